"""Notebooks are stored with their outputs: what they say when they run alone in an
empty folder; nothing of the machine.
"""

import ast
import base64
import importlib
import inspect
import itertools
import re

import nbformat
import numpy as np
import pytest
from answers import CASES
from saved_notebook import NOTEBOOKS, checks_of, notebook_runner, number, texts
from test_pages import run as run_blocks

import oee_tabular as oee

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
MACHINE = re.compile(
    r"(?i)/(home|root|tmp|work|users|usr|opt|var)/|[a-z]:\\\\|127\.0\.0|\b0x[0-9a-f]{6}"
)
# the code of a cell that helps, which a reader may unfold: on the site, and in Jupyter
FOLDED = {"jupyter": {"source_hidden": True}, "tags": ["hide-input"]}
SLIDES = ("slide", "subslide", "fragment")  # what slides.py puts on slides
EXERCISES = {"05": "abc", "05b": "de"}
LEVELS = ("beginner", "intermediate", "advanced")
MAX_LINES = 30  # of a cell that a student reads


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def path(request):
    return request.param


@pytest.fixture
def stored(path):
    return nbformat.read(path, as_version=4)


def cells(book, kind):
    return [cell for cell in book.cells if cell.cell_type == kind]


def pictures(book):
    outputs = [output for cell in cells(book, "code") for output in cell.outputs]
    return [
        base64.b64decode(output.data.pop("image/png"))
        for output in outputs
        if "image/png" in output.get("data", {})
    ]


@pytest.fixture(scope="module")
def run():
    with notebook_runner() as runner:
        yield runner


def test_the_stored_outputs_are_those_of_running_it_alone(path, stored, tmp_path, run):
    """To be stored again where it is meant to say something else: ``python
    tests/saved_notebook.py``.
    """
    if number(path) == "13":
        pytest.importorskip("ipywidgets")
    found = run(path, tmp_path)
    assert list(tmp_path.iterdir()) == []
    for ours, kept in zip(texts(found), texts(stored), strict=True):
        # as wide as digits
        assert NUMBER.sub("#", ours).replace(" ", "") == NUMBER.sub("#", kept).replace(
            " ", ""
        )
        numbers = [np.array(NUMBER.findall(text), dtype=float) for text in (ours, kept)]
        np.testing.assert_allclose(*numbers, rtol=1e-3, atol=1e-6)
    assert len(pictures(found)) == len(pictures(stored)) >= 1


def test_the_outputs_say_nothing_of_the_machine(path, stored):
    assert path.stat().st_size < 500_000
    assert all(picture[:4] == b"\x89PNG" for picture in pictures(stored))
    assert not MACHINE.search(nbformat.writes(stored))
    assert stored.metadata == {
        "kernelspec": {
            "display_name": "Python 3",
            "language": "python",
            "name": "python3",
        },
        "language_info": {"name": "python"},
        "oee": stored.metadata.oee,
    }
    for cell in stored.cells:
        marks = dict(cell.metadata)
        is_slide = "slideshow" in marks
        slide = marks.pop("slideshow", {"slide_type": "slide"})
        assert slide in [{"slide_type": kind} for kind in SLIDES]
        # the text of the slide, in place of the cell's own or above its picture
        assert is_slide or "slide" not in marks
        assert marks.pop("slide", "text").strip()
        # a picture that is not drawn anew
        assert is_slide or "slide_picture" not in marks
        assert marks.pop("slide_picture", "stored") == "stored"
        assert marks in ({}, FOLDED)
    for cell in cells(stored, "code"):
        assert cell.execution_count is None
        streams = [output.get("name") for output in cell.outputs]
        assert "stderr" not in streams
        assert ("stdout", "stdout") not in itertools.pairwise(streams)  # joined
        assert not [
            output
            for output in cell.outputs
            if output.get("metadata") or output.get("execution_count")
        ]
    ids = [cell.id for cell in stored.cells]
    assert len(set(ids)) == len(ids)


def test_it_opens_with_what_one_will_be_able_to_do_and_how_long_it_takes(stored):
    opening = " ".join(stored.cells[0].source.split())
    assert "After this notebook you can" in opening
    times = re.search(
        r"\*\*Time\*\*: (\d+) minutes to read(?:, (\d+) with the exercises?)?; \d+ s to"
        " run",
        opening,
    )
    level = stored.metadata.oee.level
    assert level in LEVELS
    minutes = int(times[2] or times[1])
    assert stored.metadata.oee == {"level": level, "minutes": minutes}


def test_it_says_where_its_limits_are(stored):
    text = "\n".join(cell.source for cell in cells(stored, "markdown"))
    assert re.search(r"limits|Limits|What this cannot do", text)


def test_students_read_no_assertions(stored):
    for cell in cells(stored, "code"):
        assert "assert" not in cell.source


