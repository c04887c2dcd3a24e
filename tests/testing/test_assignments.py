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
import signal
import subprocess
import sys
import time
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import nbformat
import numpy as np
import pytest
from assignment_answers import SECOND_KIND, WRONG, written
from assignment_mistakes import MORE_WRONG
from hypothesis import given
from hypothesis import strategies as st

import oee_tabular as oee
import oee_tabular.paper
from oee_tabular.testing import assignments
from oee_tabular.testing.assignments import TASKS, RefusedAnswer, check, draw_case
from oee_tabular.testing.assignments.differences import (
    explain_pattern,
    say_difference,
)

FOLDER = Path(__file__).parents[2] / "notebooks" / "assignments"
SOURCES = sorted((FOLDER / "source").glob("assignment_*/*.ipynb"))
ALL_CASES = range(40)  # what the visible and the hidden tests try
ALL_WRONG = [*WRONG, *MORE_WRONG]


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
    ALL_WRONG,
    ids=[f"{n}-{k}" for k, (n, *_) in enumerate(ALL_WRONG)],
)
def test_a_wrong_answer_is_refused_with_its_hint(exercise, text, word):
    """The cases that a student sees are enough, and so are the hidden ones alone."""
    answer = written(exercise, text)
    said = refusal(exercise, answer, range(10))
    assert word in said
    assert "Hint: " in said
    refusal(exercise, answer, range(10, 40))


def test_ten_wrong_answers_are_tried_for_each_exercise():
    tried = collections.Counter(name for name, _, _ in ALL_WRONG)
    assert set(tried) == set(TASKS) == set(SECOND_KIND)
    assert min(tried.values()) >= 10


@pytest.mark.parametrize("exercise", TASKS)
def test_ten_cases_are_of_every_kind(exercise):
    task = assignments._TASKS[exercise]
    assert not task.kinds[0].about
    assert all(kind.about for kind in task.kinds[1:])
    assert len({kind.about for kind in task.kinds}) == len(task.kinds)
    assert len(task.kinds) <= len(assignments.VISIBLE_CASES) == 10


def test_a_case_has_what_its_kind_says():
    """The special values that a wrong answer is told of are in the arguments."""
    for case in range(40):
        kind = assignments._TASKS["2_counts"].kind_of(case).about
        counts, simulator = draw_case("2_counts", case).values()
        is_possible = (simulator > 0) | (counts == 0)
        assert is_possible.all() == (kind.find("never makes") < 0)
        assert (simulator < 1e-5).any() == bool(
            re.search("has zeros|1e-9|never", kind)
        ) or (kind in ("two pairs were never recorded", "nothing was recorded"))
        if "recorded" in kind:
            assert (counts.sum(axis=-1) == 0).any()
        target, simulator = draw_case("2_ratio", case).values()
        assert (target[simulator == 0] == 0).all()
        np.testing.assert_allclose(target.sum(axis=-1), 1.0, rtol=1e-12)
        np.testing.assert_allclose(simulator.sum(axis=-1), 1.0, rtol=1e-12)
    outside = [
        (target > 0) & (simulator == 0)
        for case in range(10)
        for target, simulator in [draw_case("2_support", case).values()]
    ]
    assert 3 <= sum(found.any() for found in outside) <= 6


