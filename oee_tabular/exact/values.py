"""Values of a policy: V(s), Q(s, a) and J = mu_0 . V (the paper's J_P(pi)).

A horizon T means the rewards at t = 0, ..., T-1; None means the infinite discounted
sum. ``normalized=True`` multiplies by (1 - discount), for both kinds of horizon.

Each policy system, (I - gamma P) x = b or its transpose, is solved with a bound on the
error, ``|x - x*|_inf <= |M^-1|_inf |residual|_inf``, rounding included. ``solvers``
says which solver is used, and where the norm of the inverse comes from.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular._sparse import check_csr
from oee_tabular.exact import _system, backward, finite, solvers
from oee_tabular.exact.backup import back_up_pairs
from oee_tabular.exact.reach import solve_where_reached
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import (
    SMALLEST_FLOAT,
    Kernel,
    System,
    drop_states,
    exponent,
    policy_system,
    recurrent_states,
    rows_of,
)
from oee_tabular.exceptions import ArgumentError, NumericalWarning
from oee_tabular.mdp import check_policy, horizon_length, optional_horizon_length
from oee_tabular.typing import (
    Array,
    BoolArray,
    Csr,
    PolicyLike,
    RealArrayLike,
    SparseLike,
)


@checked()
@dataclass(frozen=True)
class LinearSolution:
    """Hold a solution of ``solve_policy_system`` with a bound on its error.

    Attributes
    ----------
    x : ndarray of shape (S,)
        The solution.
    error_bound : float
        A bound on the largest error ``|x - x*|_inf``, rounding included. For a
        transposed system it bounds the sum of the errors, ``|x - x*|_1``.
    method : str
        The solver: "dense LU", "LU in a band", "value iteration", "BiCGSTAB" or "sparse
        LU".

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    >>> solution = solve_policy_system(kernel, np.array([1.0, 0.0]), 0.5)
    >>> solution.x.round(4).tolist(), solution.error_bound < 1e-12, solution.method
    ([1.3333, 0.0], True, 'dense LU')
    """

    x: Array
    error_bound: float
    method: str


@suggest_keywords
def solve_policy_system(
    kernel: SparseLike, b: RealArrayLike, discount: float, *, transpose: bool = False
) -> LinearSolution:
    """Solve (I - discount K) x = b, or the transposed system, for a nonnegative K.

    Parameters
    ----------
    kernel : sparse array of shape (S, S)
        The nonnegative kernel K. Its rows may have any sum.
    b : array_like of shape (S,)
        The right side.
    discount : float
        The discount, in [0, 1].
    transpose : bool, default False
        Whether (I - discount K)^T x = b is solved, which gives occupancies in place of
        values.

    Returns
    -------
    LinearSolution
        The solution, a bound on its error and the solver that found it.

    Raises
    ------
    ValueError
        If the kernel is not square, sparse, finite and nonnegative, or the right side
        has another length or is not finite.
    DivergentKernelError
        If the spectral radius of discount * K is not below 1. It is a ValueError.

    See Also
    --------
    evaluate_policy : Values of a policy of a model, with the same bound.

    Notes
    -----
    Costs O(S^3) up to 100 states, one pass where few states can reach each other
    (layered models), and a few dozen sparse sweeps for all other kernels.

    Examples
    --------
    The share of discounted time in each state, from state 0:

    >>> import numpy as np
    >>> from scipy import sparse
    >>> kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    >>> start = np.array([0.5, 0.0])
    >>> solve_policy_system(kernel, start, 0.5, transpose=True).x.round(4).tolist()
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
    """Solve M x = b for arguments that have been checked.

    Each entry of b differs from what it stands for by at most ``rounding``, which
    counts in the error bound. ``near`` is an approximation of x to begin with.
    """
    norm = solvers.inverse_norm(system)
    shift = exponent(b)
    if shift == 0:
        solution = solvers.answer(system, b, near)
        return LinearSolution(
            solution.x, float(norm * (solution.bound + rounding)), solution.method
        )
    # numbers are scaled because dot products would leave the range of floats
    solution = solvers.answer(system, np.ldexp(b, -shift))
    with np.errstate(over="ignore", under="ignore"):
        x = np.ldexp(solution.x, shift)
        bound = float(np.ldexp(norm * solution.bound, shift))
    # subnormal numbers are rounded once more
    bound += norm * rounding + len(x) * SMALLEST_FLOAT
    return LinearSolution(x, bound if np.isfinite(x).all() else np.inf, solution.method)


