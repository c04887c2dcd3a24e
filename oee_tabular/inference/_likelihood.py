"""Compiled parts of the likelihood interval: one ascent on the rows of a policy.

The rows are a ``likelihood.PolicyRows``. Row r of state state[r] has the entries
indptr[r] .. indptr[r+1]; entry i leads to column[i], pays pay[i], has weight[i] = pi(a
| s), and edge[i] is the place of (state, column) among the edges of the graph of
states. With u_i = tau v_i / n_r, v centred so that sum phat v = 0, the rows that are
best for v are

    P_i = phat_i / (1 + e_r - u_i),   e_r: sum_i P_i = 1,
    KL_r = sum_i phat_i log(1 + e_r - u_i).
"""

from math import log1p

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.inference.robust import greedy_row

# The numbers of an ascent are a record, whose fields are attributes without numba too:
# ``value`` is J of its rows, ``reference`` J of the frequencies, and ``change`` the
# change of J in the last step.
NAMES = (
    "sign limit reference settled value step tau change divergence slack quiet"
    " iterations reached"
)
NUMBERS = np.dtype((np.record, [(name, "f8") for name in NAMES.split()]))
MAX_ITERATIONS = 200  # ten are usual
# iterations in a row that move the end by less than a share ``settled`` of its distance
# from ``reference``, after which the ascent ends
MAX_QUIET_ITERATIONS = 4
LIMIT_TOLERANCE = 1e-8  # of the limit: how closely it is met in the end
# of the last iteration's change: how far off J of an iteration may be
VALUE_TOLERANCE = 1e-3
# factor of the step after one that was no worse; a step that doubles is refused every
# other time
STEP_GROWTH = 1.2
MIN_STEP = 1e-3  # smaller steps are taken even where J falls
ROUNDING = 1e-14  # of the values: a smaller difference of two of them is none
TINY = 1e-300


@njit(cache=True, error_model="numpy")
def ascend(rows, ascent):
    """Propose rows, evaluate them, and accept or refuse them until the end stays.

    P_k = P(x_k),   x_{k+1} = x_k + a (G_k - x_k),   G_k the gradient of J at P_k.
    """
    is_over = False
    while not is_over:
        propose(rows, ascent)
        value = fill_values(
            rows, ascent.trial, ascent.values, ascent.visits, ascent.slope
        )
        is_over = accept(ascent, value)


@njit(cache=True, error_model="numpy")
def propose(rows, ascent):
    """Fill ``trial`` with the rows P(x) that are best for x.

    P_i = phat_i / (1 + e_r - u_i),   sum n KL = limit.

    The limit is met as closely as the last step was long.
    """
    s = ascent.numbers[0]
    width = abs(s.value - s.reference) + TINY
    s.slack = VALUE_TOLERANCE * min(s.change, width)
    ascent.trial[:] = ascent.p
    share = s.step if rows.n_steps > 0 else 1.0
    room = min(max(s.slack / width, LIMIT_TOLERANCE), 1e-3)
    s.tau, s.reached = best_rows(
        rows, ascent.x, share, s.limit, room, s.tau, ascent.trial
    )


@njit(cache=True, error_model="numpy")
def accept(ascent, value):
    """Take the trial rows, or halve the step, and return whether that was the last.

    x_{k+1} = x_k + a (G_k - x_k),   a halved where J is worse, else a -> min(1, 1.2 a).

    ``value`` is J of the trial rows, and ``slope`` the gradient of J there.
    """
    s = ascent.numbers[0]
    gain = s.sign * (value - s.value)
    is_first = s.iterations == 0
    is_last = s.iterations >= MAX_ITERATIONS - 1
    is_worse = (
        gain < -max(2.0 * s.slack, 1e-12 * max(1.0, abs(s.value)))
        and s.step >= MIN_STEP
        and not is_first
    )
    s.iterations += 1
    if is_worse:
        s.step *= 0.5
    else:
        # An ascent ends where J has hardly changed for some iterations, or in one in
        # which the rows have not changed either.
        s.change = s.change if is_first else abs(gain)
        is_still = abs(gain) <= s.settled * abs(value - s.reference) + 1e-14 * abs(
            s.reference
        )
        s.quiet = s.quiet + 1 if is_still else 0
        is_last = (
            is_last
            or s.quiet >= MAX_QUIET_ITERATIONS
            or (is_still and np.abs(ascent.trial - ascent.p).max() <= 1e-9)
        )
        # Drawn directions get the gradient's size, so that the two can be mixed.
        if is_first:
            ascent.x[:] *= np.abs(ascent.slope).sum() / max(
                np.abs(ascent.x).sum(), TINY
            )
        s.value, s.divergence, s.step = value, s.reached, min(1.0, STEP_GROWTH * s.step)
        ascent.p[:], ascent.last_x[:], ascent.gradient[:] = (
            ascent.trial,
            ascent.x,
            s.sign * ascent.slope,
        )
    ascent.x[:] = ascent.last_x + s.step * (ascent.gradient - ascent.last_x)
    return is_last


