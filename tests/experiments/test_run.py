"""The runner: the same table in every mode, resuming, folders with other settings, killed workers, dask."""

import json
import os
import re
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest

from oee_tabular.lab import run as running
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.output import figures, index, pipe_table, summary_of, table_of, write
from oee_tabular.lab.registry import Experiment
from oee_tabular.lab.run import run_experiment
from oee_tabular.lab.store import Store, cell_key, code_version


def noise(cell, stream):
    """A cell that needs BLAS, and gives numbers that are hard to print."""
    matrix = stream.generator().normal(size=(60, 60))
    value = float(np.linalg.inv(matrix @ matrix.T + np.eye(60)).sum())
    return [{"name": name, "value": value * factor} for name, factor in (("one", 1.0), ("third", 1 / 3))]


def experiment(run=noise, **options):
    def draw(table, summary, figure):
        figure.subplots().plot(summary["value_mean"])

    plain = {
        "title": "Noise | and more",
        "axes": {"n": (1, 2, 3)},
        "keys": ("n", "name"),
        "measures": ("value",),
        "caption": "Numbers.",
        "repetitions": 2,
    }
    return Experiment(id="noise", run=run, draw=draw, **(plain | options))


def bytes_of(folder, one, settings, **options):
    run_experiment(one, folder, settings, **options)
    write(one, Store(folder, settings))
    return {name: (folder / name).read_bytes() for name in ("table.csv", "summary.csv", "summary.md", "figure.svg")}


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """(the experiment, its settings, the files of a run in this process)."""
    one = EXPERIMENTS["estimands"]
    settings = one.settings(smoke=True, repetitions=1)
    return one, settings, bytes_of(tmp_path_factory.mktemp("serial"), one, settings)


def test_serial_and_processes_give_the_same_files(tmp_path, serial):
    one, settings, expected = serial
    assert bytes_of(tmp_path / "two", one, settings, jobs=2) == expected
    assert bytes_of(tmp_path / "again", one, settings) == expected
    table = pd.read_csv(tmp_path / "two" / "table.csv")
    assert len(table) == 12
    assert list(table.columns[:3]) == ["delta", "repetition", "quantity"]


def test_a_dask_cluster_gives_the_same_files(tmp_path, serial):
    """A scheduler and two workers, started here as a user would."""
    distributed = pytest.importorskip("distributed")
    one, settings, expected = serial
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        found = bytes_of(tmp_path / "dask", one, settings, dask=cluster.scheduler_address)
    assert found == expected


def test_a_worker_with_other_code_is_refused(tmp_path, monkeypatch):
    one = experiment()
    monkeypatch.setattr(running, "code_version", lambda: "0.0.1+other")
    with pytest.raises(
        RuntimeError, match=r"a worker must have this version of oee_tabular, .*; it has 0\.0\.1\+other"
    ):
        run_experiment(one, tmp_path / "a", one.settings())