def _check_kernel(kernel: Any) -> Csr:
    """Return the kernel as csr, or raise an error that names its first bad entry."""
    if not _checks.is_sparse(kernel):
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
        first = bad[0]
        row = int(np.searchsorted(rows.indptr, first, side="right")) - 1
        column = int(rows.indices[first])
        raise ArgumentError(
            "kernel",
            f"must be finite and nonnegative; kernel[{row}, {column}] is"
            f" {rows.data[first]}",
        )
    return rows


@dataclass(frozen=True)
class PolicyValues:
    """Hold the values of a policy, V and J, with a bound on the error of V.

    Attributes
    ----------
    values : ndarray of shape (S,)
        V(s), not normalised.
    value : float
        J = mu_0 . V.
    error_bound : float
        A bound on the largest error ``|V - V*|_inf``: from the residual of the linear
        system, or with a horizon from the roundings of the recursion. The latter bounds
        the error of J as well.
    method : str
        The solver.
    """

    values: Array
    value: float
    error_bound: float
    method: str


def policy_rewards(model: Model, policy: Array) -> Array:
    """Compute r_pi(s) = sum_a policy[s, a] r(s, a), of shape (S,)."""
    return _system.average_rewards(policy, model.rewards)[0]


def largest_reward(model: Model) -> float:
    """Return the largest magnitude of a reward, of r(s, a, s') where there are some.

    Tolerances are shares of it, so that the unit of the rewards does not matter.
    """
    data = model.rewards if model.reward_data is None else model.reward_data
    return _system.largest_magnitude(data)


@suggest_keywords
def evaluate_policy(
    model: Model, policy: PolicyLike, *, horizon: int | None = None
) -> PolicyValues:
    """Compute V, J and a bound on their error.

    Finite horizon: V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0; infinite: (I - gamma P_pi)
    V = r_pi.

    Parameters
    ----------
    model : FiniteMDP or ReweightedModel
        The model in which the policy is evaluated. The rows of a ReweightedModel may
        have any sum.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.

    Returns
    -------
    PolicyValues
        ``values`` of shape (S,), ``value`` (J), ``error_bound`` of ``|V - V*|_inf`` and
        ``method``. V* is the exact solution for the numbers as they are stored:
        transitions, policy and ``rewards`` (S, A), the rounded expectation of r(s, a,
        s').

    Raises
    ------
    ValueError
        If an argument is bad; without a horizon, if the sum from the start does not
        exist (discount 1 and a policy that is not absorbed in states without reward, or
        a kernel whose spectral radius times the discount is not below 1).

    See Also
    --------
    policy_value : J alone.
    state_values : V alone.
    solve_policy_system : The solution of any such linear system.

    Notes
    -----
    With a horizon the recursion goes backward over all states, and the bound is that of
    its roundings, some n T spacings of the largest V_t, n the entries of a row. Costs
    O(T nnz) with a horizon, one sparse solve without. Only what the policy reaches from
    the start matters to J: if the infinite sum diverges in a state that it never
    reaches, ``values`` is nan in all states that it never reaches. Values beyond the
    largest float are infinite, and so is the error bound then.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> result = evaluate_policy(coin, [[1.0]] * 2)
    >>> (
    ...     result.values.round(6).tolist(),
    ...     round(result.value, 6),
    ...     result.error_bound < 1e-12,
    ... )
    ([0.5, 1.5], 1.0, True)
    """
    require_model(model, "model")
    steps = None if horizon is None else horizon_length(horizon, model, policy)
    pi = check_policy(policy, model, horizon=steps)
    if steps is None:
        return reached_values(model, pi)
    values, bound = backward.bounded_values(model, pi, steps)
    return PolicyValues(
        values, finite.initial_mean(model, values), bound, "backward recursion"
    )


