"""Logs in several files: episodes that are cut where a file ends, and folders that name
columns.
"""

import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.data import read_log
from oee_tabular.exceptions import ArgumentError, DataWarning, SimulatorWarning

GRID = oee.tasks.gridworld(3, slip=0.3)
LOG = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 6, 9, seed=4)
COLUMNS = ["state", "action", "next_state", "reward", "terminated", "episode"]


def frame(*more):
    return pd.DataFrame({name: LOG.columns()[name] for name in [*COLUMNS, *more]})


def write(folder, table, cuts, ending):
    """Write the rows between cuts to files, whose numbers have no zeros before them."""
    bounds = [0, *sorted(cuts), len(table)]
    for k, (low, high) in enumerate(zip(bounds, bounds[1:], strict=False)):
        path = folder / f"part.{k}{ending}"
        part = table.iloc[low:high]
        if ending == ".parquet":
            part.to_parquet(path, index=False)
        else:
            part.to_csv(path, index=False)
    return folder


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".csv.gz"])
@pytest.mark.parametrize("more", [(), ("timestep",)])
@pytest.mark.filterwarnings("ignore:.* a header and no rows")
@settings(max_examples=8)
@given(cuts=st.lists(st.integers(0, len(LOG)), min_size=1, max_size=13))
def test_a_log_is_the_same_wherever_it_is_cut(tmp_path_factory, ending, more, cuts):
    folder = write(tmp_path_factory.mktemp("cut"), frame(*more), cuts, ending)
    log = Transitions.load(folder)
    for name in ("state", "reward", "timestep", "truncated", "terminated"):
        assert_array_equal(getattr(log, name), getattr(LOG, name), err_msg=name)
    assert_array_equal(log.episode_starts, LOG.episode_starts)
    counts = Transitions.open(folder)
    facts = LOG.summary()
    told = counts.summary()
    for name in ("transitions", "episodes", "episode_length_min", "episode_length_max"):
        assert told[name] == facts[name]
    assert told["truncated"] == facts["truncated"]
    # all episodes are in the sample, in their order
    for name in ("state", "reward", "timestep", "truncated"):
        assert_array_equal(getattr(counts.sample, name), getattr(LOG, name))


def test_processes_and_samples_of_episodes_that_are_cut(tmp_path):
    write(tmp_path, frame(), range(3, len(LOG), 4), ".csv")
    for kept in (1, 7, 20, 30):
        one, two = (Transitions.open(tmp_path, kept_moves=kept, jobs=k) for k in (1, 2))
        assert one.recording == two.recording
        assert (one.sample is None) == (two.sample is None)
        if one.sample is not None:
            assert len(one.sample) <= kept
            for name, column in one.sample.columns().items():
                assert_array_equal(column, getattr(two.sample, name))
            lengths = np.diff(LOG.episode_starts).tolist()
            assert set(np.diff(one.sample.episode_starts).tolist()) <= set(lengths)


HEAD = "state,action,next_state,episode"


def files(folder, texts, head=HEAD):
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{head}\n{text}")
    return folder


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize(
    ("head", "last", "first", "words"),
    [
        (
            HEAD,
            "1,0,2,7",
            "3,0,4,7",
            "its next_state there, 2, is not its state here, 3",
        ),
        (
            f"{HEAD},timestep",
            "1,0,2,7,0",
            "2,0,4,7,0",
            "its timestep there is 0 and here 0",
        ),
        (f"{HEAD},terminated", "1,0,2,7,1", "2,0,4,7,0", None),
        (f"{HEAD},truncated", "1,0,2,7,True", "2,0,4,7,True", None),
        (HEAD, "1,0,2,7", "2,0,4,8", None),
    ],
)
def test_episodes_that_are_two(tmp_path, read, head, last, first, words):
    """Where it is a guess, it is told."""
    files(tmp_path, {"a.csv": last, "b.csv": first}, head)
    if words is None:
        found = read(tmp_path)
    else:
        with pytest.warns(UserWarning, match=f"episode 7 ends .*a.csv.*b.csv.*{words}"):
            found = read(tmp_path)
    assert found.summary()["episodes"] == 2


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize(
    ("last", "first", "words"),
    [
        ("1,0,2,7,0", "2,0,4,7,3", r"must be 1, where it goes on from .*a\.csv', or 0"),
        ("1,0,2,7,0", "2,0,4,8,3", r"must be 0 .*an episode that another file begins"),
    ],
)
def test_timesteps_that_fit_no_file_before(tmp_path, read, last, first, words):
    files(tmp_path, {"a.csv": last, "b.csv": first}, f"{HEAD},timestep")
    with pytest.raises(ValueError, match=rf"b\.csv': timestep\[0\] {words}"):
        read(tmp_path)
    found = Transitions.open(tmp_path, bad_rows="drop")
    assert (len(found), found.recording.broken) == (2, 1)
    assert len(found.recording.reasons) == 1


