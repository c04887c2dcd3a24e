"""BiCGSTAB for (I - K) x = b, preconditioned by a modified diagonal incomplete LU with Eisenstat's trick.

With D~ the modified diagonal, L and U the rest divided by it, the operator (I + L)^-1 (L + D + U) (I + U)^-1 costs one
backward and one forward sweep, as one product does [1]; all vector updates and dot products ride on the sweeps.

L fills one buffer from its front and U from its back.

Reference: [1] Eisenstat, Efficient implementation of a class of preconditioned conjugate gradient methods, SIAM J. Sci.
Stat. Comput. 2 (1981).
"""

from collections import namedtuple

import numpy as np
from numba import njit

from oee_tabular.exact._policy_rows import transpose_rows

FLOOR = 2e-15  # of the residual relative to y, which is a good deal smaller than x
STEPS = 500
PROBE_STEPS = 16  # within which a twentieth has to be left, where fewer than STEPS are allowed

# row pointers of L and U, their columns and values, D - 2; D~
Factors = namedtuple("Factors", "lower upper columns values diagonal modified")


@njit(cache=True)
def modified_diagonal(kernel, weight):
    """D~_i = M_ii - weight sum_{j<i} M_ij s_j with s_j = sum_{k>j} M_jk / D~_j; the plain diagonal where that is too small.

    With weight 1, (D~ + L) D~^-1 (D~ + U) has the row sums of M. The same D~ serves the transposed system.
    """
    indptr, indices, data, _ = kernel
    n = len(indptr) - 1
    modified, later = np.empty(n), np.empty(n)
    for i in range(n):
        diagonal, dropped, sum_later = 1.0, 0.0, 0.0
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j < i:
                dropped += data[k] * later[j]
            elif j > i:
                sum_later += data[k]
            else:
                diagonal -= data[k]
        pivot = diagonal - weight * dropped
        if not pivot > 0.05 * diagonal:
            pivot = diagonal if diagonal > 0.0 else 1.0  # a matrix that is singular or worse has yet to be found out
        modified[i] = pivot
        later[i] = sum_later / pivot
    return modified


@njit(cache=True)
def factorise(kernel, transpose, weight):
    """L, U and D of D~^-1 (I - K), or of the transposed matrix; the discount is in K."""
    modified = modified_diagonal(kernel, weight)
    indptr, indices, data, _ = kernel
    n = len(modified)
    if transpose:
        indptr, indices, data = transpose_rows(indptr, indices, data, n)
    lower, upper = np.empty(n + 1, dtype=np.uint32), np.empty(n + 1, dtype=np.uint32)
    columns, values, diagonal = np.empty(len(indices), dtype=np.uint32), np.empty(len(indices)), np.empty(n)
    low, high = 0, len(indices)
    lower[0], upper[0] = low, high
    for i in range(n):
        scale, own = 1.0 / modified[i], 1.0
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if j < i:
                columns[low], values[low] = j, data[k] * scale
                low += 1
            elif j > i:
                high -= 1
                columns[high], values[high] = j, data[k] * scale
            else:
                own -= data[k]
        lower[i + 1], upper[i + 1] = low, high
        diagonal[i] = own * scale - 2.0
    return Factors(lower, upper, columns, values, diagonal, modified)


@njit(cache=True)
def bicgstab(factors, b, relative, floor, steps):
    """y with (I + U)^-1 y = x for the scaled right side b, in at most ``steps`` steps; the steps taken.

    It stops where the largest entry of the preconditioned residual is below relative * (its first) or below floor times
    the largest entry of y. Values hold the negated L and U (they are nonnegative).
    """
    lower, upper, columns, values, diagonal, _ = factors
    n = len(b)
    r = np.empty(n)
    first = np.empty(n)
    size = 0.0
    for i in range(n):
        total = b[i]
        for k in range(lower[i], lower[i + 1]):
            total += values[k] * r[columns[k]]
        r[i] = total
        first[i] = total
        size = max(size, abs(total))
    y, p, v, w = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    t, z = np.empty(n), np.empty(n)
    rho, alpha, omega, beta = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        rho += r[i] * r[i]
    goal = relative * size
    taken = 0
    while True:
        largest, largest_y = 0.0, 0.0
        for i in range(n - 1, -1, -1):  # finishes the step before, and t = (I + U)^-1 p for the new p
            y_i = y[i] + (alpha * p[i] + omega * r[i])
            r_i = r[i] - omega * w[i]
            p_i = r_i + beta * (p[i] - omega * v[i])
            y[i], p[i], r[i] = y_i, p_i, r_i
            largest = max(largest, abs(r_i))
            largest_y = max(largest_y, abs(y_i))
            total = p_i
            for k in range(upper[i + 1], upper[i]):
                total += values[k] * t[columns[k]]
            t[i] = total
        is_slow = steps < STEPS and taken == PROBE_STEPS and largest > 0.05 * size
        if not largest > max(goal, floor * largest_y) or taken == steps or is_slow:
            taken = steps if is_slow else taken
            break
        taken += 1
        along = 0.0
        for i in range(n):
            total = p[i] + diagonal[i] * t[i]
            for k in range(lower[i], lower[i + 1]):
                total += values[k] * z[columns[k]]
            z[i] = total
            v_i = total + t[i]
            v[i] = v_i
            along += first[i] * v_i
        if along == 0.0 or not np.isfinite(along):
            break
        alpha = rho / along
        for i in range(n - 1, -1, -1):  # r holds the half step's residual from here to the next sweep upwards
            s_i = r[i] - alpha * v[i]
            r[i] = s_i
            total = s_i
            for k in range(upper[i + 1], upper[i]):
                total += values[k] * t[columns[k]]
            t[i] = total
        ws, ww, first_w, first_s = 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            s_i = r[i]
            total = s_i + diagonal[i] * t[i]
            for k in range(lower[i], lower[i + 1]):
                total += values[k] * z[columns[k]]
            z[i] = total
            w_i = total + t[i]
            w[i] = w_i
            ws += w_i * s_i
            ww += w_i * w_i
            first_w += first[i] * w_i
            first_s += first[i] * s_i
        omega = ws / ww if ww > 0.0 else 0.0
        new = first_s - omega * first_w
        if (
            omega == 0.0 or rho == 0.0 or not (np.isfinite(new) and abs(new) > 0.0)
        ):  # nowhere to go: start anew from here
            if np.isfinite(alpha) and np.isfinite(omega):
                for i in range(n):
                    y[i] += alpha * p[i] + omega * r[i]
            break
        beta = (new / rho) * (alpha / omega)
        rho = new
    for i in range(n - 1, -1, -1):
        total = y[i]
        for k in range(upper[i + 1], upper[i]):
            total += values[k] * t[columns[k]]
        t[i] = total
    return t, taken


@njit(cache=True)
def solve(factors, steps, b, relative):
    """x, its residual below ``relative`` times b's; None where fewer than ``STEPS`` steps are allowed and do not do."""
    x, n_taken = bicgstab(factors, b / factors.modified, relative, FLOOR, steps)
    return None if n_taken == steps < STEPS else x
