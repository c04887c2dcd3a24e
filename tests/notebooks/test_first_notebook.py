"""Notebook 00 is stored with its outputs: they are what it says when it is run, and hold nothing of the machine."""

import base64
import re

import nbformat
import numpy as np
import pytest
from saved_notebook import FIRST, run, texts
from test_pages import run as run_blocks

import oee_tabular as oee

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@pytest.fixture(scope="module")
def stored():
    return nbformat.read(FIRST, as_version=4)


def test_every_cell_has_run_once_in_order(stored):
    code = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    pictures = [output for cell in code for output in cell.outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == sum("plt.subplots" in cell.source for cell in code)
    assert all(base64.b64decode(picture.data["image/png"])[:4] == b"\x89PNG" for picture in pictures)


def test_the_outputs_say_nothing_of_the_machine(stored):
    assert FIRST.stat().st_size < 1e6
    kept = nbformat.writes(stored)
    assert not re.search(r"(?i)/(home|root|tmp|work|users|usr|opt|var)/|[a-z]:\\\\|127\.0\.0|0x[0-9a-f]{6}", kept)
    assert stored.metadata["language_info"] == {"name": "python"}  # no version
    assert all(cell.metadata == {} for cell in stored.cells)  # no times


def test_the_stored_outputs_are_those_of_running_it(stored):
    """To be stored again where it is meant to say something else: ``python tests/saved_notebook.py``."""
    for found, kept in zip(texts(run()), texts(stored), strict=True):
        assert NUMBER.sub("#", found) == NUMBER.sub("#", kept)
        numbers = [np.array(NUMBER.findall(text), dtype=float) for text in (found, kept)]
        np.testing.assert_allclose(*numbers, rtol=1e-3, atol=1e-6)


def test_the_commands_for_own_files_run(stored, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (text,) = [cell.source for cell in stored.cells if "## With your own files" in cell.source]
    P, policy = np.full((2, 2, 2), 0.5), np.full((2, 2), 0.5)
    oee.Transitions([0, 1, 1], [0, 1, 0], [1, 1, 0]).save("log.csv")
    run_blocks(text, capsys, oee=oee, np=np, P=P, r=[[0, 1], [1, 0]], initial=0, discount=0.9, policy=policy)
    assert (tmp_path / "answer.html").stat().st_size
