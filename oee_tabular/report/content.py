"""The content of a report: one data object of which every form of it is a view.

Rows, answers, comparison, trials, intervals, notes and facts are here as data, in the
report's unit. Text (``tables``), page (``page``), notebook, JSON and CSV only lay them
out; ``columns`` says which columns a table has, and ``text`` has the sentences.
"""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from oee_tabular import __version__
from oee_tabular.data import TransitionCounts
from oee_tabular.estimators.findings import MAX_UNREAD_SHARE
from oee_tabular.estimators.rewards import reward_effect
from oee_tabular.inference import Interval
from oee_tabular.inference.trials import METHOD as JOINED
from oee_tabular.inference.trials import trials_by_policy
from oee_tabular.report import text
from oee_tabular.report.files import plain
from oee_tabular.report.notes import Note, rank_notes
from oee_tabular.report.rows import Result, first_results
from oee_tabular.report.text import Answer
from oee_tabular.report.uncertainty import LIKELIHOOD, OWN, ROLLOUTS

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

Record = dict[str, Any]
PLAN_FILE = "next.csv"  # which a plan's command writes, with the names of states
# of half an interval: rewards of the log that change a value by less are not named
# first
NEGLIGIBLE_SHARE = 0.05
# columns of the report's own that (1 - discount) multiplies; diagnostics know theirs
VALUES = {
    "value",
    "standard_error",
    "lower",
    "upper",
    "sampling_lower",
    "sampling_upper",
    "worst_case_lower",
    "worst_case_upper",
    "less_by",
    "less_by_lower",
    "less_by_upper",
    "mean",
    "trials_lower",
    "trials_upper",
    "log_lower",
    "log_upper",
    "true_value",
    "error",
}


@dataclass(frozen=True, eq=False)
class Content:
    """Hold what a report says, in the report's unit.

    Attributes
    ----------
    brief : str
        The answer in a sentence or two.
    headline : str
        The answer, and what its interval assumes.
    unit : str
        What a value is, as a formula.
    meaning : str
        What a value is, in words.
    confidence : float
        The level of the intervals.
    records : list of dict
        A row for each policy and estimator, as ``Report.records`` returns them.
    shown : list of dict
        The rows that a short table does not leave out.
    answers : list of Answer
        What there is to say of each policy.
    comparison : list of dict
        A row for each policy, best first; empty for a single policy.
    truth : dict of str to float
        The exact value of each policy, where it is known.
    legend : list of str
        What each interval of the shown rows is.
    kind : str
        Of which kind the intervals of the answer are, in a sentence.
    details : tuple of str
        The sentences on how certain the values are, and on what to record next.
    notes : list of Note
        Every note, the one that a reader needs first at the front.
    warnings : tuple of str
        The sentences of the notes on rows and data, as they are numbered in the rows.
    about_rows : frozenset of int
        The numbers, from 1, of the warnings that are about rows.
    facts : dict of str to value
        What simulator, log and rewards are.
    task : str or None
        The name of a continuous task.
    sizes : (int or None, int or None)
        The numbers of transitions and of states; None where there is no such number,
        as of the states of a continuous task.
    tried : dict of str to int
        The number of trials of each policy that was tried.
    plan_command : str
        What plans the next recording, ready to be typed; "" where nothing does.
    """

    brief: str
    headline: str
    unit: str
    meaning: str
    confidence: float
    records: list[Record]
    shown: list[Record]
    answers: list[Answer]
    comparison: list[Record]
    truth: Mapping[str, float]
    legend: list[str]
    kind: str
    details: tuple[str, ...]
    notes: list[Note]
    warnings: tuple[str, ...]
    about_rows: frozenset[int]
    facts: Mapping[str, Any]
    task: str | None
    sizes: tuple[int | None, int | None]
    tried: Mapping[str, int]
    plan_command: str


def gather_content(report: Report) -> Content:
    """Gather what a report says, once for all its forms."""
    problem = report.problem
    sizes: tuple[int | None, int | None] = (None, None)
    if report.source is not None:
        sizes = (report.source.n_transitions, None)
    tried = {}
    if problem is not None:
        by_policy = trials_by_policy(problem, report.policies)
        tried = {name: len(trials) for name, trials in by_policy.items()}
        transitions = round(float(problem.counts.sum()))
        sizes = (transitions, problem.simulator.n_states)
    shown = report.rows()
    numbers = (k for numbers in report.notes.values() for k in numbers)
    return Content(
        brief=write_headline(report, text.policy_value),
        headline=write_headline(report, text.policy_worth),
        unit=report.unit,
        meaning=report.meaning,
        confidence=report.confidence,
        records=report.records(),
        shown=shown,
        answers=report.answers,
        comparison=report.comparison(),
        truth={name: exact * report.scale for name, exact in report.truth.items()},
        legend=report.legend(shown),
        kind=text.interval_kinds(stated_methods(report), report.confidence),
        details=report.uncertainty.details,
        notes=rank_notes(report),
        warnings=report.warnings,
        about_rows=frozenset(numbers),
        facts=report.facts,
        task=None if report.source is None else report.source.task,
        sizes=sizes,
        tried=tried,
        plan_command=write_plan_command(report),
    )


