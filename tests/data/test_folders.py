"""Folders of a log: copies, overlaps, what is left out, and subfolders."""

import gzip
import os
import shutil
import warnings

import numpy as np
import pandas as pd
import pytest

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.exceptions import DataWarning

READERS = [Transitions.load, Transitions.open]


def frame_of(n, seed, *, has_episodes=True, n_states=30):
    """Return a random walk: states, actions and rewards by chance."""
    rng = np.random.default_rng(seed)
    state = rng.integers(0, n_states, n + 1)
    frame = pd.DataFrame(
        {
            "state": state[:-1],
            "action": rng.integers(0, 3, n),
            "next_state": state[1:],
            "reward": rng.normal(size=n).round(2),
        }
    )
    return frame.assign(episode=np.arange(n) // 10) if has_episodes else frame


def write(frame, path):
    if path.suffix == ".parquet":
        frame.to_parquet(path, index=False)
    elif path.suffix == ".npz":
        Transitions.from_frame(frame).save(path)
    else:
        frame.to_csv(path, index=False)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("one", "other"),
    [("a.csv", "a - copy.csv"), ("2024.parquet", "z.parquet"), ("log.npz", "old.npz")],
)
def test_files_of_the_same_bytes_are_refused(tmp_path, read, one, other):
    write(frame_of(60, 0), tmp_path / one)
    write(frame_of(60, 1), tmp_path / f"m{one}")
    shutil.copy(tmp_path / one, tmp_path / other)
    with pytest.raises(ValueError, match="must name each recording once") as caught:
        read(tmp_path)
    assert one in str(caught.value)
    assert other in str(caught.value)
    with pytest.raises(ValueError, match="hold the same 60 rows"):
        read([tmp_path / one, tmp_path / other])
    # the remedy
    logs = [Transitions.load(tmp_path / name) for name in (one, other)]
    Transitions.concatenate(logs).save(tmp_path / "joined.npz")
    assert len(Transitions.load(tmp_path / "joined.npz")) == 120


@pytest.mark.parametrize("read", READERS)
def test_short_files_may_be_the_same(tmp_path, read):
    for name in ("a.csv", "b.csv", "c.csv"):
        write(frame_of(5, 0, has_episodes=False), tmp_path / name)
    with pytest.warns(DataWarning, match=r"same 5 rows \(2 such files in all\): they"):
        assert len(read(tmp_path)) == 15


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("other", [".csv.gz", ".parquet", ".npz"])
def test_one_name_in_two_formats_is_refused(tmp_path, read, other):
    frame = frame_of(80, 3)
    write(frame, tmp_path / "w1.csv")
    if other == ".csv.gz":
        with gzip.open(tmp_path / "w1.csv.gz", "wt") as handle:
            frame.assign(note="x").to_csv(handle, index=False)
    else:
        write(frame, tmp_path / f"w1{other}")
    if other == ".npz" and read is not Transitions.load:
        return  # an npz has more columns, which is an error there
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        with pytest.raises(ValueError, match=r"w1\..*hold the same transitions \("):
            read(tmp_path)
    # other rows under that name are another part of the log
    (tmp_path / f"w1{other}").unlink()
    write(frame_of(80, 4), tmp_path / f"w1{other.removesuffix('.gz')}")
    assert len(read(tmp_path)) == (80 if other == ".csv.gz" else 160)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize("n_shared", [0, 15, 40, 300])
def test_files_that_overlap_are_warned_of(tmp_path, read, ending, n_shared):
    frame = frame_of(1000, 5, has_episodes=False)
    for name, some in (("a", frame[: 500 + n_shared]), ("b", frame[500:])):
        write(some, tmp_path / f"{name}{ending}")
    if n_shared < 20:
        assert len(read(tmp_path)) == 1000 + n_shared
        return
    with pytest.warns(DataWarning, match=f"^{n_shared} rows stand in .*a.* and in .*b"):
        read(tmp_path)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("n", [240, 3000])
