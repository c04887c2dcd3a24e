"""What the user knows about the target: a box, a tie or features in evaluations and comparisons."""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.report import contest

SIMULATOR, TARGET = oee.tasks.gridworld(5, 0.3), oee.tasks.gridworld(5, 0.1)
POLICIES = {"mine": oee.tasks.gridworld_policy(5, 0.5), "uniform": oee.uniform_policy(SIMULATOR)}
LOG = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 4, 30, seed=0)
PROBLEM = oee.Problem(SIMULATOR, LOG, horizon=40)
BOX = {"lower_ratio": 0.3, "upper_ratio": 1.4}
KEYS = np.unique(np.round(SIMULATOR.transitions.data, 6), return_inverse=True)[1]


def test_a_box_narrows_intervals_and_comparison_and_leaves_values():
    plain, boxed = (oee.evaluate(PROBLEM, POLICIES, estimators="oee", **box).records() for box in ({}, BOX))
    for one, two in zip(plain, boxed, strict=True):
        assert one["value"] == two["value"]
        assert one["lower"] < two["lower"] <= two["value"] <= two["upper"] < one["upper"]
    (_, wide), (_, narrow) = (contest(PROBLEM, POLICIES, **box).comparison() for box in ({}, BOX))
    assert wide["less_by_lower"] < narrow["less_by_lower"] < narrow["less_by_upper"] < wide["less_by_upper"]
    assert contest(PROBLEM, POLICIES).best is None
    assert contest(PROBLEM, POLICIES, **BOX).best == "mine"


def test_the_interval_under_a_true_tie_is_narrow_and_holds_the_value():
    report = oee.evaluate(PROBLEM, {"mine": POLICIES["mine"]}, estimators=["oee"], tie=KEYS)
    plain, tied = report.records()
    assert (plain["estimator"], tied["estimator"]) == ("oee", "oee-tied")
    assert tied["interval_method"] == "likelihood under the tie"
    assert tied["upper"] - tied["lower"] < 0.2 * (plain["upper"] - plain["lower"])
    assert tied["lower"] < oee.policy_value(TARGET, POLICIES["mine"], horizon=40) < tied["upper"]
    assert "likelihood under the tie" in report.to_html()


def test_bad_assumptions():
    ask = {"estimators": "oee"}
    much = oee.Problem(SIMULATOR, oee.sample_episodes(TARGET, POLICIES["uniform"], 200, 100, seed=0), horizon=40)
    with pytest.raises(
        ValueError, match=r"must fit the log: .* contradict the box \[0.9, 1.05\] in \d+ state-action pair"
    ):
        oee.evaluate(much, POLICIES, lower_ratio=0.9, upper_ratio=1.05, **ask)
    with pytest.raises(ValueError, match="lower_ratio must be in"):
        oee.evaluate(PROBLEM, POLICIES, lower_ratio=1.2, **ask)
    with pytest.raises(ValueError, match="tie and features must not be given together"):
        oee.evaluate(PROBLEM, POLICIES, tie=KEYS, features=KEYS.astype(float), **ask)
    with pytest.raises(TypeError, match="unexpected keyword argument 'lower'"):
        oee.evaluate(PROBLEM, POLICIES, lower=0.5, **ask)
