"""LU with pivoting, by SuperLU: where elimination fills little, and where an iteration falls short."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._checks import Array
from oee_tabular.exact import _graph
from oee_tabular.exact.system import Csr, Solve, System


@dataclass(frozen=True)
class SuperLU:
    """Sparse, eliminated in the order of minimum degree.

    ``most`` : entries a state that an elimination in the reverse of a breadth-first order may fill, which is counted first:
    with 8 trees; None for the last resort, which any graph that does not expand suits.
    """

    most: float | None = None
    name: str = "sparse LU"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """By the count, first along the rows alone, which spares a transpose; graphs that expand fill up in any order."""
        if self.most is None:
            return not system.expands
        rows = Csr(*system.kernel[:3])
        along_rows = _graph.fills_little(system.kernel, rows, *system.order, self.most)
        return bool(along_rows and _graph.fills_little(system.kernel, system.back, *system.order, self.most))

    def prepare(self, system: System) -> Solve:
        """Gives up on a singular system, as far as SuperLU sees it."""
        kernel = system.csr()
        rows = sparse.csr_array(sparse.eye_array(system.n_states, format="csr") - system.kernel.discount * kernel)
        transposed = sparse.csc_array((rows.data, rows.indices, rows.indptr), shape=rows.shape)
        try:
            factors = sparse_linalg.splu(transposed, "MMD_AT_PLUS_A", options={"SymmetricMode": True, "Equil": False})
        except RuntimeError:  # singular
            return lambda b, relative: None

        def solve(b: Array, relative: float) -> Array:
            return np.asarray(factors.solve(b, "N" if system.transpose else "T"))

        return solve
