"""Profile likelihood intervals: all values J(P') of models whose likelihood ratio the log does not reject.

    {J(P') : sum_x n_x KL(phat_x || P'_x) <= c},   c half the chi-square quantile with one degree of freedom,

asymptotically of the confidence asked for [1]; on tables the same as CoinDICE's empirical likelihood [2]. Rows without data, if
the policy reaches them, are set to their extreme in the prior box (the whole simplex on the simulator's support without one).

An end is stationary where its rows are best for the gradient of J at themselves. P(x) are the rows that maximise sum x P over
the set (``_likelihood``: P_i = phat_i / (1 + e - u_i)), G_k = d(s) pi(a | s) (r + gamma V(s')) is the gradient of J at P_k, and
the ascent to the upper end (with -G: to the lower) is

    P_k = P(x_k),   x_{k+1} = x_k + a (G_k - x_k);

where J(P_k) is worse than J(P_{k-1}), a is halved and the step from x_{k-1} is made again; else a grows by a fifth, up to 1.
Rows that are best for x + a (G - x) lie on an ascent of J from those that are best for x. An iteration is two linear solves,
for V and d, and a pass over the rows.

J is not concave in the rows, and where the frequencies never lead to a reward it is flat: ascents are made from several
directions, the same each time, and the farthest ends are taken. Of 640 ends of random problems, half of them with many rows
without data, 3 were short of the best that is known by more than 1e-5 of the interval's width, by 1.3% at most. With a horizon
rows without data may be best mixed; these are approached slowly (.04% of the width in one of the three).

Sources: [1] A. Owen, Empirical Likelihood, 2001. [2] B. Dai et al., CoinDICE: Off-policy confidence interval estimation,
NeurIPS 2020.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaincinv

from oee_tabular._checks import Array
from oee_tabular.exact import policy_value
from oee_tabular.inference.evidence import Evidence, simulator_rows
from oee_tabular.inference.policy_rows import FINE, Points, PolicyRows

N_DRAWS = 16  # ascents from drawn directions, of small problems
AFFORDED = 10**6  # transitions of the simulator, times the steps of a value, that share such ascents among them
N_SWEEPS = 15  # steps of a value without a horizon, in time
N_ITERATIONS = 200  # at most; ten are usual
N_QUIET = 4  # iterations that move the end by less than a share of the way from the frequencies' value are the last
SETTLED = 3e-8  # that share
SCOUTED = 1e-3  # the same of all ascents of large problems, of which the best is continued
EXACT = 1e-8  # of the limit: how closely it is met in the end
SOLVED = 1e-3  # of the last iteration's change: how far J of an iteration may be off
GROWTH = 1.2  # of a, after a step that was no worse; doubling it is refused every other time
LEAST_STEP = 1e-3  # a, from which on steps are taken as they are
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class LikelihoodEnd:
    """An end of the interval.

    ``rows`` are the probabilities of the model that has it, best for ``direction``; ``divergence`` its sum of n KL (c where
    the set binds), ``change`` the last iteration's; ``promised`` is the most that rows of the set have beyond it to first
    order, max G (P'' - P'): 0 at a stationary point.
    """

    value: float
    rows: Array
    direction: Array
    divergence: float
    iterations: int
    change: float
    promised: float = np.nan


def likelihood_ends(evidence: Evidence, confidence: float) -> tuple[LikelihoodEnd, LikelihoodEnd]:
    """Find the smallest and the largest value in the set."""
    limit = float(gammaincinv(0.5, confidence))  # half of chi-square's quantile
    rows = PolicyRows.from_evidence(evidence)
    base = rows.evaluate(rows.arrays.phat[None], None, FINE)
    starts = [(sign, x[None]) for sign in (-1.0, 1.0) for x in _start_directions(rows, evidence, base, sign)]
    groups, settled = ([starts], SETTLED) if rows.is_small else ([[start] for start in starts], SCOUTED)
    ends: dict[float, LikelihoodEnd] = {}
    for group in groups:
        signs, x = np.array([sign for sign, _ in group]), np.concatenate([x for _, x in group])
        for sign, end in zip(signs.tolist(), ascend(rows, x, signs, limit, base, settled), strict=True):
            if sign not in ends or sign * (end.value - ends[sign].value) > 0.0:
                ends[sign] = end
    if not rows.is_small:
        for sign, end in ends.items():
            (ends[sign],) = ascend(rows, end.direction[None], np.array([sign]), limit, base, SETTLED)
    low, high = (_finish(rows, evidence, base, limit, sign, ends[sign]) for sign in (-1.0, 1.0))
    return low, high


def _finish(
    rows: PolicyRows, evidence: Evidence, base: Points, limit: float, sign: float, end: LikelihoodEnd
) -> LikelihoodEnd:
    """The value to rounding, the rows among all, and what is promised."""
    point = rows.evaluate(end.rows[None], base, FINE)
    ahead, _ = rows.best_rows(sign * point.gradient, point.p, np.ones(1), limit, EXACT, np.zeros(1))
    promised = np.where(rows.has_data, sign * point.gradient * (ahead - point.p), 0.0).sum()
    whole = evidence.phat.copy()
    whole[rows.entries] = end.rows
    value = policy_value(evidence.with_rows(whole), evidence.policy, horizon=evidence.horizon)
    return replace(end, value=value, rows=whole, promised=float(promised))


def _start_directions(rows: PolicyRows, evidence: Evidence, base: Points, sign: float) -> Iterator[Array]:
    """The gradient at the frequencies; r + gamma V of the simulator; drawn V, every other time each row's best state alone."""
    arrays, rng = rows.arrays, np.random.default_rng(5)
    yield sign * base.gradient[0]
    own = rows.evaluate(simulator_rows(evidence)[rows.entries][None], base, FINE)
    yield sign * (arrays.pay + evidence.model.discount * own.values[0][arrays.column])
    work = len(arrays.phat) * (N_SWEEPS if rows.n_steps is None else rows.n_steps)
    for k in range(min(max(AFFORDED // max(work, 1), 1), N_DRAWS)):
        drawn = rng.random(len(arrays.initial))[arrays.column]
        largest = np.repeat(np.maximum.reduceat(drawn, arrays.indptr[:-1]), np.diff(arrays.indptr))
        yield (drawn == largest).astype(np.float64) if k % 2 else drawn


def ascend(rows: PolicyRows, x: Array, sign: Array, limit: float, base: Points, settled: float) -> list[LikelihoodEnd]:
    """Run the loop above for several ascents at once, from directions x (k, entries), upwards (sign 1) or downwards (-1).

    All arrays have a line for each ascent that goes on, ``lane`` its place among the ends.
    """
    k, base_value = len(x), float(base.value[0])
    ends: dict[int, LikelihoodEnd] = {}
    lane = np.arange(k)
    point = Points(*(np.repeat(part, k, axis=0) for part in base))
    last_x, gradient, divergence = x, np.zeros_like(x), np.zeros(k)
    step, tau, change, quiet = np.ones(k), np.zeros(k), np.full(k, np.inf), np.zeros(k, dtype=np.int64)
    for iteration in range(N_ITERATIONS):
        width = np.abs(point.value - base_value) + TINY
        slack = SOLVED * np.minimum(change, width)
        room = float(np.clip(slack / width, EXACT, 1e-3).min())
        p, reached = rows.best_rows(x, point.p, step, limit, room, tau)
        new = rows.evaluate(p, point)
        gain = sign * (new.value - point.value)
        is_worse = gain < -np.maximum(2.0 * slack, 1e-12 * np.maximum(1.0, np.abs(point.value)))
        is_worse &= (step >= LEAST_STEP) & (iteration > 0)
        if iteration == 0:  # drawn directions get the gradient's size, so that they can be mixed
            sizes = [np.abs(part).sum(axis=1, keepdims=True) for part in (new.gradient, x)]
            x = x * (sizes[0] / np.maximum(sizes[1], TINY))
        else:
            change = np.where(is_worse, change, np.abs(gain))
        is_still = ~is_worse & (np.abs(gain) <= settled * np.abs(new.value - base_value) + 1e-14 * abs(base_value))
        quiet = np.where(is_worse, quiet, np.where(is_still, quiet + 1, 0))
        ended = (
            (quiet >= N_QUIET)
            | (is_still & (np.abs(p - point.p).max(axis=1) <= 1e-9))
            | (iteration == N_ITERATIONS - 1)
        )
        point = Points(*_choose(is_worse, point, new))
        last_x, gradient, divergence = _choose(
            is_worse, (last_x, gradient, divergence), (x, sign[:, None] * new.gradient, reached)
        )
        step = np.where(is_worse, 0.5 * step, np.minimum(1.0, GROWTH * step))
        for i in np.flatnonzero(ended):
            numbers = float(divergence[i]), iteration + 1, float(change[i])
            ends[int(lane[i])] = LikelihoodEnd(float(point.value[i]), point.p[i], last_x[i], *numbers)
        if ended.all():
            break
        if ended.any():
            point = Points(*(part[~ended] for part in point))
            kept = (part[~ended] for part in (last_x, gradient, divergence, step, tau, change, quiet, sign, lane))
            last_x, gradient, divergence, step, tau, change, quiet, sign, lane = kept
        x = last_x + step[:, None] * (gradient - last_x)
    return [ends[i] for i in range(k)]


def _choose(is_first: Array, first: tuple[Array, ...], second: tuple[Array, ...]) -> tuple[Array, ...]:
    """Line by line."""
    if not is_first.any():
        return second
    return tuple(
        np.where(is_first.reshape(-1, *[1] * (one.ndim - 1)), one, other)
        for one, other in zip(first, second, strict=True)
    )
