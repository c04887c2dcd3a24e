"""Doubly robust estimators and MAGIC, recomputed row by row, move by move and step by
step.
"""

import numpy as np
import pytest
from estimators.four_states import (
    BEHAVIOR,
    FULL,
    POLICY,
    environments,
    plain_episodes,
    recorded_problem,
    reweighted_zeta,
)
from helpers import dense
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import Problem, Transitions, exact
from oee_tabular.estimators import (
    DoublyRobust,
    DualDice,
    Magic,
    Marginalized,
    ModelBased,
)


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("weights", ["occupancy", "beta"])
def test_doubly_robust_on_transitions_row_by_row(form, horizon, weights):
    """J_sim + sum_x visits(x) (frequencies - P) (r + gamma V), its error, and the log's
    coverage.
    """
    problem, target = recorded_problem(form, horizon=horizon, n=8)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.0)
    where = exact.reweight(simulator, zeta) if weights == "occupancy" else simulator
    gradient = exact.transition_gradient(
        where, POLICY, horizon=horizon, values_of=simulator
    )
    table = np.zeros((8, 4))
    stored = simulator.transitions.tocoo()
    table[stored.coords] = gradient
    counts = problem.counts.toarray()
    n = counts.sum(axis=1)
    value = oee.policy_value(simulator, POLICY, horizon=horizon)
    variance = 0.0
    for x in np.flatnonzero(n):
        frequency = counts[x] / n[x]
        value += (frequency - simulator.transitions.toarray()[x]) @ table[x]
        variance += frequency @ (table[x] - frequency @ table[x]) ** 2 / n[x]
    found = DoublyRobust(ratio=zeta, weights=weights)(problem, POLICY)
    assert (n == 0).any()
    assert_allclose(found.value, value, rtol=1e-10)
    assert_allclose(found.standard_error, np.sqrt(variance), rtol=1e-10)
    facts = found.diagnostics
    assert_allclose(
        facts["simulator_value"], oee.policy_value(simulator, POLICY, horizon=horizon)
    )
    time = oee.occupancy(where, POLICY, horizon=horizon).copy()
    time[3] = 0.0  # it is over there: nothing to learn
    seen = n.reshape(4, 2) > 0
    share = time[seen].sum() / time.sum()
    assert_allclose(
        (facts["coverage"], facts["unrecorded_share"]), (share, 1 - share), atol=1e-12
    )
    size = time[seen].sum() ** 2 / (time[seen] ** 2 / n.reshape(4, 2)[seen]).sum()
    assert_allclose(facts["effective_sample_size"], size)
    missed = sorted(
        (-time[s, a], s, a) for s, a in np.argwhere(~seen) if time[s, a] > 0
    )[:3]
    assert facts["unrecorded"] == "; ".join(f"s={s}, a={a}" for _, s, a in missed)


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_doubly_robust_on_rollouts_step_by_step(form, horizon):
    """D_t = m_t + zeta (r + gamma D_t+1 - (r + gamma V)) of each rollout, backwards."""
    problem, target = recorded_problem(form, horizon=horizon)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.1)
    steps = horizon or int(np.ceil(np.log(1e-12) / np.log(0.9))) + 1
    log = oee.sample_returns(
        simulator, POLICY, 25, steps, seed=np.random.default_rng(7), record=True
    ).log
    table = zeta.values.toarray().reshape(4, 2, 4)
    transitions, rewards = dense(simulator)
    values = [
        (
            np.zeros(4)
            if t >= steps
            else oee.state_values(simulator, POLICY, horizon=horizon and horizon - t)
        )
        for t in range(steps + 1)
    ]
    found = []
    for moves, _ in plain_episodes(log):
        ahead = 0.0
        for t in range(len(moves) - 1, -1, -1):
            s, a, j, r = moves[t]
            u = values[t + 1] if t + 1 < steps else np.zeros(4)
            known = (table[s, a] * transitions[s, a]) @ (
                0.9 * u + (rewards[s, a] if form == 3 else 0.0)
            )
            ahead = (
                known
                + (0.0 if form == 3 else r)
                + table[s, a, j] * 0.9 * (ahead - u[j])
            )
        found.append(ahead)
    estimate = DoublyRobust(data="rollouts", ratio=zeta, n_rollouts=25)(
        problem, POLICY, seed=7
    )
    assert_allclose(estimate.value, np.mean(found), rtol=1e-9)
    assert_allclose(estimate.standard_error, np.std(found, ddof=1) / 5, rtol=1e-9)
    assert estimate.diagnostics == {
        "standard_error_of": "rollouts",
        "n_rollouts": 25,
        "gap": 0.0,
    }


