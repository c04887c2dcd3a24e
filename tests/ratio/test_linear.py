"""Linear and kernel classes: the interior-point method, its certificate, Clarabel, Algorithm 1, and zeta in a class."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers import rngs
from hypothesis import assume, given, settings
from numpy.testing import assert_allclose, assert_array_equal
from ratio import problem
from scipy import optimize

import oee_tabular as oee
from oee_tabular.ratio import features, interior
from oee_tabular.ratio._sgd import project
from oee_tabular.ratio.interior import certificate
from oee_tabular.ratio.linear import implied_bound, move_points
from oee_tabular.ratio.statements import LinearProgram

LINE = np.linspace(-3.0, 3.0, 40)
Q = np.exp(-(LINE**2) / 2)
P = np.exp(-((LINE - 0.5) ** 2) / 1.28)
COUNTS = np.random.default_rng(0).multinomial(300, P / P.sum())
QUADRATIC = np.column_stack([np.ones(40), LINE, LINE**2])


def random_program(rng):
    n = int(rng.integers(4, 60))
    phi = np.column_stack([np.ones(n), rng.normal(size=(n, int(rng.integers(1, 6))))])
    p, q = rng.integers(0, 5, n) + 0.0, rng.integers(1, 5, n) + 0.0
    p[0] += 1
    p, q = p / p.sum(), q / q.sum()
    lower = float(rng.choice([0.0, 10 ** rng.uniform(-3, -0.5)]))
    upper = float(rng.choice([np.inf, 10 ** rng.uniform(0.3, 2)]))
    normalized = bool(rng.random() < 0.6)
    ceiling = np.full(n, np.inf)
    if normalized:
        ceiling = (1 - lower * (1 - q)) / q
    penalty = float(rng.choice([0.0, 10 ** rng.uniform(-4, 0)]))
    return LinearProgram(q, p, q, np.zeros(n), phi, penalty, lower, upper, normalized, ceiling)


@given(rngs)
def test_random_programs_are_solved_and_certified(rng):
    program = random_program(rng)
    found = interior.solve(program)
    assert found.gap < 1e-10
    assert found.violation < 1e-11
    assert found.iterations < 60
    assert_allclose(found.ratio, program.features @ found.weights, atol=1e-9)
    value = interior.objective(program, found.weights, found.ratio)
    # no feasible neighbour is better by more than the gap
    for _ in range(5):
        w = found.weights + 10 ** rng.uniform(-6, -1) * rng.normal(size=len(found.weights))
        g = program.features @ w
        if program.normalized:
            w, g = w / (program.q @ g), g / (program.q @ g)
        if (g > 0).all() and (g >= program.lower).all() and (g <= program.upper).all():
            assert interior.objective(program, w, g) >= value - found.gap - 1e-14


@given(rngs)
def test_the_certificate_bounds_every_feasible_point_with_any_multipliers(rng):
    """The gap that any v and eta (0 without the equality) give a feasible w is at least what w loses to the optimum."""
    program = random_program(rng)
    found = interior.solve(program)
    best = interior.objective(program, found.weights, found.ratio) - found.gap
    judged = program
    if program.penalty == 0:
        judged = LinearProgram(**{**program.__dict__, "features": interior.orthonormal(program.features)[0]})
    one = np.linalg.lstsq(program.features, np.ones(len(program.p)))[0]
    tie = found.tie + 1e-3 * rng.normal(size=len(found.tie)) * np.abs(found.tie)
    gap, violation = interior.certificate(
        judged, one, np.ones(len(program.p)), tie, found.eta + 1e-3 * program.normalized
    )
    assert violation < 1e-12
    assert gap >= interior.objective(program, one, np.ones(len(program.p))) - best - 1e-9 - found.gap


@pytest.mark.parametrize("options", [{}, {"ridge": 0.01}, {"normalized": False, "upper": 5.0}, {"upper": 2.0}])
@pytest.mark.parametrize("kind", ["features", "kernel"])
def test_against_clarabel(options, kind):
    given = {"features": QUADRATIC} if kind == "features" else {"kernel": "gaussian", "coordinates": LINE}
    given |= {"lower": 0.01, **({"ridge": 1 / 300} if kind == "kernel" else {}), **options}
    ours, theirs = (oee.density_ratio(COUNTS, Q, solver=solver, **given) for solver in ("dual", "CLARABEL"))
    assert ours.gap < 1e-13
    assert ours.status == "optimal"
    assert ours.objective <= theirs.objective + 1e-12
    # Clarabel's "optimal" may be 1e-8 off; a feasible g exceeds the best by sum p (u - ln(1 + u)) or more, u = g / best - 1
    assert theirs.gap < 1e-6
    u = theirs.ratio / ours.ratio - 1
    assert (COUNTS / COUNTS.sum()) @ (u - np.log1p(u)) <= theirs.gap + 1e-10
    assert_allclose(ours.ratio, theirs.ratio, atol=1e-3)


@given(rngs)
def test_one_feature_an_entry_is_the_table(rng):
    n = int(rng.integers(2, 12))
    p, q = rng.integers(1, 9, n), rng.integers(1, 9, n)
    for options in ({}, {"lower": 0.5, "upper": 1.6}, {"normalized": False, "lower": 0.2}):
        table = oee.density_ratio(p, q, **options)
        by_feature = oee.density_ratio(p, q, features=np.eye(n), **options)
        assert_allclose(by_feature.objective, table.objective, atol=1e-11)
        # a g whose value is within a gap of the best is that near it, weighted by p: p (u - ln(1 + u)), u its relative error
        u = by_feature.ratio / table.ratio - 1
        assert (p / p.sum()) @ (u - np.log1p(u)) <= by_feature.gap + 1e-13
        assert_allclose(by_feature.ratio, table.ratio, rtol=1e-5)
        assert_allclose(by_feature.divergence, table.divergence, atol=1e-9)
    ridge = oee.density_ratio(p, q, ridge=0.3, normalized=False)  # the paper's penalty, sum g^2, is |w|^2 here
    assert_allclose(
        oee.density_ratio(p, q, features=np.eye(n), ridge=0.3, normalized=False).ratio, ridge.ratio, atol=1e-6
    )


def test_a_kernel_is_its_gram_matrix():
    points = np.random.default_rng(0).normal(size=(30, 2))
    kernel = features.gaussian(0.7)
    made = features.kernel_features(points, kernel, n_centers=30)
    assert_allclose(made.matrix @ made.matrix.T, kernel(points, points), atol=1e-10)
    few = features.kernel_features(points, kernel, n_centers=5)
    left = kernel(points, points) - few.matrix @ few.matrix.T
    assert_allclose(np.diag(left).max(), few.residual, atol=1e-14)
    assert np.linalg.eigvalsh(left).min() > -1e-12
    identity = oee.density_ratio(COUNTS, Q, kernel=lambda x, c: 1.0 * (x == c.T), coordinates=LINE, ridge=0.2)
    assert_allclose(identity.ratio, oee.density_ratio(COUNTS, Q, features=np.eye(40), ridge=0.2).ratio, atol=1e-9)


def test_a_smooth_class_beats_the_table_on_a_smooth_ratio():
    truth = (P / P.sum()) / (Q / Q.sum())
    share = Q / Q.sum()
    table, line, kernel = (
        share @ np.abs(oee.density_ratio(COUNTS, Q, **options).ratio - truth)
        for options in ({}, {"features": QUADRATIC}, {"kernel": "gaussian", "coordinates": LINE, "ridge": 1 / 300})
    )
    assert kernel < 0.5 * table
    assert line < table


def test_collinear_features_are_solved_with_a_warning():
    doubled = np.column_stack([QUADRATIC, QUADRATIC[:, 1] * 2])
    with pytest.warns(UserWarning, match="features should be linearly independent; they have rank 3 of 4"):
        twice = oee.density_ratio(COUNTS, Q, features=doubled, lower=0.01)
    assert_allclose(twice.ratio, oee.density_ratio(COUNTS, Q, features=QUADRATIC, lower=0.01).ratio, atol=1e-7)
    assert twice.details["feature_rank"] == 3
    assert_allclose(twice.weights[3], 2 * twice.weights[1])  # the smallest w: in proportion to the columns


def test_algorithm_1_on_features():
    box = {"lower": 0.05, "upper": 5.0, "normalized": False, "features": QUADRATIC}
    exact = oee.density_ratio(COUNTS, Q, **box)
    options = {"solver": "sgd", "step_size": 0.02, "n_iterations": 4000, "seed": 0}
    fit, again = (oee.density_ratio(COUNTS, Q, **box, **options) for _ in range(2))
    assert_array_equal(fit.ratio, again.ratio)
    assert fit.trace.excess[-1] < 0.01 * fit.trace.excess[0]
    assert (fit.trace.excess > -1e-9).all()
    assert_allclose(fit.gap, fit.objective - exact.objective, atol=1e-12)
    assert fit.ratio.min() >= 0.05
    assert fit.ratio.max() <= 5.0


@given(rngs)
def test_the_projection_is_the_nearest_point(rng):
    """No point of the polytope that scipy finds is nearer."""
    n, d = int(rng.integers(2, 15)), int(rng.integers(1, 4))
    phi = np.column_stack([np.ones(n), rng.normal(size=(n, d))])
    start = rng.normal(size=d + 1) * 3
    w = start.copy()
    project(w, phi, (phi**2).sum(axis=1), 0.5, 2.0)
    g = phi @ w
    outside = max(0.5 - g.min(), g.max() - 2.0)
    assert outside < 1e-3  # the sweeps are capped: nearly parallel constraints converge slowly (rng 921398: 6e-5)
    assume(outside < 1e-9)
    walls = [
        {"type": "ineq", "fun": lambda v: phi @ v - 0.5, "jac": lambda v: phi},
        {"type": "ineq", "fun": lambda v: 2.0 - phi @ v, "jac": lambda v: -phi},
    ]
    inside = np.eye(d + 1)[0]
    best = optimize.minimize(
        lambda v: ((v - start) ** 2).sum(), inside, jac=lambda v: 2 * (v - start), constraints=walls, method="SLSQP"
    )
    assume(best.success and (phi @ best.x).min() > 0.5 - 1e-9 and (phi @ best.x).max() < 2.0 + 1e-9)
    assert ((w - start) ** 2).sum() <= best.fun + 1e-4 * (1.0 + best.fun)


SIMULATOR, TARGET = oee.tasks.gridworld(5, 0.3), oee.tasks.gridworld(5, 0.1)
PLACES = np.column_stack(np.unravel_index(np.arange(25), (5, 5)))
LOG = oee.sample_transitions(TARGET, np.full((25, 4), 0.01), 3000, seed=1)
TRUTH = oee.true_ratio(TARGET, SIMULATOR).values.data


@pytest.mark.parametrize(
    "options",
    [
        {"method": "linear", "features": np.log(SIMULATOR.transitions.data)},
        {"method": "linear", "features": oee.ratio.action_displacement(SIMULATOR, PLACES), "lower": 0.1, "upper": 3.0},
        {"method": "kernel", "coordinates": PLACES},
        {"method": "kernel", "coordinates": PLACES, "bandwidth": 2.0, "n_centers": 50, "ridge": lambda n: 2 / n},
    ],
    ids=["log P", "displacements, box", "kernel", "kernel, few centres"],
)
def test_zeta_in_a_class(options):
    zeta, theirs = (oee.transition_ratio(LOG, SIMULATOR, solver=solver, **options) for solver in ("dual", "CLARABEL"))
    assert zeta.row_sum_error < 1e-12
    assert zeta.gap < 1e-12
    assert theirs.gap < 1e-8
    assert_allclose(zeta.values.data, theirs.values.data, atol=1e-4)  # a gap of 1e-8 leaves as much as its root
    error, likelihood = (
        np.abs(z.values.data - TRUTH).mean() for z in (zeta, oee.transition_ratio(LOG, SIMULATOR, prior="none"))
    )
    assert error < likelihood
    assert zeta.values.data.min() >= options.get("lower", 0.0)
    assert zeta.values.data.max() <= options.get("upper", np.inf)
    assert zeta.target_model(SIMULATOR).n_states == 25


def test_a_class_that_holds_the_truth_finds_it():
    """With the target's own probabilities for counts and no ridge, zeta is exact."""
    exact_counts = TARGET.transitions * 1.0
    zeta = oee.transition_ratio(exact_counts, SIMULATOR, method="linear", features=TRUTH, ridge=0.0)
    assert_allclose(zeta.values.data, TRUTH, atol=1e-6)


