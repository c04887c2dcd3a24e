"""Rows of a simulator: what is fitted block by block is what is fitted at once."""

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.mdp.rows import Rows, distinct_rows


@given(rngs)
def test_distinct_rows_are_numpys(rng):
    table = rng.integers(-2, 2, size=(rng.integers(1, 40), rng.integers(1, 4))) / 3
    kinds, kind = distinct_rows(table)
    expected, place = np.unique(table, axis=0, return_inverse=True)
    assert_array_equal(kinds, expected)
    assert_array_equal(kind, place.reshape(-1))


@given(rngs)
def test_rows_are_centred_by_numpy_or_by_a_sparse_product(rng):
    simulator = random_mdp(rng)
    rows, matrix = Rows.of(simulator), simulator.transitions
    values = rng.normal(size=(matrix.nnz, 2))
    means = np.add.reduceat(matrix.data[:, None] * values, matrix.indptr[:-1])
    expected = values - np.repeat(means, np.diff(matrix.indptr), axis=0)
    for few in (0, 10**6):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("oee_tabular.mdp.rows.SMALL", few)
            assert_allclose(rows.center(values), expected, atol=1e-13)


# ---- block by block ----------------------------------------------------------------------------------------------


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
