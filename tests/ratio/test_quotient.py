"""The quotient of two ratios, and the data of the simulator that it is fitted against."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, LOG, POLICY, SIMULATOR, fit
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions


@pytest.mark.parametrize("method", ["ratio_of_ratios", "joint"])
def test_the_ridge_reaches_both_betas(method):
    """A strong ridge towards 1 (the quotient) or 0 with the sums kept (joint) makes zeta nearly 1."""
    options = {"method": method, "simulator_data": "exact", "behavior_policy": POLICY}
    free, bent = (fit(COUNTS + 1.0, ridge=ridge, **options).values.data for ridge in (None, 1e4))
    assert np.abs(free - 1).max() > 0.3
    assert np.abs(bent - 1).max() < 0.1
    assert_array_equal(free, fit(COUNTS + 1.0, ridge=0.0, **options).values.data)
    of_n, given_number = (fit(COUNTS + 1.0, ridge=r, **options).values.data for r in (lambda n: 5.0 / n, 5.0 / 61.0))
    assert_allclose(of_n, given_number, rtol=1e-12)


def test_the_quotient_without_a_box_is_that_of_frequencies():
    """(n_x / q_x) / (n_sa / q_sa), normalised on each side; 1 where neither side has the move."""
    other = np.array([[2, 2, 4], [1, 0, 3], [5, 5, 2], [1, 1, 1], [0, 0, 0], [4, 0, 4]], dtype=float)
    state, action, following = [], [], []
    for row, j in np.argwhere(other > 0):
        for column, number in zip((state, action, following), (row // 2, row % 2, j), strict=True):
            column.extend([number] * int(other[row, j]))
    data = Transitions(state, action, following)
    counts = np.where(other > 0, COUNTS, 0.0)
    found = fit(counts, method="ratio_of_ratios", simulator_data=data, lower=0.0, upper=np.inf)
    n, m = counts.sum(axis=1, keepdims=True), other.sum(axis=1, keepdims=True)
    expected = np.divide(counts * m, other * n, out=np.ones((6, 3)), where=(other > 0) & (n > 0))
    assert_allclose(found.values.toarray(), expected, rtol=1e-8)
    facts = found.details
    assert facts["undetermined_moves"] == 5
    assert facts["moves_only_in_log"] == 0
    p, q = counts[counts > 0] / counts.sum(), other[counts > 0] / other.sum()
    assert_allclose(facts["divergence_moves"], p @ np.log(p / q), rtol=1e-8)
    pairs = [(a, b) for a, b in zip(n[:, 0] / n.sum(), m[:, 0] / m.sum(), strict=True) if a > 0]
    assert_allclose(facts["divergence_pairs"], sum(a * np.log(a / b) for a, b in pairs), rtol=1e-8)
    boxed = fit(method="ratio_of_ratios", simulator_data=data, lower=0.5, upper=1.5)
    assert boxed.details["moves_only_in_log"] == 1
    assert (boxed.details["lower"], boxed.details["upper"]) == (0.5, 1.5)
    moves = oee.density_ratio(COUNTS.reshape(-1), other.reshape(-1), lower=0.5, upper=1.5, toward=1.0).ratio
    low, high = (moves <= 0.5).mean(), (moves >= 1.5).mean()
    assert low > 0
    assert high > 0
    assert_allclose(boxed.details["share_at_the_box"], low + high)


def test_data_of_the_simulator():
    """Exact occupancies over the log's longest episode under its estimated policy; samples of the log's size, by the seed."""
    options = {"lower": 0.0, "upper": np.inf, "method": "ratio_of_ratios"}
    box = {"lower": 0.5, "upper": 1.5, "toward": 1.0}  # without one, the weights of q cancel
    for discount in (None, 0.5):
        exact = oee.transition_ratio(LOG, SIMULATOR, simulator_data="exact", discount=discount, **options | box)
        p = LOG.counts(3, 2, discount=discount).toarray().reshape(-1)
        actions = p.reshape(3, 2, 3).sum(axis=2)
        behavior, weighted = actions / actions.sum(axis=1, keepdims=True), SIMULATOR.with_discount(discount or 1.0)
        q = oee.occupancy(weighted, behavior, horizon=8, of="transition").data
        moves, pairs = (
            oee.density_ratio(p.reshape(-1, k).sum(axis=1), q.reshape(-1, k).sum(axis=1), **box) for k in (1, 3)
        )
        assert_allclose(exact.values.data, moves.ratio / np.repeat(pairs.ratio, 3), rtol=1e-9)
    data = oee.sample_episodes(SIMULATOR, POLICY, 200, 8, seed=1)
    given = oee.transition_ratio(LOG, SIMULATOR, simulator_data=data, discount=0.5, **options)
    p, q = (each.counts(3, 2, discount=0.5).toarray().reshape(-1) for each in (LOG, data))
    moves, pairs = (oee.density_ratio(p.reshape(-1, k).sum(axis=1), q.reshape(-1, k).sum(axis=1)) for k in (1, 3))
    assert_allclose(given.values.data, moves.ratio / np.repeat(pairs.ratio, 3), rtol=1e-9)
    drawn, again, other = (oee.transition_ratio(LOG, SIMULATOR, seed=k, **options) for k in (3, 3, 4))
    assert_array_equal(drawn.values.data, again.values.data)
    assert np.abs(drawn.values.data - other.values.data).max() > 1e-3
    assert drawn.details["beta"][0].q_total == len(LOG)


def test_logs_stop_where_an_episode_is_over():
    over = FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [1, 0], 0.9)
    fit = oee.transition_ratio(
        sparse.csr_array([[1.0, 1.0], [0.0, 0.0]]), over, method="ratio_of_ratios", simulator_data="exact"
    )
    assert_allclose(fit.values.data, 1.0, rtol=1e-12)
    assert fit.details["undetermined_moves"] == 1
