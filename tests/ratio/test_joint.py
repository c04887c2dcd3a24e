"""The joint program with a box on the ratio: nu beta_sa <= beta_sas' <= mu beta_sa."""

import numpy as np
import pytest
from helpers import rngs, rows_of
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, fit

import oee_tabular as oee
from oee_tabular import Transitions
from oee_tabular.ratio import _joint, joint, statements
from oee_tabular.ratio.arguments import Box

SIMULATOR, TARGET = oee.tasks.gridworld(4, 0.3), oee.tasks.gridworld(4, 0.1)
LOG = oee.sample_transitions(TARGET, np.full((16, 4), 1 / 64), 800, seed=0)
KNOWN = {"method": "joint", "simulator_data": "exact", "behavior_policy": oee.uniform_policy(SIMULATOR)}


def random_program(rng):
    lengths = rng.integers(1, 6, int(rng.integers(1, 6)))
    indptr = np.concatenate([[0], np.cumsum(lengths)])
    observed = rng.integers(0, 5, indptr[-1]) + 0.0
    observed[0] += 1
    probability = rng.integers(1, 9, indptr[-1]) + 0.0
    probability /= np.repeat(np.add.reduceat(probability, indptr[:-1]), lengths)
    share = rng.integers(1, 9, len(lengths)) + 0.0
    if len(lengths) > 1 and rng.random() < 0.2:
        share[0] = 0.0  # the simulator's data have none of this pair
    return joint.joint_program(
        observed,
        share / share.sum(),
        rows_of(probability, indptr),
        Box(float(10 ** rng.uniform(-3, -0.1)), float(10 ** rng.uniform(0.1, 2))),
        ridge=float(rng.choice([0.0, 10 ** rng.uniform(-4, 1)])),
        ratio_box=Box(
            float(rng.choice([0.0, rng.uniform(0.05, 0.95)])), float(rng.choice([np.inf, rng.uniform(1.05, 5.0)]))
        ),
    )


@given(rngs)
def test_random_programs_are_solved_and_certified(rng):
    program = random_program(rng)
    found = joint.solve_joint(program)
    pairs = np.repeat(found.pairs, np.diff(program.indptr))
    assert joint.joint_gaps(program, found).sum() < 1e-12
    for values in (found.moves, found.pairs):
        assert values.min() >= program.nu * (1 - 1e-12)
        assert values.max() <= program.mu * (1 + 1e-12)
    assert (found.moves >= program.ratio_lower * pairs * (1 - 1e-12)).all()
    if np.isfinite(program.ratio_upper):
        assert (found.moves <= program.ratio_upper * pairs * (1 + 1e-12)).all()
    mass = np.add.reduceat(program.q * found.moves, program.indptr[:-1])
    assert_allclose(mass, np.add.reduceat(program.q, program.indptr[:-1]) * found.pairs, rtol=1e-12)


def objective(program, point):
    """The value that is minimised."""
    value = 0.0
    for weights, masses, g in ((program.p, program.q, point.moves), (program.s, program.r, point.pairs)):
        seen = weights > 0
        value += float(masses @ g - weights[seen] @ np.log(g[seen]) + 0.5 * program.lam * g @ g)
    return value


def test_against_clarabel():
    for seed in range(25):
        program = random_program(np.random.default_rng(seed))
        ours = joint.solve_joint(program)
        point = statements.solve_joint(program)
        best, value = objective(program, ours), objective(program, point)
        gap = min(joint.joint_gaps(program, each).sum() for each in (point, point._replace(theta=-point.theta)))
        assert best <= value + 1e-9
        assert best >= value - gap - 1e-9  # the peer's dual bound is below our value
        assert gap < 1e-5


@given(rngs, st.sampled_from(["moves", "pairs", "theta"]), st.floats(0.01, 0.5))
def test_a_point_that_is_off_is_not_certified(rng, which, off):
    """Feasible points on the way to B = b = 1, and multipliers that are off: objective - gap stays below the optimum."""
    program = random_program(rng)
    found = joint.solve_joint(program)
    moves, pairs, theta = found.moves, found.pairs, found.theta
    if which == "theta":
        theta = theta + off
    else:
        moves, pairs = moves + off * (1.0 - moves), pairs + off * (1.0 - pairs)
    nothing = np.zeros(len(program.p))
    point = statements.JointPoint(moves, pairs, theta, nothing, nothing)
    gap = joint.joint_gaps(program, point).sum()
    assert objective(program, point) - gap <= objective(program, found) + 1e-11
    if which == "pairs":  # outside the constraint, or the box, by so much
        far = joint.joint_gaps(program, found._replace(pairs=found.pairs * (1.0 + off), eta=nothing, xi=nothing))
        big = np.add.reduceat(program.q, program.indptr[:-1])
        assert (far >= 0.99 * off * big * found.pairs - 1e-12).all()


