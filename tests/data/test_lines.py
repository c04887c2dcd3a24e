"""Tables line by line: each is a transition as it stands, or an error with its line,
whatever the size of the file and whoever reads it.
"""

import gzip
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from fuzz_csv import compare, counted, loaded
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.exceptions import ArgumentError

HEAD = "state,action,next_state"
PAD = " " * 90
MANY = 25_000  # padded rows that make a file larger than what Python reads by itself


def write(folder, text, name="log.csv"):
    (folder / name).parent.mkdir(exist_ok=True, parents=True)
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


@pytest.mark.parametrize("readers", [(loaded,), (counted,)])
def test_small_and_large_files_are_read_alike(tmp_path, readers):
    assert compare(3, 50, tmp_path, readers) == []


# ---- quotes


@pytest.mark.parametrize(
    "line",
    [
        '1,0,2,"6 inch',
        '1,0,2,"a\nb"',
        '1,0,2,"a"b',
        '"1,0,2,x',
        '1,0,"2,x',
        '1,0,2,""x"',
        '1,0,2,"',
        '1,0,2,"x" ',
    ],
)
@pytest.mark.parametrize("n", [3, MANY])
def test_a_quote_that_does_not_close_in_its_line(tmp_path, line, n):
    after = f"0,0,{PAD}1,ok\n" * n
    path = write(tmp_path, f"{HEAD},note\n0,0,1,ok\n{line}\n{after}")
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ValueError, match=r"row 1 \(line 3\) must close each quote"):
            read(path)
    with pytest.warns(UserWarning, match="left out: note"):
        found = Transitions.open(path, bad_rows="drop")
    assert len(found) == n + 1
    assert found.recording.dropped == 1 + line.count("\n")


@pytest.mark.parametrize("n", [1, MANY])
def test_quotes_that_close_are_read(tmp_path, n):
    rows = f'"0",{PAD}0,1,"a ""b"", c"\n0,0,1,6" inch\n' * n
    path = write(tmp_path, f'"state","action","next_state",note\n{rows}')
    with pytest.warns(UserWarning, match="left out: note"):
        assert len(Transitions.load(path)) == 2 * n


def test_quotes_of_a_table_of_a_policy(tmp_path):
    from oee_tabular.data.tables import csv_frame

    for text, words in (
        ('state,action\n0,1\n1,"0\n', r"row 1 \(line 3\) must close each quote"),
        ("state,action\n0,1\n\n1\n", r"row 1 \(line 4\) must have 2 fields"),
        ("state,action\n0,1\nstate,action\n", "holds the labels of the columns"),
        ("state,state\n0,1\n", "columns that differ"),
    ):
        with pytest.raises(ValueError, match=words):
            csv_frame(str(write(tmp_path, text)))
    frame = csv_frame(str(write(tmp_path, "state,action\nNA,e\u0301\nnull,nan\n")))
    assert frame.to_numpy().tolist() == [["NA", "é"], ["null", "nan"]]


# ---- headers


@pytest.mark.parametrize("n", [2, MANY])
def test_rows_that_are_the_labels_of_other_columns_are_no_header(tmp_path, n):
    head = "state,action,next_state,0,1\n"
    path = write(tmp_path, head + "0,1,0,7,7\n1,0,1,7,7\n" * n)
    with pytest.warns(UserWarning, match="left out: 0, 1"):
        assert len(Transitions.load(path)) == 2 * n


@pytest.mark.parametrize(
    "again",
    [
        HEAD,
        '"state","action","next_state"',
        "\ufeffstate,action,next_state",
        "State,ACTION,next state",
        "action,next_state,state",
    ],
)
@pytest.mark.parametrize("row", [f"0,{PAD}0,1", f"hall,{PAD}go,dock"])
@pytest.mark.parametrize("n", [2, MANY])
def test_a_header_in_the_middle(tmp_path, again, row, n):
    path = write(tmp_path, HEAD + f"\n{row}" * n + f"\n{again}\n{row}\n")
    with pytest.raises(
        ValueError, match=rf"row {n} \(line {n + 2}\) must hold the values"
    ):
        Transitions.load(path)
    if row[0] == "0":
        assert len(Transitions.open(path, bad_rows="drop")) == n + 1


