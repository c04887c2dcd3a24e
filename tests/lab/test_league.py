"""The league's numbers, by hand on small tables, and by another route; its page, files and pictures."""

import math

import numpy as np
import pandas as pd
import pytest

from oee_tabular.lab.bench.league import league_of
from oee_tabular.lab.bench.scores import N_RESAMPLES, geometric_mean, resamples

ML, SIM = "maximum-likelihood", "simulator"


def rows(family, size, errors, *, identical=False, covered=1.0, bound=0.01, half=None, status="ok", families="held"):
    """Rows of one cell: estimator -> errors of its seeds; ``half``: estimator -> half an interval's width."""
    found = []
    for name, values in errors.items():
        for seed, error in enumerate(values):
            value, wide = 5.0 + error, (half or {}).get(name, math.nan)
            found.append(
                {"family": family, "families": families, "size": float(size), "seed": seed, "estimator": name,
                 "value": value, "error": error, "truth": 5.0, "standard_error": wide / 4, "lower": value - wide,
                 "upper": value + wide, "seconds": 0.5 + seed, "covered": covered,
                 "bound": bound, "identical": identical, "status": status}
            )  # fmt: skip
    return found


def league(*parts):
    return league_of(pd.DataFrame([row for part in parts for row in part]))


def cell(found, family, size, estimator="mine"):
    cells = found.cells
    return cells[(cells.family == family) & (cells["size"] == size) & (cells.estimator == estimator)].iloc[0]


def row(found, estimator="mine"):
    return found.league.query("families == 'held'").set_index("estimator").loc[estimator]


def test_ratios_geometric_mean_and_worst_by_hand():
    found = league(
        rows("a", 1, {ML: [1, -1], SIM: [3, 3], "mine": [0.25, 0.25]}),
        rows("b", 3, {ML: [4, 4], SIM: [2, 2], "mine": [8, -8]}),
        rows("c", 3, {ML: [3, 5], SIM: [10, 10], "mine": [1, 7]}),
        rows("same", 3, {ML: [1, 1], SIM: [0, 0], "mine": [0.5, 0.5]}, identical=True, families="tuned", bound=0.25),
    )
    assert cell(found, "a", 1)["ratio"] == 0.25
    assert cell(found, "b", 3)["ratio"] == 4.0  # over the simulator's, the better one
    np.testing.assert_allclose(cell(found, "c", 3)["ratio"], math.sqrt(25 / 17), rtol=1e-12)
    same = cell(found, "same", 3)
    assert (same["ratio"], same["b"], same["floor"], same["over_likelihood"]) == (2.0, 0.0, 1.009, 0.5)  # over eff / 2
    mine = row(found)
    np.testing.assert_allclose(mine["over reference"], (0.25 * 4 * math.sqrt(25 / 17)) ** (1 / 3), rtol=1e-12)
    assert (mine["cells"], mine["worst"], mine["worst cell"], mine["floor"]) == (3, 4.0, "b at 3", 1.224)
    np.testing.assert_allclose(mine["over likelihood"], (0.25 * 2 * math.sqrt(25 / 17)) ** (1 / 3), rtol=1e-12)
    assert cell(found, "a", 1)["over_eff"] == 2.5  # .25 over sqrt(.01)
    assert found.league[["estimator", "families"]].values.tolist() == [
        [name, kind] for kind in ("held", "tuned") for name in (ML, SIM, "mine")
    ]
    assert cell(found, "a", 1)["seconds"] == 1.0
    assert cell(found, "c", 3)["bias"] == 4.0


def test_the_bootstrap_is_paired_and_of_the_seeds():
    rng = np.random.default_rng(0)
    own, likelihood, simulator = rng.normal(size=(3, 12)) * [[1.4], [1.0], [1.2]]
    found = cell(league(rows("a", 3, {ML: likelihood, SIM: simulator, "mine": own})), "a", 3)
    picks = np.random.default_rng(1).integers(12, size=(40_000, 12))  # by another route
    one, two, three = (np.sqrt((errors[picks] ** 2).mean(axis=1)) for errors in (own, likelihood, simulator))
    np.testing.assert_allclose(found["low"], np.quantile(one / np.minimum(two, three), 0.05), rtol=0.03)
    assert found["low"] < found["ratio"]


def test_a_constant_factor_is_sure_and_a_tie_is_not():
    errors = np.random.default_rng(2).normal(size=8)
    found = league(rows("a", 3, {ML: errors, SIM: 9 + errors, "mine": 1.2 * errors, "twice": 2 * errors}))
    np.testing.assert_allclose(cell(found, "a", 3)["low"], 1.2)
    assert row(found)["surely above 1.1"] == row(found, "twice")["surely above 1.1"] == 1.0
    assert row(found, ML)["surely above 1.1"] == 0.0


def test_bootstrap_samples_are_shares_of_the_seeds():
    drawn = resamples(5)
    assert drawn.shape == (N_RESAMPLES, 5)
    np.testing.assert_allclose(drawn.sum(axis=1), 1.0)
    np.testing.assert_allclose(drawn.mean(axis=0), 0.2, atol=0.01)
    assert resamples(5) is drawn


