"""What stands where a file is to be written: nothing is lost, mixed or left behind."""

import contextlib
import gzip
import hashlib
import json
import multiprocessing
import os
import re
import signal
import socket
import subprocess
import sys
import uuid
from pathlib import Path

import numpy as np
import pytest
from helpers import run_command
from kernels.files import Part, folder_part, waiting_interrupts

import oee_tabular as oee
from oee_tabular.cli import values
from oee_tabular.lab.run import Store, alone

GRID = "gridworld:3,slip=.3"
EVALUATE = f"evaluate --simulator {GRID} --log log.csv --estimators simulator"
# a command without the file that it writes, and a name for the file
FILES = {
    "sample": (f"sample {GRID} --episodes 2 --output", "l.npz"),
    "sample csv": (f"sample {GRID} --episodes 2 --output", "l.csv"),
    "sample csv.gz": (f"sample {GRID} --episodes 2 --output", "l.csv.gz"),
    "sample parquet": (f"sample {GRID} --episodes 2 --output", "l.PARQUET"),
    "sample states": ("sample cartpole --episodes 1 --horizon 3 --output", "l.Npz"),
    "policy": (f"policy {GRID} uniform --output", "p.npy"),
    "export": (f"export {GRID} --output", "m.npz"),
    "counts": ("counts log.csv --output", "c.npz"),
    "plan": (
        f"plan --simulator {GRID} --log log.csv --transitions 9 --output",
        "n.npy",
    ),
    "report": (f"{EVALUATE} --report", "page.html"),
}
REPORT = ("report.json", "table.csv", "values.png", "values.pdf", "values.svg")


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """A command in a folder of its own with log.csv -> (exit code, last line)."""
    monkeypatch.chdir(tmp_path)
    grid = oee.tasks.gridworld(3, 0.3)
    oee.sample_episodes(grid, oee.uniform_policy(grid), 2, 9, seed=0).save("log.csv")

    def command(line):
        code = run_command(*line.split())
        captured = capsys.readouterr()
        return code, (captured.err if code else captured.out).strip()

    return command


def names(folder="."):
    """The names in a folder but log.csv's."""
    return sorted(name for name in os.listdir(folder) if name != "log.csv")


def nowhere(line):
    """The command with a simulator and a log that do not exist."""
    line = line.replace(GRID, "nowhere.npz").replace("log.csv", "nowhere.csv")
    return line.replace("cartpole", "cartpole:nothing=3")


# ---- what stands there: an error before the work


def put(kind, path, target):
    """Something that is no file to be replaced, at ``path``."""
    if kind == "link":
        Path(target).write_text("precious")
        os.symlink(target, path)
    elif kind == "dangling link":
        os.symlink(target, path)
    elif kind == "loop":
        os.symlink(path, path)
    elif kind == "folder":
        os.mkdir(path)
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        with socket.socket(socket.AF_UNIX) as own:
            own.bind(str(path))


KINDS = {
    "link": "a link, to 'target'",
    "dangling link": "a link, to 'target'",
    "loop": "a link, to",
    "folder": "a folder",
    "pipe": "a device, a pipe or a socket",
    "socket": "a device, a pipe or a socket",
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_an_error_before_the_work_without_overwrite(command, name):
    line, file = FILES[name]
    Path(file).write_text("hours of work")
    code, said = command(f"{nowhere(line)} {file}")
    option = line.split()[-1]
    assert (code, said) == (
        2,
        f"oee: {option} must be a new file, or be given with --overwrite; '{file}'"
        " exists already",
    )
    assert Path(file).read_text() == "hours of work"
    assert names() == [file]
    os.link(file, "second")  # another name of the same file keeps what it has
    assert command(f"{line} {file} --overwrite")[0] == 0
    assert Path("second").read_text() == "hours of work"
    assert Path(file).read_bytes() != b"hours of work"
    assert names() == sorted([file, "second"])
    os.remove(file)
    assert command(f"{line} {file}")[0] == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FILES)
