"""The joint program of one (s, a) with the ratio kept in a box: nu b <= B_x <= mu b.

For a given b the inner program over B is a row of ``_dual``: with g = B / b,

    minimise sum_x [q b g - p log g + A b^2 / 2 g^2]  over  max(lower / b, nu) <= g <= min(upper / b, mu),  sum q g = sum q,

and the value is convex in b with the derivative (envelope theorem)

    r - s / b + V b - theta D + nu sum lambda - mu sum rho,

theta = m - 1 the multiplier of sum q B = D b, lambda and rho those of the moving bounds: one bracketed root in b.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from oee_tabular.ratio._dual import coordinate, solve_row
from oee_tabular.ratio._joint import gap_term


def inner(b: Any, p: Any, q: Any, a: Any, box: Any, low: Any, high: Any, scratch: Any, out: Any) -> Any:
    """B for a given b into ``out``; returns theta, nu sum lambda - mu sum rho. ``box`` is (lower, upper, nu, mu)."""
    lower, upper, nu, mu = box
    scaled, bent, zero = scratch
    least, most = max(lower / b, nu), min(upper / b, mu)
    mass = 0.0
    for x in range(low, high):
        scaled[x] = q[x] * b
        bent[x] = a[x] * b * b
        mass += q[x]
    theta = 0.0
    if mass > 0.0:
        m, _, _ = solve_row(p, scaled, bent, zero, least, most, low, high, out)
        theta = m - 1.0
    else:
        for x in range(low, high):
            out[x] = coordinate(0.0, bent[x], p[x], least, most)
    pull = 0.0
    for x in range(low, high):
        g = out[x]
        out[x] = g * b
        slope = (1.0 + theta) * q[x] + a[x] * out[x] - (p[x] / out[x] if p[x] > 0.0 else 0.0)
        if g <= least and nu * b > lower and slope > 0.0:
            pull += nu * slope
        elif g >= most and mu * b < upper and slope < 0.0:
            pull += mu * slope
    return theta, pull


inner = njit(cache=True, error_model="numpy")(inner)


def certify(
    b: Any,
    theta: Any,
    p: Any,
    q: Any,
    a: Any,
    pair: Any,
    box: Any,
    low: Any,
    high: Any,
    out: Any,
    push: Any,
    press: Any,
) -> Any:
    """The gap of B (``out``) and b with theta, lambda (``push``) and rho (``press``), which are filled in.

    Where a moving bound coincides with a fixed one its share of the multiplier is what b's own condition asks for. Also
    returns what is left of that condition, and its derivative in theta.
    """
    s, r, v, big = pair
    lower, upper, nu, mu = box
    near = 1e-12
    slope = r - theta * big + v * b - (s / b if s > 0.0 else 0.0)
    turn, loose = -big, 0.0
    for x in range(low, high):
        push[x], press[x] = 0.0, 0.0
        steep = (1.0 + theta) * q[x] + a[x] * out[x] - (p[x] / out[x] if p[x] > 0.0 else 0.0)
        if steep > 0.0 and nu > 0.0 and out[x] <= nu * b * (1.0 + near):
            push[x] = steep
            if nu * b > lower * (1.0 + near):
                slope += nu * steep
                turn += nu * q[x]
            else:
                loose += nu * steep
        elif steep < 0.0 and out[x] >= mu * b * (1.0 - near):
            press[x] = -steep
            if mu * b < upper * (1.0 - near):
                slope += mu * steep
                turn += mu * q[x]
            else:
                loose += mu * steep
    share = min(max(-slope / loose, 0.0), 1.0) if loose != 0.0 else 0.0
    residual, gap, lift = -big * b, 0.0, 0.0
    for x in range(low, high):
        if push[x] > 0.0 and not nu * b > lower * (1.0 + near):
            push[x] *= share
        if press[x] > 0.0 and not mu * b < upper * (1.0 - near):
            press[x] *= share
        bound = (1.0 + theta) * q[x] - push[x] + press[x]
        gap += gap_term(bound, a[x], p[x], coordinate(bound, a[x], p[x], lower, upper), out[x], lower, upper)
        if push[x] > 0.0:
            gap += push[x] * abs(out[x] - nu * b)
            lift += nu * push[x]
        if press[x] > 0.0:
            gap += press[x] * abs(mu * b - out[x])
            lift -= mu * press[x]
        residual += q[x] * out[x]
    bound = r - theta * big + lift
    gap += gap_term(bound, v, s, coordinate(bound, v, s, lower, upper), b, lower, upper)
    return gap + abs(theta * residual), slope + share * loose, turn


certify = njit(cache=True, error_model="numpy")(certify)


def solve_box(
    p: Any, q: Any, a: Any, pair: Any, box: Any, low: Any, high: Any, scratch: Any, out: Any, push: Any, press: Any
) -> Any:
    """One (s, a): fills B, lambda (``push``) and rho (``press``); returns b, theta and the gap. ``pair`` is (s, r, V, D)."""
    s, r, v, big = pair
    lower, upper = box[0], box[1]
    left, right = lower, upper
    b = min(max(1.0, lower), upper)
    for _ in range(4000):
        theta, pull = inner(b, p, q, a, box, low, high, scratch, out)
        slope = r - theta * big + v * b + pull - (s / b if s > 0.0 else 0.0)
        if slope == 0.0:
            break
        if slope > 0.0:
            right = b
        else:
            left = b
        if right == np.inf:
            trial = 2.0 * b
        elif left == 0.0 and right > 1e-300:
            trial = 0.5 * b
        else:
            trial = left + 0.5 * (right - left)
        if trial == b or not left <= trial <= right or trial < 1e-300 or trial > 1e300:
            break
        if trial in (left, right):
            if (trial == lower and left == lower) or (trial == upper and right == upper):
                b = trial
                theta, pull = inner(b, p, q, a, box, low, high, scratch, out)
            break
        b = trial
    gap, slope, turn = certify(b, theta, p, q, a, pair, box, low, high, out, push, press)
    trial = theta
    for _ in range(8):  # where B cannot move theta is free in an interval: take the one that suits b
        if slope == 0.0 or turn == 0.0:
            break
        trial -= slope / turn
        other, slope, turn = certify(b, trial, p, q, a, pair, box, low, high, out, push, press)
        if other < gap:
            gap, theta = other, trial
    certify(b, theta, p, q, a, pair, box, low, high, out, push, press)
    return b, theta, gap


solve_box = njit(cache=True, error_model="numpy")(solve_box)


def solve_all_boxed(p: Any, q: Any, a: Any, s: Any, r: Any, v: Any, big: Any, box: Any, indptr: Any) -> Any:
    """Every (s, a) by itself: B, b, theta, lambda, rho and gaps."""
    n_rows = len(indptr) - 1
    out, push, press = np.empty(len(p)), np.zeros(len(p)), np.zeros(len(p))
    scratch = (np.empty(len(p)), np.empty(len(p)), np.zeros(len(p)))
    b, theta, gap = np.empty(n_rows), np.empty(n_rows), np.empty(n_rows)
    for k in range(n_rows):
        pair = (s[k], r[k], v[k], big[k])
        b[k], theta[k], gap[k] = solve_box(p, q, a, pair, box, indptr[k], indptr[k + 1], scratch, out, push, press)
    return out, b, theta, push, press, gap


solve_all_boxed = njit(cache=True, error_model="numpy")(solve_all_boxed)
