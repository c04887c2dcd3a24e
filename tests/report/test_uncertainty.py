"""One interval beside each value, no value outside of it, no ranking that the log
cannot carry, and the sentences on it.
"""

import csv
import io
import json
import math
import re
from decimal import Decimal
from fractions import Fraction
from functools import partial
from statistics import NormalDist

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.estimators import Estimate, ModelBased, OffEnvironment, Problem
from oee_tabular.estimators.findings import truncation
from oee_tabular.report import uncertainty
from oee_tabular.report.evaluation import group_findings
from oee_tabular.report.rows import Result
from oee_tabular.report.text import (
    distance_from_simulator,
    format_interval,
    format_value,
    legend,
)

SIMULATOR = oee.tasks.gridworld(4, 0.3, discount=0.9)
TARGET = oee.tasks.gridworld(4, 0.1, discount=0.9)
GOOD, MINE, BAD = (oee.tasks.gridworld_policy(4, delta) for delta in (0.9, 0.5, 0.4))


def even(n, seed=0, rows=16, recorded=TARGET):
    """A problem whose log has transitions of the first ``rows`` states, all actions
    alike.
    """
    share = np.repeat(np.arange(16) < rows, 4).reshape(16, 4) / (4.0 * rows)
    return Problem(SIMULATOR, oee.sample_transitions(recorded, share, n, seed=seed))


def sentences_of(problem, policy, **options):
    return oee.evaluate(
        problem, {"mine": policy}, estimators=["oee"], **options
    ).uncertainty.sentences


def sentences(problem, **options):
    return sentences_of(problem, MINE, **options)


def corrected(value):
    """An estimator that corrects by the log, with an interval of its own."""

    def estimator(problem, policy, *, seed=None):
        facts = {"interval_method": "one-step", "coverage": 0.5}
        ends = (value - 0.196, value + 0.196)
        return Estimate(
            value, 0.1, ends, facts, model_value=value, is_normal=True, measured=0.5
        )

    return {"oee": estimator}


def row_of(report, estimator="oee"):
    """The row of an estimator, and its notes."""
    row = next(row for row in report.records() if row["estimator"] == estimator)
    return row, [report.warnings[k - 1] for k in row["notes"]]


@settings(max_examples=40, deadline=None)
@given(rngs, st.integers(0, 60))
def test_every_value_stands_inside_its_interval(rng, n):
    simulator = random_mdp(rng)
    target = random_mdp(rng, like=simulator)
    policies = {name: random_policy(rng, simulator) for name in "ab"}
    log = oee.sample_episodes(
        target, random_policy(rng, simulator, zeros=0.0), 1 + n // 6, 6, seed=1
    )
    columns = {
        name: column for name, column in log.columns().items() if name != "terminated"
    }
    report = oee.evaluate(
        Problem(simulator, oee.Transitions(**columns)), policies, seed=0
    )
    for row in report.records():
        assert (
            (row["lower"] is None)
            == (row["upper"] is None)
            == (row["interval_method"] is None)
        )
        if row["lower"] is not None:
            assert row["lower"] <= row["value"] <= row["upper"]
            assert (
                row["interval_method"] != "standard error"
                or row["lower"] < row["upper"]
            )
            assert row["estimator"] != "model-based" or row["coverage"] >= 0.9
    for answer in report.answers:
        assert answer.lower is None or answer.lower <= answer.value <= answer.upper


def test_the_same_interval_stands_everywhere(tmp_path):
    """Whatever the row is called: table, CSV, JSON, the page and the answer."""
    problem = even(2000)
    report = oee.evaluate(
        problem,
        {"mine": MINE},
        estimators={"corrected": OffEnvironment(), "model": ModelBased()},
    )
    sure = oee.interval(problem, MINE)
    expected = (sure.lower, sure.upper, "likelihood")
    row, _ = row_of(report, "corrected")
    report.save(tmp_path)
    told = json.loads((tmp_path / "report.json").read_text())["results"][0]
    for one in (row, told):
        assert (one["lower"], one["upper"], one["interval_method"]) == expected
    kept = next(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text())))
    assert (
        float(kept["lower"]),
        float(kept["upper"]),
        kept["interval_method"],
    ) == expected
    (answer,) = report.answers
    assert (answer.lower, answer.upper, answer.method) == expected
    text = report.to_text(verbose=True)
    page = report.to_html()
    assert str(sure).split(", 95%")[0] in text
    assert "95% interval of corrected (likelihood): " in text
    assert "95% interval of model (standard error): " in text
    assert format_interval(*expected[:2]) in page
    assert format_value(row["value"], *expected[:2]) in page


