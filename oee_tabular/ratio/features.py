"""Function classes that are linear in their parameters: features given by the user, or made from a kernel.

A kernel class on points x_1..x_n (the RKHS, by the representer theorem) is the linear class with features L, where the Gram
matrix is L L^T, and the squared RKHS norm is |w|^2. L is a pivoted Cholesky factor [1]: exact up to ``residual``, the largest
diagonal entry of K - L L^T.

Differs from [1] in that it also stops after ``n_centers`` pivots, and refuses a kernel whose variances become negative.

Reference: [1] H. Harbrecht, M. Peters and R. Schneider, On the low-rank approximation by the pivoted Cholesky decomposition,
Applied Numerical Mathematics 62, 2012.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.data.frames import is_frame
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.rows import Rows, distinct_rows

Kernel = Callable[[Array, Array], Any]


def gaussian(bandwidth: float) -> Callable[[Array, Array], Array]:
    """exp(-|x - c|^2 / (2 bandwidth^2)), for (n, d) and (m, d) points an (n, m) array.

    Parameters
    ----------
    bandwidth : positive number, in units of the points

    Examples
    --------
    >>> gaussian(1.0)(np.array([[0.0]]), np.array([[0.0], [2.0]])).round(4).tolist()
    [[1.0, 0.1353]]
    """
    width = _checks.number_in(bandwidth, "bandwidth", 0.0, np.inf, open_ends=True)

    def kernel(x: Array, c: Array) -> Array:
        distance = (x**2).sum(axis=1)[:, None] - 2.0 * x @ c.T + (c**2).sum(axis=1)
        return np.asarray(np.exp(-np.maximum(distance, 0.0) / (2.0 * width**2)))

    return kernel


def gram(kernel: Kernel, x: Array, centers: Array) -> Array:
    """kernel(x, centers), checked: finite, of shape (n, m)."""
    array = _checks.float_array(kernel(x, centers), "kernel", ndim=2)
    if array.shape != (len(x), len(centers)):
        raise ValueError(f"kernel must give an array of shape {(len(x), len(centers))}; it gives {array.shape}")
    _checks.require_finite(array, "kernel")
    return array


@dataclass(frozen=True, eq=False)
class KernelFeatures:
    """``matrix`` (n, r) with K = matrix matrix^T up to ``residual`` on the diagonal; ``pivots`` are the r points used."""

    matrix: Array
    pivots: Array
    residual: float


def kernel_features(
    points: Array,
    kernel: Kernel,
    *,
    n_centers: int,
    tolerance: float = 1e-12,
    center: Callable[[Array], Array] | None = None,
) -> KernelFeatures:
    """Pivoted Cholesky of the kernel's Gram matrix on ``points`` (n, d); O(n r^2), with r kernel columns evaluated.

    ``center`` is a linear map that is applied to functions on the points (a projection, as the subtraction of row means): the
    features are then those of the functions after it, of the same norm. Raises ValueError where the kernel is not
    positive semidefinite on these points.
    """
    n = len(points)
    limit = min(n, n_centers)
    factor = np.zeros((n, limit))
    diagonal = _diagonal(kernel, points)
    if not (diagonal >= 0).all():
        bad = int(np.argmin(diagonal))
        raise ValueError(f"kernel must be positive semidefinite; k(x, x) is {diagonal[bad]:g} at point {bad}")
    scale = float(diagonal.max(initial=0.0))
    if scale == 0.0:
        raise ValueError("kernel must not be 0 at every point")
    left = diagonal.copy()
    pivots: list[int] = []
    for j in range(limit):
        pivot = int(np.argmax(left))
        if left[pivot] <= tolerance * scale:
            break
        column = gram(kernel, points, points[[pivot]])[:, 0] - factor[:, :j] @ factor[pivot, :j]
        factor[:, j] = column / np.sqrt(left[pivot])
        pivots.append(pivot)
        left = left - factor[:, j] ** 2
        left[pivots] = 0.0
        if left.min() < -1e-6 * scale:
            bad = int(np.argmin(left))
            raise ValueError(
                f"kernel must be symmetric and positive semidefinite; given the points {pivots[-3:]} point {bad} has the "
                f"variance {left[bad]:g}"
            )
    matrix = factor[:, : len(pivots)]
    if center is not None:
        matrix = center(matrix)
    return KernelFeatures(matrix, np.array(pivots), float(np.maximum(left, 0.0).max()))


def _diagonal(kernel: Kernel, points: Array) -> Array:
    """k(x, x) of every point, in blocks so that no more than 64 columns are made at a time."""
    size = 64
    blocks = [np.diag(gram(kernel, points[i : i + size], points[i : i + size])) for i in range(0, len(points), size)]
    return np.concatenate(blocks)


def rank_of(features: Array) -> int:
    """The number of independent columns, each scaled to length 1, up to 1e-10."""
    lengths = np.sqrt((features**2).sum(axis=0))
    used = features[:, lengths > 0] / lengths[lengths > 0]
    if used.shape[1] == 0:
        return 0
    values = np.linalg.eigvalsh(used.T @ used)
    return int(np.sum(values > 1e-10 * values[-1]))


def warn_of_rank(features: Array, *, where: str = "") -> int:
    """The rank; warns where the columns are collinear."""
    rank, d = rank_of(features), features.shape[1]
    if rank < d:
        _checks.warn(
            f"features should be linearly independent{where}; they have rank {rank} of {d} (the smallest parameters "
            "that fit are taken)"
        )
    return rank


def cell_features(features: object, n: int) -> Array:
    """User's features of n cells as an (n, d) array of finite numbers."""
    array = _checks.float_array(features, "features", ndim=(1, 2))
    if len(array) != n or array.size == 0:
        raise ValueError(f"features must have {n} rows, one for each entry of p; they have shape {array.shape}")
    _checks.require_finite(array, "features")
    return array.reshape(n, -1)


