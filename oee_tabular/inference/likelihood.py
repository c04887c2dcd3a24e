"""Profile likelihood intervals: all values J(P') of models whose likelihood ratio the log does not reject.

{J(P') : sum_x n_x KL(phat_x || P'_x) <= c}, c half the chi-square quantile with one degree of freedom: asymptotically of the
confidence asked for [1]; on tables the same as CoinDICE's empirical likelihood. An end is stationary where
P'_i = phat_i / (eta_x - tau G_i / n_x), G the gradient of J at P' itself: a fixed point, with one root for tau inside. Rows
without data, if the policy reaches them, are set to their extreme in the prior box (the whole simplex on the simulator's
support without one), and counted.

Sources: [1] A. Owen, Empirical Likelihood, 2001. [2] B. Dai et al., CoinDICE: Off-policy confidence interval estimation,
NeurIPS 2020.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from oee_tabular._checks import Array, IntArray
from oee_tabular.exact import policy_value, state_values, transition_gradient
from oee_tabular.inference.ambiguity import Evidence, simulated_rows


@dataclass(frozen=True, eq=False)
class ProfileEnd:
    """An end of the interval, the model that has it, its sum of n KL (c where the set binds), iterations and last change."""

    value: float
    rows: Array
    divergence: float
    iterations: int
    change: float


def profile_end(evidence: Evidence, confidence: float, sign: float, *, most: int = 200) -> ProfileEnd:
    """The largest (sign 1) or smallest (-1) value in the profile set.

    J is not concave in the rows, and where the frequencies never lead to a reward it is flat: the ascent is made from the
    frequencies and from mixtures of them, as far as the set allows, with the simulator and with each row's best (worst)
    next state in it; the farthest end is taken. (A start from the extreme rows if each had the whole limit to itself cost
    nine tenths of the time and moved 2 of 162 measured ends, by .2 and .5% of the interval's width.)
    """
    limit = float(stats.chi2.ppf(confidence, 1)) / 2.0
    starts = [evidence.phat.copy(), *_other_starts(evidence, sign, limit)]
    ends = [_ascend(evidence, p, sign, limit, most, wander=2 if k == 0 else 0) for k, p in enumerate(starts)]
    return max(ends, key=lambda end: sign * end.value)


def _other_starts(evidence: Evidence, sign: float, limit: float) -> list[Array]:
    """Members of the set on the way from the frequencies to the simulator's rows, and to its best next states."""
    matrix = evidence.model.transitions
    rows, starts = evidence.rows, evidence.indptr[:-1]
    simulator = simulated_rows(evidence)
    values = state_values(evidence.with_rows(simulator), evidence.policy, horizon=evidence.horizon)
    pay = 0.0 if evidence.model.reward_data is None else evidence.model.reward_data
    ahead = sign * (pay + evidence.model.discount * values[matrix.indices])
    best = (ahead == np.maximum.reduceat(ahead, starts)[rows]).astype(np.float64)
    best /= np.add.reduceat(best, starts)[rows]
    seen = evidence.n[rows] > 0
    return [_toward(evidence, np.where(seen, q, simulator), limit) for q in (simulator, best)]


def _toward(evidence: Evidence, q: Array, limit: float) -> Array:
    """(1 - d) phat + d q with the largest d in [0, 1] at which sum n KL(phat || .) <= limit; q itself in rows without data."""
    phat, rows = evidence.phat, evidence.rows
    seen = evidence.n[rows] > 0
    held = seen & (phat > 0)
    weight, base = (evidence.n[rows] * phat)[held], phat[held]

    def member(d: float) -> Array:
        return np.where(seen, (1.0 - d) * phat + d * q, q)

    def divergence(d: float) -> float:
        with np.errstate(divide="ignore"):
            return float(weight @ np.log(base / member(d)[held]))

    low, high = 0.0, 1.0
    if divergence(1.0) <= limit:
        return member(1.0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if divergence(middle) <= limit else (low, middle)
    return member(low)


def _ascend(evidence: Evidence, p: Array, sign: float, limit: float, most: int, *, wander: int) -> ProfileEnd:
    """Fixed points of ``_step`` from p; after ``wander`` steps the value never gets worse."""
    value = policy_value(evidence.with_rows(p), evidence.policy, horizon=evidence.horizon)
    used, change, iteration, still = 0.0, np.inf, 0, 0
    for iteration in range(1, most + 1):
        trial, used = _step(evidence, sign * _direction(evidence, p), limit)
        new = policy_value(evidence.with_rows(trial), evidence.policy, horizon=evidence.horizon)
        length = 1.0
        while sign * (new - value) < -1e-12 * max(1.0, abs(value)) and iteration > wander and length > 1e-3:
            length *= 0.5  # between two members of the rows' convex sets
            trial = p + length * (trial - p)
            new = policy_value(evidence.with_rows(trial), evidence.policy, horizon=evidence.horizon)
        change = abs(new - value)
        still = still + 1 if change <= 1e-10 * max(1.0, abs(value)) else 0
        settled = float(np.abs(trial - p).max()) <= 1e-10
        p, value = trial, new
        if still and (settled or still > 3):  # rows that are not reached yet may move before the value does
            break
    return ProfileEnd(value, p, used, iteration, change)


def _direction(evidence: Evidence, p: Array) -> Array:
    """The gradient of J; in rows without data r + gamma V, which orders next states the same and does not vanish unreached.

    (With a horizon only where the gradient does vanish: there the order changes in time.)
    """
    model = evidence.with_rows(p)
    gradient = transition_gradient(model, evidence.policy, horizon=evidence.horizon)
    unseen = evidence.n == 0
    if not unseen.any():
        return gradient
    starts = evidence.indptr[:-1]
    flat = np.maximum.reduceat(gradient, starts) == np.minimum.reduceat(gradient, starts)
    chosen = (unseen if evidence.horizon is None else unseen & flat)[evidence.rows]
    values = state_values(model, evidence.policy, horizon=evidence.horizon)
    pay = 0.0 if evidence.model.reward_data is None else evidence.model.reward_data
    ahead = pay + evidence.model.discount * values[evidence.model.transitions.indices]
    return np.where(chosen, ahead, gradient)


def _step(evidence: Evidence, gradient: Array, limit: float) -> tuple[Array, float]:
    """Rows that maximise the linear part under sum n KL <= limit, by a root in log tau; the sum reached."""
    from oee_tabular.kernels import ambiguity as kernel

    n = evidence.n
    rows = evidence.rows
    spread = np.maximum.reduceat(gradient, evidence.indptr[:-1]) - np.minimum.reduceat(gradient, evidence.indptr[:-1])
    active = (n > 0) & (spread > 1e-14 * max(float(spread.max(initial=0.0)), 1e-300))
    seen = n[rows] > 0
    low, high = np.where(seen, 0.0, evidence.low), np.where(seen, 1.0, evidence.high)
    p, kl = np.empty(len(evidence.phat)), np.empty(len(n))

    def fill(tau: float, todo: IntArray) -> None:
        lam = np.where(active, n / tau, np.where(n > 0, np.inf, 0.0))
        kernel.rows_at(lam, evidence.phat, gradient, low, high, evidence.indptr, todo, p, kl)

    moving = np.flatnonzero(active)
    fill(1.0, np.flatnonzero(~active))  # the others do not depend on tau

    def total(tau: float) -> float:
        fill(tau, moving)
        return float(n[active] @ kl[active])

    if not active.any():
        return p.copy(), 0.0
    mean = np.add.reduceat(evidence.phat * gradient, evidence.indptr[:-1])
    variance = np.add.reduceat(evidence.phat * (gradient - mean[rows]) ** 2, evidence.indptr[:-1])
    size = float(np.sum(variance[active] / n[active]))
    tau = np.sqrt(2.0 * limit / size) if size > 0 else 1.0
    reached = total(tau)
    near = far = tau
    below = above = reached
    for _ in range(200):  # near: inside the set, far: outside
        if below <= limit:
            break
        far, above = near, below
        near *= 0.5
        below = total(near)
    for _ in range(200):
        if above >= limit:
            break
        near, below = far, above
        far *= 2.0
        above = total(far)
    for step in range(200):  # the sum grows about as tau^2: a secant in logarithms, every third step a bisection
        if far <= near * (1.0 + 1e-12) or below >= limit * (1.0 - 1e-10):
            break
        middle = np.sqrt(near * far)
        if step % 3 != 2 and 0.0 < below < above < np.inf:
            share = np.log(limit / below) / np.log(above / below)
            middle = near * (far / near) ** min(max(share, 1e-6), 1.0 - 1e-6)
        reached = total(middle)
        if reached <= limit:
            near, below = middle, reached
        else:
            far, above = middle, reached
    used = total(near)
    return p.copy(), used
