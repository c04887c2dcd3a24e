"""Ratios in classes by own programs: linear, kernel and tied."""

import copy
import pickle

import numpy as np
import pytest
from helpers import table_of
from numpy.testing import assert_allclose, assert_array_equal
from scipy import optimize, sparse

import oee_tabular as oee
from oee_tabular.ratio import Tied, transition_ratio, true_ratio
from oee_tabular.ratio.features import kernel_features


def small(seed=4, moves=150):
    """Five states, two actions, rows of three next states; counts on the stored
    entries.
    """
    rng = np.random.default_rng(seed)
    P = np.zeros((5, 2, 5))
    for s in range(5):
        for a in range(2):
            P[s, a, rng.choice(5, 3, replace=False)] = rng.dirichlet(np.full(3, 2.0))
    simulator = oee.FiniteMDP(P, rng.normal(size=(5, 2)), np.full(5, 0.2), 0.9)
    Q = np.where(P > 0, P * np.exp(rng.normal(scale=0.5, size=P.shape)), 0.0)
    target = simulator.with_transitions(Q / Q.sum(axis=2, keepdims=True))
    log = oee.sample_transitions(target, np.full((5, 2), 0.1), moves, seed=seed)
    return simulator, P, table_of(log, (5, 2)), log


def by_slsqp(risk, start, low, high, of):
    """The least risk over w with low <= of(w) <= high."""
    rows = (
        [optimize.NonlinearConstraint(of, low, high)]
        if np.isfinite([low, high]).any()
        else []
    )
    found = optimize.minimize(
        risk,
        start,
        method="SLSQP",
        constraints=rows,
        options={"ftol": 1e-14, "maxiter": 2000},
    )
    return found.x, found.fun


@pytest.mark.parametrize("box", [(0.0, np.inf), (0.7, 1.4)])
@pytest.mark.parametrize("ridge", [None, 0.05])
def test_the_linear_class_by_its_own_risk(box, ridge):
    simulator, P, n, log = small()
    phi = np.random.default_rng(0).normal(size=(3, *P.shape)) * (P > 0)
    centred = (phi - (P * phi).sum(axis=3, keepdims=True)) * (P > 0)
    total = n.sum()
    strength = 1.0 / total if ridge is None else ridge

    def zeta(w):
        return 1.0 + np.tensordot(w, centred, 1)

    def risk(w):
        each = np.log(np.maximum(zeta(w)[n > 0], 1e-12))
        return (
            (P * zeta(w) * n.sum(axis=2, keepdims=True)).sum() / total
            - n[n > 0] @ each / total
            + strength / 2 * w @ w
        )

    w, least = by_slsqp(risk, np.zeros(3), *box, lambda w: zeta(w)[P > 0])
    fit = oee.transition_ratio(
        log,
        simulator,
        method="linear",
        features=np.moveaxis(phi, 0, 3),
        ridge=ridge,
        lower=box[0],
        upper=box[1],
    )
    assert_allclose(
        fit.values.toarray().reshape(P.shape)[P > 0], zeta(w)[P > 0], atol=2e-5
    )
    assert_allclose(fit.details["weights"], w, atol=2e-5)
    assert -1e-10 < risk(fit.details["weights"]) - least < 1e-8
    assert fit.row_sum_error < 1e-12


def test_the_kernel_class_is_a_gaussian_process_around_the_simulator():
    """With the whole Gram matrix K of the moves, less row means: zeta = 1 + K alpha,
    penalty alpha' K alpha.
    """
    simulator, P, n, log = small(moves=3000)
    places = np.random.default_rng(1).normal(size=(5, 2))
    fit = oee.transition_ratio(
        log, simulator, method="kernel", coordinates=places, bandwidth=0.8
    )
    s, a, j = np.nonzero(P)
    x = np.hstack([places[s], places[j] - places[s]])
    x = x / x.std(axis=0)
    K = np.exp(-((x[:, None] - x[None]) ** 2).sum(axis=2) / (2 * 0.8**2)) * (
        a[:, None] == a[None]
    )
    row = 2 * s + a
    center = np.eye(len(s)) - (row[:, None] == row[None]) * P[s, a, j][None]
    root = np.linalg.cholesky(K + 1e-13 * np.eye(len(s)))
    features = center @ root
    counts = n[s, a, j]
    total = n.sum()
    mass = n.sum(axis=2)[s, a] * P[s, a, j] / total

    def risk(w):
        z = 1.0 + features @ w
        if (z <= 0).any():
            return np.inf
        return (
            mass @ z
            - counts[counts > 0] @ np.log(z[counts > 0]) / total
            + w @ w / (2 * total)
        )

    w = np.zeros(len(s))
    for _ in range(200):  # Newton, halved where it leaves the domain or rises
        z = 1.0 + features @ w
        gradient = features.T @ (mass - counts / z / total) + w / total
        bend = (features * (counts / z**2 / total)[:, None]).T @ features + np.eye(
            len(w)
        ) / total
        step = -np.linalg.solve(bend, gradient)
        length = 1.0
        while risk(w + length * step) > risk(w) and length > 1e-12:
            length /= 2
        w = w + length * step
    assert (1.0 + features @ w > 0.0).all()  # or zeta >= 0 would bind
    assert_allclose(
        fit.values.toarray().reshape(P.shape)[s, a, j], 1.0 + features @ w, atol=1e-5
    )
    assert fit.gap < 1e-7


