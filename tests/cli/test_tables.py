"""Simulators from tables, and what a log's messages propose."""

import json
import re
import warnings
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.cli.simulators import read_simulator
from oee_tabular.data.aliases import resembles_probability

COLUMNS = ["state", "action", "next_state", "probability", "reward"]


@pytest.mark.parametrize(
    ("label", "name", "other"),
    [
        ("action", "creep", "crep"),
        ("action", "drive", "dirve"),
        ("state", "kitchen", "kitchn"),
        ("state", "corridor", "Corridor"),
    ],
)
def test_a_misspelt_name_of_a_table_is_found_where_pairs_are_missing(
    run, folder, label, name, other
):
    rows = [
        (state, action, state, 1.0, 0.0)
        for state in ("kitchen", "corridor", "attic")
        for action in ("creep", "drive")
    ]
    table = pd.DataFrame(rows, columns=COLUMNS)
    row = int(np.flatnonzero(table[label] == name)[-1])
    table.loc[row, label] = other
    table.to_csv("t.csv", index=False)
    told = run("export t.csv --initial attic --output made.npz", code=2)
    assert f"row {row} (line {row + 2}) has '{other}': is '{name}' meant?" in told


@pytest.mark.parametrize(("mark", "word"), [(";", "semicolons"), ("\t", "tabs")])
def test_other_separators_of_a_table_with_own_labels_are_named(run, folder, mark, word):
    own = {label: f"my_{label}" for label in COLUMNS}
    table = table_of(oee.FiniteMDP.load("sim.npz")).rename(columns=own)
    table.to_csv("t.csv", index=False, sep=mark, decimal="," if mark == ";" else ".")
    options = " ".join(f"--column {field}={label}" for field, label in own.items())
    told = run(f"export t.csv {options} --initial r0c0 --output made.npz", code=2)
    assert f"must be separated by commas; they are by {word}" in told
    table.to_csv("t.csv", index=False)
    told = run(f"info t.csv {options}")
    assert told.rstrip().endswith(f"--output simulator.npz {options}")


@pytest.mark.parametrize("is_wide", [False, True])
@pytest.mark.parametrize(
    ("label", "value", "meant"),
    [("state", "r1c11", "r1c1"), ("action", "nn", "n"), ("state", "R2c2", "r2c2")],
)
def test_a_policy_with_own_labels_names_what_is_misspelt(
    run, folder, label, value, meant, is_wide
):
    grid = oee.FiniteMDP.load("sim.npz")
    rows = [(str(s), str(grid.action_names[0]), 1.0) for s in grid.state_names]
    table = pd.DataFrame(rows, columns=["state", "action", "probability"])
    row = int(np.flatnonzero(table[label] == (meant if label == "state" else "n"))[0])
    if is_wide:
        if label == "action":
            return
        table = pd.DataFrame({"state": table["state"], "n": 1.0})
    table.loc[row, label] = value
    table.columns = ["wo", *(["n"] if is_wide else ["was", "p"])]
    table.to_csv("pi.csv", index=False)
    told = run("evaluate --simulator sim.npz --log log.csv --policy pi.csv", code=2)
    assert f"must be one of the simulator's names; it is '{value}'" in told


def table_of(mdp, *, has_names=True):
    """Return a row for each transition from a state that is not terminal."""
    rows = []
    for k, (p, r) in enumerate(
        zip(mdp.transitions.toarray(), mdp.rewards.ravel(), strict=True)
    ):
        s, a = divmod(k, mdp.n_actions)
        if not mdp.absorbing()[s]:
            rows += [(s, a, t, p[t], r) for t in np.flatnonzero(p)]
    frame = pd.DataFrame(
        rows, columns=["state", "action", "next_state", "probability", "reward"]
    )
    if has_names:
        for column in ("state", "next_state"):
            frame[column] = [mdp.state_names[k] for k in frame[column]]
        frame["action"] = [mdp.action_names[k] for k in frame["action"]]
    return frame


@pytest.mark.parametrize("labels", [{}, {"state": "from", "next_state": "to"}])
@pytest.mark.parametrize("has_names", [False, True])
def test_a_table_of_probabilities_becomes_a_simulator(run, folder, labels, has_names):
    grid = oee.FiniteMDP.load("sim.npz")
    table = table_of(grid, has_names=has_names).rename(columns=labels)
    table.to_csv("table.csv", index=not labels)
    words = " ".join(f"--column {field}={label}" for field, label in labels.items())
    start = grid.state_names[0] if has_names else 0
    run(f"export table.csv {words} --initial {start} --discount 0.9 --output t.npz")
    made = oee.FiniteMDP.load("t.npz")
    assert_allclose(
        oee.policy_value(made, oee.uniform_policy(made)),
        oee.policy_value(grid.with_discount(0.9), oee.uniform_policy(grid)),
    )


def test_samples_become_a_simulator(run, folder):
    run("export log.csv --discount 0.8 --output s.npz")
    log = oee.Transitions.load("log.csv")
    made = oee.FiniteMDP.load("s.npz")
    same = oee.FiniteMDP.from_log(log, discount=0.8)
    assert_allclose(made.transitions.toarray(), same.transitions.toarray())
    assert made.sampling is not None
    assert json.loads(run("export log.csv --output j.npz --json"))["discount"] == 0.99
    rows = pd.read_csv("log.csv")[["state", "action", "next_state", "reward"]]
    rows.to_csv("rows.csv", index=False)
    told = run("export rows.csv --output r.npz", code=2)
    assert "--initial must be given: 'rows.csv' does not say where episodes" in told
    run("export rows.csv --output r.npz --initial 0")


