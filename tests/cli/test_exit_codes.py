"""The exit codes of all commands: each that ``details`` names, and no other."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.__main__ import main
from oee_tabular.cli import Command, app
from oee_tabular.cli.details import EXIT_CODES

DATA = "--simulator sim.npz --log log.csv"
# command -> a line that succeeds; lines that are refused
LINES = {
    "evaluate": (
        f"{DATA} --estimators simulator --output out --report page.html",
        f"{DATA} --estimators oracle",
        f"{DATA} --estimators simulator --output page.html",
        f"{DATA} --estimators simulator --report page.html",
        f"{DATA} --confidence 2",
        "--simulator sim.npz --log nowhere.csv",
        "--simulator nowhere.npz --log log.csv",
        "--no-such-option",
    ),
    "compare": (
        f"{DATA} --policy uniform --policy optimal --quick",
        f"{DATA} --policy uniform",
        f"{DATA} --policy uniform --policy none.npy",
    ),
    "improve": (
        f"{DATA} --running uniform --report i.html",
        f"{DATA} --running none.npy",
        f"{DATA} --running uniform --unrecorded much",
        f"{DATA} --running uniform --candidate running=optimal",
        f"{DATA} --running uniform --report i.txt",
    ),
    "plan": (
        f"{DATA} --transitions 9 --output n.npy",
        f"{DATA} --transitions 9 --output n.npy",
        f"{DATA} --transitions 0",
        f"{DATA} --transitions many",
        f"{DATA} --transitions 9 --output n.txt",
    ),
    "sample": (
        "sim.npz --episodes 2 --output l.csv",
        "sim.npz --episodes 2 --output l.csv",
        "sim.npz --output m.csv",
        "sim.npz --episodes 2",
        "sim.npz --episodes 2 --output nowhere/l.csv",
    ),
    "policy": (
        "sim.npz uniform --output p.npy",
        "sim.npz uniform --output p.npy",
        "sim.npz best --output q.npy",
        "log.csv uniform --output q.npy",
    ),
    "export": (
        "sim.npz --output e.npz",
        "sim.npz --output e.npz",
        "nothing.csv --output f.npz",
        "log.csv --output log.csv",
        "log.csv --output log.csv --overwrite",
        "folder --output f.npz",
        "sim.npz --output f.npy",
        "sim.npz --output f.npz --action-noise 2",
    ),
    "counts": (
        "log.csv --output c.npz",
        "log.csv --output c.npz",
        "sim.npz --output d.npz",
        "log.csv log.csv --output d.npz",
        "log.csv --output d.csv",
    ),
    "info": ("sim.npz", "nowhere.npz", "", "sim.npz --output x"),
    "reproduce": (
        "estimands --smoke --seeds 1 --jobs 1 --output results",
        "estimands --smoke --seeds 1 --jobs 1 --seed 3 --output results",
        "nothing",
        "",
    ),
    "bench": (
        "--estimators simulator --families machine --sizes 3 --seeds 1 --jobs 1"
        " --output bench",
        "--estimators simulator --families machine --sizes 4 --seeds 1 --jobs 1"
        " --output bench",
        "--families nothing",
        "--output log.csv --families machine",
    ),
    "check": (
        "own_check:fair --repetitions 3",
        "own_check:nothing",
        "nowhere:nothing",
        "own_check",
    ),
}
OWN = """
import oee_tabular as oee

def fair():
    return oee.estimators.ModelBased()

def broken(problem, policy, *, seed=None):
    return oee.estimators.Estimate(float("nan"), 0.0)
