"""The frame of the command: help, options, errors, JSON, progress, and what it imports."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest
import typer.main

import oee_tabular as oee
from oee_tabular.cli import app
from oee_tabular.cli.details import DETAILS, JSON_KEYS, details_of

COMMANDS = typer.main.get_command(app).commands
SAMPLE = "sample gridworld:3,slip=0.1 --output"
SLOW = {
    "cvxpy",
    "pandas",
    "pyarrow",
    "gymnasium",
    "matplotlib",
    "oee_tabular.testing",
    "oee_tabular.continuous.task.base",
}


def test_nothing_slow_is_imported_without_need(folder):
    np.save("p.npy", np.full((9, 4), 0.25))
    evaluate = [
        "evaluate",
        "--simulator",
        "sim.npz",
        "--log",
        "log.csv",
        "--policy",
        "p.npy",
    ]
    for words, slow, text in (
        (["--help"], SLOW | {"numba", "scipy"}, "evaluate"),
        (evaluate, SLOW, "the simulator, corrected by the log"),
    ):
        script = (
            f"import sys, oee_tabular.cli as c\ntry:\n    c.main({words})\nexcept"
            " SystemExit:\n    pass\n"
        )
        script += f"print(sorted({slow} & set(sys.modules)))"
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        )
        assert text in done.stdout
        assert done.stdout.endswith("\n[]\n")


@pytest.mark.parametrize("asked", ["-h", "--help"])
def test_help_in_groups(run, asked):
    text = run("evaluate", asked)
    titles = [
        line
        for line in text.splitlines()
        if line.endswith(":") and not line.startswith(" ")
    ]
    groups = ["Input:", "Value:", "Output:", "Options:"]
    values = ["Values of SIM:", "Values of SPEC:", "Values of --estimators:"]
    assert titles == groups + values
    assert "--simulator SIM" in text
    assert "<" not in text
    assert "`" not in text
    commands = run(asked)
    assert "--install-completion" in commands
    assert "..." not in commands.split("Commands:")[1]
    assert run("--version").startswith("oee 0.")


def test_help_is_short(run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert len(run("evaluate --help").splitlines()) <= 112
    for command in COMMANDS.values():
        for parameter in command.params:
            assert len(parameter.help) <= 120, parameter.help
            assert parameter.help.endswith((".", "..."))
            assert not re.search(r"[^.]\.\s", parameter.help), parameter.help


def test_details_are_of_options_that_exist_and_on_the_page_of_their_command():
    unused = set(DETAILS)
    for name, command in COMMANDS.items():
        for title, forms in details_of(name, command.params).items():
            assert f"**Values of `{title}`**:" in command.epilog
            unused -= {key for key, known in DETAILS.items() if known is forms}
            for form, meaning in forms.items():
                assert f"* `{form}`: {meaning}" in command.epilog
        # a typographer would make a dash of two hyphens
        assert "--" not in re.sub("`[^`]*`", "", command.epilog + command.help)
        for parameter in command.params:
            assert "--" not in re.sub("`[^`]*`", "", parameter.help)
    assert not unused


def test_options_keep_their_help_where_docstrings_are_stripped():
    words = [sys.executable, "-OO", "-m", "oee_tabular", "evaluate", "--help"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "Level of the intervals." in done.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_options_are_few_and_each_has_its_group_and_a_word_for_its_value(run, name):
    options = [p for p in COMMANDS[name].params if p.param_type_name == "option"]
    assert len(options) <= {"evaluate": 35, "improve": 19}.get(name, 18)
    text = run(name, "--help")
    for option in options:
        assert option.opts[0] in text
        assert option.rich_help_panel in ("Input", "Value", "Output")
        assert option.help
        assert option.is_flag or option.metavar


SINGLE = []
for command_name, command in COMMANDS.items():
    for parameter in command.params:
        if parameter.param_type_name == "option" and not parameter.multiple:
            SINGLE.append((command_name, parameter))


@pytest.mark.parametrize(
    ("name", "option"), SINGLE, ids=lambda value: getattr(value, "name", value)
)
def test_an_option_given_twice_is_refused(run, name, option):
    word = option.opts[0] if option.is_flag else f"{option.opts[0]} 1"
    places = " ".join(
        "1" for p in COMMANDS[name].params if p.param_type_name == "argument"
    )
    needed = [
        p
        for p in COMMANDS[name].params
        if p.required and p.param_type_name == "option" and p is not option
    ]
    words = " ".join(f"{p.opts[0]} 1" for p in needed)
    said = run(name, places, words, word, word, code=2)
    assert said == f"oee: {option.opts[0]} must be given once; it is given 2 times\n"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (
            "evaluate --simulator gridworld:4,slip=0.3",
            "--log must be given with --simulator",
        ),
        ("evaluate --log x.npz", "--simulator must be given with --log"),
        ("evaluate --estimators oe", "got 'oe' (did you mean 'oee'?)"),
        (
            "evaluate --target gridworld:10,slip=0.1",
            "--target needs --simulator and --log",
        ),
        ("evaluate --initial 1", "--initial needs --simulator and --log"),
        ("evaluate --features f.npy", "--features needs --simulator and --log"),
        ("evaluate --confidence 1.5", "--confidence must be in (0, 1); it is 1.5"),
        ("evaluate --horizon 0", "--horizon must be a positive integer; it is 0"),
        (
            "evaluate --rewards mine",
            "--rewards must be one of 'simulator', 'log'; got 'mine'",
        ),
        ("evaluate --policy mix:x", "--policy must be like mix:0.5; got 'mix:x'"),
        ("evaluate --policy best", "or a .npy, .npz or .csv file; got 'best'"),
        ("evaluate --policy optimum", "got 'optimum' (did you mean 'optimal'?)"),
        (
            "evaluate --policy a=uniform --policy a=optimal",
            "--policy names must differ; 'a' is given twice",
        ),
        (
            "evaluate --policy =uniform",
            "--policy must have a name before its '='; got '=uniform'",
        ),
        ("evaluate --policy nowhere.npy", "no such file: nowhere.npy"),
        (
            "evaluate --output /proc/version/below",
            "--output must be a folder that can be written",
        ),
        ("evaluate --report x", "must end in .html or .htm; it is 'x'"),
        ("evaluate --report title=", "must end in .html"),
        ("evaluate --quick --guaranteed", "--guaranteed must be left out with --quick"),
        (f"{SAMPLE} l.npz", "one of --transitions and --episodes must be given"),
        (
            f"{SAMPLE} l.npz --transitions 0",
            "--transitions must be a positive integer; it is 0",
        ),
        (
            f"{SAMPLE} l.npz --episodes 1 --horizon 0",
            "--horizon must be a positive integer; it is 0",
        ),
        (f"{SAMPLE} l.npz --episodes 1 --seed -1", "Invalid value for '--seed'"),
        (f"{SAMPLE} l.txt --episodes 1", "must end in .npz, .csv, .csv.gz, .parquet"),
        (
            "sample FrozenLake-v1 --output l.npz --episodes 0",
            "--episodes must be a positive integer; it is 0",
        ),
        ("sample nowhere-v1 --episodes 1 --output l.npz", "'nowhere-v1' is neither"),
        ("compare --policy uniform --policy expert", "Missing option '--simulator'"),
        ("info nowhere.npz", "no such file: nowhere.npz"),
        ("info nofile", "no such file: nofile"),
    ],
)
def test_errors_are_one_line_and_leave_nothing(run, tmp_path, words, text):
    assert text in " ".join(run(words, code=2).split())
    assert list(tmp_path.iterdir()) == []


def test_warnings_are_lines_not_python(tmp_path):
    (tmp_path / "typo.csv").write_text("state,action,next_obs,battery\n0,0,3,0.25\n")
    words = [sys.executable, "-m", "oee_tabular", "info", "typo.csv"]
    done = subprocess.run(
        words, capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stderr.startswith("oee: warning: ")
    assert "it reads 'next_obs' as next_state" in done.stderr
    assert "left out: battery" in done.stderr
    assert ".py" not in done.stderr


DATA = "--simulator sim.npz --log log.csv"
SHORT = {
    "evaluate": f"{DATA} --estimators simulator",
    "compare": f"{DATA} --policy uniform --policy optimal --quick",
    "improve": f"{DATA} --running uniform",
    "plan": f"{DATA} --transitions 50 --horizon 20",
    "sample": "gridworld:3,slip=0.1 --episodes 2 --output l.npz",
    "policy": "sim.npz uniform --output p.npy",
    "export": "gridworld:3,slip=0.1 --output e.npz",
    "counts": "log.csv --output c.npz",
    "info": "sim.npz",
    "reproduce": "--list",
    "bench": "--sizes 1 --seeds 1 --families ring --jobs 1 --output b",
    "check": "mine:Mine --repetitions 3",
}


def test_every_command_has_json_with_the_keys_of_its_details(run, folder):
    assert set(SHORT) == set(COMMANDS)
    # which take longer, and have tests of their own
    for name in set(SHORT) - {"bench", "check"}:
        found = json.loads(run(name, SHORT[name], "--json"))
        keys = re.sub(r" \([^)]*\)", "", JSON_KEYS[name]).split(", ")
        assert set(found) == set(keys)
        assert found["version"] == oee.__version__


def test_json_is_alone_on_stdout(folder):
    script = (
        "import sys; from oee_tabular import _progress; _progress.SECONDS = 0.001\n"
    )
    script += "from oee_tabular.cli import main; main(sys.argv[1:])"
    words = f"evaluate {SHORT['evaluate']} --json".split()
    done = subprocess.run(
        [sys.executable, "-c", script, *words],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "results" in json.loads(done.stdout)
    assert re.match(r"oee: \d+ s: ", done.stderr)


def test_progress_names_policies_and_intervals(folder, monkeypatch):
    steps = []
    monkeypatch.setattr("oee_tabular._progress.report_step", steps.append)
    problem = oee.Problem(
        oee.FiniteMDP.load("sim.npz"), oee.Transitions.load("log.csv")
    )
    oee.evaluate(
        problem, {"a": np.full((9, 4), 0.25), "b": [0] * 9}, estimators=["oee"]
    )
    work = [
        f"{work} of “a” (policy 1 of 2) {work} of “b” (policy 2 of 2)"
        for work in ("oee", "likelihood interval")
    ]
    assert " ".join(steps) == " ".join(
        [*work, "comparison of the policies, and what to record next"]
    )


def test_overwrite_says_of_each_command_what_it_replaces(run, monkeypatch):
    """Only a folder has files that are replaced unasked; a page is a file as others."""
    monkeypatch.setenv("COLUMNS", "200")
    of_page = "Replace an existing --report, and files of the --output folder that"
    of_folder = "Replace also files of the folder that the command did not write"
    for command in ("evaluate", "reproduce", "bench", "improve", "plan", "export"):
        text = run(f"{command} --help")
        assert (of_page in text) == (command == "evaluate")
        assert (of_folder in text) == (command in ("reproduce", "bench"))
        is_file = command in ("improve", "plan", "export")
        assert ("Replace a file that exists" in text) == is_file


def test_help_says_what_a_table_of_a_simulator_is(run, monkeypatch):
    """Only ``export`` takes one, and its help has the names of the columns."""
    monkeypatch.setenv("COLUMNS", "200")
    fields = "state, action, next_state, probability and reward"
    for command in ("evaluate", "plan", "policy", "sample"):
        text = run(f"{command} --help")
        assert "FILE.csv                    No simulator yet; oee export makes" in text
        assert fields not in text
    text = run("export --help")
    assert "No simulator yet" not in text
    assert f"FILE.csv                    A table with the columns {fields}" in text
    for command in ("export", "info"):
        assert "a simulator's table or a log calls" in run(f"{command} --help")
