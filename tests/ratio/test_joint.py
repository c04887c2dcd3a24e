"""The joint program, with and without a box on the ratio: ratio_lower beta_sa <= beta_sas' <= ratio_upper beta_sa."""

import importlib

import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, POLICY, fit
from scipy import sparse

import oee_tabular as oee
from oee_tabular import Transitions

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)
LOG = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), 800, seed=0)
KNOWN = {"method": "joint", "simulator_data": "exact", "behavior_policy": oee.uniform_policy(SIMULATOR)}


def random_program(rng):
    """Counts, a simulator with rows of one to six next states, and options for ``transition_ratio``."""
    n = int(rng.integers(2, 6))
    rows = rng.integers(1, 9, (n, 2, n)) * (rng.random((n, 2, n)) < 0.7) + np.eye(n)[:, None]
    rows /= rows.sum(axis=2, keepdims=True)
    simulator = oee.FiniteMDP(rows, np.zeros(n), np.full(n, 1 / n), 0.9)
    counts = rng.integers(0, 5, (2 * n, n)) * (rows.reshape(2 * n, n) > 0) + 0.0
    counts[0, 0] += 1
    options = {
        "lower": float(10 ** rng.uniform(-3, -0.1)),
        "upper": float(10 ** rng.uniform(0.1, 2)),
        "ridge": float(rng.choice([0.0, 10 ** rng.uniform(-4, 1)])),
        "ratio_lower": float(rng.choice([0.0, rng.uniform(0.05, 0.95)])),
        "ratio_upper": float(rng.choice([np.inf, rng.uniform(1.05, 5.0)])),
        "behavior_policy": oee.uniform_policy(simulator),
    }
    return sparse.csr_array(counts), simulator, options


def value(counts, simulator, options, found):
    """The objective as it is written, at the two betas of a fit, and what they miss of the constraints."""
    share = oee.occupancy(simulator.with_discount(1.0), options["behavior_policy"], horizon=1000, of="transition")
    share, rows = share.toarray(), np.repeat(np.arange(counts.shape[0]), np.diff(simulator.transitions.indptr))
    absorbing = np.repeat(simulator.absorbing(), 2)
    if not absorbing.all():
        share[absorbing] = 0.0
    moves, pairs = found.details["moves"], found.details["pairs"]
    columns = simulator.transitions.indices
    r = share.sum(axis=1) / share.sum()
    p, q = counts.toarray()[rows, columns] / counts.sum(), r[rows] * simulator.transitions.data
    s = np.bincount(rows, p, counts.shape[0])
    total = 0.0
    for weights, masses, g in ((p, q, moves), (s, r, pairs)):
        seen = weights > 0
        total += masses @ g - weights[seen] @ np.log(g[seen]) + 0.5 * options["ridge"] * g @ g
    assert_allclose(np.bincount(rows, q * moves, counts.shape[0]), r * pairs, atol=1e-6)
    return total


@given(rngs)
def test_random_programs_are_solved_and_certified(rng):
    counts, simulator, options = random_program(rng)
    found = oee.transition_ratio(counts, simulator, method="joint", simulator_data="exact", **options)
    pairs = np.repeat(found.details["pairs"], np.diff(simulator.transitions.indptr))
    assert 0 <= found.gap < 1e-12
    for values in (found.details["moves"], found.details["pairs"]):
        assert values.min() >= options["lower"] * (1 - 1e-12)
        assert values.max() <= options["upper"] * (1 + 1e-12)
    assert (found.details["moves"] >= options["ratio_lower"] * pairs * (1 - 1e-12)).all()
    assert (found.details["moves"] <= options["ratio_upper"] * pairs * (1 + 1e-12)).all()


@pytest.mark.parametrize("seed", range(15))
def test_against_clarabel(seed):
    counts, simulator, options = random_program(np.random.default_rng(seed))
    ours, theirs = (
        oee.transition_ratio(counts, simulator, method="joint", simulator_data="exact", solver=solver, **options)
        for solver in ("dual", "CLARABEL")
    )
    best, other = (value(counts, simulator, options, found) for found in (ours, theirs))
    assert other - theirs.gap - 1e-9 <= best <= other + 1e-9  # their dual bound is below our value
    assert theirs.gap < 1e-5


@pytest.mark.parametrize("bounds", [{}, {"ratio_lower": 0.4, "ratio_upper": 1.5}])
@pytest.mark.parametrize("part", range(3), ids=["moves", "pairs", "theta"])
def test_a_corrupted_joint_solver_is_found_out_in_every_row(monkeypatch, bounds, part):
    solve = importlib.import_module("oee_tabular.ratio.joint").solve_all

    def gap_of(*places):
        def wrong(program):
            parts = solve(program)
            for place in places:
                parts[part][place] = 1.01 * parts[part][place] + 0.01
            return parts

        monkeypatch.setattr("oee_tabular.ratio.joint.solve_all", wrong)
        return oee.transition_ratio(LOG, SIMULATOR, **KNOWN, **bounds).gap

    assert gap_of(3) > 1e-7
    assert_allclose(gap_of(3, 40), gap_of(3) + gap_of(40), rtol=1e-6)
    assert gap_of(40) > 1e-9


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
    counts[4] = [1.0, 3.0, 0.0]
    inside = fit(counts, method="joint", simulator_data=some, ridge=0.5)  # no ratio is at its bounds
    assert_array_equal(inside.values.toarray()[4], np.ones(3))
    one = np.eye(6, 3) * [3, 0, 0]  # rows without transitions, and no upper bound
    alone = fit(one, method="joint", simulator_data="exact", lower=0.1, upper=np.inf, behavior_policy=POLICY)
    assert np.isfinite(alone.values.data).all()
    assert (alone.gap, alone.row_sum_error) == pytest.approx((0.0, 0.0), abs=1e-12)
    text = r"^simulator_data must cover the log's \(s, a\), or upper be finite: the program is unbounded at 1 of them$"
    with pytest.raises(ValueError, match=text):
        fit(counts, method="joint", simulator_data=some, upper=np.inf)