def change_cell(table, row, label, value):
    table = table.astype({label: object})
    table.loc[row, label] = value
    return table


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda t: pd.concat([t, t[:1]]), "must be the only one of its state, action"),
        (lambda t: t[1:], "first in row 0 (line 2)): probability must sum to 1"),
        (lambda t: t[1:], "a row may be missing"),
        (
            lambda t: t.assign(probability=t.probability.round(1) + 1e-6),
            "of rounded ones, divide each by the sum of its pair",
        ),
        (lambda t: change_cell(t, 3, "probability", -0.5), "row 3 (line 5): pr"),
        (lambda t: change_cell(t, 3, "probability", 1.5), "in [0, 1]; it is 1.5"),
        (lambda t: change_cell(t, 5, "probability", "x"), "a finite number; it is 'x'"),
        (lambda t: change_cell(t, 2, "probability", "inf"), "row 2 (line 4): pr"),
        (lambda t: change_cell(t, 6, "reward", "1e999"), "row 6 (line 8): reward must"),
        (lambda t: t[t.action != "n"][:-9], "must have every action of a state"),
        (lambda t: t.assign(probability="x"), "probability must be a finite number"),
        (lambda t: change_cell(t, 4, "state", None), "row 4 (line 6): state must have"),
        (lambda t: t.drop(columns="reward"), "and none is reward (--column reward="),
        (
            lambda t: change_cell(t, 7, "next_state", "r0c1 "),
            "(line 9): next_state must",
        ),
        (
            lambda t: change_cell(t, 8, "action", " n"),
            "nor begin or end with a blank; it is ' n'",
        ),
    ],
)
def test_tables_that_are_no_simulator(run, folder, change, text):
    change(table_of(oee.FiniteMDP.load("sim.npz"))).to_csv("t.csv", index=False)
    told = run("export t.csv --initial r0c0 --output made.npz", code=2)
    assert text in told
    told = run("export t.csv --column epsode=x --initial r0c0 --output m.npz", code=2)
    assert told.startswith("oee: --column must name columns of state, action")
    assert not (folder / "made.npz").exists()


@pytest.mark.parametrize("command", ["evaluate --log log.csv --simulator", "export"])
def test_a_table_in_place_of_a_simulator(run, folder, command):
    told = run(f"{command} log.tsv --output x.npz", code=2)
    if command == "export":
        assert "log.tsv" in told
    else:
        assert "oee export log.tsv --initial STATE" in told
        assert "FiniteMDP.from_log(log, initial=STATE" in told
    told = run("export sim.npz --column state=x --output x.npz", code=2)
    assert "--column must be left out for 'sim.npz'" in told


@pytest.mark.parametrize("own", [{}, {"action": "cmd"}, {"state": "wo", "reward": "€"}])
def test_the_command_for_a_table_in_place_of_a_simulator_works(run, folder, own):
    table = table_of(oee.FiniteMDP.load("sim.npz")).rename(columns=own)
    table.to_csv("own table.csv", index=False)
    told = run("evaluate --simulator 'own table.csv' --log log.csv", code=2)
    command = re.search(r"oee (export .*? --output simulator.npz)", told)[1]
    assert command.count("LABEL") == len(own)
    for field, label in own.items():
        command = command.replace(f"{field}=LABEL", f"{field}={label}")
    assert "FiniteMDP" in run(
        command.replace("STATE", "r0c0").replace("discount G", "discount .9")
    )


@pytest.mark.parametrize(
    "text",
    [
        "state;action;next_state;probability;reward\n0;0;1;1;0\n",
        "",
        "state,action,next_state\n0,0,1\n",
        "state_0,state_1,action,next_state_0,next_state_1\n0,0,1,1,0\n",
        "a,b\n0,1\n",
    ],
)
def test_columns_are_asked_for_only_where_names_are_what_is_missing(run, folder, text):
    (folder / "-t.csv").write_text(text)
    told = run("evaluate --simulator=-t.csv --log log.csv", code=2)
    assert "oee export ./-t.csv --initial STATE" in told


@pytest.mark.parametrize(
    ("more", "columns"),
    [
        ({}, "state and action"),
        ({"wieviel": [1.0, 1.0]}, "state, action and probability"),
    ],
)
def test_a_table_of_few_columns_may_be_a_policy(run, folder, more, columns):
    rows = {"wo": ["r0c0", "r0c1"], "was": ["n", "e"], **more}
    pd.DataFrame(rows).to_csv("pi.csv")
    assert f"a policy's has {columns}" in run("info pi.csv", code=2)


def test_why_no_row_of_a_log_is_good_is_said(run, folder):
    rows = {"state": ["a", "b"], "action": ["go", "go"], "next_state": ["b", "a"]}
    pd.DataFrame(rows).to_csv("names.csv", index=False)
    told = run("counts names.csv --bad-rows drop --output c.npz", code=2)
    assert "must have at least one good row; of 1 files none has" in told
    assert "; 'names.csv': action[0] must be an integer; it is 'go' (names take" in told


