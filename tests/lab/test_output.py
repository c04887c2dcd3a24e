"""Tables and pages of results, and figures as data: what a panel takes from a table, and where panels stand."""

import numpy as np
import pandas as pd
import pytest
from lab.noise import bytes_of, experiment
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.lab.output import figures, index, pipe_table, summary_of
from oee_tabular.lab.panels import SIZE, Beside, Errors, Panels, Ranges


def test_the_summary_has_mean_sd_and_standard_error(tmp_path):
    one = experiment(paper=lambda summary: [2.0 if n == 1 else np.nan for n in summary.n])
    files = bytes_of(tmp_path / "noise", one.settings())
    table = pd.read_csv(tmp_path / "noise" / "table.csv")
    summary = summary_of(one, table)
    assert len(summary) == 6
    values = table[(table.n == 2) & (table["name"] == "third")].value
    row = summary[(summary.n == 2) & (summary["name"] == "third")].iloc[0]
    assert_allclose(row[["value_mean", "value_sd"]].tolist(), [values.mean(), values.std(ddof=1)])
    assert_allclose([row["value_se"], row["seeds"]], [values.std(ddof=1) / np.sqrt(2), 2])
    first = summary[summary.n == 1].iloc[0]
    assert_allclose(first["ours / paper"], first["value_mean"] / 2.0)
    assert np.isnan(row["ours / paper"])
    page = files["summary.md"].decode()
    assert "`oee reproduce noise`, 2 seeds a cell (n 1, 2, 3)" in page
    assert "| 2 | third | 2 |" in page
    other = bytes_of(tmp_path / "b", one.settings(repetitions=1, seed=4))["summary.md"].decode()
    assert "`oee reproduce noise --seeds 1 --seed 4`, 1 seeds" in other
    again = figures(one, table, summary)
    assert again["figure.svg"] == files["figure.svg"]
    assert again["figure.png"][:4] == b"\x89PNG"
    listing = index(tmp_path, [one, experiment(id="not there")]).read_text()
    assert "[Noise | and more](noise/summary.md)" in listing
    assert "not there" not in listing


def test_a_markdown_table():
    frame = pd.DataFrame({"a|b": ["x|y"], "n": [3], "v": [0.123456], "w": [np.nan]})
    assert pipe_table(frame) == "| a\\|b | n | v | w |\n|---|---|---|---|\n| x\\|y | 3 | 0.1235 |  |"


@pytest.fixture
def table():
    """Two cases, two curves, three n, two seeds; ``error`` = 8 / n times 1 and 3, ``spread`` the same for both curves."""
    return pd.DataFrame(
        [
            {"case": case, "n": n, "seed": seed, "name": name, "error": size * seed * 8.0 / n, "spread": 1.0 / n}
            for case in (0.5, 0.25)
            for n in (40, 10, 20)
            for seed in (1, 3)
            for name, size in (("first", 1.0), ("second", -2.0))
        ]
    )


def draw(panels, table):
    figure = Figure()
    panels(table, table, figure)
    figure.canvas.draw()
    return figure


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


def test_a_panel_for_each_group_and_a_point_for_the_mean_of_its_rows(table):
    figure = draw(Panels("error", "name", by=("case",), xlabel="n", ylabel="error", size=(3.0, 2.0)), table)
    assert [ax.get_title() for ax in figure.axes] == ["case = 0.5", "case = 0.25"]  # in the table's order
    assert_allclose(figure.get_size_inches(), (6.0, 2.0))
    curves = lines(figure.axes[1])
    assert list(curves) == ["first", "second"]
    assert_array_equal(curves["first"].get_xdata(), [10, 20, 40])
    assert_allclose(curves["first"].get_ydata(), [1.6, 0.8, 0.4])
    assert_allclose(curves["second"].get_ydata(), [-3.2, -1.6, -0.8])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("n", "error")
    assert not figure.axes[0].collections
    edges = draw(Panels("error", "name", bands=True), table).axes[0].collections[0].get_paths()[0].vertices
    assert_allclose([edges[:, 1].min(), edges[:, 1].max()], [8 / 40, 3 * 8 / 10])  # the smallest and the largest row