def test_a_bad_row_where_an_episode_is_cut(tmp_path):
    files(tmp_path, {"a.csv": "0,0,1,7\n1,0,-2,7", "b.csv": "2,0,3,7\n0,0,1,8"})
    found = Transitions.open(tmp_path, bad_rows="drop")
    told = found.recording
    assert (told.episodes, told.broken, told.dropped) == (2, 1, 1)
    assert len(found.sample) == 1


@pytest.mark.filterwarnings("ignore:.* a header and no rows")
def test_parts_without_rows(tmp_path):
    files(tmp_path, {"a.csv": "", "b.csv": "0,0,1,x", "c.csv": "", "d.csv": "1,0,2,x"})
    for found in (Transitions.load(tmp_path), Transitions.open(tmp_path)):
        assert found.summary()["episodes"] == 1
    for path in tmp_path.iterdir():
        path.write_text(HEAD)
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ValueError, match="at least one"):
            read(tmp_path)


def test_ids_that_restart_in_files_that_were_joined(tmp_path):
    files(tmp_path, {"a.csv": "0,0,1,0\n0,0,1,1\n0,0,1,0"})
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ValueError, match=r"0 begins again in row 2 .*'run1-0'"):
            read(tmp_path)
    files(tmp_path, {"a.csv": "0,0,1,0\n0,0,1,1", "b.csv": "0,0,1,0"})
    assert Transitions.load(tmp_path).n_episodes == 3


@pytest.mark.parametrize("ids", [[-5, -5], [2**63 - 1, 0], [-(2**63), 2**63 - 1]])
def test_numbers_of_episodes_of_several_logs(ids):
    logs = [Transitions([0], [0], [1], episode=[k]) for k in ids]
    assert Transitions.concatenate(logs * 2).n_episodes == 4


def test_links_that_lead_nowhere_are_not_passed_over(tmp_path):
    files(tmp_path, {"a.csv": "0,0,1,0"})
    (tmp_path / "b.csv").symlink_to(tmp_path / "gone.csv")
    for path in (tmp_path, str(tmp_path / "*.csv")):
        with pytest.raises(FileNotFoundError):
            Transitions.load(path)


def test_a_pattern_of_folders(tmp_path):
    files(tmp_path, {"day=2/a.csv": "1,0,2,x", "day=1/a.csv": "0,0,1,x"})
    for path in (str(tmp_path / "day=*"), tmp_path):
        with pytest.warns(UserWarning, match="read as one.* the folders differ in day"):
            assert Transitions.load(path).state.tolist() == [0, 1]
        with pytest.warns(UserWarning, match="read as one.* the folders differ in day"):
            assert Transitions.open(path).recording.episodes == 1


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize(
    "folders", [("robot=1", "robot=2"), ("seed=0/a=1", "seed=0/a=2"), ("", "site=x")]
)
def test_ids_that_may_restart_in_each_folder(tmp_path, read, folders):
    """The same folder is none that differs, and timesteps tell where ids restart."""
    texts = [f"{folder}/{name}.csv" for folder in folders for name in "pq"]
    rows = dict(zip(texts, ("0,0,1,0", "1,0,2,0", "2,0,3,0", "3,0,4,0"), strict=True))
    files(tmp_path / "a", rows)
    paths = [tmp_path / "a" / text for text in texts]
    with pytest.warns(UserWarning, match="read as one") as told:
        assert read(paths).summary()["episodes"] == 1
    (text,) = (str(each.message) for each in told)
    assert str(paths[1]) in text
    assert str(paths[2]) in text
    assert "write the file's name before ids" in text
    assert "such places" not in text
    head = f"{HEAD},timestep"
    files(
        tmp_path / "b",
        {text: f"{rows[text]},{k}" for k, text in enumerate(texts)},
        head,
    )
    assert read([tmp_path / "b" / text for text in texts]).summary()["episodes"] == 1


