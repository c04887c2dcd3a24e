"""The main job: ``evaluate`` by states and by transitions, likelihood intervals, counts, starts, calls on a few states.

Growth is the slope of log CPU seconds against log size from the first to the last size, printed with the last one;
``evaluate`` is --quick's, with 10 transitions for each state-action pair. Peers: DuckDB for the same sums, ``import
numpy, scipy.sparse`` for a start, plain numpy with row sums and ``isfinite`` for small calls.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import mdps
import numpy as np
from common import cpu, interleaved, per_call, row, rows_of

import oee_tabular as oee

MAIN = "from oee_tabular.cli import main; main({!r})"
IMPORTS = "import numpy, scipy.sparse"


def make_problem(simulator, n, horizon=None):
    """Transitions of the simulator itself from any pair, and a policy that is mostly its best."""
    share = np.full(simulator.rewards.shape, 1 / simulator.rewards.size)
    log = oee.sample_transitions(simulator, share, n, seed=0)
    policy = oee.mix(oee.optimal_policy(simulator), oee.uniform_policy(simulator), 0.8)
    return oee.Problem(simulator, log, horizon=horizon), policy


def least(call, times):
    """Smallest CPU seconds of several calls, after a warm one."""
    call()
    return min(cpu(call)[1] for _ in range(times))


def growing(case, simulators, sizes, transitions):
    """``evaluate(quick=True)`` of each simulator with so many transitions, the last row with the growth exponent."""
    seconds = []
    for simulator, size, n in zip(simulators, sizes, transitions, strict=True):
        problem, policy = make_problem(simulator, n)
        seconds.append(least(lambda p=problem, pi=policy: oee.evaluate(p, pi, seed=0, quick=True), 1))
        slope = np.log(seconds[-1] / seconds[0]) / np.log(size / sizes[0]) if len(seconds) > 1 else np.nan
        yield row("main job", f"{case} {size}", "ours", seconds[-1], note=f"grows like size^{slope:.2f}")


def intervals(quick):
    """The likelihood interval from 100 000 transitions."""
    cases = {"grid 30": (oee.tasks.gridworld(30, 0.1), None), "random graph 1000": (mdps.garnet(1000), None)}
    if not quick:
        cases |= {"grid 100": (oee.tasks.gridworld(100, 0.1), None), "random graph 10000": (mdps.garnet(10_000), None)}
        cases |= {"grid 45, horizon 500": (oee.tasks.gridworld(45, 0.1), 500)}
    for case, (simulator, horizon) in cases.items():
        problem, policy = make_problem(simulator, 100_000, horizon)
        seconds = least(lambda p=problem, pi=policy: oee.interval(p, pi), 2)
        yield row("main job", f"interval, {case}", "ours", seconds)


def counts(n):
    """Counts of a parquet file and of a tenth of it, ours and DuckDB's sums; 10^9 are projected from the slope."""
    simulator = mdps.garnet(1000)
    share = np.full(simulator.rewards.shape, 1 / simulator.rewards.size)
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{size}.parquet" for size in (n // 10, n)]
        for file, size in zip(files, (n // 10, n), strict=True):
            oee.sample_transitions(simulator, share, size, seed=0).save(file)
        calls = {
            "ours": lambda: oee.Transitions.open(files[1]),
            "ours, a tenth": lambda: oee.Transitions.open(files[0]),
        }
        try:
            import duckdb

            sums = "state, action, next_state, terminated, count(*), sum(reward), min(reward), max(reward)"
            connection = duckdb.connect(config={"threads": 1})
            calls["DuckDB"] = lambda: connection.sql(f"select {sums} from '{files[1]}' group by all").fetchnumpy()
        except ImportError:
            pass
        timed = interleaved(calls, 3.0)
    yield from rows_of("main job", f"counts of {n} transitions", timed)
    slope = (timed["ours"][0] - timed["ours, a tenth"][0]) / (0.9 * n)
    yield row("main job", "counts of 10^9 transitions", "ours", 1e9 * slope, note="projected")


def start(code):
    """User and system seconds of a child that runs ``code``."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def write_files(folder, simulator, log, policy):
    """The arguments of ``oee`` for own files."""
    files = {name: str(Path(folder) / f"{name}.npz") for name in ("simulator", "log")}
    simulator.save(files["simulator"])
    log.save(files["log"])
    files["policy"] = str(Path(folder) / "policy.npy")
    np.save(files["policy"], policy)
    return [part for name, file in files.items() for part in (f"--{name}", file)]


def starts(quick):
    """A new interpreter to the end of a first command; the smallest of several, in turns."""
    grid = oee.tasks.gridworld(10, 0.1)
    policy = oee.mix(oee.tasks.gridworld_expert(10), oee.uniform_policy(grid), 0.7)
    with tempfile.TemporaryDirectory() as folder:
        log = oee.sample_episodes(oee.tasks.gridworld(10, 0.25), policy, 20, 50, seed=1)
        own = write_files(folder, grid, log, policy)
        programs = {
            "import oee_tabular": "import oee_tabular",
            "oee --help": f"try:\n {MAIN.format(['--help'])}\nexcept SystemExit: 0",
        }
        programs |= {"oee evaluate, own files": MAIN.format(["evaluate", *own]), IMPORTS: IMPORTS}
        times = {name: min(start(code) for _ in range(3 if quick else 9)) for name, code in programs.items()}
    for name, seconds in times.items():
        yield row("start", name, "ours", seconds)
        yield row("start", name, IMPORTS, times[IMPORTS])


def millions():
    """``oee evaluate --quick`` at 10^6 states with 10^5 transitions, from files; the most memory so far."""
    grid, slippery, graph = oee.tasks.gridworld(1000, 0.1), oee.tasks.gridworld(1000, 0.3), mdps.garnet(10**6)
    expert = oee.mix(oee.tasks.gridworld_expert(1000), oee.uniform_policy(grid), 0.8)
    cases = {"grid": (grid, slippery, expert), "random graph": (graph, graph, oee.uniform_policy(graph))}
    for name, (simulator, target, policy) in cases.items():
        with tempfile.TemporaryDirectory() as folder:
            share = np.full(simulator.rewards.shape, 1 / simulator.rewards.size)
            own = write_files(folder, simulator, oee.sample_transitions(target, share, 10**5, seed=0), policy)
            seconds = min(start(MAIN.format(["evaluate", *own, "--quick"])) for _ in range(2))
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
        yield row("main job", f"evaluate --quick, {name} of 1000000", "ours", seconds, note=f"at most {most:.2f} GB")


def small_calls(n=4, discount=0.9):
    """An MDP of 4 states beside numpy."""
    rng = np.random.default_rng(0)
    p, r, policy, first = rng.dirichlet(np.ones(n), (n, 2)), rng.random((n, 2)), np.full((n, 2), 0.5), np.full(n, 1 / n)
    mdp = oee.FiniteMDP(p, r, first, discount)

    def check():
        if not np.isfinite(p).all() or np.abs(p.sum(axis=2) - 1.0).max() > 1e-8:
            raise ValueError

    def value():
        check()
        system = np.eye(n) - discount * np.einsum("sa,sat->st", policy, p)
        return first @ np.linalg.solve(system, (policy * r).sum(axis=1))

    build = lambda: oee.FiniteMDP(p, r, first, discount)  # noqa: E731
    for case, ours, peer in (
        ("FiniteMDP", build, check),
        ("FiniteMDP and policy_value", lambda: oee.policy_value(build(), policy), value),
        ("policy_value", lambda: oee.policy_value(mdp, policy), value),
    ):
        calls = {name: per_call(call, 200) for name, call in {"ours": ours, "numpy": peer}.items()}
        yield from rows_of("small calls", f"{case}, {n} states", interleaved(calls), scale=200)


def rows(*, quick):
    """The table's rows."""
    sizes = (1000, 10_000) if quick else (1000, 10_000, 100_000)
    graphs = (mdps.garnet(n) for n in sizes)
    yield from growing("evaluate, random graph of", graphs, sizes, [40 * n for n in sizes])
    sides = (32, 100) if quick else (32, 100, 316)
    areas, grids = [side**2 for side in sides], (oee.tasks.gridworld(side, 0.1) for side in sides)
    yield from growing("evaluate, grid of", grids, areas, [40 * n for n in areas])
    transitions = (10_000, 100_000) if quick else (10_000, 100_000, 1_000_000, 10_000_000)
    yield from growing("evaluate, transitions", [mdps.garnet(1000)] * len(transitions), transitions, transitions)
    yield from intervals(quick)
    yield from counts(10**5 if quick else 10**7)
    yield from small_calls()
    yield from starts(quick)
    if not quick:
        yield from millions()
