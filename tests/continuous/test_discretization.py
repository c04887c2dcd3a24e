import json
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular._checks import freeze
from oee_tabular._files import save_npz
from oee_tabular._sparse import row_sums
from oee_tabular.continuous.grid import Grid, gauss_hermite
from oee_tabular.continuous.task import task_metadata
from oee_tabular.data import ContinuousTransitions
from oee_tabular.estimators.calibrated import calibrate
from oee_tabular.tasks import (
    CartPole,
    ContinuousTask,
    Discretization,
    GridInterpolation,
    GymnasiumTask,
    Moves,
    VisitedCells,
    cartpole_policy,
    defensive_mixture,
    monte_carlo_value,
    record,
    resimulate,
    visited_states,
)

QUICK = {"closure_episodes": 0}


class Drift(ContinuousTask):
    """s' = s + push + 0.1 xi on the line; paid by where it leads, over beyond 1 unless it circles."""

    def __init__(self, circle=False, push=0.25, noise=0.0):
        self.name, self.state_names, self.feature_names = "Drift", ("s",), ("s",)
        self.actions = freeze(np.array([-push, push]))
        self.n_disturbances, self.noise = 1, noise
        self.feature_low, self.feature_high = np.array([-1.0]), np.array([1.0])
        self.periodic, self.terminates = (circle,), not circle

    def moves(self, states, actions, disturbance):
        following = states + self.actions[actions][:, None] + self.noise * disturbance
        return Moves(following, self.reward_between(states, actions, following), self.terminated(following))

    def initial_states(self, n, rng):
        return rng.uniform(-0.1, 0.1, (n, 1))

    def terminated(self, states):
        return np.abs(states[:, 0]) > 1.0 if self.terminates else np.zeros(len(states), dtype=bool)

    def reward_between(self, states, actions, next_states):
        return next_states[:, 0] - states[:, 0]


def half(states):
    return np.full((len(states), 2), 0.5)


# ---------------------------------------------------------------- the grid's weights


@st.composite
def grids(draw):
    k = draw(st.integers(1, 3))
    shape = tuple(draw(st.integers(2, 6)) for _ in range(k))
    low = np.array([draw(st.integers(-5, 5)) for _ in range(k)], dtype=float)
    width = np.array([draw(st.integers(1, 8)) for _ in range(k)], dtype=float)
    return Grid(low, low + width, shape, (False,) * k)


@given(grids(), st.integers(0, 2**32 - 1))
def test_weights_are_a_distribution_that_keeps_the_point(grid, seed):
    points = np.random.default_rng(seed).uniform(grid.low, grid.high, (20, len(grid.shape)))
    weights = grid.weights(points)
    assert_allclose(row_sums(weights), 1.0, rtol=1e-14)
    assert weights.data.min() > 0
    assert np.diff(weights.indptr).max() <= 2 ** len(grid.shape)
    assert_allclose(weights @ grid.vertices(), points, atol=1e-12)
    assert not grid.outside(points).any()
    assert grid.outside(grid.high + 1e-3 * (grid.high - grid.low) + 0 * points).all()


@given(grids())
def test_a_vertex_is_its_own(grid):
    assert_allclose(grid.weights(grid.vertices()).toarray(), np.eye(grid.n_cells), atol=1e-12)


def test_bilinear_by_hand():
    grid = Grid(np.zeros(2), np.ones(2), (2, 2), (False, False))
    assert_allclose(grid.weights(np.array([[0.25, 0.5]])).toarray(), [[0.375, 0.375, 0.125, 0.125]])


def test_a_circle_closes():
    grid = Grid(np.array([-np.pi]), np.array([np.pi]), (4,), (True,))
    assert_allclose(grid.vertices()[:, 0], [-np.pi, -np.pi / 2, 0, np.pi / 2])
    weights = grid.weights(np.array([[0.75 * np.pi], [-1.25 * np.pi], [2.75 * np.pi]])).toarray()
    assert_allclose(weights, [[0.5, 0, 0, 0.5]] * 3, atol=1e-12)
    assert not grid.outside(np.array([[99.0]])).any()