def test_without_a_likelihood_interval_the_estimator_s_own_has_the_level_asked_for(
    monkeypatch,
):
    monkeypatch.setattr(uncertainty, "MAX_TRANSITIONS", 10)
    report = oee.evaluate(even(400), {"mine": MINE}, estimators=corrected(2.0))
    row, _ = row_of(report)
    assert row["interval_method"] == "one-step"
    assert_allclose([row["lower"], row["upper"]], [1.804, 2.196])
    wide, _ = row_of(
        oee.evaluate(
            even(400), {"mine": MINE}, estimators=corrected(2.0), confidence=0.99
        )
    )
    assert_allclose(
        wide["upper"] - 2.0,
        0.196 * NormalDist().inv_cdf(0.995) / NormalDist().inv_cdf(0.975),
    )
    assert "is worth about 2.00 (95% interval: 1.80 to 2.20)" in report.headline
    expected = (
        "There are no likelihood intervals: 232 transitions can be reached, more"
        " than 10."
    )
    assert report.uncertainty.sentences[1] == expected


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_value_outside_gives_way_to_the_interval_s_nearer_end(end):
    problem = even(2000)
    sure = oee.interval(problem, MINE)
    far = sure.upper + 1.0 if end == "upper" else sure.lower - 1.0
    report = oee.evaluate(
        problem, {"mine": MINE}, estimators=corrected(far), normalized=True
    )
    row, notes = row_of(report)
    numbers = [
        row[key]
        for key in ("value", "lower", "upper", "replaced_value", "standard_error")
    ]
    assert_allclose(
        numbers, 0.1 * np.array([getattr(sure, end), sure.lower, sure.upper, far, 0.1])
    )
    assert row["replaced_by"] == f"the interval's {end} end"
    expected = (
        r"own value, (\S+), lies outside the interval. The table gives the interval's"
        r" (\w+) end instead"
    )
    shown, place = re.search(expected, " ".join(notes)).groups()
    assert (float(shown), place) == (pytest.approx(0.1 * far, rel=1e-2), end)
    assert (
        f"is worth about {format_value(row['value'], row['lower'], row['upper'])}"
        in report.to_html()
    )
    inside = sure.lower + 0.3 * sure.width
    kept, _ = row_of(
        oee.evaluate(problem, {"mine": MINE}, estimators=corrected(inside))
    )
    assert kept["value"] == inside
    assert "replaced_value" not in kept


def test_ratios_of_every_kind_have_the_interval_to_quote():
    """A tie, the joint ratio and a ratio that is given have no standard error; their
    rows sum to 1 all the same.
    """
    problem = even(2000)
    sure = oee.interval(problem, MINE)
    kinds = {
        "tied": partial(
            oee.transition_ratio,
            method="tied",
            tie=np.arange(SIMULATOR.transitions.nnz) % 7,
        ),
        "joint": "joint",
        "given": oee.true_ratio(TARGET, SIMULATOR),
        "none": partial(oee.transition_ratio, prior="none"),
        "quotient": "ratio_of_ratios",
    }
    estimators = {name: OffEnvironment(kind) for name, kind in kinds.items()}
    estimators["product"] = OffEnvironment(evaluation="monte_carlo")
    report = oee.evaluate(problem, {"mine": MINE}, estimators=estimators)
    for name in ("tied", "joint", "given", "none"):
        row, _ = row_of(report, name)
        assert (row["lower"], row["upper"], row["interval_method"]) == (
            sure.lower,
            sure.upper,
            "likelihood",
        )
    assert row_of(report, "tied")[0]["replaced_by"].startswith("the interval's ")
    assert row_of(report, "product")[0]["interval_method"] == "rollouts"
    assert row_of(report, "quotient")[0]["lower"] is None


