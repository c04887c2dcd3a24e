"""A stand-in for the paper's robot (Section VI.D, Table I): a Kinova Gen3 simulated by MuJoCo, and the same arm perturbed.

**No data of the real arm was ever published. What is called the target here is this simulation with other parameters**:
a scale on the velocity that a command gives, latency, a payload, joint friction, weaker servos, noisier encoders. Payload,
gain and friction change the value by less than 1 %, since the servos are stiff and gravity is compensated; what a
task of Cartesian commands notices is how far a command moves the hand.

A command in {-1, 0, 1}^3 asks for 0.1 m/s along the axes of the base during 0.2 s. Resolved rates turn it into a moving
reference of the joints, and position servos follow that. Simulating needs the extra ``mujoco``; where the hand is needs NumPy
alone:

    T(q) = prod_k Trans(p_k) Rot_x(r_k) Rot_z(q_k),      dq = J^T (J J^T + lambda^2 I)^-1 (v, 0)

The offsets p_k (m) and r_k (rad) are read from gen3.xml, the file that MuJoCo simulates: there is one set of numbers.
"""

from __future__ import annotations

import functools
import itertools
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import Any, Self
from xml.etree import ElementTree

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, freeze
from oee_tabular.continuous.task import ContinuousTask, Moves

N_JOINTS = 7
HOME = np.array([0.0, 0.26179939, np.pi, -2.26892803, 0.0, 0.95993109, 1.57079633])  # rad, the usual resting pose
DAMPING = 0.02  # lambda: keeps joint speeds finite near singular poses


def arm_xml() -> str:
    """The MJCF of the stand-in: published geometry, masses, inertias and limits; assumed armature and servo gains."""
    return resources.files("oee_tabular.continuous.kinova").joinpath("gen3.xml").read_text()


@functools.cache
def _chain() -> tuple[Array, Array]:
    """Offsets (8, 3) in m and turns about x (8,) in rad: seven joints and the end effector."""
    root = ElementTree.fromstring(arm_xml())
    bodies = [body for body in root.iter("body") if "euler" in body.attrib]
    offsets = np.array([[float(x) for x in body.attrib["pos"].split()] for body in bodies])
    turns = np.array([float(body.attrib["euler"].split()[0]) for body in bodies])
    return offsets, turns


def _frames(joints: Array) -> tuple[Array, Array, Array]:
    """Joint origins (n, 7, 3), joint axes (n, 7, 3) and the end effector (n, 3)."""
    offsets, turns = _chain()
    n = len(joints)
    place = np.zeros((n, 3))
    x, y, z = (np.broadcast_to(row, (n, 3)) for row in np.eye(3))
    origins, axes = np.empty((n, N_JOINTS, 3)), np.empty((n, N_JOINTS, 3))
    for k in range(N_JOINTS + 1):
        p, c, s = offsets[k], np.cos(turns[k]), np.sin(turns[k])
        place = place + p[0] * x + p[1] * y + p[2] * z
        y, z = c * y + s * z, c * z - s * y
        if k < N_JOINTS:
            origins[:, k], axes[:, k] = place, z
            c, s = np.cos(joints[:, k, None]), np.sin(joints[:, k, None])
            x, y = c * x + s * y, c * y - s * x
    return origins, axes, place


def end_effector(joints: Array) -> Array:
    """(n, 3) position of the end effector in m, in the frame of the base, at joint angles (n, 7) in rad.

    Raises ValueError for another shape or numbers that are not finite. Cost: O(n).

    Examples
    --------
    >>> end_effector(HOME[None]).round(4).tolist()
    [[0.4567, 0.0014, 0.4337]]
    """
    angles = _checks.float_array(joints, "joints")
    if angles.ndim != 2 or angles.shape[1] != N_JOINTS:
        raise ValueError(f"joints must have shape (n, {N_JOINTS}), angles in rad; it has shape {angles.shape}")
    _checks.require_finite(angles, "joints")
    return _frames(angles)[2]


