"""How far the target is from the simulator, how sure the log makes each value, and what to record next: in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Any, Literal

import numpy as np
from scipy import special

from oee_tabular import _printing, _progress
from oee_tabular._checks import Array
from oee_tabular.design.advice import advice
from oee_tabular.estimators import Problem
from oee_tabular.inference import Comparison, Decision, Interval, compare_policies
from oee_tabular.inference.evidence import Evidence, gather
from oee_tabular.inference.robust import independent_radius
from oee_tabular.report.assumptions import Assumptions

LARGEST = 10_000_000  # reachable moves beyond which the likelihood interval is left out: it takes many minutes

SOFT = (
    "The counts were given beside the log: tests of the simulator and likelihood intervals, which need whole and independent "
    "moves, are left out."
)
MORE_PRECISE = " The difference is known more precisely than either value because both rest on the same transitions."
MUCH_WIDER = 1.5  # times the interval from the recorded transitions alone: from there on the report explains both
SHARED = "shared"  # the key of the interval under a tie or features


@dataclass(frozen=True)
class Sureness:
    """How sure the log makes the values of policies.

    Attributes
    ----------
    intervals : of each policy, by method
    distance : how far the target is from the simulator, and why there are no likelihood intervals where there are none
    policies : what there is to say of each policy
    ranking : which policy is worth most, if the log can say so; "" of a single one
    best : that policy; None where the log cannot say, or several are worth the same
    next : the one piece of advice for the next recording
    """

    intervals: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)
    distance: tuple[str, ...] = ()
    policies: Mapping[str, str] = field(default_factory=dict)
    ranking: str = ""
    best: str | None = None
    next: str = ""
    comparison: Comparison | None = None

    @property
    def likelihood(self) -> dict[str, Interval]:
        """The likelihood interval of each policy that has one."""
        found = {name: methods.get("likelihood") for name, methods in self.intervals.items()}
        return {name: one for name, one in found.items() if one is not None and one.status == "ok"}

    @property
    def sentences(self) -> tuple[str, ...]:
        """What ends a report."""
        told = (f"{name}: {text}" for name, text in self.policies.items() if text)
        return (*self.distance, *told, *filter(None, (self.ranking, self.next)))


def how_sure(
    problem: Problem,
    policies: Mapping[str, Array],
    confidence: float,
    *,
    guaranteed: bool,
    scale: float,
    quick: bool = False,
    assumed: Assumptions | None = None,
) -> Sureness:
    """Likelihood intervals (and guaranteed ones) of every policy; distance, width and the next (s, a) in words.

    ``scale`` multiplies values in the sentences (1 - discount for normalised reports). ``ranking`` is left to ``ranked``, which
    needs the values.
    """
    soft, assumed = problem.soft, assumed or Assumptions()
    if soft and guaranteed:
        raise ValueError("guaranteed must be False where counts are given: soft counts are no independent moves")
    evidence = gather(problem, next(iter(policies.values())))
    endless = problem.simulator.discount == 1.0 and problem.horizon is None
    lacking = ""
    if endless:
        lacking = "at discount 1 they need a horizon"
    elif quick:
        lacking = "quick was asked for"
    elif (
        len(evidence.phat) > LARGEST
        and (moves := int(np.diff(evidence.rows.indptr)[evidence.reachable].sum())) > LARGEST
    ):
        lacking = f"the reachable moves are {moves}, more than {LARGEST}"
    if lacking and guaranteed:
        raise ValueError(f"guaranteed must be False here: {lacking}")
    methods: tuple[Literal["likelihood", "robust"], ...] = ("likelihood", "robust") if guaranteed else ("likelihood",)
    intervals: dict[str, dict[str, Interval]] = {}
    distance = [SOFT if soft else _distance(evidence)]
    if lacking and not soft:
        distance.append(f"There are no likelihood intervals: {lacking}.")
    elif not soft:
        for i, (name, policy) in enumerate(policies.items()):
            _progress.report_step(f"likelihood interval of “{name}” (policy {i + 1} of {len(policies)})")
            intervals[name] = {m: assumed.interval(problem, policy, method=m, confidence=confidence) for m in methods}
            if (shared := assumed.shared_interval(problem, policy, confidence)) is not None:
                intervals[name][SHARED] = shared
    del evidence  # as much memory as the simulator
    _progress.report_step("comparison of the policies, and what to record next")
    several = len(policies) > 1 and not endless
    each = 1.0 - (1.0 - confidence) / max(len(policies) - 1, 1)  # all differences from the best hold at once
    return Sureness(
        intervals,
        tuple(distance),
        {name: _width(found, confidence, scale) for name, found in intervals.items()},
        next="" if endless else advice(problem, policies, confidence),
        comparison=compare_policies(problem, policies, confidence=each, **assumed.box) if several else None,
    )


def ranked(sure: Sureness, values: Mapping[str, float], scale: float = 1.0) -> Sureness:
    """With the sentence about the best policy, by the comparison's one rule; ``values`` are those that are shown."""
    if len(values) < 2 or not any(math.isfinite(value) for value in values.values()):
        return sure
    if sure.comparison is None:
        return replace(sure, ranking="At discount 1 policies are ranked only with a horizon (horizon=, --horizon).")
    found = sure.comparison.decide(values, sure.likelihood)
    names, best = found.candidates, found.best
    if best is not None:
        told = f"Of {len(values)} policies, “{best}” is worth most in the target.{_lead(found, sure, values, scale)}"
        return replace(sure, best=best, ranking=told)
    told = ", ".join(f"“{name}”" for name in names[:-1]) + f" and “{names[-1]}”"
    rest = len(values) - len(names)
    less = f"; the other {rest} {'is' if rest == 1 else 'are'} worth less" if rest else ""
    if found.are_equal:
        return replace(sure, ranking=f"{told} are worth the same in the target{less}.")
    return replace(sure, ranking=f"The log cannot say which of {told} is worth most in the target{less}.")


