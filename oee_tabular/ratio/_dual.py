"""The separable KL program with one equality per row, solved through its one-dimensional dual.

In a row: minimise sum_x [q g - p log g - pull g + a/2 g^2] over lower <= g <= upper, subject to sum_x q g = sum_x q; a and
pull differ between entries (``ratio.dual`` says how ridges and least squares come to this form). With the multiplier eta of
the equality and m = 1 + eta (m itself is iterated on: near m = 0 nothing cancels) each coordinate has the closed form of
``coordinate``, and phi(m) = sum_x q g_x(m) is nonincreasing: a bracketed root.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


def coordinate(b: Any, a: Any, p: Any, lower: Any, upper: Any) -> Any:
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


coordinate = njit(cache=True, error_model="numpy")(coordinate)


def fill_row(m: Any, p: Any, q: Any, a: Any, pull: Any, lower: Any, upper: Any, low: Any, high: Any, g: Any) -> Any:
    """g_x(m) for the entries low..high; returns sum q g and minus its derivative in m."""
    total, slope = 0.0, 0.0
    for x in range(low, high):
        value = coordinate(q[x] * m - pull[x], a[x], p[x], lower, upper)
        g[x] = value
        if q[x] > 0.0:
            total += q[x] * value
            if lower < value < upper:
                mass = q[x] * value  # q^2 / (p / g^2 + a), written so that g^2 cannot underflow
                bend = p[x] + a[x] * value * value
                if bend > 0.0:
                    slope += mass * (mass / bend)
    return total, slope


fill_row = njit(cache=True, error_model="numpy")(fill_row)


def _is_one(p: Any, q: Any, a: Any, pull: Any, lower: Any, upper: Any, low: Any, high: Any) -> Any:
    """Whether g = 1 solves the row by inspection: p = q and no pull away from 1."""
    if lower > 1.0 or upper < 1.0:
        return False
    for x in range(low, high):
        if p[x] != q[x] or pull[x] != a[x]:
            return False
    return True


_is_one = njit(cache=True, error_model="numpy")(_is_one)


def close_bracket(
    m: Any,
    total: Any,
    target: Any,
    p: Any,
    q: Any,
    a: Any,
    pull: Any,
    lower: Any,
    upper: Any,
    low: Any,
    high: Any,
    out: Any,
) -> Any:
    """(left, right, found) a few rounding units apart around the root near m; found is False where it is not near."""
    step = 2.3e-16 * abs(m) + 1e-300
    for _ in range(12):
        if total >= target:
            other, _ = fill_row(m + step, p, q, a, pull, lower, upper, low, high, out)
            if other <= target:
                return m, m + step, True
        else:
            other, _ = fill_row(m - step, p, q, a, pull, lower, upper, low, high, out)
            if other >= target:
                return m - step, m, True
        step *= 4.0
    return m, m, False


close_bracket = njit(cache=True, error_model="numpy")(close_bracket)


def finish_row(
    left: Any,
    right: Any,
    target: Any,
    p: Any,
    q: Any,
    a: Any,
    pull: Any,
    lower: Any,
    upper: Any,
    low: Any,
    high: Any,
    g: Any,
) -> Any:
    """g between the minimisers of the bracket's ends, meeting the equality; returns the end that is nearer."""
    most, least, open_mass = 0.0, 0.0, 0.0
    for x in range(low, high):
        if q[x] > 0.0:
            shift = pull[x]
            above = coordinate(q[x] * left - shift, a[x], p[x], lower, upper)
            least += q[x] * coordinate(q[x] * right - shift, a[x], p[x], lower, upper)
            if above == np.inf:
                open_mass += q[x]
            else:
                most += q[x] * above
    share = 1.0
    if open_mass == 0.0 and most > least:
        share = min(max((target - least) / (most - least), 0.0), 1.0)
    m = left if share >= 0.5 and open_mass == 0.0 else right
    for x in range(low, high):
        shift = pull[x]
        above = coordinate(q[x] * left - shift, a[x], p[x], lower, upper)
        below = coordinate(q[x] * right - shift, a[x], p[x], lower, upper)
        if open_mass > 0.0:  # a jump without an upper bound: the deficit goes to the unobserved entries, evenly
            g[x] = below + (target - least) / open_mass if above == np.inf else below
        else:
            g[x] = below + share * (above - below) if above > below else above
    return m


finish_row = njit(cache=True, error_model="numpy")(finish_row)


