"""The sentences that end a report: how far, how sure, what would help."""

import json

import numpy as np
import pytest

import oee_tabular as oee

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3, discount=0.9), oee.tasks.gridworld(4, 0.1, discount=0.9)
POLICY = {"mine": oee.tasks.gridworld_policy(4, 0.5)}


def report(recorded, n, share=None, **options):
    share = np.full((16, 4), 1 / 64) if share is None else share
    log = oee.sample_transitions(recorded, share, n, seed=0)
    return oee.evaluate(oee.Problem(SIMULATOR, log), POLICY, estimators=["oee"], seed=0, **options)


def test_much_data_of_another_environment():
    found = report(TARGET, 60_000, guaranteed=True, target=TARGET)
    far, sure, advice = found.uncertainty.sentences
    assert far == "The data reject the simulator in 60 of the 60 recorded state-action pairs."
    intervals = found.uncertainty.intervals["mine"]
    assert set(intervals) == {"likelihood", "robust"}
    assert found.truth["mine"] in intervals["likelihood"]
    assert intervals["robust"].lower < intervals["likelihood"].lower
    assert sure.startswith("mine: The interval that is guaranteed at any sample size is −")
    assert f"{sure}\n{advice}" in str(found)
    told = json.loads(found.to_json())
    assert told["conclusion"] == list(found.uncertainty.sentences)
    assert [row["method"] for row in told["intervals"]] == ["likelihood", "robust"]


def test_little_data_tells_by_all_moves_together():
    far = report(TARGET, 400).uncertainty.sentences[0]
    assert far.startswith("The data as a whole reject the simulator (z = ")
    assert far.endswith("Transitions that the simulator calls likely are more frequent in the target.")


def test_the_simulator_itself():
    assert (
        report(SIMULATOR, 2000).uncertainty.sentences[0].startswith("The data show no significant difference from the")
    )


def test_what_was_never_recorded_comes_first():
    share = np.full((16, 4), 1.0)
    share[0, 0] = 0.0
    found = report(TARGET, 5000, share / share.sum())
    assert found.uncertainty.sentences[2] == "Record action 0 in state 0 first (never recorded)."
    assert "allows the best and the worst in 1 unrecorded state-action pair (" in found.uncertainty.sentences[1]


def test_values_are_in_the_reports_unit():
    plain, scaled = report(TARGET, 3000), report(TARGET, 3000, normalized=True)
    row, small = (json.loads(found.to_json())["intervals"][0] for found in (plain, scaled))
    assert np.isclose(small["lower"], 0.1 * row["lower"])
    assert not any("guaranteed" in sentence for sentence in plain.uncertainty.sentences)


def test_a_certain_simulator_has_nothing_to_learn():
    chain = oee.FiniteMDP(np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.array([1.0, 0.0]), [1, 0], 0.9)
    problem = oee.Problem(chain, oee.Transitions([0], [0], [1]))
    sentences = oee.evaluate(problem, {"only": np.ones((2, 1))}, estimators=["oee"]).uncertainty.sentences
    assert "one possible next state in every recorded" in sentences[0]
    assert sentences[1] == "Record action 0 in state 0 first (1 transition so far; the model has one outcome)."
    over = oee.Problem(oee.FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 0.9), oee.Transitions([0], [0], [0]))
    assert (
        oee.evaluate(over, {"only": [0]}, estimators=["oee"]).uncertainty.next
        == "More transitions would not narrow it."
    )


def test_diagnostics_that_are_values_are_in_the_reports_unit():
    plain, scaled = report(TARGET, 400).records()[0], report(TARGET, 400, normalized=True).records()[0]
    for name in ("value", "standard_error", "lower", "one_step_value", "one_step_standard_error", "error_bound"):
        assert scaled[name] == pytest.approx(0.1 * plain[name], rel=1e-12), name
    for name in ("coverage", "largest_weight", "one_step_distance"):
        assert scaled[name] == plain[name], name


def test_where_there_are_no_likelihood_intervals_it_is_said(monkeypatch):
    """At discount 1 without a horizon, and of too many moves; guaranteed ones are refused there."""
    from oee_tabular.report import uncertainty

    log = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), 900, seed=0)
    endless = oee.Problem(SIMULATOR.with_discount(1.0), log)
    found = oee.evaluate(endless, POLICY, estimators=["oee"], seed=0)
    assert found.uncertainty.intervals == {}
    assert found.uncertainty.sentences[1] == "There are no likelihood intervals: at discount 1 they need a horizon."
    with pytest.raises(ValueError, match="guaranteed must be False here: at discount 1 they need a horizon"):
        oee.evaluate(endless, POLICY, estimators=["oee"], seed=0, guaranteed=True)
    monkeypatch.setattr(uncertainty, "MAX_TRANSITIONS", 10)
    text = report(TARGET, 400).uncertainty.sentences[1]
    assert text == "There are no likelihood intervals: 232 transitions can be reached, more than 10."


def test_quick_leaves_the_likelihood_intervals_out():
    pair = oee.testing.case("ragged")
    problem = pair.problem(300, seed=0)
    report = oee.evaluate(problem, pair.policy, estimators=["oee"], seed=0, quick=True)
    full = oee.evaluate(problem, pair.policy, estimators=["oee"], seed=0)
    assert report.uncertainty.intervals == {}
    assert "There are no likelihood intervals: quick=True (--quick) leaves them out." in report.uncertainty.distance
    assert report.uncertainty.distance[0] == full.uncertainty.distance[0]
    assert report.results[0].estimate.diagnostics["model_value"] == full.results[0].estimate.diagnostics["model_value"]
    with pytest.raises(ValueError, match="guaranteed must be False where quick is True"):
        oee.evaluate(problem, pair.policy, quick=True, guaranteed=True)
    with pytest.raises(ValueError, match="quick must be True or False; got 1"):
        oee.evaluate(problem, pair.policy, quick=1)
