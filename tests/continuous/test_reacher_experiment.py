"""Figure 3's settings, its table and its figure, on a cell of small cost."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from oee_tabular.lab.experiment import Stream
from oee_tabular.lab.experiments import reacher
from oee_tabular.lab.experiments.reacher import DELTAS, fig3
from oee_tabular.tasks import Reacher, VisitedCells, monte_carlo_value, reacher_log, reacher_policy


@pytest.fixture(scope="module")
def table():
    patch = pytest.MonkeyPatch()
    patch.setattr(reacher, "TRUTH_EPISODES", 256)
    patch.setattr(reacher, "MODEL_EPISODES", 64)
    patch.setattr(reacher, "CELLS", VisitedCells(200, n_simulated=1000, n_stepped=2000, max_steps=20))
    patch.setattr(reacher, "reacher_log", partial(reacher_log, max_steps=20))
    reacher.truth.cache_clear()
    settings = {"length": 0.05, "n": 3000, "repetition": 0}
    rows = fig3.run(settings, Stream("fig3", 0, settings))
    again = fig3.run(settings, Stream("fig3", 0, settings))
    patch.undo()
    reacher.truth.cache_clear()
    assert [row["value_0.5"] for row in rows] == [row["value_0.5"] for row in again]
    return pd.DataFrame([settings | row for row in rows])


def test_every_curve_is_there(table):
    shown = {reacher.WEIGHTED, reacher.AVERAGED, reacher.PLAIN, reacher.MODEL, reacher.LINEAR, reacher.RESIDUAL, reacher.ORACLE,
             reacher.SIMULATOR, reacher.OWN_REWARD, reacher.AVERAGE, reacher.UNKNOWN, reacher.UNKNOWN_AVERAGED}  # fmt: skip
    assert shown <= set(table.series)
    assert f"{reacher.WEIGHTED}, calibrated" in set(table.series)
    assert table.series.is_unique
    values, right = (table[[f"{what}_{d}" for d in DELTAS]].to_numpy() for what in ("value", "truth"))
    assert np.isfinite(values).all()
    assert_allclose(table.error, np.abs(values - right).mean(axis=1))
    assert (table[table.series == reacher.AVERAGED].uncovered == 0.0).all()
    left_out = table[table.series.isin([reacher.UNKNOWN, reacher.UNKNOWN_AVERAGED])]
    assert (left_out.uncovered > 0.0).all()  # without the target's own length, and with its log's moves
    assert left_out.weight_of_true_length.isna().all()
    assert (table[table.series == reacher.WEIGHTED].weight_of_true_length > 0.9).all()
    assert (table[table.series == reacher.SIMULATOR].uncovered > 0.3).all()


def test_the_paper_s_errors():
    """1.84, 4.88 and 15.7 for the long links, from its published points; none for the short ones."""
    names = [reacher.WEIGHTED, reacher.OWN_REWARD, reacher.MODEL, "other", reacher.WEIGHTED, reacher.WEIGHTED]
    lengths, sizes = [0.2, 0.2, 0.2, 0.2, 0.05, 0.2], [150_000] * 5 + [15_000]
    summary = pd.DataFrame({"length": lengths, "n": sizes, "series": names})
    assert_allclose(reacher.published_numbers(summary), [1.84, 4.88, 15.73, np.nan, np.nan, np.nan], atol=0.01)


def test_even_beginnings_have_the_same_mean():
    policy = reacher_policy(0.5)
    even, plain = (monte_carlo_value(task, policy, 4000, 20, seed=0) for task in (reacher.Even(), Reacher()))
    assert abs(even.value - plain.value) < 4 * np.hypot(even.standard_error, plain.standard_error)
    starts = reacher.Even().initial_states(1000, np.random.default_rng(0))
    assert (np.abs(starts) <= [3.14, 1.57, 0, 0]).all()
    assert_allclose(starts.mean(axis=0), 0.0, atol=0.01)
