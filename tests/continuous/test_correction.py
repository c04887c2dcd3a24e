"""Corrections of a simulator: its parameters, earlier actions in the state; values that
are refused, other units.
"""

import re
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from benchmarks import first_rows
from benchmarks.hidden_state import (
    Cogging,
    Delay,
    Lag,
    RandomActions,
    SensorNoise,
    of_own,
    shown,
)
from continuous.test_residual import Line, line_log
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.continuous.command import continuous_simulator
from oee_tabular.continuous.correction.choice import choose_correction
from oee_tabular.continuous.correction.hidden_state import (
    hidden_state,
    history_effects,
)
from oee_tabular.continuous.correction.history import earlier_rows
from oee_tabular.continuous.correction.parameters import parameters_of
from oee_tabular.continuous.correction.sentences import (
    describe_history,
    difference,
)
from oee_tabular.continuous.correction.starts import odd_starts
from oee_tabular.continuous.discretization.model import uniform_policy_of
from oee_tabular.continuous.evaluation.on_cells import calibrated_row
from oee_tabular.continuous.evaluation.rollouts import Rollouts, refuse_impossible
from oee_tabular.continuous.task.episodes import MonteCarlo, compare_returns
from oee_tabular.data import ContinuousTransitions
from oee_tabular.estimators import Estimate
from oee_tabular.lab.experiments import classic
from oee_tabular.mdp import possible_sums
from oee_tabular.report import Settings, choose_interval, evaluate_continuous
from oee_tabular.tasks import (
    CartPole,
    ContinuousTask,
    HistoryTask,
    LinearModel,
    Moves,
    ParameterFit,
    ResidualSimulator,
    cartpole_policy,
    corrected_value,
    fit_parameters,
    gymnasium_simulator,
    monte_carlo_value,
    record,
)

SIMULATOR = CartPole(10.0)


def log_of(target, n=3000, seed=0, delta=0.3):
    log = record(
        target,
        of_own(cartpole_policy(delta), 4),
        n_transitions=n,
        max_steps=100,
        seed=seed,
    )
    return shown(log, 4)


def value(task, delta=0.4):
    policy = of_own(cartpole_policy(delta), 4)
    seed = np.random.SeedSequence(1)
    return compare_returns([task], policy, 400, 100, discount=0.99, seed=seed).mean()


# ---------------------------------------------------------------- the state with the
# last actions


def test_states_hold_the_last_actions():
    log = log_of(SIMULATOR, 60)
    task = HistoryTask(SIMULATOR, 3)
    whole = task.log(log)
    codes = np.eye(2)[log.action]
    first = np.flatnonzero(np.diff(log.episode, prepend=-1))
    for k in range(3):
        last = whole.state[:, 4 + 2 * k : 6 + 2 * k]
        assert_array_equal(last[first + k], 0.0)
        assert_array_equal(last[10], codes[9 - k])
    goes_on = ~(log.truncated | log.terminated)[:-1]
    assert_array_equal(whole.next_state[:-1][goes_on], whole.state[1:][goes_on])
    moved = task.moves(whole.state, log.action, np.zeros((60, 4)))
    assert_array_equal(moved.next_state[:, 4:], whole.next_state[:, 4:])
    assert_array_equal(
        moved.next_state[:, :4],
        SIMULATOR.moves(log.state, log.action, np.zeros((60, 4))).next_state,
    )
    assert_array_equal(HistoryTask(SIMULATOR, 0).log(log).state, log.state)


def test_a_history_is_the_task_with_more_in_its_state():
    task = HistoryTask(Line(lambda s, a: 0.1 * s, noise=0.1, end=1.0))
    states = np.array([[0.5, 0.0, 1.0], [0.95, 0.0, 0.0]])
    # by its own state
    assert_array_equal(HistoryTask(Line(end=0.75)).terminated(states), [False, True])
    moved = task.moves(states, np.array([1, 1]), np.zeros((2, 1)))
    assert_allclose(moved.next_state, [[0.8, 0.0, 1.0], [1.295, 0.0, 1.0]])
    assert_array_equal(task.terminated(moved.next_state), moved.terminated)
    assert_allclose(
        task.reward_between(states, np.array([1, 1]), moved.next_state), moved.reward
    )
    assert_array_equal(task.embed(task.features(states)), states)
    own, last = task.displacements(states, np.array([0, 0]), moved.next_state)
    assert_allclose(own, [[0.3], [0.345]])
    assert_allclose(last, [[0.3], [-0.155]])  # no last action: the present
    assert task.initial_points()[0].shape == (50_000, 3)


def test_a_log_without_episodes_is_chained_by_its_states():
    log = line_log(Line(noise=0.1), 100)
    columns = log.columns() | dict.fromkeys(("episode", "timestep", "truncated"))
    chained = ContinuousTransitions(**columns)
    assert_array_equal(
        HistoryTask(Line(), 2).log(chained).state, HistoryTask(Line(), 2).log(log).state
    )


@pytest.mark.parametrize("ended", ["truncated", "terminated"])
@pytest.mark.parametrize("has_episodes", [False, True])
def test_nothing_follows_a_row_that_ends_its_episode(ended, has_episodes):
    """The next row begins where this one ends, and has no last action yet."""
    places = 0.1 * np.arange(31)[:, None]
    action = np.random.default_rng(0).integers(2, size=30)
    ends = np.isin(np.arange(30), [4, 17])
    columns = {"state": places[:-1], "action": action, "next_state": places[1:]}
    columns[ended] = ends
    if has_episodes:
        columns["episode"] = np.repeat([3, 1, 2], [5, 13, 12])
    whole = HistoryTask(Line(), 1).log(ContinuousTransitions(**columns))
    is_first = np.insert(ends[:-1], 0, True)
    last = np.eye(2)[np.insert(action[:-1], 0, 0)]
    assert_array_equal(whole.state[:, 1:], np.where(is_first[:, None], 0.0, last))


