"""Kernels of the tilt: its rows, Newton's method for its risk, and its strengths.

A transition x has numbers phi_x (d,): the columns ``base`` (d_1,), and a one in column
d_1 + ``code`` (no one where the code is -1). The parameters are theta (1 + A, d): those
of all actions, then those of each action alone. f'' is an arrow (see ``ridge``): its
blocks are diag(L_0) + sum_a G_a, beside it G_a, and G_a + diag(L_a), L (blocks, d) the
penalty, with one row where no action has parameters of its own.
Written in loops, since numba takes 32 s to compile this in array expressions, and 12 s
in loops.
"""

from typing import Any, NamedTuple

import numpy as np

from oee_tabular._compiling import njit

# The largest number of steps of Newton's method.
N_NEWTON = 50
# The relative tolerance of f in the rounds before the last: strengths need no more.
ROUND_TOLERANCE = 1e-5
# The strength of a group that has practically no effect.
LARGEST_STRENGTH = 1e6
# The number of parameters, all of them 0, that the prior of a strength is worth.
HYPERPRIOR = 0.25


class Columns(NamedTuple):
    """The columns of directions on some rows.

    base (entries, d_1), code (entries,), n_codes, indptr (rows + 1,), action (rows,),
    weights (entries,) the simulator's.
    """

    base: Any
    code: Any
    n_codes: Any
    indptr: Any
    action: Any
    weights: Any


@njit(cache=True, nogil=True)
def find_codes(places, state, arrival, indptr, kinds, tolerance):
    """Find the place of places[s'] - places[s] in ``kinds`` (k, c), or -1."""
    code = np.full(len(arrival), -1)
    for row in range(len(state)):
        for x in range(indptr[row], indptr[row + 1]):
            for k in range(len(kinds)):
                same = True
                for c in range(kinds.shape[1]):
                    difference = places[arrival[x], c] - places[state[row], c]
                    if abs(difference - kinds[k, c]) > tolerance:
                        same = False
                        break
                if same:
                    code[x] = k
                    break
    return code


@njit(cache=True, nogil=True, error_model="numpy")
def tilt_rows(columns, theta):
    """Compute the rows P exp((theta_0 + theta_a) . phi) / Z, (entries,), and ln Z.

    The largest exponent of a row is subtracted first, so that exp does not overflow.
    """
    width = columns.base.shape[1]
    model = np.empty(len(columns.weights))
    log_normalizer = np.empty(len(columns.action))
    for row in range(len(columns.action)):
        own = theta[0] + theta[1 + columns.action[row]]
        largest = -np.inf
        for x in range(columns.indptr[row], columns.indptr[row + 1]):
            exponent = 0.0
            for j in range(width):
                exponent += own[j] * columns.base[x, j]
            if columns.code[x] >= 0:
                exponent += own[width + columns.code[x]]
            model[x] = exponent
            largest = max(largest, exponent)
        total = 0.0
        for x in range(columns.indptr[row], columns.indptr[row + 1]):
            model[x] = columns.weights[x] * np.exp(model[x] - largest)
            total += model[x]
        for x in range(columns.indptr[row], columns.indptr[row + 1]):
            model[x] /= total
        log_normalizer[row] = largest + np.log(total)
    return model, log_normalizer


@njit(cache=True, nogil=True)
def sum_columns(columns, values, n_actions):
    """Sum values_x phi_x over each action's rows, (A, d)."""
    width = columns.base.shape[1]
    sums = np.zeros((n_actions, width + columns.n_codes))
    for row in range(len(columns.action)):
        own = sums[columns.action[row]]
        for x in range(columns.indptr[row], columns.indptr[row + 1]):
            for j in range(width):
                own[j] += values[x] * columns.base[x, j]
            if columns.code[x] >= 0:
                own[width + columns.code[x]] += values[x]
    return sums


