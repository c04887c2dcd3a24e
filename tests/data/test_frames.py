"""Logs as people have them: names, data frames of several libraries, episodes as lists
of steps, and files of all these.
"""

import pickle
import re
import tempfile
import warnings
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from helpers import ACTIONS, STATES
from helpers import NAMED as MDP
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.exceptions import ArgumentError, DataWarning

NUMBERS = replace(
    oee.sample_episodes(MDP, oee.uniform_policy(MDP), 6, 8, seed=0),
    behavior_probability=None,
)


def called(numbers, names):
    return [names[k] for k in numbers]


def frame():
    columns = dict(NUMBERS.columns())
    columns |= {
        "state": called(NUMBERS.state, STATES),
        "next_state": called(NUMBERS.next_state, STATES),
    }
    return pd.DataFrame(columns | {"action": called(NUMBERS.action, ACTIONS)})


NAMED = Transitions(
    **{name: frame()[name].tolist() for name in ("state", "action", "next_state")},
    reward=NUMBERS.reward,
    episode=NUMBERS.episode,
    terminated=NUMBERS.terminated,
)


def assert_same(one, other):
    assert (one.state_names, one.action_names) == (
        other.state_names,
        other.action_names,
    )
    assert sorted(one.columns()) == sorted(other.columns())
    for name, column in other.columns().items():
        assert_array_equal(one.columns()[name], column, err_msg=name)


# ---------------------------------------------------------------- names


def test_names_are_numbered_in_their_order_and_matched_to_a_simulator_s():
    log = Transitions(["b", "a", "c"], ["x", "y", "x"], ["a", "c", "b"])
    assert (log.state_names, log.action_names) == (("b", "a", "c"), ("x", "y"))
    assert (log.state.tolist(), log.next_state.tolist()) == ([0, 1, 2], [1, 2, 0])
    assert_same(NAMED.numbered(MDP), NUMBERS)
    assert NUMBERS.numbered(MDP) is NUMBERS
    half = Transitions([0, 1], ["stay", "go"], [0, 2])
    assert (half.state_names, half.numbered(MDP).action.tolist()) == (None, [1, 0])
    # texts that are written tuples
    half = Transitions(["hall", "('room', 1)"], [1, 0], ["('room', 1)", "dock"])
    assert (half.action_names, half.numbered(MDP).next_state.tolist()) == (None, [1, 2])


@pytest.mark.parametrize(
    "make",
    [
        np.array,
        pd.Series,
        tuple,
        list,
        lambda x: np.array(x, dtype=object),
        pd.Categorical,
    ],
)
def test_whatever_holds_them(make):
    log = Transitions(make(["a", "b"]), make(["x", "x"]), make(["b", "b"]))
    assert (log.state_names, log.action.tolist()) == (("a", "b"), [0, 0])
    assert all(type(name) is str for name in log.state_names)
    assert Transitions([(0, 1), (1, 1)], [0, 0], [(1, 1), (0, 1)]).state_names == (
        (0, 1),
        (1, 1),
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda log: log.select(np.arange(len(log))),
        lambda log: log.first(5),
        lambda log: log.draw(7, seed=1),
        lambda log: Transitions.concatenate([log.first(9), log]),
        lambda log: replace(log, reward=None),
        lambda log: pickle.loads(pickle.dumps(log)),
    ],
)
def test_names_follow_the_rows(change):
    assert_same(change(NAMED).numbered(MDP), change(NUMBERS))
    given = Transitions(
        NAMED.state, NAMED.action, NAMED.next_state, state_names=NAMED.state_names
    )
    assert (
        given.numbered(MDP.with_names(STATES)).state.tolist() == NUMBERS.state.tolist()
    )


@pytest.mark.parametrize("ending", ["npz", "csv", "parquet"])
def test_files_hold_them(ending, tmp_path):
    NAMED.save(tmp_path / f"log.{ending}")
    assert_same(Transitions.load(tmp_path / f"log.{ending}").numbered(MDP), NUMBERS)
    if ending == "npz":
        assert_same(Transitions.load(tmp_path / "log.npz"), NAMED)


def test_the_command_takes_files_of_names(tmp_path, capsys):
    from oee_tabular.cli import main

    MDP.save(tmp_path / "m.npz")
    NAMED.save(tmp_path / "log.csv")
    NUMBERS.save(tmp_path / "n.csv")
    told = []
    for log in ("log.csv", "n.csv"):
        words = [
            "--simulator",
            str(tmp_path / "m.npz"),
            "--log",
            str(tmp_path / log),
            "--policy",
            "uniform",
        ]
        with pytest.raises(SystemExit) as ended:
            main(["evaluate", *words])
        assert not ended.value.code
        # without the names of the files
        told.append(capsys.readouterr().out.partition("Made from")[0])
    assert told[0] == told[1]
    assert "record action " in " ".join(told[0].split()).lower()


