import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import optimize, stats

from oee_tabular.ratio import density_ratio_samples, samples

GRID = np.linspace(-3, 3, 400)


def gaussians(n=1000, seed=0):
    """numerics.md A7: P = N(0.5, 0.8), Q = N(0, 1)."""
    rng = np.random.default_rng(seed)
    return rng.normal(0.5, 0.8, n), rng.normal(0, 1, n)


def error(fit):
    """L1(q) distance to the true ratio."""
    q = stats.norm(0, 1).pdf(GRID)
    return float(np.sum(q * np.abs(fit.at(GRID) - stats.norm(0.5, 0.8).pdf(GRID) / q)) / q.sum())


def quadratic(x):
    return np.hstack([x, x**2])


def test_log_linear_is_accurate_certified_and_normalised():
    errors = []
    for seed in range(10):
        p, q = gaussians(seed=seed)
        fit = density_ratio_samples(p, q, features=quadratic)
        assert fit.gap < 1e-12
        assert_allclose(fit.q_ratio.mean(), 1.0, rtol=1e-12)
        assert_allclose(fit.at(p), fit.p_ratio)
        errors.append(error(fit))
    assert np.mean(errors) < 0.08


def test_log_linear_minimises_its_risk():
    p, q = gaussians(200)
    fit = density_ratio_samples(p, q, features=quadratic)
    at_p, at_q = quadratic(p[:, None]), quadratic(q[:, None])
    scale = at_q.std(axis=0)

    def risk(theta):
        return np.log(np.mean(np.exp(at_q @ theta))) - (at_p @ theta).mean() + 0.5 * ((theta * scale) ** 2).sum() / 200

    found = optimize.minimize(risk, np.zeros(2), method="BFGS", options={"gtol": 1e-10})
    assert_allclose(fit.details["theta"], found.x, atol=1e-5)


def test_the_kernel_class_finds_the_shape():
    errors = [error(density_ratio_samples(*gaussians(seed=seed))) for seed in range(5)]
    assert np.mean(errors) < 0.12
    fit = density_ratio_samples(*gaussians())
    assert fit.gap < 1e-12
    assert fit.method == "kernel"
    assert (fit.q_ratio >= 0).all()


def test_leave_one_out_leaves_one_out():
    rng = np.random.default_rng(1)
    at_p, at_q = rng.random((12, 4)), rng.random((15, 4))
    for ridge in (0.01, 0.5):

        def weights(p, q, ridge=ridge):
            return np.linalg.solve(q.T @ q / len(q) + ridge * np.eye(4), p.mean(axis=0))

        squares = [(at_q[i] @ weights(at_p, np.delete(at_q, i, axis=0))) ** 2 for i in range(15)]
        values = [at_p[j] @ weights(np.delete(at_p, j, axis=0), at_q) for j in range(12)]
        expected = 0.5 * np.mean(squares) - np.mean(values)
        assert_allclose(samples._leave_one_out(at_p, at_q, np.array([ridge])), [expected], rtol=1e-10)


def test_a_kernel_of_one_s_own():
    p, q = gaussians(300)
    own = density_ratio_samples(p, q, kernel=lambda x, c: np.exp(-np.abs(x - c.T)))
    assert error(own) < 0.3


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: density_ratio_samples([1.0, np.nan], [1.0, 2.0]), r"x_p\[1\] must be finite; it is nan"),
        (lambda: density_ratio_samples([1.0], [1.0, 2.0]), "x_p must have at least 2 points; it has 1"),
        (lambda: density_ratio_samples(np.ones((3, 2)), np.ones((3, 1))), "must have one dimension; they have 2 and 1"),
        (lambda: density_ratio_samples([1, 2], [1, 2], features=quadratic, kernel="gaussian"), "not both"),
        (
            lambda: density_ratio_samples([1, 2], [1, 2], kernel="cubic"),
            "kernel must be one of 'gaussian'; got 'cubic'",
        ),
        (lambda: density_ratio_samples([1, 2], [1, 2], features=lambda x: [1.0]), "features must give one row a point"),
        (
            lambda: density_ratio_samples([1, 2], [1, 2], kernel=lambda x, c: x),
            r"kernel must give an array of shape \(2, 2\)",
        ),
        (lambda: density_ratio_samples([1, 2], [1, 2], n_centers=0), "n_centers must be a positive integer"),
    ],
)
def test_bad_calls(call, text):
    with pytest.raises(ValueError, match=text):
        call()
