"""Counts in place of a log: what they hold, their file."""

import numpy as np
import pytest
from kernels.files import DIGEST, KIND, save_npz
from numpy.testing import assert_array_equal

from oee_tabular import TransitionCounts, Transitions
from oee_tabular.data.counts import Recording

LOG = Transitions([0, 1, 0], [0, 1, 0], [1, 2, 1], [0.0, 1.0, 0.0], terminated=[0, 1, 0], episode=[0, 0, 1])
TOLD = Recording(True, 2, 1, 2, 1, 1, 3, 4, ("one", "two"))


def full():
    rewards = [0.0, 1.0], [0.0, 1.0], [0.0, 1.0]
    return TransitionCounts([0, 1], [0, 1], [1, 2], [2, 1], [0, 1], *rewards, recording=TOLD, sample=LOG)


def test_it_counts_and_prints():
    counts = full()
    assert len(counts) == 3
    assert_array_equal(counts.counts(3, 2).toarray(), LOG.counts(3, 2).toarray())
    assert counts.describe() == (
        "3 transitions, 2 different, of 3 files in 2 episodes of 1 to 2 steps: 1 terminated, 1 truncated; states 0..2, "
        "actions 0..1; rewards 0 to 1; 2 whole episodes kept; 4 invalid rows dropped, 1 episodes broken"
    )
    assert counts.summary()["why"] == ("one", "two")
    assert "counted" in counts._repr_html_()
    with pytest.raises(ValueError, match="read-only"):
        counts.state[0] = 1
    with pytest.raises(ValueError, match="discount must be left out where counts are given"):
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
        with pytest.raises(ValueError, match=r"c\.npz' must hold the arrays that were saved"):
            TransitionCounts.load(tmp_path / "c.npz")
        arrays.pop(DIGEST, None)
    arrays.pop(KIND)
    for changed, text in ((arrays | {"extra": np.zeros(1)}, "the parts of counts alone; it has 'extra'"),
                          ({"state": arrays["state"]}, "must hold every part of counts")):  # fmt: skip
        save_npz(tmp_path / "c.npz", "transition_counts", changed)
        with pytest.raises(ValueError, match=text):
            TransitionCounts.load(tmp_path / "c.npz")
    LOG.save(tmp_path / "log.npz")
    with pytest.raises(ValueError, match=r"must hold a counted log .* it holds a log of numbered states"):
        TransitionCounts.load(tmp_path / "log.npz")
