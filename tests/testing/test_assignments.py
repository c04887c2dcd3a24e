"""The assignments: right answers of two kinds are accepted, wrong ones refused with a
hint, the students' notebooks are made from the instructor's, and both can be graded.
"""

import collections
import csv
import functools
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
from assignment_answers import SECOND_KIND, WRONG, written
from hypothesis import given
from hypothesis import strategies as st

import oee_tabular as oee
import oee_tabular.paper
from oee_tabular.testing import assignments
from oee_tabular.testing.assignments import TASKS, RefusedAnswer, check, draw_case

FOLDER = Path(__file__).parents[2] / "notebooks" / "assignments"
SOURCES = sorted((FOLDER / "source").glob("assignment_*/*.ipynb"))
ALL_CASES = [*range(5), *range(10, 40)]  # what the visible and the hidden tests try


def read(path):
    return nbformat.read(path, as_version=4)


def code_cells(book):
    return [cell for cell in book.cells if cell.cell_type == "code"]


def about(cell):
    return cell.metadata.get("nbgrader", {})


@functools.cache
def first_kind():
    """The functions of the instructor's notebooks by their names."""
    names = {"np": np}
    for path in SOURCES:
        for cell in code_cells(read(path)):
            if about(cell).get("solution"):
                exec(cell.source, names)
    return names


def function_of(exercise):
    return TASKS[exercise].partition("(")[0]


def refusal(exercise, answer, cases=ALL_CASES):
    with pytest.raises(RefusedAnswer) as found:
        check(exercise, answer, cases=cases)
    return str(found.value)


@pytest.mark.parametrize("exercise", TASKS)
def test_right_answers_of_two_kinds_are_accepted(exercise, capsys):
    check(exercise, first_kind()[function_of(exercise)], cases=ALL_CASES)
    check(exercise, written(exercise, SECOND_KIND[exercise]), cases=ALL_CASES)
    assert capsys.readouterr() == (f"Right, in {len(ALL_CASES)} cases.\n" * 2, "")


@pytest.mark.parametrize(
    ("exercise", "text", "word"),
    WRONG,
    ids=[f"{n}-{k}" for k, (n, *_) in enumerate(WRONG)],
)
def test_a_wrong_answer_is_refused_with_its_hint(exercise, text, word):
    said = refusal(exercise, written(exercise, text))
    assert word in said
    assert "Hint: " in said


def test_ten_wrong_answers_are_tried_for_each_assignment():
    tried = collections.Counter(name[0] for name, _, _ in WRONG)
    assert set(tried) == {name[0] for name in TASKS} == set("12345678")
    assert min(tried.values()) >= 10
    assert {name for name, _, _ in WRONG} == set(TASKS) == set(SECOND_KIND)


NO_ANSWERS = [
    ("seven", "the text 'seven'"),
    ("", "the text ''"),
    ([1.0, 2.0], r"numbers of shape \(2,\)"),
    ([[1], [1, 2]], "a list"),
    (3.5, "the number 3.5"),
    (True, "it is True"),
    ({"risk": 1}, "a dict"),
    (np.zeros((2, 2)), r"numbers of shape \(2, 2\)"),
    (None, "not answered yet"),
    (..., "not answered yet"),
    (lambda: 1.0, r"must take \(.*\); it takes \(\)"),
    (lambda x, *, y: 1.0, "must take"),
    (abs, "must take"),
    (dict, "raises|must take|must return"),
    (type("Answer", (), {}), "must take|raises"),
    (np.float64, "raises|must take|must return|is not right"),
]


@pytest.mark.parametrize("exercise", TASKS)
@pytest.mark.parametrize(("answer", "said"), NO_ANSWERS)
def test_what_is_no_function_is_refused_in_a_sentence(exercise, answer, said):
    assert re.search(said, refusal(exercise, answer))


RETURNED = [
    "seven",
    [],
    [[1], [1, 2]],
    None,
    np.sum,
    lambda x: x,
    object(),
    1j,
    np.array(["a"]),
    {},
    (x for x in ()),
    np.full(3, None),
]


