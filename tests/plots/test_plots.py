"""Pictures: what they show, what they are labelled with, and how they answer bad input."""

import re

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import oee_tabular as oee
from oee_tabular import plots
from oee_tabular.plots.style import series


@pytest.fixture
def ax():
    """Axes that are rendered at the end of the test; a warning is an error."""
    axes = Figure(layout="constrained").subplots()
    yield axes
    drawn(axes)


def words(ax):
    return [text.get_text() for text in ax.texts]


def drawn(ax):
    ax.figure.canvas.draw()
    return ax


def test_curves_have_bands_truth_and_labels(ax):
    x = np.linspace(0, 1, 5)
    bands = {"oee": (x - 0.1, x + 0.1)}
    assert (
        plots.plot_curves(
            x,
            {"oee": x, "model": x**2},
            ax,
            bands=bands,
            truth=0.5,
            xlabel="delta",
            ylabel="J",
        )
        is ax
    )
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("delta", "J")
    assert [t.get_text() for t in ax.get_legend().get_texts()] == [
        "oee",
        "model",
        "true value",
    ]
    for look in ("marker", "linestyle", "color"):
        assert pyplot.getp(ax.get_lines()[0], look) != pyplot.getp(
            ax.get_lines()[1], look
        )
    assert len(ax.collections) == 1


def test_errors_are_logarithmic_with_a_slope(ax):
    n = np.array([100.0, 1000.0, 10_000.0])
    plots.plot_errors(n, {"oee": 3 / np.sqrt(n), "none left": [1.0, 0.0, np.nan]}, ax)
    assert ax.get_xscale() == ax.get_yscale() == "log"
    slope = next(line for line in ax.get_lines() if line.get_label() == "slope -0.5")
    np.testing.assert_allclose(slope.get_ydata(), 3 / np.sqrt(n))
    late = plots.plot_errors(
        n, {"none at first": [np.nan, 0.3, 0.2]}, Figure().subplots()
    ).get_lines()[-1]
    np.testing.assert_allclose(late.get_ydata(), 0.3 * np.sqrt(1000.0 / n))
    assert ax.get_ylabel() == "mean L1 error"
    assert (
        len(
            plots.plot_errors(
                [10.0], {"a": [1.0]}, Figure().subplots(), slope=None
            ).get_lines()
        )
        == 1
    )


def labels(ax):
    """What stands beside the lines, from the top."""
    ticks = sorted(
        zip(
            ax.get_yticks(),
            [label.get_text() for label in ax.get_yticklabels()],
            strict=True,
        )
    )
    assert ax.get_ylim()[0] > ax.get_ylim()[1]
    return [text for _, text in ticks]


def test_intervals_are_a_forest(ax):
    plots.plot_intervals(
        ["first", "wild", "lost", "sure"],
        [1.0, 9e9, np.nan, np.nan],
        [0.5, 8e9, np.nan, 0.2],
        [1.5, 1e10, np.nan, 1.8],
        ax,
        truth=1.1,
        limits=(0.0, 2.0),
        title="The log knows little",
    )
    assert labels(ax) == ["", "first", "wild", "lost", "sure"]
    assert words(ax) == ["9e+09", "no value", "true value 1.1"]
    assert ax.get_xlim() == (0.0, 2.0)
    assert any(np.array_equal(line.get_xdata(), [0.5, 1.5]) for line in ax.get_lines())
    assert any(np.array_equal(line.get_xdata(), [0.2, 1.8]) for line in ax.get_lines())
    assert "discounted sum" in ax.get_xlabel()
    assert ax.get_title() == "The log knows little"