def test_no_interval_with_little_coverage_or_unknown_variance():
    report = oee.evaluate(
        even(2000, rows=8), {"mine": MINE}, estimators=["model-based", "oee"]
    )
    row, notes = row_of(report, "model-based")
    assert row["coverage"] < 0.9
    assert row["standard_error"] > 0
    assert (row["lower"], row["upper"], row["interval_method"]) == (None, None, None)
    assert "leaves them out, so it is too narrow. Above 10% there is none" in notes[0]
    assert row_of(report)[0]["lower"] is not None
    # each (s, a) recorded once: the frequencies are all 0 or 1, their variance is 0
    log = even(20_000).log
    _, first = np.unique(4 * log.state + log.action, return_index=True)
    once = oee.Transitions(log.state[first], log.action[first], log.next_state[first])
    report = oee.evaluate(
        Problem(SIMULATOR, once), {"mine": MINE}, estimators=["model-based", "oee"]
    )
    row, notes = row_of(report, "model-based")
    assert row["coverage"] > 0.999
    assert row["single_share"] > 0.9
    assert row["lower"] is None
    assert any(
        "recorded transition. Their variance is not known, so there is no interval."
        in text
        for text in notes
    )
    assert row_of(report)[0]["upper"] > row_of(report)[0]["lower"]
    many = oee.evaluate(even(20_000), MINE, estimators=["model-based"])
    assert not row_of(many, "model-based")[0]["single_share"]


def test_a_standard_error_of_zero_makes_no_interval():
    still = {"still": lambda problem, policy, *, seed=None: Estimate(1.0, 0.0)}
    row, notes = row_of(
        oee.evaluate(even(100), {"mine": MINE}, estimators=still), "still"
    )
    assert (row["lower"], row["standard_error"]) == (None, None)
    assert (
        "there is no standard error and no interval, because what was recorded never"
        " varied" in notes[0]
    )


def test_policies_that_the_log_separates_are_ranked_and_others_are_not():
    report = oee.evaluate(even(4000), {"bad": BAD, "good": GOOD}, estimators=["oee"])
    compared = report.uncertainty.comparison
    ranking = report.uncertainty.ranking
    assert ranking.startswith(
        "Of 2 policies, “good” is worth most in the target. It is better than “bad” by "
    )
    assert ranking.endswith(").")  # intervals apart: no more to say
    assert f"(95%: {compared.lower[0, 1]:.2f} to {compared.upper[0, 1]:.2f})" in ranking
    assert " ".join(str(report).split()).startswith(ranking)
    assert ranking in report.to_html()
    tied = oee.evaluate(
        even(4000), {"bad": BAD, "good": GOOD, "same": GOOD}, estimators=["oee"]
    )
    # both differences at once
    assert tied.uncertainty.comparison.confidence == pytest.approx(1 - 0.05 / 2)
    assert (
        tied.uncertainty.ranking
        == "“good” and “same” are worth the same in the target; the other 1 is worth"
        " less."
    )
    assert "“good” is worth about" in tied.answer


def test_a_paired_comparison_ranks_where_intervals_overlap():
    report = oee.evaluate(even(1000, 3), {"mine": MINE, "bad": BAD}, estimators=["oee"])
    mine, bad = report.answers
    assert mine.lower < bad.upper
    assert report.headline.startswith(
        "Of 2 policies, “mine” is worth most in the target. It is better than “bad” by "
    )
    assert report.headline.endswith(
        "more precisely than either value because both rest on the same transitions."
    )


