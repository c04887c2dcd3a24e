"""Compiled parts of the profile likelihood interval, on the rows that a policy takes.

State s has the rows first[s] .. first[s+1], row r the entries indptr[r] .. indptr[r+1]; entry i leads to column[i] with
probability p[i] and pays pay[i], those that the log has seen (all, in rows without data) coming before seen[r]; weight[r] is
pi(a | s).

    V(s)    = sum_r weight_r sum_i p_i (pay_i + gamma V(column_i))            d(s') = mu(s') + gamma sum_s d(s) P_pi(s, s')
    P_i     = phat_i / (1 + e_r - u_i),  u_i = tau scale_r (v_i - sum phat v)  e_r: sum_i P_i = 1
    KL_r    = sum_i phat_i log(1 + e_r - u_i)
"""

from math import log1p

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def kernel_of(chain, p):
    """P_pi as CSR without its zeros, and r_pi."""
    n = len(chain.initial)
    indptr, column, value = np.zeros(n + 1, np.uint32), np.empty(len(p), np.uint32), np.empty(len(p))
    paid, sums, mark, kept = np.zeros(n), np.zeros(n), np.full(n, -1, np.int64), 0
    for s in range(n):
        begin = kept
        for r in range(chain.first[s], chain.first[s + 1]):
            for i in range(chain.indptr[r], chain.indptr[r + 1]):
                if p[i] > 0.0:
                    j, share = chain.column[i], chain.weight[r] * p[i]
                    if mark[j] != s:
                        mark[j], sums[j], column[kept] = s, 0.0, j
                        kept += 1
                    sums[j] += share
                    paid[s] += share * chain.pay[i]
        for k in range(begin, kept):
            value[k] = sums[column[k]]
        indptr[s + 1] = kept
    return indptr, column[:kept], value[:kept], paid


@njit(cache=True, error_model="numpy")
def flows(graph, share, paid, initial, gamma, to_go, visits, worth):
    """V_t into ``to_go`` (T + 1, S), d = sum_t gamma^t alpha_t into ``visits``; of each edge, gamma sum_t gamma^t alpha_t(s)
    V_{t+1}(s') into ``worth``. ``share`` is P_pi on the graph's edges, ``paid`` r_pi.
    """
    steps, n = len(to_go) - 1, len(initial)
    for s in range(n):
        to_go[steps, s], visits[s] = 0.0, 0.0
    for t in range(steps - 1, -1, -1):
        for s in range(n):
            total = 0.0
            for k in range(graph.indptr[s], graph.indptr[s + 1]):
                total += share[k] * to_go[t + 1, graph.column[k]]
            to_go[t, s] = paid[s] + gamma * total
    now, ahead = initial.copy(), np.zeros(n)
    for k in range(len(worth)):
        worth[k] = 0.0
    for t in range(steps):
        for s in range(n):
            if now[s] != 0.0:
                visits[s] += now[s]
                weight = gamma * now[s]
                for k in range(graph.indptr[s], graph.indptr[s + 1]):
                    j = graph.column[k]
                    worth[k] += weight * to_go[t + 1, j]
                    ahead[j] += weight * share[k]
                now[s] = 0.0
        now, ahead = ahead, now


@njit(cache=True, error_model="numpy")
def moments_of_rows(indptr, phat, v, mean, best, spread):
    """Of v under phat in each row: the mean and the variance; the first of the largest v, and the range of v."""
    variance = np.zeros(len(mean))
    for r in range(len(mean)):
        start, stop = indptr[r], indptr[r + 1]
        total, top, least, largest = 0.0, start, np.inf, -np.inf
        for i in range(start, stop):
            total += phat[i] * v[i]
            least = min(least, v[i])
            if v[i] > largest:
                top, largest = i, v[i]
        mean[r], best[r], spread[r] = total, top, largest - least
        for i in range(start, stop):
            away = v[i] - total
            variance[r] += phat[i] * (away * away)
    return variance


@njit(cache=True, error_model="numpy")
def root(start, stop, phat, v, mean, slope, e):
    """e with sum phat / (1 + e - u) = 1, from one near by: 1 / sum is concave in e, so that Newton's steps end below it."""
    low = 0.0
    for i in range(start, stop):
        low = max(low, slope * (v[i] - mean) + phat[i] - 1.0)
    e = max(e, low)
    for _ in range(100):
        excess, square, least = 0.0, 0.0, 1.0
        for i in range(start, stop):
            x = max(e - slope * (v[i] - mean), phat[i] - 1.0)  # no p is above 1, which 1 + e - u loses where u is huge
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
def fill(tau, rows, scale, chain, v, mean, best, bent, p):
    """P of ``rows`` into p, where entries never seen are 0 already; sum n KL, and its derivative in log tau.

    ``bent`` is e / tau^2, by which e of one tau is near that of the next; for a small tau the variance of scale v.
    Mass goes to a next state that was never seen where its u is at least 1 + e: then 1 + e = u there, and it gets what the
    others leave.
    """
    total, growth = 0.0, 0.0
    phat = chain.phat
    for r in rows:
        start, stop, slope, top = chain.indptr[r], chain.seen[r], tau * scale[r], best[r]
        unseen = top >= stop
        if stop == start + 1 and not slope * (v[top] - mean[r]) > 1.0:  # the only one that was seen keeps all
            p[start] = 1.0
            if unseen:
                p[top] = 0.0
            continue
        e = 0.0
        if stop > start + 1:
            e = root(start, stop, phat, v, mean[r], slope, tau * tau * bent[r])
            bent[r] = e / (tau * tau)
        if unseen:
            p[top] = 0.0
            unseen = slope * (v[top] - mean[r]) - 1.0 > e
            if unseen:
                e = slope * (v[top] - mean[r]) - 1.0
        kl, mass, along, square, across = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(start, stop):
            u = slope * (v[i] - mean[r])
            x = max(e - u, phat[i] - 1.0)
            p[i] = phat[i] / (1.0 + x)
            kl += phat[i] * log1p(x)
            mass += p[i]
            along += p[i] * u
            square += p[i] / (1.0 + x)
            across += p[i] / (1.0 + x) * u
        if unseen:
            p[top] = max(1.0 - mass, 0.0)
            growth += chain.n[r]
        else:
            growth += chain.n[r] * (across / square - along)
        total += chain.n[r] * kl
    return total, growth


@njit(cache=True, error_model="numpy")
def greedy(rows, chain, low, high, v, p):
    """Rows without data: what ``low`` leaves goes to the largest v up to ``high``, then to the next."""
    for r in rows:
        start, stop = chain.indptr[r], chain.indptr[r + 1]
        rest = 1.0
        for i in range(start, stop):
            p[i] = low[i]
            rest -= low[i]
        while rest > 0.0:
            best = -1
            for i in range(start, stop):
                if p[i] < high[i] and (best < 0 or v[i] > v[best]):
                    best = i
            if best < 0:
                break
            room = high[best] - p[best]
            p[best] = high[best] if room <= rest else p[best] + rest
            rest -= room


@njit(cache=True, error_model="numpy")
def blend(chain, before, share, p):
    """Of what goes all to one next state (rows without data, mass on states never seen) only ``share``; the rest as before."""
    for r in range(len(chain.n)):
        start, stop = chain.indptr[r], chain.indptr[r + 1]
        if chain.n[r] > 0.0:
            start = chain.seen[r]
        mass, had = 0.0, 0.0
        for i in range(start, stop):
            mass += p[i]
            had += before[i]
        if mass > 0.0 and had > 0.0:
            for i in range(start, stop):
                p[i] = share * p[i] + (1.0 - share) * before[i] * (mass / had)