@given(st.integers(1, 6), st.integers(1, 3))
def test_gauss_hermite_integrates_polynomials(points, n):
    nodes, weights = gauss_hermite(points, n)
    assert_allclose(weights.sum(), 1.0)
    double_factorial = 1.0
    for degree in range(0, 2 * points, 2):
        assert_allclose(weights @ nodes[:, 0] ** degree, double_factorial, rtol=1e-10)
        double_factorial *= degree + 1


# ---------------------------------------------------------------- models


def test_a_line_by_hand():
    """Steps of .25 on vertices .5 apart: half and half; beyond 1 it is over, and nothing is paid there."""
    model = GridInterpolation((5,), **QUICK).build(Drift())
    assert model.over == 5
    table = model.mdp.transitions.toarray().reshape(6, 2, 6)
    assert_allclose(table[2, 1], [0, 0, 0.5, 0.5, 0, 0])
    assert_allclose(table[4, 1], [0, 0, 0, 0, 0, 1])
    assert_allclose(table[5], [[0, 0, 0, 0, 0, 1]] * 2)
    assert_allclose(model.mdp.rewards, [[-0.25, 0.25]] * 5 + [[0, 0]])
    assert model.mdp.absorbing()[5]
    assert_allclose(model.diagnostics["step_in_cells"], [0.5])
    assert_allclose(model.mdp.initial[2], 1 - 2 * 0.05, atol=0.005)  # E|s| = .05 on vertices .5 apart: 1 - .05/.5


def test_noise_by_quadrature():
    """The mean step is kept, and the variance is the noise's plus the interpolation's."""
    model = GridInterpolation((41,), noise_points=7, **QUICK).build(Drift(noise=0.1))
    row = model.mdp.transitions.toarray().reshape(42, 2, 42)[20, 1, :41]
    where = model.points[:, 0]
    assert_allclose(row @ where, 0.25, atol=1e-12)
    variance = row @ where**2 - 0.25**2
    assert 0.1**2 < variance < 0.1**2 + 0.25 * 0.05**2


def test_rewards_of_transitions_keep_the_mean():
    expected = GridInterpolation((9,), **QUICK).build(Drift(push=0.3))
    between = GridInterpolation((9,), **QUICK).build(Drift(push=0.3), rewards="transition")
    assert between.mdp.transition_rewards is not None
    assert_allclose(between.mdp.rewards, expected.mdp.rewards, atol=1e-12)
    further = GridInterpolation((9,), floor=0.2, reach=1, **QUICK)
    simulator = further.build(Drift(push=0.3), rewards="transition").mdp
    target = further.build(Drift(push=0.4)).mdp
    # a telescoping reward weighed with another task's transitions pays what that task pays, up to the shift of the mean
    moved = simulator.with_transitions(target.transitions)
    assert_allclose(moved.rewards[4] - simulator.rewards[4], [-0.08, 0.08], atol=1e-9)


def test_the_floor_reaches_what_lies_within_a_cell():
    plain = GridInterpolation((24, 24), **QUICK).build(CartPole())
    floored = GridInterpolation((24, 24), floor=1e-3, **QUICK).build(CartPole())
    difference = floored.mdp.transitions - 0.999 * plain.mdp.transitions
    assert_allclose(row_sums(difference.tocsr()), 1e-3, rtol=1e-9)
    for gravity in (5.0, 20.0):
        log = record(CartPole(gravity), cartpole_policy(0.5), n_transitions=4000, max_steps=60, seed=0)
        counts = floored.counts(log)
        oee.transition_ratio(counts, floored.mdp, prior="simulator", strength=1.0)  # or an error for support
        with pytest.raises(ValueError, match="it gives probability 0 to"):
            oee.transition_ratio(counts, plain.mdp)