def test_the_default_s_values_decide_whatever_stands_first():
    """An estimator of the user's own has its values; the ranking says whose it is."""
    policies = {"good": GOOD, "bad": BAD}

    def ranking(problem, *values):
        def own(problem, policy, *, seed=None):
            value = values[0] if np.array_equal(policy, GOOD) else values[1]
            return Estimate(value, status="ok" if math.isfinite(value) else "none")

        return oee.evaluate(
            problem, policies, estimators={"own": own}
        ).uncertainty.ranking

    near = {"good": GOOD, "near": oee.tasks.gridworld_policy(4, 0.9001)}
    report = oee.evaluate(even(100), near, estimators=["oee"])
    assert report.uncertainty.ranking.startswith("The log cannot say which of ")
    less = report.comparison()[1]
    assert less["less_by_lower"] < 0.0 < less["less_by_upper"]
    assert ranking(even(100), math.nan, math.nan) == ""
    first = "By off-environment evaluation (oee): Of 2 policies, “good”"
    assert ranking(even(20_000), 2.0, 1.0).startswith(first)
    assert ranking(even(20_000), 1.0, 2.0).startswith(first)


def test_where_much_is_unrecorded_the_ranking_rests_on_the_intervals_of_values():
    policies = {"good": GOOD, "bad": BAD}
    half = oee.evaluate(even(20_000, rows=8), policies, estimators=["oee"])
    assert half.uncertainty.ranking.startswith("Of 2 policies, “good” is worth most")
    assert half.headline.startswith("The log covers only ")
    good, bad = (half.uncertainty.likelihood[name] for name in ("good", "bad"))
    assert good.lower > bad.upper
    less = half.comparison()[1]
    assert less["less_by_lower"] == pytest.approx(good.lower - bad.upper)
    assert less["probability_best"] is None
    # where these pairs may do anything, the log cannot say
    anything = oee.evaluate(
        even(20_000, rows=8), policies, estimators=["oee"], unrecorded=math.inf
    )
    assert anything.uncertainty.ranking.startswith("The log cannot say which of ")
    less = anything.comparison()[1]
    assert less["less_by_lower"] < 0.0 < less["less_by_upper"]


def test_much_data_of_another_environment():
    found = oee.evaluate(
        even(60_000), {"mine": MINE}, estimators=["oee"], guaranteed=True, target=TARGET
    )
    far, sure, advice = found.uncertainty.sentences
    assert far.startswith("The target differs from the simulator: what")
    assert far.endswith(
        "Each of the 60 tested state-action pairs differs surely by itself."
    )
    intervals = found.uncertainty.intervals["mine"]
    assert set(intervals) == {"likelihood", "robust"}
    assert found.truth["mine"] in intervals["likelihood"]
    assert intervals["robust"].lower < intervals["likelihood"].lower
    assert sure.startswith(
        "mine: The interval that is guaranteed at any sample size is −"
    )
    # all of the correction comes from pairs that reject the simulator by themselves
    whole = found.results[0].estimate.model_value - oee.policy_value(SIMULATOR, MINE)
    assert distance_from_simulator(whole, whole, 0.0, 0.0) in sure
    assert f"{sure} {advice}" in " ".join(found.to_text(verbose=True).split())
    told = json.loads(found.to_json())
    assert told["conclusion"] == list(found.uncertainty.sentences)
    assert [row["method"] for row in told["intervals"]] == ["likelihood", "robust"]


def test_what_was_never_recorded_comes_first():
    share = np.full((16, 4), 1.0)
    share[0, 0] = 0.0
    log = oee.sample_transitions(TARGET, share / share.sum(), 5000, seed=0)
    problem = Problem(SIMULATOR, log)
    *_, advice = sentences(problem)
    assert advice == (
        "Record action down in cell (0, 0) first: it was never recorded, so what"
        " happens there is assumed and not measured."
    )
    answer = oee.evaluate(problem, {"mine": MINE}, estimators=["oee"]).headline
    assert "One state-action pair was never recorded, and the policy spends " in answer
    assert "within a factor of three of the estimated ones. If they are as" in answer


