"""The joint program of one (s, a): beta_sas' = B_x and beta_sa = b together, under sum_x d_x B_x = D b.

    minimise  sum_x [q g - p log g + A/2 g^2](B_x)  +  [r b - s log b + V/2 b^2]   over the box,  sum_x d_x B_x = D b.

With the multiplier theta of the equality both have the coordinate's closed form, B_x(theta) falling and b(theta) rising,
so that phi(theta) = sum d B(theta) - D b(theta) is nonincreasing: one bracketed root an (s, a).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from oee_tabular.ratio._dual import coordinate


def fill(theta: Any, rows: Any, pair: Any, low: Any, high: Any, lower: Any, upper: Any, out: Any) -> Any:
    """B_x(theta) into ``out``; returns b(theta) and phi(theta). ``rows`` is (p, q, A, d), ``pair`` is (s, r, V, D)."""
    p, q, a, d = rows
    s, r, v, big = pair
    b = coordinate(r - theta * big, v, s, lower, upper)
    phi = -big * b
    for x in range(low, high):
        out[x] = coordinate(q[x] + theta * d[x], a[x], p[x], lower, upper)
        phi += d[x] * out[x]
    return b, phi


fill = njit(cache=True, error_model="numpy")(fill)


def gap_term(b: Any, a: Any, p: Any, y: Any, g: Any, lower: Any, upper: Any) -> Any:
    """h(g) - h(y) for the coordinate's minimiser y, without cancellation; h' counts only at the bounds."""
    step = g - y
    if step == 0.0:
        return 0.0
    total = 0.5 * a * step * step
    if y <= lower or y >= upper:
        total += (b + a * y - (p / y if p > 0.0 else 0.0)) * step
    if p > 0.0:
        u = step / y
        total += p * (u - np.log1p(u))
    return total


gap_term = njit(cache=True, error_model="numpy")(gap_term)


def solve(
    rows: Any, pair: Any, low: Any, high: Any, lower: Any, upper: Any, out: Any, left_out: Any, right_out: Any
) -> Any:
    """One (s, a): fills B into ``out``; returns b, theta and the gap."""
    p, q, a, d = rows
    s, r, v, big = pair
    theta = 0.0
    b, phi = fill(theta, rows, pair, low, high, lower, upper, out)
    if (
        b < np.inf and abs(phi) <= 2.3e-16 * (high - low + 2) * big * b
    ):  # equal up to the rounding of the sums themselves
        return b, theta, 0.0
    left, right, width = 0.0, 0.0, 0.5
    while phi > 0.0 and width < 1e300:  # phi(left) >= 0 >= phi(right)
        left = right
        right += width
        width *= 2.0
        b, phi = fill(right, rows, pair, low, high, lower, upper, out)
    if right == 0.0:
        while phi < 0.0 and width < 1e300:
            right = left
            left -= width
            width *= 2.0
            b, phi = fill(left, rows, pair, low, high, lower, upper, out)
    for _ in range(2000):
        theta = 0.5 * (left + right)
        if not left < theta < right:
            break
        b, phi = fill(theta, rows, pair, low, high, lower, upper, out)
        if phi >= 0.0:
            left = theta
        if phi <= 0.0:
            right = theta
    b_left, phi_left = fill(left, rows, pair, low, high, lower, upper, left_out)
    b_right, phi_right = fill(right, rows, pair, low, high, lower, upper, right_out)
    share = phi_left / (phi_left - phi_right) if phi_left > phi_right else 0.0  # of the right end
    if not 0.0 <= share <= 1.0:
        share = 0.0 if phi_left < np.inf else 1.0
    b = b_left if b_left == b_right or share == 0.0 else b_left + share * (b_right - b_left)
    for x in range(low, high):
        same = left_out[x] == right_out[x] or share == 0.0
        out[x] = left_out[x] if same else left_out[x] + share * (right_out[x] - left_out[x])
    best = np.inf
    for theta_end in (left, right):
        total = gap_term(
            r - theta_end * big, v, s, coordinate(r - theta_end * big, v, s, lower, upper), b, lower, upper
        )
        residual = -big * b
        for x in range(low, high):
            slope = q[x] + theta_end * d[x]
            total += gap_term(slope, a[x], p[x], coordinate(slope, a[x], p[x], lower, upper), out[x], lower, upper)
            residual += d[x] * out[x]
        total -= theta_end * residual
        if total < best:
            best, theta = total, theta_end
    return b, theta, best


solve = njit(cache=True, error_model="numpy")(solve)


def solve_all(
    p: Any, q: Any, a: Any, d: Any, s: Any, r: Any, v: Any, big: Any, lower: Any, upper: Any, indptr: Any
) -> Any:
    """Every (s, a) by itself: B, b, theta and gaps."""
    n_rows = len(indptr) - 1
    out, left_out, right_out = np.empty(len(p)), np.empty(len(p)), np.empty(len(p))
    b, theta, gap = np.empty(n_rows), np.empty(n_rows), np.empty(n_rows)
    rows = (p, q, a, d)
    for k in range(n_rows):
        pair = (s[k], r[k], v[k], big[k])
        b[k], theta[k], gap[k] = solve(rows, pair, indptr[k], indptr[k + 1], lower, upper, out, left_out, right_out)
    return out, b, theta, gap


solve_all = njit(cache=True, error_model="numpy")(solve_all)
