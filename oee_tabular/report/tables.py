"""Views of a report as text for a terminal, and as a table in a notebook."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from oee_tabular import _printing
from oee_tabular.report import text
from oee_tabular.report.notes import Note, Rank, rank_notes

if TYPE_CHECKING:
    from oee_tabular.report.results import Report

MAX_NOTES = 3  # that a short report shows
LINE_WIDTH = 100  # characters
TEXT_COLUMNS = ("policy", "estimator", "what it rests on")
Row = Mapping[str, Any]
Columns = Mapping[str, Callable[[Row], str]]  # title -> the cell of a row


def render(report: Report, *, all: bool, verbose: bool) -> str:
    """Write a report as text, as ``Report.to_text`` returns it."""
    if not verbose:
        return render_short(report, all=all)
    rows, notes = number_notes(report, report.rows(all=all))
    rest = text.omissions(len(report.results) - len(rows))
    return join(
        fold([report.headline]),
        comparison_in_full(report),
        align(estimator_columns(report, verbose=True), rows),
        fold([*report.legend(rows), *details(report)]),
        [*fold(notes, indent="    "), *fold([rest])],
        fold(inputs(report)),
    )


def render_short(report: Report, *, all: bool = False) -> str:
    """Write the answer, one table, the first notes, and what the report was made from.

    The last line says what is left out, and how to see it.
    """
    notes = rank_notes(report)
    if has_row_for_each_policy(report) and not all:
        shown = first_notes(notes, stated_pairs(report))
        table = comparison_table(report)
        more_rows = len(report.rows())
    else:
        rows = report.rows(all=all)
        pairs = {(row["policy"], row["estimator"]) for row in rows}
        shown = first_notes(notes, pairs)
        rows = cite_notes(rows, shown)
        table = align(short_columns(report, rows), rows)
        more_rows = 0
    hidden_rows = 0 if all else len(report.results) - len(report.rows())
    rest = text.left_out(len(notes) - len(shown), more_rows, hidden_rows)
    numbered = [f"[{k}] {note.text}" for k, note in enumerate(shown, start=1)]
    return join(
        fold([report.brief]),
        [*table, *fold([f"A value is {report.meaning}."])],
        fold(numbered, indent="    "),
        fold([provenance(report), rest]),
    )


def stated_pairs(report: Report) -> set[tuple[str, str]]:
    """Return the (policy, estimator) whose values the answer states."""
    return {(answer.policy, answer.estimator) for answer in report.answers}


def first_notes(notes: Sequence[Note], pairs: set[tuple[str, str]]) -> list[Note]:
    """Return the first notes that can change what a reader does.

    A note about rows is one of them only if a row of its own is among ``pairs``, those
    of the table.
    """
    first = [
        note
        for note in notes
        if note.rank < Rank.REMARK and (not note.pairs or note.pairs & pairs)
    ]
    return first[:MAX_NOTES]


def has_row_for_each_policy(report: Report) -> bool:
    """Say whether the policies are compared, and by nothing but the default rows.

    Then a row for each policy says all that a first reader looks for.
    """
    names = {result.estimator for result in report.results}
    return bool(report.comparison()) and names <= text.DEFAULT_ROWS.keys()


def cite_notes(rows: Sequence[Row], notes: Sequence[Note]) -> list[Row]:
    """Return rows with the numbers, from 1, of the notes that are about them."""
    cited: list[Row] = []
    for row in rows:
        pair = (row["policy"], row["estimator"])
        numbers = [k for k, note in enumerate(notes, start=1) if pair in note.pairs]
        cited.append({**row, "notes": numbers})
    return cited


def short_columns(report: Report, rows: Sequence[Row]) -> Columns:
    """Return the columns of a short table with a row for each policy and estimator.

    A column stands there only if a row has something in it.
    """
    columns: dict[str, Callable[[Row], str]] = {}
    # the answer names a single policy
    if len(report.answers) > 1:
        columns["policy"] = itemgetter("policy")
    columns["estimator"] = itemgetter("estimator")
    columns |= value_columns(report)
    if report.truth:
        columns["error"] = number_cell("error", "{:+.2g}".format)
    if any(row["notes"] for row in rows):
        columns["note"] = write_citations
    if any(write_basis(row) for row in rows):
        columns["what it rests on"] = write_basis
    return columns


def write_basis(row: Row) -> str:
    """Write what an estimator's value rests on; "" for estimators of one's own.

    Of a log that covers less than half of what the policy does, it says how much, and
    of a value that is not to be used it says so.
    """
    if row["status"] != "ok":
        return text.NOT_USABLE
    basis = text.DEFAULT_ROWS.get(row["estimator"], "")
    coverage = row.get("coverage")
    if basis and coverage is not None and coverage < text.MIN_COVERAGE:
        basis += f", which covers {_printing.share(coverage)}"
    return basis


def write_citations(row: Row) -> str:
    """Write the numbers of a row's notes."""
    return "".join(f"[{k}]" for k in row["notes"])