def test_at_a_log_the_simulator_is_what_its_own_log_says():
    """With no weight for the vertex, the visited rows are the simulator's soft frequencies in the log's places."""
    task = CartPole(noise=0.0)
    log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=3000, max_steps=100, seed=0)
    model = GridInterpolation((24, 24), vertex_weight=0.0, **QUICK).build(task, at=log)
    counts = model.counts(resimulate(task, log))
    total = row_sums(counts)
    seen = total > 0
    rows = model.mdp.transitions.toarray()
    assert_allclose(rows[seen], counts.toarray()[seen] / total[seen, None], atol=1e-12)
    plain = GridInterpolation((24, 24), **QUICK).build(task)
    assert_allclose(rows[~seen], plain.mdp.transitions.toarray()[~seen], atol=1e-12)
    assert model.diagnostics["at_outside"] == 0
    assert model.metadata["at_rows"] == 3000


@pytest.mark.filterwarnings("ignore:log.terminated. .* ends do not show")
def test_off_environment_evaluation_of_cartpole():
    """The documented configuration: a small fraction of the simulator's error is left (the study has the figures)."""
    simulator, target = CartPole(10.0), CartPole(15.0)
    log = record(target, cartpole_policy(0.3), n_transitions=10_000, max_steps=100, seed=0)
    model = GridInterpolation((32, 32), floor=1e-3, **QUICK).build(simulator, at=log)
    zeta = oee.transition_ratio(model.counts(log), model.mdp, prior="simulator", strength=0.01)
    problem = oee.Problem(model.mdp, model.encode_log(log, seed=0), horizon=100)
    policy = cartpole_policy(0.4)
    pi = model.policy(policy)
    estimate = oee.estimators.OffEnvironment(zeta)(problem, pi)
    inside = oee.policy_value(model.mdp, pi, horizon=100)
    outside, truth = (monte_carlo_value(task, policy, 20_000, 100, seed=1) for task in (simulator, target))
    calibrated = calibrate(estimate, discretised=inside, continuous=outside.value)
    error = abs(calibrated.diagnostics["calibrated_value"] - truth.value)
    assert error < 0.25 * abs(outside.value - truth.value)
    assert calibrated.value == estimate.value


def test_closure_error():
    fine = GridInterpolation((100, 100), **QUICK).build(CartPole())
    assert abs(fine.closure().error) < 0.02
    with pytest.warns(
        UserWarning, match=r"8 x 8 grid .* is too coarse for the steps of CartPole: .*closure error of -"
    ) as caught:
        coarse = GridInterpolation((8, 8)).build(CartPole())
    assert caught[0].filename == __file__
    assert coarse.diagnostics["closure"].error < -0.1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        GridInterpolation((100, 100)).build(CartPole())


# ---------------------------------------------------------------- encoding


MODEL = GridInterpolation((16, 16), **QUICK).build(CartPole())
LOG = record(CartPole(), cartpole_policy(0.3), n_transitions=400, max_steps=50, seed=0)


def test_encoding_without_a_seed_takes_the_nearest_vertex():
    nearest = MODEL.encode(LOG.state)
    apart = np.abs(MODEL.points[nearest, 2:] - LOG.state[:, 2:]) / MODEL.cells.spacing
    assert apart.max() <= 0.5 + 1e-9
    falling = np.array([[0.0, 0.0, 0.3, 0.0]])
    assert MODEL.encode(falling)[0] == MODEL.over == 256
    assert MODEL.encode([[3.0, 0.0, 0.0, 0.0]])[0] < 256  # the end of the track does not show


def test_encoded_logs_have_soft_counts_in_the_mean():
    soft = MODEL.counts(LOG).toarray()
    assert_allclose(soft.sum(), len(LOG))
    drawn = sum(MODEL.encode_log(LOG, seed=seed).counts(257, 2).toarray() for seed in range(150)) / 150
    assert_allclose(drawn.sum(axis=1), soft.sum(axis=1), atol=2.5)
    assert np.abs(drawn - soft).max() < 6 * np.sqrt(soft.max() / 150)
    assert_allclose(soft[:, 256].sum(), LOG.terminated.sum())


