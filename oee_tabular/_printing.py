"""How results print: what their values are, in words, and one small table for
notebooks, everything escaped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

# what a value is, wherever nothing else is said
SUM = "discounted sum of rewards, not normalised"
_CELL = "padding:0.15em 0.8em 0.15em 0;text-align:"


def spec(lower: float, upper: float) -> str:
    """The format of an interval's ends, and of the value between them: four digits, and
    two at least of the width.

    Examples
    --------
    >>> [format(x, spec(-11020.31, -11019.8)) for x in (-11020.31, -11020.0, -11019.8)]
    ['-11020.31', '-11020.00', '-11019.80']
    """
    largest = max(abs(lower), abs(upper))
    width = upper - lower
    if not math.isfinite(largest) or largest == 0.0:
        return ".4g"
    # the places of the first and the last digit
    first = math.floor(math.log10(largest))
    last = (
        min(first - 3, math.floor(math.log10(width)) - 1) if width > 0.0 else first - 3
    )
    last = max(last, first - 14)
    return f"z.{max(-last, 0)}f" if -4 <= first < 7 else f".{first - last}e"


def share(part: float) -> str:
    """A share of 1 in percent; what is not all of it, or not nothing, does not read so.

    >>> share(0.99996), share(1.0), share(0.421), share(1e-6)
    ('> 99.9%', '100.0%', '42.1%', '< 0.1%')
    """
    text = f"{part:.1%}"
    if text == "100.0%" and part < 1.0 - 1e-12:
        return "> 99.9%"
    return "< 0.1%" if text == "0.0%" and part > 1e-12 else text


def interval(lower: float, upper: float) -> str:
    """[lower, upper], as ``spec`` says."""
    form = spec(lower, upper)
    return f"[{lower:{form}}, {upper:{form}}]"


def table(
    header: Sequence[object],
    rows: Sequence[Sequence[object]],
    *,
    caption: str,
    text_columns: int = 1,
    below: Sequence[str] = (),
) -> str:
    """An HTML table: the first ``text_columns`` left-aligned, the others (numbers) to
    the right; sentences below.
    """

    def line(cells: Sequence[object], tag: str) -> str:
        inside = "".join(
            f"<{tag}"
            f' style="{_CELL}{"left" if k < text_columns else "right"}">{escape(str(cell))}</{tag}>'
            for k, cell in enumerate(cells)
        )
        return f"<tr>{inside}</tr>"

    head = f"<thead>{line(header, 'th')}</thead>" if header else ""
    body = "".join(line(row, "td") for row in rows)
    sentences = "".join(f"<p>{escape(text)}</p>" for text in below)
    title = f'<caption style="text-align:left">{escape(caption)}</caption>'
    return f"<div><table>{title}{head}<tbody>{body}</tbody></table>{sentences}</div>"


def facts(caption: str, rows: Sequence[tuple[str, object]]) -> str:
    """A table of names and values."""
    return table([], rows, caption=caption, text_columns=2)


def text(words: object, caption: str) -> str:
    """What prints as a table in a terminal, in the same letters."""
    return f"<div><p>{escape(caption)}</p><pre>{escape(str(words))}</pre></div>"
