"""Means and variances of weighted returns, backward in time, in the form that does not cancel.

A path is drawn with actions from ``act`` and moves from ``prob``; a step multiplies the weight by u(s, a) and w(s, a, s').

per decision    X = h(s) + u [pay(s, a) + c(s, a) + sum over the move of w (pay(s, a, s') + gamma (X' - k(s')))]
                (one of the two pays is 0), v(s) = E[u^2 w^2 gamma^2 v'] + Var_{a, s'}(u [pay + c + w (pay' + gamma (m' - k'))])
trajectory      L = u w L', L R = u w L' (r + gamma R'): means of L and L R, variances and covariance likewise

(law of total variance: every term is a variance or a positive multiple of one; E X^2 - (E X)^2 would lose digits). For a
policy and pays that do not depend on time ``_merged`` has the same, faster; this is what it is tested against.
"""

from collections import namedtuple

import numpy as np
from numba import njit

# what X has beside the walk's pays: see ``per_decision``
Extras = namedtuple("Extras", "shift scale c h k")


@njit(cache=True, error_model="numpy")
def per_decision(walk, steps, extras, keep):
    """Mean and variance (S,) of X_0 and, if ``keep``, (T, S) the variance that each step adds.

    act, u, c are (1 or T, S*A), h (1 or T, S), k (1 or T + 1, S): the first axis is time where it is longer than 1. Pays
    are (pay - shift_t) * scale_t.
    """
    indptr, indices, prob, w, act, u, by_move, pay, initial, gamma = walk
    shift, scale, c, h, k = extras
    n_states = len(initial)
    mean, var, local = np.empty(n_states), np.empty(n_states), np.empty((steps if keep else 1, n_states))
    n_actions = act.shape[1] // n_states
    next_mean, next_var = np.zeros(n_states), np.zeros(n_states)
    inner = np.empty(n_actions)
    for left in range(steps):
        t = steps - 1 - left
        ta, tc = (t if act.shape[0] > 1 else 0), (t if c.shape[0] > 1 else 0)
        th, tk = (t if h.shape[0] > 1 else 0), (t + 1 if k.shape[0] > 1 else 0)
        end = left == 0  # after the last step nothing follows, and there is no baseline
        for s in range(n_states):
            total, carry = 0.0, 0.0
            for a in range(n_actions):
                row = s * n_actions + a
                share = act[ta, row]
                if share == 0.0:
                    inner[a] = 0.0
                    continue
                f = u[ta, row]
                moved, spread = 0.0, 0.0
                for x in range(indptr[row], indptr[row + 1]):
                    j = indices[x]
                    y = 0.0 if end else gamma * (next_mean[j] - k[tk, j])
                    if by_move:
                        y += (pay[x] - shift[t]) * scale[t]
                    moved += prob[x] * w[x] * y
                    spread += prob[x] * w[x] * w[x] * next_var[j]
                inner[a] = c[tc, row] + (0.0 if by_move else (pay[row] - shift[t]) * scale[t])
                total += share * f * (inner[a] + moved)
                carry += share * f * f * gamma * gamma * spread
            own = 0.0
            for a in range(n_actions):
                row = s * n_actions + a
                share = act[ta, row]
                if share == 0.0:
                    continue
                f = u[ta, row]
                for x in range(indptr[row], indptr[row + 1]):
                    j = indices[x]
                    y = 0.0 if end else gamma * (next_mean[j] - k[tk, j])
                    if by_move:
                        y += (pay[x] - shift[t]) * scale[t]
                    off = f * (inner[a] + w[x] * y) - total
                    own += share * prob[x] * off * off
            mean[s] = h[th, s] + total
            var[s] = carry + own
            if keep:
                local[t, s] = own
        next_mean[:] = mean
        next_var[:] = var
    return mean, var, local


