"""A continuous task as a finite MDP: the laws of its rows, encoded logs, what
discretising costs, bad calls.
"""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular.continuous.discretization.build import (
    GridInterpolation,
    VisitedCells,
    discretize,
)
from oee_tabular.continuous.discretization.cells import Grid
from oee_tabular.data import ContinuousTransitions
from oee_tabular.tasks import (
    CartPole,
    ContinuousTask,
    Moves,
    Reacher,
    cartpole_policy,
    gymnasium_simulator,
    kinova,
    reacher_policy,
    record,
    resimulate,
)

QUICK = {"closure_episodes": 0}
seeds = st.integers(0, 2**32 - 1)


class Drift(ContinuousTask):
    """s' = s + push + noise xi on the line; over beyond 1 unless it circles."""

    def __init__(self, circle=False, push=0.25, noise=0.0):
        self.name = "Drift"
        self.state_names = ("s",)
        self.feature_names = ("s",)
        self.actions = np.array([-push, push])
        self.n_disturbances = 1
        self.noise = noise
        self.feature_low = np.array([-1.0])
        self.feature_high = np.array([1.0])
        self.periodic = (circle,)
        self.terminates = not circle

    def moves(self, states, actions, disturbance):
        following = states + self.actions[actions][:, None] + self.noise * disturbance
        return Moves(
            following, following[:, 0] - states[:, 0], self.terminated(following)
        )

    def initial_states(self, n, rng):
        return rng.uniform(-0.1, 0.1, (n, 1))

    def terminated(self, states):
        return (
            np.abs(states[:, 0]) > 1.0
            if self.terminates
            else np.zeros(len(states), dtype=bool)
        )


def half(states):
    return np.full((len(states), 2), 0.5)


def dense(model):
    n_states = model.mdp.n_states
    n_actions = model.mdp.n_actions
    return model.mdp.transitions.toarray().reshape(n_states, n_actions, n_states)


# ---------------------------------------------------------------- the grid's weights


@st.composite
def grids(draw):
    k = draw(st.integers(1, 3))
    shape = tuple(draw(st.integers(2, 6)) for _ in range(k))
    low = np.array([draw(st.integers(-5, 5)) for _ in range(k)], dtype=float)
    width = np.array([draw(st.integers(1, 8)) for _ in range(k)], dtype=float)
    return Grid(low, low + width, shape, (False,) * k)


@given(grids(), seeds)
def test_weights_are_a_distribution_that_keeps_the_point(grid, seed):
    points = np.random.default_rng(seed).uniform(
        grid.low, grid.high, (20, len(grid.shape))
    )
    weights = grid.weights(points)
    assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-14)
    assert weights.data.min() > 0
    assert np.diff(weights.indptr).max() <= 2 ** len(grid.shape)
    assert_allclose(weights @ grid.vertices(), points, atol=1e-12)
    assert_allclose(
        grid.weights(grid.vertices()).toarray(), np.eye(grid.n_cells), atol=1e-12
    )
    assert not grid.outside(points).any()
    assert grid.outside(grid.high + 1e-3 * (grid.high - grid.low) + 0 * points).all()


def test_a_circle_closes():
    grid = Grid(np.array([-np.pi]), np.array([np.pi]), (4,), (True,))
    assert_allclose(grid.vertices()[:, 0], [-np.pi, -np.pi / 2, 0, np.pi / 2])
    weights = grid.weights(
        np.array([[0.75 * np.pi], [-1.25 * np.pi], [2.75 * np.pi]])
    ).toarray()
    assert_allclose(weights, [[0.5, 0, 0, 0.5]] * 3, atol=1e-12)
    assert not grid.outside(np.array([[99.0]])).any()


# ---------------------------------------------------------------- models on grids


