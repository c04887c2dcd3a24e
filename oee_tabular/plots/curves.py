"""Curves: value against a parameter, error against n, variance against the horizon; their names at the ends of lines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.plots.style import ink, literally, series, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_curves(
    x: object,
    curves: Mapping[str, object],
    ax: Axes,
    *,
    bands: Mapping[str, tuple[object, object]] | None = None,
    truth: object = None,
    truth_label: str = "true value",
    xlabel: str = "parameter",
    ylabel: str = "value (discounted sum of rewards)",
) -> Axes:
    """Curves against a parameter, each with its band; the truth in ink.

    Parameters
    ----------
    x : (k,) the parameter (delta, a slip, n)
    curves : name -> (k,); nan where there is no value
    ax : matplotlib Axes
    bands : name -> (lower, upper), each (k,): quantiles, or an interval's ends
    truth, truth_label : None, a number, or (k,); its name in the legend
    xlabel, ylabel : with units

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_curves([0.1, 0.9], {"oee": [-1.6, -0.4]}, Figure().subplots(), truth=[-1.5, -0.4], xlabel="delta")
    >>> [text.get_text() for text in ax.get_legend().get_texts()]
    ['oee', 'true value']
    """
    where, found = _curves(x, curves, "x")
    for k, (name, y) in enumerate(found.items()):
        style = series(k)
        ax.plot(where, y, ms=5, lw=1.6, label=shown(name), **style)
        if bands is not None and name in bands:
            low, high = (_like(end, where, f"bands[{name!r}]") for end in bands[name])
            ax.fill_between(where, low, high, color=style["color"], alpha=0.18, lw=0)
    unknown = [name for name in bands or {} if name not in found]
    if unknown:
        raise ValueError(f"bands must be of names in curves; {unknown[0]!r} is not")
    if truth is not None:
        line = np.broadcast_to(_checks.float_array(truth, "truth"), where.shape)
        ax.plot(where, line, color=ink(), lw=1.2, ls=(0, (4, 2)), zorder=1, label=truth_label)
    return _finish(ax, xlabel, ylabel)


def plot_errors(
    n: object,
    errors: Mapping[str, object],
    ax: Axes,
    *,
    bands: Mapping[str, tuple[object, object]] | None = None,
    slope: float | None = -0.5,
    xlabel: str = "transitions of the target, n",
    ylabel: str = "mean L1 error",
) -> Axes:
    """Errors against n on logarithmic axes, with a line of ``slope`` (None: none) from the first curve's first point.

    Parameters
    ----------
    n : (k,) positive
    errors : name -> (k,) nonnegative (a 0 is left out)
    ax, bands, xlabel, ylabel : as in ``plot_curves``
    slope : of the line on logarithmic axes, -1/2 for a parametric rate; None: no line

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> plot_errors([100, 10_000], {"oee": [0.2, 0.02]}, Figure().subplots()).get_xscale()
    'log'
    """
    where, found = _curves(n, errors, "n")
    if not (where > 0).all():
        k = int(np.argmin(where > 0))
        raise ValueError(f"n[{k}] must be positive; it is {where[k]:g}")
    plot_curves(where, _positive(found, "errors"), ax, bands=bands)
    first = next(iter(found.values()))
    start = np.flatnonzero(first > 0)
    if slope is not None and start.size and len(where) > 1:
        k = int(start[0])
        line = first[k] * (where / where[k]) ** slope
        ax.plot(where, line, color=ink(), lw=1.0, ls=":", zorder=0, label=f"slope {slope:g}")
    ax.set_xscale("log")
    ax.set_yscale("log")
    return _finish(ax, xlabel, ylabel)


def plot_variance_growth(
    variances: Mapping[str, Any],
    ax: Axes,
    *,
    horizons: Any = None,
    xlabel: str = "horizon T (number of rewards)",
    ylabel: str = "variance (squared units of the return)",
) -> Axes:
    """Variances against the horizon, the variance on a logarithmic axis.

    Parameters
    ----------
    variances : name -> (k,) nonnegative
    ax, xlabel, ylabel : as in ``plot_curves``
    horizons : (k,); None: 1..k

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> plot_variance_growth({"product": [1.0, 4.0, 16.0]}, Figure().subplots()).get_yscale()
    'log'
    """
    if not variances:
        raise ValueError("variances must hold at least one curve; it is empty")
    length = len(next(iter(variances.values())))
    where, found = _curves(np.arange(1, length + 1) if horizons is None else horizons, variances, "horizons")
    plot_curves(where, _positive(found, "variances"), ax, xlabel=xlabel, ylabel=ylabel)
    for line in ax.get_lines()[-len(found) :]:
        line.set_markevery(max(1, len(where) // 8))  # markers tell the curves apart, they are not the data
    ax.set_yscale("log")
    return ax


def _positive(curves: Mapping[str, Array], name: str) -> dict[str, Array]:
    """Without zeros, which a logarithmic axis cannot show."""
    for label, y in curves.items():
        if (y < 0).any():
            k = int(np.argmax(y < 0))
            raise ValueError(f"{name}[{label!r}][{k}] must be nonnegative; it is {y[k]:g}")
    return {label: np.where(y > 0, y, np.nan) for label, y in curves.items()}


def _curves(x: object, curves: Mapping[str, object], name: str) -> tuple[Array, dict[str, Array]]:
    where = _checks.float_array(x, name, ndim=1)
    _checks.require_finite(where, name)
    if not curves:
        raise ValueError("curves must hold at least one; it is empty")
    return where, {str(label): _like(y, where, f"curve {label!r}") for label, y in curves.items()}


def _like(values: object, where: Array, name: str) -> Array:
    array = _checks.float_array(values, name, ndim=1)
    if len(array) != len(where):
        raise ValueError(f"{name} must have {len(where)} values, one a point; it has {len(array)}")
    return array


def _finish(ax: Axes, xlabel: str, ylabel: str) -> Axes:
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    ax.grid(visible=True)
    literally(ax.legend(fontsize="small").get_texts())
    return ax


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
