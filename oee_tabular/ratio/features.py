"""Function classes that are linear in their parameters: features given by the user, or
made from a kernel.

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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oee_tabular import _checks
from oee_tabular._sparse import find
from oee_tabular.data.frames import eager, is_frame
from oee_tabular.data.rules import MOVE, require_columns
from oee_tabular.exceptions import ArgumentError, NumericalWarning
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import name_transition
from oee_tabular.mdp.naming import Name, number_of
from oee_tabular.mdp.rows import Rows, distinct_rows
from oee_tabular.typing import Array, BoolArray, IntArray

KernelFunction = Callable[[Array, Array], Any]
N_DIAGONAL = 64  # points whose k(x, x) is taken from one square of the Gram matrix


def gaussian(bandwidth: float) -> Callable[[Array, Array], Array]:
    """Compute exp(-|x - c|^2 / (2 bandwidth^2)), for (n, d) and (m, d) points an (n, m)
    array.

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


class KernelFeatures(NamedTuple):
    """``matrix`` (n, r) with K = matrix matrix^T up to ``residual`` on the diagonal;
    ``pivots`` are the r points used.
    """

    matrix: Array
    pivots: IntArray
    residual: float


def kernel_features(
    points: Array, kernel: KernelFunction, n_centers: int
) -> KernelFeatures:
    """Pivoted Cholesky of the kernel's Gram matrix on ``points`` (n, d); O(n r^2), with
    r kernel columns evaluated.

    Raises ValueError where the kernel is not positive semidefinite on these points.
    """
    parts = np.split(points, np.arange(N_DIAGONAL, len(points), N_DIAGONAL))
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
        if left[pivot] <= 1e-12 * scale:
            break
        column = (
            _gram(kernel, points, points[[pivot]])[:, 0]
            - factor[:, :j] @ factor[pivot, :j]
        )
        factor[:, j] = column / np.sqrt(left[pivot])
        pivots.append(pivot)
        left = left - factor[:, j] ** 2
        left[pivots] = 0.0
        if left.min() < -1e-6 * scale:
            bad = int(np.argmin(left))
            raise ArgumentError(
                "kernel",
                "must be symmetric and positive semidefinite; given the points"
                f" {pivots[-3:]} point {bad} has the variance {left[bad]:g}",
            )
    return KernelFeatures(
        factor[:, : len(pivots)], np.array(pivots), float(np.maximum(left, 0.0).max())
    )


def _gram(kernel: KernelFunction, x: Array, centers: Array) -> Array:
    """kernel(x, centers), checked: finite, of shape (n, m)."""
    array = _checks.float_array(kernel(x, centers), "kernel", ndim=2)
    if array.shape != (len(x), len(centers)):
        raise ArgumentError(
            "kernel",
            f"must give an array of shape {(len(x), len(centers))}; it gives"
            f" {array.shape}",
        )
    _checks.require_finite(array, "kernel")
    return array


def standard_gaussian(points: Array, bandwidth: float = 1.0) -> KernelFunction:
    """Gaussian in units of each coordinate's standard deviation over the points."""
    size = points.std(axis=0)
    base = gaussian(bandwidth)
    size = np.where(size > 0, size, 1.0)
    return lambda x, c: base(x / size, c / size)


def check_kernel(kernel: object) -> None:
    """A function, or "gaussian"."""
    if not callable(kernel):
        _checks.one_of(kernel, "kernel", ("gaussian",))


