"""The paper's theorems and the bounds that replace them, on random and on worked MDPs."""

import math

import numpy as np
import pytest
from helpers import (
    Dense,
    dense_values,
    paths,
    random_mdp,
    random_policy,
    rngs,
    survival_chain,
    tiny,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import sparse, stats

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact, theory
from oee_tabular.theory import Sides, renyi_divergence

ONE = np.ones((1, 1))
horizons = st.sampled_from([None, 1, 2, 7])


def pair(rng, **options):
    """A target, and a model near it or far, on the support of one simulator."""
    simulator = random_mdp(rng, **options)
    target = random_mdp(rng, like=simulator)
    other = random_mdp(rng, like=simulator)
    weight = rng.choice([0.0, 1e-6, 0.1, 1.0])
    model = target.with_transitions(
        sparse.csr_array((1 - weight) * target.transitions + weight * other.transitions)
    )
    return target, model


def some_policy(rng, mdp, horizon):
    if horizon is None or rng.random() < 0.5:
        return random_policy(rng, mdp)
    return np.stack([random_policy(rng, mdp) for _ in range(horizon)])


def unnormalised(rng, mdp, spread):
    ratio = mdp.transitions.copy()
    ratio.data = rng.uniform(1 - spread, 1 + spread, ratio.nnz)
    return ratio


def scale(mdp, horizon=None):
    steps = math.inf if horizon is None else horizon
    return 1e-9 * max(
        1.0, np.abs(mdp.rewards).max() * min(steps, 1 / (1 - mdp.discount))
    )


def distributions(rng, zeros=0.3):
    n = int(rng.integers(2, 8))
    p, q = (
        rng.integers(1, 10, n) * (rng.random(n) >= zeros) + (np.arange(n) == 0)
        for _ in range(2)
    )
    return p / p.sum(), q / q.sum()


# the simulation lemma


@given(rngs, horizons)
def test_the_simulation_lemma_for_models(rng, horizon):
    """Statement 27, with any form of rewards."""
    target, model = pair(rng)
    policy = some_policy(rng, target, horizon)
    lemma = theory.simulation_lemma(target, model, policy, horizon=horizon)
    if horizon is None:
        dense = target.initial @ (
            dense_values(target, policy) - dense_values(model, policy)
        )
        assert_allclose(lemma.difference, dense, rtol=0, atol=scale(target))
    assert_allclose(
        lemma.by_target_occupancy, lemma.difference, rtol=0, atol=scale(target, horizon)
    )
    assert_allclose(
        lemma.by_model_occupancy, lemma.difference, rtol=0, atol=scale(target, horizon)
    )


@given(rngs, horizons)
def test_the_simulation_lemma_for_kernels_of_any_row_sum(rng, horizon):
    simulator = random_mdp(rng, discount=float(rng.choice([0.0, 0.5, 0.8])))
    target = random_mdp(rng, like=simulator)
    ratio = unnormalised(rng, simulator, 0.2)
    policy = some_policy(rng, target, horizon)
    lemma = theory.simulation_lemma(
        target, simulator, policy, horizon=horizon, ratio=ratio
    )
    same = theory.simulation_lemma(
        target, exact.reweight(simulator, ratio), policy, horizon=horizon
    )
    assert lemma == same
    size = 1e-9 * 5 * 1.2 / (1 - 0.96) * 25
    assert_allclose(lemma.by_target_occupancy, lemma.difference, rtol=0, atol=size)
    assert_allclose(lemma.by_model_occupancy, lemma.difference, rtol=0, atol=size)


# (A), (B), (C)


@given(rngs, horizons)
def test_a_b_and_c_hold_for_models(rng, horizon):
    """Statement 40, and (B) <= (A): min(2, t eta) <= (1 + eta)^t - 1."""
    target, model = pair(rng)
    policy = some_policy(rng, target, horizon)
    a, b, c = (
        sides(target, model, policy, horizon=horizon)
        for sides in (
            theory.unnormalised_sides,
            theory.normalised_sides,
            theory.kl_path_sides,
        )
    )
    truth = abs(
        oee.policy_value(target, policy, horizon=horizon)
        - oee.policy_value(model, policy, horizon=horizon)
    )
    assert a.left == b.left == c.left == truth
    assert truth <= min(b.right, c.right) + scale(target, horizon)
    assert b.right <= a.right * (1 + 1e-9)


@given(rngs, horizons)
def test_a_holds_for_kernels_of_any_row_sum(rng, horizon):
    simulator = random_mdp(rng, discount=float(rng.choice([0.0, 0.5, 0.9])))
    target = random_mdp(rng, like=simulator)
    zeta = oee.true_ratio(target, simulator).values
    ratio = zeta * unnormalised(rng, simulator, rng.choice([0.01, 0.3]))
    policy = some_policy(rng, target, horizon)
    sides = theory.unnormalised_sides(
        target, simulator, policy, horizon=horizon, ratio=ratio
    )
    assert sides.left <= sides.right + scale(target, horizon)


@pytest.mark.parametrize("on_moves", [False, True])
def test_a_is_attained(on_moves):
    """K = (1 + eta) P', r = R: every step counts, and the reward's own move where
    rewards are r(s, a, s').
    """
    rewards = np.full((1, 1, 1) if on_moves else (1, 1), -3.0)
    for discount, eta, horizon in [
        (0.9, 0.1, None),
        (0.5, 0.5, None),
        (0.9, 0.2, 1),
        (0.9, 0.2, 30),
        (1.0, 0.1, 5),
        (0.0, 0.5, None),
        (0.9, 0.0, None),
        (0.5, 1.5, 1000),
    ]:
        target = FiniteMDP(np.ones((1, 1, 1)), rewards, [1.0], discount)
        sides = theory.unnormalised_sides(
            target, target, ONE, horizon=horizon, ratio=sparse.csr_array([[1 + eta]])
        )
        assert_allclose(sides.left, sides.right, rtol=1e-9)
        assert (
            sides.right > 0
            or eta == 0
            or (discount == 0 and not on_moves)
            or (horizon == 1 and not on_moves)
        )


@given(
    st.floats(0, 3),
    st.sampled_from([0.0, 0.3, 0.9, 0.99]),
    st.sampled_from([None, 1, 3, 200]),
    st.booleans(),
)
def test_a_and_b_are_their_sums(eta, discount, horizon, on_moves):
    t = np.arange(5000 if horizon is None else horizon)
    moves = t + on_moves
    b = theory.normalised_bound(
        eta, 2.0, discount, horizon=horizon, rewards_on_moves=on_moves
    )
    assert_allclose(
        b,
        2 * np.sum(discount**t * np.minimum(2.0, moves * eta)),
        rtol=1e-9,
        atol=1e-300,
    )
    if not on_moves and discount < 1:
        assert b <= 2 * discount * eta / (1 - discount) ** 2 * (1 + 1e-9)
    a = theory.unnormalised_bound(
        eta, 2.0, discount, horizon=horizon, rewards_on_moves=on_moves
    )
    if horizon is None and discount * (1 + eta) >= 1:
        assert a == math.inf
    elif horizon is not None or discount * (1 + eta) < 0.98:
        terms = np.exp(
            t * np.log(max(discount, 1e-300)) + moves * np.log1p(eta)
        ) * -np.expm1(-moves * np.log1p(eta))
        assert_allclose(a, 2 * np.sum(terms), rtol=1e-9, atol=1e-290)


def test_b_at_its_ends():
    # the cap is far
    assert_allclose(theory.normalised_bound(1e-9, 1.0, 0.9), 0.9e-9 / 0.01, rtol=1e-9)
    near_one = 1 - 1e-6  # summed to 100 000, and bounded from there
    value = near_one * 1e-9 / (1 - near_one) ** 2
    assert (
        value * (1 - 1e-12)
        <= theory.normalised_bound(1e-9, 1.0, near_one)
        <= 1.001 * value
    )


def fork(lean, discount, reward=1.0):
    """At the start a coin with probability 1/2 + lean of the good end decides: reward
    or -reward in each later step.
    """
    transitions = np.zeros((3, 1, 3))
    transitions[0, 0] = [0, 0.5 + lean, 0.5 - lean]
    transitions[1, 0, 1] = transitions[2, 0, 2] = 1.0
    return FiniteMDP(transitions, [0.0, reward, -reward], [1.0, 0.0, 0.0], discount)


def test_c_is_tight_on_the_fork():
    """Error .11830281, bound .11830380 (both cut off after eight digits); lean .005, g
    .95, T 20.
    """
    sides = theory.kl_path_sides(
        fork(0.0, 0.95), fork(0.005, 0.95), np.ones((3, 1)), horizon=20
    )
    assert f"{sides.left:.10f}"[:10] == "0.11830281"
    assert f"{sides.right:.10f}"[:10] == "0.11830380"
    assert sides.holds
    # sqrt(2 KL) = 2 lean (1 + lean^2/3 + ...)
    assert_allclose(sides.ratio, 1 - 0.005**2 / 3, atol=1e-8)


def test_c_without_a_horizon():
    """The fork's sum in closed form: 2 lean g/(1-g) against sqrt(2 KL) g/(1-g)."""
    policy = np.ones((3, 1))
    for discount in (0.0, 0.5, 0.99):
        sides = theory.kl_path_sides(fork(0.0, discount), fork(0.2, discount), policy)
        kl = renyi_divergence([0.7, 0.3], [0.5, 0.5], 1)
        mass = discount / (1 - discount)
        assert_allclose(
            [sides.left, sides.right], [0.4 * mass, np.sqrt(2 * kl) * mass], rtol=1e-9
        )
    # a model that moves where the target does not: the cap 2 from the first move on
    sides = theory.kl_path_sides(fork(0.5, 0.5), fork(0.0, 0.5), policy)
    assert_allclose([sides.left, sides.right], [1.0, 2.0], rtol=1e-9)
    # the same dynamics: nothing is left over from the infinite sum
    assert theory.kl_path_sides(fork(0.1, 0.999), fork(0.1, 0.999), policy) == Sides(
        0.0, 0.0
    )
    near_one = theory.kl_path_sides(fork(0.0, 1 - 1e-7), fork(0.01, 1 - 1e-7), policy)
    assert near_one.holds
    assert near_one.right <= 2.1e7


# divergences


@given(rngs)
def test_renyi_divergences_grow_with_their_order(rng):
    """Statement 16; Pinsker; E_q zeta^2 = 1 + chi^2 = exp(D_2)."""
    p, q = distributions(rng)
    orders = [1e-3, 0.3, 0.5, 0.999, 1, 1.001, 1.5, 2, 5, 80, math.inf]
    values = [renyi_divergence(p, q, order) for order in orders]
    assert all(
        low <= high + 1e-12 for low, high in zip(values, values[1:], strict=False)
    )
    assert np.all(np.array(values) >= 0)
    assert 0.5 * np.abs(p - q).sum() <= np.sqrt(values[4] / 2) + 1e-15
    if np.all(q[p > 0] > 0):
        shared = q > 0
        second = np.sum(p[shared] ** 2 / q[shared])
        assert_allclose(
            [np.exp(values[7]), second],
            1 + np.sum((p - q)[shared] ** 2 / q[shared]),
            rtol=1e-12,
        )
        assert_allclose(
            values[-1],
            oee.check_assumptions(p, q, lower=0, upper=9).renyi_infinity,
            atol=1e-15,
        )
        for order in (1 - 1e-9, 1 + 1e-9):
            assert_allclose(
                renyi_divergence(p, q, order), values[4], rtol=1e-7, atol=1e-14
            )
    else:
        assert values[4] == values[-1] == math.inf


def test_renyi_divergences_in_closed_form():
    assert renyi_divergence([1, 0], [0, 1], 0.5) == math.inf
    assert_allclose(renyi_divergence([1, 0], [1, 3], 0.25), math.log(4), rtol=1e-14)
    assert_allclose(renyi_divergence([1, 0], [1, 3], 7), math.log(4), rtol=1e-14)
    # -2 log sqrt(1/2)
    assert renyi_divergence([1, 1], [1, 0], 0.5) == pytest.approx(
        math.log(2), rel=1e-14
    )
    assert renyi_divergence([2, 5, 0], [4, 10, 0], 3.0) == 0.0
    # hardly in common
    assert_allclose(
        renyi_divergence([1, 1e-20], [0, 1], 0.999), 999 * 20 * math.log(10), rtol=1e-9
    )
    # to full precision where p is near q: KL = e^2/2 (1 + O(e^2)) of a coin that leans
    # by e/2
    assert_allclose(
        renyi_divergence([0.5 + 5e-8, 0.5 - 5e-8], [0.5, 0.5], 1), 5e-15, rtol=1e-7
    )


# Theorem 1


def test_the_bound_of_theorem_1_by_hand():
    """mu = 10, nu = 1/100: mu + max(log mu, -log nu) = 10 + log 100."""
    value = theory.estimation_bound(400, 10.0, 0.01, 0.9, math.log(3), 2.0)
    assert_allclose(
        value,
        2 * 3 * (10 + math.log(100) + math.sqrt(2 * math.log(10))) / 20,
        rtol=1e-12,
    )
    sides = theory.estimation_sides(
        [1.5, 0.5, 2.0],
        [3, 1, 0],
        [2, 2, 0],
        n=400,
        mu=2.0,
        nu=0.5,
        confidence=0.9,
        constant=1.0,
    )
    assert sides.left == 0.0
    assert_allclose(
        sides.right,
        theory.estimation_bound(400, 2.0, 0.5, 0.9, math.log(1.5), 1.0),
        rtol=1e-14,
    )
    off = theory.estimation_sides(
        [2.0, 0.5], [3, 1], [2, 2], n=4, mu=2.0, nu=0.5, confidence=0.9, constant=1.0
    )
    assert off.left == 0.25  # the square of 2 - 3/2


def test_no_universal_constant():
    """K >= 55, 549, 5491 at n = 1e2, 1e4, 1e6; the estimates are the package's own."""
    for n, needed in ((100, 55), (10_000, 549), (1_000_000, 5491)):
        found = theory.universal_constant_counterexample(n)
        assert round(found.ratio) == needed
        assert not found.holds
        unseen = stats.binom.pmf(0, n, 1 / n)
        assert_allclose(found.probability_flat, unseen**2, rtol=1e-8)
        assert_allclose(found.probability_forced, unseen * (1 - unseen), rtol=1e-8)
        assert min(found.probability_flat, found.probability_forced) > 0.05
    box = {"lower": 0.1, "upper": 10.0, "normalized": False}
    forced = oee.density_ratio([1, 99], [0, 100], **box)
    assert_allclose(forced.ratio[0], 10.0, rtol=1e-12)
    assert oee.density_ratio([0, 100], [0, 100], **box).n_undetermined == 1


@pytest.mark.parametrize(
    ("n", "p", "q"),
    [(40, 0.5, 0.5), (200, 0.3, 0.5), (60, 0.01, 0.6), (300, 0.002, 0.5)],
)
@pytest.mark.parametrize("confidence", [0.5, 0.9])
def test_the_sup_error_bound_covers(n, p, q, confidence):
    """Two cells, every outcome of both samples: the bound is exceeded with probability
    delta at most.
    """
    mu = max(p / q, (1 - p) / (1 - q))
    bound = theory.sup_error_bound(n, min(p, 1 - p), min(q, 1 - q), 2, mu, confidence)
    counts = np.arange(n + 1)
    seen_p, seen_q = np.meshgrid(counts / n, counts / n, indexing="ij")
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = [
            np.abs(a / b - truth)
            for a, b, truth in (
                (seen_p, seen_q, p / q),
                (1 - seen_p, 1 - seen_q, (1 - p) / (1 - q)),
            )
        ]
    exceeded = ~(np.maximum(*errors) <= bound)
    chance = np.outer(stats.binom.pmf(counts, n, p), stats.binom.pmf(counts, n, q))
    assert chance[exceeded].sum() <= 1 - confidence


def test_the_sup_error_bound_by_hand():
    log_term = math.log(4 * 3 / 0.1)
    e_p = math.sqrt(3 * log_term / 2000)
    e_q = math.sqrt(3 * log_term / 4000)
    assert_allclose(
        theory.sup_error_bound(10_000, 0.2, 0.4, 3, 2.0, 0.9),
        2 * (e_p + e_q) / (1 - e_q),
        rtol=1e-12,
    )


@given(rngs)
def test_the_excess_risk_and_the_squared_error(rng):
    """L(g) - L(g*) = E_p phi(g/g*), E_p (g - g*)^2 <= 2 mu^2 of it."""
    p, q = distributions(rng)
    g = rng.uniform(0.1, 3.0, len(p))
    risk = theory.excess_risk(g, p, q)
    if np.any((p > 0) & (q == 0)):
        assert risk == Sides(math.inf, math.inf)
        assert theory.squared_error_sides(g, p, q).right == math.inf
        return
    assert_allclose(risk.left, risk.right, rtol=1e-9, atol=1e-12)
    best = np.divide(p, q, out=np.zeros_like(p), where=q > 0)
    by_hand = (
        np.sum(p[p > 0] * (lambda u: u - 1 - np.log(u))(g[p > 0] / best[p > 0]))
        + q[p == 0] @ g[p == 0]
    )
    assert_allclose(risk.right, by_hand, rtol=1e-9, atol=1e-13)
    assert theory.squared_error_sides(g, p, q).holds
    assert (
        theory.squared_error_sides(g, p, q, mu=50.0).right
        >= theory.squared_error_sides(g, p, q).right
    )
    at_best = theory.squared_error_sides(best, p, q)
    assert_allclose([at_best.left, at_best.right], 0.0, atol=1e-28)


# the Lemma


@given(rngs, st.floats(0.05, 0.95), st.floats(1.05, 20.0))
def test_the_lemma_holds_with_either_constant(rng, nu, mu):
    top, bottom, best_top, best_bottom = rng.uniform(nu, mu, (4, 6))
    arguments = (top, bottom, best_top, best_bottom)
    tight = theory.ratio_error_sides(*arguments, mu=mu, nu=nu, tight=True)
    loose = theory.ratio_error_sides(*arguments, mu=mu, nu=nu)
    assert tight.left == loose.left
    assert tight.left <= tight.right * (1 + 1e-12)
    assert tight.right <= loose.right * (1 + 1e-12)


def test_the_tight_constant_is_attained():
    """mu = 2, nu = 1/2: 10. The worst case mu -> mu - e, nu -> nu + e gives 10 / (1 +
    e/nu): 9.999.
    """
    for error in (1e-2, 1e-5):
        worst = theory.ratio_error_sides(
            [2.0], [0.5], [2.0 - error], [0.5 + error], mu=2.0, nu=0.5, tight=True
        )
        assert_allclose(worst.left / error, 10 / (1 + 2 * error), rtol=1e-9)
        assert_allclose(worst.right / error, 10.0, rtol=1e-9)


# Theorem 2


@given(st.integers(1, 60), st.floats(0.05, 1.0), st.floats(0.3, 0.99))
def test_the_sum_is_the_papers_fraction(horizon, discount, nu):
    x = discount / nu
    if abs(x - 1) < 0.05:
        return
    fraction = (1 - (horizon + 1) * x**horizon + horizon * x ** (horizon + 1)) / (
        1 - x
    ) ** 2
    value = theory.value_error_bound(horizon, 3.0, discount, error=0.2, nu=nu)
    assert_allclose(value, horizon * 0.04 * 9 * x * fraction, rtol=1e-7)


def test_theorem_2_is_false():
    """Err^2 / bound = 1.43 at T = 2, 18 at T = 50 (g .99, nu .97, epsilon .03)."""
    ratios = {
        T: theory.value_bound_counterexample(T, 0.99, 0.03, 0.97).ratio
        for T in (1, 2, 20, 50, 200)
    }
    assert round(ratios[2], 2) == 1.43
    assert round(ratios[50]) == 18
    assert ratios[1] < 1 < ratios[2] < ratios[20] < ratios[50] < ratios[200]
    lemma = theory.ratio_error_bound(1.0, 1.1, 0.97) ** 2
    assert round(lemma, 1) == 5.8
    assert ratios[20] / lemma > 1
    for T in (2, 50):
        t = np.arange(T + 1)
        left = np.sum(0.99**t * (1.03**t - 1)) ** 2
        assert_allclose(
            theory.value_bound_counterexample(T, 0.99, 0.03, 0.97).left,
            left,
            rtol=1e-10,
        )
    # read with T rewards instead of T + 1, it fails as well, a little later
    shorter = [
        np.sum(0.99 ** np.arange(T) * (1.03 ** np.arange(T) - 1)) ** 2
        / theory.value_error_bound(T, 1.0, 0.99, error=0.03, nu=0.97)
        for T in (2, 5, 50)
    ]
    assert shorter[0] < 1 < shorter[1] < shorter[2]


@given(rngs, st.sampled_from([1, 2, 10, 60]))
def test_the_corrected_theorem_2(rng, horizon):
    """With rows that sum to 1, |zhat/zeta - 1| <= error gives KL_t <= t error^2, and
    the bound without 1/nu.
    """
    simulator = random_mdp(rng, form=2)
    target = random_mdp(rng, like=simulator)
    matrix = target.transitions.copy()
    matrix.data = matrix.data * rng.uniform(1 - 0.2, 1 + 0.2, matrix.nnz)
    matrix = sparse.csr_array(matrix.multiply(1 / matrix.sum(axis=1)[:, None]))
    model = target.with_transitions(matrix)
    error = np.abs(model.transitions.data / target.transitions.data - 1).max()
    policy = random_policy(rng, target)
    kl = theory.path_kl(target, model, policy, horizon=horizon)
    assert np.all(kl <= np.arange(horizon + 1) * error**2 + 1e-13)
    left = theory.value_error_sides(
        target, model, policy, horizon=horizon, error=error, nu=0.5
    ).left
    largest = np.abs(target.rewards).max()
    right = theory.corrected_value_error_bound(
        horizon, largest, target.discount, error=error
    )
    assert left <= right + 1e-12 * largest**2 / (1 - target.discount) ** 2


@given(
    st.integers(1, 40), st.floats(0.0, 1.0), st.floats(0.0, 5.0), st.floats(0.0, 2.0)
)
def test_the_corrected_bound_by_hand(horizon, discount, largest, error):
    """2 T R^2 error^2 sum_t t gamma^(2 t), t = 1..T."""
    total = math.fsum(t * discount ** (2 * t) for t in range(1, horizon + 1))
    assert_allclose(
        theory.corrected_value_error_bound(horizon, largest, discount, error=error),
        2 * horizon * largest**2 * error**2 * total,
        rtol=1e-12,
        atol=1e-300,  # products below it have fewer digits
    )


def test_the_corrected_bound_in_the_horizon():
    """Its root times (1 - g)^1.5 stays put at T = 5 / (1 - g): no exponential."""
    roots = [
        math.sqrt(
            theory.corrected_value_error_bound(round(5 / gap), 1.0, 1 - gap, error=1.0)
        )
        * gap**1.5
        for gap in (0.01, 0.001, 0.0001)
    ]
    assert_allclose(roots, roots[-1], rtol=0.02)


@pytest.mark.parametrize("form", ["sa", "sat"])
def test_path_bounds_by_every_path(form):
    simulator, target, _, policy = tiny(8, form=form, n_states=2)
    model = Dense(simulator)
    truth = Dense(target)
    steps = 4
    own = []
    for t in range(steps + 1):
        found = paths(simulator, policy, t)
        own.append(
            sum(
                p
                * sum(
                    np.log(model.P[s, a, j] / truth.P[s, a, j]) for s, a, j, _ in path
                )
                for p, path in found
            )
        )
    assert_allclose(
        theory.path_kl(target, simulator, policy, horizon=steps),
        own,
        rtol=1e-9,
        atol=1e-14,
    )
    shift = int(form == "sat")
    size = np.abs(model.r).max()
    error = abs(model.J(policy, steps) - truth.J(policy, steps))
    g = model.g
    eta = np.abs(model.P - truth.P).sum(axis=2).max()
    bounds = {
        theory.kl_path_sides: sum(
            g**t * min(2.0, np.sqrt(2 * own[t + shift])) for t in range(steps)
        ),
        theory.normalised_sides: sum(
            g**t * min(2.0, (t + shift) * eta) for t in range(steps)
        ),
        theory.unnormalised_sides: sum(
            g**t * ((1 + eta) ** (t + shift) - 1) for t in range(steps)
        ),
    }
    for sides, bound in bounds.items():
        found = sides(target, simulator, policy, horizon=steps)
        assert_allclose([found.left, found.right], [error, size * bound], rtol=1e-9)
        assert found.holds


# the ends: nothing lost, and sums that are infinite

PAYS = FiniteMDP(np.ones((1, 1, 1)), [1.0], [1.0], 0.9)
UNPAID = PAYS.with_rewards([0.0])
GROWS = sparse.csr_array([[1.2]])
CHAIN = survival_chain(1.0)
TWO = np.ones((2, 1))
FASTER = CHAIN.with_transitions(np.array([[[0.6, 0.4]], [[0.0, 1.0]]]))
SAME = ([1.1, 1e308], [1.0, 0.5])
NOTHING = Sides(0.0, 0.0)
INFINITE = Sides(math.inf, math.inf)
SEEN = {"n": 4, "mu": 2.0, "nu": 0.5, "confidence": 0.9, "constant": 1.0}
ENDS = [
    (lambda: theory.unnormalised_sides(PAYS, PAYS, ONE, ratio=GROWS), INFINITE),
    (lambda: theory.unnormalised_sides(UNPAID, UNPAID, ONE, ratio=GROWS), NOTHING),
    # 1.9^100000 overflows
    (lambda: theory.unnormalised_bound(1.0, 1.0, 0.9, horizon=10**5), math.inf),
    (lambda: theory.unnormalised_bound(1.0, 0.0, 0.9), 0.0),
    (lambda: theory.unnormalised_bound(0.0, 1.0, 1.0), 0.0),
    (lambda: theory.normalised_bound(0.1, 1.0, 1.0), math.inf),
    (lambda: theory.normalised_bound(0.1, 0.0, 1.0), 0.0),
    (lambda: theory.normalised_bound(0.0, 1.0, 1.0), 0.0),
    (lambda: theory.kl_path_sides(CHAIN, FASTER, TWO).right, math.inf),
    (lambda: theory.kl_path_sides(CHAIN, CHAIN, TWO), NOTHING),
    (lambda: theory.kl_path_sides(CHAIN, FASTER, TWO, horizon=4).holds, True),
    (lambda: theory.estimation_bound(400, 10.0, 0.01, 0.9, math.inf, 2.0), math.inf),
    (lambda: theory.estimation_bound(400, 10.0, 0.01, 0.9, 1e4, 2.0), math.inf),
    (lambda: theory.estimation_sides([1, 1], [1, 1], [1, 0], **SEEN), INFINITE),
    (lambda: theory.sup_error_bound(10, 0.2, 0.4, 3, 2.0, 0.9), math.inf),
    (lambda: theory.sup_error_bound(10, 0.2, 0.0, 3, 2.0, 0.9), math.inf),
    (lambda: theory.sup_error_bound(10_000, 0.0, 0.4, 3, 2.0, 0.9), math.inf),
    (lambda: theory.excess_risk([0, 1], [1, 1], [1, 1]), INFINITE),
    (lambda: theory.excess_risk([0, 2], [0, 1], [1, 1]), NOTHING),
    (lambda: theory.ratio_error_bound(math.inf, 2.0, 0.5), math.inf),
    (lambda: theory.ratio_error_sides(*SAME, *SAME, mu=1e308, nu=0.5), NOTHING),
    (
        lambda: theory.ratio_error_sides(
            [1e308], [0.5], [1.0], [1.0], mu=1e308, nu=0.5
        ),
        INFINITE,
    ),
    (lambda: theory.value_error_bound(5000, 1.0, 0.99, error=0.1, nu=0.01), math.inf),
    (lambda: theory.value_error_bound(5000, 1.0, 0.99, error=0.0, nu=0.01), 0.0),
    (lambda: theory.value_error_bound(5, 1.0, 0.0, error=0.1, nu=0.5), 0.0),
    (lambda: theory.value_bound_counterexample(5, 0.0, 0.1, 0.5), NOTHING),
    (lambda: (NOTHING.ratio, Sides(1.0, 0.0).ratio), (0.0, math.inf)),
]


@pytest.mark.parametrize(("call", "expected"), ENDS)
def test_bounds_at_their_ends(call, expected):
    assert call() == expected
