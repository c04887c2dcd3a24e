"""Each direction of the library, entry by entry on small problems."""

import numpy as np
import pytest
from helpers import dense, dense_values, random_mdp, random_policy, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg

import oee_tabular as oee
from oee_tabular import FiniteMDP
from oee_tabular.mdp.rows import Rows
from oee_tabular.ratio.prior import neighbours as graphs
from oee_tabular.ratio.prior.library import by_action, columns_of, library, name_of, values_in
from oee_tabular.ratio.prior.neighbours import smooth_functions

PLACES = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [3.0, 1.0]])


def five(form=3, layout=None, discount=0.8):
    """Five states, two actions, some moves missing; rewards of ``form``."""
    rng = np.random.default_rng(form)
    rows = rng.dirichlet(np.full(5, 2.0), (5, 2)) * (rng.random((5, 2, 5)) > 0.2)
    rows[:, :, 0] += 0.1
    rows /= rows.sum(axis=2, keepdims=True)
    return FiniteMDP(rows, rng.normal(size=(5, 2, 5)[:form]), np.full(5, 0.2), discount, layout=layout)


def moves_of(rows):
    """(s, a, s', P) of every entry."""
    lengths = np.diff(rows.indptr)
    state, action = np.repeat(rows.state, lengths), np.repeat(rows.action, lengths)
    return list(zip(state, action, rows.arrival, rows.weights, strict=True))


def by_hand(rows, phi, *, by_deviation=False):
    """phi(s, a, s', P) less its mean in each row, in standard deviations of the row where asked."""
    found = []
    for low, high in zip(rows.indptr[:-1], rows.indptr[1:], strict=True):
        moves = moves_of(rows)[low:high]
        values, p = np.array([phi(*move) for move in moves], dtype=float), np.array([move[3] for move in moves])
        values = values - p @ values
        deviation = np.sqrt(p @ values**2)
        if by_deviation:
            values = values / deviation if deviation > 1e-9 else 0.0 * values
        found.append(values)
    return np.concatenate(found)


def ahead(simulator, level):
    """r(s, a, s') + gamma V(s'), r(s, a) left out: it is the same for every s'."""
    pay = simulator.transition_rewards
    table = None if pay is None else pay.toarray().reshape(simulator.n_states, simulator.n_actions, -1)
    return lambda s, a, t, p: (0.0 if table is None else table[s, a, t]) + simulator.discount * level[t]


def named(features):
    return {feature.name: feature for feature in features}


CHOSEN = np.array([True, True, False, True, True, True, False, True, True, True])


@pytest.mark.parametrize("form", [1, 2, 3])
@pytest.mark.parametrize("layout", [None, PLACES])
def test_every_column(form, layout):
    simulator = five(form, layout)
    policy = np.tile([0.3, 0.7], (5, 1))
    level = dense_values(simulator, policy)
    rows = Rows.of(simulator).select(CHOSEN)
    features = named(library(simulator, [level], rows))
    plain = {
        "log P": lambda s, a, t, p: np.log(p),
        "(log P)^2": lambda s, a, t, p: np.log(p) ** 2,
        "stay": lambda s, a, t, p: s == t,
    }
    for name, phi in plain.items():
        assert_allclose(features.pop(name).column(rows), by_hand(rows, phi), atol=1e-12)
    both = {"V": ahead(simulator, level)}
    smooth = smooth_functions(simulator, 3)
    both |= {f"u{k + 2}": (lambda s, a, t, p, k=k: smooth[t, k]) for k in range(3)}
    for name, phi in both.items():
        column, whole = features.pop(name).column(rows), by_hand(rows, phi)
        ratio = column @ whole / (whole @ whole)  # V is divided by its size
        assert ratio > 0
        assert_allclose(column, ratio * whole, atol=1e-12)
        scaled = by_hand(rows, phi, by_deviation=True)
        assert_allclose(features.pop(f"{name} / sd").column(rows), scaled, atol=1e-9)
    places = np.arange(5.0)[:, None] if layout is None else layout
    steps = [tuple(places[t] - places[s]) for s, a, t, p in moves_of(rows)]
    mass = {step: sum(m[3] for m, k in zip(moves_of(rows), steps, strict=True) if k == step) for step in set(steps)}
    frequent = sorted((k for k in mass if mass[k] >= 0.02 * len(rows)), key=lambda k: -mass[k])[:8]
    names = ["move " + (_signed(k[0]) if layout is None else f"({_signed(k[0])}, {_signed(k[1])})") for k in frequent]
    assert list(features) == names
    for name, step in zip(names, frequent, strict=True):
        phi = lambda s, a, t, p, step=step: tuple(places[t] - places[s]) == step  # noqa: E731
        assert_allclose(features[name].column(rows), by_hand(rows, phi), atol=1e-12)