def test_tied_entries_by_their_own_sums():
    """Two groups of keys: those of action 0 and those of action 1; g = N / M up to the
    group's constant, then the rows.
    """
    simulator, P, n, log = small()
    key = (
        np.arange(5)[None, None, :] % 3
        + 3 * np.arange(2)[None, :, None]
        + np.zeros((5, 1, 1), dtype=int)
    )
    fit = oee.transition_ratio(log, simulator, tie=key[P > 0], strength=4.0)
    zeta = np.zeros_like(P)
    for a in range(2):
        rows = n[:, a].sum(axis=1)
        total = rows.sum()
        for k in np.unique(key[:, a]):
            mine = (key[:, a] == k) & (P[:, a] > 0)
            foreseen = (P[:, a] * rows[:, None])[mine].sum() / total
            seen = n[:, a][mine].sum()
            zeta[:, a][mine] = (seen + 4.0 * foreseen) / ((total + 4.0) * foreseen)
    zeta /= (P * zeta).sum(axis=2, keepdims=True)
    assert_allclose(
        fit.values.toarray().reshape(P.shape)[P > 0], zeta[P > 0], rtol=1e-9
    )


def test_displacements_of_a_walk():
    """Steps of -1, 0 and 1 on a line: of each action the commonest is the reference,
    the others have columns.
    """
    rows = np.zeros((3, 2, 3))
    rows[0] = [[0.2, 0.8, 0], [0.9, 0.1, 0]]
    rows[1, 0] = [0.1, 0.2, 0.7]
    rows[2] = [[0, 0.3, 0.7], [0, 0.6, 0.4]]
    rows[1, 1] = [0.6, 0.3, 0.1]
    mdp = oee.FiniteMDP(rows, np.zeros(3), [1, 0, 0], 0.9)
    found = oee.ratio.action_displacement(mdp, np.array([0.0, 1.0, 2.0]))
    matrix = mdp.transitions
    state, action = np.divmod(np.repeat(np.arange(6), np.diff(matrix.indptr)), 2)
    move = matrix.indices - state
    # references: 1 of action 0 (mass 1.5), 0 of action 1 (mass 1.6)
    kept = [(0, -1), (0, 0), (1, -1), (1, 1)]
    assert_array_equal(
        found, np.stack([(action == a) & (move == m) for a, m in kept], axis=1)
    )


def test_kernels_and_their_features():
    x = np.array([[0.0, 0.0], [3.0, 4.0], [1.0, 0.0]])
    gram = oee.ratio.gaussian(1.0)(x, x)
    assert_allclose(
        oee.ratio.gaussian(2.0)(x, x[:2])[:, 1],
        np.exp(-np.array([25.0, 0.0, 20.0]) / 8),
    )
    made, few = (kernel_features(x, oee.ratio.gaussian(1.0), n) for n in (3, 2))
    assert_allclose(made.matrix @ made.matrix.T, gram, atol=1e-12)
    assert made.residual < 1e-12
    assert sorted(made.pivots.tolist()) == [0, 1, 2]
    assert_allclose(
        few.residual, (np.diag(gram) - (few.matrix**2).sum(axis=1)).max(), rtol=1e-9
    )
    many = np.linspace(0, 5, 150)[:, None]  # more than two blocks of the diagonal
    whole = kernel_features(many, lambda a, c: (1 + a @ c.T) ** 2, 150)
    assert whole.matrix.shape == (150, 3)
    assert_allclose(whole.matrix @ whole.matrix.T, (1 + many @ many.T) ** 2, rtol=1e-6)


