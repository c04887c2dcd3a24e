"""The ascent to an end of the likelihood interval: rows that are best for the gradient of J at themselves.

An iteration is two linear solves, V and the occupancy d, and a pass over the rows that the policy takes; J of the new rows is
the next iteration's V. Both solves correct the last ones, to a thousandth of what these miss in the new rows.

Source: [1] H. Walker and P. Ni, Anderson acceleration for fixed-point iterations, SIAM J. Numer. Anal. 49, 2011.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.inference.taken import Direction, Point, Taken

SETTLED = 3e-8  # of the way from the frequencies' value: four iterations that move the end by less are the last
EXACT = 1e-8  # of the limit: how closely it is met in the end
NEAR = 1e-2  # of the way from the frequencies' value: smaller steps may be extrapolated
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


@dataclass(eq=False)
class Ascent:
    """Fixed points x = G(P(x)) of rows P(x) that are best for a direction x and the gradient G at rows.

    The rows that are best for x + a (G - x) lie on an ascent of G from those that are best for x. a is halved where the value
    gets worse; after that, and where it is near and slow, steps are extrapolated from the last three by Anderson's method [1],
    and taken where that does not make it worse. ``known``: an end; the ascent stops where it comes as near to it as
    ``haste``, a share of the way from the frequencies' value, by smaller steps and on its way there, or where two iterations
    move it by less than that share of what it is behind. ``careful``: whether steps are extrapolated.
    """

    taken: Taken
    sign: float
    limit: float
    base: float
    known: ProfileEnd | None = None
    haste: float = 0.0
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
            self.careful |= SLOW * before < change <= NEAR * abs(new.value - self.base)
            follows = self._follows(point, found, change)
            quiet, behind = SETTLED * abs(new.value - self.base) + 1e-14 * abs(self.base), self._behind(new)
            still = still + 1 if change <= max(quiet, self.haste * behind) else 0
            settled = float(np.abs(new.p - point.p).max()) <= 1e-9
            point = new
            if (still and settled) or still > (1 if behind > 0.0 else 3) or follows:
                break  # rows that are not reached yet may move before the value does
        return ProfileEnd(point.value, point.p, self.used, iteration, change, np.nan), point

    def _worse(self, new: Point, point: Point) -> bool:
        return self.sign * (new.value - point.value) < -max(2.0 * self.slack, 1e-12 * max(1.0, abs(point.value)))

    def _behind(self, point: Point) -> float:
        """How far the known end is away; 0 from there on."""
        return 0.0 if self.known is None else max(self.sign * (self.known.value - point.value), 0.0)

    def _follows(self, point: Point, found: Direction, change: float) -> bool:
        """Whether the ascent comes near the known end from behind, by small steps, and is on its way there.

        To first order at least a tenth of what is left is to be had by going there; from near another end nothing is.
        """
        left = self._behind(point)
        if self.known is None or left == 0.0 or max(left, change) > self.haste * abs(self.known.value - self.base):
            return False
        return 0.1 * left <= float(found.gradient @ (self.known.rows - point.p))

    def _tried(self, x: Direction, point: Point, share: float) -> Point:
        from oee_tabular.inference import _profile as kernel

        width = abs(point.value - self.base)
        room = min(max(self.slack / width, EXACT), 1e-3) if width > 0.0 else EXACT
        p, self.used, self.tau = step(self.taken, x, self.limit, self.tau, room)
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
        steps = np.stack([self.taken.weighed(found.gradient - x.gradient) for x, found in past])
        apart = steps[-1] - steps[:-1]
        factors = np.linalg.lstsq(apart @ apart.T, apart @ steps[-1], rcond=1e-10)[0]
        return _mixed(past, np.append(factors, 1.0 - factors.sum()), share)


def _mixed(past: list[tuple[Direction, Direction]], factors: Array, share: float) -> Direction:
    """sum_k factor_k ((1 - share) x_k + share G_k)."""
    weights = [w for factor in factors for w in ((1.0 - share) * factor, share * factor)]
    parts = [part for pair in past for part in pair]
    counted = [(w, part) for w, part in zip(weights, parts, strict=True) if w != 0.0]
    return Direction(sum(w * part.gradient for w, part in counted), sum(w * part.order for w, part in counted))


def extreme(taken: Taken, order: Array, p: Array) -> Array:
    """``p``, whose rows without data lead, as far as the prior box allows, where the order is largest."""
    from oee_tabular.inference import _profile as kernel

    if taken.blank.size:
        kernel.greedy(taken.blank, taken.chain, *taken.box, order, p)
    return p


def step(taken: Taken, direction: Direction, limit: float, tau: float, room: float) -> tuple[Array, float, float]:
    """Rows that maximise the linear part under sum n KL <= limit, to a share ``room`` of it; the sum reached, and tau."""
    from oee_tabular.inference import _profile as kernel

    chain, v = taken.chain, direction.gradient
    scale = 1.0 / np.maximum(chain.n, 1.0)
    mean, spread, best = np.empty(len(scale)), np.empty(len(scale)), np.empty(len(scale), dtype=np.int64)
    variance = kernel.moments_of_rows(chain.indptr, chain.phat, v, mean, best, spread)
    p = chain.phat.copy()  # rows that no direction moves keep it
    extreme(taken, direction.order, p)
    size = spread * scale
    gains = (variance > 0.0) | (best >= chain.seen)  # others have all their mass on the best already
    moving = np.flatnonzero((chain.n > 0) & gains & (size > 1e-14 * size.max(initial=0.0)))
    if not moving.size:
        return p, 0.0, tau
    if tau == 0.0:
        total = float(np.sum(scale[moving] * variance[moving]))
        tau = np.sqrt(2.0 * limit / total) if total > 0.0 else 1.0 / float(size.max())
    bent = scale * scale * variance
    tau, used = root_of(lambda tau: kernel.fill(tau, moving, scale, chain, v, mean, best, bent, p), tau, limit, room)
    return p, used, tau


def root_of(divergence: Any, tau: float, limit: float, room: float) -> tuple[float, float]:
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
