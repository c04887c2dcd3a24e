"""Exact moments equal the enumeration of every path.

Statements are named in brackets (notebooks/statements.md).
"""

import warnings

import numpy as np
import pytest
from helpers import (
    BEHAVIOR,
    POLICY,
    dense,
    environments,
    paths,
    random_mdp,
    random_policy,
    ratio_of,
    rngs,
    survival_chain,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular.exact import weight_growth, weight_moments

KINDS = ("per_decision", "trajectory")


def values_to_go(mdp, policy, horizon):
    """(T + 1, S)."""
    values = [
        oee.state_values(mdp, policy, horizon=horizon - t) for t in range(horizon)
    ]
    return np.stack([*values, np.zeros(mdp.n_states)])


def enumerated(mdp, drawn, u, w, horizon, kind):
    """Enumerate every path with its probability.

    Each has (probability, X, last weight, return, weights of the rewards, weighted
    rewards).
    """
    by_move = mdp.transition_rewards is not None
    over = mdp.absorbing()
    rows = []
    for probability, steps in paths(mdp, drawn, horizon):
        weight = 1.0
        total = 0.0
        plain = 0.0
        weights = []
        paid = []
        for t, (s, a, following, r) in enumerate(steps):
            weight *= 1.0 if over[s] else u[s, a]
            move = 1.0 if over[s] else w[s, a, following]
            carried = weight * move if by_move else weight
            weight *= 1.0 if not by_move and t == horizon - 1 else move
            total += mdp.discount**t * carried * r
            plain += mdp.discount**t * r
            weights.append(carried)
            paid.append(carried * r)
        rows.append(
            (
                probability,
                total if kind == "per_decision" else weight * plain,
                weight,
                plain,
                weights,
                paid,
            )
        )
    return [np.array(column) for column in zip(*rows, strict=True)]


def moments_of(probability, x):
    mean = probability @ x
    return mean, probability @ (x - mean) ** 2, probability @ x**2


def check(found, probability, x):
    mean, variance, second = moments_of(probability, x)
    scale = max(second, 1e-12)
    assert abs(found.mean - mean) <= 1e-10 * np.sqrt(scale) + 1e-14
    assert abs(found.variance - variance) <= 1e-10 * scale + 1e-14


def check_sources(found, mdp, drawn, x, horizon):
    """Check Var E[X | path to s_t+1] - Var E[X | path to s_t] against ``sources``.

    The start's part comes first; the parts of the steps are also summed by their states
    s_t.
    """
    every = paths(mdp, drawn, horizon)
    probability = np.array([p for p, _ in every])
    before = moments_of(np.array([p for p, _ in every]), x)[0]
    scale = max(1.0, probability @ x**2)
    by_state = np.zeros(mdp.n_states)
    for t in range(horizon + 1):
        groups = {}
        level = np.empty(len(x))
        for k, (_, steps) in enumerate(every):
            known = (
                tuple(step[:2] for step in steps[:t]),
                steps[t][0] if t < horizon else steps[-1][2],
            )
            groups.setdefault(known, []).append(k)
        for members in groups.values():
            level[members] = (
                probability[members] @ x[members] / probability[members].sum()
            )
        part = probability * (level - before) ** 2
        before = level
        assert_allclose(found.by_step[t], part.sum(), rtol=1e-8, atol=1e-11 * scale)
        if t > 0:
            np.add.at(by_state, [steps[t - 1][0] for _, steps in every], part)
    assert_allclose(found.by_state, by_state, rtol=1e-8, atol=1e-11 * scale)


@settings(max_examples=200)
@given(rngs, st.sampled_from(KINDS))
def test_19_products_of_ratios_equal_enumeration(rng, kind):
    """Products of ratios equal enumeration to 1e-10 of E X^2 [19, 42].

    Rewards are r(s), r(s, a) and r(s, a, s'), zeta is any ratio, and there is one
    policy or one for each step.
    """
    simulator = random_mdp(
        rng, n_states=int(rng.integers(1, 4)), n_actions=int(rng.integers(1, 3))
    )
    policy = random_policy(rng, simulator)
    zeta = ratio_of(rng, simulator)
    horizon = int(rng.integers(1, 4))
    if rng.random() < 0.3:
        policy = np.stack([random_policy(rng, simulator) for _ in range(horizon)])
    w = zeta.toarray().reshape(simulator.n_states, simulator.n_actions, -1)
    probability, x, *_ = enumerated(
        simulator, policy, np.ones(simulator.rewards.shape), w, horizon, kind
    )
    found = oee.weighted_return_moments(
        simulator, zeta, policy, kind=kind, horizon=horizon, sources=True
    )
    check(found, probability, x)
    check_sources(found, simulator, policy, x, horizon)
    bare = oee.weighted_return_moments(
        simulator, zeta, policy, kind=kind, horizon=horizon
    )
    assert (bare.mean, bare.variance, bare.by_step, bare.by_state) == (
        found.mean,
        found.variance,
        None,
        None,
    )


@settings(max_examples=60)
@given(rngs, st.sampled_from(KINDS))
def test_19_policy_importance_sampling_equals_enumeration(rng, kind):
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 4)), n_actions=2)
    behavior = random_policy(rng, mdp)
    policy = random_policy(rng, mdp)
    horizon = int(rng.integers(1, 4))
    u = np.divide(policy, behavior, out=np.zeros_like(policy), where=behavior > 0)
    ones = np.ones((mdp.n_states, 2, mdp.n_states))
    probability, x, *_ = enumerated(mdp, behavior, u, ones, horizon, kind)
    check(
        oee.policy_is_moments(mdp, behavior, policy, kind=kind, horizon=horizon),
        probability,
        x,
    )


