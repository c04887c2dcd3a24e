"""Logs as files: every format gives back every bit, and what is no log is refused in a
sentence.
"""

import gzip
import itertools
import os
import subprocess
import sys
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers import random_mdp, random_policy
from kernels.files import save_npz
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions

FORMATS = ["log.npz", "log.csv", "log.parquet", "folder"]


def logs():
    rng = np.random.default_rng(0)
    mdp = random_mdp(rng, n_states=5, n_actions=3)
    episodes = oee.sample_episodes(mdp, random_policy(rng, mdp), 6, 9, seed=2)
    bare = Transitions([0, 4], [1, 0], [3, 3])
    return {"episodes": episodes, "bag": episodes.draw(20, seed=0), "bare": bare}


def assert_same(one, other):
    assert one.columns().keys() == other.columns().keys()
    for name, column in other.columns().items():
        assert_array_equal(one.columns()[name], column, err_msg=name)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("kind", ["episodes", "bag", "bare"])
def test_every_format_gives_back_every_bit(tmp_path, monkeypatch, name, kind):
    monkeypatch.chdir(tmp_path)
    log = logs()[kind]
    if name == "folder":
        pytest.importorskip("minari")
    if name == "folder" and kind != "episodes":
        with pytest.raises(
            ValueError, match="log must have episodes to be a Minari data set"
        ):
            log.save(name)
        assert list(tmp_path.iterdir()) == []
        return
    log.save(name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert_same(Transitions.load(tmp_path / name), log)
    assert_same(Transitions.load(name), log)


def test_minari_by_id(tmp_path, monkeypatch):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    log = logs()["episodes"]
    log.save("minari:grid/uniform-v0")
    assert_same(Transitions.load("grid/uniform-v0"), log)
    assert os.environ["MINARI_DATASETS_PATH"] == str(tmp_path)
    with pytest.raises(ValueError, match="must be a new folder"):
        log.save("minari:grid/uniform-v0")
    with pytest.raises(
        FileNotFoundError,
        match="neither a file nor a Minari folder or id on this machine",
    ):
        Transitions.load("grid/other-v0")


def test_a_minari_data_set_made_by_minari_itself(tmp_path, monkeypatch):
    """By Minari's own buffers, infos and all, not by our writer."""
    minari = pytest.importorskip("minari")
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    log = replace(logs()["episodes"], behavior_probability=None)
    buffers = []
    for low, high in itertools.pairwise(log.episode_starts):
        parts = [
            getattr(log, name)[low:high].tolist()
            for name in ("action", "reward", "terminated", "truncated")
        ]
        states = [*log.state[low:high].tolist(), int(log.next_state[high - 1])]
        buffers.append(
            EpisodeBuffer(
                len(buffers),
                None,
                None,
                states,
                *parts,
                {"seen": np.ones((len(states), 1))},
            )
        )
    spaces_of = {
        "observation_space": spaces.Discrete(5),
        "action_space": spaces.Discrete(3),
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        minari.create_dataset_from_buffers(
            "lake/random-v0", buffers, data_format="arrow", **spaces_of
        )
    assert_same(Transitions.load("lake/random-v0"), log)


HEAD = "state,action,next_state,reward,terminated\n"


@pytest.mark.parametrize(
    ("text", "rewards"),
    [
        (HEAD + "0,1,2,0.1,False\n\n2,0,3,1e-3,True\n", [0.1, 1e-3]),
        (
            "\ufeff\r\n"
            + HEAD.replace("\n", "\r\n")
            + "0,1,2,-.5,0\r\n+2,0,03,7.000000000000001,1\r\n",
            [-0.5, 7.000000000000001],
        ),
        (HEAD.replace("action", '"action"') + ' 0,1 ,2,"3",1.0\n', [3.0]),
        (HEAD + "0,1,2.0,1,false\n", [1.0]),
        (
            HEAD + "0,1,2,,False\n0,1,2,nan,False\n0,1,2,5,False\n",
            [np.nan, np.nan, 5.0],
        ),
    ],
)
def test_numbers_of_a_csv(tmp_path, text, rewards):
    (tmp_path / "log.csv").write_bytes(text.encode())
    assert_array_equal(Transitions.load(tmp_path / "log.csv").reward, rewards)
    assert_array_equal(
        Transitions.open(tmp_path / "log.csv").reward_sum.sum(), np.nansum(rewards)
    )


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("0,1,2,0.5,Falsely", r"terminated\[1\] must be a boolean .*; it is 'Falsely'"),
        ("0x1,1,2,1,False", r"state\[1\] must be an integer; it is '0x1'"),
        ("0,1,1_0,1,False", r"next_state\[1\] must be an integer; it is 1_0"),
        ("0,1,2,1_0,False", r"reward\[1\] must be a number; it is 1_0"),
        ("0,1,9223372036854775808,1,False", r"next_state\[1\] must be"),
        (
            '0,1,2,"0,5",False',
            (
                r"reward\[1\] must be a number; it is '0,5' \(write a decimal point, not"
                r" a comma\)"
            ),
        ),
        (
            "0,1,2,1,False,5",
            r"row 1 \(line 3\) must have 5 fields, as the header has; it has 6",
        ),
        ("0,1,2", r"row 1 \(line 3\) must have 5 fields, as the header has; it has 3"),
        ('0,1,2,"5,False', r"row 1 \(line 3\) must"),
    ],
)
def test_lines_that_are_none_of_a_log(tmp_path, line, text):
    """One reader: the same rule for logs that are loaded and for those that are
    counted.
    """
    (tmp_path / "log.csv").write_text(HEAD + "0,1,2,0.5,False\n" + line + "\n")
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ValueError, match=rf"log\.csv': {text}"):
            read(tmp_path / "log.csv")
    assert len(Transitions.open(tmp_path / "log.csv", bad_rows="drop")) == 1


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"log\.csv' must have a header; the file is empty"),
        ("state,action\n0,1\n", r"log\.csv' must have the columns"),
        (
            "state,action,next_state,state\n0,1,2,3\n",
            "must have columns that differ; it has 'state' twice",
        ),
        (
            "state,action,next_state,STATE\n0,1,2,3\n",
            "must have columns that differ; it has 'state' and 'STATE'",
        ),
        ("\x1b[31mX,action,next_state\n0,1,2\n", r"it has \\x1b\[31mX, action"),
        ("state,action,next_state\n", r"at least one (good )?row"),
    ],
)
def test_tables_that_are_none_of_a_log(tmp_path, read, text, words):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        read(tmp_path / "log.csv")


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
def test_encodings_and_compression(tmp_path, read):
    text = HEAD + "0,1,2,0.5,False\n"
    (tmp_path / "a.csv").write_bytes(text.encode("utf-16"))
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(text.encode()))
    assert len(read([tmp_path / "a.csv", tmp_path / "b.csv.gz"])) == 2
    for data in (
        b"\xfe\xff" + text.encode("utf-16-be"),
        HEAD.encode() + b"0,1,2,\xff,False\n",
        b"\xff" + text.encode(),
    ):
        (tmp_path / "c.csv").write_bytes(data)
        with pytest.raises(ValueError, match=r"c\.csv'.*UTF-(8|16)"):
            read(tmp_path / "c.csv")
    (tmp_path / "d.csv.gz").write_bytes(gzip.compress(text.encode())[:-9])
    with pytest.raises(ValueError, match=r"d\.csv\.gz'"):
        read(tmp_path / "d.csv.gz")


