"""The factor by which unrecorded pairs may differ from the estimate: its two ends, what
lies between, and what is refused.
"""

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee

FACTORS = (1.0, 1.2, 3.0, 20.0, np.inf)


def fork(n_up, n_down, n_later=0, stay=0.5):
    """From 0 to 1 (which pays 1) or 2; from 2 to 1 or to the end 3. Only 0 is recorded,
    and 2 where ``n_later`` says so.
    """
    rows = np.array(
        [
            [[0, 0.5, 0.5, 0]],
            [[0, 0, 0, 1.0]],
            [[0, stay, 0, 1 - stay]],
            [[0, 0, 0, 1.0]],
        ]
    )
    simulator = oee.FiniteMDP(rows, np.array([0.0, 1.0, 0.0, 0.0]), 0, 0.9)
    moves = [(0, 1)] * n_up + [(0, 2)] * n_down + [(2, 1), (2, 3)] * n_later
    state, following = np.array(moves).T
    log = oee.Transitions(state, np.zeros(len(state), int), following)
    return oee.Problem(simulator, log), np.ones((4, 1))


@pytest.mark.parametrize("factor", [1.5, 3.0, 7.0])
@pytest.mark.parametrize(("n_up", "n_down"), [(12, 8), (3, 9), (30, 2)])
def test_an_interval_by_hand(factor, n_up, n_down):
    """V(0) = .9 p + .81 (1 - p) q, p and q as estimated; the factor bounds q and 1 - q:
    the standard error of p alone, and how far V moves with q. An episode is paid once,
    so no end is beyond 0 and 1.
    """
    problem, policy = fork(n_up, n_down)
    estimate = oee.estimators.OffEnvironment()(problem, policy)
    zeta = oee.transition_ratio(problem.log, problem.simulator, values_of=policy)
    p = 0.5 * zeta.values[[0], [1]].item()
    q = 0.5 * zeta.values[[2], [1]].item()
    low = max(q / factor, 1 - factor * (1 - q))
    high = min(factor * q, 1 - (1 - q) / factor)
    se = estimate.standard_error
    recorded = np.sqrt(se**2 - estimate.diagnostics["unrecorded_standard_error"] ** 2)
    z = stats.norm.ppf(0.975)
    found = oee.interval(problem, policy, unrecorded=factor)
    lower = estimate.value - max(z * se, z * recorded + 0.81 * (1 - p) * (q - low))
    upper = estimate.value + max(z * se, z * recorded + 0.81 * (1 - p) * (high - q))
    # not beyond what both ends of the factor allow
    lower = max(lower, min(found.sampling[0], found.worst_case[0]))
    upper = min(upper, max(found.sampling[1], found.worst_case[1]))
    quoted = np.clip([lower, upper], 0.0, 1.0)
    assert_allclose([found.lower, found.upper], quoted, rtol=1e-9)
    sampling = np.clip([estimate.value - z * se, estimate.value + z * se], 0.0, 1.0)
    assert_allclose(found.sampling, sampling, rtol=1e-9)
    assert found.diagnostics["unrecorded_factor"] == factor


@settings(max_examples=15)
@given(rngs)
def test_a_larger_factor_never_gives_a_shorter_interval(rng):
    simulator = random_mdp(rng)
    policy = random_policy(rng, simulator)
    target = random_mdp(rng, like=simulator)
    share = rng.random((simulator.n_states, simulator.n_actions))
    share[rng.random(share.shape) < 0.4] = 0.0
    share.flat[0] += 0.1
    log = oee.sample_transitions(target, share / share.sum(), 30, seed=rng)
    horizon = None if rng.random() < 0.5 else 5
    problem = oee.Problem(simulator, log, horizon=horizon)
    found = [oee.interval(problem, policy, unrecorded=k) for k in FACTORS]
    size = max(1.0, abs(found[-1].lower), abs(found[-1].upper))
    for narrow, wide in zip(found[:-2], found[1:-1], strict=True):
        assert wide.lower <= narrow.lower + 1e-6 * size
        assert narrow.upper <= wide.upper + 1e-6 * size
    assert (found[0].lower, found[0].upper) == found[0].sampling
    for one in found:
        assert one.sampling == found[0].sampling
        assert_allclose(one.worst_case, (found[-1].lower, found[-1].upper), rtol=1e-9)
    if found[0].diagnostics["unrecorded_pairs"]:
        value = oee.estimators.OffEnvironment()(problem, policy).value
        assert found[2].lower <= value <= found[2].upper
    plain = oee.interval(problem, policy)
    assert (plain.lower, plain.upper) == (found[2].lower, found[2].upper)