def test_where_zeta_is_fitted_the_error_counts_the_visits_too():
    """zeta * P are the log's frequencies: the value is maximum likelihood's, and so is
    its error.
    """
    for discount in (0.9, 1.0):
        simulator, target = environments(3, discount)
        log = oee.sample_episodes(target, BEHAVIOR, 200, 30, seed=2)
        problem = Problem(simulator, log)
        fitted = oee.ratio.Conditional(prior="none")
        likelihood = ModelBased()(problem, POLICY)
        found = DoublyRobust(ratio=fitted)(problem, POLICY)
        assert_allclose(
            [found.value, found.standard_error],
            [likelihood.value, likelihood.standard_error],
            rtol=1e-8,
        )
        known = DoublyRobust(ratio=oee.transition_ratio(log, simulator, prior="none"))(
            problem, POLICY
        )
        assert_allclose(known.value, found.value, rtol=1e-12)
        # a zeta that is given is not the log's
        assert abs(known.standard_error / found.standard_error - 1) > 0.01


def episode_parts(problem, model, *, used, self_normalized=True):
    """(n,) what each episode adds where the log is used for ``used`` steps, and the
    model's value after them.
    """
    episodes = plain_episodes(problem.log)
    horizon = problem.horizon
    n = len(episodes)
    steps = min(max(len(moves) for moves, _ in episodes), horizon or 99)

    def values(function, t):
        left = horizon and horizon - t
        return np.zeros(4) if left == 0 else function(model, POLICY, horizon=left)

    v = [values(oee.state_values, t) for t in range(steps + 1)]
    q = [values(oee.action_values, t) for t in range(steps)]
    products = np.ones((n, steps + 1))
    for k, (moves, _) in enumerate(episodes):
        for t in range(steps):
            ratio = (
                POLICY[moves[t][:2]] / BEHAVIOR[moves[t][:2]] if t < len(moves) else 1.0
            )
            products[k, t + 1] = products[k, t] * ratio
    shares = products / products.sum(axis=0) if self_normalized else products / n
    parts = np.zeros(n)
    for k, (moves, over) in enumerate(episodes):
        j = min(used, steps, len(moves))
        parts[k] = sum(
            0.9**t * (shares[k, t + 1] * (r - q[t][s, a]) + shares[k, t] * v[t][s])
            for t, (s, a, _, r) in enumerate(moves[:j])
        )
        if not (j == len(moves) and over):
            parts[k] += (
                0.9**j * shares[k, j] * v[j][moves[0][0] if j == 0 else moves[j - 1][2]]
            )
    return parts


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("self_normalized", [False, True])
def test_doubly_robust_on_episodes_step_by_step(horizon, self_normalized):
    """V(s_0) + sum_t gamma^t [share_t+1 (r_t - Q) + share_t V ...] with the model's
    rest, and its error.
    """
    problem, target = recorded_problem(3, horizon=horizon, n=15, length=5)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    parts = episode_parts(problem, target, used=99, self_normalized=self_normalized)
    found = DoublyRobust(data="episodes", ratio=zeta, self_normalized=self_normalized)(
        problem, POLICY
    )
    assert_allclose(found.value, parts.sum(), rtol=1e-9)
    assert_allclose(found.standard_error, np.sqrt(15) * parts.std(ddof=1), rtol=1e-9)
    ends = [
        np.prod([POLICY[m[:2]] / BEHAVIOR[m[:2]] for m in moves[: horizon or 99]])
        for moves, _ in plain_episodes(problem.log)
    ]
    assert_allclose(
        found.diagnostics["effective_sample_size"],
        np.sum(ends) ** 2 / np.sum(np.square(ends)),
    )
    assert_allclose(found.diagnostics["largest_weight"], np.max(ends))


def resample(problem, draws, zeta):
    """Weighted doubly robust of logs in which the drawn episodes stand, each as often
    as it was drawn.
    """
    log = problem.log
    found = []
    starts = log.episode_starts
    columns = log.columns()
    for draw in draws:
        rows = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in draw])
        parts = {name: column[rows] for name, column in columns.items()}
        parts["episode"] = np.repeat(
            np.arange(len(draw)), [starts[i + 1] - starts[i] for i in draw]
        )
        again = Problem(
            problem.simulator,
            Transitions(**parts),
            horizon=problem.horizon,
            behavior_policy=BEHAVIOR,
        )
        found.append(
            DoublyRobust(data="episodes", ratio=zeta, self_normalized=True)(
                again, POLICY
            ).value
        )
    return np.array(found)


