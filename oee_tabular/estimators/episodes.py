"""The log's episodes: the weights policy / behaviour of importance sampling, and doubly robust sums step by step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.data import Transitions
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import Estimate, effective_sample_size, mean_and_error
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.rollouts import rollout_horizon, segment_products, weight_status
from oee_tabular.exact import Model, state_values
from oee_tabular.exact.finite import values_to_go
from oee_tabular.exact.walks import walk_of
from oee_tabular.ratio import TransitionRatio
from oee_tabular.ratio.method import Population

LARGEST_WEIGHT = 1e150  # its square is still a float


class Episodes(NamedTuple):
    """Where the log's n episodes start (n + 1,), how many steps within the horizon they have, and which are over then."""

    log: Transitions
    starts: IntArray
    lengths: IntArray
    is_over: BoolArray

    @classmethod
    def from_problem(cls, problem: Problem) -> Episodes:
        """Those of ``problem.recorded``."""
        log = problem.recorded
        if log.episode_starts is None:
            raise ValueError(
                "importance sampling needs whole episodes: give the log its episode column, or Problem(episodes=...)"
            )
        starts, whole = log.episode_starts, np.diff(log.episode_starts)
        lengths = whole if problem.horizon is None else np.minimum(whole, problem.horizon)
        final = starts[:-1] + lengths - 1
        return cls(log, starts, lengths, log.terminated[final] | problem.simulator.absorbing()[log.next_state[final]])


def behavior_ratios(problem: Problem, policy: Array, *, is_estimated: bool = False) -> Array:
    """policy(a | s) / behaviour(a | s) of each row of the log; 1 where the episode is over.

    ``is_estimated``: the behaviour is the log's action frequencies, and not what was recorded or given.
    """
    log = problem.recorded
    if is_estimated:
        pairs = np.zeros((problem.simulator.n_states, problem.simulator.n_actions))
        np.add.at(pairs, (log.state, log.action), 1.0)
        behavior = pairs[log.state, log.action] / pairs.sum(axis=1)[log.state]
    else:
        behavior = _behavior_probabilities(problem, log)
    with np.errstate(over="ignore"):
        ratio = policy[log.state, log.action] / behavior
    beyond = np.flatnonzero(~(ratio <= LARGEST_WEIGHT))
    if beyond.size:
        row = int(beyond[0])
        raise ValueError(
            f"behavior_probability must be large enough for a weight that floats can square; in row {row} it is "
            f"{behavior[row]:g}, and the policy takes that action with probability {policy[log.state[row], log.action[row]]:g}"
        )
    return np.where(problem.simulator.absorbing()[log.state], 1.0, ratio)


def _behavior_probabilities(problem: Problem, log: Transitions) -> Array:
    """The recorded probability of each action, or that of ``behavior_policy``."""
    if log.behavior_probability is not None:
        probability, name = log.behavior_probability, "log.behavior_probability"
    elif problem.behavior_policy is not None:
        probability, name = problem.behavior_policy[log.state, log.action], "behavior_policy"
    else:
        raise ValueError(
            "importance sampling needs behaviour probabilities: the log has none; give Problem(behavior_policy=...) "
            "(--behavior), or use behavior='estimated'"
        )
    zero = np.flatnonzero(probability == 0)
    if zero.size:
        row = int(zero[0])
        raise ValueError(
            f"{name} must be positive for the actions taken; it is 0 in row {row} (s={log.state[row]}, "
            f"a={log.action[row]}; {zero.size} such rows in all)"
        )
    return np.asarray(probability)


