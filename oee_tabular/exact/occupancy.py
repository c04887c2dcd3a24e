"""Discounted occupancies, and the gradient of J in the transition probabilities.

Occupancies are d(s), d(s, a) and d(s, a, s'), the paper's d_P^pi, normalised to sum to
1. Together with the values they give the derivative of J with respect to each
transition probability, which carries sampling error from a model to J.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, overload

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import csr_on_pattern, repeat_rows
from oee_tabular.exact.backup import back_up_transitions
from oee_tabular.exact.finite import gradient_to_horizon, visits
from oee_tabular.exact.reach import solve_where_reached
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import drop_states, policy_system, recurrent_states
from oee_tabular.exact.values import policy_rewards, solve, values_or_zeros
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import check_policy, optional_horizon_length, total_discount
from oee_tabular.typing import Array, Csr, PolicyLike, RealArrayLike


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
) -> Csr: ...


@suggest_keywords
def occupancy(
    mdp: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    of: Literal["state", "state_action", "transition"] = "state_action",
) -> Array | Csr:
    """Compute the discounted occupancy of states, pairs or transitions (eq. 3.2, 3.3).

    d(s, a) = sum_t gamma^t Pr(s_t = s, a_t = a) / sum_t gamma^t, over t = 0..T-1 or
    over all t.

    Parameters
    ----------
    mdp : FiniteMDP or ReweightedModel
        The model in which the policy is evaluated.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    horizon : int, optional
        The number T of times, t = 0..T-1. None means all times, which needs a discount
        below 1.
    of : {'state', 'state_action', 'transition'}, default 'state_action'
        What the occupancy is of.

    Returns
    -------
    ndarray or csr_array
        The occupancy, which sums to 1: of shape (S,) for states, (S, A) for
        state-action pairs, and a csr_array of shape (S*A, S), aligned with
        ``mdp.transitions``, for transitions.

    Raises
    ------
    ValueError
        If an argument is bad, or at discount 1 without a horizon.

    See Also
    --------
    transition_gradient : The derivative of J in each transition probability.
    policy_value : J, which is d . r * sum_t gamma^t.

    Notes
    -----
    J = d . r * sum_t gamma^t. Costs O(T nnz) with a horizon, one sparse solve without.

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
        pairs = visits(mdp, pi, steps) / total_discount(mdp.discount, steps)
    if of == "state":
        return np.asarray(pairs.sum(axis=1))
    if of == "state_action":
        return pairs
    data = repeat_rows(mdp.csr, pairs.reshape(-1)) * mdp.csr.data
    return csr_on_pattern(mdp.csr, data, own=True)


def infinite_visits(model: Model, policy: Array) -> Array:
    """Compute sum_t gamma^t Pr(s_t = s) over all t, of shape (S,), by one sparse solve.

    At discount 1 it is 0 in states that the policy never leaves, where V is 0, and a
    DivergentKernelError is raised where the policy is not absorbed in states with
    reward 0. What it never reaches does not matter.
    """
    visits, _ = solve_where_reached(lambda act: _visits_of(model, act), model, policy)
    return visits


def _visits_of(model: Model, policy: Array) -> Array:
    """Compute the visits of a policy whose rows are 0 in states that are left out."""
    system = policy_system(model, policy)
    recurrent = np.zeros(model.n_states, dtype=np.bool_)
    if model.discount == 1.0:
        rewards = policy_rewards(model, policy)
        recurrent = recurrent_states(system, rewards, model.names)
        system = drop_states(system, recurrent)
    visits = solve(replace(system, transpose=True), model.initial).x
    # rounding may leave a visit a little below 0
    return np.where(recurrent, 0.0, np.maximum(visits, 0.0))


def time_in_pairs(model: Model, policy: Array, horizon: int | None) -> Array:
    """Compute the share of time in each state-action pair, of shape (S, A).

    This is the ``occupancy``, but at discount 1 without a horizon the shares of the
    time until the policy is absorbed.
    """
    if horizon is None and model.discount == 1.0:
        visits = infinite_visits(model, policy)[:, None] * policy
        # all shares are 0 where the policy is absorbed at once
        return np.asarray(visits / (float(visits.sum()) or 1.0))
    return occupancy(model, policy, horizon=horizon)


@suggest_keywords
def transition_gradient(
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    values_of: Model | None = None,
    values: RealArrayLike | None = None,
    time: RealArrayLike | None = None,
) -> Array:
    """Compute dJ / dP(s' | s, a), aligned with ``model.transitions.data``.

    sum_t gamma^t alpha_t(s, a) [r(s, a, s') + gamma V_{t+1}(s')], where alpha_t is the
    distribution of (s_t, a_t); r stands there only where rewards depend on s'. The
    gradient is defined up to a constant in each row, because rows sum to 1.

    Parameters
    ----------
    model : FiniteMDP or ReweightedModel
        The model at whose transition probabilities the gradient is taken.
    policy : PolicyLike
        Stationary action probabilities of shape (S, A); other forms as in
        ``check_policy``.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.
    values_of : FiniteMDP or ReweightedModel, optional
        The model whose V and rewards are used; the result is aligned with its
        ``transitions.data``. None means ``model``.
    values : array_like of shape (S,), optional
        V of that model, finite where it is known, and nan elsewhere. It is not used
        with a horizon.
    time : array_like of shape (S, A), optional
        ``occupancy(model, policy)``, where it is known; finite and nonnegative. It is
        used below discount 1 without a horizon.

    Returns
    -------
    ndarray of shape (nnz,)
        The derivative in each stored transition probability, in units of J.

    Raises
    ------
    ValueError
        If an argument is bad, or if the infinite sum does not exist.

    See Also
    --------
    occupancy : The distribution alpha, summed over time.
    efficiency_bound : The variance that follows from the gradient.

    Notes
    -----
    Costs O(T nnz) time and O(T S) memory, or two sparse solves. At discount 1 without a
    horizon the policy must be absorbed in states with reward 0; the derivative is 0
    there.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> gradient = transition_gradient(coin, [[1.0]] * 2)
    >>> gradient.round(6).tolist()  # 0.5 V(s'), V = (0.5, 1.5), in each row
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
    known = None if values is None else _check_values(values, model)
    shares = None if time is None else _check_time(time, model)
    if steps is not None:
        return gradient_to_horizon(model, valued, pi, steps)
    if known is None:
        known = values_or_zeros(valued, pi)
    gradient = back_up_transitions(valued, known)
    if shares is None or model.discount == 1.0:
        times = infinite_visits(model, pi)
    else:
        times = shares.sum(axis=1) / (1.0 - model.discount)
    weight = repeat_rows(valued.csr, (times[:, None] * pi).reshape(-1))
    gradient *= weight
    # V may be nan in states that are never reached
    if values is not None and np.isnan(known).any():
        gradient[weight == 0.0] = 0.0
    return np.asarray(gradient)


def _check_values(values: RealArrayLike, model: Model) -> Array:
    """Return V as (S,) numbers, of which those that are not known are nan."""
    array = _checks.float_array(values, "values")
    _checks.require_shape(array, "values", (model.n_states,))
    _checks.require_no_infinity(array, "values")
    return array


def _check_time(time: RealArrayLike, model: Model) -> Array:
    """Return the shares of time in state-action pairs as (S, A) numbers."""
    array = _checks.float_array(time, "time")
    _checks.require_shape(array, "time", model.rewards.shape)
    _checks.require_nonnegative(array, "time")
    return array
