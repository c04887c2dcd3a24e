"""Figures as data: what a panel takes from a table, and where panels stand."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.lab.panels import SIZE, Beside, Errors, Panels


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


def drawn(figure_of, table):
    figure = Figure()
    figure_of(table, table, figure)
    figure.canvas.draw()
    return figure


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines() if not line.get_label().startswith("_")}


def test_a_panel_for_each_group_and_a_point_for_the_mean_of_its_rows(table):
    figure = drawn(Panels("error", "name", by=("case",), xlabel="moves", ylabel="error", size=(3.0, 2.0)), table)
    assert [ax.get_title() for ax in figure.axes] == ["case = 0.5", "case = 0.25"]  # in the table's order
    assert_allclose(figure.get_size_inches(), (6.0, 2.0))
    found = lines(figure.axes[1])
    assert list(found) == ["first", "second"]
    assert_array_equal(found["first"].get_xdata(), [10, 20, 40])
    assert_allclose(found["first"].get_ydata(), [1.6, 0.8, 0.4])
    assert_allclose(found["second"].get_ydata(), [-3.2, -1.6, -0.8])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("moves", "error")
    assert not figure.axes[0].collections


def test_bands_are_the_smallest_and_the_largest_row(table):
    ax = drawn(Panels("error", "name", bands=True), table).axes[0]
    edges = ax.collections[0].get_paths()[0].vertices
    assert_allclose([edges[:, 1].min(), edges[:, 1].max()], [8 / 40, 3 * 8 / 10])


def test_another_statistic_other_rows_further_curves_and_what_is_too_small(table):
    panel = Panels(
        "error", "name", how=np.max, only=lambda rows: rows[rows.n > 10], extra={"spread": "spread"}, least=0.1,
        also=lambda rows: {"flat": pd.Series({20: 5.0, 80: 6.0})},
    )  # fmt: skip
    found = lines(drawn(panel, table).axes[0])
    assert list(found) == ["first", "flat"]  # the second is negative, the spread at most 0.05
    assert_array_equal(found["first"].get_xdata(), [20, 40])
    assert_allclose(found["first"].get_ydata(), [1.2, 0.6])
    assert_array_equal(found["flat"].get_ydata(), [5.0, np.nan])


def test_a_logarithmic_axis_leaves_out_what_is_not_positive(table):
    mixed = table.assign(error=table.error.where(table.n != 20, 0.0))
    ax = drawn(Panels("error", "name", log=True, axes={"ylim": (0.01, 10.0)}), mixed).axes[0]
    assert (ax.get_yscale(), ax.get_xscale(), ax.get_ylim()) == ("log", "linear", (0.01, 10.0))
    assert_array_equal(np.isnan(lines(ax)["first"].get_ydata()), [False, True, False])
    assert np.isnan(lines(ax)["second"].get_ydata()).all()


def test_what_stands_beneath_is_told_the_rows(table):
    def beneath(ax, rows):
        ax.axvline(rows.case.iloc[0], label="case")

    figure = drawn(Panels("error", "name", by=("case",), beneath=beneath), table)
    assert [lines(ax)["case"].get_xdata()[0] for ax in figure.axes] == [0.5, 0.25]


def test_errors_are_logarithmic_with_a_slope(table):
    own = table[table.name == "first"]
    plain, sloped = (drawn(Errors("error", "name", slope=slope), own).axes[0] for slope in (None, -1.0))
    assert plain.get_xscale() == plain.get_yscale() == "log"
    assert list(lines(plain)) == ["first"]
    assert_allclose(lines(sloped)["slope -1"].get_ydata(), lines(sloped)["first"].get_ydata())


def test_the_title_says_which_error_ends_lowest(table):
    table = table.assign(error=table.error.abs())
    axes = drawn(Errors("error", "name", by=("case",)), table).axes
    for ax, case in zip(axes, (0.5, 0.25), strict=True):
        ends = {name: line.get_ydata()[-1] for name, line in lines(ax).items()}
        best = min(ends, key=ends.get)
        assert ax.get_title() == f"case = {case:g}\n{best} ends lowest: {ends[best]:.2g}"
    assert drawn(Errors("error", "name", by=("case",), lowest=False), table).axes[0].get_title() == "case = 0.5"
    alone = drawn(Errors("error", "name", by=("case",)), table[table.name == "first"])
    assert alone.axes[0].get_title() == "case = 0.5"  # nothing to compare it with


def test_panels_beside_each_other(table):
    both = [Panels("error", "name", title="{case:g}: error"), Panels("spread", "name", title="spread at {case}")]
    figure = drawn(Beside(both, by=("case",), columns=2), table)
    assert [ax.get_title() for ax in figure.axes] == ["0.5: error", "spread at 0.5", "0.25: error", "spread at 0.25"]
    assert_allclose(figure.get_size_inches(), (2 * SIZE[0], 2 * SIZE[1]))
    assert_allclose(lines(figure.axes[1])["first"].get_ydata(), [0.1, 0.05, 0.025])
    three = drawn(Beside([*both, both[0]], by=("case",), columns=4), table)
    assert [ax.get_visible() for ax in three.axes] == [True] * 6 + [False] * 2