def infinite_values(
    model: Model, policy: Array, near: Array | None = None
) -> PolicyValues:
    """Compute V and J of the infinite sum for a policy that has been checked.

    The bound on the error counts the rounding of the policy's kernel and rewards.
    ``near`` (S,) is an approximation of V to begin with. A DivergentKernelError is
    raised where the sum diverges in any state.
    """
    rewards, largest = _system.average_rewards(policy, model.rewards)
    system = policy_system(model, policy)
    if model.discount == 1.0:
        recurrent = recurrent_states(system, rewards, model.names)
        if recurrent.all():
            return PolicyValues(np.zeros(len(rewards)), 0.0, 0.0, "absorbed")
        system = drop_states(system, recurrent)
    # a reward is a sum of A products, each rounded, and may be subnormal
    rounding = (model.n_actions + 1) * (_system.EPS * largest + SMALLEST_FLOAT)
    solution = solve(system, rewards, rounding=rounding, near=near)
    return PolicyValues(
        solution.x,
        finite.initial_mean(model, solution.x),
        solution.error_bound,
        solution.method,
    )


def reached_values(
    model: Model,
    policy: Array,
    *,
    only_on_support: bool = False,
    starts: BoolArray | None = None,
) -> PolicyValues:
    """Compute V and J of the infinite sum, where need be in reached states alone.

    V is nan in the states that the policy does not reach from the start, if the sum
    diverges in one of them. ``reach`` says what counts.
    """
    solution, reached = solve_where_reached(
        lambda act: infinite_values(model, act),
        model,
        policy,
        only_on_support=only_on_support,
        starts=starts,
    )
    if reached is None:
        return solution
    return replace(solution, values=np.where(reached, solution.values, np.nan))


def values_or_zeros(
    model: Model, policy: Array, starts: BoolArray | None = None
) -> Array:
    """Compute V (S,) of the infinite sum, 0 where that diverges and is never reached.

    That is for what weighs V by visits, which are 0 there on the support of the model.
    """
    solution = reached_values(model, policy, only_on_support=True, starts=starts)
    values = solution.values
    if isfinite(solution.error_bound):
        return np.where(np.isnan(values), 0.0, values)
    return np.asarray(warn_if_not_finite(values))


def warn_if_not_finite(values: Any) -> Any:
    """Return the values, and warn where one is not finite."""
    if not np.isfinite(values).all():
        _checks.warn(
            "a value is beyond the largest float: it is infinite, or not a number",
            NumericalWarning,
        )
    return values


def finite_values(solution: PolicyValues) -> Array:
    """Return V of a solution, and warn where a value is not finite."""
    # the bound is finite only where all values are
    if isfinite(solution.error_bound):
        return solution.values
    return np.asarray(warn_if_not_finite(solution.values))


@suggest_keywords
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
    mdp : FiniteMDP or ReweightedModel
        The model in which the policy is evaluated.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.
    normalized : bool, default False
        Whether J is multiplied by (1 - discount). This is an error at discount 1.

    Returns
    -------
    float
        J, in units of the discounted sum of rewards.

    Raises
    ------
    ValueError
        As in ``evaluate_policy``, and if ``normalized`` is True at discount 1.

    See Also
    --------
    evaluate_policy : V and J with a bound on their error.
    policy_values_by_horizon : J of every horizon up to T in one pass.

    Notes
    -----
    Costs as much as ``evaluate_policy``. With a horizon the sum runs over the light
    cone of the first states, so that states that are not reached within it cost
    nothing.

    Examples
    --------
    >>> import numpy as np
    >>> from oee_tabular.mdp import FiniteMDP
    >>> mdp = FiniteMDP(np.ones((1, 1, 1)), np.array([2.0]), np.array([1.0]), 0.5)
    >>> (
    ...     policy_value(mdp, np.ones((1, 1))),
    ...     policy_value(mdp, np.ones((1, 1)), horizon=2),
    ... )
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
        sums = finite.values_by_horizon(mdp, pi, steps, is_each=False)
        value = factor * float(sums[-1])
    return value if isfinite(value) else float(warn_if_not_finite(value))


