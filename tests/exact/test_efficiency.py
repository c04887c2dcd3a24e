"""Efficiency bounds and asymptotic variances."""

import numpy as np
import pytest
from helpers import (
    POLICY,
    Dense,
    dense,
    environments,
    integer_distribution,
    paths,
    random_mdp,
    random_policy,
    rngs,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.exact import leading_bias, ratio_of_ratios_variance


def shares(rng, mdp, zeros=0.0):
    return integer_distribution(rng, mdp.n_states * mdp.n_actions, zeros).reshape(
        mdp.n_states, mdp.n_actions
    )


@given(rngs)
def test_41_the_bound_is_the_variance_of_the_numeric_gradient(rng):
    """The bound is sum_x Var_{P'}[dJ/dP'] / d_log by central differences of J.

    For r(s, a) it equals the closed form.
    """
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 5)), discount=0.9)
    policy = random_policy(rng, mdp)
    share = shares(rng, mdp)
    base = Dense(mdp)
    expected = 0.0
    for s, a in np.ndindex(*share.shape):
        slope = np.zeros(mdp.n_states)
        row = base.P[s, a]
        for j in np.flatnonzero(row):
            step = np.zeros(base.P.shape)
            step[s, a, j] = 1e-5
            slope[j] = (
                base.like(base.P + step).J(policy) - base.like(base.P - step).J(policy)
            ) / 2e-5
        expected += row @ (slope - row @ slope) ** 2 / share[s, a]
    found = oee.efficiency_bound(mdp, policy, share)
    assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    if mdp.transition_rewards is None:
        v = oee.state_values(mdp, policy)
        spread = np.einsum(
            "sat,sat->sa", base.P, (v[None, None] - (base.P @ v)[:, :, None]) ** 2
        )
        d = oee.occupancy(mdp, policy)
        assert_allclose(
            found,
            (0.9 / 0.1) ** 2 * (d**2 / share * spread).sum(),
            rtol=1e-8,
            atol=1e-9,
        )


@given(rngs)
def test_30_the_bound_is_convex_in_the_data_and_has_its_minimum_where_theory_says(rng):
    mdp = random_mdp(rng, n_states=3, n_actions=2, discount=0.9)
    policy = random_policy(rng, mdp)
    one = shares(rng, mdp)
    two = shares(rng, mdp)
    both = oee.efficiency_bound(mdp, policy, (one + two) / 2)
    ends = [oee.efficiency_bound(mdp, policy, x) for x in (one, two)]
    assert both <= np.mean(ends) * (1 + 1e-12) + 1e-12
    if oee.efficiency_bound(mdp, policy, np.full((3, 2), 1 / 6)) == 0:
        return
    parts = []
    for k in range(6):  # c_x, by making all but x certain to be seen often
        weight = np.full(6, 1e-9)
        weight[k] = 1.0 - 5e-9
        parts.append(weight)
    costs = np.linalg.solve(
        1.0 / np.array(parts),
        [oee.efficiency_bound(mdp, policy, w.reshape(3, 2)) for w in parts],
    )
    costs = np.maximum(costs, 0.0)
    if (costs < 1e-6 * costs.max()).any():
        return
    best = np.sqrt(costs) / np.sqrt(costs).sum()
    assert_allclose(
        oee.efficiency_bound(mdp, policy, best.reshape(3, 2)),
        np.sqrt(costs).sum() ** 2,
        rtol=1e-5,
    )
    assert oee.efficiency_bound(mdp, policy, one) >= np.sqrt(costs).sum() ** 2 * (
        1 - 1e-5
    )


@given(rngs)
def test_08_discount_0_and_a_long_horizon(rng):
    mdp = random_mdp(rng, n_states=3, form=2, discount=0.9)
    policy = random_policy(rng, mdp)
    share = shares(rng, mdp)
    bound = oee.efficiency_bound(mdp, policy, share)
    assert oee.efficiency_bound(mdp.with_discount(0.0), policy, share) == 0
    assert_allclose(
        oee.efficiency_bound(mdp, policy, share, horizon=600),
        bound,
        rtol=1e-6,
        atol=1e-9,
    )


