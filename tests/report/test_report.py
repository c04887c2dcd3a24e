import json
import math

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import _files
from oee_tabular.estimators import Estimate, OffEnvironment, Problem
from oee_tabular.estimators.findings import NEVER_VARIED


@pytest.fixture(scope="module")
def problem():
    simulator, target = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)
    log = oee.sample_episodes(target, oee.uniform_policy(target), 30, 40, seed=0)
    return Problem(simulator, log, horizon=40)


@pytest.fixture(scope="module")
def policies():
    return {"cautious": oee.tasks.gridworld_policy(4, 0.2), "bold": oee.tasks.gridworld_policy(4, 0.9)}


def test_the_table_holds_every_policy_and_estimator(problem, policies):
    report = oee.evaluate(problem, policies, seed=0)
    assert list(report.table["estimator"].unique()) == ["simulator", "oee", "model-based", "pdis", "wpdis"]
    assert len(report.table) == 10
    oee_row = report.table.query("policy == 'bold' and estimator == 'oee'").iloc[0]
    estimate = OffEnvironment()(problem, policies["bold"])
    assert oee_row["value"] == estimate.value
    sure = oee.interval(problem, policies["bold"])
    assert (oee_row["lower"], oee_row["upper"], oee_row["interval_method"]) == (sure.lower, sure.upper, "likelihood")
    row = report.table.query("policy == 'bold' and estimator == 'pdis'").iloc[0]
    assert_allclose(row["upper"] - row["lower"], 2 * 1.959963984540054 * row["standard_error"], rtol=1e-12)
    assert row["interval_method"] == "standard error"


def test_text_names_unit_truth_and_errors(problem, policies):
    target = oee.tasks.gridworld(4, 0.1)
    report = oee.evaluate(problem, policies, seed=0, normalized=True, target=target, confidence=0.9)
    text = str(report)
    assert "Value: (1 - discount) * sum of discount^t * reward over t = 0..39, discount 0.99" in text
    assert "90% interval" in text
    truth = oee.policy_value(target, policies["bold"], horizon=40, normalized=True)
    assert f"{truth:.6g}" in text
    row = report.table.query("policy == 'bold' and estimator == 'simulator'").iloc[0]
    assert_allclose(row["error"], row["value"] - truth, rtol=1e-12)


def test_the_same_seed_gives_the_same_report_whatever_else_is_asked_for(problem, policies):
    product = OffEnvironment(evaluation="monte_carlo")
    one = oee.evaluate(problem, policies, estimators={"a": product, "b": product}, seed=5)
    two = oee.evaluate(problem, policies, estimators={"a": product, "b": product}, seed=5)
    pd.testing.assert_frame_equal(one.table, two.table)
    values = one.table["value"].to_numpy()
    assert len(np.unique(values)) == 4
    alone = oee.evaluate(problem, policies, estimators={"a": product}, seed=5)
    assert alone.table["value"][0] == values[0]


def test_json_is_strict_and_complete(problem, policies):
    def broken(problem, policy, *, seed=None):
        return Estimate(math.nan, status="the sensor was off")

    report = oee.evaluate(problem, policies, estimators={"broken": broken, "oee": OffEnvironment()}, seed=1)
    loaded = json.loads(report.to_json(), parse_constant=lambda word: pytest.fail(word))
    assert loaded["results"][0]["value"] is None
    assert loaded["results"][0]["status"] == "the sensor was off"
    assert loaded["horizon"] == 40
    assert loaded["seed"] == 1
    assert any("no value: the sensor was off" in warning for warning in loaded["warnings"])


def test_warnings_say_what_the_numbers_do_not(problem):
    simulator, target = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)
    log = oee.sample_episodes(target, oee.tasks.gridworld_expert(4), 4, 30, seed=0)
    report = oee.evaluate(Problem(simulator, log, horizon=60), oee.uniform_policy(simulator), seed=0)
    text = "\n".join(report.warnings)
    assert "in this estimator's own model the policy spends " in text
    assert "oee (policy):" in text
    assert "the effective sample size is" in text
    assert report.notes["policy", "oee"]
    assert not report.notes["policy", "simulator"]
    bag = oee.evaluate(Problem(simulator, log.draw(10, seed=0)), oee.uniform_policy(simulator))
    assert "Importance sampling is left out: the log has no episodes." in bag.warnings
    columns = {name: column for name, column in log.columns().items() if name != "behavior_probability"}
    unknown = oee.evaluate(Problem(simulator, oee.Transitions(**columns)), oee.uniform_policy(simulator))
    assert "Importance sampling is left out: the behaviour policy is not known." in unknown.warnings