@pytest.mark.parametrize("exercise", TASKS)
@pytest.mark.parametrize("value", RETURNED, ids=lambda x: type(x).__name__)
def test_what_is_no_result_is_refused_in_a_sentence(exercise, value):
    said = refusal(exercise, lambda *_: value)
    assert re.search(r"(must return .+; it returns|returns nothing)", said)
    assert "Hint: " in said


@pytest.mark.parametrize("exercise", TASKS)
@given(value=st.one_of(st.floats(), st.integers(), st.booleans(), st.text(), st.none()))
def test_a_constant_is_never_right(exercise, value):
    refusal(exercise, lambda *_: value)


@pytest.mark.parametrize(
    "error",
    [ValueError("no"), KeyError("x"), SystemExit(3), RecursionError(), Exception],
)
def test_an_error_of_the_answer_is_told_with_its_line(error):
    def risk(g, p, q):
        raise error

    line = risk.__code__.co_firstlineno + 1
    kind = error if isinstance(error, type) else type(error)
    assert f"raises {kind.__name__} in line {line}: " in refusal("1_risk", risk)
    with pytest.raises(RefusedAnswer) as found:
        check("1_risk", risk)
    assert found.value.__suppress_context__
    assert found.value._render_traceback_() == [f"RefusedAnswer: {found.value}"]


def test_a_notebook_shows_the_sentence_alone(tmp_path):
    """IPython prints no line of the package below a student's cell."""
    pytest.importorskip("IPython")
    lines = (
        "from oee_tabular.testing.assignments import check",
        "def risk(g, p, q): return 'seven'",
        "check('1_risk', risk)",
    )
    (tmp_path / "cells.ipy").write_text("\n".join(lines))
    found = subprocess.run(
        [sys.executable, "-m", "IPython", "--colors=NoColor", "cells.ipy"],
        cwd=tmp_path,
        text=True,
        capture_output=True,
        check=False,
        env=os.environ
        | {"PYTHONPATH": str(FOLDER.parents[1]), "IPYTHONDIR": str(tmp_path / "i")},
    )
    said = "RefusedAnswer: risk must return one number; it returns the text 'seven'."
    assert found.stdout.strip().startswith(said)
    assert "Traceback" not in found.stdout + found.stderr
    assert "judging.py" not in found.stdout + found.stderr


@pytest.mark.parametrize("exercise", TASKS)
def test_parameters_in_another_order_are_refused(exercise):
    names = TASKS[exercise].partition("(")[2].removesuffix(")").split(", ")
    turned = eval(f"lambda {', '.join(names[::-1])}: 1.0")
    assert "in this order; it takes" in refusal(exercise, turned)
    others = eval(f"lambda {', '.join(f'x{k}' for k in range(len(names)))}: None")
    assert "returns nothing" in refusal(exercise, others)


def test_control_c_is_no_answer():
    def risk(g, p, q):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        check("1_risk", risk)


def test_an_exercise_that_is_not_written_yet():
    def risk(g, p, q):
        raise NotImplementedError

    assert "not answered yet" in refusal("1_risk", risk)


def deep(P, r, policy, discount):
    return oee.state_values(
        oee.FiniteMDP(P, r, np.ones(len(r)) / len(r), discount), policy
    )


def test_the_package_itself_is_no_answer():
    def inside(P, r, policy, discount):
        from oee_tabular.exact import state_values

        return state_values(P, policy)

    borrowed = oee.state_values

    def closed(P, r, policy, discount):
        return [borrowed(P, policy) for _ in range(2)]

    for answer in (
        deep,
        lambda P, r, policy, discount: deep(P, r, policy, discount),
        inside,
        closed,
    ):
        assert "by your own code; it uses" in refusal("3_values", answer)


def test_warnings_and_the_error_stream_stay_silent(capfd):
    """nbgrader gives no point to a cell that writes to the error stream."""

    def risk(g, p, q):
        print("seen", file=sys.stderr)
        return np.nansum([q @ g - np.where(p > 0, p * np.log(g), 0).sum()])

    check("1_risk", risk, cases=ALL_CASES)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("exercise", TASKS)
