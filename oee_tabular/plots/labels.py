"""Names at the ends of lines, in place of a legend."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.plots.style import literally

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPACE = 1.25  # between two names, in letters' heights


def label_ends(ax: Axes, *, fontsize: float = 8.0) -> Axes:
    """Each line's name to the right of the axes, at the height of its last point and in its colour; no legend.

    Names that would overlap are moved apart, no more than it takes. To be called last: limits and scales stay as they are.

    Parameters
    ----------
    ax : with lines that have labels
    fontsize : in points, below 100

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from oee_tabular.plots import plot_curves
    >>> ax = label_ends(plot_curves([0, 1], {"low": [0, 1], "high": [0, 2]}, Figure().subplots()))
    >>> [text.get_text() for text in ax.texts], ax.get_legend()
    (['low', 'high'], None)
    """
    _checks.number_in(fontsize, "fontsize", 0.0, 100.0, open_ends=True)
    lines = [line for line in ax.get_lines() if not str(line.get_label()).startswith("_")]
    named = [(line, end) for line in lines if (end := _end(np.asarray(line.get_xydata()))) is not None]
    if named:
        ax.get_ylim()  # brings the limits, and with them transData, up to date
        to_axes = ax.transData + ax.transAxes.inverted()
        ends = np.clip([to_axes.transform(end)[1] for _, end in named], 0.0, 1.0)
        height = ax.get_window_extent().height * 72.0 / ax.figure.dpi
        places = apart(ends, SPACE * fontsize / height)
        for (line, _), place in zip(named, places, strict=True):
            ax.text(1.02, place, str(line.get_label()), transform=ax.transAxes, color=line.get_color(),
                    fontsize=fontsize, va="center")  # fmt: skip
    literally(ax.texts)
    legend = ax.get_legend()
    if legend is not None:
        legend.remove()
    return ax


def _end(points: Array) -> Array | None:
    """The last point that is there."""
    there = points[np.isfinite(points).all(axis=1)]
    return there[-1] if len(there) else None


def apart(heights: Array, gap: float) -> Array:
    """Heights at least ``gap`` apart in the same order, nearest to those given (least squares).

    >>> apart(np.array([0.5, 0.5, 0.9]), 0.1).round(9).tolist()
    [0.45, 0.55, 0.9]
    """
    from scipy.optimize import isotonic_regression

    order = np.argsort(heights, kind="stable")
    shifts = heights[order] - gap * np.arange(len(order))  # which may not fall
    found = np.empty(len(order))
    found[order] = isotonic_regression(shifts).x + gap * np.arange(len(order))
    return found
