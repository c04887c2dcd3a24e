"""Sparse rows s*A + a: canonical csr, its rules, and look-up on another's pattern."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import freeze
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray


def canonical(matrix: Any, *, drop_zeros: bool) -> sparse.csr_array:
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


def check_csr(matrix: Any, name: str) -> sparse.csr_array:
    """Check a sparse matrix in any of scipy's formats and return it as csr of float64.

    Its arrays may be the given ones. Native code follows row pointers and indices
    wherever they lead, and scipy's matrices may be edited after they were made: whoever
    takes one looks at all of it here first. Costs O(entries). Raises an ArgumentError,
    with the part and the place, for what is no matrix of real numbers.
    """
    if not sparse.issparse(matrix):
        raise ArgumentError(
            name, f"must be a sparse matrix; got {type(matrix).__name__}"
        )
    if matrix.ndim != 2:
        raise ArgumentError(
            name, f"must have 2 dimensions when sparse; it has shape {matrix.shape}"
        )
    if matrix.dtype.kind not in "biuf":
        raise ArgumentError(name, f"must be real numbers; they are {matrix.dtype}")
    shape = matrix.shape
    kind = matrix.format
    if kind in ("csr", "csc"):
        csr = csr_from_parts(
            matrix.data,
            matrix.indices,
            matrix.indptr,
            shape if kind == "csr" else shape[::-1],
            name,
        )
        return csr if kind == "csr" else csr.T.tocsr()
    try:
        # the constructors of dia_array and coo_array look at their parts
        if kind == "dia":
            matrix = sparse.dia_array((matrix.data, matrix.offsets), shape=shape)
        elif kind == "lil" and [*map(len, matrix.rows), shape[0]] != [
            *map(len, matrix.data),
            len(matrix.rows),
        ]:
            raise ValueError("its rows have not a column for each value")
        entries = matrix.tocoo()
        return sparse.csr_array(
            sparse.coo_array((entries.data, entries.coords), shape=shape),
            dtype=np.float64,
        )
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


def csr_from_parts(
    data: Any, indices: Any, indptr: Any, shape: tuple[int, int], name: str
) -> sparse.csr_array:
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
    for array, part, bad, rule in (
        (
            pointers,
            "indptr",
            np.r_[False, pointers[1:] < pointers[:-1]],
            "at least the one before",
        ),
        (
            pointers,
            "indptr",
            pointers > len(columns),
            f"at most {len(columns)}, the entries",
        ),
        (
            columns,
            "indices",
            (columns[:used] < 0) | (columns[:used] >= shape[1]),
            f"in 0..{shape[1] - 1}",
        ),
    ):
        if bad.any():
            k = int(bad.argmax())
            raise ArgumentError(
                f"{name}.{part}[{k}]", f"must be {rule}; it is {array[k]}"
            )
    return sparse.csr_array(
        (values[:used].astype(np.float64, copy=False), columns[:used], pointers),
        shape=shape,
    )


def freeze_csr(csr: sparse.csr_array) -> sparse.csr_array:
    """Make the arrays of a matrix read-only and return it."""
    for array in (csr.data, csr.indices, csr.indptr):
        freeze(array)
    return csr


def csr_on_pattern(
    pattern: sparse.csr_array, data: Array, *, own: bool = False
) -> sparse.csr_array:
    """Return the matrix with the entries of ``pattern`` and the values ``data``.

    Zeros stay. The values are copied unless they are the matrix's ``own``.
    """
    values = data if own else np.array(data, dtype=np.float64)
    return freeze_csr(
        sparse.csr_array((values, pattern.indices, pattern.indptr), pattern.shape)
    )


def row_of_entry(csr: sparse.csr_array) -> IntArray:
    """Return the row of each stored entry."""
    return np.repeat(np.arange(csr.shape[0], dtype=np.int64), np.diff(csr.indptr))


def row_sums(csr: sparse.csr_array, data: Array | None = None) -> Array:
    """Sum the stored entries of each row, or ``data`` on the same pattern."""
    values = csr.data if data is None else data
    result = np.zeros(csr.shape[0])
    filled = np.diff(csr.indptr) > 0
    if filled.any():
        result[filled] = np.add.reduceat(values, csr.indptr[:-1][filled])
    return result


def row_variances(csr: sparse.csr_array, probability: Array, values: Array) -> Array:
    """Compute the variance of ``values`` over each row with these probabilities."""
    mean = row_sums(csr, probability * values)
    return row_sums(csr, probability * (values - mean[row_of_entry(csr)]) ** 2)


def ratio_on(pattern: sparse.csr_array, ratio: Any, name: str) -> Array:
    """Return a ratio's values on the entries of ``pattern``, 0 where it has none.

    The ratio is csr of the same shape, or an object with such ``values``.
    """
    values = getattr(ratio, "values", ratio)
    if not sparse.issparse(values) or values.shape != pattern.shape:
        found = getattr(values, "shape", type(values).__name__)
        raise ArgumentError(
            name, f"must be sparse of shape {pattern.shape}, row s*A + a; got {found}"
        )
    if (
        values.format == "csr"
        and values.dtype == np.float64
        and _has_same_pattern(values, pattern)
    ):
        return np.asarray(values.data)
    return align(canonical(check_csr(values, name), drop_zeros=False), pattern)[0]


def find(
    csr: sparse.csr_array, rows: IntArray, columns: IntArray
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


def _has_same_pattern(one: sparse.csr_array, other: sparse.csr_array) -> bool:
    """Say whether two matrices have the same entries in the same places."""
    return all(
        np.array_equal(getattr(one, part), getattr(other, part))
        for part in ("indptr", "indices")
    )


def align(
    source: sparse.csr_array, pattern: sparse.csr_array
) -> tuple[Array, BoolArray]:
    """Return the values of ``source`` on ``pattern``, and where it has entries.

    Values are 0 where ``source`` has no entry. Rows are sorted.
    """
    if _has_same_pattern(source, pattern):
        return np.array(source.data, dtype=np.float64), np.ones(
            pattern.nnz, dtype=np.bool_
        )
    position, stored = find(source, row_of_entry(pattern), pattern.indices)
    values = np.zeros(pattern.nnz)
    values[stored] = source.data[position[stored]]
    return values, stored


def align_to(
    source: sparse.csr_array, pattern: sparse.csr_array
) -> tuple[sparse.csr_array, Array]:
    """Return ``source``, and its values on the entries of ``pattern``.

    Where it has the same entries it takes the pattern's arrays.
    """
    values = freeze(align(source, pattern)[0])
    return (
        csr_on_pattern(pattern, values, own=True)
        if _has_same_pattern(source, pattern)
        else source
    ), values
