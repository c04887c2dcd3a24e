"""LU without pivoting within the envelope of M = I - gamma K, whose states are eliminated in a given order.

    L_ij = (M_ij - sum_k L_ik U_kj) / U_jj,    U_ji = M_ji - sum_k L_jk U_ki   (j < i),    U_ii = M_ii - sum_k L_ik U_ki:

row i of L and column i of U begin with the first state that i is linked to, either way; only what lies between is filled [1].
All U_ii > 0 if and only if M is an M-matrix that is not singular, which needs no pivoting.

Reference: [1] George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 4.
"""

from collections import namedtuple

import numpy as np
from numba import njit

# states in the order of elimination, the first linked one of each, where its row begins; rows of L, columns of U, U's diagonal
Envelope = namedtuple("Envelope", "order first starts lower upper diagonal")


@njit(cache=True)
def find_envelope(kernel, place):
    """The order of elimination, the reverse of ``place``; the first linked state of each; where its row begins."""
    n = len(place)
    order, first, starts = np.empty(n, dtype=np.int64), np.arange(n), np.zeros(n + 1, dtype=np.int64)
    for state in range(n):
        i = n - 1 - np.int64(place[state])
        order[i] = state
        for k in range(kernel.indptr[state], kernel.indptr[state + 1]):
            j = n - 1 - np.int64(place[kernel.indices[k]])
            first[i] = min(first[i], j)
            first[j] = min(first[j], i)
    for i in range(n):
        starts[i + 1] = starts[i] + i - first[i]
    return order, first, starts


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
            return Envelope(order, first, starts, lower, upper, diagonal), False
    return Envelope(order, first, starts, lower, upper, diagonal), True


@njit(cache=True)
def solve(factors, transpose, b):
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
