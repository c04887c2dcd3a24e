"""Experiments as data: cells, streams, choosing by id, the paper's numbers."""

import numpy as np
import pytest
from lab.noise import experiment
from numpy.testing import assert_array_equal

from oee_tabular.lab.experiments import paper
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.registry import Registry, RunSettings, Stream

CELL = {"n": 1, "case": "a", "repetition": 3}


def test_cells_are_the_product_of_axes_and_repetitions_in_order():
    own = experiment(axes={"n": (1, 2, 3), "case": ("a", "b")}, repetitions=9)
    cells = own.settings(repetitions=2).cells()
    assert len(cells) == 12
    assert cells[0] == {"n": 1, "case": "a", "repetition": 0}
    assert cells[1] == {"n": 1, "case": "a", "repetition": 1}
    assert cells[-1] == {"n": 3, "case": "b", "repetition": 1}
    assert [len(own.settings(smoke=True, repetitions=count).cells()) for count in (1, 5)] == [6, 12]  # smoke's at most
    with pytest.raises(ValueError, match="repetitions must be at least 1; got 0"):
        own.settings(repetitions=0)
    with pytest.raises(ValueError, match=r"smoke\['n'\] must be a subset of the axis; it has \[7\]"):
        experiment(smoke={"n": (7,)})


def test_the_smoke_cells_are_cells_of_the_full_sweep():
    for own in EXPERIMENTS:
        full, smoke = (own.settings(smoke=flag).cells() for flag in (False, True))
        assert all(cell in full for cell in smoke)
        assert 0 < len(smoke) <= 8


def test_a_stream_depends_on_the_seed_the_experiment_the_cell_and_the_use():
    changes = [
        ("some", 0, {}),
        ("other", 0, {}),
        ("some", 1, {}),
        ("some", 0, {"n": 2}),
        ("some", 0, {"repetition": 1}),
    ]
    draws = [Stream(name, seed, CELL | change).generator().random(4) for name, seed, change in changes]
    draws += [Stream("some", 0, CELL).generator(use=use).random(4) for use in ("rollouts", "simulator")]
    assert len({tuple(draw) for draw in draws}) == 7
    assert_array_equal(Stream("some", 0, dict(reversed(CELL.items()))).generator().random(4), draws[0])
    with pytest.raises(ValueError, match="names must be settings of the cell, n, case, repetition; got 'gird'"):
        Stream("some", 0, CELL).generator("gird")


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


def test_choosing():
    registry = Registry([experiment(id="one"), experiment(id="two", group="gymnasium"), experiment(id="three")])
    assert [e.id for e in registry.choose(["two", "one", "two"])] == ["two", "one"]
    assert [e.id for e in registry.choose([], everything=True)] == ["one", "two", "three"]
    assert [e.id for e in registry.choose(["gridworld"])] == ["one", "three"]
    with pytest.raises(ValueError, match="experiment ids must differ; 'one' is there twice"):
        Registry([experiment(id="one"), experiment(id="one")])


def test_settings_as_a_file_has_them():
    settings = RunSettings(experiment(), {"n": (1, 2)}, 3, 4)
    assert settings.as_dict() == {"experiment": "noise", "axes": {"n": [1, 2]}, "repetitions": 3, "seed": 4}


def test_the_papers_numbers():
    points = paper.curve("fig1a", "grid=10", "mean_absolute_error_of_zeta")
    assert points.x.tolist() == [1000, 3162, 10000, 31623, 100000, 316228]
    assert paper.at("fig1a", "grid=40", "mean_absolute_error_of_zeta", 316228) == pytest.approx(0.0715476503)
    assert np.isnan(paper.at("fig1a", "grid=20", "mean_absolute_error_of_zeta", 1000))


def test_a_few_cells_as_a_table():
    own = EXPERIMENTS["estimands"]
    table = own.table(delta=[0.1, 0.5], repetitions=2)
    assert len(table) == 2 * 2 * 4
    cell = {"delta": 0.5, "repetition": 1}
    assert table.tail(4).value.tolist() == [row["value"] for row in own.run(cell, Stream("estimands", 0, cell))]
    assert own.table(delta=np.float64(0.5)).equals(own.table(delta=[0.5]))


def test_the_caption_is_the_cells_docstring():
    def cell(cell, stream):
        """What the figure shows,
        in two lines.
        """

    assert experiment(cell, caption="").caption == "What the figure shows, in two lines."
    assert experiment(cell, caption="Another.").caption == "Another."
