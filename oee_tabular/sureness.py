"""How far the target is from the simulator, how sure the log makes each value, and what to record next: in plain sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.estimators import Problem
from oee_tabular.exact import transition_gradient
from oee_tabular.inference import Interval, interval
from oee_tabular.inference.ambiguity import Evidence, gather, independent_radius, reached_rows

LARGEST = 200_000  # entries beyond which the likelihood interval is left out: its fixed point takes minutes

SOFT = (
    "The counts were given beside the log: tests of the simulator and likelihood intervals, which need whole and independent "
    "moves, are left out. The intervals shown are the delta method's."
)


@dataclass(frozen=True)
class Sureness:
    """Intervals of each policy, by method, and sentences that end a report."""

    intervals: Mapping[str, Mapping[str, Interval]]
    sentences: tuple[str, ...]


def how_sure(
    problem: Problem, policies: Mapping[str, Array], confidence: float, *, guaranteed: bool, scale: float
) -> Sureness:
    """Likelihood intervals (and guaranteed ones) of every policy; distance, width and the next (s, a) in words.

    ``scale`` multiplies values in the sentences (1 - discount for normalised reports).
    """
    if problem.observed is not problem.log:
        if guaranteed:
            raise ValueError("guaranteed must be False where counts are given: soft counts are no independent moves")
        return Sureness({}, (SOFT,))
    evidence = gather(problem, next(iter(policies.values())))
    lacking = ""
    if problem.simulator.discount == 1.0 and problem.horizon is None:
        lacking = "at discount 1 they need a horizon"
    elif len(evidence.phat) > LARGEST:
        lacking = f"the reachable moves are {len(evidence.phat)}, more than {LARGEST}"
    if lacking and guaranteed:
        raise ValueError(f"guaranteed must be False here: {lacking}")
    if lacking:
        return Sureness({}, (_distance(evidence), f"There are no likelihood intervals: {lacking}."))
    methods = ("likelihood", "robust") if guaranteed else ("likelihood",)
    intervals: dict[str, dict[str, Interval]] = {}
    sentences = [_distance(evidence)]
    for name, policy in policies.items():
        found = {
            method: interval(problem, policy, method=method, confidence=confidence)  # type: ignore[arg-type]
            for method in methods
        }
        intervals[name] = found
        sentences.append(_width(name, found, confidence, scale) + " " + _next(gather(problem, policy)))
    return Sureness(intervals, tuple(sentences))


def _distance(evidence: Evidence) -> str:
    """In how many rows the counts reject the simulator, and whether all moves together do.

    The rows' tests are KL balls that hold at any number of moves, sharing 5%.
    The test of all moves together is the score test of the tilt: sum (n - n_sa P) log P over its standard deviation under P.
    """
    data = evidence.model.transitions.data
    rows, starts = evidence.rows, evidence.indptr[:-1]
    simulator = data / np.add.reduceat(data, starts)[rows]
    seen = evidence.phat > 0
    terms = np.zeros(len(seen))
    terms[seen] = evidence.phat[seen] * np.log(evidence.phat[seen] / simulator[seen])
    kl = np.add.reduceat(terms, starts)
    tested = (evidence.n > 0) & evidence.open_rows
    number = int(tested.sum())
    if number == 0:
        return "The log has no move that could tell the target from the simulator."
    freedom = np.maximum(np.diff(evidence.indptr) - 1, 1)
    apart = tested & (kl > independent_radius(evidence.n, np.diff(evidence.indptr), 0.05 / number))
    mean = float(np.sum((evidence.n * kl - freedom / 2.0)[tested]) / evidence.n[tested].sum())
    if not apart.any():
        pairs = f"In none of the {number} state-action pairs recorded do its own moves contradict the simulator"
        phi = np.log(simulator)
        level = np.add.reduceat(simulator * phi, starts)[rows]
        score = float(np.sum(evidence.n[rows] * (evidence.phat - simulator) * (phi - level)))
        spread = float(np.sum(evidence.n[rows] * simulator * (phi - level) ** 2))
        z = score / np.sqrt(spread) if spread > 0 else 0.0
        if abs(z) < 3.0:
            return f"{pairs}, nor do all of them together."
        often = "more" if z > 0 else "less"
        return (
            f"{pairs}, but all of them together do (z = {z:.1f}): moves that the simulator holds likely come {often} often in "
            "the target."
        )
    return (
        f"The target differs from the simulator: the log rules the simulator out in {int(apart.sum())} of the {number} "
        f"state-action pairs recorded; a move tells {max(mean, 0.0):.2g} nats of the difference on average."
    )


def _width(name: str, found: Mapping[str, Interval], confidence: float, scale: float) -> str:
    shown = found["likelihood"]
    if shown.status != "ok":
        return f"{name}: {shown.status}."
    text = (
        f"{name}: between {shown.lower * scale:.4g} and {shown.upper * scale:.4g} with {confidence:.0%} confidence by the "
        "likelihood interval, the one to quote"
    )
    unseen = int(shown.diagnostics["unvisited_rows"])
    if unseen:
        if unseen == 1:
            text += " (the reachable state-action pair never recorded at its worst)"
        else:
            text += f" (the {unseen} reachable state-action pairs never recorded at their worst)"
    if "robust" in found:
        sure = found["robust"]
        text += f"; guaranteed, between {sure.lower * scale:.4g} and {sure.upper * scale:.4g}"
    return text + "."


def _next(evidence: Evidence) -> str:
    """The (s, a) whose next move narrows the interval most: never recorded ones first, then argmax c / (n (n + 1))."""
    model = evidence.with_rows(evidence.phat)
    gradient = transition_gradient(model, evidence.policy, horizon=evidence.horizon)
    starts, rows = evidence.indptr[:-1], evidence.rows
    mean = np.add.reduceat(evidence.phat * gradient, starts)
    cost = np.add.reduceat(evidence.phat * (gradient - mean[rows]) ** 2, starts)
    spread = np.maximum.reduceat(gradient, starts) - np.minimum.reduceat(gradient, starts)
    unseen = (evidence.n == 0) & evidence.open_rows & reached_rows(evidence)
    gain = np.where(evidence.n > 0, cost / np.maximum(evidence.n * (evidence.n + 1.0), 1.0), 0.0)
    if unseen.any() and float(spread[unseen].max()) > 0:
        k = int(np.argmax(np.where(unseen, spread, -1.0)))
        why = "never recorded"
    elif float(gain.max()) > 0:
        k = int(np.argmax(gain))
        share = cost[k] / evidence.n[k] / max(float(np.sum(cost[evidence.n > 0] / evidence.n[evidence.n > 0])), 1e-300)
        why = f"{evidence.n[k]:g} moves so far, {100 * share:.0f}% of the variance"
    else:
        return "More moves would not narrow it."
    state, action = divmod(k, evidence.model.n_actions)
    return f"What would help most: moves of action {action} in state {state} ({why})."


def as_records(sureness: Sureness, scale: float) -> list[dict[str, Any]]:
    """The intervals as plain rows."""
    return [
        {
            "policy": policy,
            "method": method,
            "lower": found.lower * scale,
            "upper": found.upper * scale,
            "confidence": found.confidence,
            "status": found.status,
        }
        for policy, methods in sureness.intervals.items()
        for method, found in methods.items()
    ]
