"""What a table shows, in its own numbers: the words of the figures' titles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

LARGEST = 12.0  # points
SHARE = 0.98  # of the figure's width


def entitle(figure: Figure, text: str) -> None:
    """The title of a whole figure: one line, in letters small enough for its width."""
    if text:
        title = figure.suptitle(text, fontsize=LARGEST)
        title.set_parse_math(False)
        title.set_fontsize(LARGEST * min(1.0, SHARE * figure.bbox.width / title.get_window_extent().width))


def number(x: float) -> str:
    """Two digits, as people write them.

    >>> number(0.00412), number(31.4), number(612.0), number(3.2e7)
    ('0.0041', '31', '612', '3.2e+07')
    """
    return f"{x:.0f}" if 10.0 <= abs(x) < 1e5 else f"{x:.2g}"


def percent(share: float) -> str:
    """A share, in per cent.

    >>> percent(0.9761), percent(0.0041)
    ('98%', '0.41%')
    """
    return f"{number(100.0 * share)}%"


def reach(values: Iterable[float], write: Callable[[float], str] = number) -> str:
    """From the smallest to the largest.

    >>> reach([0.5, 0.1, 0.3]), reach([0.5])
    ('0.1 to 0.5', '0.5')
    """
    ends = np.array(list(values), dtype=float)
    return " to ".join(dict.fromkeys([write(ends.min()), write(ends.max())]))


def listed(values: pd.Series[float], write: Callable[[float], str] = number) -> str:
    """Each value with its name, in their order: "0.01 (default), 0.2 (simulator)"."""
    return ", ".join(f"{write(x)} ({name})" for name, x in values.items())


def rank(
    what: str, y: str, by: str, x: str = "n", *, how: Callable[[Any], float] = np.mean, names: Iterable[str] = ()
) -> Callable[[pd.DataFrame], str]:
    """A finding: the statistic ``how`` of ``y`` at the largest ``x``, for the three smallest of ``by``, or for ``names``.

    It reads "RMSE at n = 31623: 0.0041 (default), 0.012 (simulator)".
    """

    def find(table: pd.DataFrame) -> str:
        last = table[x].max()
        values = table[table[x] == last].groupby(by)[y].apply(how).sort_values()
        chosen = values[[name for name in values.index if name in names]] if names else values
        return f"{what} at {x} = {last:g}: {listed(chosen.head(3))}"

    return find