def _signed(x):
    return f"{x:+g}" if x else "0"


def test_at_most_eight_displacements_and_none_that_is_rare():
    p = np.zeros((12, 1, 12))
    p[:, 0] = 0.001
    for s in range(12):
        p[s, 0, (s + 1) % 12] += 0.988
    simulator = FiniteMDP(p, np.zeros(12), np.full(12, 1 / 12), 0.9)
    names = [f.name for f in library(simulator, [], Rows.of(simulator)) if f.name.startswith("move")]
    assert names == ["move +1", "move -11"]  # 11/12 and 1/12 of the mass; every other one has at most .012
    flat = FiniteMDP(np.full((12, 1, 12), 1 / 12), np.zeros(12), np.full(12, 1 / 12), 0.9)
    names = [f.name for f in library(flat, [], Rows.of(flat)) if f.name.startswith("move")]
    assert len(names) == 8
    assert names[0] == "move 0"


def test_coordinates_in_names_place_the_states_where_nothing_else_does():
    def moves(simulator):
        return [f.name for f in library(simulator, [], Rows.of(simulator)) if f.name.startswith("move")]

    named = five().with_names([tuple(place) for place in PLACES.tolist()])
    assert moves(named) == moves(five(layout=PLACES)) != moves(five())


def test_displacements_are_counted_where_the_log_has_been():
    simulator = five(2)
    few = np.zeros(10, dtype=bool)
    few[0] = True  # the moves of state 0: displacements 0, 1, 2, ...
    names = [f.name for f in library(simulator, [], Rows.of(simulator).select(few)) if f.name.startswith("move")]
    assert set(names) <= {"move 0", "move +1", "move +2", "move +3", "move +4"}


def test_what_theory_names_and_what_is_for_each_action():
    simulator = five(3)
    levels = values_in(simulator, [np.tile([0.3, 0.7], (5, 1)), np.tile([1.0, 0.0], (5, 1))], None)
    features = library(simulator, levels, Rows.of(simulator))
    expected = {"log P", *(f"V of policy {k}{end}" for k in (1, 2) for end in ("", " / sd"))}
    assert {f.name for f in features if f.expected} == expected
    assert [f.name for f in features if not f.by_action] == ["(log P)^2"]
    table = by_action(features, 2)
    assert table.shape == (3, len(features))
    assert table[0].all()
    for part in (1, 2):
        assert [features[j].name for j in np.flatnonzero(~table[part])] == ["(log P)^2"]
    assert not by_action(features, 1)[1:].any()
    assert name_of((0, 0), features) == "log P"
    assert name_of((2, 2), features) == "stay, action 1"


def test_columns_of_chosen_features():
    base = np.arange(12.0).reshape(6, 2)
    action = np.array([0, 0, 1, 1, 0, 1])
    scale = np.array([[2.0, 4.0], [1.0, 8.0], [5.0, 1.0]])
    found = columns_of([(1, 0), (0, 2), (1, 1)], lambda j: base[:, j], scale, action)
    expected = [base[:, 1] / 4, base[:, 0] * (action == 1) / 5, base[:, 1] * (action == 0) / 8]
    assert_array_equal(found, np.column_stack(expected))


@settings(max_examples=20)
@given(rngs)
def test_values_in_the_simulator(rng):
    simulator = random_mdp(rng, discount=0.9)
    policies = [random_policy(rng, simulator) for _ in range(2)]
    for level, policy in zip(values_in(simulator, policies, None), policies, strict=True):
        assert_allclose(level, dense_values(simulator, policy), rtol=1e-8, atol=1e-8)
    (finite,) = values_in(simulator, policies[:1], 3)
    p, r = dense(simulator)
    level = np.zeros(simulator.n_states)
    for _ in range(3):
        level = np.einsum("sa,sat,sat->s", policies[0], p, r + 0.9 * level)
    assert_allclose(finite, level, atol=1e-10)


def test_a_policy_without_a_value_has_no_feature():
    ring = FiniteMDP([[[0.0, 1.0]], [[1.0, 0.0]]], [1.0, 1.0], [1, 0], 1.0)
    assert values_in(ring, [np.ones((2, 1))], None) == []
    assert_allclose(values_in(ring, [np.ones((2, 1))], 3), [[3.0, 3.0]])
    assert values_in(ring, [], 3) == []


