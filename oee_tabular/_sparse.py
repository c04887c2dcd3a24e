"""Rows s*A + a in CSR form: canonical storage, look-up of one matrix on the pattern of another."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray, IntArray, freeze


def canonical(matrix: Any, *, drop_zeros: bool) -> sparse.csr_array:
    """A CSR copy with sorted indices, no duplicates, 32-bit indices where they fit, and read-only arrays."""
    csr = sparse.csr_array(matrix, dtype=np.float64, copy=True)
    csr.sum_duplicates()
    if drop_zeros:
        csr.eliminate_zeros()
    csr.sort_indices()
    if max(csr.nnz, *csr.shape) <= np.iinfo(np.int32).max:
        csr.indices = csr.indices.astype(np.int32, copy=False)
        csr.indptr = csr.indptr.astype(np.int32, copy=False)
    return frozen(csr)


def frozen(csr: sparse.csr_array) -> sparse.csr_array:
    """The same matrix with read-only arrays."""
    for array in (csr.data, csr.indices, csr.indptr):
        freeze(array)
    return csr


def on_pattern(pattern: sparse.csr_array, data: Array) -> sparse.csr_array:
    """The matrix with the entries of ``pattern`` and the values ``data``; explicit zeros stay."""
    return frozen(sparse.csr_array((np.array(data, dtype=np.float64), pattern.indices, pattern.indptr), pattern.shape))


def row_of_entry(csr: sparse.csr_array) -> IntArray:
    """The row of each stored entry."""
    return np.repeat(np.arange(csr.shape[0], dtype=np.int64), np.diff(csr.indptr))


def row_sums(csr: sparse.csr_array, data: Array | None = None) -> Array:
    """Sums over the rows of the stored entries (of ``data`` on the same pattern, if given)."""
    values = csr.data if data is None else data
    result = np.zeros(csr.shape[0])
    filled = np.diff(csr.indptr) > 0
    if filled.any():
        result[filled] = np.add.reduceat(values, csr.indptr[:-1][filled])
    return result


def find(csr: sparse.csr_array, rows: IntArray, columns: IntArray) -> tuple[IntArray, BoolArray]:
    """The position in ``csr.data`` of each (row, column), and whether it is stored (position 0 where it is not)."""
    keys = row_of_entry(csr) * csr.shape[1] + csr.indices
    wanted = np.asarray(rows, dtype=np.int64) * csr.shape[1] + columns
    if keys.size == 0:
        return np.zeros(wanted.shape, dtype=np.int64), np.zeros(wanted.shape, dtype=np.bool_)
    position = np.minimum(np.searchsorted(keys, wanted), keys.size - 1)
    stored = keys[position] == wanted
    return np.where(stored, position, 0), stored


def align(source: sparse.csr_array, pattern: sparse.csr_array) -> tuple[Array, BoolArray]:
    """The values of ``source`` on the entries of ``pattern`` (0 where it has none), and where it has one."""
    if (
        source.nnz == pattern.nnz
        and np.array_equal(source.indptr, pattern.indptr)
        and np.array_equal(source.indices, pattern.indices)
    ):
        return np.array(source.data, dtype=np.float64), np.ones(pattern.nnz, dtype=np.bool_)
    if source.nnz == 0:
        return np.zeros(pattern.nnz), np.zeros(pattern.nnz, dtype=np.bool_)
    position, stored = find(source, row_of_entry(pattern), pattern.indices.astype(np.int64))
    return np.where(stored, source.data[position], 0.0), stored
