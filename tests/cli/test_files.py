"""The commands of files, and logs of several of them."""

import json
import os

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee

GRID = "gridworld:3,slip=0.3"


def test_sampling_steps_gymnasium(run):
    run(
        "sample FrozenLake-v1:map_name=4x4 --transitions 200 --seed 3 --output lake.npz"
    )
    import gymnasium

    log = oee.record_episodes(
        gymnasium.make("FrozenLake-v1"),
        np.full((16, 4), 0.25),
        n_transitions=200,
        seed=3,
    )
    assert_array_equal(oee.Transitions.load("lake.npz").next_state, log.next_state)


def test_the_horizon_ends_episodes_that_would_not(run):
    """CliffWalking has no limit of its own; going up for ever would never end."""
    np.save("up.npy", np.eye(4)[np.zeros(48, dtype=int)])
    words = (
        "sample CliffWalking-v1 --policy up.npy --episodes 2 --horizon 7 --output l.npz"
    )
    assert "14 transitions in 2 episodes of 7 steps" in run(words)


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz"])
def test_what_is_sampled_has_names_and_is_read_again(run, folder, ending):
    mdp = oee.tasks.gridworld(3, slip=0.2).with_names(
        [(s // 3, s % 3) for s in range(9)], ["n", "e", "s", "w"]
    )
    mdp.save("named.npz")
    run(f"sample named.npz --transitions 300 --output by_name{ending}")
    log = oee.Transitions.load(f"by_name{ending}")
    assert log.action_names is not None
    same = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 60, 1000, seed=0).first(
        300
    )
    assert_allclose(log.numbered(mdp).next_state, same.next_state)
    assert "named states" in run(f"info by_name{ending}")
    run(f"counts by_name{ending} --simulator named.npz --output counts.npz")
    ask = "evaluate --simulator named.npz --estimators oee --json --log"
    values = [
        json.loads(run(ask, file))["results"][0]["value"]
        for file in (f"by_name{ending}", "counts.npz")
    ]
    assert values[0] == values[1]


def test_info(run, tmp_path):
    oee.tasks.gridworld(3, 0.3).save("m.npz")
    said = run("info m.npz")
    assert "FiniteMDP(9 states, 4 actions" in said
    assert "1 state in which an episode is over" in said
    assert json.loads(run("info m.npz --json"))["kind"] == "finite_mdp"
    oee.Transitions([0], [0], [3]).save("l.csv")
    assert "Transitions(1 transitions" in run("info l.csv")
    np.savez("p.npz", policy=np.full((9, 4), 0.25), other=np.ones((9, 4)))
    said = run("info p.npz")
    assert (
        "policy of 9 states and 4 actions ('policy'): float64 of shape (9, 4)" in said
    )
    assert "array ('other')" in said
    run("evaluate --estimators oee --output out")
    for path in ("out", "out/report.json"):
        said = run("info", path)
        assert "Report of (1 - discount)" in said
        assert "] (likelihood)" in said
    (tmp_path / "other.json").write_text("{}")
    assert "must be a report that oee evaluate wrote" in run("info other.json", code=2)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("{}", "it is empty, {}, and lacks unit, facts, results"),
        ('{"success": 9, "runs": 12}', "it has success, runs, and lacks unit, facts"),
        ('{"unit": 1}', "it has unit, and lacks facts, results"),
        ("[1, 0, 1]", "it holds a list, [1, 0, 1]"),
        ("42", "it holds one value, 42"),
        ("null", "it holds one value, None"),
        ("", "it is empty"),
        (" \n", "it is empty"),
        ("not json", "it is no JSON in line 1, column 1, 'not json'"),
        ('{"unit": 1,\n oops}', "it is no JSON in line 2, column 2, ' oops}'"),
        ("[" * 10**5, "its parts are nested too deep"),
        ("\xff", "it is no text in UTF-8"),
        ('{"unit": 1, "facts": 2, "results": 3}', "are not those of a report (write"),
    ],
)
def test_info_says_what_json_that_is_no_report_holds(run, tmp_path, text, found):
    (tmp_path / "x.json").write_bytes(text.encode("latin-1"))
    told = run("info x.json", code=2)
    assert told.startswith("oee: 'x.json' must be a report that oee evaluate wrote, or")
    assert found in told


def test_info_on_trials(run, tmp_path):
    (tmp_path / "t.csv").write_text("policy,success\na,1\nb,0\na,1\n")
    said = run("info t.csv")
    assert "2 of 3 succeeded" in said
    assert "a: Trials(2 of 2 succeeded)" in said
    (tmp_path / "eval_info.json").write_text(
        '{"per_episode": [{"success": true, "sum_reward": 2.5}]}'
    )
    assert "1 of 1 succeeded" in run("info eval_info.json")
    assert json.loads(run("info eval_info.json --json"))["kind"] == "trials"


