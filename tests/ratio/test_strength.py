"""The strength of the prior: its choice, the kinds of rows that share one, what it means."""

import numpy as np
import pytest
from helpers import rows_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import gammaln

from oee_tabular.ratio.prior.strength import StrengthChoice, choose_strength, kinds_of_rows, meaning


def many_rows(kappa, seed=0, n=60, rows=40):
    rng = np.random.default_rng(seed)
    prior = np.array([0.5, 0.3, 0.2])
    return np.array([rng.multinomial(n, rng.dirichlet(kappa * prior)) for _ in range(rows)]).astype(float), prior


@pytest.mark.parametrize("criterion", ["evidence", "loo"])
def test_the_chosen_strength_is_the_best_of_a_fine_grid(criterion):
    observed, prior = many_rows(20.0)
    rows = len(observed)
    base, indptr = np.tile(prior, rows), np.arange(rows + 1) * 3

    def score(kappa):
        n, m = observed.sum(axis=1, keepdims=True), kappa * prior
        if criterion == "evidence":
            gained = gammaln(m + observed) - gammaln(m)
            return gained.sum() + rows * gammaln(kappa) - gammaln(kappa + n).sum()
        seen = np.where(observed > 0, observed, 1.0)
        return np.sum(np.where(observed > 0, observed * np.log((seen - 1 + m) / (n - 1 + kappa)), 0.0))

    found = choose_strength(observed.reshape(-1), base, rows_of(base, indptr), criterion)
    fine = np.exp(np.linspace(0, np.log(1e4), 20_001))
    scores = np.array([score(k) for k in fine])
    assert found.criterion == criterion
    assert_allclose(found.strength, fine[scores.argmax()], rtol=0.04)
    assert_allclose(found.score, scores.max(), rtol=1e-5)
    assert_array_equal(found.by_row, np.full(rows, found.strength))
    assert_allclose((found.grid[0], found.grid[-1], len(found.grid)), (1.0, 1e8, 17))
    assert_allclose(found.curve, [score(k) for k in found.grid], rtol=1e-9)
    assert found.kinds == [(rows, 60 * rows, found.strength)]


def test_kinds_of_rows():
    """The same probabilities in any order are one kind; kinds with few rows or few moves are pooled."""
    rows = [[0.5, 0.3, 0.2]] * 3 + [[0.2, 0.5, 0.3]] * 3 + [[0.6, 0.2, 0.2]] * 5 + [[0.1, 0.1, 0.8]] * 4
    weights, indptr = np.array(rows).reshape(-1), np.arange(16) * 3
    enough = np.full(45, 10.0)
    kinds = kinds_of_rows(enough, rows_of(weights, indptr))
    assert len(set(kinds[:6])) == 1
    assert len(set(kinds[6:11])) == 1
    assert (kinds[11:] == 0).all()
    assert len({kinds[0], kinds[6], 0}) == 3
    thin = enough.copy()
    thin[18:33] = 100.0 / 15  # 100 moves in five rows: enough
    assert kinds_of_rows(thin, rows_of(weights, indptr))[6] != 0
    thin[18] -= 1.0
    assert kinds_of_rows(thin, rows_of(weights, indptr))[6] == 0
    four = enough.copy()
    four[18:21] = 0.0  # one of the five rows never visited
    assert kinds_of_rows(four, rows_of(weights, indptr))[6] == 0


def test_what_the_strength_means():
    n_row = np.array([0.0, 10.0, 20.0, 30.0])
    flat, curve = np.zeros(3), np.array([0.0, 5.0, 0.0])

    def words(strength, kinds=((3, 60, 500.0),), curve=curve):
        return meaning(StrengthChoice(n_row, strength, 0.0, "loo", flat, curve, list(kinds), flat), n_row, "tilt")

    compared = "a row of it is worth {} transitions, and the log has 20 in the median row"
    assert words(300.0) == "the tilt fits: " + compared.format(300)
    assert words(299.0) == "the tilt fits roughly: " + compared.format(299)
    assert words(50.0) == "the tilt fits roughly: " + compared.format(50)
    assert words(49.0) == "the tilt does not fit: " + compared.format(49)
    parts = [(3, 60, 500.0), (2, 40, 49.0)]
    assert words(300.0, parts) == "the tilt fits: " + compared.format(300) + "; but not in 2 of 5 rows"
    whole = compared.replace("{} transitions", "any number of transitions")
    assert words(1e8) == "the tilt fits: " + whole
    assert words(9.9e5) == "the tilt fits: " + compared.format("9.9e+05")
    assert words(300.0, curve=flat + 0.5) == (
        "too few transitions to decide whether the tilt fits (20 in the median recorded row)"
    )
