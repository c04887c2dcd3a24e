"""The value range of Assumption V.1 against linear programs, closed forms and what is
refused.
"""

import numpy as np
import pytest
from helpers import dense, random_mdp, random_policy, rngs
from hypothesis import example, given, settings
from numpy.testing import assert_allclose
from scipy import optimize
from scipy.optimize import linprog
from scipy.stats import chi2

import oee_tabular as oee

INF = float("inf")


def best_row(v, p, nu, mu):
    """max q v over nu p <= q <= min(mu p, 1), sum q = 1, as a linear program."""
    bounds = [(nu * x, min(mu * x, 1.0) if x > 0 else 0.0) for x in p]
    answer = linprog(-v, A_eq=np.ones((1, len(p))), b_eq=[1.0], bounds=bounds)
    assert answer.status == 0
    return answer.x


def brute_force(mdp, policy, nu, mu, sign, horizon=None):
    """Value iteration with a linear program a row, ended by the value of its rows
    (without a horizon).
    """
    P, r = dense(mdp)
    values = np.zeros(len(P))
    for _ in range(60 if horizon is None else horizon):
        ahead = sign * (r + mdp.discount * values)
        q = np.array(
            [
                [best_row(ahead[s, a], P[s, a], nu, mu) for a in range(P.shape[1])]
                for s in range(len(P))
            ]
        )
        # policy iteration of whoever picks the rows: 60 rounds are many more than it
        # takes
        if horizon is None:
            kernel = np.einsum("sa,sat->st", policy, q)
            paid = np.einsum("sa,sat,sat->s", policy, q, r)
            new = np.linalg.solve(np.eye(len(P)) - mdp.discount * kernel, paid)
            if np.abs(new - values).max() < 1e-13:
                break
            values = new
        else:
            values = np.einsum("sa,sat,sat->s", policy, q, r + mdp.discount * values)
    return float(mdp.initial @ values)


