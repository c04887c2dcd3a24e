import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import optimize, stats

from oee_tabular.ratio import density_ratio_samples
from oee_tabular.ratio.features import gaussian
from oee_tabular.ratio.samples import kernel as sample_kernel
from oee_tabular.ratio.samples._log_linear import newton

GRID = np.linspace(-3, 3, 400)


def gaussians(n=1000, seed=0):
    """P = N(0.5, 0.8), Q = N(0, 1)."""
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


def test_quadratic_is_the_class_of_gaussians():
    """On p of variance .64: log g = -x^2/2 (1/.64 - 1) + x .5/.64 + constant."""
    fit = density_ratio_samples(*gaussians(200_000), features="quadratic")
    center, scale = fit.details["center"][0], fit.details["scale"][0]
    first, second = fit.details["theta"]
    assert_allclose(second / scale**2, -0.5 * (1 / 0.64 - 1), atol=0.01)
    assert_allclose(first / scale - 2 * center * second / scale**2, 0.5 / 0.64, atol=0.01)
    assert error(fit) < 0.01


def test_the_words_are_functions_of_standardised_points():
    rng = np.random.default_rng(3)
    p, q = rng.normal(0.3, 0.9, (80, 3)), rng.normal(5.0, 2.0, (90, 3)) - [5.0, 4.0, 5.0]
    linear = density_ratio_samples(p, q, features="linear")
    assert_allclose(linear.p_ratio, density_ratio_samples(p, q, features=lambda x: x).p_ratio, rtol=1e-9)

    def products(x):
        z = (x - q.mean(axis=0)) / q.std(axis=0)
        return np.hstack([z, np.array([z[:, i] * z[:, j] for i in range(3) for j in range(i, 3)]).T])

    quadratic_fit = density_ratio_samples(p, q, features="quadratic")
    assert quadratic_fit.details["theta"].shape == (9,)
    assert_allclose(quadratic_fit.q_ratio, density_ratio_samples(p, q, features=products).q_ratio, rtol=1e-9)


@pytest.mark.parametrize("options", [{"features": "linear"}, {"features": "quadratic"}, {"kernel": "gaussian"}])
def test_shift_and_scale_change_nothing(options):
    p, q = gaussians(600)
    expected = density_ratio_samples(p, q, **options)
    for shift, scale in ((1e6, 1.0), (-3.0, 1e-8), (0.0, 1e8)):
        fit = density_ratio_samples(shift + scale * p, shift + scale * q, **options)
        assert_allclose(fit.q_ratio, expected.q_ratio, rtol=1e-6, atol=1e-8)
        assert_allclose(fit.at(shift + scale * p), fit.p_ratio, rtol=1e-8)
        if "features" in options:
            assert_allclose(fit.q_ratio.mean(), 1.0, rtol=1e-12)


@pytest.mark.parametrize("shift", [1e6, 1e9])
def test_features_without_digits_are_normalised_all_the_same(shift):
    p, q = gaussians(300)
    with pytest.warns(UserWarning, match="features should be linearly independent on x_q; they have rank 1 of 2"):
        fit = density_ratio_samples(p + shift, q + shift, features=quadratic)
    assert_allclose(fit.q_ratio.mean(), 1.0, rtol=1e-12)


def test_collinear_and_constant_features():
    p, q = gaussians(300)
    x = density_ratio_samples(p, q, features="linear")
    with pytest.warns(UserWarning, match="they have rank 1 of 3") as caught:
        fit = density_ratio_samples(p, q, features=lambda x: np.hstack([x, 1 - 2 * x, 3 * x]))
    assert caught[0].filename == __file__
    assert fit.gap < 1e-12
    assert_allclose(fit.p_ratio, x.p_ratio, rtol=0.01)  # of a penalty that is a third
    everywhere = density_ratio_samples(p, q, features=lambda x: np.hstack([x, np.full_like(x, 7.1)]))  # without warning
    assert_allclose(everywhere.p_ratio, x.p_ratio, rtol=1e-12)
    pairs = [np.column_stack([z, np.full((300, 2), 0.1)]) for z in (p, q)]
    pairs[0][5, 2] = 4.0
    with pytest.warns(UserWarning, match=r"features\[:, 2\] is constant there and not on x_p") as caught:
        fit = density_ratio_samples(*pairs, features="linear")
    assert caught[0].filename == __file__
    assert_allclose(fit.p_ratio, x.p_ratio, rtol=1e-12)