def test_values_are_in_the_reports_unit():
    plain, scaled = (
        oee.evaluate(even(400), {"mine": MINE}, estimators=["oee"], normalized=x)
        for x in (False, True)
    )
    row, small = (report.to_dict()["intervals"][0] for report in (plain, scaled))
    assert np.isclose(small["lower"], 0.1 * row["lower"])
    row = plain.records()[0]
    small = scaled.records()[0]
    for name in (
        "value",
        "standard_error",
        "lower",
        "one_step_value",
        "one_step_standard_error",
        "error_bound",
    ):
        assert small[name] == pytest.approx(0.1 * row[name], rel=1e-12), name
    for name in ("coverage", "largest_weight", "one_step_distance"):
        assert small[name] == row[name], name


@pytest.mark.parametrize("seed", range(3))
def test_the_test_of_all_transitions_together_by_hand(seed):
    """The score of a tilt along log P over its standard deviation under P."""
    rng = np.random.default_rng(seed)
    p = rng.dirichlet([1.0, 2.0, 4.0], size=12)
    simulator = oee.FiniteMDP(
        np.pad(p, ((0, 0), (0, 9))).reshape(12, 1, 12), np.ones(12), [1] + [0] * 11, 0.9
    )
    # each row a little flatter, which no single row shows
    flatter = p**0.75 / (p**0.75).sum(axis=1, keepdims=True)
    counts = np.array([rng.multinomial(40, row) for row in flatter])
    state, following = np.repeat(np.argwhere(counts + 1), (counts).ravel(), axis=0).T
    log = oee.Transitions(state, np.zeros_like(state), following)
    z = score = variance = 0.0
    for row, n in zip(p, counts, strict=True):
        phi = np.log(row) - row @ np.log(row)
        score += (n - n.sum() * row) @ phi
        variance += n.sum() * (row @ phi**2)
    z = score / math.sqrt(variance)
    assert abs(z) > 3.5
    said = sentences_of(Problem(simulator, log), np.zeros(12, dtype=int))[0]
    sign = "less" if z < 0 else "even more"
    assert f"happens {sign} often than it says (z = {z:.1f} standard" in said


def test_differences_are_in_the_reports_unit():
    policies = {"good": GOOD, "mine": MINE, "bad": BAD}
    plain, scaled = (
        oee.evaluate(even(400), policies, estimators=["oee"], normalized=x).comparison()
        for x in (False, True)
    )
    assert [row["policy"] for row in plain] == [row["policy"] for row in scaled]
    for row, small in zip(plain, scaled, strict=True):
        for name in ("value", "lower", "upper", "less_by", "less_by_lower"):
            if row[name] is None:
                assert small[name] is None
            else:
                assert small[name] == pytest.approx(0.1 * row[name], rel=1e-9), name
        assert row["probability_best"] == small["probability_best"]
    assert plain[1]["less_by_upper"] > plain[1]["less_by"]


def test_a_certain_simulator_has_nothing_to_learn():
    chain = oee.FiniteMDP(
        np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.array([1.0, 0.0]), [1, 0], 0.9
    )
    report = oee.evaluate(
        Problem(chain, oee.Transitions([0], [0], [1])),
        {"only": [0, 0]},
        estimators=["oee"],
    )
    far, advice = report.uncertainty.sentences
    assert "one possible next state in every recorded" in far
    assert (
        advice == "To test what the model is sure of, record action 0 in state"
        " 0 first (1 transition so far; the model has one outcome)."
    )
    over = Problem(
        oee.FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 0.9),
        oee.Transitions([0], [0], [0]),
    )
    found = oee.evaluate(over, {"only": [0]}, estimators=["oee"])
    assert found.uncertainty.next == "More transitions would not narrow it."


def test_missing_likelihood_intervals_are_reported():
    """At discount 1 without a horizon, and where ``quick`` leaves them out; guaranteed
    ones are refused there.
    """
    endless = Problem(SIMULATOR.with_discount(1.0), even(900).log)
    problem = even(300)
    reason = "at discount 1 they need a horizon"
    assert sentences(endless)[1] == f"There are no likelihood intervals: {reason}."
    quick, full = (
        oee.evaluate(problem, MINE, estimators=["oee"], quick=x) for x in (True, False)
    )
    assert quick.uncertainty.intervals == {}
    assert quick.uncertainty.distance == (
        full.uncertainty.distance[0],
        "There are no likelihood intervals: quick=True (--quick) leaves them out.",
    )
    assert quick.records()[0]["model_value"] == full.records()[0]["model_value"]


