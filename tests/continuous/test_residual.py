"""A simulator corrected by a log: against own truths, its parts against plain numpy,
and the stops that it finds.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.continuous.correction.neighbors import Neighbors
from oee_tabular.continuous.correction.regression import (
    Functions,
    Grams,
    episode_groups,
)
from oee_tabular.continuous.correction.sentences import odd_row
from oee_tabular.continuous.correction.stops import find_stops
from oee_tabular.continuous.task.episodes import compare_returns
from oee_tabular.data import ContinuousTransitions
from oee_tabular.lab.experiments import classic
from oee_tabular.lab.experiments.classic import Plain
from oee_tabular.tasks import (
    CartPole,
    ContinuousTask,
    HistoryTask,
    Moves,
    ResidualSimulator,
    cartpole_policy,
    corrected_value,
    discretize,
    monte_carlo_value,
    record,
)

# ---------------------------------------------------------------- own targets


CARTPOLES = {
    "gravity": classic.ChangedCartPole(12.5),
    "pole": classic.ChangedCartPole(10.0, pole=1.3),
    "wind": classic.ChangedCartPole(10.0, push=0.5),
    "gusts": classic.ChangedCartPole(10.0, gusts=0.1),
    "all": classic.ChangedCartPole(
        11.3, pole=1.3, force=0.8, joint=2e-4, cart=0.05, gusts=0.03
    ),
}


def cartpole_log(target, n=6000, seed=0):
    return record(
        target, cartpole_policy(0.3), n_transitions=n, max_steps=100, seed=seed
    )


def value(task, policy, episodes, horizon):
    """By random numbers that belong to the episode and the step: tasks that are alike
    go alike.
    """
    return compare_returns(
        [task], policy, episodes, horizon, discount=0.99, seed=np.random.SeedSequence(1)
    ).mean()


def errors(target, corrected, simulator, episodes, deltas=(0.0, 0.5)):
    """(2, policies) of the simulator and of the corrected one."""
    rows = []
    for delta in deltas:
        truth, before, after = (
            0.01 * value(task, cartpole_policy(delta), episodes, 100)
            for task in (target, simulator, corrected)
        )
        rows.append([before - truth, after - truth])
    return np.abs(np.array(rows)).T


@pytest.mark.parametrize("change", CARTPOLES)
def test_cartpole(change):
    """Nothing is tuned: one setting for every change. Other noise has other paths: more
    of Monte Carlo's error is left.
    """
    target = CARTPOLES[change]
    corrected = ResidualSimulator(CartPole(10.0), cartpole_log(target, 3000), seed=0)
    before, after = errors(
        target, corrected, CartPole(10.0), 4000 if target.gusts else 500
    )
    assert after.mean() < (0.003 if target.gusts else 0.0005)
    assert after.mean() < 0.5 * before.mean()
    assert not any(c.hidden for c in corrected.coordinates)
    assert corrected.coordinates[3].differs


def test_an_unchanged_target_is_the_simulator_to_the_last_bit():
    task = CartPole(10.0)
    corrected = ResidualSimulator(task, cartpole_log(task), seed=0)
    assert [c.kind for c in corrected.coordinates] == ["zero"] * 5
    assert [c.scatter for c in corrected.coordinates] == ["simulator"] * 4 + ["none"]
    assert not any(c.differs or c.hidden for c in corrected.coordinates)
    rng = np.random.default_rng(0)
    states = rng.normal(size=(50, 4)) / 10
    actions = rng.integers(2, size=50)
    xi = rng.normal(size=(50, 4))
    assert corrected.n_disturbances == 4
    mine = corrected.moves(states, actions, xi)
    own = task.moves(states, actions, xi)
    assert_allclose(mine.next_state, own.next_state, rtol=0, atol=1e-15)
    assert_array_equal(mine.terminated, own.terminated)
    values = [
        monte_carlo_value(t, cartpole_policy(0.3), 500, 100, seed=0).value
        for t in (task, corrected)
    ]
    assert values[0] == values[1]  # common random numbers


def test_pendulum():
    """The environment's steps are Gymnasium's (test_experiments.py)."""
    target = classic.Pendulum(mass=1.2, gravity=11.0)
    simulator = classic.Pendulum()
    log = record(
        target, classic.swinging(0.3), n_transitions=4000, max_steps=200, seed=0
    )
    corrected = ResidualSimulator(simulator, log, seed=0)
    assert corrected._stops.bounds[0, 1] == -8.0
    assert corrected._stops.bounds[1, 1] == 8.0
    for delta in (0.1, 0.5):
        policy = classic.swinging(delta)
        truth, found, before = (
            value(task, policy, 200, 200) for task in (target, corrected, simulator)
        )
        assert abs(found - truth) < 0.1 * abs(before - truth)
    stepped = corrected.moves(
        np.array([[3.0, 7.99], [3.0, -7.99]]), np.array([2, 0]), np.zeros((2, 1))
    ).next_state
    assert np.abs(stepped[:, 1]).max() <= 8.0


class Unknowing(classic.MountainCar):
    """Steps end, but no state tells whether it is over."""

    def moves(self, states, actions, disturbance):
        return classic.MountainCar(self.gravity, self.force).moves(
            states, actions, disturbance
        )

    def terminated(self, states):
        return np.zeros(len(states), dtype=bool)


@pytest.mark.parametrize(
    ("simulator", "within"), [(classic.MountainCar(), 0.001), (Unknowing(), 0.1)]
)
def test_mountain_car(simulator, within):
    """The wall is a stop; where the task cannot say which states are over, the nearest
    known one does.
    """
    target = classic.MountainCar(0.0027, 0.0009)
    log = record(
        target, classic.rocking(0.3), n_transitions=4000, max_steps=200, seed=0
    )
    corrected = ResidualSimulator(simulator, log, seed=0)
    assert corrected._knows_ends == (not isinstance(simulator, Unknowing))
    assert corrected._stops.bounds[0, 0] == -1.2
    for delta in (0.1, 0.5):
        policy = classic.rocking(delta)
        truth, found, before = (
            value(task, policy, 100, 200) for task in (target, corrected, simulator)
        )
        assert abs(found - truth) < within * abs(before - truth)


# ---------------------------------------------------------------- tasks on the line


class Line(ContinuousTask):
    """s' = s + push + drift(s) + noise xi; paid by where it leads."""

    def __init__(
        self,
        drift=lambda s, a: 0.0,
        noise=0.0,
        *,
        knows_reward=True,
        wall=np.inf,
        end=np.inf,
    ):
        self.name = "Line"
        self.state_names = ("s",)
        self.feature_names = ("s",)
        self.actions = np.array([-0.25, 0.25])
        self.n_disturbances = 1
        self.feature_low = np.array([-2.0])
        self.feature_high = np.array([2.0])
        self.periodic = (False,)
        self.terminates = np.isfinite(end)
        self.drift = drift
        self.noise = noise
        self.knows_reward = knows_reward
        self.wall = wall
        self.end = end

    def moves(self, states, actions, disturbance):
        shift = self.actions[actions] + self.drift(states[:, 0], actions)
        following = np.clip(
            states + shift[:, None] + self.noise * disturbance, -self.wall, self.wall
        )
        return Moves(
            following, following[:, 0] - states[:, 0], self.terminated(following)
        )

    def initial_states(self, n, rng):
        return rng.uniform(-1.0, 1.0, (n, 1))

    def terminated(self, states):
        return (np.abs(states) > self.end).any(axis=1)

    def reward_between(self, states, actions, next_states):
        return next_states[:, 0] - states[:, 0] if self.knows_reward else None