@pytest.mark.parametrize("bounds", [{}, {"ratio_lower": 0.4, "ratio_upper": 1.5}])
def test_a_corrupted_joint_solver_is_found_out(monkeypatch, bounds):
    solve = _joint.solve_all

    def wrong(*arguments):
        moves, *rest = solve(*arguments)
        moves[3] *= 1.01
        return moves, *rest

    monkeypatch.setattr(_joint, "solve_all", wrong)
    assert oee.transition_ratio(LOG, SIMULATOR, **KNOWN, **bounds).gap > 1e-5


def test_zeta_stays_in_its_box():
    free = oee.transition_ratio(LOG, SIMULATOR, **KNOWN)
    assert free.values.data.min() < 0.4
    for bounds in ((0.4, 1.5), (0.4, None), (None, 1.5)):
        boxed, theirs = (
            oee.transition_ratio(LOG, SIMULATOR, ratio_lower=bounds[0], ratio_upper=bounds[1], solver=solver, **KNOWN)
            for solver in ("dual", "CLARABEL")
        )
        zeta = boxed.values.data
        assert zeta.min() >= (bounds[0] or 0.0) - 1e-12
        assert zeta.max() <= (bounds[1] or np.inf) + 1e-12
        assert boxed.row_sum_error < 1e-12
        assert boxed.gap < 1e-12
        assert theirs.gap < 1e-8
        visited = boxed.visited.reshape(-1)[np.repeat(np.arange(64), np.diff(SIMULATOR.transitions.indptr))]
        assert_allclose(zeta[visited], theirs.values.data[visited], atol=2e-4)


def test_a_box_that_does_not_bind_changes_nothing():
    free = oee.transition_ratio(LOG, SIMULATOR, **KNOWN)
    wide = oee.transition_ratio(LOG, SIMULATOR, ratio_lower=1e-4, ratio_upper=1e4, **KNOWN)
    assert_allclose(wide.values.data, free.values.data, atol=1e-7)
    assert wide.details["ratio_upper"] == 1e4


def test_moves_weighted_by_discount():
    """The paper's discounted d on both sides: each move counts discount^t."""
    log = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 200, 30, seed=0)
    data = oee.sample_episodes(SIMULATOR, oee.uniform_policy(SIMULATOR), 200, 30, seed=1)
    found = oee.transition_ratio(log, SIMULATOR, method="ratio_of_ratios", simulator_data=data, discount=0.9)
    weighted = (each.counts(16, 4, discount=0.9).toarray() for each in (log, data))
    by_hand = oee.density_ratio(*(w.reshape(-1) for w in weighted), lower=0.01, upper=10.0, toward=1.0)
    pairs = (each.counts(16, 4, discount=0.9).toarray().sum(axis=1) for each in (log, data))
    below = oee.density_ratio(*pairs, lower=0.01, upper=10.0, toward=1.0)
    quotient = by_hand.ratio.reshape(64, 16) / below.ratio[:, None]
    rows = np.repeat(np.arange(64), np.diff(SIMULATOR.transitions.indptr))
    seen = log.counts(16, 4).toarray()[rows, SIMULATOR.transitions.indices] > 0
    assert_allclose(found.values.data[seen], quotient[rows, SIMULATOR.transitions.indices][seen], rtol=1e-9)
    alike = oee.transition_ratio(log, SIMULATOR, method="ratio_of_ratios", simulator_data=data)
    assert np.abs(found.values.data - alike.values.data).max() > 0.05
    for how in ("exact", None):
        other = oee.transition_ratio(
            log, SIMULATOR, method="ratio_of_ratios", simulator_data=how, discount=0.9, seed=0,
            behavior_policy=oee.uniform_policy(SIMULATOR),
        )  # fmt: skip
        heavy = seen & (found.counts.reshape(-1)[rows] > 20)
        assert np.abs(other.values.data - found.values.data)[heavy].mean() < 0.3
    with pytest.raises(ValueError, match="discount must be left out where counts are given"):
        oee.transition_ratio(log.counts(16, 4), SIMULATOR, discount=0.9)
    bag = oee.Transitions(log.state, log.action, log.next_state)
    with pytest.raises(ValueError, match="log must have timesteps"):
        oee.transition_ratio(bag, SIMULATOR, discount=0.9)


def test_exact_data_are_discounted_too():
    """The simulator's exact discounted occupancy: with the simulator's own moves for a log, zeta tends to 1."""
    log = oee.sample_episodes(SIMULATOR, oee.uniform_policy(SIMULATOR), 4000, 30, seed=0)
    own = {"method": "ratio_of_ratios", "simulator_data": "exact", "behavior_policy": oee.uniform_policy(SIMULATOR)}
    found = oee.transition_ratio(log, SIMULATOR, discount=0.8, **own)
    share = oee.occupancy(SIMULATOR.with_discount(0.8), oee.uniform_policy(SIMULATOR), horizon=30, of="transition")
    assert share.data @ np.abs(found.values.data - 1.0) < 0.03
    alike = oee.transition_ratio(log, SIMULATOR, **own)  # undiscounted on both sides: its data are early moves too
    assert np.abs(alike.values.data - found.values.data).max() > 0.05


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
