"""``oee reproduce`` as a person calls it."""

import re

import pytest

from oee_tabular.cli import main
from oee_tabular.lab.experiments import catalogue
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.registry import Experiment, Registry


def oee_command(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code or 0


def test_the_list(capsys):
    assert oee_command("reproduce", "--list") == 0
    told = capsys.readouterr().out
    assert re.search(r"^gridworld:\n  fig1a +360 cells  Figure 1a", told, re.M)
    assert all(experiment.id in told for experiment in EXPERIMENTS)


def test_a_smoke_run_writes_everything_and_goes_on(tmp_path, capsys):
    arguments = ("reproduce", "estimands", "--smoke", "--seeds", 1, "--jobs", 1, "--output", tmp_path)
    assert oee_command(*arguments) == 0
    assert "estimands: 3 cells computed" in capsys.readouterr().out
    names = {path.name for path in (tmp_path / "smoke" / "estimands").iterdir()}
    assert names == {
        "settings.json", "cells.jsonl", "table.csv", "summary.csv", "summary.md", "figure.svg", "figure.png",
    }  # fmt: skip
    assert "The published recipe" in (tmp_path / "smoke" / "index.md").read_text()
    assert oee_command(*arguments) == 0
    assert "0 cells computed, 3 from the cache" in capsys.readouterr().out
    assert oee_command(*arguments, "--seed", 1) == 2
    assert re.search(r"holds results of other settings: seed 0 there, 1 asked", capsys.readouterr().err)
    assert oee_command(*arguments, "--seed", 1, "--fresh") == 0
    assert "3 cells computed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("fig1",), r"experiment must be one of fig1a, .*; got 'fig1'; nearest: fig1a"),
        ((), "one experiment or more must be given, or --all; there are fig1a"),
        (("fig1a", "--all"), "--all must be given without ids; got fig1a"),
        (("fig1a", "--seeds", 0), "--seeds must be at least 1; got 0"),
        (("fig1a", "--seed", -1), "(?s)--seed.*(greater than or equal to 0|x>=0)"),
        (("estimands", "--smoke", "--jobs", 0), "jobs must be a positive number, or -1 for one a core; got 0"),
    ],
)
def test_bad_calls(arguments, text, tmp_path, capsys):
    assert oee_command("reproduce", *arguments, "--output", tmp_path / "new") == 2
    assert re.search(text, capsys.readouterr().err)
    assert not (tmp_path / "new").exists()


def test_other_settings_are_refused_before_anything_runs(tmp_path, capsys):
    assert oee_command("reproduce", "estimands", "--smoke", "--seeds", 1, "--jobs", 1, "--output", tmp_path) == 0
    capsys.readouterr()
    other = ("--smoke", "--seeds", 1, "--seed", 1, "--jobs", 1, "--output", tmp_path)
    assert oee_command("reproduce", "horizon", "estimands", *other) == 2
    assert not (tmp_path / "smoke" / "horizon").exists()


def test_an_experiment_without_its_extra_is_left_out_with_a_sentence_and_refused_alone(tmp_path, monkeypatch):
    known = EXPERIMENTS["estimands"]
    lacking = Experiment(**{**known.__dict__, "id": "arm", "requires": ("no_such_module",)})
    monkeypatch.setattr(catalogue, "EXPERIMENTS", Registry([known, lacking]))
    told = []
    options = {"smoke": True, "seeds": 1, "seed": 0, "jobs": 1, "dask": None, "fresh": False, "say": told.append}
    for names, everything in (([], True), (["estimands", "arm"], False)):
        told.clear()
        catalogue.reproduce(names, everything=everything, output=tmp_path, **options)
        assert (tmp_path / "smoke" / "estimands" / "summary.md").is_file()
        assert told[-1].startswith("Left out: arm needs no_such_module, which is not installed")
    with pytest.raises(ImportError, match="arm needs no_such_module"):
        catalogue.reproduce(["arm"], everything=False, output=tmp_path, **options)
