"""Every certificate is that of the program as stated: it holds, it is tight, and it
rejects its own solver's errors.

The independent minimisation here knows the statement alone: bisections on the slope of
each entry, and on the multiplier.
"""

import importlib

import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.ratio import dual, statements

SIMULATOR = oee.tasks.gridworld(4, 0.3)
TARGET = oee.tasks.gridworld(4, 0.1)
LOG = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), 800, seed=0)


def statement(rng):
    """p, q with zeros on either side and on both, and options for ``density_ratio``;
    bounded from below.
    """
    n = int(rng.integers(2, 7))
    p, q = (rng.integers(0, 4, n) * (rng.random(n) < 0.7) + 0.0 for _ in range(2))
    p[rng.integers(n)] += 1
    q[rng.integers(n)] += 1
    options = {
        "lower": float(rng.choice([0.0, 0.3, 0.9])),
        "upper": float(rng.choice([1.2, 2.5, 40.0])),
        "ridge": float(rng.choice([0.0, 0.2, 3.0])),
        "toward": [None, 0.0, 1.0, 0.5, 2.0][int(rng.integers(5))],
        "normalized": bool(rng.random() < 0.5),
        "loss": str(rng.choice(["kl", "chi2"])),
    }
    if options["toward"] is None and options["ridge"] > 0 and rng.random() < 0.5:
        options["upper"] = None
    return p, q, options


def optimum(p, q, options):
    """The program's least value by strong duality, max_eta min_g: nested bisections,
    nothing of the package's.
    """
    known = (p > 0) | (q > 0)
    p = (p / p.sum())[known]
    q = (q / q.sum())[known]
    ridge = options["ridge"]
    toward = options["toward"]
    squares = options["loss"] == "chi2"
    bend, center = (
        (np.full(len(p), ridge), 0.0) if toward is None else (ridge * q, toward)
    )
    lower = options["lower"]
    upper = 1e4 if options["upper"] is None else options["upper"]

    def at(eta):
        """The Lagrangian's least value, and sum q g - 1 there."""
        low = np.full(len(p), lower)
        high = np.full(len(p), upper)
        for _ in range(60):
            g = 0.5 * (low + high)
            slope = (
                bend * (g - center)
                + eta * q
                + (q * g - p if squares else q - p / np.maximum(g, 1e-300))
            )
            low = np.where(slope < 0, g, low)
            high = np.where(slope < 0, high, g)
        g = np.where(
            low == lower, lower, np.where(high == upper, upper, 0.5 * (low + high))
        )
        fits = (
            q * g**2 / 2 - p * g
            if squares
            else q * g - np.where(p > 0, p * np.log(np.maximum(g, 1e-300)), 0.0)
        )
        miss = float(q @ g) - 1.0
        return float((fits + bend * (g - center) ** 2 / 2).sum()) + eta * miss, miss

    if not options["normalized"]:
        return at(0.0)[0]
    left = -1e4
    right = 1e4
    for _ in range(60):
        middle = 0.5 * (left + right)
        left, right = (middle, right) if at(middle)[1] > 0 else (left, middle)
    return max(at(left)[0], at(right)[0])


def value_of(g, p, q, options):
    """The objective as the docstring of ``density_ratio`` writes it."""
    known = (p > 0) | (q > 0)
    p = (p / p.sum())[known]
    q = (q / q.sum())[known]
    g = g[known]
    gap = g if options["toward"] is None else g - options["toward"]
    penalty = (
        options["ridge"]
        / 2
        * ((gap**2).sum() if options["toward"] is None else q @ gap**2)
    )
    if options["loss"] == "chi2":
        return q @ g**2 / 2 - p @ g + penalty
    return q @ g - p[p > 0] @ np.log(g[p > 0]) + penalty


def solved(rng, solver="dual"):
    p, q, options = statement(rng)
    return p, q, options, oee.density_ratio(p, q, solver=solver, **options)


@given(rngs)
def test_the_minimum_with_zeros_in_p_and_in_q(rng):
    p, q, options, fit = solved(rng)
    best = optimum(p, q, options)
    size = max(1.0, abs(best))
    assert_allclose(
        fit.objective, value_of(fit.ratio, p, q, options), rtol=1e-10, atol=1e-12 * size
    )
    assert_allclose(fit.objective, best, rtol=0, atol=1e-9 * size)
    assert 0 <= fit.gap < 1e-12 * size
    assert fit.dual_bound <= best + 1e-9 * size
    if options["normalized"]:
        assert_allclose(q / q.sum() @ fit.ratio, 1.0, rtol=1e-12)
    assert fit.ratio.min() >= options["lower"]
    assert fit.ratio.max() <= (options["upper"] or np.inf)


