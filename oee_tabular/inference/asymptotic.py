"""Large-sample errors of the maximum-likelihood model: covariances by the delta method, and the bootstrap.

Source: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993.
"""

from __future__ import annotations

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, Seed
from oee_tabular._sparse import find
from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value, transition_gradient
from oee_tabular.inference.evidence import Evidence
from oee_tabular.inference.likelihood import PolicyRows, value_of_rows

FEWEST_EPISODES = 10


def value_covariances(evidences: list[Evidence], prior: float) -> tuple[Array, Array]:
    """Cov(J_i, J_j) = sum_x Cov_x(G_i, G_j) / max(n_x, 1), (k, k) each of the rows that the log has, and of those it has not.

    Cov_x is under (n_x phat + prior * P) / (n_x + prior), G the gradient of J at the maximum-likelihood model.
    """
    first = evidences[0]
    rows, n = first.rows, first.rows.spread(first.n)
    law = (n * first.phat + prior * rows.weights) / np.maximum(n + prior, 1e-300)
    gradients = [transition_gradient(e.fitted, e.policy, horizon=e.horizon) for e in evidences]
    centred = np.array([g - rows.spread(rows.mean(law, g)) for g in gradients])
    weight = law / np.maximum(n, 1.0)
    recorded, never = ((centred * np.where(chosen, weight, 0.0)) @ centred.T for chosen in (n > 0, n == 0))
    return np.asarray(recorded), np.asarray(never)


def bootstrap_values(problem: Problem, evidence: Evidence, *, by: str, n_bootstrap: int, seed: Seed) -> Array:
    """J of the models of ``n_bootstrap`` resamples of transitions or of whole episodes; rows without data the simulator's."""
    generator, log, rows = _checks.generator(seed), problem.log, evidence.rows
    entry, _ = find(evidence.model.transitions, log.state * rows.n_actions + log.action, log.next_state)
    weight = log.moves().number
    if (weight != np.floor(weight)).any():
        raise ValueError("counts must be whole numbers to be resampled; some are not")
    n, size, starts = len(log), len(evidence.phat), log.episode_starts
    n_episodes = 0 if starts is None else len(starts) - 1
    if by == "episodes":
        if starts is None:
            raise ValueError("log must have episodes to be resampled by episodes; it has none")
        if n_episodes < FEWEST_EPISODES:
            raise ValueError(
                f"log must have at least {FEWEST_EPISODES} episodes to be resampled by episodes; it has {n_episodes}"
            )
        episode = np.repeat(np.arange(n_episodes), np.diff(starts))
    share = np.bincount(entry, weights=weight, minlength=size) / n
    taken, values = PolicyRows.from_evidence(evidence), np.empty(n_bootstrap)
    is_quick = not taken.is_sparse and (taken.n_steps > 0 or taken.discount < 1.0)
    for b in range(n_bootstrap):
        if by == "episodes":
            number = np.bincount(generator.integers(0, n_episodes, n_episodes), minlength=n_episodes)
            drawn = np.bincount(entry, weights=number[episode], minlength=size).astype(np.float64)
        else:
            drawn = generator.multinomial(n, share).astype(np.float64)
        p = np.where(rows.spread(rows.sums(drawn)) > 0, rows.frequencies(drawn), rows.weights)
        if is_quick:
            values[b] = value_of_rows(taken, p[taken.entries])
        else:
            values[b] = policy_value(evidence.with_rows(p), evidence.policy, horizon=evidence.horizon)
    return values
