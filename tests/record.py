"""Record the results of a fixed set of public calls, and compare the records of two states of the package.

    python tests/record.py write FILE.npz       run the calls with the package that Python imports
    python tests/record.py compare A.npz B.npz  print what differs; exit code 1 where something does

Everything is public and small. Logs are drawn here with numpy, not by the package, so that both states see the same.
Each result belongs to a group, and each group has its own rule:

    value     arrays and numbers, equal to 1e-12 of the largest magnitude in the array
    bound     a value and a bound on its error: the two values differ by no more than the two bounds
    interval  lower and upper ends, equal to 1e-6 of the width
    fit       solutions of a convex program, equal to 1e-7 of the largest magnitude
    error     the class of the error is the same, and both messages name the argument
    sampled   bits drawn by the package: differences are listed apart and are not failures

The old record is that of commit c81a0ed, with which the second edition began. To make it on any machine:

    git worktree add ../base c81a0ed
    python -m venv ../basevenv && ../basevenv/bin/pip install -e '../base[parquet,gymnasium]'
    cd ../base && ../basevenv/bin/python PATH/TO/tests/record.py write /tmp/base.npz
"""

import os
import re
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions, exact

TOLERANCE = {"value": 1e-12, "interval": 1e-6, "fit": 1e-7}  # of the scale, the width, the scale

# ---- problems, made with numpy alone


def chain_mdp(n, steps, discount, n_actions=2, seed=0):
    """A ring (``steps`` with both signs), each action with other weights; rewards r(s, a)."""
    rng, at = np.random.default_rng(seed), np.arange(n)
    rows, columns, data = [], [], []
    for a in range(n_actions):
        weights = rng.random((n, len(steps))) + 0.05
        weights /= weights.sum(axis=1, keepdims=True)
        for k, step in enumerate(steps):
            rows.append(at * n_actions + a)
            columns.append((at + step) % n)
            data.append(weights[:, k])
    entries = np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))
    kernel = sparse.csr_array(sparse.coo_array(entries, shape=(n * n_actions, n)))
    return FiniteMDP(kernel, rng.random((n, n_actions)) - 0.5, np.full(n, 1 / n), discount)


