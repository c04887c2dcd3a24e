"""The recursions behind moments: merged and centred sweeps agree, and each step and state has its own share of the variance."""

import itertools

import numpy as np
import pytest
from helpers import BEHAVIOR, POLICY, environments, histories, random_mdp, random_policy, ratio_of, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular.exact._merged import LANES, PARTS, merge
from oee_tabular.exact._moments import per_decision as centred
from oee_tabular.exact.recursions import extras_of, merged
from oee_tabular.exact.walks import walk_of

KINDS = ("per_decision", "trajectory")


@settings(max_examples=150)
@given(rngs, st.sampled_from(["zeta", "policies", "none"]), st.booleans(), st.booleans())
def test_merged_sweeps_are_the_centred_form(rng, weights, timed, based):
    """One sweep over entries merged over actions; strips that fill and that do not."""
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 90)), n_actions=int(rng.integers(1, 5)))
    steps = int(rng.integers(1, 7))
    options = {
        "zeta": lambda: {"ratio": ratio_of(rng, mdp)}, "policies": lambda: {"policy": random_policy(rng, mdp)},
        "none": dict,
    }[weights]()  # fmt: skip
    walk = walk_of(mdp, random_policy(rng, mdp), **options)
    shift, scale = (rng.normal(size=steps), np.exp(rng.normal(size=steps))) if timed else (None, None)
    h, k = (rng.normal(size=(n, mdp.n_states)) for n in (steps, steps + 1)) if based else (None, None)
    extras = extras_of(walk, steps, shift=shift, scale=scale, h=h, k=k)
    old = centred(walk, steps, extras, True)
    new = merged(walk, steps, extras, True)
    for name, a, b in zip(("mean", "var", "local"), new, old, strict=True):
        assert_allclose(a, b, rtol=1e-9, atol=1e-12 * max(1.0, np.abs(b).max()), err_msg=name)


@given(rngs, st.booleans(), st.booleans())
def test_moves_to_states_that_stand_side_by_side(rng, timed, based):
    """On a ring the strips' entries are consecutive states, but where it closes; the same numbers as in the centred form."""
    n, n_actions, steps = int(rng.integers(70, 200)), 2, 4
    steps_of = rng.choice(np.arange(-5, 40), 3, replace=False)
    transitions = np.zeros((n, n_actions, n))
    for step in steps_of:
        transitions[np.arange(n), :, (np.arange(n) + step) % n] += rng.gamma(0.3, size=(n, n_actions)) + 1e-9
    transitions /= transitions.sum(axis=2, keepdims=True)
    mdp = oee.FiniteMDP(transitions, rng.normal(size=(n, n_actions, n)), np.full(n, 1 / n), 0.9)
    walk = walk_of(mdp, random_policy(rng, mdp), ratio=ratio_of(rng, mdp))
    shift, scale = (rng.normal(size=steps), np.exp(rng.normal(size=steps))) if timed else (None, None)
    h, k = (rng.normal(size=(x, n)) for x in (steps, steps + 1)) if based else (None, None)
    strips = merge(walk)
    offsets, columns, aligned, numbers, *_ = strips
    columns = columns.reshape(-1, LANES).astype(np.int64)
    assert_array_equal(aligned, (columns == columns[:, :1] + np.arange(LANES)).all(axis=1))
    assert not aligned.all()
    mass = numbers.reshape(-1, PARTS, LANES)[:, 0]
    for first, last in itertools.pairwise(offsets):
        assert (2.0 * mass[first] >= mass[first:last].max(axis=0)).all()
    extras = extras_of(walk, steps, shift=shift, scale=scale, h=h, k=k)
    old = centred(walk, steps, extras, True)
    for a, b in zip(merged(walk, steps, extras, True), old, strict=True):
        assert_allclose(a, b, rtol=1e-9, atol=1e-12 * max(1.0, np.abs(b).max()))


def test_a_grids_strips_are_read_side_by_side():
    """Entries are in the order of their columns, at a wall as beside it: four of five strips' at 100 x 100 are consecutive."""
    grid = oee.tasks.gridworld(100, 0.3)
    aligned = merge(walk_of(grid, oee.uniform_policy(grid))).aligned
    assert aligned.mean() > 0.8


def test_rows_of_very_different_lengths_are_sorted_into_strips():
    """One state of 200 that leads everywhere, the others to two: equal to the centred form, with no more room than needed."""
    rng = np.random.default_rng(0)
    transitions = np.zeros((200, 1, 200))
    transitions[np.arange(200), 0, rng.integers(0, 200, 200)] += 0.5
    transitions[np.arange(200), 0, rng.integers(0, 200, 200)] += 0.5
    transitions[77] = 1 / 200
    mdp = oee.FiniteMDP(transitions, rng.normal(size=(200, 1, 200)), np.full(200, 1 / 200), 0.9)
    walk = walk_of(mdp, np.ones((200, 1)), ratio=ratio_of(rng, mdp))
    strips = merge(walk)
    extras = extras_of(walk, 5)
    old, new = centred(walk, 5, extras, True), merged(walk, 5, extras, True)
    for a, b in zip(new, old, strict=True):
        assert_allclose(a, b, rtol=1e-11, atol=1e-12)
    offsets, order = strips.offsets, strips.order
    assert offsets[-1] <= 200 + 2 * 6
    assert order[199] == 77
    assert sorted(order[:200]) == list(range(200))
    assert (order[200:] == 200).all()


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


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("action_baseline", [False, True])
def test_the_shares_of_doubly_robust_add_up(form, action_baseline):
    simulator, target = environments(form)
    zeta = oee.true_ratio(target, simulator)
    found = oee.doubly_robust_moments(simulator, zeta, POLICY, horizon=3, action_baseline=action_baseline, sources=True)
    assert_allclose(found.by_step.sum(), found.variance, rtol=1e-12)
    assert_allclose(found.by_step[0] + found.by_state.sum(), found.variance, rtol=1e-12)
    own = walk_of(simulator, POLICY).values_to_go(3)
    given_baseline = own.copy()
    given_baseline[3] = 9.0  # row T is not used
    again = oee.doubly_robust_moments(
        simulator, zeta, POLICY, baseline=given_baseline, horizon=3, action_baseline=action_baseline
    )
    assert_allclose((again.mean, again.variance), (found.mean, found.variance), rtol=1e-12)
    assert given_baseline[3, 0] == 9.0  # and the caller's array is the caller's
    for t in range(3):
        assert_allclose(own[t], oee.state_values(simulator, POLICY, horizon=3 - t), rtol=1e-12)
