"""What a column is called: labels of other projects, and ``columns``.

Each table is read in every form, and all must agree.
"""

import json
import subprocess
import sys
import warnings
from decimal import Decimal

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.data import ContinuousTransitions
from oee_tabular.data.aliases import ALIASES, DOUBTS, FIELDS, plain
from oee_tabular.data.rules import COLUMNS
from oee_tabular.exceptions import ArgumentError, DataWarning

OURS = pd.DataFrame(
    {
        "state": [0, 1, 0, 1],
        "action": [0, 1, 0, 1],
        "next_state": [1, 2, 1, 2],
        "reward": [0.5, 1.0, 0.5, 1.0],
        "terminated": [False, True, False, True],
        "truncated": [False, False, False, False],
        "episode": [4, 4, 7, 7],
        "timestep": [0, 1, 0, 1],
        "behavior_probability": [0.5, 0.25, 0.5, 0.25],
    }
)
EXPECTED = Transitions(**{label: OURS[label].to_numpy() for label in OURS})
PLAIN = OURS[["state", "action", "next_state", "episode"]]


def forms(table, folder):
    """The ways in which a table is a log: what reads it, by name."""
    table.to_csv(folder / "log.csv", index=False)
    table.to_parquet(folder / "log.parquet", index=False)
    polars = pytest.importorskip("polars")
    return {
        "csv": lambda **way: Transitions.load(folder / "log.csv", **way),
        "parquet": lambda **way: Transitions.load(folder / "log.parquet", **way),
        "pandas": lambda **way: Transitions.from_frame(table, **way),
        "arrow": lambda **way: Transitions.from_frame(pa.table(table), **way),
        "polars": lambda **way: Transitions.from_frame(
            polars.DataFrame({label: table[label].tolist() for label in table}), **way
        ),
        "counted csv": lambda **way: Transitions.open(folder / "log.csv", **way),
        "counted parquet": lambda **way: Transitions.open(
            folder / "log.parquet", **way
        ),
    }


def assert_reads(table, folder, expected=EXPECTED, **way):
    """All forms give the expected log, and the same warnings but for the source."""
    told = set()
    for name, read in forms(table, folder).items():
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            log = read(**way)
        reads = [
            str(each.message) for each in caught if " it reads " in str(each.message)
        ]
        told.add(tuple(text[text.index(" it reads ") :] for text in reads))
        if name.startswith("counted"):
            whole = Transitions.open(saved(expected, folder))
            assert log.summary() == whole.summary(), name
        else:
            assert sorted(log.columns()) == sorted(expected.columns()), name
            for label, column in expected.columns().items():
                assert_array_equal(log.columns()[label], column, err_msg=name)
    assert len(told) == 1
    return next(iter(told))


def saved(log, folder):
    log.save(folder / "expected.parquet")
    return folder / "expected.parquet"


def assert_refused(table, folder, words, **way):
    for read in forms(table, folder).values():
        with pytest.raises(ArgumentError, match=words):
            read(**way)


# ---------------------------------------------------------------- labels of others


PROJECTS = {
    "RLlib": {
        "state": "obs",
        "action": "actions",
        "next_state": "new_obs",
        "reward": "rewards",
        "terminated": "terminateds",
        "truncated": "truncateds",
        "episode": "eps_id",
        "timestep": None,
        "behavior_probability": "action_prob",
    },
    "Tianshou": {
        "state": "obs",
        "action": "act",
        "next_state": "obs_next",
        "reward": "rew",
    },
    "D4RL": {
        "state": "observations",
        "action": "actions",
        "next_state": "next_observations",
        "reward": "rewards",
        "terminated": "terminals",
        "truncated": "timeouts",
    },
    "a spreadsheet": {
        "state": "State",
        "next_state": "Next State",
        "behavior_probability": "Propensity Score",
        "episode": "Episode No",
    },
    "camels and dots": {
        "next_state": "next.state",
        "terminated": "isTerminal",
        "truncated": "TimeLimit.truncated",
        "episode": "trajectoryId",
    },
    "textbook": {"state": "s", "action": "a", "reward": "r", "next_state": "s'"},
}


