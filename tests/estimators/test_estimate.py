"""What an estimate says: its words, its line, its shares of the policy's time, and its seed."""

import numpy as np
import pytest
from estimators.four_states import BEHAVIOR, POLICY, environments, recorded_problem
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions
from oee_tabular.estimators import (
    DoublyRobust,
    Estimate,
    ModelBased,
    OffEnvironment,
    Oracle,
    Simulator,
)
from oee_tabular.estimators.base import effective_sample_size, mean_and_error
from oee_tabular.estimators.names import named_estimators

COVERAGE = {"unseen", "coverage", "fallback_share", "effective_sample_size"}


ONE_STEP = {"one_step_value", "one_step_standard_error", "unseen_standard_error", "one_step_distance", "model_value",
            "maximum_likelihood_value", "moved", "standard_error_if_centre_fits", "interval_method"}  # fmt: skip


LINEAR = {"error_bound", "method"}


KEYS = {
    "simulator": LINEAR,
    "oracle": LINEAR | COVERAGE | {"gap", "row_sum_error", "largest_weight", "standard_error_of"},
    "oee": LINEAR | COVERAGE | ONE_STEP | {"gap", "row_sum_error", "largest_weight", "standard_error_of", "strength",
                                           "meaning"},
    "oee-product": {"gap", "standard_error_of", "n_rollouts", "effective_sample_size", "largest_weight", "mean_weight",
                    "row_sum_error"},
    "model-based": LINEAR | COVERAGE | {"standard_error_of", "single_share"},
    "pdis": {"standard_error_of", "n_episodes", "effective_sample_size", "largest_weight", "mean_weight",
             "truncation_bias_bound"},
    "dr": COVERAGE | {"standard_error_of", "simulator_value", "gap"},
    "dr-beta": COVERAGE | {"standard_error_of", "simulator_value"},
    "dr-rollouts": {"standard_error_of", "n_rollouts", "gap"},
    "dr-episodes": {"standard_error_of", "n_episodes", "effective_sample_size", "largest_weight", "gap"},
    "magic": {"standard_error_of", "n_episodes", "effective_sample_size", "largest_weight", "share_of_model", "gap"},
    "marginalized": COVERAGE | {"gap", "largest_weight", "mean_weight"},
    "dualdice": {"largest_weight", "residual"},
}  # fmt: skip


OF = {"oee-product": "rollouts", "dr-rollouts": "rollouts", "oracle": None}


@pytest.mark.parametrize("name", KEYS)
def test_the_words_in_the_diagnostics(name):
    problem, target = recorded_problem()
    estimate = named_estimators([name], target)[name](problem, POLICY, seed=0)
    assert set(estimate.diagnostics) == KEYS[name]
    assert estimate.status == "ok"
    if name == "oee":
        error = 1.959963984540054 * estimate.standard_error
        assert_allclose(estimate.interval, (estimate.value - error, estimate.value + error), rtol=1e-12)
    else:
        assert estimate.interval is None
    source = estimate.diagnostics.get("standard_error_of")
    assert source == OF.get(name, "log" if "standard_error_of" in KEYS[name] else None)
    assert (estimate.standard_error is None) == (source is None)
    if "method" in KEYS[name]:
        assert estimate.diagnostics["method"] == "dense LU"
        assert 0 <= estimate.diagnostics["error_bound"] < 1e-12
    if "n_rollouts" in KEYS[name]:
        assert estimate.diagnostics["n_rollouts"] == 100
    if "n_episodes" in KEYS[name]:
        assert estimate.diagnostics["n_episodes"] == 30
    if "gap" in KEYS[name]:
        assert 0 <= estimate.diagnostics["gap"] < 1e-9


def test_an_estimate_in_one_line():
    assert repr(Estimate(0.12345678)) == "Estimate(0.123457)"
    assert repr(Estimate(2.0, 0.25)) == "Estimate(2 ± 0.25 (standard error))"
    assert repr(Estimate(2.0, 0.25, status="too few")) == "Estimate(2 ± 0.25 (standard error), too few)"


def test_sizes_and_errors_of_small_samples():
    assert effective_sample_size(np.zeros(3)) == 0.0
    assert effective_sample_size(np.array([1.0, 3.0])) == 1.6
    assert mean_and_error(np.array([4.0])) == (4.0, None)
    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0)


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
