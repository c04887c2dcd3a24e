"""The interval beside each value, how far the target is from the simulator, which
policy is best, what to record next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from scipy import special

from oee_tabular import _printing, _progress
from oee_tabular.design.advice import advice
from oee_tabular.estimators import Estimate, Estimator, OffEnvironment, Problem
from oee_tabular.estimators.findings import NEVER_VARIED, no_value, outside
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import (
    Comparison,
    Decision,
    Interval,
    compare_policies,
    interval,
)
from oee_tabular.inference.comparison import ENOUGH
from oee_tabular.inference.evidence import Evidence, gather
from oee_tabular.inference.robust import independent_radius
from oee_tabular.ratio import transition_ratio
from oee_tabular.report import text
from oee_tabular.typing import Array

# that can be reached: beyond, likelihood intervals take many minutes, and are left out
MAX_TRANSITIONS = 10_000_000
MIN_Z = 3.0  # of the test of all transitions together
# times the interval from the recorded transitions alone: from there on the report
# explains both
MUCH_WIDER = 1.5
# keys of intervals; shared: under a tie or features
LIKELIHOOD = "likelihood"
SHARED = "shared"
GUARANTEED: Final = "robust"
NOISE = "standard error"
OWN = "the estimator's own"
OWN_LEVEL = 0.95  # of the intervals that estimators set themselves


@dataclass(frozen=True, eq=False)
class Premises:
    """What the user knows about the target.

    ``lower_ratio`` and ``upper_ratio`` are a box around the simulator's probabilities,
    which narrows likelihood and guaranteed intervals. ``tie`` or ``features`` (as in
    ``transition_ratio``) add a row with the interval of their own model
    (``inference.likelihood``).
    """

    lower_ratio: float | None = None
    upper_ratio: float | None = None
    tie: Any = None
    features: Any = None

    def __post_init__(self) -> None:
        if self.tie is not None and self.features is not None:
            raise ValueError(
                "tie and features must not be given together: they are two different"
                " models"
            )

    @property
    def box(self) -> dict[str, Any]:
        """The box, as ``interval`` takes it."""
        return {"lower_ratio": self.lower_ratio, "upper_ratio": self.upper_ratio}

    def __str__(self) -> str:
        """The box in words; "" without one."""
        if self.lower_ratio is None and self.upper_ratio is None:
            return ""
        lower = self.lower_ratio or 0.0
        upper = "any number of" if self.upper_ratio is None else f"{self.upper_ratio:g}"
        return (
            f"assumed between {lower:g} and {upper} times the simulator's probabilities"
        )

    @property
    def estimators(self) -> dict[str, Estimator]:
        """The estimator that rests on the tie or the features, by name."""
        if self.tie is not None:
            return {
                "oee-tied": OffEnvironment(
                    partial(transition_ratio, method="tied", tie=self.tie)
                )
            }
        if self.features is not None:
            return {
                "oee-features": OffEnvironment(
                    partial(transition_ratio, prior="tilt", features=self.features)
                )
            }
        return {}

    def intervals(
        self, problem: Problem, policy: Array, level: float, *, guaranteed: bool
    ) -> dict[str, Interval]:
        """The intervals of a policy by method; a ValueError where the log contradicts
        the box, with the pairs.
        """
        result = {LIKELIHOOD: interval(problem, policy, confidence=level, **self.box)}
        if str(self) and result[LIKELIHOOD].status != "ok":
            raise ValueError(
                "lower_ratio and upper_ratio must fit the log:"
                f" {result[LIKELIHOOD].status}"
            )
        if guaranteed:
            result[GUARANTEED] = interval(
                problem, policy, method=GUARANTEED, confidence=level, **self.box
            )
        if self.estimators:
            result[SHARED] = interval(
                problem, policy, tie=self.tie, features=self.features, confidence=level
            )
        return result


@dataclass(frozen=True)
class Uncertainty:
    """How sure the log makes the values of policies.

    Attributes
    ----------
    intervals : of each policy, by method
    distance : sentences on how far the target is from the simulator, and why there are
        no likelihood intervals
    policies : sentences on the interval of each policy, where there is something to say
    comparison : of the policies; its intervals of all differences from the best hold at
        once
    decision : which policy is best, as far as the log can say
    ranking : the sentence about it; "" of a single policy
    next : the sentence on what to record next
    caveat : a warning before any value; "" where there is nothing
    """

    intervals: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)
    distance: tuple[str, ...] = ()
    policies: Mapping[str, str] = field(default_factory=dict)
    comparison: Comparison | None = None
    decision: Decision | None = None
    ranking: str = ""
    next: str = ""
    caveat: str = ""

    @property
    def likelihood(self) -> dict[str, Interval]:
        """The likelihood interval of each policy that has one."""
        intervals = {
            name: methods[LIKELIHOOD]
            for name, methods in self.intervals.items()
            if LIKELIHOOD in methods
        }
        return {name: one for name, one in intervals.items() if one.status == "ok"}

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a report says below its table."""
        about = (
            f"{name}: {sentence}"
            for name, sentence in self.policies.items()
            if sentence
        )
        return (*self.distance, *about, *filter(None, (self.ranking, self.next)))


