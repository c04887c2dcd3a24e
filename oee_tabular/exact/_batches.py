"""Values of many policies in small MDPs: dense systems side by side, so that each step is one vectorised loop.

No pivoting is needed for I - gamma K (small_systems), so that all lanes do the same steps. Systems of different sizes are
filled up with an identity. The lane is the last index of every array.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

LANES = 64  # enough for the check that arrays do not overlap, which each vectorised loop begins with, to cost little


def assemble(
    pointers: Any, entry: Any, indices: Any, data: Any, policy: Any, rewards: Any, own: Any, lane: Any, kernel: Any,
    pay: Any, dense: Any,
) -> Any:  # fmt: skip
    """One lane's kernel and rewards; the largest sums of a row and of the magnitudes of its pay."""
    n_actions = len(policy) // own
    mass, paid = 0.0, 0.0
    for state in range(own):
        value, size = 0.0, 0.0
        dense[:] = 0.0
        for row in range(state * n_actions, (state + 1) * n_actions):
            weight = policy[row]
            if weight == 0.0:
                continue
            term = weight * rewards[row]
            value += term
            size += abs(term)
            low, high = entry + np.int64(pointers[row]), entry + np.int64(pointers[row + 1])
            chance = data[low:high]
            if high - low == own:
                for j in range(own):
                    dense[j] += weight * chance[j]
            else:
                to = indices[low:high]
                for k in range(high - low):
                    dense[to[k]] += weight * chance[k]
        total = 0.0
        for j in range(own):
            kernel[state, j, lane] = dense[j]
            total += dense[j]
        pay[state, lane] = value
        paid = max(paid, size)
        mass = max(mass, total)
    return mass, paid


assemble = njit(cache=True)(assemble)


def inner(total: Any, left: Any, right: Any) -> None:
    """total -= sum_k left[k] * right[k] in every lane."""
    for k in range(len(left)):
        x, y = left[k], right[k]
        for lane in range(len(total)):
            total[lane] -= x[lane] * y[lane]


inner = njit(cache=True)(inner)


def factor(lower: Any, upper: Any, n: Any, regular: Any) -> None:
    """Crout's LU without pivoting of the matrix in ``lower``; ``upper[j, i]`` is U_ij, ``upper[j, j]`` inverse pivots.

    ``regular`` says in which lanes all pivots were positive.
    """
    for i in range(n):
        for j in range(i):
            entry = lower[i, j]
            inner(entry, lower[i, :j], upper[j, :j])
            for lane in range(len(regular)):
                entry[lane] *= upper[j, j, lane]
        for j in range(i, n):
            entry = upper[j, i]
            for lane in range(len(regular)):
                entry[lane] = lower[i, j, lane]
            inner(entry, lower[i, :i], upper[j, :i])
        pivot = upper[i, i]
        for lane in range(len(regular)):
            regular[lane] = regular[lane] and pivot[lane] > 0.0
            pivot[lane] = 1.0 / pivot[lane] if pivot[lane] > 0.0 else 0.0


factor = njit(cache=True)(factor)


def substitute(lower: Any, upper: Any, n: Any, x: Any) -> None:
    """Solve in every lane, in place."""
    for i in range(1, n):
        inner(x[i], lower[i, :i], x[:i])
    for j in range(n - 1, -1, -1):
        value = x[j]
        for lane in range(x.shape[1]):
            value[lane] *= upper[j, j, lane]
        for i in range(j):
            inner(x[i], upper[j, i : i + 1], x[j : j + 1])


substitute = njit(cache=True)(substitute)


def backup(kernel: Any, discount: Any, pay: Any, n: Any, x: Any, out: Any) -> None:
    """pay + discount * kernel x in every lane."""
    for i in range(n):
        total = out[i]
        total[:] = 0.0
        inner(total, kernel[i, :n], x[:n])
        own = pay[i]
        for lane in range(len(discount)):
            total[lane] = own[lane] - discount[lane] * total[lane]


backup = njit(cache=True)(backup)


def missing(kernel: Any, discount: Any, pay: Any, n: Any, x: Any, out: Any, largest: Any, tallest: Any) -> None:
    """The residual pay + discount * kernel x - x, its largest magnitude in every lane, and that of x."""
    backup(kernel, discount, pay, n, x, out)
    largest[:] = 0.0
    tallest[:] = 0.0
    for i in range(n):
        left, own = out[i], x[i]
        for lane in range(len(largest)):
            left[lane] -= own[lane]
            largest[lane] = max(largest[lane], abs(left[lane]))
            tallest[lane] = max(tallest[lane], abs(own[lane]))


