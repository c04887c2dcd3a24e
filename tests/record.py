# ruff: noqa: B023, E501
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
    """Results by group and name; a result is made by ``thunk`` and may be an error, which is a result as well."""

    def __init__(self):
        self.entries = {}

    def add(self, group, name, thunk):
        key = f"{group}|{name}"
        if key in self.entries:
            raise KeyError(f"{key} is recorded twice")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.entries[key] = flatten(thunk())
        except Exception as error:
            self.entries[key] = np.array(f"{type(error).__name__}: {error}")

    def error(self, argument, thunk):
        number = sum(key.startswith("error|") for key in self.entries)
        self.add("error", f"{number:02d}|{argument}", thunk)


def flatten(result):
    """One array of a result: numbers, text, the parts of matrices and sequences one after another."""
    if sparse.issparse(result):
        matrix = sparse.csr_array(result)
        matrix.sum_duplicates()
        return np.concatenate([matrix.shape, matrix.indptr, matrix.indices, matrix.data], dtype=float)
    if isinstance(result, exact.Moments):
        result = [result.mean, result.variance, result.bias]
    if isinstance(result, oee.FiniteMDP | exact.ReweightedModel):
        result = [result.transitions, result.rewards, result.initial, result.discount, result.terminal_state]
    if isinstance(result, oee.Transitions | oee.TransitionCounts):
        columns = result.columns()
        result = [columns[name] for name in sorted(columns)]
    if isinstance(result, tuple | list) and not all(isinstance(part, int | float | str) for part in result):
        return np.concatenate([np.ravel(flatten(part)) for part in result])
    array = np.asarray(result if result is not None else "None")
    return array if array.dtype.kind == "U" else array.astype(float)


