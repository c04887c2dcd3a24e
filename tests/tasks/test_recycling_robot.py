"""The recycling robot against the book's equations, and as a task by name."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import oee_tabular as oee

CASES = [
    {"alpha": 0.8, "beta": 0.6},
    {"alpha": 0.3, "beta": 0.95, "search_reward": 5.0},
    {"alpha": 0.0, "beta": 0.0, "wait_reward": 1.9, "discount": 0.5},
    {"alpha": 1.0, "beta": 1.0, "discount": 0.0, "rescue_reward": 0.0},
]


@pytest.mark.parametrize("given", CASES)
def test_the_optimal_values_solve_the_book_s_equations(given):
    """Sutton & Barto (2018), example 3.9: v(h) and v(l) of the optimal policy."""
    robot = oee.tasks.recycling_robot(**given)
    values = oee.state_values(robot, oee.optimal_policy(robot))
    a, b = given["alpha"], given["beta"]
    search = given.get("search_reward", 2.0)
    wait = given.get("wait_reward", 1.0)
    rescue = given.get("rescue_reward", -3.0)
    gamma = given.get("discount", 0.9)
    h, low = values
    assert_allclose(
        h,
        max(search + gamma * (a * h + (1 - a) * low), wait + gamma * h),
        rtol=1e-12,
    )
    searching = b * search + (1 - b) * rescue + gamma * ((1 - b) * h + b * low)
    assert_allclose(low, max(searching, wait + gamma * low, gamma * h), rtol=1e-12)


def test_a_high_battery_cannot_be_recharged():
    robot = oee.tasks.recycling_robot()
    assert robot.available.tolist() == [[True, True, False], [True, True, True]]
    assert robot.state_names == ("high", "low")
    assert robot.transitions.toarray()[2].tolist() == [0.0, 0.0]
    with pytest.raises(ValueError, match="recharge cannot be taken in state high"):
        oee.policy_value(robot, {"high": "recharge", "low": "wait"})
    log = oee.Transitions(["low", "high"], ["wait", "recharge"], ["low", "high"])
    with pytest.raises(ValueError, match=r"^log\[1\] .* state high action recharge"):
        oee.Problem(robot, log)


def test_its_name_on_the_command_line():
    task = oee.tasks.named_task("recycling_robot:0.5,beta=0.9", discount=0.7)
    same = oee.tasks.recycling_robot(0.5, 0.9, discount=0.7)
    assert_allclose(task.mdp.transitions.toarray(), same.transitions.toarray())
    assert task.mdp.discount == 0.7
    assert np.array_equal(task.mdp.available, same.available)
    assert np.array_equal(task.expert(), oee.optimal_policy(same))
    with pytest.raises(ValueError, match=r"must be like 'recycling_robot:beta=0.6'"):
        oee.tasks.named_task("recycling_robot:gamma=0.5")
