"""Sentences and templates of reports: the answer, how certain it is, and legends.

Other sentences are in ``report.uncertainty`` (what the user assumes, why intervals are
left out), ``estimators.findings`` (what estimators warn of), ``.rewards`` and
``.names``, ``design.advice`` (what to record next) and ``continuous.correction``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

from oee_tabular import _printing

# the share of a policy's discounted time in recorded pairs below which a reader must
# know that first
MIN_COVERAGE = 0.5
# likelihood intervals whose ends are no search's: where the policy reaches pairs that
# were never recorded, or the search was left out
WIDENED = (
    "oee's value ± normal quantile × standard error, widened by what state-action pairs that"
    " were never recorded can change if they differ from the estimate by at most a"
    " factor (three by default; unrecorded=, --unrecorded)."
)
AS_ESTIMATED = (
    "oee's value ± normal quantile × standard error. Unrecorded state-action pairs"
    " behave as estimated."
)
CUT = " It is cut at the least or largest value that the rewards allow."
# the kinds of intervals that are symmetric unless they are cut
SYMMETRIC = ("one-step", "simulator's samples", "standard error", "rollouts")
METHODS: Mapping[str, str] = {  # kinds of intervals
    "likelihood": "every value that the log does not reject.",
    "likelihood with trials": (
        "every value that log and trials together do not reject. Log and trials are one"
        " likelihood; the log's part is as in the likelihood interval."
    ),
    "trials": ("by the trials alone: Wilson's for successes, Student's for returns."),
    "likelihood under the tie": (
        "every value of the model with this tie that the log does not reject."
    ),
    "likelihood under the features": (
        "every value of the model along the features that the log does not reject."
    ),
    "one-step": (
        "value ± normal quantile × standard error. An unrecorded pair has the variance"
        " of one transition."
    ),
    "refits": (
        "value ± t quantile × standard error from resampled episodes. It includes the"
        " rollouts' noise."
    ),
    "calibrated": (
        "value ± normal quantile × standard error. It includes the gap between two"
        " calibrations."
    ),
    "simulator's samples": (
        "value ± normal quantile × standard error. It includes only the simulator's"
        " sampling noise."
    ),
    "the estimator's own": "as the estimator gives it.",
    "standard error": "value ± quantile × standard error (sampling noise).",
    "rollouts": (
        "value ± quantile × standard error, the Monte Carlo error of the rollouts and"
        " of nothing else."
    ),
    "guaranteed": (
        "it covers with at least this confidence for any number of transitions. It is"
        " the widest."
    ),
    "sampling": AS_ESTIMATED,
    "worst case": (
        "every value that the log does not reject, if unrecorded state-action pairs may"
        " do anything that the simulator allows."
    ),
}
# the corrected rows of a continuous task, with the last actions in its state or without
CONTINUOUS_ROW = re.compile(
    r"oee \((parameters, )?residual(, last (action|\d+ actions))?\)"
)
OF_SIMULATOR = "the simulator alone"
OF_BOTH = "the simulator, corrected by the log"
# the same, where the log cannot say how far the target is from it
NOT_OF_TARGET = "the simulator alone: not the target"
# what the rows of a usual report rest on
DEFAULT_ROWS: Mapping[str, str] = {
    "simulator": OF_SIMULATOR,
    "oee": OF_BOTH,
    "oee-tied": "the same, with shared ratios",
    "oee-features": "the same, along the features",
    "model-based": "the log alone",
    "pdis": "the log's episodes, weighted",
    "wpdis": "the log's episodes, weighted",
    "trials": "the trials alone",
    "oee+trials": "simulator, log and trials",
    "linear model of the log": "the log alone",
    "simulator (continuous)": OF_SIMULATOR,
}
# the rows whose value is that of a corrected simulator
CORRECTED_ROWS = frozenset({"oee", "oee-tied", "oee-features", "oee+trials"})
# stands above the command that plans the next recording
PLANNED = "A plan for as many transitions as the log has:"
NOT_USABLE = "do not rely on this value (--verbose says why)"
NO_VALUE = (
    "No estimator could give the value of a policy in the target. The notes say why."
)
REWARD_CONFLICT = "{}, so this rests on rewards that may be wrong."
ROWS_LOST = (
    "{rows} of the log's {all} rows ({share:.1%}) could not be read, and nobody knows"
    " where they led."
)
MISSING_WEIGHTS = "Importance sampling is left out ({}): {}."
NOT_TESTED = (
    "The simulator has one possible next state in every recorded state-action pair, so"
    " it cannot be tested."
)
SOFT = (
    "The counts were given beside the log. Tests of the simulator and likelihood"
    " intervals need whole and independent transitions, so they are left out."
)
MISSING_INTERVALS = "There are no likelihood intervals: {}."
QUICK = "quick=True (--quick) leaves them out"  # for MISSING_INTERVALS
SEARCHED_NEXT = "they are searched for next"
MISSING_WORST_CASES = "The intervals' worst cases are left out: {}."
NO_P_BEST = (
    "There is no P(best), because it includes sampling noise alone, and here other"
    " uncertainty decides the ranking."
)
INTERVAL_AT_ANY_SIZE = "The interval that is guaranteed at any sample size is {}."
DROPPED = "The interval lets dropped transitions lead anywhere."
BY_DEFAULT = "By off-environment evaluation (oee): "
NOT_JOINED = "Without them the trials are not joined with the log."
RANKED_WITHOUT_TRIALS = "The ranking rests on the log alone, without the trials."
NEEDS_HORIZON = (
    "At discount 1 policies are ranked only with a horizon (horizon=, --horizon)."
)


@dataclass(frozen=True)
class Answer:
    """Hold what a report says of one policy, in the report's unit.

    Attributes
    ----------
    policy : str
        The name of the policy.
    estimator : str
        The estimator whose value stands first.
    value : float
        The value; nan where there is none.
    lower : float or None
        The lower end of the interval, or None without one.
    upper : float or None
        The upper end of the interval, or None without one.
    method : str or None
        The name of the interval, or None without one.
    simulator : float or None
        The value in the simulator.
    simulator_error : float or None
        The standard error of the simulator's value, where the simulator was sampled.
    truth : float or None
        The exact value in the target, where it is known.
    coverage : float or None
        The share of the policy's discounted time in recorded state-action pairs, in [0,
        1]; None where it was not measured.
    unrecorded : int
        The number of reachable state-action pairs that were never recorded.
    assumption : str
        A sentence on the pairs that were never recorded: what the interval lets them
        do, and its two ends; "" where they hardly matter.
    is_inner : bool
        Whether the interval's ends are inner bounds, because their search was stopped.
    is_from_log : bool
        Whether the value uses the log. False for what the simulator alone says.
    is_contradicted : bool
        Whether the policy's trials contradict the log, so that no value is stated.
    """

    policy: str
    estimator: str
    value: float
    lower: float | None
    upper: float | None
    method: str | None
    simulator: float | None
    simulator_error: float | None
    truth: float | None
    coverage: float | None
    unrecorded: int
    assumption: str
    is_inner: bool
    is_from_log: bool
    is_contradicted: bool = False

    @property
    def is_nearly_silent(self) -> bool:
        """Return whether the log covers less than half of what the policy does."""
        return self.coverage is not None and self.coverage < MIN_COVERAGE


# numbers


def is_of_correction(estimator: str) -> bool:
    """Return whether a row's value is that of a corrected simulator.

    >>> [is_of_correction(f"oee{x}") for x in ("", " (residual, last 12 actions)", "?")]
    [True, True, False]
    """
    return estimator in CORRECTED_ROWS or bool(CONTINUOUS_ROW.fullmatch(estimator))


def write_basis(estimator: str) -> str:
    """Say what the value of a row rests on; "" for estimators of one's own."""
    if CONTINUOUS_ROW.fullmatch(estimator):
        return OF_BOTH
    return DEFAULT_ROWS.get(estimator, "")