def record_mdps(record, folder):
    """Constructions, changes, files."""
    rng = np.random.default_rng(0)
    kernel = rng.dirichlet(np.ones(3), (3, 2))
    initial = [0.5, 0.25, 0.25]
    csr = sparse.csr_array(kernel.reshape(6, 3))
    forms = {"s": rng.normal(size=3), "sa": rng.normal(size=(3, 2)), "sas": rng.normal(size=(3, 2, 3))}
    for name, rewards in forms.items():
        for kind, given in (
            ("dense", kernel),
            ("csr", csr),
            ("coo", csr.tocoo()),
            ("csc matrix", sparse.csc_matrix(csr)),
        ):
            record.add("value", f"FiniteMDP {kind} r({name})", lambda g=given, r=rewards: FiniteMDP(g, r, initial, 0.9))
    single = (kernel.astype(np.float32), forms["sa"].astype(np.float32), np.array(initial, dtype=np.float32))
    record.add("value", "FiniteMDP single precision", lambda: FiniteMDP(*single, 0.9))
    record.add("value", "FiniteMDP lists", lambda: FiniteMDP(kernel.tolist(), forms["s"].tolist(), initial, 1))
    sparse_rewards = sparse.csr_array(forms["sas"].reshape(6, 3))
    record.add("value", "FiniteMDP sparse rewards", lambda: FiniteMDP(csr, sparse_rewards, initial, 0.9))
    options = {"state_names": ["a", "b", "c"], "action_names": [("x", 0), ("x", 1)], "layout": [[0, 0], [0, 1], [1, 0]]}
    named = FiniteMDP(kernel, forms["sas"], {"a": 0.5, "b": 0.5}, 0.9, terminal_state=[0, 2, 2], **options)
    record.add("value", "FiniteMDP named", lambda: named)
    record.add("value", "FiniteMDP initial by name", lambda: FiniteMDP(kernel, forms["s"], "b", 0.9, **options))
    record.add("value", "FiniteMDP layout", lambda: named.layout)
    record.add("value", "FiniteMDP names", lambda: repr((named.state_names, named.action_names)))
    changes = {
        "with_action_noise": lambda m: m.with_action_noise(0.2),
        "with_discount": lambda m: m.with_discount(0.5),
        "with_initial": lambda m: m.with_initial([0, 1, 0]),
        "with_initial state": lambda m: m.with_initial("c"),
        "with_layout": lambda m: m.with_layout([0, 1, 2]).layout,
        "with_names": lambda m: repr(m.with_names(["u", "v", "w"], None).state_names),
        "with_rewards": lambda m: m.with_rewards([1, 2, 3]),
        "with_transitions": lambda m: m.with_transitions(np.roll(kernel, 1, axis=2)),
        "with_support_of": lambda m: m.with_support_of(Transitions([0], [0], [1]), 0.1),
        "arrays": lambda m: repr(sorted(m.arrays())),
        "absorbing": lambda m: m.absorbing(),
        "closed": lambda m: m.closed(),
        "save": lambda m: (m.save(folder / "mdp.npz"), FiniteMDP.load(folder / "mdp.npz"))[1],
        "displacements": lambda m: oee.mdp.displacements(m),
    }
    for name, change in changes.items():
        record.add("value", f"FiniteMDP {name}", lambda c=change: c(named))
    frozen = oee.tasks.make_environment("FrozenLake-v1", map_name="8x8")
    record.add("value", "from_gymnasium", lambda: FiniteMDP.from_gymnasium(frozen, discount=0.9))
    log = draw_log(named, np.full((3, 2), 0.5), 30, 10, seed=2)
    record.add("value", "from_log", lambda: FiniteMDP.from_log(log, discount=0.9))
    record.add("value", "from_log rewards", lambda: FiniteMDP.from_log(log, [0, 1, 2], n_states=3, n_actions=2))
    cliff = oee.tasks.make_environment("FrozenLake-v1")
    record.add("sampled", "from_env", lambda: FiniteMDP.from_env(cliff, samples_per_pair=5, seed=0))
    numbers = [[0.0, 1.0], [1.0, 0.0], [0.25, 0.75]]
    policies = {
        "(S, A)": numbers, "(S,)": [1, 0, 1], "mapping": {"a": ("x", 1), "b": ("x", 0), "c": {("x", 0): 0.25, ("x", 1): 0.75}},
        "mapping by number": {0: 1, 1: 0, 2: 0}, "function": lambda s: ("x", 1) if s == "a" else [0.5, 0.5],
    }  # fmt: skip
    for name, policy in policies.items():
        record.add("value", f"policy {name}", lambda p=policy: oee.mdp.check_policy(p, named))
    record.add("value", "policy (T, S, A)", lambda: oee.mdp.check_policy([numbers] * 4, named, horizon=4))
    record.add("value", "mix", lambda: oee.mix(numbers, [[0.5, 0.5]] * 3, 0.3))
    record.add("value", "uniform_policy", lambda: oee.uniform_policy(named))


