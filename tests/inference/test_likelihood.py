"""The ends of the likelihood interval against SLSQP, one another and what defines an
end.
"""

import numpy as np
import pytest
from helpers import printed, random_policy, rngs
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from slsqp import LIMIT, best_of_slsqp, problem_of

import oee_tabular as oee
from oee_tabular.inference import profile_ascent
from oee_tabular.inference.evidence import gather
from oee_tabular.inference.profile_ascent import likelihood_ends


def divergence(evidence, rows):
    n = evidence.rows.spread(evidence.n) * evidence.phat
    held = (n > 0) & (evidence.phat > 0)
    return float(n[held] @ np.log(evidence.phat[held] / rows[held]))


@settings(max_examples=40)
# V is constant at the end: rounding must not be taken for a direction
@example(np.random.default_rng(444), None)
@given(rngs, st.sampled_from([None, None, 5]))
def test_an_end_is_a_member_and_its_value(rng, horizon):
    problem, policy = problem_of(rng, horizon)
    evidence = gather(problem, policy)
    frequencies = oee.policy_value(evidence.fitted, policy, horizon=horizon)
    for sign, end in zip((-1.0, 1.0), likelihood_ends(evidence, 0.95), strict=True):
        assert_allclose(evidence.rows.sums(end.rows), 1.0, rtol=1e-11)
        assert divergence(evidence, end.rows) <= LIMIT + 1e-9
        assert_allclose(divergence(evidence, end.rows), end.divergence, atol=1e-9)
        assert end.value == oee.policy_value(
            evidence.with_rows(end.rows), policy, horizon=horizon
        )
        assert sign * (end.value - frequencies) >= -1e-9 * max(1.0, abs(frequencies))


# scipy 1.15's SLSQP
@pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")
@pytest.mark.parametrize("seed", range(8))
def test_no_end_is_short_of_slsqp(seed):
    """Of 119 such problems with ten starts each 1 of 238 ends was, by 1.3% of the
    width; none of these.
    """
    rng = np.random.default_rng(seed)
    problem, policy = problem_of(
        rng, horizon=None if seed % 4 else 5, n=int(rng.choice([8, 20, 60]))
    )
    evidence = gather(problem, policy)
    ends = [end.value for end in likelihood_ends(evidence, 0.95)]
    slack = 1e-5 * (ends[1] - ends[0]) + 1e-9
    assert ends[0] <= best_of_slsqp(evidence, -1.0, 5, rng) + slack
    assert ends[1] >= best_of_slsqp(evidence, 1.0, 5, rng) - slack


def sparse_problem(seed):
    """A few next states, few transitions, many rows without any: where ends are many."""
    rng = np.random.default_rng(1000 + seed)
    n_states = int(rng.integers(4, 40))
    n_actions = int(rng.integers(1, 4))
    k = int(rng.integers(2, min(n_states, 6) + 1))
    rows = np.zeros((n_states, n_actions, n_states))
    for row in rows.reshape(-1, n_states):
        row[rng.choice(n_states, k, replace=False)] = rng.dirichlet(
            np.full(k, rng.choice([0.3, 1.0, 5.0]))
        )
    shape = n_states, n_actions
    rewards = (
        rng.normal(size=shape)
        if rng.random() < 0.7
        else (rng.random(shape) < 0.15) * 1.0
    )
    ends = seed % 5 == 4
    finite = seed % 5 in (2, 4)
    discount = 1.0 if ends else float(rng.choice([0.8, 0.95, 0.99]))
    horizon = int(rng.integers(3, 60)) if finite else None
    simulator = oee.FiniteMDP(rows, rewards, rng.dirichlet(np.ones(n_states)), discount)
    other = rows * np.exp(0.3 * rng.normal(size=rows.shape))
    target = simulator.with_transitions(other / other.sum(axis=2, keepdims=True))
    share = rng.dirichlet(np.full(rewards.size, 0.5)).reshape(shape)
    log = oee.sample_transitions(
        target, share, int(10 ** rng.uniform(1, 3.5)), seed=seed
    )
    return oee.Problem(simulator, log, horizon=horizon), rng.dirichlet(
        np.ones(n_actions), size=n_states
    )


