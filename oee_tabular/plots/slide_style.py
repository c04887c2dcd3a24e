"""Slides: pictures of 1920 x 1080 pixels, with letters that the last row can read."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from oee_tabular import _checks
from oee_tabular.exceptions import OutputWarning

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# A slide has 1920 x 1080 pixels, which are few inches with many pixels each: lines,
# marks and letters grow alike. Letters of 8 points, the smallest that pictures here
# have, are 36 pixels high, which is 18 points on a slide of 13.3 x 7.5 inches.
SLIDE_INCHES = (6.0, 3.375)
SLIDE_DPI = 320
MIN_SLIDE_POINTS = 8.0
MAX_SHRINKING = 1.6  # of a figure's inches on a slide, with letters as they are
N_LABEL_LETTERS = 10.0  # of an axis' label, in an inch
MAX_SLIDE_ROWS = 12  # of a forest plot, with its headings
SLIDE_STYLE: dict[Any, Any] = {
    "figure.figsize": SLIDE_INCHES,
    "figure.dpi": SLIDE_DPI,
    "figure.constrained_layout.use": True,
    "savefig.dpi": "figure",
    "font.size": 10.5,
}
_has_slides: ContextVar[bool] = ContextVar("has_slides", default=False)


@contextmanager
def slides() -> Iterator[None]:
    """Draw pictures for slides inside: 16:9, with type that the last row can read.

    A figure that is made inside has 1920 x 1080 pixels as a PNG, and the same shape as
    a PDF or an SVG. That holds for the pictures of this package, whatever their size is
    elsewhere, for the files that ``Report.save`` writes, and for your own figures of
    pyplot. Pictures of pages (``figure_svg``) stay as they are. A slide has room for
    twelve lines of a forest plot; a warning says which estimators are left out.

    Yields
    ------
    None
        Nothing; matplotlib's settings are the same as before at the end.

    See Also
    --------
    save_figure : Writes what a function draws to a file.

    Examples
    --------
    >>> from oee_tabular.plots import figure_png
    >>> with slides():
    ...     data = figure_png(lambda ax: ax.plot([0, 1]))
    >>> [int.from_bytes(data[k : k + 4], "big") for k in (16, 20)]  # width, height
    [1920, 1080]
    """
    import matplotlib

    token = _has_slides.set(True)
    try:
        with matplotlib.rc_context(SLIDE_STYLE):
            yield
    finally:
        _has_slides.reset(token)


def has_slides() -> bool:
    """Return whether pictures are made for slides just now."""
    return _has_slides.get()


@contextmanager
def without_slides() -> Iterator[None]:
    """Draw inside as outside of ``slides``."""
    token = _has_slides.set(False)
    try:
        yield
    finally:
        _has_slides.reset(token)


def fit_slide(figure: Any) -> bool:
    """Give a finished figure the shape of a slide, and say whether slides are made.

    Figures with more panels than a slide has room for get more inches, and with them
    smaller letters; a warning says so where they are less than half as high.
    """
    if not has_slides():
        return False
    width, height = figure.get_size_inches()
    if math.isclose(figure.dpi * width, SLIDE_DPI * SLIDE_INCHES[0]):
        return True  # it is one already
    crowding = max(width / SLIDE_INCHES[0], height / SLIDE_INCHES[1])
    scale = max(1.0, crowding / MAX_SHRINKING)
    if scale > 2.0:
        pixels = SLIDE_DPI / scale * MIN_SLIDE_POINTS / 72.0
        _checks.warn(
            "a picture has more panels or lines than a slide has room for; its letters"
            f" are only {pixels:.0f} pixels high",
            OutputWarning,
        )
    figure.set_size_inches([scale * inches for inches in SLIDE_INCHES])
    figure.set_dpi(SLIDE_DPI / scale)
    for ax in figure.axes:
        for label, inches in zip(
            (ax.xaxis.label, ax.yaxis.label), axes_inches(ax), strict=True
        ):
            letters = int(N_LABEL_LETTERS * inches)
            label.set_text(textwrap.fill(label.get_text(), max(letters, 12)))
    return True


def axes_inches(ax: Axes) -> tuple[float, float]:
    """Return the width and the height of axes before they are laid out."""
    box = ax.get_window_extent()
    return box.width / ax.figure.dpi, box.height / ax.figure.dpi
