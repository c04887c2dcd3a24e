"""Parquet with vectors in lists, such as LeRobot's; DuckDB writes the files."""

import duckdb
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from oee_tabular.continuous.log.transitions import holds_states
from oee_tabular.data import ContinuousTransitions, Transitions
from oee_tabular.exceptions import ArgumentError, DataWarning

STATE = [[0.0, 0.5], [1.0, 1.5], [2.0, 2.5], [7.0, 7.5], [8.0, 8.5]]
FRAMES = {
    "observation.state": ("FLOAT[2]", STATE),
    "action": ("FLOAT[]", [[0.0], [1.0], [2.0], [3.0], [4.0]]),
    "timestamp": ("FLOAT", [0.0, 0.1, 0.2, 0.0, 0.1]),
    "frame_index": ("BIGINT", [0, 1, 2, 0, 1]),
    "episode_index": ("BIGINT", [0, 0, 0, 1, 1]),
    "index": ("BIGINT", [0, 1, 2, 3, 4]),
    "next.reward": ("FLOAT", [0.25, 0.5, 0.0, 0.75, 0.0]),
    "next.done": ("BOOLEAN", [False, False, True, False, True]),
    "task_index": ("BIGINT", [0] * 5),
}


def write(path, **changes):
    """Write the frames; a change is a column (its type and values), or None."""
    columns = {name: column for name, column in (FRAMES | changes).items() if column}
    connection = duckdb.connect()
    types = ", ".join(f'"{name}" {kind}' for name, (kind, _) in columns.items())
    connection.execute(f"CREATE TABLE frames ({types})")
    rows = list(zip(*(values for _, values in columns.values()), strict=True))
    marks = ", ".join("?" * len(columns))
    connection.executemany(f"INSERT INTO frames VALUES ({marks})", rows)
    connection.execute(f"COPY frames TO '{path}' (FORMAT parquet)")
    return path


def test_frames_are_shifted_within_their_episodes(tmp_path):
    path = write(tmp_path / "file-000.parquet")
    log = ContinuousTransitions.load(path)
    assert_array_equal(log.state, np.array(STATE)[[0, 1, 3]])
    assert_array_equal(log.next_state, np.array(STATE)[[1, 2, 4]])
    assert_array_equal(log.action, [[0.0], [1.0], [3.0]])
    assert_array_equal(log.reward, [0.25, 0.5, 0.75])
    assert_array_equal(log.episode, [0, 0, 1])
    assert_array_equal(log.timestep, [0, 1, 0])
    assert_array_equal(log.truncated, [False, True, True])
    assert not log.terminated.any()
    assert holds_states(path)


def test_files_of_a_data_set_are_one_log(tmp_path):
    folder = tmp_path / "data" / "chunk-000"
    folder.mkdir(parents=True)
    write(folder / "file-000.parquet")
    write(folder / "file-001.parquet", episode_index=("BIGINT", [2, 2, 2, 3, 3]))
    log = ContinuousTransitions.load(tmp_path / "data" / "*" / "*.parquet")
    assert len(log) == 6
    assert log.n_episodes == 4


def test_columns_name_other_vectors(tmp_path):
    more = {
        "observation.environment_state": ("DOUBLE[]", [[k] for k in range(5)]),
        "lift": ("DOUBLE", [5.0, 6.0, 7.0, 8.0, 9.0]),
    }
    path = write(tmp_path / "a.parquet", **more)
    both = ["observation.state", "observation.environment_state", "lift"]
    with pytest.warns(
        DataWarning, match="left out: observation.environment_state, lift"
    ):
        ContinuousTransitions.load(path)
    log = ContinuousTransitions.load(path, columns={"state": both})
    assert log.state.shape == (3, 4)
    assert_array_equal(log.state[1], [1.0, 1.5, 1.0, 6.0])
    assert_array_equal(log.next_state[0], log.state[1])
    with pytest.warns(DataWarning, match="next.done"):
        log = ContinuousTransitions.load(
            path, columns={"state": both, "terminated": None}
        )
    assert not log.terminated.any()


def test_lists_with_a_next_state_are_read_row_by_row(tmp_path):
    following = ("FLOAT[2]", [[k, k] for k in range(5)])
    path = write(
        tmp_path / "a.parquet",
        next_state=following,
        state=FRAMES["observation.state"],
        reward=FRAMES["next.reward"],
        terminated=FRAMES["next.done"],
        **dict.fromkeys([label for label in FRAMES if label != "action"]),
    )
    log = ContinuousTransitions.load(path)
    assert_array_equal(log.next_state[:, 0], range(5))
    assert_array_equal(log.terminated, FRAMES["next.done"][1])


def test_a_reward_of_a_last_frame_is_not_lost_without_a_word(tmp_path):
    paid = ("FLOAT", [0.0, 0.0, 1.0, 0.0, 0.5])
    path = write(tmp_path / "a.parquet", **{"next.reward": paid})
    with pytest.warns(
        DataWarning, match="in 2 of 2 episodes it has a reward, in all 1.5"
    ):
        ContinuousTransitions.load(path)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"observation.state": ("FLOAT[]", [[1.0], [1, 2], [1], [1], [1]])},
            "1 to 2 numbers",
        ),
        (
            {"observation.state": ("FLOAT[]", [[1.0], None, [1], [1], [1]])},
            "1 rows without one",
        ),
        ({"observation.state": ("FLOAT[]", [[]] * 5)}, "one length, at least 1"),
        (
            {"observation.state": ("FLOAT[]", [[1.0], [None], [1], [1], [1]])},
            r"state_0\[1\]",
        ),
        ({"observation.state": ("VARCHAR[]", [["a"]] * 5)}, "lists of numbers"),
        ({"observation.state": ("FLOAT[][]", [[[1.0]]] * 5)}, "lists of numbers"),
        (
            {"observation.state": ("FLOAT[]", [[1.0], [float("inf")], [1], [1], [1]])},
            "finite",
        ),
        ({"frame_index": ("BIGINT", [0, 2, 3, 0, 1])}, "row 1 must be the frame after"),
        ({"episode_index": ("BIGINT", [0, 1, 2, 3, 4])}, "an episode of two frames"),
        (
            {"episode_index": ("BIGINT", [0, 0, 1, 0, 0]), "next.reward": None},
            "episode",
        ),
        (
            {
                "episode_index": None,
                "frame_index": None,
                "next.done": None,
                "next.reward": None,
            },
            "a column episode",
        ),
        ({"action": None}, "no action"),
        ({"next.reward": ("FLOAT", [0.0, None, 0.0, 0.0, 0.0])}, "reward"),
    ],
)
def test_frames_that_break_a_rule_are_refused(changes, text, tmp_path):
    path = write(tmp_path / "a.parquet", **changes)
    with pytest.raises(ValueError, match=text) as error:
        ContinuousTransitions.load(path)
    assert "a.parquet" in str(error.value) or "episode" in str(error.value)


@pytest.mark.parametrize("columns", [{"state": "pose"}, {"pose": "state"}])
def test_columns_that_are_not_there_are_refused(columns, tmp_path):
    path = write(tmp_path / "a.parquet")
    with pytest.raises(ArgumentError, match="columns must"):
        ContinuousTransitions.load(path, columns=columns)


def test_a_log_of_numbers_says_what_it_lacks(tmp_path):
    path = write(tmp_path / "a.parquet")
    with pytest.raises(ArgumentError):
        Transitions.load(path)
