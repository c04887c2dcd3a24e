"""True bounds on the error of a model's value: (A), (B) and (C) of the theory.

They are stated in ``oee_tabular.theory``. For Pinsker's inequality and the divergence
of paths see Tsybakov, Introduction to Nonparametric Estimation, 2009, section 2.4.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align, row_sums
from oee_tabular.exact import Model, policy_value
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.mdp import (
    FiniteMDP,
    check_policy,
    limit_horizon,
    optional_horizon_length,
)
from oee_tabular.theory.theorem_1 import Sides, divergence_terms
from oee_tabular.theory.theorem_2 import (
    RatioLike,
    check_pair,
    forward_distributions,
)
from oee_tabular.typing import Array, PolicyLike, RealArrayLike

# an infinite sum is added up until discount^t is negligible, over at most so many terms
MAX_TERMS = 100_000
NEGLIGIBLE_DISCOUNT = 1e-12


@suggest_keywords
def unnormalised_bound(
    eta: float,
    reward_bound: float,
    discount: float,
    *,
    horizon: int | None = None,
    rewards_on_moves: bool = False,
) -> float:
    """Compute bound (A) on the error of a model's value, for rows with any sum.

    Parameters
    ----------
    eta : float
        The largest over (s, a) of sum_s' abs(K - P'), in [0, inf).
    reward_bound : float
        R, the largest absolute reward, in [0, inf).
    discount : float
        The discount g, in [0, 1].
    horizon : int, optional
        T, the number of rewards; None means the infinite discounted sum.
    rewards_on_moves : bool, default False
        Whether rewards are r(s, a, s'), which rest on one transition more:
        (1 + eta)^{t+1} takes the place of (1 + eta)^t.

    Returns
    -------
    float
        The bound on abs(J(K) - J'). It is inf if its numbers overflow.

    See Also
    --------
    unnormalised_sides : Both sides on a pair of models.
    normalised_bound : The bound for rows that sum to 1.

    Notes
    -----
    The bound is R sum_t g^t ((1 + eta)^t - 1). Without a horizon the sum is R g eta /
    ((1 - g) (1 - g (1 + eta))), and inf where g (1 + eta) >= 1. It is exponential in
    the horizon, and K = (1 + eta) P' with r = R attains it.

    Examples
    --------
    >>> (
    ...     round(unnormalised_bound(0.5, 1.0, 0.5, horizon=3), 12),
    ...     unnormalised_bound(0.5, 1.0, 0.9),
    ... )
    (0.5625, inf)
    """
    _checks.boolean(rewards_on_moves, "rewards_on_moves")
    eta, bound, gamma, steps = _check_constants(eta, reward_bound, discount, horizon)
    shift = int(rewards_on_moves)
    if bound == 0.0 or eta == 0.0:
        return 0.0
    if gamma == 0.0:
        return bound * shift * eta
    if steps is None:
        rest = 1.0 - gamma * (1.0 + eta)
        if not rest > 0.0:
            return math.inf
        first = 1.0 if shift else gamma
        return bound * eta * first / ((1.0 - gamma) * rest)
    t = np.arange(
        limit_horizon(steps, min(1.0, gamma * (1.0 + eta)), work=100.0, kept=8)
    )
    growth = (t + shift) * np.log1p(eta)
    with np.errstate(over="ignore"):
        return float(
            bound * np.sum(np.exp(t * np.log(gamma) + growth) * -np.expm1(-growth))
        )


@suggest_keywords
def unnormalised_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: RatioLike | None = None,
) -> Sides:
    """Compute both sides of bound (A) on a pair of models.

    Parameters
    ----------
    target : FiniteMDP
        P', the target.
    model : FiniteMDP or ReweightedModel
        K, the model: it has the target's rewards, initial distribution and discount.
    policy : PolicyLike
        The policy, also of shape (T, S, A) with a horizon T.
    horizon : int, optional
        T, the number of rewards; None means the infinite discounted sum.
    ratio : csr_array of shape (S*A, S) or TransitionRatio, optional
        A ratio: ``model`` is then the simulator P, and K = ratio * P.

    Returns
    -------
    Sides
        The error abs(J(K) - J') by dynamic programming, and ``unnormalised_bound`` at
        the pair's own eta and R. Both are inf where the infinite sum J(K) does not
        exist.

    Raises
    ------
    ValueError
        If model and target are not a pair: other states, actions, rewards, initial
        distribution or discount.

    See Also
    --------
    unnormalised_bound : The bound from its constants.

    Notes
    -----
    eta counts the target's transitions that K lacks. The cost is that of two
    evaluations.

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> round(unnormalised_sides(target, model, [[1.0]] * 2, horizon=3).ratio, 3)
    0.357
    """
    kernel = check_pair(target, model, ratio)
    left = _value_error(target, kernel, policy, horizon)
    constants = _constants(target, kernel)
    on_moves = target.reward_data is not None
    return Sides(
        left, unnormalised_bound(*constants, horizon=horizon, rewards_on_moves=on_moves)
    )


@suggest_keywords
def normalised_bound(
    eta: float,
    reward_bound: float,
    discount: float,
    *,
    horizon: int | None = None,
    rewards_on_moves: bool = False,
) -> float:
    """Compute bound (B) on the error of a model's value, for rows that sum to 1.

    Parameters
    ----------
    eta : float
        The largest over (s, a) of sum_s' abs(K - P'), in [0, inf).
    reward_bound : float
        R, the largest absolute reward, in [0, inf).
    discount : float
        The discount g, in [0, 1].
    horizon : int, optional
        T, the number of rewards; None means the infinite discounted sum.
    rewards_on_moves : bool, default False
        Whether rewards are r(s, a, s'), which rest on one transition more: (t + 1) eta
        takes the place of t eta.

    Returns
    -------
    float
        The bound on abs(J(K) - J'). It is inf at discount 1 without a horizon, unless
        eta or R is 0.

    See Also
    --------
    normalised_sides : Both sides on a pair of models.
    unnormalised_bound : The bound for rows with any sum.

    Notes
    -----
    The bound is R sum_t g^t min(2, t eta), which is at most R g eta / (1 - g)^2. An
    infinite sum is added up to discount^t = 1e-12 (at most 100 000 terms) and bounded
    from there.

    Examples
    --------
    >>> (
    ...     normalised_bound(0.5, 1.0, 0.5, horizon=3),
    ...     normalised_bound(0.5, 1.0, 1.0, horizon=10),
    ... )
    (0.5, 15.0)
    """
    _checks.boolean(rewards_on_moves, "rewards_on_moves")
    eta, bound, gamma, steps = _check_constants(eta, reward_bound, discount, horizon)
    shift = int(rewards_on_moves)
    if bound == 0.0 or eta == 0.0:
        return 0.0
    if steps is None and gamma == 1.0:
        return math.inf
    if steps is None:
        length = _n_terms(gamma)
    else:
        length = limit_horizon(steps, gamma, work=100.0, kept=8)
    t = np.arange(length)
    total = float(np.sum(gamma**t * np.minimum(2.0, (t + shift) * eta)))
    if steps is None:
        total += (
            gamma**length
            / (1.0 - gamma)
            * min(2.0, (length + shift + gamma / (1.0 - gamma)) * eta)
        )
    return bound * total


@suggest_keywords
def normalised_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: RatioLike | None = None,
) -> Sides:
    """Compute both sides of bound (B) on a pair of models.

    Parameters
    ----------
    target : FiniteMDP
        P', the target.
    model : FiniteMDP or ReweightedModel
        K, the model: it has the target's rewards, initial distribution and discount.
    policy : PolicyLike
        The policy, also of shape (T, S, A) with a horizon T.
    horizon : int, optional
        T, the number of rewards; None means the infinite discounted sum.
    ratio : csr_array of shape (S*A, S) or TransitionRatio, optional
        A ratio: ``model`` is then the simulator P, and K = ratio * P.

    Returns
    -------
    Sides
        The error abs(J(K) - J') by dynamic programming, and ``normalised_bound`` at
        the pair's own eta and R.

    Raises
    ------
    ValueError
        If model and target are not a pair, or if a row of K does not sum to 1.

    See Also
    --------
    normalised_bound : The bound from its constants.

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> round(normalised_sides(target, model, [[1.0]] * 2, horizon=3).ratio, 3)
    0.375
    """
    kernel = _check_normalised_pair(target, model, ratio)
    left = _value_error(target, kernel, policy, horizon)
    constants = _constants(target, kernel)
    on_moves = target.reward_data is not None
    return Sides(
        left, normalised_bound(*constants, horizon=horizon, rewards_on_moves=on_moves)
    )


@suggest_keywords
def path_kl(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int,
    ratio: RatioLike | None = None,
) -> Array:
    """Compute the divergence of paths under a model from those under the target.

    Parameters
    ----------
    target : FiniteMDP
        P', the target.
    model : FiniteMDP or ReweightedModel
        K, the model: it has the target's rewards, initial distribution and discount.
    policy : PolicyLike
        The policy, also of shape (T, S, A) with a horizon T.
    horizon : int
        T, the number of transitions.
    ratio : csr_array of shape (S*A, S) or TransitionRatio, optional
        A ratio: ``model`` is then the simulator P, and K = ratio * P.

    Returns
    -------
    ndarray of shape (T + 1,)
        KL_t in nats for t = 0..T. It is inf from the first transition on that K makes
        and the target does not.

    Raises
    ------
    ValueError
        If model and target are not a pair, or if a row of K does not sum to 1.

    See Also
    --------
    kl_path_bound : The bound on the error of the value that follows.

    Notes
    -----
    KL_t = sum_{k<t} E_K[KL(K || P')(s_k, a_k)], by the chain rule [1]_ the divergence
    of the first t transitions under K from those under P'. The cost is O(T * nnz).

    References
    ----------
    .. [1] Tsybakov, Introduction to Nonparametric Estimation, 2009, section 2.4.

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> # log(25 / 24) / 2 a transition
    >>> path_kl(target, model, [[1.0]] * 2, horizon=3).round(4).tolist()
    [0.0, 0.0204, 0.0408, 0.0612]
    """
    kernel = _check_normalised_pair(target, model, ratio)
    steps = limit_horizon(
        _checks.positive_integer(horizon, "horizon"), 1.0, work=kernel.transitions.nnz
    )
    pi = check_policy(policy, target, horizon=steps)
    return _accumulate_kl(kernel, pi, steps, _row_kl(target, kernel))


def _accumulate_kl(kernel: Model, pi: Array, steps: int, row_kl: Array) -> Array:
    """Compute the divergence of paths, KL_t = KL_{t-1} + <alpha_{t-1}, row_kl>.

    t is 0..steps, and alpha_t the distribution of state-action pairs under K.
    """
    result = np.zeros(steps + 1)
    for t, pairs in enumerate(forward_distributions(kernel, pi, steps)):
        reached = pairs.reshape(-1) > 0.0  # 0 * inf is 0 here
        result[t + 1] = result[t] + pairs.reshape(-1)[reached] @ row_kl[reached]
    return result


def _row_kl(target: Model, kernel: Model) -> Array:
    """Compute KL(K || P') of each row, (S*A,)."""
    on_kernel, _ = align(target.transitions, kernel.transitions)
    _, shared = align(kernel.transitions, target.transitions)
    elsewhere = row_sums(
        target.transitions, np.where(shared, 0.0, target.transitions.data)
    )
    return (
        row_sums(
            kernel.transitions, divergence_terms(kernel.transitions.data, on_kernel)
        )
        + elsewhere
    )


def kl_path_bound(
    path_divergence: RealArrayLike, reward_bound: float, discount: float
) -> float:
    """Compute bound (C) on the error of a model's value, from the divergence of paths.

    Parameters
    ----------
    path_divergence : array_like of shape (T,)
        The divergence, for t = 0..T-1, of the transitions that the reward at t rests
        on, nonnegative or inf. Of ``path_kl`` these are the entries 0..T-1 for rewards
        r(s, a), and 1..T for r(s, a, s').
    reward_bound : float
        R, the largest absolute reward, in [0, inf).
    discount : float
        The discount g, in [0, 1].

    Returns
    -------
    float
        The bound on abs(J(K) - J'), where the rows of K sum to 1.

    See Also
    --------
    kl_path_sides : Both sides on a pair of models.
    path_kl : The divergence of paths.

    Notes
    -----
    The bound is R sum_{t<T} g^t min(2, sqrt(2 KL_t)). Proof: the error of E r_t is at
    most 2 R times the total variation of those transitions; Pinsker's inequality; the
    chain rule. It is not exponential in the horizon: if abs(zhat/zeta - 1) <= eps, then
    KL_t <= t eps^2 (``corrected_value_error_bound``). It is tight to second order in
    eps.

    Examples
    --------
    >>> kl_path_bound([0.0, 0.5, 8.0], 1.0, 0.5)
    1.0
    """
    kl = _checks.float_array(path_divergence, "path_divergence", ndim=1)
    bad = np.flatnonzero(~(kl >= 0.0))
    if bad.size:
        raise ArgumentError(
            f"path_divergence[{bad[0]}]", f"must be nonnegative; it is {kl[bad[0]]}"
        )
    _, bound, gamma, _ = _check_constants(0.0, reward_bound, discount, None)
    return float(
        bound * np.sum(gamma ** np.arange(len(kl)) * np.minimum(2.0, np.sqrt(2.0 * kl)))
    )


@suggest_keywords
def kl_path_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: RatioLike | None = None,
) -> Sides:
    """Compute both sides of bound (C) on a pair of models.

    Parameters
    ----------
    target : FiniteMDP
        P', the target.
    model : FiniteMDP or ReweightedModel
        K, the model: it has the target's rewards, initial distribution and discount.
    policy : PolicyLike
        The policy, also of shape (T, S, A) with a horizon T.
    horizon : int, optional
        T, the number of rewards; None means the infinite discounted sum.
    ratio : csr_array of shape (S*A, S) or TransitionRatio, optional
        A ratio: ``model`` is then the simulator P, and K = ratio * P.

    Returns
    -------
    Sides
        The error abs(J(K) - J') by dynamic programming, and ``kl_path_bound`` at the
        pair's own path divergence.

    Raises
    ------
    ValueError
        If model and target are not a pair, or if a row of K does not sum to 1.

    See Also
    --------
    kl_path_bound : The bound from a divergence.

    Notes
    -----
    Without a horizon the sum runs to discount^t = 1e-12 (at most 100 000 steps), and
    the rest is bounded by Jensen's inequality, so the right side stays a bound. The
    cost is O(T * nnz).

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> round(kl_path_sides(target, model, [[1.0]] * 2, horizon=3).ratio, 3)
    0.435
    """
    kernel = _check_normalised_pair(target, model, ratio)
    left = _value_error(target, kernel, policy, horizon)
    _, bound, gamma = _constants(target, kernel)
    shift = int(target.reward_data is not None)
    row_kl = _row_kl(target, kernel)
    steps = optional_horizon_length(horizon, kernel, policy)
    pi = check_policy(policy, target, horizon=steps)
    if steps is not None:
        kl = _accumulate_kl(kernel, pi, steps, row_kl)[shift:][:steps]
        return Sides(left, kl_path_bound(kl, bound, gamma))
    if gamma == 1.0:
        if bound == 0.0:
            return Sides(left, 0.0)
        # every state that is reached is reached in S transitions
        all_kl = _accumulate_kl(kernel, pi, kernel.n_states, row_kl)[-1]
        return Sides(left, 0.0 if all_kl == 0.0 else math.inf)
    length = _n_terms(gamma)
    kl = _accumulate_kl(kernel, pi, length + shift, row_kl)[shift:]
    later = 0.0
    if gamma > 0.0:
        later = kl[length] + row_kl.max() * gamma / (1.0 - gamma)
    tail = gamma**length / (1.0 - gamma) * min(2.0, math.sqrt(2.0 * later))
    return Sides(left, kl_path_bound(kl[:length], bound, gamma) + bound * tail)


def _n_terms(gamma: float) -> int:
    """Return the number of terms of an infinite sum that are added up (gamma < 1)."""
    if gamma == 0.0:
        return 1
    steps = math.ceil(math.log(NEGLIGIBLE_DISCOUNT) / math.log(gamma))
    return min(MAX_TERMS, steps)


def _check_normalised_pair(
    target: object, model: object, ratio: RatioLike | None
) -> Model:
    """Check a pair as ``check_pair`` does, and that the rows of K sum to 1."""
    kernel = check_pair(target, model, ratio)
    sums = row_sums(kernel.transitions).reshape(kernel.n_states, kernel.n_actions)
    # rows of actions that cannot be taken are empty
    sums = np.where(kernel.available, sums, 1.0)
    _checks.require_sums_to_one(sums, "model.transitions")
    return kernel


def _check_constants(
    eta: float, reward_bound: float, discount: float, horizon: int | None
) -> tuple[float, float, float, int | None]:
    """Check the constants of a bound."""
    return (
        _checks.number_in(eta, "eta", 0.0, math.inf),
        _checks.number_in(reward_bound, "reward_bound", 0.0, math.inf),
        _checks.number_in(discount, "discount", 0.0, 1.0),
        _checks.optional_horizon(horizon),
    )


def _constants(target: Model, kernel: Model) -> tuple[float, float, float]:
    """Compute eta, R and the discount of a pair.

    eta is the largest over (s, a) of sum_s' abs(K - P'), R the largest absolute reward
    of the transitions of either.
    """
    change = row_sums(sparse.csr_array(abs(kernel.transitions - target.transitions)))
    tables = [
        m.rewards if m.reward_data is None else m.reward_data for m in (target, kernel)
    ]
    largest = max(float(np.abs(table).max(initial=0.0)) for table in tables)
    return float(change.max(initial=0.0)), largest, target.discount


def _value_error(
    target: FiniteMDP, kernel: Model, policy: PolicyLike, horizon: int | None
) -> float:
    """Compute abs(J(K) - J'), which is inf where J(K) does not exist.

    It is 0 if all rewards are 0.
    """
    truth = policy_value(target, policy, horizon=horizon)
    pi = check_policy(policy, target, horizon=horizon)
    try:
        return abs(policy_value(kernel, pi, horizon=horizon) - truth)
    except DivergentKernelError:
        return math.inf if _constants(target, kernel)[1] > 0.0 else 0.0
