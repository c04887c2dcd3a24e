"""MDPs of Gymnasium's tables: the table's own values, where termination leads, and what is refused."""

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular import FiniteMDP

ENVIRONMENTS = [
    ("FrozenLake-v1", {"map_name": "4x4"}),
    ("FrozenLake-v1", {"map_name": "8x8", "success_rate": 0.6}),
    ("FrozenLake-v1", {"desc": ["SFH", "FFG"], "is_slippery": False}),
    ("CliffWalking-v1", {}),
    ("CliffWalking-v1", {"is_slippery": True}),
    ("Taxi-v4", {}),
    ("Taxi-v4", {"is_rainy": True, "rainy_probability": 0.6}),
]


@pytest.mark.parametrize(("name", "kwargs"), ENVIRONMENTS)
def test_values_and_terminations_are_those_of_the_table_itself(name, kwargs):
    """By value iteration on the table (nothing after termination), without any of our conversion."""
    env = gymnasium.make(name, **kwargs)
    table, mdp = env.unwrapped.P, FiniteMDP.from_gymnasium(env, discount=0.9)
    policy = np.random.default_rng(0).dirichlet(np.ones(mdp.n_actions), size=len(table))
    rows = [(s, a, p, t, r, done) for s in table for a in table[s] for p, t, r, done in table[s][a]]
    s, a, p, t, r, done = (np.array(column) for column in zip(*rows, strict=True))
    values = np.zeros(len(table))
    for _ in range(400):
        values = np.bincount(s, policy[s, a] * p * (r + 0.9 * np.where(done, 0.0, values[t])), len(table))
    assert_allclose(oee.policy_value(mdp, policy), env.unwrapped.initial_state_distrib @ values, rtol=1e-9)
    is_own = ~np.isin(np.arange(len(table)), t[done]) | (mdp.terminal_state != np.arange(len(table)))
    assert_allclose(oee.state_values(mdp, policy)[: len(table)][is_own], values[is_own], rtol=1e-9, atol=1e-9)
    over, expected = mdp.absorbing(), np.zeros((mdp.n_states, mdp.n_actions, mdp.n_states))
    np.add.at(expected, (s, a, np.where(done, mdp.terminal_state[t], t)), p)
    assert over[mdp.terminal_state[t[done]]].all()
    assert_allclose(mdp.transitions.toarray().reshape(expected.shape)[~over], expected[~over], rtol=0, atol=1e-15)


def test_goal_and_holes_of_frozen_lake_stay_apart():
    mdp = oee.tasks.toy_text("FrozenLake-v1", map_name="4x4")
    assert mdp.n_states == 16
    assert_array_equal(np.flatnonzero(mdp.absorbing()), [5, 7, 11, 12, 15])


def test_a_state_entered_alive_as_well_gets_a_twin(tmp_path):
    """Taxi: from its unreachable states the destination is entered without termination, so dropping off needs twins."""
    mdp = oee.tasks.toy_text("Taxi-v4")
    twins = np.flatnonzero(mdp.terminal_state != np.arange(500))
    assert (mdp.n_states, len(mdp.terminal_state), len(twins)) == (504, 500, 4)
    assert_array_equal(np.sort(mdp.terminal_state[twins]), np.arange(500, 504))
    mdp.save(tmp_path / "taxi.npz")
    for other in (FiniteMDP.load(tmp_path / "taxi.npz"), mdp.with_action_noise(0.1), mdp.with_discount(0.5)):
        assert_array_equal(other.terminal_state, mdp.terminal_state)
        assert other.absorbing()[500:].all()
    own = np.full((500, 6), 1 / 6)  # a policy of the environment's own shape
    assert oee.policy_value(mdp, own) == oee.policy_value(mdp, oee.uniform_policy(mdp))
    by_step = oee.policy_value(mdp, np.stack([own] * 3), horizon=3)  # forward in time, the other one backward
    assert_allclose(by_step, oee.policy_value(mdp, own, horizon=3), rtol=1e-13)


def lake():
    return gymnasium.make("FrozenLake-v1")


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: gymnasium.make("Taxi-v4", fickle_passenger=True),
            "fickle Taxi passenger changes its destination outside",
        ),
        (lambda: gymnasium.make("Blackjack-v1"), "BlackjackEnv has none"),
        (lambda: gymnasium.wrappers.TransformReward(lake(), lambda r: -r), "the wrapper TransformReward may"),
        (lambda: gymnasium.wrappers.StickyAction(lake(), 0.25), "the wrapper StickyAction may"),
        (lambda: gymnasium.wrappers.NormalizeReward(lake()), "the wrapper NormalizeReward may"),
        (lambda: gymnasium.wrappers.FrameStackObservation(lake(), 2), "the wrapper FrameStackObservation may"),
        (lambda: gymnasium.wrappers.DelayObservation(lake(), 1), "the wrapper DelayObservation may"),
    ],
)
def test_refusals(make, text):
    with pytest.raises(ValueError, match=text):
        FiniteMDP.from_gymnasium(make())
    assert FiniteMDP.from_gymnasium(gymnasium.wrappers.RecordEpisodeStatistics(lake())).n_states == 16


class Corridor(gymnasium.Env):
    """State 2, the last one, is begun in and never entered; an outcome of probability 0 leads there."""

    observation_space, action_space = gymnasium.spaces.Discrete(3), gymnasium.spaces.Discrete(1)
    initial_state_distrib = np.array([0.0, 0.0, 1.0])
    P = {
        0: {0: [(1.0, 0, 0.0, True)]},
        1: {0: [(0.5, 0, 0.0, True), (0.5, 1, 0.0, False), (0.0, 2, 7.0, False)]},
        2: {0: [(1.0, 1, 1.0, False)]},
    }


def test_a_table_whose_last_state_is_never_entered():
    mdp = FiniteMDP.from_gymnasium(Corridor(), discount=0.5)
    assert_array_equal(mdp.transitions.toarray(), [[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0]])
    assert_array_equal(mdp.initial, [0, 0, 1])
    assert_array_equal(oee.state_values(mdp, np.ones((3, 1))), [0, 0, 1])
