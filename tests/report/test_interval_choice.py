"""One interval beside each value wherever it stands, no value outside of it, and no ranking that the log cannot carry."""

import csv
import io
import json
import math
import re
from dataclasses import dataclass, field
from functools import partial
from statistics import NormalDist

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular import _printing
from oee_tabular.estimators import Estimate, ModelBased, OffEnvironment, Problem
from oee_tabular.report import uncertainty
from oee_tabular.report.text import format_interval, format_value

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3, discount=0.9), oee.tasks.gridworld(4, 0.1, discount=0.9)
MINE = oee.tasks.gridworld_policy(4, 0.5)


def even(n, seed=0, rows=16):
    """A problem whose log has moves of the first ``rows`` states, all actions alike."""
    share = np.zeros((16, 4))
    share[:rows] = 1 / (4 * rows)
    return Problem(SIMULATOR, oee.sample_transitions(TARGET, share, n, seed=seed))


@dataclass
class Corrected:
    """Stands for an estimator that corrects by the log: its value, its one-step value, an interval of its own."""

    value: float
    error: float = 0.1
    facts: dict = field(default_factory=dict)

    def __call__(self, problem, policy, *, seed=None):
        facts = {
            "one_step_standard_error": 0.2, "interval_method": "one-step",
            "model_value": self.value, "moved": 0.0, "coverage": 0.5, "row_sum_error": 0.0,
        }  # fmt: skip
        ends = (self.value - 1.96 * self.error, self.value + 1.96 * self.error)
        return Estimate(
            self.value, self.error, ends, facts | self.facts, model_value=self.value,
            is_normal=True, measured=0.5,
        )  # fmt: skip


def row_of(report, estimator="oee", policy=None):
    return next(row for row in report.records() if row["estimator"] == estimator and policy in (None, row["policy"]))


@settings(max_examples=40, deadline=None)
@given(rngs, st.integers(0, 60))
def test_every_value_stands_inside_its_interval(rng, n):
    simulator = random_mdp(rng)
    target = random_mdp(rng, like=simulator)
    policies = {name: random_policy(rng, simulator) for name in "ab"}
    log = oee.sample_episodes(target, random_policy(rng, simulator, zeros=0.0), 1 + n // 6, 6, seed=1)
    columns = {name: column for name, column in log.columns().items() if name != "terminated"}
    report = oee.evaluate(Problem(simulator, oee.Transitions(**columns)), policies, seed=0)
    for row in report.records():
        assert (row["lower"] is None) == (row["upper"] is None) == (row["interval_method"] is None)
        if row["lower"] is None:
            continue
        assert row["lower"] <= row["value"] <= row["upper"]
        assert row["interval_method"] != "standard error" or row["lower"] < row["upper"]
        if row["estimator"] == "model-based":
            assert row["coverage"] >= 0.9
    for answer in report.answers:
        assert answer.lower is None or answer.lower <= answer.value <= answer.upper


@settings(max_examples=300)
@given(st.floats(-1e12, 1e12), st.floats(1e-9, 1e6))
def test_ends_have_digits_until_their_width_shows(lower, width):
    upper = lower + width
    form = _printing.spec(lower, upper)
    shown = float(f"{upper:{form}}") - float(f"{lower:{form}}")
    if width > 1e-11 * max(abs(lower), abs(upper)):
        assert_allclose(shown, upper - lower, rtol=0.11)


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        ((-11023.4, -11022.9), "[-11023.40, -11022.90]"),
        ((0.1602, 0.2342), "[0.1602, 0.2342]"),
        ((-18.92, 4.857), "[-18.92, 4.86]"),
        ((3.0, 3.0), "[3.000, 3.000]"),
        ((0.0, 0.0), "[0, 0]"),
        ((1.5e20, 1.5003e20), "[1.50000e+20, 1.50030e+20]"),
        ((-math.inf, 2.0), "[-inf, 2]"),
    ],
)
def test_intervals_in_text(ends, text):
    assert _printing.interval(*ends) == text


def test_the_same_interval_stands_everywhere(tmp_path):
    """Whatever the row is called: table, CSV, JSON, the picture's records, the page and the answer."""
    problem = even(2000)
    report = oee.evaluate(problem, {"mine": MINE}, estimators={"corrected": OffEnvironment(), "model": ModelBased()})
    sure = oee.interval(problem, MINE)
    ends = (sure.lower, sure.upper)
    row = row_of(report, "corrected")
    assert (row["lower"], row["upper"], row["interval_method"]) == (*ends, "likelihood")
    assert report.results[0].estimate.interval == ends
    assert _printing.interval(*ends) in str(report)
    assert "95% interval of corrected (likelihood): " in str(report)
    assert "95% interval of model (standard error): " in str(report)
    report.save(tmp_path)
    told = json.loads((tmp_path / "report.json").read_text())["results"][0]
    assert (told["lower"], told["upper"], told["interval_method"]) == (*ends, "likelihood")
    kept = next(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text())))
    assert (float(kept["lower"]), float(kept["upper"]), kept["interval_method"]) == (*ends, "likelihood")
    (answer,) = report.answers
    assert (answer.lower, answer.upper, answer.method) == (*ends, "likelihood")
    page = report.to_html()
    assert format_interval(*ends) in page
    assert format_value(row["value"], *ends) in page