def test_a_header_in_a_frame_and_in_parquet(tmp_path):
    frame = pd.DataFrame(
        [["hall", "go", "dock"], HEAD.split(",")], columns=HEAD.split(",")
    )
    with pytest.raises(ValueError, match="frame: row 1 must hold the values"):
        Transitions.from_frame(frame)
    frame.to_parquet(tmp_path / "log.parquet")
    with pytest.raises(ValueError, match=r"log\.parquet': row 1 must hold the values"):
        Transitions.load(tmp_path / "log.parquet")
    # a state may be called so
    named = frame.assign(action="go")
    assert "state" in Transitions.from_frame(named).state_names


@pytest.mark.parametrize(
    ("head", "again"),
    [
        (HEAD, "observation,act,newObs"),
        (HEAD, "s_t,a_t,s_tp1"),
        (HEAD, "state,acton,next_state"),
        (HEAD, "prev_state,actions,nextstate"),
        ("obs,action,next_obs", HEAD),
        (f"{HEAD},reward", "current_state,action,new_state,rew"),
    ],
)
@pytest.mark.parametrize("row", [f"0,{PAD}0,1", f"hall,go,dock{PAD}"])
@pytest.mark.parametrize("n", [2, MANY])
@pytest.mark.filterwarnings("ignore:.* has other labels than a log")
def test_a_header_in_the_middle_with_other_labels(tmp_path, head, again, row, n):
    row = row.replace(f"dock{PAD}", "dock") + ",2" * (head.count(",") - 2)
    path = write(tmp_path, head + f"\n{row}" * n + f"\n{again}\n{row}\n")
    place = (
        rf"row {n} \(line {n + 2}\) must hold the values .* give the files as a list"
    )
    with pytest.raises(ValueError, match=place):
        Transitions.load(path)
    if row[0] == "0":
        with pytest.raises(ValueError, match=place):
            Transitions.open(path)
        assert len(Transitions.open(path, bad_rows="drop")) == n + 1
    with pytest.raises(ValueError, match=rf"frame: row {n} must hold the values"):
        Transitions.from_frame(pd.read_csv(path))


@pytest.mark.parametrize("n", [2, MANY])
@pytest.mark.parametrize(
    "rows",
    [
        "s,a,s1\ns1,b,s",  # names of states in other rows as well
        "obs,action,state\nhall,go,dock",  # not those of their own columns
        "state,go,next_state\nhall,go,dock",
        "state1,action1,next_state1\nhall,go,dock",
    ],
)
def test_names_that_are_labels_as_well(tmp_path, rows, n):
    path = write(tmp_path, f"{HEAD}\n" + f"{rows}\n" * n)
    assert len(Transitions.load(path)) == 2 * n


@pytest.mark.parametrize("n", [0, 1, MANY])
@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_very_many_blank_lines(tmp_path, monkeypatch, n, ending):
    from oee_tabular.data import tables

    monkeypatch.setattr(tables, "MAX_BLANK_LINES", 300_000)
    rows = f"0,{PAD}0,1{ending}" * n
    for number, is_right in ((300_000, n > 0), (2_000_000, False)):
        blank = ending * number
        path = tmp_path / f"{number}.csv.gz"
        path.write_bytes(gzip.compress(f"{HEAD}{ending}{rows}{blank}".encode(), 1))
        for read in (Transitions.load, Transitions.open):
            if is_right:
                assert len(read(path)) == n
            elif number > 300_000:
                with pytest.raises(
                    ValueError, match=rf"from line {n + 2} on, more than 300000 lines"
                ):
                    read(path)


# ---- episodes