def resolved_rates(joints: Array, velocity: Array) -> Array:
    """(n, 7) joint speeds in rad/s that move the end effector with ``velocity`` (n, 3) m/s and do not turn it.

    Damped least squares on the 6-row Jacobian; O(n).
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
TICKS = 10  # updates of the joint reference in a period
FEED_FORWARD = np.array([0.05] * 4 + [0.1] * 3)  # s, kv / kp: servos damp the speed's error
START = 0.01  # rad: how exactly the arm returns to its home pose
JOINT_STATES = tuple(f"{kind}_{k}" for kind in ("joint", "speed", "reference") for k in range(1, N_JOINTS + 1))
COMMANDS = freeze(np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3))))
CENTER = freeze(end_effector(HOME[None])[0])
DEAD_BAND = 0.75 * STEP  # m: an arm that moves up to 1.5 times as far as asked does not hunt about its goal
GOALS = freeze(CENTER + np.array([  # m: whole steps from home, about 0.23 m, each in another direction
    [0.16, 0.18, 0.08], [0.14, -0.18, 0.06], [-0.12, 0.18, 0.12], [-0.10, -0.16, -0.12], [0.18, 0.06, -0.14],
]))  # fmt: skip
REACH = np.array([0.24, 0.24, 0.20])  # m on either side of home: what the finite MDP covers
AT_A_TIME = 2048  # states whose trajectories MuJoCo returns in one array
STAND_IN = "simulated stand-in, not a robot"


def require_mujoco() -> Any:
    """The module ``mujoco``, or an ImportError that names the extra."""
    try:
        import mujoco
    except ImportError:
        raise ImportError("mujoco is not installed: pip install 'oee-tabular[mujoco]'") from None
    return mujoco


def goal_number(goal: object) -> int:
    """``goal`` as a row number of GOALS."""
    if isinstance(goal, bool) or not isinstance(goal, int | np.integer) or not 0 <= goal < len(GOALS):
        raise ValueError(f"goal must be in 0..{len(GOALS) - 1}, a row of GOALS; it is {_checks.show(goal)}")
    return int(goal)


class HandTask(ContinuousTask):
    """What the arm and the model of its hand share: 27 commands, the position (x, y, z) as the feature, and the cost of it."""

    actions = COMMANDS
    feature_names = ("x", "y", "z")
    feature_low = freeze(CENTER - REACH)
    feature_high = freeze(CENTER + REACH)
    periodic = (False,) * 3
    terminates = False
    is_translation_invariant = True
    default_cells = tuple((2 * np.round(REACH / STEP) + 1).astype(int).tolist())  # vertices a command's step apart
    goal: int

    def features(self, states: Array) -> Array:
        """The measured position: the first three coordinates."""
        return np.ascontiguousarray(states[:, :3])

    def towards(self, goal: int) -> Self:
        """The same with another goal."""
        return replace(self, goal=goal)  # type: ignore[type-var]

    def costs(self, states: Array) -> Array:
        """(n,) r(x) = -|x - goal| in m."""
        return np.asarray(-np.linalg.norm(states[:, :3] - GOALS[self.goal], axis=1))

    def reward_terms(self, states: Array) -> Array:
        """(n, 1) the costs."""
        return self.costs(states)[:, None]

    def reward_of(self, before: Array, actions: IntArray, after: Array) -> Array:
        """The cost of the state before the transition."""
        return before[:, 0]


@dataclass(frozen=True)
class KinovaArm(HandTask):
    """The simulated Gen3 that moves its hand to a goal; a stand-in for the paper's robot.

        r(s) = -|x - goal| in m,  27 commands of 0.2 s,  x the measured position of the hand

    Parameters
    ----------
    goal : 0..4, a row of GOALS
    velocity_scale : what a commanded speed is multiplied with; 1.4 is the reference mismatch
    latency : s, in [0, 0.2]: for so long a period begins with the command of the one before
    payload : kg at the end effector, not compensated
    friction : N m of dry friction in each joint
    gain : factor on the servos' stiffness and damping
    encoder_noise : rad, standard deviation of each joint's reading from which the position is computed

    Notes
    -----
    A state has 27 coordinates: the measured position (3), joint angles (7), speeds (7) and references (7), and the last
    command (3). Only the position is a feature. 40 steps of MuJoCo a command: some thousand commands a second.

    Examples
    --------
    >>> arm = KinovaArm(velocity_scale=1.4)
    >>> arm.n_actions, arm.n_state, arm.actions[26].tolist()
    (27, 27, [1.0, 1.0, 1.0])
    >>> arm.parameters()["data"]
    'simulated stand-in, not a robot'
    """

    state_names = ("x", "y", "z", *JOINT_STATES, "command_x", "command_y", "command_z")
    n_disturbances = N_JOINTS

    goal: int = 0
    velocity_scale: float = 1.0
    latency: float = 0.0
    payload: float = 0.0
    friction: float = 0.0
    gain: float = 1.0
    encoder_noise: float = 5e-4
    name: str = field(default="Kinova Gen3 (simulated stand-in)", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "goal", goal_number(self.goal))
        _checks.number_in(self.velocity_scale, "velocity_scale", 0.0, 3.0)
        _checks.number_in(self.latency, "latency", 0.0, PERIOD)
        _checks.number_in(self.payload, "payload", 0.0, 4.0)
        _checks.number_in(self.friction, "friction", 0.0, 9.0)
        _checks.number_in(self.gain, "gain", 0.05, 5.0)
        _checks.number_in(self.encoder_noise, "encoder_noise", 0.0, 0.1)

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One command from each state: 40 steps of MuJoCo each."""
        joints, speeds, reference, before = np.split(states[:, 3:], [7, 14, 21], axis=1)
        command = COMMANDS[np.asarray(actions, dtype=np.int64)]
        late = self.latency / PERIOD * TICKS
        references = np.empty((len(states), TICKS, N_JOINTS))
        for tick in range(TICKS):
            share = min(1.0, max(0.0, tick + 1.0 - late))  # of this tick in which the new command is in force
            velocity = self.velocity_scale * SPEED * (share * command + (1.0 - share) * before)
            rates = resolved_rates(reference, velocity)
            reference = reference + PERIOD / TICKS * rates
            references[:, tick] = reference + FEED_FORWARD * rates
        joints, speeds = self._follow(joints, speeds, references)
        seen = end_effector(joints + self.encoder_noise * disturbance)
        following = np.concatenate([seen, joints, speeds, reference, command], axis=1)
        return Moves(following, self.costs(states), np.zeros(len(states), dtype=np.bool_))

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """At rest near the home pose, N(0, 0.01^2) rad in each joint."""
        joints = HOME + START * rng.standard_normal((n, N_JOINTS))
        seen = end_effector(joints + self.encoder_noise * rng.standard_normal((n, N_JOINTS)))
        return np.concatenate([seen, joints, np.zeros((n, N_JOINTS)), joints, np.zeros((n, 3))], axis=1)

    def on_features(self) -> ContinuousTask:
        """The hand's position as a process of its own: it leaves 24 coordinates open, averaged over by ``fit_hand``."""
        from oee_tabular.continuous.kinova.hand import fit_hand

        return fit_hand(self)

    def parameters(self) -> dict[str, Any]:
        """All of them, and that this is no robot."""
        names = ("goal", "velocity_scale", "latency", "payload", "friction", "gain", "encoder_noise")
        return {"data": STAND_IN} | {name: getattr(self, name) for name in names}

    def _follow(self, joints: Array, speeds: Array, references: Array) -> tuple[Array, Array]:
        """Angles and speeds after the servos have followed references (n, TICKS, 7)."""
        mujoco = require_mujoco()
        from mujoco import rollout

        model = self._model(mujoco)
        data = mujoco.MjData(model)
        steps = round(PERIOD / TICKS / model.opt.timestep)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        start = np.zeros((len(joints), size))  # time, angles, speeds, then what this model leaves empty
        start[:, 1 : 1 + N_JOINTS], start[:, 1 + N_JOINTS : 1 + 2 * N_JOINTS] = joints, speeds
        found = np.empty((len(joints), 2 * N_JOINTS))
        for low in range(0, len(joints), AT_A_TIME):
            part = slice(low, low + AT_A_TIME)
            control = np.repeat(references[part], steps, axis=1)
            states, _ = rollout.rollout(model, data, start[part], control)
            found[part] = states[:, -1, 1 : 1 + 2 * N_JOINTS]
        return found[:, :N_JOINTS], found[:, N_JOINTS:]

    def _model(self, mujoco: Any) -> Any:
        """The compiled arm with this task's payload, friction and gain."""
        model = mujoco.MjModel.from_xml_string(arm_xml())
        hand = model.body("end_effector").id
        model.body_mass[hand] += self.payload
        model.body_inertia[hand] += 0.4 * self.payload * 0.05**2  # a ball of 5 cm
        model.dof_frictionloss[:] = self.friction
        model.actuator_gainprm[:, 0] *= self.gain
        model.actuator_biasprm[:, 1:3] *= self.gain
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model
