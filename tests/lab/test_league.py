"""Tests of the league: its numbers, page, files and pictures.

Numbers are checked by hand on small tables, and by another route.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee
from oee_tabular.lab.bench.league import (
    ERRORS,
    EXPLAINED,
    floor,
    geometric_mean,
    league_of,
    league_of_cells,
)

RESULTS = Path(__file__).parents[2] / "notebooks" / "results"
ML = "maximum-likelihood"
SIM = "simulator"
FACTS = {
    "families": "held",
    "identical": False,
    "covered": 1.0,
    "bound": 0.01,
    "truth": 5.0,
    "status": "ok",
}


def rows(family, size, errors, *, half=None, **facts):
    """Return the rows of one cell, from estimator -> errors of its seeds.

    ``half`` gives half the width of an estimator's intervals.
    """
    made = []
    for name, values in errors.items():
        for seed, error in enumerate(values):
            value = 5.0 + error
            wide = (half or {}).get(name, math.nan)
            own = {
                "family": family,
                "size": float(size),
                "seed": seed,
                "estimator": name,
                "value": value,
                "error": error,
                "standard_error": wide / 4,
                "lower": value - wide,
                "upper": value + wide,
                "seconds": 0.5 + seed,
            }
            made.append(own | FACTS | facts)
    return made


def league(*parts):
    return league_of(pd.DataFrame([row for part in parts for row in part]))


def cell(found, family, size, estimator="mine"):
    return found.cells.set_index(["family", "size", "estimator"]).loc[
        (family, size, estimator)
    ]


def row(found, estimator="mine"):
    return (
        found.league.query("families == 'held'").set_index("estimator").loc[estimator]
    )


FRAMES = ("table", "cells", "league")


def small_league():
    """A league of two families, with an estimator that failed once."""
    found = [
        *rows("a", 1, {ML: [1, -1], SIM: [3, 3], "mine": [0.25, 0.25]}, half={ML: 2.0}),
        *rows("b", 3, {ML: [1, -1], SIM: [3, 3], "mine": [0.25, math.nan]}),
    ]
    found[-1] |= {"status": "no value"}
    return league_of(pd.DataFrame(found))


def use(found, folder):
    """Whatever a league makes of its frames."""
    made = [str(found), repr(found), found.errors(), found.scores(), found.to_latex()]
    for draw in (found.profile, found.sizes, found.heat):
        draw(Figure())
    found.save(folder, about={"a": "noise"}, command="oee bench")
    return made


def refusal(found, **frames):
    """What is said of frames in place of a league's own, or "" where they are taken."""
    try:
        replace(found, **frames)
    except ValueError as error:
        return str(error)
    return ""


def test_a_league_needs_the_columns_it_asks_for_and_no_others(tmp_path):
    found = small_league()
    needed = {}
    for name in FRAMES:
        frame = getattr(found, name)
        said = {
            column: refusal(found, **{name: frame.drop(columns=column)})
            for column in frame.columns
        }
        needed[name] = [column for column in said if said[column]]
        for column in needed[name]:
            assert f"{name} must have a column {column}; it has" in said[column]
    assert {*needed["table"]} >= {"family", "size", "seed", "estimator", "error"}
    use(
        replace(found, **{name: getattr(found, name)[needed[name]] for name in FRAMES}),
        tmp_path / "league",
    )


NUMBER_OF = {"table": "error", "cells": "ratio", "league": "worst"}
ODD_FRAMES = {
    "numbers as texts": (
        lambda frame, number: frame.assign(**{number: "3"}),
        "must be real numbers; it is",
    ),
    "complex numbers": (
        lambda frame, number: frame.assign(**{number: frame[number] + 1j}),
        "must be real numbers; it is complex128",
    ),
    "a missing text": (
        lambda frame, number: frame.assign(
            estimator=[*frame["estimator"][:1], None, *frame["estimator"][2:]]
        ),
        "must be texts; row 1 is",
    ),
    "a row twice": (
        lambda frame, number: pd.concat([frame, frame.iloc[[2]]]),
        "is double",
    ),
    "a column twice": (
        lambda frame, number: pd.concat([frame, frame[[number]]], axis=1),
        "is there twice",
    ),
}


