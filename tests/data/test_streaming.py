"""Logs of any size as counts: the same bits whatever the file's form, the order of
processes, and the rows left out.
"""

import itertools
import os
import re
import signal
import subprocess
import sys
import tempfile

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import TransitionCounts, Transitions
from oee_tabular.data import sums, tables

GRID = oee.tasks.gridworld(3, slip=0.3)
UNIFORM = oee.uniform_policy(GRID)


def logs(number=4, episodes=12):
    return [
        oee.sample_episodes(GRID, UNIFORM, episodes, 9, seed=k) for k in range(number)
    ]


def written(folder, ending=".parquet", number=4, episodes=12):
    folder.mkdir(exist_ok=True)
    for k, log in enumerate(logs(number, episodes)):
        log.save(folder / f"part-{k}{ending}")
    return folder


def same(one, other):
    assert_columns(one, other)
    assert one.recording == other.recording
    assert (one.sample is None) == (other.sample is None)
    if one.sample is not None:
        assert_columns(one.sample, other.sample)


def assert_columns(one, other):
    assert one.columns().keys() == other.columns().keys()
    for name, column in one.columns().items():
        assert_array_equal(column, getattr(other, name), err_msg=name)


# ---- what is counted


@pytest.mark.parametrize("ending", [".parquet", ".csv", ".npz"])
def test_a_folder_is_the_log_of_its_files(tmp_path, ending):
    found = Transitions.open(written(tmp_path / "a", ending))
    whole = Transitions.concatenate(logs())
    assert_array_equal(found.counts(9, 4).toarray(), whole.counts(9, 4).toarray())
    assert_columns(found.sample, whole)
    facts = found.summary()
    plain = whole.summary()
    assert facts["files"] == 4
    for name in facts.keys() & plain.keys():
        assert facts[name] == plain[name], name
    assert_allclose(found.reward_sum.sum(), whole.reward.sum(), rtol=1e-12)


def test_files_patterns_and_lists_name_the_same(tmp_path):
    folder = written(tmp_path / "a")
    one = Transitions.open(folder)
    for name in ("_SUCCESS", ".hidden.csv", "notes.txt"):
        (folder / name).write_text("x")
    parts = [folder / f"part-{k}.parquet" for k in range(4)]
    for path in (folder, str(folder / "*.parquet"), parts, f"{tmp_path}/**/*.parquet"):
        same(one, Transitions.open(path))


def test_a_minari_data_set_is_counted(tmp_path):
    pytest.importorskip("minari")
    log = logs(1)[0]
    log.save(tmp_path / "recorded")
    assert_columns(Transitions.open(tmp_path / "recorded").sample, log)


def test_problems_take_it_in_place_of_the_log(tmp_path):
    whole = Transitions.concatenate(logs())
    ours, plain = (
        oee.Problem(GRID, log, 9)
        for log in (Transitions.open(written(tmp_path / "a")), whole)
    )
    policy = oee.tasks.gridworld_policy(3, 0.5)
    tables = [oee.evaluate(problem, policy, seed=0) for problem in (ours, plain)]
    assert "pdis" in [r.estimator for r in tables[0].results]
    for found, expected in zip(tables[0].results, tables[1].results, strict=True):
        assert found.estimator == expected.estimator
        np.testing.assert_equal(found.estimate.value, expected.estimate.value)
        assert found.estimate.interval == expected.estimate.interval
    assert tables[0].warnings == tables[1].warnings


@pytest.mark.parametrize("ending", [".parquet", ".csv", ".npz"])
def test_the_sample_is_the_first_episodes_of_a_draw(tmp_path, ending):
    """Whole episodes in the order of the files, as many as fit: a larger sample holds
    each smaller one.
    """
    folder = written(tmp_path / "a", ending, number=2, episodes=30)
    whole = Transitions.concatenate(logs(2, 30))
    before = set()
    episodes = [whole.select(whole.episode == e) for e in range(60)]
    for size in (5, 9, 40, 100, 200, 540):
        sample = Transitions.open(folder, kept_moves=size).sample
        chosen = []
        for e in range(0 if sample is None else sample.n_episodes):
            part = sample.select(sample.episode == e)
            after = chosen[-1] + 1 if chosen else 0
            chosen.append(
                next(
                    k
                    for k in range(after, 60)
                    if episodes[k].next_state.tolist() == part.next_state.tolist()
                )
            )
        assert min(size, len(whole)) - 9 < sum(len(episodes[k]) for k in chosen) <= size
        assert before <= set(chosen)
        before = set(chosen)
    assert len(before) == 60