def class_features(
    features: object,
    kernel: str | KernelFunction | None,
    coordinates: ArrayLike | None,
    n_centers: int,
    n: int,
) -> tuple[Array, dict[str, Any]]:
    """(n, d) features of n cells from the user's, or from a kernel on the cells'
    coordinates; and what is said of them.
    """
    if features is not None:
        for value, name in ((kernel, "kernel"), (coordinates, "coordinates")):
            if value is not None:
                raise ArgumentError(
                    name,
                    "must not be given with features; the two are different classes",
                )
        array = _checks.float_array(features, "features", ndim=(1, 2))
        if len(array) != n or array.size == 0:
            raise ArgumentError(
                "features",
                f"must have {n} rows, one for each entry of p; they have shape"
                f" {array.shape}",
            )
        _checks.require_finite(array, "features")
        array = array.reshape(n, -1)
        return array, {"feature_rank": count_rank(array)}
    if coordinates is None:
        raise ArgumentError(
            "coordinates",
            "must be given with kernel: the points that the entries of p and q"
            " stand for",
        )
    points = _check_points(coordinates, n, "one for each entry of p")
    check_kernel(kernel)
    space = kernel_features(
        points, kernel if callable(kernel) else standard_gaussian(points), n_centers
    )
    return space.matrix, {"kernel_residual": space.residual, "centers": space.pivots}


