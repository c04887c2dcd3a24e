"""``oee evaluate --features FILE --tie FILE``: what a user's own files do, and what is
said of bad ones.
"""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular.cli.inputs import read_entries
from oee_tabular.mdp import displacements

GRID = oee.tasks.gridworld(3, 0.3)
NAMED = GRID.with_names([f"cell {s}" for s in range(9)], [("go", a) for a in range(4)])
LOG = oee.sample_transitions(
    oee.tasks.gridworld(3, 0.1), np.full((9, 4), 1 / 36), 200, seed=0
)
ROW = np.repeat(np.arange(36), np.diff(GRID.transitions.indptr))
STATE = ROW // 4
ACTION = ROW % 4
NEXT = GRID.transitions.indices
KIND = displacements(GRID)[1]
KEYS = 10 * ACTION + KIND
NNZ = GRID.transitions.nnz
POLICY = oee.tasks.gridworld_policy(3, 0.8)
ASK = "evaluate --simulator gridworld:3,slip=0.3 --log log.csv --policy mix:0.8"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    LOG.save("log.csv")


def table(**columns):
    return pd.DataFrame(
        {"state": STATE, "action": ACTION, "next_state": NEXT} | columns
    )


def by_name(**columns):
    called = {
        label: [f"cell {s}" for s in values]
        for label, values in (("state", STATE), ("next_state", NEXT))
    }
    return table(**columns).assign(
        **called, action=[str(("go", int(a))) for a in ACTION]
    )


def dense(values, elsewhere=np.nan):
    """(S, A, S, ...) of values on the entries."""
    found = np.full(
        (9, 4, 9, *np.shape(values)[1:]),
        elsewhere,
        dtype=np.result_type(values, elsewhere),
    )
    found[STATE, ACTION, NEXT] = values
    return found


def read(option, file, simulator=GRID):
    """What the file of an option holds, and its description."""
    return read_entries(Path(file), option, simulator)


FILES = {"features": np.column_stack([KIND == 1, NEXT]).astype(float), "tie": KEYS}
OPTIONS = {
    "features": {"prior": "tilt", "features": FILES["features"]},
    "tie": {"tie": KEYS},
}


@pytest.mark.parametrize(
    ("kind", "name"), [("features", "oee-features"), ("tie", "oee-tied")]
)
def test_a_file_adds_a_row_with_its_interval_and_leaves_the_others(run, kind, name):
    np.save("own.npy", FILES[kind])
    plain, more = (
        json.loads(run(ASK, words, "--json"))
        for words in ("", f"--{kind} own.npy --report page.html")
    )
    assert [row["estimator"] for row in more["results"]] == [
        "simulator",
        "oee",
        "model-based",
        name,
    ]
    for one, two in zip(plain["results"], more["results"], strict=False):
        assert one | {"notes": 0} == two | {"notes": 0}
    assert set(plain["warnings"]) <= set(more["warnings"])
    problem = oee.Problem(GRID, oee.Transitions.load("log.csv"))
    row = more["results"][-1]
    expected = oee.estimators.OffEnvironment(
        partial(oee.transition_ratio, **OPTIONS[kind])
    )(problem, POLICY)
    assert expected.value in (row["value"], row.get("replaced_value"))
    interval = oee.interval(problem, POLICY, **{kind: FILES[kind]})
    assert (row["lower"], row["upper"], row["interval_method"]) == (
        interval.lower,
        interval.upper,
        interval.method,
    )
    assert more["facts"][kind].startswith("own.npy (")
    assert "own.npy (" in Path("page.html").read_text()


def test_one_of_them_beside_the_estimators_that_were_asked_for(run):
    table(kind=KEYS).to_csv("keys.csv", index=False)
    np.save("phi.npy", FILES["features"])
    words = (
        "--estimators model-based,oracle --target gridworld:3,slip=0.1 --tie keys.csv"
    )
    found = json.loads(run(ASK, words, "--json"))
    assert [row["estimator"] for row in found["results"]] == [
        "model-based",
        "oracle",
        "oee-tied",
    ]
    assert not any("left out" in text for text in found["warnings"])
    assert "tie and features must not be given together" in run(
        ASK, words, "--features phi.npy", code=2
    )