def test_what_is_no_file_is_refused_before_the_work(command, name, kind):
    line, file = FILES[name]
    put(kind, file, "target")
    before = names()
    for more in ("", " --overwrite"):
        code, said = command(f"{nowhere(line)} {file}{more}")
        assert code == 2
        assert KINDS[kind] in said or "is a folder" in said
        assert said.startswith(f"oee: {line.split()[-1]} ") or "is a folder" in said
    assert names() == before
    if kind == "link":
        assert Path("target").read_text() == "precious"


@pytest.mark.parametrize("name", FILES)
def test_other_endings_and_folders_are_refused_before_the_work(command, name):
    line, file = FILES[name]
    option = line.split()[-1]
    code, said = command(f"{nowhere(line)} file.pkl")
    assert code == 2
    assert re.search(r"must end in .*; it is 'file\.pkl'", said)
    if option == "--output":  # the folder of a page is made
        assert command(f"{nowhere(line)} no/{file}") == (2, "oee: no such folder: no")
    assert names() == []


@pytest.mark.parametrize("name", FILES)
def test_the_folder_may_be_a_link_and_names_may_be_odd(command, name):
    line, file = FILES[name]
    os.mkdir("real")
    os.symlink("real", "folder")
    stem, dot, ending = file.partition(".")
    long = "ü" * 100 + f"e\u0301{stem}{dot}{ending}"  # 200 bytes and a combined letter
    assert command(f"{line} folder/{long}")[0] == 0
    assert command(f"{line} folder/{file.upper()}")[0] == 0
    assert names("real") == sorted([long, file.upper()])
    assert os.path.islink("folder")


def test_a_minari_folder_is_new_and_asked_for_before_the_work(command, monkeypatch):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", os.path.abspath("root"))
    line = f"sample {GRID} --episodes 2 --output"
    for target in ("set", "minari:own/log-v0"):
        assert command(f"{line} {target}")[0] == 0
        for more in ("", " --overwrite"):
            code, said = command(f"{nowhere(line)} {target}{more}")
            assert code == 2
            assert re.search(r"must be a new folder; '.*' exists already", said)
    os.symlink("nothing", "link")
    assert command(f"{nowhere(line)} link")[0] == 2
    assert names() == ["link", "root", "set"]
    assert names("root/own") == ["log-v0"]


# ---- what comes while the command is at work


COMING = """
from pathlib import Path
import oee_tabular as oee

def sim():
    Path("new").mkdir(exist_ok=True)
    for name in ("l.csv", "p.npy", "m.npz", "n.npy", "page.html", "new/table.csv"):
        Path(name).write_text("another's")
    return oee.tasks.gridworld(3, slip=0.3)
"""
RACES = {
    "sample": "sample coming:sim --episodes 2 --output l.csv",
    "policy": "policy coming:sim uniform --output p.npy",
    "export": "export coming:sim --output m.npz",
    "plan": (
        "plan --simulator coming:sim --log log.csv --transitions 9 --output n.npy"
    ),
    "page": f"{EVALUATE.replace(GRID, 'coming:sim')} --report page.html",
    "folder": f"{EVALUATE.replace(GRID, 'coming:sim')} --output new",
}


@pytest.mark.parametrize("name", RACES)
def test_a_file_that_comes_meanwhile_is_not_replaced(command, name):
    Path("coming.py").write_text(COMING)
    file = "new/table.csv" if name == "folder" else RACES[name].split()[-1]
    code, said = command(RACES[name])
    assert code == 2
    assert "--overwrite" in said
    assert file in said
    assert Path(file).read_text() == "another's"
    assert names("new") == ["table.csv"]
    assert not [one for one in names() if one.endswith(".part")]
    assert command(f"{RACES[name]} --overwrite")[0] == 0
    assert Path(file).read_bytes() != b"another's"


