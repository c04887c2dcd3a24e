"""Where numbered states lie among the features: vertices of a grid, cells of centres; and the points that stand for noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import canonical
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_probabilities

ENTRIES_AT_A_TIME = 4_000_000  # of a matrix under construction: bounds the memory


class Cells(Protocol):
    """Where the numbered states lie among the features: a grid's vertices, or centres."""

    @property
    def n_cells(self) -> int:
        """How many there are."""

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) how each point is shared out; rows sum to 1, points outside go to the nearest face."""

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points lie outside what the cells describe."""

    def extent(self) -> str:
        """What they describe, in words."""

    def arrays(self) -> dict[str, Any]:
        """What a file needs to make them again."""


class Places:
    """Cells of a task, and states that stand for them: ``points`` (m, d), each in the cell ``point_cell`` (m,)."""

    task: ContinuousTask
    cells: Cells
    points: Array
    point_cell: IntArray

    @property
    def over(self) -> int | None:
        """The number of the absorbing state in which episodes end, None where they do not."""
        return self.cells.n_cells if self.task.terminates else None

    def mean(self, values: Array) -> Array:
        """(n_cells,) the mean over each cell of values (m,), one for each point."""
        n = np.bincount(self.point_cell, minlength=self.cells.n_cells)
        return np.asarray(np.bincount(self.point_cell, values, self.cells.n_cells) / n)

    def policy(self, function: StatePolicy) -> Array:
        """(S, A) the policy function in each state: its mean over the points of the cell; uniform where it is over."""
        n_actions = self.task.n_actions
        at_points = check_probabilities(function, self.points, n_actions)
        table = np.full((self.cells.n_cells + self.task.terminates, n_actions), 1.0 / n_actions)
        for a in range(n_actions):
            table[: self.cells.n_cells, a] = self.mean(at_points[:, a])
        return np.asarray(table / table.sum(axis=1, keepdims=True))


def begins(task: ContinuousTask, cells: Cells) -> Array:
    """(S,) where episodes begin, on the cells and, where they can end, the state that is over."""
    starts, mass = task.initial_points()
    initial = np.zeros(cells.n_cells + task.terminates)
    initial[: cells.n_cells] = cells.weights(task.features(starts)).T @ mass
    return np.asarray(initial / initial.sum())


