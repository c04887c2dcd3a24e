"""Cells among a task's features: the vertices of a ``Grid``, or ``VoronoiCells``.

Both share a point out among their cells with weights that sum to 1: the 2^k vertices
around it, so that its mean is kept, or the one cell that it lies in. They say which
points lie outside of what they describe.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular import _checks
from oee_tabular._progress import progress_bar
from oee_tabular._sparse import canonical, csr_on_pattern, row_of_entry, row_sums
from oee_tabular.continuous.task.base import ContinuousTask
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array, BoolArray, Csr, IntArray

PLACES_AT_A_TIME = 250_000  # bounds the memory


def indicator(numbers: IntArray, n: int) -> Csr:
    """Return rows (len(numbers), n) with a 1 in the column of their number."""
    size = len(numbers)
    return sparse.csr_array(
        (np.ones(size), numbers, np.arange(size + 1)), shape=(size, n)
    )


@dataclass(frozen=True, eq=False)
class Grid:
    """The vertices of a regular grid, numbered in C order.

    There are ``shape`` vertices from ``low`` to ``high`` along each coordinate; along a
    periodic one ``high`` is ``low`` again.
    """

    low: Array
    high: Array
    shape: tuple[int, ...]
    periodic: tuple[bool, ...]

    @property
    def n_cells(self) -> int:
        """Return the number of vertices."""
        return math.prod(self.shape)

    @property
    def spacing(self) -> Array:
        """Return the distance (k,) between neighbouring vertices."""
        parts = np.array(self.shape) - np.where(self.periodic, 0, 1)
        return np.asarray((self.high - self.low) / parts)

    def indices(self) -> IntArray:
        """Return the place (n_cells, k) of each vertex along each coordinate."""
        return np.stack(np.unravel_index(np.arange(self.n_cells), self.shape), axis=1)

    def vertices(self) -> Array:
        """Return where the vertices lie, (n_cells, k)."""
        return np.asarray(self.low + self.indices() * self.spacing)

    def weights(self, features: Array) -> Csr:
        """Compute multilinear weights (n, n_cells) on the vertices around each point.

        There are 2^k of these. Points outside go to the nearest inside.
        """
        n = len(features)
        shape = np.array(self.shape)
        place = (features - self.low) / self.spacing
        place = np.where(self.periodic, place % shape, np.clip(place, 0.0, shape - 1.0))
        last = shape - np.where(self.periodic, 1, 2)
        corner = np.minimum(place.astype(np.int64), last)
        fraction = place - corner
        numbers = np.zeros((n, 1), dtype=np.int64)
        weights = np.ones((n, 1))
        for axis, size in enumerate(self.shape):
            both = (corner[:, axis, None] + [0, 1]) % size
            share = np.stack([1.0 - fraction[:, axis], fraction[:, axis]], axis=1)
            n_corners = 2 ** (axis + 1)
            numbers = size * numbers[:, :, None] + both[:, None]
            numbers = numbers.reshape(n, n_corners)
            weights = (weights[:, :, None] * share[:, None]).reshape(n, n_corners)
        parts = weights.ravel(), numbers.ravel(), np.arange(n + 1) * weights.shape[1]
        matrix = sparse.csr_array(parts, shape=(n, self.n_cells))
        return canonical(matrix, drop_zeros=True)

    def outside(self, features: Array) -> BoolArray:
        """Return which points (n,) lie beyond the faces."""
        room = 1e-9 * self.spacing
        beyond = (features < self.low - room) | (features > self.high + room)
        return np.asarray((beyond & ~np.array(self.periodic)).any(axis=1))

    def extent(self) -> str:
        """Describe shape and range in words."""
        ranges = " x ".join(
            f"[{a:.4g}, {b:.4g}]" for a, b in zip(self.low, self.high, strict=True)
        )
        return f"the {' x '.join(map(str, self.shape))} grid on {ranges}"


@dataclass(frozen=True, eq=False)
class VoronoiCells:
    """The cells of ``centres`` (n, k) under the distance abs(x - y) / scale.

    ``radius`` is the largest distance from a centre that was observed.
    """

    centres: Array
    scale: Array
    radius: float

    @cached_property
    def _tree(self) -> Any:
        """Return the search tree of the scaled centres."""
        return cKDTree(self.centres / self.scale)

    @property
    def n_cells(self) -> int:
        """Return the number of centres."""
        return len(self.centres)

    def nearest(self, features: Array) -> tuple[IntArray, Array]:
        """Return the cell of each point, and its distance from the centre."""
        distance, number = self._tree.query(features / self.scale)
        return np.asarray(number, dtype=np.int64), np.asarray(distance)

    def weights(self, features: Array) -> Csr:
        """Return weights (n, n_cells), 1 in the point's cell."""
        return indicator(self.nearest(features)[0], self.n_cells)

    def outside(self, features: Array) -> BoolArray:
        """Return which points (n,) are farther off than any visited state was.

        The distance is that from the nearest centre.
        """
        return np.asarray(self.nearest(features)[1] > self.radius)

    def extent(self) -> str:
        """Describe number of cells and reach in words."""
        return f"the {self.n_cells} cells of visited states (reach {self.radius:.3g})"


