"""Experiments as data: settings, a function from a cell of them to rows, and figures.

The cells are the product of the axes and the repetitions. ``run(cell, stream)`` returns
the rows of one cell; all its random numbers come from ``stream``, which knows the cell
and the seed alone. A cell's rows are therefore the same bits in any process, in any
order, in the full sweep and in its smoke subset. Tables and figures read the rows only.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from oee_tabular import _checks, _files
from oee_tabular.plots import (
    INK,
    draw_or_warn,
    fit_slide,
    has_slides,
    own_style,
    plot_curves,
)

Scalar = float | int | str | bool
Cell = Mapping[str, Any]  # name -> Scalar
Row = dict[str, Any]


@dataclass(frozen=True)
class Stream:
    """Random numbers of a cell.

    They are those of ``numpy.random.SeedSequence(seed, spawn_key=(words,
    repetition))``. The words are a digest of the experiment's id, of the settings named
    (all of the cell's by default; cells that name the same ones share their random
    numbers) and of what they are for (``use``): numbers for different uses are
    independent.
    """

    experiment: str
    seed: int
    cell: Cell

    def sequence(self, *names: str, use: str = "") -> np.random.SeedSequence:
        """Return the seed sequence of the named settings of the cell.

        Without names it is that of all settings.
        """
        settings = {
            name: self.cell[name] for name in names or self.cell if name != "repetition"
        }
        text = json.dumps(
            [self.experiment, settings, *([use] if use else [])], sort_keys=True
        )
        words = np.frombuffer(hashlib.sha256(text.encode()).digest()[:16], dtype=">u4")
        key = (*(int(word) for word in words), int(self.cell.get("repetition", 0)))
        return np.random.SeedSequence(self.seed, spawn_key=key)

    def generator(self, *names: str, use: str = "") -> np.random.Generator:
        """Return a new generator of ``sequence(*names, use=use)``.

        The same call gives the same numbers again.
        """
        return np.random.default_rng(self.sequence(*names, use=use))


def find_nothing(table: pd.DataFrame) -> str:
    """Return the finding of an experiment without one."""
    return ""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Definition of one figure or table.

    Attributes
    ----------
    id, title : str
        As in ``oee reproduce ID``; the title is that of the summary.
    axes : mapping of str to tuple
        The values of each setting.
    repetitions : int
        Number of seeds of each cell of the axes.
    smoke : mapping of str to tuple
        The values of a smoke run, of one seed; an axis that is not named has its first
        value.
    run : callable
        (cell, stream) -> rows; the cell's own settings are added to each row. Its
        docstring is the caption.
    keys : tuple of str
        Columns that tell the points of the summary apart.
    measures : tuple of str
        Numbers that are averaged over the repetitions, the first being what the
        experiment is about.
    draw : callable
        (table, summary, figure) -> None.
    finding : callable
        table -> what its rows show, in their own numbers, a line: the figure's title.
    paper : callable, optional
        Row of the summary -> the paper's number (nan where none was published).
    group : str
        One of "gridworld", "gymnasium", "sureness", "continuous" and "bench".
    requires : tuple of str
        Modules that the cells import and that an installation may lack.
    extra : str
        What installs them, where it is not called as the module is.
    """

    id: str
    title: str
    axes: Mapping[str, tuple[Scalar, ...]]
    run: Callable[[Cell, Stream], list[Row]]
    keys: tuple[str, ...]
    measures: tuple[str, ...]
    draw: Callable[[pd.DataFrame, pd.DataFrame, Any], None]
    finding: Callable[[pd.DataFrame], str] = find_nothing
    repetitions: int = 10
    smoke: Mapping[str, tuple[Scalar, ...]] = field(default_factory=dict)
    paper: Callable[[Any], float] | None = None
    group: str = "gridworld"
    requires: tuple[str, ...] = ()
    extra: str = ""

    @property
    def caption(self) -> str:
        """Return what the figure shows, and in which units."""
        return " ".join((self.run.__doc__ or "").split())

    def settings(
        self, *, smoke: bool = False, repetitions: int | None = None, seed: int = 0
    ) -> RunSettings:
        """Return the settings of the full sweep, or of its smoke subset.

        ``repetitions`` replaces the experiment's own number.
        """
        first = {name: values[:1] for name, values in self.axes.items()}
        axes = {**self.axes, **first, **self.smoke} if smoke else self.axes
        own = 1 if smoke else self.repetitions
        return RunSettings(self, axes, repetitions or own, seed)


