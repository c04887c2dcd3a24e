"""Exact means and variances of returns and of weighted returns, by dynamic programming.

The estimators are averages over n independent episodes of X; ``Moments`` has the mean and the variance of one X (so that the
estimator's variance is ``variance / n``). Recursions in ``kernels.moments``; definitions in each function. Reward timing: a
reward r(s, a) at t carries the ratios of the moves before it, zeta_1 .. zeta_t, a reward r(s, a, s') also that of its own
move. After an episode is over (an absorbing state) weights stand still.

Sources: the recursions of the second moment are Sobel's [1]; self-normalised estimators as ratio estimators [2, 2.6]; doubly
robust per decision [3].

References: [1] M. J. Sobel, The variance of discounted Markov decision processes, J. Applied Probability 19, 1982. [2] W. G.
Cochran, Sampling Techniques, 1977. [3] N. Jiang and L. Li, Doubly robust off-policy value evaluation, ICML 2016.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums
from oee_tabular._threads import dot, one_thread
from oee_tabular.exact.finite import locked
from oee_tabular.exact.linear import exponent, spectral_radius
from oee_tabular.exact.walks import (
    Moments,
    Walk,
    entries,
    forward_measure,
    infinite,
    per_decision,
    require_mdp,
    scaled_moments,
    walk_of,
    weighted_kernel,
)
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import SHORT, followed

KINDS = ("per_decision", "trajectory")
Kind = Literal["per_decision", "trajectory"]


def return_moments(mdp: FiniteMDP, policy: Any, *, horizon: int | None = None, sources: bool = False) -> Moments:
    """Mean and variance of the return G = sum_t gamma^t r_t of one episode.

    Var G = Var V_0(s_0) + sum_t gamma^2t E Var[r_t + gamma V_{t+1}(s_{t+1}) | s_t].

    Parameters
    ----------
    mdp : FiniteMDP
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None (discount below 1)
    sources : whether ``by_step`` (finite horizon) and ``by_state`` are filled in

    Examples
    --------
    >>> import numpy as np
    >>> coin = FiniteMDP(np.full((2, 1, 2), 0.5), np.array([0.0, 1.0]), np.array([0.5, 0.5]), 0.5)
    >>> return_moments(coin, np.ones((2, 1)), horizon=2)  # a fair coin, and half another: 1/4 + 1/16
    Moments(mean=0.75, variance=0.3125, bias=0.0)
    """
    require_mdp(mdp)
    _checks.boolean(sources, "sources")
    steps = _checks.optional_horizon(horizon)
    pi = check_policy(policy, mdp, horizon=steps)
    return _moments(walk_of(mdp, pi), "per_decision", steps, False, sources)


def weighted_return_moments(
    simulator: FiniteMDP,
    zeta: Any,
    policy: Any,
    *,
    kind: Kind = "per_decision",
    horizon: int | None = None,
    self_normalized: bool = False,
    sources: bool = False,
) -> Moments:
    """Of the paper's product of ratios on one rollout of the simulator, W_t = zeta_1 ... zeta_t.

    In absorbing states that pay nothing, where an episode is over, W_t stands still whatever zeta is there.

    per_decision: X = sum_t gamma^t W_t r_t; trajectory: X = W_{T-1} G (W_T where rewards depend on s').

    Parameters
    ----------
    simulator, policy, horizon : as in ``return_moments``
    zeta : csr (S*A, S) or an object with such ``values``, on the simulator's support
    kind : "per_decision" | "trajectory" (finite horizon only: its weight has no limit)
    self_normalized : divide by the sum of the weights, per step for per_decision
    sources : as in ``return_moments``

    Raises
    ------
    ValueError
        Bad arguments; without a horizon, where the second moment does not exist: the spectral radius of gamma^2 (P zeta^2)
        under the policy is not below 1 (it is given).

    Notes
    -----
    The mean per decision is J of the model zeta * P. Cost: O(T nnz), or two sparse solves.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> found = weighted_return_moments(simulator, oee.true_ratio(target, simulator), [[1.0]] * 2)
    >>> round(found.mean, 6), round(found.variance, 4)  # unbiased: J in the target is 1.1
    (1.1, 0.4251)
    """
    require_mdp(simulator, "simulator")
    _checks.one_of(kind, "kind", KINDS)
    _checks.boolean(self_normalized, "self_normalized")
    _checks.boolean(sources, "sources")
    steps = _checks.optional_horizon(horizon)
    pi = check_policy(policy, simulator, horizon=steps)
    return _moments(walk_of(simulator, pi, ratio=zeta), kind, steps, self_normalized, sources)


def policy_is_moments(
    mdp: FiniteMDP,
    behavior_policy: Any,
    policy: Any,
    *,
    kind: Kind = "per_decision",
    horizon: int | None = None,
    self_normalized: bool = False,
    sources: bool = False,
) -> Moments:
    """Of policy importance sampling (eq. 3.5) on an episode of ``behavior_policy``, rho_t = prod_{k <= t} policy / behavior.

    per_decision: X = sum_t gamma^t rho_t r_t; trajectory: X = rho_{T-1} G. In absorbing states that pay nothing, where an
    episode is over, rho_t stands still whatever the two policies do there.

    Parameters
    ----------
    mdp : FiniteMDP, the environment that the episodes are from
    behavior_policy, policy : (S, A), or (T, S, A) with a horizon T
    kind, horizon, self_normalized, sources : as in ``weighted_return_moments``

    Notes
    -----
    Where the behaviour policy never takes an action that the policy takes, the mean is that of what is left: it is not J.

    Examples
    --------
    >>> bandit = FiniteMDP([[[1.0], [1.0]]], [[0.0, 1.0]], [1.0], 0.5)
    >>> policy_is_moments(bandit, [[0.5, 0.5]], [[0.0, 1.0]], horizon=1)  # 0 or 2, evenly
    Moments(mean=1.0, variance=1.0, bias=0.0)
    """
    require_mdp(mdp)
    _checks.one_of(kind, "kind", KINDS)
    _checks.boolean(self_normalized, "self_normalized")
    _checks.boolean(sources, "sources")
    steps = _checks.optional_horizon(horizon)
    behavior = check_policy(behavior_policy, mdp, name="behavior_policy", horizon=steps)
    pi = check_policy(policy, mdp, horizon=steps)
    if behavior.ndim != pi.ndim:
        behavior, pi = np.broadcast_arrays(behavior, pi)
    return _moments(walk_of(mdp, behavior, policy=pi), kind, steps, self_normalized, sources)


def _moments(walk: Walk, kind: str, steps: int | None, self_normalized: bool, sources: bool) -> Moments:
    shift = _exponent(walk)
    scaled = walk if shift == 0 else replace(walk, pay=locked(np.ldexp(walk.pay, -shift)))
    with np.errstate(over="ignore", invalid="ignore"):  # of weights: said below
        return scaled_moments(_of_scaled(scaled, kind, steps, self_normalized, sources), shift)


def _exponent(walk: Walk) -> int:
    """That of the largest reward that is reached: others may be of any size."""
    if exponent(walk.pay) == 0:
        return 0
    taken = walk.act.max(axis=0) > 0.0
    row = np.repeat(np.arange(len(taken)), np.diff(walk.indptr.astype(np.int64)))
    state, reached = np.arange(len(taken)) // (len(taken) // walk.n_states), walk.initial > 0.0
    while True:
        rows = taken & reached[state]
        ahead = reached.copy()
        ahead[walk.indices[rows[row]]] = True
        if (ahead == reached).all():
            return exponent(walk.pay[rows[row]] if walk.by_move else walk.pay[rows])
        reached = ahead


def _of_scaled(walk: Walk, kind: str, steps: int | None, self_normalized: bool, sources: bool) -> Moments:
    if steps is None:
        if kind == "trajectory" or self_normalized:
            what = "trajectory" if kind == "trajectory" else "self-normalised"
            raise ValueError(f"horizon must be given: the infinite sum has no variance for {what} weights")
        return infinite(walk, sources)
    steps = _followed(walk, steps, kind == "trajectory" or self_normalized, sources)
    if kind == "trajectory":
        return _trajectory(walk, steps, self_normalized, sources)
    if self_normalized:
        return _per_step_ratio(walk, steps, sources)
    return per_decision(walk, steps, sources=sources)


def _followed(walk: Walk, steps: int, lasting: bool, sources: bool) -> int:
    """The steps of a horizon that are carried out; weights that grow faster than the discount, or stay, keep all of them."""
    if steps <= SHORT or len(walk.act) > 1:
        return steps
    rate = walk.discount
    if not (bool(np.all(walk.u == 1.0)) and bool(np.all(walk.w == 1.0))):
        first, second = (_radius(weighted_kernel(walk, power)) for power in (1, 2))
        rate = 1.0 if lasting else max(rate, rate * first, rate**2 * second)
    kept = 10.0 * walk.n_states if sources or lasting else 4.0
    return followed(steps, rate, ahead=walk.n_states, work=4.0 * len(walk.prob), kept=kept)


def _trajectory(walk: Walk, steps: int, self_normalized: bool, sources: bool) -> Moments:
    from oee_tabular.exact import _moments as kernel

    n = walk.n_states
    out, local = np.empty((5, n)), np.empty((steps if sources else 1, 3, n))
    kernel.trajectory(steps, *walk.shape, walk.discount, out, local, sources)
    first, initial = walk.first
    out = out[:, first]
    weight, value = np.float64(dot(initial, out[0])), dot(initial, out[1])
    off = np.stack([out[0] - weight, out[1] - value])
    products = off[0] ** 2, off[0] * off[1], off[1] ** 2
    start = np.array([dot(initial, x) for x in products])
    parts = np.zeros((0, 3, n))
    if sources:  # step t's share given the prefix: W^2 Var(G L' + gamma^t L' R')
        before = forward_measure(walk, steps, power=2, returns=True)[:steps]
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


def _per_step_ratio(walk: Walk, steps: int, sources: bool) -> Moments:
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
    before = forward_measure(walk, steps, power=power)[:steps, 0]
    n_actions = walk.act.shape[1] // walk.n_states
    rows = np.repeat(np.arange(walk.act.shape[1]), np.diff(walk.indptr))
    times = walk.act.shape[0]
    chance = walk.act * walk.u**power  # (1 or T, S*A)
    if walk.by_move:
        moved = walk.prob * walk.w**power
        mass_of = np.stack([np.bincount(rows, moved, walk.act.shape[1])] * times) * chance
        paid_of = np.stack([np.bincount(rows, moved * walk.pay, walk.act.shape[1])] * times) * chance
    else:
        mass_of, paid_of = chance, chance * walk.pay
    by_state = [x.reshape(times, walk.n_states, n_actions).sum(axis=2) for x in (mass_of, paid_of)]
    return np.asarray((before * by_state[0]).sum(axis=1)), np.asarray((before * by_state[1]).sum(axis=1))


def doubly_robust_moments(
    simulator: FiniteMDP,
    zeta: Any,
    policy: Any,
    *,
    baseline: Any = None,
    horizon: int,
    action_baseline: bool = False,
    sources: bool = False,
) -> Moments:
    """Of the doubly robust estimator on one rollout of the simulator.

    D_t = r_t + gamma [m_t(s_t, a_t) + zeta_{t+1} (D_{t+1} - U_{t+1}(s_{t+1}))], m_t(s, a) = sum_s' zeta P U_{t+1}(s'); for
    rewards r(s, a, s'), r(s, a, s') + gamma U takes the place of gamma U and m_t has E[zeta r] in it. Its mean is J of
    zeta * P for every U.

    Parameters
    ----------
    simulator, zeta, policy : as in ``weighted_return_moments``
    baseline : U, (T + 1, S) values to go at t (row T is not used); None: those of the simulator
    horizon : T
    action_baseline : whether m and the reward are replaced by their mean over the policy's actions; with U the true
        values that leaves Var V_0(s_0) alone
    sources : as in ``return_moments``

    Notes
    -----
    With U = 0 the per-decision estimator. Cost: O(T nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> known = simulator, oee.true_ratio(target, simulator), [[1.0]] * 2
    >>> robust, product = doubly_robust_moments(*known, horizon=3), weighted_return_moments(*known, horizon=3)
    >>> round(robust.mean, 6), round(product.mean, 6), round(robust.variance, 4), round(product.variance, 4)
    (0.95, 0.95, 0.25, 0.3823)
    """
    require_mdp(simulator, "simulator")
    _checks.boolean(action_baseline, "action_baseline")
    _checks.boolean(sources, "sources")
    steps = _checks.positive_integer(horizon, "horizon")
    pi = check_policy(policy, simulator)
    walk = walk_of(simulator, pi, ratio=zeta)
    if baseline is None:
        steps = _followed(walk, steps, False, True)
    u = values_to_go(walk_of(simulator, pi), steps) if baseline is None else _checks.float_array(baseline, "baseline")
    if u.shape != (steps + 1, simulator.n_states):
        raise ValueError(
            f"baseline must have shape {(steps + 1, simulator.n_states)}, values to go at t; it has {u.shape}"
        )
    _checks.require_finite(u, "baseline")
    shift = exponent(np.concatenate([walk.pay, u.ravel()]))
    u = np.ldexp(u, -shift)
    u[steps] = 0.0
    walk = replace(walk, pay=locked(np.ldexp(walk.pay, -shift)))
    weighted = entries(walk, walk.prob * walk.w)
    paid = row_sums(weighted, weighted.data * walk.pay) if walk.by_move else walk.pay
    known = np.empty((steps, walk.act.shape[1]))  # all of the step that the baseline knows
    for t in range(steps):
        known[t] = walk.discount * (weighted @ u[t + 1]) + paid
    quiet = replace(walk, pay=np.zeros(len(walk.pay)))
    if action_baseline:
        mean = (walk.act * known).reshape(steps, simulator.n_states, -1).sum(axis=2)
        return scaled_moments(per_decision(quiet, steps, h=mean, k=u, sources=sources), shift)
    return scaled_moments(per_decision(quiet, steps, c=known, k=u, sources=sources), shift)


def values_to_go(walk: Walk, steps: int) -> Array:
    """(T + 1, S): the unweighted expected return from t on."""
    values = np.zeros((steps + 1, walk.n_states))
    plain = entries(walk, walk.prob)
    paid = row_sums(plain, walk.prob * walk.pay) if walk.by_move else walk.pay
    for t in range(steps - 1, -1, -1):
        act = walk.act[t if walk.act.shape[0] > 1 else 0]
        values[t] = (act * (paid + walk.discount * (plain @ values[t + 1]))).reshape(walk.n_states, -1).sum(axis=1)
    return values


def weight_moments(simulator: FiniteMDP, zeta: Any, policy: Any, *, horizon: int) -> tuple[Array, Array]:
    """E[W_t] and E[W_t^2] for t = 0..T, W_t = zeta_1 ... zeta_t: two (T + 1,) arrays.

    In absorbing states that pay nothing, where an episode is over, W_t stands still whatever zeta is there.

    E[W_t] = 1 for every t where the rows of zeta * P sum to 1; log E[W_t^2] / t -> ``weight_growth``.

    Parameters
    ----------
    simulator, zeta : as in ``weighted_return_moments``
    policy : (S, A) or (T, S, A)
    horizon : T, a positive int

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> first, second = weight_moments(simulator, oee.true_ratio(target, simulator), [[1.0]] * 2, horizon=3)
    >>> first.round(6).tolist(), second.round(4).tolist()  # 1.04^t
    ([1.0, 1.0, 1.0, 1.0], [1.0, 1.04, 1.0816, 1.1249])
    """
    require_mdp(simulator, "simulator")
    steps = _checks.positive_integer(horizon, "horizon")
    pi = check_policy(policy, simulator, horizon=steps)
    walk = walk_of(simulator, pi, ratio=zeta)
    steps = followed(steps, 1.0, work=4.0 * len(walk.prob), kept=6.0 * walk.n_states)
    first, second = (forward_measure(walk, steps, power=power)[:, 0].sum(axis=1) for power in (1, 2))
    return first, second


def _radius(matrix: sparse.csr_array) -> float:
    if not np.isfinite(matrix.data).all():
        return np.inf  # of squares beyond the largest float
    if matrix.shape[0] <= 400:
        return float(np.abs(np.linalg.eigvals(matrix.toarray())).max())
    return spectral_radius(matrix)


@one_thread
def weight_growth(simulator: FiniteMDP, zeta: Any, policy: Any) -> float:
    """log of the spectral radius of (P zeta^2) under the policy: the rate at which E[W_t^2] grows, nats a step.

    Nonnegative where rows of zeta * P sum to 1, 0 only where zeta = 1 on the moves that recur. Of a reducible chain the
    largest over all classes.

    Parameters
    ----------
    simulator, zeta : as in ``weighted_return_moments``
    policy : (S, A)

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> round(weight_growth(simulator, oee.true_ratio(target, simulator), [[1.0]] * 2), 4)  # log 1.04
    0.0392
    """
    require_mdp(simulator, "simulator")
    walk = walk_of(simulator, check_policy(policy, simulator), ratio=zeta)
    radius = _radius(weighted_kernel(walk, 2))
    return float(np.log(radius)) if radius > 0 else -np.inf
