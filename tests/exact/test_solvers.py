"""Every solver of a policy's linear system against the same laws, on kernels of every structure; the choice; the kernels."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers import dense_values, rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from structures import STRUCTURES, binary_tree, cycle, grid, layered, random_rows

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact import solvers
from oee_tabular.exact.linear import solve_policy_system
from oee_tabular.exact.solvers import (
    SOLVERS,
    _bicgstab,
    _envelope,
    _graph,
    _reduction,
    _value_iteration,
    inverse_norm,
    refine,
)
from oee_tabular.exact.solvers.bicgstab import BiCGStab
from oee_tabular.exact.solvers.envelope import EnvelopeLU
from oee_tabular.exact.solvers.lapack import LAPACK
from oee_tabular.exact.solvers.superlu import SuperLU
from oee_tabular.exact.system import System, spectral_radius

LAST = SOLVERS[-3:]  # LAPACK, SuperLU, LAPACK of more states
OTHERS = (LAPACK(700), BiCGStab(is_reduced=False), EnvelopeLU(), SuperLU(100.0))  # as the options have it


@dataclass
class Stub:
    """A solver that does what it is told."""

    name: str
    solve: Any
    is_direct: bool = False

    def suits(self, system):
        return True

    def prepare(self, system):
        return self.solve


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("discount", [0.0, 0.9, 0.9999])
@pytest.mark.parametrize("name", STRUCTURES)
def test_every_solver_gives_the_one_answer_within_its_bound(name, discount, transpose):
    kernel = STRUCTURES[name]
    b = np.random.default_rng(1).normal(size=kernel.shape[0])
    matrix = np.eye(len(b)) - discount * kernel.toarray()
    truth = np.linalg.solve(matrix.T if transpose else matrix, b)
    scale = np.abs(truth).sum() if transpose else np.abs(truth).max()
    size = 1e-12 / (1.0 - discount) * scale
    found = solve_policy_system(kernel, b, discount, transpose=transpose)
    assert_allclose(found.x, truth, rtol=0, atol=size)
    missed = np.abs(found.x - truth)
    assert (missed.sum() if transpose else missed.max()) <= found.error_bound + size
    assert found.error_bound < 1e-11 / (1 - discount) * scale + 1e-300
    system = System.from_csr(kernel, discount, transpose)
    norm = inverse_norm(system)
    for solver in (*SOLVERS, *OTHERS):
        if not solver.suits(system):
            continue
        answer = refine(system, b, solver.prepare(system), solver.name)
        if answer is None:  # value iteration where the graph does not mix
            assert not solver.is_direct
            continue
        missed = np.abs(answer.x - truth)
        missed = missed.sum() if transpose else missed.max()
        # an iteration may end above its rounding: its residual says so, and another solver is asked
        assert missed <= norm * answer.bound + size, solver
        assert missed < size or not solver.is_direct, solver


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("n", [3, 30, 200, 500])
def test_a_direct_solver_answers_a_singular_system_with_nan(n, transpose):
    """From which divergence is concluded; the name of the method is that of the solver that was asked first."""
    singular = System.from_csr(sparse.csr_array(sparse.eye_array(n)), 1.0, transpose)
    asked = [solver for solver in (*SOLVERS, *OTHERS) if solver.is_direct and solver.suits(singular)]
    assert asked
    for solver in asked:
        assert np.isnan(solver.prepare(singular)(np.ones(n), 0.0)).all()
    found = solvers.answer(singular, np.ones(n))
    assert np.isnan(found.x).all()
    assert np.isnan(found.largest)


def test_the_iteration_refines_to_rounding_and_leaves_zero_alone():
    system, solver = System.from_csr(grid(25), 0.99), BiCGStab()
    b = np.random.default_rng(0).random(625)
    x, missed, largest, bound, rounding, _ = refine(system, b, solver.prepare(system), solver.name)
    assert_allclose(missed, b + 0.99 * (system.csr() @ x) - x, rtol=0, atol=1e-15 * np.abs(x).max())
    assert largest == np.abs(missed).max() < 1e-14 * np.abs(x).max()
    assert largest < bound <= largest + rounding
    x, missed, largest, *_ = refine(system, np.zeros(625), solver.prepare(system), solver.name)
    assert_array_equal(x, np.zeros(625))
    assert_array_equal(missed, np.zeros(625))
    assert largest == 0.0


def test_where_iteration_fails_the_direct_solver_answers(monkeypatch):
    grid = oee.tasks.gridworld(25, 0.3)
    policy = oee.uniform_policy(grid)
    monkeypatch.setattr(solvers, "SOLVERS", (Stub("BiCGSTAB", lambda b, relative: np.zeros(len(b))), *LAST))
    found = exact.evaluate_policy(grid, policy)
    assert found.method == "sparse LU"
    assert_allclose(found.values, dense_values(grid, policy), rtol=1e-10, atol=1e-10)


def test_where_iteration_fails_on_an_expander(monkeypatch):
    """Up to 3000 states a dense solver answers; above, the bound says how far the iteration got."""
    monkeypatch.setattr(solvers, "SOLVERS", (Stub("BiCGSTAB", lambda b, relative: 0.9 * b), *LAST))
    for n, method in ((900, "dense LU"), (3300, "BiCGSTAB")):
        b = np.random.default_rng(0).normal(size=n)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = solve_policy_system(random_rows(n, 3), b, 0.9)
        assert (len(said) == 1) == (n > 3000)
        assert not said or "3300 states is solved only to a residual of" in str(said[0].message)
        missed = np.abs(found.x - 0.9 * (random_rows(n, 3) @ found.x) - b).max()
        assert found.method == method
        assert (missed < 1e-13) == (n == 900)
        assert missed <= 10 * found.error_bound + 1e-13
        assert found.error_bound < 1e3


def test_no_direct_solver_is_asked_about_an_expander(monkeypatch):
    monkeypatch.setattr(solvers, "SOLVERS", SOLVERS[: -len(LAST)])
    for entries in (2, 3, 6, 20):
        kernel = random_rows(3000, entries)
        for discount in (0.9, 0.9999):
            for transpose in (False, True):
                found = solve_policy_system(kernel, np.ones(3000) / 3000, discount, transpose=transpose)
                assert found.method in ("BiCGSTAB", "value iteration")


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


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("discount", [0.99, 0.99999])
def test_graphs_that_expand_are_solved_without_a_preconditioner(discount, transpose):
    """By sweeps where they mix; blocks that seldom meet by plain BiCGSTAB, whose steps the discount does not add to."""
    random, n = random_rows(2000, 3), 2000
    blocks = sparse.csr_array(
        0.999 * sparse.block_diag([random_rows(500, 5)] * 4) + 0.001 * sparse.csr_array(random_rows(n, 5))
    )
    b = np.random.default_rng(0).normal(size=n)
    assert solve_policy_system(random_rows(n, 8), b, discount, transpose=transpose).method == "value iteration"
    system, solver = System.from_csr(blocks, discount, transpose), BiCGStab(is_plain=True)
    assert _value_iteration.sweeps(system.kernel, system.largest, transpose, b, 0.0) is None
    assert solver.suits(system)
    found = refine(system, b, solver.prepare(system), solver.name)
    assert found.largest <= found.rounding
    truth = np.linalg.solve(system.matrix().toarray(), b)
    assert_allclose(found.x, truth, rtol=0, atol=1e-12 / (1 - discount) * np.abs(truth).max())
    assert not solver.suits(System.from_csr(grid(25), discount))
    assert not solver.suits(System.from_csr(cycle(500), discount))
    assert solver.suits(System.from_csr(random, discount))


@pytest.mark.parametrize("discount", [0.99, 0.99999])
def test_an_even_start_does_not_end_the_plain_iteration(discount):
    """Ones are an eigenvector of what the transposed residuals are held against: a Krylov space of one dimension."""
    n, rng = 2000, np.random.default_rng(3)
    weights, ahead = rng.dirichlet(np.ones(2), n).reshape(-1), rng.integers(n, size=2 * n)
    kernel = sparse.csr_array((weights, (np.repeat(np.arange(n), 2), ahead)), (n, n))
    system, solver, b = System.from_csr(kernel, discount, True), BiCGStab(is_plain=True), np.full(n, (1 - discount) / n)
    assert _value_iteration.sweeps(system.kernel, system.largest, True, b, 0.0) is None
    found = refine(system, b, solver.prepare(system), solver.name)
    assert found is not None
    assert found.largest <= found.rounding
    truth = np.linalg.solve(system.matrix().toarray(), b)
    assert_allclose(found.x, truth, rtol=0, atol=1e-14 / (1 - discount) * found.x.max())
    assert solve_policy_system(kernel, b, discount, transpose=True).method == "BiCGSTAB"


def test_rounding_of_long_rows_does_not_stop_the_sweeps():
    rng = np.random.default_rng(0)
    rows = rng.random((600, 600))
    rows /= rows.sum(axis=1, keepdims=True)
    for discount in (0.99, 0.99999):
        assert solve_policy_system(sparse.csr_array(rows), rng.normal(size=600), discount).method == "value iteration"


def test_a_large_tree_near_discount_one():
    kernel, b = binary_tree(4095), np.random.default_rng(1).normal(size=4095)
    found = solve_policy_system(kernel, b, 0.999999)
    assert_allclose(b + 0.999999 * (kernel @ found.x) - found.x, 0.0, atol=1e-10 * np.abs(found.x).max())
    assert found.error_bound < 1e-5 * np.abs(found.x).max()


def test_which_graphs_expand():
    """Lattices, rings and layers do not, random graphs and small worlds do."""
    n = 900
    restart = sparse.csr_array((np.ones(n), (np.arange(n), np.zeros(n, dtype=int))), shape=(n, n))
    for kernel in (grid(25), sparse.csr_array(0.9 * grid(30) + 0.1 * restart), cycle(500), layered(40, 20),
                   sparse.csr_array(sparse.block_diag([grid(10)] * 20))):  # fmt: skip
        assert not _graph.expands(System.from_csr(kernel, 0.9).kernel)
    for entries in (2, 3, 8):
        assert _graph.expands(System.from_csr(random_rows(900, entries), 0.9).kernel)
    assert not EnvelopeLU().suits(System.from_csr(random_rows(900, 3), 0.9))
    assert SuperLU(8.0).suits(System.from_csr(binary_tree(1023), 0.9))
    for kernel in (random_rows(900, 3), grid(40)):
        assert not SuperLU(8.0).suits(System.from_csr(kernel, 0.9))


@given(rngs)
def test_count_of_fill_and_envelope(rng):
    """The count is that of dense elimination of the pattern of M + M^T; the factors multiply to M in that order."""
    n, gamma = int(rng.integers(2, 30)), 0.9
    kernel = rng.random((n, n)) * (rng.random((n, n)) < rng.choice([0.05, 0.2]))
    kernel /= np.maximum(kernel.sum(axis=1, keepdims=True), 1e-9)
    system = System.from_csr(sparse.csr_array(kernel), gamma)
    order = system.order[0].astype(int)[::-1]
    pattern = ((kernel + kernel.T + np.eye(n)) > 0)[order][:, order]
    for k in range(n):
        pattern[k + 1 :, k + 1 :] |= np.outer(pattern[k + 1 :, k], pattern[k, k + 1 :])
    assert _graph.count_fill(system.kernel, system.back, *system.order, 1e9) == np.tril(pattern, -1).sum()
    states, first, starts = _envelope.find_envelope(system.kernel, system.order[1])
    factors, is_regular = _envelope.factorise(system.kernel, system.order[1], states, first, starts)
    assert is_regular
    lower, upper = np.eye(n), np.diag(factors.diagonal)
    for i in range(n):
        lower[i, first[i] : i] = factors.lower[starts[i] : starts[i + 1]]
        upper[first[i] : i, i] = factors.upper[starts[i] : starts[i + 1]]
    matrix = (np.eye(n) - gamma * kernel)[order][:, order]
    assert_allclose(lower @ upper, matrix, atol=1e-13)


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
        assert_allclose(found.values[place[:n]], known, rtol=1e-13)


def test_a_layered_kernel_is_solved_in_one_step():
    """In breadth-first order it is upper triangular, whatever the order of its states, and the preconditioner exact."""
    kernel = STRUCTURES["layered"]
    shuffled = np.random.default_rng(3).permutation(480)
    for rows in (kernel, sparse.csr_array(kernel[shuffled][:, shuffled])):
        system = System.from_csr(rows, 0.999)
        order, place = system.order
        assert_array_equal(np.sort(order), np.arange(480))
        assert_array_equal(order[place], np.arange(480))
        factors = _bicgstab.factorise(system.kernel, False, 0.9, order, place)
        _, steps = _bicgstab.bicgstab(factors, np.ones(480) / factors.modified, 1e-12, 0.0, 50)
        assert steps <= 1 + 2 * (rows is not kernel)


@given(rngs)
def test_kernels_are_what_numpy_says(rng):
    """The plain twins: elimination, value iteration's sweeps, the reduced system, the modified diagonal."""
    n, gamma = int(rng.integers(2, 12)), float(rng.choice([0.5, 0.95]))
    kernel = rng.random((n, n)) * (rng.random((n, n)) < 0.5)
    kernel /= np.maximum(kernel.sum(axis=1, keepdims=True), 1e-9)
    system = System.from_csr(sparse.csr_array(kernel), gamma)
    matrix, b = np.eye(n) - gamma * kernel, rng.normal(size=n)
    for transpose, m in ((False, matrix), (True, matrix.T)):
        x, (order, _) = np.linalg.solve(m, b), system.order
        mark, inverse, room = _reduction.independent(system.kernel, order)
        inside = mark == 1
        assert not (kernel * (1 - np.eye(n)))[np.ix_(inside, inside)].any()
        rest, reduction = _reduction.eliminate(system.kernel, order, mark, inverse, room)
        left = reduction.states.astype(int)
        assert_array_equal(np.sort(left), np.flatnonzero(~inside))
        crossing = m[np.ix_(left, inside)] @ np.linalg.solve(m[np.ix_(inside, inside)], m[np.ix_(inside, left)])
        schur = m[np.ix_(left, left)] - crossing
        reduced = sparse.csr_array(
            (rest.data, rest.indices.astype(int), rest.indptr.astype(int)), shape=(len(left),) * 2
        )
        reduced = np.eye(len(left)) - (reduced.T if transpose else reduced).toarray()
        assert_allclose(reduced, schur, atol=1e-13)
        right = _reduction.reduce_right(system.kernel, reduction, transpose, b)
        assert_allclose(
            _reduction.extend(system.kernel, reduction, transpose, b, np.linalg.solve(schur, right)), x, atol=1e-11
        )
    swept, shifted = _value_iteration.sweeps(system.kernel, 1.0, False, b, 0.0), b
    if swept is not None and np.abs(kernel.sum(axis=1) - 1.0).max() < 1e-9:
        for _ in range(2000):
            shifted = b + gamma * kernel @ shifted
        assert_allclose(swept, shifted, rtol=1e-10, atol=1e-10)
    place = rng.permutation(n).astype(np.uint32)
    order = np.argsort(place).astype(np.uint32)
    ordered, pivots, later = matrix[order][:, order], np.zeros(n), np.zeros(n)
    for i in range(n):
        plain = ordered[i, i]
        pivots[i] = plain - 0.9 * sum(-ordered[i, j] * later[j] for j in range(i))
        pivots[i] = pivots[i] if pivots[i] > 0.05 * plain else plain
        later[i] = -ordered[i, i + 1 :].sum() / pivots[i]
    assert_allclose(_bicgstab.modified_diagonal(system.kernel, 0.9, order, place), pivots, rtol=1e-12)


