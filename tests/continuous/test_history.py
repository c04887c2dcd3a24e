"""Hidden state: what earlier actions explain, how many of them enter the state, and which row a report puts in front."""

import numpy as np
import pytest
from benchmarks.hidden_state import Cogging, Delay, Lag, RandomActions, SensorNoise, of_own, shown
from continuous.test_residual import Line, line_log
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.continuous.correction import choose_correction, describe_history, fit_parameters, parameters_of
from oee_tabular.continuous.episodes import compare_returns
from oee_tabular.continuous.evaluation import evaluate_continuous
from oee_tabular.continuous.history import earlier_rows, hidden_state, history_effects
from oee_tabular.data import ContinuousTransitions
from oee_tabular.lab.experiments import classic
from oee_tabular.tasks import CartPole, HistoryTask, ResidualSimulator, Settings, cartpole_policy, record

SIMULATOR = CartPole(10.0)


def log_of(target, n=3000, seed=0, delta=0.3):
    log = record(target, of_own(cartpole_policy(delta), 4), n_transitions=n, max_steps=100, seed=seed)
    return shown(log, 4)


def value(task, delta=0.4):
    policy, seed = of_own(cartpole_policy(delta), 4), np.random.SeedSequence(1)
    return compare_returns([task], policy, 400, 100, discount=0.99, seed=seed).mean()


# ---------------------------------------------------------------- the state with the last actions


def test_states_hold_the_last_actions():
    log, task = log_of(SIMULATOR, 60), HistoryTask(SIMULATOR, 3)
    whole, codes = task.log(log), np.eye(2)[log.action]
    first = np.flatnonzero(np.diff(log.episode, prepend=-1))
    for k in range(3):
        last = whole.state[:, 4 + 2 * k : 6 + 2 * k]
        assert_array_equal(last[first + k], 0.0)
        assert_array_equal(last[10], codes[9 - k])
    goes_on = ~(log.truncated | log.terminated)[:-1]
    assert_array_equal(whole.next_state[:-1][goes_on], whole.state[1:][goes_on])
    moved = task.moves(whole.state, log.action, np.zeros((60, 4)))
    assert_array_equal(moved.next_state[:, 4:], whole.next_state[:, 4:])
    assert_array_equal(moved.next_state[:, :4], SIMULATOR.moves(log.state, log.action, np.zeros((60, 4))).next_state)
    assert_array_equal(HistoryTask(SIMULATOR, 0).log(log).state, log.state)


def test_a_history_is_the_task_with_more_in_its_state():
    task = HistoryTask(Line(lambda s, a: 0.1 * s, noise=0.1, end=1.0))
    states = np.array([[0.5, 0.0, 1.0], [0.95, 0.0, 0.0]])
    assert_array_equal(HistoryTask(Line(end=0.75)).terminated(states), [False, True])  # by its own state
    moved = task.moves(states, np.array([1, 1]), np.zeros((2, 1)))
    assert_allclose(moved.next_state, [[0.8, 0.0, 1.0], [1.295, 0.0, 1.0]])
    assert_array_equal(task.terminated(moved.next_state), moved.terminated)
    assert_allclose(task.reward_between(states, np.array([1, 1]), moved.next_state), moved.reward)
    assert_array_equal(task.embed(task.features(states)), states)
    own, last = task.displacements(states, np.array([0, 0]), moved.next_state)
    assert_allclose(own, [[0.3], [0.345]])
    assert_allclose(last, [[0.3], [-0.155]])  # no last action: the present
    assert task.initial_points()[0].shape == (50_000, 3)


def test_a_log_without_episodes_is_chained_by_its_states():
    log = line_log(Line(noise=0.1), 100)
    columns = log.columns() | dict.fromkeys(("episode", "timestep", "truncated"))
    chained = ContinuousTransitions(**columns)
    assert_array_equal(HistoryTask(Line(), 2).log(chained).state, HistoryTask(Line(), 2).log(log).state)


# ---------------------------------------------------------------- what history explains


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_delay_is_named_and_its_history_kept(steps):
    target = Delay(SIMULATOR, steps)
    chosen = choose_correction(SIMULATOR, log_of(target), seed=0)
    effect = chosen.plain.coordinates[3].history
    assert (effect.lag, effect.of) == (steps, "action")
    assert effect.lag_r_squared > 0.7
    words = ("one step", "two steps", "three steps")[steps - 1]
    assert hidden_state(chosen.plain).startswith(f"the action of {words} ago explains 8")
    more = " At most 5 are tried; history 8 keeps more."
    assert not chosen.reason.endswith(more)
    assert describe_history(chosen.plain, chosen.learned, 5, True).endswith(f"of a step's standard deviation.{more}")
    assert (chosen.steps, chosen.is_trusted, chosen.status) == (steps, True, "ok")
    assert abs(value(chosen.learned) - value(target)) < 0.05 * abs(value(SIMULATOR) - value(target))


