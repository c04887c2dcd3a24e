"""LU of one communicating set of states after the other, without pivoting (an M-matrix needs none); or with it, by a library.

LAPACK's, dense, is the first resort for small systems, and a last one: of expanders, where others fill in, up to 3000 states.
SuperLU's is the last one where the graph of a system lets it finish.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse import csgraph
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._checks import Array, IntArray
from oee_tabular.exact.solvers import _elimination
from oee_tabular.exact.system import Solve, System

DENSE_LIMIT = 400


@dataclass(frozen=True)
class SuperLU:
    """Sparse, with the minimum degree order of A^T + A: where the graph does not expand."""

    name: str = "sparse LU"
    direct: bool = True

    def suits(self, system: System) -> bool:
        """Graphs whose factors do not fill up."""
        return len(system.kernel.indptr) - 1 > DENSE_LIMIT and not expands(system.csr())

    def prepare(self, system: System) -> Solve:
        """Nan for a singular system."""
        try:
            factors = sparse_linalg.splu(system.matrix(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        except RuntimeError:  # singular
            return nothing
        return lambda b, relative: np.asarray(factors.solve(b))


def nothing(b: Array, relative: float) -> Array:
    """Of a singular system."""
    return np.full(len(b), np.nan)


def expands(kernel: sparse.csr_array) -> bool:
    """Whether some breadth-first level of the graph, its hubs and trees left out, holds an eighth of the states.

    The factors of such a graph fill up, in any order of elimination. Hubs (a state that all others lead back to) do not
    matter where they are few: they are eliminated last; states with one or two neighbours are eliminated first.
    """
    n = kernel.shape[0]
    kept = np.flatnonzero(np.bincount(kernel.indices, minlength=n) <= 20.0 * np.sqrt(n))
    if len(kept) < 7 * n / 8:
        return True
    graph = sparse.csr_array(kernel[kept][:, kept])
    graph = sparse.csr_array(graph + graph.T)
    graph.setdiag(0.0)
    graph.eliminate_zeros()
    while len(kept) >= n / 8:
        linked = np.flatnonzero(np.diff(graph.indptr) > 2)
        if len(linked) > 0.99 * graph.shape[0]:
            break
        graph, kept = graph[linked][:, linked], kept[linked]
    if len(kept) < n / 8:
        return False
    count, label = csgraph.connected_components(graph, directed=False)
    largest = np.flatnonzero(label == np.bincount(label, minlength=count).argmax())
    distance = csgraph.dijkstra(graph, directed=False, indices=largest[0], unweighted=True)[largest]
    return bool(np.bincount(distance.astype(np.int64)).max() > n / 8)


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
