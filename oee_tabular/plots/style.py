"""Colours, markers and lines that colour-blind readers tell apart; figures as files."""

from __future__ import annotations

import html
import io
import itertools
import math
import os
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from oee_tabular import _checks, _files
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError, OutputWarning

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

# The colours of an SVG's texts, lines and ground. On a page that has CSS variables for
# them (``_ON_PAGE``) they become these.
INK = "#1b1f23"
QUIET = "#8b9198"
PAPER = "#fdfdfe"
_ON_PAGE = {INK: "ink", QUIET: "quiet", PAPER: "paper"} | {
    color: f"series-{k}" for k, color in enumerate(COLORS)
}
_SVG_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "oee_tabular",  # the same picture, the same bytes
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": QUIET,
    "axes.titlecolor": INK,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "grid.color": QUIET,
    "grid.alpha": 0.25,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 10.0,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "legend.frameon": False,
}

# ---- files and slides

KINDS = ("png", "pdf", "svg")  # of the files of a picture
# What a file has beside the picture: no date, so that the same picture has the same
# bytes.
_METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None},
    "svg": {"Date": None},
}
# Text stays text in an SVG; journals ask for TrueType (42) in a PDF.
_FILE_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "oee_tabular",
    "pdf.fonttype": 42,
}
# A slide has 1920 x 1080 pixels, which are few inches with many pixels each: lines,
# marks and letters grow alike. Letters of 8 points, the smallest that pictures here
# have, are 36 pixels high, which is 18 points on a slide of 13.3 x 7.5 inches.
SLIDE_INCHES = (6.0, 3.375)
SLIDE_DPI = 320
MIN_SLIDE_POINTS = 8.0
MAX_SHRINKING = 1.6  # of a figure's inches on a slide, with letters as they are
N_LABEL_LETTERS = 10.0  # of an axis' label, in an inch
MAX_SLIDE_ROWS = 12  # of a forest plot, with its headings
_SLIDE_STYLE: dict[Any, Any] = {
    "figure.figsize": SLIDE_INCHES,
    "figure.dpi": SLIDE_DPI,
    "figure.constrained_layout.use": True,
    "savefig.dpi": "figure",
    "font.size": 10.5,
}
_has_slides: ContextVar[bool] = ContextVar("has_slides", default=False)


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
        height_points = 72.0 * 0.8 * _inches(ax)[1] / max(len(labels), 1)
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

    slide = _SLIDE_STYLE if has_slides() else {}
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        named: dict[Any, Any] = slide | dict(settings or {})
        matplotlib.rcParams.update(named)
        yield


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
    >>> with slides():
    ...     data = figure_png(lambda ax: ax.plot([0, 1]))
    >>> [int.from_bytes(data[k : k + 4], "big") for k in (16, 20)]  # width, height
    [1920, 1080]
    """
    import matplotlib

    token = _has_slides.set(True)
    try:
        with matplotlib.rc_context(_SLIDE_STYLE):
            yield
    finally:
        _has_slides.reset(token)


def has_slides() -> bool:
    """Return whether pictures are made for slides just now."""
    return _has_slides.get()


@contextmanager
def _without_slides() -> Iterator[None]:
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
            (ax.xaxis.label, ax.yaxis.label), _inches(ax), strict=True
        ):
            letters = int(N_LABEL_LETTERS * inches)
            label.set_text(textwrap.fill(label.get_text(), max(letters, 12)))
    return True


def _inches(ax: Axes) -> tuple[float, float]:
    """Return the width and the height of axes before they are laid out."""
    box = ax.get_window_extent()
    return box.width / ax.figure.dpi, box.height / ax.figure.dpi


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


@suggest_keywords
def figure_png(
    draw: Callable[[Axes], object], *, size: tuple[float, float] = (9.0, 4.8)
) -> bytes:
    """Return the picture that ``draw`` makes on one axis, as the bytes of a PNG.

    No display is used, and no setting but matplotlib's defaults.

    Parameters
    ----------
    draw : callable
        Function of a ``matplotlib.axes.Axes``, on which it draws.
    size : tuple of two floats, default (9.0, 4.8)
        Width and height in inches, each from 0.1 to 100. Inside ``slides`` it is that
        of a slide.

    Returns
    -------
    bytes
        The content of a PNG file.

    Raises
    ------
    ValueError
        If ``draw`` is no function, or a size is out of range.

    See Also
    --------
    figure_svg : The same as SVG text for a page.
    save_figure : The same as a PNG, PDF or SVG file.

    Examples
    --------
    >>> figure_png(lambda ax: ax.plot([0, 1]), size=(2.0, 1.5))[1:4]
    b'PNG'
    """
    with own_style():
        return _save(draw, size, "png", _METADATA["png"])


@suggest_keywords
def save_figure(
    draw: Callable[[Axes], object],
    path: str | os.PathLike[str],
    *,
    size: tuple[float, float] = (9.0, 4.8),
) -> Path:
    """Write the picture that ``draw`` makes on one axis to a PNG, PDF or SVG file.

    The ending of the path says which. No display is used, and no setting but
    matplotlib's defaults. The file appears whole or not at all.

    Parameters
    ----------
    draw : callable
        Function of a ``matplotlib.axes.Axes``, on which it draws; ``report.plot`` is
        one.
    path : str or path
        The file, which is replaced if it is there: .png, .pdf or .svg.
    size : tuple of two floats, default (9.0, 4.8)
        Width and height in inches, each from 0.1 to 100. Inside ``slides`` it is that
        of a slide.

    Returns
    -------
    Path
        The path of the file.

    Raises
    ------
    ValueError
        If ``draw`` is no function, the path has another ending, or a size is out of
        range.

    See Also
    --------
    slides : Makes pictures for slides.
    figure_svg : The picture as SVG text for a page.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = save_figure(lambda ax: ax.plot([0, 1]), Path(folder) / "line.pdf")
    ...     file.read_bytes()[:5]
    b'%PDF-'
    """
    endings = tuple(f".{kind}" for kind in KINDS)
    _files.require_ending(_files.local(path), endings)
    kind = Path(path).name.lower().rpartition(".")[2]
    with own_style(_FILE_STYLE):
        content = _save(draw, size, kind, _METADATA[kind])
    with _files.whole_file(path) as file:
        file.write(content)
    return Path(path)


def figure_files(
    draw: Callable[[Axes], object], stem: str, *, size: tuple[float, float]
) -> dict[str, bytes]:
    """Return the picture that ``draw`` makes as a PNG, a PDF and an SVG, by name."""
    with own_style(_FILE_STYLE):
        figure = _figure(draw, size)
        return {
            f"{stem}.{kind}": _print(figure, kind, _METADATA[kind]) for kind in KINDS
        }


@suggest_keywords
def figure_svg(
    draw: Callable[[Axes], object],
    *,
    name: str,
    title: str,
    description: str,
    size: tuple[float, float] = (4.4, 3.2),
) -> str:
    """Return the picture that ``draw`` makes on one axis, as SVG text for a page.

    Its ids start with ``name``. Its colours are the page's CSS variables --ink,
    --quiet, --paper and --series-0 to --series-7 where it has them. The same call gives
    the same text.

    Parameters
    ----------
    draw : callable
        Function of a ``matplotlib.axes.Axes``, on which it draws.
    name : str
        Name of the picture, unique on its page.
    title : str
        Title of the text alternative.
    description : str
        Description of the text alternative.
    size : tuple of two floats, default (4.4, 3.2)
        Width and height in inches, each from 0.1 to 100.

    Returns
    -------
    str
        An ``<svg>`` element.

    Raises
    ------
    ValueError
        If ``draw`` is no function, a text is none, or a size is out of range.

    See Also
    --------
    figure_png : The same as the bytes of a PNG.

    Examples
    --------
    >>> text = figure_svg(
    ...     lambda ax: ax.plot([0, 1]),
    ...     name="line",
    ...     title="A line",
    ...     description="It rises.",
    ... )
    >>> text[:5], 'role="img"' in text
    ('<svg ', True)
    """
    check_texts(name=name, title=title, description=description)
    nothing = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with _without_slides(), own_style(_SVG_STYLE):
        text = _save(draw, size, "svg", nothing).decode()
    tag, _, inside = text[text.index("<svg") :].partition(">")
    changes = {
        # without what a page does not need or has already
        r"<metadata>.*?</metadata>|<!--.*?-->": "",
        r'<defs>\s*<style type="text/css">.*?</style>\s*</defs>': "",
        # ids and colours made the page's own
        r'(\bid="|url\(#|href="#)': rf"\1{name}-",
        **{
            rf"(fill|stroke): {color}\b": rf"\1: var(--{variable}, {color.lower()})"
            for color, variable in _ON_PAGE.items()
        },
        r"\s*\n\s*": "\n",
    }
    for pattern, replacement in changes.items():
        inside = re.sub(pattern, replacement, inside, flags=re.IGNORECASE | re.DOTALL)
    (box,) = re.findall(r'viewBox="[^"]*"', tag)
    return (
        '<svg xmlns:xlink="http://www.w3.org/1999/xlink"'
        f' xmlns="http://www.w3.org/2000/svg" {box} class="plot" role="img"'
        f' aria-labelledby="{name}-title {name}-desc">\n<title'
        f' id="{name}-title">{html.escape(title)}</title>\n<desc'
        f' id="{name}-desc">{html.escape(description)}</desc>{inside.rstrip()}'
    )


def _save(
    draw: Callable[[Axes], object],
    size: tuple[float, float],
    kind: str,
    metadata: dict[str, Any],
) -> bytes:
    """Return the file of one kind of what ``draw`` draws."""
    return _print(_figure(draw, size), kind, metadata)


def _figure(draw: Callable[[Axes], object], size: tuple[float, float]) -> Any:
    """Return the figure on whose only axes ``draw`` has drawn."""
    from matplotlib.figure import Figure

    _checks.function(draw, "draw")
    inches = check_pair(size, "size")
    if not 0.1 <= min(inches) <= max(inches) <= 100.0:
        raise ArgumentError("size", f"must be from 0.1 to 100 inches; it is {inches}")
    shape = SLIDE_INCHES if has_slides() else inches
    figure = Figure(figsize=shape, layout="constrained")
    draw(figure.subplots())
    return figure


def _print(figure: Any, kind: str, metadata: dict[str, Any]) -> bytes:
    """Return the file that a backend makes of a figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    canvases = {"png": FigureCanvasAgg, "pdf": FigureCanvasPdf, "svg": FigureCanvasSVG}
    canvas: Any = canvases[kind](figure)
    buffer = io.BytesIO()
    dpi = figure.dpi  # PDF and SVG leave theirs
    # savefig would read SOURCE_DATE_EPOCH
    getattr(canvas, f"print_{kind}")(buffer, metadata=metadata)
    figure.set_dpi(dpi)
    return buffer.getvalue()
