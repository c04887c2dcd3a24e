"""The tilt along given features, the strength of the prior, and the ridge that is chosen on the data."""

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import optimize, sparse, special

import oee_tabular as oee

BELIEVED = 1e13  # a strength at which zeta is the tilt


def fit_tilt(observed, simulator, features=None, **options):
    """theta, zeta and the gap of the tilt for counts on the simulator's entries."""
    matrix = simulator.transitions
    counts = sparse.csr_array((observed, matrix.indices, matrix.indptr), matrix.shape)
    options = {"prior": "tilt", "strength": BELIEVED, "features": features} | options
    zeta = oee.transition_ratio(counts, simulator, **options)
    return zeta.details["theta"], zeta.values.data, zeta.details["tilt_gap"]


def sums(values, indptr):
    return np.add.reduceat(values, indptr[:-1], axis=0)


def spread(rows, indptr):
    return np.repeat(rows, np.diff(indptr), axis=0)


def observed_from(rng, mdp, n):
    weights = np.full((mdp.n_states, mdp.n_actions), 1 / (mdp.n_states * mdp.n_actions))
    log = oee.sample_transitions(mdp, weights, n, seed=int(rng.integers(1 << 30)))
    counts = log.counts(mdp.n_states, mdp.n_actions).toarray()
    rows = np.repeat(np.arange(mdp.transitions.shape[0]), np.diff(mdp.transitions.indptr))
    return counts[rows, mdp.transitions.indices]


def grids(size=5):
    return oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)


def standardised(phi, simulator, observed):
    """phi centred in each row, its root mean square over the rows with counts 1; the scale."""
    indptr, weights = simulator.transitions.indptr, simulator.transitions.data
    centred = phi - spread(sums(weights[:, None] * phi, indptr), indptr)
    seen = sums(observed, indptr) > 0
    scale = np.sqrt(sums(weights[:, None] * centred**2, indptr)[seen].sum(axis=0) / seen.sum())
    return centred / scale, scale


@given(rngs, st.integers(1, 3))
def test_the_tilt_minimises_its_risk(rng, d):
    """Against scipy's BFGS on the risk written out anew, with standardised features and unit penalty."""
    simulator = random_mdp(rng, n_states=5, n_actions=2, zeros=0.0)
    observed = observed_from(rng, simulator, int(rng.integers(1, 80)))
    phi = rng.normal(size=(simulator.transitions.nnz, d))
    indptr = simulator.transitions.indptr.astype(np.int64)
    weights = simulator.transitions.data
    theta, zeta, gap = fit_tilt(observed, simulator, phi)
    standard, scale = standardised(phi, simulator, observed)

    def risk(theta):
        log_z = np.log(sums(weights * np.exp(standard @ theta), indptr))
        return sums(observed, indptr) @ log_z - observed @ (standard @ theta) + 0.5 * theta @ theta

    def slope(theta):
        tilted = weights * np.exp(standard @ theta)
        tilted *= spread(sums(observed, indptr) / sums(tilted, indptr), indptr)
        return (tilted - observed) @ standard + theta

    found = optimize.minimize(risk, np.zeros(d), jac=slope, method="BFGS", options={"gtol": 1e-9})
    assert risk(theta * scale) <= found.fun + 1e-10
    assert_allclose(theta * scale, found.x, atol=1e-5)
    assert 0 <= gap < 1e-15
    raw = weights * np.exp(phi @ theta)
    assert_allclose(weights * zeta, raw / spread(sums(raw, indptr), indptr), rtol=1e-9)


def test_features_in_every_form_are_the_same():
    simulator, target = grids()
    log = oee.sample_episodes(target, oee.uniform_policy(target), 30, 100, seed=0)
    dense = np.zeros((25, 4, 25))
    rows = np.repeat(np.arange(100), np.diff(simulator.transitions.indptr))
    flat = (simulator.transitions.indices - rows // 4).astype(float)
    dense.reshape(100, 25)[rows, simulator.transitions.indices] = flat
    forms = [flat, flat[:, None], dense, dense[..., None], lambda s, a, t: t - s]
    values = [oee.transition_ratio(log, simulator, prior="tilt", features=form).values.data for form in forms]
    for other in values[1:]:
        assert_allclose(other, values[0], rtol=1e-12)


# ---- the strength ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("p", "n"), [(1e-6, 1e6), (1e-8, 1e4), (1e-9, 1e3), (1e-10, 100)])
def test_a_feature_of_one_rare_transition_is_fitted_with_a_true_certificate(p, n):
    simulator = oee.FiniteMDP([[[1 - p, p]], [[0.5, 0.5]]], [0.0, 0.0], [1.0, 0.0], 0.9)
    observed = np.array([0.0, n, 5.0, 5.0])
    (theta,), _, gap = fit_tilt(observed, simulator, np.array([0.0, 1.0, 0.0, 0.0]))
    centred, scale = np.array([-p, 1 - p]), np.sqrt(p * (1 - p) / 2)

    def risk(theta):  # of the first row; the second has no feature
        exponent = centred / scale * theta
        return n * (special.logsumexp(exponent, b=[1 - p, p]) - exponent[1]) + 0.5 * theta**2

    found = theta * scale
    best = min(risk(t) for t in np.concatenate([np.linspace(0, 60, 2001) * scale, [found]]))
    assert (risk(found) - best) / (n + 10) <= gap + 1e-9
    assert gap < 1e-6


def test_enormous_counts_of_collinear_features():
    simulator = oee.FiniteMDP(np.full((2, 1, 2), 0.5), [0.0, 0.0], [1.0, 0.0], 0.9)
    features = np.array([[1.0, 1.0], [0.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    with pytest.warns(UserWarning, match="rank 1 of 2"):
        _, zeta, _ = fit_tilt(np.array([3e15, 1e15, 3e15, 1e15]), simulator, features, strength=1e-3)
    assert_allclose(zeta, [1.5, 0.5, 1.5, 0.5], rtol=1e-6)


def test_one_transition_says_nothing_about_the_prior():
    simulator = oee.FiniteMDP(np.full((6, 1, 6), 1 / 6), np.zeros(6), np.full(6, 1 / 6), 0.9)
    zeta = oee.transition_ratio(oee.Transitions([0], [0], [1]), simulator)
    assert zeta.details["meaning"].startswith("too few transitions to decide")
    assert zeta.details["strength"] == pytest.approx(1e8)
    assert_allclose(zeta.values.data, 1.0, atol=1e-4)
