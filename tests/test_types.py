"""Types reach the user: mypy and pyright accept right calls and refuse wrong ones."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import oee_tabular

FOLDER = Path(__file__).parent / "type_checks"
ROOT = Path(oee_tabular.__file__).parents[1]


def lines_by_mypy(path):
    """Return the numbers of the lines in which mypy finds an error."""
    pytest.importorskip("mypy")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary"]
    options = ["--no-warn-unused-ignores", "--config-file", FOLDER / "mypy.ini"]
    run = subprocess.run(
        [*command, *options, path], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode in (0, 1), run.stdout + run.stderr
    found = re.findall(rf"{path.name}:(\d+): error: (.*)", run.stdout)
    elsewhere = [
        line
        for line in run.stdout.splitlines()
        if ": error:" in line and path.name not in line
    ]
    assert not elsewhere
    return {int(number): text for number, text in found}


def lines_by_pyright(path):
    """Return the numbers of the lines in which pyright finds an error."""
    program = shutil.which("basedpyright", path=Path(sys.executable).parent)
    if program is None:
        pytest.skip("no basedpyright; install it; in a clone: pip install '.[dev]'")
    options = ["--project", FOLDER / "pyrightconfig.json"]
    options += ["--pythonpath", sys.executable]
    run = subprocess.run(
        [program, "--outputjson", *options, path],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    found = json.loads(run.stdout)["generalDiagnostics"]
    return {
        each["range"]["start"]["line"] + 1: each["message"]
        for each in found
        if each["severity"] == "error"
    }


@pytest.fixture(scope="module", params=[lines_by_mypy, lines_by_pyright])
def errors_in(request):
    return request.param


def test_right_calls_are_accepted(errors_in):
    assert errors_in(FOLDER / "right_calls.py") == {}


def test_each_wrong_call_is_an_error(errors_in):
    path = FOLDER / "wrong_calls.py"
    lines = path.read_text().splitlines()
    wrong = {k for k, line in enumerate(lines, 1) if line.endswith("# wrong")}
    assert len(wrong) >= 20
    found = errors_in(path)
    assert {k: lines[k - 1] for k in wrong - set(found)} == {}
    assert {k: found[k] for k in set(found) - wrong} == {}