def test_a_scheduler_that_does_not_answer_is_said_within_ten_seconds(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("oee_tabular._workers.CONNECT", 1.0)
    start = time.perf_counter()
    with pytest.raises(OSError, match=r"no dask scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        run_experiment(experiment(), tmp_path / "a", experiment().settings(), dask="tcp://127.0.0.1:9")
    assert time.perf_counter() - start < 10
    assert not (tmp_path / "a").exists()
    assert not list(tmp_path.iterdir())


def test_dask_without_the_extra_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match=re.escape("in a clone: pip install '.[dask]'")):
        run_experiment(experiment(), tmp_path / "a", experiment().settings(), dask="tcp://127.0.0.1:9")


def test_a_missing_extra_is_named(tmp_path):
    with pytest.raises(ImportError, match=r"noise needs no_such_module, which is not installed"):
        run_experiment(experiment(requires=("no_such_module",)), tmp_path / "a", experiment().settings())
    lacking = experiment(requires=("no_such_module",), extra="some")
    with pytest.raises(ImportError, match=r"pip install '.\[some\]'$"):
        run_experiment(lacking, tmp_path / "a", experiment().settings())


class Stop(Exception):
    pass


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path):
    log = tmp_path / "log"

    def counted(cell, stream):
        with log.open("a") as handle:
            handle.write(f"{cell['n']},{cell['repetition']}\n")
        if cell["n"] == 2 and cell["repetition"] == 1 and not (tmp_path / "go").exists():
            raise Stop
        return noise(cell, stream)

    one = experiment(counted)
    settings = one.settings()
    with pytest.raises(Stop):
        run_experiment(one, tmp_path / "a", settings)
    assert log.read_text().splitlines() == ["1,0", "2,0", "3,0", "1,1", "2,1"]  # whole repetitions, as far as it came
    cells = tmp_path / "a" / "cells.jsonl"
    cells.write_text(cells.read_text() + '{"key": "half a li')
    (tmp_path / "go").touch()
    sweep = run_experiment(one, tmp_path / "a", settings)
    assert (sweep.computed, sweep.cached, sweep.stale) == (2, 4, 0)
    assert sorted(set(log.read_text().splitlines())) == ["1,0", "1,1", "2,0", "2,1", "3,0", "3,1"]
    assert len(log.read_text().splitlines()) == 7  # the one that failed, twice
    again = run_experiment(one, tmp_path / "a", settings)
    assert (again.computed, again.cached) == (0, 6)
    whole = experiment()
    run_experiment(whole, tmp_path / "b", settings)
    write(one, Store(tmp_path / "a", settings))
    write(whole, Store(tmp_path / "b", settings))
    assert (tmp_path / "a" / "table.csv").read_bytes() == (tmp_path / "b" / "table.csv").read_bytes()


