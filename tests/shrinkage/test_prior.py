"""The default's prior: its limits, what does not matter to it, what it finds, and its
errors.
"""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from helpers import dense, dense_values, random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.mdp.rows import Rows


def garnet(seed, n_states=20, n_actions=2, successors=5, discount=0.9, layout=None):
    """Rows of Dirichlet probabilities on a few random successors, rewards of states and
    actions.
    """
    rng = np.random.default_rng(seed)
    rows = np.zeros((n_states, n_actions, n_states))
    for s in range(n_states):
        for a in range(n_actions):
            rows[s, a, rng.choice(n_states, successors, replace=False)] = rng.dirichlet(
                np.full(successors, 2.0)
            )
    pay = rng.normal(size=(n_states, n_actions))
    return FiniteMDP(
        rows, pay, np.full(n_states, 1 / n_states), discount, layout=layout
    )


def tilted_along(simulator, phi):
    """The target with rows proportional to P exp(phi), phi at the simulator's entries."""
    model, _ = Rows.of(simulator).tilt(phi)
    matrix = simulator.transitions
    return simulator.with_transitions(
        sparse.csr_array((model, matrix.indices, matrix.indptr), matrix.shape)
    )


def worse(simulator, policy, size=0.5):
    """A target in which everything is a little worse along V."""
    level = dense_values(simulator, policy)[simulator.transitions.indices]
    column = Rows.of(simulator).center(level)
    return tilted_along(simulator, -size * column / column.std())


def drawn(target, per_row, seed):
    shape = (target.n_states, target.n_actions)
    return oee.sample_transitions(
        target,
        np.full(shape, 1 / np.prod(shape)),
        int(per_row * np.prod(shape)),
        seed=seed,
    )


def line(n=60):
    """One more, one less, or the same, with probabilities of each state's own; waiting
    costs.
    """
    rng = np.random.default_rng(0)
    rows = np.zeros((n, 2, n))
    for s in range(n):
        for a in range(2):
            stay, more, less = rng.dirichlet([4.0, 8.0, 8.0 + 4.0 * a])
            rows[s, a, s] += stay
            rows[s, a, min(s + 1, n - 1)] += more
            rows[s, a, max(s - 1, 0)] += less
    return FiniteMDP(
        rows, np.arange(n)[:, None] * [-1.0, -1.0] - [0.0, 0.5], np.eye(n)[5], 0.95
    )


def more_often(simulator, theta):
    """The target in which s + 1 follows s more often, by ``theta`` of each state."""
    rows = Rows.of(simulator)
    one_more = rows.arrival - rows.spread(rows.state) == 1
    return tilted_along(
        simulator, np.broadcast_to(theta, 60)[rows.spread(rows.state)] * one_more
    )


# ---- limits


def test_a_log_that_tells_nothing_leaves_the_simulator():
    """Transitions of pairs with a single successor only."""
    rows = np.zeros((3, 2, 3))
    rows[0, 0] = [0.2, 0.5, 0.3]
    rows[0, 1] = [0, 0, 1]
    rows[1] = [0.6, 0.1, 0.3]
    rows[2] = [0, 0, 1]
    simulator = FiniteMDP(rows, np.array([1.0, 2.0, 0.0]), [1, 0, 0], 0.9)
    log = oee.Transitions([0, 2], [1, 0], [2, 2])
    policy = np.full((3, 2), 0.5)
    zeta = oee.transition_ratio(log, simulator, values_of=policy)
    assert_allclose(zeta.values.data, 1.0, rtol=1e-14)
    value = oee.estimators.OffEnvironment()(oee.Problem(simulator, log), policy).value
    assert_allclose(value, oee.policy_value(simulator, policy), rtol=1e-12)