def test_without_hard_links_a_new_file_is_still_a_new_one(command, monkeypatch):
    def refuse(*_, **__):
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    Path("coming.py").write_text(COMING)
    line, file = FILES["policy"]
    assert command(f"{line} {file}")[0] == 0
    assert np.load(file).shape == (9, 4)
    os.remove(file)
    assert command(RACES["policy"])[0] == 2
    assert Path(file).read_text() == "another's"


ROUNDS = [f"policy {GRID} {{}} --output {k}.npy" for k in range(20)]
ROUNDS += [f"{EVALUATE} --policy {{}} --output {k}" for k in range(2)]


def competitor(barrier, folder, policy, codes):
    """Run each command at the same time as the other process."""
    os.chdir(folder)
    for k, line in enumerate(ROUNDS):
        barrier.wait()
        codes.put((k, policy, run_command(*line.format(policy).split())))


def test_of_two_commands_that_write_one_new_file_one_succeeds(command, tmp_path):
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(2)
    codes = context.Queue()
    processes = [
        context.Process(target=competitor, args=(barrier, tmp_path, policy, codes))
        for policy in ("uniform", "optimal")
    ]
    for process in processes:
        process.start()
    got = [codes.get() for _ in range(2 * len(ROUNDS))]
    for process in processes:
        process.join()
    for k, line in enumerate(ROUNDS):
        file = Path(line.split()[-1])
        found = {code: policy for at, policy, code in got if at == k}
        assert sorted(found) == [0, 2]
        if file.suffix:
            is_uniform = bool((np.load(file) == 0.25).all())
        else:
            assert names(file) == sorted(REPORT)
            report = json.loads((file / "report.json").read_text())
            table = (file / "table.csv").read_bytes()
            assert report["files"]["table.csv"] == hashlib.sha256(table).hexdigest()
            is_uniform = report["results"][0]["policy"] == "uniform"
        assert is_uniform == (found[0] == "uniform")
    assert not [name for name in names() if name.endswith(".part")]


# ---- the folder of a report


def test_the_first_command_of_the_readme_runs_twice(command):
    assert command("evaluate --output oee-output --estimators simulator")[0] == 0
    Path("oee-output/notes.txt").write_text("mine")
    first = Path("oee-output/report.json").read_bytes()
    code, said = command("evaluate --output oee-output --estimators simulator,oee")
    assert code == 0
    assert said.endswith(
        "Written: oee-output/report.json, oee-output/table.csv, oee-output/values.png,"
        " oee-output/values.pdf, oee-output/values.svg"
    )
    assert Path("oee-output/report.json").read_bytes() != first
    assert names("oee-output") == sorted([*REPORT, "notes.txt"])
    assert Path("oee-output/notes.txt").read_text() == "mine"


def test_the_report_lists_its_files(command):
    command(f"{EVALUATE} --output out")
    content = json.loads(Path("out/report.json").read_text())
    files = content["files"]
    assert sorted(files) == sorted(REPORT)
    for name in REPORT[1:]:
        data = Path("out", name).read_bytes()
        assert files[name] == hashlib.sha256(data).hexdigest()
    del files["report.json"]
    text = json.dumps(content, indent=2) + "\n"
    own = hashlib.sha256(text.encode()).hexdigest()
    assert json.loads(Path("out/report.json").read_text())["files"] == (
        files | {"report.json": own}
    )
    assert "files" not in json.loads(command(f"{EVALUATE} --json")[1])


def edit(path):
    path.write_bytes(path.read_bytes() + b"\n")


def forget(path):
    """The report as an older version wrote it."""
    content = json.loads(path.read_text())
    del content["files"]
    path.write_text(json.dumps(content, indent=2) + "\n")


def touch_json(path):
    """The same JSON with a number of the user's."""
    content = json.loads(path.read_text())
    content["results"][0]["value"] = 1.0
    path.write_text(json.dumps(content, indent=2) + "\n")