def solve_row(p: Any, q: Any, a: Any, pull: Any, lower: Any, upper: Any, low: Any, high: Any, g: Any) -> Any:
    """Solve one row into ``g``; returns m and its bracket.

    Needs lower <= 1 <= upper. The bracket [left, right] has phi(left) >= sum q >= phi(right); it shrinks by Newton steps
    from whichever end, or by halving where Newton leaves it, until its ends are neighbours. g is the convex combination
    of the two ends' minimisers that meets the equality, right at jumps too (p = 0 = a). left = right where g is known outright.
    """
    target, mass, bend = 0.0, 0.0, 0.0
    for x in range(low, high):
        target += q[x]
        if q[x] > 0.0:
            mass += p[x]
            bend = max(bend, a[x])
    known = True
    m = 1.0
    if _is_one(p, q, a, pull, lower, upper, low, high):
        pass
    elif lower == 1.0 or upper == 1.0:  # the box leaves g = 1 alone; m at which it is every coordinate's minimiser
        side = 1.0 if lower == 1.0 else -1.0
        m = -np.inf
        for x in range(low, high):
            if q[x] > 0.0:
                m = max(m, side * (p[x] + pull[x] - a[x]) / q[x])
        m = side * m
    elif mass == 0.0 and bend == 0.0:  # nothing observed where q is: every feasible point is optimal
        m = 0.0
    else:
        known = False
    if known:
        for x in range(low, high):
            g[x] = 1.0 if q[x] > 0.0 else coordinate(-pull[x], a[x], p[x], lower, upper)
        return m, m, m
    left, right, width = 1.0, 1.0, 1.0
    total, slope = fill_row(1.0, p, q, a, pull, lower, upper, low, high, g)
    if total == target:
        return 1.0, 1.0, 1.0
    if total > target:
        while total > target and width < 1e300:
            left = right
            right = right + width
            width *= 2.0
            total, slope = fill_row(right, p, q, a, pull, lower, upper, low, high, g)
    elif bend > 0.0 or (mass > 0.0 and upper < np.inf):
        # g grows without bound as m falls (bend > 0), or reaches the upper bound everywhere once m < 0
        while total < target and width < 1e300:
            right = left
            left = left - width
            width *= 2.0
            total, slope = fill_row(left, p, q, a, pull, lower, upper, low, high, g)
    else:  # no box, no ridge: sum q g >= mass / m
        left = mass
        while True:
            total, slope = fill_row(left, p, q, a, pull, lower, upper, low, high, g)
            if total >= target:
                break
            left *= 1.0 - 1e-15
    m = left if total >= target else right
    for _ in range(2000):
        trial = m + (total - target) / slope if slope > 0.0 else 0.5 * (left + right)
        if not left < trial < right:
            trial = 0.5 * (left + right)
        if not left < trial < right:
            break
        m = trial
        total, slope = fill_row(m, p, q, a, pull, lower, upper, low, high, g)
        if total >= target:
            left = m
        if total <= target:
            right = m
        if left == right:
            break
        if slope > 0.0 and abs(total - target) <= 1e-10 * slope * abs(m):  # Newton's next step ends at rounding
            m += (total - target) / slope
            total, slope = fill_row(m, p, q, a, pull, lower, upper, low, high, g)
            near_left, near_right, near = close_bracket(m, total, target, p, q, a, pull, lower, upper, low, high, g)
            if near:
                left, right = near_left, near_right
                break
    m = finish_row(left, right, target, p, q, a, pull, lower, upper, low, high, g)
    return m, left, right


solve_row = njit(cache=True, error_model="numpy")(solve_row)


def solve_rows(
    p: Any, q: Any, a: Any, pull: Any, lower: Any, upper: Any, indptr: Any, todo: Any, g: Any, left: Any, right: Any,
    m: Any,
) -> Any:  # fmt: skip
    """Every row of ``todo`` by itself: the ratios, the bracket of m and m of each."""
    for k in todo:
        m[k], left[k], right[k] = solve_row(p, q, a, pull, lower, upper, indptr[k], indptr[k + 1], g)


solve_rows = njit(cache=True, error_model="numpy")(solve_rows)


def minimisers(m: Any, p: Any, q: Any, a: Any, pull: Any, lower: Any, upper: Any, indptr: Any, out: Any) -> Any:
    """g(m) of each row with a number m; the others keep what ``out`` has."""
    for k in range(len(m)):
        if not np.isnan(m[k]):
            fill_row(m[k], p, q, a, pull, lower, upper, indptr[k], indptr[k + 1], out)


minimisers = njit(cache=True, error_model="numpy")(minimisers)


def solve_free(p: Any, q: Any, a: Any, pull: Any, lower: Any, upper: Any) -> Any:
    """Without the equality: m = 1."""
    g = np.empty(len(p))
    for x in range(len(p)):
        g[x] = coordinate(q[x] - pull[x], a[x], p[x], lower, upper)
    return g


solve_free = njit(cache=True, error_model="numpy")(solve_free)