def half(states):
    return np.full((len(states), 2), 0.5)


def line_log(target, n=2000, seed=0, steps=20):
    return record(target, half, n_transitions=n, max_steps=steps, seed=seed)


class OneSided(Line):
    """Line whose noise only pushes to the right, abs(xi): its mean is not 0."""

    def moves(self, states, actions, disturbance):
        return super().moves(states, actions, np.abs(disturbance))


@pytest.mark.parametrize(
    ("simulator", "scatter"), [(Line, "simulator"), (OneSided, "log")]
)
def test_noise_of_the_same_size_and_another_mean_is_not_the_simulator_s(
    simulator, scatter
):
    """abs(xi) and xi have the root mean square 1, and the means 0.8 and 0."""
    log = line_log(Line(noise=0.1))
    corrected = ResidualSimulator(simulator(noise=0.1), log, seed=0)
    assert corrected.coordinates[0].scatter == scatter


@pytest.mark.parametrize(
    ("drift", "kind", "per_action"),
    [
        (lambda s, a: 0.1 + 0.0 * s, "mean", False),
        (lambda s, a: -0.1 * s, "linear", False),
        (lambda s, a: 0.1 * a * s, "linear", True),
        (lambda s, a: np.where(a == 1, 0.1, -0.2) * np.sin(3 * s), "Fourier", None),
    ],
)
def test_the_simplest_class_that_does(drift, kind, per_action):
    corrected = ResidualSimulator(
        Line(noise=0.01), line_log(Line(drift, noise=0.01)), seed=0
    )
    learned = corrected.coordinates[0]
    assert learned.kind == kind
    if per_action is not None:
        assert learned.per_action == per_action
    assert learned.scatter == "simulator"
    assert learned.explained > 0.8
    rng = np.random.default_rng(1)
    states = rng.uniform(-1, 1, (200, 1))
    actions = rng.integers(2, size=200)
    found = corrected.moves(states, actions, np.zeros((200, 1))).next_state
    right = Line(drift).moves(states, actions, np.zeros((200, 1))).next_state
    assert np.sqrt(((found - right) ** 2).mean()) < 0.005