@given(rngs)
def test_residuals_and_what_bounds_them(rng):
    """Each kernel that computes a residual, against the formulas in its docstring."""
    from oee_tabular.exact import _policy_rows as policy_rows

    n, discount, formed = int(rng.integers(2, 9)), float(rng.random()), 3.0
    dense = rng.random((n, n)) * (rng.random((n, n)) < 0.6)
    b, x = rng.normal(size=(2, n)) * 10.0 ** rng.integers(-3, 4, (2, n))
    parts = System.from_csr(sparse.csr_array(dense), discount)
    unit = 0.5 * np.finfo(float).eps
    for transpose, matrix in ((False, dense), (True, dense.T)):
        kernel = policy_rows.residual_transposed if transpose else policy_rows.residual
        missed, largest, bound, rounding = kernel(parts.kernel, b, x, formed)
        sizes = discount * (matrix @ np.abs(x)) + np.abs(x) + np.abs(b)
        here = unit * ((matrix > 0).sum(axis=1) + 4 + formed) * sizes
        truth = b + discount * (matrix @ x) - x
        assert (np.abs(missed - truth) <= 2 * here).all()
        assert largest == np.abs(missed).max()
        assert_allclose(rounding, here.max(), rtol=1e-7)
        whole = np.abs(missed) + here
        assert_allclose(bound, whole.sum() if transpose else whole.max(), rtol=1e-7)
        assert bound >= (whole.sum() if transpose else whole.max()) * (1 - 1e-15)