# ---- the next recording


def write_plan_command(report: Report) -> str:
    """Write what plans the next recording, ready to be typed.

    It is the command in the files' own names, with the options by which they were read,
    or the call in Python; "" where neither can plan (a continuous task's log, the
    probability of success).
    """
    facts = report.facts
    if report.problem is None or "success" in facts:
        return ""
    n = max(1, int(report.problem.counts.sum()))
    if "policy_names" not in facts:
        if "simulator_name" in facts:
            return ""
        wanted = ", ".join(f"{name!r}: ..." for name in report.policies)
        return f"oee.plan_data_collection(problem, {{{wanted}}}, n={n})"
    names = facts["policy_names"]
    files = facts.get("log_files", [facts.get("log_name")])
    columns = facts.get("column_options", [])
    # facts may be a user's own, of any form
    is_a_command_s = isinstance(names, Mapping) and "simulator_name" in facts
    if not is_a_command_s or not all(
        isinstance(x, list | tuple) for x in (files, columns)
    ):
        return ""
    words = ["oee", "plan", "--simulator", str(facts["simulator_name"])]
    for file in files:
        words += ["--log", str(file)]
    for column in columns:
        words += ["--column", str(column)]
    for name, spec in names.items():
        words += ["--policy", str(spec) if name == spec else f"{name}={spec}"]
    options = {
        "horizon": report.horizon,
        **{name: facts.get(name) for name in ("initial", "discount", "impossible")},
    }
    options["action-noise"] = facts.get("action_noise") or None
    options["box"] = facts.get("box")
    options["confidence"] = None if report.confidence == 0.95 else report.confidence
    for name, value in options.items():
        # a value that begins with a dash would be read as an option
        if str(value).startswith("-"):
            words.append(f"--{name}={value}")
        elif value is not None:
            words += [f"--{name}", str(value)]
    return shlex.join([*words, "--transitions", str(n), "--output", PLAN_FILE])


# ---- rows


def make_answers(report: Report) -> list[Answer]:
    """Return what there is to say of each policy, in the order of the results.

    The value is the one that the log corrects, where there is one, with its
    interval.
    """
    answers = []
    tried = report.uncertainty.trials
    for policy, first in first_results(report.results).items():
        row = make_record(report, first)
        simulator = record_of_simulator(report, policy)
        # the noise of rollouts is small, and says nothing against the simulator
        is_by_rollouts = simulator.get("standard_error_of") == ROLLOUTS
        likelihood = report.uncertainty.intervals.get(policy, {}).get(LIKELIHOOD)
        unrecorded = 0
        if likelihood is not None:
            unrecorded = int(likelihood.diagnostics.get("unrecorded_pairs", 0))
        assumption = ""
        is_inner = False
        if row["interval_method"] in (LIKELIHOOD, JOINED):
            assumption = report.uncertainty.assumptions.get(policy, "")
            about = {} if likelihood is None else likelihood.diagnostics
            is_inner = about.get("inner_bounds_of") == "interval"
        answers.append(
            Answer(
                policy,
                row["estimator"],
                row["value"],
                row["lower"],
                row["upper"],
                row["interval_method"],
                simulator.get("value"),
                None if is_by_rollouts else simulator.get("standard_error"),
                row["true_value"],
                row.get("coverage"),
                unrecorded,
                assumption,
                is_inner,
                first.estimate.is_from_log,
                policy in tried and tried[policy].is_contradicted,
            )
        )
    return answers


def record_of_simulator(report: Report, policy: str) -> dict[str, Any]:
    """Return the first record of a policy that uses the simulator alone, or {}."""
    for result in report.results:
        if result.policy == policy and not result.estimate.is_from_log:
            return make_record(report, result)
    return {}


def make_record(report: Report, result: Result) -> dict[str, Any]:
    """Return one result as a row, in the report's unit."""
    estimate = result.estimate
    truth = report.truth.get(result.policy)
    method = estimate.diagnostics.get("interval_method", OWN)
    lower, upper = estimate.interval or (None, None)
    likelihood = None
    if method == LIKELIHOOD:
        likelihood = report.uncertainty.likelihood.get(result.policy)
    elif method == JOINED and result.policy in report.uncertainty.trials:
        likelihood = report.uncertainty.trials[result.policy].interval
    row = {
        "policy": result.policy,
        "estimator": result.estimator,
        "value": estimate.value,
        "standard_error": estimate.standard_error,
        "lower": lower,
        "upper": upper,
        **end_columns(likelihood),
        "interval_method": None if lower is None else method,
        "true_value": truth,
        "error": None if truth is None else estimate.value - truth,
        "status": estimate.status,
        "notes": list(report.notes.get((result.policy, result.estimator), ())),
    }
    row = scale_row(report, row)
    # diagnostics stand after the columns, and never replace one of them
    return {**row, **estimate.diagnostics.scaled(report.scale), **row}


