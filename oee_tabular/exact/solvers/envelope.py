"""LU without pivoting within the envelope of M = I - gamma K, whose states are eliminated in a given order.

    L_ij = (M_ij - sum_k L_ik U_kj) / U_jj,    U_ji = M_ji - sum_k L_jk U_ki   (j < i),    U_ii = M_ii - sum_k L_ik U_ki

All U_ii > 0 if and only if M is an M-matrix that is not singular, which needs no pivoting.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from numba import njit

from oee_tabular._checks import Array
from oee_tabular.exact.system import Solve, System

# states in the order of elimination, the first linked one of each, where its row begins; rows of L, columns of U, U's diagonal
Envelope = namedtuple("Envelope", "order first starts lower upper diagonal")


@dataclass(frozen=True)
class EnvelopeLU:
    """O(S w^2) for an envelope of w entries a state: rings, chains, queues, layers, whatever the order of their states.

    Up to ``WIDEST`` this is .8 to 6 times as fast as SuperLU (tests/benchmarks/values.py). ``is_narrow``: only up to 10
    entries a state, or twice those of K, where it is 2 to 6 times as fast; between that and ``WIDEST`` lie grids of up
    to 60 x 60, which BiCGSTAB solves in few steps, and random bands.
    """

    is_narrow: bool = False
    name: str = "LU in a band"
    is_direct: bool = True

    def suits(self, system: System) -> bool:
        """Graphs that a breadth-first search walks through in narrow fronts."""
        if (self.is_narrow and system.expands) or system.envelope is None:
            return False
        n_filled, n_entries = system.envelope[-1][-1], len(system.kernel.indices)
        return not self.is_narrow or bool(n_filled <= max(10 * system.n_states, 2 * n_entries))

    def prepare(self, system: System) -> Solve:
        """Gives up where a pivot is not positive: then M is no M-matrix."""
        assert system.envelope is not None
        factors, is_regular = factorise(system.kernel, *system.envelope)

        def solve(b: Array, relative: float) -> Array | None:
            return np.asarray(substitute(factors, system.transpose, b)) if is_regular else None

        return solve


@njit(cache=True)
def factorise(kernel, place, order, first, starts):
    """The factors, and whether all pivots are positive."""
    indptr, indices, data, discount = kernel
    n = len(order)
    lower, upper, diagonal = np.zeros(starts[n]), np.zeros(starts[n]), np.ones(n)
    for state in range(n):
        i = n - 1 - np.int64(place[state])
        for k in range(indptr[state], indptr[state + 1]):
            j, value = n - 1 - np.int64(place[indices[k]]), discount * data[k]
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
            below, above = lower[own + j], upper[own + j]
            for k in range(max(first[i], first[j]), j):
                below -= lower[own + k] * upper[other + k]
                above -= lower[other + k] * upper[own + k]
            lower[own + j], upper[own + j] = below / diagonal[j], above
            diagonal[i] -= lower[own + j] * above
        if not diagonal[i] > 0.0:
            break
    return Envelope(order, first, starts, lower, upper, diagonal), diagonal.min() > 0.0


@njit(cache=True)
def substitute(factors, transpose, b):
    """x of L U x = b, or of U^T L^T x = b."""
    order, first, starts, lower, upper, diagonal = factors
    n = len(b)
    y, x = np.empty(n), np.empty(n)
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
