"""What an estimator returns, and what an estimator is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from oee_tabular import _printing
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.estimators.diagnostics import DiagnosticsField
from oee_tabular.estimators.findings import Finding
from oee_tabular.estimators.problem import Problem
from oee_tabular.typing import PolicyLike, Seed

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
    bounds : tuple of (float, float), optional
        The least and the largest value that the rewards and the horizon make possible,
        where they are known. The interval that a report quotes ends there.

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
    bounds: tuple[float, float] | None = None

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
