"""Direct solvers with pivoting, from LAPACK and SuperLU: the last resort, where the graph of a system lets them finish."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import csgraph
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._checks import Array

if TYPE_CHECKING:
    from oee_tabular.exact.systems import System

DENSE_LIMIT = 400
DENSE_EXPANDERS = 3000  # 72 MB and a second
Solver = Callable[[Array, float], Array]  # of the right side, and of how far its residual is to fall


def library(system: System) -> tuple[Solver, str] | None:
    """A direct solver with pivoting, whose answer is nan for a singular system; None where it would never finish."""
    n = system.n_states
    mixes = n > DENSE_LIMIT and expands(system.kernel())
    if mixes and n > DENSE_EXPANDERS:
        return None
    matrix = system.matrix()
    if n <= DENSE_LIMIT or mixes:
        getrf, getrs = linalg.get_lapack_funcs(("getrf", "getrs"), dtype=np.float64)
        dense, place, singular = getrf(matrix.toarray())
        if singular:
            return lambda b, relative: np.full(n, np.nan), "dense LU"
        return lambda b, relative: np.asarray(getrs(dense, place, b)[0]), "dense LU"
    try:
        factors = sparse_linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:  # singular
        return lambda b, relative: np.full(n, np.nan), "sparse LU"
    return lambda b, relative: np.asarray(factors.solve(b)), "sparse LU"


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
