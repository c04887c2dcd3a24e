"""Where a continuous task is stepped, and the rows of transition probabilities that follow.

A builder chooses cells among the features, and state-action pairs x_1, ..., x_m at which the task is stepped. The row of the
numbered pair (i, a) is the weighted mean of where those lead,

    P(j | i, a) = sum_k W_{(i,a),k} E_xi[ w_j(f(x_k, xi)) ],      r(i, a) = sum_k W_{(i,a),k} E_xi[ r(x_k, xi) ],

w_j the weight of cell j at a point. Another task stepped at the same places has the same states; a ratio between the two
differs from 1 by their dynamics alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._progress import progress_bar
from oee_tabular.continuous.task import ContinuousTask

PLACES_AT_A_TIME = 250_000  # bounds the memory


class Cells(Protocol):
    """Where the numbered states lie among the features: the vertices of a grid, or centres."""

    @property
    def n_cells(self) -> int:
        """How many there are."""

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) how each point is shared out; rows sum to 1, points outside go to the nearest place inside."""

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points lie outside what the cells describe."""

    def neighbourhood(self, task: ContinuousTask, reach: int) -> sparse.csr_array:
        """(n_cells, S) rows that are uniform over what lies within ``reach`` of each cell."""

    def extent(self) -> str:
        """What they describe, in words."""


@dataclass(frozen=True, eq=False)
class Places:
    """Cells, the state-action pairs that are stepped, and how a row is the mean of them.

    Attributes
    ----------
    cells : where the numbered states lie
    states, actions : (m, d), (m,) the pairs that are stepped
    averages : csr (n_cells * A, m), W; None where pair k is row k
    points, point_cell : (p, d), (p,) states that stand for the cells: policies and costs are means over them
    noise_points : Gauss-Hermite points of each disturbance; None: the stepped task's
    is_drawn : whether each pair has one random draw of them in place of those points
    seed : of the draws
    facts : how they were chosen: plain numbers and words
    """

    cells: Cells
    states: Array
    actions: IntArray
    averages: sparse.csr_array | None
    points: Array
    point_cell: IntArray
    noise_points: int | tuple[int, ...] | None
    is_drawn: bool
    seed: Any
    facts: dict[str, Any]

    def mean(self, values: Array) -> Array:
        """(n_cells,) the mean over each cell of values (p,), one for each point."""
        n = np.bincount(self.point_cell, minlength=self.cells.n_cells)
        return np.asarray(np.bincount(self.point_cell, values, self.cells.n_cells) / n)

    def step(self, task: ContinuousTask) -> tuple[sparse.csr_array, Array]:
        """Rows (n_cells * A, S) and rewards (n_cells, A) of a task."""
        noise = None if self.is_drawn else task.noise_points if self.noise_points is None else self.noise_points
        rng = _checks.generator(self.seed)
        blocks, paid = [], []
        for low in progress_bar("stepping", range(0, len(self.states), PLACES_AT_A_TIME)):
            part = slice(low, low + PLACES_AT_A_TIME)
            arrival, rewards = self._step_part(task, self.states[part], self.actions[part], noise, rng)
            blocks.append(arrival)
            paid.append(rewards)
        matrix = blocks[0] if len(blocks) == 1 else sparse.csr_array(sparse.vstack(blocks, format="csr"))
        every = np.concatenate(paid)
        if self.averages is not None:
            matrix, every = sparse.csr_array(self.averages @ matrix), np.asarray(self.averages @ every)
        return matrix, every.reshape(-1, task.n_actions)

    def _step_part(
        self,
        task: ContinuousTask,
        states: Array,
        actions: IntArray,
        noise: int | tuple[int, ...] | None,
        rng: np.random.Generator,
    ) -> tuple[sparse.csr_array, Array]:
        gone = task.terminated(states)
        total: Any = 0.0
        paid = np.zeros(len(states))
        for disturbance, chance in _disturbances(len(states), task.n_disturbances, noise, rng):
            moved = task.moves(states, actions, disturbance)
            bad = np.flatnonzero(~np.isfinite(moved.next_state).all(axis=1))
            if bad.size:
                raise ValueError(
                    f"task must step to finite states; from {states[bad[0]].tolist()} under action {actions[bad[0]]} it "
                    f"steps to {moved.next_state[bad[0]].tolist()}"
                )
            ended = moved.terminated & task.end_shows(moved.next_state) | gone
            total = total + chance * weights_of(self.cells, task, moved.next_state, ended)
            paid += chance * np.where(gone, 0.0, moved.reward)
        return sparse.csr_array(total), paid


def weights_of(cells: Cells, task: ContinuousTask, states: Array, ended: BoolArray) -> sparse.csr_array:
    """(n, S) how states are shared out among the numbered ones; what has ended lies in the absorbing state, the last."""
    inner = cells.weights(task.features(states))
    if not task.terminates:
        return inner
    inner = sparse.csr_array(sparse.diags_array(np.where(ended, 0.0, 1.0)) @ inner)
    inner.eliminate_zeros()
    found = sparse.csr_array(sparse.hstack([inner, sparse.csr_array(ended[:, None].astype(np.float64))]))
    found.sort_indices()
    return found


def each_action(task: ContinuousTask, states: Array) -> tuple[Array, IntArray]:
    """Each state under each action, in rows s*A + a."""
    return np.repeat(states, task.n_actions, axis=0), np.tile(np.arange(task.n_actions), len(states))


def _disturbances(
    n: int, size: int, noise: int | tuple[int, ...] | None, rng: np.random.Generator
) -> Iterator[tuple[Array, float]]:
    """Disturbances (n, size) with their probabilities: quadrature points, the same for all pairs, or a draw for each."""
    if noise is None:
        yield rng.standard_normal((n, size)), 1.0
        return
    for node, chance in zip(*gauss_hermite(noise, size), strict=True):
        yield np.broadcast_to(node, (n, size)), float(chance)


def gauss_hermite(points: int | tuple[int, ...], n: int) -> tuple[Array, Array]:
    """Nodes (m, n) and weights (m,) that average over N(0, I_n): exact for polynomials of degree 2 points - 1.

    >>> nodes, weights = gauss_hermite((3, 1), 2)
    >>> round(float(weights @ nodes[:, 0] ** 4), 12), float(abs(nodes[:, 1]).max())
    (3.0, 0.0)
    """
    counts = (points,) * n if isinstance(points, int) else tuple(points)
    if len(counts) != n:
        raise ValueError(
            f"noise_points must be a number or {n} numbers, one for each disturbance; it is {_checks.show(points)}"
        )
    lines = [np.polynomial.hermite_e.hermegauss(_checks.positive_integer(count, "noise_points")) for count in counts]
    if not lines:
        return np.zeros((1, 0)), np.ones(1)
    nodes = np.stack(np.meshgrid(*(line[0] for line in lines), indexing="ij"), axis=-1).reshape(-1, n)
    weights = np.ones(1)
    for line in lines:
        weights = np.multiply.outer(weights, line[1] / line[1].sum()).ravel()
    return nodes, weights
