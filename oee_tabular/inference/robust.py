"""Guaranteed extremes of J by robust policy evaluation, each row in its own set.

    U(s, a) = {P : KL(phat || P) <= epsilon(s, a),  low <= P <= high,  sum P = 1}
    V(s) = sum_a pi(a | s) max_{P in U(s, a)} sum_s' P(s') (r(s, a, s') + gamma V(s'))

with min in place of max for the lower end. The best rows for V, then V for these rows,
until the Bellman residual is rounding [3]. The row problems are solved with an upper
bound each, and what is left of the residual widens the interval. The radii hold for all
rows at once with the confidence asked for (a union over the rows).

A row's problem, maximise sum P v over U, has with multipliers lambda of the ball and
eta of the sum the solution P = clip(lambda phat / (eta - v), low, high), ``high`` where
eta <= v. For a given lambda the sum is nonincreasing in eta (one bracketed root; at a
jump the two ends are combined), and KL falls as lambda grows (another).

Before any log there is the box of Assumption V.1 alone, nu P <= P' <= mu P. With u(s')
= r(s, a, s') + gamma V-(s') the least value of the models within it is [3, 4]

    V-(s) = sum_a pi(a | s) [nu E_P u + (1 - nu) CVaR_tau(u)],

tau = (1 - nu) / (mu - nu), CVaR_tau the mean of u over its worst share tau under P:
each row keeps nu P and sends the remaining 1 - nu to the worst next states, (mu - nu) P
at most to each. The largest value V+ has the best share in place of the worst.

Sources: [1] R. Agrawal, Finite-sample concentration of the multinomial in relative
entropy, IEEE Trans. Information Theory 66, 2020. [2] A. Jonsson et al., Planning in
Markov decision processes with gap-dependent sample complexity, NeurIPS 2020. [3] G.
Iyengar, Robust dynamic programming, Mathematics of Operations Research 30, 2005; A.
Nilim and L. El Ghaoui, Robust control of Markov decision processes, Operations Research
53, 2005. [4] A. Bennett, N. Kallus, M. Oprescu, W. Sun and K. Wang, Efficient and sharp
off-policy evaluation in robust Markov decision processes, NeurIPS 2024, arXiv
2404.00099.
"""

from __future__ import annotations

from collections.abc import Callable
from math import frexp, inf, ldexp, log, log1p, sqrt
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from scipy import special

