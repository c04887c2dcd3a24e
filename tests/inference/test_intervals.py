"""Intervals: row problems against linear and conic programs, laws 33 to 44 of the
theory notes, what is refused.
"""

import itertools

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import stats

import oee_tabular as oee
from oee_tabular.inference import evidence as evidences
from oee_tabular.inference import robust
from oee_tabular.inference.asymptotic import bootstrap_values


@pytest.mark.parametrize(("n", "k"), [(3, 2), (10, 2), (5, 3), (8, 3)])
def test_43_the_radii_hold_by_enumeration(n, k):
    """Pr(KL(phat || P) > epsilon) <= level, summed over all outcomes, for several P."""
    for level in (0.3, 0.05, 0.001):
        one = np.array([float(n)])
        count = np.array([k])
        epsilon = robust.independent_radius(one, count, level)[0]
        anytime = robust.anytime_radius(one, count, level)[0]
        # Jonsson et al. 2020: n r
        published = np.log(1 / level) + (k - 1) * np.log(np.e * (1 + n / (k - 1)))
        assert_allclose(n * anytime, published, rtol=1e-13)
        c = n * epsilon
        assert_allclose(np.exp(-c) * (np.e * c / (k - 1)) ** (k - 1), level, rtol=1e-8)
        for p in (
            np.full(k, 1 / k),
            np.append(np.full(k - 1, 0.05), 1 - 0.05 * (k - 1)),
        ):
            outside = outside_anytime = 0.0
            for counts in itertools.product(range(n + 1), repeat=k):
                if sum(counts) != n:
                    continue
                phat = np.array(counts) / n
                chance = stats.multinomial.pmf(counts, n, p)
                kl = sum(
                    a * np.log(a / b) for a, b in zip(phat, p, strict=True) if a > 0
                )
                outside += chance * (kl > epsilon)
                outside_anytime += chance * (kl > anytime)
            assert outside <= level
            assert outside_anytime <= level
    assert robust.independent_radius(np.array([0.0]), np.array([2]), 0.1)[0] == np.inf


def test_43_the_rows_share_the_probability_of_failure():
    """The sum of the rows' tail bounds is 1 - confidence, over the rows that are open
    and reached.
    """
    simulator = oee.tasks.gridworld(4, 0.3, discount=0.9)
    log = oee.sample_transitions(simulator, np.full((16, 4), 1 / 64), 5000, seed=0)
    evidence = evidences.gather(
        oee.Problem(simulator, log), oee.uniform_policy(simulator)
    )
    size = robust.radii(evidence, 0.9, "independent")
    k = np.diff(evidence.rows.indptr)
    c = (evidence.n * size)[k > 1]
    bounds = np.exp(-c) * (np.e * c / (k[k > 1] - 1)) ** (k[k > 1] - 1)
    assert_allclose(bounds.sum(), 0.1, rtol=1e-9)
    still = evidences.gather(oee.Problem(simulator, log), oee.tasks.gridworld_expert(4))
    # fewer rows are reached
    assert robust.radii(still, 0.9, "independent")[0] < size[0]


def case(rng, n_states=3, n=60, **options):
    simulator = random_mdp(rng, n_states=n_states, n_actions=2, discount=0.8, **options)
    target = random_mdp(rng, like=simulator)
    share = rng.dirichlet(np.ones(2 * n_states)).reshape(n_states, 2)
    log = oee.sample_transitions(target, share, n, seed=int(rng.integers(1 << 30)))
    return simulator, target, oee.Problem(simulator, log), random_policy(rng, simulator)