def test_values_stand_by_policy_and_outliers_at_the_edge(ax):
    names = ("policy", "estimator", "value", "lower", "upper", "true_value")
    rows = [
        ("trained policy", "simulator", 5.0, None, None, 3.0),
        ("old policy", "oee", 1.0, 0.5, 1.5, None),
        ("trained policy", "oee", 3.2, 2.8, 3.6, 3.0),
        ("trained policy", "ratio-of-ratios", -3.5e34, -9e34, 1e34, 3.0),
        ("old policy", "pdis", 900.0, None, None, None),
        ("old policy", "mine", np.nan, None, None, None),
    ]
    rows = [dict(zip(names, row, strict=True)) for row in rows]
    plots.plot_values(rows, ax, title="One " * 30, unit="sum of rewards")
    assert labels(ax)[:4] == ["trained policy", "simulator", "oee", "ratio-of-ratios"]
    assert labels(ax)[4:] == ["old policy", "oee", "pdis", "mine"]
    assert words(ax) == ["−3.5e+34", "900", "no value", "true value 3"]
    # what intervals, truth and simulator span
    assert ax.get_xlim() == pytest.approx((0.5 - 0.27, 5.0 + 0.27))
    (truth,) = (
        line for line in ax.get_lines() if np.array_equal(line.get_xdata(), [3.0, 3.0])
    )
    # not through the others
    assert (
        ax.get_yticks()[ax.get_yticks().tolist().index(3)] < truth.get_ydata()[1] < 4.0
    )
    marks = {
        line.get_color()
        for line in ax.get_lines()
        if line.get_marker() == series(1)["marker"]
    }
    assert marks == {series(1)["color"]}  # an estimator looks alike everywhere
    assert ax.get_xlabel() == "value in the target: sum of rewards"
    assert ax.get_title().count("\n") > 0


@pytest.mark.parametrize(
    ("value", "low", "high", "ends"),
    [
        ([1.0], [0.0], [2.0], (0.0, 2.0)),
        ([3.0], [np.nan], [np.nan], (3.0, 3.0)),
        ([3.0, 3.0], [3.0, np.nan], [3.0, np.nan], (3.0, 3.0)),
        ([0.0], [0.0], [0.0], (0.0, 0.0)),
        ([np.nan], [np.nan], [7.0], (7.0, 7.0)),
        ([1.0, 1.1, -1e300], [np.nan] * 3, [np.nan] * 3, (1.0, 1.1)),
        ([1.0, 1.1, 90.0], [0.9, 1.0, -1e300], [1.1, 1.2, 1e300], (0.9, 1.2)),
        ([1.0, 1.1, 4.0], [0.9, 1.0, np.nan], [1.1, 1.2, np.nan], (0.9, 4.0)),
    ],
)
def test_the_axis_is_that_of_the_intervals(value, low, high, ends, ax):
    left, right = plots.plot_intervals(
        [str(k) for k in range(len(value))], value, low, high, ax
    ).get_xlim()
    assert left < ends[0] <= ends[1] < right
    assert right - left <= max(
        1.2 * (ends[1] - ends[0]), 0.01 * abs(ends[0])
    ) or ends == (0.0, 0.0)


def test_a_grid_is_drawn_as_it_is_numbered(ax):
    plots.plot_grid(
        np.arange(6.0),
        (2, 3),
        ax,
        label="J (reward)",
        text=list("abcdef"),
        crossed=[0, 0, 0, 0, 1, 0],
    )
    mesh = ax.collections[0]
    np.testing.assert_array_equal(mesh.get_array(), [[0, 1, 2], [3, 4, 5]])
    assert ax.get_ylim() == (2, 0)  # row 0 on top
    assert words(ax) == list("abcdef")
    assert [text.get_color() for text in ax.texts] == ["#ffffff"] * 3 + ["#000000"] * 3
    assert ax.get_lines()[0].get_xydata().tolist() == [[1.5, 1.5]]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("column", "row")
    assert ax.figure.axes[1].get_ylabel() == "J (reward)"


def test_large_grids_are_images_and_carry_no_words():
    def draw(ax):
        plots.plot_grid(np.arange(2500.0), (50, 50), ax, label="x", text=["w"] * 2500)
        assert not ax.texts

    text = plots.figure_svg(draw, name="m", title="t", description="d")
    assert "data:image/png;base64" in text
    assert text.count("<path") < 200


def test_ratios_are_centred_on_one(ax):
    plots.plot_ratio([0.5, 1.0, 4.0, np.nan], (2, 2), ax)
    norm = ax.collections[0].norm
    assert norm.vmin * norm.vmax == pytest.approx(1.0)
    assert words(ax) == ["0.5", "1", "4"]
    assert [t.get_text() for t in ax.figure.axes[1].get_yticklabels()] == [
        "0.25",
        "0.5",
        "1",
        "2",
        "4",
    ]
    even = plots.plot_ratio(np.ones(4), (2, 2), Figure().subplots())
    assert even.collections[0].norm.vmax == 2.0
    nothing = plots.plot_ratio(
        [0.0, np.nan, np.nan, np.nan], (2, 2), Figure().subplots()
    )
    assert nothing.collections[0].norm.vmax == 2.0


