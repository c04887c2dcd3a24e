"""Every solver of a policy's linear system obeys the same laws, on every structure.

The choice among them is tested too.
"""

import warnings
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from helpers import dense_values, rngs
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg, sparse
from structures import STRUCTURES, binary_tree, cycle, grid, layered, random_rows

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact import solvers
from oee_tabular.exact.solvers import (
    LAPACK,
    SOLVERS,
    BiCGStab,
    PlainBiCGStab,
    SuperLU,
    ValueIteration,
    inverse_norm,
    measure,
    refine,
)
from oee_tabular.exact.system import Kernel, System, rows_of
from oee_tabular.exact.values import solve_policy_system

LAST = SOLVERS[-3:]  # LAPACK, SuperLU, LAPACK of more states
ITERATIVE = (ValueIteration(), PlainBiCGStab(), BiCGStab())


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


def system_of(kernel, discount, transpose=False):
    return System(Kernel(*rows_of(sparse.csr_array(kernel)), discount), transpose)


def dense_system(system):
    matrix = np.eye(system.n_states) - system.kernel.discount * system.csr().toarray()
    return matrix.T if system.transpose else matrix


def refined(system, b, solver):
    return refine(
        system,
        b,
        solver,
        solvers.Iterate(np.zeros(len(b)), b, np.inf, np.inf, 0.0, "none"),
    )


def check_solver(solver, system, b, truth):
    """A direct solver and BiCGSTAB are right; what an iteration leaves is in its bound."""
    found = refined(system, b, solver)
    scale = np.abs(truth).sum() if system.transpose else np.abs(truth).max()
    missed = np.abs(found.x - truth)
    missed = missed.sum() if system.transpose else missed.max()
    size = 1e-12 / (1.0 - system.kernel.discount) * scale
    assert missed <= inverse_norm(system) * found.bound + size, solver
    assert missed < size or not solver.is_direct, solver


@pytest.mark.large
@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("discount", [0.0, 0.9, 0.9999])
@pytest.mark.parametrize("name", STRUCTURES)
def test_every_solver_gives_the_one_answer_within_its_bound(name, discount, transpose):
    kernel = STRUCTURES[name]
    b = np.random.default_rng(1).normal(size=kernel.shape[0])
    system = system_of(kernel, discount, transpose)
    truth = np.linalg.solve(dense_system(system), b)
    for solver in (*SOLVERS, LAPACK(700), SuperLU(100.0)):
        if solver.suits(system):
            check_solver(solver, system, b, truth)
    found = solve_policy_system(kernel, b, discount, transpose=transpose)
    scale = np.abs(truth).sum() if transpose else np.abs(truth).max()
    assert_allclose(found.x, truth, rtol=0, atol=1e-12 / (1.0 - discount) * scale)
    assert found.error_bound < 1e-11 / (1 - discount) * scale + 1e-300


@given(rngs)
def test_small_systems_by_solvers_that_they_would_not_meet(rng):
    """Any pattern, rows of any sum below 1; states that nothing leads to, or from."""
    n = int(rng.integers(2, 30))
    gamma = float(rng.choice([0.5, 0.95]))
    kernel = rng.random((n, n)) * (rng.random((n, n)) < rng.choice([0.05, 0.2, 0.5]))
    kernel /= np.maximum(kernel.sum(axis=1, keepdims=True), 1e-9) * rng.choice(
        [1.0, 1.2]
    )
    b = rng.normal(size=n)
    for transpose in (False, True):
        system = system_of(kernel, gamma, transpose)
        truth = np.linalg.solve(dense_system(system), b)
        for solver in SOLVERS:
            if not isinstance(solver, ValueIteration) or solver.suits(system):
                check_solver(solver, system, b, truth)
        found = refined(system, b, BiCGStab())
        assert found.largest <= 64 * found.rounding


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("n", [3, 30, 200, 500])
def test_a_singular_system_diverges(n, transpose):
    """Direct solvers give up on it, from which that is concluded."""
    singular = system_of(np.eye(n), 1.0, transpose)
    asked = [
        solver
        for solver in (*SOLVERS, LAPACK(700))
        if solver.is_direct and solver.suits(singular)
    ]
    assert asked
    assert all(solver.prepare(singular)(np.ones(n), 0.0) is None for solver in asked)
    for times, discount, most in ((1.0, 1.0, r"1\)"), (2.0, 0.9, r"1\.8\)")):
        with pytest.raises(
            ValueError, match=rf"spectral radius of 1.*\(its rows sum to at most {most}"
        ):
            solve_policy_system(
                times * singular.csr(), np.ones(n), discount, transpose=transpose
            )


