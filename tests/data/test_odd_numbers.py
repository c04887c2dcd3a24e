"""Numbers that no float holds, that only Python writes, or that must not be compared."""

import decimal

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from oee_tabular import Transitions
from oee_tabular.exceptions import ArgumentError

LABELS = ["state", "action", "next_state", "reward"]
LARGE = ["7" * 310, "-" + "3" * 400, "8" * 4400, "1e999"]


def log_of(label, value):
    """A good row, and one with the value in a column."""
    second = {"state": "1", "action": "0", "next_state": "0", "reward": "1"}
    rows = ["0,0,1,1", ",".join((second | {label: value}).values())]
    return "\n".join([",".join(LABELS), *rows]) + "\n"


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize("value", LARGE, ids=["310", "negative", "4400", "power"])
@pytest.mark.parametrize("label", LABELS)
def test_a_number_beyond_all_floats_in_a_file(tmp_path, label, value, read):
    (tmp_path / "log.csv").write_text(log_of(label, value))
    rule = "be finite" if label == "reward" else "be an integer"
    with pytest.raises(ArgumentError, match=rf"{label}\[1\] must {rule}"):
        read(tmp_path / "log.csv")


@pytest.mark.parametrize("label", ["state", "reward", "episode", "timestep"])
@pytest.mark.parametrize(
    "value", [3**700, -(10**350), decimal.Decimal("-1e5000")], ids=["3", "10", "e"]
)
def test_a_number_beyond_all_floats_in_a_frame(label, value):
    columns = {name: [0, 0] for name in LABELS}
    frame = pd.DataFrame(columns | {label: pd.Series([0, value], dtype=object)})
    with pytest.raises(ArgumentError, match=rf"{label}\[1\] must be "):
        Transitions.from_frame(frame)


@pytest.mark.parametrize("text", ["1_0", "0_1.5", "1_000_000"])
def test_a_reward_with_underscores_is_no_number(tmp_path, text):
    (tmp_path / "log.csv").write_text(log_of("reward", text))
    with pytest.raises(ArgumentError, match=r"reward\[1\] must be a number; it is"):
        Transitions.load(tmp_path / "log.csv")


def test_a_signaling_nan_is_missing():
    columns = {name: [0, 0] for name in LABELS}
    odd = pd.Series([decimal.Decimal(2), decimal.Decimal("-sNaN12")], dtype=object)
    log = Transitions.from_frame(pd.DataFrame(columns | {"reward": odd}))
    assert_array_equal(log.reward, [2.0, np.nan])
    with pytest.raises(ArgumentError, match=r"action\[1\] must have a value"):
        Transitions.from_frame(pd.DataFrame(columns | {"action": odd}))


def test_integers_in_an_array_of_objects():
    ids = np.array([4.0, decimal.Decimal(4), 5], dtype=object)
    log = Transitions([0, 1, 0], [0, 0, 0], [1, 0, 1], episode=ids)
    assert_array_equal(log.episode, [4, 4, 5])
    for item in (None, b"5", [5], object, True, np.nan):
        ids = np.empty(3, dtype=object)
        ids[:] = [4, 4, item]
        with pytest.raises(ArgumentError, match=r"episode\[2\]"):
            Transitions([0, 1, 0], [0, 0, 0], [1, 0, 1], episode=ids)


def test_a_frame_in_place_of_a_path():
    frame = pd.DataFrame({name: [0] for name in LABELS})
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ArgumentError, match="DataFrame, which from_frame reads"):
            read(frame)


@pytest.mark.parametrize("label", ["state", "action", "next_state", "episode"])
@pytest.mark.parametrize(("kind", "digits"), [("f2", 11), ("f4", 24), ("f8", 53)])
def test_floats_are_integers_below_where_they_hold_each(label, kind, digits):
    columns = {name: np.zeros(2, dtype=np.int64) for name in LABELS[:3]}
    good = np.full(2, 2**digits - 1, dtype=kind)
    log = Transitions(**columns | {label: good})
    assert_array_equal(log.columns()[label], 2**digits - 1)
    bad = np.full(2, 2**digits, dtype=kind)
    frame = pd.DataFrame(columns | {label: bad})
    rule = rf"{label}\[0\] must be an integer of 64 bits, or below 2\*\*{digits},"
    with pytest.raises(ArgumentError, match=rule):
        Transitions(**columns | {label: bad})
    with pytest.raises(ArgumentError, match=rule):
        Transitions.from_frame(frame)


@pytest.mark.parametrize(
    "value", [[1.0], np.ones(1), {"a": 1}, (1.0,), b"1", 1j, True], ids=repr
)
def test_what_is_no_number_is_said_to_be_none(value):
    rewards = pd.Series([0.5, value], dtype=object)
    frame = pd.DataFrame({name: [0, 0] for name in LABELS} | {"reward": rewards})
    with pytest.raises(ArgumentError, match=r"reward\[1\] must be a number; it is"):
        Transitions.from_frame(frame)


@pytest.mark.parametrize("value", [np.inf, np.float32("inf"), decimal.Decimal("inf")])
def test_what_is_not_finite_is_said_to_be_so(value):
    rewards = pd.Series([0.5, value], dtype=object)
    frame = pd.DataFrame({name: [0, 0] for name in LABELS} | {"reward": rewards})
    with pytest.raises(ArgumentError, match=r"reward\[1\] must be finite; it is"):
        Transitions.from_frame(frame)


def test_an_array_without_dimensions_is_its_number():
    rewards = pd.Series([np.array(0.5), np.array(2)], dtype=object)
    frame = pd.DataFrame({name: [0, 0] for name in LABELS} | {"reward": rewards})
    assert_array_equal(Transitions.from_frame(frame).reward, [0.5, 2.0])