# before the values


def find_intervals(
    problem: Problem,
    policies: Mapping[str, Array],
    level: float,
    known: Premises,
    *,
    guaranteed: bool,
    quick: bool,
) -> Uncertainty:
    """Test the simulator against the log and compute the intervals of every policy, or
    say why there are none.
    """
    if problem.soft:
        if guaranteed:
            reason = "soft counts are no independent transitions"
            raise ArgumentError(
                "guaranteed", f"must be False where counts are given: {reason}"
            )
        return Uncertainty(distance=(text.SOFT,))
    evidence = gather(problem, next(iter(policies.values())))
    lacking = _reason_without_intervals(problem, evidence, quick=quick)
    distance = (_test_simulator(evidence),)
    del evidence  # as much memory as the simulator
    if lacking:
        if guaranteed:
            raise ArgumentError("guaranteed", f"must be False here: {lacking}")
        return Uncertainty(distance=(*distance, text.MISSING_INTERVALS.format(lacking)))
    intervals = {}
    for i, (name, policy) in enumerate(policies.items()):
        _progress.report_step(
            f"likelihood interval of “{name}” (policy {i + 1} of {len(policies)})"
        )
        intervals[name] = known.intervals(problem, policy, level, guaranteed=guaranteed)
    return Uncertainty(intervals, distance)


def _reason_without_intervals(
    problem: Problem, evidence: Evidence, *, quick: bool
) -> str:
    """Why there are no likelihood intervals; "" where there are."""
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        return "at discount 1 they need a horizon"
    if quick:
        return "quick=True (--quick) leaves them out"
    if len(evidence.phat) > MAX_TRANSITIONS:
        reachable = int(np.diff(evidence.rows.indptr)[evidence.reachable].sum())
        if reachable > MAX_TRANSITIONS:
            return (
                f"{reachable} transitions can be reached, more than {MAX_TRANSITIONS}"
            )
    return ""


def _test_simulator(evidence: Evidence) -> str:
    """In how many pairs the counts reject the simulator, and whether all transitions
    together do.

    The pairs' tests are KL balls that hold at any number of transitions, sharing 5%.
    The test of all together is the score test of the tilt along log P: sum (n - n_sa P)
    log P over its standard deviation under P.
    """
    tested = (evidence.n > 0) & evidence.open_rows
    n_tested = int(tested.sum())
    if n_tested == 0:
        return text.NOT_TESTED
    rows = evidence.rows.select(tested)
    n = evidence.n[tested]
    phat = evidence.phat[rows.entries]
    kl = rows.sums(special.rel_entr(phat, rows.weights))
    rejected = int(
        (kl > independent_radius(n, np.diff(rows.indptr), 0.05 / n_tested)).sum()
    )
    if rejected:
        return text.pair_rejections(rejected, n_tested)
    phi = rows.center(np.log(rows.weights))
    score = float(np.sum(rows.spread(n) * (phat - rows.weights) * phi))
    spread = float(np.sum(rows.spread(n) * rows.weights * phi**2))
    z = score / np.sqrt(spread) if spread > 0 else 0.0
    return text.agreement(n_tested) if abs(z) < MIN_Z else text.joint_rejection(z)