def test_samples_that_do_not_overlap():
    rng = np.random.default_rng(0)
    q = rng.normal(0, 1, 200)
    for distance in (6.0, 1e3, 1e8):
        for features in ("linear", "quadratic", quadratic):
            with pytest.raises(ValueError, match=r"x_q must cover x_p; the features extrapolate to a ratio of exp\("):
                density_ratio_samples(distance + rng.normal(0, 1, 200), q, features=features)
        fit = density_ratio_samples(distance + rng.normal(0, 1, 200), q)
        assert np.isfinite(fit.p_ratio).all()
        assert fit.gap < 1e-12
    with pytest.warns(UserWarning, match="x_q must cover x_p"):
        fit = density_ratio_samples([0.9] * 50 + [3.0], np.linspace(-1, 1, 100), features="linear")
    assert 1e5 < fit.p_ratio[-1] < 1e14
    assert_allclose(fit.q_ratio.mean(), 1.0, rtol=1e-12)
    near = density_ratio_samples(rng.normal(1, 1, 200), q, features="linear")
    assert np.isfinite(near.at([1e6, -1e6, 1e300])).all()


def test_the_kernel_class_finds_the_shape():
    errors = []
    for seed in range(20):
        p, q = gaussians(seed=seed)
        fit = density_ratio_samples(p, q, kernel="gaussian")
        assert fit.gap < 1e-12
        assert fit.method == "kernel"
        assert (fit.q_ratio >= 0).all()
        assert_allclose(fit.at(p), fit.p_ratio, rtol=1e-9, atol=1e-12)
        errors.append(np.mean(np.abs(fit.q_ratio - stats.norm(0.5, 0.8).pdf(q) / stats.norm(0, 1).pdf(q))))
    assert np.mean(errors) < 0.0804  # densratio's uLSIF on these samples (tests/benchmarks/sample_ratios.py)


def refitted(draw, n_fits=60, n=1000):
    """The default fit on samples of each of n_fits seeds."""
    return [density_ratio_samples(*draw(np.random.default_rng(seed), n)) for seed in range(n_fits)]


def test_the_score_test_has_its_level_where_the_class_is_right():
    """The quadratic class has these ratios: of Gaussians, in one and two dimensions, and of exponentials (an x alone)."""
    draws = (
        lambda rng, n: (rng.normal(0.5, 0.8, n), rng.normal(0, 1, n)),
        lambda rng, n: (rng.normal(0.2, 0.9, (n, 2)), rng.normal(0, 1, (n + 200, 2))),
        lambda rng, n: (rng.exponential(0.7, n), rng.exponential(1.0, n)),
    )
    for draw in draws:
        fits = refitted(draw)
        p_values = [fit.details["p_value"] for fit in fits]
        assert stats.kstest(p_values, "uniform").pvalue > 1e-3
        assert {fit.method for fit in fits if fit.details["p_value"] > 0.2} == {"log-linear"}
        assert {fit.method for fit in fits if fit.details["p_value"] <= 0.2} == {"kernel"}


def test_the_score_test_refuses_what_the_class_has_not():
    draws = (
        lambda rng, n: (rng.normal(rng.choice([-1, 1], n), 0.5), rng.normal(0, 1, n)),  # two modes
        lambda rng, n: (rng.standard_t(3, n), rng.normal(0, 1.2, n)),  # heavy tails
        lambda rng, n: (rng.uniform(0, 0.7, n), rng.uniform(0, 1, n)),  # a jump
    )
    for draw in draws:
        fits = refitted(draw, 20)
        assert sum(fit.method == "kernel" for fit in fits) >= 18


def test_the_default_is_one_of_the_two_classes():
    p, q = gaussians(seed=1)
    x = np.linspace(-2, 2, 9)
    default, named = density_ratio_samples(p, q), density_ratio_samples(p, q, features="quadratic")
    assert default.method == "log-linear"
    assert_allclose(default.at(x), named.at(x), rtol=1e-14)
    p = np.concatenate([p - 2, p + 2])
    default, named = density_ratio_samples(p, q), density_ratio_samples(p, q, kernel="gaussian")
    assert default.method == "kernel"
    assert default.details["p_value"] < 1e-9
    assert_allclose(default.at(x), named.at(x), rtol=1e-14)
    few = density_ratio_samples(*gaussians(511))  # 8 times the square of 2 features and 6 bumps are 512
    assert few.method == "kernel"
    assert "p_value" not in few.details
    assert "p_value" in density_ratio_samples(*gaussians(512)).details