def test_a_line_by_hand():
    """Steps of .25 on vertices .5 apart: half and half; beyond 1 it is over, and
    nothing is paid there.
    """
    model = discretize(Drift(), cells=(5,), **QUICK)
    assert model.over == 5
    table = dense(model)
    assert_allclose(table[2, 1], [0, 0, 0.5, 0.5, 0, 0])
    assert_allclose(table[4, 1], [0, 0, 0, 0, 0, 1])
    assert_allclose(table[5], [[0, 0, 0, 0, 0, 1]] * 2)
    assert_allclose(model.mdp.rewards, [[-0.25, 0.25]] * 5 + [[0, 0]])
    assert model.mdp.absorbing()[5]
    # E|s| = .05 on vertices .5 apart: 1 - .05/.5
    assert_allclose(model.mdp.initial[2], 1 - 2 * 0.05, atol=0.005)


def test_noise_by_quadrature():
    """The mean step is kept, and the variance is the noise's plus the interpolation's."""
    model = discretize(
        Drift(noise=0.1), cells=GridInterpolation((41,), noise_points=7), **QUICK
    )
    row = dense(model)[20, 1, :41]
    where = model.points[:, 0]
    assert_allclose(row @ where, 0.25, atol=1e-12)
    variance = row @ where**2 - 0.25**2
    assert 0.1**2 < variance < 0.1**2 + 0.25 * 0.05**2


def test_default_cells_follow_the_number_of_features():
    assert discretize(Drift(), **QUICK).mdp.n_states == 202
    assert discretize(CartPole(), **QUICK).mdp.n_states == 32 * 32 + 1
    assert discretize(kinova.ideal_hand(), **QUICK).cells.shape == (25, 25, 21)
    few = VisitedCells(1000, n_simulated=2000, n_stepped=2000)
    assert discretize(CartPole(form="full"), cells=few, **QUICK).mdp.n_states == 1001


def assert_floor(model, log, floor):
    """A share of pairs with impossible logged transitions lies on these, and nothing
    else is another.
    """
    apart = (model.mdp.transitions - model.plain.transitions).toarray()
    changed = np.abs(apart).sum(axis=1) > 0
    assert changed.any()
    assert_allclose(np.maximum(apart, 0.0).sum(axis=1)[changed], floor, rtol=1e-9)
    assert_allclose(model.mdp.rewards, model.plain.rewards)
    counts = model.counts(log, outside="nearest")
    assert (
        model.supported(counts)[1]
        == 0.0
        < replace(model, mdp=model.plain).supported(counts)[1]
    )
    assert model.metadata["floor"] == floor


@given(seeds)
@settings(max_examples=5)
@pytest.mark.filterwarnings("ignore:log.*state must be inside")
def test_a_floor_is_a_share_of_the_log_s_impossible_transitions(seed):
    log = record(CartPole(15.0), half, n_transitions=300, max_steps=60, seed=seed)
    assert_floor(
        discretize(CartPole(), log, cells=(60, 60), floor=1e-3, **QUICK), log, 1e-3
    )


def test_copies_of_a_state_on_two_sides_of_an_edge_are_one():
    model = discretize(Drift(), cells=(81,), **QUICK)
    log = ContinuousTransitions(
        [[-0.25], [0.0125 + 1e-8]], [1, 1], [[0.0125 - 1e-8], [0.2625]], episode=[0, 0]
    )
    encoded = model.encode(log)
    assert encoded.state[1] == encoded.next_state[0]


def test_at_a_log_the_simulator_is_what_its_own_log_says():
    """With no weight for the vertex, the visited rows are the simulator's soft
    frequencies in the log's places.
    """
    task = CartPole(noise=0.0)
    log = record(
        CartPole(15.0), cartpole_policy(0.3), n_transitions=3000, max_steps=100, seed=0
    )
    model = discretize(
        task, log, cells=GridInterpolation((24, 24), vertex_weight=0.0), **QUICK
    )
    counts = model.counts(resimulate(task, log))
    total = counts.sum(axis=1)
    seen = total > 0
    rows = model.mdp.transitions.toarray()
    assert_allclose(rows[seen], counts.toarray()[seen] / total[seen, None], atol=1e-12)
    plain = discretize(task, cells=(24, 24), **QUICK)
    assert_allclose(rows[~seen], plain.mdp.transitions.toarray()[~seen], atol=1e-12)


