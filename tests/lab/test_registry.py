"""Experiments as data: cells, streams, the paper's numbers."""

import numpy as np
import pytest
from lab.noise import experiment
from numpy.testing import assert_array_equal

from oee_tabular.lab.experiment import Stream
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.experiments.common import published, published_at

CELL = {"n": 1, "case": "a", "repetition": 3}


def test_cells_are_the_product_of_axes_and_repetitions_in_order():
    own = experiment(axes={"n": (1, 2, 3), "case": ("a", "b")}, repetitions=9, smoke={"n": (2, 3)})
    cells = own.settings(repetitions=2).cells()
    assert len(cells) == 12
    assert cells[0] == {"n": 1, "case": "a", "repetition": 0}
    assert cells[1] == {"n": 1, "case": "a", "repetition": 1}
    assert cells[-1] == {"n": 3, "case": "b", "repetition": 1}
    smoke = [{"n": n, "case": "a", "repetition": 0} for n in (2, 3)]  # the first of what is not named, one seed
    assert own.settings(smoke=True).cells() == smoke
    assert len(own.settings(smoke=True, repetitions=5).cells()) == 10


def test_the_smoke_cells_are_cells_of_the_full_sweep():
    for own in EXPERIMENTS.values():
        full, smoke = (own.settings(smoke=flag).cells() for flag in (False, True))
        assert all(cell in full for cell in smoke)
        assert 0 < len(smoke) <= 8


def test_a_stream_depends_on_the_seed_the_experiment_the_cell_and_the_use():
    cells = [CELL, CELL | {"n": 2}, CELL | {"repetition": 1}]
    streams = [Stream("some", 0, cell) for cell in cells] + [Stream("other", 0, CELL), Stream("some", 1, CELL)]
    draws = [stream.generator().random(4) for stream in streams]
    draws += [streams[0].generator(use=use).random(4) for use in ("rollouts", "simulator")]
    assert len({tuple(draw) for draw in draws}) == 7
    assert_array_equal(Stream("some", 0, dict(reversed(CELL.items()))).generator().random(4), draws[0])


def test_named_settings_share_a_stream():
    one, two, other = (Stream("some", 0, CELL | change) for change in ({}, {"case": "b"}, {"repetition": 4}))
    assert_array_equal(one.generator("n").random(3), two.generator("n").random(3))
    assert (one.generator("case").random(3) != two.generator("case").random(3)).all()
    assert (one.generator("n").random(3) != other.generator("n").random(3)).all()


def test_the_stream_is_pinned():
    """Another version must not change the numbers of a saved table silently."""
    stream = Stream("fig1a", 0, {"data": "uniform", "grid": 10, "n": 1000, "repetition": 2})
    assert stream.sequence().spawn_key[-1] == 2
    assert stream.generator().integers(1 << 30, size=3).tolist() == [189595970, 308855473, 571500491]


def test_the_papers_numbers():
    points = published("fig1a", "grid=10", "mean_absolute_error_of_zeta")
    assert points.x.tolist() == [1000, 3162, 10000, 31623, 100000, 316228]
    assert published_at("fig1a", "grid=40", "mean_absolute_error_of_zeta", 316228) == pytest.approx(0.0715476503)
    assert np.isnan(published_at("fig1a", "grid=20", "mean_absolute_error_of_zeta", 1000))
