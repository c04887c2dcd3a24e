"""The main job: ``evaluate`` by states and by moves, the likelihood interval, counts from a file, the first start.

Growth is the slope of log CPU seconds against log size from the first to the last size, printed with the last one; ``evaluate``
is --quick's, with 10 moves for each row of the simulator. There is no peer but for the counts (DuckDB: the same sums).
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from common import cpu, row
from scipy import sparse

import oee_tabular as oee

FIRST = "from oee_tabular.cli import main; main({!r})"


def random_graph(n_states, *, n_actions=4, n_next=5, seed=0):
    """A random MDP: each row leads to ``n_next`` states, with Dirichlet(1) probabilities."""
    rng = np.random.default_rng(seed)
    following = rng.integers(n_states, size=(n_states * n_actions, n_next))
    entries = rng.dirichlet(np.ones(n_next), n_states * n_actions).reshape(-1), following.reshape(-1)
    indptr = np.arange(0, following.size + 1, n_next)
    moves = sparse.csr_array((*entries, indptr), shape=(n_states * n_actions, n_states))
    moves.sum_duplicates()
    rewards = rng.normal(size=(n_states, n_actions))
    return oee.FiniteMDP(moves, rewards, np.full(n_states, 1 / n_states), 0.99)


def problem_of(simulator, n_moves, horizon=None):
    """Moves of the simulator itself from any row, and a policy that is mostly its best."""
    share = np.full(simulator.rewards.shape, 1 / simulator.rewards.size)
    log = oee.sample_transitions(simulator, share, n_moves, seed=0)
    policy = oee.mix(oee.optimal_policy(simulator), oee.uniform_policy(simulator), 0.8)
    return oee.Problem(simulator, log, horizon=horizon), policy


def least(call, times):
    """Smallest CPU seconds of several calls, after a warm one."""
    call()
    return min(cpu(call)[1] for _ in range(times))


def growing(case, sizes, timed):
    """Rows of the sizes, the last with the growth exponent."""
    seconds = []
    for size in sizes:
        seconds.append(timed(size))
        slope = np.log(seconds[-1] / seconds[0]) / np.log(size / sizes[0]) if len(seconds) > 1 else np.nan
        note = f"grows like size^{slope:.2f}" if size == sizes[-1] else ""
        yield row("main job", f"{case} {size}", "ours", seconds[-1], note=note)


def evaluated(simulator, n_moves, times):
    """Seconds of ``evaluate(quick=True)`` with the default estimators."""
    problem, policy = problem_of(simulator, n_moves)
    return least(lambda: oee.evaluate(problem, policy, seed=0, quick=True), times)


def interval_rows(quick):
    """The likelihood interval."""
    cases = {"grid 30": (oee.tasks.gridworld(30, 0.1), None), "random graph 1000": (random_graph(1000), None)}
    if not quick:
        cases |= {
            "grid 100": (oee.tasks.gridworld(100, 0.1), None),
            "random graph 10000": (random_graph(10_000), None),
            "grid 45, horizon 500": (oee.tasks.gridworld(45, 0.1), 500),
        }
    for case, (simulator, horizon) in cases.items():
        problem, policy = problem_of(simulator, 100_000, horizon)
        seconds = least(lambda problem=problem, policy=policy: oee.interval(problem, policy), 2)
        value = least(lambda s=simulator, p=policy, h=horizon: oee.state_values(s, p, horizon=h), 5)
        yield row("main job", f"interval, {case}", "ours", seconds, note=f"{seconds / value:.0f} value solves")


def counted_rows(n_moves):
    """Counts of a parquet file, ours and DuckDB's."""
    simulator = random_graph(1000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        share = np.full(simulator.rewards.shape, 1 / simulator.rewards.size)
        oee.sample_transitions(simulator, share, n_moves, seed=0).save(path)
        case = f"counts of {n_moves} moves"
        yield row("main job", case, "ours", least(lambda: oee.Transitions.open(path), 3))
        try:
            import duckdb
        except ImportError:
            return
        sums = (
            "select state, action, next_state, terminated, count(*), sum(reward), min(reward), max(reward), "
            f"count(*) filter (truncated) from '{path}' group by all"
        )
        with duckdb.connect(config={"threads": 1}) as connection:
            yield row("main job", case, "DuckDB", least(lambda: connection.sql(sums).fetchnumpy(), 3))


def started(arguments, cache):
    """User and system seconds of ``oee`` in a new process; modules are kept as byte code, as pip leaves them."""
    import resource

    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-c", FIRST.format(arguments)]
    subprocess.run(command, check=True, capture_output=True, env=kept | {"NUMBA_CACHE_DIR": cache})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def started_rows():
    """``oee evaluate`` with an empty cache of compiled code, and the second time."""
    simulator = oee.tasks.gridworld(10, 0.1)
    policy = oee.mix(oee.tasks.gridworld_expert(10), oee.uniform_policy(simulator), 0.7)
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / name) for name in ("simulator.npz", "log.csv", "policy.npy")]
        simulator.save(files[0])
        oee.sample_episodes(oee.tasks.gridworld(10, 0.25), policy, 20, 50, seed=1).save(files[1])
        np.save(files[2], policy)
        own = [part for pair in zip(("--simulator", "--log", "--policy"), files, strict=True) for part in pair]
        for case, arguments in (("own files", ["evaluate", *own]), ("no arguments", ["evaluate"])):
            with tempfile.TemporaryDirectory() as cache:
                for time in ("first", "second"):
                    yield row("main job", f"{time} start, {case}", "ours", started(arguments, cache))


