"""Logs of several files, wherever a command takes a log; an option given twice is refused by its name."""

import json

import pytest

import oee_tabular as oee
from oee_tabular.cli import main

SIMULATOR = ("--simulator", "gridworld:4,slip=0.3")


def run(capsys, *arguments, code=0):
    """What ``oee arguments`` prints, on stderr where an error is expected."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert (ended.value.code or 0) == code
    captured = capsys.readouterr()
    return captured.out if code == 0 else captured.err


@pytest.fixture
def logs(tmp_path):
    """Two files of a folder, each a log of ten episodes."""
    grid = oee.tasks.gridworld(4, 0.1)
    for week in range(2):
        log = oee.sample_episodes(grid, oee.uniform_policy(grid), 10, 20, seed=week)
        log.save(tmp_path / f"week{week}.csv")
    return tmp_path


def ways(folder):
    """The same log as two files, as a pattern and as a folder."""
    return {
        "files": ("--log", folder / "week0.csv", "--log", folder / "week1.csv"),
        "pattern": ("--log", folder / "week*.csv"),
        "folder": ("--log", folder),
    }


@pytest.mark.parametrize("way", ["files", "pattern", "folder"])
@pytest.mark.parametrize(
    "command",
    [
        ("evaluate", "--quick", "--policy", "uniform"),
        ("compare", "--quick", "--policy", "uniform", "--policy", "expert"),
        ("plan", "--transitions", "10"),
    ],
)
def test_a_log_may_be_several_files(capsys, logs, command, way):
    name, *more = command
    both = json.loads(run(capsys, name, *SIMULATOR, *ways(logs)[way], *more, "--json"))
    joined = oee.Transitions.concatenate([oee.Transitions.load(logs / f"week{week}.csv") for week in range(2)])
    joined.save(logs / "joined.npz")
    one = json.loads(run(capsys, name, *SIMULATOR, "--log", logs / "joined.npz", *more, "--json"))
    for record in (both, one):
        record.pop("facts", None)
    assert both == one


@pytest.mark.parametrize("way", ["files", "pattern", "folder"])
def test_info_of_several_files(capsys, logs, way):
    paths = [word for word in ways(logs)[way] if word != "--log"]
    assert "in 20 episodes" in run(capsys, "info", *paths)


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (("evaluate", *SIMULATOR, "--simulator", "gridworld:3", "--log", "x.csv"), "--simulator"),
        (("evaluate", "--quick", "--quick"), "--quick"),
        (("evaluate", "--normalized", "--raw"), "--normalized"),
        (("plan", *SIMULATOR, "--log", "x.csv", "--transitions", "1", "--transitions", "2"), "--transitions"),
        (("sample", "gridworld:3", "--output", "a.csv", "--output", "b.csv"), "--output"),
        (("reproduce", "--seeds", "1", "--seeds", "2"), "--seeds"),
        (("bench", "--jobs", "1", "--jobs", "2"), "--jobs"),
    ],
)
def test_an_option_given_twice_is_refused(capsys, arguments, option):
    assert f"{option} must be given once; it is given 2 times" in run(capsys, *arguments, code=2)


def test_a_pattern_without_files_is_refused(capsys, tmp_path):
    assert "nothing*.csv" in run(capsys, "evaluate", *SIMULATOR, "--log", tmp_path / "nothing*.csv", code=2)
