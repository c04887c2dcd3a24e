"""A bound on the error of J by the divergence of paths: (C) of notebooks/statements.md. Notation as in bounds.

Reference: [1] Tsybakov, Introduction to Nonparametric Estimation, 2009, section 2.4 (Pinsker; KL of a path).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import special

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike
from oee_tabular._sparse import align, row_sums
from oee_tabular.exact.reweighted import Model
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import followed, optional_steps
from oee_tabular.theory.bounds import constants, measured, on_moves, require_rows, terms_of_a_sum, value_error
from oee_tabular.theory.simulation_lemma import Sides, check_pair, forward_distributions


def path_kl(target: FiniteMDP, model: Model, policy: PolicyLike, *, horizon: int, ratio: object = None) -> Array:
    """KL_t = sum_{k<t} E_K[KL(K || P')(s_k, a_k)] in nats for t = 0..T, shape (T + 1,).

    By the chain rule [1] the divergence of the first t moves under K from those under P'. inf from the first move on that K
    makes and the target does not. Cost: O(T * nnz).

    Parameters
    ----------
    target, model, policy, ratio : as in ``normalised_sides``, whose errors are these
    horizon : T, a positive int

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
    >>> path_kl(target, model, [[1.0]] * 2, horizon=3).round(4).tolist()  # log(25 / 24) / 2 a move
    [0.0, 0.0204, 0.0408, 0.0612]
    """
    kernel = check_pair(target, model, ratio)
    require_rows(kernel)
    steps = followed(_checks.positive_integer(horizon, "horizon"), 1.0, work=kernel.transitions.nnz)
    pi = check_policy(policy, target, horizon=steps)
    return _path_kl(kernel, pi, steps, _row_kl(target, kernel))


def _path_kl(kernel: Model, pi: Array, steps: int, rows: Array) -> Array:
    result = np.zeros(steps + 1)
    for t, pairs in enumerate(forward_distributions(kernel, pi, steps)):
        made = pairs.reshape(-1) > 0.0  # 0 * inf is 0 here
        result[t + 1] = result[t] + pairs.reshape(-1)[made] @ rows[made]
    return result


def _row_kl(target: Model, kernel: Model) -> Array:
    """(S*A,): KL(K || P') of each row."""
    on_kernel, _ = align(target.transitions, kernel.transitions)
    _, shared = align(kernel.transitions, target.transitions)
    elsewhere = row_sums(target.transitions, np.where(shared, 0.0, target.transitions.data))
    return row_sums(kernel.transitions, divergence_terms(kernel.transitions.data, on_kernel)) + elsewhere


def divergence_terms(p: Array, q: Array) -> Array:
    """p log(p/q) - p + q >= 0, entry by entry, to full relative precision for q near p; q where p = 0, inf where q = 0 < p."""
    terms: Array = np.asarray(special.kl_div(p, q))
    near = (p > 0.0) & (np.abs(q - p) < 0.5 * p)
    change = (q[near] - p[near]) / p[near]
    terms[near] = p[near] * (change - np.log1p(change))
    return terms


def kl_path_bound(path_divergence: object, reward_bound: float, discount: float) -> float:
    """(C), where the rows of K sum to 1: |J(K) - J'| <= R sum_{t<T} g^t min(2, sqrt(2 KL_t)).

    Parameters
    ----------
    path_divergence : (T,) nonnegative, inf allowed: KL of the moves that the reward at t rests on, t = 0..T-1; with
        ``path_kl`` its entries 0..T-1 for r(s, a), 1..T for r(s, a, s')
    reward_bound : R = max |r|, in [0, inf)
    discount : g in [0, 1]

    Notes
    -----
    Proof: |E_K r_t - E_P' r_t| <= 2 R TV of those moves; Pinsker; the chain rule. No exponential in the horizon: with
    |zhat/zeta - 1| <= eps, KL_t <= t eps^2 (``corrected_value_error_bound``). It is tight to second order in eps.

    Examples
    --------
    >>> kl_path_bound([0.0, 0.5, 8.0], 1.0, 0.5)
    1.0
    """
    kl = _checks.float_array(path_divergence, "path_divergence", ndim=1)
    bad = np.flatnonzero(~(kl >= 0.0))
    if bad.size:
        raise ValueError(f"path_divergence[{bad[0]}] must be nonnegative; it is {kl[bad[0]]}")
    _, bound, gamma, _ = constants(0.0, reward_bound, discount, None)
    return float(bound * np.sum(gamma ** np.arange(len(kl)) * np.minimum(2.0, np.sqrt(2.0 * kl))))


def kl_path_sides(
    target: FiniteMDP, model: Model, policy: PolicyLike, *, horizon: int | None = None, ratio: object = None
) -> Sides:
    """(C) on a pair: |J(K) - J'| by dynamic programming, and ``kl_path_bound`` of the pair's own path divergence.

    Without a horizon the sum runs to discount^t = 1e-12 (at most 100 000 steps), and what follows is bounded by
    Jensen's inequality, so right stays a bound. Cost: O(T * nnz).

    Parameters
    ----------
    target, model, policy, horizon, ratio : as in ``normalised_sides``, whose errors are these

    Examples
    --------
    >>> target, model = (FiniteMDP([[[1 - p, p]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5) for p in (0.6, 0.5))
    >>> round(kl_path_sides(target, model, [[1.0]] * 2, horizon=3).ratio, 3)
    0.435
    """
    kernel = check_pair(target, model, ratio)
    require_rows(kernel)
    left = value_error(target, kernel, policy, horizon)
    _, bound, gamma = measured(target, kernel)
    shift = int(on_moves(target))
    rows = _row_kl(target, kernel)
    steps = optional_steps(horizon, kernel, policy)
    pi = check_policy(policy, target, horizon=steps)
    if steps is not None:
        return Sides(left, kl_path_bound(_path_kl(kernel, pi, steps, rows)[shift:][:steps], bound, gamma))
    if gamma == 1.0:  # every state that is reached is reached in S moves
        never = bound == 0.0 or _path_kl(kernel, pi, kernel.n_states, rows)[-1] == 0.0
        return Sides(left, 0.0 if never else math.inf)
    length = terms_of_a_sum(gamma)
    kl = _path_kl(kernel, pi, length + shift, rows)[shift:]
    later = kl[length] + rows.max() * gamma / (1.0 - gamma) if gamma > 0.0 else 0.0
    tail = gamma**length / (1.0 - gamma) * min(2.0, math.sqrt(2.0 * later))
    return Sides(left, kl_path_bound(kl[:length], bound, gamma) + bound * tail)
