import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from oee_tabular.data import ContinuousTransitions

STATES = np.array([[0.0, 0.1], [0.2, 0.3], [0.4, 0.1], [1.0, 1.0]])
FOLLOWING = np.array([[0.2, 0.3], [0.4, 0.1], [0.5, 0.0], [2.0, 2.0]])


def log(**changes):
    columns = {
        "state": STATES,
        "action": [0, 1, 0, 1],
        "next_state": FOLLOWING,
        "reward": [1.0, 1.0, 1.0, 0.5],
        "terminated": [0, 0, 1, 0],
        "episode": [4, 4, 4, 7],
        "behavior_probability": [0.5, 0.25, 1.0, 0.0],
    }
    return ContinuousTransitions(**(columns | changes))


def assert_same(a, b):
    assert a.columns().keys() == b.columns().keys()
    for name, column in a.columns().items():
        assert_array_equal(column, b.columns()[name], strict=True)


@st.composite
def logs(draw):
    n, d = draw(st.integers(1, 6)), draw(st.integers(1, 4))
    numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
    state = draw(hnp.arrays(float, (n, d), elements=numbers))
    following = draw(hnp.arrays(float, (n, d), elements=numbers))
    commands = draw(st.booleans())
    action = draw(
        hnp.arrays(float, (n, 2), elements=numbers) if commands else hnp.arrays(int, n, elements=st.integers(0, 9))
    )
    reward = draw(st.none() | hnp.arrays(float, n, elements=numbers))
    return ContinuousTransitions(state, action, following, reward, terminated=draw(hnp.arrays(bool, n)))


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".parquet"])
@settings(max_examples=25)
@given(one=logs())
def test_files_keep_every_bit(tmp_path_factory, suffix, one):
    path = tmp_path_factory.mktemp("log") / f"log{suffix}"
    one.save(path)
    assert_same(ContinuousTransitions.load(path), one)


def test_columns_of_a_table(tmp_path):
    path = tmp_path / "log.csv"
    log().save(path)
    header = path.read_text().splitlines()[0]
    assert header == (
        "state_0,state_1,action,next_state_0,next_state_1,reward,terminated,truncated,episode,timestep,behavior_probability"
    )
    frame = pd.read_csv(path)
    frame[frame.columns[::-1]].assign(comment="x").to_csv(path, index=False)
    with pytest.warns(UserWarning, match="left out: comment"):
        assert_same(ContinuousTransitions.load(path), log())
    wide = np.arange(24.0).reshape(2, 12)  # state_10 comes after state_9
    ContinuousTransitions(wide, [0, 1], wide + 1.0).save(path)
    assert_array_equal(ContinuousTransitions.load(path).state, wide)


def test_what_is_filled_in():
    found = log()
    assert_array_equal(found.timestep, [0, 1, 2, 0])
    assert_array_equal(found.truncated, [False, False, False, True])
    assert (len(found), found.n_state) == (4, 2)
    assert "4 transitions of 2-dimensional states in 2 episodes: 1 terminated, 1 truncated" in repr(found)
    with pytest.raises(ValueError, match="read-only"):
        found.state[0, 0] = 1.0
    assert_array_equal(found.first(2).truncated, [False, True])
    bag = found.select([3, 0])
    assert bag.episode is None
    assert_array_equal(bag.state, STATES[[3, 0]])
    assert_array_equal(bag.timestep, [0, 0])


def test_commands_are_matched_to_the_nearest_action():
    table = [[-2.0], [0.0], [2.0]]
    exact = log(action=[[-2.0], [2.0], [0.0], [0.0]])
    assert_array_equal(exact.action_numbers(table, strict=True), [0, 2, 1, 1])
    near = log(action=[[-1.9], [2.0], [0.7], [0.0]])
    with pytest.warns(
        UserWarning, match=r"2 of 4 rows are none of them; the farthest, row 2, is \[0.7\], 0.7 from \[0.0\]"
    ):
        assert_array_equal(near.action_numbers(table), [0, 2, 1, 1])
    assert_array_equal(log().action_numbers([-10.0, 10.0]), [0, 1, 0, 1])


def test_float32_copies_of_one_state_are_the_same_state():
    assert len(log(state=STATES.astype(np.float32), next_state=FOLLOWING)) == 4