def test_info_on_frames_of_lists(run, tmp_path):
    pa = pytest.importorskip("pyarrow")
    table = pa.table(
        {
            "observation.state": pa.array([[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]]),
            "action": pa.array([[0.5]] * 3),
            "episode_index": pa.array([0, 0, 0]),
            "frame_index": pa.array([0, 1, 2]),
        }
    )
    (tmp_path / "data").mkdir()
    pytest.importorskip("pyarrow.parquet").write_table(table, "data/frames.parquet")
    for path in ("data", "data/frames.parquet"):
        said = run("info", path)
        assert "ContinuousTransitions(2 transitions of 2-dimensional states" in said
        assert "state is 'observation.state'" in said


def test_info_on_a_model_of_prism(run):
    pytest.importorskip("umbi")
    oee.tasks.gridworld(3, 0.3).with_discount(0.9).save("m.umb")
    assert "FiniteMDP(9 states, 4 actions" in run("info m.umb")


# ---------------------------------------------------------------- logs of several files


@pytest.fixture
def parts(run, tmp_path):
    """A folder of three files, each a log of ten episodes, and one file with all."""
    pytest.importorskip("pyarrow")
    grid = oee.tasks.gridworld(3, slip=0.1)
    logs = []
    (tmp_path / "log").mkdir()
    for k in range(3):
        logs.append(oee.sample_episodes(grid, oee.uniform_policy(grid), 10, 20, seed=k))
        logs[k].save(f"log/part-{k}.parquet")
    oee.Transitions.concatenate(logs).save("joined.npz")
    return tmp_path / "log"


WAYS = {
    "files": [f"log/part-{k}.parquet" for k in range(3)],
    "pattern": ["'log/part-*.parquet'"],
    "folder": ["log"],
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "command",
    [
        "evaluate --quick --policy uniform",
        "compare --quick --policy uniform --policy expert",
        "plan --transitions 10",
    ],
)
def test_a_log_may_be_several_files(run, parts, command, way):
    records = []
    for log in (WAYS[way], ["joined.npz"]):
        logs = " ".join(f"--log {file}" for file in log)
        records.append(json.loads(run(command, "--simulator", GRID, logs, "--json")))
        records[-1].pop("facts", None)
    assert records[0] == records[1]
    assert "in 30 episodes" in run("info", *WAYS[way])


def test_counts_stand_for_the_log(run, parts):
    told = run(f"counts log --output counts.npz --simulator {GRID}")
    assert told.startswith("counts.npz: ")
    assert "of 3 files in 30 episodes" in told
    ask = f"evaluate --simulator {GRID} --json --log"
    ours, plain = (
        json.loads(run(ask, file))["results"] for file in ("counts.npz", "joined.npz")
    )
    assert [(row["value"], row["lower"]) for row in ours] == [
        (row["value"], row["lower"]) for row in plain
    ]
    assert "TransitionCounts(" in run("info counts.npz")
    run(f"plan --simulator {GRID} --log counts.npz --transitions 50")


@pytest.mark.parametrize(
    "log", ["log.npz", "./log.npz", "link.npz log.npz", "hard.npz"]
)
def test_counts_do_not_replace_the_log_they_are_made_of(run, tmp_path, log):
    file = tmp_path / "log.npz"
    oee.Transitions([0, 1], [0, 0], [1, 0]).save(file)
    os.symlink(file, tmp_path / "link.npz")
    os.link(file, tmp_path / "hard.npz")
    before = file.read_bytes()
    told = run(f"counts {log} --output log.npz --overwrite", code=2)
    assert "--output must be another file than the log" in told
    assert file.read_bytes() == before


def test_bad_rows_are_refused_or_dropped(run, parts, tmp_path):
    part = oee.Transitions.load(parts / "part-1.parquet").columns()
    part["state"] = np.where(np.arange(len(part["state"])) == 5, 77, part["state"])
    pd.DataFrame(part).to_parquet(parts / "part-1.parquet", index=False)
    words = f"counts log --output c.npz --simulator {GRID}"
    assert "part-1.parquet': state[5] must be in 0..8; it is 77" in run(words, code=2)
    assert not (tmp_path / "c.npz").exists()
    told = run(words, "--bad-rows drop")
    assert "1 invalid rows dropped, 1 episodes broken" in told
    assert "part-1.parquet': state[5] must be in 0..8; it is 77" in told
    evaluated = run(f"evaluate --simulator {GRID} --log c.npz --quick --verbose")
    assert "1 invalid row of the log (" in " ".join(evaluated.split())
    assert "--output must be a new file, or be given with --overwrite" in run(
        words, code=2
    )
    run(words, "--bad-rows drop --overwrite")
