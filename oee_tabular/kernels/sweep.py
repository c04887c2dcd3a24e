"""Symmetric Gauss-Seidel sweeps: the preconditioner of the policy systems (I - gamma P) x = b."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


def sgs_solve(indptr: Any, indices: Any, data: Any, diagonal: Any, b: Any) -> Any:
    """Solve (D + L) D^-1 (D + U) x = b for the CSR matrix L + D + U with the given diagonal."""
    n = len(b)
    x = np.empty(n)
    for i in range(n):
        total = b[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j < i:
                total -= data[k] * x[j]
        x[i] = total / diagonal[i]
    for i in range(n - 1, -1, -1):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j > i:
                total += data[k] * x[j]
        x[i] -= total / diagonal[i]
    return x


sgs_solve = njit(cache=True)(sgs_solve)