def record_exact(record):
    """Values, occupancies, moments, bounds of every problem."""
    for name, mdp in problems():
        policy, uniform, other = random_policy(mdp, 7), oee.uniform_policy(mdp), perturb(mdp, 8)
        even, small = np.full_like(policy, 1 / policy.size), mdp.n_states <= 130

        def add(what, thunk, group="value", name=name):
            record.add(group, f"{name}: {what}", thunk)

        for horizon in (None, 1, 12):
            of = {"horizon": horizon}
            add(f"state_values {horizon}", lambda of=of: oee.state_values(mdp, policy, **of))
            add(f"action_values {horizon}", lambda of=of: oee.action_values(mdp, policy, **of))
            add(f"policy_value {horizon}", lambda of=of: oee.policy_value(mdp, policy, **of))
            add(f"normalized {horizon}", lambda of=of: oee.policy_value(mdp, uniform, normalized=True, **of))
            for kind in ("state", "state_action", "transition"):
                add(f"occupancy {kind} {horizon}", lambda of=of, k=kind: oee.occupancy(mdp, policy, of=k, **of))
            add(
                f"optimal_policy {horizon}",
                lambda of=of: optimal_value(mdp, **of),
                "fit" if horizon is None else "value",
            )
            add(f"efficiency_bound {horizon}", lambda of=of: oee.efficiency_bound(mdp, policy, even, **of))
            add(f"transition_gradient {horizon}", lambda of=of: exact.transition_gradient(mdp, policy, **of))
        add("discount 1", lambda: oee.policy_value(mdp.with_discount(1.0), policy, horizon=9))
        add("discount 1 absorbed", lambda: oee.state_values(mdp.with_discount(1.0), uniform))
        add("policy_values_by_horizon", lambda: exact.policy_values_by_horizon(mdp, policy, horizon=20))
        add("in time", lambda: oee.policy_value(mdp, np.stack([policy, uniform, policy]), horizon=3))
        add(
            "evaluate_policy",
            lambda: (lambda v: [v.values, v.error_bound])(exact.evaluate_policy(mdp, policy)),
            "bound",
        )
        zeta = oee.true_ratio(other, mdp)
        add("true_ratio", lambda: zeta.values)
        add("reweight", lambda: exact.reweight(mdp, zeta.values))
        add("reweighted value", lambda: oee.policy_value(exact.reweight(mdp, 0.99 * zeta.values), policy))
        if not small:
            continue
        add("return_moments", lambda: oee.return_moments(mdp, policy))
        add("return_moments 12", lambda: oee.return_moments(mdp, policy, horizon=12, sources=True))
        add("weight_growth", lambda: exact.weight_growth(mdp, zeta, policy))
        add("weight_moments", lambda: list(exact.weight_moments(mdp, zeta, policy, horizon=5)))
        add("leading_bias", lambda: exact.leading_bias(mdp, policy, even))
        add("ratio_of_ratios_variance", lambda: exact.ratio_of_ratios_variance(mdp, other, policy, even, even))
        for kind in ("per_decision", "trajectory"):
            for options in ({}, {"self_normalized": True}, {"sources": True}):
                of = {"kind": kind, "horizon": 6, **options}
                add(f"weighted {of}", lambda of=of: moments(oee.weighted_return_moments(mdp, zeta, policy, **of)))
                add(f"importance {of}", lambda of=of: moments(oee.policy_is_moments(mdp, uniform, policy, **of)))
        baseline = np.tile(oee.state_values(mdp, policy), (7, 1))
        add("doubly_robust", lambda: oee.doubly_robust_moments(mdp, zeta, policy, baseline=baseline, horizon=6))
        for model in ("mdp", "tree", "stationary"):
            of = {"horizon": 6, "model": model}
            add(f"trajectory {model}", lambda of=of: oee.trajectory_efficiency_bound(mdp, uniform, policy, **of))


def optimal_value(mdp, **options):
    """J and the occupancy-free value of the optimal policy: the policy itself may break ties either way."""
    policy = oee.optimal_policy(mdp, **options)
    return [oee.policy_value(mdp, policy, **options), *oee.state_values(mdp, policy, **options).tolist()]


def moments(result):
    """All of some Moments but those by state, whose zeros depend on the route."""
    by_step = [] if result.by_step is None else result.by_step
    return [*(float(x) for x in (result.mean, result.variance, result.bias)), *np.ravel(by_step).tolist()]


