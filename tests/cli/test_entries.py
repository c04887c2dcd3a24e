"""``oee evaluate --features FILE --tie FILE``: what a user's own files do, and what is said of bad ones."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular.cli import main
from oee_tabular.cli.entries import features_of, tie_of
from oee_tabular.mdp import displacements

GRID = oee.tasks.gridworld(3, 0.3)
TARGET = oee.tasks.gridworld(3, 0.1)
LOG = oee.sample_transitions(TARGET, np.full((9, 4), 1 / 36), 200, seed=0)
ROW = np.repeat(np.arange(36), np.diff(GRID.transitions.indptr))
STATE, ACTION, NEXT = ROW // 4, ROW % 4, GRID.transitions.indices
KIND = displacements(GRID)[1]
KEYS = 10 * ACTION + KIND
NNZ = GRID.transitions.nnz
POLICY = oee.tasks.gridworld_policy(3, 0.8)


def run(capsys, *arguments, code=0):
    """stdout (or stderr for an expected error) of ``oee arguments``."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert (ended.value.code or 0) == code
    captured = capsys.readouterr()
    return captured.out if code == 0 else captured.err


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    LOG.save("log.csv")
    return tmp_path


ASK = ["evaluate", "--simulator", "gridworld:3,slip=0.3", "--log", "log.csv", "--policy", "mix:0.8"]


def table(**columns):
    return pd.DataFrame({"state": STATE, "action": ACTION, "next_state": NEXT} | columns)


def dense(values, elsewhere=np.nan):
    """(S, A, S, ...) of values on the entries."""
    found = np.full((9, 4, 9, *np.shape(values)[1:]), elsewhere, dtype=np.result_type(values, elsewhere))
    found[STATE, ACTION, NEXT] = values
    return found


# ---------------------------------------------------------------- what they do


FILES = {"features": np.column_stack([KIND == 1, NEXT]).astype(float), "tie": KEYS}
OPTIONS = {"features": {"prior": "tilt", "features": FILES["features"]}, "tie": {"tie": KEYS}}


@pytest.mark.parametrize(("kind", "name"), [("features", "oee-features"), ("tie", "oee-tied")])
def test_a_file_adds_a_row_with_its_interval_and_leaves_the_others(capsys, kind, name):
    np.save("own.npy", FILES[kind])
    plain = json.loads(run(capsys, *ASK, "--json"))
    more = json.loads(run(capsys, *ASK, f"--{kind}", "own.npy", "--json"))
    assert [row["estimator"] for row in more["results"]] == ["simulator", "oee", "model-based", name]
    for other in ("simulator", "oee", "model-based"):
        one, two = (next(r for r in found["results"] if r["estimator"] == other) for found in (plain, more))
        assert {k: v for k, v in one.items() if k != "notes"} == {k: v for k, v in two.items() if k != "notes"}
    assert set(plain["warnings"]) <= set(more["warnings"])
    problem, row = oee.Problem(GRID, oee.Transitions.load("log.csv")), more["results"][-1]
    expected = oee.estimators.OffEnvironment(partial(oee.transition_ratio, **OPTIONS[kind]))(problem, POLICY)
    assert expected.value in (row["value"], row.get("replaced_value"))
    interval = oee.interval(problem, POLICY, **{kind: FILES[kind]})
    assert (row["lower"], row["upper"], row["interval_method"]) == (interval.lower, interval.upper, interval.method)
    assert kind not in plain["facts"]
    assert more["facts"][kind].startswith("own.npy (")
    np.save("keys.npy", KEYS)
    np.save("phi.npy", FILES["features"])
    both = run(capsys, *ASK, "--features", "phi.npy", "--tie", "keys.npy", code=2)
    assert "tie and features must not be given together" in both


def test_a_box_narrows_the_interval(capsys):
    plain, boxed = (json.loads(run(capsys, *ASK, *words, "--json")) for words in ((), ("--box", "0.2,3")))
    one, two = (next(r for r in found["results"] if r["estimator"] == "oee") for found in (plain, boxed))
    assert one["lower"] <= two["lower"] < two["upper"] <= one["upper"]
    assert boxed["facts"]["target"] == "assumed between 0.2 and 3 times the simulator's probabilities"
    for text in ("0.5", "a,b", "1,2,3", "nan,2"):
        assert "--box must be LOWER,UPPER" in run(capsys, *ASK, "--box", text, code=2)
    assert "lower_ratio must be in [0, 1]" in run(capsys, *ASK, "--box", "1.5,2", code=2)