def test_closure_error():
    error, noise = discretize(CartPole(), cells=(100, 100), **QUICK).closure_error()
    assert abs(error) < 0.02
    assert noise < 0.02
    with pytest.warns(
        UserWarning,
        match=(
            r"8 x 8 grid .* is too coarse for the steps of CartPole: .*closure error of"
            r" -.*theta_dot 0"
        ),
    ) as caught:
        coarse = discretize(CartPole(), cells=(8, 8))
    assert caught[0].filename == __file__
    assert coarse.diagnostics["closure_error"] < -0.1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        discretize(CartPole(), cells=(100, 100))


# ---------------------------------------------------------------- encoding

MODEL = discretize(CartPole(), cells=(16, 16), **QUICK)
LOG = record(CartPole(), cartpole_policy(0.3), n_transitions=400, max_steps=50, seed=0)


@pytest.mark.parametrize("seed", [None, 0])
def test_no_states_have_no_numbers(seed):
    assert MODEL.encode_states(np.empty((0, 4)), seed=seed).shape == (0,)


def test_encoding_without_a_seed_takes_the_nearest_vertex():
    nearest = MODEL.encode_states(LOG.state)
    apart = np.abs(MODEL.points[nearest, 2:] - LOG.state[:, 2:]) / MODEL.cells.spacing
    assert apart.max() <= 0.5 + 1e-9
    falling = np.array([[0.0, 0.0, 0.3, 0.0]])
    assert MODEL.encode_states(falling)[0] == MODEL.over == 256
    # the end of the track does not show
    assert MODEL.encode_states([[3.0, 0.0, 0.0, 0.0]])[0] < 256


def test_encoded_logs_have_soft_counts_in_the_mean():
    soft = MODEL.counts(LOG).toarray()
    assert_allclose(soft.sum(), len(LOG))
    drawn = (
        sum(
            MODEL.encode(LOG, seed=seed).counts(257, 2).toarray() for seed in range(150)
        )
        / 150
    )
    assert_allclose(drawn.sum(axis=1), soft.sum(axis=1), atol=2.5)
    assert np.abs(drawn - soft).max() < 6 * np.sqrt(soft.max() / 150)
    assert_allclose(soft[:, 256].sum(), LOG.terminated.sum())


def test_encoded_logs_keep_their_episodes():
    for seed in (None, 3):
        encoded = MODEL.encode(LOG, seed=seed)
        assert_array_equal(encoded.episode, LOG.episode)
        assert_array_equal(encoded.terminated, LOG.terminated)
        assert_array_equal(encoded.behavior_probability, LOG.behavior_probability)
        assert_array_equal(encoded.next_state[encoded.terminated], 256)
    assert_array_equal(MODEL.encode(LOG, seed=3).state, MODEL.encode(LOG, seed=3).state)
    # without flags it ends where the task does
    bare = ContinuousTransitions(LOG.state, LOG.action, LOG.next_state)
    assert_array_equal(MODEL.encode(bare).terminated, LOG.terminated)


def test_the_end_of_the_track_does_not_show_in_the_angle():
    states = np.array([[2.39, 1.0, 0.0, 0.0], [0.0, 0.0, 0.2, 2.0]])
    moved = CartPole(noise=0.0).moves(states, np.array([1, 1]), np.zeros((2, 4)))
    log = ContinuousTransitions(
        states, [1, 1], moved.next_state, terminated=moved.terminated, episode=[0, 1]
    )
    assert log.terminated.all()
    with pytest.warns(
        UserWarning,
        match=(
            r"1 of 2 ends do not show in the features \(theta, theta_dot\); the first,"
            r" row 0"
        ),
    ):
        encoded = MODEL.encode(log)
    assert_array_equal(encoded.terminated, [False, True])
    assert_array_equal(encoded.truncated, [True, False])
    coarse = GridInterpolation(
        (3, 3, 3, 3), low=(-3, -3, -0.3, -3), high=(3, 3, 0.3, 3)
    )
    full = discretize(CartPole(form="full"), cells=coarse, **QUICK)
    assert full.encode(log).terminated.all()


