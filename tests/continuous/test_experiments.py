"""The studies of CartPole and of Reacher on small cells, and of changes that nobody
tuned for.
"""

import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import gymnasium
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose, assert_array_equal
from saved_results import saved

from oee_tabular.continuous.task.kinova import ideal_hand
from oee_tabular.lab import experiments
from oee_tabular.lab.experiment import Stream, files_of, summary_of
from oee_tabular.lab.experiments import changes, classic, reacher
from oee_tabular.lab.experiments.cartpole import (
    GRAVITIES,
    exact_values,
    fine_values,
    importance_sampling,
    off_environment,
    policies_of,
    published_error,
    simulate_truth,
    target_log,
    true_values,
    truth_table,
)
from oee_tabular.lab.experiments.catalogue import EXPERIMENTS
from oee_tabular.lab.experiments.changes import CASES, Delayed
from oee_tabular.lab.experiments.classic import LinearGaussian
from oee_tabular.lab.experiments.common import frequencies
from oee_tabular.lab.experiments.kinova import towards
from oee_tabular.lab.experiments.reacher import DELTAS, fig3
from oee_tabular.tasks import (
    CartPole,
    HistoryTask,
    Reacher,
    ResidualSimulator,
    VisitedCells,
    cartpole_policy,
    discretize,
    monte_carlo_value,
    reacher_log,
    reacher_policy,
    record,
)

IDS = ("fig2", "cartpole_resolution", "cartpole_data", "cartpole_choice")


def assert_no_worse_than_saved(name, cell, made):
    """Errors are those of the saved table; of what rests on the simulator with a floor,
    at most a tenth above them.
    """
    rows = saved(name)
    for setting, value in cell.items():
        rows = rows[rows[setting] == value]
    both = made.merge(rows, on=[*cell, "estimator"], suffixes=("", "_saved"))
    assert len(both) == len(rows)
    rests = both.estimator.str.startswith("OEE")
    assert_allclose(both.error[~rests], both.error_saved[~rests], rtol=1e-5)
    assert (both.error[rests] < 1.1 * both.error_saved[rests] + 1e-4).all()


@pytest.mark.parametrize("name", IDS)
def test_a_smoke_cell(name):
    experiment = EXPERIMENTS[name]
    settings = experiment.settings(smoke=True, repetitions=1)
    cells = settings.cells()
    chosen = [cells[0], cells[-1]]
    rows = [experiment.run(cell, Stream(name, 0, cell)) for cell in chosen]
    assert rows[0] == experiment.run(cells[0], Stream(name, 0, cells[0]))
    for cell, found in zip(chosen, rows, strict=True):
        assert_no_worse_than_saved(
            name, cell, pd.DataFrame([{**cell, **row} for row in found])
        )
    table = pd.DataFrame(
        [
            {**cell, **row}
            for cell, found in zip(chosen, rows, strict=True)
            for row in found
        ]
    )
    summary = summary_of(experiment, table)
    assert set(experiment.keys) <= set(summary.columns)
    assert np.isfinite(summary["error_mean"]).all()
    with mpl.rc_context({"figure.max_open_warning": 0}):
        assert files_of(experiment.settings(smoke=True), table)[
            "figure.svg"
        ].startswith(b"<?xml")


def test_the_shipped_truths_are_what_their_function_makes():
    table = truth_table()
    assert len(table) == 6 * (4 + 4 + 1 + 1)
    assert (table.episodes == 400_000).all()
    assert (table.standard_error < 3e-4).all()
    for case, gravity, delta in (
        ("target", 15.0, 0.4),
        ("target without noise", 7.5, 1.0),
        ("simulator", 10.0, 0.0),
    ):
        shipped = table[
            (table.case == case) & (table.gravity == gravity) & (table.delta == delta)
        ].iloc[0]
        found = simulate_truth(case, gravity, delta, 20_000)
        assert abs(found.value - shipped.value) < 4 * found.standard_error
    assert_allclose(
        true_values("simulator", 10.0), true_values("target", 10.0), rtol=0, atol=1.5e-3
    )  # other random numbers, one quantity


