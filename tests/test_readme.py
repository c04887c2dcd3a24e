"""The README tells the truth: its example prints what it shows, what it names is there, and it is one screen after another."""

import re
from pathlib import Path

import numpy as np
import pytest
from test_pages import PAGES, command

import oee_tabular as oee

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text()


def test_own_arrays_print_what_the_readme_shows(capsys):
    code, shown = (re.search(rf"```{kind}\n(.*?)```", TEXT, re.S).group(1) for kind in ("python", "text"))
    assert len(code.splitlines()) <= 12  # two of them imports
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out.split() == shown.split()


def test_it_is_short():
    assert len(TEXT.splitlines()) <= 110
    assert max(map(len, TEXT.splitlines())) <= 120


def test_files_that_the_readme_mentions_exist():
    for path in re.findall(r"`((?:tests|notebooks)/[\w/.]+)`|\]\(([\w/.]+)\)", TEXT):
        assert (README.parent / "".join(path)).exists(), path


def test_ci_runs_the_second_command():
    line = next(line for line in TEXT.splitlines() if '-e ".[dev]"' in line)
    assert line.startswith("python3 -m venv .venv && ")
    assert "pip install --quiet -e" in (README.parent / ".ci" / "run").read_text()


COMMANDS = sorted({" ".join(found.split()) for found in re.findall(r"(?:`|\.venv/bin/)(oee \w[^`\n]*)", TEXT)})
SMALL = {"oee bench": " --families inventory20 --sizes 3 --seeds 1 --jobs 1 --output bench"}  # else minutes


@pytest.mark.parametrize("line", COMMANDS)
def test_commands_run(line, tmp_path, monkeypatch):
    """Own files and an own estimator stand for the words in capitals and for module:object."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    oee.FiniteMDP(np.full((2, 2, 2), 0.5), [[0, 1], [1, 0]], 0, 0.9).save("SIM.npz")
    oee.Transitions([0, 1, 1], [0, 1, 0], [1, 1, 0]).save("LOG.csv")
    np.save("POLICY.npy", [[0.5, 0.5], [1.0, 0.0]])
    (tmp_path / "own_of_readme.py").write_text(re.search(r"```python\n(.*?)```", PAGES["own_estimator"], re.S)[1])
    own = {"SIM": "SIM.npz", "LOG": "LOG.csv", "POLICY": "POLICY.npy", "module:object": "own_of_readme:smoothed"}
    words = re.sub("|".join(own), lambda found: own[found[0]], line)
    command(words + SMALL.get(" ".join(line.split()[:2]), ""))


def test_every_command_is_found():
    assert {line.split()[1] for line in COMMANDS} == {"evaluate", "check", "bench", "reproduce"}


def test_ci_builds_the_site_as_the_readme_does():
    line = next(line for line in TEXT.splitlines() if "-m sphinx" in line)
    built = next(line for line in (README.parent / ".ci" / "run").read_text().splitlines() if "-m sphinx" in line)
    assert built.replace("-q ", "") == line[line.index("python -m sphinx") :]