def partition(episodes):
    return pd.factorize(np.asarray(episodes))[0].tolist()


IDS = st.sampled_from(
    ["7", "007", "1e1", "10", "1e400", "12ab", "ab12", "-3", "+3", "0", "-0", "é", "07"]
)


@settings(max_examples=30)
@given(st.lists(IDS, min_size=1, max_size=6, unique=True))
def test_ids_are_as_many_as_their_texts(tmp_path_factory, ids):
    """In a frame, CSV, parquet, the constructor, and where they are counted."""
    folder = tmp_path_factory.mktemp("ids")
    n = len(ids)
    frame = pd.DataFrame({"state": 0, "action": 0, "next_state": 0, "episode": ids})
    frame.to_csv(folder / "a.csv", index=False)
    frame.to_parquet(folder / "a.parquet")
    logs = [
        Transitions.from_frame(frame),
        Transitions.load(folder / "a.csv"),
        Transitions.load(folder / "a.parquet"),
        Transitions([0] * n, [0] * n, [0] * n, episode=ids),
    ]
    assert [log.n_episodes for log in logs] == [n] * 4
    for name in ("a.csv", "a.parquet"):
        assert Transitions.open(folder / name).recording.episodes == n


@settings(max_examples=10)
@given(IDS, st.sampled_from([" ", "  ", "\t"]), st.booleans())
def test_blanks_around_an_id_say_nothing(tmp_path_factory, own, blank, is_before):
    path = tmp_path_factory.mktemp("ids") / "a.csv"
    ids = [own, blank + own if is_before else own + blank]
    frame = pd.DataFrame({"state": 0, "action": 0, "next_state": 0, "episode": ids})
    frame.to_csv(path, index=False)
    for log in (
        Transitions.from_frame(frame),
        Transitions.load(path),
        Transitions([0, 0], [0, 0], [0, 0], episode=ids),
    ):
        assert log.n_episodes == 1


def test_an_episode_that_begins_late_is_refused_with_a_way_on(tmp_path):
    path = write(tmp_path, f"{HEAD},episode,timestep\n0,0,1,5,2\n1,0,0,5,3\n")
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(
            ArgumentError, match=r"timestep\[0\] must be 0 .*bad_rows='drop'"
        ) as refused:
            read(path)
        assert path.name in str(refused.value)
    assert "1 episode broken" in repr(Transitions.open(path, bad_rows="drop"))


def test_ids_of_a_large_file_and_integers(tmp_path):
    rows = "0,0,0,7\n0,0,0,007\n" + f"0,0,{PAD}0,8\n" * MANY
    path = write(tmp_path, f"{HEAD},episode\n{rows}")
    assert Transitions.load(path).n_episodes == 3
    assert Transitions.open(path).recording.episodes == 3
    path = write(tmp_path, f"{HEAD},episode\n0,0,0,01\n0,0,0,02\n0,0,0,3.0\n")
    assert_array_equal(Transitions.load(path).episode, [1, 2, 3])
    path = write(tmp_path, f"{HEAD},episode\n0,0,0,1\n0,0,0,1.5\n")
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(
            ValueError, match=r"episode\[1\] must be an integer; it is 1\.5"
        ):
            read(path)


# ---- missing values


WORDS = ["", "NaN", "NA", "NULL", "\\N", "None", "null", "N/A", "#N/A", "<NA>", "NaT"]
WORDS += ["missing", " na ", "undefined", "."]


@pytest.mark.parametrize("word", WORDS)
def test_words_for_no_reward(tmp_path, word):
    frame = pd.DataFrame(
        {"state": [0, 0], "action": 0, "next_state": 0, "reward": [word, "4"]}
    )
    frame.to_parquet(tmp_path / "a.parquet")
    write(tmp_path, f"{HEAD},reward\n0,0,0,{word}\n0,0,0,4\n", "a.csv")
    more = f"0,0,{PAD}0,4\n" * MANY
    write(tmp_path, f"{HEAD},reward\n0,0,0,{word}\n{more}", "b.csv")
    assert_array_equal(Transitions.from_frame(frame).reward, [np.nan, 4])
    for name in ("a.csv", "a.parquet", "b.csv"):
        assert_array_equal(Transitions.load(tmp_path / name).reward[:2], [np.nan, 4])
        counts = Transitions.open(tmp_path / name)
        assert counts.count.sum() - counts.reward_count.sum() == 1
        assert counts.summary()["rewards_missing"] == 1


