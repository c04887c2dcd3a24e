"""What an estimator is and returns, its exact limit, its option ``ratio``; means with
standard errors.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from oee_tabular import _checks, _printing
from oee_tabular._parallel import one_thread
from oee_tabular._sparse import row_variances
from oee_tabular.estimators.findings import WEIGHTLESS, Finding, from_diagnostics
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.exact import ReweightedModel, reweight
from oee_tabular.exact.system import exponent
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import optional_horizon_length
from oee_tabular.ratio import Method, TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.ratio.support import refuse_unsupported, require_pair
from oee_tabular.ratio.transition import method_named
from oee_tabular.typing import Array, IntArray, PolicyLike, Seed

UNEXPLAINED = "the value is not finite: beyond the largest float, or not a number"

# diagnostics that are values, or errors of values: (1 - discount) multiplies them as
# well
IN_VALUES_UNIT = frozenset(
    {
        "simulator_value",
        "model_value",
        "one_step_value",
        "maximum_likelihood_value",
        "replaced_value",
        "refused_value",
        "second_calibration_value",
        "truncation_bias_bound",
        "error_bound",
        "one_step_standard_error",
        "unrecorded_standard_error",
        "standard_error_if_centre_fits",
        "standard_error_of_the_log",
    }
)


@dataclass(frozen=True)
class Estimate:
    """A value of a policy in the target, a discounted sum of rewards (not multiplied by
    1 - discount).

    Attributes
    ----------
    value : float (nan if there is none; status says why)
    standard_error : float or None
        None also if the data do not vary: one transition, or equal returns.
        ``diagnostics["standard_error_of"]`` says what it covers: the log or the
        rollouts.
    interval : (lower, upper) or None
        The estimator's own, at 95%. If ``model_value`` is set, ``oee.evaluate`` quotes
        the likelihood interval instead, where there is one.
        ``diagnostics["interval_method"]`` names the interval.
    diagnostics : numbers and strings
        If they apply: ``effective_sample_size``, ``largest_weight``, ``coverage``
        (share of the
        policy's discounted time in recorded pairs), ``unrecorded_share`` (the rest),
        ``row_sum_error``, ``error_bound`` (of the linear algebra), ``gap`` (of the
        convex programs).
    status : "ok", or the problem and a remedy
    findings : warnings, which a report prints
    model_value : the exact value of zeta * P, or None
        Set if the value is that of a corrected simulator whose rows sum to 1. A report
        quotes such values first, with the likelihood interval.
    measured : share of the policy's time in pairs whose variance the standard error
        includes
    is_normal : whether the interval is the value ± a quantile times the standard error
    is_from_log : False if the value uses the simulator alone
    is_from_episodes : whether it averages the log's own episodes and rewards
    is_headline : whether a report gives it first

    Examples
    --------
    >>> import oee_tabular as oee
    >>> pair = oee.testing.case("ragged")
    >>> estimate = oee.estimators.ModelBased()(pair.problem(1000, seed=0), pair.policy)
    >>> estimate, estimate.status, estimate.diagnostics["standard_error_of"]
    (Estimate(10.2027 ± 0.17 (standard error)), 'ok', 'log')
    """

    value: float
    standard_error: float | None = None
    interval: tuple[float, float] | None = None
    diagnostics: dict[str, Any] = field(default_factory=dict)
    status: str = "ok"
    findings: tuple[Finding, ...] = ()
    model_value: float | None = None
    measured: float = 1.0
    is_normal: bool = False
    is_from_log: bool = True
    is_from_episodes: bool = False
    is_headline: bool = False

    def __post_init__(self) -> None:
        for k, finding in enumerate(
            _checks.collection(self.findings, "findings", "Findings")
        ):
            _checks.instance(
                finding, Finding, f"findings[{k}]", "Finding(kind, severity, text)"
            )
        _checks.instance(self.status, str, "status", "string")
        number = isinstance(self.value, float | int | np.number)
        if number and self.status == "ok" and not np.isfinite(self.value):
            object.__setattr__(self, "status", UNEXPLAINED)

    def __repr__(self) -> str:
        return (
            f"Estimate({self._value_and_error()}"
            + ("" if self.status == "ok" else f", {self.status}")
            + ")"
        )

    def __str__(self) -> str:
        ends = (
            ""
            if self.interval is None
            else f", interval {_printing.interval(*self.interval)}"
        )
        text = f"{self._value_and_error()}{ends}; {_printing.SUM}"
        return text + ("" if self.status == "ok" else f"; {self.status}")

    def _value_and_error(self) -> str:
        error = (
            ""
            if self.standard_error is None
            else f" ± {self.standard_error:.2g} (standard error)"
        )
        return f"{self.value:.6g}{error}"

    def _repr_html_(self) -> str:
        error = None if self.standard_error is None else f"{self.standard_error:.2g}"
        ends = None if self.interval is None else _printing.interval(*self.interval)
        rows: dict[str, object] = {
            "value": f"{self.value:.6g}",
            "standard error": error,
            "interval": ends,
        }
        rows = {name: shown for name, shown in rows.items() if shown is not None}
        rows |= {
            name: f"{x:.4g}" if isinstance(x, float) else x
            for name, x in self.diagnostics.items()
        }
        return _printing.facts(
            f"Estimate: {_printing.SUM}", [*rows.items(), ("status", self.status)]
        )


class Estimator(Protocol):
    """An estimator as a callable; the package's own are frozen dataclasses of their
    options.

    Examples
    --------
    An estimator of one's own, against one of the laws that estimators should satisfy:

    >>> import oee_tabular as oee
    >>> def model(problem, policy, *, seed=None):
    ...     ratio = oee.transition_ratio(problem.log, problem.simulator, prior="simulator")
    ...     return Estimate(oee.policy_value(ratio.target_model(problem.model), policy, horizon=problem.horizon))
    >>> oee.testing.check_estimator(model, laws=["scale"])["scale"].outcome
    'holds'
    """

    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Estimate J of ``policy`` in the target of ``problem``."""
        ...


def effective_sample_size(weights: Array) -> float:
    """Kish's (sum w)^2 / sum w^2: how many equally weighted samples would vary as much;
    0 where all weights are 0.
    """
    # squares of very large or small numbers leave the range of floats
    scaled = np.ldexp(weights, -exponent(weights))
    square = float(scaled @ scaled)
    return float(scaled.sum()) ** 2 / square if square > 0 else 0.0


ROUNDING = 1e-12  # of the largest number involved: what is smaller does not vary


def mean_and_error(values: Array, size: float = 0.0) -> tuple[float, float | None]:
    """Mean and standard error of independent values, without an error where they do not
    vary.

    ``size``: of the numbers that the values are differences of, where they are.
    """
    # squares of very large or small numbers leave the range of floats
    n = len(values)
    shift = exponent(values)
    scaled = np.ldexp(values, -shift)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values
        most = max(float(np.abs(scaled).max()), float(np.ldexp(size, -shift)))
        varies = n > 1 and not np.ptp(scaled) <= ROUNDING * most
        error = (
            float(np.ldexp(scaled.std(ddof=1) / np.sqrt(n), shift)) if varies else None
        )
        return float(np.ldexp(scaled.mean(), shift)), error


def delta_error(
    matrix: sparse.csr_array, frequency: Array, totals: Array, gradient: Array
) -> float:
    """Delta method, root of the sum over recorded rows of Var(gradient) / n, variances
    under ``frequency``.
    """
    shift = exponent(gradient)
    gradient = np.ldexp(gradient, -shift)
    variance = row_variances(matrix, frequency, gradient)
    return float(
        np.ldexp(np.sqrt(np.sum(variance[totals > 0] / totals[totals > 0])), shift)
    )


def error_or_none(error: float, gradient: Array, indptr: IntArray) -> float | None:
    """A delta-method error; None where it is 0 though a row's next state matters.

    ``gradient`` of the value, on the entries of the simulator's rows.
    """
    starts = indptr[:-1]
    reach = np.maximum.reduceat(gradient, starts) - np.minimum.reduceat(
        gradient, starts
    )
    possible = float(reach.max())
    matters = possible > ROUNDING * float(np.abs(gradient).max())
    return None if matters and error <= ROUNDING * possible else error


def learnable_shares(problem: Problem, time: Array) -> Array:
    """Shares of the policy's ``time`` (S, A), without states that no action leaves."""
    alive = np.where(problem.simulator.closed()[:, None], 0.0, time)
    return np.asarray(alive / (float(alive.sum()) or 1.0))


def coverage(problem: Problem, shares: Array, counts: Array) -> dict[str, Any]:
    """The share of the policy's time in recorded pairs, and the effective sample size.

    ``shares`` (S, A) are those of ``learnable_shares``, ``counts`` (S, A) the log's.
    The effective sample
    size is (sum d)^2 / sum d^2 / n over recorded pairs: as many transitions drawn from
    the policy's
    occupancy have the same variance.
    """
    visited = counts > 0
    d = shares[visited]
    n = counts[visited]
    missed = np.where(visited, 0.0, shares)
    share = float(missed.sum())
    spread = float(np.sum(d * d / n))
    longest = np.argsort(-missed, axis=None, kind="stable")[:3]
    pairs = [divmod(int(k), shares.shape[1]) for k in longest if missed.flat[k] > 0]
    return {
        "unrecorded": "; ".join(problem.simulator.names.pair(s, a) for s, a in pairs),
        "coverage": 1.0 - share,
        "unrecorded_share": share,
        "effective_sample_size": float(d.sum()) ** 2 / spread if spread > 0 else 0.0,
    }


# what an estimator claims (testing.CLAIMS) that reads the log's counts alone
OF_COUNTS = frozenset({"relabelling", "scale", "padding", "after_end"})


class TabularEstimator:
    """An estimator of the package: the arguments of calls and limits are checked here."""

    @one_thread
    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Estimate J of ``policy`` in the target.

        ``seed`` is for rollouts, resamples and the simulator's data. The value is nan
        if its sum diverges;
        the status says why.
        """
        pi = require_policy(problem, policy)
        try:
            estimate = self.estimate(problem, pi, _checks.generator(seed))
        except DivergentKernelError as divergence:
            return Estimate(float("nan"), status=str(divergence))
        if WEIGHTLESS in estimate.findings:
            return estimate
        warnings = from_diagnostics(
            estimate.diagnostics, estimate.value, estimate.standard_error
        )
        return replace(estimate, findings=(*warnings, *estimate.findings))

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """The estimate of a checked policy, without the findings that its diagnostics
        make.
        """
        raise NotImplementedError

    def limit(
        self,
        simulator: FiniteMDP,
        target: FiniteMDP,
        policy: PolicyLike,
        *,
        data_distribution: ArrayLike | None = None,
        behavior_policy: PolicyLike | None = None,
        horizon: int | None = None,
    ) -> float:
        """The exact population limit, bias included, of a policy's estimated value.

        Parameters
        ----------
        simulator, target : FiniteMDP
            The target inside the simulator's support where there are data.
        policy : (S, A)
        data_distribution : (S, A) or None
            How pairs are recorded (None: evenly). Its support alone matters but for the
            quotient of two
            ratios, and with features.
        behavior_policy : (S, A) of the log's episodes; None: one with support
        horizon : positive int or None
        """
        require_pair(target, simulator)
        share = np.full(
            (simulator.n_states, simulator.n_actions),
            1.0 / simulator.transitions.shape[0],
        )
        if data_distribution is not None:
            share = _checks.distribution(
                data_distribution, "data_distribution", share.shape
            )
        support = share.reshape(-1) > 0
        keep = sparse.diags_array(support.astype(np.float64), format="csr")
        refuse_unsupported(
            sparse.csr_array(keep @ target.transitions), simulator, what="target"
        )
        if behavior_policy is not None:
            behavior_policy = check_policy(
                behavior_policy, simulator, name="behavior_policy"
            )
        steps = optional_horizon_length(horizon, simulator)
        pi = check_policy(policy, simulator)
        return self.limit_of(
            Population(simulator, target, pi, share, support, behavior_policy, steps)
        )

    def limit_of(self, population: Population) -> float:
        """The limit in a checked population."""
        raise NotImplementedError


RatioOption = str | Method | TransitionRatio | Callable[..., TransitionRatio]
# as many simulated moves as the log has
_SAMPLED = frozenset({"consistent", "relabelling", "scale", "random"})
# methods that need no options, and what they claim
CLAIMS_OF_METHODS: Mapping[str, frozenset[str]] = {
    "conditional": OF_COUNTS | {"consistent", "shift"},
    "ratio_of_ratios": _SAMPLED,  # its rows have any sum
    "joint": _SAMPLED | {"shift"},
}


class RatioEstimator(TabularEstimator):
    """An estimator with a zeta: given, or fitted as ``ratio`` says."""

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
        """zeta from the log, as ``ratio`` says; V of ``policy`` is a direction of
        "conditional".
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
        """What the exact value of zeta * P claims; a zeta that is given is right for
        one pair only.
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
