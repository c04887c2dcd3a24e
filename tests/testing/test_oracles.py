import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import ImportanceSampling, ModelBased, OffEnvironment, Simulator
from oee_tabular.testing import case, compare_with_oracle

RAGGED = case("ragged")
PAIR = RAGGED.simulator, RAGGED.target
EPISODES = {"n": 100, "behavior_policy": RAGGED.behavior, "horizon": 6, "repetitions": 150}


def even():
    moving = np.full((4, 2), 1 / 6)
    moving[3] = 0.0
    return moving


def test_the_model_is_efficient_and_its_figures_are_those_of_its_values():
    found = compare_with_oracle(
        ModelBased(), PAIR, RAGGED.policy, n=3000, data_distribution=even(), repetitions=150, horizon=6
    )
    values = found.values
    assert_allclose(found.truth, RAGGED.truth)
    assert found.limit == pytest.approx(RAGGED.truth, abs=1e-12)
    assert found.bound == oee.efficiency_bound(RAGGED.target, RAGGED.policy, even(), horizon=6)
    assert_allclose(found.bias, values.mean() - RAGGED.truth, atol=1e-12)
    assert_allclose(found.rmse**2, np.mean((values - RAGGED.truth) ** 2))
    assert_allclose(found.rmse**2, found.bias**2 + found.variance * 149 / 150)
    assert abs(found.bias) < 4 * found.bias_error + 0.02
    assert abs(found.inefficiency - 1.0) < 4 * found.inefficiency_error
    assert 0.05 < found.inefficiency_error < 0.25
    assert found.unit == "transitions"


def test_importance_sampling_s_variance_is_the_exact_one():
    found = compare_with_oracle(ImportanceSampling(), PAIR, RAGGED.policy, **EPISODES)
    exact = oee.policy_is_moments(RAGGED.target, RAGGED.behavior, RAGGED.policy, horizon=6)
    assert abs(100 * found.variance - exact.variance) < 4 * 100 * found.variance_error
    assert found.bound == oee.trajectory_efficiency_bound(RAGGED.target, RAGGED.behavior, RAGGED.policy, horizon=6)
    assert found.inefficiency > 1.5
    assert abs(found.bias) < 4 * found.bias_error


def test_standard_errors_of_the_figures_are_right():
    """The spread of each figure over independent comparisons is the standard error that it comes with."""
    first = np.zeros((4, 2))
    first[0, 0] = 1.0

    def share(problem, policy, *, seed=None):
        return oee.Estimate(float(np.mean(problem.log.next_state == 0)))

    options = {"n": 50, "data_distribution": first, "repetitions": 60, "horizon": 3}
    runs = [compare_with_oracle(share, PAIR, RAGGED.policy, **options, seed=seed) for seed in range(25)]
    for name in ("bias", "variance", "rmse"):
        spread = np.std([getattr(run, name) for run in runs], ddof=1)
        claimed = np.mean([getattr(run, f"{name}_error") for run in runs])
        assert 0.5 < spread / claimed < 1.7, name


def test_the_table_says_it_all():
    found = compare_with_oracle(Simulator(), PAIR, RAGGED.policy, **{**EPISODES, "repetitions": 3})
    lines = str(found).splitlines()
    assert lines[0] == "Simulator(): 3 logs of 100 episodes"
    assert [line[2:34].strip() for line in lines[1:]] == [
        "J_target", "limit", "bias", "variance", "root-mean-square error", "efficiency bound (n * variance)",
        "n * variance / bound",
    ]  # fmt: skip
    assert "10.07" in lines[1]
    assert found.variance == 0.0
    assert found.rmse_error == 0.0
    assert repr(found) == str(found)


def test_any_callable_without_a_limit_and_logs_without_a_value():
    def half(problem, policy, *, seed=None):
        return oee.Estimate(1.0) if seed % 2 else oee.Estimate(float("nan"), status="odd seeds only")

    found = compare_with_oracle(half, PAIR, RAGGED.policy, **{**EPISODES, "repetitions": 5})
    assert found.limit is None
    assert (len(found.values), found.failures) == (2, 3)
    assert "half: 2 logs" in str(found)
    assert "without a value: 3 more logs (odd seeds only)" in str(found)

    def never(problem, policy, *, seed=None):
        return oee.Estimate(float("nan"), status="never")

    nothing = compare_with_oracle(never, PAIR, RAGGED.policy, **{**EPISODES, "repetitions": 2})
    assert np.isnan(nothing.bias)
    assert np.isnan(nothing.rmse)
    assert "nan" in str(nothing)


def test_where_data_leave_something_out_the_bound_is_infinite():
    partial = case("partial")
    found = compare_with_oracle(
        OffEnvironment(), PAIR, partial.policy, n=200, behavior_policy=partial.behavior, horizon=5, repetitions=3
    )
    assert found.bound == np.inf
    assert np.isnan(found.inefficiency)
    endless = case("ragged infinite")
    pair = endless.simulator, endless.target
    found = compare_with_oracle(
        ImportanceSampling(), pair, endless.policy, n=50, behavior_policy=endless.behavior, repetitions=3
    )
    assert np.isfinite(found.bound)
    assert found.limit == pytest.approx(endless.truth, rel=1e-9)


def test_the_same_seed_gives_the_same_bits():
    options = {**EPISODES, "repetitions": 3}
    runs = [compare_with_oracle(ModelBased(), PAIR, RAGGED.policy, **options, seed=seed).values for seed in (1, 1, 2)]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


@pytest.mark.parametrize(("changes", "text"), [
    ({"behavior_policy": None}, "one of behavior_policy and data_distribution must be given"),
    ({"data_distribution": even()}, "one of behavior_policy and data_distribution must be given"),
    ({"repetitions": 1}, "repetitions must be at least 2; it is 1"),
    ({"n": 0}, "n must be a positive integer; it is 0"),
    ({"pair": (PAIR[0],)}, r"pair must be \(simulator, target\); it holds 1"),
    ({"estimator": lambda problem: 1.0}, r"estimator must be callable as .*; it takes \(problem\)"),
    ({"estimator": lambda problem, policy: (1.0, 2.0)}, "must return a float or an Estimate; it returned tuple"),
    ({"pair": 3}, r"pair must be \(simulator, target\); got int"),
    ({"pair": (PAIR[0], 3)}, "target must be a FiniteMDP; got int"),
    ({"pair": (PAIR[0], case("moves").target)}, "target and simulator must have the same states and actions"),
    ({"behavior_policy": None, "data_distribution": even() / 2}, "data_distribution must sum to 1 .*; it sums to 0.5"),
])  # fmt: skip
def test_bad_calls(changes, text):
    arguments = {"estimator": ModelBased(), "pair": PAIR, "policy": RAGGED.policy, **EPISODES} | changes
    with pytest.raises(ValueError, match=text):
        compare_with_oracle(**arguments)
