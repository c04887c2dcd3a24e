"""LU of one communicating set of states after the other, without pivoting (an M-matrix needs none); or dense, by LAPACK.

Dense it is the first resort for small systems, and the last one: of expanders, where others fill in, up to 3000 states.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import lapack

from oee_tabular._checks import Array, IntArray
from oee_tabular.exact.solvers import _elimination
from oee_tabular.exact.solvers.library import DENSE_LIMIT, expands, nothing
from oee_tabular.exact.system import Solve, System

DENSE_EXPANDERS = 3000  # 72 MB and a second


@dataclass(frozen=True)
class ComponentLU:
    """Strongly connected components, each by dense LU after those that it leads to.

    One pass over layered models, whatever the order of their states: 2.8 ms for 20 000 states in levels of 4 (measured with
    tests/benchmarks/values.py), 45 by BiCGSTAB. Where every component is one state there is no gain.
    """

    name: str = "LU by components"
    direct: bool = True

    def suits(self, system: System) -> bool:
        """No more than some states reach each other."""
        return len(system.components[1]) > 0

    def prepare(self, system: System) -> Solve:
        """Nan from the first component on that is no M-matrix."""
        return partial(_elimination.solve_components, system.kernel, *system.components, system.transpose)


@dataclass(frozen=True)
class LAPACK:
    """Dense, O(S^3): ``up_to`` so many states, and ``expanders`` up to so many.

    Of 100 states it takes as long as the best of the others, of fewer less, and it needs next to nothing compiled.
    """

    up_to: int = DENSE_LIMIT
    expanders: int = DENSE_EXPANDERS
    name: str = "dense LU"
    direct: bool = True

    def suits(self, system: System) -> bool:
        """By the number of states, and by the graph where it is asked."""
        n = len(system.kernel.indptr) - 1
        return n <= self.up_to or (n <= self.expanders and expands(system.csr()))

    def prepare(self, system: System) -> Solve:
        """Nan for a singular system."""
        matrix = _elimination.dense(system.kernel).T  # in the order of Fortran's arrays
        factors, place, singular = lapack.dgetrf(matrix, overwrite_a=True)
        return nothing if singular else partial(_solved, factors, place, int(not system.transpose))


def _solved(factors: Array, place: IntArray, transposed: int, b: Array, relative: float) -> Array:
    return np.asarray(lapack.dgetrs(factors, place, b, trans=transposed)[0])