"""


@pytest.fixture
def code(folder, monkeypatch, capsys):
    """The exit code of a whole command, as the shell sees it."""
    Path("own_check.py").write_text(OWN)
    os.mkdir("folder")
    np.save("own.npy", np.full((9, 4), 0.25))

    def code(line):
        monkeypatch.setattr(sys, "argv", ["oee", *line.split()])
        with pytest.raises(SystemExit) as ended:
            main()
        number = ended.value.code or 0
        told = capsys.readouterr()
        assert number in EXIT_CODES, told.err
        if number == 2:
            assert re.search(r"(^|\n)(oee: |Error: |Usage: )", told.err)
        return number

    return code


def contents(folder="."):
    return {
        path: path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_every_command_has_lines():
    commands = {
        (command.name or command.callback.__name__)
        for command in app.registered_commands
    }
    assert set(LINES) == commands


@pytest.mark.parametrize("name", LINES)
def test_success_is_0_and_a_refused_command_changes_nothing(code, name):
    right, *wrong = LINES[name]
    assert code(f"{name} {right}") == 0
    assert code(f"{name} --help") == 0
    before = contents()
    for line in wrong:
        assert code(f"{name} {line}") == 2
        assert contents() == before, line


def test_improve_is_3_where_nothing_is_to_be_deployed(code):
    assert code(f"improve {DATA} --running uniform") == 0
    # what runs is the best already: keep
    assert code(f"improve {DATA} --running optimal --json") == 3
    # a log of a few transitions: record
    oee.Transitions.load("log.csv").first(12).save("log.csv")
    assert code(f"improve {DATA} --running uniform") == 3


def test_a_law_that_does_not_hold_is_1(code):
    assert code("check own_check:broken --repetitions 3") == 1


def test_compare_is_3_where_the_first_policy_is_not_found_to_be_the_best(code):
    best, any_one, near = (
        f"--policy {name}" for name in ("best=optimal", "any=uniform", "near=mix:0.999")
    )
    words = f"compare {DATA} --horizon 30 --quick"
    assert code(f"{words} --expect-best {best} {any_one}") == 0
    assert code(f"{words} --expect-best {any_one} {best}") == 3
    assert code(f"{words} --expect-best {any_one} {best} --json") == 3
    # without the option another best policy is an answer as well
    assert code(f"{words} {any_one} {best}") == 0
    # the same policy twice, and a log that cannot say
    assert code(f"{words} --expect-best {best} --policy same=optimal") == 3
    oee.Transitions.load("log.csv").first(12).save("log.csv")
    assert code(f"{words} --expect-best {best} {near}") == 3
    # a command that is refused says so by another code
    assert code(f"{words} --expect-best {best}") == 2


@pytest.mark.parametrize("name", LINES)
def test_ctrl_c_is_130(code, monkeypatch, name):
    def interrupted(*_):
        raise KeyboardInterrupt

    before = contents()
    monkeypatch.setattr(Command, "invoke", interrupted)
    assert code(f"{name} {LINES[name][0]}") == 130
    assert contents() == before


@pytest.mark.parametrize("text", ["raise KeyboardInterrupt", "def f(: pass"])
def test_ctrl_c_within_the_text_of_a_library_ends_with_a_code_too(tmp_path, text):
    """Not by a signal, which Python sends itself where an ``exec`` was interrupted."""
    (tmp_path / "robot.py").write_text(f"exec({text!r})\n")
    line = "sample robot:make --transitions 5 --output log.npz"
    done = subprocess.run(
        [sys.executable, "-m", "oee_tabular", *line.split()],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == (130 if "Keyboard" in text else 2)
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="only Linux has it")
@pytest.mark.parametrize("is_closed", [True, False])
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("info nowhere.npz", 2),
        ("evaluate --seed 1.5", 2),
        ("nothing", 2),
        ("sample gridworld:3 --transitions 0 --output l.csv", 2),
        ("export gridworld:3,slip=0.3 --output e.npz", 0),
        ("export warns.csv --initial 0 --output e.npz", 0),
        ("sample interrupts:make --transitions 3 --output l.csv", 130),
    ],
)
def test_the_code_is_the_same_where_errors_cannot_be_written(
    tmp_path, line, expected, is_closed
):
    (tmp_path / "interrupts.py").write_text("raise KeyboardInterrupt")
    (tmp_path / "warns.csv").write_text(
        "state,action,next_state,reward,note\n0,0,0,1,7\n"
    )
    words = [sys.executable, "-P", "-m", "oee_tabular", *line.split()]
    shell = shlex.join(words) + (" 2>&-" if is_closed else " 2>/dev/full")
    # a buffer that cannot be written is an error of its own where Python ends
    surroundings = {**os.environ}
    surroundings.pop("PYTHONUNBUFFERED", None)
    done = subprocess.run(
        ["sh", "-c", shell], cwd=tmp_path, env=surroundings, check=False
    )
    assert done.returncode == expected


def test_the_how_to_has_the_table():
    page = (Path(oee.__file__).parents[1] / "notebooks" / "how_to.md").read_text()
    rows = re.findall(r"^\| (\d+) \| (.*) \|$", page, re.M)
    assert {int(number): text for number, text in rows} == EXIT_CODES
