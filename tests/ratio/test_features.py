"""Features of moves and of cells, and those that kernels make."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import FEATURES, SIMULATOR, fit

from oee_tabular import FiniteMDP
from oee_tabular.ratio.features import action_displacement, count_rank, feature_array, gaussian, kernel_features


def test_features_of_every_shape():
    whole = np.arange(18.0).reshape(3, 2, 3)
    assert_array_equal(feature_array(whole, SIMULATOR)[:, 0], np.arange(18))
    assert_array_equal(feature_array(np.stack([whole, -whole], axis=3), SIMULATOR)[:, 1], -np.arange(18))
    assert_array_equal(feature_array(np.arange(18), SIMULATOR).shape, (18, 1))
    made = feature_array(lambda s, a, j: 100 * s + 10 * a + j, SIMULATOR)[:, 0]
    assert_array_equal(made, [100 * s + 10 * a + j for s in range(3) for a in range(2) for j in range(3)])
    assert_allclose(feature_array(None, SIMULATOR)[:, 0], np.log(SIMULATOR.transitions.data))


def test_displacements_of_a_walk():
    """Steps of -1, 0 and 1 on a line: of each action the commonest is the reference, the others have columns."""
    rows = np.zeros((3, 2, 3))
    rows[0], rows[1, 0], rows[2] = [[0.2, 0.8, 0], [0.9, 0.1, 0]], [0.1, 0.2, 0.7], [[0, 0.3, 0.7], [0, 0.6, 0.4]]
    rows[1, 1] = [0.6, 0.3, 0.1]
    mdp = FiniteMDP(rows, np.zeros(3), [1, 0, 0], 0.9)
    found = action_displacement(mdp, np.array([0.0, 1.0, 2.0]))
    matrix = mdp.transitions
    state, action = np.divmod(np.repeat(np.arange(6), np.diff(matrix.indptr)), 2)
    move = matrix.indices - state
    kept = [(0, -1), (0, 0), (1, -1), (1, 1)]  # references: 1 of action 0 (mass 1.5), 0 of action 1 (mass 1.6)
    assert_array_equal(found, np.stack([(action == a) & (move == m) for a, m in kept], axis=1))
    flat = action_displacement(mdp, np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0]]))
    assert_array_equal(flat, found)


def test_kernels_and_their_features():
    x = np.array([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]])
    gram = gaussian(1.0)(x, x)
    assert_allclose(gaussian(2.0)(x, x[:2])[:, 1], np.exp(-np.array([25.0, 0.0, 20.0]) / 8))
    made, few = (kernel_features(x, gaussian(1.0), n) for n in (3, 2))
    assert_allclose(made.matrix @ made.matrix.T, gram, atol=1e-12)
    assert made.residual < 1e-12
    assert sorted(made.pivots.tolist()) == [0, 1, 2]
    assert_allclose(few.residual, (np.diag(gram) - (few.matrix**2).sum(axis=1)).max(), rtol=1e-9)
    many = np.linspace(0, 5, 150)[:, None]  # more than two blocks of the diagonal
    whole = kernel_features(many, lambda a, c: (1 + a @ c.T) ** 2, 150)
    assert whole.matrix.shape == (150, 3)
    assert_allclose(whole.matrix @ whole.matrix.T, (1 + many @ many.T) ** 2, rtol=1e-6)


@pytest.mark.parametrize(
    ("features", "rank"),
    [
        (np.zeros((4, 2)), 0),
        (np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1e-9]]), 2),
        (np.array([[1.0, 1.0], [0.0, 1e-9]]), 1),
    ],
)
def test_collinear_features_are_counted_with_a_warning(features, rank):
    with pytest.warns(UserWarning, match=f"^features should be linearly independent; they have rank {rank} of "):
        assert count_rank(features) == rank


def test_collinear_features_within_rows_are_named():
    text = r"^features should be linearly independent within rows; they have rank 1 of 2 \(the smallest parameters that fit"
    with pytest.warns(UserWarning, match=text):
        fit(method="linear", features=FEATURES[:, [0, 0]])
