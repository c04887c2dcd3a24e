"""Compiled parts of the likelihood interval, on the rows that a policy takes.

State s has the rows first[s] .. first[s+1], row r the entries indptr[r] .. indptr[r+1]; entry i leads to column[i] and pays
pay[i]. Those that the log has (all, in rows without data) come before observed[r]. weight[i] is pi(a | s), edge[i] the place of
(state, column) among the edges of the graph of states. Arrays of probabilities have a line for each ascent.

    P_i  = phat_i / (1 + e_r - u_i),   u_i = tau v_i / n_r (sum phat v = 0),   e_r: sum_i P_i = 1
    KL_r = sum_i phat_i log(1 + e_r - u_i)
"""

from math import log1p

import numpy as np
from numba import njit

from oee_tabular.inference._robust import greedy_row


@njit(cache=True, error_model="numpy")
def evaluate_steps(rows, p, gamma, n_steps, values, visits, gradient):
    """With a horizon: V, d and the gradient of J, of each ascent.

    V_t = r_pi + gamma P_pi V_{t+1},   d = sum_t gamma^t alpha_t,   dJ / dP_i = pi sum_t gamma^t alpha_t (pay_i + gamma V_{t+1})
    """
    n = len(rows.initial)
    to_go, worth, share = np.empty((n_steps + 1, n)), np.empty(len(rows.columns)), np.empty(len(rows.columns))
    paid = np.empty(n)
    for k in range(len(p)):
        paid[:], share[:], worth[:], to_go[n_steps], visits[k] = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(rows.edge)):
            share[rows.edge[i]] += rows.weight[i] * p[k, i]
            paid[rows.state[i]] += rows.weight[i] * p[k, i] * rows.pay[i]
        for t in range(n_steps - 1, -1, -1):
            for s in range(n):
                total = 0.0
                for j in range(rows.edges[s], rows.edges[s + 1]):
                    total += share[j] * to_go[t + 1, rows.columns[j]]
                to_go[t, s] = paid[s] + gamma * total
        now, ahead = rows.initial.copy(), np.zeros(n)
        for t in range(n_steps):
            for s in range(n):
                if now[s] != 0.0:
                    visits[k, s] += now[s]
                    for j in range(rows.edges[s], rows.edges[s + 1]):
                        worth[j] += gamma * now[s] * to_go[t + 1, rows.columns[j]]
                        ahead[rows.columns[j]] += gamma * now[s] * share[j]
                    now[s] = 0.0
            now, ahead = ahead, now
        values[k] = to_go[0]
        for i in range(len(rows.edge)):
            gradient[k, i] = rows.weight[i] * (visits[k, rows.state[i]] * rows.pay[i] + worth[rows.edge[i]])


@njit(cache=True, error_model="numpy")
def best_rows(rows, low, high, x, share, limit, room, tau, p):
    """The rows that are best for each direction ``x``, over those in ``p``: max sum x P subject to sum n KL <= limit.

    The limit is met to a share ``room``, from inside. ``tau`` (of each ascent) holds guesses and gets the multipliers. Of mass
    that goes all to one next state (rows without data; states that the log never reached) only ``share`` moves.
    """
    n_rows = len(rows.n)
    spread, bent, best = np.zeros(n_rows), np.zeros(n_rows), np.empty(n_rows, np.int64)
    new, spare, reached = np.empty(p.shape[1]), np.empty(p.shape[1]), np.zeros(len(p))
    for k in range(len(p)):
        v, total = x[k].copy(), 0.0
        for r in range(n_rows):
            start, stop = rows.indptr[r], rows.indptr[r + 1]
            if rows.n[r] == 0.0:
                greedy_row(v, low, high, start, stop, new, spare)
                continue
            for _ in range(2):  # once more for the rounding, which is all where v hardly varies
                mean = 0.0
                for i in range(start, stop):
                    mean += rows.phat[i] * v[i]
                for i in range(start, stop):
                    v[i] -= mean
            best[r], bent[r], least = start, 0.0, np.inf
            for i in range(start, stop):
                best[r] = i if v[i] > v[best[r]] else best[r]
                least = min(least, v[i])
                bent[r] += rows.phat[i] * (v[i] / rows.n[r]) ** 2
                new[i] = rows.phat[i]
            spread[r] = (v[best[r]] - least) / rows.n[r]
            total += rows.n[r] * bent[r]
        size = spread.max()
        if size > 0.0:
            moves = spread > 1e-14 * size
            if tau[k] == 0.0:
                tau[k] = np.sqrt(2.0 * limit / total) if total > 0.0 else 1.0 / size
            tau[k], reached[k] = meet_limit(tau[k], moves, rows, v, best, bent, limit, room, new)
        blend(rows, share[k], new, p[k])
    return reached


