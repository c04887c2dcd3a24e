"""The controller of the hand, and logged trajectories of an arm as a log of its hand's positions.

A log of a real arm comes as a table (CSV, parquet or npz: columns state_0, ..., next_state_0, ...,
action or action_0, ..., episode; one command a row) or as a Minari data set with continuous observations. A state is the
hand's position in m (3), the joints' angles in rad (7: forward kinematics give the position), or a whole state of the
stand-in (27, of which the first three are the position).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.kinova.dynamics import (
    COMMANDS,
    DEAD_BAND,
    GOALS,
    N_ARM_STATES,
    N_JOINTS,
    HandTask,
    end_effector,
    goal_number,
)
from oee_tabular.continuous.log import ContinuousTransitions


@dataclass(frozen=True)
class KinovaPolicy:
    """pi_delta = delta * uniform + (1 - delta) * the proportional controller, a function of states giving (n, 27).

    The controller commands sign(goal_i - x_i) along each axis that is off by more than the dead band of 0.015 m. It looks at
    the first three coordinates of a state alone, the measured position in m: it is the same for the arm and for its model.

    Parameters
    ----------
    goal : 0..4, a row of GOALS
    delta : share of random commands, in [0, 1]

    Examples
    --------
    >>> from oee_tabular.continuous.kinova.dynamics import CENTER
    >>> COMMANDS[kinova_policy(0)(CENTER[None]).argmax()].tolist()  # from home: forward along x, y and z
    [1.0, 1.0, 1.0]
    >>> kinova_policy(0, delta=0.27)(CENTER[None]).max().round(3).item()
    0.74
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


kinova_policy = KinovaPolicy
FARTHEST = 1.3  # m: beyond the reach of a Gen3
MOST_TURNS = 8 * np.pi  # rad: continuous joints count turns, but not so many
HORIZON = 25  # commands of a run


def record_goals(
    arm: HandTask, *, n_runs: int = 10, delta: float = 0.0, horizon: int = HORIZON, seed: Any = None
) -> ContinuousTransitions:
    """``n_runs`` runs to each of the five goals under ``kinova_policy(goal, delta)``, by default the paper's 50 trajectories.

    Parameters
    ----------
    arm : KinovaArm, which needs MuJoCo, or KinovaHand; its own goal is not used
    n_runs : to each goal; goal g has the episodes g n_runs to (g + 1) n_runs - 1, and the rewards of its goal
    delta : share of random commands, in [0, 1]
    horizon : commands of a run
    seed : the same seed gives the same bits

    Examples
    --------
    >>> from oee_tabular.continuous.kinova.hand import ideal_hand
    >>> log = record_goals(ideal_hand(1.4), n_runs=1, seed=0)  # no arm, only commands that move it too far
    >>> len(log), log.n_state, int(log.truncated.sum())
    (125, 3, 5)
    """
    runs = _checks.positive_integer(n_runs, "n_runs")
    steps = _checks.positive_integer(horizon, "horizon")
    rng = _checks.generator(seed)
    return ContinuousTransitions.concatenate(
        [
            record(arm.towards(g), kinova_policy(g, delta), n_episodes=runs, max_steps=steps, seed=rng)
            for g in range(len(GOALS))
        ]
    )


def hand_log(log: ContinuousTransitions, *, speed: float | None = None) -> ContinuousTransitions:
    """The same transitions with the hand's position (n, 3) in m as the state, and commands in {-1, 0, 1}^3.

    Parameters
    ----------
    log : states of 3 coordinates (position, m), 7 (joint angles, rad) or 27 (the stand-in's own)
    speed : m/s that a command of 1 stands for, where the log's actions are velocities; None: they are numbers of the 27
        commands, or their directions

    Positions beyond 1.3 m and angles beyond 8 pi (millimetres, degrees?) are errors.

    Examples
    --------
    >>> from oee_tabular.continuous.kinova.dynamics import HOME
    >>> joints = ContinuousTransitions([HOME], [[0.0, 0.0, 0.1]], [HOME])
    >>> found = hand_log(joints, speed=0.1)
    >>> found.state.round(3).tolist(), found.action.tolist()
    ([[0.457, 0.001, 0.434]], [[0.0, 0.0, 1.0]])
    """
    _checks.instance(log, ContinuousTransitions, "log")
    columns: dict[str, Any] = log.columns()
    for name in ("state", "next_state"):
        columns[name] = _positions(columns[name], name)
    if speed is not None:
        scale = _checks.number_in(speed, "speed", 0.0, np.inf, open_ends=True)
        if log.action.ndim != 2:
            raise ValueError("speed must be None where log.action has numbers of commands; it is not None")
        columns["action"] = log.action / scale
    if columns["action"].ndim == 2 and columns["action"].shape[1] != COMMANDS.shape[1]:
        raise ValueError(f"log.action must have 3 coordinates, along x, y, z; it has {columns['action'].shape[1]}")
    return ContinuousTransitions(**columns)


def load_kinova_log(path: str | os.PathLike[str], *, speed: float | None = None) -> ContinuousTransitions:
    """``hand_log`` of a file: .csv, .parquet, .npz, or a Minari folder or id with continuous observations.

    Parameters
    ----------
    path : of a file whose name ends in .csv, .parquet or .npz; else a Minari folder or id
    speed : m/s that a command of 1 stands for, see ``hand_log``

    Examples
    --------
    >>> import tempfile
    >>> log = ContinuousTransitions([[0.4, 0.0, 0.4]], [[1.0, 0.0, 0.0]], [[0.43, 0.0, 0.4]], episode=[0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log.save(folder + "/arm.csv")
    ...     load_kinova_log(folder + "/arm.csv")
    ContinuousTransitions(1 transitions of 3-dimensional states in 1 episodes: 0 terminated, 1 truncated;
                          actions are 3-dimensional commands)
    """
    found = ContinuousTransitions.load(path)
    try:
        return hand_log(found, speed=speed)
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)!r}: {error}") from None


def _positions(states: Array, name: str) -> Array:
    """(n, 3) the positions of the hand, which must be possible ones."""
    width = states.shape[1]
    if width not in (3, N_JOINTS, N_ARM_STATES):
        raise ValueError(
            f"log.{name} must have 3 coordinates (position), {N_JOINTS} (joint angles) or {N_ARM_STATES} (the stand-in's "
            f"state); it has {width}"
        )
    is_angles = width == N_JOINTS
    limit, what = (MOST_TURNS, "joint angles in rad") if is_angles else (FARTHEST, "positions in m")
    array = states if is_angles else np.array(states[:, :3])
    for place in np.argwhere(np.abs(array) > limit):
        where = _checks.place(f"log.{name}", tuple(place))
        raise ValueError(f"{where} must be within +-{limit:.4g}: {what}; it is {array[tuple(place)]:g}")
    return end_effector(array) if is_angles else array
