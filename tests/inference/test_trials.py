"""Log and trials in one likelihood: limits, enumeration, contradiction, and words."""

import json
import math
import re

import numpy as np
import pytest
from benchmarks import trials as benchmark
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, special, stats

import oee_tabular as oee
from oee_tabular.data import success_simulator
from oee_tabular.exceptions import ArgumentError
from oee_tabular.inference import join_trials
from oee_tabular.inference import trials as joining

HALF_CHI = stats.chi2.ppf(0.95, 1) / 2


def coin(n_up, n_down):
    """One step from a coin: the value is the probability of state 1."""
    P = np.zeros((3, 1, 3))
    P[0, 0, 1:] = 0.5
    P[1, 0, 1] = P[2, 0, 2] = 1.0
    reach = success_simulator(oee.FiniteMDP(P, np.zeros(3), 0, 0.9), 1)
    counts = np.zeros((3, 3))
    counts[0] = 0, n_up, n_down
    from scipy import sparse

    return reach, sparse.csr_array(counts)


def joined(n_up, n_down, trials, **options):
    simulator, counts = coin(n_up, n_down)
    problem = oee.Problem(simulator, counts, horizon=1, trials=trials)
    return oee.interval(problem, [0, 0, 0], **options)


def set_of(height, grid):
    """The smallest and the largest point of a grid with l below its least + c."""
    inside = grid[height <= height.min() + HALF_CHI]
    return inside[0], inside[-1]


@settings(max_examples=8)
@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 12))
def test_on_two_states_the_set_is_that_of_an_enumeration(up, down, won):
    j = np.linspace(1e-7, 1 - 1e-7, 1_000_001)
    n = up + down
    height = n * (special.rel_entr(up / n, j) + special.rel_entr(down / n, 1 - j))
    height += 12 * (won / 12 - j) ** 2 / (2 * j * (1 - j))
    found = joined(up, down, oee.Trials.from_successes(won, 12))
    if found.diagnostics["contradiction_p_value"] >= 0.01:
        np.testing.assert_allclose(
            [found.lower, found.upper], set_of(height, j), atol=1e-5
        )


@pytest.mark.parametrize("won", [0, 4, 8, 12])
def test_the_test_of_a_contradiction_by_hand(won):
    """Twice the least of l is a chi-square of one degree of freedom."""
    j = np.linspace(1e-7, 1 - 1e-7, 200_001)
    height = 30 * (special.rel_entr(2 / 3, j) + special.rel_entr(1 / 3, 1 - j))
    height += 12 * (won / 12 - j) ** 2 / (2 * j * (1 - j))
    found = joined(20, 10, oee.Trials.from_successes(won, 12))
    p_value = found.diagnostics["contradiction_p_value"]
    assert p_value == pytest.approx(stats.chi2.sf(2 * height.min(), 1), rel=1e-3)


def test_few_trials_change_little_and_many_decide():
    log = joined(20, 10, None)
    assert log.method == "likelihood"
    few = joined(20, 10, oee.Trials.from_successes(2, 3))
    assert few.lower == pytest.approx(log.lower, abs=0.02)
    assert few.upper == pytest.approx(log.upper, abs=0.02)
    many = joined(20, 10, oee.Trials.from_successes(20_000, 30_000))
    assert many.width < 0.011


def test_without_trials_it_is_the_log():
    """A single trial of next to no weight is none."""
    simulator, counts = coin(20, 10)
    problem = oee.Problem(simulator, counts, horizon=1)
    alone = oee.interval(problem, [0, 0, 0])
    trials = oee.Trials([1.0, 0.0], weight=[1.0, 1.0])
    assert (
        oee.Problem(simulator, counts, horizon=1, trials=trials).without_trials.trials
        is None
    )
    both = oee.Problem(simulator, counts, horizon=1, trials=trials)
    assert oee.interval(both.without_trials, [0, 0, 0]) == alone


@pytest.mark.parametrize("level", [0.8, 0.95, 0.99])
def test_a_log_that_says_nothing_leaves_the_trials(level):
    """All data are of a pair that the policy does not use: Wilson's interval."""
    P = np.zeros((3, 2, 3))
    P[0, :, 1:] = 0.5
    P[1, :, 1] = P[2, :, 2] = 1.0
    simulator = success_simulator(oee.FiniteMDP(P, np.zeros(3), 0, 0.9), 1)
    log = oee.Transitions([0] * 8, [1] * 8, [1, 2] * 4)
    trials = oee.Trials.from_successes(9, 12)
    problem = oee.Problem(simulator, log, horizon=1, trials=trials)
    found = oee.interval(problem, [0, 0, 0], unrecorded=np.inf, confidence=level)
    assert found.diagnostics["log_lower"] == pytest.approx(0.0, abs=1e-9)
    assert found.diagnostics["log_upper"] == pytest.approx(1.0, abs=1e-9)
    wilson = stats.binomtest(9, 12).proportion_ci(level, "wilson")
    np.testing.assert_allclose([found.lower, found.upper], wilson, atol=1e-6)