def test_the_simulator_is_the_one_with_action_noise(run):
    noisy = GRID.with_action_noise(0.1)
    np.save("keys.npy", np.arange(noisy.transitions.nnz))
    np.save("other.npy", np.arange(oee.tasks.gridworld(3, 0.0).transitions.nnz))
    words = (
        "evaluate --simulator gridworld:3,slip=0.0 --log log.csv --action-noise 0.1"
        " --quick --json --tie"
    )
    assert f"keys.npy ({noisy.transitions.nnz} keys)" in run(words, "keys.npy")
    assert f"must have shape ({noisy.transitions.nnz},)" in run(
        words, "other.npy", code=2
    )


def test_forms_of_features():
    one = (KIND == 1).astype(float)
    two = np.column_stack([KIND == 1, NEXT])
    for given, expected in (
        (one, one[:, None]),
        (dense(one), one[:, None]),
        (two, two),
        (dense(two), two),
    ):
        np.save("phi.npy", given)
        Path("phi.npy").rename("PHI.NPY")
        values, names = read("features", "PHI.NPY")
        assert_array_equal(values, expected)
        assert names == ", ".join(f"feature {k}" for k in range(expected.shape[1]))
    some = table(ahead=(KIND == 1) * 2.5, empty=0, late=NEXT > 4).sample(
        frac=1, random_state=0
    )
    some = some[(some["ahead"] > 0) | some["late"]]  # what is left out is 0
    some[["late", "next_state", "ahead", "action", "empty", "state"]].to_csv(
        "PHI.CSV", index=False
    )
    values, names = read("features", "PHI.CSV")
    assert names == "late, ahead, empty"
    assert_array_equal(
        values, np.column_stack([NEXT > 4, (KIND == 1) * 2.5, np.zeros(NNZ)])
    )


def test_forms_of_keys():
    shuffled = table(kind=KEYS - 7).iloc[::-1]
    shuffled.to_csv("keys.csv", index=False)
    shuffled.astype({"kind": float}).to_csv("decimal.csv", index=False)
    np.save("keys.npy", KEYS - 7)
    np.save("dense.npy", dense(KEYS - 7, elsewhere=0))
    for name in ("keys.csv", "decimal.csv", "keys.npy", "dense.npy"):
        assert_array_equal(
            read("tie", name)[0], np.unique(KEYS, return_inverse=True)[1]
        )
    # as floats they would be one
    table(kind=2**62 + np.arange(NNZ)).to_csv("keys.csv", index=False)
    assert_array_equal(read("tie", "keys.csv")[0], np.arange(NNZ))


@pytest.mark.parametrize(
    ("kind", "name"), [("features", "oee-features"), ("tie", "oee-tied")]
)
def test_states_and_actions_by_name(run, kind, name):
    NAMED.save("named.npz")
    column = {"features": KIND == 1, "tie": KEYS}[kind]
    by_name(x=column).iloc[::-1].to_csv("names.csv", index=False)
    table(x=column).to_csv("numbers.csv", index=False)
    assert_array_equal(
        read(kind, "names.csv", NAMED)[0], read(kind, "numbers.csv", NAMED)[0]
    )
    found = json.loads(
        run(
            "evaluate --simulator named.npz --log log.csv --json", f"--{kind} names.csv"
        )
    )
    assert found["results"][-1]["estimator"] == name


def test_python_takes_the_same_tables():
    named = by_name(ahead=KIND == 1)
    tuples = named.assign(action=[("go", int(a)) for a in ACTION])
    ratios = [
        oee.transition_ratio(LOG, NAMED, features=given).values.data
        for given in (
            (KIND == 1).astype(float),
            tuples,
            named,
            table(ahead=KIND == 1),
            pa.Table.from_pandas(named),
        )
    ]
    for ratio in ratios[1:]:
        assert_array_equal(ratio, ratios[0])
    tied = oee.transition_ratio(LOG, NAMED, tie=by_name(kind=KEYS)).values.data
    assert_array_equal(tied, oee.transition_ratio(LOG, NAMED, tie=KEYS).values.data)


def changed(row, column, value):
    frame = table(kind=KEYS).astype(object)
    frame.loc[row, column] = value
    return frame