def test_where_all_is_recorded_the_factor_does_not_matter():
    problem, policy = fork(12, 8, 5)
    found = [oee.interval(problem, policy, unrecorded=k) for k in FACTORS]
    assert len({(one.lower, one.upper, one.worst_case) for one in found}) == 1
    assert found[0].worst_case == found[0].sampling == (found[0].lower, found[0].upper)


def test_a_box_bounds_unrecorded_pairs_itself_unless_a_factor_is_given():
    problem, policy = fork(12, 8)
    box = {"lower_ratio": 0.5, "upper_ratio": 1.5}
    plain = oee.interval(problem, policy, **box)
    assert plain == oee.interval(problem, policy, unrecorded=np.inf, **box)
    near = oee.interval(problem, policy, unrecorded=1.1, **box)
    assert plain.lower <= near.lower < near.upper <= plain.upper
    # an estimate that is outside of the box is moved into it
    tight = {"lower_ratio": 0.999, "upper_ratio": 1.001}
    narrow = oee.interval(problem, policy, unrecorded=2.0, **tight)
    widest = oee.interval(problem, policy, **tight)
    assert widest.lower <= narrow.lower <= narrow.upper <= widest.upper
    for method in ("delta", "robust"):
        other = oee.interval(problem, policy, method=method)
        assert other.worst_case is None


def test_the_simulator_s_support_stays():
    """What the simulator gives a probability of .999 may not become three times it."""
    problem, policy = fork(12, 8, stay=0.999)
    found = oee.interval(problem, policy, unrecorded=3.0)
    assert found.upper - found.sampling[1] < 0.002
    assert found.lower > oee.interval(problem, policy, unrecorded=1e6).lower + 0.1


def test_a_search_that_was_stopped_gives_inner_bounds():
    simulator = oee.tasks.gridworld(15, 0.3)
    target = oee.tasks.gridworld(15, 0.1)
    policy = oee.tasks.gridworld_policy(15, 0.5)
    log = oee.sample_episodes(target, policy, 20, 40, seed=0)
    problem = oee.Problem(simulator, log)
    whole = oee.interval(problem, policy)
    assert "stopped_after" not in whole.diagnostics
    assert oee.interval(problem, policy, seconds=1e6) == whole
    short = oee.interval(problem, policy, seconds=1e-9)
    # the search is for the worst case alone
    assert (short.lower, short.upper) == (whole.lower, whole.upper)
    assert short.diagnostics["stopped_after"] == 1e-9
    assert short.diagnostics["inner_bounds_of"] == "worst case"
    assert short.worst_case[0] >= whole.worst_case[0]
    assert short.worst_case[1] <= whole.worst_case[1]
    worst = oee.interval(problem, policy, seconds=1e-9, unrecorded=np.inf)
    assert (worst.lower, worst.upper) == short.worst_case
    assert "inner bounds" in str(worst)
    assert "inner bounds" not in str(whole) + str(short)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"unrecorded": 0.99}, r"unrecorded must be in \[1, inf\]; it is 0.99"),
        ({"unrecorded": -3}, r"unrecorded must be in \[1, inf\]; it is -3"),
        ({"unrecorded": np.nan}, "unrecorded must be in"),
        ({"unrecorded": "3x"}, "unrecorded must be a number; got '3x'"),
        ({"seconds": 0}, "seconds must be in"),
        ({"seconds": np.inf}, "seconds must be finite; it is inf"),
        ({"seconds": "1"}, "seconds must be a number; got '1'"),
    ],
)
def test_what_is_refused(given, message):
    problem, policy = fork(12, 8)
    with pytest.raises(ValueError, match=f"^{message}"):
        oee.interval(problem, policy, **given)


@settings(max_examples=25)
@given(rngs)
def test_an_interval_ends_where_no_value_is_possible(rng):
    """Whatever the factor, its ends and the value are between the sums of the least and
    of the largest rewards that the policy can take.
    """
    simulator = random_mdp(rng)
    policy = random_policy(rng, simulator)
    share = np.full((simulator.n_states, simulator.n_actions), 1.0)
    log = oee.sample_transitions(simulator, share / share.sum(), 3, seed=rng)
    horizon = None if rng.random() < 0.5 else 4
    problem = oee.Problem(simulator, log, horizon=horizon)
    value = oee.estimators.OffEnvironment()(problem, policy).value
    gamma = simulator.discount
    n_steps = 1 / (1 - gamma) if horizon is None else np.sum(gamma ** np.arange(4))
    rewards = simulator.rewards[policy > 0]
    if simulator.transition_rewards is not None:
        rewards = simulator.transition_rewards.toarray()[(policy > 0).ravel()]
        possible = simulator.transitions.toarray()[(policy > 0).ravel()] > 0
        rewards = rewards[possible]
    least, most = rewards.min() * n_steps, rewards.max() * n_steps
    slack = 1e-9 * (1 + abs(least) + abs(most))
    for factor in FACTORS:
        found = oee.interval(problem, policy, unrecorded=factor)
        for lower, upper in ((found.lower, found.upper), found.sampling):
            assert least - slack <= lower <= upper <= most + slack
        if factor < np.inf:
            assert found.lower - slack <= value <= found.upper + slack