def paid(rewards):
    """One step to state 1 or 2, which pays; two actions."""
    P = np.zeros((3, 2, 3))
    P[0, :, 1:] = 0.5
    P[1, :, 1] = P[2, :, 2] = 1.0
    r = np.zeros((3, 2, 3))
    r[0, :, 1:] = rewards
    return oee.FiniteMDP(P, r, 0, 0.9)


@pytest.mark.parametrize("level", [0.8, 0.95, 0.99])
def test_returns_without_a_log_have_students_interval(level):
    y = np.array([0.2, 0.5, -0.4, 0.1, 0.3])
    log = oee.Transitions([0] * 8, [1] * 8, [1, 2] * 4)
    problem = oee.Problem(paid([-40.0, 40.0]), log, horizon=1, trials=oee.Trials(y))
    found = oee.interval(problem, [0, 0, 0], unrecorded=np.inf, confidence=level)
    student = stats.t.interval(level, 4, y.mean(), y.std(ddof=1) / np.sqrt(5))
    np.testing.assert_allclose([found.lower, found.upper], student, atol=1e-5)


@settings(max_examples=5)
@given(st.integers(2, 20), st.integers(2, 20), st.integers(0, 1000))
def test_returns_by_enumeration(up, down, seed):
    y = np.random.default_rng(seed).choice([-1.0, 2.0], 7, p=[0.4, 0.6]) + 0.0
    if y.std() == 0.0:
        y[0] = 1.0 - y[0]
    p = np.linspace(1e-7, 1 - 1e-7, 1_000_001)
    j = -1.0 + 3.0 * p
    n = up + down
    height = n * (special.rel_entr(up / n, p) + special.rel_entr(down / n, 1 - p))
    t = (y.mean() - j) / (y.std(ddof=1) / np.sqrt(7))
    tail = stats.t.sf(np.abs(t), 6)
    height += 0.5 * stats.norm.isf(tail) ** 2
    log = oee.Transitions([0] * n, [0] * n, [2] * up + [1] * down)
    problem = oee.Problem(paid([-1.0, 2.0]), log, horizon=1, trials=oee.Trials(y))
    found = oee.interval(problem, [0, 0, 0])
    if found.diagnostics["contradiction_p_value"] >= 0.01:
        np.testing.assert_allclose(
            [found.lower, found.upper], set_of(height, j), atol=1e-5
        )


def lake(won=9, **options):
    target = success_simulator(oee.tasks.gridworld(4, 0.1).with_initial(0), 15)
    simulator = success_simulator(oee.tasks.gridworld(4, 0.3).with_initial(0), 15)
    policy = oee.tasks.gridworld_expert(4)
    log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 200, seed=3)
    trials = None
    if won is not None:
        trials = oee.Trials.from_successes(won, 12, **options)
    problem = oee.Problem(simulator, log, horizon=8, trials=trials)
    return problem, policy, oee.policy_value(target, policy, horizon=8)


@pytest.mark.parametrize("level", [0.8, 0.95])
def test_the_trials_alone_have_wilsons_or_students_interval(level):
    simulator, counts = coin(20, 10)
    trials = oee.Trials.from_successes(9, 12)
    problem = oee.Problem(simulator, counts, horizon=1, trials=trials)
    both = join_trials(problem, [0, 0, 0], confidence=level)
    wilson = stats.binomtest(9, 12).proportion_ci(level, "wilson")
    np.testing.assert_allclose(both.trials, wilson)
    y = np.array([0.2, 0.5, -0.4, 0.1, 0.3])
    log = oee.Transitions([0] * 8, [0] * 8, [1, 2] * 4)
    problem = oee.Problem(paid([-1.0, 1.0]), log, horizon=1, trials=oee.Trials(y))
    both = join_trials(problem, [0, 0, 0], confidence=level)
    student = stats.t.interval(level, 4, y.mean(), y.std(ddof=1) / np.sqrt(5))
    np.testing.assert_allclose(both.trials, student)


