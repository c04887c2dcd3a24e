"""Mean and variance of what is summed along a walk: per decision, over the whole, for ever, self-normalised.

Sums go backward in time with the law of total variance, so that nothing cancels (``_moments``, ``_merged``).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular import _printing
from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular._threads import dot
from oee_tabular.exact.linear import DivergentKernelError, solve_policy_system
from oee_tabular.exact.system import exponent, readable
from oee_tabular.exact.walks import Walk, radius_of
from oee_tabular.mdp.horizons import SHORT_HORIZON, limit_horizon

if TYPE_CHECKING:
    from oee_tabular.exact._moments import Extras


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean and variance of one episode's X; for a self-normalised estimator, what n episodes have to first order.

    Attributes
    ----------
    mean : E[X]; self-normalised: the limit of the estimator
    variance : Var[X]; self-normalised: lim n * variance of the estimator
    bias : 0; self-normalised: lim n * (expectation of the estimator - mean)
        What is made of numbers beyond the largest float is infinite, or nan, with a warning.
    by_step : (T + 1,) parts of the variance: that of the start, then of each step; None unless asked for
    by_state : (S,) parts of the variance by the state that the step was taken from (without the start's); None unless
        asked for

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> found = oee.return_moments(coin, [[1.0]] * 2, horizon=2, sources=True)
    >>> found, found.by_step.tolist()  # the first state's chance, the first move's, the last's
    (Moments(mean=0.75, variance=0.3125, bias=0.0), [0.25, 0.0625, 0.0])
    """

    mean: float
    variance: float
    bias: float = 0.0
    by_step: Array | None = field(default=None, repr=False)
    by_state: Array | None = field(default=None, repr=False)
    _deviation: float | None = field(default=None, repr=False)  # where the variance leaves the range of floats

    @property
    def standard_deviation(self) -> float:
        """sqrt(variance), also where the variance is too large or too small for a float."""
        return float(np.sqrt(self.variance)) if self._deviation is None else self._deviation

    def _repr_html_(self) -> str:
        rows: list[tuple[str, object]] = [
            ("mean", f"{self.mean:.6g}"), ("variance (squared units)", f"{self.variance:.6g}"),
            ("standard deviation", f"{self.standard_deviation:.6g}"), ("bias", f"{self.bias:.4g}"),
        ]  # fmt: skip
        return _printing.facts(f"Moments of one episode: {_printing.SUM}", rows)


def moments_of(walk: Walk, steps: int | None, *, whole: bool, self_normalized: bool, sources: bool) -> Moments:
    """Of the product of ratios on one walk, with one weight for the ``whole`` return or with one for each reward."""
    shift = largest_exponent(walk)
    scaled = walk if shift == 0 else walk._replace(pay=readable(np.ldexp(walk.pay, -shift)))
    with np.errstate(over="ignore", invalid="ignore"):  # of weights: said below
        if steps is None:
            if whole or self_normalized:
                what = "trajectory" if whole else "self-normalised"
                raise ValueError(f"horizon must be given: the infinite sum has no variance for {what} weights")
            return scaled_moments(infinite(scaled, sources), shift)
        steps = steps_followed(scaled, steps, whole or self_normalized, sources)
        if whole:
            return scaled_moments(trajectory(scaled, steps, self_normalized, sources), shift)
        if self_normalized:
            return scaled_moments(per_step_ratio(scaled, steps, sources), shift)
        return scaled_moments(per_decision(scaled, steps, sources=sources), shift)


def largest_exponent(walk: Walk) -> int:
    """That of the largest reward that is reached: others may be of any size."""
    if exponent(walk.pay) == 0:
        return 0
    taken = walk.act.max(axis=0) > 0.0
    row = walk.rows
    state, reached = np.arange(len(taken)) // (len(taken) // walk.n_states), walk.initial > 0.0
    while True:
        rows = taken & reached[state]
        ahead = reached.copy()
        ahead[walk.indices[rows[row]]] = True
        if (ahead == reached).all():
            return exponent(walk.pay[rows[row]] if walk.by_move else walk.pay[rows])
        reached = ahead


def steps_followed(walk: Walk, steps: int, lasting: bool, sources: bool) -> int:
    """The steps of a horizon that are carried out; weights that grow faster than the discount, or stay, keep all of them."""
    if steps <= SHORT_HORIZON or len(walk.act) > 1:
        return steps
    rate = walk.discount
    if not (_all_one(walk.u) and _all_one(walk.w)):
        first, second = (radius_of(walk.weighted_kernel(power)) for power in (1, 2))
        rate = 1.0 if lasting else max(rate, rate * first, rate**2 * second)
    kept = 10.0 * walk.n_states if sources or lasting else 4.0
    return limit_horizon(steps, rate, ahead=walk.n_states, work=4.0 * len(walk.prob), kept=kept)


