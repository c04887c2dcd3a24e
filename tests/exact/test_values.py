from fractions import Fraction

import numpy as np
import pytest
from helpers import (
    Dense,
    dense,
    dense_values,
    environments,
    random_mdp,
    random_policy,
    rngs,
    survival_chain,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact


@pytest.mark.parametrize("seed", range(200))
def test_values_and_occupancies_agree_with_dense_linear_algebra(seed):
    rng = np.random.default_rng(seed)
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 40)))
    policy = random_policy(rng, mdp)
    scale = max(1.0, np.abs(mdp.rewards).max() / (1 - mdp.discount))
    values = dense_values(mdp, policy)
    assert_allclose(oee.state_values(mdp, policy), values, rtol=0, atol=1e-9 * scale)
    transitions, rewards = dense(mdp)
    q = np.einsum("sat,sat->sa", transitions, rewards + mdp.discount * values)
    assert_allclose(oee.action_values(mdp, policy), q, rtol=0, atol=1e-9 * scale)
    assert_allclose(
        oee.policy_value(mdp, policy), mdp.initial @ values, rtol=0, atol=1e-9 * scale
    )
    pairs = (1 - mdp.discount) * Dense(mdp).visits(policy)
    assert_allclose(oee.occupancy(mdp, policy), pairs, rtol=0, atol=1e-9)
    assert_allclose(
        oee.occupancy(mdp, policy, of="state"), pairs.sum(axis=1), rtol=0, atol=1e-9
    )
    moves = (
        oee.occupancy(mdp, policy, of="transition").toarray().reshape(transitions.shape)
    )
    assert_allclose(moves, pairs[:, :, None] * transitions, rtol=0, atol=1e-9)


@given(rngs, st.sampled_from([None, 1, 7]))
def test_flow_and_duality_of_the_occupancy(rng, horizon):
    """Statements 1 and 2: the flow equation, and mu_0 . V = d . r * sum gamma^t."""
    mdp = random_mdp(rng)
    policy = random_policy(rng, mdp)
    pairs = oee.occupancy(mdp, policy, horizon=horizon)
    assert_allclose(pairs.sum(), 1.0, rtol=1e-9)
    mass = (
        1 / (1 - mdp.discount)
        if horizon is None
        else (mdp.discount ** np.arange(horizon)).sum()
    )
    value = oee.policy_value(mdp, policy, horizon=horizon)
    assert_allclose(
        (pairs * mdp.rewards).sum() * mass,
        value,
        rtol=0,
        atol=1e-9 * max(1, abs(value)),
    )
    if horizon is None:
        flow = (1 - mdp.discount) * mdp.initial + mdp.discount * (
            mdp.transitions.T @ pairs.reshape(-1)
        )
        assert_allclose(pairs.sum(axis=1), flow, rtol=0, atol=1e-9)


@given(rngs, st.sampled_from([None, 4]))
def test_affine_rewards_give_affine_values(rng, horizon):
    """Statement 3."""
    mdp = random_mdp(rng, form=3)
    policy = random_policy(rng, mdp)
    table = mdp.transition_rewards.copy()
    table.data = 3.0 * mdp.transition_rewards.data - 2.0
    mass = (
        1 / (1 - mdp.discount)
        if horizon is None
        else (mdp.discount ** np.arange(horizon)).sum()
    )
    changed = oee.policy_value(mdp.with_rewards(table), policy, horizon=horizon)
    assert_allclose(
        changed,
        3 * oee.policy_value(mdp, policy, horizon=horizon) - 2 * mass,
        rtol=1e-9,
        atol=1e-9,
    )


def test_the_survival_chain_in_closed_form():
    for discount in (0.0, 0.5, 0.9, 1.0):
        chain = survival_chain(discount)
        assert_allclose(
            oee.policy_value(chain, np.ones((2, 1))),
            1 / (1 - 0.7 * discount),
            rtol=1e-14,
        )
    assert_allclose(
        oee.policy_value(survival_chain(1.0), np.ones((2, 1)), horizon=3),
        1 + 0.7 + 0.49,
        rtol=1e-14,
    )
    for horizon in (None, 5):
        raw, normal = (
            oee.policy_value(survival_chain(), [[1]] * 2, horizon=horizon, normalized=n)
            for n in (False, True)
        )
        assert_allclose(normal, 0.1 * raw, rtol=1e-14)


def test_discount_one_with_a_policy_that_is_absorbed():
    """In an MDP in which another is not."""
    transitions = np.array([[[0.0, 1.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]]])
    mdp = FiniteMDP(transitions, np.array([[2.0, 0.0], [0.0, 0.0]]), [1, 0], 1.0)
    assert oee.policy_value(mdp, np.array([[0.5, 0.5], [1.0, 0.0]])) == pytest.approx(
        2.0, rel=1e-14
    )


