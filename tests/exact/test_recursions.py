"""Merged sweeps are those of a policy in time; each step and state has its own share of the variance."""

import numpy as np
import pytest
from helpers import BEHAVIOR, POLICY, environments, random_mdp, random_policy, ratio_of, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose

import oee_tabular as oee


def check_in_time(mdp, zeta, policy, behavior, horizon):
    """A policy for each step that is always the same: entry by entry what the merged sweeps give."""
    calls = [
        lambda pi, **options: oee.return_moments(mdp, pi, **options),
        lambda pi, **options: oee.weighted_return_moments(mdp, zeta, pi, **options),
        lambda pi, **options: oee.weighted_return_moments(mdp, zeta, pi, self_normalized=True, **options),
        lambda pi, **options: oee.policy_is_moments(mdp, behavior, pi, **options),
        lambda pi, **options: oee.policy_is_moments(mdp, behavior, pi, self_normalized=True, **options),
    ]
    for call in calls:
        merged, timed = (call(pi, horizon=horizon, sources=True) for pi in (policy, np.stack([policy] * horizon)))
        for name in ("mean", "variance", "bias", "by_step", "by_state"):
            one, two = getattr(merged, name), getattr(timed, name)
            scale = max(1.0, np.abs(two).max(), abs(timed.mean) ** 2)
            assert_allclose(one, two, rtol=1e-9, atol=1e-12 * scale, err_msg=name)


@pytest.mark.large
@settings(max_examples=60)
@given(rngs)
def test_merged_sweeps_are_those_of_a_policy_in_time(rng):
    """Strips that fill and that do not."""
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 90)), n_actions=int(rng.integers(1, 5)))
    zeta = oee.true_ratio(random_mdp(rng, like=mdp), mdp)
    check_in_time(mdp, zeta, random_policy(rng, mdp), random_policy(rng, mdp, zeros=0.0), int(rng.integers(1, 7)))


@pytest.mark.large
@settings(max_examples=15)
@given(rngs)
def test_rings_and_rows_of_very_different_lengths(rng):
    """A ring's entries lead to consecutive states; in the other, one state leads everywhere, the rest to three."""
    n, n_actions = int(rng.integers(70, 200)), 2
    for is_ring in (True, False):
        transitions = np.zeros((n, n_actions, n))
        for step in rng.choice(np.arange(-5, 40), 3, replace=False):
            following = (np.arange(n) + step) % n if is_ring else rng.integers(0, n, n)
            transitions[np.arange(n), :, following] += rng.gamma(0.3, size=(n, n_actions)) + 1e-9
        if not is_ring:
            transitions[n // 2] = 1.0
        transitions /= transitions.sum(axis=2, keepdims=True)
        mdp = oee.FiniteMDP(transitions, rng.normal(size=(n, n_actions, n)), np.full(n, 1 / n), 0.9)
        policy, behavior = (rng.dirichlet(np.ones(n_actions), n) for _ in range(2))
        check_in_time(mdp, ratio_of(rng, mdp), policy, behavior, 4)


@pytest.mark.parametrize("form", [1, 2, 3])
@pytest.mark.parametrize("weights", ["none", "moves", "actions"])
def test_an_infinite_sum_has_the_shares_of_a_long_one(form, weights):
    simulator, target = environments(form)

    def moments(**options):
        if weights == "none":
            return oee.return_moments(simulator, POLICY, sources=True, **options)
        if weights == "moves":
            zeta = oee.true_ratio(target, simulator)
            return oee.weighted_return_moments(simulator, zeta, POLICY, sources=True, **options)
        return oee.policy_is_moments(simulator, BEHAVIOR, POLICY, sources=True, **options)

    endless, long = moments(), moments(horizon=120)
    assert_allclose(endless.mean, long.mean, rtol=1e-10)
    assert_allclose(endless.variance, long.variance, rtol=1e-10)
    assert_allclose(endless.by_state, long.by_state, rtol=1e-9)
    assert endless.by_step is None
    assert endless.bias == 0.0
    assert_allclose(endless.variance - endless.by_state.sum(), long.by_step[0], rtol=1e-9)
