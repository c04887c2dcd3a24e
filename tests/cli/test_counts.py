"""``oee counts``, and the counts file as the log of the other commands; ``--quick``."""

import json

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.cli import main

pytest.importorskip("pyarrow")


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "log"
    place.mkdir()
    grid = oee.tasks.gridworld(3, slip=0.1)
    for k in range(3):
        oee.sample_episodes(grid, oee.uniform_policy(grid), 10, 20, seed=k).save(place / f"part-{k}.parquet")
    return place


def run(*arguments):
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as ended:
        return ended.code
    return 0


def rows(capsys, *arguments):
    assert run("evaluate", "--simulator", "gridworld:3,slip=0.3", "--policy", "optimal", "--json", *arguments) == 0
    return json.loads(capsys.readouterr().out)


def test_counts_stand_for_the_log(folder, tmp_path, capsys):
    output = tmp_path / "counts.npz"
    assert run("counts", folder, "--output", output, "--simulator", "gridworld:3,slip=0.3") == 0
    told = capsys.readouterr().out
    assert told.startswith(f"{output}: ")
    assert "of 3 files in 30 episodes" in told
    parts = [oee.Transitions.load(path) for path in sorted(folder.iterdir())]
    oee.Transitions.concatenate(parts).save(tmp_path / "log.npz")
    ours, plain = (rows(capsys, "--log", tmp_path / name) for name in ("counts.npz", "log.npz"))
    assert [row["value"] for row in ours["results"]] == [row["value"] for row in plain["results"]]
    assert [row["lower"] for row in ours["results"]] == [row["lower"] for row in plain["results"]]
    assert run("info", output) == 0
    assert "TransitionCounts(" in capsys.readouterr().out
    assert run("plan", "--simulator", "gridworld:3,slip=0.3", "--log", output, "--transitions", "50") == 0


def test_quick_leaves_likelihood_intervals_out(folder, capsys):
    found = rows(capsys, "--log", folder / "part-0.parquet", "--quick")
    assert not [row for row in found["results"] if row.get("interval_method") == "likelihood"]
    assert [
        row
        for row in rows(capsys, "--log", folder / "part-0.parquet")["results"]
        if row["interval_method"] == "likelihood"
    ]
    arguments = ("--simulator", "gridworld:3,slip=0.3", "--log", folder / "part-0.parquet", "--quick", "--guaranteed")
    assert run("evaluate", *arguments) == 2
    assert "guaranteed must be False where quick is True" in capsys.readouterr().err


def test_bad_rows_are_refused_or_dropped(folder, tmp_path, capsys):
    part = oee.Transitions.load(folder / "part-1.parquet").columns()
    part["state"] = np.where(np.arange(len(part["state"])) == 5, 77, part["state"])
    import pandas as pd

    pd.DataFrame(part).to_parquet(folder / "part-1.parquet", index=False)
    arguments = ("counts", folder, "--output", tmp_path / "c.npz", "--simulator", "gridworld:3,slip=0.3")
    assert run(*arguments) == 2
    assert "part-1.parquet': state[5] must be in 0..8; it is 77" in capsys.readouterr().err
    assert not (tmp_path / "c.npz").exists()
    assert run(*arguments, "--bad-rows", "drop") == 0
    told = capsys.readouterr().out
    assert "1 bad rows dropped, 1 episodes broken" in told
    assert "part-1.parquet': state[5] must be in 0..8; it is 77" in told
    assert "1 bad rows of the log were not counted" in str(rows(capsys, "--log", tmp_path / "c.npz")["warnings"])
    assert run(*arguments) == 2
    assert "--output must be a new file, or be given with --overwrite" in capsys.readouterr().err
    assert run(*arguments, "--bad-rows", "drop", "--overwrite") == 0


def test_a_scheduler_that_does_not_answer(folder, tmp_path, capsys):
    pytest.importorskip("distributed")
    assert run("counts", folder, "--output", tmp_path / "c.npz", "--dask", "tcp://127.0.0.1:9") == 2
    assert "no dask scheduler answers at 'tcp://127.0.0.1:9'" in capsys.readouterr().err
