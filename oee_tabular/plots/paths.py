"""Policies and paths on maps: an arrow for each action, a line for each episode.

An arrow of action a in state s shows pi(a | s) by its length. It points along the mean
displacement of the action, sum_s' P(s' | s, a) (place[s'] - place[s]). Before a wall,
displacements that the action has elsewhere lead off the map: they count as well, if its
others are as likely as elsewhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._sparse import row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, check_policy, number_of
from oee_tabular.plots import style
from oee_tabular.plots.grids import N_TEXT_CELLS, N_VECTOR_CELLS, frame_map
from oee_tabular.plots.maps import Map, map_of
from oee_tabular.plots.style import INK, PAPER
from oee_tabular.typing import Array, BoolArray, IntArray, PolicyLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from oee_tabular.data import Transitions

# of an arrow, in cells: how far it begins from the middle of its cell, and its length
# at probability 0 and 1
ARROW_START_CELLS = 0.1
SHORTEST_CELLS = 0.13
LONGEST_CELLS = 0.36
MIN_SHOWN_PROBABILITY = 1e-9  # below it is what is left of rounding
MIN_STEP_CELLS = 1e-6  # mean displacement below which an action leads nowhere
DIRECTION_DIGITS = 3  # to which unit vectors are compared
MAX_DISPLACEMENTS = 64  # of an action, up to which walls are looked for
PROBABILITY_TOLERANCE = 1e-6  # to which an action is alike in two states
MAX_PATHS = 20
CELL_COLOR = "#f1f3f4"
OVER_COLOR = "#d5d9dd"
# how far apart paths are that go through the same cells
PATH_SPACING_CELLS = 0.09


def require_map(mdp: FiniteMDP, name: str = "mdp") -> Map:
    """Return the map of an MDP; raise an ArgumentError where it has none."""
    found = map_of(_checks.instance(mdp, FiniteMDP, name))
    if found is None:
        raise ArgumentError(
            name,
            f"must have states on a grid; its {mdp.n_states} states have no"
            " (row, column) of even steps, one state a place (mdp.with_layout(layout),"
            " or FiniteMDP(..., layout=), says where they lie)",
        )
    return found


@suggest_keywords
def plot_policy(mdp: FiniteMDP, policy: PolicyLike, ax: Axes | None = None) -> Axes:
    """Draw a policy as arrows: one for each action that it takes in a state.

    The longer an arrow is, the more probable is its action. Actions that lead the same
    way share an arrow. An action that leads nowhere is a ring. Terminal states have no
    arrows.

    Parameters
    ----------
    mdp : FiniteMDP
        The model, whose states lie on a grid (``map_of``).
    policy : array_like of shape (S, A), or one that ``policy_value`` takes
        Probabilities of the actions in each state.
    ax : matplotlib.axes.Axes, optional
        Where to draw; over the picture of ``plot_grid``, for example. On empty axes,
        and on the new ones that None makes, the cells are drawn first.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If the states of the model lie on no grid, or the policy is none of it.

    See Also
    --------
    plot_paths : Draws episodes on the same map.
    plot_grid : Draws a heat map below the arrows.

    Notes
    -----
    Costs O(S A + nnz).

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> import oee_tabular as oee
    >>> grid = oee.tasks.gridworld(3, slip=0.1)
    >>> ax = plot_policy(grid, oee.uniform_policy(grid), Figure().subplots())
    >>> len(ax.collections[-1].get_offsets())  # four in each state but the goal
    32
    """
    places = require_map(mdp)
    probabilities = check_policy(policy, mdp)
    ax = draw_cells(mdp, places, ax)
    towards = _directions(mdp, places)
    is_shown = (probabilities > MIN_SHOWN_PROBABILITY) & (places.cell >= 0)[:, None]
    is_shown &= ~mdp.closed()[:, None]
    state, action = np.nonzero(is_shown)
    step: Array = towards[state, action]
    # one arrow for each state and direction, with the probabilities of its actions
    key = np.column_stack([state, step.round(DIRECTION_DIGITS) + 0.0])
    _, first, shared = np.unique(key, axis=0, return_index=True, return_inverse=True)
    weight = np.zeros(len(first))
    np.add.at(weight, shared.reshape(-1), probabilities[state, action])
    row, column = np.divmod(places.cell[state[first]], len(places.columns))
    middles = np.column_stack([column, row]) + 0.5
    step = step[first]
    is_moving = np.hypot(step[:, 0], step[:, 1]) > 0.5
    _draw_rings(ax, middles[~is_moving], weight[~is_moving])
    _draw_arrows(ax, middles[is_moving], step[is_moving][:, ::-1], weight[is_moving])
    return ax


def _draw_arrows(ax: Axes, start: Array, towards: Array, weight: Array) -> None:
    """Draw arrows, dark with a light edge, which are seen on every shade."""
    if not len(start):
        return
    length = SHORTEST_CELLS + (LONGEST_CELLS - SHORTEST_CELLS) * weight
    ax.quiver(
        *(start + ARROW_START_CELLS * towards).T,
        *(length[:, None] * towards).T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        units="xy",
        width=0.045,  # cells
        headwidth=3.4,
        headlength=3.0,
        headaxislength=2.8,
        minlength=0.0,
        color=INK,
        edgecolor=PAPER,
        linewidth=0.5,
        zorder=3,
    )


def _draw_rings(ax: Axes, middles: Array, weight: Array) -> None:
    """Draw a ring for each action that stays, the wider the more probable."""
    for (x, y), w in zip(middles, weight, strict=True):
        radius = 0.06 + 0.16 * w
        for color, width in ((PAPER, 3.2), (INK, 1.6)):
            ax.add_patch(
                _circle((x, y), radius, fill=False, ec=color, lw=width, zorder=3)
            )


def _circle(middle: tuple[float, float], radius: float, **options: Any) -> Any:
    """Return a circle of matplotlib."""
    from matplotlib.patches import Circle

    return Circle(middle, radius, **options)


def _directions(mdp: FiniteMDP, places: Map) -> Array:
    """Return the unit vector (row, column) of each action in each state, (S, A, 2).

    It is 0 where an action leads nowhere.
    """
    matrix = mdp.transitions
    start, action = np.divmod(row_of_entry(matrix), mdp.n_actions)
    end = matrix.indices
    where = np.column_stack(np.divmod(places.cell, len(places.columns)))
    step = where[end] - where[start]
    moves = (places.cell[start] >= 0) & (places.cell[end] >= 0) & step.any(axis=1)
    is_live = (places.cell >= 0) & ~mdp.closed()
    result = np.zeros((mdp.n_states, mdp.n_actions, 2))
    for a in range(mdp.n_actions):
        own = np.flatnonzero(moves & (action == a))
        if len(own):
            steps, kind = np.unique(step[own], axis=0, return_inverse=True)
            entries = start[own], kind.reshape(-1), matrix.data[own]
            result[:, a] = _mean_steps(entries, steps, where, is_live)
    size = np.linalg.norm(result, axis=2, keepdims=True)
    directions: Array = np.divide(
        result, size, out=np.zeros_like(result), where=size > MIN_STEP_CELLS
    )
    return directions


def _mean_steps(
    entries: tuple[IntArray, IntArray, Array],
    steps: IntArray,
    where: IntArray,
    is_live: BoolArray,
) -> Array:
    """Return the mean displacement of one action in each state, (S, 2).

    ``entries`` are the states, the rows of ``steps`` and the probabilities of its
    transitions. p_d is the median probability of displacement d over the states from
    which d leads to a state. Where the action has all these p_d, what lies off the map
    is counted as if it were there.
    """
    state, kind, probability = entries
    mean = np.zeros((len(where), 2))
    np.add.at(mean, state, probability[:, None] * steps[kind])
    if len(steps) > MAX_DISPLACEMENTS:
        return mean
    table = np.zeros((len(where), len(steps)))
    np.add.at(table, (state, kind), probability)
    shape = where.max(axis=0) + 1
    taken = np.zeros(shape, dtype=np.bool_)
    taken[tuple(where[where[:, 0] >= 0].T)] = True
    ends = where[:, None, :] + steps
    is_inside = ((ends >= 0) & (ends < shape)).all(axis=2)
    is_on_map = is_inside & taken[tuple(np.where(is_inside[..., None], ends, 0).T)].T
    typical = np.array(
        [
            np.median(column[on & is_live]) if (on & is_live).any() else 0.0
            for column, on in zip(table.T, is_on_map.T, strict=True)
        ]
    )
    if typical.sum() > 1.0 + PROBABILITY_TOLERANCE:
        return mean
    is_typical = ((np.abs(table - typical) <= PROBABILITY_TOLERANCE) | ~is_on_map).all(
        axis=1
    )
    return np.where(is_typical[:, None], typical @ steps, mean)


@suggest_keywords
def plot_paths(
    mdp: FiniteMDP,
    paths: Transitions | Sequence[object] | IntArray,
    ax: Axes | None = None,
    *,
    max_paths: int = MAX_PATHS,
) -> Axes:
    """Draw paths through the states: a list of states, several, or a log's episodes.

    A path begins at a hollow circle and ends at a filled mark. Paths through the same
    cells lie side by side.

    Parameters
    ----------
    mdp : FiniteMDP
        The model, whose states lie on a grid (``map_of``).
    paths : Transitions, or sequence of states, or sequence of lists of states
        A log with episodes; or one path, its states by number or name; or a list of
        such lists.
    ax : matplotlib.axes.Axes, optional
        Where to draw; over the picture of ``plot_grid``, for example. On empty axes,
        and on the new ones that None makes, the cells are drawn first.
    max_paths : int, default 20
        How many paths are drawn, the first ones; the label below the picture says where
        there are more.

    Returns
    -------
    matplotlib.axes.Axes
        The axes that were drawn on.

    Raises
    ------
    ValueError
        If the states of the model lie on no grid, a state is none of the model, the log
        has no episodes, or there is nothing to draw.

    See Also
    --------
    plot_policy : Draws the actions of a policy on the same map.
    animate_two : Shows an episode in the simulator beside one in the target.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> import oee_tabular as oee
    >>> grid = oee.tasks.gridworld(3, slip=0.1)
    >>> ax = plot_paths(grid, [0, 1, 2, 5, 8], Figure().subplots())
    >>> ax.get_lines()[1].get_xdata().tolist()  # columns, from the middles of the cells
    [0.5, 1.5, 2.5, 2.5, 2.5]
    """
    places = require_map(mdp)
    n_shown = _checks.positive_integer(max_paths, "max_paths")
    shown, n_paths = _check_paths(mdp, paths, n_shown)
    ax = draw_cells(mdp, places, ax)
    cell = cell_of_each(mdp, places)
    spacing = min(PATH_SPACING_CELLS, 0.6 / max(len(shown) - 1, 1))
    for k, states in enumerate(shown):
        middle = np.column_stack(np.divmod(cell[states], len(places.columns)))
        shift = spacing * (k - 0.5 * (len(shown) - 1))
        _draw_path(ax, middle[:, ::-1] + 0.5 + shift, k)
    if n_paths > len(shown):
        ax.set_xlabel(f"column (the first {len(shown)} of {n_paths} paths)")
    return ax


def _draw_path(ax: Axes, points: Array, k: int) -> None:
    """Draw one path with a light edge, its first point and its last."""
    look = style.series(k)
    for color, width in ((PAPER, 3.2), (look["color"], 1.7)):
        ax.plot(*points.T, color=color, lw=width, solid_joinstyle="round", zorder=4)
    first: dict[str, Any] = {"mfc": PAPER, "mec": look["color"], "mew": 1.6}
    last: dict[str, Any] = {"mfc": look["color"], "mec": PAPER, "mew": 0.8}
    ax.plot(*points[0], "o", ms=6, zorder=5, **first)
    ax.plot(*points[-1], marker=look["marker"], ms=7, zorder=5, **last)


def _check_paths(
    mdp: FiniteMDP, paths: object, n_shown: int
) -> tuple[list[IntArray], int]:
    """Return the first paths as numbers of states, and how many there are."""
    # loaded on use: other pictures do without logs
    from oee_tabular.data import Transitions

    if isinstance(paths, Transitions):
        return _paths_of_log(mdp, paths, n_shown)
    given = _checks.collection(paths, "paths", "a log, states, or lists of states")
    several = len(given) > 0 and all(isinstance(p, list | np.ndarray) for p in given)
    if not several:
        return [_numbers(mdp, given, "paths")], 1
    return [
        _numbers(mdp, path, f"paths[{k}]") for k, path in enumerate(given[:n_shown])
    ], len(given)


def _numbers(mdp: FiniteMDP, path: object, name: str) -> IntArray:
    """Return the numbers of a path's states."""
    states = _checks.collection(path, name, "states, by number or name")
    if not len(states):
        raise ArgumentError(
            name, "must hold at least one state; it is empty, and nothing is to draw"
        )
    numbers = [
        number_of(state, mdp.state_names, mdp.n_states, f"{name}[{k}]")
        for k, state in enumerate(states)
    ]
    return np.array(numbers, dtype=np.int64)


