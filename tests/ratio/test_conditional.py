"""The conditional ratio: its prior row, its strength and what it means, its ridge; fits block by block."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, SIMULATOR, fit
from scipy import sparse
from scipy.special import gammaln

import oee_tabular as oee
from oee_tabular.ratio.prior.strength import StrengthChoice, meaning


def test_the_tilt_s_prior_row_and_strength():
    """(n + kappa m) / (n_sa + kappa) over P, m the tilt's row; the tilt's row alone where the log has none."""
    found = fit(prior="tilt", strength=5.0)
    P = SIMULATOR.transitions.toarray()
    base = P ** (1 + found.details["theta"][0])
    base /= base.sum(axis=1, keepdims=True)
    expected = (COUNTS + 5.0 * base) / (COUNTS.sum(axis=1, keepdims=True) + 5.0)
    assert_allclose(found.values.toarray() * SIMULATOR.transitions.toarray(), expected, rtol=1e-10)
    bare = fit(prior="tilt", strength=0.0)
    assert_allclose(bare.values.toarray()[4] * SIMULATOR.transitions.toarray()[4], base[4], rtol=1e-10)
    assert found.details["strength"] == 5.0
    ridged = fit(prior="simulator", strength=0.0, ridge=lambda n: 2.0 / n)
    same = fit(prior="simulator", strength=0.0, ridge=lambda n: 2.0 / n, toward=1.0)
    assert_array_equal(ridged.values.data, same.values.data)
    assert_array_equal(ridged.values.toarray()[4], np.ones(3))


@pytest.mark.parametrize("criterion", ["evidence", "loo"])
def test_a_chosen_ridge_is_kappa_over_the_count_of_each_row(criterion):
    """Also in a row of one move; and the criterion that was asked for is the one that is used."""
    counts = COUNTS.copy()
    counts[4] = [1.0, 0.0, 0.0]
    chosen = fit(counts, prior="none", ridge=criterion)
    assert chosen.details["ridge_by"] == criterion
    kappa = chosen.details["ridge_times_count"]
    assert kappa > 1.0
    same = fit(counts, prior="none", ridge=lambda n: kappa / n)
    assert_allclose(chosen.values.data, same.values.data, rtol=1e-9)
    assert fit(counts, prior="simulator", strength=criterion).details["strength_by"] == criterion
    kinds = fit(prior="simulator", strength=criterion).details["strength_kinds"]
    assert [(rows, moves) for rows, moves, _ in kinds] == [(5, 43)]  # of six rows, one without moves


# ---- the strength of the prior


def of_rows(rows, counts, **options):
    """The fit of one action whose rows lead to the first states."""
    padded = np.pad(rows, ((0, 0), (0, len(rows) - len(rows[0]))))
    simulator = oee.FiniteMDP(padded[:, None], np.zeros(len(rows)), 0, 0.9)
    matrix = sparse.csr_array(np.pad(counts, ((0, 0), (0, len(rows) - len(rows[0])))).astype(float))
    return oee.transition_ratio(matrix, simulator, prior="simulator", **options).details


@pytest.mark.parametrize("criterion", ["evidence", "loo"])
def test_the_chosen_strength_is_the_best_of_a_fine_grid(criterion):
    """The rows' probability under Dirichlet(kappa m), or each transition's under those of the others."""
    rng, prior, rows = np.random.default_rng(0), np.array([0.5, 0.3, 0.2]), 40
    observed = np.array([rng.multinomial(60, rng.dirichlet(20.0 * prior)) for _ in range(rows)])

    def score(kappa):
        n, m = observed.sum(axis=1, keepdims=True), kappa * prior
        if criterion == "evidence":
            gained = gammaln(m + observed) - gammaln(m)
            return gained.sum() + rows * gammaln(kappa) - gammaln(kappa + n).sum()
        seen = np.where(observed > 0, observed, 1.0)
        return np.sum(np.where(observed > 0, observed * np.log((seen - 1 + m) / (n - 1 + kappa)), 0.0))

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
    """The same probabilities in any order are one kind; kinds with few rows or few transitions are pooled."""
    rows = [[0.5, 0.3, 0.2]] * 3 + [[0.2, 0.5, 0.3]] * 3 + [[0.6, 0.2, 0.2]] * 5 + [[0.1, 0.1, 0.8]] * 4
    counts = np.full((15, 3), 10)

    def kinds(*changes):
        changed = counts.copy()
        for place, number in changes:
            changed[place] = number
        return sorted(kind[:2] for kind in of_rows(rows, changed)["strength_kinds"])

    assert kinds() == [(4, 120), (5, 150), (6, 180)]
    assert kinds((slice(6, 11), [8, 6, 6])) == [(4, 120), (5, 100), (6, 180)]
    assert kinds((slice(6, 11), [8, 6, 6]), (6, [7, 6, 6])) == [(6, 180), (9, 219)]  # 99 transitions in five rows
    assert kinds((6, 0)) == [(6, 180), (8, 240)]  # one of the five rows never recorded


def test_what_the_strength_means():
    """From 50 transitions a row on the prior fits roughly, from 300 on it fits; that of kinds, and too few to decide."""
    n_row, flat, curve = np.array([0.0, 10.0, 20.0, 30.0]), np.zeros(3), np.array([0.0, 5.0, 0.0])

    def words(strength, *kinds, curve=curve):
        kinds = [(3, 60, 500.0), *kinds]
        return meaning(StrengthChoice(n_row, strength, 0.0, "loo", flat, curve, kinds, flat), n_row, "tilt")

    compared = "a row of it is worth {} transitions, and the log has 20 in the median row"
    verdicts = {300.0: "fits", 299.0: "fits roughly", 50.0: "fits roughly", 49.0: "does not fit"}
    for strength, verdict in verdicts.items():
        assert words(strength) == f"the tilt {verdict}: {compared.format(int(strength))}"
    assert words(300.0, (2, 40, 49.0)) == f"the tilt fits: {compared.format(300)}; but not in 2 of 5 rows"
    assert "is worth any number of transitions" in words(1e8)
    assert words(9.9e5) == "the tilt fits: " + compared.format("9.9e+05")
    few = "too few transitions to decide whether the tilt fits (20 in the median recorded row)"
    assert words(300.0, curve=flat + 0.5) == few


# ---- block by block


OPTIONS = {
    "average": {},
    "tilt": {"prior": "tilt"},
    "box and ridge": {"prior": "simulator", "ridge": 0.1, "lower": 0.2, "upper": 3.0},
    "nothing": {"prior": "none", "ridge": lambda n: 1.0 / n},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_fit_by_blocks_is_that_of_all_rows_at_once(name, monkeypatch):
    simulator, target = oee.tasks.gridworld(5, 0.3), oee.tasks.gridworld(5, 0.1)
    policy = oee.tasks.gridworld_expert(5)
    log = oee.sample_episodes(target, oee.uniform_policy(target), 15, 30, seed=0)
    about = {} if OPTIONS[name] else {"values_of": policy}
    gradient = np.random.default_rng(0).normal(size=simulator.transitions.nnz)
    found = []
    for size, small in ((2**18, 10**6), (37, 0)):  # also: rows centred by numpy, or by a sparse product
        monkeypatch.setattr("oee_tabular.mdp.rows.BLOCK", size)
        monkeypatch.setattr("oee_tabular.mdp.rows.SMALL", small)
        monkeypatch.setattr("oee_tabular.ratio.conditional.BLOCK", size)
        fit = oee.transition_ratio(log, simulator, **about, **OPTIONS[name])
        step = fit.one_step(gradient)
        errors = [fit.log_standard_error(gradient), step.change, step.standard_error, step.unseen, step.change_error]
        found.append(
            [fit.values.data, fit.gap, *fit.details["enclosure"], np.array(errors), fit.maximum_likelihood_rows]
        )
    for one, other in zip(*found, strict=True):
        assert_allclose(one, other, rtol=1e-12, atol=1e-14)
