"""How far the target is from the simulator, the interval of each value, which policy is best, and what to record next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import special

from oee_tabular import _progress
from oee_tabular._checks import Array
from oee_tabular.design.advice import advice
from oee_tabular.estimators import Estimate, Problem
from oee_tabular.inference import Comparison, Decision, Interval, compare_policies
from oee_tabular.inference.evidence import Evidence, gather
from oee_tabular.inference.robust import independent_radius
from oee_tabular.report import text
from oee_tabular.report.assumptions import Assumptions

MAX_TRANSITIONS = (
    10_000_000  # that can be reached: beyond, the likelihood interval is left out, since it takes many minutes
)
MIN_Z = 3.0  # of the test of all transitions together
MUCH_WIDER = 1.5  # times the interval from the recorded transitions alone: from there on the report explains both
LIKELIHOOD, GUARANTEED, SHARED = "likelihood", "robust", "shared"  # keys of intervals; shared: under a tie or features


@dataclass(frozen=True)
class Uncertainty:
    """How sure the log makes the values of policies.

    Attributes
    ----------
    intervals : of each policy, by method
    distance : sentences on how far the target is from the simulator, and why there are no likelihood intervals
    policies : sentences on the interval of each policy, where there is something to say
    comparison : of the policies; its intervals of all differences from the best hold at once
    decision : which policy is best, as far as the log can say
    ranking : the sentence about it; "" of a single policy
    next : the sentence on what to record next
    """

    intervals: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)
    distance: tuple[str, ...] = ()
    policies: Mapping[str, str] = field(default_factory=dict)
    comparison: Comparison | None = None
    decision: Decision | None = None
    ranking: str = ""
    next: str = ""

    @property
    def likelihood(self) -> dict[str, Interval]:
        """The likelihood interval of each policy that has one."""
        found = {name: methods.get(LIKELIHOOD) for name, methods in self.intervals.items()}
        return {name: one for name, one in found.items() if one is not None and one.status == "ok"}

    @property
    def best(self) -> str | None:
        """The best policy; None where the log cannot say, or several are worth the same."""
        return None if self.decision is None else self.decision.best

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a report says below its table."""
        about = (f"{name}: {sentence}" for name, sentence in self.policies.items() if sentence)
        return (*self.distance, *about, *filter(None, (self.ranking, self.next)))

    def records(self, scale: float) -> list[dict[str, Any]]:
        """The intervals as plain rows; ``scale`` multiplies values."""
        return [
            {
                "policy": policy,
                "method": method,
                "lower": found.lower * scale,
                "upper": found.upper * scale,
                **sampling_columns(found, scale),
                "confidence": found.confidence,
                "status": found.status,
            }
            for policy, methods in self.intervals.items()
            for method, found in methods.items()
        ]


def sampling_columns(found: Interval | None, scale: float) -> dict[str, float | None]:
    """The interval from the recorded transitions alone, as columns of a table; None where there is none."""
    lower, upper = (None, None) if found is None or found.sampling is None else found.sampling
    return {
        "sampling_lower": None if lower is None else lower * scale,
        "sampling_upper": None if upper is None else upper * scale,
    }


def assess(
    problem: Problem,
    policies: Mapping[str, Array],
    confidence: float,
    *,
    guaranteed: bool = False,
    quick: bool = False,
    assumed: Assumptions | None = None,
) -> Uncertainty:
    """Compute intervals of every policy, the test of the simulator, the comparison, and what to record next.

    ``with_values`` adds the sentences that need the values.
    """
    assumed = assumed or Assumptions()
    if problem.soft and guaranteed:
        raise ValueError("guaranteed must be False where counts are given: soft counts are no independent transitions")
    evidence = gather(problem, next(iter(policies.values())))
    is_endless = problem.simulator.discount == 1.0 and problem.horizon is None
    lacking = _reason_without_intervals(evidence, is_endless=is_endless, quick=quick)
    if lacking and guaranteed:
        raise ValueError(f"guaranteed must be False here: {lacking}")
    distance = [text.SOFT if problem.soft else _test_simulator(evidence)]
    if lacking and not problem.soft:
        distance.append(text.missing_intervals(lacking))
    del evidence  # as much memory as the simulator
    intervals: dict[str, dict[str, Interval]] = {}
    for i, (name, policy) in enumerate({} if lacking or problem.soft else policies.items()):
        _progress.report_step(f"likelihood interval of “{name}” (policy {i + 1} of {len(policies)})")
        methods = (LIKELIHOOD, GUARANTEED) if guaranteed else (LIKELIHOOD,)
        intervals[name] = {m: assumed.interval(problem, policy, method=m, confidence=confidence) for m in methods}
        if (shared := assumed.model_interval(problem, policy, confidence)) is not None:
            intervals[name][SHARED] = shared
    _progress.report_step("comparison of the policies, and what to record next")
    comparison = None
    if len(policies) > 1 and not is_endless:
        each = 1.0 - (1.0 - confidence) / (len(policies) - 1)  # all differences from the best hold at once
        comparison = compare_policies(problem, policies, confidence=each, **assumed.box)
    return Uncertainty(
        intervals,
        tuple(distance),
        comparison=comparison,
        next="" if is_endless else advice(problem, policies, confidence),
    )