def test_encoded_logs_keep_their_episodes():
    for seed in (None, 3):
        encoded = MODEL.encode_log(LOG, seed=seed)
        assert_array_equal(encoded.episode, LOG.episode)
        assert_array_equal(encoded.terminated, LOG.terminated)
        assert_array_equal(encoded.behavior_probability, LOG.behavior_probability)
        assert_array_equal(encoded.next_state[encoded.terminated], 256)
    assert_array_equal(MODEL.encode_log(LOG, seed=3).state, MODEL.encode_log(LOG, seed=3).state)


def test_a_log_without_flags_ends_where_the_task_does():
    bare = ContinuousTransitions(LOG.state, LOG.action, LOG.next_state)
    assert_array_equal(MODEL.encode_log(bare).terminated, LOG.terminated)


def test_the_end_of_the_track_does_not_show_in_the_angle():
    states = np.array([[2.39, 1.0, 0.0, 0.0], [0.0, 0.0, 0.2, 2.0]])
    moved = CartPole(noise=0.0).moves(states, np.array([1, 1]), np.zeros((2, 4)))
    log = ContinuousTransitions(states, [1, 1], moved.next_state, terminated=moved.terminated, episode=[0, 1])
    assert log.terminated.all()
    with pytest.warns(
        UserWarning, match=r"1 of 2 ends do not show in the features \(theta, theta_dot\); the first, row 0"
    ):
        encoded = MODEL.encode_log(log)
    assert_array_equal(encoded.terminated, [False, True])
    assert_array_equal(encoded.truncated, [True, False])
    full = GridInterpolation((3, 3, 3, 3), low=(-3, -3, -0.3, -3), high=(3, 3, 0.3, 3), **QUICK).build(
        CartPole(form="full")
    )
    assert full.encode_log(log).terminated.all()


def test_states_outside_are_named_and_counted():
    fast = np.array(LOG.state)
    fast[7, 3] = 5.0
    fast[9, 3] = -6.0
    bag = ContinuousTransitions(fast, LOG.action, LOG.next_state, terminated=LOG.terminated)
    text = r"log.state must be inside the 16 x 16 grid .*: 2 of 400 rows are not; the first, row 7, is at theta=.*, theta_dot=5"
    with pytest.raises(ValueError, match=text):
        MODEL.encode_log(bag)
    with pytest.warns(UserWarning, match=text + ".* moved to the nearest place inside"):
        assert len(MODEL.encode_log(bag, outside="nearest")) == 400
    with pytest.warns(UserWarning, match=text + ".* left out"):
        assert len(MODEL.encode_log(bag, outside="drop")) == 398
    with pytest.warns(UserWarning, match="left out"):
        assert_allclose(MODEL.counts(bag, outside="drop").sum(), 398)
    built = GridInterpolation((16, 16), **QUICK).build(CartPole(), at=bag)
    assert built.diagnostics["at_outside"] == 2


def test_files(tmp_path):
    path = tmp_path / "cartpole.npz"
    MODEL.save(path)
    loaded = Discretization.load(path, CartPole())
    assert_array_equal(loaded.mdp.transitions.toarray(), MODEL.mdp.transitions.toarray())
    assert_array_equal(loaded.mdp.rewards, MODEL.mdp.rewards)
    assert_array_equal(loaded.encode(LOG.state), MODEL.encode(LOG.state))
    assert_array_equal(loaded.policy(cartpole_policy(0.3)), MODEL.policy(cartpole_policy(0.3)))
    assert loaded.metadata == MODEL.metadata | {"version": oee.__version__}
    with pytest.raises(
        ValueError, match=r"task must have the parameters of .*'gravity': 10.0.*; it has .*'gravity': 15.0"
    ):
        Discretization.load(path, CartPole(15.0))
    line = GridInterpolation((9,), **QUICK).build(Drift(), rewards="transition")
    line.save(path)
    again = Discretization.load(path, Drift())
    assert_array_equal(again.mdp.reward_data, line.mdp.reward_data)