# ---------------------------------------------------------------- what history explains


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_delay_is_named_and_its_history_kept(steps):
    target = Delay(SIMULATOR, steps)
    chosen = choose_correction(SIMULATOR, log_of(target), seed=0)
    effect = chosen.plain.coordinates[3].history
    assert (effect.lag, effect.of) == (steps, "action")
    assert effect.lag_r_squared > 0.7
    words = ("one step", "two steps", "three steps")[steps - 1]
    assert hidden_state(chosen.plain).startswith(
        f"the action of {words} ago explains 8"
    )
    more = " At most 5 are tried; history 8 keeps more."
    assert not chosen.reason.endswith(more)
    assert describe_history(chosen.plain, chosen.learned, 5, True).endswith(
        f"of a step's standard deviation.{more}"
    )
    assert (chosen.steps, chosen.is_trusted, chosen.status) == (steps, True, "ok")
    assert abs(value(chosen.learned) - value(target)) < 0.05 * abs(
        value(SIMULATOR) - value(target)
    )


def test_what_history_explains_is_no_effect_below_the_least():
    log = log_of(Delay(SIMULATOR, 1), 2000)
    left = ResidualSimulator(SIMULATOR, log, seed=0).left_over
    every = np.ones(len(log), dtype=np.bool_)
    group = log.episode % 40
    for share, is_effect in ((0.5, True), (2.0, False)):
        effect = history_effects(
            SIMULATOR,
            log,
            log.action,
            left,
            group,
            is_smooth=every,
            is_free=every,
            least=share * left.std(axis=0),
        )[3]
        assert (effect.r_squared > 0.5) == (effect.part > 0.0) == is_effect


def effect_on_line(log, residual):
    """What history explains of a residual of the line, where every row counts."""
    every = np.ones(len(log), dtype=np.bool_)
    return history_effects(
        Line(),
        log,
        log.action,
        residual[:, None],
        log.episode % 40,
        is_smooth=every,
        is_free=every,
        least=np.zeros(1),
    )[0]


def test_history_explains_its_share_of_what_a_row_s_neighbours_leave():
    """Half of the residual is the last action's, the rest noise, of which a row tells
    nothing to itself.
    """
    log = line_log(Line(noise=0.1), 4000)
    last = earlier_rows(log, 1)[:, 0]
    residual = np.where(
        last >= 0, 2.0 * log.action[last] - 1.0, 0.0
    ) + np.random.default_rng(0).normal(size=4000)
    effect = effect_on_line(log, residual)
    assert (effect.lag, effect.of) == (1, "action")
    assert_allclose(effect.r_squared, 0.5, atol=0.03)
    # 1 and -1, in the residual's unit
    assert_allclose(effect.part, 1.0, atol=0.03)


def test_history_is_no_larger_for_what_the_state_explains():
    """A large residual that the state explains is not counted as history's."""
    log = line_log(Line(noise=0.1), 4000)
    last = earlier_rows(log, 1)[:, 0]
    of_history = np.where(last >= 0, 0.2 * (2.0 * log.action[last] - 1.0), 0.0)
    parts = []
    for of_state in (0.0, 2.0):
        of_all = of_state * np.sin(log.state[:, 0]) + of_history
        effect = effect_on_line(log, of_all)
        assert (effect.lag, effect.of) == (1, "action")
        parts.append(effect.part)
    assert_allclose(parts, 0.2, atol=0.03)


def test_rows_that_do_not_count_are_no_neighbours():
    """The state explains all of a residual, also where most episodes are left out."""
    log = line_log(Line(noise=0.1), 4000)
    rng = np.random.default_rng(0)
    noise = 0.1 * rng.normal(size=4000)
    effect = history_effects(
        Line(),
        log,
        log.action,
        np.sin(log.state) + noise[:, None],
        log.episode % 40,
        is_smooth=log.episode % 5 == 0,
        is_free=np.ones(4000, dtype=np.bool_),
        least=np.zeros(1),
    )[0]
    assert effect.r_squared < 0.1


def test_sentences_speak_of_the_row_in_front():
    """Too short a history is not in front; a fit that took the state alone is no
    physics where history matters.
    """
    log = log_of(Delay(SIMULATOR, 2))
    assert choose_correction(SIMULATOR, log, history=1, seed=0).reason == ""
    given = choose_correction(SIMULATOR, log, history=3, seed=0).reason
    assert given == "The value in front has the last 3 actions in the state."
    for target, is_hidden in ((Delay(SIMULATOR, 2), True), (CartPole(12.0), False)):
        seen = log_of(target)
        fit = fit_parameters(*parameters_of(SIMULATOR, ["gravity"]), seen)
        reason = choose_correction(SIMULATOR, seen, fit=fit, seed=0).reason
        assert ("Do not read its numbers as physics" in reason) == is_hidden


def test_a_delay_of_a_command_that_rarely_changes():
    """Large residuals in few rows are no contacts where an earlier action explains
    them.
    """
    target = Delay(classic.Pendulum(), 2)
    recorded = record(
        target,
        of_own(classic.swinging(0.05), 2),
        n_transitions=4000,
        max_steps=200,
        seed=0,
    )
    chosen = choose_correction(classic.Pendulum(), shown(recorded, 2), seed=0)
    assert chosen.steps == 2
    assert not any(c.hidden for c in chosen.learned.coordinates)