def test_rows_that_do_not_follow_each_other_may_be_of_other_columns(run, folder):
    rows = {"state": [0, 1] * 4, "action": 0, "next_state": [1, 0] * 4}
    rows |= {"timestep": [0, 1] * 4, "run": np.arange(8) // 2, "machine": 7}
    pd.DataFrame(rows).to_csv("own.csv")
    told = run("info own.csv --column episode=machine", code=2)
    assert "timestep[2] must be 2" in told
    assert "make sure first that episode, timestep, state and next_state are" in told
    assert "count such rows as they are, in episodes that are not whole" in told
    assert "4 episodes" in run("info own.csv --column episode=run")


NUMBERS = {
    "-3,5": "write a decimal point",
    "12,000": "decimal point",
    "-1,234.5": "write it without commas",
    "\u22123": "write the minus as a hyphen",
    "\u20137.5": "write the minus as a hyphen",
    "(7.25)": "write a minus, -1, in place of",
    "3 kg": "write the number alone, without its unit",
    "$4.50": "write the number alone, without its unit",
    "12%": "write the number alone, without its unit",
}


@pytest.mark.parametrize("text", NUMBERS)
@pytest.mark.parametrize("read", [oee.Transitions.load, oee.Transitions.open])
def test_rewards_that_are_no_numbers_have_a_remedy(tmp_path, text, read):
    frame = pd.DataFrame({"state": [0, 0], "action": 0, "next_state": 0})
    frame.assign(reward=["1.5", text]).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(
        ValueError, match=r"reward\[1\] must be a number; it is"
    ) as told:
        read(tmp_path / "log.csv")
    assert NUMBERS[text] in str(told.value)


def test_odd_lines_have_a_remedy(run, folder):
    frame = pd.read_csv("log.csv")
    text = frame.to_csv(index=False)
    (folder / "above.csv").write_text(f"exported by a robot\n\n{text}")
    told = run("info above.csv", code=2)
    assert "(line 3 looks like the header: leave the lines above it out" in told
    header, rest = text.split("\n", 1)
    units = ",".join("EUR" if label == "reward" else "0" for label in frame.columns)
    (folder / "units.csv").write_text(f"{header}\n{units}\n{rest}")
    assert "(a row of units below the header?" in run("info units.csv", code=2)
    shuffled = frame.sample(frac=1, random_state=0)
    shuffled.to_csv("shuffled.csv", index=False)
    assert "sort the table by episode and time" in run("info shuffled.csv", code=2)
    told = run("counts shuffled.csv --bad-rows drop --output c.npz")
    assert "dropped:" not in told
    assert "invalid: 'shuffled.csv'" in told
    assert "(such rows are counted; their episodes are not whole)" in told
    frame.to_csv("semicolons.csv", sep=";", index=False)
    told = run("info semicolons.csv --column state=state", code=2)
    assert "they are by semicolons (in Python: pandas.read_csv(path, sep=';'" in told
    lost = frame.assign(next_state=frame.next_state.mask(frame.index == 7))
    lost.to_csv("lost.csv", index=False)
    told = run("evaluate --simulator sim.npz --log lost.csv --policy uniform", code=2)
    assert "oee counts --bad-rows drop)" in told
    told = run("counts lost.csv --bad-rows drop --output d.npz")
    assert "1 invalid rows dropped, 1 episodes broken (1 of known state" in told


def test_patterns_are_to_be_quoted(run, folder):
    words = "evaluate --simulator sim.npz --policy uniform --log log.csv sim.npz"
    told = run(words, code=2)
    assert "--log must stand before each file; before 'sim.npz' it does not" in told


def test_folders_by_an_action_of_another_name(tmp_path):
    log = oee.sample_episodes(
        oee.tasks.gridworld(3, 0.2), np.full((9, 4), 0.25), 20, 20, seed=0
    )
    frame = pd.DataFrame(log.columns()).rename(columns={"action": "cmd"})
    for action, part in frame.groupby("cmd"):
        (tmp_path / f"cmd={action}").mkdir()
        part.drop(columns="cmd").to_csv(
            tmp_path / f"cmd={action}" / "a.csv", index=False
        )
    for read in (oee.Transitions.load, oee.Transitions.open):
        with pytest.raises(ValueError, match="folders by cmd part the rows of an"):
            read(tmp_path, columns={"action": "cmd", "timestep": None})


def test_a_discount_that_nobody_chose_is_said(folder, run, capsys):
    """On stdout by export, by others on stderr; not one that the simulator has."""
    from oee_tabular.cli import main

    said = "discount 0.99 (the default; --discount sets it)\n"
    assert run("export log.csv --output s.npz").endswith(said)
    assert said not in run("export log.csv --discount 0.99 --output t.npz")
    assert said not in run("export sim.npz --output u.npz")
    run("sample FrozenLake-v1 --transitions 300 --output lake.npz")
    evaluate = "evaluate --log lake.npz --policy uniform --quick --simulator"
    for words, is_said in (
        ("export log.csv --output v.npz --json", True),
        ("policy FrozenLake-v1 optimal --output p.npy", True),
        (f"{evaluate} FrozenLake-v1", True),
        (f"{evaluate} FrozenLake-v1 --discount 0.9", False),
        ("policy sim.npz optimal --output q.npy", False),
    ):
        with pytest.raises(SystemExit) as ended:
            main(words.split())
        assert not ended.value.code
        assert (f"oee: {said}" in capsys.readouterr().err) == is_said


def test_info_knows_a_simulator_s_table(folder, run):
    """By probabilities that sum to 1; the command that it names makes a simulator."""
    rows = ["a,go,a,0.25,0", "a,go,b,0.75,1", "a,stay,a,1,0"]
    rows += ["b,go,a,0.5,2", "b,go,b,0.5,0", "b,stay,b,1,0"]
    header = "state,action,next_state,probability,reward"
    (folder / "my table.csv").write_text("\n".join([header, *rows]))
    told = run("info 'my table.csv'")
    assert "table of a simulator: 6 transitions of 2 states and 2 actions" in told
    command = told.splitlines()[1].split(": ", 1)[1]
    words = command.replace("STATE", "a").replace("--discount G", "--discount 0.9")
    assert "2 states, 2 actions" in run(words.removeprefix("oee "))
    pd.read_csv("my table.csv").rename(
        columns={"state": "von", "next_state": "nach"}
    ).drop(columns="reward").to_csv("other.csv")
    columns = "--column state=von --column next_state=nach"
    told = json.loads(run(f"info other.csv {columns} --json"))
    assert told["kind"] == "simulator_table"
    assert "once it has a column reward" in told["text"][1]
    # with the columns of a log it is one
    (folder / "log3.csv").write_text(
        "state,action,next_state,behavior_probability\n0,1,1,1\n1,0,0,1\n"
    )
    assert run("info log3.csv").startswith("Transitions(2 transitions")


@pytest.mark.parametrize(
    ("file", "is_what"),
    [
        ("policy.csv", "holds a policy"),
        ("trials.csv", "holds trials"),
        ("sim.npz", "is no table"),
        ("sim.umb", "is a FiniteMDP"),
        ("report.json", "is a report"),
    ],
)
def test_info_says_which_files_have_no_columns_of_a_log(folder, run, file, is_what):
    (folder / "policy.csv").write_text("state,action\nr0c0,n\nr0c1,e\n")
    (folder / "trials.csv").write_text("policy,success\nmine,1\nmine,0\n")
    (folder / "report.json").write_text("{}")
    if file == "sim.umb":
        oee.FiniteMDP.load("sim.npz").save(file)
    told = run(f"info {file} --column state=where", code=2)
    assert f"--column must be left out for {file!r}, which {is_what};" in told


RESEMBLES = "resembles probability (to read it: --column "
SUMS = "sums to 1 for each state and action, as probabilities ("


@pytest.mark.parametrize(
    ("label", "reason"),
    [
        ("probabilty", RESEMBLES),
        ("Porbability", RESEMBLES),
        ("propability", RESEMBLES),
        ("transition_prob", RESEMBLES),
        ("proba", RESEMBLES),
        ("P next", RESEMBLES),
        ("chance", SUMS),
        ("weight", SUMS),
        ("how often", SUMS),
        ("42", SUMS),
    ],
)
def test_a_column_that_may_be_the_probability_is_asked_after(
    run, folder, label, reason
):
    """Rows of a table of probabilities would count as samples without it."""
    grid = oee.FiniteMDP.load("sim.npz")
    table = table_of(grid).rename(columns={"probability": label})
    table.to_csv("t.csv", index=False)
    told = run("export t.csv --initial r0c0 --output made.npz", code=2)
    assert f"'{label}' {reason}" in told
    assert not (folder / "made.npz").exists()
    run(f"export t.csv --initial r0c0 --column 'probability={label}' --output made.npz")
    made = oee.FiniteMDP.load("made.npz")
    assert made.sampling is None
    assert_allclose(
        oee.policy_value(made, oee.uniform_policy(made)),
        oee.policy_value(grid.with_discount(0.99), oee.uniform_policy(grid)),
    )
    run("export t.csv --initial r0c0 --column probability= --output of_samples.npz")
    assert oee.FiniteMDP.load("of_samples.npz").sampling is not None


@pytest.mark.parametrize("values", [[0.5, 0.5, 0.5, 0.4], [1.0, 0.0, 1.0, 1.0]])
def test_other_columns_of_numbers_are_left_out(run, folder, values):
    frame = pd.DataFrame(
        {
            "state": ["a", "a", "b", "b"],
            "action": ["go", "go", "go", "go"],
            "next_state": ["a", "b", "a", "b"],
            "reward": [0.0, 1.0, 0.0, 1.0],
            "load": values,
        }
    )
    frame.to_csv("t.csv", index=False)
    run("export t.csv --initial a --output made.npz")
    assert oee.FiniteMDP.load("made.npz").sampling is not None


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        (
            "s,action,next_state,reward,note\n0,0,1,1,0.5\n1,0,0,0,0.3\n",
            "--column state=S",
            "did you mean 's'?",
        ),
        (
            "state,action,next_state,reward,x\n,0,1,1,0.5\n,0,0,1,0.5\n1,0,0,0,1.0\n",
            "",
            "state[0] must have a value",
        ),
    ],
)
def test_other_faults_of_a_table_are_told_first(run, folder, text, options, said):
    (folder / "t.csv").write_text(text)
    assert said in run(f"export t.csv --initial 0 {options} --output made.npz", code=2)


