import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions


def small_log(**changes):
    columns = {
        "state": [0, 1, 2, 0],
        "action": [0, 1, 0, 1],
        "next_state": [1, 2, 3, 2],
        "reward": [0.0, 0.5, 1.0, -1.0],
        "terminated": [False, False, True, False],
        "episode": [7, 7, 7, 3],
    }
    return Transitions(**(columns | changes))


def test_what_is_not_given_is_filled_in():
    log = small_log()
    assert_array_equal(log.timestep, [0, 1, 2, 0])
    assert_array_equal(log.truncated, [False, False, False, True])
    assert_array_equal(log.episode_starts, [0, 3, 4])
    assert log.n_episodes == 2
    bag = Transitions([0], [0], [1])
    assert bag.episode is None
    assert bag.n_episodes is None
    assert not bag.terminated.any()
    assert not bag.truncated.any()


def test_counts_and_discounted_counts():
    log = small_log()
    counts = log.counts(4, 2).toarray().reshape(4, 2, 4)
    assert counts[0, 0, 1] == counts[1, 1, 2] == counts[2, 0, 3] == counts[0, 1, 2] == 1
    assert counts.sum() == 4
    discounted = log.counts(4, 2, discount=0.5).toarray().reshape(4, 2, 4)
    assert_allclose(
        [discounted[0, 0, 1], discounted[1, 1, 2], discounted[2, 0, 3], discounted[0, 1, 2]], [1, 0.5, 0.25, 1]
    )


@given(rngs)
def test_counts_count(rng):
    n = int(rng.integers(1, 200))
    state, action, following = rng.integers(0, 5, n), rng.integers(0, 3, n), rng.integers(0, 5, n)
    expected = np.zeros((15, 5))
    np.add.at(expected, (state * 3 + action, following), 1)
    assert_array_equal(Transitions(state, action, following).counts(5, 3).toarray(), expected)


def test_it_is_immutable():
    log = small_log()
    with pytest.raises(AttributeError):
        log.state = np.zeros(4)
    with pytest.raises(ValueError, match="read-only"):
        log.state[0] = 3


def test_drawing_is_without_replacement_and_reproducible():
    mdp = oee.tasks.gridworld(4, 0.1)
    log = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 10, 50, seed=0)
    drawn, again = log.draw(100, seed=3), log.draw(100, seed=3)
    assert_array_equal(drawn.state, again.state)
    assert drawn.episode is None
    whole = log.draw(len(log), seed=1)
    assert_array_equal(whole.counts(16, 4).toarray(), log.counts(16, 4).toarray())
    assert_array_equal(np.sort(whole.timestep), np.sort(log.timestep))
    assert_array_equal(np.sort(whole.behavior_probability), np.sort(log.behavior_probability))


def test_logs_are_joined_in_order():
    mdp = oee.tasks.gridworld(3, 0.1)
    logs = [oee.sample_episodes(mdp, oee.uniform_policy(mdp), k, 20, seed=k) for k in (2, 3)]
    both = oee.Transitions.concatenate(logs)
    assert len(both) == len(logs[0]) + len(logs[1])
    assert both.n_episodes == 5
    assert_array_equal(both.next_state, np.concatenate([log.next_state for log in logs]))
    assert_array_equal(both.timestep, np.concatenate([log.timestep for log in logs]))
    assert_array_equal(both.episode[: len(logs[0])], logs[0].episode)
    bag = oee.Transitions.concatenate([logs[0], logs[1].draw(4, seed=0)])
    assert bag.episode is None
    with pytest.raises(ValueError, match="logs must be one or more Transitions; got"):
        oee.Transitions.concatenate([])
    with pytest.raises(ValueError, match="logs must be one or more Transitions; got"):
        oee.Transitions.concatenate([logs[0], "log"])


def test_the_first_rows_keep_their_episodes():
    log = small_log().first(2)
    assert_array_equal(log.episode, [7, 7])
    assert_array_equal(log.truncated, [False, True])
    assert_array_equal(small_log().first(3).truncated, [False, False, False])


def test_selecting_by_mask_and_by_number():
    log = small_log()
    assert_array_equal(log.select([3, 0]).state, [0, 0])
    assert_array_equal(log.select(log.reward > 0).reward, [0.5, 1.0])


def test_it_prints_as_a_summary():
    assert repr(small_log()) == (
        "Transitions(4 transitions in 2 episodes of 1 to 3 steps: 1 terminated, 1 truncated; states 0..3, actions 0..1; "
        "rewards -1 to 1)"
    )
    assert small_log().summary()["state_action_pairs_seen"] == 4


@pytest.mark.parametrize("largest", [5, 10**4, 2**62, 2**63 - 1])
@given(rngs)
def test_what_was_seen_is_counted_whatever_the_numbers(largest, rng):
    n = int(rng.integers(1, 40))
    state, action, following = (rng.choice([0, 1, 3, largest], n) for _ in range(3))
    facts = Transitions(state, action, following).summary()
    assert facts["states_seen"] == len({*state.tolist(), *following.tolist()})
    assert facts["state_action_pairs_seen"] == len({*zip(state.tolist(), action.tolist(), strict=True)})
    assert facts["largest_state"] == max(state.max(), following.max())
