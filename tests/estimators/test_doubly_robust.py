"""Doubly robust estimators and MAGIC, recomputed row by row, move by move and step by step."""

import numpy as np
import pytest
from estimators.four_states import BEHAVIOR, POLICY, plain_episodes, recorded_problem, reweighted_zeta
from helpers import dense
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions, exact
from oee_tabular.estimators import DoublyRobust, Magic
from oee_tabular.estimators.episodes import episode_terms, model_values
from oee_tabular.estimators.magic import simplex_minimum
from oee_tabular.estimators.rollouts import rollout_horizon


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("weights", ["occupancy", "beta"])
def test_doubly_robust_on_transitions_row_by_row(form, horizon, weights):
    """J_sim + sum_x visits(x) (frequencies - P) (r + gamma V), its error, and the log's coverage."""
    problem, target = recorded_problem(form, horizon=horizon, n=8)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.0)
    where = exact.reweight(simulator, zeta) if weights == "occupancy" else simulator
    gradient = exact.transition_gradient(where, POLICY, horizon=horizon, values_of=simulator)
    table = np.zeros((8, 4))
    stored = simulator.transitions.tocoo()
    table[stored.coords] = gradient
    counts = problem.counts.toarray()
    n = counts.sum(axis=1)
    value, variance = oee.policy_value(simulator, POLICY, horizon=horizon), 0.0
    for x in np.flatnonzero(n):
        frequency = counts[x] / n[x]
        value += (frequency - simulator.transitions.toarray()[x]) @ table[x]
        variance += frequency @ (table[x] - frequency @ table[x]) ** 2 / n[x]
    found = DoublyRobust(ratio=zeta, weights=weights)(problem, POLICY)
    assert (n == 0).any()
    assert_allclose(found.value, value, rtol=1e-10)
    assert_allclose(found.standard_error, np.sqrt(variance), rtol=1e-10)
    facts = found.diagnostics
    assert_allclose(facts["simulator_value"], oee.policy_value(simulator, POLICY, horizon=horizon))
    time = oee.occupancy(where, POLICY, horizon=horizon).copy()
    time[3] = 0.0  # it is over there: nothing to learn
    seen = n.reshape(4, 2) > 0
    share = time[seen].sum() / time.sum()
    assert_allclose((facts["coverage"], facts["fallback_share"]), (share, 1 - share), atol=1e-12)
    size = time[seen].sum() ** 2 / (time[seen] ** 2 / n.reshape(4, 2)[seen]).sum()
    assert_allclose(facts["effective_sample_size"], size)
    missed = sorted(((-time[s, a], s, a) for s, a in np.argwhere(~seen) if time[s, a] > 0))[:3]
    assert facts["unseen"] == "; ".join(f"s={s}, a={a}" for _, s, a in missed)


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_doubly_robust_on_rollouts_move_by_move(form, horizon):
    """D_t = m_t + zeta (r + gamma D_t+1 - (r + gamma V)) of each rollout, backwards."""
    problem, target = recorded_problem(form, horizon=horizon)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.1)
    steps = horizon or rollout_horizon(0.9, None)
    log = oee.sample_returns(simulator, POLICY, 25, steps, seed=np.random.default_rng(7), record=True).log
    table = zeta.values.toarray().reshape(4, 2, 4)
    transitions, rewards = dense(simulator)
    values = [
        np.zeros(4) if t >= steps else oee.state_values(simulator, POLICY, horizon=horizon and horizon - t)
        for t in range(steps + 1)
    ]
    found = []
    for moves, _ in plain_episodes(log):
        ahead = 0.0
        for t in range(len(moves) - 1, -1, -1):
            s, a, j, r = moves[t]
            u = values[t + 1] if t + 1 < steps else np.zeros(4)
            known = (table[s, a] * transitions[s, a]) @ (0.9 * u + (rewards[s, a] if form == 3 else 0.0))
            ahead = known + (0.0 if form == 3 else r) + table[s, a, j] * 0.9 * (ahead - u[j])
        found.append(ahead)
    estimate = DoublyRobust(data="rollouts", ratio=zeta, n_rollouts=25)(problem, POLICY, seed=7)
    assert_allclose(estimate.value, np.mean(found), rtol=1e-9)
    assert_allclose(estimate.standard_error, np.std(found, ddof=1) / 5, rtol=1e-9)
    assert estimate.diagnostics == {"standard_error_of": "rollouts", "n_rollouts": 25, "gap": 0.0}


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("self_normalized", [False, True])
def test_doubly_robust_on_episodes_step_by_step(horizon, self_normalized):
    """V(s_0) + sum_t gamma^t [share_t+1 (r_t - Q) + share_t V ...] with the model's rest, and all its partial sums."""
    problem, target = recorded_problem(3, horizon=horizon, n=15, length=5)
    model = exact.reweight(problem.simulator, reweighted_zeta(problem.simulator, target, 1.0))
    episodes = plain_episodes(problem.log)
    n, steps = len(episodes), min(max(len(moves) for moves, _ in episodes), horizon or 99)
    v, q = model_values(model, POLICY, horizon, steps)
    for t in range(steps):
        left = horizon and horizon - t
        assert_allclose(v[t], oee.state_values(model, POLICY, horizon=left), rtol=1e-10)
        assert_allclose(q[t], oee.action_values(model, POLICY, horizon=left), rtol=1e-10)
    assert_array_equal(v[steps], np.zeros(4)) if horizon == steps else None
    products = np.ones((n, steps + 1))
    for k, (moves, _) in enumerate(episodes):
        for t in range(steps):
            inside = t < len(moves)
            products[k, t + 1] = products[k, t] * (POLICY[moves[t][:2]] / BEHAVIOR[moves[t][:2]] if inside else 1.0)
    shares = products / products.sum(axis=0) if self_normalized else products / n
    partial = np.zeros((n, steps + 1))
    for k, (moves, over) in enumerate(episodes):
        for j in range(steps + 1):
            used = min(j, len(moves))
            total = sum(
                0.9**t * (shares[k, t + 1] * (r - q[t][s, a]) + shares[k, t] * v[t][s])
                for t, (s, a, _, r) in enumerate(moves[:used])
            )
            state = moves[0][0] if used == 0 else moves[used - 1][2]
            gone = used == len(moves) and over
            if not gone and (horizon is None or used < horizon):
                total += 0.9**used * shares[k, used] * v[used][state]
            partial[k, j] = total
    found = episode_terms(problem, POLICY, model, self_normalized=self_normalized)
    assert_allclose(found.partial, partial, rtol=1e-9, atol=1e-12)
    assert_allclose(found.total, partial[:, -1].sum(), rtol=1e-9)
    assert_allclose(found.values, n * partial[:, -1], rtol=1e-9, atol=1e-12)
    ends = np.array([products[k, min(steps, len(moves))] for k, (moves, _) in enumerate(episodes)])
    assert_allclose(found.last, ends, rtol=1e-12)
    mean = partial[:, -1].sum() / n
    error = np.sqrt(n / (n - 1) * ((partial[:, -1] - mean) ** 2).sum())
    assert_allclose(found.error, error, rtol=1e-9)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    estimate = DoublyRobust(data="episodes", ratio=zeta, self_normalized=self_normalized)(problem, POLICY)
    assert_allclose((estimate.value, estimate.standard_error), (found.total, error), rtol=1e-9)
    assert_allclose(estimate.diagnostics["effective_sample_size"], ends.sum() ** 2 / (ends**2).sum())
    assert_allclose(estimate.diagnostics["largest_weight"], ends.max())


