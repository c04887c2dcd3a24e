"""What a fit of zeta says: its details, its models, its standard error and its one-step
correction.
"""

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from ratio.problem import COUNTS, FEATURES, PLACES, SIMULATOR, TARGET, fit
from scipy import sparse

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.estimators import OffEnvironment
from oee_tabular.ratio import Conditional, InClass, Joint, Network, Quotient, Sgd, Tied
from oee_tabular.ratio.statements import SolverStatusError

FITS = {
    "the default": {},
    "the tilt": {"prior": "tilt"},
    "the simulator": {"prior": "simulator"},
    "a strength": {"prior": "simulator", "strength": 2.0},
    "no prior": {"prior": "none"},
    "a chosen ridge": {"prior": "none", "ridge": "loo"},
    "another solver": {"prior": "none", "solver": "CLARABEL"},
    "linear": {"method": "linear", "features": FEATURES},
    "kernel": {"method": "kernel", "coordinates": PLACES},
    "quotient": {"method": "ratio_of_ratios", "simulator_data": "exact"},
    "joint": {"method": "joint", "simulator_data": "exact"},
}
ROWS = [*FITS][:7]


@pytest.mark.parametrize("name", FITS)
def test_what_a_fit_says(name):
    options = FITS[name]
    found = fit(**options)
    assert found.method == {"quotient": "ratio_of_ratios"}.get(
        name, options.get("method", "conditional")
    )
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
        assert (found.details["ratio_lower"], found.details["ratio_upper"]) == (
            0.0,
            np.inf,
        )
        quotient = found.details["moves"] / np.repeat(found.details["pairs"], 3)
        assert_allclose(quotient, found.values.data, rtol=1e-12)
    assert np.isfinite(found.values.data).all()


def test_a_ratio_in_one_line():
    values = sparse.csr_array(np.array([[0.5, 1.25]]))
    ratio = oee.TransitionRatio(
        values, "given", 2e-9, np.array([[True]]), 3e-4, np.array([[7.0]])
    )
    assert (
        "given: 2 values from 0.5 to 1.25, 1 of 1 pairs recorded, gap 2.0e-09, row-sum"
        " error 3.0e-04" in repr(ratio)
    )
    assert ratio.log_standard_error(np.ones(2)) is None
    assert ratio.one_step(np.ones(2)) is None


def test_models_of_rows_that_do_not_sum_to_one():
    true = oee.true_ratio(TARGET, SIMULATOR)
    twice = oee.TransitionRatio(
        true.values * 2.0, "twice", 0.0, true.visited, 1.0, true.counts
    )
    text = (
        r"^rows of zeta \* P must sum to 1; they sum to 2 to 2 \(method 'twice' does"
        r" not make them; normalize=True divides"
    )
    with pytest.raises(ValueError, match=text):
        twice.target_model(SIMULATOR)
    made = twice.target_model(SIMULATOR, normalize=True)
    assert_allclose(
        made.transitions.toarray(), TARGET.transitions.toarray(), rtol=1e-12
    )
    assert_allclose(
        true.target_model(SIMULATOR).transitions.toarray(),
        TARGET.transitions.toarray(),
        rtol=1e-12,
    )


REFITTED = {
    "none": {"prior": "none"},
    "simulator": {"prior": "simulator", "strength": 3.0},
    "ridge": {"prior": "simulator", "strength": 1.0, "ridge": 0.3},
    "the paper's ridge": {
        "prior": "simulator",
        "strength": 1.0,
        "ridge": 0.3,
        "toward": None,
    },
    "box": {"prior": "simulator", "strength": 1.0, "lower": 0.7, "upper": 1.6},
    "linear": {"method": "linear", "features": FEATURES, "ridge": 0.01},
    "kernel": {"method": "kernel", "coordinates": PLACES, "ridge": 0.01},
}


@pytest.mark.parametrize("name", REFITTED)
def test_the_standard_error_by_refits(name):
    """sqrt(sum over rows of n Var(d value / d one more move)), the derivatives by
    central differences of refits.
    """
    # no zeros in rows that have moves
    counts = COUNTS + np.where(COUNTS.sum(axis=1, keepdims=True) > 0, 0.5, 0.0)
    options = REFITTED[name]
    step = 1e-4
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
    spread = (
        shares * (slopes - (shares * slopes).sum(axis=1, keepdims=True)) ** 2
    ).sum(axis=1)
    expected = np.sqrt((n * spread).sum())
    assert_allclose(
        fit(counts, **options).log_standard_error(gradient), expected, rtol=5e-4
    )


def test_the_one_step_correction_row_by_row():
    found = fit(prior="simulator", strength=4.0)
    gradient = np.random.default_rng(1).normal(size=18)
    step = found.one_step(gradient)
    g = gradient.reshape(6, 3)
    kernel = (found.values.data * SIMULATOR.transitions.data).reshape(6, 3)
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
    assert_allclose(step.unrecorded, np.sqrt(unseen), rtol=1e-12)


