"""Where numbered states lie among a task's features: on the vertices of a ``Grid``, or in ``VoronoiCells`` around centres.

Both share a point out among their cells with weights that sum to 1: the 2^k vertices around it, so that its mean is kept, or
the one cell that it lies in. They say which points lie outside of what they describe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import canonical


def indicator(numbers: IntArray, n: int) -> sparse.csr_array:
    """(len(numbers), n) rows with a 1 in the column of their number."""
    size = len(numbers)
    return sparse.csr_array((np.ones(size), numbers, np.arange(size + 1)), shape=(size, n))


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

    def indices(self) -> IntArray:
        """(n_cells, k) the place of each vertex along each coordinate."""
        return np.stack(np.unravel_index(np.arange(self.n_cells), self.shape), axis=1)

    def vertices(self) -> Array:
        """(n_cells, k) where the vertices lie."""
        return np.asarray(self.low + self.indices() * self.spacing)

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) multilinear weights on the 2^k vertices around each point; points outside go to the nearest inside."""
        n, shape = len(features), np.array(self.shape)
        place = (features - self.low) / self.spacing
        place = np.where(self.periodic, place % shape, np.clip(place, 0.0, shape - 1.0))
        corner = np.minimum(place.astype(np.int64), shape - np.where(self.periodic, 1, 2))
        fraction = place - corner
        numbers, weights = np.zeros((n, 1), dtype=np.int64), np.ones((n, 1))
        for axis, size in enumerate(self.shape):
            both = (corner[:, axis, None] + [0, 1]) % size
            share = np.stack([1.0 - fraction[:, axis], fraction[:, axis]], axis=1)
            numbers = (size * numbers[:, :, None] + both[:, None]).reshape(n, -1)
            weights = (weights[:, :, None] * share[:, None]).reshape(n, -1)
        starts = np.arange(n + 1) * weights.shape[1]
        parts = (weights.ravel(), numbers.ravel(), starts)
        return canonical(sparse.csr_array(parts, shape=(n, self.n_cells)), drop_zeros=True)

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points lie beyond the faces."""
        room = 1e-9 * self.spacing
        beyond = (features < self.low - room) | (features > self.high + room)
        return np.asarray((beyond & ~np.array(self.periodic)).any(axis=1))

    def extent(self) -> str:
        """Shape and range, in words."""
        ranges = " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(self.low, self.high, strict=True))
        return f"the {' x '.join(map(str, self.shape))} grid on {ranges}"


@dataclass(frozen=True, eq=False)
class VoronoiCells:
    """The cells of ``centres`` (n, k) under the distance |x - y| / scale, with the largest distance that was observed."""

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
        return indicator(self.nearest(features)[0], self.n_cells)

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points are farther from every centre than any visited state was."""
        return np.asarray(self.nearest(features)[1] > self.radius)

    def extent(self) -> str:
        """Number of cells and reach, in words."""
        return f"the {self.n_cells} cells of visited states (reach {self.radius:.3g})"