@pytest.mark.parametrize("seed", [106, 152, 188, 219, 255])
def test_drawn_directions_find_farther_ends(seed, monkeypatch):
    """Of these problems the two that are not drawn miss an end by 1.5% of the width or
    more.
    """
    problem, policy = sparse_problem(seed)
    evidence = gather(problem, policy)
    low, high = (end.value for end in likelihood_ends(evidence, 0.95))
    monkeypatch.setattr(profile_ascent, "MAX_DRAWN_DIRECTIONS", 0)
    nearer_low, nearer_high = (end.value for end in likelihood_ends(evidence, 0.95))
    assert max(nearer_low - low, high - nearer_high) > 0.015 * (high - low)


@pytest.mark.parametrize("seed", [8, 50, 73])
def test_steps_that_overshoot_are_halved(seed):
    """Of these problems an end without that is short by 9 to 19% of the width, and no
    stationary point.
    """
    evidence = gather(*sparse_problem(seed))
    low, high = likelihood_ends(evidence, 0.95)
    assert max(low.promised, high.promised) <= 1e-5 * (high.value - low.value)
    assert max(low.change, high.change) <= 1e-6 * (high.value - low.value)


@pytest.mark.parametrize("horizon", [None, 40])
def test_large_problems_have_the_ends_of_small_ones(horizon, monkeypatch):
    """One ascent at a time, V and d corrected from those near by, scouts and one that
    is continued.
    """
    simulator = oee.tasks.gridworld(6, 0.2, discount=0.95)
    target = oee.tasks.gridworld(6, 0.1, discount=0.95)
    policy = oee.tasks.gridworld_policy(6, 0.5)
    log = oee.sample_transitions(target, np.full((36, 4), 1 / 144), 600, seed=1)
    evidence = gather(oee.Problem(simulator, log, horizon=horizon), policy)
    small = [end.value for end in likelihood_ends(evidence, 0.95)]
    monkeypatch.setattr(profile_ascent, "MAX_DENSE_STATES", 0)
    large = [end.value for end in likelihood_ends(evidence, 0.95)]
    assert_allclose(large, small, rtol=1e-13, atol=1e-8 * (small[1] - small[0]))


@pytest.mark.parametrize("unit", [1e-250, 1e160, 1e300])
def test_ends_are_in_the_rewards_unit(unit):
    problem, policy = problem_of(np.random.default_rng(0), n=100)
    simulator = problem.simulator
    rewards = (
        simulator.rewards
        if simulator.transition_rewards is None
        else simulator.transition_rewards
    )
    scaled = oee.Problem(simulator.with_rewards(unit * rewards), problem.log)
    one = oee.interval(problem, policy)
    other = oee.interval(scaled, policy)
    assert_allclose(
        np.array([other.lower, other.upper]) / unit, [one.lower, one.upper], rtol=1e-6
    )


def test_an_end_where_no_recorded_row_changes_the_value():
    """At the worst, unrecorded rows keep the walk from its goal: V of recorded ones is
    constant but for rounding.
    """
    places = np.arange(21)
    for seed in range(15):
        rng = np.random.default_rng(seed)
        P = np.zeros((21, 2, 21))
        rewards = np.full((21, 2, 21), -0.004)
        P[20, :, 20] = 1.0
        rewards[:, :, 20] = 0.996
        rewards[20] = 0.0
        for s, a in np.ndindex(20, 2):
            np.add.at(
                P[s, a],
                np.clip(s + np.arange(-1, 2), 0, 20),
                rng.dirichlet(np.full(3, 6.0)),
            )
        simulator = oee.FiniteMDP(P, rewards, 10, 0.99)
        log = oee.sample_episodes(simulator, np.zeros(21, int), 30, 20, seed=seed)
        found = oee.interval(
            oee.Problem(simulator, log),
            np.where(places < 10, 1, 0),
            unrecorded=np.inf,
        )
        assert -0.4 - 1e-9 <= found.lower < found.upper <= 1.0


