"""Families on grids: the paper's, floors of 8 x 8 cells, and Gymnasium's toy text.

The slip of the floors differs by place or by motor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import normalize
from oee_tabular.lab.bench.shift import Maker, PairOptions, pair
from oee_tabular.mdp import FiniteMDP
from oee_tabular.tasks import gridworld, gridworld_policy, toy_text

SIMULATOR_SLIP = 0.15  # slip of the floors
# The policy acts as the expert in half of the steps; uniform actions record the target.
PAPER: PairOptions = {
    "policy": gridworld_policy(10, 0.5),
    "recorded": 0.0,
    "length": 1000,
}
ROW, COLUMN = np.indices((8, 8)).reshape(2, 64, 1)
IS_MIDDLE = (ROW >= 3) & (ROW < 6) & (COLUMN >= 3) & (COLUMN < 6)


def floor(slip: Any = SIMULATOR_SLIP) -> FiniteMDP:
    """Make a floor of 8 x 8 cells, started anywhere.

    ``slip`` is a number, or one for each cell, or one for each (cell, action).
    """
    share = np.broadcast_to(np.asarray(slip, dtype=np.float64), (64, 4)).copy()
    share[-1] = 0.0
    always = gridworld(8, 1.0).transitions
    never = gridworld(8, 0.0).transitions
    transitions = (
        sparse.diags_array(share.ravel()) @ always
        + sparse.diags_array(1.0 - share.ravel()) @ never
    )
    return FiniteMDP(
        transitions,
        0.2 * (ROW + COLUMN - 14.0).ravel(),
        normalize(np.append(np.ones(63), 0.0)),
        0.98,
    )


def one_way_grid() -> Family:
    """Make a 6 x 6 grid from its corner, with a log of nearly its expert alone.

    The simulator's optimal policy takes 97% of the steps, a uniform one the others.

    Much of what the policy does is never recorded.
    """
    simulator, target = (gridworld(6, slip, discount=0.97) for slip in (0.3, 0.15))
    family = pair(
        "Moves slip less than simulated, and the log shows one way only.",
        simulator,
        target,
        optimal=0.6,
    )
    narrow = pair(family.about, simulator, target, optimal=0.97).policy
    return Family(simulator, target, family.policy, narrow, family.about)


FLOORS: dict[str, Maker] = {
    "paper_grid": lambda: pair(
        "The paper's: steps slip less than simulated.",
        gridworld(10, 0.3),
        gridworld(10, 0.1),
        **PAPER,
    ),
    "paper_grid_reversed": lambda: pair(
        "Steps slip more than simulated.",
        gridworld(10, 0.1),
        gridworld(10, 0.3),
        **PAPER,
    ),
    "floor_slippery": lambda: pair(
        "Nine cells in the middle of the floor are slippery, which the simulator does"
        " not know.",
        floor(),
        floor(np.where(IS_MIDDLE, 0.6, SIMULATOR_SLIP)),
    ),
    "floor_motor": lambda: pair(
        "One of the four motors is weak.",
        floor(),
        floor(np.array([0.55, SIMULATOR_SLIP, SIMULATOR_SLIP, SIMULATOR_SLIP])),
        recorded=0.0,
    ),
    "floor_chequered": lambda: pair(
        "Every other cell of the floor is more slippery than simulated.",
        floor(),
        floor(np.where((ROW + COLUMN) % 2, 0.4, SIMULATOR_SLIP)),
        recorded=0.9,
    ),
    "floor_wind": lambda: pair(
        "A wind blows along one direction, in a fifth of the steps; the simulator has"
        " none.",
        floor(),
        # The wind moves it a row up, whatever it does.
        0.8 * floor().transitions
        + 0.2 * floor().transitions[np.arange(64 * 4) // 4 * 4 + 1],
    ),
    "floor_identical": lambda: pair(
        "The simulator of the floor is right.", floor(), floor()
    ),
}
TOY_TEXT: dict[str, Maker] = {
    # FrozenLake 8 x 8: a step goes where it is meant with probability 1/3 simulated, .6
    # real
    "frozen_lake": lambda: pair(
        "The ice is less slippery than simulated.",
        *(
            toy_text("FrozenLake-v1", map_name="8x8", success_rate=rate)
            for rate in (1 / 3, 0.6)
        ),
    ),
    # A taxi in the rain goes where it is sent with probability .8 simulated, .6 real
    "taxi_rain": lambda: pair(
        "It rains harder than simulated: the taxi misses more turns.",
        *(
            toy_text("Taxi-v4", discount=0.95, is_rainy=True, rainy_probability=rate)
            for rate in (0.8, 0.6)
        ),
        recorded=0.9,
    ),
    # One action in ten is replaced by a random one in the simulator, three in ten in
    # the target
    "cliff_walking": lambda: pair(
        "The edge of the cliff is more slippery than simulated.",
        toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.1),
        toy_text("CliffWalking-v1", discount=0.95).with_action_noise(0.3).transitions,
        recorded=0.9,
    ),
}
