"""A target and a model of it: both sides of a statement, the checks of a pair, and the simulation lemma.

Reference: [1] Kearns and Singh, Near-optimal reinforcement learning in polynomial time, Machine Learning 49, 2002.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike
from oee_tabular._sparse import align, csr_on_pattern
from oee_tabular.exact import ReweightedModel, occupancy, policy_value, reweight, state_values
from oee_tabular.exact.reweighted import Model
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.arrays import name_transition
from oee_tabular.mdp.horizons import optional_horizon_length


@dataclass(frozen=True)
class Sides:
    """Both sides of an inequality ``left <= right``, each as it was computed (no tolerance).

    Attributes
    ----------
    left, right : float, inf allowed

    Examples
    --------
    >>> sides = Sides(3.0, 2.0)
    >>> sides.holds, sides.ratio
    (False, 1.5)
    """

    left: float
    right: float

    @property
    def holds(self) -> bool:
        """left <= right."""
        return self.left <= self.right

    @property
    def ratio(self) -> float:
        """left / right: above 1 where the inequality fails, by that factor; 0 where left is 0."""
        if self.left == 0.0:
            return 0.0
        return self.left / self.right if self.right > 0.0 else math.inf


@dataclass(frozen=True)
class SimulationLemma:
    """J' - J(K) by two evaluations, and by each form of the lemma; the three are equal up to rounding.

    Attributes
    ----------
    difference : J' - J(K), units of J
    by_target_occupancy, by_model_occupancy : the same, the change of the rows weighted by d' or by d_K

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
    target: FiniteMDP, model: Model, policy: PolicyLike, *, horizon: int | None = None, ratio: object = None
) -> SimulationLemma:
    """J' - J(K) = g/(1-g) <d', (P' - K) V_K> = g/(1-g) <d_K, (P' - K) V'>, for any nonnegative kernel K [1].

    With a horizon, sum_{t<T} g^{t+1} <alpha'_t, (P' - K) V^K_{t+1}>, and the same with the two exchanged (V_T = 0).
    Where rewards are r(s, a, s'), r(s, a, s') + g V(s') takes the place of g V(s').

    Parameters
    ----------
    target : FiniteMDP, P'
    model : FiniteMDP or ReweightedModel, K: the target's rewards, initial distribution and discount, rows of any sum
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None
    ratio : None, or csr (S*A, S) or an object with such ``values``: ``model`` is then the simulator P, and K = ratio * P

    Raises
    ------
    ValueError
        What is not a pair; without a horizon, discount 1 or a K whose infinite sum does not exist.

    Notes
    -----
    Values are not normalised. Cost: O(T * nnz) time and O(T * S) memory, or four sparse solves.

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
    difference = policy_value(target, pi, horizon=steps) - policy_value(kernel, pi, horizon=steps)
    first = _error_by_occupancy(target, kernel, pi, steps, measured=target, valued=kernel)
    second = _error_by_occupancy(target, kernel, pi, steps, measured=kernel, valued=target)
    return SimulationLemma(difference, first, second)


def _error_by_occupancy(
    target: Model, kernel: Model, pi: Array, steps: int | None, *, measured: Model, valued: Model
) -> float:
    """sum_t g^t <alpha_t, r' - r_K + g (P' - K) V_{t+1}>: alpha of ``measured``, V of ``valued``."""
    gamma, reward_error = target.discount, target.rewards - kernel.rewards

    def row_errors(value: Array) -> Array:
        change: Array = target.transitions @ value - kernel.transitions @ value
        return reward_error + gamma * change.reshape(reward_error.shape)

    if steps is None:
        errors = row_errors(state_values(valued, pi))
        return float(np.sum(occupancy(measured, pi) * errors) / (1.0 - gamma))
    to_go = np.zeros((steps + 1, target.n_states))
    for t in range(steps - 1, -1, -1):
        q = valued.rewards + gamma * (valued.transitions @ to_go[t + 1]).reshape(reward_error.shape)
        to_go[t] = np.sum((pi if pi.ndim == 2 else pi[t]) * q, axis=1)
    alphas = enumerate(forward_distributions(measured, pi, steps))
    return sum(gamma**t * float(np.sum(pairs * row_errors(to_go[t + 1]))) for t, pairs in alphas)


def forward_distributions(model: Model, pi: Array, steps: int) -> Iterator[Array]:
    """alpha_t, (S, A), for t = 0..steps-1; not normalised."""
    transposed = sparse.csr_array(model.transitions.T)
    states = model.initial
    for t in range(steps):
        pairs = states[:, None] * (pi if pi.ndim == 2 else pi[t])
        yield pairs
        states = transposed @ pairs.reshape(-1)


def check_pair(target: object, model: object, ratio: object = None) -> FiniteMDP | ReweightedModel:
    """K: ``model``, or ratio * model; a ValueError where it is not the target's MDP under other dynamics."""
    target = _checks.instance(target, FiniteMDP, "target")
    if ratio is not None:
        model = reweight(_checks.instance(model, FiniteMDP, "model", "FiniteMDP (the simulator) with a ratio"), ratio)
    if not isinstance(model, FiniteMDP | ReweightedModel):
        raise ValueError(f"model must be a FiniteMDP or a ReweightedModel; got {type(model).__name__}")
    if target.transitions.shape != model.transitions.shape:
        raise ValueError(
            f"target and model must have the same states and actions; their transitions have shapes "
            f"{target.transitions.shape} and {model.transitions.shape}"
        )
    if target.discount != model.discount:
        raise ValueError(f"model must have the target's discount {target.discount:g}; it has {model.discount:g}")
    bad = np.flatnonzero(np.abs(target.initial - model.initial) > _checks.SUM_TOLERANCE)
    if bad.size:
        s = bad[0]
        raise ValueError(f"model.initial[{s}] must be the target's {target.initial[s]:g}; it is {model.initial[s]:g}")
    _check_rewards(target, model)
    return model