@suggest_keywords
def state_values(
    mdp: Model, policy: PolicyLike, *, horizon: int | None = None
) -> Array:
    """Compute V(s) = E[sum_t gamma^t r_t | s_0 = s], not normalised (eq. 4.1).

    Parameters
    ----------
    mdp : FiniteMDP or ReweightedModel
        The model in which the policy is evaluated.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.

    Returns
    -------
    ndarray of shape (S,)
        The value of each state.

    Raises
    ------
    ValueError
        As in ``evaluate_policy``, and if the sum does not exist in some state, even if
        the policy never reaches it; ``evaluate_policy`` has the other states' values.

    See Also
    --------
    action_values : The values of all state-action pairs.
    evaluate_policy : The same values with a bound on their error.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> state_values(coin, [[1.0]] * 2).round(6).tolist()
    [0.5, 1.5]
    >>> state_values(coin, [[1.0]] * 2, horizon=2).tolist()
    [0.25, 1.25]
    """
    require_model(mdp)
    if horizon is None:
        return finite_values(infinite_values(mdp, check_policy(policy, mdp)))
    steps = horizon_length(horizon, mdp, policy)
    pi = check_policy(policy, mdp, horizon=steps)
    return np.asarray(warn_if_not_finite(backward.last_values(mdp, pi, steps)))


@suggest_keywords
def action_values(
    mdp: Model, policy: PolicyLike, *, horizon: int | None = None
) -> Array:
    """Compute Q(s, a) = r(s, a) + gamma E[V(s_1) | s, a], not normalised.

    With a horizon T, V is the value of the T - 1 rewards that follow.

    Parameters
    ----------
    mdp : FiniteMDP or ReweightedModel
        The model in which the policy is evaluated.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A) with a horizon T; other forms
        as in ``check_policy``.
    horizon : int, optional
        Number of rewards, at t = 0..horizon-1. None means the infinite discounted sum.

    Returns
    -------
    ndarray of shape (S, A)
        The value of each state-action pair; -inf where the action cannot be taken.

    Raises
    ------
    ValueError
        As in ``state_values``.

    See Also
    --------
    state_values : The values of all states.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> rows = [[[1, 0], [0, 1]], [[0, 1], [0, 1]]]
    >>> mdp = oee.FiniteMDP(rows, [[1.0, 0.0], [2.0, 2.0]], [1, 0], 0.9)
    >>> stay = [[1, 0], [1, 0]]  # for ever 1, or 2 from the next step on
    >>> action_values(mdp, stay).round(6).tolist()
    [[10.0, 18.0], [20.0, 20.0]]
    """
    require_model(mdp)
    steps = optional_horizon_length(horizon, mdp, policy)
    if steps is None:
        return drop_unavailable(mdp, back_up_pairs(mdp, state_values(mdp, policy)))
    pi = check_policy(policy, mdp, horizon=steps)
    values = backward.last_values(mdp, pi, steps - 1)
    q = np.asarray(warn_if_not_finite(back_up_pairs(mdp, values)))
    return drop_unavailable(mdp, q)


def drop_unavailable(model: Model, q: Array) -> Array:
    """Return Q (S, A), -inf where the action cannot be taken: no maximum is there."""
    return q if model.has_all_actions else np.where(model.available, q, -np.inf)