def test_data_that_never_show_what_matters():
    mdp = oee.tasks.gridworld(3, 0.3)
    share = np.full((9, 4), 1 / 32)
    share[0] = 0
    assert oee.efficiency_bound(mdp, oee.uniform_policy(mdp), share) == np.inf
    even = np.full((9, 4), 1 / 36)
    simulator = oee.tasks.gridworld(3, 0.5)
    for two in ((share, even), (even, share)):
        assert (
            ratio_of_ratios_variance(simulator, mdp, oee.uniform_policy(mdp), *two)
            == np.inf
        )
    certain = oee.FiniteMDP(
        np.array([[[0.0, 1.0]], [[0.5, 0.5]]]), np.array([0.0, 1.0]), [1, 0], 0.9
    )
    # a certain move needs no data
    assert np.isfinite(oee.efficiency_bound(certain, np.ones((2, 1)), [[0.0], [1.0]]))


@given(rngs)
def test_the_tree_bound_is_the_variance_of_doubly_robust_with_the_truth(rng):
    """The tree bound is the variance of doubly robust with the true Q and V.

    Kallus and Uehara proved it. The Markov bound, by alpha^2 / beta Var[r + gamma V],
    is at most that.
    """
    mdp = random_mdp(rng, n_states=3, n_actions=2)
    behavior = random_policy(rng, mdp, zeros=0)
    policy = random_policy(rng, mdp)
    horizon = 3
    values = [
        oee.state_values(mdp, policy, horizon=horizon - t) for t in range(horizon)
    ] + [np.zeros(3)]
    transitions, paid = dense(mdp)
    pairs = np.stack(
        [
            mdp.rewards + mdp.discount * transitions @ values[t + 1]
            for t in range(horizon)
        ]
    )
    ratio = np.where(mdp.absorbing()[:, None], 1.0, policy / behavior)
    probabilities = []
    estimates = []
    for probability, steps in paths(mdp, behavior, horizon):
        value = 0.0
        for t, (s, a, _, r) in reversed(list(enumerate(steps))):
            value = values[t][s] + ratio[s, a] * (
                r - pairs[t, s, a] + mdp.discount * value
            )
        probabilities.append(probability)
        estimates.append(value)
    probabilities = np.array(probabilities)
    estimates = np.array(estimates)
    mean = probabilities @ estimates
    tree, markov = (
        oee.trajectory_efficiency_bound(
            mdp, behavior, policy, horizon=horizon, model=model
        )
        for model in ("tree", "mdp")
    )
    scale = max(1.0, tree)
    assert_allclose(
        probabilities @ (estimates - mean) ** 2, tree, rtol=1e-9, atol=1e-10 * scale
    )
    assert_allclose(
        mean, oee.policy_value(mdp, policy, horizon=horizon), rtol=1e-9, atol=1e-9
    )
    assert markov <= tree + 1e-10 * scale
    alpha = mdp.initial
    beta = mdp.initial
    q_noise = 0.0
    own = mdp.initial @ (values[0] - mdp.initial @ values[0]) ** 2
    for t in range(horizon):
        ahead = paid + mdp.discount * values[t + 1]
        factor = mdp.discount ** (2 * t)
        spread = (
            transitions
            * (ahead - (transitions * ahead).sum(axis=2, keepdims=True)) ** 2
        ).sum(axis=2)
        q_noise += (
            factor * alpha @ (policy * (pairs[t] - values[t][:, None]) ** 2).sum(axis=1)
        )
        mine = alpha[:, None] * policy
        theirs = beta[:, None] * behavior
        own += (
            factor
            * np.divide(
                mine**2 * spread, theirs, out=np.zeros_like(mine), where=theirs > 0
            ).sum()
        )
        alpha, beta = (np.einsum("sa,sat->t", x, transitions) for x in (mine, theirs))
    assert_allclose(markov, own, rtol=1e-9, atol=1e-10 * scale)
    on_policy = oee.trajectory_efficiency_bound(mdp, policy, policy, horizon=horizon)
    plain = oee.return_moments(mdp, policy, horizon=horizon)
    assert_allclose(
        plain.variance,
        on_policy + q_noise,
        rtol=1e-8,
        atol=1e-9 * max(1.0, plain.variance),
    )