NO_ANSWERS = [
    ("seven", "the text 'seven'"),
    ("", "the text ''"),
    ([1.0, 2.0], r"numbers of shape \(2,\)"),
    ([[1], [1, 2]], "a list whose parts differ in length or kind"),
    (3.5, "the number 3.5"),
    (True, "it is True"),
    ({"risk": 1}, "a dictionary"),
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


def within_itself():
    endless = []
    endless.append(endless)
    return endless


def arrays_of(result):
    """Results that are none, made of a right one, and the words that are said."""
    array = np.asarray(result, dtype=float)
    return [
        (np.full(array.shape, np.nan), "is nan, and|returns nan, and"),
        (np.full(array.shape, np.inf), "is inf, and|returns inf, and"),
        (np.stack([array, array]), r"it returns numbers of shape \(2,"),
        (np.zeros((0, *array.shape)), r"it returns numbers of shape \(0,"),
        (array.astype(str), "of texts|the text"),
        (array.astype(complex), "complex number"),
        (np.array([None] * array.size).reshape(array.shape), "objects that are no"),
        (np.ma.masked_all(array.shape), "masked entries, which are no numbers"),
        (
            [np.ma.masked_all(array.shape)] * 2,
            "a list with masked entries, which are no",
        ),
        ((np.ma.masked_all(2), 1), "a tuple with masked entries, which are no"),
        ([Decimal("sNaN")] * 3, "a list of "),
        (within_itself(), "a list "),
        (np.full(array.shape, 10**400, dtype=object), "numbers that no float"),
        (np.full(array.shape, True, dtype=object), "no numbers, as (True|.*True) is"),
        (array.astype(str).tolist(), "of texts|the text"),
        (array.astype(bool), "must return .* it returns .*(True|False)"),
        ({"a": array}, "a dictionary"),
        (type("Answer", (), {}), "the class Answer"),
    ]


@pytest.mark.parametrize("exercise", TASKS)
def test_a_result_of_another_kind_is_named_in_plain_words(exercise):
    task = assignments._TASKS[exercise]
    right = task.solve(*draw_case(exercise, 0).values())
    if right is None:
        right = np.zeros(4000)
    if isinstance(right, str):
        right = 1.0
    for value, words in arrays_of(right):
        said = refusal(exercise, lambda *_, value=value: value)
        if "must return" not in words and isinstance(right, bool):
            words = "must return True or False; it returns"
        if exercise == "8_decide":
            words = "must return 'deploy' or 'keep' or 'record'; it returns"
        if exercise == "5_bootstrap":
            words += "|is nan or inf"
        if not isinstance(right, bool):
            assert re.search(words, said), said
        assert "Hint: " in said
        assert " a ndarray" not in said


@pytest.mark.parametrize("kind", [float, Fraction, Decimal])
@pytest.mark.parametrize("exercise", ["2_support", "2_ratio", "2_counts", "1_risk"])
def test_right_values_in_arrays_of_objects_or_without_dimension_are_right(
    exercise, kind, capsys
):
    """``np.frompyfunc`` gives objects; ``np.all`` of some arrays no bool."""
    right = first_kind()[function_of(exercise)]

    def answer(*arguments):
        found = np.asarray(right(*arguments))
        if found.dtype == bool:
            return found
        made = [kind(x) if np.isfinite(x) else float(x) for x in found.flat]
        objects = np.empty(len(made), dtype=object)
        objects[:] = made
        objects = objects.reshape(found.shape)
        return objects if kind is float else objects[()]  # one alone as it is

    wrapped = eval(
        f"lambda {', '.join(draw_case(exercise, 0))}: answer("
        f"{', '.join(draw_case(exercise, 0))})",
        {"answer": answer},
    )
    check(exercise, wrapped, cases=ALL_CASES)
    assert "Right" in capsys.readouterr().out


@pytest.mark.parametrize("wrong", [0.0, np.nan, np.inf])
def test_the_entry_that_is_shown_is_a_wrong_one(wrong):
    """The first differs by more, and is within the tolerance."""
    found = np.array([1000.5, wrong, np.inf])
    right = np.array([1000.0, 0.01, np.inf])
    said = say_difference(found, right, np.array([False, True, False]), (), {})
    assert said.startswith(f"entry [1] is {wrong:g}, and 0.01 is right.")
    assert "1 of 3 entries is wrong" in said


@pytest.mark.parametrize("exercise", ["2_ratio", "2_counts"])
@pytest.mark.parametrize("most", [1e6, 1e7])
def test_a_ratio_that_is_cut_however_late_is_refused(exercise, most):
    right = first_kind()[function_of(exercise)]
    name = "target" if exercise == "2_ratio" else "counts"
    cut = eval(
        f"lambda {name}, simulator: np.minimum(right({name}, simulator), {most})",
        {"right": right, "np": np},
    )
    with pytest.raises(RefusedAnswer, match="is not cut"):
        check(exercise, cut)


@pytest.mark.parametrize("exercise", TASKS)
def test_an_argument_that_is_changed_is_named(exercise):
    def spoil(*arguments):
        result = first_kind()[function_of(exercise)](*arguments)
        for value in arguments:
            if isinstance(value, np.ndarray):
                value += value.dtype.type(1)
                break
        return result

    names = [
        name
        for name, value in draw_case(exercise, 0).items()
        if isinstance(value, np.ndarray)
    ]
    if names:
        assert f"changes its argument {names[0]}; work" in refusal(exercise, spoil)
    else:
        assert exercise in ("8_decide", "8_need")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda x: 2 * x, "right result times 2;"),
        (lambda x: -x, "the sign is wrong"),
        (lambda x: 3.7 * x, "every entry is the right one times 3.7;"),
        (lambda x: x + 5, "every entry is the right one plus 5;"),
        (lambda x: x[::-1], "in the reverse order"),
        (lambda x: np.trunc(x), "the fractions are cut off"),
        (lambda x: np.round(x, 3), "rounded to 3 digits"),
        (lambda x: x * (1 + 1e-5), "this is close and not exact"),
        (lambda x: 0 * x, "all entries are 0"),
        (lambda x: np.where(x == x.max(), np.nan, x), "1 of 5 entries is wrong"),
        (lambda x: np.where(x == x.max(), np.nan, x), "is nan, and"),
        (lambda x: np.where(x == x.max(), np.nan, 2 * x), "5 of 5 entries are wrong"),
    ],
)
def test_a_pattern_of_all_entries_is_named(change, said):
    right = first_kind()["state_values"]
    assert said in refusal(
        "3_values", lambda P, r, policy, discount: change(right(P, r, policy, discount))
    )