def test_reward_conflicts_are_told_with_the_remedy():
    simulator = oee.tasks.gridworld(3, 0.3)
    log = oee.Transitions([0], [0], [3], [9.0])
    for rewards, remedy in (
        ("simulator", 'rewards="log" (--rewards log) uses those of the log'),
        ("log", "use the log's mean"),
    ):
        report = oee.evaluate(Problem(simulator, log, rewards=rewards), oee.uniform_policy(simulator))
        assert "The log's rewards contradict the simulator's in 1 of 1 transitions" in report.warnings[1]
        assert remedy in report.warnings[1]


def test_saving_writes_all_or_nothing(problem, policies, tmp_path, monkeypatch):
    report = oee.evaluate(problem, policies, seed=0)
    written = report.save(tmp_path / "a" / "b")
    assert sorted(path.name for path in written) == ["report.json", "table.csv", "values.png"]
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == ["report.json", "table.csv", "values.png"]
    assert (tmp_path / "a" / "b" / "values.png").read_bytes().startswith(b"\x89PNG")
    again = oee.evaluate(problem, policies, seed=0).save(tmp_path / "c")
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in written]
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(ValueError, match=r"folder must be a folder that can be written; '.*file' is a file"):
        report.save(file / "below")

    calls = iter(range(9))

    def fail(number):
        if next(calls) == 1:  # the second file
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(_files.os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        report.save(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_policies_may_be_one_array_a_list_or_a_mapping(problem, policies):
    bold = policies["bold"]
    one = oee.evaluate(problem, bold, estimators="oee")
    several = oee.evaluate(problem, [bold, policies["cautious"]], estimators=["oee"])
    assert list(one.table["policy"]) == ["policy"]
    assert list(several.table["policy"]) == ["policy 0", "policy 1"]
    assert one.table["value"][0] == several.table["value"][0]


def test_a_user_s_own_estimator_and_names():
    simulator = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_episodes(simulator, oee.uniform_policy(simulator), 5, 20, seed=0)

    class Constant:
        def __call__(self, problem, policy, *, seed=None):
            return Estimate(1.5, 0.5)

    report = oee.evaluate(
        Problem(simulator, log), oee.uniform_policy(simulator), estimators=["oee", Constant(), Constant()]
    )
    assert list(report.table["estimator"]) == ["oee", "Constant", "Constant'"]
    assert report.results[1].estimate.interval == pytest.approx((0.52, 2.48), abs=1e-3)


def test_the_picture_holds_what_is_credible_and_marks_the_rest(problem, policies):
    from matplotlib.figure import Figure

    from oee_tabular import plots

    def wild(problem, policy, *, seed=None):
        return Estimate(-1e30, diagnostics={"row_sum_error": 3.0})

    target = oee.tasks.gridworld(4, 0.1)
    report = oee.evaluate(problem, policies, estimators={"oee": OffEnvironment(), "wild": wild}, target=target, seed=0)
    ax = Figure().subplots()
    plots.plot_values(report.records(), ax, unit=report.unit)
    low, high = ax.get_xlim()
    assert -100 < low < high < 10
    assert any("1e+30" in text.get_text() for text in ax.texts)
    lines = {label.get_text() for label in ax.get_yticklabels()}
    assert lines == {"cautious", "bold", "oee", "wild"}


def test_reward_conflicts_are_noted_on_every_value_that_a_model_gives():
    simulator = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_episodes(simulator, oee.uniform_policy(simulator), 20, 30, seed=0)
    paid = oee.Transitions(**(log.columns() | {"reward": log.reward + 1.0}))
    report = oee.evaluate(Problem(simulator, paid, horizon=20), oee.uniform_policy(simulator))
    assert [report.notes["policy", name][:1] for name in ("simulator", "oee", "model-based")] == [(1,)] * 3
    assert 1 not in report.notes["policy", "pdis"]
    assert json.loads(report.to_json())["results"][0]["notes"] == [1]
    settled = oee.evaluate(Problem(simulator, paid, horizon=20, rewards="log"), oee.uniform_policy(simulator))
    assert "use the log's mean" in settled.warnings[0]
    assert all(1 not in notes for notes in settled.notes.values())


def test_one_divergent_value_does_not_end_the_report():
    """At discount 1 the fallback of the model stays for ever where it pays; the others have values."""
    transitions = np.array([[[0.0, 0.5, 0.5]], [[0.5, 0.0, 0.5]], [[0.0, 0.0, 1.0]]])
    simulator = oee.FiniteMDP(transitions, [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], 1.0)
    log = oee.Transitions([0, 0], [0, 0], [1, 2], [1.0, 1.0])
    report = oee.evaluate(Problem(simulator, log), np.ones((3, 1)))
    values = dict(zip(report.table["estimator"], report.table["value"], strict=True))
    assert np.isfinite([values["simulator"], values["oee"]]).all()
    assert np.isnan(values["model-based"])
    text = "\n".join(report.warnings)
    assert "model-based (policy): no value: horizon must be given" in text
    assert "it stays for ever among states of which s=1 has reward 1 (1 such states in all)" in text
    named = oee.evaluate(Problem(simulator.with_names(["hall", "ramp", "dock"]), log), np.ones((3, 1)))
    assert "among states of which s=ramp has reward 1" in "\n".join(named.warnings)
    assert "oee (policy): in this estimator's own model the policy spends 33% of" in text  # of 2 steps 2 / 3 in state 1
    assert report.results[1].estimate.interval is not None


def test_what_to_record_next_is_said_once():
    simulator = oee.tasks.gridworld(3, 0.3)
    log = oee.Transitions([0], [0], [3])
    policies = {"a": oee.uniform_policy(simulator), "b": oee.tasks.gridworld_policy(3, 0.5)}
    text = str(oee.evaluate(Problem(simulator, log), policies, estimators="oee"))
    assert text.count("Record action ") == 1
    assert "Record first" not in text


def test_a_behaviour_policy_that_the_log_contradicts_is_told():
    simulator = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_episodes(simulator, oee.tasks.gridworld_policy(3, 0.4), 10, 20, seed=0)
    problem = Problem(simulator, log, behavior_policy=oee.uniform_policy(simulator))
    assert any(f"differ from behavior_policy in {len(log)} transitions" in text for text in oee.evaluate(
        problem, oee.uniform_policy(simulator)).warnings)  # fmt: skip


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda p: oee.evaluate(p.simulator, None), r"problem must be a Problem\(simulator, log, ...\); got FiniteMDP"),
        (
            lambda p: oee.evaluate(p, oee.uniform_policy(p.simulator), target=oee.tasks.gridworld(3, 0.1)),
            r"target must have the simulator's 16 states and 4 actions; it has 9 and 4",
        ),
        (lambda p: oee.transition_ratio(p.log, "sim.npz"), r"simulator must be a FiniteMDP; got str"),
    ],
)
def test_wrong_kinds_of_arguments(problem, call, text):
    with pytest.raises(ValueError, match=text):
        call(problem)


def test_of_one_policy_s_values_the_one_that_the_log_corrects_is_said_first_and_the_simulator_s_last(problem, policies):
    every = {
        "alone": Estimate(1.0, is_from_log=False),
        "other": Estimate(2.0),
        "lost": Estimate(math.nan, model_value=3.0),
        "corrected": Estimate(3.0, model_value=3.0),
    }

    def first(*names):
        chosen = {name: lambda problem, policy, *, seed=None, name=name: every[name] for name in names}
        return oee.evaluate(problem, policies["bold"], estimators=chosen).answers[0].estimator

    assert first(*every) == "corrected"
    assert first("alone", "other", "lost") == "other"
    assert first("alone", "lost") == "alone"


def test_an_estimator_s_own_interval_stays_and_what_explains_its_lack_is_not_said(problem, policies):
    def own(problem, policy, *, seed=None):
        return Estimate(1.0, 0.5, (0.0, 3.0), findings=(NEVER_VARIED,))

    report = oee.evaluate(problem, policies["bold"], estimators={"own": own}, confidence=0.99)
    assert report.results[0].estimate.interval == (0.0, 3.0)
    assert report.records()[0]["interval_method"] == "the estimator's own"
    assert report.warnings == ()
