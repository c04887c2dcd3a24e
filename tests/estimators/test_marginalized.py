"""Marginalised importance sampling and DualDICE against dense equations."""

import numpy as np
import pytest
from estimators.four_states import FULL, POLICY, recorded_problem, reweighted_zeta
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import Problem
from oee_tabular.estimators import DualDice, Marginalized, ModelBased
from oee_tabular.estimators.marginalized import total_discount


def test_sums_of_discounts():
    assert_allclose(total_discount(0.5, None), 2.0)
    assert_allclose(total_discount(0.5, 3), 1.75)
    assert total_discount(1.0, 3) == 3.0


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
    assert_allclose(found.diagnostics["largest_nu"], np.abs(nu).max(), rtol=1e-6)
    assert_allclose(found.diagnostics["largest_weight"], (b @ nu).max(), rtol=1e-6)
    assert found.diagnostics["residual"] < 1e-12
    assert_allclose(found.value, oee.policy_value(model, POLICY), rtol=1e-9)
    endless = Problem(simulator.with_discount(1.0), problem.log)
    with pytest.raises(ValueError, match=r"^discount must be below 1 for DualDICE; it is 1$"):
        DualDice()(endless, POLICY)