def test_every_episode_is_drawn_as_often_as_another(tmp_path):
    """The draw is by the file's name: three of ten episodes, under 100 names."""
    state = np.repeat(np.arange(10), 2)
    log = Transitions(state, 0 * state, state, episode=state)
    drawn = np.zeros(10)
    for k in range(100):
        log.save(tmp_path / f"{k}.csv")
        drawn[
            Transitions.open(tmp_path / f"{k}.csv", kept_moves=6).sample.state[::2]
        ] += 1
    assert drawn.sum() == 300
    # chi-square of 9 degrees of freedom: P < .003
    assert np.sum((drawn - 30) ** 2 / 21) < 25


def test_folders_name_columns_as_hive_does(tmp_path):
    for action in range(2):
        (tmp_path / f"action={action}" / "day=1").mkdir(parents=True)
        frame = pd.DataFrame({"state": [0, 1], "next_state": [1, action]})
        frame.to_parquet(
            tmp_path / f"action={action}" / "day=1" / "x.parquet", index=False
        )
    found = Transitions.open(tmp_path)
    assert_array_equal(found.columns()["action"], [0, 1, 0, 1])
    assert_array_equal(found.next_state, [1, 1, 0, 1])
    assert not found.by_episodes
    assert found.sample is None


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_what_is_summed_and_what_is_left_out(tmp_path, ending):
    """By columns that a log does not know, a warning; by rows that break a rule, the
    first and the number of the others.
    """
    columns = {
        "state": [0, 0, 0, -1, 9, -2],
        "action": 0,
        "next_state": 1,
        "terminated": [0, 0, 1, 0, 0, 0],
    }
    frame = pd.DataFrame(
        columns | {"reward": [1.0, -2.0, 5.0, 0, 0, 0], "battery": 0.7}
    )
    path = tmp_path / f"l{ending}"
    (frame.to_csv if ending == ".csv" else frame.to_parquet)(path, index=False)
    for read in (Transitions.open, Transitions.load):
        with pytest.raises(
            ValueError, match=r"state\[3\] must be at least 0; it is -1"
        ):
            read(path)
    with pytest.warns(UserWarning, match="left out: battery"):
        found = Transitions.open(path, n_states=9, bad_rows="drop")
    (reason,) = found.recording.reasons
    assert reason.endswith(
        "state[3] must be at least 0; it is -1; 2 other rows break the same rule"
    )
    assert found.recording.dropped == 3
    sums = {
        "count": [2, 1],
        "terminated": [0, 1],
        "reward_sum": [-1, 5],
        "reward_min": [-2, 5],
        "reward_max": [1, 5],
    }
    for name, expected in sums.items():
        assert_array_equal(getattr(found, name), expected)


@pytest.mark.parametrize(
    ("name", "values", "rule"),  # of each, the least and the largest are right
    [
        (
            "behavior_probability",
            ["0.1", "0.1x", "0.9"],
            r"must be a number; it is '0\.1x'",
        ),
        ("truncated", [0.0, 0.5, 1.0], r"must be a boolean .*; it is 0\.5"),
        ("timestep", [0.0, 0.5, 1.0], r"must be an integer; it is 0\.5"),
    ],
)
def test_a_value_between_others_in_parquet_without_episodes(
    tmp_path, name, values, rule
):
    pd.DataFrame({"state": 0, "action": 0, "next_state": 0, name: values}).to_parquet(
        tmp_path / "a.parquet"
    )
    with pytest.raises(ValueError, match=rf"{name}\[1\] {rule}"):
        Transitions.open(tmp_path)


