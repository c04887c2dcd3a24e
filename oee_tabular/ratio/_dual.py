"""The separable KL program with one equality per row, solved through its one-dimensional dual.

In a row: minimise sum_x [q g - p log g - pull g + a/2 g^2] over lower <= g <= upper, subject to sum_x q g = sum_x q; a and
pull differ between entries (``ratio.dual`` says how ridges and least squares come to this form). With the multiplier eta of
the equality and m = 1 + eta (m itself is iterated on: near m = 0 nothing cancels) each coordinate has the closed form of
``coordinate``, and the miss sum_x q (g_x(m) - 1) is nonincreasing in m: a bracketed root, by Newton's method. Where a = 0 it
is Newton's in 1/m, in which the miss is linear as long as the same entries are inside the box.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

TINY = 1e-200  # multipliers nearer to 0 are 0
ROUNDING = 2.3e-16
N_STEPS = 4000  # halvings from the largest to the smallest number take 2000


class Form(NamedTuple):
    """The program's arrays (entries,) and its box."""

    p: Any
    q: Any
    a: Any
    pull: Any
    lower: float
    upper: float


@njit(cache=True, error_model="numpy")
def coordinate(b, a, p, lower, upper):
    """argmin of b g - p log g + a/2 g^2 over [lower, upper]; ``lower`` where every point is one."""
    if p > 0.0:
        if a > 0.0:
            root = np.sqrt(b * b + 4.0 * a * p)
            g = 2.0 * p / (b + root) if b >= 0.0 else (root - b) / (2.0 * a)
        elif b > 0.0:
            g = p / b
        else:
            g = np.inf
    elif b >= 0.0:
        g = 0.0
    elif a > 0.0:
        g = -b / a
    else:
        g = np.inf
    return min(max(g, lower), upper)


@njit(cache=True, error_model="numpy")
def minimiser(m, form, x):
    """g_x(m)."""
    return coordinate(form.q[x] * m - form.pull[x], form.a[x], form.p[x], form.lower, form.upper)


@njit(cache=True, error_model="numpy", inline="always")  # rows are short: a call costs as much as its loop
def fill_row(m, form, low, high, g):
    """g_x(m) for the entries low..high; returns sum q (g - 1) and minus its derivative in m."""
    miss, slope = 0.0, 0.0
    for x in range(low, high):
        q, value = form.q[x], minimiser(m, form, x)
        g[x] = value
        if q > 0.0:
            miss += q * (value - 1.0)
            if form.lower < value < form.upper:
                mass = q * value  # q^2 / (p / g^2 + a), written so that g^2 cannot underflow
                curvature = form.p[x] + form.a[x] * value * value
                if curvature > 0.0:
                    slope += mass * (mass / curvature)
    return miss, slope


@njit(cache=True, error_model="numpy")
def solve_row(form, low, high, g, below, above):
    """Solve one row into ``g``, with the minimisers at the ends of m's bracket, below <= g <= above; returns m.

    Needs lower <= 1 <= upper. The bracket has miss(left) >= 0 >= miss(right); from m = 1 it shrinks by Newton's steps, each a
    little too long near the root so that both ends come within rounding of it, by doubled steps where it has no end, and by
    halving. g is the convex combination of the two ends' minimisers that meets the equality, right at jumps too (p = 0 = a).
    """
    mass, curved = 0.0, False
    for x in range(low, high):
        if form.q[x] > 0.0:
            mass += form.p[x]
            curved = curved or form.a[x] > 0.0
    if mass == 0.0 and not curved and low < high and not form.pull[low:high].any():  # every feasible g is a minimiser
        for x in range(low, high):
            g[x] = 1.0 if form.q[x] > 0.0 else minimiser(0.0, form, x)
        below[low:high], above[low:high] = g[low:high], g[low:high]
        return 0.0
    left, right = -np.inf, np.inf
    if not curved:  # without a bound sum q g >= mass / m; with one all entries are at it once m < 0
        left = mass if form.upper == np.inf else -TINY
    m, width, reach = 1.0, 1.0, ROUNDING
    for step in range(1, N_STEPS):
        miss, slope = fill_row(m, form, low, high, g)
        if miss == 0.0:
            below[low:high], above[low:high] = g[low:high], g[low:high]
            return m
        if np.isnan(miss) or (curved and not np.isfinite(miss + slope)):  # numbers that double precision does not hold
            g[low:high] = np.nan
            return np.nan
        if miss > 0.0:
            left = m
        else:
            right = m
        if right - left <= max(4.0 * reach * abs(m), TINY):
            break
        share = miss / (slope * m) if slope > 0.0 else np.nan
        trial = m / (1.0 - share) if not curved and share < 0.5 else m * (1.0 + share)
        if abs(share) <= 1e-10:
            trial += np.copysign(reach * m, miss)
            reach *= 2.0
        if not left < trial < right or step % 16 == 0:
            if right == np.inf or left == -np.inf:  # g has no bound as m falls, or reaches its bounds as it rises
                trial = left + width if right == np.inf else right - width
                width *= 2.0
            else:
                trial = 0.0 if left < 0.0 < right else 0.5 * (left + right)
            if not left < trial < right:
                break
        m = trial
    at_left, at_right = fill_row(left, form, low, high, above)[0], fill_row(right, form, low, high, below)[0]
    share = min(max(-at_right / (at_left - at_right), 0.0), 1.0) if at_left > at_right else 1.0
    for x in range(low, high):
        g[x] = below[x] + share * (above[x] - below[x]) if above[x] > below[x] else above[x]
    return left if share >= 0.5 else right


@njit(cache=True, error_model="numpy")
def solve_rows(form, indptr, g, below, above, m):
    """Every row by itself: the ratios, what encloses them, and m of each row."""
    for k in range(len(m)):
        m[k] = solve_row(form, indptr[k], indptr[k + 1], g, below, above)


@njit(cache=True, error_model="numpy")
def solve_free(form):
    """Without the equality: m = 1."""
    g = np.empty(len(form.p))
    for x in range(len(g)):
        g[x] = minimiser(1.0, form, x)
    return g
