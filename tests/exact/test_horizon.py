"""Finite horizons: light cone, forward sums and plain sweeps equal the definition."""

from fractions import Fraction

import numpy as np
import pytest
from helpers import (
    BEHAVIOR,
    POLICY,
    environments,
    random_mdp,
    random_policy,
    ratio_of,
    rngs,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact import weight_growth, weight_moments
from oee_tabular.exact.backup import back_up_pairs, back_up_transitions
from oee_tabular.mdp.horizons import total_discount

horizons = st.integers(1, 9)


def backward(model, policy, steps):
    """V_0, V_1: the definition, with library products on the rows as they stand."""
    value = following = np.zeros(model.n_states)
    for t in range(steps - 1, -1, -1):
        ahead = (model.transitions @ value).reshape(model.rewards.shape)
        pairs = model.rewards + model.discount * ahead
        act = policy if policy.ndim == 2 else policy[t]
        following = value
        value = (act * pairs).sum(axis=1)
    return value, following


def forward(model, policy, steps):
    """sum_t gamma^t Pr(s_t = s, a_t = a)."""
    states = model.initial
    total = np.zeros((model.n_states, model.n_actions))
    for t in range(steps):
        pairs = states[:, None] * (policy if policy.ndim == 2 else policy[t])
        total += model.discount**t * pairs
        states = model.transitions.T @ pairs.reshape(-1)
    return total


def some_model(rng, **options):
    """Draw an MDP, in half of the cases with its kernel multiplied by anything.

    Zeros are among the factors.
    """
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 30)), **options)
    if rng.random() < 0.5:
        return mdp
    data = rng.integers(0, 4, mdp.transitions.nnz) / 2.0
    ratio = sparse.csr_array(
        (data, mdp.transitions.indices, mdp.transitions.indptr),
        shape=mdp.transitions.shape,
    )
    return exact.reweight(mdp, ratio)


def some_policy(rng, model, steps, stationary):
    if stationary:
        return random_policy(rng, model)
    return np.stack([random_policy(rng, model) for _ in range(steps)])


@given(rngs, horizons, st.booleans())
def test_all_ways_give_the_sum_of_the_definition(rng, steps, stationary):
    model = some_model(rng)
    policy = some_policy(rng, model, steps, stationary)
    values, following = backward(model, policy, steps)
    scale = 1e-12 * max(1.0, np.abs(values).max())
    assert_allclose(
        exact.state_values(model, policy, horizon=steps), values, rtol=0, atol=scale
    )
    pairs = model.rewards + model.discount * (model.transitions @ following).reshape(
        model.rewards.shape
    )
    assert_allclose(
        exact.action_values(model, policy, horizon=steps), pairs, rtol=0, atol=scale
    )
    value = model.initial @ values
    assert_allclose(
        exact.policy_value(model, policy, horizon=steps), value, rtol=0, atol=scale
    )
    visits = forward(model, policy, steps)
    assert_allclose((visits * model.rewards).sum(), value, rtol=0, atol=scale * steps)
    mass = sum(model.discount**t for t in range(steps))
    assert_allclose(
        exact.occupancy(model, policy, horizon=steps),
        visits / mass,
        rtol=1e-12,
        atol=1e-13,
    )
    states = exact.occupancy(model, policy, horizon=steps, of="state")
    assert_allclose(states, visits.sum(axis=1) / mass, rtol=1e-12, atol=1e-13)