@pytest.mark.parametrize("size", [1e-6, 1e9, 1e15, 8e15])
def test_counts_of_any_size(size):
    """Up to 2^53, the most that is taken."""
    rows = np.array([[9, 2], [4, 3], [1, 0], [0, 1], [7, 2], [0, 1]], dtype=float)
    rows /= rows.sum(axis=1, keepdims=True)
    simulator = FiniteMDP(rows.reshape(2, 3, 2), [1.0, 0.0], [1.0, 0.0], 0.5)
    target = np.array([[0.6, 0.4], [0, 1], [1, 0], [0, 1], [0, 1], [0, 1.0]])
    zeta = oee.transition_ratio(
        size * sparse.csr_array(target), simulator, values_of=np.full((2, 3), 1 / 3)
    )
    assert np.isfinite(zeta.values.data).all()
    assert zeta.row_sum_error < 1e-9
    if size > 1e6:
        assert_allclose(
            zeta.target_model(simulator).transitions.toarray(), target, atol=1e-6
        )


# ---- what does not matter


@settings(max_examples=25)
@given(rngs, st.sampled_from([1, 30, 3000]))
def test_rows_of_zeta_p_are_distributions(rng, n):
    simulator = random_mdp(rng, discount=0.9)
    target = random_mdp(rng, like=simulator)
    share = np.full(
        (target.n_states, target.n_actions), 1 / (target.n_states * target.n_actions)
    )
    log = oee.sample_transitions(target, share, n, seed=int(rng.integers(1 << 30)))
    policies = [random_policy(rng, simulator) for _ in range(2)]
    zeta = oee.transition_ratio(log, simulator, values_of=policies)
    assert zeta.row_sum_error < 1e-12
    assert (zeta.values.data >= 0).all()
    assert 0 <= zeta.gap < 1e-9


def renamed(mdp, states, actions):
    """State ``states[k]`` and action ``actions[b]`` become k and b; places go along."""
    rows = dense(mdp)[0][np.ix_(states, actions, states)]
    return FiniteMDP(
        rows,
        mdp.rewards[np.ix_(states, actions)],
        mdp.initial[states],
        mdp.discount,
        layout=mdp.layout[states],
    )


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.sampled_from([2.0, 20.0]))
def test_names_of_states_and_actions_do_not_matter_where_places_are_given(
    seed, per_row
):
    rng = np.random.default_rng(seed)
    simulator = garnet(
        seed, n_states=12, layout=rng.integers(0, 3, (12, 2)).astype(float)
    )
    policy = random_policy(rng, simulator, zeros=0.0)
    log = drawn(worse(simulator, policy), per_row, seed)
    states = rng.permutation(12)
    actions = rng.permutation(2)
    names = np.argsort(states)
    moves = np.argsort(actions)
    again = oee.Transitions(names[log.state], moves[log.action], names[log.next_state])
    turned = policy[np.ix_(states, actions)]
    default = oee.estimators.OffEnvironment()
    one = default(oee.Problem(simulator, log), policy)
    two = default(oee.Problem(renamed(simulator, states, actions), again), turned)
    assert_allclose(two.value, one.value, rtol=1e-5)
    assert_allclose(two.standard_error, one.standard_error, rtol=1e-5)


@settings(max_examples=12)
@given(
    st.integers(0, 10**6),
    st.sampled_from([1e-3, 1.0, -50.0]),
    st.sampled_from([0.0, -3.0, 10.0]),
)
def test_units_of_rewards_and_places_do_not_matter(seed, scale, shift):
    """r -> a r + b leaves zeta: a direction is the same as its opposite."""
    simulator = garnet(seed, n_states=10, layout=np.arange(10.0))
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy), 8.0, seed)
    other = simulator.with_rewards(scale * simulator.rewards + shift).with_layout(
        scale * np.arange(10.0) + shift
    )
    one, two = (
        oee.transition_ratio(log, mdp, values_of=policy) for mdp in (simulator, other)
    )
    assert_allclose(two.values.data, one.values.data, rtol=1e-5)


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.sampled_from([0.3, 0.9]))
def test_shaping_of_rewards_does_not_matter(seed, discount):
    """Rewards with a potential, r + gamma Phi(s') - Phi(s), leave zeta [1].

    r + gamma V(s') changes by Phi(s) alone, which is the same in the whole row.

    [1] Ng, Harada and Russell, Policy invariance under reward transformations, 1999.
    """
    simulator = garnet(seed, n_states=10, discount=discount)
    phi = np.random.default_rng(seed).normal(size=10)
    shaped = simulator.with_rewards(
        dense(simulator)[1] + discount * phi[None, None, :] - phi[:, None, None]
    )
    policy = random_policy(np.random.default_rng(seed + 1), simulator)
    log = drawn(worse(simulator, policy), 8.0, seed)
    one, two = (
        oee.transition_ratio(log, mdp, values_of=policy) for mdp in (simulator, shaped)
    )
    assert_allclose(two.values.data, one.values.data, rtol=1e-5)


