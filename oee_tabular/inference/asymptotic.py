"""Large-sample intervals of the maximum-likelihood model: the delta method, and the bootstrap.

Rows without data are the simulator's, and taken for known: where the policy needs them these intervals are too short, which
their diagnostics say (``unvisited_share``).

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._sparse import find
from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value, transition_gradient
from oee_tabular.inference.evidence import Evidence, simulator_rows

FEWEST_EPISODES = 10


def delta_ends(evidence: Evidence, confidence: float) -> tuple[float, float, float]:
    """(lower, upper, standard error): J -+ z sqrt(sum_x Var_phat[G_x] / n_x), G the gradient at the model."""
    model = evidence.with_rows(evidence.phat)
    value = policy_value(model, evidence.policy, horizon=evidence.horizon)
    gradient = transition_gradient(model, evidence.policy, horizon=evidence.horizon)
    starts, rows = evidence.indptr[:-1], evidence.rows
    mean = np.add.reduceat(evidence.phat * gradient, starts)
    variance = np.add.reduceat(evidence.phat * (gradient - mean[rows]) ** 2, starts)
    seen = evidence.n > 0
    error = float(np.sqrt(np.sum(variance[seen] / evidence.n[seen])))
    z = float(ndtri(0.5 + confidence / 2.0))
    return value - z * error, value + z * error, error


def bootstrap_values(problem: Problem, evidence: Evidence, *, by: str, n_bootstrap: int, seed: Seed) -> Array:
    """J of the models of ``n_bootstrap`` resamples of transitions or of whole episodes."""
    generator = _checks.generator(seed)
    log = problem.log
    rows = log.state * problem.simulator.n_actions + log.action
    entry, _ = find(evidence.model.transitions, rows, log.next_state)
    weight = log.moves().number
    if (weight != np.floor(weight)).any():
        raise ValueError("counts must be whole numbers to be resampled; some are not")
    n = len(log)
    size = len(evidence.phat)
    starts = log.episode_starts
    if by == "episodes":
        if starts is None:
            raise ValueError("log must have episodes to be resampled by episodes; it has none")
        if len(starts) - 1 < FEWEST_EPISODES:
            raise ValueError(
                f"log must have at least {FEWEST_EPISODES} episodes to be resampled by episodes; it has {len(starts) - 1}"
            )
        episode = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    base = simulator_rows(evidence)
    counts = np.bincount(entry, weights=weight, minlength=size)
    values = np.empty(n_bootstrap)
    for b in range(n_bootstrap):
        if by == "episodes":
            assert starts is not None
            number = np.bincount(generator.integers(0, len(starts) - 1, len(starts) - 1), minlength=len(starts) - 1)
            drawn = np.bincount(entry, weights=number[episode], minlength=size)
        else:
            drawn = generator.multinomial(n, counts / n).astype(np.float64)
        total = np.add.reduceat(drawn, evidence.indptr[:-1])[evidence.rows]
        p = np.where(total > 0, drawn / np.maximum(total, 1.0), base)
        values[b] = _quick_value(evidence, p)
    return values


def _quick_value(evidence: Evidence, p: Array) -> float:
    """J of the model with rows p: densely for small infinite-horizon problems, which a bootstrap solves hundreds of times.

    Measured on grids, one thread: 7.7 times as fast as ``policy_value`` at 16 states, 3.3 at 100, 2.0 at 144.
    """
    model, size = evidence.model, evidence.model.n_states
    if evidence.horizon is not None or size > 150 or model.discount == 1.0:
        return policy_value(evidence.with_rows(p), evidence.policy, horizon=evidence.horizon)
    rows, columns = evidence.rows, model.transitions.indices
    weight = evidence.policy.reshape(-1)[rows] * p
    start = rows // model.n_actions
    kernel = np.bincount(start * size + columns, weights=weight, minlength=size * size).reshape(size, size)
    pay = model.reward_data if model.reward_data is not None else model.rewards.reshape(-1)[rows]
    paid = np.bincount(start, weights=weight * pay, minlength=size)
    return float(model.initial @ np.linalg.solve(np.eye(size) - model.discount * kernel, paid))
