"""Merged sweeps are those of a policy in time; each step and state has its own share of the variance."""

import numpy as np
import pytest
from helpers import BEHAVIOR, POLICY, environments, histories, random_mdp, random_policy, ratio_of, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee

KINDS = ("per_decision", "trajectory")


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


def shares_by_enumeration(mdp, found, x, horizon):
    """Parts of Var X: the start's and each step's, and the steps' by the state they were taken from."""
    probability = np.array([path[0] for path in found])
    levels = [np.full(len(x), probability @ x)]
    for t in range(horizon + 1):
        groups = {}
        for k, (_, states, actions, _) in enumerate(found):
            groups.setdefault((states[: t + 1], actions[:t]), []).append(k)
        level = np.empty(len(x))
        for members in groups.values():
            level[members] = probability[members] @ x[members] / probability[members].sum()
        levels.append(level)
    steps = [probability * (after - before) ** 2 for before, after in zip(levels[:-1], levels[1:], strict=True)]
    by_state = np.zeros(mdp.n_states)
    for t in range(horizon):
        np.add.at(by_state, [path[1][t] for path in found], steps[t + 1])
    return np.array([step.sum() for step in steps]), by_state


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("self_normalized", [False, True])
@pytest.mark.parametrize("form", [1, 2, 3])
def test_each_step_and_each_state_has_its_own_share_of_the_variance(form, kind, self_normalized):
    """Not only their sum: Var E[X | path to s_t+1] - Var E[X | path to s_t], path by path, by states s_t."""
    simulator, target = environments(form)
    zeta, horizon = oee.true_ratio(target, simulator), 3
    w = zeta.values.toarray().reshape(3, 2, 3) * np.array([1.0, 1.3, 0.8])  # the rows do not sum to 1
    ratio = sparse.csr_array(w.reshape(6, 3))
    found = histories(simulator, POLICY, horizon)
    weights, paid = [], []
    for _, states, actions, rewards in found:
        after = np.cumprod([w[states[t], actions[t], states[t + 1]] for t in range(horizon)])
        weights.append(after if form == 3 else np.concatenate([[1.0], after[:-1]]))
        paid.append(rewards)
    weights, paid = np.array(weights), np.array(paid)
    probability, gamma = np.array([path[0] for path in found]), simulator.discount ** np.arange(horizon)
    if kind == "trajectory":
        weight, total = weights[:, -1], paid @ gamma
        mass = probability @ weight
        level = probability @ (weight * total) / mass
        x = weight * (total - level) / mass if self_normalized else weight * total
    else:
        mass = probability @ weights
        level = probability @ (weights * paid) / mass
        x = (weights * (paid - level) / mass) @ gamma if self_normalized else (weights * paid) @ gamma
    by_step, by_state = shares_by_enumeration(simulator, found, x, horizon)
    moments = oee.weighted_return_moments(
        simulator, ratio, POLICY, kind=kind, horizon=horizon, self_normalized=self_normalized, sources=True
    )
    assert_allclose(moments.by_step, by_step, rtol=1e-9, atol=1e-12)
    assert_allclose(moments.by_state, by_state, rtol=1e-9, atol=1e-12)
    assert_allclose(moments.variance, by_step.sum(), rtol=1e-9)
    bare = oee.weighted_return_moments(
        simulator, ratio, POLICY, kind=kind, horizon=horizon, self_normalized=self_normalized
    )
    assert bare.by_step is None
    assert bare.by_state is None
    assert (bare.mean, bare.variance, bare.bias) == (moments.mean, moments.variance, moments.bias)


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
