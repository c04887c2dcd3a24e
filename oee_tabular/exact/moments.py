"""Exact means and variances of returns and of weighted returns, by dynamic programming.

The estimators are averages over n independent episodes of X; ``Moments`` has the mean
and the variance of one X (so that the estimator's variance is ``variance / n``). The
recursions are in ``recursions``; each function defines its X. A reward r(s, a) at t
carries the ratios of the transitions before it, zeta_1 .. zeta_t, a reward r(s, a, s')
also the ratio of its own transition. In an absorbing state, where an episode has
ended, weights are constant.

Sources: the recursions of the second moment are Sobel's [1]; self-normalised estimators
as ratio estimators [2, 2.6]; doubly robust per decision [3].

References: [1] M. J. Sobel, The variance of discounted Markov decision processes, J.
Applied Probability 19, 1982. [2] W. G. Cochran, Sampling Techniques, 1977. [3] N. Jiang
and L. Li, Doubly robust off-policy value evaluation, ICML 2016.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import row_sums
from oee_tabular.exact.finite import values_to_go
from oee_tabular.exact.recursions import (
    Moments,
    compute_moments,
    limit_walk,
    per_decision_moments,
    scale_moments,
)
from oee_tabular.exact.reweighted import RatioLike
from oee_tabular.exact.system import as_readonly, exponent
from oee_tabular.exact.walks import walk_of
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.typing import PolicyLike, RealArrayLike

KINDS = ("per_decision", "trajectory")
Kind = Literal["per_decision", "trajectory"]


def _check_arguments(
    model: FiniteMDP,
    name: str,
    horizon: int | None,
    *,
    kind: object = "per_decision",
    **flags: bool,
) -> tuple[int | None, dict[str, bool]]:
    """Check what the functions share; return the horizon and the options."""
    _checks.instance(model, FiniteMDP, name)
    _checks.one_of(kind, "kind", KINDS)
    for flag, value in flags.items():
        _checks.boolean(value, flag)
    return _checks.optional_horizon(horizon), {
        "is_trajectory": kind == "trajectory",
        **flags,
    }


@suggest_keywords
def return_moments(
    mdp: FiniteMDP,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of the return G = sum_t gamma^t r_t of one episode.

    Parameters
    ----------
    mdp : FiniteMDP
        The model in which the policy is evaluated.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.
    sources : bool, default False
        Whether ``by_state`` and, with a horizon, ``by_step`` are filled in.

    Returns
    -------
    Moments
        Mean and variance of G.

    Raises
    ------
    ValueError
        If an argument is bad, or at discount 1 without a horizon.

    See Also
    --------
    weighted_return_moments : Moments of returns that are weighted by ratios.
    policy_value : The mean alone.

    Notes
    -----
    Var G = Var V_0(s_0) + sum_t gamma^2t E Var[r_t + gamma V_{t+1}(s_{t+1}) | s_t].
    Costs O(T nnz) with a horizon, two sparse solves without.

    Examples
    --------
    A fair coin, and half another, have the variance 1/4 + 1/16:

    >>> import numpy as np
    >>> half = np.array([0.5, 0.5])
    >>> coin = FiniteMDP(np.full((2, 1, 2), 0.5), np.array([0.0, 1.0]), half, 0.5)
    >>> return_moments(coin, np.ones((2, 1)), horizon=2)
    Moments(mean=0.75, variance=0.3125, bias=0.0)
    """
    length, options = _check_arguments(
        mdp, "mdp", horizon, self_normalized=False, sources=sources
    )
    pi = check_policy(policy, mdp, horizon=length)
    return compute_moments(walk_of(mdp, pi), length, **options)