def test_cases_are_drawn_alike_and_apart(exercise):
    def flat(case):
        values = draw_case(exercise, case).values()
        return np.concatenate([np.ravel(v) for v in values if v is not None])

    np.testing.assert_array_equal(flat(3), flat(3))
    assert not np.array_equal(flat(3), flat(4))
    parameters = TASKS[exercise].partition("(")[2].removesuffix(")").split(", ")
    assert list(draw_case(exercise, 0)) == parameters


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("risk",), "exercise must be one of 1_risk, .*; it is 'risk'"),
        ((None,), "exercise must be one of"),
        (([],), "exercise must be one of"),
        (("1_risk", -1), "must be an integer from 0 to 9999; it is -1"),
        (("1_risk", 1.5), "must be an integer from 0 to 9999"),
        (("1_risk", True), "must be an integer from 0 to 9999"),
    ],
)
def test_bad_names_and_cases(arguments, said):
    exercise, case = (*arguments, 0)[:2]
    with pytest.raises(ValueError, match=said):
        draw_case(exercise, case)
    with pytest.raises(ValueError, match=said):
        check(exercise, lambda: 1, cases=[case])


@pytest.mark.parametrize("cases", [[], None, 3, "12"])
def test_bad_sets_of_cases(cases):
    with pytest.raises(ValueError, match="cases must"):
        check("1_risk", lambda: 1, cases=cases)


# the oracles, by other routes of the package


def test_the_risk_is_the_paper_s():
    for case in ALL_CASES:
        g, p, q = draw_case("1_risk", case).values()
        found = assignments.risk.RISK.solve(g, p, q)
        assert found == pytest.approx(oee.paper.risk(g, p, q), rel=1e-12)


def test_the_design_reaches_the_efficiency_bound():
    """The costs by the shares sum to the bound, and Neyman's shares have the least."""
    for case in range(8):
        P, r, mu, policy, discount = draw_case("6_costs", case).values()
        mdp = oee.FiniteMDP(P, r, mu, discount)
        costs = first_kind()["costs"](P, r, mu, policy, discount)
        shares = first_kind()["neyman_design"](costs, 1)
        least = oee.efficiency_bound(mdp, policy, shares)
        np.testing.assert_allclose((costs / shares).sum(), least, rtol=1e-9)
        np.testing.assert_allclose(np.sqrt(costs).sum() ** 2, least, rtol=1e-9)
        plan = oee.plan_data_collection(mdp, {"p": policy}, n=100)
        np.testing.assert_allclose(plan.costs["p"], costs, rtol=1e-7, atol=1e-12)


def test_the_gain_is_that_of_the_package():
    """Its error: the change of the gain in many redrawn logs of long rows."""
    counts, r, mu, discount, running, candidate = draw_case("8_gain", 0).values()
    long = np.round(1e6 * counts / counts.sum(-1, keepdims=True))
    gain, error = first_kind()["gain_and_error"](
        long, r, mu, discount, running, candidate
    )
    rng = np.random.default_rng(0)
    P = long / long.sum(-1, keepdims=True)
    gains = []
    for _ in range(400):
        drawn = rng.multinomial(1_000_000, P) / 1e6
        mdp = oee.FiniteMDP(drawn, r, mu, discount)
        gains.append(oee.policy_value(mdp, candidate) - oee.policy_value(mdp, running))
    np.testing.assert_allclose(np.mean(gains), gain, atol=5 * error / 20)
    np.testing.assert_allclose(np.std(gains), error, rtol=5 / np.sqrt(800))


# the notebooks