@pytest.mark.parametrize("project", PROJECTS)
def test_labels_that_mean_one_thing_are_read_with_one_note(tmp_path, project):
    names = PROJECTS[project]
    gone = [label for label, name in names.items() if name is None]
    table = OURS.drop(columns=gone).rename(columns=names)
    (told,) = assert_reads(table, tmp_path)
    for label, name in names.items():
        assert name is None or f"{name!r} as {label}" in told


def test_every_alias_is_read_as_its_column_and_none_is_doubtful():
    assert not any(label in FIELDS for label in DOUBTS)
    assert not any(label in DOUBTS for label in FIELDS)
    for label in (*FIELDS, *DOUBTS):
        assert plain(label) == label
    for field, aliases in ALIASES.items():
        for alias in aliases.split():
            with pytest.warns(DataWarning, match=f" as {field} "):
                log = Transitions.from_frame(OURS.rename(columns={field: alias}))
            assert sorted(log.columns()) == sorted(EXPECTED.columns())


@pytest.mark.parametrize(
    ("label", "field"),
    [
        ("is_episode_terminated", "terminated"),
        ("TerminationFlag", "terminated"),
        ("data/terminals", "terminated"),
        ("task.terminates", "terminated"),
        ("wasTerminated", "terminated"),
        ("terminal-state-flag", "terminated"),
        ("episode truncated", "truncated"),
        ("hasTruncated", "truncated"),
        ("trunc_flag", "truncated"),
    ],
)
def test_labels_of_ends_are_read_by_their_words(label, field):
    with pytest.warns(DataWarning, match=f" as {field} "):
        log = Transitions.from_frame(OURS.rename(columns={field: label}))
    assert_array_equal(getattr(log, field), getattr(EXPECTED, field))


@pytest.mark.parametrize(
    "label",
    [
        "isEnded",
        "data/episode_over",
        "has_finished",
        "doneFlag",
        "game.ended",
        "final_flag",
        "end_state",
        "terminal_state",
        "done_or_truncated",
        "termination_truncation_flag",
        "is_over_flag",
        "next_terminal",
        "is_not_done",
    ],
)
def test_labels_of_ends_that_may_mean_two_things(label):
    table = OURS[["state", "action", "next_state"]].assign(**{label: 1})
    with pytest.raises(ArgumentError, match="whose meaning is clear") as refused:
        Transitions.from_frame(table)
    for field in () if "not" in label else ("terminated", "truncated"):
        assert f"--column {field}={label}" in str(refused.value)
    with pytest.warns(DataWarning, match=f"left out: {label}"):
        Transitions.from_frame(OURS.assign(**{label: 1}))


@pytest.mark.parametrize(
    "label",
    [
        "end_time",
        "end_effector_x",
        "terminal_voltage",
        "final_x",
        "recommended",
        "endpoint",
        "final_reward",
        "terminal_id",
        "termination_reason",
        "overall",
        "is_flag",
        "backend",
        "weekend",
        "data_id",
        "turnover",
        "truncation_error",
        "episode_flag",
    ],
)
def test_labels_that_are_no_ends(label):
    table = OURS[["state", "action", "next_state"]].assign(**{label: 1.5})
    with pytest.warns(DataWarning, match=f"left out: {label}$"):
        Transitions.from_frame(table)