def test_every_entry_is_said_of_a_pattern_that_every_entry_follows():
    """A large entry beside small ones that are right is no factor of all."""
    found, right = np.array([3e9, 0.5, 0.25, 1.0]), np.array([1e9, 0.5, 0.25, 1.0])
    for pattern in (3.0, 1.0, 0.5):
        said = explain_pattern(found * pattern, right, {}, is_entrywise=True)
        assert "times" not in said
    every = explain_pattern(3.0 * right, right, {}, is_entrywise=True)
    assert every == "every entry is the right one times 3"


def test_a_wrong_entry_is_named_with_what_is_there():
    def ratio(target, simulator):
        return target / np.maximum(simulator, 1e-3)

    said = refusal("2_ratio", lambda target, simulator: ratio(target, simulator))
    assert re.search(
        r"in case 3, where probabilities of both are near 1e-6: entry"
        r" \[(\d), (\d), (\d)\] is 0\.002, and 2 is right\. This is state \1, action"
        r" \2, next state \3, where target is 2e-06 and simulator is 9\.99999e-07\."
        r" \d+ of \d+ entries are wrong\."
        r" Hint: divide by the simulator's probability as it is",
        said,
    )
    assert said.endswith('Its arguments: draw_case("2_ratio", 3).')


def test_two_numbers_that_look_alike_get_more_digits():
    said = refusal("1_risk", lambda g, p, q: q @ g - p @ np.log(g) + 1e-6)
    found, right = re.search(r"it returns (\S+), and (\S+) is right", said).groups()
    assert found != right


@pytest.mark.parametrize("huge", ["posinf", "neginf"])
def test_what_nan_to_num_makes_of_inf_is_named(huge):
    """It is no other mistake, though others have such entries too."""
    right = first_kind()["ratio_from_counts"]

    def answer(counts, simulator):
        inf = np.inf if huge == "posinf" else -np.inf
        lost = (counts > 0) & (simulator == 0)
        return np.nan_to_num(np.where(lost, inf, right(counts, simulator)))

    told = refusal("2_counts", answer)
    assert "numpy.nan_to_num makes 1.8e308 of it" in told
    assert "a pair without counts" not in told


def test_an_error_in_a_special_case_says_what_is_special():
    def need(gain, error, cost, n):
        return np.ceil(n * (1.96 * error / (gain - cost)) ** 2)

    answer = lambda gain, error, cost, n: need(gain, error, cost, n)  # noqa: E731
    said = refusal("8_need", answer)
    assert "raises ZeroDivisionError" in said
    assert (
        "This happens in case 1, where the gain equals the cost: where the gain" in said
    )


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

    check("1_risk", risk)
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
    for case in range(0, 80, 10):  # plain ones, where every pair has a cost
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
    assert "import check, draw_case\\n" in text
    assert (
        text.count("raise NotImplementedError()\n") == 0 or "# YOUR CODE HERE" in text
    )
    stubs = [c for c in code_cells(made) if about(c).get("solution")]
    assert all("raise NotImplementedError()" in cell.source for cell in stubs)
    assert len(stubs) >= 2


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_a_student_reads_what_to_install_and_what_to_hand_in(path):
    """In the released notebook itself, which may be all that a student has."""
    text = read(make()["released"](path)).cells[0].source
    assert f"keep the name of its file, `{path.name}`" in text
    assert "The package must be installed: `pip install" in text
    named = re.findall(r"`(notebooks[^`]*)`", text)
    assert named
    assert all((FOLDER.parents[1] / name).exists() for name in named)


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


