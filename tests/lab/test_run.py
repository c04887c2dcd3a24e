"""Tests of the runner.

Every mode gives the same table; interrupted runs resume, also after killed workers, and
dask works.
"""

import os
import re
import signal
import subprocess
import sys

import pandas as pd
import pytest
from helpers import wait_until
from lab.noise import bytes_of, experiment, noise

from oee_tabular.lab import run as running
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.run import run_experiment


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Return the settings and the files of a run in this process."""
    settings = EXPERIMENTS["estimands"].settings(smoke=True, repetitions=3)
    return settings, bytes_of(tmp_path_factory.mktemp("serial"), settings)


def test_serial_and_processes_give_the_same_files(tmp_path, serial):
    settings, expected = serial
    assert bytes_of(tmp_path / "two", settings, jobs=2) == expected
    assert bytes_of(tmp_path / "again", settings) == expected
    table = pd.read_csv(tmp_path / "two" / "table.csv")
    assert len(table) == 12
    assert list(table.columns[:3]) == ["delta", "repetition", "quantity"]


def test_a_dask_cluster_gives_the_same_files(tmp_path, serial):
    """Start a scheduler and two workers here, as a user would."""
    distributed = pytest.importorskip("distributed")
    settings, expected = serial
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=":0",
        silence_logs=50,
    ) as cluster:
        assert (
            bytes_of(tmp_path / "dask", settings, dask=cluster.scheduler_address)
            == expected
        )


def test_a_worker_with_other_code_is_refused(tmp_path, monkeypatch):
    versions = iter(["0.0.1+here", "0.0.1+other"])
    monkeypatch.setattr(running, "code_version", lambda: next(versions))
    text = (
        r"a worker must have this version of oee_tabular, 0\.0\.1\+here; it has"
        r" 0\.0\.1\+other"
    )
    with pytest.raises(RuntimeError, match=text):
        run_experiment(tmp_path / "a", experiment().settings())


def test_dask_that_does_not_answer_or_is_not_installed(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("oee_tabular._parallel.CONNECT", 1.0)
    settings = experiment().settings()
    address = "tcp://127.0.0.1:9"
    with pytest.raises(
        OSError, match=r"no dask scheduler answers at 'tcp://127\.0\.0\.1:9'"
    ):
        run_experiment(tmp_path / "a", settings, dask=address)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        ImportError, match=re.escape("in a clone: pip install '.[dask]'")
    ):
        run_experiment(tmp_path / "a", settings, dask=address)
    assert not list(tmp_path.iterdir())


def test_what_is_refused_before_anything_is_written(tmp_path):
    lacking = experiment(requires=("no_such_module",), extra="some").settings()
    with pytest.raises(
        ImportError, match=r"^noise needs no_such_module, .* pip install '\.\[some\]'$"
    ):
        run_experiment(tmp_path / "a", lacking)
    with pytest.raises(
        ValueError, match="jobs must be a positive number, or -1 for one a core; got 0"
    ):
        run_experiment(tmp_path / "a", experiment().settings(), jobs=0)
    assert not list(tmp_path.iterdir())


class Stop(Exception):
    pass


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path):
    log = tmp_path / "log"

    def counted(cell, stream):
        with log.open("a") as handle:
            handle.write(f"{cell['n']},{cell['repetition']}\n")
        if (
            cell["n"] == 2
            and cell["repetition"] == 1
            and not (tmp_path / "go").exists()
        ):
            raise Stop
        return noise(cell, stream)

    counted.__doc__ = noise.__doc__  # the caption
    settings = experiment(counted).settings()
    with pytest.raises(Stop):
        run_experiment(tmp_path / "a", settings)
    # whole repetitions, as far as it came
    assert log.read_text().splitlines() == ["1,0", "2,0", "3,0", "1,1", "2,1"]
    first = run_experiment(tmp_path / "a", experiment().settings(repetitions=1))
    # what is there can be written with one repetition
    assert (first.computed, first.cached) == (0, 3)
    (tmp_path / "go").touch()
    sweep = run_experiment(tmp_path / "a", settings)
    assert (sweep.computed, sweep.cached, sweep.damaged) == (2, 4, 0)
    assert len(log.read_text().splitlines()) == 7  # the one that failed, twice
    again = run_experiment(tmp_path / "a", settings)
    assert (again.computed, again.cached) == (0, 6)
    assert bytes_of(tmp_path / "a", settings) == bytes_of(
        tmp_path / "b", experiment().settings()
    )


def start_command(output, *more):
    command = [
        sys.executable,
        "-m",
        "oee_tabular",
        "reproduce",
        "lambda_n",
        "--smoke",
        "--seeds",
        "2",
        *more,
    ]
    return (
        subprocess.Popen(
            [*command, "--output", str(output)], stdout=subprocess.DEVNULL
        ),
        command,
    )


def test_a_killed_process_is_resumed(tmp_path):
    """Kill a real command half way with ``kill -9``.

    The second run computes only what is missing.
    """
    process, command = start_command(tmp_path, "--jobs", "1")
    cells = tmp_path / "smoke" / "lambda_n" / "cells.jsonl"
    wait_until(lambda: cells.exists() and cells.read_text().count("\n"), process)
    process.kill()
    process.wait()
    kept = cells.read_text().count("\n")
    done = subprocess.run(
        [*command, "--output", str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
    )
    counts = re.search(r"(\d+) cells computed(?:, (\d+) from the cache)?", done.stdout)
    assert int(counts[1]) + int(counts[2] or 0) == 2
    assert int(counts[2] or 0) == kept >= 1
    fresh = bytes_of(
        tmp_path / "fresh", EXPERIMENTS["lambda_n"].settings(smoke=True, repetitions=2)
    )
    assert (cells.parent / "table.csv").read_bytes() == fresh["table.csv"]


def children_of(number):
    """Return the numbers of the running processes below one, by /proc."""
    pairs = []
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open(f"/proc/{name}/stat") as file:
                state, parent = file.read().rpartition(")")[2].split()[:2]
        except (FileNotFoundError, ProcessLookupError):
            continue
        pairs += [(int(name), int(parent))] if state != "Z" else []
    below = [child for child, parent in pairs if parent == number]
    return [*below, *(more for child in below for more in children_of(child))]


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="looks at /proc")
@pytest.mark.parametrize("blow", [signal.SIGTERM, signal.SIGKILL])
def test_a_command_that_is_ended_leaves_no_worker(tmp_path, blow):
    process, _ = start_command(tmp_path, "--jobs", "2")
    cells = tmp_path / "smoke" / "lambda_n" / "cells.jsonl"
    wait_until(lambda: len(children_of(process.pid)) >= 2, process)
    workers = children_of(process.pid)
    assert cells.exists()
    process.send_signal(blow)
    process.wait()
    wait_until(
        lambda: not any(os.path.exists(f"/proc/{worker}/stat") for worker in workers)
    )


@pytest.mark.parametrize("is_always", [False, True])
def test_a_cell_whose_worker_dies_is_run_again(tmp_path, is_always):
    marker = tmp_path / "died"

    def kill(cell, stream):
        if cell["n"] == 2 and (is_always or not marker.exists()):
            marker.touch()
            os._exit(9)
        return noise(cell, stream)

    settings = experiment(kill, repetitions=1).settings()
    if is_always:
        with pytest.raises(
            RuntimeError,
            match=(
                r"killed 3 times in a row without a finished cell; unfinished: .*'n': 2"
            ),
        ):
            run_experiment(tmp_path / "a", settings, jobs=2)
        return
    sweep = run_experiment(tmp_path / "a", settings, jobs=2)
    assert sweep.computed == 3
    plain = experiment().settings(repetitions=1)
    assert sweep.table().equals(run_experiment(tmp_path / "b", plain).table())