@njit(cache=True, nogil=True)
def sum_covariances(columns, model, mass, n_actions):
    """Sum mass E[phi], (A, d), and mass Cov[phi], (A, d, d), over each action's rows.

    Moments are under ``model``; mass is (rows,). Cov[phi] = E[phi phi'] - E[phi]
    E[phi]', of which the lower triangle is summed.
    """
    width = columns.base.shape[1]
    d = width + columns.n_codes
    means = np.zeros((n_actions, d))
    covariances = np.zeros((n_actions, d, d))
    mean = np.zeros(d)
    used = np.arange(d)
    for row in range(len(columns.action)):
        if mass[row] == 0.0:
            continue
        own = covariances[columns.action[row]]
        n_used = width  # the columns of the base, then the codes that the row has
        # mass E[phi phi'] of the row, and mass E[phi] into ``mean``.
        for x in range(columns.indptr[row], columns.indptr[row + 1]):
            share = mass[row] * model[x]
            code = columns.code[x]
            if share == 0.0:
                continue
            for i in range(width):
                part = share * columns.base[x, i]
                mean[i] += part
                for j in range(i + 1):
                    own[i, j] += part * columns.base[x, j]
                if code >= 0:
                    own[width + code, i] += part
            if code >= 0:
                if mean[width + code] == 0.0:
                    used[n_used] = width + code
                    n_used += 1
                mean[width + code] += share
                own[width + code, width + code] += share
        # Less mass E[phi] E[phi]', for the columns that the row has.
        for i in range(n_used):
            for j in range(n_used):
                if used[j] <= used[i]:
                    own[used[i], used[j]] -= mean[used[i]] * mean[used[j]] / mass[row]
        for i in range(n_used):
            means[columns.action[row], used[i]] += mean[used[i]]
            mean[used[i]] = 0.0
    for action in range(n_actions):
        for i in range(d):
            for j in range(i):
                covariances[action, j, i] = covariances[action, i, j]
    return means, covariances


@njit(cache=True, nogil=True)
def invert_arrow(covariances, penalty):
    """Invert the arrow: (G_a + L_a)^-1, (G_a + L_a)^-1 G_a, and the Schur complement.

    The first two are (A, d, d), the inverse of the complement is (d, d). The complement
    is L_0 + sum_a G_a - G_a (G_a + L_a)^-1 G_a = L_0 + sum_a G_a (G_a + L_a)^-1 L_a,
    which does not cancel.
    """
    n_own = len(penalty) - 1
    d = penalty.shape[1]
    inverse = np.empty((n_own, d, d))
    gain = np.empty((n_own, d, d))
    left = np.diag(penalty[0])
    for action in range(len(covariances)):
        own = covariances[action].copy()
        if n_own > 0:
            for i in range(d):
                own[i, i] += penalty[1 + action, i]
            inverted = np.linalg.inv(own)
            own = inverted @ covariances[action]
        for i in range(d):
            for j in range(d):
                if n_own > 0:
                    inverse[action, i, j] = inverted[i, j]
                    gain[action, i, j] = own[i, j]
                    own[i, j] *= penalty[1 + action, i]
                left[i, j] += 0.5 * own[i, j]
                left[j, i] += 0.5 * own[i, j]
    return inverse, gain, np.linalg.inv(left)


@njit(cache=True, nogil=True)
def solve_arrow(inverses, b):
    """Solve f'' x = b by the inverted arrow, both (blocks, d).

    x_0 = S^-1 (b_0 - sum_a G_a (G_a + L_a)^-1 b_a), x_a = (G_a + L_a)^-1 (b_a - G_a
    x_0), S the Schur complement.
    """
    inverse, gain, shared = inverses
    x = np.zeros(b.shape)
    right = b[0].copy()
    for action in range(len(gain)):
        for i in range(len(right)):
            for j in range(len(right)):
                right[j] -= gain[action, i, j] * b[1 + action, i]
    for i in range(len(right)):
        for j in range(len(right)):
            x[0, i] += shared[i, j] * right[j]
    for action in range(len(gain)):
        for i in range(len(right)):
            for j in range(len(right)):
                x[1 + action, i] += (
                    inverse[action, i, j] * b[1 + action, j]
                    - gain[action, i, j] * x[0, j]
                )
    return x


@njit(cache=True, nogil=True)
def invert_diagonal(inverses):
    """Compute the diagonal of f''^-1, (blocks, d), from the inverted arrow."""
    inverse, gain, shared = inverses
    diagonal = np.empty((1 + len(inverse), len(shared)))
    for i in range(len(shared)):
        diagonal[0, i] = shared[i, i]
    for action in range(len(inverse)):
        part = gain[action] @ shared
        for i in range(len(shared)):
            diagonal[1 + action, i] = inverse[action, i, i]
            for j in range(len(shared)):
                diagonal[1 + action, i] += part[i, j] * gain[action, i, j]
    return diagonal


@njit(cache=True, nogil=True, error_model="numpy")
def differentiate(columns, model, risk, theta, penalty):
    """Compute f' (blocks, d) and G (A, d, d) where the tilt's rows are ``model``.

    f' = L theta + sum_rows w n E[phi] - sum_x w n_x phi_x.
    """
    mass, pulled = risk
    means, covariances = sum_covariances(columns, model, mass, len(pulled))
    gradient = penalty * theta[: len(penalty)]
    for action in range(len(pulled)):
        for j in range(pulled.shape[1]):
            gradient[0, j] += means[action, j] - pulled[action, j]
            if len(penalty) > 1:
                gradient[1 + action, j] += means[action, j] - pulled[action, j]
    return gradient, covariances