NUMBER = "of {name} must have a finite number in every row; row"
TWICE = (
    f"row {NNZ} of {{name}} must be another transition; s={STATE[2]}, a={ACTION[2]} ->"
    f" s'={NEXT[2]} is row 2"
)
BOTH = [
    ("f.npy", None, "no such file: f.npy"),
    ("f.txt", "1", "must be a .npy or .csv file; got 'f.txt'"),
    ("f.npy", "1,2,3", "'f.npy' must be an npz or npy file of plain arrays; "),
    (
        "f.npy",
        np.array([{}, None] * (NNZ // 2)),
        "'f.npy' must be an npz or npy file of plain arrays; ",
    ),
    ("f.csv", "", "'f.csv' must be a CSV table with a header; "),
    ("f.npy", np.zeros(NNZ) * 1j, "{name} must"),
    ("f.npy", KEYS[1:], f" shape ({NNZ - 1},)"),
    ("f.npy", np.zeros((9, 4, 9, 1, 1), dtype=int), " shape (9, 4, 9, 1, 1)"),
    ("f.npy", np.array(1), " shape ()"),
    (
        "f.csv",
        table(x=1).drop(columns="action"),
        "{name} must have the columns state, action, next_state; it has state,",
    ),
    (
        "f.csv",
        table(),
        "{name} must have a column of numbers beside its transitions; it has none",
    ),
    (
        "f.csv",
        table(x=KEYS).reset_index(names=""),
        "must have a name for every column; it has Unnamed: 0, state, action,",
    ),
    ("f.csv", table(x=1).iloc[:0], "{name} must have at least one row; it has none"),
    ("f.csv", changed(3, "kind", ""), f"column 'kind' {NUMBER} 3 has none or nan"),
    ("f.csv", changed(2, "state", "s1"), f"column 'state' {NUMBER} 2 has s1"),
    (
        "f.csv",
        changed(2, "state", 0.5),
        "column 'state' of {name} must have an integer in every row; row 2 has 0.5",
    ),
    (
        "f.csv",
        changed(4, "next_state", 9),
        "column 'next_state' of {name} must be in 0..8; row 4 has 9",
    ),
    (
        "f.csv",
        changed(4, "action", 4),
        "column 'action' of {name} must be in 0..3; row 4 has 4",
    ),
    (
        "f.csv",
        changed(0, "next_state", 8),
        (
            "a transition of the simulator, which gives probability 0 to s=0, a=0 ->"
            " s'=8\n"
        ),
    ),
    ("f.csv", pd.concat([table(x=1), table(x=1).iloc[2:4]]), TWICE),
]
nan = FILES["features"].copy()
inf = FILES["features"].copy()
nan[3, 1] = np.nan
inf[-1, 0] = np.inf
FEATURES = [
    (
        "f.npy",
        nan,
        (
            f"features must be finite; feature 1 at s={STATE[3]}, a={ACTION[3]} ->"
            f" s'={NEXT[3]} is nan"
        ),
    ),
    (
        "f.npy",
        dense(inf),
        "features must be finite; feature 0 at s=8, a=3 -> s'=8 is inf",
    ),
]
TIES = [
    ("f.npy", KEYS.astype(float), "tie must have integer keys; they are float64"),
    ("f.npy", np.column_stack([KEYS, KEYS]), f" shape ({NNZ}, 2)"),
    (
        "f.csv",
        changed(6, "kind", 1.5),
        "column 'kind' of {name} must have an integer in every row; row 6 has 1.5",
    ),
    (
        "f.csv",
        table(x=KEYS, y=KEYS),
        (
            "tie must have one column of keys beside state, action, next_state; it has"
            " x, y"
        ),
    ),
    (
        "f.csv",
        table(x=KEYS).iloc[2:],
        (
            f"a key for every transition of the simulator; 2 of {NNZ} have none, the"
            " first: s=0,"
        ),
    ),
]
CASES = [("features", *case) for case in BOTH + FEATURES] + [
    ("tie", *case) for case in BOTH + TIES
]


@pytest.mark.parametrize(("option", "file", "content", "text"), CASES)
def test_bad_files_are_one_line(run, option, file, content, text):
    if isinstance(content, pd.DataFrame):
        content.to_csv(file, index=False)
    elif isinstance(content, np.ndarray):
        np.save(file, content, allow_pickle=True)
    elif content is not None:
        Path(file).write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
    said = run(ASK, f"--{option} {file}", code=2)
    assert text.replace("{name}", option) in said
    assert file in said


def test_where_they_cannot_apply(run):
    np.savez("a.npz", keys=KEYS, more=KEYS)
    Path("a.npz").rename("a.npy")
    said = run(ASK, "--tie a.npy", code=2)
    assert (
        said
        == "oee: 'a.npy' must hold one array, as numpy.save writes it; it holds keys,"
        " more\n"
    )
    said = run(
        "evaluate --simulator cartpole:gravity=10 --log log.csv --tie a.npy", code=2
    )
    assert (
        said
        == "oee: --tie must be left out for a continuous task, whose states have no"
        " numbers; it is a.npy\n"
    )