def test_the_ends_are_the_same_where_kernels_are_not_compiled():
    """The machine code and Python run the same loop."""
    script = (
        "import oee_tabular as oee; w = oee.tasks.gridworld(2, slip=0.2)\np ="
        " oee.uniform_policy(w); log = oee.sample_transitions(w, p / 4, 30,"
        " seed=0)\nends = oee.interval(oee.Problem(w, log), p); print(repr(ends.lower),"
        " repr(ends.upper))"
    )
    ends = [printed(script, NUMBA_DISABLE_JIT=off).split() for off in "01"]
    assert_allclose(*(np.array(words, dtype=float) for words in ends), rtol=1e-9)


# ---- gains: the ends of J(pi) - J(pi_0)


def gain_ends(problem, policy, running):
    evidence = gather(problem, policy)
    return [end.value for end in likelihood_ends(evidence, 0.95, minus=running)]


@settings(max_examples=30)
@given(rngs, st.sampled_from([None, None, 5]))
def test_the_ends_of_a_gain_and_of_its_negative(rng, horizon):
    """What one policy gains over another, the other loses; both values are of one
    model, so that the ends are within those of two separate intervals.
    """
    problem, policy = problem_of(rng, horizon)
    running = random_policy(rng, problem.simulator)
    low, high = gain_ends(problem, policy, running)
    loss, win = gain_ends(problem, running, policy)
    width = high - low
    assert_allclose([low, high], [-win, -loss], atol=1e-4 * width + 1e-9)
    ends = [
        [end.value for end in likelihood_ends(gather(problem, pi), 0.95)]
        for pi in (policy, running)
    ]
    room = 1e-6 * (abs(width) + 1.0)
    assert low >= ends[0][0] - ends[1][1] - room
    assert high <= ends[0][1] - ends[1][0] + room
    fitted = gather(problem, policy).fitted
    middle = oee.policy_value(fitted, policy, horizon=horizon) - oee.policy_value(
        fitted, running, horizon=horizon
    )
    assert low - room <= middle <= high + room


def test_a_policy_gains_nothing_over_itself():
    problem, policy = problem_of(np.random.default_rng(5))
    assert gain_ends(problem, policy, policy) == [0.0, 0.0]


@pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")
@pytest.mark.parametrize("seed", range(6))
def test_no_end_of_a_gain_is_short_of_slsqp(seed):
    rng = np.random.default_rng(100 + seed)
    problem, policy = problem_of(rng, horizon=None if seed % 3 else 5, n=500)
    running = random_policy(rng, problem.simulator)
    evidence = gather(problem, policy)
    low, high = (end.value for end in likelihood_ends(evidence, 0.95, minus=running))
    room = 1e-4 * (high - low)
    assert best_of_slsqp(evidence, -1.0, 4, rng, running) >= low - room
    assert best_of_slsqp(evidence, 1.0, 4, rng, running) <= high + room


@pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")
@pytest.mark.parametrize("seed", [*range(4), 31, 37])
def test_no_end_is_short_of_slsqp_where_pairs_are_not_recorded(seed):
    rng = np.random.default_rng(100 + seed)
    problem, policy = problem_of(rng, n=int(rng.choice([8, 20, 60])))
    running = random_policy(rng, problem.simulator)
    evidence = gather(problem, policy)
    low, high = (end.value for end in likelihood_ends(evidence, 0.95, minus=running))
    room = 1e-3 * (high - low)
    assert best_of_slsqp(evidence, -1.0, 4, rng, running) >= low - room
    assert best_of_slsqp(evidence, 1.0, 4, rng, running) <= high + room


def test_a_gain_of_a_large_problem_is_that_of_a_small_one(monkeypatch):
    """Solved by sweeps and by LAPACK alike."""
    problem, policy = problem_of(np.random.default_rng(9), n=60)
    running = random_policy(np.random.default_rng(10), problem.simulator)
    small = gain_ends(problem, policy, running)
    monkeypatch.setattr(profile_ascent, "MAX_DENSE_STATES", 1)
    assert_allclose(gain_ends(problem, policy, running), small, rtol=1e-5)