@settings(max_examples=25)
@given(rngs, st.sampled_from([None, 3]))
def test_34_35_44_nested_mirrored_and_every_member_inside(rng, horizon):
    simulator, _, problem, policy = case(rng)
    problem = oee.Problem(simulator, problem.log, horizon=horizon)
    wide, narrow = (
        oee.interval(problem, policy, method="robust", confidence=c)
        for c in (0.99, 0.6)
    )
    slack = 1e-8 * max(1.0, abs(wide.upper), abs(wide.lower))
    assert wide.lower <= narrow.lower + slack
    assert narrow.upper <= wide.upper + slack
    evidence = evidences.gather(problem, policy)
    size = robust.radii(evidence, 0.6, "independent")
    # members: a step from the counts towards a random row, as far as the ball allows
    for _ in range(5):
        p = evidence.phat.copy()
        for k in range(len(evidence.n)):
            row = slice(*evidence.rows.indptr[k : k + 2])
            aim = rng.dirichlet(np.ones(row.stop - row.start))
            low = 0.0
            high = 1.0 - 1e-9
            for _ in range(40):
                middle = 0.5 * (low + high)
                trial = (1 - middle) * evidence.phat[row] + middle * aim
                a = evidence.phat[row]
                kl = sum(
                    x * np.log(x / y) for x, y in zip(a, trial, strict=True) if x > 0
                )
                low, high = (middle, high) if kl <= size[k] else (low, middle)
            p[row] = (1 - low) * evidence.phat[row] + low * aim
        value = oee.policy_value(evidence.with_rows(p), policy, horizon=horizon)
        assert narrow.lower - slack <= value <= narrow.upper + slack
    if simulator.transition_rewards is not None:
        negative = -simulator.transition_rewards
    else:
        negative = -simulator.rewards
    mirrored = oee.Problem(
        simulator.with_rewards(negative), problem.log, horizon=horizon
    )
    for method in ("robust", "likelihood", "delta"):
        plain, other = (
            oee.interval(x, policy, method=method) for x in (problem, mirrored)
        )
        assert_allclose(
            (other.lower, other.upper),
            (-plain.upper, -plain.lower),
            rtol=1e-6,
            atol=1e-6,
        )
    if horizon is None:
        end = robust.extreme_value(evidence, size, 1.0)
        assert end.residual <= 1e-8 * max(1.0, abs(end.value))
        assert_allclose(end.bound, end.value, atol=1e-6 * max(1.0, abs(end.value)))


@settings(max_examples=25)
@given(rngs)
def test_33_four_times_the_same_transitions_give_an_interval_inside(rng):
    _, _, problem, policy = case(rng)
    log = problem.log
    more = oee.Problem(
        problem.simulator,
        oee.Transitions(
            *(np.tile(x, 4) for x in (log.state, log.action, log.next_state))
        ),
    )
    for method in ("robust", "likelihood", "delta"):
        # the estimate of unrecorded pairs changes with the log; its support does not
        given = {"unrecorded": np.inf} if method == "likelihood" else {}
        few, many = (
            oee.interval(each, policy, method=method, **given)
            for each in (problem, more)
        )
        if method == "delta" and np.isnan(few.lower):  # nothing in the log varies
            assert np.isnan(many.lower)
            continue
        slack = 1e-7 * max(1.0, abs(few.lower), abs(few.upper))
        assert few.lower - slack <= many.lower
        assert many.upper <= few.upper + slack


def test_39_two_states_by_brute_force():
    """One uncertain row with two outcomes: J on a fine grid of its probability."""
    simulator = oee.FiniteMDP(
        np.array([[[0.6, 0.4]], [[0.0, 1.0]]]), np.array([1.0, 0.0]), [1, 0], 0.9
    )
    log = oee.Transitions([0] * 20, [0] * 20, [0] * 13 + [1] * 7)
    problem = oee.Problem(simulator, log)
    ones = np.ones((2, 1))
    grid = np.linspace(1e-6, 1 - 1e-6, 400_001)
    kl = 0.65 * np.log(0.65 / grid) + 0.35 * np.log(0.35 / (1 - grid))
    values = 1 / (1 - 0.9 * grid)
    for method, limit in (
        ("robust", robust.independent_radius(np.array([20.0]), np.array([2]), 0.05)[0]),
        ("likelihood", stats.chi2.ppf(0.95, 1) / 2 / 20),
    ):
        found = oee.interval(problem, ones, method=method)
        inside = values[kl <= limit]
        assert_allclose(
            (found.lower, found.upper), (inside.min(), inside.max()), rtol=2e-5
        )
    both = oee.interval(
        problem, ones, method="robust", lower_ratio=0.9, upper_ratio=1.1
    )
    inside = values[
        (kl <= robust.independent_radius(np.array([20.0]), np.array([2]), 0.05)[0])
        & (grid >= 0.56)
        & (grid <= 0.64)
    ]
    assert_allclose((both.lower, both.upper), (inside.min(), inside.max()), rtol=2e-5)


