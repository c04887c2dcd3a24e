"""BiCGSTAB for (I - gamma K) x = b, on what an independent set of states leaves, with a modified diagonal incomplete LU.

With E a set of states without an entry between them, x_e = (b_e + gamma sum_c K_ec x_c) / (1 - gamma K_ee), and what is
left is a system I - K' of the same kind (a Schur complement of an M-matrix) [1]. On a grid E is every other cell, K' has
as many entries as K, and the iteration takes a third of the steps.

States are taken in breadth-first order, so that the sweeps of a wave front do not wait for each other, and the trees of a
search that starts anew stand before those it had found: a layered kernel is then upper triangular and solved in one step.

References: [1] Saad, Iterative Methods for Sparse Linear Systems, 2003, section 12.5 (independent set orderings; ILUM).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from oee_tabular._checks import Array
from oee_tabular.exact._policy_rows import add_entry, multiply
from oee_tabular.exact.solvers import _bicgstab
from oee_tabular.exact.system import Kernel, Solve, System

# where a direct solver can follow: grids of up to 60 x 60 take 6 to 16 at .99 and up to 39 at .9999, small worlds of 500 states 53
# at .999, random bands 67 at .99 and up to 500
FEW_STEPS = 72


@dataclass(frozen=True)
class BiCGStab:
    """For every sparse system: a few dozen sweeps, in memory of a few vectors.

    None of E is eliminated where what is left would have more than 2.5 times as many entries. On grids of 300 x 300 its
    elimination makes this 1.9 to 4.5 times as fast for policies that get somewhere (a random walk: 1 to 1.7), at 100 x 100 1.2
    to 1.9 times.
    """

    name: str = "BiCGSTAB"
    is_direct: bool = False

    def suits(self, system: System) -> bool:
        """All systems."""
        return True

    def prepare(self, system: System) -> Solve:
        """The reduced system and its factors."""
        kernel, transpose, (order, _) = system.kernel, system.transpose, system.order
        inverse, room = find_independent(kernel, order)
        if room > 2.5 * len(kernel.indices):
            inverse, room = np.zeros(system.n_states), len(kernel.indices)
        rest, states = eliminate(kernel, order, inverse, room)
        # weight 1 keeps row sums, which counts near discount 1; a little below it the iteration is steadier in a drift
        weight = 1.0 - min(0.1, max(0.001, 0.15 * np.sqrt(1.0 - kernel.discount)))
        factors = _bicgstab.factorise(rest, transpose, weight)
        steps = _bicgstab.STEPS if system.envelope is None else FEW_STEPS

        def solve(b: Array, relative: float) -> Array | None:
            """M_CC y + M_CE x_e = b_c with x_e = M_EE^-1 (b_e - M_EC y)."""
            ahead = np.empty(len(b))
            multiply(kernel, transpose, inverse * b, ahead)
            y = _bicgstab.solve(factors, steps, (b + kernel.discount * ahead)[states], relative)
            if y is None:
                return None
            x = np.zeros(len(b))
            x[states] = y
            multiply(kernel, transpose, x, ahead)
            return np.asarray(x + inverse * (b + kernel.discount * ahead))

        return solve


@njit(cache=True)
def find_independent(kernel, order):
    """1 / (1 - gamma K_ee) of the states of E, found greedily in the given order, else 0; room that K' may need."""
    indptr, indices, data, discount = kernel
    n = len(order)
    is_free, inverse, room = np.ones(n, dtype=np.bool_), np.zeros(n), np.int64(0)
    for q in range(n):
        state, diagonal = order[q], 1.0
        for k in range(indptr[state], indptr[state + np.uint32(1)]):
            if indices[k] == state:
                diagonal -= discount * data[k]
            elif inverse[indices[k]] > 0.0:
                is_free[state] = False
        if is_free[state] and diagonal > 0.0:
            inverse[state] = 1.0 / diagonal
            for k in range(indptr[state], indptr[state + np.uint32(1)]):
                is_free[indices[k]] = False
    for state in range(n):
        if inverse[state] == 0.0:
            for k in range(indptr[state], indptr[state + 1]):
                j = indices[k]
                room += np.int64(indptr[j + np.uint32(1)] - indptr[j]) if inverse[j] > 0.0 else 1
    return inverse, room


@njit(cache=True)
def eliminate(kernel, order, inverse, room):
    """K' in the given order of the states that are left, with discount 1; and these states."""
    indptr, indices, data, discount = kernel
    states = order[inverse[order] == 0.0]
    number, place = np.zeros(len(order), dtype=np.uint32), np.zeros(len(states), dtype=np.uint32)
    for row in range(len(states)):
        number[states[row]] = row
    columns, values = np.empty(room, dtype=np.uint32), np.empty(room)  # only what is filled becomes memory
    starts, filled = np.zeros(len(states) + 1, dtype=np.uint32), np.uint64(0)
    for row in range(len(states)):
        begin, state = filled, states[row]
        for k in range(indptr[state], indptr[state + np.uint32(1)]):
            j, value = indices[k], discount * data[k]
            if inverse[j] == 0.0:
                filled = add_entry(columns, values, place, begin, filled, number[j], value)
                continue
            value *= discount * inverse[j]
            for m in range(indptr[j], indptr[j + np.uint32(1)]):
                if indices[m] != j:
                    filled = add_entry(columns, values, place, begin, filled, number[indices[m]], value * data[m])
        starts[row + 1] = filled
    return Kernel(starts, columns[:filled], values[:filled], 1.0), states