def experiment(
    title: str, *, draw: Any, **options: Any
) -> Callable[[Callable[[Cell, Stream], list[Row]]], Experiment]:
    """Return a decorator that makes a function an experiment of its name.

    Without ``finding`` the finding is that of ``draw``, which must be ``Panels``.
    """
    options = {"finding": getattr(draw, "find", None), **options}
    return lambda run: Experiment(
        id=run.__name__, title=title, run=run, draw=draw, **options
    )


BYTES_OF_CELL = 400  # of a dict of a few settings


def check_cells(
    axes: Mapping[str, tuple[Scalar, ...]], repetitions: int, name: str
) -> None:
    """Raise an error that names the repetitions where memory cannot hold the cells."""
    n_points = math.prod(len(values) for values in axes.values())
    _checks.require_memory(
        n_points * repetitions, name, repetitions, size=BYTES_OF_CELL
    )


@dataclass(frozen=True, eq=False)
class RunSettings:
    """Settings that a results folder is made from.

    Attributes
    ----------
    experiment : Experiment
        The experiment that is run.
    axes : mapping of str to tuple
        The values of each setting in this run.
    repetitions : int
        Number of seeds of each cell.
    seed : int
        The seed of all random numbers.
    asked : mapping of str
        Settings that are no axes (of JSON's types); results of others are not taken for
        these.
    modules : tuple of str
        A user's modules that the cells run: their files are part of the code.
    """

    experiment: Experiment
    axes: Mapping[str, tuple[Scalar, ...]]
    repetitions: int
    seed: int
    asked: Mapping[str, Any] = field(default_factory=dict)
    modules: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check that the cells can be listed."""
        check_cells(self.axes, self.repetitions, "repetitions")

    def cells(self) -> list[Cell]:
        """Return every cell, in the order of the table."""
        axes = {**self.axes, "repetition": range(self.repetitions)}
        return [
            dict(zip(axes, point, strict=True))
            for point in itertools.product(*axes.values())
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return the settings as a dict for a JSON file."""
        axes = {name: list(values) for name, values in self.axes.items()}
        own = {
            "experiment": self.experiment.id,
            "axes": axes,
            "repetitions": self.repetitions,
            "seed": self.seed,
        }
        if self.asked:
            own["asked"] = dict(self.asked)
        return own


# ---- figures as data

SIZE = (4.8, 3.9)  # of a panel, inches


def keep_all(rows: pd.DataFrame) -> pd.DataFrame:
    """Return all rows."""
    return rows