def test_numbers_of_a_log_s_own_are_no_simulator_s():
    """Counted as they stand, they would be taken for another's."""
    for options in ({}, {"method": "ratio_of_ratios"}):
        data = [{"simulator_data": log} if options else {} for log in (NAMED, NUMBERS)]
        one, other = (
            oee.transition_ratio(log, MDP, **options, **more)
            for log, more in zip((NAMED, NUMBERS), data, strict=True)
        )
        assert_array_equal(one.values.data, other.values.data)
    problems = [
        oee.Problem(MDP, log, simulator_data=log, episodes=log)
        for log in (NAMED, NUMBERS)
    ]
    for part in ("log", "episodes", "simulator_data"):
        assert_same(*(getattr(problem, part) for problem in problems))


def test_it_says_that_it_has_names():
    assert "; 3 named states, 2 named actions; rewards" in repr(NAMED)
    assert "; 2 named states, actions 0..1;" in repr(
        Transitions(["a"], [1], ["b"], [0.0])
    )


# ---------------------------------------------------------------- frames


def arrow(table):
    columns = {name: table[name].tolist() for name in table.columns}
    return pa.table(
        {
            name: [str(x) for x in column] if isinstance(column[0], str) else column
            for name, column in columns.items()
        }
    )


def polars(table):
    return pytest.importorskip("polars").DataFrame(
        {name: table[name].tolist() for name in table.columns}
    )


@pytest.mark.parametrize(
    "kind", [lambda table: table, arrow, polars, lambda table: polars(table).lazy()]
)
def test_frames_of_any_library(kind):
    plain = pd.DataFrame(NUMBERS.columns())
    for table in (plain, plain.astype({"episode": str})):
        assert_same(Transitions.from_frame(kind(table)), NUMBERS)
    with pytest.warns(DataWarning, match="columns of the frame .* left out: note$"):
        assert_same(Transitions.from_frame(kind(plain.assign(note="x"))), NUMBERS)
    texts = frame().assign(
        state=frame()["state"].map(str), next_state=frame()["next_state"].map(str)
    )
    assert_same(Transitions.from_frame(kind(texts), simulator=MDP), NUMBERS)
    assert_same(oee.Problem(MDP, kind(texts)).log, NUMBERS)


def test_columns_of_objects_and_of_texts_are_numbers():
    expected = Transitions([0, 3], [0, 0], [3, 0], [0.5, np.nan])
    for kind, state in (
        (object, [np.int64(0), 3]),
        (str, ["0", "3"]),
        ("Int64", [0, 3]),
        (float, [0.0, 3.0]),
    ):
        table = pd.DataFrame(
            {"state": pd.Series(state, dtype=kind), "action": 0, "next_state": [3, 0]}
        )
        assert_same(
            Transitions.from_frame(
                table.assign(reward=pd.array([0.5, None], dtype="Float64"))
            ),
            expected,
        )
    with pytest.raises(
        ValueError,
        match=(
            r"^frame: state\[0\] must be an integer; it is '2020-01-01.* \(2 such rows"
            r" in all\)"
        ),
    ):
        Transitions.from_frame(table.assign(state=pd.Timestamp("2020-01-01")))


def test_an_index_is_ignored():
    shuffled = frame().set_index(pd.Index(np.arange(len(NUMBERS))[::-1]))
    assert_same(Transitions.from_frame(shuffled, simulator=MDP), NUMBERS)
    assert_same(Transitions.from_frame(shuffled), NAMED)


def test_columns_by_their_names_there():
    table = frame().rename(
        columns={
            "state": "from",
            "next_state": "to",
            "reward": "paid",
            "episode": "run",
        }
    )
    renamed = {"state": "from", "next_state": "to", "reward": "paid", "episode": "run"}
    assert_same(Transitions.from_frame(table, simulator=MDP, **renamed), NUMBERS)
    swapped = frame().rename(columns={"state": "next_state", "next_state": "state"})
    assert_same(
        Transitions.from_frame(
            swapped, simulator=MDP, state="next_state", next_state="state"
        ),
        NUMBERS,
    )
    nothing = Transitions.from_frame(frame(), simulator=MDP, reward=None)
    assert_array_equal(nothing.reward, NUMBERS.reward)


