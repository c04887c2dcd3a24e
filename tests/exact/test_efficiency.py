"""Efficiency bounds and asymptotic variances."""

import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy, rngs
from hypothesis import given
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.exact import leading_bias, ratio_of_ratios_variance
from oee_tabular.exact.moments import values_to_go
from oee_tabular.exact.walks import per_decision, walk_of


def shares(rng, mdp, zeros=0.0):
    from helpers import integer_distribution

    return integer_distribution(rng, mdp.n_states * mdp.n_actions, zeros).reshape(mdp.n_states, mdp.n_actions)


@given(rngs)
def test_41_the_bound_is_the_variance_of_the_numeric_gradient(rng):
    """sum_x Var_{P'}[dJ/dP'] / d_log by central differences of J; and the closed form for r(s, a)."""
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 5)), discount=0.9)
    policy, share = random_policy(rng, mdp), shares(rng, mdp)
    transitions, rewards = dense(mdp)
    size = mdp.n_states
    expected = 0.0
    for s in range(size):
        for a in range(mdp.n_actions):
            slope = np.zeros(size)
            for j in np.flatnonzero(transitions[s, a]):
                values = []
                for step in (1e-5, -1e-5):
                    moved = transitions.copy()
                    moved[s, a, j] += step
                    kernel = np.einsum("sa,sat->st", policy, moved)
                    paid = np.einsum("sa,sat,sat->s", policy, moved, rewards)
                    if mdp.transition_rewards is None:
                        paid = (policy * mdp.rewards).sum(axis=1)
                    values.append(mdp.initial @ np.linalg.solve(np.eye(size) - 0.9 * kernel, paid))
                slope[j] = (values[0] - values[1]) / 2e-5
            row = transitions[s, a]
            expected += row @ (slope - row @ slope) ** 2 / share[s, a]
    found = oee.efficiency_bound(mdp, policy, share)
    assert_allclose(found, expected, rtol=1e-4, atol=1e-6)
    if mdp.transition_rewards is None:
        v = oee.state_values(mdp, policy)
        spread = np.einsum("sat,sat->sa", transitions, (v[None, None] - (transitions @ v)[:, :, None]) ** 2)
        d = oee.occupancy(mdp, policy)
        assert_allclose(found, (0.9 / 0.1) ** 2 * (d**2 / share * spread).sum(), rtol=1e-8, atol=1e-9)


@given(rngs)
def test_30_the_bound_is_convex_in_the_data_and_has_its_minimum_where_theory_says(rng):
    mdp = random_mdp(rng, n_states=3, n_actions=2, discount=0.9)
    policy = random_policy(rng, mdp)
    one, two = shares(rng, mdp), shares(rng, mdp)
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
    costs = np.linalg.solve(1.0 / np.array(parts), [oee.efficiency_bound(mdp, policy, w.reshape(3, 2)) for w in parts])
    costs = np.maximum(costs, 0.0)
    if (costs < 1e-6 * costs.max()).any():
        return
    best = np.sqrt(costs) / np.sqrt(costs).sum()
    assert_allclose(oee.efficiency_bound(mdp, policy, best.reshape(3, 2)), np.sqrt(costs).sum() ** 2, rtol=1e-5)
    assert oee.efficiency_bound(mdp, policy, one) >= np.sqrt(costs).sum() ** 2 * (1 - 1e-5)


@given(rngs)
def test_03_08_scale_shift_and_discount_0(rng):
    mdp = random_mdp(rng, n_states=3, form=2, discount=0.9)
    policy, share = random_policy(rng, mdp), shares(rng, mdp)
    bound = oee.efficiency_bound(mdp, policy, share)
    assert_allclose(
        oee.efficiency_bound(mdp.with_rewards(mdp.rewards * 3 + 5), policy, share), 9 * bound, rtol=1e-7, atol=1e-8
    )
    assert oee.efficiency_bound(mdp.with_discount(0.0), policy, share) == 0
    assert_allclose(oee.efficiency_bound(mdp, policy, share, horizon=600), bound, rtol=1e-6, atol=1e-9)


def test_data_that_never_show_what_matters():
    mdp = oee.tasks.gridworld(3, 0.3)
    share = np.full((9, 4), 1 / 32)
    share[0] = 0
    assert oee.efficiency_bound(mdp, oee.uniform_policy(mdp), share) == np.inf
    certain = oee.FiniteMDP(np.array([[[0.0, 1.0]], [[0.5, 0.5]]]), np.array([0.0, 1.0]), [1, 0], 0.9)
    assert np.isfinite(oee.efficiency_bound(certain, np.ones((2, 1)), [[0.0], [1.0]]))  # a certain move needs no data