HOSTILE = [
    "it's.csv",
    "a[1]*?.parquet",
    'q".parquet',
    "$path; DROP.csv",
    "s3:/x.csv",
    "état\n.parquet",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_files_and_columns_are_never_sql(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    log = logs()["episodes"]
    frame = pd.DataFrame(log.columns()).assign(
        **{"a\"; DROP TABLE x; --'": 1, "state'": 2}
    )
    path = tmp_path / name
    (frame.to_csv if name.endswith("csv") else frame.to_parquet)(path, index=False)
    (tmp_path / "a11.parquet").write_bytes(b"a pattern would match this")
    with pytest.warns(UserWarning, match="left out"):
        assert_array_equal(Transitions.load(path).state, log.state)
    with pytest.warns(UserWarning, match="left out"):
        assert len(Transitions.open(path)) == len(log)


def test_duckdb_reads_one_file_and_loads_nothing(tmp_path):
    from oee_tabular.data.tables import open_duckdb

    logs()["episodes"].save(tmp_path / "log.parquet")
    (tmp_path / "other.csv").write_text("a\n1\n")
    for query in (f"SELECT * FROM read_csv('{tmp_path}/other.csv')", "LOAD httpfs"):
        with (
            pytest.raises(ValueError, match=r"Permission|extension"),
            open_duckdb(str(tmp_path / "log.parquet")) as run,
        ):
            run(query)


WITHOUT = """
import sys
sys.modules["duckdb"] = None
import pandas as pd
import oee_tabular as oee
log = oee.Transitions([0, 1], [0, 0], [1, 0])
log.save(sys.argv[1])
assert len(oee.Transitions.load(sys.argv[1])) == len(oee.Transitions.from_frame(pd.DataFrame(log.columns()))) == 2
oee.TransitionCounts([0], [0], [1], [2]).save(sys.argv[1])
assert len(oee.Transitions.open(sys.argv[1])) == 2
"""


def test_arrays_frames_and_npz_need_no_duckdb(tmp_path):
    subprocess.run(
        [sys.executable, "-c", WITHOUT, str(tmp_path / "log.npz")], check=True
    )


def test_a_file_of_ours_that_another_program_wrote_anew_names_the_way_out(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    logs()["episodes"].save(tmp_path / "log.parquet")
    table = parquet.read_table(tmp_path / "log.parquet")
    parquet.write_table(table.slice(0, 3), tmp_path / "log.parquet")
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(
            ValueError, match=r"log\.parquet' must be as it was saved: .*from_frame"
        ):
            read(tmp_path / "log.parquet")
    Transitions.from_frame(table).save(tmp_path / "log.parquet")
    assert len(Transitions.load(tmp_path / "log.parquet")) == len(table)


def test_unknown_members_of_an_npz_are_refused(tmp_path):
    save_npz(
        tmp_path / "log.npz",
        "transitions",
        logs()["bare"].columns() | {"rewards": np.zeros(2)},
    )
    with pytest.raises(
        ValueError,
        match=r"log\.npz' must hold the columns of a log alone; it has 'rewards'",
    ):
        Transitions.load(tmp_path / "log.npz")


# ---- several files


# the same log in three formats
@pytest.mark.filterwarnings("ignore:.*rows stand in")
def test_several_files_a_pattern_and_a_folder_are_one_log(tmp_path):
    log = logs()["episodes"]
    for k, ending in enumerate(("csv", "parquet", "npz")):
        log.save(tmp_path / f"part-{k}.{ending}")
    (tmp_path / "_SUCCESS").write_text("")
    whole = Transitions.concatenate([log] * 3)
    parts = sorted(tmp_path.glob("part*"))
    mdp = oee.FiniteMDP(np.full((5, 3, 5), 0.2), np.zeros(5), 0, 0.9)
    for path in (tmp_path, str(tmp_path / "part-*"), parts):
        assert_same(Transitions.load(path), whole)
        assert_same(oee.Problem(mdp, path).log, whole)


def test_missing_rewards_are_missing(tmp_path):
    """A mean is over the transitions that have a reward, however the log was put
    together.
    """
    (tmp_path / "a.csv").write_text(
        "state,action,next_state,reward\n0,0,1,4\n0,0,1,\n1,0,1,\n"
    )
    (tmp_path / "b.csv").write_text("state,action,next_state\n0,0,1\n")
    (tmp_path / "c.csv").write_text("state,action,next_state,reward\n0,0,1,2\n")
    log = Transitions.load(tmp_path)
    counts = Transitions.open(tmp_path)
    assert_array_equal(log.reward, [4, np.nan, np.nan, np.nan, 2])
    assert_array_equal(counts.reward_count, [2, 0])
    assert_array_equal(counts.reward_sum, [6, 0])
    assert Transitions.load(tmp_path / "b.csv").reward is None
    assert log.select([1, 2]).reward is None
    for ending in ("npz", "csv", "parquet"):
        log.save(tmp_path / f"d.{ending}")
        assert_array_equal(
            Transitions.load(tmp_path / f"d.{ending}").reward, log.reward
        )
    assert_array_equal(
        Transitions.from_frame(pd.DataFrame(log.columns())).reward, log.reward
    )
    counts.save(tmp_path / "counts.npz")
    again = oee.TransitionCounts.load(tmp_path / "counts.npz")
    mdp = oee.FiniteMDP(
        np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [[[0.0, 1.0]], [[0.0, -1.0]]], 0, 0.9
    )
    for data in (log, counts, again):
        problem = oee.Problem(mdp, data, rewards="log")
        assert_allclose(problem.model.transition_rewards.toarray(), [[0, 3], [0, -1]])
        assert problem.reward_conflict.rows == 2
    assert_array_equal(oee.Problem(mdp, log).rewards_of(log), [4, 1, -1, 1, 2])


def test_arrays_of_objects_are_not_saved(tmp_path):
    """They would be pickles, which ``load`` refuses; an old file of that name stays."""
    path = tmp_path / "old.npz"
    path.write_bytes(b"old")
    with pytest.raises(
        ValueError, match="names must be numbers or text; it is an array of objects"
    ):
        save_npz(path, "thing", {"fine": np.zeros(2), "names": np.array(["a", None])})
    assert path.read_bytes() == b"old"
