"""The ascent to the ends of the likelihood interval against numpy, Clarabel, SLSQP and what defines an end."""

import cvxpy as cp
import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats
from scipy.optimize import minimize

import oee_tabular as oee
from oee_tabular.exact import transition_gradient
from oee_tabular.inference import _likelihood, _robust, likelihood, policy_rows
from oee_tabular.inference.evidence import gather, reachable_rows
from oee_tabular.inference.likelihood import likelihood_ends
from oee_tabular.inference.policy_rows import PolicyRows

LIMIT = stats.chi2.ppf(0.95, 1) / 2


def problem_of(rng, horizon=None, n=None):
    simulator = random_mdp(rng, n_states=int(rng.integers(3, 9)), n_actions=2)
    policy = random_policy(rng, simulator)
    shape = policy.shape
    n = int(rng.integers(5, 200)) if n is None else n
    log = oee.sample_transitions(simulator, np.full(shape, 1 / policy.size), n, seed=int(rng.integers(99)))
    return oee.Problem(simulator, log, horizon=horizon), policy


def divergence(evidence, rows):
    held = (evidence.n[evidence.rows] > 0) & (evidence.phat > 0)
    return float((evidence.n[evidence.rows] * evidence.phat)[held] @ np.log(evidence.phat[held] / rows[held]))


@settings(max_examples=40)
@given(rngs, st.sampled_from([None, 1, 6]))
def test_values_and_gradients_are_those_of_the_model(rng, horizon):
    """On the rows that the policy takes: J, and where there are data G up to a constant in each row."""
    problem, policy = problem_of(rng, horizon)
    evidence = gather(problem, policy)
    rows = PolicyRows.from_evidence(evidence)
    model = evidence.with_rows(evidence.phat)
    starts, lengths = rows.arrays.indptr[:-1], np.diff(rows.arrays.indptr)
    exact = transition_gradient(model, policy, horizon=horizon)[rows.entries]
    exact = np.where(rows.has_data, exact - np.repeat(np.add.reduceat(exact, starts) / lengths, lengths), 0.0)
    for n_dense in (0, 128):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(policy_rows, "N_DENSE", n_dense)
            point = rows.evaluate(np.stack([rows.arrays.phat] * 2), None, 1e-12)
        for value, gradient in zip(point.value, point.gradient, strict=True):
            assert_allclose(value, oee.policy_value(model, policy, horizon=horizon), rtol=1e-9, atol=1e-9)
            centred = gradient - np.repeat(np.add.reduceat(gradient, starts) / lengths, lengths)
            found = np.where(rows.has_data, centred, 0.0)
            assert_allclose(found, exact, atol=1e-7 * max(np.abs(exact).max(), 1e-5))


@settings(max_examples=25)
@given(rngs)
def test_best_rows_are_a_convex_program_s_optimum(rng):
    """max G P under sum n KL(phat || P) <= c, by Clarabel; states never observed get mass where that is best."""
    problem, policy = problem_of(rng, n=12)
    rows = PolicyRows.from_evidence(gather(problem, policy))
    arrays = rows.arrays
    gradient = rng.normal(size=(1, len(arrays.phat)))
    (p,), (reached,) = rows.best_rows(gradient, arrays.phat[None], np.ones(1), LIMIT, 1e-8, np.zeros(1))
    assert reached <= LIMIT * (1 + 1e-12)
    row = np.repeat(np.arange(len(arrays.n)), np.diff(arrays.indptr))
    assert_allclose(np.bincount(row, p), 1.0, rtol=1e-12)
    assert (p >= 0).all()
    free = cp.Variable(len(p), nonneg=True)
    held = (arrays.n[row] > 0) & (arrays.phat > 0)
    weight = (arrays.n[row] * arrays.phat)[held]
    sums = [cp.sum(free[arrays.indptr[r] : arrays.indptr[r + 1]]) == 1 for r in range(len(arrays.n))]
    ball = -weight @ cp.log(free[held]) <= LIMIT - weight @ np.log(arrays.phat[held])
    program = cp.Problem(cp.Maximize(gradient[0] @ free), [*sums, ball])
    program.solve(solver="CLARABEL")
    assert_allclose(gradient[0] @ p, program.value, rtol=1e-5, atol=1e-5)


@settings(max_examples=40)
@given(rngs, st.sampled_from([None, None, 5]))
def test_an_end_is_a_member_and_its_value(rng, horizon):
    problem, policy = problem_of(rng, horizon)
    evidence = gather(problem, policy)
    frequencies = oee.policy_value(evidence.with_rows(evidence.phat), policy, horizon=horizon)
    for sign, end in zip((-1.0, 1.0), likelihood_ends(evidence, 0.95), strict=True):
        assert_allclose(np.add.reduceat(end.rows, evidence.indptr[:-1]), 1.0, rtol=1e-11)
        assert divergence(evidence, end.rows) <= LIMIT + 1e-9
        assert_allclose(divergence(evidence, end.rows), end.divergence, atol=1e-9)
        assert end.value == oee.policy_value(evidence.with_rows(end.rows), policy, horizon=horizon)
        assert sign * (end.value - frequencies) >= -1e-9 * max(1.0, abs(frequencies))


