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
def test_values_agree_with_value_iteration_on_the_table_itself(name, kwargs):
    """The table's own semantics (nothing after termination), evaluated without any of our conversion."""
    env = gymnasium.make(name, **kwargs)
    table = env.unwrapped.P
    mdp = FiniteMDP.from_gymnasium(env, discount=0.9)
    own = len(table)
    rng = np.random.default_rng(0)
    policy = rng.dirichlet(np.ones(mdp.n_actions), size=own)
    values = np.zeros(own)
    for _ in range(400):
        values = np.array(
            [
                sum(
                    policy[s, a] * p * (r + 0.9 * (0.0 if done else values[t]))
                    for a in range(mdp.n_actions)
                    for p, t, r, done in table[s][a]
                )
                for s in range(own)
            ]
        )
    started = env.unwrapped.initial_state_distrib
    assert_allclose(oee.policy_value(mdp, policy), started @ values, rtol=1e-9)
    entered_by_death = {t for s in table for a in table[s] for _, t, _, done in table[s][a] if done}
    ours = oee.state_values(mdp, policy)
    for s in range(own):
        if s not in entered_by_death or mdp.terminal_state[s] != s:
            assert_allclose(ours[s], values[s], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("name", "kwargs"), ENVIRONMENTS)
def test_terminated_moves_lead_to_states_that_are_over(name, kwargs):
    env = gymnasium.make(name, **kwargs)
    mdp = FiniteMDP.from_gymnasium(env)
    table = env.unwrapped.P
    over = mdp.absorbing()
    transitions = mdp.transitions.toarray().reshape(mdp.n_states, mdp.n_actions, -1)
    for s in table:
        if over[s]:
            continue
        for a in table[s]:
            expected = np.zeros(mdp.n_states)
            for p, t, _, done in table[s][a]:
                expected[mdp.terminal_state[t] if done else t] += p
                assert not done or over[mdp.terminal_state[t]]
            assert_allclose(transitions[s, a], expected, rtol=0, atol=1e-15)


def test_goal_and_holes_of_frozen_lake_stay_apart():
    mdp = oee.tasks.toy_text("FrozenLake-v1", map_name="4x4")
    assert mdp.n_states == 16
    assert_array_equal(np.flatnonzero(mdp.absorbing()), [5, 7, 11, 12, 15])


def test_a_state_entered_alive_as_well_gets_a_twin():
    """Taxi: from its unreachable states the destination is entered without termination, so dropping off needs twins."""
    mdp = oee.tasks.toy_text("Taxi-v4")
    assert mdp.n_states == 504
    assert len(mdp.terminal_state) == 500
    twins = np.flatnonzero(mdp.terminal_state != np.arange(500))
    assert len(twins) == 4
    assert_array_equal(np.sort(mdp.terminal_state[twins]), np.arange(500, 504))


def test_a_policy_of_the_environment_s_own_shape_is_accepted():
    mdp = oee.tasks.toy_text("Taxi-v4")
    own = np.full((500, 6), 1 / 6)
    assert oee.policy_value(mdp, own) == oee.policy_value(mdp, oee.uniform_policy(mdp))
    by_step = oee.policy_value(mdp, np.stack([own] * 3), horizon=3)  # forward in time, the other one backward
    assert_allclose(by_step, oee.policy_value(mdp, own, horizon=3), rtol=1e-13)


def test_rain_comes_with_its_probability():
    mdp = oee.tasks.toy_text("Taxi-v4", is_rainy=True, rainy_probability=0.6)
    largest = mdp.transitions.max(axis=1).toarray()
    assert np.isclose(largest, 0.6).any()


def test_refusals():
    with pytest.raises(ValueError, match="fickle Taxi passenger changes its destination outside it"):
        FiniteMDP.from_gymnasium(gymnasium.make("Taxi-v4", fickle_passenger=True))
    with pytest.raises(ValueError, match="BlackjackEnv has none"):
        FiniteMDP.from_gymnasium(gymnasium.make("Blackjack-v1"))
    flipped = gymnasium.wrappers.TransformReward(gymnasium.make("FrozenLake-v1"), lambda r: -r)
    with pytest.raises(ValueError, match="the wrapper TransformReward may"):
        FiniteMDP.from_gymnasium(flipped)
    sticky = gymnasium.wrappers.StickyAction(gymnasium.make("FrozenLake-v1"), 0.25)
    with pytest.raises(ValueError, match="the wrapper StickyAction may"):
        FiniteMDP.from_gymnasium(sticky)


def test_terminal_states_survive_saving_and_noise(tmp_path):
    mdp = oee.tasks.toy_text("Taxi-v4")
    mdp.save(tmp_path / "taxi.npz")
    for other in (FiniteMDP.load(tmp_path / "taxi.npz"), mdp.with_action_noise(0.1), mdp.with_discount(0.5)):
        assert_array_equal(other.terminal_state, mdp.terminal_state)
        assert other.absorbing()[500:].all()


@pytest.mark.parametrize(
    "wrap",
    [
        gymnasium.wrappers.NormalizeReward,
        lambda env: gymnasium.wrappers.FrameStackObservation(env, 2),
        lambda env: gymnasium.wrappers.DelayObservation(env, 1),
    ],
)
def test_wrappers_that_may_change_anything_are_refused(wrap):
    with pytest.raises(ValueError, match=r"the wrapper .* may"):
        FiniteMDP.from_gymnasium(wrap(gymnasium.make("FrozenLake-v1")))
    harmless = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.make("FrozenLake-v1"))
    assert FiniteMDP.from_gymnasium(harmless).n_states == 16


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
    assert mdp.n_states == 3
    assert_array_equal(mdp.transitions.toarray(), [[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0]])
    assert_array_equal(mdp.initial, [0, 0, 1])
    assert_array_equal(oee.state_values(mdp, np.ones((3, 1))), [0, 0, 1])
