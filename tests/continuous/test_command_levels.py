"""How many levels commands are given by: what it does to values is measured and mended."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.continuous.correction.history import HistoryTask, blend_steps
from oee_tabular.continuous.evaluation.command_levels import (
    Rounding,
    describe_rounding,
    has_only,
    include_rounding,
    make_finer,
    make_finer_often,
    measure_roundings,
)
from oee_tabular.continuous.evaluation.policies import as_probabilities
from oee_tabular.continuous.evaluation.rollouts import Rollouts
from oee_tabular.continuous.log.numbering import share_commands
from oee_tabular.continuous.task.base import ContinuousTask, Moves
from oee_tabular.estimators import Estimate
from oee_tabular.report import Settings, evaluate_continuous
from oee_tabular.tasks import ResidualSimulator


class Slider(ContinuousTask):
    """A point that is moved by its command; a reward minus the square of the command."""

    name = "slider"
    state_names = ("place",)
    n_disturbances = 1
    feature_names = state_names
    feature_low = np.array([-20.0])
    feature_high = np.array([20.0])
    periodic = (False,)
    terminates = False

    def __init__(self, levels=3, shift=0.0):
        self.actions = np.linspace(-2.0, 2.0, levels)[:, None]
        self.shift = shift

    def initial_points(self):
        return np.array([[1.0]]), np.ones(1)

    def initial_states(self, n, rng):
        return np.ones((n, 1))

    def moves(self, states, actions, disturbance):
        commands = self.actions[actions]
        after = 0.9 * states + 0.1 * (commands + self.shift) + 0.01 * disturbance
        return Moves(after, -(commands[:, 0] ** 2), np.zeros(len(states), dtype=bool))


class Deaf(Slider):
    """A task that does not read ``self.actions``."""

    def moves(self, states, actions, disturbance):
        commands = np.linspace(-2.0, 2.0, 3)[:, None][actions]
        after = 0.9 * states + 0.1 * commands
        return Moves(after, -(commands[:, 0] ** 2), np.zeros(len(states), dtype=bool))


def brake(states):
    return 0.5 + 0.0 * states


def log_of(task, n=600, seed=0):
    return oee.tasks.record(
        task,
        lambda s: np.full((len(s), len(task.actions)), 1 / len(task.actions)),
        n_transitions=n,
        max_steps=20,
        seed=seed,
    )


@pytest.mark.parametrize("levels", [2, 3, 5])
def test_a_finer_task_has_a_level_between_each_two(levels):
    task = Slider(levels)
    finer, places = make_finer(task, log_of(task))
    assert_allclose(finer.actions[:, 0], np.linspace(-2.0, 2.0, 2 * levels - 1))
    assert_array_equal(finer.actions[places], task.actions)
    assert len(task.actions) == levels
    twice = make_finer_often(task, log_of(task), 2)
    assert_allclose(twice.actions[:, 0], np.linspace(-2.0, 2.0, 4 * levels - 3))


def test_two_coordinates_are_a_product():
    task = Slider(3)
    grid = np.array([[x, y] for x in (0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    task = task.with_actions(grid)
    log = log_of(Slider(6))
    finer, places = make_finer(task, log)
    assert finer.actions.shape == (3 * 5, 2)
    assert_array_equal(finer.actions[places], grid)
    scattered = task.with_actions(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.5]]))
    assert make_finer(scattered, log_of(Slider(3))) is None


def test_a_task_that_steps_other_commands_has_no_finer_one():
    task = Deaf(3)
    assert make_finer(task, log_of(task)) is None
    assert make_finer(oee.tasks.CartPole(), log_of(oee.tasks.CartPole())) is None


@pytest.mark.parametrize("levels", [2, 3, 5, 9])
def test_the_error_of_rounding_is_measured(levels):
    """A command of 0.5 is given by 0 and its neighbour: the mean square is known."""
    task = Slider(levels)
    policy = as_probabilities(brake, task.actions)
    rollouts = Rollouts(10, 1.0, 4000, np.random.SeedSequence(0), paths=4000)
    roundings, _ = measure_roundings(task, log_of(task), {"p": policy}, rollouts)
    found = roundings[policy]
    lower, upper = (
        max(x for x in task.actions[:, 0] if x <= 0.5),
        min(x for x in task.actions[:, 0] if x >= 0.5),
    )
    weight = 0.0 if lower == upper else (0.5 - lower) / (upper - lower)
    mean_square = (1 - weight) * lower**2 + weight * upper**2
    finer = np.linspace(-2.0, 2.0, 2 * levels - 1)
    low, high = finer[finer <= 0.5].max(), finer[finer >= 0.5].min()
    share = 0.0 if low == high else (0.5 - low) / (high - low)
    between = (1 - share) * low**2 + share * high**2
    expected = 4 / 3 * 10 * (mean_square - between)
    assert abs(found.error - expected) <= 4 * found.standard_error + 1e-9
    assert found.n_actions == levels


def test_the_error_of_rounding_is_four_thirds_of_a_difference():
    """Also its standard error, by the same returns under both ways of giving commands."""
    task = Slider(3)
    policy = as_probabilities(brake, task.actions)
    rollouts = Rollouts(10, 1.0, 50, np.random.SeedSequence(0), paths=50)
    roundings, finer = measure_roundings(task, log_of(task), {"p": policy}, rollouts)
    coarse = as_probabilities(brake, task.actions)

    def rounded(states):
        found = np.zeros((len(states), 5))
        found[:, ::2] = coarse(states)
        return found

    ways = [rounded, as_probabilities(brake, finer.actions)]
    returns = rollouts.compare([finer, finer], ways)
    difference = returns[1] - returns[0]
    found = roundings[policy]
    assert_allclose(found.error, 4 / 3 * difference.mean())
    assert_allclose(found.standard_error, 4 / 3 * difference.std(ddof=1) / np.sqrt(50))


@pytest.mark.parametrize(
    ("error", "ends"),
    [(0.09, (-1.0, 1.0)), (0.15, (-1.0, 1.225)), (-0.15, (-1.225, 1.0))],
)
def test_an_interval_takes_in_an_error_above_a_tenth_of_its_half_width(error, ends):
    """Of at most 2 d, where the error is 4/3 d."""
    estimate = Estimate(0.0, 0.5, (-1.0, 1.0))
    found = include_rounding(estimate, Rounding(3, error, 0.01))
    assert_allclose(found.interval, ends)
    assert include_rounding(estimate, None) is estimate


@pytest.mark.parametrize(("error", "n"), [(0.05, 0), (0.3, 1), (-1.5, 2), (6.0, 3)])
def test_refinements_follow_the_law_of_the_square(error, n):
    rounding = Rounding(3, error, 0.01)
    assert rounding.count_refinements(1.0) == n
    assert rounding.is_too_large(1.0) == (n > 0)
    assert not Rounding(3, error, 10.0).is_too_large(1.0)


FEW = Settings(episodes=400)


def test_coarse_levels_are_made_finer():
    target = Slider(33, shift=0.3)
    log = log_of(target, seed=1)
    commands = {"action": target.actions[log.action], "behavior_probability": None}
    log = oee.ContinuousTransitions(**log.columns() | commands)
    with pytest.warns(UserWarning, match="of the log's 600 commands lie between"):
        report = evaluate_continuous(
            Slider(3), log, {"p": brake}, settings=FEW, horizon=20, discount=1.0, seed=0
        )
    row = report.table.iloc[0]
    assert row.lower - 0.1 <= -20 * 0.25 <= row.upper + 0.1
    said = " ".join(report.warnings)
    assert "to the task's 3 actions changes its value in the simulator by" in said
    assert "actions are taken" in said
    assert "moved to the nearest" not in said


def recorded(target, n_levels, seed=0):
    """Record a log of ``target`` with commands of ``n_levels``, as commands."""
    fine = target.with_actions(np.linspace(-2.0, 2.0, n_levels)[:, None])
    log = log_of(fine, seed=seed)
    commands = {"action": fine.actions[log.action], "behavior_probability": None}
    return oee.ContinuousTransitions(**log.columns() | commands)


@pytest.mark.parametrize("levels", [2, 3, 6])
def test_a_correction_reads_commands_between_actions_as_they_are(levels):
    """A step that is linear in the command is corrected to rounding by two levels. With
    each command moved to the nearest level, the moves would count as noise.
    """

    class Still(Slider):
        n_disturbances = 0

        def moves(self, states, actions, disturbance):
            xi = np.zeros((len(states), 1))
            return super().moves(states, actions, xi)

    log = recorded(Still(shift=0.3), 41)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        corrected = ResidualSimulator(Still(levels), log, seed=0)
    assert np.abs(corrected.left_over[:, 0]).max() < 1e-9
    states = np.linspace(-1.0, 1.0, 7)[:, None]
    for a in range(levels):
        actions = np.full(7, a)
        xi = np.zeros((7, corrected.n_disturbances))
        found = corrected.moves(states, actions, xi).next_state
        right = Still(levels, shift=0.3).moves(states, actions, None).next_state
        assert_allclose(found, right, atol=1e-7)


@pytest.mark.parametrize("steps", [1, 2])
def test_earlier_commands_between_actions_are_shares_of_them(steps):
    """The mean of the shares is the command, and a whole action is inside the range."""
    target = Slider(41, shift=0.3)
    log = recorded(target, 41)
    task = HistoryTask(Slider(3), steps)
    whole = task.log(log)
    shares = whole.state[:, 1 : 1 + 3]
    has_last = shares.any(axis=1)
    assert_allclose(shares[has_last].sum(axis=1), 1.0)
    before = np.flatnonzero(has_last) - 1
    assert_allclose(shares[has_last] @ task.actions, log.action[before], atol=1e-12)
    corrected = ResidualSimulator(task, whole, seed=0)
    inside = np.array([[0.5, *np.tile([0.0, 1.0, 0.0], steps)]])
    inside[0, 0] = log.state.mean()
    assert not corrected.beyond(inside)[0]
    # the step under an earlier command is the mean of those under its neighbours
    moved = task.displacements(
        whole.state, whole.action[:, 0].astype(int) * 0, whole.state
    )
    expected = -0.1 * log.state[has_last] + 0.1 * log.action[before]
    assert_allclose(moved[1][has_last], expected, atol=1e-12)


@pytest.mark.parametrize("levels", [3, 5])
@pytest.mark.parametrize("limit", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("steps", [1, 2])
def test_commands_at_their_limit_are_no_stops_of_earlier_actions(levels, limit, steps):
    """Many commands of exactly the same size look as rows at a wall do. Still each row
    counts, and no remembered action differs from what the log says it was.
    """
    rng = np.random.default_rng(steps)
    n = 900
    commands = np.clip(1.5 * rng.standard_normal((n, 1)), -limit, limit)
    places = np.zeros((n + 1, 1))
    for t in range(n):
        gust = 0.01 * rng.standard_normal()
        places[t + 1] = 0.9 * places[t] + 0.1 * (commands[t] + 0.3) + gust
    log = oee.ContinuousTransitions(
        places[:-1], commands, places[1:], -(commands[:, 0] ** 2), episode=np.zeros(n)
    )
    task = HistoryTask(Slider(levels), steps)
    corrected = ResidualSimulator(task, task.log(log), seed=0)
    assert np.abs(corrected.left_over[:, 1 : task.n_state]).max() < 1e-12
    states = np.column_stack([places[:50], np.tile(np.eye(levels)[-1], (50, steps))])
    for a in range(levels):
        moved = corrected.step(states, np.full(50, a), rng).next_state
        assert_array_equal(
            moved[:, 1 : 1 + levels], np.tile(np.eye(levels)[a], (50, 1))
        )


@pytest.mark.parametrize("noise", [0.1, 0.4])
@pytest.mark.parametrize("steps", [1, 3])
def test_small_changes_of_a_command_show_a_delay(noise, steps):
    """They stay next to one action, so that its number alone tells nothing of them."""
    rng = np.random.default_rng(steps)
    n = 3000
    commands = 0.1 * np.sin(np.arange(n) / 9.0) + noise * rng.standard_normal(n)
    commands = np.clip(commands, -0.9, 0.9)[:, None]
    given = np.concatenate([np.zeros((steps, 1)), commands])[:n]
    places = np.zeros((n + 1, 1))
    for t in range(n):
        places[t + 1] = 0.9 * places[t] + 0.1 * given[t] + 1e-4 * rng.normal()
    log = oee.ContinuousTransitions(
        places[:-1], commands, places[1:], -(commands[:, 0] ** 2), episode=np.zeros(n)
    )
    effect = ResidualSimulator(Slider(3), log, seed=0).coordinates[0].history
    assert (effect.lag, effect.of) == (steps, "action")
    assert effect.lag_r_squared > 0.3


def test_a_shared_command_pays_the_mean_of_what_its_actions_pay():
    """In place of what the action next to it pays; that of no share pays its own."""
    task = Slider(3)
    states = np.linspace(-1.0, 1.0, 4)[:, None]
    actions = np.array([0, 1, 2, 2])
    shares = np.array([[0.25, 0.75, 0], [0, 0.5, 0.5], [0.1, 0.2, 0.7], [0, 0, 0]])
    own = task.noiseless_step(states, actions)
    apart = blend_steps(task, states, actions, own.next_state, shares)
    paid = -np.array([4.0, 0.0, 4.0])
    means = np.append(shares[:3] @ paid, paid[2])
    assert_allclose(own.reward + apart.reward, means)
    to = [0.9 * states[:3, 0] + 0.1 * (shares[:3] @ task.actions[:, 0])]
    assert_allclose((own.next_state + apart.next_state)[:3, 0], to[0])


def test_angles_between_actions_are_the_shorter_way():
    class Wheel(Slider):
        state_names = feature_names = ("angle",)
        periodic = (True,)
        feature_low = np.array([-np.pi])
        feature_high = np.array([np.pi])

        def moves(self, states, actions, disturbance):
            after = states + 1.5 * self.actions[actions]
            after = (after + np.pi) % (2 * np.pi) - np.pi
            return Moves(after, -after[:, 0], np.zeros(len(states), dtype=bool))

    wheel = Wheel(3)
    states = np.full((1, 1), 3.0)
    shares = np.array([[0.0, 0.75, 0.25]])
    found = blend_steps(wheel, states, np.array([1]), np.array([[3.0]]), shares)
    # from 3 by 3 is 6 - 2 pi: 3 ahead, of which a quarter
    assert_allclose(found.next_state, [[0.75]])


def test_actions_of_a_log_that_are_the_task_s_change_nothing():
    """Numbers and the same actions as commands give the same bits."""
    target = Slider(3, shift=0.3)
    numbers = log_of(target)
    columns = numbers.columns() | {"action": target.actions[numbers.action]}
    commands = oee.ContinuousTransitions(**columns)
    one, other = (ResidualSimulator(Slider(3), x, seed=0) for x in (numbers, commands))
    assert_array_equal(one.left_over, other.left_over)
    assert one.coordinates == other.coordinates
    assert share_commands(Slider(3), numbers) is None


def test_a_policy_of_coarse_actions_is_one_of_finer_ones():
    coarse, fine = np.array([[0.0], [1.0]]), np.array([[0.0], [0.5], [1.0]])
    policy = as_probabilities(brake, coarse)
    states = np.ones((1, 1))
    assert_array_equal(policy(states), [[0.5, 0.5]])
    assert_array_equal(as_probabilities(policy, fine)(states), [[0.0, 1.0, 0.0]])
    assert as_probabilities(policy, coarse) is policy


def test_what_cannot_be_made_finer_is_in_the_interval():
    """A log that has only the task's actions says nothing of others."""
    task = Slider(3, shift=0.3)
    log = log_of(task, seed=1)
    assert has_only(log, task.actions)
    commands = oee.ContinuousTransitions(
        **log.columns() | {"action": task.actions[log.action]}
    )
    assert has_only(commands, task.actions)
    assert not has_only(commands, np.array([[1.0], [3.0]]))
    report = evaluate_continuous(
        Slider(3), log, {"p": brake}, settings=FEW, horizon=20, discount=1.0, seed=0
    )
    row = report.table.iloc[0]
    assert row.lower < row.value < row.upper
    # (1 - 1/4) 0 + 1/4 2^2 = 1 a step in place of 1/4
    assert row.value == pytest.approx(-20 * 1.0, rel=0.1)
    assert row.upper > -20 * 0.3
    assert "The intervals include this change" in " ".join(report.warnings)


def test_no_interval_is_said_to_include_what_is_cut_off():
    """Commands beyond the actions' range are cut: finer actions are in it as well."""
    task = Slider(3)
    log = log_of(task, seed=1)
    policy = as_probabilities(lambda states: np.full(len(states), 2.5), task.actions)
    measured = {policy: Rounding(3, -1.0, 0.1)}
    told = describe_rounding("p", policy, log, measured, 1.0, is_counted=True)
    changed, included, cut = told.split(". ")
    assert "changes its value in the simulator by about 1" in changed
    assert included == "The intervals include this change"
    assert cut.startswith("100% of the policy's commands lie beyond the range of the")
    plain = describe_rounding("p", policy, log, measured, 1.0)
    assert plain == told.replace(f" {included}.", "")


def test_a_task_that_cannot_be_measured_says_a_distance():
    log = log_of(Deaf(3), seed=1)
    report = evaluate_continuous(
        Deaf(3), log, {"p": brake}, settings=FEW, horizon=20, discount=1.0, seed=0
    )
    assert "rounded to the task's 3 commands" in " ".join(report.warnings)
