"""Duality gaps of separable programs, computed from the programs as they are stated.

This file shares no code with the solvers (``dual``, ``joint``).

With the multipliers fixed, the Lagrangian of an entry is b g - p log g + a/2 g^2 up to
a constant, and its least value over the box has a closed form. The gap is the sum of
what the handed-over g is above those, a sum of terms that are none of them negative,
plus |multiplier| times what an equality is missed by, and the miss itself where it is
more than the rounding of its sum: a wrong g, a wrong multiplier and a point outside the
constraints all show.
"""

from math import log1p

import numpy as np

from oee_tabular._compiling import njit


@njit(cache=True, error_model="numpy")
def excess(b, a, p, g, lower, upper):
    """Compute h(g) - min h over [lower, upper], h(g) = b g - p log g + a/2 g^2.

    It is inf where there is no minimum. A g outside counts as the nearest point inside,
    plus its distance from it.
    """
    total = max(lower - g, g - upper, 0.0)
    g = min(max(g, lower), upper)
    if not g < np.inf or (p > 0.0 and not g > 0.0):
        return np.inf
    if p > 0.0 and (a > 0.0 or b > 0.0):
        # The root of a y^2 + b y = p, without cancellation.
        size = abs(b) + np.sqrt(b * b + 4.0 * a * p)
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
        total += p * (0.5 * u * u if abs(u) < 1e-9 else u - log1p(u))
    return total


@njit(cache=True, error_model="numpy")
def equality_gap(miss, multiplier, n):
    """Compute what an equality of ``n`` terms adds to the gap.

    It is |multiplier| |miss|, and |miss| itself where it exceeds the sum's rounding.
    """
    size = abs(miss)
    return abs(multiplier) * size + (size if size > 2.3e-16 * (n + 16) else 0.0)


@njit(cache=True, error_model="numpy")
def row_gaps(program, box, indptr, g, m, tied):
    """Compute the (rows,) gaps of g with the multipliers m - 1 of sum q g = sum q.

    ``tied`` says whether there is this equality; without it m is 1. ``program``
    (``dual.Coordinates``): minimise sum q g - p log g + a/2 (g - c)^2, or (squares) sum
    q g^2 / 2 - p g + a/2 (g - c)^2, over the box.
    """
    p, q, a, c, squares = program
    gaps = np.zeros(len(indptr) - 1)
    for k in range(len(gaps)):
        miss = 0.0
        for x in range(indptr[k], indptr[k + 1]):
            miss += q[x] * (g[x] - 1.0)
            if squares:
                slope = (m[k] - 1.0) * q[x] - p[x] - a[x] * c[x]
                gaps[k] += excess(slope, q[x] + a[x], 0.0, g[x], box.lower, box.upper)
            else:
                gaps[k] += excess(
                    m[k] * q[x] - a[x] * c[x], a[x], p[x], g[x], box.lower, box.upper
                )
        if tied:
            gaps[k] += equality_gap(miss, m[k] - 1.0, indptr[k + 1] - indptr[k])
    return gaps


@njit(cache=True, error_model="numpy")
def excesses(slope, p, g, lower, upper):
    """Compute sum_x [l_x(g_x) - min l_x] over [lower, upper_x].

    l_x(g) = slope_x g - p_x log g.
    """
    total = 0.0
    for x in range(len(p)):
        total += excess(slope[x], 0.0, p[x], g[x], lower, upper[x])
    return total


@njit(cache=True, error_model="numpy")
def joint_gaps(f, point):
    """Compute the (rows,) gaps of a point in the program ``f`` of ``ratio.joint``.

    ``point`` (``statements.JointPoint``) has B, b and the multipliers. Each row's gap
    is the sum of the excesses of B and b in the Lagrangian, of |multiplier| times the
    distance from each bound of the ratio, and of the equality's.
    """
    moves, pairs, theta, eta, xi = point
    gaps = np.zeros(len(f.s))
    for k in range(len(gaps)):
        b = pairs[k]
        mass = 0.0
        miss = 0.0
        slope = f.r[k]
        # Entry by entry the excess of B, and what the ratio's bounds add.
        for x in range(f.indptr[k], f.indptr[k + 1]):
            mass += f.q[x]
            miss += f.q[x] * (moves[x] - b)
            gaps[k] += excess(
                (1.0 + theta[k]) * f.q[x] - eta[x] + xi[x],
                f.lam,
                f.p[x],
                moves[x],
                f.nu,
                f.mu,
            )
            above = moves[x] - f.ratio_lower * b
            gaps[k] += eta[x] * abs(above) + (f.p[x] + f.q[x]) * max(-above, 0.0)
            slope += f.ratio_lower * eta[x]
            if f.ratio_upper < np.inf:
                below = f.ratio_upper * b - moves[x]
                gaps[k] += xi[x] * abs(below) + (f.p[x] + f.q[x]) * max(-below, 0.0)
                slope -= f.ratio_upper * xi[x]
        gaps[k] += excess(slope - theta[k] * mass, f.lam, f.s[k], b, f.nu, f.mu)
        gaps[k] += equality_gap(miss, theta[k], f.indptr[k + 1] - f.indptr[k])
    return gaps
