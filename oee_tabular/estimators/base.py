"""Estimates, the base classes of estimators, and means with standard errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from oee_tabular import _checks, _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._parallel import one_thread
from oee_tabular._results import checked
from oee_tabular._sparse import row_variances
from oee_tabular.estimators.diagnostics import DiagnosticsField
from oee_tabular.estimators.findings import WEIGHTLESS, Finding, from_diagnostics
from oee_tabular.estimators.problem import Problem, require_policy
from oee_tabular.exact import ReweightedModel, reweight
from oee_tabular.exact.system import exponent
from oee_tabular.exact.values import largest_reward
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import optional_horizon_length
from oee_tabular.ratio import Method, TransitionRatio
from oee_tabular.ratio.method import Population
from oee_tabular.ratio.support import refuse_unsupported, require_pair
from oee_tabular.shrinkage.transition import method_named
from oee_tabular.typing import (
    Array,
    Csr,
    PolicyLike,
    RealArrayLike,
    Seed,
)

UNEXPLAINED = "the value is not finite: beyond the largest float, or not a number"


@suggest_keywords
@checked()
@dataclass(frozen=True)
class Estimate:
    """A value of a policy in the target, with its standard error and diagnostics.

    Parameters
    ----------
    value : float
        The discounted sum of rewards, not multiplied by 1 - discount. It is nan where
        there is no value; ``status`` says why.
    standard_error : float, optional
        The standard error of the value. It is None also where the data do not vary:
        one transition, or equal returns. ``diagnostics["standard_error_of"]`` says what
        it covers: the log or the rollouts.
    interval : tuple of (float, float), optional
        The estimator's own interval (lower, upper), at 95%. Where ``model_value`` is
        set, ``oee.evaluate`` quotes the likelihood interval instead, if there is one.
        ``diagnostics["interval_method"]`` names the interval.
    diagnostics : Diagnostics or mapping, optional
        Numbers and texts on how the value came about, such as the coverage, the largest
        weight or the accuracy of the linear solve. Every mapping is stored as a
        ``Diagnostics``, which lists the known keys with their units.
    status : str, default 'ok'
        The problem and a remedy, if there is a problem.
    findings : tuple of Finding, optional
        Warnings about the value, which a report prints.
    model_value : float, optional
        The exact value of zeta * P, where the value is that of a corrected simulator
        whose rows sum to 1. A report quotes such values first, with the likelihood
        interval.
    measured : float, default 1.0
        The share of the policy's discounted time in pairs whose variance the standard
        error includes.
    is_normal : bool, default False
        Whether the interval is the value ± a quantile times the standard error.
    is_from_log : bool, default True
        Whether the value uses the log, and not the simulator alone.
    is_from_episodes : bool, default False
        Whether the value averages the log's own episodes and rewards.
    is_headline : bool, default False
        Whether a report gives this value first.

    See Also
    --------
    Diagnostics : The known diagnostics, with type, unit and meaning.
    Finding : A warning about a value.

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
    diagnostics: DiagnosticsField = DiagnosticsField()  # noqa: RUF009  a descriptor
    status: str = "ok"
    findings: tuple[Finding, ...] = ()
    model_value: float | None = None
    measured: float = 1.0
    is_normal: bool = False
    is_from_log: bool = True
    is_from_episodes: bool = False
    is_headline: bool = False

    def __post_init__(self) -> None:
        if self.status == "ok" and not np.isfinite(self.value):
            object.__setattr__(self, "status", UNEXPLAINED)

    def __repr__(self) -> str:
        text = self._value_and_error()
        if self.status != "ok":
            text += f", {self.status}"
        return f"Estimate({text})"

    def __str__(self) -> str:
        text = self._value_and_error()
        if self.interval is not None:
            text += f", interval {_printing.interval(*self.interval)}"
        text += f"; {_printing.SUM}"
        if self.status != "ok":
            text += f"; {self.status}"
        return text

    def _value_and_error(self) -> str:
        """Write the value, and its standard error if there is one."""
        if self.standard_error is None:
            return f"{self.value:.6g}"
        return f"{self.value:.6g} ± {self.standard_error:.2g} (standard error)"

    def _repr_html_(self) -> str:
        """Return the table that a notebook shows."""
        rows: dict[str, object] = {"value": f"{self.value:.6g}"}
        if self.standard_error is not None:
            rows["standard error"] = f"{self.standard_error:.2g}"
        if self.interval is not None:
            rows["interval"] = _printing.interval(*self.interval)
        for name, x in self.diagnostics.items():
            rows[name] = f"{x:.4g}" if isinstance(x, float) else x
        return _printing.facts(
            f"Estimate: {_printing.SUM}", [*rows.items(), ("status", self.status)]
        )


