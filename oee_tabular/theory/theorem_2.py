"""The simulation lemma, and the paper's Lemma V.1 (zeta) and Theorem V.2 (the value).

They compare a target with a model of it. Beside the paper's statements are true ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular._sparse import align, csr_on_pattern
from oee_tabular.exact import (
    Model,
    ReweightedModel,
    occupancy,
    policy_value,
    reweight,
    state_values,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import (
    FiniteMDP,
    check_policy,
    limit_horizon,
    name_transition,
    optional_horizon_length,
)
from oee_tabular.ratio import TransitionRatio
from oee_tabular.theory.theorem_1 import Sides, check_box, check_ratio
from oee_tabular.typing import Array, BoolArray, PolicyLike, RealArrayLike, SparseLike

# a ratio as ``reweight`` takes it
RatioLike: TypeAlias = SparseLike | TransitionRatio


@checked()
@dataclass(frozen=True)
class SimulationLemma:
    """Hold the difference of two values, computed in three ways that are equal.

    Attributes
    ----------
    difference : float
        J' - J(K) by two evaluations, not normalised.
    by_target_occupancy : float
        The same, as the change of the rows weighted by the target's occupancy d'.
    by_model_occupancy : float
        The same, as the change of the rows weighted by the model's occupancy d_K.

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> lemma = simulation_lemma(target, model, [[1.0]] * 2)
    >>> (
    ...     round(lemma.difference, 6),
    ...     round(lemma.by_target_occupancy, 6),
    ...     round(lemma.by_model_occupancy, 6),
    ... )
    (0.1, 0.1, 0.1)
    """

    difference: float
    by_target_occupancy: float
    by_model_occupancy: float


@suggest_keywords
def simulation_lemma(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int | None = None,
    ratio: RatioLike | None = None,
) -> SimulationLemma:
    """Compute the difference of two models' values, also by the simulation lemma.

    Parameters
    ----------
    target : FiniteMDP
        P', the target.
    model : FiniteMDP or ReweightedModel
        K, the model: it has the target's rewards, initial distribution and discount,
        and rows with any sum.
    policy : PolicyLike
        The policy, also of shape (T, S, A) with a horizon T.
    horizon : int, optional
        T, the number of rewards; None means the infinite discounted sum.
    ratio : csr_array of shape (S*A, S) or TransitionRatio, optional
        A ratio: ``model`` is then the simulator P, and K = ratio * P.

    Returns
    -------
    SimulationLemma
        J' - J(K) by two evaluations, and by the two forms of the lemma.

    Raises
    ------
    ValueError
        If model and target are not a pair; without a horizon, if the discount is 1 or
        the infinite sum of K does not exist.

    Notes
    -----
    For any nonnegative kernel K the lemma [1]_ says::

        J' - J(K) = g/(1-g) <d', (P' - K) V_K> = g/(1-g) <d_K, (P' - K) V'>

    With a horizon it is sum_{t<T} g^{t+1} <alpha'_t, (P' - K) V^K_{t+1}>, and the same
    with the two exchanged (V_T = 0). Where rewards are r(s, a, s'), r(s, a, s') +
    g V(s') takes the place of g V(s').

    Values are not normalised. The cost is O(T * nnz) time and O(T * S) memory, or four
    sparse solves.

    References
    ----------
    .. [1] Kearns and Singh, Near-optimal reinforcement learning in polynomial
       time, Machine Learning 49, 2002.

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> lemma = simulation_lemma(target, model, [[1.0]] * 2, horizon=3)
    >>> (
    ...     round(lemma.difference, 6),
    ...     round(lemma.by_target_occupancy, 6),
    ...     round(lemma.by_model_occupancy, 6),
    ... )
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
    """Compute sum_t g^t <alpha_t, r' - r_K + g (P' - K) V_{t+1}>.

    alpha is the distribution of state-action pairs in ``measured``, V the value in
    ``valued``.
    """
    gamma = target.discount
    reward_error = target.rewards - kernel.rewards

    def row_errors(value: Array) -> Array:
        """Compute r' - r_K + g (P' - K) V of each state-action pair, (S, A)."""
        change = np.asarray(target.transitions @ value - kernel.transitions @ value)
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
    """Yield alpha_t (S, A) for t = 0..steps-1, which is not normalised."""
    transposed = sparse.csr_array(model.transitions.T)
    states = model.initial
    for t in range(steps):
        pairs = states[:, None] * (pi if pi.ndim == 2 else pi[t])
        yield pairs
        states = transposed @ pairs.reshape(-1)


