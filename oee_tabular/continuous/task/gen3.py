"""The kinematics of a Kinova Gen3, its controller, and its logs of the hand's position.

A command in {-1, 0, 1}^3 asks for 0.1 m/s along the axes of the base during 0.2 s.
Resolved rates turn it into a moving reference of the joints, and position servos follow
that. Where the hand is needs NumPy alone:

    T(q) = prod_k Trans(p_k) Rot_x(r_k) Rot_z(q_k),
    dq = J^T (J J^T + lambda^2 I)^-1 (v, 0)

The offsets p_k (m) and r_k (rad) are read from gen3.xml, the file that MuJoCo
simulates: there is one set of numbers.
"""

from __future__ import annotations

import functools
import itertools
import os
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any, Self
from xml.etree import ElementTree

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import ContinuousTask
from oee_tabular.continuous.task.episodes import record
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, IntArray, RealArrayLike, Seed

N_JOINTS = 7
# position 3, angles, speeds and references 7 each, the last command 3
N_ARM_STATES = 27
# rad, the usual resting pose
HOME = np.array([0.0, 0.26179939, np.pi, -2.26892803, 0.0, 0.95993109, 1.57079633])
MAX_REACH = 1.3  # m: beyond the reach of a Gen3
MAX_JOINT_ANGLE = 8 * np.pi  # rad: continuous joints count turns, but not so many
HORIZON = 25  # commands of a run
DAMPING = 0.02  # lambda: keeps joint speeds finite near singular poses


def arm_xml() -> str:
    """Return the MJCF of the stand-in.

    It has published geometry, masses, inertias and limits, and assumed armature and
    servo gains.
    """
    return (
        resources.files("oee_tabular.continuous.task").joinpath("gen3.xml").read_text()
    )


@functools.cache
def _chain() -> tuple[Array, Array]:
    """Return offsets (8, 3) in m and turns about x (8,) in rad.

    They are of the seven joints and the end effector.
    """
    bodies = [
        body.attrib
        for body in ElementTree.fromstring(arm_xml()).iter("body")
        if "euler" in body.attrib
    ]
    offsets = [[float(x) for x in body["pos"].split()] for body in bodies]
    turns = [[float(x) for x in body["euler"].split()] for body in bodies]
    return np.array(offsets), np.array(turns)[:, 0]


def _frames(joints: Array) -> tuple[Array, Array, Array]:
    """Compute joint origins and axes, (n, 7, 3) each, and the end effector (n, 3)."""
    offsets, turns = _chain()
    n = len(joints)
    place = np.zeros((n, 3))
    x, y, z = (np.broadcast_to(row, (n, 3)) for row in np.eye(3))
    origins = np.empty((n, N_JOINTS, 3))
    axes = np.empty((n, N_JOINTS, 3))
    for k in range(N_JOINTS + 1):
        p = offsets[k]
        c = np.cos(turns[k])
        s = np.sin(turns[k])
        place = place + p[0] * x + p[1] * y + p[2] * z
        y, z = _rotate(y, z, c, s)
        if k < N_JOINTS:
            origins[:, k] = place
            axes[:, k] = z
            c = np.cos(joints[:, k, None])
            s = np.sin(joints[:, k, None])
            x, y = _rotate(x, y, c, s)
    return origins, axes, place


def _rotate(
    first: Array, second: Array, cosine: Array, sine: Array
) -> tuple[Array, Array]:
    """Turn two axes about the third."""
    return cosine * first + sine * second, cosine * second - sine * first


def end_effector(joints: RealArrayLike) -> Array:
    """Compute the position of the end effector, (n, 3) in m.

    The joint angles are (n, 7) in rad; the frame is that of the base.

    Examples
    --------
    >>> end_effector(HOME[None]).round(4).tolist()
    [[0.4567, 0.0014, 0.4337]]
    """
    angles = _checks.float_array(joints, "joints")
    if angles.ndim != 2 or angles.shape[1] != N_JOINTS:
        raise ArgumentError(
            "joints",
            f"must have shape (n, {N_JOINTS}), angles in rad; it has shape"
            f" {angles.shape}",
        )
    _checks.require_finite(angles, "joints")
    return _frames(angles)[2]


def resolved_rates(joints: Array, velocity: Array) -> Array:
    """Compute joint speeds (n, 7) in rad/s by which the end effector does not turn.

    It moves with the ``velocity`` (n, 3) in m/s. The speeds are damped least squares on
    the 6-row Jacobian; they cost O(n).
    """
    origins, axes, place = _frames(joints)
    linear = np.cross(axes, place[:, None, :] - origins)
    jacobian = np.concatenate([linear, axes], axis=2).transpose(0, 2, 1)
    twist = np.concatenate([velocity, np.zeros_like(velocity)], axis=1)[:, :, None]
    square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING**2 * np.eye(6)
    rates = jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, twist)
    return np.asarray(rates[:, :, 0])