def test_what_has_no_value_is_counted_and_the_references_are_taken_on_the_same_seeds():
    found = league(
        rows("a", 3, {ML: [1, 100], SIM: [2, 200], "mine": [0.5, math.nan]}),
        rows("b", 3, {ML: [1, 1], SIM: [2, 2], "mine": [math.nan, math.nan]}),
    )
    assert cell(found, "a", 3)["ratio"] == 0.5
    assert cell(found, "a", 3)["failed"] == 1
    assert math.isnan(cell(found, "b", 3)["ratio"])
    assert row(found)["failed"] == 3
    assert row(found)["over reference"] == 0.5


def test_zero_errors_are_no_nan():
    found = league(rows("a", 3, {ML: [1, 1], SIM: [0, 0], "mine": [0, 0], "other": [1, 1]}, bound=math.inf))
    assert cell(found, "a", 3)["ratio"] == 1.0
    assert math.isinf(cell(found, "a", 3, "other")["ratio"])
    assert str(found)
    assert geometric_mean([math.nan]) != geometric_mean([math.nan])
    assert geometric_mean([2.0, 8.0]) == pytest.approx(4.0)


def test_coverage_counts_large_logs_that_hold_the_policys_time():
    wide = {ML: 1.0, "mine": 2.0}
    many = [0.5] * 9 + [3.0] * 3
    found = league(
        rows("small", 1, {ML: many, SIM: many, "mine": [9.0] * 12}, half=wide),
        rows("unseen", 3, {ML: many, SIM: many, "mine": [9.0] * 12}, half=wide, covered=0.9),
        rows("counted", 3, {ML: many, SIM: many, "mine": many}, half=wide),
        rows("few", 10, {ML: [0.0], SIM: [0.0], "mine": [9.0]}, half=wide),
    )
    mine = row(found)
    assert (mine["logs"], mine["coverage"]) == (13, 9 / 13)
    assert (mine["worst family"], mine["its coverage"]) == ("counted", 0.75)  # one log says little of "few"
    unit = 1.959963984540054 * 0.1  # half the width of an efficient interval
    np.testing.assert_allclose([mine["width"], mine["width of 1.96 se"]], [2 / unit, 5.0])
    assert mine["coverage of 1.96 se"] == 9 / 13
    assert row(found, SIM)["logs"] == 0
    assert math.isnan(row(found, SIM)["coverage"])


def test_scores_are_runs_by_tasks():
    found = league(
        rows("a", 0.3, {ML: [1, 1], SIM: [3, 3], "mine": [2, -4]}),
        rows("b", 3, {ML: [4, 4], SIM: [2, 2], "mine": [1, math.nan]}),
    )
    np.testing.assert_allclose(found.scores()["mine"], [[2.0, 0.5], [4.0, np.nan]])
    assert set(found.scores()) == {ML, SIM, "mine"}


def test_files_are_whole_and_the_same_twice(tmp_path):
    found = league(
        rows("a|b", 0.3, {ML: [1, 1], SIM: [3, 3], "mi$e": [2, math.nan]}, half={ML: 1.0}, status="ok"),
        rows("same", 3, {ML: [1, 1], SIM: [0, 0], "mi$e": [1, 1]}, identical=True),
    )
    names = {"table.csv", "cells.csv", "league.csv", "league.md", "league.tex", "profile.png", "sizes.png", "heat.png"}
    assert {
        path.name for path in found.save(tmp_path / "one", about={"a|b": "Something."}, command="oee bench")
    } == names
    found.save(tmp_path / "two")
    same = names - {"league.md"}
    assert all((tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes() for name in same)
    page = (tmp_path / "one" / "league.md").read_text()
    assert "| a\\|b | Something. |" in page
    assert "## Without a value" in page
    assert r"mi\$e & held & 2 &" in (tmp_path / "one" / "league.tex").read_text()
    assert (tmp_path / "one" / "heat.png").read_bytes()[1:4] == b"PNG"
    assert len(pd.read_csv(tmp_path / "one" / "table.csv")) == 12


def test_the_pictures_show_every_cell():
    from matplotlib.figure import Figure

    found = league(
        rows("a", 1, {ML: [1, 1], SIM: [3, 3], "mine": [0.1, 0.1]}),
        rows("b", 1, {ML: [1, 1], SIM: [3, 3], "mine": [40, 40]}),
        rows("c", 1, {ML: [1, 1], SIM: [3, 3], "mine": [math.nan, math.nan]}),
    )
    heat, profile = Figure(), Figure()
    found.heat(heat)
    assert [text.get_text() for text in heat.axes[0].texts] == ["0.1", "40", "-"]
    found.profile(profile)
    line = next(line for line in profile.axes[0].lines if line.get_label() == "mine")
    assert max(line.get_ydata()) == pytest.approx(2 / 3)  # what has no value is never below tau
    assert min(line.get_ydata()) == 0.0