def per_decision(walk: Walk, steps: int, *, sources: bool = False, **given: Array | None) -> Moments:
    """The kernel's X over ``steps`` steps, with what is ``given`` of ``extras_of``."""
    from oee_tabular.exact import _moments

    extras = extras_of(walk, steps, **given)
    shifted = np.any(extras.shift != 0.0) and not walk.by_move
    constant = len(walk.act) == len(walk.u) == 1 and not np.any(extras.c)
    merging = constant and (not shifted or _all_one(walk.u) or _all_one(walk.w))
    mean, var, local = (merged if merging else _moments.per_decision)(walk, steps, extras, sources)
    first, initial = walk.first
    value = dot(initial, mean[first])
    start = dot(initial, (mean[first] - value) ** 2)
    found = Moments(value, start + dot(initial, var[first]))
    if not sources:
        return found
    second = walk.reaches(steps, power=2)[:steps, 0]
    parts = walk.discount ** (2.0 * np.arange(steps))[:, None] * second * local
    return Moments(value, found.variance, 0.0, np.concatenate([[start], parts.sum(axis=1)]), parts.sum(axis=0))


def extras_of(
    walk: Walk,
    steps: int,
    *,
    shift: Array | None = None,
    scale: Array | None = None,
    c: Array | None = None,
    h: Array | None = None,
    k: Array | None = None,
) -> Extras:
    """As the kernels read them; what is not given is 0 (``scale``: 1)."""
    from oee_tabular.exact._moments import Extras

    times = (np.zeros(steps) if shift is None else shift, np.ones(steps) if scale is None else scale)
    bases = (
        np.zeros((1, size)) if x is None else np.atleast_2d(x)
        for x, size in ((c, walk.act.shape[1]), (h, walk.n_states), (k, walk.n_states))
    )
    return Extras(*(readable(x) for x in (*times, *bases)))


def merged(walk: Walk, steps: int, extras: Extras, keep: bool) -> tuple[Array, Array, Array]:
    """``_moments.per_decision`` for a policy and pays that do not depend on time, 6 to 10 times as fast."""
    from oee_tabular.exact import _merged

    strips, n = _merged.merge(walk), walk.n_states
    order, based = strips.order, np.any(extras.h) or np.any(extras.k)
    at_start, ahead = (np.zeros((steps, len(order)) if based else (0, 0)) for _ in range(2))
    if based:
        at_start[:, :n], ahead[:, :n] = extras.h[:steps, order[:n]], extras.k[:steps, order[:n]]
        ahead[0] = 0.0
    placed = extras._replace(h=at_start, k=ahead)
    found = []
    for part in _merged.merged_moments(
        strips, steps, placed, not walk.by_move and _all_one(walk.u), walk.discount, keep
    ):
        states = np.empty((*part.shape[:-1], n))
        states[..., order[:n]] = part[..., :n]
        found.append(states)
    return found[0], found[1], found[2]


def _all_one(values: Array) -> bool:
    return bool(np.all(values == 1.0))


def infinite(walk: Walk, sources: bool) -> Moments:
    """Two linear systems; DivergentKernelError where a moment does not exist."""
    first, second = (walk.weighted_kernel(power) for power in (1, 2))
    gamma, n = walk.discount, walk.n_states
    n_actions = walk.act.shape[1] // n
    act, u = walk.act[0], walk.u[0]
    rows = walk.rows
    if gamma == 1.0:
        raise ValueError("horizon must be given: at discount 1 the infinite sum's variance is not worked out")
    chance, f = act[rows] * walk.prob, u[rows]
    state = rows // n_actions
    pay = walk.w * walk.pay if walk.by_move else walk.pay[rows]
    mean = solve_policy_system(first, np.bincount(state, chance * f * pay, n).astype(np.float64), gamma).x
    value = f * (pay + gamma * walk.w * mean[walk.indices])
    own: Array = np.bincount(state, chance * (value - mean[state]) ** 2, n).astype(np.float64)
    try:
        var = solve_policy_system(second, own, gamma**2).x
    except DivergentKernelError as error:
        raise DivergentKernelError(
            "horizon must be given: the infinite sum has no variance, the second moment of its weights grows too fast "
            f"({error})"
        ) from None
    begin, initial = walk.first
    total = dot(initial, mean[begin])
    start = dot(initial, (mean[begin] - total) ** 2)
    found = Moments(total, start + dot(initial, np.maximum(var[begin], 0.0)))
    if not sources:
        return found
    reached = solve_policy_system(second, walk.initial, gamma**2, transpose=True).x
    return Moments(total, found.variance, 0.0, None, reached * own)


