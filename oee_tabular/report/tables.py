"""Views of a report's content as text for a terminal, and as a table in a notebook."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from oee_tabular import _printing
from oee_tabular.report import columns, text
from oee_tabular.report.columns import Column, Row
from oee_tabular.report.notes import Note, Rank

if TYPE_CHECKING:
    from oee_tabular.report.content import Content
    from oee_tabular.report.results import Report

MAX_NOTES = 3  # that a short report shows
LINE_WIDTH = 100  # characters
MAX_NAME = 60  # characters of a file's name, or of a description in place of one
EQUALS = "\x1f=\x1f"  # no white space, of the length of " = "
NOTEBOOK = (
    columns.POLICY,
    columns.ESTIMATOR,
    columns.VALUE,
    columns.INTERVAL,
    columns.STANDARD_ERROR,
    columns.ERROR,
    columns.NOTE,
)


def render(report: Report, *, all: bool, verbose: bool) -> str:
    """Write a report as text, as ``Report.to_text`` returns it."""
    content = report.content
    if not verbose:
        return render_short(content, all=all)
    rows, notes = number_notes(content, content.records if all else content.shown)
    rest = text.omissions(len(content.records) - len(rows))
    return join(
        fold([content.headline]),
        comparison_in_full(content),
        align(columns.estimator_columns(content, columns.FULL), rows),
        [*fold([*report.legend(rows), *content.details]), *planning(content)],
        [*fold(notes, indent="    "), *fold([rest])],
        fold(inputs(content)),
    )


def render_short(content: Content, *, all: bool = False) -> str:
    """Write the answer, one table, the first notes, and what the report was made from.

    The last line says what is left out, and how to see it.
    """
    if has_row_for_each_policy(content) and not all:
        shown = first_notes(content.notes, stated_pairs(content))
        table = comparison_table(content)
        is_cited = False
        # the policies' own rows are in the table
        more_rows = len(content.shown) - len(content.comparison)
    else:
        records = content.records if all else content.shown
        pairs = {(row["policy"], row["estimator"]) for row in records}
        shown = first_notes(content.notes, pairs)
        rows = cite_notes(records, shown)
        table = align(short_columns(content, rows), rows)
        is_cited = True
        more_rows = 0
    hidden_rows = 0 if all else len(content.records) - len(content.shown)
    rest = text.left_out(len(content.notes) - len(shown), more_rows, hidden_rows)
    return join(
        fold([content.brief]),
        [*table, *fold([describe_values(content)])],
        list_notes(shown, is_cited=is_cited),
        fold([provenance(content), rest]),
    )


def describe_values(content: Content) -> str:
    """Say what a value and its interval are, and why exact values can be known."""
    sentence = f"A value is {content.meaning}; larger is better."
    if content.truth:
        sentence += " Exact values are known here, because the target itself is given."
    return f"{sentence} {content.kind}".rstrip()


def render_comparison(report: Report, *, verbose: bool) -> str:
    """Write what ``oee compare`` prints: the answer, and a row for each policy."""
    content = report.content
    if not verbose:
        return render_short(content)
    _, notes = number_notes(content, content.shown)
    return join(
        fold([content.headline]),
        comparison_in_full(content),
        fold([*content.legend, *content.details]),
        fold(notes, indent="    "),
        fold(inputs(content)),
    )


def render_intervals(report: Report, *, verbose: bool) -> str:
    """Write what likelihood intervals add to a report that was shown without them."""
    content = report.content
    title = "With the likelihood intervals:"
    if not verbose:
        return join([title], [render_short(content)])
    kinds = ("likelihood", "likelihood with trials")
    rows = [row for row in content.shown if row["interval_method"] in kinds]
    return join(
        [title],
        fold([content.headline]),
        comparison_in_full(content),
        fold([*report.legend(rows), *content.details]),
    )


def render_html(content: Content) -> str:
    """Write a report as a table in a notebook."""
    chosen = [
        name for name in NOTEBOOK if name != columns.STANDARD_ERROR or not content.truth
    ]
    shown = columns.estimator_columns(content, chosen)
    rows, notes = number_notes(content, content.shown)
    return _printing.table(
        [column.title for column in shown],
        [[column.write(row) for column in shown] for row in rows],
        caption=content.headline,
        text_columns=2,
        below=[*content.legend, *content.details, *notes, *inputs(content)],
    )


# ---- the table


def has_row_for_each_policy(content: Content) -> bool:
    """Say whether the policies are compared, and by nothing but the default rows.

    Then a row for each policy says all that a first reader looks for.
    """
    names = {row["estimator"] for row in content.records}
    return bool(content.comparison) and all(map(text.write_basis, names))


def short_columns(content: Content, rows: Sequence[Row]) -> list[Column]:
    """Return the columns of a short table with a row for each policy and estimator.

    A column stands there only if a row has something in it. The answer names a single
    policy, so that a column of policies stands there only for several.
    """
    chosen = columns.estimator_columns(content, columns.SHORT)
    if len(content.answers) == 1:
        chosen = [column for column in chosen if column.title != columns.POLICY]
    return [column for column in chosen if any(column.write(row) for row in rows)]


def comparison_table(content: Content) -> list[str]:
    """Write a row for each policy, best first; no lines for a single policy."""
    if not content.comparison:
        return []
    return align(columns.comparison_columns(content), content.comparison)


def comparison_in_full(content: Content) -> list[str]:
    """Write the table of the policies, and why it has no P(best)."""
    lines = comparison_table(content)
    if any(row["probability_best"] is None for row in content.comparison):
        lines += fold([text.NO_P_BEST])
    return lines


def align(chosen: Sequence[Column], rows: Sequence[Row]) -> list[str]:
    """Return the lines of a table; columns of texts align left, others right."""
    table = [[column.title for column in chosen]]
    table += [[column.write(row) for column in chosen] for row in rows]
    widths = [max(map(len, cells)) for cells in zip(*table, strict=True)]
    lines = []
    for cells in table:
        padded = []
        for column, cell, width in zip(chosen, cells, widths, strict=True):
            padded.append(cell.ljust(width) if column.is_text else cell.rjust(width))
        lines.append("  ".join(padded).rstrip())
    return lines


# ---- the notes


def stated_pairs(content: Content) -> set[tuple[str, str]]:
    """Return the (policy, estimator) whose values the answer states."""
    return {(answer.policy, answer.estimator) for answer in content.answers}


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


def cite_notes(rows: Sequence[Row], notes: Sequence[Note]) -> list[Row]:
    """Return rows with the numbers, from 1, of the notes that are about them.

    A note that is about no row has no number.
    """
    about_rows = [note for note in notes if note.pairs]
    cited: list[Row] = []
    for row in rows:
        pair = (row["policy"], row["estimator"])
        numbers = [
            k for k, note in enumerate(about_rows, start=1) if pair in note.pairs
        ]
        cited.append({**row, "notes": numbers})
    return cited


def list_notes(notes: Sequence[Note], *, is_cited: bool) -> list[str]:
    """Write notes below a table, those that its rows cite with their numbers.

    A number that no row has would send the reader looking for it.
    """
    lines = []
    number = 0
    for note in notes:
        if is_cited and note.pairs:
            number += 1
            lines += fold([f"[{number}] {note.text}"], indent="    ")
        else:
            lines += fold([f"- {note.text}"], indent="  ")
    return lines


def number_notes(content: Content, rows: Sequence[Row]) -> tuple[list[Row], list[str]]:
    """Return the rows with their notes numbered from 1, and the sentences of the notes.

    A warning that is about no row in particular has no number, and comes first.
    """
    cited = sorted({k for row in rows for k in row["notes"]})
    warnings = content.warnings
    general = [
        warning
        for k, warning in enumerate(warnings, start=1)
        if k not in content.about_rows
    ]
    numbered = [f"[{i}] {warnings[k - 1]}" for i, k in enumerate(cited, start=1)]
    renumbered: list[Row] = [
        {**row, "notes": [1 + cited.index(k) for k in row["notes"]]} for row in rows
    ]
    return renumbered, [*general, *numbered]


# ---- what it was made from


def planning(content: Content) -> list[str]:
    """Return the command that plans the next recording, where a command reported."""
    if not content.plan_command.startswith("oee plan "):
        return []
    return [text.PLANNED, f"    {content.plan_command}"]


def inputs(content: Content) -> list[str]:
    """Return the lines on what a value is, and on what it was made from."""
    facts = content.facts
    keys = [key for key in ("simulator", "log", "trials", "target") if key in facts]
    return [
        f"Value: {content.unit}",
        *(f"{key.capitalize()}: {facts[key]}" for key in keys),
    ]


def provenance(content: Content) -> str:
    """Return in one line what the report was made from."""
    facts = content.facts
    simulator = facts.get("simulator_name") or content.task
    if simulator and facts.get("action_noise"):
        simulator = f"{simulator} with action noise {facts['action_noise']:g}"
    names = [
        name and textwrap.shorten(str(name), MAX_NAME, placeholder=" ...")
        for name in (facts.get("log_name"), simulator)
    ]
    return text.provenance(content.sizes, (names[0], names[1]), content.tried)


# ---- lines


def fold(sentences: Iterable[str], indent: str = "") -> list[str]:
    """Wrap sentences to lines of LINE_WIDTH characters; each begins a line."""
    wrapper = textwrap.TextWrapper(
        LINE_WIDTH,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    lines = []
    for sentence in sentences:
        # an equation stays on one line
        for line in wrapper.wrap(sentence.replace(" = ", EQUALS)):
            lines.append(line.replace(EQUALS, " = "))
    return lines


def join(*paragraphs: Sequence[str]) -> str:
    """Join paragraphs of lines by blank lines, without those that are empty."""
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)
