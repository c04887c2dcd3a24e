"""The two ends of the scale: the simulator as it is, and the oracle that knows the true ratio.

A simulator made of samples (``FiniteMDP.from_env``, ``from_log``) has a sampling error of its own. By the delta method,
with G(s, a, s') = dJ / dP(s' | s, a) (``exact.transition_gradient``), D(s, a) the discounted time in (s, a), n(s, a) samples
of each pair and m first states,

    Var J = sum_(s, a) Var_(s' ~ P(. | s, a)) G(s, a, s') / (n(s, a) - 1) + Var_mu V / m
            + sum_(s, a, s') (D(s, a) P(s' | s, a))^2 Var(mean reward of the transition).

n - 1, since P is the frequency of these samples. A pair without two samples has no variance to show.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._sparse import align
from oee_tabular._threads import one_thread
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import OF_COUNTS, ROUNDING, Estimate, ExactLimit, catch_divergence
from oee_tabular.estimators.model_based import delta_error
from oee_tabular.estimators.off_environment import OffEnvironment
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.estimators.rollouts import check_rollout_options, product_claims
from oee_tabular.exact import evaluate_policy, occupancy, reweight, transition_gradient
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import total_discount
from oee_tabular.ratio import TransitionRatio, true_ratio
from oee_tabular.ratio.method import Population

NORMAL_QUANTILE = 1.959963984540054  # of a 95% interval
MAX_UNKNOWN_SHARE = 0.1  # of the policy's time in pairs with one sample or none: above it there is no interval
N_FEW = 10  # samples: with fewer, a normal interval is a guess
MIN_SHARE = 1e-3  # of the policy's discounted time: less is not worth a sentence


@dataclass(frozen=True)
class Simulator(ExactLimit):
    """J in the simulator as it stands, with its own rewards; the log is not used.

    Of a simulator that was made of samples the value has their standard error and a 95% interval.

    Limit: J(P_simulator); its error is gamma/(1 - gamma) <d_target, (P_target - P_simulator) V_simulator>.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> round(Simulator()(pair.problem(1000, seed=0), pair.policy).value, 2)
    7.97
    """

    @one_thread
    @catch_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """Exact; ``seed`` is not used."""
        pi = require_policy(problem, policy)
        simulator, sampling = problem.simulator, problem.simulator.sampling
        result = evaluate_policy(simulator, pi, horizon=problem.horizon)
        facts: dict[str, object] = {"error_bound": result.error_bound, "method": result.method}
        told = findings.linear_algebra(result.error_bound, result.value)
        known = Estimate(result.value, diagnostics=facts, findings=told, is_from_log=False)
        if sampling is None or (problem.horizon is None and simulator.discount == 1.0):
            return known
        share = occupancy(simulator, pi, horizon=problem.horizon).reshape(-1)
        unknown = float(share[sampling.pairs < 2.0].sum())
        told += _few_samples(sampling.pairs, share, has_interval=unknown <= MAX_UNKNOWN_SHARE)
        error = _sampling_error(simulator, pi, problem.horizon, result.values, share)
        reach = NORMAL_QUANTILE * error
        if not reach > ROUNDING * abs(result.value):  # the samples never varied
            return Estimate(result.value, diagnostics=facts, findings=told, is_from_log=False)
        return Estimate(
            result.value,
            error,
            (result.value - reach, result.value + reach) if unknown <= MAX_UNKNOWN_SHARE else None,
            diagnostics=facts | {"standard_error_of": "simulator's samples", "interval_method": "simulator's samples"},
            findings=told,
            measured=1.0 - unknown,
            is_normal=True,
            is_from_log=False,
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        return OF_COUNTS | {"identical", "shift"}

    def limit_of(self, population: Population) -> float:
        """J in the simulator."""
        return population.value(population.simulator)


def _sampling_error(simulator: FiniteMDP, policy: Array, horizon: int | None, values: Array, share: Array) -> float:
    """The standard error of J by the equation above; ``share`` (S*A,) of the policy's time."""
    sampling, matrix = simulator.sampling, simulator.transitions
    assert sampling is not None
    gradient = transition_gradient(simulator, policy, horizon=horizon)
    variance = delta_error(matrix, matrix.data, np.maximum(sampling.pairs - 1.0, 1.0), gradient) ** 2
    variance += float(simulator.initial @ (values - simulator.initial @ values) ** 2) / sampling.starts
    if sampling.reward_error is not None:
        time = share * total_discount(simulator.discount, horizon)
        each, _ = align(sampling.reward_error, matrix)
        variance += float((np.repeat(time, np.diff(matrix.indptr)) * matrix.data) ** 2 @ each)
    return math.sqrt(variance)


