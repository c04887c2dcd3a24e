"""How results print: what their values are, in words, and one small table for notebooks, everything escaped."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

SUM = "discounted sum of rewards, not normalised"  # what a value is, wherever nothing else is said
_CELL = "padding:0.15em 0.8em 0.15em 0;text-align:"


def table(
    header: Sequence[object],
    rows: Sequence[Sequence[object]],
    *,
    caption: str,
    text_columns: int = 1,
    below: Sequence[str] = (),
) -> str:
    """An HTML table: the first ``text_columns`` left-aligned, the others (numbers) to the right; sentences below."""

    def line(cells: Sequence[object], tag: str) -> str:
        inside = "".join(
            f'<{tag} style="{_CELL}{"left" if k < text_columns else "right"}">{escape(str(cell))}</{tag}>'
            for k, cell in enumerate(cells)
        )
        return f"<tr>{inside}</tr>"

    head = f"<thead>{line(header, 'th')}</thead>" if header else ""
    body = "".join(line(row, "td") for row in rows)
    sentences = "".join(f"<p>{escape(text)}</p>" for text in below)
    title = f'<caption style="text-align:left">{escape(caption)}</caption>'
    return f"<div><table>{title}{head}<tbody>{body}</tbody></table>{sentences}</div>"


def facts(caption: str, rows: Sequence[tuple[str, object]], *, below: Sequence[str] = ()) -> str:
    """A table of names and values."""
    return table([], rows, caption=caption, text_columns=2, below=below)


def text(words: object, caption: str) -> str:
    """What prints as a table in a terminal, in the same letters."""
    return f"<div><p>{escape(caption)}</p><pre>{escape(str(words))}</pre></div>"