def test_a_slow_motor_keeps_as_many_actions_as_help():
    chosen = choose_correction(SIMULATOR, log_of(Lag(SIMULATOR, 0.5), 5000), seed=0)
    assert chosen.steps >= 3
    assert chosen.is_trusted
    assert abs(value(chosen.learned) - value(Lag(SIMULATOR, 0.5))) < 1.0
    assert abs(value(chosen.plain) - value(Lag(SIMULATOR, 0.5))) > 1.0


@pytest.mark.parametrize(
    ("simulator", "target", "policy"),
    [
        # rougher than any g
        (classic.Pendulum(), Cogging(cogging=1.2), classic.swinging(0.3)),
        (SIMULATOR, RandomActions(SIMULATOR, 0.1), cartpole_policy(0.3)),
        # a wall
        (classic.MountainCar(), classic.MountainCar(0.003), classic.rocking(0.3)),
    ],
)
def test_what_is_rough_or_random_is_not_hidden(simulator, target, policy):
    log = record(target, policy, n_transitions=4000, max_steps=200, seed=0)
    assert not any(
        c.hidden for c in ResidualSimulator(simulator, log, seed=0).coordinates
    )


@pytest.mark.parametrize(("count", "is_spike"), [(2, False), (40, False), (5, True)])
def test_a_few_odd_rows_are_no_hidden_state(count, is_spike):
    """Errors of the log: of the next state alone, or spikes of a sensor, which two rows
    show.
    """
    log = log_of(CartPole(12.0, noise=0.0), 2000)
    columns = log.columns() | dict.fromkeys(("episode", "timestep", "truncated"))
    columns |= {name: np.array(columns[name]) for name in ("state", "next_state")}
    first = np.flatnonzero(~(log.terminated | log.truncated))
    odd = np.random.default_rng(count).choice(first, count, replace=False)
    columns["next_state"][odd, 3] = np.where(log.next_state[odd, 3] > 0, -3.0, 3.0)
    if is_spike:
        columns["state"][odd + 1, 3] = columns["next_state"][odd, 3]
    chosen = choose_correction(SIMULATOR, ContinuousTransitions(**columns), seed=0)
    assert (chosen.steps, chosen.is_trusted) == (0, True)


# ---------------------------------------------------------------- reports


def test_with_sensor_noise_no_value_is_stated():
    target = SensorNoise(SIMULATOR, 0.01)
    policies = {"near": cartpole_policy(0.3), "far": cartpole_policy(0.8)}
    report = evaluate_continuous(
        SIMULATOR,
        log_of(target),
        policies,
        settings=Settings(episodes=500),
        horizon=100,
        seed=0,
    )
    answers = {answer.policy: answer for answer in report.answers}
    rows = [answer.estimator for answer in answers.values()]
    assert rows == ["simulator (continuous)", "simulator (continuous)"]
    assert all(answer.lower is None for answer in answers.values())
    assert report.headline.startswith(
        "The log cannot say what the policies “near” and “far” are worth in the target:"
        " the next state depends on more than the recorded state and action"
    )
    assert "worth about" not in report.headline
    assert "The value in front" not in str(report)
    told = " ".join(str(report).split())
    assert "The cause may be sensor noise: an error" in told
    # nothing looks like the answer, and a log in memory is told by its size
    assert told.count("the simulator alone: not the target") == 2
    assert re.search(r"recorded in the target \([0-9,]+ transitions\)", told)
    assert (
        "Keeping the last actions in the state, up to 5, does not help."
        in report.uncertainty.sentences[0]
    )
    # advice does not go in a circle: "history 8", then "history auto"
    given = choose_correction(SIMULATOR, log_of(target), history=8, seed=0)
    told = given.advice(is_auto=False)
    assert told.startswith("A correction that keeps the last 8 actions in the state ")
    learned = [
        row
        for row in report.records()
        if row["estimator"] in ("oee (residual)", "linear model of the log")
    ]
    assert len(learned) == 4
    assert all(
        row["lower"] is None and "hidden state" in row["status"] for row in learned
    )


def test_history_may_be_given(monkeypatch):
    steps = []
    monkeypatch.setattr("oee_tabular._progress.report_step", steps.append)
    log = log_of(Delay(SIMULATOR, 2), 2000)
    settings = Settings(episodes=100)
    names = {}
    for history in (0, 1, 3, "auto"):
        steps.clear()
        report = evaluate_continuous(
            SIMULATOR,
            log,
            {"p": cartpole_policy(0.3)},
            settings=settings,
            horizon=30,
            history=history,
            seed=0,
            estimators=["oee"],
        )
        names[history] = [row["estimator"] for row in report.records()]
        is_short = history in (0, 1)
        assert ("Use history auto" in report.uncertainty.sentences[0]) == is_short
    assert names["auto"] == [
        "oee (residual, last 2 actions)",
        "oee (residual)",
        "simulator (continuous)",
    ]
    assert "correction with 2 earlier actions in the state" in steps
    assert "oee (residual, last 2 actions) of “p” (1 of 3)" in steps
    assert re.search(r"^oee .residual. of “p” .2 of 3, about \d+ s left.$", steps[-2])
    assert names[0] == ["simulator (continuous)", "oee (residual)"]
    # too short
    assert names[1] == [
        "simulator (continuous)",
        "oee (residual, last action)",
        "oee (residual)",
    ]
    assert names[3][0] == "oee (residual, last 3 actions)"


# ---------------------------------------------------------------- parameters by least
# squares


def cartpole_log(target, n=300, seed=0):
    return record(
        target, cartpole_policy(0.3), n_transitions=n, max_steps=100, seed=seed
    )