def test_places_are_the_states_numbers_where_there_are_none():
    plain = line()
    log = drawn(more_often(line(), 0.4), 20.0, 0)
    numbered = plain.with_layout(np.arange(60))
    one, two = (oee.transition_ratio(log, mdp) for mdp in (plain, numbered))
    assert_array_equal(one.values.data, two.values.data)
    shuffled = plain.with_layout(np.random.default_rng(0).permutation(60))
    assert (
        np.abs(oee.transition_ratio(log, shuffled).values.data - one.values.data).max()
        > 1e-3
    )


# ---- what it finds


def test_the_user_s_features_are_directions_beside_the_others():
    """Every third state leads on more often: no direction of ours, but one of the
    user's.
    """
    simulator = line()
    policy = np.full((60, 2), 0.5)
    target = more_often(simulator, 0.8 * (np.arange(60) % 3 == 0))
    log = drawn(target, 30.0, 0)
    truth = oee.true_ratio(target, simulator).values.data
    known = oee.transition_ratio(
        log,
        simulator,
        values_of=policy,
        features=lambda s, a, t: (s % 3 == 0) * (t - s == 1),
    )
    plain = oee.transition_ratio(log, simulator, values_of=policy)
    errors = [np.abs(zeta.values.data - truth).mean() for zeta in (known, plain)]
    assert errors[0] < 0.6 * errors[1]
    assert_allclose(known.details["directions"]["feature 0"], 0.8, atol=0.15)
    assert known.details["feature_rank"] == 1


def test_several_policies_have_a_direction_each():
    simulator = garnet(4, n_states=30)
    good = oee.optimal_policy(simulator)
    bad = oee.optimal_policy(simulator.with_rewards(-simulator.rewards))
    log = drawn(worse(simulator, good, 0.8), 10.0, 0)
    zeta = oee.transition_ratio(log, simulator, values_of=[bad, good])
    assert {"V of policy 1", "V of policy 2"} <= set(zeta.details["directions"])
    one, listed = (
        oee.transition_ratio(log, simulator, values_of=values)
        for values in (good, [good])
    )
    assert_array_equal(one.values.data, listed.values.data)


def test_policies_and_horizon_only_choose_directions():
    simulator = garnet(3)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy), 10.0, 0)
    fits = [
        oee.transition_ratio(log, simulator, **options)
        for options in ({}, {"values_of": policy}, {"values_of": policy, "horizon": 3})
    ]
    assert "V" not in fits[0].details["directions"]
    assert np.abs(fits[1].values.data - fits[2].values.data).max() > 1e-6
    assert all(
        fit.prior == "ridge"
        for fit in [oee.ratio.Conditional(), oee.ratio.Conditional(features=[[1.0]])]
    )


# ---- the program and its errors


@pytest.mark.parametrize(
    "options", [{}, {"features": lambda s, a, t: np.cos(t)}, {"prior": "tilt"}]
)
def test_a_cvxpy_solver_gives_the_same_tilt(options):
    simulator = garnet(1, n_states=8, successors=3)
    policy = oee.optimal_policy(simulator)
    log = drawn(worse(simulator, policy, 0.8), 10.0, 0)
    about = {} if "prior" in options else {"values_of": policy}
    ours, theirs = (
        oee.transition_ratio(
            log, simulator, strength=20.0, solver=solver, **about, **options
        )
        for solver in ("dual", "CLARABEL")
    )
    # as far off as the root of a gap of 1e-8, which the solver may leave
    assert_allclose(theirs.values.data, ours.values.data, atol=3e-4)
    assert ours.gap < 1e-12
    assert theirs.gap < 1e-6


