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
            r"row 0 \(line 2\): column 'probability' .* \(write 0\.395 for 39\.5%\)",
        ),
        (
            long().assign(probability="0,25"),
            r"a number from 0 to 1 .* \(write a decimal point, not a comma\)",
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


# ---- what info and the commands that use a policy say of the same table

PLAIN = oee.FiniteMDP(
    np.full((2, 2, 2), 0.5), np.ones((2, 2)), initial=[1, 0], discount=0.5
)
NAMED = PLAIN.with_names(["dock", "hall"], ["go", "wait"])


@pytest.fixture
def say(run, tmp_path):
    """Return what the reader of policies and what info say of a table."""

    def say(text, simulator=PLAIN, code=None):
        (tmp_path / "p.csv").write_text(text)
        try:
            found = oee.mdp.check_policy(
                read_policy_table("p.csv", simulator), simulator
            ).tolist()
        except ValueError as error:
            found = str(error)
        if code is None:
            code = 2 if isinstance(found, str) else 0
        return found, run("info p.csv", code=code)

    return say


@pytest.mark.parametrize(
    "text",
    [
        "state,0,1\n0,True,False\n1,False,True\n",
        "state,0,1\n0,TRUE,\n1,,true\n",
        "state,0,1\n0,1,0\n1,False,True\n",
        "state,0,1\n0,yes,f\n1,no,t\n",
        "state,action,probability\n0,0,True\n1,1,True\n",
        "state,action,probability\n0,0,1\n0,1,FALSE\n1,0,0\n1,1,TRUE\n",
    ],
)
def test_truth_values_are_one_and_zero(say, text):
    found, told = say(text)
    assert found == [[1.0, 0.0], [0.0, 1.0]]
    assert told.startswith("policy: 2 ") or told.startswith("policy: 4 rows")


def test_a_one_hot_table_of_pandas_is_read(tmp_path):
    actions = np.arange(9) % 4
    frame = pd.get_dummies(pd.Series([ACTIONS[a] for a in actions]))
    found = read(tmp_path, frame.assign(state=STATES))
    assert_allclose(found, np.eye(4)[actions])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("80%", "it is '80%' (write 0.8 for 80%)"),
        ("12.5 %", "it is '12.5 %' (write 0.125 for 12.5 %)"),
        ("1/2", "it is '1/2' (write 0.5 for 1/2)"),
        ("x", "it is 'x'"),
        ("True", "it is 'True'"),
        ("1_0", "it is 1_0"),
        ("1.5", "it is 1.5"),
        ("-0.5", "it is -0.5"),
        ("nan", "must have a value; it has none"),
        ("inf", "it is inf"),
    ],
)
def test_what_is_no_probability_is_named_by_its_place(say, text, words):
    for place, table in (
        ("column '1'", f"state,0,1\n0,0.5,0.5\n\n1,0.5,{text}\n"),
        (
            "column 'probability'",
            f"state,action,probability\n0,0,0.5\n\n0,1,{text}\n1,0,1\n",
        ),
    ):
        found, told = say(table)
        assert f"'p.csv': row 1 (line 4): {place} must " in found
        assert words in found
        assert told == f"oee: {found}\n"


@pytest.mark.parametrize("text", ["80%", "4/5", "0,8"])
def test_shares_below_names_of_actions_are_named_by_their_place(say, text):
    found, told = say(f'state,go,wait\ndock,1,0\nhall,"{text}",.2\n', NAMED)
    assert "row 1 (line 3): column 'go' must be a number from 0 to 1" in found
    assert told == f"oee: {found}\n"


