"""Linear and kernel classes: solutions, certificates, refusals, and zeta in a class,
all by public calls.
"""

import numpy as np
import pytest
from helpers import rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal

import oee_tabular as oee
from oee_tabular.ratio import Kernel, Linear

LINE = np.linspace(-3.0, 3.0, 40)
Q = np.exp(-(LINE**2) / 2)
P = np.exp(-((LINE - 0.5) ** 2) / 1.28)
COUNTS = np.random.default_rng(0).multinomial(300, P / P.sum())
QUADRATIC = np.column_stack([np.ones(40), LINE, LINE**2])


def random_program(rng):
    """p, q, a class with a constant, and options for ``density_ratio``."""
    n = int(rng.integers(8, 40))
    phi = np.column_stack([np.ones(n), rng.normal(size=(n, int(rng.integers(1, 5))))])
    p = rng.integers(0, 5, n) + 0.0
    q = rng.integers(1, 5, n) + 0.0
    p[0] += 1
    return (
        p,
        q,
        {
            "functions": Linear(phi),
            "lower": float(rng.choice([0.0, 10 ** rng.uniform(-3, -0.5)])),
            "upper": float(rng.choice([np.inf, 10 ** rng.uniform(0.3, 2)])),
            "normalized": bool(rng.random() < 0.6),
            "ridge": float(rng.choice([0.0, 10 ** rng.uniform(-4, 0)])),
        },
    )


def value(w, p, q, options):
    g = options["functions"].features @ w
    seen = p > 0
    return (
        (q @ g) / q.sum()
        - p[seen] @ np.log(g[seen]) / p.sum()
        + options["ridge"] / 2 * w @ w
    )


@settings(max_examples=30)
@given(rngs)
def test_no_feasible_point_is_better_by_more_than_the_gap(rng):
    p, q, options = random_program(rng)
    fit = oee.density_ratio(p, q, **options)
    g = options["functions"].features @ fit.weights
    assert 0 <= fit.gap < 1e-9
    assert_allclose(fit.ratio, g, atol=1e-9)
    assert (fit.ratio >= options["lower"]).all()
    assert (fit.ratio <= options["upper"]).all()
    assert_allclose(fit.objective, value(fit.weights, p, q, options), atol=1e-9)
    if options["normalized"]:
        assert_allclose(q @ fit.ratio, q.sum(), rtol=1e-9)
    for size in (1e-6, 1e-4, 1e-2):
        w = fit.weights + size * rng.normal(size=len(fit.weights))
        g = options["functions"].features @ w
        if options["normalized"]:
            w = w / (q @ g) * q.sum()
            g = g / (q @ g) * q.sum()
        if (
            (g > 0).all()
            and (g >= options["lower"]).all()
            and (g <= options["upper"]).all()
        ):
            assert value(w, p, q, options) >= fit.dual_bound - 1e-12


def test_a_class_has_the_numbers_of_its_program():
    p = np.array([3.0, 1.0, 4.0, 2.0])
    q = np.array([2.0, 2.0, 1.0, 5.0])
    features = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0], [1.0, -1.0]])
    fit = oee.density_ratio(p, q, functions=Linear(features), ridge=0.1)
    w = fit.weights
    ps = p / 10
    qs = q / 10
    g = features @ w
    assert_allclose(fit.ratio, g, rtol=1e-9)
    assert_allclose(fit.objective, qs @ g - ps @ np.log(g) + 0.05 * w @ w, rtol=1e-9)
    assert_allclose(fit.dual_bound, fit.objective - fit.gap)
    assert_allclose(fit.divergence, ps @ np.log(g) - qs @ g + 1, rtol=1e-9)
    assert_allclose(
        features.T @ (qs * (1 + fit.normalizer) - ps / g) + 0.1 * w, 0, atol=1e-6
    )
    assert fit.details == {"feature_rank": 2}
    assert (fit.p_total, fit.q_total, fit.n_undetermined, fit.status) == (
        10.0,
        10.0,
        0,
        "optimal",
    )
    assert_array_equal(fit.enclosure, [np.zeros(4), np.full(4, np.inf)])
    kernel = oee.density_ratio(p, q, functions=Kernel([0.0, 0.1, 0.2, 0.4]), ridge=0.1)
    assert set(kernel.details) == {"kernel_residual", "centers"}
    size = np.std([0.0, 0.1, 0.2, 0.4])
    gram = np.exp(
        -((np.subtract.outer([0.0, 0.1, 0.2, 0.4], [0.0, 0.1, 0.2, 0.4]) / size) ** 2)
        / 2
    )
    coefficients = np.linalg.solve(gram, kernel.ratio)
    assert_allclose(
        coefficients @ gram @ coefficients, kernel.weights @ kernel.weights, rtol=1e-6
    )


@pytest.mark.parametrize(
    "options",
    [{}, {"ridge": 0.01}, {"normalized": False, "upper": 5.0}, {"upper": 2.0}],
)
@pytest.mark.parametrize("kind", ["features", "kernel"])
def test_another_solver_has_the_same_minimum(options, kind):
    given = {
        "functions": Linear(QUADRATIC) if kind == "features" else Kernel(LINE),
        "lower": 0.01,
        **({"ridge": 1 / 300} if kind == "kernel" else {}),
        **options,
    }
    ours = oee.density_ratio(COUNTS, Q, **given)
    assert ours.gap < 1e-10
    assert ours.status == "optimal"
    assert_array_equal(
        oee.density_ratio(COUNTS, Q, solver="CLARABEL", **given).ratio, ours.ratio
    )
    if kind == "kernel":  # too hard for SCS
        return
    theirs = oee.density_ratio(COUNTS, Q, solver="SCS", **given)
    assert ours.objective - theirs.gap - 1e-10 <= theirs.objective
    assert_allclose(theirs.objective, ours.objective, atol=1e-4)


