"""How results print: units and normalisation are named, in a terminal and in a
notebook, and everything is escaped.
"""

import numpy as np
import pytest
from helpers import Page

import oee_tabular as oee
from oee_tabular.estimators import Estimate
from oee_tabular.inference import compare_policies
from oee_tabular.testing import check_estimator, compare_with_oracle

SIMULATOR = oee.tasks.gridworld(3, 0.3)
TARGET = oee.tasks.gridworld(3, 0.1)
LOG = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 30, 20, seed=0)
PROBLEM = oee.Problem(SIMULATOR, LOG, horizon=20)
POLICIES = {
    "<b>bold</b>": oee.tasks.gridworld_policy(3, 0.9),
    "mild & slow": oee.tasks.gridworld_policy(3, 0.1),
}
BOLD = POLICIES["<b>bold</b>"]

SUM = "discounted sum of rewards, not normalised"
RESULTS = {
    "report": (
        lambda: oee.evaluate(PROBLEM, POLICIES, target=TARGET),
        "sum of discount^t * reward over t = 0..19, discount 0.99",
    ),
    "normalised report": (
        lambda: oee.evaluate(PROBLEM, POLICIES, normalized=True),
        "(1 - discount) * sum of discount^t * reward over t = 0..19, discount 0.99",
    ),
    "estimate": (lambda: oee.estimators.OffEnvironment()(PROBLEM, BOLD), SUM),
    "evaluated estimate": (
        lambda: oee.evaluate(PROBLEM, BOLD, estimators="oee").results[0].estimate,
        SUM,
    ),
    "failed estimate": (lambda: Estimate(float("nan"), status="<lost>"), SUM),
    "interval": (lambda: oee.interval(PROBLEM, BOLD), SUM),
    "improvement": (lambda: oee.improve(PROBLEM, BOLD), SUM),
    "robust policy": (lambda: oee.robust_policy(SIMULATOR, 0.5, 2.0), SUM),
    "plan for a gain": (
        lambda: oee.plan_data_collection(PROBLEM, POLICIES, n=100, minus=BOLD),
        SUM,
    ),
    "no interval": (
        lambda: oee.interval(
            PROBLEM, BOLD, lower_ratio=0.999, upper_ratio=1.001, confidence=0.01
        ),
        SUM,
    ),
    "plan": (
        lambda: oee.plan_data_collection(PROBLEM, POLICIES, n=100, sampling="free"),
        SUM,
    ),
    "comparison": (lambda: compare_policies(PROBLEM, POLICIES), SUM),
    "oracle": (
        lambda: compare_with_oracle(
            oee.estimators.ModelBased(),
            (SIMULATOR, TARGET),
            BOLD,
            n=50,
            behavior_policy=BOLD,
            repetitions=5,
            horizon=5,
        ),
        SUM,
    ),
    "transition ratio": (lambda: oee.transition_ratio(LOG, SIMULATOR), "without unit"),
    "ratio": (lambda: oee.density_ratio([1.0, 2.0], [2.0, 1.0]), "without unit"),
    "MDP": (lambda: SIMULATOR, "rewards in units of the return"),
    "log": (lambda: LOG, "Transitions: a log"),
    "problem": (lambda: PROBLEM, "not normalised"),
    "moments": (lambda: oee.return_moments(TARGET, BOLD, horizon=5), "squared units"),
}


@pytest.mark.parametrize("name", RESULTS)
def test_in_a_notebook(name):
    make, unit = RESULTS[name]
    parsed = Page(make()._repr_html_())
    assert parsed.open == []
    seen = {tag for tag, _ in parsed.tags}
    assert seen <= {
        "div",
        "table",
        "caption",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
        "p",
        "pre",
    }
    assert unit in "".join(parsed.words)


def test_estimates_and_intervals_in_one_line():
    assert (
        str(Estimate(2.0, 0.25, (1.5, 2.5)))
        == "2 ± 0.25 (standard error), interval [1.5, 2.5]; discounted sum of"
        " rewards, not normalised"
    )
    assert str(Estimate(2.0, status="too few")).endswith("not normalised; too few")
    found = oee.inference.Interval(1.0, 2.0, 0.9, "delta")
    assert (
        str(found) == "[1.0, 2.0], 90% delta interval; discounted sum of rewards, not"
        " normalised"
    )
    lost = oee.inference.Interval(
        np.nan, np.nan, 0.9, "robust", status="the counts contradict the box"
    )
    assert str(lost) == "no 90% robust interval: the counts contradict the box"
    assert "KL(p || q) about" in str(oee.density_ratio([1.0, 2.0], [2.0, 1.0]))


def test_verdicts_print_in_a_notebook():
    def zero(problem, policy, *, seed=None):
        return Estimate(0.0)

    assert "laws" in check_estimator(zero, seed=0)._repr_html_().lower()
