"""What mutation testing showed that the other tests of ``exact`` leave open: each test is named after what it pins down."""

from fractions import Fraction

import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy, rngs, survival_chain
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact import leading_bias, ratio_of_ratios_variance, weight_growth, weight_moments
from oee_tabular.exact.efficiency import require_action_support
from oee_tabular.exact.linear import inverse_norm, solve_policy_system, spectral_radius
from oee_tabular.exact.systems import System

KINDS = ("per_decision", "trajectory")


def environments(form, discount=0.7):
    """A simulator and a target near it, three states and two actions, every move possible."""
    rng = np.random.default_rng(form)
    rows = rng.dirichlet(np.full(3, 4.0), (3, 2))
    rewards = rng.normal(size=(3, 2, 3)[:form])
    simulator = FiniteMDP(rows, rewards, [0.6, 0.4, 0.0], discount)
    return simulator, simulator.with_transitions(0.8 * rows + 0.2 * rng.dirichlet(np.ones(3), (3, 2)))


POLICY = np.array([[0.3, 0.7], [0.5, 0.5], [0.8, 0.2]])
BEHAVIOR = np.array([[0.4, 0.6], [0.5, 0.5], [0.6, 0.4]])


def histories(mdp, policy, horizon):
    """(probability, states s_0..s_T, actions, rewards) of each path, all of positive probability."""
    transitions, rewards = dense(mdp)
    found = [(float(p), (s,), (), ()) for s, p in enumerate(mdp.initial) if p > 0]
    for _ in range(horizon):
        found = [
            (p * policy[states[-1], a] * transitions[states[-1], a, j], (*states, j), (*actions, a),
             (*paid, rewards[states[-1], a, j]))
            for p, states, actions, paid in found
            for a in range(mdp.n_actions)
            for j in range(mdp.n_states)
            if policy[states[-1], a] * transitions[states[-1], a, j] > 0
        ]  # fmt: skip
    return found


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


def test_an_infinite_sum_of_states_that_are_never_entered():
    """The last state is only a start: no column of the weighted kernel, and yet a row."""
    mdp = FiniteMDP(
        np.array([[[0.5, 0.5, 0.0]], [[0.5, 0.5, 0.0]], [[1.0, 0.0, 0.0]]]), [1.0, 2.0, 5.0], [0, 0, 1], 0.5
    )
    endless, long = (oee.return_moments(mdp, np.ones((3, 1)), horizon=h, sources=True) for h in (None, 60))
    assert_allclose((endless.mean, endless.variance), (long.mean, long.variance), rtol=1e-12)
    assert_allclose(endless.by_state, long.by_state, rtol=1e-12)
    assert weight_growth(mdp, oee.true_ratio(mdp, mdp), np.ones((3, 1))) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_weights_of_actions_stand_still_where_it_is_over(kind):
    """An absorbing state with two actions: what is done there neither pays nor weighs."""
    rows = np.array([[[0.5, 0.5], [0.2, 0.8]], [[0.0, 1.0], [0.0, 1.0]]])
    mdp = FiniteMDP(rows, np.array([[1.0, 3.0], [0.0, 0.0]]), [1, 0], 0.9)
    behavior, policy = np.array([[0.5, 0.5], [0.1, 0.9]]), np.array([[0.25, 0.75], [0.9, 0.1]])
    found = histories(mdp, behavior, 3)
    x = []
    for _, states, actions, paid in found:
        ratios = [1.0 if s == 1 else policy[s, a] / behavior[s, a] for s, a in zip(states[:-1], actions, strict=True)]
        weights = np.cumprod(ratios) if kind == "per_decision" else np.full(3, np.prod(ratios))
        x.append(0.9 ** np.arange(3) @ (weights * paid))
    probability, x = np.array([path[0] for path in found]), np.array(x)
    moments = oee.policy_is_moments(mdp, behavior, policy, kind=kind, horizon=3)
    assert_allclose(moments.mean, probability @ x, rtol=1e-12)
    assert_allclose(moments.variance, probability @ (x - probability @ x) ** 2, rtol=1e-12)


