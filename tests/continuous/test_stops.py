"""Stops: found by their repetition, undone in the simulator's step, put where the corrected step passes them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.continuous.scatter import Stops
from oee_tabular.lab.experiments.classic import Plain
from oee_tabular.tasks import HistoryTask, Moves, ResidualSimulator, record


class Cart(Plain):
    """Pushed between two walls: who gets there stands still, and loses a share of what else turns."""

    name = "Cart"
    state_names = feature_names = ("place", "speed", "spin")
    actions = np.array([-1.0, 1.0])
    feature_low, feature_high = np.full(3, -2.0), np.full(3, 2.0)
    periodic, terminates = (False,) * 3, False

    def __init__(self, force=1.0, wall=1.0, loss=0.5):
        self.force, self.wall, self.loss = force, wall, loss

    def moves(self, states, actions, disturbance):
        speed = states[:, 1] + 0.1 * self.force * self.actions[actions]
        place = states[:, 0] + 0.1 * speed
        over = np.abs(place) >= self.wall
        spin = 0.95 * states[:, 2] - over * self.loss * speed
        place, speed = np.clip(place, -self.wall, self.wall), np.where(over, 0.0, speed)
        following = np.stack([place, speed, spin], axis=1)
        return Moves(following, -(place**2), np.zeros(len(states), dtype=np.bool_))

    def initial_states(self, n, rng):
        return rng.uniform(-0.7, 0.7, (n, 3))


def evenly(states):
    return np.full((len(states), 2), 0.5)


def one_step(target, simulator, n=6000):
    """Errors of the simulator and of the corrected one on new moves of the target, and where the two are stopped."""
    log = record(target, evenly, n_transitions=n, max_steps=25, seed=0)
    corrected = ResidualSimulator(simulator, log, seed=0)
    new = record(target, evenly, n_transitions=4000, max_steps=25, seed=1)
    actions, xi = new.action_numbers(target.actions), np.zeros((4000, corrected.n_disturbances))
    right, own = new.next_state, simulator.moves(new.state, actions, xi).next_state
    found = corrected.moves(new.state, actions, xi).next_state
    stopped = np.abs(right[:, 0]) == 1.0, np.abs(own[:, 0]) == 1.0
    return np.abs(own - right), np.abs(found - right), stopped, corrected


@pytest.mark.parametrize("force", [0.5, 2.0])
def test_a_stop_is_the_corrected_step_s_not_the_simulator_s(force):
    before, after, (there, here), _ = one_step(Cart(force), Cart())
    assert (there != here).sum() > 20
    assert (after[there | here, :2].max(axis=1) > 1e-6).mean() < 0.1  # those that just come to the wall
    assert before[there != here, 1].max() > 0.5
    assert after[~there & ~here].max() < 1e-6  # free steps know nothing of the walls


def test_what_is_lost_at_a_stop_pushes_the_others_as_the_log_says():
    _, after, (there, _), corrected = one_step(Cart(0.8, loss=0.25), Cart(loss=0.5))
    for push in corrected._stops.pushes.values():
        assert_allclose(push, [[0.0, 0.0, -0.25]], atol=1e-6)
    assert np.quantile(after[there, 2], 0.9) < 1e-6


def test_an_unchanged_task_keeps_its_own_stops_to_the_bit():
    _, after, (there, _), corrected = one_step(Cart(), Cart(), n=2000)
    assert there.any()
    assert not after.any()
    assert not any(c.differs for c in corrected.coordinates)


def test_who_rests_at_a_stop_scatters_nobody_else_less():
    class Shaken(Cart):
        n_disturbances = 1

        def moves(self, states, actions, disturbance):
            shaken = np.array(states)
            shaken[:, 2] += 0.05 * disturbance[:, 0] * (np.abs(states[:, 0]) < 1.0)
            return super().moves(shaken, actions, disturbance)

    def to_the_right(states):
        return np.tile([0.1, 0.9], (len(states), 1))

    log = record(Shaken(0.8), to_the_right, n_transitions=4000, max_steps=25, seed=0)
    corrected = ResidualSimulator(Cart(), log, seed=0)
    assert 0.2 < (np.abs(log.next_state[:, 0]) == 1.0).mean() < 0.5
    states = np.zeros((4000, 3))
    moved = corrected.step(states, np.ones(4000, dtype=np.int64), np.random.default_rng(0)).next_state
    assert_allclose(moved[:, 2].std(), 0.95 * 0.05, rtol=0.06)


def test_a_stop_of_another_place():
    _, after, _, corrected = one_step(Cart(0.8, wall=0.95), Cart())
    assert_array_equal(corrected._stops.target[:, 0], [-0.95, 0.95])
    assert_array_equal(corrected._stops.own[:, 0], [-1.0, 1.0])
    assert np.median(after.max(axis=1)) < 1e-4


# ---------------------------------------------------------------- what is a stop


def found(following, own=None, is_angle=None):
    no_angles = np.zeros(following.shape[1], dtype=bool)
    own, angles = following if own is None else own, no_angles if is_angle is None else np.array(is_angle)
    return Stops(np.zeros_like(following), following, own, angles)


def moved(wall=1.0, still=True, n=2000):
    rng = np.random.default_rng(0)
    values = rng.normal(scale=0.6, size=(n, 2))
    over = np.abs(values[:, 0]) >= wall
    values[over, 0] = np.sign(values[over, 0]) * wall
    values[over & still, 1] = 0.0
    return values


def test_a_limit_that_holds_nothing_else_is_a_bound():
    assert found(moved()).held == {(0, 0): ([1], [0.0]), (1, 0): ([1], [0.0])}
    limit = found(moved(still=False))
    assert_array_equal(limit.bounds[:, 0], [-1.0, 1.0])
    assert np.isinf(limit.target).all()
    assert not limit.held


def test_angles_and_numbers_have_no_stops():
    assert np.isinf(found(moved(), is_angle=[True, False]).target).all()
    few = np.round(moved(), 1)
    few[np.abs(few[:, 0]) == 1.0, 1] = 0.0
    assert np.isinf(found(few).target).all()
    many = moved(wall=0.2)  # most rows are at the walls
    assert np.isinf(found(many).target).all()


def test_the_simulator_s_stop_is_the_target_s_where_the_log_does_not_pass_it():
    short = 0.9 * moved(wall=2.0).clip(-1.0, 1.0) - 1e-3 * np.arange(2000)[:, None] / 2000
    assert_array_equal(found(short, own=moved()).target[:, 0], [-1.0, 1.0])
    passing = found(moved(wall=5.0), own=moved())
    assert np.isinf(passing.target).all()
    assert_array_equal(passing.own[:, 0], [-1.0, 1.0])


def test_the_last_action_is_no_stop():
    whole = HistoryTask(Cart())
    log = whole.log(record(Cart(0.8), evenly, n_transitions=2000, max_steps=25, seed=0))
    stops = ResidualSimulator(whole, log, seed=0)._stops
    assert np.isfinite(stops.target[:, 0]).all()
    assert np.isinf(stops.target[:, 3:]).all()
