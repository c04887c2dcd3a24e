"""The two ends of the scale: the simulator as it is, and the oracle that knows the true ratio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from oee_tabular import _checks
from oee_tabular._checks import PolicyLike, Seed
from oee_tabular._threads import one_thread
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import OF_COUNTS, ROUNDING, Estimate, ExactLimit, catch_divergence
from oee_tabular.estimators.off_environment import OffEnvironment
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.estimators.rollouts import check_rollout_options, product_claims, product_estimate
from oee_tabular.estimators.sampling import compute_sampling_error, short_samples
from oee_tabular.exact import evaluate_policy, reweight
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio import true_ratio
from oee_tabular.ratio.method import Population

NORMAL_QUANTILE = 1.959963984540054  # of a 95% interval
MAX_UNKNOWN_SHARE = 0.1  # of the policy's time in pairs with one sample or none: above it there is no interval


@dataclass(frozen=True)
class Simulator(ExactLimit):
    """J in the simulator as it stands, with its own rewards; the log is not used.

    Of a simulator that was made of samples the value has their standard error and a 95% interval (``estimators.sampling``).

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
        found = evaluate_policy(problem.simulator, pi, horizon=problem.horizon)
        facts: dict[str, object] = {"error_bound": found.error_bound, "method": found.method}
        told = findings.linear_algebra(found.error_bound, found.value)
        error = compute_sampling_error(problem.simulator, pi, problem.horizon)
        if error is None:
            return Estimate(found.value, diagnostics=facts, findings=told, is_from_log=False)
        is_known = error.unknown_share <= MAX_UNKNOWN_SHARE
        told += short_samples(error, has_interval=is_known)
        reach = NORMAL_QUANTILE * error.standard_error
        if not reach > ROUNDING * abs(found.value):  # the samples never varied
            return Estimate(found.value, diagnostics=facts, findings=told, is_from_log=False)
        ends = (found.value - reach, found.value + reach) if is_known else None
        return Estimate(
            found.value,
            error.standard_error,
            ends,
            diagnostics=facts | {"standard_error_of": "simulator's samples", "interval_method": "simulator's samples"},
            findings=told,
            is_from_log=False,
            is_normal=True,
            measured=1.0 - error.unknown_share,
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        return OF_COUNTS | {"identical", "shift"}

    def limit_of(self, people: Population) -> float:
        """J in the simulator."""
        return people.value(people.simulator)


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
            return product_estimate(
                problem.model,
                ratio,
                pi,
                horizon=problem.horizon,
                weighting=self.weighting,
                self_normalized=self.self_normalized,
                n_rollouts=self.n_rollouts,
                seed=seed,
            )
        found = evaluate_policy(reweight(problem.model, ratio), pi, horizon=problem.horizon)
        return Estimate(
            found.value,
            diagnostics={
                "error_bound": found.error_bound,
                "method": found.method,
                "largest_weight": float(ratio.values.data.max()),
            },
            findings=findings.linear_algebra(found.error_bound, found.value),
        )

    @property
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        if self.evaluation == "exact":
            return OF_COUNTS | {"consistent", "unbiased", "shift"}
        known = product_claims(OF_COUNTS | {"consistent"}, self_normalized=self.self_normalized)
        return known if self.self_normalized else known | {"unbiased"}

    def limit_of(self, people: Population) -> float:
        """J of its own target in zeta * P, which ``target`` need not be; of the product the mean of what is averaged."""
        return OffEnvironment(
            ratio=true_ratio(self.target, people.simulator),
            evaluation=self.evaluation,
            weighting=self.weighting,
            self_normalized=self.self_normalized,
        ).limit_of(people)
