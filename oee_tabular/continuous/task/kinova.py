"""A simulated stand-in for the paper's robot, a Kinova Gen3 that reaches five goals.

It is the task of Section VI.D and Table I. **It is not the robot, and its target is not
reality**: no data of the arm was ever published. ``KinovaArm`` simulates it with MuJoCo
(extra ``mujoco``) from the manufacturer's published geometry and masses, with assumed
servos; the same arm with another ``velocity_scale``, latency, payload, friction, gain
or encoder noise plays the target. Payload, gain and friction change the value by less
than 1 %, since the servos are stiff and gravity is compensated; what a task of
Cartesian commands notices is how far a command moves the hand. ``hand_log`` and
``load_kinova_log`` take what a real arm would log.

    simulator = discretize(KinovaArm(), floor=0.1)  # a FiniteMDP of the hand's position
    # 50 trajectories of T = 25
    log = record_goals(KinovaArm(velocity_scale=1.4), n_runs=10, seed=0)
    counts, uncovered = simulator.supported(simulator.counts(log))
    tie = simulator.displacement_ties()
    zeta = oee_tabular.transition_ratio(counts, simulator.mdp, tie=tie, strength=3.0)

Without MuJoCo everything imports; what simulates the arm raises an ImportError that
names the extra.

``KinovaHand`` is the arm as a process of its hand's position alone,

    x' = x + D_a(x) + L_a xi,
    D_a(x) = B_a (1, z, z z^T),   z = (x - x_home) / reach

The displacement D_a of a command is fitted by least squares to what the arm does from
states that it visits (its joints as they then are, moving or at rest), under every
command; L_a L_a^T is the covariance of what is left: mostly whether the hand was moving
already. This closes the process over 3 of 27 coordinates; what that costs is measured
by Monte Carlo of the arm itself, which stands beside the discretised values wherever
they are shown.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular.continuous.discretization.cells import each_action
from oee_tabular.continuous.task import gen3
from oee_tabular.continuous.task.base import Moves
from oee_tabular.continuous.task.episodes import record
from oee_tabular.continuous.task.gen3 import (
    COMMANDS,
    GOALS,
    HOME,
    HORIZON,
    KinovaPolicy,
    end_effector,
    hand_log,
    kinova_policy,
    load_kinova_log,
    record_goals,
)
from oee_tabular.typing import Array, IntArray, Seed

__all__ = [
    "COMMANDS",
    "GOALS",
    "HOME",
    "HORIZON",
    "STAND_IN",
    "KinovaArm",
    "KinovaHand",
    "KinovaPolicy",
    "end_effector",
    "fit_hand",
    "hand_log",
    "ideal_hand",
    "kinova_policy",
    "load_kinova_log",
    "record_goals",
]

# The other hands of the defensive simulator have these multiples of the displacements.
FACTORS = (0.5, 1.5)
SCATTER_FACTOR = 2.0  # the multiple of the scatter that these hands have
# the shares of random commands of the policies that visit the states for a fit
VISITING_DELTAS = (0.0, 0.3, 0.6, 1.0)
N_TICKS = 10  # updates of the joint reference in a period
# s, kv / kp: servos damp the speed's error
FEED_FORWARD = np.repeat([0.05, 0.1], [4, 3])
START = 0.01  # rad: how exactly the arm returns to its home pose
JOINT_STATES = tuple(
    f"{kind}_{k}"
    for kind in ("joint", "speed", "reference")
    for k in range(1, gen3.N_JOINTS + 1)
)
N_STATES_AT_A_TIME = 2048  # MuJoCo returns their trajectories in one array
LIMITS = {
    "velocity_scale": (0.0, 3.0),
    "latency": (0.0, gen3.PERIOD),
    "payload": (0.0, 4.0),
    "friction": (0.0, 9.0),
    "gain": (0.05, 5.0),
    "encoder_noise": (0.0, 0.1),
}
STAND_IN = "simulated stand-in, not a robot"


@checked(
    shapes={"coefficients": "a k x", "scatter": "a x x", "starts": "n x"},
)
@dataclass(frozen=True, eq=False)
class KinovaHand(gen3.HandTask):
    """The position of the (simulated) arm's hand as a process of its own.

    ``fit_hand`` makes it. The state is the position (x, y, z) in m, the actions are 27
    commands of 0.2 s, the reward is minus the distance from the goal in m. Episodes do
    not end.

    Attributes
    ----------
    coefficients : ndarray of shape (27, 10, 3)
        The coefficients, in m, of 1, z and the products of z for each command.
    scatter : ndarray of shape (27, 3, 3)
        L_a of each command, in m: what the position alone does not tell.
    starts : ndarray of shape (n, 3)
        Positions in m at which episodes begin.
    source : dict
        The arm's parameters.
    goal : int
        The goal, a row of GOALS; r(x) = -abs(x - goal).
    noise_points : int
        The number of Gauss-Hermite points of the scatter on a grid.
    name : str
        A name that says that it is a stand-in.

    Examples
    --------
    >>> hand = ideal_hand(1.4, scatter=0.0)
    >>> shift = (
    ...     hand.moves(gen3.CENTER[None], np.array([26]), np.zeros((1, 3))).next_state[
    ...         0
    ...     ]
    ...     - gen3.CENTER
    ... )
    >>> (shift / gen3.STEP).round(3).tolist()
    [1.4, 1.4, 1.4]
    """

    state_names = ("x", "y", "z")
    n_disturbances = 3

    coefficients: Array
    scatter: Array
    starts: Array
    source: dict[str, Any]
    goal: int = 0
    noise_points: int = 1
    name: str = field(default="Kinova hand (simulated stand-in)", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "goal", gen3.goal_number(self.goal))
        _checks.positive_integer(self.noise_points, "noise_points")

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Carry out one command from each state.

        Parameters
        ----------
        states : ndarray of shape (n, 3)
            The positions in m.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        disturbance : ndarray of shape (n, 3)
            The disturbance xi, drawn from N(0, I).

        Returns
        -------
        Moves
            The next states and the rewards; no state is terminal.

        Notes
        -----
        Costs O(n).
        """
        chosen = np.asarray(actions, dtype=np.int64)
        shift = np.empty((len(states), 3))
        for a in range(len(COMMANDS)):
            rows = chosen == a
            noise = disturbance[rows] @ self.scatter[a].T
            shift[rows] = basis(states[rows]) @ self.coefficients[a] + noise
        never = np.zeros(len(states), dtype=np.bool_)
        return Moves(states + shift, self.costs(states), never)

    def others(self) -> tuple[KinovaHand, ...]:
        """Return hands that go half and one and a half times as far.

        Returns
        -------
        tuple of KinovaHand
            The hands, with twice the scatter: a target may lie between.
        """
        scatter = SCATTER_FACTOR * self.scatter
        wider = replace(self, scatter=scatter, noise_points=2)
        hands = []
        for factor in FACTORS:
            source = self.source | {"scaled": factor, "scatter": SCATTER_FACTOR}
            coefficients = factor * self.coefficients
            hands.append(replace(wider, coefficients=coefficients, source=source))
        return tuple(hands)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw some of ``starts``.

        Parameters
        ----------
        n : int
            How many states are drawn.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        ndarray of shape (n, 3)
            The positions in m.
        """
        return np.asarray(self.starts[rng.integers(len(self.starts), size=n)])

    def initial_points(self) -> tuple[Array, Array]:
        """Return ``starts``, with equal weights.

        Returns
        -------
        states : ndarray of shape (m, 3)
            The positions in m.
        weights : ndarray of shape (m,)
            The weights, which sum to 1.
        """
        return self.starts, np.full(len(self.starts), 1.0 / len(self.starts))

    def parameters(self) -> dict[str, Any]:
        """Return the parameters of the arm to which it was fitted, and the goal.

        Returns
        -------
        dict
            The parameters.
        """
        return self.source | {"goal": self.goal}


def ideal_hand(scale: float = 1.0, *, scatter: float = 0.05) -> KinovaHand:
    """Return a hand that every command moves by ``scale`` steps, without MuJoCo.

    Its scatter is ``scatter`` steps.
    """
    coefficients = np.zeros((len(COMMANDS), 10, 3))
    factor = _checks.number_in(scale, "scale", 0.0, 3.0)
    coefficients[:, 0] = factor * gen3.STEP * COMMANDS
    share = _checks.number_in(scatter, "scatter", 0.0, 1.0)
    spread = share * gen3.STEP * np.eye(3)
    source = {"ideal": True, "scale": scale, "scatter": scatter}
    return KinovaHand(
        coefficients,
        np.broadcast_to(spread, (len(COMMANDS), 3, 3)),
        gen3.CENTER[None],
        source,
    )


def basis(states: Array) -> Array:
    """Return 1, z, and the products of z, in units of the workspace, (n, 10).

    They are held fixed outside of it.
    """
    z = np.clip((states - gen3.CENTER) / gen3.REACH, -1.0, 1.0)
    x, y, w = z.T
    return np.stack(
        [np.ones(len(z)), x, y, w, x * x, y * y, w * w, x * y, x * w, y * w], axis=1
    )


@suggest_keywords
@one_thread
def fit_hand(arm: gen3.HandTask, *, n_states: int = 500, seed: Seed = 0) -> KinovaHand:
    """Fit D_a and L_a to states of the arm, each stepped under all 27 commands.

    Parameters
    ----------
    arm : KinovaArm or KinovaHand
        The arm, which needs MuJoCo; or a KinovaHand, to see what the fit finds of a
        hand that is known.
    n_states : int, default 500
        How many states are stepped, at most.
    seed : int, Generator or SeedSequence, default 0
        The source of random numbers, by default 0. The same seed gives the same bits.

    Returns
    -------
    KinovaHand
        The hand as a process of its own.

    Raises
    ------
    ValueError
        If ``n_states`` is not a positive integer.

    Notes
    -----
    Costs 27 n_states commands of the arm, some seconds by default.

    Examples
    --------
    >>> found = fit_hand(ideal_hand(1.4, scatter=0.0), n_states=100)
    >>> (
    ...     (found.coefficients[26, 0] / gen3.STEP).round(3).tolist(),
    ...     found.coefficients.shape,
    ... )
    ([1.4, 1.4, 1.4], (27, 10, 3))
    """
    _checks.instance(arm, gen3.HandTask, "arm", "KinovaArm or KinovaHand")
    wanted = _checks.positive_integer(n_states, "n_states")
    rng = _checks.generator(seed)
    n_runs = len(GOALS) * len(VISITING_DELTAS)
    each = max(1, -(-wanted // (HORIZON * n_runs))) + 1
    visited = []
    for g, delta in itertools.product(range(len(GOALS)), VISITING_DELTAS):
        policy = kinova_policy(g, delta)
        log = record(
            arm.towards(g), policy, n_episodes=each, max_steps=HORIZON, seed=rng
        )
        visited.append(log.state)
    states = rng.permutation(np.concatenate(visited))[:wanted]
    rows, actions = each_action(arm, states)
    arrival = arm.step(rows, actions, rng).next_state[:, :3]
    shifts = (arrival - rows[:, :3]).reshape(len(states), len(COMMANDS), 3)
    known = basis(states[:, :3])
    coefficients = np.stack(
        [np.linalg.lstsq(known, shifts[:, a])[0] for a in range(len(COMMANDS))]
    )
    left = shifts - np.einsum("nk,akd->nad", known, coefficients)
    n_free = max(1, len(states) - known.shape[1])  # degrees of freedom
    spread = np.einsum("nai,naj->aij", left, left) / n_free
    scatter = np.linalg.cholesky(spread + 1e-14 * np.eye(3))
    starts = arm.initial_states(2000, rng)[:, :3]
    return KinovaHand(coefficients, scatter, starts, arm.parameters(), arm.goal)


@suggest_keywords
@dataclass(frozen=True)
class KinovaArm(gen3.HandTask):
    """The simulated Gen3 that moves its hand to a goal, in place of the real robot.

    A state has 27 coordinates: the measured position of the hand (3, m), joint angles
    (7, rad), speeds (7, rad/s) and references (7, rad), and the last command (3). Only
    the position is a feature. The 27 actions are the commands {-1, 0, 1}^3, each for
    0.2 s, a 1 standing for 0.1 m/s along an axis of the base. The reward of a state
    is::

        r(s) = -|x - goal| in m,

    x the measured position of the hand. Episodes do not end.

    Parameters
    ----------
    goal : int, default 0
        The goal, 0 to 4, a row of GOALS.
    velocity_scale : float, default 1.0
        What a commanded speed is multiplied with; 1.4 is the reference mismatch.
    latency : float, default 0.0
        For how many s, in [0, 0.2], a period begins with the command of the one before.
    payload : float, default 0.0
        The mass at the end effector in kg, which is not compensated.
    friction : float, default 0.0
        The dry friction in each joint in N m.
    gain : float, default 1.0
        The factor on the servos' stiffness and damping.
    encoder_noise : float, default 5e-4
        The standard deviation in rad of each joint's reading, from which the position
        is computed.

    Raises
    ------
    ValueError
        If a number is out of its range.

    See Also
    --------
    fit_hand : Make a model of the hand alone.
    kinova_policy : The controller, mixed with random commands.

    Notes
    -----
    A command costs 40 steps of MuJoCo: some thousand commands a second.

    Examples
    --------
    >>> arm = KinovaArm(velocity_scale=1.4)
    >>> arm.n_actions, arm.n_state, arm.actions[26].tolist()
    (27, 27, [1.0, 1.0, 1.0])
    >>> arm.parameters()["data"]
    'simulated stand-in, not a robot'
    """

    state_names = ("x", "y", "z", *JOINT_STATES, "command_x", "command_y", "command_z")
    n_disturbances = gen3.N_JOINTS

    goal: int = 0
    velocity_scale: float = 1.0
    latency: float = 0.0
    payload: float = 0.0
    friction: float = 0.0
    gain: float = 1.0
    encoder_noise: float = 5e-4
    name: str = field(default="Kinova Gen3 (simulated stand-in)", init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "goal", gen3.goal_number(self.goal))
        for name, (low, high) in LIMITS.items():
            _checks.number_in(getattr(self, name), name, low, high)

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Carry out one command from each state by 40 steps of MuJoCo each.

        Parameters
        ----------
        states : ndarray of shape (n, 27)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        disturbance : ndarray of shape (n, 7)
            Draws of N(0, I), which ``encoder_noise`` multiplies.

        Returns
        -------
        Moves
            The next states and the rewards; no state is terminal.
        """
        joints, speeds, reference, before = np.split(states[:, 3:], [7, 14, 21], axis=1)
        command = COMMANDS[np.asarray(actions, dtype=np.int64)]
        late = self.latency / gen3.PERIOD * N_TICKS
        references = np.empty((len(states), N_TICKS, gen3.N_JOINTS))
        for tick in range(N_TICKS):
            # the share of this tick in which the new command is in force
            share = min(1.0, max(0.0, tick + 1.0 - late))
            mixed = share * command + (1.0 - share) * before
            velocity = self.velocity_scale * gen3.SPEED * mixed
            rates = gen3.resolved_rates(reference, velocity)
            reference = reference + gen3.PERIOD / N_TICKS * rates
            references[:, tick] = reference + FEED_FORWARD * rates
        joints, speeds = self._follow(joints, speeds, references)
        measured = end_effector(joints + self.encoder_noise * disturbance)
        parts = [measured, joints, speeds, reference, command]
        following = np.concatenate(parts, axis=1)
        never = np.zeros(len(states), dtype=np.bool_)
        return Moves(following, self.costs(states), never)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw states at rest near the home pose.

        Parameters
        ----------
        n : int
            How many states are drawn.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        ndarray of shape (n, 27)
            The states, N(0, 0.01^2) rad in each joint from the home pose.
        """
        joints = HOME + START * rng.standard_normal((n, gen3.N_JOINTS))
        noise = self.encoder_noise * rng.standard_normal((n, gen3.N_JOINTS))
        measured = end_effector(joints + noise)
        speeds = np.zeros((n, gen3.N_JOINTS))
        parts = [measured, joints, speeds, joints, np.zeros((n, 3))]
        return np.concatenate(parts, axis=1)

    def on_features(self) -> KinovaHand:
        """Return the hand's position as a process of its own.

        Returns
        -------
        KinovaHand
            The process, fitted to the arm.
        """
        return fit_hand(self)

    def parameters(self) -> dict[str, Any]:
        """Return every parameter by name, and that this is no robot.

        Returns
        -------
        dict
            The parameters.
        """
        values = {name: getattr(self, name) for name in ("goal", *LIMITS)}
        return {"data": STAND_IN} | values

    def _follow(
        self, joints: Array, speeds: Array, references: Array
    ) -> tuple[Array, Array]:
        """Return angles and speeds after the servos have followed the references.

        These are (n, N_TICKS, 7).
        """
        try:
            import mujoco
        except ImportError:
            raise ImportError(
                "mujoco is not installed; in a clone: pip install '.[mujoco]'"
            ) from None
        from mujoco import rollout

        model = mujoco.MjModel.from_xml_string(gen3.arm_xml())
        hand = model.body("end_effector").id
        model.body_mass[hand] += self.payload
        model.body_inertia[hand] += 0.4 * self.payload * 0.05**2  # a ball of 5 cm
        model.dof_frictionloss[:] = self.friction
        model.actuator_gainprm[:, 0] *= self.gain
        model.actuator_biasprm[:, 1:3] *= self.gain
        mujoco.mj_setConst(model, mujoco.MjData(model))
        data = mujoco.MjData(model)
        steps = round(gen3.PERIOD / N_TICKS / model.opt.timestep)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        # time, angles, speeds, then what this model leaves empty
        start = np.zeros((len(joints), size))
        start[:, 1 : 1 + gen3.N_JOINTS] = joints
        start[:, 1 + gen3.N_JOINTS : 1 + 2 * gen3.N_JOINTS] = speeds
        found = np.empty((len(joints), 2 * gen3.N_JOINTS))
        for low in range(0, len(joints), N_STATES_AT_A_TIME):
            part = slice(low, low + N_STATES_AT_A_TIME)
            controls = np.repeat(references[part], steps, axis=1)
            states, _ = rollout.rollout(model, data, start[part], controls)
            found[part] = states[:, -1, 1 : 1 + 2 * gen3.N_JOINTS]
        return found[:, : gen3.N_JOINTS], found[:, gen3.N_JOINTS :]
