"""Discount 1 without a horizon: policies that come to an end have visits, gradients, standard errors and a value that moves."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment
from oee_tabular.exact import transition_gradient
from oee_tabular.exact.system import DivergentKernelError


def ending(seed, n=8):
    """Rows of all successors, the last state is the end; a target whose rows are bent along V; a policy."""
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.full(n, 2.0), (n, 2))
    rows[-1] = np.eye(n)[-1]
    pay = rng.normal(size=(n, 2)) * (np.arange(n) < n - 1)[:, None]
    simulator = oee.FiniteMDP(rows, pay, np.full(n, 1 / n), 1.0)
    policy = rng.dirichlet(np.ones(2), n)
    level = oee.state_values(simulator, policy)
    bent = rows * np.exp(-0.5 * (level - level.mean()) / level.std())
    return simulator, simulator.with_transitions(bent / bent.sum(axis=2, keepdims=True)), policy


def test_the_gradient_is_the_derivative_of_j():
    simulator, target, policy = ending(1)
    gradient, change = transition_gradient(simulator, policy), target.transitions - simulator.transitions
    ends = [
        oee.policy_value(simulator.with_transitions(simulator.transitions + e * change), policy) for e in (1e-5, -1e-5)
    ]
    toward = target.transitions.data - simulator.transitions.data
    assert_allclose(gradient @ toward, (ends[0] - ends[1]) / 2e-5, rtol=1e-6)
    with pytest.raises(DivergentKernelError, match="the policy is absorbed in states with reward 0"):
        transition_gradient(oee.FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 1.0), np.ones((1, 1)))


def test_where_maximum_likelihood_never_ends_the_value_stays():
    """State 1 was seen to stay where it pays: its frequencies have no value, the default's has one."""
    rows = [[[0.0, 0.5, 0.5]], [[0.0, 0.5, 0.5]], [[0.0, 0.0, 1.0]]]
    simulator = oee.FiniteMDP(rows, [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], 1.0)
    problem = oee.Problem(simulator, oee.Transitions([0, 1, 1], [0, 0, 0], [1, 1, 1]))
    assert not np.isfinite(ModelBased("simulator")(problem, np.ones((3, 1))).value)
    found = OffEnvironment()(problem, np.ones((3, 1)))
    assert found.value == found.diagnostics["model_value"] > 2
    assert "maximum_likelihood_value" not in found.diagnostics
    assert found.interval[0] < found.value < found.interval[1]
    assert "at discount 1" in str(oee.evaluate(problem, {"a": [0, 0, 0], "b": [0, 0, 0]}, estimators="oee"))
