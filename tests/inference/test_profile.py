"""The parts of the profile likelihood interval against plain numpy, Clarabel and what defines its ends."""

import cvxpy as cp
import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee
from oee_tabular.exact import transition_gradient
from oee_tabular.inference import _profile, ascent, likelihood
from oee_tabular.inference import taken as rows_taken
from oee_tabular.inference.ascent import Ascent
from oee_tabular.inference.evidence import gather
from oee_tabular.inference.taken import Chain, Direction, Taken

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
    """On the rows that the policy takes: J, and G up to a constant in each row."""
    problem, policy = problem_of(rng, horizon)
    evidence = gather(problem, policy)
    taken = Taken.of(evidence)
    model = evidence.with_rows(evidence.phat)
    for states in (0, 128):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(rows_taken, "DENSE", states)
            point = taken.valued(taken.chain.phat.copy(), None, 1e-12)
            _, found = taken.direction(point, 1.0, 1e-12)
        assert_allclose(point.value, oee.policy_value(model, policy, horizon=horizon), rtol=1e-9, atol=1e-9)
        exact = transition_gradient(model, policy, horizon=horizon)[taken.entries]
        starts, lengths = taken.chain.indptr[:-1], np.diff(taken.chain.indptr)
        for gradient in (found.gradient, exact):
            gradient -= np.repeat(np.add.reduceat(gradient, starts) / lengths, lengths)
        assert_allclose(found.gradient, exact, atol=1e-7 * max(np.abs(exact).max(), 1e-5))


@settings(max_examples=25)
@given(rngs)
def test_a_step_is_the_linear_program_s_optimum(rng):
    """max G P under sum n KL(phat || P) <= c, by Clarabel; states never seen get mass where that is best."""
    problem, policy = problem_of(rng, n=12)
    taken = Taken.of(gather(problem, policy))
    chain = taken.chain
    gradient = rng.normal(size=len(chain.phat))
    p, used, _ = ascent.step(taken, Direction(gradient, gradient), LIMIT, 0.0, 1e-8)
    assert used <= LIMIT * (1 + 1e-12)
    row = np.repeat(np.arange(len(chain.n)), np.diff(chain.indptr))
    assert_allclose(np.bincount(row, p), 1.0, rtol=1e-12)
    assert (p >= 0).all()
    rows = cp.Variable(len(p), nonneg=True)
    held = (chain.n[row] > 0) & (chain.phat > 0)
    weight = (chain.n[row] * chain.phat)[held]
    sums = [cp.sum(rows[chain.indptr[r] : chain.indptr[r + 1]]) == 1 for r in range(len(chain.n))]
    ball = -weight @ cp.log(rows[held]) <= LIMIT - weight @ np.log(chain.phat[held])
    program = cp.Problem(cp.Maximize(gradient @ rows), [*sums, ball])
    program.solve(solver="CLARABEL")
    assert_allclose(gradient @ p, program.value, rtol=1e-5, atol=1e-5)


@settings(max_examples=40)
@given(rngs, st.sampled_from([None, None, 5]), st.sampled_from([-1.0, 1.0]))
def test_an_end_is_a_member_and_its_value(rng, horizon, sign):
    problem, policy = problem_of(rng, horizon)
    evidence = gather(problem, policy)
    end = likelihood.profile_end(evidence, 0.95, sign)
    assert_allclose(np.add.reduceat(end.rows, evidence.indptr[:-1]), 1.0, rtol=1e-11)
    assert divergence(evidence, end.rows) <= LIMIT + 1e-9
    assert_allclose(divergence(evidence, end.rows), end.divergence, atol=1e-9)
    assert end.value == oee.policy_value(evidence.with_rows(end.rows), policy, horizon=horizon)
    frequencies = oee.policy_value(evidence.with_rows(evidence.phat), policy, horizon=horizon)
    assert sign * (end.value - frequencies) >= -1e-9 * max(1.0, abs(frequencies))


def test_ends_are_stationary():
    """What the set still promises to first order is nothing beside the width; a step that is not the gradient's leaves more."""
    for seed in range(8):
        problem, policy = problem_of(np.random.default_rng(seed), n=400)
        found = oee.interval(problem, policy)
        assert -1e-8 * found.width <= found.diagnostics["promised"] + 4e-12 <= 1e-5 * found.width + 8e-12
        assert found.width == 0 or abs(found.diagnostics["divergence"] - LIMIT) < 1e-7


def sparse_problem(seed):
    """A few next states, few moves, many rows without any: where ends are many."""
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


