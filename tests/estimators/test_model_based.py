"""The log's frequencies as a model: fallbacks, rewards, standard error."""

import numpy as np
from estimators.four_states import environments
from helpers import dense
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP, Problem, Transitions
from oee_tabular.estimators import ModelBased


def test_models_of_the_log_use_the_simulator_s_rewards():
    """r(s, a, s') on the moves seen and on staying, which "stay" makes up; the row's mean where staying has no reward."""
    simulator, _ = environments(3)
    problem = Problem(simulator, Transitions([0, 0, 1], [0, 0, 1], [1, 2, 1]))
    own = dense(simulator)[1]
    stay = ModelBased().model(problem)
    rows, pay = dense(stay)
    assert_allclose(rows[0, 0], [0, 0.5, 0.5, 0])
    assert_allclose(rows[1, 0], [0, 1, 0, 0])
    assert_allclose(pay[0, 0, 1:3], own[0, 0, 1:3])
    assert_allclose(pay[1, 0, 1], own[1, 0, 1])
    assert_allclose(pay[1, 1, 1], own[1, 1, 1])
    rows, undefined = dense(simulator)[0], own.copy()
    rows[1, 0], undefined[1, 0, 1] = [0.5, 0.0, 0.5, 0.0], np.nan
    without = FiniteMDP(rows, undefined, simulator.initial, simulator.discount)
    moved = ModelBased().model(Problem(without, Transitions([0, 0, 1], [0, 0, 1], [1, 2, 1])))
    assert_allclose(dense(moved)[1][1, 0, 1], without.rewards[1, 0])
    other = ModelBased("simulator").model(problem)
    assert_allclose(dense(other)[0][1, 0], dense(simulator)[0][1, 0])
    assert_allclose(dense(other)[1][1, 0], own[1, 0])
    assert_array_equal(other.terminal_state, simulator.terminal_state)
    assert_array_equal(other.initial, simulator.initial)
    assert other.discount == simulator.discount


def test_models_keep_states_that_nothing_enters_and_where_termination_leads():
    rows = np.array([[[0.5, 0.5]], [[0.5, 0.5]]])
    pay = np.arange(4.0).reshape(2, 1, 2)
    simulator = FiniteMDP(rows, pay, [0, 1], 0.9, terminal_state=[1, 1])
    problem = Problem(simulator, Transitions([1, 0], [0, 0], [0, 0]))
    for fallback in ("stay", "simulator"):
        model = ModelBased(fallback).model(problem)
        assert_array_equal(model.terminal_state, [1, 1])
        assert_allclose(oee.state_values(model, np.ones((2, 1))), [0.0, 2.0], atol=1e-12)
    once = ModelBased()(Problem(simulator, Transitions([1, 0, 0], [0, 0, 0], [0, 0, 1])), np.ones((2, 1)))
    assert once.standard_error > 0  # of state 0 alone: a row seen once shows no spread


def test_one_record_is_enough_where_there_is_one_next_state():
    """State 0 leads to 1 for sure, and was left once; state 1 may stay or end, and was left once: its variance is unknown."""
    rows = np.array([[[0.0, 1.0, 0.0]], [[0.0, 0.5, 0.5]], [[0.0, 0.0, 1.0]]])
    simulator = FiniteMDP(rows, [1.0, 1.0, 0.0], [1, 0, 0], 0.5)
    found = ModelBased("simulator")(Problem(simulator, Transitions([0, 1], [0, 0], [1, 2])), np.ones((3, 1)))
    assert_allclose(found.diagnostics["single_share"], 1 / 3)  # of the time before the end: 1 in state 0, .5 in state 1
    assert_allclose(found.measured, 2 / 3)