def test_magic_weighs_the_distance_of_a_wrong_model():
    """The simulator for a model, far from the log: its bias is its distance from the bootstrap's central half."""
    rows = np.array([[[0.9, 0.1]], [[0.1, 0.9]]])
    simulator = FiniteMDP(rows, np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), [1, 0], 0.9)
    target = simulator.with_transitions(np.array([[[0.55, 0.45]], [[0.3, 0.7]]]))
    log = oee.sample_episodes(target, np.ones((2, 1)), 12, 4, seed=2)
    problem, zeta = Problem(simulator, log, horizon=4), oee.true_ratio(simulator, simulator)
    parts = episode_terms(problem, np.ones((2, 1)), simulator, self_normalized=True).partial[:, [0, -1]]
    totals, n = parts.sum(axis=0), 12
    draws = np.random.default_rng(5).integers(0, n, size=(30, n))
    low, high = np.quantile(parts[:, 1][draws].sum(axis=1), [0.25, 0.75])
    bias = np.array([max(low - totals[0], totals[0] - high, 0.0), max(low - totals[1], totals[1] - high, 0.0)])
    assert bias[0] > 0.1
    matrix = n / (n - 1) * (parts - totals / n).T @ (parts - totals / n) + np.outer(bias, bias)
    share = np.linalg.solve(matrix, np.ones(2))
    share = np.clip(share / share.sum(), 0, 1)
    found = Magic(ratio=zeta, n_lengths=2, n_bootstrap=30)(problem, np.ones((2, 1)), seed=5)
    assert 0.0 < share[0] < 1.0
    assert_allclose(found.value, share @ totals, rtol=1e-6)


