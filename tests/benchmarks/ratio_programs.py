"""Benchmarks of the ratio programs: run by hand, printed as tables.

    python tests/benchmarks/ratio_programs.py random [N]   N (20 000) random problems: largest gap / scale, failures
    python tests/benchmarks/ratio_programs.py speed        structured solver against cvxpy + Clarabel, one process
    python tests/benchmarks/ratio_programs.py large        1e6 and 1e7 triples: time against numpy.log, peak memory

Times are the process's CPU time, medians; the compiled kernels are warm. Clarabel runs at the tightest tolerance that it
reaches.
"""

import resource
import sys

import numpy as np
from common import cpu

import oee_tabular as oee
from oee_tabular.ratio import dual, statements


def clock(call, repeat=5):
    """Median CPU seconds."""
    return float(np.median([cpu(call)[1] for _ in range(repeat)]))


def random_problem(rng):
    """Scales 1e-6 to 1e6, zeros on both sides, boxes 1e-4 to 1e4, ridges of all sizes towards 0, 1 and 2."""
    n = int(rng.integers(1, 60))
    p = rng.integers(0, 4, n) * 10 ** rng.uniform(-6, 6, n)
    q = rng.integers(0, 4, n) * 10 ** rng.uniform(-6, 6, n)
    options = {
        "lower": 10 ** rng.uniform(-4, 0) if rng.random() < 0.7 else None,
        "upper": 10 ** rng.uniform(0, 4),
        "ridge": float(rng.choice([0.0, 10 ** rng.uniform(-8, 4)])),
        "toward": [None, 0.0, 1.0, 2.0][int(rng.integers(4))],
        "normalized": bool(rng.random() < 0.8),
        "loss": "kl" if rng.random() < 0.8 else "chi2",
    }
    return p, q, options


def random(n=20_000):
    """Solve n random problems; the scale of a problem is max(1, |objective|, |multiplier|), the terms of its dual value."""
    rng = np.random.default_rng(0)
    worst, missed, solved, failed = 0.0, 0.0, 0, 0
    for _ in range(n):
        p, q, options = random_problem(rng)
        if p.sum() == 0 or q.sum() == 0:
            continue
        try:
            fit = oee.density_ratio(p, q, **options)
        except ValueError as error:
            failed += 1
            print(error)
            continue
        solved += 1
        scale = max(1.0, abs(fit.objective), abs(fit.normalizer))
        worst = max(worst, fit.gap / scale)
        if options["normalized"]:
            missed = max(missed, abs(q / q.sum() @ fit.ratio - 1.0))
    print(
        f"{solved} problems solved, {failed} failed; largest gap / scale {worst:.1e}, largest |sum q g - 1| {missed:.1e}"
    )
    return worst, missed, failed


def grid_problem(size, n=100_000):
    """Counts of the target and exact probabilities of the simulator on the gridworld's triples."""
    simulator, target = oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)
    rows = np.repeat(np.arange(4 * size * size), np.diff(simulator.transitions.indptr))
    log = oee.sample_episodes(target, oee.uniform_policy(target), 20 + n // 400, 1000, seed=0)
    counts = log.counts(size * size, 4)
    observed = np.asarray(counts[rows, simulator.transitions.indices]).reshape(-1)
    return observed, simulator.transitions.data, simulator.transitions.indptr.astype(np.int64)


def speed():
    """The same programs by both solvers."""
    print("| grid | triples | program | structured (s) | Clarabel (s) | times faster |")
    print("|---|---|---|---|---|---|")
    for size in (10, 20, 40):
        observed, probability, indptr = grid_problem(size)
        n_row = np.add.reduceat(observed, indptr[:-1])
        weights = np.repeat(n_row + 1.0, np.diff(indptr))
        p, q = (
            (observed + probability) / weights,
            probability / np.repeat(np.add.reduceat(probability, indptr[:-1]), np.diff(indptr)),
        )
        whole = np.array([0, len(p)])
        zero = np.zeros(len(p))
        for name, program, rows in (
            ("normalised, box", dual.Coordinates(observed / observed.sum(), q / q.sum(), zero, zero), whole),
            ("rows, box", dual.Coordinates(p, q, zero, zero), indptr),
        ):
            ours = clock(lambda program=program, rows=rows: dual.solve_rows(program, 0.01, 10.0, rows))
            theirs = clock(
                lambda program=program, rows=rows: statements.solve_rows(program, 0.01, 10.0, rows), repeat=1
            )
            print(
                f"| {size} x {size} | {len(p)} | {name} | {ours:.2e} | {theirs:.2f} | {theirs / ours:.0f} |", flush=True
            )


def large():
    """1e6 cells in passes of numpy.log; 1e7 triples, normalised by rows, in memory."""
    rng = np.random.default_rng(0)
    p, q = rng.integers(0, 5, 10**6).astype(float), rng.integers(1, 5, 10**6).astype(float)
    once = clock(lambda: np.log((p + 1.0) / q), repeat=9)
    for options in ({}, {"lower": 0.1, "upper": 2.0}, {"ridge": 0.1}, {"ridge": 0.1, "toward": 1.0, "upper": 5.0}):
        ours = clock(lambda options=options: oee.density_ratio(p + 1.0, q, **options))
        print(f"density_ratio of 1e6 cells, {options}: {ours / once:.0f} passes of numpy.log(p / q)")
    p, q = rng.integers(1, 5, (10**7 // 4, 4)).astype(float), rng.integers(1, 5, (10**7 // 4, 4)).astype(float)
    p, q = ((x / x.sum(axis=1, keepdims=True)).reshape(-1) for x in (p, q))
    program, rows = dual.Coordinates(p, q, *np.zeros((2, 10**7))), np.arange(0, 10**7 + 1, 4)
    ours = clock(lambda: dual.solve_rows(program, 0.01, 10.0, rows), repeat=1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"1e7 triples, rows, box: {ours:.2f} s, peak memory of the process {peak:.2f} GiB")


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "random"
    if what == "random":
        random(*(int(word) for word in sys.argv[2:]))
    else:
        {"speed": speed, "large": large}[what]()