missing = njit(cache=True)(missing)


def small_values(
    pointers: Any, first_pointer: Any, first_entry: Any, indices: Any, data: Any, first_row: Any, rewards: Any,
    first_action: Any, policies: Any, first_state: Any, sizes: Any, discounts: Any, horizon: Any, values: Any, errors: Any,
) -> None:  # fmt: skip
    """Values of many policies; horizon 0 is the infinite sum.

    Everything is flat, and problem i begins at the place that the array ``first_...`` says: its row pointers (to which
    ``first_entry`` is added), its rewards, its policy, its values. An error of nan: the rows exceed 1 / discount or come
    near it, and a single evaluation has to look.
    """
    most = np.int64(0)
    for i in range(len(sizes)):
        most = max(most, sizes[i])
    kernel, lower, upper = np.empty((most, most, LANES)), np.empty((most, most, LANES)), np.empty((most, most, LANES))
    pay, x, out, trial = (
        np.empty((most, LANES)), np.empty((most, LANES)), np.empty((most, LANES)), np.empty((most, LANES))
    )  # fmt: skip
    dense = np.empty(most)
    discount, mass, paid, regular = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.ones(LANES, dtype=np.bool_)
    largest, tallest, again, other = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    unit = 0.5 * np.finfo(np.float64).eps * (1.0 + 1e-9)
    for block in range(0, len(sizes), LANES):
        width = min(LANES, len(sizes) - block)
        n = np.int64(0)
        for lane in range(width):
            n = max(n, sizes[block + lane])
        kernel[:n, :n] = 0.0
        pay[:n] = 0.0
        discount[:] = 0.0
        for lane in range(width):
            i = block + lane
            policy = policies[first_action[i] : first_action[i + 1]]
            own = pointers[first_pointer[i] : first_pointer[i] + len(policy) + 1]
            paying = rewards[first_row[i] : first_row[i] + len(policy)]
            discount[lane] = discounts[i]
            mass[lane], paid[lane] = assemble(
                own, first_entry[i], indices, data, policy, paying, sizes[i], lane, kernel, pay, dense
            )
        if horizon > 0:
            x[:n] = 0.0
            for _ in range(horizon):
                backup(kernel, discount, pay, n, x, out)
                x, out = out, x
        else:
            for i in range(n):
                for j in range(n):
                    target, source = lower[i, j], kernel[i, j]
                    one = 1.0 if i == j else 0.0
                    for lane in range(LANES):
                        target[lane] = one - discount[lane] * source[lane]
            regular[:] = True
            factor(lower, upper, n, regular)
            x[:n] = pay[:n]
            substitute(lower, upper, n, x)
            missing(kernel, discount, pay, n, x, out, largest, tallest)
            rough = False
            for lane in range(LANES):
                rough = rough or not largest[lane] <= 8.0 * unit * (2.0 * tallest[lane] + paid[lane])
            if rough:
                substitute(lower, upper, n, out)
                trial[:n] = x[:n] + out[:n]
                missing(kernel, discount, pay, n, trial, out, again, other)
                for lane in range(LANES):
                    if again[lane] < largest[lane]:
                        largest[lane], tallest[lane] = again[lane], other[lane]
                        for i in range(n):
                            x[i, lane] = trial[i, lane]
        for lane in range(width):
            i = block + lane
            place, own_states = first_state[i], sizes[i]
            for s in range(own_states):
                values[place + s] = x[s, lane]
            if horizon > 0:
                errors[i] = 0.0
                continue
            roundings = own_states + (first_action[i + 1] - first_action[i]) // own_states
            carried = discount[lane] * mass[lane] * (1.0 + 2.0 * (roundings + 1.0) * unit)
            if regular[lane] and carried <= 1.0 - 1e-9:
                rounding = (roundings + 4.0) * unit * (2.0 * tallest[lane] + 2.0 * paid[lane])
                errors[i] = (largest[lane] + rounding) / (1.0 - carried) * (1.0 + 1e-9)
            else:
                errors[i] = np.nan


small_values = njit(cache=True)(small_values)