def _paths_of_log(
    mdp: FiniteMDP, log: Transitions, n_shown: int
) -> tuple[list[IntArray], int]:
    """Return the states of a log's first episodes, and how many episodes there are."""
    bounds = log.episode_starts
    if bounds is None or not len(log):
        lacks = "has no episodes" if len(log) else "is empty"
        raise ArgumentError(
            "paths",
            f"must be a log with episodes, or lists of states; the log {lacks}"
            " (Transitions(..., episode=) says which transitions belong together)",
        )
    numbered = log.numbered(mdp, "paths")
    found = []
    shown = bounds[: n_shown + 1]
    for start, end in zip(shown[:-1], shown[1:], strict=True):
        states = [*numbered.state[start:end], numbered.next_state[end - 1]]
        found.append(_numbers(mdp, states, "paths"))
    return found, len(bounds) - 1


def cell_of_each(mdp: FiniteMDP, places: Map) -> IntArray:
    """Return the cell of each state, also of those that lie beneath another one."""
    cell = places.cell.copy()
    if mdp.layout is None:  # which alone puts two states in one place
        return cell
    for state in np.flatnonzero(cell < 0):
        at = mdp.layout[state]
        row = int(np.abs(np.subtract(places.rows, at[0])).argmin())
        column = int(np.abs(np.subtract(places.columns, at[1])).argmin())
        cell[state] = row * len(places.columns) + column
    return cell