@pytest.mark.parametrize("end", ["csv", "csv.gz", "parquet"])
def test_samples_without_rewards_are_no_simulator(run, folder, end):
    log = pd.DataFrame({"at": [0, 1], "do": [0, 0], "to": [1, 0], "gain": [1.0, 2.0]})
    getattr(log, f"to_{end.split('.')[0]}")(f"t.{end}", index=False)
    names = "--column state=at --column action=do --column next_state=to"
    told = run(f"export t.{end} {names} --initial 0 --output made.npz", code=2)
    assert f"'t.{end}' must have rewards, to be a simulator; it has at, do" in told
    assert "none is reward (--column reward=LABEL)" in told
    run(f"export t.{end} {names} --column reward=gain --initial 0 --output made.npz")
    assert oee.FiniteMDP.load("made.npz").rewards.max() == 2.0


def test_states_in_two_columns_beside_one_of_numbers(run, folder):
    text = "x,y,action,x2,y2,reward,note\n0,0,go,0,1,1,0.5\n0,1,go,0,0,0,0.8\n"
    (folder / "t.csv").write_text(text)
    columns = "--column state=x,y --column next_state=x2,y2"
    run(f"export t.csv {columns} --initial 0 --output made.npz")
    assert oee.FiniteMDP.load("made.npz").state_names == ((0, 0), (0, 1))