def format_number(value: float | None, digits: int = 4) -> str:
    """Write a number with a real minus sign; an en dash for None."""
    if value is None:
        return "–"
    if math.isnan(value):
        return "no value"
    return f"{value:#.{digits}g}".removesuffix(".").replace("-", "−") if value else "0"


def format_value(value: float | None, lower: float | None, upper: float | None) -> str:
    """Write a number with as many digits as its interval has."""
    if value is None or lower is None or upper is None or not math.isfinite(value):
        return format_number(value)
    return format(value, _printing.spec(lower, upper)).replace("-", "−")


def format_estimate(
    value: float | None,
    ends: tuple[float | None, float | None],
    quoted: tuple[float | None, float | None],
) -> str:
    """Write a value with as many digits as its interval has.

    Without one it has no more digits than the quoted interval of its policy.
    """
    shown = format_value(value, *ends)
    if None in ends:
        shown = min(shown, format_value(value, *quoted), key=len)
    return shown


def format_interval(
    lower: float | None, upper: float | None, joint: str = " to "
) -> str:
    """Write an interval; an en dash without one."""
    if lower is None or upper is None:
        return "–"
    return (
        f"{format_value(lower, lower, upper)}{joint}{format_value(upper, lower, upper)}"
    )


def format_level(confidence: float) -> str:
    """Write a confidence level, such as 95% or 99.9%."""
    return f"{confidence:.4%}".rstrip("0%").rstrip(".") + "%"


