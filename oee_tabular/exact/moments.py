"""Exact means and variances of returns and of weighted returns, by dynamic programming.

The estimators are averages over n independent episodes of X; ``Moments`` has the mean
and the variance of one X (so that the estimator's variance is ``variance / n``).
Recursions in ``recursions``; definitions in each function. Reward timing: a reward r(s,
a) at t carries the ratios of the transitions before it, zeta_1 .. zeta_t, a reward r(s,
a, s') also that of its own transition. In an absorbing state, where an episode has
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
from oee_tabular._sparse import row_sums
from oee_tabular.exact.finite import values_to_go
from oee_tabular.exact.recursions import (
    Moments,
    compute_moments,
    limit_walk,
    per_decision_moments,
    scale_moments,
)
from oee_tabular.exact.system import as_readonly, exponent
from oee_tabular.exact.walks import walk_of
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.typing import PolicyLike

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
    """The horizon, and the options of ``compute_moments``."""
    _checks.instance(model, FiniteMDP, name)
    _checks.one_of(kind, "kind", KINDS)
    for flag, value in flags.items():
        _checks.boolean(value, flag)
    return _checks.optional_horizon(horizon), {
        "is_trajectory": kind == "trajectory",
        **flags,
    }


def return_moments(
    mdp: FiniteMDP,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of the return G = sum_t gamma^t r_t of one episode.

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
    length, options = _check_arguments(
        mdp, "mdp", horizon, self_normalized=False, sources=sources
    )
    return compute_moments(
        walk_of(mdp, check_policy(policy, mdp, horizon=length)), length, **options
    )


def weighted_return_moments(
    simulator: FiniteMDP,
    zeta: object,
    policy: PolicyLike,
    *,
    kind: Kind = "per_decision",
    horizon: int | None = None,
    self_normalized: bool = False,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of the paper's product of ratios on one rollout, W_t =
    zeta_1 ... zeta_t.

    In absorbing states with reward 0, where an episode has ended, W_t is constant.

    per_decision: X = sum_t gamma^t W_t r_t; trajectory: X = W_{T-1} G (W_T where
    rewards depend on s').

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
        Bad arguments; without a horizon, if the second moment does not exist: the
        spectral radius of gamma^2 (P zeta^2) under the policy is not below 1 (it is
        given).

    Notes
    -----
    The mean per decision is J of the model zeta * P. Cost: O(T nnz), or two sparse
    solves.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> simulator, target = (oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.5) for p in (0.5, 0.6))
    >>> moments = weighted_return_moments(simulator, oee.true_ratio(target, simulator), [[1.0]] * 2)
    >>> round(moments.mean, 6), round(moments.variance, 4)  # unbiased: J in the target is 1.1
    (1.1, 0.4251)
    """
    flags = {"self_normalized": self_normalized, "sources": sources}
    length, options = _check_arguments(
        simulator, "simulator", horizon, kind=kind, **flags
    )
    walk = walk_of(
        simulator, check_policy(policy, simulator, horizon=length), ratio=zeta
    )
    return compute_moments(walk, length, **options)


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
    """Compute mean and variance of policy importance sampling (eq. 3.5) on one episode
    of ``behavior_policy``.

    rho_t = prod_{k <= t} policy / behavior; per_decision: X = sum_t gamma^t rho_t r_t;
    trajectory: X = rho_{T-1} G. rho_t is constant after an episode's end.

    Parameters
    ----------
    mdp : FiniteMDP, the environment that the episodes are from
    behavior_policy, policy : (S, A), or (T, S, A) with a horizon T
    kind, horizon, self_normalized, sources : as in ``weighted_return_moments``

    Notes
    -----
    If the behaviour policy never takes an action that the policy takes, the mean is not
    J.

    Examples
    --------
    >>> bandit = FiniteMDP([[[1.0], [1.0]]], [[0.0, 1.0]], [1.0], 0.5)
    >>> policy_is_moments(bandit, [[0.5, 0.5]], [[0.0, 1.0]], horizon=1)  # 0 or 2, evenly
    Moments(mean=1.0, variance=1.0, bias=0.0)
    """
    flags = {"self_normalized": self_normalized, "sources": sources}
    length, options = _check_arguments(mdp, "mdp", horizon, kind=kind, **flags)
    behavior = check_policy(
        behavior_policy, mdp, name="behavior_policy", horizon=length
    )
    pi = check_policy(policy, mdp, horizon=length)
    if behavior.ndim != pi.ndim:
        shape = (behavior if behavior.ndim == 3 else pi).shape
        behavior = np.broadcast_to(behavior, shape)
        pi = np.broadcast_to(pi, shape)
    return compute_moments(walk_of(mdp, behavior, policy=pi), length, **options)


def doubly_robust_moments(
    simulator: FiniteMDP,
    zeta: object,
    policy: PolicyLike,
    *,
    baseline: object = None,
    horizon: int,
    action_baseline: bool = False,
    sources: bool = False,
) -> Moments:
    """Compute mean and variance of the doubly robust estimator on one rollout of the
    simulator.

    D_t = r_t + gamma [m_t(s_t, a_t) + zeta_{t+1} (D_{t+1} - U_{t+1}(s_{t+1}))], m_t(s,
    a) = sum_s' zeta P U_{t+1}(s'); for rewards r(s, a, s'), r(s, a, s') + gamma U takes
    the place of gamma U and m_t has E[zeta r] in it. Its mean is J of zeta * P for
    every U.

    Parameters
    ----------
    simulator, zeta, policy : as in ``weighted_return_moments``
    baseline : U, (T + 1, S) values to go at t (row T is not used); None: those of the
        simulator
    horizon : T
    action_baseline : whether m and the reward are replaced by their mean over the
        policy's actions; with U the true values that leaves Var V_0(s_0) alone
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
    shift = exponent(np.concatenate([walk.rewards.ravel(), u.ravel()]))
    ahead = walk.discount * np.ldexp(u[1:], -shift)
    rewards = np.ldexp(walk.rewards[0], -shift)
    ahead[-1] = 0.0
    weighted = walk.row_matrix(walk.prob * walk.w)
    if walk.by_transition:
        rewards = row_sums(weighted, weighted.data * rewards)
    # (T, S*A): of each step, what the baseline knows
    known = np.array([weighted @ x for x in ahead]) + rewards
    discounts = np.full(length, walk.discount)
    if not action_baseline:  # D = known + w (gamma D' - gamma U')
        walk = walk._replace(by_transition=False, rewards=as_readonly(known))
        return scale_moments(
            per_decision_moments(walk, discounts, offsets=ahead, sources=sources), shift
        )
    # D = its mean over actions + w (gamma D' - gamma U'): without that mean, it is of
    # D' and U' that theirs is left out
    mean = walk.sum_actions(walk.act * known)
    ahead[:-1] -= walk.discount * mean[1:]
    walk = walk._replace(rewards=as_readonly(np.zeros_like(walk.rewards)))
    moments = per_decision_moments(
        walk, discounts, offsets=ahead, start=mean[0], sources=sources
    )
    return scale_moments(moments, shift)
