"""The simulator as it is, and the oracle that knows the true ratio.

A simulator made of samples (``FiniteMDP.from_env``, ``from_log``) has a sampling error
of its own. By the delta method, with G(s, a, s') = dJ / dP(s' | s, a)
(``exact.transition_gradient``), D(s, a) the discounted time in (s, a), n(s, a) samples
of each pair and m first states::

    Var J = sum_(s, a) Var_(s' ~ P(. | s, a)) G(s, a, s') / (n(s, a) - 1) + Var_mu V / m
            + sum_(s, a, s') (D(s, a) P(s' | s, a))^2 Var(mean reward of transition).

The divisor is n - 1, since P is the frequency of these samples. A pair without two
samples has no variance to show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import align
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import OF_COUNTS, TabularEstimator
from oee_tabular.estimators.errors import ROUNDING, delta_error
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.off_environment import NORMAL, OffEnvironment
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.ratio_based import RatioOption
from oee_tabular.exact import evaluate_policy, occupancy, transition_gradient
from oee_tabular.mdp import FiniteMDP, total_discount
from oee_tabular.ratio import true_ratio
from oee_tabular.ratio.method import Population
from oee_tabular.typing import Array

# share of the policy's time in pairs with one sample or none above which there is no
# interval
MAX_UNKNOWN_SHARE = 0.1
N_FEW = 10  # with fewer samples of a pair a normal interval is a guess
# share of the policy's discounted time below which there is no finding
MIN_SHARE = 1e-3


@dataclass(frozen=True)
class Simulator(TabularEstimator):
    """The policy's value in the simulator itself, without the log.

    Rewards are the simulator's own. If the simulator was made of samples, the value has
    a standard error and a 95% interval.

    See Also
    --------
    OffEnvironment : The value in the simulator as the log corrects it.

    Notes
    -----
    The limit is J in the simulator. By the simulation lemma its error is
    gamma / (1 - gamma) <d_target, (P_target - P_simulator) V_simulator>.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> round(Simulator()(pair.problem(1000, seed=0), pair.policy).value, 2)
    7.97
    """

    claims = OF_COUNTS | {"identical", "shift"}

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Compute the exact value in the simulator.

        Parameters
        ----------
        problem : Problem
            The simulator; its log is not used.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            Not used.

        Returns
        -------
        Estimate
            The value, with a standard error where the simulator was sampled.
        """
        simulator = problem.simulator
        sampling = problem.simulator.sampling
        result = evaluate_policy(simulator, policy, horizon=problem.horizon)
        exact = Estimate(
            result.value,
            diagnostics={"error_bound": result.error_bound, "method": result.method},
            is_from_log=False,
        )
        if sampling is None or (problem.horizon is None and simulator.discount == 1.0):
            return exact
        share = occupancy(simulator, policy, horizon=problem.horizon).reshape(-1)
        unknown = float(share[sampling.pairs < 2.0].sum())
        has_interval = unknown <= MAX_UNKNOWN_SHARE
        warnings = _few_samples(sampling.pairs, share, has_interval=has_interval)
        error = _sampling_error(
            simulator, policy, problem.horizon, result.values, share
        )
        reach = NORMAL * error
        if not reach > ROUNDING * abs(result.value):  # the samples never varied
            return replace(exact, findings=warnings)
        source = "simulator's samples"
        interval = None
        if has_interval:
            interval = (result.value - reach, result.value + reach)
        return replace(
            exact,
            standard_error=error,
            interval=interval,
            diagnostics=exact.diagnostics
            | {
                "standard_error_of": source,
                "interval_method": source,
            },
            findings=warnings,
            measured=1.0 - unknown,
            is_normal=True,
        )

    def limit_of(self, population: Population) -> float:
        """Compute J in the simulator.

        Parameters
        ----------
        population : Population
            Simulator, target, policy and horizon.

        Returns
        -------
        float
            The value in the simulator; not normalised.
        """
        return population.value(population.simulator)