def test_the_default_errs_less_than_the_peers():
    errors = []
    for seed in range(20):
        p, q = gaussians(seed=seed)
        fit = density_ratio_samples(p, q)
        errors.append(np.mean(np.abs(fit.q_ratio - stats.norm(0.5, 0.8).pdf(q) / stats.norm(0, 1).pdf(q))))
    assert np.mean(errors) < 0.063  # adapt's KLIEP on these samples (tests/benchmarks/sample_ratios.py)


def test_the_default_does_not_explode_outside_the_samples():
    rng = np.random.default_rng(4)
    p, q = rng.normal(0, 1.3, 1000), rng.normal(0, 1, 1000)
    fit = density_ratio_samples(p, q)
    assert fit.method == "log-linear"
    assert_allclose(fit.at([8.0]), max(fit.p_ratio.max(), fit.q_ratio.max()))
    assert density_ratio_samples(p, q, features="quadratic").at([8.0]) > 1e3 * fit.at([8.0])
    assert_allclose(fit.at(p), fit.p_ratio)


@pytest.mark.parametrize("case", ["constant", "two values", "far", "overflow"])
def test_samples_that_the_quadratic_class_cannot_have_get_the_kernel(case):
    """Without a warning: no class was asked for."""
    p, q = gaussians()
    if case == "constant":
        p, q = np.column_stack([p, p]), np.column_stack([q, np.zeros(1000)])
    elif case == "two values":
        p, q = p > 0.3, q > 0.3
    elif case == "far":
        p = p + 1e4
    else:
        p = p * 1e100
    fit = density_ratio_samples(p, q)
    assert (fit.method, fit.details["p_value"]) == ("kernel", 0.0)


def test_leave_one_out_leaves_one_out():
    rng = np.random.default_rng(1)
    at_p, at_q = rng.random((12, 4)), rng.random((15, 4))
    ridges = np.array([0.01, 0.5, 3.0])
    fits = sample_kernel._leave_one_out(at_p, at_q, ridges)
    for k, ridge in enumerate(ridges):

        def weights(p, q, ridge=ridge):
            return np.linalg.solve(q.T @ q / len(q) + ridge * np.eye(4), p.mean(axis=0))

        squares = [(at_q[i] @ weights(at_p, np.delete(at_q, i, axis=0))) ** 2 for i in range(15)]
        values = [at_p[j] @ weights(np.delete(at_p, j, axis=0), at_q) for j in range(12)]
        assert_allclose(fits.scores[k], 0.5 * np.mean(squares) - np.mean(values), rtol=1e-10)
        assert_allclose(fits.weights[:, k], weights(at_p, at_q), rtol=1e-10)
    assert (fits.gaps < 1e-25).all()


def test_the_kernel_fit_is_the_weighted_mean_of_refits():
    rng = np.random.default_rng(2)
    p, q = rng.normal(0.3, 1, (30, 2)), rng.normal(0, 1, (40, 2))
    fit = density_ratio_samples(p, q, n_centers=7, seed=1)
    details = fit.details
    assert len(details["scores"]) == len(details["shares"]) == 7 * 13
    assert_allclose(sum(details["shares"].values()), 1.0, rtol=1e-12)
    least = details["scores"][details["bandwidth"], details["ridge"]]
    assert least == min(details["scores"].values())
    n, expected = 2 / (1 / 30 + 1 / 40), 0.0
    for (bandwidth, ridge), share in details["shares"].items():
        assert bandwidth in details["weights"] or share == 0
        if share > 0:
            rise = details["scores"][bandwidth, ridge] - least
            assert_allclose(
                np.log(share / details["shares"][details["bandwidth"], details["ridge"]]), -n * rise, atol=1e-9
            )
        at_p, at_q = (gaussian(bandwidth)(x, details["centers"]) for x in (p, q))
        w = np.linalg.solve(at_q.T @ at_q / 40 + ridge * np.eye(7), at_p.mean(axis=0))
        expected = expected + share * at_q @ w
    assert_allclose(fit.q_ratio, np.maximum(expected, 0.0), rtol=1e-9, atol=1e-12)


