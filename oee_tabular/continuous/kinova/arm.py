"""The simulated arm: a Kinova Gen3 of MuJoCo (extra ``mujoco``), as the simulator and, perturbed, as the target."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.kinova.dynamics import (
    COMMANDS,
    HOME,
    N_JOINTS,
    PERIOD,
    SPEED,
    HandTask,
    arm_xml,
    end_effector,
    goal_number,
    resolved_rates,
)
from oee_tabular.continuous.kinova.hand import KinovaHand, fit_hand
from oee_tabular.continuous.task import Moves

TICKS = 10  # updates of the joint reference in a period
FEED_FORWARD = np.array([0.05] * 4 + [0.1] * 3)  # s, kv / kp: servos damp the speed's error
START = 0.01  # rad: how exactly the arm returns to its home pose
JOINT_STATES = tuple(f"{kind}_{k}" for kind in ("joint", "speed", "reference") for k in range(1, N_JOINTS + 1))
AT_A_TIME = 2048  # states whose trajectories MuJoCo returns in one array
LIMITS = {
    "velocity_scale": (0.0, 3.0), "latency": (0.0, PERIOD), "payload": (0.0, 4.0), "friction": (0.0, 9.0),
    "gain": (0.05, 5.0), "encoder_noise": (0.0, 0.1),
}  # fmt: skip
STAND_IN = "simulated stand-in, not a robot"


def require_mujoco() -> Any:
    """The module ``mujoco``, or an ImportError that names the extra."""
    try:
        import mujoco
    except ImportError:
        raise ImportError("mujoco is not installed: pip install 'oee-tabular[mujoco]'") from None
    return mujoco


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
        for name, (low, high) in LIMITS.items():
            _checks.number_in(getattr(self, name), name, low, high)

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

    def on_features(self) -> KinovaHand:
        """The hand's position as a process of its own."""
        return fit_hand(self)

    def parameters(self) -> dict[str, Any]:
        """All of them, and that this is no robot."""
        return {"data": STAND_IN} | {name: getattr(self, name) for name in ("goal", *LIMITS)}

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
        model = mujoco.MjModel.from_xml_string(arm_xml())
        hand = model.body("end_effector").id
        model.body_mass[hand] += self.payload
        model.body_inertia[hand] += 0.4 * self.payload * 0.05**2  # a ball of 5 cm
        model.dof_frictionloss[:] = self.friction
        model.actuator_gainprm[:, 0] *= self.gain
        model.actuator_biasprm[:, 1:3] *= self.gain
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model