def test_answers_are_refined_to_rounding_and_zero_is_left_alone():
    system = system_of(grid(25), 0.99)
    b = np.random.default_rng(0).random(625)
    x, missed, largest, bound, rounding, method = solvers.answer(system, b)
    assert method == "BiCGSTAB"
    assert_allclose(
        missed, b + 0.99 * (grid(25) @ x) - x, rtol=0, atol=1e-15 * np.abs(x).max()
    )
    assert largest == np.abs(missed).max() < 1e-14 * np.abs(x).max()
    assert largest < bound <= largest + rounding
    found = solvers.answer(system, np.zeros(625))
    assert (found.largest, found.bound, np.abs(found.x).max()) == (0.0, 0.0, 0.0)


@pytest.mark.large
def test_where_iteration_fails_the_direct_solver_answers(monkeypatch):
    """Where iteration fails, a direct solver answers.

    On expanders of up to 3000 states that is a dense one; above, the bound says how far
    the iteration got.
    """
    for stub in (
        lambda b, relative: 0.9 * b,
        lambda b, relative: None,
        lambda b, relative: np.full(len(b), np.nan),
    ):
        monkeypatch.setattr(solvers, "SOLVERS", (Stub("BiCGSTAB", stub), *LAST))
        mdp = oee.tasks.gridworld(25, 0.3)
        found = exact.evaluate_policy(mdp, oee.uniform_policy(mdp))
        assert found.method == "sparse LU"
        assert_allclose(
            found.values,
            dense_values(mdp, oee.uniform_policy(mdp)),
            rtol=1e-10,
            atol=1e-10,
        )
    monkeypatch.setattr(
        solvers, "SOLVERS", (Stub("BiCGSTAB", lambda b, relative: 0.9 * b), *LAST)
    )
    for n, method in ((900, "dense LU"), (3300, "BiCGSTAB")):
        b = np.random.default_rng(0).normal(size=n)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = solve_policy_system(random_rows(n, 3), b, 0.9)
        messages = [str(w.message)[:62] for w in said]
        if n > 3000:
            assert messages == [
                "the linear system of 3300 states is solved only to a residual "
            ]
        else:
            assert messages == []
        missed = np.abs(found.x - 0.9 * (random_rows(n, 3) @ found.x) - b).max()
        assert found.method == method
        assert (missed < 1e-13) == (n == 900)
        assert missed <= 10 * found.error_bound + 1e-13
        assert found.error_bound < 1e3


def dense_halves():
    """Value iteration fails there, and every state is a hub."""
    p = np.random.default_rng(0).random((450, 450))
    half = 225
    p[:half, half:] *= 1e-9
    p[half:, :half] *= 1e-9
    return p / p.sum(axis=1, keepdims=True)


def blocks():
    """Random graphs that seldom meet: value iteration leaves them."""
    far = 0.001 * random_rows(2000, 5)
    return sparse.csr_array(0.999 * sparse.block_diag([random_rows(500, 5)] * 4) + far)


def dense_rows():
    rows = np.random.default_rng(0).random((600, 600))
    return rows / rows.sum(axis=1, keepdims=True)


CHOICES = {  # kernel, discounts, methods
    "mixing": (lambda: random_rows(2000, 8), (0.99, 0.99999), {"value iteration"}),
    "long rows, whose rounding is large": (
        dense_rows,
        (0.99, 0.99999),
        {"value iteration"},
    ),
    "blocks": (blocks, (0.99, 0.99999), {"BiCGSTAB"}),
    "two next states": (
        lambda: random_rows(3000, 2),
        (0.9, 0.9999),
        {"BiCGSTAB", "value iteration"},
    ),
    "dense halves": (dense_halves, (1 - 1e-9,), {"BiCGSTAB", "dense LU", "sparse LU"}),
    "ring": (lambda: cycle(500), (0.99,), {"LU in a band"}),
    "layers": (lambda: layered(40, 4), (0.99,), {"LU in a band"}),
    "tree": (lambda: binary_tree(4095), (0.99, 0.999999), {"sparse LU"}),
    "grid": (lambda: grid(25), (0.99,), {"BiCGSTAB"}),
    "few states": (lambda: grid(9), (0.99,), {"dense LU"}),
}


