"""What an estimate says: its words, its line, its shares of the policy's time, and its
seed.
"""

import functools

import numpy as np
import pytest
from estimators.four_states import BEHAVIOR, POLICY, environments, recorded_problem
from numpy.testing import assert_allclose
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions
from oee_tabular.estimators import (
    DoublyRobust,
    Estimate,
    ImportanceSampling,
    Magic,
    ModelBased,
    OffEnvironment,
    Oracle,
    Simulator,
)
from oee_tabular.estimators.calibrated import calibrate
from oee_tabular.estimators.errors import effective_sample_size, mean_and_error
from oee_tabular.estimators.names import named_estimators


def test_sizes_and_errors_of_small_samples():
    assert effective_sample_size(np.zeros(3)) == 0.0
    assert effective_sample_size(np.array([1.0, 3.0])) == 1.6
    assert mean_and_error(np.array([4.0])) == (4.0, None)
    assert mean_and_error(np.array([1.0, 3.0])) == (2.0, 1.0)
    # rounding is no variation
    assert mean_and_error(np.array([0.1 + 0.2, 0.3, 0.3]))[1] is None
    assert mean_and_error(np.array([1e-17, 0.0, -1e-17]), 1.0)[1] is None
    assert mean_and_error(np.array([1e-200, 2e-200]))[1] == pytest.approx(0.5e-200)


def test_nothing_to_learn_is_full_coverage():
    """The policy is over at once: its time is all where nothing can be learned."""
    mdp = FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [0, 1], 0.9)
    facts = OffEnvironment()(
        Problem(mdp, Transitions([0], [0], [1])), np.ones((2, 1))
    ).diagnostics
    assert (
        facts["coverage"],
        facts["unrecorded_share"],
        facts["effective_sample_size"],
    ) == (1.0, 0.0, 0.0)
    assert facts["unrecorded"] == ""


def test_without_a_horizon_at_discount_one():
    """Values where the policy is absorbed, as with a horizon that it seldom outlasts; a
    status where it is not.
    """
    simulator, target = environments(2, discount=1.0)
    problem = Problem(simulator, oee.sample_episodes(target, BEHAVIOR, 30, 50, seed=0))
    for estimator in (OffEnvironment(), ModelBased("simulator"), DoublyRobust()):
        found = estimator(problem, POLICY)
        long = estimator(Problem(simulator, problem.log, horizon=400), POLICY)
        assert_allclose(
            [found.value, found.standard_error],
            [long.value, long.standard_error],
            rtol=1e-6,
        )
        names = ["coverage", "effective_sample_size"]
        assert_allclose(
            *(
                [facts[name] for name in names]
                for facts in (found.diagnostics, long.diagnostics)
            ),
            rtol=1e-6,
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
    "simulator": None,
    "oracle": None,
    "oee": "log",
    "oee-product": "rollouts",
    "model-based": "log",
    "pdis": "log",
    "dr": "log",
    "dr-beta": "log",
    "dr-rollouts": "rollouts",
    "dr-episodes": "log",
    "magic": "log",
    "marginalized": None,
    "dualdice": None,
}


@pytest.mark.parametrize("name", SOURCES)
def test_what_a_standard_error_is_of_and_whose_interval_it_makes(name):
    problem, target = recorded_problem()
    estimate = named_estimators([name], target)[name](problem, POLICY, seed=0)
    facts = estimate.diagnostics
    assert estimate.status == "ok"
    assert facts.get("standard_error_of") == SOURCES[name]
    assert (estimate.standard_error is None) == (SOURCES[name] is None)
    ends = estimate.value + 1.959963984540054 * np.array([-1, 1]) * (
        estimate.standard_error or 0.0
    )
    assert (estimate.interval is not None) == (name == "oee")
    assert_allclose(estimate.interval or ends, ends, rtol=1e-12)
    assert (facts.get("n_rollouts", 100), facts.get("n_episodes", 30)) == (100, 30)
    assert 0 <= facts.get("gap", 0.0) < 1e-9
    assert 0 <= facts.get("error_bound", 0.0) < 1e-12


# ---- discount 1 without a horizon: policies that come to an end have visits,
# gradients, standard errors and a value that moves
def test_where_maximum_likelihood_never_ends_the_value_stays():
    """State 1 was seen to stay where it pays: its frequencies have no value, the
    default's has one.
    """
    rows = [[[0.0, 0.5, 0.5]], [[0.0, 0.5, 0.5]], [[0.0, 0.0, 1.0]]]
    simulator = oee.FiniteMDP(rows, [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], 1.0)
    problem = oee.Problem(simulator, oee.Transitions([0, 1, 1], [0, 0, 0], [1, 1, 1]))
    assert not np.isfinite(ModelBased("simulator")(problem, np.ones((3, 1))).value)
    found = OffEnvironment()(problem, np.ones((3, 1)))
    assert found.value == found.diagnostics["model_value"] > 2
    assert "maximum_likelihood_value" not in found.diagnostics
    assert found.interval[0] < found.value < found.interval[1]
    assert "at discount 1" in str(
        oee.evaluate(problem, {"a": [0, 0, 0], "b": [0, 0, 0]}, estimators="oee")
    )