@dataclass(frozen=True, eq=False)
class Grid:
    """The vertices of a regular grid, numbered in C order.

    ``shape`` vertices from ``low`` to ``high`` along each coordinate; along a periodic one ``high`` is ``low`` again.
    """

    low: Array
    high: Array
    shape: tuple[int, ...]
    periodic: tuple[bool, ...]

    @property
    def n_cells(self) -> int:
        """The number of vertices."""
        return math.prod(self.shape)

    @property
    def spacing(self) -> Array:
        """(k,) distance between neighbouring vertices."""
        parts = np.array(self.shape) - np.where(self.periodic, 0, 1)
        return np.asarray((self.high - self.low) / parts)

    def vertices(self, numbers: IntArray | None = None) -> Array:
        """(n, k) where the vertices with these numbers (default: all) lie."""
        asked = np.arange(self.n_cells) if numbers is None else numbers
        return np.asarray(self.low + np.stack(np.unravel_index(asked, self.shape), axis=1) * self.spacing)

    def locate(self, features: Array) -> tuple[IntArray, Array, BoolArray]:
        """Lower corner (n, k), place in the cell (n, k) and outside (n,) of each point."""
        from oee_tabular.continuous import _grid

        points = np.ascontiguousarray(features, dtype=np.float64)
        found: tuple[IntArray, Array, BoolArray] = _grid.locate(
            points, self.low, self.spacing, np.array(self.shape), np.array(self.periodic)
        )
        return found

    def interpolate(self, features: Array) -> tuple[IntArray, Array]:
        """The 2^k vertices around each point and their weights, both (n, 2^k)."""
        from oee_tabular.continuous import _grid

        corner, fraction, _ = self.locate(features)
        found: tuple[IntArray, Array] = _grid.vertices_of(
            corner, fraction, np.array(self.shape), np.array(self.periodic)
        )
        return found

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) multilinear weights."""
        numbers, weights = self.interpolate(features)
        starts = np.arange(len(numbers) + 1) * numbers.shape[1]
        matrix = sparse.csr_array((weights.ravel(), numbers.ravel(), starts), shape=(len(numbers), self.n_cells))
        return canonical(matrix, drop_zeros=True)

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points lie beyond the faces."""
        return self.locate(features)[2]

    def extent(self) -> str:
        """Shape and range."""
        ranges = " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(self.low, self.high, strict=True))
        return f"the {' x '.join(map(str, self.shape))} grid on {ranges}"

    def arrays(self) -> dict[str, Any]:
        """For a file."""
        return {
            "grid_low": self.low,
            "grid_high": self.high,
            "grid_shape": np.array(self.shape),
            "grid_periodic": np.array(self.periodic),
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, Any]) -> Self:
        """From ``arrays()``; ValueError for what is no grid."""
        low, high = (_checks.float_array(arrays[name], name, ndim=1) for name in ("grid_low", "grid_high"))
        shape, periodic = arrays["grid_shape"], arrays["grid_periodic"]
        if not low.shape == high.shape == shape.shape == periodic.shape or not 0 < low.size < 32:
            raise ValueError("grid_low, grid_high, grid_shape and grid_periodic must have a number for each coordinate")
        if shape.dtype.kind not in "iu" or shape.min() < 2 or periodic.dtype.kind != "b":
            raise ValueError("grid_shape must be integers of at least 2, grid_periodic booleans")
        if not np.all((low < high) & np.isfinite(high - low)):
            raise ValueError("grid_low must be finite and below grid_high")
        return cls(low, high, tuple(shape.tolist()), tuple(periodic.tolist()))


@dataclass(frozen=True, eq=False)
class VoronoiCells:
    """The cells of ``centres`` (n, k) under the distance |x - y| / scale, with the largest distance that was seen."""

    centres: Array
    scale: Array
    radius: float

    @cached_property
    def _tree(self) -> Any:
        return cKDTree(self.centres / self.scale)

    @property
    def n_cells(self) -> int:
        """The number of centres."""
        return len(self.centres)

    def nearest(self, features: Array) -> tuple[IntArray, Array]:
        """The cell of each point, and its distance from the centre."""
        distance, number = self._tree.query(features / self.scale)
        return np.asarray(number, dtype=np.int64), np.asarray(distance)

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) 1 in the point's cell."""
        number = self.nearest(features)[0]
        n = len(number)
        return sparse.csr_array((np.ones(n), number, np.arange(n + 1)), shape=(n, self.n_cells))

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points are farther from every centre than any visited state was."""
        return np.asarray(self.nearest(features)[1] > self.radius)

    def extent(self) -> str:
        """Number of cells and reach."""
        return f"the {self.n_cells} cells of visited states (reach {self.radius:.3g})"

    def arrays(self) -> dict[str, Any]:
        """For a file."""
        return {"cell_centres": self.centres, "cell_scale": self.scale, "cell_radius": np.array(self.radius)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, Any]) -> Self:
        """From ``arrays()``; ValueError for what is no such cells."""
        centres = _checks.float_array(arrays["cell_centres"], "cell_centres", ndim=2)
        scale = _checks.float_array(arrays["cell_scale"], "cell_scale", ndim=1)
        _checks.require_finite(centres, "cell_centres")
        if centres.size == 0 or scale.shape != centres.shape[1:] or not np.all((scale > 0) & np.isfinite(scale)):
            raise ValueError(f"cell_scale must be {centres.shape[1]} positive numbers, and cell_centres not be empty")
        return cls(centres, scale, _checks.number_in(arrays["cell_radius"], "cell_radius", 0.0, np.inf))


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


def each_action(task: ContinuousTask, states: Array) -> tuple[Array, IntArray]:
    """Each state under each action, in rows s*A + a."""
    return np.repeat(states, task.n_actions, axis=0), np.tile(np.arange(task.n_actions), len(states))