@njit(cache=True, nogil=True, error_model="numpy")
def penalized_risk(columns, risk, theta, penalty):
    """Compute f and the tilt's rows, f as in the docstring of ``prior.ridge``."""
    mass, pulled = risk
    model, log_normalizer = tilt_rows(columns, theta)
    value = 0.0
    for row in range(len(mass)):
        value += mass[row] * log_normalizer[row]
    for action in range(len(pulled)):
        for j in range(pulled.shape[1]):
            value -= pulled[action, j] * (theta[0, j] + theta[1 + action, j])
    for block in range(len(penalty)):
        for j in range(penalty.shape[1]):
            value += 0.5 * penalty[block, j] * theta[block, j] ** 2
    return value, model


@njit(cache=True, nogil=True, error_model="numpy")
def minimise(columns, risk, theta, penalty, tolerance):
    """Minimise f by Newton's method with backtracking: theta <- theta - t f''^-1 f'.

    It ends when a step gains less than ``tolerance`` of f or only rounding is left.
    Returns theta, G, and the bound sum f'^2 / (2 L) on f less its minimum.
    """
    value, model = penalized_risk(columns, risk, theta, penalty)
    last = np.inf
    mass = 0.0
    gap = 0.0
    for row in range(len(risk[0])):
        mass += risk[0][row]
    for _ in range(N_NEWTON):
        gradient, covariances = differentiate(columns, model, risk, theta, penalty)
        step = solve_arrow(invert_arrow(covariances, penalty), gradient)
        decrement = 0.0
        gap = 0.0
        for block in range(len(penalty)):
            for j in range(penalty.shape[1]):
                decrement += gradient[block, j] * step[block, j]
                gap += 0.5 * gradient[block, j] ** 2 / penalty[block, j]
        size = max(1.0, abs(value), mass)
        if not decrement > tolerance * size or 1e-12 * size > decrement > 0.25 * last:
            break
        last = decrement
        # Rounding may hide a decrease of f that is this small.
        slack = 1e-13 * size if decrement < 1e-9 * size else 0.0
        # The step is halved until f decreases enough.
        length = 2.0
        trial = np.inf
        while trial > value - 1e-4 * length * decrement + slack and length > 1e-12:
            length *= 0.5
            moved = theta.copy()
            for block in range(len(step)):
                for j in range(step.shape[1]):
                    moved[block, j] -= length * step[block, j]
            trial, tilted = penalized_risk(columns, risk, moved, penalty)
        if length <= 1e-12:
            break
        theta = moved
        value = trial
        model = tilted
    return theta, covariances, gap


@njit(cache=True, nogil=True, error_model="numpy")
def update_strengths(theta, inverses, penalty, scale, group, n_groups):
    """Compute MacKay's lambda of each group of columns, (2, groups).

    lambda_g = [c + sum_j (1 - L_j (f''^-1)_jj)] / sum_j (s_j theta_j)^2, for all
    actions and for each action alone.
    """
    diagonal = invert_diagonal(inverses)
    told = np.full((2, n_groups), HYPERPRIOR)
    size = np.zeros((2, n_groups))
    for block in range(len(penalty)):
        for j in range(len(group)):
            told[min(block, 1), group[j]] += (
                1.0 - penalty[block, j] * diagonal[block, j]
            )
            size[min(block, 1), group[j]] += (scale[block, j] * theta[block, j]) ** 2
    for side in range(2):
        for k in range(n_groups):
            told[side, k] = min(
                max(told[side, k] / max(size[side, k], 1e-300), 1.0), LARGEST_STRENGTH
            )
    return told


@njit(cache=True, nogil=True)
def spread_strengths(strengths, scale, group):
    """Compute the penalty L = lambda s^2 of each column, (blocks, d)."""
    penalty = np.empty(scale.shape)
    for block in range(len(scale)):
        for j in range(len(group)):
            penalty[block, j] = (
                strengths[min(block, 1), group[j]] * scale[block, j] ** 2
            )
    return penalty


@njit(cache=True, nogil=True)
def fit_tilt(columns, risk, theta, strengths, scale, group, n_rounds):
    """Fit theta and the strengths by ``n_rounds`` of MacKay's rule.

    Each round minimises f and then updates the strengths. Returns theta, the strengths,
    G, and the bound on f less its minimum.
    """
    for left in range(n_rounds, -1, -1):
        penalty = spread_strengths(strengths, scale, group)
        theta, covariances, gap = minimise(
            columns, risk, theta, penalty, ROUND_TOLERANCE if left else 1e-24
        )
        if left:
            inverses = invert_arrow(covariances, penalty)
            strengths = update_strengths(
                theta, inverses, penalty, scale, group, strengths.shape[1]
            )
    return theta, strengths, covariances, gap
