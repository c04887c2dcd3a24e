"""The option ``ratio`` of estimators that rest on zeta: where it is from, its fit to a log and its limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.estimators.base import OF_COUNTS, TabularEstimator
from oee_tabular.estimators.problem import Problem
from oee_tabular.exact import ReweightedModel, reweight
from oee_tabular.ratio import Method, TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.ratio.transition import method_named

RatioOption = str | Method | TransitionRatio | Callable[..., TransitionRatio]
_SAMPLED = frozenset({"consistent", "relabelling", "scale", "random"})  # as many simulated moves as the log has
NAMED: Mapping[str, frozenset[str]] = {  # methods that need no options, and what they claim
    "conditional": OF_COUNTS | {"consistent", "shift"},
    "ratio_of_ratios": _SAMPLED,  # its rows have any sum
    "joint": _SAMPLED | {"shift"},
}


class RatioEstimator(TabularEstimator):
    """An estimator with a zeta: given, or fitted as ``ratio`` says."""

    ratio: RatioOption

    def __post_init__(self) -> None:
        if isinstance(self.ratio, str):
            _checks.one_of(self.ratio, "ratio", tuple(NAMED))
        elif not isinstance(self.ratio, TransitionRatio | Method) and not callable(self.ratio):
            raise ValueError(
                f"ratio must be a method's name, a TransitionRatio or a function; got {_checks.show(self.ratio)}"
            )

    def fit(self, problem: Problem, policy: Array, generator: np.random.Generator) -> TransitionRatio:
        """zeta from the log, as ``ratio`` says; V of ``policy`` is a direction of "conditional"."""
        if isinstance(self.ratio, TransitionRatio):
            self.ratio.on(problem.simulator)  # or an error
            return self.ratio
        if callable(self.ratio):
            return self.ratio(problem.observed, problem.simulator)
        return self._method.fit(
            problem.observed,
            problem.simulator,
            values_of=policy,
            horizon=problem.horizon,
            simulator_data=problem.simulator_data,
            behavior_policy=problem.behavior_policy,
            seed=generator,
            made=problem.made,
        )

    @property
    def _method(self) -> Method:
        assert isinstance(self.ratio, str | Method)
        return method_named(self.ratio) if isinstance(self.ratio, str) else self.ratio

    def limit_model(self, population: Population) -> ReweightedModel:
        """zeta * P with the zeta that infinitely many transitions would give."""
        simulator = population.simulator
        if isinstance(self.ratio, TransitionRatio):
            return reweight(simulator, self.ratio)
        if callable(self.ratio):
            return reweight(simulator, self.ratio(population.counts(), simulator))
        return reweight(simulator, self._method.limit(population))

    @property
    def model_claims(self) -> frozenset[str]:
        """What the exact value of zeta * P claims; a zeta that is given is right for one pair only."""
        if isinstance(self.ratio, TransitionRatio):
            return OF_COUNTS | {"shift"} if self.ratio.row_sum_error <= _checks.SUM_TOLERANCE else OF_COUNTS
        return NAMED[self.ratio] if isinstance(self.ratio, str) else frozenset({"scale"})