def count(number: int, noun: str) -> str:
    """Write a number of things: 1 pair, 2 pairs, 1,000 pairs."""
    plural = "" if number == 1 else "s"
    return f"{number:,} {noun}{plural}"


# the answer


def policy_worth(answer: Answer, confidence: float) -> str:
    """Say what one policy is worth, what the simulator says, and what is assumed."""
    return " ".join(filter(None, (policy_value(answer, confidence), answer.assumption)))


def policy_value(answer: Answer, confidence: float) -> str:
    """Say what one policy is worth, beside what the simulator says."""
    ends = (answer.lower, answer.upper)
    level = f"{format_level(confidence)} interval"
    if answer.is_inner:
        level = f"inner bounds of the {level}"
    if answer.is_contradicted and answer.lower is not None:
        sentence = (
            f"Until then all that can be said of “{answer.policy}” is the range that"
            f" reaches over both, {format_interval(*ends)}"
        )
    elif answer.is_nearly_silent and answer.coverage is not None:
        sentence = (
            f"The log covers only {_printing.share(answer.coverage)} of what the policy"
            f" “{answer.policy}” does, so "
        )
        if answer.lower is None:
            sentence += (
                f"its value in the target, about {format_number(answer.value)}, has no"
                " interval"
            )
        else:
            sentence += (
                "its value in the target is known only to be between"
                f" {format_interval(*ends, ' and ')} ({level})"
            )
    else:
        is_of_target = answer.is_from_log or answer.truth is not None
        where = "target" if is_of_target else "simulator"
        sentence = (
            f"In the {where}, the policy “{answer.policy}” is worth about"
            f" {format_value(answer.value, *ends)}"
        )
        if answer.lower is not None:
            sentence += f" ({level}: {format_interval(*ends)})"
    if answer.simulator is not None and answer.is_from_log:
        sentence += f"; the simulator says {format_value(answer.simulator, *ends)}"
        if answer.simulator_error is not None:
            sentence += (
                f" (standard error {format_number(answer.simulator_error, 2)}, because"
                " it was sampled)"
            )
    if answer.truth is not None:
        sentence += f". The exact value, known here, is {format_number(answer.truth)}"
    return f"{sentence}."


