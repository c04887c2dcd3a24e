"""What users run: intervals, estimates, reports, a million states, counts, starts,
small calls; rollouts; the ratio programs.

Peers: DuckDB for the same sums, ``import numpy, scipy.sparse`` for a start, plain numpy
with row sums and ``isfinite`` for small calls, a numba loop for rollouts, cvxpy with
Clarabel for the ratio programs.
"""

import resource
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import mdps
import numpy as np
from numba import njit
from speed import compare, row
from values import form

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment
from oee_tabular.ratio import dual, statements
from oee_tabular.tasks import gridworld, gridworld_expert

MAIN = "from oee_tabular.cli import main; main({!r})"
IMPORTS = "import numpy, scipy.sparse"
HORIZON = 200  # of rollouts


def intervals(most):
    """The likelihood interval from 100 000 transitions of the simulator itself, of a
    policy that is mostly its best.
    """
    cases = {
        "grid 30": (gridworld(30, 0.1), None),
        "random graph 1000": (mdps.garnet(1000), None),
    }
    cases |= {
        "grid 100": (gridworld(100, 0.1), None),
        "random graph 10000": (mdps.garnet(10_000), None),
    }
    cases |= {"grid 45, horizon 500": (gridworld(45, 0.1), 500)}
    for name, (simulator, horizon) in cases.items():
        if simulator.n_states <= most:
            log = mdps.draw_log(simulator, 100_000)
            policy = oee.mix(
                oee.optimal_policy(simulator), oee.uniform_policy(simulator), 0.8
            )
            call = partial(
                oee.interval, oee.Problem(simulator, log, horizon=horizon), policy
            )
            yield from compare("main job", f"interval, {name}", {"ours": call})


