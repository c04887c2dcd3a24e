"""The conditional ratio: its prior row, its strength and what it means, its ridge; fits
block by block.
"""

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, SIMULATOR, fit
from scipy import optimize, sparse, special
from scipy.special import gammaln

import oee_tabular as oee
from oee_tabular.shrinkage.strength import StrengthChoice, meaning


def test_the_tilt_s_prior_row_and_strength():
    """(n + kappa m) / (n_sa + kappa) over P, m the tilt's row; the tilt's row alone
    where the log has none.
    """
    found = fit(prior="tilt", strength=5.0)
    P = SIMULATOR.transitions.toarray()
    base = P ** (1 + found.details["theta"][0])
    base /= base.sum(axis=1, keepdims=True)
    expected = (COUNTS + 5.0 * base) / (COUNTS.sum(axis=1, keepdims=True) + 5.0)
    assert_allclose(
        found.values.toarray() * SIMULATOR.transitions.toarray(), expected, rtol=1e-10
    )
    bare = fit(prior="tilt", strength=0.0)
    assert_allclose(
        bare.values.toarray()[4] * SIMULATOR.transitions.toarray()[4],
        base[4],
        rtol=1e-10,
    )
    assert found.details["strength"] == 5.0
    ridged = fit(prior="simulator", strength=0.0, ridge=lambda n: 2.0 / n)
    same = fit(prior="simulator", strength=0.0, ridge=lambda n: 2.0 / n, toward=1.0)
    assert_array_equal(ridged.values.data, same.values.data)
    assert_array_equal(ridged.values.toarray()[4], np.ones(3))


@pytest.mark.parametrize("criterion", ["evidence", "loo"])
def test_a_chosen_ridge_is_kappa_over_the_count_of_each_row(criterion):
    """Also in a row of one move; and the criterion that was asked for is the one that
    is used.
    """
    counts = COUNTS.copy()
    counts[4] = [1.0, 0.0, 0.0]
    chosen = fit(counts, prior="none", ridge=criterion)
    assert chosen.details["ridge_by"] == criterion
    kappa = chosen.details["ridge_times_count"]
    assert kappa > 1.0
    same = fit(counts, prior="none", ridge=lambda n: kappa / n)
    assert_allclose(chosen.values.data, same.values.data, rtol=1e-9)
    assert (
        fit(counts, prior="simulator", strength=criterion).details["strength_by"]
        == criterion
    )
    kinds = fit(prior="simulator", strength=criterion).details["strength_kinds"]
    # of six rows, one without moves
    assert [(rows, moves) for rows, moves, _ in kinds] == [(5, 43)]


# ---- the strength of the prior


def of_rows(rows, counts, **options):
    """The fit of one action whose rows lead to the first states."""
    padded = np.pad(rows, ((0, 0), (0, len(rows) - len(rows[0]))))
    simulator = oee.FiniteMDP(padded[:, None], np.zeros(len(rows)), 0, 0.9)
    matrix = sparse.csr_array(
        np.pad(counts, ((0, 0), (0, len(rows) - len(rows[0])))).astype(float)
    )
    return oee.transition_ratio(matrix, simulator, prior="simulator", **options).details


@pytest.mark.parametrize("criterion", ["evidence", "loo"])
def test_the_chosen_strength_is_the_best_of_a_fine_grid(criterion):
    """The rows' probability under Dirichlet(kappa m), or each transition's under those
    of the others.
    """
    rng = np.random.default_rng(0)
    prior = np.array([0.5, 0.3, 0.2])
    rows = 40
    observed = np.array(
        [rng.multinomial(60, rng.dirichlet(20.0 * prior)) for _ in range(rows)]
    )

    def score(kappa):
        n = observed.sum(axis=1, keepdims=True)
        m = kappa * prior
        if criterion == "evidence":
            gained = gammaln(m + observed) - gammaln(m)
            return gained.sum() + rows * gammaln(kappa) - gammaln(kappa + n).sum()
        seen = np.where(observed > 0, observed, 1.0)
        return np.sum(
            np.where(
                observed > 0, observed * np.log((seen - 1 + m) / (n - 1 + kappa)), 0.0
            )
        )

    found = of_rows(np.tile(prior, (rows, 1)), observed, strength=criterion)
    fine = np.exp(np.linspace(0, np.log(1e4), 20_001))
    scores = np.array([score(k) for k in fine])
    assert_allclose(found["strength"], fine[scores.argmax()], rtol=0.04)
    assert_allclose(found["strength_score"], scores.max(), rtol=1e-5)
    grid, curve = found["strength_curve"]
    assert_allclose((grid[0], grid[-1], len(grid)), (1.0, 1e8, 17))
    assert_allclose(curve, [score(k) for k in grid], rtol=1e-9)
    assert found["strength_kinds"] == [(rows, 60 * rows, found["strength"])]