def test_both_are_narrower_than_either():
    problem, policy, truth = lake()
    both = join_trials(problem, policy)
    assert both.interval.width < both.log.width
    assert both.interval.width < both.trials[1] - both.trials[0]
    assert truth in both.interval
    assert both.interval.lower <= both.value <= both.interval.upper
    assert both.worth > 12
    assert not both.is_contradicted
    assert both.log == oee.interval(problem.without_trials, policy)
    # four times the trials that have as narrow an interval have half of it
    assert both.more_trials == pytest.approx(3.0 * both.worth)
    ends = [
        joining.Outcomes(m, both.value, both.variance, np.inf, True).ends(0.95)
        for m in (both.worth, both.worth + both.more_trials)
    ]
    widths = [upper - lower for lower, upper in ends]
    assert widths[0] == pytest.approx(both.interval.width)
    assert widths[1] == pytest.approx(widths[0] / 2, rel=0.05)
    # by the bound as many transitions bring as much
    of_log = 1 / both.standard_error**2 - 12 / both.variance
    brought = of_log * both.more_transitions / problem.counts.sum()
    assert brought == pytest.approx(both.more_trials / both.variance)


def test_a_contradiction_is_said_and_not_averaged():
    problem, policy, _ = lake(won=0)
    both = join_trials(problem, policy)
    assert both.is_contradicted
    assert both.p_value < 0.01
    assert both.value == both.mean == 0.0
    assert both.interval.lower <= both.trials[0]
    assert both.interval.upper >= both.log.upper
    report = oee.evaluate(problem, policy, seed=0)
    assert report.headline.startswith("The trials of “policy” and the log contradict")


def test_ends_of_the_knob_are_joined_too():
    problem, policy, _ = lake()
    found = oee.interval(problem, policy)
    one, anything = (oee.interval(problem, policy, unrecorded=k) for k in (1.0, np.inf))
    np.testing.assert_allclose(found.sampling, (one.lower, one.upper), atol=1e-5)
    np.testing.assert_allclose(
        found.worst_case, (anything.lower, anything.upper), atol=1e-5
    )


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.999])
def test_a_higher_level_is_wider(confidence):
    problem, policy, _ = lake()
    low = oee.interval(problem, policy, confidence=confidence)
    high = oee.interval(problem, policy, confidence=confidence + 0.0005)
    assert high.lower <= low.lower + 1e-9
    assert high.upper >= low.upper - 1e-9


def test_equal_returns_have_the_models_variance():
    simulator = oee.tasks.gridworld(3, 0.3)
    policy = oee.tasks.gridworld_expert(3)
    log = oee.sample_transitions(simulator, np.full((9, 4), 1 / 36), 200, seed=0)
    for returns in ([-1.5], [-1.5] * 4):
        trials = oee.Trials(returns)
        both = join_trials(oee.Problem(simulator, log, trials=trials), policy)
        exact = oee.return_moments(simulator, policy).variance
        assert 0.2 * exact < both.variance < 5.0 * exact
        assert both.interval.width < both.log.width


def test_returns_of_0_and_1_are_successes():
    problem, policy, _ = lake()
    as_returns = oee.Problem(
        problem.simulator,
        problem.log,
        horizon=8,
        trials=oee.Trials(problem.trials.returns),
    )
    assert oee.interval(as_returns, policy) == oee.interval(problem, policy)


def test_trials_of_one_of_two_policies():
    problem, policy, _ = lake(policy="mine")
    uniform = oee.uniform_policy(problem.simulator)
    report = oee.evaluate(problem, {"mine": policy, "other": uniform}, seed=0)
    rows = {(row["policy"], row["estimator"]) for row in report.records()}
    assert ("mine", "oee+trials") in rows
    assert ("other", "oee+trials") not in rows
    assert "without the trials" in report.uncertainty.ranking
    same, _, _ = lake(policy=policy)
    named = oee.evaluate(same, {"a": uniform, "b": policy}, seed=0)
    assert [row["policy"] for row in named.trials()] == ["b"]
    with pytest.raises(ArgumentError, match=r"trials.policy must be a policy that is"):
        oee.evaluate(problem, {"expert": policy}, seed=0)
    with pytest.raises(ArgumentError, match=r"trials.policy must be the policy"):
        oee.interval(same, uniform)
    with pytest.raises(ArgumentError, match=r"trials.policy must be a policy that is"):
        oee.evaluate(same, {"u": uniform}, seed=0)
    nameless, _, _ = lake()
    with pytest.raises(ArgumentError, match=r"trials.policy must name the policy"):
        oee.evaluate(nameless, {"a": uniform, "b": policy}, seed=0)


