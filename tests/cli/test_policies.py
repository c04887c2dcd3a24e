"""Policies as CSV tables: their labels, what is left out, and what is refused."""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.cli.policies import read_policy_table

STATES = ["bay", "gate", "road", "shop", "yard", "ramp", "lift", "belt", "end"]
ACTIONS = ["up", "right", "down", "left"]
GRID = oee.tasks.gridworld(3, slip=0.3).with_names(STATES, ACTIONS)
POLICY = np.random.default_rng(0).dirichlet(np.ones(4), size=9).round(3)
POLICY[:, 0] = 1 - POLICY[:, 1:].sum(axis=1)


def long(labels=("state", "action", "probability")):
    rows = [(STATES[s], ACTIONS[a], POLICY[s, a]) for s in range(9) for a in range(4)]
    return pd.DataFrame(rows, columns=list(labels))


def wide(label="state"):
    return pd.DataFrame(POLICY, columns=ACTIONS).assign(**{label: STATES})


def read(folder, frame, **options):
    path = folder / "pi.csv"
    frame.to_csv(path, **({"index": False} | options))
    return oee.mdp.check_policy(read_policy_table(str(path), GRID), GRID)


@given(
    st.permutations(["state", "action", "probability"]),
    st.sampled_from(["s", "from_state", "obs", "where", "pose"]),
    st.sampled_from(["act", "actions", "what", "cmd"]),
    st.sampled_from(["prob", "p", "pi", "Probability", "probabilities", "action_prob"]),
    st.booleans(),
)
@settings(max_examples=60, deadline=None)
@pytest.mark.filterwarnings("ignore:.*has other labels than a policy")
def test_labels_do_not_change_a_policy(
    tmp_path_factory, order, state, action, probability, index
):
    new = {"state": state, "action": action, "probability": probability}
    frame = long()[order].rename(columns=new)
    folder = tmp_path_factory.mktemp("policy")
    assert_allclose(read(folder, frame, index=index), POLICY)


@pytest.mark.parametrize("index", [False, True])
def test_a_column_for_each_action(tmp_path, index):
    assert_allclose(read(tmp_path, wide(), index=index), POLICY)
    with pytest.warns(UserWarning, match="'place' as state"):
        assert_allclose(read(tmp_path, wide("place"), index=index), POLICY)
    with pytest.warns(UserWarning, match="policy does not use are left out: note, n"):
        assert_allclose(read(tmp_path, wide().assign(note="x", n=7)), POLICY)


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (long(["state", "action", "weight"]), "'weight' holds numbers from 0 to 1"),
        (
            long().assign(prob=0.5).rename(columns={"probability": "p"}),
            "must have one column of probabilities; it has 'p' and 'prob'",
        ),
        (
            wide().rename(columns={"up": "Up"}),
            r"'Up' holds numbers from 0 to 1 .* \(did you mean 'up'\?\)",
        ),
        (
            long().assign(probability=[f"{p:.1%}" for p in POLICY.ravel()]),
            r"numbers as probabilities; .* \(write 0\.1 for 10%\)",
        ),
        (
            long().assign(probability="0,25"),
            r"numbers as probabilities; .* \(write a decimal point, not a comma\)",
        ),
    ],
)
def test_what_may_be_a_probability_is_never_left_out(tmp_path, frame, text):
    with pytest.raises(ValueError, match=text):
        read(tmp_path, frame)


@pytest.mark.parametrize("sep", [";", "\t", "|"])
def test_other_separators_have_a_remedy(tmp_path, sep):
    with pytest.raises(ValueError, match=r"must be separated by commas; they are by"):
        read(tmp_path, long(), sep=sep)
    again = pd.read_csv(tmp_path / "pi.csv", sep=sep, decimal=",")
    again["probability"] = again["probability"].astype(float)
    assert_allclose(read(tmp_path, again), POLICY)


def test_info_says_that_a_table_is_a_policy(run, tmp_path):
    long(["pose", "cmd", "prob"]).to_csv("long.csv")
    wide()[["state", *ACTIONS]].to_csv("wide.csv", index=False)
    assert run("info long.csv").startswith(
        "policy: 36 rows of 9 states and 4 actions, probabilities 'prob'"
    )
    assert "policy: 9 states, and a column for each of 4 actions" in run(
        "info wide.csv"
    )
    # a log that lacks a column is none
    pd.DataFrame({"state": [0], "action": [1], "reward": [2.0]}).to_csv("log.csv")
    assert "must have the columns state, action, next_state" in run(
        "info log.csv", code=2
    )


