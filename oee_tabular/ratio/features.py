"""Features of function classes: the user's, or made from a kernel.

A kernel class on points x_1..x_n (the RKHS, by the representer theorem) is the linear
class with features L, where the Gram matrix is L L^T, and the squared RKHS norm is
|w|^2. L is a pivoted Cholesky factor [1]: exact up to ``residual``, the largest
diagonal entry of K - L L^T.

Differs from [1] in that it also stops after ``n_centers`` pivots, and refuses a kernel
whose variances become negative.

Features, and the keys of ``ties``, may also come as a data frame: a transition a row,
in the columns state, action and next_state (numbers or names), beside them one for each
feature, or one of keys.

Reference: [1] H. Harbrecht, M. Peters and R. Schneider, On the low-rank approximation
by the pivoted Cholesky decomposition, Applied Numerical Mathematics 62, 2012.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._sparse import find
from oee_tabular.data.frames import eager, is_frame
from oee_tabular.data.labels import require_columns
from oee_tabular.data.rules import MOVE
from oee_tabular.exceptions import ArgumentError, NumericalWarning
from oee_tabular.mdp import (
    FiniteMDP,
    Name,
    Rows,
    distinct_rows,
    name_transition,
    number_of,
)
from oee_tabular.typing import Array, BoolArray, FrameLike, IntArray, RealArrayLike

KernelFunction: TypeAlias = Callable[[Array, Array], RealArrayLike]
KernelLike: TypeAlias = Literal["gaussian"] | KernelFunction
# An array on the simulator's transitions, a data frame, or a function of (s, a, s').
FeaturesLike: TypeAlias = (
    RealArrayLike | FrameLike | Callable[[IntArray, IntArray, IntArray], RealArrayLike]
)

# The number of points whose k(x, x) is taken from one square of the Gram matrix.
N_POINTS_PER_SQUARE = 64
# The share of the largest k(x, x) up to which a pivot's variance counts as 0.
PIVOT_TOLERANCE = 1e-12
# The share of the largest k(x, x) by which a variance may be negative from rounding.
NEGATIVE_VARIANCE_TOLERANCE = 1e-6
# how errors say that functions are called
FEATURES_CALL = "features(state, action, next_state), of three arrays of integers"
KERNEL_CALL = "kernel(x, c), of two arrays of points, (n, d) and (m, d)"


@dataclass(frozen=True)
class _Gaussian:
    """The Gaussian kernel of a bandwidth, which pickles and compares by it."""

    bandwidth: float

    def __call__(self, x: Array, c: Array) -> Array:
        """Compute the kernel of two arrays of points."""
        distance = (x**2).sum(axis=1)[:, None] - 2.0 * x @ c.T + (c**2).sum(axis=1)
        exponent = np.maximum(distance, 0.0) / (2.0 * self.bandwidth**2)
        return np.asarray(np.exp(-exponent))

    def __repr__(self) -> str:
        return f"gaussian({self.bandwidth!r})"


def gaussian(bandwidth: float) -> Callable[[Array, Array], Array]:
    """Return the Gaussian kernel of a bandwidth, a function of two arrays of points.

    Parameters
    ----------
    bandwidth : float
        The bandwidth h > 0, in units of the points.

    Returns
    -------
    callable
        Takes (n, d) points x and (m, d) points c; returns the (n, m) array of
        exp(-d^2 / (2 h^2)), d the distance of x and c. It can be pickled, and equals
        another kernel of the same bandwidth.

    Examples
    --------
    >>> gaussian(1.0)(np.array([[0.0]]), np.array([[0.0], [2.0]])).round(4).tolist()
    [[1.0, 0.1353]]
    """
    return _Gaussian(
        _checks.number_in(bandwidth, "bandwidth", 0.0, np.inf, open_ends=True)
    )


class KernelFeatures(NamedTuple):
    """Features (n, r) of a kernel, from its pivoted Cholesky factor.

    K = matrix matrix^T up to ``residual`` on the diagonal; ``pivots`` are the numbers
    of the r points used.
    """

    matrix: Array
    pivots: IntArray
    residual: float


def kernel_features(
    points: Array, kernel: KernelFunction, n_centers: int
) -> KernelFeatures:
    """Factorise the kernel's Gram matrix on ``points`` (n, d) by pivoted Cholesky.

    Cost: O(n r^2), with r kernel columns evaluated. Raises ValueError where the kernel
    is not positive semidefinite on these points.
    """
    cuts = np.arange(N_POINTS_PER_SQUARE, len(points), N_POINTS_PER_SQUARE)
    parts = np.split(points, cuts)
    left = np.concatenate([np.diag(_gram(kernel, part, part)) for part in parts])
    if not (left >= 0).all():
        bad = int(np.argmin(left))
        raise ArgumentError(
            "kernel",
            f"must be positive semidefinite; k(x, x) is {left[bad]:g} at point {bad}",
        )
    scale = float(left.max(initial=0.0))
    if scale == 0.0:
        raise ArgumentError("kernel", "must not be 0 at every point")
    factor = np.zeros((len(points), min(len(points), n_centers)))
    pivots = []
    for j in range(factor.shape[1]):
        pivot = int(np.argmax(left))
        if left[pivot] <= PIVOT_TOLERANCE * scale:
            break
        column = _gram(kernel, points, points[[pivot]])[:, 0]
        column = column - factor[:, :j] @ factor[pivot, :j]
        factor[:, j] = column / np.sqrt(left[pivot])
        pivots.append(pivot)
        left = left - factor[:, j] ** 2
        left[pivots] = 0.0
        if left.min() < -NEGATIVE_VARIANCE_TOLERANCE * scale:
            bad = int(np.argmin(left))
            raise ArgumentError(
                "kernel",
                "must be symmetric and positive semidefinite; given the points"
                f" {pivots[-3:]} point {bad} has the variance {left[bad]:g}",
            )
    residual = float(np.maximum(left, 0.0).max())
    return KernelFeatures(factor[:, : len(pivots)], np.array(pivots), residual)


def _gram(kernel: KernelFunction, x: Array, centers: Array) -> Array:
    """Evaluate the kernel and check that it is finite and of shape (n, m)."""
    given = _checks.call_function(kernel, "kernel", KERNEL_CALL, x, centers)
    array = _checks.float_array(given, "kernel", ndim=2)
    if array.shape != (len(x), len(centers)):
        raise ArgumentError(
            "kernel",
            f"must give an array of shape {(len(x), len(centers))}; it gives"
            f" {array.shape}",
        )
    _checks.require_finite(array, "kernel")
    return array


def standard_gaussian(points: Array, bandwidth: float = 1.0) -> KernelFunction:
    """Return the Gaussian in units of each coordinate's standard deviation."""
    size = points.std(axis=0)
    base = gaussian(bandwidth)
    size = np.where(size > 0, size, 1.0)

    def kernel(x: Array, c: Array) -> Array:
        """Compute the Gaussian of two arrays of points in these units."""
        return base(x / size, c / size)

    return kernel