@pytest.mark.parametrize(
    ("kernel", "discount", "radius"),
    [
        ([[0, 1], [0, 0]], 1.0, 0.0),
        ([[1, 0], [0, 1]], 1.0, 1.0),
        ([[1, 0], [0, 1]], 0.25, 0.25),
        ([[0, 2], [0.5, 0]], 1.0, 1.0),
        ([[0, 9], [1, 0]], 0.5, 1.5),
    ],
)
def test_the_spectral_radius_of_simple_kernels(kernel, discount, radius):
    assert_allclose(spectral_radius(sparse.csr_array(kernel, dtype=float), discount), radius, rtol=1e-12)


@pytest.mark.parametrize(
    ("kernel", "discount"), [([[0.5, 0.5], [0.2, 0.3]], 0.9), ([[0.5, 0.3], [0.2, 0.3]], 0.5), ([[0, 0], [0, 0]], 0.9)]
)
def test_rows_below_one_need_no_certificate(kernel, discount, monkeypatch):
    """|M^-1| = 1 / (1 - gamma * largest row sum) is known from them: no second system is solved for it."""
    monkeypatch.setattr(solvers, "answer", None)
    norm = inverse_norm(System.from_csr(sparse.csr_array(kernel, dtype=float), discount))
    assert_allclose(norm, 1 / (1 - discount * max(map(sum, kernel))), rtol=1e-12)


