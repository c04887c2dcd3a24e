"""The joint program of one (s, a): beta_sas' = B_x and beta_sa = b together, under sum_x q_x B_x = r b, r = sum_x q_x.

    minimise  sum_x [q g - p log g + lam/2 g^2](B_x)  +  [r g - s log g + lam/2 g^2](b)   over  nu <= B, b <= mu.

*Without a box on the ratio.* With the multiplier theta of the equality both have the coordinate's closed form, B_x(theta)
falling and b(theta) rising, so that phi(theta) = sum q B(theta) - r b(theta) is nonincreasing: one bracketed root an (s, a).

*With one*, ratio_lower b <= B_x <= ratio_upper b. For a given b the inner program over B is a row of ``_dual``: with g = B / b,

    minimise  sum_x [q b g - p log g + lam b^2 / 2 g^2]   subject to  sum q g = sum q  and
              max(nu / b, ratio_lower) <= g <= min(mu / b, ratio_upper),

and the value is convex in b with the derivative (envelope theorem)

    r - s / b + lam b - theta r + ratio_lower sum eta - ratio_upper sum xi,

theta = m - 1 the multiplier of sum q B = r b, eta and xi those of the moving bounds: one bracketed root in b. Where theta is
free in an interval, the one of least gap is taken, by the certificate itself.
"""

import numpy as np
from numba import njit

from oee_tabular.ratio._certificate import joint_gap
from oee_tabular.ratio._dual import Form, coordinate, solve_row


@njit(cache=True, error_model="numpy", inline="always")  # rows are short: a call costs as much as its loop
def fill(theta, f, k, moves):
    """B_x(theta) of row k into ``moves``; returns b(theta) and phi(theta)."""
    r = f.r[k]
    b = coordinate(r - theta * r, f.lam, f.s[k], f.nu, f.mu)
    phi = -r * b
    for x in range(f.indptr[k], f.indptr[k + 1]):
        moves[x] = coordinate(f.q[x] + theta * f.q[x], f.lam, f.p[x], f.nu, f.mu)
        phi += f.q[x] * moves[x]
    return b, phi


@njit(cache=True, error_model="numpy")
def solve(f, k, moves, at_left, at_right):
    """One (s, a) without a box on the ratio: fills B into ``moves``; returns b and theta."""
    n, r = f.indptr[k + 1] - f.indptr[k], f.r[k]
    b, phi = fill(0.0, f, k, moves)
    if b < np.inf and abs(phi) <= 2.3e-16 * (n + 2) * r * b:  # equal up to the rounding of the sums themselves
        return b, 0.0
    left, right, width = 0.0, 0.0, 0.5
    while phi > 0.0 and width < 1e300:  # phi(left) >= 0 >= phi(right)
        left = right
        right += width
        width *= 2.0
        b, phi = fill(right, f, k, moves)
    if right == 0.0:
        while phi < 0.0 and width < 1e300:
            right = left
            left -= width
            width *= 2.0
            b, phi = fill(left, f, k, moves)
    for _ in range(2000):
        theta = 0.5 * (left + right)
        if not left < theta < right:
            break
        b, phi = fill(theta, f, k, moves)
        if phi >= 0.0:
            left = theta
        if phi <= 0.0:
            right = theta
    b_left, phi_left = fill(left, f, k, at_left)
    b_right, phi_right = fill(right, f, k, at_right)
    share = phi_left / (phi_left - phi_right) if phi_left > phi_right else 0.0  # of the right end
    if not 0.0 <= share <= 1.0:
        share = 0.0 if phi_left < np.inf else 1.0
    b = b_left if b_left == b_right or share == 0.0 else b_left + share * (b_right - b_left)
    for x in range(f.indptr[k], f.indptr[k + 1]):
        same = at_left[x] == at_right[x] or share == 0.0
        moves[x] = at_left[x] if same else at_left[x] + share * (at_right[x] - at_left[x])
    return b, right if share > 0.5 else left


@njit(cache=True, error_model="numpy")
def inner(b, f, k, scaled, moves):
    """B of row k for a given b into ``moves``; returns theta and the moving bounds' pull on b. ``scaled``: q b, lam b^2, 0."""
    (q, a, zero), low, high = scaled, f.indptr[k], f.indptr[k + 1]
    lower, upper = max(f.nu / b, f.ratio_lower), min(f.mu / b, f.ratio_upper)
    for x in range(low, high):
        q[x], a[x] = f.q[x] * b, f.lam * b * b
    theta = 0.0
    if f.r[k] > 0.0:
        m, _, _ = solve_row(Form(f.p, q, a, zero, lower, upper), low, high, f.lam == 0.0, moves)
        theta = m - 1.0
    else:
        for x in range(low, high):
            moves[x] = coordinate(0.0, a[x], f.p[x], lower, upper)
    pull = 0.0
    for x in range(low, high):
        g = moves[x]
        moves[x] = g * b
        slope = (1.0 + theta) * f.q[x] + f.lam * moves[x] - (f.p[x] / moves[x] if f.p[x] > 0.0 else 0.0)
        if g <= lower and f.ratio_lower * b > f.nu and slope > 0.0:
            pull += f.ratio_lower * slope
        elif g >= upper and f.ratio_upper * b < f.mu and slope < 0.0:
            pull += f.ratio_upper * slope
    return theta, pull


