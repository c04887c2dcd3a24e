"""What a simulator supports of a log's moves, and the log's own frequencies, against dense arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

from oee_tabular.continuous.simulator import ContinuousSimulator
from oee_tabular.continuous.support import frequencies, staying, supported
from oee_tabular.tasks import CartPole, cartpole_policy

seeds = st.integers(0, 2**32 - 1)


def pair(seed, n_states=4, n_actions=2):
    rng = np.random.default_rng(seed)
    shape = (n_states * n_actions, n_states)
    counts = rng.integers(0, 3, shape) * (rng.random(shape) < 0.5)
    return counts.astype(float), rng.random(shape) * (rng.random(shape) < 0.6)


@given(seeds)
def test_what_is_supported_lies_where_there_is_probability(seed):
    counts, transitions = pair(seed)
    unsorted = sparse.csr_array(sparse.diags_array(np.ones(len(counts))) @ sparse.csr_array(transitions))
    kept, lost = supported(sparse.csr_array(counts), unsorted)
    assert_array_equal(kept.toarray(), counts * (transitions > 0))
    assert (kept.data > 0).all()
    assert_allclose(lost, counts[transitions == 0].sum() / counts.sum() if counts.any() else 0.0, atol=1e-12)


@given(seeds)
def test_a_stored_zero_is_no_probability(seed):
    counts, transitions = pair(seed)
    stored = sparse.csr_array(np.ones_like(transitions))
    stored.data[:] = transitions.ravel()
    assert_array_equal(supported(sparse.csr_array(counts), stored)[0].toarray(), counts * (transitions > 0))


@given(seeds)
def test_frequencies_are_the_log_s_rows_and_stay_elsewhere(seed):
    counts, _ = pair(seed)
    found = frequencies(sparse.csr_array(counts), 2).toarray()
    assert_allclose(found.sum(axis=1), 1.0)
    for row, seen in enumerate(counts):
        expected = seen / seen.sum() if seen.any() else np.eye(4)[row // 2]
        assert_allclose(found[row], expected, rtol=1e-15)


def test_staying_leads_the_given_rows_to_their_own_state():
    rows = np.array([True, False, False, True, True, True])
    expected = np.zeros((6, 3))
    expected[0, 0] = expected[3, 1] = expected[4, 2] = expected[5, 2] = 1.0
    assert_array_equal(staying(rows, 2).toarray(), expected)


def test_a_simulator_on_its_own_cells_may_refuse_a_grid():
    simulator = ContinuousSimulator(
        "here", CartPole(), cartpole_policy(0.0), (32, 32), 10, no_grid="here: it has its own"
    )
    assert simulator.build().mdp.n_states == 32 * 32 + 1
    with pytest.raises(ValueError, match="grid must be left out for here: it has its own"):
        simulator.build(grid=(3, 3))
