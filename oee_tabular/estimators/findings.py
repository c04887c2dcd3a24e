"""What a reader must know before using an estimate: each finding in its words; () where there is nothing to say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from oee_tabular._checks import Array

# below, or above, these something is worth a sentence
MIN_SHARE = 0.02  # of the policy's discounted time
MAX_ROW_SUM_ERROR = 1e-3
MIN_WEIGHTED, MIN_WEIGHTED_SHARE = 10.0, 0.05  # effective sample size, and its share of the episodes
MAX_GAP = 1e-6  # nats
MAX_ERROR_BOUND = 1e-6  # of the value


@dataclass(frozen=True)
class Finding:
    """Something to know about a value; findings of one kind and text about policies make one sentence.

    Attributes
    ----------
    kind : a word for it
    severity : the larger the worse, among findings of one kind
        Of a problem's data 0 where no model's value depends on it.
    text : a sentence that may hold ``{}``, where the figure stands
        "": nothing is said of a value that has an interval.
    figure : what differs from policy to policy
    alone : the sentence where the value has no interval, if that is another

    Examples
    --------
    >>> str(Finding("units", 2.0, "the log's rewards are {} times the simulator's.", "2"))
    "the log's rewards are 2 times the simulator's."
    """

    kind: str
    severity: float
    text: str
    figure: str = ""
    alone: str | None = None

    def __str__(self) -> str:
        return self.sentence(self.figure)

    def sentence(self, figure: str) -> str:
        """The sentence with a figure."""
        return self.text.replace("{}", figure)


Findings = tuple[Finding, ...]

NEVER_VARIED = Finding(
    "constant",
    1.0,
    "",
    "no standard error",
    "there is {} and no interval: what was seen never varied, which does not make the value certain.",
)
WEIGHTLESS = Finding(  # the status says it, and a report leaves such rows out
    "weightless",
    1.0,
    "the weight of every whole episode is 0: none of the log is one that the policy could have made",
)
SAMPLED = Finding(
    "sampled",
    0.0,
    "The simulator was made of samples: likelihood intervals widen by what its first states, its mean rewards and "
    "transitions that were never met may change.",
)


def no_value(status: str, value: float) -> Finding:
    """Why a value is not to be used."""
    text = "do not rely on the value: {}." if math.isfinite(value) else "no value: {}."
    return Finding("status", 1.0, text, status)


def from_diagnostics(facts: Mapping[str, Any], value: float, error: float | None) -> Findings:
    """What the diagnostics of any estimate have to say, ``error`` its standard error."""
    told: list[Finding] = []
    has_source = facts.get("standard_error_of") is not None
    unseen, single = facts.get("fallback_share", 0.0), facts.get("single_share", 0.0)
    if unseen > MIN_SHARE:
        is_tied = "n_keys" in facts
        is_bare = error is not None and "unseen_standard_error" not in facts
        text = "the log has nothing in the state-action pairs where the policy spends {} of its discounted time."
        if is_tied:
            text += " Transitions of the same key elsewhere speak for them."
        elif is_bare:
            text += " The standard error does not cover them, and above 10% there is no interval."
        alone = f"{text[:-1]}, so there is no interval." if has_source and not is_tied and not is_bare else None
        told.append(Finding("coverage", unseen, text, f"{unseen:.0%}", alone))
    if single > MIN_SHARE:
        alone = (
            "{} of the policy's discounted time is spent in state-action pairs with one recorded transition, whose variance is "
            "not known: there is no interval."
        )
        told.append(Finding("single", single, "", f"{single:.0%}", alone))
    elif has_source and error is None:
        told.append(NEVER_VARIED)
    if (miss := facts.get("row_sum_error", 0.0)) > MAX_ROW_SUM_ERROR:
        text = (
            "the rows of zeta * P miss 1 by up to {}; over a horizon such errors multiply. The row-normalised ratio (oee) "
            "does not have them."
        )
        told.append(Finding("row sums", miss, text, f"{miss:.2g}"))
    for noun in ("episodes", "rollouts"):
        n, effective = facts.get(f"n_{noun}", 0), facts.get("effective_sample_size", math.inf)
        if effective < max(MIN_WEIGHTED, MIN_WEIGHTED_SHARE * n) and n:
            text = f"the weights rest on about {{}} of {n} {noun}: the value is largely chance, its standard error too small."
            told.append(Finding("weights", -effective, text, f"{effective:.1f}"))
    if (gap := facts.get("gap", 0.0)) > MAX_GAP:
        told.append(Finding("gap", gap, "the ratio's program is solved only to a gap of {} nats.", f"{gap:.1e}"))
    if (bound := facts.get("error_bound", 0.0)) > MAX_ERROR_BOUND * max(1.0, abs(value)):
        told.append(Finding("linear algebra", bound, "the linear solve is accurate only to {}.", f"{bound:.1e}"))
    return tuple(told)


def truncation(number: int, episodes: int, bound: float, value: float, error: float | None) -> Findings:
    """``number`` of the episodes lack rewards that can change the value by up to ``bound``."""
    if not bound > max(1e-3 * abs(value), 0.1 * (error or 0.0)):
        return ()
    reach = f"by up to {bound:.3g} (as a discounted sum)" if bound < math.inf else "without bound at discount 1"
    text = f"{number} of {episodes} episodes were cut before they were over; what they lack can change the value {{}}."
    return (Finding("truncation", bound, text, reach),)


def foreign_starts(share: float) -> Findings:
    """Episodes begin where the simulator never does."""
    text = (
        "{} of the episodes start where the simulator never does; importance sampling estimates the value from the log's "
        "own starts."
    )
    return (Finding("starts", share, text, f"{share:.0%}"),) if share > 0 else ()


MADE_FROM_LOG = Finding(
    "selected",
    1.0,
    "The policy is optimal in the log's own model and not in the simulator, so it was probably made from this log. Such a "
    "value was chosen for being large: it is too large on average, and its interval covers less often than it says. Another "
    "log would tell without this error.",
)


def conflict_with_centre(likeliest: float, distance: float) -> Findings:
    """The value rests on the corrected simulator, ``distance`` standard errors from the log's."""
    text = (
        f"The value rests on the corrected simulator. The log's frequencies alone say {likeliest:.4g}, {{}} standard errors of "
        "the difference away. If you know what may differ, say it: features of transitions (features=, on the command line "
        "--features) or transitions that are alike (tie=, --tie)."
    )
    return (Finding("against", distance, text, f"{distance:.1f}"),)