@given(rngs)
def test_the_gradient_is_the_derivative(rng):
    """Statement 29: finite differences along directions that keep rows summing to 1."""
    mdp = random_mdp(rng, n_states=4, zeros=0.0, discount=0.9)
    policy = random_policy(rng, mdp)
    horizon = [None, 3][int(rng.integers(2))]
    gradient = exact.transition_gradient(mdp, policy, horizon=horizon)
    direction = rng.normal(size=(mdp.n_states * mdp.n_actions, mdp.n_states))
    direction -= direction.mean(axis=1, keepdims=True)
    step = 1e-5
    values = [
        oee.policy_value(
            mdp.with_transitions(
                sparse.csr_array(mdp.transitions.toarray() + sign * step * direction)
            ),
            policy,
            horizon=horizon,
        )
        for sign in (1, -1)
    ]
    numeric = (values[0] - values[1]) / (2 * step)
    assert_allclose(gradient @ direction.reshape(-1), numeric, rtol=1e-5, atol=1e-5)


def test_a_gradient_of_known_values_and_time_is_the_same():
    mdp = oee.tasks.gridworld(3, 0.3)
    policy = oee.uniform_policy(mdp)
    values = oee.state_values(mdp, policy).tolist()
    time = oee.occupancy(mdp, policy).tolist()
    found = exact.transition_gradient(mdp, policy, values=values, time=time)
    assert_allclose(found, exact.transition_gradient(mdp, policy), rtol=1e-9)


def test_unnormalised_kernels_diverge_with_their_radius():
    """1.15 P at discount 0.9 has a radius of 1.035."""
    mdp = random_mdp(
        np.random.default_rng(3), n_states=4, n_actions=2, discount=0.9, form=2
    )
    policy = oee.uniform_policy(mdp)
    inflated = exact.reweight(mdp, mdp.transitions * 0 + mdp.transitions.sign() * 1.15)
    with pytest.raises(ValueError, match=r"spectral radius of 1\.035"):
        oee.policy_value(inflated, policy)
    assert np.isfinite(oee.policy_value(inflated, policy, horizon=50))
    small = exact.reweight(mdp, mdp.transitions.sign() * 1.05)
    kernel = np.einsum("sa,sat->st", policy, dense(mdp)[0]) * 1.05
    expected = np.linalg.solve(
        np.eye(4) - 0.9 * kernel, (policy * mdp.rewards).sum(axis=1)
    )
    assert_allclose(oee.state_values(small, policy), expected, rtol=1e-10)


def test_a_kernel_above_one_but_below_the_radius_is_certified():
    """Rows may exceed 1 where the policy rarely is; only the radius counts."""
    transitions = np.array([[[0.0, 1.0]], [[0.0, 1.0]]])
    mdp = FiniteMDP(transitions, [1.0, 1.0], [1, 0], 0.5)
    zeta = sparse.csr_array(np.array([[0.0, 3.0], [0.0, 1.0]]))
    found = exact.evaluate_policy(exact.reweight(mdp, zeta), np.ones((2, 1)))
    assert_allclose(found.values, [1 + 0.5 * 3 * 2, 2.0], rtol=1e-14)
    assert 0 <= found.error_bound < 1e-12


def test_a_kernel_that_loses_mass_has_a_value_at_discount_one():
    mdp = FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 1.0)
    leaking = exact.reweight(mdp, sparse.csr_array([[0.5]]))
    assert_allclose(oee.policy_value(leaking, np.ones((1, 1))), 2.0, rtol=1e-12)


def test_the_radius_of_a_periodic_kernel():
    cycle = FiniteMDP(np.array([[[0.0, 1.0]], [[1.0, 0.0]]]), [1.0, 1.0], [1, 0], 0.9)
    with pytest.raises(ValueError, match=r"spectral radius of 1\.00[12]"):
        oee.policy_value(
            exact.reweight(cycle, sparse.csr_array(np.array([[0, 2.0], [0.62, 0]]))),
            np.ones((2, 1)),
        )


@pytest.mark.filterwarnings("ignore:a value is beyond the largest float")
# where kernels are not compiled
@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_values_beyond_floats_are_infinite_and_their_bound_is():
    """Values beyond floats are infinite, and so is the bound on their error.

    In a state that is never reached they do not matter to J, however it is computed.
    """
    never = FiniteMDP(
        [[[0.5, 0.5, 0]], [[0.5, 0.5, 0]], [[0, 0, 1.0]]],
        [0, 1, 1e308],
        [1, 0, 0],
        0.99,
    )
    same = FiniteMDP(never.transitions, [[0], [1], [1]], never.initial, 0.99)
    policy = [[1.0]] * 3
    for horizon in (None, 5, 500):
        found, plain = (
            exact.evaluate_policy(mdp, policy, horizon=horizon) for mdp in (never, same)
        )
        assert_allclose(found.values[:2], plain.values[:2], rtol=1e-12)
        assert (found.values[2], found.error_bound) == (np.inf, np.inf)
        assert_allclose(
            [found.value, oee.policy_value(never, policy, horizon=horizon)],
            plain.value,
            rtol=1e-12,
        )
    assert (
        oee.policy_value(
            FiniteMDP(never.transitions, never.rewards, [0, 0, 1], 0.99), policy
        )
        == np.inf
    )


