"""Differences of policies, rankings, and measures of selection."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee
from oee_tabular.inference import compare_policies, selection_measures

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3, discount=0.9), oee.tasks.gridworld(4, 0.1, discount=0.9)
POLICIES = {f"delta={d}": oee.tasks.gridworld_policy(4, d) for d in (0.4, 0.5, 0.9)}
SHARE = np.full((16, 4), 1 / 64)


def problem(n, seed):
    return oee.Problem(SIMULATOR, oee.sample_transitions(TARGET, SHARE, n, seed=seed))


def test_differences_are_surer_than_values():
    found = compare_policies(problem(2000, 0), POLICIES)
    assert found.names == ("delta=0.9", "delta=0.5", "delta=0.4")
    apart = np.sqrt(found.standard_errors[1] ** 2 + found.standard_errors[2] ** 2)
    width = (found.upper - found.lower)[1, 2] / (2 * stats.norm.ppf(0.975))
    assert width < 0.5 * apart
    assert_allclose(found.differences, -found.differences.T)
    assert_allclose(found.lower, -found.upper.T)
    assert_allclose(found.probability_best.sum(), 1.0)
    delta = oee.interval(problem(2000, 0), POLICIES["delta=0.5"], method="delta")
    assert_allclose(found.standard_errors[1], delta.diagnostics["standard_error"], rtol=1e-9)
    assert "delta=0.9" in str(found).splitlines()[1]
    resampled = compare_policies(problem(2000, 0), POLICIES, method="bootstrap", seed=1)
    assert_allclose(resampled.standard_errors, found.standard_errors, rtol=0.2)
    assert_allclose((resampled.upper - resampled.lower)[0, 1], (found.upper - found.lower)[0, 1], rtol=0.25)


def test_the_intervals_of_differences_cover():
    truth = oee.policy_value(TARGET, POLICIES["delta=0.5"]) - oee.policy_value(TARGET, POLICIES["delta=0.4"])
    inside = 0
    for seed in range(120):
        found = compare_policies(problem(3000, seed), POLICIES, n_draws=10)
        i, j = found.names.index("delta=0.5"), found.names.index("delta=0.4")
        inside += found.lower[i, j] <= truth <= found.upper[i, j]
    assert stats.binom.cdf(inside, 120, 0.95) > 0.001
    assert inside < 120


def test_the_same_seed_gives_the_same_ranking():
    one, two = (compare_policies(problem(500, 0), POLICIES, seed=3) for _ in range(2))
    assert (one.probability_best == two.probability_best).all()


def test_measures_of_selection():
    found = selection_measures([1.0, 2.0, 3.0, 4.0], [10.0, 30.0, 20.0, 0.0])
    assert_allclose(found.rank_correlation, -0.4)
    assert found.regret == 1.0
    assert selection_measures([1.0, 2.0, 3.0, 4.0], [10.0, 30.0, 20.0, 0.0], k=2).regret == pytest.approx(1 / 3)
    assert selection_measures([1, 2], [1, 2]) == selection_measures([1, 2], [1, 2])
    assert np.isnan(selection_measures([1.0, 1.0], [0.0, 1.0]).rank_correlation)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (
            lambda: compare_policies(problem(9, 0), {"one": POLICIES["delta=0.5"]}),
            "policies must be a mapping of at least two",
        ),
        (
            lambda: compare_policies(problem(9, 0), POLICIES, method="robust"),
            "method must be one of 'delta', 'bootstrap'",
        ),
        (lambda: compare_policies(problem(9, 0), POLICIES, confidence=0), r"confidence must be in \(0, 1\); it is 0"),
        (
            lambda: selection_measures([1], [1]),
            "estimates and truths must have one length of at least 2; they have 1 and 1",
        ),
        (lambda: selection_measures([1, np.nan], [1, 2]), r"estimates\[1\] must be finite; it is nan"),
        (lambda: selection_measures([1, 2], [1, 2], k=3), "k must be at most the number of policies, 2; it is 3"),
    ],
)
def test_bad_calls(call, text):
    with pytest.raises(ValueError, match=text):
        call()
