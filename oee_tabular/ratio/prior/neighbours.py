"""The graph of a simulator's states, and its smoothness penalty on few nodes.

Two states are neighbours as far as the simulator moves between them: w(s, s') is the mean over actions of P(s' | s, a),
averaged over both directions. A function u of the states is smooth where

    u' Q u = sum_{s < s'} w(s, s') (u_s - u_s')^2 + rest sum_s u_s^2

is small (a Gaussian Markov random field [1]; ``rest``, 1e-4, makes it proper). Many states are joined into groups along heavy
edges, u being equal within a group, until there are few enough.

Reference: [1] H. Rue and L. Held, Gaussian Markov Random Fields, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._checks import Array, IntArray
from oee_tabular.exact.system import Csr
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.prior._kernels import match, merge

REST = 1e-4
LARGEST, FILL = 1024, 60_000  # nodes, and entries of the factor
SMALL = 200  # nodes up to which all eigenvalues are found


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Groups of states and the penalty on functions of the groups.

    Attributes
    ----------
    group : (S,), the group of each state
    penalty : csc of shape (K, K), positive definite: Q on functions that are constant in each group
    log_determinant : of ``penalty``
    """

    group: IntArray
    penalty: sparse.csc_array
    log_determinant: float


class Factor:
    """Of a symmetric positive definite matrix: sparse, by minimum degree without pivoting; dense, Cholesky's."""

    def __init__(self, matrix: sparse.csc_array | Array):
        self._sparse: sparse_linalg.SuperLU | None = None
        self._dense: Any = None
        if isinstance(matrix, np.ndarray):
            self._dense = linalg.cho_factor(matrix, lower=True)
        else:
            self._sparse = sparse_linalg.splu(
                sparse.csc_array(matrix),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )

    @property
    def entries(self) -> int:
        """Of the factor."""
        return int(self._sparse.L.nnz) if self._sparse is not None else int(self._dense[0].size)

    def solve(self, b: Array) -> Array:
        """matrix^-1 b."""
        if self._sparse is not None:
            return np.asarray(self._sparse.solve(b))
        return np.asarray(linalg.cho_solve(self._dense, b))

    def log_determinant(self) -> float:
        """ln |matrix|."""
        if self._sparse is not None:
            return float(np.log(np.abs(self._sparse.U.diagonal())).sum())
        return 2.0 * float(np.log(np.diag(self._dense[0])).sum())


def neighbours(simulator: FiniteMDP, *, width: int = 1) -> Neighbours:
    """The graph on at most ``LARGEST / width`` groups, fewer where the factor of the penalty would fill up (expanders).

    Cost: O(nnz log S).
    """
    weights = mirrored = _weights(simulator)  # symmetric, later but for rounding: the transpose is the quicker to join
    group: IntArray = np.arange(simulator.n_states)
    nodes = max(1, LARGEST // width)
    while True:
        sizes = np.bincount(group).astype(np.float64)
        if len(sizes) <= nodes:
            penalty = sparse.csc_array(
                sparse.diags_array(weights.sum(axis=1) - weights.diagonal() + REST * sizes)
                - weights
                + sparse.diags_array(weights.diagonal())
            )
            factored = Factor(penalty)
            if len(sizes) <= 2 or factored.entries <= FILL:
                return Neighbours(group, penalty, factored.log_determinant())
        joined = match(weights.indptr, weights.indices, weights.data, sizes)
        del weights  # it is large
        merged = merge(Csr(mirrored.indptr, mirrored.indices, mirrored.data), joined)
        left = len(merged.indptr) - 1
        mirrored = sparse.csr_array((merged.data, merged.indices, merged.indptr), shape=(left, left))
        weights = sparse.csr_array(mirrored.T)
        group = joined[group]


def smooth_functions(simulator: FiniteMDP, count: int, graph: Neighbours | None = None) -> Array:
    """The smoothest functions on ``neighbours(simulator)``, (S, count) or fewer columns, each at most 1 in size.

    u = D^-1/2 v, v the eigenvectors 2, 3, ... of the normalised Laplacian I - D^-1/2 W D^-1/2 [2] on at most ``LARGEST``
    groups. Of a multiple eigenvalue the basis is what the eigensolver gives.

    [2] F. Chung, Spectral Graph Theory, 1997.
    """
    graph = neighbours(simulator) if graph is None else graph
    penalty, nodes = graph.penalty, graph.penalty.shape[0]
    if nodes <= 2:
        return np.zeros((simulator.n_states, 0))
    edges = sparse.csc_array(sparse.diags_array(penalty.diagonal()) - penalty)
    degree = np.asarray(edges.sum(axis=1)).reshape(-1)
    root = np.sqrt(np.where(degree > 0, degree, 1.0))
    scaling = sparse.diags_array(1.0 / root)
    laplacian = sparse.csc_array(sparse.eye_array(nodes) - scaling @ edges @ scaling)
    wanted = min(count, nodes - 2)
    if nodes <= SMALL:
        vectors = linalg.eigh(laplacian.toarray(), subset_by_index=[1, wanted])[1]
    else:
        values, found = sparse_linalg.eigsh(laplacian, k=wanted + 1, sigma=-1e-3, v0=np.ones(nodes))
        vectors = found[:, np.argsort(values, kind="stable")[1:]]
    levels = vectors / root[:, None]
    levels = levels / np.maximum(np.abs(levels).max(axis=0), 1e-300)
    return np.asarray(levels[graph.group])


def _weights(simulator: FiniteMDP) -> sparse.csr_array:
    """w(s, s') as a symmetric (S, S) matrix."""
    matrix, n_actions = simulator.transitions, simulator.n_actions
    shape = (simulator.n_states, simulator.n_states)  # a state's rows stand one behind another
    one_way = sparse.csr_array(
        (matrix.data / n_actions, matrix.indices.copy(), matrix.indptr[::n_actions].copy()), shape
    )
    one_way.sum_duplicates()
    both: sparse.csr_array = sparse.csr_array(one_way + one_way.T)
    both.data *= 0.5
    both.sort_indices()
    return both