def test_a_correction_stays_within_the_residuals_that_were_logged():
    """They are -.3 and .3; the fit alone reaches .97; what it leaves, which is drawn,
    adds to what is cut off.
    """
    target = Line(lambda s, a: np.where(s > 0, 0.3, -0.3), knows_reward=False)
    simulator = Line(knows_reward=False)
    corrected = ResidualSimulator(
        simulator, line_log(target, 100, seed=2, steps=4), seed=0
    )
    for reach in (3.0, 50.0):
        states = np.linspace(-reach, reach, 2001)[:, None]
        actions = np.zeros(2001, dtype=int)
        added = corrected.moves(
            states, actions, np.zeros((2001, corrected.n_disturbances))
        ).next_state - (states - 0.25)
        assert 0.3 < np.abs(added).max() < 0.45


def test_a_reward_that_the_task_cannot_tell_is_learned():
    """r = s' - s where only the step knows it: the simulator's misses the drift."""
    target = Line(lambda s, a: -0.3 * s)
    simulator = Line(knows_reward=False)
    corrected = ResidualSimulator(simulator, line_log(target), seed=0)
    states = np.linspace(-0.8, 0.8, 30)[:, None]
    actions = np.arange(30) % 2
    found, right = (
        t.moves(states, actions, np.zeros((30, t.n_disturbances)))
        for t in (corrected, target)
    )
    assert_allclose(found.reward, right.reward, atol=1e-5)
    assert corrected.coordinates[-1].name == "reward"
    assert len(ResidualSimulator(Line(), line_log(target), seed=0).coordinates) == 1


def test_noise_is_drawn_from_the_log_where_it_is_another():
    target = Line(noise=0.05)
    corrected = ResidualSimulator(Line(noise=0.01), line_log(target, 6000), seed=0)
    assert (corrected.coordinates[0].scatter, corrected.n_disturbances) == ("log", 2)
    assert corrected._scatter.near is None
    states = np.zeros((20_000, 1))
    actions = np.ones(20_000, dtype=np.int64)
    spread = (
        corrected.step(states, actions, np.random.default_rng(0)).next_state[:, 0]
        - 0.25
    )
    assert_allclose([spread.mean(), spread.std()], [0.0, 0.05], atol=0.0015)


class Gusty(Line):
    def moves(self, states, actions, disturbance):
        return super().moves(
            states, actions, disturbance * np.where(states > 0, 5.0, 0.5)
        )