def test_the_certificate_counts_its_own_residual(monkeypatch):
    """|M^-1| <= max h / (1 - residual); half of it or more, or an h that is not positive, certifies nothing."""
    kernel = sparse.csr_array(np.array([[0.0, 2.0], [0.1, 0.0]]))
    for residual, h in (([0.2, -0.4], [3.0, 1.0]), ([0.2, -0.6], [3.0, 1.0]), ([0.0, 0.0], [3.0, 0.0])):
        largest = np.abs(residual).max()
        answer = solvers.Answer(np.array(h), np.array(residual), largest, largest, 0.0, "dense LU")
        monkeypatch.setattr(solvers, "answer", lambda system, b, answer=answer: answer)
        if min(residual) == -0.4:
            assert_allclose(inverse_norm(System.from_csr(kernel, 0.9)), 3.0 / 0.6)
        else:
            with pytest.raises(ValueError, match=r"spectral radius of 0\.402492"):
                inverse_norm(System.from_csr(kernel, 0.9))


@given(rngs)
def test_the_norm_of_the_inverse_is_bounded_by_its_certificate(rng):
    """Kernels whose rows exceed 1: |(I - gamma K)^-1|_inf is at most what the M-matrix certificate says, and near it."""
    n = int(rng.integers(2, 7))
    kernel = rng.random((n, n)) * (rng.random((n, n)) < 0.6)
    kernel[0] *= 3.0
    radius = np.abs(np.linalg.eigvals(kernel)).max()
    if radius == 0:
        return
    kernel *= 1.05 / radius
    bound = inverse_norm(System.from_csr(sparse.csr_array(kernel), 0.9))
    norm = np.abs(np.linalg.inv(np.eye(n) - 0.9 * kernel)).sum(axis=1).max()
    assert norm <= bound * (1 + 1e-12)
    if 0.9 * kernel.sum(axis=1).max() > 1:
        assert_allclose(bound, norm, rtol=1e-6)