def _lead(found: Decision, sure: Sureness, values: Mapping[str, float], scale: float) -> str:
    """By how much the best is worth more than the next, and why that is known."""
    assert found.margin is not None
    assert sure.comparison is not None
    best, following = sorted(values, key=lambda name: -values[name] if math.isfinite(values[name]) else math.inf)[:2]
    difference, lower, upper = (scale * x for x in found.margin)
    if not math.isfinite(difference):
        return ""
    form = _printing.spec(lower, upper)
    level = 1.0 - (len(values) - 1) * (1.0 - sure.comparison.confidence)
    text = f" It is better than “{following}” by {difference:{form}} ({level:.0%}: {lower:{form}} to {upper:{form}})."
    ours, theirs = (sure.likelihood.get(name) for name in (best, following))
    if ours is None or theirs is None or ours.lower <= theirs.upper:
        text += MORE_PRECISE
    return text


def _distance(evidence: Evidence) -> str:
    """In how many rows the counts reject the simulator, and whether all moves together do.

    The rows' tests are KL balls that hold at any number of moves, sharing 5%.
    The test of all moves together is the score test of the tilt: sum (n - n_sa P) log P over its standard deviation under P.
    """
    tested = (evidence.n > 0) & evidence.open_rows
    number = int(tested.sum())
    if number == 0:
        return "The log has no move that could tell the target from the simulator."
    rows = evidence.rows.select(tested)
    n, phat, moves = evidence.n[tested], evidence.phat[rows.entries], np.diff(rows.indptr)
    kl = rows.sums(special.rel_entr(phat, rows.weights))
    apart = kl > independent_radius(n, moves, 0.05 / number)
    mean = float(np.sum(n * kl - (moves - 1) / 2.0) / n.sum())
    if not apart.any():
        pairs = f"In none of the {number} state-action pairs recorded do its own moves contradict the simulator"
        phi = rows.center(np.log(rows.weights))
        score = float(np.sum(rows.spread(n) * (phat - rows.weights) * phi))
        spread = float(np.sum(rows.spread(n) * rows.weights * phi**2))
        z = score / np.sqrt(spread) if spread > 0 else 0.0
        if abs(z) < 3.0:
            return f"{pairs}, nor do moves that it holds likely come more or less often on the whole."
        often = "more" if z > 0 else "less"
        return (
            f"{pairs}, but all of them together do (z = {z:.1f}): moves that the simulator holds likely come {often} often in "
            "the target."
        )
    return (
        f"The target differs from the simulator: the log rules the simulator out in {int(apart.sum())} of the {number} "
        f"state-action pairs recorded; a move tells {max(mean, 0.0):.2g} nats of the difference on average."
    )


def _width(found: Mapping[str, Interval], confidence: float, scale: float) -> str:
    shown = found["likelihood"]
    if shown.status != "ok":
        return f"{shown.status}."
    between = _between(shown.lower, shown.upper, scale)
    text = f"{between} with {confidence:.0%} confidence by the likelihood interval, the one to quote"
    unseen = int(shown.diagnostics["unvisited_rows"])
    if unseen == 1:
        text += " (the reachable state-action pair never recorded at its worst)"
    elif unseen:
        text += f" (the {unseen} reachable state-action pairs never recorded at their worst)"
    if "robust" in found:
        text += f"; guaranteed, {_between(found['robust'].lower, found['robust'].upper, scale)}"
    return f"{text}.{_assumptions(shown, scale)}"


def _assumptions(shown: Interval, scale: float) -> str:
    """What the quoted interval assumes, and what the narrower one, where the two differ by more than ``MUCH_WIDER``."""
    if shown.sampling is None or shown.width <= MUCH_WIDER * (shown.sampling[1] - shown.sampling[0]):
        return ""
    quantile = NormalDist().inv_cdf(0.5 + shown.confidence / 2.0)
    share = _printing.share(shown.diagnostics["unvisited_share"])
    dropped = shown.diagnostics.get("dropped_moves", 0.0)
    also = " and dropped transitions lead anywhere" if dropped else ""
    return (
        f" It lets state-action pairs that were never recorded ({share} of the policy's time) do anything that the simulator "
        f"allows{also}; from the recorded transitions alone, with those pairs as estimated, the value lies "
        f"{_between(*shown.sampling, scale)} (value ± {quantile:.3g} standard errors)."
    )


def _between(lower: float, upper: float, scale: float) -> str:
    form = _printing.spec(lower * scale, upper * scale)
    return f"between {lower * scale:{form}} and {upper * scale:{form}}"


def sampling_columns(found: Interval | None, scale: float) -> dict[str, float | None]:
    """The interval from the recorded transitions alone, as columns of a table; None where there is none."""
    lower, upper = (None, None) if found is None or found.sampling is None else found.sampling
    return {
        "sampling_lower": None if lower is None else lower * scale,
        "sampling_upper": None if upper is None else upper * scale,
    }


def as_records(sureness: Sureness, scale: float) -> list[dict[str, Any]]:
    """The intervals as plain rows."""
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
        for policy, methods in sureness.intervals.items()
        for method, found in methods.items()
    ]
