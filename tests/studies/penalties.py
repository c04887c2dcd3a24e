"""lambda_n and I(g): what the paper's ridge and its alternatives do to zeta, swept. Run by hand.

    python tests/studies/penalties.py              writes tests/studies/penalties.csv and prints the best of each

10 x 10 grid, slip 0.3 simulated, 0.1 real; n moves of the uniform policy; ten repetitions. The strength is c, the number of
moves that the penalty is worth: lambda_n = c / n_sa in a row (c / n for the quotient's two programs). I(g)^2 is

    sum g^2            the paper's, unweighted, towards 0
    sum P g^2          weighted by the simulator: with rows that sum to 1 the same program as the next
    sum P (g - 1)^2    towards the simulator
    -2 sum P log g     the Dirichlet prior on the simulator, in the place of a square
    quotient, sum g^2  the paper's estimator: two programs, box [0.01, 10]

Error: mean over (s, a, s') of |zeta_hat - zeta|, the goal left out, and |J - J_target| of the expert at delta = 0.5.
"""

from pathlib import Path

import numpy as np
import pandas as pd

import oee_tabular as oee

STRENGTHS = (0.0, 0.01, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)
SAMPLES = (1000, 10_000, 100_000)
REPETITIONS = 10
TABLE = Path(__file__).with_name("penalties.csv")


def options(penalty, c):
    """Arguments of ``transition_ratio``."""
    if penalty == "-2 sum P log g":
        return {"prior": "simulator", "strength": c}

    def ridge(n):
        return c / n

    if penalty == "quotient, sum g^2":
        return {"method": "ratio_of_ratios", "simulator_data": "exact", "ridge": ridge, "toward": None}
    toward = {"sum g^2": None, "sum P g^2": 0.0, "sum P (g - 1)^2": 1.0}[penalty]
    return {"prior": "none", "ridge": ridge, "toward": toward}


PENALTIES = ("sum g^2", "sum P g^2", "sum P (g - 1)^2", "-2 sum P log g", "quotient, sum g^2")


def errors(n, repetition, cases):
    """(cases, 2) errors of zeta and of J."""
    simulator, target = oee.tasks.gridworld(10, 0.3), oee.tasks.gridworld(10, 0.1)
    truth = oee.true_ratio(target, simulator).values.data
    policy = oee.mix(oee.tasks.gridworld_expert(10), oee.uniform_policy(simulator), 0.5)
    value = oee.policy_value(target, policy, horizon=200)
    live = np.repeat(np.arange(400), np.diff(simulator.transitions.indptr)) // 4 != 99
    generator = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(n, repetition)))
    log = oee.sample_episodes(target, oee.uniform_policy(target), 40 + n // 200, 1000, seed=generator).draw(
        n, seed=generator
    )
    problem = oee.Problem(simulator, log, horizon=200, behavior_policy=oee.uniform_policy(simulator))
    found = []
    for penalty, c in cases:
        zeta = oee.transition_ratio(log, simulator, **options(penalty, c))
        estimate = oee.estimators.OffEnvironment(ratio=zeta)(problem, policy)
        found.append((np.abs(zeta.values.data - truth)[live].mean(), abs(estimate.value - value)))
    return np.array(found)


def study():
    """One row for each sample size, penalty and strength."""
    cases = [(penalty, c) for penalty in PENALTIES for c in STRENGTHS]
    rows = []
    for n in SAMPLES:
        table = np.array([errors(n, repetition, cases) for repetition in range(REPETITIONS)])
        for (penalty, c), mean, middle in zip(cases, table.mean(axis=0), np.median(table, axis=0), strict=True):
            rows.append(
                {"n": n, "penalty": penalty, "moves": c, "zeta_error": mean[0], "median_value_error": middle[1]}
            )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    found = study()
    found.to_csv(TABLE, index=False, float_format="%.4g")
    print(found.loc[found.groupby(["n", "penalty"])["zeta_error"].idxmin()].to_string(index=False))