@njit(cache=True, error_model="numpy")
def meet_limit(tau, moves, rows, v, best, bent, limit, room, p):
    """tau with sum n KL at the limit, from inside, and the sum; Newton's steps in logarithms.

    Steps that leave the bracket, or find nothing to go by, become bisections (doublings while there is no bracket).
    """
    near, far, reached = 0.0, np.inf, 0.0
    for _ in range(200):
        reached, growth = tilt(tau, moves, rows, v, best, bent, p)
        if reached <= limit:
            near = tau
            if reached >= limit * (1.0 - room):
                return tau, reached
        else:
            far = tau
        trial = 0.0
        if reached > 0.0 and growth > 0.0 and reached < np.inf:
            trial = tau * np.exp(np.log(limit * (1.0 - 0.3 * room) / reached) * reached / growth)
        if not near < trial < far:
            trial = 2.0 * near if far == np.inf else 0.5 * far if near == 0.0 else np.sqrt(near * far)
        if far <= near * (1.0 + 1e-14) or trial == np.inf:
            break
        tau = trial
    reached, _ = tilt(near, moves, rows, v, best, bent, p)
    return near, reached


@njit(cache=True, error_model="numpy")
def tilt(tau, moves, rows, v, best, bent, p):
    """P of the rows that move into p; sum n KL, and its derivative in log tau.

    ``bent`` is e / tau^2, by which e of one tau is near that of the next; for a small tau the variance of v / n. Mass goes to a
    next state that was never observed where its u is at least 1 + e: then 1 + e = u there, and it gets what the others leave.
    """
    total, growth = 0.0, 0.0
    phat = rows.phat
    for r in np.flatnonzero(moves):
        start, stop, slope, top = rows.indptr[r], rows.observed[r], tau / rows.n[r], best[r]
        e = find_root(start, stop, phat, v, slope, tau * tau * bent[r]) if stop > start + 1 else 0.0
        if stop > start + 1 and tau > 0.0:
            bent[r] = e / (tau * tau)
        excess = slope * v[top] - 1.0
        is_new = top >= stop and excess > e
        if is_new:
            e = excess
        kl, mass, along, square, across = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(start, stop):
            u = slope * v[i]
            x = max(e - u, phat[i] - 1.0)
            p[i] = phat[i] / (1.0 + x)
            kl += phat[i] * log1p(x)
            mass += p[i]
            along += p[i] * u
            square += p[i] / (1.0 + x)
            across += p[i] / (1.0 + x) * u
        if top >= stop:
            p[top] = max(1.0 - mass, 0.0) if is_new else 0.0
        growth += rows.n[r] if is_new else rows.n[r] * (across / square - along)
        total += rows.n[r] * kl
    return total, growth


@njit(cache=True, error_model="numpy")
def find_root(start, stop, phat, v, slope, e):
    """e with sum phat / (1 + e - u) = 1, from one near by: 1 / sum is concave in e, so that Newton's steps end below it."""
    low = 0.0
    for i in range(start, stop):
        low = max(low, slope * v[i] + phat[i] - 1.0)
    e = max(e, low)
    for _ in range(100):
        excess, square, least = 0.0, 0.0, 1.0
        for i in range(start, stop):
            x = max(e - slope * v[i], phat[i] - 1.0)  # no p is above 1, which 1 + e - u loses where u is huge
            share = phat[i] / (1.0 + x)
            excess -= share * x
            square += share / (1.0 + x)
            least = min(least, 1.0 + x)
        step = (1.0 + excess) * excess / square
        e = max(e + step, low)
        if not abs(step) > max(1e-15 * e, 1e-9 * least * min(e, 1.0), 1e-17):  # what is left is as its square / least
            break
    return e


@njit(cache=True, error_model="numpy")
def blend(rows, share, new, p):
    """``new`` into ``p``; of mass that goes all to one next state only ``share``, the rest where it was."""
    for r in range(len(rows.n)):
        start, stop = rows.indptr[r], rows.indptr[r + 1]
        middle = rows.observed[r] if rows.n[r] > 0.0 else start
        mass, had = 0.0, 0.0
        for i in range(middle, stop):
            mass += new[i]
            had += p[i]
        kept = (1.0 - share) * mass / had if mass > 0.0 and had > 0.0 else 0.0
        for i in range(start, middle):
            p[i] = new[i]
        for i in range(middle, stop):
            p[i] = (share if kept > 0.0 else 1.0) * new[i] + kept * p[i]
