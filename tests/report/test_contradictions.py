"""Many reports of random problems: no two things in one of them contradict each other."""

import itertools
import json
import re

import numpy as np
import pytest
from helpers import random_mdp, random_policy

import oee_tabular as oee
from oee_tabular.data import success_simulator

N_REPORTS = 240
N_PARTS = 6


def draw(rng):
    """A random problem, from a log of few transitions to one of many, and policies that
    are far apart or nearly the same.
    """
    simulator = random_mdp(rng)
    target = random_mdp(rng, like=simulator)
    shape = simulator.n_states, simulator.n_actions
    share = rng.dirichlet(np.ones(shape[0] * shape[1])).reshape(shape)
    if rng.random() < 0.5:
        share = np.where(rng.random(shape) < 0.3, 0.0, share)
        share[0, 0] += 0.1
    n = int(rng.choice([1, 5, 30, 200, 2000]))
    log = oee.sample_transitions(target, share / share.sum(), n, seed=rng)
    first = random_policy(rng, simulator)
    policies = {"a": first}
    for name in "bcd"[: rng.integers(1, 4)]:
        other = random_policy(rng, simulator)
        policies[name] = oee.mix(first, other, rng.choice([0.02, 0.3, 1.0]))
    if rng.random() < 0.2:
        policies["same"] = first.copy()
    horizon = None if rng.random() < 0.7 else int(rng.integers(1, 8))
    return oee.Problem(simulator, log, horizon=horizon), policies


def inside(value, lower, upper):
    slack = 1e-9 * max(1.0, abs(lower), abs(upper))
    return lower - slack <= value <= upper + slack


def check(report):
    """Everything that a reader can lay side by side."""
    rows = report.comparison()
    values = [row["value"] for row in rows]
    assert values == sorted(values, reverse=True)
    records = {row["policy"]: row for row in report.records()}
    for row in rows:
        beside = records[row["policy"]]
        for key in ("value", "lower", "upper"):
            assert row[key] == beside[key]
        assert inside(row["value"], row["lower"], row["upper"])
        if row["sampling_lower"] is not None:
            assert row["lower"] <= row["sampling_lower"] + 1e-9
            assert row["upper"] >= row["sampling_upper"] - 1e-9
    for row in rows[1:]:
        assert row["less_by"] == pytest.approx(values[0] - row["value"], abs=1e-9)
        if row["less_by_lower"] is not None:
            assert inside(row["less_by"], row["less_by_lower"], row["less_by_upper"])
        # intervals that are apart tell the policies apart
        if row["upper"] < rows[0]["lower"]:
            assert row["less_by_lower"] > 0.0
    chances = [row["probability_best"] for row in rows]
    if None not in chances:
        assert sum(chances) == pytest.approx(1.0)
        if len(rows) == 2:
            assert chances[0] >= 0.5
    best = report.best
    if best is not None:
        assert best == rows[0]["policy"]
        assert all(row["less_by_lower"] > 0.0 for row in rows[1:])
        assert chances[0] is None or chances[0] == max(chances)
        assert f"“{best}” is worth most in the target" in report.headline
    else:
        assert "is worth most in the target. It is better" not in report.headline
        open_ = [row for row in rows[1:] if not (row["less_by_lower"] or 0.0) > 0.0]
        assert open_
        assert None in chances or max(chances) <= report.confidence or equal(rows)
    told = json.loads(report.to_json())
    assert [row["policy"] for row in told["comparison"]] == [
        row["policy"] for row in rows
    ]
    assert told["best"] == best
    for row, kept in zip(rows, told["comparison"], strict=True):
        assert kept["value"] == row["value"]
        assert kept["probability_best"] == row["probability_best"]
    # the answer tells the values in the order of the table
    places = [report.answer.find(f"policy “{row['policy']}”") for row in rows]
    known = [place for place in places if place >= 0]
    assert known == sorted(known)


def equal(rows):
    return all(row["less_by"] <= 1e-12 * abs(rows[0]["value"]) for row in rows[1:])


@pytest.mark.parametrize("part", range(N_PARTS))
def test_no_report_contradicts_itself(part):
    for seed in range(part, N_REPORTS, N_PARTS):
        problem, policies = draw(np.random.default_rng([55, seed]))
        report = oee.report.contest(problem, policies)
        check(report)
        if seed % 25 == part % 25:
            whole = oee.evaluate(problem, policies, seed=0)
            check_same(report, whole)
            page = re.sub(r"<[^>]+>", " ", whole.to_html())
            assert " ".join(whole.headline.split()) in " ".join(page.split())


def check_same(report, other):
    """``contest`` and ``evaluate`` say the same of the policies."""
    for one, two in zip(report.comparison(), other.comparison(), strict=True):
        assert one == two
    assert report.headline == other.headline
    assert report.best == other.best