BAD = {
    "a flat state": ({"state": [0.0, 1.0]}, r"^state must have shape \(n, d\); it has shape \(2,\)"),
    "an empty log": ({"state": np.zeros((0, 2))}, r"state must have at least one row; the log is empty"),
    "nan in a state": ({"state": [[0.0, np.nan], *STATES[1:]]}, r"state\[0, 1\] must be finite; it is nan"),
    "inf in a next state": (
        {"next_state": [*FOLLOWING[:3], [np.inf, 0.0]]},
        r"next_state\[3, 0\] must be finite; it is inf",
    ),
    "words": ({"state": [["a", "b"]]}, r"state must be an array of numbers; got list"),
    "other coordinates": (
        {"next_state": FOLLOWING[:, :1]},
        r"next_state must have the 2 coordinates of state; it has 1",
    ),
    "lengths": ({"action": [0, 1, 0]}, r"columns must have equal lengths; .*'action': 3"),
    "a negative action": ({"action": [0, -1, 0, 0]}, r"action\[1\] must be at least 0; it is -1"),
    "half an action": (
        {"action": [0, 0.5, 0, 0]},
        r"action\[1\] must be an integer; it is 0.5 \(call the column of a continuous task's commands action_0\)",
    ),
    "a broken chain": (
        {"next_state": [[0.25, 0.3], *FOLLOWING[1:]]},
        r"next_state\[0\] must be the state of the next row of its episode, which is \[0.2, 0.3\]; it is \[0.25, 0.3\]",
    ),
    "termination in the middle": (
        {"terminated": [1, 0, 1, 0]},
        r"terminated\[0\] must be False: its episode continues in the next row",
    ),
    "a nan reward": ({"reward": [0.0, np.nan, 0.0, 0.0]}, r"reward\[1\] must be finite; it is nan"),
}


@pytest.mark.parametrize(("changes", "text"), BAD.values(), ids=BAD)
def test_bad_columns(changes, text):
    with pytest.raises(ValueError, match=text):
        log(**changes)


CALLS = {
    "a number outside": (
        lambda: log(action=[0, 3, 0, 0]).action_numbers([-1.0, 1.0]),
        r"log.action\[1\] must be in 0..1, .*it is 3",
    ),
    "command dimensions": (
        lambda: log(action=np.zeros((4, 2))).action_numbers([-1.0, 1.0]),
        r"log.action must have the 1 coordinates of the task's actions; it has 2",
    ),
    "strict": (
        lambda: log(action=np.full((4, 1), 0.5)).action_numbers([-1.0, 1.0], strict=True),
        r"log.action must be one of the task's 2 actions; 4 of 4 rows are none of them; the farthest, row 0, is \[0.5\]",
    ),
    "no rows": (lambda: log().select([]), r"rows must choose at least one row"),
    "too many rows": (lambda: log().first(5), r"n must be at most the 4 rows of the log; it is 5"),
    "unknown ending": (lambda: log().save("log.txt"), r"path must end in .npz, .csv, .parquet; it is 'log.txt'"),
    "a folder": (lambda: log().save("folder"), r"path must end in .npz, .csv, .parquet; it is 'folder'"),
    "no file": (lambda: ContinuousTransitions.load("none.csv"), "none.csv"),
}


@pytest.mark.parametrize(("call", "text"), CALLS.values(), ids=CALLS)
def test_bad_calls(call, text):
    with pytest.raises((ValueError, FileNotFoundError), match=text):
        call()


FILES = {
    "a missing column": ("state_0,action,next_state_1\n1,0,2\n", "must have every column .*; next_state_0 is missing"),
    "no action": ("state_0,next_state_0\n1,2\n", "must have the columns state_0, .* it has no action, only "),
    "both forms": ("state_0,state,action,next_state_0\n1,1,0,2\n", "must have either state or state_0, ...; it has both"),
    "an empty field": ("state_0,action,next_state_0\n1,0,2\n,0,2\n", r"state_0\[1\] must have a value; it has none"),
    "no table": ("", "must have the columns state_0"),
    "words": ("state_0,action,next_state_0\nx,0,2\n", r"state_0\[0\] must be finite; it is .x."),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), FILES.values(), ids=FILES)
def test_bad_files(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + message):
        ContinuousTransitions.load(path)


def test_logs_are_joined_and_drawn_from():
    both = ContinuousTransitions.concatenate([log(), log(episode=None)])
    assert both.episode is None
    two = ContinuousTransitions.concatenate([log(), log()])
    assert_array_equal(two.episode, [4, 4, 4, 7, 12, 12, 12, 15])
    assert_array_equal(two.state, np.concatenate([STATES, STATES]))
    assert_array_equal(two.truncated, np.tile([False, False, False, True], 2))
    drawn = two.draw(8, seed=0)
    assert drawn.episode is None
    assert_array_equal(np.sort(drawn.state[:, 0]), np.sort(two.state[:, 0]))
    with pytest.raises(ValueError, match="logs must be one or more ContinuousTransitions"):
        ContinuousTransitions.concatenate([log(), "log"])
