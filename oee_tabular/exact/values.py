"""Values of a policy: V(s), Q(s, a) and J = mu_0 . V (the paper's equation for J_P(pi)).

A horizon T means the rewards at t = 0, ..., T-1; None the infinite discounted sum. ``normalized=True`` multiplies by
(1 - discount), for both kinds of horizon.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import row_sums
from oee_tabular.exact.linear import DivergentKernelError, solve_policy_system
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.mdp import check_policy


@dataclass(frozen=True)
class PolicyValues:
    """V and J of a policy.

    ``error_bound`` bounds |V - V*|_inf, from the residual of the linear system (0 for a finite horizon, where the sums
    are carried out as they stand); ``method`` names the solver.
    """

    values: Array
    value: float
    error_bound: float
    method: str


def policy_kernel(model: Model, policy: Array) -> sparse.csr_array:
    """(S, S): sum_a policy[s, a] K(s' | s, a)."""
    n_states, n_actions = model.n_states, model.n_actions
    averaging = sparse.csr_array(
        (policy.reshape(-1), np.arange(n_states * n_actions), np.arange(n_states + 1) * n_actions),
        shape=(n_states, n_states * n_actions),
    )
    return sparse.csr_array(averaging @ model.transitions)


def policy_rewards(model: Model, policy: Array) -> Array:
    """(S,): sum_a policy[s, a] r(s, a)."""
    return np.asarray(np.einsum("sa,sa->s", policy, model.rewards))


def evaluate_policy(model: Model, policy: Any, *, horizon: int | None = None) -> PolicyValues:
    """V, J and a bound on their error.

    Finite horizon: V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0; infinite: (I - gamma P_pi) V = r_pi.

    Parameters
    ----------
    model : FiniteMDP (or a ReweightedModel, whose rows may have any sum)
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None

    Returns
    -------
    PolicyValues
        ``values`` (S,), ``value`` (J), ``error_bound`` of |V - V*|_inf, and ``method``.

    Raises
    ------
    ValueError
        Bad arguments; without a horizon, a sum that does not exist (discount 1 and a policy that is not absorbed in
        states without reward, or a kernel whose spectral radius times the discount is not below 1).

    Notes
    -----
    Cost: O(T * nnz), or one sparse solve.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> found = evaluate_policy(coin, [[1.0]] * 2)
    >>> found.values.round(6).tolist(), round(found.value, 6), found.error_bound < 1e-12
    ([0.5, 1.5], 1.0, True)
    """
    require_model(model)
    steps = _checks.optional_horizon(horizon)
    pi = check_policy(policy, model, horizon=steps)
    if steps is not None:
        values = _backward(model, pi, steps)[0]
        return PolicyValues(values, float(model.initial @ values), 0.0, "backward recursion")
    kernel, rewards = policy_kernel(model, pi), policy_rewards(model, pi)
    if model.discount < 1.0:
        solution = solve_policy_system(kernel, rewards, model.discount)
        values, bound, method = solution.x, solution.error_bound, solution.method
    else:
        values, bound, method = _undiscounted(kernel, rewards)
    return PolicyValues(values, float(model.initial @ values), bound, method)


def _backward(model: Model, policy: Array, horizon: int) -> tuple[Array, Array]:
    """V_0 and V_1 of a T-step problem."""
    value = following = np.zeros(model.n_states)
    if policy.ndim == 2:
        kernel, rewards = policy_kernel(model, policy), policy_rewards(model, policy)
        for _ in range(horizon):
            value, following = rewards + model.discount * (kernel @ value), value
        return value, following
    for t in range(horizon - 1, -1, -1):
        value, following = np.einsum("sa,sa->s", policy[t], _backup(model, value)), value
    return value, following


def _backup(model: Model, value: Array) -> Array:
    return np.asarray(model.rewards + model.discount * (model.transitions @ value).reshape(model.rewards.shape))


def _undiscounted(kernel: sparse.csr_array, rewards: Array) -> tuple[Array, float, str]:
    """Discount 1: the states of closed classes must pay nothing; the others are solved for."""
    _, component = csgraph.connected_components(kernel, directed=True, connection="strong")
    entries = kernel.tocoo()
    flows = entries.data > 0
    crossing = flows & (component[entries.row] != component[entries.col])
    closed = np.ones(component.max() + 1, dtype=np.bool_)
    closed[component[entries.row[crossing]]] = False
    closed[component[row_sums(kernel) < 1.0 - 2.0 * _checks.SUM_TOLERANCE]] = False  # a kernel may lose mass
    recurrent = closed[component]
    paying: IntArray = np.flatnonzero(recurrent & (rewards != 0.0))
    if paying.size:
        raise DivergentKernelError(
            "horizon must be given: at discount 1 the infinite sum exists only where the policy is absorbed in states "
            f"that pay nothing; it stays for ever in {paying.size} states that do, the first: {paying[0]} "
            f"(reward {rewards[paying[0]]:g})"
        )
    values = np.zeros(len(rewards))
    transient = np.flatnonzero(~recurrent)
    if transient.size == 0:
        return values, 0.0, "absorbed"
    inner = sparse.csr_array(kernel[transient][:, transient])
    solution = solve_policy_system(inner, rewards[transient], 1.0)
    values[transient] = solution.x
    return values, solution.error_bound, solution.method


def _normalise(model: Model, normalized: bool) -> float:
    if not normalized:
        return 1.0
    if model.discount == 1.0:
        raise ValueError("normalized must be False at discount 1: the factor (1 - discount) would be 0")
    return 1.0 - model.discount


def policy_value(mdp: Model, policy: Any, *, horizon: int | None = None, normalized: bool = False) -> float:
    """J = E[sum_t gamma^t r_t] from the initial distribution, exactly (by dynamic programming).

    Parameters
    ----------
    mdp : FiniteMDP (or a ReweightedModel)
    policy, horizon : as in ``evaluate_policy``, whose errors and cost are these
    normalized : whether J is multiplied by (1 - discount); an error at discount 1

    Examples
    --------
    >>> import numpy as np
    >>> from oee_tabular.mdp import FiniteMDP
    >>> mdp = FiniteMDP(np.ones((1, 1, 1)), np.array([2.0]), np.array([1.0]), 0.5)
    >>> policy_value(mdp, np.ones((1, 1))), policy_value(mdp, np.ones((1, 1)), horizon=2)
    (4.0, 3.0)
    >>> policy_value(mdp, np.ones((1, 1)), normalized=True)
    2.0
    """
    factor = _normalise(mdp, normalized)
    return factor * evaluate_policy(mdp, policy, horizon=horizon).value


def state_values(mdp: Model, policy: Any, *, horizon: int | None = None) -> Array:
    """V(s) = E[sum_t gamma^t r_t | s_0 = s], shape (S,); not normalised.

    Parameters
    ----------
    mdp : FiniteMDP (or a ReweightedModel)
    policy, horizon : as in ``evaluate_policy``, whose errors and cost are these

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> state_values(coin, [[1.0]] * 2).round(6).tolist(), state_values(coin, [[1.0]] * 2, horizon=2).tolist()
    ([0.5, 1.5], [0.25, 1.25])
    """
    return evaluate_policy(mdp, policy, horizon=horizon).values


def action_values(mdp: Model, policy: Any, *, horizon: int | None = None) -> Array:
    """Q(s, a) = r(s, a) + gamma E[V(s_1) | s, a], shape (S, A); with a horizon, V has one step less to go.

    Parameters
    ----------
    mdp : FiniteMDP (or a ReweightedModel)
    policy, horizon : as in ``evaluate_policy``, whose errors and cost are these

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.FiniteMDP([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1.0, 0.0], [2.0, 2.0]], [1, 0], 0.9)
    >>> action_values(mdp, [[1, 0], [1, 0]]).round(6).tolist()  # for ever 1, or 2 from the next step on
    [[10.0, 18.0], [20.0, 20.0]]
    """
    steps = _checks.optional_horizon(horizon)
    if steps is None:
        return _backup(mdp, state_values(mdp, policy))
    return _backup(mdp, _backward(mdp, check_policy(policy, mdp, horizon=steps), steps)[1])