def test_a_misspelt_column_of_a_table_of_probabilities_is_named(run, folder):
    table = table_of(oee.FiniteMDP.load("sim.npz"))
    table.rename(columns={"reward": "rewrad"}).to_csv("t.csv", index=False)
    told = run("export t.csv --initial r0c0 --output made.npz", code=2)
    assert "none is reward (did you mean 'rewrad'?) (--column reward=LABEL)" in told
    table.to_csv("t.csv", index=False)
    words = "--column probability=weight"
    told = run(f"export t.csv {words} --initial r0c0 --output made.npz", code=2)
    assert "none is weight (--column probability=LABEL)" in told


@pytest.mark.parametrize(
    ("label", "meant"),
    [
        ("probabilty", "behavior_probability"),
        ("action_probabilty", "behavior_probability"),
        ("propensty_score", "behavior_probability"),
        ("is_terminl", "terminated"),
        ("episode_indx", "episode"),
        ("epsiode_index", "episode"),
    ],
)
def test_misspelt_labels_of_other_projects_are_asked_after(tmp_path, label, meant):
    frame = pd.DataFrame({"state": [0, 0], "action": 0, "next_state": 0, label: 1})
    frame.to_csv(tmp_path / "log.csv", index=False)
    for read in (oee.Transitions.load, oee.Transitions.open):
        with pytest.raises(ValueError, match=f"{label}' resembles .*{meant}"):
            read(tmp_path / "log.csv")
        with pytest.warns(oee.exceptions.DataWarning, match=f"left out: {label}"):
            read(tmp_path / "log.csv", columns={meant: None})
    for other in ("action_prob_2", "episode_reward", "step_cost", "probe", "stability"):
        with pytest.warns(oee.exceptions.DataWarning, match=other):
            oee.Transitions.from_frame(frame[frame.columns[:3]].assign(**{other: 1}))


ROUTES = [("hall", "go", "door"), ("door", "go", "yard"), ("yard", "go", "hall")]


@pytest.mark.parametrize(
    ("row", "name", "other"),
    [(0, "dorr", "door"), (1, "Yard", "yard"), (2, "halll", "hall"), (0, "doo", "")],
)
def test_a_misspelt_next_state_is_named_with_its_line(folder, row, name, other):
    rows = [[*each, 0.5, 1.0] for each in ROUTES]
    rows += [[*each[:2], "the end", 0.5, 0.0] for each in ROUTES]
    rows.append(["yard", "go", name, 0.25, 0.0])
    rows[2][3] = 0.25
    rows.insert(row, rows.pop())
    text = "state,action,next_state,probability,reward\n\n"
    text += "\n".join(",".join(map(str, each)) for each in rows)
    (folder / "t.csv").write_text(text)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        made = read_simulator("t.csv", {}, "hall", 0.9)
    found = [str(each.message) for each in told]
    assert len(found) == bool(other)
    if other:
        place = f"'t.csv': row {row} (line {row + 3}): next_state"
        assert found[0].startswith(
            f"{place} '{name}' resembles the state '{other}', and"
        )
    assert made.absorbing()[made.state_names.index(name)]
    # a row of its own says that it is meant
    (folder / "t.csv").write_text(f"{text}\n{name},go,{name},1,0")
    made = read_simulator("t.csv", {}, "hall", 0.9)
    assert made.absorbing()[made.state_names.index(name)]


@pytest.mark.parametrize("label", ["p_id", "p_value", "p_terminal", "availability"])
def test_columns_that_no_probability_is_are_left_out(label):
    assert not resembles_probability(label)


@pytest.mark.parametrize("label", ["p", "P next", "prob", "transition_prob", "proba"])
def test_columns_that_may_be_the_probability(label):
    assert resembles_probability(label)


def test_info_takes_a_table_for_a_log_where_that_is_said(folder, run):
    """And where values are missing, which no simulator's table has."""
    (folder / "t.csv").write_text(
        "state,action,next_state,probability,reward\n0,0,1,1,1\n1,0,0,1,1\n"
    )
    assert "table of a simulator" in run("info t.csv")
    (folder / "miss.csv").write_text(
        "state,action,next_state,probability,reward\n,0,1,1,1\n0,,1,1,1\n"
    )
    assert "table of a simulator" not in run("info miss.csv", code=2)
    words = "info t.csv --column behavior_probability=probability"
    assert run(words).startswith("Transitions(2 transitions")
    assert "table of a simulator" not in run("info t.csv --column probability=", code=2)


OWN_NAMES = """pose,cmd,next_pose,chance,reward
dock,go,aisle,0.8,-1
dock,go,dock,0.2,-1
dock,wait,dock,1,0
aisle,go,delivered,0.9,5
aisle,go,dock,0.1,-1
aisle,wait,aisle,1,0
"""
OWN_COLUMNS = " ".join(
    f"--column {field}={label}"
    for field, label in (
        ("state", "pose"),
        ("action", "cmd"),
        ("next_state", "next_pose"),
        ("probability", "chance"),
    )
)


