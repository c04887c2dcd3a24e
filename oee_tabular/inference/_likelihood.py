"""Compiled parts of the likelihood interval: one ascent, on the rows that a policy
takes (``likelihood.PolicyRows``).

Row r of state state[r] has the entries indptr[r] .. indptr[r+1]; entry i leads to
column[i], pays pay[i], has weight[i] = pi(a | s), and edge[i] is the place of (state,
column) among the edges of the graph of states. With u_i = tau v_i / n_r, v centred so
that sum phat v = 0, the rows that are best for v are

    P_i = phat_i / (1 + e_r - u_i),   e_r: sum_i P_i = 1,   KL_r = sum_i phat_i log(1 + e_r - u_i).
"""

from math import log1p

import numpy as np
from numba import njit

from oee_tabular.inference.robust import greedy_row

# an ascent's numbers, as records: their fields are attributes without numba too;
# ``value`` is J of its rows and ``reference`` that of the frequencies, ``change`` the
# last step's
NAMES = (
    "sign limit reference settled value step tau change divergence slack quiet"
    " iterations reached"
)
NUMBERS = np.dtype((np.record, [(name, "f8") for name in NAMES.split()]))
N_ITERATIONS = 200  # at most; ten are usual
# iterations that move the end by less than a share ``settled`` of the way from
# ``reference`` are the last
N_QUIET = 4
EXACT = 1e-8  # of the limit: how closely it is met in the end
SOLVED = 1e-3  # of the last iteration's change: how far J of an iteration may be off
# of the step, after one that was no worse; doubling it is refused every other time
GROWTH = 1.2
LEAST_STEP = 1e-3  # from which on steps are taken as they are
ROUNDING = 1e-14  # of the values: a smaller difference of two of them is none
TINY = 1e-300


@njit(cache=True, error_model="numpy")
def ascend(rows, ascent):
    """Propose rows, evaluate and accept or refuse them until the end stays where it is."""
    is_over = False
    while not is_over:
        propose(rows, ascent)
        value = fill_values(
            rows, ascent.trial, ascent.values, ascent.visits, ascent.slope
        )
        is_over = accept(ascent, value)


@njit(cache=True, error_model="numpy")
def propose(rows, ascent):
    """Fill ``trial`` with the rows P(x) that are best for x, the limit met as closely
    as the last step was long.
    """
    s = ascent.numbers[0]
    width = abs(s.value - s.reference) + TINY
    s.slack = SOLVED * min(s.change, width)
    ascent.trial[:] = ascent.p
    share = s.step if rows.n_steps > 0 else 1.0
    room = min(max(s.slack / width, EXACT), 1e-3)
    s.tau, s.reached = best_rows(
        rows, ascent.x, share, s.limit, room, s.tau, ascent.trial
    )


@njit(cache=True, error_model="numpy")
def accept(ascent, value):
    """Take the trial rows, of this J and gradient ``slope``, or halve the step; set the
    next x. Whether that was the last.
    """
    s = ascent.numbers[0]
    gain = s.sign * (value - s.value)
    is_first = s.iterations == 0
    is_last = s.iterations >= N_ITERATIONS - 1
    is_worse = (
        gain < -max(2.0 * s.slack, 1e-12 * max(1.0, abs(s.value)))
        and s.step >= LEAST_STEP
        and not is_first
    )
    s.iterations += 1
    if is_worse:
        s.step *= 0.5
    else:
        s.change = s.change if is_first else abs(gain)
        is_still = abs(gain) <= s.settled * abs(value - s.reference) + 1e-14 * abs(
            s.reference
        )
        s.quiet = s.quiet + 1 if is_still else 0
        is_last = (
            is_last
            or s.quiet >= N_QUIET
            or (is_still and np.abs(ascent.trial - ascent.p).max() <= 1e-9)
        )
        # drawn directions get the gradient's size, so that they can be mixed
        if is_first:
            ascent.x[:] *= np.abs(ascent.slope).sum() / max(
                np.abs(ascent.x).sum(), TINY
            )
        s.value, s.divergence, s.step = value, s.reached, min(1.0, GROWTH * s.step)
        ascent.p[:], ascent.last_x[:], ascent.gradient[:] = (
            ascent.trial,
            ascent.x,
            s.sign * ascent.slope,
        )
    ascent.x[:] = ascent.last_x + s.step * (ascent.gradient - ascent.last_x)
    return is_last


@njit(cache=True, error_model="numpy")
def fill_values(rows, p, values, visits, gradient):
    """J, V, d and the gradient of J, of few states or with a horizon."""
    if rows.n_steps > 0:
        fill_values_of_steps(rows, p, values, visits, gradient)
    else:
        n = len(values)
        matrix = np.eye(n)
        paid = np.zeros(n)
        for i in range(len(p)):
            matrix[rows.state[i], rows.column[i]] -= (
                rows.discount * rows.weight[i] * p[i]
            )
            paid[rows.state[i]] += rows.weight[i] * p[i] * rows.pay[i]
        values[:] = np.linalg.solve(matrix, paid)
        visits[:] = np.linalg.solve(matrix.T.copy(), rows.initial)
        fill_gradient(rows, values, visits, gradient)
    return (rows.initial * values).sum()


