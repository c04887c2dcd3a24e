"""Numbers as text, and small HTML tables of results for notebooks, with escapes."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from html import escape
from typing import TextIO

from oee_tabular._isolation import EPOCH
from oee_tabular.exceptions import ArgumentError

# the unit of a value, unless something else is said
SUM = "discounted sum of rewards, not normalised"
# what this package prints beyond ASCII, as streams of other encodings show it
LOOK_ALIKES = {
    "\N{MINUS SIGN}": "-",
    "\N{EN DASH}": "-",
    "\N{EM DASH}": "-",
    "\N{LEFT DOUBLE QUOTATION MARK}": '"',
    "\N{RIGHT DOUBLE QUOTATION MARK}": '"',
    "\N{LEFT SINGLE QUOTATION MARK}": "'",
    "\N{RIGHT SINGLE QUOTATION MARK}": "'",
    "\N{HORIZONTAL ELLIPSIS}": "...",
    "\N{NO-BREAK SPACE}": " ",
    "\N{MULTIPLICATION SIGN}": "x",
    "\N{DIVISION SIGN}": "/",
    "\N{PLUS-MINUS SIGN}": "+-",
    "\N{RIGHTWARDS ARROW}": "->",
    "\N{SUPERSCRIPT TWO}": "^2",
    "\N{LESS-THAN OR EQUAL TO}": "<=",
    "\N{GREATER-THAN OR EQUAL TO}": ">=",
    "\N{ALMOST EQUAL TO}": "~",
}
_CELL = "padding:0.15em 0.8em 0.15em 0;text-align:"


def write_day(seconds: float) -> str:
    """Write the day (UTC) of a number of seconds since 1970."""
    day = datetime.fromtimestamp(seconds, UTC)
    return f"{day.day} {day:%B %Y}"


def read_epoch() -> str:
    """Return the day of SOURCE_DATE_EPOCH; "" where it is not set."""
    given = os.environ.get(EPOCH, "")
    try:
        return write_day(int(given)) if given else ""
    except (ValueError, OverflowError, OSError):
        raise ArgumentError(
            EPOCH,
            f"must be a whole number of seconds since 1970; it is {given[:100]!r} (a"
            " variable of the environment)",
        ) from None


def print_text(text: str, stream: TextIO | None) -> None:
    """Print text on a stream of any encoding, at once; None prints nothing.

    Letters that the encoding lacks are replaced by look-alikes, or escaped as Python
    does: none is lost, and none is an error.
    """
    if stream is not None:
        print(fit(text, getattr(stream, "encoding", None)), file=stream, flush=True)


def fit(text: str, encoding: str | None) -> str:
    r"""Replace the letters that an encoding lacks.

    >>> fit("“x” − π", "ascii"), fit("“x” − π", "cp437")
    ('"x" - \\u03c0', '"x" - π')
    """
    if encoding is None or _has(encoding, text):
        return text
    return "".join(
        letter
        if _has(encoding, letter)
        else LOOK_ALIKES.get(letter)
        or letter.encode("ascii", "backslashreplace").decode()
        for letter in text
    )


def _has(encoding: str, text: str) -> bool:
    """Return whether an encoding has all the letters of a text."""
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return False
    except LookupError:  # a stream with an encoding of its own
        return True
    return True


def spec(lower: float, upper: float, *, exact: bool = False) -> str:
    """Choose the format of an interval's ends, and of the value between them.

    It shows two digits of the width, and never fewer than the units. Of ends that are
    ``exact`` at least four significant digits are shown.

    Examples
    --------
    >>> [format(x, spec(-11020.31, -11019.8)) for x in (-11020.31, -11020.0, -11019.8)]
    ['-11020.31', '-11020.00', '-11019.80']
    """
    largest = max(abs(lower), abs(upper))
    width = upper - lower
    if not math.isfinite(largest) or largest == 0.0:
        return ".4g"
    # the decimal places of the first and the last digit
    first = math.floor(math.log10(largest))
    last = first - 3
    if width > 0.0:
        last = math.floor(math.log10(width)) - 1
        if first < 7:  # written without an exponent
            last = min(last, 0)
        if exact:
            last = min(last, first - 3)
    last = max(last, first - 14)
    return f"z.{max(-last, 0)}f" if -4 <= first < 7 else f".{first - last}e"


def share(part: float) -> str:
    """Write a share of 1 in percent; only 1 itself reads as 100.0%, only 0 as 0.0%.

    >>> share(0.99996), share(1.0), share(0.421), share(1e-6)
    ('> 99.9%', '100.0%', '42.1%', '< 0.1%')
    """
    text = f"{part:.1%}"
    if text == "100.0%" and part < 1.0 - 1e-12:
        return "> 99.9%"
    return "< 0.1%" if text == "0.0%" and part > 1e-12 else text


def listing(words: Sequence[str]) -> str:
    """Return words with commas, and an "and" before the last of several.

    >>> listing(["a", "b", "c"]), listing(["a"])
    ('a, b and c', 'a')
    """
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def probability(p: float) -> str:
    """Write an estimated probability in percent; none reads as certain.

    >>> probability(1.0), probability(0.9996), probability(0.421), probability(0.0)
    ('> 99.9%', '> 99.9%', '42.1%', '< 0.1%')
    """
    text = f"{p:.1%}"
    return {"100.0%": "> 99.9%", "0.0%": "< 0.1%"}.get(text, text)


def interval(lower: float, upper: float, *, exact: bool = False) -> str:
    """Write [lower, upper] in the format of ``spec``."""
    form = spec(lower, upper, exact=exact)
    return f"[{lower:{form}}, {upper:{form}}]"


def table(
    header: Sequence[object],
    rows: Sequence[Sequence[object]],
    *,
    caption: str,
    text_columns: int = 1,
    below: Sequence[str] = (),
) -> str:
    """Write an HTML table with sentences below it.

    The first ``text_columns`` are aligned to the left, the others (numbers) to the
    right.
    """

    def line(cells: Sequence[object], tag: str) -> str:
        """Write a row."""
        inside = ""
        for k, cell in enumerate(cells):
            style = f"{_CELL}{'left' if k < text_columns else 'right'}"
            inside += f'<{tag} style="{style}">{escape(str(cell))}</{tag}>'
        return f"<tr>{inside}</tr>"

    head = f"<thead>{line(header, 'th')}</thead>" if header else ""
    body = "".join(line(row, "td") for row in rows)
    sentences = "".join(f"<p>{escape(text)}</p>" for text in below)
    title = f'<caption style="text-align:left">{escape(caption)}</caption>'
    return f"<div><table>{title}{head}<tbody>{body}</tbody></table>{sentences}</div>"


def facts(caption: str, rows: Sequence[tuple[str, object]]) -> str:
    """Write an HTML table of names and values."""
    return table([], rows, caption=caption, text_columns=2)


def text(words: object, caption: str) -> str:
    """Write a table that is laid out for the terminal as preformatted HTML."""
    return f"<div><p>{escape(caption)}</p><pre>{escape(str(words))}</pre></div>"
