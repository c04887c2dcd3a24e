import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular.continuous.cartpole import ANGLE_LIMIT, EXPERT
from oee_tabular.tasks import (
    CartPole,
    cartpole_policy,
    discretize,
    gymnasium_simulator,
    monte_carlo_value,
    record,
    resimulate,
    train_expert,
)


@pytest.mark.parametrize("gravity", [7.5, 9.8, 15.0])
def test_one_step_is_gymnasium_s_to_the_last_bit(gravity):
    rng = np.random.default_rng(0)
    states = rng.uniform([-2.45, -3, -0.22, -4], [2.45, 3, 0.22, 4], (3000, 4))
    actions = rng.integers(0, 2, 3000)
    theirs = gymnasium_simulator(f"CartPole-v1:gravity={gravity}").task.step(states, actions, rng)
    ours = CartPole(gravity, noise=0.0).step(states, actions, rng)
    assert_array_equal(ours.next_state, theirs.next_state)
    assert_array_equal(ours.terminated, theirs.terminated)
    assert_array_equal(ours.reward, theirs.reward)


@given(st.floats(0, 30), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_laws_of_a_step(gravity, seed):
    """Mirror symmetry; the angle does not see the cart; gravity enters linearly; noise is added at the end."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-0.2, 0.2, (20, 4))
    actions = rng.integers(0, 2, 20)
    xi = rng.standard_normal((20, 4))
    task = CartPole(gravity, noise=0.01)
    moved = task.moves(states, actions, xi)
    assert_allclose(task.moves(-states, 1 - actions, -xi).next_state, -moved.next_state, rtol=0, atol=1e-15)
    elsewhere = states + np.array([1.0, 0.3, 0.0, 0.0])
    assert_array_equal(task.moves(elsewhere, actions, xi).next_state[:, 2:], moved.next_state[:, 2:])
    still = CartPole(gravity, noise=0.0).moves(states, actions, xi).next_state
    assert_allclose(moved.next_state - still, 0.01 * xi, rtol=0, atol=1e-14)
    none, twice = (CartPole(g, 0.0).moves(states, actions, xi).next_state for g in (0.0, 2 * gravity))
    assert_allclose(none + twice, 2 * still, rtol=0, atol=1e-12)


def test_the_failing_step_has_a_reward_too():
    """A pole that never falls is worth 1 - 0.99^100 = 0.633967658726771 (the paper's ceiling)."""
    falling = np.array([[0.0, 0.0, ANGLE_LIMIT - 1e-3, 1.0], [0.0, 0.0, 0.0, 0.0]])
    moved = CartPole().moves(falling, np.array([1, 1]), np.zeros((2, 4)))
    assert_array_equal(moved.terminated, [True, False])
    assert_array_equal(moved.reward, [1.0, 1.0])
    model = discretize(CartPole(), cells=(20, 20), closure_episodes=0)
    assert_array_equal(model.mdp.rewards[:-1], 1.0)
    assert_array_equal(model.mdp.rewards[-1], 0.0)
    stands = model.mdp.with_transitions(sparse.kron(sparse.eye_array(model.mdp.n_states), np.ones((2, 1)), "csr"))
    ceiling = oee.policy_value(stands, oee.uniform_policy(stands), horizon=100, normalized=True)
    assert_allclose(ceiling, 0.633967658726771, rtol=1e-12)


def test_the_shipped_expert_is_the_trained_one():
    assert train_expert() == EXPERT
    assert train_expert(seed=1) == train_expert(seed=1) != EXPERT


def test_policies():
    states = record(CartPole(), cartpole_policy(0.5), n_transitions=200, max_steps=100, seed=0).state
    expert, uniform = cartpole_policy(0.0)(states), cartpole_policy(1.0)(states)
    assert_array_equal(uniform, 0.5)
    assert_allclose(cartpole_policy(0.3)(states), 0.3 * uniform + 0.7 * expert)
    firm = cartpole_policy(0.0, deterministic=True)(states)
    assert_array_equal(firm[:, 1], expert[:, 1] > 0.5)
    right = 1 / (1 + np.exp(-(EXPERT[0] * states[:, 2] + EXPERT[1] * states[:, 3] + EXPERT[2])))
    assert_allclose(expert[:, 1], right)


def test_records_say_what_happened():
    log = record(CartPole(noise=0.0), cartpole_policy(0.3), n_episodes=40, max_steps=30, seed=0)
    assert_array_equal(log.reward, 1.0)
    starts = np.flatnonzero(log.timestep == 0)
    assert len(starts) == 40
    lengths = np.diff(np.append(starts, len(log)))
    assert lengths.max() == 30
    ends = np.append(starts[1:], len(log)) - 1
    assert_array_equal(log.terminated[ends] ^ log.truncated[ends], True)
    assert_array_equal(np.abs(log.next_state[:, 2]) > ANGLE_LIMIT, log.terminated)
    again = resimulate(CartPole(noise=0.0), log)
    assert_array_equal(again.next_state, log.next_state)
    chosen = cartpole_policy(0.3)(log.state)[np.arange(len(log)), log.action]
    assert_allclose(log.behavior_probability, chosen)
    assert abs((log.action == 1).mean() - cartpole_policy(0.3)(log.state)[:, 1].mean()) < 0.05


def test_the_same_seed_gives_the_same_bits():
    one, two, other = (
        record(CartPole(), cartpole_policy(0.3), n_transitions=3000, max_steps=100, seed=s) for s in (1, 1, 2)
    )
    assert_array_equal(one.next_state, two.next_state)
    assert not np.array_equal(one.next_state, other.next_state)
    # a shorter log is the beginning of a longer one
    short = record(CartPole(), cartpole_policy(0.3), n_transitions=1000, max_steps=100, seed=1)
    assert_array_equal(short.state, one.state[:1000])
    values = [monte_carlo_value(CartPole(), cartpole_policy(0.3), 5000, 100, seed=4) for _ in range(2)]
    assert values[0] == values[1]
