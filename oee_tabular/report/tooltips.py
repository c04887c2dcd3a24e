"""Tooltips in the pictures of a page: SVG titles, which need no script.

An invisible rectangle stands over each part of a picture, and its ``<title>`` is what a
browser shows there.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from oee_tabular import plots

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# matplotlib gives what is wholly transparent no fill, and a browser then no tooltip
MIN_ALPHA = 1e-3


@dataclass(frozen=True)
class Tooltip:
    """Hold what a browser shows over a rectangle of a picture.

    Attributes
    ----------
    x : float
        The left end, in units of the axis.
    y : float
        The lower end, in units of the axis.
    width : float
        The width, in units of the axis.
    height : float
        The height, in units of the axis.
    text : str
        What is shown.
    """

    x: float
    y: float
    width: float
    height: float
    text: str


def draw_with_tooltips(
    draw: Callable[[Axes], object],
    tips: Sequence[Tooltip],
    *,
    name: str,
    title: str,
    description: str,
    size: tuple[float, float],
    across: bool = False,
) -> str:
    """Return ``plots.figure_svg`` of a picture with tooltips over it.

    With ``across`` the x of a tooltip is a share of the picture's width.
    """

    def draw_all(ax: Axes) -> None:
        """Draw the picture, and an invisible rectangle for each tooltip."""
        from matplotlib.patches import Rectangle

        draw(ax)
        transform = ax.get_yaxis_transform() if across else ax.transData
        for k, tip in enumerate(tips):
            ax.add_artist(
                Rectangle(
                    (tip.x, tip.y),
                    tip.width,
                    tip.height,
                    facecolor="white",
                    alpha=MIN_ALPHA,
                    linewidth=0.0,
                    transform=transform,
                    zorder=10.0,
                    gid=f"tip{k}",
                )
            )

    picture = plots.figure_svg(
        draw_all, name=name, title=title, description=description, size=size
    )

    def add_title(found: re.Match[str]) -> str:
        """Return the start of a rectangle's group with its title."""
        return f"{found[0]}<title>{html.escape(tips[int(found[1])].text)}</title>"

    return re.sub(rf'<g id="{re.escape(name)}-tip(\d+)">', add_title, picture)
