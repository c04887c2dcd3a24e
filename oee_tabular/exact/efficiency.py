"""Efficiency bounds, and the exact asymptotic variance and bias of some estimators.

Notation: G_x(s') = dJ / dP'(s' | x) is the gradient of ``transition_gradient``, x = (s,
a), at the target P'; for an infinite horizon and rewards r(s, a) that is gamma d(x)
V(s') / (1 - gamma). Values are discounted sums. The bounds for transition data are for
n independent rows x ~ data_distribution, s' ~ P'(. | x), where the initial distribution
and the rewards are known.

References: [1] N. Kallus and M. Uehara, Double reinforcement learning for efficient
off-policy evaluation in Markov decision processes, JMLR 21, 2020. [2] A. W. van der
Vaart, Asymptotic Statistics, 1998, chapters 20 and 25.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import dot, one_thread
from oee_tabular._sparse import align, row_of_entry, row_sums, row_variances
from oee_tabular.exact.backup import back_up_transitions
from oee_tabular.exact.finite import values_to_go
from oee_tabular.exact.occupancy import occupancy, transition_gradient
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import state_values
from oee_tabular.exact.walks import walk_of
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, horizon_length, require_available
from oee_tabular.typing import Array, PolicyLike, RealArrayLike


@suggest_keywords
def efficiency_bound(
    target: FiniteMDP,
    policy: PolicyLike,
    data_distribution: RealArrayLike,
    *,
    horizon: int | None = None,
) -> float:
    """Compute lim n * variance of the best estimator of J from n target transitions.

    Parameters
    ----------
    target : FiniteMDP
        The environment that the data are from.
    policy : PolicyLike
        The evaluated policy, of shape (S, A).
    data_distribution : array_like of shape (S, A)
        How state-action pairs of the data are drawn. It sums to 1.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum
        (discount below 1).

    Returns
    -------
    float
        The bound, in squared units of J. It is inf if the data never have a pair whose
        next state matters.

    Raises
    ------
    ValueError
        If an argument is bad, or at discount 1 without a horizon.

    See Also
    --------
    trajectory_efficiency_bound : The bound from n episodes.
    ratio_of_ratios_variance : The variance of the paper's estimator.

    Notes
    -----
    sum_x Var_{s' ~ P'(.|x)}[G_x(s')] / data_distribution(x); for r(s, a) and an
    infinite horizon (gamma / (1 - gamma))^2 sum_x d(x)^2 / data_distribution(x)
    Var_{P'}[V]. The maximum-likelihood model attains it [2].

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> bound = efficiency_bound(coin, [[1.0]] * 2, [[0.5], [0.5]])
    >>> round(bound, 6)  # no standard error below sqrt(0.25 / n)
    0.25
    """
    share = _check_share(target, data_distribution, horizon)
    gradient = transition_gradient(target, policy, horizon=horizon)
    variances = row_variances(target.transitions, target.transitions.data, gradient)
    return _divide_and_sum(variances, share)


@one_thread
def leading_bias(
    target: FiniteMDP, policy: PolicyLike, data_distribution: RealArrayLike
) -> float:
    """Compute lim n * bias of J of the maximum-likelihood model, infinite horizon.

    The model is fitted to n target transitions; the bias is its expected J less J.

    Parameters
    ----------
    target : FiniteMDP
        The environment that the data are from.
    policy : PolicyLike
        The evaluated policy, of shape (S, A).
    data_distribution : array_like of shape (S, A)
        How state-action pairs of the data are drawn. It sums to 1.

    Returns
    -------
    float
        The limit, in units of J, not normalised. It is inf if the data never have a
        pair that matters.

    Raises
    ------
    ValueError
        If an argument is bad, or at discount 1.

    See Also
    --------
    efficiency_bound : The variance that the same model attains.

    Notes
    -----
    gamma / (1 - gamma) sum_x d(x) / data_distribution(x) Cov_{s' ~ P'(.|x)}(U_x(s'),
    r(s, a, s') + gamma V(s')), where U_x(s') is the expected discounted number of
    visits to x from s' (the reward is left out where it does not depend on s'). Costs
    O(S^3 + nnz S).

    Examples
    --------
    With n = 1000 transitions J is 0.0017 too low on average:

    >>> import oee_tabular as oee
    >>> rows = [[[0.9, 0.1]], [[0.5, 0.5]]]
    >>> target = oee.FiniteMDP(rows, [0.0, 1.0], [1.0, 0.0], 0.9)
    >>> round(leading_bias(target, [[1.0]] * 2, [[0.5], [0.5]]), 2)
    -1.67
    """
    share = _check_share(target, data_distribution, None)
    pi = check_policy(policy, target)
    gamma = target.discount
    matrix = target.transitions
    kernel = policy_kernel(target, pi).toarray()
    # (s', s): the expected discounted number of visits to s from s'
    visits = np.linalg.inv(np.eye(target.n_states) - gamma * kernel)
    values = state_values(target, pi)
    rows = row_of_entry(matrix)
    state = rows // target.n_actions
    ahead = back_up_transitions(target, values)
    back = visits[matrix.indices, state] * pi.reshape(-1)[rows]
    mean = row_sums(matrix, matrix.data * ahead)
    covariance = row_sums(matrix, matrix.data * back * (ahead - mean[rows]))
    reached = occupancy(target, pi).reshape(-1)
    return gamma / (1.0 - gamma) * _divide_and_sum(reached * covariance, share)


@suggest_keywords
def ratio_of_ratios_variance(
    simulator: FiniteMDP,
    target: FiniteMDP,
    policy: PolicyLike,
    data_distribution: RealArrayLike,
    simulator_distribution: RealArrayLike,
    *,
    horizon: int | None = None,
    rows: Literal["as_they_are", "normalised"] = "as_they_are",
    independent_samples: bool = False,
) -> float:
    """Compute lim n * variance of J(zeta P) for the paper's zeta, a quotient of ratios.

    The two ratios are fitted to n target transitions and n of the simulator's; the
    simulator is known exactly.

    Parameters
    ----------
    simulator : FiniteMDP
        The simulator P.
    target : FiniteMDP
        The environment that the data are from.
    policy : PolicyLike
        The evaluated policy, of shape (S, A).
    data_distribution : array_like of shape (S, A)
        How state-action pairs of the data are drawn. It sums to 1.
    simulator_distribution : array_like of shape (S, A)
        How the simulator's state-action pairs are drawn. It sums to 1.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum
        (discount below 1).
    rows : {'as_they_are', 'normalised'}, default 'as_they_are'
        Whether each row of zeta * P is divided by its sum.
    independent_samples : bool, default False
        Whether the two ratios are fitted to separate samples.

    Returns
    -------
    float
        The limit, in squared units of J. It is inf if a distribution lacks a pair that
        matters.

    Raises
    ------
    ValueError
        If an argument is bad, or the target has transitions outside the simulator's
        support.

    See Also
    --------
    efficiency_bound : The least variance from the target's transitions.

    Notes
    -----
    It is the bound of ``efficiency_bound`` plus, with q = simulator_distribution, for
    rows as they are sum_x Var_P[zeta G] / q(x), and with separate samples for the (s,
    a) and the (s, a, s') ratio (Algorithm 1, lines 1 and 3) moreover 2 Var_D[E_P' G /
    d_D] + 2 Var_q[E_P' G / q]; for normalised rows sum_x E_P[zeta^2 (G - E_P' G)^2] /
    q(x), whatever the samples of the (s, a) ratio, which a row's sum cancels.

    Examples
    --------
    The simulator's sample adds as much noise as the log does, so that this is twice the
    bound:

    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> data = [[0.5], [0.5]]
    >>> round(ratio_of_ratios_variance(coin, coin, [[1.0]] * 2, data, data), 6)
    0.5
    """
    _checks.boolean(independent_samples, "independent_samples")
    _checks.one_of(rows, "rows", ("as_they_are", "normalised"))
    _checks.instance(simulator, FiniteMDP, "simulator")
    share = _check_share(target, data_distribution, horizon)
    other = _check_share(
        target, simulator_distribution, horizon, "simulator_distribution"
    )
    gradient = transition_gradient(target, policy, horizon=horizon)
    probability, stored = align(simulator.transitions, target.transitions)
    outside = ~stored & (target.transitions.data > 0)
    if outside.any():
        raise ArgumentError(
            "target",
            f"must stay in the simulator's support; {int(outside.sum())} of its"
            " transitions do not",
        )
    matrix = target.transitions
    entry = row_of_entry(matrix)
    zeta = np.divide(
        matrix.data, probability, out=np.zeros_like(probability), where=probability > 0
    )
    mean = row_sums(matrix, matrix.data * gradient)
    total = _divide_and_sum(row_variances(matrix, matrix.data, gradient), share)
    if rows == "normalised":
        added = row_sums(matrix, probability * zeta**2 * (gradient - mean[entry]) ** 2)
    else:
        added = row_sums(matrix, probability * (zeta * gradient) ** 2) - mean**2
    total += _divide_and_sum(np.maximum(added, 0.0), other)
    if independent_samples and rows == "as_they_are":
        for weights in (share, other):
            level = float(mean.sum())
            total += 2.0 * (_divide_and_sum(mean**2, weights) - level**2)
    return total


@suggest_keywords
def trajectory_efficiency_bound(
    mdp: FiniteMDP,
    behavior_policy: PolicyLike,
    policy: PolicyLike,
    *,
    horizon: int,
    model: Literal["mdp", "tree", "stationary"] = "mdp",
) -> float:
    """Compute lim n * variance of the best estimator of J from n episodes.

    Each episode has ``horizon`` transitions. ``model`` says what is known beforehand.

    Parameters
    ----------
    mdp : FiniteMDP
        The target.
    behavior_policy : PolicyLike
        The policy that acted, of shape (S, A).
    policy : PolicyLike
        The evaluated policy, of shape (S, A).
    horizon : int
        Number of rewards T, at t = 0..T-1.
    model : {'mdp', 'tree', 'stationary'}, default 'mdp'
        What estimators may assume: a kernel for each step, transitions that depend on
        the whole history, or one kernel.

    Returns
    -------
    float
        The bound, in squared units of J.

    Raises
    ------
    ValueError
        If an argument is bad, or the behaviour policy never takes an action that the
        policy takes in a reachable state: no estimator is consistent then.

    See Also
    --------
    efficiency_bound : The bound from n independent transitions.

    Notes
    -----
    "mdp", Kallus and Uehara's [1]: the kernel may differ between steps, the
    distribution of the first state is unknown. "tree", theirs too: transitions may
    depend on the whole history. For both

        Var V_0(s_0) + sum_t gamma^2t sum_x weight_t(x) Var[r + gamma V_{t+1}(s') | x],

    weight_t(x) = alpha_t(x)^2 / beta_t(x) ("mdp"; alpha, beta the distributions of
    (s_t, a_t) under the policy and the behaviour policy) and E[rho_0..t^2 1{x_t = x}]
    ("tree"). They apply to estimators that assume no more, such as importance sampling
    and doubly robust ones; an estimator that pools steps can have lower variance.
    "stationary": one kernel, the first state's distribution and the rewards known, the
    Cramer-Rao bound

        sum_x Var_{s' ~ P'(.|x)}[G_x(s')] / sum_t beta_t(x),
        G_x(s') = sum_t gamma^t alpha_t(x) (r + gamma V_{t+1}(s')),

    since the log-likelihood of an episode is a sum over its transitions: a pair's
    information is that of one transition times its expected visits.
    ``estimators.ModelBased`` (maximum likelihood) attains it. It is never above "mdp".

    Examples
    --------
    >>> import oee_tabular as oee
    >>> steer = oee.FiniteMDP(
    ...     [[[0.9, 0.1], [0.1, 0.9]]] * 2, [0.0, 1.0], [1.0, 0.0], 1.0
    ... )
    >>> even, right = [[0.5, 0.5]] * 2, [[0.0, 1.0]] * 2
    >>> for model in ("stationary", "mdp", "tree"):
    ...     bound = trajectory_efficiency_bound(
    ...         steer, even, right, horizon=3, model=model
    ...     )
    ...     print(model, round(bound, 4))
    stationary 0.2547
    mdp 0.4752
    tree 0.54

    Importance sampling has a variance of

    >>> round(oee.policy_is_moments(steer, even, right, horizon=3).variance, 4)
    14.04
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    length = horizon_length(horizon, mdp, kept=12 * mdp.n_states)
    _checks.one_of(model, "model", ("mdp", "tree", "stationary"))
    behavior = check_policy(behavior_policy, mdp, name="behavior_policy")
    pi = check_policy(policy, mdp)
    require_action_support(mdp, behavior, pi, length)
    matrix = mdp.transitions
    if model == "stationary":
        times = walk_of(mdp, behavior).weights_by_state(length, power=1)[:-1, 0]
        visits = times.sum(axis=0)[:, None] * behavior
        gradient = transition_gradient(mdp, pi, horizon=length)
        variances = row_variances(matrix, matrix.data, gradient)
        return _divide_and_sum(variances, visits.reshape(-1))
    weights = _pair_weights(mdp, behavior, pi, length, is_tree=model == "tree")
    values = values_to_go(mdp, pi, length)
    total = dot(mdp.initial, (values[0] - dot(mdp.initial, values[0])) ** 2)
    for t, weight in enumerate(weights):
        ahead = back_up_transitions(mdp, values[t + 1])
        variances = row_variances(matrix, matrix.data, ahead)
        total += mdp.discount ** (2 * t) * dot(weight, variances)
    return total


def _pair_weights(
    mdp: FiniteMDP, behavior: Array, policy: Array, horizon: int, *, is_tree: bool
) -> Array:
    """Compute weight_t(x) of ``trajectory_efficiency_bound``, of shape (T, S*A)."""
    if is_tree:  # E[rho_0..t^2 1{x_t = x}]
        weighted = walk_of(mdp, behavior, policy=policy)
        squares = weighted.weights_by_state(horizon, power=2)[:-1, 0]
        factors = weighted.act * weighted.u**2
        return np.asarray(np.repeat(squares, mdp.n_actions, axis=1) * factors)
    beta = _pair_probabilities(mdp, behavior, horizon)
    alpha = _pair_probabilities(mdp, policy, horizon)
    return np.divide(alpha**2, beta, out=np.zeros_like(beta), where=beta > 0)


def _pair_probabilities(mdp: FiniteMDP, policy: Array, horizon: int) -> Array:
    """Compute Pr(s_t = s, a_t = a) of a policy, of shape (T, S*A)."""
    walk = walk_of(mdp, policy)
    states = walk.weights_by_state(horizon, power=1)[:-1, 0]
    return np.asarray(np.repeat(states, mdp.n_actions, axis=1) * walk.act)


def require_action_support(
    mdp: FiniteMDP, behavior: Array, policy: Array, horizon: int | None
) -> None:
    """Raise a ValueError unless the behaviour policy takes every action it must.

    The error names the first state-action pair that the policy reaches and takes, and
    that the behaviour policy never does.
    """
    missing = (policy > 0) & (behavior == 0) & ~mdp.absorbing()[:, None]
    if missing.any():
        missing &= walk_of(mdp, policy).reachable_states(horizon)[:, None]
    if missing.any():
        s, a = (int(i) for i in np.argwhere(missing)[0])
        raise ArgumentError(
            "behavior_policy",
            "must take every action that the policy takes; in state"
            f" {mdp.names.state(s)} it never takes action {mdp.names.action(a)}"
            f" ({int(missing.sum())} such state-action pairs in all)",
        )


def _check_share(
    target: FiniteMDP,
    distribution: RealArrayLike,
    horizon: int | None,
    name: str = "data_distribution",
) -> Array:
    """Return the distribution of state-action pairs as (S*A,).

    It also checks what every function of data from the target needs.
    """
    _checks.instance(target, FiniteMDP, "target")
    if horizon is None and target.discount == 1.0:
        raise ArgumentError("horizon", "must be given at discount 1")
    shape = (target.n_states, target.n_actions)
    share = _checks.distribution(distribution, name, shape)
    return require_available(share, target, name).reshape(-1)


def _divide_and_sum(values: Array, share: Array) -> float:
    """Compute sum values / share; inf where share is 0 and the value is not."""
    # a variance of 1e-24 of the largest is rounding
    missing = (share == 0) & (np.abs(values) > 1e-24 * np.abs(values).max(initial=0.0))
    if missing.any():
        return float("inf")
    terms = np.divide(values, share, out=np.zeros_like(values), where=share > 0)
    return float(np.sum(terms))