def test_several_columns_make_tuples():
    table = pd.DataFrame(
        {"x": [0, 0], "y": ["a", "b"], "u": [0, 1], "v": ["b", "b"], "action": [0, 0]}
    )
    log = Transitions.from_frame(table, state=["x", "y"], next_state=("u", "v"))
    assert log.state_names == ((0, "a"), (0, "b"), (1, "b"))
    assert log.next_state.tolist() == [1, 2]
    grid = oee.tasks.gridworld(2, 0.1).with_names(
        [(r, c) for r in range(2) for c in range(2)]
    )
    cells = pd.DataFrame(
        {"r": [0.0, 1.0], "c": [0, 1], "r2": [0, 1], "c2": [1, 1], "action": [0, 0]}
    )
    log = Transitions.from_frame(
        cells, simulator=grid, state=["r", "c"], next_state=["r2", "c2"]
    )
    assert log.state.tolist() == [0, 3]  # 0.0 is 0


def test_labels_of_others_are_read_with_one_note_and_no_other_is_named():
    table = (
        frame()
        .rename(columns={"reward": "rewards", "terminated": "Terminated"})
        .assign(note="x")
    )
    with pytest.warns(DataWarning) as told:
        assert_same(Transitions.from_frame(table, simulator=MDP), NUMBERS)
    read, left = (str(each.message) for each in told)
    assert "reads 'rewards' as reward, 'Terminated' as terminated " in read
    assert left.endswith("left out: note")