def test_a_killed_process_is_resumed(tmp_path):
    """``kill -9`` on a real command half way; the second run computes only what is missing."""
    command = [sys.executable, "-m", "oee_tabular", "reproduce", "lambda_n", "--smoke", "--seeds", "2", "--jobs", "1"]
    command += ["--output", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    cells = tmp_path / "smoke" / "lambda_n" / "cells.jsonl"
    deadline = time.time() + 60
    while time.time() < deadline and not (cells.exists() and cells.read_text().count("\n")):
        time.sleep(0.01)
    process.kill()
    process.wait()
    kept = cells.read_text().count("\n")
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = re.search(r"(\d+) cells computed(?:, (\d+) from the cache)?", done.stdout)
    assert int(found[1]) + int(found[2] or 0) == 2
    assert int(found[2] or 0) == kept >= 1
    one = EXPERIMENTS["lambda_n"]
    fresh = bytes_of(tmp_path / "fresh", one, one.settings(smoke=True, repetitions=2))
    assert (cells.parent / "table.csv").read_bytes() == fresh["table.csv"]


def test_a_cell_whose_worker_dies_is_run_again(tmp_path):
    def deadly(cell, stream):
        marker = tmp_path / f"died-{cell['n']}"
        if cell["n"] == 2 and not marker.exists():
            marker.touch()
            os._exit(9)
        return noise(cell, stream)

    one = experiment(deadly)
    sweep = run_experiment(one, tmp_path / "a", one.settings(), jobs=2)
    assert sweep.computed == 6
    run_experiment(experiment(), tmp_path / "b", one.settings())
    assert table_of(Store(tmp_path / "a", one.settings())).equals(table_of(Store(tmp_path / "b", one.settings())))


def test_a_cell_that_always_kills_its_worker_ends_the_sweep(tmp_path):
    def deadly(cell, stream):
        os._exit(9)

    with pytest.raises(RuntimeError, match=r"killed 3 times in a row without a finished cell; unfinished: \{'n': 1"):
        run_experiment(
            experiment(deadly, axes={"n": (1,)}), tmp_path / "a", experiment(axes={"n": (1,)}).settings(), jobs=2
        )


# ---- the folder --------------------------------------------------------------------------------------------------


def test_other_settings_are_refused_with_the_difference(tmp_path):
    one = experiment()
    run_experiment(one, tmp_path / "a", one.settings())
    before = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    other = experiment(axes={"n": (1, 2)}).settings(seed=7)
    with pytest.raises(
        ValueError,
        match=r"other settings: seed 0 there, 7 asked; n \[1, 2, 3\] there, \[1, 2\] asked \(--fresh empties it",
    ):
        run_experiment(one, tmp_path / "a", other)
    assert {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()} == before
    sweep = run_experiment(one, tmp_path / "a", other, fresh=True)
    assert sweep.computed == 4


def test_more_seeds_are_added_to_those_that_are_there(tmp_path):
    one = experiment()
    run_experiment(one, tmp_path / "a", one.settings(repetitions=1))
    write(one, Store(tmp_path / "a", one.settings(repetitions=1)))
    sweep = run_experiment(one, tmp_path / "a", one.settings(repetitions=3))
    assert (sweep.computed, sweep.cached) == (6, 3)
    write(one, Store(tmp_path / "a", one.settings(repetitions=3)))
    whole = bytes_of(tmp_path / "b", one, one.settings(repetitions=3))
    assert {name: (tmp_path / "a" / name).read_bytes() for name in whole} == whole
    with pytest.raises(ValueError, match="other settings: repetitions 3 there, 2 asked"):
        Store(tmp_path / "a", one.settings(repetitions=2))


def test_an_interrupted_sweep_is_written_with_the_repetitions_that_it_has(tmp_path):
    def interrupted(cell, stream):
        if cell["repetition"] == 1 and cell["n"] == 3:
            raise Stop
        return noise(cell, stream)

    one = experiment(interrupted)
    with pytest.raises(Stop):
        run_experiment(one, tmp_path / "a", one.settings(repetitions=5))
    sweep = run_experiment(one, tmp_path / "a", one.settings(repetitions=1))
    assert (sweep.computed, sweep.cached) == (0, 3)
    assert list(table_of(Store(tmp_path / "a", one.settings(repetitions=1))).n) == [1, 1, 2, 2, 3, 3]


def test_fresh_does_not_empty_a_folder_of_something_else(tmp_path):
    (tmp_path / "precious").write_text("kept")
    with pytest.raises(ValueError, match=r"must be a results folder to be emptied; it has no settings\.json"):
        run_experiment(experiment(), tmp_path, experiment().settings(), fresh=True)
    assert (tmp_path / "precious").read_text() == "kept"
    with pytest.raises(ValueError, match="must be a folder; it is a file"):
        run_experiment(experiment(), tmp_path / "precious", experiment().settings())


def test_results_of_other_code_are_computed_again(tmp_path):
    one, settings = experiment(), experiment().settings()
    old = Store(tmp_path / "a", settings, code="0.0.0+old")
    old.open()
    old.add(settings.cells()[0], [{"name": "one", "value": -1.0}])
    sweep = run_experiment(one, tmp_path / "a", settings)
    assert (sweep.computed, sweep.cached, sweep.stale) == (6, 0, 1)
    assert (table_of(Store(tmp_path / "a", settings)).value > 0).all()
    keys = {cell_key(settings, settings.cells()[0], code) for code in ("a", "b")}
    assert len(keys) == 2
    assert re.fullmatch(r"[\d.]+\+[0-9a-f]{12}", code_version())


def test_results_of_other_code_are_kept_for_its_return(tmp_path):
    settings = experiment().settings()
    old = Store(tmp_path / "a", settings, code="old")
    old.open()
    old.add(settings.cells()[0], [{"name": "one", "value": -1.0}])
    run_experiment(experiment(), tmp_path / "a", settings)
    assert len(Store(tmp_path / "a", settings, code="old").missing()) == 5


def test_a_folder_that_lost_cells_says_so(tmp_path):
    one, settings = experiment(), experiment().settings()
    run_experiment(one, tmp_path / "a", settings)
    cells = tmp_path / "a" / "cells.jsonl"
    cells.write_text("17\n[]\n{}\n" + "".join(cells.read_text().splitlines(keepends=True)[2:]))
    with pytest.raises(ValueError, match="lacks 2 of 6 cells; run the experiment again"):
        write(one, Store(tmp_path / "a", settings))
    assert run_experiment(one, tmp_path / "a", settings).computed == 2


@pytest.mark.parametrize("text", ["", "[]", '{"editor": 1}'])
def test_a_folder_of_something_else_is_neither_used_nor_emptied(tmp_path, text):
    (tmp_path / "settings.json").write_text(text)
    (tmp_path / "thesis.txt").write_text("kept")
    with pytest.raises(ValueError, match=r"must be the settings of a results folder; it is not"):
        run_experiment(experiment(), tmp_path, experiment().settings())
    with pytest.raises(ValueError, match=r"must hold results only to be emptied; it holds thesis\.txt"):
        run_experiment(experiment(), tmp_path, experiment().settings(), fresh=True)
    assert (tmp_path / "thesis.txt").read_text() == "kept"


def test_jobs_must_be_positive(tmp_path):
    with pytest.raises(ValueError, match="jobs must be a positive number, or -1 for one a core; got 0"):
        run_experiment(experiment(), tmp_path / "a", experiment().settings(), jobs=0)


# ---- the files ---------------------------------------------------------------------------------------------------


def test_the_summary_has_mean_sd_and_standard_error(tmp_path):
    one = experiment(paper=lambda summary: [2.0 if n == 1 else np.nan for n in summary.n])
    run_experiment(one, tmp_path / "a", one.settings())
    table = table_of(Store(tmp_path / "a", one.settings()))
    summary = summary_of(one, table)
    assert len(summary) == 6
    values = table[(table.n == 2) & (table["name"] == "third")].value
    row = summary[(summary.n == 2) & (summary["name"] == "third")].iloc[0]
    assert row["value_mean"] == pytest.approx(values.mean())
    assert row["value_sd"] == pytest.approx(values.std(ddof=1))
    assert row["value_se"] == pytest.approx(values.std(ddof=1) / np.sqrt(2))
    assert row["seeds"] == 2
    first = summary[summary.n == 1].iloc[0]
    assert first["ours / paper"] == pytest.approx(first["value_mean"] / 2.0)
    assert np.isnan(row["ours / paper"])
    write(one, Store(tmp_path / "a", one.settings()))
    page = (tmp_path / "a" / "summary.md").read_text()
    assert "`oee reproduce noise`, 2 seeds a cell (n 1, 2, 3)" in page
    other = one.settings(repetitions=1, seed=4)
    run_experiment(one, tmp_path / "b", other)
    write(one, Store(tmp_path / "b", other))
    assert "`oee reproduce noise --seeds 1 --seed 4`, 1 seeds" in (tmp_path / "b" / "summary.md").read_text()
    assert "| 2 | third | 2 |" in page
    again = figures(one, table, summary)
    assert again["figure.svg"] == (tmp_path / "a" / "figure.svg").read_bytes()
    assert again["figure.png"][:4] == b"\x89PNG"


def test_the_index_lists_what_is_there(tmp_path):
    one = experiment()
    run_experiment(one, tmp_path / "noise", one.settings())
    write(one, Store(tmp_path / "noise", one.settings()))
    other = experiment()
    page = index(tmp_path, [one, Experiment(**{**other.__dict__, "id": "not there"})]).read_text()
    assert "[Noise | and more](noise/summary.md)" in page
    assert "not there" not in page


def test_a_markdown_table():
    frame = pd.DataFrame({"a|b": ["x|y"], "n": [3], "v": [0.123456], "w": [np.nan]})
    assert pipe_table(frame) == "| a\\|b | n | v | w |\n|---|---|---|---|\n| x\\|y | 3 | 0.1235 |  |"


def test_settings_stand_beside_the_results(tmp_path):
    one = experiment()
    run_experiment(one, tmp_path / "a", one.settings(seed=3))
    assert json.loads((tmp_path / "a" / "settings.json").read_text()) == one.settings(seed=3).as_dict()
