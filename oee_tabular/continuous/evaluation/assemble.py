"""The last step of an evaluation: the rows' values, put together as a report.

Without cells every row stands beside its own interval. On cells the finite problem's
report takes the rows as estimators of policies that are tables.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from oee_tabular import _checks, _progress
from oee_tabular.continuous.evaluation.on_cells import OnCells
from oee_tabular.continuous.evaluation.prepare import Prepared
from oee_tabular.continuous.evaluation.rollouts import GUESSED, MAX_GUESSED_SHARE
from oee_tabular.continuous.evaluation.rows import ReportRow, Rows
from oee_tabular.continuous.evaluation.simulator import Calibration
from oee_tabular.continuous.task.base import StatePolicy
from oee_tabular.continuous.task.episodes import MonteCarlo
from oee_tabular.estimators import Estimate, Estimator, Problem
from oee_tabular.exceptions import ArgumentError
from oee_tabular.report import (
    Report,
    Result,
    Source,
    Uncertainty,
    choose_interval,
    evaluate,
    group_findings,
    is_of_correction,
    kinds_of_findings,
    log_cannot_say,
    number_notes,
)
from oee_tabular.typing import Array, IntArrayLike, RealArrayLike, SeedNumbers

REFUSED = "in the corrected simulator its value of {}"
TOO_QUIET = (
    "Most often the log's states and commands vary too little to fix the correction:"
    " record with noise on the commands, and from several starts."
)


@dataclass(frozen=True)
class Premises:
    """What is known of the target's transitions beside the log; it needs cells.

    Attributes
    ----------
    lower_ratio : float or None
        A lower bound of the target's transition probabilities over the simulator's.
    upper_ratio : float or None
        An upper bound of them.
    tie : array_like of int or None
        A key of each transition, as in ``transition_ratio``.
    features : array_like or None
        Features of each transition.
    """

    lower_ratio: float | None = None
    upper_ratio: float | None = None
    tie: IntArrayLike | None = None
    features: RealArrayLike | None = None


@dataclass(frozen=True)
class Layout:
    """How a report is to be computed and printed.

    Attributes
    ----------
    confidence : float
        The level of the intervals.
    normalized : bool
        Whether values are multiplied by (1 - discount).
    guaranteed : bool
        Whether the intervals that cover at any sample size are computed.
    quick : bool
        Whether likelihood intervals are left out.
    calibration : {'ratio', 'difference', 'none'}
        How the value on cells is calibrated.
    facts : mapping
        More to keep in the report's ``facts``.
    """

    confidence: float
    normalized: bool
    guaranteed: bool
    quick: bool
    calibration: Calibration
    facts: Mapping[str, Any]


@dataclass(frozen=True)
class Sentences:
    """What is said of the whole.

    Attributes
    ----------
    distance : tuple of str
        How the target differs from the simulator, and what was taken for it.
    doubt : str
        Why no correction can be trusted, or "".
    messages : tuple of str
        Notes on the log, the policies and the estimators.
    """

    distance: tuple[str, ...]
    doubt: str
    messages: tuple[str, ...]


def assemble_rows(
    prepared: Prepared,
    rows: Rows,
    sentences: Sentences,
    premises: Premises,
    layout: Layout,
) -> Report:
    """Return the report of rows without a finite problem."""
    _require_no_premises(**vars(premises))
    facts = {
        "simulator": f"{prepared.simulator.name}, without cells",
        "log": repr(prepared.given_log),
        **layout.facts,
    }
    report = _report_rows(
        prepared.policies,
        {name: row.estimate for name, row in rows.every().items()},
        prepared.horizon,
        prepared.discount,
        facts,
        seed=prepared.seed,
        confidence=layout.confidence,
        normalized=layout.normalized,
        guaranteed=layout.guaranteed,
        quick=layout.quick,
    )
    caveat, unanswered = _doubt_values(report, sentences)
    uncertainty = Uncertainty(
        distance=_describe_distance(report, sentences),
        caveat=caveat,
        unanswered=unanswered,
    )
    messages = (*report.warnings, *sentences.messages)
    source = Source(prepared.simulator.name, len(prepared.given_log))
    return replace(report, warnings=messages, uncertainty=uncertainty, source=source)


def assemble_on_cells(
    prepared: Prepared,
    cells: OnCells,
    rows: Rows,
    finite: Mapping[str, Estimator],
    sentences: Sentences,
    premises: Premises,
    layout: Layout,
) -> Report:
    """Return the report of a finite problem on cells, with the rows as estimators.

    ``finite`` are the estimators of finite problems.
    """
    # policies by their tables on the cells, which are all that finite estimators take
    known = {
        table.tobytes(): prepared.policies[name]
        for name, table in prepared.tables.items()
    }

    def simulate(table: Array) -> MonteCarlo:
        """Estimate the value of a policy's table on the cells, in the simulator."""
        return rows.simulate(known[np.asarray(table).tobytes()])

    def on_tables(some: list[ReportRow]) -> dict[str, Estimator]:
        """Return rows as estimators of policies on the cells."""
        return {row.name: partial(_evaluate_table, row, known) for row in some}

    every = on_tables(rows.first)
    kind = layout.calibration
    if rows.has_oee and kind != "none":
        scale = 1.0 - prepared.discount if layout.normalized else 1.0
        every["oee (calibrated)"] = cells.calibrated(simulate, kind, scale)
    every |= on_tables(rows.others)
    every |= cells.others(finite)
    every |= on_tables(rows.target)
    report = evaluate(
        cells.problem,
        prepared.tables,
        estimators=every,
        confidence=layout.confidence,
        seed=prepared.seed,
        normalized=layout.normalized,
        facts={**cells.facts, **layout.facts},
        guaranteed=layout.guaranteed,
        quick=layout.quick,
        lower_ratio=premises.lower_ratio,
        upper_ratio=premises.upper_ratio,
        tie=premises.tie,
        features=premises.features,
    )
    loss = cells.describe_loss(simulate, prepared.tables)
    caveat, unanswered = _doubt_values(report, sentences)
    uncertainty = replace(
        report.uncertainty,
        next=cells.add_features(report.uncertainty.next),
        distance=(
            *_describe_distance(report, sentences),
            *report.uncertainty.distance,
        ),
        caveat=caveat,
        unanswered=unanswered,
    )
    messages = (*report.warnings, *sentences.messages, loss)
    texts = tuple(map(cells.add_features, messages))
    return replace(report, warnings=texts, uncertainty=uncertainty)