def claim(path):
    """A digest that is no text."""
    content = json.loads(path.read_text())
    content["files"] = ["table.csv"]
    path.write_text(json.dumps(content))


CHANGES = {
    "edited table": ("table.csv", edit),
    "edited picture": ("values.png", edit),
    "a blank in the report": ("report.json", edit),
    "a number in the report": ("report.json", touch_json),
    "an older version": ("report.json", forget),
    "another digest": ("report.json", claim),
    "no JSON": ("report.json", lambda path: path.write_text("[" * 100_000)),
    "a list": ("report.json", lambda path: path.write_text("[]")),
    "no report": ("table.csv", lambda path: (path.parent / "report.json").unlink()),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_file_that_changed_is_an_error_before_the_work(command, name):
    file, change = CHANGES[name]
    assert command(f"{EVALUATE} --output out")[0] == 0
    change(Path("out", file))
    before = {one: Path("out", one).read_bytes() for one in names("out")}
    code, said = command(f"{nowhere(EVALUATE)} --output out")
    assert (code, said) == (
        2,
        "oee: --output must be a folder in which nothing is lost, or be given with"
        f" --overwrite; 'out/{file}' is not as the last oee evaluate of this version"
        " wrote it",
    )
    assert {one: Path("out", one).read_bytes() for one in names("out")} == before
    assert command(f"{EVALUATE} --output out --overwrite")[0] == 0
    assert command(f"{EVALUATE} --output out")[0] == 0
    assert names("out") == sorted(REPORT)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("file", REPORT)
def test_what_is_no_file_in_the_folder_is_refused(command, file, kind):
    os.mkdir("out")
    put(kind, os.path.join("out", file), os.path.abspath("target"))
    before = names("out")
    for more in ("", " --overwrite"):
        code, said = command(f"{nowhere(EVALUATE)} --output out{more}")
        assert code == 2
        assert f"--output must be a regular file, or a new one; 'out/{file}'" in said
    assert names("out") == before


def test_a_link_that_leads_nowhere_is_no_folder(command):
    os.symlink("nothing", "out")
    for line in (f"{nowhere(EVALUATE)} --output out", "bench --output out"):
        code, said = command(line)
        assert code == 2
        assert "must be a folder" in said
    assert names() == ["out"]


def test_the_page_is_not_the_folder(command):
    code, said = command(f"{EVALUATE} --output a.html --report x=./a.html")
    assert code == 2
    assert "--report must be no folder; './a.html' is the folder of --output" in said
    assert names() == []


def test_a_picture_that_is_not_made_any_more_is_removed_unless_it_changed(tmp_path):
    from oee_tabular.report.files import write_report

    both = {"table.csv": b"1", "values.png": b"2"}
    for is_changed in (False, True):
        write_report(tmp_path, {"a": 1}, both)
        if is_changed:
            (tmp_path / "values.png").write_bytes(b"mine")
        write_report(tmp_path, {"a": 1}, {"table.csv": b"3"})
        assert (tmp_path / "values.png").exists() == is_changed
    # a stranger's report that lists other files removes none of them
    (tmp_path / "thesis.txt").write_bytes(b"mine")
    content = {"files": {"thesis.txt": hashlib.sha256(b"mine").hexdigest()}}
    (tmp_path / "report.json").write_text(json.dumps(content))
    write_report(tmp_path, {"a": 1}, both)
    assert (tmp_path / "thesis.txt").exists()


def test_python_replaces_as_numpy_does(tmp_path):
    mdp = oee.tasks.gridworld(2, 0.3)
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 3, 9, seed=0)
    report = oee.evaluate(
        oee.Problem(mdp, log), oee.uniform_policy(mdp), estimators=["simulator"]
    )
    kept = tmp_path / "kept"
    kept.mkdir()
    for name in REPORT:
        (kept / name).symlink_to(tmp_path / name)  # leads nowhere yet
    for path in (tmp_path / "log.npz", tmp_path / "page.html", tmp_path / "out.csv"):
        path.write_text("old")
        (kept / path.name).symlink_to(path)
    for _ in range(2):
        report.save(kept)
        report.to_html(kept / "page.html")
        log.save(kept / "log.npz")
        log.save(kept / "out.csv")
    assert all(path.is_symlink() for path in kept.iterdir())
    assert json.loads((tmp_path / "report.json").read_text())["results"]
    assert len(oee.Transitions.load(tmp_path / "log.npz")) == len(log)
    assert len(oee.Transitions.load(tmp_path / "out.csv")) == len(log)
    assert not list(tmp_path.rglob("*.part"))