@given(rngs, horizons, st.booleans())
def test_the_values_by_horizon_are_those_of_each(rng, steps, stationary):
    """J_0 = 0, J_t - J_{t-1} = gamma^(t-1) E[r_{t-1}]; J_t is the value of horizon t.

    ``policy_value`` and ``evaluate_policy`` give the same.
    """
    model = some_model(rng)
    policy = some_policy(rng, model, steps, stationary)
    found = exact.policy_values_by_horizon(model, policy, horizon=steps)
    assert found.shape == (steps + 1,)
    assert found[0] == 0.0
    for t in range(1, steps + 1):
        first = policy if stationary else policy[:t]
        value = exact.policy_value(model, first, horizon=t)
        assert_allclose(
            (found[t], exact.evaluate_policy(model, first, horizon=t).value),
            value,
            rtol=1e-12,
            atol=1e-13,
        )
    paid = np.diff(
        [(forward(model, policy, t) * model.rewards).sum() for t in range(steps + 1)]
    )
    assert_allclose(
        np.diff(found), paid, rtol=0, atol=1e-11 * max(1.0, np.abs(found).max())
    )


@given(rngs, st.one_of(st.none(), st.integers(1, 5)))
def test_the_gradient_is_the_sum_of_its_definition(rng, steps):
    """The gradient is sum_t gamma^t alpha_t (r + gamma V'_t+1) on the other's entries.

    alpha is of the first model, V' of the other.
    """
    model, valued = (
        random_mdp(rng, n_states=5, n_actions=2, discount=0.9) for _ in range(2)
    )
    policy = random_policy(rng, model)
    rows = np.repeat(np.arange(10), np.diff(valued.transitions.indptr))
    columns = valued.transitions.indices
    pay = 0.0 if valued.reward_data is None else valued.reward_data
    states = model.initial
    expected = np.zeros(len(rows))
    endless = exact.state_values(valued, policy)
    for t in range(steps or 400):
        share = (states[:, None] * policy).reshape(-1)
        left = backward(valued, policy, steps - t)[1] if steps else endless
        expected += (
            model.discount**t * share[rows] * (pay + model.discount * left[columns])
        )
        states = model.transitions.T @ share
    found = exact.transition_gradient(model, policy, horizon=steps, values_of=valued)
    assert_allclose(
        found, expected, rtol=0, atol=1e-11 * max(1.0, np.abs(expected).max())
    )


# ---- merged sweeps are those of a policy in time; each step and state has its own
# share of the variance
def check_in_time(mdp, zeta, policy, behavior, horizon):
    """Check that one policy for all steps, given for each, changes nothing.

    Its moments are computed entry by entry, the stationary policy's by merged sweeps.
    """
    calls = [
        lambda pi, **options: oee.return_moments(mdp, pi, **options),
        lambda pi, **options: oee.weighted_return_moments(mdp, zeta, pi, **options),
        lambda pi, **options: oee.weighted_return_moments(
            mdp, zeta, pi, self_normalized=True, **options
        ),
        lambda pi, **options: oee.policy_is_moments(mdp, behavior, pi, **options),
        lambda pi, **options: oee.policy_is_moments(
            mdp, behavior, pi, self_normalized=True, **options
        ),
    ]
    for call in calls:
        merged, timed = (
            call(pi, horizon=horizon, sources=True)
            for pi in (policy, np.stack([policy] * horizon))
        )
        for name in ("mean", "variance", "bias", "by_step", "by_state"):
            one = getattr(merged, name)
            two = getattr(timed, name)
            scale = max(1.0, np.abs(two).max(), abs(timed.mean) ** 2)
            assert_allclose(one, two, rtol=1e-9, atol=1e-12 * scale, err_msg=name)


@pytest.mark.large
@settings(max_examples=60)
@given(rngs)
def test_merged_sweeps_are_those_of_a_policy_in_time(rng):
    """Strips that fill and that do not."""
    mdp = random_mdp(
        rng, n_states=int(rng.integers(1, 90)), n_actions=int(rng.integers(1, 5))
    )
    zeta = oee.true_ratio(random_mdp(rng, like=mdp), mdp)
    check_in_time(
        mdp,
        zeta,
        random_policy(rng, mdp),
        random_policy(rng, mdp, zeros=0.0),
        int(rng.integers(1, 7)),
    )