def resampled(problem, draws, zeta):
    """Weighted doubly robust of logs in which the drawn episodes stand, each as often as it was drawn."""
    log, found = problem.log, []
    starts, columns = log.episode_starts, log.columns()
    for draw in draws:
        rows = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in draw])
        parts = {name: column[rows] for name, column in columns.items()}
        parts["episode"] = np.repeat(np.arange(len(draw)), [starts[i + 1] - starts[i] for i in draw])
        again = Problem(problem.simulator, Transitions(**parts), horizon=problem.horizon, behavior_policy=BEHAVIOR)
        found.append(DoublyRobust(data="episodes", ratio=zeta, self_normalized=True)(again, POLICY).value)
    return np.array(found)


def test_magic_normalises_the_weights_of_each_resample():
    """Thomas and Brunskill's bootstrap: g_T of the resample itself, not sums of the log's own shares."""
    problem, target = recorded_problem(3, horizon=4, n=15)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    terms = episode_terms(problem, POLICY, exact.reweight(problem.simulator, zeta), self_normalized=True)
    draws = np.random.default_rng(3).integers(0, 15, size=(20, 15))
    expected = resampled(problem, draws, zeta)
    assert_allclose(terms.resampled(draws), expected, rtol=1e-10)
    assert_allclose(terms.resampled(np.arange(15)[None]), terms.total, rtol=1e-12)
    assert np.abs(terms.partial[:, -1][draws].sum(axis=1) - expected).max() > 0.01  # the two differ


def test_magic_between_the_model_and_the_log():
    """Two lengths: the weights minimise variance plus squared distance from the central half, checked on a grid."""
    problem, target = recorded_problem(3, horizon=4, n=15)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    found = Magic(ratio=zeta, n_lengths=2, n_bootstrap=50)(problem, POLICY, seed=3)
    parts = episode_terms(problem, POLICY, exact.reweight(problem.simulator, zeta), self_normalized=True).partial[
        :, [0, -1]
    ]
    totals, n = parts.sum(axis=0), 15
    covariance = n / (n - 1) * (parts - totals / n).T @ (parts - totals / n)
    draws = np.random.default_rng(3).integers(0, n, size=(50, n))
    low, high = np.quantile(resampled(problem, draws, zeta), [0.25, 0.75])
    bias = np.maximum(np.maximum(totals - high, low - totals), 0)
    matrix = covariance + np.outer(bias, bias)
    x = np.linspace(0, 1, 20_001)
    costs = matrix[0, 0] * x**2 + 2 * matrix[0, 1] * x * (1 - x) + matrix[1, 1] * (1 - x) ** 2
    best = np.array([x[costs.argmin()], 1 - x[costs.argmin()]])
    assert_allclose([found.diagnostics["share_of_model"], found.diagnostics["share_of_log"]], best, atol=1e-4)
    assert_allclose(found.value, best @ totals, atol=1e-3)
    assert_allclose(found.standard_error, np.sqrt(best @ covariance @ best), rtol=1e-2)
    alone = Magic(ratio=zeta, n_lengths=1)(problem, POLICY, seed=3)
    starts = problem.log.episode_starts
    begun = oee.state_values(target, POLICY, horizon=4)[problem.log.state[starts[:-1]]]
    assert_allclose(alone.value, begun.mean(), rtol=1e-12)  # the model, from where the log's episodes start
    first = Transitions(**{k: c[: starts[1]] for k, c in problem.log.columns().items()})
    single = Magic(ratio=zeta)(Problem(problem.simulator, first, horizon=4), POLICY)
    assert np.isnan(single.value)
    assert single.status == "the blend needs at least 2 episodes"
    assert_allclose(simplex_minimum(np.diag([1.0, 3.0])), [0.75, 0.25])
    assert_allclose(simplex_minimum(np.zeros((2, 2))).sum(), 1.0)