# ---- results folders


REPRODUCE = "reproduce estimands --smoke --seeds 1 --jobs 1 --output out"
BENCH = (
    "bench --estimators simulator --families machine --sizes 3 --seeds 1 --jobs 1"
    " --output out"
)
RESULTS = {
    REPRODUCE: ("out/smoke/estimands", "summary.md"),
    BENCH: ("out", "league.csv"),
}


@pytest.mark.parametrize("line", RESULTS)
def test_results_that_changed_are_an_error_before_the_work(command, line, monkeypatch):
    folder, file = map(Path, RESULTS[line])
    assert command(line)[0] == 0
    assert command(line)[0] == 0
    whole = {path.name: path.read_bytes() for path in folder.iterdir()}
    (folder / file).write_text("mine")
    code, said = command(line)
    assert code == 2
    assert f"{str(folder / file)!r} must be as the last run of this version" in said
    assert "(--overwrite replaces it; --output names another folder)" in said
    assert (folder / file).read_text() == "mine"
    assert command(f"{line} --overwrite")[0] == 0
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == whole
    settings = json.loads((folder / "settings.json").read_text())
    assert set(settings["files"]) == set(whole) - {"settings.json", "cells.jsonl"}


@pytest.mark.parametrize("line", RESULTS)
@pytest.mark.parametrize("name", ["table.csv", "cells.jsonl"])
def test_files_of_somebody_else_are_an_error_before_the_work(command, line, name):
    folder = Path(RESULTS[line][0])
    folder.mkdir(parents=True)
    (folder / name).write_text("mine")
    code, said = command(line)
    assert code == 2
    assert f"{str(folder / name)!r} must be as the last run" in said
    assert names(folder) == [name]
    assert (folder / name).read_text() == "mine"
    assert command(f"{line} --overwrite")[0] == 0


def test_an_index_that_changed_is_an_error_before_the_work(command):
    assert command(REPRODUCE)[0] == 0
    index = Path("out/smoke/index.md")
    text = index.read_bytes()
    assert command(REPRODUCE)[0] == 0
    for other in (b"mine", text.replace(b"Results", b"My results"), text + b"\n"):
        index.write_bytes(other)
        code, said = command(REPRODUCE)
        assert code == 2
        assert "'out/smoke/index.md' must be as the last oee reproduce" in said
        assert index.read_bytes() == other
    assert command(f"{REPRODUCE} --overwrite")[0] == 0
    assert index.read_bytes() == text


def test_fresh_empties_no_folder_of_something_else(tmp_path):
    from oee_tabular.lab.experiments.catalogue import EXPERIMENTS

    settings = EXPERIMENTS["estimands"].settings(smoke=True)
    for name in ("thesis.part", ".thesis.part", f".a.{uuid.uuid1().hex}.part"):
        Store(tmp_path, settings).open()
        (tmp_path / name).write_text("mine")
        with pytest.raises(ValueError, match="must hold results only to be emptied"):
            Store(tmp_path, settings, fresh=True)
        (tmp_path / name).unlink()
    (tmp_path / "cells.jsonl").unlink()
    (tmp_path / "settings.json").write_text('{"editor.fontSize": 12}')
    with pytest.raises(ValueError, match="must be the settings of a results folder"):
        Store(tmp_path, settings, fresh=True)
    assert (tmp_path / "settings.json").exists()