# ---- folders that name columns


MDP = oee.FiniteMDP(np.full((2, 2, 2), 0.5), np.zeros((2, 2)), 0, 0.9).with_names(
    action_names=["left", "go right/é"]
)


def test_names_of_folders(tmp_path):
    files(
        tmp_path,
        {"action=left/a.csv": "0,1,5", "action=go%20right%2Fe%CC%81/a.csv": "1,1,6"},
        "state,next_state,episode",
    )
    assert sorted(oee.Problem(MDP, tmp_path).log.action.tolist()) == [0, 1]
    assert sorted(Transitions.open(tmp_path, simulator=MDP).action.tolist()) == [0, 1]
    assert Transitions.load(tmp_path).action_names == ("go right/é", "left")


def test_folders_of_values_that_are_missing(tmp_path):
    null = "__HIVE_DEFAULT_PARTITION__"
    files(tmp_path, {f"reward={null}/a.csv": "0,0,1,5", "reward=2.5/a.csv": "0,0,1,6"})
    assert_array_equal(np.sort(Transitions.load(tmp_path).reward), [2.5, np.nan])
    assert Transitions.open(tmp_path).reward_count.tolist() == [1]
    files(tmp_path / "b", {f"state={null}/a.csv": "0,1"}, "action,next_state")
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(ValueError, match=r"state\[0\] must have a value"):
            read(tmp_path / "b")


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz"])
@pytest.mark.parametrize(
    ("folder", "is_right"),
    [
        ("action=1", True),
        ("action=0", False),
        ("action=01", True),
        ("state=x", False),
        ("terminated=false", True),
        ("terminated=1", False),
        ("reward=0.5e0", True),
        ("reward=-1", False),
    ],
)
def test_folders_and_columns_of_one_name(tmp_path, read, ending, folder, is_right):
    path = tmp_path / folder / f"a{ending}"
    path.parent.mkdir()
    log = Transitions([0, 0], [1, 1], [0, 0], [0.5, 0.5])
    log.save(path)
    if is_right:
        assert len(read(tmp_path)) == 2
    else:
        label = folder.partition("=")[0]
        with pytest.raises(
            ValueError, match=rf"{label}\[0\] must be what the folder '{folder}' says"
        ):
            read(tmp_path)
    # a file that is given itself stands in no folder
    assert read(path).action.tolist()[0] == 1


@pytest.mark.parametrize("read", [Transitions.load, Transitions.open])
def test_folders_that_part_the_rows_of_an_episode(tmp_path, read):
    head = "state,next_state,episode"
    files(tmp_path / "a", {"action=0/x.csv": "0,1,5", "action=1/x.csv": "1,2,5"}, head)
    with pytest.raises(
        ValueError, match="must have all rows of an episode in one folder"
    ):
        read(tmp_path / "a")
    files(tmp_path / "b", {"action=0/x.csv": "0,1,5\n2,3,5"}, head)
    with pytest.raises(ValueError, match="folders by action part the rows"):
        read(tmp_path / "b")
    head = "state,action,next_state"
    files(
        tmp_path / "c", {"episode=05/x.csv": "1,0,2", "episode=5/x.csv": "2,0,3"}, head
    )
    assert read(tmp_path / "c").summary()["episodes"] == 2


