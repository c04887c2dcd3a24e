"""One matrix on the pattern of another."""

import numpy as np
from helpers import rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular._sparse import align, canonical, find


def some_matrix(rng, shape):
    return canonical(
        sparse.csr_array(np.where(rng.random(shape) < rng.random(), rng.random(shape), 0)), drop_zeros=False
    )


@given(rngs, st.integers(1, 9), st.integers(1, 9))
def test_values_on_another_pattern(rng, n_rows, n_columns):
    """As dense arrays say."""
    source, pattern = (some_matrix(rng, (n_rows, n_columns)) for _ in range(2))
    there = pattern.toarray() != 0
    values, stored = align(source, pattern)
    assert_array_equal(values, source.toarray()[there])
    assert_array_equal(stored, source.toarray()[there] != 0)


@given(rngs, st.integers(1, 9), st.integers(1, 9))
def test_where_moves_are(rng, n_rows, n_columns):
    matrix = some_matrix(rng, (n_rows, n_columns))
    rows, columns = np.indices(matrix.shape).reshape(2, -1)
    place, stored = find(matrix, rows, columns)
    dense = matrix.toarray().reshape(-1)
    assert_array_equal(stored, dense != 0)
    assert_array_equal(matrix.data[place[stored]], dense[stored])
    assert not place[~stored].any()


def test_rewards_of_the_moves_that_there_are_take_no_room_for_places():
    grid = oee.tasks.gridworld(3, 0.1)
    assert np.shares_memory(grid.transition_rewards.indices, grid.transitions.indices)
    assert np.shares_memory(grid.transition_rewards.data, grid.reward_data)
