"""The solvers of a policy's linear system: one answer from all, bounds that bound, values right to the last bit."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from helpers import random_mdp, random_policy, rngs
from hypothesis import given, settings
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact import systems
from oee_tabular.exact.linear import DivergentKernelError, inverse_norm, solve_policy_system
from oee_tabular.exact.systems import System
from oee_tabular.exact.values import policy_kernel, policy_rewards


def rational(matrix, b, gamma):
    """(I - gamma K)^-1 b in fractions, by Gauss and Jordan."""
    n, g = len(b), Fraction(gamma)
    rows = [[(i == j) - g * Fraction(matrix[i][j]) for j in range(n)] + [Fraction(b[i])] for i in range(n)]
    for k in range(n):
        pivot = next(i for i in range(k, n) if rows[i][k] != 0)
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k and rows[i][k] != 0:
                f = rows[i][k]
                rows[i] = [value - f * other for value, other in zip(rows[i], rows[k], strict=True)]
    return [row[n] for row in rows]


def rational_values(mdp, policy, by_move=False):
    """The exact solution for the numbers as they are stored; ``by_move``: for r(s, a, s'), not for its expectation."""
    p, n = mdp.transitions.toarray(), mdp.n_states
    chance = [[Fraction(x) for x in row] for row in p.tolist()]
    act = [[Fraction(x) for x in row] for row in policy.tolist()]
    pay = [[Fraction(x) for x in row] for row in mdp.rewards.tolist()]
    if by_move and mdp.transition_rewards is not None:
        paid = [[Fraction(x) for x in row] for row in mdp.transition_rewards.toarray().tolist()]
        means = [sum(c * r for c, r in zip(*rows, strict=True)) for rows in zip(chance, paid, strict=True)]
        pay = [means[s * mdp.n_actions : (s + 1) * mdp.n_actions] for s in range(n)]
    actions = range(mdp.n_actions)
    kernel = [[sum(act[s][a] * chance[s * mdp.n_actions + a][t] for a in actions) for t in range(n)] for s in range(n)]
    return rational(kernel, [sum(act[s][a] * pay[s][a] for a in actions) for s in range(n)], mdp.discount)


def cycle(n):
    """A ring with a step back now and then."""
    at = np.arange(n)
    rows = np.concatenate([at, at])
    columns = np.concatenate([(at + 1) % n, (at - 1) % n])
    return sparse.csr_array((np.repeat([0.9, 0.1], n), (rows, columns)), shape=(n, n))


def grid(n):
    mdp = oee.tasks.gridworld(n, 0.3)
    return policy_kernel(mdp, oee.uniform_policy(mdp))


def layered(layers, width):
    rng = np.random.default_rng(0)
    n = layers * width
    kernel = sparse.lil_array((n, n))
    for s in range(n - width):
        layer = s // width + 1
        kernel[s, layer * width + rng.permutation(width)[:3]] = rng.dirichlet(np.ones(3))
    for s in range(n - width, n):
        kernel[s, s] = 1.0
    return sparse.csr_array(kernel)


def random_rows(n, entries):
    rng = np.random.default_rng(n)
    rows = np.repeat(np.arange(n), entries)
    data = rng.dirichlet(np.ones(entries), n).reshape(-1)
    return sparse.csr_array((data, (rows, rng.integers(0, n, n * entries))), shape=(n, n))


STRUCTURES = {
    "one state": sparse.csr_array([[1.0]]),
    "two that never meet": sparse.csr_array(np.eye(2)),
    "grid": grid(22),
    "layered": layered(12, 40),
    "expander": random_rows(600, 8),
    "ring": cycle(500),
    "disconnected": sparse.csr_array(sparse.block_diag([grid(15), random_rows(200, 3), cycle(100)])),
    "reducible": sparse.csr_array(
        sparse.block_array([[grid(12) * 0.7, random_rows(144, 2) * 0.3], [None, cycle(144)]])
    ),
    "lossy": grid(20) * 0.9,
    "rows above 1": sparse.csr_array(sparse.diags_array(np.where(np.arange(400) % 7 == 1, 1.2, 0.8)) @ grid(20)),
    "empty": sparse.csr_array((50, 50)),
    "dense": sparse.csr_array(np.random.default_rng(5).dirichlet(np.ones(60), 60)),
}


def solvers(system):
    """Every solver that can be asked for this system."""
    n = system.n_states
    found = {"library": systems.library(system)[0], "BiCGSTAB": systems.krylov(system)}
    if len(system.components[1]):
        found["components"] = systems.by_components(system)
    found["LU"] = systems.elimination(system, n - 1, n - 1, False)
    found["band"] = systems.elimination(system, n - 1, n - 1, True)
    if not system.transpose and system.sums[1] * system.discount < 1:
        found["value iteration"] = lambda b, relative: systems.sweeps(system, b, relative, 1.0)[0]
    return found


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("discount", [0.0, 0.9, 0.9999])
@pytest.mark.parametrize("name", STRUCTURES)
def test_all_solvers_give_one_answer_within_their_bounds(name, discount, transpose):
    kernel = STRUCTURES[name]
    b = np.random.default_rng(1).normal(size=kernel.shape[0])
    matrix = np.eye(len(b)) - discount * kernel.toarray()
    truth = np.linalg.solve(matrix.T if transpose else matrix, b)
    scale = np.abs(truth).sum() if transpose else np.abs(truth).max()
    size = 1e-12 / (1.0 - discount) * scale
    found = solve_policy_system(kernel, b, discount, transpose=transpose)
    proved = solve_policy_system(kernel, b, discount, transpose=transpose, certify=True)
    assert_allclose(found.x, truth, rtol=0, atol=size)
    assert proved.certified > 0.99  # all, but for a small entry beside large ones
    missed = np.abs(found.x - proved.x)
    assert (missed.sum() if transpose else missed.max()) <= found.error_bound + np.spacing(scale)
    assert found.error_bound < 1e-11 / (1 - discount) * scale + 1e-300
    spacing = np.spacing(np.abs(proved.x))  # certified: half of it at the most, and what is not a little more
    assert proved.error_bound <= (0.51 * spacing.sum() if transpose else 0.51 * spacing.max())
    system = System.of(kernel, discount, transpose)
    norm = inverse_norm(system)
    for solver_name, solver in solvers(system).items():
        x, (_, _, bound, _) = systems.refine(system, b, solver)
        missed = np.abs(x - proved.x)
        missed = missed.sum() if transpose else missed.max()
        slow = solver_name in systems.ITERATIVE  # its residual says so, and another solver is asked
        assert missed <= norm * bound + np.spacing(scale), solver_name
        assert slow or missed < size, solver_name


@pytest.mark.parametrize(
    ("name", "method"),
    [("one state", "dense LU"), ("grid", "BiCGSTAB"), ("layered", "LU by components"), ("expander", "value iteration"),
     ("ring", "banded LU"), ("dense", "value iteration"), ("rows above 1", "BiCGSTAB"), ("empty", "LU by components")],
)  # fmt: skip
def test_the_choice(name, method):
    kernel = STRUCTURES[name]
    b = np.random.default_rng(0).random(kernel.shape[0])
    assert solve_policy_system(kernel, b, 0.95).method == method


def test_no_direct_solver_is_asked_about_an_expander(monkeypatch):
    monkeypatch.setattr(systems, "library", None)
    for entries in (2, 3, 6, 20):
        kernel = random_rows(3000, entries)
        for discount in (0.9, 0.9999):
            for transpose in (False, True):
                found = solve_policy_system(kernel, np.ones(3000) / 3000, discount, transpose=transpose)
                assert found.method in ("BiCGSTAB", "value iteration")


def test_a_layered_kernel_is_solved_in_one_step():
    """In breadth-first order it is upper triangular, whatever the order of its states, and the preconditioner exact."""
    from oee_tabular.exact.solvers import _bicgstab as krylov

    kernel = STRUCTURES["layered"]
    shuffled = np.random.default_rng(3).permutation(480)
    for rows in (kernel, sparse.csr_array(kernel[shuffled][:, shuffled])):
        system = System.of(rows, 0.999)
        order, place = system.order
        assert_array_equal(np.sort(order), np.arange(480))
        assert_array_equal(order[place], np.arange(480))
        parts = system.indptr, system.indices, system.data, 0.999
        modified = krylov.modified_diagonal(*parts, 0.9, order, place)
        factors = krylov.split(*parts, order, place, modified)
        _, steps = krylov.bicgstab(*factors, np.ones(480) / modified, 1e-12, 0.0, 50)
        assert steps <= 1 + 2 * (rows is not kernel)


def levels(rng, n, size):
    """Sets of up to ``size`` states that communicate, each leading to sets after it; states in any order."""
    ends = np.unique(np.append(np.cumsum(rng.integers(1, size + 1, n)), n).clip(max=n))
    kernel = np.zeros((n, n))
    for low, high in zip(np.append(0, ends[:-1]), ends, strict=True):
        for i in range(low, high):
            kernel[i, low + (i - low + 1) % (high - low)] = rng.random() + 0.1
            later = rng.integers(low, n, 3)
            kernel[i, later] += rng.random(3) * (rng.random(3) < 0.7)
    kernel /= kernel.sum(axis=1, keepdims=True)
    at = rng.permutation(n)
    return kernel[at][:, at], len(ends)


def test_which_graphs_expand():
    from oee_tabular.exact.solvers.library import expands

    n = 900
    restart = sparse.csr_array((np.ones(n), (np.arange(n), np.zeros(n, dtype=int))), shape=(n, n))
    for kernel in (grid(25), sparse.csr_array(0.9 * grid(30) + 0.1 * restart), cycle(500), layered(40, 20),
                   sparse.csr_array(sparse.block_diag([grid(10)] * 20))):  # fmt: skip
        assert not expands(kernel)
    for entries in (2, 3, 8):
        assert expands(random_rows(900, entries))
    assert expands(sparse.csr_array(np.full((450, 450), 1 / 450)))  # nothing but hubs
    assert not expands(binary_tree(1023))


def binary_tree(n):
    """A walk up and down a tree; half of the states are its leaves."""
    rng, at = np.random.default_rng(0), np.arange(n)
    rows = np.concatenate([at[1:], (at[1:] - 1) // 2, [0]])
    columns = np.concatenate([(at[1:] - 1) // 2, at[1:], [0]])
    kernel = sparse.csr_array((rng.random(len(rows)) + 0.01, (rows, columns)), shape=(n, n))
    return sparse.csr_array(sparse.diags_array(1 / kernel.sum(axis=1)) @ kernel)


def test_a_large_tree_near_discount_one():
    kernel, b = binary_tree(4095), np.random.default_rng(1).normal(size=4095)
    found = solve_policy_system(kernel, b, 0.999999)
    assert_allclose(b + 0.999999 * (kernel @ found.x) - found.x, 0.0, atol=1e-10 * np.abs(found.x).max())
    assert found.error_bound < 1e-5 * np.abs(found.x).max()


def test_a_dense_model_of_two_halves_that_hardly_meet():
    """Value iteration and BiCGSTAB fail there, and every state is a hub: LAPACK answers."""
    rng = np.random.default_rng(0)
    p, half = rng.random((450, 450)), 225
    p[:half, half:] *= 1e-9
    p[half:, :half] *= 1e-9
    p /= p.sum(axis=1, keepdims=True)
    mdp = FiniteMDP(p[:, None], np.arange(450.0), np.ones(450) / 450, 1 - 1e-9)
    found = exact.evaluate_policy(mdp, np.ones((450, 1)))
    assert found.error_bound < 1e-3 * np.abs(found.values).max()


@pytest.mark.parametrize("power", [530, -530, 1000, -1000])
@pytest.mark.parametrize("certify", [False, True])
def test_the_scale_of_the_right_side_does_not_matter(power, certify):
    """But for what leaves the range of floats: powers of two change no bit."""
    for kernel in (random_rows(900, 3), grid(22), layered(12, 40)):
        kernel = sparse.csr_array(kernel * 0.9)
        b = np.random.default_rng(0).normal(size=kernel.shape[0])
        for transpose in (False, True):
            one, other = (
                solve_policy_system(kernel, right, 0.95, transpose=transpose, certify=certify)
                for right in (b, np.ldexp(b, power))
            )
            assert_array_equal(other.x, np.ldexp(one.x, power))
            assert_allclose(other.error_bound, np.ldexp(one.error_bound, power), rtol=1e-12, atol=1e-320)
    mdp = oee.tasks.gridworld(7, 0.3, discount=0.9)
    far = mdp.with_rewards(np.ldexp(mdp.rewards, power))
    near = mdp.with_rewards(mdp.rewards)
    one, other = (exact.evaluate_policy(m, oee.uniform_policy(mdp), certify=certify) for m in (near, far))
    assert_array_equal(other.values, np.ldexp(one.values, power))
    assert other.value == np.ldexp(one.value, power)
    assert other.certified == one.certified


def test_what_is_too_small_for_pairs_of_floats_is_not_certified():
    """0.94 / (1 - 0.94 g) of rewards around 1e-307 is right to the last bit; subnormal values are not said to be."""
    reward, gamma = 3.707675519592279e-307, 0.9378850624888447
    found = exact.evaluate_policy(FiniteMDP([[[1.0]]], [reward], [1.0], gamma), [[1.0]], certify=True)
    truth = Fraction(reward) / (1 - Fraction(gamma))
    assert abs(Fraction(float(found.values[0])) - truth) <= Fraction(found.error_bound)
    assert found.certified == 0.0 or found.values[0] == float(truth)
    small = exact.evaluate_policy(FiniteMDP([[[1.0]]], [3e-318], [1.0], gamma), [[1.0]], certify=True)
    assert small.certified == 0.0
    assert abs(Fraction(float(small.values[0])) - Fraction(3e-318) / (1 - Fraction(gamma))) <= Fraction(
        small.error_bound
    )


def test_the_certified_bound_of_a_transposed_system_is_of_the_sum():
    d = np.linspace(0.1, 0.9, 100)
    found = solve_policy_system(
        sparse.csr_array(sparse.diags_array(d)), np.ones(100), 0.5, transpose=True, certify=True
    )
    missed = sum(
        abs(Fraction(x) - 1 / (1 - Fraction(v) / 2)) for x, v in zip(found.x.tolist(), d.tolist(), strict=True)
    )
    assert missed <= Fraction(found.error_bound) < 10 * missed


@pytest.mark.parametrize(
    ("kernel", "b", "discount", "words"),
    [
        (np.eye(2), [1, 1], 0.5, "kernel must be a sparse matrix; got ndarray"),
        (sparse.csr_array((2, 3)), [1, 1], 0.5, r"kernel must be square, \(S, S\); it has shape \(2, 3\)"),
        (sparse.csr_array([[0.5, -0.5], [0, 1]]), [1, 1], 0.5, r"nonnegative; kernel\[0, 1\] is -0.5"),
        (sparse.csr_array([[0.5, 0.5], [0, np.nan]]), [1, 1], 0.5, r"finite and nonnegative; kernel\[1, 1\] is nan"),
        (sparse.csr_array(np.eye(2)), [1, 1, 1], 0.5, "b must have 2 entries, one a state; it has 3"),
        (sparse.csr_array(np.eye(2)), [[1], [1]], 0.5, r"b must have 1 dimension\(s\); it has shape \(2, 1\)"),
        (sparse.csr_array(np.eye(2)), [1, np.inf], 0.5, r"b.*1.*inf"),
        (sparse.csr_array(np.eye(2)), [1, 1], -1, "discount must be in"),
        (sparse.csr_array(np.eye(2)), [1, 1], np.nan, "discount must be"),
    ],
)
def test_bad_systems(kernel, b, discount, words):
    with pytest.raises(ValueError, match=words):
        solve_policy_system(kernel, np.array(b), discount)


def test_a_matrix_by_columns_is_read_as_what_it_is():
    kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    for form in (kernel, kernel.tocsc(), kernel.tocoo()):
        assert_allclose(solve_policy_system(form, np.array([1.0, 0.0]), 0.5).x, [4 / 3, 0.0], rtol=1e-15)


@pytest.mark.parametrize("certify", [False, True])
def test_where_iteration_fails_on_an_expander(monkeypatch, certify):
    """Up to 3000 states a dense solver answers; above, the bound says how far the iteration got."""
    monkeypatch.setattr(systems, "_mixing", lambda system, b: None)
    monkeypatch.setattr(systems, "krylov", lambda system: lambda b, relative: 0.9 * b)
    for n, method in ((900, "dense LU"), (3300, "BiCGSTAB")):
        b = np.random.default_rng(0).normal(size=n)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = solve_policy_system(random_rows(n, 3), b, 0.9, certify=certify)
        assert (len(said) == 1) == (n > 3000 and not certify)
        assert not said or "3300 states is solved only to a residual of" in str(said[0].message)
        missed = np.abs(found.x - 0.9 * (random_rows(n, 3) @ found.x) - b).max()
        assert found.method == method
        assert (missed < 1e-13) == (n == 900)
        assert missed <= 10 * found.error_bound + 1e-13
        assert found.error_bound < 1e3
        assert not certify or (found.certified == 1.0) == (n == 900)


@given(rngs)
def test_strongly_connected_components_are_found_and_ordered(rng):
    """Those of scipy, each after those that it leads to; one that is too large ends the search."""
    from oee_tabular.exact.solvers._components import components

    n = int(rng.integers(1, 70))
    dense, count = levels(rng, n, int(rng.integers(1, 9)))
    kernel = sparse.csr_array(dense)
    hidden = rng.random(kernel.nnz) < 0.2  # entries of 0 that are stored lead nowhere
    dense = np.where(
        sparse.csr_array((hidden, kernel.indices, kernel.indptr), shape=kernel.shape).toarray(), 0.0, dense
    )
    kernel.data[hidden] = 0.0
    seen, label = sparse.csgraph.connected_components(dense, directed=True, connection="strong")
    assert seen >= count
    parts = System.of(kernel, 0.5)
    order, starts = components(parts.indptr, parts.indices, parts.data, n)
    assert_array_equal(np.sort(order), np.arange(n))
    assert len(starts) == seen + 1
    sets = [set(order[low:high].tolist()) for low, high in zip(starts[:-1], starts[1:], strict=True)]
    assert {frozenset(s) for s in sets} == {frozenset(np.flatnonzero(label == c).tolist()) for c in range(seen)}
    place = np.empty(n, dtype=int)
    for number, states in enumerate(sets):
        place[list(states)] = number
    rows, columns = np.nonzero(dense)
    assert (place[columns] <= place[rows]).all()
    largest = max(len(states) for states in sets)
    for most in range(1, n + 1):
        found = components(parts.indptr, parts.indices, parts.data, most)
        assert (len(found[1]) > 0) == (most >= largest)
        assert len(found[0]) == n * (most >= largest)


@given(rngs)
def test_layered_systems_are_solved_by_components(rng):
    n = int(rng.integers(70, 120))
    dense, _ = levels(rng, n, 7)
    kernel, b = sparse.csr_array((dense > 0) | (rng.random((n, n)) < 0.05)).astype(float), rng.normal(size=n)
    kernel.data = dense[
        np.repeat(np.arange(n), np.diff(kernel.indptr)), kernel.indices
    ]  # some of them 0, where order ends
    discount = float(rng.choice([0.0, 0.9, 0.9999]))
    for transpose in (False, True):
        matrix = np.eye(n) - discount * (dense.T if transpose else dense)
        found = solve_policy_system(kernel, b, discount, transpose=transpose)
        assert found.method == "LU by components"
        truth = np.linalg.solve(matrix, b)
        assert_allclose(found.x, truth, rtol=0, atol=1e-12 / (1 - discount) * np.abs(truth).sum())
        missed = np.abs(found.x - solve_policy_system(kernel, b, discount, transpose=transpose, certify=True).x)
        assert (missed.sum() if transpose else missed.max()) <= found.error_bound + np.spacing(np.abs(truth).sum())


def test_a_layered_model_of_any_order_has_its_exact_values():
    """A clock in the state: T rounds of a grid world are its values over T steps."""
    small, steps = oee.tasks.gridworld(6, 0.3), 50
    n = small.n_states
    order = np.random.default_rng(0).permutation(n * steps)
    clock = sparse.csr_array(sparse.kron(sparse.eye_array(steps, k=1), small.transitions))
    last = sparse.csr_array((np.arange(clock.shape[0]) >= n * (steps - 1) * small.n_actions).astype(float)[:, None])
    end = sparse.csr_array(([1.0], ([0], [0])), shape=(1, 1))
    clock = sparse.csr_array(sparse.block_array([[clock, last], [None, sparse.vstack([end] * small.n_actions)]]))
    rewards = np.append(np.tile(small.rewards, (steps, 1)), np.zeros((1, small.n_actions)), axis=0)
    place = np.append(order, n * steps)  # the new number of a state
    back = np.argsort(place)
    rows = (back[:, None] * small.n_actions + np.arange(small.n_actions)).reshape(-1)
    policy = np.append(np.tile(oee.uniform_policy(small), (steps, 1)), np.full((1, 4), 0.25), axis=0)
    for discount in (0.99, 1.0):
        mdp = FiniteMDP(clock[rows][:, back], rewards[back], np.eye(n * steps + 1)[place[0]], discount)
        found = exact.evaluate_policy(mdp, policy[back])
        known = oee.state_values(small.with_discount(discount), oee.uniform_policy(small), horizon=steps)
        assert found.method == "LU by components"
        assert_allclose(found.values[place[:n]], known, rtol=1e-13)


@given(rngs)
@settings(max_examples=60)
def test_certified_values_are_the_exact_ones_correctly_rounded(rng):
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 6)), discount=float(rng.choice([0.0, 0.3, 0.9, 0.99, 0.9999])))
    policy = random_policy(rng, mdp)
    truth = rational_values(mdp, policy, by_move=True)
    found = exact.evaluate_policy(mdp, policy, certify=True)
    right = np.array([float(x) for x in truth])
    # around 0 a bound has two signs, and half way between floats no bound is small enough
    hard = np.array(
        [
            t == 0 or abs(Fraction(x) - t) * 4 >= Fraction(np.spacing(abs(x)))
            for x, t in zip(right.tolist(), truth, strict=True)
        ]
    )
    assert found.certified >= 1.0 - hard.mean() - 1e-12
    assert_array_equal(found.values[~hard], right[~hard])
    assert_allclose(found.values[hard], right[hard], rtol=3e-16, atol=1e-25)
    assert max(abs(Fraction(v) - t) for v, t in zip(found.values.tolist(), truth, strict=True)) <= found.error_bound
    value = sum(Fraction(m) * t for m, t in zip(mdp.initial.tolist(), truth, strict=True))
    ulps = np.spacing(abs(float(value))) + np.spacing(
        np.abs(right).max()
    )  # values of both signs may cancel (rng 10270478)
    assert abs(Fraction(found.value) - value) <= Fraction(ulps) + Fraction(1, 10**25)
    plain = exact.evaluate_policy(mdp, policy)
    assert plain.certified is None
    truth = rational_values(mdp, policy)
    worst = max(abs(Fraction(v) - t) for v, t in zip(plain.values.tolist(), truth, strict=True))
    assert worst <= Fraction(plain.error_bound)
    assert_array_equal(oee.state_values(mdp, policy, certify=True), found.values)


@pytest.mark.parametrize("scale", [1.0, 2.0**-700])
def test_rewards_of_moves_that_cancel_are_certified(scale):
    """r(s, a) = sum P r(s, a, s') loses six digits to cancellation when it is rounded: V is right to the last bit."""
    rng = np.random.default_rng(4)
    for _ in range(30):
        p = rng.dirichlet(np.ones(4), (4, 2))
        rewards = rng.normal(size=(4, 2, 4))
        rewards -= (1.0 - 1e-6) * (p * rewards).sum(axis=2)[:, :, None]
        mdp = oee.FiniteMDP(p, rewards * scale, [1, 0, 0, 0], 0.9)
        policy = rng.dirichlet(np.ones(2), 4)
        truth = rational_values(mdp, policy, by_move=True)
        found = exact.evaluate_policy(mdp, policy, certify=True)
        assert found.certified == 1.0
        assert_array_equal(found.values, [float(v) for v in truth])
        assert max(abs(Fraction(v) - t) for v, t in zip(found.values.tolist(), truth, strict=True)) <= found.error_bound


@given(rngs)
@settings(max_examples=30)
def test_the_bound_of_a_compiled_small_system_bounds(rng):
    """Kernels of any row sums, against fractions; the rounding of the policy's kernel and rewards is in the bound."""
    mdp = random_mdp(rng, n_states=4, n_actions=3, discount=float(rng.choice([0.5, 0.95])))
    ratio = mdp.transitions.copy()
    ratio.data = rng.random(ratio.nnz) * 1.3
    model, policy = exact.reweight(mdp, ratio), random_policy(rng, mdp)
    try:
        found = exact.evaluate_policy(model, policy)
    except DivergentKernelError:
        return
    truth = rational_values(model, policy)
    worst = max(abs(Fraction(v) - t) for v, t in zip(found.values.tolist(), truth, strict=True))
    assert worst <= Fraction(found.error_bound)
    batched = exact.evaluate_batch([model], [policy])
    worst = max(abs(Fraction(v) - t) for v, t in zip(batched.values[0].tolist(), truth, strict=True))
    assert worst <= Fraction(float(batched.error_bound[0]))


def test_certified_at_discount_1_and_where_nothing_is_paid():
    rows = np.array([[[0.1, 0.7, 0.2]], [[0.3, 0.3, 0.4]], [[0.0, 0.0, 1.0]]])
    mdp = FiniteMDP(rows, [1.0, 1 / 3, 0.0], [1, 0, 0], 1.0)
    found = exact.evaluate_policy(mdp, np.ones((3, 1)), certify=True)
    inner = rational(rows[:2, 0, :2].tolist(), [1.0, 1 / 3], 1.0)
    assert found.certified == 1.0
    assert_array_equal(found.values, [*(float(x) for x in inner), 0.0])
    free = mdp.with_rewards(np.zeros(3)).with_discount(0.9)
    found = exact.evaluate_policy(free, np.ones((3, 1)), certify=True)
    assert (found.values.tolist(), found.certified, found.value) == ([0.0] * 3, 1.0, 0.0)
    over = FiniteMDP(np.ones((1, 1, 1)), [0.0], [1.0], 1.0)
    assert exact.evaluate_policy(over, np.ones((1, 1)), certify=True).certified == 1.0


def test_what_cannot_be_certified_is_said():
    """2 (1 - 1/2) - 1 = 0 without the graph telling so, and a value half way between two floats."""
    cancels = sparse.csr_array([[0.0, 1.0], [0.0, 0.0]])
    found = solve_policy_system(cancels, np.array([-0.5, 1.0]), 0.5, certify=True)
    assert_allclose(found.x, [0.0, 1.0], atol=1e-25)
    assert found.certified == 0.5
    half_way = sparse.csr_array([[0.0, 2.0**-53], [0.0, 0.0]])
    found = solve_policy_system(half_way, np.array([1.0, 1.0]), 1.0, certify=True)
    assert found.certified == 0.5
    assert abs(found.x[0] - 1.0) <= np.spacing(1.0)


def test_certify_is_for_the_infinite_sum():
    mdp = oee.tasks.gridworld(3, 0.3)
    with pytest.raises(ValueError, match="certify must be False with a horizon"):
        exact.evaluate_policy(mdp, oee.uniform_policy(mdp), horizon=3, certify=True)


@given(rngs)
def test_the_policy_kernel_is_the_product(rng):
    """Merged, sorted, without zeros: bit for bit what the sparse product gives."""
    mdp = random_mdp(rng, n_states=int(rng.integers(1, 50)), zeros=float(rng.choice([0.0, 0.3, 0.9])))
    policy = random_policy(rng, mdp)
    n, m = mdp.n_states, mdp.n_actions
    averaging = sparse.csr_array((policy.reshape(-1), np.arange(n * m), np.arange(n + 1) * m), shape=(n, n * m))
    product = sparse.csr_array(averaging @ mdp.transitions)
    product.sort_indices()
    product.eliminate_zeros()
    kernel = policy_kernel(mdp, policy)
    assert kernel.has_canonical_format
    for part in ("data", "indices", "indptr"):
        assert_array_equal(getattr(kernel, part), getattr(product, part))
    assert_allclose(policy_rewards(mdp, policy), np.einsum("sa,sa->s", policy, mdp.rewards), rtol=1e-14)


def test_wide_index_arrays_and_unsorted_rows_are_taken():
    kernel = STRUCTURES["grid"]
    parts = kernel.data[::-1].copy(), kernel.indices[::-1].astype(np.int64), kernel.nnz - kernel.indptr[::-1]
    wide = sparse.csr_array((*parts[:2], parts[2].astype(np.int64)), shape=kernel.shape)
    b = np.random.default_rng(0).random(484)
    flipped = sparse.csr_array(kernel.toarray()[::-1])
    assert_allclose(
        solve_policy_system(wide, b, 0.9).x, np.linalg.solve(np.eye(484) - 0.9 * flipped.toarray(), b), rtol=1e-11
    )


def test_policies_in_fortran_order_are_taken():
    for size in (3, 12):
        mdp = oee.tasks.gridworld(size, 0.3)
        policy = random_policy(np.random.default_rng(0), mdp)
        expected = exact.evaluate_policy(mdp, policy).values
        assert_array_equal(exact.evaluate_policy(mdp, np.asfortranarray(policy)).values, expected)
        assert_array_equal(exact.evaluate_batch(mdp, [np.asfortranarray(policy)]).values[0], expected if size > 5 else
                           exact.evaluate_batch(mdp, [policy]).values[0])  # fmt: skip


@pytest.mark.parametrize("name", ["one state", "grid", "layered", "expander", "ring", "dense", "disconnected"])
def test_without_a_discount_a_closed_class_diverges(name):
    kernel = STRUCTURES[name]
    for transpose in (False, True):
        for certify in (False, True):
            with pytest.raises(DivergentKernelError, match=r"spectral radius of (1|0\.9999)"):
                solve_policy_system(kernel, np.ones(kernel.shape[0]), 1.0, transpose=transpose, certify=certify)
    with pytest.raises(DivergentKernelError, match=r"spectral radius of 1\."):
        solve_policy_system(kernel * 1.5, np.ones(kernel.shape[0]), 0.9)


@given(rngs)
def test_residuals_and_what_bounds_them(rng):
    """Each kernel that computes a residual, against the formulas in its docstring."""
    from oee_tabular.exact import _policy_rows as policy_rows
    from oee_tabular.exact.solvers import _elimination as small_systems

    n, discount, formed = int(rng.integers(2, 9)), float(rng.random()), 3.0
    dense = rng.random((n, n)) * (rng.random((n, n)) < 0.6)
    b, x = rng.normal(size=(2, n)) * 10.0 ** rng.integers(-3, 4, (2, n))
    parts = System.of(sparse.csr_array(dense), discount)
    unit = 0.5 * np.finfo(float).eps
    for transpose, matrix in ((False, dense), (True, dense.T)):
        kernel = policy_rows.residual_transposed if transpose else policy_rows.residual
        missed, largest, bound, rounding = kernel(parts.indptr, parts.indices, parts.data, discount, b, x, formed)
        sizes = discount * (matrix @ np.abs(x)) + np.abs(x) + np.abs(b)
        here = unit * ((matrix > 0).sum(axis=1) + 4 + formed) * sizes
        truth = b + discount * (matrix @ x) - x
        assert (np.abs(missed - truth) <= 2 * here).all()
        assert largest == np.abs(missed).max()
        assert_allclose(rounding, here.max(), rtol=1e-7)
        whole = np.abs(missed) + here
        assert_allclose(bound, whole.sum() if transpose else whole.max(), rtol=1e-7)
        assert bound >= (whole.sum() if transpose else whole.max()) * (1 - 1e-15)
    out = np.empty(n)
    largest, bound = small_systems.missing(dense.reshape(-1), discount, b, x, out, formed)
    sizes = discount * (dense @ np.abs(x)) + np.abs(x) + np.abs(b)
    assert largest == np.abs(out).max()
    assert_allclose(bound, (np.abs(out) + unit * (n + 4 + formed) * sizes).max(), rtol=1e-7)
    # where nothing is missed only the roundings are left
    zero = np.zeros(n)
    assert_allclose(small_systems.missing(dense.reshape(-1), 0.0, b, b, out, formed),
                    (0.0, unit * (n + 4 + formed) * 2 * np.abs(b).max()), rtol=1e-7)  # fmt: skip
    assert small_systems.missing(dense.reshape(-1), discount, zero, zero, out, formed) == (0.0, 0.0)
