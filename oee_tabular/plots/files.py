"""Files of pictures: PNG, PDF and SVG, and SVG text for a page."""

from __future__ import annotations

import html
import io
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oee_tabular import _checks, _files
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.plots.slide_style import SLIDE_INCHES, has_slides, without_slides
from oee_tabular.plots.style import (
    COLORS,
    INK,
    PAPER,
    QUIET,
    check_pair,
    check_texts,
    own_style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# What an SVG's colours become on a page that has CSS variables for them.
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
    with without_slides(), own_style(_SVG_STYLE):
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
    ax = figure.subplots()
    _checks.call_function(draw, "draw", "draw(ax), ax an Axes of matplotlib", ax)
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