def feature_array(features: object, simulator: FiniteMDP) -> Array:
    """phi as an (entries, d) array of finite numbers.

    ``features``: None (log P), a function of (s, a, s') arrays, an array of (entries,) or (entries, d)
    aligned with ``simulator.transitions.data``, or of (S, A, S) or (S, A, S, d), or a data frame with columns state, action,
    next_state (numbers or the simulator's names) and one for each feature, 0 in the moves that it has not.
    """
    matrix, rows = simulator.transitions, Rows.of(simulator)
    if features is None:
        return np.asarray(np.log(matrix.data)[:, None])
    if not callable(features) and is_frame(features):
        from oee_tabular.ratio.tabled import features_in

        return features_in(features, simulator, "features")[0]
    moves = rows.transitions
    given = features(*moves) if callable(features) else features
    array = _checks.float_array(given, "features")
    shape = (simulator.n_states, simulator.n_actions, simulator.n_states)
    if array.ndim >= 3 and array.shape[:3] == shape:
        array = array[moves]
    if array.ndim not in (1, 2) or array.shape[0] != matrix.nnz or array.size == 0:
        raise ValueError(
            f"features must have {matrix.nnz} rows, one for each transition of the simulator, or shape {shape} (+ d); "
            f"they have shape {array.shape}"
        )
    _checks.require_finite(array, "features")
    return array.reshape(matrix.nnz, -1)


def check_places(coordinates: object, simulator: FiniteMDP) -> Array:
    """(S, c): where each state is, from (S,) or (S, c) finite numbers."""
    places = _checks.float_array(coordinates, "coordinates", ndim=(1, 2))
    _checks.require_finite(places, "coordinates")
    if len(places) != simulator.n_states:
        raise ValueError(f"coordinates must have {simulator.n_states} rows, one a state; they have {len(places)}")
    return places.reshape(simulator.n_states, -1)


def action_displacement(simulator: FiniteMDP, coordinates: ArrayLike) -> Array:
    """Indicator features of (action, displacement), which share what is learned between all states.

    Parameters
    ----------
    simulator : FiniteMDP
    coordinates : (S,) or (S, c): where each state is; the displacement is the difference of the two ends' coordinates

    Returns
    -------
    (entries, d) : one column per action and displacement; of each action the commonest displacement is the reference

    Examples
    --------
    >>> line = FiniteMDP([[[0.5, 0.5, 0]], [[0, 0.5, 0.5]], [[0, 0, 1]]], [0, 0, 0], [1, 0, 0], 0.9)
    >>> action_displacement(line, [0, 1, 2]).ravel().tolist()  # 0 -> 0, 0 -> 1, 1 -> 1, 1 -> 2, 2 -> 2: ahead?
    [0.0, 1.0, 0.0, 1.0, 0.0]
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    places = check_places(coordinates, simulator)
    rows = Rows.of(simulator)
    steps = places[rows.arrival] - rows.spread(places[rows.state])
    keys = np.column_stack([rows.spread(rows.action), np.round(steps, 9)])
    kinds, kind = distinct_rows(keys)
    mass = np.bincount(kind, weights=simulator.transitions.data)
    reference = [
        int(np.flatnonzero(kinds[:, 0] == a)[np.argmax(mass[kinds[:, 0] == a])]) for a in np.unique(kinds[:, 0])
    ]
    kept = np.setdiff1d(np.arange(len(kinds)), reference)
    return np.asarray(kind[:, None] == kept, dtype=np.float64)
