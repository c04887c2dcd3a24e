"""Importance sampling on the log's episodes, without transition probabilities.

Of the simulator it reads the discount, the absorbing states, the support of the initial
distribution, and the rewards (where the log has none, and to bound what is missing).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.data import Transitions
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import TabularEstimator
from oee_tabular.estimators.errors import effective_sample_size, mean_and_error
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.rollouts import (
    normalize_by_episode,
    normalize_by_step,
    rollout_horizon,
    segment_products,
    step_numbers,
    weight_status,
)
from oee_tabular.exact import policy_is_moments, walk_of
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio.method import Population
from oee_tabular.typing import Array, BoolArray, IntArray

LARGEST_WEIGHT = 1e150  # the square of a larger weight is no float any more


class Episodes(NamedTuple):
    """The log's n episodes within the horizon.

    ``rows`` are the rows of the log, one episode after the other: those of episode i
    are rows[starts[i]] to rows[starts[i + 1] - 1]. ``is_over`` (n,) says which episodes
    have ended after their last row.
    """

    log: Transitions
    rows: IntArray
    starts: IntArray
    is_over: BoolArray

    @classmethod
    def from_problem(cls, problem: Problem) -> Episodes:
        """Cut the recorded episodes of a problem at its horizon."""
        log = problem.recorded
        if log.episode_starts is None:
            raise ValueError(
                "importance sampling needs whole episodes: give the log its episode"
                " column, or Problem(episodes=...)"
            )
        lengths = np.diff(log.episode_starts)
        if problem.horizon is not None:
            lengths = np.minimum(lengths, problem.horizon)
        starts = np.concatenate([[0], np.cumsum(lengths)])
        rows = np.repeat(log.episode_starts[:-1], lengths) + step_numbers(starts)
        final = rows[starts[1:] - 1]
        is_over = (
            log.terminated[final] | problem.simulator.absorbing()[log.next_state[final]]
        )
        return cls(log, rows, starts, is_over)

    @property
    def lengths(self) -> IntArray:
        """Return the number of steps of each episode, (n,)."""
        return np.diff(self.starts)

    def weights(
        self, problem: Problem, policy: Array, *, is_estimated: bool = False
    ) -> Array:
        """Compute the weight rho_0 ... rho_t of each row, rho = policy / behaviour."""
        with np.errstate(over="ignore"):
            ratio = _behavior_ratios(problem, policy, is_estimated=is_estimated)
            return segment_products(ratio[self.rows], self.starts)


def _behavior_ratios(problem: Problem, policy: Array, *, is_estimated: bool) -> Array:
    """Compute policy(a | s) / behaviour(a | s) of each row of the log.

    It is 1 in absorbing states, where actions change nothing.
    """
    log = problem.recorded
    if is_estimated:
        pairs = np.zeros((problem.simulator.n_states, problem.simulator.n_actions))
        np.add.at(pairs, (log.state, log.action), 1.0)
        behavior = pairs[log.state, log.action] / pairs.sum(axis=1)[log.state]
    else:
        behavior = _behavior_probabilities(problem, log)
    ratio = policy[log.state, log.action] / behavior
    beyond = np.flatnonzero(~(ratio <= LARGEST_WEIGHT))
    if beyond.size:
        row = int(beyond[0])
        raise ArgumentError(
            "behavior_probability",
            f"must be large enough for a weight that floats can square; in row {row} it"
            f" is {behavior[row]:g}, and the policy takes that action with probability"
            f" {policy[log.state[row], log.action[row]]:g}",
        )
    return np.where(problem.simulator.absorbing()[log.state], 1.0, ratio)


def _behavior_probabilities(problem: Problem, log: Transitions) -> Array:
    """Return the recorded probability of each action, or ``behavior_policy``'s."""
    if log.behavior_probability is not None:
        probability = log.behavior_probability
        name = "log.behavior_probability"
    elif problem.behavior_policy is not None:
        probability = problem.behavior_policy[log.state, log.action]
        name = "behavior_policy"
    else:
        raise ValueError(
            "importance sampling needs behaviour probabilities: the log has none; give"
            " Problem(behavior_policy=...) (--behavior), or use behavior='estimated'"
        )
    zero = np.flatnonzero(probability == 0)
    if zero.size:
        row = int(zero[0])
        raise ArgumentError(
            name,
            f"must be positive for the actions taken; it is 0 in row {row}"
            f" (s={log.state[row]}, a={log.action[row]}; {zero.size} such rows in all)",
        )
    return np.asarray(probability)