def test_ends_are_stationary():
    """What the set still promises to first order is nothing beside the width."""
    for seed in range(8):
        problem, policy = problem_of(np.random.default_rng(seed), n=400)
        found = oee.interval(problem, policy)
        assert -1e-8 * found.width <= found.diagnostics["promised"] + 4e-12 <= 1e-5 * found.width + 8e-12
        assert found.width == 0 or abs(found.diagnostics["divergence"] - LIMIT) < 1e-7


def value_and_gradient(evidence, p):
    """J and dJ / dp by numpy alone."""
    model, pair, column = evidence.model, evidence.rows, evidence.model.transitions.indices
    n, state, weight = model.n_states, pair // model.n_actions, evidence.policy.reshape(-1)[pair]
    pay = model.rewards.reshape(-1)[pair] if model.reward_data is None else model.reward_data
    kernel, paid = np.zeros((n, n)), np.bincount(state, weight * p * pay, n)
    np.add.at(kernel, (state, column), model.discount * weight * p)
    if evidence.horizon is None:
        values = np.linalg.solve(np.eye(n) - kernel, paid)
        visits = np.linalg.solve((np.eye(n) - kernel).T, model.initial)
        return model.initial @ values, weight * visits[state] * (pay + model.discount * values[column])
    values, law, gradient = [np.zeros(n)], model.initial, np.zeros(len(p))
    for _ in range(evidence.horizon):
        values.append(paid + kernel @ values[-1])
    for t in range(evidence.horizon):
        gradient += weight * law[state] * (pay + model.discount * values[evidence.horizon - t - 1][column])
        law = law @ kernel
    return model.initial @ values[-1], gradient


def best_of_slsqp(evidence, sign, n_starts, rng):
    """The end by SLSQP over all free probabilities."""
    free = np.flatnonzero((reachable_rows(evidence) & evidence.open_rows)[evidence.rows])
    pair, n = evidence.rows[free], evidence.n[evidence.rows[free]]
    phat, base = evidence.phat[free], evidence.phat.copy()
    held = np.flatnonzero((n > 0) & (phat > 0))
    weight, sums = (n * phat)[held], (pair == np.unique(pair)[:, None]) * 1.0

    def left(x):
        return LIMIT + weight @ np.log(np.maximum(x[held], 1e-300) / phat[held])

    def left_gradient(x):
        return np.bincount(held, weight / np.maximum(x[held], 1e-300), len(x))

    def loss(x):
        base[free] = x
        value, gradient = value_and_gradient(evidence, base)
        return -sign * value, -sign * gradient[free]

    best, bounds = -np.inf, [(1e-10 if k in set(held) else 0.0, 1.0) for k in range(len(free))]
    for _ in range(n_starts):
        aim = rng.exponential(size=len(free)) ** 3
        aim = np.where(n > 0, 0.9 * phat + 0.1 * aim / (sums.T @ (sums @ aim)), aim / (sums.T @ (sums @ aim)))
        rules = [{"type": "eq", "fun": lambda x: sums @ x - 1, "jac": lambda x: sums},
                 {"type": "ineq", "fun": left, "jac": left_gradient}]  # fmt: skip
        options = {"maxiter": 500, "ftol": 1e-13}
        answer = minimize(loss, aim, jac=True, method="SLSQP", bounds=bounds, constraints=rules, options=options).x
        answer = np.clip(answer, 0.0, 1.0) / (sums.T @ (sums @ np.clip(answer, 0.0, 1.0)))
        if left(answer) >= -1e-7:
            best = max(best, -loss(answer)[0])
    return sign * best


@pytest.mark.parametrize("seed", range(8))
def test_no_end_is_short_of_slsqp(seed):
    """Of 119 such problems with ten starts each 1 of 238 ends was, by 1.3% of the width; none of these."""
    rng = np.random.default_rng(seed)
    problem, policy = problem_of(rng, horizon=None if seed % 4 else 5, n=int(rng.choice([8, 20, 60])))
    evidence = gather(problem, policy)
    ends = [end.value for end in likelihood_ends(evidence, 0.95)]
    slack = 1e-5 * (ends[1] - ends[0]) + 1e-9
    assert ends[0] <= best_of_slsqp(evidence, -1.0, 5, rng) + slack
    assert ends[1] >= best_of_slsqp(evidence, 1.0, 5, rng) - slack


