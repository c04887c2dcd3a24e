"""The changes that nobody tuned for: their dynamics against Gymnasium's, one small case of each kind, and what is drawn."""

from dataclasses import replace

import gymnasium
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular.continuous.kinova import ideal_hand
from oee_tabular.lab import experiments
from oee_tabular.lab.experiment import Stream, summary_of
from oee_tabular.lab.experiments import changes, classic
from oee_tabular.lab.experiments.changes import CASES, Delayed
from oee_tabular.lab.experiments.kinova import towards
from oee_tabular.tasks import (
    CartPole,
    HistoryTask,
    Reacher,
    ResidualSimulator,
    corrected_value,
    monte_carlo_value,
    record,
)


def places(task, n=200, seed=0):
    rng = np.random.default_rng(seed)
    low, high = np.resize(task.feature_low, task.n_state), np.resize(task.feature_high, task.n_state)
    return rng.uniform(low, high, (n, task.n_state)), rng.integers(task.n_actions, size=n)


# ---------------------------------------------------------------- dynamics


GYMNASIUMS = [
    ("Pendulum-v1", classic.Pendulum(1.2, 1.1, 9.0), {"m": 1.2, "l": 1.1, "g": 9.0}),
    ("MountainCar-v0", classic.MountainCar(0.0027, 0.0009), {"gravity": 0.0027, "force": 0.0009}),
    ("Acrobot-v1", classic.Acrobot(1.2, 1.3, 1.15),
     {"LINK_MASS_1": 1.2, "LINK_MASS_2": 1.3, "LINK_LENGTH_1": 1.15, "LINK_COM_POS_1": 0.575}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "task", "changes"), GYMNASIUMS)
def test_a_step_is_gymnasium_s(name, task, changes):
    env = gymnasium.make(name).unwrapped
    again = [np.array((env.reset(seed=k), env.state)[1]) for k in range(50)]
    for parameter, value in changes.items():
        assert hasattr(env, parameter)
        setattr(env, parameter, value)
    states, actions = places(task)
    moved = task.moves(states, actions, np.zeros((len(states), 0)))
    for i, (state, a) in enumerate(zip(states, actions, strict=True)):
        env.state = np.array(state)
        _, reward, over, _, _ = env.step(task.actions[[a]] if name == "Pendulum-v1" else int(a))
        assert_allclose(moved.next_state[i], env.state, rtol=0, atol=1e-10)
        assert_allclose(moved.reward[i], reward)
        assert moved.terminated[i] == over
    starts = task.initial_states(500, np.random.default_rng(0))
    assert (np.min(again, axis=0) >= starts.min(axis=0) - 0.1).all()
    assert (np.max(again, axis=0) <= starts.max(axis=0) + 0.1).all()


def test_cartpole_with_everything_as_it_was():
    states, actions = places(CartPole(10.0, form="full"))
    xi = np.random.default_rng(1).standard_normal((len(states), 4))
    found, right = (task.moves(states, actions, xi) for task in (classic.ChangedCartPole(10.0), CartPole(10.0)))
    assert_allclose(found.next_state, right.next_state, rtol=0, atol=1e-14)
    assert_array_equal(found.terminated, right.terminated)
    for change in ("pole", "force", "joint", "cart", "push", "gusts"):
        other = replace(classic.ChangedCartPole(10.0), **{change: 0.5}).moves(states, actions, xi)
        assert np.abs(other.next_state - right.next_state).max() > 1e-6


def test_a_chain_without_friction_keeps_its_energy():
    task = classic.Chain(friction=0.0, noise=0.0)
    states = 0.3 * task.initial_states(50, np.random.default_rng(0))

    def energy(states):
        stretched = np.diff(states[:, :4], axis=1, prepend=0.0, append=0.0)
        held = task.stiffness * (stretched**2 / 2 + task.hardness * stretched**4 / 4).sum(axis=1)
        return held + 0.5 * task.mass * (states[:, 4:] ** 2).sum(axis=1)

    before = energy(states)
    for _ in range(100):
        states = task.moves(states, np.ones(50, dtype=np.int64), np.zeros((50, 4))).next_state
    assert_allclose(energy(states), before, rtol=0.1)


def test_a_delayed_task_does_what_was_asked_before():
    task = Delayed(CartPole(10.0, noise=0.0))
    states = np.column_stack([np.zeros((3, 4)), [[0, 0], [1, 0], [0, 1]]])
    moved = task.step(states, np.array([1, 1, 0]), np.random.default_rng(0))
    right = CartPole(10.0, noise=0.0).moves(np.zeros((3, 4)), np.array([1, 0, 1]), np.zeros((3, 4)))
    assert_array_equal(moved.next_state[:, :4], right.next_state)
    assert_array_equal(moved.next_state[:, 4:], [[0, 1], [0, 1], [1, 0]])


