"""Rows of the KL program without a ridge: the multiplier by guessing which entries are at their bounds.

In a row: minimise sum_x q g - p log g over lower <= g <= upper, subject to sum_x q g = sum_x q. With m = 1 + the equality's
multiplier, g_x(m) = clip(p / q / m) and phi(m) = sum q g(m) is nonincreasing. Given the set of entries inside the box the
equality is linear in 1/m: m = (sum of p inside) / (sum q - what the bounds carry); comparisons and sums only. Sums are taken
in blocks of 256 entries, for accuracy, in an order that depends on the row alone. 3.5 to 18 times as fast as ``_dual``.
"""

import numpy as np
from numba import njit

BLOCK = 256


@njit(cache=True, error_model="numpy")
def guess_at(m, target, form, low, high):
    """phi(m), and the m that would solve the equality if the entries inside the box at m stayed there (nan: none)."""
    p, q, lower, upper = form.p, form.q, form.lower, form.upper
    inside, at_low, at_high = 0.0, 0.0, 0.0
    block = low
    while block < high:
        end = min(block + BLOCK, high)
        part, part_low, part_high = 0.0, 0.0, 0.0
        for x in range(block, end):
            scaled = q[x] * m
            under, over = p[x] <= lower * scaled, p[x] >= upper * scaled
            part_low += q[x] if under else 0.0
            part_high += q[x] if over else 0.0
            part += 0.0 if (under or over) else p[x]
        inside += part
        at_low += part_low
        at_high += part_high
        block = end
    carried = lower * at_low + (upper * at_high if at_high > 0.0 else 0.0)
    rest = target - carried
    return inside / m + carried, inside / rest if inside > 0.0 and rest > 0.0 else np.nan


@njit(cache=True, error_model="numpy")
def total_of(q, low, high):
    """sum q."""
    total = 0.0
    block = low
    while block < high:
        end = min(block + BLOCK, high)
        part = 0.0
        for x in range(block, end):
            part += q[x]
        total += part
        block = end
    return total


@njit(cache=True, error_model="numpy")
def clipped(p, q, inverse, lower, upper):
    """clip(p / q / m), 0 / 0 being 0; selections, so that it compiles to straight-line code."""
    g = p / q * inverse if p > 0.0 else 0.0
    g = lower if g < lower else g
    return upper if g > upper else g


@njit(cache=True, error_model="numpy")
def between(left, right, share, form, low, high, g):
    """Write g = share g(left) + (1 - share) g(right)."""
    high_end, low_end = 1.0 / left, 1.0 / right
    for x in range(low, high):
        above = clipped(form.p[x], form.q[x], high_end, form.lower, form.upper)
        below = clipped(form.p[x], form.q[x], low_end, form.lower, form.upper)
        g[x] = below + share * (above - below)


@njit(cache=True, error_model="numpy")
def solve_plain_rows(form, indptr, g, left, right, m):
    """Fill g, the bracket of m and m of every row that this method solves; the others get m nan.

    phi(left) >= sum q >= phi(right). m = 1 where it solves the row exactly, so that p = q gives g = 1.
    """
    for k in range(len(indptr) - 1):
        low, high = indptr[k], indptr[k + 1]
        target = total_of(form.q, low, high)
        start, stop, at_start, at_stop = 1.0, 1.0, 0.0, 0.0
        phi, middle = guess_at(1.0, target, form, low, high)
        settled = phi == target
        width = 1.2e-16 * (2.0 + 0.25 * np.sqrt(high - low))
        if not settled:
            for _ in range(60):
                if not 0.0 < middle < np.inf:
                    break
                start, stop = middle * (1.0 - width), middle * (1.0 + width)
                at_start, trial = guess_at(start, target, form, low, high)
                if at_start >= target:
                    at_stop, trial = guess_at(stop, target, form, low, high)
                    if at_stop <= target:
                        settled = True
                        break
                if abs(trial - middle) <= 4.0 * width * middle:
                    width *= 4.0
                middle = trial
        if not settled:
            m[k] = np.nan
            continue
        share = (target - at_stop) / (at_start - at_stop) if at_start > at_stop else 1.0
        between(start, stop, share, form, low, high, g)
        left[k], right[k] = start, stop
        m[k] = start if share >= 0.5 else stop


@njit(cache=True, error_model="numpy")
def plain_minimisers(m, form, indptr, g):
    """g(m) of each row with a number m, to the bit as ``between`` has it; the others keep what ``g`` has."""
    for k in range(len(m)):
        if not np.isnan(m[k]):
            for x in range(indptr[k], indptr[k + 1]):
                g[x] = clipped(form.p[x], form.q[x], 1.0 / m[k], form.lower, form.upper)
