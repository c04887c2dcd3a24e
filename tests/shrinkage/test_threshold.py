"""The soft threshold: lambda, the change towards the log, and an estimate without it."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import OffEnvironment
from oee_tabular.shrinkage import SoftThreshold
from oee_tabular.shrinkage.threshold import threshold

# lambda of the soft threshold by the ratio of the variances (s / se_fit)^2
LAMBDAS = {0.3: 0.55, 1.0: 0.73, 5.0: 0.98, 10.0: 1.12, 30.0: 1.38, 100.0: 1.70}


@pytest.mark.parametrize("unit", [1.0, 1e-120, 1e120])
def test_the_soft_threshold_is_chosen_by_the_ratio_of_variances(unit):
    for ratio, expected in LAMBDAS.items():
        assert threshold(ratio**0.5 * unit, unit) == pytest.approx(expected)
    # halfway between two of them, in logarithms
    assert threshold(50.0**0.25 * unit, unit) == pytest.approx((0.98 + 1.12) / 2)
    # beyond the table its ends
    assert threshold(0.01 * unit, unit) == 0.55
    assert threshold(0.0, unit) == 0.55
    assert threshold(1e3 * unit, unit) == 1.70
    assert threshold(unit, 0.0) == 1.70


@pytest.mark.parametrize("seed", range(4))
def test_a_value_stops_at_the_threshold_of_its_own_variances(seed):
    """What is left of the change is lambda s, with s and lambda from the diagnostics."""
    pair = oee.testing.case("ragged")
    problem = pair.problem(300, seed=seed)
    found = OffEnvironment()(problem, pair.policy)
    facts = found.diagnostics
    moved = facts["moved"]
    assert 0.0 < moved < 1.0
    change = (found.value - facts["model_value"]) / moved
    s = abs(change) / facts["one_step_distance"]
    ratios, lambdas = map(list, (LAMBDAS, LAMBDAS.values()))
    ratio = (s / facts["standard_error_if_centre_fits"]) ** 2
    expected = np.interp(np.log(ratio), np.log(ratios), lambdas)
    assert (1.0 - moved) * abs(change) / s == pytest.approx(expected, rel=1e-6)


# ---- the move


finite = st.floats(-1e6, 1e6)
positive = st.floats(1e-3, 1e3)


@given(finite, finite, positive, positive)
def test_a_move_goes_towards_both_values_of_the_log(one_step, likelihood, s, se_fit):
    """It never passes the further one, nor twice the nearer one."""
    move = SoftThreshold().move(
        one_step=one_step, likelihood=likelihood, s=s, se_fit=se_fit
    )
    amounts = sorted([abs(one_step), abs(likelihood)])
    assert move.amount * one_step >= 0.0
    assert abs(move.amount) <= min(2.0 * amounts[0], amounts[1]) * (1 + 1e-12)
    if one_step * likelihood <= 0.0:
        assert move == (0.0, 0.0, 0.0)


@given(finite, finite, positive, positive, st.sampled_from([1e-9, 3.0, 1e9]))
def test_a_move_has_the_unit_of_the_values(one_step, likelihood, s, se_fit, unit):
    first, second = (
        SoftThreshold().move(
            one_step=u * one_step, likelihood=u * likelihood, s=u * s, se_fit=u * se_fit
        )
        for u in (1.0, unit)
    )
    assert_allclose(second.amount, unit * first.amount, rtol=1e-9, atol=1e-9 * unit)
    assert_allclose(second[1:], first[1:], rtol=1e-9, atol=1e-9)


# ---- an estimate without it


PAIRS = ("ragged", "ragged infinite", "moves", "survival infinite")


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("n", [1, 30, 1000])
def test_without_an_adjustment_the_value_is_that_of_the_corrected_simulator(name, n):
    """The errors and the other values of the log stay; only the value differs."""
    pair = oee.testing.case(name)
    problem = pair.problem(n, seed=n)
    default = OffEnvironment()(problem, pair.policy)
    plain = OffEnvironment(adjust=None)(problem, pair.policy)
    zeta = oee.transition_ratio(
        problem.counts,
        problem.simulator,
        values_of=pair.policy,
        horizon=problem.horizon,
    )
    model = zeta.target_model(problem.model)
    expected = oee.policy_value(model, pair.policy, horizon=problem.horizon)
    assert_allclose(plain.value, expected, rtol=1e-9)
    assert plain.value == plain.model_value == default.model_value
    assert plain.standard_error == default.standard_error
    left_out = default.diagnostics.keys() - plain.diagnostics.keys()
    assert left_out == {"moved", "one_step_distance"} & default.diagnostics.keys()
    for key in plain.diagnostics:
        assert plain.diagnostics[key] == default.diagnostics[key]
    if default.interval is not None:
        shift = plain.value - default.value
        assert_allclose(plain.interval, np.add(default.interval, shift), atol=1e-9)


@pytest.mark.parametrize("name", PAIRS)
def test_without_a_prior_there_is_nothing_to_adjust(name):
    """The maximum-likelihood model has the log's value already."""
    pair = oee.testing.case(name)
    problem = pair.problem(300, seed=0)
    ratio = oee.ratio.Conditional(prior="none")
    values = [
        OffEnvironment(ratio, adjust=adjust)(problem, pair.policy).value
        for adjust in (None, SoftThreshold())
    ]
    assert_allclose(values[0], values[1], rtol=1e-12)


def test_the_adjustment_is_a_part_of_the_estimator():
    assert OffEnvironment() == OffEnvironment(adjust=SoftThreshold())
    assert OffEnvironment() != OffEnvironment(adjust=None)
    for estimator in (OffEnvironment(), OffEnvironment(adjust=None)):
        assert pickle.loads(pickle.dumps(estimator)) == estimator
        assert eval(repr(estimator)) == estimator


def test_the_papers_estimator_is_a_call_and_a_name():
    """Products of the quotient, without a prior and without an adjustment."""
    pair = oee.testing.case("ragged")
    problem = pair.problem(300, seed=0)
    long = OffEnvironment(
        oee.ratio.Quotient(normalized=False), evaluation="monte_carlo", adjust=None
    )
    expected = long(problem, pair.policy, seed=4)
    assert OffEnvironment.paper()(problem, pair.policy, seed=4) == expected
    report = oee.evaluate(problem, pair.policy, estimators=["paper", "oee"], seed=4)
    assert list(report.table["estimator"]) == ["paper", "oee"]
