"""The rows of a continuous task's report that are no estimators of a finite problem alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value, paired_returns
from oee_tabular.continuous.residual import ResidualSimulator
from oee_tabular.continuous.task import ContinuousTask, StatePolicy
from oee_tabular.estimators import Estimate, Estimator, Problem, calibrate
from oee_tabular.estimators.base import IN_VALUES_UNIT, Basis
from oee_tabular.estimators.findings import uncovered
from oee_tabular.exact import policy_value
from oee_tabular.mdp import FiniteMDP


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

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """``seed`` is not used: the value's own is."""
        mc = self.value(policy)
        facts = {"standard_error_of": "rollouts", "n_rollouts": mc.n_episodes}
        return Estimate(mc.value, mc.standard_error, diagnostics=facts)


@dataclass(frozen=True, eq=False)
class Residual:
    """J in the simulator corrected by the log's residuals, by Monte Carlo, with an error by refits on resampled episodes.

        se^2 = se_MC^2 + Var_b (J_b - J),   J_b the value after refit b; both with the same random numbers

    Attributes
    ----------
    value : of the corrected simulator
    corrected : ResidualSimulator
    refits : how many
    paths : episodes by which J_b - J is found
    """

    value: MonteCarloValue
    corrected: ResidualSimulator
    refits: int = 20
    paths: int = 1000

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """``seed`` is not used: the value's own is."""
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

        before = returns(self.corrected)
        again = [self.corrected.resampled(np.random.default_rng(s)) for s in streams[1].spawn(self.refits)]
        moved = np.array([(returns(task) - before).mean() for task in again])
        of_log = float(moved.std(ddof=1))
        error = float(np.hypot(of_log, mc.standard_error))
        reach = error * float(stats.t.ppf(0.975, self.refits - 1))
        facts = {
            "standard_error_of": "log and rollouts", "n_rollouts": mc.n_episodes, "refits": self.refits,
            "standard_error_of_the_log": of_log, "interval_method": "refits",
            "explained": ", ".join(f"{c.name} {c.explained:.3g}" for c in self.corrected.coordinates if c.kind != "zero"),
        }  # fmt: skip
        ends = (mc.value - reach, mc.value + reach)
        hidden = [c for c in self.corrected.coordinates if c.hidden]
        basis = Basis(normal=True, corrected=not hidden)
        return Estimate(mc.value, error, ends, facts, status=_not_markov(hidden), basis=basis)


def _not_markov(hidden: list[Any]) -> str:
    """What is wrong where history tells of the residuals; "ok" where it does not."""
    if not hidden:
        return "ok"
    told = ", ".join(f"{c.told_by_history:.0%} in {c.name}" for c in hidden)
    return (
        f"the state is not all that the next one depends on: the action and the residual before explain {told} of what the "
        "correction leaves over (hidden state, such as a delay); tasks.HistoryTask puts the last action into the state"
    )


@dataclass(frozen=True, eq=False)
class Plain:
    """J in the simulator on the cells without its defensive share."""

    simulator: FiniteMDP

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
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
        told = uncovered(*(self.support[name] for name in ("uncovered_mass", "largest_zeta", "d_inf")))
        return replace(found, diagnostics=found.diagnostics | dict(self.support), findings=(*found.findings, *told))


@dataclass(frozen=True, eq=False)
class Calibrated:
    """The calibrated value in a row of its own; the raw one has its own."""

    estimator: Estimator
    continuous: MonteCarloValue
    kind: str

    @one_thread
    def __call__(self, problem: Problem, policy: Any, *, seed: Any = None) -> Estimate:
        """The estimator's value, times J_continuous / J_discretised of the simulator, or plus their difference."""
        raw = self.estimator(problem, policy, seed=seed)
        mc = self.continuous(policy)
        below = policy_value(problem.simulator, policy, horizon=problem.horizon)
        found = calibrate(
            raw, discretised=below, continuous=mc.value, continuous_error=mc.standard_error, kind=self.kind
        )
        facts = found.diagnostics
        value, error = facts["calibrated_value"], facts["calibrated_standard_error"]
        raw_only = IN_VALUES_UNIT | {"row_sum_error", "calibrated_value", "calibrated_standard_error"}
        kept = {name: x for name, x in facts.items() if name not in raw_only}
        ends = None if found.interval is None or error is None else (value - 1.96 * error, value + 1.96 * error)
        basis = Basis(normal=True, measured=found.basis.measured)
        return replace(found, value=value, standard_error=error, interval=ends, diagnostics=kept, basis=basis)
