"""A standard error that the data do not identify is blank: never 0, and no interval of zero width stands on it."""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.estimators import DoublyRobust, ImportanceSampling, Magic, ModelBased, OffEnvironment, Simulator

COIN = oee.FiniteMDP(np.full((2, 1, 2), 0.5), np.array([0.0, 1.0]), [1, 0], 0.9)
ONLY = np.ones((2, 1))
PLAIN = oee.ratio.Conditional(prior="none")


def log(next_state):
    """Episodes of one move from state 0."""
    n = len(next_state)
    return oee.Transitions(
        [0] * n, [0] * n, next_state, [0.0] * n, episode=np.arange(n), timestep=[0] * n, behavior_probability=[1.0] * n
    )


SAME = {"one transition": log([1]), "a thousand equal moves": log([1] * 1000)}
ESTIMATORS = [
    OffEnvironment(PLAIN), OffEnvironment("joint"), ModelBased(), ModelBased(fallback="simulator"), ImportanceSampling(),
    ImportanceSampling(self_normalized=True), ImportanceSampling("trajectory", self_normalized=True), DoublyRobust(),
    DoublyRobust(data="episodes"), DoublyRobust(data="episodes", self_normalized=True), Magic(),
]  # fmt: skip


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
@pytest.mark.parametrize("name", SAME)
def test_what_does_not_vary_has_no_error(estimator, name):
    found = estimator(oee.Problem(COIN, SAME[name], horizon=1 if "kind" in repr(estimator) else 3), ONLY, seed=0)
    assert found.standard_error is None or found.standard_error > 0.01  # the latter of rows never visited
    assert found.interval is None or found.interval[1] - found.interval[0] > 0.01


@pytest.mark.parametrize("method", ["delta", "bootstrap"])
def test_no_interval_without_variation(method):
    for same in SAME.values():
        found = oee.interval(oee.Problem(COIN, same, horizon=2), ONLY, method=method, seed=0)
        assert np.isnan([found.lower, found.upper, found.diagnostics["standard_error"]]).all()
        assert "the log's transitions that affect the value never vary" in found.status
    varied = oee.interval(oee.Problem(COIN, log([0, 1] * 20), horizon=2), ONLY, method=method, seed=0)
    assert (varied.status, varied.width > 0.1) == ("ok", True)


def test_where_nothing_can_vary_the_error_is_0():
    """One next state everywhere in the simulator: that is knowledge, not silence."""
    certain = oee.FiniteMDP(np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.array([0.0, 1.0]), [1, 0], 0.9)
    problem = oee.Problem(certain, oee.Transitions([0, 1], [0, 0], [1, 1]))
    assert ModelBased()(problem, ONLY).standard_error == 0.0
    assert oee.interval(problem, ONLY, method="delta").width == 0.0


def sampled_simulator(n):
    """State 0 led to state 1, which pays 1, in 3 of n samples, else to state 2; both stay."""
    to = [1] * 3 + [2] * (n - 3)
    log = oee.Transitions([0] * n + [1] * 20 + [2] * 20, [0] * (n + 40), [*to, *[1] * 20, *[2] * 20])
    return oee.FiniteMDP.from_log(log, [0.0, 1.0, 0.0], initial=0, discount=0.5)


@pytest.mark.parametrize("n", [5, 12])
def test_the_error_of_a_frequency_from_n_samples(n):
    """J = p / 2 over two steps: its variance is p (1 - p) / (n - 1) / 4; fewer than ten samples are few."""
    problem = oee.Problem(sampled_simulator(n), oee.Transitions([0], [0], [1]), horizon=2)
    found, p = Simulator()(problem, np.ones((3, 1))), 3 / n
    assert found.value == pytest.approx(p / 2)
    assert found.standard_error == pytest.approx(0.5 * np.sqrt(p * (1 - p) / (n - 1)))
    assert found.interval == pytest.approx([p / 2 + z * found.standard_error for z in (-1.96, 1.96)], abs=1e-4)
    assert [finding.kind for finding in found.findings] == ["few samples"] * (n == 5)
    assert not found.is_from_log