@pytest.mark.parametrize(
    "options",
    [
        {"method": "delta"},
        {"method": "bootstrap"},
        {"method": "robust"},
        {"tie": np.zeros(3, dtype=int)},
        {"features": np.zeros(3)},
    ],
)
def test_what_cannot_be_joined_is_refused(options):
    problem, policy, _ = lake()
    with pytest.raises(ArgumentError, match=r"with trials.*problem.without_trials"):
        oee.interval(problem, policy, **options)


@pytest.mark.parametrize("seconds", [5e-324, 1e-320, 1e-12])
def test_a_tiny_limit_in_time_leaves_nothing_out(seconds):
    problem, policy, _ = lake()
    joined = join_trials(problem, policy, seconds=seconds)
    for interval in (joined.interval, joined.log):
        assert np.isfinite(
            [interval.lower, interval.upper, *interval.sampling, *interval.worst_case]
        ).all()


def test_the_trials_of_worth_have_as_wide_an_interval_as_their_row():
    """Counted by Wilson's interval and by Student's, which the row “trials” has."""
    problem, policy, _ = lake()
    both = join_trials(problem, policy)
    z = stats.norm.ppf(0.975)
    m, p = both.worth, both.value
    spread = p * (1 - p) / m + z**2 / (4 * m**2)
    wilson = 2 * z * math.sqrt(spread) / (1 + z**2 / m)
    assert wilson == pytest.approx(both.interval.width)
    y = np.array([-1.0, -2.0, -1.2, -0.8])
    simulator = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_transitions(simulator, np.full((9, 4), 1 / 36), 200, seed=0)
    problem = oee.Problem(simulator, log, trials=oee.Trials(y))
    both = join_trials(problem, oee.tasks.gridworld_expert(3))
    half = stats.t.ppf(0.975, both.worth - 1) * y.std(ddof=1) / math.sqrt(both.worth)
    assert 2 * half == pytest.approx(both.interval.width)


@pytest.mark.parametrize("is_success", [True, False])
@pytest.mark.parametrize("number", [3.0, 12.0, 1e6])
def test_trials_alone_are_worth_their_own_number(number, is_success):
    freedom = math.inf if is_success else number - 1.0
    outcomes = joining.Outcomes(number, 0.7, 0.21, freedom, is_success)
    lower, upper = outcomes.ends(0.9)
    worth = joining._count_as_narrow(outcomes, 0.7, upper - lower, 0.9)
    assert worth == pytest.approx(number)


def test_few_trials_are_worth_an_interval_without_end():
    """No number of successes has an interval wider than 1, nor 1 return any end."""
    successes = joining.Outcomes(12.0, 0.7, 0.21, math.inf, True)
    assert joining._count_as_narrow(successes, 0.7, 1.0, 0.95) == 0.0
    assert joining._count_as_narrow(successes, 0.7, 1e-200, 0.95) > 1e20
    assert joining._count_as_narrow(successes, 0.0, 1e-200, 0.95) == math.inf
    returns = successes._replace(freedom=11.0, is_success=False)
    assert joining._count_as_narrow(returns, 0.7, 1e9, 0.95) == pytest.approx(1, abs=1)


def test_a_report_says_how_trials_are_counted_and_whose_they_are():
    problem, policy, _ = lake()
    report = oee.evaluate(problem, {"mine": policy}, seed=0)
    shown = " ".join(str(report).split())
    assert "would halve the interval of simulator, log and trials together." in shown
    assert re.search(
        r"Made from the log that was recorded in the target \([^)]+\), the simulator"
        r" \([^)]+\) and 12 trials of “mine”\.",
        shown,
    )
    told = "9 of 12 succeeded (“mine”)"
    assert told in report.to_html()
    assert json.loads(report.to_json())["facts"]["trials"] == told


def test_a_point_is_worth_any_number_of_trials():
    """A simulator without chance knows the value; its report says so without a number."""
    sure = success_simulator(oee.tasks.gridworld(3, 0.0).with_initial(0), 8)
    policy = oee.tasks.gridworld_expert(3)
    log = oee.sample_episodes(sure, policy, 3, 6, seed=0)
    problem = oee.Problem(
        sure, log, horizon=6, trials=oee.Trials.from_successes(12, 12)
    )
    joined = join_trials(problem, policy)
    assert joined.interval.width == 0.0
    assert joined.worth == math.inf
    report = oee.evaluate(problem, policy, seed=0)
    assert "trials alone would" not in report.to_text(verbose=True)
    json.loads(report.to_json(), parse_constant=pytest.fail)