@pytest.mark.parametrize(
    ("simulator", "text"),
    [
        (NAMED, "state,action,go,wait\ndock,go,.2,.8\nhall,wait,1,0\n"),
        (NAMED, "state,action,go\ndock,go,1\nhall,wait,0\n"),
        (NAMED, "state,action,wait,go\ndock,go,False,True\nhall,wait,True,False\n"),
        (PLAIN, "0,1,state,action\n.2,.8,0,0\n1,0,1,1\n"),
        (NAMED, "s,a,go,wait\ndock,go,.2,.8\nhall,wait,1,0\n"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*has other labels than a policy")
def test_actions_stand_in_one_column_or_in_the_labels(say, simulator, text):
    found, told = say(text, simulator)
    assert "either a column action, or a column for each action" in found
    assert "did you mean" not in found
    assert told.endswith(f"oee: {found}\n")


@pytest.mark.filterwarnings("ignore:.*that a policy does not use")
def test_values_of_actions_may_stand_beside_the_actions(say):
    text = "state,action,go,wait\ndock,go,-3.5,1\nhall,wait,2,7\n"
    found, told = say(text, NAMED)
    assert found == [[1.0, 0.0], [0.0, 1.0]]
    assert "one action for each state" in told


@pytest.mark.parametrize(
    "text", ["0,1\n0,1\n1,0\n", "1,0\n1,0\n", "0\n0\n1\n", ",0,1\n0,0,1\n1,1,0\n"]
)
def test_a_table_without_states_lacks_their_column(say, text):
    found, told = say(text)
    assert "the column of the states is missing" in found
    assert "labels of the columns again" not in found
    assert "must have the columns state" in told


def test_a_header_that_stands_again_is_told_in_words_that_fit(say):
    found, told = say("state,action\n0,1\nstate,action\n")
    assert "row 1 (line 3) must hold the values of its columns; it holds the l" in found
    assert "transition" not in found
    assert told == f"oee: {found}\n"


@pytest.mark.parametrize(
    "labels",
    ["action_0,action_1", "a0,a1", "Action 1,Action 2", "pi[0],pi[1]", "a_1,a_2"],
)
@pytest.mark.parametrize("simulator", [PLAIN, NAMED])
def test_numbered_columns_are_to_be_called_by_the_number(say, labels, simulator):
    text = f"state,{labels}\n0,0,1\n1,1,0\n"
    found, told = say(text, simulator, code=0)
    first, second = labels.split(",")
    advice = f"call the columns by the actions' numbers: '{first}' 0, '{second}' 1"
    assert advice in found
    assert advice in told
    assert say(text.replace(labels, "0,1"))[0] == [[0.0, 1.0], [1.0, 0.0]]


def test_numbered_columns_that_are_names_are_read(say):
    simulator = PLAIN.with_names(["dock", "hall"], ["action_0", "action_1"])
    found, told = say("state,action_0,action_1\ndock,0,1\nhall,1,0\n", simulator)
    assert found == [[0.0, 1.0], [1.0, 0.0]]
    assert "where the simulator's actions have no such names" in told


@pytest.mark.parametrize(
    "frame",
    [
        pd.DataFrame({"pose": STATES[:5], "cmd": ACTIONS[0]}),
        pd.DataFrame({"state": STATES[:5], "action": ACTIONS[0]}),
        pd.DataFrame({"pose": STATES[:5], "cmd": ACTIONS[0], "prob": 1}),
        wide("pose").iloc[:5],
    ],
)
@pytest.mark.filterwarnings("ignore:.*has other labels than a policy")
@pytest.mark.parametrize("n_good", [0, 1, 4])
def test_states_that_are_misspelt_are_named(tmp_path, frame, n_good):
    label = "state" if "state" in frame else "pose"
    wrong = ["bayy", "gaet", "rood", "shopp", "yardd"]
    frame = frame.assign(**{label: STATES[:n_good] + wrong[n_good:]})
    first = f"'{wrong[n_good]}' (did you mean '{STATES[n_good]}'?)"
    place = f"row {n_good} (line {n_good + 2}): column '{label}' must be one of the"
    with pytest.raises(ValueError, match=re.escape(place)) as refused:
        read(tmp_path, frame)
    assert f"simulator's names; it is {first}" in str(refused.value)
    for name, meant in list(zip(wrong, STATES, strict=False))[n_good + 1 : n_good + 3]:
        assert f"{name!r} (did you mean {meant!r}?)" in str(refused.value)


def test_actions_that_are_misspelt_are_named(tmp_path):
    frame = pd.DataFrame({"state": STATES[:4], "cmd": ["upp", "rihgt", "dwn", "left"]})
    with pytest.raises(ValueError, match=r"column 'cmd' must be one of .* 'upp' \(did"):
        read(tmp_path, frame)