def pendulum_log(target, n=300, seed=0):
    return record(
        target, classic.swinging(0.3), n_transitions=n, max_steps=200, seed=seed
    )


def test_the_right_structure_is_found_exactly():
    """Without noise: all of the parameters, and nothing is left."""
    target = classic.Pendulum(mass=1.2, gravity=11.0, friction=0.1)
    log = pendulum_log(target)
    fit = fit_parameters(
        *parameters_of(classic.Pendulum(), ["mass", "gravity", "friction"]), log
    )
    assert_allclose(
        [fit.parameters[name] for name in ("mass", "gravity", "friction")],
        [1.2, 11.0, 0.1],
        rtol=1e-6,
    )
    assert fit.start == {"mass": 1.0, "gravity": 10.0, "friction": 0.0}
    assert_allclose(fit.residual, 0.0, atol=1e-8)
    states = log.state[:9]
    actions = log.action[:9]
    none = np.zeros((9, 0))
    assert_allclose(
        fit.task.moves(states, actions, none).next_state,
        target.moves(states, actions, none).next_state,
    )


def test_standard_errors_are_those_of_other_logs():
    fits = [
        fit_parameters(
            *parameters_of(CartPole(10.0), ["gravity"]),
            cartpole_log(CartPole(12.0), seed=seed),
        )
        for seed in range(30)
    ]
    found = np.array([fit.parameters["gravity"] for fit in fits])
    errors = np.array([fit.standard_error["gravity"] for fit in fits])
    assert 0.6 < found.std() / errors.mean() < 1.6
    assert (np.abs(found - 12.0) < 2 * errors).mean() > 0.8


class Pushed(Line):
    """Line with a constant push and heavy tails: Student's t with two degrees."""

    def __init__(self, push, noise=0.0):
        super().__init__(lambda s, a: push + 0.0 * s, noise)

    def step(self, states, actions, rng):
        scatter = rng.standard_t(2.0, size=(len(states), 1))
        return self.moves(states, actions, scatter)


def test_standard_errors_by_hand():
    """The sandwich of soft L1, rho(e) = 2 c^2 ((1 + (e / c)^2)^(1/2) - 1).

    rho' / 2 = e w and rho'' / 2 = w^3 with w = (1 + (e / c)^2)^(-1/2); c is the median
    of abs(e). Of a constant push, se = (sum (w e)^2)^(1/2) / sum w^3.
    """
    log = line_log(Pushed(0.05, noise=0.02), 4000)
    fit = fit_parameters(Pushed, {"push": 0.1}, log)
    e = fit.residual[:, 0]
    w = (1.0 + (e / np.median(np.abs(e))) ** 2) ** -0.5
    own = np.sqrt(np.sum((w * e) ** 2)) / np.sum(w**3)
    # the scale c is that of the fit before the last one
    assert_allclose(fit.standard_error["push"], own, rtol=0.01)
    assert abs(fit.parameters["push"] - 0.05) < 4.0 * own


def test_rows_that_no_structure_explains_pull_little():
    log = cartpole_log(RandomActions(classic.ChangedCartPole(12.5), 0.1), 2000)
    fit = fit_parameters(
        *parameters_of(classic.ChangedCartPole(10.0), ["gravity", "force"]), log
    )
    assert_allclose(
        [fit.parameters["gravity"], fit.parameters["force"]], [12.5, 1.0], rtol=0.01
    )


def test_what_a_log_does_not_determine_is_reported():
    """Steps depend on gravity / length and 1 / (mass length^2) alone."""
    log = pendulum_log(classic.Pendulum(mass=1.2, gravity=11.0))
    fit = fit_parameters(
        *parameters_of(classic.Pendulum(), ["mass", "length", "gravity"]), log
    )
    assert np.isinf(list(fit.standard_error.values())).all()
    assert "The log does not determine mass, length, gravity." in fit.describe()


def test_a_fit_at_its_bound_is_reported():
    fit = fit_parameters(
        CartPole,
        {"gravity": 10.0},
        cartpole_log(CartPole(15.0)),
        {"gravity": (5.0, 12.0)},
    )
    assert_allclose(fit.parameters["gravity"], 12.0, rtol=1e-3)
    assert fit.at_bounds == ("gravity",)
    assert "The fit stopped at a bound of gravity." in fit.describe()


@pytest.mark.parametrize(
    ("spec", "truth"),
    [
        ("Pendulum-v1", {"g": 9.0, "m": 1.3}),
        # from which the environment computes others
        ("CartPole-v1", {"length": 0.7, "gravity": 11.0}),
    ],
)
def test_gymnasium(spec, truth):
    target = gymnasium_simulator(
        f"{spec}:" + ",".join(f"{key}={x}" for key, x in truth.items())
    ).task
    policy = uniform_policy_of(target)
    log = target.record(policy, n_transitions=300, max_steps=100, seed=0)
    fit = fit_parameters(
        *parameters_of(gymnasium_simulator(spec).task, list(truth)), log
    )
    assert_allclose(
        [fit.parameters[name] for name in truth], list(truth.values()), rtol=1e-4
    )


def test_mujoco():
    pytest.importorskip("mujoco")
    truth = {
        "body_mass.pole": 8.0,
        "dof_damping.slider": 2.0,
        "actuator_gear.slide": 80.0,
    }
    simulator = gymnasium_simulator("InvertedPendulum-v5", actions=5).task
    model = gymnasium.make("InvertedPendulum-v5").unwrapped.model
    assert simulator.family.known()["body_mass.pole"] == model.body("pole").mass[0]
    target = simulator.family(**truth)
    policy = uniform_policy_of(target)
    log = target.record(policy, n_transitions=300, max_steps=30, seed=0)
    fit = fit_parameters(*parameters_of(simulator, list(truth)), log)
    assert_allclose(
        [fit.parameters[name] for name in truth], list(truth.values()), rtol=1e-2
    )


