"""What a fit of zeta says: its details, its models, its standard error and its one-step correction."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, FEATURES, PLACES, SIMULATOR, TARGET, fit
from scipy import sparse

import oee_tabular as oee

FITS = {
    "the default": {}, "the tilt": {"prior": "tilt"}, "the simulator": {"prior": "simulator"},
    "a strength": {"prior": "simulator", "strength": 2.0}, "no prior": {"prior": "none"},
    "a chosen ridge": {"prior": "none", "ridge": "loo"}, "another solver": {"prior": "none", "solver": "CLARABEL"},
    "linear": {"method": "linear", "features": FEATURES}, "kernel": {"method": "kernel", "coordinates": PLACES},
    "quotient": {"method": "ratio_of_ratios", "simulator_data": "exact"},
    "joint": {"method": "joint", "simulator_data": "exact"},
}  # fmt: skip
ROWS = [*FITS][:7]


@pytest.mark.parametrize("name", FITS)
def test_what_a_fit_says(name):
    options = FITS[name]
    found = fit(**options)
    assert found.method == {"quotient": "ratio_of_ratios"}.get(name, options.get("method", "conditional"))
    assert 0 <= found.gap < 1e-7
    assert_array_equal(found.counts, COUNTS.sum(axis=1).reshape(3, 2))
    assert_array_equal(found.visited, found.counts > 0)
    sums = (found.values.toarray() * SIMULATOR.transitions.toarray()).sum(axis=1)
    assert_allclose(found.row_sum_error, np.abs(sums - 1).max(), atol=1e-15)
    if name in ROWS:
        assert found.details["prior"] == options.get("prior", "ridge")
    assert ("enclosure" in found.details) == (name in ROWS and name != "another solver")
    if "enclosure" in found.details:
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
    assert "given: 2 values from 0.5 to 1.25, 1 of 1 pairs recorded, gap 2.0e-09, row-sum error 3.0e-04" in repr(ratio)
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


REFITTED = {
    "none": {"prior": "none"},
    "simulator": {"prior": "simulator", "strength": 3.0},
    "ridge": {"prior": "simulator", "strength": 1.0, "ridge": 0.3},
    "the paper's ridge": {"prior": "simulator", "strength": 1.0, "ridge": 0.3, "toward": None},
    "box": {"prior": "simulator", "strength": 1.0, "lower": 0.7, "upper": 1.6},
    "linear": {"method": "linear", "features": FEATURES, "ridge": 0.01},
    "kernel": {"method": "kernel", "coordinates": PLACES, "ridge": 0.01},
}


@pytest.mark.parametrize("name", REFITTED)
def test_the_standard_error_by_refits(name):
    """sqrt(sum over rows of n Var(d value / d one more move)), the derivatives by central differences of refits."""
    counts = COUNTS + np.where(COUNTS.sum(axis=1, keepdims=True) > 0, 0.5, 0.0)  # no zeros in rows that have moves
    options, step = REFITTED[name], 1e-4
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
    assert_allclose(fit(counts, **options).log_standard_error(gradient), expected, rtol=5e-4)


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