from oee_tabular import _checks
from oee_tabular._compiling import njit
from oee_tabular._parallel import dot
from oee_tabular.exact import (
    largest_reward,
    policy_system,
    reached_states,
    recurrent_states,
    values_or_zeros,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.evidence import Evidence
from oee_tabular.mdp import optional_horizon_length
from oee_tabular.typing import Array, BoolArray, IntArray

RadiusKind: TypeAlias = Literal["independent", "anytime"]

MAX_SWEEPS = 100  # five to ten are usual
# sweeps that do not halve the residual, after which it is taken for rounding
MAX_STALLED_SWEEPS = 8
RESIDUAL_TOLERANCE = 1e-12  # of the largest value or reward
# relative, and absolute: by so much the KL of counts and box may exceed the radius
RADIUS_TOLERANCES = (1e-9, 1e-15)
# the largest number of lambdas that a row tries
MAX_STEPS = 200
MIN_EXPONENT = -1020  # of a unit that is a power of two


def independent_radius(n: Array, k: IntArray, level: float) -> Array:
    """Compute the radius of a KL ball for n independent draws over k outcomes [1].

    It is the epsilon with Pr(KL(phat || P) > epsilon) <= level: c = n epsilon solves
    e^-c (e c / (k - 1))^(k - 1) = level, c > k - 1. It is inf where n = 0.
    """
    order = np.maximum(k - 1.0, 1.0)
    # -c + (k-1) (1 + log(c / (k-1))) = log level: with y = c / (k-1), y e^-y = exp(log
    # level / (k-1) - 1)
    c = -order * special.lambertw(-np.exp(np.log(level) / order - 1.0), k=-1).real
    return np.where(n > 0, c / np.maximum(n, 1.0), np.inf)


def anytime_radius(n: Array, k: IntArray, level: float) -> Array:
    """Compute the radius of a KL ball where n is itself random, as in episodes [2].

    epsilon = (log(1 / level) + (k - 1) log(e (1 + n / (k - 1)))) / n, inf where n = 0.
    """
    order = np.maximum(k - 1.0, 1.0)
    c = np.log(1.0 / level) + order * (1.0 + np.log1p(n / order))
    return np.where(n > 0, c / np.maximum(n, 1.0), np.inf)


def radii(evidence: Evidence, confidence: float, kind: RadiusKind) -> Array:
    """Compute the radius (S*A,) of each row's KL ball.

    The rows that are reachable and stochastic share the failure probability evenly.
    """
    n_rows = int((evidence.is_stochastic & evidence.reachable).sum())
    level = (1.0 - confidence) / max(n_rows, 1)
    radius = independent_radius if kind == "independent" else anytime_radius
    return radius(evidence.n, np.diff(evidence.rows.indptr), level)


class Extreme(NamedTuple):
    """The largest or the smallest value, with a bound beyond it.

    ``residual`` is the Bellman residual that is left, ``sweeps`` the number of robust
    evaluations.
    """

    value: float
    bound: float
    residual: float
    sweeps: int


def extreme_value(evidence: Evidence, radius: Array, sign: float) -> Extreme:
    """Compute the extreme of J over the rectangular set, largest for sign 1.

    It is certified by the Bellman residual (at discount 1 to rounding).
    """
    model = evidence.model
    policy = evidence.policy
    p = evidence.phat.copy()
    guesses = np.zeros(len(radius))

    def back_up(values: Array, pi: Array) -> Array:
        """Return (S,) sum_a pi max P (r + gamma V), with bounds from outside."""
        ahead = (
            evidence.transition_rewards + model.discount * values[evidence.rows.arrival]
        )
        bound, _ = solve_rows(evidence, radius, sign * ahead, guesses, p)
        return np.asarray((pi * (sign * bound).reshape(pi.shape)).sum(axis=1))

    steps = optional_horizon_length(evidence.horizon, model, policy)
    if steps is not None:
        values = np.zeros(model.n_states)
        for t in range(steps - 1, -1, -1):
            values = back_up(values, policy if policy.ndim == 2 else policy[t])
        value = dot(model.initial, values)
        return Extreme(value, value, 0.0, steps)
    # at discount 1 values need not exist in states that no model reaches
    left_out = np.zeros(model.n_states, dtype=np.bool_)
    if model.discount == 1.0:
        left_out = ~reached_states(model, policy)
    values, rise, residual, sweeps = settle_values(
        evidence, p, sign, left_out, lambda values: back_up(values, policy)
    )
    value = dot(model.initial, values)
    beyond = rise / (1.0 - model.discount) if model.discount < 1.0 else 0.0
    return Extreme(value, value + sign * beyond, residual, sweeps)


def settle_values(
    evidence: Evidence,
    p: Array,
    sign: float,
    left_out: BoolArray,
    back_up: Callable[[Array], Array],
) -> tuple[Array, float, float, int]:
    """Compute the extreme V (S,) of the evidence's policy over the rows' sets.

    ``back_up`` returns (S,) sum_a pi max P (r + gamma V), and writes the rows that
    attain it into ``p`` (entries,), which are also what is begun with. States that are
    ``left_out`` have 0. Returns V, by how much one more step would move it outwards at
    most, the Bellman residual, and the number of steps.
    """
    model = evidence.model
    values = values_or_zeros(evidence.with_rows(p), evidence.policy)
    values[left_out] = 0.0
    size = largest_reward(model)
    residual = np.inf
    rise = 0.0
    sweeps = 0
    stalled = 0
    while sweeps < MAX_SWEEPS:
        sweeps += 1
        backed = back_up(values)
        backed[left_out] = 0.0
        rise = max(float((sign * (backed - values)).max()), 0.0)
        last = residual
        residual = float(np.abs(backed - values).max())
        stalled = stalled + 1 if residual >= 0.5 * last else 0
        tolerance = RESIDUAL_TOLERANCE * max(size, float(np.abs(values).max()))
        if residual <= tolerance or stalled >= MAX_STALLED_SWEEPS:
            break
        values = values_or_zeros(evidence.with_rows(p), evidence.policy)
        values[left_out] = 0.0
    return values, rise, residual, sweeps


def find_contradictions(
    evidence: Evidence, confidence: float, kind: RadiusKind
) -> IntArray:
    """Find the rows in which the KL ball of the counts misses the box.

    The box is wrong there, with the confidence given.
    """
    radius = radii(evidence, confidence, kind)
    p = evidence.phat.copy()
    _, kl = solve_rows(evidence, radius, np.zeros(len(p)), np.zeros(len(radius)), p)
    relative, absolute = RADIUS_TOLERANCES
    largest = radius * (1.0 + relative) + absolute
    return np.flatnonzero(np.isfinite(radius) & (kl > largest))


def solve_rows(
    evidence: Evidence, radius: Array, v: Array, guesses: Array, p: Array
) -> tuple[Array, Array]:
    """Compute certified bounds (S*A,) on max sum P v, and the KL of the maximisers.

    The maximisers are written into p. ``v`` and the multipliers ``guesses`` are solved
    in a unit of v's size, whose products neither underflow nor overflow.
    """
    # a power of two, which rounds nothing
    unit = power_of_two(v)
    v = v / unit
    guesses /= unit
    bound, kl = np.empty((2, len(radius)))
    rows = evidence.rows
    # a row without a ball and without room is what it is, in any order
    has_room = rows.sums((evidence.high > evidence.low).astype(np.float64)) > 0
    own = np.flatnonzero(rows.spread(has_room | np.isfinite(radius)))
    order = np.arange(len(v))
    order[own] = own[order_by_row(v[own], rows.spread(np.arange(len(rows)))[own])]
    worst_rows(
        radius,
        evidence.phat,
        v,
        order,
        evidence.low,
        evidence.high,
        rows.indptr,
        guesses,
        p,
        np.empty(len(p)),
        bound,
        kl,
    )
    guesses *= unit
    return bound * unit, kl


def power_of_two(values: Array) -> float:
    """Return the power of two at or below the largest absolute value; 1 for zeros."""
    largest = float(np.abs(values).max(initial=0.0))
    if not 0.0 < largest < inf:
        return 1.0
    # below it, since the inverse of the least numbers would be infinite
    return ldexp(1.0, max(frexp(largest)[1] - 1, MIN_EXPONENT))


def require_end(evidence: Evidence) -> None:
    """Refuse a box in which a model keeps the policy among transient states.

    The refused states are the largest set X of states that the policy leaves in the
    simulator, in which no row has to leave X (nu = 0 or no successor outside) and X can
    take all mass (mu P(X) >= 1).
    """
    model = evidence.model
    rows = evidence.rows
    # what the policy never reaches does not matter
    reached = reached_states(model, evidence.policy)
    policy = np.where(reached[:, None], evidence.policy, 0.0)
    system = policy_system(model, policy)
    rewards = (policy * model.rewards).sum(axis=1)
    # which refuses a simulator whose own sum diverges
    inside = reached & ~recurrent_states(system, rewards, model.names)
    taken = policy.reshape(-1) > 0
    while inside.any():
        kept = inside[rows.arrival]
        leaving = rows.sums(np.where(kept, 0.0, evidence.low))
        room = rows.sums(np.where(kept, evidence.high, 0.0))
        closed = ~taken | ((leaving <= 0.0) & (room >= 1.0 - _checks.SUM_TOLERANCE))
        smaller = inside & closed.reshape(-1, model.n_actions).all(axis=1)
        if (smaller == inside).all():
            state = model.names.state(np.flatnonzero(inside)[0])
            raise ArgumentError(
                "horizon",
                "must be given: at discount 1 the infinite sum exists only where the"
                " policy is absorbed in every model of the box; with lower_ratio 0 it"
                f" may stay for ever among states of which s={state} is one",
            )
        inside = smaller


def order_by_row(v: Array, row: IntArray) -> IntArray:
    """Return the entries in the order of their rows, the largest v of each first."""
    return np.lexsort((-v, row))


@njit(cache=True, error_model="numpy")
def fill_at(eta, lam, phat, v, low, high, start, stop, out):
    """Write P(eta, lambda); return its sum, and minus the sum's derivative in eta.

    P_i = clip(lambda phat_i / (eta - v_i), low_i, high_i),   high_i where eta <= v_i.
    """
    total = 0.0
    slope = 0.0
    for i in range(start, stop):
        gap = eta - v[i]
        if gap <= 0.0:
            out[i] = high[i]
        else:
            value = lam * phat[i] / gap
            if value < low[i]:
                out[i] = low[i]
            elif value > high[i]:
                out[i] = high[i]
            else:
                out[i] = value
                slope += value / gap
        total += out[i]
    return total, slope


@njit(cache=True, error_model="numpy")
def greedy_row(order, low, high, start, stop, out):
    """Write the maximiser without a ball; return the last entry that got some mass.

    What ``low`` leaves of the mass goes to the entries in their ``order``, the largest
    v first (``order_by_row``).
    """
    rest = 1.0
    last = -1
    for i in range(start, stop):
        out[i] = low[i]
        rest -= low[i]
    for k in range(start, stop):
        last = order[k]
        room = high[last] - low[last]
        if room > rest:
            room = rest
        out[last] += room
        rest -= room
        if rest <= 0.0:
            break
    return last


@njit(cache=True, error_model="numpy")
def row_at(lam, phat, v, low, high, start, stop, out, spare):
    """Write P for a lambda above 0, summing to 1, and return eta.

    sum_i clip(lambda phat_i / (eta - v_i), low_i, high_i) = 1: a bracketed root in eta.

    It needs sum low <= 1 <= sum high.
    """
    least = 0.0
    smallest = inf
    largest = -inf
    for i in range(start, stop):
        least += low[i]
        if v[i] < smallest:
            smallest = v[i]
        if v[i] > largest:
            largest = v[i]
    left = smallest
    # as far to the right as the sum needs, and more than the values' rounding
    scale = largest - smallest
    if abs(largest) > scale:
        scale = abs(largest)
    if abs(smallest) > scale:
        scale = abs(smallest)
    reach = 1e-12 * scale + 1e-300
    room = 1.0 - least
    if room < 1e-300:
        room = 1e-300
    if lam / room > reach:
        reach = lam / room
    right = largest + reach
    eta = right
    # Newton's steps, and bisections where they leave the bracket
    for _ in range(200):
        total, slope = fill_at(eta, lam, phat, v, low, high, start, stop, out)
        if total == 1.0:
            return eta
        if total > 1.0:
            left = eta
        else:
            right = eta
        trial = eta + (total - 1.0) / slope if slope > 0.0 else 0.5 * (left + right)
        if not left < trial < right:
            trial = 0.5 * (left + right)
        if not left < trial < right or abs(trial - eta) <= 1e-16 * abs(eta):
            break
        eta = trial
    # At a jump of the sum its two ends are combined, so that it is 1.
    upper, _ = fill_at(left, lam, phat, v, low, high, start, stop, out)
    lower, _ = fill_at(right, lam, phat, v, low, high, start, stop, spare)
    share = 0.0
    if upper > lower:
        share = (1.0 - lower) / (upper - lower)
        if share < 0.0:
            share = 0.0
        if share > 1.0:
            share = 1.0
    for i in range(start, stop):
        if out[i] != spare[i]:
            out[i] = spare[i] + share * (out[i] - spare[i])
    return right


@njit(cache=True, error_model="numpy")
def divergence(phat, p, start, stop):
    """Return KL(phat || P) without cancellation where P is near phat.

    KL = sum phat (u - log(1 + u)),   u = (P - phat) / phat; the terms in u sum to minus
    what P has where phat is 0.
    """
    total = 0.0
    for i in range(start, stop):
        if phat[i] == 0.0:
            # sum P = sum phat = 1: this mass is missing in the terms in u
            total += p[i]
        elif p[i] <= 0.0:
            return inf
        else:
            u = (p[i] - phat[i]) / phat[i]
            if -1e-4 < u < 1e-4:
                total += phat[i] * 0.5 * u * u * (1.0 - 2.0 * u / 3.0 + 0.5 * u * u)
            elif u < -0.5:
                total += phat[i] * (u - log(p[i] / phat[i]))
            else:
                total += phat[i] * (u - log1p(u))
    return total


@njit(cache=True, error_model="numpy")
def bound_above(eta, lam, epsilon, phat, v, low, high, start, stop):
    """Return the Lagrangian's maximum, an upper bound on the row's problem.

    eta + lambda epsilon + max_P sum_i [P_i (v_i - eta) + lambda phat_i log(P_i/phat_i)]

    over low <= P <= high, for any eta and lambda >= 0.
    """
    total = eta + (lam * epsilon if lam > 0.0 else 0.0)
    for i in range(start, stop):
        slope = v[i] - eta
        if phat[i] > 0.0 and lam > 0.0:
            best = high[i]
            if slope < 0.0:
                best = lam * phat[i] / -slope
                if best < low[i]:
                    best = low[i]
                if best > high[i]:
                    best = high[i]
            if best <= 0.0:
                return inf
            total += best * slope + lam * phat[i] * log(best / phat[i])
        else:
            total += (high[i] if slope > 0.0 else low[i]) * slope
    return total


@njit(cache=True, error_model="numpy")
def worst_row(epsilon, phat, v, order, low, high, start, stop, guess, out, spare):
    """Write the maximiser; return lambda, an upper bound on the maximum, and the KL.

    KL(phat || P(lambda)) = epsilon, a bracketed root in log lambda: KL falls as lambda
    grows. A KL above epsilon says that no P of the box is in the ball.
    """
    last = greedy_row(order, low, high, start, stop, out)
    eta = v[last] if last >= 0 else inf
    kl = 0.0 if epsilon == inf else divergence(phat, out, start, stop)
    if kl <= epsilon:
        return 0.0, bound_above(eta, 0.0, 0.0, phat, v, low, high, start, stop), kl
    spread = v[order[start]] - v[order[stop - 1]]
    # ``near`` and ``far`` are lambdas outside and inside of the ball, ``above`` and
    # ``below`` are log(KL / epsilon) there. Steps are regula falsi in log lambda, every
    # third one a bisection.
    near = 0.0
    far = inf
    above = 1.0
    below = -1.0
    lam = guess if guess > 0.0 else spread / sqrt(2.0 * epsilon + 1e-300)
    # without a spread it is the nearest point of the box to the counts
    is_last = spread <= 0.0
    if is_last:
        lam = 1e30
    for step in range(MAX_STEPS + 1):
        eta = row_at(lam, phat, v, low, high, start, stop, out, spare)
        kl = divergence(phat, out, start, stop)
        if is_last:
            break
        excess = log((kl if kl > 1e-300 else 1e-300) / epsilon)
        if excess > 0.0:
            near = lam
            above = excess
        else:
            far = lam
            below = excess
        is_last = (
            -1e-12 < excess <= 0.0
            or far <= near * (1.0 + 1e-13)
            or far < 1e-15 * spread
            or near > 1e15 * spread
            or step == MAX_STEPS - 1
        )
        if is_last:
            lam = far if far < inf else near
        elif far == inf:
            lam = 4.0 * near
        elif near == 0.0:
            lam = 0.25 * far
        elif step % 3 == 2 or not above < inf:
            lam = sqrt(near * far)
        else:  # regula falsi in log lambda, log KL
            share = above / (above - below)
            if share < 1e-3:
                share = 1e-3
            if share > 1.0 - 1e-3:
                share = 1.0 - 1e-3
            lam = near * (far / near) ** share
    if spread <= 0.0:
        return 0.0, v[start], kl
    return lam, bound_above(eta, lam, epsilon, phat, v, low, high, start, stop), kl


@njit(cache=True, error_model="numpy")
def worst_rows(epsilon, phat, v, order, low, high, indptr, lam, out, spare, above, kl):
    """Solve every row's problem, max sum P v, and write P, its bounds and its KL.

    ``lam`` holds guesses and gets the multipliers. inf in ``epsilon`` is a row without
    data. ``spare`` is room for the entries.
    """
    for k in range(len(indptr) - 1):
        start = indptr[k]
        stop = indptr[k + 1]
        # the row of an action that cannot be taken
        if start == stop:
            lam[k], above[k], kl[k] = 0.0, 0.0, 0.0
            continue
        lam[k], above[k], kl[k] = worst_row(
            epsilon[k], phat, v, order, low, high, start, stop, lam[k], out, spare
        )