def _check_rewards(target: FiniteMDP, model: Model) -> None:
    """Check the form of rewards, and their values (r(s, a, s') on the transitions that both make)."""
    if target.reward_data is None or model.reward_data is None:
        if target.reward_data is not model.reward_data:
            forms = ["r(s, a)" if m.reward_data is None else "r(s, a, s')" for m in (target, model)]
            raise ValueError(f"model must have the target's form of rewards, {forms[0]}; it has {forms[1]}")
        bad = np.argwhere(~np.isclose(target.rewards, model.rewards, rtol=1e-9, atol=1e-12))
        if bad.size:
            s, a = bad[0]
            wanted, found = target.rewards[s, a], model.rewards[s, a]
            raise ValueError(f"model.rewards[{s}, {a}] must be the target's {wanted:g}; it is {found:g}")
        return
    found, shared = align(csr_on_pattern(model.transitions, model.reward_data), target.transitions)
    wrong = np.flatnonzero(shared & ~np.isclose(found, target.reward_data, rtol=1e-9, atol=1e-12))
    if wrong.size:
        k = int(wrong[0])
        where = name_transition(target.transitions, k, target.n_actions, target.names)
        raise ValueError(
            f"model's reward at {where} must be the target's {target.reward_data[k]:g}; it is {found[k]:g}"
        )


def check_box(nu: float, mu: float) -> tuple[float, float]:
    """nu in (0, 1) and mu > 1, or ValueError."""
    lower = _checks.number_in(nu, "nu", 0.0, 1.0, open_ends=True)
    return lower, _checks.number_in(mu, "mu", 1.0, math.inf, open_ends=True)


def check_ratio(value: object, name: str, nu: float, mu: float) -> Array:
    """The values of a g as an array, or ValueError where one is outside [nu, mu]."""
    array = _checks.float_array(value, name, ndim=1)
    bad = np.flatnonzero(~((array >= nu) & (array <= mu)))
    if bad.size:
        raise ValueError(f"{name}[{bad[0]}] must be in [nu, mu] = [{nu:g}, {mu:g}]; it is {array[bad[0]]}")
    return array