def record_data(record, folder):
    """Logs: columns, counts, files, frames, names, bad rows."""
    mdp = oee.tasks.gridworld(4, 0.2)
    uniform = oee.uniform_policy(mdp)
    log, other = (draw_log(mdp, uniform, 12, 15, seed=seed) for seed in (5, 6))
    n = (mdp.n_states, mdp.n_actions)
    record.add("value", "counts", lambda: log.counts(*n))
    record.add("value", "counts discount", lambda: log.counts(*n, discount=0.9))
    record.add("value", "select", lambda: log.select(np.arange(0, 30)))
    record.add("value", "first", lambda: log.first(17))
    record.add("value", "concatenate", lambda: Transitions.concatenate([log, other]))
    record.add("sampled", "draw", lambda: log.draw(20, seed=0))
    for ending in ("npz", "csv", "parquet"):
        path = folder / f"log.{ending}"
        record.add("value", f"load {ending}", lambda p=path: (log.save(p), Transitions.load(p))[1])
        record.add("value", f"open {ending}", lambda p=path: Transitions.open(p).counts(*n))
        record.add("value", f"open {ending} sums", lambda p=path: Transitions.open(p).reward_sum)
        parts = folder / f"parts-{ending}"
        parts.mkdir()
        for k, part in enumerate((log, other)):
            part.save(parts / f"part-{k}.{ending}")
        record.add("value", f"open {ending} folder", lambda p=parts: Transitions.open(p))
        record.add("value", f"open {ending} pattern", lambda p=parts, e=ending: Transitions.open(f"{p}/part-*.{e}"))
        record.add("value", f"open {ending} list", lambda p=parts: Transitions.open(sorted(p.iterdir()), simulator=mdp))
    record.add("value", "counts file", lambda: saved_counts(folder, log))
    rows = {key: value for key, value in log.columns().items() if key in ("state", "action", "next_state", "reward")}
    record.add("value", "from_frame", lambda: Transitions.from_frame(pd.DataFrame(rows)))
    renamed = pd.DataFrame({"s": rows["state"], "a": rows["action"], "s2": rows["next_state"]})
    labels = {"state": "s", "action": "a", "next_state": "s2"}
    record.add("value", "from_frame renamed", lambda: Transitions.from_frame(renamed, **labels))
    named = mdp.with_names([f"r{k // 4}c{k % 4}" for k in range(16)], ["n", "e", "s", "w"])
    words = pd.DataFrame({key: [f"r{k // 4}c{k % 4}" for k in rows[key]] for key in ("state", "next_state")})
    words["action"] = [["n", "e", "s", "w"][k] for k in rows["action"]]
    record.add("value", "from_frame names", lambda: Transitions.from_frame(words, simulator=named))
    words.to_csv(folder / "words.csv", index=False)
    words.to_parquet(folder / "words.parquet")
    for ending in ("csv", "parquet"):
        record.add(
            "value", f"open names {ending}", lambda e=ending: Transitions.open(folder / f"words.{e}", simulator=named)
        )
        record.add(
            "value", f"load names {ending}", lambda e=ending: Transitions.load(folder / f"words.{e}").numbered(named)
        )
    (folder / "bad.csv").write_text("state,action,next_state,reward\n0,0,1,1\n1,0,x,2\n1,9,2,1\n2,1,2,nan\n2,1,3,0.5\n")
    bad = {"simulator": mdp, "bad_rows": "drop"}
    record.add("value", "bad rows dropped", lambda: Transitions.open(folder / "bad.csv", **bad).counts(*n))
    record.add("error", "bad rows|next_state", lambda: Transitions.open(folder / "bad.csv"))
    steps = [[(0, 1, 0.5), (1, 2, 0.0), (5, 0, 1.0)], [(0, 0, 0.0), (4, 3, 2.0)]]
    record.add("value", "from_episodes", lambda: Transitions.from_episodes(steps))


def saved_counts(folder, log):
    log.save(folder / "c.csv")
    counts = oee.Transitions.open(folder / "c.csv")
    counts.save(folder / "counts.npz")
    return oee.TransitionCounts.load(folder / "counts.npz")