# ---- what killed commands leave


def part(folder, name="l.npz", number=None):
    """A part as a killed command leaves it."""
    path = Path(folder) / f".{name}.{(number or uuid.uuid4()).hex}.part"
    path.write_text("half")
    return path


@pytest.mark.parametrize("name", FILES)
def test_the_next_command_removes_the_parts_of_killed_ones(command, name):
    line, file = FILES[name]
    part(".")
    part(".", "x" * 40)
    folder = Path(f".set.{uuid.uuid4().hex}.part")
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "file").write_text("half")
    assert command(f"{line} {file}")[0] == 0
    assert names() == [file]


def test_python_removes_them_and_nothing_else(tmp_path):
    log = oee.Transitions([0], [0], [0])
    log.save(tmp_path / "first.npz")
    part(tmp_path)
    others = [
        part(tmp_path, number=uuid.uuid1()),
        tmp_path / ".x.part",
        tmp_path / f"x.{uuid.uuid4().hex}.part",
        tmp_path / f".x.{uuid.uuid4().hex}.part.txt",
        tmp_path / f".x.{uuid.uuid4().hex[:-1]}.part",
    ]
    for path in others:
        path.write_text("mine")
    link = tmp_path / f".x.{uuid.uuid4().hex}.part"
    link.symlink_to(others[0])
    pipe = tmp_path / f".x.{uuid.uuid4().hex}.part"
    os.mkfifo(pipe)
    log.save(tmp_path / "second.npz")
    found = {path.name for path in tmp_path.iterdir()}
    kept = {path.name for path in (*others, link, pipe)}
    assert found == kept | {"first.npz", "second.npz"}


def test_a_part_that_a_process_writes_is_never_removed(tmp_path):
    log = oee.Transitions([0], [0], [0])
    with contextlib.ExitStack() as stack:
        own = stack.enter_context(Part(str(tmp_path / "own.npz")))
        folder = stack.enter_context(folder_part(tmp_path, "set"))
        own.write(b"half")
        own.flush()
        log.save(tmp_path / "other.npz")
        assert len(list(tmp_path.iterdir())) == 3
        assert folder.is_dir()
    assert [path.name for path in tmp_path.iterdir()] == ["other.npz"]


def test_where_there_are_no_locks_a_part_is_kept_for_a_day(tmp_path, monkeypatch):
    monkeypatch.setattr("oee_tabular._writing._flock", None)
    new = part(tmp_path)
    old = part(tmp_path)
    os.utime(old, (1e9, 1e9))
    oee.Transitions([0], [0], [0]).save(tmp_path / "log.npz")
    assert new.exists()
    assert not old.exists()


def test_a_long_folder_is_looked_through_once_in_a_while(tmp_path, monkeypatch):
    monkeypatch.setattr("oee_tabular._writing.FEW", 3)
    looked = []
    listed = os.listdir
    monkeypatch.setattr(os, "listdir", lambda path: looked.append(1) or listed(path))
    log = oee.Transitions([0], [0], [0])
    for k in range(60):
        log.save(tmp_path / f"{k}.csv")
    assert 4 < len(looked) < 30


KILLED = """
import os, signal, sys

blow, place, number = int(sys.argv.pop(1)), sys.argv.pop(1), int(sys.argv.pop(1))
signal.signal(signal.SIGINT, signal.default_int_handler)
from oee_tabular import _writing
calls = []

def hook(function):
    def killed(*arguments):
        calls.append(1)
        if len(calls) == number:
            os.kill(os.getpid(), blow)
        return function(*arguments)
    return killed

owner = _writing.Part if place in ("sync", "place") else os
setattr(owner, place, hook(getattr(owner, place)))
from oee_tabular.__main__ import main
main()
"""


