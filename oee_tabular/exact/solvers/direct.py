"""LU of M = I - gamma K, three ways: dense by LAPACK, within an envelope, sparse by
SuperLU.

Within the envelope states are eliminated in a given order and without pivoting:

    L_ij = (M_ij - sum_k L_ik U_kj) / U_jj,    U_ji = M_ji - sum_k L_jk U_ki   (j < i),    U_ii = M_ii - sum_k L_ik U_ki

All U_ii > 0 if and only if M is an M-matrix that is not singular, which needs no
pivoting.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse import linalg as sparse_linalg

from oee_tabular.exact import _system
from oee_tabular.exact.system import Csr, Solve, System
from oee_tabular.typing import Array

LAST_RESORT = 3000  # states: 72 MB and a second

# states in the order of elimination, the first linked one of each, where its row
# begins; rows of L, columns of U, U's diagonal
Envelope = namedtuple("Envelope", "order first starts lower upper diagonal")


@dataclass(frozen=True)
class LAPACK:
    """Dense, O(S^3), for up to ``most`` states.

    Of 100 states it takes as long as the best of the others, of fewer less, and it
    needs next to nothing compiled.
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
            return (
                None
                if is_singular
                else np.asarray(
                    lapack.dgetrs(factors, place, b, trans=not system.transpose)[0]
                )
            )

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


@dataclass(frozen=True)
class EnvelopeLU:
    """O(S w^2) for an envelope of w entries a state: rings, chains, queues, layers,
    whatever the order of their states.

    Up to ``WIDEST`` this is .8 to 6 times as fast as SuperLU
    (tests/benchmarks/values.py). ``is_narrow``: only up to 10 entries a state, or twice
    those of K, where it is 2 to 6 times as fast; between that and ``WIDEST`` lie grids
    of up to 60 x 60, which BiCGSTAB solves in few steps, and random bands.
    """

    is_narrow: bool = False
    name: str = "LU in a band"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """Graphs that a breadth-first search walks through in narrow fronts."""
        if (self.is_narrow and system.expands) or system.envelope is None:
            return False
        n_filled = system.envelope[-1][-1]
        n_entries = len(system.kernel.indices)
        return not self.is_narrow or bool(
            n_filled <= max(10 * system.n_states, 2 * n_entries)
        )

    def prepare(self, system: System) -> Solve:
        """Gives up where a pivot is not positive: then M is no M-matrix."""
        assert system.envelope is not None
        factors, is_regular = factorise(system.kernel, *system.envelope)

        def solve(b: Array, relative: float) -> Array | None:
            return (
                np.asarray(substitute(factors, system.transpose, b))
                if is_regular
                else None
            )

        return solve


@njit(cache=True)
def factorise(kernel, place, order, first, starts):
    """The factors, and whether all pivots are positive."""
    indptr, indices, data, discount = kernel
    n = len(order)
    lower = np.zeros(starts[n])
    upper = np.zeros(starts[n])
    diagonal = np.ones(n)
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
    """x of L U x = b, or of U^T L^T x = b."""
    order, first, starts, lower, upper, diagonal = factors
    n = len(b)
    y = np.empty(n)
    x = np.empty(n)
    ahead, behind = (upper, lower) if transpose else (lower, upper)
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
    """Sparse, eliminated in the order of minimum degree.

    ``most`` : entries a state that an elimination in the reverse of a breadth-first
    order may fill, which is counted first: with 8 trees; None for the last resort,
    which any graph that does not expand suits.
    """

    most: float | None = None
    name: str = "sparse LU"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """By the count, first along the rows alone, which spares a transpose; graphs
        that expand fill up in any order.
        """
        if self.most is None:
            return not system.expands
        rows = Csr(*system.kernel[:3])
        along_rows = _system.fills_little(system.kernel, rows, *system.order, self.most)
        return bool(
            along_rows
            and _system.fills_little(
                system.kernel, system.back, *system.order, self.most
            )
        )

    def prepare(self, system: System) -> Solve:
        """Gives up on a singular system, as far as SuperLU sees it."""
        kernel = system.csr()
        rows = sparse.csr_array(
            sparse.eye_array(system.n_states, format="csr")
            - system.kernel.discount * kernel
        )
        transposed = sparse.csc_array(
            (rows.data, rows.indices, rows.indptr), shape=rows.shape
        )
        try:
            factors = sparse_linalg.splu(
                transposed,
                "MMD_AT_PLUS_A",
                options={"SymmetricMode": True, "Equil": False},
            )
        except RuntimeError:  # singular
            return lambda b, relative: None

        def solve(b: Array, relative: float) -> Array:
            return np.asarray(factors.solve(b, "N" if system.transpose else "T"))

        return solve