def _doubt_values(report: Report, sentences: Sentences) -> tuple[str, tuple[str, ...]]:
    """Return why the log cannot say the values of some policies, and which ones."""
    names = list(dict.fromkeys(result.policy for result in report.results))
    if sentences.doubt:
        return log_cannot_say(names, sentences.doubt), tuple(names)
    shares: dict[str, float] = {}
    for result in report.results:
        share = result.estimate.diagnostics.get("beyond_log")
        if share is not None and result.policy not in shares:
            shares[result.policy] = share
    guessed = [name for name in names if shares.get(name, 0.0) > MAX_GUESSED_SHARE]
    caveats = [
        log_cannot_say([name], GUESSED.format(f"{shares[name]:.0%}"))
        for name in guessed
    ]
    for name, status in _refused_values(report).items():
        if name not in guessed:
            guessed.append(name)
            caveats.append(log_cannot_say([name], REFUSED.format(status)))
    return " ".join(caveats), tuple(guessed)


def _describe_distance(report: Report, sentences: Sentences) -> tuple[str, ...]:
    """Return how the target differs, behind what to do where a value is refused."""
    if sentences.doubt or not _refused_values(report):
        return sentences.distance
    return (TOO_QUIET, *sentences.distance)


def _refused_values(report: Report) -> dict[str, str]:
    """Return why policies have no value in the corrected simulator, by their names."""
    first: dict[str, Result] = {}
    for result in report.results:
        if is_of_correction(result.estimator):
            first.setdefault(result.policy, result)
    return {
        name: result.estimate.status
        for name, result in first.items()
        if "refused_value" in result.estimate.diagnostics
    }


def _evaluate_table(
    row: ReportRow,
    known: Mapping[bytes, StatePolicy],
    problem: Problem,
    table: Array,
    *,
    seed: SeedNumbers = None,
) -> Estimate:
    """Evaluate a row for a policy that is given by its table on the cells."""
    return row.estimate(known[np.asarray(table).tobytes()])


def _require_no_premises(**premises: object) -> None:
    """Raise a ValueError for what is known of the target but needs cells."""
    lower = premises["lower_ratio"]
    if lower is not None:
        _checks.number_in(lower, "lower_ratio", 0.0, 1.0)
    upper = premises["upper_ratio"]
    if upper is not None:
        _checks.number_in(upper, "upper_ratio", 1.0, np.inf, infinite=True)
    for name, value in premises.items():
        if value is not None:
            raise ArgumentError(
                name,
                "must be left out without cells: it is about the transitions of a"
                " finite simulator",
            )


def _report_rows(
    policies: Mapping[str, StatePolicy],
    rows: Mapping[str, Callable[[StatePolicy], Estimate]],
    horizon: int,
    discount: float,
    facts: Mapping[str, Any],
    *,
    seed: SeedNumbers = None,
    confidence: float = 0.95,
    normalized: bool = False,
    guaranteed: bool = False,
    quick: bool = False,
) -> Report:
    """Return the report of rows without a finite problem.

    Each row stands beside its own interval.
    """
    level = _checks.number_in(confidence, "confidence", 0.0, 1.0, open_ends=True)
    if _checks.boolean(guaranteed, "guaranteed"):
        raise ArgumentError(
            "guaranteed",
            "must be False without cells: guaranteed intervals need a finite simulator",
        )
    if _checks.boolean(normalized, "normalized") and discount == 1.0:
        raise ArgumentError(
            "normalized",
            "must be False at discount 1: the factor (1 - discount) would be 0",
        )
    _checks.boolean(quick, "quick")
    scale = 1.0 - discount if normalized else 1.0
    results = []
    pace = _progress.Pace(len(policies) * len(rows))
    for name, policy in policies.items():
        for label, row in rows.items():
            pace.report(f"{label} of “{name}”")
            estimate = choose_interval(row(policy), None, level, scale)
            results.append(Result(name, label, estimate))
            _progress.report_finished(f"{label} of “{name}”: {estimate}")
    texts, notes = number_notes(results, group_findings(results))
    return Report(
        tuple(results),
        {},
        texts,
        notes,
        level,
        normalized,
        discount,
        horizon,
        seed,
        facts,
        kinds=kinds_of_findings(results),
    )
