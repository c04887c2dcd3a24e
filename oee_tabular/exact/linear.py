"""Linear systems of a policy, (I - gamma P) x = b and their transposes, each answer with a bound on its error.

The bound is |x - x*|_inf <= |M^-1|_inf |residual|_inf, rounding included. ``solvers`` says which solver is asked, and where the
norm of the inverse comes from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import check_csr
from oee_tabular.exact import solvers
from oee_tabular.exact.system import Kernel, System, exponent, rows_of

__all__ = ["LinearSolution", "solve_policy_system"]


@dataclass(frozen=True)
class LinearSolution:
    """A solution of ``solve_policy_system`` with a bound on its error.

    Attributes
    ----------
    x : (S,)
    error_bound : of |x - x*|_inf (of |x - x*|_1 for a transposed system), rounding included
    method : "dense LU", "LU in a band", "value iteration", "BiCGSTAB" or "sparse LU"

    Examples
    --------
    >>> solution = solve_policy_system(sparse.csr_array([[0.5, 0.5], [0.0, 1.0]]), np.array([1.0, 0.0]), 0.5)
    >>> solution.x.round(4).tolist(), solution.error_bound < 1e-12, solution.method
    ([1.3333, 0.0], True, 'dense LU')
    """

    x: Array
    error_bound: float
    method: str


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
    ValueError
        A kernel that is not square, sparse, finite and nonnegative, a right side of another length or not finite.
    DivergentKernelError
        A ValueError: the spectral radius of discount * K is not below 1.

    Notes
    -----
    Cost: O(S^3) up to 100 states; one pass where few states can reach each other (layered models); else a few
    dozen sparse sweeps.

    Examples
    --------
    The share of discounted time in each state, from state 0:

    >>> kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    >>> solve_policy_system(kernel, np.array([0.5, 0.0]), 0.5, transpose=True).x.round(4).tolist()
    [0.6667, 0.3333]
    """
    _checks.boolean(transpose, "transpose")
    rows, gamma = _check_kernel(kernel), _checks.number_in(discount, "discount", 0.0, 1.0)
    right = _checks.float_array(b, "b", ndim=1)
    if len(right) != rows.shape[0]:
        raise ValueError(f"b must have {rows.shape[0]} entries, one a state; it has {len(right)}")
    _checks.require_finite(right, "b")
    return solve(System(Kernel(*rows_of(rows), gamma), transpose), right)


def solve(system: System, b: Array, *, rounding: float = 0.0, near: Array | None = None) -> LinearSolution:
    """M x = b where every number has been checked; each entry of b is ``rounding`` from what it stands for, at most.

    ``near`` : about x, to begin with.
    """
    norm, shift = solvers.inverse_norm(system), exponent(b)
    if shift == 0:
        solution = solvers.answer(system, b, near)
        return LinearSolution(solution.x, float(norm * (solution.bound + rounding)), solution.method)
    solution = solvers.answer(system, np.ldexp(b, -shift))  # dot products would leave the range of floats
    with np.errstate(over="ignore", under="ignore"):
        x, bound = np.ldexp(solution.x, shift), float(np.ldexp(norm * solution.bound, shift))
    bound += norm * rounding + len(x) * 5e-324  # what is subnormal is rounded once more
    return LinearSolution(x, bound if np.isfinite(x).all() else np.inf, solution.method)


def _check_kernel(kernel: Any) -> sparse.csr_array:
    """The kernel as the solvers read it."""
    if not sparse.issparse(kernel):
        raise ValueError(f"kernel must be a sparse matrix; got {type(kernel).__name__}")
    if kernel.ndim != 2 or kernel.shape[0] != kernel.shape[1] or kernel.shape[0] == 0:
        raise ValueError(f"kernel must be square, (S, S); it has shape {kernel.shape}")
    rows = check_csr(kernel, "kernel")
    bad = np.flatnonzero(~(np.isfinite(rows.data) & (rows.data >= 0.0)))
    if bad.size:
        place = int(np.searchsorted(rows.indptr, bad[0], side="right")) - 1, int(rows.indices[bad[0]])
        raise ValueError(
            f"kernel must be finite and nonnegative; kernel[{place[0]}, {place[1]}] is {rows.data[bad[0]]}"
        )
    return rows
