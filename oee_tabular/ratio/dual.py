"""The structured solver of separable programs, each row by a one-dimensional root.

The program is (eq. 3.7)

    minimise  sum_x q g - p log g + A/2 (g - c)^2
    subject to  lower <= g <= upper,  sum_x q g = sum_x q,

in each row. The loops solve the same as q g - p log g - pull g + a/2 g^2, with the
curvature a = A and pull = A c. With the multiplier eta of the equality, which
``statements`` returns, and m = 1 + eta (m itself is iterated on: near m = 0 nothing cancels)
each coordinate has the closed form of ``coordinate``, and the miss sum_x q (g_x(m) - 1)
is nonincreasing in m: a bracketed root, by Newton's method. Where a = 0 it is Newton's
in 1/m, in which the miss is linear as long as the same entries are inside the box. Gaps
are those of the program as stated (``_certificate``).
"""

from __future__ import annotations

from math import copysign, inf, isfinite, isnan, nan, sqrt
from typing import NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._compiling import njit
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import _certificate
from oee_tabular.typing import Array, IntArray


class Box(NamedTuple):
    """Checked bounds nu <= g <= mu of a ratio, infinite where not given."""

    lower: float
    upper: float


def check_box(
    lower: object,
    upper: object,
    *,
    normalized: bool,
    names: tuple[str, str] = ("lower", "upper"),
) -> Box:
    """Return the bounds of a ratio as floats.

    Raises an error for a box that is empty or, where g is normalised, excludes 1.
    """
    nu = 0.0
    if lower is not None:
        nu = _checks.number_in(lower, names[0], 0.0, np.inf)
    mu = np.inf
    if upper is not None:
        mu = _checks.number_in(upper, names[1], 0.0, np.inf, infinite=True)
    if nu > mu:
        raise ArgumentError(
            names[0], f"must not exceed {names[1]}; they are {nu:g} and {mu:g}"
        )
    if mu == 0.0:
        raise ArgumentError(
            names[1],
            "must be positive: the logarithm of the ratio is part of the objective; it"
            " is 0",
        )
    if normalized and not nu <= 1.0 <= mu:
        raise ValueError(
            f"the box [{', '.join(names)}] must contain 1 for sum q g = 1 to be"
            f" possible; it is [{nu:g}, {mu:g}]"
        )
    return Box(nu, mu)


def check_ridge(value: object, n: float) -> float:
    """Return lambda_n, a given number or a function of the sample size, checked."""
    if callable(value):
        found = _checks.call_function(value, "ridge", "ridge(n), n the sample size", n)
        return _checks.number_in(found, f"ridge({n:g})", 0.0, np.inf)
    return _checks.number_in(value, "ridge", 0.0, np.inf)


def check_weights(p: object, q: object) -> tuple[Array, Array]:
    """Return p and q, counts or probabilities of the same cells, checked.

    They are nonnegative, and each has a positive sum.
    """
    weights = (
        _checks.float_array(p, "p", ndim=1),
        _checks.float_array(q, "q", ndim=1),
    )
    for array, name in zip(weights, ("p", "q"), strict=True):
        _checks.require_nonnegative(array, name)
        with np.errstate(over="ignore"):
            total = float(array.sum())
        if not 0.0 < total < np.inf:
            raise ArgumentError(
                name, f"must have a positive, finite sum; it is {total:g}"
            )
    if len(weights[0]) != len(weights[1]):
        raise ValueError(
            f"p and q must have one length; they have {len(weights[0])} and"
            f" {len(weights[1])}"
        )
    return weights


def check_distributions(p: object, q: object) -> tuple[Array, Array]:
    """Return counts or probabilities p and q of the same cells, scaled to sum to 1."""
    p_weights, q_weights = check_weights(p, q)
    return p_weights / p_weights.sum(), q_weights / q_weights.sum()