def killed(line, blow, place, number):
    """The exit code of a command that is killed at the n-th call of a function."""
    words = [sys.executable, "-c", KILLED, str(int(blow)), place, str(number)]
    return subprocess.run(
        [*words, *line.split()], capture_output=True, check=False, text=True
    ).returncode


@pytest.mark.parametrize(
    ("line", "blow", "place", "number"),
    [
        (f"{FILES['sample'][0]} l.npz", signal.SIGKILL, "sync", 1),
        (f"{FILES['sample parquet'][0]} l.parquet", signal.SIGTERM, "fsync", 1),
        (f"{FILES['export'][0]} m.npz", signal.SIGINT, "place", 1),
        (f"{FILES['counts'][0]} c.npz", signal.SIGKILL, "place", 1),
        (f"{FILES['plan'][0]} n.npy", signal.SIGINT, "sync", 1),
        (f"{EVALUATE} --output out", signal.SIGTERM, "sync", 3),
        (f"{EVALUATE} --output out", signal.SIGKILL, "place", 2),
        (f"{EVALUATE} --output out", signal.SIGINT, "place", 3),
        (BENCH, signal.SIGKILL, "place", 6),
        (REPRODUCE, signal.SIGINT, "place", 5),
    ],
)
def test_a_killed_command_leaves_nothing_after_the_next(
    command, line, blow, place, number
):
    code = killed(line, blow, place, number)
    assert code == (130 if blow == signal.SIGINT else -blow)
    assert command(line)[0] == 0
    left = [path.name for path in Path().rglob(".*")]
    assert left == []


@pytest.mark.parametrize("number", [1, 2, 3])
def test_ctrl_c_between_two_names_leaves_files_of_one_run(command, monkeypatch, number):
    assert command(f"{EVALUATE} --output out")[0] == 0
    before = {name: Path("out", name).read_bytes() for name in names("out")}
    replace = os.replace
    calls = []

    def interrupted(*paths):
        calls.append(1)
        if len(calls) == number:
            raise KeyboardInterrupt
        replace(*paths)

    options = {"policy": ["expert", "uniform"], "estimators": "simulator"}
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", interrupted)
        with pytest.raises(KeyboardInterrupt):
            values.evaluate(
                simulator=GRID, log=["log.csv"], output=Path("out"), **options
            )
    after = {name: Path("out", name).read_bytes() for name in names("out")}
    assert sorted(after) == sorted(REPORT)
    changed = [name for name in REPORT if after[name] != before[name]]
    assert changed == ([] if number == 1 else list(REPORT))
    assert command(f"{EVALUATE} --output out")[0] == 0


