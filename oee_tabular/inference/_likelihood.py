"""Compiled loops of the likelihood interval: the rows that are best for a direction.

Row r has the entries indptr[r] .. indptr[r+1]. With u_i = tau v_i / n_r, v centred so
that sum phat v = 0, the rows that are best for v are

    P_i = phat_i / (1 + e_r - u_i),   e_r: sum_i P_i = 1,
    KL_r = sum_i phat_i log(1 + e_r - u_i).
"""

from math import exp, log, log1p, sqrt

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.inference.robust import greedy_row

# a spread of v / n that is a smaller share of the largest one does not move a row
MIN_SPREAD = 1e-14
ROUNDING = 1e-14  # of the values: a smaller difference of two of them is none


@njit(cache=True, error_model="numpy")
def fill_best_rows(
    indptr,
    phat,
    n,
    low,
    high,
    order,
    x,
    limit,
    room,
    tau,
    v,
    best,
    spread,
    curvature,
    p,
):
    """Write the rows that are best for ``x`` into p; return tau and sum n KL.

    max sum x P   subject to   sum_r n_r KL_r <= limit:
    P_i = phat_i / (1 + e_r - u_i),   u_i = tau v_i / n_r.

    The limit is met to a share ``room``, from inside; ``tau`` is a guess, or 0. Rows
    without data take the best next states, in their ``order`` by x; without an order
    each takes the best one alone. ``v`` (entries,),
    ``best``, ``spread`` and ``curvature`` (rows,) are room for x centred, its best
    entry, its spread, and its variance, which begins the search for tau.
    """
    total = 0.0
    size = 0.0
    for r in range(len(n)):
        start = indptr[r]
        stop = indptr[r + 1]
        spread[r] = 0.0
        if n[r] == 0.0:
            if len(order):
                greedy_row(order, low, high, start, stop, p)
                continue
            top = start
            for i in range(start, stop):
                p[i] = 0.0
                if x[i] > x[top]:
                    top = i
            p[top] = 1.0
            continue
        for i in range(start, stop):
            v[i] = x[i]
            p[i] = phat[i]
        # the second pass removes rounding, which is all there is where v hardly varies
        for _ in range(2):
            mean = 0.0
            for i in range(start, stop):
                mean += phat[i] * v[i]
            for i in range(start, stop):
                v[i] -= mean
        top = start
        least = np.inf
        variance = 0.0
        for i in range(start, stop):
            if v[i] > v[top]:
                top = i
            if v[i] < least:
                least = v[i]
            variance += phat[i] * (v[i] / n[r]) ** 2
        best[r] = top
        curvature[r] = variance
        spread[r] = (v[top] - least) / n[r]
        if spread[r] > size:
            size = spread[r]
        total += n[r] * variance
    if size == 0.0:
        return tau, 0.0
    second_order = 1.0 / size
    if total > 0.0:
        second_order = sqrt(2.0 * limit / total)
    # a guess that is far off would lose all u in rounding, or leave no rounding
    if not 1e-3 * second_order < tau < 1e3 * second_order:
        tau = second_order
    return meet_limit(
        tau,
        MIN_SPREAD * size,
        spread,
        indptr,
        phat,
        n,
        v,
        best,
        curvature,
        limit,
        room,
        p,
    )


@njit(cache=True, error_model="numpy")
def meet_limit(
    tau, least_spread, spread, indptr, phat, n, v, best, curvature, limit, room, p
):
    """Return tau with sum n KL at the limit, from inside, and this sum.

    log tau -> log tau + log(limit / KL) KL / (d KL / d log tau): Newton in logarithms.

    Steps that leave the bracket, or that no derivative guides, become bisections, and
    doublings while there is no bracket. Rows whose spread is at most ``least_spread``
    stay.
    """
    near = 0.0
    far = np.inf
    reached = 0.0
    for _ in range(200):
        reached, growth = tilt(
            tau, least_spread, spread, indptr, phat, n, v, best, curvature, p
        )
        if reached <= limit:
            near = tau
            if reached >= limit * (1.0 - room):
                return tau, reached
        else:
            far = tau
        trial = 0.0
        if reached > 0.0 and growth > 0.0 and reached < np.inf:
            trial = tau * exp(
                log(limit * (1.0 - 0.3 * room) / reached) * reached / growth
            )
        if not near < trial < far:
            if far == np.inf:
                trial = 2.0 * near
            elif near == 0.0:
                trial = 0.5 * far
            else:
                trial = sqrt(near * far)
        if far <= near * (1.0 + 1e-14) or trial == np.inf:
            break
        tau = trial
    reached, growth = tilt(
        near, least_spread, spread, indptr, phat, n, v, best, curvature, p
    )
    return near, reached


