"""Families whose simulators have the right value by luck."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import optimize, stats

from oee_tabular.exact import optimal_policy, policy_value, state_values
from oee_tabular.lab.bench.families_shifts.tables import draw_garnet, from_tables
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import normalize
from oee_tabular.lab.bench.shift import Moves, shift
from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import IntArray


def miss(family: Family) -> float:
    """Compute by how much the true value is above the simulator's."""
    return family.truth - policy_value(family.simulator, family.policy)


def match_value(
    family_at: Callable[[float], Family], low: float, high: float
) -> Family:
    """Find the family at the parameter where the simulator's value is right by luck.

    The parameter lies in [low, high].
    """
    parameter = optimize.brentq(
        lambda parameter: miss(family_at(parameter)), low, high, xtol=1e-3
    )
    return family_at(parameter)


def lucky_garnet(rng: np.random.Generator) -> Family:
    """Make a Garnet tilted along V, up in half of the states and down elsewhere."""
    table = draw_garnet(rng)
    rewards = rng.normal(size=(40, 3))
    better = rng.random(40) < 0.5
    simulator = FiniteMDP(table, rewards, np.full(40, 1 / 40), 0.95)
    z = stats.zscore(state_values(simulator, optimal_policy(simulator)))
    about = (
        "Half of the states are better and half worse than simulated, which cancels by"
        " luck."
    )

    def family_at(loss: float) -> Family:
        """Return the family whose worse states lose this much."""
        real = normalize(
            table * np.exp(np.where(better, 0.6, -loss)[:, None, None] * z)
        )
        return from_tables(about, (table, real), rewards, 0.95)

    # They are drawn again where the states drawn to be worse matter too little.
    while miss(family_at(5.0)) > 0.0:
        better = rng.random(40) < 0.5
    return match_value(family_at, 0.0, 5.0)


def lucky_queue(rng: np.random.Generator) -> Family:
    """Make a queue of 0 to 29 jobs with slow or fast service."""
    arrival = rng.uniform(0.34, 0.4)
    about = "Fewer arrivals and slower service than simulated, which cancel by luck."
    cost = -0.1 * np.arange(30.0)[:, None] - np.array([0.0, 0.4])

    def moves(jobs: IntArray, fast: IntArray, arrival: float, factor: float) -> Moves:
        """Return the transitions of the queue."""
        done = np.where(jobs > 0, factor * np.where(fast, 0.7, 0.5), 0.0)
        up = arrival * (1 - done)
        down = (1 - arrival) * done
        return (up, jobs + 1), (down, jobs - 1), (1 - up - down, jobs)

    def family_at(factor: float) -> Family:
        """Return the family whose service is this factor of the simulated one."""
        return shift(
            about, (30, 2), cost, 0.97, (0.45, 1.0), (arrival, factor), moves
        )()

    return match_value(family_at, 0.3, 1.0)
