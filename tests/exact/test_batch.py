"""Many evaluations at once are the single ones."""

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs, survival_chain
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import exact


def same(found, models, policies, horizon=None):
    assert len(found) == len(models)
    for i, (model, policy) in enumerate(zip(models, policies, strict=True)):
        one = exact.evaluate_policy(model, policy, horizon=horizon)
        bound = found.error_bound[i] + one.error_bound if horizon is None else 1e-12 * (1 + np.abs(one.values).max())
        assert np.abs(found.values[i] - one.values).max() <= bound + 1e-300
        assert_allclose(found.value[i], one.value, rtol=1e-9, atol=1e-9)
        assert (horizon is None) == (found.error_bound[i] > 0) or not np.any(one.values)


@given(rngs, st.sampled_from([None, 1, 5]), st.booleans())
@settings(max_examples=40)
def test_a_batch_is_the_single_evaluations(rng, horizon, equal):
    count = int(rng.choice([1, 3, 70]))
    n = 3 if equal else None
    models = [random_mdp(rng, n_states=n, n_actions=2 if equal else None) for _ in range(count)]
    policies = [random_policy(rng, model) for model in models]
    found = exact.evaluate_batch(models, policies, horizon=horizon)
    same(found, models, policies, horizon)
    stacked = exact.evaluate_batch(exact.stack_models(models), policies, horizon=horizon)
    for ours, other in zip(found.values, stacked.values, strict=True):
        assert_array_equal(ours, other)
    if equal:
        assert found.values.shape == (count, 3)
        again = exact.evaluate_batch(models, np.array(policies), horizon=horizon)
        assert_array_equal(again.values, found.values)
        many = exact.evaluate_batch(models[0], np.array(policies), horizon=horizon)
        same(many, [models[0]] * count, policies, horizon)


def test_large_time_dependent_and_undiscounted_ones_are_evaluated_one_by_one():
    grid = oee.tasks.gridworld(7, 0.3)
    small = oee.tasks.gridworld(2, 0.3)
    models, policies = [grid, small], [oee.uniform_policy(grid), oee.uniform_policy(small)]
    same(exact.evaluate_batch(models, policies), models, policies)
    moving = [np.stack([oee.uniform_policy(small)] * 3)]
    same(exact.evaluate_batch([small], moving, horizon=3), [small], moving, 3)
    chain = survival_chain(1.0)
    assert_allclose(exact.evaluate_batch(chain, [np.ones((2, 1))]).value, 1 / 0.3)


def test_kernels_beyond_one_are_certified_or_said_to_diverge():
    mdp = oee.FiniteMDP(np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), [1.0, 1.0], [1, 0], 0.5)
    ratio = mdp.transitions.copy()
    ratio.data = np.array([3.0, 1.0])
    found = exact.evaluate_batch([exact.reweight(mdp, ratio), mdp], [np.ones((2, 1))] * 2)
    assert_allclose(found.values[0], [4.0, 2.0], rtol=1e-14)
    assert np.all(found.error_bound < 1e-12)
    ratio.data = np.array([1.0, 2.5])
    with pytest.raises(ValueError, match=r"spectral radius of 1\.25"):
        exact.evaluate_batch([mdp, exact.reweight(mdp, ratio)], [np.ones((2, 1))] * 2)


def test_a_batch_of_none():
    mdp = oee.tasks.gridworld(2, 0.3)
    found = exact.evaluate_batch(mdp, [])
    assert len(found) == 0
    assert repr(found) == "BatchValues(0 policies)"


@pytest.mark.parametrize(
    ("models", "policies", "text"),
    [
        (3, [], r"models must be a FiniteMDP or a sequence of them; got int"),
        ([], [], r"models must be at least one FiniteMDP; there is none"),
        (["grid", 4], [1, 2], r"models\[1\] must be a FiniteMDP; got int"),
        (["grid"], 3, r"policies must be a sequence of policies; got int"),
        (["grid"], [[[1]], [[1]]], r"policies must be as many as models \(1\); there are 2"),
        (["grid", "grid"], ["uniform", [[0.5, 0.4, 0, 0]] * 4], r"policies\[1\]\[0\] must sum to 1 .* it sums to 0\.9"),
        (["grid"], [[[1.5, -0.5, 0, 0]] * 4], r"policies\[0\]\[0, 1\] must be nonnegative; it is -0\.5"),
        (["grid"], [[[np.nan, 0, 0, 1]] * 4], r"policies\[0\]\[0, 0\] must be finite; it is nan"),
        (["grid"], np.ones((1, 3, 4)) / 4, r"policies\[0\] must have shape \(4, 4\)"),
    ],
)
def test_bad_batches(models, policies, text):
    grid = oee.tasks.gridworld(2, 0.3)
    if isinstance(models, list):
        models = [grid if model == "grid" else model for model in models]
    if isinstance(policies, list):
        policies = [oee.uniform_policy(grid) if isinstance(p, str) else p for p in policies]
    with pytest.raises(ValueError, match=text):
        exact.evaluate_batch(models, policies)


def test_policies_of_single_precision_are_scaled_as_in_single_evaluations():
    policy = np.array([[1e-9, 1.0]] * 2, dtype=np.float32)
    mdp = oee.FiniteMDP([[[1.0, 0], [0, 1.0]], [[0, 1.0], [1.0, 0]]], [[1, 2.0], [3, 4]], [1, 0], 0.999)
    known = exact.evaluate_policy(mdp, policy).values
    for many in (policy[None], [policy]):
        assert_array_equal(exact.evaluate_batch(mdp, many).values[0], known)


def test_a_ragged_policy_is_named_by_its_place():
    mdp = oee.FiniteMDP(np.ones((2, 2, 2)) / 2, np.ones((2, 2)), [1, 0], 0.9)
    with pytest.raises(ValueError, match=r"policies\[1\]"):
        exact.evaluate_batch(mdp, [np.ones((2, 2)) / 2, [[1], [1, 2]]])
