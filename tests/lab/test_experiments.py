"""Tests of every experiment, and of ``oee reproduce`` as a person calls it.

Each has smoke cells, a saved table, a page, a figure and a finding.
"""

import html
import json
import re
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from helpers import run_command
from matplotlib.figure import Figure
from saved_results import RESULTS, assert_saved, saved

from oee_tabular.lab import experiments
from oee_tabular.lab.experiment import (
    Stream,
    files_of,
    set_title,
    share_legend,
    summary_of,
)
from oee_tabular.lab.experiments import catalogue
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS

# by its multinomial, whose numbers are others from numpy 2.5 on
DRAWN_BY_NUMPY = {"efficiency"}
IDS = [
    name for name, experiment in EXPERIMENTS.items() if experiment.group != "continuous"
]
EACH = pytest.mark.parametrize(
    "experiment", EXPERIMENTS.values(), ids=list(EXPERIMENTS)
)


@pytest.mark.parametrize("name", IDS)
def test_a_smoke_cell(name):
    """Check that the saved table has a smoke cell, and that it is summarised and drawn.

    Its random numbers are those of the cell and the seed.
    """
    experiment = EXPERIMENTS[name]
    for module in experiment.requires:
        pytest.importorskip(module)
    cell = experiment.settings(smoke=True, repetitions=1).cells()[0]
    rows = experiment.run(cell, Stream(name, 0, cell))
    table = pd.DataFrame([{**cell, **row} for row in rows])
    if name not in DRAWN_BY_NUMPY or np.lib.NumpyVersion(np.__version__) < "2.5.0":
        assert_saved(name, cell, table)
    summary = summary_of(experiment, table)
    assert set(experiment.keys) <= set(summary.columns)
    assert np.isfinite(summary[f"{experiment.measures[0]}_mean"]).all()
    with mpl.rc_context({"figure.max_open_warning": 0}):
        assert files_of(experiment.settings(smoke=True), table)[
            "figure.svg"
        ].startswith(b"<?xml")
    if name in ("lambda_n", "coverage_lake", "efficiency"):
        again, other = (
            json.dumps(experiment.run(cell, Stream(name, seed, cell)))
            for seed in (0, 1)
        )
        assert again == json.dumps(rows) != other


@EACH
def test_the_saved_results_are_of_the_full_sweep_and_say_what_the_table_shows(
    experiment,
):
    folder = RESULTS / experiment.id
    table = saved(experiment.id)
    figure = Figure(layout="constrained")
    settings = json.loads((folder / "settings.json").read_text())
    for about_the_run in ("files", "made_by"):
        settings.pop(about_the_run, None)
    assert settings == experiment.settings().as_dict()
    assert set(experiment.keys) <= set(table.columns)
    for page in (folder / "summary.md", RESULTS / "index.md"):
        assert experiment.caption in page.read_text()
    finding = experiment.finding(table)
    assert finding
    assert "\n" not in finding
    for name in ("figure.svg", "summary.md"):
        assert finding in html.unescape((folder / name).read_text())
    experiment.draw(table, summary_of(experiment, table), figure)
    shown = [ax for ax in figure.axes if ax.get_visible()]
    assert shown
    for ax in shown:
        # not the paper's points
        lines = [line for line in ax.get_lines() if line.get_linestyle() != "None"]
        curves = [
            line
            for line in lines
            if len(line.get_xdata()) > 2 and not line.get_label().startswith("_")
        ]
        # what the curves are held against
        beside = ("slope", "true value", "true (Monte Carlo)", "zeta = 1", "exact")
        assert (
            len([line for line in curves if not line.get_label().startswith(beside)])
            <= 6
        ), ax.get_title()
    share_legend(figure)
    set_title(figure, finding)
    figure.canvas.draw()
    box = figure._suptitle.get_window_extent()
    assert figure._suptitle.get_fontsize() >= 8.0
    assert box.x0 >= 0.0
    assert box.x1 <= figure.bbox.x1


@EACH
def test_a_finding_changes_with_the_numbers(experiment):
    """Check that no number of a finding is written in the code.

    A table whose every measure is another gives another sentence.
    """
    table = saved(experiment.id)
    numbers = set(table.select_dtypes("number")) - {
        *experiment.keys,
        *experiment.axes,
        "repetition",
    }
    factors = np.random.default_rng(0).uniform(0.2, 5.0, (len(table), len(numbers)))
    other = table.assign(
        **{name: table[name] * factors[:, k] for k, name in enumerate(sorted(numbers))}
    )
    assert experiment.finding(other) != experiment.finding(table)


