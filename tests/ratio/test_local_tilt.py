"""The tilt that varies over the states, and the graph that says how."""

from functools import partial

import numpy as np
import pytest
from helpers import random_mdp, rngs
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import integrate, optimize, sparse

import oee_tabular as oee
from oee_tabular import exact
from oee_tabular.exact.system import Csr
from oee_tabular.ratio import statements
from oee_tabular.ratio.prior import local_tilt
from oee_tabular.ratio.prior import neighbours as graphs
from oee_tabular.ratio.prior._kernels import match, merge
from oee_tabular.ratio.prior.local_tilt import fit_local_tilt
from oee_tabular.ratio.prior.neighbours import REST, neighbours
from oee_tabular.ratio.prior.tilt import fit_tilt
from oee_tabular.ratio.support import aligned_counts


def halves(size):
    """Simulated slip .3; real slip .1 on the left half, .5 on the right."""
    simulator, less, more = (oee.tasks.gridworld(size, slip) for slip in (0.3, 0.1, 0.5))
    left = np.repeat(np.arange(size * size) % size < size // 2, 4).astype(float)
    mixed = sparse.diags_array(left) @ less.transitions + sparse.diags_array(1 - left) @ more.transitions
    return simulator, simulator.with_transitions(sparse.csr_array(mixed))


def counts_of(target, simulator, n, seed=0):
    weights = np.full((target.n_states, target.n_actions), 1 / (target.n_states * target.n_actions))
    log = oee.sample_transitions(target, weights, n, seed=seed)
    return log, aligned_counts(log.counts(target.n_states, target.n_actions), simulator)


def local(observed, simulator, smoothness, features=None, solver="dual"):
    whole = fit_tilt(observed, simulator, features)
    found = fit_local_tilt(observed, simulator, whole, smoothness, solver=solver)
    return whole, found


def risk_of(observed, simulator, phi, smoothness):
    """f(u, theta) written out, the penalty as a sum over pairs of states."""
    matrix, n_actions, n_states = simulator.transitions, simulator.n_actions, simulator.n_states
    weight = pair_weights(simulator)
    d = phi.shape[1]
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))

    def f(both):
        u, theta = both[:-d].reshape(n_states, d), both[-d:]
        exponent = np.sum(phi * (u[rows // n_actions] + theta), axis=1)
        log_z = np.log(np.bincount(rows, matrix.data * np.exp(exponent)))
        pairs = 0.25 * np.sum(weight[:, :, None] * (u[:, None] - u[None]) ** 2)
        data = np.bincount(rows, observed) @ log_z - observed @ exponent
        return data + 0.5 * theta @ theta + smoothness * (pairs + 0.5 * REST * np.sum(u**2))

    return f


def pair_weights(simulator):
    """w(s, s') for all pairs, dense."""
    dense = simulator.transitions.toarray().reshape(simulator.n_states, simulator.n_actions, -1).mean(axis=1)
    return 0.5 * (dense + dense.T)


@settings(max_examples=10)
@given(rngs, st.integers(1, 2), st.sampled_from([0.1, 3.0, 100.0]))
def test_it_minimises_the_penalised_risk(rng, d, smoothness):
    simulator = random_mdp(rng, n_states=4, n_actions=2, zeros=0.0)
    _, observed = counts_of(random_mdp(rng, n_states=4, n_actions=2, zeros=0.0), simulator, 60, int(rng.integers(99)))
    phi = rng.normal(size=(simulator.transitions.nnz, d))
    whole, found = local(observed, simulator, smoothness, phi)
    f = risk_of(observed, simulator, whole.phi(whole.whole), smoothness)
    best = optimize.minimize(f, np.zeros(5 * d), method="BFGS", options={"gtol": 1e-7})
    theta = best.x[-d:]
    assert_allclose(found.theta, best.x[:-d].reshape(4, d) + theta, atol=1e-4)
    assert found.gap < 1e-15
    rows = np.add.reduceat(found.ratio * simulator.transitions.data, simulator.transitions.indptr[:-1])
    assert_allclose(rows, 1.0, rtol=1e-13)


def test_the_evidence_is_the_integral():
    """Two states, each with one action and two successors: exp(-f) over three numbers, on a grid, against Laplace."""
    simulator = oee.FiniteMDP([[[0.6, 0.4]], [[0.3, 0.7]]], np.zeros(2), [1.0, 0.0], 0.9)
    observed = np.array([150.0, 60.0, 40.0, 200.0])
    whole = fit_tilt(observed, simulator)

    weights, phi = simulator.transitions.data.reshape(2, 2), whole.phi(whole.whole).reshape(2, 2)
    counts = observed.reshape(2, 2)
    center = counts / counts.sum(axis=1, keepdims=True)
    middle = np.diff(np.log(center / weights), axis=1)[:, 0] / np.diff(phi, axis=1)[:, 0]  # each state's own tilt
    line = np.linspace(-1.0, 1.0, 101)

    def data(s, tilt):  # of one state
        exponent = phi[s][:, None] * tilt
        return counts[s].sum() * np.log(weights[s] @ np.exp(exponent)) - counts[s] @ exponent

    def gain(smoothness):
        a, b, theta = middle[0] + line, middle[1] + line, 6.0 * line
        alone = data(0, theta) + data(1, theta) + 0.5 * theta**2
        lowest = alone.min()
        fine = middle.mean() + 2 * np.linspace(-1, 1, 4001)
        one = data(0, fine) + data(1, fine) + 0.5 * fine**2
        x, y, z = a[:, None, None], b[None, :, None], theta[None, None, :]
        pairs = pair_weights(simulator)[0, 1] * (x - y) ** 2 + REST * ((x - z) ** 2 + (y - z) ** 2)
        f = data(0, a)[:, None, None] + data(1, b)[None, :, None] + 0.5 * z**2 + 0.5 * smoothness * pairs
        volume = (a[1] - a[0]) * (b[1] - b[0]) * (theta[1] - theta[0])
        penalty = neighbours(simulator).penalty.toarray() * smoothness
        both = np.log(np.exp(lowest - f).sum() * volume) + 0.5 * np.linalg.slogdet(penalty / (2 * np.pi))[1]
        return both - np.log(integrate.trapezoid(np.exp(lowest - one), fine))

    for smoothness in (20.0, 200.0):
        _, found = local(observed, simulator, smoothness)
        assert_allclose(found.gain, gain(smoothness), atol=0.05)


def test_an_infinite_smoothness_is_one_tilt_for_all_states():
    simulator, target = halves(6)
    log, observed = counts_of(target, simulator, 2000)
    whole, found = local(observed, simulator, 1e9)
    assert_allclose(found.ratio, whole.ratio, rtol=1e-5)
    assert_allclose(found.gain, 0.0, atol=1e-3)
    one = oee.transition_ratio(log, simulator, smoothness=np.inf)
    assert one.details["smoothness"] == np.inf
    assert "theta_by_state" not in one.details
    near = oee.transition_ratio(log, simulator, smoothness=1e9)
    assert_allclose(near.values.data, one.values.data, rtol=1e-5)
    assert_allclose(near.details["theta_by_state"], np.tile(one.details["theta"], (36, 1)), rtol=1e-3, atol=1e-4)


def test_where_the_target_differs_is_found_and_told():
    simulator, target = halves(12)
    log, _ = counts_of(target, simulator, 6000)
    zeta = oee.transition_ratio(log, simulator, prior="tilt")
    truth = oee.true_ratio(target, simulator).values.data
    one = oee.transition_ratio(log, simulator, smoothness=np.inf)
    weight = simulator.transitions.data
    errors = [weight @ np.abs(z.values.data - truth) for z in (zeta, one)]
    assert errors[0] < 0.35 * errors[1]
    theta = zeta.details["theta_by_state"].reshape(12, 12)
    assert theta[:, :5].min() > 0.2
    assert theta[:, 7:].max() < -0.1
    assert zeta.details["smoothness_gain"] > 100
    assert max(gain for _, gain in zeta.details["smoothness_curve"]) == zeta.details["smoothness_gain"]
    assert zeta.details["meaning"].startswith("the tilt fits")
    for options in ({"strength": "loo", "prior": "tilt"}, {}):  # also beside the other candidates of the centre
        other = oee.transition_ratio(log, simulator, **options)
        assert other.details["smoothness"] == zeta.details["smoothness"]


def test_a_target_that_one_tilt_fits_keeps_it():
    simulator, target = oee.tasks.gridworld(10, 0.3), oee.tasks.gridworld(10, 0.1)
    kept = [oee.transition_ratio(counts_of(target, simulator, 4000, s)[0], simulator, prior="tilt") for s in range(10)]
    assert sum(zeta.details["smoothness"] == np.inf for zeta in kept) >= 8


@pytest.mark.parametrize("slip", [0.0, 0.01])
def test_one_tilt_however_far_is_not_called_many(slip):
    """Far levels must not be credited to departures: a target of one theta, far from the simulator."""
    simulator, target = oee.tasks.gridworld(6, 0.3), oee.tasks.gridworld(6, slip)
    for n in (100, 1000, 10_000):
        zeta = oee.transition_ratio(counts_of(target, simulator, n)[0], simulator, prior="tilt")
        assert zeta.details["smoothness"] == np.inf
        assert "smoothness_gain" not in zeta.details


@pytest.mark.parametrize("dense", [0, 128])
def test_enormous_counts(dense, monkeypatch):
    simulator, target = halves(4)
    monkeypatch.setattr(local_tilt, "DENSE", dense)
    for size in (1e9, 1e15, 8e15):
        zeta = oee.transition_ratio(sparse.csr_array(size * target.transitions), simulator, smoothness=5.0)
        assert_allclose(zeta.target_model(simulator).transitions.toarray(), target.transitions.toarray(), atol=1e-6)
        assert np.isfinite(zeta.gap)


def test_dense_and_sparse_systems_agree(monkeypatch):
    simulator, target = halves(5)
    log, _ = counts_of(target, simulator, 3000)
    dense = oee.transition_ratio(log, simulator, prior="tilt")
    monkeypatch.setattr(local_tilt, "DENSE", 0)
    assert_allclose(oee.transition_ratio(log, simulator, prior="tilt").values.data, dense.values.data, rtol=1e-10)


def test_the_same_program_by_cvxpy():
    simulator, target = halves(4)
    log, observed = counts_of(target, simulator, 600)
    _, ours = local(observed, simulator, 5.0)
    _, theirs = local(observed, simulator, 5.0, solver="CLARABEL")
    assert_allclose(theirs.ratio, ours.ratio, rtol=1e-5)
    assert max(ours.gap, theirs.gap) < 1e-12
    whole = oee.transition_ratio(log, simulator, smoothness=5.0, solver="CLARABEL")
    assert_allclose(whole.values.data, oee.transition_ratio(log, simulator, smoothness=5.0).values.data, rtol=1e-4)


def test_the_gap_bounds_what_a_wrong_answer_leaves(monkeypatch):
    simulator, target = halves(4)
    _, observed = counts_of(target, simulator, 600)
    whole, _ = local(observed, simulator, 5.0)
    f = risk_of(observed, simulator, whole.phi(whole.whole), 5.0)
    best = optimize.minimize(f, np.zeros(17), method="BFGS").fun
    wrong = 0.1 * np.random.default_rng(0).normal(size=17)
    monkeypatch.setattr(statements, "solve_tilt", lambda program, solver: wrong)
    _, found = local(observed, simulator, 5.0, solver="CLARABEL")
    assert 0 < (f(wrong) - best) / 600 <= found.gap


def test_its_standard_error_is_that_of_repeated_logs():
    """Smoothness given: the error of J(zeta P) over logs with given row counts, against the delta method's."""
    simulator, target = halves(6)
    policy = oee.tasks.gridworld_policy(6, 0.5)
    ratio = partial(oee.transition_ratio, smoothness=20.0, strength=200.0)
    rng = np.random.default_rng(0)
    matrix = target.transitions.toarray()
    values, errors = [], []
    for _ in range(150):
        counts = sparse.csr_array(np.array([rng.multinomial(60, row / row.sum()) for row in matrix]).astype(float))
        zeta = ratio(counts, simulator)
        values.append(oee.policy_value(exact.reweight(simulator, zeta), policy, horizon=60))
        if len(values) <= 10:
            estimate = oee.estimators.OffEnvironment(ratio)(oee.Problem(simulator, counts, horizon=60), policy)
            assert_allclose(estimate.diagnostics["model_value"], values[-1], rtol=1e-12)
            errors.append(estimate.diagnostics["standard_error_if_centre_fits"])
    assert_allclose(np.mean(errors), np.std(values, ddof=1), rtol=0.2)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"smoothness": -1.0}, r"smoothness must be in \(0, inf\); it is -1"),
        ({"smoothness": 0.0}, r"smoothness must be in \(0, inf\); it is 0"),
        ({"smoothness": "loo"}, "smoothness must be a number; got 'loo'"),
        ({"smoothness": 1.0, "prior": "simulator"}, "smoothness must be left out with prior 'simulator'"),
        ({"smoothness": 1.0, "method": "joint"}, "smoothness must not be given with method 'joint'"),
    ],
)
def test_bad_smoothness(options, text):
    simulator, target = halves(4)
    log, _ = counts_of(target, simulator, 50)
    with pytest.raises(ValueError, match=text):
        oee.transition_ratio(log, simulator, **options)


