"""Does OEE's exact value converge to the truth at the rate n^-1/2? A study with a saved table; run by hand.

    python tests/studies/convergence.py            writes tests/studies/convergence.csv and prints the slopes

10 x 10 grid, slip 0.3 simulated, 0.1 real, T = 200, values times (1 - discount). Logs: the first n moves of episodes of at
most 1000 steps, made in the target by the uniform policy (where the true (s, a) ratio between simulator and target is 1)
and by pi_0.5 (where it is not). For each n, REPETITIONS logs; the error is J_hat - J. The ratios: maximum likelihood
(prior "none"), shrinkage to the simulator with strength 1, and the default (shrinkage to the tilt by evidence), which is
far more accurate as long as the tilt is as good as the data, and joins the others after that: its slope is flatter. The
slope is the least-squares slope of log10 RMSE on log10 n from n = 3 10^4 on. Where the data policy hardly visits what the
evaluated policy needs (data by pi_0.5, evaluated pi_0.1), n = 10^6 is not yet large: the slope is shallower there.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment, Problem

SIZES = [round(10**e) for e in (3, 3.5, 4, 4.5, 5, 5.5, 6)]
REPETITIONS = 40
HORIZON = 200
TABLE = Path(__file__).with_name("convergence.csv")


def first_moves(target, behavior, n, stream):
    """The first n moves of episodes of at most 1000 steps."""
    generator = np.random.default_rng(stream)
    pilot = oee.sample_episodes(target, behavior, 50, 1000, seed=generator)
    needed = 20 + round(1.2 * n / (len(pilot) / 50))
    while len(log := oee.sample_episodes(target, behavior, needed, 1000, seed=generator)) < n:
        needed *= 2
    return log.first(n)


RATIOS = {
    "none": partial(oee.transition_ratio, prior="none"),
    "simulator, 1": partial(oee.transition_ratio, prior="simulator", strength=1.0),
    "default": oee.transition_ratio,
}


def errors(behavior_delta, delta, n, repetitions, *, seed=0, ratio="none"):
    """J_hat - J over independent logs (the same for every ratio)."""
    simulator, target = oee.tasks.gridworld(10, 0.3), oee.tasks.gridworld(10, 0.1)
    behavior, policy = oee.tasks.gridworld_policy(10, behavior_delta), oee.tasks.gridworld_policy(10, delta)
    truth = oee.policy_value(target, policy, horizon=HORIZON, normalized=True)
    found = []
    for repetition in range(repetitions):
        stream = np.random.SeedSequence(seed, spawn_key=(round(10 * behavior_delta), n, repetition))
        problem = Problem(simulator, first_moves(target, behavior, n, stream), horizon=HORIZON)
        found.append(0.01 * OffEnvironment(RATIOS[ratio])(problem, policy).value - truth)
    return np.array(found)


def study():
    """One row for each ratio, data policy, evaluated policy and n."""
    rows = []
    for behavior_delta in (0.0, 0.5):
        for delta in (0.1, 0.5, 0.9):
            for n in SIZES:
                for ratio in RATIOS:
                    e = errors(behavior_delta, delta, n, REPETITIONS, ratio=ratio)
                    rows.append(
                        {
                            "ratio": ratio,
                            "data_policy": "uniform" if behavior_delta == 0.0 else f"delta={behavior_delta:g}",
                            "policy": f"delta={delta:g}",
                            "n": n,
                            "repetitions": len(e),
                            "bias": e.mean(),
                            "sd": e.std(ddof=1),
                            "rmse": np.sqrt(np.mean(e**2)),
                        }
                    )
                    print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def slopes(table, start=30_000):
    """Least-squares slope of log10 RMSE on log10 n, for each ratio, data policy and policy."""
    late = table[table["n"] >= start]
    return late.groupby(["ratio", "data_policy", "policy"])[["n", "rmse"]].apply(
        lambda g: np.polyfit(np.log10(g["n"]), np.log10(g["rmse"]), 1)[0]
    )


if __name__ == "__main__":
    found = study()
    found.to_csv(TABLE, index=False, float_format="%.6g")
    print(slopes(found))
