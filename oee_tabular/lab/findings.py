"""What a table shows, in its own numbers: the words of the figures' titles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


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
    ordered = sorted(values)
    return " to ".join(dict.fromkeys([write(ordered[0]), write(ordered[-1])]))


def listed(values: pd.Series[float], write: Callable[[float], str] = number) -> str:
    """Each value with its name, in their order: "0.01 (default), 0.2 (simulator)"."""
    return ", ".join(f"{write(x)} ({name})" for name, x in values.items())