def test_coverage_crosses_out_what_was_never_recorded(ax):
    plots.plot_coverage(
        [[1, 999], [0, 0], [3, 0], [0, 0]], (2, 2), ax, over=[False, False, False, True]
    )
    assert words(ax) == ["1k", "3", "end"]
    assert ax.get_lines()[0].get_xydata().tolist() == [[1.5, 0.5]]
    assert [t.get_text() for t in ax.figure.axes[1].get_yticklabels()] == [
        "1",
        "10",
        "100",
        "1000",
    ]
    drawn(plots.plot_coverage(np.zeros(4), (2, 2), Figure().subplots()))


def test_occupancy_is_in_percent(ax):
    plots.plot_occupancy(
        [0.5, 0.4996, 0.0004, 0.0],
        (2, 2),
        ax,
        unrecorded=[0, 1, 0, 0],
        over=[0, 0, 0, 1],
    )
    assert words(ax) == ["50", "end"]  # a crossed state has no number under its cross
    assert "%" in ax.figure.axes[1].get_ylabel()
    drawn(plots.plot_occupancy(np.zeros(4), (2, 2), Figure().subplots()))


def test_states_are_ranked(ax):
    time = [[0.1, 0], [0.3, 0.3], [0, 0], [0.15, 0.15]]
    plots.plot_states(time, [[5, 0], [0, 0], [0, 0], [12345, 0]], ax)
    assert labels(ax) == ["state 1", "state 3", "state 0"]
    assert words(ax) == ["none recorded", "12\u202f345 recorded", "5 recorded"]
    widths = [bar.get_width() for bar in ax.patches]
    np.testing.assert_allclose(widths, [0, 15, 10, 60, 15, np.nan], atol=1e-9)
    one = plots.plot_states(
        [0.1, 0.6], [1, 1], Figure().subplots(), top=1, names=["$a", "b$"]
    )
    assert labels(one) == ["b$"]
    drawn(plots.plot_states(np.zeros(3), np.zeros(3), Figure().subplots()))


ROW = {
    "policy": "p",
    "estimator": "oee",
    "value": 1.0,
    "lower": 0.5,
    "upper": 1.5,
    "true_value": None,
}
CALLS = [
    lambda ax: plots.plot_curves([0, 1], {"a": [1, 2]}, ax),
    lambda ax: plots.plot_errors([1, 2], {"a": [1, 2]}, ax),
    lambda ax: plots.plot_variance_growth({"a": [1, 2]}, ax),
    lambda ax: plots.plot_intervals(["a"], [1], [0], [2], ax),
    lambda ax: plots.plot_values([ROW], ax),
    lambda ax: plots.plot_states([1], [1], ax),
    lambda ax: plots.plot_grid([1, 2], (1, 2), ax, label="x"),
    lambda ax: plots.plot_ratio([1, 2], (1, 2), ax),
    lambda ax: plots.plot_coverage([1, 2], (1, 2), ax),
    lambda ax: plots.plot_occupancy([0, 1], (1, 2), ax),
]


@pytest.mark.parametrize("call", CALLS)
def test_every_plot_makes_axes_where_it_is_given_none(call, ax):
    assert call(ax) is ax
    own = call(None)
    drawn(own)
    pyplot.close(own.figure)
    with pytest.raises(
        ValueError, match="ax must be matplotlib Axes, or None for new ones; got 'left'"
    ):
        call("left")


def test_results_draw_themselves(ax):
    pair = oee.testing.case("ragged")
    problem = pair.problem(1000, seed=0)
    policies = {"new": pair.policy, "recorded": pair.behavior}
    interval = oee.interval(problem, pair.policy)
    assert interval.plot(ax) is ax
    assert ax.get_title() == str(interval).replace("sum ", "sum\n")
    compared = oee.inference.compare_policies(problem, policies).plot(
        Figure().subplots()
    )
    assert labels(compared) == ["", "recorded less new"]
    assert (words(compared), compared.get_title()) == (
        ["no difference: 0"],
        "“new” is worth most",
    )
    plan = oee.plan_data_collection(problem, pair.policy, n=1000).plot(
        Figure().subplots()
    )
    assert labels(plan) == ["state 0", "state 1", "state 2"]
    report = oee.evaluate(problem, policies, seed=0)
    values = report.plot(Figure().subplots())
    assert labels(values)[:2] == ["new", "simulator"]
    assert " ".join(values.get_title().split()) == report.headline
    assert len(labels(report.plot(Figure().subplots(), all=True))) == 2 + len(
        report.results
    )


