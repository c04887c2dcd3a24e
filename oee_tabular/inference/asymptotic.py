"""Large-sample errors of the maximum-likelihood model: delta method and bootstrap.

An interval is widened for transitions outside the simulator's support, and for a
simulator that was made of samples itself.

Of the transitions from (s, a) the target may make a share q_sa that the simulator rules
out, to any state at all:

    q_sa = f / (m + n) + k / (k + n).

The first term is Good and Turing's estimate of the probability of transitions never met
[1], with m samples of the simulator and n of the log, f of the transitions met once; it
is 1 in a row without any, which was filled in. In the second, k transitions of the log
were dropped as impossible (``Problem(impossible="drop")``).

To first order, at the maximum-likelihood model with D_sa the discounted time in (s, a),
they take or add at most

    sum_sa D_sa q_sa abs(extreme of r + gamma V - E_p (r + gamma V)),

the extreme over all states and rewards (with a horizon the sum goes over steps too, V
having those that are left). That is a band and no bound: where q is large, transitions
that lead to where q is large again may lead further. A simulator's own sampling
(``FiniteMDP.from_env``, ``from_log``) adds the variance

    Var_mu(V) / m_starts + sum_sa,s' (D_sa p_s')^2 Var(mean reward of the transition).

Source: [1] I. Good, The population frequencies of species and the estimation of
population parameters, Biometrika 40, 1953.

The bootstrap: B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._sparse import align, find
from oee_tabular.estimators import Problem
from oee_tabular.exact import policy_value, state_values, transition_gradient
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference.evidence import Evidence
from oee_tabular.inference.profile_ascent import PolicyRows, value_of_rows
from oee_tabular.mdp import horizon_length, total_discount
from oee_tabular.typing import Array, IntArray, Seed

MIN_EPISODES = 10  # that a bootstrap of episodes resamples


def value_covariances(evidences: list[Evidence], prior: float) -> tuple[Array, Array]:
    """Compute the covariances of several values by the delta method.

    Cov(J_i, J_j) = sum_x Cov_x(G_i, G_j) / max(n_x, 1). Cov_x is under (n_x phat +
    prior * P) / (n_x + prior), and G is the gradient of J at the maximum-likelihood
    model. Two matrices (k, k) are returned: the sums over rows that the log has, and
    over the others.
    """
    first = evidences[0]
    rows = first.rows
    n = first.rows.spread(first.n)
    law = (n * first.phat + prior * rows.weights) / np.maximum(n + prior, 1e-300)
    gradients = [
        transition_gradient(e.fitted, e.policy, horizon=e.horizon) for e in evidences
    ]
    centred = np.array([g - rows.spread(rows.mean(law, g)) for g in gradients])
    weight = law / np.maximum(n, 1.0)
    recorded, never = (
        (centred * np.where(chosen, weight, 0.0)) @ centred.T
        for chosen in (n > 0, n == 0)
    )
    return np.asarray(recorded), np.asarray(never)


def bootstrap_values(
    problem: Problem,
    evidence: Evidence,
    *,
    by: Literal["transitions", "episodes"],
    n_bootstrap: int,
    seed: Seed,
) -> Array:
    """Compute J of the models of resampled transitions, or of resampled episodes.

    Rows without data in a resample are the simulator's.
    """
    generator = _checks.generator(seed)
    log = problem.log
    rows = evidence.rows
    entry, _ = find(
        evidence.model.transitions,
        log.state * rows.n_actions + log.action,
        log.next_state,
    )
    weight = log.moves().number
    if (weight != np.floor(weight)).any():
        raise ArgumentError(
            "counts", "must be whole numbers to be resampled; some are not"
        )
    n = len(log)
    size = len(evidence.phat)
    n_episodes = 0
    if by == "episodes":
        starts = _check_episodes(log.episode_starts)
        n_episodes = len(starts) - 1
        episode = np.repeat(np.arange(n_episodes), np.diff(starts))
    share = np.bincount(entry, weights=weight, minlength=size) / n
    taken = PolicyRows.from_evidence(evidence)
    values = np.empty(n_bootstrap)
    # the compiled evaluation is for few states, and needs a sum that converges
    is_quick = not taken.is_sparse and (taken.n_steps > 0 or taken.discount < 1.0)
    for b in range(n_bootstrap):
        if by == "episodes":
            chosen = generator.integers(0, n_episodes, n_episodes)
            number = np.bincount(chosen, minlength=n_episodes)
            counted = np.bincount(entry, weights=number[episode], minlength=size)
        else:
            counted = generator.multinomial(n, share)
        drawn = counted.astype(np.float64)
        has_data = rows.spread(rows.sums(drawn)) > 0
        p = np.where(has_data, rows.frequencies(drawn), rows.weights)
        if is_quick:
            values[b] = value_of_rows(taken, p[taken.entries])
        else:
            values[b] = policy_value(
                evidence.with_rows(p), evidence.policy, horizon=evidence.horizon
            )
    return values


def _check_episodes(starts: IntArray | None) -> IntArray:
    """Return where episodes start, if there are enough of them to be resampled."""
    if starts is None:
        raise ArgumentError(
            "log", "must have episodes to be resampled by episodes; it has none"
        )
    n_episodes = len(starts) - 1
    if n_episodes < MIN_EPISODES:
        raise ArgumentError(
            "log",
            f"must have at least {MIN_EPISODES} episodes to be resampled by"
            f" episodes; it has {n_episodes}",
        )
    return starts


class Margin(NamedTuple):
    """By how much an interval widens for what the simulator may lack.

    ``value`` is J of the frequencies, ``variance`` what the simulator's sampling adds,
    ``down`` and ``up`` what transitions outside of its support take and add.
    """

    value: float
    variance: float
    down: float
    up: float
    diagnostics: dict[str, float]

    def widen(self, lower: float, upper: float, z: float) -> tuple[float, float]:
        """Widen the ends of an interval.

        They are those for a simulator that is known and rules nothing out wrongly.
        """
        spread = z * np.sqrt(self.variance)
        below = float(np.hypot(max(self.value - lower, 0.0), spread))
        above = float(np.hypot(max(upper - self.value, 0.0), spread))
        return self.value - below - self.down, self.value + above + self.up


def outside_margin(problem: Problem, evidence: Evidence) -> Margin | None:
    """Compute the margin of a problem; None where nothing needs one.

    That is where the simulator is known and no transition was dropped.
    """
    sampling = problem.simulator.sampling
    if sampling is None and not problem.dropped.any():
        return None
    policy = evidence.policy
    horizon = evidence.horizon
    fitted = evidence.fitted
    rows = evidence.rows
    share = evidence.time_share
    unmet = np.zeros(len(share))
    is_never_met = np.zeros(len(share), dtype=np.bool_)
    variance = 0.0
    if sampling is not None:
        initial = evidence.model.initial
        values = state_values(fitted, policy, horizon=horizon)
        unmet = _unmet_share(evidence, sampling.pairs)
        is_never_met = (sampling.pairs == 0.0) & (evidence.n == 0.0)
        spread = float(initial @ values**2) - float(initial @ values) ** 2
        variance = max(spread, 0.0) / sampling.starts
        if sampling.reward_error is not None:
            time = total_discount(fitted.discount, horizon) * share
            each, _ = align(sampling.reward_error, evidence.model.transitions)
            variance += float((rows.spread(time) * evidence.phat) ** 2 @ each)
    dropped = problem.dropped / np.maximum(problem.dropped + evidence.n, 1.0)
    down, up = _band(evidence, np.minimum(unmet + dropped, 1.0))
    facts: dict[str, float] = {}
    if sampling is not None:
        facts = {
            "unmet_share": float(share @ unmet),
            "never_met_share": float(share @ is_never_met),
            "never_met_row": int(np.argmax(share * is_never_met)),
            "sampling_error": float(np.sqrt(variance)),
        }
    if problem.dropped.any():
        facts |= {
            "dropped_transitions": float(problem.dropped.sum()),
            "dropped_share": float(share @ dropped),
        }
    value = policy_value(fitted, policy, horizon=horizon)
    return Margin(value, variance, down, up, facts)


def _unmet_share(evidence: Evidence, pairs: Array) -> Array:
    """Estimate the share (S*A,) of transitions never met, after Good and Turing.

    ``pairs`` are the simulator's samples of each row, inf where it is known.
    """
    rows = evidence.rows
    known = ~np.isfinite(pairs)
    samples = np.where(np.isfinite(pairs), pairs, 0.0)
    simulated = rows.spread(samples) * evidence.model.transitions.data
    number = np.rint(simulated) + rows.spread(evidence.n) * evidence.phat
    once = rows.sums((np.abs(number - 1.0) < 0.5).astype(float))
    total = samples + evidence.n
    share = np.where(total > 0, np.minimum(once / np.maximum(total, 1.0), 1.0), 1.0)
    return np.where(known, 0.0, share)


def _band(evidence: Evidence, q: Array) -> tuple[float, float]:
    """Compute what a share q (S*A,) of transitions to any state takes and adds.

    It is of first order in q.
    """
    policy = evidence.policy
    fitted = evidence.fitted
    gamma = evidence.fitted.discount
    if evidence.horizon is None:
        time = evidence.time_share / (1.0 - gamma)
        down, up = time @ (q[:, None] * _reach(evidence, state_values(fitted, policy)))
        return float(down), float(up)
    values = np.zeros(len(policy))
    beyond = np.zeros((len(policy), 2))
    for _ in range(horizon_length(evidence.horizon, fitted)):
        later = gamma * (fitted.transitions @ beyond)
        ahead = q[:, None] * _reach(evidence, values) + later
        beyond = np.einsum("sa,sak->sk", policy, ahead.reshape(*policy.shape, 2))
        following = (fitted.transitions @ values).reshape(policy.shape)
        values = (policy * (fitted.rewards + gamma * following)).sum(axis=1)
    down, up = fitted.initial @ beyond
    return float(down), float(up)


def _reach(evidence: Evidence, values: Array) -> Array:
    """Compute how far the extremes of r + gamma V lie from each row's mean, (S*A, 2).

    The first column is for the worst transition, the second for the best.
    """
    rewards = evidence.model.reward_data
    gamma = evidence.model.discount
    # r(s, a) is the row's own wherever the transition leads
    rewards_or_0 = np.zeros(1) if rewards is None else rewards
    ahead = gamma * values[evidence.rows.arrival] + rewards_or_0
    mean = evidence.rows.mean(evidence.phat, ahead)
    worst = gamma * values.min() + rewards_or_0.min()
    best = gamma * values.max() + rewards_or_0.max()
    return np.asarray(np.maximum(np.column_stack([mean - worst, best - mean]), 0.0))