@pytest.mark.parametrize("label", sorted(DOUBTS))
def test_labels_that_may_mean_two_things_are_refused_where_something_is_lost(label):
    table = OURS[["state", "action", "next_state"]].assign(**{label: 1})
    with pytest.raises(ArgumentError, match="whose meaning is clear") as refused:
        Transitions.from_frame(table)
    fields = DOUBTS[label].fields
    for field in fields:
        assert f"columns={{{field!r}: {label!r}}}, --column {field}={label}" in str(
            refused.value
        )
    # beside a log's own columns nothing of the log is lost, and it is said what is not
    # read
    with pytest.warns(DataWarning, match=rf"left out: {label}$") as told:
        log = Transitions.from_frame(OURS.assign(**{label: 1}))
    assert len(told) == 1
    assert len(log.columns()) == len(COLUMNS)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            {"done": OURS["terminated"]},
            r"'done' may say .*--column terminated=done, or",
        ),
        ({"Dones": 1}, r"'Dones' may say that the task ended"),
        ({"done": 1, "truncated": 0}, r"'done' may .*true where this one is and trunc"),
        ({"done": 1, "TimeLimit.truncated": 0}, r"then write a column terminated"),
        ({"nextDone": 0}, "'nextDone' may say"),
        ({"notDone": 0}, "'notDone' may be the opposite"),
        ({"terminatd": 0}, r"'terminatd' resembles terminated .*minated=terminatd"),
        ({"rewad": 0}, "'rewad' resembles reward"),
        ({"truncatde": 0}, "'truncatde' resembles truncated"),
        ({"behaviour_probability": 0}, "resembles behavior_probability"),
        ({"t": 0}, r"'t' may .*--column timestep=t, or .*--column terminated=t"),
        (
            {"action_logp": -1},
            "write a column behavior_probability of its exponentials",
        ),
        (
            {"n": 3, "episode": None},
            r"rows, frame.loc\[frame.index.repeat\(frame\['n'\]\)\].*--column episode=",
        ),
        ({"Visit Count": 3, "episode": None}, "'Visit Count' may say how many"),
        ({"obs": 0, "next_obs": 0, "next_state": None}, "of one kind"),
        ({"traj_id": 0, "ep": 0, "episode": None}, "'traj_id' and 'ep' may each hold"),
    ],
)
def test_what_is_refused_is_so_in_every_form(tmp_path, more, words):
    gone = [label for label, value in more.items() if value is None]
    kept = {label: value for label, value in more.items() if value is not None}
    assert_refused(PLAIN.drop(columns=gone).assign(**kept), tmp_path, words)


@pytest.mark.parametrize(
    "more",
    [
        {"done": 1, "terminated": 0},
        {"done": 1, "terminated": 0, "truncated": 0},
        {"is_last": 1, "is_first": 0, "is_terminal": 0},
        {"step": 5},
        {"terminal": 1, "terminated": 0},
        {"timestamp": 3.5, "behavior_policy": "b"},
        {"rewad": 0, "reward": 1.0},
        {"obs": 3, "next_obs": 3},
    ],
)
def test_what_a_log_can_do_without_is_left_out(tmp_path, more):
    for read in forms(PLAIN.assign(**more), tmp_path).values():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            log = read()
        assert log.summary()["terminated"] == 0
        assert log.summary()["largest_state"] == 2


def test_a_table_of_counts_is_no_log_until_its_rows_are_repeated():
    moves = OURS[["state", "action", "next_state"]]
    for table in (
        moves.groupby(list(moves), as_index=False).size(),
        moves.groupby(list(moves)).size().reset_index(),
        moves.value_counts().reset_index(),
    ):
        with pytest.raises(ArgumentError, match="may say how many transitions a row"):
            Transitions.from_frame(table)
        label = table.columns[-1]
        whole = table.loc[table.index.repeat(table[label])].drop(columns=label)
        assert len(Transitions.from_frame(whole)) == len(OURS)
        with pytest.warns(DataWarning, match=f"left out: {label}$"):
            log = Transitions.from_frame(table, columns={"episode": None})
        assert len(log) == len(table)


