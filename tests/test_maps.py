"""Maps of worlds that are no square grids: cells at their places, blank where no state is; by layout, names or moves."""

import numpy as np
import pytest
from matplotlib.figure import Figure

import oee_tabular as oee
from oee_tabular import plots

ROOMS = [(0, 0), (0, 1), (1, 1), (2, 1), (2, 0)]  # a corridor around a wall: (1, 0) is none
STEP = 0.25


def corridor(names=ROOMS, **options):
    """One goes on along the corridor, or back; the last room is the end."""
    n = len(names)
    transitions = np.zeros((n, 2, n))
    for s in range(n - 1):
        transitions[s, 0, s + 1] = transitions[s, 1, max(s - 1, 0)] = 0.9
        transitions[s, :, s] += 0.1
    transitions[n - 1, :, n - 1] = 1.0
    return oee.FiniteMDP(transitions, np.eye(n)[n - 2], 0, 0.9, state_names=names, **options)


def cells(ax):
    return np.ma.filled(ax.collections[0].get_array(), np.nan).reshape(-1)


def words(ax):
    return {(text.get_position()[1] - 0.5, text.get_position()[0] - 0.5): text.get_text() for text in ax.texts}


@pytest.fixture
def ax():
    return Figure().subplots()


def test_rooms_are_at_their_places_and_walls_are_blank(ax):
    found = plots.map_of(corridor())
    assert found.shape == (3, 2)
    plots.plot_grid([1.0, 2.0, 3.0, 4.0, 5.0], found, ax, label="x", text=list("abcde"), crossed=[0, 0, 0, 1, 0])
    np.testing.assert_array_equal(cells(ax), [1, 2, np.nan, 3, 5, 4])
    assert words(ax) == {(0, 0): "a", (0, 1): "b", (1, 1): "c", (2, 1): "d", (2, 0): "e"}
    assert ax.get_lines()[0].get_xydata().tolist() == [[1.5, 2.5]]


def test_every_map_takes_it():
    found, over = plots.map_of(corridor()), [0, 0, 0, 0, 1]
    seen = plots.plot_coverage([[1, 1], [3, 0], [0, 0], [7, 0], [0, 0]], found, Figure().subplots(), over=over)
    assert words(seen) == {(0, 0): "2", (0, 1): "3", (2, 1): "7", (2, 0): "end"}
    assert seen.get_lines()[0].get_xydata().tolist() == [[1.5, 1.5]]
    time = plots.plot_occupancy([0.5, 0.25, 0.25, 0, 0], found, Figure().subplots(), over=over)
    assert words(time) == {(0, 0): "50", (0, 1): "25", (1, 1): "25", (2, 0): "end"}
    ratio = plots.plot_ratio([1, 2, 0.5, np.nan, 4], found, Figure().subplots())
    assert words(ratio) == {(0, 0): "1", (0, 1): "2", (1, 1): "0.5", (2, 0): "4"}
    with pytest.raises(ValueError, match="values must have 5 entries, one a cell of the grid; it has 6"):
        plots.plot_grid(np.zeros(6), found, Figure().subplots(), label="x")


def test_axes_speak_the_layouts_units(ax):
    found = plots.map_of(corridor(layout=STEP * np.array(ROOMS) - [3, 0]))
    assert found.rows == (-3.0, -2.75, -2.5)
    assert found.place(3) == (-2.5, 0.25)
    plots.plot_grid(np.arange(5.0), found, ax, label="x")
    assert [label.get_text() for label in ax.get_yticklabels()] == ["-3", "-2.75", "-2.5"]


@pytest.mark.parametrize(
    "layout",
    [
        np.arange(5),  # a line
        np.column_stack([[0, 1, 2.6, 3, 4], [0, 0, 0, 0, 1]]),  # uneven steps
        np.column_stack([np.arange(5), [0, 1, 10**6, 3, 4]]),  # too far apart to draw
        np.column_stack([[0.0, 1e308, -1e308, 5e-324, 1.0], np.zeros(5)]),
        [(0, 0), (0, 1), (0, 1), (1, 0), (1, 1)],  # two rooms above each other
        np.zeros((5, 3)),  # three coordinates
    ],
)
def test_places_that_make_no_map(layout):
    assert plots.map_of(corridor(layout=layout)) is None


def test_a_rectangle_by_its_shape_and_a_grid_by_its_transitions():
    assert plots.map_of(oee.tasks.gridworld(3, 0.1).with_layout((1, 9))).shape == (1, 9)
    assert plots.map_of(oee.tasks.gridworld(3, 0.1).with_layout(None)).shape == (3, 3)
    assert plots.map_of(oee.tasks.toy_text("FrozenLake-v1")).shape == (4, 4)


def test_a_state_that_is_over_lies_beneath_the_one_at_its_place():
    places = [(0, 0), (0, 1), (1, 1), (2, 1), (0, 1)]  # the last is over
    found = plots.map_of(corridor([*ROOMS[:4], "end"], layout=places))
    assert found.cell.tolist() == [0, 1, 3, 5, -1]
    assert found.place(4) is None
    drawn = plots.plot_occupancy([0.3, 0.3, 0.4, 0, 0], found, Figure().subplots(), over=[0, 0, 0, 0, 1])
    assert words(drawn) == {(0, 0): "30", (0, 1): "30", (1, 1): "40"}