@given(rngs)
def test_finite_horizons_of_the_ratio_of_ratios(rng):
    simulator = random_mdp(rng, n_states=3, discount=0.5, zeros=0.0)
    target = random_mdp(rng, like=simulator)
    policy = random_policy(rng, simulator)
    share = shares(rng, simulator)
    for rows in ("as_they_are", "normalised"):
        infinite, long = (
            ratio_of_ratios_variance(
                simulator, target, policy, share, share, rows=rows, horizon=h
            )
            for h in (None, 120)
        )
        assert_allclose(long, infinite, rtol=1e-9, atol=1e-12)


@given(rngs)
def test_the_four_quotients_against_a_delta_method(rng):
    """The four variances equal the delta method's, by central differences.

    lim n Var of J as a function of the four samples' frequencies uses no formula of the
    package.
    """
    size = int(rng.integers(2, 4))
    simulator = oee.FiniteMDP(
        rng.dirichlet(np.ones(size) * 2, (size, 2)),
        rng.normal(size=(size, 2)),
        [1] + [0] * (size - 1),
        0.7,
    )
    target = simulator.with_transitions(rng.dirichlet(np.ones(size) * 2, (size, 2)))
    policy = rng.dirichlet(np.ones(2), size)
    share, other = (
        rng.dirichlet(np.ones(2 * size) * 3).reshape(size, 2) for _ in range(2)
    )
    p = dense(target)[0]
    q = dense(simulator)[0]
    moves = [share[:, :, None] * p, other[:, :, None] * q]

    def value(a, b, c, d, normalised):
        """Compute J from the frequencies of four samples.

        a and b are the transitions of the log and of the simulator; c and d are behind
        the (s, a) ratio.
        """
        kernel = (a / b) / (c.sum(axis=2) / d.sum(axis=2))[:, :, None] * q
        if normalised:
            kernel = kernel / kernel.sum(axis=2, keepdims=True)
        paid = (policy * target.rewards).sum(axis=1)
        system = np.eye(size) - 0.7 * np.einsum("sa,sat->st", policy, kernel)
        return target.initial @ np.linalg.solve(system, paid)

    def variance(f, cells):
        """Of f at multinomial frequencies: sum cells slope^2 - (sum cells slope)^2."""
        slope = np.zeros(cells.size)
        for i in range(cells.size):
            ends = []
            for sign in (1, -1):
                moved = cells.copy()
                moved.flat[i] *= 1 + sign * 1e-5
                ends.append(f(moved))
            slope[i] = (ends[0] - ends[1]) / (2e-5 * cells.flat[i])
        weight = cells.reshape(-1)
        return weight @ slope**2 - (weight @ slope) ** 2

    for rows in ("as_they_are", "normalised"):
        for apart in (False, True):
            n = rows == "normalised"
            if apart:
                parts = [
                    lambda x, n=n: value(x, moves[1], *moves, n),
                    lambda x, n=n: value(moves[0], x, *moves, n),
                    lambda x, n=n: value(*moves, x, moves[1], n),
                    lambda x, n=n: value(*moves, moves[0], x, n),
                ]
                expected = sum(variance(f, moves[i % 2]) for i, f in enumerate(parts))
            else:
                expected = variance(
                    lambda x, n=n: value(x, moves[1], x, moves[1], n), moves[0]
                )
                expected += variance(
                    lambda x, n=n: value(moves[0], x, moves[0], x, n), moves[1]
                )
            found = ratio_of_ratios_variance(
                simulator,
                target,
                policy,
                share,
                other,
                rows=rows,
                independent_samples=apart,
            )
            assert_allclose(found, expected, rtol=1e-5, atol=1e-7)


def fisher_bound(mdp, behavior, policy, horizon):
    """Compute g' I^-1 g, I the information of all paths in the rows' free coordinates.

    A row has as many coordinates as transitions with probability, less one.
    """
    transitions, _ = dense(mdp)
    free = [
        (s, a, j)
        for s, a in np.ndindex(*behavior.shape)
        for j in np.flatnonzero(transitions[s, a])[:-1]
    ]
    last = {
        (s, a): np.flatnonzero(transitions[s, a])[-1]
        for s, a in np.ndindex(*behavior.shape)
    }
    information = np.zeros((len(free), len(free)))
    for probability, steps in paths(mdp, behavior, horizon):
        score = np.zeros(len(free))
        for s, a, following, _ in steps:
            for i, (x, b, j) in enumerate(free):
                if (x, b) == (s, a):
                    score[i] += (following == j) / transitions[s, a, j]
                    score[i] -= (following == last[s, a]) / transitions[
                        s, a, last[s, a]
                    ]
        information += probability * np.outer(score, score)
    slope = np.zeros(len(free))
    for i, (s, a, j) in enumerate(free):
        ends = []
        for step in (1e-6, -1e-6):
            moved = transitions.copy()
            moved[s, a, j] += step
            moved[s, a, last[s, a]] -= step
            ends.append(Dense(mdp).like(moved).J(policy, horizon))
        slope[i] = (ends[0] - ends[1]) / 2e-6
    return float(slope @ np.linalg.pinv(information, rcond=1e-10) @ slope)