def million_rows():
    """``oee evaluate --quick`` at 10^6 states with 10^5 moves, from files, kernels compiled; the most memory so far."""
    grid, slippery = oee.tasks.gridworld(1000, 0.1), oee.tasks.gridworld(1000, 0.3)
    likely = oee.mix(oee.tasks.gridworld_expert(1000), oee.uniform_policy(grid), 0.8)
    graph = random_graph(10**6)
    for name, simulator, target, policy in (
        ("grid", grid, slippery, likely),
        ("random graph", graph, graph, oee.uniform_policy(graph)),
    ):
        with tempfile.TemporaryDirectory() as folder:
            files = [str(Path(folder) / file) for file in ("simulator.npz", "log.npz", "policy.npy")]
            simulator.save(files[0])
            share = np.full(simulator.rewards.shape, 1 / simulator.rewards.size)
            oee.sample_transitions(target, share, 10**5, seed=0).save(files[1])
            np.save(files[2], policy)
            own = [part for pair in zip(("--simulator", "--log", "--policy"), files, strict=True) for part in pair]
            with tempfile.TemporaryDirectory() as cache:
                seconds = min(started(["evaluate", *own, "--quick"], cache) for _ in range(2))
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9
        yield row("main job", f"evaluate --quick, {name} of 1000000", "ours", seconds, note=f"at most {most:.2f} GB")


def rows(*, quick):
    """The table's rows."""
    most, times = (10_000, 2) if quick else (100_000, 1)
    sizes = [size for size in (1000, 10_000, 100_000) if size <= most]
    yield from growing("evaluate, random graph of", sizes, lambda n: evaluated(random_graph(n), 40 * n, times))
    sides = [side for side in (32, 100, 316) if side**2 <= most]
    widths = [side**2 for side in sides]
    by_states = dict(zip(widths, sides, strict=True))
    yield from growing(
        "evaluate, grid of", widths, lambda n: evaluated(oee.tasks.gridworld(by_states[n], 0.1), 40 * n, times)
    )
    moves = (10_000, 100_000) if quick else (10_000, 100_000, 1_000_000, 10_000_000)
    graph = random_graph(1000)
    yield from growing("evaluate, random graph of 1000, moves", moves, lambda n: evaluated(graph, n, times))
    yield from interval_rows(quick)
    yield from counted_rows(10**5 if quick else 10**7)
    if not quick:
        yield from million_rows()
    yield from started_rows()