@pytest.mark.large
@settings(max_examples=15)
@given(rngs)
def test_rings_and_rows_of_very_different_lengths(rng):
    """Strips are right for a ring and for rows of very different lengths.

    A ring's entries lead to consecutive states; in the other graph one state leads
    everywhere, the rest to three.
    """
    n = int(rng.integers(70, 200))
    n_actions = 2
    for is_ring in (True, False):
        transitions = np.zeros((n, n_actions, n))
        for step in rng.choice(np.arange(-5, 40), 3, replace=False):
            following = (np.arange(n) + step) % n if is_ring else rng.integers(0, n, n)
            transitions[np.arange(n), :, following] += (
                rng.gamma(0.3, size=(n, n_actions)) + 1e-9
            )
        if not is_ring:
            transitions[n // 2] = 1.0
        transitions /= transitions.sum(axis=2, keepdims=True)
        mdp = oee.FiniteMDP(
            transitions, rng.normal(size=(n, n_actions, n)), np.full(n, 1 / n), 0.9
        )
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
            return oee.weighted_return_moments(
                simulator, zeta, POLICY, sources=True, **options
            )
        return oee.policy_is_moments(
            simulator, BEHAVIOR, POLICY, sources=True, **options
        )

    endless = moments()
    long = moments(horizon=120)
    assert_allclose(endless.mean, long.mean, rtol=1e-10)
    assert_allclose(endless.variance, long.variance, rtol=1e-10)
    assert_allclose(endless.by_state, long.by_state, rtol=1e-9)
    assert endless.by_step is None
    assert endless.bias == 0.0
    assert_allclose(
        endless.variance - endless.by_state.sum(), long.by_step[0], rtol=1e-9
    )


# ---- weights along a walk: how fast they grow, and where they stand still
KINDS = ("per_decision", "trajectory")


@pytest.mark.parametrize("n", [3, 400, 401, 450])
def test_growth_of_large_and_small_chains(n):
    """A ring with zeta = 2: E W_t^2 = 4^t at every size; without weight minus infinity."""
    ring = sparse.csr_array(
        (np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n)
    )
    mdp = FiniteMDP(ring, np.ones(n), np.full(n, 1 / n), 0.9)
    ones = np.ones((n, 1))
    assert_allclose(weight_growth(mdp, ring * 2.0, ones), np.log(4.0), rtol=1e-9)
    assert_allclose(weight_growth(mdp, ring * 0.5, ones), np.log(0.25), rtol=1e-9)
    assert weight_growth(mdp, ring * 0.0, ones) == -np.inf
    first, second = weight_moments(mdp, ring * 2.0, ones, horizon=3)
    assert_allclose(first, [1, 2, 4, 8])
    assert_allclose(second, [1, 4, 16, 64])


def test_an_infinite_sum_of_states_that_are_never_entered():
    """The last state is only a start: no column of the weighted kernel, and yet a row."""
    mdp = FiniteMDP(
        np.array([[[0.5, 0.5, 0.0]], [[0.5, 0.5, 0.0]], [[1.0, 0.0, 0.0]]]),
        [1.0, 2.0, 5.0],
        [0, 0, 1],
        0.5,
    )
    endless, long = (
        oee.return_moments(mdp, np.ones((3, 1)), horizon=h, sources=True)
        for h in (None, 60)
    )
    assert_allclose(
        (endless.mean, endless.variance), (long.mean, long.variance), rtol=1e-12
    )
    assert_allclose(endless.by_state, long.by_state, rtol=1e-12)
    assert weight_growth(
        mdp, oee.true_ratio(mdp, mdp), np.ones((3, 1))
    ) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("self_normalized", [False, True])
def test_ratios_of_transitions_in_absorbing_states_do_not_count(kind, self_normalized):
    simulator = oee.tasks.gridworld(3, 0.3)
    zeta = oee.true_ratio(oee.tasks.gridworld(3, 0.2), simulator).values.copy()
    other = zeta.copy()
    over = np.repeat(simulator.absorbing(), simulator.n_actions)
    other.data[over[np.repeat(np.arange(zeta.shape[0]), np.diff(zeta.indptr))]] = 1.7
    assert (other.data == 1.7).sum() == simulator.n_actions
    policy = oee.tasks.gridworld_expert(3)
    one, two = (
        exact.weighted_return_moments(
            simulator, z, policy, kind=kind, horizon=6, self_normalized=self_normalized
        )
        for z in (zeta, other)
    )
    assert (one.mean, one.variance) == (two.mean, two.variance)
    assert_array_equal(
        *(weight_moments(simulator, z, policy, horizon=6) for z in (zeta, other))
    )


@pytest.mark.parametrize("kind", KINDS)
def test_without_any_weight_nothing_is_left_to_divide_by(kind):
    chain = FiniteMDP(np.full((2, 1, 2), 0.5), [1.0, 2.0], [1, 0], 0.9)
    nothing = sparse.csr_array(np.zeros((2, 2)))
    with pytest.warns(UserWarning, match="all weights of a step are 0"):
        found = oee.weighted_return_moments(
            chain,
            nothing,
            np.ones((2, 1)),
            kind=kind,
            horizon=2,
            self_normalized=True,
            sources=True,
        )
    assert np.isnan([found.mean, found.variance, found.bias]).all()
    plain = oee.weighted_return_moments(
        chain, nothing, np.ones((2, 1)), kind=kind, horizon=2
    )
    assert (plain.mean, plain.variance, plain.bias) == (
        (1.0 if kind == "per_decision" else 0.0),
        0.0,
        0.0,
    )


# ---- the bound on rounding, against rational numbers


def exact_backward(model, policy, steps):
    """V_0 and J for the numbers as they are stored, as fractions."""
    gamma = Fraction(float(model.discount))
    n_actions = model.n_actions
    rows = []
    for row in range(model.transitions.shape[0]):
        part = slice(model.transitions.indptr[row], model.transitions.indptr[row + 1])
        entries = zip(
            model.transitions.indices[part].tolist(),
            map(Fraction, model.transitions.data[part].tolist()),
            strict=True,
        )
        rows.append(list(entries))
    value = [Fraction(0)] * model.n_states
    for t in range(steps - 1, -1, -1):
        act = policy if policy.ndim == 2 else policy[t]
        value = [
            sum(
                Fraction(float(act[s, a]))
                * (
                    Fraction(float(model.rewards[s, a]))
                    + gamma * sum(p * value[j] for j, p in rows[s * n_actions + a])
                )
                for a in range(n_actions)
            )
            for s in range(model.n_states)
        ]
    start = map(Fraction, model.initial.tolist())
    return value, sum(m * v for m, v in zip(start, value, strict=True))


def ill_conditioned(rng, size):
    """An MDP with huge rewards that cancel, on average or from step to step."""
    n_states = int(rng.integers(1, 7))
    n_actions = int(rng.integers(1, 4))
    transitions = rng.dirichlet(np.full(n_states, 0.6), (n_states, n_actions))
    rewards = rng.normal(size=(n_states, n_actions))
    huge = size * rng.choice([-1.0, 0.0, 1.0], (n_states, n_actions))
    if rng.random() < 0.5:  # pay with one hand and take with the other
        huge[:, -1] = -huge[:, :-1].sum(axis=1)
    discount = float(rng.choice([0.3, 0.9, 1.0]))
    return oee.FiniteMDP(
        transitions, rewards + huge, rng.dirichlet(np.ones(n_states)), discount
    )


@settings(max_examples=100)
@given(
    rngs, st.integers(1, 12), st.booleans(), st.sampled_from([1.0, 1e8, 1e16, 1e-80])
)
def test_the_error_bound_of_a_horizon_holds_and_is_no_exaggeration(
    rng, steps, stationary, size
):
    model = ill_conditioned(rng, size)
    shape = (model.n_states,) if stationary else (steps, model.n_states)
    policy = rng.dirichlet(np.ones(model.n_actions), shape)
    found = exact.evaluate_policy(model, policy, horizon=steps)
    values, value = exact_backward(model, policy, steps)
    distance = max(
        abs(Fraction(v) - w) for v, w in zip(found.values.tolist(), values, strict=True)
    )
    assert distance <= Fraction(found.error_bound)
    assert abs(Fraction(found.value) - value) <= Fraction(found.error_bound)
    largest = float(np.abs(model.rewards).max())
    weight = sum(model.discount**t for t in range(steps))
    assert 0.0 < found.error_bound <= 1e3 * np.finfo(float).eps * weight * largest


def test_the_error_bound_shows_where_rewards_cancel():
    """What is left of 1e17 - 1e17 is rounding, or the small rewards are lost."""
    rewards = [[1e17], [188.0 - 1e17], [0.0]]
    rows = [[[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]], [[0.0, 0.0, 1.0]]]
    chain = oee.FiniteMDP(rows, rewards, [1.0, 0.0, 0.0], 1.0)
    found = exact.evaluate_policy(chain, np.ones((3, 1)), horizon=2)
    assert abs(found.value - 188.0) <= found.error_bound
    assert 1.0 < found.error_bound < 1e3


def test_the_error_bound_of_kernels_of_any_sum_grows_with_them():
    model = exact.reweight(survival(2), sparse.csr_array(np.full((2, 2), 1.5)))
    bounds = [
        exact.evaluate_policy(model, np.ones((2, 1)), horizon=t).error_bound
        for t in (1, 10, 20)
    ]
    assert bounds[0] < 1e-14
    assert 1.3**10 < bounds[2] / bounds[1] < 1e3
    over = exact.evaluate_policy(model, np.ones((2, 1)), horizon=5000)
    assert over.error_bound == np.inf


def survival(n):
    return oee.FiniteMDP(np.full((n, 1, n), 1.0 / n), np.ones(n), np.full(n, 1 / n), 1)


discounts = st.one_of(
    st.floats(0.0, 1.0), st.integers(1, 53).map(lambda bits: 1.0 - 2.0**-bits)
)


@given(discounts, st.integers(1, 60))
def test_the_weight_of_a_horizon_is_right_to_rounding(discount, steps):
    """Near discount 1 as well, where 1 - discount^T has lost its digits."""
    exactly = sum(Fraction(discount) ** t for t in range(steps))
    assert abs(Fraction(total_discount(discount, steps)) / exactly - 1) < 2e-15


@settings(max_examples=20)
@given(rngs, discounts, st.integers(1, 9))
def test_an_occupancy_sums_to_one_at_any_discount(rng, discount, steps):
    mdp = random_mdp(rng, n_states=4).with_discount(discount)
    time = oee.occupancy(mdp, random_policy(rng, mdp), horizon=steps)
    assert abs(time.sum() - 1.0) < 1e-13


@settings(max_examples=30)
@given(rngs)
def test_the_backup_of_a_pair_is_the_mean_of_those_of_its_transitions(rng):
    """In kernels of any sum; r(s, a) stands in the pair's alone."""
    model = some_model(rng)
    values = rng.normal(size=model.n_states)
    pairs = back_up_pairs(model, values)
    kernel = model.transitions
    expected = model.rewards.reshape(-1) + model.discount * (kernel @ values)
    assert_allclose(pairs.reshape(-1), expected, rtol=0, atol=1e-12)
    each = back_up_transitions(model, values)
    means = sparse.csr_array((kernel.data * each, kernel.indices, kernel.indptr))
    means.resize(kernel.shape)
    own = model.rewards.reshape(-1) if model.reward_data is None else 0.0
    assert_allclose(means.sum(axis=1) + own, expected, rtol=0, atol=1e-12)