def sparse_problem(seed):
    """A few next states, few transitions, many rows without any: where ends are many."""
    rng = np.random.default_rng(1000 + seed)
    n_states, n_actions = int(rng.integers(4, 40)), int(rng.integers(1, 4))
    k = int(rng.integers(2, min(n_states, 6) + 1))
    rows = np.zeros((n_states, n_actions, n_states))
    for row in rows.reshape(-1, n_states):
        row[rng.choice(n_states, k, replace=False)] = rng.dirichlet(np.full(k, rng.choice([0.3, 1.0, 5.0])))
    shape = n_states, n_actions
    rewards = rng.normal(size=shape) if rng.random() < 0.7 else (rng.random(shape) < 0.15) * 1.0
    ends, finite = seed % 5 == 4, seed % 5 in (2, 4)
    discount = 1.0 if ends else float(rng.choice([0.8, 0.95, 0.99]))
    horizon = int(rng.integers(3, 60)) if finite else None
    simulator = oee.FiniteMDP(rows, rewards, rng.dirichlet(np.ones(n_states)), discount)
    other = rows * np.exp(0.3 * rng.normal(size=rows.shape))
    target = simulator.with_transitions(other / other.sum(axis=2, keepdims=True))
    share = rng.dirichlet(np.full(rewards.size, 0.5)).reshape(shape)
    log = oee.sample_transitions(target, share, int(10 ** rng.uniform(1, 3.5)), seed=seed)
    return oee.Problem(simulator, log, horizon=horizon), rng.dirichlet(np.ones(n_actions), size=n_states)


@pytest.mark.parametrize("seed", [12, 152, 188, 276])
def test_several_starts_find_farther_ends_than_the_frequencies(seed, monkeypatch):
    """Of these problems one start misses an end by 1.5% of the width or more."""
    problem, policy = sparse_problem(seed)
    evidence = gather(problem, policy)
    low, high = (end.value for end in likelihood_ends(evidence, 0.95))
    one = likelihood._start_directions
    monkeypatch.setattr(likelihood, "_start_directions", lambda *given: [next(one(*given))])
    nearer_low, nearer_high = (end.value for end in likelihood_ends(evidence, 0.95))
    assert max(nearer_low - low, high - nearer_high) > 0.015 * (high - low)


@pytest.mark.parametrize("seed", [8, 50, 73])
def test_steps_that_overshoot_are_halved(seed):
    """Of these problems an end without that is short by 9 to 19% of the width, and no stationary point."""
    evidence = gather(*sparse_problem(seed))
    low, high = likelihood_ends(evidence, 0.95)
    assert max(low.promised, high.promised) <= 1e-5 * (high.value - low.value)
    assert max(low.change, high.change) <= 1e-6 * (high.value - low.value)


@pytest.mark.parametrize("horizon", [None, 40])
def test_large_problems_have_the_ends_of_small_ones(horizon, monkeypatch):
    """One ascent at a time, V and d corrected from those near by, scouts and one that is continued."""
    simulator, target = oee.tasks.gridworld(6, 0.2, discount=0.95), oee.tasks.gridworld(6, 0.1, discount=0.95)
    policy = oee.tasks.gridworld_policy(6, 0.5)
    log = oee.sample_transitions(target, np.full((36, 4), 1 / 144), 600, seed=1)
    evidence = gather(oee.Problem(simulator, log, horizon=horizon), policy)
    small = [end.value for end in likelihood_ends(evidence, 0.95)]
    monkeypatch.setattr(policy_rows, "N_DENSE", 0)
    large = [end.value for end in likelihood_ends(evidence, 0.95)]
    assert_allclose(large, small, rtol=1e-13, atol=1e-8 * (small[1] - small[0]))


@pytest.mark.parametrize("u", [0.0, 1e-8, 0.5, 30.0])
@pytest.mark.parametrize("near", [0.0, 0.5, 1.0, 3.0, 1e6])
def test_the_root_of_a_row(u, near):
    """Two states at frequency .5 with u and -u: x = 1 + e solves x^2 - x = u^2; from wherever the search begins."""
    root = 2.0 * u**2 / (1.0 + np.sqrt(1.0 + 4.0 * u**2))
    found = _likelihood.find_root(0, 2, np.array([0.5, 0.5]), np.array([u, -u]), 1.0, near * root)
    assert_allclose(found, root, rtol=1e-14, atol=1e-23)


@given(rngs)
def test_rows_without_data_are_filled_greedily(rng):
    """Within the box, with sum 1, and where v is larger an entry is full before another gets more than its least."""
    n = int(rng.integers(1, 8))
    low = rng.dirichlet(np.ones(n)) * rng.choice([0.0, 0.5])
    high = np.maximum(low, rng.choice([0.0, 0.2, 1.0], n))
    high[rng.integers(n)] = 1.0
    v, p = rng.integers(0, 4, n).astype(float), np.full(n, np.nan)
    _robust.greedy_row(v, low, high, 0, n, p, np.empty(n))
    assert_allclose(p.sum(), 1.0, rtol=1e-14)
    assert (p >= low).all()
    assert (p <= high + 1e-15).all()
    better = v[:, None] > v
    full, least = (p >= high - 1e-14)[:, None], (p <= low + 1e-14)[None]
    assert (full | least)[better].all()