def check_pair(
    target: object, model: object, ratio: RatioLike | None = None
) -> FiniteMDP | ReweightedModel:
    """Check a target and a model of it, and return the model K.

    It is ``model``, or ratio * model. A ValueError says where it is not the target's
    MDP under other transition probabilities.
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
        raise ValueError(  # it concerns two arguments
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


def _agree(found: Array, wanted: Array) -> BoolArray:
    """Return where two rewards are the same but for rounding.

    Rounding is a share of either, or of the largest: the unit does not matter.
    """
    largest = float(np.abs(wanted).max(initial=0.0))
    return np.isclose(wanted, found, rtol=1e-9, atol=1e-12 * largest)


def _check_rewards(target: FiniteMDP, model: Model) -> None:
    """Check that the rewards have the same form and the same values.

    Rewards r(s, a, s') are compared on the transitions that both models make.
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
        bad = np.argwhere(~_agree(model.rewards, target.rewards))
        if bad.size:
            s, a = bad[0]
            wanted = target.rewards[s, a]
            found = model.rewards[s, a]
            raise ArgumentError(
                f"model.rewards[{s}, {a}]",
                f"must be the target's {wanted:g}; it is {found:g}",
            )
        return
    found, shared = align(
        csr_on_pattern(model.transitions, model.reward_data), target.transitions
    )
    wrong = np.flatnonzero(shared & ~_agree(found, target.reward_data))
    if wrong.size:
        k = int(wrong[0])
        where = name_transition(target.transitions, k, target.n_actions, target.names)
        raise ArgumentError(
            f"model's reward at {where}",
            f"must be the target's {target.reward_data[k]:g}; it is {found[k]:g}",
        )


@suggest_keywords
def ratio_error_bound(
    error: float, mu: float, nu: float, *, tight: bool = False
) -> float:
    """Compute the bound of Lemma V.1 (eq. 5.2) on the sup error of zeta.

    Parameters
    ----------
    error : float
        The sup error of both betahat, in [0, inf]. By Theorem V.1 for each of the two
        it would have the probability 1 - 2 delta.
    mu : float
        The upper end of the box of ratios, in (1, inf).
    nu : float
        The lower end of the box of ratios, in (0, 1).
    tight : bool, default False
        Whether the smallest constant, which is attained as the error tends to 0, takes
        the place of the paper's.

    Returns
    -------
    float
        The bound mu (1 + nu mu) / nu^2 * error; (mu + nu) / nu^2 * error if ``tight``.

    See Also
    --------
    ratio_error_sides : Both sides on tables.

    Notes
    -----
    The box is that of all four ratios, so that zeta = beta_sas' / beta_sa is in
    [nu/mu, mu/nu]. The paper has M(G, delta) / n^{1/4} for ``error``; M already
    contains n.

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
    if not square > 0.0:
        return math.inf
    factor = upper + lower if tight else upper * (1.0 + lower * upper)
    return factor / square * size


@suggest_keywords
def ratio_error_sides(
    moves: RealArrayLike,
    pairs: RealArrayLike,
    true_moves: RealArrayLike,
    true_pairs: RealArrayLike,
    *,
    mu: float,
    nu: float,
    tight: bool = False,
) -> Sides:
    """Compute both sides of Lemma V.1 on tables.

    Parameters
    ----------
    moves : array_like of shape (n,)
        The estimate of beta_sas' of each transition, in [nu, mu].
    pairs : array_like of shape (n,)
        The estimate of beta_sa of each transition's state-action pair, in [nu, mu].
    true_moves : array_like of shape (n,)
        The true beta_sas', in [nu, mu].
    true_pairs : array_like of shape (n,)
        The true beta_sa, in [nu, mu].
    mu : float
        The upper end of the box of ratios, in (1, inf).
    nu : float
        The lower end of the box of ratios, in (0, 1).
    tight : bool, default False
        Whether the smallest constant takes the place of the paper's.

    Returns
    -------
    Sides
        The sup error of zhat, and ``ratio_error_bound`` at the larger of the two sup
        errors.

    See Also
    --------
    ratio_error_bound : The bound from its constants.

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
    # a quotient beyond the largest float is infinite, and equal to another such one
    with np.errstate(over="ignore"):
        quotient = top / bottom
        best = best_top / best_bottom
    differs = quotient != best
    left = float(np.abs(quotient[differs] - best[differs]).max(initial=0.0))
    return Sides(left, ratio_error_bound(error, mu, nu, tight=tight))


def value_error_bound(
    horizon: int, reward_bound: float, discount: float, *, error: float, nu: float
) -> float:
    """Compute the right-hand side of Theorem V.2 (eq. 5.3), which is false as stated.

    Parameters
    ----------
    horizon : int
        The paper's T. Its sum runs over t = 0..T, T + 1 rewards, as in
        ``policy_value(..., horizon=T + 1)``.
    reward_bound : float
        R, at least the largest absolute reward r(s, a).
    discount : float
        The discount gamma, in [0, 1].
    error : float
        The sup error of both betahat, M(G, delta) / n^{1/4}.
    nu : float
        The lower end of the box of ratios, in (0, 1).

    Returns
    -------
    float
        The bound on the square (J' - J(zhat P))^2. It is inf where x^T overflows.

    See Also
    --------
    value_bound_counterexample : A pair that exceeds the bound.
    corrected_value_error_bound : A true bound of this form.

    Notes
    -----
    With x = gamma / nu the bound is::

        T M^2 R^2 x / sqrt(n) * (1 - (T+1) x^T + T x^{T+1}) / (1 - x)^2
            = T R^2 error^2 sum_{t=1..T} t x^t

    ``value_bound_counterexample`` exceeds it, by any factor as T grows where
    (gamma (1 + error))^2 > gamma / nu. Its proof has sum t where rows that do not sum
    to 1 give sum t^2, drops the constant of the lemma, and bounds zeta by 1/nu, which
    does not bound it.

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


@suggest_keywords
def value_error_sides(
    target: FiniteMDP,
    model: Model,
    policy: PolicyLike,
    *,
    horizon: int,
    error: float,
    nu: float,
    ratio: RatioLike | None = None,
) -> Sides:
    """Compute both sides of Theorem V.2 on a pair of models.

    Parameters
    ----------
    target : FiniteMDP
        P', the target, with rewards r(s, a), as the theorem has them.
    model : FiniteMDP or ReweightedModel
        K, the model: it has the target's rewards, initial distribution and discount.
    policy : PolicyLike
        The policy, also of shape (T + 1, S, A).
    horizon : int
        The paper's T; its sum runs over t = 0..T.
    error : float
        The sup error of both betahat.
    nu : float
        The lower end of the box of ratios, in (0, 1).
    ratio : csr_array of shape (S*A, S) or TransitionRatio, optional
        A ratio: ``model`` is then the simulator P, and K = ratio * P.

    Returns
    -------
    Sides
        The exact (J' - J(K))^2, and ``value_error_bound`` with R the largest absolute
        reward.

    Raises
    ------
    ValueError
        If model and target are not a pair, or if rewards are r(s, a, s').

    See Also
    --------
    value_error_bound : The right-hand side from its constants.

    Examples
    --------
    >>> target, model = (
    ...     FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    ...     for p in (0.6, 0.5)
    ... )
    >>> round(
    ...     value_error_sides(
    ...         target, model, [[1.0]] * 2, horizon=2, error=0.2, nu=0.5
    ...     ).ratio,
    ...     3,
    ... )
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
    """Construct a counterexample to Theorem V.2.

    Parameters
    ----------
    horizon : int
        The paper's T; its sum runs over t = 0..T.
    discount : float
        The discount gamma, in [0, 1].
    epsilon : float
        The sup error of both betahat, at least 0.
    nu : float
        The lower end of the box of ratios, in (0, 1).

    Returns
    -------
    Sides
        The squared error by dynamic programming, and the bound of the theorem.

    See Also
    --------
    value_error_bound : The bound of the theorem.

    Notes
    -----
    P' = P, r = 1, betahat_sas' = 1 + epsilon and betahat_sa = 1, so that zhat is
    1 + epsilon, and the squared error (sum_{t<=T} gamma^t ((1 + epsilon)^t - 1))^2.

    Examples
    --------
    >>> [
    ...     round(value_bound_counterexample(T, 0.99, 0.03, 0.97).ratio, 2)
    ...     for T in (2, 50)
    ... ]
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
    """Compute a true bound in place of Theorem V.2, for rows that sum to 1.

    Parameters
    ----------
    horizon : int
        The paper's T; its sum runs over t = 0..T.
    reward_bound : float
        R, at least the largest absolute reward.
    discount : float
        The discount gamma, in [0, 1].
    error : float
        The largest absolute zhat/zeta - 1.

    Returns
    -------
    float
        The bound on (J' - J(zhat P))^2.

    See Also
    --------
    value_error_bound : The bound of the paper.
    kl_path_bound : The bound that it follows from.

    Notes
    -----
    The bound is 2 T R^2 error^2 sum_{t=1..T} t gamma^{2t}, the paper's form without
    1/nu. It follows from (C) with KL_t <= t error^2, and from Cauchy's inequality. For
    T of order 1 / (1 - gamma) the error is of order (1 - gamma)^{-3/2}, which is not
    exponential.

    Examples
    --------
    >>> round(corrected_value_error_bound(2, 1.0, 0.5, error=0.1), 6)
    0.015
    """
    bound = _checks.number_in(reward_bound, "reward_bound", 0.0, math.inf)
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    size = _checks.number_in(error, "error", 0.0, math.inf)
    steps = _checks.positive_integer(horizon, "horizon")
    # the number of terms may be cut, the factor T may not
    last = limit_horizon(steps, gamma, work=100.0, kept=8)
    t = np.arange(1.0, last + 1.0)
    return float(
        2.0 * steps * (bound * size) * (bound * size) * np.sum(t * gamma ** (2.0 * t))
    )