def trajectory(walk: Walk, steps: int, self_normalized: bool, sources: bool) -> Moments:
    """X = W G, or W (G - its mean) / E W where it is self-normalised."""
    from oee_tabular.exact import _moments

    n = walk.n_states
    out, local = _moments.trajectory(walk, steps, sources)
    first, initial = walk.first
    out = out[:, first]
    weight, value = np.float64(dot(initial, out[0])), dot(initial, out[1])
    off = np.stack([out[0] - weight, out[1] - value])
    products = off[0] ** 2, off[0] * off[1], off[1] ** 2
    start = np.array([dot(initial, x) for x in products])
    parts = np.zeros((0, 3, n))
    if sources:  # step t's share given the prefix: W^2 Var(G L' + gamma^t L' R')
        before = walk.reaches(steps, power=2, returns=True)[:steps]
        factor = walk.discount ** np.arange(steps, dtype=np.float64)[:, None]
        b0, b1, b2 = before[:, 0], before[:, 1], before[:, 2]
        own_l, own_cov, own_lr = local[:, 0], local[:, 1], local[:, 2]
        parts = np.stack(
            [
                b0 * own_l,
                b1 * own_l + factor * b0 * own_cov,
                b2 * own_l + 2.0 * factor * b1 * own_cov + factor**2 * b0 * own_lr,
            ],
            axis=1,
        )
    total = start + np.array([dot(initial, x) for x in out[2:]])
    mix, mean, bias, variance = np.array([0.0, 0.0, 1.0]), value, 0.0, float(total[2])
    if self_normalized:
        if weight == 0.0:
            return Moments(float("nan"), float("nan"), float("nan"))
        mean = float(value / weight)
        mix = np.array([mean**2, -2.0 * mean, 1.0]) / weight**2
        bias = -float((total[1] - mean * total[0]) / weight**2)
        variance = max(float(mix @ total), 0.0)
    if not sources:
        return Moments(mean, variance, bias)
    shares = np.einsum("i,tis->ts", mix, parts)
    return Moments(mean, variance, bias, np.concatenate([[mix @ start], shares.sum(axis=1)]), shares.sum(axis=0))


def per_step_ratio(walk: Walk, steps: int, sources: bool) -> Moments:
    """sum_t gamma^t (sum_i W_it r_it) / (sum_i W_it): to first order the mean of sum_t gamma^t W_t (r_t - j_t) / E W_t."""
    reached = [_paid(walk, steps, power) for power in (1, 2)]
    (mass, paid), (square, square_paid) = reached
    factor = walk.discount ** np.arange(steps, dtype=np.float64)
    if np.any(mass == 0.0):
        return Moments(float("nan"), float("nan"), float("nan"))
    level = paid / mass
    found = per_decision(walk, steps, shift=level, scale=1.0 / mass, sources=sources)
    bias = -dot(factor, (square_paid - level * square) / mass**2)
    return Moments(dot(factor, level), found.variance, bias, found.by_step, found.by_state)


def _paid(walk: Walk, steps: int, power: int) -> tuple[Array, Array]:
    """E[W^power] and E[W^power r_t] of the weight that each step's reward carries."""
    before = walk.reaches(steps, power=power)[:steps, 0]
    chance, mass, pay = walk.act * walk.u**power, np.ones(walk.act.shape[1]), walk.pay  # chance: (1 or T, S*A)
    if walk.by_move:
        moved = walk.entries(walk.prob * walk.w**power)
        mass, pay = row_sums(moved), row_sums(moved, moved.data * pay)
    weight, paid = (np.asarray((before * walk.by_state(chance * x)).sum(axis=1)) for x in (mass, pay))
    return weight, paid


def scaled_moments(found: Moments, shift: int) -> Moments:
    """The moments of 2^shift X from those of X, with a warning where they are not finite."""
    if shift != 0:
        with np.errstate(over="ignore", under="ignore"):
            deviation = float(np.ldexp(found.standard_deviation, shift))
            mean, bias = (float(np.ldexp(x, shift)) for x in (found.mean, found.bias))
            by_step, by_state = (None if x is None else np.ldexp(x, 2 * shift) for x in (found.by_step, found.by_state))
            found = Moments(mean, float(np.ldexp(found.variance, 2 * shift)), bias, by_step, by_state, deviation)
        if found.variance < np.finfo(float).tiny < deviation or found.variance == np.inf > deviation:
            warnings.warn(
                f"the variance {found.variance:g} is beyond floats; standard_deviation has its root", stacklevel=4
            )
    if not np.isfinite([found.mean, found.standard_deviation]).all():
        what = "beyond the largest float: the weights or the rewards are too large; or all weights of a step are 0"
        warnings.warn(f"a moment is {what}", stacklevel=4)
    return found
