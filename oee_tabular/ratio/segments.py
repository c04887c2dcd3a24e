"""Sums over the rows of a simulator (none of them empty), for arrays aligned with its entries."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import Array, IntArray


def segment_sums(values: Array, indptr: IntArray) -> Array:
    """The sum over each row of (entries,) or (entries, d) values."""
    return np.asarray(np.add.reduceat(values, indptr[:-1], axis=0))


def segment_max(values: Array, indptr: IntArray) -> Array:
    """The largest value of each row."""
    return np.asarray(np.maximum.reduceat(values, indptr[:-1]))


def spread(rows: NDArray[Any], indptr: IntArray) -> NDArray[Any]:
    """Each row's value at each of its entries."""
    return np.repeat(rows, np.diff(indptr), axis=0)
