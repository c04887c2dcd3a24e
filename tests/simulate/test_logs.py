"""Sampled logs: frequencies by chi-square at fixed seeds, where episodes end, seeds and bits, bad calls."""

import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy, rngs, survival_chain
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import oee_tabular as oee
from oee_tabular.simulate.sampler import episodes_holding


def test_seeds_are_what_default_rng_takes():
    mdp, policy = survival_chain(), np.ones((2, 1))
    one, two = (
        oee.sample_episodes(mdp, policy, 50, 20, seed=np.random.SeedSequence(5, spawn_key=(1, 2))) for _ in range(2)
    )
    assert_array_equal(one.next_state, two.next_state)
    generator = np.random.default_rng(0)
    first, second = (oee.sample_episodes(mdp, policy, 50, 20, seed=generator) for _ in range(2))
    assert not np.array_equal(first.next_state, second.next_state)


@settings(max_examples=20)
@given(rngs)
def test_a_log_is_one_that_passes_every_check(rng):
    """The columns are written without them."""
    mdp = random_mdp(rng)
    log = oee.sample_episodes(
        mdp, random_policy(rng, mdp), 7, int(rng.integers(1, 40)), seed=int(rng.integers(1 << 30))
    )
    checked = oee.Transitions(**log.columns())
    for name, column in log.columns().items():
        assert_array_equal(column, getattr(checked, name), err_msg=name)
        assert column.dtype == getattr(checked, name).dtype
        assert not column.flags.writeable
    assert str(log) == str(checked)


def test_transitions_follow_the_distribution_and_the_model():
    """Chi-square of 100 000 transitions against P(s' | s, a) d(s, a); impossible ones never happen."""
    rng = np.random.default_rng(4)
    mdp, n = random_mdp(rng, n_states=5, n_actions=3), 100_000
    weights = rng.dirichlet(np.ones(15)).reshape(5, 3)
    weights[1] *= [0.0, 1.0, 1.0]
    weights /= weights.sum()
    log = oee.sample_transitions(mdp, weights, n, seed=1)
    expected = n * (weights.reshape(-1)[:, None] * mdp.transitions.toarray()).reshape(-1)
    observed = log.counts(5, 3).toarray().reshape(-1)
    assert observed[expected == 0].sum() == 0
    assert stats.chisquare(observed[expected > 0], expected[expected > 0]).pvalue > 1e-4
    assert log.episode is None


def test_episodes_follow_initial_policy_and_transitions():
    rng = np.random.default_rng(8)
    mdp = random_mdp(rng, n_states=4, n_actions=2, discount=0.9)
    policy = random_policy(rng, mdp)
    log = oee.sample_episodes(mdp, policy, 30_000, 3, seed=2)
    first = log.timestep == 0
    expected = first.sum() * mdp.initial
    observed = np.bincount(log.state[first], minlength=4)
    assert observed[expected == 0].sum() == 0
    assert stats.chisquare(observed[expected > 0], expected[expected > 0]).pvalue > 1e-4
    joint = policy.reshape(-1)[:, None] * mdp.transitions.toarray()
    visits = np.repeat(np.bincount(log.state, minlength=4), 2)[:, None] * joint  # conditional on the states
    counts = log.counts(4, 2).toarray()
    assert (counts[visits == 0] == 0).all()
    assert ((counts - visits)[visits > 0] ** 2 / visits[visits > 0]).sum() < stats.chi2.isf(1e-4, (visits > 0).sum())
    assert_array_equal(log.behavior_probability, policy[log.state, log.action])
    transitions, rewards = dense(mdp)
    assert (transitions[log.state, log.action, log.next_state] > 0).all()
    assert_allclose(log.reward, rewards[log.state, log.action, log.next_state])


def test_episodes_end_where_they_are_terminal():
    log = oee.sample_episodes(survival_chain(), np.ones((2, 1)), 4000, 5, seed=0)
    lengths, last = np.diff(log.episode_starts), log.episode_starts[1:] - 1
    ended = log.terminated[last]
    assert_array_equal(ended, log.next_state[last] == 1)
    assert (lengths[~ended] == 5).all()
    assert_array_equal(log.truncated[last], ~ended)
    assert_allclose((lengths == 1).mean(), 0.3, atol=0.03)


@pytest.mark.large
def test_a_long_horizon_is_followed_where_episodes_end():
    with pytest.warns(UserWarning, match="multiply-adds"):
        log = oee.sample_episodes(survival_chain(1.0), np.ones((2, 1)), 30, 10**9, seed=0)
    assert log.terminated.sum() == 30
    one = oee.sample_episodes(oee.FiniteMDP([[[1.0]]], [1.0], [1.0], 0.9), [[1.0]], 2, 500_000, seed=0)
    assert np.diff(one.episode_starts).tolist() == [500_000] * 2


def test_twins_of_terminal_states_are_not_drawn_from():
    """A distribution over the environment's own states is one over all, with nothing on the twins."""
    rows = np.array([[[0.5, 0.5, 0.0, 0.0]], [[0.0, 0.0, 0.6, 0.4]], [[0.0, 0.0, 1.0, 0.0]], [[0.0, 0.0, 0.0, 1.0]]])
    mdp = oee.FiniteMDP(rows, np.ones((4, 1)), [1, 0, 0, 0], 0.9, terminal_state=[2, 3])
    own = np.array([[0.25], [0.75]])
    log = oee.sample_transitions(mdp, own, 2000, seed=0)
    same = oee.sample_transitions(mdp, np.concatenate([own, np.zeros((2, 1))]), 2000, seed=0)
    assert_array_equal(log.next_state, same.next_state)
    assert log.state.max() == 1
    assert not log.terminated.any()


@pytest.mark.parametrize("n", [1, 100, 401])
def test_whole_episodes_hold_n_transitions(n):
    """At least n, whole episodes, and of one seed those first that hold fewer."""
    grid, policy = oee.tasks.gridworld(3, slip=0.1), oee.tasks.gridworld_expert(3)
    log, more = (episodes_holding(grid, policy, size, 20, seed=0) for size in (n, 5 * n))
    assert len(log) >= n
    assert log.terminated[-1]
    assert_array_equal(log.state, more.first(len(log)).state)
