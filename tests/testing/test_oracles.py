import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.estimators import (
    ImportanceSampling,
    ModelBased,
    OffEnvironment,
    Simulator,
)
from oee_tabular.testing import case, compare_with_oracle

RAGGED = case("ragged")
EVEN = np.array([[1 / 6, 1 / 6]] * 3 + [[0.0, 0.0]])


def compare(estimator, pair=RAGGED, repetitions=3, **options):
    """On episodes of the case, or on transitions of a distribution."""
    data = {} if "data_distribution" in options else {"behavior_policy": pair.behavior}
    given = (
        {"n": 100, "horizon": pair.horizon, "repetitions": repetitions} | data | options
    )
    return compare_with_oracle(
        estimator, (pair.simulator, pair.target), pair.policy, **given
    )


def test_the_model_is_efficient_and_its_figures_are_those_of_its_values():
    found = compare(ModelBased(), n=3000, data_distribution=EVEN, repetitions=150)
    errors = found.values - RAGGED.truth
    assert (found.unit, found.truth) == ("transitions", RAGGED.truth)
    assert found.limit == pytest.approx(RAGGED.truth, abs=1e-12)
    assert found.bound == oee.efficiency_bound(
        RAGGED.target, RAGGED.policy, EVEN, horizon=6
    )
    assert_allclose(found.bias, errors.mean(), atol=1e-12)
    assert_allclose(found.rmse**2, [np.mean(errors**2)])
    assert_allclose(found.rmse**2, found.bias**2 + found.variance * 149 / 150)
    assert abs(found.bias) < 4 * found.bias_error + 0.02
    assert abs(found.inefficiency - 1.0) < 4 * found.inefficiency_error
    assert 0.05 < found.inefficiency_error < 0.25


def test_importance_sampling_s_variance_is_the_exact_one():
    found = compare(ImportanceSampling(), repetitions=150)
    exact = oee.policy_is_moments(
        RAGGED.target, RAGGED.behavior, RAGGED.policy, horizon=6
    )
    assert abs(100 * found.variance - exact.variance) < 4 * 100 * found.variance_error
    assert found.bound == oee.trajectory_efficiency_bound(
        RAGGED.target, RAGGED.behavior, RAGGED.policy, horizon=6
    )
    assert found.inefficiency > 1.5
    assert abs(found.bias) < 4 * found.bias_error


def test_standard_errors_of_the_figures_are_right():
    """The spread of each figure over independent comparisons is the standard error that
    it comes with.
    """
    first = np.zeros((4, 2))
    first[0, 0] = 1.0

    def share(problem, policy):
        return float(np.mean(problem.log.next_state == 0))

    options = {"n": 50, "data_distribution": first, "repetitions": 60, "horizon": 3}
    runs = [compare(share, **options, seed=seed) for seed in range(25)]
    for name in ("bias", "variance", "rmse"):
        spread = np.std([getattr(run, name) for run in runs], ddof=1)
        claimed = np.mean([getattr(run, f"{name}_error") for run in runs])
        assert 0.5 < spread / claimed < 1.7, name


def test_the_table_says_it_all():
    found = compare(Simulator())
    for words in (
        "Simulator(): 3 logs of 100 episodes",
        "J_target",
        "10.07",
        "efficiency bound (n * variance)",
    ):
        assert words in str(found)
    assert found.variance == found.rmse_error == 0.0


def test_any_callable_without_a_limit_and_logs_without_a_value():
    def half(problem, policy, *, seed=None):
        return (
            oee.Estimate(1.0)
            if seed % 2
            else oee.Estimate(float("nan"), status="odd seeds only")
        )

    found = compare(half, repetitions=5)
    assert found.limit is None
    assert (len(found.values), found.failures) == (2, 3)
    assert str(found).startswith("half: 2 logs")
    assert "without a value: 3 more logs (odd seeds only)" in str(found)
    nothing = compare(
        lambda problem, policy: oee.Estimate(float("nan"), status="never"),
        repetitions=2,
    )
    assert np.all(
        np.isnan(
            [
                nothing.bias,
                nothing.bias_error,
                nothing.rmse,
                nothing.rmse_error,
                nothing.variance_error,
            ]
        )
    )
    assert "nan" in str(nothing)


def test_where_data_leave_something_out_the_bound_is_infinite():
    found = compare(OffEnvironment(), case("partial"))
    assert found.bound == np.inf
    assert np.isnan(found.inefficiency)
    endless = case("ragged infinite")
    found = compare(ImportanceSampling(), endless)
    assert np.isfinite(found.bound)
    assert found.limit == pytest.approx(endless.truth, rel=1e-9)


def test_the_same_seed_gives_the_same_bits():
    runs = [compare(ModelBased(), seed=seed).values for seed in (1, 1, 2)]
    assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])
