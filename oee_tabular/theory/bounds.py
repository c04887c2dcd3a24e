"""True bounds on the error of J: (A), (B) and, by the divergence of paths, (C) of
``oee_tabular.theory``.

Reference: [1] Tsybakov, Introduction to Nonparametric Estimation, 2009, section 2.4
(Pinsker; KL of a path).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import align, row_sums
from oee_tabular.exact import policy_value
from oee_tabular.exact.reweighted import Model
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import limit_horizon, optional_horizon_length
from oee_tabular.theory.theorem_1 import Sides, divergence_terms
from oee_tabular.theory.theorem_2 import check_pair, forward_distributions
from oee_tabular.typing import Array, PolicyLike

# infinite sums: terms that are added up, and the discount^t where that ends
N_TERMS = 100_000
NEGLIGIBLE = 1e-12


def unnormalised_bound(
    eta: float,
    reward_bound: float,
    discount: float,
    *,
    horizon: int | None = None,
    rewards_on_moves: bool = False,
) -> float:
    """(A): |J(K) - J'| <= R sum_t g^t ((1 + eta)^t - 1), whatever the rows of K sum to.

    Parameters
    ----------
    eta : max over (s, a) of sum_s' |K - P'| = E_P |zhat - zeta|, in [0, inf)
    reward_bound : R = max |r|, in [0, inf)
    discount : g in [0, 1]
    horizon : T (t < T), or None: the sum is R g eta / ((1 - g) (1 - g (1 + eta))), and
        inf where g (1 + eta) >= 1
    rewards_on_moves : True for r(s, a, s'): (1 + eta)^{t+1} takes the place of (1 +
        eta)^t

    Notes
    -----
    It is exponential in the horizon, and K = (1 + eta) P' with r = R attains it. It is
    inf if its numbers overflow.

    Examples
    --------
    >>> round(unnormalised_bound(0.5, 1.0, 0.5, horizon=3), 12), unnormalised_bound(0.5, 1.0, 0.9)
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
        return (
            bound * eta * (1.0 if shift else gamma) / ((1.0 - gamma) * rest)
            if rest > 0.0
            else math.inf
        )
    t = np.arange(
        limit_horizon(steps, min(1.0, gamma * (1.0 + eta)), work=100.0, kept=8)
    )
    growth = (t + shift) * np.log1p(eta)
    with np.errstate(over="ignore"):
        return float(
            bound * np.sum(np.exp(t * np.log(gamma) + growth) * -np.expm1(-growth))
        )