def queue_mdp(n, discount):
    """A queue of at most n - 1: served by one or, at a cost, by two; reward -length."""
    kernel = np.zeros((n, 2, n))
    for s in range(n):
        for a, down in ((0, 0.5), (1, 0.7)):
            kernel[s, a, max(s - 1 - a, 0)] += down
            kernel[s, a, min(s + 1, n - 1)] += 1 - down
    rewards = -np.arange(n)[:, None] / n - np.array([0.0, 0.2])
    return FiniteMDP(kernel, rewards, np.eye(n)[n // 2], discount)


def random_mdp(n, n_actions, n_next, discount, form, seed):
    """Random successors with Dirichlet weights; rewards r(s), r(s, a) or r(s, a, s') for form 1, 2, 3."""
    rng = np.random.default_rng(seed)
    kernel = np.zeros((n, n_actions, n))
    for row in kernel.reshape(-1, n):
        row[rng.permutation(n)[:n_next]] = rng.dirichlet(np.ones(n_next))
    return FiniteMDP(kernel, rng.normal(size=(n, n_actions, n)[:form]), rng.dirichlet(np.ones(n)), discount)


def perturb(mdp, seed):
    """Other dynamics on the same support."""
    kernel = sparse.csr_array(mdp.transitions)
    weights = kernel.data * np.random.default_rng(seed).uniform(0.5, 1.5, kernel.nnz)
    kernel = sparse.csr_array((weights, kernel.indices, kernel.indptr), shape=kernel.shape)
    return mdp.with_transitions(sparse.csr_array(sparse.diags_array(1 / kernel.sum(axis=1)) @ kernel))


def random_policy(mdp, seed):
    return np.random.default_rng(seed).dirichlet(np.ones(mdp.n_actions), mdp.n_states)


def draw_log(mdp, policy, n_episodes, horizon, seed, rewards=True):
    """Episodes drawn with numpy: state, action, next state, expected reward, episode, behaviour probability."""
    rng, rows, kernel = np.random.default_rng(seed), [], sparse.csr_array(mdp.transitions)
    for episode in range(n_episodes):
        s = rng.choice(mdp.n_states, p=mdp.initial)
        for _ in range(horizon):
            a = rng.choice(mdp.n_actions, p=policy[s])
            entries = slice(*kernel.indptr[s * mdp.n_actions + a :][:2])
            following = rng.choice(kernel.indices[entries], p=kernel.data[entries])
            rows.append((s, a, following, mdp.rewards[s, a], episode, policy[s, a]))
            s = following
    s, a, following, reward, episode, probability = map(np.array, zip(*rows, strict=True))
    return Transitions(s, a, following, reward if rewards else None, episode=episode, behavior_probability=probability)


def problems():
    """Name -> MDP."""
    yield "tiny s", random_mdp(3, 2, 2, 0.9, 1, seed=1)
    yield "tiny sa", random_mdp(4, 3, 3, 0.5, 2, seed=2)
    yield "tiny sas", random_mdp(4, 2, 4, 0.99, 3, seed=3)
    yield "one state", FiniteMDP([[[1.0]]], [2.0], [1.0], 0.75)
    yield "gridworld 5", oee.tasks.gridworld(5, 0.3)
    yield "gridworld 30", oee.tasks.gridworld(30, 0.1)
    yield "ring 60", chain_mdp(60, (-1, 1, 2), 0.95)
    yield "ring 1500", chain_mdp(1500, (-2, -1, 1, 2), 0.999)
    yield "queue 80", queue_mdp(80, 0.98)
    yield "queue 400", queue_mdp(400, 0.999)
    yield "random 120", random_mdp(120, 3, 6, 0.99, 2, seed=4)
    yield "random 600", random_mdp(600, 2, 5, 0.99, 3, seed=5)
    yield "small world 500", chain_mdp(500, (-1, 1, 167), 0.99)
    yield "frozen lake", oee.tasks.toy_text("FrozenLake-v1")
    yield "taxi", oee.tasks.toy_text("Taxi-v4", discount=0.95)


# ---- the record


class Record:
    """Results by group and name. A call that fails has its error as its result."""

    def __init__(self):
        self.entries = {}

    def add(self, group, name, function, *arguments, **options):
        key = f"{group}|{name}"
        if key in self.entries:
            raise KeyError(f"{key} is recorded twice")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.entries[key] = flatten(function(*arguments, **options))
        except Exception as error:
            self.entries[key] = np.array(f"{type(error).__name__}: {error}")

    def error(self, argument, function, *arguments, **options):
        number = sum(key.startswith("error|") for key in self.entries)
        self.add("error", f"{number:02d}|{argument}", function, *arguments, **options)


def flatten(result):
    """One array of a result: numbers or text; the parts of matrices and sequences one after another."""
    if sparse.issparse(result):
        matrix = sparse.csr_array(result)
        matrix.sum_duplicates()
        return np.concatenate([matrix.shape, matrix.indptr, matrix.indices, matrix.data], dtype=float)
    if isinstance(result, exact.Moments):  # by state zeros depend on the route
        result = [result.mean, result.variance, result.bias, [] if result.by_step is None else result.by_step]
    elif isinstance(result, FiniteMDP | exact.ReweightedModel):
        result = [result.transitions, result.rewards, result.initial, result.discount, result.terminal_state]
    elif isinstance(result, Transitions | oee.TransitionCounts):
        columns = result.columns()
        result = [columns[name] for name in sorted(columns) if name != "reward_count"]  # which the old state has not
    elif isinstance(result, oee.Interval):
        result = [result.lower, result.upper]
    elif isinstance(result, oee.TransitionRatio):
        result = result.values
        return flatten(result)
    elif isinstance(result, oee.Report):
        result = [float(row["value"]) for row in result.records()]
    elif isinstance(result, oee.Plan):
        result = np.array(result.expected_width, dtype=float)
    if isinstance(result, tuple | list) and not all(isinstance(part, int | float | str) for part in result):
        return np.concatenate([np.ravel(flatten(part)) for part in result])
    array = np.asarray(result if result is not None else "None")
    return array if array.dtype.kind == "U" else array.astype(float)


def saved(thing, path):
    """What is read again from where a thing was saved."""
    thing.save(path)
    return type(thing).load(path)


def record_mdps(record, folder):
    """Constructions, changes, files, policies."""

    def add(name, function, *arguments, **options):
        record.add("value", f"FiniteMDP {name}", function, *arguments, **options)

    rng, initial = np.random.default_rng(0), [0.5, 0.25, 0.25]
    kernel = rng.dirichlet(np.ones(3), (3, 2))
    csr = sparse.csr_array(kernel.reshape(6, 3))
    forms = {"s": rng.normal(size=3), "sa": rng.normal(size=(3, 2)), "sas": rng.normal(size=(3, 2, 3))}
    for kind, given in (("dense", kernel), ("csr", csr), ("coo", csr.tocoo()), ("csc matrix", sparse.csc_matrix(csr))):
        for name, rewards in forms.items():
            add(f"{kind} r({name})", FiniteMDP, given, rewards, initial, 0.9)
    add("single precision", FiniteMDP, *(np.float32(a) for a in (kernel, forms["sa"], initial)), 0.9)
    add("lists", FiniteMDP, kernel.tolist(), forms["s"].tolist(), initial, 1)
    add("sparse rewards", FiniteMDP, csr, sparse.csr_array(forms["sas"].reshape(6, 3)), initial, 0.9)
    names = {"state_names": ["a", "b", "c"], "action_names": [("x", 0), ("x", 1)], "layout": [[0, 0], [0, 1], [1, 0]]}
    named = FiniteMDP(kernel, forms["sas"], {"a": 0.5, "b": 0.5}, 0.9, terminal_state=[0, 2, 2], **names)
    add("named", lambda: named)
    add("initial by name", FiniteMDP, kernel, forms["s"], "b", 0.9, **names)
    add("names", lambda: [repr(named.state_names), repr(named.action_names), repr(sorted(named.arrays()))])
    add("layout", lambda: [named.layout, named.with_layout([0, 1, 2]).layout, *oee.mdp.displacements(named)])
    add("renamed", lambda: repr(named.with_names(["u", "v", "w"], None).state_names))
    for change, value in (
        ("action_noise", 0.2), ("discount", 0.5), ("initial", [0, 1, 0]), ("initial", "c"), ("rewards", [1, 2, 3]),
        ("transitions", np.roll(kernel, 1, axis=2)),
    ):  # fmt: skip
        add(f"with_{change} {value!r:.10}", getattr(named, f"with_{change}"), value)
    add("with_support_of", named.with_support_of, Transitions([0], [0], [1]), 0.1)
    add("absorbing", lambda: [named.absorbing(), named.closed()])
    add("save", saved, named, folder / "mdp.npz")
    frozen = oee.tasks.make_environment("FrozenLake-v1")
    add("from_gymnasium", FiniteMDP.from_gymnasium, frozen, discount=0.9)
    record.add("sampled", "from_env", FiniteMDP.from_env, frozen, samples_per_pair=5, seed=0)
    log = draw_log(named, np.full((3, 2), 0.5), 30, 10, seed=2)
    add("from_log", FiniteMDP.from_log, log, discount=0.9)
    add("from_log rewards", FiniteMDP.from_log, log, [0, 1, 2], n_states=3, n_actions=2)
    numbers = [[0.0, 1.0], [1.0, 0.0], [0.25, 0.75]]
    mapping = {"a": ("x", 1), "b": ("x", 0), "c": {("x", 0): 0.25, ("x", 1): 0.75}}
    forms = (numbers, [1, 0, 1], mapping, {0: 1, 1: 0, 2: 0}, lambda s: ("x", 1) if s == "a" else [0.5, 0.5])
    for k, policy in enumerate(forms):
        add(f"policy {k}", oee.mdp.check_policy, policy, named)
    add("policy (T, S, A)", oee.mdp.check_policy, [numbers] * 4, named, horizon=4)
    add("mix", oee.mix, numbers, [[0.5, 0.5]] * 3, 0.3)
    add("uniform_policy", oee.uniform_policy, named)


def record_exact(record):
    """Values, occupancies, moments, bounds of every problem."""
    for name, mdp in problems():
        record_values(record, name, mdp)
        if mdp.n_states <= 130:
            record_moments(record, name, mdp)


def record_values(record, name, mdp):
    def add(what, function, *arguments, group="value", **options):
        record.add(group, f"{name}: {what} {options or ''}", function, *arguments, **options)

    policy, uniform, other = random_policy(mdp, 7), oee.uniform_policy(mdp), perturb(mdp, 8)
    even, zeta, undiscounted = np.full_like(policy, 1 / policy.size), oee.true_ratio(other, mdp), mdp.with_discount(1.0)
    for horizon in (None, 1, 12):
        for function in (oee.state_values, oee.action_values, oee.policy_value, exact.transition_gradient):
            add(function.__name__, function, mdp, policy, horizon=horizon)
        add("policy_value", oee.policy_value, mdp, uniform, normalized=True, horizon=horizon)
        for of in ("state", "state_action", "transition"):
            add("occupancy", oee.occupancy, mdp, policy, of=of, horizon=horizon)
        group = "fit" if horizon is None else "value"
        add("optimal_policy", optimal_value, mdp, group=group, horizon=horizon)
        add("efficiency_bound", oee.efficiency_bound, mdp, policy, even, horizon=horizon)
    add("discount 1", oee.policy_value, undiscounted, policy, horizon=9)
    add("discount 1", oee.state_values, undiscounted, uniform)
    add("by horizon", exact.policy_values_by_horizon, mdp, policy, horizon=20)
    add("in time", oee.policy_value, mdp, np.stack([policy, uniform, policy]), horizon=3)
    add("evaluate_policy", bounded_values, mdp, policy, group="bound")
    add("true_ratio", oee.true_ratio, other, mdp)
    add("reweight", exact.reweight, mdp, zeta.values)
    add("reweighted value", oee.policy_value, exact.reweight(mdp, 0.99 * zeta.values), policy)


def record_moments(record, name, mdp):
    def add(what, function, *arguments, **options):
        record.add("value", f"{name}: {what} {options}", function, *arguments, **options)

    policy, uniform, other = random_policy(mdp, 7), oee.uniform_policy(mdp), perturb(mdp, 8)
    even, zeta = np.full_like(policy, 1 / policy.size), oee.true_ratio(other, mdp)
    add("return_moments", oee.return_moments, mdp, policy)
    add("return_moments", oee.return_moments, mdp, policy, horizon=12, sources=True)
    add("weight_growth", exact.weight_growth, mdp, zeta, policy)
    add("weight_moments", exact.weight_moments, mdp, zeta, policy, horizon=5)
    add("leading_bias", exact.leading_bias, mdp, policy, even)
    add("ratio_of_ratios_variance", exact.ratio_of_ratios_variance, mdp, other, policy, even, even)
    for kind in ("per_decision", "trajectory"):
        for options in ({}, {"self_normalized": True}, {"sources": True}):
            add("weighted", oee.weighted_return_moments, mdp, zeta, policy, kind=kind, horizon=6, **options)
            add("importance", oee.policy_is_moments, mdp, uniform, policy, kind=kind, horizon=6, **options)
    values = np.tile(oee.state_values(mdp, policy), (7, 1))
    record.add("value", f"{name}: robust", oee.doubly_robust_moments, mdp, zeta, policy, baseline=values, horizon=6)
    for model in ("mdp", "tree", "stationary"):
        add("trajectory bound", oee.trajectory_efficiency_bound, mdp, uniform, policy, horizon=6, model=model)


def optimal_value(mdp, **options):
    """The values of the optimal policy, which itself may break ties either way."""
    return oee.state_values(mdp, oee.optimal_policy(mdp, **options), **options)


def bounded_values(mdp, policy):
    result = exact.evaluate_policy(mdp, policy)
    return [result.values, result.error_bound]


def record_data(record, folder):
    """Logs: columns, counts, files, frames, names, bad rows."""

    def add(name, function, *arguments, **options):
        record.add("value", name, function, *arguments, **options)

    mdp = oee.tasks.gridworld(4, 0.2)
    log, other = (draw_log(mdp, oee.uniform_policy(mdp), 12, 15, seed=seed) for seed in (5, 6))
    states, actions = [f"r{k // 4}c{k % 4}" for k in range(16)], ["n", "e", "s", "w"]
    named = mdp.with_names(states, actions)
    add("counts", log.counts, 16, 4)
    add("counts discount", log.counts, 16, 4, discount=0.9)
    add("select", log.select, np.arange(30))
    add("first", log.first, 17)
    add("concatenate", Transitions.concatenate, [log, other])
    record.add("sampled", "draw", log.draw, 20, seed=0)
    table = pd.DataFrame({name: log.columns()[name] for name in ("state", "action", "next_state", "reward")})
    add("from_frame", Transitions.from_frame, table)
    labels = {"state": "s", "action": "a", "next_state": "s2"}
    add("from_frame renamed", Transitions.from_frame, table.rename(columns=labels), **labels)
    words = table.assign(action=[actions[k] for k in table["action"]])
    for column in ("state", "next_state"):
        words[column] = [states[k] for k in table[column]]
    add("from_frame names", Transitions.from_frame, words, simulator=named)
    for ending in ("npz", "csv", "parquet"):
        path, parts = folder / f"log.{ending}", folder / ending
        parts.mkdir()
        for k, part in enumerate((log, other)):
            part.save(parts / f"part-{k}.{ending}")
        add(f"load {ending}", saved, log, path)
        add(f"open {ending}", Transitions.open, path)
        add(f"open {ending} folder", Transitions.open, parts)
        add(f"open {ending} pattern", Transitions.open, f"{parts}/part-*.{ending}")
        add(f"open {ending} list", Transitions.open, sorted(parts.iterdir()), simulator=mdp)
        if ending != "npz":
            path = folder / f"words.{ending}"
            words.to_csv(path, index=False) if ending == "csv" else words.to_parquet(path)
            add(f"open names {ending}", Transitions.open, path, simulator=named)
            add(f"load names {ending}", lambda p=path: Transitions.load(p).numbered(named))
    add("counts file", saved, Transitions.open(folder / "log.csv"), folder / "counts.npz")
    bad = folder / "bad.csv"
    bad.write_text("state,action,next_state,reward\n0,0,1,1\n1,0,x,2\n1,9,2,1\n2,1,2,inf\n2,1,3,0.5\n")
    add("bad rows dropped", lambda: Transitions.open(bad, simulator=mdp, bad_rows="drop").counts(16, 4))
    record.error("next_state", Transitions.open, bad)
    steps = [[(0, 1, 0.5), (1, 2, 0.0), (5, 0, 1.0)], [(0, 0, 0.0), (4, 3, 2.0)]]
    add("from_episodes", Transitions.from_episodes, steps)


def record_above(record):
    """What stands on these rooms: ratios, intervals, reports, plans, samples."""
    lake = oee.tasks.toy_text("FrozenLake-v1", discount=0.9)
    simulators = {"grid": oee.tasks.gridworld(4, 0.3), "random": random_mdp(12, 2, 4, 0.9, 3, seed=9), "lake": lake}
    for name, simulator in simulators.items():

        def add(group, what, function, *arguments, name=name, **options):
            record.add(group, f"{name}: {what}", function, *arguments, **options)

        target, policy, uniform = perturb(simulator, 3), random_policy(simulator, 4), oee.uniform_policy(simulator)
        log = draw_log(target, uniform, 20, 25, seed=1, rewards=name != "lake")
        if name == "lake":  # a bag: at the ends of episodes, which are not marked, states go on
            log = Transitions(log.state, log.action, log.next_state)
        problem = oee.Problem(simulator, log)
        add("fit", "conditional", oee.transition_ratio, log, simulator)
        add("fit", "joint", oee.transition_ratio, log, simulator, method="joint", simulator_data="exact")
        for method in ("likelihood", "delta"):
            add("interval", method, oee.interval, problem, policy, method=method)
        add("interval", "box", oee.interval, problem, policy, lower_ratio=0.4, upper_ratio=2.5)
        add("fit", "evaluate", oee.evaluate, problem, policy, estimators=["model-based", "oee"], quick=True, seed=0)
        add("fit", "plan", oee.plan_data_collection, problem, policy, n=300)
        add("sampled", "episodes", oee.sample_episodes, target, uniform, 40, 10, seed=11)
        add("sampled", "transitions", oee.sample_transitions, target, uniform / len(uniform), 200, seed=11)
        add("sampled", "returns", lambda t=target, u=uniform: oee.sample_returns(t, u, 99, 30, seed=11).values)
        add("value", "samples", are_near, target, uniform)


def are_near(mdp, policy):
    """Whether mean and variance of 20 000 returns lie within 5 standard errors and a fifth of the exact ones."""
    values, truth = (
        oee.sample_returns(mdp, policy, 20_000, 15, seed=1).values,
        oee.return_moments(mdp, policy, horizon=15),
    )
    near = abs(values.mean() - truth.mean) <= 5 * np.sqrt(truth.variance / len(values)) + 1e-12
    return [near, abs(values.var() - truth.variance) < 0.2 * truth.variance + 1e-12]


def record_errors(record):
    """Bad calls: the argument that the message must name, and the call."""
    grid = oee.tasks.gridworld(3, 0.3)
    u, log = oee.uniform_policy(grid), draw_log(grid, oee.uniform_policy(grid), 4, 6, seed=0)
    P, ratio, problem = np.full((2, 1, 2), 0.5), oee.true_ratio(grid, grid), oee.Problem(grid, log)
    nan, small, other = P * np.nan, sparse.csr_array(np.ones((4, 2))), sparse.csr_array(np.ones((3, 3)))
    wrong = {
        "transitions": [P * 2, -P, nan, np.eye(2), [["a"]], None, P[:0], P + 0j, small, sparse.csr_array(nan[:, 0]), "P"],
        "rewards": [np.zeros(3), [0, np.inf], "r", nan, other], "initial": [[0.5, 0.4], [1.0], [np.nan, 1], "start", [-1, 2]],
        "discount": [1.01, np.nan, "high", None, -0.1], "terminal_state": [[0, 2], [0.5], "x"],
        "layout": [[0, 1, 2], [[0, np.nan]] * 2], "state_names": [["a"], ["a", "a"], 3],
    }  # fmt: skip
    given = {"transitions": P, "rewards": [0.0, 0.0], "initial": [1.0, 0.0], "discount": 0.9}
    columns = {"state": [0, 1], "action": [0, 0], "next_state": [1, 2]}
    for argument, values in wrong.items():
        for value in values:
            record.error(argument, FiniteMDP, **{**given, argument: value})
    for value in (u[:, :3], u * 2, u * np.nan, "uniform", None, [9] * 9, [0.5] * 9, {0: 1}, lambda s: [1, 1], [u] * 2):
        record.error("policy", oee.policy_value, grid, value)
    for value in (0, 2.5, True, "3", -1):
        record.error("horizon", oee.policy_value, grid, u, horizon=value)
    for argument, value in (
        ("state", [0.5, 1]), ("state", ["a", "b"]), ("action", [-1, 0]), ("next_state", [1]), ("reward", [np.inf, 0]),
        ("terminated", [2, 0]), ("episode", [1e300, 0]), ("timestep", "x"), ("behavior_probability", [1.2, 1]),
    ):  # fmt: skip
        record.error(argument, Transitions, **{**columns, argument: value})
    for argument, function, *arguments in (
        ("mdp", oee.policy_value, P, u), ("epsilon", grid.with_action_noise, 1.5), ("transitions", grid.with_transitions, P),
        ("initial", grid.with_initial, 99), ("weight_of_a", oee.mix, u, u, 2), ("policy", oee.mix, u, u[:3], 0.5),
        ("data_distribution", oee.efficiency_bound, grid, u, u), ("ratio", exact.reweight, grid, small),
        ("rows", log.select, []),
        ("n_states", log.counts, "3", 2), ("frame", Transitions.from_frame, pd.DataFrame({"place": [0]})),
        ("path", log.save, "log.xlsx"), ("nowhere.csv", Transitions.load, "nowhere.csv"), ("log", oee.Problem, grid, P),
        ("nowhere.parquet", Transitions.open, "nowhere.parquet"), ("simulator", oee.Problem, P, log),
    ):  # fmt: skip
        record.error(argument, function, *arguments)
    for argument, function, *arguments, options in (
        ("normalized", oee.policy_value, grid, u, {"normalized": 2}), ("of", oee.occupancy, grid, u, {"of": "action"}),
        ("discount", oee.occupancy, grid.with_discount(1.0), u, {}), ("n", log.draw, 10**6, {"seed": 0}),
        ("kind", oee.policy_is_moments, grid, u, u, {"kind": "step", "horizon": 3}), ("seed", log.draw, 2, {"seed": -1}),
        ("behavior_policy", oee.policy_is_moments, grid, u[:3], u, {"horizon": 3}),
        ("zeta", oee.weighted_return_moments, grid, np.ones(3), u, {"horizon": 3}),
        ("model", oee.trajectory_efficiency_bound, grid, u, u, {"horizon": 3, "model": "bush"}),
        ("baseline", oee.doubly_robust_moments, grid, ratio, u, {"baseline": [1.0], "horizon": 3}),
        ("n_episodes", oee.sample_episodes, grid, u, 0, 3, {"seed": 0}),
        ("horizon", oee.sample_episodes, grid, u, 1, 0, {"seed": 0}),
        ("seed", oee.sample_episodes, grid, u, 1, 1, {"seed": "a"}),
        ("distribution", oee.sample_transitions, grid, u, 3, {"seed": 0}),
        ("method", oee.transition_ratio, log, grid, {"method": "joined"}),
        ("confidence", oee.interval, problem, u, {"confidence": 2}),
    ):  # fmt: skip
        record.error(argument, function, *arguments, **options)


def write(path):
    """Run every call and write the record."""
    record = Record()
    with tempfile.TemporaryDirectory() as folder:
        record_mdps(record, Path(folder))
        record_data(record, Path(folder))
    for part in (record_exact, record_above, record_errors):
        part(record)
    np.savez_compressed(path, **record.entries)
    return record.entries


# ---- the comparison


def difference(key, a, b):
    """What differs between two results, in words, or an empty text."""
    group, _, name = key.partition("|")
    texts = [str(x) if x.dtype.kind == "U" else "" for x in (a, b)]
    if group == "error":
        argument = re.escape(name.split("|")[-1])
        classes = [text.partition(":")[0] or "no error" for text in texts]
        silent = [not re.search(rf"(?<![a-z]){argument}", text.partition(":")[2]) for text in texts]
        if classes[0] != classes[1]:
            return f"{classes[0]} -> {classes[1]}: {texts[1] or texts[0]:.160}"
        return f"does not name {name.split('|')[-1]}: {texts[1]:.160}" if silent[1] and not silent[0] else ""
    if any(texts):
        failed = [re.match(r"\w+(Error|Exception|Warning): ", text) for text in texts]
        if all(failed):
            return "" if failed[0].group() == failed[1].group() else f"{texts[0]:.100} -> {texts[1]:.100}"
        return "" if texts[0] == texts[1] else f"{texts[0] or a.shape!s:.140} -> {texts[1] or b.shape!s:.140}"
    if a.shape != b.shape:
        return f"shape {a.shape} -> {b.shape}"
    if group == "bound":  # the last number is the bound
        apart, allowed = np.max(np.abs(a[:-1] - b[:-1]), initial=0.0), a[-1] + b[-1]
        return "" if apart <= allowed else f"values apart by {apart:.3g}, bounds allow {allowed:.3g}"
    if a.size == 0:
        return ""
    with np.errstate(invalid="ignore"):
        apart = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, np.abs(a - b))
    if group == "sampled":
        return f"{np.count_nonzero(apart)} of {a.size} numbers" if apart.any() else ""
    sizes = np.abs(a[np.isfinite(a)])
    scale = abs(a.flat[-1] - a.flat[0]) if group == "interval" else sizes.max(initial=0.0)
    largest = float(np.max(apart))
    return (
        ""
        if largest <= TOLERANCE[group] * scale
        else f"{largest / (scale or 1.0):.3g} of the {group}'s scale {scale:.3g}"
    )


def compare(path_a, path_b):
    """Lines of what differs, failures first and sampled bits apart; the number of failures."""
    with np.load(path_a) as a, np.load(path_b) as b:
        old, new = dict(a), dict(b)
    lines = {"failure": [], "sampled": []}
    for key in sorted(old.keys() | new.keys()):
        both = key in old and key in new
        text = difference(key, old[key], new[key]) if both else f"only in {path_a if key in old else path_b}"
        if text:
            lines["sampled" if key.startswith("sampled|") else "failure"].append(f"{key:<60} {text}")
    return len(old), lines


def main(arguments):
    if len(arguments) == 2 and arguments[0] == "write":
        print(f"{len(write(arguments[1]))} results in {os.path.basename(arguments[1])}")
        return 0
    if len(arguments) != 3 or arguments[0] != "compare":
        print(__doc__)
        return int(arguments != ["--help"])
    number, lines = compare(*arguments[1:])
    print(*lines["failure"], sep="\n")
    print(f"{number} results, {len(lines['failure'])} differ")
    print(*(["sampled bits that differ (no failure):"] * bool(lines["sampled"])), *lines["sampled"], sep="\n")
    return int(bool(lines["failure"]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