@suggest_keywords
def weighted_return_moments(
    simulator: FiniteMDP,
    zeta: RatioLike,
    policy: PolicyLike,
    *,
    kind: Kind = "per_decision",
    horizon: int | None = None,
    self_normalized: bool = False,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of the paper's product of ratios on one rollout.

    With W_t = zeta_1 ... zeta_t, per decision X = sum_t gamma^t W_t r_t, and for the
    trajectory X = W_{T-1} G, with W_T where rewards depend on s'. In absorbing states
    with reward 0, where an episode has ended, W_t is constant.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator that the rollout is from.
    zeta : sparse array of shape (S*A, S), or an object with such ``values``
        The ratio of transition probabilities, row s*A + a, on the simulator's support.
        An entry that is not stored is 0.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    kind : {'per_decision', 'trajectory'}, default 'per_decision'
        What is averaged. "trajectory" needs a horizon, because its weight has no limit.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.
    self_normalized : bool, default False
        Whether sums are divided by the sum of their weights, separately for each step
        if ``kind`` is "per_decision".
    sources : bool, default False
        Whether ``by_state`` and, with a horizon, ``by_step`` are filled in.

    Returns
    -------
    Moments
        Mean and variance of X. For a self-normalised estimator, its limit, its
        asymptotic variance and its leading bias.

    Raises
    ------
    ValueError
        If an argument is bad; without a horizon, if the second moment does not exist
        because the spectral radius of gamma^2 (P zeta^2) under the policy is not below
        1 (the error gives it).

    See Also
    --------
    policy_is_moments : Moments of importance sampling over policies.
    doubly_robust_moments : Moments of the doubly robust estimator.
    sample_returns : Samples of X.

    Notes
    -----
    The mean per decision is J of the model zeta * P. Costs O(T nnz), or two sparse
    solves.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> target = oee.FiniteMDP([[[0.4, 0.6]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> zeta = oee.true_ratio(target, simulator)
    >>> moments = weighted_return_moments(simulator, zeta, [[1.0]] * 2)
    >>> round(moments.mean, 6), round(moments.variance, 4)  # J in the target is 1.1
    (1.1, 0.4251)
    """
    flags = {"self_normalized": self_normalized, "sources": sources}
    length, options = _check_arguments(
        simulator, "simulator", horizon, kind=kind, **flags
    )
    pi = check_policy(policy, simulator, horizon=length)
    return compute_moments(walk_of(simulator, pi, ratio=zeta), length, **options)


@suggest_keywords
def policy_is_moments(
    mdp: FiniteMDP,
    behavior_policy: PolicyLike,
    policy: PolicyLike,
    *,
    kind: Kind = "per_decision",
    horizon: int | None = None,
    self_normalized: bool = False,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of policy importance sampling on one episode (eq. 3.5).

    The episode is from ``behavior_policy``. With rho_t = prod_{k <= t} policy /
    behavior, per decision X = sum_t gamma^t rho_t r_t, and for the trajectory X =
    rho_{T-1} G. rho_t is constant after an episode's end.

    Parameters
    ----------
    mdp : FiniteMDP
        The environment that the episode is from.
    behavior_policy : PolicyLike
        The policy that acted, of shape (S, A), or (T, S, A) with a horizon T.
    policy : PolicyLike
        The evaluated policy, of shape (S, A), or (T, S, A) with a horizon T.
    kind : {'per_decision', 'trajectory'}, default 'per_decision'
        What is averaged. "trajectory" needs a horizon, because its weight has no limit.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.
    self_normalized : bool, default False
        Whether sums are divided by the sum of their weights, separately for each step
        if ``kind`` is "per_decision".
    sources : bool, default False
        Whether ``by_state`` and, with a horizon, ``by_step`` are filled in.

    Returns
    -------
    Moments
        Mean and variance of X. For a self-normalised estimator, its limit, its
        asymptotic variance and its leading bias.

    Raises
    ------
    ValueError
        As in ``weighted_return_moments``.

    See Also
    --------
    weighted_return_moments : Moments of the product of ratios of transitions.

    Notes
    -----
    If the behaviour policy never takes an action that the policy takes, the mean is not
    J. Costs O(T nnz), or two sparse solves.

    Examples
    --------
    >>> bandit = FiniteMDP([[[1.0], [1.0]]], [[0.0, 1.0]], [1.0], 0.5)
    >>> # 0 or 2, evenly
    >>> policy_is_moments(bandit, [[0.5, 0.5]], [[0.0, 1.0]], horizon=1)
    Moments(mean=1.0, variance=1.0, bias=0.0)
    """
    flags = {"self_normalized": self_normalized, "sources": sources}
    length, options = _check_arguments(mdp, "mdp", horizon, kind=kind, **flags)
    behavior = check_policy(
        behavior_policy, mdp, name="behavior_policy", horizon=length
    )
    pi = check_policy(policy, mdp, horizon=length)
    # where one of them is stationary, it is repeated for each step
    if behavior.ndim != pi.ndim:
        shape = (behavior if behavior.ndim == 3 else pi).shape
        behavior = np.broadcast_to(behavior, shape)
        pi = np.broadcast_to(pi, shape)
    return compute_moments(walk_of(mdp, behavior, policy=pi), length, **options)


@suggest_keywords
def doubly_robust_moments(
    simulator: FiniteMDP,
    zeta: RatioLike,
    policy: PolicyLike,
    *,
    baseline: RealArrayLike | None = None,
    horizon: int,
    action_baseline: bool = False,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of the doubly robust estimator on one rollout.

    The rollout is from the simulator. D_t = r_t + gamma [m_t(s_t, a_t) + zeta_{t+1}
    (D_{t+1} - U_{t+1}(s_{t+1}))], m_t(s, a) = sum_s' zeta P U_{t+1}(s').

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator that the rollout is from.
    zeta : sparse array of shape (S*A, S), or an object with such ``values``
        The ratio of transition probabilities, row s*A + a, on the simulator's support.
        An entry that is not stored is 0.
    policy : PolicyLike
        Stationary action probabilities of shape (S, A); other forms as in
        ``check_policy``.
    baseline : array_like of shape (T + 1, S), optional
        U, values to go at t (row T is not used). None means the simulator's values.
    horizon : int
        Number of rewards T, at t = 0..T-1.
    action_baseline : bool, default False
        Whether m and the reward are replaced by their mean over the policy's actions.
        If U has the true values, Var V_0(s_0) alone is left.
    sources : bool, default False
        Whether ``by_state`` and, with a horizon, ``by_step`` are filled in.

    Returns
    -------
    Moments
        Mean and variance of D_0.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    weighted_return_moments : The same with U = 0, per decision.

    Notes
    -----
    For rewards r(s, a, s'), r(s, a, s') + gamma U takes the place of gamma U and m_t
    has E[zeta r] in it. The mean is J of zeta * P for every U. With U = 0 this is the
    per-decision estimator. Costs O(T nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> target = oee.FiniteMDP([[[0.4, 0.6]]] * 2, [0, 1], [0.5, 0.5], 0.5)
    >>> zeta = oee.true_ratio(target, simulator)
    >>> known = simulator, zeta, [[1.0]] * 2
    >>> robust = doubly_robust_moments(*known, horizon=3)
    >>> product = weighted_return_moments(*known, horizon=3)
    >>> round(robust.mean, 6), round(product.mean, 6)
    (0.95, 0.95)
    >>> round(robust.variance, 4), round(product.variance, 4)
    (0.25, 0.3823)
    """
    _check_arguments(
        simulator, "simulator", None, action_baseline=action_baseline, sources=sources
    )
    length = _checks.positive_integer(horizon, "horizon")
    pi = check_policy(policy, simulator)
    walk = walk_of(simulator, pi, ratio=zeta)
    if baseline is None:
        length = limit_walk(walk, length, False, True)
        u = values_to_go(simulator, pi, length)
    else:
        u = _checks.float_array(baseline, "baseline")
    if u.shape != (length + 1, simulator.n_states):
        raise ArgumentError(
            "baseline",
            f"must have shape {(length + 1, simulator.n_states)}, values to go at t; it"
            f" has {u.shape}",
        )
    _checks.require_finite(u, "baseline")
    # rewards and values are scaled so that their squares stay within floats
    shift = exponent(np.concatenate([walk.rewards.ravel(), u.ravel()]))
    ahead = walk.discount * np.ldexp(u[1:], -shift)
    rewards = np.ldexp(walk.rewards[0], -shift)
    ahead[-1] = 0.0
    weighted = walk.row_matrix(walk.prob * walk.w)
    if walk.by_transition:
        rewards = row_sums(weighted, weighted.data * rewards)
    # (T, S*A): for each step, the mean m that the baseline gives
    known = np.array([weighted @ x for x in ahead]) + rewards
    discounts = np.full(length, walk.discount)
    if not action_baseline:
        # D = known + w (gamma D' - gamma U')
        walk = walk._replace(by_transition=False, rewards=as_readonly(known))
        moments = per_decision_moments(walk, discounts, offsets=ahead, sources=sources)
        return scale_moments(moments, shift)
    # D = its mean over actions + w (gamma D' - gamma U'). The mean is no part of the
    # recursion: it is taken out of D' and U', and added at the start
    mean = walk.sum_actions(walk.act * known)
    ahead[:-1] -= walk.discount * mean[1:]
    walk = walk._replace(rewards=as_readonly(np.zeros_like(walk.rewards)))
    moments = per_decision_moments(
        walk, discounts, offsets=ahead, start=mean[0], sources=sources
    )
    return scale_moments(moments, shift)
