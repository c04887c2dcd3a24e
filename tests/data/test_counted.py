"""Counts in place of a log: what they hold, their file."""

import numpy as np
import pandas as pd
import pytest
from kernels.files import DIGEST, KIND, save_npz
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import TransitionCounts, Transitions
from oee_tabular.data.counts import Recording

LOG = Transitions(
    [0, 1, 0],
    [0, 1, 0],
    [1, 2, 1],
    [0.0, 1.0, 0.0],
    terminated=[0, 1, 0],
    episode=[0, 0, 1],
)
TOLD = Recording(True, 2, 1, 2, 1, 1, 3, 4, ("one", "two"))


def full():
    rewards = [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]
    return TransitionCounts(
        [0, 1], [0, 1], [1, 2], [2, 1], [0, 1], *rewards, recording=TOLD, sample=LOG
    )


def test_it_counts_and_prints():
    counts = full()
    assert len(counts) == 3
    assert_array_equal(counts.counts(3, 2).toarray(), LOG.counts(3, 2).toarray())
    assert (
        counts.describe()
        == "3 transitions, 2 different, of 3 files in 2 episodes of 1 to 2 steps: 1"
        " terminated, 1 truncated; states 0..2, actions 0..1; rewards 0 to 1; 2"
        " whole episodes kept; 4 invalid rows dropped, 1 episodes broken"
    )
    assert counts.summary()["why"] == ("one", "two")
    assert "counted" in counts._repr_html_()
    with pytest.raises(ValueError, match="read-only"):
        counts.state[0] = 1
    with pytest.raises(
        ValueError, match="discount must be left out where counts are given"
    ):
        counts.counts(3, 2, discount=0.9)
    with pytest.raises(ValueError, match=r"log\.state\[1\] must be in 0\.\.0; it is 1"):
        counts.counts(1, 2)


def test_a_matrix_is_a_log_of_counts():
    matrix = LOG.counts(3, 2)
    counts = TransitionCounts.of(matrix, 2)
    assert_array_equal(counts.counts(3, 2).toarray(), matrix.toarray())
    assert counts.by_episodes


@pytest.mark.parametrize("make", [full, lambda: TransitionCounts([0], [0], [1], [0.5])])
def test_its_file_gives_back_every_bit(tmp_path, make):
    counts = make()
    counts.save(tmp_path / "c.npz")
    again = TransitionCounts.load(tmp_path / "c.npz")
    assert again.columns().keys() == counts.columns().keys()
    for name, column in counts.columns().items():
        assert_array_equal(getattr(again, name), column)
        assert getattr(again, name).dtype == column.dtype
    assert again.recording == counts.recording
    assert (again.sample is None) == (counts.sample is None)
    if counts.sample is not None:
        for name, column in counts.sample.columns().items():
            assert_array_equal(getattr(again.sample, name), column)


def test_a_file_that_has_changed_is_refused(tmp_path):
    full().save(tmp_path / "c.npz")
    arrays = dict(np.load(tmp_path / "c.npz"))
    arrays["count"][0] += 1
    for _ in range(2):
        np.savez(tmp_path / "c.npz", **arrays)
        with pytest.raises(
            ValueError, match=r"c\.npz' must hold the arrays that were saved"
        ):
            TransitionCounts.load(tmp_path / "c.npz")
        arrays.pop(DIGEST, None)
    arrays.pop(KIND)
    for changed, text in (
        (arrays | {"extra": np.zeros(1)}, "the parts of counts alone; it has 'extra'"),
        ({"state": arrays["state"]}, "must hold every part of counts"),
    ):
        save_npz(tmp_path / "c.npz", "transition_counts", changed)
        with pytest.raises(ValueError, match=text):
            TransitionCounts.load(tmp_path / "c.npz")
    LOG.save(tmp_path / "log.npz")
    with pytest.raises(
        ValueError,
        match=r"must hold a counted log .* it holds a log of numbered states",
    ):
        TransitionCounts.load(tmp_path / "log.npz")


# ---- logs that hold names, streamed: matched to the simulator's, in memory of the
# counts
ROOMS = ("hall", ("room", 2), "dock", "über,all")
HEADINGS = ("go", "stay")


def named_simulator():
    rows = np.full((4, 2, 4), 0.25)
    return oee.FiniteMDP(
        rows, np.zeros(4), 0, 0.9, state_names=ROOMS, action_names=HEADINGS
    )


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".npz"])
@pytest.mark.parametrize("actions", ["names", "numbers"])
def test_logs_of_names_are_counted_by_the_simulators(tmp_path, ending, actions):
    simulator = named_simulator()
    if actions == "numbers":
        simulator = simulator.with_names(ROOMS)
    log = oee.sample_episodes(simulator, oee.uniform_policy(simulator), 40, 10, seed=0)
    columns = log.columns()
    for label in ("state", "next_state"):
        columns[label] = [ROOMS[s] for s in columns[label]]
    if actions == "names":
        columns["action"] = [HEADINGS[a] for a in columns["action"]]
    Transitions(**columns).save(tmp_path / f"named{ending}")
    log.save(tmp_path / "numbers.npz")
    found = Transitions.open(tmp_path / f"named{ending}", simulator=simulator)
    plain = Transitions.open(tmp_path / "numbers.npz")
    for name in ("state", "action", "next_state", "count", "reward_sum"):
        assert_array_equal(getattr(found, name), getattr(plain, name))
    assert found.sample.state_names is None
    assert oee.Problem(simulator, found).observed.sum() == 400