def check_kernel(kernel: object) -> None:
    """Raise an error unless the kernel is a function or "gaussian"."""
    if not callable(kernel):
        _checks.one_of(kernel, "kernel", ("gaussian",))


def count_rank(features: Array, *, where: str = "") -> int:
    """Return the number of independent columns, and warn where some are collinear.

    Columns are scaled to length 1; eigenvalues below 1e-10 of the largest count as 0.
    """
    lengths = np.sqrt((features**2).sum(axis=0))
    d = features.shape[1]
    used = features[:, lengths > 0] / lengths[lengths > 0]
    values = np.linalg.eigvalsh(used.T @ used)
    rank = int(np.sum(values > 1e-10 * values.max(initial=0.0)))
    if rank < d:
        _checks.warn(
            f"features should be linearly independent{where}; they have rank {rank} of"
            f" {d} (the smallest parameters that fit are taken)",
            NumericalWarning,
        )
    return rank


def feature_array(features: object, simulator: FiniteMDP) -> Array:
    """Return the features as an (entries, d) array of finite numbers.

    ``features`` is a function of the arrays (s, a, s'); an array of (entries,) or
    (entries, d) aligned with ``simulator.transitions.data``, or of (S, A, S) or (S, A,
    S, d); or a data frame with columns state, action, next_state (numbers or the
    simulator's names) and one for each feature, 0 for transitions that are not in it.
    """
    if not callable(features) and is_frame(features):
        return features_of(eager(features), simulator)[0]
    if callable(features):
        features = _checks.call_function(
            features, "features", FEATURES_CALL, *Rows.of(simulator).transitions
        )
    return features_of(_checks.float_array(features, "features"), simulator)[0]


