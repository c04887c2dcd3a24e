"""Doubly robust sums over the log's episodes, step by step: what DoublyRobust(data="episodes") and Magic share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import Estimate, effective_sample_size, mean_and_error
from oee_tabular.estimators.importance_sampling import ImportanceSampling
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.rollouts import rollout_horizon, segment_products, weight_status
from oee_tabular.exact import Model, action_values, state_values
from oee_tabular.exact.walks import walk_of
from oee_tabular.ratio import TransitionRatio
from oee_tabular.ratio.method import Population


@dataclass(frozen=True, eq=False)
class EpisodeTerms:
    """The doubly robust estimator on episodes: each episode's value, the total, its error, and the last weights.

    ``partial`` (episodes, T + 2) are its parts by the number of steps j = 0..T + 1 that the log is used for, the model's value
    after them (weighted doubly robust only). The total is sum_t sum_i share_ti ``gains``_ti, share_ti = ``weights``_ti (both
    (T + 2, episodes)) over their number, or over their sum at t.
    """

    values: Array
    total: float
    error: float | None
    last: Array
    partial: Array
    weights: Array
    gains: Array

    def resampled(self, draws: IntArray) -> Array:
        """(b,) weighted totals of the resamples ``draws`` (b, episodes) of the episodes, weights normalised on each.

        nan where at some step all weights of a resample are 0.
        """
        n, products = len(self.values), self.weights * self.gains
        totals = np.empty(len(draws))
        for b, draw in enumerate(draws):
            number = np.bincount(draw, minlength=n)
            with np.errstate(invalid="ignore"):
                totals[b] = float(((products @ number) / (self.weights @ number)).sum())
        return totals


def episode_estimate(
    found: EpisodeTerms, zeta: TransitionRatio, value: float, error: float | None, **more: object
) -> Estimate:
    """An estimate from the log's episodes with a model zeta * P; ``more`` joins the diagnostics."""
    n, effective = len(found.values), effective_sample_size(found.last)
    return Estimate(
        value,
        error,
        diagnostics={
            "standard_error_of": "log",
            "n_episodes": n,
            "effective_sample_size": effective,
            "largest_weight": float(found.last.max()),
            **more,
            "gap": zeta.gap,
        },
        status=weight_status(value),
        findings=(*findings.varied(error), *findings.weights(effective, n, "episodes"), *findings.gap(zeta.gap)),
        is_from_episodes=True,
    )


def episode_terms(problem: Problem, policy: Array, model: Model, *, self_normalized: bool) -> EpisodeTerms:
    """Policy importance sampling on the log's episodes with V and Q of ``model`` as control variates."""
    log = problem.recorded
    ratio = ImportanceSampling().ratios(problem, policy)
    starts, timestep = log.episode_starts, log.timestep
    assert starts is not None
    assert timestep is not None
    gamma, horizon = model.discount, problem.horizon
    longest = int(np.diff(starts).max())
    steps = longest if horizon is None else min(longest, horizon)
    n = len(starts) - 1
    lengths = np.minimum(np.diff(starts), steps)
    final = starts[:-1] + lengths - 1
    over = log.terminated[final] | problem.simulator.absorbing()[log.next_state[final]]
    v, q = model_values(model, policy, horizon, steps)
    products = segment_products(ratio, starts)
    shares = np.zeros((steps + 1, n))  # rho_0..t-1 / n, or over its sum: an episode that is over keeps its weight
    shares[0] = 1.0 / n
    weights, gains = np.ones((steps + 1, n)), np.zeros((steps + 1, n))
    for t in range(steps):
        row = starts[:-1] + np.minimum(t, lengths - 1)
        weight = weights[t + 1] = products[row]
        mass = float(weight.sum())
        if self_normalized and mass == 0.0:
            nothing = np.full(n, np.nan)
            return EpisodeTerms(
                nothing, float("nan"), None, products[final], np.full((n, steps + 1), np.nan), weights, gains
            )
        shares[t + 1] = weight / (mass if self_normalized else n)
    rewards = problem.rewards_of(log)
    begun = np.zeros((n, steps + 1))  # what the log's first j steps give, in shares
    running = np.zeros(n)
    closing = np.zeros((n, steps + 1))  # and the model's value after them
    closing[:, 0] = shares[0] * v[0][log.state[starts[:-1]]]
    for t in range(steps):
        alive = lengths > t
        row = (starts[:-1] + t)[alive]
        s, a = log.state[row], log.action[row]
        paid = rewards[row] - q[t][s, a]
        running[alive] += gamma**t * (shares[t + 1][alive] * paid + shares[t][alive] * v[t][s])
        gains[t + 1, alive] += gamma**t * paid
        gains[t, alive] += gamma**t * v[t][s]
        begun[:, t + 1] = running
        ended = np.where(alive, lengths == t + 1, True)
        gone = ended & over
        cut = ended & ~over  # a truncated episode goes on as the model
        stop = np.where(alive, t + 1, lengths)
        state = log.next_state[starts[:-1] + stop - 1]
        at = np.minimum(stop, steps)
        rest = v[at, state] * gamma**stop
        if horizon is not None:
            rest = np.where(stop >= horizon, 0.0, rest)
        own = np.where(cut, shares[np.minimum(stop, steps), np.arange(n)], shares[t + 1])
        closing[:, t + 1] = np.where(gone, 0.0, own * rest)
    gains[at, np.arange(n)] += np.where(gone, 0.0, rest)  # at the last step every episode is gone or cut
    partial = begun + closing
    values = partial[:, -1] * n
    total = float(partial[:, -1].sum())
    error = mean_and_error(values)[1]
    if error is not None:
        error = float(np.sqrt(n / (n - 1.0) * np.sum((partial[:, -1] - total / n) ** 2)))
    return EpisodeTerms(values, total, error, products[final], partial, weights, gains)


def model_values(model: Model, policy: Array, horizon: int | None, steps: int) -> tuple[Array, Array]:
    """V (steps + 1, S) and Q (steps, S, A) of the model at each step."""
    if horizon is None:
        v, q = state_values(model, policy), action_values(model, policy)
        return np.tile(v, (steps + 1, 1)), np.broadcast_to(q, (steps, *q.shape))
    values = np.zeros((horizon + 1, model.n_states))
    pairs = np.zeros((horizon, model.n_states, model.n_actions))
    for t in range(horizon - 1, -1, -1):
        pairs[t] = model.rewards + model.discount * (model.transitions @ values[t + 1]).reshape(model.rewards.shape)
        values[t] = (policy * pairs[t]).sum(axis=1)
    return values[: steps + 1], pairs[:steps]


def episode_limit(people: Population, model: Model) -> float:
    """E[V(s_0) + sum rho ...], by the recursion of its mean; J_target where the behaviour policy has support."""
    if people.behavior is None:
        return people.value(people.target)
    steps = rollout_horizon(people.target.discount, people.horizon)
    v, q = model_values(model, people.policy, people.horizon, steps)
    walk = walk_of(people.target, people.behavior, policy=people.policy)
    reached = walk.weights_by_state(steps, power=1)[:-1, 0]
    gains = v[:-1] + walk.sum_actions(walk.act * walk.u * (people.target.rewards - q).reshape(steps, -1))
    return float(people.target.discount ** np.arange(steps, dtype=np.float64) @ (reached * gains).sum(axis=1))
