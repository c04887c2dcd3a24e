"""The rows of a continuous task's report that are no estimators of a finite problem alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value, paired_returns
from oee_tabular.continuous.task import ContinuousTask, StatePolicy
from oee_tabular.estimators import Estimate, Estimator, Problem
from oee_tabular.estimators.findings import Finding

BEYOND = 0.02  # share of a policy's moves beyond the log's range: it is said
QUANTILE = 1.96  # of the intervals that estimators set themselves


@dataclass(frozen=True, eq=False)
class MonteCarloValue:
    """Values in a continuous task of policies that are known by their tables; each is computed once, all by one seed.

    Policies that are the same table on the cells share a value.
    """

    task: ContinuousTask
    functions: Mapping[bytes, StatePolicy]
    horizon: int
    episodes: int
    discount: float
    seed: np.random.SeedSequence
    found: dict[bytes, MonteCarlo] = field(default_factory=dict)

    def __call__(self, policy: Array) -> MonteCarlo:
        """The value of the policy with this (S, A) table."""
        key = np.asarray(policy).tobytes()
        if key not in self.found:
            stream = np.random.default_rng(np.random.SeedSequence(self.seed.entropy, spawn_key=self.seed.spawn_key))
            self.found[key] = monte_carlo_value(
                self.task, self.functions[key], self.episodes, self.horizon, discount=self.discount, seed=stream
            )
        return self.found[key]


@dataclass(frozen=True, eq=False)
class Simulated:
    """J in the continuous task itself, by Monte Carlo."""

    value: MonteCarloValue
    is_headline: bool = False  # where no correction can be trusted: then the rollouts' noise is no interval to speak of

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """``seed`` is not used: the value's own is."""
        mc = self.value(policy)
        facts = {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}
        error = None if self.is_headline else mc.standard_error
        is_first = self.is_headline
        return Estimate(mc.value, error, diagnostics=facts, is_headline=is_first, is_from_log=not is_first)


@dataclass(frozen=True, eq=False)
class Refitted:
    """J in a task learned from the log, by Monte Carlo, with an error by refits on resampled episodes.

        se^2 = se_MC^2 + Var_b (J_b - J),   J_b the value after refit b; both with the same random numbers

    Attributes
    ----------
    value : of the learned task
    learned : ContinuousTask whose ``resampled(rng)`` is the same fitted to a bootstrap's log
    refits : how many
    paths : episodes by which J_b - J is found
    status : why the value is not to be relied on, and then has no error; "ok"
    """

    value: MonteCarloValue
    learned: Any
    refits: int = 20
    paths: int = 1000
    status: str = "ok"

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """``seed`` is not used: the value's own is."""
        if self.status != "ok":
            mc = self.value(policy)
            facts = {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}
            return Estimate(mc.value, None, None, facts, status=self.status)
        mc, function = self.value(policy), self.value.functions[np.asarray(policy).tobytes()]
        paths = min(self.paths, mc.n_episodes)
        # episodes and refits have streams of their own, the same for every policy
        streams = [
            np.random.SeedSequence(self.value.seed.entropy, spawn_key=(*self.value.seed.spawn_key, k)) for k in (1, 2)
        ]

        def returns(task: ContinuousTask) -> Array:
            return paired_returns(
                task, function, paths, self.value.horizon, discount=self.value.discount, seed=streams[0]
            )

        before = returns(self.learned)
        again = [self.learned.resampled(np.random.default_rng(s)) for s in streams[1].spawn(self.refits)]
        moved = np.array([(returns(task) - before).mean() for task in again])
        of_log = float(moved.std(ddof=1))
        error = float(np.hypot(of_log, mc.standard_error))
        reach = error * float(stats.t.ppf(0.975, self.refits - 1))
        facts = {
            "standard_error_of": "log and rollouts", "n_rollouts": mc.n_episodes, "refits": self.refits,
            "standard_error_of_the_log": of_log, "interval_method": "refits",
        }  # fmt: skip
        return Estimate(mc.value, error, (mc.value - reach, mc.value + reach), facts, is_normal=True)


@dataclass(frozen=True, eq=False)
class Residual(Refitted):
    """``Refitted`` in the simulator corrected by the log's residuals."""

    @one_thread
    def __call__(self, problem: Problem, policy: object, *, seed: Seed = None) -> Estimate:
        """``seed`` is not used: the value's own is."""
        found = Refitted.__call__(self, problem, policy, seed=seed)
        share = self._beyond(self.value.functions[np.asarray(policy).tobytes()])
        told = ", ".join(f"{c.name} {c.explained:.3g}" for c in self.learned.coordinates if c.kind != "zero")
        facts = found.diagnostics | {"explained": told, "beyond_log": share}
        return replace(
            found, diagnostics=facts, findings=(*found.findings, *beyond_log(share)), is_headline=self.status == "ok",
        )  # fmt: skip

    def _beyond(self, function: StatePolicy) -> float:
        """Share of the policy's moves, of 200 episodes, that begin beyond what the log has seen."""
        counted = np.zeros(2)

        def watched(states: Array) -> Array:
            counted[:] += self.learned.beyond(states).sum(), len(states)
            return function(states)

        seed = np.random.SeedSequence(self.value.seed.entropy, spawn_key=(*self.value.seed.spawn_key, 3))
        paired_returns(self.learned, watched, min(200, self.paths), self.value.horizon, discount=1.0, seed=seed)
        return float(counted[0] / counted[1])


def beyond_log(share: float) -> tuple[Finding, ...]:
    """``share`` of the policy's moves begin where the correction was never fitted."""
    text = (
        "{} of the policy's moves begin beyond what the log has seen (a feature of the state outside its range): what the "
        "correction adds there is a guess, and no interval covers it."
    )
    return (Finding("beyond", share, text, f"{share:.0%}"),) if share > BEYOND else ()


@dataclass(frozen=True, eq=False)
class Possible:
    """An estimator whose values beyond what the rewards can sum to are refused, with a sentence.

    A value that is beyond by at most 1.96 standard errors, within its interval, is put on the bound.

    Attributes
    ----------
    estimator : whose value it is
    lowest, highest : the least and the most that T rewards sum to
    scale : of values in the sentence
    """

    estimator: Estimator
    lowest: float
    highest: float
    scale: float = 1.0

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """The estimator's, or no value."""
        found = self.estimator(problem, policy, seed=seed)
        room = 1e-9 * max([1.0, *(abs(bound) for bound in (self.lowest, self.highest) if np.isfinite(bound))])
        nearest = float(np.clip(found.value, self.lowest, self.highest))
        if not np.isfinite(found.value) or abs(nearest - found.value) <= room:
            return found
        if abs(nearest - found.value) <= QUANTILE * (found.standard_error or 0.0):
            return replace(found, value=nearest)
        value, low, high = (x * self.scale for x in (found.value, self.lowest, self.highest))
        text = f"{value:.4g} cannot be: what {problem.horizon} rewards pay is between {low:.4g} and {high:.4g}"
        return replace(found, value=float("nan"), standard_error=None, interval=None, status=text, findings=(),
                       diagnostics=found.diagnostics | {"refused_value": found.value})  # fmt: skip