# ---------------------------------------------------------------- cells of visited states


FULL = CartPole(form="full")
VISITED = visited_states([FULL, CartPole(15.0, form="full")], [cartpole_policy(0.3), cartpole_policy(1.0)], 20_000,
                         max_steps=100, seed=0)  # fmt: skip
CELLS = VisitedCells(500, seed=1).build(FULL, VISITED)


def test_cells_agree_with_monte_carlo():
    policy = cartpole_policy(0.3)
    value = oee.policy_value(CELLS.mdp, CELLS.policy(policy), horizon=100)
    mc = monte_carlo_value(FULL, policy, 5000, 100, seed=0)
    assert_allclose(value, mc.value, rtol=0.1)


def test_cells_are_the_same_for_every_task():
    target = VisitedCells(500, seed=1).build(CartPole(15.0, form="full"), VISITED)
    assert_array_equal(target.cells.centres, CELLS.cells.centres)
    assert_array_equal(target.point_cell, CELLS.point_cell)
    given_cells = VisitedCells(500, seed=1).build(FULL, VISITED, cells=CELLS.cells)
    assert_array_equal(given_cells.mdp.transitions.data, CELLS.mdp.transitions.data)


def test_a_policy_in_a_cell_is_its_mean():
    pi = CELLS.policy(cartpole_policy(0.3))
    inside = CELLS.points[CELLS.point_cell == 7]
    assert_allclose(pi[7], cartpole_policy(0.3)(inside).mean(axis=0))
    assert_allclose(pi[CELLS.over], 0.5)


def test_cells_encode_logs(tmp_path):
    log = record(FULL, cartpole_policy(0.3), n_transitions=500, max_steps=100, seed=9)
    encoded = CELLS.encode_log(log, outside="nearest")
    assert_array_equal(encoded.counts(CELLS.mdp.n_states, 2).toarray(), CELLS.counts(log, outside="nearest").toarray())
    away = np.array([[50.0, 0.0, 0.0, 0.0]])
    assert CELLS.cells.outside(away).all()
    CELLS.save(tmp_path / "cells.npz")
    loaded = Discretization.load(tmp_path / "cells.npz", FULL)
    assert_array_equal(loaded.encode(log.state, outside="nearest"), encoded.state)


def test_a_floor_around_cells():
    floored = VisitedCells(500, seed=1, floor=0.01, neighbours=6).build(FULL, VISITED)
    assert_array_equal(floored.cells.centres, CELLS.cells.centres)
    assert_allclose(row_sums(floored.mdp.transitions), 1.0)
    apart = floored.mdp.transitions - 0.99 * CELLS.mdp.transitions
    assert apart.min() >= -1e-15
    assert_allclose(apart.sum(axis=1)[:-2], 0.01)
    assert floored.mdp.absorbing()[floored.over]
    assert (floored.mdp.transitions.toarray()[:, floored.over] > 0).all()


def test_cells_know_rewards_of_moves():
    line = Drift()
    model = VisitedCells(20, seed=0).build(line, np.linspace(-1, 1, 2001)[:, None], rewards="transition")
    plain = VisitedCells(20, seed=0).build(line, np.linspace(-1, 1, 2001)[:, None])
    assert_allclose(model.mdp.rewards, plain.mdp.rewards, atol=1e-12)
    assert_allclose(model.mdp.rewards[:20], [[-0.25, 0.25]] * 20, atol=1e-9)


# ---------------------------------------------------------------- other tasks, mixtures


