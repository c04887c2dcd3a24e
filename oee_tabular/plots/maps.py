"""Maps: the cells of a grid, and the states in them.

A ``Map`` says where the states lie, from the layout of an MDP or from its transitions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks
from oee_tabular._results import checked
from oee_tabular._sparse import row_of_entry
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array, BoolArray, IntArray, RealArrayLike

# The least share of a map's cells that are states: places that are further apart make
# no map.
MIN_FILLED_SHARE = 0.02
PLACE_TOLERANCE_CELLS = 1e-6  # by which a place may miss the middle of its cell


@checked(shapes={"cell": "S"})
@dataclass(frozen=True, eq=False)
class Map:
    """Hold the cells of a grid, row 0 on top, and the states in them.

    ``plot_grid`` and its like take it for a shape.

    Parameters
    ----------
    rows : tuple of float
        Coordinates of the rows, as they are written on the axis.
    columns : tuple of float
        Coordinates of the columns, as they are written on the axis.
    cell : ndarray of int, shape (S,)
        Where each state is: row * columns + column; -1 for a state that is not drawn.

    Examples
    --------
    >>> print(Map.of_shape(2, 3).spread([1, 2, 3, 4, 5, 6]))
    [1. 2. 3. 4. 5. 6.]
    >>> print(Map((0.0, 1.0), (0.0,), np.array([1])).spread([7]))
    [nan  7.]
    """

    rows: tuple[float, ...]
    columns: tuple[float, ...]
    cell: IntArray

    @classmethod
    def of_shape(cls, rows: int, columns: int) -> Map:
        """Make the map that has a state in each cell, numbered row * columns + column.

        Parameters
        ----------
        rows : int
            Number of rows.
        columns : int
            Number of columns.

        Returns
        -------
        Map
            The map of rows * columns states.
        """
        shape = (
            _checks.positive_integer(rows, "rows"),
            _checks.positive_integer(columns, "columns"),
        )
        # a coordinate is a number of Python's, kept and checked in several places
        needed = shape[0] * shape[1] + 20.0 * sum(shape)
        _checks.require_memory(needed, "rows", shape)
        return cls(
            tuple(range(shape[0])),
            tuple(range(shape[1])),
            np.arange(shape[0] * shape[1]),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of rows and columns."""
        return len(self.rows), len(self.columns)

    def spread(self, values: RealArrayLike) -> Array:
        """Return what is in each cell, nan where no state is.

        Parameters
        ----------
        values : RealArrayLike of shape (S,)
            A number for each state.

        Returns
        -------
        ndarray of shape (rows * columns,)
            A number for each cell.
        """
        given = _checks.float_array(values, "values", ndim=1)
        if len(given) != len(self.cell):
            raise ArgumentError(
                "values",
                f"must have {len(self.cell)} entries, one a state; it has {len(given)}",
            )
        cells = np.full(len(self.rows) * len(self.columns), np.nan)
        cells[self.cell[self.cell >= 0]] = given[self.cell >= 0]
        return cells

    def place(self, state: int) -> tuple[float, float] | None:
        """Return the coordinates of a state's row and column.

        Parameters
        ----------
        state : int
            Number of the state.

        Returns
        -------
        tuple of two floats, or None
            Row and column; None for a state that is not drawn.
        """
        if not _checks.is_integer(state) or not 0 <= state < len(self.cell):
            raise ArgumentError(
                "state",
                f"must be an integer from 0 to {len(self.cell) - 1}; got"
                f" {_checks.show(state)}",
            )
        if self.cell[state] < 0:
            return None
        row, column = divmod(int(self.cell[state]), len(self.columns))
        return self.rows[row], self.columns[column]


