"""Figures as data: which column of a table is x, which y, what tells its curves apart, and what its panels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.plots import plot_curves, plot_errors
from oee_tabular.plots.style import marks, shorten

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE = (4.8, 3.9)  # of a panel, inches
Band = tuple[Array, Array]


@dataclass(frozen=True)
class Panels:
    """Curves of a table against one of its columns, in a panel for each group of its rows: a figure of an experiment.

    Attributes
    ----------
    y, x : columns; a point is the mean over the rows of an x (the seeds)
    curves : the column that tells the curves apart; None: there are those of ``extra`` and ``also`` alone
    by : columns that tell the groups apart
    title : of a panel, with columns of ``by`` in braces; None: their names and values
    xlabel, ylabel : with units
    extra : name -> another column of y, over all rows
    also : rows -> further curves by name, each a Series over x
    how : what a point is instead of the mean
    bands : whether the smallest and the largest row of each point are shown
    only : rows -> those that are drawn
    least : curves that nowhere exceed it are left out
    log : whether y is logarithmic; what is not positive is left out
    beneath : (ax, rows) -> None, draws what is no curve of the table
    axes : further settings, as ``Axes.set`` takes them
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
    also: Callable[[pd.DataFrame], Mapping[str, pd.Series[float]]] | None = None
    how: Callable[[Any], float] = np.mean
    bands: bool = False
    only: Callable[[pd.DataFrame], pd.DataFrame] | None = None
    least: float = -np.inf
    log: bool = False
    beneath: Callable[[Axes, pd.DataFrame], None] | None = None
    axes: Mapping[str, Any] = field(default_factory=dict)
    columns: int | None = None
    size: tuple[float, float] = SIZE

    def __call__(self, table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
        """A panel for each group."""
        Beside([self], self.by, self.columns, self.size)(table, summary, figure)

    def draw(self, table: pd.DataFrame, ax: Axes) -> None:
        """The panel of these rows."""
        rows = table if self.only is None else self.only(table)
        if self.beneath is not None:
            self.beneath(ax, rows)
        where = sorted(rows[self.x].unique())
        parts = (
            [] if self.curves is None else [(str(name), part) for name, part in rows.groupby(self.curves, sort=False)]
        )
        points = {name: part.groupby(self.x)[self.y].apply(self.how) for name, part in parts}
        points |= {name: rows.groupby(self.x)[column].mean() for name, column in self.extra.items()}
        points |= {} if self.also is None else self.also(rows)
        curves = {
            name: y.reindex(where).to_numpy(dtype=float) for name, y in points.items() if not (y <= self.least).all()
        }
        bands: dict[str, Band] = {}
        for name, part in parts if self.bands else ():
            low, high = part.groupby(self.x)[self.y].agg(["min", "max"]).reindex(where).to_numpy(dtype=float).T
            bands |= {name: (low, high)} if name in curves else {}
        self._plot(where, curves, bands, ax)
        ax.set(**self.axes)

    def _plot(self, where: list[Any], curves: dict[str, Array], bands: dict[str, Band], ax: Axes) -> None:
        if self.log:
            curves = {name: np.where(y > 0, y, np.nan) for name, y in curves.items()}
            ax.set_yscale("log")
        plot_curves(where, curves, ax, bands=bands, xlabel=self.xlabel, ylabel=self.ylabel)


@dataclass(frozen=True)
class Errors(Panels):
    """Errors against n, both logarithmic, with a line of ``slope`` (None: none).

    With ``lowest`` the title says which curve is lowest at the last n, as far as it has a value there.
    """

    slope: float | None = None
    lowest: bool = True

    def _plot(self, where: list[Any], curves: dict[str, Array], bands: dict[str, Band], ax: Axes) -> None:
        ends = {name: y[-1] for name, y in curves.items() if np.isfinite(y[-1])}
        if self.lowest and len(ends) > 1:
            best = min(ends, key=lambda name: ends[name])
            ax.set_title(f"{ax.get_title()}\n{shorten(best)} ends lowest: {ends[best]:.2g}", fontsize="medium")
        plot_errors(where, curves, ax, bands=bands, slope=self.slope, xlabel=self.xlabel, ylabel=self.ylabel)


@dataclass(frozen=True)
class Ranges(Panels):
    """Means of y with their 95% ranges over the rows, a line for each value of ``curves``, a mark for each of ``x``.

    ``beside`` is a column that is drawn next to them, ``mark`` a value that is marked on the axis.
    """

    x: str = ""
    beside: str | None = None
    mark: float | None = None

    def draw(self, table: pd.DataFrame, ax: Axes) -> None:
        """The panel of these rows."""
        names, by = list(table[self.curves].unique()), self.x or table.columns[0]
        groups = list(table.groupby(by, sort=False))
        for k, (value, rows) in enumerate(groups):
            own = rows.groupby(self.curves)[self.y].agg(["mean", "sem"]).reindex(names)
            place = np.arange(len(names)) + 0.14 * (k - (len(groups) - 1) / 2)
            ax.errorbar(own["mean"], place, xerr=1.96 * own["sem"], ms=5, lw=1, label=f"{by} {value}", **marks(k))
        if self.beside is not None:
            other = table.groupby(self.curves)[self.beside].mean().reindex(names)
            ax.plot(other, range(len(names)), "k|", ms=14, label=self.beside)
        if self.mark is not None:
            ax.axvline(self.mark, color="black", lw=1, ls=":")
        ax.set_yticks(range(len(names)), names)
        ax.invert_yaxis()
        ax.grid(visible=True, alpha=0.3)
        ax.set_xlabel(self.xlabel)
        ax.legend(fontsize="small", loc="best")
        ax.set(**self.axes)


@dataclass(frozen=True)
class Beside:
    """Several panels side by side for each group of rows; ``by``, ``columns`` and ``size`` are these."""

    panels: Sequence[Panels]
    by: tuple[str, ...] = ()
    columns: int | None = None
    size: tuple[float, float] = SIZE

    def __call__(self, table: pd.DataFrame, summary: pd.DataFrame, figure: Figure) -> None:
        """Draw it."""
        groups: list[Any] = list(table.groupby(list(self.by), sort=False)) if self.by else [((), table)]
        parts = [(panel, rows, dict(zip(self.by, key, strict=True))) for key, rows in groups for panel in self.panels]
        titles = []
        for panel, _, values in parts:
            named = ", ".join(f"{name} = {{{name}:g}}" for name in values)
            titles.append((named if panel.title is None else panel.title).format(**values))
        axes = panels(figure, titles, columns=self.columns, size=self.size)
        for (panel, rows, _), ax in zip(parts, axes, strict=True):
            panel.draw(rows, ax)


def panels(
    figure: Figure, names: Sequence[Any], *, columns: int | None = None, size: tuple[float, float] = SIZE
) -> list[Axes]:
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