@suggest_keywords
@dataclass(frozen=True)
class ImportanceSampling(TabularEstimator):
    """Importance sampling: the log's episodes, weighted by products of policy ratios.

    ``ImportanceSampling()(problem, policy)`` returns an ``Estimate``. The weights are
    products of rho = policy(a | s) / behaviour(a | s) over the steps of an episode. It
    uses no transition probabilities of the simulator. It needs a log with whole
    episodes, and the probabilities with which the behaviour policy took their actions.

    Parameters
    ----------
    kind : {'trajectory', 'per_decision'}, default 'per_decision'
        The weight of a reward. 'trajectory' is the product of rho over the whole
        episode; 'per_decision' is the product over the steps up to the reward
        (eq. 3.5).
    self_normalized : bool, default False
        Whether to divide by the sum of the weights instead of the number of episodes
        (weighted importance sampling). For 'per_decision' this is done at each step.
    ragged : {'pad', 'zero'}, default 'pad'
        The weight of an ended episode in the sums of later steps, if 'per_decision' is
        self-normalised. 'pad' keeps its last weight. 'zero' sets it to 0, which
        estimates another quantity, E[r_t | not ended].
    behavior : {'recorded', 'estimated'}, default 'recorded'
        Where the behaviour probabilities come from. 'recorded' takes the log's, or else
        those of ``Problem(behavior_policy=...)``. 'estimated' takes the frequencies of
        actions in the log.

    Raises
    ------
    ValueError
        When called, if the log has no episodes, or if behaviour probabilities are
        missing or 0 for a recorded action.

    See Also
    --------
    DoublyRobust : The same episodes with a model as control variate.

    Notes
    -----
    The plain estimators converge to J of the target, from the initial states of the
    log's episodes, if the behaviour policy takes every action that the policy takes.
    Episodes that were truncated before the horizon lack their later rewards; the
    diagnostic ``truncation_bias_bound`` bounds the bias.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> problem = pair.problem(1000, seed=0)
    >>> ImportanceSampling(kind="trajectory")(problem, pair.policy)
    Estimate(10.9262 ± 0.56 (standard error))
    >>> ImportanceSampling(self_normalized=True)(problem, pair.policy)
    Estimate(10.5713 ± 0.29 (standard error))
    """

    kind: Literal["trajectory", "per_decision"] = "per_decision"
    self_normalized: bool = False
    ragged: Literal["pad", "zero"] = "pad"
    behavior: Literal["recorded", "estimated"] = "recorded"

    def __post_init__(self) -> None:
        _checks.one_of(self.kind, "kind", ("trajectory", "per_decision"))
        _checks.one_of(self.ragged, "ragged", ("pad", "zero"))
        _checks.boolean(self.self_normalized, "self_normalized")
        _checks.one_of(self.behavior, "behavior", ("recorded", "estimated"))

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Weigh the log's episodes.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            Not used: the estimate is exact given the log.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        episodes = Episodes.from_problem(problem)
        n = len(episodes.lengths)
        is_estimated = self.behavior == "estimated"
        weight = episodes.weights(problem, policy, is_estimated=is_estimated)
        beyond = np.flatnonzero(~(weight <= LARGEST_WEIGHT))
        if beyond.size:
            k = beyond[0]
            step = step_numbers(episodes.starts)[k]
            status = (
                f"the product of policy / behaviour overflows in row {episodes.rows[k]}"
                f" of the log, step {step} of its episode: shorten the horizon, or use"
                " oee"
            )
            return Estimate(float("nan"), status=status)
        last = weight[episodes.starts[1:] - 1]
        if self.kind == "trajectory":
            weight = np.repeat(last, episodes.lengths)
        value, error = self._average(problem, episodes, weight, last)
        effective = effective_sample_size(last)
        n_cut, bound = _truncation_bound(
            problem, episodes, last, self_normalized=self.self_normalized
        )
        first_state = episodes.log.state[episodes.rows[episodes.starts[:-1]]]
        foreign = float((problem.simulator.initial[first_state] == 0).mean())
        if not last.any() or (self.self_normalized and effective < 2.0):
            error = None  # the value is that of one episode, and shows no variation
        warnings = (
            *findings.truncation(n_cut, n, bound, value, error),
            *findings.foreign_starts(foreign),
        )
        return Estimate(
            value,
            error,
            diagnostics={
                "standard_error_of": "log",
                "n_episodes": n,
                "effective_sample_size": effective,
                "largest_weight": float(weight.max()),
                "mean_weight": float(last.mean()),
                "truncation_bias_bound": bound,
            },
            status=weight_status(value) if last.any() else str(findings.WEIGHTLESS),
            findings=warnings if last.any() else (findings.WEIGHTLESS,),
            is_from_episodes=True,
        )

    def _average(
        self, problem: Problem, episodes: Episodes, weight: Array, last: Array
    ) -> tuple[float, float | None]:
        """Average the weighted rewards: the value and its standard error.

        ``weight`` is that of each row's reward, ``last`` (n,) that of whole episodes.
        """
        starts = episodes.starts
        step = step_numbers(starts).astype(np.float64)
        rewards = problem.rewards_of(episodes.log)[episodes.rows]
        discounted = problem.simulator.discount**step * rewards
        totals = np.add.reduceat(weight * discounted, starts[:-1])
        if not self.self_normalized:
            return mean_and_error(totals)
        if self.kind == "trajectory":
            return normalize_by_episode(totals, last)
        return normalize_by_step(
            discounted, weight, starts, last, keep_last=self.ragged == "pad"
        )

    @property
    def claims(self) -> frozenset[str]:
        """Return what the estimator claims, in words of ``testing.CLAIMS``."""
        claims = {"relabelling", "scale"}
        if not self._drops_ended:
            claims |= {"consistent", "padding"}
        if self.self_normalized:
            return frozenset(claims | {"shift"})
        claims |= {"after_end"} if self.kind == "per_decision" else set()
        return frozenset(
            claims | ({"unbiased"} if self.behavior == "recorded" else set())
        )

    @property
    def _drops_ended(self) -> bool:
        """Return whether episodes that have ended leave the sums of weights."""
        return (
            self.self_normalized
            and self.kind == "per_decision"
            and self.ragged == "zero"
        )

    def limit_of(self, population: Population) -> float:
        """Compute the mean of what is averaged over episodes of the behaviour policy.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.

        Notes
        -----
        It is J_target where the behaviour policy takes every action that the policy
        takes, as it does by default; otherwise the rewards of the paths that it can
        make, self-normalised over their weight. Where ended episodes are dropped it is
        sum_t gamma^t E[rho r_t] / E[rho 1{not ended at t}], where every episode has a
        first step, also one that starts in an absorbing state.
        """
        target = population.target
        behavior = population.behavior
        if not self._drops_ended and behavior is None:
            return population.value(target)
        steps = rollout_horizon(target.discount, population.horizon)
        behavior = population.policy if behavior is None else behavior
        if not self._drops_ended:
            return policy_is_moments(
                target,
                behavior,
                population.policy,
                kind=self.kind,
                self_normalized=self.self_normalized,
                horizon=steps,
            ).mean
        walk = walk_of(target, behavior, policy=population.policy)
        reached = walk.weights_by_state(steps, power=1)[:steps, 0]
        going = ~target.absorbing()
        taken = walk.act[0].reshape(going.size, -1) * walk.u[0].reshape(going.size, -1)
        rewards = reached @ (taken * target.rewards).sum(axis=1)
        weight = taken.sum(axis=1)
        alive = reached[:, going] @ weight[going]
        # an episode that starts in an absorbing state has one step all the same
        alive[0] = reached[0] @ weight
        kept = alive > 1e-300
        rewards *= target.discount ** np.arange(steps, dtype=np.float64)
        return float(np.sum(rewards[kept] / alive[kept]))


