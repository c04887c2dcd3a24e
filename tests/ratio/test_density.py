import numpy as np
import pytest
from helpers import rngs
from hypothesis import given
from numpy.testing import assert_allclose

import oee_tabular as oee
from oee_tabular.ratio import statements


def test_with_a_box_the_two_ratios_agree_to_1e_6():
    """The paper's grid, 1572 triples, counts of 10 000 moves against exact occupancies,
    box [0.1, 4], ridges.
    """
    simulator = oee.tasks.gridworld(10, 0.3)
    target = oee.tasks.gridworld(10, 0.1)
    uniform = oee.uniform_policy(simulator)
    shares = oee.occupancy(
        simulator.with_discount(1.0), uniform, horizon=200, of="transition"
    ).data[:1572]
    log = oee.sample_episodes(target, uniform, 60, 1000, seed=0).draw(10_000, seed=0)
    counts = log.counts(100, 4)
    p = np.asarray(
        counts[
            np.repeat(np.arange(400), np.diff(simulator.transitions.indptr)),
            simulator.transitions.indices,
        ]
    )
    for options in (
        {},
        {"normalized": False},
        {"ridge": 0.1, "toward": 1.0},
        {"ridge": 1e-4},
    ):
        ours, theirs = (
            oee.density_ratio(
                p.reshape(-1)[:1572],
                shares,
                lower=0.1,
                upper=4.0,
                solver=solver,
                **options,
            )
            for solver in ("dual", "CLARABEL")
        )
        assert ours.gap < 1e-12
        assert ours.objective <= theirs.objective + 1e-9
        assert_allclose(ours.ratio, theirs.ratio, rtol=0, atol=1e-6)


@given(rngs)
def test_closed_forms(rng):
    """Unconstrained p/q; box clip(p/q); ridge 2p / (q + sqrt(q^2 + 4 lam p))."""
    n = int(rng.integers(1, 20))
    p = rng.integers(0, 9, n) + 0.0
    q = rng.integers(1, 9, n) + 0.0
    p[0] += 1
    ps = p / p.sum()
    qs = q / q.sum()
    assert_allclose(oee.density_ratio(p, q).ratio, ps / qs, rtol=1e-14)
    boxed = oee.density_ratio(p, q, lower=0.5, upper=1.25, normalized=False).ratio
    assert_allclose(boxed, np.clip(ps / qs, 0.5, 1.25), rtol=1e-14)
    ridged = oee.density_ratio(p, q, ridge=0.3, normalized=False).ratio
    assert_allclose(ridged, 2 * ps / (qs + np.sqrt(qs**2 + 4 * 0.3 * ps)), rtol=1e-14)
    both = oee.density_ratio(p, q, lower=0.5, upper=1.25)
    # at -1 the unobserved cells make up what is lacking
    if both.normalizer > -1 + 1e-9:
        assert_allclose(
            both.ratio,
            np.clip(ps / ((1 + both.normalizer) * qs), 0.5, 1.25),
            rtol=0,
            atol=1e-12,
        )


def test_zeros():
    """p = q = 0 is undetermined and gets 1; q = 0 < p sits at the upper bound; p = 0 <
    q at the lower.
    """
    fit = oee.density_ratio([0, 2, 0, 2], [0, 0, 1, 1], lower=0.1, upper=4.0)
    assert fit.n_undetermined == 1
    assert_allclose(fit.ratio, [1.0, 4.0, 0.1, 1.9], rtol=1e-12)
    assert fit.gap < 1e-14
    assert oee.density_ratio([0, 2], [0, 2], ridge=1.0, toward=0.5).ratio[0] == 0.5


def test_a_jump_is_filled_in():
    """Both observed cells hit the upper bound with sum q g = 0.4 < 1: the unobserved
    cell makes up the rest.
    """
    fit = oee.density_ratio([1, 1, 0], [0.1, 0.1, 0.8], upper=2.0)
    assert_allclose(fit.ratio, [2.0, 2.0, 0.75], rtol=1e-12)
    assert_allclose(fit.normalizer, -1.0)
    assert fit.gap < 1e-14