@pytest.mark.parametrize(
    ("form", "share"),
    [
        (lambda frame: frame[frame.columns[::-1]], 1.0),
        (lambda frame: frame[: len(frame) // 2], 0.5),
        (lambda frame: frame[len(frame) // 3 :].reset_index(drop=True), 2.0 / 3.0),
        (lambda frame: frame.assign(note="again"), 1.0),
    ],
    ids=["other order", "first half", "without a third", "one more column"],
)
@pytest.mark.filterwarnings("ignore:.* left out")
def test_a_copy_in_another_form_among_many_files(tmp_path, read, n, form, share):
    """The copy is neither of the same bytes nor beside its original."""
    for k in range(7):
        write(frame_of(n, k, has_episodes=False), tmp_path / f"run_{k}.csv")
    copy = form(frame_of(n, 2, has_episodes=False))
    write(copy, tmp_path / "run_9.csv")
    words = f"^{round(share * n)} rows stand in .*run_2.* and in .*run_9"
    with pytest.warns(DataWarning, match=words):
        read(tmp_path)


def test_of_many_large_files_the_last_ones_are_compared(tmp_path, monkeypatch):
    monkeypatch.setattr("oee_tabular.data.copies.N_KEPT_ROWS", 700)
    for k in range(6):
        write(frame_of(200, k, has_episodes=False), tmp_path / f"run_{k}.csv")
    last = frame_of(200, 4, has_episodes=False)
    write(last[last.columns[::-1]], tmp_path / "run_7.csv")
    with pytest.warns(DataWarning, match="200 rows stand in .*run_4.* and in .*run_7"):
        Transitions.load(tmp_path)


@pytest.mark.parametrize("read", READERS)
def test_what_is_never_random_is_no_overlap(tmp_path, read):
    """Runs of a machine that always does the same: 50 steps round a circle."""
    state = np.arange(50)
    frame = pd.DataFrame(
        {"state": state, "action": 0, "next_state": (state + 1) % 50, "reward": -1.0}
    )
    for name in ("a", "b", "c"):
        write(frame.assign(episode=f"run {name}"), tmp_path / f"{name}.csv")
    assert len(read(tmp_path)) == 150


def test_large_files_that_overlap(tmp_path, monkeypatch):
    """Both ends of a file are compared, also where it is read in many pieces."""
    monkeypatch.setattr("oee_tabular.data.copies.N_ROWS", 400)
    monkeypatch.setattr("oee_tabular.data.copies.N_GROUPED_ROWS", 400)
    monkeypatch.setattr("oee_tabular.data.tables.N_CSV_ROWS", 300)
    frame = frame_of(5000, 6, has_episodes=False)
    for ending in (".csv", ".parquet"):
        folder = tmp_path / ending
        folder.mkdir()
        write(frame[:3000], folder / f"a{ending}")
        write(frame[2900:], folder / f"b{ending}")
        for read in READERS:
            with pytest.warns(DataWarning, match="^100 rows stand in"):
                read(folder)


@pytest.mark.parametrize("read", READERS)
def test_files_that_are_left_out_are_named(tmp_path, read):
    write(frame_of(50, 0), tmp_path / "a.csv")
    for name in ("b.tab", "c.csv.bz2", "d.ods", "E.Feather", "README.txt", "notes.md"):
        (tmp_path / name).write_text("x")
    (tmp_path / "_SUCCESS").write_text("")
    (tmp_path / ".b.tsv").write_text("")
    with pytest.warns(DataWarning) as told:
        read(tmp_path)
    text = str(told[0].message)
    assert text.startswith("read 1 of 5 files in ")
    assert all(name in text for name in ("'b.tab'", "'c.csv.bz2'", "'E.Feather'"))
    assert "notes" not in text
    assert "README" not in text


@pytest.mark.parametrize("read", READERS)
def test_files_without_rows_are_named(tmp_path, read):
    for name, seed in (("a", 0), ("c", 1)):
        write(frame_of(50, seed), tmp_path / f"{name}.csv")
    write(frame_of(50, 0)[:0], tmp_path / "b.csv")
    with pytest.warns(DataWarning, match="1 of 3 files has a header and no rows: .*b"):
        assert len(read(tmp_path)) == 100


@pytest.mark.parametrize("read", READERS)
def test_subfolders_beside_files_are_said(tmp_path, read):
    write(frame_of(50, 0), tmp_path / "a.csv")
    (tmp_path / "old" / "more").mkdir(parents=True)
    write(frame_of(50, 1), tmp_path / "old" / "more" / "b.parquet")
    with pytest.warns(DataWarning, match=r"^1 of the 2 files read in .* subfolders: "):
        assert len(read(tmp_path)) == 100


def test_a_folder_of_other_formats_alone(tmp_path):
    (tmp_path / "a.tsv").write_text("state\taction\tnext_state\n0\t0\t0\n")
    for read in READERS:
        with pytest.raises(ValueError, match=r"must hold files in .* has 'a\.tsv' \("):
            read(tmp_path)
    with pytest.raises(ValueError, match=r"pandas\.read_csv\(path, sep='\\t'\)"):
        oee.Transitions.load(tmp_path / "a.tsv")


@pytest.mark.parametrize("step", ["action=caf%E9", "%FF=3", "state=a%C3"])
def test_folders_whose_letters_are_not_utf_8_are_refused(step, tmp_path):
    """Two of them would be read as one value."""
    folder = tmp_path / "log" / step
    folder.mkdir(parents=True)
    (folder / "a.csv").write_text("state,action,next_state\n0,0,1\n")
    with pytest.raises(ValueError, match="must have folders whose %XX are UTF-8"):
        oee.Transitions.load(tmp_path / "log")


@pytest.mark.parametrize("word", ["NA", "nan", "NULL", " n/a "])
def test_a_missing_part_of_a_tuple_is_no_name(word, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(f"x,y,u,x2,y2\n0,{word},5,0,1\n0,1,5,0,1\n")
    columns = {"state": ["x", "y"], "action": "u", "next_state": ["x2", "y2"]}
    with pytest.raises(ValueError, match=r"state\[0\] must have a value"):
        oee.Transitions.load(path, columns=columns)


def write_rows(path, *rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["state,action,next_state", *rows, ""]))


@pytest.mark.parametrize("kind", ["spelling", "absolute", "link", "hard link", "loop"])
def test_one_file_under_two_paths_is_refused(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_rows(tmp_path / "l" / "a.csv", "0,0,1", "1,0,0")
    path = ["l/a.csv", "l/../l/a.csv"]
    if kind == "absolute":
        path = ["l/a.csv", str(tmp_path / "l" / "a.csv")]
    elif kind == "link":
        (tmp_path / "l" / "b.csv").symlink_to("a.csv")
        path = "l"
    elif kind == "hard link":
        (tmp_path / "l" / "b.csv").hardlink_to(tmp_path / "l" / "a.csv")
        path = "l"
    elif kind == "loop":
        (tmp_path / "l" / "loop").symlink_to("../l")
        path = "l/**/*.csv"
    for read in (oee.Transitions.load, oee.Transitions.open):
        with pytest.raises(
            ValueError, match=r"^path must name each file once; '.*again"
        ):
            read(path)


def test_a_pattern_of_files_and_folders_is_refused(tmp_path):
    write_rows(tmp_path / "day1.csv", "0,0,1")
    write_rows(tmp_path / "day2" / "a.csv", "1,0,2", "2,0,0")
    for read in (oee.Transitions.load, oee.Transitions.open):
        with pytest.raises(
            ValueError, match=r"^path must match files or folders, not bo"
        ):
            read(str(tmp_path / "day*"))
    (tmp_path / "day3").mkdir()  # holds no log
    (tmp_path / "day3" / "plot.png").touch()
    assert len(oee.Transitions.load(str(tmp_path / "day[13]*"))) == 1


LACKING = {
    "episode": {"episode": [0, 0]},
    "behavior_probability": {"behavior_probability": [0.5, 0.5]},
    "terminated": {"terminated": [0, 1]},
    "timestep": {"timestep": [0, 1]},
}


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize("column", LACKING)
def test_a_column_that_one_of_several_files_lacks_is_refused(
    tmp_path, read, is_first, column
):
    plain = pd.DataFrame({"state": [0, 1], "action": [0, 1], "next_state": [1, 0]})
    other = plain.assign(next_state=[1, 2])
    if column == "timestep":
        plain, other = plain.assign(episode=[0, 0]), other.assign(episode=[1, 1])
    both = [plain.assign(**LACKING[column]), other]
    for name, frame in zip(("a", "b"), both if is_first else both[::-1], strict=True):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    has, lacks = ("a", "b") if is_first else ("b", "a")
    message = rf"same columns; .*{has}.csv' has '{column}', and .*{lacks}.csv' does not"
    with pytest.raises(ValueError, match=message):
        read(tmp_path)
    # the remedy
    assert len(read(tmp_path, columns={column: None})) == 4


@pytest.mark.parametrize("read", READERS)
def test_rewards_may_be_missing_in_a_file(tmp_path, read):
    plain = pd.DataFrame({"state": [0, 1], "action": [0, 1], "next_state": [1, 0]})
    plain.to_csv(tmp_path / "a.csv", index=False)
    plain.assign(state=[0, 2], reward=[1.0, 2.0]).to_csv(
        tmp_path / "b.csv", index=False
    )
    assert len(read(tmp_path)) == 4


OWN = {"state": [0, 1], "action": [0, 0], "next_state": [1, 0]}
NO_ACTION = {"state": [0, 1], "next_state": [1, 0]}
U = {"state": [0, 1], "u": [0, 0], "next_state": [1, 0]}


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("folder", "table", "columns"),
    [
        ("action=1/action=2", NO_ACTION, None),
        ("action=1/x/action=01", NO_ACTION, None),
        ("act=1/action=2", NO_ACTION, None),
        ("act=1", OWN, None),
        ("Actions=1", OWN, None),
        ("u=1", U, {"action": "u"}),
        ("action=1", U, {"action": "u"}),
        ("act=1", U, {"action": "u"}),
        ("u=0/act=1", NO_ACTION, {"action": "u"}),
        ("rewards=2", OWN | {"reward": [1.0, 2.0]}, None),
    ],
)
def test_folders_that_contradict_are_refused(tmp_path, read, folder, table, columns):
    place = tmp_path / folder
    place.mkdir(parents=True)
    pd.DataFrame(table).to_csv(place / "a.csv", index=False)
    with pytest.raises(ValueError, match=r"what the folder|one thing of each column"):
        read(tmp_path, columns=columns)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("folder", ["action=0/action=0", "act=0/action=0", "act=0"])
def test_folders_that_agree_are_read(tmp_path, read, folder):
    place = tmp_path / folder
    place.mkdir(parents=True)
    pd.DataFrame(OWN).to_csv(place / "a.csv", index=False)
    assert set(read(tmp_path).action) == {0}


def test_labels_of_every_file_are_reported(tmp_path):
    frame = pd.DataFrame(OWN)
    frame.assign(reward=1.0).to_csv(tmp_path / "a.csv", index=False)
    frame.assign(state=[2, 1], rewards=1.0, pay=3).to_csv(
        tmp_path / "b.csv", index=False
    )
    for read in READERS:
        with pytest.warns(DataWarning) as told:
            read(tmp_path)
        said = " ".join(str(one.message) for one in told)
        assert "'rewards' as reward" in said
        assert "left out: pay" in said


@pytest.mark.parametrize("column", ["state", "action"])
def test_names_in_one_file_and_numbers_in_another_are_refused(tmp_path, column):
    named = {"state": ["x", "y"], "next_state": ["y", "x"]}
    names = named if column == "state" else {"action": ["x", "y"]}
    frame = pd.DataFrame(OWN)
    frame.to_csv(tmp_path / "a.csv", index=False)
    frame.assign(**names).to_csv(tmp_path / "b.csv", index=False)
    message = rf"names as {column}, or numbers; .*b.csv' has 'x', and .*a.csv' has 0 "
    with pytest.raises(ValueError, match=message):
        Transitions.load(tmp_path)


@pytest.mark.parametrize("read", READERS)
def test_a_folder_may_be_called_like_a_pattern(tmp_path, read):
    for name in ("p[1]", "p1"):
        (tmp_path / name).mkdir()
        frame_of(5, len(name)).to_csv(tmp_path / name / "a.csv", index=False)
    assert len(read(str(tmp_path / "p[1]" / "*.csv"))) == 5
    (tmp_path / "p1" / "a.csv").unlink()
    assert len(read(str(tmp_path / "p[1]" / "*.csv"))) == 5


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("column", ["reward", "episode", "wait"])
def test_durations_in_parquet_are_no_numbers(tmp_path, read, unit, column):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    spans = arrow.array([0, 0], arrow.duration(unit))
    table = arrow.table({"wide": ["x", "y"], **OWN, column: spans, "é": [1, 2]})
    parquet.write_table(table, tmp_path / "log.parquet")
    if column == "wait":  # which is left out
        with pytest.warns(DataWarning, match="left out: wide, wait, é"):
            assert len(read(tmp_path)) == 2
        return
    with pytest.raises(ValueError, match=f"'{column}' holds durations"):
        read(tmp_path)


def test_rewards_whose_sum_is_no_float_are_refused(tmp_path):
    frame = pd.DataFrame(
        {"state": 0, "action": 0, "next_state": 0, "reward": [1e308] * 2}
    )
    for ending in ("csv", "parquet"):
        write(frame, tmp_path / f"log.{ending}")
        with pytest.raises(ValueError, match="state 0, action 0 add up to inf"):
            Transitions.open(tmp_path / f"log.{ending}")


def test_columns_of_parquet_without_a_name_are_refused(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table({**OWN, "": [1.0, 2.0]}), tmp_path / "log.parquet")
    for read in READERS:
        with pytest.raises(ValueError, match="whose name is empty"):
            read(tmp_path, columns={"reward": ""})


@pytest.mark.parametrize("read", READERS)
def test_a_folder_of_very_many_other_files_is_refused(tmp_path, read, monkeypatch):
    """A home or a root folder is no log; its files are not all looked through."""
    monkeypatch.setattr("oee_tabular.data.files.MAX_OTHER_FILES", 5)
    write(frame_of(20, 0), tmp_path / "log.csv")
    for k in range(5):
        (tmp_path / f".part {k}.txt").touch()
    assert len(read(tmp_path)) == 20
    folder = tmp_path / "below"
    folder.mkdir()
    (folder / "a.jpg").touch()
    with pytest.raises(ValueError, match=r"^path must be the folder of a log; .* 5 "):
        read(tmp_path)


@pytest.mark.parametrize("read", READERS)
def test_a_folder_that_cannot_be_read_is_refused(tmp_path, read, monkeypatch):
    for name in ("a", "b", ".git"):
        (tmp_path / name).mkdir()
    write(frame_of(20, 0), tmp_path / "a" / "log.csv")
    scan = os.scandir
    closed = {str(tmp_path / ".git")}

    def refuse(path):
        if os.fspath(path) in closed:
            raise PermissionError(13, "Permission denied", os.fspath(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # it stands in a subfolder
        assert len(read(tmp_path)) == 20  # a hidden folder holds no log
    closed.add(str(tmp_path / "b"))
    with pytest.raises(ValueError, match=r"^path must name a folder .*b' cannot"):
        read(tmp_path)


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("b.csv", b""),
        ("b.csv", b"\r\n\n"),
        ("b.csv", b"\xef\xbb\xbf"),
        ("b.csv.gz", b""),
        ("b.parquet", b""),
    ],
)
def test_a_part_that_is_empty(tmp_path, read, name, data):
    (tmp_path / "a.csv").write_text("state,action,next_state\n0,0,1\n")
    (tmp_path / name).write_bytes(data)
    words = r"must have a header; the file is empty .* may be left out"
    with pytest.raises(ValueError, match=rf"{name}' {words}"):
        read(tmp_path)


ORDERS = {
    "reversed": lambda frame: frame[::-1],
    "by state": lambda frame: frame.sort_values(["state", "reward"]),
    "shuffled": lambda frame: frame.sample(frac=1.0, random_state=3),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz"])
@pytest.mark.parametrize("has_names", [False, True])
@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
def test_copies_in_another_order_are_told(tmp_path, order, ending, has_names, read):
    random = np.random.default_rng(0)

    def draw():
        frame = pd.DataFrame(random.integers(0, 9, (900, 3)))
        frame.columns = ["state", "action", "next_state"]
        return frame.assign(reward=random.normal(size=900))

    def write(frame, name):
        path = tmp_path / name
        Transitions.from_frame(frame).save(path)
        return path

    frame = draw()
    names = "abcdefghi"
    if has_names and read == Transitions.load:
        for label in ("state", "next_state"):
            frame[label] = [f"s{names[k]}" for k in frame[label]]
    others = draw()
    if has_names and read == Transitions.load:
        others = frame.assign(next_state=frame.next_state[::-1].to_numpy())
    paths = [write(frame, "a.csv"), write(others, "b.csv")]
    read(paths)  # other rows of the same number
    paths.append(write(ORDERS[order](frame), f"c{ending}"))
    words = r"a.csv' and '.*c\..*' hold the same 900 rows, in another order, and count"
    with pytest.warns(DataWarning, match=words):
        read(paths)


def test_files_with_little_chance_are_no_copies(tmp_path):
    """Each way through a corridor has the same transitions."""
    for k in range(3):
        rows = np.roll(np.tile(np.arange(5), 40), k)
        Transitions(rows, 0 * rows, (rows + 1) % 5).save(tmp_path / f"{k}.csv")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "in .*the same order")
        Transitions.load(tmp_path)
        Transitions.open(tmp_path)
