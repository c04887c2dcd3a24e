"""Grids: the paper's, and floors of 8 x 8 whose slip differs by place or by motor."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.bench.family import Family
from oee_tabular.bench.making import Recorded, mixed_rows, pair, spread
from oee_tabular.mdp import FiniteMDP
from oee_tabular.tasks import gridworld, gridworld_policy

SIDE, CELLS = 8, 64
SIMULATED = 0.15  # slip of the floors


def paper_grid(simulated: float, real: float, about: str) -> Family:
    """The paper's 10 x 10 grid under half the expert's policy, recorded by uniform actions."""
    policy = gridworld_policy(10, 0.5)
    return pair(gridworld(10, simulated), gridworld(10, real), about, policy=policy, recorded="uniform", length=1000)


def floor(slip: Any = SIMULATED) -> FiniteMDP:
    """8 x 8 cells, started anywhere; ``slip`` is a number, or one for each (s, a)."""
    always, never = gridworld(SIDE, 1.0), gridworld(SIDE, 0.0)
    share = np.broadcast_to(np.asarray(slip, dtype=np.float64), (CELLS, 4)).copy()
    share[-1] = 0.0
    transitions = mixed_rows(share, always, never)
    row, column = np.divmod(np.arange(CELLS), SIDE)
    distance = 0.2 * (row + column - 2 * (SIDE - 1.0))
    return FiniteMDP(transitions, distance, spread(CELLS, range(CELLS - 1)), 0.98)


def floors(slip: Any, about: str, *, recorded: Recorded = "half") -> Family:
    """A floor that slips otherwise than simulated."""
    return pair(floor(), floor(slip), about, recorded=recorded)


def where(mask: Any, slip: float) -> Array:
    """(S, A): ``slip`` in the cells of the mask (8, 8), as simulated elsewhere."""
    return np.repeat(np.where(np.asarray(mask).reshape(-1), slip, SIMULATED), 4).reshape(CELLS, 4)


def slippery() -> Family:
    """Nine cells in the middle."""
    row, column = np.indices((SIDE, SIDE))
    wet = (row >= 3) & (row < 6) & (column >= 3) & (column < 6)
    return floors(
        where(wet, 0.6), "Nine cells in the middle of the floor are slippery, which the simulator does not know."
    )


def motor() -> Family:
    """The first direction's motor."""
    weak = np.full((CELLS, 4), SIMULATED)
    weak[:, 0] = 0.55
    return floors(weak, "One of the four motors is weak.", recorded="uniform")


def chequered() -> Family:
    """Every other cell."""
    odd = np.indices((SIDE, SIDE)).sum(axis=0) % 2
    return floors(where(odd, 0.4), "Every other cell of the floor is more slippery than simulated.", recorded="policy")


def wind() -> Family:
    """A gust carries the robot up a row, whatever it does."""
    simulator = floor()
    gust = simulator.transitions[np.arange(CELLS * 4) // 4 * 4 + 1]
    return pair(
        simulator, 0.8 * simulator.transitions + 0.2 * gust,
        "A wind blows along one direction, in a fifth of the steps; the simulator has none.", recorded="half",
    )  # fmt: skip


def calm() -> Family:
    """Nothing is wrong."""
    return floors(SIMULATED, "The simulator of the floor is right.")
