"""Off-environment evaluation: the value of the simulator reweighted by zeta."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Literal

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import csr_on_pattern
from oee_tabular.estimators import findings
from oee_tabular.estimators.errors import (
    effective_sample_size,
    error_or_none,
    mean_and_error,
)
from oee_tabular.estimators.estimate import Estimate
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.ratio_based import RatioEstimator, RatioOption
from oee_tabular.estimators.recorded_time import coverage, learnable_shares
from oee_tabular.estimators.rollouts import (
    carried_rewards,
    normalize_by_episode,
    normalize_by_step,
    rollout_horizon,
    weight_status,
)
from oee_tabular.exact import (
    evaluate_policy,
    policy_value,
    reweight,
    time_in_pairs,
    transition_gradient,
    weighted_return_moments,
    with_rows,
)
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.mdp import horizon_length
from oee_tabular.ratio import Quotient, Sgd, TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.shrinkage.threshold import Move, SoftThreshold
from oee_tabular.simulate import draw
from oee_tabular.typing import Array

NORMAL = NormalDist().inv_cdf(0.975)
# distance of the value from maximum likelihood's, in standard errors of their
# difference, above which a finding reports it
CONTRADICTION = 2.0
# details of a ratio that become diagnostics of the value
DETAILS = ("strength", "meaning", "n_keys")
OVERFLOW = "the product of ratios overflows: shorten the horizon, or use oee"


@suggest_keywords
@dataclass(frozen=True)
class OffEnvironment(RatioEstimator):
    """Off-environment evaluation, the default: the value of the corrected simulator.

    ``OffEnvironment()(problem, policy, seed=None)`` returns an ``Estimate``. It fits a
    ratio zeta = P_target / P to the log, shrunk to a prior, and multiplies the
    simulator's transition probabilities P by it. It computes the policy's value in this
    corrected simulator zeta * P (eq. 4.2). If the log contradicts that value, it moves
    the value towards the log. The rows that are fitted against the known P, the
    prior, the exact value and the move are this package's; ``oee_tabular.shrinkage``
    explains prior and move. What the paper has is as short a call::

        OffEnvironment()          our default
        OffEnvironment.paper()    the paper's own: the quotient of eq. 4.4, and products
                                  of it along simulated episodes

    Parameters
    ----------
    ratio : str, Method, TransitionRatio or callable, default 'conditional'
        How zeta is fitted:

        - a name, "conditional", "ratio_of_ratios" or "joint": that method of
          ``transition_ratio`` with its default options;
        - a method object of ``oee.ratio`` such as ``Conditional(strength=3.0)`` or
          ``Tied(keys)``: that method with these options;
        - a ``TransitionRatio``: this ratio, without a fit;
        - a function (log, simulator) -> TransitionRatio: what it returns. It gets the
          counts in place of the log if the problem was given counts.
    evaluation : {'exact', 'monte_carlo'}, default 'exact'
        How the value is computed. 'exact' solves for it by dynamic programming in
        zeta * P, which adds no variance. 'monte_carlo' averages rollouts of the
        simulator, weighted by the paper's products of ratios.
    weighting : {'per_decision', 'trajectory'}, default 'per_decision'
        For "monte_carlo": whether a reward is multiplied by the ratios up to its step,
        or by those of the whole episode.
    self_normalized : bool, default False
        For "monte_carlo": whether the sum is divided by the sum of the weights.
    n_rollouts : int, default 100
        For "monte_carlo": the number of simulated episodes, which are those of
        ``sample_returns``.
    adjust : SoftThreshold or None, default SoftThreshold()
        How the exact value moves towards the log where the log contradicts it. None
        leaves it at J(zeta P). It has no effect without standard errors
        of zeta: with "monte_carlo", and with ratios that are tied, quotients or given.

    Raises
    ------
    ValueError
        If an option is out of its range; when called, if the policy or the problem does
        not fit.

    See Also
    --------
    ModelBased : The maximum-likelihood model of the log, without a simulator.
    DoublyRobust : The simulator's value, and the log's residuals on top of it.
    oee_tabular.transition_ratio : The ratio itself.
    oee_tabular.shrinkage.SoftThreshold : The move towards the log.

    Notes
    -----
    As the log grows, the value with "conditional" converges to J of the target if the
    log covers the policy; unrecorded pairs have the prior (the tilted simulator).

    ``Estimate.value`` is J(zeta P), the exact value of the corrected simulator
    (``model_value``), moved towards the log by a soft threshold::

        J(zeta P) + sign(change) max(0, |change| - lambda s),   s^2 = se^2 - se_fit^2

    Here change leads from J(zeta P) to the nearer of two values, the one-step value and
    the maximum-likelihood value, and towards the latter, at most twice as far, if the
    nearer one is more than 2 s away; it is 0 if J(zeta P) lies between them. s
    is the standard error of the difference of the two values, se that of the one-step
    value, se_fit that of zeta * P if its prior fits.
    ``shrinkage.SoftThreshold`` says how change and lambda follow.

    ``Estimate.standard_error`` is the root of the sum over recorded rows of Var(G) / n
    and over the others of Var(G), with G the derivative of J in zeta * P, and variances
    under zeta * P; ``interval`` is the value ± 1.96 of it. It is that of the one-step
    value, whatever ``adjust`` is: it has room for a bias of J(zeta P) that the log
    cannot see. With adjust=None nothing bounds a bias that the log does see, and a
    finding tells where there is one.
    ``standard_error_if_centre_fits`` is a lower bound: it is the standard error if the
    prior fits, and value ± 1.96 of it covers too seldom elsewhere. With "monte_carlo"
    the standard error is that of the rollouts given zeta, which is too small if weights
    have heavy tails.

    Examples
    --------
    >>> from oee_tabular.testing import case
    >>> pair = case("ragged")  # a known target: J = 10.07
    >>> estimate = OffEnvironment()(pair.problem(1000, seed=0), pair.policy)
    >>> (
    ...     round(estimate.value, 2),
    ...     round(estimate.standard_error, 2),
    ...     round(estimate.diagnostics["one_step_value"], 2),
    ... )
    (10.18, 0.17, 10.2)
    >>> plain = OffEnvironment(adjust=None)(pair.problem(1000, seed=0), pair.policy)
    >>> round(plain.value, 2)
    10.15
    """

    ratio: RatioOption = "conditional"
    evaluation: Literal["exact", "monte_carlo"] = "exact"
    weighting: Literal["per_decision", "trajectory"] = "per_decision"
    self_normalized: bool = False
    n_rollouts: int = 100
    adjust: SoftThreshold | None = SoftThreshold()  # noqa: RUF009  it is frozen

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.adjust is not None and not isinstance(self.adjust, SoftThreshold):
            raise ArgumentError(
                "adjust",
                "must be SoftThreshold() or None; it is"
                f" {_checks.show(self.adjust)} (oee.shrinkage.SoftThreshold)",
            )
        _checks.one_of(self.evaluation, "evaluation", ("exact", "monte_carlo"))
        _checks.one_of(self.weighting, "weighting", ("per_decision", "trajectory"))
        _checks.boolean(self.self_normalized, "self_normalized")
        _checks.positive_integer(self.n_rollouts, "n_rollouts")

    @classmethod
    @suggest_keywords
    def paper(
        cls,
        *,
        lower: float = 0.01,
        upper: float = 10.0,
        ridge: float | Callable[[float], float] = 0.0,
        solver: str | Sgd = "dual",
        n_rollouts: int = 100,
    ) -> OffEnvironment:
        """Return the paper's own estimator.

        Parameters
        ----------
        lower : float, default 0.01
            The paper's nu, the lower bound on each beta.
        upper : float, default 10.0
            The paper's mu, the upper bound on each beta.
        ridge : float or callable, default 0.0
            The paper's lambda_n, a number or a function of n, times half of the sum of
            squares of each beta.
        solver : str or Sgd, default 'dual'
            'dual' finds the optimum of eq. 3.7 exactly; ``Sgd(...)`` is the paper's
            Algorithm 1.
        n_rollouts : int, default 100
            The number of simulated episodes.

        Returns
        -------
        OffEnvironment
            The quotient of two density ratios (eq. 4.4), each by eq. 3.7 without the
            constraint sum q g = 1, and the mean of simulated episodes whose rewards are
            weighted by products of the quotient (eq. 4.2).

        Examples
        --------
        >>> from oee_tabular.testing import case
        >>> pair = case("ragged")  # a known target: J = 10.07
        >>> paper = OffEnvironment.paper(n_rollouts=1000)
        >>> problem = pair.problem(1000, seed=0)
        >>> estimate = paper(problem, pair.policy, seed=0)
        >>> round(estimate.value, 1), round(estimate.standard_error, 1)
        (10.2, 0.4)
        """
        quotient = Quotient(
            lower, upper, ridge, toward=None, normalized=False, solver=solver
        )
        return cls(
            quotient, adjust=None, evaluation="monte_carlo", n_rollouts=n_rollouts
        )

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Compute J in zeta * P, moved towards the log, or the mean of the rollouts.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of the rollouts, and of simulated data for zeta.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        if self == DEFAULT:
            return _estimate_by_default(problem, policy)[0]
        zeta = self.fit(problem, policy, generator)
        if self.evaluation == "monte_carlo":
            return self._average_rollouts(problem, zeta, policy, generator)
        return _estimate_exactly(problem, zeta, policy, self.adjust)

    @property
    def claims(self) -> frozenset[str]:
        """Return what the estimator claims, in words of ``testing.CLAIMS``.

        Sums of weighted rewards do not shift with the rewards, unless they are divided
        by the sum of the weights.
        """
        if self.evaluation == "exact":
            return self.model_claims
        if self.self_normalized:
            return self.model_claims | {"shift", "random"}
        return self.model_claims - {"shift"} | {"random"}

    def _average_rollouts(
        self,
        problem: Problem,
        zeta: TransitionRatio,
        policy: Array,
        generator: np.random.Generator,
    ) -> Estimate:
        """Average rollouts of the simulator, weighted by products of zeta."""
        model = problem.model
        per_decision = self.weighting == "per_decision"
        n_steps = horizon_length(
            rollout_horizon(model.discount, problem.horizon), model
        )
        by_step = self.self_normalized and per_decision
        drawn = draw(
            model,
            policy,
            self.n_rollouts,
            n_steps,
            seed=generator,
            zeta=zeta,
            record=by_step,
            name="n_rollouts",
        )
        if by_step:
            value, error = normalize_by_step(
                *carried_rewards(model, drawn), drawn.starts, drawn.weights
            )
        elif self.self_normalized:
            value, error = normalize_by_episode(drawn.whole, drawn.weights)
        else:
            value, error = mean_and_error(
                drawn.weighted if per_decision else drawn.whole
            )
        overflows = not np.isfinite(value) and not np.isfinite(drawn.weights).all()
        return Estimate(
            value,
            error,
            status=OVERFLOW if overflows else weight_status(value),
            diagnostics={
                "standard_error_of": "rollouts",
                "n_rollouts": self.n_rollouts,
                "effective_sample_size": effective_sample_size(drawn.weights),
                "largest_weight": float(
                    (drawn.largest if per_decision else drawn.weights).max()
                ),
                "mean_weight": float(drawn.weights.mean()),
                "row_sum_error": zeta.row_sum_error,
                "gap": zeta.gap,
            },
        )

    def limit_of(self, population: Population) -> float:
        """Compute J of the limit of zeta * P, or the mean of the weighted rollouts.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.

        Notes
        -----
        The limit of "conditional" has the target's rows where the data are, and the
        prior's elsewhere. That of "ratio_of_ratios" and "joint" is the quotient clipped
        to its box, against the simulator's exact occupancy under the behaviour policy
        (under the policy of the data where none is given).
        """
        model = self.limit_model(population)
        simulator = population.simulator
        if self.evaluation == "exact" or (
            self.weighting == "per_decision" and not self.self_normalized
        ):
            return population.value(model)
        own = simulator.transitions
        rows = model.transitions.data
        zeta = csr_on_pattern(
            own, np.divide(rows, own.data, out=np.zeros_like(rows), where=own.data > 0)
        )
        moments = weighted_return_moments(
            simulator,
            zeta,
            population.policy,
            kind=self.weighting,
            self_normalized=self.self_normalized,
            horizon=rollout_horizon(simulator.discount, population.horizon),
        )
        return moments.mean


DEFAULT = OffEnvironment()
MAX_KEPT_BYTES = 2**28  # of the rows of a problem's last policies


def estimate_with_rows(problem: Problem, policy: Array) -> tuple[Estimate, Array]:
    """Compute the default's estimate, and the rows zeta P that it begins from.

    The rows have one probability for each entry of the simulator's transitions. The
    estimate is ``OffEnvironment()(problem, policy)`` without its findings; no seed
    matters.
    """
    try:
        return _estimate_by_default(problem, policy)
    except DivergentKernelError as divergence:
        zeta = DEFAULT.fit(problem, policy, np.random.default_rng(0))
        rows = reweight(problem.model, zeta).transitions.data
        return Estimate(float("nan"), status=str(divergence)), rows


def _estimate_by_default(problem: Problem, policy: Array) -> tuple[Estimate, Array]:
    """Return the default's estimate and its rows, kept for a problem's last policies.

    Intervals and comparisons need what the estimator has computed already.
    """
    kept: dict[bytes, tuple[Estimate, Array]] = problem.cache.setdefault(
        _estimate_by_default, {}
    )
    key = policy.tobytes()
    if key not in kept:
        zeta = DEFAULT.fit(problem, policy, np.random.default_rng(0))
        rows = reweight(problem.model, zeta).transitions.data
        most = max(MAX_KEPT_BYTES // max(rows.nbytes + len(key), 1), 1)
        while len(kept) >= most:
            del kept[next(iter(kept))]
        estimate = _estimate_exactly(problem, zeta, policy, DEFAULT.adjust)
        kept[key] = estimate, rows
    return kept[key]


def _estimate_exactly(
    problem: Problem,
    zeta: TransitionRatio,
    policy: Array,
    adjust: SoftThreshold | None,
) -> Estimate:
    """Compute J of zeta * P, moved towards the log where its rows sum to 1."""
    model = reweight(problem.model, zeta)
    result = evaluate_policy(model, policy, horizon=problem.horizon)
    exact = Estimate(
        result.value,
        diagnostics={
            "gap": zeta.gap,
            "row_sum_error": zeta.row_sum_error,
            "largest_weight": float(zeta.values.data.max()),
            "error_bound": result.error_bound,
            "method": result.method,
        },
    )
    if zeta.row_sum_error > _checks.SUM_TOLERANCE:
        return exact
    time = time_in_pairs(model, policy, problem.horizon)
    shares = coverage(problem, learnable_shares(problem, time), zeta.counts)
    about = {name: zeta.details[name] for name in DETAILS if name in zeta.details}
    exact = replace(
        exact,
        diagnostics=exact.diagnostics | shares | about | {"standard_error_of": None},
        model_value=result.value,
        measured=shares["coverage"],
    )
    # before the gradient, which is as large as its model
    ml_value = _maximum_likelihood_value(problem, zeta, policy)
    gradient = transition_gradient(
        model, policy, horizon=problem.horizon, values=result.values, time=time
    )
    return _add_errors(exact, ml_value, zeta, gradient, adjust)


def _add_errors(
    exact: Estimate,
    ml_value: float | None,
    zeta: TransitionRatio,
    gradient: Array,
    adjust: SoftThreshold | None,
) -> Estimate:
    """Add standard errors to J(zeta P), and move it towards the log by ``adjust``.

    ``ml_value`` is J of the maximum-likelihood model, and ``gradient`` that of J in
    zeta * P. Without standard errors of a fit the estimate stays as it is.
    """
    se_fit = zeta.log_standard_error(gradient)
    step = zeta.one_step(gradient)
    if se_fit is None or step is None:
        return exact
    known = (
        se_fit,
        step.change,
        step.standard_error,
        step.change_error,
        ml_value or 0.0,
    )
    if not np.isfinite(known).all():
        return exact  # rewards near the largest float
    error = float(np.hypot(step.standard_error, step.unrecorded))
    certain = error_or_none(error, gradient, zeta.values.indptr)
    # the value is the same in all models: what differs is rounding
    is_fixed = certain == 0.0
    shared = 1.0
    if step.standard_error > 0 and not is_fixed:
        shared = min(se_fit / step.standard_error, 1.0)
    # the standard error of the difference of the two values
    s = float(step.standard_error * np.sqrt(1.0 - shared**2))
    move = Move(0.0, 0.0, 0.0)
    if adjust is not None and ml_value is not None and not is_fixed:
        move = adjust.move(
            one_step=step.change,
            likelihood=ml_value - exact.value,
            s=s,
            se_fit=se_fit,
        )
    value = exact.value + move.amount
    diagnostics = {
        "standard_error_of": "log",
        "standard_error_if_centre_fits": se_fit,
        "interval_method": "one-step",
        "model_value": exact.value,
        "one_step_value": exact.value + step.change,
        "one_step_standard_error": error,
        "unrecorded_standard_error": step.unrecorded,
    }
    if adjust is not None:
        diagnostics |= {"one_step_distance": move.distance, "moved": move.share}
    warnings: findings.Findings = ()
    if ml_value is not None:
        diagnostics["maximum_likelihood_value"] = ml_value
        if abs(value - ml_value) > CONTRADICTION * s > 0.0:
            warnings = findings.conflict_with_log(ml_value, abs(value - ml_value) / s)
    interval = None
    if certain is not None and np.isfinite(error):
        interval = (value - NORMAL * certain, value + NORMAL * certain)
    return replace(
        exact,
        value=value,
        standard_error=certain,
        interval=interval,
        diagnostics=exact.diagnostics | diagnostics,
        findings=warnings,
        is_normal=True,
    )


def _maximum_likelihood_value(
    problem: Problem, zeta: TransitionRatio, policy: Array
) -> float | None:
    """Compute J under the maximum-likelihood rows, or return None.

    There is none where zeta has no such rows, or where at discount 1 the policy need
    not leave states with rewards.
    """
    rows = zeta.maximum_likelihood_rows
    if rows is None:
        return None
    try:
        return policy_value(
            with_rows(problem.model, rows, own=True), policy, horizon=problem.horizon
        )
    except DivergentKernelError:
        return None
