"""The controller of the hand, mixed with random commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.continuous.kinova.dynamics import COMMANDS, DEAD_BAND, GOALS, goal_number


@dataclass(frozen=True)
class KinovaPolicy:
    """pi_delta = delta * uniform + (1 - delta) * the proportional controller, a function of states giving (n, 27).

    The controller commands sign(goal_i - x_i) along each axis that is off by more than the dead band of 0.015 m: a
    proportional command, cut to [-1, 1] and rounded. It looks at the first three coordinates of a state alone, the measured
    position, so that it is the same for the arm and for its model.
    """

    goal: int = 0
    delta: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "goal", goal_number(self.goal))
        _checks.number_in(self.delta, "delta", 0.0, 1.0)

    def __call__(self, states: Array) -> Array:
        """(n, 27) probabilities of the commands."""
        apart = GOALS[self.goal] - states[:, :3]
        command = np.where(np.abs(apart) > DEAD_BAND, np.sign(apart), 0.0).astype(np.int64) + 1
        table = np.full((len(states), len(COMMANDS)), self.delta / len(COMMANDS))
        table[np.arange(len(states)), command @ np.array([9, 3, 1])] += 1.0 - self.delta
        return table


def kinova_policy(goal: int, delta: float = 0.0) -> KinovaPolicy:
    """delta * uniform + (1 - delta) * the proportional controller to a goal.

    Parameters
    ----------
    goal : 0..4, a row of GOALS
    delta : share of random commands, in [0, 1]

    Returns
    -------
    KinovaPolicy
        A function of states, whose first three coordinates are the hand's position in m.

    Examples
    --------
    >>> from oee_tabular.continuous.kinova.dynamics import CENTER
    >>> COMMANDS[kinova_policy(0)(CENTER[None]).argmax()].tolist()  # from home: forward along x, y and z
    [1.0, 1.0, 1.0]
    >>> kinova_policy(0, delta=0.27)(CENTER[None]).max().round(3).item()
    0.74
    """
    return KinovaPolicy(goal, delta)
