"""Sampled returns: the bits, the sums along recorded paths, and exact moments."""

import math

import numpy as np
import pytest
from helpers import dense, printed, random_mdp, random_policy, rngs, survival_chain
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

import oee_tabular as oee
from oee_tabular.simulate.sampler import episodes_holding

FIELDS = ("values", "returns", "weights", "lengths", "final_state")
GRID = oee.tasks.gridworld(4, 0.3)
UNIFORM = oee.uniform_policy(GRID)
ZETA = oee.true_ratio(oee.tasks.gridworld(4, 0.2), GRID)


def assert_same(one, two, rows=slice(None)):
    for name in FIELDS:
        assert_array_equal(
            getattr(one, name)[rows], getattr(two, name)[rows], err_msg=name
        )


SCRIPT = """
import hashlib, oee_tabular as oee
mdp = oee.tasks.gridworld(7, 0.3)
policy, zeta = oee.uniform_policy(mdp), oee.true_ratio(oee.tasks.gridworld(7, 0.2), mdp)
logs = oee.sample_episodes(mdp, policy, 200, 60, seed=11), oee.sample_transitions(mdp, policy / 49, 5000, seed=12)
columns = [column for log in logs for column in log.columns().values()]
for n in (3001, 30_001):  # the second is shared by threads
    drawn = oee.sample_returns(mdp, policy, n, 61, seed=11, zeta=zeta)
    columns += [drawn.values, drawn.returns, drawn.weights, drawn.lengths, drawn.final_state]
print(hashlib.sha256(b"".join(column.tobytes() for column in columns)).hexdigest())
"""


@pytest.mark.large
def test_the_same_bits_for_any_number_of_threads():
    assert (
        printed(SCRIPT, NUMBA_NUM_THREADS=1)
        == printed(SCRIPT, NUMBA_NUM_THREADS=2)
        != ""
    )


def test_an_episode_does_not_depend_on_how_many_there_are_nor_on_what_is_computed():
    few, many = (oee.sample_returns(GRID, UNIFORM, n, 25, seed=3) for n in (40, 500))
    assert_same(few, many, slice(40))
    for options in (
        {"zeta": ZETA},
        {"zeta": ZETA, "kind": "trajectory"},
        {"record": True},
    ):
        other = oee.sample_returns(GRID, UNIFORM, 500, 25, seed=3, **options)
        assert_array_equal(other.returns, many.returns)
        assert_array_equal(other.final_state, many.final_state)


def test_one_seed_gives_independent_samples_of_each_kind():
    """A log and the returns to be compared with it are drawn from different numbers."""
    log = oee.sample_episodes(GRID, UNIFORM, 2000, 1, seed=3)
    other = oee.sample_returns(GRID, UNIFORM, 2000, 1, seed=3, record=True).log
    expected = (
        np.outer(*(np.bincount(x.action, minlength=4) for x in (log, other))) / 2000
    )
    observed = np.histogram2d(log.action, other.action, bins=np.arange(5) - 0.5)[0]
    assert stats.chi2.sf(((observed - expected) ** 2 / expected).sum(), 9) > 1e-4