def test_columns_that_a_frame_alone_has_are_named_as_those_of_a_file():
    """Levels of its index too; columns that were left out on purpose are not."""
    table = frame().assign(isdone=0, weight=2).set_index("weight")
    with pytest.warns(DataWarning) as told:
        assert_same(Transitions.from_frame(table, simulator=MDP), NUMBERS)
    assert [str(each.message) for each in told] == [
        "columns of the frame that a log does not use are left out: isdone, weight"
    ]
    with pytest.warns(DataWarning, match="left out: a, .*, and 2 more$"):
        Transitions.from_frame(
            frame().assign(**dict.fromkeys("abcdefghijkl", 0)), simulator=MDP
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Transitions.from_frame(frame(), simulator=MDP, columns={"reward": None})


# ---------------------------------------------------------------- lists of steps


def steps():
    starts = NUMBERS.episode_starts
    return [
        [
            *(
                (
                    STATES[NUMBERS.state[k]],
                    ACTIONS[NUMBERS.action[k]],
                    NUMBERS.reward[k],
                )
                for k in range(low, high)
            ),
            (STATES[NUMBERS.next_state[high - 1]], bool(NUMBERS.terminated[high - 1])),
        ]
        for low, high in zip(starts[:-1], starts[1:], strict=True)
    ]


def test_episodes_as_lists_of_steps():
    assert_same(Transitions.from_episodes(steps(), simulator=MDP), NUMBERS)
    assert_same(oee.Problem(MDP, steps()).log, NUMBERS)
    assert_same(Transitions.from_episodes(steps()), NAMED)


def test_forms_of_a_step():
    expected = Transitions(
        [0, 1, 0],
        [1, 0, 1],
        [1, 2, 2],
        [1.0, 2.0, 3.0],
        episode=[0, 0, 1],
        terminated=[0, 1, 0],
    )
    for first in (
        [(0, 1, 1.0), (1, 0, 2.0), (2, True)],
        [(0, 1, 1.0), [1, 0, 2.0, 2, True]],
        [(0, 1, 1.0, 1), (1, 0, 2.0), (2, np.True_)],
        [(0, 1, 1.0, 1, False), (1, 0, 2.0, 2, True)],
    ):
        for second in (
            [(0, 1, 3.0), (2,)],
            [(0, 1, 3.0, 2)],
            ((0, 1, 3.0), (2, False)),
        ):
            assert_same(Transitions.from_episodes([first, second]), expected)


def test_a_last_transition_without_a_next_state_is_left_out_with_a_warning():
    with pytest.warns(
        UserWarning, match=r"^the last transitions of 2 episodes are left out"
    ):
        log = Transitions.from_episodes(
            [[(0, 0, 1.0), (1, 0, 2.0)], [(3, 0, 1.0)], [], [(2, 0, 5.0), (1,)]]
        )
    assert_array_equal(log.state, [0, 2])
    assert_array_equal(log.reward, [1.0, 5.0])
    assert log.truncated.all()


def test_files_of_a_pattern_warn_once_and_missing_rewards_are_described(tmp_path):
    for k, rewards in enumerate(([-2.0, -0.0], [np.nan, -1.0])):
        table = pd.DataFrame(
            {
                "state": [0, 1],
                "action": [0, 0],
                "next_state": [1, 0],
                "reward": rewards,
                "speed": [1, 2],
            }
        )
        table.to_csv(tmp_path / f"{k}.csv", index=False)
    with pytest.warns(UserWarning, match="left out: speed$") as told:
        log = Transitions.load(tmp_path)
    assert len(told) == 1
    with pytest.warns(UserWarning, match="left out: speed$"):
        counts = Transitions.open(tmp_path)
    assert all(
        "rewards -2 to 0, 1 of 4 missing" in each.describe() for each in (log, counts)
    )


KINDS = {  # of a column's values; a place among them is drawn for the last
    "numbers": lambda k: k,
    "floats": lambda k: k.astype(float),
    "texts of numbers": lambda k: k.astype(str).astype(object),
    "names": lambda k: np.array(list("abcd"), dtype=object)[k],
    "booleans": lambda k: k > 1,
    "booleans and nothing": lambda k: np.array(
        [*(k[1:] > 1).tolist(), None], dtype=object
    ),
    "a half": lambda k: np.append(k[1:] + 0.0, 0.5),
    "nothing": lambda k: np.append(k[1:] + 0.0, np.nan),
    "a name that is nothing": lambda k: np.array(
        [*"abcd"[: len(k) - 1], None], dtype=object
    ),
    "too large": lambda k: np.append(k[1:], 2**60),
}


def kinds_of(label):
    """Kinds that a column may have; True and False of a CSV's episodes are names."""
    return [kind for kind in KINDS if label != "episode" or "booleans" not in kind]


@settings(max_examples=25)
@given(st.data())
def test_a_table_is_the_same_log_in_every_form_or_is_refused_in_all(data):
    """The values, and of bad ones the column, the row, the rule and what was found."""
    n = data.draw(st.integers(1, 5))
    numbers = st.lists(st.integers(0, 3), min_size=n, max_size=n).map(np.array)
    drawn = {
        label: KINDS[data.draw(st.sampled_from(kinds_of(label)), label)](
            data.draw(numbers)
        )
        for label in (
            "state",
            "action",
            "next_state",
            *data.draw(st.sampled_from([(), ("reward",), ("episode",)])),
        )
    }
    frame = pd.DataFrame(drawn)
    with tempfile.TemporaryDirectory() as folder:
        csv = f"{folder}/log.csv"
        parquet = f"{folder}/log.parquet"
        frame.to_csv(csv, index=False)
        frame.to_parquet(parquet, index=False)
        ways = (
            (Transitions.from_frame, frame),
            (Transitions.load, csv),
            (Transitions.load, parquet),
        )
        assert len({str(outcome(make, source)) for make, source in ways}) == 1


def outcome(make, source):
    """A log's columns, or the words of its error without the file and its remedy."""
    try:
        log = make(source)
    except ValueError as error:
        words = re.sub(r"^(frame|'[^']*'): ", "", str(error))
        return re.sub(
            r" \((make sure first [^;]*; )?to leave such rows out [^)]*\), [^)]*\)",
            "",
            words,
        )
    return {label: str(column.tolist()) for label, column in log.columns().items()}


MOVE = {"state": [0, 0], "action": [0, 1], "next_state": [0, 1]}
ODD = {
    "dates": pd.to_datetime(["2020-01-01", None]),
    "dates of a zone": pd.to_datetime(["2020-01-01", None], utc=True),
    "durations": pd.to_timedelta([1, None], unit="s"),
    "months": pd.PeriodIndex(["2020-01", None], freq="M"),
    "bytes": np.array([b"x", None], dtype=object),
    "complex": [1j, None],
    "intervals": pd.interval_range(0, 2),
}


@pytest.mark.parametrize("column", [*MOVE, "reward", "terminated", "timestep"])
@pytest.mark.parametrize("kind", ODD)
def test_values_of_other_types_are_refused_with_their_column(kind, column):
    frame = pd.DataFrame(MOVE | {column: ODD[kind]})
    with pytest.raises(ArgumentError, match=rf"^frame: {column}(\[\d\])? must"):
        Transitions.from_frame(frame)


@pytest.mark.parametrize("kind", ["dates", "durations"])
def test_an_episode_needs_an_id(kind):
    with pytest.raises(ArgumentError, match=r"^frame: episode\[1\] must have a value"):
        Transitions.from_frame(pd.DataFrame(MOVE | {"episode": ODD[kind]}))


def test_the_reason_of_a_frame_that_cannot_be_read_is_one_line():
    polars = pytest.importorskip("polars")
    lazy = polars.LazyFrame(MOVE | {"text": ["a", "b"]})
    odd = (
        lazy.select("nope"),
        lazy.with_columns(polars.col("text").cast(polars.Int64)),
        lazy.rename({"text": "state"}),
        lazy.filter(polars.col("other") > 1),
    )
    for frame in odd:
        with pytest.raises(
            ArgumentError, match=r"^frame must be a lazy .* raises \w+: "
        ) as (refused):
            Transitions.from_frame(frame)
        assert "\n" not in str(refused.value)

    class DataFrame:
        """A frame of a library that nobody knows."""

        def toPandas(self):
            return pd.DataFrame(MOVE)

    with pytest.raises(ArgumentError, match=r"read yet: frame\.toPandas\(\)\)"):
        Transitions.from_frame(DataFrame())


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", [np.float16, np.float32, np.longdouble])
def test_numbers_of_any_precision_are_judged_without_a_warning(kind):
    values = np.array([1, 3], dtype=kind)
    assert Transitions(values, [0, 1], [0, 1]).state.tolist() == [1, 3]
    for odd, rule in ((0.5, "an integer"), (np.inf, "an integer"), (-1, "at least 0")):
        values = np.array([1, odd], dtype=kind)
        with pytest.raises(ArgumentError, match=rf"^state\[1\] must be {rule}"):
            Transitions(values, [0, 1], [0, 1])


@pytest.mark.parametrize(
    ("value", "rule"),
    [
        (2.0**53, r"an integer of 64 bits, or below 2\*\*53, from where"),
        (2.0**60, r"an integer of 64 bits, or below 2\*\*53, from where"),
        (2.0**63, r"below 2\*\*63"),
        (1e300, r"below 2\*\*63"),
        (2**63, r"below 2\*\*63"),
        (2**64 - 1, r"below 2\*\*63"),
        (0.5, "an integer;"),
        (-(2.0**60), "at least 0"),
    ],
)
def test_an_integer_that_is_too_large_is_no_other_number(value, rule, tmp_path):
    with pytest.raises(ArgumentError, match=rf"^state\[0\] must be {rule}"):
        Transitions(np.array([value]), [0], [0])
    frame = pd.DataFrame({"state": [value], "action": [0], "next_state": [0]})
    with pytest.raises(ArgumentError, match=rf"^frame: state\[0\] must be {rule}"):
        Transitions.from_frame(frame)


def test_a_name_that_is_none_is_named_with_its_row(tmp_path):
    path = tmp_path / "log.csv"
    columns = [["dock", "hall", "hall"], ["go", "go", "go"], ["hall", "dock", "hall"]]
    odd = {" hall": "nor begin", "h\u0430ll": r"must differ; .* which looks as \w+\["}
    for k, column in enumerate(("state", "action", "next_state")):
        for text, rule in odd.items():
            given = [[*column] for column in columns]
            given[k][2] = text if column != "action" else text.replace("hall", "go")
            if column == "action" and text[0] == "h":
                continue
            with pytest.raises(ArgumentError, match=rf"{column}\[2\].*{rule}|{rule}"):
                Transitions(*given)
            labels = ("state", "action", "next_state")
            pd.DataFrame(dict(zip(labels, given, strict=True))).to_csv(
                path, index=False
            )
            with pytest.raises(ValueError, match=rf"{column}\[2\]"):
                Transitions.load(path)


@pytest.mark.parametrize("odd", [[1, 2], {"a": 1}, {3}, np.array([1, 2])], ids=repr)
def test_values_that_cannot_be_hashed_are_refused_by_place(odd):
    column = np.array(["go", None], dtype=object)
    column[1] = odd
    frame = pd.DataFrame({"state": ["a", "b"], "action": column})
    frame = frame.assign(next_state=["b", "a"])
    with pytest.raises(ValueError, match="action"):
        Transitions.from_frame(frame)


def test_columns_of_several_values_a_row_are_refused_by_name():
    polars = pytest.importorskip("polars")
    place = [{"x": 0, "y": 1}, {"x": 1, "y": 1}]
    structs = polars.DataFrame({"state": place, "action": [0, 0], "next_state": place})
    pairs = structs.with_columns(
        polars.Series(name, [[0, 1], [1, 1]], dtype=polars.Array(polars.Int64, 2))
        for name in ("state", "next_state")
    )
    for frame in (structs, pairs):
        with pytest.raises(ValueError, match=r"^frame: state must hold numbers"):
            oee.Transitions.from_frame(frame)