def test_no_two_policies_that_do_the_same_differ():
    """Also where they differ in states that neither reaches."""
    rows = np.zeros((4, 2, 4))
    rows[0, :, :2] = [[0.3, 0.7], [0.6, 0.4]]
    rows[1, :, :2] = 0.5
    rows[2:, :, 2:] = [[[0.5, 0.5], [0.2, 0.8]]] * 2
    simulator = oee.FiniteMDP(rows, [0.0, 1.0, 2.0, -3.0], 0, 0.9)
    log = oee.sample_transitions(simulator, np.full((4, 2), 1 / 8), 60, seed=0)
    one = np.array([[0.5, 0.5]] * 4)
    other = one.copy()
    other[2:] = [0.0, 1.0]
    report = oee.report.contest(
        oee.Problem(simulator, log), {"one": one, "other": other}
    )
    assert report.comparison()[1]["less_by"] == 0.0
    assert "worth the same" in report.headline
    for one, two in itertools.combinations(report.answers, 2):
        assert one.value == pytest.approx(two.value, rel=1e-6)


def walk(n, forward):
    """States in a row, one step forward or back; leaving the last one pays 1."""
    rows = np.zeros((n + 1, 1, n + 1))
    rows[np.arange(n), 0, np.arange(1, n + 1)] = forward
    rows[np.arange(n), 0, np.maximum(np.arange(n) - 1, 0)] += 1 - forward
    rows[n, 0, n] = 1.0
    pay = np.zeros_like(rows)
    pay[n - 1, 0, n] = 1.0
    return oee.FiniteMDP(rows, pay, n // 2, 0.98)


def test_a_difference_in_value_is_told_where_no_transition_shows_it():
    """Outcomes that the simulator calls equally likely: the test of all of them together
    sees nothing, and one state alone shows little.
    """
    told = []
    for seed in range(24):
        rng = np.random.default_rng([56, seed])
        n = int(rng.integers(8, 25))
        simulator = walk(n, 0.5)
        target = walk(n, rng.choice([0.5, 0.54, 0.58]))
        share = np.full((n + 1, 1), 1 / (n + 1))
        log = oee.sample_transitions(target, share, 600, seed=rng)
        policies = {"on": np.ones((n + 1, 1))}
        report = oee.evaluate(oee.Problem(simulator, log), policies, seed=0)
        sentence = report.uncertainty.distance[0]
        if "significant" not in sentence:
            continue
        found = report.uncertainty.likelihood["on"]
        value = oee.exact.policy_value(simulator, policies["on"])
        is_outside = not inside(value, found.lower, found.upper)
        words = "The simulator's value lies outside the interval of “on”"
        assert (words in sentence) == is_outside
        told.append(is_outside)
    assert 3 <= sum(told) < len(told) - 3


@pytest.mark.parametrize(
    ("successes", "is_apart"), [(9, True), (0, True), (11, True), (12, False)]
)
def test_trials_that_are_not_joined_may_contradict_the_log(successes, is_apart):
    """Without a horizon every walk arrives for certain, and trials that failed say that
    the target can do something else.
    """
    simulator = success_simulator(oee.tasks.gridworld(4, 0.3), 15)
    target = success_simulator(oee.tasks.gridworld(4, 0.1), 15)
    policy = oee.tasks.gridworld_expert(4)
    log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 300, seed=4)
    trials = oee.Trials.from_successes(successes, 12)
    report = oee.evaluate(
        oee.Problem(simulator, log, trials=trials), {"mine": policy}, seed=0
    )
    words = "contradict each other (their 95% intervals are apart)"
    assert (words in report.headline) == is_apart
    assert "worth about 1.0000 (95% interval: 1.0000 to 1.0000)" in report.headline


@pytest.mark.parametrize("seed", range(12))
def test_a_value_that_is_the_same_in_all_models_is_known(seed):
    """The same reward everywhere, or one of 1 at the only end: what is left is rounding."""
    rng = np.random.default_rng([57, seed])
    simulator = random_mdp(rng)
    shape = simulator.n_states, simulator.n_actions
    if seed % 2:
        rewards = np.full(shape, rng.normal())
        simulator = oee.FiniteMDP(
            simulator.transitions, rewards, simulator.initial, 0.9
        )
    else:
        n, k = shape
        rows = np.zeros((n + 1, k, n + 1))
        rows[:n, :, :n] = 0.9 * simulator.transitions.toarray().reshape(n, k, n)
        rows[:n, :, n] = 0.1
        rows[n, :, n] = 1.0
        pay = np.zeros_like(rows)
        pay[:n, :, n] = 1.0
        simulator = oee.FiniteMDP(rows, pay, 0, 1.0)
    policy = random_policy(rng, simulator)
    share = np.ones((simulator.n_states, simulator.n_actions))
    log = oee.sample_transitions(simulator, share / share.sum(), 60, seed=rng)
    estimate = oee.estimators.OffEnvironment()(oee.Problem(simulator, log), policy)
    assert estimate.standard_error == 0.0
    assert estimate.interval == (estimate.value, estimate.value)
    assert "against" not in {finding.kind for finding in estimate.findings}