def map_of(mdp: FiniteMDP) -> Map | None:
    """Return the map of an MDP whose states lie on a grid, or None.

    ``mdp.layout`` of two columns, (row, column), with even steps puts the states there;
    holes stay blank. A terminal state that lies where another state does is not drawn.
    Without such a layout ``detect_grid`` is asked.

    Parameters
    ----------
    mdp : FiniteMDP
        The model whose states are placed.

    Returns
    -------
    Map or None
        None where two states that can be left share a place, and where fewer than one
        cell in fifty is a state.

    See Also
    --------
    detect_grid : Finds a grid in the transitions alone.

    Notes
    -----
    Costs O(S log S + nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> corner = oee.FiniteMDP(
    ...     np.full((3, 1, 3), 1 / 3),
    ...     [0, 0, 1],
    ...     0,
    ...     0.9,
    ...     state_names=[(0, 0), (0, 1), (1, 1)],
    ... )
    >>> map_of(corner).shape, map_of(corner).spread([5, 6, 7])
    ((2, 2), array([ 5.,  6., nan,  7.]))
    """
    layout = _checks.instance(mdp, FiniteMDP, "mdp").layout
    if layout is not None and layout.shape[1] == 2:
        result = _from_places(layout, mdp.closed())
        if result is not None:
            return result
    shape = detect_grid(mdp)
    return None if shape is None else Map.of_shape(*shape)


def _from_places(layout: Array, is_over: BoolArray) -> Map | None:
    """Return the map of places on a grid with even steps, or None."""
    coordinates = []
    numbers = []
    for place in layout.T:
        distinct = np.unique(place)
        gaps = np.diff(distinct)
        gaps = gaps[gaps > PLACE_TOLERANCE_CELLS * np.abs(distinct).max()]
        step = float(gaps.min()) if len(gaps) else 1.0
        with np.errstate(over="ignore", invalid="ignore"):
            at = (place - distinct[0]) / step
            number = np.rint(at)
            is_even = (number < len(layout) / MIN_FILLED_SHARE) & (
                np.abs(at - number) <= PLACE_TOLERANCE_CELLS
            )
        if not is_even.all():
            return None
        coordinates.append(
            tuple((distinct[0] + step * np.arange(int(number.max()) + 1)).tolist())
        )
        numbers.append(number.astype(np.int64))
    rows, columns = coordinates
    row, column = numbers
    if len(layout) < MIN_FILLED_SHARE * len(rows) * len(columns):
        return None
    cell = row * len(columns) + column
    # of several states in a cell one that can be left is drawn
    order = np.argsort(is_over, kind="stable")
    is_hidden = np.ones(len(cell), dtype=np.bool_)
    is_hidden[order[np.unique(cell[order], return_index=True)[1]]] = False
    if (is_hidden & ~is_over).any():
        return None
    return Map(rows, columns, np.where(is_hidden, -1, cell))


def as_map(shape: tuple[int, int] | Map) -> Map:
    """Return a map, or that of (rows, columns); refuse anything else."""
    if isinstance(shape, Map):
        return shape
    try:
        rows, columns = _checks.collection(shape, "shape", "(rows, columns)")
    except (TypeError, ValueError):
        raise ArgumentError(
            "shape", f"must be (rows, columns); got {_checks.show(shape)}"
        ) from None
    return Map.of_shape(
        _checks.positive_integer(rows, "shape[0]"),
        _checks.positive_integer(columns, "shape[1]"),
    )


def detect_grid(mdp: FiniteMDP) -> tuple[int, int] | None:
    """Find the rows and columns of a gridworld in its transitions.

    A gridworld's states are numbered row * columns + column. Its transitions stay, go
    to the neighbour on the left or right (never around an edge), or to the one above or
    below. A jump back to an initial state (as from CliffWalking's cliff) is allowed.

    Parameters
    ----------
    mdp : FiniteMDP
        The model whose transitions are read.

    Returns
    -------
    tuple of two ints, or None
        Numbers of rows and columns; None where it is no gridworld.

    See Also
    --------
    map_of : Reads the layout of the model first.

    Notes
    -----
    Costs O(nnz).

    Examples
    --------
    >>> from oee_tabular.tasks import gridworld
    >>> detect_grid(gridworld(5, slip=0.1))
    (5, 5)
    """
    matrix = _checks.instance(mdp, FiniteMDP, "mdp").transitions
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