def test_kinds_of_rows_share_a_strength():
    """The same probabilities in any order are one kind; kinds with few rows or few
    transitions are pooled.
    """
    rows = (
        [[0.5, 0.3, 0.2]] * 3
        + [[0.2, 0.5, 0.3]] * 3
        + [[0.6, 0.2, 0.2]] * 5
        + [[0.1, 0.1, 0.8]] * 4
    )
    counts = np.full((15, 3), 10)

    def kinds(*changes):
        changed = counts.copy()
        for place, number in changes:
            changed[place] = number
        return sorted(kind[:2] for kind in of_rows(rows, changed)["strength_kinds"])

    assert kinds() == [(4, 120), (5, 150), (6, 180)]
    assert kinds((slice(6, 11), [8, 6, 6])) == [(4, 120), (5, 100), (6, 180)]
    # 99 transitions in five rows
    assert kinds((slice(6, 11), [8, 6, 6]), (6, [7, 6, 6])) == [(6, 180), (9, 219)]
    assert kinds((6, 0)) == [(6, 180), (8, 240)]  # one of the five rows never recorded


def test_what_the_strength_means():
    """From 50 transitions a row on the prior fits roughly, from 300 on it fits; that of
    kinds, and too few to decide.
    """
    n_row = np.array([0.0, 10.0, 20.0, 30.0])
    flat = np.zeros(3)
    curve = np.array([0.0, 5.0, 0.0])

    def words(strength, *kinds, curve=curve):
        kinds = [(3, 60, 500.0), *kinds]
        return meaning(
            StrengthChoice(n_row, strength, 0.0, "loo", flat, curve, kinds, flat),
            n_row,
            "tilt",
        )

    compared = (
        "a row of it is worth {} transitions, and the log has 20 in the median row"
    )
    verdicts = {
        300.0: "fits",
        299.0: "fits roughly",
        50.0: "fits roughly",
        49.0: "does not fit",
    }
    for strength, verdict in verdicts.items():
        assert (
            words(strength) == f"the tilt {verdict}: {compared.format(int(strength))}"
        )
    assert (
        words(300.0, (2, 40, 49.0))
        == f"the tilt fits: {compared.format(300)}; but not in 2 of 5 rows"
    )
    assert "is worth any number of transitions" in words(1e8)
    assert words(9.9e5) == "the tilt fits: " + compared.format("9.9e+05")
    few = (
        "too few transitions to decide whether the tilt fits (20 in the median recorded"
        " row)"
    )
    assert words(300.0, curve=flat + 0.5) == few


# ---- block by block


