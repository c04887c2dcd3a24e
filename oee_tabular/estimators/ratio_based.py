"""The base class of estimators that use a ratio zeta, and what such a ratio may be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular.estimators.base import OF_COUNTS, TabularEstimator
from oee_tabular.estimators.problem import Problem
from oee_tabular.exact import ReweightedModel, reweight
from oee_tabular.exceptions import ArgumentError
from oee_tabular.ratio import Method, TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.shrinkage.transition import method_named
from oee_tabular.typing import Array

RatioOption: TypeAlias = (
    Literal["conditional", "ratio_of_ratios", "joint"]
    | Method
    | TransitionRatio
    | Callable[..., TransitionRatio]
)
# for methods that draw as many simulated transitions as the log has
_SAMPLED = frozenset({"consistent", "relabelling", "scale", "random"})
# the methods that a name stands for, and what they claim
CLAIMS_OF_METHODS: Mapping[str, frozenset[str]] = {
    "conditional": OF_COUNTS | {"consistent", "shift"},
    "ratio_of_ratios": _SAMPLED,  # its rows have any sum
    "joint": _SAMPLED | {"shift"},
}


class RatioEstimator(TabularEstimator):
    """The base of estimators that use a ratio zeta, given or fitted to the log."""

    ratio: RatioOption

    def __post_init__(self) -> None:
        if isinstance(self.ratio, str):
            _checks.one_of(self.ratio, "ratio", tuple(CLAIMS_OF_METHODS))
        elif not isinstance(self.ratio, TransitionRatio | Method) and not callable(
            self.ratio
        ):
            raise ArgumentError(
                "ratio",
                "must be a method's name, a TransitionRatio or a function; got"
                f" {_checks.show(self.ratio)}",
            )

    def fit(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> TransitionRatio:
        """Fit zeta to the log, as ``ratio`` says.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy to evaluate; its state values are a direction of "conditional".
        generator : numpy.random.Generator
            The source of simulated data, for methods that need them.

        Returns
        -------
        TransitionRatio
            The ratio on the simulator's support.
        """
        if isinstance(self.ratio, TransitionRatio):
            zeta = self.ratio
        elif callable(self.ratio):
            zeta = self.ratio(problem.observed, problem.simulator)
        else:
            method = self._method
            # only quotients of two ratios look at the log itself; its counts are made
            # once a problem
            looks_at_log = "simulator_data" in method.USES
            return method.fit(
                problem.observed if looks_at_log else problem.counts,
                problem.simulator,
                values_of=policy,
                horizon=problem.horizon,
                simulator_data=problem.simulator_data,
                behavior_policy=problem.behavior_policy,
                seed=generator,
                cache=problem.cache,
            )
        zeta.on(problem.simulator)  # or an error
        return zeta

    @property
    def _method(self) -> Method:
        """Return the method that ``ratio`` is or names."""
        assert isinstance(self.ratio, str | Method)
        return method_named(self.ratio) if isinstance(self.ratio, str) else self.ratio

    def limit_model(self, population: Population) -> ReweightedModel:
        """Return zeta * P with the zeta that infinitely many transitions would give.

        Parameters
        ----------
        population : Population
            Simulator, target and how the data are recorded.

        Returns
        -------
        ReweightedModel
            The corrected simulator in the limit.
        """
        simulator = population.simulator
        if isinstance(self.ratio, TransitionRatio):
            return reweight(simulator, self.ratio)
        if callable(self.ratio):
            return reweight(simulator, self.ratio(population.counts(), simulator))
        return reweight(simulator, self._method.limit(population))

    @property
    def model_claims(self) -> frozenset[str]:
        """Return the claims of the exact value of zeta * P.

        A zeta that is given is right for one pair of environments only.
        """
        if isinstance(self.ratio, TransitionRatio):
            return (
                OF_COUNTS | {"shift"}
                if self.ratio.row_sum_error <= _checks.SUM_TOLERANCE
                else OF_COUNTS
            )
        return (
            CLAIMS_OF_METHODS[self.ratio]
            if isinstance(self.ratio, str)
            else frozenset({"scale"})
        )
