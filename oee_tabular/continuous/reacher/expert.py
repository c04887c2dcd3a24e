"""Reacher's policies: a controller made for the simulator's arm, mixed with random actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.reacher.dynamics import LENGTH, LEVELS, RADIUS, TARGET, Reacher


def joint_angles(target: object, length: float = LENGTH) -> tuple[float, float]:
    """(q1, q2) that put the fingertip on ``target``, the elbow bent to the left (q2 >= 0).

    cos q2 = (x^2 + y^2 - l^2 - (l + .01)^2) / (2 l (l + .01)); a ValueError for a target out of the arm's reach.
    """
    x, y = _checks.float_array(target, "target")
    far = length + RADIUS
    bend = (x * x + y * y - length**2 - far**2) / (2.0 * length * far)
    if not -1.0 <= bend <= 1.0:
        raise ValueError(
            f"target must be {RADIUS:g} to {length + far:g} m from the shoulder of an arm with links of {length:g} m; "
            f"it is {np.hypot(x, y):g} m away"
        )
    q2 = float(np.arccos(bend))
    return float(np.arctan2(y, x) - np.arctan2(far * np.sin(q2), length + far * np.cos(q2))), q2


@dataclass(frozen=True)
class ReacherPolicy:
    """pi_delta = delta * uniform + (1 - delta) * expert, a function of states (n, 4) giving probabilities (n, 9).

    The expert (ours: the paper's is lost) is a proportional-derivative controller of the joint angles that put the
    *simulator's* fingertip on the target, u = stiffness * (q* - q) - brake * w, each joint taking the nearest of its three
    levels. It believes in the simulator's links whatever the arm.

    Parameters
    ----------
    delta : share of random actions, in [0, 1]: the opposite sense to the gridworld, as in the paper
    target : (x, y) in m
    length : of the links that the expert believes in, m
    stiffness, brake : of the controller

    Examples
    --------
    >>> reacher_policy(0.9)(np.zeros((1, 4))).max().round(12).item()
    0.2
    """

    delta: float = 0.0
    target: tuple[float, float] = TARGET
    length: float = LENGTH
    stiffness: float = 4.0
    brake: float = 0.5

    def __post_init__(self) -> None:
        _checks.number_in(self.delta, "delta", 0.0, 1.0)
        object.__setattr__(self, "_aim", joint_angles(self.target, self.length))

    def __call__(self, states: Array) -> Array:
        """(n, 9) probabilities of the actions, in the order of ``Reacher.actions``."""
        aim = self._aim  # type: ignore[attr-defined]
        turn = aim[0] - states[:, 0]
        errors = np.column_stack([np.arctan2(np.sin(turn), np.cos(turn)), aim[1] - states[:, 1]])
        wanted = self.stiffness * errors - self.brake * states[:, 2:]
        level = np.digitize(wanted, [LEVELS[0] / 2, LEVELS[2] / 2])
        table = np.full((len(states), 9), self.delta / 9.0)
        table[np.arange(len(states)), 3 * level[:, 0] + level[:, 1]] += 1.0 - self.delta
        return table


reacher_policy = ReacherPolicy


def reacher_log(task: Reacher, n: int, *, max_steps: int = 150, seed: Any = None) -> ContinuousTransitions:
    """The paper's data: n transitions by pi_delta, delta = 0, .1, ..., 1 in equal parts, episodes of ``max_steps``.

    Parameters
    ----------
    task : Reacher, the target's arm
    n : transitions in all
    max_steps : transitions of an episode
    seed : the same seed gives the same bits

    Raises
    ------
    ValueError
        ``n`` or ``max_steps`` not a positive integer.

    Examples
    --------
    >>> len(reacher_log(Reacher(), 1000, max_steps=25, seed=0))
    1000
    """
    from oee_tabular.continuous.episodes import record  # what it compiles with is imported only here

    size = _checks.positive_integer(n, "n")
    parts = [
        record(task, reacher_policy(k / 10), n_transitions=-(-size // 11), max_steps=max_steps, seed=stream)
        for k, stream in enumerate(_checks.generator(seed).spawn(11))
    ]
    return ContinuousTransitions.concatenate(parts).first(size)
