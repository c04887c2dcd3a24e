"""Marginalised importance sampling and DualDICE against dense equations."""

import numpy as np
import pytest
from estimators.four_states import FULL, POLICY, environments, recorded_problem, reweighted_zeta
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import Problem
from oee_tabular.estimators import DualDice, Marginalized, ModelBased


@pytest.mark.parametrize("form", [2, 3])
@pytest.mark.parametrize("horizon", [None, 4])
def test_marginalised_values_row_by_row(form, horizon):
    """sum_x d_target(x) rbar(x) over the rows of the log, rbar its mean pay: beta cancels where there is no box."""
    problem, target = recorded_problem(form, horizon=horizon, n=8)
    simulator = problem.simulator
    zeta = reweighted_zeta(simulator, target, 1.0)
    there, here = (oee.occupancy(m, POLICY, horizon=horizon).reshape(-1) for m in (target, simulator))
    rows = problem.log.state * 2 + problem.log.action
    n = np.bincount(rows, minlength=8)
    paid = np.bincount(rows, problem.log.reward, minlength=8) / np.maximum(n, 1)
    mass = 10.0 if horizon is None else (1 - 0.9**4) / 0.1
    found = Marginalized(ratio=zeta)(problem, POLICY)
    seen, share = n > 0, n / n.sum()
    assert_allclose(found.value, mass * (there * paid)[seen].sum(), rtol=1e-9)
    weights = np.where(seen, there / np.maximum(share, 1e-300), 0.0)
    assert_allclose(found.diagnostics["largest_weight"], weights.max(), rtol=1e-9)
    assert_allclose(found.diagnostics["mean_weight"], share @ weights, rtol=1e-9)
    boxed = Marginalized(ratio=zeta, lower=0.8, upper=1.2)(problem, POLICY)
    beta = np.clip(
        here[seen] / share[seen], 0.8, 1.2
    )  # not the fit's own: that is beta / (the time where the log has rows)
    expected = mass * (share[seen] * beta * there[seen] / np.maximum(here[seen], 1e-300) * paid[seen]).sum()
    assert_allclose(boxed.value, expected, rtol=1e-9)
    limit = Marginalized(ratio=zeta).limit(simulator, target, POLICY, data_distribution=FULL, horizon=horizon)
    assert_allclose(limit, oee.policy_value(target, POLICY, horizon=horizon), rtol=1e-9)


def test_dualdice_against_dense_equations():
    """nu from B^T D B nu = (1 - gamma) mu_0 pi; w = B nu."""
    problem, _ = recorded_problem(2, n=60)
    simulator = problem.simulator
    model = ModelBased("simulator").model(problem)
    ahead = np.einsum("xt,tb->xtb", model.transitions.toarray(), POLICY).reshape(8, 8)
    b = np.eye(8) - 0.9 * ahead
    base = np.diag(oee.occupancy(simulator, POLICY).reshape(-1))
    nu = np.linalg.solve(b.T @ base @ b, 0.1 * (simulator.initial[:, None] * POLICY).reshape(-1))
    found = DualDice()(problem, POLICY)
    assert_allclose(found.diagnostics["largest_weight"], (b @ nu).max(), rtol=1e-6)
    assert found.diagnostics["residual"] < 1e-12
    assert_allclose(found.value, oee.policy_value(model, POLICY), rtol=1e-9)


ONE_HOT = np.eye(8).reshape(4, 2, 8)


@pytest.mark.parametrize("form", [2, 3])
def test_one_hot_features_are_maximum_likelihood(form):
    """A^T theta = -(1 - gamma) E phi_0 is then the flow of the log's frequencies: every pair that goes on is recorded."""
    problem, target = recorded_problem(form, n=80)
    likelihood = ModelBased()(problem, POLICY).value
    found = Marginalized(features=ONE_HOT)(problem, POLICY)
    assert_allclose(found.value, likelihood, rtol=1e-10)
    assert_allclose(Marginalized(features=np.eye(8))(problem, POLICY).value, likelihood, rtol=1e-10)
    by_state = Marginalized(features=lambda s, a: np.stack([s == 0, s == 1, s == 2], axis=1))
    assert_allclose(by_state(problem, POLICY).value, likelihood, rtol=0.2)  # the policy is known: w depends on s alone
    for estimator in (by_state, Marginalized(features=ONE_HOT, lower=0.1, upper=9.0)):
        limit = estimator.limit(problem.simulator, target, POLICY, data_distribution=FULL)
        assert_allclose(limit, oee.policy_value(target, POLICY), rtol=1e-10)


def test_the_saddle_point_pair_by_pair():
    """Two features, and pairs that the log lacks: sums over the log's rows, as the equations are printed."""
    problem, _ = recorded_problem(3, n=3, length=4)
    simulator, log = problem.simulator, problem.log
    counts = problem.counts.sum(axis=1)
    assert (counts[:6] == 0).any()
    phi = np.stack([np.ones((4, 2)), np.arange(8.0).reshape(4, 2) % 3], axis=2)
    live = phi * (np.arange(4) < 3)[:, None, None]  # state 3 is over
    mean = (POLICY[:, :, None] * live).sum(axis=1)
    beta = oee.occupancy(simulator, POLICY) / np.maximum(counts.reshape(4, 2) / len(log), 1e-300)
    rows = [(beta[s, a], live[s, a], mean[j], r)
            for s, a, j, r in zip(log.state, log.action, log.next_state, log.reward, strict=True)]  # fmt: skip
    matrix = np.mean([b * np.outer(f, 0.9 * ahead - f) for b, f, ahead, _ in rows], axis=0)
    theta = np.linalg.solve(matrix.T, -0.1 * simulator.initial @ mean)
    found = Marginalized(features=phi)(problem, POLICY)
    assert_allclose(found.value, np.mean([b * (f @ theta) * r for b, f, _, r in rows]) / 0.1, rtol=1e-10)
    assert_allclose(found.diagnostics["mean_weight"], np.mean([b * (f @ theta) for b, f, _, _ in rows]), rtol=1e-10)
    assert found.diagnostics["fallback_share"] > 0.02
    assert found.findings[0].kind == "coverage"


def test_indistinguishable_features_and_problems_without_a_saddle_point():
    simulator, _ = environments()
    problem = Problem(simulator, oee.Transitions([0, 1], [0, 1], [1, 2]))
    apart = np.stack([np.arange(8) % 3 == 0, np.ones(8), np.arange(8) == 5], axis=1)
    with pytest.raises(ValueError, match="in the pairs that the log and the policy share; columns 0, 1 are not"):
        Marginalized(features=apart)(problem, POLICY)
    elsewhere = Marginalized(features=np.arange(8) == 5)(problem, POLICY)  # 0 in every recorded pair
    assert (elsewhere.value, elsewhere.diagnostics["mean_weight"]) == (0.0, 0.0)