@pytest.mark.parametrize("horizon", [None, 4])
def test_value_range_equals_a_linear_program_in_each_row(horizon):
    for seed in range(50 if horizon is None else 10):
        rng = np.random.default_rng(seed)
        mdp = random_mdp(
            rng, n_states=3, n_actions=2, discount=float(rng.choice([0.5, 0.9]))
        )
        policy = random_policy(rng, mdp)
        nu = rng.choice([0.0, 0.3, 0.8])
        mu = rng.choice([1.3, 4.0])
        found = oee.value_range(mdp, policy, nu, mu, horizon=horizon)
        peer = [brute_force(mdp, policy, nu, mu, sign, horizon) for sign in (-1.0, 1.0)]
        assert_allclose([found.lower, found.upper], peer, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("horizon", [None, 1, 7])
def test_value_range_is_monotone_and_ends_at_the_value(horizon):
    boxes = [
        (1.0, 1.0),
        (0.9, 1.0),
        (0.9, 1.2),
        (0.5, 1.2),
        (0.5, 3.0),
        (0.0, 3.0),
        (0.0, INF),
    ]
    for seed in range(10):
        rng = np.random.default_rng(seed)
        mdp = random_mdp(rng, discount=0.9)
        target = random_mdp(rng, like=mdp)
        policy = random_policy(rng, mdp)
        ranges = [oee.value_range(mdp, policy, *box, horizon=horizon) for box in boxes]
        value = oee.policy_value(mdp, policy, horizon=horizon)
        # a row that can be raised nowhere can be lowered nowhere
        for one in ranges[:2]:
            assert_allclose([one.lower, one.upper], value, rtol=1e-11, atol=1e-11)
        slack = 1e-10 * max(1.0, abs(value))
        for narrow, wide in zip(ranges, ranges[1:], strict=False):
            assert wide.lower <= narrow.lower + slack
            assert wide.upper >= narrow.upper - slack
        assert (
            ranges[-1].lower - slack
            <= oee.policy_value(target, policy, horizon=horizon)
            <= ranges[-1].upper + slack
        )


def test_value_range_is_cvar_in_closed_form():
    """One step: nu E u + (1 - nu) CVaR_tau(u), tau = (1 - nu) / (mu - nu), of four
    equally likely rewards.
    """
    rewards = np.array([[[0.0, 1.0, 2.0, 10.0]]])
    P = np.full((1, 1, 4), 0.25)
    P = np.concatenate([P, np.eye(4)[None, 1:].transpose(1, 0, 2)]).reshape(4, 1, 4)
    r = np.where(P > 0, np.concatenate([rewards, np.zeros((3, 1, 4))]), 0.0)
    mdp = oee.FiniteMDP(P, r, 0, 0.5)
    # tau = 1/2: the two worst, the two best
    found = oee.value_range(mdp, np.ones((4, 1)), 0.5, 1.5, horizon=1)
    assert_allclose(
        [found.lower, found.upper], [0.5 * 3.25 + 0.5 * 0.5, 0.5 * 3.25 + 0.5 * 6.0]
    )
    assert (found.confidence, found.method) == (1.0, "range")
    assert (
        str(found)
        == "[1.875, 4.625], range over all models in the box; discounted sum of"
        " rewards, not normalised"
    )


def test_value_range_follows_a_policy_of_each_step():
    mdp = oee.tasks.gridworld(3, 0.3, discount=0.9)
    policy = np.stack([oee.tasks.gridworld_policy(3, d) for d in (0.2, 0.9, 0.5)])
    one = oee.value_range(mdp, policy, 1.0, 1.0, horizon=3)
    assert_allclose(one.upper, oee.policy_value(mdp, policy, horizon=3), rtol=1e-12)
    same = [
        oee.value_range(mdp, p, 0.5, 2.0, horizon=3)
        for p in (policy[0], np.stack([policy[0]] * 3))
    ]
    assert_allclose(
        [same[0].lower, same[0].upper], [same[1].lower, same[1].upper], rtol=1e-13
    )


def walk(stay):
    """From 0 to the end 1 with probability 1 - stay, -1 a step."""
    return oee.FiniteMDP([[[stay, 1 - stay]], [[0, 1.0]]], [-1.0, 0.0], 0, 1.0)


def test_value_range_at_discount_1_where_the_policy_ends():
    """1 - stay lies between nu .5 and mu .5: as many steps as its inverse."""
    found = oee.value_range(walk(0.5), [0, 0], 0.4, 1.5)
    assert_allclose([found.lower, found.upper], [-1 / 0.25, -1 / 0.75], rtol=1e-12)
    assert_allclose(
        oee.value_range(walk(0.5), [0, 0], 0.0, 1.5).lower, -4.0, rtol=1e-12
    )
    assert_allclose(
        oee.value_range(walk(0.5), [0, 0], 0.4, 3.0).lower, -5.0, rtol=1e-12
    )


# ---- the likelihood interval of a model whose rows share parameters, under a tie or
# features
def log_zeta(simulator, phi, theta):
    """(entries,) logarithms of rows proportional to P exp(phi theta), less those of P;
    in range for any theta.
    """
    starts = simulator.transitions.indptr[:-1]
    lengths = np.diff(simulator.transitions.indptr)
    exponent = phi @ theta
    exponent = exponent - np.repeat(np.maximum.reduceat(exponent, starts), lengths)
    total = np.add.reduceat(simulator.transitions.data * np.exp(exponent), starts)
    return exponent - np.repeat(np.log(total), lengths)


def tilted(simulator, phi, theta):
    """(entries,) rows proportional to P exp(phi theta)."""
    return simulator.transitions.data * np.exp(log_zeta(simulator, phi, theta))


def with_rows(simulator, data):
    matrix = simulator.transitions.copy()
    matrix.data = data
    return simulator.with_transitions(matrix)


def pair(seed, theta=(0.6, -0.4)):
    """A simulator, a target that differs along two random features, and a policy."""
    rng = np.random.default_rng(seed)
    simulator = random_mdp(rng, n_states=5, n_actions=2, zeros=0.3, discount=0.8)
    phi = rng.normal(size=(simulator.transitions.nnz, 2))
    return (
        simulator,
        with_rows(simulator, tilted(simulator, phi, np.array(theta))),
        random_policy(rng, simulator),
        phi,
    )


def log_of(target, n, seed):
    share = np.full(
        (target.n_states, target.n_actions), 1 / (target.n_states * target.n_actions)
    )
    return oee.sample_transitions(target, share, n, seed=seed)


@settings(max_examples=8, deadline=None)
@example(np.random.default_rng(447))  # SLSQP looks far outside of the set
@example(np.random.default_rng(20409))  # seventy linearisations
@given(rngs)
def test_the_ends_are_the_extremes_over_the_set(rng):
    """By SLSQP from several starts, on the risk written out: -log-likelihood + |theta
    s|^2 / 2.
    """
    simulator, target, policy, phi = pair(int(rng.integers(1 << 30)))
    log = log_of(target, int(rng.integers(30, 300)), int(rng.integers(1 << 30)))
    found = oee.interval(oee.Problem(simulator, log), policy, features=phi)
    P = simulator.transitions.data
    indptr = simulator.transitions.indptr
    row = np.repeat(np.arange(10), np.diff(indptr))
    n = np.asarray(log.counts(5, 2)[row, simulator.transitions.indices]).reshape(-1)
    centred = phi - np.add.reduceat(P[:, None] * phi, indptr[:-1])[row]
    seen = (np.bincount(row, n) > 0) & (np.diff(indptr) > 1)  # what tells something
    scale = np.sqrt(
        np.add.reduceat(P[:, None] * centred**2, indptr[:-1])[seen].sum(axis=0)
        / seen.sum()
    )

    def risk(theta):
        return -n @ log_zeta(simulator, phi, theta) + 0.5 * np.sum((scale * theta) ** 2)

    def value(theta):
        return oee.policy_value(
            with_rows(simulator, tilted(simulator, phi, theta)), policy
        )

    best = optimize.minimize(risk, np.zeros(2), method="BFGS", options={"gtol": 1e-8})
    limit = best.fun + 0.5 * chi2.ppf(0.95, 1)
    inside = {"type": "ineq", "fun": lambda theta: limit - risk(theta)}
    # what BFGS finds
    assert_allclose(
        found.diagnostics["estimate"], value(best.x), rtol=0, atol=1e-5 * found.width
    )
    for sign, end in ((1, found.lower), (-1, found.upper)):
        starts = [best.x + 0.1 * d for d in (np.zeros(2), *np.eye(2), *-np.eye(2))]
        ends = [
            optimize.minimize(
                lambda t, s: s * value(t),
                x,
                (sign,),
                method="SLSQP",
                constraints=[{**inside, "args": ()}],
            )
            for x in starts
        ]
        farthest = min(sign * value(e.x) for e in ends if risk(e.x) <= limit + 1e-6)
        # SLSQP may fall short
        assert -1e-4 * found.width <= farthest - sign * end <= 0.05 * found.width


def test_a_tie_is_features_that_are_indicators_of_its_keys():
    simulator, target, policy, _ = pair(1)
    keys = np.arange(simulator.transitions.nnz) % 4
    problem = oee.Problem(simulator, log_of(target, 200, 0))
    tied = oee.interval(problem, policy, tie=keys)
    features = oee.interval(problem, policy, features=np.eye(4)[keys])
    assert_allclose(
        [tied.lower, tied.upper], [features.lower, features.upper], rtol=1e-6
    )
    assert (tied.method, tied.under) == ("likelihood under the tie", "the tie")
    assert ", 95% likelihood interval under the tie; " in str(tied)
    assert tied.diagnostics["n_parameters"] == 4


def test_a_higher_level_is_wider_and_infinite_data_leave_a_point():
    simulator, target, policy, phi = pair(2)
    problem = oee.Problem(simulator, log_of(target, 300, 0))
    narrow, wide = (
        oee.interval(problem, policy, features=phi, confidence=level)
        for level in (0.5, 0.99)
    )
    assert wide.lower < narrow.lower < narrow.upper < wide.upper
    many = oee.Problem(simulator, 1e7 * target.transitions)
    found = oee.interval(many, policy, features=phi)
    assert_allclose(
        [found.lower, found.upper], oee.policy_value(target, policy), rtol=1e-3
    )