@pytest.mark.parametrize("kind", [Line, Gusty])
def test_noise_is_the_simulator_s_own_where_it_is_alike(kind):
    """Whether a step is linear in it or not."""
    task = kind(noise=0.02)
    corrected = ResidualSimulator(task, line_log(task, 3000), seed=0)
    assert corrected.coordinates[0].scatter == "simulator"
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, (500, 1))
    actions = rng.integers(2, size=500)
    xi = rng.standard_normal((500, 1))
    found, still = (
        corrected.moves(states, actions, x).next_state for x in (xi, 0.0 * xi)
    )
    right, rest = (task.moves(states, actions, x).next_state for x in (xi, 0.0 * xi))
    assert_allclose(found - still, right - rest, rtol=0, atol=1e-14)


def test_noise_that_depends_on_the_place_is_drawn_near_by():
    corrected = ResidualSimulator(
        Line(noise=0.01), line_log(Gusty(noise=0.02), 6000), seed=0
    )
    assert corrected._scatter.near is not None
    for place, right in ((-0.7, 0.01), (0.7, 0.1)):
        states = np.full((4000, 1), place) + np.random.default_rng(1).uniform(
            -0.2, 0.2, (4000, 1)
        )
        moved = corrected.step(
            states, np.zeros(4000, dtype=np.int64), np.random.default_rng(0)
        ).next_state
        assert_allclose((moved - states).std(), right, rtol=0.2)


def test_an_action_that_was_never_logged_has_the_others_correction():
    log = line_log(Line(lambda s, a: 0.1 + 0 * s, noise=0.02))
    corrected = ResidualSimulator(Line(), log.select(log.action == 0), seed=0)
    moved = corrected.step(
        np.zeros((4000, 1)), np.ones(4000, dtype=np.int64), np.random.default_rng(0)
    ).next_state
    assert_allclose(moved.mean(), 0.35, atol=0.002)


@pytest.mark.parametrize("n", [1, 2, 5, 30])
def test_a_handful_of_transitions(n):
    corrected = ResidualSimulator(
        CartPole(10.0), cartpole_log(CartPole(15.0), n), seed=0
    )
    value = monte_carlo_value(
        corrected, cartpole_policy(0.3), 200, 100, seed=0, normalized=True
    ).value
    assert 0.0 < value < 0.64


def test_everything_goes_on_from_there():
    """Cells of the corrected simulator; a log of it; corrected again, nothing is left."""
    target = CARTPOLES["gravity"]
    corrected = ResidualSimulator(CartPole(10.0), cartpole_log(target, 3000), seed=0)
    model, right = (
        discretize(task, cells=(40, 40), closure_episodes=0)
        for task in (corrected, CartPole(12.5))
    )
    values = [
        oee.policy_value(
            m.mdp, m.policy(cartpole_policy(0.4)), horizon=100, normalized=True
        )
        for m in (model, right)
    ]
    assert_allclose(values[0], values[1], atol=0.002)
    again = ResidualSimulator(corrected, cartpole_log(corrected, 2000, seed=1), seed=0)
    assert all(c.explained < 0.01 for c in again.coordinates)
    assert corrected.parameters()["gravity"] == 10.0
    assert corrected.parameters()["corrected_by_moves"] == 3000


def test_the_explained_share_counts_every_row():
    """Rows that g was not fitted to, contacts, are left over all the same."""
    log = line_log(Line(lambda s, a: 0.1 * s, noise=0.01), 1000)
    columns = log.columns()
    columns["next_state"] = (
        columns["next_state"] + np.where(np.arange(1000) % 20 == 0, 2.0, 0.0)[:, None]
    )
    for name in ("episode", "timestep", "truncated"):
        columns[name] = None
    learned = ResidualSimulator(
        Line(noise=0.01), ContinuousTransitions(**columns), seed=0
    ).coordinates[0]
    assert learned.kind == "linear"
    assert_allclose(
        learned.explained,
        1.0 - (learned.left_over / learned.residual_scatter) ** 2,
        atol=0.001,
    )
    assert learned.explained < 0.5


