"""Rows of a simulator: entries, sums and centring, against dense loops."""

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.mdp import rows as of_rows
from oee_tabular.mdp.rows import Rows, distinct


def by_hand(simulator, chosen):
    """(s, a, s', P, place among the entries) of the chosen rows, one list a row."""
    matrix, found = simulator.transitions, []
    for row in range(matrix.shape[0]):
        if not chosen[row]:
            continue
        places = range(int(matrix.indptr[row]), int(matrix.indptr[row + 1]))
        s, a = divmod(row, simulator.n_actions)
        found.append([(s, a, int(matrix.indices[j]), float(matrix.data[j]), j) for j in places])
    return found


@given(rngs)
def test_entries_and_sums_of_chosen_rows(rng):
    simulator = random_mdp(rng)
    n_rows = simulator.n_states * simulator.n_actions
    chosen = rng.random(n_rows) < 0.6
    chosen[rng.integers(n_rows)] = True
    rows, expected = Rows.of(simulator, chosen), by_hand(simulator, chosen)
    assert len(rows) == len(expected)
    assert rows.state.tolist() == [row[0][0] for row in expected]
    assert rows.action.tolist() == [row[0][1] for row in expected]
    assert rows.arrival.tolist() == [x[2] for row in expected for x in row]
    assert rows.entries.tolist() == [x[4] for row in expected for x in row]
    assert_allclose(rows.weights, [x[3] / sum(y[3] for y in row) for row in expected for x in row], rtol=1e-15)
    values = rng.normal(size=(len(rows.arrival), 2))
    ends = np.cumsum([0] + [len(row) for row in expected])
    pieces = [slice(low, high) for low, high in zip(ends[:-1], ends[1:], strict=True)]
    sums = np.array([values[piece].sum(axis=0) for piece in pieces])
    assert_allclose(rows.sums(values), sums, atol=1e-13)
    assert_allclose(rows.sums(values[:, 0]), sums[:, 0], atol=1e-13)
    at_entries = [sums[k] for k, row in enumerate(expected) for _ in row]
    assert_array_equal(rows.spread(sums), at_entries)
    centred = np.concatenate([values[p] - rows.weights[p] @ values[p] for p in pieces])
    for few in (0, 10**6):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(of_rows, "FEW", few)  # by a sparse product, and by numpy
            assert_allclose(rows.centred(values), centred, atol=1e-13)
    assert_allclose(rows.centred(values[:, 1]), centred[:, 1], atol=1e-13)


@given(rngs)
def test_all_rows(rng):
    simulator = random_mdp(rng)
    rows = Rows.of(simulator)
    assert len(rows) == simulator.n_states * simulator.n_actions
    assert rows.entries == slice(0, simulator.transitions.nnz)
    assert_array_equal(rows.indptr, simulator.transitions.indptr)
    assert_array_equal(rows.arrival, simulator.transitions.indices)


def test_weights_that_sum_to_one_but_for_rounding_are_divided():
    simulator = random_mdp(np.random.default_rng(0), n_states=4, n_actions=2)
    slack = 1 + 1e-9
    simulator = simulator.with_transitions((simulator.transitions.toarray() * slack).reshape(4, 2, 4))
    rows = Rows.of(simulator)
    assert_allclose(rows.sums(rows.weights), 1.0, rtol=1e-15)


@pytest.mark.parametrize("d", [1, 3])
def test_the_mean_of_centred_values_is_zero_in_each_row(d):
    rng = np.random.default_rng(1)
    rows = Rows.of(random_mdp(rng, n_states=6, n_actions=3))
    values = rng.normal(size=(len(rows.arrival), d))
    assert_allclose(rows.sums(rows.weights[:, None] * rows.centred(values)), 0.0, atol=1e-14)


@given(rngs)
def test_distinct_rows_are_numpys(rng):
    table = rng.integers(-2, 2, size=(rng.integers(1, 40), rng.integers(1, 4))) / 3
    kinds, kind = distinct(table)
    expected, place = np.unique(table, axis=0, return_inverse=True)
    assert_array_equal(kinds, expected)
    assert_array_equal(kind, place.reshape(-1))
