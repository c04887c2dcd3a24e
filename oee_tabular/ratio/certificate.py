"""Duality gaps of separable programs, from the program as it is stated; shares no code with what solves it.

With the multipliers fixed, the Lagrangian of an entry is b g - p log g + a/2 g^2 up to a constant, and its least value over
the box has a closed form. The gap is the sum of what the handed-over g is above those, a sum of terms that are none of them
negative, plus |multiplier| times what an equality is missed by, and the miss itself where it is more than the rounding of
its sum: a wrong g, a wrong multiplier and a point outside the constraints all show.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


def excess(b: Any, a: Any, p: Any, g: Any, lower: Any, upper: Any) -> Any:
    """h(g) - min of h over [lower, upper], h(g) = b g - p log g + a/2 g^2; inf where there is no minimum.

    A g outside counts as the nearest inside, and as far as it is off.
    """
    total = max(lower - g, g - upper, 0.0)
    g = min(max(g, lower), upper)
    if not g < np.inf or (p > 0.0 and not g > 0.0):
        return np.inf
    if p > 0.0 and (a > 0.0 or b > 0.0):
        size = abs(b) + np.sqrt(b * b + 4.0 * a * p)  # the root of a y^2 + b y = p, without cancellation
        y = 2.0 * p / size if b > 0.0 else 0.5 * size / a
    elif p == 0.0 and a > 0.0:
        y = -b / a
    elif p == 0.0 and b == 0.0:
        return total
    else:
        y = np.inf if p > 0.0 or b < 0.0 else lower
    y = min(max(y, lower), upper)
    if y == np.inf:
        return np.inf
    step = g - y
    total += 0.5 * a * step * step
    if (y <= lower or y >= upper) and step != 0.0:
        total += max((b + a * y - (p / y if p > 0.0 else 0.0)) * step, 0.0)
    if p > 0.0 and step != 0.0:
        u = step / y
        total += p * (0.5 * u * u if abs(u) < 1e-9 else u - np.log1p(u))
    return total


excess = njit(cache=True, error_model="numpy")(excess)


def missed(miss: Any, multiplier: Any, n: Any) -> Any:
    """What an equality of ``n`` terms adds to the gap."""
    size = abs(miss)
    return abs(multiplier) * size + (size if size > 2.3e-16 * (n + 16) else 0.0)


missed = njit(cache=True, error_model="numpy")(missed)


def row_gaps(
    squares: Any, m: Any, p: Any, q: Any, a: Any, c: Any, lower: Any, upper: Any, indptr: Any, tied: Any, g: Any
) -> Any:
    """(rows,) gaps of g with the multipliers m - 1 of sum q g = sum q (``tied``; without it m is 1).

    minimise sum q g - p log g + a/2 (g - c)^2, or (``squares``) sum q g^2 / 2 - p g + a/2 (g - c)^2, over the box.
    """
    gaps = np.zeros(len(indptr) - 1)
    for k in range(len(gaps)):
        miss = 0.0
        for x in range(indptr[k], indptr[k + 1]):
            miss += q[x] * (g[x] - 1.0)
            if squares:
                gaps[k] += excess((m[k] - 1.0) * q[x] - p[x] - a[x] * c[x], q[x] + a[x], 0.0, g[x], lower, upper)
            else:
                gaps[k] += excess(m[k] * q[x] - a[x] * c[x], a[x], p[x], g[x], lower, upper)
        if tied:
            gaps[k] += missed(miss, m[k] - 1.0, indptr[k + 1] - indptr[k])
    return gaps


row_gaps = njit(cache=True, error_model="numpy")(row_gaps)


def joint_gaps(
    p: Any, q: Any, a: Any, s: Any, r: Any, v: Any, box: Any, indptr: Any, moves: Any, pairs: Any, theta: Any,
    push: Any, press: Any,
) -> Any:  # fmt: skip
    """(rows,) gaps of B (``moves``) and b (``pairs``) in the program of ``ratio.joint``; ``box`` is (lower, upper, nu, mu).

    ``theta`` is the multiplier of sum q B = (sum q) b, ``push`` and ``press`` >= 0 those of nu b <= B <= mu b.
    """
    lower, upper, nu, mu = box
    gaps = np.zeros(len(indptr) - 1)
    for k in range(len(gaps)):
        b, big, miss, steep = pairs[k], 0.0, 0.0, r[k]
        for x in range(indptr[k], indptr[k + 1]):
            big += q[x]
            miss += q[x] * (moves[x] - b)
            slope = (1.0 + theta[k]) * q[x] - push[x] + press[x]
            gaps[k] += excess(slope, a[x], p[x], moves[x], lower, upper)
            gaps[k] += push[x] * abs(moves[x] - nu * b) + (p[x] + q[x]) * max(nu * b - moves[x], 0.0)
            steep += nu * push[x]
            if mu < np.inf:
                gaps[k] += press[x] * abs(mu * b - moves[x]) + (p[x] + q[x]) * max(moves[x] - mu * b, 0.0)
                steep -= mu * press[x]
        gaps[k] += excess(steep - theta[k] * big, v[k], s[k], b, lower, upper)
        gaps[k] += missed(miss, theta[k], indptr[k + 1] - indptr[k])
    return gaps


joint_gaps = njit(cache=True, error_model="numpy")(joint_gaps)
