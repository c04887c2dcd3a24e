"""LU of M = I - gamma K: dense by LAPACK, within an envelope, and sparse by SuperLU.

Within the envelope states are eliminated in a given order and without pivoting:

    L_ij = (M_ij - sum_k L_ik U_kj) / U_jj        (j < i)
    U_ji = M_ji - sum_k L_jk U_ki                 (j < i)
    U_ii = M_ii - sum_k L_ik U_ki

All U_ii > 0 if and only if M is an M-matrix that is not singular, which needs no
pivoting.
"""

from __future__ import annotations

from collections import namedtuple
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse import linalg as sparse_linalg

from oee_tabular._compiling import njit
from oee_tabular._parallel import ONE_THREAD
from oee_tabular.exact import _system
from oee_tabular.exact.system import KernelRows, Solve, System
from oee_tabular.typing import Array

# of the last resort: a dense LU of 3000 states takes 72 MB and a second
MAX_DENSE_STATES = 3000
# of a matrix that OpenBLAS 0.3 factorises in one thread
MAX_ONE_THREAD_STATES = 100

# states in the order of elimination, the first linked state of each, where its row
# begins; rows of L, columns of U, U's diagonal
Envelope = namedtuple("Envelope", "order first starts lower upper diagonal")


@dataclass(frozen=True)
class LAPACK:
    """Dense LU, O(S^3), for up to ``most`` states.

    With 100 states it takes as long as the best of the others, with fewer less, and it
    needs next to nothing compiled.
    """

    most: int
    name: str = "dense LU"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """Return whether the states are few enough."""
        return system.n_states <= self.most

    def prepare(self, system: System) -> Solve:
        """Factorise the dense matrix; a singular system is given up."""
        # the transposed matrix is in Fortran's order, so that LAPACK copies nothing
        matrix = np.zeros((system.n_states, system.n_states))
        fill_matrix(*system.kernel, matrix)
        return solver_of_dense(matrix.T, not system.transpose)


def solver_of_dense(matrix: Array, transpose: bool) -> Solve:
    """Factorise a dense matrix in Fortran's order, which is overwritten.

    Gives the solver of its system, or of the transposed one, which gives up where the
    matrix is singular.
    """
    # OpenBLAS leaves a small matrix to one thread; of a larger one the number of
    # threads would decide the last digits
    context = ONE_THREAD if len(matrix) > MAX_ONE_THREAD_STATES else nullcontext()
    with context:
        factors, place, is_singular = lapack.dgetrf(matrix, overwrite_a=True)

    def solve(b: Array, relative: float) -> Array | None:
        """Solve by the factors, unless the matrix is singular."""
        if is_singular:
            return None
        with context:
            x, _ = lapack.dgetrs(factors, place, b, trans=transpose)
        return np.asarray(x)

    return solve


@njit(cache=True)
def fill_matrix(indptr, indices, data, discount, matrix):
    """Add I - discount K to a dense matrix (S, S)."""
    for i in range(len(indptr) - 1):
        matrix[i, i] += 1.0
        for k in range(indptr[i], indptr[i + 1]):
            matrix[i, indices[k]] -= discount * data[k]


@dataclass(frozen=True)
class EnvelopeLU:
    """LU within an envelope of w entries a state, O(S w^2).

    It suits rings, chains, queues and layers, whatever the order of their states. Up to
    ``MAX_ENVELOPE_WIDTH`` it is .8 to 6 times as fast as SuperLU
    (tests/benchmarks/values.py). ``is_narrow``: only up to 14 entries a state, or twice
    the entries of K, where it is 2 to 6 times as fast; between that and
    ``MAX_ENVELOPE_WIDTH`` lie grids of up to 60 x 60, which BiCGSTAB solves in few
    steps, and random bands.
    """

    is_narrow: bool = False
    name: str = "LU in a band"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """Return whether a breadth-first search goes in narrow fronts."""
        if (self.is_narrow and system.expands) or system.envelope is None:
            return False
        if not self.is_narrow:
            return True
        return bool(system.envelope[-1][-1] <= system.max_narrow_entries)

    def prepare(self, system: System) -> Solve:
        """Factorise within the envelope; give up where a pivot is not positive.

        M is no M-matrix then.
        """
        assert system.envelope is not None
        factors, is_regular = factorise(system.kernel, *system.envelope)

        def solve(b: Array, relative: float) -> Array | None:
            """Solve by the factors, unless a pivot is not positive."""
            if not is_regular:
                return None
            return np.asarray(substitute(factors, system.transpose, b))

        return solve


