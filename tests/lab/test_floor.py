"""The floor's table, against the dual: the prior of the simulator's error under which the best ratio is worst."""

import numpy as np
from numpy.testing import assert_allclose
from scipy import stats

from oee_tabular.lab.bench.league import ERRORS, floor


def test_the_table_against_the_least_favourable_prior():
    """Mirror ascent on the prior; its Bayes rule bounds the least worst ratio from below, its worst ratio from above."""
    errors = np.union1d(np.arange(0.0, 10.01, 0.1), ERRORS)
    scale = np.maximum(np.minimum(errors, 1.0), 0.5)
    x = np.linspace(-18.0, 18.0, 1501)
    here, mirrored = (stats.norm.pdf(x - sign * errors[:, None]) for sign in (1.0, -1.0))
    prior = np.full(len(errors), 1.0 / len(errors))
    for k in range(600):
        weights = prior / scale**2
        rule = (weights * errors) @ (here - mirrored) / (weights @ (here + mirrored))
        squares = ((rule - errors[:, None]) ** 2 * here).sum(axis=1) * (x[1] - x[0]) / scale**2
        least, worst = np.sqrt(prior @ squares), np.sqrt(squares.max())
        prior = prior * np.exp(0.5 / np.sqrt(1.0 + k / 50.0) * (squares - squares.max()))
        prior /= prior.sum()
    assert 1.22 < least < worst < 1.23
    assert_allclose(floor(ERRORS), np.sqrt(squares)[np.isin(errors, ERRORS)], rtol=0.01)
    assert floor(np.array([7.0, -7.0])).tolist() == [1.224, 1.224]
