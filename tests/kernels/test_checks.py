"""What errors show of values, and how many workers there are, whom no Ctrl-C reaches."""

import math
import re
import subprocess
import sys
import time
from collections import ChainMap, OrderedDict
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pytest
from helpers import rngs, wait_until
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import _checks, _parallel, _printing, _progress
from oee_tabular._sparse import align, canonical, find
from oee_tabular.lab.run import _hold_interrupts

GRID = oee.tasks.gridworld(3, 0.3)
UNIFORM = oee.uniform_policy(GRID)
LOG = oee.sample_episodes(GRID, UNIFORM, 4, 20, seed=0)


def nested_list(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


class Own(Mapping):
    """A mapping that is no dict."""

    def __init__(self, content):
        self.content = content

    def __getitem__(self, key):
        return self.content[key]

    def __iter__(self):
        return iter(self.content)

    def __len__(self):
        return len(self.content)


PAIR = oee.FiniteMDP(np.full((2, 1, 2), 0.5), [[0.0], [1.0]], 0, 0.9)
COUNTED = {"goal": 1, "dock": 0}


@pytest.mark.parametrize(
    "names",
    [
        {"dock", "goal"},
        frozenset(COUNTED),
        iter({"dock", "goal"}),
        COUNTED.keys() | set(),
        COUNTED,
        OrderedDict(COUNTED),
        MappingProxyType(COUNTED),
        Own(COUNTED),
        {0: "dock", 1: "goal"},
        {"dock": "goal", "goal": "dock"},
        ChainMap(COUNTED),
    ],
    ids=lambda names: type(names).__name__,
)
def test_what_has_no_order_or_two_is_no_sequence(names):
    calls = {
        "state_names": lambda: PAIR.with_names(names),
        "action_names": lambda: PAIR.with_names(["a", "b"], names),
        "logs": lambda: oee.Transitions.concatenate(names),
        "path": lambda: oee.Transitions.load(names),
        "episodes": lambda: oee.Transitions.from_episodes(names),
        "laws": lambda: oee.testing.check_estimator(
            oee.estimators.Simulator(), laws=names
        ),
    }
    for argument, function in calls.items():
        with pytest.raises(ValueError, match=rf"^{argument} must be .* \(|got set_it"):
            function()


def test_remedies_for_mappings_of_names_work():
    wanted = ("dock", "goal")
    for names in (COUNTED, {1: "goal", 0: "dock"}, Own(COUNTED)):
        with pytest.raises(ValueError, match="of their numbers: ") as refused:
            PAIR.with_names(names)
        remedy = str(refused.value).rpartition("numbers: ")[2].removesuffix(")")
        made = eval(remedy, {"state_names": names})
        assert PAIR.with_names(made).state_names == wanted
    ordered = dict.fromkeys(wanted)
    for names in (ordered.keys(), iter(wanted), (name for name in wanted), [*wanted]):
        assert PAIR.with_names(names).state_names == wanted


@pytest.mark.parametrize("value", [True, False, np.True_, np.array(False), [True]])
def test_a_truth_value_is_no_number(value):
    calls = {
        "discount": lambda: PAIR.with_discount(value),
        "slip": lambda: oee.tasks.gridworld(3, value),
        "weight_of_a": lambda: oee.mix([[1.0]], [[1.0]], value),
        "seed": lambda: oee.sample_episodes(PAIR, [0, 0], 2, 2, seed=value),
        "horizon": lambda: oee.policy_value(PAIR, [0, 0], horizon=value),
    }
    for argument, function in calls.items():
        with pytest.raises(ValueError, match=f"^{argument} must (be|hold)"):
            function()


@given(st.floats(0.0, 1e-5, exclude_min=True))
def test_a_number_beyond_a_limit_is_never_shown_as_the_limit(excess):
    for value in (1.0 + excess, -excess):
        if 0.0 <= value <= 1.0:
            continue
        with pytest.raises(ValueError, match="discount must be in") as refused:
            PAIR.with_discount(value)
        assert not 0.0 <= float(str(refused.value).rpartition(" ")[2]) <= 1.0


class Silent:
    def __repr__(self):
        raise RecursionError


@pytest.mark.parametrize(
    "value",
    [
        nested_list(10_000),
        np.zeros((2,) * 30, dtype=bool),
        np.full((400, 400), None),
        10**5000,
        "x" * 10**7,
        list(range(10**6)),
        Silent(),
        sparse.eye_array(5),
        dict.fromkeys(range(1000), "y" * 1000),
    ],
    ids=lambda value: type(value).__name__,
)
def test_any_value_is_shown_in_few_calls_and_briefly(value):
    calls = []
    sys.setprofile(lambda *event: calls.append(event[1]))
    try:
        text = _checks.show(value)
    finally:
        sys.setprofile(None)
    # of a list with a million items, a few are looked at
    assert len(calls) < 2000
    assert 0 < len(text) <= 300
    with pytest.raises(ValueError, match="horizon must be"):
        oee.policy_value(
            GRID, UNIFORM, horizon=value if not isinstance(value, int) else -value
        )


@pytest.mark.parametrize("text", ["\x1b[31mX", "a\nb", "\x9b31m", "\u202egnp"])
def test_control_characters_are_visible(text):
    assert _checks.show(text).isprintable()
    assert _checks.escape_controls(text).isprintable()
    with pytest.raises(ValueError, match="estimators") as refused:
        oee.evaluate(oee.Problem(GRID, LOG), UNIFORM, estimators=[text])
    assert str(refused.value).isprintable()


@pytest.mark.parametrize(
    ("jobs", "cells", "most"), [(1000, 3, 3), (2, 3, 2), (2, 1, 2), (1, 5, 1)]
)
def test_no_more_jobs_than_cells_but_one_cell_has_a_process_of_its_own(
    jobs, cells, most
):
    assert _parallel.parallel(cells, jobs, None).n_jobs == most


def test_workers_are_not_interrupted_themselves():
    """Ctrl-C reaches every process of a terminal; those that still import would each
    print a traceback.
    """
    script = (
        "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK,"
        " []))"
    )
    with _hold_interrupts():
        inside = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        )
    outside = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert (inside.stdout, outside.stdout) == ("True\n", "False\n")


