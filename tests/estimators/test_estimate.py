"""What an estimate says: its words, its line, its shares of the policy's time, and its seed."""

import numpy as np
import pytest
from estimators.four_states import BEHAVIOR, POLICY, environments, recorded_problem
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions
from oee_tabular.estimators import DoublyRobust, ModelBased, OffEnvironment, Oracle, Simulator
from oee_tabular.estimators.base import effective_sample_size, mean_and_error
from oee_tabular.estimators.names import named_estimators


def test_sizes_and_errors_of_small_samples():
    assert effective_sample_size(np.zeros(3)) == 0.0
    assert effective_sample_size(np.array([1.0, 3.0])) == 1.6
    assert mean_and_error(np.array([4.0])) == (4.0, None)
    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0)
    assert mean_and_error(np.array([0.1 + 0.2, 0.3, 0.3]))[1] is None  # rounding is no variation
    assert mean_and_error(np.array([1e-17, 0.0, -1e-17]), 1.0)[1] is None
    assert mean_and_error(np.array([1e-200, 2e-200]))[1] == pytest.approx(0.5e-200)


def test_nothing_to_learn_is_full_coverage():
    """The policy is over at once: its time is all where nothing can be learned."""
    mdp = FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [0, 1], 0.9)
    facts = OffEnvironment()(Problem(mdp, Transitions([0], [0], [1])), np.ones((2, 1))).diagnostics
    assert (facts["coverage"], facts["fallback_share"], facts["effective_sample_size"]) == (1.0, 0.0, 0.0)
    assert facts["unseen"] == ""


def test_without_a_horizon_at_discount_one():
    """Values where the policy is absorbed, as with a horizon that it seldom outlasts; a status where it is not."""
    simulator, target = environments(2, discount=1.0)
    problem = Problem(simulator, oee.sample_episodes(target, BEHAVIOR, 30, 50, seed=0))
    for estimator in (OffEnvironment(), ModelBased("simulator"), DoublyRobust()):
        found = estimator(problem, POLICY)
        long = estimator(Problem(simulator, problem.log, horizon=400), POLICY)
        assert_allclose([found.value, found.standard_error], [long.value, long.standard_error], rtol=1e-6)
        names = ["coverage", "effective_sample_size"]
        assert_allclose(
            *([facts[name] for name in names] for facts in (found.diagnostics, long.diagnostics)), rtol=1e-6
        )
    rows = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    ring = FiniteMDP(rows, [1.0, 1.0], [1, 0], 1.0)
    forever = Problem(ring, Transitions([0, 1], [0, 0], [1, 0]))
    for estimator in (Simulator(), Oracle(ring), OffEnvironment(), ModelBased()):
        found = estimator(forever, np.ones((2, 1)))
        assert np.isnan(found.value)
        assert found.standard_error is None
        assert "horizon must be given: at discount 1" in found.status


SOURCES = {
    "simulator": None, "oracle": None, "oee": "log", "oee-product": "rollouts", "model-based": "log", "pdis": "log",
    "dr": "log", "dr-beta": "log", "dr-rollouts": "rollouts", "dr-episodes": "log", "magic": "log", "marginalized": None,
    "dualdice": None,
}  # fmt: skip


@pytest.mark.parametrize("name", SOURCES)
def test_what_a_standard_error_is_of_and_whose_interval_it_makes(name):
    problem, target = recorded_problem()
    estimate = named_estimators([name], target)[name](problem, POLICY, seed=0)
    facts = estimate.diagnostics
    assert estimate.status == "ok"
    assert facts.get("standard_error_of") == SOURCES[name]
    assert (estimate.standard_error is None) == (SOURCES[name] is None)
    ends = estimate.value + 1.959963984540054 * np.array([-1, 1]) * (estimate.standard_error or 0.0)
    assert (estimate.interval is not None) == (name == "oee")
    assert_allclose(estimate.interval or ends, ends, rtol=1e-12)
    assert (facts.get("n_rollouts", 100), facts.get("n_episodes", 30)) == (100, 30)
    assert 0 <= facts.get("gap", 0.0) < 1e-9
    assert 0 <= facts.get("error_bound", 0.0) < 1e-12