OPTIONS = {
    "ridge": {},
    "tilt": {"prior": "tilt"},
    "box and ridge": {"prior": "simulator", "ridge": 0.1, "lower": 0.2, "upper": 3.0},
    "nothing": {"prior": "none", "ridge": lambda n: 1.0 / n},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_fit_by_blocks_is_that_of_all_rows_at_once(name, monkeypatch):
    simulator = oee.tasks.gridworld(5, 0.3)
    target = oee.tasks.gridworld(5, 0.1)
    policy = oee.tasks.gridworld_expert(5)
    log = oee.sample_episodes(target, oee.uniform_policy(target), 15, 30, seed=0)
    about = {} if OPTIONS[name] else {"values_of": policy}
    gradient = np.random.default_rng(0).normal(size=simulator.transitions.nnz)
    found = []
    # also: rows centred by numpy, or by a sparse product
    for size, small in ((2**18, 10**6), (37, 0)):
        monkeypatch.setattr("oee_tabular.mdp.rows.BLOCK", size)
        monkeypatch.setattr("oee_tabular.mdp.rows.MAX_REDUCEAT_SIZE", small)
        monkeypatch.setattr("oee_tabular.ratio.conditional.BLOCK", size)
        fit = oee.transition_ratio(log, simulator, **about, **OPTIONS[name])
        step = fit.one_step(gradient)
        errors = [
            fit.log_standard_error(gradient),
            step.change,
            step.standard_error,
            step.unrecorded,
            step.change_error,
        ]
        found.append(
            [
                fit.values.data,
                fit.gap,
                *fit.details["enclosure"],
                np.array(errors),
                fit.maximum_likelihood_rows,
            ]
        )
    for one, other in zip(*found, strict=True):
        assert_allclose(one, other, rtol=1e-12, atol=1e-14)


# ---- the tilt along given features, the strength of the prior, and the ridge that is
# chosen on the data
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
    rows = np.repeat(
        np.arange(mdp.transitions.shape[0]), np.diff(mdp.transitions.indptr)
    )
    return counts[rows, mdp.transitions.indices]


def grids(size=5):
    return oee.tasks.gridworld(size, 0.3), oee.tasks.gridworld(size, 0.1)


def standardised(phi, simulator, observed):
    """phi centred in each row, its root mean square over the rows with counts 1; the
    scale.
    """
    indptr = simulator.transitions.indptr
    weights = simulator.transitions.data
    centred = phi - spread(sums(weights[:, None] * phi, indptr), indptr)
    seen = sums(observed, indptr) > 0
    scale = np.sqrt(
        sums(weights[:, None] * centred**2, indptr)[seen].sum(axis=0) / seen.sum()
    )
    return centred / scale, scale


@given(rngs, st.integers(1, 3))
def test_the_tilt_minimises_its_risk(rng, d):
    """Against scipy's BFGS on the risk written out anew, with standardised features and
    unit penalty.
    """
    simulator = random_mdp(rng, n_states=5, n_actions=2, zeros=0.0)
    observed = observed_from(rng, simulator, int(rng.integers(1, 80)))
    phi = rng.normal(size=(simulator.transitions.nnz, d))
    indptr = simulator.transitions.indptr.astype(np.int64)
    weights = simulator.transitions.data
    theta, zeta, gap = fit_tilt(observed, simulator, phi)
    standard, scale = standardised(phi, simulator, observed)

    def risk(theta):
        log_z = np.log(sums(weights * np.exp(standard @ theta), indptr))
        return (
            sums(observed, indptr) @ log_z
            - observed @ (standard @ theta)
            + 0.5 * theta @ theta
        )

    def slope(theta):
        tilted = weights * np.exp(standard @ theta)
        tilted *= spread(sums(observed, indptr) / sums(tilted, indptr), indptr)
        return (tilted - observed) @ standard + theta

    found = optimize.minimize(
        risk, np.zeros(d), jac=slope, method="BFGS", options={"gtol": 1e-9}
    )
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
    values = [
        oee.transition_ratio(log, simulator, prior="tilt", features=form).values.data
        for form in forms
    ]
    for other in values[1:]:
        assert_allclose(other, values[0], rtol=1e-12)


# ---- the strength
# ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("p", "n"), [(1e-6, 1e6), (1e-8, 1e4), (1e-9, 1e3), (1e-10, 100)]
)
def test_a_feature_of_one_rare_transition_is_fitted_with_a_true_certificate(p, n):
    simulator = oee.FiniteMDP([[[1 - p, p]], [[0.5, 0.5]]], [0.0, 0.0], [1.0, 0.0], 0.9)
    observed = np.array([0.0, n, 5.0, 5.0])
    (theta,), _, gap = fit_tilt(observed, simulator, np.array([0.0, 1.0, 0.0, 0.0]))
    centred = np.array([-p, 1 - p])
    scale = np.sqrt(p * (1 - p) / 2)

    def risk(theta):  # of the first row; the second has no feature
        exponent = centred / scale * theta
        return (
            n * (special.logsumexp(exponent, b=[1 - p, p]) - exponent[1])
            + 0.5 * theta**2
        )

    found = theta * scale
    best = min(
        risk(t) for t in np.concatenate([np.linspace(0, 60, 2001) * scale, [found]])
    )
    assert (risk(found) - best) / (n + 10) <= gap + 1e-9
    assert gap < 1e-6


def test_enormous_counts_of_collinear_features():
    simulator = oee.FiniteMDP(np.full((2, 1, 2), 0.5), [0.0, 0.0], [1.0, 0.0], 0.9)
    features = np.array([[1.0, 1.0], [0.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    with pytest.warns(UserWarning, match="rank 1 of 2"):
        _, zeta, _ = fit_tilt(
            np.array([3e15, 1e15, 3e15, 1e15]), simulator, features, strength=1e-3
        )
    assert_allclose(zeta, [1.5, 0.5, 1.5, 0.5], rtol=1e-6)


def test_one_transition_says_nothing_about_the_prior():
    simulator = oee.FiniteMDP(
        np.full((6, 1, 6), 1 / 6), np.zeros(6), np.full(6, 1 / 6), 0.9
    )
    zeta = oee.transition_ratio(oee.Transitions([0], [0], [1]), simulator)
    assert zeta.details["meaning"].startswith("too few transitions to decide")
    assert zeta.details["strength"] == pytest.approx(1e8)
    assert_allclose(zeta.values.data, 1.0, atol=1e-4)