def _truncation_bound(
    problem: Problem, episodes: Episodes, last: Array, *, self_normalized: bool
) -> tuple[int, float]:
    """Count the episodes cut before the horizon, and bound what they can change.

    A missing reward is at most the largest of the log and the simulator, and its weight
    is in expectation the episode's last weight.
    """
    lengths = episodes.lengths.astype(np.float64)
    gamma = problem.simulator.discount
    end = np.inf if problem.horizon is None else float(problem.horizon)
    missing = ~episodes.is_over & (lengths < end)
    if not missing.any():
        return 0, 0.0
    if gamma == 1.0:
        tail = end - lengths
    else:
        tail = (gamma**lengths - gamma**end) / (1.0 - gamma)
    rewards = problem.simulator.reward_data
    if rewards is None:
        rewards = problem.simulator.rewards
    largest = max(
        float(np.abs(problem.rewards_of(episodes.log)).max()),
        float(np.abs(rewards).max()),
    )
    counted = missing & (last > 0)
    mass = float(last.sum()) if self_normalized else float(len(last))
    bound = 0.0
    if mass > 0:
        with np.errstate(over="ignore"):
            bound = float(np.sum(last[counted] / mass * tail[counted])) * largest
    if gamma < 1.0 or end < np.inf:
        # a finite bound exists, even where it is beyond the largest float
        bound = min(bound, float(np.finfo(float).max))
    return int(missing.sum()), bound