@settings(max_examples=60)
@given(rngs, st.sampled_from(KINDS))
def test_self_normalised_limits_variances_and_biases(rng, kind):
    """The bias is -(E[W^2 G] - J E[W^2]) / N, and N * MSE -> E[W^2 (G - J)^2].

    Weights are scaled to mean 1.
    """
    simulator = random_mdp(rng, n_states=int(rng.integers(1, 4)), n_actions=2)
    policy = random_policy(rng, simulator)
    horizon = int(rng.integers(1, 4))
    zeta = ratio_of(rng, simulator)
    w = zeta.toarray().reshape(simulator.n_states, 2, -1)
    probability, _, last, plain, weights, paid = enumerated(
        simulator, policy, np.ones_like(policy), w, horizon, kind
    )
    with warnings.catch_warnings(record=True, action="always") as said:
        found = oee.weighted_return_moments(
            simulator,
            zeta,
            policy,
            kind=kind,
            horizon=horizon,
            self_normalized=True,
            sources=True,
        )
    assert bool(said) == np.isnan(found.mean)
    gamma = simulator.discount ** np.arange(horizon)
    if kind == "trajectory":
        mass = probability @ last
        if mass == 0:
            assert np.isnan(found.mean)
            return
        limit = probability @ (last * plain) / mass
        influence = last * (plain - limit) / mass
        bias = -(probability @ (last**2 * (plain - limit))) / mass**2
    else:
        mass = probability @ weights
        if (mass == 0).any():
            assert np.isnan(found.mean)
            return
        level = probability @ paid / mass
        limit = gamma @ level
        influence = ((paid - level * weights) / mass) @ gamma
        bias = -gamma @ (probability @ (weights * (paid - level * weights)) / mass**2)
    scale = max(1.0, probability @ influence**2)
    assert_allclose(found.mean, limit, rtol=1e-10, atol=1e-11)
    assert_allclose(found.variance, probability @ influence**2, atol=1e-9 * scale)
    assert_allclose(found.bias, bias, rtol=1e-8, atol=1e-9 * scale)
    check_sources(found, simulator, policy, influence, horizon)