SPEED = 0.1  # m/s along each axis
PERIOD = 0.2  # s between commands
STEP = SPEED * PERIOD  # m: how far a command should move the hand
COMMANDS = freeze(np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))))
CENTER = freeze(end_effector(HOME[None])[0])
# m: an arm that moves up to 1.5 times as far as asked does not hunt about its goal
DEAD_BAND = 0.75 * STEP
# m: whole steps from home, about 0.23 m, each in another direction
GOALS = freeze(
    CENTER
    + np.array(
        [
            [0.16, 0.18, 0.08],
            [0.14, -0.18, 0.06],
            [-0.12, 0.18, 0.12],
            [-0.10, -0.16, -0.12],
            [0.18, 0.06, -0.14],
        ]
    )
)
# m on either side of home: what the finite MDP covers
REACH = np.array([0.24, 0.24, 0.20])


def goal_number(goal: Any) -> int:
    """Return ``goal`` as a row number of GOALS."""
    number = int(goal) if _checks.is_integer(goal) else -1
    if not 0 <= number < len(GOALS):
        raise ArgumentError(
            "goal",
            f"must be in 0..{len(GOALS) - 1}, a row of GOALS; it is"
            f" {_checks.show(goal)}",
        )
    return number


class HandTask(ContinuousTask):
    """The base of the arm and of the model of its hand.

    They share 27 commands, the position (x, y, z) of the hand in m as the feature, and
    its cost.
    """

    actions = COMMANDS
    feature_names = ("x", "y", "z")
    feature_low = freeze(CENTER - REACH)
    feature_high = freeze(CENTER + REACH)
    periodic = (False,) * 3
    terminates = False
    is_translation_invariant = True
    # vertices a command's step apart
    default_cells = tuple((2 * np.round(REACH / STEP) + 1).astype(int).tolist())
    goal: int

    def features(self, states: Array) -> Array:
        """Return the measured position, the first three coordinates, in m.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, 3)
            The positions.
        """
        return np.ascontiguousarray(states[:, :3])

    def towards(self, goal: int) -> Self:
        """Return the same task with another goal.

        Parameters
        ----------
        goal : int
            The goal, 0 to 4.

        Returns
        -------
        HandTask
            The task.
        """
        return replace(self, goal=goal)  # type: ignore[type-var]

    def costs(self, states: Array) -> Array:
        """Compute r(x), minus the distance from the hand to the goal.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n,)
            The rewards in m.
        """
        return np.asarray(-np.linalg.norm(states[:, :3] - GOALS[self.goal], axis=1))

    def reward_terms(self, states: Array) -> Array:
        """Return the rewards as the one term, (n, 1).

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, 1)
            The rewards in m.
        """
        return self.costs(states)[:, None]

    def reward_of(self, before: Array, actions: IntArray, after: Array) -> Array:
        """Return the reward of the state before the transition.

        Parameters
        ----------
        before : ndarray of shape (n, 1)
            The reward terms of the states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        after : ndarray of shape (n, 1)
            The reward terms of the next states.

        Returns
        -------
        ndarray of shape (n,)
            The rewards in m.
        """
        return before[:, 0]


