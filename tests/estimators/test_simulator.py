"""The simulator's own sampling error, by hand."""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.estimators import Simulator


def sampled(n):
    """State 0 led to state 1, which pays 1, in 3 of n samples, else to state 2; both stay."""
    to = [1] * 3 + [2] * (n - 3)
    log = oee.Transitions([0] * n + [1] * 20 + [2] * 20, [0] * (n + 40), [*to, *[1] * 20, *[2] * 20])
    return oee.FiniteMDP.from_log(log, [0.0, 1.0, 0.0], initial=0, discount=0.5)


@pytest.mark.parametrize("n", [5, 12])
def test_the_error_of_a_frequency_from_n_samples(n):
    """J = p / 2 over two steps: its variance is p (1 - p) / (n - 1) / 4; fewer than ten samples are few."""
    problem = oee.Problem(sampled(n), oee.Transitions([0], [0], [1]), horizon=2)
    found, p = Simulator()(problem, np.ones((3, 1))), 3 / n
    assert found.value == pytest.approx(p / 2)
    assert found.standard_error == pytest.approx(0.5 * np.sqrt(p * (1 - p) / (n - 1)))
    assert found.interval == pytest.approx([p / 2 + z * found.standard_error for z in (-1.96, 1.96)], abs=1e-4)
    assert [finding.kind for finding in found.findings] == ["few samples"] * (n == 5)
    assert not found.is_from_log