def week_of_each_assignment():
    """Week -> number of the assignment, by the syllabus."""
    syllabus = (FOLDER.parent / "syllabus.md").read_text()
    rows = re.findall(r"^\| (\d) \|.*release/assignment_(\d)/", syllabus, re.M)
    return dict(rows)


def test_page_syllabus_and_notebooks_name_the_same_weeks():
    page = (FOLDER.parent / "assignments.md").read_text()
    rows = re.findall(r"^\| \[(\d)\]\(syllabus.md.*?\) \| (\d) \|", page, re.M)
    assert dict(rows) == week_of_each_assignment()
    assert [week for week, _ in rows] == list("12345678")
    for path in SOURCES:
        number = path.parent.name[-1]
        [week] = [w for w, k in rows if k == number]
        assert f"for week {week} of the course" in " ".join(
            read(path).cells[0].source.split()
        )


def test_the_page_says_the_points_and_what_is_graded():
    page = (FOLDER.parent / "assignments.md").read_text()
    shown = re.findall(r"^\| (\d) \| `(\w+)` \| (\d) \| (\d) \| (\S.*) \|$", page, re.M)
    expected = []
    for path in SOURCES:
        points = {
            about(cell)["grade_id"]: str(about(cell)["points"])
            for cell in code_cells(read(path))
            if about(cell).get("grade")
        }
        for name in TASKS:
            number, _, word = name.partition("_")
            if path.parent.name == f"assignment_{number}":
                ids = [f"assignment_{number}_{word}_{x}" for x in ("visible", "hidden")]
                expected.append((number, function_of(name), *map(points.get, ids)))
    assert [row[:4] for row in shown] == expected
    assert all(len(row[4]) > 20 for row in shown)
    kinds = {
        function_of(name): " ".join(kind.about for kind in task.kinds)
        for name, task in assignments._TASKS.items()
    }
    for _, name, _, _, text in shown:
        for number in re.findall(r"0\.999|0\.99|150|1\.957|1\.963|1e-9|1e6", text):
            assert number in kinds[name], (name, number)
    texts = {row[1]: row[4] for row in shown}
    for name, suspects in (
        ("shift_law", assignments.estimator_law.SHIFT_SUSPECTS),
        ("limit_law", assignments.estimator_law.LIMIT_SUSPECTS),
    ):
        n_right = sum(suspect.is_right for suspect in suspects)
        n_wrong = len(suspects) - n_right
        said = (
            f"which of {n_right + n_wrong} estimators it lets pass: {n_right} obey the"
        )
        assert texts[name].startswith(f"{said} law and {n_wrong} break it")


def test_the_page_says_what_is_there():
    page = (FOLDER.parent / "assignments.md").read_text()
    rows = re.findall(
        r"^\| \[\d\]\(\S+\) \| (\d) \| .*\]\((assignments/release/.*)\) \| 10 \|$",
        page,
        re.M,
    )
    expected = [
        (path.parent.name[-1], make()["released"](path).relative_to(FOLDER.parent))
        for path in SOURCES
    ]
    assert sorted((number, Path(name)) for number, name in rows) == expected
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
    assert found.stdout.splitlines() == [
        *(f"{path}: 10 of 10 points" for path in SOURCES),
        *("", "1 student", "  source: 80 of 80"),
    ]
    assert (found.stderr, found.returncode) == ("", 0)
    assert [path.name for path in tmp_path.iterdir()] == ["grades.csv"]
    rows = table_of(tmp_path / "grades.csv")
    assert len(rows) == len(SOURCES) + 1
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
    almost = "def risk(g, p, q):\n    return q @ g - p @ np.log(g)"
    changes = {
        "assignment_1_risk": almost,
        "assignment_1_risk_visible": "print('Right.')",
        "assignment_1_risk_hidden": "pass",
        "assignment_1_minimiser_visible": "print('Right.')",
        "assignment_1_normalised_hidden": None,
    }
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    assert "risk.ipynb: 0 of 10 points" in found
    assert re.search(r"assignment_1_risk_visible: 0 of 1: .*also where g = 0", found)
    assert re.search(r"assignment_1_risk_hidden: 0 of 2: .*also where g = 0", found)
    assert "assignment_1_normalised_hidden: 0 of 3: RefusedAnswer" in found