@pytest.mark.parametrize("name", ["$x$ and $y", "\\frac{", "a\x00b", "<b>&", "x" * 200])
def test_names_are_only_text(name):
    def draw(ax):
        plots.plot_intervals([name], [1.0], [0.0], [2.0], ax)
        return ax

    text = plots.figure_svg(draw, name="p", title=name, description=name)
    assert "<b>" not in text
    ax = Figure().subplots()
    plots.plot_curves([0, 1], {name: [0, 1]}, ax)


def test_an_svg_fits_into_a_page():
    def draw(ax):
        return plots.plot_intervals(["a", "b"], [1.0, 2.0], [0.5, 1.5], [1.5, 2.5], ax)

    texts = {"title": "A <title>", "description": "what & where"}
    one, again, two = (
        plots.figure_svg(draw, name=name, **texts) for name in ("one", "one", "two")
    )
    assert one == again
    assert plots.figure_png(draw) == plots.figure_png(draw)
    assert one.startswith("<svg")
    assert one.endswith("</svg>")
    for part in (
        'role="img" aria-labelledby="one-title one-desc"',
        "A &lt;title&gt;",
        "var(--ink, #1b1f23)",
        "var(--series-0, #0072b2)",
    ):
        assert part in one
    assert "width=" not in one[: one.index(">")]
    for gone in ("<?xml", "DOCTYPE", "metadata", "<style", "<!--"):
        assert gone not in one
    ids = re.findall(r' id="([^"]*)', one + two)
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize(
    ("make", "shape"),
    [
        (lambda: oee.tasks.gridworld(2, 0.1), (2, 2)),
        (lambda: oee.tasks.gridworld(7, 0.0), (7, 7)),
        (lambda: oee.tasks.toy_text("FrozenLake-v1", map_name="8x8"), (8, 8)),
        (lambda: oee.tasks.toy_text("CliffWalking-v1"), (4, 12)),
        (lambda: oee.tasks.toy_text("Taxi-v4"), None),
        (lambda: oee.FiniteMDP(np.eye(3)[:, None], np.zeros(3), [1, 0, 0], 0.9), None),
        (lambda: walk([1, 2, 3, 4, 5, 5]), None),  # a line
        # 2 to 3 would step around the edge of width 3; 1 to 2 does not
        (lambda: walk([3, 2, 5, 4, 5, 5]), None),
    ],
)
def test_grids_are_found_from_the_transitions(make, shape):
    assert plots.detect_grid(make()) == shape


def walk(following):
    n = len(following)
    transitions = np.zeros((n, 1, n))
    transitions[np.arange(n), 0, following] = 1.0
    if following[0] == 3:
        transitions[2, 0] = [0, 0, 0, 1.0, 0, 0]  # row 0, column 2 to row 1, column 0
    return oee.FiniteMDP(transitions, np.zeros(n), np.eye(n)[0], 0.9)


def test_names_stand_at_the_ends_of_lines(ax):
    x = np.arange(4.0)
    plots.plot_curves(
        x,
        {
            "high": 3 * x,
            "low $1": x,
            "gone": [1.0, 5.0, np.nan, np.nan],
            "none": np.full(4, np.nan),
        },
        ax,
    )
    plots.label_ends(ax)
    assert ax.get_legend() is None
    assert words(ax) == ["high", "low $1", "gone"]
    heights = ax.transAxes.inverted().transform(
        ax.transData.transform([(0, 9.0), (0, 3.0), (0, 5.0)])
    )[:, 1]
    np.testing.assert_allclose([text.get_position()[1] for text in ax.texts], heights)
    assert [text.get_color() for text in ax.texts] == [
        line.get_color() for line in ax.get_lines()[:3]
    ]


def test_names_do_not_overlap(ax):
    plots.plot_curves(
        [0.0, 1.0], {f"curve {k}": [0.0, 1.0 + 1e-3 * k] for k in range(5)}, ax
    )
    ax.set_ylim(0.0, 2.0)
    drawn(plots.label_ends(ax))
    boxes = [text.get_window_extent() for text in ax.texts]
    assert all(
        below.y1 <= above.y0 for below, above in zip(boxes[:-1], boxes[1:], strict=True)
    )
    middle = np.mean([text.get_position()[1] for text in ax.texts])
    # moved no further than it takes: as far up as down
    assert abs(middle - 0.501) < 1e-6