def scale_row(report: Report, row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row whose values are multiplied by the report's scale."""
    return {
        key: x * report.scale if key in VALUES and x is not None else x
        for key, x in row.items()
    }


def make_trials(report: Report) -> list[Record]:
    """Return the rows of ``Report.trials``."""
    rows = []
    for policy, both in report.uncertainty.trials.items():
        row = {
            "policy": policy,
            "value": both.value,
            "lower": both.interval.lower,
            "upper": both.interval.upper,
            "number": both.number,
            "mean": both.mean,
            "trials_lower": both.trials[0],
            "trials_upper": both.trials[1],
            "log_lower": both.log.lower,
            "log_upper": both.log.upper,
            "p_value": both.p_value,
            "worth": both.worth,
            "more_trials": both.more_trials,
            "more_transitions": both.more_transitions,
        }
        rows.append(scale_row(report, row))
    return rows


def make_comparison(report: Report) -> list[Record]:
    """Return the rows of ``Report.comparison``."""
    compared = report.uncertainty.comparison
    decision = report.uncertainty.decision
    if compared is None or decision is None:
        return []
    known = report.uncertainty.likelihood
    best = compared.names[0]
    table = []
    for k, policy in enumerate(compared.names):
        estimate = report.uncertainty.default.get(policy)
        lower, upper = (estimate and estimate.interval) or (None, None)
        row: dict[str, Any] = {
            "policy": policy,
            "value": float(compared.values[k]),
            "lower": lower,
            "upper": upper,
            **end_columns(known.get(policy)),
            "probability_best": decision.probability_best[policy],
            "unrecorded_share": float(compared.unrecorded_share[k]),
            "less_by": None,
            "less_by_lower": None,
            "less_by_upper": None,
        }
        if k > 0:
            less = float(compared.differences[0, k])
            ends = compared.bounds(best, policy, known)
            row["less_by"] = less
            if math.isfinite(ends[0]):
                row["less_by_lower"] = min(ends[0], less)
                row["less_by_upper"] = max(ends[1], less)
        table.append(scale_row(report, row))
    return table


def interval_columns(interval: Interval) -> dict[str, Any]:
    """Return an interval as columns of a table."""
    return {
        "lower": interval.lower,
        "upper": interval.upper,
        **end_columns(interval),
        "confidence": interval.confidence,
        "status": interval.status,
    }


def end_columns(interval: Interval | None) -> dict[str, float | None]:
    """Return the intervals at both ends of the factor of unrecorded pairs, as columns.

    They are None where there is no such interval.
    """
    sampling: tuple[float | None, float | None] = (None, None)
    anything: tuple[float | None, float | None] = (None, None)
    if interval is not None:
        sampling = interval.sampling or sampling
        anything = interval.worst_case or anything
    return {
        "sampling_lower": sampling[0],
        "sampling_upper": sampling[1],
        "worst_case_lower": anything[0],
        "worst_case_upper": anything[1],
    }


# ---- what the intervals of rows are


def explain_intervals(
    report: Report, rows: Sequence[Mapping[str, Any]]
) -> list[tuple[str, str, list[str]]]:
    """Return each kind of interval with its meaning and the rows that have it.

    A row is named by its estimator; where that has intervals of several kinds, with its
    policies.
    """
    kinds: dict[tuple[str, str], dict[str, list[str]]] = {}
    for row in rows:
        method = row["interval_method"]
        if method is not None:
            kind = (str(method), explain_interval(report, row))
            members = kinds.setdefault(kind, {})
            policies = members.setdefault(str(row["estimator"]), [])
            policies.append(f"“{row.get('policy')}”")
    seen = Counter(estimator for members in kinds.values() for estimator in members)
    return [
        (
            method,
            meaning,
            [
                f"{name} of {', '.join(policies)}" if seen[name] > 1 else name
                for name, policies in members.items()
            ],
        )
        for (method, meaning), members in kinds.items()
    ]


def explain_interval(report: Report, row: Mapping[str, Any]) -> str:
    """Say what the interval of a row is, from how it was made."""
    method = str(row["interval_method"])
    meaning = text.METHODS.get(method, method)
    is_cut = False
    if method == LIKELIHOOD:
        found = report.uncertainty.likelihood.get(str(row.get("policy")))
        if found is not None:
            if not is_searched(found):
                is_widened = found.diagnostics["unrecorded_factor"] != 1.0
                meaning = text.WIDENED if is_widened else text.AS_ESTIMATED
            facts = found.diagnostics
            is_cut = "uncut_lower" in facts or "uncut_upper" in facts
    elif method in text.SYMMETRIC and row.keys() >= {"value", "lower", "upper"}:
        below = float(row["value"] - row["lower"])
        above = float(row["upper"] - row["value"])
        rounding = 1e-9 * abs(float(row["value"]))
        is_cut = not math.isclose(below, above, rel_tol=1e-6, abs_tol=rounding)
    return meaning + text.CUT if is_cut else meaning


def is_searched(interval: Interval) -> bool:
    """Say whether the ends of a likelihood interval were found by a search.

    Then they are the last values that the log does not reject. Others are a value and
    standard errors: where the policy reaches pairs that were never recorded, at a
    finite factor, and where the search was left out.
    """
    facts = interval.diagnostics
    if "divergence" not in facts:
        return False
    if interval.sampling is None or math.isinf(facts["unrecorded_factor"]):
        return True
    if facts["unrecorded_factor"] == 1.0:
        return "sampling_method" not in facts
    return not facts["unrecorded_pairs"]


# ---- the answer


def stated_methods(report: Report) -> list[str]:
    """Return the methods of the intervals that the answer states."""
    silent = report.uncertainty.unanswered
    return [
        answer.method
        for answer in report.answers
        if answer.method is not None
        and math.isfinite(answer.value)
        and answer.policy not in silent
        and not answer.is_contradicted
    ]


def write_headline(report: Report, write: Callable[[Answer, float], str]) -> str:
    """Write the headline, with a sentence by ``write`` about a single policy."""
    silent = report.uncertainty.unanswered
    answers = [
        answer
        for answer in report.answers
        if math.isfinite(answer.value) and answer.policy not in silent
    ]
    if not answers:
        return report.uncertainty.caveat or text.NO_VALUE
    sentences = [write(answer, report.confidence) for answer in answers]
    if len(report.answers) > 1 and report.uncertainty.ranking:
        sentences = [text.silent_log(answers), report.uncertainty.ranking]
    sentences.insert(0, report.uncertainty.caveat)
    # rewards of the log cannot contradict the log
    conflict = None
    if report.problem is not None and report.problem.rewards != "log":
        conflict = report.problem.reward_conflict
    if conflict is not None and not _is_conflict_small(report, answers):
        where = str(conflict)
        where = f"{where[0].upper()}{where[1:]}"
        sentences.insert(0, text.REWARD_CONFLICT.format(where))
    sentences.insert(0, _lost_rows(report))
    return " ".join(filter(None, sentences))


def _lost_rows(report: Report) -> str:
    """Return which part of the log could not be read, empty where it is small."""
    log = report.problem.log if report.problem is not None else None
    if not isinstance(log, TransitionCounts):
        return ""
    lost = log.recording.dropped
    share = lost / max(lost + len(log), 1)
    if share <= MAX_UNREAD_SHARE:
        return ""
    return text.ROWS_LOST.format(rows=lost, all=lost + len(log), share=share)


def _is_conflict_small(report: Report, answers: Sequence[Answer]) -> bool:
    """Say whether the log's rewards are rounded, or matter to no value."""
    problem = report.problem
    if problem is None or problem.reward_conflict is None:
        return True
    if problem.reward_conflict.is_rounding:
        return True
    for answer in answers:
        known = answer.policy in report.policies
        if answer.lower is None or answer.upper is None or not known:
            return False
        width = 0.5 * (answer.upper - answer.lower)
        effect = reward_effect(problem, report.policies[answer.policy]) * report.scale
        if not abs(effect) <= NEGLIGIBLE_SHARE * width:
            return False
    return True


# ---- JSON


def make_dict(report: Report) -> Record:
    """Return everything as plain values, as ``Report.to_dict`` describes it."""
    found = {
        "version": __version__,
        "answer": report.answer,
        "unit": report.unit,
        "discount": report.discount,
        "horizon": report.horizon,
        "normalized": report.normalized,
        "confidence": report.confidence,
        "interval": report.legend(report.records()),
        "seed": report.seed if isinstance(report.seed, int) else None,
        "facts": dict(report.facts),
        "results": report.records(),
        "intervals": [
            scale_row(
                report, {"policy": policy, "method": method, **interval_columns(found)}
            )
            for policy, methods in report.uncertainty.intervals.items()
            for method, found in methods.items()
        ],
        "best": report.best,
        "comparison": report.comparison(),
        "trials": report.trials(),
        "conclusion": list(report.uncertainty.sentences),
        "warnings": list(report.warnings),
    }
    return {key: plain(value) for key, value in found.items()}
