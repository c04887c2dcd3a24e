"""Figures as data: which column of a table is x, which y, what tells its curves apart, and what its panels; their words."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular.plots import plot_curves
from oee_tabular.plots.style import INK

SIZE = (4.8, 3.9)  # of a panel, inches


@dataclass(frozen=True)
class Panels:
    """Curves of a table against one of its columns, in a panel for each group of its rows: a figure of an experiment.

    Attributes
    ----------
    y, x : columns; a point is the mean over the rows of an x (the seeds)
    curves : the column that tells the curves apart; None: there are those of ``extra`` alone
    by : columns that tell the groups apart
    title : of a panel, with columns of ``by`` in braces; None: their names and values
    xlabel, ylabel : with units
    extra : name -> another column of y, over all rows
    how : what a point is over the rows, as pandas' ``agg`` takes it
    bands : whether the smallest and the largest row of each point are shown
    only : rows -> those that are drawn
    log : whether y is logarithmic; what is not positive is left out
    slope : of a line in logarithmic axes through the first curve's first point; None: none
    beneath : (ax, rows) -> draws first what is no curve of the table
    axes : further settings, as ``Axes.set`` takes them
    beside : further panels for each group, whose ``by``, ``columns`` and ``size`` are this one's
    columns : panels side by side, None: all; size : of a panel, inches
    """

    y: str
    curves: str | None = None
    x: str = "n"
    by: tuple[str, ...] = ()
    title: str | None = None
    xlabel: str = "transitions of the target, n"
    ylabel: str = ""
    extra: Mapping[str, str] = field(default_factory=dict)
    how: str | Callable[[Any], float] = "mean"
    bands: bool = False
    only: Callable[[pd.DataFrame], pd.DataFrame] = lambda rows: rows
    log: bool = False
    slope: float | None = None
    beneath: Callable[[Any, pd.DataFrame], object] | None = None
    axes: Mapping[str, Any] = field(default_factory=dict)
    beside: Sequence[Panels] = ()
    columns: int | None = None
    size: tuple[float, float] = SIZE

    def __call__(self, table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
        """Draw a panel for each group, and those beside it."""
        groups: list[Any] = list(table.groupby(list(self.by), sort=False)) if self.by else [((), table)]
        parts = [(panel, rows, key) for key, rows in groups for panel in (self, *self.beside)]
        named = ", ".join(f"{name} = {{{name}}}" for name in self.by)
        titles = [
            (named if panel.title is None else panel.title).format(**dict(zip(self.by, key, strict=True)))
            for panel, _, key in parts
        ]
        axes = panels(figure, titles, columns=self.columns, size=self.size)
        for (panel, rows, _), ax in zip(parts, axes, strict=True):
            panel._draw(panel.only(rows), ax)

    def find(self, table: pd.DataFrame) -> str:
        """The three lowest curves at the largest x: "RMSE at n = 31623: 0.0041 (default), 0.012 (simulator)"."""
        rows = self.only(table)
        last = rows[self.x].max()
        values = rows[rows[self.x] == last].groupby(self.curves)[self.y].agg(self.how).sort_values()
        return f"{self.ylabel} at {self.x} = {last:g}: {listed(values.head(3))}"

    def _draw(self, rows: pd.DataFrame, ax: Any) -> None:
        by_x = rows.groupby(self.x)
        curves = {name: by_x[column].mean() for name, column in self.extra.items()}
        bands = {}
        if self.curves is not None:
            own = rows.groupby([self.x, self.curves], sort=False)[self.y]
            points, low, high = (own.agg(how).unstack().sort_index() for how in (self.how, "min", "max"))  # noqa: PD010
            names = rows[self.curves].unique()
            curves = {str(name): points[name] for name in names} | curves
            bands = {str(name): (low[name], high[name]) for name in names if self.bands}
        where = np.sort(rows[self.x].unique())
        if self.log:
            curves = {name: y.where(y > 0) for name, y in curves.items()}
        if self.beneath is not None:
            self.beneath(ax, rows)
        if self.slope is not None:
            add_slope(ax, where, next(iter(curves.values())).to_numpy(), self.slope)
        plot_curves(where, curves, ax, bands=bands, xlabel=self.xlabel, ylabel=self.ylabel)
        ax.set(**{"yscale": "log" if self.log else "linear"} | dict(self.axes))


def add_slope(ax: Any, n: Any, errors: Any, slope: float) -> None:
    """Add a line of this slope in logarithmic axes, from the first error."""
    label = f"slope {slope:g}"
    ax.plot(n, errors[0] * (n / n[0]) ** slope, color=INK, lw=1.0, ls=":", zorder=0, label=label)


def panels(
    figure: Any, names: Sequence[Any], *, columns: int | None = None, size: tuple[float, float] = SIZE
) -> list[Any]:
    """Titled axes side by side, each of ``size`` inches."""
    across = len(names) if columns is None else min(columns, len(names))
    down = -(-len(names) // across)
    figure.set_size_inches(size[0] * across, size[1] * down)
    axes = list(np.ravel(figure.subplots(down, across, squeeze=False)))
    for ax, name in zip(axes, names, strict=False):
        ax.set_title(str(name), fontsize="medium")
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    return axes[: len(names)]


# ---- what a table shows, in its own numbers: the words of the figures' titles


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