@given(rngs)
def test_36_boxes(rng):
    """nu = mu = 1 gives the simulator's value alone; a wider box a wider interval; the
    true box contains the truth.
    """
    simulator, target, problem, policy = case(rng, n=5)
    truth = oee.policy_value(target, policy)
    point = oee.interval(
        problem, policy, method="robust", lower_ratio=1.0, upper_ratio=1.0
    )
    value = oee.policy_value(simulator, policy)
    if point.status == "ok":
        assert_allclose(
            (point.lower, point.upper), (value, value), rtol=1e-9, atol=1e-9
        )
    zeta = oee.true_ratio(target, simulator).values.data
    wide = {
        "lower_ratio": float(min(zeta.min(), 1.0)),
        "upper_ratio": float(max(zeta.max(), 1.0)),
    }
    free = oee.interval(problem, policy, method="robust", confidence=0.999)
    boxed = oee.interval(problem, policy, method="robust", confidence=0.999, **wide)
    slack = 1e-8 * max(1.0, abs(free.upper), abs(free.lower))
    if boxed.status == "ok":
        assert free.lower - slack <= boxed.lower
        assert boxed.upper <= free.upper + slack
        evidence = evidences.gather(problem, policy, **wide)
        size = np.full(len(evidence.n), np.inf)  # no data at all: the box alone
        ends = [
            robust.extreme_value(evidence, size, sign).bound for sign in (-1.0, 1.0)
        ]
        assert ends[0] - slack <= truth <= ends[1] + slack


@pytest.mark.parametrize(
    ("horizon", "discount", "by_move", "bearing"),
    [
        (1, 1.0, False, 0),
        (1, 1.0, True, 1),
        (2, 1.0, False, 1),
        (3, 1.0, True, 3),
        (9, 1.0, False, 4),
        (None, 0.0, True, 1),
        (None, 0.0, False, 0),
        (None, 0.5, False, 4),
    ],
)
def test_rows_never_recorded_are_counted_where_they_bear_on_the_value(
    horizon, discount, by_move, bearing
):
    """A chain of four states that stay or go on, and an end; the log has the end alone.
    The first T rows pay by move.
    """
    rows = np.zeros((5, 1, 5))
    for s in range(4):
        rows[s, 0, [s, s + 1]] = 0.5
    rows[4, 0, 4] = 1.0
    pays = np.array([1.0, 1, 1, 1, 0])
    rewards = (
        np.where(rows > 0, pays, 0.0) * np.arange(5)[:, None, None] if by_move else pays
    )
    problem = oee.Problem(
        oee.FiniteMDP(rows, rewards, 0, discount),
        oee.Transitions([4], [0], [4]),
        horizon=horizon,
    )
    assert (
        oee.interval(problem, np.ones((5, 1))).diagnostics["unrecorded_pairs"]
        == bearing
    )


def test_38_unrecorded_rows_are_not_trusted():
    """The log has no move of the only row that matters: the interval holds all that the
    box allows, delta none.
    """
    rows = np.array([[[0.5, 0.5], [0.5, 0.5]], [[0.0, 1.0], [0.0, 1.0]]])
    simulator = oee.FiniteMDP(rows, np.array([1.0, 0.0]), [1, 0], 0.9)
    log = oee.Transitions([0, 0, 0], [1, 1, 1], [0, 1, 0])
    problem = oee.Problem(simulator, log)
    first = np.array([[1.0, 0.0], [1.0, 0.0]])
    identified = (1 / (1 - 0.9 * 0.25), 1 / (1 - 0.9 * 0.75))
    for method in ("likelihood", "robust"):
        found = oee.interval(
            problem, first, method=method, lower_ratio=0.5, upper_ratio=1.5
        )
        assert_allclose((found.lower, found.upper), identified, rtol=1e-9)
        assert found.diagnostics["unrecorded_pairs"] == 1
        # time in the first state
        assert_allclose(found.diagnostics["unrecorded_share"], 0.1 / 0.55)
        everything = oee.interval(problem, first, method=method, unrecorded=np.inf)
        assert_allclose((everything.lower, everything.upper), (1.0, 10.0), rtol=1e-9)
    delta = oee.interval(problem, first, method="delta")
    assert np.isnan(delta.width)
    assert "the log's transitions that affect the value never vary" in delta.status


