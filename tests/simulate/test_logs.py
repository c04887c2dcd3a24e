import numpy as np
import pytest
from helpers import dense, printed_with_threads, random_mdp, random_policy, rngs, survival_chain
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import oee_tabular as oee
from oee_tabular.simulate import _rollout as rollout
from oee_tabular.simulate.logs import episodes_holding


@pytest.mark.parametrize(
    ("counter", "key", "answer"),
    [
        # Random123's kat_vectors for philox4x32-10
        ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xA4093822, 0x299F31D0),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_philox_gives_its_published_answers(counter, key, answer):
    found = rollout.philox(*(np.uint64(word) for word in (*counter, *key)))
    assert tuple(int(word) for word in found) == answer


def test_uniforms_are_in_the_unit_interval_and_uniform():
    key = np.uint64(12345678901234567)
    draws = np.array([rollout.uniforms(key, i, t) for i in range(300) for t in range(30)]).reshape(-1)
    assert draws.min() >= 0
    assert draws.max() < 1
    assert stats.kstest(draws, "uniform").pvalue > 1e-3
    assert len(np.unique(draws)) == len(draws)


SCRIPT = """
import hashlib, numpy as np, oee_tabular as oee
mdp = oee.tasks.gridworld(7, 0.3)
a = oee.sample_episodes(mdp, oee.uniform_policy(mdp), 200, 60, seed=11)
b = oee.sample_transitions(mdp, np.full((49, 4), 1 / 196), 5000, seed=12)
text = b"".join(np.ascontiguousarray(x).tobytes() for log in (a, b) for x in log.columns().values())
print(hashlib.sha256(text).hexdigest())
"""


def test_the_same_seed_gives_the_same_bits_for_any_number_of_threads():
    assert printed_with_threads(SCRIPT, 1) == printed_with_threads(SCRIPT, 2) != ""


def test_seeds_are_what_default_rng_takes():
    mdp = survival_chain()
    policy = np.ones((2, 1))
    one = oee.sample_episodes(mdp, policy, 50, 20, seed=np.random.SeedSequence(5, spawn_key=(1, 2)))
    two = oee.sample_episodes(mdp, policy, 50, 20, seed=np.random.SeedSequence(5, spawn_key=(1, 2)))
    assert_array_equal(one.next_state, two.next_state)
    generator = np.random.default_rng(0)
    first = oee.sample_episodes(mdp, policy, 50, 20, seed=generator)
    second = oee.sample_episodes(mdp, policy, 50, 20, seed=generator)
    assert len(first) != len(second) or not np.array_equal(first.next_state, second.next_state)


@given(rngs)
def test_running_sums_restart_in_each_row(rng):
    lengths = rng.integers(1, 6, size=int(rng.integers(1, 20)))
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    data = rng.random(indptr[-1])
    expected = np.concatenate([np.cumsum(data[a:b]) for a, b in zip(indptr[:-1], indptr[1:], strict=True)])
    assert_allclose(rollout.running_sums(data, indptr), expected, rtol=1e-15)


def test_moves_follow_the_distribution_and_the_transitions():
    """Chi-square of 200 000 moves against P(s' | s, a) w(s, a); impossible moves never happen."""
    rng = np.random.default_rng(4)
    mdp = random_mdp(rng, n_states=5, n_actions=3)
    weights = rng.dirichlet(np.ones(15)).reshape(5, 3)
    n = 200_000
    log = oee.sample_transitions(mdp, weights, n, seed=1)
    expected = n * (weights.reshape(-1)[:, None] * mdp.transitions.toarray()).reshape(-1)
    found = log.counts(5, 3).toarray().reshape(-1)
    assert found[expected == 0].sum() == 0
    assert stats.chisquare(found[expected > 0], expected[expected > 0]).pvalue > 1e-4


def test_episodes_follow_initial_policy_and_transitions():
    rng = np.random.default_rng(8)
    mdp = random_mdp(rng, n_states=4, n_actions=2, discount=0.9)
    policy = random_policy(rng, mdp)
    log = oee.sample_episodes(mdp, policy, 60_000, 3, seed=2)
    first = log.timestep == 0
    n = first.sum()
    expected = n * mdp.initial
    found = np.bincount(log.state[first], minlength=4)
    assert found[expected == 0].sum() == 0
    assert stats.chisquare(found[expected > 0], expected[expected > 0]).pvalue > 1e-4
    undiscounted = mdp.with_discount(1.0)
    share = oee.occupancy(undiscounted, policy, horizon=3, of="transition").toarray()
    if not mdp.absorbing().any():
        assert_allclose(log.counts(4, 2).toarray() / len(log), share, rtol=0, atol=5 / np.sqrt(len(log)))
    assert_array_equal(log.behavior_probability, policy[log.state, log.action])
    transitions, rewards = dense(mdp)
    assert (transitions[log.state, log.action, log.next_state] > 0).all()
    assert_allclose(log.reward, rewards[log.state, log.action, log.next_state])


def test_episodes_end_where_they_are_over():
    log = oee.sample_episodes(survival_chain(), np.ones((2, 1)), 4000, 5, seed=0)
    lengths = np.diff(log.episode_starts)
    ended = log.terminated[log.episode_starts[1:] - 1]
    assert_array_equal(ended, log.next_state[log.episode_starts[1:] - 1] == 1)
    assert (lengths[~ended] == 5).all()
    assert_array_equal(log.truncated[log.episode_starts[1:] - 1], ~ended)
    assert_allclose((lengths == 1).mean(), 0.3, atol=0.03)


def test_an_entry_of_probability_zero_is_never_picked_whatever_the_draw():
    cumulative = np.array([0.0, 0.5, 0.5, 1.0, 1.0])
    picked = [int(rollout.pick(cumulative, 0, 5, u)) for u in (0.0, 0.25, 0.5, 0.75, 1 - 2**-53)]
    assert picked == [1, 1, 3, 3, 3]


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (lambda m, p: oee.sample_transitions(m, p / 9, 0, seed=0), "^n must be a positive integer; it is 0"),
        (lambda m, p: oee.sample_transitions(m, p, 5, seed=0), "^distribution must sum to 1 .*; it sums to 9"),
        (lambda m, p: oee.sample_transitions(m, np.ones(4), 5, seed=0), "^distribution must have 2 dimension"),
        (lambda m, p: oee.sample_transitions(m, np.ones((3, 4)) / 12, 5, seed=0), r"^distribution must have shape \(9, 4\)"),
        (lambda m, p: oee.sample_episodes(m, p, 0, 5, seed=0), "^n_episodes must be a positive integer; it is 0"),
        (lambda m, p: oee.sample_episodes(m, p, 5, 0, seed=0), "^horizon must be a positive integer; it is 0"),
        (lambda m, p: oee.sample_episodes(m, p, 5, 5, seed="x"), "^seed must be what numpy.random.default_rng takes; got 'x'"),
    ],
)  # fmt: skip
def test_bad_calls(bad, words):
    mdp = oee.tasks.gridworld(3, slip=0.1)
    with pytest.raises(ValueError, match=words):
        bad(mdp, oee.uniform_policy(mdp))


