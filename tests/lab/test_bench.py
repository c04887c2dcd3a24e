"""Tests of runs of the benchmark.

They give the same bits every time and in every mode, resume, have failures as rows, and
take a user's own estimators and families.
"""

import importlib.metadata
import json
import re
import signal
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers import run_command
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.exact import efficiency_bound, occupancy
from oee_tabular.lab.bench.sweep import plan

SMALL = {"families": ["machine", "garnet_worse"], "sizes": [3], "seeds": 2}
MACHINE = oee.bench.families()["machine"]


@pytest.fixture
def here(monkeypatch):
    """Give the command in this folder, where own.py is."""
    monkeypatch.chdir(Path(__file__).parent)


def run_machine(estimators, **options):
    return oee.bench.run(
        estimators, **({"families": "machine", "sizes": 3, "seeds": 2} | options)
    )


def assert_same(one, two):
    for name in ("table", "cells"):
        first, second = (
            getattr(league, name).drop(columns="seconds") for league in (one, two)
        )
        pd.testing.assert_frame_equal(first, second, check_exact=True)


def test_twice_and_in_two_processes_the_same_bits(here):
    given = {"oee": "oee", "product": "is", "own": "own:guess"}
    one = oee.bench.run(given, **SMALL)
    assert_same(one, oee.bench.run(given, **SMALL))
    assert_same(one, oee.bench.run(given, **SMALL, jobs=2))
    assert len(one.table) == 2 * 2 * 5
    assert (one.table.status == "ok").all()
    assert one.league.estimator.tolist() == [
        "maximum-likelihood",
        "simulator",
        "oee",
        "product",
        "own",
    ]


def test_a_row_is_what_the_estimator_says_on_the_familys_log():
    league = oee.bench.run(
        "oee", families=["garnet_worse"], sizes=[3], seeds=2, seed=5
    ).table
    assert league.seed.unique().tolist() == [5, 6]
    family = oee.bench.families(6)["garnet_worse"]
    row = league[(league.estimator == "oee") & (league.seed == 6)].iloc[0]
    assert (row.truth, row.n, row.open_rows) == (family.truth, 360, 120)
    assert_allclose(row.error, row.value - family.truth)
    assert_allclose(
        row.bound,
        efficiency_bound(family.target, family.policy, family.data_distribution) / 360,
    )
    assert 0.9 < row.covered <= 1.0
    assert row.lower < row.value < row.upper
    other = oee.bench.run(
        "simulator", families="garnet_worse, machine", sizes=[1, 3], seeds=7
    ).table
    key = ["family", "size", "seed", "estimator"]
    again = other.set_index(key).loc[("garnet_worse", 3.0, 6, "maximum-likelihood")]
    # in any run
    assert (
        again.value
        == league.set_index(key).value["garnet_worse", 3.0, 6, "maximum-likelihood"]
    )
    simulator = other[(other.estimator == "simulator") & (other.family == "machine")]
    assert set(simulator.value) == {oee.policy_value(MACHINE.simulator, MACHINE.policy)}


def test_the_share_of_the_policys_time_that_a_log_covers():
    family = oee.bench.families()["corridor30"]
    row = oee.bench.run(
        "simulator", families="corridor30", sizes=0.3, seeds=1
    ).table.iloc[0]
    time = occupancy(family.target, family.policy)
    time[29] = 0.0  # over
    assert row.n == 17
    assert (
        0
        < row.covered
        < time[np.argsort(time.sum(axis=1))[-17:]].sum() / time.sum() + 1e-12
    )


def fail(problem, policy, *, seed=None):
    raise RuntimeError("no luck")


def hang(problem, policy):
    # as the alarm does at the end of the time
    signal.raise_signal(signal.SIGALRM)


def test_an_estimator_that_never_returns_is_a_row_with_that_reason():
    asked = {"families": ["machine"], "sizes": [3], "seeds": 1}
    status = (
        oee.bench.run({"hang": hang}, **asked, timeout=3600)
        .table.set_index("estimator")
        .status
    )
    assert (
        status["hang"]
        == "TimeoutError: no answer within 3600 s (--timeout gives it more)"
    )
    assert (status.drop("hang") == "ok").all()
    with pytest.raises(ValueError, match="timeout must be"):
        oee.bench.run({"hang": hang}, **asked, timeout=0)