def test_a_parquet_file_without_episodes_is_counted_as_csv_is(tmp_path):
    frame = frame_of().drop(columns=["episode", "timestep"])
    frame.to_parquet(tmp_path / "a.parquet")
    frame.to_csv(tmp_path / "a.csv", index=False)
    one, other = (Transitions.open(tmp_path / name) for name in ("a.parquet", "a.csv"))
    same(one, other)
    assert one.recording.truncated == 2


def test_numbers_whose_product_64_bits_do_not_hold(tmp_path):
    large = 2**52
    rows = [
        (large, large, large - 1, 1.0),
        (0, 1, 5, 2.0),
        (large, large, large - 1, 4.0),
        (large, large, 5, 8.0),
    ]
    pd.DataFrame(rows, columns=["state", "action", "next_state", "reward"]).to_csv(
        tmp_path / "a.csv", index=False
    )
    counts = Transitions.open(tmp_path)
    assert_array_equal(counts.state, [0, large, large])
    assert_array_equal(counts.next_state, [5, 5, large - 1])
    assert_array_equal(counts.reward_sum, [2, 8, 5])


# ---- rows that are none of a log


def frame_of(**changes):
    columns = {
        "state": [0, 1, 2, 0, 1, 0, 1],
        "action": [0, 1, 0, 1, 0, 0, 0],
        "next_state": [1, 2, 3, 1, 2, 1, 2],
        "reward": [0.0, 0.5, 1.0, -1.0, 0.0, 0.0, 0.0],
        "terminated": [0, 0, 1, 0, 0, 0, 0],
        "episode": [5, 5, 5, 6, 6, 7, 7],
        "timestep": [0, 1, 2, 0, 1, 0, 1],
        "behavior_probability": [0.5] * 7,
        "truncated": [0, 0, 0, 0, 1, 0, 1],
    }
    frame = pd.DataFrame(columns)
    for name, (row, value) in changes.items():
        frame[name] = frame[name].astype(object)
        frame.loc[row, name] = value
    return frame


BAD = [  # column, value in row 4, rule
    ("state", -3, r"must be at least 0; it is -3"),
    ("next_state", 9, r"must be in 0\.\.8; it is 9"),
    ("action", 4, r"must be in 0\.\.3; it is 4"),
    ("state", 0.5, r"must be an integer; it is 0\.5"),
    ("state", 2**62, r"must be in 0\.\.8; it is 4611686018427387904"),
    ("action", 2**63 + 5, r"must be (in 0\.\.3|an integer); it is 92233720368547758"),
    ("reward", np.inf, r"must be finite; it is inf"),
    ("behavior_probability", 1.5, r"must be in \[0, 1\]; it is 1\.5"),
    ("terminated", 7, r"must be a boolean \(or 0 or 1\); it is 7"),
    ("timestep", -1, r"must be at least 0; it is -1"),
    ("state", None, r"must have a value; it has none"),
    ("episode", None, r"must have a value; it has none"),
    ("episode", 6.5, r"must be an integer; it is 6\.5"),
    (
        "state",
        "x",
        r"must be an integer; it is 'x' \(names take a simulator that has them",
    ),
    ("reward", "much", r"must be a number; it is 'much'"),
    ("truncated", "perhaps", r"must be a boolean"),
]
CASES = [(*case, ending) for case in BAD for ending in (".csv", ".parquet")]