# ---- maps of worlds that are no square grids: cells at their places, blank where no
# state is; by layout, names or moves a corridor around a wall: (1, 0) is none
ROOMS = [(0, 0), (0, 1), (1, 1), (2, 1), (2, 0)]
STEP = 0.25


def corridor(names=ROOMS, **options):
    """One goes on along the corridor, or back; the last room is the end."""
    n = len(names)
    transitions = np.zeros((n, 2, n))
    for s in range(n - 1):
        transitions[s, 0, s + 1] = transitions[s, 1, max(s - 1, 0)] = 0.9
        transitions[s, :, s] += 0.1
    transitions[n - 1, :, n - 1] = 1.0
    return oee.FiniteMDP(
        transitions, np.eye(n)[n - 2], 0, 0.9, state_names=names, **options
    )


def cells(ax):
    return np.ma.filled(ax.collections[0].get_array(), np.nan).reshape(-1)


def words_at(ax):
    return {
        (text.get_position()[1] - 0.5, text.get_position()[0] - 0.5): text.get_text()
        for text in ax.texts
    }


def test_rooms_are_at_their_places_and_walls_are_blank(ax):
    found = plots.map_of(corridor())
    assert found.shape == (3, 2)
    plots.plot_grid(
        [1.0, 2.0, 3.0, 4.0, 5.0],
        found,
        ax,
        label="x",
        text=list("abcde"),
        crossed=[0, 0, 0, 1, 0],
    )
    np.testing.assert_array_equal(cells(ax), [1, 2, np.nan, 3, 5, 4])
    assert words_at(ax) == {
        (0, 0): "a",
        (0, 1): "b",
        (1, 1): "c",
        (2, 1): "d",
        (2, 0): "e",
    }
    assert ax.get_lines()[0].get_xydata().tolist() == [[1.5, 2.5]]


def test_every_map_takes_it():
    found = plots.map_of(corridor())
    over = [0, 0, 0, 0, 1]
    seen = plots.plot_coverage(
        [[1, 1], [3, 0], [0, 0], [7, 0], [0, 0]], found, Figure().subplots(), over=over
    )
    assert words_at(seen) == {(0, 0): "2", (0, 1): "3", (2, 1): "7", (2, 0): "end"}
    assert seen.get_lines()[0].get_xydata().tolist() == [[1.5, 1.5]]
    time = plots.plot_occupancy(
        [0.5, 0.25, 0.25, 0, 0], found, Figure().subplots(), over=over
    )
    assert words_at(time) == {(0, 0): "50", (0, 1): "25", (1, 1): "25", (2, 0): "end"}
    ratio = plots.plot_ratio([1, 2, 0.5, np.nan, 4], found, Figure().subplots())
    assert words_at(ratio) == {(0, 0): "1", (0, 1): "2", (1, 1): "0.5", (2, 0): "4"}
    with pytest.raises(
        ValueError, match="values must have 5 entries, one a cell of the grid; it has 6"
    ):
        plots.plot_grid(np.zeros(6), found, Figure().subplots(), label="x")


def test_axes_speak_the_layouts_units(ax):
    found = plots.map_of(corridor(layout=STEP * np.array(ROOMS) - [3, 0]))
    assert found.rows == (-3.0, -2.75, -2.5)
    assert found.place(3) == (-2.5, 0.25)
    plots.plot_grid(np.arange(5.0), found, ax, label="x")
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        "-3",
        "-2.75",
        "-2.5",
    ]


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
    drawn = plots.plot_occupancy(
        [0.3, 0.3, 0.4, 0, 0], found, Figure().subplots(), over=[0, 0, 0, 0, 1]
    )
    assert words_at(drawn) == {(0, 0): "30", (0, 1): "30", (1, 1): "40"}


@pytest.mark.parametrize(("value", "marker"), [(-50.0, "<"), (50.0, ">")])
def test_a_value_outside_is_an_arrow_that_points_to_it(value, marker):
    ax = plots.plot_intervals(
        ["in", "out"], [0.0, value], [-1.0, np.nan], [1.0, np.nan], limits=(-2.0, 2.0)
    )
    arrows = [line.get_marker() for line in ax.get_lines()]
    assert marker in arrows
    pyplot.close(ax.figure)
