"""CartPole's experiments: smoke cells, the shipped truths, the baselines' laws."""

import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from saved_results import saved

from oee_tabular.lab.experiment import Stream, files_of, summary_of
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
from oee_tabular.lab.experiments.classic import LinearGaussian
from oee_tabular.lab.experiments.common import frequencies
from oee_tabular.tasks import CartPole, cartpole_policy, discretize, monte_carlo_value, record

IDS = ("fig2", "cartpole_resolution", "cartpole_data", "cartpole_choice")


def assert_no_worse_than_saved(name, cell, made):
    """Errors are those of the saved table; of what rests on the simulator with a floor, at most a tenth above them."""
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
        assert_no_worse_than_saved(name, cell, pd.DataFrame([{**cell, **row} for row in found]))
    table = pd.DataFrame([{**cell, **row} for cell, found in zip(chosen, rows, strict=True) for row in found])
    summary = summary_of(experiment, table)
    assert set(experiment.keys) <= set(summary.columns)
    assert np.isfinite(summary["error_mean"]).all()
    with mpl.rc_context({"figure.max_open_warning": 0}):
        assert files_of(experiment.settings(smoke=True), table)["figure.svg"].startswith(b"<?xml")


def test_the_shipped_truths_are_what_their_function_makes():
    table = truth_table()
    assert len(table) == 6 * (4 + 4 + 1 + 1)
    assert (table.episodes == 400_000).all()
    assert (table.standard_error < 3e-4).all()
    for case, gravity, delta in (("target", 15.0, 0.4), ("target without noise", 7.5, 1.0), ("simulator", 10.0, 0.0)):
        shipped = table[(table.case == case) & (table.gravity == gravity) & (table.delta == delta)].iloc[0]
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


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads Linux's record of the peak memory")
def test_a_million_vertices_in_ten_seconds_and_a_gigabyte():
    """Built, and one policy evaluated; processor time, in a process of its own."""
    code = """
import time
from pathlib import Path
from oee_tabular.lab.experiments.cartpole import exact_values
from oee_tabular.tasks import CartPole, cartpole_policy, discretize

discretize(CartPole(), cells=(4, 4), closure_episodes=0)  # compile
began = time.process_time()
model = discretize(CartPole(), cells=(1000, 1000), closure_episodes=0)
value = exact_values(model.mdp, [model.policy(cartpole_policy(0.4))])[0]
peak = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM")][0]
print(value, time.process_time() - began, int(peak.split()[1]) / 1024**2)  # getrusage would count the parent's peak as well
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    value, seconds, gigabytes = map(float, done.stdout.split())
    assert_allclose(value, true_values("target", 10.0)[2], rtol=2e-3)
    assert seconds < 10.0
    assert gigabytes < 1.0


def test_the_paper_s_own_errors():
    assert_allclose(published_error(15.0, "OEE"), 0.040, atol=0.01)
    assert published_error(15.0, "simulator") < published_error(15.0, "OEE")  # what it leaves out
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
    sampled = monte_carlo_value(model, cartpole_policy(0.4), 40_000, 100, seed=0, normalized=True)
    assert abs(fine_values(model)[2] - sampled.value) < 4 * sampled.standard_error + 5e-4


def test_importance_sampling_of_the_log_s_own_policy_is_the_mean_return():
    log = record(CartPole(15.0), cartpole_policy(0.4), n_episodes=50, max_steps=100, seed=0)
    returns = pd.Series(0.01 * 0.99**log.timestep * log.reward).groupby(log.episode).sum()
    for self_normalized in (False, True):
        assert_allclose(importance_sampling(log, self_normalized=self_normalized)[2], returns.mean(), rtol=1e-12)


def test_a_log_stepped_by_gymnasium_is_the_compiled_task_s():
    log = target_log("gymnasium", 15.0, 300, np.random.default_rng(0))
    moved = CartPole(15.0, 0.0).moves(log.state, log.action, np.zeros((300, 4)))
    assert np.array_equal(moved.next_state, log.next_state)
    assert np.array_equal(moved.terminated, log.terminated)
