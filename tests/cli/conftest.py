"""What tests of the command share."""

import shlex
import warnings

import pytest

import oee_tabular as oee
from oee_tabular.cli import main


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """``oee`` with words, in strings, in a folder of its own: stdout, or the one line on stderr where an error is expected."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)

    def run(*words, code=0):
        with pytest.raises(SystemExit) as ended:
            main(shlex.split(" ".join(str(word) for word in words)))
        captured = capsys.readouterr()
        assert (ended.value.code or 0) == code, captured.err
        if code == 0:
            return captured.out
        assert captured.err.startswith(("oee: ", "Usage: "))
        assert captured.err.count("\n") == 1 or captured.err.startswith("Usage: ")
        return captured.err

    return run


@pytest.fixture
def folder(run, tmp_path):
    """A folder with a 3 x 3 simulator with names, and a log of its target."""
    grid = oee.tasks.gridworld(3, slip=0.3).with_names([f"r{s // 3}c{s % 3}" for s in range(9)], ["n", "e", "s", "w"])
    grid.save("sim.npz")
    target = oee.tasks.gridworld(3, slip=0.1)
    oee.sample_episodes(target, oee.uniform_policy(target), 40, 30, seed=0).save("log.csv")
    return tmp_path