def test_the_standard_error_in_a_class_is_the_delta_methods():
    """sqrt(sum_rows n Var(psi)), psi = d value / d (one more observation), by finite differences of refits."""
    options = {"method": "linear", "features": oee.ratio.action_displacement(SIMULATOR, PLACES)}
    zeta = oee.transition_ratio(LOG, SIMULATOR, **options, ridge=1 / 3000)
    gradient = np.random.default_rng(0).normal(size=len(TRUTH))
    counts = LOG.counts(25, 4)
    rows = np.repeat(np.arange(100), np.diff(SIMULATOR.transitions.indptr))
    observed = np.asarray(counts[rows, SIMULATOR.transitions.indices]).reshape(-1)
    seen = np.flatnonzero(observed)[::7]
    (part,) = zeta._influence.parts
    scores = part.at(part.whole)[1]
    pulled = (SIMULATOR.transitions.data * zeta.values.data * gradient) @ scores
    psi = scores @ np.linalg.solve(part.information, pulled)
    for entry in seen:
        values = []
        for change in (0.05, -0.05):
            moved = observed.copy()
            moved[entry] += change
            total = moved.sum()
            other = type(counts)(
                (moved, SIMULATOR.transitions.indices, SIMULATOR.transitions.indptr), shape=counts.shape
            )
            fit = oee.transition_ratio(other, SIMULATOR, **options, ridge=1 / total)
            values.append(gradient @ (SIMULATOR.transitions.data * fit.values.data))
        assert_allclose((values[0] - values[1]) / 0.1, psi[entry], rtol=1e-4, atol=1e-7)
    error = zeta.log_standard_error(gradient)
    frequency = observed / np.bincount(rows, observed)[rows]
    mean = np.bincount(rows, frequency * psi)[rows]
    assert_allclose(error, np.sqrt(np.sum(observed * (psi - mean) ** 2)), rtol=1e-9)


