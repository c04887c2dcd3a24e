"""Profile likelihood intervals: all values J(P') of models whose likelihood ratio the log does not reject.

{J(P') : sum_x n_x KL(phat_x || P'_x) <= c}, c half the chi-square quantile with one degree of freedom: asymptotically of the
confidence asked for [1]; on tables the same as CoinDICE's empirical likelihood. An end is stationary where
P'_i = phat_i / (eta_x - tau G_i / n_x), G the gradient of J at P' itself: a fixed point, with one root for tau inside. Rows
without data, if the policy reaches them, are set to their extreme in the prior box (the whole simplex on the simulator's
support without one), and counted.

An iteration is two linear solves, V and the occupancy d, and a pass over the rows that the policy takes; J of the new rows is
the next iteration's V. Both solves correct the last ones, to a thousandth of what these miss in the new rows.

Sources: [1] A. Owen, Empirical Likelihood, 2001. [2] B. Dai et al., CoinDICE: Off-policy confidence interval estimation,
NeurIPS 2020. [3] H. Walker and P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49, 2011.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from oee_tabular._checks import Array
from oee_tabular.exact import policy_value
from oee_tabular.inference.ambiguity import Evidence, simulated_rows
from oee_tabular.inference.taken import FINE, Direction, Point, Taken

SETTLED = 3e-8  # of the way from the frequencies' value: four iterations that move the end by less are the last
CLOSE = 1e-2  # of it: an ascent that comes so near to a known end, by smaller steps, is taken to be on its way there
DRAWN = 16  # ascents from drawn rows, of small problems (40 ms for 100 states)
AFFORDED = 10**6  # moves of the simulator, times the steps of a value, that share such ascents among them
SWEEPS = 15  # steps of a value without a horizon, in time
EXACT = 1e-8  # of the limit: how closely it is met in the end
HOPELESS = 1e-2  # of what an ascent is behind: two iterations that move it by less are the last
SLOW = 0.3  # of the last iteration's change: from there on steps are extrapolated
SOLVED = 1e-3  # of the last iteration's change: how far J of an iteration may be off


@dataclass(frozen=True, eq=False)
class ProfileEnd:
    """An end of the interval, and how it was found.

    ``rows`` are the probabilities of the model that has it, ``divergence`` its sum of n KL (c where the set binds), ``change``
    the last iteration's; ``promised`` is the most that rows of the set have beyond it to first order, max G (P'' - P'): 0 at
    a stationary point.
    """

    value: float
    rows: Array
    divergence: float
    iterations: int
    change: float
    promised: float


@dataclass(frozen=True, eq=False)
class Start:
    """What both ends begin with: the frequencies' point, and r + gamma V of the simulator's rows."""

    taken: Taken
    base: Point
    ahead: Array

    @classmethod
    def of(cls, evidence: Evidence) -> Start:
        """Of the rows that the policy takes."""
        taken = Taken.of(evidence)
        base, _ = taken.direction(taken.valued(taken.chain.phat.copy(), None, FINE), 1.0, FINE)
        values = taken.valued(simulated_rows(evidence)[taken.entries], base, FINE).values
        return cls(taken, base, taken.chain.pay + taken.discount * values[taken.chain.column])

    def members(self, sign: float, limit: float) -> Iterator[Array]:
        """Members of the set, from the frequencies towards each row's best next state in the simulator, and by drawn values."""
        chain = self.taken.chain
        starts, lengths = chain.indptr[:-1], np.diff(chain.indptr)
        rng = np.random.default_rng(5)
        drawn = (rng.random(len(chain.initial))[chain.column] for _ in range(draws(self.taken)))
        for order in (sign * self.ahead, *drawn):
            best = (order == np.repeat(np.maximum.reduceat(order, starts), lengths)).astype(np.float64)
            best /= np.repeat(np.add.reduceat(best, starts), lengths)
            yield toward(self.taken, _extreme(self.taken, order, best), limit)


def profile_end(
    evidence: Evidence,
    confidence: float,
    sign: float,
    *,
    most: int = 200,
    start: Callable[[Evidence], Start] = Start.of,
) -> ProfileEnd:
    """The largest (sign 1) or smallest (-1) value in the profile set.

    J is not concave in the rows, and where the frequencies never lead to a reward it is flat: the ascent is made from the
    frequencies and from mixtures of them, as far as the set allows, with each row's best (worst) next state by the simulator's
    values and by values that are drawn (the same draws each time): once in large problems, more often in smaller ones, up to
    16 times; the farthest end is taken. Of 1186 ends of random problems, half of them with many rows without data, 5 were more
    than 1e-5 of the interval's width behind the best of 40 further draws, 1.3% of it at most; 48 (21%) by what large problems
    get, 75 (21%) from the frequencies alone.
    """
    limit = float(gammaincinv(0.5, confidence))  # half of chi-square's quantile
    begun = start(evidence)
    taken, base = begun.taken, begun.base
    best, last = _Ascent(taken, sign, limit, base.value).end(base, most, wander=2)
    for member in begun.members(sign, limit):
        other = taken.valued(member, base, FINE)
        other_end, other = _Ascent(taken, sign, limit, base.value, known=best).end(other, most, wander=0)
        if sign * other_end.value > sign * best.value:
            best, last = other_end, other
    point, found = taken.direction(taken.valued(best.rows, last, FINE), sign, FINE)
    ahead, _, _ = _step(taken, found, limit, 0.0, EXACT)
    rows = evidence.phat.copy()
    rows[taken.entries] = best.rows
    value = policy_value(evidence.with_rows(rows), evidence.policy, horizon=evidence.horizon)
    return replace(best, value=value, rows=rows, promised=float(found.gradient @ (ahead - point.p)))


