"""Policies and episodes on maps: where arrows point, how long they are, and paths."""

import importlib.util

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import colors
from matplotlib.figure import Figure
from PIL import Image

import oee_tabular as oee
from oee_tabular import plots
from oee_tabular.plots.paths import (
    ARROW_START_CELLS,
    LONGEST_CELLS,
    SHORTEST_CELLS,
)

UP, RIGHT, DOWN, LEFT = (-1, 0), (0, 1), (1, 0), (0, -1)


def arrows(mdp, policy):
    """What is drawn: {(row, column, direction): length}, and the middles of rings."""
    ax = Figure().subplots()
    plots.plot_policy(mdp, policy, ax)
    drawn = {}
    for quiver in (one for one in ax.collections if hasattr(one, "U")):
        for (x, y), right, down in zip(
            quiver.get_offsets(), quiver.U, quiver.V, strict=True
        ):
            length = np.hypot(right, down)
            x -= ARROW_START_CELLS * right / length
            y -= ARROW_START_CELLS * down / length
            towards = (round(down / length, 2) + 0.0, round(right / length, 2) + 0.0)
            drawn[round(y - 0.5, 6), round(x - 0.5, 6), towards] = length
    rings = {tuple(np.subtract(circle.center[::-1], 0.5)) for circle in ax.patches}
    ax.figure.canvas.draw()
    return drawn, rings


def length_of(probability):
    return SHORTEST_CELLS + (LONGEST_CELLS - SHORTEST_CELLS) * probability


def grid_moves(rows, columns, slip, holes=(), order=(UP, RIGHT, DOWN, LEFT)):
    """An MDP whose action goes one way, or with ``slip`` any of the four."""
    cells = [(r, c) for r in range(rows) for c in range(columns) if (r, c) not in holes]
    number = {cell: k for k, cell in enumerate(cells)}
    P = np.zeros((len(cells), 4, len(cells)))
    for cell, s in number.items():
        ends = [number.get((cell[0] + step[0], cell[1] + step[1]), s) for step in order]
        for a in range(4):
            P[s, a, ends[a]] += 1.0 - slip
            for end in ends:
                P[s, a, end] += slip / 4
    P[-1] = np.eye(len(cells))[-1]
    return oee.FiniteMDP(P, np.zeros(len(cells)), 0, 0.9, layout=cells), cells