def test_the_error_if_the_prior_fits_is_the_posterior_s():
    """Rows' own noise, and theta ~ N(theta, f''^-1) through what the rows have of the
    tilt; derivatives by differences.
    """
    simulator = garnet(5, n_states=8)
    policy = oee.optimal_policy(simulator)
    zeta = oee.transition_ratio(
        drawn(worse(simulator, policy), 6.0, 0), simulator, values_of=policy
    )
    inside = zeta._influence
    rows = Rows.of(simulator)
    P = simulator.transitions.data
    gradient = np.random.default_rng(0).normal(size=len(P))
    share = inside.share
    n = inside.n

    def value(theta):
        model = replace(inside.prior, theta=theta).at(rows)
        return gradient @ (rows.spread(1 - share) * model)

    theta = inside.prior.theta
    h = 1e-5
    pull = np.zeros(theta.shape)
    for place in np.ndindex(*theta.shape):
        step = np.zeros(theta.shape)
        step[place] = h
        pull[place] = (value(theta + step) - value(theta - step)) / (2 * h)
    G = inside.prior.covariances
    d = theta.shape[1]
    H = np.diag(inside.prior.penalty.reshape(-1))
    H[:d, :d] += G.sum(axis=0)
    for a in range(2):
        own = slice((1 + a) * d, (2 + a) * d)
        H[:d, own] += G[a]
        H[own, :d] += G[a]
        H[own, own] += G[a]
    of_theta = pull.reshape(-1) @ np.linalg.solve(H, pull.reshape(-1))
    variance = rows.variance(zeta.values.data * P, gradient)
    of_rows = np.sum((share**2 * variance)[n > 0] / n[n > 0])
    assert of_theta > 0
    assert_allclose(
        zeta.log_standard_error(gradient), np.sqrt(of_theta + of_rows), rtol=1e-6
    )


@pytest.mark.parametrize("options", [{}, {"prior": "tilt"}])
def test_a_fit_in_another_process_is_the_same(options):
    simulator = garnet(5)
    policy = oee.optimal_policy(simulator)
    about = {} if options else {"values_of": policy}
    zeta = oee.transition_ratio(
        drawn(worse(simulator, policy), 20.0, 0), simulator, **about, **options
    )
    gradient = np.random.default_rng(0).normal(size=simulator.transitions.nnz)
    other = pickle.loads(pickle.dumps(zeta))
    assert other.log_standard_error(gradient) == zeta.log_standard_error(gradient)
    assert other.one_step(gradient) == zeta.one_step(gradient)


def test_a_log_of_one_action_does_not_say_all_of_the_others():
    """What one action shows may be its own: the others get the shared part of it. Actions
    that no state has are no others.
    """
    simulator = oee.tasks.gridworld(4, 0.3, discount=0.9)
    target = oee.tasks.gridworld(4, 0.1, discount=0.9)
    share = np.zeros((16, 4))
    share[:, 0] = 1 / 16
    log = oee.sample_transitions(target, share, 2000, seed=5)
    zeta = oee.transition_ratio(log, simulator)
    own = [name for name in zeta.details["directions"] if name.endswith("action 0")]
    assert own
    moved = np.abs(np.log(np.maximum(zeta.values.toarray(), 1e-300)))
    moved = np.where(zeta.values.toarray() > 0, moved, 0.0).reshape(16, 4, 16)
    largest = moved.max(axis=(0, 2))
    assert (largest[1:] < 0.8 * largest[0]).all()
    assert (largest[1:] > 0.05 * largest[0]).all()

    only = oee.FiniteMDP(
        simulator.transitions.toarray().reshape(16, 4, 16)[:, :1],
        simulator.rewards[:, :1],
        np.full(16, 1 / 16),
        0.9,
    )
    alone = oee.transition_ratio(log, only)
    assert not [name for name in alone.details["directions"] if "action" in name]