def test_all_missing_columns_are_named_at_once(run, tmp_path):
    (tmp_path / "own.csv").write_text(OWN_NAMES)
    all_three = "--column state=LABEL --column action=LABEL --column next_state=LABEL)"
    of_simulator = "has probability and reward as well (--column probability=LABEL)"
    for words in ("info own.csv", "export own.csv --initial dock --output s.npz"):
        told = run(words, code=2)
        assert "none is state, action or next_state" in told
        assert all_three in told
        assert of_simulator in told
    words = "export own.csv --initial dock --output s.npz --column probability=chance"
    told = run(words, code=2)
    assert "probability and reward; it has pose, cmd, next_pose, chance, reward" in told
    assert all_three in told
    told = run(f"{words} --column state=pose --column reward=pay", code=2)
    assert "none is action, next_state (did you mean 'next_pose'?) or pay" in told
    assert "--column next_state=LABEL --column reward=LABEL)" in told
    # a way on that the reader knows stays
    (tmp_path / "s.csv").write_text(
        OWN_NAMES.replace("pose", "state", 1).replace(",", ";")
    )
    assert "must be separated by commas" in run("info s.csv", code=2)
    told = run(f"info own.csv {OWN_COLUMNS}")
    assert "table of a simulator: 6 transitions of 3 states" in told


def test_export_of_a_table_says_where_episodes_start_and_are_over(run, tmp_path):
    (tmp_path / "own.csv").write_text(OWN_NAMES)
    told = run(f"export own.csv --initial dock --output s.npz {OWN_COLUMNS}")
    assert told.splitlines()[1] == (
        "episodes start in dock; delivered is terminal: every action leads back to it"
        " with reward 0"
    )
    rows = ["0,0,1,0.5,0", "0,0,2,0.5,0"]
    header = "state,action,next_state,probability,reward"
    (tmp_path / "two.csv").write_text("\n".join([header, *rows]))
    told = run("export two.csv --initial 0 --output two.npz")
    assert "start in 0; 1, 2 are terminal: every action leads back to the same" in told
    rows = [f"0,0,{k},0.125,0" for k in range(1, 9)]
    (tmp_path / "many.csv").write_text("\n".join([header, *rows]))
    told = run("export many.csv --initial 0 --output many.npz")
    assert "1, 2, 3, 4, 5 and 3 other states are terminal" in told
    (tmp_path / "none.csv").write_text(f"{header}\n0,0,0,1,1")
    told = run("export none.csv --initial 0 --output none.npz")
    assert "episodes start in 0; no state is terminal" in told


HEADER = ",".join(COLUMNS)


def write_table(name, rows, *more):
    """Write a simulator's table with more columns than it must have."""
    with open(name, "w") as handle:
        handle.write("\n".join([",".join([HEADER, *more]), *rows]))


def value_of(file):
    mdp = oee.FiniteMDP.load(file)
    return float(oee.policy_value(mdp, oee.uniform_policy(mdp)))


EXPORT = "export g.csv --initial a --discount .9 --output g.npz --overwrite"


@pytest.mark.parametrize("flags", [("True", "False"), ("1", "0"), ("1.0", "0.0")])
@pytest.mark.parametrize(
    ("label", "option"),
    [
        ("terminated", ""),
        ("is_terminal", ""),
        ("terminals", ""),
        ("Terminal", ""),
        ("done", "--column terminated=done"),
        ("goal reached", "--column 'terminated=goal reached'"),
    ],
)
def test_a_transition_that_ends_the_task_is_worth_its_reward(
    run, folder, flags, label, option
):
    yes, no = flags
    write_table("g.csv", [f"a,x,b,1,1,{yes}", f"b,x,a,1,5,{no}"], label)
    run(f"{EXPORT} {option}")
    assert_allclose(value_of("g.npz"), 1.0)
    # a state that is entered in both ways goes on where it is entered alive
    rows = [f"a,x,b,.5,1,{yes}", f"a,x,b,.5,3,{no}", f"b,x,a,1,5,{no}"]
    write_table("g.csv", rows, label)
    told = run(f"{EXPORT} {option}")
    assert "a transition that ends the task in b leads to b (over)" in told
    assert_allclose(value_of("g.npz"), (2 + 0.45 * 5) / (1 - 0.405))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("CliffWalking-v1", {}),
        ("FrozenLake-v1", {}),
        ("FrozenLake-v1", {"is_slippery": False}),
        ("Taxi-v4", {}),
    ],
)
def test_the_table_of_an_environment_is_the_model_of_it(folder, name, options):
    env = pytest.importorskip("gymnasium").make(name, **options)
    compare_with_environment(env)


@pytest.mark.parametrize("seed", range(20))
def test_flags_that_differ_are_read_as_an_environment_s_are(folder, seed):
    """Some states are entered both alive and by termination, some by one alone."""
    rng = np.random.default_rng(seed)
    table = {}
    for s in range(5):
        table[s] = {}
        for a in range(2):
            weights = rng.dirichlet(np.ones(3)).round(3)
            weights[2] = 1.0 - weights[:2].sum()
            to = rng.permutation(5)[:3].tolist()
            flags = rng.random(3) < 0.3
            rewards = rng.normal(size=3)
            table[s][a] = list(zip(weights, to, rewards, flags, strict=True))
    start = np.eye(5)[rng.integers(5)]
    compare_with_environment(SimpleNamespace(P=table, initial_state_distrib=start))


def compare_with_environment(env):
    """Compare the model of an environment with that of its table as a file."""
    rows = [
        (s, a, following, probability, reward, terminated)
        for s, actions in getattr(env, "unwrapped", env).P.items()
        for a, listed in actions.items()
        for probability, following, reward, terminated in listed
    ]
    pd.DataFrame(rows, columns=[*COLUMNS, "terminated"]).to_csv("g.csv", index=False)
    same = oee.FiniteMDP.from_gymnasium(env, discount=0.9)
    start = int(np.argmax(same.initial))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", oee.exceptions.DataWarning)
        made = read_simulator("g.csv", {}, str(start), 0.9)
    np.testing.assert_array_equal(made.terminal_state, same.terminal_state)
    assert_allclose(made.transitions.toarray(), same.transitions.toarray())
    same = same.with_initial(np.eye(same.n_states)[start])
    policy = oee.uniform_policy(made)
    assert_allclose(oee.policy_value(made, policy), oee.policy_value(same, policy))


