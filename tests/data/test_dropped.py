"""Rows that are left out: those of a known state and action count for their pair."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import TransitionCounts, Transitions
from oee_tabular.exceptions import DataWarning

# 0 the start, 1 the middle, 2 the goal, 3 nowhere that actions lead to
CHAIN = np.array(
    [
        [[0.2, 0.8, 0, 0], [1, 0, 0, 0]],
        [[0, 0.4, 0.6, 0], [1, 0, 0, 0]],
        [[0, 0, 1, 0], [0, 0, 1, 0]],
        [[0.5, 0.5, 0, 0], [0.5, 0.5, 0, 0]],
    ]
)
REWARDS = np.zeros((4, 2, 4))
REWARDS[1, 0, 2] = 10.0
REWARDS[0, :, :] = -1.0
NAMES = ["start", "middle", "goal", "nowhere"]


def simulator(**more):
    return oee.FiniteMDP(CHAIN, REWARDS, 0, 0.9, **more)


def frame_of(n=300, seed=0):
    log = oee.sample_episodes(
        simulator(), oee.uniform_policy(simulator()), n, 20, seed=seed
    )
    return pd.DataFrame(log.columns()).astype({"next_state": object, "reward": object})


def hide(frame, column, rows, value):
    frame = frame.copy()
    frame.loc[rows, column] = value
    return frame


@given(
    st.sampled_from(["next_state", "reward", "terminated", "timestep"]),
    st.sampled_from(["", "NULL", "lost", "-3"]),
    st.sets(st.integers(0, 200), min_size=1),
    st.sampled_from([".csv", ".parquet"]),
)
@settings(max_examples=40, deadline=None)
def test_no_row_is_lost_of_its_pair(tmp_path_factory, column, value, rows, ending):
    """Counts and dropped rows are together the rows of each pair, whatever is wrong."""
    whole = frame_of(40)
    odd = hide(whole.astype(str), column, sorted(rows), value)
    path = tmp_path_factory.mktemp("log") / f"log{ending}"
    (odd.to_csv if ending == ".csv" else odd.to_parquet)(path, index=False)
    found = Transitions.open(path, n_states=4, n_actions=2, bad_rows="drop")
    kept = np.bincount(found.state * 2 + found.action, found.count, 8)
    rows_of_pairs = np.bincount(whole.state * 2 + whole.action, minlength=8)
    assert_array_equal(kept + found.dropped_of_pairs(4, 2), rows_of_pairs)
    assert found.n_dropped_of_pairs == found.recording.dropped


def test_an_interval_lets_dropped_rows_lead_anywhere(tmp_path):
    """The rows that lead to the goal are lost: the value is not that of the others."""
    frame = frame_of()
    policy = np.array([[1.0, 0], [1, 0], [1, 0], [1, 0]])
    truth = oee.policy_value(simulator(), policy)
    lost = hide(frame, "next_state", frame.next_state == 2, np.nan)
    lost.assign(terminated=False).to_csv(tmp_path / "lost.csv", index=False)
    counts = Transitions.open(
        tmp_path / "lost.csv", simulator=simulator(), bad_rows="drop"
    )
    problem = oee.Problem(simulator(), counts)
    n_lost = int((frame.next_state == 2).sum())
    assert problem.dropped.tolist() == [0, 0, n_lost, 0, 0, 0, 0, 0]
    found = oee.interval(problem, policy)
    assert found.lower < truth < found.upper
    texts = [str(finding) for finding in problem.findings]
    assert any(
        f"{n_lost} invalid rows of the log in 1 state-action pair are" in text
        for text in texts
    )
    counts.save(tmp_path / "counts.npz")
    again = oee.Problem(simulator(), tmp_path / "counts.npz")
    assert_array_equal(again.dropped, problem.dropped)


def test_a_log_in_names_and_several_files(tmp_path):
    named = simulator(state_names=NAMES, action_names=["on", "back"])
    frame = frame_of(100)
    for column in ("state", "next_state"):
        frame[column] = [NAMES[k] for k in frame[column]]
    frame["action"] = [("on", "back")[k] for k in frame["action"]]
    frame.loc[[3, 50], "next_state"] = "Middle"
    frame.loc[[7], "state"] = None
    frame.iloc[:120].to_csv(tmp_path / "a.csv", index=False)
    frame.iloc[120:].to_parquet(tmp_path / "b.parquet", index=False)
    found = [
        Transitions.open(tmp_path, simulator=named, bad_rows="drop", jobs=jobs)
        for jobs in (1, 2)
    ]
    assert_array_equal(found[0].dropped, found[1].dropped)
    assert (found[0].n_dropped_of_pairs, found[0].recording.dropped) == (2, 3)
    texts = [str(one) for one in oee.Problem(named, found[0]).findings]
    assert any(
        f"1 invalid row of the log ({1 / len(frame):.2%} of all rows) were not" in text
        for text in texts
    )


def test_a_terminated_row_ends_in_the_only_terminal_state(tmp_path):
    frame = frame_of(60)
    over = frame.terminated
    odd = hide(frame, "next_state", over, None)
    odd.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(ValueError, match="must have a value"):
        Transitions.open(tmp_path / "log.csv", simulator=simulator())
    with pytest.warns(
        DataWarning, match=r"terminated rows have no next_state: read as"
    ):
        found = Transitions.open(
            tmp_path / "log.csv", simulator=simulator(), bad_rows="drop"
        )
    frame.to_csv(tmp_path / "whole.csv", index=False)
    whole = Transitions.open(tmp_path / "whole.csv", simulator=simulator())
    assert found.dropped is None
    for column in ("state", "next_state", "count", "reward_sum"):
        assert_array_equal(getattr(found, column), getattr(whole, column))
    # with two ends nobody knows which
    two = CHAIN.copy()
    two[3] = 0
    two[3, :, 3] = 1
    rewards = REWARDS.copy()
    ends = oee.FiniteMDP(two, rewards, 0, 0.9)
    found = Transitions.open(tmp_path / "log.csv", simulator=ends, bad_rows="drop")
    assert found.n_dropped_of_pairs == over.sum()


def test_counts_without_dropped_rows_still_load(tmp_path):
    found = TransitionCounts([0, 1], [0, 0], [1, 2], [30, 12])
    found.save(tmp_path / "counts.npz")
    with np.load(tmp_path / "counts.npz") as arrays:
        assert "dropped" not in arrays
    assert TransitionCounts.load(tmp_path / "counts.npz").dropped is None


@pytest.mark.parametrize(
    ("dropped", "text"),
    [
        ([[0, 0]], r"dropped must be integers of shape \(L, 3\)"),
        ([[0, 0, 0.5]], r"dropped must be integers of shape \(L, 3\)"),
        ([[0, 0, 0]], r"dropped\[0, 2\] must be in 1\.\.2\*\*53; it is 0"),
        ([[0, -1, 2]], r"dropped\[0, 1\] must be in 0\.\.2\*\*53; it is -1"),
    ],
)
def test_dropped_rows_are_checked(dropped, text):
    with pytest.raises(ValueError, match=text):
        TransitionCounts([0], [0], [0], [1], dropped=dropped)


def test_dropped_rows_are_of_the_simulators_states():
    counts = TransitionCounts([0], [0], [0], [1], dropped=[[9, 0, 2]])
    with pytest.raises(ValueError, match=r"log\.dropped\[0, 0\] must be in 0\.\.3"):
        oee.Problem(simulator(), counts)


@pytest.mark.parametrize(("column", "value"), [("next_state", "?"), ("state", "x")])
@pytest.mark.parametrize(("n_lost", "is_told"), [(1, False), (40, True)])
def test_the_answer_begins_with_what_could_not_be_read(
    tmp_path, column, value, n_lost, is_told
):
    whole = frame_of(100).drop(columns=["episode", "timestep"])
    odd = hide(whole.astype(object), column, list(range(n_lost)), value)
    odd.to_csv(tmp_path / "log.csv", index=False)
    log = Transitions.open(tmp_path / "log.csv", simulator=simulator(), bad_rows="drop")
    problem = oee.Problem(simulator(), log)
    report = oee.evaluate(problem, {"new": oee.uniform_policy(simulator())}, seed=0)
    n = len(whole)
    told = f"{n_lost} of the log's {n} rows ({n_lost / n:.1%}) could not be read"
    assert report.headline.startswith(told) == is_told
