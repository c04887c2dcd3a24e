"""Duality gaps of separable programs, computed from the programs as they are stated.

This file shares no code with the solvers (``dual``, ``joint``).

With the multipliers fixed, the Lagrangian of an entry is b g - p log g + a/2 g^2 up to
a constant, and its least value over the box has a closed form. The gap is the sum of
what the handed-over g is above those, a sum of terms that are none of them negative,
plus |multiplier| times what an equality is missed by, and the miss itself where it is
more than the rounding of its sum: a wrong g, a wrong multiplier and a point outside the
constraints all show.
"""

from __future__ import annotations

from math import inf, log1p, sqrt
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.typing import Array, IntArray

if TYPE_CHECKING:
    from oee_tabular.ratio.dual import Box, Coordinates
    from oee_tabular.ratio.statements import JointPoint, JointProgram


@njit(cache=True, error_model="numpy")
def excess(b, a, p, g, lower, upper):
    """Compute h(g) - min h over [lower, upper], h(g) = b g - p log g + a/2 g^2.

    It is inf where there is no minimum. A g outside counts as the nearest point inside,
    plus its distance from it.
    """
    total = 0.0
    if g < lower:
        total = lower - g
        g = lower
    elif g > upper:
        total = g - upper
        g = upper
    if not g < inf or (p > 0.0 and not g > 0.0):
        return inf
    y = inf
    if p > 0.0 and (a > 0.0 or b > 0.0):
        # The root of a y^2 + b y = p, without cancellation.
        root = sqrt(b * b + 4.0 * a * p)
        y = 2.0 * p / (b + root) if b > 0.0 else 0.5 * (root - b) / a
    elif p == 0.0 and a > 0.0:
        y = -b / a
    elif p == 0.0 and b == 0.0:
        return total
    elif p == 0.0 and b > 0.0:
        y = lower
    if y < lower:
        y = lower
    if y > upper:
        y = upper
    if y == inf:
        return inf
    step = g - y
    total += 0.5 * a * step * step
    if (y <= lower or y >= upper) and step != 0.0:
        slope = b + a * y
        if p > 0.0:
            slope -= p / y
        if not slope * step <= 0.0:
            total += slope * step
    if p > 0.0 and step != 0.0:
        u = step / y
        total += p * (0.5 * u * u if -1e-9 < u < 1e-9 else u - log1p(u))
    return total


@njit(cache=True, error_model="numpy")
def equality_gap(miss, multiplier, n):
    """Compute what an equality of ``n`` terms adds to the gap.

    It is |multiplier| |miss|, and |miss| itself where it exceeds the sum's rounding.
    """
    size = abs(miss)
    gap = abs(multiplier) * size
    if size > 2.3e-16 * (n + 16):
        gap += size
    return gap


def row_gaps(
    program: Coordinates, box: Box, indptr: IntArray, g: Array, m: Array, tied: bool
) -> Array:
    """Compute the (rows,) gaps of g with the multipliers m - 1 of sum q g = sum q.

    ``tied`` says whether there is this equality; without it m is 1. ``program``
    (``dual.Coordinates``): minimise sum q g - p log g + a/2 (g - c)^2, or (squares) sum
    q g^2 / 2 - p g + a/2 (g - c)^2, over the box.
    """
    gaps = np.empty(len(indptr) - 1)
    fill_gaps(*program, *box, indptr, g, m, tied, gaps)
    return gaps


@njit(cache=True, error_model="numpy")
def fill_gaps(p, q, a, c, squares, lower, upper, indptr, g, m, tied, gaps):
    """Fill the gap of each row, as in ``row_gaps``."""
    for k in range(len(gaps)):
        miss = 0.0
        gap = 0.0
        for x in range(indptr[k], indptr[k + 1]):
            miss += q[x] * (g[x] - 1.0)
            slope = m[k] * q[x]
            curvature = a[x]
            weight = p[x]
            if squares:
                slope = (m[k] - 1.0) * q[x] - p[x]
                curvature += q[x]
                weight = 0.0
            slope -= a[x] * c[x]
            gap += excess(slope, curvature, weight, g[x], lower, upper)
        if tied:
            gap += equality_gap(miss, m[k] - 1.0, indptr[k + 1] - indptr[k])
        gaps[k] = gap


@njit(cache=True, error_model="numpy")
def excesses(slope, p, g, lower, upper):
    """Compute sum_x [l_x(g_x) - min l_x] over [lower, upper_x].

    l_x(g) = slope_x g - p_x log g.
    """
    total = 0.0
    for x in range(len(p)):
        total += excess(slope[x], 0.0, p[x], g[x], lower, upper[x])
    return total


def joint_gaps(program: JointProgram, point: JointPoint) -> Array:
    """Compute the (rows,) gaps of a point in the program of ``ratio.joint``.

    ``point`` (``statements.JointPoint``) has B, b and the multipliers. Each row's gap
    is the sum of the excesses of B and b in the Lagrangian, of |multiplier| times the
    distance from each bound of the ratio, and of the equality's.
    """
    gaps = np.empty(len(program.s))
    fill_joint_gaps(program, *point, gaps)
    return gaps


@njit(cache=True, error_model="numpy")
def fill_joint_gaps(f, moves, pairs, theta, eta, xi, gaps):
    """Fill the gap of each row, as in ``joint_gaps``."""
    for k in range(len(gaps)):
        b = pairs[k]
        mass = 0.0
        miss = 0.0
        slope = f.r[k]
        gap = 0.0
        # Entry by entry the excess of B, and what the ratio's bounds add.
        for x in range(f.indptr[k], f.indptr[k + 1]):
            mass += f.q[x]
            miss += f.q[x] * (moves[x] - b)
            gap += excess(
                (1.0 + theta[k]) * f.q[x] - eta[x] + xi[x],
                f.lam,
                f.p[x],
                moves[x],
                f.nu,
                f.mu,
            )
            above = moves[x] - f.ratio_lower * b
            gap += eta[x] * abs(above)
            if above < 0.0:
                gap -= (f.p[x] + f.q[x]) * above
            slope += f.ratio_lower * eta[x]
            if f.ratio_upper < inf:
                below = f.ratio_upper * b - moves[x]
                gap += xi[x] * abs(below)
                if below < 0.0:
                    gap -= (f.p[x] + f.q[x]) * below
                slope -= f.ratio_upper * xi[x]
        gap += excess(slope - theta[k] * mass, f.lam, f.s[k], b, f.nu, f.mu)
        gap += equality_gap(miss, theta[k], f.indptr[k + 1] - f.indptr[k])
        gaps[k] = gap
