"""Linear systems of a policy, (I - gamma P) x = b and their transposes, each answer with a bound on its error.

The bound is |x - x*|_inf <= |M^-1|_inf |residual|_inf, rounding included. Which solver does it and where the norm comes from is
said in ``solvers``. To prove a solution correctly rounded, the residual is computed in twice the precision, the solution
refined as a pair high + low, and |x - x*| bounded by the norm of the inverse times the residual [1]. Where the pair is farther
than that from the middle between two floats, its high part is the exact solution's nearest float.

Reference: [1] Demmel et al., Error bounds from extra-precise iterative refinement, ACM Trans. Math. Softw. 32 (2006).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray
from oee_tabular._sparse import check_csr
from oee_tabular.exact.system import DivergentKernelError, Kernel, Solve, System, exponent, readable, scaled_back

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
    rows = check_csr(kernel, "kernel")
    bad = np.flatnonzero(~(np.isfinite(rows.data) & (rows.data >= 0.0)))
    if bad.size:
        place = int(np.searchsorted(rows.indptr, bad[0], side="right")) - 1, int(rows.indices[bad[0]])
        raise ValueError(
            f"kernel must be finite and nonnegative; kernel[{place[0]}, {place[1]}] is {rows.data[bad[0]]}"
        )
    return rows


SMALLEST = 1e-288  # below it the low part of a pair has lost bits


@dataclass(frozen=True, eq=False)
class Certified:
    """high + low, the float that is nearest to it, and what is known of it.

    Attributes
    ----------
    high, low : (S,), high the sum's rounding
    error_bound : of |high - x*|_inf (transposed: of |high - x*|_1)
    certified : the share of states where high is proved to be x* correctly rounded
    method
    """

    high: Array
    low: Array
    error_bound: float
    certified: float
    method: str


class Pair(NamedTuple):
    """x + low; what it misses, the size of that and a bound on it, and the largest rounding in it."""

    x: Array
    low: Array
    missed: Array
    size: float
    bound: float
    rounding: float


def solve_certified(
    system: System, low: Array, b: Array, b_low: Array, norm_of_inverse: float, slack: float = 0.0
) -> Certified:
    """(I - discount (K + low)) x = b + b_low, or the transposed system, to the last bit where that can be proved.

    Parameters
    ----------
    system, low : the kernel as a pair; ``System.formed`` counts the roundings in its low part
    b, b_low : (S,) the right side as a pair, contiguous
    norm_of_inverse : a bound on |(I - discount K)^-1|_inf
    slack : bounds what the pair b misses
    """
    from oee_tabular.exact import _twofold as twofold
    from oee_tabular.exact.solvers import SOLVERS

    kernel, rest = _as_it_is_read(system, low)

    def measured(x: Array, x_low: Array) -> Pair:
        parts = kernel, rest, b, b_low, x, x_low, float(system.formed), system.transpose
        missed, size, bound, rounding = twofold.residual(*parts)
        return Pair(x, x_low, missed, size, bound, rounding)

    def proved(pair: Pair) -> BoolArray:
        sure: BoolArray = twofold.settled(pair.x, pair.low, norm_of_inverse * (pair.bound + slack))
        return sure if sure.all() else sure | twofold.nothing_ahead(kernel, b, b_low, pair.x, pair.low)

    # near 1 an iteration's own residual drifts from the true one: the first solution is then all that floats can give
    first, step = (1e-11, 1e-11) if system.kernel.discount <= 0.999 else (0.0, 1e-12)
    pair: Pair | None = None
    method = ""
    for solver in SOLVERS:
        if not solver.suits(system):
            continue
        solve = solver.prepare(system)
        if pair is None:
            x = solve(b, first)
            if x is None:
                continue
            pair = measured(x, np.zeros(len(b)))
        method = solver.name
        pair, stalled = _refined(pair, solve, step, measured, proved)
        if solver.direct or not stalled:
            break
    assert pair is not None
    sure = proved(pair) & ((pair.x == 0.0) | (np.abs(pair.x) > SMALLEST))
    low_part = np.abs(pair.low).sum() if system.transpose else np.abs(pair.low).max(initial=0.0)
    error = float(norm_of_inverse * (pair.bound + slack)) + float(low_part)
    exact_zeros = bool(np.all(sure & (pair.x == 0.0)))
    return Certified(pair.x, pair.low, 0.0 if exact_zeros else error, float(sure.mean()), method)


def _refined(
    pair: Pair, solve: Solve, step: float, measured: Callable[[Array, Array], Pair], proved: Callable[[Pair], BoolArray]
) -> tuple[Pair, bool]:
    """The pair after as many steps as it takes, 20 at most; and whether a step did not halve what is missed."""
    from oee_tabular.exact import _twofold as twofold

    for _ in range(20):
        if not 0.25 * pair.rounding < pair.size < np.inf or proved(pair).all():
            return pair, False
        x, low = pair.x.copy(), pair.low.copy()
        further = solve(pair.missed, step)
        if further is None:
            return pair, True
        twofold.add(x, low, further)
        again = measured(x, low)
        if not again.size < 0.5 * pair.size:
            return pair, True
        pair = again
    return pair, False


def _as_it_is_read(system: System, low: Array) -> tuple[Kernel, Array]:
    """The kernel and its low part, transposed where the system is."""
    from oee_tabular.exact._policy_rows import transposed

    if not system.transpose:
        return system.kernel, low
    indptr, indices, data, discount = system.kernel
    n = len(indptr) - 1
    back, states, turned = (readable(part) for part in transposed(indptr, indices, data, n))
    rest: Array = transposed(indptr, indices, readable(low), n)[2]
    return Kernel(back, states, turned, discount), rest
