"""Finite horizons: light cone, forward sums and plain sweeps give one answer, that of the definition."""

import numpy as np
from helpers import random_mdp, random_policy, rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular import exact

horizons = st.integers(1, 9)


def backward(model, policy, steps):
    """V_0, V_1: the definition, with library products on the rows as they stand."""
    value = following = np.zeros(model.n_states)
    for t in range(steps - 1, -1, -1):
        pairs = model.rewards + model.discount * (model.transitions @ value).reshape(model.rewards.shape)
        value, following = ((policy if policy.ndim == 2 else policy[t]) * pairs).sum(axis=1), value
    return value, following


def forward(model, policy, steps):
    """sum_t gamma^t Pr(s_t = s, a_t = a)."""
    states, total = model.initial, np.zeros((model.n_states, model.n_actions))
    for t in range(steps):
        pairs = states[:, None] * (policy if policy.ndim == 2 else policy[t])
        total += model.discount**t * pairs
        states = model.transitions.T @ pairs.reshape(-1)
    return total


def some_model(rng, **options):
    """An MDP, in half of the cases with its kernel multiplied by anything, zeros among it."""
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 30)), **options)
    if rng.random() < 0.5:
        return mdp
    data = rng.integers(0, 4, mdp.transitions.nnz) / 2.0
    ratio = sparse.csr_array((data, mdp.transitions.indices, mdp.transitions.indptr), shape=mdp.transitions.shape)
    return exact.reweight(mdp, ratio)


def some_policy(rng, model, steps, stationary):
    if stationary:
        return random_policy(rng, model)
    return np.stack([random_policy(rng, model) for _ in range(steps)])


@given(rngs, horizons, st.booleans())
def test_all_ways_give_the_sum_of_the_definition(rng, steps, stationary):
    model = some_model(rng)
    policy = some_policy(rng, model, steps, stationary)
    values, following = backward(model, policy, steps)
    scale = 1e-12 * max(1.0, np.abs(values).max())
    assert_allclose(exact.state_values(model, policy, horizon=steps), values, rtol=0, atol=scale)
    pairs = model.rewards + model.discount * (model.transitions @ following).reshape(model.rewards.shape)
    assert_allclose(exact.action_values(model, policy, horizon=steps), pairs, rtol=0, atol=scale)
    value = model.initial @ values
    assert_allclose(exact.policy_value(model, policy, horizon=steps), value, rtol=0, atol=scale)
    visits = forward(model, policy, steps)
    assert_allclose((visits * model.rewards).sum(), value, rtol=0, atol=scale * steps)
    mass = sum(model.discount**t for t in range(steps))
    assert_allclose(exact.occupancy(model, policy, horizon=steps), visits / mass, rtol=1e-12, atol=1e-13)
    states = exact.occupancy(model, policy, horizon=steps, of="state")
    assert_allclose(states, visits.sum(axis=1) / mass, rtol=1e-12, atol=1e-13)


@given(rngs, horizons, st.booleans())
def test_the_values_by_horizon_are_those_of_each(rng, steps, stationary):
    """J_0 = 0; J_t - J_{t-1} = gamma^(t-1) E[r_{t-1}]; J_t is that of policy_value and evaluate_policy."""
    model = some_model(rng)
    policy = some_policy(rng, model, steps, stationary)
    found = exact.policy_values_by_horizon(model, policy, horizon=steps)
    assert found.shape == (steps + 1,)
    assert found[0] == 0.0
    for t in range(1, steps + 1):
        first = policy if stationary else policy[:t]
        value = exact.policy_value(model, first, horizon=t)
        assert_allclose((found[t], exact.evaluate_policy(model, first, horizon=t).value), value, rtol=1e-12, atol=1e-13)
    paid = np.diff([(forward(model, policy, t) * model.rewards).sum() for t in range(steps + 1)])
    assert_allclose(np.diff(found), paid, rtol=0, atol=1e-11 * max(1.0, np.abs(found).max()))


def test_only_what_is_reached_in_time_is_read():
    """From state 3 of a line, two moves: states 3, 4, 5 and their numbers; what lies beyond may be anything."""
    size, steps = 50, 3
    moves = sparse.eye_array(size, k=1, format="lil")
    moves[size - 1, size - 1] = 1.0
    initial = np.eye(size)[3]
    line = oee.FiniteMDP(moves.tocsr(), np.arange(size, dtype=float), initial, 0.5)
    policy = np.ones((size, 1))
    assert np.flatnonzero(exact.occupancy(line, policy, horizon=steps)).tolist() == [3, 4, 5]
    assert exact.policy_values_by_horizon(line, policy, horizon=steps).tolist() == [0.0, 3.0, 5.0, 6.25]


@given(rngs, st.one_of(st.none(), st.integers(1, 5)))
def test_the_gradient_is_the_sum_of_its_definition(rng, steps):
    """sum_t gamma^t alpha_t (r + gamma V'_t+1) on the other model's entries, alpha of the first, V' of the other."""
    model, valued = (random_mdp(rng, n_states=5, n_actions=2, discount=0.9) for _ in range(2))
    policy = random_policy(rng, model)
    rows = np.repeat(np.arange(10), np.diff(valued.transitions.indptr))
    columns = valued.transitions.indices
    pay = 0.0 if valued.reward_data is None else valued.reward_data
    states, expected = model.initial, np.zeros(len(rows))
    endless = exact.state_values(valued, policy)
    for t in range(steps or 400):
        share = (states[:, None] * policy).reshape(-1)
        left = backward(valued, policy, steps - t)[1] if steps else endless
        expected += model.discount**t * share[rows] * (pay + model.discount * left[columns])
        states = model.transitions.T @ share
    found = exact.transition_gradient(model, policy, horizon=steps, values_of=valued)
    assert_allclose(found, expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max()))