def test_a_value_s_standard_error_has_the_rollouts_noise_in_it():
    """sqrt(log^2 + rollouts^2), which the rows of a report say."""
    target = Line(lambda s, a: 0.1 * s, noise=0.2)
    corrected = ResidualSimulator(Line(noise=0.2), line_log(target, 500), seed=0)
    found = {
        n: corrected_value(corrected, half, n, 10, refits=5, paths=50, seed=0)
        for n in (50, 800)
    }
    for n, estimate in found.items():
        facts = estimate.diagnostics
        rollouts = monte_carlo_value(corrected, half, n, 10, seed=0)
        assert facts["standard_error_of"] == "log and rollouts"
        assert facts["n_rollouts"] == n
        both = np.hypot(facts["standard_error_of_the_log"], rollouts.standard_error)
        assert_allclose(estimate.standard_error, both, rtol=0.15)  # other rollouts
    assert found[50].standard_error > found[800].standard_error


def test_the_standard_error_by_refits_is_unbiased(monkeypatch):
    """The deviation of the refits' values, each less the value by the same chance."""
    target = Line(lambda s, a: 0.1 * s, noise=0.2)
    corrected = ResidualSimulator(Line(noise=0.2), line_log(target, 300), seed=0)
    returns = np.array([[1.0, 3.0], [2.0, 4.0], [5.0, 3.0]])

    def compare(tasks, *given, **options):
        return returns if len(tasks) == 3 else compare_returns(tasks, *given, **options)

    monkeypatch.setattr(
        "oee_tabular.continuous.evaluation.rollouts.compare_returns", compare
    )
    found = corrected_value(corrected, half, 50, 5, refits=2, paths=2, seed=0)
    # means of 3 and 4 in place of 2
    assert_allclose(found.diagnostics["standard_error_of_the_log"], 0.5**0.5)


# ---------------------------------------------------------------- its parts, in plain
# numpy


def regression(n=300, seed=0):
    """Functions, their arguments on rows, targets, groups and which rows are used."""
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(n, 1))
    actions = rng.integers(2, size=n)
    displacement = np.sin(states) + rng.normal(size=(n, 1)) / 10
    targets = np.column_stack(
        [states[:, 0] * actions + rng.normal(size=n) / 10, np.cos(3 * states[:, 0])]
    )
    arguments = states, actions, displacement, None
    return (
        Functions(Line(), *arguments, rng),
        arguments,
        targets,
        np.arange(n) % 9,
        np.arange(n) % 7 > 0,
    )


def test_values_are_sums_of_functions_row_by_row():
    """Whatever rows stand beside a row, and beyond the log as at its edge."""
    functions, arguments, targets, group, used = regression(1000)
    fits = Grams(functions, arguments, targets, group, used).choose()
    w = functions.stack(fits)
    phi = functions(*arguments)
    states, actions, displacement, _ = arguments
    right = np.stack([phi[:, : w.shape[1]][i] @ w[a] for i, a in enumerate(actions)])
    ends = np.array([[-np.inf, -0.5], [np.inf, 0.5]])
    found = functions.predict(*arguments[:3], w, ends)
    assert_allclose(found, np.clip(right, *ends), atol=1e-12)
    # a log's own commands, here those of its actions, lead to the same
    commands = Line().actions.reshape(-1, 1)[actions].astype(float)
    own = functions.predict(*arguments[:3], w, ends, commands)
    assert_allclose(own, found, atol=1e-12)
    some = np.arange(7, 500, 3)
    assert_array_equal(
        functions.predict(states[some], actions[some], displacement[some], w, ends),
        found[some],
    )
    k = states[:, 0].argmax(), displacement[:, 0].argmax()
    edge = states[k[:1], :], np.array([1]), displacement[k[1:], :]
    assert_array_equal(functions(*edge), functions(edge[0] + 10, edge[1], edge[2] + 10))
    assert_array_equal(
        functions.predict(*edge, w, ends),
        functions.predict(edge[0] + 10, edge[1], edge[2] + 10, w, ends),
    )


def test_groups_are_of_whole_episodes():
    episode = np.repeat(np.arange(100), 7)
    group = episode_groups(episode, 700, 50, 2)
    assert group.max() == 39
    assert all(len(np.unique(group[episode == k])) == 1 for k in range(100))
    assert episode_groups(episode, 700, 3000, 9).max() == 7  # memory
    assert len(np.unique(episode_groups(None, 700, 50, 2))) == 40


