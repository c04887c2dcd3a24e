"""Findings, the warnings about an estimate.

Functions that look for something return () where there is nothing to warn of.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked, conform
from oee_tabular.typing import Array

# limits beyond which there is a finding
MIN_SHARE = 0.02  # a share of the policy's discounted time
MAX_ROW_SUM_ERROR = 1e-3  # a probability
MIN_WEIGHTED = 10.0  # an effective sample size
MIN_WEIGHTED_SHARE = 0.05  # an effective sample size, as a share of the episodes
MAX_GAP = 1e-6  # nats
MAX_UNREAD_SHARE = 0.01  # of the log's rows, which intervals do not allow for
SMALLEST_NORMAL = 2.0**-1022
MAX_ERROR_BOUND = 1e-6  # a share of the value, or of the largest reward
# the kind of finding about values that rest on a few episodes, whose rows a short
# report leaves out
FEW_WEIGHTED = "weights"


@suggest_keywords
@checked()
@dataclass(frozen=True)
class Finding:
    """A warning about a value.

    A report makes one sentence of findings of one kind and text about several policies.

    Parameters
    ----------
    kind : str
        A name for this sort of warning.
    severity : float
        A number that is larger for the worse of two findings of one kind. Of a finding
        about a problem's data it is 0 where no model's value depends on it.
    text : str
        A sentence, in which ``{}`` stands for the figure. It is "" where there is no
        warning about a value that has an interval.
    figure : str, default ''
        The figure, which differs from policy to policy.
    alone : str, optional
        The sentence where the value has no interval, if that is another.

    See Also
    --------
    Estimate : Its ``findings`` are such warnings.

    Examples
    --------
    >>> str(
    ...     Finding(
    ...         "units", 2.0, "the log's rewards are {} times the simulator's.", "2"
    ...     )
    ... )
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
        """Write the sentence with a figure.

        Parameters
        ----------
        figure : str
            What takes the place of ``{}``.

        Returns
        -------
        str
            The sentence.
        """
        return self.text.replace("{}", conform(figure, "figure", str))


Findings = tuple[Finding, ...]

NEVER_VARIED = Finding(
    "constant",
    1.0,
    "",
    "no standard error",
    "there is {} and no interval, because what was recorded never varied. That does not"
    " make the value certain.",
)
WEIGHTLESS = Finding(  # the status says it, and a report leaves such rows out
    "weightless",
    1.0,
    "the weight of every whole episode is 0: none of the log is one that the policy"
    " could have made",
)
SAMPLED = Finding(
    "sampled",
    0.0,
    "The simulator was made of samples. Likelihood intervals allow for the noise in its"
    " initial states, its mean rewards and the transitions that it lacks.",
)


def no_value(status: str, value: float) -> Finding:
    """Say why a value is not to be used."""
    text = "do not rely on the value: {}." if math.isfinite(value) else "no value: {}."
    return Finding("status", 1.0, text, status)


def from_diagnostics(
    facts: Mapping[str, Any], value: float, error: float | None, size: float = 0.0
) -> Findings:
    """Return the findings that the diagnostics of an estimate lead to.

    ``value`` and ``error`` are those of the estimate; ``size`` is the largest reward.
    """
    findings = list(_low_coverage(facts, error))
    has_source = facts.get("standard_error_of") is not None
    single = facts.get("single_share", 0.0)
    if single > MIN_SHARE:
        alone = (
            "the policy spends {} of its discounted time in state-action pairs with one"
            " recorded transition. Their variance is not known, so there is no"
            " interval."
        )
        findings.append(Finding("single", single, "", f"{single:.0%}", alone))
    elif has_source and error is None:
        findings.append(NEVER_VARIED)
    if (miss := facts.get("row_sum_error", 0.0)) > MAX_ROW_SUM_ERROR:
        text = (
            "the rows of zeta * P miss 1 by up to {}; over a horizon such errors"
            " multiply. The row-normalised ratio (oee) does not have them."
        )
        findings.append(Finding("row sums", miss, text, f"{miss:.2g}"))
    for noun in ("episodes", "rollouts"):
        n = facts.get(f"n_{noun}", 0)
        effective = facts.get("effective_sample_size", math.inf)
        if effective < max(MIN_WEIGHTED, MIN_WEIGHTED_SHARE * n) and n:
            text = (
                f"the effective sample size is {{}} of {n} {noun}. The value is mostly"
                " chance; its standard error is too small and its interval too narrow."
            )
            findings.append(Finding(FEW_WEIGHTED, -effective, text, f"{effective:.1f}"))
    if (gap := facts.get("gap", 0.0)) > MAX_GAP:
        findings.append(
            Finding(
                "gap",
                gap,
                "the ratio's program is solved only to a gap of {} nats.",
                f"{gap:.1e}",
            )
        )
    bound = facts.get("error_bound", 0.0)
    # without rewards a bound is that of numbers that are subnormal
    if bound > max(MAX_ERROR_BOUND * max(size, abs(value)), SMALLEST_NORMAL):
        findings.append(
            Finding(
                "linear algebra",
                bound,
                "the value is accurate only to {}.",
                f"{bound:.1e}",
            )
        )
    return tuple(findings)