def log_cannot_say(policies: Sequence[str], reason: str) -> str:
    """Say that the log cannot say what policies are worth, and why."""
    names = [f"“{name}”" for name in policies]
    if len(names) == 1:
        subject = f"the policy {names[0]} is"
    else:
        subject = f"the policies {_printing.listing(names)} are"
    return f"The log cannot say what {subject} worth in the target: {reason}."


def silent_log(answers: Sequence[Answer]) -> str:
    """Say of which policies the log covers less than half; "" if of none."""
    silent = [answer for answer in answers if answer.is_nearly_silent]
    shares = ", ".join(
        f"{_printing.share(a.coverage or 0.0)} of what “{a.policy}” does"
        for a in silent
    )
    return f"The log covers only {shares}." if silent else ""


# which policy is best


def best_policy(
    best: str,
    following: str,
    n_policies: int,
    margin: tuple[float, float, float],
    confidence: float,
    *,
    overlap: bool,
) -> str:
    """Say which policy is worth most, and by how much.

    ``margin`` is the difference from the following policy with its interval:
    (difference, lower, upper).
    """
    sentence = f"Of {n_policies} policies, “{best}” is worth most in the target."
    if math.isfinite(margin[0]):
        sentence += f" It is better than “{following}” by {format_value(*margin)}"
        sentence += f" ({format_level(confidence)}: {format_interval(*margin[1:])})."
        if overlap:
            sentence += (
                " The difference is known more precisely than either value because both"
                " rest on the same transitions."
            )
    return sentence


def no_best_policy(
    candidates: Sequence[str], n_policies: int, *, are_equal: bool
) -> str:
    """Say that the log cannot name a best policy, or that the candidates are equal."""
    names = _printing.listing([f"“{name}”" for name in candidates])
    others = n_policies - len(candidates)
    less = ""
    if others:
        verb = "is" if others == 1 else "are"
        less = f"; the other {others} {verb} worth less"
    if are_equal:
        return f"{names} are worth the same in the target{less}."
    return f"The log cannot say which of {names} is worth most in the target{less}."


# how sure


def reward_change(effects: Mapping[str, float]) -> str:
    """Say by how much other rewards change the values of policies, at most."""
    largest = max(map(abs, effects.values()), default=math.nan)
    if not math.isfinite(largest):
        return ""
    whose = "value" if len(effects) == 1 else "values"
    most = "" if len(effects) == 1 else "at most "
    return f" In the simulator they change the {whose} by {most}{largest:.2g}."


def verdict_on_simulator(
    z: float,
    rejected: int,
    tested: int,
    *,
    is_rejected: bool,
    left_out: Sequence[str] = (),
) -> str:
    """Say whether the log rejects the simulator: as a whole, then pair by pair.

    ``z`` is the score of all transitions together in standard deviations, ``rejected``
    the number of the ``tested`` pairs that reject the simulator by themselves, and
    ``is_rejected`` whether all together do. Tested are the recorded pairs for which the
    simulator has more than one next state. ``left_out`` are the policies whose interval
    leaves out the simulator's value, which is said where no test rejects: an interval
    adds up what many pairs say of one value, and sees what no single pair shows.
    """
    pairs = f"{tested:,} tested state-action pairs"
    if not is_rejected and not rejected:
        where = f"the {pairs}, neither together (z = {z:.1f}) nor one by one"
        if tested == 1:
            where = f"the one tested state-action pair (z = {z:.1f})"
        if left_out:
            names = _printing.listing([f"“{name}”" for name in left_out])
            one = len(left_out) == 1
            unseen = (
                f"none of the {pairs} differs significantly by itself, and over all of"
                f" them differences may cancel, z = {z:.1f}"
            )
            if tested == 1:
                unseen = (
                    "the one tested state-action pair does not differ significantly, z ="
                    f" {z:.1f}"
                )
            return (
                "The simulator's value lies outside the"
                f" {'interval' if one else 'intervals'} of {names}, which suggests that"
                " the target differs. Go by the interval: it adds up what small"
                f" differences do to the value, and the tests do not see them ({unseen})."
            )
        return (
            f"The data show no significant difference from the simulator in {where}. A"
            " short log cannot show a small one."
        )
    if not is_rejected:
        each = f"{rejected:,} of the {pairs} {'shows' if rejected == 1 else 'show'} it"
        if tested == 1:
            each = "the one tested state-action pair shows it"
        return (
            f"The target differs from the simulator: {each}. Over the whole log, outcomes"
            " that are likely in the simulator are about as frequent as it says (z ="
            f" {z:.1f}), where differences in opposite directions may cancel."
        )
    sign = "less" if z < 0 else "even more"
    whole = (
        "The target differs from the simulator: what the simulator calls likely happens"
        f" {sign} often than it says (z = {z:.1f} standard deviations, over all recorded"
        " transitions together)."
    )
    if tested == 1:
        return f"{whole} All are of one state-action pair."
    if not rejected:
        return (
            f"{whole} No single one of the {pairs} has enough transitions to show it by"
            " itself, in a test that allows for looking at all of them."
        )
    if rejected == tested:
        return f"{whole} Each of the {pairs} differs surely by itself."
    verb = "differs" if rejected == 1 else "differ"
    by = "itself" if rejected == 1 else "themselves"
    return f"{whole} {rejected:,} of the {pairs} {verb} surely by {by}."


