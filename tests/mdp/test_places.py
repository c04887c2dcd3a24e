"""Names by place: cells of a grid, and the directions in which actions lead."""

import numpy as np
import pytest

import oee_tabular as oee
from oee_tabular.mdp import place_names


def test_a_gridworld_s_states_are_cells_and_its_actions_directions():
    names = place_names(oee.tasks.gridworld(10, slip=0.3))
    told = {names.describe_pair(86, a) for a in range(4)}
    assert told == {
        f"action {word} in cell (8, 6)" for word in ("up", "down", "left", "right")
    }
    assert names.label_pair(86, 0).endswith(" in cell (8, 6)")
    for action in range(4):
        word = names.action_word(action)
        step = {"up": -10, "down": 10, "left": -1, "right": 1}[word]
        row = oee.tasks.gridworld(10, slip=0.0).transitions[[55 * 4 + action]]
        assert row.indices.tolist() == [55 + step]


def test_names_of_its_own_stay():
    names = place_names(
        oee.tasks.gridworld(2, slip=0.0).with_names(
            ["hall", "big room", "dock", "end"], ["n", "s", "w", "e"]
        )
    )
    assert names.describe_pair(1, 2) == "action w in state “big room”"
    assert names.label_pair(0, 3) == "e in state hall"


def test_action_names_stay_beside_cells():
    lake = oee.tasks.toy_text("FrozenLake-v1", map_name="4x4")
    assert place_names(lake).describe_pair(6, 2) == "action right in cell (1, 2)"


def chain(layout, n_actions=1):
    n = len(layout)
    steps = np.zeros((n, n_actions, n))
    steps[:, :, :] = np.roll(np.eye(n), 1, axis=1)[:, None, :]
    return oee.FiniteMDP(steps, np.zeros(n), 0, 0.9, layout=layout)


@pytest.mark.parametrize(
    ("mdp", "said"),
    [
        # no layout, a line, a layout that is no grid, two states in a cell
        (
            oee.FiniteMDP(np.ones((1, 1, 1)), [0.0], 0, 0.9),
            "action 0 in state 0",
        ),
        (chain([[0.0], [1.0], [2.0]]), "action 0 in state 0"),
        (chain([[0.5, 0.0], [1.0, 1.0], [2.0, 2.0]]), "action 0 in state 0"),
        (chain([[0.0, 0.0], [0.0, 0.0], [2.0, 2.0]]), "action 0 in state 0"),
        # two actions that lead to the same place have no direction of their own
        (
            chain([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]], n_actions=2),
            "action 0 in cell (0, 0)",
        ),
    ],
)
def test_where_there_is_no_grid_numbers_stay(mdp, said):
    assert place_names(mdp).describe_pair(0, 0) == said


def test_a_terminal_twin_of_a_cell_keeps_its_number():
    taxi = oee.tasks.toy_text("Taxi-v4")
    assert place_names(taxi) == taxi.names
    cliff = oee.tasks.toy_text("CliffWalking-v1")
    names = place_names(cliff)
    assert names.describe_state(25) in ("cell (2, 1)", "state 25")


def test_the_advice_of_a_report_names_the_cell():
    simulator = oee.tasks.gridworld(5, 0.3)
    uniform = oee.uniform_policy(simulator)
    log = oee.sample_episodes(simulator, uniform, 2, 10, seed=1)
    problem = oee.Problem(simulator, log)
    report = oee.evaluate(problem, uniform, estimators=["oee"])
    assert " in cell (" in report.uncertainty.next
    plan = oee.plan_data_collection(problem, uniform, n=10)
    assert report.uncertainty.next.partition(" first")[0] in str(plan)