@pytest.mark.parametrize("horizon", [None, 4])
def test_rows_that_only_an_unrecorded_transition_reaches_are_set_to_their_extreme(
    horizon,
):
    """20 moves from 0, all to 1; mass q = 1 - exp(-c / 20) may go to 2, whose unseen
    row leads to +10 or to -10.
    """
    rows = np.zeros((6, 1, 6))
    for s, to in ((0, (1, 2)), (1, (5,)), (2, (3, 4)), (3, (5,)), (4, (5,)), (5, (5,))):
        rows[s, 0, list(to)] = 1 / len(to)
    simulator = oee.FiniteMDP(
        rows, np.array([0.0, 0, 0, -10, 10, 0]), np.eye(6)[0], 0.9
    )
    log = oee.Transitions([0] * 20, [0] * 20, [1] * 20)
    problem = oee.Problem(simulator, log, horizon=horizon)
    found = oee.interval(problem, np.ones((6, 1)), unrecorded=np.inf)
    q = 1 - np.exp(-stats.chi2.ppf(0.95, 1) / 2 / 20)
    assert_allclose(
        (found.lower, found.upper), (-0.81 * 10 * q, 0.81 * 10 * q), rtol=1e-6
    )


def test_with_much_data_the_methods_agree():
    simulator = oee.tasks.gridworld(3, 0.3, discount=0.9)
    target = oee.tasks.gridworld(3, 0.1, discount=0.9)
    policy = oee.tasks.gridworld_policy(3, 0.5)
    log = oee.sample_transitions(target, np.full((9, 4), 1 / 36), 200_000, seed=0)
    problem = oee.Problem(simulator, log)
    delta = oee.interval(problem, policy, method="delta")
    for options in ({}, {"method": "bootstrap", "seed": 0}):
        other = oee.interval(problem, policy, **options)
        assert_allclose(other.width, delta.width, rtol=0.15)
        assert oee.policy_value(target, policy) in other
    again = oee.interval(problem, policy, method="bootstrap", seed=0)
    assert again == oee.interval(problem, policy, method="bootstrap", seed=0)
    guaranteed = oee.interval(problem, policy, method="robust")
    assert guaranteed.lower < delta.lower < delta.upper < guaranteed.upper


def test_bootstrap_by_episodes():
    """A resample is the model of the drawn episodes, each as often as it was drawn; its
    law is that of episodes.
    """
    simulator = oee.tasks.gridworld(3, 0.3, discount=0.9)
    target = oee.tasks.gridworld(3, 0.1, discount=0.9)
    policy = oee.uniform_policy(simulator)
    log = oee.sample_episodes(target, policy, 200, 10, seed=0)
    problem = oee.Problem(simulator, log)
    values = bootstrap_values(
        problem,
        evidences.gather(problem, policy),
        n_bootstrap=25,
        by="episodes",
        seed=3,
    )
    starts = log.episode_starts
    generator = np.random.default_rng(3)
    expected = []
    for _ in range(25):
        drawn = generator.integers(0, 200, 200)
        rows = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in drawn])
        again = oee.Problem(
            simulator,
            oee.Transitions(log.state[rows], log.action[rows], log.next_state[rows]),
        )
        expected.append(
            oee.estimators.ModelBased(fallback="simulator")(again, policy).value
        )
    assert_allclose(values, expected, rtol=1e-9)
    found = oee.interval(
        problem, policy, method="bootstrap", resample="episodes", seed=3
    )
    values = bootstrap_values(
        problem,
        evidences.gather(problem, policy),
        n_bootstrap=500,
        by="episodes",
        seed=3,
    )
    assert values.min() < found.lower < values.mean() < found.upper < values.max()