def record_above(record):
    """What stands on these rooms: ratios, intervals, reports, plans, samples."""
    for name in ("gridworld", "random", "lake"):
        simulator = {
            "gridworld": lambda: oee.tasks.gridworld(4, 0.3),
            "random": lambda: random_mdp(12, 2, 4, 0.9, 3, seed=9),
            "lake": lambda: oee.tasks.toy_text("FrozenLake-v1", discount=0.9),
        }[name]()
        target, policy = perturb(simulator, 3), random_policy(simulator, 4)
        uniform = oee.uniform_policy(simulator)
        log = draw_log(target, uniform, 20, 25, seed=1)
        if name == "lake":
            log = Transitions(log.state, log.action, log.next_state)
        try:
            problem = oee.Problem(simulator, log)
        except ValueError as error:
            record.add("value", f"{name}: Problem", lambda e=error: str(type(e)))
            continue
        exactly = {"conditional": {}, "joint": {"simulator_data": "exact"}}
        for method in exactly:
            record.add("fit", f"{name}: transition_ratio {method}",
                       lambda p=problem, s=simulator, g=log, m=method: oee.transition_ratio(g, s, method=m, **exactly[m]).values)  # fmt: skip
        for method in ("likelihood", "delta"):
            record.add("interval", f"{name}: interval {method}",
                       lambda p=problem, q=policy, m=method: ends(oee.interval(p, q, method=m)))  # fmt: skip
        box = {"lower_ratio": 0.4, "upper_ratio": 2.5}
        record.add("interval", f"{name}: interval box", lambda p=problem, q=policy: ends(oee.interval(p, q, **box)))
        quick = {"estimators": ["model-based", "oee"], "quick": True, "seed": 0}
        record.add("fit", f"{name}: evaluate", lambda p=problem, q=policy: report_values(oee.evaluate(p, q, **quick)))
        planned = {"n": 300, "solver": "auto"}
        record.add(
            "fit", f"{name}: plan", lambda p=problem, q=policy: plan_widths(oee.plan_data_collection(p, q, **planned))
        )
        drawn = {"seed": 11}
        record.add(
            "sampled", f"{name}: episodes", lambda t=target, u=uniform: oee.sample_episodes(t, u, 40, 10, **drawn)
        )
        even = np.full_like(uniform, 1 / uniform.size)
        record.add(
            "sampled", f"{name}: transitions", lambda t=target, e=even: oee.sample_transitions(t, e, 200, **drawn)
        )
        record.add(
            "sampled", f"{name}: returns", lambda t=target, u=uniform: oee.sample_returns(t, u, 99, 30, **drawn).values
        )
        record.add("value", f"{name}: z of 20 000 sampled returns", lambda t=target, u=uniform: is_near(t, u))


def is_near(mdp, policy):
    """Whether the mean and the variance of sampled returns lie within 5 standard errors of the exact ones."""
    values = oee.sample_returns(mdp, policy, 20_000, 15, seed=1).values
    truth = oee.return_moments(mdp, policy, horizon=15)
    spread = np.sqrt(truth.variance / len(values))
    return [
        abs(values.mean() - truth.mean) <= 5 * spread + 1e-12,
        abs(values.var() / max(truth.variance, 1e-300) - 1) < 0.2,
    ]


def ends(interval):
    return [interval.lower, interval.upper]


def report_values(report):
    return [float(row["value"]) for row in report.records()]


def plan_widths(plan):
    return np.array(plan.expected_width, dtype=float)


