"""The tilt along chosen features: its minimiser, its gap, its precisions, and the evidence that another feature would add."""

from decimal import Decimal, getcontext

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy import optimize, special

import oee_tabular as oee
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio import statements
from oee_tabular.ratio.prior import _kernels, selection
from oee_tabular.ratio.prior.selection import Selection

ALL, FIRST = 0, 1  # a feature for all actions, or for action 0 alone


def problem(seed=0, d=4, n=300, theta=0.0):
    """Counts of 10 rows of 5 states, the target tilted by theta along feature 0 (or along all), and d centred features."""
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.full(5, 2.0), (5, 2))
    simulator = oee.FiniteMDP(rows, np.zeros(5), np.full(5, 0.2), 0.9)
    found = Rows.of(simulator)
    base = found.center(rng.normal(size=(50, d)))
    model, _ = found.tilt(base @ np.append(theta, np.zeros(d - np.size(theta))))
    sizes = rng.multinomial(n, np.full(10, 0.1))
    counts = np.concatenate([rng.multinomial(m, p) for m, p in zip(sizes, model.reshape(10, 5), strict=True)]) + 0.0
    allowed = np.ones((3, d), dtype=bool)
    return Selection(found, counts, base, allowed), np.exp(rng.uniform(1, 5, 10))


def dense_columns(chosen, made, counts_of_rows=10):
    """The chosen columns, written out: of unit mean square over all rows, an action's own being 0 in the others."""
    action = np.repeat(made.rows.action, 5)
    found = []
    for j, part in chosen:
        column = made.base[:, j] * (1.0 if part == ALL else action == part - 1)
        found.append(column / np.sqrt((made.rows.weights * column**2).sum() / counts_of_rows))
    return np.column_stack(found)


def risk(made, phi, kappa, precision):
    """f(theta), as it is written."""
    weight = np.minimum((1 + kappa) / (made.count + kappa), 1.0)
    counts, p = made.observed.reshape(10, 5), made.rows.weights.reshape(10, 5)

    def f(theta):
        exponent = (phi @ theta).reshape(10, 5)
        log_z = special.logsumexp(exponent, b=p, axis=1)
        return weight @ (made.count * log_z - (counts * exponent).sum(axis=1)) + 0.5 * precision @ theta**2

    return f


def hessian(made, phi, kappa, model):
    """sum over rows of w n Cov(phi), without the penalty."""
    weight = np.minimum((1 + kappa) / (made.count + kappa), 1.0)
    found = np.zeros((phi.shape[1],) * 2)
    for row in range(10):
        part, m = phi[5 * row : 5 * row + 5], model[5 * row : 5 * row + 5]
        centred = part - m @ part
        found += weight[row] * made.count[row] * (centred * m[:, None]).T @ centred
    return found


CHOICES = [((0, ALL),), ((0, ALL), (2, FIRST)), ((1, 2), (0, FIRST), (3, ALL))]


@pytest.mark.parametrize("chosen", CHOICES)
@pytest.mark.parametrize("theta", [0.0, 0.7])
def test_the_minimiser_and_what_comes_with_it(chosen, theta):
    made, kappa = problem(theta=theta)
    phi = dense_columns(chosen, made)
    assert_allclose(made.columns(chosen), phi, atol=1e-12)
    found = made.fit(chosen, kappa)
    f = risk(made, phi, kappa, found.precision)
    best = optimize.minimize(f, np.zeros(len(chosen)), method="BFGS", options={"gtol": 1e-7})
    assert_allclose(found.theta, best.x, atol=1e-5)
    assert f(found.theta) <= best.fun + 1e-9
    assert 0 <= found.gap < 1e-12
    raw = made.rows.weights * np.exp(phi @ found.theta)
    assert_allclose(
        found.model, (raw.reshape(10, 5) / raw.reshape(10, 5).sum(axis=1, keepdims=True)).reshape(-1), rtol=1e-12
    )
    information = hessian(made, phi, kappa, found.model) + np.diag(found.precision)
    assert_allclose(found.information, information, rtol=1e-9, atol=1e-9)
    size = 0.5 * (np.linalg.slogdet(information)[1] - np.log(found.precision).sum() + found.precision @ found.theta**2)
    assert_allclose(found.size, size, rtol=1e-9)
    assert found.chosen == chosen


@pytest.mark.parametrize("theta", [0.0, 0.15, 0.7])
def test_precisions_are_at_mackay_s_fixed_point(theta):
    for seed in range(4):
        made, kappa = problem(seed, theta=theta)
        found = made.fit([(0, ALL), (1, ALL), (3, FIRST)], kappa)
        inverse = np.diag(np.linalg.inv(found.information))
        new = np.clip((1 - found.precision * inverse) / found.theta**2, 1.0, 1e6)
        settled = np.abs(np.log(new / found.precision))
        assert settled[found.precision < 100].max(initial=0) < 0.08  # eight rounds; what is all but out may go on
        if theta == 0.7:
            assert_allclose(found.precision[0], max(1.0, new[0]), rtol=0.06)