def test_policy_importance_sampling_with_both_policies_in_time():
    """A behaviour policy for each step, the evaluated one for each step or for all."""
    mdp, _ = environments(2)
    moving = np.stack([BEHAVIOR, POLICY, BEHAVIOR])
    for policy in (POLICY, np.stack([POLICY, BEHAVIOR, POLICY])):
        found = oee.policy_is_moments(mdp, moving, policy, horizon=3)
        assert_allclose(found.mean, oee.policy_value(mdp, policy, horizon=3), rtol=1e-12)
    same = oee.policy_is_moments(mdp, moving, moving, horizon=3)
    plain = oee.return_moments(mdp, moving, horizon=3)
    assert_allclose((same.mean, same.variance), (plain.mean, plain.variance), rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_without_any_weight_nothing_is_left_to_divide_by(kind):
    chain = FiniteMDP(np.full((2, 1, 2), 0.5), [1.0, 2.0], [1, 0], 0.9)
    nothing = sparse.csr_array(np.zeros((2, 2)))
    with pytest.warns(UserWarning, match="all weights of a step are 0"):
        found = oee.weighted_return_moments(
            chain, nothing, np.ones((2, 1)), kind=kind, horizon=2, self_normalized=True, sources=True
        )
    assert np.isnan([found.mean, found.variance, found.bias]).all()
    plain = oee.weighted_return_moments(chain, nothing, np.ones((2, 1)), kind=kind, horizon=2)
    assert (plain.mean, plain.variance, plain.bias) == ((1.0 if kind == "per_decision" else 0.0), 0.0, 0.0)


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("action_baseline", [False, True])
def test_the_shares_of_doubly_robust_add_up(form, action_baseline):
    simulator, target = environments(form)
    zeta = oee.true_ratio(target, simulator)
    found = oee.doubly_robust_moments(simulator, zeta, POLICY, horizon=3, action_baseline=action_baseline, sources=True)
    assert_allclose(found.by_step.sum(), found.variance, rtol=1e-12)
    assert_allclose(found.by_step[0] + found.by_state.sum(), found.variance, rtol=1e-12)
    own = exact.moments.values_to_go(exact.walks.walk_of(simulator, POLICY), 3)
    given_baseline = own.copy()
    given_baseline[3] = 9.0  # row T is not used
    again = oee.doubly_robust_moments(
        simulator, zeta, POLICY, baseline=given_baseline, horizon=3, action_baseline=action_baseline
    )
    assert_allclose((again.mean, again.variance), (found.mean, found.variance), rtol=1e-12)
    assert given_baseline[3, 0] == 9.0  # and the caller's array is the caller's
    for t in range(3):
        assert_allclose(own[t], oee.state_values(simulator, POLICY, horizon=3 - t), rtol=1e-12)


# ---- growth of weights and radii ---------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [3, 400, 401, 450])
def test_growth_of_large_and_small_chains(n):
    """A ring with zeta = 2: E W_t^2 = 4^t at every size; without weight minus infinity."""
    ring = sparse.csr_array((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
    mdp = FiniteMDP(ring, np.ones(n), np.full(n, 1 / n), 0.9)
    ones = np.ones((n, 1))
    assert_allclose(weight_growth(mdp, ring * 2.0, ones), np.log(4.0), rtol=1e-9)
    assert_allclose(weight_growth(mdp, ring * 0.5, ones), np.log(0.25), rtol=1e-9)
    assert weight_growth(mdp, ring * 0.0, ones) == -np.inf
    first, second = weight_moments(mdp, ring * 2.0, ones, horizon=3)
    assert_allclose(first, [1, 2, 4, 8])
    assert_allclose(second, [1, 4, 16, 64])


def test_the_spectral_radius_of_simple_kernels():
    assert spectral_radius(sparse.csr_array(np.array([[0.0, 1.0], [0.0, 0.0]]))) == 0.0
    assert_allclose(spectral_radius(sparse.csr_array(np.eye(3))), 1.0)
    assert_allclose(spectral_radius(sparse.csr_array(np.eye(3)), 0.25), 0.25)
    assert_allclose(spectral_radius(sparse.csr_array(np.array([[0.0, 2.0], [0.5, 0.0]]))), 1.0, rtol=1e-12)
    assert_allclose(spectral_radius(sparse.csr_array(np.array([[0.0, 9.0], [1.0, 0.0]])), 0.5), 1.5, rtol=1e-12)


# ---- linear systems ----------------------------------------------------------------------------------------------


def test_the_norm_of_the_inverse_of_kernels_below_one():
    """1 / (1 - gamma * largest row sum), exactly."""
    assert_allclose(
        inverse_norm(System.of(sparse.csr_array(np.array([[0.5, 0.5], [0.2, 0.3]])), 0.9)), 10.0, rtol=1e-12
    )
    assert_allclose(
        inverse_norm(System.of(sparse.csr_array(np.array([[0.5, 0.3], [0.2, 0.3]])), 0.5)), 1 / 0.6, rtol=1e-12
    )
    assert_allclose(inverse_norm(System.of(sparse.csr_array((2, 2)), 0.9)), 1.0, rtol=1e-12)


@pytest.mark.parametrize("n", [30, 500])
@pytest.mark.parametrize("transpose", [False, True])
def test_systems_and_their_transposes_at_both_sizes(n, transpose):
    """The answer, its method, and an error bound that holds and is no more than rounding (for the transpose, of sums)."""
    rng = np.random.default_rng(n)
    kernel = sparse.csr_array(sparse.random_array((n, n), density=6 / n, rng=rng) + sparse.eye_array(n) * 0.1)
    kernel = sparse.csr_array(sparse.diags_array(1 / kernel.sum(axis=1)) @ kernel)
    b = rng.normal(size=n)
    found = solve_policy_system(kernel, b, 0.9, transpose=transpose)
    matrix = np.eye(n) - 0.9 * kernel.toarray()
    truth = np.linalg.solve(matrix.T if transpose else matrix, b)
    assert_allclose(found.x, truth, rtol=0, atol=1e-11 * np.abs(truth).max())
    missed = np.abs(found.x - truth)
    assert (missed.sum() if transpose else missed.max()) <= found.error_bound + 1e-13 * np.abs(truth).sum()
    assert 0 < found.error_bound < 1e-9 * np.abs(truth).sum()
    assert found.method == ("dense LU" if n == 30 else "BiCGSTAB")


def test_rows_below_one_need_no_certificate(monkeypatch):
    """The bound is known from the row sums: no second system is solved for it."""
    from oee_tabular.exact import linear

    monkeypatch.setattr(linear, "solve", None)
    assert_allclose(inverse_norm(System.of(sparse.csr_array(np.array([[0.5, 0.5], [0.2, 0.3]])), 0.9)), 10.0)


def test_the_certificate_counts_its_own_residual(monkeypatch):
    """|M^-1| <= max h / (1 - residual); half of it or more, or an h that is not positive, certifies nothing."""
    from oee_tabular.exact import linear

    kernel = sparse.csr_array(np.array([[0.0, 2.0], [0.1, 0.0]]))
    for residual, h in (([0.2, -0.4], [3.0, 1.0]), ([0.2, -0.6], [3.0, 1.0]), ([0.0, 0.0], [3.0, 0.0])):
        largest = np.abs(residual).max()
        answer = np.array(h), (np.array(residual), largest, largest, 0.0), "dense LU"
        monkeypatch.setattr(linear, "solve", lambda system, b, answer=answer: answer)
        if min(residual) == -0.4:
            assert_allclose(inverse_norm(System.of(kernel, 0.9)), 3.0 / 0.6)
        else:
            with pytest.raises(ValueError, match=r"spectral radius of 0\.402492"):
                inverse_norm(System.of(kernel, 0.9))


@pytest.mark.parametrize("transpose", [False, True])
def test_the_error_bound_is_residual_and_rounding_times_the_norm_of_the_inverse(transpose):
    """(|b - M x| + u (entries of the row + 4) (gamma K |x| + |x| + |b|)) / (1 - gamma): its sum, or its largest."""
    rows = np.array([[0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [0.2, 0.3, 0.5]])
    b = np.array([1.0, -2.0, 3.0])
    found = solve_policy_system(sparse.csr_array(rows), b, 0.9, transpose=transpose)
    kernel = 0.9 * (rows.T if transpose else rows)
    entries = (kernel != 0).sum(axis=1) + 4
    sizes = kernel @ np.abs(found.x) + np.abs(found.x) + np.abs(b)
    missed = np.abs(b + kernel @ found.x - found.x) + 0.5 * np.finfo(float).eps * entries * sizes
    assert_allclose(found.error_bound, 10.0 * (missed.sum() if transpose else missed.max()), rtol=0.3)


def test_a_direct_solver_answers_a_singular_system_with_nan():
    """Without pivoting, dense and sparse: nan, and the name of the method, from which divergence is concluded."""
    from oee_tabular.exact.systems import elimination, library, solve

    for n, name in ((3, "dense LU"), (200, "dense LU"), (500, "sparse LU")):
        singular = System.of(sparse.csr_array(sparse.eye_array(n)), 1.0)
        solver, method = library(singular)
        assert method == name
        assert np.isnan(solver(np.ones(n), 0.0)).all()
    for n, method in ((3, "dense LU"), (500, "LU by components")):
        singular = System.of(sparse.csr_array(sparse.eye_array(n)), 1.0)
        x, missed, found = solve(singular, np.ones(n))
        assert np.isnan(x).all()
        assert np.isnan(missed[1])
        assert found == method
    assert np.isnan(elimination(singular, 3, 3, True)(np.ones(500), 0.0)).all()


def test_the_iteration_refines_to_rounding_and_leaves_zero_alone():
    from oee_tabular.exact.systems import krylov, refine

    grid = oee.tasks.gridworld(25, 0.3)
    system = System.of(exact.values.policy_kernel(grid, oee.uniform_policy(grid)), 0.99)
    b = np.random.default_rng(0).random(625)
    x, (missed, largest, bound, rounding) = refine(system, b, krylov(system))
    assert_allclose(missed, b + 0.99 * (system.kernel() @ x) - x, rtol=0, atol=1e-15 * np.abs(x).max())
    assert largest == np.abs(missed).max() < 1e-14 * np.abs(x).max()
    assert largest < bound <= largest + rounding
    x, (missed, largest, *_) = refine(system, np.zeros(625), krylov(system))
    assert_array_equal(x, np.zeros(625))
    assert_array_equal(missed, np.zeros(625))
    assert largest == 0.0


def test_a_singular_system_at_either_size_is_divergence():
    for n in (2, 500):
        ring = sparse.csr_array((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
        with pytest.raises(
            ValueError, match=r"spectral radius of 1, which must be below 1 \(its rows sum to at most 1\)"
        ):
            solve_policy_system(ring, np.ones(n), 1.0)
        with pytest.raises(ValueError, match=r"its rows sum to at most 1\.8"):
            solve_policy_system(ring * 2.0, np.ones(n), 0.9)


# ---- values ------------------------------------------------------------------------------------------------------


def test_what_is_said_of_a_value():
    """The method and the error bound of each way to a value."""
    chain, ones = survival_chain(), np.ones((2, 1))
    found = exact.evaluate_policy(chain, ones, horizon=3)
    assert (found.method, found.error_bound) == ("backward recursion", 0.0)
    assert exact.evaluate_policy(chain, ones).method == "dense LU"
    endless = exact.evaluate_policy(survival_chain(1.0), ones)
    assert endless.method == "dense LU"
    assert 0 < endless.error_bound < 1e-13
    over = FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 1.0)
    found = exact.evaluate_policy(over, np.ones((1, 1)))
    assert (found.values.tolist(), found.value, found.error_bound, found.method) == ([0.0], 0.0, 0.0, "absorbed")


def test_discount_one_names_the_states_that_pay_for_ever():
    """Two closed classes, one of which pays; a transient state that pays is no obstacle."""
    rows = np.zeros((5, 1, 5))
    rows[0, 0, [1, 3]] = 0.5
    rows[[1, 2], 0, [2, 1]] = 1.0
    rows[[3, 4], 0, [4, 3]] = 1.0
    mdp = FiniteMDP(rows, [7.0, 0.0, 0.0, 2.0, -3.0], [1, 0, 0, 0, 0], 1.0)
    text = r"it stays for ever in 2 states that do, the first: 3 \(reward 2\)"
    with pytest.raises(ValueError, match=text):
        oee.policy_value(mdp, np.ones((5, 1)))
    free = mdp.with_rewards(np.array([7.0, 0.0, 0.0, 0.0, 0.0]))
    assert_allclose(oee.state_values(free, np.ones((5, 1))), [7, 0, 0, 0, 0])


def test_action_values_with_a_policy_in_time():
    """Q_0 looks ahead with the policies of the later steps."""
    mdp, _ = environments(3)
    moving = np.stack([POLICY, BEHAVIOR, POLICY])
    transitions, rewards = dense(mdp)
    value = np.zeros(3)
    for policy in moving[::-1]:
        q = (transitions * (rewards + mdp.discount * value)).sum(axis=2)
        value = (policy * q).sum(axis=1)
    assert_allclose(oee.action_values(mdp, moving, horizon=3), q, rtol=1e-13)
    assert_allclose(oee.state_values(mdp, moving, horizon=3), value, rtol=1e-13)
    assert_allclose(oee.action_values(mdp, POLICY, horizon=1), mdp.rewards, rtol=1e-13)


def test_occupancies_of_few_steps():
    mdp, _ = environments(2)
    pairs = oee.occupancy(mdp, POLICY, horizon=2)
    ahead = np.einsum("s,sa,sat->t", mdp.initial, POLICY, dense(mdp)[0])
    expected = (mdp.initial + 0.7 * ahead)[:, None] * POLICY / 1.7
    assert_allclose(pairs, expected, rtol=1e-13)
    assert_allclose(oee.occupancy(mdp, np.stack([POLICY, POLICY]), horizon=2), expected, rtol=1e-13)
    assert_allclose(oee.occupancy(mdp, POLICY, horizon=2, of="state"), expected.sum(axis=1), rtol=1e-13)


def test_reweighting_takes_a_ratio_or_its_matrix():
    simulator, target = environments(3)
    zeta = oee.true_ratio(target, simulator)
    for given_ratio in (zeta, zeta.values):
        model = exact.reweight(simulator, given_ratio)
        assert_allclose(model.transitions.toarray(), target.transitions.toarray(), rtol=1e-12)
        assert_allclose(model.rewards, target.rewards, rtol=1e-12)
        assert (model.n_states, model.n_actions, model.discount) == (3, 2, 0.7)
        assert_array_equal(model.initial, simulator.initial)
        assert_array_equal(model.reward_data, simulator.reward_data)
        assert_array_equal(model.terminal_state, simulator.terminal_state)
    assert exact.reweight(*(environments(2)[0], zeta.values)).reward_data is None


@given(rngs, st.sampled_from([None, 3]))
@settings(max_examples=30)
def test_the_gradient_with_the_values_of_another_model(rng, horizon):
    """sum_t gamma^t alpha_t (r + gamma V'_t+1) on the other model's entries, alpha of the first, V' of the other."""
    one = random_mdp(rng, n_states=3, n_actions=2, discount=0.9, zeros=0.0)
    other = random_mdp(rng, n_states=3, n_actions=2, discount=0.9)
    policy = random_policy(rng, one)
    found = exact.transition_gradient(one, policy, horizon=horizon, values_of=other)
    reached, kernel = one.initial, np.einsum("sa,sat->st", policy, dense(one)[0])
    paid = dense(other)[1] if other.transition_rewards is not None else np.zeros((3, 2, 3))
    expected = np.zeros((3, 2, 3))
    for t in range(horizon or 400):
        ahead = (
            np.zeros(3) if horizon == t + 1 else oee.state_values(other, policy, horizon=horizon and horizon - t - 1)
        )
        expected += 0.9**t * reached[:, None, None] * policy[:, :, None] * (paid + 0.9 * ahead)
        reached = kernel.T @ reached
    stored = other.transitions.tocoo()
    scale = max(1.0, np.abs(expected).max())
    assert_allclose(found, expected.reshape(6, 3)[stored.coords], rtol=0, atol=1e-9 * scale)


# ---- planning ----------------------------------------------------------------------------------------------------


def test_at_discount_one_the_plan_starts_from_a_policy_that_is_absorbed():
    """Action 0 stays for nothing, action 1 costs 1 and leads out, where 5 are paid on the way: out, not for ever."""
    rows = np.array([[[1.0, 0, 0], [0, 1.0, 0]], [[0, 0, 1.0], [0, 1.0, 0]], [[0, 0, 1.0], [0, 0, 1.0]]])
    mdp = FiniteMDP(rows, np.array([[0.0, -1.0], [5.0, 0.0], [0.0, 0.0]]), [1, 0, 0], 1.0)
    plan = oee.optimal_policy(mdp)
    assert oee.policy_value(mdp, plan) == 4.0
    assert_array_equal(plan[:2], [[0.0, 1.0], [1.0, 0.0]])


def test_with_a_horizon_the_first_of_equal_actions_and_the_discount():
    """A delayed 10 against 6 at once: with discount 0.5 the latter; at the last step only what is paid at once counts."""
    rows = np.array([[[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]], [[0.0, 1.0]] * 3])
    rows[0, 0] = [1.0, 0.0]
    mdp = FiniteMDP(rows, np.array([[0.0, 6.0, 6.0], [0.0, 0.0, 0.0]]), [1, 0], 0.5)
    plan = oee.optimal_policy(mdp, horizon=3)
    assert plan.shape == (3, 2, 3)
    assert_array_equal(plan[:, 0], [[0.0, 1.0, 0.0]] * 3)
    assert_array_equal(plan[:, 1], [[1.0, 0.0, 0.0]] * 3)
    free = oee.optimal_policy(mdp.with_discount(1.0), horizon=2)
    assert_array_equal(free[:, 0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def test_equal_actions_up_to_rounding_are_equal():
    """0.1 + 0.2 against 0.3: the first, whichever is the larger in floating point."""
    rows = np.ones((1, 2, 1))
    for rewards in ([[0.1 + 0.2, 0.3]], [[0.3, 0.1 + 0.2]]):
        assert_array_equal(oee.optimal_policy(FiniteMDP(rows, np.array(rewards), [1.0], 0.0)), [[1.0, 0.0]])


# ---- bounds ------------------------------------------------------------------------------------------------------

SHARE = np.array([[0.1, 0.2], [0.15, 0.05], [0.3, 0.2]])
OTHER = np.array([[0.2, 0.2], [0.05, 0.25], [0.2, 0.1]])


@pytest.mark.parametrize("form", [1, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_the_ratio_of_ratios_variance_term_by_term(form, horizon):
    simulator, target = environments(form)
    p, q = dense(target)[0], dense(simulator)[0]
    g = exact.transition_gradient(target, POLICY, horizon=horizon).reshape(3, 2, 3)
    zeta, mean = p / q, (p * g).sum(axis=2)
    bound = ((p * (g - mean[:, :, None]) ** 2).sum(axis=2) / SHARE).sum()
    as_they_are = ((q * (zeta * g - mean[:, :, None]) ** 2).sum(axis=2) / OTHER).sum()
    normalised = ((q * zeta**2 * (g - mean[:, :, None]) ** 2).sum(axis=2) / OTHER).sum()
    extra = 2 * sum(((mean**2 / x).sum() - mean.sum() ** 2) for x in (SHARE, OTHER))
    arguments, options = (simulator, target, POLICY, SHARE, OTHER), {"horizon": horizon}
    assert_allclose(oee.efficiency_bound(target, POLICY, SHARE, **options), bound, rtol=1e-12)
    assert_allclose(ratio_of_ratios_variance(*arguments, **options), bound + as_they_are, rtol=1e-10)
    assert_allclose(ratio_of_ratios_variance(*arguments, rows="normalised", **options), bound + normalised, rtol=1e-10)
    assert_allclose(
        ratio_of_ratios_variance(*arguments, independent_samples=True, **options),
        bound + as_they_are + extra,
        rtol=1e-10,
    )
    never = OTHER.copy()
    never[0, 0], never[0, 1] = 0.0, 0.4
    assert ratio_of_ratios_variance(simulator, target, POLICY, SHARE, never, **options) == np.inf
    assert ratio_of_ratios_variance(simulator, target, POLICY, never, OTHER, **options) == np.inf


@pytest.mark.parametrize("form", [1, 2, 3])
def test_the_leading_bias_is_that_of_second_differences(form):
    """1/2 sum_x sum_s' P' D^2 J in the direction e_s' - P'(x), over data_distribution(x)."""
    _, target = environments(form)
    transitions, rewards = dense(target)
    rows, step, total = transitions.reshape(6, 3), 1e-3, 0.0

    def value(moved):
        kernel = np.einsum("sa,sat->st", POLICY, moved)
        paid = (POLICY * target.rewards).sum(axis=1)
        if form == 3:
            paid = np.einsum("sa,sat,sat->s", POLICY, moved, rewards)
        return target.initial @ np.linalg.solve(np.eye(3) - 0.7 * kernel, paid)

    for x in range(6):
        for j in range(3):
            direction = np.zeros((6, 3))
            direction[x] = np.eye(3)[j] - rows[x]
            ends = [value((rows + sign * step * direction).reshape(3, 2, 3)) for sign in (1, -1)]
            total += rows[x, j] * (sum(ends) - 2 * value(transitions)) / step**2 / 2 / SHARE.reshape(-1)[x]
    assert abs(total) > 0.01
    assert_allclose(leading_bias(target, POLICY, SHARE), total, rtol=1e-4)


@pytest.mark.parametrize("form", [2, 3])
def test_the_bounds_for_episodes_with_their_own_weights(form):
    """alpha^2 / beta for an MDP, E rho^2 for a tree, each times Var[r + gamma V], by marginals of the paths."""
    mdp, _ = environments(form)
    horizon, gamma = 3, 0.7
    transitions, rewards = dense(mdp)
    paid = rewards if form == 3 else np.zeros((3, 2, 3))
    values = [oee.state_values(mdp, POLICY, horizon=horizon - t) for t in range(horizon)] + [np.zeros(3)]
    found = {"mdp": 0.0, "tree": 0.0}
    alpha, beta, square = mdp.initial, mdp.initial, mdp.initial
    start = mdp.initial @ (values[0] - mdp.initial @ values[0]) ** 2
    for t in range(horizon):
        ahead = paid + gamma * values[t + 1]
        spread = (transitions * (ahead - (transitions * ahead).sum(axis=2, keepdims=True)) ** 2).sum(axis=2)
        under_policy, under_behavior = alpha[:, None] * POLICY, beta[:, None] * BEHAVIOR
        squared = square[:, None] * POLICY**2 / BEHAVIOR
        found["mdp"] += gamma ** (2 * t) * (under_policy**2 / np.maximum(under_behavior, 1e-300) * spread).sum()
        found["tree"] += gamma ** (2 * t) * (squared * spread).sum()
        alpha, beta, square = (np.einsum("sa,sat->t", x, transitions) for x in (under_policy, under_behavior, squared))
    for model, expected in found.items():
        bound = oee.trajectory_efficiency_bound(mdp, BEHAVIOR, POLICY, horizon=horizon, model=model)
        assert_allclose(bound, start + expected, rtol=1e-12)
    assert found["mdp"] < found["tree"]


def test_only_actions_within_reach_must_be_taken():
    """A corridor: the behaviour policy lacks action 1 in its third state, which two moves reach and one does not."""
    rows = np.zeros((4, 2, 4))
    rows[[0, 1, 2, 3], :, [1, 2, 3, 0]] = 1.0
    mdp = FiniteMDP(rows, np.ones(4), [1, 0, 0, 0], 0.9)
    half = np.full((4, 2), 0.5)
    without = half.copy()
    without[2] = [1.0, 0.0]
    for horizon in (1, 2):
        require_action_support(mdp, without, half, horizon)
    text = r"in state 2 it never takes action 1 \(1 such state-action pairs in all\)$"
    for horizon in (3, 4, 9, None):
        with pytest.raises(ValueError, match=text):
            require_action_support(mdp, without, half, horizon)
    require_action_support(mdp, without, without, None)
    never = half.copy()
    never[:, 0], never[:, 1] = 0.0, 1.0
    with pytest.raises(ValueError, match=r"in state 0 it never takes action 0 \(4 such"):
        require_action_support(mdp, never, half, None)
    over = FiniteMDP(np.ones((1, 2, 1)), np.zeros((1, 2)), [1.0], 0.9)
    require_action_support(over, np.array([[1.0, 0.0]]), np.array([[0.5, 0.5]]), None)  # it is over: no action matters


# ---- bad calls ---------------------------------------------------------------------------------------------------


def edited(matrix, entry, value):
    data = matrix.data.copy()
    data[entry] = value
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


SIMULATOR, TARGET = environments(2)
ZETA = oee.true_ratio(TARGET, SIMULATOR)
WRONG = {
    "weighted moments: simulator": (
        lambda: oee.weighted_return_moments(3, ZETA, POLICY, horizon=2),
        "simulator must be a FiniteMDP; got int$",
    ),
    "weighted moments: kind": (
        lambda: oee.weighted_return_moments(SIMULATOR, ZETA, POLICY, kind="step", horizon=2),
        "^kind must be one of 'per_decision', 'trajectory'; got 'step'$",
    ),
    "policy moments: mdp": (
        lambda: oee.policy_is_moments(3, POLICY, POLICY, horizon=2),
        "^mdp must be a FiniteMDP; got int$",
    ),
    "policy moments: behaviour": (
        lambda: oee.policy_is_moments(SIMULATOR, POLICY * 2, POLICY, horizon=2),
        r"^behavior_policy\[0\] must sum to 1",
    ),
    "policy moments: policy": (
        lambda: oee.policy_is_moments(SIMULATOR, POLICY, POLICY * 2, horizon=2),
        r"^policy\[0\] must sum to 1",
    ),
    "doubly robust: simulator": (
        lambda: oee.doubly_robust_moments(3, ZETA, POLICY, horizon=2),
        "^simulator must be a FiniteMDP; got int$",
    ),
    "doubly robust: horizon": (
        lambda: oee.doubly_robust_moments(SIMULATOR, ZETA, POLICY, horizon=None),
        "^horizon must be a positive integer; got None$",
    ),
    "doubly robust: a baseline that is no array": (
        lambda: oee.doubly_robust_moments(SIMULATOR, ZETA, POLICY, baseline="V", horizon=2),
        "^baseline must be an array of numbers; got str",
    ),
    "doubly robust: a baseline that is not finite": (
        lambda: oee.doubly_robust_moments(SIMULATOR, ZETA, POLICY, baseline=np.full((3, 3), np.inf), horizon=2),
        r"^baseline\[0, 0\] must be finite; it is inf$",
    ),
    "weight moments: simulator": (
        lambda: weight_moments(3, ZETA, POLICY, horizon=2),
        "^simulator must be a FiniteMDP; got int$",
    ),
    "weight moments: horizon": (
        lambda: weight_moments(SIMULATOR, ZETA, POLICY, horizon=0),
        "^horizon must be a positive integer; it is 0$",
    ),
    "weight growth: simulator": (
        lambda: weight_growth(3, ZETA, POLICY),
        "^simulator must be a FiniteMDP; got int$",
    ),
    "ratio of ratios: rows": (
        lambda: ratio_of_ratios_variance(SIMULATOR, TARGET, POLICY, SHARE, OTHER, rows="clipped"),
        "^rows must be one of 'as_they_are', 'normalised'; got 'clipped'$",
    ),
    "ratio of ratios: simulator": (
        lambda: ratio_of_ratios_variance(3, TARGET, POLICY, SHARE, OTHER),
        "^simulator must be a FiniteMDP; got int$",
    ),
    "ratio of ratios: target": (
        lambda: ratio_of_ratios_variance(SIMULATOR, 3, POLICY, SHARE, OTHER),
        "^target must be a FiniteMDP; got int$",
    ),
    "ratio of ratios: data": (
        lambda: ratio_of_ratios_variance(SIMULATOR, TARGET, POLICY, SHARE / 2, OTHER),
        "^data_distribution must sum to 1",
    ),
    "ratio of ratios: the simulator's data": (
        lambda: ratio_of_ratios_variance(SIMULATOR, TARGET, POLICY, SHARE, OTHER / 2),
        "^simulator_distribution must sum to 1",
    ),
    "leading bias: data": (
        lambda: leading_bias(TARGET, POLICY, SHARE / 2),
        "^data_distribution must sum to 1",
    ),
    "leading bias: discount 1": (
        lambda: leading_bias(TARGET.with_discount(1.0), POLICY, SHARE),
        "^horizon must be given at discount 1$",
    ),
    "bound for episodes: mdp": (
        lambda: oee.trajectory_efficiency_bound(3, BEHAVIOR, POLICY, horizon=2),
        "^mdp must be a FiniteMDP; got int$",
    ),
    "bound for episodes: horizon": (
        lambda: oee.trajectory_efficiency_bound(SIMULATOR, BEHAVIOR, POLICY, horizon=0),
        "^horizon must be a positive integer; it is 0$",
    ),
    "bound for episodes: behaviour": (
        lambda: oee.trajectory_efficiency_bound(SIMULATOR, BEHAVIOR * 2, POLICY, horizon=2),
        r"^behavior_policy\[0\] must sum to 1",
    ),
    "bound for episodes: model": (
        lambda: oee.trajectory_efficiency_bound(SIMULATOR, BEHAVIOR, POLICY, horizon=2, model="bush"),
        "^model must be one of 'mdp', 'tree', 'stationary'; got 'bush'$",
    ),
    "occupancy: of": (
        lambda: oee.occupancy(SIMULATOR, POLICY, of="pairs"),
        "^of must be one of 'state', 'state_action', 'transition'; got 'pairs'$",
    ),
    "reweighting by no matrix": (
        lambda: exact.reweight(SIMULATOR, np.ones((6, 3))),
        r"^ratio must be sparse of shape \(6, 3\), row s\*A \+ a; got \(6, 3\)$",
    ),
    "reweighting by a number": (
        lambda: exact.reweight(SIMULATOR, 3.0),
        r"^ratio must be sparse of shape \(6, 3\), row s\*A \+ a; got float$",
    ),
    "reweighting by a negative ratio": (
        lambda: exact.reweight(SIMULATOR, edited(SIMULATOR.transitions, 5, -1.0)),
        r"^ratio must be finite and nonnegative; at s=0, a=1 -> s'=2 it is -1\.0$",
    ),
    "reweighting by nan": (
        lambda: exact.reweight(SIMULATOR, edited(SIMULATOR.transitions, 6, np.nan)),
        r"^ratio must be finite and nonnegative; at s=1, a=0 -> s'=0 it is nan$",
    ),
    "weighting by no matrix": (
        lambda: weight_growth(SIMULATOR, np.ones((6, 3)), POLICY),
        r"^zeta must be sparse of shape \(6, 3\), row s\*A \+ a; got \(6, 3\)$",
    ),
    "weighting by nan": (
        lambda: weight_growth(SIMULATOR, SIMULATOR.transitions * np.nan, POLICY),
        "^zeta must be finite and nonnegative; entry 0 is nan$",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_calls_name_their_argument(name):
    call, text = WRONG[name]
    with pytest.raises(ValueError, match=text):
        call()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("self_normalized", [False, True])
def test_ratios_of_moves_in_absorbing_states_do_not_count(kind, self_normalized):
    simulator = oee.tasks.gridworld(3, 0.3)
    zeta = oee.true_ratio(oee.tasks.gridworld(3, 0.2), simulator).values.copy()
    other = zeta.copy()
    over = np.repeat(simulator.absorbing(), simulator.n_actions)
    other.data[over[np.repeat(np.arange(zeta.shape[0]), np.diff(zeta.indptr))]] = 1.7
    assert (other.data == 1.7).sum() == simulator.n_actions
    policy = oee.tasks.gridworld_expert(3)
    one, two = (
        exact.weighted_return_moments(simulator, z, policy, kind=kind, horizon=6, self_normalized=self_normalized)
        for z in (zeta, other)
    )
    assert (one.mean, one.variance) == (two.mean, two.variance)
    assert_array_equal(*(weight_moments(simulator, z, policy, horizon=6) for z in (zeta, other)))


def test_moments_print_their_numbers():
    found = exact.return_moments(oee.tasks.gridworld(3, 0.3), oee.tasks.gridworld_expert(3), horizon=5)
    assert found.by_step is None
    page = found._repr_html_()
    for text in ("Moments of one episode", "standard deviation", f"{found.standard_deviation:.6g}", "mean"):
        assert text in page


@pytest.mark.parametrize("which", ["kernel", "rewards"])
def test_the_error_bound_counts_the_rounding_of_the_policys_rows(which):
    """Thousands of actions: sums over them are rounded before the system is solved. 40 states that stay where they are."""
    n, n_actions, rng = 40, 2000, np.random.default_rng(0)
    policy = rng.dirichlet(np.ones(n_actions), n)
    rewards = np.ones((n, n_actions)) if which == "kernel" else rng.normal(size=(n, n_actions)) * 1e6
    stay = sparse.csr_array((np.ones(n * n_actions), (np.arange(n * n_actions), np.repeat(np.arange(n), n_actions))))
    mdp = FiniteMDP(stay, rewards, np.full(n, 1 / n), 0.999 if which == "kernel" else 0.0)
    found = exact.evaluate_policy(mdp, policy)
    gamma = Fraction(mdp.discount)
    missed = []
    for state in range(n):
        act = [Fraction(x) for x in policy[state].tolist()]
        pay = sum(a * Fraction(r) for a, r in zip(act, rewards[state].tolist(), strict=True))
        missed.append(abs(Fraction(float(found.values[state])) - pay / (1 - gamma * sum(act))))
    assert Fraction(found.error_bound) / 10**5 < max(missed) <= Fraction(found.error_bound)


def test_moments_without_a_horizon_have_the_exact_mean():
    simulator = oee.tasks.gridworld(4, 0.3, discount=0.8)
    zeta = oee.true_ratio(oee.tasks.gridworld(4, 0.27), simulator)
    policy = oee.uniform_policy(simulator)
    known = oee.policy_value(exact.reweight(simulator, zeta.values), policy)
    for sources in (False, True):
        found = exact.weighted_return_moments(simulator, zeta, policy, sources=sources)
        assert_allclose(found.mean, known, rtol=1e-12)
        assert (found.by_state is not None) == sources
    assert_allclose(exact.return_moments(simulator, policy).mean, oee.policy_value(simulator, policy), rtol=1e-12)