@pytest.mark.parametrize(
    "bounds",
    [
        {"lower": 1.0},
        {"upper": 1.0},
        {"lower": 1.0, "upper": 1.0},
        {"lower": 1 - 1e-12},
    ],
)
def test_a_box_that_leaves_one_point(bounds):
    fit = oee.density_ratio([3, 1, 0], [1, 1, 2], **bounds)
    assert_allclose(
        fit.ratio,
        np.ones(3),
        rtol=0,
        atol=1e-11 * (bounds["lower"] < 1 if "lower" in bounds else 0),
    )
    assert (fit.status == "optimal") == (fit.gap <= 1e-8)


# 20 000: the largest gap is 3e-16 of 19 792 problems
@pytest.mark.parametrize("n", [1500])
def test_hard_scales_are_solved(n):
    """Scales 1e-6 to 1e6, zeros, boxes 1e-4 to 1e4, ridges 1e-8 to 1e4: certified
    whenever both sides have counts.
    """
    rng = np.random.default_rng(0)
    for _ in range(n):
        size = int(rng.integers(1, 60))
        p, q = (
            rng.integers(0, 4, size) * 10 ** rng.uniform(-6, 6, size) for _ in range(2)
        )
        options = {
            "lower": 10 ** rng.uniform(-4, 0) if rng.random() < 0.7 else None,
            "upper": 10 ** rng.uniform(0, 4),
            "ridge": float(rng.choice([0.0, 10 ** rng.uniform(-8, 4)])),
            "toward": [None, 0.0, 1.0, 2.0][int(rng.integers(4))],
            "normalized": bool(rng.random() < 0.8),
            "loss": "kl" if rng.random() < 0.8 else "chi2",
        }
        if p.sum() == 0 or q.sum() == 0:
            continue
        fit = oee.density_ratio(p, q, **options)
        assert fit.gap / max(1.0, abs(fit.objective), abs(fit.normalizer)) < 1e-14
        if options["normalized"]:
            assert_allclose(q / q.sum() @ fit.ratio, 1.0, rtol=1e-10)


def test_a_solver_that_stops_short_hands_on_no_numbers(monkeypatch):
    monkeypatch.setattr(
        statements, "clarabel_options", lambda tolerance: {"max_iter": 2}
    )
    with pytest.raises(
        RuntimeError,
        match=r"CLARABEL ended with status .*, not 'optimal'; its numbers are not used",
    ):
        oee.density_ratio([3, 1, 4], [2, 2, 4], upper=1.4, solver="CLARABEL")


@pytest.mark.parametrize(
    ("p", "q", "options"),
    [
        ([1e-200, 1], [0.5, 0.5], {}),
        ([0, 0, 20, 0], [1e-297, 1.9e-16, 0.007, 7e-11], {"ridge": 1.0}),
        ([1, 1], [1e-300, 1], {"upper": 1e6}),
    ],
)
def test_numbers_that_underflow_are_solved(p, q, options):
    fit = oee.density_ratio(p, q, **options)
    assert np.isfinite(fit.ratio).all()
    assert 0 <= fit.gap < 1e-12


def test_assumptions_that_hold_and_fail():
    found = oee.check_assumptions([1, 3, 0, 4], [2, 2, 2, 2], lower=0.5, upper=1.5)
    assert found.box_contains_one
    assert (
        found.inside,
        found.supported,
        found.below,
        found.above,
        found.unsupported,
    ) == (False, True, 1, 1, 0)
    assert (found.smallest, found.largest) == (0.0, 2.0)
    assert_allclose(found.renyi_infinity, np.log(2.0))
    lost = oee.check_assumptions([1, 1], [1, 0], lower=1.0, upper=np.inf)
    assert (
        lost.box_contains_one,
        lost.supported,
        lost.unsupported,
        lost.renyi_infinity,
    ) == (False, False, 1, np.inf)
    assert "nu <= p/q <= mu: fails (1 entries below, 0 above)" in str(lost)
    assert not oee.check_assumptions(
        [1, 1], [1, 1], lower=0.0, upper=1.0
    ).box_contains_one
    assert oee.check_assumptions([1, 3], [2, 2], lower=0.5, upper=1.5).inside