def pendulum(**changes):
    def write(env, state):
        env.unwrapped.state = np.array(state)

    options = {
        "state_names": ("angle", "speed"),
        "get_state": lambda env: env.unwrapped.state,
        "set_state": write,
        "actions": [[-2.0], [0.0], [2.0]],
        "low": [-np.pi, -8.0],
        "high": [np.pi, 8.0],
        "periodic": (True, False),
        "terminates": False,
    }
    return GymnasiumTask(lambda: gymnasium.make("Pendulum-v1"), **(options | changes))


def test_pendulum_through_gymnasium():
    """A task that is not ours: the grid's value of a policy against stepping Gymnasium itself."""
    task = pendulum()
    model = GridInterpolation((61, 61), **QUICK).build(task)
    assert model.over is None
    assert model.mdp.n_states == 61 * 61

    def swing(states):
        push = np.where(states[:, 1] > 0, 2, 0)
        return 0.2 / 3 + 0.8 * np.eye(3)[push]

    closure = model.closure(swing, horizon=30, n_episodes=60)
    assert abs(closure.error) < 0.03 + 3 * closure.standard_error
    log = task.record(swing, n_transitions=100, max_steps=40, seed=0)
    assert_array_equal(np.flatnonzero(log.truncated), [39, 79, 99])
    assert_array_equal(resimulate(task, log).next_state, log.next_state)
    assert len(model.encode_log(log, seed=0)) == 100
    commands = ContinuousTransitions(log.state, 2.0 * (log.action[:, None] - 1.0), log.next_state)
    assert abs(model.counts(commands, strict=True) - model.counts(log)).max() == 0


def test_a_defensive_mixture_has_the_others_support():
    build = GridInterpolation((60, 60), **QUICK).build
    simulator, low, high = (build(CartPole(g)) for g in (10.0, 5.0, 20.0))
    mixed = defensive_mixture(simulator, [low, high], epsilon=0.2)
    expected = 0.8 * simulator.mdp.transitions + 0.1 * low.mdp.transitions + 0.1 * high.mdp.transitions
    assert abs(mixed.mdp.transitions - expected).max() < 1e-15
    assert mixed.metadata["defensive"]["epsilon"] == 0.2
    ratio = oee.true_ratio(low.mdp, mixed.mdp)  # supported, and bounded by K / epsilon
    assert ratio.values.data.max() <= 10.0 + 1e-9
    with pytest.raises(ValueError, match="it gives probability 0 to"):
        oee.true_ratio(low.mdp, simulator.mdp)


# ---------------------------------------------------------------- bad calls

ANGLE = CartPole()


def edited(column, row, value):
    changed = np.array(LOG.columns()[column])
    changed[row] = value
    return ContinuousTransitions(**(LOG.select(np.arange(len(LOG))).columns() | {column: changed}))


class Nan(Drift):
    def moves(self, states, actions, disturbance):
        moved = super().moves(states, actions, disturbance)
        return replace(moved, next_state=np.where(states == 0.0, np.nan, moved.next_state))