class Estimator(Protocol):
    """An estimator: a callable that gives an ``Estimate`` of a policy's value.

    The package's own estimators are frozen dataclasses of their options. Functions that
    return a number or an ``Estimate`` serve as well (``oee.evaluate``,
    ``oee.testing.check_estimator``).

    See Also
    --------
    Estimate : What an estimator returns.
    Problem : What an estimator is given.

    Examples
    --------
    An estimator of one's own, against one of the laws that estimators should satisfy:

    >>> import oee_tabular as oee
    >>> def model(problem, policy, *, seed=None):
    ...     ratio = oee.transition_ratio(
    ...         problem.log, problem.simulator, prior="simulator"
    ...     )
    ...     return Estimate(
    ...         oee.policy_value(
    ...             ratio.target_model(problem.model), policy, horizon=problem.horizon
    ...         )
    ...     )
    >>> oee.testing.check_estimator(model, laws=["scale"])["scale"].outcome
    'holds'
    """

    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Estimate the policy's value in the target.

        Parameters
        ----------
        problem : Problem
            The simulator and the log, with the horizon and the source of rewards.
        policy : PolicyLike
            The policy to evaluate.
        seed : int, Generator or None, optional
            The seed of whatever is drawn.

        Returns
        -------
        Estimate
            The value, with a standard error where the estimator has one.
        """
        ...


def effective_sample_size(weights: Array) -> float:
    """Compute Kish's effective sample size, (sum w)^2 / sum w^2.

    As many equally weighted samples would vary as much. It is 0 where all weights are
    0.
    """
    # squares of very large or small numbers leave the range of floats
    scaled = np.ldexp(weights, -exponent(weights))
    square = float(scaled @ scaled)
    return float(scaled.sum()) ** 2 / square if square > 0 else 0.0


# a share of the largest number involved: a smaller spread is rounding, and no variation
ROUNDING = 1e-12


def mean_and_error(values: Array, size: float = 0.0) -> tuple[float, float | None]:
    """Compute the mean and the standard error of independent values.

    There is no error where the values do not vary. If they are differences, ``size`` is
    the size of the numbers that were subtracted, whose rounding is no variation.
    """
    # squares of very large or small numbers leave the range of floats
    n = len(values)
    shift = exponent(values)
    scaled = np.ldexp(values, -shift)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values
        most = max(float(np.abs(scaled).max()), float(np.ldexp(size, -shift)))
        varies = n > 1 and not np.ptp(scaled) <= ROUNDING * most
        error = None
        if varies:
            error = float(np.ldexp(scaled.std(ddof=1) / np.sqrt(n), shift))
        return float(np.ldexp(scaled.mean(), shift)), error


def delta_error(matrix: Csr, frequency: Array, totals: Array, gradient: Array) -> float:
    """Compute a standard error by the delta method.

    It is the root of the sum over recorded rows of Var(gradient) / n, with the
    variances under ``frequency`` and the numbers n in ``totals``.
    """
    shift = exponent(gradient)
    gradient = np.ldexp(gradient, -shift)
    variance = row_variances(matrix, frequency, gradient)
    return float(
        np.ldexp(np.sqrt(np.sum(variance[totals > 0] / totals[totals > 0])), shift)
    )


def error_or_none(
    error: float, gradient: Array, indptr: NDArray[np.integer[Any]]
) -> float | None:
    """Return a delta-method error, or None where 0 would be wrong.

    An error of 0 is wrong where the next state of some row matters: what was recorded
    did not vary. ``gradient`` is the value's, on the entries of the simulator's rows,
    which begin at ``indptr``.
    """
    starts = indptr[:-1]
    reach = np.maximum.reduceat(gradient, starts) - np.minimum.reduceat(
        gradient, starts
    )
    possible = float(reach.max())
    matters = possible > ROUNDING * float(np.abs(gradient).max())
    return None if matters and error <= ROUNDING * possible else error


def learnable_shares(problem: Problem, time: Array) -> Array:
    """Compute the shares of the policy's time, without states that no action leaves.

    ``time`` and the result have the shape (S, A).
    """
    alive = np.where(problem.simulator.closed()[:, None], 0.0, time)
    return np.asarray(alive / (float(alive.sum()) or 1.0))


def coverage(problem: Problem, shares: Array, counts: Array) -> dict[str, Any]:
    """Compute the share of the policy's time in recorded pairs, and the sample size.

    ``shares`` (S, A) are those of ``learnable_shares``, ``counts`` (S, A) the log's.
    The effective sample size is (sum d)^2 / (sum d^2 / n) over recorded pairs: as many
    transitions drawn from the policy's occupancy have the same variance.
    """
    recorded = counts > 0
    d = shares[recorded]
    n = counts[recorded]
    missed = np.where(recorded, 0.0, shares)
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


# the claims (testing.CLAIMS) of an estimator that reads the log's counts alone
OF_COUNTS = frozenset({"relabelling", "scale", "padding", "after_end"})


class TabularEstimator:
    """The base of the package's estimators, which checks arguments and adds findings.

    A subclass defines ``estimate``, ``limit_of`` and ``claims``.
    """

    @one_thread
    def __call__(
        self, problem: Problem, policy: PolicyLike, *, seed: Seed = None
    ) -> Estimate:
        """Estimate the policy's value in the target.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : PolicyLike
            The policy to evaluate.
        seed : int, Generator or None, optional
            The seed of rollouts, resamples and the simulator's data.

        Returns
        -------
        Estimate
            The value with its findings. It is nan if its sum diverges; the status says
            why.
        """
        pi = require_policy(problem, policy)
        try:
            estimate = self.estimate(problem, pi, _checks.generator(seed))
        except DivergentKernelError as divergence:
            return Estimate(float("nan"), status=str(divergence))
        if WEIGHTLESS in estimate.findings:
            return estimate
        warnings = from_diagnostics(
            estimate.diagnostics,
            estimate.value,
            estimate.standard_error,
            largest_reward(problem.model),
        )
        return replace(estimate, findings=(*warnings, *estimate.findings))

    def estimate(
        self, problem: Problem, policy: Array, generator: np.random.Generator
    ) -> Estimate:
        """Estimate the value of a checked policy, without the findings it leads to.

        Parameters
        ----------
        problem : Problem
            The simulator and the log.
        policy : ndarray of shape (S, A)
            The policy's probabilities.
        generator : numpy.random.Generator
            The source of whatever is drawn.

        Returns
        -------
        Estimate
            The value, without the findings that follow from its diagnostics.
        """
        raise NotImplementedError

    def limit(
        self,
        simulator: FiniteMDP,
        target: FiniteMDP,
        policy: PolicyLike,
        *,
        data_distribution: RealArrayLike | None = None,
        behavior_policy: PolicyLike | None = None,
        horizon: int | None = None,
    ) -> float:
        """Compute the exact limit of the estimated value as the log grows.

        Parameters
        ----------
        simulator : FiniteMDP
            The simulator.
        target : FiniteMDP
            The target, inside the simulator's support where there are data.
        policy : PolicyLike
            The policy to evaluate.
        data_distribution : array_like of shape (S, A), optional
            The share of the log's transitions in each state-action pair; None means
            evenly. Only its support matters, except for the quotient of two ratios and
            with features.
        behavior_policy : PolicyLike, optional
            The policy of the log's episodes; None means one that takes every action of
            ``policy``.
        horizon : int, optional
            The number of rewards; None means the infinite discounted sum.

        Returns
        -------
        float
            The limit, bias included; not normalised.

        Raises
        ------
        ValueError
            If target and simulator do not match, or if the target has transitions
            outside the simulator's support where there are data.
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
        """Compute the limit in a checked population.

        Parameters
        ----------
        population : Population
            Simulator, target, policy, horizon and how the data are recorded.

        Returns
        -------
        float
            The limit of the value; not normalised.
        """
        raise NotImplementedError


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
