"""Policy importance sampling on the log's episodes: the field's estimators, which never look at the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._threads import one_thread
from oee_tabular.data import Transitions
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import Estimate, ExactLimit, effective_sample_size
from oee_tabular.estimators.problem import Problem, checked_policy
from oee_tabular.estimators.rollouts import Weighted, combine, rollout_horizon, segment_products, weight_status
from oee_tabular.exact import policy_is_moments
from oee_tabular.exact.walks import walk_of
from oee_tabular.ratio.method import Population

LARGEST_WEIGHT = 1e150  # its square is still a float


@dataclass(frozen=True)
class ImportanceSampling(ExactLimit):
    """Episodes of the log weighted by products of policy(a|s) / behaviour(a|s).

    Parameters
    ----------
    kind : "trajectory" | "per_decision"
        The whole product on every reward, or at step t the product up to t.
    self_normalized : bool
        Divide by the sum of the weights (weighted importance sampling), per step for per_decision.
    ragged : "pad" | "zero"
        In self-normalised per-decision sampling, what an ended episode does to the normaliser of later steps: it keeps
        its last weight, or has weight 0 (which estimates E[r_t | still going], a different quantity).
    behavior : "recorded" | "estimated"
        The log's behaviour probabilities (or ``Problem(behavior_policy=...)``), or the log's action frequencies.

    Notes
    -----
    Limit, plain: J(P_target) where the behaviour policy takes every action that the policy takes, from the starts of
    the log's episodes. Episodes that were truncated before the horizon lack their later rewards: the bias that this can
    make is bounded in ``truncation_bias_bound``.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
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

    @one_thread
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Exact given the log; ``seed`` is not used."""
        pi = checked_policy(problem, policy)
        log = problem.recorded
        ratio = self.ratios(problem, pi)  # or an error, without episodes
        starts, timestep = log.episode_starts, log.timestep
        assert starts is not None
        assert timestep is not None
        keep = np.ones(len(log), dtype=np.bool_) if problem.horizon is None else timestep < problem.horizon
        lengths = np.diff(starts) if problem.horizon is None else np.minimum(np.diff(starts), problem.horizon)
        cut = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        with np.errstate(over="ignore"):
            weight = segment_products(ratio[keep], cut)
        beyond = np.flatnonzero(~(weight <= LARGEST_WEIGHT))
        if beyond.size:
            row, step = int(np.flatnonzero(keep)[beyond[0]]), int(timestep[keep][beyond[0]])
            reason = f"the product of policy / behaviour overflows in row {row} of the log, step {step} of its episode"
            return Estimate(float("nan"), status=f"{reason}: shorten the horizon, or use oee")
        last = weight[cut[1:] - 1]
        if self.kind == "trajectory":
            weight = np.repeat(last, lengths)
        gamma = problem.simulator.discount
        reward = gamma ** timestep[keep].astype(np.float64) * problem.rewards_of(log)[keep]
        value, error = combine(
            Weighted(reward, weight, cut, last),
            self_normalized=self.self_normalized,
            keep_last=self.ragged == "pad",
            per_decision=self.kind == "per_decision",
        )
        n, effective = len(last), effective_sample_size(last)
        cut_off, bound = _truncation(log, problem, lengths, last, self.self_normalized)
        foreign = float((problem.simulator.initial[log.state[starts[:-1]]] == 0).mean())
        status = weight_status(value)
        if self.self_normalized and effective < 2.0:
            error = None  # one episode decides: its value has no spread to show
        weightless = not last.any()
        if weightless:
            error = None
            status = str(findings.WEIGHTLESS)
        return Estimate(
            value,
            error,
            diagnostics={
                "standard_error_of": "log",
                "n_episodes": n,
                "effective_sample_size": effective,
                "largest_weight": float(weight.max()),
                "mean_weight": float(last.mean()),
                "truncated_share": cut_off / n,
                "truncation_bias_bound": bound,
                "foreign_starts_share": foreign,
            },
            status=status,
            findings=(findings.WEIGHTLESS,)
            if weightless
            else (
                *findings.varied(error),
                *findings.weights(effective, n, "episodes"),
                *findings.truncated(cut_off, n, bound, value, error),
                *findings.foreign_starts(foreign),
            ),
            is_from_episodes=True,
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        per_decision = self.kind == "per_decision"
        found = {"relabelling", "scale"}
        if not (self.self_normalized and per_decision and self.ragged == "zero"):
            found |= {"consistent", "padding"}
        if self.self_normalized:
            found.add("shift")
        else:
            found |= {"after_end"} if per_decision else set()
            found |= {"unbiased"} if self.behavior == "recorded" else set()
        return frozenset(found)

    def ratios(self, problem: Problem, policy: Array) -> Array:
        """policy(a | s) / behaviour(a | s) of each row of the log (of ``problem.episodes`` where there are some)."""
        log = problem.recorded
        if log.episode_starts is None:
            raise ValueError(
                "importance sampling needs whole episodes: give the log its episode column, or Problem(episodes=...)"
            )
        taken = self._behavior(problem, log)
        with np.errstate(over="ignore"):
            ratio = policy[log.state, log.action] / taken
        beyond = np.flatnonzero(~(ratio <= LARGEST_WEIGHT))
        if beyond.size:
            row = int(beyond[0])
            raise ValueError(
                f"behavior_probability must be large enough for a weight that floats can square; in row {row} it is "
                f"{taken[row]:g}, and the policy takes that action with probability {policy[log.state[row], log.action[row]]:g}"
            )
        return np.where(problem.simulator.absorbing()[log.state], 1.0, ratio)  # what is over has nothing to correct

    def limit_of(self, people: Population) -> float:
        """The mean of what is averaged over episodes of ``behavior_policy`` in the target.

        J_target where that policy takes every action that the policy takes (None: it does); otherwise the
        rewards of the paths that it can make, self-normalised those of what is left over their weight.
        """
        dropped = self.self_normalized and self.kind == "per_decision" and self.ragged == "zero"
        if people.behavior is None:
            return _limit_without_the_finished(people, people.policy) if dropped else people.value(people.target)
        if dropped:
            return _limit_without_the_finished(people, people.behavior)
        return policy_is_moments(
            people.target, people.behavior, people.policy, kind=self.kind, self_normalized=self.self_normalized,
            horizon=rollout_horizon(people.target.discount, people.horizon),
        ).mean  # fmt: skip

    def _behavior(self, problem: Problem, log: Transitions) -> Array:
        """Probability of each recorded action under the policy that recorded it."""
        if self.behavior == "estimated":
            pairs = np.zeros((problem.simulator.n_states, problem.simulator.n_actions))
            np.add.at(pairs, (log.state, log.action), 1.0)
            return np.asarray(pairs[log.state, log.action] / pairs.sum(axis=1)[log.state])
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


def _limit_without_the_finished(people: Population, behavior: Array) -> float:
    """sum_t gamma^t E[rho r_t] / E[rho 1{not yet over at t}]: what dropping finished episodes estimates."""
    steps = rollout_horizon(people.target.discount, people.horizon)
    walk = walk_of(people.target, behavior, policy=people.policy)
    reached = walk.weights_by_state(steps, power=1)[:steps, 0]
    going = ~people.target.absorbing()
    taken = walk.act[0].reshape(going.size, -1) * walk.u[0].reshape(going.size, -1)
    paid = reached @ (taken * people.target.rewards).sum(axis=1)
    alive = reached[:, going] @ taken.sum(axis=1)[going]
    kept = alive > 1e-300
    factor = people.target.discount ** np.arange(steps, dtype=np.float64)
    return float(np.sum(factor[kept] * paid[kept] / alive[kept]))


def _truncation(
    log: Transitions, problem: Problem, lengths: Any, last: Array, self_normalized: bool
) -> tuple[int, float]:
    """How many episodes are cut before the horizon, and a bound on what their missing rewards can change.

    A missing reward has at most the largest size that the log or the simulator's moves have, and in expectation the
    episode's last weight.
    """
    starts = log.episode_starts
    assert starts is not None
    final = starts[1:] - 1
    over = log.terminated[final] | problem.simulator.absorbing()[log.next_state[final]]
    ended = over & (lengths == np.diff(starts))
    missing = ~ended if problem.horizon is None else ~ended & (lengths < problem.horizon)
    if not missing.any():
        return 0, 0.0
    gamma = problem.simulator.discount
    paid = problem.simulator.rewards if problem.simulator.reward_data is None else problem.simulator.reward_data
    largest = max(float(np.abs(problem.rewards_of(log)).max()), float(np.abs(paid).max()))
    if gamma == 1.0:
        steps = np.inf if problem.horizon is None else problem.horizon
        tail = np.asarray(steps - lengths, dtype=np.float64)
    else:
        end = 0.0 if problem.horizon is None else gamma**problem.horizon
        tail = (gamma ** lengths.astype(np.float64) - end) / (1.0 - gamma)
    counted = missing & (last > 0)
    mass = float(last.sum()) if self_normalized else float(len(last))
    with np.errstate(over="ignore"):
        bound = float(np.sum(last[counted] / mass * tail[counted])) * largest if mass > 0 else 0.0
    if gamma < 1.0 or problem.horizon is not None:
        bound = min(bound, float(np.finfo(float).max))  # there is one, even where no float holds it
    return int(missing.sum()), bound