BAD = {
    "no shape": (lambda: GridInterpolation(60), r"shape must be a tuple of positive integers; got 60"),
    "one vertex": (lambda: GridInterpolation((60, 1)), r"shape must have at least 2 vertices .*; it is \(60, 1\)"),
    "half a vertex": (lambda: GridInterpolation((60, 1.5)), r"shape must be a positive integer; got 1.5"),
    "another number of features": (
        lambda: GridInterpolation((9, 9, 9)).build(CartPole()),
        r"shape must have 2 numbers, one for each feature of CartPole \(theta, theta_dot\); it is \(9, 9, 9\)",
    ),
    "low above high": (
        lambda: GridInterpolation((9, 9), low=(0.0, 3.2)).build(CartPole()),
        r"high\[1\] must be above low\[1\], 3.2; it is 3.2",
    ),
    "a nan end": (lambda: GridInterpolation((9, 9), low=(0.0, np.nan)).grid(ANGLE), r"low\[1\] must be finite; it is nan"),
    "ends of another length": (lambda: GridInterpolation((9, 9), high=(1.0,)).grid(ANGLE), r"high must have shape \(2,\)"),
    "floor": (lambda: GridInterpolation((9, 9), floor=1.5), r"floor must be in \[0, 1\]; it is 1.5"),
    "reach": (lambda: GridInterpolation((9, 9), reach=0), r"reach must be a positive integer; it is 0"),
    "noise points": (
        lambda: GridInterpolation((9, 9), noise_points=(3, 3)).build(CartPole()),
        r"noise_points must be a number or 4 numbers, one for each disturbance; it is \(3, 3\)",
    ),
    "rewards": (lambda: GridInterpolation((9, 9)).build(ANGLE, rewards="all"), r"rewards must be one of 'expected', 'tr"),
    "no reward between": (
        lambda: GridInterpolation((9, 9)).build(CartPole(), rewards="transition"),
        r"rewards must be 'expected' for CartPole, which has no reward_between",
    ),
    "a step to nowhere": (
        lambda: GridInterpolation((5,)).build(Nan()),
        r"task must step to finite states; from \[0.0\] under action 0 it steps to \[nan\]",
    ),
    "states of another dimension": (
        lambda: MODEL.encode(np.zeros((3, 2))),
        r"states must have shape \(n, 4\), the x, x_dot, theta, theta_dot of CartPole; it has shape \(3, 2\)",
    ),
    "nan states": (lambda: MODEL.encode([[0, 0, np.nan, 0]]), r"states\[0, 2\] must be finite; it is nan"),
    "a log of another dimension": (
        lambda: MODEL.encode_log(ContinuousTransitions(np.zeros((3, 2)), [0, 0, 0], np.zeros((3, 2)))),
        r"log.state must have the 4 coordinates of CartPole \(x, x_dot, theta, theta_dot\); it has 2",
    ),
    "a finite log": (
        lambda: MODEL.counts(oee.Transitions([0], [0], [0])),
        r"log must be ContinuousTransitions; got Transitions",
    ),
    "an action outside": (lambda: MODEL.counts(edited("action", 3, 2)), r"log.action\[3\] must be in 0..1, .*; it is 2"),
    "a state that is over": (
        lambda: MODEL.counts(edited("state", 5, [0.0, 0.0, 0.5, 0.0])),
        r"log.state\[5\] must be a state in which CartPole goes on; it is over in \[0.0, 0.0, 0.5, 0.0\] \(1 such rows",
    ),
    "a next state outside": (
        lambda: MODEL.counts(edited("next_state", 5, [0.0, 0.0, 0.0, 9.0])),
        r"log.next_state must be inside .*: 1 of 400 rows are not; the first, row 5, is at theta=0, theta_dot=9",
    ),
    "outside": (lambda: MODEL.encode_log(LOG, outside="clip"), r"outside must be one of 'error', 'nearest', .*; got 'clip'"),
    "termination of what does not end": (
        lambda: GridInterpolation((9,), **QUICK).build(Drift(circle=True)).counts(
            ContinuousTransitions([[0.0]], [0], [[0.1]], terminated=[True])
        ),
        r"log.terminated\[0\] must be False: episodes of Drift do not end; it is True",
    ),
    "no cells": (lambda: VisitedCells(0), r"n_cells must be a positive integer; it is 0"),
    "floor without rewards": (
        lambda: VisitedCells(5, floor=0.1).build(FULL, VISITED[:99], rewards="transition"),
        r"floor must be 0 with rewards 'transition': its moves have none; it is 0.1",
    ),
    "visited dimension": (lambda: VisitedCells(5).build(FULL, np.zeros((9, 2))), r"visited must have shape \(n, 4\)"),
    "visited over": (
        lambda: VisitedCells(5).build(FULL, np.ones((9, 4))),
        r"visited must have states in which CartPole goes on; it has none",
    ),
    "cells without states": (
        lambda: VisitedCells(5).build(FULL, VISITED[:10], cells=CELLS.cells),
        r"visited must have a state in every cell; \d+ cells have none, the first is \d+",
    ),
    "no tasks": (lambda: visited_states([], [half], 5, max_steps=5, seed=0), r"tasks and policies must have at least one each"),
    "no others": (lambda: defensive_mixture(MODEL, []), r"others must have at least one Discretization; it has none"),
    "others on another grid": (
        lambda: defensive_mixture(MODEL, [CELLS]),
        r"others\[0\] must have the simulator's rows and states, \(514, 257\); it has \(",
    ),
    "an action that the environment has not": (
        lambda: pendulum(actions=[[-3.0]]),
        r"actions\[0\] must be in Box\(-2.0, 2.0, \(1,\), float32\); it is \[-3.0\]",
    ),
    "state names": (lambda: pendulum(state_names=("a",)), r"get_state must return the 1 numbers .*; it returns shape \(2,\)"),
    "a state that is not set": (
        lambda: pendulum(set_state=lambda env, state: setattr(env.unwrapped, "state", state + 1)),
        r"set_state must set what get_state reads; .* became",
    ),
    "low": (lambda: pendulum(low=[0.0]), r"low must have shape \(2,\), one for each of state_names; it has shape \(1,\)"),
    "make": (lambda: GymnasiumTask(5, state_names=(), get_state=half, set_state=half, actions=[0], low=[], high=[]),
             r"make must be a function; got int"),
}  # fmt: skip