def test_parameters_come_first_and_the_residual_on_top():
    log = pendulum_log(Cogging(mass=1.2, gravity=11.0, cogging=0.1, dry=0.1), 3000)
    fit = fit_parameters(*parameters_of(classic.Pendulum(), ["mass", "gravity"]), log)
    chosen = choose_correction(classic.Pendulum(), log, fit=fit, seed=0)
    assert chosen.fit is fit
    assert chosen.name == "oee (parameters, residual)"
    assert chosen.learned.task is fit.task
    assert (
        "corrects the residuals of the fitted simulator, because its held-out one-step"
        " error is not clearly larger" in chosen.reason
    )
    worse = fit_parameters(
        classic.Pendulum, {"gravity": 3.0}, log, {"gravity": (2.0, 4.0)}
    )
    assert (
        choose_correction(classic.Pendulum(), log.first(400), fit=worse, seed=0).fit
        is None
    )


def test_a_report_fits_by_name():
    log = cartpole_log(CartPole(14.0), 1000)
    report = evaluate_continuous(
        CartPole(10.0),
        log,
        {"p": cartpole_policy(0.5)},
        settings=Settings(episodes=200),
        horizon=50,
        seed=0,
        fit=["gravity"],
        estimators=["oee"],
    )
    assert [r["estimator"] for r in report.records()][:2] == [
        "oee (parameters, residual)",
        "oee (residual)",
    ]
    assert report.uncertainty.sentences[0].startswith("Least squares gives gravity 14")


# ---------------------------------------------------------------- calibration


@pytest.mark.parametrize(
    ("value", "error", "found"),
    [
        (5.0, None, 5.0),
        (10.5, None, np.nan),
        (10.5, 0.1, np.nan),
        (10.5, 0.4, 10.0),
        (10.5, 0.253, np.nan),
        (-0.1, 0.01, np.nan),
    ],
)
def test_values_that_cannot_be_are_refused(value, error, found):
    raw = Estimate(value, error, None if error is None else (value - 1, value + 1))
    estimate = refuse_impossible(raw, 0.0, 10.0, 10)
    assert estimate.value == pytest.approx(found, nan_ok=True)
    if np.isnan(found):
        assert (
            estimate.status
            == f"{value:.4g} is impossible: a sum of 10 rewards is between 0 and 10"
        )
        assert estimate.interval is None
    # rewards without bounds refuse no finite value
    same = refuse_impossible(raw, -np.inf, np.inf, 10)
    assert replace(same, bounds=None) == raw


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("bounds", [(0.0, 10.0), (-np.inf, np.inf)])
def test_values_without_end_are_refused(value, bounds):
    estimate = refuse_impossible(Estimate(value, 1.0, (0.0, 1.0)), *bounds, 10)
    assert np.isnan(estimate.value)
    assert estimate.interval is None
    assert estimate.status == (
        f"{value:.4g} is no finite number: the states grow without end"
    )


def test_an_interval_of_all_that_is_possible_has_no_value():
    wide = Estimate(-30.0, 40.0, (-110.0, 50.0))
    estimate = refuse_impossible(wide, 0.0, 10.0, 10)
    assert np.isnan(estimate.value)
    assert estimate.status == (
        "-30 is a guess: its interval reaches over all that is possible (a sum of 10"
        " rewards is between 0 and 10)"
    )
    # a value that is possible stays, and so does one whose interval leaves something
    assert refuse_impossible(replace(wide, value=3.0), 0.0, 10.0, 10).value == 3.0
    some = replace(wide, interval=(-110.0, 9.0))
    assert refuse_impossible(some, 0.0, 10.0, 10).value == 0.0


def test_where_the_corrected_value_is_refused_the_log_cannot_say(monkeypatch):
    """The simulator's value alone is no answer to what is asked."""
    monkeypatch.setattr(Rollouts, "estimate", lambda *given: Estimate(1e9))
    report = evaluate_continuous(
        SIMULATOR,
        log_of(SIMULATOR, n=500),
        {"one": cartpole_policy(0.4), "two": cartpole_policy(0.9)},
        settings=Settings(episodes=50),
        horizon=20,
        seed=0,
        estimators=["oee"],
    )
    for name in ("one", "two"):
        assert (
            f"The log cannot say what the policy “{name}” is worth in the target: in the"
            " corrected simulator its value of 1e+09 is impossible: a sum of 20 rewards"
        ) in report.headline
    assert "worth about" not in report.headline
    assert "record with noise on the commands" in " ".join(str(report).split())
    # the simulator's own value remains, as that
    assert {answer.estimator for answer in report.answers} == {"simulator (continuous)"}


# ---------------------------------------------------------------- where episodes begin


def with_starts(log, shift, rows=None):
    """The log with other first states; ``rows`` picks some of the episodes."""
    first = np.unique(log.episode, return_index=True)[1]
    first = first if rows is None else first[rows]
    states = log.state.copy()
    states[first] += shift[: len(first)]
    return ContinuousTransitions(**log.columns() | {"state": states})


@pytest.mark.parametrize("name", ["theta", "x"])
@pytest.mark.parametrize("gravity", [10.0, 12.5])
def test_first_states_that_do_not_fit_are_told(name, gravity):
    """As a recorder writes them that notes the state before a reset."""
    log = log_of(CartPole(gravity), n=3000)
    k = SIMULATOR.state_names.index(name)
    n = len(np.unique(log.episode))
    shift = np.zeros((n, 4))
    shift[:, k] = 0.2 * np.random.default_rng(0).standard_normal(n)
    assert choose_correction(SIMULATOR, log, seed=0).is_trusted
    chosen = choose_correction(SIMULATOR, with_starts(log, shift), seed=0)
    assert not chosen.is_trusted
    assert chosen.steps == 0
    assert "the first rows of its episodes do not fit the others" in chosen.status
    assert name in chosen.status
    assert "leave its first row out" in chosen.advice(is_auto=True)