@pytest.mark.parametrize(("name", "value", "rule", "ending"), CASES)
def test_bad_rows_are_named_and_refused_or_counted(tmp_path, name, value, rule, ending):
    frame = frame_of(**{name: (4, value)})
    path = tmp_path / f"bad{ending}"
    if ending == ".csv":
        frame.to_csv(path, index=False)
    else:
        kind = None
        if value is None or isinstance(value, float):
            kind = "Float64"
        elif value == 2**63 + 5:
            kind = "uint64"
        column = (
            frame[name].map(str)
            if isinstance(value, str)
            else pd.array(frame[name].tolist(), dtype=kind)
        )
        frame.assign(**{name: column}).to_parquet(path, index=False)
    frame_of().assign(episode=[1, 1, 1, 2, 2, 3, 3]).to_csv(
        tmp_path / "a.csv", index=False
    )
    with pytest.raises(
        ValueError,
        match=rf"'{re.escape(str(path))}': {name}\[4\] {rule}.*bad_rows='drop'",
    ):
        Transitions.open(path, n_states=9, n_actions=4)
    found = Transitions.open(
        [path, tmp_path / "a.csv"], n_states=9, n_actions=4, bad_rows="drop"
    )
    assert re.search(rule, found.recording.reasons[0])
    n_broken = 1 + (name == "episode")  # without a name it may be the next episode's
    assert (found.recording.dropped, len(found), found.recording.broken) == (
        1,
        13,
        n_broken,
    )
    assert np.diff(found.sample.episode_starts).tolist() == (
        [3, 3, 2, 2] if name == "episode" else [3, 2, 3, 2, 2]
    )
    assert f"1 invalid rows dropped, {n_broken} episodes broken" in found.describe()


# by the line before which they stand, from 0: bad lines; rows dropped, moves, episodes
# broken, lengths of others
LINES = [
    (
        {5: "1,2"},
        r"row 4 \(line 6\) must have 9 fields, as the header has; it has 2",
        [1, 7, 1],
        [3, 2],
    ),
    (
        {5: "1,0,2,0,0,6,1,0.5,1,9"},
        r"row 4 \(line 6\) must have 9 fields, .*; it has 10",
        [1, 7, 1],
        [3, 2],
    ),
    (
        {2: "1,2", 6: "x,0,1,0,0,6,2,0.5,1"},
        r"row 1 \(line 3\) must.*\n.*state\[6\] must",
        [2, 7, 2],
        [2],
    ),
    (
        {2: "1,2\n-4,1,2,0,0,5,1,0.5,0", 8: "7"},
        r"row 1 .*\n.*state\[2\] must be .* -4",
        [3, 7, 2],
        [2],
    ),
]


@pytest.mark.parametrize(("lines", "words", "numbers", "lengths"), LINES)
def test_lines_with_other_fields(tmp_path, lines, words, numbers, lengths):
    """The numbers of rows stay right behind them."""
    text = frame_of().to_csv(index=False).splitlines()
    for place in sorted(lines, reverse=True):
        text.insert(place, lines[place])
    (tmp_path / "a.csv").write_text("\n".join(text) + "\n")
    with pytest.raises(ValueError, match=rf"a\.csv': {words.split('.*')[0]}"):
        Transitions.open(tmp_path)
    found = Transitions.open(tmp_path, bad_rows="drop")
    assert re.search(words, "\n".join(found.recording.reasons))
    assert [found.recording.dropped, len(found), found.recording.broken] == numbers
    assert np.diff(found.sample.episode_starts).tolist() == lengths


@pytest.mark.parametrize("odd", [("0,0", "0,0,1,1"), ("0,0,1,1", "0,0")])
def test_lines_whose_fields_are_as_many_on_the_average(tmp_path, monkeypatch, odd):
    """Of a file above the size that Python reads line by line."""
    monkeypatch.setattr("oee_tabular.data.tables.MAX_SMALL_BYTES", 1000)
    lines = ["state,action,next_state", *["0,0,1"] * 4000]
    lines[10], lines[20] = odd
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(ValueError, match=r"row 9 \(line 11\) must have 3 fields"):
        Transitions.open(tmp_path)
    found = Transitions.open(tmp_path, bad_rows="drop")
    assert (found.recording.dropped, len(found)) == (2, 3998)


