"""The likelihood interval of a model whose rows share parameters, under a tie or features."""

import numpy as np
from helpers import random_mdp, random_policy, rngs
from hypothesis import example, given, settings
from numpy.testing import assert_allclose
from scipy import optimize
from scipy.stats import chi2

import oee_tabular as oee


def log_zeta(simulator, phi, theta):
    """(entries,) logarithms of rows proportional to P exp(phi theta), less those of P; in range for any theta."""
    starts, lengths = simulator.transitions.indptr[:-1], np.diff(simulator.transitions.indptr)
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
    return simulator, with_rows(simulator, tilted(simulator, phi, np.array(theta))), random_policy(rng, simulator), phi


def log_of(target, n, seed):
    share = np.full((target.n_states, target.n_actions), 1 / (target.n_states * target.n_actions))
    return oee.sample_transitions(target, share, n, seed=seed)


@settings(max_examples=8, deadline=None)
@example(np.random.default_rng(447))  # SLSQP looks far outside of the set
@example(np.random.default_rng(20409))  # seventy linearisations
@given(rngs)
def test_the_ends_are_the_extremes_over_the_set(rng):
    """By SLSQP from several starts, on the risk written out: -log-likelihood + |theta s|^2 / 2."""
    simulator, target, policy, phi = pair(int(rng.integers(1 << 30)))
    log = log_of(target, int(rng.integers(30, 300)), int(rng.integers(1 << 30)))
    found = oee.interval(oee.Problem(simulator, log), policy, features=phi)
    P, indptr = simulator.transitions.data, simulator.transitions.indptr
    row = np.repeat(np.arange(10), np.diff(indptr))
    n = np.asarray(log.counts(5, 2)[row, simulator.transitions.indices]).reshape(-1)
    centred = phi - np.add.reduceat(P[:, None] * phi, indptr[:-1])[row]
    seen = (np.bincount(row, n) > 0) & (np.diff(indptr) > 1)  # what tells something
    scale = np.sqrt(np.add.reduceat(P[:, None] * centred**2, indptr[:-1])[seen].sum(axis=0) / seen.sum())

    def risk(theta):
        return -n @ log_zeta(simulator, phi, theta) + 0.5 * np.sum((scale * theta) ** 2)

    def value(theta):
        return oee.policy_value(with_rows(simulator, tilted(simulator, phi, theta)), policy)

    best = optimize.minimize(risk, np.zeros(2), method="BFGS", options={"gtol": 1e-8})
    limit = best.fun + 0.5 * chi2.ppf(0.95, 1)
    inside = {"type": "ineq", "fun": lambda theta: limit - risk(theta)}
    assert_allclose(found.diagnostics["estimate"], value(best.x), rtol=0, atol=1e-5 * found.width)  # what BFGS finds
    for sign, end in ((1, found.lower), (-1, found.upper)):
        starts = [best.x + 0.1 * d for d in (np.zeros(2), *np.eye(2), *-np.eye(2))]
        ends = [
            optimize.minimize(
                lambda t, s: s * value(t), x, (sign,), method="SLSQP", constraints=[{**inside, "args": ()}]
            )
            for x in starts
        ]
        farthest = min(sign * value(e.x) for e in ends if risk(e.x) <= limit + 1e-6)
        assert sign * end <= farthest + 1e-4 * found.width


def test_a_tie_is_features_that_are_indicators_of_its_keys():
    simulator, target, policy, _ = pair(1)
    keys = np.arange(simulator.transitions.nnz) % 4
    problem = oee.Problem(simulator, log_of(target, 200, 0))
    tied = oee.interval(problem, policy, tie=keys)
    features = oee.interval(problem, policy, features=np.eye(4)[keys])
    assert_allclose([tied.lower, tied.upper], [features.lower, features.upper], rtol=1e-6)
    assert tied.method == "likelihood under the tie"
    assert tied.diagnostics["n_parameters"] == 4


def test_a_higher_level_is_wider_and_infinite_data_leave_a_point():
    simulator, target, policy, phi = pair(2)
    problem = oee.Problem(simulator, log_of(target, 300, 0))
    narrow, wide = (oee.interval(problem, policy, features=phi, confidence=level) for level in (0.5, 0.99))
    assert wide.lower < narrow.lower < narrow.upper < wide.upper
    many = oee.Problem(simulator, 1e7 * target.transitions)
    found = oee.interval(many, policy, features=phi)
    assert_allclose([found.lower, found.upper], oee.policy_value(target, policy), rtol=1e-3)
