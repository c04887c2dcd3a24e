"""The README tells the truth: its example prints what it shows, what it names is there, and it is one screen after another."""

import re
from pathlib import Path

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
