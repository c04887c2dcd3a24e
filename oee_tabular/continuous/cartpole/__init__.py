"""CartPole under another gravity (the paper's Section VI.B), by the configuration that logs are evaluated by."""

from __future__ import annotations

from typing import Any

from oee_tabular._checks import Array
from oee_tabular.continuous.cartpole.dynamics import CartPole
from oee_tabular.continuous.cartpole.expert import cartpole_policy
from oee_tabular.continuous.cells import VisitedCells, visited_states
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.simulator import ContinuousSimulator


def cartpole(**parameters: Any) -> ContinuousSimulator:
    """CartPole under a gravity, by the configuration that ``oee reproduce fig2`` uses for every target.

    (theta, theta') on 32 x 32 vertices, looked at in the log's own places, floor 0.001, zeta from soft counts with prior
    "simulator" and strength 0.01, calibrated by the ratio. For the targets 7.5, 12.5 and 15 and the simulator 10 the mean error
    of (1 - discount) J was .0005 to .0009 at 80 000 moves and .0004 to .0012 at 10 000; the simulator's is .009 to .019. The
    whole state (``form=full``) has 1000 cells of states that the simulator visits.
    """
    task = CartPole(**parameters)
    whole = task.form == "full"
    return ContinuousSimulator(
        "cartpole",
        task,
        cartpole_policy(0.0),
        _visited_cells if whole else (32, 32),
        horizon=100,
        floor=1e-3,
        ratio={"prior": "simulator", "strength": 1.0 if whole else 0.01},
    )


def _visited_cells(
    task: CartPole, *, at: ContinuousTransitions | None, floor: float, discount: float
) -> Discretization:
    """The whole state: cells of visited states."""
    builder = VisitedCells(1000, floor=floor, neighbours=200)
    visited = visited_by_policies(task)
    if at is None:
        return builder.build(task, visited, discount=discount)
    return builder.at(task, visited, at, discount=discount)


def visited_by_policies(task: CartPole) -> Array:
    """200 000 states where the task goes under four policies."""
    policies = [cartpole_policy(delta) for delta in (0.0, 0.3, 0.6, 1.0)]
    return visited_states([task], policies, 200_000, max_steps=100, seed=0)
