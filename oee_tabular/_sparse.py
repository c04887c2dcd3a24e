"""Sparse rows s*A + a: canonical csr, its rules, and look-up on another's pattern."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from oee_tabular._checks import freeze, is_sparse
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, Csr, IntArray


class CsrParts(Protocol):
    """Describe what has the arrays of a csr matrix: scipy's, or ``mdp.CsrArrays``."""

    @property
    def indptr(self) -> NDArray[np.integer[Any]]:
        """Return the first entry of each row, and the number of entries."""

    @property
    def indices(self) -> NDArray[np.integer[Any]]:
        """Return the column of each entry."""

    @property
    def data(self) -> NDArray[Any]:
        """Return the value of each entry."""

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of rows and of columns."""

    @property
    def nnz(self) -> int:
        """Return the number of entries."""


def canonical(matrix: Any, *, drop_zeros: bool) -> Csr:
    """Copy a matrix to csr with sorted indices, no duplicates and read-only arrays.

    Indices have 32 bits where they fit.
    """
    csr = sparse.csr_array(matrix, dtype=np.float64, copy=True)
    csr.sum_duplicates()
    if drop_zeros:
        csr.eliminate_zeros()
    csr.sort_indices()
    if max(csr.nnz, *csr.shape) <= np.iinfo(np.int32).max:
        csr.indices = csr.indices.astype(np.int32, copy=False)
        csr.indptr = csr.indptr.astype(np.int32, copy=False)
    return freeze_csr(csr)


def check_csr(matrix: Any, name: str) -> Csr:
    """Check a sparse matrix in any of scipy's formats and return it as csr of float64.

    Entries of one place add up, as those of probabilities and counts do; of values see
    ``check_values``. Its arrays may be the given ones. Native code follows row pointers
    and indices wherever they lead, and scipy's matrices may be edited after they were
    made: whoever takes one looks at all of it here first. Costs O(entries). Raises an
    ArgumentError, with the part and the place, for what is no matrix of real numbers.
    """
    _require_real_matrix(matrix, name)
    if matrix.format not in ("csr", "csc"):
        coo = _check_coo(matrix, name)
        return sparse.csr_array(coo, dtype=np.float64)
    # a csc matrix has the parts that its transpose has as csr
    is_csr = matrix.format == "csr"
    shape = matrix.shape if is_csr else matrix.shape[::-1]
    csr = csr_from_parts(matrix.data, matrix.indices, matrix.indptr, shape, name)
    return csr if is_csr else csr.T.tocsr()


def _require_real_matrix(matrix: Any, name: str) -> None:
    """Raise an ArgumentError for what is no sparse matrix of real numbers."""
    if not is_sparse(matrix):
        raise ArgumentError(
            name, f"must be a sparse matrix; got {type(matrix).__name__}"
        )
    if matrix.ndim != 2:
        raise ArgumentError(
            name, f"must have 2 dimensions when sparse; it has shape {matrix.shape}"
        )
    kind = _dtype_of(matrix, name)
    if kind.kind not in "biuf":
        raise ArgumentError(name, f"must be real numbers; they are {kind}")


def _dtype_of(matrix: Any, name: str) -> np.dtype[Any]:
    """Return the type of the entries, of which a malformed matrix has none."""
    try:
        # scipy asks the data, which may have been replaced by anything
        kind: np.dtype[Any] = matrix.dtype
    except Exception:
        held = type(getattr(matrix, "data", None)).__name__
        raise ArgumentError(
            name,
            f"must be a sound sparse matrix; its {matrix.format} form is not (data must"
            f" be an array of numbers; it is a {held})",
        ) from None
    return kind


class Entries(NamedTuple):
    """Hold the entries of a sparse matrix as they were given, repeated ones as well."""

    row: IntArray
    column: IntArray
    value: Array


def entries_of(matrix: Any, name: str) -> Entries:
    """Check a sparse matrix as ``check_csr`` does and return all its entries.

    Entries of one place are not added.
    """
    _require_real_matrix(matrix, name)
    if matrix.format not in ("csr", "csc"):
        coo = _check_coo(matrix, name)
        row, column = coo.coords
    else:
        is_csr = matrix.format == "csr"
        shape = matrix.shape if is_csr else matrix.shape[::-1]
        coo = csr_from_parts(matrix.data, matrix.indices, matrix.indptr, shape, name)
        row, column = row_of_entry(coo), coo.indices
        if not is_csr:
            row, column = column, row
    return Entries(
        row.astype(np.int64), column.astype(np.int64), coo.data.astype(np.float64)
    )


def is_matrix_list(value: object) -> bool:
    """Say whether a value is a list, a tuple or an array of sparse matrices alone."""
    if isinstance(value, np.ndarray):
        if not (
            type(value) is np.ndarray and value.ndim == 1 and value.dtype.hasobject
        ):
            return False
        value = value.tolist()
    return (
        isinstance(value, list | tuple) and bool(value) and all(map(is_sparse, value))
    )


def stack_actions(matrices: Any, name: str) -> sparse.coo_array[Any]:
    """Return a list of A sparse (S, S) matrices, one an action, as one (S*A, S).

    Repeated entries stay. Raises an ArgumentError where one has another shape.
    """
    n_actions = len(matrices)
    n_states = matrices[0].shape[-1]
    parts = []
    for action, matrix in enumerate(matrices):
        if matrix.shape != (n_states, n_states):
            raise ArgumentError(
                f"{name}[{action}]",
                f"must have shape {(n_states, n_states)}, of states and next states,"
                " in a list of sparse matrices, one an action; it has shape"
                f" {matrix.shape}",
            )
        row, column, value = entries_of(matrix, f"{name}[{action}]")
        parts.append((row * n_actions + action, column, value))
    rows, columns, values = (np.concatenate(p) for p in zip(*parts, strict=True))
    # in single precision they are scaled
    if all(matrix.dtype in (np.float32, np.float16) for matrix in matrices):
        values = values.astype(np.float32)
    shape = (n_states * n_actions, n_states)
    return sparse.coo_array((values, (rows, columns)), shape=shape)


def check_values(
    matrix: Any, name: str, weights: Callable[[], Entries | None] | None = None
) -> Csr:
    """Check a sparse matrix of values, such as rewards or ratios, and return its csr.

    Values of one place do not add up: equal ones count once, and different ones are
    averaged by the probabilities that were given at the same repeated places.

    Parameters
    ----------
    matrix : sparse matrix
        The values, in any of scipy's formats.
    name : str
        The argument's name, for errors.
    weights : callable, optional
        Returns the entries of the probabilities as they were given, or None. It is
        called where values of one place differ.

    Returns
    -------
    csr_array
        Canonical, explicit zeros included.

    Raises
    ------
    ArgumentError
        If the matrix is malformed, or if different values stand in one place.
    """
    if matrix.format == "csr" and _dtype_of(matrix, name) == np.float64:
        # the usual case; scipy says whether it holds only of sound matrices
        csr = check_csr(matrix, name)
        if csr.has_canonical_format:
            return canonical(csr, drop_zeros=False)
    given = entries_of(matrix, name)
    return values_of_entries(given, matrix.shape, name, weights)


def values_of_entries(
    given: Entries,
    shape: tuple[int, int],
    name: str,
    weights: Callable[[], Entries | None] | None = None,
) -> Csr:
    """Return the csr of values, of which those of one place do not add up."""
    order = np.lexsort((given.column, given.row))
    row, column, value = (part[order] for part in given)
    is_first = np.ones(len(row), dtype=np.bool_)
    is_first[1:] = (row[1:] != row[:-1]) | (column[1:] != column[:-1])
    starts = np.flatnonzero(is_first)
    own = value[starts]
    if len(starts) < len(row):
        group = np.cumsum(is_first) - 1
        differs = (value != own[group]) & ~(np.isnan(value) & np.isnan(own[group]))
        if differs.any():
            shares = None if weights is None else weights()
            own = _average_repeated(given, order, group, differs, shares, name)
    parts = (own, (row[starts], column[starts]))
    return canonical(sparse.csr_array(parts, shape=shape), drop_zeros=False)


def _average_repeated(
    given: Entries,
    order: IntArray,
    group: IntArray,
    differs: BoolArray,
    weights: Entries | None,
    name: str,
) -> Array:
    """Return the mean value of each place under the weights of the same entries.

    ``order`` sorts the entries, ``group`` numbers the places in this order.
    """
    value = given.value[order]
    first = np.searchsorted(group, group)  # of the same place
    has_weights = weights is not None and all(
        np.array_equal(one, other)
        for one, other in zip(given[:2], weights[:2], strict=True)
    )
    share: Array = np.zeros(len(group))
    total = share
    if weights is not None and has_weights:
        share = weights.value[order]
        total = np.bincount(group, share).astype(np.float64)
        lacks = differs & ~(total > 0.0)[group]
    else:
        lacks = differs
    if lacks.any():
        k = int(lacks.argmax())
        row, column = int(given.row[order[k]]), int(given.column[order[k]])
        raise ArgumentError(
            f"{name}[{row}, {column}]",
            f"must have one value; it has {value[first[k]]:g} and {value[k]:g}"
            " (repeated entries of probabilities add up, those of values do not: give"
            " their mean, or both in the same order as the probabilities)",
        )
    mean = np.bincount(group, share * value) / np.where(total > 0.0, total, 1.0)
    # a place whose values agree keeps their bits
    is_mixed = np.bincount(group, differs) > 0
    return np.asarray(np.where(is_mixed, mean, value[np.unique(first)]))


def _check_coo(matrix: Any, name: str) -> Any:
    """Return the coo of a sound matrix that is neither csr nor csc.

    Repeated entries stay.
    """
    shape = matrix.shape
    kind = matrix.format
    try:
        # the constructors of dia_array and coo_array look at their parts
        if kind == "dia":
            matrix = sparse.dia_array((matrix.data, matrix.offsets), shape=shape)
        elif kind == "lil":
            _require_lil_parts(matrix)
        entries = matrix.tocoo()
        return sparse.coo_array((entries.data, entries.coords), shape=shape)
    except (
        AttributeError,
        IndexError,
        KeyError,
        OverflowError,
        TypeError,
        ValueError,
    ) as error:
        raise ArgumentError(
            name, f"must be a sound sparse matrix; its {kind} form is not ({error})"
        ) from None


def _require_lil_parts(matrix: Any) -> None:
    """Raise a ValueError where the rows of a lil matrix do not fit their values."""
    n_columns = [*map(len, matrix.rows), matrix.shape[0]]
    n_values = [*map(len, matrix.data), len(matrix.rows)]
    if n_columns != n_values:
        raise ValueError("its rows have not a column for each value")


def csr_from_parts(
    data: Any, indices: Any, indptr: Any, shape: tuple[int, int], name: str
) -> Csr:
    """Make the csr of these parts.

    Raises an ArgumentError, with the part and the place, where they are not those of a
    matrix.
    """
    values = np.asarray(data)
    columns = np.asarray(indices)
    pointers = np.asarray(indptr)
    for part, array, kinds, rule in (
        ("data", values, "biuf", "real numbers"),
        ("indices", columns, "iu", "integers"),
        ("indptr", pointers, "iu", "integers"),
    ):
        if array.dtype.kind not in kinds or array.ndim != 1:
            raise ArgumentError(
                f"{name}.{part}",
                f"must be {rule} of one dimension; they are {array.dtype} of"
                f" {array.ndim}",
            )
    if len(pointers) != shape[0] + 1:
        raise ArgumentError(
            f"{name}.indptr",
            f"must have {shape[0] + 1} entries, one more than rows; it has"
            f" {len(pointers)}",
        )
    if len(values) != len(columns):
        raise ArgumentError(
            f"{name}.data",
            f"must have a value for each of the {len(columns)} indices; it has"
            f" {len(values)}",
        )
    if pointers[0] != 0:
        raise ArgumentError(f"{name}.indptr[0]", f"must be 0; it is {pointers[0]}")
    used = int(pointers[-1])
    is_decreasing = np.r_[False, pointers[1:] < pointers[:-1]]
    is_outside = (columns[:used] < 0) | (columns[:used] >= shape[1])
    n_entries = len(columns)
    _require(pointers, ~is_decreasing, f"{name}.indptr", "at least the one before")
    _require(
        pointers,
        pointers <= n_entries,
        f"{name}.indptr",
        f"at most {n_entries}, the entries",
    )
    _require(columns, ~is_outside, f"{name}.indices", f"in 0..{shape[1] - 1}")
    return sparse.csr_array(
        (values[:used].astype(np.float64, copy=False), columns[:used], pointers),
        shape=shape,
    )


def _require(array: NDArray[Any], is_good: BoolArray, name: str, rule: str) -> None:
    """Raise an ArgumentError with the first value of ``array`` that is not good."""
    if not is_good.all():
        k = int(is_good.argmin())
        raise ArgumentError(f"{name}[{k}]", f"must be {rule}; it is {array[k]}")


def freeze_csr(csr: Csr) -> Csr:
    """Make the arrays of a matrix read-only and return it."""
    for array in (csr.data, csr.indices, csr.indptr):
        freeze(array)
    return csr


def csr_on_pattern(pattern: CsrParts, data: Array, *, own: bool = False) -> Csr:
    """Return the matrix with the entries of ``pattern`` and the values ``data``.

    Zeros stay. The values are copied unless they are the matrix's ``own``.
    """
    values = data if own else np.array(data, dtype=np.float64)
    parts = (values, pattern.indices, pattern.indptr)
    return freeze_csr(sparse.csr_array(parts, pattern.shape))


def row_of_entry(csr: CsrParts) -> IntArray:
    """Return the row of each stored entry."""
    return np.repeat(np.arange(csr.shape[0], dtype=np.int64), np.diff(csr.indptr))


def repeat_rows(csr: CsrParts, values: NDArray[Any]) -> NDArray[Any]:
    """Repeat the value of each row at each of its stored entries."""
    return np.repeat(values, np.diff(csr.indptr), axis=0)


def row_sums(csr: CsrParts, data: Array | None = None) -> Array:
    """Sum the stored entries of each row, or ``data`` on the same pattern."""
    values = csr.data if data is None else data
    result = np.zeros(csr.shape[0])
    filled = np.diff(csr.indptr) > 0
    if filled.any():
        result[filled] = np.add.reduceat(values, csr.indptr[:-1][filled])
    return result


def row_variances(csr: CsrParts, probability: Array, values: Array) -> Array:
    """Compute the variance of ``values`` over each row with these probabilities."""
    mean = row_sums(csr, probability * values)
    return row_sums(csr, probability * (values - repeat_rows(csr, mean)) ** 2)


def ratio_on(pattern: CsrParts, ratio: Any, name: str) -> Array:
    """Return a ratio's values on the entries of ``pattern``, 0 where it has none.

    The ratio is csr of the same shape, or an object with such ``values``.
    """
    values = ratio if is_sparse(ratio) else getattr(ratio, "values", ratio)
    if not is_sparse(values) or values.shape != pattern.shape:
        found = getattr(values, "shape", type(values).__name__)
        raise ArgumentError(
            name, f"must be sparse of shape {pattern.shape}, row s*A + a; got {found}"
        )
    is_float_csr = values.format == "csr" and values.dtype == np.float64
    if is_float_csr and _has_same_pattern(values, pattern):
        return np.asarray(values.data)
    return align(check_values(values, name), pattern)[0]


def find(
    csr: CsrParts, rows: IntArray, columns: NDArray[np.integer[Any]]
) -> tuple[IntArray, BoolArray]:
    """Return where each (row, column) is in ``csr.data``, and whether it is stored.

    The position is 0 where an entry is not stored.
    """
    numbered = sparse.csr_array(
        (np.arange(1, csr.nnz + 1), csr.indices, csr.indptr), csr.shape
    )
    # 0 where nothing is stored
    number = numbered[rows, columns] if len(rows) else np.zeros(0, dtype=np.int64)
    return np.maximum(number - 1, 0), number > 0


def _has_same_pattern(one: CsrParts, other: CsrParts) -> bool:
    """Say whether two matrices have the same entries in the same places."""
    return all(
        np.array_equal(getattr(one, part), getattr(other, part))
        for part in ("indptr", "indices")
    )


def align(source: Csr, pattern: CsrParts) -> tuple[Array, BoolArray]:
    """Return the values of ``source`` on ``pattern``, and where it has entries.

    Values are 0 where ``source`` has no entry. Rows are sorted.
    """
    if _has_same_pattern(source, pattern):
        values = np.array(source.data, dtype=np.float64)
        return values, np.ones(pattern.nnz, dtype=np.bool_)
    position, stored = find(source, row_of_entry(pattern), pattern.indices)
    values = np.zeros(pattern.nnz)
    values[stored] = source.data[position[stored]]
    return values, stored


def align_to(source: Csr, pattern: CsrParts) -> tuple[Csr, Array]:
    """Return ``source``, and its values on the entries of ``pattern``.

    Where it has the same entries it takes the pattern's arrays.
    """
    values = freeze(align(source, pattern)[0])
    if _has_same_pattern(source, pattern):
        source = csr_on_pattern(pattern, values, own=True)
    return source, values