def test_where_no_row_leaves_a_state_it_does_not_matter_how_it_is_entered(run, folder):
    rows = ["a,x,end,.5,1,1", "a,x,b,.25,0,0", "a,x,b,.25,0,0", "b,x,end,1,2,0"]
    write_table("g.csv", [*rows, "b,x,a,0,9,1"], "terminated")
    told = run(EXPORT)
    assert "end is terminal" in told
    assert "(over)" not in told
    assert_allclose(value_of("g.npz"), 0.5 + 0.45 * 2)


@pytest.mark.parametrize(
    ("more", "row", "said"),
    [
        (
            ["truncated"],
            "True",
            "row 1 (line 3): truncated must be false in a table of probabilities, as a"
            " model has no limit of time; it is True (leave the column out: --column"
            " truncated=)",
        ),
        (["timeout"], "1", "row 1 (line 3): truncated must be false"),
        (["terminated"], "perhaps", "row 1 (line 3): terminated must be a boolean"),
        (["terminated"], "2", "row 1 (line 3): terminated must be a boolean"),
        (["terminal"], "", "row 1 (line 3): terminated must have a value"),
        (["done"], "1", "'done' may say that the task ended (terminated)"),
        (["dones"], "1", "'dones' may say that the task ended (terminated)"),
        (["mask"], "1", "'mask' may be the opposite of terminated"),
        (["terminatd"], "1", "'terminatd' resembles terminated"),
        (["terminal", "is_terminal"], "1,1", "'terminal' and 'is_terminal' may each"),
    ],
)
def test_flags_that_a_table_of_probabilities_cannot_have(run, folder, more, row, said):
    zeros = ",".join("0" for _ in more)
    write_table("g.csv", [f"a,x,b,1,1,{zeros}", f"b,x,a,1,5,{row}"], *more)
    assert said in run(EXPORT, code=2)
    if len(more) == 1:
        fields = ("terminated", "truncated")
        words = " ".join(f"--column {field}=" for field in fields)
        run(f"{EXPORT} {words}")
        assert_allclose(value_of("g.npz"), (1 + 0.9 * 5) / (1 - 0.81))


def test_a_table_that_is_never_truncated_may_say_so(run, folder):
    rows = ["a,x,b,1,1,1,0", "b,x,a,1,5,0,0"]
    write_table("g.csv", rows, "terminated", "TimeLimit.truncated")
    run(EXPORT)
    assert_allclose(value_of("g.npz"), 1.0)
    told = run(f"{EXPORT} --column terminated=trminated", code=2)
    assert "none is trminated (did you mean 'terminated'?)" in told


def test_notes_of_a_table_of_probabilities_do_not_call_it_a_log(folder):
    write_table("g.csv", ["a,x,b,1,1,1,3", "b,x,a,1,5,0,4"], "is_terminal", "weight_kg")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        read_simulator("g.csv", {}, "a", 0.9)
    assert [str(each.message) for each in told] == [
        "'g.csv' has other labels than a table of probabilities: it reads 'is_terminal'"
        " as terminated (--column names other columns)",
        "columns of 'g.csv' that a table of probabilities does not use are left out:"
        " weight_kg",
    ]


def test_rows_of_one_transition_are_added_where_their_sum_is_right(folder):
    write_table("g.csv", ["a,x,b,.5,1", "a,x,b,.25,4", "a,x,a,.25,0", "b,x,a,1,0"])
    with pytest.warns(oee.exceptions.DataWarning, match=r"row 0 \(line 2\) has the st"):
        made = read_simulator("g.csv", {}, "a", 0.9)
    assert_allclose(made.transitions.toarray(), [[0.25, 0.75], [1, 0]])
    assert_allclose(made.rewards[0, 0], 1.5)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["0,0,-1,1,1"], "row 0 (line 2): next_state must be at least 0; it is -1"),
        (["-1,0,0,1,1", "0,0,0,1,0"], "row 0 (line 2): state must be at least 0"),
        (["0,0,0,1,0", "0,-2,0,1,1"], "row 1 (line 3): action must be at least 0"),
        (["0.5,0,1,1,1"], "row 0 (line 2): state must be an integer; it is 0.5"),
        (["0,0,0,1,1", "1,1.5,0,1,1"], "row 1 (line 3): action must be an integer; it"),
        (["0,0,1_0,1,1"], "row 0 (line 2): next_state must be an integer; it is 1_0"),
        ([f"0,0,{10**20 - 1},1,1"], "next_state must be below 2**63; it is 9999999999"),
        (["0,0,inf,1,1"], "row 0 (line 2): next_state must be an integer; it is inf"),
        (["0,0,1e300,1,1"], "row 0 (line 2): next_state must be below 2**63"),
        (
            ["0,0,999999999999,1,1"],
            "(line 2): next_state must be small enough for this",
        ),
        (["999999999999,0,0,1,1"], "row 0 (line 2): state must be small enough"),
        (["0,999999999999,0,1,1"], "row 0 (line 2): action must be small enough"),
        (
            ["0,0,hall,1,1"],
            "row 0 (line 2): next_state must be a number, as those of s",
        ),
        (["hall,0,0,1,1"], "row 0 (line 2): state must be a number, as those of next"),
        (["a,0,7,1,1", "b,0,a,1,1"], "row 1 (line 3): next_state must be an integer"),
        (["a,0,b,1,1", "b,0,,1,1"], "row 1 (line 3): next_state must have a value"),
        (["0,0,1,True,1"], "row 0 (line 2): probability must be a finite number"),
        (["0,0,1,,1"], "row 0 (line 2): probability must have a value; it has none"),
        (["0,0,1,1,"], "row 0 (line 2): reward must have a value; it has none"),
        (["0,0,0,1,1", "0,0,0,0,2"], "row 1 (line 3) must be the only one"),
        ([], "must have at least one row; it has none"),
    ],
)
@pytest.mark.parametrize("command", ["export g.csv --initial 0 --output g.npz", "info"])
def test_odd_numbers_of_a_table_are_named_with_their_row(
    run, folder, rows, said, command
):
    write_table("g.csv", rows)
    told = run(command if command != "info" else "info g.csv", code=2)
    assert told.startswith("oee: 'g.csv'")
    assert said in told


