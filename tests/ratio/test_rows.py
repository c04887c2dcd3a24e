"""Rows of a simulator: entries, sums and centring, against dense loops."""

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.mdp import rows as of_rows
from oee_tabular.mdp.rows import Rows, distinct_rows


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
    rows, expected = Rows.of(simulator).select(chosen), by_hand(simulator, chosen)
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
            patch.setattr(of_rows, "SMALL", few)  # by a sparse product, and by numpy
            assert_allclose(rows.center(values), centred, atol=1e-13)
    assert_allclose(rows.center(values[:, 1]), centred[:, 1], atol=1e-13)


@given(rngs)
def test_distinct_rows_are_numpys(rng):
    table = rng.integers(-2, 2, size=(rng.integers(1, 40), rng.integers(1, 4))) / 3
    kinds, kind = distinct_rows(table)
    expected, place = np.unique(table, axis=0, return_inverse=True)
    assert_array_equal(kinds, expected)
    assert_array_equal(kind, place.reshape(-1))


# ---- block by block ----------------------------------------------------------------------------------------------


@given(rngs, st.integers(1, 40))
def test_blocks_are_the_rows_in_turn(rng, size):
    simulator = random_mdp(rng)
    whole = Rows.of(simulator)
    chosen = whole.select(rng.random(len(whole)) < 0.7) if rng.random() < 0.5 else whole
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("oee_tabular.mdp.rows.BLOCK", size)
        blocks = list(chosen.blocks())
    for part in ("number", "arrival", "weights"):
        parts = [getattr(block, part) for block in blocks]
        assert_array_equal(np.concatenate(parts) if parts else [], getattr(chosen, part))
    data = simulator.transitions.data
    for block in blocks:
        assert block.indptr[0] == 0
        assert_allclose(block.sums(data[block.entries]), 1.0)
        assert_array_equal(simulator.transitions.indices[block.entries], block.arrival)


def test_entries_of_some_of_a_blocks_rows():
    whole = Rows.of(random_mdp(np.random.default_rng(1), n_states=8, n_actions=3))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("oee_tabular.mdp.rows.BLOCK", 10)
        _, second, *_ = whole.blocks()
        patch.setattr("oee_tabular.mdp.rows.BLOCK", 4)
        inner = [block.entries for block in second.blocks()]
    assert len(inner) > 1
    assert (inner[0].start, inner[-1].stop) == (second.entries.start, second.entries.stop)
    odd = second.number % 2 == 1
    some = second.select(odd)
    expected = np.concatenate([np.arange(*whole.indptr[k : k + 2]) for k in second.number[odd]])
    assert_array_equal(np.arange(whole.indptr[-1])[some.entries], expected)


OPTIONS = {
    "average": {},
    "tilt": {"prior": "tilt"},
    "box and ridge": {"prior": "simulator", "ridge": 0.1, "lower": 0.2, "upper": 3.0},
    "nothing": {"prior": "none", "ridge": lambda n: 1.0 / n},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_fit_by_blocks_is_that_of_all_rows_at_once(name, monkeypatch):
    simulator, target = oee.tasks.gridworld(5, 0.3), oee.tasks.gridworld(5, 0.1)
    policy = oee.tasks.gridworld_expert(5)
    log = oee.sample_episodes(target, oee.uniform_policy(target), 15, 30, seed=0)
    about = {} if OPTIONS[name] else {"values_of": policy}
    gradient = np.random.default_rng(0).normal(size=simulator.transitions.nnz)
    found = []
    for size in (2**18, 37):
        monkeypatch.setattr("oee_tabular.mdp.rows.BLOCK", size)
        monkeypatch.setattr("oee_tabular.ratio.conditional.BLOCK", size)
        fit = oee.transition_ratio(log, simulator, **about, **OPTIONS[name])
        step = fit.one_step(gradient)
        errors = [fit.log_standard_error(gradient), step.change, step.standard_error, step.unseen, step.change_error]
        found.append([fit.values.data, fit.gap, *fit.details["enclosure"], np.array(errors), fit.likeliest])
    for one, other in zip(*found, strict=True):
        assert_allclose(one, other, rtol=1e-12, atol=1e-14)
