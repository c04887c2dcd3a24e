"""Values with their intervals, by policy; the states where a policy spends its time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError, OutputWarning
from oee_tabular.plots import style
from oee_tabular.plots.slide_style import MAX_SLIDE_ROWS, has_slides
from oee_tabular.plots.style import COLORS, INK, check_texts, disable_math, shorten
from oee_tabular.typing import Array, IntArray, RealArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = {"policy", "estimator", "value", "lower", "upper", "true_value"}
# what is further from the intervals than so many widths of a typical one does not
# stretch the axis
MAX_REACH_WIDTHS = 15.0
N_LETTERS_PER_INCH = 11.0  # of text


class Lines(NamedTuple):
    """Hold the lines of a forest plot, (k,) each, and the texts of their groups."""

    names: Sequence[str]
    value: Array
    lower: Array
    upper: Array
    group: Array

    @property
    def ends(self) -> Array:
        """Return the lower and the upper end of each line's interval, (k, 2)."""
        return np.stack([self.lower, self.upper], axis=1)


@suggest_keywords
def plot_values(
    records: Sequence[Mapping[str, Any]],
    ax: Axes | None = None,
    *,
    title: str = "",
    unit: str = "",
    limits: tuple[float, float] | None = None,
) -> Axes:
    """Draw the values of a report with their intervals, a line for each estimator.

    Policies stand one below the other. Exact values in the target are dashed lines.

    Parameters
    ----------
    records : sequence of mappings
        What ``Report.records()`` returns.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    title : str, default ""
        What the picture shows, in a sentence.
    unit : str, default ""
        What a value is; it is written below the axis.
    limits : tuple of two floats, optional
        Ends of the axis, as in ``plot_intervals``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If the records are not a report's, or there is nothing to draw.

    See Also
    --------
    plot_intervals : The same from arrays.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> row = {
    ...     "policy": "new",
    ...     "estimator": "oee",
    ...     "value": 1.0,
    ...     "lower": 0.5,
    ...     "upper": 1.5,
    ...     "true_value": 1.2,
    ... }
    >>> rows = [
    ...     row,
    ...     row | {"estimator": "pdis", "value": 99.0, "lower": None, "upper": None},
    ... ]
    >>> ax = plot_values(rows, Figure().subplots())
    >>> (
    ...     [label.get_text() for label in ax.get_yticklabels()],
    ...     [text.get_text() for text in ax.texts],
    ... )
    (['new', 'oee', 'pdis'], ['99', 'true value 1.2'])
    """
    check_texts(unit=unit)
    given = _checks.collection(records, "records", "a Report's records()")
    rows: Sequence[Mapping[str, Any]] = given
    for row in given:
        if not isinstance(row, Mapping) or not row.keys() >= COLUMNS:
            raise ArgumentError(
                "records",
                f"must be mappings with {', '.join(sorted(COLUMNS))}; one is"
                f" {_checks.show(row)}",
            )
    if limits is None and not any(math.isfinite(row["value"]) for row in rows):
        raise ArgumentError(
            "records", "must hold at least one finite value; there is nothing to draw"
        )
    if has_slides():
        rows = _rows_of_slide(rows)
    policies = [row["policy"] for row in rows]
    ordered = sorted(rows, key=lambda row: policies.index(row["policy"]))
    columns = {key: [row[key] for row in ordered] for key in COLUMNS}
    return plot_intervals(
        columns["estimator"],
        columns["value"],
        columns["lower"],
        columns["upper"],
        ax,
        groups=columns["policy"],
        truth={
            row["policy"]: row["true_value"]
            for row in rows
            if row["true_value"] is not None
        },
        limits=limits,
        xlabel=f"value in the target: {unit}" if unit else "value in the target",
        title=title,
    )


