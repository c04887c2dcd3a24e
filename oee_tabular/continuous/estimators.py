"""The rows of a continuous task's report that are no estimators of a finite problem alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from oee_tabular._checks import Array, Seed
from oee_tabular._threads import one_thread
from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value, paired_returns
from oee_tabular.continuous.task import ContinuousTask, StatePolicy
from oee_tabular.estimators import Estimate, Estimator, Problem, calibrate
from oee_tabular.estimators.base import IN_VALUES_UNIT
from oee_tabular.estimators.findings import Finding, missing_support
from oee_tabular.exact import policy_value
from oee_tabular.mdp import FiniteMDP

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
class Plain:
    """J in the simulator on the cells without its defensive share."""

    simulator: FiniteMDP

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Seed = None) -> Estimate:
        """Exact."""
        return Estimate(policy_value(self.simulator, policy, horizon=problem.horizon))


@dataclass(frozen=True, eq=False)
class Supported:
    """An estimator whose diagnostics say how far its ratio has support."""

    estimator: Estimator
    support: Mapping[str, float]

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """The estimator's, with ``uncovered_mass``, ``largest_zeta`` and ``d_inf``."""
        found = self.estimator(problem, policy, seed=seed)
        told = missing_support(*(self.support[name] for name in ("uncovered_mass", "largest_zeta", "d_inf")))
        return replace(found, diagnostics=found.diagnostics | dict(self.support), findings=(*found.findings, *told))


def second_calibration(value: float, gap: float) -> Finding:
    """What the other calibration says."""
    text = "calibrated by the simulator on a log of its own instead, the value is {}; the interval covers the gap."
    return Finding("second calibration", gap, text, f"{value:.4g}")


def calibrated_far(apart: float, own: float) -> Finding:
    """Calibration takes out more than was put in."""
    text = "calibration moves the value by {}: rely on the corrected simulator rather than on either."
    figure = f"{apart:.3g}, more than the cells move the simulator's own value, {own:.3g}"
    return Finding("calibrated far", apart, text, figure)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """The calibrated value in a row of its own; the raw one has its own.

    Attributes
    ----------
    estimator : the raw value's
    continuous : values in the continuous simulator
    plain : policy -> value on the cells of the simulator without a floor, looked at in the log's places
    own : the same, looked at in the places of a log of the simulator's own; None: not known
    kind : "ratio" | "difference"
    scale : of values in the sentences

    Notes
    -----
    What the two calibrations differ by is what calibration is uncertain by: it is told, and the error counts it so that the
    95% interval covers it, error^2 = se^2 + (gap / 1.96)^2.
    """

    estimator: Estimator
    continuous: MonteCarloValue
    plain: Callable[[Array], float]
    own: Callable[[Array], float] | None
    kind: str
    scale: float = 1.0

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """The estimator's value, times J_continuous / J_discretised of the simulator, or plus their difference."""
        raw = self.estimator(problem, policy, seed=seed)
        mc, below = self.continuous(policy), self.plain(policy)
        found = self._by(raw, mc, below)
        facts = found.diagnostics
        value, error = facts["calibrated_value"], facts["calibrated_standard_error"]
        raw_only = IN_VALUES_UNIT | {"row_sum_error", "calibrated_value", "calibrated_standard_error"}
        kept = {name: x for name, x in facts.items() if name not in raw_only}
        told = list(found.findings)
        if self.own is not None:
            second = float(self._by(raw, mc, self.own(policy)).diagnostics["calibrated_value"])
            gap = abs(second - value)
            error = None if error is None else float(np.hypot(error, gap / QUANTILE))
            kept |= {"second_calibration_value": second, "interval_method": "calibrated"}
            told.append(second_calibration(second * self.scale, gap))
        apart, own = abs(raw.value - value), abs(mc.value - below)
        if apart > 1.01 * own + 2.0 * mc.standard_error:
            told.append(calibrated_far(apart * self.scale, own * self.scale))
        ends = None if found.interval is None or error is None else (value - QUANTILE * error, value + QUANTILE * error)
        return replace(
            found, value=value, standard_error=error, interval=ends, diagnostics=kept, findings=tuple(told),
            model_value=None, is_normal=True, is_from_log=True, is_from_episodes=False,
            is_headline=False,
        )  # fmt: skip

    def _by(self, raw: Estimate, mc: MonteCarlo, below: float) -> Estimate:
        return calibrate(
            raw, discretised=below, continuous=mc.value, continuous_error=mc.standard_error, kind=self.kind
        )


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