LED_BY_ONE = [(12, -1), (276, 1), (386, -1), (392, 1)]  # seed, sign
LED_BY_MANY = [(152, -1), (188, -1), (219, -1), (220, -1)]


@pytest.mark.parametrize(
    ("seed", "sign", "afforded"),
    [(*case, 0) for case in LED_BY_ONE] + [(*case, likelihood.AFFORDED) for case in LED_BY_ONE + LED_BY_MANY],
)
def test_the_farthest_of_many_ends_is_found(seed, sign, afforded, monkeypatch):
    """Farther than from the frequencies alone, by 2.4 to 22% of the width; and not nearer than from six more random starts."""
    monkeypatch.setattr(likelihood, "AFFORDED", afforded)
    problem, policy = sparse_problem(seed)
    evidence = gather(problem, policy)
    end, other = (likelihood.profile_end(evidence, 0.95, s).value for s in (sign, -sign))
    taken = Taken.of(evidence)
    base, _ = taken.direction(taken.valued(taken.chain.phat.copy(), None), 1.0)

    def ascended(point, wander):
        return Ascent(taken, sign, LIMIT, base.value).end(point, 200, wander=wander)[0].value

    assert sign * (end - ascended(base, 2)) > 0.015 * abs(end - other)
    lengths, rng = np.diff(taken.chain.indptr), np.random.default_rng(0)
    for _ in range(6):
        order = rng.uniform(size=len(taken.chain.phat))
        leading = (order == np.repeat(np.maximum.reduceat(order, taken.chain.indptr[:-1]), lengths)).astype(float)
        point = taken.valued(likelihood.toward(taken, leading, LIMIT), base)
        assert sign * (ascended(point, 0) - end) < 1e-3 * abs(end - other)


def test_a_value_near_by_costs_a_step_and_errs_to_second_order():
    """V of rows near by is solved for to a thousandth of the change; J, corrected by the last d, is far closer."""
    simulator = oee.tasks.gridworld(20, 0.2)
    policy = oee.uniform_policy(simulator)
    log = oee.sample_transitions(simulator, np.full(policy.shape, 1 / policy.size), 8000, seed=1)
    evidence = gather(oee.Problem(simulator, log), policy)
    start = likelihood.Start.of(evidence)
    taken = start.taken
    *_, member, _ = start.members(1.0, LIMIT)
    p = likelihood.toward(taken, member, 0.1)
    near = taken.valued(p, start.base)
    truth = taken.valued(p, None, 1e-13)
    change = np.abs(truth.values - start.base.values).max()
    assert 1e-6 < np.abs(near.values - truth.values).max() / change < 1e-2
    uncorrected = taken.chain.initial @ near.values
    assert abs(near.value - truth.value) < 1e-5 * change
    assert abs(near.value - truth.value) < 0.1 * abs(uncorrected - truth.value)


@pytest.mark.parametrize("u", [0.0, 1e-8, 0.5, 30.0])
@pytest.mark.parametrize("near", [0.0, 0.5, 1.0, 3.0, 1e6])
def test_the_root_of_a_row(u, near):
    """Two states at frequency .5 with u and -u: x = 1 + e solves x^2 - x = u^2; from wherever the search begins."""
    root = 2.0 * u**2 / (1.0 + np.sqrt(1.0 + 4.0 * u**2))
    found = _profile.root(0, 2, np.array([0.5, 0.5]), np.array([u, -u]), 0.0, 1.0, near * root)
    assert_allclose(found, root, rtol=1e-14, atol=1e-23)


@given(rngs)
def test_rows_without_data_are_filled_greedily(rng):
    """Within the box, with sum 1, and where v is larger an entry is full before another gets more than its least."""
    n = int(rng.integers(1, 8))
    low = rng.dirichlet(np.ones(n)) * rng.choice([0.0, 0.5])
    high = np.maximum(low, rng.choice([0.0, 0.2, 1.0], n))
    high[rng.integers(n)] = 1.0
    v, p = rng.integers(0, 4, n).astype(float), np.full(n, np.nan)
    chain = Chain(*[np.zeros(0)] * 9)._replace(indptr=np.array([0, n]))
    _profile.greedy(np.array([0]), chain, low, high, v, p)
    assert_allclose(p.sum(), 1.0, rtol=1e-14)
    assert (p >= low).all()
    assert (p <= high + 1e-15).all()
    better = v[:, None] > v
    full, least = (p >= high - 1e-14)[:, None], (p <= low + 1e-14)[None]
    assert (full | least)[better].all()