def test_twins_of_terminal_states_are_not_drawn_from():
    """A distribution over the environment's own states is one over all, with nothing on the twins."""
    rows = np.array([[[0.5, 0.5, 0.0, 0.0]], [[0.0, 0.0, 0.6, 0.4]], [[0.0, 0.0, 1.0, 0.0]], [[0.0, 0.0, 0.0, 1.0]]])
    mdp = oee.FiniteMDP(rows, np.ones((4, 1)), [1, 0, 0, 0], 0.9, terminal_state=[2, 3])
    own = np.array([[0.25], [0.75]])
    log = oee.sample_transitions(mdp, own, 2000, seed=0)
    same = oee.sample_transitions(mdp, np.concatenate([own, np.zeros((2, 1))]), 2000, seed=0)
    assert_array_equal(log.next_state, same.next_state)
    assert log.state.max() == 1
    assert not log.terminated.any()
    episodes = oee.sample_episodes(mdp, np.ones((4, 1)), 20, 4, seed=0)
    assert episodes.terminated.dtype == bool


@pytest.mark.parametrize("n", [1, 100, 401])
def test_whole_episodes_hold_n_moves(n):
    """At least n moves, whole episodes, and of one seed the same whatever number of episodes is tried first."""
    grid = oee.tasks.gridworld(3, slip=0.1)
    policy = oee.tasks.gridworld_expert(3)
    logs = [episodes_holding(grid, policy, n, 20, seed=0, first=first) for first in (None, 1, 500)]
    for log in logs:
        assert len(log) >= n
        assert log.terminated[-1]
        assert_array_equal(log.first(n).state, logs[0].first(n).state)
    generators = [episodes_holding(grid, policy, n, 20, seed=np.random.default_rng(1)) for _ in range(2)]
    assert_array_equal(generators[0].state, generators[1].state)