@pytest.mark.parametrize("history", [0, 1, 2])
def test_a_history_that_is_given_hides_no_false_starts(history):
    log = log_of(CartPole(12.5), n=3000)
    shift = np.zeros((len(np.unique(log.episode)), 4))
    shift[:, 2] = 0.2 * np.random.default_rng(0).standard_normal(len(shift))
    wrong = with_starts(log, shift)
    assert not choose_correction(SIMULATOR, wrong, history=history, seed=0).is_trusted


def test_what_the_correction_explains_is_no_false_start():
    """A damped system moves most where its episodes begin."""
    rng = np.random.default_rng(0)
    rows = []
    for episode in range(40):
        place = rng.uniform(-1.0, 1.0)
        for _ in range(50):
            action = rng.integers(2)
            after = 0.3 * place + 0.02 * (2 * action - 1) + 0.002 * rng.normal()
            rows.append((place, action, after, episode))
            place = after
    columns = np.array(rows).T
    log = ContinuousTransitions(
        columns[0][:, None],
        columns[1].astype(int),
        columns[2][:, None],
        0.0 * columns[0],
        episode=columns[3],
    )

    class Damped(Line):
        def moves(self, states, actions, disturbance):
            after = 0.2 * states + 0.02 * (2 * actions[:, None] - 1)
            return Moves(after, 0.0 * after[:, 0], np.zeros(len(after), dtype=bool))

    assert choose_correction(Damped(), log, seed=0).is_trusted


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_delay_is_no_false_start(steps):
    """Its queue is empty where an episode begins, so that first rows are unlike others."""
    log = log_of(Delay(SIMULATOR, steps))
    chosen = choose_correction(SIMULATOR, log, seed=0)
    assert chosen.is_trusted
    assert not chosen.plain.odd_starts.any()


@pytest.mark.parametrize(
    "kind", ["true", "last of the episode before", "one start for all", "zeros"]
)
def test_false_first_rows_of_a_system_drawn_anew(kind):
    """One log of the benchmark by which the thresholds were compared."""
    simulator, path, commands = first_rows.record(4)
    log = first_rows.log_of(path, commands, kind)
    plain = choose_correction(simulator, log, history=0).plain
    assert plain.odd_starts.any() == (kind != "true")


def test_starts_that_are_only_few_or_only_hard_are_not_odd():
    log = log_of(SIMULATOR, n=3000)
    n = len(np.unique(log.episode))
    size = np.full((n, 4), 0.3)
    some = choose_correction(SIMULATOR, with_starts(log, size, slice(0, 1)), seed=0)
    assert "first rows" not in some.status
    # what second rows miss as well is no fault of the recorder
    left = np.ones((len(log), 1))
    first = np.unique(log.episode, return_index=True)[1]
    assert odd_starts(log, left, np.zeros(1)) == 0.0
    left[first] = 100.0
    assert odd_starts(log, left, np.zeros(1)) > 0.9
    assert odd_starts(log, left, np.full(1, 200.0)) == 0.0
    left[first[4:]] = 1.0
    assert odd_starts(log, left, np.zeros(1)) == 0.0
    left[first] = 100.0
    left[first + 1] = 90.0
    assert odd_starts(log, left, np.zeros(1)) == 0.0
    alone = ContinuousTransitions(**log.columns() | {"episode": None})
    assert odd_starts(alone, left, np.zeros(1)) == 0.0


@pytest.mark.parametrize(
    ("raw", "below", "said"), [(5.0, 6.0, False), (9.0, 6.0, True)]
)
def test_calibration_that_changes_more_than_the_simulator_has_a_warning(
    raw, below, said
):
    """By the ratio 9/6 a raw 9 moves by 4.5, the simulator's own value by 3."""
    raw = Estimate(
        raw,
        0.1,
        (raw - 0.2, raw + 0.2),
        {"interval_method": "one-step", "one_step_value": 9.9},
    )
    estimate = calibrated_row(raw, MonteCarlo(9.0, 0.01, 1.0, 100), below, "ratio", 1.0)
    assert estimate.value == pytest.approx(raw.value * 1.5)
    assert estimate.interval == pytest.approx(
        (
            estimate.value - 1.96 * estimate.standard_error,
            estimate.value + 1.96 * estimate.standard_error,
        )
    )
    assert (
        any(
            "Rely on the corrected simulator instead" in str(finding)
            for finding in estimate.findings
        )
        == said
    )


# ---------------------------------------------------------------- the linear model,
# rewards


def test_a_linear_model_is_least_squares_with_the_log_s_residuals():
    log = cartpole_log(CartPole(15.0), 3000)
    model = LinearModel(CartPole(10.0), log)
    a = log.action == 1
    x = np.column_stack([np.ones(a.sum()), log.state[a]])
    by_hand = np.linalg.lstsq(x, log.next_state[a] - log.state[a])[0]
    left = log.next_state[a] - log.state[a] - x @ by_hand
    np.testing.assert_allclose(model.residuals[a], left, atol=1e-9)
    states = np.zeros((4000, 4))
    actions = np.ones(4000, dtype=np.int64)
    moved = (
        model.step(states, actions, np.random.default_rng(0)).next_state - by_hand[0]
    )
    assert np.abs(moved.std(axis=0) / model.residuals[a].std(axis=0) - 1).max() < 0.1
    again = model.resampled(0)
    assert 0 < np.abs(again.coefficients - model.coefficients).max() < 0.1
    truth, found, before = (
        monte_carlo_value(
            task, cartpole_policy(0.4), 4000, 100, seed=0, normalized=True
        ).value
        for task in (CartPole(15.0), model, CartPole(10.0))
    )
    assert abs(found - truth) < 0.3 * abs(before - truth)


