"""What mutation testing showed the other tests of ``ratio`` to leave open: each test is named after what it pins."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from helpers import dense
from numpy.testing import assert_allclose, assert_array_equal
from oee_tabular.ratio.box import check_box, check_ridge
from scipy import sparse
from scipy.special import gammaln

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions, exact
from oee_tabular.ratio import Sgd, density_ratio_samples
from oee_tabular.ratio.assumptions import check_assumptions
from oee_tabular.ratio.features import gaussian, kernel_features, rank_of
from oee_tabular.ratio.interior import certificate
from oee_tabular.ratio.linear import implied_bound, move_points
from oee_tabular.ratio.method import Given
from oee_tabular.ratio.prior.strength import StrengthChoice, _weighted_median, choose_strength, kinds_of_rows, meaning
from oee_tabular.ratio.prior.tilt import action_displacement, feature_array, fit_tilt
from oee_tabular.ratio.quotient import estimated_behavior, simulator_weights
from oee_tabular.ratio.statements import LinearProgram
from oee_tabular.ratio.support import refuse_unsupported

POLICY = np.array([[0.3, 0.7], [0.6, 0.4], [0.8, 0.2]])


def environments():
    rng = np.random.default_rng(0)
    rows = rng.dirichlet(np.full(3, 3.0), (3, 2))
    simulator = FiniteMDP(rows, rng.normal(size=(3, 2)), [0.5, 0.3, 0.2], 0.8)
    return simulator, simulator.with_transitions(0.6 * rows + 0.4 * rng.dirichlet(np.ones(3), (3, 2)))


SIMULATOR, TARGET = environments()
PLACES = np.array([0.0, 1.0, 3.0])
LOG = oee.sample_episodes(TARGET, POLICY, 20, 8, seed=0)
COUNTS = np.array([[4, 3, 1], [0, 2, 5], [6, 1, 1], [3, 3, 3], [0, 0, 0], [2, 0, 9]], dtype=float)
FEATURES = np.stack([np.arange(18.0) % 5, (np.arange(18.0) * 7) % 4], axis=1)


def fit(counts=COUNTS, **options):
    return oee.transition_ratio(sparse.csr_array(counts), SIMULATOR, **options)


# ---- what a fit says ---------------------------------------------------------------------------------------------

CHOSEN = {"strength", "strength_by", "strength_score", "strength_curve", "strength_kinds", "meaning"}
TILTED = {"theta", "tilt_gap", "feature_rank", "smoothness"}
ROWS = {"prior", "lower", "upper", "enclosure"}
BETAS = {"lower", "upper"}
DETAILS = {
    "the default": ({}, CHOSEN | TILTED | ROWS | {"centre"}),
    "the tilt": ({"prior": "tilt"}, CHOSEN | TILTED | ROWS),
    "the simulator": ({"prior": "simulator"}, CHOSEN | ROWS),
    "a strength": ({"prior": "simulator", "strength": 2.0}, {"strength"} | ROWS),
    "no prior": ({"prior": "none"}, {"strength"} | ROWS),
    "a chosen ridge": ({"prior": "none", "ridge": "loo"}, {"strength", "ridge_times_count", "ridge_by"} | ROWS),
    "another solver": ({"prior": "none", "solver": "CLARABEL"}, {"strength"} | (ROWS - {"enclosure"})),
    "linear": ({"method": "linear", "features": FEATURES}, {"feature_rank", "weights", "ridge"} | BETAS),
    "kernel": (
        {"method": "kernel", "coordinates": PLACES},
        {"kernel_residual", "centers", "weights", "ridge"} | BETAS,
    ),
    "quotient": (
        {"method": "ratio_of_ratios", "simulator_data": "exact"},
        {"undetermined_moves", "share_at_the_box", "moves_only_in_log", "divergence_moves", "divergence_pairs", "beta"}
        | BETAS,
    ),
    "joint": (
        {"method": "joint", "simulator_data": "exact"},
        {"ratio_lower", "ratio_upper", "moves", "pairs", "pairs_without_simulator_data"} | BETAS,
    ),
}


@pytest.mark.parametrize("name", DETAILS)
def test_the_words_in_the_details(name):
    options, keys = DETAILS[name]
    found = fit(**options)
    assert set(found.details) == keys
    assert found.method == {"quotient": "ratio_of_ratios"}.get(name, options.get("method", "conditional"))
    assert 0 <= found.gap < 1e-7
    assert_array_equal(found.counts, COUNTS.sum(axis=1).reshape(3, 2))
    assert_array_equal(found.visited, found.counts > 0)
    sums = (found.values.toarray() * SIMULATOR.transitions.toarray()).sum(axis=1)
    assert_allclose(found.row_sum_error, np.abs(sums - 1).max(), atol=1e-15)
    if "prior" in keys:
        assert found.details["prior"] == options.get("prior", "average")
    if "enclosure" in keys:
        below, above = found.details["enclosure"]
        assert (below <= found.values.data + 1e-12).all()
        assert (found.values.data <= above + 1e-12).all()
        assert_allclose(below, above, rtol=1e-9)
    box = (0.01, 10.0) if name in ("quotient", "joint") else (0.0, np.inf)
    assert (found.details["lower"], found.details["upper"]) == box
    if name == "joint":
        assert (found.details["ratio_lower"], found.details["ratio_upper"]) == (0.0, np.inf)
        quotient = found.details["moves"] / np.repeat(found.details["pairs"], 3)
        assert_allclose(quotient, found.values.data, rtol=1e-12)
    assert np.isfinite(found.values.data).all()


def test_a_ratio_in_one_line():
    values = sparse.csr_array(np.array([[0.5, 1.25]]))
    ratio = oee.TransitionRatio(values, "given", 2e-9, np.array([[True]]), 3e-4, np.array([[7.0]]))
    assert repr(ratio) == (
        "TransitionRatio(given: 2 values from 0.5 to 1.25, 1 of 1 (s, a) visited, gap 2.0e-09, row-sum error 3.0e-04)"
    )
    assert ratio.details == {}
    assert ratio.log_standard_error(np.ones(2)) is None
    assert ratio.one_step(np.ones(2)) is None


def test_models_of_rows_that_do_not_sum_to_one():
    true = oee.true_ratio(TARGET, SIMULATOR)
    twice = oee.TransitionRatio(true.values * 2.0, "twice", 0.0, true.visited, 1.0, true.counts)
    text = r"^rows of zeta \* P must sum to 1; they sum to 2 to 2 \(method 'twice' does not make them; normalize=True divides"
    with pytest.raises(ValueError, match=text):
        twice.target_model(SIMULATOR)
    made = twice.target_model(SIMULATOR, normalize=True)
    assert_allclose(made.transitions.toarray(), TARGET.transitions.toarray(), rtol=1e-12)
    assert_allclose(true.target_model(SIMULATOR).transitions.toarray(), TARGET.transitions.toarray(), rtol=1e-12)


# ---- the conditional ratio ---------------------------------------------------------------------------------------

FITS = {
    "none": {"prior": "none"},
    "simulator": {"prior": "simulator", "strength": 3.0},
    "tilt": {"prior": "tilt", "strength": 3.0},
    "tilt of features": {"prior": "tilt", "strength": 3.0, "features": FEATURES},
    "ridge": {"prior": "simulator", "strength": 1.0, "ridge": 0.3},
    "the paper's ridge": {"prior": "simulator", "strength": 1.0, "ridge": 0.3, "toward": None},
    "box": {"prior": "simulator", "strength": 1.0, "lower": 0.7, "upper": 1.6},
    "linear": {"method": "linear", "features": FEATURES, "ridge": 0.01},
    "kernel": {"method": "kernel", "coordinates": PLACES, "ridge": 0.01},
}


@pytest.mark.parametrize("name", FITS)
def test_the_standard_error_by_refits(name):
    """sqrt(sum over rows of n Var(d value / d one more move)), the derivatives by central differences of refits."""
    counts = COUNTS + np.where(COUNTS.sum(axis=1, keepdims=True) > 0, 0.5, 0.0)  # no zeros in rows that have moves
    options, step = FITS[name], 1e-4
    gradient = np.random.default_rng(1).normal(size=18)
    p = SIMULATOR.transitions.data

    def value(moved):
        return gradient @ (fit(moved, **options).values.data * p)

    slopes = np.zeros((6, 3))
    for x in np.argwhere(counts > 0):
        unit = np.zeros((6, 3))
        unit[tuple(x)] = step
        slopes[tuple(x)] = (value(counts + unit) - value(counts - unit)) / (2 * step)
    n = counts.sum(axis=1)
    shares = counts / np.maximum(n, 1)[:, None]
    spread = (shares * (slopes - (shares * slopes).sum(axis=1, keepdims=True)) ** 2).sum(axis=1)
    expected = np.sqrt((n * spread).sum())
    fixed = options.get("strength") is not None or options["prior"] == "none" if "prior" in options else True
    assert fixed
    assert_allclose(fit(counts, **options).log_standard_error(gradient), expected, rtol=2e-4)


def test_the_one_step_correction_row_by_row():
    found = fit(prior="simulator", strength=4.0)
    gradient = np.random.default_rng(1).normal(size=18)
    step = found.one_step(gradient)
    g, kernel = gradient.reshape(6, 3), (found.values.data * SIMULATOR.transitions.data).reshape(6, 3)
    change = variance = own = 0.0
    for x in np.flatnonzero(COUNTS.sum(axis=1)):
        n = COUNTS[x].sum()
        frequency = COUNTS[x] / n
        change += g[x] @ (frequency - kernel[x])
        spread = kernel[x] @ (g[x] - kernel[x] @ g[x]) ** 2
        variance += spread / n
        own += (4.0 / (n + 4.0)) ** 2 * spread / n
    unseen = kernel[4] @ (g[4] - kernel[4] @ g[4]) ** 2
    assert_allclose(step.change, change, rtol=1e-12)
    assert_allclose(step.standard_error, np.sqrt(variance), rtol=1e-12)
    assert_allclose(step.change_error, np.sqrt(own), rtol=1e-12)
    assert_allclose(step.unseen, np.sqrt(unseen), rtol=1e-12)


def test_the_tilt_s_prior_row_and_strength():
    """(n + kappa m) / (n_sa + kappa) over P, m the tilt's row; the tilt's row alone where the log has none."""
    tilt = fit_tilt(COUNTS.reshape(-1), SIMULATOR)
    base = tilt.ratio.reshape(6, 3) * SIMULATOR.transitions.toarray()
    found = fit(prior="tilt", strength=5.0)
    expected = (COUNTS + 5.0 * base) / (COUNTS.sum(axis=1, keepdims=True) + 5.0)
    assert_allclose(found.values.toarray() * SIMULATOR.transitions.toarray(), expected, rtol=1e-10)
    bare = fit(prior="tilt", strength=0.0)
    assert_allclose(bare.values.toarray()[4] * SIMULATOR.transitions.toarray()[4], base[4], rtol=1e-10)
    assert_allclose(found.details["theta"], tilt.theta)
    assert found.details["feature_rank"] == 1
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


@pytest.mark.parametrize("method", ["ratio_of_ratios", "joint"])
def test_the_ridge_reaches_both_betas(method):
    """A strong ridge towards 1 (the quotient) or 0 with the sums kept (joint) makes zeta nearly 1."""
    options = {"method": method, "simulator_data": "exact", "behavior_policy": POLICY}
    free, bent = (fit(COUNTS + 1.0, ridge=ridge, **options).values.data for ridge in (None, 1e4))
    assert np.abs(free - 1).max() > 0.3
    assert np.abs(bent - 1).max() < 0.1
    assert_array_equal(free, fit(COUNTS + 1.0, ridge=0.0, **options).values.data)
    of_n, given_number = (fit(COUNTS + 1.0, ridge=r, **options).values.data for r in (lambda n: 5.0 / n, 5.0 / 61.0))
    assert_allclose(of_n, given_number, rtol=1e-12)


# ---- the strength of the prior -----------------------------------------------------------------------------------


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

    found = choose_strength(observed.reshape(-1), base, base, indptr, criterion)
    fine = np.exp(np.linspace(0, np.log(1e4), 20_001))
    scores = np.array([score(k) for k in fine])
    assert found.criterion == criterion
    assert_allclose(found.strength, fine[scores.argmax()], rtol=0.02)
    assert_allclose(found.score, scores.max(), rtol=1e-7)
    assert_array_equal(found.by_row, np.full(rows, found.strength))
    assert_allclose((found.grid[0], found.grid[-1], len(found.grid)), (1.0, 1e8, 41))
    assert_allclose(found.curve, [score(k) for k in found.grid], rtol=1e-9)
    assert found.kinds == [(rows, 60 * rows, found.strength)]


def test_kinds_of_rows():
    """The same probabilities in any order are one kind; kinds with few rows or few moves are pooled."""
    rows = [[0.5, 0.3, 0.2]] * 3 + [[0.2, 0.5, 0.3]] * 3 + [[0.6, 0.2, 0.2]] * 5 + [[0.1, 0.1, 0.8]] * 4
    weights, indptr = np.array(rows).reshape(-1), np.arange(16) * 3
    enough = np.full(45, 10.0)
    kinds = kinds_of_rows(weights, enough, indptr)
    assert len(set(kinds[:6])) == 1
    assert len(set(kinds[6:11])) == 1
    assert (kinds[11:] == 0).all()
    assert len({kinds[0], kinds[6], 0}) == 3
    thin = enough.copy()
    thin[18:33] = 100.0 / 15  # 100 moves in five rows: enough
    assert kinds_of_rows(weights, thin, indptr)[6] != 0
    thin[18] -= 1.0
    assert kinds_of_rows(weights, thin, indptr)[6] == 0
    four = enough.copy()
    four[18:21] = 0.0  # one of the five rows never visited
    assert kinds_of_rows(weights, four, indptr)[6] == 0


def test_a_kind_that_was_never_visited_is_pooled():
    weights = np.array([[0.5, 0.5]] * 5 + [[0.7, 0.3]] * 2).reshape(-1)
    observed = np.array([[20.0, 20.0]] * 5 + [[0.0, 0.0]] * 2).reshape(-1)
    assert_array_equal(kinds_of_rows(weights, observed, np.arange(8) * 2), [1] * 5 + [0] * 2)


def test_the_median_move():
    """The value of the row that holds the middle one of all moves; without moves the largest."""
    values = np.array([3.0, 1.0, 2.0])
    assert _weighted_median(values, np.array([1.0, 1.0, 1.0])) == 2.0
    assert _weighted_median(values, np.array([5.0, 1.0, 1.0])) == 3.0
    assert _weighted_median(values, np.array([0.0, 1.0, 0.0])) == 1.0
    assert _weighted_median(values, np.zeros(3)) == 3.0
    assert _weighted_median(values[:1], np.ones(1)) == 3.0


def test_what_the_strength_means():
    n_row = np.array([0.0, 10.0, 20.0, 30.0])
    flat, curve = np.zeros(3), np.array([0.0, 5.0, 0.0])

    def words(strength, kinds=((3, 60, 500.0),), curve=curve):
        return meaning(StrengthChoice(n_row, strength, 0.0, "loo", flat, curve, list(kinds)), n_row, "tilt")

    compared = "a row of it is worth {} moves, and the log has 20 in the median row"
    assert words(300.0) == "the tilt fits: " + compared.format(300)
    assert words(299.0) == "the tilt fits roughly: " + compared.format(299)
    assert words(50.0) == "the tilt fits roughly: " + compared.format(50)
    assert words(49.0) == "the tilt does not fit: " + compared.format(49)
    parts = [(3, 60, 500.0), (2, 40, 49.0)]
    assert words(300.0, parts) == "the tilt fits: " + compared.format(300) + "; but not in 2 of 5 rows"
    whole = compared.replace("{} moves", "any number of moves")
    assert words(1e8) == "the tilt fits: " + whole
    assert words(9.9e5) == "the tilt fits: " + compared.format("9.9e+05")
    assert words(300.0, curve=flat + 0.5) == (
        "too few moves to tell whether the tilt fits (20 in the median row that has some)"
    )


# ---- tilts and features ------------------------------------------------------------------------------------------


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


def test_the_tilt_at_its_optimum():
    """The penalised score is 0: expected less observed features plus theta, in standard units."""
    tilt = fit_tilt(COUNTS.reshape(-1), SIMULATOR, FEATURES)
    p, n = SIMULATOR.transitions.toarray(), COUNTS.sum(axis=1)
    phi = FEATURES.reshape(6, 3, 2)
    phi = phi - (p[:, :, None] * phi).sum(axis=1, keepdims=True)
    scale = np.sqrt(np.einsum("xj,xjd->d", p, phi**2) / 6)
    raw = p * np.exp(phi @ tilt.theta)
    model = raw / raw.sum(axis=1, keepdims=True)
    assert_allclose(tilt.ratio.reshape(6, 3), model / p, rtol=1e-9)
    score = np.einsum("x,xj,xjd->d", n, model, phi / scale) - np.einsum("xj,xjd->d", COUNTS, phi / scale)
    assert_allclose(score + tilt.theta * scale, 0, atol=1e-6)
    centred = phi / scale - (model[:, :, None] * phi / scale).sum(axis=1, keepdims=True)
    assert_allclose(tilt.scores, centred.reshape(18, 2), atol=1e-9)
    information = np.einsum("x,xj,xjd,xje->de", n, model, centred, centred) + np.eye(2)
    assert_allclose(tilt.information, information, rtol=1e-8)
    assert tilt.rank == 2
    assert tilt.gap < 1e-12
    other = fit_tilt(COUNTS.reshape(-1), SIMULATOR, FEATURES, solver="CLARABEL")
    assert_allclose(other.theta, tilt.theta, rtol=1e-3, atol=1e-4)


def test_the_gap_of_a_tilt_that_is_not_the_best(monkeypatch):
    """|gradient|^2 / 2 over the number of moves, here at theta = 0: expected less observed features."""
    monkeypatch.setattr(statements, "solve_tilt", lambda program, solver: np.zeros(2))
    tilt = fit_tilt(COUNTS.reshape(-1), SIMULATOR, FEATURES, solver="CLARABEL")
    p, phi = SIMULATOR.transitions.toarray(), FEATURES.reshape(6, 3, 2)
    phi = phi - (p[:, :, None] * phi).sum(axis=1, keepdims=True)
    phi = phi / np.sqrt(np.einsum("xj,xjd->d", p, phi**2) / 6)
    gradient = -np.einsum("xj,xjd->d", COUNTS, phi)
    assert_allclose(tilt.gap, 0.5 * gradient @ gradient / 43, rtol=1e-9)
    assert_allclose(tilt.ratio, 1.0)


def test_collinear_features_of_a_class_are_named():
    text = r"^features should be linearly independent within rows; they have rank 1 of 2 \(the smallest parameters that fit"
    with pytest.warns(UserWarning, match=text):
        fit(method="linear", features=FEATURES[:, [0, 0]])
    text = r"^features should be linearly independent; they have rank 1 of 2 \(the smallest parameters that fit"
    with pytest.warns(UserWarning, match=text):
        oee.density_ratio([1, 2, 3], [2, 2, 2], features=[[1, 2], [1, 2], [1, 2]])


def test_kernels_and_their_features():
    x = np.array([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]])
    assert_allclose(gaussian(2.0)(x, x[:2])[:, 1], np.exp(-np.array([25.0, 0.0, 20.0]) / 8))
    made = kernel_features(x, gaussian(1.0), n_centers=3)
    assert_allclose(made.matrix @ made.matrix.T, gaussian(1.0)(x, x), atol=1e-12)
    assert made.residual < 1e-12
    assert sorted(made.pivots.tolist()) == [0, 1, 2]
    few = kernel_features(x, gaussian(1.0), n_centers=2)
    gram = gaussian(1.0)(x, x)
    left = np.diag(gram) - (few.matrix**2).sum(axis=1)
    assert_allclose(few.residual, left.max(), rtol=1e-9)
    assert few.matrix.shape == (3, 2)
    centred = kernel_features(x, gaussian(1.0), n_centers=3, center=lambda m: m - m.mean(axis=0))
    assert_allclose(centred.matrix, made.matrix - made.matrix.mean(axis=0))
    many = np.linspace(0, 5, 150)[:, None]  # more than two blocks of the diagonal
    whole = kernel_features(many, lambda a, c: (1 + a @ c.T) ** 2, n_centers=150)
    assert whole.matrix.shape == (150, 3)
    assert_allclose(whole.matrix @ whole.matrix.T, (1 + many @ many.T) ** 2, rtol=1e-6)


def test_ranks():
    assert rank_of(np.zeros((4, 2))) == 0
    assert rank_of(np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1e-9]])) == 2
    assert rank_of(np.array([[1.0, 1.0], [0.0, 1e-9]])) == 1


def test_bounds_that_the_sum_implies():
    assert_allclose(implied_bound(np.array([0.25, 0.75, 0.0]), 0.2), [(1 - 0.15) / 0.25, (1 - 0.05) / 0.75, np.inf])


def test_points_of_moves_are_action_place_and_displacement():
    points = move_points(SIMULATOR, PLACES)
    expected = [(a, PLACES[s], PLACES[j] - PLACES[s]) for s in range(3) for a in range(2) for j in range(3)]
    assert_array_equal(points, expected)


# ---- quotients and the simulator's data --------------------------------------------------------------------------


def test_the_quotient_without_a_box_is_that_of_frequencies():
    """(n_x / q_x) / (n_sa / q_sa), normalised on each side; 1 where neither side has the move."""
    other = np.array([[2, 2, 4], [1, 0, 3], [5, 5, 2], [1, 1, 1], [0, 0, 0], [4, 0, 4]], dtype=float)
    state, action, following = [], [], []
    for row, j in np.argwhere(other > 0):
        for column, number in zip((state, action, following), (row // 2, row % 2, j), strict=True):
            column.extend([number] * int(other[row, j]))
    data = Transitions(state, action, following)
    counts = np.where(other > 0, COUNTS, 0.0)
    found = fit(counts, method="ratio_of_ratios", simulator_data=data, lower=0.0, upper=np.inf)
    n, m = counts.sum(axis=1, keepdims=True), other.sum(axis=1, keepdims=True)
    expected = np.divide(counts * m, other * n, out=np.ones((6, 3)), where=(other > 0) & (n > 0))
    assert_allclose(found.values.toarray(), expected, rtol=1e-8)
    facts = found.details
    assert facts["undetermined_moves"] == 5
    assert facts["moves_only_in_log"] == 0
    p, q = counts[counts > 0] / counts.sum(), other[counts > 0] / other.sum()
    assert_allclose(facts["divergence_moves"], p @ np.log(p / q), rtol=1e-8)
    pairs = [(a, b) for a, b in zip(n[:, 0] / n.sum(), m[:, 0] / m.sum(), strict=True) if a > 0]
    assert_allclose(facts["divergence_pairs"], sum(a * np.log(a / b) for a, b in pairs), rtol=1e-8)
    boxed = fit(method="ratio_of_ratios", simulator_data=data, lower=0.5, upper=1.5)
    assert boxed.details["moves_only_in_log"] == 1
    assert (boxed.details["lower"], boxed.details["upper"]) == (0.5, 1.5)
    moves = oee.density_ratio(COUNTS.reshape(-1), other.reshape(-1), lower=0.5, upper=1.5, toward=1.0).ratio
    low, high = (moves <= 0.5).mean(), (moves >= 1.5).mean()
    assert low > 0
    assert high > 0
    assert_allclose(boxed.details["share_at_the_box"], low + high)


def weights(observed, log, simulator, data, behavior, seed, discount=None):
    return simulator_weights(Given(observed, simulator, log=log, discount=discount, seed=seed), data, behavior)


def test_data_of_the_simulator():
    """Exact occupancies over the log's longest episode; counts; samples of the log's size under its policy."""
    observed = LOG.counts(3, 2)
    aligned = observed.toarray().reshape(-1)
    behavior = estimated_behavior(aligned, SIMULATOR)
    pairs = observed.sum(axis=1).reshape(3, 2)
    assert_allclose(behavior, pairs / pairs.sum(axis=1, keepdims=True))
    assert_array_equal(estimated_behavior(np.zeros(18), SIMULATOR), np.full((3, 2), 0.5))
    share = weights(aligned, LOG, SIMULATOR, "exact", behavior, None)
    expected = oee.occupancy(SIMULATOR.with_discount(1.0), behavior, horizon=8, of="transition")
    assert_allclose(share, expected.data, rtol=1e-12)
    weighted = weights(aligned, LOG, SIMULATOR, "exact", behavior, None, 0.5)
    expected = oee.occupancy(SIMULATOR.with_discount(0.5), behavior, horizon=8, of="transition")
    assert_allclose(weighted, expected.data, rtol=1e-12)
    counted = weights(aligned, LOG, SIMULATOR, LOG, behavior, None)
    assert_array_equal(counted, aligned)
    halved = weights(aligned, LOG, SIMULATOR, LOG, behavior, None, 0.5)
    assert_allclose(halved, LOG.counts(3, 2, discount=0.5).toarray().reshape(-1))
    drawn = weights(aligned, LOG, SIMULATOR, None, behavior, 3)
    assert drawn.sum() == len(LOG)
    assert_array_equal(drawn, weights(aligned, LOG, SIMULATOR, None, behavior, 3))
    faded = weights(aligned, LOG, SIMULATOR, None, behavior, 3, 0.5)
    assert faded.sum() < 0.4 * len(LOG)  # 8 steps of 0.5^t: a quarter
    without = weights(aligned, None, SIMULATOR, None, behavior, 3)
    assert without.sum() == len(LOG)
    long = weights(aligned, None, SIMULATOR, "exact", behavior, None)
    expected = oee.occupancy(SIMULATOR.with_discount(1.0), behavior, horizon=1000, of="transition")
    assert_allclose(long, expected.data, rtol=1e-9)
    over = FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [1, 0], 0.9)
    share = weights(np.array([1.0, 1.0, 0.0]), None, over, "exact", np.ones((2, 1)), None)
    ended = FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 0.9)
    assert_array_equal(weights(np.ones(1), None, ended, "exact", np.ones((1, 1)), None), [1.0])
    assert share[2] == 0.0  # logs stop where an episode is over
    assert_allclose(share[0], share[1])


def test_pairs_that_the_simulator_s_data_lack():
    """Counted where the log has them; zeta is 1 there; without an upper bound there is no program."""
    some = Transitions([0, 0, 1, 2], [0, 1, 0, 1], [0, 1, 2, 0])
    counts = COUNTS.copy()
    counts[3] = 0.0  # neither side has the row (1, 1); only the log has none of (2, 0); rows 0, 1, 2, 5 on both
    found = fit(counts, method="joint", simulator_data=some)
    assert found.details["pairs_without_simulator_data"] == 0
    counts[4] = 1.0
    found = fit(counts, method="joint", simulator_data=some)
    assert found.details["pairs_without_simulator_data"] == 1
    assert_array_equal(found.values.toarray()[[3, 4]], np.ones((2, 3)))
    text = r"^simulator_data must cover the log's \(s, a\), or upper be finite: the program is unbounded at 1 of them$"
    with pytest.raises(ValueError, match=text):
        fit(counts, method="joint", simulator_data=some, upper=np.inf)


# ---- density ratios ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"normalized": False}, {"lower": 0.6, "upper": 1.4}, {"ridge": 0.2},
                                     {"ridge": 0.2, "toward": 1.0, "normalized": False}], ids=repr)  # fmt: skip
@pytest.mark.parametrize("loss", ["kl", "chi2"])
def test_the_numbers_of_a_fit(options, loss):
    """The objective as it is written, the bound below it, the sums that were handed over, the divergence."""
    p, q = np.array([3.0, 1.0, 4.0, 0.0, 0.0]), np.array([2.0, 2.0, 1.0, 3.0, 0.0])
    found = oee.density_ratio(p, q, loss=loss, **options)
    g, ps, qs = found.ratio[:4], p[:4] / 8, q[:4] / 8
    ridge, toward = options.get("ridge", 0.0), options.get("toward")
    penalty = 0.5 * ridge * ((g**2).sum() if toward is None else qs @ (g - toward) ** 2)
    if loss == "kl":
        value = qs @ g - ps[:3] @ np.log(g[:3]) + penalty
        assert_allclose(found.divergence, ps[:3] @ np.log(g[:3]) - qs @ g + 1, rtol=1e-12)
    else:
        value = qs @ g**2 / 2 - ps @ g + penalty
        assert np.isnan(found.divergence)
    assert_allclose(found.objective, value, rtol=1e-12)
    assert_allclose(found.dual_bound, value - found.gap, rtol=1e-12)
    assert 0 <= found.gap < 1e-10
    assert (found.p_total, found.q_total, found.n_undetermined, found.status) == (8.0, 8.0, 1, "optimal")
    assert found.ratio[4] == 1.0
    assert found.trace is None
    assert found.weights is None
    if options.get("normalized", True):
        assert_allclose(qs @ g, 1.0, rtol=1e-12)
    else:
        assert found.normalizer == 0.0
    assert (found.enclosure[0] <= found.ratio + 1e-12).all()
    assert (found.ratio <= found.enclosure[1] + 1e-12).all()
    tried = 0
    for move in feasible_directions(qs, options.get("normalized", True)):  # and it is the minimum: no step does better
        other = g + 1e-4 * move
        if (other < options.get("lower", 0)).any() or (other > options.get("upper", np.inf)).any():
            continue
        worse = qs @ other - ps[:3] @ np.log(other[:3]) if loss == "kl" else qs @ other**2 / 2 - ps @ other
        worse += 0.5 * ridge * ((other**2).sum() if toward is None else qs @ (other - toward) ** 2)
        assert worse >= value - 1e-12
        assert worse > value or ps @ move == 0
        tried += 1
    assert tried >= 2


def feasible_directions(q, normalized):
    """Up and down along each entry, or along pairs of entries that keep sum q g."""
    one = np.eye(len(q))
    if not normalized:
        return [*one, *-one]
    return [one[i] / q[i] - one[j] / q[j] for i in range(len(q)) for j in range(len(q)) if i != j]


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


def test_algorithm_1_step_by_step():
    """The same draws, one update at a time, and its trace."""
    p, q = np.array([3.0, 1.0, 4.0]) / 8, np.array([2.0, 4.0, 2.0]) / 8
    options = {"lower": 0.2, "upper": 3.0, "normalized": False, "ridge": 0.1, "toward": 1.0}
    found = oee.density_ratio(p, q, solver="sgd", step_size=0.05, batch_size=16, n_iterations=60, seed=4, **options)
    best = oee.density_ratio(p, q, **options)
    generator, g, trace = np.random.default_rng(4), np.ones(3), {}
    for iteration in range(1, 61):
        counts = [
            np.bincount(np.searchsorted(np.cumsum(x), generator.random(16) * x.sum(), side="right"), minlength=3) / 16
            for x in (p, q)
        ]
        g = np.clip(g - 0.05 * (counts[1] - counts[0] / g + 0.1 * q * (g - 1.0)), 0.2, 3.0)
        value = q @ g - p @ np.log(g) + 0.05 * q @ (g - 1.0) ** 2
        trace[iteration] = (value - best.objective, np.abs(g - best.ratio).mean())
    assert_allclose(found.ratio, g, rtol=1e-12)
    points = found.trace.iteration
    assert points[0] == 1
    assert points[-1] == 60
    assert_array_equal(points, np.unique(np.round(np.geomspace(1, 60, 50))))
    assert_allclose(found.trace.excess, [trace[i][0] for i in points], atol=1e-12)
    assert_allclose(found.trace.error, [trace[i][1] for i in points], rtol=1e-9)
    assert_allclose(found.gap, trace[60][0], atol=1e-12)


def test_boxes_and_ridges():
    box = check_box(None, None, normalized=True)
    assert (box.lower, box.upper) == (0.0, np.inf)
    assert check_box(1.0, 1.0, normalized=True).upper == 1.0
    assert check_box(2.0, 3.0, normalized=False).lower == 2.0
    assert check_ridge(lambda n: 1 / n, 4.0) == 0.25
    assert check_ridge(0, 4.0) == 0.0


def test_assumptions_that_hold_and_fail():
    found = check_assumptions([1, 3, 0, 4], [2, 2, 2, 2], lower=0.5, upper=1.5)
    assert found.box_contains_one
    assert (found.inside, found.supported, found.below, found.above, found.unsupported) == (False, True, 1, 1, 0)
    assert (found.smallest, found.largest) == (0.0, 2.0)
    assert_allclose(found.renyi_infinity, np.log(2.0))
    assert check_assumptions([1, 1, 2], [1, 0, 1], lower=0.0, upper=9.0).unsupported == 1
    lost = check_assumptions([1, 1], [1, 0], lower=1.0, upper=np.inf)
    assert (lost.box_contains_one, lost.supported, lost.unsupported, lost.renyi_infinity) == (False, False, 1, np.inf)
    assert not check_assumptions([1, 1], [1, 1], lower=0.0, upper=1.0).box_contains_one
    edge = check_assumptions([1, 3], [2, 2], lower=0.5, upper=1.5)
    assert edge.inside
    assert (
        str(edge) == "nu < 1 < mu: holds; nu <= p/q <= mu: holds, p/q from 0.5 to 1.5; support: holds; D_inf = 0.4055"
    )
    assert str(lost) == (
        "nu < 1 < mu: fails; nu <= p/q <= mu: fails (1 entries below, 0 above), p/q from 0.5 to 0.5; support: fails at 1 "
        "entries; D_inf = inf"
    )


def test_moves_outside_the_support_in_words():
    """The four heaviest, by weight; their number and share; what leads out."""
    rows = np.zeros((6, 1, 6))
    rows[:, 0, 0] = 1.0
    simulator = FiniteMDP(rows, np.zeros(6), [1, 0, 0, 0, 0, 0], 0.9)
    counts = np.zeros((6, 6))
    counts[0], counts[1, 0] = [9, 1, 2, 3, 4, 5], 6
    with pytest.raises(ValueError, match=r"^log must stay where") as caught:
        refuse_unsupported(sparse.csr_array(counts), simulator)
    assert str(caught.value) == (
        "log must stay where the simulator has probability: it gives probability 0 to 5 different moves (15 of 30 in all), the "
        "heaviest: s=0, a=0 -> s'=5 (5); s=0, a=0 -> s'=4 (4); s=0, a=0 -> s'=3 (3); s=0, a=0 -> s'=2 (2). No ratio exists "
        "there. No action leads from 0 to 5 in the simulator, so that action noise does not help. If the target can do this, "
        "give it some probability, P[0, 0] *= 0.99; P[0, 0, 5] += 0.01; if it is a fault of the log, leave those rows out; "
        "else a mixture of simulator parameters, or states that tell such moves apart"
    )
    with pytest.raises(ValueError, match=r"^target must stay where"):
        refuse_unsupported(sparse.csr_array(counts), simulator, what="target")
    counts[0, 1:] = 0
    refuse_unsupported(sparse.csr_array(counts), simulator)


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


# ---- bad calls ---------------------------------------------------------------------------------------------------

zeta = functools.partial(functools.partial, oee.transition_ratio, sparse.csr_array(COUNTS), SIMULATOR)
density = functools.partial(functools.partial, oee.density_ratio, [1, 2], [2, 1])
drawn = functools.partial(functools.partial, density_ratio_samples, [1.0, 2.0, 3.0], [1.0, 2.0, 4.0])
SGD = {"solver": "sgd", "normalized": False, "lower": 0.1, "upper": 9.0}
UNUSED = {
    "strength": 1.0, "features": FEATURES, "kernel": "gaussian", "coordinates": PLACES, "bandwidth": 1.0, "n_centers": 5,
    "simulator_data": "exact", "behavior_policy": POLICY, "ratio_lower": 0.5, "ratio_upper": 2.0, "prior": "none",
}  # fmt: skip
OWN = {
    "conditional": {"prior", "strength", "features"},
    "linear": {"features"},
    "kernel": {"kernel", "coordinates", "bandwidth", "n_centers"},
    "ratio_of_ratios": {"simulator_data", "behavior_policy"},
    "joint": {"simulator_data", "behavior_policy", "ratio_lower", "ratio_upper"},
}


@pytest.mark.parametrize("method", OWN)
@pytest.mark.parametrize("name", UNUSED)
def test_options_that_a_method_does_not_use(method, name):
    if name in OWN[method]:
        return
    with pytest.raises(
        ValueError, match=rf"^{name} must not be given with method '{method}', which does not use it; got"
    ):
        zeta(method=method, **{name: UNUSED[name]})()


WRONG = {
    "method": (zeta(method="q"), r"^method must be one of 'conditional', 'tied', 'linear', .*, 'joint'; got 'q'$"),
    "simulator": (lambda: oee.transition_ratio(LOG, 3), r"^simulator must be a FiniteMDP; got int$"),
    "prior": (zeta(prior="q"), r"^prior must be one of 'average', 'tilt', 'simulator', 'none'; got 'q'$"),
    "strength": (zeta(strength="q"), r"^strength must be one of 'evidence', 'loo'; got 'q'$"),
    "a negative strength": (zeta(strength=-1), r"^strength must be in \[0, inf\); it is -1$"),
    "ridge": (zeta(ridge="q"), r"^ridge must be one of 'evidence', 'loo'; got 'q'$"),
    "a negative ridge": (zeta(ridge=-1), r"^ridge must be in \[0, inf\); it is -1$"),
    "a ridge of n": (density(ridge=lambda n: -n), r"^ridge\(3\) must be in \[0, inf\); it is -3$"),
    "toward": (zeta(toward=-1), r"^toward must be in \[0, inf\); it is -1$"),
    "toward of a density": (density(toward=-1), r"^toward must be in \[0, inf\); it is -1$"),
    "lower": (zeta(lower=-1), r"^lower must be in \[0, inf\); it is -1$"),
    "upper": (zeta(upper=-1), r"^upper must be in \[0, inf\]; it is -1$"),
    "upper below 1": (
        zeta(upper=0.5),
        r"^the box \[lower, upper\] must contain 1 for sum q g = 1 to be possible; it is \[0, 0",
    ),
    "the joint box": (
        zeta(method="joint", ratio_upper=0.5),
        r"^the box \[ratio_lower, ratio_upper\] must contain 1 for sum q g = 1",
    ),
    "features with a prior": (
        zeta(prior="simulator", features=FEATURES),
        r"^features must be left out with prior 'simulator', which does not use them$",
    ),
    "a word for the ridge": (
        zeta(method="joint", ridge="loo"),
        r"^ridge must be a number or a function of n with method 'joint'; got 'loo'$",
    ),
    "behaviour": (
        zeta(method="joint", behavior_policy=POLICY * 2),
        r"^behavior_policy\[0\] must sum to 1",
    ),
    "behaviour of the quotient": (
        zeta(method="ratio_of_ratios", behavior_policy=POLICY * 2),
        r"^behavior_policy\[0\] must sum to 1",
    ),
    "centres": (
        zeta(method="kernel", coordinates=PLACES, n_centers=0),
        r"^n_centers must be a positive integer; it is 0$",
    ),
    "centres of a density": (
        density(kernel="gaussian", coordinates=[0, 1], n_centers=0),
        r"^n_centers must be a positive integer; it is 0$",
    ),
    "centres of samples": (drawn(n_centers=0), r"^n_centers must be a positive integer; it is 0$"),
    "a discount for counts": (
        zeta(discount=0.9),
        r"^discount must be left out where counts are given: they have no timesteps$",
    ),
    "what is no log": (
        lambda: oee.transition_ratio(COUNTS, SIMULATOR),
        r"^log_or_counts must be Transitions or sparse counts; got ndarray$",
    ),
    "no moves": (
        lambda: oee.transition_ratio(sparse.csr_array((6, 3)), SIMULATOR),
        r"^log_or_counts must have at least one move; it has none$",
    ),
    "the true ratio's target": (lambda: oee.true_ratio(3, SIMULATOR), r"^target must be a FiniteMDP; got int$"),
    "the true ratio's simulator": (lambda: oee.true_ratio(TARGET, 3), r"^simulator must be a FiniteMDP; got int$"),
    "a seed": (
        zeta(method="ratio_of_ratios", seed="q"),
        r"^seed must be what numpy.random.default_rng takes",
    ),
    "a bandwidth": (
        zeta(method="kernel", coordinates=PLACES, bandwidth=-1),
        r"^bandwidth must be in \(0, inf\); it is -1$",
    ),
    "a kernel": (zeta(method="kernel", kernel="q", coordinates=PLACES), r"^kernel must be one of 'gaussian'; got 'q'$"),
    "places that are not finite": (
        zeta(method="kernel", coordinates=[0, 1, np.nan]),
        r"^coordinates\[2\] must be finite; it is nan$",
    ),
    "places of another number": (
        lambda: action_displacement(SIMULATOR, [0, 1]),
        r"^coordinates must have 3 rows, one a state; they have 2$",
    ),
    "features that are not finite": (
        zeta(features=np.where(FEATURES == 2, np.inf, FEATURES)),
        r"^features\[2, 0\] must be finite; it is inf$",
    ),
    "features that are words": (zeta(features="q"), r"^features must be an array of numbers; got str"),
    "a loss": (density(loss="q"), r"^loss must be one of 'kl', 'chi2'; got 'q'$"),
    "p": (lambda: oee.density_ratio([-1], [1]), r"^p\[0\] must be nonnegative; it is -1\.0$"),
    "q": (lambda: oee.density_ratio([1], [-1]), r"^q\[0\] must be nonnegative; it is -1\.0$"),
    "coordinates without a kernel": (
        density(coordinates=[0, 1]),
        r"^coordinates must be given with a kernel; none is given$",
    ),
    "coordinates with features": (
        density(features=[1, 1], coordinates=[0, 1]),
        r"^coordinates must not be given with features; the two are different classes$",
    ),
    "a step": (density(step_size=0, **SGD), r"^step_size must be in \(0, inf\); it is 0$"),
    "a batch": (density(batch_size=0, **SGD), r"^batch_size must be a positive integer; it is 0$"),
    "iterations": (density(n_iterations=0, **SGD), r"^n_iterations must be a positive integer; it is 0$"),
    "a seed of Algorithm 1": (density(seed="q", **SGD), r"^seed must be what numpy.random.default_rng takes"),
    "options of Algorithm 1": (lambda: Sgd(step_size=-1), r"^step_size must be in \(0, inf\); it is -1$"),
    "Algorithm 1 without an upper bound": (
        density(**(SGD | {"upper": None})),
        r'^solver "sgd" must have 0 < lower and a finite upper; the box is \[0\.1, inf\]$',
    ),
    "Algorithm 1 without a lower bound": (
        density(**(SGD | {"lower": None})),
        r'^solver "sgd" must have 0 < lower and a finite upper; the box is \[0, 9\]$',
    ),
    "Algorithm 1 normalised": (
        density(**(SGD | {"normalized": True})),
        r'^solver "sgd" must have normalized=False and loss="kl": Algorithm 1 knows no other program$',
    ),
    "Algorithm 1 with another loss": (
        density(loss="chi2", **SGD),
        r'^solver "sgd" must have normalized=False and loss="kl"',
    ),
    "a kernel that is not finite": (
        density(kernel=lambda x, c: np.full((len(x), len(c)), np.nan), coordinates=[0, 1]),
        r"^kernel\[0, 0\] must be finite; it is nan$",
    ),
    "samples of three dimensions": (
        lambda: density_ratio_samples(np.ones((2, 2, 2)), [1, 2]),
        r"^x_p must have 1 or 2 dimension\(s\); it has shape \(2, 2, 2\)$",
    ),
    "assumptions: p": (lambda: check_assumptions([-1], [1], lower=0, upper=1), r"^p\[0\] must be nonnegative"),
    "assumptions: q": (
        lambda: check_assumptions([1], [0], lower=0, upper=1),
        r"^q must have a positive, finite sum; it is 0$",
    ),
    "features of a class of three dimensions": (
        density(features=np.ones((2, 1, 1))),
        r"^features must have 1 or 2 dimension\(s\); it has shape \(2, 1, 1\)$",
    ),
    "coordinates of three dimensions": (
        density(kernel="gaussian", coordinates=np.ones((2, 1, 1))),
        r"^coordinates must have 1 or 2 dimension\(s\); it has shape \(2, 1, 1\)$",
    ),
    "coordinates that are not finite": (
        density(kernel="gaussian", coordinates=[0, np.inf]),
        r"^coordinates\[1\] must be finite; it is inf$",
    ),
    "assumptions: a matrix": (
        lambda: check_assumptions([[1]], [1], lower=0, upper=1),
        r"^p must have 1 dimension\(s\); it has shape \(1, 1\)$",
    ),
    "a class far from its box": (
        density(features=[1, -1], lower=0.5, upper=4.0, normalized=False),
        r"^features must span a function that is at least 0\.5 and at most 4; the nearest misses by 0\.5 \(a constant",
    ),
    "a class far from its sum": (
        density(features=[1, -1], lower=0.25),
        r"^features must span a function that is at least 0\.25, with sum q g = 1; the nearest misses by 3\.25 \(a constant",
    ),
    "assumptions: lower": (
        lambda: check_assumptions([1], [1], lower=-1, upper=1),
        r"^lower must be in \[0, inf\); it is -1$",
    ),
    "assumptions: upper": (
        lambda: check_assumptions([1], [1], lower=0, upper=-1),
        r"^upper must be in \[0, inf\]; it is -1$",
    ),
    "assumptions: lengths": (
        lambda: check_assumptions([1], [1, 1], lower=0, upper=1),
        r"^p and q must have one length; they have 1 and 2$",
    ),
    "samples: x_p": (lambda: density_ratio_samples([np.nan, 1], [1, 2]), r"^x_p\[0\] must be finite; it is nan$"),
    "samples: x_q": (lambda: density_ratio_samples([1, 2], [1.0]), r"^x_q must have at least 2 points; it has 1$"),
    "samples: features": (drawn(features="q"), r"^features must be one of 'linear', 'quadratic'; got 'q'$"),
    "samples: kernel": (drawn(kernel="q"), r"^kernel must be one of 'gaussian'; got 'q'$"),
    "samples: seed": (drawn(seed="q"), r"^seed must be what numpy.random.default_rng takes"),
    "another simulator's ratio": (
        lambda: exact.reweight(SIMULATOR, oee.true_ratio(*[FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 0.5)] * 2)),
        r"^ratio must be sparse of shape \(6, 3\)",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_calls_name_their_argument(name):
    call, text = WRONG[name]
    with pytest.raises(ValueError, match=text):
        call()


def test_the_true_ratio_entry_by_entry():
    found = oee.true_ratio(TARGET, SIMULATOR)
    assert_allclose(found.values.toarray().reshape(3, 2, 3), dense(TARGET)[0] / dense(SIMULATOR)[0], rtol=1e-14)
    assert (found.method, found.gap, found.details) == ("true", 0.0, {})
    assert found.visited.all()
