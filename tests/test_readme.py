"""The README tells the truth: its commands, its example and what the example prints."""

import re
import shlex
from pathlib import Path

import pytest

import oee_tabular as oee
from oee_tabular.cli import main

README = Path(__file__).parents[1] / "README.md"
TEXT = README.read_text()


def test_the_example_prints_what_the_readme_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    after = TEXT[TEXT.index("<!-- example") :]
    commands, shown = (re.search(rf"```{kind}\n(.*?)```", after, re.S).group(1) for kind in ("sh", "text"))
    for line in commands.splitlines():
        words = shlex.split(line)
        assert words[0] == "oee"
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main(words[1:])
        assert not ended.value.code
    assert capsys.readouterr().out.split() == shown.split()
    for code in re.findall(r"```python\n(.*?)```", after, re.S):
        exec(compile(code, "README.md", "exec"), {})
        printed = capsys.readouterr().out
        assert "model-based" in printed or "Smoothed: passed" in printed


def test_files_and_names_that_the_readme_mentions_exist():
    for path in re.findall(r"`(tests/[\w/.]+|notebooks/[\w/.]+)`", TEXT):
        assert (README.parent / path).exists(), path
    for path in re.findall(r"\]\(([\w/.]+)\)", TEXT):
        assert (README.parent / path).exists(), path
    table = TEXT[TEXT.index("## From the paper") : TEXT.index("What the default is")]
    for name in re.findall(r"`((?:estimators|tasks|inference|exact)\.\w+|[a-z]+_[a-z_]+|[A-Z]\w+)(?![\w/.])", table):
        found = oee
        for part in name.split("."):
            found = getattr(found, part)


def test_ci_runs_the_second_command():
    line = next(line for line in TEXT.splitlines() if '-e ".[dev]"' in line)
    assert line.startswith("python3 -m venv .venv && ")
    assert line in TEXT
    assert "pip install --quiet -e" in (README.parent / ".ci" / "run").read_text()
