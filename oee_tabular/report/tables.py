"""A report as text for a terminal, and as a table in a notebook: the answer, a table,
what is assumed, notes.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from oee_tabular import _printing
from oee_tabular.report import text

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

N_NOTES = 5  # that a short report shows
LINE = 100  # characters
Row = Mapping[str, Any]
Columns = Mapping[str, Callable[[Row], str]]  # title -> the cell of a row


def render(report: Report, *, all: bool, verbose: bool) -> str:
    """The report as text: ``Report.to_text``."""
    rows, notes = number_notes(report, report.rows(all=all))
    first = notes if verbose else notes[:N_NOTES]
    rest = text.omissions(len(notes) - len(first), len(report.results) - len(rows))
    return join(
        fold([report.headline]),
        comparison_table(report),
        align(estimator_columns(report, verbose=verbose), rows, n_texts=2),
        fold([*report.legend(rows), *details(report)]),
        [*fold(first, indent="    "), *fold([rest])],
        fold(inputs(report)),
    )


def render_comparison(report: Report) -> str:
    """What ``oee compare`` prints: the answer and a row each policy."""
    return join(
        fold([report.headline]),
        comparison_table(report),
        fold([*details(report), *inputs(report)]),
    )


def render_html(report: Report) -> str:
    """The report as a table of a notebook."""
    columns = estimator_columns(report, verbose=False)
    rows, notes = number_notes(report, report.rows())
    return _printing.table(
        list(columns),
        [[cell(row) for cell in columns.values()] for row in rows],
        caption=report.headline,
        text_columns=2,
        below=[*report.legend(rows), *details(report), *notes, *inputs(report)],
    )


def estimator_columns(report: Report, *, verbose: bool) -> Columns:
    """Six columns of a row each policy and estimator; ``verbose`` adds those of
    diagnostics.
    """
    more = diagnostic_columns(report)
    shown = "error" if report.truth else "std. error"
    return {
        "policy": itemgetter("policy"),
        "estimator": itemgetter("estimator"),
        **value_columns(report),
        **(more if verbose else {shown: more[shown]}),
        "note": lambda row: "".join(f"[{k}]" for k in row["notes"]),
    }


def value_columns(report: Report) -> Columns:
    """A value, and its interval."""
    return {
        "value": lambda row: write_value(row["value"], row["lower"], row["upper"]),
        f"{report.confidence:.0%} interval": lambda row: write_interval(
            row["lower"], row["upper"]
        ),
    }


def diagnostic_columns(report: Report) -> Columns:
    """How an estimate came about, empty where a row does not know."""
    return {
        "std. error": number_cell("standard_error", "{:.2g}".format),
        **({"error": number_cell("error", "{:+.2g}".format)} if report.truth else {}),
        "eff. n": number_cell("effective_sample_size", "{:.0f}".format),
        "coverage": number_cell("coverage", _printing.share),
        "max weight": number_cell("largest_weight", "{:.3g}".format),
        "row-sum err.": number_cell(
            "row_sum_error", lambda error: "0" if error < 1e-9 else f"{error:.2g}"
        ),
    }


def comparison_table(report: Report) -> list[str]:
    """A row each policy, best first; no lines of a single one."""
    rows = report.comparison()
    if not rows:
        return []
    best = number_cell("probability_best", "{:.1%}".format)
    columns: Columns = {
        "policy": itemgetter("policy"),
        **value_columns(report),
        "P(best)": lambda row: best(row) or "-",
        "below the top row by": write_difference,
        **(
            {
                "exact value": lambda row: (
                    f"{report.truth[row['policy']] * report.scale:.6g}"
                )
            }
            if report.truth
            else {}
        ),
    }
    has_no_best = any(row["probability_best"] is None for row in rows)
    return [
        *align(columns, rows, n_texts=1),
        *([text.NO_P_BEST] if has_no_best else []),
    ]


def write_value(value: float, lower: float | None, upper: float | None) -> str:
    """Write a value with as many digits as its interval has."""
    if lower is None or upper is None:
        return text.format_number(value).replace("−", "-")
    return f"{value:{_printing.spec(lower, upper)}}"


def write_interval(lower: float | None, upper: float | None) -> str:
    """Write an interval; "" without one."""
    return "" if lower is None or upper is None else _printing.interval(lower, upper)


def write_difference(row: Row) -> str:
    """Write by how much a policy is worth less than the best; "" of the best."""
    less = row["less_by"]
    ends = (row["less_by_lower"], row["less_by_upper"])
    return (
        ""
        if less is None
        else f"{write_value(less, *ends)} {write_interval(*ends)}".strip()
    )


def number_cell(key: str, form: Callable[[float], str]) -> Callable[[Row], str]:
    """The cell of a number; "" where a row has none."""
    return lambda row: "" if row.get(key) is None else form(row[key])


def align(columns: Columns, rows: Sequence[Row], *, n_texts: int) -> list[str]:
    """The lines of a table; columns after the first ``n_texts`` stand to the right."""
    table = [list(columns), *([cell(row) for cell in columns.values()] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for cells in table:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)][
            :n_texts
        ]
        padded += [
            cell.rjust(width) for cell, width in zip(cells, widths, strict=True)
        ][n_texts:]
        lines.append("  ".join(padded).rstrip())
    return lines


def number_notes(report: Report, rows: Sequence[Row]) -> tuple[list[Row], list[str]]:
    """The rows with their notes numbered from 1, and the notes; a warning about no row
    in particular has no number.
    """
    cited = sorted({k for row in rows for k in row["notes"]})
    about_rows = {k for notes in report.notes.values() for k in notes}
    general = [
        warning
        for k, warning in enumerate(report.warnings, start=1)
        if k not in about_rows
    ]
    numbered = [f"[{i}] {report.warnings[k - 1]}" for i, k in enumerate(cited, start=1)]
    return [
        {**row, "notes": [1 + cited.index(k) for k in row["notes"]]} for row in rows
    ], [*general, *numbered]


def details(report: Report) -> list[str]:
    """What is said below the table; the ranking of the policies stands above it."""
    return [
        sentence
        for sentence in report.uncertainty.sentences
        if sentence != report.uncertainty.ranking
    ]


def inputs(report: Report) -> list[str]:
    """What a value is, and what it was made from."""
    keys = [key for key in ("simulator", "log", "target") if key in report.facts]
    return [
        f"Value: {report.unit}",
        *(f"{key.capitalize()}: {report.facts[key]}" for key in keys),
    ]


def fold(sentences: Iterable[str], indent: str = "") -> list[str]:
    """Sentences, each from a line of its own, in lines of ``LINE`` characters."""
    wrapper = textwrap.TextWrapper(
        LINE, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]


def join(*paragraphs: Sequence[str]) -> str:
    """Paragraphs of lines, apart from those that are empty."""
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)