@settings(max_examples=20)
@given(rngs)
def test_one_feature_an_entry_is_the_table(rng):
    n = int(rng.integers(2, 12))
    p = rng.integers(1, 9, n)
    q = rng.integers(1, 9, n)
    for options in (
        {},
        {"lower": 0.5, "upper": 1.6},
        {"normalized": False, "lower": 0.2},
    ):
        table = oee.density_ratio(p, q, **options)
        fit = oee.density_ratio(p, q, functions=Linear(np.eye(n)), **options)
        assert_allclose(fit.objective, table.objective, atol=1e-10)
        assert_allclose(fit.ratio, table.ratio, rtol=1e-5)
        assert_allclose(fit.divergence, table.divergence, atol=1e-8)
    # the paper's penalty, sum g^2, is |w|^2 here
    options = {"ridge": 0.3, "normalized": False}
    fits = (
        oee.density_ratio(p, q, functions=Linear(np.eye(n)), **options),
        oee.density_ratio(p, q, **options),
    )
    assert_allclose(fits[0].ratio, fits[1].ratio, atol=1e-5)
    bounded = oee.density_ratio(
        [1, 2, 5], [4, 3, 1], functions=Linear(np.eye(3)), lower=2.0, normalized=False
    )
    assert_allclose(bounded.ratio, [2.0, 2.0, 5.0], rtol=1e-6)


def test_a_kernel_that_separates_all_points_is_the_table():
    identity = oee.density_ratio(
        COUNTS, Q, functions=Kernel(LINE, lambda x, c: 1.0 * (x == c.T)), ridge=0.2
    )
    assert_allclose(
        identity.ratio,
        oee.density_ratio(COUNTS, Q, functions=Linear(np.eye(40)), ridge=0.2).ratio,
        atol=1e-8,
    )


def test_collinear_features_are_solved_with_a_warning():
    doubled = np.column_stack([QUADRATIC, QUADRATIC[:, 1] * 2])
    with pytest.warns(
        UserWarning,
        match="features should be linearly independent; they have rank 3 of 4",
    ):
        twice = oee.density_ratio(COUNTS, Q, functions=Linear(doubled), lower=0.01)
    assert_allclose(
        twice.ratio,
        oee.density_ratio(COUNTS, Q, functions=Linear(QUADRATIC), lower=0.01).ratio,
        atol=1e-7,
    )
    assert twice.details["feature_rank"] == 3
    # the smallest w: in proportion to the columns
    assert_allclose(twice.weights[3], 2 * twice.weights[1])


@settings(max_examples=20)
@given(rngs)
def test_numbers_of_many_scales_end_with_a_status(rng):
    """Six decades of counts: the gap is small or the status says that it is not."""
    n = int(rng.integers(5, 40))
    p, q = (rng.integers(1, 4, n) * 10 ** rng.uniform(-3, 3, n) for _ in range(2))
    fit = oee.density_ratio(
        p,
        q,
        functions=Linear(np.column_stack([np.ones(n), rng.normal(size=n)])),
        lower=0.01,
        upper=100,
    )
    assert 0 <= fit.gap < 1e-6
    assert (fit.status == "optimal") == (fit.gap <= 1e-8)


SIMULATOR = oee.tasks.gridworld(5, 0.3)
TARGET = oee.tasks.gridworld(5, 0.1)
PLACES = np.column_stack(np.unravel_index(np.arange(25), (5, 5)))
LOG = oee.sample_transitions(TARGET, np.full((25, 4), 0.01), 3000, seed=1)
TRUTH = oee.true_ratio(TARGET, SIMULATOR).values.data


def test_a_class_that_holds_the_truth_finds_it():
    """With the target's own probabilities for counts and no ridge, zeta is exact."""
    zeta = oee.transition_ratio(
        TARGET.transitions * 1.0, SIMULATOR, method="linear", features=TRUTH, ridge=0.0
    )
    assert_allclose(zeta.values.data, TRUTH, atol=1e-6)


def test_the_points_that_a_kernel_of_transitions_gets():
    """Action, place and displacement of each of the simulator's moves."""
    asked = []

    def kernel(x, c):
        asked.append(x)
        return np.exp(-((x[:, None] - c[None]) ** 2).sum(axis=2))

    oee.transition_ratio(
        LOG, SIMULATOR, method="kernel", kernel=kernel, coordinates=PLACES, n_centers=5
    )
    points = next(x for x in asked if len(x) == SIMULATOR.transitions.nnz)
    rows = np.repeat(np.arange(100), np.diff(SIMULATOR.transitions.indptr))
    assert_array_equal(points[:, 0], rows % 4)
    assert_array_equal(points[:, 1:3], PLACES[rows // 4])
    assert_array_equal(
        points[:, 1:3] + points[:, 3:], PLACES[SIMULATOR.transitions.indices]
    )


def test_a_class_without_a_minimum():
    """q = 0 < p with neither ridge nor upper bound: the value falls for ever."""
    with pytest.raises(
        RuntimeError,
        match="unbounded, where q = 0 < p; give a ridge or a finite upper bound",
    ):
        oee.density_ratio([1, 2, 1], [1, 1, 0], functions=Linear(np.eye(3)))


def test_a_class_that_vanishes_where_p_does():
    assert_allclose(
        oee.density_ratio([0, 2, 1], [1, 1, 1], functions=Linear(np.arange(3.0))).ratio,
        [0.0, 1.0, 2.0],
        atol=1e-6,
    )