def test_where_there_is_no_likelihood_interval_the_estimators_own_stands_at_the_level_asked_for(monkeypatch):
    monkeypatch.setattr(uncertainty, "MAX_TRANSITIONS", 10)
    found = oee.evaluate(even(400), {"mine": MINE}, estimators={"oee": Corrected(2.0)})
    assert row_of(found)["interval_method"] == "one-step"
    assert_allclose([row_of(found)[end] for end in ("lower", "upper")], [1.804, 2.196])
    wide = row_of(oee.evaluate(even(400), {"mine": MINE}, estimators={"oee": Corrected(2.0)}, confidence=0.99))
    assert_allclose(wide["upper"] - 2.0, 0.196 * NormalDist().inv_cdf(0.995) / NormalDist().inv_cdf(0.975))
    assert "is worth about 2.000 (95% interval: 1.804 to 2.196)" in found.headline


@pytest.mark.parametrize("end", ["lower", "upper"])
def test_a_value_outside_gives_way_to_the_interval_s_nearer_end(end):
    problem = even(2000)
    sure = oee.interval(problem, MINE)
    far = sure.upper + 1.0 if end == "upper" else sure.lower - 1.0
    report = oee.evaluate(problem, {"mine": MINE}, estimators={"oee": Corrected(far)}, normalized=True)
    row = row_of(report)
    assert_allclose(
        [row["value"], row["lower"], row["upper"]], 0.1 * np.array([getattr(sure, end), sure.lower, sure.upper])
    )
    assert_allclose(row["replaced_value"], 0.1 * far)
    assert row["replaced_by"] == f"the interval's {end} end"
    assert_allclose(row["standard_error"], 0.01)
    shown = format(0.1 * far, _printing.spec(row["lower"], row["upper"]))
    told = [report.warnings[k - 1] for k in row["notes"]]
    expected = f"own value, {shown}, lies outside the interval. The table gives the interval's {end} end instead"
    assert any(expected in text for text in told)
    assert f"is worth about {format_value(row['value'], row['lower'], row['upper'])}" in report.to_html()


def test_a_value_inside_stays():
    problem = even(2000)
    sure = oee.interval(problem, MINE)
    inside = sure.lower + 0.3 * sure.width
    kept = row_of(oee.evaluate(problem, {"mine": MINE}, estimators={"oee": Corrected(inside)}))
    assert kept["value"] == inside
    assert "replaced_value" not in kept


def test_ratios_of_every_kind_have_the_interval_to_quote():
    """A tie, the joint ratio and a ratio that is given have no standard error; their rows sum to 1 all the same."""
    problem = even(2000)
    sure = oee.interval(problem, MINE)
    keys = np.arange(SIMULATOR.transitions.nnz) % 7
    kinds = {
        "tied": partial(oee.transition_ratio, method="tied", tie=keys),
        "joint": "joint",
        "given": oee.true_ratio(TARGET, SIMULATOR),
        "none": partial(oee.transition_ratio, prior="none"),
    }
    report = oee.evaluate(
        problem, {"mine": MINE}, estimators={name: OffEnvironment(kind) for name, kind in kinds.items()}
    )
    for name in kinds:
        row = row_of(report, name)
        assert (row["lower"], row["upper"], row["interval_method"]) == (sure.lower, sure.upper, "likelihood")
    assert row_of(report, "tied")["replaced_by"].startswith("the interval's ")
    product = OffEnvironment(evaluation="monte_carlo")
    other = oee.evaluate(
        problem, {"mine": MINE}, estimators={"product": product, "quotient": OffEnvironment("ratio_of_ratios")}
    )
    assert row_of(other, "product")["interval_method"] == "standard error"
    assert row_of(other, "quotient")["lower"] is None


def test_no_interval_of_a_model_that_the_log_covers_too_little():
    report = oee.evaluate(even(2000, rows=8), {"mine": MINE}, estimators=["model-based", "oee"])
    row = row_of(report, "model-based")
    assert row["coverage"] < 0.9
    assert row["standard_error"] > 0
    assert (row["lower"], row["upper"], row["interval_method"]) == (None, None, None)
    assert "The standard error ignores them. Above 10% there is no interval." in report.warnings[row["notes"][0] - 1]
    assert row_of(report)["lower"] is not None


