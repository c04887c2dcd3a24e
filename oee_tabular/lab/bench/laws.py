"""Distributions that transitions of families are made of."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse, special, stats

from oee_tabular._sparse import csr_on_pattern, row_of_entry, row_sums
from oee_tabular.typing import Array


def scale_rows(matrix: sparse.csr_array) -> sparse.csr_array:
    """Scale each row of a matrix to sum to 1."""
    return csr_on_pattern(matrix, matrix.data / row_sums(matrix)[row_of_entry(matrix)])


def normalize(table: Array) -> Array:
    """Scale a table to sum to 1 along its last axis."""
    return np.asarray(table / table.sum(axis=-1, keepdims=True))


def poisson(mean: Any, largest: Any) -> Array:
    """Return Pr(min(N, largest) = k) of a Poisson number N, k along the last axis."""
    k = np.arange(np.max(largest) + 1)
    return np.where(
        k < largest,
        stats.poisson.pmf(k, mean),
        np.where(k == largest, stats.poisson.sf(k - 1, mean), 0.0),
    )


def binomial(n: Any, probability: Any) -> Array:
    """Return Pr(N = k) of a binomial number N, k along the last axis."""
    k = np.arange(np.max(n) + 1)
    failures = np.maximum(n - k, 0)
    law = special.comb(n, k) * probability**k * (1.0 - probability) ** failures
    return np.where(k <= n, law, 0.0)


def cross(one: Array, other: Array) -> Array:
    """Return the joint distribution of two independent parts, along the last axis.

    The second part varies faster.
    """
    joint = one[..., :, None] * other[..., None, :]
    return joint.reshape(*joint.shape[:-2], -1)
