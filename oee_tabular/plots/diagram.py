"""The problem in one picture: simulator, target, policy, log, and value."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from oee_tabular._keywords import suggest_keywords
from oee_tabular.plots import style
from oee_tabular.plots.style import COLORS, INK, PAPER

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH, HEIGHT = 16.0, 9.0  # units of the drawing


class Box(NamedTuple):
    """Hold a box: the middle, the name, what it says below, and its colour."""

    x: float
    y: float
    name: str
    text: str
    color: str


BOX_WIDTH, BOX_HEIGHT = 4.1, 2.3
BOXES = {
    "simulator": Box(
        2.25, 7.5, "Simulator", "probabilities known,\nsomewhat wrong", COLORS[0]
    ),
    "policy": Box(
        8.0, 7.5, "Policy", "made in the simulator,\nnot run in the target", COLORS[0]
    ),
    "target": Box(
        2.25, 1.5, "Target", "the real robot,\nprobabilities unknown", COLORS[1]
    ),
    "log": Box(8.0, 1.5, "Log", "a few transitions,\nby another policy", COLORS[1]),
    "value": Box(
        13.75, 4.5, "Value", "of the policy in the\ntarget, with interval", COLORS[2]
    ),
}


class Arrow(NamedTuple):
    """Hold an arrow: its ends, how it bends, its line, its word and where that is."""

    start: tuple[float, float]
    end: tuple[float, float]
    bend: str
    look: str
    dashes: str
    word: str
    place: tuple[float, float]


STRAIGHT = "arc3"
ARROWS = (
    Arrow((4.35, 7.5), (5.9, 7.5), STRAIGHT, "-|>", "-", "makes", (5.1, 7.8)),
    Arrow((4.35, 1.5), (5.9, 1.5), STRAIGHT, "-|>", "-", "records", (5.1, 1.8)),
    Arrow(
        (3.6, 6.3),
        (11.65, 4.5),
        "angle,angleA=-90,angleB=180,rad=6",
        "-|>",
        "-",
        "corrected by the log",
        (7.9, 4.8),
    ),
    Arrow(
        (10.1, 7.5),
        (13.75, 5.7),
        "angle,angleA=0,angleB=90,rad=6",
        "-|>",
        "-",
        "is evaluated",
        (12.0, 7.8),
    ),
    Arrow(
        (10.1, 1.5),
        (13.75, 3.3),
        "angle,angleA=0,angleB=-90,rad=6",
        "-|>",
        "-",
        "says how sure",
        (12.0, 1.8),
    ),
    Arrow(
        (0.9, 6.3),
        (0.9, 2.7),
        STRAIGHT,
        "<|-|>",
        "--",
        "they differ, and\nnobody knows how",
        (1.2, 3.2),
    ),
)


@suggest_keywords
def schematic(ax: Axes | None = None) -> Axes:
    """Draw what the package answers: simulator, target, policy, log and value.

    Parameters
    ----------
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure; inside ``slides`` it is a slide.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If ``ax`` are no axes.

    See Also
    --------
    slides : Makes pictures for slides.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = schematic(Figure().subplots())
    >>> "Simulator" in [text.get_text() for text in ax.texts]
    True
    """
    from matplotlib.patches import Rectangle

    ax = style.check_axes(ax, (6.4, 3.6))
    ax.set(xlim=(0, WIDTH), ylim=(0, HEIGHT), aspect="equal")
    ax.set_axis_off()
    # a ground of its own, on which a dark page shows the dark letters
    ax.add_patch(Rectangle((0, 0), WIDTH, HEIGHT, fc=PAPER, ec="none", zorder=0))
    for box in BOXES.values():
        _draw_box(ax, box)
    for arrow in ARROWS:
        _draw_arrow(ax, arrow)
    return ax


def _draw_box(ax: Axes, box: Box) -> None:
    """Draw a box with its name and what it says."""
    from matplotlib.patches import FancyBboxPatch

    corner = (box.x - 0.5 * BOX_WIDTH, box.y - 0.5 * BOX_HEIGHT)
    look: dict[str, Any] = {"fc": "none", "ec": box.color, "lw": 1.8, "zorder": 1}
    shape = "round,pad=0,rounding_size=0.25"
    ax.add_patch(FancyBboxPatch(corner, BOX_WIDTH, BOX_HEIGHT, shape, **look))
    words: dict[str, Any] = {"ha": "center", "va": "center", "color": INK}
    name: dict[str, Any] = {"fontsize": 11.0, "fontweight": "bold"}
    ax.text(box.x, box.y + 0.55, box.name, **name, **words)
    ax.text(box.x, box.y - 0.4, box.text, fontsize=8.0, linespacing=1.25, **words)


def _draw_arrow(ax: Axes, arrow: Arrow) -> None:
    """Draw an arrow with its word beside it."""
    from matplotlib.patches import FancyArrowPatch

    look: dict[str, Any] = {
        "arrowstyle": arrow.look,
        "connectionstyle": arrow.bend,
        "mutation_scale": 10.0,
        "shrinkA": 0.0,
        "shrinkB": 0.0,
        "color": INK,
        "lw": 1.2,
        "linestyle": arrow.dashes,
    }
    ax.add_patch(FancyArrowPatch(arrow.start, arrow.end, **look))
    is_beside = arrow.start[0] == arrow.end[0]
    ax.text(
        *arrow.place,
        arrow.word,
        fontsize=8.0,
        linespacing=1.25,
        ha="left" if is_beside else "center",
        va="bottom",
        color=INK,
    )