@pytest.mark.parametrize(
    ("name", "row", "value", "text"),
    [
        (
            "timestep",
            4,
            3,
            r"timestep\[4\] must be 1 \(steps of an episode in order from 0\); it is 3",
        ),
        (
            "state",
            4,
            0,
            (
                r"next_state\[3\] must be the state of the next row of its episode,"
                r" which is 0; it is 1"
            ),
        ),
        (
            "terminated",
            3,
            1,
            (
                r"terminated\[3\] must be False: its episode continues in the next row;"
                r" it is True"
            ),
        ),
        ("truncated", 3, 1, r"truncated\[3\] must be False"),
    ],
)
def test_rows_that_do_not_go_on_with_their_episode(tmp_path, name, row, value, text):
    """Their moves are moves; the episode is none to be sampled."""
    frame_of(**{name: (row, value)}).infer_objects().to_parquet(
        tmp_path / "a.parquet", index=False
    )
    with pytest.raises(ValueError, match=text):
        Transitions.open(tmp_path)
    found = Transitions.open(tmp_path, bad_rows="drop")
    assert (len(found), found.recording.dropped, found.recording.broken) == (7, 0, 1)
    assert re.search(text, found.recording.reasons[0])
    assert np.diff(found.sample.episode_starts).tolist() == [3, 2]


@given(
    st.permutations([0, 0, 1, 1, 2, 2]),
    st.lists(st.integers(-9, 2**40), min_size=3, max_size=3, unique=True),
)
@settings(max_examples=40)
def test_episodes_stand_together(order, names):
    """Else the first row is named in which one begins again, and of the others alone
    there may be samples.
    """
    runs = [name for name, _ in itertools.groupby(order)]
    columns = {
        "state": [0] * 6,
        "action": 0,
        "next_state": 0,
        "episode": [names[k] for k in order],
    }
    with tempfile.TemporaryDirectory() as folder:
        path = f"{folder}/a.csv"
        pd.DataFrame(columns).to_csv(path, index=False)
        found = Transitions.open(path, bad_rows="drop")
        again = next(
            (k for k in range(6) if order[k] in order[:k] and order[k] != order[k - 1]),
            None,
        )
        if again is not None:
            words = (
                rf"keep the rows .* together; {names[order[again]]} begins again in row"
                rf" {again}"
            )
            with pytest.raises(ValueError, match=words):
                Transitions.open(path)
            assert re.search(words, found.recording.reasons[0])
    assert len(found) == 6
    n_whole = sum(runs.count(k) == 1 for k in range(3))
    assert (0 if found.sample is None else found.sample.n_episodes) == n_whole


# ---- files that are none of a log


def test_files_that_are_none_are_named(tmp_path):
    folder = written(tmp_path / "a")
    plain = frame_of()
    (tmp_path / "empty").mkdir()
    (tmp_path / "x.txt").write_text("")
    for path in (tmp_path / "none.parquet", tmp_path / "none", f"{tmp_path}/*.none"):
        with pytest.raises(FileNotFoundError):
            Transitions.open(path)
    for path, text in (
        (
            tmp_path / "empty",
            r"path must hold files in \.csv, .*; the folder .*empty' has none",
        ),
        (
            [folder, folder / "part-0.parquet"],
            r"path must name each file once; .*part-0.parquet' is named twice",
        ),
        ([], "path must name files"),
        (tmp_path / "x.txt", r"path must end in .*x\.txt"),
        ("s3://bucket/log.parquet", "nothing is fetched"),
    ):
        with pytest.raises(ValueError, match=text):
            Transitions.open(path)
    for frame, text in (
        (
            plain.drop(columns="action"),
            r"part-2\.parquet' must have the columns state, action, next_state; it has",
        ),
        (
            plain.drop(columns="truncated"),
            (
                r"same columns; .*part-0\.parquet' has 'truncated', and"
                r" .*part-2\.parquet' does not"
            ),
        ),
    ):
        frame.to_parquet(folder / "part-2.parquet", index=False)
        with pytest.raises(ValueError, match=text):
            Transitions.open(folder)


# ---- processes, clusters, kills