@pytest.mark.large
@pytest.mark.parametrize("name", CHOICES)
def test_which_solver_answers(name):
    make, discounts, methods = CHOICES[name]
    kernel = sparse.csr_array(make())
    b = np.random.default_rng(0).normal(size=kernel.shape[0])
    for discount in discounts:
        for transpose in (False, True):
            found = solve_policy_system(kernel, b, discount, transpose=transpose)
            assert found.method in methods
            matrix = kernel.T if transpose else kernel
            assert_allclose(
                b + discount * (matrix @ found.x) - found.x,
                0.0,
                atol=1e-10 * np.abs(found.x).max(),
            )
            assert (
                found.error_bound
                < 1e-11 / (1 - discount) * np.abs(found.x).max() * len(b) ** transpose
            )


@pytest.mark.large
@pytest.mark.parametrize("discount", [0.99, 0.99999])
def test_an_even_start_does_not_end_the_plain_iteration(discount):
    """A right side of ones does not end the plain iteration.

    Ones are an eigenvector that transposed residuals are held against, a Krylov space
    of one dimension.
    """
    n = 2000
    rng = np.random.default_rng(3)
    weights = rng.dirichlet(np.ones(2), n).reshape(-1)
    ahead = rng.integers(n, size=2 * n)
    kernel = sparse.csr_array((weights, (np.repeat(np.arange(n), 2), ahead)), (n, n))
    system = system_of(kernel, discount, True)
    b = np.full(n, (1 - discount) / n)
    assert ValueIteration().prepare(system)(b, 0.0) is None
    found = solvers.answer(system, b)
    assert found.method == "BiCGSTAB"
    assert found.largest <= found.rounding
    truth = np.linalg.solve(dense_system(system), b)
    assert_allclose(found.x, truth, rtol=0, atol=1e-14 / (1 - discount) * found.x.max())


@given(rngs)
def test_the_norm_of_the_inverse_is_bounded_by_its_certificate(rng):
    """The M-matrix certificate bounds |(I - gamma K)^-1|_inf, and is near it.

    The kernels have rows whose sums exceed 1.
    """
    n = int(rng.integers(2, 7))
    kernel = rng.random((n, n)) * (rng.random((n, n)) < 0.6)
    kernel[0] *= 3.0
    radius = np.abs(np.linalg.eigvals(kernel)).max()
    if radius == 0:
        return
    kernel *= 1.05 / radius
    bound = inverse_norm(system_of(kernel, 0.9))
    norm = np.abs(np.linalg.inv(np.eye(n) - 0.9 * kernel)).sum(axis=1).max()
    assert norm <= bound * (1 + 1e-12)
    if 0.9 * kernel.sum(axis=1).max() > 1:
        assert_allclose(bound, norm, rtol=1e-6)


@pytest.mark.large
@pytest.mark.parametrize("entries", [5, 200])
def test_near_discount_one_occupancies_sum_to_one(entries):
    """Near discount 1, occupancies sum to 1 up to the rounding of the rows' sums.

    That is eps / (1 - discount). With the rounding of the bound on these sums it would
    be 1e-8 and 3e-7.
    """
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(entries), size=200)
    columns = rng.integers(200, size=200 * entries)
    rows = sparse.coo_array(
        (weights.ravel(), (np.repeat(np.arange(200), entries), columns)),
        shape=(200, 200),
    )
    mdp = oee.FiniteMDP(rows.tocsr(), np.ones(200), np.eye(200)[0], 1.0 - 1e-7)
    assert oee.exact.evaluate_policy(mdp, np.ones((200, 1))).method == "value iteration"
    assert abs(oee.occupancy(mdp, np.ones((200, 1))).sum() - 1.0) < 4e-9


@pytest.mark.large
@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("name", STRUCTURES)
def test_an_answer_from_near_by_leaves_its_share(name, transpose, monkeypatch):
    """An answer from a vector near by leaves the allowed share of its residual.

    Where a solver gives up, or leaves too much, the next one goes on.
    """
    system = system_of(STRUCTURES[name], 0.95, transpose)
    b = np.random.default_rng(1).normal(size=system.n_states)
    whole = solvers.answer(system, b)
    near = whole.x * (1.0 + 0.01 * np.random.default_rng(2).normal(size=len(b)))
    missed = np.abs(measure(system, b, near, "").missed).max()
    found = solvers.answer(system, b, near, 1e-3)
    assert_allclose(
        found.missed,
        b - dense_system(system) @ found.x,
        rtol=0,
        atol=1e-13 * np.abs(found.x).max(),
    )
    assert found.largest <= 1e-2 * missed
    asked = []
    for poor in (
        lambda b, relative: asked.append((b, relative)),
        lambda b, relative: 0.5 * b,
    ):
        monkeypatch.setattr(
            solvers, "EARLY_STOP_SOLVERS", [Stub("poor", poor), LAPACK(700)]
        )
        assert solvers.answer(system, b, near, 1e-3).largest <= 0.1 * missed
    assert_array_equal(asked[0][0], measure(system, b, near, "").missed)
    assert asked[0][1] == 1e-3
    assert_array_equal(solvers.answer(system, b, whole.x).x, whole.x)