def test_a_corrected_arm_aims_elsewhere():
    hand = ideal_hand(1.0, scatter=0.0)
    log = record(
        ideal_hand(1.4, scatter=0.0), lambda s: np.full((len(s), 27), 1 / 27), n_episodes=2, max_steps=25, seed=0
    )
    other = towards(ResidualSimulator(hand, log, seed=0), 3)
    assert_allclose(other.reward_between(log.state, log.action, log.next_state), hand.towards(3).costs(log.state))


# ---------------------------------------------------------------- the experiment


def small(name):
    case = CASES[name]
    return replace(case, sizes=(1500,), episodes=200, deltas=case.deltas[1:3], grid=(10, 10) if case.grid else ())


@pytest.fixture(scope="module")
def tables():
    names = ("CartPole, pole x 1.3", "CartPole, delay", "Pendulum, mass, gravity", "Chain, mass, springs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(changes, "CASES", {name: small(name) for name in names})
        patch.setattr(changes, "LOGS", {name: (name, 1500) for name in names})
        changes.known.cache_clear()
        rows = []
        for name in names:
            settings = {"case": name, "repetition": 0}
            rows += [settings | row for row in changes.changes.run(settings, Stream("changes", 0, settings))]
        changes.known.cache_clear()
    return pd.DataFrame(rows)


def errors(tables, name):
    return tables[tables.case == name].set_index("estimator")


def test_the_residual_row_is_within_a_quarter(tables):
    for name in ("CartPole, pole x 1.3", "Pendulum, mass, gravity", "Chain, mass, springs"):
        rows = errors(tables, name)
        assert rows.share["simulator"] == 1.0
        assert rows.share["residual"] < 0.25
        assert rows.differs.all()
        assert not rows.hidden.any()
        assert "linear model" in rows.index
        assert ({"grid", "calibrated"} <= set(rows.index)) == bool(CASES[name].grid)
    row = errors(tables, "CartPole, pole x 1.3").loc["residual"]
    assert_allclose(row.error, np.mean([abs(row["error_0.2"]), abs(row["error_0.4"])]))
    assert 0 < row.noise < row.truth_standard_error
    assert 0.2 < row["truth_0.4"] < row["truth_0.2"] < 0.634


def test_a_delay_is_reported_and_the_last_action_mends_it(tables):
    rows = errors(tables, "CartPole, delay")
    assert rows.hidden.all()
    assert rows.share["residual, last action"] < 1 / 3
    assert rows.error["residual"] > 2 * rows.error["residual, last action"]


def test_every_case_is_a_change_but_one():
    unchanged = [name for name, case in CASES.items() if case.target in (case.simulator, classic.ChangedCartPole(10.0))]
    assert unchanged == ["CartPole, unchanged"]
    assert isinstance(CASES["CartPole, delay"].target, HistoryTask)
    reacher = CASES["Reacher, 1.7 times"].simulator
    assert isinstance(reacher, Reacher)
    assert (reacher.reward_length, reacher.length) == (0.17, 0.1)


# ---------------------------------------------------------------- a value and how sure it is


def test_a_small_coverage(monkeypatch):
    """Six logs of 1000 moves: of their intervals at least five hold the truth, by the log's part alone as well."""
    for name, size in {"N": 1000, "EPISODES": 200, "PATHS": 50, "TRUTH": 20_000}.items():
        monkeypatch.setattr(changes, name, size)
    name = "CartPole, gravity 12.5"
    changes.truth.cache_clear()
    changes.returns_of_target.cache_clear()
    table = experiments.table("residual_coverage", case=name, repetitions=6)
    changes.truth.cache_clear()
    changes.returns_of_target.cache_clear()
    assert min(table.covered.sum(), table.covered_paired.sum()) >= 5
    assert_array_equal(table.covered, (table.lower <= table.truth) & (table.truth <= table.upper))
    apart = table.error.abs() / np.hypot(table.error_of_log, table.noise)
    assert_array_equal(table.covered_paired == 1.0, apart <= 2.262)  # Student's t, 9 degrees of freedom
    assert table.error_of_log.mean() < 0.1 * (table.upper - table.lower).mean()  # the rollouts' part is most
    figure = Figure()
    changes.draw_coverage(table, summary_of(changes.residual_coverage, table), figure)
    assert [ax.get_title() for ax in figure.axes] == [name]


def test_a_corrected_value_holds_the_truth():
    case = CASES["CartPole, gravity 15"]
    corrected = ResidualSimulator(case.simulator, case.log(3000, 0), seed=0)
    found = corrected_value(corrected, case.acting(0.4), 1000, 100, refits=4, paths=100, seed=0)
    again = corrected_value(corrected, case.acting(0.4), 1000, 100, refits=4, paths=100, seed=0)
    assert (found.value, found.interval) == (again.value, again.interval)
    truth = monte_carlo_value(case.target, case.acting(0.4), 20_000, 100, seed=1).value
    before = monte_carlo_value(case.simulator, case.acting(0.4), 20_000, 100, seed=1).value
    assert found.interval[0] < truth < found.interval[1] < before
    assert found.status == "ok"