@pytest.mark.parametrize("labels", [["0", "00"], ["1", "0", "01"], ["0", "1", "000"]])
def test_one_action_in_two_columns_is_refused(tmp_path, labels):
    frame = pd.DataFrame({"state": [0, 1]}).assign(**dict.fromkeys(labels, 0.5))
    frame.to_csv(tmp_path / "p.csv", index=False)
    simulator = oee.FiniteMDP(
        np.full((2, 2, 2), 0.5), np.ones((2, 2)), initial=[1, 0], discount=0.5
    )
    with pytest.raises(ValueError, match=r"one column for each action; .* are both"):
        read_policy_table(str(tmp_path / "p.csv"), simulator)


def test_states_and_actions_are_read_as_those_of_logs(tmp_path):
    path = tmp_path / "p.csv"
    flags = {"state_names": ["True", "False"], "action_names": ["yes", "no"]}
    simulator = oee.FiniteMDP(
        np.full((2, 2, 2), 0.5), np.ones((2, 2)), initial=[1, 0], discount=0.5
    )
    named = oee.FiniteMDP(
        np.full((2, 2, 2), 0.5), np.ones((2, 2)), initial=[1, 0], discount=0.5, **flags
    )
    path.write_text("state,action\n0.0,1.0\n1.0,0.0\n")
    assert read_policy_table(str(path), simulator) == {0: 1, 1: 0}
    path.write_text("state,action\nTrue,no\nFalse,yes\n")
    found = read_policy_table(str(path), named)
    assert found == {"True": "no", "False": "yes"}
    assert oee.mdp.check_policy(found, named).tolist() == [[0, 1], [1, 0]]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("state,action\n0,1\n1,\n", "action[1]"),
        ("state,action,probability\n0,1,1\n,0,1\n", "state[1]"),
        ("state,0,1\n0,0.5,0.5\n,0.5,0.5\n", "state[1]"),
    ],
)
def test_empty_states_and_actions_are_named_by_their_row(tmp_path, text, place):
    (tmp_path / "p.csv").write_text(text)
    simulator = oee.FiniteMDP(
        np.full((2, 2, 2), 0.5), np.ones((2, 2)), initial=[1, 0], discount=0.5
    )
    with pytest.raises(ValueError, match=re.escape(f"{place} has none (1 such")):
        read_policy_table(str(tmp_path / "p.csv"), simulator)


@pytest.mark.parametrize("label", ["probabilty", "action_probabilty", "Proba"])
def test_a_column_that_may_be_the_probability_is_asked_after(tmp_path, label):
    """Without it the one action that a state has would be taken always."""
    frame = pd.DataFrame({"state": STATES, "action": "up", label: 0.5})
    with pytest.raises(ValueError, match=f"'{label}' resembles probability"):
        read(tmp_path, frame)


@pytest.mark.parametrize("has_names", [True, False])
def test_policies_are_written_as_tables_that_are_read_again(run, tmp_path, has_names):
    grid = GRID if has_names else oee.tasks.gridworld(3, slip=0.3)
    grid.save("sim.npz")
    told = run("policy sim.npz mix:0.7 --output pi.csv")
    assert told.startswith("pi.csv: policy of 9 states and 4 actions")
    run("policy sim.npz mix:0.7 --output pi.npy")
    frame = pd.read_csv("pi.csv")
    assert list(frame.columns) == ["state", "action", "probability"]
    assert frame["state"][0] == (STATES[0] if has_names else 0)
    run("policy sim.npz pi.csv --output again.npy")
    np.testing.assert_array_equal(np.load("again.npy"), np.load("pi.npy"))
    assert "probabilities 'probability'" in run("info pi.csv")
    told = run("policy sim.npz mix:0.7 --output pi.txt", code=2)
    assert "--output must end in .npy or .csv; it is 'pi.txt'" in told
    assert "--overwrite" in run("policy sim.npz uniform --output pi.csv", code=2)


@pytest.mark.parametrize(
    "names",
    [
        [f"a, {k}" for k in range(9)],
        [f"-{k}=" for k in range(9)],
        [(k // 3, k % 3) for k in range(9)],
        [("x", k) for k in range(9)],
        ["NA", "null", "None", "true", "False", "é", "=1", "'", '"'],
    ],
)
def test_odd_names_of_a_written_policy_are_read_again(run, tmp_path, names):
    oee.tasks.gridworld(3, slip=0.3).with_names(names, ACTIONS).save("sim.npz")
    run("policy sim.npz mix:0.7 --output pi.csv")
    run("policy sim.npz mix:0.7 --output pi.npy")
    run("policy sim.npz pi.csv --output again.npy")
    np.testing.assert_array_equal(np.load("again.npy"), np.load("pi.npy"))
