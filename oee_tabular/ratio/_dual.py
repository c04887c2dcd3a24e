"""The separable KL program with one equality per row, solved through its one-dimensional dual.

In a row: minimise sum_x [q g - p log g - pull g + a/2 g^2] over lower <= g <= upper, subject to sum_x q g = sum_x q; a and
pull differ between entries (``ratio.dual`` says how ridges and least squares come to this form). With the multiplier eta of
the equality and m = 1 + eta (m itself is iterated on: near m = 0 nothing cancels) each coordinate has the closed form of
``coordinate``, and phi(m) = sum_x q g_x(m) is nonincreasing: a bracketed root.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit


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
def at(m, form, x):
    """g_x(m)."""
    return coordinate(form.q[x] * m - form.pull[x], form.a[x], form.p[x], form.lower, form.upper)


@njit(cache=True, error_model="numpy", inline="always")  # rows are short: a call costs as much as its loop
def fill_row(m, form, low, high, g):
    """g_x(m) for the entries low..high; returns sum q g and minus its derivative in m."""
    total, slope = 0.0, 0.0
    for x in range(low, high):
        q, value = form.q[x], at(m, form, x)
        g[x] = value
        if q > 0.0:
            total += q * value
            if form.lower < value < form.upper:
                mass = q * value  # q^2 / (p / g^2 + a), written so that g^2 cannot underflow
                curvature = form.p[x] + form.a[x] * value * value
                if curvature > 0.0:
                    slope += mass * (mass / curvature)
    return total, slope


@njit(cache=True, error_model="numpy")
def is_one(form, low, high):
    """Whether g = 1 solves the row by inspection: p = q and no pull away from 1."""
    same = form.lower <= 1.0 <= form.upper
    for x in range(low, high):
        same = same and form.p[x] == form.q[x] and form.pull[x] == form.a[x]
    return same


@njit(cache=True, error_model="numpy")
def close_bracket(m, total, target, form, low, high, g):
    """(left, right, found) a few rounding units apart around the root near m; found is False where it is not near."""
    step = 2.3e-16 * abs(m) + 1e-300
    for _ in range(12):
        if total >= target:
            other, _ = fill_row(m + step, form, low, high, g)
            if other <= target:
                return m, m + step, True
        else:
            other, _ = fill_row(m - step, form, low, high, g)
            if other >= target:
                return m - step, m, True
        step *= 4.0
    return m, m, False


@njit(cache=True, error_model="numpy")
def finish_row(left, right, target, form, low, high, g):
    """g between the minimisers of the bracket's ends, meeting the equality; returns the end that is nearer."""
    at_left, at_right, open_mass = 0.0, 0.0, 0.0
    for x in range(low, high):
        q = form.q[x]
        if q > 0.0:
            above = at(left, form, x)
            at_right += q * at(right, form, x)
            if above == np.inf:
                open_mass += q
            else:
                at_left += q * above
    share = 1.0
    if open_mass == 0.0 and at_left > at_right:
        share = min(max((target - at_right) / (at_left - at_right), 0.0), 1.0)
    m = left if share >= 0.5 and open_mass == 0.0 else right
    for x in range(low, high):
        above, below = at(left, form, x), at(right, form, x)
        if open_mass > 0.0:  # a jump without an upper bound: the deficit goes to the unobserved entries, evenly
            g[x] = below + (target - at_right) / open_mass if above == np.inf else below
        else:
            g[x] = below + share * (above - below) if above > below else above
    return m


@njit(cache=True, error_model="numpy")
def known_row(form, low, high, mass, curved):
    """m where g = 1 solves the row (wherever q > 0), nan elsewhere."""
    m = np.nan
    if is_one(form, low, high):
        m = 1.0
    elif form.lower == 1.0 or form.upper == 1.0:  # the box leaves g = 1 alone; m at which it is every minimiser
        side = 1.0 if form.lower == 1.0 else -1.0
        m = -np.inf
        for x in range(low, high):
            if form.q[x] > 0.0:
                m = max(m, side * (form.p[x] + form.pull[x] - form.a[x]) / form.q[x])
        m = side * m
    elif mass == 0.0 and not curved:  # nothing observed where q is: every feasible point is optimal
        m = 0.0
    return m