@pytest.mark.parametrize("name", FRAMES)
@pytest.mark.parametrize("odd", ODD_FRAMES)
def test_frames_that_are_none_of_a_league_are_refused(name, odd):
    found = small_league()
    change, message = ODD_FRAMES[odd]
    with pytest.raises(ValueError, match=message) as error:
        replace(found, **{name: change(getattr(found, name), NUMBER_OF[name])})
    assert str(error.value).startswith(name)


@pytest.mark.parametrize("size", [3, 1 / 3, 1234567])
def test_a_league_is_read_back_from_its_tables(size, tmp_path):
    errors = {ML: [1, -1], SIM: [3, 3], "mine": [0.25, 0.25]}
    found = league(rows("a", size, errors))
    found.save(tmp_path)
    frames = {name: pd.read_csv(tmp_path / f"{name}.csv") for name in FRAMES}
    again = oee.bench.League(**frames)
    for name, scores in found.scores().items():
        assert_allclose(again.scores()[name], scores, rtol=1e-5)


@pytest.mark.parametrize("name", ["table", "league"])
def test_a_row_without_a_cell_is_refused(name):
    found = small_league()
    frame = getattr(found, name)
    more = frame.iloc[[0]].assign(estimator="another")
    with pytest.raises(ValueError, match=f"{name} must have rows whose .* is not"):
        replace(found, **{name: pd.concat([frame, more])})


def test_ratios_geometric_mean_and_worst_by_hand():
    found = league(
        rows("a", 1, {ML: [1, -1], SIM: [3, 3], "mine": [0.25, 0.25]}),
        rows("b", 3, {ML: [4, 4], SIM: [2, 2], "mine": [8, -8]}),
        rows("c", 3, {ML: [3, 5], SIM: [10, 10], "mine": [1, 7]}),
        rows(
            "same",
            3,
            {ML: [1, 1], SIM: [0, 0], "mine": [0.5, 0.5]},
            identical=True,
            families="tuned",
            bound=0.25,
        ),
    )
    # b's is over the simulator's, the better one
    ratios = 0.25, 4.0, math.sqrt(25 / 17)
    assert_allclose(
        [cell(found, *key)["ratio"] for key in (("a", 1), ("b", 3), ("c", 3))],
        ratios,
        rtol=1e-12,
    )
    same = cell(found, "same", 3)[["ratio", "b", "floor", "over_likelihood"]]
    assert same.tolist() == [2.0, 0.0, 1.009, 0.5]  # over eff / 2
    mine = row(found)
    assert_allclose(mine["over reference"], np.prod(ratios) ** (1 / 3), rtol=1e-12)
    assert mine[["cells", "worst", "worst cell", "floor"]].tolist() == [
        3,
        4.0,
        "b at 3",
        1.224,
    ]
    assert_allclose(
        mine["over likelihood"], (0.25 * 2 * math.sqrt(25 / 17)) ** (1 / 3), rtol=1e-12
    )
    # .25 over sqrt(.01)
    assert cell(found, "a", 1)[["over_eff", "seconds"]].tolist() == [2.5, 1.0]
    assert cell(found, "c", 3)["bias"] == 4.0
    kinds = [[name, kind] for kind in ("held", "tuned") for name in (ML, SIM, "mine")]
    assert found.league[["estimator", "families"]].values.tolist() == kinds


def test_the_bootstrap_is_paired_and_of_the_seeds():
    errors = np.random.default_rng(0).normal(size=(3, 12)) * [[1.4], [1.0], [1.2]]
    found = league(
        rows(
            "a",
            3,
            {
                **dict(zip(("mine", ML, SIM), errors, strict=True)),
                "twice": 2 * errors[1],
            },
        )
    )
    picks = np.random.default_rng(1).integers(12, size=(40_000, 12))  # by another route
    one, two, three = (np.sqrt((own[picks] ** 2).mean(axis=1)) for own in errors)
    assert_allclose(
        cell(found, "a", 3)["low"],
        np.quantile(one / np.minimum(two, three), 0.05),
        rtol=0.03,
    )
    assert cell(found, "a", 3)["low"] < cell(found, "a", 3)["ratio"]
    assert cell(found, "a", 3, "twice")["low"] >= 2.0  # in each sample
    assert row(found, "twice")["surely above 1.1"] == 1.0
    assert row(found, ML)["surely above 1.1"] == 0.0


