"""The rows of a continuous task's report that are no estimators of a finite problem alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular._threads import one_thread
from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value
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