@settings(max_examples=60)
@given(rngs, st.booleans(), st.booleans())
def test_22_42_doubly_robust_moments_equal_enumeration(rng, action_baseline, own):
    """The mean is J(zeta P) for every baseline.

    The variance is the variance of the recursion's definition on each path.
    """
    simulator = random_mdp(
        rng, n_states=int(rng.integers(1, 4)), n_actions=int(rng.integers(1, 3))
    )
    policy = random_policy(rng, simulator)
    zeta = ratio_of(rng, simulator)
    horizon = int(rng.integers(1, 4))
    baseline = rng.normal(size=(horizon + 1, simulator.n_states)) if own else None
    found = oee.doubly_robust_moments(
        simulator,
        zeta,
        policy,
        baseline=baseline,
        horizon=horizon,
        action_baseline=action_baseline,
        sources=True,
    )
    assert_allclose(found.by_step.sum(), found.variance, rtol=1e-9, atol=1e-12)
    assert_allclose(
        found.by_step[0] + found.by_state.sum(), found.variance, rtol=1e-9, atol=1e-12
    )
    u = (
        values_to_go(simulator, policy, horizon)
        if baseline is None
        else baseline.copy()
    )
    u[horizon] = 0  # row T is not used
    transitions, rewards = dense(simulator)
    over = simulator.absorbing()
    w = zeta.toarray().reshape(transitions.shape)
    w[over] = 1.0
    by_move = simulator.transition_rewards is not None
    gamma = simulator.discount
    probabilities = []
    values = []
    for probability, steps in paths(simulator, policy, horizon):
        value = 0.0
        for t in range(horizon - 1, -1, -1):
            s, a, following, r = steps[t]
            moved = gamma * u[t + 1] + (rewards[s] if by_move else 0.0)
            known = (transitions[s] * w[s] * moved).sum(axis=1) + (
                0.0 if by_move else rewards[s, :, 0]
            )
            left = r if by_move else 0.0
            expected = (known * policy[s]).sum() if action_baseline else known[a]
            value = expected + w[s, a, following] * (
                left + gamma * value - (left + gamma * u[t + 1][following])
            )
        probabilities.append(probability)
        values.append(value)
    check(found, np.array(probabilities), np.array(values))
    kernel = oee.weighted_return_moments(simulator, zeta, policy, horizon=horizon)
    assert_allclose(found.mean, kernel.mean, rtol=1e-9, atol=1e-10)


@given(rngs)
def test_23_with_the_true_values_only_the_start_varies(rng):
    """With the true values doubly robust is exact for any zeta whose rows sum to 1.

    Here zeta is the true one; with the action baseline Var = Var V_0(s_0).
    """
    simulator = random_mdp(rng)
    target = random_mdp(rng, like=simulator)
    policy = random_policy(rng, simulator)
    zeta = oee.true_ratio(target, simulator)
    values = values_to_go(target, policy, 4)
    found = oee.doubly_robust_moments(
        simulator, zeta, policy, baseline=values, horizon=4, action_baseline=True
    )
    start = target.initial @ (values[0] - target.initial @ values[0]) ** 2
    assert_allclose(found.variance, start, atol=1e-9 * max(1.0, found.mean**2))
    assert_allclose(
        found.mean, oee.policy_value(target, policy, horizon=4), rtol=1e-9, atol=1e-10
    )


@given(rngs)
def test_20_21_the_mean_is_the_value_of_the_model(rng):
    """Per decision: J(zeta P). With rows that sum to 1 the trajectory's is the same."""
    simulator = random_mdp(rng, discount=0.9)
    target = random_mdp(rng, like=simulator)
    policy = random_policy(rng, simulator)
    any_zeta = ratio_of(rng, simulator)
    model = oee.exact.reweight(simulator, any_zeta)
    # there weights stand still, in the model they need not
    if not simulator.absorbing().any():
        found = oee.weighted_return_moments(simulator, any_zeta, policy, horizon=4)
        assert_allclose(
            found.mean,
            oee.policy_value(model, policy, horizon=4),
            rtol=1e-9,
            atol=1e-10,
        )
    truth = oee.policy_value(target, policy, horizon=4)
    for kind in KINDS:
        zeta = oee.true_ratio(target, simulator)
        found = oee.weighted_return_moments(
            simulator, zeta, policy, kind=kind, horizon=4
        )
        assert_allclose(found.mean, truth, rtol=1e-9, atol=1e-9)


def test_an_infinite_sum_without_a_variance_names_the_radius():
    """gamma^2 rho(P zeta^2) = .9^2 * 1.5 = 1.215."""
    simulator = oee.FiniteMDP(np.full((2, 1, 2), 0.5), np.ones(2), [1, 0], 0.9)
    zeta = sparse.csr_array(np.array([[1 + 0.5**0.5, 1 - 0.5**0.5]] * 2))
    with pytest.raises(
        ValueError,
        match=r"horizon must be given: .* no variance.*spectral radius of 1\.215",
    ):
        oee.weighted_return_moments(simulator, zeta, np.ones((2, 1)))
    assert_allclose(weight_growth(simulator, zeta, np.ones((2, 1))), np.log(1.5))