@pytest.mark.parametrize("label", ["state", "terminated", "timestep", "episode"])
@pytest.mark.parametrize("word", ["NULL", "n/a"])
@pytest.mark.parametrize("n", [2, MANY])
def test_words_for_no_value_where_there_must_be_one(tmp_path, label, word, n):
    row = dict.fromkeys([*HEAD.split(","), label], "0") | {"action": f"{PAD}0"}
    lines = [",".join(row), ",".join((row | {label: word}).values())]
    path = write(tmp_path, "\n".join([*lines, *[",".join(row.values())] * n]))
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(
            ValueError, match=rf"{label}\[0\] must have a value; it is '{word}'"
        ):
            read(path)


def test_a_state_that_is_called_like_no_value(tmp_path):
    mdp = oee.FiniteMDP([[[0, 1.0]], [[1.0, 0]]], [0, 0], 0, 0.9).with_names(
        state_names=["hall", "NA"], action_names=["null"]
    )
    path = write(tmp_path, f"{HEAD}\nhall,null,NA\nNA,null,hall\n")
    assert_array_equal(oee.Problem(mdp, path).log.state, [0, 1])
    assert_array_equal(Transitions.open(path, simulator=mdp).state, [0, 1])
    frame = pd.read_csv(path, keep_default_na=False)
    assert_array_equal(Transitions.from_frame(frame, simulator=mdp).state, [0, 1])
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ValueError, match="must"):
            read(path)


# ---- flags, numbers and names


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("-0", 0),
        ("1E0", 1),
        ("1e-400", 0),
        (" 1 ", 1),
        ("+1", 1),
        ("TRUE", 1),
        ("f", 0),
        ("0.0e5", 0),
        ("01", 1),
        ("yes", 1),
        ("No", 0),
        (" Y", 1),
        ("ja", None),
        ("2", None),
        ("0x1", None),
        ("on", None),
    ],
)
@pytest.mark.parametrize("n", [2, MANY])
def test_flags(tmp_path, text, value, n):
    after = f"0,0,{PAD}0,0\n" * n
    path = write(tmp_path, f"{HEAD},terminated\n0,0,0,{text}\n{after}")
    for read in (Transitions.load, Transitions.open):
        if value is None:
            words = r"terminated\[0\] must be a boolean \(or 0 or 1\); it is .*{}"
            with pytest.raises(ValueError, match=words.format(text)):
                read(path)
        elif read is Transitions.load:
            assert read(path).terminated[0] == value
        else:
            assert read(path).summary()["terminated"] == value