def features_of(given: Any, simulator: FiniteMDP) -> tuple[Array, list[str]]:
    """Return features (entries, d) on the simulator's transitions, and their names.

    ``given`` is an array of numbers or a data frame whose rows are read, both in the
    forms of ``feature_array``.
    """
    matrix = simulator.transitions
    if not isinstance(given, np.ndarray):
        columns, entry = _moves_of(given, simulator, "features")
        values = np.zeros((matrix.nnz, len(columns)))
        for k, column in enumerate(columns):
            values[entry, k] = column.finite()
        return values, [column.label for column in columns]
    if given.dtype.kind not in "biuf":
        raise ArgumentError(
            "features",
            f"must be real numbers; they are {given.dtype} (astype(float) makes numbers"
            " of texts)",
        )
    array = given.astype(np.float64)
    shape = (simulator.n_states, simulator.n_actions, simulator.n_states)
    written = array.shape
    if array.ndim >= 3 and array.shape[:3] == shape:
        array = array[Rows.of(simulator).transitions]
    if array.ndim not in (1, 2) or array.shape[0] != matrix.nnz or array.size == 0:
        raise ArgumentError(
            "features",
            f"must have {matrix.nnz} rows, one for each transition of the simulator, or"
            f" shape {shape} (+ d); they have shape {written}",
        )
    array = array.reshape(matrix.nnz, -1)
    for entry, k in np.argwhere(~np.isfinite(array))[:1].tolist():
        where = name_transition(matrix, entry, simulator.n_actions, simulator.names)
        raise ArgumentError(
            "features", f"must be finite; feature {k} at {where} is {array[entry, k]}"
        )
    return array, [f"feature {k}" for k in range(array.shape[1])]


def _check_points(coordinates: object, n: int, rule: str) -> Array:
    """Return coordinates of (n,) or (n, c) as an (n, c) array of finite numbers."""
    points = _checks.float_array(coordinates, "coordinates", ndim=(1, 2))
    _checks.require_finite(points, "coordinates")
    if len(points) != n:
        raise ArgumentError(
            "coordinates", f"must have {n} rows, {rule}; they have {len(points)}"
        )
    return points.reshape(n, -1)


def move_points(simulator: FiniteMDP, coordinates: object) -> Array:
    """Return each transition's action, coordinates of s and displacement, side by side.

    The array has shape (entries, 1 + 2c).
    """
    places = _check_points(coordinates, simulator.n_states, "one a state")
    rows = Rows.of(simulator)
    start = rows.spread(places[rows.state])
    return np.column_stack(
        [rows.spread(rows.action), start, places[rows.arrival] - start]
    )


def action_displacement(simulator: FiniteMDP, coordinates: RealArrayLike) -> Array:
    """Make indicator features of pairs (action, displacement).

    They share information between all states.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator whose transitions get features.
    coordinates : array-like of shape (S,) or (S, c)
        Coordinates of each state; a displacement is the difference of the two ends'
        coordinates.

    Returns
    -------
    ndarray of shape (entries, d)
        One column for each action and displacement; the commonest displacement of each
        action is the reference and has none.

    Examples
    --------
    >>> line = FiniteMDP(
    ...     [[[0.5, 0.5, 0]], [[0, 0.5, 0.5]], [[0, 0, 1]]], [0, 0, 0], [1, 0, 0], 0.9
    ... )
    >>> # 0 -> 0, 0 -> 1, 1 -> 1, 1 -> 2, 2 -> 2: ahead?
    >>> action_displacement(line, [0, 1, 2]).ravel().tolist()
    [0.0, 1.0, 0.0, 1.0, 0.0]
    """
    _checks.instance(simulator, FiniteMDP, "simulator")
    points = move_points(simulator, coordinates)
    n_coordinates = points.shape[1] // 2
    keys = np.column_stack([points[:, 0], np.round(points[:, 1 + n_coordinates :], 9)])
    kinds, kind = distinct_rows(keys)
    mass = np.bincount(kind, weights=simulator.transitions.data)
    reference = [
        int(np.flatnonzero(kinds[:, 0] == a)[np.argmax(mass[kinds[:, 0] == a])])
        for a in np.unique(kinds[:, 0])
    ]
    kept = np.setdiff1d(np.arange(len(kinds)), reference)
    return np.asarray(kind[:, None] == kept, dtype=np.float64)


# The prefix that pandas gives to columns without a name.
UNNAMED_PREFIX = "Unnamed: "
# The number below which a float is exactly the integer that was written.
EXACT_INTEGER_LIMIT = 2.0**53


def keys_in(table: Any, simulator: FiniteMDP, source: str) -> NDArray[Any]:
    """Return the integer keys of a data frame, (entries,), one for every transition.

    The frame's rows are read; ``source`` is its name in errors.
    """
    columns, entry = _moves_of(table, simulator, source)
    if len(columns) > 1:
        labels = words(column.label for column in columns)
        raise ArgumentError(
            source,
            f"must have one column of keys beside {words(MOVE)}; it has {labels}",
        )
    written = columns[0].integers()
    matrix = simulator.transitions
    absent = np.setdiff1d(np.arange(matrix.nnz), entry)
    if absent.size:
        first = name_transition(
            matrix, int(absent[0]), simulator.n_actions, simulator.names
        )
        raise ArgumentError(
            source,
            f"must have a key for every transition of the simulator; {absent.size} of"
            f" {matrix.nnz} have none, the first: {first}",
        )
    keys = np.empty(matrix.nnz, dtype=written.dtype)
    keys[entry] = written
    return keys