def test_beside_the_estimators_that_were_asked_for(capsys):
    table(kind=KEYS).to_csv("keys.csv", index=False)
    words = [*ASK, "--estimators", "model-based,oracle", "--target", "gridworld:3,slip=0.1", "--json"]
    found = json.loads(run(capsys, *words, "--tie", "keys.csv"))
    assert [row["estimator"] for row in found["results"]] == ["model-based", "oracle", "oee-tied"]
    assert not any("left out" in text for text in found["warnings"])
    assert found["results"][-1]["error"] == found["results"][-1]["value"] - found["results"][-1]["true_value"]


def test_the_page_names_the_files(capsys):
    np.save("keys.npy", KEYS)
    run(capsys, *ASK, "--tie", "keys.npy", "--report", "page.html")
    with open("page.html") as handle:
        page = handle.read()
    assert "keys.npy (" in page
    assert "oee-tied" in page


def test_the_simulator_is_the_one_with_action_noise(capsys):
    noisy = GRID.with_action_noise(0.1)
    np.save("keys.npy", np.arange(noisy.transitions.nnz))
    np.save("other.npy", np.arange(oee.tasks.gridworld(3, 0.0).transitions.nnz))
    words = ["evaluate", "--simulator", "gridworld:3,slip=0.0", "--log", "log.csv", "--action-noise", "0.1"]
    assert f"keys.npy ({noisy.transitions.nnz} keys)" in run(capsys, *words, "--tie", "keys.npy", "--json")
    assert f"must have shape ({noisy.transitions.nnz},)" in run(capsys, *words, "--tie", "other.npy", code=2)


def test_four_shapes_of_features_are_one():
    one, two = (KIND == 1).astype(float), np.column_stack([KIND == 1, NEXT])
    for given, expected in ((one, one[:, None]), (dense(one), one[:, None]), (two, two), (dense(two), two)):
        np.save("phi.npy", given)
        found, names = features_of(Path("phi.npy"), GRID)
        assert_array_equal(found, expected)
        assert names == [f"feature {k}" for k in range(expected.shape[1])]
        assert found.dtype == np.float64
    np.save("phi.npy", KIND == 1)
    Path("phi.npy").rename("PHI.NPY")
    assert_array_equal(features_of(Path("PHI.NPY"), GRID)[0], one[:, None])


def test_a_table_of_features_may_leave_moves_out():
    some = table(ahead=(KIND == 1) * 2.5, empty=0, late=NEXT > 4).iloc[np.random.default_rng(0).permutation(NNZ)]
    some = some[(some["ahead"] > 0) | some["late"]]
    some[["late", "next_state", "ahead", "action", "empty", "state"]].to_csv("PHI.CSV", index=False)
    found, names = features_of(Path("PHI.CSV"), GRID)
    assert names == ["late", "ahead", "empty"]
    assert_array_equal(found, np.column_stack([NEXT > 4, (KIND == 1) * 2.5, np.zeros(NNZ)]))


def test_keys_in_three_forms_are_one():
    shuffled = table(kind=KEYS - 7).iloc[::-1]
    shuffled.to_csv("keys.csv", index=False)
    shuffled.astype({"kind": float}).to_csv("decimal.csv", index=False)
    np.save("keys.npy", KEYS - 7)
    np.save("dense.npy", dense(KEYS - 7, elsewhere=0))
    for name in ("keys.csv", "decimal.csv", "keys.npy", "dense.npy"):
        assert_array_equal(tie_of(Path(name), GRID), KEYS - 7)
        assert tie_of(Path(name), GRID).dtype == np.int64
    large = 2**62 + np.arange(NNZ)  # as floats they would be one
    table(kind=large).to_csv("keys.csv", index=False)
    assert_array_equal(tie_of(Path("keys.csv"), GRID), large)