def test_failures_are_rows_with_their_reason_and_the_rest_goes_on():
    reasons = {
        "fail": (fail, "RuntimeError: no luck"),
        "nothing": (
            lambda problem, policy: oee.Estimate(
                float("nan"), status="the sum diverges"
            ),
            "the sum diverges",
        ),
        "silent": (
            lambda problem, policy, *, seed=None: oee.Estimate(float("inf")),
            "the value is inf",
        ),
        "pair": (
            lambda problem, policy: (1.0, 0.1),
            (
                "AnswerError: an estimator must return a float or an Estimate; it"
                " returned tuple"
            ),
        ),
    }
    fine = {"bare": lambda problem, policy: 1.0, "fine": oee.estimators.ModelBased()}
    league = run_machine(
        {name: function for name, (function, _) in reasons.items()} | fine
    )
    status = league.table.drop_duplicates("estimator").set_index("estimator").status
    assert (status[["bare", "fine"]] == "ok").all()
    assert all(status[name].startswith(reason) for name, (_, reason) in reasons.items())
    failed = league.league.set_index("estimator").failed
    assert failed[failed > 0].to_dict() == dict.fromkeys(reasons, 2)
    assert "| fail | RuntimeError: no luck | 2 |" in league.page({}, "")
    assert "fail: no value on 2 logs: RuntimeError: no luck" in str(league)
    assert "no value" not in str(run_machine("oee"))


def test_the_printed_value_and_its_interval():
    table = run_machine(
        ["oee", "evaluate", "oracle"], sizes=10, seeds=1
    ).table.set_index("estimator")
    assert table.lower["evaluate"] <= table.value["evaluate"] <= table.upper["evaluate"]
    methods = {
        "evaluate": "likelihood",
        "maximum-likelihood": "value +- 1.96 standard errors",
        "simulator": "",
    }
    assert {name: table.interval[name] for name in methods} == methods
    likely = table.loc["maximum-likelihood"]
    assert_allclose(
        [likely.upper - likely.value, likely.value - likely.lower],
        1.959964 * likely.standard_error,
        rtol=1e-6,
    )
    assert table.truth.unique().tolist() == [MACHINE.truth]
    assert_allclose(table.error["oracle"], 0.0, atol=1e-9)  # it is given the target


def test_finished_cells_are_kept(tmp_path):
    """Keep finished cells, but not those of other settings.

    How an interrupted run goes on is in test_run.py.
    """
    calls = []
    options = {"sizes": 1, "seeds": 2, "output": tmp_path / "out"}
    first, again = (
        run_machine(
            {"counted": lambda problem, policy: calls.append(1) or 0.0}, **options
        )
        for _ in range(2)
    )
    assert_same(first, again)
    assert len(calls) == 2
    with pytest.raises(
        ValueError, match=r"estimators \['counted'\] there, \['simulator'\] asked"
    ):
        run_machine("simulator", **options)
    run_machine("simulator", **options, fresh=True)
    assert json.loads((tmp_path / "out" / "settings.json").read_text())["asked"][
        "estimators"
    ] == ["simulator"]


def test_modules_are_part_of_the_settings(here):
    assert plan("oee, own:guess", families=["machine"]).modules == ("own",)
    assert plan(["oee"], families="own:pairs").modules == ("own",)
    assert plan(["oee", fail], families=["machine"]).modules == (fail.__module__,)


def test_families_of_ones_own(here):
    for given, truths in (("own:pairs", 2), ("own:constant", 1)):
        table = run_machine("own:Maker", families=given).table
        assert table.family.unique().tolist() == ["three"]
        assert table.truth.nunique() == truths
        assert table[table.estimator == "own:Maker"].interval.unique().tolist() == [
            "mine"
        ]
    for mine in (
        {"mine": MACHINE},
        lambda: {"mine": MACHINE},
        lambda seed: {"mine": MACHINE},
    ):
        table = run_machine("simulator", families=mine, seeds=1).table
        assert set(zip(table.family, table.families, strict=True)) == {("mine", "held")}


