"""Linear systems of a policy: error bounds against exact rationals, scales, bad calls, systems without a solution."""

from fractions import Fraction

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import linalg, sparse
from structures import STRUCTURES, grid, layered, random_rows

import oee_tabular as oee
from oee_tabular import FiniteMDP, exact
from oee_tabular.exact.values import solve_policy_system


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


def refined(matrix, b, gamma):
    """The same for more states: a dense solve, and five corrections from exact residuals, each good to 6 digits or more."""
    factors, g = linalg.lu_factor(np.eye(len(b)) - gamma * matrix), Fraction(gamma)
    entries = [[(int(j), g * Fraction(row[j])) for j in np.flatnonzero(row)] for row in matrix]
    x, right = [Fraction(0)] * len(b), [Fraction(v) for v in b.tolist()]
    for _ in range(6):
        residual = [v - x[i] + sum(c * x[j] for j, c in entries[i]) for i, v in enumerate(right)]
        step = linalg.lu_solve(factors, [float(v) for v in residual])
        x = [v + Fraction(d) for v, d in zip(x, step.tolist(), strict=True)]
    return x


def ill_conditioned(name, n):
    """Kernels whose I - gamma K is nearly singular, or whose solution spans many magnitudes."""
    rng, at = np.random.default_rng(n), np.arange(n)
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
    elif name == "drift against the exit":  # gambler's ruin: solutions grow geometrically
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
    [("ring", 6), ("ring", 400), ("near-absorbing", 12), ("near-absorbing", 150), ("two halves that hardly meet", 8),
     ("drift against the exit", 12), ("rows above 1", 12),
     ("rows above 1", 150)],
)  # fmt: skip
def test_error_bound_of_ill_conditioned_systems(name, n, discount, transpose):
    """|x - x*| <= error_bound in exact arithmetic; the bound is no more than the rounding times the condition number."""
    kernel, b = ill_conditioned(name, n), np.random.default_rng(1).normal(size=n)
    result = solve_policy_system(sparse.csr_array(kernel), b, discount, transpose=transpose)
    matrix = kernel.T if transpose else kernel
    truth = rational(matrix.tolist(), b.tolist(), discount) if n < 100 else refined(matrix, b, discount)
    misses = [abs(Fraction(x) - t) for x, t in zip(result.x.tolist(), truth, strict=True)]
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
                solve_policy_system(kernel, right, 0.95, transpose=transpose) for right in (b, np.ldexp(b, power))
            )
            assert_array_equal(other.x, np.ldexp(one.x, power))
            assert_allclose(other.error_bound, np.ldexp(one.error_bound, power), rtol=1e-12, atol=1e-320)
    mdp = oee.tasks.gridworld(7, 0.3, discount=0.9)
    far = mdp.with_rewards(np.ldexp(mdp.rewards, power))
    near = mdp.with_rewards(mdp.rewards)
    one, other = (exact.evaluate_policy(m, oee.uniform_policy(mdp)) for m in (near, far))
    assert_array_equal(other.values, np.ldexp(one.values, power))
    assert other.value == np.ldexp(one.value, power)


def test_subnormal_values_are_within_their_bound():
    gamma = 0.9378850624888447
    for reward in (3.707675519592279e-307, 3e-318):
        result = exact.evaluate_policy(FiniteMDP([[[1.0]]], [reward], [1.0], gamma), [[1.0]])
        truth = Fraction(reward) / (1 - Fraction(gamma))
        assert abs(Fraction(float(result.values[0])) - truth) <= Fraction(result.error_bound)


def test_a_matrix_by_columns_is_read_as_what_it_is():
    kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    for form in (kernel, kernel.tocsc(), kernel.tocoo()):
        assert_allclose(solve_policy_system(form, np.array([1.0, 0.0]), 0.5).x, [4 / 3, 0.0], rtol=1e-15)


def test_wide_index_arrays_and_unsorted_rows_are_taken():
    kernel = STRUCTURES["grid"]
    parts = kernel.data[::-1].copy(), kernel.indices[::-1].astype(np.int64), kernel.nnz - kernel.indptr[::-1]
    wide = sparse.csr_array((*parts[:2], parts[2].astype(np.int64)), shape=kernel.shape)
    b = np.random.default_rng(0).random(484)
    flipped = sparse.csr_array(kernel.toarray()[::-1])
    assert_allclose(
        solve_policy_system(wide, b, 0.9).x, np.linalg.solve(np.eye(484) - 0.9 * flipped.toarray(), b), rtol=1e-11
    )