@given(rngs)
def test_10_12_26_moments_of_the_weight(rng):
    """E W_t = 1 for the true ratio, and |alpha_t|_1 for any ratio.

    E W_t^2 does not fall, and grows at weight_growth; it is 1 if P = P'.
    """
    simulator = random_mdp(rng, n_states=3)
    target = random_mdp(rng, like=simulator)
    policy = random_policy(rng, simulator)
    zeta = oee.true_ratio(target, simulator)
    first, second = weight_moments(simulator, zeta, policy, horizon=6)
    assert_allclose(first, 1.0, rtol=1e-12)
    assert (np.diff(second) >= -1e-12 * second[1:]).all()
    chi = np.asarray(
        simulator.transitions.multiply(zeta.values.multiply(zeta.values)).sum(axis=1)
    ).max()
    assert (second <= chi ** np.arange(7) * (1 + 1e-12)).all()
    same = oee.true_ratio(simulator, simulator)
    for kind in KINDS:
        found = oee.weighted_return_moments(
            simulator, same, policy, kind=kind, horizon=5
        )
        plain = oee.return_moments(simulator, policy, horizon=5)
        assert_allclose(
            (found.mean, found.variance),
            (plain.mean, plain.variance),
            rtol=1e-10,
            atol=1e-11,
        )
    if not simulator.absorbing().any():
        other = ratio_of(rng, simulator)
        alpha = simulator.initial
        kernel = other.multiply(simulator.transitions).toarray().reshape(3, -1, 3)
        for mass in weight_moments(simulator, other, policy, horizon=6)[0]:
            assert_allclose(mass, alpha.sum(), rtol=1e-10, atol=1e-12)
            alpha = np.einsum("s,sa,sat->t", alpha, policy, kernel)


@given(rngs)
def test_25_the_law_of_total_variance(rng):
    """The variance of the return follows the law of total variance, for r(s, a).

    Var G = Var V_0 + sum gamma^2t E Var_a Q_t + gamma^(2t+2) E Var V_{t+1}.
    """
    mdp = random_mdp(rng, form=2)
    policy = random_policy(rng, mdp)
    horizon = 4
    values = values_to_go(mdp, policy, horizon)
    transitions, _ = dense(mdp)
    total = mdp.initial @ (values[0] - mdp.initial @ values[0]) ** 2
    reached = mdp.initial
    for t in range(horizon):
        ahead = transitions @ values[t + 1]
        pairs = mdp.rewards + mdp.discount * ahead
        spread_a = (
            policy * (pairs - (policy * pairs).sum(axis=1, keepdims=True)) ** 2
        ).sum(axis=1)
        spread_s = np.einsum(
            "sa,sat,sat->s",
            policy,
            transitions,
            (values[t + 1][None, None] - ahead[:, :, None]) ** 2,
        )
        total += (
            mdp.discount ** (2 * t) * reached @ (spread_a + mdp.discount**2 * spread_s)
        )
        reached = np.einsum("s,sa,sat->t", reached, policy, transitions)
    found = oee.return_moments(mdp, policy, horizon=horizon)
    assert_allclose(found.variance, total, rtol=1e-9, atol=1e-10)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.filterwarnings("ignore:a moment is beyond the largest float")
def test_variances_beyond_floats():
    """E[W_t^2] = 1.64^t: there is no finite variance, but the mean keeps its digits.

    Nothing ends in an error of arithmetic.
    """
    simulator, target = (
        oee.FiniteMDP([[[1 - p, p]]] * 2, [0, 1], [0.5, 0.5], 0.999) for p in (0.5, 0.9)
    )
    known = simulator, oee.true_ratio(target, simulator), [[1.0]] * 2
    value = oee.policy_value(target, known[-1], horizon=2000)
    for kind in KINDS:
        found = oee.weighted_return_moments(*known, kind=kind, horizon=2000)
        assert_allclose(found.mean, value, rtol=1e-9)
        assert not np.isfinite(found.variance)
    for weight in (0.1, 4.0):
        constant = simulator, (simulator.transitions > 0) * weight, known[-1]
        oee.weighted_return_moments(
            *constant, horizon=300, kind="trajectory", self_normalized=True
        )


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_states_that_are_never_reached_may_pay_anything():
    chain = [[[0.5, 0.5, 0]], [[0.5, 0.5, 0]], [[0, 0, 1.0]]]
    huge, small = (
        oee.FiniteMDP(chain, [0, 1, pay], [1, 0, 0], 0.5) for pay in (1e200, 1.0)
    )
    for options in ({"kind": "per_decision"}, {"kind": "trajectory"}):
        one, two = (
            oee.weighted_return_moments(
                m, oee.true_ratio(m, m), [[1.0]] * 3, horizon=3, **options
            )
            for m in (huge, small)
        )
        assert_allclose((one.mean, one.variance), (two.mean, two.variance), rtol=1e-12)


