"""One matrix on the pattern of another."""

import numpy as np
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_array_equal
from scipy import sparse

from oee_tabular._sparse import align, canonical, find


@given(rngs)
def test_values_on_another_pattern(rng):
    """As dense arrays say; the other pattern may be the same."""
    shape = tuple(rng.integers(1, 9, size=2))
    table = np.where(rng.random(shape) < rng.random(), rng.random(shape), 0)
    other = table if rng.random() < 0.2 else rng.permuted(table, axis=1)
    source, pattern = (canonical(sparse.csr_array(each), drop_zeros=False) for each in (table, other))
    values, stored = align(source, pattern)
    there = np.nonzero(other)
    assert_array_equal(values, table[there])
    assert_array_equal(stored, table[there] != 0)
    place, is_found = find(source, *there)
    assert_array_equal(is_found, stored)
    assert_array_equal(source.data[place[stored]], values[stored])