def with_values(uncertainty: Uncertainty, shown: Mapping[str, Estimate], scale: float = 1.0) -> Uncertainty:
    """Add what the intervals assume and which policy is best; ``shown`` are the estimates in front.

    ``scale`` multiplies values in the sentences (1 - discount for normalised reports).
    """
    about = {
        name: _describe(found, shown[name].diagnostics.get("coverage"), scale)
        for name, found in uncertainty.intervals.items()
    }
    uncertainty = replace(uncertainty, policies=about)
    values = {name: estimate.value for name, estimate in shown.items()}
    if len(values) < 2 or not any(math.isfinite(value) for value in values.values()):
        return uncertainty
    if uncertainty.comparison is None:
        return replace(uncertainty, ranking=text.NEEDS_HORIZON)
    decision = uncertainty.comparison.decide(values, uncertainty.likelihood)
    if decision.best is None or decision.margin is None:
        ranking = text.no_best_policy(decision.candidates, len(values), are_equal=decision.are_equal)
        return replace(uncertainty, decision=decision, ranking=ranking)
    best, following = sorted(values, key=lambda name: -values[name] if math.isfinite(values[name]) else math.inf)[:2]
    ours, theirs = (uncertainty.likelihood.get(name) for name in (best, following))
    difference, lower, upper = (scale * x for x in decision.margin)
    ranking = text.best_policy(
        best, following, len(values), (difference, lower, upper),
        1.0 - (len(values) - 1) * (1.0 - uncertainty.comparison.confidence),
        overlap=ours is None or theirs is None or ours.lower <= theirs.upper,
    )  # fmt: skip
    return replace(uncertainty, decision=decision, ranking=ranking)


def _reason_without_intervals(evidence: Evidence, *, is_endless: bool, quick: bool) -> str:
    """Why there are no likelihood intervals; "" where there are."""
    if is_endless:
        return "at discount 1 they need a horizon"
    if quick:
        return "quick=True (--quick) leaves them out"
    if len(evidence.phat) > MAX_TRANSITIONS:
        reachable = int(np.diff(evidence.rows.indptr)[evidence.reachable].sum())
        if reachable > MAX_TRANSITIONS:
            return f"{reachable} transitions can be reached, more than {MAX_TRANSITIONS}"
    return ""


def _test_simulator(evidence: Evidence) -> str:
    """In how many pairs the counts reject the simulator, and whether all transitions together do.

    The pairs' tests are KL balls that hold at any number of transitions, sharing 5%. The test of all together is the score test
    of the tilt along log P: sum (n - n_sa P) log P over its standard deviation under P.
    """
    tested = (evidence.n > 0) & evidence.open_rows
    n_tested = int(tested.sum())
    if n_tested == 0:
        return text.NOT_TESTED
    rows = evidence.rows.select(tested)
    n, phat = evidence.n[tested], evidence.phat[rows.entries]
    kl = rows.sums(special.rel_entr(phat, rows.weights))
    rejected = int((kl > independent_radius(n, np.diff(rows.indptr), 0.05 / n_tested)).sum())
    if rejected:
        return text.pair_rejections(rejected, n_tested)
    phi = rows.center(np.log(rows.weights))
    score = float(np.sum(rows.spread(n) * (phat - rows.weights) * phi))
    spread = float(np.sum(rows.spread(n) * rows.weights * phi**2))
    z = score / np.sqrt(spread) if spread > 0 else 0.0
    return text.agreement(n_tested) if abs(z) < MIN_Z else text.joint_rejection(z)


def _describe(found: Mapping[str, Interval], coverage: float | None, scale: float) -> str:
    """What the intervals of a policy assume; ``coverage`` is the share of the policy's time that the log covers."""
    quoted = found[LIKELIHOOD]
    if quoted.status != "ok":
        return f"{quoted.status}."
    dropped = bool(quoted.diagnostics.get("dropped_moves", 0.0))
    unrecorded = int(quoted.diagnostics["unvisited_rows"])
    told = [text.worst_case(unrecorded, None if coverage is None else 1.0 - coverage, dropped=dropped)]
    if quoted.sampling is not None and quoted.width > MUCH_WIDER * (quoted.sampling[1] - quoted.sampling[0]):
        lower, upper = (end * scale for end in quoted.sampling)
        told.append(text.sampling_interval(lower, upper, unrecorded=unrecorded))
    if GUARANTEED in found:
        told.append(text.interval_at_any_size(found[GUARANTEED].lower * scale, found[GUARANTEED].upper * scale))
    return " ".join(filter(None, told))