def test_refits_vary_as_other_logs_do():
    """Bootstrap of the drift's mean against the mean over logs."""
    target = Line(lambda s, a: 0.1 + 0 * s, noise=0.2)

    def shift(task):
        return task.moves(
            np.zeros((1, 1)), np.array([1]), np.zeros((1, task.n_disturbances))
        ).next_state[0, 0]

    found = [
        shift(ResidualSimulator(Line(noise=0.2), line_log(target, 500, seed=k), seed=0))
        for k in range(20)
    ]
    one = ResidualSimulator(Line(noise=0.2), line_log(target, 500), seed=0)
    again = [shift(one.resampled(k)) for k in range(40)]
    assert 0.5 < np.std(again) / np.std(found) < 2.0
    assert shift(one) == shift(
        ResidualSimulator(Line(noise=0.2), line_log(target, 500), seed=0)
    )


@pytest.mark.parametrize("target", [Line(noise=0.05), Gusty(noise=0.02)])
def test_a_refit_draws_no_residual_of_an_episode_that_it_leaves_out(target):
    """Neither from all rows nor from those near by."""
    corrected = ResidualSimulator(Line(), line_log(target, 2000, steps=100), seed=0)
    assert (corrected._scatter.near is not None) == isinstance(target, Gusty)
    quantiles = np.column_stack(
        [np.zeros(4000), np.random.default_rng(0).normal(size=4000)]
    )
    states = np.linspace(-0.9, 0.9, 4000)[:, None]

    def n_outcomes(task):
        moved = task.moves(states, np.ones(4000, dtype=np.int64), quantiles).next_state
        return len(np.unique(np.round(moved - states, 12)))

    assert n_outcomes(corrected.resampled(0)) < 0.85 * n_outcomes(corrected)


def test_a_row_on_which_every_value_rests_is_named():
    columns = record(
        CartPole(15.0), cartpole_policy(0.3), n_transitions=800, max_steps=100, seed=0
    ).columns()
    log = ContinuousTransitions(**columns)
    assert odd_row(ResidualSimulator(CartPole(10.0), log, seed=0)) == ""
    following = columns["next_state"].copy()
    following[-1, 3] += 50.0
    said = odd_row(
        ResidualSimulator(
            CartPole(10.0),
            ContinuousTransitions(**(columns | {"next_state": following})),
            seed=0,
        )
    )
    assert said.startswith(
        " Row 799 of the log alone makes 100% of the unexplained residual in “theta_dot”"
        " (by 50"
    )


# ---------------------------------------------------------------- stops


class Cart(Plain):
    """Pushed between two walls: who gets there stands still, and loses a share of what
    else turns.
    """

    name = "Cart"
    state_names = feature_names = ("place", "speed", "spin")
    actions = np.array([-1.0, 1.0])
    feature_low = np.full(3, -2.0)
    feature_high = np.full(3, 2.0)
    periodic = (False,) * 3
    terminates = False

    def __init__(self, force=1.0, wall=1.0, loss=0.5):
        self.force = force
        self.wall = wall
        self.loss = loss

    def moves(self, states, actions, disturbance):
        speed = states[:, 1] + 0.1 * self.force * self.actions[actions]
        place = states[:, 0] + 0.1 * speed
        over = np.abs(place) >= self.wall
        spin = 0.95 * states[:, 2] - over * self.loss * speed
        place = np.clip(place, -self.wall, self.wall)
        speed = np.where(over, 0.0, speed)
        following = np.stack([place, speed, spin], axis=1)
        return Moves(following, -(place**2), np.zeros(len(states), dtype=np.bool_))

    def initial_states(self, n, rng):
        return rng.uniform(-0.7, 0.7, (n, 3))


def evenly(states):
    return np.full((len(states), 2), 0.5)


