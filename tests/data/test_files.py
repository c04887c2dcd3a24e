import os

import numpy as np
import pandas as pd
import pytest
from helpers import random_mdp, random_policy
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions, _files
from oee_tabular._files import save_npz
from oee_tabular.data import files, tables

FORMATS = ["log.npz", "log.csv", "log.parquet", "folder"]


def logs():
    rng = np.random.default_rng(0)
    mdp = random_mdp(rng, n_states=5, n_actions=3)
    episodes = oee.sample_episodes(mdp, random_policy(rng, mdp), 6, 9, seed=2)
    bare = Transitions([0, 4], [1, 0], [3, 3])
    return {"episodes": episodes, "bag": episodes.draw(20, seed=0), "bare": bare}


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("kind", ["episodes", "bag", "bare"])
def test_every_format_gives_back_every_bit(tmp_path, name, kind):
    log = logs()[kind]
    if name == "folder":
        pytest.importorskip("minari")
    if name == "folder" and kind != "episodes":
        with pytest.raises(ValueError, match="log must have episodes to be a Minari data set"):
            log.save(tmp_path / name)
        assert list(tmp_path.iterdir()) == []
        return
    log.save(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    loaded = Transitions.load(tmp_path / name)
    assert loaded.columns().keys() == log.columns().keys()
    for column, values in log.columns().items():
        assert_array_equal(getattr(loaded, column), values, err_msg=column)


def test_a_minari_folder_of_a_relative_name(tmp_path, monkeypatch):
    pytest.importorskip("minari")
    monkeypatch.chdir(tmp_path)
    log = logs()["episodes"]
    log.save("recorded")
    assert [path.name for path in tmp_path.iterdir()] == ["recorded"]
    assert_array_equal(Transitions.load("recorded").state, log.state)


def test_minari_by_id(tmp_path, monkeypatch):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    log = logs()["episodes"]
    log.save("minari:grid/uniform-v0")
    assert_array_equal(Transitions.load("grid/uniform-v0").state, log.state)
    assert os.environ["MINARI_DATASETS_PATH"] == str(tmp_path)
    with pytest.raises(ValueError, match="must be a new folder"):
        log.save("minari:grid/uniform-v0")
    with pytest.raises(FileNotFoundError, match="neither a file, nor a Minari folder, nor a Minari id"):
        Transitions.load("grid/other-v0")


def test_a_minari_data_set_made_by_minari_itself(tmp_path, monkeypatch):
    """Collected by Minari's own buffers from a Gymnasium environment, infos and all, not by our writer."""
    import gymnasium

    minari = pytest.importorskip("minari")
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = gymnasium.make("FrozenLake-v1")
    buffers = []
    for k in range(3):
        state, _ = env.reset(seed=k)
        env.action_space.seed(k)
        buffer = EpisodeBuffer(
            id=k, observations=[state], actions=[], rewards=[], terminations=[], truncations=[], infos={}
        )
        over = False
        while not over:
            action = env.action_space.sample()
            state, reward, terminated, truncated, _ = env.step(action)
            buffer.observations.append(state)
            buffer.actions.append(action)
            buffer.rewards.append(reward)
            buffer.terminations.append(terminated)
            buffer.truncations.append(truncated)
            over = terminated or truncated
        buffers.append(buffer)
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        minari.create_dataset_from_buffers("lake/random-v0", buffers, env=env.spec, data_format="arrow")
    log = Transitions.load("lake/random-v0")
    assert log.n_episodes == 3
    assert_array_equal(log.state, np.concatenate([b.observations[:-1] for b in buffers]))
    assert_array_equal(log.terminated, np.concatenate([b.terminations for b in buffers]))


def test_a_csv_written_by_hand(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "state,action,next_state,reward,terminated,episode\n0,1,2,0.5,False,0\n2,0,3,1,True,0\n1,1,1,0,0,1\n"
    )
    log = Transitions.load(path)
    assert_array_equal(log.reward, [0.5, 1, 0])
    assert_array_equal(log.terminated, [False, True, False])
    assert_array_equal(log.truncated, [False, False, True])


HEAD = "state,action,next_state,reward,terminated\n"


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        (HEAD + "0,1,2,0.1,False\n\n2,0,3,1e-3,True\n", True),
        ("\ufeff\r\n" + HEAD + "0,1,2,-.5,0\r\n+2,0,03,7.000000000000001,1\r\n", True),
        ('"state","action","next_state"\n 0,1 ,2\n', True),
        (HEAD, False),
        (HEAD + "0,1,2,0.5,yes\n", False),
        (HEAD + "0,1,2,0.5,Falsely\n", False),
        (HEAD + "0,1,2,0.5,True\n0,1,2,0.5,1\n", False),
        (HEAD + "0,1,2,nan,False\n", False),
        (HEAD + "0,1,2,inf,False\n", False),
        (HEAD + "0,1,2,,False\n", False),
        (HEAD + "0,1,2.0,1,False\n", False),
        (HEAD + "0,1,2.5,1,False\n", False),
        (HEAD + "0,1,1_0,1,False\n", False),
        (HEAD + "0,1,9223372036854775808,1,False\n", False),
        (HEAD + "-1,1,2,1,False\n", True),
        (HEAD + "0,1,2,1,False,5\n", False),
        (HEAD + "0,1,2\n", False),
        (HEAD + "a,1,b,1,False\n", False),
        (HEAD + "# 0,1,2,1,False\n", False),
        (HEAD + '0,"1",2,1,False\n', False),
        ("state,action,next_state,state\n0,1,2,3\n", False),
        ("state,action,next_state,battery\n0,1,2,3\n", False),
        ("state,action\n0,1\n", True),
        ("", False),
    ],
)
@pytest.mark.filterwarnings("ignore:columns of")
def test_numpy_and_pandas_read_the_same_csv(tmp_path, monkeypatch, text, plain):
    """The same columns, to the last bit, or the same error; what is not plain is pandas' alone."""
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode())
    assert (tables.plain_csv(str(path), files.TYPES) is not None) == plain
    found = []
    for read in (tables.plain_csv, lambda *_: None):
        monkeypatch.setattr(files, "plain_csv", read)
        try:
            found.append(Transitions.load(path).columns())
        except ValueError as error:
            found.append(str(error))
    assert type(found[0]) is type(found[1])
    if isinstance(found[0], str):
        assert found[0] == found[1]
    else:
        assert list(found[0]) == list(found[1])
        for name, column in found[0].items():
            assert column.dtype == found[1][name].dtype
            assert_array_equal(column, found[1][name])