@settings(max_examples=40)
@given(rngs)
def test_sums_along_the_recorded_paths(rng):
    """Sums equal what the log gives step by step, for every form of rewards and kind.

    Horizons are within and beyond a block of random words.
    """
    mdp = random_mdp(rng)
    policy = random_policy(rng, mdp)
    horizon = int(rng.integers(1, 70))
    zeta = oee.true_ratio(random_mdp(rng, like=mdp), mdp)
    key = int(rng.integers(1 << 30))
    ratio = zeta.values.toarray().reshape(mdp.n_states, mdp.n_actions, -1)
    terminal = mdp.absorbing()
    by_transition = mdp.transition_rewards is not None
    for kind in ("per_decision", "trajectory"):
        drawn = oee.sample_returns(
            mdp, policy, 17, horizon, seed=key, zeta=zeta, kind=kind, record=True
        )
        log = drawn.log
        starts = drawn.log.episode_starts
        assert_array_equal(np.diff(starts), drawn.lengths)
        assert_array_equal(log.next_state[starts[1:] - 1], drawn.final_state)
        assert_array_equal(log.terminated[starts[1:] - 1], terminal[drawn.final_state])
        assert (mdp.initial[log.state[starts[:-1]]] > 0).all()
        assert (policy[log.state, log.action] > 0).all()
        for i in range(17):
            plain = 0.0
            weighted = 0.0
            w = 1.0
            whole = 1.0
            for t, row in enumerate(range(starts[i], starts[i + 1])):
                s = log.state[row]
                a = log.action[row]
                following = log.next_state[row]
                after = w * (1.0 if terminal[s] else ratio[s, a, following])
                plain += mdp.discount**t * log.reward[row]
                weighted += (
                    mdp.discount**t * (after if by_transition else w) * log.reward[row]
                )
                whole = w if not by_transition and t == horizon - 1 else after
                w = after
            assert_allclose(drawn.returns[i], plain, rtol=1e-12, atol=1e-12)
            assert_allclose(drawn.weights[i], whole, rtol=1e-12)
            expected = weighted if kind == "per_decision" else whole * plain
            assert_allclose(drawn.values[i], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", ["per_decision", "trajectory"])
@pytest.mark.parametrize("pay", ["next", "current"])
def test_weighted_returns_have_the_exact_moments(kind, pay):
    # weights within 1.05^5 or so
    simulator, target = (oee.tasks.gridworld(4, slip, pay=pay) for slip in (0.3, 0.27))
    zeta = oee.true_ratio(target, simulator)
    n = 40_000
    horizon = 6
    drawn = oee.sample_returns(
        simulator, UNIFORM, n, horizon, seed=1, zeta=zeta, kind=kind
    )
    known = oee.weighted_return_moments(
        simulator, zeta, UNIFORM, kind=kind, horizon=horizon
    )
    assert abs(drawn.mean - known.mean) < 4.5 * known.standard_deviation / np.sqrt(n)
    assert_allclose(drawn.values.var(), known.variance, rtol=0.06)
    assert abs(drawn.weights.mean() - 1) < 4.5 * drawn.weights.std() / np.sqrt(n)
    assert_allclose(
        drawn.standard_error, known.standard_deviation / np.sqrt(n), rtol=0.03
    )


def test_an_episode_that_begins_where_it_is_terminal_has_one_step():
    chain = oee.FiniteMDP(
        np.array([[[0.7, 0.3]], [[0.0, 1.0]]]),
        np.array([1.0, 0.0]),
        np.array([0.0, 1.0]),
        0.9,
    )
    for horizon in (1, 9):
        drawn = oee.sample_returns(
            chain, np.ones((2, 1)), 5, horizon, seed=0, record=True
        )
        assert_array_equal(drawn.lengths, np.ones(5))
        assert_array_equal(drawn.returns, np.zeros(5))
        assert drawn.log.terminated.all()


def test_a_generator_is_advanced_and_a_refused_call_leaves_it():
    generator = np.random.default_rng(0)
    other = np.random.default_rng(0)
    first, second = (
        oee.sample_returns(GRID, UNIFORM, 20, 10, seed=generator) for _ in range(2)
    )
    assert not np.array_equal(first.returns, second.returns)
    with pytest.raises(ValueError, match="horizon"):
        oee.sample_returns(GRID, UNIFORM, 20, 0, seed=other)
    assert_same(first, oee.sample_returns(GRID, UNIFORM, 20, 10, seed=other))


def call(mdp=GRID, policy=UNIFORM, n_episodes=3, horizon=4, seed=0, **options):
    return oee.sample_returns(mdp, policy, n_episodes, horizon, seed=seed, **options)


def test_it_prints_what_it_holds():
    drawn = call(n_episodes=50, horizon=20)
    assert repr(drawn).startswith(
        f"SampledReturns(50 episodes, {drawn.lengths.sum()} transitions: mean "
    )
    assert ">largest weight<" in drawn._repr_html_()
    assert drawn.log is None
    assert repr(call(zeta=ZETA, kind="trajectory")).endswith("weighted trajectory)")
    assert len(drawn) == 50
    assert np.isnan(call(n_episodes=1).standard_error)


def test_infinite_weights_leave_rewards_of_0_alone():
    mdp = oee.FiniteMDP(
        np.array([[[0.5, 0.5]], [[0.0, 1.0]]]),
        np.array([1.0, 0.0]),
        np.array([1.0, 0.0]),
        1.0,
    )
    zeta = mdp.transitions.copy()
    zeta.data = np.full(zeta.nnz, 1e200)
    with np.errstate(over="ignore"):
        drawn = oee.sample_returns(mdp, np.ones((2, 1)), 300, 9, seed=0, zeta=zeta)
    assert np.array_equal(np.isinf(drawn.values), drawn.lengths > 2)
    assert not np.isnan(drawn.values).any()


# ---- sampled logs: frequencies by chi-square at fixed seeds, where episodes end, seeds
# and bits, bad calls
def test_seeds_are_what_default_rng_takes():
    mdp = survival_chain()
    policy = np.ones((2, 1))
    one, two = (
        oee.sample_episodes(
            mdp, policy, 50, 20, seed=np.random.SeedSequence(5, spawn_key=(1, 2))
        )
        for _ in range(2)
    )
    assert_array_equal(one.next_state, two.next_state)
    generator = np.random.default_rng(0)
    first, second = (
        oee.sample_episodes(mdp, policy, 50, 20, seed=generator) for _ in range(2)
    )
    assert not np.array_equal(first.next_state, second.next_state)


@settings(max_examples=20)
@given(rngs)
def test_a_log_is_one_that_passes_every_check(rng):
    """The columns are written without them."""
    mdp = random_mdp(rng)
    log = oee.sample_episodes(
        mdp,
        random_policy(rng, mdp),
        7,
        int(rng.integers(1, 40)),
        seed=int(rng.integers(1 << 30)),
    )
    checked = oee.Transitions(**log.columns())
    for name, column in log.columns().items():
        assert_array_equal(column, getattr(checked, name), err_msg=name)
        assert column.dtype == getattr(checked, name).dtype
        assert not column.flags.writeable
    assert str(log) == str(checked)


def test_transitions_follow_the_distribution_and_the_model():
    """100 000 transitions agree with P(s' | s, a) d(s, a) by a chi-square test.

    Impossible transitions never happen.
    """
    rng = np.random.default_rng(4)
    mdp = random_mdp(rng, n_states=5, n_actions=3)
    n = 100_000
    weights = rng.dirichlet(np.ones(15)).reshape(5, 3)
    weights[1] *= [0.0, 1.0, 1.0]
    weights /= weights.sum()
    log = oee.sample_transitions(mdp, weights, n, seed=1)
    expected = n * (weights.reshape(-1)[:, None] * mdp.transitions.toarray()).reshape(
        -1
    )
    observed = log.counts(5, 3).toarray().reshape(-1)
    assert observed[expected == 0].sum() == 0
    assert stats.chisquare(observed[expected > 0], expected[expected > 0]).pvalue > 1e-4
    assert log.episode is None


def test_episodes_follow_initial_policy_and_transitions():
    rng = np.random.default_rng(8)
    mdp = random_mdp(rng, n_states=4, n_actions=2, discount=0.9)
    policy = random_policy(rng, mdp)
    log = oee.sample_episodes(mdp, policy, 30_000, 3, seed=2)
    first = log.timestep == 0
    expected = first.sum() * mdp.initial
    observed = np.bincount(log.state[first], minlength=4)
    assert observed[expected == 0].sum() == 0
    assert stats.chisquare(observed[expected > 0], expected[expected > 0]).pvalue > 1e-4
    joint = policy.reshape(-1)[:, None] * mdp.transitions.toarray()
    # conditional on the states
    visits = np.repeat(np.bincount(log.state, minlength=4), 2)[:, None] * joint
    counts = log.counts(4, 2).toarray()
    assert (counts[visits == 0] == 0).all()
    assert (
        (counts - visits)[visits > 0] ** 2 / visits[visits > 0]
    ).sum() < stats.chi2.isf(1e-4, (visits > 0).sum())
    assert_array_equal(log.behavior_probability, policy[log.state, log.action])
    transitions, rewards = dense(mdp)
    assert (transitions[log.state, log.action, log.next_state] > 0).all()
    assert_allclose(log.reward, rewards[log.state, log.action, log.next_state])


def test_no_random_number_is_used_twice_along_an_episode():
    """All steps are independent: two of them choose alike by chance alone.

    128 successors are equally likely: a step's choice is that of another step in one
    of 128 episodes. The return in base 2 shows the path of rollouts.
    """
    n = 4000
    even = oee.FiniteMDP(
        np.full((128, 1, 128), 1 / 128), np.zeros(128), [1 / 128] * 128, 0.9
    )
    log = oee.sample_episodes(even, np.ones((128, 1)), n, 40, seed=3)
    path = np.column_stack([log.state.reshape(n, 40), log.next_state[39::40]])
    alike = np.array(
        [(path[:, i] == path[:, j]).sum() for i in range(41) for j in range(i)]
    )
    # binomial of n and 1/128: 5.5 standard deviations in any of 820 pairs
    assert alike.max() < n / 128 + 5.5 * math.sqrt(n / 128)
    assert alike.min() > n / 128 - 5.5 * math.sqrt(n / 128)
    bits = oee.FiniteMDP(np.full((2, 1, 2), 0.5), [0.0, 1.0], [0.5, 0.5], 0.5)
    returns = oee.sample_returns(bits, np.ones((2, 1)), n, 48, seed=3).returns
    steps = (returns * 2.0**47).astype(np.int64)
    digits = (steps[:, None] >> np.arange(48)) & 1
    assert (digits @ 2.0 ** -np.arange(47, -1, -1) == returns).all()
    z = np.corrcoef(digits.T) * math.sqrt(n)
    assert np.abs(z[np.triu_indices(48, 1)]).max() < 5.5


def test_episodes_end_where_they_are_terminal():
    log = oee.sample_episodes(survival_chain(), np.ones((2, 1)), 4000, 5, seed=0)
    lengths = np.diff(log.episode_starts)
    last = log.episode_starts[1:] - 1
    ended = log.terminated[last]
    assert_array_equal(ended, log.next_state[last] == 1)
    assert (lengths[~ended] == 5).all()
    assert_array_equal(log.truncated[last], ~ended)
    assert_allclose((lengths == 1).mean(), 0.3, atol=0.03)


@pytest.mark.large
def test_a_long_horizon_is_followed_where_episodes_end():
    with pytest.warns(UserWarning, match="multiply-adds"):
        log = oee.sample_episodes(
            survival_chain(1.0), np.ones((2, 1)), 30, 10**9, seed=0
        )
    assert log.terminated.sum() == 30
    one = oee.sample_episodes(
        oee.FiniteMDP([[[1.0]]], [1.0], [1.0], 0.9), [[1.0]], 2, 500_000, seed=0
    )
    assert np.diff(one.episode_starts).tolist() == [500_000] * 2


def test_twins_of_terminal_states_are_not_drawn_from():
    """A distribution over the environment's own states leaves nothing for the twins."""
    rows = np.array(
        [
            [[0.5, 0.5, 0.0, 0.0]],
            [[0.0, 0.0, 0.6, 0.4]],
            [[0.0, 0.0, 1.0, 0.0]],
            [[0.0, 0.0, 0.0, 1.0]],
        ]
    )
    mdp = oee.FiniteMDP(rows, np.ones((4, 1)), [1, 0, 0, 0], 0.9, terminal_state=[2, 3])
    own = np.array([[0.25], [0.75]])
    log = oee.sample_transitions(mdp, own, 2000, seed=0)
    same = oee.sample_transitions(
        mdp, np.concatenate([own, np.zeros((2, 1))]), 2000, seed=0
    )
    assert_array_equal(log.next_state, same.next_state)
    assert log.state.max() == 1
    assert not log.terminated.any()


@pytest.mark.parametrize("n", [1, 100, 401])
def test_whole_episodes_hold_n_transitions(n):
    """At least n, whole episodes, and of one seed those first that hold fewer."""
    grid = oee.tasks.gridworld(3, slip=0.1)
    policy = oee.tasks.gridworld_expert(3)
    log, more = (
        episodes_holding(grid, policy, size, 20, seed=0) for size in (n, 5 * n)
    )
    assert len(log) >= n
    assert log.terminated[-1]
    assert_array_equal(log.state, more.first(len(log)).state)