def test_with_a_horizon_an_end_may_lie_inside_the_set():
    """From s1 the robot goes back to s0, which costs 5, with probability p. Over four
    steps J is least for p inside of [0.147, 1], which one such transition does not
    reject: neither end of p is the end of J.
    """
    P = np.array([[[0.0, 1.0]], [[1 / 3, 2 / 3]]])
    r = np.array([[[-5.0, -5.0]], [[2.0, 0.0]]])
    simulator = oee.FiniteMDP(P, r, [1.0, 0.0], 0.99)
    log = oee.Transitions([0, 0, 1], [0, 0, 0], [1, 1, 0])
    policy = np.ones((2, 1))
    found = oee.interval(oee.Problem(simulator, log, horizon=4), policy, unrecorded=1)
    least = np.exp(-1.920729410347062)  # half of chi-square's quantile
    values = []
    for p in np.linspace(least, 1.0, 4001):
        rows = np.array([[[0.0, 1.0]], [[p, 1.0 - p]]])
        model = oee.FiniteMDP(rows, r, [1.0, 0.0], 0.99)
        values.append(oee.policy_value(model, policy, horizon=4))
    assert found.worst_case[0] == pytest.approx(min(values), abs=1e-5)
    assert found.worst_case[1] == pytest.approx(max(values), abs=1e-5)
    assert min(values) < min(values[0], values[-1]) - 0.1


def test_ends_before_the_cut_are_kept():
    """One reward of 0 or 1, from two starts, of which one was never recorded: as if it
    had been recorded once, its normal end is above 1.
    """
    rows = np.array([[[0.2, 0, 0.8]], [[0, 0.2, 0.8]], [[0, 0, 1.0]]])
    arrives = np.zeros((3, 1, 3))
    arrives[:2, :, 2] = 1.0
    simulator = oee.FiniteMDP(rows, arrives, [0.5, 0.5, 0], 0.9)
    zeros = np.zeros(20, int)
    log = oee.Transitions(zeros, zeros, np.r_[np.full(18, 2), 0, 0])
    problem = oee.Problem(simulator, log, horizon=1)
    policy = np.ones((3, 1))
    value = oee.estimators.OffEnvironment()(problem, policy)
    found = oee.interval(problem, policy)
    facts = found.diagnostics
    assert (facts["lowest_possible"], facts["highest_possible"]) == (0.0, 1.0)
    assert found.upper == found.sampling[1] == 1.0
    end = value.value + stats.norm.ppf(0.975) * value.standard_error
    assert_allclose(facts["uncut_sampling_upper"], end, rtol=1e-12)
    assert facts["uncut_upper"] > 1.0
    assert value.value in found


@settings(max_examples=40)
@given(rngs, st.sampled_from([(None, 0.8), (4, 0.8), (4, 1.0)]))
def test_no_end_is_beyond_the_one_payment_of_an_episode(rng, steps):
    """States 0 to 3 lead anywhere; what pays (losses as well) leads to the end, 4. The
    value of another model on the same support is within what is called possible.
    """
    horizon, discount = steps
    p = rng.dirichlet(np.ones(5), size=(5, 2)) * 0.9
    p[:, :, 4] += 0.1
    p[4] = [0, 0, 0, 0, 1]
    pay = np.zeros((5, 2, 5))
    pay[:4, :, 4] = rng.uniform(-2, 1, size=(4, 2))
    pay[:4, :, 4] *= rng.random((4, 2)) < 0.7
    simulator = oee.FiniteMDP(p, pay, 0, discount)
    q = np.where(p > 0, rng.random(p.shape) ** 3, 0.0)
    other = simulator.with_transitions(q / q.sum(axis=2, keepdims=True))
    policy = random_policy(rng, simulator)
    log = oee.sample_transitions(other, np.full((5, 2), 0.1), 25, seed=rng)
    found = oee.interval(oee.Problem(simulator, log, horizon=horizon), policy)
    low, high = (found.diagnostics[f"{end}_possible"] for end in ("lowest", "highest"))
    taken = pay[policy > 0]
    assert low >= min(0.0, taken.min())
    assert high <= max(0.0, taken.max())
    assert low <= found.lower <= found.upper <= high
    value = oee.exact.policy_value(other, policy, horizon=horizon)
    assert low - 1e-12 <= value <= high + 1e-12