def _sampling_error(
    simulator: FiniteMDP,
    policy: Array,
    horizon: int | None,
    values: Array,
    share: Array,
) -> float:
    """Compute the standard error of J, by the equation at the top of this file.

    ``share`` (S*A,) is that of the policy's time in each state-action pair.
    """
    sampling = simulator.sampling
    matrix = simulator.transitions
    assert sampling is not None
    gradient = transition_gradient(simulator, policy, horizon=horizon)
    variance = (
        delta_error(
            matrix, matrix.data, np.maximum(sampling.pairs - 1.0, 1.0), gradient
        )
        ** 2
    )
    variance += (
        float(simulator.initial @ (values - simulator.initial @ values) ** 2)
        / sampling.starts
    )
    if sampling.reward_error is not None:
        time = share * total_discount(simulator.discount, horizon)
        each, _ = align(sampling.reward_error, matrix)
        variance += float(
            (np.repeat(time, np.diff(matrix.indptr)) * matrix.data) ** 2 @ each
        )
    return math.sqrt(variance)


def _few_samples(
    n_samples: Array, share: Array, *, has_interval: bool
) -> tuple[findings.Finding, ...]:
    """Return a finding where the policy uses pairs with few samples, else nothing."""
    is_few = (share > 0.0) & (n_samples < N_FEW)
    time = float(share[is_few].sum())
    if time <= MIN_SHARE:
        return ()
    n_used = int(((share > 0.0) & np.isfinite(n_samples)).sum())
    text = (
        f"the simulator was sampled, and {{}} of the {n_used} state-action pairs that"
        f" the policy uses have fewer than {N_FEW} samples ({time:.1%} of its"
        " discounted time)"
    )
    if not has_interval:
        text += "; do not rely on the value, which has no interval"
    return (findings.Finding("few samples", time, f"{text}.", str(int(is_few.sum()))),)


@suggest_keywords
@dataclass(frozen=True)
class Oracle(TabularEstimator):
    """The policy's value under the true zeta of a known target.

    It is exact, or, as in the paper, an average over rollouts of the simulator.

    Parameters
    ----------
    target : FiniteMDP
        The target environment.
    evaluation : {'exact', 'monte_carlo'}, default 'exact'
        Dynamic programming in zeta * P, or the paper's oracle, whose only error is that
        of averaging.
    weighting : {'per_decision', 'trajectory'}, default 'per_decision'
        For "monte_carlo": as in ``OffEnvironment``.
    self_normalized : bool, default False
        For "monte_carlo": whether the sum is divided by the sum of the weights.
    n_rollouts : int, default 100
        For "monte_carlo": the number of simulated episodes.

    Raises
    ------
    ValueError
        When called, if the target has transitions outside the simulator's support.

    See Also
    --------
    OffEnvironment : The same with a zeta that is fitted to the log.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> problem = pair.problem(1000, seed=0)
    >>> round(Oracle(pair.target)(problem, pair.policy).value, 2)
    10.07
    >>> sampled = Oracle(pair.target, evaluation="monte_carlo", n_rollouts=1000)(
    ...     problem, pair.policy, seed=0
    ... )
    >>> abs(sampled.value - pair.truth) < 4 * sampled.standard_error
    True
    """

    target: FiniteMDP
    evaluation: Literal["exact", "monte_carlo"] = "exact"
    weighting: Literal["per_decision", "trajectory"] = "per_decision"
    self_normalized: bool = False
    n_rollouts: int = 100

    def __post_init__(self) -> None:
        _checks.instance(self.target, FiniteMDP, "target")
        self._evaluate_with("conditional")  # or an error

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Compute the value under the true zeta.

        Parameters
        ----------
        problem : Problem
            The simulator; its log is not used.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of the rollouts.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        by_zeta = self._evaluate_with(true_ratio(self.target, problem.simulator))
        return replace(by_zeta.estimate(problem, policy, generator), model_value=None)

    @property
    def claims(self) -> frozenset[str]:
        """Return what the estimator claims, in words of ``testing.CLAIMS``."""
        known = self._evaluate_with("conditional").claims
        return known if self.self_normalized else known | {"unbiased"}

    def limit_of(self, population: Population) -> float:
        """Compute J under the ratio of its own target, or the mean of the rollouts.

        Parameters
        ----------
        population : Population
            Simulator, policy and horizon; the target of the population is not used.

        Returns
        -------
        float
            The limit of the value; not normalised.
        """
        return self._evaluate_with(
            true_ratio(self.target, population.simulator)
        ).limit_of(population)

    def _evaluate_with(self, ratio: RatioOption) -> OffEnvironment:
        """Return off-environment evaluation with this ratio and the same options."""
        return OffEnvironment(
            ratio,
            self.evaluation,
            self.weighting,
            self.self_normalized,
            self.n_rollouts,
        )
