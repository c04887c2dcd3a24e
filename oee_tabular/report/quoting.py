"""The one interval that stands beside each value, the value that stands inside it, and where the value comes from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import NormalDist

from oee_tabular import _printing
from oee_tabular.estimators import Estimate
from oee_tabular.estimators.findings import NEVER_VARIED, Finding, no_value, outside
from oee_tabular.inference import Interval
from oee_tabular.inference.comparison import ENOUGH

LIKELIHOOD, NOISE, OWN = "likelihood", "standard error", "the estimator's own"
METHODS: Mapping[str, str] = {
    LIKELIHOOD: "every value in keeping with the log; where it has nothing, any move that the simulator makes is possible",
    "likelihood under the tie": "every value of the tied model in keeping with the log; transitions of one key change alike",
    "likelihood under the features": "every value of the model in keeping with the log; rows change along the features alone",
    "one-step": "value plus or minus normal quantile x standard error, to which pairs never recorded add as if recorded once",
    "refits": "value plus or minus t quantile x standard error, by refits on resampled episodes and the rollouts' own",
    "calibrated": "value plus or minus normal quantile x standard error, in which the gap between two calibrations counts",
    "simulator's samples": "value plus or minus normal quantile x standard error: the simulator's sampling, not the target",
    OWN: "as the estimator gives it",
    NOISE: "value plus or minus normal quantile x standard error: the noise of the log, or of the rollouts, alone",
}
_OWN_LEVEL = 0.95  # of the intervals that estimators set themselves


def quoted(estimate: Estimate, sure: Interval | None, level: float, scale: float = 1.0) -> Estimate:
    """The estimate with the interval to quote, a value inside it, and the findings that are to be told.

    A value that the log corrects has the likelihood interval ``sure``, where there is one; outside of it stands no value: its
    nearer end takes its place (``replaced_value``, ``replaced_by``). Others have the
    estimator's own interval, at ``level``, or value plus or minus a normal quantile times the standard error, where that
    counts what matters: not below ``ENOUGH``, not where the variance is not known.
    ``diagnostics["interval_method"]`` names what it is. ``scale`` multiplies values in the findings.
    """
    if sure is not None and sure.status == "ok" and estimate.model_value is not None:
        found = _inside(estimate, sure, scale)
    else:
        found = _with_own_interval(estimate, level)
    lacking = found.interval is None and (found.standard_error is not None or found.status == "ok")
    told = [] if found.status == "ok" else [no_value(found.status, found.value)]
    for finding in found.findings:
        text = finding.alone if lacking and finding.alone is not None else finding.text
        told += [replace(finding, text=text, alone=None)] if text else []
    return replace(found, findings=tuple(told))


def _with_own_interval(estimate: Estimate, level: float) -> Estimate:
    quantile = NormalDist().inv_cdf(0.5 + level / 2.0)
    if estimate.interval is not None:
        if not estimate.is_normal or level == _OWN_LEVEL:
            return estimate
        factor = quantile / NormalDist().inv_cdf(0.5 + _OWN_LEVEL / 2.0)
        lower, upper = (estimate.value + factor * (end - estimate.value) for end in estimate.interval)
        return replace(estimate, interval=(lower, upper))
    error, facts = estimate.standard_error, estimate.diagnostics
    if error is None or not math.isfinite(estimate.value) or estimate.measured < ENOUGH:
        return estimate
    if error <= 1e-12 * abs(estimate.value):  # 0, to roundoff: what does not vary has no error to show
        told = (*estimate.findings, NEVER_VARIED)
        return replace(estimate, standard_error=None, diagnostics={"standard_error_of": "log"} | facts, findings=told)
    ends = (estimate.value - quantile * error, estimate.value + quantile * error)
    return replace(estimate, interval=ends, diagnostics=facts | {"interval_method": NOISE})


def _inside(estimate: Estimate, sure: Interval, scale: float) -> Estimate:
    facts, value = estimate.diagnostics | {"interval_method": sure.method}, estimate.value
    room = 1e-9 * max(1.0, abs(sure.lower), abs(sure.upper))  # the ends are found by iteration
    low, high = sure.lower - room, sure.upper + room
    if low <= value <= high:
        ends = (min(sure.lower, value), max(sure.upper, value))
        return replace(estimate, interval=ends, diagnostics=facts)
    end, by = (sure.lower, "lower") if value < low else (sure.upper, "upper")
    shown = format(value * scale, _printing.spec(sure.lower * scale, sure.upper * scale))
    return replace(
        estimate,
        value=end,
        interval=(sure.lower, sure.upper),
        diagnostics=facts | {"replaced_value": value, "replaced_by": f"the interval's {by} end"},
        findings=(*estimate.findings, outside(shown, abs(value - end), by)),
    )


def sentences(told: list[tuple[str, str, Finding]]) -> list[tuple[str, frozenset[tuple[str, str]]]]:
    """One sentence per fact of (policy, estimator, finding), with the pairs that it is about."""
    groups: dict[tuple[str, str], list[tuple[str, str, Finding]]] = {}
    for policy, estimator, finding in told:
        groups.setdefault((finding.kind, finding.text), []).append((policy, estimator, finding))
    found = []
    for members in groups.values():
        policy, estimator, worst = max(members, key=lambda member: member[2].severity)
        by_policies: dict[tuple[str, ...], list[str]] = {}  # the policies it is said of -> the estimators
        for name in dict.fromkeys(member[1] for member in members):
            own = tuple(member[0] for member in members if member[1] == name)
            by_policies.setdefault(own, []).append(name)
        about = "; ".join(f"{', '.join(names)} ({', '.join(own)})" for own, names in by_policies.items())
        figure = worst.figure
        if any(member[2].figure != figure for member in members):
            several = len({member[0] for member in members}) > 1
            figure += f" ({policy if several else estimator} is the worst)"
        found.append((f"{about}: {worst.sentence(figure)}", frozenset(member[:2] for member in members)))
    return found


def way(estimates: Mapping[str, Estimate], simulator: float, scale: float) -> str:
    """What the ``simulator`` says, and the values that the log corrects, by estimator."""
    corrected = {name: estimate for name, estimate in estimates.items() if estimate.model_value is not None}
    if not corrected:
        return ""
    values = [f"{name} {_show(estimate, scale)}" for name, estimate in corrected.items()]
    if len(values) == 1:
        values = [_show(estimate, scale) for estimate in corrected.values()]
    return f"The simulator says {simulator * scale:.4g}. Corrected by the log: {'; '.join(values)}."


def _show(estimate: Estimate, scale: float) -> str:
    """The value, to the digits that its interval carries."""
    form = ".4g" if estimate.interval is None else _printing.spec(*(end * scale for end in estimate.interval))
    return format(estimate.value * scale, form)