def test_a_box_that_the_counts_contradict_is_refused_by_name():
    simulator = oee.FiniteMDP(
        np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), np.array([1.0, 0.0]), [1, 0], 0.9
    )
    log = oee.Transitions([0] * 400, [0] * 400, [0] * 396 + [1] * 4)
    for method in ("likelihood", "robust", "delta"):
        found = oee.interval(
            oee.Problem(simulator, log),
            np.ones((2, 1)),
            method=method,
            lower_ratio=0.5,
            upper_ratio=1.5,
        )
        assert np.isnan(found.lower)
        assert (
            "the counts contradict the box [0.5, 1.5] in 1 state-action pair, with"
            " confidence 0.95: (s=0, a=0, n=400)" in found.status
        )
    assert (
        oee.interval(
            oee.Problem(simulator, log),
            np.ones((2, 1)),
            lower_ratio=0.01,
            upper_ratio=2.0,
        ).status
        == "ok"
    )


def test_two_steps_that_never_succeeded_are_both_raised():
    """J = discount p q is flat at p = q = 0: the gradient sees nothing, the interval
    must. n (-log(1 - p)) = c / 2 each.
    """
    kernel = np.zeros((4, 1, 4))
    kernel[0, 0, [1, 3]] = kernel[1, 0, [2, 3]] = 0.5
    kernel[2, 0, 2] = kernel[3, 0, 3] = 1.0
    reward = np.zeros((4, 1, 4))
    reward[1, 0, 2] = 1.0
    simulator = oee.FiniteMDP(kernel, reward, [1.0, 0, 0, 0], 0.9)
    log = oee.Transitions([0] * 20 + [1] * 20, [0] * 40, [3] * 40)
    for horizon in (None, 5):
        found = oee.interval(
            oee.Problem(simulator, log, horizon=horizon), np.ones((4, 1))
        )
        p = 1 - np.exp(-stats.chi2.ppf(0.95, 1) / 2 / 2 / 20)
        assert_allclose(
            (found.lower, found.upper), (0.0, 0.9 * p * p), rtol=1e-6, atol=1e-15
        )


@pytest.mark.parametrize("resample", ["transitions", "episodes"])
def test_a_pair_that_a_resample_misses_is_as_simulated(resample):
    """One transition of a pair, of ten: (9/10)^10 = 35% of the resamples miss it.

    Its value is then the simulator's 1/2, and the log's 1 otherwise.
    """
    # 0: the pair in question; 1: nothing to learn; 2: the reward; 3: none; 4: the end
    rows = np.zeros((5, 1, 5))
    rows[0, 0, [2, 3]] = 0.5
    rows[1:, 0, 4] = 1.0
    model = oee.FiniteMDP(
        rows, [0.0, 0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0, 0.0], 1.0
    )
    log = oee.Transitions(
        [0] + [1] * 9,
        [0] * 10,
        [2] + [4] * 9,
        episode=np.arange(10),
        terminated=[0] * 10,
    )
    found = oee.interval(
        oee.Problem(model, log, horizon=2),
        np.ones((5, 1)),
        method="bootstrap",
        resample=resample,
        n_bootstrap=200,
        seed=0,
    )
    assert (found.lower, found.upper) == (0.5, 1.0)
    # the deviation of 1/2 or 1, with a chance of 0.35
    assert found.diagnostics["standard_error"] == pytest.approx(0.24, abs=0.02)


@pytest.mark.parametrize("exponent", [-1000, -700, -560, 300])
def test_the_robust_interval_has_the_unit_of_the_rewards(exponent):
    pair = oee.testing.case("ragged")
    problem = pair.problem(100, seed=0)
    unit = 2.0**exponent
    model = problem.simulator
    parts = model.initial, model.discount
    plain_model = oee.FiniteMDP(model.transitions, model.rewards, *parts)
    scaled = oee.FiniteMDP(model.transitions, model.rewards * unit, *parts)
    plain = oee.interval(
        oee.Problem(plain_model, problem.log), pair.policy, method="robust"
    )
    found = oee.interval(oee.Problem(scaled, problem.log), pair.policy, method="robust")
    ends = found.lower / unit, found.upper / unit
    assert_allclose(ends, (plain.lower, plain.upper), rtol=1e-9)


@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-310, 3.0, 1e308])
def test_a_power_of_two_is_at_or_below_the_largest_value(size):
    unit = robust.power_of_two(np.array([-size, size / 2]))
    assert np.frexp(unit)[0] == 0.5
    assert size / unit < 2.0