@dataclass(frozen=True, eq=False)
class Places:
    """Cells, the state-action pairs that are stepped, and how rows are made of them.

    Attributes
    ----------
    cells : Grid or VoronoiCells
        Where the numbered states lie.
    states : ndarray of shape (m, d)
        The states that are stepped.
    actions : ndarray of int, shape (m,)
        The actions under which they are stepped.
    averages : csr array of shape (n_cells * A, m) or None
        The weights W of the pairs in each row. None means that pair k is row k.
    points : ndarray of shape (p, d)
        States that stand for the cells: policies and costs are means over them.
    point_cell : ndarray of int, shape (p,)
        The cell of each of these states.
    noise_points : int or None
        The number of Gauss-Hermite points of each disturbance; None means the stepped
        task's.
    seed : int or None
        The seed of one draw of the disturbances for each pair, in place of those
        points. None means no draws.
    """

    cells: Grid | VoronoiCells
    states: Array
    actions: IntArray
    averages: Csr | None
    points: Array
    point_cell: IntArray
    noise_points: int | None = None
    seed: int | None = None

    def mean(self, values: Array) -> Array:
        """Compute the mean over each cell of values (p, ...), one for each point."""
        matrix = indicator(self.point_cell, self.cells.n_cells)
        return np.asarray(((matrix.T @ values).T / matrix.sum(axis=0)).T)

    def weights(self, task: ContinuousTask, states: Array, ended: BoolArray) -> Csr:
        """Compute how states are shared out among the numbered ones, (n, S).

        Terminal states lie in the absorbing state, the last.
        """
        inner = self.cells.weights(task.features(states))
        if not task.terminates:
            return inner
        inner = sparse.csr_array(sparse.diags_array(np.where(ended, 0.0, 1.0)) @ inner)
        last = sparse.csr_array(ended[:, None].astype(np.float64))
        return canonical(sparse.hstack([inner, last]), drop_zeros=True)

    def simulate(
        self, task: ContinuousTask, initial: Array, discount: float
    ) -> FiniteMDP:
        """Return the FiniteMDP of a task that is stepped at these places."""
        rng = None if self.seed is None else np.random.default_rng(self.seed)
        parts = progress_bar("stepping", range(0, len(self.states), PLACES_AT_A_TIME))
        blocks = []
        for low in parts:
            part = slice(low, low + PLACES_AT_A_TIME)
            blocks.append(self._step(task, part, rng))
        stacked = sparse.vstack([block for block, _ in blocks], format="csr")
        matrix = sparse.csr_array(stacked)
        rewards = np.concatenate([part for _, part in blocks])
        if self.averages is not None:
            matrix = sparse.csr_array(self.averages @ matrix)
            rewards = np.asarray(self.averages @ rewards)
        rewards = rewards.reshape(-1, task.n_actions)
        if task.terminates:
            n_states = matrix.shape[1]
            stay = indicator(np.full(task.n_actions, n_states - 1), n_states)
            matrix = sparse.csr_array(sparse.vstack([matrix, stay], format="csr"))
            rewards = np.concatenate([rewards, np.zeros((1, task.n_actions))])
        return self.finite_mdp(task, matrix, rewards, initial, discount)

    def finite_mdp(
        self,
        task: ContinuousTask,
        matrix: Csr,
        expected: Array,
        initial: Array,
        discount: float,
    ) -> FiniteMDP:
        """Return the FiniteMDP of rows, which are normalised, and rewards r(s, a).

        Rewards of a task with ``reward_terms`` are those of the cells' mean terms, r(i,
        a, j): they telescope on cells as they do in the task. Taken transition by
        transition, their mean error would add up.
        """
        matrix = canonical(matrix, drop_zeros=True)
        rows = row_of_entry(matrix)
        rewards: Array | Csr = expected
        matrix = csr_on_pattern(matrix, matrix.data / row_sums(matrix)[rows], own=True)
        terms = task.reward_terms(self.points)
        if terms is not None:
            mean = self.mean(terms)
            state, action = np.divmod(rows, task.n_actions)
            between = task.reward_of(mean[state], action, mean[matrix.indices])
            first = between[matrix.indptr[:-1]]
            # rewards r(s, a) stay a small table
            if np.array_equal(between, first[rows]):
                rewards = first.reshape(expected.shape)
            else:
                rewards = csr_on_pattern(matrix, between)
        return FiniteMDP(matrix, rewards, initial, discount)

    def _step(
        self, task: ContinuousTask, part: slice, rng: np.random.Generator | None
    ) -> tuple[Csr, Array]:
        """Compute where some of the pairs lead and their rewards.

        Both are averages over the disturbances.
        """
        states = self.states[part]
        actions = self.actions[part]
        if rng is None:
            n_points = self.noise_points
            if n_points is None:
                n_points = task.noise_points
            nodes, chances = gauss_hermite(n_points, task.n_disturbances)
            draws = [np.broadcast_to(node, (len(states), len(node))) for node in nodes]
        else:
            draws = [rng.standard_normal((len(states), task.n_disturbances))]
            chances = np.ones(1)
        gone = task.terminated(states)
        total: Any = 0.0
        rewards = np.zeros(len(states))
        for disturbance, chance in zip(draws, chances, strict=True):
            moved = task.moves(states, actions, disturbance)
            bad = np.flatnonzero(~np.isfinite(moved.next_state).all(axis=1))
            if bad.size:
                raise ArgumentError(
                    "task",
                    f"must step to finite states; from {states[bad[0]].tolist()} under"
                    f" action {actions[bad[0]]} it steps to"
                    f" {moved.next_state[bad[0]].tolist()}",
                )
            ended = moved.terminated & task.end_shows(moved.next_state) | gone
            arrival = chance * self.weights(task, moved.next_state, ended)
            total = total + arrival
            rewards += chance * np.where(gone, 0.0, moved.reward)
        return sparse.csr_array(total), rewards