def test_states_outside_are_named_and_counted():
    fast = np.array(LOG.state)
    fast[[7, 9], 3] = 5.0, -6.0
    bag = ContinuousTransitions(
        fast, LOG.action, LOG.next_state, terminated=LOG.terminated
    )
    text = (
        r"log.state must be inside the 16 x 16 grid .*: 2 of 400 rows are not; the"
        r" first, row 7, is at theta=.*, theta_dot=5"
    )
    with pytest.raises(ValueError, match=text):
        MODEL.encode(bag)
    for outside, told, n in (
        ("nearest", "moved to the nearest place inside", 400),
        ("drop", "left out", 398),
    ):
        for number in (
            lambda o: len(MODEL.encode(bag, outside=o)),
            lambda o: MODEL.counts(bag, outside=o).sum(),
        ):
            with pytest.warns(UserWarning, match=f"{text}.* {told}"):
                assert_allclose(number(outside), n)


@given(seeds)
def test_what_is_supported_lies_where_there_is_probability(seed):
    rng = np.random.default_rng(seed)
    shape = MODEL.mdp.transitions.shape
    counts = sparse.random_array(shape, density=0.01, rng=rng)
    kept, lost = MODEL.supported(sparse.csr_array(counts))
    inside = counts.toarray() * (MODEL.mdp.transitions.toarray() > 0)
    assert_array_equal(kept.toarray(), inside)
    assert_allclose(lost, 1 - inside.sum() / counts.sum(), atol=1e-12)


# ---------------------------------------------------------------- cells of visited
# states

FULL = CartPole(form="full")
SMALL = VisitedCells(500, n_simulated=20_000, n_stepped=20_000)
POLICIES = [cartpole_policy(0.3), cartpole_policy(1.0)]
CELLS = discretize(FULL, cells=SMALL, policies=POLICIES, seed=1, **QUICK)


def test_cells_agree_with_monte_carlo():
    policy = cartpole_policy(0.3)
    error, _ = CELLS.closure_error(policy, n_episodes=5000)
    assert abs(error) < 0.1
    pi = CELLS.policy(policy)
    inside = CELLS.points[CELLS.places.point_cell == 7]
    assert_allclose(pi[7], policy(inside).mean(axis=0))
    assert_allclose(pi[CELLS.over], 0.5)


def test_another_task_on_the_same_cells():
    other = discretize(CartPole(15.0, form="full"), cells=CELLS, **QUICK)
    assert other.places is CELLS.places
    same = discretize(FULL, cells=CELLS, **QUICK)
    assert_array_equal(same.mdp.transitions.data, CELLS.mdp.transitions.data)
    assert abs(other.mdp.transitions - same.mdp.transitions).max() > 0.01


def test_cells_encode_logs_and_rows_are_where_the_log_s_states_lead():
    log = record(FULL, cartpole_policy(0.3), n_transitions=500, max_steps=100, seed=9)
    encoded = CELLS.encode(log, outside="nearest")
    assert_array_equal(
        encoded.counts(CELLS.mdp.n_states, 2).toarray(),
        CELLS.counts(log, outside="nearest").toarray(),
    )
    assert CELLS.cells.outside(np.array([[50.0, 0.0, 0.0, 0.0]])).all()
    silent = CartPole(noise=0.0, form="full")
    own = discretize(
        silent, log, cells=VisitedCells(50, n_simulated=100, n_stepped=100), **QUICK
    )
    resimulated = own.counts(resimulate(silent, log), outside="nearest")
    assert own.supported(resimulated)[1] == 0.0


def test_a_floor_around_cells():
    log = record(
        CartPole(15.0), cartpole_policy(0.3), n_transitions=2000, max_steps=100, seed=9
    )
    floored = discretize(
        FULL, log, cells=SMALL, policies=POLICIES, floor=0.01, seed=1, **QUICK
    )
    assert_floor(floored, log, 0.01)
    assert floored.mdp.absorbing()[floored.over]


# ---------------------------------------------------------------- several simulators in
# one support


