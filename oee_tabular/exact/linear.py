"""Linear systems of a policy, (I - gamma P) x = b and their transposes, each answer with a bound on its error.

The bound is |x - x*|_inf <= |M^-1|_inf |residual|_inf, rounding included. Which solver does it and where the norm comes from is
said in ``solvers``, how a solution is proved to be correctly rounded in ``certified``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import checked
from oee_tabular.exact.certified import solve_certified
from oee_tabular.exact.system import DivergentKernelError, System, exponent, scaled_back

__all__ = ["DivergentKernelError", "LinearSolution", "exponent", "solve_policy_system"]


@dataclass(frozen=True)
class LinearSolution:
    """A solution of ``solve_policy_system`` with a bound on its error.

    Attributes
    ----------
    x : (S,)
    error_bound : of |x - x*|_inf (of |x - x*|_1 for a transposed system), rounding included
    method : "dense LU", "LU by components", "value iteration", "BiCGSTAB" or "sparse LU"
    certified : with ``certify=True``, the share of entries of x that are proved to be correctly rounded; else None

    Examples
    --------
    >>> found = solve_policy_system(sparse.csr_array([[0.5, 0.5], [0.0, 1.0]]), np.array([1.0, 0.0]), 0.5)
    >>> found.x.round(4).tolist(), found.error_bound < 1e-12, found.method
    ([1.3333, 0.0], True, 'dense LU')
    """

    x: Array
    error_bound: float
    method: str
    certified: float | None = None


def solve_policy_system(
    kernel: sparse.csr_array, b: Array, discount: float, *, transpose: bool = False, certify: bool = False
) -> LinearSolution:
    """Solve (I - discount K) x = b, or the transposed system, for a nonnegative kernel K.

    Parameters
    ----------
    kernel : csr (S, S), nonnegative; its rows may have any sum
    b : (S,)
    discount : float in [0, 1]
    transpose : whether (I - discount K)^T x = b is solved: occupancies instead of values
    certify : whether x is refined until it is the exact solution's nearest float, and proved to be

    Raises
    ------
    ValueError
        A kernel that is not square, sparse, finite and nonnegative, a right side of another length or not finite.
    DivergentKernelError
        A ValueError: the spectral radius of discount * K is not below 1.

    Notes
    -----
    Cost: O(S^3) up to 100 states; one pass where no more than some states can reach each other (layered models); else a few
    dozen sparse sweeps. Certified 1.5 to 2 times that.

    Examples
    --------
    The share of discounted time in each state, from state 0:

    >>> kernel = sparse.csr_array([[0.5, 0.5], [0.0, 1.0]])
    >>> solve_policy_system(kernel, np.array([0.5, 0.0]), 0.5, transpose=True).x.round(4).tolist()
    [0.6667, 0.3333]
    """
    from oee_tabular.exact import solvers

    _checks.boolean(transpose, "transpose")
    _checks.boolean(certify, "certify")
    rows, gamma = _checked(kernel), _checks.number_in(discount, "discount", 0.0, 1.0)
    right = _checks.float_array(b, "b", ndim=1)
    if len(right) != rows.shape[0]:
        raise ValueError(f"b must have {rows.shape[0]} entries, one a state; it has {len(right)}")
    _checks.require_finite(right, "b")
    system, shift = System.of(rows, gamma, transpose), exponent(right)
    if shift != 0:  # dot products would leave the range of floats
        right = np.ldexp(right, -shift)
    norm = solvers.inverse_norm(system)
    if certify:
        proved = solve_certified(system, np.zeros(rows.nnz), right, np.zeros(len(right)), norm)
        x, bound, share, method = proved.high, proved.error_bound, proved.certified, proved.method
    else:
        found = solvers.answer(system, right)
        x, bound, share, method = found.x, float(norm * found.bound), None, found.method
    if shift != 0:
        x, bound, share = scaled_back(x, bound, share, shift)
    return LinearSolution(x, bound, method, share)


def _checked(kernel: Any) -> sparse.csr_array:
    """The kernel as the solvers read it."""
    if not sparse.issparse(kernel):
        raise ValueError(f"kernel must be a sparse matrix; got {type(kernel).__name__}")
    if kernel.ndim != 2 or kernel.shape[0] != kernel.shape[1] or kernel.shape[0] == 0:
        raise ValueError(f"kernel must be square, (S, S); it has shape {kernel.shape}")
    rows = checked(kernel, "kernel")
    bad = np.flatnonzero(~(np.isfinite(rows.data) & (rows.data >= 0.0)))
    if bad.size:
        place = int(np.searchsorted(rows.indptr, bad[0], side="right")) - 1, int(rows.indices[bad[0]])
        raise ValueError(
            f"kernel must be finite and nonnegative; kernel[{place[0]}, {place[1]}] is {rows.data[bad[0]]}"
        )
    return rows