def outside(value: str, severity: float, end: str) -> Finding:
    """The log rules the estimator's own value out; ``end`` is "lower" or "upper"."""
    text = (
        f"The estimator's own value, {value}, lies outside the interval that the log allows. The interval's {end} end stands "
        "in its place."
    )
    return Finding("outside", severity, text)


def missing_support(share: float, largest: float, nats: float) -> Findings:
    """Transitions that only the defensive share of a continuous simulator makes possible."""
    text = (
        "{} of the log's transitions have probability 0 in the plain simulator, where no ratio exists; what is said of them "
        f"rests on the defensive share (largest zeta {largest:.3g}, D_inf {nats:.2g} nats). "
        "A simulator under parameters that bracket the target (tasks.defensive_mixture), process noise or wider cells "
        "would cover them."
    )
    return (Finding("support", share, text, f"{share:.1%}"),) if share > 0.01 else ()


def rewards_contradict(conflict: object, *, log_pays: bool) -> Finding:
    """The log's rewards are not the simulator's."""
    if log_pays:
        remedy = "oee and model-based use the log's mean reward where it was observed."
    else:
        remedy = (
            'The simulator, oee and model-based values use the simulator\'s rewards; rewards="log" (--rewards log) uses those '
            "of the log."
        )
    text = str(conflict)
    return Finding("rewards", 0.0 if log_pays else 1.0, f"{text[0].upper()}{text[1:]}. {remedy}")


def rows_dropped(rows: int, reasons: tuple[str, ...]) -> Findings:
    """Rows of the log's files that are none of a log's, and were not counted."""
    text = f"{rows} bad rows of the log were not counted: {'; '.join(reasons)}."
    return (Finding("dropped", 0.0, text),) if rows else ()


def moves_dropped(dropped: Array, kept: float) -> Findings:
    """Transitions that the simulator calls impossible: ``dropped`` of each pair, beside ``kept`` in all."""
    number, pairs = float(dropped.sum()), int((dropped > 0).sum())
    text = (
        f"{number:g} of the log's {number + kept:g} transitions, of {pairs} pair{'s' * (pairs > 1)} of a state and an action, "
        f"{'is' if number == 1 else 'are'} impossible in the simulator and left out of every model. Likelihood intervals let "
        "these transitions lead anywhere; all other intervals ignore them."
    )
    return (Finding("impossible", 1.0, text),) if number else ()


def episodes_sampled(kept: int, of: int) -> Findings:
    """Importance sampling sees some of the log's episodes."""
    text = f"Importance sampling sees a sample of {kept} of the log's {of} episodes; all others see every transition."
    return (Finding("sample", 0.0, text),) if 0 < kept < of else ()


def behavior_contradicts(rows: int) -> Findings:
    """The policy that is said to have recorded the log did not."""
    text = "The log's behaviour probabilities are used; they differ from behavior_policy in {} rows."
    return (Finding("behavior", 0.0, text, str(rows)),) if rows else ()