class Coordinates(NamedTuple):
    """A separable program: minimise sum q g - p log g + curvature/2 (g - center)^2.

    All arrays have one number an entry. ``squares`` means least squares (LSIF), the
    chi-square divergence's dual: sum q g^2 / 2 - p g in place of the KL risk.
    """

    p: Array
    q: Array
    curvature: Array
    center: Array
    squares: bool = False

    def risk(self, g: Array) -> float:
        """Compute sum q g - p log g, or sum q g^2 / 2 - p g for least squares."""
        if self.squares:
            return 0.5 * float(self.q @ g**2) - float(self.p @ g)
        has_log = self.p > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            if has_log.all():
                logs = self.p @ np.log(g)
            else:
                logs = self.p[has_log] @ np.log(g[has_log])
        return float(self.q @ g) - float(logs)

    def penalty(self, g: Array) -> float:
        """Compute sum curvature/2 (g - center)^2."""
        if not self.curvature.any():
            return 0.0
        return 0.5 * float(self.curvature @ (g - self.center) ** 2)

    def kernel_form(self, lower: float, upper: float) -> Form:
        """Return the form q g - p log g - pull g + a/2 g^2 of the program.

        It equals the program up to a constant.
        """
        pull = self.curvature * self.center
        if self.squares:
            pull = self.p + pull + self.q
            a = self.q + self.curvature
            no_log = np.zeros_like(self.p)
            return Form(no_log, self.q, a, pull, float(lower), float(upper))
        return Form(self.p, self.q, self.curvature, pull, float(lower), float(upper))


class RowSolution(NamedTuple):
    """Minimisers, m = 1 + the multiplier, and the absolute duality gap of each row.

    below <= the exact minimiser <= above, entry by entry: the minimisers at the two
    ends of the bracket of m, equal, up to rounding, but where a jump leaves the
    minimiser free (inf where nothing bounds it).
    """

    ratio: Array
    m: Array
    gap: Array
    below: Array
    above: Array


def solve_rows(
    program: Coordinates, lower: float, upper: float, indptr: IntArray
) -> RowSolution:
    """Solve every row ``indptr[k]:indptr[k+1]`` by itself.

    The callers check the arguments: p, q sum to 1 in each row that has entries;
    curvature >= 0; lower <= 1 <= upper. Cost: O(entries) times a few steps; it cannot
    fail.
    """
    rows = indptr.astype(np.int64)
    m = np.empty(len(indptr) - 1)
    ratio, below, above = np.empty((3, len(program.p)))
    fill_rows(*program.kernel_form(lower, upper), rows, ratio, below, above, m)
    gaps = row_gaps(program, ratio, m, lower, upper, rows)
    return RowSolution(ratio, m, gaps, below, above)


def solve_free(program: Coordinates, lower: float, upper: float) -> Array:
    """Compute the minimiser without the equality, in closed form."""
    g = np.empty(len(program.p))
    fill_free(*program.kernel_form(lower, upper), g)
    return g


def row_gaps(
    program: Coordinates,
    g: Array,
    m: Array | None,
    lower: float,
    upper: float,
    indptr: IntArray,
) -> Array:
    """Compute the duality gap of any g with multipliers ``m`` - 1, row by row.

    The multipliers are of the rows' equalities; None means that there is no equality.
    The gap is computed from the program as stated, by code that no solver uses; what
    constraints are missed by counts as it is. Cost: O(entries).
    """
    multiplier = np.ones(len(indptr) - 1) if m is None else m
    box = Box(float(lower), float(upper))
    return _certificate.row_gaps(program, box, indptr, g, multiplier, m is not None)


def objective(g: Array, program: Coordinates) -> float:
    """Compute the program's value at g."""
    return program.risk(g) + program.penalty(g)


# Multipliers nearer to 0 count as 0.
TINY = 1e-200
# The relative rounding error of a double, a little above 2^-52.
ROUNDING = 2.3e-16
# The largest number of steps; halvings from the largest to the smallest double take
# 2000.
N_STEPS = 4000


class Form(NamedTuple):
    """The arrays (entries,) of a program as the kernels read it, and its box."""

    p: Array
    q: Array
    a: Array
    pull: Array
    lower: float
    upper: float


@njit(cache=True, error_model="numpy")
def coordinate(b, a, p, lower, upper):
    """Return argmin of b g - p log g + a/2 g^2 over [lower, upper].

    It is ``lower`` where every point is one.
    """
    g = inf
    if p > 0.0:
        if a > 0.0:
            root = sqrt(b * b + 4.0 * a * p)
            g = 2.0 * p / (b + root) if b >= 0.0 else (root - b) / (2.0 * a)
        elif b > 0.0:
            g = p / b
    elif b >= 0.0:
        g = 0.0
    elif a > 0.0:
        g = -b / a
    if g < lower:
        g = lower
    if g > upper:
        g = upper
    return g