@pytest.mark.parametrize(
    "is_wrong", [False, True], ids=["the target", "far from the log"]
)
def test_magic_between_the_model_and_the_log(is_wrong):
    """Thomas and Brunskill, two lengths: variance plus squared distance from the
    central half of the bootstrap of g_T.

    The weights are normalised on each resample, and the least is looked for on a grid.
    """
    problem, target = recorded_problem(
        3, horizon=None if is_wrong else 4, n=15, length=5
    )
    rows = dense(target)[0]
    rows[:3] = (
        0.1 * rows[:3] + 0.9 * np.eye(4)[oee.state_values(target, POLICY).argmax()]
    )
    model = target.with_transitions(rows) if is_wrong else target
    zeta = oee.true_ratio(model, problem.simulator)
    found = Magic(ratio=zeta, n_lengths=2, n_bootstrap=50)(problem, POLICY, seed=3)
    parts = np.stack(
        [episode_parts(problem, model, used=used) for used in (0, 99)], axis=1
    )
    totals = parts.sum(axis=0)
    n = 15
    covariance = n / (n - 1) * (parts - totals / n).T @ (parts - totals / n)
    draws = np.random.default_rng(3).integers(0, n, size=(50, n))
    low, high = np.quantile(resample(problem, draws, zeta), [0.25, 0.75])
    bias = np.maximum(np.maximum(totals - high, low - totals), 0)
    matrix = covariance + np.outer(bias, bias)
    x = np.linspace(0, 1, 20_001)
    costs = (
        matrix[0, 0] * x**2
        + 2 * matrix[0, 1] * x * (1 - x)
        + matrix[1, 1] * (1 - x) ** 2
    )
    best = np.array([x[costs.argmin()], 1 - x[costs.argmin()]])
    assert (bias[0] > 0) == is_wrong
    assert_allclose(found.diagnostics["share_of_model"], best[0], atol=1e-4)
    assert_allclose(found.value, best @ totals, atol=1e-3)
    assert_allclose(found.standard_error, np.sqrt(best @ covariance @ best), rtol=1e-2)


def test_magic_of_one_length_or_one_episode():
    problem, target = recorded_problem(3, horizon=4, n=15)
    zeta = reweighted_zeta(problem.simulator, target, 1.0)
    alone = Magic(ratio=zeta, n_lengths=1)(problem, POLICY, seed=3)
    starts = problem.log.episode_starts
    begun = oee.state_values(target, POLICY, horizon=4)[problem.log.state[starts[:-1]]]
    # the model, from where the log's episodes start
    assert_allclose(alone.value, begun.mean(), rtol=1e-12)
    first = Transitions(**{k: c[: starts[1]] for k, c in problem.log.columns().items()})
    single = Magic(ratio=zeta)(Problem(problem.simulator, first, horizon=4), POLICY)
    assert np.isnan(single.value)
    assert single.status == "the blend needs at least 2 episodes"


# ---- marginalised importance sampling and DualDICE against dense equations
@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_marginalised_values_row_by_row(form, horizon):
    """sum_x d_target(x) rbar(x) over the rows of the log, rbar its mean pay: beta
    cancels where there is no box.
    """
    problem, target = recorded_problem(form, horizon=horizon, n=8)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.0)
    there, here = (
        oee.occupancy(m, POLICY, horizon=horizon).reshape(-1)
        for m in (target, simulator)
    )
    rows = problem.log.state * 2 + problem.log.action
    n = np.bincount(rows, minlength=8)
    paid = np.bincount(rows, problem.log.reward, minlength=8) / np.maximum(n, 1)
    mass = 10.0 if horizon is None else (1 - 0.9**4) / 0.1
    found = Marginalized(ratio=zeta)(problem, POLICY)
    seen = n > 0
    share = n / n.sum()
    assert_allclose(found.value, mass * (there * paid)[seen].sum(), rtol=1e-9)
    weights = np.where(seen, there / np.maximum(share, 1e-300), 0.0)
    assert_allclose(found.diagnostics["largest_weight"], weights.max(), rtol=1e-9)
    assert_allclose(found.diagnostics["mean_weight"], share @ weights, rtol=1e-9)
    boxed = Marginalized(ratio=zeta, lower=0.8, upper=1.2)(problem, POLICY)
    beta = np.clip(
        here[seen] / share[seen], 0.8, 1.2
    )  # not the fit's own: that is beta / (the time where the log has rows)
    expected = (
        mass
        * (
            share[seen]
            * beta
            * there[seen]
            / np.maximum(here[seen], 1e-300)
            * paid[seen]
        ).sum()
    )
    assert_allclose(boxed.value, expected, rtol=1e-9)
    limit = Marginalized(ratio=zeta).limit(
        simulator, target, POLICY, data_distribution=FULL, horizon=horizon
    )
    assert_allclose(limit, oee.policy_value(target, POLICY, horizon=horizon), rtol=1e-9)