def test_points_of_moves():
    points = move_points(SIMULATOR, PLACES)
    assert points.shape == (SIMULATOR.transitions.nnz, 5)
    rows = np.repeat(np.arange(100), np.diff(SIMULATOR.transitions.indptr))
    assert_array_equal(points[:, 0], rows % 4)
    assert_array_equal(points[:, 1:3] + points[:, 3:], PLACES[SIMULATOR.transitions.indices])


def density(**options):
    return lambda: oee.density_ratio([3, 1, 2], [1, 1, 1], **options)


def zeta(**options):
    return lambda: oee.transition_ratio(LOG, SIMULATOR, **options)


BAD = {
    "too few features": (density(features=[1, 2]), r"features must have 3 rows, one for each entry of p; .* \(2,\)"),
    "nan features": (density(features=[1, np.nan, 2]), r"features\[1\] must be finite; it is nan"),
    "no function in the class": (
        density(features=[1, -1, 1]),
        r"features must span a function that is at least 0, with sum q g = 1; the nearest misses by .* \(a constant feature",
    ),
    "two classes": (density(features=[1, 1, 1], kernel="gaussian"), "kernel must not be given with features"),
    "a kernel without points": (density(kernel="gaussian"), "coordinates must be given with kernel"),
    "points without a kernel": (density(coordinates=[1, 2, 3]), "coordinates must be given with a kernel"),
    "too few points": (density(kernel="gaussian", coordinates=[1, 2]), "coordinates must have 3 rows, .* they have 2"),
    "an unknown kernel": (density(kernel="rbf", coordinates=[1, 2, 3]), "kernel must be one of 'gaussian'; got 'rbf'"),
    "a kernel of the wrong shape": (
        density(kernel=lambda x, c: np.ones(3), coordinates=[1, 2, 3]),
        r"kernel must have 2 dimension\(s\); it has shape \(3,\)",
    ),
    "an indefinite kernel": (
        density(kernel=lambda x, c: 1.0 - 3.0 * (x != c.T), coordinates=[1, 2, 3]),
        "kernel must be symmetric and positive semidefinite; given the points",
    ),
    "a negative kernel": (
        density(kernel=lambda x, c: -np.ones((len(x), len(c))), coordinates=[1, 2, 3]),
        "kernel must be positive semidefinite; k.x, x. is -1 at point 0",
    ),
    "a kernel that is 0": (
        density(kernel=lambda x, c: np.zeros((len(x), len(c))), coordinates=[1, 2, 3]),
        "kernel must not be 0 at every point",
    ),
    "toward with features": (density(features=[1, 1, 1], toward=1.0), "toward and loss must be left out with features"),
    "a thin box": (density(features=[1, 1, 1], lower=1.0), r"the box of a linear class must have lower < 1 < upper"),
    "no features": (zeta(method="linear"), 'features must be given with method "linear"'),
    "no coordinates": (zeta(method="kernel"), 'coordinates must be given with method "kernel"'),
    "coordinates of another size": (
        zeta(method="kernel", coordinates=[1, 2]),
        "coordinates must have 25 rows, one a state; they have 2",
    ),
    "a bandwidth of 0": (zeta(method="kernel", coordinates=PLACES, bandwidth=0), r"bandwidth must be in \(0, inf\)"),
    "a kernel where it has no use": (zeta(kernel="gaussian"), "kernel must not be given with method 'conditional'"),
    "a word for the ridge": (
        zeta(method="linear", features=TRUTH, ridge="evidence"),
        "ridge must be a number or a function of n with method 'linear'; got 'evidence'",
    ),
    "prior with a class": (zeta(method="linear", features=TRUTH, prior="tilt"), "prior must not be given with method"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_calls(name):
    call, text = BAD[name]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(ValueError, match=text):
            call()


def of_many_scales(rng):
    """Six decades of counts."""
    n = int(rng.integers(5, 40))
    p, q = rng.integers(1, 4, n) * 10 ** rng.uniform(-3, 3, n), rng.integers(1, 4, n) * 10 ** rng.uniform(-3, 3, n)
    return oee.density_ratio(p, q, features=np.column_stack([np.ones(n), rng.normal(size=n)]), lower=0.01, upper=100)


@settings(max_examples=20)
@given(rngs)
def test_numbers_of_many_scales_end_with_a_status(rng):
    """The gap is small or the status says that it is not."""
    fit = of_many_scales(rng)
    assert fit.gap >= 0
    assert (fit.status == "optimal") == (fit.gap <= 1e-8)
    assert fit.gap < 1e-4


@pytest.mark.parametrize("seed", [233, 312, 563, 3248])
def test_a_ratio_that_falls_by_decades_holds_no_step_up(seed):
    """With p / g in the conditions, rather than a multiplier z with z g = p, these stopped at gaps of .2 to .6."""
    assert of_many_scales(np.random.default_rng(seed)).gap <= 1e-8


def test_bounds_that_the_sum_implies():
    assert_allclose(implied_bound(np.array([0.25, 0.75, 0.0]), 0.2), [(1 - 0.15) / 0.25, (1 - 0.05) / 0.75, np.inf])


def test_points_of_moves_are_action_place_and_displacement():
    points = move_points(problem.SIMULATOR, problem.PLACES)
    expected = [
        (a, problem.PLACES[s], problem.PLACES[j] - problem.PLACES[s])
        for s in range(3)
        for a in range(2)
        for j in range(3)
    ]
    assert_array_equal(points, expected)


def test_a_class_has_the_numbers_of_its_program():
    p, q = np.array([3.0, 1.0, 4.0, 2.0]), np.array([2.0, 2.0, 1.0, 5.0])
    features = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0], [1.0, -1.0]])
    found = oee.density_ratio(p, q, features=features, ridge=0.1)
    w, ps, qs = found.weights, p / 10, q / 10
    g = features @ w
    assert_allclose(found.ratio, g, rtol=1e-9)
    assert_allclose(found.objective, qs @ g - ps @ np.log(g) + 0.05 * w @ w, rtol=1e-9)
    assert_allclose(found.dual_bound, found.objective - found.gap)
    assert_allclose(found.divergence, ps @ np.log(g) - qs @ g + 1, rtol=1e-9)
    assert found.details == {"feature_rank": 2}
    slope = features.T @ (qs * (1 + found.normalizer) - ps / g) + 0.1 * w
    assert_allclose(slope, 0, atol=1e-6)
    assert (found.p_total, found.q_total, found.n_undetermined, found.status) == (10.0, 10.0, 0, "optimal")
    assert_array_equal(found.enclosure[0], np.zeros(4))
    assert_array_equal(found.enclosure[1], np.full(4, np.inf))
    kernel = oee.density_ratio(p, q, kernel="gaussian", coordinates=[0.0, 0.1, 0.2, 0.4], ridge=0.1)
    assert set(kernel.details) == {"kernel_residual", "centers"}
    size = np.std([0.0, 0.1, 0.2, 0.4])
    gram = np.exp(-((np.subtract.outer([0.0, 0.1, 0.2, 0.4], [0.0, 0.1, 0.2, 0.4]) / size) ** 2) / 2)
    coefficients = np.linalg.solve(gram, kernel.ratio)
    assert_allclose(coefficients @ gram @ coefficients, kernel.weights @ kernel.weights, rtol=1e-6)