def _few_samples(n_samples: Array, share: Array, *, has_interval: bool) -> tuple[findings.Finding, ...]:
    """The policy goes where the simulator was hardly sampled."""
    is_few = (share > 0.0) & (n_samples < N_FEW)
    time = float(share[is_few].sum())
    if time <= MIN_SHARE:
        return ()
    n_used = int(((share > 0.0) & np.isfinite(n_samples)).sum())
    text = (
        f"the simulator was sampled, and {{}} of the {n_used} state-action pairs that the policy uses have fewer than "
        f"{N_FEW} samples ({time:.1%} of its discounted time)"
    )
    if not has_interval:
        text += "; do not rely on the value, which has no interval"
    return (findings.Finding("few samples", time, f"{text}.", str(int(is_few.sum()))),)


@dataclass(frozen=True)
class Oracle(ExactLimit):
    """The value under the true zeta, from a target that is known: exactly, or as in the paper by rollouts.

    Parameters
    ----------
    target : FiniteMDP
    evaluation : "exact" | "monte_carlo" (the paper's oracle: only the error of averaging remains)
    weighting, self_normalized, n_rollouts : as in ``OffEnvironment``

    Raises
    ------
    ValueError
        When called: the target moves outside the simulator's support.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> problem = pair.problem(1000, seed=0)
    >>> round(Oracle(pair.target)(problem, pair.policy).value, 2)
    10.07
    >>> sampled = Oracle(pair.target, evaluation="monte_carlo", n_rollouts=1000)(problem, pair.policy, seed=0)
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
        _checks.one_of(self.evaluation, "evaluation", ("exact", "monte_carlo"))
        check_rollout_options(self.weighting, self.n_rollouts)
        _checks.boolean(self.self_normalized, "self_normalized")

    @one_thread
    @catch_divergence
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """``seed`` is for "monte_carlo"."""
        pi = require_policy(problem, policy)
        ratio = true_ratio(self.target, problem.simulator)
        if self.evaluation == "monte_carlo":
            return self._off_environment(ratio)(problem, pi, seed=seed)
        result = evaluate_policy(reweight(problem.model, ratio), pi, horizon=problem.horizon)
        largest = float(ratio.values.data.max())
        return Estimate(
            result.value,
            diagnostics={"error_bound": result.error_bound, "method": result.method, "largest_weight": largest},
            findings=findings.linear_algebra(result.error_bound, result.value),
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        if self.evaluation == "exact":
            return OF_COUNTS | {"consistent", "unbiased", "shift"}
        known = product_claims(OF_COUNTS | {"consistent"}, self_normalized=self.self_normalized)
        return known if self.self_normalized else known | {"unbiased"}

    def limit_of(self, population: Population) -> float:
        """J of its own target in zeta * P, which ``target`` need not be; of the product the mean of what is averaged."""
        return self._off_environment(true_ratio(self.target, population.simulator)).limit_of(population)

    def _off_environment(self, ratio: TransitionRatio) -> OffEnvironment:
        return OffEnvironment(ratio, self.evaluation, self.weighting, self.self_normalized, self.n_rollouts)
