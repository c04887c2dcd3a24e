"""Off-environment evaluation: the value of the simulator reweighted by an estimated zeta."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any, Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._sparse import csr_on_pattern
from oee_tabular._threads import one_thread
from oee_tabular.estimators import findings
from oee_tabular.estimators.base import OF_COUNTS, Estimate, ExactLimit, error_or_none
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.estimators.rollouts import check_rollout_options, product_claims, product_estimate, rollout_horizon
from oee_tabular.exact import (
    Model,
    ReweightedModel,
    evaluate_policy,
    policy_value,
    reweight,
    transition_gradient,
    weighted_return_moments,
)
from oee_tabular.exact.linear import DivergentKernelError
from oee_tabular.exact.occupancy import time_in_pairs
from oee_tabular.exact.reweighted import with_rows
from oee_tabular.ratio import Method, TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.ratio.transition import method_named

NORMAL = NormalDist().inv_cdf(0.975)
# Minimax-regret soft thresholds for x ~ N(b, s^2) beside a second estimate whose bias is b: by s^2 over the variance of
# that estimate, in standard deviations s [1], interpolated in the logarithm of the ratio; the first, below 1, is a guess.
VARIANCE_RATIOS = (0.3, 1.0, 5.0, 10.0, 30.0, 100.0)
THRESHOLDS = (0.55, 0.73, 0.98, 1.12, 1.38, 1.70)
CONTRADICTION = (
    2.0  # standard errors of their difference between the value and maximum likelihood's that are worth a word
)
_SAMPLED = frozenset({"consistent", "relabelling", "scale", "random"})  # as many simulated moves as the log has
NAMED: Mapping[str, frozenset[str]] = {  # methods that need no options, and what they claim
    "conditional": OF_COUNTS | {"consistent", "shift"},
    "ratio_of_ratios": _SAMPLED,  # its rows have any sum
    "joint": _SAMPLED | {"shift"},
}
RatioOption = str | Method | TransitionRatio | Callable[..., TransitionRatio]


@dataclass(frozen=True)
class OffEnvironment(ExactLimit):
    """The paper's estimator: zeta from the log, the policy's value in zeta * P (eq. 4.2).

    Parameters
    ----------
    ratio : "conditional" | "ratio_of_ratios" | "joint"; a method of ``oee.ratio`` with its options (``Conditional(...)``,
        ``Quotient(normalized=False)``, the paper's own); a TransitionRatio; or a function (log, simulator) -> TransitionRatio
        (``functools.partial(oee.transition_ratio, strength=3.0)``); where the problem was given counts it gets those
    evaluation : "exact" (dynamic programming in zeta * P: no product of ratios, no variance) or "monte_carlo" (the
        paper's product of ratios on rollouts of the simulator)
    weighting : "per_decision" | "trajectory", for "monte_carlo"
    self_normalized : bool, for "monte_carlo": divide by the sum of the weights
    n_rollouts : int, for "monte_carlo": the episodes of ``sample_returns``, moments in ``weighted_return_moments``

    Notes
    -----
    Limit with "conditional", as n grows: J(P_target) where the log's distribution covers the policy's; the prior's rows (the
    simulator's, tilted) stand in for rows never visited. ``Estimate.value`` is the exact value of zeta * P
    (``diagnostics["model_value"]``), moved towards the log by a soft threshold:

        value + sign(change) max(0, |change| - lambda s),   s^2 = se^2 - se_fit^2,

    change leading to the one-step value or to that of maximum likelihood, whichever is nearer (0 where they lie on two
    sides): the first is linear in the log's frequencies and can overshoot, the second is not and is wild with few
    transitions. Where the nearer of them is more than 2 s away the change leads further to maximum likelihood, and from 4 s
    on all the way: what the first order misses is then larger than the noise. s is the standard error of the difference of
    the two values, se that of the one-step value, se_fit that of zeta * P if its prior fits. lambda grows with s / se_fit:
    the more the prior can gain, the more the log has to say against it. Its values make the largest regret over all biases
    of the prior as small as a soft threshold can [1].
    ``diagnostics`` has both ends and the share ``moved``.

    ``Estimate.standard_error`` is sqrt(sum over visited rows of Var(G) / n + sum over rows never visited of Var(G)), G the
    derivative of J in zeta * P, variances under zeta * P; ``interval`` is the value plus or minus 1.96 of it. The narrower
    ``standard_error_if_centre_fits`` counts the log's noise alone. With "monte_carlo" the standard error is that of the
    rollouts given zeta, which heavy tails make too small.

    Reference: [1] T. Armstrong, P. Kline and L. Sun, Adapting to misspecification, arXiv 2305.14265.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a target that is known: the truth is 10.07
    >>> estimate = OffEnvironment()(pair.problem(1000, seed=0), pair.policy)
    >>> round(estimate.value, 2), round(estimate.standard_error, 2), round(estimate.diagnostics["one_step_value"], 2)
    (10.18, 0.17, 10.2)
    """

    ratio: RatioOption = "conditional"
    evaluation: Literal["exact", "monte_carlo"] = "exact"
    weighting: Literal["per_decision", "trajectory"] = "per_decision"
    self_normalized: bool = False
    n_rollouts: int = 100

    def __post_init__(self) -> None:
        if isinstance(self.ratio, str):
            _checks.one_of(self.ratio, "ratio", tuple(NAMED))
        elif not isinstance(self.ratio, TransitionRatio | Method) and not callable(self.ratio):
            raise ValueError(
                f"ratio must be a method's name, a TransitionRatio or a function; got {_checks.show(self.ratio)}"
            )
        _checks.one_of(self.evaluation, "evaluation", ("exact", "monte_carlo"))
        check_rollout_options(self.weighting, self.n_rollouts)
        _checks.boolean(self.self_normalized, "self_normalized")

    @one_thread
    def __call__(self, problem: Problem, policy: PolicyLike, *, seed: Seed = None) -> Estimate:
        """``seed`` samples the simulator's data for "ratio_of_ratios" and the rollouts for "monte_carlo"."""
        pi = require_policy(problem, policy)
        generator = _checks.generator(seed)
        zeta = self.fit(problem, pi, generator)
        if self.evaluation == "monte_carlo":
            estimate = product_estimate(
                problem.model,
                zeta,
                pi,
                horizon=problem.horizon,
                weighting=self.weighting,
                self_normalized=self.self_normalized,
                n_rollouts=self.n_rollouts,
                seed=generator,
            )
            told = (*estimate.findings, *findings.gap(zeta.gap))
            return replace(estimate, diagnostics=estimate.diagnostics | {"gap": zeta.gap}, findings=told)
        return _exact(problem, zeta, pi)

    def fit(self, problem: Problem, policy: Array, generator: np.random.Generator) -> TransitionRatio:
        """zeta from the log, as ``ratio`` says.

        V of ``policy`` is a direction of "conditional"; ``generator`` samples the simulator's data where a method needs them.
        """
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
    def claims(self) -> frozenset[str]:
        """Words of ``testing.CLAIMS``."""
        known = ratio_claims(self.ratio)
        return known if self.evaluation == "exact" else product_claims(known, self_normalized=self.self_normalized)

    @property
    def _method(self) -> Method:
        assert isinstance(self.ratio, str | Method)
        return method_named(self.ratio) if isinstance(self.ratio, str) else self.ratio

    def limit_model(self, people: Population) -> ReweightedModel:
        """zeta * P with the zeta that infinitely many moves would give."""
        if isinstance(self.ratio, TransitionRatio):
            return reweight(people.simulator, self.ratio)
        if callable(self.ratio):
            return reweight(people.simulator, self.ratio(people.counts(), people.simulator))
        return reweight(people.simulator, self._method.limit(people))

    def limit_of(self, people: Population) -> float:
        """J of the limit of zeta * P; of the product of ratios the mean of what is averaged.

        Exact rows of the target where the data are, the prior's elsewhere ("conditional"); the box-clipped quotient
        ("ratio_of_ratios", "joint": data_distribution counts, against the simulator's exact occupancy under the
        behaviour policy, which is that of the data where it is not given).
        """
        model = self.limit_model(people)
        if self.evaluation == "exact" or (self.weighting == "per_decision" and not self.self_normalized):
            return people.value(model)
        zeta = csr_on_pattern(
            people.simulator.transitions,
            np.divide(model.transitions.data, people.simulator.transitions.data, out=np.zeros(people.simulator.transitions.nnz),
                      where=people.simulator.transitions.data > 0),
        )  # fmt: skip
        return weighted_return_moments(
            people.simulator, zeta, people.policy, kind=self.weighting, self_normalized=self.self_normalized,
            horizon=rollout_horizon(people.simulator.discount, people.horizon),
        ).mean  # fmt: skip


def ratio_claims(ratio: RatioOption) -> frozenset[str]:
    """What the exact value of zeta * P claims by the way zeta is found.

    A zeta that is given is right for one pair only; a function promises nothing but that it does not look at rewards.
    """
    if isinstance(ratio, TransitionRatio):
        return OF_COUNTS | {"shift"} if ratio.row_sum_error <= _checks.SUM_TOLERANCE else OF_COUNTS
    return NAMED[ratio] if isinstance(ratio, str) else frozenset({"scale"})


def _exact(problem: Problem, zeta: TransitionRatio, policy: Array) -> Estimate:
    model = reweight(problem.model, zeta)
    diagnostics: dict[str, object] = {
        "gap": zeta.gap,
        "row_sum_error": zeta.row_sum_error,
        "largest_weight": float(zeta.values.data.max()),
    }
    try:
        found = evaluate_policy(model, policy, horizon=problem.horizon)
    except DivergentKernelError as divergence:
        return Estimate(float("nan"), diagnostics=diagnostics, status=str(divergence))
    diagnostics |= {"error_bound": found.error_bound, "method": found.method}
    told = (
        *findings.row_sums(zeta.row_sum_error),
        *findings.gap(zeta.gap),
        *findings.linear_algebra(found.error_bound, found.value),
    )
    if zeta.row_sum_error > _checks.SUM_TOLERANCE:
        return Estimate(found.value, diagnostics=diagnostics, findings=told)
    time = time_in_pairs(model, policy, problem.horizon)
    seen = coverage(problem, model, policy, zeta.counts, time)
    diagnostics |= seen
    diagnostics |= {name: zeta.details[name] for name in ("strength", "meaning", "n_keys") if name in zeta.details}
    diagnostics["standard_error_of"] = None
    exact = Estimate(
        found.value, diagnostics=diagnostics, findings=told, model_value=found.value, measured=seen["coverage"]
    )
    step = _moved(problem, zeta, policy, model, exact, found.values, time)
    unseen = findings.unseen_time(seen["fallback_share"], judged=step is not exact, tied=zeta.tied)
    return replace(step, findings=(*unseen, *step.findings))


def _moved(
    problem: Problem, zeta: TransitionRatio, policy: Array, model: Model, exact: Estimate, values: Array, time: Array
) -> Estimate:
    """The exact value, moved towards the log where that speaks against the prior; its standard error and interval."""
    likeliest = _likeliest(problem, zeta, policy)  # before the gradient, which is as large as its model
    gradient = transition_gradient(model, policy, horizon=problem.horizon, values=values, time=time)
    within, step = zeta.log_standard_error(gradient), zeta.one_step(gradient)
    if within is None or step is None:
        return exact
    known = [within, step.change, step.standard_error, step.change_error]
    if not np.isfinite(known if likeliest is None else [*known, likeliest]).all():
        return exact  # rewards near the largest float
    shared = min(within / step.standard_error, 1.0) if step.standard_error > 0 else 1.0
    apart = float(step.standard_error * np.sqrt(1.0 - shared**2))
    change = 0.0 if likeliest is None else change_to_log(step.change, likeliest - exact.value, apart)
    kept = min(abs(change), threshold(apart, within) * apart)
    share = 1.0 - kept / abs(change) if change else 0.0
    value, error = exact.value + share * change, float(np.hypot(step.standard_error, step.unseen))
    diagnostics = exact.diagnostics | {
        "standard_error_of": "log",
        "standard_error_if_centre_fits": within,
        "interval_method": "one-step",
        "model_value": exact.value,
        "one_step_value": exact.value + step.change,
        "one_step_standard_error": error,
        "unseen_standard_error": step.unseen,
        "one_step_distance": abs(change) / apart if apart > 0 else 0.0,
        **({} if likeliest is None else {"maximum_likelihood_value": likeliest}),
        "moved": share,
    }
    told = error_or_none(error, gradient, problem.model.transitions.indptr)
    interval = (value - NORMAL * error, value + NORMAL * error) if told is not None and np.isfinite(error) else None
    return replace(
        exact,
        value=value,
        standard_error=told,
        interval=interval,
        diagnostics=diagnostics,
        findings=(*findings.no_variation(told), *_contradiction(value, likeliest, apart), *exact.findings),
        is_normal=True,
    )


def threshold(apart: float, within: float) -> float:
    """lambda of the soft threshold, where the two values' difference has the standard error ``apart``."""
    if not within > 0.0:
        return THRESHOLDS[-1]
    logs = np.log(VARIANCE_RATIOS)
    return float(np.interp(2.0 * np.log(max(apart, 1e-300) / within), logs, THRESHOLDS))


def _contradiction(value: float, likeliest: float | None, apart: float) -> tuple[findings.Finding, ...]:
    """The value rests on the tilt against the log."""
    if likeliest is None or not abs(value - likeliest) > CONTRADICTION * apart > 0.0:
        return ()
    return findings.conflict_with_centre(likeliest, abs(value - likeliest) / apart)


def _likeliest(problem: Problem, zeta: TransitionRatio, policy: Array) -> float | None:
    """Maximum likelihood's value; None without one, or where at discount 1 states that pay keep the policy for ever."""
    likeliest = zeta.likeliest
    if likeliest is None:
        return None
    try:
        return policy_value(with_rows(problem.model, likeliest, own=True), policy, horizon=problem.horizon)
    except DivergentKernelError:
        return None


def change_to_log(one_step: float, likelihood: float, apart: float) -> float:
    """The change to what the log says: to the nearer of two values, 0 where they contradict each other.

    Where the nearer is 2 to 4 times ``apart`` away, more and more to maximum likelihood's.
    """
    if one_step * likelihood <= 0:
        return 0.0
    nearer = min(one_step, likelihood, key=abs)
    distance = abs(nearer) / apart if apart > 0 else np.inf
    return nearer + float(np.clip((distance - 2.0) / 2.0, 0.0, 1.0)) * (likelihood - nearer)


def coverage(problem: Problem, model: Model, policy: Array, counts: Array, time: Array | None = None) -> dict[str, Any]:
    """How much of the policy's discounted time in ``model`` the log has seen, and how many of its transitions bear on it.

    ``counts`` (S, A) are the log's, ``time`` the policy's where it is known. States that no action leaves in the simulator
    are left out of the time: there is nothing to learn. The effective sample size is 1 / sum d^2 / n over visited (s, a),
    scaled to the visited share: the number of transitions that would tell as much if recorded where the policy goes.
    """
    time = time_in_pairs(model, policy, problem.horizon) if time is None else time
    alive = np.where(problem.simulator.closed()[:, None], 0.0, time)
    visited = counts > 0
    total = float(alive.sum())
    d: Array = alive[visited]
    n: Array = counts[visited]
    seen = float(d.sum())
    share = 1.0 if total == 0.0 else min(seen / total, 1.0)
    spread = float(np.sum(d * d / n)) if d.size else 0.0
    missed = np.where(visited, 0.0, alive)
    first = [divmod(int(k), model.n_actions) for k in np.argsort(-missed, axis=None, kind="stable")[:3]]
    return {
        "unseen": "; ".join(problem.simulator.names.pair(s, a) for s, a in first if missed[s, a] > 0),
        "coverage": share,
        "fallback_share": 1.0 - share,
        "effective_sample_size": seen**2 / spread if spread > 0 else 0.0,
    }