def test_processes_give_the_same_bytes(tmp_path):
    folder = written(tmp_path / "a")
    serial = Transitions.open(folder, kept_moves=100, output=tmp_path / "serial.npz")
    same(
        serial,
        Transitions.open(folder, kept_moves=100, jobs=2, output=tmp_path / "two.npz"),
    )
    assert (tmp_path / "serial.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()


def test_a_dask_cluster_gives_the_same_bits(tmp_path):
    distributed = pytest.importorskip("distributed")
    folder = written(tmp_path / "a")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=":0",
        silence_logs=50,
    ) as cluster:
        found = Transitions.open(folder, dask=cluster.scheduler_address)
    same(found, Transitions.open(folder))


def test_workers_read_relative_paths_in_the_caller_s_folder(tmp_path, monkeypatch):
    """Workers are used again, after the caller went to another folder."""
    found = []
    for name in ("one", "two"):
        folder = written(tmp_path / name)
        monkeypatch.chdir(folder)
        found.append(Transitions.open("*.parquet", jobs=2))
        for file in folder.iterdir():
            file.unlink()
    same(*found)


def test_a_scheduler_that_does_not_answer(tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(
        OSError, match=r"no dask scheduler answers at 'tcp://127\.0\.0\.1:9'"
    ):
        Transitions.open(written(tmp_path / "a", number=1), dask="tcp://127.0.0.1:9")


def test_an_unreadable_file_is_named_and_nothing_is_written(tmp_path):
    folder = written(tmp_path / "a")
    output = tmp_path / "c.npz"
    data = bytearray((folder / "part-2.parquet").read_bytes())
    data[8:200] = bytes(192)
    (folder / "part-2.parquet").write_bytes(data)
    with pytest.raises(ValueError, match=r"part-2\.parquet' must be"):
        Transitions.open(folder, output=output)
    assert os.listdir(tmp_path) == ["a"]


KILLED = """
import sys, time
from oee_tabular import Transitions, _files
synced = _files.os.fsync
def slow(handle):
    print("here", flush=True)
    time.sleep(3600)
_files.os.fsync = slow
Transitions.open(sys.argv[1], output=sys.argv[2])
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no kill -9 here")
def test_a_count_that_is_killed_leaves_nothing_under_its_name(tmp_path):
    folder = written(tmp_path / "a")
    output = tmp_path / "c.npz"
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder), str(output)],
        stdout=subprocess.PIPE,
        env=dict(os.environ),
    ) as process:
        assert process.stdout.readline() == b"here\n"
        process.kill()
    assert not output.exists()
    same(Transitions.open(folder, output=output), TransitionCounts.load(output))


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
@pytest.mark.parametrize("n_joins", [0, 1])
@pytest.mark.parametrize("words", [(), ("Unable to allocate 2 TiB",)])
def test_missing_memory_has_words(tmp_path, monkeypatch, ending, n_joins, words):
    """Memory that is over at the first piece, or where sums are joined."""
    path = tmp_path / f"log.{ending}"
    Transitions([0, 1, 2], [0, 0, 1], [1, 2, 0]).save(path)
    calls = []

    def sum_rows(columns):
        calls.append(columns)
        if len(calls) > n_joins:
            raise MemoryError(*words)
        return summed(columns)

    summed = sums.sum_rows
    monkeypatch.setattr(sums, "sum_rows", sum_rows)
    with pytest.raises(MemoryError) as told:
        Transitions.open(path)
    text = str(told.value)
    assert text.startswith(
        f"{str(path)!r} needs more memory than there is: it was over"
    )
    assert f"after {3 * n_joins} different transitions, which take about " in text
    assert "GiB are free (count in fewer processes" in text


def test_what_pandas_cannot_allocate_is_no_fault_of_the_file(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    Transitions([0, 1, 2], [0, 0, 1], [1, 2, 0]).save(path)

    def read_csv(*arguments, **options):
        raise pd.errors.ParserError("Error tokenizing data. C error: out of memory")

    monkeypatch.setattr(pd, "read_csv", read_csv)
    monkeypatch.setattr(tables, "MAX_SMALL_BYTES", 1)
    with pytest.raises(MemoryError, match="more rows than memory holds"):
        Transitions.load(path)
    with pytest.raises(MemoryError, match="GiB are free"):
        Transitions.open(path)