def distance_from_simulator(
    whole: float, rejecting: float, recorded: float, unrecorded: float
) -> str:
    """Say in which pairs a corrected value differs from the simulator's.

    ``whole`` is the difference; the others are its parts in the pairs that reject the
    simulator one by one, in other recorded pairs, and in pairs never recorded.
    """
    width = max(abs(whole), abs(rejecting), abs(recorded), abs(unrecorded))

    def write(part: float) -> str:
        """Write a part with two digits of the largest."""
        return format_value(part, 0.0, width) if part else "0"

    parts = [
        (rejecting, "comes from pairs that reject the simulator one by one"),
        (recorded, "from other recorded pairs"),
        (unrecorded, "from pairs that were never recorded"),
    ]
    told = ", ".join(f"{write(part)} {where}" for part, where in parts)
    return (
        "The corrected simulator's value differs from the simulator's by"
        f" {write(whole)}: {told}."
    )


def unmet(share: float, pair: str) -> str:
    """Say where the samples of a simulator say nothing, and what to do.

    ``share`` is that of the policy's time, ``pair`` the name of the pair with the most.
    """
    return (
        f"The policy spends {_printing.share(share)} of its time where neither the"
        f" simulator's samples nor the log show what follows, most of it in {pair}: the"
        " interval lets it lead anywhere. If episodes are over there, make the simulator"
        " anew of samples that say so (--column terminated=LABEL), or that have rows"
        " which lead from this state back to it."
    )


def assumption(
    factor: float,
    unrecorded: int,
    share: float | None,
    as_estimated: tuple[float, float] | None,
    anything: tuple[float, float] | None,
    *,
    has_box: bool = False,
) -> str:
    """Say what an interval lets the pairs do that were never recorded.

    ``factor`` is that of ``interval``. ``as_estimated`` and ``anything`` are the
    intervals at its two ends, where they are to be told. ``has_box`` says that the user
    bounded all ratios.
    """
    is_one = unrecorded == 1
    pairs = "One state-action pair was"
    where = "it"
    if not is_one:
        pairs = f"{unrecorded:,} state-action pairs were"
        where = "them"
    of_time = ""
    if share is not None:
        time = _printing.share(share)
        of_time = f", and the policy spends {time} of its time in {where}"
    probabilities = "its probabilities" if is_one else "their probabilities"
    if factor == 1.0:
        rule = f"The interval takes {probabilities} as estimated"
    elif math.isinf(factor):
        rule = f"The interval lets {probabilities} be anything"
        if has_box:
            rule += " that the box allows"
    else:
        rule = (
            f"The interval assumes that {probabilities} are within a factor of"
            f" {write_factor(factor)} of the estimated ones"
        )
    ends = []
    if as_estimated is not None:
        ends.append(f"if they are as estimated, it is {format_interval(*as_estimated)}")
    if anything is not None:
        worst = format_interval(*anything)
        ends.append(f"if they can be anything, {'' if ends else 'it is '}{worst}")
    sentences = [f"{pairs} never recorded{of_time}", rule]
    if ends:
        told = "; ".join(ends)
        sentences.append(f"{told[0].upper()}{told[1:]}")
    return f"{'. '.join(sentences)}."


