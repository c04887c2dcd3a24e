"""Curves of values, of errors against n, and of variances against the horizon."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import conform
from oee_tabular.exceptions import ArgumentError
from oee_tabular.plots.style import (
    INK,
    TRUTH,
    check_axes,
    check_texts,
    disable_math,
    series,
    shorten,
)
from oee_tabular.typing import Array, RealArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LABEL_SIZE_POINTS = 8.0  # of names at the ends of lines
LABEL_SPACING_HEIGHTS = 1.25  # between two of them, in letters' heights


@suggest_keywords
def plot_curves(
    x: RealArrayLike,
    curves: Mapping[str, RealArrayLike],
    ax: Axes | None = None,
    *,
    bands: Mapping[str, tuple[RealArrayLike, RealArrayLike]] | None = None,
    truth: RealArrayLike | None = None,
    xlabel: str = "parameter",
    ylabel: str = "value (discounted sum of rewards)",
) -> Axes:
    """Draw curves against a parameter, each with its band, and the truth.

    Parameters
    ----------
    x : RealArrayLike of shape (k,)
        The parameter: a probability, a slip, a number of transitions.
    curves : mapping of str to RealArrayLike of shape (k,)
        Name and values of each curve; nan where there is no value.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    bands : mapping of str to pair of RealArrayLike of shape (k,), optional
        Lower and upper ends beside some of the curves: quantiles, or an interval.
    truth : float or RealArrayLike of shape (k,), optional
        True values, drawn as a dashed line.
    xlabel : str
        What the parameter is, with its unit.
    ylabel : str
        What the values are, with their unit.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If there is nothing to draw, or lengths differ.

    See Also
    --------
    plot_errors : The same on logarithmic axes.
    label_ends : Names at the ends of the lines in place of a legend.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_curves(
    ...     [0.1, 0.9],
    ...     {"oee": [-1.6, -0.4]},
    ...     Figure().subplots(),
    ...     truth=[-1.5, -0.4],
    ...     xlabel="delta",
    ... )
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['oee', 'true value']
    """
    where, drawn = _check_curves(x, curves, "x", "curves")
    check_texts(xlabel=xlabel, ylabel=ylabel)
    ends = {}
    for name, pair in conform({} if bands is None else bands, "bands", Mapping).items():
        if name not in drawn:
            raise ArgumentError(
                "bands", f"must be of names in curves; {_checks.show(name)} is not"
            )
        both = _checks.collection(pair, "bands", "pairs of arrays")
        if len(both) != 2:
            raise ArgumentError(
                f"bands[{name!r}]",
                f"must be (lower, upper); it has {len(both)} entries",
            )
        ends[name] = [_check_like(end, where, f"bands[{name!r}]") for end in both]
    line = None
    if truth is not None:
        plain = _checks.without_known_labels(truth, where.tolist())
        line = _checks.float_array(plain, "truth", ndim=(0, 1))
        line = _check_like(
            line if line.ndim else np.full(len(where), line), where, "truth"
        )
    ax = check_axes(ax)
    for k, (name, y) in enumerate(drawn.items()):
        ax.plot(where, y, ms=5, lw=1.6, label=shorten(name), **series(k))
        if name in ends:
            ax.fill_between(
                where,
                ends[name][0],
                ends[name][1],
                color=series(k)["color"],
                alpha=0.18,
                lw=0,
            )
    if line is not None:
        ax.plot(where, line, label="true value", **TRUTH)
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    ax.grid(visible=True)
    _add_legend(ax)
    return ax


def _add_legend(ax: Axes) -> None:
    """Write the names of the lines into a legend, as they are."""
    disable_math(ax.legend(fontsize="small").get_texts())


@suggest_keywords
def plot_errors(
    n: RealArrayLike,
    errors: Mapping[str, RealArrayLike],
    ax: Axes | None = None,
    *,
    bands: Mapping[str, tuple[RealArrayLike, RealArrayLike]] | None = None,
    slope: float | None = -0.5,
    xlabel: str = "transitions of the target, n",
    ylabel: str = "mean L1 error",
) -> Axes:
    """Draw errors against n on logarithmic axes, with a line of a given slope.

    Parameters
    ----------
    n : RealArrayLike of shape (k,)
        Positive numbers of transitions.
    errors : mapping of str to RealArrayLike of shape (k,)
        Name and nonnegative errors of each curve; a 0 is left out.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    bands : mapping of str to pair of RealArrayLike of shape (k,), optional
        Lower and upper ends beside some of the curves.
    slope : float or None, default -0.5
        Slope of a dotted line from the first curve's first point; -1/2 is that of a
        parametric rate. None draws no line.
    xlabel : str
        What n counts.
    ylabel : str
        What the errors are, with their unit.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If an n is not positive, an error is negative, or there is nothing to draw.

    See Also
    --------
    plot_curves : The same on linear axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> plot_errors(
    ...     [100, 10_000], {"oee": [0.2, 0.02]}, Figure().subplots()
    ... ).get_xscale()
    'log'
    """
    where, drawn = _check_curves(n, errors, "n", "errors", is_logarithmic=True)
    if where.min() <= 0:
        raise ArgumentError(
            f"n[{where.argmin()}]", f"must be positive; it is {where.min():g}"
        )
    ax = plot_curves(where, drawn, ax, bands=bands, xlabel=xlabel, ylabel=ylabel)
    first = next(iter(drawn.values()))
    start = np.flatnonzero(np.isfinite(first))
    if slope is not None:
        slope = _checks.number_in(slope, "slope", -100.0, 100.0)
    if slope is not None and start.size and len(where) > 1:
        line = first[start[0]] * (where / where[start[0]]) ** slope
        ax.plot(
            where, line, color=INK, lw=1.0, ls=":", zorder=0, label=f"slope {slope:g}"
        )
        _add_legend(ax)
    ax.set_xscale("log")
    ax.set_yscale("log")
    return ax


@suggest_keywords
def plot_variance_growth(
    variances: Mapping[str, RealArrayLike],
    ax: Axes | None = None,
    *,
    horizons: RealArrayLike | None = None,
    xlabel: str = "horizon T (number of rewards)",
    ylabel: str = "variance (squared units of the return)",
) -> Axes:
    """Draw variances against the horizon, on a logarithmic axis.

    Parameters
    ----------
    variances : mapping of str to RealArrayLike of shape (k,)
        Name and nonnegative variances of each curve, in squared units of the return.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    horizons : RealArrayLike of shape (k,), optional
        Numbers of rewards; None means 1 to k.
    xlabel : str
        What the horizon counts.
    ylabel : str
        What the variances are, with their unit.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If a variance is negative, lengths differ, or there is nothing to draw.

    See Also
    --------
    plot_curves : Curves on linear axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> plot_variance_growth(
    ...     {"product": [1.0, 4.0, 16.0]}, Figure().subplots()
    ... ).get_yscale()
    'log'
    """
    if horizons is None:
        first = next(
            iter(_checks.instance(variances, Mapping, "variances").values()), ()
        )
        horizons = 1 + np.arange(_checks.float_array(first, "variances").size)
    where, drawn = _check_curves(
        horizons, variances, "horizons", "variances", is_logarithmic=True
    )
    ax = plot_curves(where, drawn, ax, xlabel=xlabel, ylabel=ylabel)
    for line in ax.get_lines()[-len(drawn) :]:
        # markers tell the curves apart, they are not the data
        line.set_markevery(max(1, len(where) // 8))
    ax.set_yscale("log")
    return ax


def _check_curves(
    x: object,
    curves: Mapping[str, Any],
    x_name: str,
    name: str,
    *,
    is_logarithmic: bool = False,
) -> tuple[Array, dict[str, Array]]:
    """Return x and the curves as arrays, checked.

    A logarithmic axis cannot show a zero: it becomes nan.
    """
    where = _checks.float_array(x, x_name, ndim=1)
    _checks.require_finite(where, x_name)
    arrays = {}
    for label, values in _checks.instance(curves, Mapping, name).items():
        y = _check_like(values, where, f"{name}[{str(label)!r}]")
        if is_logarithmic:
            _checks.require_nonnegative(np.nan_to_num(y), f"{name}[{str(label)!r}]")
            y = np.where(y > 0, y, np.nan)
        arrays[str(label)] = y
    if not arrays:
        raise ArgumentError(name, "must hold at least one curve; it is empty")
    if not any(np.isfinite(y).any() for y in arrays.values()):
        rule = "positive number, for a logarithmic axis" if is_logarithmic else "number"
        raise ArgumentError(
            name, f"must hold at least one finite {rule}; there is nothing to draw"
        )
    return where, arrays


def _check_like(values: object, where: Array, name: str) -> Array:
    """Return values as an array that has one for each point."""
    # a group's mean, for one, is labelled by the points
    plain = _checks.without_known_labels(values, where.tolist())
    array = _checks.float_array(plain, name, ndim=1)
    if len(array) != len(where):
        raise ArgumentError(
            name, f"must have {len(where)} values, one a point; it has {len(array)}"
        )
    return array


def label_ends(ax: Axes) -> Axes:
    """Write each line's name to the right of the axes, in place of a legend.

    A name stands at the height of the line's last point and has its colour. Names that
    would overlap are moved apart, no more than it takes. Call it last: limits and
    scales stay as they are.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Axes with lines that have labels.

    Returns
    -------
    matplotlib.axes.Axes
        The same axes.

    Raises
    ------
    ValueError
        If ``ax`` are no axes.

    See Also
    --------
    plot_curves : Draws curves with a legend.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> from oee_tabular.plots import plot_curves
    >>> ax = label_ends(
    ...     plot_curves([0, 1], {"low": [0, 1], "high": [0, 2]}, Figure().subplots())
    ... )
    >>> [text.get_text() for text in ax.texts], ax.get_legend()
    (['low', 'high'], None)
    """
    from scipy.optimize import isotonic_regression

    ax = check_axes(ax)
    ends = []
    for line in ax.get_lines():
        points = np.asarray(line.get_xydata())
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) and not str(line.get_label()).startswith("_"):
            ends.append((line, points[-1]))
    if ends:
        ax.get_ylim()  # brings the limits, and with them transData, up to date
        to_axes = ax.transData + ax.transAxes.inverted()
        heights = np.clip(
            to_axes.transform([point for _, point in ends])[:, 1], 0.0, 1.0
        )
        # heights at least a step apart in the same order, nearest to these (least
        # squares): what is left of the steps may not fall
        order = np.argsort(heights, kind="stable")
        steps = (
            LABEL_SPACING_HEIGHTS
            * LABEL_SIZE_POINTS
            * ax.figure.dpi
            / (72.0 * ax.get_window_extent().height)
            * np.arange(len(order))
        )
        heights[order] = isotonic_regression(heights[order] - steps).x + steps
        style: dict[str, Any] = {
            "transform": ax.transAxes,
            "fontsize": LABEL_SIZE_POINTS,
            "va": "center",
        }
        for (line, _), height in zip(ends, heights, strict=True):
            ax.text(
                1.02, height, str(line.get_label()), color=line.get_color(), **style
            )
    disable_math(ax.texts)
    if (legend := ax.get_legend()) is not None:
        legend.remove()
    return ax