def test_worked_example_the_survival_chain():
    """G of two steps: 1 + .9 with probability .7, else 1; Bernoulli variance .21 * .81."""
    chain = survival_chain()
    found = oee.return_moments(chain, np.ones((2, 1)), horizon=2, sources=True)
    assert_allclose(found.mean, 1 + 0.9 * 0.7)
    assert_allclose(found.variance, 0.81 * 0.21)
    assert_allclose(found.by_step, [0, 0.81 * 0.21, 0], atol=1e-15)
    assert_allclose(found.standard_deviation, 0.9 * 0.21**0.5)


def test_no_cancellation():
    """With rewards of 1e8 plus a coin, the coin's variance keeps its digits.

    E X^2 - (E X)^2 would have none.
    """
    coin = np.array([1e8, 1e8 + 0.5])
    mdp = oee.FiniteMDP(np.full((2, 1, 2), 0.5), coin, [1, 0], 0.5)
    exact = ((coin[1] - coin[0]) / 2) ** 2 * (0.25 + 0.0625)
    assert_allclose(
        oee.return_moments(mdp, np.ones((2, 1)), horizon=3).variance, exact, rtol=1e-6
    )


@given(rngs, st.sampled_from(KINDS))
def test_05_06_07_relabelling_and_longer_horizons_change_nothing(rng, kind):
    """[5] states and actions in another order; [7] steps after sure absorption."""
    simulator = random_mdp(rng, n_states=3, n_actions=2)
    policy = random_policy(rng, simulator)
    zeta = ratio_of(rng, simulator)
    states = rng.permutation(3)
    actions = rng.permutation(2)
    transitions, rewards = dense(simulator)
    if simulator.transition_rewards is None:
        paid = simulator.rewards[np.ix_(states, actions)]
    else:
        paid = rewards[np.ix_(states, actions, states)]
    other = oee.FiniteMDP(
        transitions[np.ix_(states, actions, states)],
        paid,
        simulator.initial[states],
        simulator.discount,
    )
    weights = (
        zeta.toarray().reshape(3, 2, 3)[np.ix_(states, actions, states)].reshape(6, 3)
    )
    found, moved = (
        oee.weighted_return_moments(m, z, p, kind=kind, horizon=3)
        for m, z, p in (
            (simulator, zeta, policy),
            (other, sparse.csr_array(weights), policy[np.ix_(states, actions)]),
        )
    )
    assert_allclose(
        (moved.mean, moved.variance), (found.mean, found.variance), rtol=1e-9, atol=1e-9
    )
    chain = oee.FiniteMDP(
        np.array([[[0, 0.5, 0.5]], [[0, 0, 1]], [[0, 0, 1]]]),
        np.array([1.0, 2.0, 0.0]),
        [1, 0, 0],
        0.9,
    )
    tilted = sparse.csr_array(np.array([[0, 1.5, 0.5], [0, 0, 1.2], [0, 0, 7.0]]))
    short, long = (
        oee.weighted_return_moments(
            chain, tilted, np.ones((3, 1)), kind="per_decision", horizon=h
        )
        for h in (3, 9)
    )
    assert_allclose(
        (short.mean, short.variance), (long.mean, long.variance), rtol=1e-12
    )


