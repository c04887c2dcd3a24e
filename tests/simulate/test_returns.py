"""Sampled returns: the bits, the paths, the sums along them, and exact moments within standard errors."""

import numpy as np
import pytest
from helpers import printed_with_threads, random_mdp, random_policy, rngs, survival_chain
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse, stats

import oee_tabular as oee
from oee_tabular.simulate import _lanes as lanes
from oee_tabular.simulate import _rollout as rollout
from oee_tabular.simulate import sampler as alias
from oee_tabular.simulate.logs import stream_key
from oee_tabular.simulate.sampler import sampler

FIELDS = ("values", "returns", "weights", "lengths", "final_state")
GRID = oee.tasks.gridworld(4, 0.3)
UNIFORM = oee.uniform_policy(GRID)
ZETA = oee.true_ratio(oee.tasks.gridworld(4, 0.2), GRID)


def same(one, two, rows=slice(None)):
    for name in FIELDS:
        assert_array_equal(getattr(one, name)[rows], getattr(two, name)[rows], err_msg=name)


def words_of(key, kind, trajectory, step):
    """Four words from philox itself, which test_logs.py holds to the published vectors."""
    counter = (step // 4, kind, trajectory & 0xFFFFFFFF, trajectory >> 32)
    return [int(word) for word in rollout.philox(*(np.uint64(c) for c in counter), key & LOW, key >> np.uint64(32))]


LOW = np.uint64(0xFFFFFFFF)


def test_words_of_many_lanes_are_philox_words():
    key, n = np.uint64(0x0123456789ABCDEF), 5
    trajectory = np.array([0, 1, 7, 2**32 - 1, 2**40 + 3], dtype=np.uint64)
    t = np.array([0, 4, 8, 400, 2**33], dtype=np.uint64)
    words = np.zeros((4, 8), dtype=np.uint64)
    lanes.step_words(key, trajectory, t, words, n)
    for i in range(n):
        expected = words_of(key, 1, int(trajectory[i]), int(t[i]))
        assert words[:, i].tolist() == [word << 32 | word for word in expected]
        for k in range(4):
            assert int(lanes.word_of(key, np.uint64(1), trajectory[i], t[i] + np.uint64(k))) == expected[k]


def undecided(seed, trajectory, horizon, first, k):
    """A chain in which every other word of that trajectory ties with its threshold, and its path by whole numbers.

    2^k names of step t follow each other; each leads to all those of step t + 1 with the chance 2^-k, but that which the word x
    of the step points to has (x // 2^k + 1/2) / 2^32 where x is not to decide, and the last other one what is left: that is
    its alias. ``first``: so does the draw of the first state.
    """
    key, path, below, n = stream_key(seed), [], set(), 2**k
    chances = np.zeros((n * (horizon + 1), n * (horizon + 1)))
    initial = np.eye(len(chances))[0]
    for step in range(-1 if first else 0, horizon):
        kind = 2 if step < 0 else 1
        x, rest = (words_of(key, c, trajectory, max(step, 0))[max(step, 0) % 4] for c in (kind, kind + 2))
        row = np.zeros(len(chances))
        names = row[n * (step + 1) : n * (step + 2)]
        names[:] = 1 / n
        own, other = x % n, n - 1 - (x % n == n - 1)
        tie = step < 0 or (step + trajectory) % 2 == 0
        if tie:
            names[own] = (x // n + 0.5) / 2**32
            names[other] += 1 / n - names[own]
            below.add(rest < 2**31)
        if step < 0:
            initial = row
        else:
            chances[n * step : n * (step + 1)] = row
        path.append(n * (step + 1) + (own if rest < 2**31 or not tie else other))
    chances[-n:, -n:] = np.eye(n)
    return oee.FiniteMDP(sparse.csr_array(chances), np.arange(len(chances)) / 8, initial, 0.5), path, below


@pytest.mark.parametrize(("horizon", "k"), [(3, 1), (4, 1), (9, 1), (9, 4)])
@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize(("weighted", "record"), [(False, False), (False, True), (True, False), (True, True)])
def test_where_a_words_32_bits_do_not_decide_32_more_do(horizon, k, first, weighted, record):
    taken = set()
    for trajectory in (0, 1, 69):
        mdp, path, below = undecided(5, trajectory, horizon, first, k)
        policy = np.ones((mdp.n_states, 1))
        zeta = mdp.transitions.copy()
        zeta.data = np.where(np.arange(zeta.nnz) % 2 == 0, 1.5, 0.5)
        drawn = [
            oee.sample_returns(mdp, policy, 70, horizon, seed=5, n_lanes=n_lanes, record=record,
                               zeta=zeta if weighted else None)
            for n_lanes in (1, 8, 64)
        ]  # fmt: skip
        for other in drawn[1:]:
            same(drawn[0], other)
        weights = [
            sampler(mdp, policy, 70, horizon, seed=5, lanes=n, zeta=zeta if weighted else None).sums().largest
            for n in (1, 8, 64)
        ]
        assert_array_equal(weights, [weights[0]] * 3)
        states = path if first else [0, *path]
        assert drawn[0].final_state[trajectory] == states[-1]
        value, weight, whole, largest = 0.0, 1.0, 1.0, 0.0
        for t, state in enumerate(states[:-1]):
            largest = max(largest, weight)
            value += 0.5**t * weight * mdp.rewards[state, 0]
            whole = weight if t == horizon - 1 else weight * (zeta[[state], :][:, [states[t + 1]]].toarray().item())
            weight = whole if weighted else 1.0
        assert_allclose(drawn[0].values[trajectory], value, rtol=1e-14)
        assert_allclose(drawn[0].weights[trajectory], whole if weighted else 1.0, rtol=1e-14)
        assert_allclose(weights[0][trajectory], largest, rtol=1e-14)
        if record:
            rows = drawn[0].log.episode_starts[trajectory] + np.arange(horizon)
            assert drawn[0].log.next_state[rows].tolist() == states[1:]
        taken |= below
    assert taken == {False, True}


SCRIPT = """
import hashlib, oee_tabular as oee
mdp = oee.tasks.gridworld(7, 0.3)
zeta = oee.true_ratio(oee.tasks.gridworld(7, 0.2), mdp)
a = oee.sample_returns(mdp, oee.uniform_policy(mdp), 3001, 61, seed=11, zeta=zeta, record=True)
columns = [getattr(a, name) for name in ("values", "returns", "weights", "lengths", "final_state")]
print(hashlib.sha256(b"".join(x.tobytes() for x in (*columns, *a.log.columns().values()))).hexdigest())
"""


def test_the_same_bits_for_any_number_of_threads():
    assert printed_with_threads(SCRIPT, 1) == printed_with_threads(SCRIPT, 2) != ""


@pytest.mark.parametrize("options", [{}, {"zeta": ZETA}])
@pytest.mark.parametrize("n", [1, 63, 300])
def test_the_same_bits_for_any_number_of_lanes(options, n):
    drawn = [oee.sample_returns(GRID, UNIFORM, n, 31, seed=5, n_lanes=lanes, **options) for lanes in (1, 8, 64, 1000)]
    for other in drawn[1:]:
        same(drawn[0], other)


def test_an_episode_does_not_depend_on_how_many_there_are_nor_on_what_is_computed():
    few, many = (oee.sample_returns(GRID, UNIFORM, n, 25, seed=3) for n in (40, 500))
    same(few, many, slice(40))
    for options in ({"zeta": ZETA}, {"zeta": ZETA, "kind": "trajectory"}, {"record": True}):
        other = oee.sample_returns(GRID, UNIFORM, 500, 25, seed=3, **options)
        assert_array_equal(other.returns, many.returns)
        assert_array_equal(other.final_state, many.final_state)


def test_records_past_the_cache_give_the_same_bits(monkeypatch):
    options = {"seed": 3, "zeta": ZETA, "record": True}
    arrays = oee.sample_returns(GRID, UNIFORM, 200, 25, **options)
    monkeypatch.setattr(alias, "RECORDS_FROM", 0)
    records = oee.sample_returns(GRID, UNIFORM, 200, 25, **options)
    same(arrays, records)
    assert_array_equal(arrays.log.state, records.log.state)


@settings(max_examples=40)
@given(rngs)
def test_sums_along_the_recorded_paths(rng):
    """Every form of rewards, every kind, horizons within and beyond whole passes: recomputed step by step from the log."""
    mdp = random_mdp(rng)
    model = random_mdp(rng, like=mdp)
    policy, horizon = random_policy(rng, mdp), int(rng.integers(1, 14))
    zeta = oee.true_ratio(model, mdp)
    for kind in ("per_decision", "trajectory"):
        key = int(rng.integers(1 << 30))
        largest = sampler(mdp, policy, 17, horizon, seed=key, zeta=zeta, lanes=3).sums().largest
        drawn = oee.sample_returns(mdp, policy, 17, horizon, seed=key, zeta=zeta, kind=kind, n_lanes=3, record=True)
        log, over, by_move = drawn.log, mdp.absorbing(), mdp.transition_rewards is not None
        starts = log.episode_starts
        assert_array_equal(np.diff(starts), drawn.lengths)
        assert_array_equal(log.next_state[starts[1:] - 1], drawn.final_state)
        assert_array_equal(log.terminated[starts[1:] - 1], over[drawn.final_state])
        assert (mdp.initial[log.state[starts[:-1]]] > 0).all()
        assert (policy[log.state, log.action] > 0).all()
        ratio = zeta.values.toarray().reshape(mdp.n_states, mdp.n_actions, -1)
        for i in range(17):
            plain = weighted = 0.0
            w, whole, top = 1.0, 1.0, 0.0
            for t, row in enumerate(range(starts[i], starts[i + 1])):
                s, a, following = log.state[row], log.action[row], log.next_state[row]
                after = w * (1.0 if over[s] else ratio[s, a, following])
                plain += mdp.discount**t * log.reward[row]
                weighted += mdp.discount**t * (after if by_move else w) * log.reward[row]
                whole = w if not by_move and t == horizon - 1 else after
                top = max(top, after if by_move else w)
                w = after
            assert_allclose(drawn.returns[i], plain, rtol=1e-12, atol=1e-12)
            assert_allclose(drawn.weights[i], whole, rtol=1e-12)
            assert_allclose(largest[i], top, rtol=1e-12)
            expected = weighted if kind == "per_decision" else whole * plain
            assert_allclose(drawn.values[i], expected, rtol=1e-12, atol=1e-12)


def test_the_first_states_and_moves_follow_initial_policy_and_transitions():
    rng = np.random.default_rng(8)
    mdp = random_mdp(rng, n_states=5, n_actions=3, form=2)
    policy = random_policy(rng, mdp)
    log = oee.sample_returns(mdp, policy, 50_000, 1, seed=2, record=True).log
    expected = (mdp.initial[:, None] * policy).reshape(-1)[:, None] * mdp.transitions.toarray() * 50_000
    found = log.counts(5, 3).toarray()
    assert found[expected == 0].sum() == 0
    assert stats.chisquare(found[expected > 0], expected[expected > 0]).pvalue > 1e-4


@pytest.mark.parametrize("horizon", [1, 3, 4, 50])
def test_returns_have_the_exact_moments(horizon):
    n = 40_000
    drawn = oee.sample_returns(GRID, UNIFORM, n, horizon, seed=horizon)
    known = oee.return_moments(GRID, UNIFORM, horizon=horizon)
    assert abs(drawn.mean - known.mean) < 4.5 * known.standard_deviation / np.sqrt(n) + 1e-12
    assert_allclose(drawn.values.var(), known.variance, rtol=0.06, atol=1e-12)
    assert_array_equal(drawn.weights, np.ones(n))


@pytest.mark.parametrize("kind", ["per_decision", "trajectory"])
@pytest.mark.parametrize("pay", ["next", "current"])
def test_weighted_returns_have_the_exact_moments(kind, pay):
    simulator, target = (oee.tasks.gridworld(4, slip, pay=pay) for slip in (0.3, 0.27))  # weights within 1.05^5 or so
    zeta, n, horizon = oee.true_ratio(target, simulator), 40_000, 6
    drawn = oee.sample_returns(simulator, UNIFORM, n, horizon, seed=1, zeta=zeta, kind=kind)
    known = oee.weighted_return_moments(simulator, zeta, UNIFORM, kind=kind, horizon=horizon)
    assert abs(drawn.mean - known.mean) < 4.5 * known.standard_deviation / np.sqrt(n)
    assert_allclose(drawn.values.var(), known.variance, rtol=0.06)
    assert abs(drawn.weights.mean() - 1) < 4.5 * drawn.weights.std() / np.sqrt(n)
    assert_allclose(drawn.standard_error, known.standard_deviation / np.sqrt(n), rtol=0.03)


def test_episodes_end_where_they_are_over():
    drawn = oee.sample_returns(survival_chain(1.0), np.ones((2, 1)), 20_000, 7, seed=0)
    steps = np.arange(1, 8)
    share = np.where(steps < 7, 0.3 * 0.7 ** (steps - 1), 0.7**6)
    assert stats.chisquare(np.bincount(drawn.lengths)[1:], 20_000 * share).pvalue > 1e-4
    assert_array_equal(drawn.returns, drawn.lengths)  # 1 for each step that begins alive
    assert (drawn.final_state[drawn.lengths < 7] == 1).all()
    assert set(drawn.final_state[drawn.lengths == 7]) == {0, 1}


def test_an_episode_that_begins_where_it_is_over_has_one_step():
    over = oee.FiniteMDP(np.array([[[0.7, 0.3]], [[0.0, 1.0]]]), np.array([1.0, 0.0]), np.array([0.0, 1.0]), 0.9)
    for horizon in (1, 9):
        drawn = oee.sample_returns(over, np.ones((2, 1)), 5, horizon, seed=0, record=True)
        assert_array_equal(drawn.lengths, np.ones(5))
        assert_array_equal(drawn.returns, np.zeros(5))
        assert drawn.log.terminated.all()
        log = oee.sample_episodes(over, np.ones((2, 1)), 5, horizon, seed=0)
        assert_array_equal(log.next_state, drawn.log.next_state)


def test_many_first_states():
    """More than 2^11 outcomes, where thresholds have fewer than 53 bits of the 64, and a word's first 32 decide less often."""
    n = 5000
    chain = sparse.csr_array((np.ones(n), (np.arange(n), (np.arange(n) + 1) % n)), shape=(n, n))
    mdp = oee.FiniteMDP(chain, np.arange(n) + 1.0, np.full(n, 1 / n), 1.0)
    drawn = oee.sample_returns(mdp, np.ones((n, 1)), 200_000, 1, seed=0)
    counts = np.bincount(drawn.returns.astype(int) - 1, minlength=n)
    assert stats.chisquare(counts).pvalue > 1e-4
    assert_array_equal(drawn.final_state, drawn.returns.astype(int) % n)


def test_a_generator_is_advanced_and_a_refused_call_leaves_it():
    generator, other = np.random.default_rng(0), np.random.default_rng(0)
    first, second = (oee.sample_returns(GRID, UNIFORM, 20, 10, seed=generator) for _ in range(2))
    assert not np.array_equal(first.returns, second.returns)
    with pytest.raises(ValueError, match="horizon"):
        oee.sample_returns(GRID, UNIFORM, 20, 0, seed=other)
    same(first, oee.sample_returns(GRID, UNIFORM, 20, 10, seed=other))


def call(mdp=GRID, policy=UNIFORM, n_episodes=3, horizon=4, seed=0, **options):
    return oee.sample_returns(mdp, policy, n_episodes, horizon, seed=seed, **options)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (lambda: call(mdp=3), "mdp must be a FiniteMDP; got int"),
        (lambda: call(policy=UNIFORM[:3]), r"policy must have shape \(16, 4\) \(states, actions\); it has shape \(3, 4\)"),
        (lambda: call(policy=UNIFORM * 2), r"policy\[0\] must sum to 1 .*; it sums to 2"),
        (lambda: call(n_episodes=0), "n_episodes must be a positive integer; it is 0"),
        (lambda: call(horizon=None), "horizon must be a positive integer; got None"),
        (lambda: call(horizon=2.5), "horizon must be a positive integer; got 2.5"),
        (lambda: call(n_lanes=0), "n_lanes must be a positive integer; it is 0"),
        (lambda: call(seed="x"), "seed must be what numpy.random.default_rng takes; got 'x'"),
        (lambda: call(kind="whole"), "kind must be one of 'per_decision', 'trajectory'; got 'whole'"),
        (lambda: call(zeta=np.ones((64, 16))), r"zeta must be sparse of shape \(64, 16\), row s\*A \+ a; got \(64, 16\)"),
        (lambda: call(zeta=ZETA.values * 1j), "zeta must be real numbers; they are complex128"),
            (lambda: call(zeta=[1, [2, 3]]), r"zeta must be sparse of shape \(64, 16\), row s\*A \+ a; got list"),
        (lambda: call(zeta=-ZETA.values), "zeta must be finite and nonnegative; entry 0 is -"),
    ],
)  # fmt: skip
def test_bad_calls(bad, words):
    with pytest.raises(ValueError, match=words):
        bad()