NAMED = GRID.with_names([f"cell {s}" for s in range(9)], [("go", a) for a in range(4)])


def by_name(**columns):
    called = {"state": STATE, "next_state": NEXT}
    frame = table(**columns).assign(**{label: [f"cell {s}" for s in values] for label, values in called.items()})
    return frame.assign(action=[str(("go", int(a))) for a in ACTION])


def test_states_and_actions_by_name(capsys):
    NAMED.save("named.npz")
    by_name(ahead=KIND == 1).iloc[::-1].to_csv("phi.csv", index=False)
    by_name(kind=KEYS).to_csv("keys.csv", index=False)
    assert_array_equal(features_of(Path("phi.csv"), NAMED)[0], (KIND == 1)[:, None])
    assert_array_equal(tie_of(Path("keys.csv"), NAMED), KEYS)
    table(kind=KEYS).to_csv("numbers.csv", index=False)  # numbers are taken as they were
    assert_array_equal(tie_of(Path("numbers.csv"), NAMED), KEYS)
    ask = [
        "evaluate",
        "--simulator",
        "named.npz",
        "--log",
        "log.csv",
        "--json",
    ]
    for words, name in ((("--tie", "keys.csv"), "oee-tied"), (("--features", "phi.csv"), "oee-features")):
        found = json.loads(run(capsys, *ask, *words))
        assert found["results"][-1]["estimator"] == name


def test_python_takes_the_same_tables():
    tuples = by_name(ahead=KIND == 1).assign(action=[("go", int(a)) for a in ACTION])
    for frame in (
        tuples,
        by_name(ahead=KIND == 1),
        table(ahead=KIND == 1),
        pa.Table.from_pandas(by_name(ahead=KIND == 1)),
    ):
        same = oee.transition_ratio(LOG, NAMED, features=frame).values.data
        assert_array_equal(same, oee.transition_ratio(LOG, NAMED, features=(KIND == 1).astype(float)).values.data)
    tied = oee.transition_ratio(LOG, NAMED, tie=by_name(kind=KEYS)).values.data
    assert_array_equal(tied, oee.transition_ratio(LOG, NAMED, tie=KEYS).values.data)


@pytest.mark.parametrize(
    ("column", "value", "text"),
    [
        (
            "state",
            "cel 3",
            r"^column 'state' of tie, row 5, must be one of the simulator's names; it is 'cel 3' \(did you ",
        ),
        (
            "action",
            "left",
            r"^column 'action' of tie, row 5, must be one of the simulator's names; it is 'left' \(they are ",
        ),
        ("next_state", None, r"^column 'next_state' of tie must have a name in every row; row 5 has none or nan$"),
        ("kind", "a", r"^column 'kind' of tie must have a finite number in every row; row 5 has a$"),
    ],
)
def test_bad_tables_in_python(column, value, text):
    frame = by_name(kind=KEYS).astype(object)
    frame.loc[5, column] = value
    with pytest.raises(ValueError, match=text):
        oee.transition_ratio(LOG, NAMED, tie=frame)


def test_names_of_a_simulator_that_has_none():
    with pytest.raises(ValueError, match=r"^column 'state' of features must have a finite number .*; row 0 has cell 0"):
        oee.transition_ratio(LOG, GRID, features=by_name(ahead=1.0))


# ---------------------------------------------------------------- bad files


def changed(row, column, value, **columns):
    frame = table(**(columns or {"kind": KEYS})).astype(object)
    frame.loc[row, column] = value
    return frame


def array_with(index, value):
    found = np.column_stack([KIND, NEXT]).astype(float)
    found[index] = value
    return found