def test_a_variable_named_check_does_not_stand_in_its_place(tmp_path):
    changes = {
        "assignment_1_risk": "check = lambda *_, **__: None\nrisk = None",
        "assignment_1_minimiser": "check = 3\ndraw_case = 4\nminimiser = check",
    }
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    assert "risk.ipynb: 0 of 10 points" in found
    assert "assignment_1_risk_visible: 0 of 1: RefusedAnswer" in found
    assert "assignment_1_minimiser_hidden: 0 of 2: RefusedAnswer" in found


def test_a_notebook_that_runs_for_ever(tmp_path):
    path = submission(tmp_path, {"assignment_1_risk": "while True: pass"})
    found = run_grade(
        path, "--seconds", 3, "--output", "grades.csv", folder=tmp_path
    ).stdout
    assert "risk.ipynb: 0 of 10 points" in found
    # a busy machine may still be importing the package
    late = r"it ran longer than 3 s, in (assignment_1_risk|code cell 1)$"
    assert re.search(f"assignment_1_risk_visible: 0 of 1: {late}", found, re.M)
    [row, total] = table_of(tmp_path / "grades.csv")
    assert re.search(f"assignment_1_normalised_hidden: {late}", row["message"])
    assert (total["points"], total["of"]) == ("0", "10")


def test_a_notebook_that_ends_python_keeps_its_points(tmp_path):
    good = "def risk(g, p, q):\n    t = p > 0\n    return q @ g - p[t] @ np.log(g[t])"
    changes = {
        "assignment_1_risk": good,
        "assignment_1_minimiser": "import os\nos._exit(1)",
    }
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    assert "risk.ipynb: 3 of 10 points" in found
    ended = "the notebook ended its process (exit code 1), in assignment_1_minimiser"
    assert f"assignment_1_minimiser_visible: 0 of 1: {ended}" in found


