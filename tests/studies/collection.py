"""How much planned collection saves: RMSE of the value estimate for four ways to collect. Run by hand.

    python tests/studies/collection.py             writes tests/studies/collection.csv and prints it

5 x 5 grid, slip 0.3 simulated, 0.1 real, reward -Manhattan distance / 8 of the current cell, discount 0.95, infinite horizon,
the policy half expert and half uniform. Data are episodes of a behaviour policy in the target, started again after each move
with probability 0.05 and at the goal; n moves in all. 400 repetitions, values times (1 - discount). Claim: planned collection
reaches the RMSE of uniform collection with at most a third of the transitions.

    uniform      the uniform behaviour policy
    on-policy    the policy that is evaluated
    planned      ``plan_data_collection(simulator, policy, sampling="behavior")``: before any data
    two-stage    a fifth as planned; then the plan from that log ("estimate") for the rest

Estimates: "maximum likelihood" (rows without data the simulator's), whose variance a plan minimises; and ``OffEnvironment()``,
which borrows strength from all rows by a tilt that this pair of grids happens to satisfy: no plan is made for it, and any data
tell it about all rows. ``foretold``: sqrt(asymptotic variance / n) of maximum likelihood.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

import oee_tabular as oee
from oee_tabular.inference.design_flow import collection_mdp
from oee_tabular.inference.experimental_design import plan_data_collection
from oee_tabular.tasks.gridworld import gridworld_policy

REPETITIONS, RESTART = 400, 0.05
SIZES = (667, 2000, 6667, 20_000)
DESIGNS = ("uniform", "on-policy", "planned", "two-stage")
ESTIMATORS = {
    "maximum likelihood": oee.estimators.ModelBased(fallback="simulator"),
    "OffEnvironment": oee.estimators.OffEnvironment(),
}
TABLE = Path(__file__).with_name("collection.csv")


def small_grid(slip):
    """The grid of theory notes, section 3."""
    base = oee.tasks.gridworld(5, slip, discount=0.95)
    row, column = np.divmod(np.arange(25), 5)
    return oee.FiniteMDP(base.transitions, (row + column - 8) / 8, base.initial, 0.95)


def record(target, behavior, n, rng):
    """n moves: episodes that stop after each move with probability RESTART, and at the goal."""
    episodes = n // 3 + 100  # more than are needed
    log = oee.sample_episodes(target, behavior, episodes, 300, seed=rng)
    kept = np.flatnonzero(log.timestep < rng.geometric(RESTART, episodes)[log.episode])
    assert len(kept) >= n
    return log.select(kept[:n])


def joined(first, second):
    """Both logs as one bag of moves."""
    pairs = {
        name: (getattr(first, name), getattr(second, name)) for name in ("state", "action", "next_state", "reward")
    }
    return oee.Transitions(**{name: np.concatenate(parts) for name, parts in pairs.items()})


def planned(known, policy, n):
    return plan_data_collection(known, policy, n=n, sampling="behavior", restart=RESTART).behavior_policy


def before_any_data():
    """The plan from the simulator; without a log it is the same for every n."""
    return planned(small_grid(0.3), gridworld_policy(5, 0.5), 1)


def collect(design, n, before, simulator, target, policy, rng):
    """A log of n moves; ``before`` is the behaviour planned in the simulator."""
    if design == "uniform":
        return record(target, oee.uniform_policy(target), n, rng)
    if design == "on-policy":
        return record(target, policy, n, rng)
    if design == "planned":
        return record(target, before, n, rng)
    first = record(target, before, n // 5, rng)
    rest = n - len(first)
    return joined(first, record(target, planned(oee.Problem(simulator, first), policy, rest), rest, rng))


def one(design, n, repetition, before):
    """Errors of the estimates, times (1 - discount)."""
    simulator, target, policy = small_grid(0.3), small_grid(0.1), gridworld_policy(5, 0.5)
    rng = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(DESIGNS.index(design), n, repetition)))
    problem = oee.Problem(simulator, collect(design, n, before, simulator, target, policy, rng))
    value = oee.policy_value(target, policy)
    return [0.05 * (estimate(problem, policy).value - value) for estimate in ESTIMATORS.values()]


def foretold(design, n):
    """sqrt(asymptotic variance / n) for what the behaviour policy meets in the target; two stages: for the oracle's plan."""
    target, policy = small_grid(0.1), gridworld_policy(5, 0.5)
    behavior = {
        "uniform": lambda: oee.uniform_policy(target),
        "on-policy": lambda: policy,
        "planned": before_any_data,
        "two-stage": lambda: planned(target, policy, n),
    }[design]()
    share = oee.occupancy(collection_mdp(target, RESTART), behavior)
    return 0.05 * float(np.sqrt(oee.efficiency_bound(target, policy, share) / n))


def study(repetitions=REPETITIONS, n_jobs=2):
    """One row for each n, way to collect and estimator."""
    cells = [(design, n) for n in SIZES for design in DESIGNS]
    before = before_any_data()
    jobs = [(*cell, repetition, before) for cell in cells for repetition in range(repetitions)]
    errors = np.array(Parallel(n_jobs=n_jobs)(delayed(one)(*job) for job in jobs)).reshape(len(cells), repetitions, -1)
    rows = []
    for (design, n), error in zip(cells, errors, strict=True):
        for name, e in zip(ESTIMATORS, error.T, strict=True):
            square = e**2
            rmse = float(np.sqrt(square.mean()))
            rows.append({"n": n, "design": design, "estimator": name, "rmse": rmse, "bias": e.mean(),
                         "rmse_error": square.std() / np.sqrt(repetitions) / (2 * rmse),
                         "foretold": foretold(design, n), "repetitions": repetitions})  # fmt: skip
    return pd.DataFrame(rows)


if __name__ == "__main__":
    table = study(*(int(x) for x in sys.argv[1:2]))
    table.to_csv(TABLE, index=False, float_format="%.5g")
    print(table.to_string(index=False))
    rmse = table.set_index(["estimator", "n", "design"])["rmse"]
    for name in ESTIMATORS:
        for n, third in ((2000, 667), (20_000, 6667)):
            for design in ("on-policy", "planned", "two-stage"):
                ratio = rmse[name, third, design] / rmse[name, n, "uniform"]
                print(f"{name}: {design} with {third} / uniform with {n}: {ratio:.2f}")