def test_another_statistic_other_rows_further_curves_and_what_is_too_small(table):
    panel = Panels(
        "error", "name", how=np.max, only=lambda rows: rows[rows.n > 10], extra={"spread": "spread"}, least=0.1,
        also=lambda rows: {"flat": pd.Series({20: 5.0, 80: 6.0})}, beneath=lambda ax, rows: ax.axvline(rows.n.min(), label="n"),
    )  # fmt: skip
    curves = lines(draw(panel, table).axes[0])
    assert list(curves) == ["n", "first", "flat"]  # the second is negative, the spread at most 0.05
    assert_array_equal(curves["first"].get_xdata(), [20, 40])
    assert_allclose(curves["first"].get_ydata(), [1.2, 0.6])
    assert_array_equal(curves["flat"].get_ydata(), [5.0, np.nan])
    assert curves["n"].get_xdata()[0] == 20


def test_a_logarithmic_axis_leaves_out_what_is_not_positive(table):
    mixed = table.assign(error=table.error.where(table.n != 20, 0.0))
    ax = draw(Panels("error", "name", log=True, axes={"ylim": (0.01, 10.0)}), mixed).axes[0]
    assert (ax.get_yscale(), ax.get_xscale(), ax.get_ylim()) == ("log", "linear", (0.01, 10.0))
    assert_array_equal(np.isnan(lines(ax)["first"].get_ydata()), [False, True, False])
    assert np.isnan(lines(ax)["second"].get_ydata()).all()


def test_errors_are_logarithmic_with_a_slope_and_the_title_says_which_ends_lowest(table):
    own = table[table.name == "first"]
    plain, sloped = (draw(Errors("error", "name", slope=slope), own).axes[0] for slope in (None, -1.0))
    assert plain.get_xscale() == plain.get_yscale() == "log"
    assert list(lines(plain)) == ["first"]
    assert_allclose(lines(sloped)["slope -1"].get_ydata(), lines(sloped)["first"].get_ydata())
    both = table.assign(error=table.error.abs())
    for ax, case in zip(draw(Errors("error", "name", by=("case",)), both).axes, (0.5, 0.25), strict=True):
        assert ax.get_title() == f"case = {case:g}\nfirst ends lowest: 0.4"
    assert draw(Errors("error", "name", by=("case",), lowest=False), both).axes[0].get_title() == "case = 0.5"
    assert draw(Errors("error", "name", by=("case",)), own).axes[0].get_title() == "case = 0.5"  # nothing to compare


def test_ranges_are_means_with_their_standard_errors(table):
    ax = draw(Beside([Ranges("error", "name", "case", title="all", beside="spread", mark=0.95)]), table).axes[0]
    (points, _, (bars,)) = ax.containers[0]
    own = table[(table.name == "first") & (table.case == 0.5)].error
    assert_allclose(points.get_xdata()[0], own.mean())
    ends = bars.get_segments()[0][:, 0]
    assert_allclose(ends, own.mean() + 1.96 * own.sem() * np.array([-1, 1]))
    assert_allclose(lines(ax)["spread"].get_xdata(), table.spread.mean())
    assert [text.get_text() for text in ax.get_yticklabels()] == ["first", "second"]


def test_panels_beside_each_other(table):
    both = [Panels("error", "name", title="{case:g}: error"), Panels("spread", "name", title="spread at {case}")]
    figure = draw(Beside(both, by=("case",), columns=2), table)
    assert [ax.get_title() for ax in figure.axes] == ["0.5: error", "spread at 0.5", "0.25: error", "spread at 0.25"]
    assert_allclose(figure.get_size_inches(), (2 * SIZE[0], 2 * SIZE[1]))
    assert_allclose(lines(figure.axes[1])["first"].get_ydata(), [0.1, 0.05, 0.025])
    three = draw(Beside([*both, both[0]], by=("case",), columns=4), table)
    assert [ax.get_visible() for ax in three.axes] == [True] * 6 + [False] * 2