def table_of(path):
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def put(source, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(source if isinstance(source, str) else source.read_text())


def test_a_class_in_both_layouts_is_graded_student_by_student(tmp_path):
    """What cannot be graded is a row with its reason, and the others go on."""
    risk, ratio = SOURCES[:2]
    empty = FOLDER / "release/assignment_1/risk.ipynb"
    put(risk, tmp_path / "submitted/anna/assignment_1/risk.ipynb")
    put(ratio, tmp_path / "submitted/anna/assignment_2/true_ratio.ipynb")
    put("{}", tmp_path / "submitted/anna/.ipynb_checkpoints/risk.ipynb")
    put("seven", tmp_path / "submitted/ben/risk.ipynb")
    put(risk, tmp_path / "submitted/cleo/mine.ipynb")
    put(empty, tmp_path / "submitted/cleo/risk (1).ipynb")
    put(risk, tmp_path / "submitted/cleo/assignment_1/risk.ipynb")
    found = run_grade(
        *("submitted", "--output", "grades.csv", "--tests", "tests.csv"),
        folder=tmp_path,
    )
    assert (found.returncode, found.stderr) == (1, "")
    rows = table_of(tmp_path / "grades.csv")
    expected = [
        ("anna", "assignment_1", "10", "10", ""),
        ("anna", "assignment_2", "10", "10", ""),
        ("anna", "total", "20", "20", ""),
        ("ben", "assignment_1", "0", "10", "could not be read: it must be a notebook"),
        ("ben", "assignment_2", "0", "10", "handed in nothing"),
        ("ben", "total", "0", "20", ""),
        ("cleo", "assignment_1", "10", "10", ""),
        ("cleo", "assignment_1", "0", "0", "not counted: handed in several times, and"),
        ("cleo", "", "0", "0", "not graded: it must have the name of an assignment"),
        ("cleo", "assignment_2", "0", "10", "handed in nothing"),
        ("cleo", "total", "10", "20", ""),
    ]
    columns = ("student", "assignment", "points", "of")
    assert [tuple(row[name] for name in columns) for row in rows] == [
        row[:4] for row in expected
    ]
    for row, (*_, message) in zip(rows, expected, strict=True):
        assert row["message"].startswith(message)
        assert bool(row["message"]) == bool(message)
    summary = found.stdout[found.stdout.index("3 students") :].splitlines()
    assert summary[1:5] == [
        "  anna: 20 of 20",
        "  ben: 0 of 20",
        "  cleo: 10 of 20",
        "2 not graded",
    ]
    tests = table_of(tmp_path / "tests.csv")
    assert sum(int(row["points"]) for row in tests) == 30
    assert sum(int(row["of"]) for row in tests) == 60


@pytest.mark.parametrize("best", ["risk.ipynb", "risk (1).ipynb", "a/risk.ipynb"])
def test_of_a_notebook_that_was_handed_in_several_times_the_best_counts(tmp_path, best):
    for name in ("risk.ipynb", "risk (1).ipynb", "a/risk.ipynb"):
        source = (
            SOURCES[0] if name == best else FOLDER / "release/assignment_1/risk.ipynb"
        )
        put(source, tmp_path / "s/ann/assignment_1" / name.replace("a/", "../"))
    found = run_grade("s", "--output", "grades.csv", folder=tmp_path)
    assert found.returncode == 0
    rows = table_of(tmp_path / "grades.csv")
    assert sorted(row["points"] for row in rows) == ["0", "0", "10", "10"]
    lost = [row["message"] for row in rows if row["points"] == "0"]
    assert all("has 10 points, this one 0" in message for message in lost)
    assert sum(int(row["of"]) for row in rows[:-1]) == 10


def test_who_handed_in_nothing_has_a_row(tmp_path):
    """Of one assignment too, where others were handed in."""
    put(SOURCES[0], tmp_path / "s/ann/risk.ipynb")
    put(SOURCES[1], tmp_path / "s/bob/assignment_2/true_ratio.ipynb")
    (tmp_path / "s/cid/assignment_2").mkdir(parents=True)
    (tmp_path / "s/dan").mkdir()
    (tmp_path / "s/.git").mkdir()
    for number in ("2", "assignment_2"):
        options = ("--assignment", number, "--output", "g.csv", "--overwrite")
        assert run_grade("s", *options, folder=tmp_path).returncode == 0
        rows = table_of(tmp_path / "g.csv")
        lost = ("assignment_2", "0", "10", "handed in nothing")
        found = [
            (
                row["student"],
                row["assignment"],
                row["points"],
                row["of"],
                row["message"],
            )
            for row in rows
            if row["assignment"] != "total"
        ]
        assert found == [
            ("ann", *lost),
            ("bob", "assignment_2", "10", "10", ""),
            ("cid", *lost),
            ("dan", *lost),
        ]
    put(SOURCES[1], tmp_path / "s/eve/assignment_2/true_ratio_eve.ipynb")
    put(SOURCES[0], tmp_path / "s/eve/assignment_1/my_risk.ipynb")
    told = run_grade("s", "--assignment", "2", folder=tmp_path)
    assert told.returncode == 1
    assert "true_ratio_eve.ipynb: not graded: it must have the name of" in told.stdout
    assert "my_risk" not in told.stdout
    folders = ("s/bob/assignment_2", "s/cid/assignment_2", "--output", "h.csv")
    assert run_grade(*folders, folder=tmp_path).returncode == 0
    assert [row["points"] for row in table_of(tmp_path / "h.csv")] == [
        *("10", "10"),
        *("0", "0"),
    ]
    none = run_grade("s/cid", "s/dan", folder=tmp_path)
    assert "must have notebooks (.ipynb); it has none" in none.stderr
    own = SOURCES[0].read_text().replace('"points": 1,', '"points": 4,')
    put(own, tmp_path / "own/assignment_1/risk.ipynb")
    told = run_grade("s/ann", "--source", "own", folder=tmp_path)
    assert "risk.ipynb: 19 of 19 points" in told.stdout
    wrong = run_grade("s/ann", "--source", "s", folder=tmp_path)
    assert "--source must have folders assignment_1" in wrong.stderr
    wrong = run_grade("s", "--assignment", "9", folder=tmp_path)
    assert "--assignment must be one of 1, 2, 3, 4, 5, 6, 7, 8; it is 9" in wrong.stderr


def test_rows_are_on_the_disk_before_the_next_student_is_graded(tmp_path):
    """A stop in the middle keeps what was graded."""
    put(SOURCES[0], tmp_path / "submitted/anna/risk.ipynb")
    (tmp_path / "submitted/ben").mkdir()
    submission(tmp_path / "submitted/ben", {"assignment_1_risk": "while True: pass"})
    process = subprocess.Popen(
        [sys.executable, str(FOLDER / "grade.py"), "submitted", "--output", "g.csv"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(FOLDER.parents[1])},
        # children of a background job would ignore it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert "anna/risk.ipynb: 10 of 10 points" in process.stdout.readline()
        for _ in range(200):
            rows = table_of(tmp_path / "g.csv")
            if len(rows) == 2:
                break
            time.sleep(0.05)
        assert [row["assignment"] for row in rows] == ["assignment_1", "total"]
    finally:
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=600)[0]
    assert "Stopped. What was graded is in the tables." in said
    assert process.returncode == 130


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("mine.ipynb", "{}", "must have the name of an assignment, bootstrap.ipynb"),
        ("risk.ipynb", "seven", "must be a notebook of format 4"),
        ("risk.ipynb", "", "must be a notebook of format 4"),
        ("risk.ipynb", "[]", "must be a notebook of format 4"),
        ("risk.ipynb", json.dumps({"cells": [1]}), "must be a notebook of format 4"),
        ("risk.ipynb", None, "must be a file: No such file"),
    ],
)
def test_a_file_that_cannot_be_graded(tmp_path, name, text, said):
    if text is not None:
        (tmp_path / name).write_text(text)
    found = run_grade(name, "--output", "grades.csv", folder=tmp_path)
    assert found.returncode == 1
    assert said in found.stdout
    assert "Traceback" not in found.stderr
    [row, total] = table_of(tmp_path / "grades.csv")
    assert said in row["message"]
    assert (row["points"], total["assignment"]) == ("0", "total")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((".",), ". must have notebooks (.ipynb); it has none"),
        (("risk.ipynb", "--seconds", "0"), "--seconds must be above 0; it is 0"),
        (("risk.ipynb", "--output", "no/g.csv"), "no/g.csv cannot be written"),
    ],
)
def test_bad_arguments_of_the_grader(tmp_path, arguments, said):
    found = run_grade(*arguments, folder=tmp_path)
    assert found.returncode == 2
    assert said in found.stderr.replace("\n", " ")
    assert "Traceback" not in found.stderr