@pytest.mark.parametrize("seed", range(30))
def test_clarabel_has_the_same_minimum(seed):
    p, q, options, fit = solved(np.random.default_rng(seed), "CLARABEL")
    best = optimum(p, q, options)
    assert fit.gap < 1e-6
    assert_allclose(fit.objective, best, rtol=0, atol=1e-6)
    assert fit.objective - fit.gap <= best + 1e-9


# ---- the certificates themselves
# ---------------------------------------------------------------------------------


@given(rngs, st.floats(-0.4, 0.4))
def test_no_feasible_point_is_called_nearer_to_the_minimum_than_it_is(rng, off):
    """Whatever the point and the multiplier: objective - gap is below the optimum."""
    p, q, options, fit = solved(rng)
    known = (p > 0) | (q > 0)
    ps = (p / p.sum())[known]
    qs = (q / q.sum())[known]
    toward = options["toward"]
    bend = np.full(len(ps), options["ridge"]) * (1.0 if toward is None else qs)
    program = dual.Coordinates(
        ps, qs, bend, np.full(len(ps), toward or 0.0), squares=options["loss"] == "chi2"
    )
    low = options["lower"]
    high = np.inf if options["upper"] is None else options["upper"]
    g = fit.ratio[known]
    moved = np.clip(g * np.exp(rng.normal(size=len(g)) * off), max(low, 1e-9), high)
    if options["normalized"]:
        # towards 1, which is feasible
        moved = g + min(1.0, abs(off)) * (np.ones(len(g)) - g)
    m = np.array([1.0 + fit.normalizer + off]) if options["normalized"] else None
    indptr = np.array([0, len(g)])
    gap = float(dual.row_gaps(program, moved, m, low, high, indptr)[0])
    best = optimum(p, q, options)
    assert dual.objective(moved, program) - gap <= best + 1e-9 * max(1.0, abs(best))
    outside = g.copy()
    outside[0] = low - 0.1
    # off by so much
    assert dual.row_gaps(program, outside, m, low, high, indptr)[0] > 0.099


@pytest.mark.parametrize("ridge", [0.0, 0.1])
def test_corrupted_rows_are_found_out(monkeypatch, ridge):
    """A kernel that leaves one entry of one row half a percent off."""
    solve = importlib.import_module("oee_tabular.ratio.dual").fill_rows

    def wrong(p, q, a, pull, lower, upper, indptr, g, *rest):
        solve(p, q, a, pull, lower, upper, indptr, g, *rest)
        g[7] *= 1.005

    options = {
        "prior": "simulator",
        "lower": 0.01,
        "upper": 10.0,
        "ridge": ridge,
        "toward": 1.0,
    }
    right = oee.transition_ratio(LOG, SIMULATOR, **options).gap
    monkeypatch.setattr("oee_tabular.ratio.dual.fill_rows", wrong)
    assert oee.transition_ratio(LOG, SIMULATOR, **options).gap > 1e-7 > 1e3 * right


@pytest.mark.parametrize("ridge", [0.0, 0.1])
@pytest.mark.parametrize("change", ["weights", "multipliers", "both"])
def test_a_class_is_certified_at_the_weights_that_are_handed_over(
    monkeypatch, ridge, change
):
    """w that are off, multipliers that are off."""
    x = np.linspace(-1.0, 1.0, 30)
    p = np.exp(-((x - 0.3) ** 2))
    q = np.ones(30)
    features = np.column_stack([np.ones(30), x])
    options = {
        "functions": oee.ratio.Linear(features),
        "lower": 0.05,
        "upper": 9.0,
        "ridge": ridge,
        "normalized": False,
    }
    right = oee.density_ratio(p, q, **options)
    solve = statements.solve_linear
    assert right.gap < 1e-11

    def wrong(program, **keywords):
        weights, tie, eta = solve(program, **keywords)
        if change != "multipliers":
            weights = weights + 1e-3
        if change != "weights":
            tie = tie + 1e-3 * x**2
        return weights, tie, eta

    monkeypatch.setattr(statements, "solve_linear", wrong)
    fit = oee.density_ratio(p, q, **options)
    assert fit.gap > 1e-8
    assert fit.dual_bound <= right.objective + 1e-12