def test_a_class_above_one_without_an_upper_bound():
    """One feature an entry, 2 <= g: max(p/q, 2)."""
    p, q = np.array([1.0, 2.0, 5.0]), np.array([4.0, 3.0, 1.0])
    found = oee.density_ratio(p, q, features=np.eye(3), lower=2.0, normalized=False)
    assert_allclose(found.ratio, np.maximum((p / 8) / (q / 8), 2.0), rtol=1e-6)
    assert found.status == "optimal"


def test_how_far_a_point_is_from_its_constraints():
    """Below, above, off the sum, and 0 inside."""
    q = np.array([0.5, 0.5])
    program = LinearProgram(
        b=q, p=q, q=q, offset=np.zeros(2), features=np.eye(2), penalty=0.1, lower=0.5, upper=2.0, normalized=True,
        ceiling=np.full(2, np.inf),
    )  # fmt: skip
    for g, miss in (([1.2, 0.8], 0.0), ([1.75, 0.25], 0.25), ([2.5, 2.5], 1.5), ([0.6, 0.6], 0.4)):
        violation = certificate(program, np.array(g), np.array(g), np.zeros(2), 0.0)[1]
        assert_allclose(violation, miss, atol=1e-15)
    free = replace(program, normalized=False)
    for g, miss in (([0.6, 0.6], 0.0), ([2.5, 1.0], 0.5), ([0.25, 1.0], 0.25)):
        assert_allclose(certificate(free, np.array(g), np.array(g), np.zeros(2), 0.0)[1], miss, atol=1e-15)
