"""--unrecorded and --interval-seconds: they are Python's, and what they refuse."""

import json

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.report import evaluation

DATA = "--simulator sim.npz --log log.csv"
POLICIES = "--policy a=a.npy --policy b=b.npy"


@pytest.fixture
def files(run):
    """A simulator, a log that lacks many pairs, and two policies; the problem."""
    run("export gridworld:4,slip=0.3 --output sim.npz")
    run(
        "sample gridworld:4,slip=0.1 --transitions 60 --output log.csv --policy mix:0.8"
    )
    simulator = oee.FiniteMDP.load("sim.npz")
    np.save("a.npy", oee.tasks.gridworld_policy(4, 0.9))
    np.save("b.npy", oee.uniform_policy(simulator))
    return oee.Problem(simulator, oee.Transitions.load("log.csv"))


@pytest.mark.parametrize("factor", ["1", "2.5", "inf"])
def test_the_factor_is_that_of_interval(run, files, factor):
    policy = np.load("a.npy")
    found = oee.interval(files, policy, unrecorded=float(factor))
    told = json.loads(
        run(f"evaluate {DATA} --policy a.npy --unrecorded {factor} --json")
    )
    row = next(row for row in told["results"] if row["estimator"] == "oee")
    assert (row["lower"], row["upper"]) == (found.lower, found.upper)
    assert (row["sampling_lower"], row["sampling_upper"]) == found.sampling
    assert (row["worst_case_lower"], row["worst_case_upper"]) == found.worst_case
    compared = json.loads(
        run(f"compare {DATA} {POLICIES} --unrecorded {factor} --json")
    )
    rows = {row["policy"]: row for row in compared["policies"]}
    assert (rows["a"]["lower"], rows["a"]["upper"]) == (found.lower, found.upper)


def test_a_large_problem_s_report_comes_before_its_intervals(run, files, monkeypatch):
    words = f"evaluate {DATA} --policy a.npy --estimators oee"
    whole = run(words)
    assert "likelihood intervals" not in whole
    monkeypatch.setattr(evaluation, "MIN_LARGE_TRANSITIONS", 1)
    out = run(words)
    first, second = out.split("With the likelihood intervals:")
    told = " ".join(first.split())
    assert (
        "The intervals' worst cases are left out: they are searched for next." in told
    )
    assert "if they can be anything" not in told
    answer = " ".join(whole.split("\n\n")[0].split())
    assert answer in " ".join(second.split())
    # what is written, and JSON, is the whole report
    kept = json.loads(run(words, "--json"))
    monkeypatch.setattr(evaluation, "MIN_LARGE_TRANSITIONS", 10**9)
    assert kept["results"] == json.loads(run(words, "--json"))["results"]
    monkeypatch.setattr(evaluation, "MIN_LARGE_TRANSITIONS", 1)
    compared = run(f"compare {DATA} {POLICIES}")
    assert compared.count("below the top row by") == 2


def test_a_search_that_was_stopped_is_said():
    """In a problem that is large enough for its search to be stopped."""
    simulator, target = (oee.tasks.gridworld(13, slip) for slip in (0.3, 0.1))
    policy = oee.tasks.gridworld_policy(13, 0.5)
    log = oee.sample_episodes(target, policy, 10, 40, seed=0)
    problem = oee.Problem(simulator, log)
    given = {"estimators": ["oee"], "interval_seconds": 1e-9}
    report = oee.evaluate(problem, policy, **given)
    assert "The search for the ends of the worst case was stopped after" in str(report)
    whole = oee.evaluate(problem, policy, estimators=["oee"])
    assert "stopped" not in str(whole)
    assert "inner bounds of the 95% interval" not in report.headline
    anything = oee.evaluate(problem, policy, unrecorded=np.inf, **given)
    assert "inner bounds of the 95% interval" in anything.headline
    narrow, wide = report.answers[0], whole.answers[0]
    assert (narrow.lower, narrow.upper) == (wide.lower, wide.upper)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("--unrecorded 0.5", "--unrecorded must be in [1, inf]; it is 0.5"),
        ("--unrecorded nan", "--unrecorded must be in [1, inf]; it is nan"),
        ("--unrecorded three", "--unrecorded must be a number from 1 to inf; it is"),
        ("--unrecorded ''", "--unrecorded must be a number from 1 to inf; it is ''"),
        (
            "--interval-seconds 0",
            "--interval-seconds must be a number of seconds above",
        ),
        ("--interval-seconds inf", "--interval-seconds must be a number of seconds"),
        ("--interval-seconds -1", "--interval-seconds must be a number of seconds"),
        ("--unrecorded inf --quick", "--quick must be left out with --unrecorded inf"),
        ("--interval-seconds 9 --quick", "--quick must be left out with --interval-"),
    ],
)
def test_what_is_refused(run, files, words, text):
    assert text in run(f"evaluate {DATA} --policy a.npy {words}", code=2)
    assert text in run(f"compare {DATA} {POLICIES} {words}", code=2)


def test_continuous_tasks_have_no_such_pairs(run):
    text = run(
        "evaluate --simulator cartpole:gravity=10 --log log.csv --unrecorded 3", code=2
    )
    assert "--unrecorded must be left out for a continuous task" in text


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"quick": True, "unrecorded": np.inf}, "quick must be False with unrecorded"),
        ({"quick": True, "interval_seconds": 2}, "quick must be False with interval_s"),
        ({"interval_seconds": 0}, "interval_seconds must be in"),
        ({"unrecorded": 0}, r"unrecorded must be in \[1, inf\]; it is 0"),
    ],
)
def test_what_python_refuses(given, text):
    pair = oee.testing.case("ragged")
    problem = pair.problem(50, seed=0)
    with pytest.raises(ValueError, match=f"^{text}"):
        oee.evaluate(problem, pair.policy, **given)
    with pytest.raises(ValueError, match=f"^{text}"):
        oee.report.contest(problem, {"a": pair.policy, "b": pair.behavior}, **given)


def test_an_interval_at_discount_1_needs_a_horizon():
    simulator = oee.FiniteMDP([[[0.5, 0.5]], [[0.0, 1.0]]], [-1.0, 0.0], 0, 1.0)
    problem = oee.Problem(simulator, oee.Transitions([0, 0], [0, 0], [0, 1]))
    with pytest.raises(ValueError, match=r"^horizon must be given at discount 1"):
        oee.interval(problem, [[1.0], [1.0]], unrecorded=2.0)


def test_a_policy_against_itself_and_a_log_of_one_transition(files):
    policy = np.load("a.npy")
    one = oee.Problem(files.simulator, oee.Transitions([0], [0], [1]))
    report = oee.report.contest(one, {"one": policy, "two": policy})
    assert report.best is None
    assert "“one” and “two” are worth the same in the target" in report.headline
    assert [row["probability_best"] for row in report.comparison()] in (
        [None, None],
        [0.5, 0.5],
    )