def test_a_resample_of_a_short_log_has_rows():
    model = LinearModel(CartPole(10.0), cartpole_log(CartPole(15.0), 2))
    for seed in range(30):
        assert np.abs(model.resampled(seed).coefficients).max() > 0


def test_rewards_that_are_not_the_task_s_are_reported():
    class Paid(CartPole):
        def reward_between(self, states, actions, next_states):
            return np.ones(len(states))

    simulator = replace(continuous_simulator("cartpole"), task=Paid(10.0))
    log = cartpole_log(CartPole(10.0), 400)
    odd = ContinuousTransitions(
        **(log.columns() | {"reward": np.where(np.arange(400) < 3, 2.0, 1.0)})
    )
    policies = {"mixed": cartpole_policy(0.4)}
    settings = Settings(episodes=50)
    right, wrong = (
        evaluate_continuous(
            simulator, each, policies, settings=settings, seed=0, estimators=["oee"]
        ).warnings
        for each in (log, odd)
    )
    assert not any("contradict" in text for text in right)
    said = (
        "rewards contradict the simulator's r(s, a, s') in 3 of 400 transitions. The"
        " reward of row 0 is 2"
    )
    assert any(said in text for text in wrong)


# ---------------------------------------------------------------- units, and places
# that the log has not seen


def in_units(log, columns, factor):
    given = log.columns()
    for name in ("state", "next_state"):
        given[name] = given[name].copy()
        given[name][:, list(columns)] *= factor
    return ContinuousTransitions(**given)


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        ((), 1.0, ""),
        ((2,), 180 / np.pi, "theta (degrees for radians)"),
        ((2, 3), 180 / np.pi, "theta and theta_dot (degrees for radians)"),
        ((0,), 1e3, "x (mm for m)"),
        ((0, 1), 1e2, "x and x_dot (cm for m)"),
    ],
)
@pytest.mark.parametrize("gusts", [0.0, 0.1])
def test_columns_in_another_unit(columns, factor, said, gusts):
    """Whatever else has changed: gravity, and gusts as large as a push."""
    log = in_units(
        cartpole_log(classic.ChangedCartPole(15.0, gusts=gusts), 1000), columns, factor
    )
    assert ResidualSimulator(CartPole(10.0), log, seed=0).units == said


def test_another_unit_is_no_hidden_state():
    """An angle in degrees: told of with the unit, in the first sentence and in the
    row's status.
    """
    task = classic.Acrobot()
    log = in_units(
        record(task, classic.pumping(0.3), n_transitions=3000, max_steps=500, seed=0),
        (1,),
        180 / np.pi,
    )
    corrected = ResidualSimulator(task, log, seed=0)
    told = (
        "The log's columns seem to be in another unit than the simulator's: angle_2"
        " (degrees for radians)"
    )
    assert difference(corrected).startswith(told)
    assert "Hidden state" not in difference(corrected)
    found = corrected_value(
        corrected, classic.pumping(0.1), 20, 20, refits=2, paths=10, seed=0
    )
    assert "degrees for radians" in found.status
    assert "hidden state" not in found.status


def test_a_policy_beyond_the_log_is_reported():
    """The log's cart is pushed at random from the middle; a policy that always pushes
    right is soon where it never was.
    """
    log = record(
        CartPole(15.0), cartpole_policy(1.0), n_transitions=2000, max_steps=8, seed=0
    )
    corrected = ResidualSimulator(CartPole(10.0), log, seed=0)
    away = np.array([log.state[5], 2.0 * log.state.max(axis=0)])
    assert corrected.beyond(away).tolist() == [False, True]
    far, near = (
        corrected_value(
            corrected, cartpole_policy(1.0), 300, steps, refits=2, paths=100, seed=0
        )
        for steps in (60, 5)
    )
    assert far.diagnostics["beyond_log"] > 0.04
    assert near.diagnostics["beyond_log"] < 0.01
    assert [finding.kind for finding in far.findings] == ["beyond"]
    assert not near.findings
    assert "start outside the range of the recorded states" in str(far.findings[0])