def gauss_hermite(points: int, n: int) -> tuple[Array, Array]:
    """Return nodes (m, n) and weights (m,) that average over N(0, I_n).

    They are exact for polynomials of degree 2 points - 1.

    >>> nodes, weights = gauss_hermite(3, 2)
    >>> round(float(weights @ nodes[:, 0] ** 4), 12), len(nodes)
    (3.0, 9)
    """
    n_points = _checks.positive_integer(points, "noise_points")
    line, chance = np.polynomial.hermite_e.hermegauss(n_points)
    nodes = np.array(list(itertools.product(line, repeat=n)))
    weights = np.array(list(itertools.product(chance / chance.sum(), repeat=n)))
    return nodes, weights.prod(axis=1)


def each_action(task: ContinuousTask, states: Array) -> tuple[Array, IntArray]:
    """Return each state under each action, in rows s*A + a."""
    return np.repeat(states, task.n_actions, axis=0), np.tile(
        np.arange(task.n_actions), len(states)
    )


def spread_over_pairs(start: Csr, actions: IntArray, n_actions: int) -> Csr:
    """Return the weights (n, S) of states as weights (n, S * A) of state-action pairs.

    The states are left by actions (n,); the pair (s, a) has the column s*A + a.
    """
    action_of_entry = np.repeat(actions, np.diff(start.indptr))
    pairs = start.indices.astype(np.int64) * n_actions + action_of_entry
    shape = (len(actions), start.shape[1] * n_actions)
    return sparse.csr_array((start.data, pairs, start.indptr), shape=shape)


def average_of_pairs(weights: Csr) -> Csr:
    """Return W (S * A, m) of the weights (m, S * A) that stepped pairs have."""
    return sparse.csr_array(sparse.diags_array(1.0 / weights.sum(axis=0)) @ weights.T)
