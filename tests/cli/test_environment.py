"""Variables and folders that a command is started with."""

import os
import subprocess
import sys

import pytest

DATA = "--simulator sim.npz --log log.csv"
VALUES = f"evaluate {DATA} --quick --estimators oee"


@pytest.mark.parametrize("value", ["abc", "1e5", "1.5", "9" * 30])
@pytest.mark.parametrize(
    "words",
    [
        f"{VALUES} --output out --report page.html",
        f"improve {DATA} --running uniform --report page.html",
        "bench --output out",
        "info sim.npz",
    ],
)
def test_a_date_that_is_none_is_named_before_the_work(
    run, folder, monkeypatch, words, value
):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", value)
    said = run(words, code=2)
    assert "SOURCE_DATE_EPOCH must be a whole number of seconds since 1970" in said
    assert f"it is '{value}' (a variable of the environment)" in said
    assert not (folder / "out").exists()


@pytest.mark.parametrize("value", ["0", "-2", "abc"])
def test_a_number_of_threads_that_is_none_is_named(run, folder, monkeypatch, value):
    monkeypatch.setenv("NUMBA_NUM_THREADS", value)
    said = run(VALUES, code=2)
    assert f"NUMBA_NUM_THREADS must be a positive integer; it is '{value}'" in said


def start(words, folder, **variables):
    """Run a whole command in a folder."""
    return subprocess.run(
        [sys.executable, "-P", "-m", "oee_tabular", *words.split()],
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "variables",
    [
        {"MPLBACKEND": "nothing"},
        {"MPLBACKEND": "module://nowhere"},
        {"MPLBACKEND": "TkAgg", "SOURCE_DATE_EPOCH": ""},
    ],
)
def test_pictures_need_no_backend_of_the_user(folder, variables):
    words = f"{VALUES} --output out --report page.html"
    done = start(words, folder, **variables)
    assert done.returncode == 0
    assert "warning" not in done.stderr
    names = {"report.json", "table.csv", "values.png", "values.pdf", "values.svg"}
    assert {path.name for path in (folder / "out").iterdir()} == names
    assert "<svg" in (folder / "page.html").read_text()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("check oee_tabular.estimators:ModelBased", "the current folder was removed"),
        ("sample nowhere:make --transitions 9 --output l.csv", "l.csv"),
        ("info log.csv", "the current folder was removed (change to another one)"),
        ("info /log.csv", "no such file: /log.csv"),
    ],
)
def test_a_current_folder_that_is_gone_is_named(run, tmp_path, words, expected):
    gone = tmp_path / "gone"
    gone.mkdir()
    os.chdir(gone)  # the fixture goes back
    try:
        gone.rmdir()
    except OSError:
        pytest.skip("a current folder cannot be removed here")
    said = run(words, code=2)
    assert expected in said
    assert "the output cannot be written" not in said