@suggest_keywords
@dataclass(frozen=True)
class KinovaPolicy:
    """The proportional controller mixed with random commands.

    It is delta * uniform + (1 - delta) * controller, a function of states giving
    probabilities (n, 27). The controller commands sign(goal_i - x_i) along each axis
    that is off by more than the dead band of 0.015 m. It looks at the first three
    coordinates of a state alone, the measured position in m: it is the same for the arm
    and for its model.

    Parameters
    ----------
    goal : int, default 0
        The goal, 0 to 4, a row of GOALS.
    delta : float, default 0.0
        The share of random commands, in [0, 1].

    Raises
    ------
    ValueError
        If ``goal`` is no row of GOALS, or ``delta`` outside of [0, 1].

    Examples
    --------
    >>> # from home: forward along x, y and z
    >>> COMMANDS[kinova_policy(0)(CENTER[None]).argmax()].tolist()
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
        """Return the probabilities (n, 27) of the commands."""
        apart = GOALS[self.goal] - states[:, :3]
        direction = np.where(np.abs(apart) > DEAD_BAND, np.sign(apart), 0.0)
        levels = direction.astype(np.int64) + 1
        # commands are numbered in C order over the three levels of x, y and z
        number = levels @ np.array([9, 3, 1])
        table = np.full((len(states), len(COMMANDS)), self.delta / len(COMMANDS))
        table[np.arange(len(states)), number] += 1.0 - self.delta
        return table


kinova_policy = KinovaPolicy


@suggest_keywords
def record_goals(
    arm: HandTask,
    *,
    n_runs: int = 10,
    delta: float = 0.0,
    horizon: int = HORIZON,
    seed: Seed = None,
) -> ContinuousTransitions:
    """Record runs to each of the five goals, by default the paper's 50 trajectories.

    Parameters
    ----------
    arm : KinovaArm or KinovaHand
        The arm, which needs MuJoCo, or a model of its hand; its own goal is not used.
    n_runs : int, default 10
        The number of runs to each goal. Goal g has the episodes g n_runs to (g + 1)
        n_runs - 1, and the rewards of its goal.
    delta : float, default 0.0
        The share of random commands, in [0, 1].
    horizon : int, default 25
        The number of commands of a run.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers. The same seed gives the same bits.

    Returns
    -------
    ContinuousTransitions
        The log, under ``kinova_policy(goal, delta)``.

    Raises
    ------
    ValueError
        If a number is out of its range.

    Examples
    --------
    >>> from oee_tabular.continuous.task.kinova import ideal_hand
    >>> # no arm, only commands that move it too far
    >>> log = record_goals(ideal_hand(1.4), n_runs=1, seed=0)
    >>> len(log), log.n_state, int(log.truncated.sum())
    (125, 3, 5)
    """
    _checks.instance(arm, HandTask, "arm", "KinovaArm or KinovaHand")
    runs = _checks.positive_integer(n_runs, "n_runs")
    steps = _checks.positive_integer(horizon, "horizon")
    rng = _checks.generator(seed)
    parts = [
        record(
            arm.towards(g),
            kinova_policy(g, delta),
            n_episodes=runs,
            max_steps=steps,
            seed=rng,
        )
        for g in range(len(GOALS))
    ]
    return ContinuousTransitions.concatenate(parts)


@suggest_keywords
def hand_log(
    log: ContinuousTransitions, *, speed: float | None = None
) -> ContinuousTransitions:
    """Return the same transitions with the hand's position as the state.

    Parameters
    ----------
    log : ContinuousTransitions
        A log with states of 3 coordinates (position, m), 7 (joint angles, rad) or 27
        (the stand-in's own).
    speed : float, optional
        The speed in m/s for which a command of 1 stands, where the log's actions are
        velocities. None means that they are numbers of the 27 commands, or their
        directions.

    Returns
    -------
    ContinuousTransitions
        The log, with states (n, 3) in m and numbers of commands or commands in {-1, 0,
        1}^3.

    Raises
    ------
    ValueError
        If a position is beyond 1.3 m or an angle beyond 8 pi (millimetres, degrees?),
        or states or actions have other lengths.

    Examples
    --------
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
            raise ArgumentError(
                "speed",
                "must be None where log.action has numbers of commands; it is not None",
            )
        columns["action"] = log.action / scale
    if columns["action"].ndim == 2 and columns["action"].shape[1] != COMMANDS.shape[1]:
        raise ArgumentError(
            "log.action",
            "must have 3 coordinates, along x, y, z; it has"
            f" {columns['action'].shape[1]}",
        )
    return ContinuousTransitions(**columns)


@suggest_keywords
def load_kinova_log(
    path: str | os.PathLike[str], *, speed: float | None = None
) -> ContinuousTransitions:
    """Read a file and return its transitions with the hand's position as the state.

    Parameters
    ----------
    path : str or path-like
        A file whose name ends in .csv, .parquet or .npz; or else a Minari folder or id,
        with continuous observations.
    speed : float, optional
        The speed in m/s for which a command of 1 stands; see ``hand_log``.

    Returns
    -------
    ContinuousTransitions
        The log, with states (n, 3) in m.

    Raises
    ------
    ValueError
        If the file is no such log, or ``hand_log`` refuses it.

    See Also
    --------
    hand_log : The same for a log that is at hand.

    Examples
    --------
    >>> import tempfile
    >>> log = ContinuousTransitions(
    ...     [[0.4, 0.0, 0.4]], [[1.0, 0.0, 0.0]], [[0.43, 0.0, 0.4]], episode=[0]
    ... )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log.save(folder + "/arm.csv")
    ...     load_kinova_log(folder + "/arm.csv")
    ContinuousTransitions(1 transitions of 3-dimensional states in 1 episodes: 0 terminated, 1 truncated;
                          actions are 3-dimensional commands)
    """
    found = ContinuousTransitions.load(path)
    # several paths are read as one log
    is_one = isinstance(path, str | os.PathLike)
    shown = _checks.show(os.fspath(path) if is_one else path)
    try:
        return hand_log(found, speed=speed)
    except ArgumentError as error:
        raise ArgumentError(f"{shown}: {error.argument}", error.rule) from None
    except ValueError as error:
        raise ValueError(f"{shown}: {error}") from None


def _positions(states: Array, name: str) -> Array:
    """Return the positions of the hand, (n, 3), which must be possible ones."""
    width = states.shape[1]
    if width not in (3, N_JOINTS, N_ARM_STATES):
        raise ArgumentError(
            f"log.{name}",
            f"must have 3 coordinates (position), {N_JOINTS} (joint angles) or"
            f" {N_ARM_STATES} (the stand-in's state); it has {width}",
        )
    is_angles = width == N_JOINTS
    if is_angles:
        array = states
        limit = MAX_JOINT_ANGLE
        what = "joint angles in rad"
    else:
        array = np.array(states[:, :3])
        limit = MAX_REACH
        what = "positions in m"
    for place in np.argwhere(np.abs(array) > limit):
        where = _checks.place(f"log.{name}", tuple(place))
        raise ArgumentError(
            where,
            f"must be within +-{limit:.4g}: {what}; it is {array[tuple(place)]:g}",
        )
    return end_effector(array) if is_angles else array