@njit(cache=True, error_model="numpy")
def trajectory(walk, steps, keep):
    """(5, S): E L, E LR, Var L, Cov(L, LR), Var LR; and if ``keep``, (T, 3, S) each step's share of the last three.

    For rewards r(s, a) the last move's w is left out: T rewards, T - 1 moves.
    """
    indptr, indices, prob, w, act, u, by_move, pay, initial, gamma = walk
    n_states = len(initial)
    n_actions = act.shape[1] // n_states
    out, local = np.empty((5, n_states)), np.empty((steps if keep else 1, 3, n_states))
    after = np.zeros((5, n_states))
    after[0] = 1.0
    for left in range(steps):
        t = steps - 1 - left
        ta = t if act.shape[0] > 1 else 0
        plain = left == 0 and not by_move
        for s in range(n_states):
            mean_l, mean_lr, var_l, cov, var_lr = 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(n_actions):
                row = s * n_actions + a
                share = act[ta, row]
                if share == 0.0:
                    continue
                for x in range(indptr[row], indptr[row + 1]):
                    j = indices[x]
                    f = u[ta, row] * (1.0 if plain else w[x])
                    r = pay[x] if by_move else pay[row]
                    chance = share * prob[x]
                    mean_l += chance * f * after[0, j]
                    mean_lr += chance * f * (r * after[0, j] + gamma * after[1, j])
                    square = chance * f * f
                    var_l += square * after[2, j]
                    cov += square * (r * after[2, j] + gamma * after[3, j])
                    var_lr += square * (
                        r * r * after[2, j] + 2.0 * r * gamma * after[3, j] + gamma * gamma * after[4, j]
                    )
            own_l, own_cov, own_lr = 0.0, 0.0, 0.0
            for a in range(n_actions):
                row = s * n_actions + a
                share = act[ta, row]
                if share == 0.0:
                    continue
                for x in range(indptr[row], indptr[row + 1]):
                    j = indices[x]
                    f = u[ta, row] * (1.0 if plain else w[x])
                    r = pay[x] if by_move else pay[row]
                    off_l = f * after[0, j] - mean_l
                    off_lr = f * (r * after[0, j] + gamma * after[1, j]) - mean_lr
                    chance = share * prob[x]
                    own_l += chance * off_l * off_l
                    own_cov += chance * off_l * off_lr
                    own_lr += chance * off_lr * off_lr
            out[0, s], out[1, s] = mean_l, mean_lr
            out[2, s], out[3, s], out[4, s] = var_l + own_l, cov + own_cov, var_lr + own_lr
            if keep:
                local[t, 0, s], local[t, 1, s], local[t, 2, s] = own_l, own_cov, own_lr
        after[:] = out
    return out, local


@njit(cache=True, error_model="numpy")
def forward(walk, steps, power, returns):
    """(T + 1, 3, S): E[W^p G^i 1{s_t = s}] for i = 0, 1, 2, p = ``power``, G the discounted return before t.

    W holds the factors of the steps before t. Without ``returns`` i = 1, 2 stay at 0.
    """
    indptr, indices, prob, w, act, u, by_move, pay, initial, gamma = walk
    n_states = len(initial)
    out = np.zeros((steps + 1, 3, n_states))
    n_actions = act.shape[1] // n_states
    out[0, 0] = initial
    factor = 1.0
    for t in range(steps):
        ta = t if act.shape[0] > 1 else 0
        for s in range(n_states):
            b0, b1, b2 = out[t, 0, s], out[t, 1, s], out[t, 2, s]
            if b0 == 0.0:
                continue
            for a in range(n_actions):
                row = s * n_actions + a
                share = act[ta, row]
                if share == 0.0:
                    continue
                for x in range(indptr[row], indptr[row + 1]):
                    j = indices[x]
                    f = u[ta, row] * w[x]
                    chance = share * prob[x] * (f if power == 1 else f * f)
                    out[t + 1, 0, j] += chance * b0
                    if returns:
                        r = factor * (pay[x] if by_move else pay[row])
                        out[t + 1, 1, j] += chance * (b1 + r * b0)
                        out[t + 1, 2, j] += chance * (b2 + 2.0 * r * b1 + r * r * b0)
        factor *= gamma
    return out