def test_decimals_and_fractions_are_numbers(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    frame = pd.DataFrame(
        {
            "state": [Decimal(0), Decimal("1.0")],
            "action": [Fraction(0), Fraction(2, 2)],
            "next_state": 1,
            "reward": [Decimal("0.25"), Decimal("NaN")],
            "terminated": [Decimal(1), Fraction(0)],
        }
    )
    log = Transitions.from_frame(frame)
    assert_array_equal(log.reward, [0.25, np.nan])
    assert log.action.tolist() == [0, 1]
    assert log.terminated.tolist() == [True, False]
    with pytest.raises(ValueError, match=r"state\[1\] must be an integer; it is"):
        Transitions.from_frame(frame.assign(state=[Decimal(0), Decimal("0.5")]))
    amounts = arrow.array([Decimal("0.25"), None], arrow.decimal128(9, 3))
    numbers = arrow.array([Decimal(0), Decimal(1)], arrow.decimal128(9, 0))
    table = arrow.table(
        {"state": numbers, "action": [0, 0], "next_state": numbers, "reward": amounts}
    )
    parquet.write_table(table, tmp_path / "a.parquet")
    for log in (
        Transitions.from_frame(table),
        Transitions.load(tmp_path / "a.parquet"),
    ):
        assert log.state.tolist() == [0, 1]
        assert_array_equal(log.reward, [0.25, np.nan])


def test_letters_in_two_forms_are_one_name(tmp_path):
    one, two = "caf\u00e9", "cafe\u0301"
    log = Transitions([one, two], ["go", "go"], [two, one])
    assert log.state_names == (one,)
    assert log.state.tolist() == [0, 0]
    mdp = oee.FiniteMDP([[[1.0, 0]], [[1.0, 0]]], [0, 0], 0, 0.9)
    with pytest.raises(ValueError, match="state_names must differ"):
        mdp.with_names(state_names=[one, two])
    for name, written in ((one, two), (two, one)):
        named = mdp.with_names(state_names=[name, ("hall", name)])
        path = write(tmp_path, f"{HEAD}\n{written},0,{written}\n")
        assert oee.Problem(named, path).log.state.tolist() == [0]
        assert Transitions.open(path, simulator=named).state.tolist() == [0]
        assert oee.policy_value(named, {written: 0, ("hall", written): 0}) == 0


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            ["0,0,hall", "0,0,dock"],
            r"next_state\[0\] must be a number, as those of state",
        ),
        (
            ["hall,0,0", "dock,0,1"],
            r"state\[0\] must be a number, as those of next_state",
        ),
        (
            ["0,0,1", "0,0,1", "x,0,1"],
            r"state\[2\] must be an integer; it is 'x' \(2 of",
        ),
        (["a,0,a", "b,0,a", "7,0,a"], r"state\[2\] must be a name, .*; it is 7"),
        (["7,0,a", "b,0,a", "a,0,a"], r"state\[0\] must be a name, .*; it is 7"),
    ],
)
def test_names_beside_numbers(tmp_path, rows, words):
    path = write(tmp_path, "\n".join([HEAD, *rows]))
    with pytest.raises(ValueError, match=rf"log\.csv': {words}"):
        Transitions.load(path)
    frame = pd.read_csv(path, dtype=str)
    with pytest.raises(ValueError, match=rf"frame: {words}"):
        Transitions.from_frame(frame)


# ---- compressed files and columns of other programs


def test_a_compressed_file_is_as_large_as_what_is_in_it(tmp_path, monkeypatch):
    """It goes to pandas, which the fields of no line tell."""
    text = f"{HEAD}\n" + f"0,0,{PAD}1\n" * MANY
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(text.encode()))
    calls = []
    from oee_tabular.data import tables

    read = tables._read_lines
    monkeypatch.setattr(
        tables, "_read_lines", lambda *given: calls.append(given) or read(*given)
    )
    assert len(Transitions.load(tmp_path / "a.csv.gz")) == MANY
    assert calls == []


@pytest.mark.parametrize(
    "name", ["file_row_number", "FILE_ROW_NUMBER", "filename", "file_index", "rowid"]
)
def test_columns_that_are_called_like_duckdbs_own(tmp_path, monkeypatch, name):
    monkeypatch.setattr("oee_tabular.data.tables.N_PARQUET_ROWS", 2)
    frame = pd.DataFrame(
        {"state": [0, 1, 2, 0, 1], "action": 0, "next_state": [1, 2, 3, 1, 2], name: 7}
    ).assign(episode=[0, 0, 0, 1, 1])
    frame.to_parquet(tmp_path / "a.parquet")
    for read in (Transitions.load, Transitions.open):
        with pytest.warns(UserWarning, match=f"left out: {name}"):
            found = read(tmp_path / "a.parquet")
        assert len(found) == 5
