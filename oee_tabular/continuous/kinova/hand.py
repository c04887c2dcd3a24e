"""The arm as a process of its hand's position alone.

    x' = x + D_a(x) + L_a xi,     D_a(x) = B_a (1, z, z z^T),   z = (x - x_home) / reach

The displacement D_a of a command is fitted by least squares to what the arm does from states that it visits (its joints as
they then are, moving or at rest), under every command; L_a L_a^T is the covariance of what is left: mostly whether the hand
was moving already. This closes the process over 3 of 27 coordinates; what that costs is measured by Monte Carlo of the arm
itself, which stands beside the discretised values wherever they are shown.
"""

from __future__ import annotations

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
    GOALS,
    REACH,
    STEP,
    HandTask,
    goal_number,
)
from oee_tabular.continuous.kinova.logs import kinova_policy
from oee_tabular.continuous.task import Moves

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