def test_a_long_csv_is_pandas_own(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_text(HEAD + "0,1,2,0.1,False\n" * 20)
    monkeypatch.setattr(tables, "PLAIN", 100)
    assert tables.plain_csv(str(path), files.TYPES) is None
    assert len(Transitions.load(path)) == 20


def test_columns_that_a_log_does_not_know_are_named(tmp_path):
    pd.DataFrame({"state": [0], "action": [0], "next_state": [1], "battery": [0.7]}).to_csv(
        tmp_path / "l.csv", index=False
    )
    with pytest.warns(UserWarning, match="left out: battery"):
        Transitions.load(tmp_path / "l.csv")


@pytest.mark.parametrize("name", ["log.npz", "log.csv", "log.parquet"])
def test_a_write_that_fails_leaves_what_was_there(tmp_path, monkeypatch, name):
    """The disk fills up at the last moment: the old file stands, no temporary file is left."""
    log = logs()["episodes"]
    log.first(3).save(tmp_path / name)
    before = (tmp_path / name).read_bytes()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_files.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        log.save(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() == before


def test_npz_files_never_are_pickles(tmp_path):
    path = tmp_path / "evil.npz"
    np.savez(path, state=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="must be an npz or npy file of plain arrays"):
        Transitions.load(path)


def test_arrays_of_objects_are_not_saved(tmp_path):
    """They would be pickles, which ``load`` refuses; an old file of that name stays."""
    path = tmp_path / "old.npz"
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match="names must be numbers or text; it is an array of objects"):
        save_npz(path, "thing", {"fine": np.zeros(2), "names": np.array(["a", None])})
    assert path.read_bytes() == b"old"