# ---- calibrated values
def test_ratio_and_difference_by_hand():
    raw = Estimate(0.45, 0.02, diagnostics={"gap": 0.0})
    found = calibrate(raw, discretised=0.5, continuous=0.55, continuous_error=0.01)
    assert found.value == 0.45
    assert found.standard_error == 0.02
    assert found.diagnostics["gap"] == 0.0
    assert_allclose(found.diagnostics["calibrated_value"], 0.495)
    assert_allclose(
        found.diagnostics["calibrated_standard_error"],
        np.hypot(0.02 * 1.1, 0.45 / 0.5 * 0.01),
    )
    moved = calibrate(
        raw, discretised=-0.1, continuous=0.2, continuous_error=0.01, kind="difference"
    )
    assert_allclose(moved.diagnostics["calibrated_value"], 0.75)
    assert_allclose(
        moved.diagnostics["calibrated_standard_error"], np.hypot(0.02, 0.01)
    )
    assert (
        moved.diagnostics["calibration"]
        == "difference: plus 0.2 - -0.1 (simulator: continuous - discretised)"
    )
    assert "calibrated_value" not in raw.diagnostics


@pytest.mark.parametrize("kind", ["ratio", "difference"])
def test_an_estimate_of_the_simulator_itself_becomes_its_continuous_value(kind):
    found = calibrate(Estimate(3.0), discretised=3.0, continuous=2.5, kind=kind)
    assert found.diagnostics["calibrated_value"] == 2.5
    assert found.diagnostics["calibrated_standard_error"] is None


# ---- a standard error that the data do not identify is blank: never 0, and no interval
# of zero width stands on it
COIN = oee.FiniteMDP(np.full((2, 1, 2), 0.5), np.array([0.0, 1.0]), [1, 0], 0.9)
ONLY = np.ones((2, 1))
PLAIN = oee.ratio.Conditional(prior="none")


def log(next_state):
    """Episodes of one move from state 0."""
    n = len(next_state)
    return oee.Transitions(
        [0] * n,
        [0] * n,
        next_state,
        [0.0] * n,
        episode=np.arange(n),
        timestep=[0] * n,
        behavior_probability=[1.0] * n,
    )


SAME = {"one transition": log([1]), "a thousand equal moves": log([1] * 1000)}
ESTIMATORS = [
    OffEnvironment(PLAIN),
    OffEnvironment("joint"),
    ModelBased(),
    ModelBased(fallback="simulator"),
    ImportanceSampling(),
    ImportanceSampling(self_normalized=True),
    ImportanceSampling("trajectory", self_normalized=True),
    DoublyRobust(),
    DoublyRobust(data="episodes"),
    DoublyRobust(data="episodes", self_normalized=True),
    Magic(),
]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=str)
@pytest.mark.parametrize("name", SAME)
def test_what_does_not_vary_has_no_error(estimator, name):
    found = estimator(
        oee.Problem(COIN, SAME[name], horizon=1 if "kind" in repr(estimator) else 3),
        ONLY,
        seed=0,
    )
    # the latter of rows never visited
    assert found.standard_error is None or found.standard_error > 0.01
    assert found.interval is None or found.interval[1] - found.interval[0] > 0.01


@pytest.mark.parametrize("method", ["delta", "bootstrap"])
def test_no_interval_without_variation(method):
    for same in SAME.values():
        found = oee.interval(
            oee.Problem(COIN, same, horizon=2), ONLY, method=method, seed=0
        )
        assert np.isnan(
            [found.lower, found.upper, found.diagnostics["standard_error"]]
        ).all()
        assert "the log's transitions that affect the value never vary" in found.status
    varied = oee.interval(
        oee.Problem(COIN, log([0, 1] * 20), horizon=2), ONLY, method=method, seed=0
    )
    assert (varied.status, varied.width > 0.1) == ("ok", True)


def test_where_nothing_can_vary_the_error_is_0():
    """One next state everywhere in the simulator: that is knowledge, not silence."""
    certain = oee.FiniteMDP(
        np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.array([0.0, 1.0]), [1, 0], 0.9
    )
    problem = oee.Problem(certain, oee.Transitions([0, 1], [0, 0], [1, 1]))
    assert ModelBased()(problem, ONLY).standard_error == 0.0
    assert oee.interval(problem, ONLY, method="delta").width == 0.0


def sampled_simulator(n):
    """State 0 led to state 1, which pays 1, in 3 of n samples, else to state 2; both
    stay.
    """
    to = [1] * 3 + [2] * (n - 3)
    log = oee.Transitions(
        [0] * n + [1] * 20 + [2] * 20, [0] * (n + 40), [*to, *[1] * 20, *[2] * 20]
    )
    return oee.FiniteMDP.from_log(log, [0.0, 1.0, 0.0], initial=0, discount=0.5)


