"""Direct solvers without pivoting for M = I - gamma K with a nonnegative K: dense and banded, one system or many.

An M-matrix needs no pivoting, and a pivot that is not positive says that it is none: the spectral radius of gamma K is
not below 1. Entry (i, j) is stored at i * step + j + shift: step n and shift 0 for a dense matrix; for a band of bl below
and bu above the diagonal, step bl + bu and shift bl.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


def factor(a: Any, n: Any, step: Any, shift: Any, below: Any, above: Any) -> Any:
    """LU in place, unit lower; whether all pivots are positive."""
    for k in range(n):
        pivot_row = k * step + shift
        pivot = a[pivot_row + k]
        if not pivot > 0.0:
            return False
        end = min(n, k + above + 1)
        for i in range(k + 1, min(n, k + below + 1)):
            row = i * step + shift
            f = a[row + k]
            if f != 0.0:
                f /= pivot
                a[row + k] = f
                target = a[row + k + 1 : row + end]  # slices: a computed signed index is not vectorised
                source = a[pivot_row + k + 1 : pivot_row + end]
                for j in range(len(target)):
                    target[j] -= f * source[j]
    return True


factor = njit(cache=True)(factor)


def substitute(a: Any, n: Any, step: Any, shift: Any, below: Any, above: Any, x: Any, transpose: Any) -> None:
    """Solve M x = b, or M^T x = b, in place."""
    if transpose:
        for i in range(n):
            row = i * step + shift
            value = x[i] / a[row + i]
            x[i] = value
            for j in range(i + 1, min(n, i + above + 1)):
                x[j] -= a[row + j] * value
        for i in range(n - 1, -1, -1):
            row = i * step + shift
            value = x[i]
            for j in range(max(0, i - below), i):
                x[j] -= a[row + j] * value
        return
    for i in range(n):
        row = i * step + shift
        total = x[i]
        for j in range(max(0, i - below), i):
            total -= a[row + j] * x[j]
        x[i] = total
    for i in range(n - 1, -1, -1):
        row = i * step + shift
        total = x[i]
        for j in range(i + 1, min(n, i + above + 1)):
            total -= a[row + j] * x[j]
        x[i] = total / a[row + i]


substitute = njit(cache=True)(substitute)


def band_of(indptr: Any, indices: Any, place: Any) -> Any:
    """How far entries lie below and above the diagonal: as they stand, and in the order that ``place`` gives."""
    below: Any = 0
    above: Any = 0
    below_placed: Any = 0
    above_placed: Any = 0
    for i in range(len(indptr) - 1):
        here = np.int64(place[i])
        for k in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[k])
            distance = j - i
            above = max(above, distance)
            below = max(below, -distance)
            distance = np.int64(place[j]) - here
            above_placed = max(above_placed, distance)
            below_placed = max(below_placed, -distance)
    return below, above, below_placed, above_placed


band_of = njit(cache=True)(band_of)


def fill(indptr: Any, indices: Any, data: Any, discount: Any, place: Any, size: Any, step: Any, shift: Any) -> Any:
    """I - discount K in the order that ``place`` gives."""
    a = np.zeros(size)
    for i in range(len(indptr) - 1):
        row = np.int64(place[i]) * step + shift
        a[row + np.int64(place[i])] += 1.0
        for k in range(indptr[i], indptr[i + 1]):
            a[row + np.int64(place[indices[k]])] -= discount * data[k]
    return a


fill = njit(cache=True)(fill)


def assemble(indptr: Any, indices: Any, data: Any, policy: Any, rewards: Any, kernel: Any, pay: Any) -> Any:
    """The dense kernel (flat) and the rewards of a policy; the largest sums of a row and of the magnitudes of its pay.

    ``indptr`` holds the rows of one MDP; the other arrays of an MDP with S states and A actions are flat as well.
    """
    n = len(pay)
    n_actions = (len(indptr) - 1) // n
    kernel[:] = 0.0
    mass, paid = 0.0, 0.0
    for state in range(n):
        value, size = 0.0, 0.0
        for action in range(n_actions):
            row = state * n_actions + action
            weight = policy[row]
            if weight == 0.0:
                continue
            term = weight * rewards[row]
            value += term
            size += abs(term)
            for k in range(indptr[row], indptr[row + 1]):
                kernel[np.int64(indices[k]) + state * n] += weight * data[k]
        pay[state] = value
        paid = max(paid, size)
        total = 0.0
        for j in range(state * n, state * n + n):
            total += kernel[j]
        mass = max(mass, total)
    return mass, paid


assemble = njit(cache=True)(assemble)


def missing(kernel: Any, discount: Any, pay: Any, x: Any, out: Any, formed: Any) -> Any:
    """pay - (I - discount kernel) x, its largest magnitude, and the largest with its rounding (policy_rows.residual)."""
    n = len(x)
    unit = 0.5 * np.finfo(np.float64).eps * (1.0 + 1e-9)
    largest, bound = 0.0, 0.0
    for i in range(n):
        total, size = 0.0, 0.0
        for j in range(n):
            term = kernel[i * n + j] * x[j]
            total += term
            size += abs(term)
        value = pay[i] + (discount * total - x[i])
        out[i] = value
        here = unit * (n + 4.0 + formed) * (discount * size + abs(x[i]) + abs(pay[i]))
        value = abs(value)
        if not value <= largest:
            largest = value
        if not value + here <= bound:
            bound = value + here
    return largest, bound


missing = njit(cache=True)(missing)


def solve_small(
    kernel: Any, pay: Any, mass: Any, paid: Any, discount: Any, n_actions: Any, matrix: Any, spare: Any, x: Any
) -> Any:
    """x = (I - discount kernel)^-1 pay with a bound on its error; nan where the infinite sum does not exist."""
    n = len(x)
    for i in range(n):
        for j in range(n):
            matrix[i * n + j] = -discount * kernel[i * n + j]
        matrix[i * n + i] += 1.0
    if not factor(matrix, n, n, 0, n - 1, n - 1):
        return np.nan
    unit = 0.5 * np.finfo(np.float64).eps
    mass *= 1.0 + 2.0 * (n + n_actions) * unit
    if discount * mass <= 1.0 - 1e-9:
        norm = 1.0 / (1.0 - discount * mass)
    else:  # |M^-1| <= max h / (1 - |1 - M h|) for an h > 0
        x[:] = 1.0
        substitute(matrix, n, n, 0, n - 1, n - 1, x, False)
        tallest = 0.0
        for i in range(n):
            if not (x[i] > 0.0 and np.isfinite(x[i])):
                return np.nan
            tallest = max(tallest, x[i])
        ones = np.ones(n)
        _, away = missing(kernel, discount, ones, x, spare, n_actions)
        if not away < 0.5:
            return np.nan
        norm = tallest / (1.0 - away)
    x[:] = pay
    substitute(matrix, n, n, 0, n - 1, n - 1, x, False)
    _, bound = missing(kernel, discount, pay, x, spare, n_actions)
    substitute(matrix, n, n, 0, n - 1, n - 1, spare, False)
    for i in range(n):
        spare[i] += x[i]
    other = np.empty(n)
    _, refined = missing(kernel, discount, pay, spare, other, n_actions)
    if refined < bound:
        x[:] = spare
        bound = refined
    return norm * (1.0 + 1e-9) * (bound + 2.0 * (n_actions + 1.0) * unit * paid)


solve_small = njit(cache=True)(solve_small)


def small_value(indptr: Any, indices: Any, data: Any, policy: Any, rewards: Any, discount: Any) -> Any:
    """The values of one policy, and the bound on their error."""
    n, n_actions = policy.shape
    kernel, matrix = np.empty(n * n), np.empty(n * n)
    pay, spare, x = np.empty(n), np.empty(n), np.empty(n)
    mass, paid = assemble(indptr, indices, data, policy.reshape(-1), rewards.reshape(-1), kernel, pay)
    bound = solve_small(kernel, pay, mass, paid, discount, n_actions, matrix, spare, x)
    return x, bound


small_value = njit(cache=True)(small_value)