@njit(cache=True, error_model="numpy")
def fill_row(m, p, q, a, pull, lower, upper, low, high, g):
    """Fill g_x(m) for the entries low..high; return sum q (g - 1) and minus its slope.

    g_x(m) = argmin of (q_x m - pull_x) g - p_x log g + a_x/2 g^2. The slope is d/dm
    sum q g_x(m) = - sum q^2 / (p / g^2 + a) over entries inside the box.
    """
    miss = 0.0
    slope = 0.0
    for x in range(low, high):
        value = coordinate(q[x] * m - pull[x], a[x], p[x], lower, upper)
        g[x] = value
        if q[x] > 0.0:
            miss += q[x] * (value - 1.0)
            if lower < value < upper:
                # q^2 / (p / g^2 + a), written so that g^2 cannot underflow
                mass = q[x] * value
                curvature = p[x] + a[x] * value * value
                if curvature > 0.0:
                    slope += mass * (mass / curvature)
    return miss, slope


@njit(cache=True, error_model="numpy")
def solve_row(p, q, a, pull, lower, upper, low, high, g, below, above):
    """Solve one row into ``g`` between ``below`` and ``above``; return m.

    The root of sum q (g_x(m) - 1) = 0, with g at the two ends of m's bracket in
    ``below`` and ``above``. Needs lower <= 1 <= upper. The bracket has miss(left) >= 0
    >= miss(right); from m = 1 it shrinks by Newton's steps, each a little too long near
    the root so that both ends come within rounding of it, by doubled steps where it has
    no end, and by halving. g is the convex combination of the two ends' minimisers that
    meets the equality, right at jumps too (p = 0 = a).
    """
    mass = 0.0
    curved = False
    pulled = False
    for x in range(low, high):
        if q[x] > 0.0:
            mass += p[x]
            if a[x] > 0.0:
                curved = True
        if pull[x] != 0.0:
            pulled = True
    # Every feasible g is a minimiser.
    if mass == 0.0 and not curved and low < high and not pulled:
        fill_row(0.0, p, q, a, pull, lower, upper, low, high, g)
        for x in range(low, high):
            if q[x] > 0.0:
                g[x] = 1.0
            below[x] = g[x]
            above[x] = g[x]
        return 0.0
    left = -inf
    right = inf
    # Without a bound sum q g >= mass / m; with one all entries are at it once m < 0.
    if not curved:
        left = mass if upper == inf else -TINY
    # Newton's method within the bracket, until it is as narrow as rounding.
    m = 1.0
    width = 1.0
    reach = ROUNDING
    for step in range(1, N_STEPS):
        miss, slope = fill_row(m, p, q, a, pull, lower, upper, low, high, g)
        if miss == 0.0:
            for x in range(low, high):
                below[x] = g[x]
                above[x] = g[x]
            return m
        # Numbers that double precision does not hold.
        if isnan(miss) or (curved and not isfinite(miss + slope)):
            for x in range(low, high):
                g[x] = nan
            return nan
        if miss > 0.0:
            left = m
        else:
            right = m
        limit = 4.0 * reach * abs(m)
        if right - left <= limit or right - left <= TINY:
            break
        share = miss / (slope * m) if slope > 0.0 else nan
        trial = m / (1.0 - share) if not curved and share < 0.5 else m * (1.0 + share)
        if abs(share) <= 1e-10:
            trial += copysign(reach * m, miss)
            reach *= 2.0
        if not left < trial < right or step % 16 == 0:
            # g has no bound as m falls, or reaches its bounds as it rises.
            if right == inf or left == -inf:
                trial = left + width if right == inf else right - width
                width *= 2.0
            else:
                trial = 0.0 if left < 0.0 < right else 0.5 * (left + right)
            if not left < trial < right:
                break
        m = trial
    # The convex combination of the two ends that meets the equality.
    at_left = fill_row(left, p, q, a, pull, lower, upper, low, high, above)[0]
    at_right = fill_row(right, p, q, a, pull, lower, upper, low, high, below)[0]
    share = 1.0
    if at_left > at_right:
        share = -at_right / (at_left - at_right)
        if share < 0.0:
            share = 0.0
        if share > 1.0:
            share = 1.0
    for x in range(low, high):
        g[x] = above[x]
        if above[x] > below[x]:
            g[x] = below[x] + share * (above[x] - below[x])
    return left if share >= 0.5 else right


@njit(cache=True, error_model="numpy")
def fill_rows(p, q, a, pull, lower, upper, indptr, g, below, above, m):
    """Solve every row by itself: fill the ratios, their enclosure, and each row's m."""
    for k in range(len(m)):
        m[k] = solve_row(
            p, q, a, pull, lower, upper, indptr[k], indptr[k + 1], g, below, above
        )


@njit(cache=True, error_model="numpy")
def fill_free(p, q, a, pull, lower, upper, g):
    """Fill the minimisers without the equality, g_x(1)."""
    for x in range(len(g)):
        g[x] = coordinate(q[x] - pull[x], a[x], p[x], lower, upper)