def descending_key(value: float) -> float:
    """A key that sorts values from the largest, those that are not finite last."""
    return -value if math.isfinite(value) else math.inf


# the one interval that stands beside each value, and the value that stands inside it


def choose_interval(
    estimate: Estimate, likelihood: Interval | None, level: float, scale: float = 1.0
) -> Estimate:
    """The estimate with the interval to quote, a value inside it, and the findings to
    print.

    A value that the log corrects has the likelihood interval, where there is one;
    outside of it stands no value: its nearer end takes its place (``replaced_value``,
    ``replaced_by``). Others have the estimator's own interval, at ``level``, or value
    plus or minus a normal quantile times the standard error, where that counts what
    matters: not below ``ENOUGH``, not where the variance is not known.
    ``diagnostics["interval_method"]`` names what it is. ``scale`` multiplies values in
    the findings.
    """
    is_corrected = estimate.model_value is not None and not math.isnan(estimate.value)
    if is_corrected and likelihood is not None and likelihood.status == "ok":
        chosen = _put_inside(estimate, likelihood, scale)
    else:
        chosen = _with_own_interval(estimate, level)
    lacks_interval = chosen.interval is None and (
        chosen.standard_error is not None or chosen.status == "ok"
    )
    findings = [] if chosen.status == "ok" else [no_value(chosen.status, chosen.value)]
    for finding in chosen.findings:
        words = (
            finding.alone
            if lacks_interval and finding.alone is not None
            else finding.text
        )
        findings += [replace(finding, text=words, alone=None)] if words else []
    return replace(chosen, findings=tuple(findings))


def _with_own_interval(estimate: Estimate, level: float) -> Estimate:
    quantile = NormalDist().inv_cdf(0.5 + level / 2.0)
    value = estimate.value
    error = estimate.standard_error
    facts = estimate.diagnostics
    if estimate.interval is not None:
        if not estimate.is_normal or level == OWN_LEVEL:
            return estimate
        factor = quantile / NormalDist().inv_cdf(0.5 + OWN_LEVEL / 2.0)
        lower, upper = (value + factor * (end - value) for end in estimate.interval)
        return replace(estimate, interval=(lower, upper))
    if error is None or not math.isfinite(value) or estimate.measured < ENOUGH:
        return estimate
    # 0, to roundoff: what does not vary has no error to show
    if error <= 1e-12 * abs(value):
        findings = (*estimate.findings, NEVER_VARIED)
        facts = {"standard_error_of": "log"} | facts
        return replace(
            estimate, standard_error=None, diagnostics=facts, findings=findings
        )
    ends = (value - quantile * error, value + quantile * error)
    return replace(
        estimate, interval=ends, diagnostics=facts | {"interval_method": NOISE}
    )


def _put_inside(estimate: Estimate, likelihood: Interval, scale: float) -> Estimate:
    lower = likelihood.lower
    upper = likelihood.upper
    value = estimate.value
    facts = estimate.diagnostics | {"interval_method": likelihood.method}
    room = 1e-9 * max(1.0, abs(lower), abs(upper))  # the ends are found by iteration
    if lower - room <= value <= upper + room:
        return replace(
            estimate, interval=(min(lower, value), max(upper, value)), diagnostics=facts
        )
    end, which = (lower, "lower") if value < lower else (upper, "upper")
    shown = format(value * scale, _printing.spec(lower * scale, upper * scale))
    return replace(
        estimate,
        value=end,
        interval=(lower, upper),
        diagnostics=facts
        | {
            "replaced_value": value,
            "replaced_by": f"the interval's {which} end",
        },
        findings=(*estimate.findings, outside(shown, abs(value - end), which)),
    )


