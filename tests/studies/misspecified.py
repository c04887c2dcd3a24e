"""A target that the tilt cannot express: RMSE of J against sample size. Run by hand.

    python tests/studies/misspecified.py           writes tests/studies/misspecified.csv and prints it

20 x 20 grid, simulated slip 0.3; real slip 0.1 on the left half (columns below 10) and 0.5 on the right. Policies delta =
0.1, 0.5, 0.9; T = 200, values times (1 - discount); uniform data, n moves drawn from episodes of at most 1000 steps; 20 logs.
``exact`` is ``Estimate.value`` of OffEnvironment(), ``one_step`` the value beside it, ``model_based`` maximum likelihood.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy import sparse

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment, Problem

SIZE, HORIZON, REPETITIONS = 20, 200, 20
SAMPLES = [round(10**e) for e in (3, 3.5, 4, 4.5, 5, 5.5)]
TABLE = Path(__file__).with_name("misspecified.csv")


def pair():
    """The simulator and a target whose slip depends on the column."""
    simulator, less, more = (oee.tasks.gridworld(SIZE, slip) for slip in (0.3, 0.1, 0.5))
    left = np.repeat(np.arange(SIZE * SIZE) % SIZE < SIZE // 2, 4).astype(float)
    mixed = sparse.diags_array(left) @ less.transitions + sparse.diags_array(1 - left) @ more.transitions
    return simulator, simulator.with_transitions(sparse.csr_array(mixed))


def errors(delta, n, repetitions, *, seed=0):
    """(repetitions, 4): errors of the exact, the one-step and the model-based value, and whether the report warns."""
    simulator, target = pair()
    policy = oee.tasks.gridworld_policy(SIZE, delta)
    truth = oee.policy_value(target, policy, horizon=HORIZON)
    found = []
    for repetition in range(repetitions):
        generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n, repetition)))
        pool = oee.sample_episodes(target, oee.uniform_policy(target), 40 + n // 300, 1000, seed=generator)
        problem = Problem(simulator, pool.draw(n, seed=generator), horizon=HORIZON)
        estimate = OffEnvironment()(problem, policy)
        facts = estimate.diagnostics
        values = np.array([estimate.value, facts["one_step_value"], ModelBased()(problem, policy).value])
        found.append([*(0.01 * (values - truth)), "does not fit" in facts["meaning"]])
    return np.array(found, dtype=float)


def study():
    """One row for each policy and sample size."""
    rows = []
    for delta in (0.1, 0.5, 0.9):
        for n in SAMPLES:
            e = errors(delta, n, REPETITIONS)
            exact, one_step, model_based, told = np.sqrt(np.mean(e**2, axis=0))
            rows.append({"policy": f"delta={delta:g}", "n": n, "exact": exact, "one_step": one_step,
                         "model_based": model_based, "says_it_does_not_fit": told**2, "repetitions": len(e)})  # fmt: skip
            print(rows[-1], flush=True)
    return pd.DataFrame(rows)


if __name__ == "__main__":
    study().to_csv(TABLE, index=False, float_format="%.6g")