@njit(cache=True, error_model="numpy")
def multipliers(b, theta, f, k, moves, eta, xi):
    """Fills eta and xi in for B (``moves``), b and theta; returns what is left of b's condition, and its derivative in theta.

    Where a moving bound coincides with a fixed one its share of the multiplier is what b's own condition asks for.
    """
    low, high, near = f.indptr[k], f.indptr[k + 1], 1e-12
    moving_lower, moving_upper = f.ratio_lower * b > f.nu * (1.0 + near), f.ratio_upper * b < f.mu * (1.0 - near)
    rest = f.r[k] - theta * f.r[k] + f.lam * b - (f.s[k] / b if f.s[k] > 0.0 else 0.0)
    turn, loose = -f.r[k], 0.0
    for x in range(low, high):
        eta[x], xi[x] = 0.0, 0.0
        slope = (1.0 + theta) * f.q[x] + f.lam * moves[x] - (f.p[x] / moves[x] if f.p[x] > 0.0 else 0.0)
        if slope > 0.0 and f.ratio_lower > 0.0 and moves[x] <= f.ratio_lower * b * (1.0 + near):
            eta[x] = slope
            pull, moving, bound = f.ratio_lower * slope, moving_lower, f.ratio_lower
        elif slope < 0.0 and moves[x] >= f.ratio_upper * b * (1.0 - near):
            xi[x] = -slope
            pull, moving, bound = f.ratio_upper * slope, moving_upper, f.ratio_upper
        else:
            continue
        if moving:
            rest += pull
            turn += bound * f.q[x]
        else:
            loose += pull
    share = min(max(-rest / loose, 0.0), 1.0) if loose != 0.0 else 0.0
    for x in range(low, high):
        if not moving_lower:
            eta[x] *= share
        if not moving_upper:
            xi[x] *= share
    return rest + share * loose, turn


@njit(cache=True, error_model="numpy")
def root_in_b(f, k, scaled, moves):
    """(b, theta) where the value's derivative in b vanishes, or at a bound; B into ``moves``.

    From b = 1 to the bound on the side of the root, or by doubled steps where there is none; then secant steps between the
    ends of the bracket, every fifth a halving.
    """
    left, right, at_left, at_right = f.nu, f.mu, np.nan, np.nan
    b = min(max(1.0, left), right)
    for step in range(1, 2000):
        theta, pull = inner(b, f, k, scaled, moves)
        slope = f.r[k] - theta * f.r[k] + f.lam * b + pull - (f.s[k] / b if f.s[k] > 0.0 else 0.0)
        if slope == 0.0 or (slope > 0.0 and b == f.nu) or (slope < 0.0 and b == f.mu):
            break
        if slope > 0.0:
            right, at_right = b, slope
        else:
            left, at_left = b, slope
        if np.isnan(at_left):
            trial = left if left > 0.0 else 0.5 * b
        elif np.isnan(at_right):
            trial = right if right < np.inf else 2.0 * b
        else:
            trial = left - at_left * ((right - left) / (at_right - at_left))
            if not left < trial < right or step % 5 == 0:
                trial = left + 0.5 * (right - left)
            if not left < trial < right:
                break
        if trial < 1e-300 or trial > 1e300:
            break
        if abs(trial - b) <= 2.3e-16 * b:
            theta, pull = inner(trial, f, k, scaled, moves)
            return trial, theta
        b = trial
    return b, theta


@njit(cache=True, error_model="numpy")
def solve_boxed(f, k, scaled, moves, eta, xi):
    """One (s, a) with a box on the ratio: fills B (``moves``), eta and xi; returns b and theta."""
    b, theta = root_in_b(f, k, scaled, moves)
    rest, turn = multipliers(b, theta, f, k, moves, eta, xi)
    gap, trial = joint_gap(f, k, moves, b, theta, eta, xi), theta
    for _ in range(8):  # where B cannot move theta is free in an interval: take the one that suits b
        if rest == 0.0 or turn == 0.0:
            break
        trial -= rest / turn
        rest, turn = multipliers(b, trial, f, k, moves, eta, xi)
        other = joint_gap(f, k, moves, b, trial, eta, xi)
        if other < gap:
            gap, theta = other, trial
    multipliers(b, theta, f, k, moves, eta, xi)
    return b, theta


@njit(cache=True, error_model="numpy")
def solve_all(f, boxed):
    """Every (s, a) of the program ``f`` by itself: B, b, theta, eta and xi; ``boxed``: with a box on the ratio."""
    n, n_rows = len(f.p), len(f.s)
    moves, eta, xi, scratch = np.empty(n), np.zeros(n), np.zeros(n), (np.empty(n), np.empty(n), np.zeros(n))
    b, theta = np.empty(n_rows), np.empty(n_rows)
    for k in range(n_rows):
        if boxed:
            b[k], theta[k] = solve_boxed(f, k, scratch, moves, eta, xi)
        else:
            b[k], theta[k] = solve(f, k, moves, scratch[0], scratch[1])
    return moves, b, theta, eta, xi
