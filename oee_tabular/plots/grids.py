"""Maps of a gridworld's states: values, ratios, what the log has seen, where a policy goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import row_of_entry
from oee_tabular.plots.style import COLORS, DIVERGING, PAPER, SEQUENTIAL, literally

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from oee_tabular.mdp import FiniteMDP

VECTOR = 1600  # cells up to which each is a shape of its own; beyond, the map is an image
NUMBERED = 12  # rows and columns up to which cells can hold text


def detect_grid(mdp: FiniteMDP) -> tuple[int, int] | None:
    """(rows, columns) of a gridworld whose states are numbered row * columns + column, or None where it is none.

    A gridworld's moves stay, go to the neighbour on the left or right (never around an edge), or to the one above or below;
    a jump back to a first state (as from CliffWalking's cliff) is allowed. O(nnz).

    Parameters
    ----------
    mdp : FiniteMDP

    Examples
    --------
    >>> from oee_tabular.tasks import gridworld
    >>> detect_grid(gridworld(5, slip=0.1))
    (5, 5)
    """
    matrix = mdp.transitions
    start = row_of_entry(matrix) // mdp.n_actions
    step = matrix.indices.astype(np.int64) - start
    counted = (mdp.initial[matrix.indices] == 0) | (np.abs(step) <= 1)
    sizes = np.unique(np.abs(step[counted]))
    long = sizes[sizes > 1]
    if len(long) != 1:
        return None
    width = int(long[0])
    around = (start // width != matrix.indices // width) & (np.abs(step) == 1) & counted
    if 1 not in sizes or around.any() or mdp.n_states % width or mdp.n_states == width:
        return None
    return mdp.n_states // width, width


def plot_grid(
    values: object,
    shape: tuple[int, int],
    ax: Axes,
    *,
    label: str,
    norm: Any = None,
    colormap: str = SEQUENTIAL,
    text: Any = None,
    crossed: object = None,
    ticks: Any = None,
) -> Axes:
    """A heat map of one number a state; row 0 is on top, as states are numbered.

    Parameters
    ----------
    values : (rows * columns,), or that shape; nan for a cell without colour
    shape : (rows, columns)
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
    rows, columns = _shape(shape)
    cells = np.ma.masked_invalid(_states(values, rows * columns, "values").reshape(rows, columns))
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
        mask = np.asarray(crossed, dtype=np.bool_).reshape(-1)
        if mask.shape != (rows * columns,):
            raise ValueError(f"crossed must have {rows * columns} entries, one a state; it has {mask.size}")
        row, column = np.divmod(np.flatnonzero(mask), columns)
        size = min(9.0, 120.0 / max(rows, columns))
        for color, width in ((PAPER, 3.6), (COLORS[1], 1.8)):  # a halo, so that it is seen on every shade
            ax.plot(column + 0.5, row + 0.5, ls="none", marker="x", ms=size, mec=color, mew=width)
    if text is not None and max(rows, columns) <= NUMBERED:
        _write(ax, drawn, cells, list(text), columns)
    ax.set_xlabel("column")
    ax.set_ylabel("row")
    for axis, count in ((ax.xaxis, columns), (ax.yaxis, rows)):
        every = max(1, -(-count // 10))
        numbers = range(0, count, every)
        axis.set_ticks([k + 0.5 for k in numbers], [str(k) for k in numbers])
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
    values: object, shape: tuple[int, int], ax: Axes, *, label: str = "ratio P_target / P_simulator"
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

    rows, columns = _shape(shape)
    ratio = _states(values, rows * columns, "values")
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
    shape: tuple[int, int],
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

    rows, columns = _shape(shape)
    given = _checks.float_array(counts, "counts", ndim=(1, 2))
    _checks.require_nonnegative(given, "counts")
    seen = _states(given.sum(axis=1) if given.ndim == 2 else given, rows * columns, "counts")
    ended = _mask(over, rows * columns)
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
    shape: tuple[int, int],
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

    rows, columns = _shape(shape)
    share = 100.0 * _states(time, rows * columns, "time")
    ended = _mask(over, rows * columns)
    share = np.where(ended, np.nan, share)
    most = float(np.nanmax(share)) if np.isfinite(share).any() else 0.0
    crossed = _mask(unseen, rows * columns) & ~ended
    words = ["end" if e else "" if c else _percent(s) for s, e, c in zip(share, ended, crossed, strict=True)]
    norm = PowerNorm(0.5, 0.0, most if most > 0 else 1.0)
    return plot_grid(share, shape, ax, label=label, norm=norm, text=words, crossed=crossed)


def _write(ax: Axes, drawn: Any, cells: Any, words: list[str], columns: int) -> None:
    from matplotlib.colors import to_rgb

    size = 8.0 if columns <= 8 else 7.2
    for k, word in enumerate(words):
        row, column = divmod(k, columns)
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


def _shape(shape: tuple[int, int]) -> tuple[int, int]:
    try:
        rows, columns = shape
    except (TypeError, ValueError):
        raise ValueError(f"shape must be (rows, columns); got {shape!r}") from None
    return _checks.positive_integer(rows, "shape[0]"), _checks.positive_integer(columns, "shape[1]")


def _states(values: object, n_states: int, name: str) -> Array:
    array = _checks.float_array(values, name).reshape(-1)
    if array.size != n_states:
        raise ValueError(f"{name} must have {n_states} entries, one a cell of the grid; it has {array.size}")
    return array


def _mask(mask: object, n_states: int) -> Any:
    found = np.zeros(n_states, dtype=np.bool_) if mask is None else np.asarray(mask, dtype=np.bool_).reshape(-1)
    if found.size != n_states:
        raise ValueError(f"over must have {n_states} entries, one a cell of the grid; it has {found.size}")
    return found