def test_a_row_in_which_the_value_does_not_differ_is_not_divided_by_zero():
    simulator = FiniteMDP([[[0.5, 0.5]], [[0.25, 0.75]]], [0.0, 0.0], [1.0, 0.0], 0.9)
    features = named(library(simulator, [np.zeros(2)], Rows.of(simulator)))
    for name in ("V", "V / sd"):
        assert_array_equal(features[name].column(Rows.of(simulator)), 0.0)


# ---- the smoothest functions on the graph ------------------------------------------------------------------------


def normalised_laplacian(simulator):
    """(I - D^-1/2 W D^-1/2, D), W the mean over actions of P, both directions averaged, without its diagonal."""
    p = dense(simulator)[0].mean(axis=1)
    w = 0.5 * (p + p.T)
    np.fill_diagonal(w, 0.0)
    d = w.sum(axis=1)
    root = np.sqrt(np.where(d > 0, d, 1.0))
    return np.eye(len(w)) - w / root[:, None] / root, root


@pytest.mark.parametrize("small", [0, 200])
@pytest.mark.parametrize("name", ["random", "grid", "ring", "corridor"])
def test_smooth_functions_span_the_lowest_eigenspaces(name, small, monkeypatch):
    monkeypatch.setattr(graphs, "SMALL", small)
    simulator = {
        "random": lambda: random_mdp(np.random.default_rng(3), n_states=12, n_actions=2, zeros=0.5),
        "grid": lambda: oee.tasks.gridworld(5, 0.3),
        "ring": lambda: _ring(14),
        "corridor": lambda: _corridor(9),
    }[name]()
    laplacian, root = normalised_laplacian(simulator)
    values, vectors = linalg.eigh(laplacian)
    found = smooth_functions(simulator, 3)
    assert found.shape == (simulator.n_states, 3)
    assert_allclose(np.abs(found).max(axis=0), 1.0)
    for k in range(3):
        v = root * found[:, k]
        v = v / np.linalg.norm(v)
        assert_allclose(laplacian @ v, values[k + 1] * v, atol=1e-8)  # an eigenvector, of the k-th smallest eigenvalue
        near = np.abs(values - values[k + 1]) < 1e-8
        assert_allclose(np.linalg.norm(vectors[:, near].T @ v), 1.0, rtol=1e-8)
    v = root[:, None] * found
    assert np.linalg.matrix_rank(v, tol=1e-6) == 3


def _ring(n):
    p = np.zeros((n, 1, n))
    for s in range(n):
        p[s, 0, [(s + 1) % n, (s - 1) % n, s]] = 0.4, 0.4, 0.2
    return FiniteMDP(p, np.zeros(n), np.full(n, 1 / n), 0.9)


def _corridor(n):
    p = np.zeros((n, 1, n))
    for s in range(n):
        p[s, 0, max(s - 1, 0)] += 0.3
        p[s, 0, min(s + 1, n - 1)] += 0.7
    return FiniteMDP(p, np.zeros(n), np.full(n, 1 / n), 0.9)


def test_few_nodes_and_groups(monkeypatch):
    assert smooth_functions(five(2), 9).shape == (5, 3)  # of five nodes, eigenvectors 2 to 4
    two = FiniteMDP([[[0.5, 0.5]], [[0.5, 0.5]]], [0.0, 0.0], [1.0, 0.0], 0.9)
    assert smooth_functions(two, 3).shape == (2, 0)
    monkeypatch.setattr(graphs, "LARGEST", 6)
    group = graphs.neighbours(_corridor(24)).group
    found = smooth_functions(_corridor(24), 2)
    assert found.shape == (24, 2)
    for g in set(group):
        assert np.ptp(found[group == g], axis=0).max() == 0.0
    slope = np.sign(np.diff(found[:, 0]))
    assert set(slope[slope != 0]) in ({1.0}, {-1.0})  # from one end to the other


def test_states_that_nothing_leaves_or_enters():
    rows = np.zeros((4, 1, 4))
    rows[0, 0], rows[1, 0], rows[2, 0], rows[3, 0, 3] = [0.5, 0.5, 0, 0], [0.2, 0.4, 0.4, 0], [0, 0.5, 0.5, 0], 1.0
    found = smooth_functions(FiniteMDP(rows, np.zeros(4), [1, 0, 0, 0], 0.9), 3)
    assert np.isfinite(found).all()