@dataclass(frozen=True)
class Panels:
    """Figure of an experiment: curves of a table against one of its columns.

    There is a panel for each group of the table's rows.

    Attributes
    ----------
    y, x : str
        Columns; a point is the mean over the rows of an x (the seeds).
    curves : str, optional
        The column that tells the curves apart. None draws those of ``extra`` alone.
    by : tuple of str
        Columns that tell the groups apart.
    title : str, optional
        Title of a panel, with columns of ``by`` in braces. None means their names and
        values.
    xlabel, ylabel : str
        Labels with units.
    extra : mapping of str to str
        Name -> another column of y, over all rows.
    how : str or callable
        What a point is over the rows, as pandas' ``agg`` takes it.
    bands : bool
        Whether the smallest and the largest row of each point are shown.
    only : callable
        rows -> those that are drawn.
    log : bool
        Whether y is logarithmic; what is not positive is left out.
    slope : float, optional
        Slope of a line in logarithmic axes through the first curve's first point.
    beneath : callable, optional
        (ax, rows) -> draws first what is no curve of the table.
    axes : mapping of str
        Further settings, as ``Axes.set`` takes them.
    beside : sequence of Panels
        Further panels for each group, whose ``by``, ``columns`` and ``size`` are this
        one's.
    columns : int, optional
        Number of panels side by side; None puts all of them in one line.
    size : tuple of float
        Width and height of a panel in inches.
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
    only: Callable[[pd.DataFrame], pd.DataFrame] = keep_all
    log: bool = False
    slope: float | None = None
    beneath: Callable[[Any, pd.DataFrame], object] | None = None
    axes: Mapping[str, Any] = field(default_factory=dict)
    beside: Sequence[Panels] = ()
    columns: int | None = None
    size: tuple[float, float] = SIZE

    def __call__(self, table: pd.DataFrame, summary: pd.DataFrame, figure: Any) -> None:
        """Draw a panel for each group, and those beside it."""
        groups: list[Any] = [((), table)]
        if self.by:
            groups = list(table.groupby(list(self.by), sort=False))
        parts = [
            (panel, rows, key) for key, rows in groups for panel in (self, *self.beside)
        ]
        titles = [panel._title(self.by, key) for panel, _, key in parts]
        axes = panels(figure, titles, columns=self.columns, size=self.size)
        for (panel, rows, _), ax in zip(parts, axes, strict=True):
            panel._draw(panel.only(rows), ax)

    def find(self, table: pd.DataFrame) -> str:
        """Return the three lowest curves at the largest x.

        The text is as "RMSE at n = 31623: 0.0041 (default), 0.012 (simulator)".
        """
        rows = self.only(table)
        last = rows[self.x].max()
        values = (
            rows[rows[self.x] == last]
            .groupby(self.curves)[self.y]
            .agg(self.how)
            .sort_values()
        )
        return f"{self.ylabel} at {self.x} = {last:g}: {listed(values.head(3))}"

    def _title(self, by: tuple[str, ...], key: tuple[Any, ...]) -> str:
        """Return the title of a panel for the group with these values of ``by``."""
        form = self.title
        if form is None:
            form = ", ".join(f"{name} = {{{name}}}" for name in by)
        return form.format(**dict(zip(by, key, strict=True)))

    def _draw(self, rows: pd.DataFrame, ax: Any) -> None:
        """Draw the curves of these rows."""
        by_x = rows.groupby(self.x)
        curves = {name: by_x[column].mean() for name, column in self.extra.items()}
        bands = {}
        if self.curves is not None:
            own = rows.groupby([self.x, self.curves], sort=False)[self.y]
            points, low, high = (
                own.agg(how).unstack().sort_index()  # noqa: PD010
                for how in (self.how, "min", "max")
            )
            names = rows[self.curves].unique()
            curves = {str(name): points[name] for name in names} | curves
            for name in names if self.bands else ():
                bands[str(name)] = (low[name].to_numpy(), high[name].to_numpy())
        where = np.sort(rows[self.x].unique())
        if self.log:
            curves = {name: y.where(y > 0) for name, y in curves.items()}
        if self.beneath is not None:
            self.beneath(ax, rows)
        if self.slope is not None:
            add_slope(ax, where, next(iter(curves.values())).to_numpy(), self.slope)
        # all stand in the order of ``where``
        plain = {name: y.to_numpy() for name, y in curves.items()}
        plot_curves(
            where, plain, ax, bands=bands, xlabel=self.xlabel, ylabel=self.ylabel
        )
        yscale = "log" if self.log else "linear"
        ax.set(**{"yscale": yscale} | dict(self.axes))


def add_slope(ax: Any, n: Any, errors: Any, slope: float) -> None:
    """Add a line of this slope in logarithmic axes, from the first error."""
    label = f"slope {slope:g}"
    ax.plot(
        n,
        errors[0] * (n / n[0]) ** slope,
        color=INK,
        lw=1.0,
        ls=":",
        zorder=0,
        label=label,
    )


def panels(
    figure: Any,
    names: Sequence[Any],
    *,
    columns: int | None = None,
    size: tuple[float, float] = SIZE,
) -> list[Any]:
    """Return titled axes side by side, each of ``size`` inches."""
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
    """Write a number with two digits, as people do.

    >>> number(0.00412), number(31.4), number(612.0), number(3.2e7)
    ('0.0041', '31', '612', '3.2e+07')
    """
    return f"{x:.0f}" if 10.0 <= abs(x) < 1e5 else f"{x:.2g}"


def percent(share: float) -> str:
    """Write a share in per cent.

    >>> percent(0.9761), percent(0.0041)
    ('98%', '0.41%')
    """
    return f"{number(100.0 * share)}%"


def reach(values: Iterable[float], write: Callable[[float], str] = number) -> str:
    """Write the range from the smallest to the largest value.

    >>> reach([0.5, 0.1, 0.3]), reach([0.5])
    ('0.1 to 0.5', '0.5')
    """
    ordered = sorted(values)
    return " to ".join(dict.fromkeys([write(ordered[0]), write(ordered[-1])]))


def listed(values: pd.Series[float], write: Callable[[float], str] = number) -> str:
    """Write each value with its name, in their order.

    The text is as "0.01 (default), 0.2 (simulator)".
    """
    return ", ".join(f"{write(x)} ({name})" for name, x in values.items())


# ---- what is written of the rows

TITLE_SIZE = 12.0  # points at most
N_TITLE_LETTERS = 11.0  # of a title of several lines, in an inch


def summary_of(experiment: Experiment, table: pd.DataFrame) -> pd.DataFrame:
    """Summarize the measures at each point over the seeds.

    Each measure has its mean, standard deviation and standard error. There are the
    number of seeds and, where the paper has one, its number and ours / paper.
    """
    grouped = table.groupby(list(experiment.keys), sort=False, dropna=False)
    parts: list[Any] = [grouped.size().rename("seeds")]
    for measure in experiment.measures:
        columns = [f"{measure}_{name}" for name in ("mean", "sd", "se")]
        parts.append(
            grouped[measure].agg(["mean", "std", "sem"]).set_axis(columns, axis=1)
        )
    summary: pd.DataFrame = pd.concat(parts, axis=1).reset_index()
    if experiment.paper is not None:
        summary["paper"] = [experiment.paper(row) for row in summary.to_dict("records")]
        summary["ours / paper"] = (
            summary[f"{experiment.measures[0]}_mean"] / summary["paper"]
        )
    return summary


def files_of(settings: RunSettings, table: pd.DataFrame) -> dict[str, bytes]:
    """Return what is made of the rows of a sweep, by the names of the files.

    The same table gives the same bytes.
    """
    experiment = settings.experiment
    summary = summary_of(experiment, table)
    finding = experiment.finding(table)

    def draw(figure: Any) -> None:
        """Draw the experiment's figure with one legend and its finding as title."""
        experiment.draw(table, summary, figure)
        fit_slide(figure)  # before what depends on the width
        share_legend(figure)
        set_title(figure, finding)

    pictures = draw_or_warn(
        f"the figure of {experiment.id}", lambda: draw_bytes(draw, salt=experiment.id)
    )
    return {
        "table.csv": _files.csv_bytes(table),
        "summary.csv": _files.csv_bytes(summary, float_format="%.6g"),
        "summary.md": _files.text_bytes(page(settings, finding, summary)),
        **{f"figure.{kind}": content for kind, content in (pictures or {}).items()},
    }


