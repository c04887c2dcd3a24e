"""Linear systems of a policy, (I - gamma P) x = b and their transposes, each answer with a bound on its error.

For a nonnegative kernel K and M = I - gamma K, any h > 0 with M h >= c > 0 certifies that the spectral radius of gamma K
is below 1 and that |M^-1|_inf <= max(h) / c [1]. Rows that sum to 1 give h = 1, c = 1 - gamma, the usual bound
|x - x*| <= |residual| / (1 - gamma). Other kernels (unnormalised ratios, discount 1) get h from one more solve.

Small systems are solved densely; larger ones by BiCGSTAB preconditioned with symmetric Gauss-Seidel and refined on the
true residual, with a sparse LU only where that falls short: a direct solver fills in on expanders.

References: [1] Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences, 1994, chapter 6 (M-matrices).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from oee_tabular._checks import Array
from oee_tabular._sparse import row_sums

DENSE_LIMIT = 400
_ACCEPTABLE = 1e-10  # relative error bound above which the direct solver is tried as well


@dataclass(frozen=True)
class LinearSolution:
    """A solution of ``solve_policy_system`` with a bound on its error.

    Attributes
    ----------
    x : (S,)
    error_bound : of |x - x*|_inf (of |x - x*|_1 for a transposed system), rounding included
    method : "dense LU", "BiCGSTAB" or "sparse LU"

    Examples
    --------
    >>> found = solve_policy_system(sparse.csr_array([[0.5, 0.5], [0.0, 1.0]]), np.array([1.0, 0.0]), 0.5)
    >>> found.x.round(4).tolist(), found.error_bound < 1e-12, found.method
    ([1.3333, 0.0], True, 'dense LU')
    """

    x: Array
    error_bound: float
    method: str


class DivergentKernelError(ValueError):
    """gamma K has a spectral radius of 1 or more: the infinite sum does not exist."""


def solve_policy_system(
    kernel: sparse.csr_array, b: Array, discount: float, *, transpose: bool = False
) -> LinearSolution:
    """Solve (I - discount K) x = b, or the transposed system, for a nonnegative kernel K.

    Parameters
    ----------
    kernel : csr (S, S), nonnegative; its rows may have any sum
    b : (S,)
    discount : float in [0, 1]
    transpose : whether (I - discount K)^T x = b is solved: occupancies instead of values

    Raises
    ------
    DivergentKernelError
        A ValueError: the spectral radius of discount * K is not below 1.

    Notes
    -----
    Cost: dense O(S^3) up to 400 states, else a few dozen sparse sweeps.

    Examples
    --------
    The share of discounted time in each state, from state 0:

    >>> kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    >>> solve_policy_system(kernel, np.array([0.5, 0.0]), 0.5, transpose=True).x.round(4).tolist()
    [0.6667, 0.3333]
    """
    norm_of_inverse = _inverse_norm(kernel, discount)
    matrix = _system(kernel, discount, transpose)
    x, residual, method = _solve(matrix, b)
    size_of_row = np.diff(matrix.indptr) + 3  # what rounding can do to the matrix and to the residual
    rounding = np.finfo(float).eps * size_of_row * (abs(matrix) @ np.abs(x) + np.abs(b))
    missed = np.abs(residual) + rounding
    size = missed.sum() if transpose else missed.max(initial=0.0)
    return LinearSolution(x, float(norm_of_inverse * size), method)


def _system(kernel: sparse.csr_array, discount: float, transpose: bool) -> sparse.csr_array:
    matrix = sparse.csr_array(sparse.eye_array(kernel.shape[0], format="csr") - discount * kernel)
    if transpose:
        matrix = sparse.csr_array(matrix.T)
    matrix.sort_indices()
    return matrix


def _inverse_norm(kernel: sparse.csr_array, discount: float) -> float:
    """An upper bound on |(I - discount K)^-1|_inf, from a certificate."""
    largest = float(row_sums(kernel).max(initial=0.0))
    if discount * largest <= 1.0 - 1e-9:
        return 1.0 / (1.0 - discount * largest)
    matrix = _system(kernel, discount, False)
    h, residual, _ = _solve(matrix, np.ones(kernel.shape[0]))
    slack = 1.0 - float(np.abs(residual).max())
    if not (np.all(np.isfinite(h)) and h.min() > 0.0 and slack > 0.5):
        radius = spectral_radius(kernel, discount)
        raise DivergentKernelError(
            f"the infinite sum does not exist: discount * kernel has a spectral radius of {radius:.6g}, "
            f"which must be below 1 (its rows sum to at most {discount * largest:.6g}); normalise the rows or give a horizon"
        )
    return float(h.max() / slack)


def spectral_radius(kernel: sparse.csr_array, discount: float = 1.0) -> float:
    """The spectral radius of discount * K for a nonnegative K, by the power method (a mean over 1000 steps)."""
    vector = np.ones(kernel.shape[0])
    growth = []
    for _ in range(2000):
        vector = discount * (kernel @ vector)
        size = float(vector.max(initial=0.0))
        if size == 0.0:
            return 0.0
        vector /= size
        growth.append(np.log(size))
    return float(np.exp(np.mean(growth[1000:])))  # the mean, for kernels that are periodic


def _solve(matrix: sparse.csr_array, b: Array) -> tuple[Array, Array, str]:
    if matrix.shape[0] <= DENSE_LIMIT:
        dense = matrix.toarray()
        try:
            x = np.linalg.solve(dense, b)
            x = x + np.linalg.solve(dense, b - dense @ x)
        except np.linalg.LinAlgError:
            x = np.full(len(b), np.nan)
        return x, b - dense @ x, "dense LU"
    x, residual = _iterate(matrix, b)
    if np.abs(residual).max() <= _ACCEPTABLE * 1e-2 * max(np.abs(b).max(), np.finfo(float).tiny):
        return x, residual, "BiCGSTAB"
    try:
        factors = linalg.splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
    except RuntimeError:  # singular
        return np.full(len(b), np.nan), np.full(len(b), np.nan), "sparse LU"
    y = factors.solve(b)
    y = y + factors.solve(b - matrix @ y)
    direct = b - matrix @ y
    if np.abs(direct).max() < np.abs(residual).max():
        return y, direct, "sparse LU"
    return x, residual, "BiCGSTAB"


def _iterate(matrix: sparse.csr_array, b: Array) -> tuple[Array, Array]:
    """Preconditioned BiCGSTAB with refinement on the true residual until it stops falling."""
    from oee_tabular.kernels.sweep import sgs_solve

    diagonal = matrix.diagonal()
    n = len(b)
    x, residual = np.zeros(n), b.copy()
    if not np.all(diagonal > 0):
        return x, residual
    preconditioner = linalg.LinearOperator(
        (n, n), matvec=lambda v: sgs_solve(matrix.indptr, matrix.indices, matrix.data, diagonal, np.ravel(v))
    )
    for _ in range(8):
        if not np.abs(residual).max(initial=0.0) > 0.0:
            break
        step, _ = linalg.bicgstab(matrix, residual, rtol=1e-10, atol=0.0, maxiter=400, M=preconditioner)
        candidate = x + step
        new_residual = b - matrix @ candidate
        if not np.all(np.isfinite(new_residual)) or np.abs(new_residual).max() > 0.5 * np.abs(residual).max():
            if np.all(np.isfinite(new_residual)) and np.abs(new_residual).max() < np.abs(residual).max():
                x, residual = candidate, new_residual
            break
        x, residual = candidate, new_residual
    return x, residual