def test_a_doubt_is_settled_by_what_columns_says(tmp_path):
    table = PLAIN.assign(done=OURS["terminated"], t=[0, 1, 0, 1])
    moves = {label: PLAIN[label].to_numpy() for label in PLAIN}
    ended = Transitions(**moves, terminated=table["done"].to_numpy())
    assert_reads(table, tmp_path, ended, columns={"terminated": "done"})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        nothing = Transitions(**moves)
        assert_reads(table, tmp_path, nothing, columns={"terminated": None})


@settings(max_examples=60)
@given(st.lists(st.sampled_from([*FIELDS, *DOUBTS, "rewad", "battery"]), unique=True))
def test_whatever_stands_beside_a_log_s_own_columns_changes_nothing(labels):
    table = OURS.assign(**{label: 1 for label in labels if label not in OURS})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings(
            "ignore", message="columns of the frame that a log does"
        )
        log = Transitions.from_frame(table)
    for label, column in EXPECTED.columns().items():
        assert_array_equal(log.columns()[label], column)


@pytest.mark.filterwarnings("ignore:.*hold the same 4 rows")
def test_several_files_are_noted_once(tmp_path):
    for k in range(3):
        OURS.rename(columns={"reward": "rewards"}).to_csv(
            tmp_path / f"{k}.csv", index=False
        )
    for read in (Transitions.load, Transitions.open):
        with pytest.warns(DataWarning, match="'rewards' as reward") as told:
            read(tmp_path)
        assert sum("rewards" in str(each.message) for each in told) == 1


def test_infos_of_minari(tmp_path):
    pytest.importorskip("minari")
    EXPECTED.save(tmp_path / "set")
    log = Transitions.load(tmp_path / "set", columns={"behavior_probability": None})
    assert log.behavior_probability is None
    with pytest.raises(ArgumentError, match="behavior_probability alone for a Minari"):
        Transitions.load(tmp_path / "set", columns={"state": "infos"})


# ---------------------------------------------------------------- columns


ODD = {
    "state": 'pose "before"',
    "action": "did, really",
    "next_state": "after=that",
    "reward": "Zürich",
    "terminated": "state",
    "truncated": "Select",
    "episode": "run",
    "timestep": "k'",
    "behavior_probability": "mu",
}


def test_columns_by_any_label(tmp_path):
    table = OURS.rename(columns=ODD).assign(battery=0.5)
    assert assert_reads(table, tmp_path, columns=ODD) == ()
    problem = oee.Problem(
        oee.tasks.gridworld(3, 0.3),
        OURS.assign(
            next_state=[1, 2, 1, 2], terminated=False, truncated=[0, 1, 0, 1]
        ).rename(columns={"state": "pose"}),
        columns={"state": "pose"},
        impossible="drop",
    )
    assert problem.log.n_episodes == 2


def test_several_labels_make_a_name_in_every_form(tmp_path):
    rows = 40
    table = pd.DataFrame(
        {
            "row": np.arange(rows) % 3,
            "side": np.where(np.arange(rows) % 2, "left", "right"),
            "did": "go",
            "row2": (np.arange(rows) % 3).astype(float),
            "side2": "left",
        }
    )
    columns = {
        "state": ["row", "side"],
        "action": "did",
        "next_state": ("row2", "side2"),
    }
    expected = Transitions.from_frame(table, columns=columns)
    assert expected.state_names[:2] == ((0, "right"), (1, "left"))
    names = [(row, side) for row in range(3) for side in ("left", "right")]
    for name, read in forms(table, tmp_path).items():
        if name.startswith("counted"):
            model = oee.FiniteMDP(
                np.full((6, 1, 6), 1 / 6),
                np.zeros((6, 1)),
                np.full(6, 1 / 6),
                0.9,
                state_names=names,
                action_names=["go"],
            )
            counted = read(columns=columns, simulator=model)
            numbered = expected.numbered(model)
            difference = counted.counts(6, 1) - numbered.counts(6, 1)
            assert difference.nnz == 0, name
        else:
            log = read(columns=columns)
            assert log.state_names == expected.state_names, name
            assert_array_equal(log.next_state, expected.next_state)