@given(rngs)
def test_the_tree_bound_is_the_variance_of_doubly_robust_with_the_truth(rng):
    """Kallus and Uehara: equality for DR with true Q and V; Markov <= tree <= plain importance sampling's variance."""
    mdp = random_mdp(rng, n_states=3, n_actions=2)
    behavior, policy = random_policy(rng, mdp, zeros=0), random_policy(rng, mdp)
    horizon = 3
    values = values_to_go(walk_of(mdp, policy), horizon)
    walk = walk_of(mdp, behavior, policy=policy)
    transitions, _ = dense(mdp)
    pairs = np.stack([mdp.rewards + mdp.discount * transitions @ values[t + 1] for t in range(horizon)])
    robust = per_decision(walk, horizon, c=-pairs.reshape(horizon, -1), h=values[:horizon])
    tree, markov = (
        oee.trajectory_efficiency_bound(mdp, behavior, policy, horizon=horizon, model=model)
        for model in ("tree", "mdp")
    )
    scale = max(1.0, tree)
    assert_allclose(robust.variance, tree, rtol=1e-9, atol=1e-10 * scale)
    assert_allclose(robust.mean, oee.policy_value(mdp, policy, horizon=horizon), rtol=1e-9, atol=1e-9)
    assert markov <= tree + 1e-10 * scale
    on_policy = oee.trajectory_efficiency_bound(mdp, policy, policy, horizon=horizon)
    q_noise = sum(
        mdp.discount ** (2 * t) * reached @ (policy * (pairs[t] - values[t][:, None]) ** 2).sum(axis=1)
        for t, reached in enumerate(marginals(mdp, policy, horizon))
    )
    plain = oee.return_moments(mdp, policy, horizon=horizon)
    assert_allclose(plain.variance, on_policy + q_noise, rtol=1e-8, atol=1e-9 * max(1.0, plain.variance))


def marginals(mdp, policy, horizon):
    reached, transitions = mdp.initial, dense(mdp)[0]
    for _ in range(horizon):
        yield reached
        reached = np.einsum("s,sa,sat->t", reached, policy, transitions)


def simulated(target, policy, share, n, repetitions, seed=0):
    """J of the maximum-likelihood model of n rows drawn from ``share``, many times."""
    rng = np.random.default_rng(seed)
    transitions, _ = dense(target)
    cells = (share[:, :, None] * transitions).reshape(-1)
    size = target.n_states
    found = []
    for counts in rng.multinomial(n, cells, size=repetitions):
        table = counts.reshape(transitions.shape)
        model = table / np.maximum(table.sum(axis=2, keepdims=True), 1)
        kernel = np.einsum("sa,sat->st", policy, model)
        found.append(
            target.initial
            @ np.linalg.solve(np.eye(size) - target.discount * kernel, (policy * target.rewards).sum(axis=1))
        )
    return np.array(found)


def test_the_leading_bias_and_the_bound_against_simulation():
    rng = np.random.default_rng(13)
    target = oee.FiniteMDP(rng.dirichlet(np.ones(3) * 0.7, (3, 2)), rng.normal(size=(3, 2)), [1, 0, 0], 0.8)
    policy, share = np.full((3, 2), 0.5), np.full((3, 2), 1 / 6)
    n = 400
    values = simulated(target, policy, share, n, 40_000)
    error = values.std() / np.sqrt(len(values))
    bias = leading_bias(target, policy, share)
    assert abs(n * (values.mean() - oee.policy_value(target, policy)) - bias) < 4 * n * error
    assert abs(bias) > 6 * n * error  # the test can fail
    assert_allclose(n * values.var(), oee.efficiency_bound(target, policy, share), rtol=0.05)


