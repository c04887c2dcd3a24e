"""Grids: the paper's, floors of 8 x 8 whose slip differs by place or by motor, and Gymnasium's toy text."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.lab.bench.family import Family, Recorded, pair, spread
from oee_tabular.mdp import FiniteMDP
from oee_tabular.tasks import gridworld, gridworld_policy, toy_text

SIDE, CELLS = 8, 64
SIMULATED = 0.15  # slip of the floors


def paper_grid(simulated: float, real: float, about: str) -> Family:
    """The paper's 10 x 10 grid under half the expert's policy, recorded by uniform actions."""
    policy = gridworld_policy(10, 0.5)
    return pair(gridworld(10, simulated), gridworld(10, real), about, policy=policy, recorded="uniform", length=1000)


def floor(slip: object = SIMULATED) -> FiniteMDP:
    """8 x 8 cells, started anywhere; ``slip`` is a number, or one for each (s, a)."""
    always, never = gridworld(SIDE, 1.0).transitions, gridworld(SIDE, 0.0).transitions
    share = np.broadcast_to(np.asarray(slip, dtype=np.float64), (CELLS, 4)).copy()
    share[-1] = 0.0
    weight = share.reshape(-1)
    transitions = sparse.diags_array(weight) @ always + sparse.diags_array(1.0 - weight) @ never
    row, column = np.divmod(np.arange(CELLS), SIDE)
    distance = 0.2 * (row + column - 2 * (SIDE - 1.0))
    return FiniteMDP(transitions, distance, spread(CELLS, range(CELLS - 1)), 0.98)


def floors(slip: object, about: str, *, recorded: Recorded = "half") -> Family:
    """A floor that slips otherwise than simulated."""
    return pair(floor(), floor(slip), about, recorded=recorded)


def where(mask: object, slip: float) -> Array:
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


def one_way_grid() -> Family:
    """The paper's grid from its corner with a log of its expert alone: much of what the policy does is never seen."""
    simulator, target = (gridworld(6, slip, discount=0.97) for slip in (0.3, 0.15))
    family = pair(simulator, target, "Moves slip less than simulated, and the log shows one way only.", optimal=0.6)
    narrow = pair(simulator, target, family.about, optimal=0.97).policy
    return Family(simulator, target, family.policy, narrow, family.about)


def frozen_lake() -> Family:
    """FrozenLake 8 x 8: a step goes where it is meant with probability 1/3 simulated, .6 real."""
    simulator, target = (toy_text("FrozenLake-v1", map_name="8x8", success_rate=rate) for rate in (1 / 3, 0.6))
    return pair(simulator, target, "The ice is less slippery than simulated.", recorded="half")


def taxi_rain() -> Family:
    """Taxi in the rain: it goes where it is sent with probability .8 simulated, .6 real."""
    simulator, target = (
        toy_text("Taxi-v4", discount=0.95, is_rainy=True, rainy_probability=rate) for rate in (0.8, 0.6)
    )
    return pair(simulator, target, "It rains harder than simulated: the taxi misses more turns.", recorded="policy")


def cliff_walking() -> Family:
    """CliffWalking: one action in ten is replaced by a random one in the simulator, three in ten in the target."""
    simulator = toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.1)
    wet = toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.3)
    return pair(simulator, wet.transitions, "The edge of the cliff is more slippery than simulated.", recorded="policy")
