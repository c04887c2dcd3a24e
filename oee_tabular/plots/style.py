"""Colours, markers and lines that colour-blind readers tell apart; texts and axes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError, OutputWarning
from oee_tabular.plots.slide_style import (
    SLIDE_INCHES,
    SLIDE_STYLE,
    axes_inches,
    has_slides,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

Picture = TypeVar("Picture")

# Okabe and Ito's colours, then grey and brown. A series has the marker and the line of
# the same index as well, so that nothing is told by colour alone.
COLORS = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#7F7F7F",
    "#8C6D31",
)
MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
LINES: tuple[Any, ...] = (
    "-",
    "--",
    "-.",
    ":",
    (0, (5, 1, 1, 1, 1, 1)),
    (0, (8, 3)),
    (0, (3, 1)),
    (0, (1, 3)),
)
SEQUENTIAL = "cividis"
DIVERGING = "PuOr_r"
# The estimators that reports show by default. Each has one of the eight series to
# itself.
ESTIMATORS = (
    "simulator",
    "oee",
    "oee-product",
    "ratio-of-ratios",
    "model-based",
    "pdis",
    "wpdis",
    "oracle-product",
)

# The colours of an SVG's texts, lines and ground.
INK = "#1b1f23"
QUIET = "#8b9198"
PAPER = "#fdfdfe"

# the dashed line of what is true
TRUTH: dict[str, Any] = {"color": INK, "lw": 1.2, "ls": (0, (4, 2)), "zorder": 1}


def series(k: int) -> dict[str, Any]:
    """Return colour, marker and line of the k-th series.

    From the ninth on the colours come again with other markers, which are hollow.
    """
    again = 3 * (k // len(COLORS))
    style = {
        "color": COLORS[k % len(COLORS)],
        "marker": MARKERS[(k + again) % len(MARKERS)],
        "linestyle": LINES[(k + again) % len(LINES)],
    }
    return style | {"markerfacecolor": "none"} if again else style


def places(names: Sequence[str]) -> list[int]:
    """Return the series of each name, the same one in every picture.

    A name in ``ESTIMATORS`` has its own; others take what is left, in order.

    >>> places(["model-based", "mine", "oee", "mine"]), places(["a", "b"])
    ([4, 0, 1, 0], [0, 1])
    """
    numbers = {name: ESTIMATORS.index(name) for name in names if name in ESTIMATORS}
    free = (k for k in itertools.count() if k not in numbers.values())
    return [
        numbers[name] if name in numbers else numbers.setdefault(name, next(free))
        for name in names
    ]


def check_labels(names: object, argument: str, rule: str) -> tuple[Any, ...]:
    """Convert names for a picture to a tuple of texts or numbers."""
    labels = _checks.collection(names, argument, rule)
    for k, label in enumerate(labels):
        if not isinstance(label, str | int | float | np.generic):
            raise ArgumentError(
                f"{argument}[{k}]", f"must be a text; got {_checks.show(label)}"
            )
    return labels


def shorten(name: object, longest: int = 36) -> str:
    """Return a name as a picture can hold it: printable, and not too long."""
    whole = (
        str(name)
        if isinstance(name, str | int | float | np.generic)
        else _checks.show(name)
    )
    text = "".join(letter if letter.isprintable() else "\ufffd" for letter in whole)
    return text if len(text) <= longest else text[: longest - 1] + "…"


def disable_math(texts: Sequence[Text]) -> None:
    """Show names as they are: a dollar sign in one starts no formula."""
    for text in texts:
        text.set_parse_math(False)


def label_rows(ax: Axes, labels: Any) -> None:
    """Write a label beside each row, row 0 on top."""
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(max(len(labels), 1) - 0.4, -0.6)
    if has_slides():
        # the title takes a part of the height that the axes have now
        height_points = 72.0 * 0.8 * axes_inches(ax)[1] / max(len(labels), 1)
        ax.tick_params(axis="y", labelsize=min(10.5, 0.9 * height_points))
    ax.tick_params(axis="y", length=0)
    disable_math(ax.get_yticklabels())


def check_axes(ax: Axes | None, size: tuple[float, float] = (6.4, 3.8)) -> Axes:
    """Return ``ax``, or new pyplot axes of ``size`` inches for None."""
    if ax is None:
        from matplotlib import pyplot

        inches = SLIDE_INCHES if has_slides() else size
        ax = pyplot.subplots(figsize=inches, layout="constrained")[1]
    if not hasattr(ax, "get_xaxis"):
        raise ArgumentError(
            "ax",
            f"must be matplotlib Axes, or None for new ones; got {_checks.show(ax)}",
        )
    return ax


def check_texts(**texts: object) -> None:
    """Refuse titles and labels that are not text."""
    for name, text in texts.items():
        _checks.instance(text, str, name, "text")


def check_pair(pair: object, name: str) -> tuple[float, float]:
    """Return two finite numbers, or raise an error that names the argument."""
    ends = _checks.float_array(pair, name)
    if ends.shape != (2,) or not np.isfinite(ends).all():
        raise ArgumentError(
            name, f"must be two finite numbers; got {_checks.show(pair)}"
        )
    return float(ends[0]), float(ends[1])


@contextmanager
def own_style(settings: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Draw inside with matplotlib's defaults and these settings.

    A user's own (LaTeX for all texts, a backend that is missing) are left out, and are
    the same as before at the end.
    """
    import matplotlib

    slide = SLIDE_STYLE if has_slides() else {}
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        named: dict[Any, Any] = slide | dict(settings or {})
        matplotlib.rcParams.update(named)
        yield


def draw_or_warn(name: str, draw: Callable[[], Picture]) -> Picture | None:
    """Return the picture that ``draw`` makes; if it fails, warn and return None.

    A picture that cannot be drawn must not take the table with it.
    """
    try:
        return draw()
    except Exception as error:  # matplotlib's, of fonts, or of a full disk
        reason = f"{type(error).__name__}: {' '.join(str(error).split()):.200}"
        _checks.warn(
            f"{name} is left out, because it cannot be drawn ({reason})", OutputWarning
        )
        return None