@settings(max_examples=15)
@given(rngs, st.sampled_from([1, 2, 3]))
def test_the_bound_for_one_kernel_is_that_of_the_fisher_information_of_all_paths(
    rng, form
):
    mdp = random_mdp(
        rng,
        n_states=int(rng.integers(2, 4)),
        n_actions=int(rng.integers(1, 3)),
        form=form,
        discount=0.9,
    )
    behavior = random_policy(rng, mdp, zeros=0.0)
    policy = random_policy(rng, mdp)
    horizon = int(rng.integers(1, 4))
    found, markov = (
        oee.trajectory_efficiency_bound(mdp, behavior, policy, horizon=horizon, model=m)
        for m in ("stationary", "mdp")
    )
    assert_allclose(
        found, fisher_bound(mdp, behavior, policy, horizon), rtol=1e-6, atol=1e-7
    )
    assert found <= markov * (1 + 1e-9) + 1e-9


SHARE = np.array([[0.1, 0.2], [0.15, 0.05], [0.3, 0.2]])


@pytest.mark.parametrize("form", [1, 2, 3])
def test_the_leading_bias_is_that_of_second_differences(form):
    """The leading bias is 1/2 sum_x sum_s' P' D^2 J / data_distribution(x).

    D^2 J is the second difference in the direction e_s' - P'(x).
    """
    _, target = environments(form)
    base = Dense(target)
    rows = base.P.reshape(6, 3)
    step = 1e-3
    total = 0.0
    for x in range(6):
        for j in range(3):
            direction = np.zeros((6, 3))
            direction[x] = np.eye(3)[j] - rows[x]
            ends = [
                base.like((rows + sign * step * direction).reshape(3, 2, 3)).J(POLICY)
                for sign in (1, -1)
            ]
            total += (
                rows[x, j]
                * (sum(ends) - 2 * base.J(POLICY))
                / step**2
                / 2
                / SHARE.reshape(-1)[x]
            )
    assert abs(total) > 0.01
    assert_allclose(leading_bias(target, POLICY, SHARE), total, rtol=1e-4)


def test_only_actions_within_reach_must_be_taken():
    """The behaviour policy must take an action only where the horizon reaches.

    In a corridor it lacks action 1 in the third state, which two transitions reach and
    one does not.
    """
    rows = np.zeros((4, 2, 4))
    rows[[0, 1, 2, 3], :, [1, 2, 3, 0]] = 1.0
    mdp = FiniteMDP(rows, np.ones(4), [1, 0, 0, 0], 0.9)
    half = np.full((4, 2), 0.5)
    never = np.eye(2)[[1, 1, 1, 1]]
    without = half.copy()
    without[2] = [1.0, 0.0]
    for horizon in (1, 2):
        oee.trajectory_efficiency_bound(mdp, without, half, horizon=horizon)
    for horizon in (3, 4, 9):
        with pytest.raises(
            ValueError,
            match=(
                r"in state 2 it never takes action 1 \(1 such state-action pairs in"
                r" all\)$"
            ),
        ):
            oee.trajectory_efficiency_bound(mdp, without, half, horizon=horizon)
    oee.trajectory_efficiency_bound(mdp, without, without, horizon=9)
    with pytest.raises(
        ValueError, match=r"in state 0 it never takes action 0 \(4 such"
    ):
        oee.trajectory_efficiency_bound(mdp, never, half, horizon=9)
    # no action matters
    over = FiniteMDP(np.ones((1, 2, 1)), np.zeros((1, 2)), [1.0], 0.9)
    assert (
        oee.trajectory_efficiency_bound(over, [[1.0, 0.0]], [[0.5, 0.5]], horizon=3)
        == 0.0
    )