# ---- numbers, intervals and tables in text
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
        ((-18.92, 4.857), "[-19, 5]"),
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


# ---- slow steps are told on stderr
def test_slow_steps_are_reported_once_on_stderr(capsys, monkeypatch):
    monkeypatch.setattr(_progress, "SECONDS", 0.02)
    told = ""

    def wait_for(word):
        def is_told():
            nonlocal told
            captured = capsys.readouterr()
            assert captured.out == ""
            told += captured.err
            return word in told

        wait_until(is_told)

    _progress.report_step("nobody listens")
    with _progress.show_steps():
        _progress.report_step("a first step")
        with _progress.show_steps():
            wait_for("first")
        _progress.report_step("a second step")
        wait_for("second")
        time.sleep(0.1)
    told += capsys.readouterr().err
    assert re.sub(r"\d+ s", "N s", told).splitlines() == [
        "oee: N s: a first step",
        "oee: N s: a second step",
    ]


# ---- one matrix on the pattern of another
@given(rngs)
def test_values_on_another_pattern(rng):
    """As dense arrays say; the other pattern may be the same."""
    shape = tuple(rng.integers(1, 9, size=2))
    table = np.where(rng.random(shape) < rng.random(), rng.random(shape), 0)
    other = table if rng.random() < 0.2 else rng.permuted(table, axis=1)
    source, pattern = (
        canonical(sparse.csr_array(each), drop_zeros=False) for each in (table, other)
    )
    values, stored = align(source, pattern)
    there = np.nonzero(other)
    assert_array_equal(values, table[there])
    assert_array_equal(stored, table[there] != 0)
    place, is_found = find(source, *there)
    assert_array_equal(is_found, stored)
    assert_array_equal(source.data[place[stored]], values[stored])