def count_rank(features: Array, *, where: str = "") -> int:
    """The number of independent columns, each scaled to length 1, up to 1e-10; warns
    where some are collinear.
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
    """phi as an (entries, d) array of finite numbers.

    ``features``: a function of (s, a, s') arrays, an array of (entries,) or (entries,
    d)
    aligned with ``simulator.transitions.data``, or of (S, A, S) or (S, A, S, d), or a
    data frame with columns state, action, next_state (numbers or the simulator's names)
    and one for each feature, 0 for transitions that are not in it.
    """
    matrix = simulator.transitions
    rows = Rows.of(simulator)
    if not callable(features) and is_frame(features):
        return features_in(features, simulator, "features")[0]
    moves = rows.transitions
    given = features(*moves) if callable(features) else features
    array = _checks.float_array(given, "features")
    shape = (simulator.n_states, simulator.n_actions, simulator.n_states)
    written = array.shape
    if array.ndim >= 3 and array.shape[:3] == shape:
        array = array[moves]
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
    return array


def _check_points(coordinates: object, n: int, rule: str) -> Array:
    """(n, c) finite numbers from (n,) or (n, c)."""
    points = _checks.float_array(coordinates, "coordinates", ndim=(1, 2))
    _checks.require_finite(points, "coordinates")
    if len(points) != n:
        raise ArgumentError(
            "coordinates", f"must have {n} rows, {rule}; they have {len(points)}"
        )
    return points.reshape(n, -1)


def move_points(simulator: FiniteMDP, coordinates: object) -> Array:
    """(entries, 1 + 2c): the action, the coordinates of s, and the displacement, of
    each simulator transition.
    """
    places = _check_points(coordinates, simulator.n_states, "one a state")
    rows = Rows.of(simulator)
    start = rows.spread(places[rows.state])
    return np.column_stack(
        [rows.spread(rows.action), start, places[rows.arrival] - start]
    )


def action_displacement(simulator: FiniteMDP, coordinates: ArrayLike) -> Array:
    """Make indicator features of (action, displacement), which share information
    between all states.

    Parameters
    ----------
    simulator : FiniteMDP
    coordinates : (S,) or (S, c): where each state is; the displacement is the
        difference of the two ends' coordinates

    Returns
    -------
    (entries, d) : one column per action and displacement; of each action the commonest
        displacement is the reference

    Examples
    --------
    >>> line = FiniteMDP([[[0.5, 0.5, 0]], [[0, 0.5, 0.5]], [[0, 0, 1]]], [0, 0, 0], [1, 0, 0], 0.9)
    >>> action_displacement(line, [0, 1, 2]).ravel().tolist()  # 0 -> 0, 0 -> 1, 1 -> 1, 1 -> 2, 2 -> 2: ahead?
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


NAMELESS = "Unnamed: "  # what pandas calls a column without a name
WHOLE = 2.0**53  # up to which a float is the integer that was written


def features_in(
    frame: Any, simulator: FiniteMDP, source: str
) -> tuple[Array, list[str]]:
    """(entries, d) finite numbers on ``simulator.transitions.data``, their names; 0 for
    transitions not in the frame.

    ``source`` is what errors call the frame.
    """
    columns, entry = _moves_of(frame, simulator, source)
    values = np.zeros((simulator.transitions.nnz, len(columns)))
    for k, column in enumerate(columns):
        values[entry, k] = column.finite()
    return values, [column.label for column in columns]


def keys_in(frame: Any, simulator: FiniteMDP, source: str) -> NDArray[Any]:
    """(entries,) integer keys; no transition of the simulator may be left out."""
    columns, entry = _moves_of(frame, simulator, source)
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
    frame: Any, simulator: FiniteMDP, source: str
) -> tuple[list[_Column], IntArray]:
    """The columns beside the transitions, and the entry of the simulator's transitions
    that each row is about.
    """
    table = eager(frame)
    labels = [str(label) for label in table.columns]
    require_columns(source, MOVE, labels)
    own = [label for label in labels if label not in MOVE]
    if any(label.startswith(NAMELESS) for label in own):
        raise ArgumentError(
            source,
            f"must have a name for every column; it has {words(labels)} (a written"
            " index?)",
        )
    if not own or len(table) == 0:
        rule = (
            "a column of numbers beside its transitions"
            if len(table)
            else "at least one row"
        )
        raise ArgumentError(source, f"must have {rule}; it has none")
    columns = {label: _Column(label, source, table[label]) for label in labels}
    states = (simulator.state_names, simulator.n_states)
    sizes = (states, (simulator.action_names, simulator.n_actions), states)
    s, a, following = (
        columns[label].numbered(*size) for label, size in zip(MOVE, sizes, strict=True)
    )
    entry, stored = find(simulator.transitions, s * simulator.n_actions + a, following)

    def move(row: int) -> str:
        return simulator.names.transition(s[row], a[row], following[row])

    outside = np.flatnonzero(~stored)
    if outside.size:
        more = f" ({outside.size} such rows in all)" if outside.size > 1 else ""
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
        """A ValueError where a row is ``bad``."""
        if bad.any():
            row = int(np.argmax(bad))
            shown = "none or nan" if values is None else values[row]
            raise ValueError(
                f"column {self.label!r} of {self.source} must {rule}; row {row} has"
                f" {shown}"
            )

    def finite(self) -> Array:
        """Finite numbers."""
        rule = "have a finite number in every row"
        values = np.asarray(self.series.to_numpy())
        self.refuse(self.series.is_null().to_numpy(), rule, None)
        numbers: Any = values
        if values.dtype.kind not in "biuf":
            import pandas as pd

            numbers = pd.to_numeric(
                pd.Series(values, dtype=object), errors="coerce"
            ).to_numpy()
        numbers = np.asarray(numbers, dtype=np.float64)
        self.refuse(~np.isfinite(numbers), rule, values)
        return np.asarray(numbers)

    def integers(self) -> NDArray[Any]:
        """Whole numbers, as integers."""
        values = np.asarray(self.series.to_numpy())
        if values.dtype.kind in "iu":
            return values
        numbers = self.finite()
        self.refuse(
            (numbers != np.rint(numbers)) | (np.abs(numbers) >= WHOLE),
            "have an integer in every row",
            numbers,
        )
        return numbers.astype(np.int64)

    def numbered(self, names: tuple[Name, ...] | None, size: int) -> IntArray:
        """States or actions: integers in 0..size-1, or the simulator's names where it
        has some.
        """
        values = np.asarray(self.series.to_numpy())
        if names is None or values.dtype.kind in "biuf":
            numbers = self.integers()
            self.refuse(
                (numbers < 0) | (numbers >= size), f"be in 0..{size - 1}", numbers
            )
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
    """Names in a sentence."""
    return ", ".join(str(name) for name in names) or "none"
