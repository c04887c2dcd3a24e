"""Weights along a walk: how fast they grow, and where they stand still."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact import weight_growth, weight_moments

KINDS = ("per_decision", "trajectory")


@pytest.mark.parametrize("n", [3, 400, 401, 450])
def test_growth_of_large_and_small_chains(n):
    """A ring with zeta = 2: E W_t^2 = 4^t at every size; without weight minus infinity."""
    ring = sparse.csr_array((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
    mdp = FiniteMDP(ring, np.ones(n), np.full(n, 1 / n), 0.9)
    ones = np.ones((n, 1))
    assert_allclose(weight_growth(mdp, ring * 2.0, ones), np.log(4.0), rtol=1e-9)
    assert_allclose(weight_growth(mdp, ring * 0.5, ones), np.log(0.25), rtol=1e-9)
    assert weight_growth(mdp, ring * 0.0, ones) == -np.inf
    first, second = weight_moments(mdp, ring * 2.0, ones, horizon=3)
    assert_allclose(first, [1, 2, 4, 8])
    assert_allclose(second, [1, 4, 16, 64])


def test_an_infinite_sum_of_states_that_are_never_entered():
    """The last state is only a start: no column of the weighted kernel, and yet a row."""
    mdp = FiniteMDP(
        np.array([[[0.5, 0.5, 0.0]], [[0.5, 0.5, 0.0]], [[1.0, 0.0, 0.0]]]), [1.0, 2.0, 5.0], [0, 0, 1], 0.5
    )
    endless, long = (oee.return_moments(mdp, np.ones((3, 1)), horizon=h, sources=True) for h in (None, 60))
    assert_allclose((endless.mean, endless.variance), (long.mean, long.variance), rtol=1e-12)
    assert_allclose(endless.by_state, long.by_state, rtol=1e-12)
    assert weight_growth(mdp, oee.true_ratio(mdp, mdp), np.ones((3, 1))) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("self_normalized", [False, True])
def test_ratios_of_transitions_in_absorbing_states_do_not_count(kind, self_normalized):
    simulator = oee.tasks.gridworld(3, 0.3)
    zeta = oee.true_ratio(oee.tasks.gridworld(3, 0.2), simulator).values.copy()
    other = zeta.copy()
    over = np.repeat(simulator.absorbing(), simulator.n_actions)
    other.data[over[np.repeat(np.arange(zeta.shape[0]), np.diff(zeta.indptr))]] = 1.7
    assert (other.data == 1.7).sum() == simulator.n_actions
    policy = oee.tasks.gridworld_expert(3)
    one, two = (
        exact.weighted_return_moments(simulator, z, policy, kind=kind, horizon=6, self_normalized=self_normalized)
        for z in (zeta, other)
    )
    assert (one.mean, one.variance) == (two.mean, two.variance)
    assert_array_equal(*(weight_moments(simulator, z, policy, horizon=6) for z in (zeta, other)))


@pytest.mark.parametrize("kind", KINDS)
def test_without_any_weight_nothing_is_left_to_divide_by(kind):
    chain = FiniteMDP(np.full((2, 1, 2), 0.5), [1.0, 2.0], [1, 0], 0.9)
    nothing = sparse.csr_array(np.zeros((2, 2)))
    with pytest.warns(UserWarning, match="all weights of a step are 0"):
        found = oee.weighted_return_moments(
            chain, nothing, np.ones((2, 1)), kind=kind, horizon=2, self_normalized=True, sources=True
        )
    assert np.isnan([found.mean, found.variance, found.bias]).all()
    plain = oee.weighted_return_moments(chain, nothing, np.ones((2, 1)), kind=kind, horizon=2)
    assert (plain.mean, plain.variance, plain.bias) == ((1.0 if kind == "per_decision" else 0.0), 0.0, 0.0)