BAD = {
    # what the file is
    "missing npy": ("phi.npy", None, "no such file: {file}"),
    "missing csv": ("phi.csv", None, "no such file: {file}"),
    "unknown extension": ("phi.txt", "1", "{option} must be a .npy or .csv file; got 'phi.txt'"),
    "npz": ("phi.npz", "1", "{option} must be a .npy or .csv file; got 'phi.npz'"),
    "text": ("phi.npy", "1,2,3", "'phi.npy' must be an npz or npy file of plain arrays; "),
    "pickle": ("phi.npy", np.array([{}, None] * (NNZ // 2)), "'phi.npy' must be an npz or npy file of plain arrays; "),
    "empty table": ("phi.csv", "", "'phi.csv' must be a CSV table with a header; "),
    "a longer row": (
        "phi.csv",
        "state,action,next_state,x\n0,0,3,1,1\n",
        "'phi.csv' must be a CSV table with a header",
    ),
    "bytes": ("phi.csv", b"\xff\x00x", "'phi.csv' must be a CSV table with a header, in UTF-8; "),
    # arrays
    "words": ("phi.npy", np.array(["a"] * NNZ), "'phi.npy' must hold real numbers; it holds <U1"),
    "complex": ("phi.npy", np.zeros(NNZ) * 1j, "'phi.npy' must hold real numbers; it holds complex128"),
    "another length": ("phi.npy", KEYS[1:], f"'phi.npy' must have shape ({NNZ},), in the order of the simulator's"),
    "another length, found": ("phi.npy", KEYS[1:], f"it has shape ({NNZ - 1},)"),
    "another size": ("phi.npy", np.zeros((9, 4, 8), dtype=int), "or (9, 4, 9)"),
    "another size, found": ("phi.npy", np.zeros((9, 4, 8), dtype=int), "it has shape (9, 4, 8)"),
    "five axes": ("phi.npy", np.zeros((9, 4, 9, 1, 1), dtype=int), "it has shape (9, 4, 9, 1, 1)"),
    "three axes": ("phi.npy", np.zeros((NNZ, 1, 1), dtype=int), f"it has shape ({NNZ}, 1, 1)"),
    "no features": ("phi.npy", np.zeros((NNZ, 0), dtype=int), f"it has shape ({NNZ}, 0)"),
    "a number": ("phi.npy", np.array(1), "it has shape ()"),
    # tables
    "without moves": (
        "phi.csv",
        table(x=1).drop(columns="action"),
        "'phi.csv' must have the columns state, action, next_state; it has state, next_state, x",
    ),
    "without numbers": ("phi.csv", table(), "'phi.csv' must have a column of numbers beside its moves; it has none"),
    "an index": (
        "phi.csv",
        table(x=KEYS).reset_index(names=""),
        "must have a name for every column; it has Unnamed: 0, state, action, next_state, x (a written index?)",
    ),
    "without rows": ("phi.csv", table(x=1).iloc[:0], "'phi.csv' must have at least one row; it has none"),
    "a gap": (
        "phi.csv",
        changed(3, "kind", ""),
        "column 'kind' of 'phi.csv' must have a finite number in every row; row 3 has none or nan",
    ),
    "nan": ("phi.csv", changed(5, "kind", "nan"), "row 5 has none or nan"),
    "infinite": (
        "phi.csv",
        changed(5, "kind", "-inf"),
        "column 'kind' of 'phi.csv' must have a finite number in every row; row 5 has -inf",
    ),
    "a word": (
        "phi.csv",
        changed(7, "kind", "left"),
        "column 'kind' of 'phi.csv' must have a finite number in every row; row 7 has left",
    ),
    "a state that is a word": (
        "phi.csv",
        changed(2, "state", "s1"),
        "column 'state' of 'phi.csv' must have a finite number in every row; row 2 has s1",
    ),
    "a state that is no integer": (
        "phi.csv",
        changed(2, "state", 0.5),
        "column 'state' of 'phi.csv' must have an integer in every row; row 2 has 0.5",
    ),
    "a state too many": (
        "phi.csv",
        changed(4, "next_state", 9),
        "column 'next_state' of 'phi.csv' must be in 0..8; row 4 has 9",
    ),
    "a negative state": (
        "phi.csv",
        changed(4, "state", -1),
        "column 'state' of 'phi.csv' must be in 0..8; row 4 has -1",
    ),
    "an action too many": (
        "phi.csv",
        changed(4, "action", 4),
        "column 'action' of 'phi.csv' must be in 0..3; row 4 has 4",
    ),
    "a move outside": (
        "phi.csv",
        changed(0, "next_state", 8),
        "row 0 of 'phi.csv' must be a move of the simulator, which gives probability 0 to s=0, a=0 -> s'=8\n",
    ),
    "moves outside": ("phi.csv", table(x=1).assign(next_state=8), "-> s'=8 ("),
    "a move twice": (
        "phi.csv",
        pd.concat([table(x=1), table(x=1).iloc[2:4]]),
        f"row {NNZ} of 'phi.csv' must be a move of its own; "
        f"s={STATE[2]}, a={ACTION[2]} -> s'={NEXT[2]} is row 2 already",
    ),
}

FEATURES = {
    "nan in an array": (
        "phi.npy",
        array_with((3, 1), np.nan),
        f"'phi.npy' must be finite; feature 1 at s={STATE[3]}, a={ACTION[3]} -> s'={NEXT[3]} is nan",
    ),
    "infinite in an array": (
        "phi.npy",
        dense(array_with((NNZ - 1, 0), np.inf)),
        "'phi.npy' must be finite; feature 0 at s=8, a=3 -> s'=8 is inf",
    ),
}

TIES = {
    "float keys": ("phi.npy", KEYS.astype(float), "'phi.npy' must hold integer keys; it holds float64"),
    "boolean keys": ("phi.npy", KEYS > 3, "'phi.npy' must hold integer keys; it holds bool"),
    "two keys a move": ("phi.npy", np.column_stack([KEYS, KEYS]), f"it has shape ({NNZ}, 2)"),
    "two dense keys a move": ("phi.npy", np.zeros((9, 4, 9, 2), dtype=int), "it has shape (9, 4, 9, 2)"),
    "half a key": (
        "phi.csv",
        changed(6, "kind", 1.5),
        "column 'kind' of 'phi.csv' must have an integer in every row; row 6 has 1.5",
    ),
    "a key beyond floats": (
        "phi.csv",
        changed(6, "kind", "1e16"),
        "must have an integer in every row; row 6 has 1e+16",
    ),
    "two columns": (
        "phi.csv",
        table(x=KEYS, y=KEYS),
        "'phi.csv' must have one column of keys beside state, action, next_state; it has x, y",
    ),
    "moves without a key": (
        "phi.csv",
        table(x=KEYS).iloc[2:],
        f"'phi.csv' must have a key for every transition of the simulator; 2 "
        f"of {NNZ} have none, the first: s=0, a=0 -> s'=0",
    ),
}

CALLS = [
    *((option, name) for option in ("--features", "--tie") for name in BAD),
    *(("--features", name) for name in FEATURES),
    *(("--tie", name) for name in TIES),
]


def write(file, content):
    if isinstance(content, pd.DataFrame):
        content.to_csv(file, index=False)
    elif isinstance(content, np.ndarray):
        np.save(file, content, allow_pickle=True)
    elif content is not None:
        with open(file, "wb") as handle:
            handle.write(content if isinstance(content, bytes) else content.encode())


@pytest.mark.parametrize(("option", "name"), CALLS)
def test_bad_files_are_one_line(capsys, option, name):
    file, content, text = (BAD | FEATURES | TIES)[name]
    write(file, content)
    said = run(capsys, *ASK, option, file, code=2)
    assert text.replace("{option}", option).replace("{file}", file) in said
    assert said.startswith("oee: ")
    assert said.count("\n") == 1


def test_an_npz_by_the_name_of_an_npy(capsys):
    np.savez("a.npz", keys=KEYS, more=KEYS)
    Path("a.npz").rename("a.npy")
    said = run(capsys, *ASK, "--tie", "a.npy", code=2)
    assert said == "oee: 'a.npy' must hold one array, as numpy.save writes it; it holds keys, more\n"


@pytest.mark.parametrize("option", ["--features", "--tie"])
def test_where_they_cannot_apply(capsys, option):
    np.save("keys.npy", KEYS)
    said = run(capsys, "evaluate", option, "keys.npy", code=2)
    assert said == f"oee: {option} needs --simulator and --log\n"
    words = ["evaluate", "--simulator", "cartpole:gravity=10", "--log", "log.csv", option, "keys.npy"]
    assert run(capsys, *words, code=2) == (
        f"oee: {option} must be left out for a continuous task, whose moves are not between numbered states; it is 'keys.npy'\n"
    )