def write_factor(factor: float) -> str:
    """Write a small whole number as a word."""
    words = {2.0: "two", 3.0: "three", 4.0: "four", 5.0: "five", 10.0: "ten"}
    return words.get(factor, f"{factor:g}")


def without_dropped(lower: float, upper: float) -> str:
    """Say what the interval would be without dropped transitions."""
    return (
        "The interval lets dropped transitions lead anywhere; without them it is"
        f" {format_interval(lower, upper)}."
    )


def stopped(what: str, seconds: float) -> str:
    """Say that the ends of an interval, or of its worst case, are inner bounds."""
    return (
        f"The search for the ends of the {what} was stopped after {seconds:.3g} s"
        " (interval_seconds=, --interval-seconds): they are inner bounds, and the"
        f" {what} is at least as wide."
    )


# trials


def both_sources(
    mean: float,
    trials: tuple[float, float],
    log: tuple[float, float],
    number: float,
    confidence: float,
) -> str:
    """Say what the trials say alone, and what simulator and log say without them."""
    level = format_level(confidence)
    return (
        f"The {count_trials(number)} alone say {format_value(mean, *trials)} ({level}"
        f" interval: {format_interval(*trials)}); the simulator, corrected by the log,"
        f" says {format_within(log, trials)}."
    )


def worth_of_both(worth: float) -> str:
    """Say how many trials alone would give as narrow an interval, and of which kind."""
    return (
        "Simulator, log and trials together are as precise as about"
        f" {count_up(worth, 'trial')} alone would be."
    )


def halve_interval(trials: float, transitions: float) -> str:
    """Say how many more trials, or transitions, halve the interval."""
    return (
        f"About {count_up(trials, 'more trial')}, or"
        f" {count_up(transitions, 'more transition')} recorded like the log's, would halve"
        " the interval of simulator, log and trials together."
    )


def contradiction(
    policy: str,
    trials: tuple[float, float],
    log: tuple[float, float],
    p_value: float | None,
    level: float,
) -> str:
    """Say that the trials of a policy contradict the log.

    Without a ``p_value`` it is their intervals of confidence ``level`` that are apart.
    """
    shown = f"their {100 * level:.4g}% intervals are apart"
    if p_value is not None:
        shown = "p < 0.0001" if p_value < 1e-4 else f"p = {p_value:.2g}"
        shown += f", below {level:g}"
    return (
        f"The trials of “{policy}” and the log contradict each other ({shown}):"
        f" the trials say {format_interval(*trials)}, the log says"
        f" {format_within(log, trials)}. One of them may be of another target, of other"
        " first states or of another policy. Find out which one before either is used."
    )


def format_within(ends: tuple[float, float], other: tuple[float, float]) -> str:
    """Write an interval with the digits of another; one number if the ends agree."""
    lower, upper = (format_value(end, *other) for end in ends)
    return lower if lower == upper else f"{lower} to {upper}"


def count_trials(number: float) -> str:
    """Write a number of trials; of weighted ones how many equal ones they are worth."""
    if number == round(number):
        return count(round(number), "trial")
    return f"trials (worth {number:.3g} of equal weight)"


def round_up(number: float) -> str:
    """Write a number of trials or transitions with two digits, at least 1."""
    whole = max(math.ceil(number), 1)
    size = 10 ** max(len(str(whole)) - 2, 0)
    return f"{math.ceil(whole / size) * size:,}"