@njit(cache=True, error_model="numpy")
def bracket(total, target, mass, curved, form, low, high, g):
    """(left, right, m, sum q g at m, minus its derivative): the root lies in [left, right], and m is one of its ends.

    ``total`` is sum q g at m = 1.
    """
    left, right, width, slope = 1.0, 1.0, 1.0, 0.0
    if total > target:
        while total > target and width < 1e300:
            left = right
            right = right + width
            width *= 2.0
            total, slope = fill_row(right, form, low, high, g)
    elif curved or (mass > 0.0 and form.upper < np.inf):
        # g grows without bound as m falls (a > 0), or reaches the upper bound everywhere once m < 0
        while total < target and width < 1e300:
            right = left
            left = left - width
            width *= 2.0
            total, slope = fill_row(left, form, low, high, g)
    else:  # no box, no ridge: sum q g >= mass / m
        left = mass
        while True:
            total, slope = fill_row(left, form, low, high, g)
            if total >= target:
                break
            left *= 1.0 - 1e-15
    return left, right, left if total >= target else right, total, slope


@njit(cache=True, error_model="numpy")
def solve_row(form, low, high, g):
    """Solve one row into ``g``; returns m and its bracket.

    Needs lower <= 1 <= upper. The bracket [left, right] has phi(left) >= sum q >= phi(right); it shrinks by Newton steps
    from whichever end, or by halving where Newton leaves it, until its ends are neighbours. g is the convex combination
    of the two ends' minimisers that meets the equality, right at jumps too (p = 0 = a). left = right where g is known outright.
    """
    target, mass, curved = 0.0, 0.0, False
    for x in range(low, high):
        target += form.q[x]
        if form.q[x] > 0.0:
            mass += form.p[x]
            curved = curved or form.a[x] > 0.0
    m = known_row(form, low, high, mass, curved)
    if not np.isnan(m):
        for x in range(low, high):
            g[x] = 1.0 if form.q[x] > 0.0 else at(0.0, form, x)
        return m, m, m
    total, _ = fill_row(1.0, form, low, high, g)
    if total == target:
        return 1.0, 1.0, 1.0
    left, right, m, total, slope = bracket(total, target, mass, curved, form, low, high, g)
    for _ in range(2000):
        trial = m + (total - target) / slope if slope > 0.0 else 0.5 * (left + right)
        if not left < trial < right:
            trial = 0.5 * (left + right)
        if not left < trial < right:
            break
        m = trial
        total, slope = fill_row(m, form, low, high, g)
        if total >= target:
            left = m
        if total <= target:
            right = m
        if left == right:
            break
        if slope > 0.0 and abs(total - target) <= 1e-10 * slope * abs(m):  # Newton's next step ends at rounding
            m += (total - target) / slope
            total, slope = fill_row(m, form, low, high, g)
            near_left, near_right, near = close_bracket(m, total, target, form, low, high, g)
            if near:
                left, right = near_left, near_right
                break
    return finish_row(left, right, target, form, low, high, g), left, right


@njit(cache=True, error_model="numpy")
def solve_rows(form, indptr, todo, g, left, right, m):
    """Every row of ``todo`` by itself: the ratios, the bracket of m and m of each."""
    for k in todo:
        m[k], left[k], right[k] = solve_row(form, indptr[k], indptr[k + 1], g)


@njit(cache=True, error_model="numpy")
def minimisers(m, form, indptr, g):
    """g(m) of each row with a number m; the others keep what ``g`` has."""
    for k in range(len(m)):
        if not np.isnan(m[k]):
            fill_row(m[k], form, indptr[k], indptr[k + 1], g)


@njit(cache=True, error_model="numpy")
def solve_free(form):
    """Without the equality: m = 1."""
    g = np.empty(len(form.p))
    for x in range(len(g)):
        g[x] = at(1.0, form, x)
    return g
