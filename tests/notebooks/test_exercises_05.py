"""The checks of notebook 05's exercises: right answers are accepted, wrong ones rejected with their hint, none is no error.

The right answers are computed here by the package, not copied from the checks.
"""

import importlib.util
import json
import math
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers import rows_of
from scipy import sparse
from scipy.optimize import brentq

import oee_tabular as oee
from oee_tabular.ratio.prior.strength import score

NOTEBOOKS = Path(__file__).parents[2] / "notebooks"
ROW = np.array([0.7, 0.1, 0.1, 0.1])


def _exercises() -> ModuleType:
    spec = importlib.util.spec_from_file_location("exercises", NOTEBOOKS / "exercises.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


exercises = _exercises()


def one_row():
    """One state with a row of four next states, which are all absorbing."""
    rows = np.zeros((5, 1, 5))
    rows[0, 0, 1:] = ROW
    rows[1:, 0, 1:] = np.eye(4)
    return oee.FiniteMDP(rows, np.zeros(5), np.eye(5)[0], 0.9)


def shrunk_ratio():
    counts = sparse.csr_array(([9.0, 1.0], ([0, 0], [1, 2])), shape=(5, 5))
    return oee.transition_ratio(counts, one_row(), prior="simulator", strength=30.0).values.toarray()[0, 1]


def tilt_to(slip):
    def excess(theta):
        tilted = ROW ** (1 + theta)
        return tilted[0] / tilted.sum() - (1 - slip)

    return brentq(excess, -5, 5, xtol=1e-12)


def evidence_gained():
    observed, prior = np.array([2.0, 0.0]), np.array([0.5, 0.5])
    rows = rows_of(prior, [0, 2])
    certain = 2 * math.log(0.5)
    np.testing.assert_allclose(score(1e9, observed, prior, rows), certain, atol=1e-8)
    return score(1.0, observed, prior, rows) - certain


NUMBERS = {
    "05_a": (shrunk_ratio, [0.75, 9 / 7, 1.2, 0, -1.071, math.nan, math.inf], "30 pretended moves"),
    "05_b": (lambda: tilt_to(0.1), [1.694, 0.9, 0.68, -0.435], "the target's are 27"),
    "05_c": (evidence_gained, [1.5, 0.585, 0.176, -0.405], "second move has probability"),
    "05_d": (lambda: tilt_to(0.5), [0.435, 0.565, 0.694, -0.45], "theta is negative"),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_right_answers_are_accepted(name, capsys):
    right = NUMBERS[name][0]()
    for answer in (right, np.float64(right), round(float(right), 3)):
        getattr(exercises, f"check_{name}")(answer)
        assert capsys.readouterr().out.startswith("Right")


@pytest.mark.parametrize("name", NUMBERS)
def test_wrong_answers_get_the_hint(name):
    _, wrong, hint = NUMBERS[name]
    for answer in [*wrong, "0.7", True, [1.0]]:
        with pytest.raises(AssertionError, match=f"is not right. Hint: .*{re.escape(hint)}"):
            getattr(exercises, f"check_{name}")(answer)


def test_true_or_false(capsys):
    exercises.check_05_e(False)
    assert capsys.readouterr().out.startswith("Right")
    for answer in (True, 0, 1, "False"):
        with pytest.raises(AssertionError, match=r"Hint: .*two equal values of P"):
            exercises.check_05_e(answer)


def test_a_tilt_gives_equal_next_states_equal_ratios():
    """What exercise e says, on the fit of lopsided counts."""
    counts = sparse.csr_array(([50.0, 40.0, 5.0, 5.0], ([0] * 4, [1, 2, 3, 4])), shape=(5, 5))
    fitted = oee.transition_ratio(counts, one_row(), prior="tilt", strength=1e8).values.toarray()[0, 1:]
    np.testing.assert_allclose(fitted[1:], fitted[1], rtol=1e-5)
    assert abs(fitted[0] - 1) > 0.1


@pytest.mark.parametrize("name", [*NUMBERS, "05_e"])
def test_no_answer_is_no_error(name, capsys):
    getattr(exercises, f"check_{name}")(None)
    assert "Not answered yet" in capsys.readouterr().out


def test_the_notebook_asks_every_exercise_and_has_no_answers_or_outputs():
    cells = json.loads((NOTEBOOKS / "05_little_data.ipynb").read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    asked = [found for text in code for found in re.findall(r"exercises\.check_(05_\w)\(answer\)", text)]
    assert asked == [*NUMBERS, "05_e"]
    assert all(text.startswith("answer = None") for text in code if "check_05" in text)
    assert not any(cell.get("outputs") for cell in cells)
    solutions = "".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    assert solutions.count("<details>") == solutions.count("</details>") == len(asked)