@dataclass(frozen=True, eq=False)
class EpisodeTerms:
    """The doubly robust estimator on n episodes of at most T steps, V and Q of a model as control variates.

    The value is sum_t sum_i share_ti ``gains``_ti, where share_ti is ``weights``_ti = rho_0 ... rho_{t-1} over n, or over their
    sum at t (both are (T + 1, n); an episode that has ended keeps its weight). ``partial`` (n, T + 1) are its parts where
    the log is used for j = 0..T steps and the model's value after them.
    """

    weights: Array
    gains: Array
    partial: Array

    @classmethod
    def from_problem(cls, problem: Problem, policy: Array, model: Model, *, self_normalized: bool) -> EpisodeTerms:
        """The terms, nan where the weights to divide by are all 0."""
        log, starts, lengths, is_over = Episodes.from_problem(problem)
        n, steps, gamma = len(lengths), int(lengths.max()), model.discount
        v, q = model_values(model, policy, problem.horizon, steps)
        t, used = np.arange(steps)[:, None], np.minimum(np.arange(steps + 1)[:, None], lengths)
        rows = starts[:-1] + np.minimum(t, lengths - 1)
        state, action = log.state[rows], log.action[rows]
        products = segment_products(behavior_ratios(problem, policy), starts)
        weights = np.vstack([np.ones((1, n)), products[rows]])
        factor = np.where(t < lengths, gamma ** t.astype(np.float64), 0.0)
        residual = factor * (problem.rewards_of(log)[rows] - q[t, state, action])  # carries W_{t+1}
        value = factor * v[t, state]  # carries W_t
        at = np.where(used == 0, log.state[starts[:-1]], log.next_state[starts[:-1] + np.maximum(used, 1) - 1])
        rest = np.where(
            (used == lengths) & is_over, 0.0, gamma**used * v[used, at]
        )  # of the model after ``used`` steps
        with np.errstate(invalid="ignore"):
            shares = weights / (weights.sum(axis=1, keepdims=True) if self_normalized else n)
        gains = np.zeros((steps + 1, n))
        gains[1:] = residual
        gains[:-1] += value
        gains[lengths, np.arange(n)] += rest[-1]
        partial = np.take_along_axis(shares, used, axis=0) * rest
        partial[1:] += np.cumsum(shares[1:] * residual + shares[:-1] * value, axis=0)
        return cls(weights, gains, np.where(np.isfinite(shares).all(), partial, np.nan).T)

    @property
    def total(self) -> float:
        """The value."""
        return float(self.partial[:, -1].sum())

    @property
    def error(self) -> float | None:
        """The standard error of the value; None from a single episode, or where the episodes do not vary."""
        return mean_and_error(len(self.partial) * self.partial[:, -1])[1]

    def resample(self, draws: IntArray) -> Array:
        """(b,) self-normalised values of the resamples ``draws`` (b, n) of the episodes, weights normalised on each.

        nan where at some step all weights of a resample are 0.
        """
        n, products = len(self.partial), self.weights * self.gains
        totals = np.empty(len(draws))
        for b, draw in enumerate(draws):
            number = np.bincount(draw, minlength=n)
            with np.errstate(invalid="ignore"):
                totals[b] = float(((products @ number) / (self.weights @ number)).sum())
        return totals

    def estimate(self, zeta: TransitionRatio, value: float, error: float | None, **more: object) -> Estimate:
        """An estimate from the log's episodes with a model zeta * P; ``more`` joins the diagnostics."""
        last, n = self.weights[-1], len(self.partial)
        effective = effective_sample_size(last)
        return Estimate(
            value,
            error,
            diagnostics={
                "standard_error_of": "log",
                "n_episodes": n,
                "effective_sample_size": effective,
                "largest_weight": float(last.max()),
                **more,
                "gap": zeta.gap,
            },
            status=weight_status(value),
            findings=(
                *findings.no_variation(error),
                *findings.weights(effective, n, "episodes"),
                *findings.gap(zeta.gap),
            ),
            is_from_episodes=True,
        )


def model_values(model: Model, policy: Array, horizon: int | None, steps: int) -> tuple[Array, Array]:
    """V (steps + 1, S) and Q (steps, S, A) of the model at each step."""
    v = state_values(model, policy)[None] if horizon is None else values_to_go(model, policy, horizon)[: steps + 1]
    ahead = (model.transitions @ (v if horizon is None else v[1:]).T).T
    q = model.rewards + model.discount * ahead.reshape(-1, *model.rewards.shape)
    return np.broadcast_to(v, (steps + 1, *v.shape[1:])), np.broadcast_to(q, (steps, *q.shape[1:]))


def episode_limit(population: Population, model: Model) -> float:
    """E[V(s_0) + sum rho ...], by the recursion of its mean; J_target where the behaviour policy has support."""
    if population.behavior is None:
        return population.value(population.target)
    target = population.target
    steps = rollout_horizon(target.discount, population.horizon)
    v, q = model_values(model, population.policy, population.horizon, steps)
    walk = walk_of(target, population.behavior, policy=population.policy)
    reached = walk.weights_by_state(steps, power=1)[:-1, 0]
    gains = v[:-1] + walk.sum_actions(walk.act * walk.u * (target.rewards - q).reshape(steps, -1))
    return float(target.discount ** np.arange(steps, dtype=np.float64) @ (reached * gains).sum(axis=1))
