"""Views of a report as text for a terminal, and as a table in a notebook."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from oee_tabular import _printing
from oee_tabular.report import text

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

MAX_NOTES = 5  # that a short report shows
LINE_WIDTH = 100  # characters
Row = Mapping[str, Any]
Columns = Mapping[str, Callable[[Row], str]]  # title -> the cell of a row


def render(report: Report, *, all: bool, verbose: bool) -> str:
    """Write a report as text, as ``Report.to_text`` returns it."""
    rows, notes = number_notes(report, report.rows(all=all))
    first = notes if verbose else notes[:MAX_NOTES]
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
    """Write what ``oee compare`` prints: the answer, and a row for each policy."""
    return join(
        fold([report.headline]),
        comparison_table(report),
        fold([*details(report), *inputs(report)]),
    )


def render_intervals(report: Report) -> str:
    """Write what likelihood intervals add to a report that was shown without them."""
    kinds = ("likelihood", "likelihood with trials")
    rows = [row for row in report.rows() if row["interval_method"] in kinds]
    return join(
        fold(["With the likelihood intervals:"]),
        fold([report.headline]),
        comparison_table(report),
        fold([*report.legend(rows), *details(report)]),
    )


def render_html(report: Report) -> str:
    """Write a report as a table in a notebook."""
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
    """Return the columns of the table with a row for each policy and estimator.

    They are six; ``verbose`` shows all columns of diagnostics.
    """
    more = diagnostic_columns(report)
    if not verbose:
        shown = "error" if report.truth else "std. error"
        more = {shown: more[shown]}
    return {
        "policy": itemgetter("policy"),
        "estimator": itemgetter("estimator"),
        **value_columns(report),
        **more,
        "note": lambda row: "".join(f"[{k}]" for k in row["notes"]),
    }


def value_columns(report: Report) -> Columns:
    """Return the columns of a value and its interval.

    A value without an interval has no more digits than the policy's answer.
    """
    quoted = {answer.policy: (answer.lower, answer.upper) for answer in report.answers}

    def value(row: Row) -> str:
        """Write a value with as many digits as an interval allows."""
        ends = row["lower"], row["upper"]
        shown = text.format_estimate(row["value"], ends, quoted[row["policy"]])
        return shown.replace("−", "-")

    return {
        "value": value,
        f"{report.confidence:.0%} interval": lambda row: write_interval(
            row["lower"], row["upper"]
        ),
    }


def diagnostic_columns(report: Report) -> Columns:
    """Return the columns of diagnostics, whose cells are empty where a row has none."""
    errors = {"std. error": number_cell("standard_error", "{:.2g}".format)}
    if report.truth:
        errors["error"] = number_cell("error", "{:+.2g}".format)
    return {
        **errors,
        "eff. n": number_cell("effective_sample_size", "{:.0f}".format),
        "coverage": number_cell("coverage", _printing.share),
        "max weight": number_cell("largest_weight", "{:.3g}".format),
        "row-sum err.": number_cell("row_sum_error", _write_row_sum_error),
    }


def _write_row_sum_error(error: float) -> str:
    """Write how far rows are from summing to 1; rounding is 0."""
    return "0" if error < 1e-9 else f"{error:.2g}"


def comparison_table(report: Report) -> list[str]:
    """Write a row for each policy, best first; no lines for a single policy."""
    rows = report.comparison()
    if not rows:
        return []
    best = number_cell("probability_best", "{:.1%}".format)
    columns: dict[str, Callable[[Row], str]] = {
        "policy": itemgetter("policy"),
        **value_columns(report),
        "P(best)": lambda row: best(row) or "-",
        "below the top row by": write_difference,
    }

    def exact_value(row: Row) -> str:
        """Write the exact value of a policy, in the report's unit."""
        return f"{report.truth[row['policy']] * report.scale:.6g}"

    if report.truth:
        columns["exact value"] = exact_value
    lines = align(columns, rows, n_texts=1)
    if any(row["probability_best"] is None for row in rows):
        lines.append(text.NO_P_BEST)
    return lines


def write_value(value: float, lower: float | None, upper: float | None) -> str:
    """Write a value with as many digits as its interval has."""
    if lower is None or upper is None:
        return text.format_number(value).replace("−", "-")
    return f"{value:{_printing.spec(lower, upper)}}"


def write_interval(lower: float | None, upper: float | None) -> str:
    """Write an interval; "" without one."""
    return "" if lower is None or upper is None else _printing.interval(lower, upper)


def write_difference(row: Row) -> str:
    """Write by how much a policy is worth less than the best; "" for the best."""
    less = row["less_by"]
    if less is None:
        return ""
    ends = (row["less_by_lower"], row["less_by_upper"])
    return f"{write_value(less, *ends)} {write_interval(*ends)}".strip()


def number_cell(key: str, form: Callable[[float], str]) -> Callable[[Row], str]:
    """Return the function that writes a row's number; "" where the row has none."""
    return lambda row: "" if row.get(key) is None else form(row[key])


def align(columns: Columns, rows: Sequence[Row], *, n_texts: int) -> list[str]:
    """Return the lines of a table; only the first n_texts columns align left."""
    table = [list(columns)]
    table += [[cell(row) for cell in columns.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for cells in table:
        padded = []
        for k, (cell, width) in enumerate(zip(cells, widths, strict=True)):
            padded.append(cell.ljust(width) if k < n_texts else cell.rjust(width))
        lines.append("  ".join(padded).rstrip())
    return lines


def number_notes(report: Report, rows: Sequence[Row]) -> tuple[list[Row], list[str]]:
    """Return the rows with their notes numbered from 1, and the sentences of the notes.

    A warning that is about no row in particular has no number, and comes first.
    """
    cited = sorted({k for row in rows for k in row["notes"]})
    about_rows = {k for notes in report.notes.values() for k in notes}
    general = [
        warning
        for k, warning in enumerate(report.warnings, start=1)
        if k not in about_rows
    ]
    numbered = [f"[{i}] {report.warnings[k - 1]}" for i, k in enumerate(cited, start=1)]
    renumbered: list[Row] = [
        {**row, "notes": [1 + cited.index(k) for k in row["notes"]]} for row in rows
    ]
    return renumbered, [*general, *numbered]


def details(report: Report) -> list[str]:
    """Return the sentences below the table; the ranking stands above it."""
    return list(report.uncertainty.details)


def inputs(report: Report) -> list[str]:
    """Return the lines on what a value is, and on what it was made from."""
    keys = [
        key for key in ("simulator", "log", "trials", "target") if key in report.facts
    ]
    return [
        f"Value: {report.unit}",
        *(f"{key.capitalize()}: {report.facts[key]}" for key in keys),
    ]


def fold(sentences: Iterable[str], indent: str = "") -> list[str]:
    """Wrap sentences to lines of LINE_WIDTH characters; each begins a line."""
    wrapper = textwrap.TextWrapper(
        LINE_WIDTH,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]


def join(*paragraphs: Sequence[str]) -> str:
    """Join paragraphs of lines by blank lines, without those that are empty."""
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)