@settings(deadline=None, max_examples=25)
@given(
    st.integers(2, 5),
    st.integers(2, 5),
    st.sampled_from([0.0, 0.2, 0.7]),
    st.permutations([UP, RIGHT, DOWN, LEFT]),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_an_arrow_points_where_its_action_goes_also_before_a_wall(
    rows, columns, slip, order, has_hole, seed
):
    holes = [(1, 1)] if has_hole and rows > 2 and columns > 2 else []
    mdp, cells = grid_moves(rows, columns, slip, holes, order)
    policy = np.random.default_rng(seed).dirichlet(np.ones(4), len(cells))
    drawn, rings = arrows(mdp, policy)
    assert rings == set()
    wanted = {
        (*map(float, cell), tuple(map(float, order[a]))): length_of(policy[s, a])
        for s, cell in enumerate(cells[:-1])
        for a in range(4)
    }
    assert drawn.keys() == wanted.keys()
    for key, length in wanted.items():
        assert drawn[key] == pytest.approx(length)


def test_a_sure_policy_has_one_arrow_a_state():
    lake = oee.tasks.toy_text(
        "FrozenLake-v1"
    )  # left, down, right, up, two in three slip
    drawn, rings = arrows(lake, [2] * lake.n_states)
    live = np.flatnonzero(~lake.closed())
    assert {key[2] for key in drawn} == {(0.0, 1.0)}
    assert {4 * row + column for row, column, _ in drawn} == {*live.tolist()}
    assert rings == set()
    assert all(v == pytest.approx(LONGEST_CELLS) for v in drawn.values())


def test_actions_that_go_the_same_way_share_an_arrow_and_others_are_rings():
    P = np.zeros((4, 4, 4))
    P[:, 0] = P[:, 1] = np.eye(4)[[1, 1, 3, 3]]  # both go right
    P[:, 2] = np.eye(4)  # stays
    P[:, 3] = np.eye(4)[[2, 3, 2, 3]]  # down
    mdp = oee.FiniteMDP(P, np.zeros(4), 0, 0.9, layout=(2, 2))
    drawn, rings = arrows(mdp, np.tile([0.25, 0.25, 0.5, 0.0], (4, 1)))
    assert rings == {(0.0, 0.0), (0.0, 1.0), (1.0, 0.0)}  # the fourth is the end
    assert {key[2] for key in drawn} == {(0.0, 1.0)}
    assert drawn[0.0, 0.0, (0.0, 1.0)] == pytest.approx(length_of(0.5))


def test_an_action_that_goes_another_way_in_each_state_points_that_way():
    rooms = [(0, 0), (0, 1), (1, 1), (2, 1), (2, 0)]
    P = np.zeros((5, 1, 5))
    P[np.arange(5), 0, [1, 2, 3, 4, 4]] = 1.0
    drawn, _ = arrows(oee.FiniteMDP(P, np.zeros(5), 0, 0.9, state_names=rooms), [0] * 5)
    assert drawn.keys() == {
        (0.0, 0.0, (0.0, 1.0)),
        (0.0, 1.0, (1.0, 0.0)),
        (1.0, 1.0, (1.0, 0.0)),
        (2.0, 1.0, (0.0, -1.0)),
    }


def test_arrows_are_drawn_over_a_heat_map():
    grid = oee.tasks.gridworld(3, 0.1)
    ax = Figure().subplots()
    plots.plot_grid(np.arange(9.0), (3, 3), ax, label="x")
    before = len(ax.collections)
    plots.plot_policy(grid, oee.uniform_policy(grid), ax)
    plots.plot_paths(grid, [0, 1], ax)
    assert len(ax.collections) == before + 1  # no cells over the colours
    (quiver,) = ax.collections[before:]
    # dark with a light edge: one of both is seen on every shade
    light = colors.to_rgb(quiver.get_edgecolor()[0])
    dark = colors.to_rgb(quiver.get_facecolor()[0])
    assert min(light) > 0.9 > 0.2 > max(dark)


def middles(ax):
    """The paths that are drawn, without their edges and marks."""
    return [line.get_xydata() for line in ax.get_lines() if line.get_linewidth() == 1.7]


def test_paths_of_states_of_names_and_of_a_log_are_the_same():
    rooms = [(r, c) for r in range(2) for c in range(2)]
    P = np.full((4, 1, 4), 0.25)
    mdp = oee.FiniteMDP(P, np.zeros(4), 0, 0.9, state_names=rooms)
    log = oee.Transitions([0, 1], [0, 0], [1, 3], episode=[0, 0])
    named = oee.Transitions.from_episodes(
        [[((0, 0), 0, 0.0), ((0, 1), 0, 0.0), ((1, 1),)]]
    )
    for path in ([0, 1, 3], [[0, 1, 3]], np.array([0, 1, 3]), np.array([[0, 1, 3]]),
                 [(0, 0), (0, 1), (1, 1)], log, named):  # fmt: skip
        ax = Figure().subplots()
        plots.plot_paths(mdp, path, ax)
        (drawn,) = middles(ax)
        np.testing.assert_allclose(drawn, [[0.5, 0.5], [1.5, 0.5], [1.5, 1.5]])


def test_paths_lie_side_by_side_and_say_where_there_are_more():
    grid = oee.tasks.gridworld(4, 0.1)
    log = oee.sample_episodes(grid, oee.tasks.gridworld_expert(4), 30, 9, seed=0)
    ax = Figure().subplots()
    plots.plot_paths(grid, log, ax)
    drawn = middles(ax)
    assert len(drawn) == 20
    starts = np.array([path[0] for path in drawn])
    assert len(np.unique(starts.round(9), axis=0)) == 20
    assert (np.abs(starts - 0.5) < 0.5).all()  # each within its cell
    assert ax.get_xlabel() == "column (the first 20 of 30 paths)"
    ax = Figure().subplots()
    assert plots.plot_paths(grid, [[0, 1], [0, 4]], ax).get_xlabel() == "column"


def test_a_path_goes_on_to_a_state_that_lies_beneath_another():
    places = [(0, 0), (0, 1), (1, 1), (0, 1)]  # the last one is over
    P = np.zeros((4, 1, 4))
    P[np.arange(4), 0, [1, 2, 3, 3]] = 1.0
    mdp = oee.FiniteMDP(P, np.zeros(4), 0, 0.9, layout=places)
    (drawn,) = middles(plots.plot_paths(mdp, [0, 1, 2, 3], Figure().subplots()))
    np.testing.assert_allclose(drawn[-1], [1.5, 0.5])


# ---- two robots

PAIR = oee.tasks.gridworld(4, 0.0), oee.tasks.gridworld(4, 0.5)
EXPERT = oee.tasks.gridworld_expert(4)


def frames(path):
    with Image.open(path) as image:
        shown = []
        for k in range(image.n_frames):
            image.seek(k)
            shown.append(np.asarray(image.convert("RGB")))
        return shown, image.info


def test_two_robots_walk_by_the_seed_in_a_small_file(tmp_path):
    files = [
        plots.animate_two(*PAIR, EXPERT, tmp_path / f"{k}.gif", seed=seed, horizon=12)
        for k, seed in enumerate((1, 1, 2))
    ]
    one, again, other = (file.read_bytes() for file in files)
    assert one == again != other
    assert len(one) <= 1_000_000
    shown, info = frames(files[0])
    assert info["duration"] == 9 * 250  # of the last one, which stands
    assert len(shown) >= 7  # the least number of steps to the goal is 6
    assert all(frame.shape == shown[0].shape for frame in shown)
    assert (shown[0] != shown[-1]).any()
    assert [path.name for path in sorted(tmp_path.iterdir())] == [
        "0.gif",
        "1.gif",
        "2.gif",
    ]


def test_animations_of_a_wide_grid_are_small(tmp_path):
    wide = oee.tasks.gridworld(12, 0.5)
    policy = oee.uniform_policy(wide)
    short, long = (
        plots.animate_two(
            wide, wide, policy, tmp_path / f"{n}.gif", seed=0, horizon=n
        ).stat()
        for n in (10, 30)
    )
    # the longest one has 200 steps
    assert long.st_size + 170 * (long.st_size - short.st_size) / 20 <= 1_000_000


def test_a_missing_pillow_is_named_before_anything_runs(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "PIL" else find(name)
    )
    with pytest.raises(
        ImportError, match=r"pillow is not installed.*pip install pillow"
    ):
        plots.animate_two(*PAIR, EXPERT, tmp_path / "a.gif", seed=0)
    assert not list(tmp_path.iterdir())


def test_an_animation_that_is_too_large_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("oee_tabular.plots.animation.MAX_BYTES", 1000)
    with pytest.raises(ValueError, match="horizon must be small enough for a GIF"):
        plots.animate_two(*PAIR, EXPERT, tmp_path / "a.gif", seed=0, horizon=2)
    assert not list(tmp_path.iterdir())