def test_the_certificate_counts_its_own_residual(monkeypatch):
    """|M^-1| <= max h / (1 - residual); half of it or more, or an h that is not positive, certifies nothing."""
    system = system_of([[0.0, 2.0], [0.1, 0.0]], 0.9)
    for residual, h in (
        ([0.2, -0.4], [3.0, 1.0]),
        ([0.2, -0.6], [3.0, 1.0]),
        ([0.0, 0.0], [3.0, 0.0]),
    ):
        largest = np.abs(residual).max()
        answer = solvers.Iterate(
            np.array(h), np.array(residual), largest, largest, 0.0, "dense LU"
        )
        monkeypatch.setattr(solvers, "answer", lambda system, b, answer=answer: answer)
        if min(residual) == -0.4:
            assert_allclose(inverse_norm(system), 3.0 / 0.6)
        else:
            with pytest.raises(ValueError, match=r"spectral radius of 0\.402492"):
                inverse_norm(system)


# ---- linear systems of a policy: error bounds against exact rationals, scales, bad
# calls, systems without a solution
def rational(matrix, b, gamma):
    """(I - gamma K)^-1 b in fractions, by Gauss and Jordan."""
    n = len(b)
    g = Fraction(gamma)
    rows = [
        [(i == j) - g * Fraction(matrix[i][j]) for j in range(n)] + [Fraction(b[i])]
        for i in range(n)
    ]
    for k in range(n):
        pivot = next(i for i in range(k, n) if rows[i][k] != 0)
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in range(n):
            if i != k and rows[i][k] != 0:
                f = rows[i][k]
                rows[i] = [
                    value - f * other
                    for value, other in zip(rows[i], rows[k], strict=True)
                ]
    return [row[n] for row in rows]


def refined_exactly(matrix, b, gamma):
    """Solve a system of more states by a dense solve and five exact corrections.

    Each correction, from an exact residual, is good to 6 digits or more.
    """
    factors = linalg.lu_factor(np.eye(len(b)) - gamma * matrix)
    g = Fraction(gamma)
    entries = [
        [(int(j), g * Fraction(row[j])) for j in np.flatnonzero(row)] for row in matrix
    ]
    x = [Fraction(0)] * len(b)
    right = [Fraction(v) for v in b.tolist()]
    for _ in range(6):
        residual = [
            v - x[i] + sum(c * x[j] for j, c in entries[i]) for i, v in enumerate(right)
        ]
        step = linalg.lu_solve(factors, [float(v) for v in residual])
        x = [v + Fraction(d) for v, d in zip(x, step.tolist(), strict=True)]
    return x