def test_no_precision_is_below_one():
    """A theta of 3 would have its maximum of evidence at about 1/9."""
    made, kappa = problem(0, n=3000, theta=3.0)
    found = made.fit([(0, ALL)], kappa)
    assert abs(found.theta[0]) > 2
    assert found.precision[0] == 1.0


def test_a_feature_of_no_use_is_held_at_zero_and_one_that_is_large_is_free():
    made, kappa = problem(2, n=3000, theta=0.8)
    found = made.fit([(0, ALL), (1, ALL)], kappa)
    assert found.precision[0] < 10
    assert found.precision[1] > 10 * found.precision[0]
    assert abs(found.theta[1]) < 0.1 < found.theta[0]


@given(rngs, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_gap_bounds_what_a_wrong_answer_leaves(rng, x, y):
    made, kappa = problem(int(rng.integers(20)), theta=0.5)
    chosen = [(0, ALL), (2, 2)]
    found = made.fit(chosen, kappa)
    wrong = found.theta + np.array([x, y])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statements, "solve_tilt", lambda program, solver: wrong * np.sqrt(found.precision))
        other = made.by_cvxpy(found, kappa, "CLARABEL")
    f = risk(made, dense_columns(chosen, made), kappa, found.precision)
    left = (f(wrong) - f(found.theta)) / made.count.sum()
    assert -1e-12 <= left <= other.gap + 1e-12
    gradient = optimize.approx_fprime(wrong, f, 1e-6)
    assert_allclose(other.gap, 0.5 * np.sum(gradient**2 / found.precision) / made.count.sum(), rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("chosen", CHOICES)
def test_a_cvxpy_solver_agrees(chosen):
    made, kappa = problem(1, theta=0.5)
    ours = made.fit(chosen, kappa)
    theirs = made.by_cvxpy(ours, kappa, "CLARABEL")
    assert_allclose(theirs.theta, ours.theta, atol=1e-5)
    assert_allclose(theirs.model, ours.model, atol=1e-5)
    assert theirs.gap < 1e-8
    assert theirs.chosen == ours.chosen
    assert_allclose(theirs.information, ours.information)


# ---- the evidence for another feature ----------------------------------------------------------------------------


def best_gain(score, information):
    """max over lambda >= 1 of [ln(lambda / (lambda + I)) + s^2 / (lambda + I)] / 2, on a fine grid."""
    precision = np.exp(np.linspace(0, 40, 400_001))
    return np.max(0.5 * (np.log(precision / (precision + information)) + score**2 / (precision + information)))


@pytest.mark.parametrize("chosen", [None, *CHOICES])
@pytest.mark.parametrize("theta", [0.0, 0.5])
def test_gains_are_the_quadratic_s_evidence(chosen, theta):
    made, kappa = problem(3, theta=theta)
    weight = np.minimum((1 + kappa) / (made.count + kappa), 1.0)
    fitted = None if chosen is None else made.fit(chosen, kappa)
    model = made.rows.weights if fitted is None else fitted.model
    gains = made.gains(fitted, kappa)
    assert gains.shape == (3, 4)
    mass = np.repeat(weight * made.count, 5)
    pushed = np.repeat(weight, 5) * made.observed - mass * model  # -df / dphi
    for part in range(3):
        for j in range(4):
            if chosen is not None and (j, part) in chosen:
                assert gains[part, j] == -np.inf
                continue
            phi = dense_columns([*(chosen or ()), (j, part)], made)
            whole = hessian(made, phi, kappa, model)
            inner = whole[:-1, :-1] + np.diag([] if fitted is None else fitted.precision)
            information = whole[-1, -1] - whole[-1, :-1] @ np.linalg.solve(inner, whole[:-1, -1])
            score = phi[:, -1] @ pushed
            if score**2 <= information:
                assert gains[part, j] == -np.inf
            else:
                assert_allclose(gains[part, j], best_gain(score, information), rtol=1e-6, atol=1e-7)


def test_a_gain_in_closed_form():
    """(z^2 - 1 - ln z^2) / 2 where lambda is above 1, at lambda = 1 otherwise."""
    gain = selection._gain(np.array([3.0, 30.0, 1.0, 3.0]), np.array([4.0, 4.0, 4.0, 4.0]), np.array([1, 1, 1, 0]) > 0)
    z2 = 9 / 4
    assert_allclose(gain[0], 0.5 * (z2 - 1 - np.log(z2)), rtol=1e-12)
    assert_allclose(gain[1], 0.5 * (900 / 5 - np.log(5.0)), rtol=1e-12)
    assert gain[2] == gain[3] == -np.inf


@pytest.mark.parametrize("price", [0.0, 2.0, 1e3])
def test_the_path_takes_what_gains_most(price):
    made, kappa = problem(4, d=9, n=2000, theta=np.linspace(0.2, 0.6, 9))
    prices = np.full((3, 9), price)
    prices[ALL, 0] = price + 1.0
    path = made.path(kappa, prices)
    assert len(path) <= 6
    last = None
    for k, step in enumerate([*path, None]):
        gain = made.gains(last, kappa) - prices
        if step is None:
            assert k == 6 or gain.max() <= 0
            break
        assert gain.max() > 0
        part, j = np.argwhere(gain == gain.max())[0]
        assert step.chosen == (*(() if last is None else last.chosen), (j, part))
        last = step
    if price == 0.0:
        assert len(path) == 6  # of nine
    if price == 1e3:
        assert path == []


@pytest.mark.parametrize("left", [0.3, -0.3])
def test_a_feature_enters_while_it_gains_more_than_its_price(left):
    made, kappa = problem(4)
    path = made.path(kappa, np.full((3, 4), made.gains(None, kappa).max() - left))
    assert (len(path) > 0) == (left > 0)


def test_features_that_are_zero_or_not_allowed_have_no_gain():
    made, kappa = problem(5)
    base = made.base.copy()
    base[:, 1] = 0.0
    base[np.repeat(made.rows.action, 5) == 1, 2] = 0.0
    allowed = np.ones((3, 4), dtype=bool)
    allowed[1, 3] = False
    gain = Selection(made.rows, made.observed, base, allowed).gains(None, kappa)
    assert (gain[:, 1] == -np.inf).all()
    assert gain[2, 2] == -np.inf
    assert gain[1, 3] == -np.inf


def test_how_much_a_move_counts():
    """n moves of a row count as n (1 + kappa) / (n + kappa); less than one move as itself."""
    made, _ = problem(6)
    made.count[:3] = [0.25, 1.0, 1000.0]
    counted = made.counted(np.full(10, 9.0))
    assert_allclose(counted[:3], [1.0, 1.0, 10 / 1009])


def test_rows_tilted_by_a_large_exponent():
    rows = Rows.of(random_mdp(np.random.default_rng(0), n_states=4, n_actions=2, zeros=0.0))
    exponent = np.random.default_rng(1).normal(size=len(rows.weights)) * 500
    model, log_z = rows.tilt(exponent)
    assert_allclose(rows.sums(model), 1.0, rtol=1e-13)
    expected = [
        special.logsumexp(exponent[i:j], b=rows.weights[i:j])
        for i, j in zip(rows.indptr[:-1], rows.indptr[1:], strict=True)
    ]
    assert_allclose(log_z, expected, rtol=1e-13)


# ---- the rising factorial ----------------------------------------------------------------------------------------

getcontext().prec = 60
BERNOULLI = [
    (1, 6),
    (-1, 30),
    (1, 42),
    (-1, 30),
    (5, 66),
    (-691, 2730),
    (7, 6),
    (-3617, 510),
    (43867, 798),
    (-174611, 330),
]


def log_gamma(x):
    """ln Gamma(x) to some 30 digits, less ln(2 pi) / 2: Stirling's series at x + 100."""
    product = Decimal(1)
    while x < 100:
        product *= x
        x += 1
    found = (x - Decimal("0.5")) * x.ln() - x
    for k, (a, b) in enumerate(BERNOULLI, start=1):
        found += Decimal(a) / Decimal(b) / (2 * k * (2 * k - 1)) / x ** (2 * k - 1)
    return found - product.ln()


@settings(max_examples=300)
@given(st.floats(-12, 12), st.one_of(st.integers(1, 5000).map(float), st.floats(-6, 6).map(lambda t: 10**t)))
def test_log_rising_over_all_scales(exponent, n):
    base = 10.0**exponent
    exact = log_gamma(Decimal(base) + Decimal(n)) - log_gamma(Decimal(base))
    assert_allclose(_kernels.log_rising(base, n), float(exact), rtol=2e-12, atol=2e-12)


@pytest.mark.parametrize("n", [1.0, 2.0, 8.0, 9.0, 11.999, 12.0, 1e5])
@pytest.mark.parametrize("base", [1e-12, 0.5, 11.9, 12.0, 12.1])
def test_log_rising_where_its_formulas_meet(base, n):
    assert_allclose(
        _kernels.log_rising(base, n), special.gammaln(base + n) - special.gammaln(base), rtol=1e-12, atol=1e-12
    )