def test_a_table_by_name():
    one = experiments.table("estimands", delta=0.5)
    assert one.equals(experiments.table("estimands", delta=np.array([0.5])))
    assert not one.equals(experiments.table("estimands", delta=0.5, seed=1))
    same = experiments.table("efficiency", n=1e5)  # names the cell of 100000
    assert same.equals(experiments.table("efficiency"))
    table = experiments.table("estimands", delta=[0.1, 0.5], repetitions=2)
    assert len(table) == 2 * 2 * 4
    cell = {"delta": 0.5, "repetition": 1}
    rows = EXPERIMENTS["estimands"].run(cell, Stream("estimands", 0, cell))
    assert table.tail(4).value.tolist() == [row["value"] for row in rows]
    with pytest.raises(
        ValueError,
        match=(
            r"experiment must be one of fig1a, .*; got 'estimand'; nearest: estimands"
        ),
    ):
        experiments.table("estimand")
    with pytest.raises(ValueError, match="axes must be among delta; got 'n'"):
        experiments.table("estimands", n=3)
    with pytest.raises(ValueError, match="repetitions must be"):
        experiments.table("estimands", repetitions=0)


def test_the_list(capsys):
    assert run_command("reproduce", "--list") == 0
    printed = capsys.readouterr().out
    assert re.search(r"^gridworld:\n  fig1a +360 cells  Figure 1a", printed, re.M)
    assert all(name in printed for name in EXPERIMENTS)


def test_a_smoke_run_writes_everything_and_goes_on(tmp_path, capsys):
    arguments = (
        "reproduce",
        "estimands",
        "--smoke",
        "--seeds",
        1,
        "--jobs",
        1,
        "--output",
        tmp_path,
    )
    assert run_command(*arguments) == 0
    assert "estimands: 1 cells computed" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "smoke" / "estimands").iterdir()}
    assert names == {
        "settings.json",
        "cells.jsonl",
        "table.csv",
        "summary.csv",
        "summary.md",
        "figure.svg",
        "figure.png",
        "figure.pdf",
    }
    assert "The published recipe" in (tmp_path / "smoke" / "index.md").read_text()
    assert run_command(*arguments) == 0
    assert "0 cells computed, 1 from the cache" in capsys.readouterr().out
    # before anything runs
    assert run_command("reproduce", "horizon", *arguments[1:], "--seed", 1) == 2
    assert re.search(
        r"holds results of other settings: seed 0 there, 1 asked",
        capsys.readouterr().err,
    )
    assert not (tmp_path / "smoke" / "horizon").exists()
    assert run_command(*arguments, "--seed", 1, "--fresh") == 0
    assert "1 cells computed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("fig1",), r"experiment must be one of fig1a, .*; got 'fig1'; nearest: fig1a"),
        ((), "one experiment or more must be given, or --all; there are fig1a"),
        (("fig1a", "--all"), "--all must be given without ids; got fig1a"),
        (("fig1a", "--seeds", 0), "--seeds must be at least 1; got 0"),
        (("fig1a", "--seed", -1), "(?s)--seed.*(greater than or equal to 0|x>=0)"),
        (
            ("estimands", "--smoke", "--jobs", 0),
            "jobs must be a positive number, or -1 for one a core; got 0",
        ),
    ],
)
def test_bad_calls(arguments, text, tmp_path, capsys):
    assert run_command("reproduce", *arguments, "--output", tmp_path / "new") == 2
    assert re.search(text, capsys.readouterr().err)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["smoke", "smoke/estimands", "smoke/index.md"])
def test_a_results_folder_with_a_link_is_refused(tmp_path, capsys, name):
    outside = tmp_path / "outside"
    link = tmp_path / "results" / name
    outside.mkdir()
    link.parent.mkdir(parents=True)
    link.symlink_to(outside / "precious" if name.endswith(".md") else outside)
    arguments = (
        "reproduce",
        "estimands",
        "--smoke",
        "--seeds",
        1,
        "--jobs",
        1,
        "--output",
        tmp_path / "results",
    )
    assert run_command(*arguments) == 2
    assert "it is a link or something else" in capsys.readouterr().err
    assert list(outside.iterdir()) == []


def test_an_experiment_without_its_extra_is_left_out_with_a_sentence_and_refused_alone(
    tmp_path, monkeypatch
):
    known = EXPERIMENTS["estimands"]
    lacking = replace(known, id="arm", requires=("no_such_module",))
    monkeypatch.setattr(catalogue, "EXPERIMENTS", {"estimands": known, "arm": lacking})
    said = []
    options = {
        "smoke": True,
        "seeds": 1,
        "seed": 0,
        "jobs": 1,
        "dask": None,
        "fresh": False,
        "say": said.append,
    }
    for names, everything in (([], True), (["estimands", "arm"], False)):
        said.clear()
        catalogue.reproduce(names, everything=everything, output=tmp_path, **options)
        assert (tmp_path / "smoke" / "estimands" / "summary.md").is_file()
        assert said[-1].startswith(
            "Left out: arm needs no_such_module, which is not installed"
        )
    with pytest.raises(ImportError, match="arm needs no_such_module"):
        catalogue.reproduce(["arm"], everything=False, output=tmp_path, **options)
