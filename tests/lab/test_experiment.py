"""Tests of experiments as data.

They cover cells, streams, the paper's numbers, tables and pages of results, and what a
panel takes from a table.
"""

import itertools
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from lab.noise import bytes_of, experiment
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.lab.experiment import (
    Panels,
    Stream,
    files_of,
    listed,
    percent,
    pipe_table,
    reach,
    set_title,
    share_legend,
    summary_of,
)
from oee_tabular.lab.experiments import catalogue
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.experiments.common import published, published_at

CELL = {"n": 1, "case": "a", "repetition": 3}


def test_cells_are_the_product_of_axes_and_repetitions_in_order():
    own = experiment(
        axes={"n": (1, 2, 3), "case": ("a", "b")}, repetitions=9, smoke={"n": (2, 3)}
    )
    cells = own.settings(repetitions=2).cells()
    assert len(cells) == 12
    assert cells[0] == {"n": 1, "case": "a", "repetition": 0}
    assert cells[1] == {"n": 1, "case": "a", "repetition": 1}
    assert cells[-1] == {"n": 3, "case": "b", "repetition": 1}
    # the first of what is not named, one seed
    smoke = [{"n": n, "case": "a", "repetition": 0} for n in (2, 3)]
    assert own.settings(smoke=True).cells() == smoke
    assert len(own.settings(smoke=True, repetitions=5).cells()) == 10


def test_the_smoke_cells_are_cells_of_the_full_sweep():
    for own in EXPERIMENTS.values():
        full, smoke = (own.settings(smoke=flag).cells() for flag in (False, True))
        assert all(cell in full for cell in smoke)
        assert 0 < len(smoke) <= 8


def test_a_stream_depends_on_the_seed_the_experiment_the_cell_and_the_use():
    cells = [CELL, CELL | {"n": 2}, CELL | {"repetition": 1}]
    streams = [Stream("some", 0, cell) for cell in cells] + [
        Stream("other", 0, CELL),
        Stream("some", 1, CELL),
    ]
    draws = [stream.generator().random(4) for stream in streams]
    draws += [
        streams[0].generator(use=use).random(4) for use in ("rollouts", "simulator")
    ]
    assert len({tuple(draw) for draw in draws}) == 7
    assert_array_equal(
        Stream("some", 0, dict(reversed(CELL.items()))).generator().random(4), draws[0]
    )


def test_named_settings_share_a_stream():
    one, two, other = (
        Stream("some", 0, CELL | change)
        for change in ({}, {"case": "b"}, {"repetition": 4})
    )
    assert_array_equal(one.generator("n").random(3), two.generator("n").random(3))
    assert (one.generator("case").random(3) != two.generator("case").random(3)).all()
    assert (one.generator("n").random(3) != other.generator("n").random(3)).all()


def test_the_stream_is_pinned():
    """Another version must not change the numbers of a saved table silently."""
    stream = Stream(
        "fig1a", 0, {"data": "uniform", "grid": 10, "n": 1000, "repetition": 2}
    )
    assert stream.sequence().spawn_key[-1] == 2
    assert stream.generator().integers(1 << 30, size=3).tolist() == [
        189595970,
        308855473,
        571500491,
    ]


def test_the_papers_numbers():
    points = published("fig1a", "grid=10", "mean_absolute_error_of_zeta")
    assert points.x.tolist() == [1000, 3162, 10000, 31623, 100000, 316228]
    assert published_at(
        "fig1a", "grid=40", "mean_absolute_error_of_zeta", 316228
    ) == pytest.approx(0.0715476503)
    assert np.isnan(
        published_at("fig1a", "grid=20", "mean_absolute_error_of_zeta", 1000)
    )


def test_the_files_of_an_experiment(tmp_path, monkeypatch):
    one = experiment(
        paper=lambda row: 2.0 if row["n"] == 1 else np.nan,
        finding=lambda table: "50 < 60",
    )
    files = bytes_of(tmp_path / "noise", one.settings())
    table = pd.read_csv(tmp_path / "noise" / "table.csv")
    summary = summary_of(one, table)
    assert len(summary) == 6
    values = table[(table.n == 2) & (table["name"] == "third")].value
    row = summary[(summary.n == 2) & (summary["name"] == "third")].iloc[0]
    assert_allclose(
        row[["value_mean", "value_sd"]].tolist(), [values.mean(), values.std(ddof=1)]
    )
    assert_allclose(
        [row["value_se"], row["seeds"]], [values.std(ddof=1) / np.sqrt(2), 2]
    )
    first = summary[summary.n == 1].iloc[0]
    assert_allclose(first["ours / paper"], first["value_mean"] / 2.0)
    assert np.isnan(row["ours / paper"])
    page = files["summary.md"].decode()
    assert page.startswith(
        "# Noise | and more\n\n![50 < 60](figure.png)\n\nNumbers that need BLAS, and"
        " are hard to print."
    )
    assert "`oee reproduce noise --seeds 2` (n 1, 2, 3)" in page
    assert "every seed is in [table.csv](table.csv)." in page
    assert "| 2 | third | 2 |" in page
    assert b"50 &lt; 60" in files["figure.svg"]
    silent = replace(one, finding=lambda table: "")
    other = bytes_of(
        tmp_path / "b", silent.settings(smoke=True, repetitions=1, seed=4)
    )["summary.md"].decode()
    assert "`oee reproduce noise --smoke --seeds 1 --seed 4` (n 1)" in other
    assert "![Noise | and more](figure.png)" in other
    again = files_of(one.settings(), table)
    assert again["figure.svg"] == files["figure.svg"]
    assert again["figure.png"][:4] == b"\x89PNG"
    monkeypatch.setattr(
        catalogue, "EXPERIMENTS", {"noise": one, "other": experiment(id="not there")}
    )
    listing = catalogue.write_index(tmp_path).read_text()
    assert "[Noise | and more](noise/summary.md)" in listing
    assert "not there" not in listing


