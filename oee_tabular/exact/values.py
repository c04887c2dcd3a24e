"""Values of a policy: V(s), Q(s, a) and J = mu_0 . V (the paper's equation for
J_P(pi)).

A horizon T means the rewards at t = 0, ..., T-1; None the infinite discounted sum.
``normalized=True`` multiplies by (1 - discount), for both kinds of horizon.

Each policy system, (I - gamma P) x = b or its transpose, is solved with a bound on the error: |x - x*|_inf <= |M^-1|_inf
|residual|_inf, rounding included. ``solvers`` says which solver is asked, and where the norm of the inverse comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import check_csr
from oee_tabular.exact import _system, finite, solvers
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import (
    Kernel,
    System,
    drop_states,
    exponent,
    policy_system,
    recurrent_states,
    rows_of,
)
from oee_tabular.exceptions import ArgumentError, NumericalWarning
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.horizons import horizon_length, optional_horizon_length
from oee_tabular.typing import Array, PolicyLike


@dataclass(frozen=True)
class LinearSolution:
    """A solution of ``solve_policy_system`` with a bound on its error.

    Attributes
    ----------
    x : (S,)
    error_bound : of |x - x*|_inf (of |x - x*|_1 for a transposed system), rounding
        included
    method : "dense LU", "LU in a band", "value iteration", "BiCGSTAB" or "sparse LU"

    Examples
    --------
    >>> solution = solve_policy_system(sparse.csr_array([[0.5, 0.5], [0.0, 1.0]]), np.array([1.0, 0.0]), 0.5)
    >>> solution.x.round(4).tolist(), solution.error_bound < 1e-12, solution.method
    ([1.3333, 0.0], True, 'dense LU')
    """

    x: Array
    error_bound: float
    method: str


def solve_policy_system(
    kernel: sparse.csr_array, b: Array, discount: float, *, transpose: bool = False
) -> LinearSolution:
    """Solve (I - discount K) x = b, or the transposed system, for a nonnegative kernel
    K.

    Parameters
    ----------
    kernel : csr (S, S), nonnegative; its rows may have any sum
    b : (S,)
    discount : float in [0, 1]
    transpose : whether (I - discount K)^T x = b is solved: occupancies instead of
        values

    Raises
    ------
    ValueError
        A kernel that is not square, sparse, finite and nonnegative, a right side of
        another length or not finite.
    DivergentKernelError
        A ValueError: the spectral radius of discount * K is not below 1.

    Notes
    -----
    Cost: O(S^3) up to 100 states; one pass where few states can reach each other
    (layered models); else a few dozen sparse sweeps.

    Examples
    --------
    The share of discounted time in each state, from state 0:

    >>> kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    >>> solve_policy_system(kernel, np.array([0.5, 0.0]), 0.5, transpose=True).x.round(4).tolist()
    [0.6667, 0.3333]
    """
    _checks.boolean(transpose, "transpose")
    rows = _check_kernel(kernel)
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    right = _checks.float_array(b, "b", ndim=1)
    if len(right) != rows.shape[0]:
        raise ArgumentError(
            "b", f"must have {rows.shape[0]} entries, one a state; it has {len(right)}"
        )
    _checks.require_finite(right, "b")
    return solve(System(Kernel(*rows_of(rows), gamma), transpose), right)


def solve(
    system: System, b: Array, *, rounding: float = 0.0, near: Array | None = None
) -> LinearSolution:
    """M x = b where every number has been checked; each entry of b is ``rounding`` from
    what it stands for, at most.

    ``near`` : about x, to begin with.
    """
    norm = solvers.inverse_norm(system)
    shift = exponent(b)
    if shift == 0:
        solution = solvers.answer(system, b, near)
        return LinearSolution(
            solution.x, float(norm * (solution.bound + rounding)), solution.method
        )
    # dot products would leave the range of floats
    solution = solvers.answer(system, np.ldexp(b, -shift))
    with np.errstate(over="ignore", under="ignore"):
        x = np.ldexp(solution.x, shift)
        bound = float(np.ldexp(norm * solution.bound, shift))
    bound += norm * rounding + len(x) * 5e-324  # what is subnormal is rounded once more
    return LinearSolution(x, bound if np.isfinite(x).all() else np.inf, solution.method)


def _check_kernel(kernel: Any) -> sparse.csr_array:
    """The kernel as the solvers read it."""
    if not sparse.issparse(kernel):
        raise ArgumentError(
            "kernel", f"must be a sparse matrix; got {type(kernel).__name__}"
        )
    if kernel.ndim != 2 or kernel.shape[0] != kernel.shape[1] or kernel.shape[0] == 0:
        raise ArgumentError(
            "kernel", f"must be square, (S, S); it has shape {kernel.shape}"
        )
    rows = check_csr(kernel, "kernel")
    bad = np.flatnonzero(~(np.isfinite(rows.data) & (rows.data >= 0.0)))
    if bad.size:
        place = (
            int(np.searchsorted(rows.indptr, bad[0], side="right")) - 1,
            int(rows.indices[bad[0]]),
        )
        raise ArgumentError(
            "kernel",
            f"must be finite and nonnegative; kernel[{place[0]}, {place[1]}] is"
            f" {rows.data[bad[0]]}",
        )
    return rows


EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class PolicyValues:
    """V and J of a policy.

    ``error_bound`` bounds |V - V*|_inf, from the residual of the linear system (0 for a
    finite horizon, where the sums are carried out as they stand); ``method`` names the
    solver.
    """

    values: Array
    value: float
    error_bound: float
    method: str


def policy_rewards(model: Model, policy: Array) -> Array:
    """(S,): sum_a policy[s, a] r(s, a)."""
    return np.asarray(
        _system.average_rewards(np.ascontiguousarray(policy), model.rewards)[0]
    )


def evaluate_policy(
    model: Model, policy: PolicyLike, *, horizon: int | None = None
) -> PolicyValues:
    """Compute V, J and a bound on their error.

    Finite horizon: V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0; infinite: (I - gamma P_pi)
    V = r_pi.

    Parameters
    ----------
    model : FiniteMDP (or a ReweightedModel, whose rows may have any sum)
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None

    Returns
    -------
    PolicyValues
        ``values`` (S,), ``value`` (J), ``error_bound`` of |V - V*|_inf and ``method``.
        V* is the exact solution for the numbers as they are stored: transitions, policy
        and ``rewards`` (S, A), the rounded expectation of r(s, a, s').

    Raises
    ------
    ValueError
        Bad arguments; without a horizon, a sum that does not exist (discount 1 and a
        policy that is not absorbed in states without reward, or a kernel whose spectral
        radius times the discount is not below 1).

    Notes
    -----
    With a horizon the recursion goes backward over all states. Cost: O(T * nnz), or one
    sparse solve. Values beyond the largest float are infinite, and the error bound then
    is.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> result = evaluate_policy(coin, [[1.0]] * 2)
    >>> result.values.round(6).tolist(), round(result.value, 6), result.error_bound < 1e-12
    ([0.5, 1.5], 1.0, True)
    """
    require_model(model, "model")
    steps = None if horizon is None else horizon_length(horizon, model, policy)
    pi = check_policy(policy, model, horizon=steps)
    if steps is None:
        return infinite_values(model, pi)
    values = _backward(model, pi, steps)
    bound = 0.0 if np.isfinite(values).all() else np.inf
    return PolicyValues(
        values, finite.initial_mean(model, values), bound, "backward recursion"
    )


def infinite_values(
    model: Model, policy: Array, near: Array | None = None
) -> PolicyValues:
    """V of the infinite sum; the bound on its error counts the rounding of the policy's
    kernel and rewards.

    ``near`` (S,): about V, to begin with.
    """
    rewards, largest = _system.average_rewards(
        np.ascontiguousarray(policy), model.rewards
    )
    system = policy_system(model, policy)
    if model.discount == 1.0:
        recurrent = recurrent_states(system, rewards, model.names)
        if recurrent.all():
            return PolicyValues(np.zeros(len(rewards)), 0.0, 0.0, "absorbed")
        system = drop_states(system, recurrent)
    rounding = (model.n_actions + 1) * (EPS * largest + 5e-324)
    solution = solve(system, rewards, rounding=rounding, near=near)
    return PolicyValues(
        solution.x,
        finite.initial_mean(model, solution.x),
        solution.error_bound,
        solution.method,
    )


def warn_if_not_finite(values: Any) -> Any:
    """The same values, with a warning where one is not finite."""
    if not np.isfinite(values).all():
        _checks.warn(
            "a value is beyond the largest float: it is infinite, or not a number",
            NumericalWarning,
        )
    return values


def finite_values(solution: PolicyValues) -> Array:
    """V, with a warning where a value is not finite."""
    is_finite = isfinite(solution.error_bound)  # which it is of finite values alone
    return (
        solution.values
        if is_finite
        else np.asarray(warn_if_not_finite(solution.values))
    )


def _backward(model: Model, policy: Array, steps: int) -> Array:
    """V with the last ``steps`` of a policy's steps to go."""
    if policy.ndim == 2:
        return np.asarray(finite.values_to_go(model, policy, steps, is_each=False)[0])
    value = np.zeros(model.n_states)
    for act in policy[len(policy) - steps :][::-1]:
        value = np.einsum("sa,sa->s", act, backup(model, value))
    return value


def backup(model: Model, value: Array) -> Array:
    """(S, A): r(s, a) + gamma sum_s' K(s' | s, a) V(s')."""
    following = np.empty(model.rewards.size)
    _system.multiply(Kernel(*rows_of(model.csr), 1.0), False, value, following)
    return np.asarray(
        model.rewards + model.discount * following.reshape(model.rewards.shape)
    )


def policy_value(
    mdp: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    normalized: bool = False,
) -> float:
    """Compute J = E[sum_t gamma^t r_t] exactly by dynamic programming (eq. 3.1).

    Parameters
    ----------
    mdp : FiniteMDP (or a ReweightedModel)
    policy, horizon : as in ``evaluate_policy``, whose errors are these, and its cost;
        with a horizon it sums over the light cone: only the states that are reached
        within it cost anything
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
    require_model(mdp)
    if _checks.boolean(normalized, "normalized") and mdp.discount == 1.0:
        raise ArgumentError(
            "normalized",
            "must be False at discount 1: the factor (1 - discount) would be 0",
        )
    factor = 1.0 - mdp.discount if normalized else 1.0
    if horizon is None:
        value = factor * evaluate_policy(mdp, policy).value
    else:
        steps = horizon_length(horizon, mdp, policy)
        pi = check_policy(policy, mdp, horizon=steps)
        value = factor * float(
            finite.values_by_horizon(mdp, pi, steps, is_each=False)[-1]
        )
    return value if isfinite(value) else float(warn_if_not_finite(value))


def state_values(
    mdp: Model, policy: PolicyLike, *, horizon: int | None = None
) -> Array:
    """Compute V(s) = E[sum_t gamma^t r_t | s_0 = s], shape (S,); not normalised (eq.
    4.1).

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
    require_model(mdp)
    return finite_values(evaluate_policy(mdp, policy, horizon=horizon))


def action_values(
    mdp: Model, policy: PolicyLike, *, horizon: int | None = None
) -> Array:
    """Compute Q(s, a) = r(s, a) + gamma E[V(s_1) | s, a], shape (S, A); with a horizon,
    V has one step less to go.

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
    require_model(mdp)
    steps = optional_horizon_length(horizon, mdp, policy)
    if steps is None:
        return backup(mdp, state_values(mdp, policy))
    pi = check_policy(policy, mdp, horizon=steps)
    return np.asarray(warn_if_not_finite(backup(mdp, _backward(mdp, pi, steps - 1))))