def test_warnings_about_a_value():
    """The method and the error bound of each way to a value."""
    chain = survival_chain()
    ones = np.ones((2, 1))
    found = exact.evaluate_policy(chain, ones, horizon=3)
    assert found.method == "backward recursion"
    assert 0 < found.error_bound < 1e-14
    assert exact.evaluate_policy(chain, ones).method == "dense LU"
    endless = exact.evaluate_policy(survival_chain(1.0), ones)
    assert endless.method == "dense LU"
    assert 0 < endless.error_bound < 1e-13
    over = FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 1.0)
    found = exact.evaluate_policy(over, np.ones((1, 1)))
    assert (found.values.tolist(), found.value, found.error_bound, found.method) == (
        [0.0],
        0.0,
        0.0,
        "absorbed",
    )


def test_discount_one_names_the_states_that_pay_for_ever():
    """At discount 1 the error names a state that has a reward for ever.

    Of two closed classes one has a reward; a transient state with a reward is no
    obstacle.
    """
    rows = np.zeros((5, 1, 5))
    rows[0, 0, [1, 3]] = 0.5
    rows[[1, 2], 0, [2, 1]] = 1.0
    rows[[3, 4], 0, [4, 3]] = 1.0
    mdp = FiniteMDP(rows, [7.0, 0.0, 0.0, 2.0, -3.0], [1, 0, 0, 0, 0], 1.0)
    text = (
        r"^horizon must be given: .*it stays for ever among states of which s=3 has"
        r" reward 2 \(2 such states in all\)"
    )
    with pytest.raises(ValueError, match=text):
        oee.policy_value(mdp, np.ones((5, 1)))
    assert_allclose(
        oee.policy_value(mdp, np.ones((5, 1)), horizon=3), 7.0 + 0.5 * (2.0 - 3.0)
    )
    free = mdp.with_rewards(np.array([7.0, 0.0, 0.0, 0.0, 0.0]))
    assert_allclose(oee.state_values(free, np.ones((5, 1))), [7, 0, 0, 0, 0])


def test_reweighting_takes_a_ratio_or_its_matrix():
    simulator, target = environments(3)
    zeta = oee.true_ratio(target, simulator)
    for given_ratio in (zeta, zeta.values):
        model = exact.reweight(simulator, given_ratio)
        assert_allclose(
            model.transitions.toarray(), target.transitions.toarray(), rtol=1e-12
        )
        assert_allclose(model.rewards, target.rewards, rtol=1e-12)
        assert (model.n_states, model.n_actions, model.discount) == (3, 2, 0.7)
        assert_array_equal(model.initial, simulator.initial)
        assert_array_equal(model.reward_data, simulator.reward_data)
        assert_array_equal(model.terminal_state, simulator.terminal_state)
    assert exact.reweight(*(environments(2)[0], zeta.values)).reward_data is None


@pytest.mark.parametrize("which", ["kernel", "rewards"])
def test_the_error_bound_counts_the_rounding_of_the_policys_rows(which):
    """Sums over thousands of actions are rounded before the system is solved.

    The error bound counts it, for 40 states that stay where they are.
    """
    n = 40
    n_actions = 2000
    rng = np.random.default_rng(0)
    policy = rng.dirichlet(np.ones(n_actions), n)
    rewards = (
        np.ones((n, n_actions))
        if which == "kernel"
        else rng.normal(size=(n, n_actions)) * 1e6
    )
    stay = sparse.csr_array(
        (
            np.ones(n * n_actions),
            (np.arange(n * n_actions), np.repeat(np.arange(n), n_actions)),
        )
    )
    mdp = FiniteMDP(
        stay, rewards, np.full(n, 1 / n), 0.999 if which == "kernel" else 0.0
    )
    found = exact.evaluate_policy(mdp, policy)
    gamma = Fraction(mdp.discount)
    missed = []
    for state in range(n):
        act = [Fraction(x) for x in policy[state].tolist()]
        pay = sum(
            a * Fraction(r) for a, r in zip(act, rewards[state].tolist(), strict=True)
        )
        missed.append(
            abs(Fraction(float(found.values[state])) - pay / (1 - gamma * sum(act)))
        )
    assert (
        Fraction(found.error_bound) / 10**5 < max(missed) <= Fraction(found.error_bound)
    )