@njit(cache=True, error_model="numpy")
def fill_gradient(rows, values, visits, gradient):
    """d(s) pi(a | s) (r + gamma V(s')) less its row's mean, which counts for nothing.

    In rows without data r + gamma V alone, which does not vanish where they are never
    reached.
    """
    for r in range(len(rows.n)):
        mean = 0.0
        weight = 1.0
        size = 0.0
        for i in range(rows.indptr[r], rows.indptr[r + 1]):
            gradient[i] = rows.pay[i] + rows.discount * values[rows.column[i]]
            mean += rows.phat[i] * gradient[i]
            size = max(size, abs(gradient[i]))
            if rows.n[r] > 0.0:
                weight = max(visits[rows.state[i]], 0.0) * rows.weight[i]
        for i in range(rows.indptr[r], rows.indptr[r + 1]):
            rest = gradient[i] - mean
            gradient[i] = weight * rest if abs(rest) > ROUNDING * size else 0.0


@njit(cache=True, error_model="numpy")
def fill_values_of_steps(rows, p, values, visits, gradient):
    """With a horizon T.

    V_t = r_pi + gamma P_pi V_{t+1},   d = sum_t gamma^t alpha_t,   dJ / dP_i = pi sum_t
    gamma^t alpha_t (pay_i + gamma V_{t+1})
    """
    n = len(rows.initial)
    gamma = rows.discount
    to_go = np.zeros((rows.n_steps + 1, n))
    worth = np.zeros(len(rows.columns))
    share = np.zeros(len(rows.columns))
    paid = np.zeros(n)
    for i in range(len(p)):
        share[rows.edge[i]] += rows.weight[i] * p[i]
        paid[rows.state[i]] += rows.weight[i] * p[i] * rows.pay[i]
    for t in range(rows.n_steps - 1, -1, -1):
        for s in range(n):
            total = 0.0
            for j in range(rows.edges[s], rows.edges[s + 1]):
                total += share[j] * to_go[t + 1, rows.columns[j]]
            to_go[t, s] = paid[s] + gamma * total
    values[:] = to_go[0]
    visits[:] = 0.0
    now = rows.initial.copy()
    ahead = np.zeros(n)
    for t in range(rows.n_steps):
        for s in range(n):
            if now[s] != 0.0:
                visits[s] += now[s]
                for j in range(rows.edges[s], rows.edges[s + 1]):
                    worth[j] += gamma * now[s] * to_go[t + 1, rows.columns[j]]
                    ahead[rows.columns[j]] += gamma * now[s] * share[j]
                now[s] = 0.0
        now, ahead = ahead, now
    for r in range(len(rows.n)):
        smallest = np.inf
        largest = -np.inf
        for i in range(rows.indptr[r], rows.indptr[r + 1]):
            gradient[i] = rows.weight[i] * (
                visits[rows.state[i]] * rows.pay[i] + worth[rows.edge[i]]
            )
            smallest = min(smallest, gradient[i])
            largest = max(largest, gradient[i])
        if rows.n[r] == 0.0 and smallest == largest:
            for i in range(rows.indptr[r], rows.indptr[r + 1]):
                gradient[i] = rows.pay[i] + gamma * values[rows.column[i]]


@njit(cache=True, error_model="numpy")
def best_rows(rows, x, share, limit, room, tau, p):
    """The rows that are best for ``x``, over those in ``p``: max sum x P subject to sum
    n KL <= limit; tau and that sum.

    The limit is met to a share ``room``, from inside; ``tau`` is a guess, or 0. Of mass
    that goes all to one next state (rows without data; states that the log never
    reached) only ``share`` moves.
    """
    n_rows = len(rows.n)
    spread = np.zeros(n_rows)
    curvature = np.zeros(n_rows)
    best = np.zeros(n_rows, np.int64)
    v = x.copy()
    new = rows.phat.copy()
    total = 0.0
    reached = 0.0
    for r in range(n_rows):
        start = rows.indptr[r]
        stop = rows.indptr[r + 1]
        n = rows.n[r]
        if n == 0.0:
            greedy_row(v, rows.low, rows.high, start, stop, new)
            continue
        # once more for the rounding, which is all where v hardly varies
        for _ in range(2):
            mean = 0.0
            for i in range(start, stop):
                mean += rows.phat[i] * v[i]
            for i in range(start, stop):
                v[i] -= mean
        best[r] = start
        least = np.inf
        for i in range(start, stop):
            best[r] = i if v[i] > v[best[r]] else best[r]
            least = min(least, v[i])
            curvature[r] += rows.phat[i] * (v[i] / n) ** 2
        spread[r] = (v[best[r]] - least) / n
        total += n * curvature[r]
    size = spread.max()
    if size > 0.0:
        moving = np.flatnonzero(spread > 1e-14 * size)
        second_order = np.sqrt(2.0 * limit / total) if total > 0.0 else 1.0 / size
        # a far guess has all its u in rounding, or none
        if not 1e-3 * second_order < tau < 1e3 * second_order:
            tau = second_order
        tau, reached = meet_limit(
            tau, moving, rows, v, best, curvature, limit, room, new
        )
    if share < 1.0:
        blend(rows, share, new, p)
    else:
        p[:] = new
    return tau, reached