# ---- tied ratios: the pooled program's closed form, its limits, and what is refused
def fit_tied(log_or_counts, simulator, tie, **options):
    return Tied(tie, **options).fit(log_or_counts, simulator)


def ring(p, n=12, n_actions=2):
    """Steps of 0, 1 or 2 around a ring with probabilities p[a]: the displacement does
    not depend on the state.
    """
    dense = np.zeros((n, n_actions, n))
    for s in range(n):
        for a in range(n_actions):
            for k in range(3):
                dense[s, a, (s + k) % n] += p[a][k]
    return oee.FiniteMDP(dense, np.linspace(0, 1, n), np.eye(n)[0], 0.9)


def displacement(s, a, following):
    return 3 * a + (following - s) % 12


SIMULATOR = ring([[0.2, 0.5, 0.3], [0.6, 0.3, 0.1]])
TARGET = ring([[0.1, 0.3, 0.6], [0.2, 0.4, 0.4]])


def test_a_function_of_the_key_is_found_exactly():
    zeta = fit_tied(100 * TARGET.transitions, SIMULATOR, displacement, strength=0.0)
    assert_allclose(
        zeta.values.toarray(), true_ratio(TARGET, SIMULATOR).values.toarray(), rtol=1e-9
    )
    assert zeta.gap < 1e-10
    assert zeta.details["n_keys"] == 6
    assert zeta.details["n_groups"] == 2
    assert_allclose(zeta.details["pooled_row_sums"], 1.0)


def test_an_unrecorded_action_keeps_the_simulator():
    only = 50 * TARGET.transitions.toarray()
    only[1::2] = 0.0
    zeta = fit_tied(sparse.csr_array(only), SIMULATOR, displacement)
    assert_allclose(
        zeta.values.toarray()[1::2][SIMULATOR.transitions.toarray()[1::2] > 0], 1.0
    )
    assert zeta.details["groups_visited"] == 1


def test_no_mass_left_in_a_row():
    simulator = oee.FiniteMDP([[[0.5, 0.5]], [[0.0, 1.0]]], [0.0, 1.0], [1.0, 0.0], 0.9)
    counts = sparse.csr_array([[4.0, 0.0], [0.0, 0.0]])
    with pytest.raises(
        ValueError, match=r"strength must be positive here: no key of row \(s=1, a=0\)"
    ):
        fit_tied(counts, simulator, np.array([0, 1, 1]), strength=0.0)


def test_a_discount_weights_the_log_s_transitions():
    log = oee.sample_episodes(TARGET, oee.uniform_policy(TARGET), 50, 20, seed=0)
    fit = transition_ratio(log, SIMULATOR, tie=displacement, discount=0.5)
    by_hand = fit_tied(
        log.counts(SIMULATOR.n_states, SIMULATOR.n_actions, discount=0.5),
        SIMULATOR,
        displacement,
        strength=3.0,
    )
    assert_allclose(fit.values.data, by_hand.values.data, rtol=1e-12)


def test_a_tied_ratio_says_that_unseen_rows_come_from_the_tie():
    """Rows that the log missed: the finding says where what is told of them comes from."""
    log = oee.Transitions([0] * 30, [0, 1] * 15, [0, 1, 2] * 10)
    policy = oee.uniform_policy(SIMULATOR)
    for ratio, tied in ((Tied(displacement), True), ("conditional", False)):
        found = oee.estimators.OffEnvironment(ratio=ratio)(
            oee.Problem(SIMULATOR, log), policy
        )
        told = [
            finding.text for finding in found.findings if finding.kind == "coverage"
        ]
        assert [("Transitions of the same key elsewhere" in text) for text in told] == [
            tied
        ]


def test_a_gaussian_is_pickled_and_compared_by_its_bandwidth():
    kernel = oee.ratio.gaussian(2)
    assert repr(kernel) == "gaussian(2.0)"
    for twin in (pickle.loads(pickle.dumps(kernel)), copy.deepcopy(kernel)):
        assert twin == kernel
        assert hash(twin) == hash(kernel)
        x = np.array([[0.0], [2.0]])
        assert_array_equal(twin(x, x), kernel(x, x))
    assert kernel != oee.ratio.gaussian(1.0)
    method = oee.ratio.InClass(coordinates=[0.0, 1.0], kernel=kernel)
    assert pickle.loads(pickle.dumps(method)).kernel == kernel