@pytest.mark.parametrize("gravity", GRAVITIES)
def test_a_hundred_by_a_hundred_is_within_one_percent(gravity):
    model = discretize(CartPole(gravity), cells=(100, 100), closure_episodes=0)
    found = exact_values(model.mdp, policies_of(model))
    assert_allclose(found, true_values("target", gravity), rtol=0.01)


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(),
    reason="reads Linux's record of the peak memory",
)
def test_a_million_vertices_in_a_gigabyte():
    """Build the cells and evaluate one policy, in a process of its own."""
    code = """
from pathlib import Path
from oee_tabular.lab.experiments.cartpole import exact_values
from oee_tabular.tasks import CartPole, cartpole_policy, discretize

model = discretize(CartPole(), cells=(1000, 1000), closure_episodes=0)
value = exact_values(model.mdp, [model.policy(cartpole_policy(0.4))])[0]
peak = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")][0]
print(value, int(peak.split()[1]) / 1024**2)  # getrusage would count the parent's peak as well
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    value, gigabytes = map(float, done.stdout.split())
    assert_allclose(value, true_values("target", 10.0)[2], rtol=2e-3)
    assert gigabytes < 1.0


def test_the_paper_s_own_errors():
    assert_allclose(published_error(15.0, "OEE"), 0.040, atol=0.01)
    # what it leaves out
    assert published_error(15.0, "simulator") < published_error(15.0, "OEE")
    assert np.isnan(published_error(7.5, "OEE"))


def test_frequencies_stay_where_the_log_was_never():
    log = target_log("compiled", 15.0, 500, np.random.default_rng(0))
    counts = off_environment(log).counts
    rows = frequencies(counts, 2)
    assert_allclose(rows.sum(axis=1), 1.0)
    unseen = np.flatnonzero(np.asarray(counts.sum(axis=1)) == 0)
    assert unseen.size
    assert np.flatnonzero(rows[[unseen[0]]].toarray()).tolist() == [unseen[0] // 2]


def test_the_linear_model_s_values_are_its_own():
    log = target_log("compiled", 15.0, 5000, np.random.default_rng(0))
    model = LinearGaussian(CartPole(), log, slice(2, 4))
    sampled = monte_carlo_value(
        model, cartpole_policy(0.4), 40_000, 100, seed=0, normalized=True
    )
    assert (
        abs(fine_values(model)[2] - sampled.value) < 4 * sampled.standard_error + 5e-4
    )


def test_importance_sampling_of_the_log_s_own_policy_is_the_mean_return():
    log = record(
        CartPole(15.0), cartpole_policy(0.4), n_episodes=50, max_steps=100, seed=0
    )
    returns = (
        pd.Series(0.01 * 0.99**log.timestep * log.reward).groupby(log.episode).sum()
    )
    for self_normalized in (False, True):
        assert_allclose(
            importance_sampling(log, self_normalized=self_normalized)[2],
            returns.mean(),
            rtol=1e-12,
        )


def test_a_log_stepped_by_gymnasium_is_the_compiled_task_s():
    log = target_log("gymnasium", 15.0, 300, np.random.default_rng(0))
    moved = CartPole(15.0, 0.0).moves(log.state, log.action, np.zeros((300, 4)))
    assert np.array_equal(moved.next_state, log.next_state)
    assert np.array_equal(moved.terminated, log.terminated)


# ---------------------------------------------------------------- Reacher


@pytest.fixture(scope="module")
def table():
    patch = pytest.MonkeyPatch()
    patch.setattr(reacher, "TRUTH_EPISODES", 256)
    patch.setattr(reacher, "MODEL_EPISODES", 64)
    patch.setattr(
        reacher,
        "CELLS",
        VisitedCells(200, n_simulated=1000, n_stepped=2000, max_steps=20),
    )
    patch.setattr(reacher, "reacher_log", partial(reacher_log, max_steps=20))
    reacher.truth.cache_clear()
    settings = {"length": 0.05, "n": 3000, "repetition": 0}
    rows = fig3.run(settings, Stream("fig3", 0, settings))
    again = fig3.run(settings, Stream("fig3", 0, settings))
    patch.undo()
    reacher.truth.cache_clear()
    assert [row["value_0.5"] for row in rows] == [row["value_0.5"] for row in again]
    return pd.DataFrame([settings | row for row in rows])


def test_every_curve_is_there(table):
    shown = {
        reacher.WEIGHTED,
        reacher.AVERAGED,
        reacher.PLAIN,
        reacher.MODEL,
        reacher.LINEAR,
        reacher.RESIDUAL,
        reacher.ORACLE,
        reacher.SIMULATOR,
        reacher.OWN_REWARD,
        reacher.AVERAGE,
        reacher.UNKNOWN,
        reacher.UNKNOWN_AVERAGED,
    }
    assert shown <= set(table.series)
    assert f"{reacher.WEIGHTED}, calibrated" in set(table.series)
    assert table.series.is_unique
    values, right = (
        table[[f"{what}_{d}" for d in DELTAS]].to_numpy() for what in ("value", "truth")
    )
    assert np.isfinite(values).all()
    assert_allclose(table.error, np.abs(values - right).mean(axis=1))
    assert (table[table.series == reacher.AVERAGED].uncovered == 0.0).all()
    left_out = table[table.series.isin([reacher.UNKNOWN, reacher.UNKNOWN_AVERAGED])]
    # without the target's own length, and with its log's moves
    assert (left_out.uncovered > 0.0).all()
    assert left_out.weight_of_true_length.isna().all()
    assert (table[table.series == reacher.WEIGHTED].weight_of_true_length > 0.9).all()
    assert (table[table.series == reacher.SIMULATOR].uncovered > 0.3).all()


def test_the_paper_s_errors_of_reacher():
    """1.84, 4.88 and 15.7 for the long links, from its published points; none for the
    short ones.
    """
    names = [
        reacher.WEIGHTED,
        reacher.OWN_REWARD,
        reacher.MODEL,
        "other",
        reacher.WEIGHTED,
        reacher.WEIGHTED,
    ]
    lengths = [0.2, 0.2, 0.2, 0.2, 0.05, 0.2]
    sizes = [150_000] * 5 + [15_000]
    summary = pd.DataFrame({"length": lengths, "n": sizes, "series": names})
    errors = [reacher.published_error(row) for row in summary.to_dict("records")]
    assert_allclose(errors, [1.84, 4.88, 15.73, np.nan, np.nan, np.nan], atol=0.01)


def test_even_beginnings_have_the_same_mean():
    policy = reacher_policy(0.5)
    even, plain = (
        monte_carlo_value(task, policy, 4000, 20, seed=0)
        for task in (reacher.Even(), Reacher())
    )
    assert abs(even.value - plain.value) < 4 * np.hypot(
        even.standard_error, plain.standard_error
    )
    starts = reacher.Even().initial_states(1000, np.random.default_rng(0))
    assert (np.abs(starts) <= [3.14, 1.57, 0, 0]).all()
    assert_allclose(starts.mean(axis=0), 0.0, atol=0.01)


# ---------------------------------------------------------------- changes that nobody
# tuned for


def places(task, n=200, seed=0):
    rng = np.random.default_rng(seed)
    low = np.resize(task.feature_low, task.n_state)
    high = np.resize(task.feature_high, task.n_state)
    return rng.uniform(low, high, (n, task.n_state)), rng.integers(
        task.n_actions, size=n
    )


# ---------------------------------------------------------------- dynamics


GYMNASIUMS = [
    ("Pendulum-v1", classic.Pendulum(1.2, 1.1, 9.0), {"m": 1.2, "l": 1.1, "g": 9.0}),
    (
        "MountainCar-v0",
        classic.MountainCar(0.0027, 0.0009),
        {"gravity": 0.0027, "force": 0.0009},
    ),
    (
        "Acrobot-v1",
        classic.Acrobot(1.2, 1.3, 1.15),
        {
            "LINK_MASS_1": 1.2,
            "LINK_MASS_2": 1.3,
            "LINK_LENGTH_1": 1.15,
            "LINK_COM_POS_1": 0.575,
        },
    ),
]


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
        _, reward, over, _, _ = env.step(
            task.actions[[a]] if name == "Pendulum-v1" else int(a)
        )
        assert_allclose(moved.next_state[i], env.state, rtol=0, atol=1e-10)
        assert_allclose(moved.reward[i], reward)
        assert moved.terminated[i] == over
    starts = task.initial_states(500, np.random.default_rng(0))
    assert (np.min(again, axis=0) >= starts.min(axis=0) - 0.1).all()
    assert (np.max(again, axis=0) <= starts.max(axis=0) + 0.1).all()


def test_cartpole_with_everything_as_it_was():
    states, actions = places(CartPole(10.0, form="full"))
    xi = np.random.default_rng(1).standard_normal((len(states), 4))
    found, right = (
        task.moves(states, actions, xi)
        for task in (classic.ChangedCartPole(10.0), CartPole(10.0))
    )
    assert_allclose(found.next_state, right.next_state, rtol=0, atol=1e-14)
    assert_array_equal(found.terminated, right.terminated)
    for change in ("pole", "force", "joint", "cart", "push", "gusts"):
        other = replace(classic.ChangedCartPole(10.0), **{change: 0.5}).moves(
            states, actions, xi
        )
        assert np.abs(other.next_state - right.next_state).max() > 1e-6


def test_a_chain_without_friction_keeps_its_energy():
    task = classic.Chain(friction=0.0, noise=0.0)
    states = 0.3 * task.initial_states(50, np.random.default_rng(0))

    def energy(states):
        stretched = np.diff(states[:, :4], axis=1, prepend=0.0, append=0.0)
        held = task.stiffness * (
            stretched**2 / 2 + task.hardness * stretched**4 / 4
        ).sum(axis=1)
        return held + 0.5 * task.mass * (states[:, 4:] ** 2).sum(axis=1)

    before = energy(states)
    for _ in range(100):
        states = task.moves(
            states, np.ones(50, dtype=np.int64), np.zeros((50, 4))
        ).next_state
    assert_allclose(energy(states), before, rtol=0.1)


def test_a_delayed_task_does_what_was_asked_before():
    task = Delayed(CartPole(10.0, noise=0.0))
    states = np.column_stack([np.zeros((3, 4)), [[0, 0], [1, 0], [0, 1]]])
    moved = task.step(states, np.array([1, 1, 0]), np.random.default_rng(0))
    right = CartPole(10.0, noise=0.0).moves(
        np.zeros((3, 4)), np.array([1, 0, 1]), np.zeros((3, 4))
    )
    assert_array_equal(moved.next_state[:, :4], right.next_state)
    assert_array_equal(moved.next_state[:, 4:], [[0, 1], [0, 1], [1, 0]])


def test_a_corrected_arm_aims_elsewhere():
    hand = ideal_hand(1.0, scatter=0.0)
    log = record(
        ideal_hand(1.4, scatter=0.0),
        lambda s: np.full((len(s), 27), 1 / 27),
        n_episodes=2,
        max_steps=25,
        seed=0,
    )
    other = towards(ResidualSimulator(hand, log, seed=0), 3)
    assert_allclose(
        other.reward_between(log.state, log.action, log.next_state),
        hand.towards(3).costs(log.state),
    )


# ---------------------------------------------------------------- the experiment


def small(name):
    case = CASES[name]
    return replace(
        case,
        sizes=(1500,),
        episodes=200,
        deltas=case.deltas[1:3],
        grid=(10, 10) if case.grid else (),
    )


@pytest.fixture(scope="module")
def tables():
    names = (
        "CartPole, pole x 1.3",
        "CartPole, delay",
        "Pendulum, mass, gravity",
        "Chain, mass, springs",
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(changes, "CASES", {name: small(name) for name in names})
        patch.setattr(changes, "LOGS", {name: (name, 1500) for name in names})
        changes.known.cache_clear()
        rows = []
        for name in names:
            settings = {"case": name, "repetition": 0}
            rows += [
                settings | row
                for row in changes.changes.run(settings, Stream("changes", 0, settings))
            ]
        changes.known.cache_clear()
    return pd.DataFrame(rows)


def errors(tables, name):
    return tables[tables.case == name].set_index("estimator")


def test_the_residual_row_is_within_a_quarter(tables):
    for name in (
        "CartPole, pole x 1.3",
        "Pendulum, mass, gravity",
        "Chain, mass, springs",
    ):
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
    unchanged = [
        name
        for name, case in CASES.items()
        if case.target in (case.simulator, classic.ChangedCartPole(10.0))
    ]
    assert unchanged == ["CartPole, unchanged"]
    assert isinstance(CASES["CartPole, delay"].target, HistoryTask)
    reacher = CASES["Reacher, 1.7 times"].simulator
    assert isinstance(reacher, Reacher)
    assert (reacher.reward_length, reacher.length) == (0.17, 0.1)


# ---------------------------------------------------------------- a value and how sure
# it is


def test_a_small_coverage(monkeypatch):
    """Six logs of 1000 moves: of their intervals at least five hold the truth, by the
    log's part alone as well.
    """
    for name, size in {
        "N": 1000,
        "EPISODES": 200,
        "PATHS": 50,
        "TRUTH": 20_000,
    }.items():
        monkeypatch.setattr(changes, name, size)
    name = "CartPole, gravity 12.5"
    changes.truth.cache_clear()
    changes.returns_of_target.cache_clear()
    table = experiments.table("residual_coverage", case=name, repetitions=6)
    changes.truth.cache_clear()
    changes.returns_of_target.cache_clear()
    assert min(table.covered.sum(), table.covered_paired.sum()) >= 5
    assert_array_equal(
        table.covered, (table.lower <= table.truth) & (table.truth <= table.upper)
    )
    apart = table.error.abs() / np.hypot(table.error_of_log, table.noise)
    # Student's t, 9 degrees of freedom
    assert_array_equal(table.covered_paired == 1.0, apart <= 2.262)
    # the rollouts' part is most
    assert table.error_of_log.mean() < 0.1 * (table.upper - table.lower).mean()
    figure = Figure()
    changes.draw_coverage(table, summary_of(changes.residual_coverage, table), figure)
    assert [ax.get_title() for ax in figure.axes] == [name]