def render_comparison(report: Report, *, verbose: bool) -> str:
    """Write what ``oee compare`` prints: the answer, and a row for each policy."""
    if not verbose:
        return render_short(report)
    return join(
        fold([report.headline]),
        comparison_in_full(report),
        fold([*details(report), *inputs(report)]),
    )


def render_intervals(report: Report, *, verbose: bool) -> str:
    """Write what likelihood intervals add to a report that was shown without them."""
    title = "With the likelihood intervals:"
    if not verbose:
        return join([title], [render_short(report)])
    kinds = ("likelihood", "likelihood with trials")
    rows = [row for row in report.rows() if row["interval_method"] in kinds]
    return join(
        [title],
        fold([report.headline]),
        comparison_in_full(report),
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
        "note": write_citations,
    }


def comparison_in_full(report: Report) -> list[str]:
    """Write the table of the policies, and why it has no P(best)."""
    rows = report.comparison()
    lines = comparison_table(report)
    if any(row["probability_best"] is None for row in rows):
        lines += fold([text.NO_P_BEST])
    return lines


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
    columns: dict[str, Callable[[Row], str]] = {
        "policy": itemgetter("policy"),
        **value_columns(report),
    }
    simulated = {
        answer.policy: text.format_value(answer.simulator, answer.lower, answer.upper)
        for answer in report.answers
        if answer.simulator is not None and answer.is_from_log
    }
    if simulated:
        columns["simulator says"] = lambda row: simulated.get(
            row["policy"], ""
        ).replace("−", "-")
    if any(row["probability_best"] is not None for row in rows):
        best = number_cell("probability_best", "{:.1%}".format)
        columns["P(best)"] = lambda row: best(row) or "-"
    columns["below the top row by"] = write_difference

    def exact_value(row: Row) -> str:
        """Write the exact value of a policy, in the report's unit."""
        exact = report.truth[row["policy"]] * report.scale
        return write_value(exact, row["lower"], row["upper"])

    if report.truth:
        columns["exact value"] = exact_value
    return align(columns, rows)


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


def align(columns: Columns, rows: Sequence[Row]) -> list[str]:
    """Return the lines of a table; columns of texts align left, others right."""
    table = [list(columns)]
    table += [[cell(row) for cell in columns.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    lines = []
    for cells in table:
        padded = []
        for title, cell, width in zip(columns, cells, widths, strict=True):
            is_text = title in TEXT_COLUMNS
            padded.append(cell.ljust(width) if is_text else cell.rjust(width))
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


def provenance(report: Report) -> str:
    """Return in one line what the report was made from."""
    problem = report.problem
    counts: tuple[int, int] | None = None
    if problem is not None:
        counts = (round(float(problem.counts.sum())), problem.simulator.n_states)
    simulator = report.facts.get("simulator_name")
    if simulator and report.facts.get("action_noise"):
        simulator += f" with action noise {report.facts['action_noise']:g}"
    names = (report.facts.get("log_name"), simulator)
    return text.provenance(counts, names)


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