@njit(cache=True)
def factorise(kernel, place, order, first, starts):
    """Factorise M = L U within the envelope.

    L_ij = (M_ij - sum_k L_ik U_kj) / U_jj, U_ji = M_ji - sum_k L_jk U_ki for j < i.
    Returns the factors, and whether all pivots are positive.
    """
    indptr, indices, data, discount = kernel
    n = len(order)
    lower = np.zeros(starts[n])
    upper = np.zeros(starts[n])
    diagonal = np.ones(n)
    # the entries of M within the envelope
    for state in range(n):
        i = n - 1 - np.int64(place[state])
        for k in range(indptr[state], indptr[state + 1]):
            j = n - 1 - np.int64(place[indices[k]])
            value = discount * data[k]
            if j < i:
                lower[starts[i] + j - first[i]] -= value
            elif j > i:
                upper[starts[j] + i - first[j]] -= value
            else:
                diagonal[i] -= value
    # row i of L and column i of U, from the first linked state on
    for i in range(n):
        own = starts[i] - first[i]  # where column 0 would be
        for j in range(first[i], i):
            other = starts[j] - first[j]
            below = lower[own + j]
            above = upper[own + j]
            for k in range(max(first[i], first[j]), j):
                below -= lower[own + k] * upper[other + k]
                above -= lower[other + k] * upper[own + k]
            lower[own + j] = below / diagonal[j]
            upper[own + j] = above
            diagonal[i] -= lower[own + j] * above
        if not diagonal[i] > 0.0:
            break
    return Envelope(order, first, starts, lower, upper, diagonal), diagonal.min() > 0.0


@njit(cache=True)
def substitute(factors, transpose, b):
    """Solve L U x = b, or U^T L^T x = b.

    y_i = b_i - sum_{j<i} L_ij y_j, x_i = (y_i - sum_{j>i} U_ij x_j) / U_ii.
    """
    order, first, starts, lower, upper, diagonal = factors
    n = len(b)
    y = np.empty(n)
    x = np.empty(n)
    ahead, behind = (upper, lower) if transpose else (lower, upper)
    # forward by the rows of one factor, then backward by the columns of the other
    for i in range(n):
        total = b[order[i]]
        for k in range(starts[i], starts[i + 1]):
            total -= ahead[k] * y[first[i] + k - starts[i]]
        y[i] = total / diagonal[i] if transpose else total
    for turn in range(n):
        i = n - 1 - turn
        if not transpose:
            y[i] /= diagonal[i]
        x[order[i]] = y[i]
        for k in range(starts[i], starts[i + 1]):
            y[first[i] + k - starts[i]] -= behind[k] * y[i]
    return x


@dataclass(frozen=True)
class SuperLU:
    """Sparse LU, eliminated in the order of minimum degree.

    ``most`` is the number of entries a state that an elimination in the reverse of a
    breadth-first order may fill, which is counted first: with 8 trees. None is for the
    last resort, which any graph that does not expand suits.
    """

    most: float | None = None
    name: str = "sparse LU"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """Return whether elimination fills little.

        It is counted first along the rows alone, which spares a transpose; graphs that
        expand fill up in any order.
        """
        if self.most is None:
            return not system.expands
        kernel = system.kernel
        rows = KernelRows(*kernel[:3])
        order = system.order
        if not _system.fills_little(kernel, rows, *order, self.most):
            return False
        return bool(_system.fills_little(kernel, system.back, *order, self.most))

    def prepare(self, system: System) -> Solve:
        """Factorise; a system that SuperLU finds singular is given up."""
        kernel = system.csr()
        identity = sparse.eye_array(system.n_states, format="csr")
        rows = sparse.csr_array(identity - system.kernel.discount * kernel)
        # SuperLU takes columns: the rows of M as columns are the transposed matrix
        transposed = sparse.csc_array(
            (rows.data, rows.indices, rows.indptr), shape=rows.shape
        )
        # scipy-stubs does not know the second argument of ``solve``
        factors: Any
        try:
            factors = sparse_linalg.splu(
                transposed,
                "MMD_AT_PLUS_A",
                options={"SymmetricMode": True, "Equil": False},
            )
        except RuntimeError:  # singular
            return lambda b, relative: None

        which = "N" if system.transpose else "T"

        def solve(b: Array, relative: float) -> Array:
            """Solve by the factors."""
            return np.asarray(factors.solve(b, which))

        return solve