def test_policy_importance_sampling_with_both_policies_in_time():
    """A behaviour policy for each step, the evaluated one for each step or for all."""
    mdp, _ = environments(2)
    moving = np.stack([BEHAVIOR, POLICY, BEHAVIOR])
    for policy in (POLICY, np.stack([POLICY, BEHAVIOR, POLICY])):
        found = oee.policy_is_moments(mdp, moving, policy, horizon=3)
        assert_allclose(
            found.mean, oee.policy_value(mdp, policy, horizon=3), rtol=1e-12
        )
    same = oee.policy_is_moments(mdp, moving, moving, horizon=3)
    plain = oee.return_moments(mdp, moving, horizon=3)
    assert_allclose(
        (same.mean, same.variance), (plain.mean, plain.variance), rtol=1e-12
    )


@pytest.mark.parametrize("how", [{}, {"kind": "trajectory"}, {"self_normalized": True}])
def test_weights_beyond_floats_are_reported(how):
    """A variance that is not a number comes with a word, whatever the mean."""
    simulator = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0, 1.0], [0.5, 0.5], 0.5)
    zeta = simulator.transitions.copy()
    zeta.data = np.array([1e308, 1.0, 1e308, 1.0])
    with pytest.warns(UserWarning, match="a moment is beyond the largest float"):
        found = oee.weighted_return_moments(
            simulator, zeta, [[1.0]] * 2, horizon=3, **how
        )
    assert np.isnan(found.variance)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", ["actions", "transitions", "steps"])
def test_a_self_normalised_bias_is_kept_where_the_mean_is_exactly_0(case, kind):
    """[31] A sum r + b in place of r moves every estimate by b, and its bias by 0."""

    def found(shift):
        if case == "actions":
            mdp = oee.FiniteMDP([[[1.0], [1.0]]], [[shift - 1, shift + 1]], [1.0], 0.5)
            return oee.policy_is_moments(
                mdp,
                [[0.75, 0.25]],
                [[0.5, 0.5]],
                kind=kind,
                horizon=1,
                self_normalized=True,
            )
        if case == "transitions":  # the ratio leads to 0 and 1 evenly
            rewards = [[[shift - 1, shift + 1]]] * 2
            ratio = sparse.csr_array([[2.0, 2.0 / 3.0]] * 2)
            horizon = 1
        else:  # a state's reward at t = 1, 2: only then has the weight a spread
            rewards = [shift - 1, shift + 1]
            ratio = sparse.csr_array([[2.0, 2.0 / 3.0]] * 2)
            horizon = 3
        mdp = oee.FiniteMDP([[[0.25, 0.75]]] * 2, rewards, [0.5, 0.5], 0.5)
        return oee.weighted_return_moments(
            mdp,
            ratio,
            [[1.0]] * 2,
            kind=kind,
            horizon=horizon,
            self_normalized=True,
        )

    zero = found(0.0)
    moved = found(3.0)
    assert abs(zero.mean) < 1e-15
    assert moved.mean > 1.0
    assert abs(moved.bias) > 1e-3
    assert_allclose(zero.bias, moved.bias, rtol=1e-12)
    assert_allclose(zero.variance, moved.variance, rtol=1e-12)


@given(rngs)
@settings(max_examples=20, deadline=None)
def test_no_control_variate_of_the_first_state_saves_more_than_its_value(rng):
    """Var G - Var V_0(s_0) is what is left by the best, by every path."""
    mdp = random_mdp(rng, n_states=3, n_actions=2, discount=0.7)
    policy = random_policy(rng, mdp)
    every = paths(mdp, policy, 3)
    chance = np.array([p for p, _ in every])
    first = np.array([steps[0][0] for _, steps in every])
    returns = np.array(
        [sum(0.7**t * r for t, (*_, r) in enumerate(steps)) for _, steps in every]
    )
    moments = oee.return_moments(mdp, policy, horizon=3, sources=True)
    scale = max(1.0, chance @ returns**2)
    values = oee.state_values(mdp, policy, horizon=3)
    spread = mdp.initial @ (values - moments.mean) ** 2
    assert_allclose(moments.by_step[0], spread, atol=1e-10 * scale)
    for control in (values, rng.normal(size=3), rng.normal(size=3)):
        left = returns - control[first]
        variance = chance @ (left - chance @ left) ** 2
        assert variance >= moments.variance - spread - 1e-10 * scale
        if control is values:
            assert_allclose(variance, moments.variance - spread, atol=1e-10 * scale)
