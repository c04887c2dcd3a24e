"""Numbers, intervals and tables in text."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from oee_tabular import _printing


@settings(max_examples=300)
@given(st.floats(-1e12, 1e12), st.floats(1e-9, 1e6))
def test_ends_have_digits_until_their_width_shows(lower, width):
    upper = lower + width
    form = _printing.spec(lower, upper)
    shown = float(f"{upper:{form}}") - float(f"{lower:{form}}")
    if width > 1e-11 * max(abs(lower), abs(upper)):
        assert_allclose(shown, upper - lower, rtol=0.11)


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        ((-11023.4, -11022.9), "[-11023.40, -11022.90]"),
        ((-18.92, 4.857), "[-18.92, 4.86]"),
        ((3.0, 3.0), "[3.000, 3.000]"),
        ((0.0, 0.0), "[0, 0]"),
        ((1.5e20, 1.5003e20), "[1.50000e+20, 1.50030e+20]"),
        ((-math.inf, 2.0), "[-inf, 2]"),
    ],
)
def test_intervals_in_text(ends, text):
    assert _printing.interval(*ends) == text


def test_names_are_escaped_in_tables():
    table = _printing.table(["<h>"], [["<c>"]], caption="<t>", below=["<s>"])
    assert not any(mark in table for mark in ("<h>", "<c>", "<t>", "<s>"))
    assert "&lt;x&gt;" in _printing.text("<x>", "<y>")
