"""What the simulator's own sampling adds to an interval, where it was made of samples (``FiniteMDP.from_env``, ``from_log``).

To first order, at the maximum-likelihood model, D_sa the discounted time in (s, a), m samples of the simulator, n of the
log (with a horizon the last sum goes over steps too, V having those that are left):

    variance        Var_mu(V) / m_starts + sum_x,s' (D_x p_xs')^2 Var(mean reward of the move)
    what may lie beyond the sampled support, each way
                    sum_x D_x q_x |extreme of r + gamma V - E_p (r + gamma V)|,   q_x = f_x / (m_x + n_x)

q_x is Good and Turing's estimate of the probability of moves never met, f_x how many were met once [1]; 1 in a row without any
sample, which was filled in. Such moves may lead anywhere.

Source: [1] I. Good, The population frequencies of species and the estimation of population parameters, Biometrika 40, 1953.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._sparse import align
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, occupancy, policy_value, state_values
from oee_tabular.inference.ambiguity import Evidence
from oee_tabular.mdp.horizons import steps_of


class Margin(NamedTuple):
    """J of the frequencies, the variance that the sampling adds, what unmet moves may take and add, their share of the time."""

    value: float
    variance: float
    down: float
    up: float
    unmet_share: float

    def widened(self, end: float, sign: float, z: float) -> float:
        """An end of an interval for a simulator that is known, as that for the sampled one."""
        half = float(np.hypot(max(sign * (end - self.value), 0.0), z * np.sqrt(self.variance)))
        return self.value + sign * (half + (self.up if sign > 0 else self.down))


def sampling_margin(problem: Problem, evidence: Evidence) -> Margin | None:
    """None where the simulator is known."""
    sampling = problem.simulator.sampling
    if sampling is None:
        return None
    model, policy, horizon = evidence.model, evidence.policy, evidence.horizon
    fitted = evidence.with_rows(evidence.phat)
    values = state_values(fitted, policy, horizon=horizon)
    time = occupancy(fitted, policy, horizon=horizon).reshape(-1) * _steps(model.discount, horizon)
    unmet = _unmet(evidence, sampling.pairs)
    start = max(float(model.initial @ values**2) - float(model.initial @ values) ** 2, 0.0) / sampling.starts
    error = 0.0
    if sampling.reward_error is not None:
        each, _ = align(sampling.reward_error, model.transitions)
        error = float((time[evidence.rows] * evidence.phat) ** 2 @ each)
    down, up = (
        (float(time @ (unmet * _beyond(evidence, values, sign))) for sign in (-1.0, 1.0))
        if horizon is None
        else _step_by_step(evidence, fitted, unmet, horizon)
    )
    share = float(time @ unmet) / _steps(model.discount, horizon)
    return Margin(policy_value(fitted, policy, horizon=horizon), start + error, down, up, share)


def _step_by_step(evidence: Evidence, fitted: ReweightedModel, unmet: Array, horizon: int) -> tuple[float, float]:
    """What may lie beyond, down and up, each step's with the V of the steps that are left."""
    policy, gamma = evidence.policy, fitted.discount
    values, beyond = np.zeros(len(policy)), np.zeros((len(policy), 2))
    for _ in range(steps_of(horizon, fitted)):
        each = np.column_stack([unmet * _beyond(evidence, values, sign) for sign in (-1.0, 1.0)])
        ahead = (each + gamma * (fitted.transitions @ beyond)).reshape(*policy.shape, 2)
        beyond = np.einsum("sa,sak->sk", policy, ahead)
        worth = fitted.rewards + gamma * (fitted.transitions @ values).reshape(policy.shape)
        values = (policy * worth).sum(axis=1)
    down, up = evidence.model.initial @ beyond
    return float(down), float(up)


def _unmet(evidence: Evidence, pairs: Array) -> Array:
    """(S*A,) q of each row."""
    known = ~np.isfinite(pairs)
    simulator = evidence.model.transitions.data * np.where(known, 0.0, pairs)[evidence.rows]
    number = np.rint(simulator) + np.where(evidence.n > 0, evidence.n, 0.0)[evidence.rows] * evidence.phat
    once = np.bincount(evidence.rows, np.abs(number - 1.0) < 0.5, len(pairs))
    total = np.where(known, 1.0, pairs) + evidence.n
    return np.where(known, 0.0, np.where(total > 0, np.minimum(once / np.maximum(total, 1.0), 1.0), 1.0))


def _beyond(evidence: Evidence, values: Array, sign: float) -> Array:
    """(S*A,) by how much the best (sign 1) or worst r + gamma V of any move differs from the row's own mean."""
    model, gamma = evidence.model, evidence.model.discount
    extreme = gamma * sign * float((sign * values).max())
    ahead = gamma * np.bincount(evidence.rows, evidence.phat * values[model.transitions.indices], len(evidence.n))
    if model.reward_data is None:
        return np.asarray(np.maximum(sign * (extreme - ahead), 0.0))
    paid = np.bincount(evidence.rows, evidence.phat * model.reward_data, len(evidence.n))
    extreme += sign * float((sign * model.reward_data).max())
    return np.asarray(np.maximum(sign * (extreme - ahead - paid), 0.0))


def _steps(discount: float, horizon: int | None) -> float:
    """sum_t gamma^t."""
    if horizon is None:
        return 1.0 / (1.0 - discount)
    return float(horizon) if discount == 1.0 else (1.0 - discount**horizon) / (1.0 - discount)
