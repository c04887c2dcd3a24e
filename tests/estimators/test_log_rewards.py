"""What the log paid: values, gradients and errors under rewards="log", by a dense model of its own."""

import numpy as np
import pytest
from helpers import Dense, table_of
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import DoublyRobust, Marginalized, ModelBased, OffEnvironment, Simulator


def paid_case(form):
    rng = np.random.default_rng(3)
    P = rng.dirichlet(np.ones(3), size=(3, 2))
    simulator = oee.FiniteMDP(P, rng.normal(size=(3, 2, 3)[: len(form)]), [0.5, 0.25, 0.25], 0.8)
    target = simulator.with_transitions(rng.dirichlet(np.ones(3), size=(3, 2)))
    drawn = oee.sample_transitions(target, np.array([[0.3, 0.1], [0.3, 0.1], [0.2, 0.0]]), 40, seed=0)
    pay = rng.normal(size=40)
    log = oee.Transitions(drawn.state, drawn.action, drawn.next_state, pay)
    base = Dense(simulator)
    n, total = table_of(log, (3, 2)), np.zeros((3, 2, 3))
    np.add.at(total, (log.state, log.action, log.next_state), pay)
    own = base.like(base.P)
    own.r = np.where(n > 0, total / np.maximum(n, 1), base.r)
    return simulator, log, rng.dirichlet([1.0, 1.0], size=3), own, n


@pytest.mark.parametrize("horizon", [None, 4])
@pytest.mark.parametrize("form", ["sa", "sat"])
def test_values_use_the_log_s_rewards(form, horizon):
    simulator, log, policy, own, n = paid_case(form)
    problem = oee.Problem(simulator, log, horizon=horizon, rewards="log")
    assert_allclose(Simulator()(problem, policy).value, Dense(simulator).J(policy, horizon), rtol=1e-9)  # its own
    total = n.sum(axis=2, keepdims=True)
    frequency = n / np.maximum(total, 1)
    likeliest = own.like(np.where(total > 0, frequency, own.P))
    found = ModelBased(fallback="simulator")(problem, policy)
    assert_allclose(found.value, likeliest.J(policy, horizon), rtol=1e-9)
    slope = likeliest.slope(policy, horizon)
    seen = total[:, :, 0] > 0
    spread = (likeliest.P * slope**2).sum(axis=2) - (likeliest.P * slope).sum(axis=2) ** 2
    assert_allclose(found.standard_error, np.sqrt((spread[seen] / total[:, :, 0][seen]).sum()), rtol=1e-7)
    fit = oee.transition_ratio(log, simulator, prior="simulator", strength=5.0)
    model = own.like(fit.values.toarray().reshape(3, 2, 3) * own.P)
    told = OffEnvironment(ratio=fit)(problem, policy).diagnostics
    assert_allclose(told["model_value"], model.J(policy, horizon), rtol=1e-9)
    assert_allclose(told["maximum_likelihood_value"], likeliest.J(policy, horizon), rtol=1e-9)
    step = (model.slope(policy, horizon) * (likeliest.P - model.P))[seen].sum()
    assert_allclose(told["one_step_value"], model.J(policy, horizon) + step, rtol=1e-9)


def test_doubly_robust_and_marginalised_values_of_the_log_s_rewards():
    simulator, log, policy, own, n = paid_case("sat")
    problem = oee.Problem(simulator, log, rewards="log")
    total = n.sum(axis=2, keepdims=True)
    frequency = n / np.maximum(total, 1)
    fit = oee.transition_ratio(log, simulator, prior="simulator", strength=5.0)
    model = own.like(fit.values.toarray().reshape(3, 2, 3) * own.P)
    seen = total[:, :, 0] > 0
    ahead = own.r + own.g * own.values(policy)
    change = (model.visits(policy)[:, :, None] * (frequency - own.P) * ahead)[seen].sum()
    assert_allclose(DoublyRobust(ratio=fit)(problem, policy).value, own.J(policy) + change, rtol=1e-9)
    pay = np.array(log.reward)
    share = model.visits(policy)[log.state, log.action] / total[log.state, log.action, 0]
    here = own.visits(policy)
    assert_allclose(Marginalized(ratio=fit)(problem, policy).value, (share * pay).sum(), rtol=1e-7)
    assert here.min() > 0
