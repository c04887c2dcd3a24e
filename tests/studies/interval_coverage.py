"""Coverage and width of the intervals. Run by hand.

    python tests/studies/interval_coverage.py [grid] [lake]    writes interval_coverage.csv and interval_coverage_lake.csv

grid: 5 x 5, slip 0.3 simulated, 0.1 real, reward -Manhattan distance / 8 of the current cell, discount 0.95, infinite horizon,
delta = 0.5; n rows drawn from the discounted occupancy of the uniform policy (the goal left out); prior box [0.25, 1.6];
400 repetitions. "rare": the same with columns 3 and 4 never recorded, which the policy needs. Widths times (1 - discount).
lake: FrozenLake 8 x 8 of the README: 1/3 simulated, 0.6 real, 20 000 transitions of the policy mix:0.49, evaluated mix:0.7;
1000 logs, the default interval without a box.
"""

import sys
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
from joblib import Parallel, delayed

import oee_tabular as oee

FOLDER = Path(__file__).parent
BOX = {"lower_ratio": 0.25, "upper_ratio": 1.6}
METHODS = {
    "delta": {"method": "delta"},
    "bootstrap percentile": {"method": "bootstrap", "n_bootstrap": 400},
    "bootstrap basic": {"method": "bootstrap", "bootstrap": "basic", "n_bootstrap": 400},
    "likelihood": {**BOX},
    "likelihood without box": {},
    "robust, box": {"method": "robust", **BOX},
    "robust": {"method": "robust"},
    "robust, anytime": {"method": "robust", "radius": "anytime"},
    "robust, l1": {"method": "robust", "ball": "l1"},
    "robust, l1 and box": {"method": "robust", "ball": "l1", **BOX},
}


def small_grid(slip):
    """The grid of theory notes, section 3."""
    base = oee.tasks.gridworld(5, slip, discount=0.95)
    row, column = np.divmod(np.arange(25), 5)
    return oee.FiniteMDP(base.transitions, (row + column - 8) / 8, base.initial, 0.95)


def problem_of(kind, n, repetition):
    """(problem, policy, true value)."""
    simulator, target = small_grid(0.3), small_grid(0.1)
    share = oee.occupancy(target, oee.uniform_policy(target))
    share[24] = 0.0
    if kind == "rare":
        share[np.arange(25) % 5 >= 3] = 0.0
    log = oee.sample_transitions(
        target, share / share.sum(), n, seed=np.random.SeedSequence(0, spawn_key=(n, repetition))
    )
    policy = oee.tasks.gridworld_policy(5, 0.5)
    return oee.Problem(simulator, log), policy, oee.policy_value(target, policy)


def one(kind, n, repetition, names):
    """(methods, 2): covered, width."""
    problem, policy, truth = problem_of(kind, n, repetition)
    rows = []
    for name in names:
        found = oee.interval(problem, policy, seed=repetition, **METHODS[name])
        rows.append((found.lower <= truth <= found.upper, 0.05 * found.width))
    return rows


def grid(repetitions=400, jobs=2):
    """One row for each environment, sample size and method."""
    rows = []
    for kind, n in (("grid", 1000), ("grid", 10_000), ("grid", 100_000), ("rare", 20_000)):
        names = list(METHODS)
        table = np.array(Parallel(jobs)(delayed(one)(kind, n, r, names) for r in range(repetitions)), dtype=float)
        for name, (covered, width) in zip(names, table.mean(axis=0), strict=True):
            rows.append({"environment": kind, "n": n, "method": name, "coverage": covered, "width": width,
                         "repetitions": repetitions})  # fmt: skip
            print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def lake_log(repetition, simulator, target, behavior, policy, truth):
    """Covered, lower, upper, unvisited rows."""
    log = oee.sample_episodes(target, behavior, 700, 100, seed=np.random.SeedSequence(1, spawn_key=(repetition,)))
    log = log.select(np.arange(20_000))
    found = oee.interval(oee.Problem(simulator, log), policy)
    return found.lower <= truth <= found.upper, found.lower, found.upper, found.diagnostics["unvisited_rows"]


def lake(repetitions=1000, jobs=2):
    """One row for each log."""

    def made(rate):
        return oee.FiniteMDP.from_gymnasium(
            gymnasium.make("FrozenLake-v1", map_name="8x8", success_rate=rate), discount=0.99
        )

    simulator, target = made(1 / 3), made(0.6)
    best, uniform = oee.optimal_policy(target), oee.uniform_policy(target)
    policy, behavior = oee.mix(best, uniform, 0.7), oee.mix(best, uniform, 0.49)
    truth = oee.policy_value(target, policy)
    found = Parallel(jobs)(delayed(lake_log)(r, simulator, target, behavior, policy, truth) for r in range(repetitions))
    table = pd.DataFrame(found, columns=["covered", "lower", "upper", "unvisited_rows"])
    print(
        f"coverage {table.covered.mean():.4f}, mean width {(table.upper - table.lower).mean():.4f}, truth {truth:.6f}"
    )
    return table


if __name__ == "__main__":
    words = sys.argv[1:] or ["grid", "lake"]
    if "grid" in words:
        grid().to_csv(FOLDER / "interval_coverage.csv", index=False, float_format="%.4g")
    if "lake" in words:
        lake().to_csv(FOLDER / "interval_coverage_lake.csv", index=False, float_format="%.5g")