def test_what_has_no_value_is_counted_and_the_references_are_taken_on_the_same_seeds():
    found = league(
        rows("a", 3, {ML: [1, 100], SIM: [2, 200], "mine": [0.5, math.nan]}),
        rows("b", 3, {ML: [1, 1], SIM: [2, 2], "mine": [math.nan, math.nan]}),
    )
    assert cell(found, "a", 3)[["ratio", "failed"]].tolist() == [0.5, 1]
    assert math.isnan(cell(found, "b", 3)["ratio"])
    assert row(found)[["failed", "over reference"]].tolist() == [3, 0.5]


def test_zero_errors_are_no_nan():
    found = league(
        rows(
            "a",
            3,
            {ML: [1, 1], SIM: [0, 0], "mine": [0, 0], "other": [1, 1]},
            bound=math.inf,
        )
    )
    assert cell(found, "a", 3)["ratio"] == 1.0
    assert math.isinf(cell(found, "a", 3, "other")["ratio"])
    assert str(found)


def test_a_mean_is_empty_where_an_estimator_is_exactly_right_in_a_cell():
    assert math.isnan(geometric_mean(pd.Series([0.0, 2.0])))
    assert math.isnan(geometric_mean(pd.Series([], dtype=float)))
    assert geometric_mean(pd.Series([4.0, math.nan, 1.0])) == pytest.approx(2.0)
    found = league(
        rows("a", 3, {ML: [1, 1], SIM: [0, 0], "mine": [1, 1]}),
        rows("b", 3, {ML: [1, 1], SIM: [3, 3], "mine": [1, 1]}),
    )
    means = ["over reference", "over likelihood", "over eff"]
    assert row(found, SIM)[means].isna().all()
    assert row(found)[means].notna().all()
    assert row(found, SIM)["worst"] == 3.0
    page = found.page({}, "")
    assert "| over reference | 4.472 |  | 4.472 |" in page
    assert "A mean is empty where the estimator is exactly right in a cell." in page


@pytest.mark.parametrize("run", ["bench", "bench_intervals"])
def test_the_saved_leagues_are_those_of_their_saved_cells(run):
    saved = pd.read_csv(RESULTS / run / "league.csv")
    made = league_of_cells(pd.read_csv(RESULTS / run / "cells.csv"))
    assert list(made.columns) == list(saved.columns)
    for name in saved.columns:
        if saved[name].dtype.kind in "if":
            assert_allclose(made[name], saved[name], rtol=2e-5, err_msg=name)
        else:
            assert made[name].tolist() == saved[name].fillna("").tolist()
    page = (RESULTS / run / "league.md").read_text()
    assert EXPLAINED in page
    simulator = saved.query("estimator == 'simulator' and families == 'tuned'")
    assert simulator["over reference"].isna().all()


def test_coverage_counts_large_logs_that_hold_the_policys_time():
    wide = {ML: 1.0, "mine": 2.0}
    many = [0.5] * 9 + [3.0] * 3
    found = league(
        rows("small", 1, {ML: many, SIM: many, "mine": [9.0] * 12}, half=wide),
        rows(
            "unseen",
            3,
            {ML: many, SIM: many, "mine": [9.0] * 12},
            half=wide,
            covered=0.9,
        ),
        rows("counted", 3, {ML: many, SIM: many, "mine": many}, half=wide),
        rows("few", 10, {ML: [0.0], SIM: [0.0], "mine": [9.0]}, half=wide),
    )
    mine = row(found)
    assert mine[["logs", "coverage", "coverage of 1.96 se"]].tolist() == [
        13,
        9 / 13,
        9 / 13,
    ]
    # one log says little of "few"
    assert mine[["worst family", "its coverage"]].tolist() == ["counted", 0.75]
    unit = 1.959963984540054 * 0.1  # half the width of an efficient interval
    assert_allclose([mine["width"], mine["width of 1.96 se"]], [2 / unit, 5.0])
    assert row(found, SIM)["logs"] == 0
    assert math.isnan(row(found, SIM)["coverage"])