def _rows_of_slide(rows: Sequence[Mapping[str, Any]]) -> Sequence[Mapping[str, Any]]:
    """Return the rows for which a slide has room: the same estimators of each policy.

    The default and the simulator come first, then the others in their order.
    """
    names = list(dict.fromkeys(row["estimator"] for row in rows))
    n_policies = len({row["policy"] for row in rows})
    if len(rows) + n_policies <= MAX_SLIDE_ROWS:
        return rows
    room = max(1, MAX_SLIDE_ROWS // n_policies - 1)
    wanted = sorted(names, key=lambda name: (name != "oee", name != "simulator"))
    kept = [row for row in rows if row["estimator"] in wanted[:room]]
    left_out = ", ".join(map(shorten, wanted[room:]))
    if not left_out or not any(math.isfinite(row["value"]) for row in kept):
        return rows
    _checks.warn(
        f"a slide has room for {MAX_SLIDE_ROWS} lines: the picture of values"
        f" leaves out {left_out} (the table has them; estimators=, or --estimators,"
        " says which are evaluated)",
        OutputWarning,
    )
    return kept


@suggest_keywords
def plot_intervals(
    names: Sequence[str],
    values: RealArrayLike,
    lower: RealArrayLike,
    upper: RealArrayLike,
    ax: Axes | None = None,
    *,
    groups: Sequence[str] | None = None,
    truth: float | Mapping[str, float] | None = None,
    truth_label: str = "true value",
    limits: tuple[float, float] | None = None,
    xlabel: str = "value (discounted sum of rewards)",
    title: str = "",
) -> Axes:
    """Draw a forest plot: one line a name, with its value and its interval.

    Lines begin at the top. The truth is a dashed line.

    Parameters
    ----------
    names : sequence of str
        Names of the k lines.
    values : RealArrayLike of shape (k,)
        Values; with nan an interval is drawn without a marker.
    lower : RealArrayLike of shape (k,)
        Lower ends; nan leaves the interval out.
    upper : RealArrayLike of shape (k,)
        Upper ends; nan leaves the interval out.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    groups : sequence of str, optional
        A name for each line, such as its policy: neighbouring lines of one group stand
        together under its name. None means one group without a name.
    truth : float or mapping of str to float, optional
        The true value, or that of each group. None means that it is not known.
    truth_label : str, default "true value"
        What the truth is called.
    limits : tuple of two floats, optional
        Ends of the axis. None means what truths and intervals span: values and ends
        that are far outside (estimates that explode) do not stretch it. A value outside
        is an open marker that points out of the picture, with its number.
    xlabel : str
        What a value is, with its unit.
    title : str, default ""
        What the picture shows, in a sentence.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If lengths differ, limits are in the wrong order, or there is nothing to draw.

    See Also
    --------
    plot_values : The same from a report.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_intervals(
    ...     ["oee", "pdis"],
    ...     [0.20, 0.12],
    ...     [0.16, 0.04],
    ...     [0.23, 0.20],
    ...     Figure().subplots(),
    ...     truth=0.19,
    ... )
    >>> [label.get_text() for label in ax.get_yticklabels()]
    ['', 'oee', 'pdis']
    """
    lines = _check_lines(names, values, lower, upper, groups)
    check_texts(truth_label=truth_label, xlabel=xlabel, title=title)
    has_numbers = np.isfinite([*lines.value, *lines.ends.flat]).any()
    if not len(lines.names) or (limits is None and not has_numbers):
        raise ArgumentError(
            "values",
            "must have a finite number, or lower and upper an interval; there is"
            " nothing to draw",
        )
    exact = _check_truths(truth, lines.group)
    if limits is None:
        span = _span(lines, [*exact.values()])
    else:
        span = style.check_pair(limits, "limits")
    if not span[0] < span[1]:
        raise ArgumentError(
            "limits", f"must be (low, high) with low < high; got {limits}"
        )
    # above each group one more row, for its name and the truth's
    starts = []
    if exact or groups is not None:
        starts = _starts(lines.group)
    short = np.array([*map(shorten, lines.names)], dtype=object)
    labels = np.insert(short, starts, lines.group[starts])
    ax = style.check_axes(ax, (6.4, 1.1 + 0.28 * len(labels)))
    y = _draw_lines(ax, lines, starts, span)
    for start, end in zip(starts, [*starts[1:], len(y)], strict=False):
        x = exact.get(lines.group[start], math.nan)
        if span[0] <= x <= span[1]:
            heights = (y[start] - 1, y[end - 1])
            _draw_truth(ax, x, heights, span, f"{truth_label} {_text_of(x)}")
    ax.set_xlim(*span)
    style.label_rows(ax, labels)
    for start in starts:
        ax.get_yticklabels()[y[start] - 1].set_fontweight("bold")
    _finish_axes(ax, xlabel, title)
    return ax


def _starts(group: Array) -> list[int]:
    """Return the first line of each group of neighbours."""
    return [k for k in range(len(group)) if k == 0 or group[k] != group[k - 1]]


def _draw_lines(
    ax: Axes, lines: Lines, starts: Sequence[int], span: tuple[float, float]
) -> IntArray:
    """Draw the intervals from the top, and return their heights."""
    line = np.arange(len(lines.group))
    y = line + np.searchsorted(starts, line, side="right")
    ends = np.clip(lines.ends, *span)
    for k, series in enumerate(style.places(lines.names)):
        marks = style.series(series) | {"linestyle": "none"}
        _draw_interval(ax, y[k], lines.value[k], ends[k], span, marks)
    return y


def _finish_axes(ax: Axes, xlabel: str, title: str) -> None:
    """Write the texts of a forest plot, and leave its needless lines out."""
    ax.tick_params(axis="y", pad=9)
    ax.spines[["left", "top", "right"]].set_visible(False)
    if ax.get_xscale() == "linear":  # other scales place their own ticks
        ax.locator_params(axis="x", nbins=5)
    ax.grid(axis="x", alpha=0.3)
    letters = max(20, int(N_LETTERS_PER_INCH * ax.bbox.width / ax.figure.dpi))
    ax.set_xlabel(textwrap.fill(xlabel, letters))
    if title:
        disable_math([ax.set_title(textwrap.fill(title, letters), fontsize="medium")])


def _check_lines(
    names: Sequence[str],
    values: RealArrayLike,
    lower: RealArrayLike,
    upper: RealArrayLike,
    groups: Sequence[str] | None,
) -> Lines:
    """Check what ``plot_intervals`` gets for each line, and return it as arrays."""
    names = style.check_labels(names, "names", "names, one a line")
    given = {"values": values, "lower": lower, "upper": upper}
    value, low, high = (
        _checks.float_array(_checks.without_known_labels(array, names), name, ndim=1)
        for name, array in given.items()
    )
    called: Sequence[str] = [""] * len(names)
    if groups is not None:
        called = style.check_labels(groups, "groups", "names, one a line")
    group = np.array([*map(shorten, called)], dtype=object)
    sizes = [len(column) for column in (names, value, low, high, group)]
    if len(set(sizes)) > 1:
        raise ValueError(
            "names, values, lower, upper and groups must have one length; "
            f"they have {', '.join(map(str, sizes[:-1]))} and {sizes[-1]}"
        )
    return Lines(names, value, low, high, group)


def _check_truths(
    truth: float | Mapping[str, float] | None, group: Array
) -> dict[str, float]:
    """Return the true value of each group that has one, by its shortened name."""
    if truth is None:
        return {}
    given = truth if isinstance(truth, Mapping) else dict.fromkeys(group, truth)
    return {
        shorten(name): float(_checks.float_array(x, "truth", ndim=0))
        for name, x in given.items()
    }


def _draw_truth(
    ax: Axes,
    x: float,
    heights: tuple[float, float],
    span: tuple[float, float],
    text: str,
) -> None:
    """Draw the true value of a group as a dashed line, with its text above."""
    top, bottom = heights
    ax.plot([x, x], [top + 0.35, bottom + 0.4], **style.TRUTH)
    quarter = int(4.0 * (x - span[0]) / (span[1] - span[0]))
    side = ("left", "center", "center", "right", "right")[quarter]
    ax.text(x, top, text, ha=side, va="center", fontsize="small")


def _draw_interval(
    ax: Axes, y: float, value: float, ends: Array, span: tuple[float, float], marks: Any
) -> None:
    """Draw an interval and its value.

    A value outside the axis is an open triangle at the edge that points to where the
    value lies, with its number.
    """
    has_interval = np.isfinite(ends).all()
    if has_interval:
        # an interval without a value has ends
        marker = "|" if math.isnan(value) else None
        ax.plot(
            ends, [y, y], color=marks["color"], lw=2.0, marker=marker, ms=9, mew=2.0
        )
    if span[0] <= value <= span[1]:
        ax.plot(value, y, ms=7, **marks)
    elif not math.isnan(value) or not has_interval:
        is_right = math.isfinite(value) and value > span[1]
        edge, shift, side = (span[1], -8, "right") if is_right else (span[0], 8, "left")
        arrow = {"markerfacecolor": "none", "marker": ">" if is_right else "<"}
        ax.plot(edge, y, ms=7, clip_on=False, **marks | arrow)
        _write_beside(ax, _text_of(value), (edge, y), shift, ha=side)


def _write_beside(
    ax: Axes, text: str, place: tuple[float, float], shift: float, **options: Any
) -> None:
    """Write a text some points beside a place: right, or left for a negative shift."""
    ax.annotate(
        text,
        place,
        (shift, 0),
        textcoords="offset points",
        va="center",
        fontsize="small",
        **options,
    )


def _text_of(value: float) -> str:
    """Return a number as it stands in a picture."""
    return f"{value:.3g}".replace("-", "−") if math.isfinite(value) else "no value"


def _span(lines: Lines, truth: list[float]) -> tuple[float, float]:
    """Return the ends of an axis that shows truths and typical intervals.

    It spans the truths, in each group the narrower half of the intervals, and what is
    near to them.
    """
    _, value, low, high, group = lines
    with np.errstate(over="ignore", invalid="ignore"):
        width = high - low
    core = [float(x) for x in truth if math.isfinite(x)]
    widths = []
    for name in dict.fromkeys(group):
        rows = np.flatnonzero((group == name) & np.isfinite(width))
        rows = rows[np.argsort(width[rows], kind="stable")[: (len(rows) + 1) // 2]]
        widths += width[rows].tolist()
        core += [*low[rows].tolist(), *high[rows].tolist()]
        own = value[(group == name) & np.isfinite(value)]
        # without intervals: the half of the values that is nearest to their median
        if not len(rows) and len(own):
            core += own[np.argsort(np.abs(own - np.median(own)), kind="stable")][
                : len(own) // 2 + 1
            ].tolist()
    if not core:  # an interval with one end
        core = [x for x in (*low.tolist(), *high.tolist()) if math.isfinite(x)]
    first = min(core)
    last = max(core)
    scale = 1e-3 * max(map(abs, core))
    typical = max(float(np.median(widths or [0.0])), scale)
    far = max(0.5 * (last - first), MAX_REACH_WIDTHS * typical)
    points = np.array([*core, *value, *low, *high])
    points = points[(points >= first - far) & (points <= last + far)]
    margin = max(0.06 * float(points.max() - points.min()), scale) or 0.5
    return float(points.min()) - margin, float(points.max()) + margin


@suggest_keywords
def plot_states(
    time: RealArrayLike,
    recorded: RealArrayLike,
    ax: Axes | None = None,
    *,
    top: int = 20,
    names: Sequence[str] | None = None,
    xlabel: str = "share of the policy's discounted time (%)",
) -> Axes:
    """Draw bars of the states in which a policy spends most of its time.

    Each bar has the part of the time that the log has recorded, and the rest.

    Parameters
    ----------
    time : RealArrayLike of shape (S,) or (S, A)
        Shares of discounted time, which sum to at most 1.
    recorded : RealArrayLike of the same shape
        How many transitions the log has from each state or state-action pair; the sum
        stands beside the bar.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    top : int, default 20
        How many states to show; those without time are left out. A slide shows at most
        twelve.
    names : sequence of str, optional
        Names of the states; None means their numbers.
    xlabel : str
        What the bars are, with the unit.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If shapes differ, or there is no state.

    See Also
    --------
    plot_occupancy : The same on a map of the states.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_states([0.3, 0.7], [12, 0], Figure().subplots())
    >>> [label.get_text() for label in ax.get_yticklabels()]
    ['state 1', 'state 0']
    """
    shares = _checks.float_array(time, "time", ndim=(1, 2))
    counts = _checks.float_array(recorded, "recorded", ndim=(1, 2))
    _checks.require_nonnegative(shares, "time")
    if not shares.size:
        raise ArgumentError("time", "must hold at least one state; it is empty")
    if counts.shape != shares.shape:
        raise ArgumentError(
            "recorded",
            f"must have the shape of time, {shares.shape}; it has {counts.shape}",
        )
    parts = shares, np.where(counts > 0, shares, 0.0), counts
    share, known, total = (
        array.reshape(len(shares), -1).sum(axis=1) for array in parts
    )
    called: Any = (
        range(len(share))
        if names is None
        else style.check_labels(names, "names", "names, one a state")
    )
    if len(called) != len(share):
        raise ArgumentError(
            "names",
            f"must have {len(share)} entries, one a state; it has {len(called)}",
        )
    check_texts(xlabel=xlabel)
    n_shown = _checks.positive_integer(top, "top")
    if has_slides():
        n_shown = min(n_shown, MAX_SLIDE_ROWS)
    order = np.argsort(-share, kind="stable")[:n_shown]
    order = order[share[order] > 0]
    y = np.arange(len(order))
    good = 100.0 * known[order]
    every = 100.0 * share[order]
    _checks.require_finite(every, "time")
    ax = style.check_axes(ax, (6.4, 1.1 + 0.25 * len(order)))
    ax.barh(y, good, color=COLORS[0], height=0.72, label="action recorded")
    rest: dict[str, Any] = {
        "color": "none",
        "edgecolor": COLORS[1],
        "hatch": "////",
        "label": "never recorded",
    }
    ax.barh(
        y, np.where(good < every, every - good, np.nan), left=good, height=0.72, **rest
    )
    for place, state in enumerate(order):
        count = "none"
        if total[state]:
            count = f"{total[state]:,.0f}".replace(",", "\u202f")
        _write_beside(ax, f"{count} recorded", (every[place], place), 4, color=INK)
    style.label_rows(
        ax, [f"state {s}" if names is None else shorten(called[s]) for s in order]
    )
    ax.set_xlim(0.0, 1.25 * every.max(initial=0.0) or 1.0)
    ax.set_xlabel(xlabel)
    ax.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=2,
        fontsize="small",
        borderaxespad=0.2,
    )
    return ax
