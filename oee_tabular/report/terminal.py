"""A report as text for a terminal, and as a table in a notebook: the answer, a table, what is assumed, notes."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from oee_tabular import _printing
from oee_tabular.report import text

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

N_NOTES = 5  # that a short report shows
LINE = 100  # characters
DIAGNOSTICS: tuple[tuple[str, str, Callable[[float], str]], ...] = (  # that have a column in long tables
    ("effective_sample_size", "eff. n", "{:.0f}".format),
    ("coverage", "coverage", _printing.share),
    ("largest_weight", "max weight", "{:.3g}".format),
    ("row_sum_error", "row-sum err.", lambda error: "0" if error < 1e-9 else f"{error:.2g}"),
)


def render(report: Report, *, all: bool, verbose: bool) -> str:
    """The report as text: ``Report.to_text``."""
    rows = report.rows(all=all)
    notes = notes_of(report, rows)
    first = notes if verbose else notes[:N_NOTES]
    rest = text.omissions(len(notes) - len(first), len(report.results) - len(rows))
    return join(
        fold([report.headline]),
        comparison_table(report),
        estimator_table(report, rows, verbose=verbose),
        fold([*report.legend(rows), *details(report)]),
        [*fold([f"[{k}] {report.warnings[k - 1]}" for k in first], indent="    "), *fold([rest])],
        fold(inputs(report)),
    )


def render_comparison(report: Report) -> str:
    """What ``oee compare`` prints: the answer and a row each policy."""
    return join(fold([report.headline]), comparison_table(report), fold([*details(report), *inputs(report)]))


def render_html(report: Report) -> str:
    """The report as a table of a notebook."""
    rows = report.rows()
    return _printing.table(
        header(report, verbose=False),
        [cells(report, row, verbose=False) for row in rows],
        caption=report.headline,
        text_columns=2,
        below=[
            *report.legend(rows),
            *details(report),
            *(f"[{k}] {report.warnings[k - 1]}" for k in notes_of(report, rows)),
            *inputs(report),
        ],
    )


def join(*paragraphs: Sequence[str]) -> str:
    """Paragraphs of lines, apart from those that are empty."""
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)


def fold(sentences: Iterable[str], indent: str = "") -> list[str]:
    """Sentences, each from a line of its own, in lines of ``LINE`` characters."""
    lines: list[str] = []
    for sentence in sentences:
        lines += textwrap.wrap(
            sentence, LINE, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )  # fmt: skip
    return lines


def notes_of(report: Report, rows: Sequence[Mapping[str, Any]]) -> list[int]:
    """The numbers of the warnings about one of the rows, or about none in particular."""
    about_a_row = {note for notes in report.notes.values() for note in notes}
    here = {note for row in rows for note in row["notes"]}
    return [k for k in range(1, len(report.warnings) + 1) if k in here or k not in about_a_row]


def details(report: Report) -> list[str]:
    """What is said below the table; the ranking of the policies stands above it."""
    return [sentence for sentence in report.uncertainty.sentences if sentence != report.uncertainty.ranking]


def inputs(report: Report) -> list[str]:
    """What a value is, and what it was made from."""
    known = (
        f"{key.capitalize()}: {report.facts[key]}" for key in ("simulator", "log", "target") if key in report.facts
    )
    return [f"Value: {report.unit}", *known]


def comparison_table(report: Report) -> list[str]:
    """A row each policy, best first; no lines of a single one."""
    rows = report.comparison()
    if not rows:
        return []
    titles = ["policy", "value", f"{report.confidence:.0%} interval", "P(best)", "worth less than the best by"]
    table = [[*titles, *(["exact value"] if report.truth else [])]]
    for row in rows:
        less = value_and_interval(row["less_by"], row["less_by_lower"], row["less_by_upper"])
        best = "-" if row["probability_best"] is None else f"{row['probability_best']:.1%}"
        value, interval = value_and_interval(row["value"], row["lower"], row["upper"])
        exact = [f"{report.truth[row['policy']] * report.scale:.6g}"] if report.truth else []
        table.append([row["policy"], value, interval, best, " ".join(less).strip(), *exact])
    has_no_best = any(row["probability_best"] is None for row in rows)
    return [*align_columns(table, numeric_from=1), *([text.NO_P_BEST] if has_no_best else [])]


def estimator_table(report: Report, rows: Sequence[Mapping[str, Any]], *, verbose: bool) -> list[str]:
    """A row each policy and estimator."""
    body = [cells(report, row, verbose=verbose) for row in rows]
    return align_columns([header(report, verbose=verbose), *body], numeric_from=2)


def header(report: Report, *, verbose: bool) -> list[str]:
    """Six columns; ``verbose`` adds those of diagnostics."""
    error = ["error"] if report.truth else []
    if not verbose:
        return ["policy", "estimator", "value", f"{report.confidence:.0%} interval", *(error or ["std. error"]), "note"]
    titles = [title for _, title, _ in DIAGNOSTICS]
    return ["policy", "estimator", "value", "std. error", f"{report.confidence:.0%} interval", *error, *titles, "note"]


def cells(report: Report, row: Mapping[str, Any], *, verbose: bool) -> list[str]:
    """The cells of one row, below ``header``."""
    value, interval = value_and_interval(row["value"], row["lower"], row["upper"])
    error = [format_or_blank(row["error"], "+.2g")] if report.truth else []
    deviation, note = format_or_blank(row["standard_error"], ".2g"), "".join(f"[{k}]" for k in row["notes"])
    if not verbose:
        return [row["policy"], row["estimator"], value, interval, *(error or [deviation]), note]
    return [row["policy"], row["estimator"], value, deviation, interval, *error, *diagnostic_cells(row), note]


def value_and_interval(value: float | None, lower: float | None, upper: float | None) -> tuple[str, str]:
    """A value with as many digits as its interval has, and that; "" for None."""
    if value is None:
        return "", ""
    if lower is None or upper is None:
        return f"{value:.5g}", ""
    return f"{value:{_printing.spec(lower, upper)}}", _printing.interval(lower, upper)


def format_or_blank(value: float | None, form: str) -> str:
    """A number, or nothing."""
    return "" if value is None else format(value, form)


def diagnostic_cells(row: Mapping[str, Any]) -> list[str]:
    """A record's ``DIAGNOSTICS``, empty where it has none."""
    return ["" if row.get(key) is None else words(row[key]) for key, _, words in DIAGNOSTICS]


def align_columns(rows: Sequence[Sequence[str]], *, numeric_from: int) -> list[str]:
    """The lines of a table; columns from ``numeric_from`` on stand to the right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(
            cell.rjust(width) if k >= numeric_from else cell.ljust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
