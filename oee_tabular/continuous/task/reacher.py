"""Reacher with links of a mistaken length (the paper's Section VI.C), and its policies.

The task is an arm of two links in a plane. The state is (q1, q2, w1, w2): the
shoulder's angle, the elbow's angle against the upper link, and their speeds in rad/s.
Masses, inertias and drag are those that Bullet computes for its Reacher (capsules of
radius 0.01 m and 1000 kg/m^3; boxes with a margin for the inertias; the armature and
the damping of the model file ignored), steps are semi-implicit Euler. The reward is the
paper's,

    r = 100 (d - d') - 0.01 (|a0 w0'| + |a1 w1'|) - 0.01 (|a0| + |a1|)
        - 0.1 [elbow at its stop],

d the distance from the fingertip to the target; Bullet's electricity cost 0.1 abs(a w)
has w in units of 10 rad/s. Its first part telescopes, so that reward is made by getting
there. The nine actions are part of the environment, and so is the target's place: the
paper's Reacher draws another one each episode, which would make the state
six-dimensional.

The fingertip is left out of the state: with it in, arms of different lengths stay on
different manifolds, and no ratio exists. The reward is then one of joint angles and of
a length: ``reward_length`` is the length by which it is computed, by default the arm's
own.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, Self, TypedDict, Unpack

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import ContinuousTask, Moves
from oee_tabular.continuous.task.episodes import record
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, IntArray, Seed

RADIUS = 0.01  # m
DENSITY = 1000.0  # kg/m^3
MARGIN = 0.04  # m, Bullet's collision margin
STOP = 3.0  # rad, of the elbow
LENGTH = 0.1  # m, the simulator's links
TARGET = (0.1, 0.1)  # m
LEVELS = (-2.0 / 3.0, 0.0, 2.0 / 3.0)  # of an action, in units of the gear
INERTIAS = ("box", "capsule")
# The other arms of the defensive simulator have these multiples of the length.
FACTORS = (0.5, 0.7, 1.4, 2.0)


MAX_LENGTH = 1e6  # m


def _require_place(target: object) -> None:
    """Require two finite numbers, the place of the target."""
    place = _checks.float_array(target, "target")
    if place.shape != (2,) or not np.isfinite(place).all():
        raise ArgumentError(
            "target",
            f"must be two finite numbers (x, y); it is {_checks.show(target)}",
        )


def link_bodies(length: float, inertia: Literal["box", "capsule"] = "box") -> Array:
    """Return mass, centre and moment of both links and the tip, (3, 3).

    The columns are the mass (kg), the distance of the centre of mass from the joint (m)
    and the moment about the centre (kg m^2). The tip is a ball 0.01 m beyond the lower
    link's end. ``inertia`` is Bullet's "box" around a link, m/12 [(2 r + .08)^2 + (l +
    2 r + .08)^2], or that of the "capsule" itself (MuJoCo's).
    """
    long = _checks.number_in(length, "length", 0.0, MAX_LENGTH)
    if long == 0.0:
        raise ArgumentError("length", f"must be positive; it is {_checks.show(length)}")
    _checks.one_of(inertia, "inertia", INERTIAS)
    rod = DENSITY * np.pi * RADIUS**2 * long
    ball = DENSITY * 4.0 / 3.0 * np.pi * RADIUS**3
    mass = rod + ball
    if inertia == "box":
        across = 2 * (RADIUS + MARGIN)
        along = long + 2 * (RADIUS + MARGIN)
        moment = mass / 12.0 * (across**2 + along**2)
    else:
        moment = rod * (long**2 / 12.0 + RADIUS**2 / 4.0)
        moment += ball * (
            2.0 / 5.0 * RADIUS**2 + long**2 / 4.0 + 3.0 / 8.0 * long * RADIUS
        )
    link = [mass, long / 2.0, moment]
    return np.array([link, link, [ball, long + RADIUS, 2.0 / 5.0 * ball * RADIUS**2]])


def fingertip(states: Array, length: float) -> Array:
    """Return where the fingertip is, (n, 2) in m.

    It is at l (cos q1, sin q1) + (l + 0.01) (cos(q1 + q2), sin(q1 + q2)).
    """
    q1 = states[:, 0]
    q12 = states[:, 0] + states[:, 1]
    reach = length + RADIUS
    return np.stack(
        [
            length * np.cos(q1) + reach * np.cos(q12),
            length * np.sin(q1) + reach * np.sin(q12),
        ],
        axis=1,
    )


class ReacherOptions(TypedDict, total=False):
    """The parameters of ``Reacher`` apart from the length of its links."""

    reward_length: float | None
    target: tuple[float, float]
    gear: float
    damping: float
    armature: float
    drag: float
    timestep: float
    substeps: int
    inertia: Literal["box", "capsule"]


@suggest_keywords
@dataclass(frozen=True)
class Reacher(ContinuousTask):
    """An arm of two links that reaches for a target, with the paper's reward.

    The state is (q1, q2, w1, w2): the angles of the shoulder and of the elbow in rad
    and their speeds in rad/s. The nine actions are torques of gear * (-2/3, 0 or 2/3) N
    m in each joint, held for ``substeps * timestep`` s. The reward, without a unit, is
    100 times the distance (m) by which the fingertip came nearer to the target, minus
    small costs of torques, speeds and the elbow's stop. Episodes do not end.

    Parameters
    ----------
    length : float, default 0.1
        The length of each link in m. The paper's simulator has 0.1, its targets 0.2 and
        0.05.
    reward_length : float, optional
        The length in m by which the reward finds the fingertip. None means the arm's
        own.
    target : tuple of two floats, default (0.1, 0.1)
        The place (x, y) of the target in m.
    gear : float, default 0.05
        The torque of an action of 1, in N m.
    damping : float, default 0.0
        The damping of each joint, in N m s/rad.
    armature : float, default 0.0
        The inertia that is added to each joint, in kg m^2.
    drag : float, default 0.04
        Bullet's linear and angular damping.
    timestep : float, default 0.0165
        The duration of an Euler step in s.
    substeps : int, default 1
        The number of Euler steps for which an action is held.
    inertia : {'box', 'capsule'}, default 'box'
        The shape whose inertia the links have: Bullet's box or MuJoCo's capsule.

    Raises
    ------
    ValueError
        If a number is out of its range.

    See Also
    --------
    reacher_policy : The expert, mixed with the uniform policy.
    reacher_log : Record the paper's data.

    Notes
    -----
    A step is deterministic and costs O(n substeps). Episodes begin at rest, q1 uniform
    in [-3.14, 3.14] and q2 in [-1.57, 1.57]. Features are (cos q1, sin q1, q2, w1, w2).
    The arm was checked against MuJoCo, which knows no drag, with ``inertia="capsule"``:
    see tests/continuous/test_tasks.py.

    Examples
    --------
    >>> task = Reacher(0.1)
    >>> task.moves(
    ...     np.zeros((1, 4)), np.array([4]), np.zeros((1, 0))
    ... ).next_state.tolist()
    [[0.0, 0.0, 0.0, 0.0]]
    >>> Reacher.tamed(0.05).substeps
    4
    """

    state_names = ("q1", "q2", "w1", "w2")
    actions = freeze(np.array(list(itertools.product(LEVELS, LEVELS))))
    n_disturbances = 0
    feature_names = ("cos_q1", "sin_q1", "q2", "w1", "w2")
    periodic = (False,) * 5
    terminates = False
    default_cells = 3000

    length: float = LENGTH
    reward_length: float | None = None
    target: tuple[float, float] = TARGET
    gear: float = 0.05
    damping: float = 0.0
    armature: float = 0.0
    drag: float = 0.04
    timestep: float = 0.0165
    substeps: int = 1
    inertia: Literal["box", "capsule"] = "box"
    name: str = field(default="Reacher", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_bodies", link_bodies(self.length, self.inertia))
        if self.reward_length is not None:
            _checks.number_in(
                self.reward_length, "reward_length", 0.0, np.inf, open_ends=True
            )
        _require_place(self.target)
        for name in ("gear", "damping", "armature", "drag"):
            _checks.number_in(getattr(self, name), name, 0.0, np.inf)
        _checks.number_in(self.timestep, "timestep", 0.0, np.inf, open_ends=True)
        _checks.positive_integer(self.substeps, "substeps")
        # rad/s, the usual speeds: without damping the links turn much faster
        speed = 4.0 if self.damping > 0 else 40.0
        high = np.array([1.0, 1.0, STOP, speed, speed])
        object.__setattr__(self, "feature_low", freeze(-high))
        object.__setattr__(self, "feature_high", freeze(high))

    @classmethod
    def tamed(cls, length: float = LENGTH, **changes: Unpack[ReacherOptions]) -> Self:
        """Make the variant for tests, with damping and longer actions.

        Parameters
        ----------
        length : float, default 0.1
            The length of each link in m.
        **changes : float, int, str or tuple
            Other parameters of ``Reacher``, by name.

        Returns
        -------
        Reacher
            An arm with a damping of 0.01 N m s/rad, an action held for 0.066 s.

        Notes
        -----
        A horizon of 25 is the paper's 1.65 s.
        """
        options: ReacherOptions = {"damping": 0.01, "substeps": 4}
        options.update(changes)
        return cls(length, **options)

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take one step from each state.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The angles (rad) and their speeds (rad/s).
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        disturbance : ndarray of shape (n, 0)
            Not used, because a step is deterministic.

        Returns
        -------
        Moves
            The next states and the rewards; no state is terminal.
        """
        commands = self.actions[np.asarray(actions, dtype=np.int64)]
        following = self.advance(states, commands)
        before = self.reward_terms(states)
        reward = self.reward_of(before, actions, self.reward_terms(following))
        return Moves(following, reward, np.zeros(len(states), dtype=np.bool_))

    def advance(self, states: Array, commands: Array) -> Array:
        """Compute the next states under commands, which need not be among the nine.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The angles (rad) and their speeds (rad/s).
        commands : ndarray of shape (n, 2)
            The commands of both joints; torques are gear * command, in N m.

        Returns
        -------
        ndarray of shape (n, 4)
            The next states.
        """
        upper, lower, cross = self._inertia()
        h = self.timestep
        q1, q2, w1, w2 = np.asarray(states, dtype=np.float64).T
        torques = self.gear * commands
        for _ in range(self.substeps):
            cosine = np.cos(q2)
            sine = np.sin(q2)
            m12 = lower + cross * cosine
            m11 = upper + lower + 2.0 * cross * cosine + self.armature
            m22 = lower + self.armature
            f1, f2 = self._forces(torques, cosine, cross * sine, w1, w2)
            a11 = m11 + h * self.damping
            a22 = m22 + h * self.damping
            det = a11 * a22 - m12 * m12
            w1 = w1 + h * (a22 * f1 - m12 * f2) / det
            w2 = w2 + h * (a11 * f2 - m12 * f1) / det
            q1 = q1 + h * w1
            q2 = q2 + h * w2
            stopped = (np.abs(q2) > STOP) & (w2 * q2 > 0.0)
            w1 = np.where(stopped, w1 + m12 / m11 * w2, w1)
            w2 = np.where(stopped, 0.0, w2)
            q2 = np.clip(q2, -STOP, STOP)
        return np.stack([q1, q2, w1, w2], axis=1)

    def _inertia(self) -> tuple[float, float, float]:
        """Compute the constants of the mass matrix, in kg m^2.

        They are the moments of inertia of the upper link (with the lower one's mass at
        its end) and of the lower link about their joints, and the factor of cos(q2) by
        which the links are coupled.
        """
        mass, centre, moment = self._bodies.T  # type: ignore[attr-defined]
        inertia = moment + mass * centre**2
        upper = inertia[0] + (mass[1] + mass[2]) * self.length**2
        lower = inertia[1] + inertia[2]
        cross = self.length * (mass[1] * centre[1] + mass[2] * centre[2])
        return upper, lower, cross

    def _forces(
        self, torques: Array, cosine: Array, coupling: Array, w1: Array, w2: Array
    ) -> tuple[Array, Array]:
        """Compute what turns the two joints, (n,) each, in N m.

        From the commands' ``torques`` (n, 2) the Coriolis terms, the damping and the
        drag are taken. ``cosine`` is cos(q2), ``coupling`` the coupling of the links
        times sin(q2), and w1 and w2 are the joints' speeds.
        """
        coriolis = coupling * (2.0 * w1 * w2 + w2 * w2)
        f1 = torques[:, 0] + coriolis - self.damping * w1
        f2 = torques[:, 1] - coupling * w1 * w1 - self.damping * w2
        if self.drag > 0.0:
            first, second = self._drag(cosine, w1, w1 + w2)
            f1 = f1 - self.drag * first
            f2 = f2 - self.drag * second
        return f1, f2

    def _drag(self, cosine: Array, w1: Array, w12: Array) -> tuple[Array, Array]:
        """Compute what a Bullet drag of 1 takes from the torques of each joint, (n,).

        The links turn at the speeds w1 and w12.
        """
        bodies = self._bodies  # type: ignore[attr-defined]
        length = self.length
        mass, centre, moment = bodies[0]
        first = w1 * (
            mass * centre**2 * (1.0 + np.abs(centre * w1)) + moment * (1.0 + np.abs(w1))
        )
        second = np.zeros_like(w1)
        for mass, centre, moment in bodies[1:]:
            # the centre's velocity along the normals of the two links
            u = length * w1
            v = centre * w12
            k = mass * (
                1.0 + np.sqrt(np.maximum(u * u + v * v + 2.0 * u * v * cosine, 0.0))
            )
            around = k * centre * (v + u * cosine) + moment * w12 * (1.0 + np.abs(w12))
            first = first + k * length * (u + v * cosine) + around
            second = second + around
        return first, second

    def distance(self, states: Array) -> Array:
        """Compute the distance from the fingertip of ``reward_length`` to the target.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The states.

        Returns
        -------
        ndarray of shape (n,)
            The distances in m.
        """
        length = self.length if self.reward_length is None else self.reward_length
        apart = fingertip(states, length) - np.array(self.target)
        return np.asarray(np.hypot(*apart.T))

    def reward_terms(self, states: Array) -> Array:
        """Compute the functions of a state in which the reward is linear.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The states.

        Returns
        -------
        ndarray of shape (n, 4)
            The distance (m), the absolute values of the two speeds (rad/s), and 1 where
            the elbow is within 1% of its stop, where Bullet's Reacher has its penalty.
        """
        at_stop = np.abs(np.abs(states[:, 1]) / STOP - 1.0) < 0.01
        return np.column_stack([self.distance(states), np.abs(states[:, 2:]), at_stop])

    def reward_of(self, before: Array, actions: IntArray, after: Array) -> Array:
        """Compute the paper's reward from the reward terms.

        Parameters
        ----------
        before : ndarray of shape (n, 4)
            The reward terms of the states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        after : ndarray of shape (n, 4)
            The reward terms of the next states.

        Returns
        -------
        ndarray of shape (n,)
            The rewards.
        """
        size = np.abs(self.actions[actions])
        cost = (size * (1.0 + after[:, 1:3])).sum(axis=1)
        reward = 100.0 * (before[:, 0] - after[:, 0]) - 0.01 * cost
        return np.asarray(reward - 0.1 * after[:, 3])

    def others(self) -> tuple[Reacher, ...]:
        """Return arms whose links are 0.5, 0.7, 1.4 and 2 times as long.

        Returns
        -------
        tuple of Reacher
            The arms.
        """
        return tuple(replace(self, length=factor * self.length) for factor in FACTORS)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw states at rest, q1 within half a turn of 0, q2 within a quarter.

        Parameters
        ----------
        n : int
            How many states are drawn.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        ndarray of shape (n, 4)
            The states.
        """
        return np.column_stack(
            [rng.uniform(-3.14, 3.14, n), rng.uniform(-1.57, 1.57, n), np.zeros((n, 2))]
        )

    def smooth(self, states: Array) -> Array:
        """Return both angles by cosine and sine, and the speeds.

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The states.

        Returns
        -------
        ndarray of shape (n, 6)
            The coordinates (cos q1, cos q2, sin q1, sin q2, w1, w2).
        """
        return np.column_stack(
            [np.cos(states[:, :2]), np.sin(states[:, :2]), states[:, 2:]]
        )

    def features(self, states: Array) -> Array:
        """Return the features (cos q1, sin q1, q2, w1, w2).

        Parameters
        ----------
        states : ndarray of shape (n, 4)
            The states.

        Returns
        -------
        ndarray of shape (n, 5)
            The features, in rad and rad/s where they have a unit.
        """
        return np.column_stack(
            [np.cos(states[:, 0]), np.sin(states[:, 0]), states[:, 1:]]
        )

    def embed(self, features: Array) -> Array:
        """Return states with these features, q1 the angle of (cos q1, sin q1).

        Parameters
        ----------
        features : ndarray of shape (n, 5)
            The features.

        Returns
        -------
        ndarray of shape (n, 4)
            The states.
        """
        return np.column_stack(
            [np.arctan2(features[:, 1], features[:, 0]), features[:, 2:]]
        )

    def parameters(self) -> dict[str, Any]:
        """Return every parameter by name.

        Returns
        -------
        dict
            The parameters.
        """
        names = [own.name for own in fields(self) if own.init]
        values = {name: getattr(self, name) for name in names}
        return values | {"target": list(self.target)}


def joint_angles(target: object, length: float = LENGTH) -> tuple[float, float]:
    """Return angles (q1, q2) in rad that put the fingertip on ``target``.

    The elbow is bent to the left, q2 >= 0, with cos q2 = (x^2 + y^2 - l^2 - (l +
    .01)^2) / (2 l (l + .01)). Raises a ValueError for a target out of the arm's reach.
    """
    point = _checks.float_array(target, "target", ndim=1)
    if len(point) != 2:
        raise ArgumentError(
            "target", f"must be two numbers, x and y; it has {len(point)}"
        )
    x, y = point
    far = length + RADIUS
    bend = (x * x + y * y - length**2 - far**2) / (2.0 * length * far)
    if not -1.0 <= bend <= 1.0:
        raise ArgumentError(
            "target",
            f"must be {RADIUS:g} to {length + far:g} m from the shoulder of an arm with"
            f" links of {length:g} m; it is {np.hypot(x, y):g} m away",
        )
    q2 = float(np.arccos(bend))
    turn = np.arctan2(far * np.sin(q2), length + far * np.cos(q2))
    return float(np.arctan2(y, x) - turn), q2


@suggest_keywords
@dataclass(frozen=True)
class ReacherPolicy:
    """The expert mixed with the uniform policy: delta * uniform + (1 - delta) * expert.

    It is a function of states (n, 4) giving probabilities (n, 9). The expert (ours: the
    paper's is lost) is a proportional-derivative controller of the joint angles that
    put the *simulator's* fingertip on the target,

        u = stiffness * (q* - q) - brake * w,

    each joint taking the nearest of its three levels. It believes in the simulator's
    links whatever the arm.

    Parameters
    ----------
    delta : float, default 0.0
        The share of random actions, in [0, 1]. The sense is opposite to the
        gridworld's, as in the paper.
    target : tuple of two floats, default (0.1, 0.1)
        The place (x, y) of the target in m.
    length : float, default 0.1
        The length in m of the links that the expert believes in.
    stiffness : float, default 4.0
        The controller's gain of the angles, in actions per rad.
    brake : float, default 0.5
        The controller's gain of the speeds, in actions per rad/s.

    Raises
    ------
    ValueError
        If ``delta`` is outside of [0, 1], or the target out of the arm's reach.

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
        link_bodies(self.length, "box")  # which checks the length
        _require_place(self.target)
        for name in ("stiffness", "brake"):
            _checks.number_in(getattr(self, name), name, -np.inf, np.inf)
        object.__setattr__(self, "_aim", joint_angles(self.target, self.length))

    def __call__(self, states: Array) -> Array:
        """Return the probabilities (n, 9) of the actions, in the task's order."""
        aim = self._aim  # type: ignore[attr-defined]
        turn = aim[0] - states[:, 0]
        errors = np.column_stack(
            [np.arctan2(np.sin(turn), np.cos(turn)), aim[1] - states[:, 1]]
        )
        wanted = self.stiffness * errors - self.brake * states[:, 2:]
        level = np.digitize(wanted, [LEVELS[0] / 2, LEVELS[2] / 2])
        table = np.full((len(states), 9), self.delta / 9.0)
        table[np.arange(len(states)), 3 * level[:, 0] + level[:, 1]] += 1.0 - self.delta
        return table


reacher_policy = ReacherPolicy


@suggest_keywords
def reacher_log(
    task: Reacher, n: int, *, max_steps: int = 150, seed: Seed = None
) -> ContinuousTransitions:
    """Record the paper's data: transitions by pi_delta, delta = 0, 0.1, ..., 1.

    Parameters
    ----------
    task : Reacher
        The target's arm.
    n : int
        The number of transitions in all, in equal parts for each delta.
    max_steps : int, default 150
        The number of transitions after which an episode is truncated.
    seed : int, Generator or SeedSequence, optional
        The source of random numbers. The same seed gives the same bits.

    Returns
    -------
    ContinuousTransitions
        The log.

    Raises
    ------
    ValueError
        If ``n`` or ``max_steps`` is not a positive integer.

    Examples
    --------
    >>> len(reacher_log(Reacher(), 1000, max_steps=25, seed=0))
    1000
    """
    _checks.instance(task, ContinuousTask, "task")
    if task.n_actions != len(LEVELS) ** 2:
        raise ArgumentError(
            "task", f"must have Reacher's {len(LEVELS) ** 2} actions; it is {task.name}"
        )
    size = _checks.positive_integer(n, "n")
    parts = [
        record(
            task,
            reacher_policy(k / 10),
            n_transitions=-(-size // 11),
            max_steps=max_steps,
            seed=stream,
        )
        for k, stream in enumerate(_checks.generator(seed).spawn(11))
    ]
    return ContinuousTransitions.concatenate(parts).first(size)