@njit(cache=True, error_model="numpy")
def fill_values(rows, p, values, visits, gradient):
    """Return J, and fill V, d and the gradient of J: few states, or a horizon.

    (I - gamma P_pi) V = r_pi,   (I - gamma P_pi)' d = mu,   J = mu V.
    """
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
    """Fill the gradient of J, centred in each row: the mean does not matter there.

    G_i = d(s) pi(a | s) (r + gamma V(s')) less its mean under phat.

    In rows without data it is r + gamma V alone, which does not vanish where the rows
    are never reached.
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
    """Fill V, d and the gradient of J with a horizon.

    V_t = r_pi + gamma P_pi V_{t+1},   d = sum_t gamma^t alpha_t,
    dJ / dP_i = pi sum_t gamma^t alpha_t (pay_i + gamma V_{t+1}).
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
    # V_t, from the last step backwards
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
    # ``now`` is gamma^t alpha_t; ``worth`` sums what each edge's probability adds to J
    for t in range(rows.n_steps):
        for s in range(n):
            if now[s] != 0.0:
                visits[s] += now[s]
                for j in range(rows.edges[s], rows.edges[s + 1]):
                    worth[j] += gamma * now[s] * to_go[t + 1, rows.columns[j]]
                    ahead[rows.columns[j]] += gamma * now[s] * share[j]
                now[s] = 0.0
        now, ahead = ahead, now
    # the gradient; where it says nothing of a row without data, r + gamma V does
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
    """Write the rows that are best for ``x`` over those in p; return tau and sum n KL.

    max sum x P   subject to   sum_r n_r KL_r <= limit:
    P_i = phat_i / (1 + e_r - u_i),   u_i = tau v_i / n_r.

    The limit is met to a share ``room``, from inside; ``tau`` is a guess, or 0. Of mass
    that goes all to one next state (rows without data, and states that the log never
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
    # Rows without data take the best next states. The others get v centred, its spread,
    # its best entry, and its variance, which begins the search for tau.
    for r in range(n_rows):
        start = rows.indptr[r]
        stop = rows.indptr[r + 1]
        n = rows.n[r]
        if n == 0.0:
            greedy_row(v, rows.low, rows.high, start, stop, new)
            continue
        # The second pass removes rounding, which is all there is where v hardly varies.
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
        # A guess that is far off would lose all u in rounding, or leave no rounding.
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
    """Return tau with sum n KL at the limit, from inside, and this sum.

    log tau -> log tau + log(limit / KL) KL / (d KL / d log tau): Newton in logarithms.

    Steps that leave the bracket, or that no derivative guides, become bisections, and
    doublings while there is no bracket.
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
    """Write P of the rows that move; return sum n KL and its derivative in log tau.

    P_i = phat_i / (1 + e_r - u_i),   u_i = tau v_i / n_r,
    KL_r = sum_i phat_i log(1 + e_r - u_i).

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
        # Here v is 0 at all observed next states, as where there is only one.
        if curvature[r] == 0.0 and excess <= 0.0:
            p[start:stop] = phat[start:stop]
            continue
        e = find_root(start, stop, phat, v, slope, tau * tau * curvature[r])
        if e > 0.0:
            curvature[r] = e / (tau * tau)
        is_new = phat[top] == 0.0 and excess > e
        if is_new:
            e = excess
        # Sums over the observed next states: KL, mass, and what the derivative of KL in
        # log tau needs.
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
    """Return e with sum phat / (1 + e - u) = 1, from an e near by.

    e -> e + (1 + s) s / q,   s = sum phat / (1 + e - u) - 1,
    q = sum phat / (1 + e - u)^2: Newton's step for 1 / (1 + s), which is concave in e,
    so that the steps end below the root.
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
                # no p is above 1; 1 + e - u loses that in rounding where u is huge
                x = max(e - slope * v[i], phat[i] - 1.0)
                share = phat[i] / (1.0 + x)
                excess -= share * x
                square += share / (1.0 + x)
                least = min(least, 1.0 + x)
        step = (1.0 + excess) * excess / square
        e = max(e + step, low)
        # After a Newton step the error is of the size of its square / least.
        if not abs(step) > max(1e-15 * e, 1e-9 * least * min(e, 1.0), 1e-17):
            break
    return e


@njit(cache=True, error_model="numpy")
def blend(rows, share, new, p):
    """Write ``new`` into p; of mass that goes all to one state, only ``share`` moves.

    P_i = share new_i + (1 - share) (mass / mass before) P_i.
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