# after the values: which policy is best, what to record next


def add_comparison(
    found: Uncertainty,
    problem: Problem,
    policies: Mapping[str, Array],
    level: float,
    known: Premises,
    front: Mapping[str, Estimate],
    scale: float,
) -> Uncertainty:
    """Compare the policies; say what the intervals assume, which policy is best, and
    what to record next.

    ``front`` are the estimates that stand in front; ``scale`` multiplies values in the
    sentences.
    """
    _progress.report_step("comparison of the policies, and what to record next")
    about = {
        name: _describe(methods, front[name].diagnostics.get("coverage"), scale)
        for name, methods in found.intervals.items()
    }
    values = {name: estimate.value for name, estimate in front.items()}
    has_ranking = len(values) > 1 and any(map(math.isfinite, values.values()))
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        return replace(
            found, policies=about, ranking=text.NEEDS_HORIZON if has_ranking else ""
        )
    comparison = None
    decision = None
    ranking = ""
    if len(values) > 1:
        # all differences from the best hold at once
        each = 1.0 - (1.0 - level) / (len(values) - 1)
        comparison = compare_policies(problem, policies, confidence=each, **known.box)
    if comparison is not None and has_ranking:
        decision = comparison.decide(values, found.likelihood)
        ranking = _rank(decision, values, found.likelihood, level, scale)
    advised = advice(problem, policies, level)
    return replace(
        found,
        policies=about,
        comparison=comparison,
        decision=decision,
        ranking=ranking,
        next=advised,
    )


def _rank(
    decision: Decision,
    values: Mapping[str, float],
    likelihood: Mapping[str, Interval],
    level: float,
    scale: float,
) -> str:
    """Say which policy is best, and by how much it is better than the next."""
    if decision.margin is None:
        return text.no_best_policy(
            decision.candidates, len(values), are_equal=decision.are_equal
        )
    best, following = sorted(values, key=lambda name: descending_key(values[name]))[:2]
    ours = likelihood.get(best)
    theirs = likelihood.get(following)
    overlap = ours is None or theirs is None or ours.lower <= theirs.upper
    difference, lower, upper = (scale * x for x in decision.margin)
    return text.best_policy(
        best, following, len(values), (difference, lower, upper), level, overlap=overlap
    )


def _describe(
    intervals: Mapping[str, Interval], coverage: float | None, scale: float
) -> str:
    """What the intervals of a policy assume; ``coverage`` is the share of the policy's
    time that the log covers.
    """
    quoted = intervals[LIKELIHOOD]
    if quoted.status != "ok":
        return f"{quoted.status}."
    dropped = bool(quoted.diagnostics.get("dropped_transitions", 0.0))
    unrecorded = int(quoted.diagnostics["unrecorded_pairs"])
    sentences = [
        text.worst_case(
            unrecorded, None if coverage is None else 1.0 - coverage, dropped=dropped
        )
    ]
    if quoted.sampling is not None and quoted.width > MUCH_WIDER * (
        quoted.sampling[1] - quoted.sampling[0]
    ):
        lower, upper = (end * scale for end in quoted.sampling)
        sentences.append(text.sampling_interval(lower, upper, unrecorded=unrecorded))
    if GUARANTEED in intervals:
        ends = text.format_interval(
            scale * intervals[GUARANTEED].lower, scale * intervals[GUARANTEED].upper
        )
        sentences.append(text.INTERVAL_AT_ANY_SIZE.format(ends))
    return " ".join(filter(None, sentences))