def test_a_family_without_discount():
    simulator = oee.FiniteMDP(
        np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [1.0, 0.0], 1.0
    )
    target = simulator.with_transitions(np.array([[[0.7, 0.3]], [[0.0, 1.0]]]))
    family = oee.bench.Family(
        simulator, target, np.ones((2, 1)), np.ones((2, 1)), "It ends too late."
    )
    table = run_machine("model-based", families={"short": family}, sizes=10).table
    assert table.covered.tolist() == [1.0] * 6
    assert table.bound.isna().all()
    assert table.truth.iloc[0] == pytest.approx(1 / 0.3)


BAD = {
    "unknown": (
        {"estimators": ["oe"]},
        r"estimators must be among .*; got 'oe' \(did you mean 'oee'\?\)",
    ),
    "twice": (
        {"estimators": "oee,oee"},
        "estimators must have different names; 'oee' is there twice",
    ),
    "no estimator at all": (
        {"estimators": [3]},
        "estimators must be names, MODULE:OBJECT or callables; got 3",
    ),
    "a reference's name": (
        {"estimators": {"simulator": "oee"}},
        "estimators must not be called 'simulator', which is a ref",
    ),
    "no module": (
        {"estimators": "no_such_module:x"},
        "must name something that can be imported; module"
        " 'no_such_module' cannot be found, neither in .* nor installed",
    ),
    "no object": (
        {"estimators": "own:nobody"},
        r"'own' has no object 'nobody' \(it has Maker, constant, guess",
    ),
    "no callable": (
        {"estimators": "own:oee"},
        "'own:oee' must be a function .* got module",
    ),
    "unknown family": (
        {"families": ["machin"]},
        r"families must be one of .*; got 'machin'; nearest: machine",
    ),
    "no families in a text": (
        {"families": ","},
        "families must name at least one; it is empty",
    ),
    "no families at all": ({"families": 3}, "families must be a function; got int"),
    "an array without dimensions": (
        {"families": np.array("machine")},
        "families must be names, or a mapping of families; iteration over a 0-d array",
    ),
    "no family": (
        {"families": "own:wrong"},
        "families must be Families; family 'three' is a int",
    ),
    "no mapping": (
        {"families": lambda: 3},
        "families must make a mapping name -> Family; they make a int",
    ),
    "a seed without": (
        {"families": lambda seed: {} if seed else {"odd": MACHINE}, "seeds": 2},
        "families must have 'odd' at every seed; at seed 1 it is missing",
    ),
    "outside the support": (
        {"families": "own:outside"},
        "family 'bent': target must stay in .* gives probability 0 to .*s=",
    ),
    "sizes": ({"sizes": [0]}, r"sizes must be in \(0, inf\); it is 0"),
    "no sizes": ({"sizes": []}, "sizes must name at least one; it is empty"),
    "size's type": ({"sizes": ["x"]}, "sizes must be a number; got 'x'"),
    "seeds": ({"seeds": 0}, "seeds must be a positive integer; it is 0"),
    "seed": ({"seed": -1}, "seed must be an integer from 0; got -1"),
    "jobs": (
        {"jobs": 0},
        "jobs must be a positive number, or -1 for one a core; got 0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_calls(name, here):
    options, text = BAD[name]
    with pytest.raises(ValueError, match=text):
        run_machine(**({"estimators": "simulator", "seeds": 1} | options))


def test_the_command(tmp_path, capsys, here):
    arguments = (
        "bench",
        "--estimators",
        "oee, own:guess",
        "--families",
        "machine,forest12",
        "--sizes",
        "3",
        "--seeds",
        2,
        "--jobs",
        1,
        "--output",
        tmp_path / "out",
    )
    assert run_command(*arguments) == 0
    told = capsys.readouterr().out
    assert re.search(
        r"estimator +maximum-likelihood, else simulator +simulator +oee +own:guess\n",
        told,
    )
    assert "out: 4 cells computed (" in told
    made = {
        "settings.json",
        "cells.jsonl",
        "table.csv",
        "cells.csv",
        "league.csv",
        "league.md",
        "league.tex",
        *(
            f"{name}.{kind}"
            for name in ("sizes", "profile", "heat")
            for kind in ("png", "pdf", "svg")
        ),
    }
    assert {path.name for path in (tmp_path / "out").iterdir()} == made
    page = (tmp_path / "out" / "league.md").read_text()
    assert (
        "`oee bench --estimators oee, own:guess --sizes 3 --seeds 2 --families"
        " machine,forest12`" in page
    )
    assert "| forest12 | Fires are twice as frequent as simulated. |" in page
    assert len(pd.read_csv(tmp_path / "out" / "cells.csv")) == 8
    assert run_command(*arguments, "--seed", 3) == 2
    assert (
        "holds results of other settings: seed 0 there, 3 asked"
        in capsys.readouterr().err
    )


def test_labels_and_what_made_the_files(tmp_path, capsys, here):
    """Labels are no settings: the second run takes the first one's cells."""
    arguments = (
        *("bench", "--estimators", "fqe,mle,model-based,own:guess", "--seeds", 2),
        *("--families", "machine", "--sizes", 3, "--jobs", 1),
        *("--output", tmp_path / "out"),
    )
    assert run_command(*arguments) == 0
    told = capsys.readouterr().out
    for name in (
        "fqe, else simulator",
        "mle, else simulator",
        "model-based, else stay",
    ):
        assert name in told
    labels = ("--label", "own:guess=50% & more_{x}", "--label", "model-based = Model")
    assert run_command(*arguments, *labels) == 0
    told = capsys.readouterr().out
    assert "out: 0 cells computed, 2 from the cache" in told
    assert "50% & more_{x}" in told
    folder = tmp_path / "out"
    assert r"50\% \& more\_\{x\} & tuned & 1 &" in (folder / "league.tex").read_text()
    page = (folder / "league.md").read_text()
    assert "| Model | 50% & more_{x} |" in page
    assert "--label 'own:guess=50% & more_{x}'" in page
    assert "own:guess" in (folder / "league.csv").read_text()
    made_by = json.loads((folder / "settings.json").read_text())["made_by"]
    assert made_by["version"].startswith(importlib.metadata.version("oee-tabular"))
    assert set(made_by) <= {"version", "commit"}
    mine = oee.bench.run(
        {"fqe": lambda problem, policy: 1.0}, families="machine", sizes=3, seeds=2
    )
    assert "fqe, else" not in str(mine)  # it is no estimator of ours


@pytest.mark.parametrize(
    ("label", "text"),
    [
        ("oee", r"--label must be NAME=TEXT, such as .*; got 'oee'"),
        ("oe=x", "--label must be of estimators in the league, .*oee; got 'oe'"),
        ("oee=", r"--label\['oee'\] must be a text of one line.*; it is ''"),
        ("oee=a\nb", r"--label\['oee'\] must be a text of one line"),
        (
            "oee=simulator",
            "--label must give each .*; 'simulator' would be there twice",
        ),
    ],
)
def test_bad_labels(label, text, tmp_path, capsys):
    arguments = ("bench", "--estimators", "oee", "--families", "machine")
    assert run_command(*arguments, "--label", label, "--output", tmp_path / "new") == 2
    assert re.search(text, capsys.readouterr().err)
    assert not (tmp_path / "new").exists()
    twice = ("--label", "oee=a", "--label", "oee=b")
    assert run_command(*arguments, *twice, "--output", tmp_path / "new") == 2
    assert "'oee' is there twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--seed", -1), "(?s)--seed.*(greater than or equal to 0|x>=0)"),
        (
            ("--sizes", "1;3"),
            "--sizes must be numbers with commas between them, 0.3,1,3; got '1;3'",
        ),
        (("--sizes", "-1"), r"sizes must be in \(0, inf\); it is -1"),
    ],
)
def test_bad_commands(arguments, text, tmp_path, capsys):
    assert (
        run_command(
            "bench", "--families", "machine", *arguments, "--output", tmp_path / "new"
        )
        == 2
    )
    assert re.search(text, capsys.readouterr().err)
    assert not (tmp_path / "new").exists()