def test_a_mixture_has_the_others_support():
    low = CartPole(5.0)
    high = CartPole(20.0)
    model = discretize(
        CartPole(), cells=(60, 60), floor=0.2, others=[low, high], **QUICK
    )
    own, first, second = (part.transitions for part in model.simulators)
    assert (
        abs(model.mdp.transitions - (0.8 * own + 0.1 * first + 0.1 * second)).max()
        < 1e-15
    )
    assert model.metadata["floor"] == 0.2
    without = replace(model, mdp=model.plain)
    # what cells cost, not a floor
    assert model.closure_error(n_episodes=100) == without.closure_error(n_episodes=100)
    assert [other["gravity"] for other in model.metadata["others"]] == [5.0, 20.0]
    ratio = oee.true_ratio(discretize(low, cells=model, **QUICK).mdp, model.mdp)
    assert ratio.values.data.max() <= 10.0 + 1e-9  # K / floor
    with pytest.raises(ValueError, match="gives probability 0 to"):
        oee.true_ratio(model.simulators[1], model.plain)
    only = model.mixture([0.0, 0.0, 1.0])
    assert abs(only.mdp.transitions - second).max() < 1e-15


ARM = Reacher(0.1, reward_length=0.05)
RUNS = record(
    Reacher(0.05), reacher_policy(0.5), n_transitions=2000, max_steps=25, seed=0
)
LENGTHS = discretize(
    ARM,
    RUNS,
    cells=VisitedCells(100, n_simulated=500, n_stepped=1000, max_steps=25),
    floor=0.8,
    policies=[reacher_policy(0.3)],
    **QUICK,
)


def test_the_length_is_found_by_the_convex_risk():
    """Lengths times .5 to 2: of a log of the half, nothing is uncovered and its length
    has all the weight.
    """
    counts = LENGTHS.counts(RUNS, outside="nearest")
    assert LENGTHS.supported(counts)[1] == 0.0
    weights = LENGTHS.fit_weights(counts)
    assert_allclose(
        [other["length"] for other in LENGTHS.metadata["others"]],
        [0.05, 0.07, 0.14, 0.2],
    )
    assert weights[1] > 0.95
    risks = [
        -counts.data
        @ np.log(
            np.asarray(
                LENGTHS.mixture(w).mdp.transitions[counts.tocoo().coords]
            ).ravel()
        )
        for w in (weights, (0.2,) * 5, 0.9 * weights + 0.02)
    ]
    assert risks[0] == min(risks)
    plain = replace(LENGTHS, simulators=(LENGTHS.plain,))
    with pytest.raises(
        ValueError,
        match=(
            r"counts must have transitions that some simulator allows; \(\d+, \d+,"
            r" \d+\) is"
        ),
    ):
        plain.fit_weights(counts)