def _low_coverage(facts: Mapping[str, Any], error: float | None) -> Findings:
    """Warn of time that the policy spends in unrecorded state-action pairs."""
    unrecorded = facts.get("unrecorded_share", 0.0)
    if not unrecorded > MIN_SHARE:
        return ()
    text = (
        "{} of the policy's discounted time is in state-action pairs that were never"
        " recorded, by this estimator's own model."
    )
    alone = None
    if "n_keys" in facts:
        text += " Transitions of the same key elsewhere stand for them."
    elif error is not None and "unrecorded_standard_error" not in facts:
        text += " Its interval leaves them out, so it is too narrow. Above 10% there is none."
    elif facts.get("standard_error_of") is not None:
        alone = f"{text[:-1]}, so there is no interval."
    return (Finding("coverage", unrecorded, text, f"{unrecorded:.0%}", alone),)


def truncation(
    number: int, episodes: int, bound: float, value: float, error: float | None
) -> Findings:
    """Warn of truncated episodes, whose missing rewards can change the value.

    ``number`` of the ``episodes`` are truncated, and can change it by up to ``bound``.
    """
    if not bound > max(1e-3 * abs(value), 0.1 * (error or 0.0)):
        return ()
    change = "the value without bound at discount 1"
    figure = ""
    if bound < math.inf:
        change = "the discounted sum of rewards by up to {}"
        figure = f"{bound:.3g}"
    text = (
        f"{number} of {episodes} episodes were truncated. The missing rewards can"
        f" change {change}."
    )
    return (Finding("truncation", bound, text, figure),)


def foreign_starts(share: float) -> Findings:
    """Warn of episodes that begin where the simulator never does."""
    text = (
        "{} of the episodes start where the simulator never does. Importance sampling"
        " estimates the value from the log's own initial states."
    )
    return (Finding("starts", share, text, f"{share:.0%}"),) if share > 0 else ()


def starts_contradict(
    state: str, number: int, episodes: int, probability: float
) -> Finding:
    """Warn of episodes that begin otherwise than the simulator's.

    ``number`` of the log's ``episodes`` begin in ``state``; ``probability`` is the
    simulator's.
    """
    share = "none" if number == 0 else f"{number}"
    if number == episodes:
        share = "all"
    text = (
        f"Of the log's {episodes} episodes {share} begin in state {state}, to which the"
        f" simulator gives probability {probability:.3g}. Values are those of the"
        " simulator's first states; initial= (--initial) says where episodes start."
    )
    severity = 1.0 + abs(number / episodes - probability)
    return Finding("first states", severity, text)


MADE_FROM_LOG = Finding(
    "selected",
    1.0,
    "The policy is optimal in the log's own model, at least where it differs from the"
    " recording policy, and not in the simulator or the corrected one, so it was"
    " probably made from this log. The value of such a policy is too large on average,"
    " and its interval covers less often than it says: where this was measured, 95%"
    " intervals missed the true value in a tenth to a third of the logs. Use another"
    " log to evaluate it, or choose by one half of this log and evaluate by the other.",
)


def conflict_with_log(ml_value: float, distance: float) -> Findings:
    """Warn of a value that maximum likelihood contradicts.

    The value is that of the corrected simulator; ``distance`` is in standard errors of
    the difference.
    """
    text = (
        "Two estimates disagree. The value is that of the corrected simulator. Maximum"
        " likelihood (the corrected simulator in unrecorded pairs) gives"
        f" {ml_value:.4g}, {{}} standard errors of the difference away. Use the"
        " interval and not the standard error. What you know of the difference may"
        " help (features=, --features; tie=, --tie)."
    )
    return (Finding("against", distance, text, f"{distance:.1f}"),)


def outside(value: str, severity: float, end: str) -> Finding:
    """Warn of a value outside the interval, beyond its "lower" or "upper" ``end``."""
    text = (
        f"The estimator's own value, {value}, lies outside the interval. The table"
        f" gives the interval's {end} end instead."
    )
    return Finding("outside", severity, text)


