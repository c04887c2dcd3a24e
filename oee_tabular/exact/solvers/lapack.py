"""Dense LU with pivoting, by LAPACK."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import lapack

from oee_tabular._checks import Array
from oee_tabular.exact.system import Solve, System

LAST_RESORT = 3000  # states: 72 MB and a second


@dataclass(frozen=True)
class LAPACK:
    """Dense, O(S^3), for up to ``most`` states.

    Of 100 states it takes as long as the best of the others, of fewer less, and it needs next to nothing compiled.
    """

    most: int
    name: str = "dense LU"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """By the number of states."""
        return system.n_states <= self.most

    def prepare(self, system: System) -> Solve:
        """Gives up on a singular system."""
        matrix = dense_matrix(system.kernel).T  # in the order of Fortran's arrays
        factors, place, is_singular = lapack.dgetrf(matrix, overwrite_a=True)

        def solve(b: Array, relative: float) -> Array | None:
            return None if is_singular else np.asarray(lapack.dgetrs(factors, place, b, trans=not system.transpose)[0])

        return solve


@njit(cache=True)
def dense_matrix(kernel):
    """(S, S): I - discount K."""
    indptr, indices, data, discount = kernel
    matrix = np.eye(len(indptr) - 1)
    for i in range(len(matrix)):
        for k in range(indptr[i], indptr[i + 1]):
            matrix[i, indices[k]] -= discount * data[k]
    return matrix