@pytest.mark.parametrize("ending", ["parquet", "npz", "csv.gz"])
def test_ctrl_c_while_a_file_is_written_keeps_the_old_one(
    tmp_path, monkeypatch, ending
):
    log = oee.Transitions([0], [0], [0])
    path = tmp_path / f"log.{ending}"
    path.write_text("old")
    columns = log.columns

    def interrupted(*arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return columns()

    def wait():
        with waiting_interrupts():
            interrupted()
            done.append(1)

    done = []
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        monkeypatch.setattr(type(log), "columns", interrupted)
        with pytest.raises(KeyboardInterrupt):
            log.save(path)
        with pytest.raises(KeyboardInterrupt):
            wait()
        assert done == [1]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert path.read_text() == "old"
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


# ---- locks


@pytest.mark.parametrize("kind", ["hard link", "link", "dangling link", "text", "pipe"])
def test_a_lock_of_somebody_else_is_neither_written_nor_removed(command, kind):
    os.mkdir("out")
    precious = Path("precious")
    lock = Path("out/.lock")
    precious.write_text("12" if kind == "hard link" else "mine")
    if kind == "hard link":
        lock.hardlink_to(precious)
    elif kind == "text":
        lock.write_text("mine")
    else:
        put(kind, lock, os.path.abspath("target"))
    before = precious.read_text()
    for line in (BENCH, f"{EVALUATE} --output out"):
        code, said = command(line)
        assert code == 2
        assert "'out/.lock' must be a plain file" in said
        assert os.path.lexists(lock)
    assert precious.read_text() == before
    assert kind != "text" or lock.read_text() == "mine"
    assert names("out") == [".lock"]


def test_a_lock_that_a_killed_command_left_is_taken_over(tmp_path):
    (tmp_path / ".lock").write_text("4194304999\n")
    with alone(tmp_path):
        assert (tmp_path / ".lock").read_text() == f"{os.getpid()}\n"
    assert list(tmp_path.iterdir()) == []


def test_a_report_waits_for_no_run_in_its_folder(command, monkeypatch):
    monkeypatch.setattr("oee_tabular._writing.LOCK_SECONDS", 0.0)
    os.mkdir("out")
    with alone(Path("out")):
        code, said = command(f"{EVALUATE} --output out")
    assert code == 2
    assert "out must be used by one command at a time; another" in said
    assert names("out") == []


# ---- endings


@pytest.mark.parametrize("name", ["log.csv.gz", "LOG.CSV.GZ", ".csv.gz", "a.b.Csv.gz"])
def test_a_log_is_written_compressed(tmp_path, name):
    mdp = oee.tasks.gridworld(3, 0.3).with_names([f"s{k}" for k in range(9)])
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 3, 9, seed=0)
    log.save(tmp_path / "plain.csv")
    log.save(tmp_path / name)
    data = (tmp_path / name).read_bytes()
    assert gzip.decompress(data) == (tmp_path / "plain.csv").read_bytes()
    again = tmp_path / "again.csv.gz"
    log.save(again)
    assert again.read_bytes() == data  # no name, no time
    assert data[4:8] == bytes(4)
    back = oee.Transitions.load(tmp_path / name)
    assert (back.next_state == log.next_state).all()
    assert back.reward.tolist() == log.reward.tolist()


def test_states_are_written_compressed(run, tmp_path):
    run("sample cartpole --episodes 1 --horizon 4 --output s.csv.gz")
    assert "ContinuousTransitions(4" in run("info s.csv.gz")
    log = oee.ContinuousTransitions.load("s.csv.gz")
    log.save("again.CSV")
    assert Path("again.CSV").read_bytes() == gzip.decompress(
        Path("s.csv.gz").read_bytes()
    )


@pytest.mark.parametrize("name", ["log", "log.npz", "log.csv", "log.csv.gz"])
def test_every_ending_that_an_error_names_can_be_written(tmp_path, name):
    log = oee.Transitions([0], [0], [0], reward=[1.0], episode=[0])
    with pytest.raises(ValueError, match="must end in") as error:
        log.save(tmp_path / "log.gz")
    if name == "log":
        pytest.importorskip("minari")
        assert "a new Minari folder" in str(error.value)
    else:
        assert name.removeprefix("log") in str(error.value)
    log.save(tmp_path / name)
    assert len(oee.Transitions.load(tmp_path / name)) == 1


def test_counts_of_counts_are_written(command):
    assert command("counts log.csv --output c.npz")[0] == 0
    oee.Transitions.open("c.npz", output="third.npz")
    assert Path("third.npz").read_bytes() == Path("c.npz").read_bytes()


@pytest.mark.parametrize(
    ("kind", "called"),
    [("pipe", "a named pipe"), ("socket", "a socket"), ("loop", "a loop of links")],
)
def test_what_is_no_file_is_called_what_it_is(kind, called, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    put(kind, "log.npz", "target")
    with pytest.raises(OSError, match=rf"it is {called} \(write to a file instead\)"):
        oee.Transitions([0], [0], [0]).save("log.npz")
