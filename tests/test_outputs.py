"""What the commands write: full disks, no formulas; one command a folder; Ctrl-C.

What stands there already is in ``test_writing.py``.
"""

import csv
import errno
import json
import os
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pandas as pd
import pytest
from helpers import GIVE_UP_SECONDS, run_command

import oee_tabular as oee
from oee_tabular.lab.run import LOCK, Store, alone

GRID = "gridworld:3,slip=.3"
SAMPLE = f"sample {GRID} --episodes 2 --output"


def command(capsys, line):
    """(exit code, what was printed, what was said on stderr)."""
    code = run_command(*line.split())
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def started(line, **options):
    command = [sys.executable, "-m", "oee_tabular", *line.split()]
    return subprocess.Popen(
        command, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options
    )


# ---- what stands there already


HYPHENS = f"""
evaluate
sample {GRID} --episodes 2
sample cartpole --episodes 1
policy {GRID} uniform
export {GRID}
counts log.csv
plan --simulator {GRID} --log log.csv --transitions 9
reproduce fig1a --smoke
bench
"""


@pytest.mark.parametrize("line", HYPHENS.strip().splitlines())
def test_a_hyphen_is_no_file(tmp_path, monkeypatch, capsys, line):
    monkeypatch.chdir(tmp_path)
    oee.sample_episodes(
        oee.tasks.gridworld(3, 0.3), np.full((9, 4), 0.25), 2, 9, seed=0
    ).save("log.csv")
    code, out, said = command(capsys, f"{line} --output -")
    assert (code, out) == (2, "")
    assert (
        " must be a file; '-', standard input or output, is none (--json prints what a"
        " command found)" in said
    )
    assert [file.name for file in tmp_path.iterdir()] == ["log.csv"]


# ---- a disk that is full


def test_a_full_disk_names_the_file(tmp_path):
    """Processes that may write 100 bytes at most: the error comes in the middle of
    writing, whoever writes.
    """

    def small():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))

    # what is compiled is written, too
    started(f"{SAMPLE} {tmp_path}/log.npz").communicate(timeout=GIVE_UP_SECONDS)
    for name in ("log.npz", "log.csv", "log.parquet"):
        (tmp_path / name).write_text("old")
        process = started(f"{SAMPLE} {tmp_path / name} --overwrite", preexec_fn=small)
        said = process.communicate(timeout=GIVE_UP_SECONDS)[1]
        assert process.returncode == 2
        assert said.splitlines()[-1].startswith(
            f"oee: {tmp_path / name}: cannot be written ("
        )
        assert "Traceback" not in said
        assert (tmp_path / name).read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {
        "log.npz",
        "log.csv",
        "log.parquet",
    }