def write_parts(folder, texts):
    """Write the rows of some files, one of which has a blank line, and return paths."""
    paths = []
    for k, text in enumerate(texts):
        paths.append(folder / f"part-{k}.csv")
        paths[k].write_text("state,action,next_state\n\n" + text)
    return paths


@pytest.mark.parametrize("form", ["folder", "paths", "pattern"])
@pytest.mark.parametrize(
    ("row", "column"), [("halll,go,door", "state"), ("hall,g,door", "action")]
)
def test_an_unknown_name_is_placed_in_its_own_file(tmp_path, form, row, column):
    good = "hall,go,door\ndoor,stay,door\n"
    paths = write_parts(tmp_path, [good, good * 2, good + row, good])
    given = {"folder": tmp_path, "paths": paths, "pattern": str(tmp_path / "*.csv")}
    simulator = oee.FiniteMDP(
        [[[0.5, 0.5]] * 2] * 2,
        [0, 0],
        [1, 0],
        0.9,
        state_names=["hall", "door"],
        action_names=["go", "stay"],
    )
    log = Transitions.load(given[form])
    place = f"log.{column}[8] (row 2 (line 5) of {str(paths[2])!r})"
    with pytest.raises(ArgumentError, match=f"^{re.escape(place)} must be one of"):
        log.numbered(simulator)
    with pytest.raises(ArgumentError, match=re.escape(place)):
        read_log(given[form], simulator)
    paths[2].unlink()
    with pytest.raises(ArgumentError, match=r"\[8\] \(row 2 of '.*part-2.csv'\) must"):
        log.numbered(simulator)


def test_numbers_outside_a_simulator_are_placed_in_their_own_file(tmp_path):
    paths = write_parts(tmp_path, ["0,0,1\n1,0,0\n", "0,0,1\n1,0,7\n"])
    log = Transitions.load(paths)
    place = f"log.next_state[3] (row 1 (line 4) of {str(paths[1])!r})"
    with pytest.raises(ArgumentError, match=re.escape(place)):
        log.counts(2, 1)
    first = Transitions.load(paths[1])
    with pytest.raises(ArgumentError, match=r"^log.next_state\[1\] must be in"):
        first.counts(2, 1)


def test_names_of_two_files_that_look_alike_are_placed(tmp_path):
    paths = write_parts(
        tmp_path, ["hall,go,door\n", "door,go,door\nh\u0430ll,go,door\n"]
    )
    with pytest.raises(ArgumentError, match="which looks as") as told:
        Transitions.load(paths)
    assert f"states must differ; {str(paths[1])!r}: row 1 (line 4) is" in str(
        told.value
    )
    assert f"looks as {str(paths[0])!r}: row 0 (line 3) does" in str(told.value)


def test_a_misspelt_next_state_of_several_files_is_placed(tmp_path):
    text = "hall,go,depot\ndepot,go,hall\n"
    paths = write_parts(tmp_path, [text * 2, text + "hall,go,depto\n"])
    log = Transitions.load(paths)
    place = re.escape(f"log.next_state[6] (row 2 (line 5) of {str(paths[1])!r})")
    with (
        pytest.warns(DataWarning, match=f"{place} 'depto' resembles"),
        pytest.warns(SimulatorWarning),
    ):
        oee.FiniteMDP.from_log(log, rewards=[0, 0, 0], initial="hall", discount=0.9)


def test_files_in_another_order_are_told(tmp_path):
    """An episode goes on in the file that was given second."""
    head = ["state", "action", "next_state", "episode", "timestep"]
    for name, steps in (("b.csv", (0, 1)), ("a.csv", (2, 3))):
        rows = [[k, 0, k + 1, 7, k] for k in steps]
        pd.DataFrame(rows, columns=head).to_csv(tmp_path / name, index=False)
    paths = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    with pytest.raises(
        ArgumentError, match="give the files in the order in which they were"
    ):
        Transitions.load(paths)
    assert Transitions.load(paths[::-1]).n_episodes == 1
