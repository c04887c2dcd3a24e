import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.exceptions import ArgumentError, DataWarning


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


@given(rngs)
def test_counts_count(rng):
    n = int(rng.integers(1, 200))
    state = rng.integers(0, 5, n)
    action = rng.integers(0, 3, n)
    following = rng.integers(0, 5, n)
    timestep = rng.integers(0, 9, n)
    log = Transitions(state, action, following, timestep=timestep)
    for discount, weights in ((None, np.ones(n)), (0.5, 0.5**timestep)):
        expected = np.zeros((15, 5))
        np.add.at(expected, (state * 3 + action, following), weights)
        assert_allclose(
            log.counts(5, 3, discount=discount).toarray(), expected, rtol=1e-12
        )


def test_it_is_immutable():
    log = small_log()
    with pytest.raises(AttributeError):
        log.state = np.zeros(4)
    with pytest.raises(ValueError, match="read-only"):
        log.state[0] = 3


GRID = oee.tasks.gridworld(4, 0.1)
LOGS = [
    oee.sample_episodes(GRID, oee.uniform_policy(GRID), k, 50, seed=k) for k in (2, 3)
]


def test_drawing_is_without_replacement_and_reproducible():
    log = LOGS[0]
    drawn = log.draw(30, seed=3)
    again = log.draw(30, seed=3)
    assert_array_equal(drawn.state, again.state)
    assert drawn.episode is None
    whole = log.draw(len(log), seed=1)
    assert_array_equal(whole.counts(16, 4).toarray(), log.counts(16, 4).toarray())
    assert_array_equal(np.sort(whole.timestep), np.sort(log.timestep))
    assert_array_equal(
        np.sort(whole.behavior_probability), np.sort(log.behavior_probability)
    )


def test_logs_are_joined_in_order():
    both = Transitions.concatenate(LOGS)
    for name, column in both.columns().items():
        parts = [getattr(log, name) for log in LOGS]
        assert_array_equal(
            column, np.concatenate([parts[0], parts[1] + 2 * (name == "episode")])
        )
    with pytest.warns(DataWarning, match=r"episode, which logs\[1\]"):
        joined = Transitions.concatenate([LOGS[0], LOGS[1].draw(4, seed=0)])
    assert joined.episode is None


def test_rows_by_their_numbers_by_a_mask_and_from_the_first():
    log = small_log()
    assert_array_equal(log.select([3, 0]).state, [0, 0])
    assert_array_equal(log.select(log.reward > 0).reward, [0.5, 1.0])
    assert_array_equal(log.first(2).episode, [7, 7])
    assert_array_equal(log.first(2).truncated, [False, True])
    assert_array_equal(log.first(3).truncated, [False, False, False])


def test_it_prints_as_a_summary():
    assert (
        repr(small_log())
        == "Transitions(4 transitions in 2 episodes of 1 to 3 steps: 1 terminated, 1"
        " truncated; states 0..3, actions 0..1; rewards -1 to 1)"
    )
    assert small_log().summary()["state_action_pairs_seen"] == 4


@pytest.mark.parametrize("largest", [5, 10**4, 2**62, 2**63 - 1])
@given(rngs)
def test_distinct_transitions_are_counted_whatever_the_numbers(largest, rng):
    n = int(rng.integers(1, 40))
    state, action, following = (rng.choice([0, 1, 3, largest], n) for _ in range(3))
    facts = Transitions(state, action, following).summary()
    assert facts["states_seen"] == len({*state.tolist(), *following.tolist()})
    assert facts["state_action_pairs_seen"] == len(
        {*zip(state.tolist(), action.tolist(), strict=True)}
    )
    assert facts["largest_state"] == max(state.max(), following.max())


@pytest.mark.parametrize(
    ("changes", "argument"),
    [
        ({"state": [0, 1, -1, 0]}, "state[2]"),
        ({"timestep": [0, 2, 3, 0]}, "timestep[1]"),
        ({"next_state": [2, 2, 3, 2]}, "next_state[0]"),
        ({"terminated": [True, False, True, False]}, "terminated[0]"),
        ({"episode": [7, 3, 7, 7]}, "episode"),
    ],
)
def test_errors_carry_their_argument(changes, argument):
    with pytest.raises(ArgumentError) as refused:
        small_log(**changes)
    assert refused.value.argument == argument
    assert str(refused.value) == f"{argument} {refused.value.rule}"


def test_errors_of_files_carry_the_file_and_the_place(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("state,action,next_state\n0,0,1\n1,x,2\n2,0\n")
    place = f"{str(path)!r}: action[1]"
    with pytest.raises(ArgumentError) as refused:
        Transitions.open(path)
    assert refused.value.argument == place
    assert (
        Transitions.open(path, bad_rows="drop").recording.reasons[0].startswith(place)
    )
    with pytest.raises(ArgumentError) as refused:
        Transitions.load(path)
    assert refused.value.argument == f"{str(path)!r}: row 2 (line 4)"
