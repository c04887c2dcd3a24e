"""Figure 1a of the paper: mean absolute error of zeta against sample size, grids of 10, 20 and 40. Run by hand.

    python tests/studies/figure_1a.py              writes tests/studies/figure_1a.csv and prints it

Slip 0.3 simulated, 0.1 real; n moves drawn without replacement from episodes of at most 1000 steps of the uniform policy;
ten repetitions with different seeds. Error: mean over all (s, a, s') in the simulator's support, the goal left out. Four
estimators: the default (no feature that knows the answer: log P), the Dirichlet prior on the simulator, maximum
likelihood (plain tabular), and the paper's quotient of two ratios. ``paper`` is the published curve of its networks (the
20 x 20 one is not at hand).
"""

from pathlib import Path

import numpy as np
import pandas as pd

import oee_tabular as oee

SIZES = (10, 20, 40)
SAMPLES = [round(10**e) for e in (3, 3.5, 4, 4.5, 5, 5.5)]
REPETITIONS = 10
TABLE = Path(__file__).with_name("figure_1a.csv")
ESTIMATORS = {
    "default": {},
    "simulator prior": {"prior": "simulator"},
    "maximum likelihood": {"prior": "none"},
    "ratio of ratios": {"method": "ratio_of_ratios"},
}
PAPER = {
    10: (0.566375, 0.445997, 0.259236, 0.143154, 0.0813596, 0.0476062),
    40: (0.568231, 0.555178, 0.472510, 0.265949, 0.142132, 0.0715477),
}


def mean_errors(size, n, repetitions, names=tuple(ESTIMATORS), *, seed=0):
    """(repetitions, estimators) mean |zeta_hat - zeta|."""
    simulator, target = oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)
    truth = oee.true_ratio(target, simulator).values.data
    live = np.repeat(np.arange(4 * size * size), np.diff(simulator.transitions.indptr)) // 4 != size * size - 1
    found = []
    for repetition in range(repetitions):
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(size, n, repetition)))
        pool = oee.sample_episodes(target, oee.uniform_policy(target), 40 + n // 200, 1000, seed=generator)
        log = pool.draw(n, seed=generator)
        row = []
        for name in names:
            options = ESTIMATORS[name] | ({"seed": generator} if name == "ratio of ratios" else {})
            zeta = oee.transition_ratio(log, simulator, **options)
            row.append(np.abs(zeta.values.data - truth)[live].mean())
        found.append(row)
    return np.array(found)


def study():
    """One row for each grid, sample size and estimator."""
    rows = []
    for size in SIZES:
        for k, n in enumerate(SAMPLES):
            errors = mean_errors(size, n, REPETITIONS)
            for name, column in zip(ESTIMATORS, errors.T, strict=True):
                paper = PAPER[size][k] if size in PAPER else np.nan
                rows.append({"grid": size, "n": n, "estimator": name, "mean": column.mean(), "sd": column.std(ddof=1),
                             "repetitions": len(column), "paper": paper})  # fmt: skip
            print(size, n, errors.mean(axis=0).round(4), flush=True)
    return pd.DataFrame(rows)


if __name__ == "__main__":
    study().to_csv(TABLE, index=False, float_format="%.6g")
