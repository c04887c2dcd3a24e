"""The one interval that stands beside each value, the value that stands inside it, and where the value comes from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import NormalDist
from typing import Any

from oee_tabular import _printing
from oee_tabular._checks import Array
from oee_tabular.estimators import Estimate, ModelBased, Problem
from oee_tabular.inference import Interval
from oee_tabular.sureness import ENOUGH

LIKELIHOOD, NOISE, OWN = "likelihood", "standard error", "the estimator's own"
METHODS: Mapping[str, str] = {
    LIKELIHOOD: "every value in keeping with the log; where it has nothing, any move that the simulator makes is possible",
    "one-step": "value plus or minus normal quantile x standard error, to which pairs never recorded add as if recorded once",
    OWN: "as the estimator gives it",
    NOISE: "value plus or minus normal quantile x standard error: the noise of the log, or of the rollouts, alone",
}
_OWN_LEVEL = 0.95  # of the intervals that estimators set themselves


def corrected(estimate: Estimate) -> bool:
    """Whether it is the exact value of a model zeta * P, rows summing to 1, whatever it is called."""
    return {"row_sum_error", "coverage"} <= estimate.diagnostics.keys()


def quoted(estimate: Estimate, sure: Interval | None, problem: Problem, policy: Array, level: float) -> Estimate:
    """The estimate with the interval to quote, and a value inside it.

    A value that the log corrects has the likelihood interval ``sure``, where there is one; outside of it stands no value: the
    one-step value takes its place, or else maximum likelihood's (``replaced_value``, ``replaced_by``). Others have the
    estimator's own interval, at ``level``, or value plus or minus a normal quantile times the standard error, where that
    counts what matters: not below ``ENOUGH``, not where the variance is not known.
    ``diagnostics["interval_method"]`` names what it is.
    """
    facts = estimate.diagnostics
    if sure is not None and sure.status == "ok" and corrected(estimate):
        return _inside(estimate, sure, problem, policy)
    quantile = NormalDist().inv_cdf(0.5 + level / 2.0)
    if estimate.interval is not None:
        if "interval_method" not in facts or level == _OWN_LEVEL:
            return estimate
        factor = quantile / NormalDist().inv_cdf(0.5 + _OWN_LEVEL / 2.0)
        lower, upper = (estimate.value + factor * (end - estimate.value) for end in estimate.interval)
        return replace(estimate, interval=(lower, upper))
    error = estimate.standard_error
    if error is None or not math.isfinite(estimate.value) or _measured(facts) < ENOUGH:
        return estimate
    if error <= 1e-12 * abs(estimate.value):  # 0, to roundoff: what does not vary has no error to show
        return replace(estimate, standard_error=None, diagnostics={"standard_error_of": "log"} | facts)
    ends = (estimate.value - quantile * error, estimate.value + quantile * error)
    return replace(estimate, interval=ends, diagnostics=facts | {"interval_method": NOISE})


def _measured(facts: Mapping[str, Any]) -> float:
    """The share of the policy's time in state-action pairs whose variance the log tells; 1 where that has no meaning."""
    return float(facts.get("coverage", 1.0) - facts.get("single_share", 0.0))


def _inside(estimate: Estimate, sure: Interval, problem: Problem, policy: Array) -> Estimate:
    facts, value = estimate.diagnostics | {"interval_method": LIKELIHOOD}, estimate.value
    room = 1e-9 * max(1.0, abs(sure.lower), abs(sure.upper))  # the ends are found by iteration
    low, high = sure.lower - room, sure.upper + room
    if not low <= value <= high:
        facts |= {"replaced_value": value, "replaced_by": "the one-step value"}
        value = facts.get("one_step_value", math.nan)
    if not low <= value <= high:
        facts["replaced_by"] = "the maximum-likelihood value"
        value = ModelBased(fallback="simulator")(problem, policy).value
    ends = (min(sure.lower, value), max(sure.upper, value))
    return replace(estimate, value=value, interval=ends, diagnostics=facts)


def way(estimates: Mapping[str, Estimate], simulator: float, scale: float) -> str:
    """How the values that the log corrects, by estimator, move from the ``simulator``'s, and where they were left."""
    told = {name: _steps(estimate, scale) for name, estimate in estimates.items() if corrected(estimate)}
    if not told:
        return ""
    listed = ": " + "; ".join(f"{name} {text}" for name, text in told.items())
    said = listed if len(told) > 1 else f" {next(iter(told.values()))}"
    return f"The simulator says {simulator * scale:.4g}; corrected by the log{said}."


def _steps(estimate: Estimate, scale: float) -> str:
    facts = estimate.diagnostics
    form = ".4g" if estimate.interval is None else _printing.spec(*(end * scale for end in estimate.interval))
    show = {name: format(x * scale, form) for name, x in facts.items() if name in VALUES}
    value = format(estimate.value * scale, form)
    steps = [f"exact value of zeta * P {show.get('model_value', show.get('replaced_value', value))}"]
    if "one_step_value" in facts:
        steps.append(f"one-step {show['one_step_value']}")
        steps.append(f"moved {facts.get('moved', 0.0):.0%}")
    if "replaced_by" in facts:
        steps[-1] += f" to {show['replaced_value']}" if "one_step_value" in facts else ""
        steps[-1] += f": outside the interval, so this is {facts['replaced_by']}"
    return f"{value} ({', '.join(steps)})"


VALUES = frozenset(  # diagnostics that are values, or errors of values
    (
        "simulator_value", "model_value", "one_step_value", "one_step_standard_error", "unseen_standard_error",
        "maximum_likelihood_value", "standard_error_if_centre_fits", "replaced_value", "truncation_bias_bound", "error_bound",
    )
)  # fmt: skip