# ---- methods of ratios as objects: what a name stands for, and limits
GRID = oee.tasks.gridworld(3, 0.3)
GRID_TARGET = oee.tasks.gridworld(3, 0.1)
POLICY = oee.tasks.gridworld_policy(3, 0.5)
GRID_LOG = oee.sample_episodes(
    GRID_TARGET, oee.uniform_policy(GRID_TARGET), 30, 20, seed=0
)
SHIFT = np.arange(GRID.transitions.nnz) % 3
STATE = np.arange(9.0)
SAME = {
    "conditional": (
        {"prior": "simulator", "strength": 2.0},
        Conditional(prior="simulator", strength=2.0),
    ),
    "tied": ({"tie": SHIFT, "strength": 1.0}, Tied(SHIFT, strength=1.0)),
    "linear": (
        {"features": SHIFT.astype(float)},
        InClass(features=SHIFT.astype(float)),
    ),
    "kernel": (
        {"coordinates": STATE, "bandwidth": 2.0},
        InClass(kernel="gaussian", coordinates=STATE, bandwidth=2.0),
    ),
    "ratio_of_ratios": (
        {"lower": 0.1, "simulator_data": "exact"},
        Quotient(lower=0.1, data="exact"),
    ),
    "joint": (
        {"upper": 5.0, "simulator_data": "exact"},
        Joint(upper=5.0, data="exact"),
    ),
}


@pytest.mark.parametrize("name", SAME)
def test_a_name_stands_for_an_object(name):
    options, method = SAME[name]
    named = oee.transition_ratio(GRID_LOG, GRID, method=name, seed=3, **options)
    for found in (
        oee.transition_ratio(GRID_LOG, GRID, method=method, seed=3),
        method.fit(GRID_LOG, GRID, seed=3),
    ):
        assert_array_equal(found.values.data, named.values.data)
        assert (found.method, found.gap) == (named.method, named.gap)


def test_a_limit_knows_no_training():
    values = [
        OffEnvironment(Quotient(normalized=False, lower=0.5, upper=2.0, **by)).limit(
            GRID, GRID_TARGET, POLICY
        )
        for by in ({}, {"solver": Sgd(n_iterations=5)}, {"functions": Network()})
    ]
    assert values[0] == values[1] == values[2]


# ---- rows, quotients and matrices in any order
def by_clarabel(counts, simulator, **options):
    """Clarabel's answer; None where it ends "optimal_inaccurate" at every tolerance
    that is asked for (1 program in 500).
    """
    try:
        return oee.transition_ratio(counts, simulator, solver="CLARABEL", **options)
    except SolverStatusError:
        return None


def pair(rng, **options):
    simulator = random_mdp(rng, **options)
    return simulator, random_mdp(rng, like=simulator)


def counts_of(rng, mdp, n):
    weights = rng.dirichlet(np.ones(mdp.n_states * mdp.n_actions)).reshape(
        mdp.n_states, mdp.n_actions
    )
    return oee.sample_transitions(
        mdp, weights, n, seed=int(rng.integers(1 << 30))
    ).counts(mdp.n_states, mdp.n_actions)


@given(rngs)
def test_the_group_law(rng):
    """Statements 10, 13: zeta is 1 for equal MDPs; zeta_AC = zeta_AB zeta_BC where
    supports are equal.
    """
    a = random_mdp(rng, zeros=0.0)
    b, c = (
        a.with_transitions(
            rng.dirichlet(np.ones(a.n_states), size=(a.n_states, a.n_actions))
        )
        for _ in range(2)
    )
    assert_array_equal(oee.true_ratio(a, a).values.data, 1.0)
    product = oee.true_ratio(b, a).values.data * oee.true_ratio(c, b).values.data
    assert_allclose(oee.true_ratio(c, a).values.data, product, rtol=1e-12)


@given(rngs, st.sampled_from([0.0, 0.3, 1.0, 7.0]))
def test_conditional_is_the_dirichlet_posterior_mean(rng, strength):
    """zeta = (n/P + kappa) / (n_sa + kappa); rows never visited are the simulator's."""
    simulator, target = pair(rng)
    counts = counts_of(rng, target, int(rng.integers(1, 60)))
    zeta = oee.transition_ratio(counts, simulator, prior="simulator", strength=strength)
    probability = simulator.transitions.toarray()
    n = counts.toarray()
    total = n.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where(
            total > 0, (n / probability + strength) / (total + strength), 1.0
        )
    expected = np.where(probability > 0, expected, 0.0)
    assert_allclose(zeta.values.toarray(), expected, rtol=1e-12)
    assert_array_equal(zeta.visited.reshape(-1), total[:, 0] > 0)
    assert zeta.row_sum_error < 1e-12
    assert zeta.gap < 1e-13