@pytest.mark.parametrize("n", [5, 12])
def test_the_error_of_a_frequency_from_n_samples(n):
    """J = p / 2 over two steps: its variance is p (1 - p) / (n - 1) / 4; fewer than ten
    samples are few.
    """
    problem = oee.Problem(
        sampled_simulator(n), oee.Transitions([0], [0], [1]), horizon=2
    )
    found = Simulator()(problem, np.ones((3, 1)))
    p = 3 / n
    assert found.value == pytest.approx(p / 2)
    assert found.standard_error == pytest.approx(0.5 * np.sqrt(p * (1 - p) / (n - 1)))
    assert found.interval == pytest.approx(
        [p / 2 + z * found.standard_error for z in (-1.96, 1.96)], abs=1e-4
    )
    assert [finding.kind for finding in found.findings] == ["few samples"] * (n == 5)
    assert not found.is_from_log


# ---- the value between the centre's and the log's: where it stops, its standard error,
# its interval, and what they say
def pair(seed, n_states=6, size=0.5):
    """Rows of five successors; the target's are moved down along V by ``size``."""
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.full(n_states, 2.0), (n_states, 2))
    simulator = oee.FiniteMDP(
        rows, rng.normal(size=(n_states, 2)), np.full(n_states, 1 / n_states), 0.9
    )
    policy = rng.dirichlet(np.ones(2), n_states)
    level = oee.state_values(simulator, policy)
    raw = rows * np.exp(-size * (level - level.mean()) / level.std())
    return (
        simulator,
        simulator.with_transitions(raw / raw.sum(axis=2, keepdims=True)),
        policy,
    )


def estimated(seed, size, per_row):
    simulator, target, policy = pair(seed, size=size)
    problem = oee.Problem(
        simulator,
        oee.sample_transitions(
            target, np.full((6, 2), 1 / 12), 12 * per_row, seed=seed
        ),
    )
    ratio = functools.partial(oee.transition_ratio, prior="simulator", strength=30.0)
    return OffEnvironment(ratio)(problem, policy)


def test_a_value_that_rests_on_the_prior_against_the_log_says_so():
    """More than two standard errors of their difference from maximum likelihood's
    value, in words with that value.
    """
    told = []
    for seed in range(30):
        facts = (estimate := estimated(seed, 1.5, 1 + seed % 4)).diagnostics
        error = (
            facts["one_step_standard_error"] ** 2
            - facts["unrecorded_standard_error"] ** 2
        )
        apart = np.sqrt(error - facts["standard_error_if_centre_fits"] ** 2)
        distance = abs(estimate.value - facts["maximum_likelihood_value"]) / apart
        words = [
            str(finding) for finding in estimate.findings if finding.kind == "against"
        ]
        assert len(words) == (distance > 2)
        if words:
            assert (
                f"gives {facts['maximum_likelihood_value']:.4g}, {distance:.1f}"
                " standard errors" in words[0]
            )
        told += words
    assert told


def test_a_change_beyond_two_standard_errors_goes_on_to_maximum_likelihood():
    """To the nearer, the one-step value, up to two; from four on to the other, but no
    further than twice the nearer.
    """
    simulator = oee.tasks.gridworld(4, 0.1)
    target = oee.tasks.gridworld(4, 0.3)
    log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 600, seed=0)
    nearer = []
    for strength in (3.0, 10.0, 30.0):
        ratio = oee.ratio.Conditional(prior="simulator", strength=strength)
        facts = OffEnvironment(ratio)(
            oee.Problem(simulator, log), oee.tasks.gridworld_policy(4, 0.9)
        ).diagnostics
        first, second = (
            facts[f"{name}_value"] - facts["model_value"]
            for name in ("one_step", "maximum_likelihood")
        )
        error = (
            facts["one_step_standard_error"] ** 2
            - facts["unrecorded_standard_error"] ** 2
        )
        apart = np.sqrt(error - facts["standard_error_if_centre_fits"] ** 2)
        nearer.append(abs(first) / apart)
        change = first + np.clip((nearer[-1] - 2) / 2, 0, 1) * (second - first)
        change = max(change, 2 * first)  # both are negative
        assert_allclose(facts["one_step_distance"], abs(change) / apart, rtol=1e-6)
    assert second < first < 0
    assert 2 < nearer[0] < nearer[1] < 4 < nearer[2]


def test_without_noise_nothing_is_moved():
    """Rows with one successor: no change, no error."""
    simulator = oee.FiniteMDP(
        sparse.csr_array([[0.0, 1.0], [0.0, 1.0]]), [1.0, 0.0], [1.0, 0.0], 0.9
    )
    found = OffEnvironment()(
        oee.Problem(simulator, oee.Transitions([0, 1], [0, 0], [1, 1])), np.ones((2, 1))
    )
    assert (found.value, found.standard_error, found.interval) == (1.0, 0.0, (1.0, 1.0))
    assert found.diagnostics["moved"] == 0.0
    assert found.diagnostics["one_step_distance"] == 0.0
