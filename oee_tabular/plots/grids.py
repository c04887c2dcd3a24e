"""Maps of a gridworld's states: values, ratios, what the log has seen, where a policy goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.plots.maps import Map, as_map
from oee_tabular.plots.style import COLORS, DIVERGING, PAPER, SEQUENTIAL, literally

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VECTOR = 1600  # cells up to which each is a shape of its own; beyond, the map is an image
NUMBERED = 12  # rows and columns up to which cells can hold text


def plot_grid(
    values: object,
    shape: tuple[int, int] | Map,
    ax: Axes,
    *,
    label: str,
    norm: Any = None,
    colormap: str = SEQUENTIAL,
    text: Any = None,
    crossed: object = None,
    ticks: Any = None,
) -> Axes:
    """A heat map of one number a state; row 0 is on top. A cell without a state stays blank.

    Parameters
    ----------
    values : (S,), or (rows, columns); nan for a cell without colour
    shape : (rows, columns) of states numbered row * columns + column; or a ``Map``, as ``map_of`` makes it
    ax : matplotlib Axes
    label : of the colour bar, with the unit
    norm, colormap : matplotlib's; None: linear
    text : (S,) words to write into the cells (left out beyond 12 rows or columns)
    crossed : (S,) mask of cells to cross out
    ticks : of the colour bar; None: matplotlib's

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_grid([0.0, 1.0, 2.0, 3.0], (2, 2), Figure().subplots(), label="value (reward)", text=list("abcd"))
    >>> [text.get_text() for text in ax.texts]
    ['a', 'b', 'c', 'd']
    """
    places = as_map(shape)
    rows, columns = places.shape
    n_states = len(places.cell)
    cells = np.ma.masked_invalid(places.spread(_states(values, n_states, "values")).reshape(rows, columns))
    if rows * columns <= VECTOR:
        drawn: Any = ax.pcolormesh(cells, cmap=colormap, norm=norm, linewidth=0.5, edgecolor="face")
    else:
        drawn = ax.imshow(
            cells, cmap=colormap, norm=norm, extent=(0, columns, rows, 0), interpolation="nearest", aspect="equal"
        )
    ax.set_xlim(0, columns)
    ax.set_ylim(rows, 0)
    ax.set_aspect("equal")
    if crossed is not None:
        row, column = np.divmod(places.cell[_mask(crossed, n_states, "crossed") & (places.cell >= 0)], columns)
        size = min(9.0, 120.0 / max(rows, columns))
        for color, width in ((PAPER, 3.6), (COLORS[1], 1.8)):  # a halo, so that it is seen on every shade
            ax.plot(column + 0.5, row + 0.5, ls="none", marker="x", ms=size, mec=color, mew=width)
    if text is not None and max(rows, columns) <= NUMBERED:
        _write(ax, drawn, cells, places.cell, list(text))
    ax.set_xlabel("column")
    ax.set_ylabel("row")
    for axis, called in ((ax.xaxis, places.columns), (ax.yaxis, places.rows)):
        every = max(1, -(-len(called) // 10))
        numbers = range(0, len(called), every)
        axis.set_ticks([k + 0.5 for k in numbers], [f"{called[k]:.6g}" for k in numbers])
        axis.set_tick_params(length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    bar = ax.figure.colorbar(drawn, ax=ax, fraction=0.05, pad=0.03, ticks=ticks, drawedges=False)
    bar.set_label(label)
    if ticks is not None:
        bar.set_ticks(ticks, labels=[f"{tick:g}" if tick == round(tick) else f"{tick:.2g}" for tick in ticks])
        bar.minorticks_off()
    bar.outline.set_visible(False)
    return ax


def plot_ratio(
    values: object, shape: tuple[int, int] | Map, ax: Axes, *, label: str = "ratio P_target / P_simulator"
) -> Axes:
    """A heat map of ratios, logarithmic around 1: one colour for more often than in the simulator, one for less often.

    Parameters
    ----------
    values : (S,) positive, nan where there is none; a 0 is drawn as the smallest
    shape, ax, label : as in ``plot_grid``

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> [text.get_text() for text in plot_ratio([0.5, 1.0, 1.0, 2.0], (2, 2), Figure().subplots()).texts]
    ['0.5', '1', '1', '2']
    """
    from matplotlib.colors import LogNorm

    ratio = _states(values, len(as_map(shape).cell), "values")
    if (ratio < 0).any():
        k = int(np.argmax(ratio < 0))
        raise ValueError(f"values[{k}] must be nonnegative; it is {ratio[k]:g}")
    positive = ratio[np.isfinite(ratio) & (ratio > 0)]
    far = float(np.abs(np.log2(positive)).max()) if positive.size else 0.0
    reach = 2.0 ** max(1.0, np.ceil(far))
    shades = np.where(ratio == 0, 1.0 / reach, ratio)
    ends = [1.0 / reach, 1.0 / np.sqrt(reach), 1.0, np.sqrt(reach), reach] if reach > 2 else [0.5, 1.0, 2.0]
    return plot_grid(
        shades, shape, ax, label=label, norm=LogNorm(1.0 / reach, reach), colormap=DIVERGING,
        text=["" if np.isnan(r) else f"{r:.2g}" for r in ratio], ticks=ends,
    )  # fmt: skip


def plot_coverage(
    counts: object,
    shape: tuple[int, int] | Map,
    ax: Axes,
    *,
    over: object = None,
    label: str = "moves recorded in the state (logarithmic)",
) -> Axes:
    """How many moves the log has from each state, logarithmic; states without any are crossed out.

    Parameters
    ----------
    counts : (S,) or (S, A), summed over actions
    shape, ax, label : as in ``plot_grid``
    over : (S,) mask of states where an episode is over (left blank, "end")

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> [text.get_text() for text in plot_coverage([20, 3, 0, 1], (2, 2), Figure().subplots()).texts]
    ['20', '3', '1']
    """
    from matplotlib.colors import LogNorm

    n_states = len(as_map(shape).cell)
    given = _checks.float_array(counts, "counts", ndim=(1, 2))
    _checks.require_nonnegative(given, "counts")
    seen = _states(given.sum(axis=1) if given.ndim == 2 else given, n_states, "counts")
    ended = _mask(over, n_states, "over")
    most = max(float(seen.max()), 1.0)
    top = 10.0 ** max(1.0, np.ceil(np.log10(most)))
    ticks = [10.0**k for k in range(round(np.log10(top)) + 1)]
    return plot_grid(
        np.where((seen > 0) & ~ended, seen, np.nan), shape, ax, label=label, norm=LogNorm(1.0, top),
        text=["end" if e else "" if s == 0 else _short(s) for s, e in zip(seen, ended, strict=True)],
        crossed=(seen == 0) & ~ended, ticks=ticks,
    )  # fmt: skip


def plot_occupancy(
    time: object,
    shape: tuple[int, int] | Map,
    ax: Axes,
    *,
    unseen: object = None,
    over: object = None,
    label: str = "share of the policy's discounted time (%)",
) -> Axes:
    """Where a policy spends its time; ``unseen`` states are crossed out.

    Parameters
    ----------
    time : (S,) shares that sum to at most 1
    shape, ax, label : as in ``plot_grid``
    unseen : (S,) mask of states to cross out
    over : (S,) mask of states where an episode is over (left blank, "end")

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> [text.get_text() for text in plot_occupancy([0.5, 0.25, 0.25, 0.0], (2, 2), Figure().subplots()).texts]
    ['50', '25', '25']
    """
    from matplotlib.colors import PowerNorm

    n_states = len(as_map(shape).cell)
    share = 100.0 * _states(time, n_states, "time")
    ended = _mask(over, n_states, "over")
    share = np.where(ended, np.nan, share)
    most = float(np.nanmax(share)) if np.isfinite(share).any() else 0.0
    crossed = _mask(unseen, n_states, "unseen") & ~ended
    words = ["end" if e else "" if c else _percent(s) for s, e, c in zip(share, ended, crossed, strict=True)]
    norm = PowerNorm(0.5, 0.0, most if most > 0 else 1.0)
    return plot_grid(share, shape, ax, label=label, norm=norm, text=words, crossed=crossed)


def _write(ax: Axes, drawn: Any, cells: Any, places: IntArray, words: list[str]) -> None:
    from matplotlib.colors import to_rgb

    columns = cells.shape[1]
    size = 8.0 if columns <= 8 else 7.2
    for cell, word in zip(places, words, strict=False):
        if cell < 0:
            continue
        row, column = divmod(int(cell), columns)
        value = cells[row, column]
        style: dict[str, Any] = {}
        if value is not np.ma.masked:
            red, green, blue = to_rgb(drawn.cmap(drawn.norm(value)))
            style["color"] = "#000000" if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.45 else "#ffffff"
        if word:
            found = ax.text(column + 0.5, row + 0.5, word, ha="center", va="center", fontsize=size, **style)
            literally([found])


def _short(count: float) -> str:
    if count < 1000:
        return f"{count:.3g}"
    return f"{count / 1000:.2g}k" if count < 1e4 else f"{count / 1000:.0f}k" if count < 1e6 else f"{count:.0e}"


def _percent(share: float) -> str:
    return "" if share < 0.05 else f"{share:.1f}" if share < 9.95 else f"{share:.0f}"


def _states(values: object, n_states: int, name: str) -> Array:
    array = _checks.float_array(values, name).reshape(-1)
    if array.size != n_states:
        raise ValueError(f"{name} must have {n_states} entries, one a cell of the grid; it has {array.size}")
    return array


def _mask(mask: object, n_states: int, name: str) -> Any:
    found = np.zeros(n_states, dtype=np.bool_) if mask is None else np.asarray(mask, dtype=np.bool_).reshape(-1)
    if found.size != n_states:
        raise ValueError(f"{name} must have {n_states} entries, one a state; it has {found.size}")
    return found
