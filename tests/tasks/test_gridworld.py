import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.tasks import gridworld, gridworld_expert, gridworld_policy


def test_the_exact_ratio_takes_three_values():
    """paper/README: 9/7 (intended), 1/3 (not intended), 7/6 (staying put in a corner under an action into a wall)."""
    ratio = oee.true_ratio(gridworld(10, 0.1), gridworld(10, 0.3))
    zeta = ratio.values.data[: 4 * 99 * 4][:1572]  # the goal's four moves, zeta = 1, come last
    assert_allclose(np.unique(np.round(zeta, 12)), np.round([1 / 3, 7 / 6, 9 / 7], 12))
    assert_array_equal(ratio.values.data[1572:], np.ones(4))
    corner = ratio.values.toarray().reshape(100, 4, 100)[0, 1, 0]  # (0, 0), row - 1, stays
    assert_allclose(corner, 7 / 6)


def test_the_trivial_estimate_scores_0570():
    """paper/README: zeta = 1 has a mean absolute error of 0.570 on the support, goal left out."""
    ratio = oee.true_ratio(gridworld(10, 0.1), gridworld(10, 0.3))
    assert_allclose(np.abs(ratio.values.data[:1572] - 1).mean(), 0.570, atol=5e-4)


def test_transitions_into_walls_stay_and_the_goal_absorbs():
    grid = gridworld(3, 0.3)
    table = grid.transitions.toarray().reshape(9, 4, 9)
    assert_allclose(table[0, 1], [0.8, 0.1, 0, 0.1, 0, 0, 0, 0, 0])  # row - 1 and column - 1 both stay
    assert_allclose(table[4, 2], [0, 0.1, 0, 0.1, 0, 0.7, 0, 0.1, 0])
    assert_array_equal(table[8], np.eye(9)[[8] * 4])
    assert grid.absorbing()[8]
    assert_array_equal(np.flatnonzero(grid.initial), [0])


def test_without_slip_the_support_shrinks():
    assert gridworld(3, 0.0).transitions.nnz == 9 * 4
    with pytest.raises(ValueError, match=r"the simulator gives probability 0 to"):
        oee.true_ratio(gridworld(3, 0.1), gridworld(3, 0.0))


def test_paying_for_the_next_or_the_current_cell():
    """J_next at T equals (J_current at T + 1 - first reward) / discount: the same payments one step later."""
    following, current = gridworld(5, 0.2), gridworld(5, 0.2, pay="current")
    policy = gridworld_policy(5, 0.5)
    first = -0.2 * 8
    shifted = (oee.policy_value(current, policy, horizon=31) - first) / 0.99
    assert_allclose(oee.policy_value(following, policy, horizon=30), shifted, rtol=1e-12)


def test_the_expert_walks_rows_then_columns():
    grid = gridworld(4, 0.0, pay="current", discount=1.0)
    distances = range(6, 0, -1)
    assert_allclose(oee.policy_value(grid, gridworld_expert(4)), -0.2 * sum(distances), rtol=1e-12)


def test_the_scale_of_the_paper_s_values():
    """delta = 0.1, T = 200 has |J| = 1.60 when the current cell pays."""
    target = gridworld(10, 0.1, pay="current")
    value = oee.policy_value(target, gridworld_policy(10, 0.1), horizon=200, normalized=True)
    assert_allclose(value, -1.60, atol=0.01)


def test_under_the_uniform_policy_the_chain_does_not_depend_on_slip():
    """paper/README: the true (s, a) ratio of the paper's data is 1."""
    uniform = oee.uniform_policy(gridworld(6, 0.3))
    assert_allclose(oee.occupancy(gridworld(6, 0.3), uniform), oee.occupancy(gridworld(6, 0.1), uniform), atol=1e-15)