def test_a_report_states_both_first():
    problem, policy, _ = lake()
    report = oee.evaluate(problem, {"mine": policy}, seed=0, guaranteed=True)
    both = join_trials(problem, policy)
    rows = {row["estimator"]: row for row in report.records()}
    assert rows["oee+trials"]["value"] == pytest.approx(both.value)
    assert rows["oee+trials"]["lower"] == pytest.approx(both.interval.lower)
    assert rows["trials"]["value"] == 0.75
    alone = oee.evaluate(problem.without_trials, {"mine": policy}, seed=0)
    before = {row["estimator"]: row for row in alone.records()}
    for name in before:
        assert rows[name]["value"] == before[name]["value"]
        assert rows[name]["lower"] == before[name]["lower"]
    words = " ".join(report.to_text(verbose=True).split())
    assert "The 12 trials alone say 0.75" in words
    assert "would halve the interval of simulator, log and trials together." in words
    assert "Trials: 9 of 12 succeeded" in words
    content = json.loads(report.to_json())
    (row,) = content["trials"]
    assert row["p_value"] > 0.01
    assert row["number"] == 12
    page = report.to_html()
    assert "oee+trials" in page
    quick = oee.evaluate(problem, {"mine": policy}, seed=0, quick=True)
    assert "not joined with the log" in str(quick)


def test_normalized_reports_scale_the_trials():
    simulator = oee.tasks.gridworld(3, 0.3)
    policy = oee.tasks.gridworld_expert(3)
    log = oee.sample_transitions(simulator, np.full((9, 4), 1 / 36), 200, seed=0)
    trials = oee.Trials([-1.0, -2.0, -1.2, -0.8])
    problem = oee.Problem(simulator, log, trials=trials)
    plain, scaled = (
        oee.evaluate(problem, policy, seed=0, normalized=flag).trials()[0]
        for flag in (False, True)
    )
    for key in ("value", "lower", "mean", "log_upper", "trials_lower"):
        assert scaled[key] == pytest.approx(0.01 * plain[key])
    for key in ("number", "worth", "p_value", "more_trials"):
        assert scaled[key] == plain[key]


def test_the_least_of_l_is_the_value_where_the_log_is_normal():
    """The value minimises (j - v)^2 / 2 se^2 + T(j)."""
    problem, policy, _ = lake()
    both = join_trials(problem, policy)
    one = oee.estimators.OffEnvironment()(problem, policy)

    def height(j):
        return ((j - one.value) / one.standard_error) ** 2 / 2 + 12 * (
            0.75 - j
        ) ** 2 / (2 * j * (1 - j))

    best = optimize.minimize_scalar(height, bounds=(0.01, 0.99), method="bounded").x
    assert both.value == pytest.approx(best, abs=1e-4)


def test_what_trials_are_worth_on_a_family():
    """A small twin of the table of notebooks/trials.md."""
    rows = benchmark.run(
        "bench", logs=3, seed=1, names=("machine",), say=lambda *_, **__: None
    )
    assert len(rows) == 12
    table = benchmark.summarise(rows)
    worth = table.set_index(["trials", "transitions a pair"])["worth"]
    assert worth[12, 10] > 24
    assert worth[12, 3] > 12
    assert (table["width"] < 1.6).all()
    assert sum(row["covers"] for row in rows) >= 9


@pytest.mark.parametrize("options", [{}, {"quick": True}])
def test_the_ends_of_a_probability_are_probabilities(options):
    """Where rewards of 1 in each of eight steps would allow for a value of 8."""
    target = success_simulator(oee.tasks.gridworld(4, 0.02).with_initial(0), 15)
    simulator = success_simulator(oee.tasks.gridworld(4, 0.3).with_initial(0), 15)
    policy = oee.tasks.gridworld_expert(4)
    log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 150, seed=3)
    problem = oee.Problem(simulator, log, horizon=8)
    report = oee.evaluate(problem, {"mine": policy}, seed=0, **options)
    row = next(each for each in report.records() if each["estimator"] == "oee")
    assert 0.0 <= row["lower"] <= row["value"] <= row["upper"] <= 1.0
    found = report.uncertainty.likelihood["mine"]
    assert found.diagnostics["highest_possible"] == 1.0