def test_what_history_explains_is_no_effect_below_the_least():
    log = log_of(Delay(SIMULATOR, 1), 2000)
    left = ResidualSimulator(SIMULATOR, log, seed=0).left_over
    every, group = np.ones(len(log), dtype=np.bool_), log.episode % 40
    for share, is_effect in ((0.5, True), (2.0, False)):
        effect = history_effects(
            SIMULATOR, log, log.action, left, group, is_smooth=every, is_free=every, least=share * left.std(axis=0)
        )[3]
        assert (effect.r_squared > 0.5) == is_effect
        assert (effect.part > 0.0) == is_effect


def test_history_explains_its_share_of_what_a_row_s_neighbours_leave():
    """Half of the residual is the last action's, the rest noise, of which a row tells nothing to itself."""
    log = line_log(Line(noise=0.1), 4000)
    last = earlier_rows(log, 1)[:, 0]
    residual = np.where(last >= 0, 2.0 * log.action[last] - 1.0, 0.0) + np.random.default_rng(0).normal(size=4000)
    every = np.ones(4000, dtype=np.bool_)
    effect = history_effects(
        Line(), log, log.action, residual[:, None], log.episode % 40, is_smooth=every, is_free=every, least=np.zeros(1)
    )[0]
    assert (effect.lag, effect.of) == (1, "action")
    assert_allclose(effect.r_squared, 0.5, atol=0.03)


def test_sentences_speak_of_the_row_in_front():
    """Too short a history is not in front; a fit that took the state alone is no physics where history matters."""
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
    """Large residuals in few rows are no contacts where an earlier action explains them."""
    target = Delay(classic.Pendulum(), 2)
    recorded = record(target, of_own(classic.swinging(0.05), 2), n_transitions=4000, max_steps=200, seed=0)
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
        (classic.Pendulum(), Cogging(cogging=1.2), classic.swinging(0.3)),  # rougher than any g
        (SIMULATOR, RandomActions(SIMULATOR, 0.1), cartpole_policy(0.3)),
        (classic.MountainCar(), classic.MountainCar(0.003), classic.rocking(0.3)),  # a wall
    ],
)
def test_what_is_rough_or_random_is_not_hidden(simulator, target, policy):
    log = record(target, policy, n_transitions=4000, max_steps=200, seed=0)
    assert not any(c.hidden for c in ResidualSimulator(simulator, log, seed=0).coordinates)


@pytest.mark.parametrize(("count", "is_spike"), [(2, False), (40, False), (5, True)])
def test_a_few_odd_rows_are_no_hidden_state(count, is_spike):
    """Errors of the log: of the next state alone, or spikes of a sensor, which two rows show."""
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


def test_sensor_noise_puts_the_simulator_in_front():
    target = SensorNoise(SIMULATOR, 0.01)
    policies = {"near": cartpole_policy(0.3), "far": cartpole_policy(0.8)}
    report = evaluate_continuous(
        SIMULATOR, log_of(target), policies, settings=Settings(episodes=500), horizon=100, seed=0
    )
    answers = {answer.policy: answer for answer in report.answers}
    assert [answer.estimator for answer in answers.values()] == ["simulator (continuous)"] * 2
    assert all(answer.lower is None for answer in answers.values())
    assert report.headline.startswith(
        "No correction can be trusted, because the next state depends on more than the state"
    )
    assert "In the simulator, the policy “near” is worth about" in report.headline
    assert "Keeping the last actions in the state, up to 5, does not help." in report.uncertainty.sentences[0]
    learned = [row for row in report.records() if row["estimator"] in ("oee (residual)", "linear model of the log")]
    assert len(learned) == 4
    assert all(row["lower"] is None and "hidden state" in row["status"] for row in learned)


def test_history_may_be_given(monkeypatch):
    steps = []
    monkeypatch.setattr("oee_tabular._progress.report_step", steps.append)
    log = log_of(Delay(SIMULATOR, 2), 2000)
    settings = Settings(episodes=100)
    names = {}
    for history in (0, 1, 3, "auto"):
        steps.clear()
        report = evaluate_continuous(
            SIMULATOR, log, {"p": cartpole_policy(0.3)}, settings=settings, horizon=30, history=history, seed=0,
            estimators=["oee"],
        )  # fmt: skip
        names[history] = [row["estimator"] for row in report.records()]
        is_short = history in (0, 1)
        assert report.uncertainty.sentences[0].startswith("Use history auto") == is_short
    assert names["auto"] == ["oee (residual, last 2 actions)", "oee (residual)", "simulator (continuous)"]
    assert "correction with 2 earlier actions in the state" in steps
    assert "oee (residual, last 2 actions) of “p”" in steps
    assert names[0] == ["simulator (continuous)", "oee (residual)"]
    assert names[1] == ["simulator (continuous)", "oee (residual, last action)", "oee (residual)"]  # too short
    assert names[3][0] == "oee (residual, last 3 actions)"
