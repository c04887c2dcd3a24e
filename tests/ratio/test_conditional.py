"""The conditional ratio: its prior row, its strength and its ridge."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, SIMULATOR, fit


def test_the_tilt_s_prior_row_and_strength():
    """(n + kappa m) / (n_sa + kappa) over P, m the tilt's row; the tilt's row alone where the log has none."""
    found = fit(prior="tilt", strength=5.0)
    P = SIMULATOR.transitions.toarray()
    base = P ** (1 + found.details["theta"][0])
    base /= base.sum(axis=1, keepdims=True)
    expected = (COUNTS + 5.0 * base) / (COUNTS.sum(axis=1, keepdims=True) + 5.0)
    assert_allclose(found.values.toarray() * SIMULATOR.transitions.toarray(), expected, rtol=1e-10)
    bare = fit(prior="tilt", strength=0.0)
    assert_allclose(bare.values.toarray()[4] * SIMULATOR.transitions.toarray()[4], base[4], rtol=1e-10)
    assert found.details["strength"] == 5.0
    ridged = fit(prior="simulator", strength=0.0, ridge=lambda n: 2.0 / n)
    same = fit(prior="simulator", strength=0.0, ridge=lambda n: 2.0 / n, toward=1.0)
    assert_array_equal(ridged.values.data, same.values.data)
    assert_array_equal(ridged.values.toarray()[4], np.ones(3))


@pytest.mark.parametrize("criterion", ["evidence", "loo"])
def test_a_chosen_ridge_is_kappa_over_the_count_of_each_row(criterion):
    """Also in a row of one move; and the criterion that was asked for is the one that is used."""
    counts = COUNTS.copy()
    counts[4] = [1.0, 0.0, 0.0]
    chosen = fit(counts, prior="none", ridge=criterion)
    assert chosen.details["ridge_by"] == criterion
    kappa = chosen.details["ridge_times_count"]
    assert kappa > 1.0
    same = fit(counts, prior="none", ridge=lambda n: kappa / n)
    assert_allclose(chosen.values.data, same.values.data, rtol=1e-9)
    assert fit(counts, prior="simulator", strength=criterion).details["strength_by"] == criterion
    kinds = fit(prior="simulator", strength=criterion).details["strength_kinds"]
    assert [(rows, moves) for rows, moves, _ in kinds] == [(5, 43)]  # of six rows, one without moves