def test_rewards_telescope_on_cells():
    """A loop pays nothing but the motors' cost: the potential's mean over a cell is
    taken once, and cancels.
    """
    rewards = LENGTHS.mdp.transition_rewards
    distance = LENGTHS.places.mean(ARM.distance(LENGTHS.points))
    matrix = LENGTHS.mdp.transitions.tocoo()
    (rows, columns) = matrix.coords
    idle = 4
    of_idle = rows % 9 == idle
    paid = np.asarray(rewards[rows[of_idle], columns[of_idle]]).ravel()
    at_stop = LENGTHS.places.mean(
        (np.abs(np.abs(LENGTHS.points[:, 1]) / 3.0 - 1.0) < 0.01).astype(float)
    )
    expected = (
        100 * (distance[rows[of_idle] // 9] - distance[columns[of_idle]])
        - 0.1 * at_stop[columns[of_idle]]
    )
    assert_allclose(paid, expected, atol=1e-12)
    # the reward belongs to the transition, whoever makes it
    other = LENGTHS.mixture([0.0, 1.0, 0.0, 0.0, 0.0]).mdp
    there = other.transitions.tocoo().coords
    assert_allclose(
        np.asarray(other.transition_rewards[there]),
        np.asarray(rewards[there]),
        atol=1e-12,
    )


# ---------------------------------------------------------------- commands that move
# the features alike everywhere


def test_tied_counts_recover_the_target_s_displacement():
    # vertices two steps apart
    model = discretize(kinova.ideal_hand(), cells=(13, 13, 11), floor=0.1, **QUICK)
    log = kinova.record_goals(kinova.ideal_hand(1.4), n_runs=4, delta=0.3, seed=0)
    counts, uncovered = model.supported(model.counts(log))
    assert uncovered < 0.02
    assert_allclose(counts.sum(), (1 - uncovered) * len(log))
    zeta = oee.transition_ratio(
        counts, model.mdp, tie=model.displacement_ties(), strength=0.1
    )
    target = zeta.target_model(model.mdp)
    places = model.cells.vertices()
    middle = model.mdp.n_states // 2
    often = np.flatnonzero(
        np.asarray(counts.sum(axis=1)).reshape(-1, 27).sum(axis=0) > 20
    )
    for a in often:
        mean = target.transitions[[middle * 27 + a]] @ places - places[middle]
        assert_allclose(mean[0] / 0.02, 1.4 * kinova.COMMANDS[a], atol=0.15)
    moved = ContinuousTransitions(
        [places[middle] + 0.004], [26], [places[middle] + 0.014]
    )
    row = model.counts(moved)[[middle * 27 + 26]]
    # carried to the vertex, its displacement kept
    assert_allclose((row @ places)[0], places[middle] + 0.01)
    with pytest.raises(
        ValueError,
        match="cells must be a grid without an absorbing state to tie displacements",
    ):
        MODEL.displacement_ties()


def test_the_hand_on_visited_cells_counts_transitions_where_they_are():
    log = kinova.record_goals(kinova.ideal_hand(), n_runs=2, delta=0.3, seed=0)
    cells = VisitedCells(40, n_simulated=300, n_stepped=300, max_steps=25)
    model = discretize(kinova.ideal_hand(), log, cells=cells, **QUICK)
    assert_allclose(
        (model.counts(log) - model.encode(log).counts(*model.mdp.rewards.shape)).data,
        0.0,
        atol=1e-12,
    )


def test_costs_and_policies_are_means_over_a_box():
    model = discretize(kinova.ideal_hand(), **QUICK)
    goal = kinova.GOALS[0]
    places = model.cells.vertices()
    at = int(np.argmin(np.linalg.norm(places - goal, axis=1)))
    line = 0.02 * ((np.arange(4) + 0.5) / 4 - 0.5)
    box = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    assert_allclose(
        model.mdp.rewards[at], -np.linalg.norm(box, axis=1).mean(), atol=1e-12
    )
    beside = int(np.argmin(np.linalg.norm(places - goal + [0.02, 0, 0], axis=1)))
    pi = model.policy(kinova.kinova_policy(0))
    assert_allclose(
        pi[[at, beside]][:, [13, 22]], [[1.0, 0.0], [0.25, 0.75]], atol=1e-12
    )
    error, _ = model.closure_error(kinova.kinova_policy(0, 0.3), horizon=25)
    assert abs(error) < 0.06


# ---------------------------------------------------------------- a task that is not
# ours


def test_pendulum_through_gymnasium():
    """The grid's value of a policy against stepping Gymnasium itself."""
    task = gymnasium_simulator("Pendulum-v1", actions=3).task
    model = discretize(task, cells=(61, 61), **QUICK)
    assert model.over is None
    assert model.mdp.n_states == 61 * 61

    def swing(states):
        push = np.where(states[:, 1] > 0, 2, 0)
        return 0.2 / 3 + 0.8 * np.eye(3)[push]

    error, noise = model.closure_error(swing, horizon=30, n_episodes=60)
    assert abs(error) < 0.03 + 3 * noise
    log = task.record(swing, n_transitions=100, max_steps=40, seed=0)
    assert np.bincount(log.episode).tolist() == [40, 40, 20]
    assert_allclose(
        log.behavior_probability, swing(log.state)[np.arange(100), log.action]
    )
    assert_array_equal(np.flatnonzero(log.truncated), [39, 79, 99])
    assert_array_equal(resimulate(task, log).next_state, log.next_state)
    assert len(model.encode(log, seed=0)) == 100
    commands = ContinuousTransitions(
        log.state, 2.0 * (log.action[:, None] - 1.0), log.next_state
    )
    assert abs(model.counts(commands) - model.counts(log)).max() == 0


def test_a_discretization_is_of_a_task_with_its_actions():
    model = discretize(Drift(), **QUICK)
    with pytest.raises(ValueError, match="task must have the MDP's"):
        replace(model, task=Reacher())