# ---- the graph ---------------------------------------------------------------------------------------------------


@given(rngs, st.integers(1, 6))
def test_the_penalty_is_a_sum_over_pairs(rng, most):
    simulator = random_mdp(rng, n_states=6, n_actions=2)
    weight = pair_weights(simulator)
    graph = neighbours(simulator, width=graphs.LARGEST // most)
    nodes = graph.penalty.shape[0]
    assert nodes <= most
    assert set(graph.group) == set(range(nodes))
    u = rng.normal(size=nodes)
    on_states = u[graph.group]
    pairs = 0.5 * np.sum(weight * (on_states[:, None] - on_states) ** 2)
    assert_allclose(u @ (graph.penalty @ u), pairs + REST * np.sum(on_states**2), rtol=1e-12)
    assert_allclose(graph.log_determinant, np.linalg.slogdet(graph.penalty.toarray())[1], rtol=1e-9, atol=1e-9)


def test_groups_of_a_grid_are_compact():
    simulator = oee.tasks.gridworld(40, 0.3)
    group = neighbours(simulator, width=16).group  # at most 64 groups of 1600 states
    sizes = np.bincount(group)
    assert len(sizes) <= 64
    assert sizes.max() <= 8 * sizes.min() + 8
    place = np.column_stack(np.divmod(np.arange(1600), 40))
    for g in range(len(sizes)):
        spread = place[group == g].std(axis=0)
        assert spread.max() <= 10


def test_an_expander_is_coarsened_until_its_factor_is_small():
    rng = np.random.default_rng(0)
    arrivals = rng.integers(0, 800, size=(800, 2, 6))
    kernel = np.zeros((800, 2, 800))
    for s in range(800):
        for a in range(2):
            np.add.at(kernel[s, a], arrivals[s, a], 1 / 6)
    graph = neighbours(oee.FiniteMDP(kernel, np.zeros(800), np.full(800, 1 / 800), 0.9))
    assert 50 <= graph.penalty.shape[0] <= 400


def test_matching_by_hand():
    """A path 0-1-2-3-7; 6 hangs on 2, which prefers it to 3 unless it is heavy; 4 and 5 are alone."""
    edges = {(0, 1): 1.0, (1, 2): 3.0, (2, 3): 1.0, (2, 6): 2.0, (3, 7): 0.5}
    dense = np.zeros((8, 8))
    for (i, j), w in edges.items():
        dense[i, j] = dense[j, i] = w
    csr = sparse.csr_array(dense)
    assert match(csr.indptr, csr.indices, csr.data, np.ones(8)).tolist() == [0, 0, 1, 2, 3, 3, 1, 2]
    sizes = np.array([1.0, 1, 1, 1, 1, 1, 100, 1])
    assert match(csr.indptr, csr.indices, csr.data, sizes).tolist() == [0, 0, 1, 1, 2, 2, 1, 1]


@given(rngs, st.integers(1, 12), st.integers(1, 6))
def test_merging_has_the_bits_of_two_products(rng, n, groups):
    """Compiled and as Python; sums of numbers of several scales, which show the order."""
    dense = np.where(rng.random((n, n)) < 0.6, 10 ** rng.uniform(-3, 3, (n, n)), 0.0)
    group = np.unique(rng.integers(groups, size=n), return_inverse=True)[1]
    csr = sparse.csr_array(dense)
    edges = Csr(csr.indptr, csr.indices, csr.data)
    onto = sparse.csr_array((np.ones(n), (np.arange(n), group)))
    expected = sparse.csr_array(onto.T) @ (csr @ onto)
    for way in (merge, merge.py_func):
        found = way(edges, group)
        assert_array_equal(found.indptr, expected.indptr)
        assert_array_equal(found.indices, expected.indices)
        assert_array_equal(found.data, expected.data)
        assert found.indices.dtype == csr.indices.dtype