@pytest.mark.parametrize("entries", [5, 200])
def test_near_discount_one_occupancies_sum_to_one(entries):
    """Up to the rounding of the rows' own sums, eps / (1 - discount); with that of the bound on them 1e-8 and 3e-7."""
    rng = np.random.default_rng(0)
    weights, columns = rng.dirichlet(np.ones(entries), size=200), rng.integers(200, size=200 * entries)
    rows = sparse.coo_array((weights.ravel(), (np.repeat(np.arange(200), entries), columns)), shape=(200, 200))
    mdp = oee.FiniteMDP(rows.tocsr(), np.ones(200), np.eye(200)[0], 1.0 - 1e-7)
    assert oee.exact.evaluate_policy(mdp, np.ones((200, 1))).method == "value iteration"
    assert abs(oee.occupancy(mdp, np.ones((200, 1))).sum() - 1.0) < 4e-9


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("name", STRUCTURES)
def test_a_correction_leaves_its_share(name, transpose, monkeypatch):
    """Of what a vector near by misses; where all that are asked give up, or leave too much, the answer is exact."""
    system = System.from_csr(STRUCTURES[name], 0.95, transpose)
    b = np.random.default_rng(1).normal(size=len(system.kernel.indptr) - 1)
    exact_one = solvers.answer(system, b)
    near = exact_one.x * (1.0 + 0.01 * np.random.default_rng(2).normal(size=len(b)))
    missed = np.abs(b - (system.matrix() @ near)).max()
    found = solvers.correct(system, b, near, 1e-3)
    assert_allclose(found.missed, b - system.matrix() @ found.x, rtol=0, atol=1e-13 * np.abs(found.x).max())
    assert found.largest <= 1e-2 * missed
    for poor in (lambda b, relative: None, lambda b, relative: 0.5 * b):
        monkeypatch.setattr(solvers, "STEADY", [Stub("poor", poor)])
        assert_array_equal(solvers.correct(system, b, near, 1e-3).x, exact_one.x)
    asked = []
    monkeypatch.setattr(solvers, "STEADY", [Stub("told", lambda b, relative: asked.append((b, relative)))])
    solvers.correct(system, b, near, 1e-3)
    assert_allclose(asked[0][0], b - system.matrix() @ near, rtol=0, atol=1e-13 * np.abs(near).max())
    assert asked[0][1] == 1e-3
