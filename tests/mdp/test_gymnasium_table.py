"""MDPs of Gymnasium's tables: the table's own values, where termination leads, names
and maps, and what is refused.
"""

from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from helpers import Dense
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
    """By value iteration on the table (nothing after termination), without any of our
    conversion.
    """
    env = gymnasium.make(name, **kwargs)
    table = env.unwrapped.P
    mdp = FiniteMDP.from_gymnasium(env, discount=0.9)
    policy = np.random.default_rng(0).dirichlet(np.ones(mdp.n_actions), size=len(table))
    rows = []
    for s in table:
        for a in table[s]:
            rows += [(s, a, *outcome) for outcome in table[s][a]]
    s, a, p, t, r, done = (np.array(column) for column in zip(*rows, strict=True))
    values = np.zeros(len(table))
    for _ in range(400):
        values = np.bincount(
            s, policy[s, a] * p * (r + 0.9 * np.where(done, 0.0, values[t])), len(table)
        )
    assert_allclose(
        oee.policy_value(mdp, policy),
        env.unwrapped.initial_state_distrib @ values,
        rtol=1e-9,
    )
    is_own = ~np.isin(np.arange(len(table)), t[done]) | (
        mdp.terminal_state != np.arange(len(table))
    )
    assert_allclose(
        oee.state_values(mdp, policy)[: len(table)][is_own],
        values[is_own],
        rtol=1e-9,
        atol=1e-9,
    )
    over = mdp.absorbing()
    expected = np.zeros((mdp.n_states, mdp.n_actions, mdp.n_states))
    np.add.at(expected, (s, a, np.where(done, mdp.terminal_state[t], t)), p)
    assert over[mdp.terminal_state[t[done]]].all()
    assert_allclose(
        mdp.transitions.toarray().reshape(expected.shape)[~over],
        expected[~over],
        rtol=0,
        atol=1e-15,
    )


@pytest.mark.parametrize(
    ("name", "kwargs", "columns", "actions"),
    [
        ("FrozenLake-v1", {"map_name": "8x8"}, 8, ("left", "down", "right", "up")),
        ("FrozenLake-v1", {"desc": ["SFH", "FFG"]}, 3, ("left", "down", "right", "up")),
        ("CliffWalking-v1", {}, 12, ("up", "right", "down", "left")),
    ],
)
def test_maps_have_rows_columns_and_directions(name, kwargs, columns, actions):
    mdp = oee.tasks.toy_text(name, **kwargs)
    assert_array_equal(mdp.layout, [divmod(s, columns) for s in range(mdp.n_states)])
    assert (mdp.action_names, mdp.state_names) == (actions, None)


def test_goal_and_holes_of_frozen_lake_stay_apart():
    mdp = oee.tasks.toy_text("FrozenLake-v1", map_name="4x4")
    assert mdp.n_states == 16
    assert_array_equal(np.flatnonzero(mdp.absorbing()), [5, 7, 11, 12, 15])


def test_a_state_entered_alive_as_well_gets_a_twin(tmp_path):
    """Taxi: from its unreachable states the destination is entered without termination,
    so dropping off needs twins.
    """
    mdp = oee.tasks.toy_text("Taxi-v4")
    # its map is not its states
    assert (mdp.layout, mdp.state_names, mdp.action_names) == (None, None, None)
    twins = np.flatnonzero(mdp.terminal_state != np.arange(500))
    assert (mdp.n_states, len(mdp.terminal_state), len(twins)) == (504, 500, 4)
    assert_array_equal(np.sort(mdp.terminal_state[twins]), np.arange(500, 504))
    mdp.save(tmp_path / "taxi.npz")
    for other in (
        FiniteMDP.load(tmp_path / "taxi.npz"),
        mdp.with_action_noise(0.1),
        mdp.with_discount(0.5),
    ):
        assert_array_equal(other.terminal_state, mdp.terminal_state)
        assert other.absorbing()[500:].all()
    own = np.full((500, 6), 1 / 6)  # a policy of the environment's own shape
    assert oee.policy_value(mdp, own) == oee.policy_value(mdp, oee.uniform_policy(mdp))
    # forward in time, the other one backward
    by_step = oee.policy_value(mdp, np.stack([own] * 3), horizon=3)
    assert_allclose(by_step, oee.policy_value(mdp, own, horizon=3), rtol=1e-13)


class Ledge(gymnasium.Env):
    """Four states; 3 is entered alive from 1 and by termination from 2, and so has a
    twin; 0 ends with probability 0.
    """

    observation_space = gymnasium.spaces.Discrete(4)
    action_space = gymnasium.spaces.Discrete(2)
    initial_state_distrib = np.array([1.0, 0.0, 0.0, 0.0])
    P = {
        0: {
            0: [(0.5, 1, 0.0, False), (0.5, 2, 0.0, False)],
            1: [(1.0, 0, 0.0, False), (0.0, 3, 7.0, True)],
        },
        1: {a: [(1.0, 3, 0.0, False)] for a in range(2)},
        2: {a: [(1.0, 3, 1.0, True)] for a in range(2)},
        3: {a: [(1.0, 2, 0.0, False)] for a in range(2)},
    }


