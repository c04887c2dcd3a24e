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
