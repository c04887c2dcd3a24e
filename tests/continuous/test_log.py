import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from oee_tabular.data import ContinuousTransitions
from oee_tabular.exceptions import ArgumentError, DataWarning

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
    n = draw(st.integers(1, 6))
    d = draw(st.integers(1, 4))
    numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)
    state = draw(hnp.arrays(float, (n, d), elements=numbers))
    following = draw(hnp.arrays(float, (n, d), elements=numbers))
    commands = draw(st.booleans())
    action = draw(
        hnp.arrays(float, (n, 2), elements=numbers)
        if commands
        else hnp.arrays(int, n, elements=st.integers(0, 9))
    )
    reward = draw(st.none() | hnp.arrays(float, n, elements=numbers))
    return ContinuousTransitions(
        state, action, following, reward, terminated=draw(hnp.arrays(bool, n))
    )


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
    assert (
        header
        == "state_0,state_1,action,next_state_0,next_state_1,reward,terminated,truncated,episode,timestep,behavior_probability"
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
    assert (
        "4 transitions of 2-dimensional states in 2 episodes: 1 terminated, 1 truncated"
        in repr(found)
    )
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
        UserWarning,
        match=(
            r"2 of 4 rows are none of them; the farthest, row 2, is \[0.7\], 0.7 from"
            r" \[0.0\]"
        ),
    ):
        assert_array_equal(near.action_numbers(table), [0, 2, 1, 1])
    assert_array_equal(log().action_numbers([-10.0, 10.0]), [0, 1, 0, 1])


@pytest.mark.parametrize("n_actions", [2 * 10**6, 5 * 10**6])
def test_more_actions_than_memory_holds_distances_are_refused(n_actions):
    n = 10**5
    states = np.zeros((n, STATES.shape[1]))
    many = ContinuousTransitions(states, np.zeros((n, 1)), states)
    actions = np.linspace(-1.0, 1.0, n_actions)[:, None]
    with pytest.raises(
        ArgumentError, match=f"actions must be small .*{n_actions} needs"
    ):
        many.action_numbers(actions)


def test_float32_copies_of_one_state_are_the_same_state():
    assert len(log(state=STATES.astype(np.float32), next_state=FOLLOWING)) == 4


FILES = {
    "a missing column": (
        "state_0,action,next_state_1\n1,0,2\n",
        "must have every column .*; next_state_0 is missing",
    ),
    "no action": (
        "state_0,next_state_0\n1,2\n",
        "must have the columns state_0, .* it has no action, only ",
    ),
    "both forms": (
        "state_0,state,action,next_state_0\n1,1,0,2\n",
        "must have either state or state_0, ...; it has both",
    ),
    "an empty field": (
        "state_0,action,next_state_0\n1,0,2\n,0,2\n",
        r"state_0\[1\] must have a value; it has none",
    ),
    "no table": ("", "must have a header; the file is empty"),
    "words": (
        "state_0,action,next_state_0\nx,0,2\n",
        r"state_0\[0\] must be a number; it is .x.",
    ),
}


@pytest.mark.parametrize(("text", "message"), FILES.values(), ids=FILES)
def test_bad_files(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + message):
        ContinuousTransitions.load(path)


def test_logs_are_joined_and_drawn_from():
    with pytest.warns(DataWarning, match=r"left out .*: episode, .*logs\[1\] lacks"):
        both = ContinuousTransitions.concatenate([log(), log(episode=None)])
    assert both.episode is None
    two = ContinuousTransitions.concatenate([log(), log()])
    assert_array_equal(two.episode, [4, 4, 4, 7, 12, 12, 12, 15])
    assert_array_equal(two.state, np.concatenate([STATES, STATES]))
    assert_array_equal(two.truncated, np.tile([False, False, False, True], 2))
    drawn = two.draw(8, seed=0)
    assert drawn.episode is None
    assert_array_equal(np.sort(drawn.state[:, 0]), np.sort(two.state[:, 0]))