@njit(cache=True, error_model="numpy")
def meet_limit(tau, moving, rows, v, best, curvature, limit, room, p):
    """tau with sum n KL at the limit, from inside, and the sum; Newton's steps in
    logarithms.

    Steps that leave the bracket, or find nothing to go by, become bisections (doublings
    while there is no bracket).
    """
    near = 0.0
    far = np.inf
    reached = 0.0
    for _ in range(200):
        reached, growth = tilt(tau, moving, rows, v, best, curvature, p)
        if reached <= limit:
            near = tau
            if reached >= limit * (1.0 - room):
                return tau, reached
        else:
            far = tau
        trial = 0.0
        if reached > 0.0 and growth > 0.0 and reached < np.inf:
            trial = tau * np.exp(
                np.log(limit * (1.0 - 0.3 * room) / reached) * reached / growth
            )
        if not near < trial < far:
            trial = (
                2.0 * near
                if far == np.inf
                else 0.5 * far
                if near == 0.0
                else np.sqrt(near * far)
            )
        if far <= near * (1.0 + 1e-14) or trial == np.inf:
            break
        tau = trial
    reached, _ = tilt(near, moving, rows, v, best, curvature, p)
    return near, reached


@njit(cache=True, error_model="numpy")
def tilt(tau, moving, rows, v, best, curvature, p):
    """P of the rows that move into p; sum n KL, and its derivative in log tau.

    ``curvature`` is e / tau^2, by which e of one tau is near that of the next; for a
    small tau the variance of v / n. Mass goes to a next state that was never observed
    where its u is at least 1 + e: then 1 + e = u there, and it gets what is left.
    """
    total = 0.0
    growth = 0.0
    phat = rows.phat
    for r in moving:
        start = rows.indptr[r]
        stop = rows.indptr[r + 1]
        slope = tau / rows.n[r]
        top = best[r]
        excess = slope * v[top] - 1.0
        # v is 0 at all that was observed, as where that is one next state
        if curvature[r] == 0.0 and excess <= 0.0:
            p[start:stop] = phat[start:stop]
            continue
        e = find_root(start, stop, phat, v, slope, tau * tau * curvature[r])
        if e > 0.0:
            curvature[r] = e / (tau * tau)
        is_new = phat[top] == 0.0 and excess > e
        if is_new:
            e = excess
        kl = 0.0
        mass = 0.0
        along = 0.0
        square = 0.0
        across = 0.0
        for i in range(start, stop):
            if phat[i] > 0.0:
                u = slope * v[i]
                x = max(e - u, phat[i] - 1.0)
                p[i] = phat[i] / (1.0 + x)
                kl += phat[i] * log1p(x)
                mass += p[i]
                along += p[i] * u
                square += p[i] / (1.0 + x)
                across += p[i] / (1.0 + x) * u
        if phat[top] == 0.0:
            p[top] = max(1.0 - mass, 0.0) if is_new else 0.0
        growth += rows.n[r] if is_new else rows.n[r] * (across / square - along)
        total += rows.n[r] * kl
    return total, growth


@njit(cache=True, error_model="numpy")
def find_root(start, stop, phat, v, slope, e):
    """e with sum phat / (1 + e - u) = 1, from one near by: 1 / sum is concave in e, so
    that Newton's steps end below it.
    """
    low = 0.0
    for i in range(start, stop):
        if phat[i] > 0.0:
            low = max(low, slope * v[i] + phat[i] - 1.0)
    e = max(e, low)
    for _ in range(100):
        excess = 0.0
        square = 0.0
        least = 1.0
        for i in range(start, stop):
            if phat[i] > 0.0:
                # no p is above 1, which 1 + e - u loses where u is huge
                x = max(e - slope * v[i], phat[i] - 1.0)
                share = phat[i] / (1.0 + x)
                excess -= share * x
                square += share / (1.0 + x)
                least = min(least, 1.0 + x)
        step = (1.0 + excess) * excess / square
        e = max(e + step, low)
        # what is left is as its square / least
        if not abs(step) > max(1e-15 * e, 1e-9 * least * min(e, 1.0), 1e-17):
            break
    return e


@njit(cache=True, error_model="numpy")
def blend(rows, share, new, p):
    """``new`` into ``p``; of mass that goes all to one next state only ``share``, the
    rest where it was.
    """
    for r in range(len(rows.n)):
        mass = 0.0
        had = 0.0
        for i in range(rows.indptr[r], rows.indptr[r + 1]):
            if rows.n[r] == 0.0 or rows.phat[i] == 0.0:
                mass += new[i]
                had += p[i]
        kept = (1.0 - share) * mass / had if mass > 0.0 and had > 0.0 else 0.0
        for i in range(rows.indptr[r], rows.indptr[r + 1]):
            if rows.n[r] == 0.0 or rows.phat[i] == 0.0:
                p[i] = (share if kept > 0.0 else 1.0) * new[i] + kept * p[i]
            else:
                p[i] = new[i]