@njit(cache=True, error_model="numpy")
def tilt(tau, least_spread, spread, indptr, phat, n, v, best, curvature, p):
    """Write P of the rows that move; return sum n KL and its derivative in log tau.

    P_i = phat_i / (1 + e_r - u_i),   u_i = tau v_i / n_r,
    KL_r = sum_i phat_i log(1 + e_r - u_i).

    ``curvature`` is e / tau^2, by which e of one tau is near that of the next; for a
    small tau the variance of v / n. Mass goes to a next state that was never observed
    where its u is at least 1 + e: then 1 + e = u there, and it gets what is left.
    """
    total = 0.0
    growth = 0.0
    for r in range(len(n)):
        if not spread[r] > least_spread:
            continue
        start = indptr[r]
        stop = indptr[r + 1]
        slope = tau / n[r]
        top = best[r]
        excess = slope * v[top] - 1.0
        # here v is 0 at all observed next states, as where there is only one
        if curvature[r] == 0.0 and excess <= 0.0:
            for i in range(start, stop):
                p[i] = phat[i]
            continue
        e = find_root(start, stop, phat, v, slope, tau * tau * curvature[r])
        if e > 0.0:
            curvature[r] = e / (tau * tau)
        is_new = phat[top] == 0.0 and excess > e
        if is_new:
            e = excess
        # sums over the observed next states: KL, mass, and what the derivative of KL in
        # log tau needs
        kl = 0.0
        mass = 0.0
        along = 0.0
        square = 0.0
        across = 0.0
        for i in range(start, stop):
            if phat[i] > 0.0:
                u = slope * v[i]
                x = e - u
                if x < phat[i] - 1.0:
                    x = phat[i] - 1.0
                p[i] = phat[i] / (1.0 + x)
                kl += phat[i] * log1p(x)
                mass += p[i]
                along += p[i] * u
                square += p[i] / (1.0 + x)
                across += p[i] / (1.0 + x) * u
        if phat[top] == 0.0:
            p[top] = 0.0
            if is_new and mass < 1.0:
                p[top] = 1.0 - mass
        if is_new:
            growth += n[r]
        else:
            growth += n[r] * (across / square - along)
        total += n[r] * kl
    return total, growth


@njit(cache=True, error_model="numpy")
def find_root(start, stop, phat, v, slope, e):
    """Return e with sum phat / (1 + e - u) = 1, from an e near by.

    e -> e + (1 + s) s / q,   s = sum phat / (1 + e - u) - 1,
    q = sum phat / (1 + e - u)^2: Newton's step for 1 / (1 + s), which is concave in e,
    so that the steps end below the root.
    """
    low = 0.0
    for i in range(start, stop):
        if phat[i] > 0.0:
            bound = slope * v[i] + phat[i] - 1.0
            if bound > low:
                low = bound
    if e < low:
        e = low
    for _ in range(100):
        excess = 0.0
        square = 0.0
        least = 1.0
        for i in range(start, stop):
            if phat[i] > 0.0:
                # no p is above 1; 1 + e - u loses that in rounding where u is huge
                x = e - slope * v[i]
                if x < phat[i] - 1.0:
                    x = phat[i] - 1.0
                share = phat[i] / (1.0 + x)
                excess -= share * x
                square += share / (1.0 + x)
                if 1.0 + x < least:
                    least = 1.0 + x
        step = (1.0 + excess) * excess / square
        e += step
        if e < low:
            e = low
        # after a Newton step the error is of the size of its square / least
        enough = 1e-15 * e
        part = 1e-9 * least
        if e < 1.0:
            part *= e
        if part > enough:
            enough = part
        if not abs(step) > enough or not abs(step) > 1e-17:
            break
    return e


@njit(cache=True, error_model="numpy")
def fill_steps(edges, columns, share, paid, discount, to_go, now, ahead, visits, worth):
    """Fill the values of each number of steps, the visits, and each edge's worth.

    V_t = r_pi + gamma P_pi V_{t+1},   d = sum_t gamma^t alpha_t,
    worth = gamma sum_t gamma^t alpha_t(s) V_{t+1}(s'),

    alpha_t the distribution of the state in step t. ``edges`` and ``columns`` are the
    graph of states, ``share`` P_pi and ``paid`` r_pi on it. ``to_go`` (T + 1, S) has 0
    in its last row; ``now`` is alpha_0, ``ahead`` 0, and both are used up.
    """
    n = len(paid)
    n_steps = len(to_go) - 1
    for t in range(n_steps - 1, -1, -1):
        for s in range(n):
            total = 0.0
            for j in range(edges[s], edges[s + 1]):
                total += share[j] * to_go[t + 1, columns[j]]
            to_go[t, s] = paid[s] + discount * total
    for t in range(n_steps):
        for s in range(n):
            mass = now[s]
            if mass != 0.0:
                visits[s] += mass
                for j in range(edges[s], edges[s + 1]):
                    worth[j] += discount * mass * to_go[t + 1, columns[j]]
                    ahead[columns[j]] += discount * mass * share[j]
        for s in range(n):
            now[s] = ahead[s]
            ahead[s] = 0.0


@njit(cache=True, error_model="numpy")
def fill_gradient(
    indptr, state, column, weight, pay, phat, n, discount, values, visits, gradient
):
    """Write the gradient of J, centred in each row: the mean does not matter there.

    G_i = d(s) pi(a | s) (r + gamma V(s')) less its mean under phat.

    In rows without data it is r + gamma V alone, which does not vanish where the rows
    are never reached.
    """
    for r in range(len(n)):
        start = indptr[r]
        stop = indptr[r + 1]
        mean = 0.0
        size = 0.0
        for i in range(start, stop):
            ahead = pay[i] + discount * values[column[i]]
            gradient[i] = ahead
            mean += phat[i] * ahead
            if ahead > size:
                size = ahead
            elif -ahead > size:
                size = -ahead
        time = visits[state[start]]
        if time < 0.0:
            time = 0.0
        for i in range(start, stop):
            rest = gradient[i] - mean
            if abs(rest) <= ROUNDING * size:
                gradient[i] = 0.0
            elif n[r] > 0.0:
                gradient[i] = time * weight[i] * rest
            else:
                gradient[i] = rest
