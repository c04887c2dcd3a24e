"""The quotient of two ratios, and the data of the simulator that it is fitted against."""

import importlib

import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, LOG, POLICY, SIMULATOR, fit
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions


@pytest.mark.parametrize("method", ["ratio_of_ratios", "joint"])
def test_the_ridge_reaches_both_betas(method):
    """A strong ridge towards 1 (the quotient) or 0 with the sums kept (joint) makes
    zeta nearly 1.
    """
    options = {"method": method, "simulator_data": "exact", "behavior_policy": POLICY}
    free, bent = (
        fit(COUNTS + 1.0, ridge=ridge, **options).values.data for ridge in (None, 1e4)
    )
    assert np.abs(free - 1).max() > 0.3
    assert np.abs(bent - 1).max() < 0.1
    assert_array_equal(free, fit(COUNTS + 1.0, ridge=0.0, **options).values.data)
    of_n, given_number = (
        fit(COUNTS + 1.0, ridge=r, **options).values.data
        for r in (lambda n: 5.0 / n, 5.0 / 61.0)
    )
    assert_allclose(of_n, given_number, rtol=1e-12)


def test_the_quotient_without_a_box_is_that_of_frequencies():
    """(n_x / q_x) / (n_sa / q_sa), normalised on each side; 1 where neither side has
    the move.
    """
    other = np.array(
        [[2, 2, 4], [1, 0, 3], [5, 5, 2], [1, 1, 1], [0, 0, 0], [4, 0, 4]], dtype=float
    )
    state = []
    action = []
    following = []
    for row, j in np.argwhere(other > 0):
        for column, number in zip(
            (state, action, following), (row // 2, row % 2, j), strict=True
        ):
            column.extend([number] * int(other[row, j]))
    data = Transitions(state, action, following)
    counts = np.where(other > 0, COUNTS, 0.0)
    found = fit(
        counts, method="ratio_of_ratios", simulator_data=data, lower=0.0, upper=np.inf
    )
    n = counts.sum(axis=1, keepdims=True)
    m = other.sum(axis=1, keepdims=True)
    expected = np.divide(
        counts * m, other * n, out=np.ones((6, 3)), where=(other > 0) & (n > 0)
    )
    assert_allclose(found.values.toarray(), expected, rtol=1e-8)
    facts = found.details
    assert facts["undetermined_moves"] == 5
    assert facts["moves_only_in_log"] == 0
    p = counts[counts > 0] / counts.sum()
    q = other[counts > 0] / other.sum()
    assert_allclose(facts["divergence_moves"], p @ np.log(p / q), rtol=1e-8)
    pairs = [
        (a, b)
        for a, b in zip(n[:, 0] / n.sum(), m[:, 0] / m.sum(), strict=True)
        if a > 0
    ]
    assert_allclose(
        facts["divergence_pairs"], sum(a * np.log(a / b) for a, b in pairs), rtol=1e-8
    )
    boxed = fit(method="ratio_of_ratios", simulator_data=data, lower=0.5, upper=1.5)
    assert boxed.details["moves_only_in_log"] == 1
    assert (boxed.details["lower"], boxed.details["upper"]) == (0.5, 1.5)
    moves = oee.density_ratio(
        COUNTS.reshape(-1), other.reshape(-1), lower=0.5, upper=1.5, toward=1.0
    ).ratio
    low = (moves <= 0.5).mean()
    high = (moves >= 1.5).mean()
    assert low > 0
    assert high > 0
    assert_allclose(boxed.details["share_at_the_box"], low + high)


@pytest.mark.parametrize("box", [(0.5, 1.5), (0.01, 1.2), (0.8, 10.0)])
def test_the_box_holds_both_betas(box):
    """beta(s, a) too, so that the quotient lies in [nu / mu, mu / nu] (eq. 4.4)."""
    counts = COUNTS + 1.0
    # a pair that the simulator's data have rarely, and one that they have often
    counts[0] *= 50.0
    counts[1] /= 50.0
    lower, upper = box
    data = oee.sample_episodes(SIMULATOR, POLICY, 200, 8, seed=1)
    found = fit(
        counts,
        method="ratio_of_ratios",
        simulator_data=data,
        lower=lower,
        upper=upper,
    )
    moves, pairs = found.details["beta"]
    for beta in (moves, pairs):
        assert beta.ratio.min() >= lower * (1 - 1e-12)
        assert beta.ratio.max() <= upper * (1 + 1e-12)
    n_pairs = counts.sum(axis=1)
    q = data.counts(3, 2).sum(axis=1)
    free = oee.density_ratio(n_pairs, q).ratio
    assert free.min() < lower or free.max() > upper  # the box binds
    own = oee.density_ratio(n_pairs, q, lower=lower, upper=upper, toward=1.0)
    assert_allclose(pairs.ratio, own.ratio, rtol=1e-9)
    assert found.values.data.min() >= lower / upper * (1 - 1e-9)
    assert found.values.data.max() <= upper / lower * (1 + 1e-9)


def test_data_of_the_simulator():
    """Exact occupancies over the log's longest episode under its estimated policy;
    samples of the log's size, by the seed.
    """
    options = {"lower": 0.0, "upper": np.inf, "method": "ratio_of_ratios"}
    # without one, the weights of q cancel
    box = {"lower": 0.5, "upper": 1.5, "toward": 1.0}
    for discount in (None, 0.5):
        exact = oee.transition_ratio(
            LOG, SIMULATOR, simulator_data="exact", discount=discount, **options | box
        )
        p = LOG.counts(3, 2, discount=discount).toarray().reshape(-1)
        actions = p.reshape(3, 2, 3).sum(axis=2)
        behavior = actions / actions.sum(axis=1, keepdims=True)
        weighted = SIMULATOR.with_discount(discount or 1.0)
        q = oee.occupancy(weighted, behavior, horizon=8, of="transition").data
        moves, pairs = (
            oee.density_ratio(
                p.reshape(-1, k).sum(axis=1), q.reshape(-1, k).sum(axis=1), **box
            )
            for k in (1, 3)
        )
        assert_allclose(
            exact.values.data, moves.ratio / np.repeat(pairs.ratio, 3), rtol=1e-9
        )
    data = oee.sample_episodes(SIMULATOR, POLICY, 200, 8, seed=1)
    given = oee.transition_ratio(
        LOG, SIMULATOR, simulator_data=data, discount=0.5, **options
    )
    p, q = (
        each.counts(3, 2, discount=0.5).toarray().reshape(-1) for each in (LOG, data)
    )
    moves, pairs = (
        oee.density_ratio(p.reshape(-1, k).sum(axis=1), q.reshape(-1, k).sum(axis=1))
        for k in (1, 3)
    )
    assert_allclose(
        given.values.data, moves.ratio / np.repeat(pairs.ratio, 3), rtol=1e-9
    )
    drawn, again, other = (
        oee.transition_ratio(LOG, SIMULATOR, seed=k, **options) for k in (3, 3, 4)
    )
    assert_array_equal(drawn.values.data, again.values.data)
    assert np.abs(drawn.values.data - other.values.data).max() > 1e-3
    assert drawn.details["beta"][0].q_total == len(LOG)


def test_logs_stop_where_an_episode_is_over():
    over = FiniteMDP(np.array([[[0.5, 0.5]], [[0.0, 1.0]]]), [1.0, 0.0], [1, 0], 0.9)
    fit = oee.transition_ratio(
        sparse.csr_array([[1.0, 1.0], [0.0, 0.0]]),
        over,
        method="ratio_of_ratios",
        simulator_data="exact",
    )
    assert_allclose(fit.values.data, 1.0, rtol=1e-12)
    assert fit.details["undetermined_moves"] == 1


# ---- the joint program, with and without a box on the ratio: ratio_lower beta_sa <=
# beta_sas' <= ratio_upper beta_sa
GRID = oee.tasks.gridworld(4, 0.3)
GRID_TARGET = oee.tasks.gridworld(4, 0.1)
GRID_LOG = oee.sample_transitions(GRID_TARGET, np.full((16, 4), 1 / 64), 800, seed=0)
KNOWN = {
    "method": "joint",
    "simulator_data": "exact",
    "behavior_policy": oee.uniform_policy(GRID),
}


def random_program(rng):
    """Counts, a simulator with rows of one to six next states, and options for
    ``transition_ratio``.
    """
    n = int(rng.integers(2, 6))
    rows = (
        rng.integers(1, 9, (n, 2, n)) * (rng.random((n, 2, n)) < 0.7)
        + np.eye(n)[:, None]
    )
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
    """The objective as it is written, at the two betas of a fit, and what they miss of
    the constraints.
    """
    share = oee.occupancy(
        simulator.with_discount(1.0),
        options["behavior_policy"],
        horizon=1000,
        of="transition",
    )
    share = share.toarray()
    rows = np.repeat(np.arange(counts.shape[0]), np.diff(simulator.transitions.indptr))
    absorbing = np.repeat(simulator.absorbing(), 2)
    if not absorbing.all():
        share[absorbing] = 0.0
    moves = found.details["moves"]
    pairs = found.details["pairs"]
    columns = simulator.transitions.indices
    r = share.sum(axis=1) / share.sum()
    p = counts.toarray()[rows, columns] / counts.sum()
    q = r[rows] * simulator.transitions.data
    s = np.bincount(rows, p, counts.shape[0])
    total = 0.0
    for weights, masses, g in ((p, q, moves), (s, r, pairs)):
        seen = weights > 0
        total += (
            masses @ g
            - weights[seen] @ np.log(g[seen])
            + 0.5 * options["ridge"] * g @ g
        )
    assert_allclose(np.bincount(rows, q * moves, counts.shape[0]), r * pairs, atol=1e-6)
    return total


@given(rngs)
def test_random_programs_are_solved_and_certified(rng):
    counts, simulator, options = random_program(rng)
    found = oee.transition_ratio(
        counts, simulator, method="joint", simulator_data="exact", **options
    )
    pairs = np.repeat(found.details["pairs"], np.diff(simulator.transitions.indptr))
    assert 0 <= found.gap < 1e-12
    for values in (found.details["moves"], found.details["pairs"]):
        assert values.min() >= options["lower"] * (1 - 1e-12)
        assert values.max() <= options["upper"] * (1 + 1e-12)
    assert (
        found.details["moves"] >= options["ratio_lower"] * pairs * (1 - 1e-12)
    ).all()
    assert (
        found.details["moves"] <= options["ratio_upper"] * pairs * (1 + 1e-12)
    ).all()


@pytest.mark.parametrize("seed", range(15))
def test_against_clarabel(seed):
    counts, simulator, options = random_program(np.random.default_rng(seed))
    ours, theirs = (
        oee.transition_ratio(
            counts,
            simulator,
            method="joint",
            simulator_data="exact",
            solver=solver,
            **options,
        )
        for solver in ("dual", "CLARABEL")
    )
    best, other = (value(counts, simulator, options, found) for found in (ours, theirs))
    # their dual bound is below our value
    assert other - theirs.gap - 1e-9 <= best <= other + 1e-9
    assert theirs.gap < 1e-5


@pytest.mark.parametrize("bounds", [{}, {"ratio_lower": 0.4, "ratio_upper": 1.5}])
@pytest.mark.parametrize("part", range(3), ids=["moves", "pairs", "theta"])
def test_a_corrupted_joint_solver_is_found_out_in_every_row(monkeypatch, bounds, part):
    solve = importlib.import_module("oee_tabular.ratio.joint").solve_program

    def gap_of(*places):
        def wrong(program):
            parts = solve(program)
            for place in places:
                parts[part][place] = 1.01 * parts[part][place] + 0.01
            return parts

        monkeypatch.setattr("oee_tabular.ratio.joint.solve_program", wrong)
        return oee.transition_ratio(GRID_LOG, GRID, **KNOWN, **bounds).gap

    assert gap_of(3) > 1e-7
    assert_allclose(gap_of(3, 40), gap_of(3) + gap_of(40), rtol=1e-6)
    assert gap_of(40) > 1e-9


def test_pairs_that_the_simulator_s_data_lack():
    """Counted where the log has them; zeta is 1 there; without an upper bound there is
    no program.
    """
    some = Transitions([0, 0, 1, 2], [0, 1, 0, 1], [0, 1, 2, 0])
    counts = COUNTS.copy()
    # neither side has the row (1, 1); only the log has none of (2, 0); rows 0, 1, 2, 5
    # on both
    counts[3] = 0.0
    found = fit(counts, method="joint", simulator_data=some)
    assert found.details["pairs_without_simulator_data"] == 0
    counts[4] = 1.0
    found = fit(counts, method="joint", simulator_data=some)
    assert found.details["pairs_without_simulator_data"] == 1
    assert_array_equal(found.values.toarray()[[3, 4]], np.ones((2, 3)))
    counts[4] = [1.0, 3.0, 0.0]
    # no ratio is at its bounds
    inside = fit(counts, method="joint", simulator_data=some, ridge=0.5)
    assert_array_equal(inside.values.toarray()[4], np.ones(3))
    one = np.eye(6, 3) * [3, 0, 0]  # rows without transitions, and no upper bound
    alone = fit(
        one,
        method="joint",
        simulator_data="exact",
        lower=0.1,
        upper=np.inf,
        behavior_policy=POLICY,
    )
    assert np.isfinite(alone.values.data).all()
    assert (alone.gap, alone.row_sum_error) == pytest.approx((0.0, 0.0), abs=1e-12)
    text = (
        r"^simulator_data must cover the log's \(s, a\), or upper be finite: the"
        r" program is unbounded at 1 of them$"
    )
    with pytest.raises(ValueError, match=text):
        fit(counts, method="joint", simulator_data=some, upper=np.inf)