def test_legends_say_how_each_row_s_interval_was_made():
    """A search's ends are no value ± standard errors, and a widened interval no search's.

    The same estimator has both where only one policy reaches unrecorded pairs.
    """
    whole = oee.evaluate(even(900), MINE, estimators=["oee"])
    found = whole.uncertainty.likelihood["policy"]
    assert (found.lower, found.upper) == found.worst_case
    (searched,) = whole.legend(whole.records())
    assert searched == (
        "95% interval of oee (likelihood): every value that the log does not reject."
    )
    # state 0 has two actions: "known" is recorded in all it does, "new" is not
    simulator = oee.FiniteMDP(
        [[[0.5, 0.5], [0.4, 0.6]], [[0.0, 1.0], [0.0, 1.0]]], [[1.0] * 2, [0.0] * 2],
        [1.0, 0.0], 0.9,
    )  # fmt: skip
    log = oee.Transitions([0] * 40, [0] * 40, [0, 1] * 20)
    both = oee.evaluate(
        Problem(simulator, log),
        {"known": [0, 0], "new": [[0.9, 0.1], [1.0, 0.0]]},
        estimators=["oee"],
    )
    first, second = both.legend(both.records())
    assert first == searched.replace("oee", "oee of “known”")
    assert second.startswith("95% interval of oee of “new” (likelihood): oee's value ±")
    assert "widened by what state-action pairs" in second
    assert first in both.to_text(verbose=True).replace("\n", " ")
    page = both.to_html()
    for start in ("likelihood (oee of “known”)</dt><dd>Every value that the log",
                  "likelihood (oee of “new”)</dt><dd>Oee's value ± normal"):  # fmt: skip
        assert start in page.replace("&#39;", "'")
    as_estimated = oee.evaluate(
        Problem(simulator, log), {"new": [1, 0]}, estimators=["oee"], unrecorded=1.0
    )
    assert "behave as estimated" in as_estimated.legend(as_estimated.records())[0]


def test_legends_say_which_intervals_are_cut():
    """Near the largest value possible a normal quantile reaches beyond it."""
    simulator = oee.FiniteMDP(
        [[[0.8, 0.15, 0.05]], [[0.05, 0.85, 0.1]], [[0.0, 0.0, 1.0]]],
        [[1.0], [1.0], [0.0]],
        [1.0, 0.0, 0.0],
        0.9,
    )
    log = oee.Transitions([0] * 30, [0] * 30, [0] * 28 + [1, 2])
    for quick in (False, True):
        report = oee.evaluate(
            Problem(simulator, log), [0, 0, 0], estimators=["oee"], quick=quick
        )
        (row,) = report.records()
        assert_allclose(row["upper"], 10.0)
        assert report.legend([row])[0].endswith("that the rewards allow.")
    noisy = {"estimator": "mine", "interval_method": "standard error", "value": 1.0}
    for upper, is_cut in ((2.0, False), (1.5, True)):
        (told,) = report.legend([noisy | {"lower": 0.0, "upper": upper}])
        assert told.endswith("that the rewards allow.") == is_cut


def test_the_text_says_of_which_kind_the_answer_s_interval_is():
    problem = even(300)
    full = oee.evaluate(problem, MINE, confidence=0.9).to_text()
    assert "The answer's interval is a likelihood interval." in " ".join(full.split())
    quick = oee.evaluate(problem, MINE, confidence=0.9, quick=True).to_text()
    assert "The answer's interval is value ± 1.64 standard errors." in " ".join(
        quick.split()
    )
    two = oee.evaluate(problem, {"good": GOOD, "bad": BAD}).to_text()
    assert "The answer's intervals are likelihood intervals." in " ".join(two.split())