@pytest.mark.parametrize(
    ("rows", "start", "names"),
    [
        (["0.0,0.0,1.0,1,1", "1.0,0.0,0.0,1,2"], "0", None),
        (["0,0,1e0,1,1", "1,0,0.0,1,2"], "0", None),
        (["True,x,False,1,1", "False,x,True,1,2"], "True", ("True", "False")),
        (["true,x,false,1,1", "false,x,true,1,2"], "true", ("true", "false")),
        (["0,True,1,1,1", "1,True,0,1,2"], "0", None),
        (["none,x,NA,1,1", "NA,x,none,1,2"], "none", ("none", "NA")),
    ],
)
def test_states_are_read_as_a_log_reads_them(folder, rows, start, names):
    write_table("g.csv", rows)
    made = read_simulator("g.csv", {}, start, 0.9)
    assert made.state_names == names
    assert_allclose(oee.policy_value(made, oee.uniform_policy(made)), 2.8 / 0.19)


@pytest.mark.parametrize("end", ["csv", "csv.gz", "parquet"])
@pytest.mark.parametrize("n_lacking", [1, 2])
def test_samples_with_a_missing_reward_are_no_simulator(run, folder, end, n_lacking):
    rewards = [1.0, 2.0, 3.0, *[np.nan] * n_lacking]
    frame = pd.DataFrame({"state": 0, "action": 0, "next_state": 0, "reward": rewards})
    getattr(frame, f"to_{end.split('.')[0]}")(f"s.{end}", index=False)
    told = run(f"export s.{end} --initial 0 --output s.npz", code=2)
    row = "row 3" if end == "parquet" else "row 3 (line 5)"
    assert f"'s.{end}': {row}: reward must have a value in each row" in told
    assert ("(2 such rows in all)" in told) == (n_lacking == 2)


@pytest.mark.parametrize(
    "rows",
    [
        ["a,x,b,.9,1", "b,x,a,1,1"],
        ["a,x,b,1,1", "a,x,b,1,1", "b,x,a,1,1"],
        ["a,x,b,,1", "b,x,a,1,1"],
        ["a,x,b,100,1", "b,x,a,100,1"],
        ["a,x,b,1/2,1", "a,x,a,1/2,1", "b,x,a,1,1"],
        [",x,b,1,1", "b,x,a,1,1"],
        ["a,x,b,1,1", "b,y,a,1,1"],
        ["a,x,b ,1,1", "b,x,a,1,1"],
        ["a,x,b,1,soon", "b,x,a,1,1"],
        ["a,x,b,-1,1", "a,x,a,2,1", "b,x,a,1,1"],
    ],
)
def test_info_says_of_a_broken_table_what_export_says(run, folder, rows):
    write_table("g.csv", rows)
    told = run(EXPORT, code=2).rstrip()
    way = "; if the file is a log, and 'probability' the probability of the action that"
    info = run("info g.csv", code=2)
    assert info.startswith(f"{told}{way} was taken: --column behavior_probability=p")
    # where its label is given, it is no log's
    own = HEADER.replace("probability", "chance")
    (folder / "g.csv").write_text("\n".join([own, *rows]))
    assert run("info g.csv --column probability=chance", code=2).rstrip() == told


def test_info_on_a_table_in_another_file(run, folder):
    frame = table_of(oee.FiniteMDP.load("sim.npz"))
    frame.to_parquet("t.parquet", index=False)
    told = run("info t.parquet", code=2)
    assert "'t.parquet' must be a .csv file, to have probabilities; if" in told
    words = "info t.parquet --column behavior_probability=probability"
    assert run(words).startswith("Transitions(")


@pytest.mark.parametrize("label", ["terminated", "is_terminal"])
def test_info_knows_a_table_that_says_where_the_task_ends(run, folder, label):
    write_table("g.csv", ["a,x,b,1,1,1", "b,x,a,1,5,0"], label)
    assert "table of a simulator: 2 transitions of 2 states" in run("info g.csv")
    write_table("g.csv", ["a,x,b,1,1,1", "b,x,a,1,5,0"], "done")
    told = run("info g.csv --column terminated=done")
    assert told.rstrip().endswith("--output simulator.npz --column terminated=done")


def test_probabilities_of_a_log_s_actions_are_those_of_a_log(run, folder):
    header = HEADER.replace("probability", "action_prob")
    (folder / "log.csv").write_text(f"{header}\n0,0,1,0.5,1\n1,0,0,0.25,1\n")
    assert "behaviour probabilities" in run("info log.csv")
    text = f"{header},terminated\n0,0,1,1,1,0\n1,0,0,1,1,1\n"
    (folder / "log.csv").write_text(text)
    assert "behaviour probabilities" in run("info log.csv")
    words = "info log.csv --column probability=action_prob"
    assert "table of a simulator: 2 transitions" in run(words)