def draw_cells(mdp: FiniteMDP, places: Map, ax: Axes | None) -> Axes:
    """Draw the cells in which states are on empty axes, terminal ones darker.

    Axes on which something is drawn stay as they are.
    """
    from matplotlib.colors import ListedColormap

    rows, columns = places.shape
    width, height = (1.2 + 0.5 * min(n, 12) for n in (columns, rows))
    ax = style.check_axes(ax, (max(width, 3.2), max(height, 2.4)))
    if ax.has_data():
        return ax
    is_over = mdp.closed()
    cells = np.ma.masked_invalid(places.spread(is_over)).reshape(rows, columns)
    ax.pcolormesh(
        cells,
        cmap=ListedColormap([CELL_COLOR, OVER_COLOR]),
        vmin=0.0,
        vmax=1.0,
        edgecolor=PAPER,
        linewidth=1.2,
        rasterized=cells.size > N_VECTOR_CELLS,
        zorder=0,
    )
    for state in np.flatnonzero(is_over & (places.cell >= 0)):
        if max(rows, columns) <= N_TEXT_CELLS:
            row, column = divmod(int(places.cell[state]), columns)
            # low in its cell, where no mark covers it
            look: dict[str, Any] = {"ha": "center", "va": "bottom", "color": INK}
            ax.text(column + 0.5, row + 0.95, "end", fontsize=8.0, **look)
    frame_map(ax, places)
    return ax
