"""Half of the states out of (I - gamma K) x = b before it is iterated: those of an independent set, exactly.

With E a set of states without an entry between them, x_e = (b_e + gamma sum_c K_ec x_c) / (1 - gamma K_ee), and what is
left is a system I - K' of the same kind (a Schur complement of an M-matrix) [1]. On a grid E is every other cell, K' has
as many entries as K, and the iteration takes a third of the steps.

Reference: [1] Saad, Iterative Methods for Sparse Linear Systems, 2003, section 12.5 (independent set orderings; ILUM).
"""

from collections import namedtuple

import numpy as np
from numba import njit

from oee_tabular.exact.solvers import _bicgstab as bicgstab
from oee_tabular.exact.system import Kernel

# 1 for the states of E, else 0; the inverse diagonal of E; the states that are left, and each one's number there
Reduction = namedtuple("Reduction", "mark inverse states number")


@njit(cache=True)
def independent(kernel, order):
    """1 for the states of E, found greedily in the given order, else 0; the inverse diagonal of E; room that K' may need."""
    indptr, indices, data, discount = kernel
    n = len(order)
    mark = np.zeros(n, dtype=np.uint8)
    inverse = np.zeros(n)
    for q in range(n):
        state = order[q]
        if mark[state] != 0:
            continue
        diagonal = 1.0
        free = True
        for k in range(indptr[state], indptr[state + np.uint32(1)]):
            j = indices[k]
            if j == state:
                diagonal -= discount * data[k]
            elif mark[j] == 1:
                free = False
        if free and diagonal > 0.0:
            mark[state] = 1
            inverse[state] = 1.0 / diagonal
            for k in range(indptr[state], indptr[state + np.uint32(1)]):
                if indices[k] != state:
                    mark[indices[k]] = 2
    room = np.int64(0)
    for state in range(n):
        if mark[state] == 1:
            continue
        mark[state] = 0
        for k in range(indptr[state], indptr[state + 1]):
            j = indices[k]
            if mark[j] == 1:
                room += np.int64(indptr[j + np.uint32(1)] - indptr[j])
            else:
                room += 1
    return mark, inverse, room


@njit(cache=True)
def added(columns, values, where, begin, filled, i, value):
    """The row from ``begin`` on with ``value`` added at column i, and where it ends then."""
    at = where[i]
    if begin <= at and at < filled and columns[at] == i:
        values[at] += value
        return filled
    where[i], columns[filled], values[filled] = filled, i, value
    return filled + np.uint64(1)


@njit(cache=True)
def eliminate(kernel, order, mark, inverse, room):
    """The rest K' in the given order of what is left, with discount 1; and the ``Reduction``."""
    indptr, indices, data, discount = kernel
    columns, values = np.empty(room, dtype=np.uint32), np.empty(room)  # only what is filled becomes memory
    n = len(order)
    number = np.zeros(n, dtype=np.uint32)
    left = 0
    for q in range(n):
        if mark[order[q]] == 0:
            number[order[q]] = left
            left += 1
    starts = np.empty(left + 1, dtype=np.uint32)
    states = np.empty(left, dtype=np.uint32)
    where = np.zeros(left, dtype=np.uint32)
    starts[0] = 0
    filled = np.uint64(0)
    for q in range(n):
        state = order[q]
        if mark[state] != 0:
            continue
        row = number[state]
        begin = filled
        states[row] = state
        for k in range(indptr[state], indptr[state + np.uint32(1)]):
            j = indices[k]
            value = discount * data[k]
            if mark[j] == 0:
                filled = added(columns, values, where, begin, filled, number[j], value)
                continue
            value *= discount * inverse[j]
            for m in range(indptr[j], indptr[j + np.uint32(1)]):
                if indices[m] == j:
                    continue
                filled = added(columns, values, where, begin, filled, number[indices[m]], value * data[m])
        starts[row + np.uint32(1)] = filled
    rest = Kernel(starts, columns[: starts[-1]], values[: starts[-1]], 1.0)
    return rest, Reduction(mark, inverse, states, number)


@njit(cache=True)
def reduce_right(kernel, reduction, transpose, b):
    """The right side of what is left."""
    indptr, indices, data, discount = kernel
    mark, inverse, states, number = reduction
    reduced = np.empty(len(states))
    for row in range(len(states)):
        state = states[row]
        total = 0.0
        if not transpose:
            for k in range(indptr[state], indptr[state + np.uint32(1)]):
                j = indices[k]
                if mark[j] == 1:
                    total += data[k] * inverse[j] * b[j]
        reduced[row] = b[state] + discount * total
    if transpose:
        for state in range(len(b)):
            if mark[state] == 1:
                value = discount * inverse[state] * b[state]
                for k in range(indptr[state], indptr[state + 1]):
                    if mark[indices[k]] == 0:
                        reduced[number[indices[k]]] += data[k] * value
    return reduced


@njit(cache=True)
def extend(kernel, reduction, transpose, b, y):
    """The whole solution from that of what is left."""
    indptr, indices, data, discount = kernel
    mark, inverse, states, _ = reduction
    x = np.zeros(len(b))
    for row in range(len(states)):
        state = states[row]
        x[state] = y[row]
        if transpose:
            for k in range(indptr[state], indptr[state + np.uint32(1)]):
                if mark[indices[k]] == 1:
                    x[indices[k]] += data[k] * y[row]
    for state in range(len(b)):
        if mark[state] == 1:
            total = x[state]
            if not transpose:
                for k in range(indptr[state], indptr[state + 1]):
                    if mark[indices[k]] == 0:
                        total += data[k] * x[indices[k]]
            x[state] = (b[state] + discount * total) * inverse[state]
    return x


@njit(cache=True)
def solve(kernel, reduction, factors, transpose, steps, b, relative):
    """x, by BiCGSTAB on what is left."""
    y = bicgstab.solve(factors, steps, reduce_right(kernel, reduction, transpose, b), relative)
    return None if y is None else extend(kernel, reduction, transpose, b, y)