@pytest.mark.filterwarnings("ignore:columns of .* are left out")
def test_names_and_vectors_may_share_a_part(tmp_path):
    table = PLAIN.assign(goal=["x", "y", "x", "y"], where=[0.0, 1.0, 2.0, 3.0])
    way = {"state": ["state", "goal"], "next_state": ["next_state", "goal"]}
    for name, read in forms(table, tmp_path).items():
        if not name.startswith("counted"):
            log = read(columns=way | {"episode": None})
            assert log.state_names[0] == (0, "x")
            assert log.state_names[log.next_state[1]] == (2, "y")
            log = read(columns={"action": ("action", "state"), "episode": None})
            assert log.action_names == ((0, 0), (1, 1))
            assert log.state.tolist() == PLAIN["state"].tolist()
    way = {
        "state": ["state", "where"],
        "next_state_0": "action",
        "next_state_1": "where",
    }
    log = ContinuousTransitions.load(
        tmp_path / "log.csv", columns=way | {"action": "next_state", "episode": None}
    )
    assert log.state[:, 1].tolist() == log.next_state[:, 1].tolist()


def test_large_files_and_small_ones_are_renamed_alike(tmp_path):
    n = 150_000
    table = pd.DataFrame(
        {
            "pose": np.char.add("place ", (np.arange(n) % 7).astype(str)),
            "did": "go",
            "then": np.char.add("place ", ((np.arange(n) + 1) % 7).astype(str)),
            "paid": np.arange(n) / 8,
        }
    )
    columns = {"state": "pose", "action": "did", "next_state": "then", "reward": "paid"}
    for read in list(forms(table, tmp_path).values())[:3]:
        log = read(columns=columns)
        assert len(log) == n
        assert len(log.state_names) == 7
        assert log.reward[-1] == (n - 1) / 8


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"pose": "state"}, r"the other way round: \{'state': 'pose'\}"),
        ({"rewards": "reward"}, "the other way round"),
        ({"stat": "reward"}, r"got 'stat' \(did you mean state\?\)"),
        ({"state": "poze"}, r"which are .*for state it names 'poze'"),
        ({"reward": "Reward"}, r"'Reward' \(did you mean 'reward'\?\)"),
        ({"reward": "state"}, "must name a column for state as well"),
        (
            {"reward": "truncated", "terminated": "truncated"},
            "'truncated' is named for",
        ),
        ({"reward": ["truncated", "timestep"]}, "must name one column for reward"),
        ({"state": []}, "must name one column for state"),
        ({"next_state": None}, "must name a column for next_state; it is None"),
        ("state=pose", "must be a mapping"),
        ({3: "state"}, "the other way round"),
    ],
)
def test_bad_columns_are_refused_in_every_form(tmp_path, columns, words):
    assert_refused(OURS, tmp_path, f"^columns .*{words}", columns=columns)


def test_what_has_its_own_labels_takes_no_columns(tmp_path):
    grid = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_episodes(grid, oee.uniform_policy(grid), 5, 9, seed=0)
    log.save(tmp_path / "log.npz")
    log.save(tmp_path / "log.csv")
    counts = Transitions.open(tmp_path / "log.csv", output=tmp_path / "counts.npz")
    columns = {"state": "state"}
    for source in (tmp_path / "log.npz", tmp_path / "counts.npz", log, counts):
        with pytest.raises(ArgumentError, match=r"^columns must be left out for"):
            oee.Problem(grid, source, columns=columns)
    with pytest.raises(ArgumentError, match=r"^columns must be left out for"):
        Transitions.load(tmp_path / "log.npz", columns=columns)
    for source in ("log.npz", "counts.npz"):
        with pytest.raises(ArgumentError, match=r"^columns must be left out for"):
            Transitions.open(tmp_path / source, columns=columns)
    whole = oee.Problem(grid, counts, episodes=tmp_path / "log.csv", columns=columns)
    assert whole.episodes.n_episodes == 5