def draws(taken: Taken) -> int:
    """Of how many drawn rows ascents are made: of all that are afforded, and of one at least."""
    work = len(taken.entries) * (SWEEPS if taken.steps is None else taken.steps)
    return min(max(AFFORDED // max(work, 1), 1), DRAWN)


def toward(taken: Taken, q: Array, limit: float) -> Array:
    """(1 - d) phat + d q with the largest d in [0, 1] at which sum n KL(phat || .) <= limit; q itself in rows without data."""
    phat, seen = taken.chain.phat, taken.seen
    held = seen & (phat > 0)
    weight = (np.repeat(taken.chain.n, np.diff(taken.chain.indptr)) * phat)[held]
    apart = q[held] / phat[held] - 1.0

    def divergence(d: float) -> float:
        with np.errstate(divide="ignore"):
            return -float(weight @ np.log1p(d * apart))

    low, high = 0.0, 1.0
    if divergence(1.0) <= limit:
        low = 1.0
    else:
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if divergence(middle) <= limit else (low, middle)
    return np.where(seen, (1.0 - low) * phat + low * q, q)


@dataclass(eq=False)
class _Ascent:
    """Fixed points x = G(P(x)) of rows P(x) that are best for a direction x and the gradient G at rows.

    The rows that are best for x + a (G - x) lie on an ascent of G from those that are best for x. a is halved where the value
    gets worse; after that, and where it is near and slow, steps are extrapolated from the last three by Anderson's method [3],
    and taken where that does not make it worse. ``known``: an end; the ascent of a larger problem stops where it comes to it
    slowly, or is well behind it and hardly moves. ``careful``: whether steps are extrapolated.
    """

    taken: Taken
    sign: float
    limit: float
    base: float
    known: ProfileEnd | None = None
    tau: float = 0.0
    used: float = 0.0
    slack: float = 0.0
    careful: bool = False

    def end(self, point: Point, most: int, *, wander: int) -> tuple[ProfileEnd, Point]:
        """From a point; in the first ``wander`` steps the value may get worse."""
        share, change, iteration, still = 1.0, np.inf, 0, 0
        past: list[tuple[Direction, Direction]] = []  # x and G
        x: Direction | None = None
        for iteration in range(1, most + 1):
            width = abs(point.value - self.base)
            self.slack = SOLVED * (change if iteration > 1 else width)
            point, found = self.taken.direction(point, self.sign)
            if x is None:
                new, share, x = self._first(point, found, share, free=iteration <= wander)
            else:
                past = [*past[-3:], (x, found)]
                new, share, x = self._next(point, past, share, free=iteration <= wander)
            before, change = change, abs(new.value - point.value)
            self.careful |= SLOW * before < change <= CLOSE * abs(new.value - self.base)
            follows = self._follows(point, found, change)
            quiet, behind = SETTLED * abs(new.value - self.base) + 1e-14 * abs(self.base), self._behind(new)
            still = still + 1 if change <= max(quiet, HOPELESS * behind) else 0
            settled = float(np.abs(new.p - point.p).max()) <= 1e-9
            point = new
            if (still and settled) or still > (1 if behind > 0.0 else 3) or follows:
                break  # rows that are not reached yet may move before the value does
        return ProfileEnd(point.value, point.p, self.used, iteration, change, np.nan), point

    def _worse(self, new: Point, point: Point) -> bool:
        return self.sign * (new.value - point.value) < -max(2.0 * self.slack, 1e-12 * max(1.0, abs(point.value)))

    def _behind(self, point: Point) -> float:
        """How far, in larger problems, the known end is away; 0 from there on."""
        if self.known is None or draws(self.taken) > 1:
            return 0.0
        return max(self.sign * (self.known.value - point.value), 0.0)

    def _follows(self, point: Point, found: Direction, change: float) -> bool:
        """Whether the ascent comes to the known end from behind, in small steps, and on its way there.

        To first order at least a tenth of what is left is to be had by going there; from near another end nothing is.
        """
        left = self._behind(point)
        if self.known is None or left == 0.0 or max(left, change) > CLOSE * abs(self.known.value - self.base):
            return False
        return 0.1 * left <= float(found.gradient @ (self.known.rows - point.p))

    def _tried(self, x: Direction, point: Point, share: float) -> Point:
        from oee_tabular.inference import _profile as kernel

        width = abs(point.value - self.base)
        room = min(max(self.slack / width, EXACT), 1e-3) if width > 0.0 else EXACT
        p, self.used, self.tau = _step(self.taken, x, self.limit, self.tau, room)
        if share < 1.0:
            kernel.blend(self.taken.chain, point.p, np.sqrt(share), p)
        return self.taken.valued(p, point)

    def _first(self, point: Point, found: Direction, share: float, free: bool) -> tuple[Point, float, Direction | None]:
        """From rows that are no direction's best: towards the gradient's, within the rows' convex sets."""
        new, target = self._tried(found, point, 1.0), None
        whole = new
        while self._worse(new, point) and not free and share > 1e-3:
            share *= 0.5
            new = self.taken.valued(point.p + share * (whole.p - point.p), point)
        target = found if new is whole else None
        return new, share, target

    def _next(
        self, point: Point, past: list[tuple[Direction, Direction]], share: float, free: bool
    ) -> tuple[Point, float, Direction]:
        if len(past) > 1 and self.careful:
            x = self._extrapolated(past, share)
            new = self._tried(x, point, share)
            if not self._worse(new, point):
                return new, share, x
        while True:
            x = _mixed(past[-1:], np.ones(1), share)
            new = self._tried(x, point, share)
            if free or share < 1e-3 or not self._worse(new, point):
                return new, min(1.0, 2.0 * share), x
            share, self.careful = 0.5 * share, True

    def _extrapolated(self, past: list[tuple[Direction, Direction]], share: float) -> Direction:
        """The mixture of the last directions whose own steps cancel best, and ``share`` of the step that is left."""
        steps = [self.taken.metric * (found.gradient - x.gradient) for x, found in past]
        apart = np.stack([steps[-1] - other for other in steps[:-1]], axis=1)
        factors = np.linalg.lstsq(apart.T @ apart, apart.T @ steps[-1], rcond=1e-10)[0]
        return _mixed(past, np.append(factors, 1.0 - factors.sum()), share)


def _mixed(past: list[tuple[Direction, Direction]], factors: Array, share: float) -> Direction:
    """sum_k factor_k ((1 - share) x_k + share G_k)."""
    weights = [w for factor in factors for w in ((1.0 - share) * factor, share * factor)]
    parts = [part for pair in past for part in pair]
    counted = [(w, part) for w, part in zip(weights, parts, strict=True) if w != 0.0]
    return Direction(sum(w * part.gradient for w, part in counted), sum(w * part.order for w, part in counted))


def _extreme(taken: Taken, order: Array, p: Array) -> Array:
    """``p``, whose rows without data lead, as far as the prior box allows, where the order is largest."""
    from oee_tabular.inference import _profile as kernel

    if taken.blank.size:
        kernel.greedy(taken.blank, taken.chain, *taken.box, order, p)
    return p


def _step(taken: Taken, direction: Direction, limit: float, tau: float, room: float) -> tuple[Array, float, float]:
    """Rows that maximise the linear part under sum n KL <= limit, to a share ``room`` of it; the sum reached, and tau."""
    from oee_tabular.inference import _profile as kernel

    chain, v = taken.chain, direction.gradient
    scale = 1.0 / np.maximum(chain.n, 1.0)
    mean, spread, best = np.empty(len(scale)), np.empty(len(scale)), np.empty(len(scale), dtype=np.int64)
    variance = kernel.moments_of_rows(chain.indptr, chain.phat, v, mean, best, spread)
    p = chain.phat.copy()  # rows that no direction moves keep it
    _extreme(taken, direction.order, p)
    size = spread * scale
    gains = (variance > 0.0) | (best >= chain.seen)  # others have all their mass on the best already
    moving = np.flatnonzero((chain.n > 0) & gains & (size > 1e-14 * size.max(initial=0.0)))
    if not moving.size:
        return p, 0.0, tau
    if tau == 0.0:
        total = float(np.sum(scale[moving] * variance[moving]))
        tau = np.sqrt(2.0 * limit / total) if total > 0.0 else 1.0 / float(size.max())
    tau, used = _root(lambda tau: kernel.fill(tau, moving, scale, chain, v, mean, best, p), tau, limit, room)
    return p, used, tau


def _root(divergence: Any, tau: float, limit: float, room: float) -> tuple[float, float]:
    """tau with divergence(tau) = (sum, its derivative in log tau) at the limit, from inside; Newton's steps in logarithms.

    Steps that leave the bracket, or find nothing to go by, become bisections (doublings while there is no bracket).
    """
    near, far, reached = 0.0, np.inf, 0.0
    for _ in range(200):
        reached, growth = divergence(tau)
        if reached <= limit:
            near = tau
            if reached >= limit * (1.0 - room):
                return tau, reached
        else:
            far = tau
        trial = 0.0
        if reached > 0.0 and growth > 0.0 and np.isfinite(reached):
            trial = tau * np.exp(np.log(limit * (1.0 - 0.3 * room) / reached) * reached / growth)
        if not near < trial < far:
            trial = 2.0 * near if far == np.inf else 0.5 * far if near == 0.0 else np.sqrt(near * far)
        if far <= near * (1.0 + 1e-14):
            break
        tau = trial
    if reached > limit:
        tau = near
        reached, _ = divergence(near)
    return tau, reached