def test_dualdice_against_dense_equations():
    """nu from B^T D B nu = (1 - gamma) mu_0 pi; w = B nu."""
    problem, _ = recorded_problem(2, n=60)
    simulator = problem.simulator
    model = ModelBased("simulator").model(problem)
    ahead = np.einsum("xt,tb->xtb", model.transitions.toarray(), POLICY).reshape(8, 8)
    b = np.eye(8) - 0.9 * ahead
    base = np.diag(oee.occupancy(simulator, POLICY).reshape(-1))
    nu = np.linalg.solve(
        b.T @ base @ b, 0.1 * (simulator.initial[:, None] * POLICY).reshape(-1)
    )
    found = DualDice()(problem, POLICY)
    assert_allclose(found.diagnostics["largest_weight"], (b @ nu).max(), rtol=1e-6)
    assert found.diagnostics["residual"] < 1e-12
    assert_allclose(found.value, oee.policy_value(model, POLICY), rtol=1e-9)


ONE_HOT = np.eye(8).reshape(4, 2, 8)


@pytest.mark.parametrize("form", [2, 3])
def test_one_hot_features_are_maximum_likelihood(form):
    """A^T theta = -(1 - gamma) E phi_0 is then the flow of the log's frequencies: every
    pair that goes on is recorded.
    """
    problem, target = recorded_problem(form, n=80)
    likelihood = ModelBased()(problem, POLICY).value
    found = Marginalized(features=ONE_HOT)(problem, POLICY)
    assert_allclose(found.value, likelihood, rtol=1e-10)
    assert_allclose(
        Marginalized(features=np.eye(8))(problem, POLICY).value, likelihood, rtol=1e-10
    )
    by_state = Marginalized(
        features=lambda s, a: np.stack([s == 0, s == 1, s == 2], axis=1)
    )
    # the policy is known: w depends on s alone
    assert_allclose(by_state(problem, POLICY).value, likelihood, rtol=0.2)
    for estimator in (by_state, Marginalized(features=ONE_HOT, lower=0.1, upper=9.0)):
        limit = estimator.limit(
            problem.simulator, target, POLICY, data_distribution=FULL
        )
        assert_allclose(limit, oee.policy_value(target, POLICY), rtol=1e-10)


def test_the_saddle_point_pair_by_pair():
    """Two features, and pairs that the log lacks: sums over the log's rows, as the
    equations are printed.
    """
    problem, _ = recorded_problem(3, n=3, length=4)
    simulator = problem.simulator
    log = problem.log
    counts = problem.counts.sum(axis=1)
    assert (counts[:6] == 0).any()
    phi = np.stack([np.ones((4, 2)), np.arange(8.0).reshape(4, 2) % 3], axis=2)
    live = phi * (np.arange(4) < 3)[:, None, None]  # state 3 is over
    mean = (POLICY[:, :, None] * live).sum(axis=1)
    beta = oee.occupancy(simulator, POLICY) / np.maximum(
        counts.reshape(4, 2) / len(log), 1e-300
    )
    rows = [
        (beta[s, a], live[s, a], mean[j], r)
        for s, a, j, r in zip(
            log.state, log.action, log.next_state, log.reward, strict=True
        )
    ]
    matrix = np.mean(
        [b * np.outer(f, 0.9 * ahead - f) for b, f, ahead, _ in rows], axis=0
    )
    theta = np.linalg.solve(matrix.T, -0.1 * simulator.initial @ mean)
    found = Marginalized(features=phi)(problem, POLICY)
    assert_allclose(
        found.value,
        np.mean([b * (f @ theta) * r for b, f, _, r in rows]) / 0.1,
        rtol=1e-10,
    )
    assert_allclose(
        found.diagnostics["mean_weight"],
        np.mean([b * (f @ theta) for b, f, _, _ in rows]),
        rtol=1e-10,
    )
    assert found.diagnostics["unrecorded_share"] > 0.02
    assert found.findings[0].kind == "coverage"


def test_indistinguishable_features_and_problems_without_a_saddle_point():
    simulator, _ = environments()
    problem = Problem(simulator, oee.Transitions([0, 1], [0, 1], [1, 2]))
    apart = np.stack([np.arange(8) % 3 == 0, np.ones(8), np.arange(8) == 5], axis=1)
    with pytest.raises(
        ValueError,
        match="in the pairs that the log and the policy share; columns 0, 1 are not",
    ):
        Marginalized(features=apart)(problem, POLICY)
    # 0 in every recorded pair
    elsewhere = Marginalized(features=np.arange(8) == 5)(problem, POLICY)
    assert (elsewhere.value, elsewhere.diagnostics["mean_weight"]) == (0.0, 0.0)