def test_scores_are_runs_by_tasks():
    found = league(
        rows("a", 0.3, {ML: [1, 1], SIM: [3, 3], "mine": [2, -4]}),
        rows("b", 3, {ML: [4, 4], SIM: [2, 2], "mine": [1, math.nan]}),
    )
    assert_allclose(found.scores()["mine"], [[2.0, 0.5], [4.0, np.nan]])
    assert set(found.scores()) == {ML, SIM, "mine"}


def test_files_are_whole_and_the_same_twice(tmp_path):
    found = league(
        rows(
            "a|b", 0.3, {ML: [1, 1], SIM: [3, 3], "mi$e": [2, math.nan]}, half={ML: 1.0}
        ),
        rows("same", 3, {ML: [1, 1], SIM: [0, 0], "mi$e": [1, 1]}, identical=True),
    )
    names = {
        "table.csv",
        "cells.csv",
        "league.csv",
        "league.md",
        "league.tex",
        *(
            f"{name}.{kind}"
            for name in ("profile", "sizes", "heat")
            for kind in ("png", "pdf", "svg")
        ),
    }
    one = tmp_path / "one"
    two = tmp_path / "two"
    made = (
        found.save(one, about={"a|b": "Something."}, command="oee bench"),
        found.save(two),
    )
    assert {path.name for path in made[0]} == names
    assert all(
        (one / name).read_bytes() == (two / name).read_bytes()
        for name in names - {"league.md"}
    )
    page = (one / "league.md").read_text()
    assert "| a\\|b | Something. |" in page
    assert "## Without a value" in page
    assert r"mi\$e & held & 2 &" in (one / "league.tex").read_text()
    assert (one / "heat.png").read_bytes()[1:4] == b"PNG"
    assert (one / "heat.pdf").read_bytes()[:4] == b"%PDF"
    assert b"<svg" in (one / "heat.svg").read_bytes()
    assert len(pd.read_csv(one / "table.csv")) == 12


def test_standard_errors_are_those_of_other_seeds():
    """Against the spread of the league over new seeds, of cells that are independent."""

    def drawn(seed):
        normal = np.random.default_rng(seed).normal
        return league(
            *(
                rows(
                    family,
                    3,
                    {
                        ML: normal(size=60),
                        SIM: np.full(60, 5.0),
                        "mine": scale * normal(size=60),
                    },
                    half={"mine": scale},
                )
                for family, scale in (("a", 1.5), ("b", 0.8), ("c", 3.0))
            )
        )

    found = drawn(0)
    errors = found.errors().assign(estimator=found.league["estimator"])
    mine = errors.set_index("estimator").loc["mine"]
    many = pd.DataFrame([row(drawn(seed)) for seed in range(1, 60)])
    for name in ("over reference", "over eff", "coverage"):
        assert_allclose(mine[name], many[name].astype(float).std(), rtol=0.35)
    text = found.to_latex()
    value = row(found)["over reference"]
    assert f"{value:.2f} ({mine['over reference']:.2f})" in text
    assert "& -- & -- " in text  # the simulator has no interval
    # maximum likelihood is its own reference
    assert errors.set_index("estimator").loc[ML, "over reference"] == 0.0


def test_without_seeds_to_vary_there_is_no_error():
    found = league(rows("a", 3, {ML: [1.0], SIM: [3.0], "mine": [2.0]}))
    assert found.errors()[["over reference", "worst", "over eff"]].isna().all(axis=None)
    assert "mine & held & 1 & 2.00 & " in found.to_latex()


def test_labels_are_shown_everywhere_and_the_names_kept():
    found = league(rows("a", 3, {ML: [1, 1], SIM: [3, 3], "mine": [2, 2]}))
    shown = found.with_labels({"mine": "Ours", SIM: "Sim_1"})
    assert shown.league["estimator"].tolist() == [ML, SIM, "mine"]
    assert "Ours" in str(shown)
    assert "| Sim_1 | Ours |" in shown.page({}, "")
    assert r"Sim\_1 & held" in shown.to_latex()
    figures = Figure(), Figure(), Figure()
    for draw, figure in zip(
        (shown.profile, shown.sizes, shown.heat), figures, strict=True
    ):
        draw(figure)
    assert figures[2].axes[0].get_title() == "Ours"
    legend = [text.get_text() for text in figures[0].axes[0].get_legend().get_texts()]
    assert legend == [f"{ML}, else simulator", "Sim_1", "Ours"]
    with pytest.raises(ValueError, match="labels must give each estimator another"):
        found.with_labels({"mine": SIM})
    with pytest.raises(ValueError, match="labels must be of estimators in the league"):
        found.with_labels({"yours": "Ours"})