def test_the_ratio_of_ratios_adds_what_it_should():
    """Each variant's simulated variance; identical environments in closed form."""
    rng = np.random.default_rng(3)
    simulator = oee.FiniteMDP(rng.dirichlet(np.ones(3), (3, 2)), rng.normal(size=(3, 2)), [1, 0, 0], 0.6)
    target = simulator.with_transitions(rng.dirichlet(np.ones(3) * 3, (3, 2)))
    policy, share = np.full((3, 2), 0.5), rng.dirichlet(np.ones(6) * 5).reshape(3, 2)
    other = rng.dirichlet(np.ones(6) * 5).reshape(3, 2)
    p, q = dense(target)[0], dense(simulator)[0]
    n, draws = 200_000, 8000
    paid = (policy * target.rewards).sum(axis=1)

    def value(kernel):
        return target.initial @ np.linalg.solve(np.eye(3) - 0.6 * np.einsum("sa,sat->st", policy, kernel), paid)

    def counts(dist, rows):
        return rng.multinomial(n, (rows[:, :, None] * dist).reshape(-1), size=draws).reshape(draws, 3, 2, 3)

    ours, theirs, ours_2, theirs_2 = counts(p, share), counts(q, other), counts(p, share), counts(q, other)
    found = {"as_they_are": [], "normalised": [], "independent": []}
    for a, b, c, d in zip(ours, theirs, ours_2, theirs_2, strict=True):
        moves, pairs = a / b, a.sum(axis=2) / b.sum(axis=2)
        kernel = moves / pairs[:, :, None] * q
        found["as_they_are"].append(value(kernel))
        found["normalised"].append(value(kernel / kernel.sum(axis=2, keepdims=True)))
        apart = c.sum(axis=2) / d.sum(axis=2)
        found["independent"].append(value(moves / apart[:, :, None] * q))
    arguments = (simulator, target, policy, share, other)
    bound = oee.efficiency_bound(target, policy, share)
    exact = {rows: ratio_of_ratios_variance(*arguments, rows=rows) for rows in ("as_they_are", "normalised")}
    exact["independent"] = ratio_of_ratios_variance(*arguments, independent_samples=True)
    for name, values in found.items():
        assert_allclose(n * np.var(values), exact[name], rtol=0.07)
        assert exact[name] > bound
    same = ratio_of_ratios_variance(target, target, policy, share, share, rows="normalised")
    assert_allclose(same, 2 * bound, rtol=1e-9)


@given(rngs)
def test_finite_horizons_of_the_ratio_of_ratios(rng):
    simulator = random_mdp(rng, n_states=3, discount=0.5, zeros=0.0)
    target = random_mdp(rng, like=simulator)
    policy, share = random_policy(rng, simulator), shares(rng, simulator)
    for rows in ("as_they_are", "normalised"):
        infinite, long = (
            ratio_of_ratios_variance(simulator, target, policy, share, share, rows=rows, horizon=h) for h in (None, 120)
        )
        assert_allclose(long, infinite, rtol=1e-9, atol=1e-12)


GRID = oee.tasks.gridworld(3, 0.3)
UNIFORM = oee.uniform_policy(GRID)
ONLY_UP = np.eye(4)[np.zeros(9, dtype=int)]
BAD = {
    "no support": (
        lambda: oee.trajectory_efficiency_bound(GRID, ONLY_UP, UNIFORM, horizon=3),
        r"behavior_policy must take every action that the policy takes; in state 0 it never takes action 1 \(",
    ),
    "data that are no distribution": (
        lambda: oee.efficiency_bound(GRID, UNIFORM, np.full((9, 4), 0.1)),
        "data_distribution must sum to 1",
    ),
    "data of another shape": (
        lambda: oee.efficiency_bound(GRID, UNIFORM, np.full(9, 1 / 9)),
        r"data_distribution must have shape \(9, 4\); it has shape \(9,\)",
    ),
    "discount 1": (
        lambda: oee.efficiency_bound(GRID.with_discount(1.0), UNIFORM, UNIFORM / 9),
        "horizon must be given at discount 1",
    ),
    "a bound of what": (lambda: oee.efficiency_bound(3, UNIFORM, UNIFORM / 9), "target must be a FiniteMDP; got int"),
    "an unknown model": (
        lambda: oee.trajectory_efficiency_bound(GRID, UNIFORM, UNIFORM, horizon=2, model="chain"),
        "model must be one of 'mdp', 'tree'; got 'chain'",
    ),
    "a target outside the simulator": (
        lambda: ratio_of_ratios_variance(oee.tasks.gridworld(3, 0.0), GRID, UNIFORM, UNIFORM / 9, UNIFORM / 9),
        "target must stay where the simulator has probability",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_calls(name):
    call, text = BAD[name]
    with pytest.raises(ValueError, match=text):
        call()
