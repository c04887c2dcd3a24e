"""Mean and variance of weighted sums along a walk.

The sums are weighted per decision or over the whole trajectory, with a horizon or for
ever, and may be self-normalised. Moments go backward in time by the law of total
variance, so that nothing cancels. ``_moments`` carries a pair (L, R), there (L, X): R
is the weighted sum, and L the product of the weights, or 1 per decision. Each X here is
p L + q R with numbers p and q: p = 0 and q = 1 but for self-normalised sums.

Its variance is Var X_0(s_0) plus what each step adds given the path before it, E[(p_t,
q_t) C_t (p_t, q_t)^T], where (p_t, q_t) = (p, q) A_0 ... A_{t-1}, A_t is the matrix of
``_moments`` and C_t = Cov(A_t m_{t+1} | s_t) the step's own covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from oee_tabular import _checks, _printing
from oee_tabular._parallel import dot
from oee_tabular._results import checked
from oee_tabular._sparse import row_sums
from oee_tabular.exact import _moments
from oee_tabular.exact.system import as_readonly, exponent
from oee_tabular.exact.values import solve_policy_system
from oee_tabular.exact.walks import Walk, radius_of
from oee_tabular.exceptions import ArgumentError, DivergentKernelError, NumericalWarning
from oee_tabular.mdp import SHORT_HORIZON, limit_horizon
from oee_tabular.typing import Array


@checked(shapes={"by_step": "t", "by_state": "S"})
@dataclass(frozen=True, eq=False)
class Moments:
    """Hold the mean and the variance of one episode's X.

    Of a self-normalised estimator they are limits for n episodes. Overflow gives inf or
    nan, with a warning.

    Attributes
    ----------
    mean : float
        E[X]; self-normalised: the limit of the estimator.
    variance : float
        Var[X]; self-normalised: lim n * variance of the estimator.
    bias : float
        0; self-normalised: lim n * (expectation of the estimator - mean).
    by_step : ndarray of shape (T + 1,) or None
        Parts of the variance, first of the start, then of each step; None unless asked
        for.
    by_state : ndarray of shape (S,) or None
        Parts of the variance by the state that the step was taken from (without the
        start's); None unless asked for.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> moments = oee.return_moments(coin, [[1.0]] * 2, horizon=2, sources=True)
    >>> moments
    Moments(mean=0.75, variance=0.3125, bias=0.0)
    >>> moments.by_step.tolist()  # of the first state, the first transition, the last
    [0.25, 0.0625, 0.0]
    """

    mean: float
    variance: float
    bias: float = 0.0
    by_step: Array | None = field(default=None, repr=False)
    by_state: Array | None = field(default=None, repr=False)
    # the standard deviation, where the variance leaves the range of floats
    _deviation: float | None = field(default=None, repr=False)

    @property
    def standard_deviation(self) -> float:
        """Return sqrt(variance), even where the variance is beyond floats.

        The variance may be too large or too small for a float while its root is not.
        """
        if self._deviation is None:
            return float(np.sqrt(self.variance))
        return self._deviation

    def _repr_html_(self) -> str:
        """Return a table of the moments for notebooks."""
        rows: list[tuple[str, object]] = [
            ("mean", f"{self.mean:.6g}"),
            ("variance (squared units)", f"{self.variance:.6g}"),
            ("standard deviation", f"{self.standard_deviation:.6g}"),
            ("bias", f"{self.bias:.4g}"),
        ]
        return _printing.facts(f"Moments of one episode: {_printing.SUM}", rows)


def compute_moments(
    walk: Walk,
    horizon: int | None,
    *,
    is_trajectory: bool,
    self_normalized: bool,
    sources: bool,
) -> Moments:
    """Compute the moments of the product of ratios on one walk.

    There is one weight for the whole return (``is_trajectory``) or one for each reward.
    """
    shift = exponent(walk.rewards)
    if shift != 0:
        # only rewards that are reached count: the others may be of any size
        n_actions = walk.act.shape[1] // walk.n_states
        is_reached = np.repeat(walk.reachable_states(), n_actions)
        is_reached &= walk.act.max(axis=0) > 0.0
        if walk.by_transition:
            is_reached = is_reached[walk.rows]
        shift = exponent(walk.rewards[0, is_reached])
        walk = walk._replace(rewards=as_readonly(np.ldexp(walk.rewards, -shift)))
    # weights may overflow: scale_moments warns of it
    with np.errstate(over="ignore", invalid="ignore"):
        if horizon is None:
            if is_trajectory or self_normalized:
                what = "trajectory" if is_trajectory else "self-normalised"
                raise ArgumentError(
                    "horizon",
                    f"must be given: the infinite sum has no variance for {what}"
                    " weights",
                )
            return scale_moments(infinite_moments(walk, sources), shift)
        horizon = limit_walk(walk, horizon, is_trajectory or self_normalized, sources)
        discounts = np.full(horizon, walk.discount)
        if is_trajectory:
            result = trajectory_moments(walk, discounts, self_normalized, sources)
        elif self_normalized:
            result = self_normalized_moments(walk, discounts, sources)
        else:
            result = per_decision_moments(walk, discounts, sources=sources)
        return scale_moments(result, shift)


def limit_walk(walk: Walk, horizon: int, is_lasting: bool, sources: bool) -> int:
    """Return the number of steps of a horizon that are carried out.

    Weights that grow faster than the discount, or stay, keep all of them.
    """
    if horizon <= SHORT_HORIZON or len(walk.act) > 1:
        return horizon
    rate = walk.discount
    if not (np.all(walk.u == 1.0) and np.all(walk.w == 1.0)):
        first, second = (radius_of(walk.weighted_kernel(power)) for power in (1, 2))
        rate = 1.0 if is_lasting else max(rate, rate * first, rate**2 * second)
    kept = 10.0 * walk.n_states if sources or is_lasting else 4.0
    return limit_horizon(
        horizon, rate, ahead=walk.n_states, work=4.0 * len(walk.prob), kept=kept
    )


def per_decision_moments(
    walk: Walk,
    discounts: Array,
    *,
    sources: bool,
    offsets: Array | None = None,
    q: float = 1.0,
    start: Array | float = 0.0,
) -> Moments:
    """Compute the moments of q X_0 + start(s_0) with one weight for each reward.

    X_t = u r + w (gamma_t X_{t+1} - k_t), where k_t are the ``offsets`` (1 or T, 1 or
    S).
    """
    if len(walk.act) == len(walk.rewards) == 1:
        out, local = _merged_backward(walk, discounts, offsets, sources)
    else:
        given = np.zeros((1, 1)) if offsets is None else offsets
        shape = (len(given), walk.n_states)
        shifts = as_readonly(np.broadcast_to(given, shape))
        out, local = _moments.backward(walk, discounts, shifts, False, sources)
    out[1] += start / q
    return _combine(walk, discounts, out, local, None, q)


def _merged_backward(
    walk: Walk, discounts: Array, offsets: Array | None, keep: bool
) -> tuple[Array, Array]:
    """Run the backward recursion with the actions of each state merged."""
    n = walk.n_states
    strips = _moments.lay_strips(*_moments.merge(walk))
    order = strips.order[:n]
    shifts = np.zeros((0 if offsets is None else len(discounts), len(strips.order)))
    if offsets is not None:
        shifts[:, :n] = offsets[:, order] if offsets.shape[1] > 1 else offsets
    mean, variance, own = _moments.backward_merged(strips, discounts, shifts, keep)
    out = np.zeros((5, n))
    local = np.empty((len(own), 1, n))
    out[0] = 1.0
    out[1, order] = mean[:n]
    out[4, order] = variance[:n]
    local[:, 0, order] = own[:, :n]
    return out, local


def trajectory_moments(
    walk: Walk, discounts: Array, self_normalized: bool, sources: bool
) -> Moments:
    """Compute the moments of X = W G.

    If self-normalised, X = W (G - its mean) / E W.
    """
    out, local = _moments.backward(
        walk, discounts, as_readonly(np.zeros((1, walk.n_states))), True, sources
    )
    if not self_normalized:
        return _combine(walk, discounts, out, local, None, 1.0)
    begin = np.flatnonzero(walk.initial)
    weight, total = (dot(walk.initial[begin], x[begin]) for x in out[:2])
    if weight == 0.0:
        return Moments(float("nan"), float("nan"), float("nan"))
    mean = float(total / np.float64(weight))
    moments = _combine(walk, discounts, out, local, -mean / weight, 1.0 / weight)
    return Moments(
        mean, moments.variance, moments.bias / weight, moments.by_step, moments.by_state
    )


def self_normalized_moments(walk: Walk, discounts: Array, sources: bool) -> Moments:
    """Compute the moments of sum_t gamma^t (sum_i W_it r_it) / (sum_i W_it).

    To first order this is the mean of sum_t gamma^t W_t (r_t - j_t) / E W_t.
    """
    horizon = len(discounts)
    mass, rewards = _step_weights(walk, horizon, 1)
    square, square_rewards = _step_weights(walk, horizon, 2)
    if np.any(mass == 0.0):
        return Moments(float("nan"), float("nan"), float("nan"))
    level = rewards / mass
    factor = walk.discount ** np.arange(horizon, dtype=np.float64)
    bias = -dot(factor, (square_rewards - level * square) / mass**2)
    # the recursion is that of X_t E W_t: a step multiplies by gamma E W_t / E W_{t+1}
    discounts = discounts * np.append(mass[:-1] / mass[1:], 1.0)
    # where the reward carries the weight of its own step, X has w (r - j)
    offsets = level[:, None]
    # where it does not, X has r - j, and j is the level of the next step
    if not walk.by_transition and np.all(walk.u == 1.0):
        offsets = discounts[:, None] * np.append(level[1:], 0.0)[:, None]
    moments = per_decision_moments(
        walk, discounts, sources=sources, offsets=offsets, q=1.0 / mass[0]
    )
    return Moments(
        dot(factor, level), moments.variance, bias, moments.by_step, moments.by_state
    )


def _step_weights(walk: Walk, horizon: int, power: int) -> tuple[Array, Array]:
    """Compute E[W^power] and E[W^power r_t] of the weight of each step's reward."""
    before = walk.weights_by_state(horizon, power=power)[:horizon, 0]
    chance = walk.act * walk.u**power
    mass = np.ones(walk.act.shape[1])
    rewards = walk.rewards[0]
    if walk.by_transition:
        weighted = walk.row_matrix(walk.prob * walk.w**power)
        mass = row_sums(weighted)
        rewards = row_sums(weighted, weighted.data * rewards)
    weight = (before * walk.sum_actions(chance * mass)).sum(axis=1)
    total = (before * walk.sum_actions(chance * rewards)).sum(axis=1)
    return np.asarray(weight), np.asarray(total)


def _combine(
    walk: Walk, discounts: Array, out: Array, local: Array, p: float | None, q: float
) -> Moments:
    """Combine the kernel's output into the moments of X = p L + q R.

    -Cov(L, X) stands as the ``bias``. If ``p`` is None, X has no L, and the bias is 0.
    The variance is split by step and state where the kernel kept what each step adds
    (``local``).
    """
    # values of the other states must not count, since they may be infinite
    begin = np.flatnonzero(walk.initial)
    initial = walk.initial[begin]
    mean_l, mean_r, var_l, cov, var_r = out[:, begin]
    length = dot(initial, mean_l)
    total = dot(initial, mean_r)
    off = q * (mean_r - total)
    variance = q * q * var_r
    bias = 0.0
    # p is 0 where a self-normalised mean is, and the bias need not be
    if p is not None:
        off += p * (mean_l - length)
        variance += p * p * var_l + 2.0 * p * q * cov
        bias = -dot(initial, (mean_l - length) * off + p * var_l + q * cov)
    start = dot(initial, off**2)
    level = 0.0 if p is None else p
    mean = q * total + level * length
    whole = start + max(dot(initial, variance), 0.0)
    if len(local) == 0:
        return Moments(mean, whole, bias)
    shares = _variance_shares(walk, discounts, local, level, q)
    by_step = np.concatenate([[start], shares.sum(axis=1)])
    return Moments(mean, whole, bias, by_step, shares.sum(axis=0))


def _variance_shares(
    walk: Walk, discounts: Array, local: Array, p: float, q: float
) -> Array:
    """Compute what each step adds to Var X in each state, of shape (T, S).

    It is E[(p_t, q_t) C_t (p_t, q_t)^T] with q_t = factor W, p_t = W (p + q G) and the
    step's own covariance C_t (``local``).
    """
    is_trajectory = local.shape[1] == 3
    weights = walk.weights_by_state(len(discounts), power=2, with_returns=is_trajectory)
    before = weights[:-1]
    factor = (q * np.cumprod(np.append(1.0, discounts[:-1])))[:, None]
    shares = factor**2 * before[:, 0] * local[:, -1]
    if is_trajectory:
        b0 = before[:, 0]
        b1 = before[:, 1]
        b2 = before[:, 2]
        shares += (p * p * b0 + 2.0 * p * q * b1 + q * q * b2) * local[:, 0]
        shares += 2.0 * factor * (p * b0 + q * b1) * local[:, 1]
    return np.asarray(shares)


def infinite_moments(walk: Walk, sources: bool) -> Moments:
    """Compute the moments of the infinite sum by two linear systems.

    A DivergentKernelError is raised where a moment does not exist.
    """
    first = walk.weighted_kernel(1)
    second = walk.weighted_kernel(2)
    gamma = walk.discount
    n = walk.n_states
    rows = walk.rows
    if gamma == 1.0:
        raise ArgumentError(
            "horizon",
            "must be given: at discount 1 the infinite sum's variance is not"
            " worked out",
        )
    chance = walk.act[0][rows] * walk.prob
    f = walk.u[0][rows]
    state = rows // (walk.act.shape[1] // n)
    rewards = walk.w * walk.rewards[0] if walk.by_transition else walk.rewards[0][rows]
    expected = np.bincount(state, chance * f * rewards, n).astype(np.float64)
    mean = solve_policy_system(first, expected, gamma).x
    value = f * (rewards + gamma * walk.w * mean[walk.indices])
    squares = chance * (value - mean[state]) ** 2
    own: Array = np.bincount(state, squares, n).astype(np.float64)
    try:
        variance = solve_policy_system(second, own, gamma**2).x
    except DivergentKernelError as error:
        raise DivergentKernelError(
            "horizon must be given: the infinite sum has no variance, the second"
            f" moment of its weights grows too fast ({error})"
        ) from None
    out = np.zeros((5, n))
    out[1] = mean
    out[4] = np.maximum(variance, 0.0)
    result = _combine(walk, np.zeros(0), out, np.zeros((0, 1, n)), None, 1.0)
    if not sources:
        return result
    reached = solve_policy_system(second, walk.initial, gamma**2, transpose=True).x
    return Moments(result.mean, result.variance, 0.0, None, reached * own)


def scale_moments(moments: Moments, shift: int) -> Moments:
    """Return the moments of 2^shift X, given those of X.

    A warning says where they are not finite, or the variance is beyond floats.
    """
    if shift != 0:
        with np.errstate(over="ignore", under="ignore"):
            deviation = float(np.ldexp(moments.standard_deviation, shift))
            moments = Moments(
                mean=float(np.ldexp(moments.mean, shift)),
                variance=float(np.ldexp(moments.variance, 2 * shift)),
                bias=float(np.ldexp(moments.bias, shift)),
                by_step=_scale_parts(moments.by_step, 2 * shift),
                by_state=_scale_parts(moments.by_state, 2 * shift),
                _deviation=deviation,
            )
        is_too_small = moments.variance < np.finfo(float).tiny < deviation
        is_too_large = moments.variance == np.inf > deviation
        if is_too_small or is_too_large:
            _checks.warn(
                f"the variance {moments.variance:g} is beyond floats;"
                " standard_deviation has its root",
                NumericalWarning,
            )
    if not np.isfinite([moments.mean, moments.standard_deviation]).all():
        _checks.warn(
            "a moment is beyond the largest float: the weights or the rewards are too"
            " large; or all weights of a step are 0",
            NumericalWarning,
        )
    return moments


def _scale_parts(parts: Array | None, shift: int) -> Array | None:
    """Return 2^shift times the parts of a variance, where there are some."""
    return None if parts is None else np.ldexp(parts, shift)