def record_errors(record):
    """Bad calls: the argument that the message must name, and the call."""
    grid = oee.tasks.gridworld(3, 0.3)
    u, log = oee.uniform_policy(grid), draw_log(grid, oee.uniform_policy(grid), 4, 6, seed=0)
    P, r, mu = np.full((2, 1, 2), 0.5), np.zeros(2), [1.0, 0.0]
    even, zeta = u / 9, oee.true_ratio(grid, grid)
    wrong = {
        "transitions": [P * 2, -P, P * np.nan, np.eye(2), [["a"]], None, np.zeros((0, 1, 0)), P + 0j, sparse.eye_array(3),
                        sparse.csr_array(np.full((2, 2), np.nan)), sparse.csr_array((2, 2)), "P"],
        "rewards": [np.zeros(3), [0, np.inf], "r", np.full((2, 1, 2), np.nan), sparse.csr_array(np.ones((3, 3)))],
        "initial": [[0.5, 0.4], [1.0], [np.nan, 1], "start", [-1, 2]],
        "discount": [1.01, np.nan, "high", None, -0.1],
        "terminal_state": [[0, 2], [0.5], "x"], "layout": [[0, 1, 2], [[0, np.nan]] * 2], "state_names": [["a"], ["a", "a"], 3],
    }  # fmt: skip
    given = {"transitions": P, "rewards": r, "initial": mu, "discount": 0.9}
    for argument, values in wrong.items():
        for value in values:
            record.error(argument, lambda a=argument, v=value: FiniteMDP(**{**given, a: v}))
    for policy in (
        u[:, :3],
        u * 2,
        u * np.nan,
        "uniform",
        None,
        [9] * 9,
        [0.5] * 9,
        {0: 1},
        lambda s: [1, 1],
        np.stack([u] * 2),
    ):
        record.error("policy", lambda p=policy: oee.policy_value(grid, p))
    for horizon in (0, 2.5, True, "3", -1):
        record.error("horizon", lambda h=horizon: oee.policy_value(grid, u, horizon=h))
    record.error("normalized", lambda: oee.policy_value(grid, u, normalized=2))
    record.error("mdp", lambda: oee.policy_value(P, u))
    record.error("discount", lambda: oee.occupancy(grid.with_discount(1.0), u))
    record.error("of", lambda: oee.occupancy(grid, u, of="action"))
    record.error("epsilon", lambda: grid.with_action_noise(1.5))
    record.error("transitions", lambda: grid.with_transitions(P))
    record.error("initial", lambda: grid.with_initial(99))
    record.error("weight_of_a", lambda: oee.mix(u, u, 2))
    record.error("policy", lambda: oee.mix(u, u[:3], 0.5))
    record.error("kind", lambda: oee.policy_is_moments(grid, u, u, kind="step", horizon=3))
    record.error("behavior_policy", lambda: oee.policy_is_moments(grid, u[:3], u, horizon=3))
    record.error("zeta", lambda: oee.weighted_return_moments(grid, np.ones(3), u, horizon=3))
    record.error("data_distribution", lambda: oee.efficiency_bound(grid, u, even * 2))
    record.error("model", lambda: oee.trajectory_efficiency_bound(grid, u, u, horizon=3, model="bush"))
    record.error("ratio", lambda: exact.reweight(grid, sparse.csr_array(np.ones((4, 2)))))
    record.error("baseline", lambda: oee.doubly_robust_moments(grid, zeta, u, baseline=[1.0], horizon=3))
    columns = {"state": [0, 1], "action": [0, 0], "next_state": [1, 2]}
    for argument, value in (("state", [0.5, 1]), ("state", ["a", "b"]), ("action", [-1, 0]), ("next_state", [1]),
                            ("reward", [np.nan, 0]), ("terminated", [2, 0]), ("episode", [1e300, 0]), ("timestep", "x"),
                            ("behavior_probability", [1.2, 1])):  # fmt: skip
        record.error(argument, lambda a=argument, v=value: Transitions(**{**columns, a: v}))
    record.error("rows", lambda: log.select([]))
    record.error("n", lambda: log.draw(10**6, seed=0))
    record.error("seed", lambda: log.draw(2, seed=-1))
    record.error("n_states", lambda: log.counts("3", 2))
    record.error("frame", lambda: Transitions.from_frame(pd.DataFrame({"place": [0], "action": [0]})))
    record.error("path", lambda: log.save("log.xlsx"))
    record.error("nowhere.csv", lambda: Transitions.load("nowhere.csv"))
    record.error("nowhere.parquet", lambda: Transitions.open("nowhere.parquet"))
    record.error("n_episodes", lambda: oee.sample_episodes(grid, u, 0, 3, seed=0))
    record.error("horizon", lambda: oee.sample_episodes(grid, u, 1, 0, seed=0))
    record.error("seed", lambda: oee.sample_episodes(grid, u, 1, 1, seed="a"))
    record.error("distribution", lambda: oee.sample_transitions(grid, u, 3, seed=0))
    record.error("log", lambda: oee.Problem(grid, np.zeros((3, 3))))
    record.error("simulator", lambda: oee.Problem(P, log))
    record.error("method", lambda: oee.transition_ratio(log, grid, method="joined"))
    record.error("confidence", lambda: oee.interval(oee.Problem(grid, log), u, confidence=2))


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