def test_a_box_that_the_log_contradicts():
    with pytest.raises(
        ValueError, match=r"must fit the log: .* contradict the box \[0.9, 1.05\]"
    ):
        sentences(even(20_000), lower_ratio=0.9, upper_ratio=1.05)


def test_an_interval_of_rollouts_says_that_it_is_their_error():
    found = uncertainty.choose_interval(
        Estimate(2.0, 0.1, diagnostics={"standard_error_of": "rollouts"}), None, 0.95
    )
    assert found.diagnostics["interval_method"] == "rollouts"
    told = legend("rollouts", ["simulator (continuous)"], 0.95)
    assert "Monte Carlo error of the rollouts" in told
    of_log = Estimate(2.0, 0.1, diagnostics={"standard_error_of": "log"})
    found = uncertainty.choose_interval(of_log, None, 0.95)
    assert found.diagnostics["interval_method"] == "standard error"


def test_a_note_on_truncated_episodes_has_no_bracket_in_a_bracket():
    """With the figures of several policies as well."""
    results = [
        Result(
            name,
            "pdis",
            Estimate(1.0, 0.1, findings=truncation(7, 12, bound, 1.0, 0.1)),
        )
        for name, bound in (("a", 82.7), ("b", 9.0))
    ]
    ((sentence, _),) = group_findings(results)
    assert sentence == (
        "pdis (a, b): 7 of 12 episodes were truncated. The missing rewards can change"
        " the discounted sum of rewards by up to 82.7 (a), 9 (b)."
    )


@pytest.mark.parametrize("names", [["oee"], ["simulator", "oee", "model-based"]])
def test_a_policy_made_from_the_log_has_a_warning(names):
    """It is optimal under the log's frequencies, the simulator's rows where there are
    none.
    """
    problem = even(300)
    counts = problem.log.counts(16, 4).toarray()
    n = counts.sum(axis=1, keepdims=True)
    rows = np.where(n > 0, counts / np.maximum(n, 1), SIMULATOR.transitions.toarray())
    chosen = oee.optimal_policy(SIMULATOR.with_transitions(rows.reshape(16, 4, 16)))
    policies = {
        "chosen": chosen,
        "optimal": oee.optimal_policy(SIMULATOR),
        "other": oee.uniform_policy(SIMULATOR),
    }
    report = oee.evaluate(problem, policies, estimators=names)
    (told,) = [text for text in report.warnings if "made from this log" in text]
    note = report.warnings.index(told) + 1
    rows = [row for row in report.records() if note in row["notes"]]
    assert {row["policy"] for row in rows} == {"chosen"}
    assert "simulator" not in {row["estimator"] for row in rows}
    # the log's own model is the simulator
    same = Problem(SIMULATOR, 1e6 * SIMULATOR.transitions)
    assert not any(
        "made from" in text
        for text in oee.evaluate(same, policies, estimators=names).warnings
    )


@pytest.mark.parametrize("value", [1.0 + 5e-10, -5e-10, 0.4])
def test_a_value_within_rounding_of_an_end_becomes_the_end(value):
    estimate = oee.Estimate(value, model_value=value)
    sure = oee.inference.Interval(0.0, 1.0, 0.95, "likelihood", {})
    found = uncertainty.choose_interval(estimate, sure, 0.95)
    assert found.value == value
    assert found.interval == (min(0.0, value), max(1.0, value))


@pytest.mark.parametrize("half", [Fraction(1, 2), Decimal("0.5"), np.float16(0.5)])
def test_what_is_known_is_kept_as_floats(half):
    known = uncertainty.Premises(
        lower_ratio=half, upper_ratio=2 * half + 1, unrecorded=4 * half
    )
    assert [known.lower_ratio, known.upper_ratio, known.unrecorded] == [0.5, 2.0, 2.0]
    assert {type(known.lower_ratio), type(known.upper_ratio)} == {float}
    assert str(known) == str(uncertainty.Premises(0.5, 2.0))
