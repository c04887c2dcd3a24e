"""LU with pivoting, from SuperLU: the last resort, where the graph of a system lets it finish."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._checks import Array
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