def _moves_of(
    table: Any, simulator: FiniteMDP, source: str
) -> tuple[list[_Column], IntArray]:
    """Return a frame's own columns, and the simulator's entry of each of its rows."""
    labels = [str(label) for label in table.columns]
    require_columns(source, MOVE, labels)
    own = [label for label in labels if label not in MOVE]
    if any(not label or label.startswith(UNNAMED_PREFIX) for label in own):
        shown = words([label or "''" for label in labels])
        raise ArgumentError(
            source,
            f"must have a name for every column; it has {shown} (a written index?)",
        )
    if not own or len(table) == 0:
        rule = "at least one row"
        if len(table):
            rule = "a column of numbers beside its transitions"
        raise ArgumentError(source, f"must have {rule}; it has none")
    columns = {label: _Column(label, source, table[label]) for label in labels}
    states = (simulator.state_names, simulator.n_states)
    actions = (simulator.action_names, simulator.n_actions)
    state, action, next_state = (columns[label] for label in MOVE)
    s = state.numbered(*states)
    a = action.numbered(*actions)
    following = next_state.numbered(*states)
    entry, stored = find(simulator.transitions, s * simulator.n_actions + a, following)

    def move(row: int) -> str:
        """Return the name of the transition in a row."""
        return simulator.names.transition(s[row], a[row], following[row])

    outside = np.flatnonzero(~stored)
    if outside.size:
        more = _checks.in_all(outside.size, "such rows")
        raise ValueError(
            f"row {outside[0]} of {source} must be a transition of the simulator, which"
            f" gives probability 0 to {move(int(outside[0]))}{more}"
        )
    again = np.setdiff1d(np.arange(len(entry)), np.unique(entry, return_index=True)[1])
    if again.size:
        row = int(again[0])
        before = int(np.argmax(entry == entry[row]))
        raise ValueError(
            f"row {row} of {source} must be another transition; {move(row)} is row"
            f" {before} already"
        )
    return [columns[label] for label in own], entry


class _Column(NamedTuple):
    """A column of a data frame; its errors name it, its table and the first bad row."""

    label: str
    source: str
    series: Any

    def refuse(self, bad: BoolArray, rule: str, values: Any) -> None:
        """Raise an error that names the first bad row, if there is one."""
        if bad.any():
            row = int(np.argmax(bad))
            shown = "none or nan" if values is None else values[row]
            raise ArgumentError(
                f"column {self.label!r} of {self.source}",
                f"must {rule}; row {row} has {shown}",
            )

    def finite(self) -> Array:
        """Return the column as finite numbers."""
        rule = "have a finite number in every row"
        values = np.asarray(self.series.to_numpy())
        self.refuse(self.series.is_null().to_numpy(), rule, None)
        numbers: Any = values
        if values.dtype.kind not in "biuf":
            import pandas as pd

            series = pd.Series(values, dtype=object)
            numbers = pd.to_numeric(series, errors="coerce").to_numpy()
        numbers = np.asarray(numbers, dtype=np.float64)
        self.refuse(~np.isfinite(numbers), rule, values)
        return np.asarray(numbers)

    def integers(self) -> NDArray[Any]:
        """Return the column as integers."""
        values = np.asarray(self.series.to_numpy())
        if values.dtype.kind in "iu":
            return values
        numbers = self.finite()
        bad = (numbers != np.rint(numbers)) | (np.abs(numbers) >= EXACT_INTEGER_LIMIT)
        self.refuse(bad, "have an integer in every row", numbers)
        return numbers.astype(np.int64)

    def numbered(self, names: tuple[Name, ...] | None, size: int) -> IntArray:
        """Return the numbers of states or actions, in 0..size-1.

        The column has these, or the simulator's names where it has some.
        """
        values = np.asarray(self.series.to_numpy())
        if names is None or values.dtype.kind in "biuf":
            numbers = self.integers()
            outside = (numbers < 0) | (numbers >= size)
            self.refuse(outside, f"be in 0..{size - 1}", numbers)
            return numbers.astype(np.int64)
        self.refuse(self.series.is_null().to_numpy(), "have a name in every row", None)
        source = f"column {self.label!r} of {self.source}"
        code = {}
        items = [
            tuple(item) if isinstance(item, list | np.ndarray) else item
            for item in values
        ]
        for k, item in enumerate(items):
            if item not in code:
                code[item] = number_of(
                    item, names, size, f"{source}, row {k},", "the simulator's"
                )
        return np.array([code[item] for item in items], dtype=np.int64)


def words(names: Iterable[object]) -> str:
    """Return names as a sentence has them, or "none"."""
    return ", ".join(str(name) for name in names) or "none"