def test_a_dictionary_of_names(tmp_path):
    frame = pd.DataFrame(
        {
            "state": ["hall", "dock"],
            "action": ["go", "go"],
            "next_state": ["dock", "hall"],
        }
    )
    frame.astype("category").to_parquet(tmp_path / "log.parquet")
    assert Transitions.open(
        tmp_path / "log.parquet", simulator=named_simulator()
    ).state.tolist() == [0, 2]


def test_numbers_after_names_and_names_that_come_late(tmp_path):
    (tmp_path / "a.csv").write_text("state,action,next_state\n0,go,2\n3,stay,0\n")
    (tmp_path / "b.csv").write_text("state,action,next_state\nhall,go,dock\n")
    found = Transitions.open(
        [tmp_path / "a.csv", tmp_path / "b.csv"], simulator=named_simulator()
    )
    assert (found.state.tolist(), found.count.tolist()) == ([0, 3], [2.0, 1.0])


@pytest.mark.parametrize(
    ("row", "text"),
    [
        (
            "hal,go,dock",
            (
                r"log\.csv': state\[1\] must be one of the simulator's names; it is"
                r" 'hal' \(did you mean 'hall'\?\)"
            ),
        ),
        (
            "hall,jump,dock",
            (
                r"log\.csv': action\[1\] must be one of the simulator's names; it is"
                r" 'jump' \("
            ),
        ),
        ("hall,go,", r"log\.csv': next_state\[1\] must have a value; it has none"),
        (
            "hall,go,7",
            r"log\.csv': next_state\[1\] must be one of the simulator's names; it is 7",
        ),
    ],
)
def test_names_that_the_simulator_has_not(tmp_path, row, text):
    path = tmp_path / "log.csv"
    path.write_text(f"state,action,next_state\nhall,stay,hall\n{row}\n")
    with pytest.raises(ValueError, match=text):
        Transitions.open(path, simulator=named_simulator())
    dropped = Transitions.open(path, simulator=named_simulator(), bad_rows="drop")
    assert (dropped.recording.dropped, len(dropped)) == (1, 1)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_episodes_may_be_called_by_texts(tmp_path, ending):
    simulator = named_simulator()
    log = oee.sample_episodes(simulator, oee.uniform_policy(simulator), 20, 7, seed=0)
    frame = pd.DataFrame(log.columns()).assign(
        episode=[f"run {k} of May" for k in log.episode]
    )
    path = tmp_path / f"log{ending}"
    (frame.to_csv if ending == ".csv" else frame.to_parquet)(path, index=False)
    assert_array_equal(Transitions.load(path).episode, log.episode)
    assert_array_equal(Transitions(**frame.to_dict("list")).episode, log.episode)
    found = Transitions.open(path)
    assert (
        found.recording.episodes,
        found.recording.shortest,
        found.recording.longest,
    ) == (20, 7, 7)
    assert found.sample.n_episodes == 20
    swapped = pd.concat([frame.iloc[:7], frame.iloc[14:21], frame.iloc[:7]])
    (swapped.to_csv if ending == ".csv" else swapped.to_parquet)(path, index=False)
    for read in (Transitions.load, Transitions.open):
        with pytest.raises(
            ValueError,
            match=r"episode must (keep the rows of an episode together|.*begins again)",
        ):
            read(path)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"episodes": "rubbish"},
            "recording's episodes must be an integer in .* is 'rub",
        ),
        ({"files": None}, "recording's files must be an integer"),
        ({"longest": 2.5}, "recording's longest must be an integer"),
        ({"shortest": 3}, "recording's shortest must be at most longest, 2; it is 3"),
        ({"dropped": -1}, r"dropped must be an integer in 0..2\*\*53; it is -1"),
        ({"episodes": 2**70}, r"episodes must be an integer in 0..2\*\*53; it is 118"),
        ({"by_episodes": 2}, "recording's by_episodes must be 0 or 1"),
        ({"reasons": "one"}, "recording's reasons must be texts; got str"),
        ({"reasons": (1,)}, r"recording's reasons\[0\] must be a text; it is 1"),
        ({"reasons": ("\x1b[2J",)}, r"reasons\[0\] must be a text without control"),
    ],
)
def test_a_recording_is_checked_where_it_is_given(changes, text):
    with pytest.raises(oee.exceptions.ArgumentError, match=text):
        TransitionCounts([0], [0], [1], [1], recording=TOLD._replace(**changes))