def test_counts_that_are_opened_are_written_and_other_options_checked(tmp_path):
    EXPECTED.save(tmp_path / "log.csv")
    counts = Transitions.open(tmp_path / "log.csv", output=tmp_path / "a.npz")
    Transitions.open(tmp_path / "a.npz", output=tmp_path / "b.npz")
    assert oee.TransitionCounts.load(tmp_path / "b.npz").summary() == counts.summary()
    for option in ({"jobs": 0}, {"bad_rows": "dropp"}, {"kept_moves": 0}):
        with pytest.raises(ArgumentError, match=rf"^{next(iter(option))} must"):
            Transitions.open(tmp_path / "a.npz", **option)


def test_each_of_several_files_must_have_them(tmp_path):
    OURS.rename(columns={"state": "pose"}).to_csv(tmp_path / "a.csv", index=False)
    OURS.to_csv(tmp_path / "b.csv", index=False)
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ArgumentError, match=r"b\.csv', which are .*'pose'"):
            read(tmp_path, columns={"state": "pose"})


def test_a_label_that_differs_by_capitals_from_a_chosen_one(tmp_path):
    table = PLAIN.rename(columns={"state": "Pose"}).assign(pose=1)
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(ArgumentError, match=r"that differ; it has 'Pose' and 'pose'"):
        Transitions.load(tmp_path / "log.csv", columns={"state": "Pose"})


# ---------------------------------------------------------------- vectors


def test_vectors_by_other_labels(tmp_path):
    table = pd.DataFrame(
        {
            "x": [0.0, 0.5],
            "v": [1.0, 2.0],
            "u": [0, 1],
            "x'": [0.5, 1.0],
            "v'": [2.0, 0.0],
            "paid": [1.0, 2.0],
        }
    )
    each = {
        "state_0": "x",
        "state_1": "v",
        "action": "u",
        "next_state_0": "x'",
        "next_state_1": "v'",
        "reward": "paid",
    }
    several = {
        "state": ["x", "v"],
        "action": "u",
        "next_state": ["x'", "v'"],
        "reward": "paid",
    }
    named = {"x": "obs_0", "v": "obs_1", "u": "actions", "x'": "Next Obs 0"}
    named |= {"v'": "next_obs[1]", "paid": "rewards"}
    for ending, write in (("csv", "to_csv"), ("parquet", "to_parquet")):
        file = tmp_path / f"log.{ending}"
        getattr(table, write)(file, index=False)
        logs = [
            ContinuousTransitions.load(file, columns=way) for way in (each, several)
        ]
        getattr(table.rename(columns=named), write)(file, index=False)
        with pytest.warns(DataWarning, match="'obs_0' as state_0"):
            logs.append(ContinuousTransitions.load(file))
        for log in logs:
            assert log.state.tolist() == [[0.0, 1.0], [0.5, 2.0]]
            assert log.next_state.tolist() == [[0.5, 2.0], [1.0, 0.0]]
            assert log.reward.tolist() == [1.0, 2.0]
    twice = {"state": ["obs_0", "obs_1"], "state_0": "actions"}
    with pytest.raises(
        ArgumentError, match="must name state_0 once; it is named twice"
    ):
        ContinuousTransitions.load(file, columns=twice)


# ---------------------------------------------------------------- frames


