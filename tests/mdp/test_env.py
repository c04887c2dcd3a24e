import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from helpers import random_mdp
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular.exceptions import ArgumentError

# what check_env says of every environment without a spec of gymnasium.make
pytestmark = pytest.mark.filterwarnings("ignore:.*not having a spec")


def machine():
    """In `full` it cannot recharge; a name, a mask, rewards r(s, a, s')."""
    P = np.zeros((3, 3, 3))
    P[0, 0], P[0, 1] = [0.7, 0.3, 0.0], [1.0, 0.0, 0.0]
    P[1, 0], P[1, 1], P[1, 2] = [0.0, 0.6, 0.4], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]
    P[2, 1] = [0.0, 0.0, 1.0]
    rewards = np.zeros((3, 3, 3))
    rewards[0, 0], rewards[1, 0] = [2.0, 1.0, 0.0], [0.0, 2.0, -3.0]
    return oee.FiniteMDP(
        P,
        rewards,
        [0.5, 0.5, 0.0],
        0.9,
        available=P.sum(axis=2) > 0,
        state_names=["full", "low", "flat"],
        action_names=["search", "wait", "recharge"],
    )


def models():
    yield "grid", oee.tasks.gridworld(4, 0.2)
    yield (
        "grid with names",
        oee.tasks.gridworld(3, 0.0).with_names(
            [f"cell {k}" for k in "abcdefghi"], ["a", "b", "c", "d"]
        ),
    )
    for name in ("FrozenLake-v1", "CliffWalking-v1", "Taxi-v4"):
        yield name, oee.FiniteMDP.from_gymnasium(gymnasium.make(name))
    yield "unavailable", machine()
    for k in range(4):
        rng = np.random.default_rng(k)
        yield f"random {k}", random_mdp(rng, form=1 + k % 3)


MODELS = dict(models())


@pytest.mark.parametrize("name", MODELS)
def test_gymnasium_accepts_it(name):
    assert len(MODELS) == 10
    check_env(MODELS[name].to_env(max_steps=20))


def test_it_moves_and_pays_as_the_mdp():
    mdp = machine()
    env = mdp.to_env(max_steps=100)
    counts = np.zeros((9, 3))
    starts = np.zeros(3)
    state, info = env.reset(seed=1)
    starts[state] += 1
    for _ in range(20_000):
        assert_array_equal(info["action_mask"], mdp.available[state])
        assert info["state_name"] == mdp.state_names[state]
        action = env.action_space.sample()
        following, reward, terminated, truncated, info = env.step(action)
        assert mdp.available[state, action]
        assert info["action_name"] == mdp.action_names[action]
        counts[state * 3 + action, following] += 1
        assert reward == mdp.transition_rewards[state * 3 + action, following]
        assert terminated == mdp.absorbing()[following]
        state = following
        if terminated or truncated:
            state, info = env.reset()
            starts[state] += 1
    P = mdp.transitions.toarray()
    assert not counts[P == 0].any()
    for expected, found in ((P, counts), (mdp.initial[None], starts[None])):
        n = found.sum(axis=1, keepdims=True)
        error = np.sqrt(expected * (1 - expected) / np.maximum(n, 1))
        assert (
            abs(found / np.maximum(n, 1) - expected)[n[:, 0] > 0]
            <= 5 * error[n[:, 0] > 0] + 1e-12
        ).all()


def test_a_seed_decides_all_that_follows():
    def play(seed):
        env = MODELS["grid"].to_env(max_steps=30)
        steps = [env.reset(seed=seed)[0]]
        while True:
            state, reward, terminated, truncated, _ = env.step(len(steps) % 4)
            steps.append((state, reward))
            if terminated or truncated:
                return steps

    assert play(3) == play(3)
    assert any(play(3) != play(seed) for seed in range(4, 8))


def test_an_agent_in_it_estimates_the_mdp():
    mdp = MODELS["grid"]
    found = oee.FiniteMDP.from_env(mdp.to_env(), samples_per_pair=400, seed=0)
    assert found.rewards.shape == mdp.rewards.shape
    difference = found.transitions.toarray() - mdp.transitions.toarray()
    assert abs(difference[~np.repeat(mdp.absorbing(), 4)]).max() < 0.15


def test_it_draws_a_map_or_names_the_state():
    env = oee.tasks.gridworld(3, 0.0).to_env()
    env.reset(seed=0)
    assert env.render() == "@..\n...\n..T"
    env.step(1)
    assert env.render().count("@") == 1
    env = machine().to_env()
    state, _ = env.reset(seed=0)
    assert env.render() == f"state {env.mdp.state_names[state]}"


def test_refuses_what_no_state_has():
    mdp = machine()
    env = mdp.to_env()
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episode has begun"):
        env.step(0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.render()
    while env.reset()[0] != 0:
        pass
    with pytest.raises(
        ArgumentError, match=r"available in state full.*recharge is not"
    ):
        env.step(2)
    for action in (3, -1, 0.5, "wait", None, np.array([0, 1])):
        with pytest.raises(
            ArgumentError, match=r"action must be an integer from 0 to 2"
        ):
            env.step(action)
    for max_steps in (0, -1, 2.5, "3"):
        with pytest.raises(ArgumentError, match="max_steps must"):
            mdp.to_env(max_steps=max_steps)


def test_an_episode_is_truncated_and_then_over():
    env = machine().to_env(max_steps=2)
    env.reset(seed=0)
    ends = [env.step(1)[2:4] for _ in range(2)]
    assert ends == [(False, False), (False, True)]
    with pytest.raises(gymnasium.error.ResetNeeded, match="the episode is over"):
        env.step(1)
