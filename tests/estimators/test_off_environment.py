"""Off-environment evaluation and the ratio that it fits."""

import numpy as np
import pytest
from estimators.four_states import BEHAVIOR, POLICY, environments, recorded_problem, reweighted_zeta
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import Problem, exact
from oee_tabular.estimators import OffEnvironment, Oracle


@pytest.mark.parametrize("horizon", [None, 4])
def test_off_environment_and_its_ratio(horizon):
    """The largest weight, the rows' error, strength and meaning; an unnormalised zeta has a value and nothing more."""
    problem, target = recorded_problem(3, horizon=horizon)
    zeta = oee.transition_ratio(problem.log, problem.simulator, values_of=POLICY, horizon=horizon)
    found = OffEnvironment()(problem, POLICY)
    facts = found.diagnostics
    assert_allclose(facts["largest_weight"], zeta.values.data.max())
    assert facts["row_sum_error"] == zeta.row_sum_error
    assert (facts["strength"], facts["meaning"]) == (zeta.details["strength"], zeta.details["meaning"])
    model = exact.reweight(problem.simulator, zeta)
    gradient = exact.transition_gradient(model, POLICY, horizon=horizon)
    assert_allclose(facts["standard_error_if_centre_fits"], zeta.log_standard_error(gradient), rtol=1e-12)
    step = zeta.one_step(gradient)
    assert_allclose(found.standard_error, np.hypot(step.standard_error, step.unseen), rtol=1e-12)
    assert_allclose(facts["model_value"], oee.policy_value(model, POLICY, horizon=horizon), rtol=1e-12)
    assert_allclose(facts["one_step_value"], facts["model_value"] + step.change, rtol=1e-12)
    assert_allclose(facts["one_step_standard_error"], np.hypot(step.standard_error, step.unseen), rtol=1e-12)
    assert_allclose(facts["unseen_standard_error"], step.unseen, rtol=1e-12)
    loose = OffEnvironment(reweighted_zeta(problem.simulator, target, 1.01))(problem, POLICY)
    assert set(loose.diagnostics) == {"gap", "row_sum_error", "largest_weight", "error_bound", "method"}
    assert loose.standard_error is None
    true = oee.true_ratio(target, problem.simulator)
    assert_allclose(Oracle(target)(problem, POLICY).diagnostics["largest_weight"], true.values.data.max())


def test_ratios_by_name_get_what_the_problem_knows():
    """The behaviour policy, the simulator's data and the seed reach ``transition_ratio``."""
    simulator, target = environments(3)
    log = oee.sample_episodes(target, BEHAVIOR, 200, 6, seed=1)
    for method in ("ratio_of_ratios", "joint"):
        for options in ({}, {"behavior_policy": BEHAVIOR}, {"simulator_data": "exact", "behavior_policy": BEHAVIOR}):
            problem = Problem(simulator, log, **options)
            zeta = oee.transition_ratio(log, simulator, method=method, seed=np.random.default_rng(4), **options)
            found = OffEnvironment(method).fit(problem, POLICY, np.random.default_rng(4))
            assert_allclose(found.values.toarray(), zeta.values.toarray(), rtol=1e-12)
    shares = 1e12 / 8 * target.transitions
    expected = oee.transition_ratio(shares, simulator, method="joint", simulator_data="exact", behavior_policy=BEHAVIOR)
    limit = OffEnvironment("joint").limit(simulator, target, POLICY, behavior_policy=BEHAVIOR)
    assert_allclose(limit, oee.policy_value(exact.reweight(simulator, expected), POLICY), rtol=1e-9)
