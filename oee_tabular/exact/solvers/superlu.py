"""LU with pivoting, by SuperLU: where elimination fills little, and where an iteration falls short."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._checks import Array
from oee_tabular.exact.solvers import _graph
from oee_tabular.exact.solvers.lapack import answer_nan
from oee_tabular.exact.system import NO_ROWS, Solve, System


@dataclass(frozen=True)
class SuperLU:
    """Sparse: in the reverse of a breadth-first order where that fills ``most`` entries a state, else in minimum degree.

    ``most`` : None for the last resort, which any graph that does not expand suits. With 8 trees, and rings and bands whose
    states all lead back to one, are solved as fast as in SuperLU's own orders or faster (benchmarks/graphs.py). The fill is
    counted first, and the count ends where it is beyond that.
    """

    most: float | None = None
    name: str = "sparse LU"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """By the count; graphs that expand fill up in any order."""
        if self.most is None:
            return not _graph.expands(system.kernel)
        if _graph.count_fill(system.kernel, NO_ROWS, *system.order, self.most) < 0:
            return False
        return bool(_graph.count_fill(system.kernel, system.back, *system.order, self.most) >= 0)

    def prepare(self, system: System) -> Solve:
        """Nan for a singular system, as far as SuperLU sees it."""
        # the transposed matrix, whose columns are the rows of K
        is_ordered = self.most is not None
        order, place = system.order if is_ordered else (np.arange(system.n_states, dtype=np.uint32),) * 2
        parts = _graph.reorder(system.kernel, order, place)
        order = order[::-1].astype(np.int64)
        matrix = sparse.csc_array((parts[2], parts[1], parts[0]), shape=(len(order), len(order)))
        options = {"SymmetricMode": True, "Equil": False}
        try:
            factors = sparse_linalg.splu(matrix, "NATURAL" if is_ordered else "MMD_AT_PLUS_A", options=options)
        except RuntimeError:  # singular
            return answer_nan

        def solve(b: Array, relative: float) -> Array:
            x = np.empty(len(b))
            x[order] = factors.solve(b[order], "N" if system.transpose else "T")
            return x

        return solve
