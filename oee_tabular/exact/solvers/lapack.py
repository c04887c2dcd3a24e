"""Dense LU with pivoting, by LAPACK."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import lapack

from oee_tabular._checks import Array, IntArray
from oee_tabular.exact import _policy_rows
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
        """Nan for a singular system."""
        matrix = _policy_rows.dense_matrix(system.kernel).T  # in the order of Fortran's arrays
        factors, place, singular = lapack.dgetrf(matrix, overwrite_a=True)
        return answer_nan if singular else partial(substitute, factors, place, int(not system.transpose))


def substitute(factors: Array, place: IntArray, transposed: int, b: Array, relative: float) -> Array:
    """Forward and back."""
    return np.asarray(lapack.dgetrs(factors, place, b, trans=transposed)[0])


def answer_nan(b: Array, relative: float) -> Array:
    """Of a singular system."""
    return np.full(len(b), np.nan)