def counts(most):
    """Counts of a parquet file and of a tenth of it, ours and DuckDB's sums; 10^9 are
    projected from the slope.
    """
    n = min(10**7, 50 * most)
    simulator = mdps.garnet(1000)
    sums = (
        "state, action, next_state, terminated, count(*), sum(reward), min(reward),"
        " max(reward)"
    )

    def duckdb():
        import duckdb

        connection = duckdb.connect(config={"threads": 1})
        return lambda: connection.sql(
            f"select {sums} from '{files[1]}' group by all"
        ).fetchnumpy()

    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{size}.parquet" for size in (n // 10, n)]
        for file, size in zip(files, (n // 10, n), strict=True):
            mdps.draw_log(simulator, size).save(file)
        ours = {
            name: partial(oee.Transitions.open, file)
            for name, file in zip(("ours, a tenth", "ours"), files)  # noqa: B905
        }
        rows = list(
            compare(
                "main job",
                f"counts of {n} transitions",
                ours,
                {"DuckDB": duckdb},
                seconds=3.0,
            )
        )
    yield from rows
    if rows:
        slope = (rows[1]["seconds"] - rows[0]["seconds"]) / (0.9 * n)
        yield row(
            "main job",
            "counts of 10^9 transitions",
            "ours",
            1e9 * slope,
            note="projected",
        )


def small_calls(most):
    """FiniteMDP and policy_value of four states."""
    n = 4
    actions = 2
    discount = 0.9
    rng = np.random.default_rng(0)
    p = rng.dirichlet(np.ones(n), (n, actions))
    r = rng.normal(size=(n, actions))
    first = np.full(n, 1 / n)
    policy = np.full((n, actions), 1 / actions)
    mdp = oee.FiniteMDP(p, r, first, discount)

    def check():
        if not np.isfinite(p).all() or np.abs(p.sum(axis=2) - 1.0).max() > 1e-8:
            raise ValueError

    def value():
        check()
        system = np.eye(n) - discount * np.einsum("sa,sat->st", policy, p)
        return first @ np.linalg.solve(system, (policy * r).sum(axis=1))

    build = partial(oee.FiniteMDP, p, r, first, discount)
    for name, ours, peer in (
        ("FiniteMDP", build, check),
        (
            "FiniteMDP and policy_value",
            lambda: oee.policy_value(build(), policy),
            value,
        ),
        ("policy_value", lambda: oee.policy_value(mdp, policy), value),
        ("occupancy", lambda: oee.occupancy(mdp, policy), value),
    ):
        name = f"{name}, {n} states"
        yield from compare(
            "small calls",
            name,
            {"ours": ours},
            {"numpy": lambda peer=peer: peer},
            repeat=200,
        )


def start(code):
    """Run ``code`` in a new interpreter, which imports what this one imports: -c looks
    into the folder where it is run.
    """
    folder = Path(oee.__file__).parents[1]
    subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, cwd=folder
    )


def write_files(folder, simulator, log, policy):
    """The arguments of ``oee`` for own files."""
    files = {
        name: str(Path(folder) / name)
        for name in ("simulator.npz", "log.npz", "policy.npy")
    }
    simulator.save(files["simulator.npz"])
    log.save(files["log.npz"])
    np.save(files["policy.npy"], policy)
    return [part for name, file in files.items() for part in (f"--{name[:-4]}", file)]


def starts(most):
    """A new interpreter to the end of a first command."""
    grid = gridworld(10, 0.1)
    target = gridworld(10, 0.25)
    policy = oee.mix(gridworld_expert(10), oee.uniform_policy(grid), 0.7)
    with tempfile.TemporaryDirectory() as folder:
        own = write_files(folder, grid, mdps.draw_log(target, 1000), policy)
        programs = {
            "import oee_tabular": "import oee_tabular",
            "oee --help": f"try:\n {MAIN.format(['--help'])}\nexcept SystemExit: 0",
            "oee evaluate, own files": MAIN.format(["evaluate", *own]),
        }
        imports = {IMPORTS: lambda: partial(start, IMPORTS)}
        for name, code in programs.items():
            yield from compare(
                "start", name, {"ours": partial(start, code)}, imports, seconds=6.0
            )


def millions(most):
    """``oee evaluate --quick`` at 10^6 states with 10^5 transitions, from files."""
    side = 1_000 if most >= 10**6 else 40
    grid = gridworld(side, 0.1)
    graph = mdps.garnet(side**2)
    expert = oee.mix(gridworld_expert(side), oee.uniform_policy(grid), 0.8)
    for name, simulator, target, policy in (
        ("grid", grid, gridworld(side, 0.3), expert),
        ("random graph", graph, graph, oee.uniform_policy(graph)),
    ):
        case = f"evaluate --quick, {name} of {side**2} states"
        with tempfile.TemporaryDirectory() as folder:
            own = write_files(folder, simulator, mdps.draw_log(target, 10**5), policy)
            call = partial(start, MAIN.format(["evaluate", *own, "--quick"]))
            yield from compare("main job", case, {"ours": call}, seconds=0.0)
        size = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
        yield row("main job", case, "most memory so far", np.nan, note=f"{size:.1f} GB")


def small_estimates(most):
    """The default estimate of MDPs of 4 and 30 states from 200 transitions, beside
    maximum likelihood in numpy.
    """
    for n in (4, 30):
        simulator = mdps.garnet(n, entries=4)
        target = mdps.garnet(n, entries=4, seed=0)
        policy = oee.uniform_policy(simulator)
        log = mdps.draw_log(target, 200)
        prior = simulator.transitions.toarray()
        m = simulator.n_actions

        def likelihood(log=log, n=n, m=m, prior=prior, simulator=simulator):
            counts = np.bincount(
                (log.state * m + log.action) * n + log.next_state, minlength=n * m * n
            ).reshape(-1, n)
            sums = counts.sum(axis=1, keepdims=True)
            model = (
                np.where(sums > 0, counts / np.maximum(sums, 1), prior)
                .reshape(n, m, n)
                .mean(axis=1)
            )
            return simulator.initial @ np.linalg.solve(
                np.eye(n) - 0.99 * model, simulator.rewards.mean(axis=1)
            )

        call = partial(OffEnvironment(), oee.Problem(simulator, log), policy)
        peers = {"numpy, maximum likelihood": lambda call=likelihood: call}
        yield from compare(
            "OffEnvironment", f"{n} states", {"ours": call}, peers, repeat=5
        )


def reports(most):
    """A report of several policies, quick and with intervals, and the page of one."""
    n = min(2_500, most)
    simulator = mdps.garnet(n)
    problem = oee.Problem(simulator, mdps.draw_log(simulator, 10 * n))
    best = oee.optimal_policy(simulator)
    mixed = {
        f"policy {k}": oee.mix(best, oee.uniform_policy(simulator), k / 20)
        for k in range(1, 21)
    }
    some = {name: mixed[name] for name in list(mixed)[:5]}
    evaluation = oee.evaluate(problem, mixed["policy 1"], seed=0, quick=True)
    calls = {
        "20 policies, quick": partial(oee.evaluate, problem, mixed, seed=0, quick=True),
        "5 policies": partial(oee.evaluate, problem, some, seed=0),
        "page": evaluation.to_html,
    }
    for name, call in calls.items():
        yield from compare("reports", f"{name}, {n} states", {"ours": call})


# ---- rollouts: seconds for a transition


@njit
def plain_loop(indptr, indices, sums, rewards, discount, terminal, n, horizon, rng):
    """The loop that anybody writes: a linear scan of the running sums of a row, numpy's
    Generator.
    """
    returns = np.zeros(n)
    steps = 0
    for i in range(n):
        state = 0
        scale = 1.0
        for _ in range(horizon):
            u = rng.random()
            k = indptr[state]
            while sums[k] <= u:
                k += 1
            returns[i] += scale * rewards[state]
            scale *= discount
            state = indices[k]
            steps += 1
            if terminal[state]:
                break
    return steps, returns


def rollouts(most):
    """Episodes of 200 steps under the uniform policy; the loop draws s' from the
    policy's chain in place of (a, s').
    """
    for size in (10, 30, 100):
        if size**2 <= most:
            yield from roll_out(
                gridworld(size, 0.3), f"a transition, grid {size}", 20_000
            )


def roll_out(grid, name, n):
    """``error``: the mean return's distance from the exact value in standard errors,
    where a program sums returns.
    """
    policy = oee.uniform_policy(grid)
    chain, rewards = form(grid, policy)
    sums = np.cumsum(chain.data) - np.repeat(
        np.arange(grid.n_states), np.diff(chain.indptr)
    )
    sums[chain.indptr[1:] - 1] = 1.0
    numbers = (
        chain.indptr,
        chain.indices,
        sums,
        rewards,
        grid.discount,
        grid.absorbing(),
        n,
        HORIZON,
    )
    value = oee.policy_value(grid, policy, horizon=HORIZON)

    def returns():
        drawn = oee.sample_returns(grid, policy, n, HORIZON, seed=0)
        return int(drawn.lengths.sum()), drawn.returns

    def miss(result):
        drawn = result[1]
        return (
            np.nan
            if drawn is None
            else abs(drawn.mean() - value) / drawn.std() * np.sqrt(len(drawn))
        )

    ours = {
        "ours, sample_returns": returns,
        "ours, sample_episodes": lambda: (
            len(oee.sample_episodes(grid, policy, n // 4, HORIZON, seed=0)),
            None,
        ),
    }
    loop = {
        "plain numba loop, s' alone": lambda: (
            lambda: plain_loop(*numbers, np.random.default_rng(0))
        )
    }
    yield from compare(
        "rollouts", name, ours, loop, miss=miss, units=lambda result: result[0]
    )


# ---- the ratio programs


def ratio(most):
    """The structured solver against cvxpy + Clarabel; large programs."""
    for size in (10, 20, 40):
        yield from compare_solvers(size)
    yield from solve_large()


def compare_solvers(size, n=100_000):
    """Counts of the target and exact probabilities of the simulator on the gridworld's
    triples.
    """
    simulator = gridworld(size, 0.3)
    target = gridworld(size, 0.1)
    log = oee.sample_episodes(
        target, oee.uniform_policy(target), 20 + n // 400, 1000, seed=0
    )
    probability = simulator.transitions.data
    starts = simulator.transitions.indptr.astype(np.int64)
    lengths = np.diff(starts)
    zero = np.zeros(len(probability))
    rows = np.repeat(np.arange(len(lengths)), lengths)
    observed = np.asarray(
        log.counts(size * size, 4)[rows, simulator.transitions.indices]
    ).reshape(-1)
    n_row = np.bincount(rows, observed)[rows]
    for name, p, q, pointers in (
        (
            "normalised, box",
            observed / observed.sum(),
            probability / len(lengths),
            starts[[0, -1]],
        ),
        ("rows, box", (observed + probability) / (n_row + 1.0), probability, starts),
    ):
        program = dual.Coordinates(p, q, zero, zero), 0.01, 10.0, pointers
        clarabel = {
            "cvxpy, Clarabel": lambda program=program: partial(
                statements.solve_rows, *program
            )
        }
        name = f"{size} x {size}, {len(rows)} triples, {name}"
        yield from compare(
            "ratio", name, {"ours": partial(dual.solve_rows, *program)}, clarabel
        )


def fit_cells(most):
    """Large programs beside ``numpy.log(p / q)``."""
    rng = np.random.default_rng(0)
    n = 10**6
    p = rng.integers(1, 6, n).astype(float)
    q = rng.integers(1, 5, n).astype(float)
    once = {"numpy.log(p / q)": lambda: lambda: np.log(p / q)}
    for options in (
        {},
        {"lower": 0.1, "upper": 2.0},
        {"ridge": 0.1},
        {"ridge": 0.1, "toward": 1.0, "upper": 5.0},
    ):
        fit = partial(oee.density_ratio, p, q, **options)
        yield from compare(
            "density_ratio", f"{n} cells, {options}", {"ours": fit}, once
        )


def solve_large():
    """10^7 triples, normalised by rows, in memory."""
    rng = np.random.default_rng(0)
    x, y = (rng.dirichlet(np.ones(4), 10**7 // 4).reshape(-1) for _ in range(2))
    program = (
        dual.Coordinates(x, y, *np.zeros((2, 10**7))),
        0.01,
        10.0,
        np.arange(0, 10**7 + 1, 4),
    )
    yield from compare(
        "ratio", "10^7 triples, rows, box", {"ours": partial(dual.solve_rows, *program)}
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    yield row(
        "ratio",
        "10^7 triples, rows, box",
        "peak memory",
        np.nan,
        note=f"{peak:.2f} GiB",
    )