def test_every_check_runs_after_a_cell_and_says_something(path, stored):
    """What checks/ says of a notebook; tests/saved_notebook.py calls it."""
    checks = checks_of(path)
    assert checks
    assert set(checks) <= {cell.id for cell in cells(stored, "code")}
    for check in checks.values():
        body = ast.parse(inspect.getsource(check))
        called = {
            node.attr for node in ast.walk(body) if isinstance(node, ast.Attribute)
        }
        has_assert = any(isinstance(node, ast.Assert) for node in ast.walk(body))
        has_assert |= any(name.startswith("assert_") for name in called)
        assert has_assert or "test_" in inspect.getsource(check)


def test_no_cell_is_longer_than_a_student_reads(stored):
    lengths = {cell.id: cell.source.count("\n") + 1 for cell in cells(stored, "code")}
    assert max(lengths.values()) <= MAX_LINES, lengths


def test_it_uses_public_names(stored):
    """Modules that have ``__all__``, and names in it: what is written down in
    test_public_names.py.
    """
    code = "\n".join(cell.source for cell in cells(stored, "code"))
    for module, names in re.findall(
        r"^from (oee_tabular[\w.]*) import (\([^)]*\)|.+)$", code, re.MULTILINE
    ):
        public = importlib.import_module(module).__all__
        submodules = {
            "paper",
            "exact",
            "experiments",
            "kinova",
            "plots",
            "estimators",
            "testing",
        }
        used = {name.strip() for name in names.split("#")[0].strip("()").split(",")} - {
            ""
        }
        assert used <= {*public, *submodules}


def test_it_leaves_the_answers_to_the_reader(path, stored):
    asked = [
        cell.source
        for cell in cells(stored, "code")
        if re.search(r"^check\(", cell.source, re.MULTILINE)
    ]
    assert all(re.match(r"answer = None\b", source) for source in asked)
    names = [
        name
        for source in asked
        for name in re.findall(r'check\("(\d\d_\w)", answer\)', source)
    ]
    # 05b goes on with the letters of 05
    letters = EXERCISES.get(number(path))
    assert names == sorted(
        name
        for name in CASES
        if name[:2] == path.stem[:2] and (letters is None or name[3] in letters)
    )
    solutions = sum(
        cell.source.count("<details>") for cell in cells(stored, "markdown")
    )
    assert solutions == len(asked)


def test_the_commands_for_own_files_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    first = nbformat.read(NOTEBOOKS[0], as_version=4)
    (text,) = [
        cell.source for cell in first.cells if "## With your own files" in cell.source
    ]
    P = np.full((2, 2, 2), 0.5)
    policy = np.full((2, 2), 0.5)
    oee.Transitions([0, 1, 1], [0, 1, 0], [1, 1, 0]).save("log.csv")
    run_blocks(
        text,
        capsys,
        oee=oee,
        np=np,
        P=P,
        r=[[0, 1], [1, 0]],
        initial=0,
        discount=0.9,
        policy=policy,
    )
    assert (tmp_path / "answer.html").stat().st_size


def test_a_line_of_the_syllabus_has_all_that_a_teacher_needs():
    folder = NOTEBOOKS[0].parent
    text = (folder / "syllabus.md").read_text()
    weeks = re.findall(r"^\| \d \|.*", text, re.MULTILINE)
    assert len(weeks) == 8
    asked_in_all = set()
    for k, week in enumerate(weeks, 1):
        cells_of_week = week.strip("| ").split(" | ")
        _, _, chapters, books, slides, exercises, assignment = cells_of_week
        assert slides == f"`--weeks {k}`"
        assert "## Slides" in text
        for part in (chapters, books, assignment):
            links = re.findall(r"\]\(([^)]+)\)", part)
            assert links
            assert all((folder / link).is_file() for link in links)
        asked = {
            f"{part[:2]}_{letter}"
            for part in exercises.replace("a to e", "a, b, c, d, e").split("; ")
            for letter in re.findall(r"\b[a-e]\b", part)
        }
        names = {link[:2] for link in re.findall(r"\((\w+\.ipynb)\)", books)}
        assert asked == {name for name in CASES if name[:2] in names}
        asked_in_all |= asked
    assert len(asked_in_all) >= 25


def test_the_syllabus_lists_every_notebook():
    folder = NOTEBOOKS[0].parent
    text = (folder / "syllabus.md").read_text()
    for path in NOTEBOOKS:
        title = nbformat.read(path, as_version=4).cells[0].source.split("\n")[0]
        linked = re.findall(rf"\[([^]]+)\]\({path.name}\)", text)
        assert title[2:].startswith(linked[0].split(":")[0]), path.name
    words = ("Thirteen", "Fourteen", "Fifteen", "Sixteen")
    assert f"{words[len(NOTEBOOKS) - 13]} notebooks" in text