@contextmanager
def at_most(size):
    """No file may grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    "line", [f"policy {GRID} uniform --output p.npy", f"{SAMPLE} folder"]
)
def test_a_full_disk_names_an_array_and_a_minari_folder(
    tmp_path, capsys, monkeypatch, line
):
    pytest.importorskip("minari")
    monkeypatch.chdir(tmp_path)
    with at_most(100):
        code, _, said = command(capsys, line)
    name = line.split()[-1]
    assert (code, said) == (2, f"oee: {name}: cannot be written (File too large)\n")
    assert list(tmp_path.iterdir()) == []


def test_a_read_only_disk_names_the_file_before_the_work(tmp_path, capsys, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("oee_tabular._files.os.fsync", refuse)
    # says so of what is not there, too
    monkeypatch.setattr("oee_tabular._files.Path.unlink", refuse)
    monkeypatch.setattr("oee_tabular._files.tempfile.TemporaryFile", refuse)
    for line in (
        f"policy {GRID} uniform",
        "counts nothing.csv",
        f"sample {GRID} --episodes 2",
    ):
        name = (
            tmp_path
            / f"{line.split()[0]}.np{'y' if line.startswith('policy') else 'z'}"
        )
        code, _, said = command(capsys, f"{line} --output {name}")
        assert (code, said) == (
            2,
            f"oee: {name}: cannot be written (Read-only file system)\n",
        )


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="has no /dev/full")
@pytest.mark.parametrize("line", ["--help", "reproduce --list", "--version"])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_that_cannot_be_written_is_one_line(line, unbuffered, monkeypatch):
    """What a buffer holds at the end is no second error."""
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with open("/dev/full", "w") as full:
        process = subprocess.run(
            [sys.executable, "-m", "oee_tabular", *line.split()],
            text=True,
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert process.returncode == 2
    assert (
        process.stderr
        == "oee: the output cannot be written (No space left on device)\n"
    )


# ---- spreadsheets

FORMULAS = ["=cmd|'/C calc'!A0", "@SUM(A1)", "+1+1", "-2+3", "\t=1", "\r=1", "＝1"]


@pytest.mark.filterwarnings("ignore:Glyph")  # a tab has none
def test_names_are_no_formulas_in_a_spreadsheet(tmp_path):
    mdp = oee.tasks.gridworld(2, 0.3)
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 3, 9, seed=0)
    policies = dict.fromkeys([*FORMULAS, "plain"], oee.uniform_policy(mdp))
    report = oee.evaluate(
        oee.Problem(mdp, log), policies, estimators=["simulator"], seed=0
    )
    report.save(tmp_path)
    table = pd.read_csv(tmp_path / "table.csv")
    assert sorted(table["policy"].unique()) == sorted(
        [*(f"'{name}".replace("\r", "\n") for name in FORMULAS), "plain"]
    )
    found = json.loads((tmp_path / "report.json").read_text())
    # JSON needs none
    assert {row["policy"] for row in found["results"]} == {*FORMULAS, "plain"}
    with open(tmp_path / "table.csv", newline="") as handle:
        cells = [cell for row in csv.reader(handle) for cell in row]
    assert len(cells) == table.shape[1] * (len(table) + 1)
    assert not [cell for cell in cells if cell.startswith(("=", "@", "+"))]


# ---- two commands in one folder

HOLD = """
import sys, time
from pathlib import Path
from oee_tabular.lab.run import alone
with alone(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(3600)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path / "estimands"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def reproduce(output, **options):
    from oee_tabular.lab.experiments.catalogue import reproduce as run

    settings = {
        "everything": False,
        "smoke": False,
        "seeds": 1,
        "seed": 0,
        "jobs": 1,
        "dask": None,
        "fresh": False,
    }
    return run(
        ["estimands"], output=output, say=lambda text: None, **(settings | options)
    )


@pytest.mark.parametrize("fresh", [False, True])
def test_the_second_command_in_a_folder_is_refused(
    tmp_path, holder, monkeypatch, fresh
):
    from oee_tabular.lab import run as running

    monkeypatch.setattr(
        running, "run_experiment", lambda *_, **__: pytest.fail("it began")
    )
    with pytest.raises(
        ValueError,
        match=(
            r"estimands must be used by one command at a time; another \(process"
            rf" {holder.pid}\)"
        ),
    ):
        reproduce(tmp_path, fresh=fresh)
    with pytest.raises(ValueError, match="must be used by one command at a time"):
        oee.bench.run(
            "oee",
            families=["machine"],
            sizes=[3],
            seeds=1,
            output=tmp_path / "estimands",
            fresh=fresh,
        )


def test_a_dead_process_holds_nothing(tmp_path, holder):
    holder.kill()
    holder.wait()
    folder = tmp_path / "estimands"
    assert (folder / LOCK).exists()  # it could not tidy up
    with (
        alone(folder),
        pytest.raises(ValueError, match="one command at a time"),
        alone(folder),
    ):
        pass
    assert list(folder.iterdir()) == []


def test_a_lock_leaves_nothing_and_takes_no_file_away(tmp_path):
    with alone(tmp_path / "a" / "b"):
        pass
    assert list(tmp_path.iterdir()) == []
    with alone(tmp_path / "c"):
        (tmp_path / "c" / "kept").write_text("x")
    assert [path.name for path in (tmp_path / "c").iterdir()] == ["kept"]


def test_fresh_keeps_the_lock_that_it_holds(tmp_path):
    from oee_tabular.lab.experiments.catalogue import EXPERIMENTS

    settings = EXPERIMENTS["estimands"].settings(smoke=True)
    Store(tmp_path, settings).open()
    with alone(tmp_path):
        Store(tmp_path, settings, fresh=True)
        assert [path.name for path in tmp_path.iterdir()] == [LOCK]


# ---- Ctrl-C


INTERRUPTED = """
import os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell ignores it, and so do its children
module = sys.argv.pop(1)

class Finder:
    def find_spec(self, name, *_):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
from oee_tabular.__main__ import main
main()
"""


def end_by_ctrl_c(script, module, *command):
    """Run a command that Ctrl-C meets where a module is imported; return stderr."""
    process = subprocess.run(
        [sys.executable, "-c", script, module, *command],
        capture_output=True,
        text=True,
        timeout=GIVE_UP_SECONDS,
        check=False,
    )
    assert process.returncode == 130
    return process.stderr


def require_end_by_ctrl_c(script, module, folder):
    """Run a short command until Ctrl-C, which shows no traceback; return stderr."""
    command = ("reproduce", "fig1a", "--smoke", "--output", folder)
    told = end_by_ctrl_c(script, module, *command)
    assert "Traceback" not in told
    return told


def test_ctrl_c_that_a_library_makes_an_error_of(tmp_path):
    """As numba does while it compiles: the exit code is that of Ctrl-C."""
    change = """os.kill(os.getpid(), signal.SIGINT)
"""
    swallowed = """try:
                os.kill(os.getpid(), signal.SIGINT)
                signal.sigtimedwait([], 1)
            except KeyboardInterrupt:
                raise RuntimeError("no compiled object yet") from None
"""
    assert change in INTERRUPTED
    script = INTERRUPTED.replace(change, swallowed)
    require_end_by_ctrl_c(script, "oee_tabular.lab.experiments.catalogue", tmp_path)


@pytest.mark.parametrize(
    "module",
    ["oee_tabular.cli", "typer", "oee_tabular.lab.experiments.catalogue", "numpy"],
)
def test_ctrl_c_while_a_module_is_imported_ends_without_a_traceback(module, tmp_path):
    """What is imported before the command begins, and what it imports as it goes."""
    told = require_end_by_ctrl_c(INTERRUPTED, module, tmp_path)
    assert "KeyboardInterrupt" not in told


def test_ctrl_c_that_a_destructor_drops_is_raised_again(tmp_path):
    """Python prints what is raised in __del__, as of a compiler's objects, and goes on."""
    change = """os.kill(os.getpid(), signal.SIGINT)
"""
    dropped = """Dropped()
"""
    destructor = """class Dropped:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        signal.sigtimedwait([], 1)

class Finder"""
    script = INTERRUPTED.replace(change, dropped).replace("class Finder", destructor)
    module = "oee_tabular.lab.experiments.catalogue"
    command = ("reproduce", "estimands", "--seeds", "4000", "--output", tmp_path)
    told = end_by_ctrl_c(script, module, *command)
    assert "Exception ignored in" in told
    assert told.count("oee: interrupted") == 1


def test_what_ctrl_c_cut_in_two_is_not_taken_down(tmp_path):
    """As a compiler's object, which may crash where Python takes its modules down."""
    crash = """class Late:
    def __init__(self):
        self.crash = os._exit

    def __del__(self):
        self.crash(3)

sys.late = Late()

class Finder"""
    script = INTERRUPTED.replace("class Finder", crash)
    require_end_by_ctrl_c(script, "oee_tabular.lab.experiments.catalogue", tmp_path)


@pytest.mark.parametrize("module", ["loky", "multiprocessing"])
def test_workers_that_ctrl_c_found_starting_are_ended_too(tmp_path, module):
    """Nobody tells them to end, and what Python does at its end would wait for them."""
    pytest.importorskip("joblib")
    start = {
        "loky": """from joblib.externals.loky.backend import get_context
        worker = get_context("loky").Process(target=time.sleep, args=(10_000,))
        """,
        "multiprocessing": """import multiprocessing
        worker = multiprocessing.get_context("spawn").Process(
            target=time.sleep, args=(10_000,)
        )
        """,
    }[module]
    busy = f"""import time
            {start.replace(chr(10), chr(10) + "    ")}worker.start()
            print("worker", worker.pid, file=sys.stderr)
            os.kill(os.getpid(), signal.SIGINT)
"""
    change = """os.kill(os.getpid(), signal.SIGINT)
"""
    script = INTERRUPTED.replace(change, busy)
    # the script is a file, which a process that is started anew can find
    path = tmp_path / "command.py"
    path.write_text(
        script.replace(
            "from oee_tabular.__main__",
            "if __name__ == '__main__':\n    from oee_tabular.__main__",
        ).replace("\nmain()", "\n    main()")
    )
    process = subprocess.run(
        [
            sys.executable,
            path,
            "oee_tabular.lab.experiments.catalogue",
            "reproduce",
            "fig1a",
            "--smoke",
            "--output",
            tmp_path / "out",
        ],
        capture_output=True,
        text=True,
        timeout=GIVE_UP_SECONDS,
        check=False,
    )
    assert process.returncode == 130, process.stderr
    with pytest.raises(ProcessLookupError):
        os.kill(int(process.stderr.split()[1]), 0)


def test_ctrl_c_after_the_end_of_a_command_changes_nothing():
    """When Python takes its modules down, handlers of signals are gone."""
    late = """
class Late:
    def __init__(self):
        self.kill, self.process = os.kill, os.getpid()

    def __del__(self):
        self.kill(self.process, 2)

sys.late = Late()
"""
    script = INTERRUPTED.replace("sys.meta_path", f"{late}\nsys.meta_path")
    process = subprocess.run(
        [sys.executable, "-c", script, "no_such_module", "--version"],
        capture_output=True,
        text=True,
        timeout=GIVE_UP_SECONDS,
        check=False,
    )
    assert (process.returncode, process.stderr) == (0, "")
    assert process.stdout.startswith("oee ")


def test_the_script_is_the_one_that_catches_it():
    import tomllib
    from pathlib import Path

    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())[
        "project"
    ]
    assert project["scripts"]["oee"] == "oee_tabular.__main__:main"