def test_the_pictures_show_every_cell():
    errors = {"a": 0.1, "b": 40, "c": math.nan}
    found = league(
        *(
            rows(name, 1, {ML: [1, 1], SIM: [3, 3], "mine": [x, x]})
            for name, x in errors.items()
        )
    )
    heat = Figure()
    profile = Figure()
    sizes = Figure()
    found.heat(heat)
    assert [text.get_text() for text in heat.axes[0].texts] == ["0.1", "40", "-"]
    found.profile(profile)
    line = next(line for line in profile.axes[0].lines if line.get_label() == "mine")
    # what has no value is never below tau
    assert max(line.get_ydata()) == pytest.approx(2 / 3)
    assert min(line.get_ydata()) == 0.0
    found.sizes(sizes)
    points = {
        bars.get_label(): bars.lines[0].get_ydata().item()
        for bars in sizes.axes[0].containers
    }
    assert points["mine"] == pytest.approx(20.0)  # sqrt(.1 * 40) over .1


def test_the_floor_against_the_least_favourable_prior():
    """Check the floor by mirror ascent on the prior.

    The prior's Bayes rule bounds the least worst ratio from below, its worst ratio from
    above.
    """
    errors = np.union1d(np.arange(0.0, 10.01, 0.1), ERRORS)
    scale = np.maximum(np.minimum(errors, 1.0), 0.5)
    x = np.linspace(-18.0, 18.0, 1501)
    here, mirrored = (
        stats.norm.pdf(x - sign * errors[:, None]) for sign in (1.0, -1.0)
    )
    prior = np.full(len(errors), 1.0 / len(errors))
    for k in range(600):
        weights = prior / scale**2
        rule = (weights * errors) @ (here - mirrored) / (weights @ (here + mirrored))
        squares = (
            ((rule - errors[:, None]) ** 2 * here).sum(axis=1)
            * (x[1] - x[0])
            / scale**2
        )
        least = np.sqrt(prior @ squares)
        worst = np.sqrt(squares.max())
        prior = prior * np.exp(
            0.5 / np.sqrt(1.0 + k / 50.0) * (squares - squares.max())
        )
        prior /= prior.sum()
    assert 1.22 < least < worst < 1.23
    assert_allclose(floor(ERRORS), np.sqrt(squares)[np.isin(errors, ERRORS)], rtol=0.01)
    assert floor(np.array([7.0, -7.0])).tolist() == [1.224, 1.224]


def test_errors_are_told_by_the_distance_of_the_policy():
    """Near is below .3, far from .5 on; cells without a distance count in neither."""
    parts = []
    distances = {"a": 0.0, "b": 0.29, "c": 0.3, "d": 0.5, "e": 1.0, "f": math.nan}
    for k, (family, distance) in enumerate(distances.items()):
        errors = {ML: [2.0, 2.0], SIM: [3.0, 3.0], "mine": [2.0**-k] * 2}
        parts.append(rows(family, 3, errors, distance=distance))
    mine = row(league(*parts))
    near, between, far = (
        mine[f"over likelihood, {which}"] for which in ("near", "between", "far")
    )
    assert_allclose([near, between, far], [2**-1.5, 2**-3.0, 2**-4.5])
    plain = row(league(rows("a", 3, {ML: [1, 1], SIM: [3, 3], "mine": [1, 1]})))
    assert math.isnan(plain["over likelihood, near"])


def test_the_distance_is_that_of_the_shares_of_pairs():
    """The recorded policy is near, but for the discount; one of other actions at 1."""
    family = oee.bench.families()["corridor30"]
    same = replace(family, policy=family.data_policy)
    other = replace(
        family,
        policy=np.eye(2)[np.ones(30, int)],
        data_policy=np.eye(2)[np.zeros(30, int)],
    )
    made = {"same": same, "other": other}
    found = oee.bench.run("simulator", families=lambda seed: made, sizes=1, seeds=1)
    distance = found.table.groupby("family")["distance"].first()
    assert 0 < distance["same"] < 0.1
    assert distance["other"] == pytest.approx(1.0)