def test_labels_of_pandas_that_are_no_texts():
    table = OURS.set_axis(range(len(COLUMNS)), axis=1)
    keywords = {label: k for k, label in enumerate(COLUMNS)}
    for log in (
        Transitions.from_frame(table, **keywords),
        Transitions.from_frame(table, columns=keywords),
    ):
        for label, column in EXPECTED.columns().items():
            assert_array_equal(log.columns()[label], column)
    with pytest.raises(ArgumentError, match=r"it is '2' \(did you mean 2\?\)"):
        Transitions.from_frame(table, **keywords | {"next_state": "2"})
    levels = OURS.set_axis(
        pd.MultiIndex.from_tuples([("log", label) for label in OURS]), axis=1
    )
    log = Transitions.from_frame(levels, **{label: ("log", label) for label in OURS})
    assert len(log.columns()) == len(COLUMNS)


def test_a_column_twice_is_refused_only_where_it_is_read():
    twice = pd.concat([OURS, OURS[["reward"]]], axis=1)
    table = pa.Table.from_arrays(
        [pa.array(twice.iloc[:, k]) for k in range(twice.shape[1])],
        names=twice.columns.tolist(),
    )
    for frame in (twice, table):
        with pytest.raises(ArgumentError, match="that differ; it has 'reward' twice"):
            Transitions.from_frame(frame)
        assert Transitions.from_frame(frame, columns={"reward": None}).reward is None


def test_named_levels_of_an_index_are_columns():
    log = Transitions.from_frame(OURS.set_index(["episode", "timestep"]))
    for label, column in EXPECTED.columns().items():
        assert_array_equal(log.columns()[label], column)
    with pytest.warns(DataWarning, match="'traj_id' as episode"):
        log = Transitions.from_frame(
            OURS.rename(columns={"episode": "traj_id"}).set_index("traj_id")
        )
    assert log.n_episodes == 2
    beside = OURS.set_index(pd.Index([9, 9, 9, 9], name="episode"))
    assert Transitions.from_frame(beside).n_episodes == 2
    shuffled = OURS.set_index(pd.Index([3, 1, 2, 0]))
    assert_array_equal(Transitions.from_frame(shuffled).state, EXPECTED.state)


@pytest.mark.parametrize(
    "kind",
    [
        lambda table: table.convert_dtypes(),
        lambda table: table.convert_dtypes(dtype_backend="pyarrow"),
        lambda table: table.astype({"state": "category", "next_state": "category"}),
        lambda table: table.astype({"state": "string", "action": "string"}),
        lambda table: table.astype(object),
        pa.table,
        lambda table: pa.table(table).set_column(
            0, "state", pa.array(table["state"]).dictionary_encode()
        ),
    ],
)
def test_types_of_columns(kind):
    log = Transitions.from_frame(kind(OURS))
    for label, column in EXPECTED.columns().items():
        assert_array_equal(log.columns()[label], column)


def test_names_of_polars_of_one_width_and_of_several():
    polars = pytest.importorskip("polars")
    for names in (["a", "b"], ["dock", "a hall"], ["ü", "日本"]):
        for kind in (polars.String, polars.Categorical, polars.Enum(names)):
            table = polars.DataFrame(
                {"state": names, "action": ["x", "x"], "next_state": names[::-1]}
            ).with_columns(polars.col("state", "next_state").cast(kind))
            log = Transitions.from_frame(table)
            assert log.state_names == tuple(names)
            assert log.next_state.tolist() == [1, 0]


# ---------------------------------------------------------------- the command