def test_it_prints_what_it_holds():
    drawn = call(n_episodes=50, horizon=20)
    assert repr(drawn).startswith(f"SampledReturns(50 episodes, {drawn.lengths.sum()} transitions: mean ")
    assert repr(drawn).endswith(f"standard error {drawn.standard_error:.2g})")
    assert drawn.log is None
    for label in (">episodes<", ">transitions<", ">mean<", ">standard error<", ">largest weight<"):
        assert label in drawn._repr_html_()
    assert repr(call(zeta=ZETA, kind="trajectory")).endswith("weighted trajectory)")
    assert "discounted sum of rewards" in drawn._repr_html_()
    assert len(drawn) == 50
    assert np.isnan(call(n_episodes=1).standard_error)


def test_infinite_weights_leave_rewards_of_0_alone():
    """Also where an episode is over, whatever takes its turn beside it."""
    mdp = oee.FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), np.array([1.0, 0.0]), np.array([1.0, 0.0]), 1.0)
    zeta = mdp.transitions.copy()
    zeta.data = np.full(zeta.nnz, 1e200)
    drawn = [oee.sample_returns(mdp, np.ones((2, 1)), 300, 9, seed=0, zeta=zeta, n_lanes=n) for n in (1, 5, 64)]
    for other in drawn[1:]:
        same(drawn[0], other)
    assert np.array_equal(np.isinf(drawn[0].values), drawn[0].lengths > 2)
    assert not np.isnan(drawn[0].values).any()
