"""Experiments as data: cells, streams, choosing by id."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from oee_tabular.lab.experiments import paper
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.registry import Experiment, Registry, Settings, Stream


def made(name="some", **options):
    plain = {
        "title": "Some",
        "axes": {"n": (1, 2, 3), "case": ("a", "b")},
        "run": lambda cell, stream: [{"x": 1.0}],
        "keys": ("n",),
        "measures": ("x",),
        "draw": lambda table, summary, figure: None,
        "caption": "",
    }
    return Experiment(id=name, **(plain | options))


def test_cells_are_the_product_of_axes_and_repetitions_in_order():
    cells = made(repetitions=2).settings().cells()
    assert len(cells) == 12
    assert cells[0] == {"n": 1, "case": "a", "repetition": 0}
    assert cells[1] == {"n": 1, "case": "a", "repetition": 1}
    assert cells[-1] == {"n": 3, "case": "b", "repetition": 1}


def test_the_smoke_cells_are_cells_of_the_full_sweep():
    for experiment in EXPERIMENTS:
        full, smoke = (experiment.settings(smoke=flag).cells() for flag in (False, True))
        assert all(cell in full for cell in smoke)
        assert 0 < len(smoke) <= 8
    with pytest.raises(ValueError, match=r"smoke\['n'\] must be a subset of the axis; it has \[7\]"):
        made(smoke={"n": (7,)})


def test_seeds_replace_the_repetitions():
    assert len(made(repetitions=9).settings(repetitions=1).cells()) == 6
    assert len(made(repetitions=9).settings(smoke=True, repetitions=1).cells()) == 6
    assert len(made(repetitions=9).settings(smoke=True, repetitions=5).cells()) == 12  # no more than smoke has
    with pytest.raises(ValueError, match="repetitions must be at least 1; got 0"):
        made().settings(repetitions=0)


def test_a_stream_depends_on_the_seed_the_experiment_and_the_cell():
    cell = {"n": 1, "case": "a", "repetition": 0}
    draws = [
        Stream(name, seed, {**cell, **change}).generator().random(4)
        for name, seed, change in (
            ("some", 0, {}), ("other", 0, {}), ("some", 1, {}), ("some", 0, {"n": 2}), ("some", 0, {"repetition": 1}),
        )
    ]  # fmt: skip
    assert len({tuple(draw) for draw in draws}) == 5
    assert_array_equal(Stream("some", 0, dict(reversed(cell.items()))).generator().random(4), draws[0])


def test_named_settings_share_a_stream():
    one, two = (Stream("some", 0, {"n": 1, "case": case, "repetition": 3}) for case in "ab")
    assert_array_equal(one.generator("n").random(3), two.generator("n").random(3))
    assert (one.generator("case").random(3) != two.generator("case").random(3)).all()
    other = Stream("some", 0, {"n": 1, "case": "a", "repetition": 4})
    assert (one.generator("n").random(3) != other.generator("n").random(3)).all()


def test_uses_have_numbers_of_their_own():
    stream = Stream("some", 0, {"n": 1, "repetition": 0})
    draws = [stream.generator(use=use).random(3) for use in ("", "rollouts", "simulator")]
    assert len({tuple(draw) for draw in draws}) == 3
    assert_array_equal(stream.generator(use="rollouts").random(3), draws[1])
    with pytest.raises(ValueError, match="names must be settings of the cell, n, repetition; got 'gird'"):
        stream.generator("gird")


def test_the_stream_is_pinned():
    """Another version must not change the numbers of a saved table silently."""
    stream = Stream("fig1a", 0, {"data": "uniform", "grid": 10, "n": 1000, "repetition": 2})
    assert stream.sequence().spawn_key[-1] == 2
    assert stream.generator().integers(1 << 30, size=3).tolist() == PINNED


PINNED = [189595970, 308855473, 571500491]


def test_choosing():
    registry = Registry([made("one"), made("two", group="gymnasium"), made("three")])
    assert [e.id for e in registry.choose(["two", "one", "two"])] == ["two", "one"]
    assert [e.id for e in registry.choose([], everything=True)] == ["one", "two", "three"]
    assert [e.id for e in registry.choose(["gridworld"])] == ["one", "three"]
    with pytest.raises(ValueError, match="experiment must be one of one, two, three; got 'twoo'; nearest: two"):
        registry.choose(["twoo"])
    with pytest.raises(ValueError, match="one experiment or more must be given, or --all; there are one, two, three"):
        registry.choose([])
    with pytest.raises(ValueError, match="--all must be given without ids; got one"):
        registry.choose(["one"], everything=True)
    with pytest.raises(ValueError, match="experiment ids must differ; 'one' is there twice"):
        Registry([made("one"), made("one")])


def test_settings_as_a_file_has_them():
    settings = Settings(made(), {"n": (1, 2)}, 3, 4)
    assert settings.as_dict() == {"experiment": "some", "axes": {"n": [1, 2]}, "repetitions": 3, "seed": 4}


def test_the_paper_s_numbers():
    points = paper.curve("fig1a", "grid=10", "mean_absolute_error_of_zeta")
    assert isinstance(points, pd.DataFrame)
    assert points.x.tolist() == [1000, 3162, 10000, 31623, 100000, 316228]
    assert paper.at("fig1a", "grid=40", "mean_absolute_error_of_zeta", 316228) == pytest.approx(0.0715476503)
    assert np.isnan(paper.at("fig1a", "grid=20", "mean_absolute_error_of_zeta", 1000))


def test_a_few_cells_as_a_table():
    experiment = EXPERIMENTS["estimands"]
    table = experiment.table(delta=[0.1, 0.5], repetitions=2)
    assert len(table) == 2 * 2 * 4
    cell = {"delta": 0.5, "repetition": 1}
    rows = experiment.run(cell, Stream("estimands", 0, cell))
    assert table.tail(4).value.tolist() == [row["value"] for row in rows]
    same = experiment.table(delta=np.float64(0.5)), experiment.table(delta=[0.5])
    assert same[0].equals(same[1])
    with pytest.raises(ValueError, match="axes must be among delta; got 'n'"):
        experiment.table(n=3)


def documented(cell, stream):
    """What the figure shows,
    in two lines.
    """
    return [{"x": 1.0}]


def test_the_caption_is_the_cells_docstring():
    assert made(run=documented).caption == "What the figure shows, in two lines."
    assert made(run=documented, caption="Another.").caption == "Another."
    assert made(run=lambda cell, stream: []).caption == ""