def one_step(target, simulator, n=6000):
    """Errors of the simulator and of the corrected one on new moves of the target, and
    where the two are stopped.
    """
    log = record(target, evenly, n_transitions=n, max_steps=25, seed=0)
    corrected = ResidualSimulator(simulator, log, seed=0)
    new = record(target, evenly, n_transitions=4000, max_steps=25, seed=1)
    actions = new.action_numbers(target.actions)
    xi = np.zeros((4000, corrected.n_disturbances))
    right = new.next_state
    own = simulator.moves(new.state, actions, xi).next_state
    found = corrected.moves(new.state, actions, xi).next_state
    stopped = np.abs(right[:, 0]) == 1.0, np.abs(own[:, 0]) == 1.0
    return np.abs(own - right), np.abs(found - right), stopped, corrected


@pytest.mark.parametrize("force", [0.5, 2.0])
def test_a_stop_is_the_corrected_step_s_not_the_simulator_s(force):
    before, after, (there, here), _ = one_step(Cart(force), Cart())
    assert (there != here).sum() > 20
    # those that just come to the wall
    assert (after[there | here, :2].max(axis=1) > 1e-6).mean() < 0.1
    assert before[there != here, 1].max() > 0.5
    assert after[~there & ~here].max() < 1e-6  # free steps know nothing of the walls


def test_what_is_lost_at_a_stop_pushes_the_others_as_the_log_says():
    _, after, (there, _), corrected = one_step(Cart(0.8, loss=0.25), Cart(loss=0.5))
    for push in corrected._pushes.values():
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
    moved = corrected.step(
        states, np.ones(4000, dtype=np.int64), np.random.default_rng(0)
    ).next_state
    assert_allclose(moved[:, 2].std(), 0.95 * 0.05, rtol=0.06)


def test_a_stop_of_another_place():
    _, after, _, corrected = one_step(Cart(0.8, wall=0.95), Cart())
    assert_array_equal(corrected._stops.target[:, 0], [-0.95, 0.95])
    assert_array_equal(corrected._stops.own[:, 0], [-1.0, 1.0])
    assert np.median(after.max(axis=1)) < 1e-4


# ---------------------------------------------------------------- what is a stop


def found(following, own=None, is_angle=None, is_memory=None):
    none = np.zeros(following.shape[1], dtype=bool)
    own = following if own is None else own
    angles = none if is_angle is None else np.array(is_angle)
    memory = none if is_memory is None else np.array(is_memory)
    return find_stops(np.zeros_like(following), following, own, angles, memory)


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


@pytest.mark.parametrize("far", [np.inf, -np.inf, np.nan, 1e200, 1e308])
def test_states_that_grow_without_end_have_neighbours(far):
    states = np.random.default_rng(0).normal(size=(20, 4))
    states[:, 3] = 1.0  # the same in all
    neighbors = Neighbors(CartPole(10.0), states)
    rows = np.arange(5, 20)
    far_off = Neighbors(CartPole(10.0), 1e6 + 0.02 * states)  # no centre is needed
    near = far_off.find(1e6 + 0.02 * states[:5], np.arange(20), key=0)
    assert_array_equal(near, np.arange(5))
    for k in (1, 3):
        found = neighbors.find(np.full((2, 4), far), rows, k, key=0)
        assert np.isin(found, rows).all()


def test_last_actions_have_no_stops_and_are_not_held():
    """A command at its limit repeats a value exactly, as a wall does."""
    values = moved()
    assert found(values, is_memory=[True, False]).held == {}
    assert np.isinf(found(values, is_memory=[True, False]).bounds).all()
    # all rows at the wall have the same last action; others may reach it as well
    alike = np.column_stack([values, values[:, 0] > 0, values[:, 0] < 0])
    both = found(alike, is_memory=[False, False, True, True]).held
    assert both == {(0, 0): ([1], [0.0]), (1, 0): ([1], [0.0])}
    assert list(found(alike).held[1, 0][0]) == [1, 2, 3]


def test_the_simulator_s_stop_is_the_target_s_where_the_log_does_not_pass_it():
    short = (
        0.9 * moved(wall=2.0).clip(-1.0, 1.0) - 1e-3 * np.arange(2000)[:, None] / 2000
    )
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