def test_a_markdown_table():
    frame = pd.DataFrame({"a|b": ["x|y"], "n": [3], "v": [0.123456], "w": [np.nan]})
    assert (
        pipe_table(frame)
        == "| a\\|b | n | v | w |\n|---|---|---|---|\n| x\\|y | 3 | 0.1235 |  |"
    )


@pytest.mark.parametrize(
    "text", ["", "MMMM 0.059 " * 20, "illi, " * 30, "$x^2$, " * 20]
)
def test_a_title_of_any_letters_fits(text):
    figure = Figure(figsize=(9.0, 3.0))
    set_title(figure, text)
    assert (figure._suptitle is None) == (text == "")
    if text:
        box = figure._suptitle.get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1


@pytest.mark.parametrize(
    ("names", "is_shared"),
    [(["abcd", "abd"], True), (["abc", "ab"], False), (["abcd", "xb"], False)],
)
def test_one_legend_for_all_panels(names, is_shared):
    figure = Figure()
    for ax, letters in zip(figure.subplots(1, 2), names, strict=True):
        for letter in letters:
            ax.plot([1, 2], label=letter)
        ax.legend()
    share_legend(figure)
    assert [ax.get_legend() is None for ax in figure.axes] == [is_shared, is_shared]
    texts = [
        text.get_text() for legend in figure.legends for text in legend.get_texts()
    ]
    assert texts == (["a", "b", "c", "d"] if is_shared else [])


@pytest.fixture
def table():
    """Return a table of two cases, two curves, three n and two seeds.

    ``error`` is 8 / n times 1 and 3, ``spread`` the same for both curves.
    """
    sizes = {"first": 1.0, "second": -2.0}
    points = itertools.product((0.5, 0.25), (40, 10, 20), (1, 3), sizes)
    return pd.DataFrame(
        [
            {
                "case": case,
                "n": n,
                "seed": seed,
                "name": name,
                "error": sizes[name] * seed * 8.0 / n,
                "spread": 1.0 / n,
            }
            for case, n, seed, name in points
        ]
    )


def draw(panels, table):
    figure = Figure()
    panels(table, table, figure)
    figure.canvas.draw()
    return figure


def lines(ax):
    return {
        line.get_label(): line
        for line in ax.get_lines()
        if not line.get_label().startswith("_")
    }


def test_a_panel_for_each_group_and_a_point_for_the_mean_of_its_rows(table):
    figure = draw(
        Panels(
            "error", "name", by=("case",), xlabel="n", ylabel="error", size=(3.0, 2.0)
        ),
        table,
    )
    # in the table's order
    assert [ax.get_title() for ax in figure.axes] == ["case = 0.5", "case = 0.25"]
    assert_allclose(figure.get_size_inches(), (6.0, 2.0))
    curves = lines(figure.axes[1])
    assert list(curves) == ["first", "second"]
    assert_array_equal(curves["first"].get_xdata(), [10, 20, 40])
    assert_allclose(curves["first"].get_ydata(), [1.6, 0.8, 0.4])
    assert_allclose(curves["second"].get_ydata(), [-3.2, -1.6, -0.8])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("n", "error")
    assert not figure.axes[0].collections
    edges = (
        draw(Panels("error", "name", bands=True), table)
        .axes[0]
        .collections[0]
        .get_paths()[0]
        .vertices
    )
    # the smallest and the largest row
    assert_allclose([edges[:, 1].min(), edges[:, 1].max()], [8 / 40, 3 * 8 / 10])


def test_findings(table):
    assert listed(pd.Series({"one": 0.0123, "two": 45.6})) == "0.012 (one), 46 (two)"
    assert (reach([0.5, 0.1, 0.3], percent), reach([0.5])) == ("10% to 50%", "0.5")
    panel = Panels("error", "name", ylabel="error")
    assert panel.find(table) == "error at n = 40: -0.8 (second), 0.4 (first)"
    largest = replace(panel, how="max", only=lambda rows: rows[rows.n < 40])
    assert largest.find(table) == "error at n = 20: -0.8 (second), 1.2 (first)"