def test_no_interval_where_the_variance_is_not_known():
    """Each (s, a) recorded once: the frequencies are all 0 or 1, their variance is 0."""
    pairs = np.repeat(np.arange(64), 3)
    log = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), 20_000, seed=0)
    first = [np.flatnonzero((log.state == s) & (log.action == a))[0] for s, a in (divmod(k, 4) for k in pairs[::3])]
    once = oee.Transitions(log.state[first], log.action[first], log.next_state[first])
    report = oee.evaluate(Problem(SIMULATOR, once), {"mine": MINE}, estimators=["model-based", "oee"])
    row = row_of(report, "model-based")
    assert row["coverage"] > 0.999
    assert row["single_share"] > 0.9
    assert row["lower"] is None
    told = [report.warnings[k - 1] for k in row["notes"]]
    assert any("recorded transition. Their variance is not known, so there is no interval." in text for text in told)
    assert row_of(report)["upper"] > row_of(report)["lower"]
    assert not row_of(oee.evaluate(even(20_000), MINE, estimators=["model-based"]), "model-based")["single_share"]


def test_a_standard_error_of_zero_makes_no_interval():
    def still(problem, policy, *, seed=None):
        return Estimate(1.0, 0.0)

    report = oee.evaluate(even(100), {"mine": MINE}, estimators={"still": still})
    row = row_of(report, "still")
    assert (row["lower"], row["standard_error"]) == (None, None)
    assert "there is no standard error and no interval, because what was recorded never varied" in report.warnings[0]


def test_policies_that_the_log_separates_are_ranked_and_others_are_not():
    good, bad = (oee.tasks.gridworld_policy(4, x) for x in (0.9, 0.4))
    report = oee.evaluate(even(4000), {"bad": bad, "good": good}, estimators=["oee"])
    compared = report.uncertainty.comparison
    text = "Of 2 policies, “good” is worth most in the target. It is better than “bad” by "
    assert report.uncertainty.ranking.startswith(text)
    assert report.uncertainty.ranking.endswith(").")  # intervals apart: no more to say
    assert f"(95%: {compared.lower[0, 1]:.3f} to {compared.upper[0, 1]:.3f})" in report.uncertainty.ranking
    assert " ".join(str(report).split()).startswith(report.uncertainty.ranking)
    assert report.uncertainty.ranking in report.to_html()
    tied = oee.evaluate(even(4000), {"bad": bad, "good": good, "same": good}, estimators=["oee"])
    assert tied.uncertainty.ranking == "“good” and “same” are worth the same in the target; the other 1 is worth less."
    assert tied.uncertainty.ranking in tied.to_html()
    assert "“good” is worth about" in tied.answer


def test_a_paired_comparison_ranks_where_intervals_overlap():
    policies = {f"delta={d}": oee.tasks.gridworld_policy(4, d) for d in (0.5, 0.4)}
    report = oee.evaluate(even(1000, 3), policies, estimators=["oee"])
    sure = [report.uncertainty.intervals[name]["likelihood"] for name in policies]
    assert sure[0].lower < sure[1].upper
    best, why = report.uncertainty.ranking.split(".5” is worth most in the target. It is better than “delta=0.4” by ")
    assert best == "Of 2 policies, “delta=0"
    assert why.endswith("known more precisely than either value because both rest on the same transitions.")


def ranking(problem, policies, *values):
    """What is said where estimators give the policies these values."""

    def own(problem, policy, *, seed=None):
        k = next(k for k, other in enumerate(policies.values()) if np.array_equal(policy, other))
        return Estimate(values[k], status="ok" if math.isfinite(values[k]) else "none")

    return oee.evaluate(problem, policies, estimators={"own": own}).uncertainty.ranking


def test_no_ranking_where_much_of_the_time_is_unrecorded_or_the_values_contradict_it():
    policies = {f"delta={d}": oee.tasks.gridworld_policy(4, d) for d in (0.9, 0.4)}
    near = {f"delta={d}": oee.tasks.gridworld_policy(4, d) for d in (0.9, 0.9001)}
    assert oee.evaluate(even(100), near, estimators=["oee"]).uncertainty.ranking.startswith(
        "The log cannot say which of "
    )
    half = oee.evaluate(even(20_000, rows=8), policies, estimators=["oee"])
    assert half.uncertainty.ranking.startswith("The log cannot say which of ")
    less = half.comparison()[1]
    assert less["less_by_lower"] < 0.0 < less["less_by_upper"]  # though their paired difference excludes 0
    assert ranking(even(100), policies, math.nan, math.nan) == ""
    assert ranking(even(20_000), policies, 2.0, 1.0).startswith("Of 2 policies, “delta=0.9”")
    assert ranking(even(20_000), policies, 1.0, 2.0).startswith("The log cannot say")


def test_sentences_without_information_are_gone():
    text = str(oee.evaluate(even(300), {"mine": MINE}, seed=0))
    assert not re.search("does not fit|counts the noise of the log|Record first", text)
