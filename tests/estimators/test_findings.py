"""What is said of an estimate, from which size on, and which estimators say it."""

import math

import numpy as np
import pytest
from estimators.four_states import BEHAVIOR, POLICY, recorded_problem, reweighted_zeta

import oee_tabular as oee
from oee_tabular import Problem, Transitions
from oee_tabular.estimators import (
    DoublyRobust,
    Estimate,
    Finding,
    ImportanceSampling,
    Magic,
    Marginalized,
    ModelBased,
    OffEnvironment,
    Simulator,
    findings,
)


def of(value=10.0, error=0.1, **facts):
    return findings.from_diagnostics(facts, value, error)


# a size of which nothing is said, one of which something is, and how it is said
SILENT_UP_TO = {
    "unseen": (
        lambda x: of(unrecorded_share=x),
        0.02,
        0.03,
        "3% of the policy's discounted time is in state-action pairs that were never",
    ),
    "row sums": (
        lambda x: of(row_sum_error=x),
        1e-3,
        2e-3,
        "the rows of zeta * P miss 1 by up to 0.002; over a horizon",
    ),
    "starts": (
        findings.foreign_starts,
        0.0,
        0.01,
        "1% of the episodes start where the simulator never does. Importance",
    ),
    "gap": (
        lambda x: of(gap=x),
        1e-6,
        2e-6,
        "the ratio's program is solved only to a gap of 2.0e-06 nats.",
    ),
    "weights": (
        lambda n: of(effective_sample_size=-n, n_rollouts=400),
        -20.0,
        -19.9,
        "the effective sample size is 19.9 of 400 rollouts. The value is mostly chance",
    ),
    "few weights": (
        lambda n: of(effective_sample_size=-n, n_episodes=12),
        -10.0,
        -9.5,
        "is 9.5 of 12 episodes",
    ),
    "support": (
        lambda x: findings.missing_support(x, 2.0, 0.69),
        0.01,
        0.011,
        (
            "1.1% of the log's transitions have probability 0 in the plain simulator,"
            " so they have no ratio. Their estimates rest on the defensive share"
            " (largest zeta 2, D_inf 0.69 nats)."
        ),
    ),
    "linear algebra": (
        lambda x: of(error_bound=x),
        9e-6,
        2e-5,
        "the value is accurate only to 2.0e-05.",
    ),
    "small values": (
        lambda x: of(0.1, error_bound=x),
        1e-7,
        2e-7,
        "is accurate only to 2.0e-07.",
    ),
    "values that are small beside the rewards": (
        lambda x: findings.from_diagnostics({"error_bound": x}, 1e-9, None, 3.0),
        3e-6,
        4e-6,
        "is accurate only to 4.0e-06.",
    ),
    "truncation": (
        lambda x: findings.truncation(3, 8, x, 10.0, None),
        0.01,
        0.02,
        (
            "3 of 8 episodes were truncated. The "
            "missing rewards can change the discounted sum of rewards by up to 0.02."
        ),
    ),
    "truncation beside an error": (
        lambda x: findings.truncation(3, 8, x, 10.0, 1.0),
        0.1,
        0.2,
        "by up to 0.2",
    ),
    "behaviour": (
        findings.behavior_contradicts,
        0,
        7,
        "They differ from behavior_policy in 7 transitions.",
    ),
}


@pytest.mark.parametrize("name", SILENT_UP_TO)
def test_thresholds_of_warnings(name):
    make, small, large, text = SILENT_UP_TO[name]
    assert make(small) == ()
    (finding,) = make(large)
    assert text in str(finding)
    assert finding.alone is None
    worse = make(large * 2 if large > 0 else large / 2)[0]
    assert worse.severity > finding.severity or name == "behaviour"


def test_values_that_are_none():
    assert str(findings.no_value("it diverges", math.nan)) == "no value: it diverges."
    assert str(findings.no_value("it diverges", -math.inf)) == "no value: it diverges."
    assert (
        str(findings.no_value("take {care}", 1.0))
        == "do not rely on the value: take {care}."
    )
    assert "without bound at discount 1." in str(
        findings.truncation(1, 1, math.inf, 1.0, None)[0]
    )


def kinds(estimate):
    return [finding.kind for finding in estimate.findings]


def test_each_estimator_says_what_it_knows():
    problem, target = recorded_problem(n=30)
    crooked = reweighted_zeta(problem.simulator, target, 1.1)
    few = Problem(problem.simulator, Transitions([0, 1], [0, 1], [1, 2]))
    assert kinds(Simulator()(problem, POLICY)) == []
    assert kinds(OffEnvironment(crooked)(problem, POLICY)) == ["row sums"]
    assert kinds(
        OffEnvironment(crooked, "monte_carlo", n_rollouts=9)(problem, POLICY, seed=0)
    ) == [
        "row sums",
        "weights",
    ]
    assert kinds(OffEnvironment()(few, POLICY)) == ["coverage"]
    assert kinds(ModelBased()(few, POLICY)) == ["coverage", "single", "elsewhere"]
    assert (
        kinds(DoublyRobust()(few, POLICY))[0]
        == kinds(Marginalized()(few, POLICY))[0]
        == "coverage"
    )
    assert {"weights", "truncation"} <= set(
        kinds(ImportanceSampling()(recorded_problem(n=9)[0], POLICY))
    )
    assert kinds(Magic()(recorded_problem(n=9)[0], POLICY, seed=0))[0] == "weights"
    assert kinds(DoublyRobust(data="episodes")(recorded_problem(n=9)[0], POLICY)) == [
        "weights"
    ]


def test_what_a_report_acts_on():
    """Typed, beside the diagnostics: what is corrected by the log, what the log has not
    told, whose rewards are paid.
    """
    problem, _ = recorded_problem(n=8)
    found = OffEnvironment()(problem, POLICY)
    facts = found.diagnostics
    assert found.model_value == facts["model_value"]
    assert found.is_normal
    assert found.measured == facts["coverage"]
    model = ModelBased()(problem, POLICY)
    assert model.model_value is None
    assert model.measured == pytest.approx(
        model.diagnostics["coverage"] - model.diagnostics["single_share"]
    )
    few = DoublyRobust()(
        Problem(problem.simulator, Transitions([0, 1], [0, 1], [1, 2])), POLICY
    )
    assert few.measured == few.diagnostics["coverage"] < 0.99
    assert not Simulator()(problem, POLICY).is_from_log
    assert [
        e(problem, POLICY).is_from_episodes
        for e in (ImportanceSampling(), DoublyRobust(data="episodes"), Magic())
    ] == [True] * 3
    assert not any(
        e(problem, POLICY).is_from_episodes
        for e in (OffEnvironment(), ModelBased(), DoublyRobust(), Marginalized())
    )


def test_a_user_s_own_finding_is_reported():
    problem, _ = recorded_problem(n=30, horizon=4)

    def own(problem, policy, *, seed=None):
        return Estimate(
            1.0,
            0.5,
            findings=(
                Finding(
                    "units",
                    float(policy[0, 0]),
                    "rewards are in {}.",
                    f"cents{policy[0, 0]}",
                ),
            ),
        )

    report = oee.evaluate(
        problem, {"a": POLICY, "b": BEHAVIOR}, estimators={"own": own}
    )
    assert report.warnings == (
        "own (a, b): rewards are in cents0.5 (b), cents0.3 (a).",
    )
    assert report.notes["a", "own"] == report.notes["b", "own"] == (1,)
    assert np.isfinite(report.results[0].estimate.interval).all()
