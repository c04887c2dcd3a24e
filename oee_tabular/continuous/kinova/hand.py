"""The hand: its controller, logged trajectories of an arm as a log of the hand's positions, and a model of it.

A log of a real arm comes as a table (CSV, parquet or npz: columns state_0, ..., next_state_0, ...,
action or action_0, ..., episode; one command a row) or as a Minari data set with continuous observations. A state is the
hand's position in m (3), the joints' angles in rad (7: forward kinematics give the position), or a whole state of the
stand-in (27, of which the first three are the position).

The model is the arm as a process of its hand's position alone.

    x' = x + D_a(x) + L_a xi,     D_a(x) = B_a (1, z, z z^T),   z = (x - x_home) / reach

The displacement D_a of a command is fitted by least squares to what the arm does from states that it visits (its joints as
they then are, moving or at rest), under every command; L_a L_a^T is the covariance of what is left: mostly whether the hand
was moving already. This closes the process over 3 of 27 coordinates; what that costs is measured by Monte Carlo of the arm
itself, which stands beside the discretised values wherever they are shown.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization.places import each_action
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.kinova.dynamics import (
    CENTER,
    COMMANDS,
    DEAD_BAND,
    GOALS,
    N_ARM_STATES,
    N_JOINTS,
    REACH,
    STEP,
    HandTask,
    end_effector,
    goal_number,
)
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import Moves


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


FACTORS = (0.5, 1.5)  # on the displacements of the other hands of the defensive simulator
WIDER = 2.0  # its scatter beside the simulator's
EXPLORED = (0.0, 0.3, 0.6, 1.0)  # deltas of the policies whose states are looked at


@dataclass(frozen=True, eq=False)
class KinovaHand(HandTask):
    """The position of the (simulated) arm's hand as a process of its own; made by ``fit_hand``.

    Attributes
    ----------
    coefficients : (27, 10, 3) in m, of 1, z and the products of z, for each command
    scatter : (27, 3, 3) in m, L_a: what the position alone does not tell
    starts : (n, 3) in m, positions at which episodes begin
    source : the arm's parameters
    goal : row of GOALS; r(x) = -|x - goal|
    noise_points : Gauss-Hermite points of the scatter on a grid
    name : says that it is a stand-in

    Examples
    --------
    >>> hand = ideal_hand(1.4, scatter=0.0)
    >>> shift = hand.moves(CENTER[None], np.array([26]), np.zeros((1, 3))).next_state[0] - CENTER
    >>> (shift / STEP).round(3).tolist()
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
        object.__setattr__(self, "goal", goal_number(self.goal))

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One command: O(n)."""
        chosen = np.asarray(actions, dtype=np.int64)
        shift = np.empty((len(states), 3))
        for a in range(len(COMMANDS)):
            rows = chosen == a
            shift[rows] = basis(states[rows]) @ self.coefficients[a] + disturbance[rows] @ self.scatter[a].T
        return Moves(states + shift, self.costs(states), np.zeros(len(states), dtype=np.bool_))

    def others(self) -> tuple[KinovaHand, ...]:
        """Hands that go half and one and a half times as far, with twice the scatter: a target may lie between."""
        return tuple(
            replace(
                self, coefficients=factor * self.coefficients, scatter=WIDER * self.scatter, noise_points=2,
                source=self.source | {"scaled": factor, "scatter": WIDER},
            )
            for factor in FACTORS
        )  # fmt: skip

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Some of ``starts``."""
        return np.asarray(self.starts[rng.integers(len(self.starts), size=n)])

    def initial_points(self) -> tuple[Array, Array]:
        """``starts``, equally likely."""
        return self.starts, np.full(len(self.starts), 1.0 / len(self.starts))

    def parameters(self) -> dict[str, Any]:
        """Those of the arm that it was fitted to."""
        return self.source | {"goal": self.goal}


def ideal_hand(scale: float = 1.0, *, scatter: float = 0.05) -> KinovaHand:
    """A hand that every command moves by ``scale`` steps, with a scatter of ``scatter`` steps, without MuJoCo."""
    coefficients = np.zeros((len(COMMANDS), 10, 3))
    coefficients[:, 0] = _checks.number_in(scale, "scale", 0.0, 3.0) * STEP * COMMANDS
    spread = _checks.number_in(scatter, "scatter", 0.0, 1.0) * STEP * np.eye(3)
    source = {"ideal": True, "scale": scale, "scatter": scatter}
    return KinovaHand(coefficients, np.broadcast_to(spread, (len(COMMANDS), 3, 3)), CENTER[None], source)


def basis(states: Array) -> Array:
    """(n, 10): 1, z, and the products of z, in units of the workspace; held fixed outside of it."""
    z = np.clip((states - CENTER) / REACH, -1.0, 1.0)
    x, y, w = z.T
    return np.stack([np.ones(len(z)), x, y, w, x * x, y * y, w * w, x * y, x * w, y * w], axis=1)


@one_thread
def fit_hand(arm: HandTask, *, n_states: int = 500, seed: Any = 0) -> KinovaHand:
    """D_a and L_a from ``n_states`` states that the arm visits, each stepped under all 27 commands.

    Parameters
    ----------
    arm : KinovaArm, which needs MuJoCo; or a KinovaHand, to see what the fit finds of a hand that is known
    n_states : how many states are stepped, at most; 27 n_states commands of the arm, some seconds by default
    seed : the same seed gives the same bits

    Examples
    --------
    >>> found = fit_hand(ideal_hand(1.4, scatter=0.0), n_states=100)
    >>> (found.coefficients[26, 0] / STEP).round(3).tolist(), found.coefficients.shape
    ([1.4, 1.4, 1.4], (27, 10, 3))
    """
    wanted = _checks.positive_integer(n_states, "n_states")
    rng = _checks.generator(seed)
    each = max(1, -(-wanted // (25 * len(GOALS) * len(EXPLORED)))) + 1
    visited = [
        record(arm.towards(g), kinova_policy(g, delta), n_episodes=each, max_steps=25, seed=rng).state
        for g in range(len(GOALS))
        for delta in EXPLORED
    ]
    states = rng.permutation(np.concatenate(visited))[:wanted]
    rows, actions = each_action(arm, states)
    arrival = arm.step(rows, actions, rng).next_state[:, :3]
    shifts = (arrival - rows[:, :3]).reshape(len(states), len(COMMANDS), 3)
    known = basis(states[:, :3])
    coefficients = np.stack([np.linalg.lstsq(known, shifts[:, a])[0] for a in range(len(COMMANDS))])
    left = shifts - np.einsum("nk,akd->nad", known, coefficients)
    spread = np.einsum("nai,naj->aij", left, left) / max(1, len(states) - known.shape[1])
    scatter = np.linalg.cholesky(spread + 1e-14 * np.eye(3))
    starts = arm.initial_states(2000, rng)[:, :3]
    return KinovaHand(coefficients, scatter, starts, arm.parameters(), arm.goal)
