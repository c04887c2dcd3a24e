"""Efficiency bounds, and the exact asymptotic variance and bias of some estimators.

Notation: G_x(s') = dJ / dP'(s' | x) is the gradient of ``transition_gradient``, x = (s,
a), at the target P'; for an infinite horizon and rewards r(s, a) that is gamma d(x)
V(s') / (1 - gamma). Values are discounted sums. The bounds for transition data are
those of n independent rows x ~ data_distribution, s' ~ P'(. | x), the initial
distribution and rewards known.

References: [1] N. Kallus and M. Uehara, Double reinforcement learning for efficient
off-policy evaluation in Markov decision processes, JMLR 21, 2020. [2] A. W. van der
Vaart, Asymptotic Statistics, 1998, chapters 20 and 25.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from oee_tabular import _checks
from oee_tabular._parallel import dot, one_thread
from oee_tabular._sparse import align, row_of_entry, row_sums, row_variances
from oee_tabular.exact.finite import values_to_go
from oee_tabular.exact.occupancy import occupancy, transition_gradient
from oee_tabular.exact.system import policy_kernel
from oee_tabular.exact.values import state_values
from oee_tabular.exact.walks import walk_of
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.typing import Array, PolicyLike


def efficiency_bound(
    target: FiniteMDP,
    policy: PolicyLike,
    data_distribution: ArrayLike,
    *,
    horizon: int | None = None,
) -> float:
    """Compute lim n * variance of the best estimator of J from n target transitions.

    sum_x Var_{s' ~ P'(.|x)}[G_x(s')] / data_distribution(x); for r(s, a) and an
    infinite horizon
    (gamma / (1 - gamma))^2 sum_x d(x)^2 / data_distribution(x) Var_{P'}[V]. The
    maximum-likelihood model attains it [2].

    Parameters
    ----------
    target : FiniteMDP
    policy : (S, A)
    data_distribution : (S, A), sums to 1: how state-action pairs are drawn
    horizon : positive int or None (discount below 1)

    Returns
    -------
    float, squared units of J; inf if the data never have a pair whose next state
        matters

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> round(efficiency_bound(coin, [[1.0]] * 2, [[0.5], [0.5]]), 6)  # no standard error below sqrt(0.25 / n)
    0.25
    """
    share = _check_share(target, data_distribution, horizon)
    gradient = transition_gradient(target, policy, horizon=horizon)
    return _divide_and_sum(
        row_variances(target.transitions, target.transitions.data, gradient), share
    )


@one_thread
def leading_bias(
    target: FiniteMDP, policy: PolicyLike, data_distribution: ArrayLike
) -> float:
    """Compute lim n * (E[J of the maximum-likelihood model] - J) from n target
    transitions, infinite horizon.

    gamma / (1 - gamma) sum_x d(x) / data_distribution(x) Cov_{s' ~ P'(.|x)}(U_x(s'),
    r(s, a, s') + gamma V(s')), U_x(s') the expected discounted number of visits to x
    from s' (the reward is left out where it does not depend on s').

    Parameters
    ----------
    target, policy, data_distribution : as in ``efficiency_bound``; discount below 1

    Notes
    -----
    In units of J, not normalised; inf if the data never have a pair that matters. Cost:
    O(S^3 + nnz S).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> target = oee.FiniteMDP([[[0.9, 0.1]], [[0.5, 0.5]]], [0.0, 1.0], [1.0, 0.0], 0.9)
    >>> round(leading_bias(target, [[1.0]] * 2, [[0.5], [0.5]]), 2)  # n = 1000: 0.0017 too low on average
    -1.67
    """
    share = _check_share(target, data_distribution, None)
    pi = check_policy(policy, target)
    gamma = target.discount
    matrix = target.transitions
    kernel = policy_kernel(target, pi).toarray()
    visits = np.linalg.inv(np.eye(target.n_states) - gamma * kernel)  # (s', s)
    values = state_values(target, pi)
    rows = row_of_entry(matrix)
    state = rows // target.n_actions
    ahead = gamma * values[matrix.indices] + (
        0.0 if target.reward_data is None else target.reward_data
    )
    back = visits[matrix.indices, state] * pi.reshape(-1)[rows]
    mean = row_sums(matrix, matrix.data * ahead)
    covariance = row_sums(matrix, matrix.data * back * (ahead - mean[rows]))
    reached = occupancy(target, pi).reshape(-1)
    return gamma / (1.0 - gamma) * _divide_and_sum(reached * covariance, share)


def ratio_of_ratios_variance(
    simulator: FiniteMDP,
    target: FiniteMDP,
    policy: PolicyLike,
    data_distribution: ArrayLike,
    simulator_distribution: Any,
    *,
    horizon: int | None = None,
    rows: Literal["as_they_are", "normalised"] = "as_they_are",
    independent_samples: bool = False,
) -> float:
    """Compute lim n * variance of J(zeta P) for the paper's zeta, a quotient of two
    fitted ratios, under the exact simulator.

    From n target transitions and n of the simulator's. The bound of
    ``efficiency_bound`` plus, q = simulator_distribution, as they are: sum_x Var_P[zeta
    G] / q(x), and with separate samples for the (s, a) and the (s, a, s') ratio
    (Algorithm 1, lines 1 and 3) moreover 2 Var_D[E_P' G / d_D] + 2 Var_q[E_P' G / q];
    rows normalised: sum_x E_P[zeta^2 (G - E_P' G)^2] / q(x), whatever the samples of
    the (s, a) ratio, which a row's sum cancels.

    Parameters
    ----------
    simulator : FiniteMDP
    target, policy, data_distribution, horizon : as in ``efficiency_bound``
    simulator_distribution : (S, A), sums to 1: how the simulator's pairs are drawn
    rows : "as_they_are" | "normalised": whether each row of zeta * P is divided by its
        sum
    independent_samples : whether the two ratios are fitted to separate samples

    Returns
    -------
    float, squared units of J; inf if a distribution lacks a pair that matters

    Raises
    ------
    ValueError
        The target has transitions outside the simulator's support.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> data = [[0.5], [0.5]]  # twice the bound: the simulator's sample adds as much noise as the log does
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
    lost = ~stored & (target.transitions.data > 0)
    if lost.any():
        raise ArgumentError(
            "target",
            f"must stay in the simulator's support; {int(lost.sum())} of its"
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


def trajectory_efficiency_bound(
    mdp: FiniteMDP,
    behavior_policy: PolicyLike,
    policy: PolicyLike,
    *,
    horizon: int,
    model: Literal["mdp", "tree", "stationary"] = "mdp",
) -> float:
    """Compute lim n * variance of the best estimator from n episodes of ``horizon``
    transitions, under three models.

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

        sum_x Var_{s' ~ P'(.|x)}[G_x(s')] / sum_t beta_t(x),    G_x(s') = sum_t gamma^t alpha_t(x) (r + gamma V_{t+1}(s')),

    since the log-likelihood of an episode is a sum over its transitions: a pair's
    information is that of one transition times its expected visits.
    ``estimators.ModelBased`` (maximum likelihood) attains it. Never above "mdp".

    Parameters
    ----------
    mdp : FiniteMDP, the target
    behavior_policy, policy : (S, A)
    horizon : positive int
    model : "mdp" | "tree" | "stationary"

    Returns
    -------
    float, squared units of J

    Raises
    ------
    ValueError
        The behaviour policy never takes an action that the policy takes in a reachable
        state: no estimator is consistent.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> steer = oee.FiniteMDP([[[0.9, 0.1], [0.1, 0.9]]] * 2, [0.0, 1.0], [1.0, 0.0], 1.0)
    >>> even, right = [[0.5, 0.5]] * 2, [[0.0, 1.0]] * 2
    >>> [round(trajectory_efficiency_bound(steer, even, right, horizon=3, model=m), 4) for m in ("stationary", "mdp", "tree")]
    [0.2547, 0.4752, 0.54]
    >>> round(oee.policy_is_moments(steer, even, right, horizon=3).variance, 4)  # importance sampling's
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
        visits = (
            walk_of(mdp, behavior)
            .weights_by_state(length, power=1)[:-1, 0]
            .sum(axis=0)[:, None]
            * behavior
        )
        gradient = transition_gradient(mdp, pi, horizon=length)
        return _divide_and_sum(
            row_variances(matrix, matrix.data, gradient), visits.reshape(-1)
        )
    if model == "tree":  # E[rho_0..t^2 1{x_t = x}]
        weighted = walk_of(mdp, behavior, policy=pi)
        squares = weighted.weights_by_state(length, power=2)[:-1, 0]
        weights = np.repeat(squares, mdp.n_actions, axis=1) * (
            weighted.act * weighted.u**2
        )
    else:
        beta, alpha = (
            np.repeat(
                walk.weights_by_state(length, power=1)[:-1, 0], mdp.n_actions, axis=1
            )
            * walk.act
            for walk in (walk_of(mdp, behavior), walk_of(mdp, pi))
        )
        weights = np.divide(alpha**2, beta, out=np.zeros_like(beta), where=beta > 0)
    values = values_to_go(mdp, pi, length)
    total = dot(mdp.initial, (values[0] - dot(mdp.initial, values[0])) ** 2)
    rewards = 0.0 if mdp.reward_data is None else mdp.reward_data
    for t, weight in enumerate(weights):
        ahead = rewards + mdp.discount * values[t + 1][matrix.indices]
        total += mdp.discount ** (2 * t) * dot(
            weight, row_variances(matrix, matrix.data, ahead)
        )
    return total


def require_action_support(
    mdp: FiniteMDP, behavior: Array, policy: Array, horizon: int | None
) -> None:
    """A ValueError that names the first (s, a) which the policy reaches and takes and
    the behaviour policy never does.
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
    distribution: ArrayLike,
    horizon: int | None,
    name: str = "data_distribution",
) -> Array:
    """The distribution of rows as (S*A,); what every function of data from the target
    needs is checked.
    """
    _checks.instance(target, FiniteMDP, "target")
    if horizon is None and target.discount == 1.0:
        raise ArgumentError("horizon", "must be given at discount 1")
    return _checks.distribution(
        distribution, name, (target.n_states, target.n_actions)
    ).reshape(-1)


def _divide_and_sum(values: Array, share: Array) -> float:
    """sum values / share; inf where share is 0 and the value is not."""
    # rounding is no variance
    missing = (share == 0) & (np.abs(values) > 1e-24 * np.abs(values).max(initial=0.0))
    if missing.any():
        return float("inf")
    return float(
        np.sum(np.divide(values, share, out=np.zeros_like(values), where=share > 0))
    )
