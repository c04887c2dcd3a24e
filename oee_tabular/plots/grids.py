"""Heat maps of states on a grid: values, ratios, recorded and expected visits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.plots import style
from oee_tabular.plots.maps import Map, as_map
from oee_tabular.plots.slide_style import has_slides
from oee_tabular.plots.style import COLORS, INK, check_texts, disable_math, shorten
from oee_tabular.typing import BoolArray, RealArrayLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize

# cells up to which each is a shape of its own; larger maps are images
N_VECTOR_CELLS = 1600
# rows and columns up to which cells can hold text, elsewhere and on a slide
N_TEXT_CELLS = 12
N_TEXT_CELLS_OF_SLIDE = 8


@suggest_keywords
def plot_grid(
    values: RealArrayLike,
    shape: tuple[int, int] | Map,
    ax: Axes | None = None,
    *,
    label: str,
    norm: Normalize | None = None,
    colormap: str = style.SEQUENTIAL,
    text: Sequence[object] | None = None,
    crossed: RealArrayLike | None = None,
    ticks: RealArrayLike | None = None,
) -> Axes:
    """Draw a heat map of one number a state, row 0 on top.

    A cell without a state stays blank.

    Parameters
    ----------
    values : RealArrayLike of shape (S,) or (rows, columns)
        A number for each state; nan for a cell without colour.
    shape : tuple of two ints, or Map
        Numbers of rows and columns, of states numbered row * columns + column; or the
        map that ``map_of`` makes.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    label : str
        What the numbers are, with the unit; it stands beside the colour bar.
    norm : matplotlib.colors.Normalize, optional
        Scale of the colours; None means linear.
    colormap : str, default "cividis"
        Name of a colour map of matplotlib.
    text : sequence of str, optional
        A word for each state, written into its cell (left out beyond 12 rows or
        columns, on a slide beyond 8).
    crossed : array_like of bool, shape (S,), optional
        States to cross out.
    ticks : RealArrayLike, optional
        Ticks of the colour bar; None means matplotlib's.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If a length is not that of the grid, the colour map is unknown, or there is
        nothing to draw.

    See Also
    --------
    map_of : Makes a shape from a model.
    plot_ratio : Heat map of ratios.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> ax = plot_grid(
    ...     [0.0, 1.0, 2.0, 3.0],
    ...     (2, 2),
    ...     Figure().subplots(),
    ...     label="value (reward)",
    ...     text=list("abcd"),
    ... )
    >>> [text.get_text() for text in ax.texts]
    ['a', 'b', 'c', 'd']
    """
    import matplotlib.colors

    places = as_map(shape)
    rows, columns = places.shape
    number = _check_states(
        values, places, "values", allow_blank=text is not None or crossed is not None
    )
    is_crossed = _check_mask(crossed, places, "crossed")
    check_texts(label=label, colormap=colormap)
    if colormap not in matplotlib.colormaps:
        raise ArgumentError(
            "colormap",
            f"must be the name of one of matplotlib's; got {_checks.show(colormap)}",
        )
    if norm is not None:
        _checks.instance(
            norm, matplotlib.colors.Normalize, "norm", "norm of matplotlib"
        )
    words: list[str] = []
    if text is not None:
        words = [
            shorten(word)
            for word in _checks.collection(text, "text", "words, one a state")
        ]
    marks = None if ticks is None else _checks.float_array(ticks, "ticks", ndim=1)
    ax = style.check_axes(ax, (5.4, 4.2))
    cells = np.ma.masked_invalid(places.spread(number).reshape(rows, columns))
    is_image = cells.size > N_VECTOR_CELLS
    mesh = ax.pcolormesh(
        cells,
        cmap=colormap,
        norm=norm,
        linewidth=0.5,
        edgecolor="face",
        rasterized=is_image,
    )
    frame_map(ax, places)
    _cross_out(ax, places, is_crossed, is_image)
    if max(rows, columns) <= (N_TEXT_CELLS_OF_SLIDE if has_slides() else N_TEXT_CELLS):
        _write(ax, mesh, cells, places, words)
    bar = ax.figure.colorbar(
        mesh, ax=ax, fraction=0.05, pad=0.03, ticks=marks, format="%g", label=label
    )
    bar.minorticks_off()
    bar.outline.set_visible(False)
    return ax


def _cross_out(ax: Axes, places: Map, is_crossed: BoolArray, is_image: bool) -> None:
    """Draw a cross over each state of the mask."""
    rows, columns = places.shape
    row, column = np.divmod(places.cell[is_crossed & (places.cell >= 0)], columns)
    size = min(9.0, 120.0 / max(rows, columns))
    # a halo, so that it is seen on every shade
    for color, width in ((style.PAPER, 3.6), (COLORS[1], 1.8)):
        ax.plot(
            column + 0.5,
            row + 0.5,
            "x",
            ms=size,
            mec=color,
            mew=width,
            rasterized=is_image,
        )


def frame_map(ax: Axes, places: Map) -> None:
    """Make axes those of a map: row 0 on top, square cells, no frame.

    At most ten coordinates stand along each axis.
    """
    rows, columns = places.shape
    ax.set(
        xlim=(0, columns), ylim=(rows, 0), aspect="equal", xlabel="column", ylabel="row"
    )
    ax.spines[:].set_visible(False)
    for axis, called in ((ax.xaxis, places.columns), (ax.yaxis, places.rows)):
        shown = range(0, len(called), -(-len(called) // 10))
        axis.set_ticks([k + 0.5 for k in shown], [f"{called[k]:.6g}" for k in shown])
        axis.set_tick_params(length=0)


@suggest_keywords
def plot_ratio(
    values: RealArrayLike,
    shape: tuple[int, int] | Map,
    ax: Axes | None = None,
    *,
    label: str = "ratio P_target / P_simulator",
) -> Axes:
    """Draw a heat map of ratios, logarithmic around 1.

    One colour means more often than in the simulator, the other less often.

    Parameters
    ----------
    values : RealArrayLike of shape (S,)
        Nonnegative ratios, nan where there is none; a 0 is drawn as the smallest.
    shape : tuple of two ints, or Map
        Numbers of rows and columns, of states numbered row * columns + column; or the
        map that ``map_of`` makes.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    label : str
        What the ratios are; it stands beside the colour bar.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If a ratio is negative, or the number of states is not that of the grid.

    See Also
    --------
    plot_grid : Heat map of any number.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> [
    ...     text.get_text()
    ...     for text in plot_ratio(
    ...         [0.5, 1.0, 1.0, 2.0], (2, 2), Figure().subplots()
    ...     ).texts
    ... ]
    ['0.5', '1', '1', '2']
    """
    from matplotlib.colors import LogNorm

    ratio = _check_states(values, as_map(shape), "values")
    _checks.require_nonnegative(np.nan_to_num(ratio), "values")
    positive = ratio[np.isfinite(ratio) & (ratio > 0)]
    power = min(max(1, int(np.ceil(np.abs(np.log2(positive)).max(initial=0.0)))), 1000)
    reach = 2.0**power
    return plot_grid(
        np.where(ratio == 0, 1.0 / reach, ratio),
        shape,
        ax,
        label=label,
        norm=LogNorm(1.0 / reach, reach),
        colormap=style.DIVERGING,
        text=["" if np.isnan(r) else f"{r:.2g}" for r in ratio],
        ticks=[2.0**k for k in sorted({-power, -(power // 2), 0, power // 2, power})],
    )


@suggest_keywords
def plot_coverage(
    counts: RealArrayLike,
    shape: tuple[int, int] | Map,
    ax: Axes | None = None,
    *,
    over: RealArrayLike | None = None,
    label: str = "recorded transitions from the state (logarithmic)",
) -> Axes:
    """Draw how many transitions the log has from each state, logarithmic.

    States without any are crossed out.

    Parameters
    ----------
    counts : RealArrayLike of shape (S,) or (S, A)
        Recorded transitions, which are summed over actions.
    shape : tuple of two ints, or Map
        Numbers of rows and columns, of states numbered row * columns + column; or the
        map that ``map_of`` makes.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    over : array_like of bool, shape (S,), optional
        Terminal states, which are left blank and named "end".
    label : str
        What the counts are; it stands beside the colour bar.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If a count is negative, or the number of states is not that of the grid.

    See Also
    --------
    plot_occupancy : Where a policy spends its time.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> [
    ...     text.get_text()
    ...     for text in plot_coverage([20, 3, 0, 1], (2, 2), Figure().subplots()).texts
    ... ]
    ['20', '3', '1']
    """
    from matplotlib.colors import LogNorm

    given = _checks.float_array(counts, "counts", ndim=(1, 2))
    _checks.require_nonnegative(given, "counts")
    places = as_map(shape)
    total = _check_states(
        given.sum(axis=1) if given.ndim == 2 else given, places, "counts"
    )
    is_over = _check_mask(over, places, "over")
    power = max(1, int(np.ceil(np.log10(max(float(total.max()), 1.0)))))
    return plot_grid(
        np.where((total > 0) & ~is_over, total, np.nan),
        shape,
        ax,
        label=label,
        norm=LogNorm(1.0, 10.0**power),
        text=[
            "end" if e else _count_text(n) for n, e in zip(total, is_over, strict=True)
        ],
        crossed=(total == 0) & ~is_over,
        ticks=[10.0**k for k in range(power + 1)],
    )


@suggest_keywords
def plot_occupancy(
    time: RealArrayLike,
    shape: tuple[int, int] | Map,
    ax: Axes | None = None,
    *,
    unrecorded: RealArrayLike | None = None,
    over: RealArrayLike | None = None,
    label: str = "share of the policy's discounted time (%)",
) -> Axes:
    """Draw where a policy spends its time; unrecorded states are crossed out.

    Parameters
    ----------
    time : RealArrayLike of shape (S,)
        Shares of discounted time, which sum to at most 1.
    shape : tuple of two ints, or Map
        Numbers of rows and columns, of states numbered row * columns + column; or the
        map that ``map_of`` makes.
    ax : matplotlib.axes.Axes, optional
        Where to draw. None makes a new figure.
    unrecorded : array_like of bool, shape (S,), optional
        States to cross out.
    over : array_like of bool, shape (S,), optional
        Terminal states, which are left blank and named "end".
    label : str
        What the shares are; it stands beside the colour bar.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If the number of states is not that of the grid.

    See Also
    --------
    plot_coverage : Where the log has transitions.
    plot_states : The states with most time, ranked.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> [
    ...     text.get_text()
    ...     for text in plot_occupancy(
    ...         [0.5, 0.25, 0.25, 0.0], (2, 2), Figure().subplots()
    ...     ).texts
    ... ]
    ['50', '25', '25']
    """
    from matplotlib.colors import PowerNorm

    places = as_map(shape)
    is_over = _check_mask(over, places, "over")
    crossed = _check_mask(unrecorded, places, "unrecorded") & ~is_over
    share = np.where(is_over, np.nan, 100.0 * _check_states(time, places, "time"))
    most = float(np.max(share, where=np.isfinite(share), initial=0.0))
    text = [_percent_text(s) for s in share]
    for k in np.flatnonzero(crossed):
        text[k] = ""
    for k in np.flatnonzero(is_over):
        text[k] = "end"
    return plot_grid(
        share,
        shape,
        ax,
        label=label,
        norm=PowerNorm(0.5, 0.0, most or 1.0),
        text=text,
        crossed=crossed,
    )


def _write(ax: Axes, mesh: Any, cells: Any, places: Map, words: Sequence[str]) -> None:
    """Write words into cells, black on light shades and white on dark ones."""
    shades = mesh.to_rgba(cells).reshape(-1, 4)[:, :3] @ [0.2126, 0.7152, 0.0722]
    style: dict[str, Any] = {
        "ha": "center",
        "va": "center",
        "fontsize": 8.0 if cells.shape[1] <= 8 else 7.2,
    }
    for cell, word in zip(places.cell, words, strict=False):
        if cell >= 0 and word:
            color = "#000000" if shades[cell] > 0.45 else "#ffffff"
            if np.ma.getmaskarray(cells).flat[cell]:
                color = INK
            row, column = divmod(int(cell), cells.shape[1])
            disable_math([ax.text(column + 0.5, row + 0.5, word, color=color, **style)])


def _count_text(count: float) -> str:
    """Return a count in at most four letters, nothing for 0."""
    if count == 0:
        return ""
    if count < 1000:
        return f"{count:.3g}"
    if count < 1e4:
        return f"{count / 1000:.2g}k"
    if count < 1e6:
        return f"{count / 1000:.0f}k"
    return f"{count:.0e}"


def _percent_text(share: float) -> str:
    """Return a share in percent, empty where it is next to nothing."""
    if share < 0.05:
        return ""
    if share < 9.95:
        return f"{share:.1f}"
    return f"{share:.0f}"


def _check_states(
    values: object, places: Map, name: str, *, allow_blank: bool = False
) -> Any:
    """Return one number for each state, checked."""
    array = _checks.float_array(values, name).reshape(-1)
    if array.size != len(places.cell):
        raise ArgumentError(
            name,
            f"must have {len(places.cell)} entries, one a cell of the grid; it has"
            f" {array.size}",
        )
    if not allow_blank and not np.isfinite(array).any():
        raise ArgumentError(
            name, "must hold at least one finite number; there is nothing to draw"
        )
    return array


def _check_mask(mask: object, places: Map, name: str) -> Any:
    """Return a mask over the states; None means that no state is in it."""
    given = np.zeros(len(places.cell)) if mask is None else mask
    return _check_states(given, places, name) != 0