def test_on_cells_no_value_is_beyond_what_the_rewards_sum_to(monkeypatch):
    """CartPole pays 1 in each of 20 steps, or 0 after its end."""

    def absurd(*given):
        return Estimate(1e9)

    monkeypatch.setattr(
        "oee_tabular.continuous.evaluation.on_cells.calibrated_row", absurd
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report = evaluate_continuous(
            CartPole(10.0),
            log_of(SIMULATOR, n=500),
            {"mixed": cartpole_policy(0.4)},
            settings=Settings(grid=(8, 8), episodes=50),
            horizon=20,
            discount=0.9,
            seed=0,
            estimators=["oee"],
            history=0,
        )
    highest = sum(0.9**t for t in range(20))
    refused = [row.estimate.status for row in report.results]
    assert (
        f"1e+09 is impossible: a sum of 20 rewards is between 0 and {highest:.4g}"
        in refused
    )


def test_where_steps_may_end_rewards_may_sum_to_0(monkeypatch):
    """Also where no row of the log ends: CartPole pays 1 in each of its steps."""
    monkeypatch.setattr(Rollouts, "estimate", lambda *given: Estimate(1e9))
    report = evaluate_continuous(
        CartPole(10.0),
        record(SIMULATOR, cartpole_policy(0.3), n_transitions=300, max_steps=5, seed=0),
        {"mixed": cartpole_policy(0.4)},
        settings=Settings(episodes=50),
        horizon=20,
        discount=0.9,
        seed=0,
        estimators=["oee"],
        history=0,
    )
    highest = sum(0.9**t for t in range(20))
    assert (
        f"1e+09 is impossible: a sum of 20 rewards is between 0 and {highest:.4g}"
        in report.results[0].estimate.status
    )


class Sliding(ContinuousTask):
    """A mass that is pushed; the reward is minus its distance from 0."""

    name = "sliding"
    state_names = ("place", "speed")
    feature_names = state_names
    feature_low = np.array([-5.0, -5.0])
    feature_high = np.array([5.0, 5.0])
    actions = np.array([-1.0, 1.0])
    n_disturbances = 0
    periodic = (False, False)
    terminates = False

    def __init__(self, drag=0.1):
        self.drag = drag

    def initial_states(self, n, rng):
        return np.column_stack([np.ones(n), rng.normal(0.0, 0.01, n)])

    def moves(self, states, actions, disturbance):
        place, speed = states.T
        speed = (1.0 - self.drag) * speed + 0.1 * self.actions[actions]
        after = np.column_stack([place + 0.1 * speed, speed])
        return Moves(after, -np.abs(after[:, 0]), np.zeros(len(states), dtype=bool))


def braking(states):
    right = (states.sum(axis=1) < 0).astype(float)
    return np.column_stack([1.0 - right, right])


def fleeing(states):
    return np.tile([0.0, 1.0], (len(states), 1))


def test_a_log_that_does_not_hold_what_the_policy_does_says_so():
    """Also of other policies of the same report, one by one."""
    log = record(Sliding(0.15), braking, n_transitions=600, max_steps=60, seed=0)
    report = evaluate_continuous(
        Sliding(),
        log,
        {"brakes": braking, "flees": fleeing},
        settings=Settings(episodes=200),
        horizon=60,
        seed=0,
    )
    assert report.headline.count("The log cannot say") == 1
    assert "what the policy “flees” is worth in the target" in report.headline
    assert "start outside the range of the recorded states" in report.headline
    assert "the policy “brakes” is worth about" in report.headline
    flees = [r for r in report.records() if r["policy"] == "flees"]
    assert flees[0]["lower"] is None
    assert "the correction is a guess" in flees[0]["status"]


@settings(max_examples=100, deadline=None)
@given(
    st.floats(-10, 10),
    st.floats(0, 10),
    st.integers(1, 30),
    st.floats(0, 1),
    st.booleans(),
    st.floats(-400, 400),
    st.floats(0, 50),
)
def test_no_interval_goes_beyond_what_rewards_sum_to(
    low, width, horizon, discount, ends, value, error
):
    bounds = possible_sums(low, low + width, horizon, discount, ends=ends)
    assert bounds[0] <= bounds[1] + 1e-9
    raw = Estimate(value, error, (value - 2 * error, value + 2 * error), is_normal=True)
    found = choose_interval(refuse_impossible(raw, *bounds, horizon), None, 0.9)
    slack = 1e-8 * (1.0 + max(map(abs, bounds)))
    if np.isnan(found.value):
        assert found.interval is None
        return
    assert bounds[0] - slack <= found.value <= bounds[1] + slack
    if found.interval is not None:
        assert bounds[0] - slack <= found.interval[0] <= found.value
        assert found.value <= found.interval[1] <= bounds[1] + slack


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-5, 5), min_size=1, max_size=20), st.floats(0, 1))
def test_sums_of_rewards_are_possible(rewards, discount):
    """Whatever rewards come, and however early the episode ends."""
    low, high = min(rewards), max(rewards)
    weights = discount ** np.arange(len(rewards))
    for n in range(1, len(rewards) + 1):
        total = float(weights[:n] @ rewards[:n])
        ends = n < len(rewards)
        least, most = possible_sums(low, high, len(rewards), discount, ends=ends)
        assert least - 1e-9 <= total <= most + 1e-9


def test_without_cells_a_value_of_the_wrong_sign_is_refused(monkeypatch):
    """Rewards are at most 0, in the log and in the simulator: no value above 0 stands."""
    log = record(
        classic.MountainCar(force=0.0012),
        classic.rocking(0.3),
        n_transitions=600,
        max_steps=200,
        seed=0,
    )
    monkeypatch.setattr(
        ResidualSimulator, "_reward", lambda self, states, *rest: np.ones(len(states))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        report = evaluate_continuous(
            classic.MountainCar(),
            log,
            {"mixed": classic.rocking(0.4)},
            settings=Settings(episodes=50),
            horizon=20,
            seed=0,
            estimators=["oee"],
        )
    residual = report.results[0]
    assert residual.estimator == "oee (residual)"
    assert np.isnan(residual.estimate.value)
    assert (
        "is impossible: a sum of 20 rewards is between -18.21 and 0"
        in residual.estimate.status
    )


@pytest.mark.parametrize("name", ["standard_error", "start"])
def test_a_fit_of_parameters_has_a_number_of_each(name):
    known = {"standard_error": {"gravity": 0.1}, "start": {"gravity": 10.0}}
    known[name] = {"length": 0.1}
    with pytest.raises(ValueError, match=f"^{name} must have a number of every .*'gra"):
        ParameterFit(
            CartPole(), {"gravity": 9.0}, residual=np.zeros((2, 4)), **known
        ).describe()