def test_the_command_reads_an_export_of_another_program(run, tmp_path):
    """Own labels, names that are several columns, and three files."""
    grid = oee.tasks.gridworld(3, slip=0.3)
    named = grid.with_names([(k // 3, k % 3) for k in range(9)], ["n", "e", "s", "w"])
    named.save("sim.npz")
    log = oee.sample_episodes(grid, oee.uniform_policy(grid), 30, 20, seed=0)
    log.save("plain.csv")
    table = pd.DataFrame(
        {
            "row": log.state // 3,
            "column": log.state % 3,
            "did": np.array(["n", "e", "s", "w"])[log.action],
            "row,2": log.next_state // 3,
            "c=2": log.next_state % 3,
            "then": log.next_state,
            "paid": log.reward,
            "done": log.terminated,
            "episode_id": log.episode,
            "pscore": log.behavior_probability,
        }
    )
    (tmp_path / "parts").mkdir()
    for k, some in enumerate(np.array_split(np.unique(log.episode), 3)):
        part = table[np.isin(log.episode, some)]
        part.to_csv(f"parts/part-{k}.csv", index=False)
    rest = "--column action=did --column terminated=done --column episode="
    words = "--column state=row,column --column action=did --column reward=paid"
    words = f"{words} --column terminated=done"
    refused = run("info parts", words, "--column next_state=row,c", code=2)
    assert "row,2, c=2, then, paid" in refused
    assert "for next_state it names 'c'" in refused
    # the label row,2 is one
    said = run("info parts --column state=then --column next_state=row,2", rest)
    assert "columns: action is 'did'; next_state is 'row,2'; state is 'then'" in said
    table.rename(columns={"row,2": "row2"}).to_parquet("log.parquet")
    words = f"{words} --column next_state=row2,c=2"
    told = [
        json.loads(run(command, source, "--json"))
        for source in (
            f"--simulator sim.npz --log log.parquet {words}",
            "--simulator sim_numbers.npz --log plain.csv",
        )
        for command in ("evaluate --policy uniform --quick",)
        if grid.save("sim_numbers.npz") is None
    ]
    assert told[0]["results"] == told[1]["results"]
    run("counts log.parquet --simulator sim.npz --output counts.npz", words)
    said = run("plan --simulator sim.npz --transitions 9 --log log.parquet", words)
    assert "solver" in said
    policies = "--policy uniform --policy optimal --quick"
    run("compare --simulator sim.npz --log log.parquet", words, policies)


def test_the_command_says_what_is_no_column(run):
    OURS.to_csv("log.csv", index=False)
    for words, text in (
        ("--column state", "--column must be COLUMN=LABEL"),
        ("--column =x", "--column must be COLUMN=LABEL"),
        ("--column state=a --column state=b", "--column must name state once"),
        ("--column state=rewrd", "--column must name columns of 'log.csv'"),
        ("--column stat=reward", "--column must have keys of state"),
        ("--column pose=state", "the other way round: {'state': 'pose'}"),
    ):
        assert text in run("info log.csv", words, code=2)
    assert "--column needs --simulator" in run("evaluate --column state=a", code=2)


def test_a_log_is_read_without_pandas_frames(tmp_path):
    """The note is one line of the command, and nothing else is."""
    OURS.rename(columns={"next_state": "next_obs"}).to_csv(
        tmp_path / "log.csv", index=False
    )
    done = subprocess.run(
        [sys.executable, "-m", "oee_tabular", "info", "log.csv"],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    assert done.stderr.count("\n") == 1
    assert "columns: next_state is 'next_obs'" in done.stdout


def test_decimals_are_numbers():
    table = OURS.assign(reward=[Decimal("0.5"), Decimal(1), Decimal("0.5"), Decimal(1)])
    assert_array_equal(Transitions.from_frame(table).reward, EXPECTED.reward)


@pytest.mark.parametrize("blank", ["", " ", "\t"])
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("read", [oee.Transitions.load, oee.Transitions.open])
def test_a_column_without_a_name_is_named_in_words(tmp_path, blank, place, read):
    labels = ["trip", "leg"]
    labels.insert(place, blank)
    path = tmp_path / "log.csv"
    path.write_text(",".join(labels) + "\n0,1,2\n")
    with pytest.raises(ValueError, match=r"it has .*a column without a name") as told:
        read(path)
    assert ", ," not in str(told.value)
    assert "has ," not in str(told.value)
    frame = pd.DataFrame([(0, 1, 2)], columns=labels)
    with pytest.raises(ValueError, match="a column without a name"):
        oee.Transitions.from_frame(frame)
