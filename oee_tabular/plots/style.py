"""Colours, markers and lines that colour-blind readers can tell apart; figures as a PNG or as an SVG for a page."""

from __future__ import annotations

import html
import io
import itertools
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from oee_tabular.estimators.names import NAMED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

# Okabe and Ito's, then grey and brown; marker and line of the same index go with them, so that colour is never alone
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#8C6D31")
MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
LINES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 3)), (0, (3, 1)), (0, (1, 3)))
SEQUENTIAL, DIVERGING = "cividis", "PuOr_r"

# what an SVG's ink becomes: CSS variables of the page that it stands in, these colours where there are none
INK, QUIET, PAPER = "#1b1f23", "#8b9198", "#fdfdfe"
_ON_PAGE = {INK: "ink", QUIET: "quiet", PAPER: "paper"} | {color: f"series-{k}" for k, color in enumerate(COLORS)}
_SVG_STYLE = {
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "oee_tabular",  # the same picture, the same bytes
    "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": QUIET, "axes.titlecolor": INK,
    "xtick.color": QUIET, "ytick.color": QUIET, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "grid.color": QUIET, "grid.alpha": 0.25, "axes.spines.top": False, "axes.spines.right": False, "font.size": 10.0,
    "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none", "legend.frameon": False,
}  # fmt: skip


def series(k: int) -> dict[str, Any]:
    """Colour, marker and line of the k-th series; from the ninth on other markers, hollow, for the same colours."""
    again = 3 * (k // len(COLORS))
    style = {
        "color": COLORS[k % len(COLORS)],
        "marker": MARKERS[(k + again) % len(MARKERS)],
        "linestyle": LINES[(k + again) % len(LINES)],
    }
    return style | {"markerfacecolor": "none"} if again else style


def marks(k: int) -> dict[str, Any]:
    """The k-th series as marks without a line."""
    return series(k) | {"linestyle": "none"}


SOLID = ("simulator", "oee", "oee-product", "ratio-of-ratios", "model-based", "pdis", "wpdis", "oracle-product")


def places(names: Sequence[str]) -> list[int]:
    """The series of each name: an estimator that has a short name has its own everywhere, others take what is left, in order.

    The first eight, which have colours of their own, are those that reports show by themselves.

    >>> places(["model-based", "mine", "oee"]), places(["a", "b"])
    ([4, 0, 1], [0, 1])
    """
    known = {name: k for k, name in enumerate(dict.fromkeys((*SOLID, *NAMED)))}
    taken = {known[name] for name in names if name in known}
    free = (k for k in itertools.count() if k not in taken)
    return [known[name] if name in known else next(free) for name in names]


def ink() -> str:
    """The colour of text in the style that is in force."""
    import matplotlib

    return str(matplotlib.rcParams["text.color"])


def shown(name: object, longest: int = 36) -> str:
    """A name as a picture can hold it: no control characters, at most ``longest`` letters."""
    text = "".join(letter if letter.isprintable() else "\ufffd" for letter in str(name))
    return text if len(text) <= longest else text[: longest - 1] + "…"


def literally(texts: Sequence[Text]) -> None:
    """Names are text: a dollar sign in one starts no formula."""
    for text in texts:
        text.set_parse_math(False)


def figure_png(draw: Callable[[Axes], object], *, size: tuple[float, float] = (9.0, 4.8)) -> bytes:
    """The picture that ``draw`` makes on one axis, as the bytes of a PNG (no display, no global state).

    Parameters
    ----------
    draw : a function of the Axes
    size : (width, height) in inches

    Examples
    --------
    >>> figure_png(lambda ax: ax.plot([0, 1]), size=(2.0, 1.5))[1:4]
    b'PNG'
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    draw(figure.subplots())
    buffer = io.BytesIO()
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def figure_svg(
    draw: Callable[[Axes], object], *, name: str, title: str, description: str, size: tuple[float, float] = (4.4, 3.2)
) -> str:
    """The picture that ``draw`` makes on one axis, as an ``<svg>`` to stand inside a page.

    It has ``title`` and ``description`` as its text alternative, ids that start with ``name`` (unique on the page), no
    date, and as colours the page's CSS variables --ink, --quiet, --paper and --series-0 to --series-7 where it has them.
    The same call gives the same text.

    Parameters
    ----------
    draw : a function of the Axes
    name : of the picture, unique on its page
    title, description : its text alternative
    size : (width, height) in inches

    Examples
    --------
    >>> text = figure_svg(lambda ax: ax.plot([0, 1]), name="line", title="A line", description="It rises.")
    >>> text[:5], 'role="img"' in text
    ('<svg ', True)
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context(_SVG_STYLE):  # type: ignore[arg-type]  # names that matplotlib knows
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.subplots())
        buffer = io.StringIO()
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(buffer, metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return _for_page(buffer.getvalue(), name, title, description)


def _for_page(text: str, name: str, title: str, description: str) -> str:
    """Without what a page does not need or already has; ids and colours made the page's own."""
    body = text[text.index("<svg") :]
    box = re.search(r'viewBox="[^"]*"', body)
    inside = body[body.index(">") + 1 :]
    inside = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", inside, flags=re.S)
    inside = re.sub(r'<defs>\s*<style type="text/css">.*?</style>\s*</defs>', "", inside, count=1, flags=re.S)
    inside = re.sub(r'\bid="', f'id="{name}-', inside)
    inside = re.sub(r"url\(#", f"url(#{name}-", inside)
    inside = re.sub(r'(xlink:href|href)="#', rf'\1="#{name}-', inside)
    for color, variable in _ON_PAGE.items():
        inside = re.sub(rf"(fill|stroke): {color}\b", rf"\1: var(--{variable}, {color.lower()})", inside, flags=re.I)
    inside = re.sub(r"\s*\n\s*", "\n", inside)
    head = (
        f'<svg xmlns:xlink="http://www.w3.org/1999/xlink" xmlns="http://www.w3.org/2000/svg" {box.group() if box else ""} '
        f'class="plot" role="img" aria-labelledby="{name}-title {name}-desc">\n'
        f'<title id="{name}-title">{html.escape(title)}</title>\n<desc id="{name}-desc">{html.escape(description)}</desc>'
    )
    return head + inside.rstrip()
