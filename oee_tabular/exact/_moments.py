"""Means and covariances of weighted returns, backward in time; weights and returns so far, forward.

Actions are drawn from ``act`` and transitions from ``prob``; a step multiplies the weight by
f = u(s, a) w(s, a, s'). Every X is the second part of a pair (L, X) that a matrix carries back by a step:

    L_t = l L_{t+1},   X_t = e L_{t+1} + f (gamma_t X_{t+1} - k_t(s'))
    per decision   l = 1, L = 1,   e = u r(s, a)  or  f r(s, a, s')
    trajectory     l = f, L = W,   e = f r:  X = W G

    means m = E[A m'],   covariances C = E[A C' A^T] + Cov(A m' | s)

(law of total variance: every term is a variance or a positive multiple of one; E X^2 - (E X)^2 would lose digits). Per decision
under a policy and rewards that do not depend on time ``_strips`` has the same, 6 to 10 times as fast.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def backward(walk, discounts, offsets, is_trajectory, keep):
    """(5, S): E L, E X, Var L, Cov(L, X), Var X of the first step; each step's own Cov(A m' | s) if ``keep``.

    The latter is (T, 1, S), of X alone, or for a trajectory (T, 3, S): Var L, Cov(L, X), Var X. ``discounts`` (T,) are gamma_t,
    ``offsets`` (1 or T, S) k_t. A trajectory with rewards r(s, a) leaves the last w out: T rewards, T - 1 transitions.
    """
    indptr, indices, prob, w, act, u, by_transition, rewards, initial, _ = walk
    horizon, n_states = len(discounts), len(initial)
    n_actions = act.shape[1] // n_states
    here, ahead = np.zeros((5, n_states)), np.zeros((5, n_states))
    here[0], ahead[0] = 1.0, 1.0
    local = np.empty((horizon if keep else 0, 3 if is_trajectory else 1, n_states))
    for t in range(horizon - 1, -1, -1):
        t_act, t_reward = (t if len(act) > 1 else 0), (t if len(rewards) > 1 else 0)
        gamma, offset = discounts[t], offsets[t if len(offsets) > 1 else 0]
        omit_w = is_trajectory and not by_transition and t == horizon - 1
        for s in range(n_states):
            mean_l, mean_x, var_l, cov, var_x = 0.0, 0.0, 0.0, 0.0, 0.0
            own_l, own_cov, own_x, length = 0.0, 0.0, 0.0, 0.0
            for is_spread in range(2):  # means and what is carried, then the spread around these means
                for row in range(s * n_actions, (s + 1) * n_actions):
                    share, factor = act[t_act, row], u[t_act, row]
                    if share == 0.0:
                        continue
                    reward = 0.0 if by_transition else rewards[t_reward, row]
                    for k in range(indptr[row], indptr[row + 1]):
                        j, chance = indices[k], share * prob[k]
                        f = factor if omit_w else factor * w[k]
                        if by_transition:
                            reward = rewards[t_reward, k]
                        if is_trajectory:
                            length = f * ahead[0, j]
                            x = f * (reward * ahead[0, j] + gamma * ahead[1, j])
                        else:
                            x = (f if by_transition else factor) * reward + f * (gamma * ahead[1, j] - offset[j])
                        if is_spread:
                            own_x += chance * (x - mean_x) * (x - mean_x)
                            if is_trajectory:
                                own_l += chance * (length - mean_l) * (length - mean_l)
                                own_cov += chance * (length - mean_l) * (x - mean_x)
                            continue
                        mean_x += chance * x
                        square = chance * f * f
                        var_x += square * gamma * gamma * ahead[4, j]
                        if is_trajectory:
                            mean_l += chance * length
                            var_l += square * ahead[2, j]
                            cov += square * (reward * ahead[2, j] + gamma * ahead[3, j])
                            var_x += square * reward * (reward * ahead[2, j] + 2.0 * gamma * ahead[3, j])
            here[1, s], here[4, s] = mean_x, var_x + own_x
            if is_trajectory:
                here[0, s], here[2, s], here[3, s] = mean_l, var_l + own_l, cov + own_cov
            if keep:
                local[t, -1, s] = own_x
                if is_trajectory:
                    local[t, 0, s], local[t, 1, s] = own_l, own_cov
        here, ahead = ahead, here
    return ahead, local


@njit(cache=True, error_model="numpy")
def forward(walk, horizon, power, with_returns):
    """(T + 1, 3 or 1, S): E[W^p G^i 1{s_t = s}], p = ``power``, i = 0, 1, 2, G the discounted return before t.

    W holds the factors of the steps before t. Without ``with_returns`` only i = 0 is there.
    """
    indptr, indices, prob, w, act, u, by_transition, rewards, initial, gamma = walk
    n_states = len(initial)
    out = np.zeros((horizon + 1, 3 if with_returns else 1, n_states))
    n_actions = act.shape[1] // n_states
    out[0, 0] = initial
    discount = 1.0
    for t in range(horizon):
        t_act = t if len(act) > 1 else 0
        for s in range(n_states):
            if out[t, 0, s] == 0.0:
                continue
            for row in range(s * n_actions, (s + 1) * n_actions):
                share = act[t_act, row]
                if share == 0.0:
                    continue
                for k in range(indptr[row], indptr[row + 1]):
                    j, f = indices[k], u[t_act, row] * w[k]
                    chance = share * prob[k] * (f if power == 1 else f * f)
                    out[t + 1, 0, j] += chance * out[t, 0, s]
                    if with_returns:
                        r = discount * (rewards[0, k] if by_transition else rewards[0, row])
                        before, before_2 = out[t, 0, s], out[t, 1, s]
                        out[t + 1, 1, j] += chance * (before_2 + r * before)
                        out[t + 1, 2, j] += chance * (out[t, 2, s] + 2.0 * r * before_2 + r * r * before)
        discount *= gamma
    return out