def test_a_cell_that_does_not_run_is_named_where_its_function_is_missing(tmp_path):
    """A missing bracket is not a missing name."""
    changes = {"assignment_1_risk": "def risk(g, p, q):\n    return (q @ g"}
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    why = r"NameError: name 'risk' is not defined \(code cell \d+ raised SyntaxError"
    assert re.search(f"assignment_1_risk_visible: 0 of 1: {why}", found)
    # what another cell raises has nothing to do with it
    changes = {"assignment_1_risk": "1 / 0"}
    found = run_grade(submission(tmp_path, changes), folder=tmp_path).stdout
    assert "name 'risk' is not defined" in found
    assert "ZeroDivisionError" not in found


def test_the_grader_replaces_no_table_unasked(tmp_path):
    submission(tmp_path, {})
    (tmp_path / "grades.csv").write_text("of nbgrader")
    given = ("risk.ipynb", "--tests", "tests.csv", "--output", "grades.csv")
    found = run_grade(*given, folder=tmp_path)
    assert found.returncode == 2
    assert "grades.csv exists; --overwrite replaces it" in found.stderr
    assert (tmp_path / "grades.csv").read_text() == "of nbgrader"
    assert not (tmp_path / "tests.csv").exists()
    nowhere = ("risk.ipynb", "--output", "points.csv", "--tests", "no/tests.csv")
    assert (
        "no/tests.csv cannot be written" in run_grade(*nowhere, folder=tmp_path).stderr
    )
    assert not (tmp_path / "points.csv").exists()
    twice = ("risk.ipynb", "--output", "a.csv", "--tests", "./a.csv", "--overwrite")
    assert "must differ" in run_grade(*twice, folder=tmp_path).stderr
    assert not (tmp_path / "a.csv").exists()
    assert run_grade(*given, "--overwrite", folder=tmp_path).returncode == 0
    assert table_of(tmp_path / "grades.csv")[0]["assignment"] == "assignment_1"


def test_no_file_to_grade(tmp_path):
    assert "give the notebooks to grade" in run_grade(folder=tmp_path).stderr