def ill_conditioned(name, n):
    """Make a kernel whose I - gamma K is nearly singular, or one hard in another way.

    The solution may have entries of many magnitudes.
    """
    rng = np.random.default_rng(n)
    at = np.arange(n)
    rows = np.zeros((n, n))
    if name == "ring":
        rows[at, (at + 1) % n] = rng.uniform(0.3, 0.7, n)
        rows[at, at - 1] = 1.0 - rows[at, (at + 1) % n]
    elif name == "near-absorbing":  # each state is left once in 10^5 to 10^12 steps
        stay = 1.0 - 10.0 ** -rng.uniform(5, 12, n)
        rows[at, at] = stay
        rows[at, (at + 1) % n] = 1.0 - stay
    elif name == "two halves that hardly meet":
        rows = rng.random((n, n))
        rows[: n // 2, n // 2 :] *= 1e-9
        rows[n // 2 :, : n // 2] *= 1e-9
        rows /= rows.sum(axis=1, keepdims=True)
    elif name == "drift against the exit":
        # gambler's ruin: solutions grow geometrically
        rows[at, np.minimum(at + 1, n - 1)] = 0.9
        rows[at[1:], at[1:] - 1] = 0.1
        rows[0] = 0.0
    else:  # rows above 1 in turn with rows below
        rows[at, (at + 1) % n] = np.where(at % 2, 1.9, 0.5)
    return rows


@pytest.mark.parametrize("transpose", [False, True])
@pytest.mark.parametrize("discount", [0.9, 0.9999999])
@pytest.mark.parametrize(
    ("name", "n"),
    [
        ("ring", 6),
        ("ring", 400),
        ("near-absorbing", 12),
        ("near-absorbing", 150),
        ("two halves that hardly meet", 8),
        ("drift against the exit", 12),
        ("rows above 1", 12),
        ("rows above 1", 150),
    ],
)
def test_error_bound_of_ill_conditioned_systems(name, n, discount, transpose):
    """|x - x*| <= error_bound in exact arithmetic; the bound is no more than the rounding times the condition number."""
    kernel = ill_conditioned(name, n)
    b = np.random.default_rng(1).normal(size=n)
    result = solve_policy_system(
        sparse.csr_array(kernel), b, discount, transpose=transpose
    )
    matrix = kernel.T if transpose else kernel
    truth = (
        rational(matrix.tolist(), b.tolist(), discount)
        if n < 100
        else refined_exactly(matrix, b, discount)
    )
    misses = [
        abs(Fraction(x) - t) for x, t in zip(result.x.tolist(), truth, strict=True)
    ]
    assert (sum(misses) if transpose else max(misses)) <= Fraction(result.error_bound)
    size = np.abs(result.x).sum() if transpose else np.abs(result.x).max()
    norm = np.abs(np.linalg.inv(np.eye(n) - discount * kernel)).sum(axis=1).max()
    assert result.error_bound <= 1e-12 * norm * size


@pytest.mark.large
@pytest.mark.parametrize("power", [530, -530, 1000, -1000])
def test_the_scale_of_the_right_side_does_not_matter(power):
    """But for what leaves the range of floats: powers of two change no bit."""
    for kernel in (random_rows(900, 3), grid(22), layered(12, 40)):
        kernel = sparse.csr_array(kernel * 0.9)
        b = np.random.default_rng(0).normal(size=kernel.shape[0])
        for transpose in (False, True):
            one, other = (
                solve_policy_system(kernel, right, 0.95, transpose=transpose)
                for right in (b, np.ldexp(b, power))
            )
            assert_array_equal(other.x, np.ldexp(one.x, power))
            assert_allclose(
                other.error_bound,
                np.ldexp(one.error_bound, power),
                rtol=1e-12,
                atol=1e-320,
            )
    mdp = oee.tasks.gridworld(7, 0.3, discount=0.9)
    far = mdp.with_rewards(np.ldexp(mdp.rewards, power))
    near = mdp.with_rewards(mdp.rewards)
    one, other = (
        exact.evaluate_policy(m, oee.uniform_policy(mdp)) for m in (near, far)
    )
    assert_array_equal(other.values, np.ldexp(one.values, power))
    assert other.value == np.ldexp(one.value, power)


def test_subnormal_values_are_within_their_bound():
    gamma = 0.9378850624888447
    for reward in (3.707675519592279e-307, 3e-318):
        result = exact.evaluate_policy(
            FiniteMDP([[[1.0]]], [reward], [1.0], gamma), [[1.0]]
        )
        truth = Fraction(reward) / (1 - Fraction(gamma))
        assert abs(Fraction(float(result.values[0])) - truth) <= Fraction(
            result.error_bound
        )


def test_a_matrix_by_columns_is_read_as_what_it_is():
    kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    for form in (kernel, kernel.tocsc(), kernel.tocoo()):
        assert_allclose(
            solve_policy_system(form, np.array([1.0, 0.0]), 0.5).x,
            [4 / 3, 0.0],
            rtol=1e-15,
        )


def test_wide_index_arrays_and_unsorted_rows_are_taken():
    kernel = STRUCTURES["grid"]
    parts = (
        kernel.data[::-1].copy(),
        kernel.indices[::-1].astype(np.int64),
        kernel.nnz - kernel.indptr[::-1],
    )
    wide = sparse.csr_array((*parts[:2], parts[2].astype(np.int64)), shape=kernel.shape)
    b = np.random.default_rng(0).random(484)
    flipped = sparse.csr_array(kernel.toarray()[::-1])
    assert_allclose(
        solve_policy_system(wide, b, 0.9).x,
        np.linalg.solve(np.eye(484) - 0.9 * flipped.toarray(), b),
        rtol=1e-11,
    )