@given(
    rngs,
    st.sampled_from(
        [
            {},
            {"ridge": 0.5},
            {"ridge": 0.2, "toward": None},
            {"lower": 0.5, "upper": 1.5},
        ]
    ),
)
def test_rows_agree_with_clarabel(rng, options):
    simulator, target = pair(rng, n_states=4, n_actions=2)
    counts = counts_of(rng, target, 60)
    shrunk = {"prior": "simulator", "strength": 1.0} | options
    ours = oee.transition_ratio(counts, simulator, **shrunk)
    theirs = by_clarabel(counts, simulator, **shrunk)
    assert ours.gap < 1e-12
    assert ours.row_sum_error < 1e-12
    if theirs is not None:
        assert theirs.gap < 1e-6
        assert_allclose(ours.values.data, theirs.values.data, rtol=0, atol=2e-3)
    # each row is the plain density_ratio of its counts
    kept = simulator.transitions
    row = int(rng.integers(8))
    entries = slice(kept.indptr[row], kept.indptr[row + 1])
    columns = kept.indices[entries]
    seen = counts.toarray()[row, columns]
    if seen.sum() > 0:
        p = seen + kept.data[entries]
        fit = oee.density_ratio(p, kept.data[entries], **({"toward": 1.0} | options))
        assert_allclose(ours.values.data[entries], fit.ratio, rtol=1e-9)


@given(rngs)
def test_ratio_of_ratios_does_not_depend_on_who_sampled(rng):
    """Statement 14: from exact occupancies the quotient is the true zeta, whatever the
    two data policies.
    """
    simulator, target = pair(rng, discount=0.9)
    # else the simulator has no move to record
    assume(not simulator.closed()[simulator.initial > 0].all())
    behavior = random_policy(rng, simulator, zeros=0.0)
    shares = oee.occupancy(
        target, random_policy(rng, simulator, zeros=0.0), horizon=30, of="transition"
    )
    zeta = oee.transition_ratio(
        shares,
        simulator,
        method="ratio_of_ratios",
        simulator_data="exact",
        behavior_policy=behavior,
        lower=0.0,
        upper=1e9,
    )
    truth = oee.true_ratio(target, simulator)
    lengths = np.diff(simulator.transitions.indptr)
    by_simulator = (
        oee.occupancy(
            simulator.with_discount(1.0), behavior, horizon=1000, of="transition"
        ).data
        > 0
    )
    by_target = np.repeat(shares.toarray().sum(axis=1) > 0, lengths)
    both = by_simulator & by_target
    assert both.any()
    assert_allclose(
        zeta.values.data[both], truth.values.data[both], rtol=1e-7, atol=1e-9
    )


def test_a_ridge_function_is_asked_for_visited_rows_only():
    import math

    simulator = oee.tasks.gridworld(3, 0.3)
    target = oee.tasks.gridworld(3, 0.1)
    log = oee.sample_episodes(target, oee.tasks.gridworld_expert(3), 5, 20, seed=0)
    asked = []

    def ridge(n):
        asked.append(n)
        return 1 / math.sqrt(n)

    zeta = oee.transition_ratio(log, simulator, ridge=ridge)
    assert sorted(asked) == sorted(set(zeta.counts[zeta.visited].tolist()))
    # the quotient asks at the number of moves, and a function that is 0 at 1 is no
    # other program than its value
    by_function, by_number = (
        oee.transition_ratio(
            log, simulator, method="ratio_of_ratios", ridge=r, toward=1.0, seed=0
        ).values.data
        for r in (lambda n: math.log(n) / n, math.log(len(log)) / len(log))
    )
    assert_array_equal(by_function, by_number)


def test_matrices_in_any_order_are_read_right_and_left_alone():
    simulator = oee.FiniteMDP(np.full((3, 2, 3), 1 / 3), np.zeros(3), [1, 0, 0], 0.9)
    parts = (
        np.array([30.0, 10, 20]),
        np.array([2, 0, 1]),
        np.array([0, 3, 3, 3, 3, 3, 3]),
    )
    unsorted = sparse.csr_array(parts, shape=(6, 3))
    assert_allclose(
        exact.reweight(simulator, unsorted).transitions.toarray()[0] * 3, [10, 20, 30]
    )
    twice = (
        np.ones(7),
        np.array([2, 0, 2, 1, 0, 1, 2]),
        np.array([0, 3, 4, 5, 6, 7, 7]),
    )
    counts = sparse.csr_array(twice, shape=(6, 3))
    before = counts.toarray()
    zeta = oee.transition_ratio(counts, simulator, prior="none")
    assert_allclose(zeta.values.toarray()[0], [1, 0, 2])
    assert_array_equal(counts.toarray(), before)
    assert counts.nnz == 7
    for form in (sparse.coo_array, sparse.csc_matrix):
        assert_array_equal(
            oee.transition_ratio(form(before), simulator, prior="none").values.data,
            zeta.values.data,
        )


def test_the_joint_program_without_box_and_ridge_is_maximum_likelihood():
    simulator = oee.tasks.gridworld(4, 0.3)
    target = oee.tasks.gridworld(4, 0.1)
    log = oee.sample_transitions(target, np.full((16, 4), 1 / 64), 5000, seed=0)
    data = oee.sample_transitions(simulator, np.full((16, 4), 1 / 64), 5000, seed=1)
    joint = oee.transition_ratio(
        log, simulator, method="joint", simulator_data=data, lower=0.0, upper=np.inf
    )
    likelihood = oee.transition_ratio(log, simulator, prior="none")
    assert_allclose(joint.values.data, likelihood.values.data, atol=1e-9)
