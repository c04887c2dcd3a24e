"""The one interval that stands beside each value, and the value that stands inside it."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import NormalDist

from oee_tabular import _printing
from oee_tabular.estimators import Estimate
from oee_tabular.estimators.findings import NEVER_VARIED, Finding, no_value, outside
from oee_tabular.inference import Interval
from oee_tabular.inference.comparison import ENOUGH

NOISE, OWN = "standard error", "the estimator's own"
OWN_LEVEL = 0.95  # of the intervals that estimators set themselves


def choose_interval(estimate: Estimate, likelihood: Interval | None, level: float, scale: float = 1.0) -> Estimate:
    """The estimate with the interval to quote, a value inside it, and the findings that are to be told.

    A value that the log corrects has the likelihood interval, where there is one; outside of it stands no value: its nearer end
    takes its place (``replaced_value``, ``replaced_by``). Others have the estimator's own interval, at ``level``, or value plus
    or minus a normal quantile times the standard error, where that counts what matters: not below ``ENOUGH``, not where the
    variance is not known. ``diagnostics["interval_method"]`` names what it is. ``scale`` multiplies values in the findings.
    """
    if likelihood is not None and likelihood.status == "ok" and estimate.model_value is not None:
        chosen = _inside(estimate, likelihood, scale)
    else:
        chosen = _with_own_interval(estimate, level)
    lacks_interval = chosen.interval is None and (chosen.standard_error is not None or chosen.status == "ok")
    findings = [] if chosen.status == "ok" else [no_value(chosen.status, chosen.value)]
    for finding in chosen.findings:
        words = finding.alone if lacks_interval and finding.alone is not None else finding.text
        findings += [replace(finding, text=words, alone=None)] if words else []
    return replace(chosen, findings=tuple(findings))


def _with_own_interval(estimate: Estimate, level: float) -> Estimate:
    quantile = NormalDist().inv_cdf(0.5 + level / 2.0)
    if estimate.interval is not None:
        if not estimate.is_normal or level == OWN_LEVEL:
            return estimate
        factor = quantile / NormalDist().inv_cdf(0.5 + OWN_LEVEL / 2.0)
        lower, upper = (estimate.value + factor * (end - estimate.value) for end in estimate.interval)
        return replace(estimate, interval=(lower, upper))
    error, facts = estimate.standard_error, estimate.diagnostics
    if error is None or not math.isfinite(estimate.value) or estimate.measured < ENOUGH:
        return estimate
    if error <= 1e-12 * abs(estimate.value):  # 0, to roundoff: what does not vary has no error to show
        findings = (*estimate.findings, NEVER_VARIED)
        return replace(
            estimate, standard_error=None, diagnostics={"standard_error_of": "log"} | facts, findings=findings
        )
    ends = (estimate.value - quantile * error, estimate.value + quantile * error)
    return replace(estimate, interval=ends, diagnostics=facts | {"interval_method": NOISE})


def _inside(estimate: Estimate, likelihood: Interval, scale: float) -> Estimate:
    facts, value = estimate.diagnostics | {"interval_method": likelihood.method}, estimate.value
    room = 1e-9 * max(1.0, abs(likelihood.lower), abs(likelihood.upper))  # the ends are found by iteration
    if likelihood.lower - room <= value <= likelihood.upper + room:
        ends = (min(likelihood.lower, value), max(likelihood.upper, value))
        return replace(estimate, interval=ends, diagnostics=facts)
    end, which = (likelihood.lower, "lower") if value < likelihood.lower else (likelihood.upper, "upper")
    shown = format(value * scale, _printing.spec(likelihood.lower * scale, likelihood.upper * scale))
    return replace(
        estimate,
        value=end,
        interval=(likelihood.lower, likelihood.upper),
        diagnostics=facts | {"replaced_value": value, "replaced_by": f"the interval's {which} end"},
        findings=(*estimate.findings, outside(shown, abs(value - end), which)),
    )


def group_findings(
    findings: list[tuple[str, str, Finding]],
) -> list[tuple[str, frozenset[tuple[str, str]]]]:
    """One sentence per fact of (policy, estimator, finding), with the (policy, estimator) that it is about."""
    groups: dict[tuple[str, str], list[tuple[str, str, Finding]]] = {}
    for policy, estimator, finding in findings:
        groups.setdefault((finding.kind, finding.text), []).append((policy, estimator, finding))
    sentences = []
    for members in groups.values():
        policy, estimator, worst = max(members, key=lambda member: member[2].severity)
        by_policies: dict[tuple[str, ...], list[str]] = {}  # the policies it is said of -> the estimators
        for name in dict.fromkeys(member[1] for member in members):
            own = tuple(member[0] for member in members if member[1] == name)
            by_policies.setdefault(own, []).append(name)
        about = "; ".join(f"{', '.join(names)} ({', '.join(own)})" for own, names in by_policies.items())
        sentence = f"{about}: {worst}"
        if any(member[2].figure != worst.figure for member in members):
            several = len({member[0] for member in members}) > 1
            sentence += f" The figure is that of {policy if several else estimator}, the worst."
        sentences.append((sentence, frozenset(member[:2] for member in members)))
    return sentences