@pytest.mark.parametrize(("call", "text"), BAD.values(), ids=BAD)
def test_bad_calls(call, text):
    with pytest.raises(ValueError, match=text):
        call()


@given(st.integers(2, 12), st.integers(2, 12), st.floats(0.0, 1.0), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_every_grid_of_cartpole_is_a_finite_mdp(rows, columns, floor, seed):
    log = record(CartPole(12.0), half, n_transitions=60, max_steps=30, seed=seed)
    model = GridInterpolation((rows, columns), floor=floor, **QUICK).build(CartPole(), at=log)
    assert model.mdp.n_states == rows * columns + 1
    assert_allclose(row_sums(model.mdp.transitions), 1.0, atol=1e-12)
    value = oee.policy_value(model.mdp, model.policy(half), horizon=50)
    assert 0 < value <= sum(0.99**t for t in range(50)) + 1e-9


def test_cells_of_a_discretization(tmp_path):
    path = tmp_path / "cells.npz"
    cells = {"grid_low": -np.ones(2), "grid_high": np.ones(2)}
    cells |= {"grid_shape": np.full(2, 4), "grid_periodic": np.zeros(2, bool)}
    metadata = task_metadata(CartPole())
    chain = oee.FiniteMDP(np.full((17, 2, 17), 1 / 17), np.zeros(17), np.full(17, 1 / 17), 0.9)
    good = chain.arrays() | cells | {"points": np.zeros((3, 4)), "point_cell": np.array([0, 1, 15])}
    good |= {"metadata": np.array(json.dumps(metadata))}
    save_npz(path, "finite_mdp", good)
    assert Discretization.load(path, CartPole()).cells.n_cells == 16
    for changes, text in (
        ({"grid_low": -np.ones(3)}, "must have a number for each coordinate"),
        ({"grid_shape": np.full(2, 2**32)}, r"cells must be at most 17, .*; they are 18446744073709551616 of 2"),
        ({"grid_high": -np.ones(2)}, "grid_low must be finite and below grid_high"),
        ({"point_cell": np.array([0, 1, 16])}, r"point_cell must be in 0\.\.15; it is 0 to 16"),
        ({"points": np.zeros((3, 3))}, r"points must have shape \(n, 4\)"),
        ({"metadata": np.array("{")}, r"Expecting property name"),
    ):
        save_npz(path, "finite_mdp", good | changes)
        with pytest.raises(ValueError, match=rf"cells\.npz'.*{text}"):
            Discretization.load(path, CartPole())