def test_a_kernel_of_one_s_own():
    p, q = gaussians(300)
    own = density_ratio_samples(p, q, kernel=lambda x, c: np.exp(-np.abs(x - c.T)))
    assert error(own) < 0.3
    assert own.details["bandwidth"] is None


def test_centers_are_distinct_points():
    """On categories the kernel of sameness is a table: p/q of the counts, shrunk."""
    rng = np.random.default_rng(0)
    p, q = rng.integers(0, 5, 400), rng.choice(5, 400, p=[0.4, 0.3, 0.1, 0.1, 0.1])
    fit = density_ratio_samples(p, q, kernel=lambda x, c: (x == c.T).astype(float), n_centers=5)
    assert sorted(fit.details["centers"][:, 0]) == [0, 1, 2, 3, 4]
    assert_allclose(fit.at(np.arange(5)), np.bincount(p) / np.bincount(q), rtol=0.1)


@pytest.mark.parametrize("options", [{"features": "linear"}, {}])
def test_at_asks_for_the_dimension_of_the_samples(options):
    rng = np.random.default_rng(0)
    fit = density_ratio_samples(rng.normal(size=(20, 2)), rng.normal(size=(30, 2)), **options)
    assert fit.at(np.zeros((3, 2))).shape == (3,)
    for x, found in ((np.zeros((3, 3)), 3), (np.zeros(2), 1)):
        with pytest.raises(
            ValueError, match=f"x must have points of dimension 2, as x_p has; they have dimension {found}"
        ):
            fit.at(x)


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
            lambda: density_ratio_samples([1, 2], [1, 2], features="cubic"),
            "features must be one of 'linear', 'quadratic'; got 'cubic'",
        ),
        (
            lambda: density_ratio_samples([1, 2], [1, 2], features=3),
            "features must be one of 'linear', 'quadratic'; got 3",
        ),
        (lambda: density_ratio_samples([1, 2], [1, 2], kernel=3), "kernel must be one of 'gaussian'; got 3"),
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


def test_what_two_samples_say():
    rng = np.random.default_rng(0)
    p, q = rng.normal(0.3, 1, 60), rng.normal(0, 1, 80)
    tilt = density_ratio_samples(p, q, features="linear")
    assert (tilt.method, set(tilt.details)) == ("log-linear", {"theta", "center", "scale"})
    own = density_ratio_samples(p, q, features=lambda x: x)
    assert set(own.details) == {"theta"}
    assert_allclose(own.q_ratio, tilt.q_ratio, rtol=1e-8)
    kernel = density_ratio_samples(p, q)
    assert kernel.method == "kernel"
    assert set(kernel.details) == {"bandwidth", "ridge", "centers", "weights", "scores", "shares"}
    assert_allclose(sum(kernel.details["shares"].values()), 1.0)
    least = min(kernel.details["scores"], key=kernel.details["scores"].get)
    assert least == (kernel.details["bandwidth"], kernel.details["ridge"])
    assert_allclose(kernel.at(p), kernel.p_ratio, rtol=1e-8)
    assert_allclose(kernel.at(q), kernel.q_ratio, rtol=1e-8)
    few = density_ratio_samples(p, q, n_centers=7, seed=3)
    assert len(few.details["centers"]) == 7
    again = density_ratio_samples(p, q, n_centers=7, seed=3)
    assert_array_equal(few.p_ratio, again.p_ratio)


@pytest.mark.parametrize(("n", "k"), [(200, 1), (500, 5)])
def test_the_compiled_newton_against_plain_numpy(n, k):
    """Newton's steps on log mean exp(theta phi) - aim . theta + penalty/2 |theta|^2, undamped: the start is near enough."""
    rng = np.random.default_rng(n)
    phi, aim, penalty = rng.normal(size=(k, n)), rng.normal(0.2, 0.1, k), 0.01
    theta = np.zeros(k)
    for _ in range(50):
        weights = np.exp(theta @ phi)
        weights /= weights.sum()
        off = phi - (phi @ weights)[:, None]
        hessian = (off * weights) @ off.T + penalty * np.eye(k)
        theta = theta - np.linalg.solve(hessian, phi @ weights - aim + penalty * theta)
    found, gap, log_mean, shares = newton(phi, aim, penalty)
    assert_allclose(found, theta, rtol=1e-10, atol=1e-12)
    assert_allclose(log_mean, np.log(np.exp(theta @ phi).mean()), atol=1e-11)
    assert_allclose(shares, weights, rtol=1e-9)
    assert gap < 1e-15
