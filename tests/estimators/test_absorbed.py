"""Discount 1 without a horizon: policies that come to an end have visits, gradients, standard errors and a value that moves."""

import numpy as np

import oee_tabular as oee
from oee_tabular.estimators import ModelBased, OffEnvironment


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