PLACES = [("a", 0), ("a", 1), ("b", 0), ("b", 1)]


@pytest.mark.parametrize(
    ("facts", "states", "actions", "layout"),
    [
        ({"shape": (2, 2)}, None, None, [[0, 0], [0, 1], [1, 0], [1, 1], [1, 1]]),
        (
            {"shape": (4,), "state_names": PLACES},
            (*PLACES, ("b", 1, "over")),
            None,
            None,
        ),
        (
            {"shape": (2, 3), "state_names": list("wxyz")},
            (*"wxyz", "z (over)"),
            None,
            None,
        ),
        ({"shape": (4, None), "action_names": ["a", "b"]}, None, ("a", "b"), None),
        (
            {"get_action_meanings": lambda self: ["NOOP", "FIRE"]},
            None,
            ("NOOP", "FIRE"),
            None,
        ),
        (
            {"shape": "2x2", "action_names": ["a", "a"], "state_names": ["only one"]},
            None,
            None,
            None,
        ),
    ],
)
def test_names_and_map_of_an_environment(facts, states, actions, layout):
    """A twin is called, and lies, as its state; what does not fit the states is left."""
    mdp = FiniteMDP.from_gymnasium(type("Named", (Ledge,), facts)())
    assert mdp.terminal_state.tolist() == [0, 1, 2, 4]
    assert (mdp.state_names, mdp.action_names) == (states, actions)
    assert_array_equal(mdp.layout, layout)
    own = [0, 0, 1, 1]  # policies of the environment's own states
    for policy in (own, [*own, 0], np.eye(2)[own], dict(enumerate(own))):
        assert_array_equal(oee.mdp.check_policy(policy, mdp)[:4], np.eye(2)[own])


def lake():
    return gymnasium.make("FrozenLake-v1")


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (
            lambda: gymnasium.make("Taxi-v4", fickle_passenger=True),
            "fickle Taxi passenger changes its destination",
        ),
        (lambda: gymnasium.make("Blackjack-v1"), "BlackjackEnv has none"),
        (
            lambda: gymnasium.wrappers.TransformReward(lake(), lambda r: -r),
            "the wrapper TransformReward may",
        ),
        (
            lambda: gymnasium.wrappers.StickyAction(lake(), 0.25),
            "the wrapper StickyAction may",
        ),
        (
            lambda: gymnasium.wrappers.FrameStackObservation(lake(), 2),
            "the wrapper FrameStackObservation may",
        ),
    ],
)
def test_refusals(make, text):
    with pytest.raises(ValueError, match=text):
        FiniteMDP.from_gymnasium(make())
    assert (
        FiniteMDP.from_gymnasium(
            gymnasium.wrappers.RecordEpisodeStatistics(lake())
        ).n_states
        == 16
    )


def test_a_toy_text_table_with_duplicates_and_ends_by_path():
    """Outcomes of one (s, a, s') are added up, their rewards averaged by probability;
    what was ended pays no more.
    """
    table = {
        0: {
            0: [(0.3, 1, 1.0, False), (0.2, 1, 5.0, False), (0.5, 2, -1.0, True)],
            1: [(1.0, 0, 0.5, False)],
        },
        1: {
            0: [(0.6, 2, 2.0, False), (0.4, 2, 3.0, True)],
            1: [(0.0, 0, 9.0, False), (1.0, 1, 0.0, False)],
        },
        2: {0: [(1.0, 0, 4.0, False)], 1: [(0.5, 2, 1.0, False), (0.5, 0, 1.0, True)]},
    }
    env = SimpleNamespace(P=table, initial_state_distrib=np.array([1.0, 0.0, 0.0]))
    mdp = FiniteMDP.from_gymnasium(env, discount=0.9)
    policy = np.array([[0.7, 0.3], [0.5, 0.5], [0.4, 0.6]])

    def walk(s, steps):
        if steps == 0:
            return 0.0
        value = 0.0
        for a in range(2):
            for p, j, r, ended in table[s][a]:
                if p > 0:
                    later = 0.0 if ended else 0.9 * walk(j, steps - 1)
                    value += policy[s, a] * p * (r + later)
        return value

    assert_allclose(oee.policy_value(mdp, policy, horizon=5), walk(0, 5), rtol=1e-12)
    assert_allclose(mdp.transitions.toarray().sum(axis=1), 1.0, rtol=1e-15)
    assert_allclose(Dense(mdp).P[0, 0, 1], 0.5)
    assert_allclose(Dense(mdp).r[0, 0, 1], (0.3 * 1 + 0.2 * 5) / 0.5)