def count_up(number: float, noun: str) -> str:
    """Write so many of something, as ``round_up`` writes the number."""
    written = round_up(number)
    return f"{written} {noun}" if written == "1" else f"{written} {noun}s"


# the table


def legend(
    method: str, rows: Sequence[str], confidence: float, meaning: str | None = None
) -> str:
    """Say what the intervals of some rows are; without a meaning, that of the method.

    A row is named by its estimator, and by its policy where others differ.
    """
    about = METHODS.get(method, method) if meaning is None else meaning
    return (
        f"{format_level(confidence)} interval of {', '.join(rows)} ({method}): {about}"
    )


def interval_kinds(methods: Sequence[str], confidence: float) -> str:
    """Say of which kind the intervals of the answer are; "" where there are none."""
    quantile = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    errors = f"value ± {quantile:.3g} standard errors"
    is_one = len(methods) == 1
    likelihood = "a likelihood interval" if is_one else "likelihood intervals"
    names = {
        "likelihood": likelihood,
        "likelihood with trials": f"{likelihood} of log and trials together",
        "trials": "of the trials alone",
        "refits": "value ± standard errors from resampled episodes",
        "the estimator's own": "the estimator's own",
        **dict.fromkeys((*SYMMETRIC, "calibrated"), errors),
    }
    kinds = list(
        dict.fromkeys(
            names.get(method, method.replace("likelihood", likelihood, 1))
            for method in methods
        )
    )
    if not kinds:
        return ""
    *first, last = kinds
    listed = f"{', '.join(first)} or {last}" if first else last
    return f"The answer's {'interval is' if is_one else 'intervals are'} {listed}."


def omissions(rows: int) -> str:
    """Say how many rows a report leaves out; "" where there are none."""
    if not rows:
        return ""
    return f"{count(rows, 'more row')} with --all (in Python: to_text(all=True))."


def left_out(notes: int, rows: int, hidden: int) -> str:
    """Say what a short report leaves out and how to see it; "" where that is nothing.

    ``notes`` and ``rows`` are shown with --verbose, ``hidden`` rows with --all.
    """
    more = []
    if notes:
        more.append(count(notes, "less important note"))
    if rows:
        more.append(f"a table of {count(rows, 'row')} by estimator")
    parts = []
    options = []
    if more:
        parts.append(f"{' and '.join(more)} (--verbose)")
        options.append("verbose=True")
    if hidden:
        parts.append(f"{count(hidden, 'row')} of other estimators (--all)")
        options.append("all=True")
    if not parts:
        return ""
    told = "; ".join(parts)
    return f"Not shown: {told}; in Python: report.to_text({', '.join(options)})."


def provenance(
    counts: tuple[int | None, int | None],
    names: tuple[str | None, str | None],
    trials: Mapping[str, int] | None = None,
) -> str:
    """Say what a value was made from; "" where nothing is known.

    ``counts`` are the numbers of transitions and of states, ``names`` are those of the
    log and of the simulator: each None where it is not known. ``trials`` are the numbers of trials
    by policy.
    """
    sizes = [
        None if number is None else count(number, unit)
        for number, unit in zip(counts, ("transition", "state"), strict=True)
    ]
    parts = []
    sources = ("the log that was recorded in the target", "the simulator")
    for what, name, size in zip(sources, names, sizes, strict=True):
        about = ", ".join(filter(None, (name, size)))
        if about:
            parts.append(f"{what} ({about})")
    if trials:
        parts.append(tried(trials))
    if not parts:
        return ""
    listed = _printing.listing(parts)
    return f"Made from {listed}."


def tried(trials: Mapping[str, int]) -> str:
    """Say how many trials there are, and of which policies."""
    total = count(sum(trials.values()), "trial")
    if len(trials) == 1:
        return f"{total} of “{next(iter(trials))}”"
    each = ", ".join(f"{number:,} of “{name}”" for name, number in trials.items())
    return f"{total} ({each})"