def missing_support(share: float, largest: float, nats: float) -> Findings:
    """Warn of transitions that only a simulator's defensive share makes possible."""
    text = (
        "{} of the log's transitions have probability 0 in the plain simulator, so"
        " they have no ratio. Their estimates rest on the defensive share (largest"
        f" zeta {largest:.3g}, D_inf {nats:.2g} nats). A simulator under parameters"
        " that bracket the target (tasks.discretize(others=...)), process noise or"
        " wider cells would cover them."
    )
    return (Finding("support", share, text, f"{share:.1%}"),) if share > 0.01 else ()


def rewards_contradict(
    conflict: object, *, log_pays: bool, is_rounding: bool = False
) -> Finding:
    """Warn of rewards of the log that are not the simulator's.

    A report puts what they do to the values into the text. Of rounded rewards the
    severity is 0.
    """
    if log_pays:
        remedy = "oee and model-based use the log's mean reward where it was observed."
    else:
        remedy = (
            "The simulator, oee and model-based values use the simulator's rewards;"
            ' rewards="log" (--rewards log) uses those of the log.'
        )
    text = str(conflict)
    return Finding(
        "rewards",
        0.0 if log_pays or is_rounding else 1.0,
        f"{text[0].upper()}{text[1:]}.{{}} {remedy}",
    )


def rows_dropped(
    rows: int, reasons: tuple[str, ...], by_pair: Array, kept: float
) -> Findings:
    """Warn of invalid rows of the log's files, which were not counted.

    ``by_pair`` is their number in each state-action pair, of those whose state and
    action can be read; ``kept`` is the number of the log's other rows.
    """
    if not rows:
        return ()
    known = float(by_pair.sum())
    unknown = rows - known
    share = unknown / (rows + kept)
    why = f": {'; '.join(reasons)}" if reasons else ""
    found = []
    if known:
        pairs = _count_pairs(by_pair)
        noun = "row" if known == 1 else "rows"
        text = (
            f"{known:g} invalid {noun} of the log in {pairs} left out of every model:"
            " it is not known where these transitions led. Likelihood and guaranteed"
            " intervals let them lead anywhere. Values and standard errors ignore them,"
            f" as if they were like the others{why}."
        )
        found.append(Finding("unread", 1.0, text))
        why = ""
    if unknown:
        noun = "row" if unknown == 1 else "rows"
        text = (
            f"{unknown:g} invalid {noun} of the log ({share:.2%} of all rows) were not"
            " counted, since their state or action cannot be read. Values and intervals"
            f" are as if they were like the others{why}."
        )
        severity = 1.0 if share > MAX_UNREAD_SHARE else 0.0
        found.append(Finding("dropped", severity, text))
    return tuple(found)


def _count_pairs(numbers: Array) -> str:
    """Return in how many state-action pairs a number is positive, with the verb."""
    pairs = int((numbers > 0).sum())
    noun = "state-action pair" if pairs == 1 else "state-action pairs"
    return f"{pairs} {noun} {'is' if numbers.sum() == 1 else 'are'}"


def moves_dropped(dropped: Array, kept: float) -> Findings:
    """Warn of transitions that were left out as impossible in the simulator.

    ``dropped`` is their number in each state-action pair, ``kept`` that of all others.
    """
    number = float(dropped.sum())
    pairs = int((dropped > 0).sum())
    noun = "state-action pair" if pairs == 1 else "state-action pairs"
    verb = "is" if number == 1 else "are"
    text = (
        f"{number:g} of the log's {number + kept:g} transitions, in {pairs} {noun},"
        f" {verb} impossible in the simulator and left out of every model. Likelihood and"
        " guaranteed intervals let these transitions lead anywhere. Standard errors"
        " ignore them."
    )
    return (Finding("impossible", 1.0, text),) if number else ()


def episodes_sampled(kept: int, of: int) -> Findings:
    """Say that importance sampling uses a sample of the log's episodes."""
    text = (
        f"Importance sampling uses a sample of {kept} of the log's {of} episodes. The"
        " other estimators use every transition."
    )
    return (Finding("sample", 0.0, text),) if 0 < kept < of else ()


def behavior_contradicts(transitions: int) -> Findings:
    """Warn of a given behaviour policy that is not the log's."""
    text = (
        "The log's behaviour probabilities are used. They differ from behavior_policy"
        " in {} transitions."
    )
    return (Finding("behavior", 0.0, text, str(transitions)),) if transitions else ()