def unnormalised_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: object = None,
) -> Sides:
    """(A) on a pair: |J(K) - J'| by dynamic programming, and ``unnormalised_bound`` at
    the pair's own eta and R.

    left is inf where the infinite sum J(K) does not exist (right is then, too). eta
    counts the target's transitions to which K gives nothing. Cost: two evaluations.

    Parameters
    ----------
    target, model, policy, horizon, ratio : as in ``simulation_lemma``, whose errors are
        these

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
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


def normalised_bound(
    eta: float,
    reward_bound: float,
    discount: float,
    *,
    horizon: int | None = None,
    rewards_on_moves: bool = False,
) -> float:
    """(B), where the rows of K sum to 1: |J(K) - J'| <= R sum_t g^t min(2, t eta) <= R
    g eta / (1 - g)^2.

    inf at discount 1 without a horizon, unless eta or R is 0. An infinite sum is added
    up to discount^t = 1e-12 (at most 100 000 terms) and bounded from there.

    Parameters
    ----------
    eta, reward_bound, discount, horizon : as in ``unnormalised_bound``
    rewards_on_moves : True for r(s, a, s'): (t + 1) eta takes the place of t eta

    Examples
    --------
    >>> normalised_bound(0.5, 1.0, 0.5, horizon=3), normalised_bound(0.5, 1.0, 1.0, horizon=10)
    (0.5, 15.0)
    """
    _checks.boolean(rewards_on_moves, "rewards_on_moves")
    eta, bound, gamma, steps = _check_constants(eta, reward_bound, discount, horizon)
    shift = int(rewards_on_moves)
    if bound == 0.0 or eta == 0.0:
        return 0.0
    if steps is None and gamma == 1.0:
        return math.inf
    length = (
        _n_terms(gamma)
        if steps is None
        else limit_horizon(steps, gamma, work=100.0, kept=8)
    )
    t = np.arange(length)
    total = float(np.sum(gamma**t * np.minimum(2.0, (t + shift) * eta)))
    if steps is None:
        total += (
            gamma**length
            / (1.0 - gamma)
            * min(2.0, (length + shift + gamma / (1.0 - gamma)) * eta)
        )
    return bound * total


def normalised_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: object = None,
) -> Sides:
    """(B) on a pair: |J(K) - J'| by dynamic programming, and ``normalised_bound`` at
    the pair's own eta and R.

    Parameters
    ----------
    target, model, policy, horizon, ratio : as in ``simulation_lemma``; a K whose rows
        miss 1 is a ValueError, too

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
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


def path_kl(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int,
    ratio: object = None,
) -> Array:
    """KL_t = sum_{k<t} E_K[KL(K || P')(s_k, a_k)] in nats for t = 0..T, shape (T + 1,).

    By the chain rule [1] the divergence of the first t transitions under K from those
    under P'; inf from the first one on that K makes and the target does not. Cost: O(T
    * nnz).

    Parameters
    ----------
    target, model, policy, ratio : as in ``normalised_sides``, whose errors are these
    horizon : T, a positive int

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
    >>> path_kl(target, model, [[1.0]] * 2, horizon=3).round(4).tolist()  # log(25 / 24) / 2 a transition
    [0.0, 0.0204, 0.0408, 0.0612]
    """
    kernel = _check_normalised_pair(target, model, ratio)
    steps = limit_horizon(
        _checks.positive_integer(horizon, "horizon"), 1.0, work=kernel.transitions.nnz
    )
    pi = check_policy(policy, target, horizon=steps)
    return _accumulate_kl(kernel, pi, steps, _row_kl(target, kernel))


def _accumulate_kl(kernel: Model, pi: Array, steps: int, row_kl: Array) -> Array:
    """KL_t = KL_{t-1} + <alpha_{t-1}, row_kl> for t = 0..steps, alpha under K."""
    result = np.zeros(steps + 1)
    for t, pairs in enumerate(forward_distributions(kernel, pi, steps)):
        reached = pairs.reshape(-1) > 0.0  # 0 * inf is 0 here
        result[t + 1] = result[t] + pairs.reshape(-1)[reached] @ row_kl[reached]
    return result


def _row_kl(target: Model, kernel: Model) -> Array:
    """(S*A,): KL(K || P') of each row."""
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
    path_divergence: object, reward_bound: float, discount: float
) -> float:
    """(C), where the rows of K sum to 1: |J(K) - J'| <= R sum_{t<T} g^t min(2, sqrt(2
    KL_t)).

    Parameters
    ----------
    path_divergence : (T,) nonnegative, inf allowed: KL of the transitions that the
        reward at t depends on, t = 0..T-1; with ``path_kl`` its entries 0..T-1 for r(s,
        a), 1..T for r(s, a, s')
    reward_bound : R = max |r|, in [0, inf)
    discount : g in [0, 1]

    Notes
    -----
    Proof: |E_K r_t - E_P' r_t| <= 2 R TV of those transitions; Pinsker; the chain rule. No exponential in the horizon: with
    |zhat/zeta - 1| <= eps, KL_t <= t eps^2 (``corrected_value_error_bound``). It is tight to second order in eps.

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


def kl_path_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: object = None,
) -> Sides:
    """(C) on a pair: |J(K) - J'| by dynamic programming, and ``kl_path_bound`` of the
    pair's own path divergence.

    Without a horizon the sum runs to discount^t = 1e-12 (at most 100 000 steps), and
    what follows is bounded by Jensen's inequality, so right stays a bound. Cost: O(T *
    nnz).

    Parameters
    ----------
    target, model, policy, horizon, ratio : as in ``normalised_sides``, whose errors are
        these

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
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
        return Sides(
            left,
            kl_path_bound(
                _accumulate_kl(kernel, pi, steps, row_kl)[shift:][:steps], bound, gamma
            ),
        )
    if gamma == 1.0:  # every state that is reached is reached in S transitions
        is_zero = (
            bound == 0.0
            or _accumulate_kl(kernel, pi, kernel.n_states, row_kl)[-1] == 0.0
        )
        return Sides(left, 0.0 if is_zero else math.inf)
    length = _n_terms(gamma)
    kl = _accumulate_kl(kernel, pi, length + shift, row_kl)[shift:]
    later = kl[length] + row_kl.max() * gamma / (1.0 - gamma) if gamma > 0.0 else 0.0
    tail = gamma**length / (1.0 - gamma) * min(2.0, math.sqrt(2.0 * later))
    return Sides(left, kl_path_bound(kl[:length], bound, gamma) + bound * tail)


def _n_terms(gamma: float) -> int:
    """How many terms of an infinite sum are added up (gamma < 1); the rest is bounded
    by Jensen's inequality.
    """
    return (
        1
        if gamma == 0.0
        else min(N_TERMS, math.ceil(math.log(NEGLIGIBLE) / math.log(gamma)))
    )


def _check_normalised_pair(target: object, model: object, ratio: object) -> Model:
    """K, as ``check_pair`` has it; ValueError where its rows miss 1."""
    kernel = check_pair(target, model, ratio)
    sums = row_sums(kernel.transitions).reshape(kernel.n_states, kernel.n_actions)
    _checks.require_sums_to_one(sums, "model.transitions")
    return kernel


def _check_constants(
    eta: float, reward_bound: float, discount: float, horizon: int | None
) -> tuple[float, float, float, int | None]:
    return (
        _checks.number_in(eta, "eta", 0.0, math.inf),
        _checks.number_in(reward_bound, "reward_bound", 0.0, math.inf),
        _checks.number_in(discount, "discount", 0.0, 1.0),
        _checks.optional_horizon(horizon),
    )


def _constants(target: Model, kernel: Model) -> tuple[float, float, float]:
    """eta = max over (s, a) of sum_s' |K - P'|, R = max |r| over the transitions of
    either, and the discount.
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
    """|J(K) - J'|; inf where J(K) does not exist (0 if all rewards are 0)."""
    truth = policy_value(target, policy, horizon=horizon)
    pi = check_policy(policy, target, horizon=horizon)
    try:
        return abs(policy_value(kernel, pi, horizon=horizon) - truth)
    except DivergentKernelError:
        return math.inf if _constants(target, kernel)[1] > 0.0 else 0.0
