"""The exercises of the notebooks: right answers are accepted, wrong ones rejected with
their hint, none is no error.

The right answers are computed here by the package, not copied from the checks.
"""

import math
import re

import numpy as np
import pytest
from answers import CASES, one_row
from scipy import sparse

import oee_tabular as oee
from oee_tabular.testing.exercises import check


@pytest.mark.parametrize("name", CASES)
def test_right_answers_are_accepted(name, capsys):
    right = CASES[name][0]()
    check(name, right)
    if np.ndim(right) == 0 and right is not False:
        check(name, np.float64(right))
        check(name, float(f"{float(right):.5g}"))  # as a reader types it
    assert set(capsys.readouterr().out.splitlines()) == {"Right."}


@pytest.mark.parametrize("name", CASES)
def test_wrong_answers_are_rejected_with_a_hint(name, capsys):
    _, wrong, word = CASES[name]
    for answer in [
        *wrong,
        "seven",
        [],
        [[1], [1, 2]],
        math.nan,
        math.inf,
        True,
        object(),
    ]:
        with pytest.raises(
            AssertionError, match=rf"is not right\. Hint: .*{re.escape(word)}"
        ):
            check(name, answer)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("name", CASES)
def test_a_missing_answer_is_reported(name, capsys):
    check(name, None)
    assert "Not answered yet" in capsys.readouterr().out


def test_an_exercise_that_is_not_there():
    with pytest.raises(
        ValueError, match=r"exercise must be one of 00_a, 01_a, .*; it is '13_a'"
    ):
        check("13_a", 1.0)


def test_a_tilt_gives_equal_next_states_equal_ratios():
    """What exercise e says, on the fit of lopsided counts."""
    counts = sparse.csr_array(
        ([50.0, 40.0, 5.0, 5.0], ([0] * 4, [1, 2, 3, 4])), shape=(5, 5)
    )
    fitted = oee.transition_ratio(
        counts, one_row(), prior="tilt", strength=1e8
    ).values.toarray()[0, 1:]
    np.testing.assert_allclose(fitted[1:], fitted[1], rtol=1e-5)
    assert abs(fitted[0] - 1) > 0.1