def draw_bytes(
    draw: Callable[[Any], None],
    *,
    salt: str,
    kinds: tuple[str, ...] = ("svg", "png", "pdf"),
) -> dict[str, bytes]:
    """Return the bytes of the figure that ``draw`` makes, by kind, without a date."""
    from matplotlib.figure import Figure

    metadata: dict[str, object] = {
        "svg": {"Date": None},
        "png": {"Software": None},
        "pdf": {"CreationDate": None},
    }
    contents = {}
    # journals ask for TrueType (42) in PDF
    with own_style({"svg.hashsalt": salt, "svg.fonttype": "none", "pdf.fonttype": 42}):
        figure = Figure(layout="constrained")
        draw(figure)
        dpi = figure.dpi if fit_slide(figure) else 110
        for kind in kinds:
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata[kind])
            contents[kind] = buffer.getvalue()
    return contents


def share_legend(figure: Any) -> None:
    """Draw one legend below the panels instead of one in each.

    This is done where one panel has the series of all and more than three.
    """
    drawn = [ax for ax in figure.axes if ax.get_legend() is not None]
    entries = [
        dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
        for ax in drawn
    ]
    most: dict[str, Any] = max(entries, key=len, default={})
    # legends inside of a slide's panels would cover their curves
    n_few = 1 if has_slides() and len(drawn) > 1 else 3
    if len(most) <= n_few or any(entry.keys() - most.keys() for entry in entries):
        return
    for ax in drawn:
        ax.legend().remove()
    # About eleven letters of a small legend fit into an inch, eight of them its line.
    fitting = int(figure.get_figwidth() * 11 / (max(map(len, most)) + 8))
    columns = min(max(1, fitting), len(most))
    figure.legend(
        list(most.values()),
        list(most),
        loc="outside lower center",
        ncols=columns,
        fontsize="small",
    )


