"""A target and a model of it: the simulation lemma, the paper's Lemma V.1 (zeta) and
Theorem V.2 (the value), and what is true.

Reference: [1] Kearns and Singh, Near-optimal reinforcement learning in polynomial time,
Machine Learning 49, 2002.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import align, csr_on_pattern
from oee_tabular.exact import (
    ReweightedModel,
    occupancy,
    policy_value,
    reweight,
    state_values,
)
from oee_tabular.exact.reweighted import Model
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.arrays import name_transition
from oee_tabular.mdp.horizons import limit_horizon, optional_horizon_length
from oee_tabular.theory.theorem_1 import Sides, check_box, check_ratio
from oee_tabular.typing import Array, PolicyLike


@dataclass(frozen=True)
class SimulationLemma:
    """J' - J(K) by two evaluations, and by each form of the lemma; the three are equal
    up to rounding.

    Attributes
    ----------
    difference : J' - J(K), units of J
    by_target_occupancy, by_model_occupancy : the same, the change of the rows weighted
        by d' or by d_K

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
    >>> lemma = simulation_lemma(target, model, [[1.0]] * 2)
    >>> round(lemma.difference, 6), round(lemma.by_target_occupancy, 6), round(lemma.by_model_occupancy, 6)
    (0.1, 0.1, 0.1)
    """

    difference: float
    by_target_occupancy: float
    by_model_occupancy: float


def simulation_lemma(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: object = None,
) -> SimulationLemma:
    """J' - J(K) = g/(1-g) <d', (P' - K) V_K> = g/(1-g) <d_K, (P' - K) V'>, for any
    nonnegative kernel K [1].

    With a horizon, sum_{t<T} g^{t+1} <alpha'_t, (P' - K) V^K_{t+1}>, and the same with
    the two exchanged (V_T = 0). Where rewards are r(s, a, s'), r(s, a, s') + g V(s')
    takes the place of g V(s').

    Parameters
    ----------
    target : FiniteMDP, P'
    model : FiniteMDP or ReweightedModel, K: the target's rewards, initial distribution
        and discount, rows of any sum
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None
    ratio : None, or csr (S*A, S) or an object with such ``values``: ``model`` is then
        the simulator P, and K = ratio * P

    Raises
    ------
    ValueError
        What is not a pair; without a horizon, discount 1 or a K whose infinite sum does
        not exist.

    Notes
    -----
    Values are not normalised. Cost: O(T * nnz) time and O(T * S) memory, or four sparse
    solves.

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
    >>> lemma = simulation_lemma(target, model, [[1.0]] * 2, horizon=3)
    >>> round(lemma.difference, 6), round(lemma.by_target_occupancy, 6), round(lemma.by_model_occupancy, 6)
    (0.075, 0.075, 0.075)
    """
    kernel = check_pair(target, model, ratio)
    steps = optional_horizon_length(horizon, kernel, policy, kept=kernel.n_states)
    pi = check_policy(policy, target, horizon=steps)
    difference = policy_value(target, pi, horizon=steps) - policy_value(
        kernel, pi, horizon=steps
    )
    first = _error_by_occupancy(
        target, kernel, pi, steps, measured=target, valued=kernel
    )
    second = _error_by_occupancy(
        target, kernel, pi, steps, measured=kernel, valued=target
    )
    return SimulationLemma(difference, first, second)


def _error_by_occupancy(
    target: Model,
    kernel: Model,
    pi: Array,
    steps: int | None,
    *,
    measured: Model,
    valued: Model,
) -> float:
    """sum_t g^t <alpha_t, r' - r_K + g (P' - K) V_{t+1}>: alpha of ``measured``, V of
    ``valued``.
    """
    gamma = target.discount
    reward_error = target.rewards - kernel.rewards

    def row_errors(value: Array) -> Array:
        change: Array = target.transitions @ value - kernel.transitions @ value
        return reward_error + gamma * change.reshape(reward_error.shape)

    if steps is None:
        errors = row_errors(state_values(valued, pi))
        return float(np.sum(occupancy(measured, pi) * errors) / (1.0 - gamma))
    to_go = np.zeros((steps + 1, target.n_states))
    for t in range(steps - 1, -1, -1):
        q = valued.rewards + gamma * (valued.transitions @ to_go[t + 1]).reshape(
            reward_error.shape
        )
        to_go[t] = np.sum((pi if pi.ndim == 2 else pi[t]) * q, axis=1)
    alphas = enumerate(forward_distributions(measured, pi, steps))
    return sum(
        gamma**t * float(np.sum(pairs * row_errors(to_go[t + 1])))
        for t, pairs in alphas
    )


def forward_distributions(model: Model, pi: Array, steps: int) -> Iterator[Array]:
    """alpha_t, (S, A), for t = 0..steps-1; not normalised."""
    transposed = sparse.csr_array(model.transitions.T)
    states = model.initial
    for t in range(steps):
        pairs = states[:, None] * (pi if pi.ndim == 2 else pi[t])
        yield pairs
        states = transposed @ pairs.reshape(-1)


def check_pair(
    target: object, model: object, ratio: object = None
) -> FiniteMDP | ReweightedModel:
    """K: ``model``, or ratio * model; a ValueError where it is not the target's MDP
    under other dynamics.
    """
    target = _checks.instance(target, FiniteMDP, "target")
    if ratio is not None:
        model = reweight(
            _checks.instance(
                model, FiniteMDP, "model", "FiniteMDP (the simulator) with a ratio"
            ),
            ratio,
        )
    if not isinstance(model, FiniteMDP | ReweightedModel):
        raise ArgumentError(
            "model",
            f"must be a FiniteMDP or a ReweightedModel; got {type(model).__name__}",
        )
    if target.transitions.shape != model.transitions.shape:
        raise ValueError(
            "target and model must have the same states and actions; their transitions"
            f" have shapes {target.transitions.shape} and {model.transitions.shape}"
        )
    if target.discount != model.discount:
        raise ArgumentError(
            "model",
            f"must have the target's discount {target.discount:g}; it has"
            f" {model.discount:g}",
        )
    bad = np.flatnonzero(np.abs(target.initial - model.initial) > _checks.SUM_TOLERANCE)
    if bad.size:
        s = bad[0]
        raise ArgumentError(
            f"model.initial[{s}]",
            f"must be the target's {target.initial[s]:g}; it is {model.initial[s]:g}",
        )
    _check_rewards(target, model)
    return model


def _check_rewards(target: FiniteMDP, model: Model) -> None:
    """Check the form of rewards, and their values (r(s, a, s') on the transitions that
    both make).
    """
    if target.reward_data is None or model.reward_data is None:
        if target.reward_data is not model.reward_data:
            forms = [
                "r(s, a)" if m.reward_data is None else "r(s, a, s')"
                for m in (target, model)
            ]
            raise ArgumentError(
                "model",
                f"must have the target's form of rewards, {forms[0]}; it has"
                f" {forms[1]}",
            )
        bad = np.argwhere(
            ~np.isclose(target.rewards, model.rewards, rtol=1e-9, atol=1e-12)
        )
        if bad.size:
            s, a = bad[0]
            wanted = target.rewards[s, a]
            found = model.rewards[s, a]
            raise ValueError(
                f"model.rewards[{s}, {a}] must be the target's {wanted:g}; it is"
                f" {found:g}"
            )
        return
    found, shared = align(
        csr_on_pattern(model.transitions, model.reward_data), target.transitions
    )
    wrong = np.flatnonzero(
        shared & ~np.isclose(found, target.reward_data, rtol=1e-9, atol=1e-12)
    )
    if wrong.size:
        k = int(wrong[0])
        where = name_transition(target.transitions, k, target.n_actions, target.names)
        raise ValueError(
            f"model's reward at {where} must be the target's {target.reward_data[k]:g};"
            f" it is {found[k]:g}"
        )


def ratio_error_bound(
    error: float, mu: float, nu: float, *, tight: bool = False
) -> float:
    """Lemma V.1 (eq. 5.2): |zhat - zeta|_inf <= mu (1 + nu mu) / nu^2 * error;
    ``tight``: (mu + nu) / nu^2 * error.

    The paper has M(G, delta) / n^{1/4} for ``error``; M already contains n.

    Parameters
    ----------
    error : in [0, inf], of both |betahat - beta|_inf (Theorem 1 twice: probability 1 -
        2 delta)
    mu, nu : the box of all four ratios, as in ``estimation_bound``: zeta = beta_sas' /
        beta_sa is in [nu/mu, mu/nu]
    tight : whether the smallest constant, attained as error -> 0, takes the place of
        the paper's

    Examples
    --------
    >>> ratio_error_bound(0.01, 2.0, 0.5), ratio_error_bound(0.01, 2.0, 0.5, tight=True)
    (0.16, 0.1)
    """
    _checks.boolean(tight, "tight")
    lower, upper = check_box(nu, mu)
    size = _checks.number_in(error, "error", 0.0, math.inf, infinite=True)
    square = lower**2
    if size == 0.0:
        return 0.0
    return (
        (upper + lower if tight else upper * (1.0 + lower * upper)) / square * size
        if square > 0.0
        else math.inf
    )


def ratio_error_sides(
    moves: object,
    pairs: object,
    true_moves: object,
    true_pairs: object,
    *,
    mu: float,
    nu: float,
    tight: bool = False,
) -> Sides:
    """The Lemma on tables: left = max |zhat - zeta|, right = the bound at the larger of
    the two sup errors.

    Parameters
    ----------
    moves, pairs : (n,) estimates of beta_sas' and beta_sa: entry k is a transition's,
        and the pair's value is repeated
    true_moves, true_pairs : (n,) the true ratios; all in [nu, mu]
    mu, nu, tight : as in ``ratio_error_bound``

    Examples
    --------
    >>> round(ratio_error_sides([1.1], [0.9], [1.0], [1.0], mu=2.0, nu=0.5).ratio, 3)
    0.139
    """
    _checks.boolean(tight, "tight")
    named = {
        "moves": moves,
        "pairs": pairs,
        "true_moves": true_moves,
        "true_pairs": true_pairs,
    }
    top, bottom, best_top, best_bottom = (
        check_ratio(value, name, *check_box(nu, mu)) for name, value in named.items()
    )
    for array, name in (
        (bottom, "pairs"),
        (best_top, "true_moves"),
        (best_bottom, "true_pairs"),
    ):
        if array.shape != top.shape:
            raise ArgumentError(
                name, f"must have the length of moves, {len(top)}; it has {len(array)}"
            )
    error = float(
        max(
            np.abs(top - best_top).max(initial=0.0),
            np.abs(bottom - best_bottom).max(initial=0.0),
        )
    )
    # a quotient beyond the largest float is infinite: nothing from another such one
    with np.errstate(over="ignore"):
        quotient = top / bottom
        best = best_top / best_bottom
    differs = quotient != best
    left = float(np.abs(quotient[differs] - best[differs]).max(initial=0.0))
    return Sides(left, ratio_error_bound(error, mu, nu, tight=tight))


def value_error_bound(
    horizon: int, reward_bound: float, discount: float, *, error: float, nu: float
) -> float:
    """Theorem V.2's right-hand side (eq. 5.3): of the SQUARE (J' - J(zhat P))^2, FALSE
    as stated (x = gamma / nu).

    T M^2 R^2 x / sqrt(n) * (1 - (T+1) x^T + T x^{T+1}) / (1 - x)^2  =  T R^2 error^2
    sum_{t=1..T} t x^t.

    Parameters
    ----------
    horizon : the paper's T. Its sum runs over t = 0..T, T + 1 rewards:
        ``policy_value(..., horizon=T + 1)``
    reward_bound : R >= max |r(s, a)|
    discount : gamma in [0, 1]
    error : M(G, delta) / n^{1/4}, the sup error of both betahat
    nu : in (0, 1)

    Notes
    -----
    ``value_bound_counterexample`` exceeds it, by any factor as T grows where (gamma (1
    + error))^2 > gamma / nu. Causes: sum t stands where rows that do not sum to 1 give
    sum t^2, the Lemma's constant is dropped, and 1/nu does not bound zeta. It is inf
    where x^T overflows.

    Examples
    --------
    >>> round(value_error_bound(2, 1.0, 0.99, error=0.03, nu=0.97), 8)
    0.0055871
    """
    steps = _checks.positive_integer(horizon, "horizon")
    bound = _checks.number_in(reward_bound, "reward_bound", 0.0, math.inf)
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    size = _checks.number_in(error, "error", 0.0, math.inf)
    lower = _checks.number_in(nu, "nu", 0.0, 1.0, open_ends=True)
    if bound == 0.0 or size == 0.0:
        return 0.0
    last = limit_horizon(steps, min(1.0, gamma / lower), work=100.0, kept=8)
    t = np.arange(1.0, last + 1.0)
    with np.errstate(over="ignore"):
        return float(
            steps * (bound * size) * (bound * size) * np.sum(t * (gamma / lower) ** t)
        )


def value_error_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int,
    error: float,
    nu: float,
    ratio: object = None,
) -> Sides:
    """Theorem 2 on a pair: left = (J' - J(K))^2 over t = 0..T, exactly; right =
    ``value_error_bound`` with R = max |r(s, a)|.

    Parameters
    ----------
    target, model, policy, ratio : as in ``simulation_lemma``; rewards r(s, a), as the
        theorem has them
    horizon, error, nu : as in ``value_error_bound``

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
    >>> round(value_error_sides(target, model, [[1.0]] * 2, horizon=2, error=0.2, nu=0.5).ratio, 3)
    0.023
    """
    kernel = check_pair(target, model, ratio)
    steps = _checks.positive_integer(horizon, "horizon")
    if target.reward_data is not None:
        raise ArgumentError(
            "target",
            "must have rewards r(s, a): Theorem 2 is about those; it has r(s, a, s')",
        )
    largest = float(np.abs(target.rewards).max())
    right = value_error_bound(horizon, largest, target.discount, error=error, nu=nu)
    values = [policy_value(mdp, policy, horizon=steps + 1) for mdp in (target, kernel)]
    return Sides((values[0] - values[1]) * (values[0] - values[1]), right)


def value_bound_counterexample(
    horizon: int, discount: float, epsilon: float, nu: float
) -> Sides:
    """Theorem 2 where P' = P, r = 1, betahat_sas' = 1 + epsilon and betahat_sa = 1:
    zhat = 1 + epsilon, sup error epsilon.

    left = (sum_{t<=T} gamma^t ((1 + epsilon)^t - 1))^2, by dynamic programming; right =
    the theorem's bound.

    Parameters
    ----------
    horizon, discount, nu : as in ``value_error_bound``
    epsilon : the sup error, at least 0

    Examples
    --------
    >>> [round(value_bound_counterexample(T, 0.99, 0.03, 0.97).ratio, 2) for T in (2, 50)]
    [1.43, 18.37]
    """
    size = _checks.number_in(epsilon, "epsilon", 0.0, math.inf)
    mdp = FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], discount)
    ratio = sparse.csr_array([[1.0 + size]])
    return value_error_sides(
        mdp, mdp, np.ones((1, 1)), horizon=horizon, error=size, nu=nu, ratio=ratio
    )


def corrected_value_error_bound(
    horizon: int, reward_bound: float, discount: float, *, error: float
) -> float:
    """In place of Theorem 2, where rows of zhat * P sum to 1: (J' - J(zhat P))^2 <= 2 T
    R^2 error^2 sum_{t=1..T} t gamma^{2t}.

    The paper's shape without 1/nu: from (C) with KL_t <= t error^2, and Cauchy's
    inequality. For T of order
    1 / (1 - gamma) the error is of order (1 - gamma)^{-3/2}: not exponential.

    Parameters
    ----------
    horizon, reward_bound, discount : as in ``value_error_bound``
    error : max |zhat/zeta - 1|

    Examples
    --------
    >>> round(corrected_value_error_bound(2, 1.0, 0.5, error=0.1), 6)
    0.015
    """
    bound = _checks.number_in(reward_bound, "reward_bound", 0.0, math.inf)
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    size = _checks.number_in(error, "error", 0.0, math.inf)
    steps = _checks.positive_integer(horizon, "horizon")
    # of the terms; the factor T stays
    last = limit_horizon(steps, gamma, work=100.0, kept=8)
    t = np.arange(1.0, last + 1.0)
    return float(
        2.0 * steps * (bound * size) * (bound * size) * np.sum(t * gamma ** (2.0 * t))
    )
