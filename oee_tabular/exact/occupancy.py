"""Discounted occupancies d(s), d(s, a), d(s, a, s'), the paper's equations for d_P^pi,
normalised to sum to 1; and what they make of values: the derivative of J with respect
to each transition probability, which carries sampling error from a model to J.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, overload

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import csr_on_pattern, row_of_entry
from oee_tabular.exact.finite import gradient_to_horizon, visits
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import drop_states, policy_system, recurrent_states
from oee_tabular.exact.values import policy_rewards, solve, state_values
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.horizons import optional_horizon_length
from oee_tabular.typing import Array, PolicyLike


@overload
def occupancy(
    mdp: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = ...,
    of: Literal["state", "state_action"] = ...,
) -> Array: ...
@overload
def occupancy(
    mdp: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = ...,
    of: Literal["transition"],
) -> sparse.csr_array: ...


def occupancy(
    mdp: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    of: Literal["state", "state_action", "transition"] = "state_action",
) -> Array | sparse.csr_array:
    """Compute the share of discounted time in each state, state-action pair or
    transition (eq. 3.2, 3.3).

    d(s, a) = sum_t gamma^t Pr(s_t = s, a_t = a) / sum_t gamma^t, over t = 0..T-1 or
    over all t.

    Parameters
    ----------
    mdp : FiniteMDP
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None (discount below 1)
    of : "state" -> (S,), "state_action" -> (S, A), "transition" -> csr of shape (S*A,
        S) aligned with mdp.transitions

    Notes
    -----
    It sums to 1, and J = d . r * sum_t gamma^t. Cost: O(T * nnz), or one sparse solve.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> occupancy(coin, [[1.0]] * 2, of="state").round(6).tolist()
    [0.5, 0.5]
    >>> occupancy(coin, [[1.0]] * 2, of="transition").toarray().round(6).tolist()
    [[0.25, 0.25], [0.25, 0.25]]
    """
    require_model(mdp)
    _checks.one_of(of, "of", ("state", "state_action", "transition"))
    steps = optional_horizon_length(horizon, mdp, policy)
    if steps is None:
        pi = check_policy(policy, mdp)
        if mdp.discount == 1.0:
            raise ArgumentError(
                "horizon",
                "must be given: at discount 1 an infinite occupancy cannot be"
                " normalised",
            )
        pairs = (1.0 - mdp.discount) * infinite_visits(mdp, pi)[:, None] * pi
    else:
        pi = check_policy(policy, mdp, horizon=steps)
        pairs = (
            visits(mdp, pi, steps)
            / (mdp.discount ** np.arange(steps, dtype=np.float64)).sum()
        )
    if of == "state":
        return np.asarray(pairs.sum(axis=1))
    if of == "state_action":
        return pairs
    data = pairs.reshape(-1)[row_of_entry(mdp.transitions)] * mdp.transitions.data
    return csr_on_pattern(mdp.transitions, data)


def infinite_visits(model: Model, policy: Array) -> Array:
    """(S,): sum_t gamma^t Pr(s_t = s) over all t; at discount 1 it is 0 in states that
    the policy never leaves, where V is 0.

    DivergentKernelError at discount 1 where the policy is not absorbed in states with
    reward 0. Cost: one sparse solve.
    """
    system = policy_system(model, policy)
    over = np.zeros(model.n_states, dtype=np.bool_)
    if model.discount == 1.0:
        over = recurrent_states(system, policy_rewards(model, policy), model.names)
        system = drop_states(system, over)
    visits = solve(replace(system, transpose=True), model.initial).x
    return np.where(over, 0.0, np.maximum(visits, 0.0))


def time_in_pairs(model: Model, policy: Array, horizon: int | None) -> Array:
    """``occupancy`` of state-action pairs; at discount 1 without a horizon shares of
    the time until the policy is absorbed.
    """
    if horizon is None and model.discount == 1.0:
        visits = infinite_visits(model, policy)[:, None] * policy
        # 0 where all is over at once
        return np.asarray(visits / (float(visits.sum()) or 1.0))
    return occupancy(model, policy, horizon=horizon)


def transition_gradient(
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    values_of: Model | None = None,
    values: Array | None = None,
    time: Array | None = None,
) -> Array:
    """Compute dJ / dP(s' | s, a), aligned with ``model.transitions.data``.

    sum_t gamma^t alpha_t(s, a) [r(s, a, s') + gamma V_{t+1}(s')], where alpha_t is the
    distribution of (s_t, a_t); r stands there only where rewards depend on s'. Defined
    up to a constant in each row (rows sum to 1).

    Parameters
    ----------
    model : FiniteMDP (or a ReweightedModel)
    policy : (S, A), stationary
    horizon : positive int or None
    values_of : the model whose V and rewards are used; the result is aligned with its
        ``transitions.data``. None: ``model``
    values : (S,) that V, where it is known; not used with a horizon
    time : (S, A) ``occupancy(model, policy)``, where it is known; used below discount 1
        without a horizon

    Notes
    -----
    Cost: O(T * nnz) time and O(T * S) memory, or two sparse solves. At discount 1
    without a horizon the policy must be absorbed in states with reward 0; the
    derivative is 0 there.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> transition_gradient(coin, [[1.0]] * 2).round(6).tolist()  # 0.5 V(s'), V = (0.5, 1.5), in each row
    [0.25, 0.75, 0.25, 0.75]
    """
    require_model(model, "model")
    if values_of is not None:
        require_model(values_of, "values_of")
        if values_of.rewards.shape != model.rewards.shape:
            raise ArgumentError(
                "values_of",
                f"must have the model's states and actions, {model.rewards.shape}; it"
                f" has {values_of.rewards.shape}",
            )
    steps = optional_horizon_length(horizon, model, kept=model.n_states)
    pi = check_policy(policy, model)
    valued = model if values_of is None else values_of
    lengths = np.diff(valued.transitions.indptr)
    if steps is None:
        known = state_values(valued, pi) if values is None else values
        gradient = (model.discount * known)[valued.transitions.indices]
        if valued.reward_data is not None:
            gradient += valued.reward_data
        if time is None or model.discount == 1.0:
            visited = infinite_visits(model, pi)
        else:
            visited = time.sum(axis=1) / (1.0 - model.discount)
        gradient *= np.repeat((visited[:, None] * pi).reshape(-1), lengths)
        return np.asarray(gradient)
    return gradient_to_horizon(model, valued, pi, steps)