def set_title(figure: Any, text: str) -> None:
    """Set the title of a whole figure in letters small enough for one line."""
    if text:
        if has_slides():  # in several lines, which can be read
            text = textwrap.fill(text, int(N_TITLE_LETTERS * figure.get_figwidth()))
        title = figure.suptitle(text, fontsize=TITLE_SIZE)
        title.set_parse_math(False)
        width = title.get_window_extent().width
        title.set_fontsize(TITLE_SIZE * min(1.0, 0.98 * figure.bbox.width / width))


def page(settings: RunSettings, finding: str, summary: pd.DataFrame) -> str:
    """Return the summary as markdown.

    It has the title, the figure with what it shows, how it was made, and the numbers.
    """
    experiment = settings.experiment
    is_full = settings.as_dict()["axes"] == experiment.settings().as_dict()["axes"]
    words = ["oee reproduce", experiment.id]
    if not is_full:
        words.append("--smoke")
    words.append(f"--seeds {settings.repetitions}")
    if settings.seed:
        words.append(f"--seed {settings.seed}")
    command = " ".join(words)
    axes = "; ".join(
        f"{name} {', '.join(map(str, values))}"
        for name, values in settings.axes.items()
    )
    parts = [
        f"# {experiment.title}",
        f"![{finding or experiment.title}](figure.png)",
        experiment.caption,
        f"`{command}` ({axes}); every seed is in [table.csv](table.csv).",
        pipe_table(summary),
    ]
    return "\n\n".join(parts) + "\n"


def pipe_table(frame: pd.DataFrame) -> str:
    """Return a table in markdown."""

    def text(value: object) -> str:
        """Write a cell, with four digits of a float; nan is empty."""
        if isinstance(value, float):
            return "" if np.isnan(value) else f"{value:.4g}"
        return str(value).replace("|", "\\|")

    rows: list[Iterable[object]] = [
        frame.columns,
        *frame.itertuples(index=False, name=None),
    ]
    lines = ["| " + " | ".join(map(text, row)) + " |" for row in rows]
    rule = "|" + "".join("---|" for _ in frame.columns)
    return "\n".join([lines[0], rule, *lines[1:]])