def test_eight_assignments_of_ten_points_ask_for_every_exercise():
    assert [path.parent.name for path in SOURCES] == [
        f"assignment_{k}" for k in range(1, 9)
    ]
    asked = collections.Counter()
    for path in SOURCES:
        cells = code_cells(read(path))
        assert sum(about(cell).get("points", 0) for cell in cells) == 10
        for cell in cells:
            for name in re.findall(r'^check\("(\w+)", \w+', cell.source, re.M):
                assert f"assignment_{name[0]}" == path.parent.name
                asked[name, "BEGIN HIDDEN TESTS" in cell.source] += 1
    assert asked == collections.Counter(
        {(name, is_hidden): 1 for name in TASKS for is_hidden in (False, True)}
    )


def make():
    return runpy.run_path(str(FOLDER / "make.py"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_the_released_notebooks_are_those_that_the_script_makes(path):
    """To be made again by ``python notebooks/assignments/make.py``."""
    script = make()
    made = script["release"](read(path))
    assert made == read(script["released"](path))
    text = nbformat.writes(made)
    for line in (line for cell in made.cells for line in cell.source.split("\n")):
        assert "BEGIN" not in line
        assert "END" not in line
    assert "cases=range(10" not in text
    assert (
        text.count("raise NotImplementedError()\n") == 0 or "# YOUR CODE HERE" in text
    )
    stubs = [c for c in code_cells(made) if about(c).get("solution")]
    assert all("raise NotImplementedError()" in cell.source for cell in stubs)
    assert len(stubs) >= 2


def test_nothing_else_is_released():
    released = {make()["released"](path) for path in SOURCES}
    assert released == set((FOLDER / "release").rglob("*.ipynb"))


@pytest.mark.parametrize(
    "text",
    [
        "### BEGIN SOLUTION\n1",
        "### END SOLUTION",
        "### BEGIN SOLUTION\n### BEGIN SOLUTION\n### END SOLUTION",
    ],
)
def test_a_region_without_its_other_end_is_an_error(text):
    with pytest.raises(ValueError, match="SOLUTION"):
        make()["cut"](text, "SOLUTION")


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_cells_have_what_nbgrader_reads(path):
    keys = {
        "cell_type",
        "grade",
        "grade_id",
        "locked",
        "schema_version",
        "solution",
        "task",
    }
    ids = []
    for book in (read(path), read(make()["released"](path))):
        assert book.nbformat == 4
        for cell in book.cells:
            if data := about(cell):
                assert set(data) - {"points"} == keys
                assert data.schema_version == 3
                assert data.cell_type == cell.cell_type
                assert ("points" in data) == data.grade == data.locked
                assert data.solution != data.grade
                ids.append(data.grade_id)
            if cell.cell_type == "code":
                assert cell.outputs == []
    assert max(collections.Counter(ids).values()) == 2  # once in each of the two


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_nbgrader_makes_the_same_cells(path):
    pytest.importorskip("nbgrader")
    from nbgrader.nbgraderformat import MetadataValidator
    from nbgrader.preprocessors import ClearHiddenTests, ClearSolutions, LockCells

    book = read(path)
    MetadataValidator().validate_nb(book)
    for step in (ClearSolutions(), LockCells(), ClearHiddenTests()):
        book, _ = step.preprocess(book, {})
    ours = read(make()["released"](path))
    assert [c.source for c in book.cells] == [c.source for c in ours.cells]
    assert [c.metadata for c in book.cells] == [c.metadata for c in ours.cells]


def test_the_page_says_what_is_there():
    page = (FOLDER.parent / "assignments.md").read_text()
    rows = re.findall(r"^\| (\d) \| .*\]\((assignments/release/.*)\) \|$", page, re.M)
    expected = [
        (path.parent.name[-1], make()["released"](path).relative_to(FOLDER.parent))
        for path in SOURCES
    ]
    assert [(number, Path(name)) for number, name in rows] == expected
    for name in re.findall(r"\]\(([^)#]+\.(?:md|ipynb))", page):
        assert (FOLDER.parent / name).is_file(), name
    tolerances = {
        task.tolerance
        for task in assignments._TASKS.values()
        if task.judge is task.bounds is None and not task.choices
    }
    assert tolerances == {1e-7, 1e-6}
    assert "to seven digits (six where" in page
    assert assignments.bootstrap.N_SIGMAS == 6
    assert draw_case("5_bootstrap", 0)["n_resamples"] == 4000
    assert "six standard errors of 4000 resamples" in " ".join(page.split())
    assert f"at most {runpy.run_path(str(FOLDER / 'grade.py'))['SECONDS']} s" in page


# grading without nbgrader


def run_grade(*arguments, folder):
    return subprocess.run(
        [sys.executable, str(FOLDER / "grade.py"), *map(str, arguments)],
        cwd=folder,
        text=True,
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(FOLDER.parents[1])},
    )


def test_the_instructors_notebooks_get_all_points_from_an_empty_folder(tmp_path):
    found = run_grade(*SOURCES, "--output", "grades.csv", folder=tmp_path)
    assert found.stdout.splitlines() == [f"{path}: 10 of 10 points" for path in SOURCES]
    assert (found.stderr, found.returncode) == ("", 0)
    assert [path.name for path in tmp_path.iterdir()] == ["grades.csv"]
    text = (tmp_path / "grades.csv").read_text()
    rows = list(csv.DictReader(text.splitlines()))
    assert len(rows) == 2 * len(TASKS)
    assert all(row["points"] == row["of"] and not row["message"] for row in rows)


def submission(folder, changes, name="risk.ipynb"):
    """The released notebook with other cells; ``changes``: grade id -> text or None."""
    [path] = (FOLDER / "release").glob(f"assignment_*/{name}")
    book = read(path)
    book.cells = [
        cell
        for cell in book.cells
        if changes.get(about(cell).get("grade_id"), "") is not None
    ]
    for cell in book.cells:
        cell.source = changes.get(about(cell).get("grade_id"), cell.source)
    nbformat.write(book, folder / name)
    return folder / name


def test_a_student_cannot_change_or_delete_a_test(tmp_path):
    good = "def risk(g, p, q):\n    return q @ g - p @ np.log(g)"
    changes = {
        "assignment_1_risk": good,
        "assignment_1_risk_hidden": "pass",
        "assignment_1_minimiser_visible": "print('Right.')",
        "assignment_1_normalised_hidden": None,
    }
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    assert "risk.ipynb: 1 of 10 points" in found
    assert re.search(r"assignment_1_risk_hidden: 0: .*also where g = 0", found)
    assert "assignment_1_normalised_hidden: 0: RefusedAnswer" in found


def test_a_notebook_that_runs_for_ever(tmp_path):
    path = submission(tmp_path, {"assignment_1_risk": "while True: pass"})
    found = run_grade(path, "--seconds", 3, folder=tmp_path).stdout
    assert "risk.ipynb: 0 of 10 points" in found
    assert "assignment_1_risk_visible: 0: it ran longer than 3.0 s" in found


def test_a_notebook_that_ends_python_keeps_its_points(tmp_path):
    good = "def risk(g, p, q):\n    return q @ g - p @ np.log(g)"
    changes = {
        "assignment_1_risk": good,
        "assignment_1_minimiser": "import os\nos._exit(1)",
    }
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    assert "risk.ipynb: 1 of 10 points" in found
    assert "assignment_1_minimiser_visible: 0: the notebook ended its process" in found


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("mine.ipynb", "{}", "must have the name of an assignment: bootstrap.ipynb"),
        ("risk.ipynb", "seven", "must be a notebook of format 4"),
        ("risk.ipynb", "[]", "must be a notebook of format 4"),
        ("risk.ipynb", json.dumps({"cells": [1]}), "must be a notebook of format 4"),
        ("risk.ipynb", None, "must be a file: No such file"),
    ],
)
def test_a_file_that_cannot_be_graded(tmp_path, name, text, said):
    if text is not None:
        (tmp_path / name).write_text(text)
    found = run_grade(name, folder=tmp_path)
    assert found.returncode == 2
    assert said in found.stderr.replace("\n", " ")
    assert "Traceback" not in found.stderr


def test_no_file_to_grade(tmp_path):
    assert "give the notebooks to grade" in run_grade(folder=tmp_path).stderr
