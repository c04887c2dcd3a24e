"""Problems: logs that contradict the simulator, their rewards, their checks, and where termination leads."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from oee_tabular import FiniteMDP, Problem, Transitions


def test_contradictions_of_the_log():
    """Rewards: rows, moves and the worst example; behaviour: rows whose probability is not the policy's."""
    simulator = FiniteMDP(np.full((2, 2, 2), 0.5), np.array([[1.0, 2.0], [3.0, 4.0]]), [1, 0], 0.9)
    log = Transitions(
        [0, 0, 1, 0], [0, 0, 1, 1], [0, 0, 1, 1], [1.5, 1.5, 9.0, 2.0], behavior_probability=[0.5, 0.4, 0.5, 0.5]
    )
    problem = Problem(simulator, log, behavior_policy=np.full((2, 2), 0.5))
    assert str(problem.reward_conflict) == (
        "the log's rewards contradict the simulator's in 3 of 4 transitions (2 distinct; "
        "the reward of s=1, a=1 -> s'=1 is 9 in the log, 4 in the simulator)"
    )
    assert problem.behavior_conflict == 1
    assert Problem(simulator, log).behavior_conflict == 0
    whole = Transitions([0, 1], [0, 1], [1, 0], episode=[0, 0], behavior_probability=[0.5, 0.2])
    drawn = Problem(simulator, log, behavior_policy=np.full((2, 2), 0.25) * 2, episodes=whole)
    assert drawn.behavior_conflict == 1
    assert Problem(simulator, whole).reward_conflict is None
    assert_array_equal(problem.rewards_of(log), log.reward)
    assert_array_equal(problem.rewards_of(whole), [1.0, 4.0])
    near = Transitions([0], [0], [0], [1.0 + 5e-7])
    assert Problem(simulator, near).reward_conflict is None
    assert Problem(simulator, Transitions([0], [0], [0], [1.00001])).reward_conflict.rows == 1


def test_log_rewards_for_rewards_of_state_and_action():
    """The mean of the log's pay where a move was seen, r(s, a) elsewhere; rows s*A + a."""
    simulator = FiniteMDP(np.full((2, 2, 2), 0.5), np.array([[1.0, 3.0], [4.0, 6.0]]), [1, 0], 0.9)
    log = Transitions([0, 0, 0, 0], [1, 1, 1, 0], [0, 0, 0, 0], [5.0, 7.0, 9.0, 2.0])
    problem = Problem(simulator, log, rewards="log")
    assert_allclose(problem.model.transition_rewards.toarray(), [[2.0, 1.0], [7.0, 3.0], [4.0, 4.0], [6.0, 6.0]])
    assert Problem(simulator, log).model is simulator


def test_each_log_of_a_problem_is_led_to_where_termination_leads():
    """A terminated move into state 0 ends in state 1; a log without one is kept as it is."""
    rows = np.array([[[0.5, 0.5]], [[0.0, 1.0]]])
    simulator = FiniteMDP(rows, [1.0, 0.0], [1, 0], 0.9, terminal_state=[1, 1])
    ended, going = Transitions([0], [0], [0], terminated=[True]), Transitions([0], [0], [0])
    problem = Problem(simulator, ended, simulator_data=ended, episodes=ended)
    for log in (problem.log, problem.episodes, problem.simulator_data):
        assert log.next_state.tolist() == [1]
        assert log.terminated.tolist() == [True]
    problem = Problem(simulator, going, simulator_data=going, episodes=going)
    assert problem.log is problem.episodes is problem.simulator_data is going
    assert Problem(simulator, going, simulator_data="exact").simulator_data == "exact"
    assert_array_equal(problem.counts.toarray(), [[1, 0], [0, 0]])
