"""Solutions of a policy's linear system that are proved to be correctly rounded.

The residual is computed in twice the precision, the solution refined as a pair high + low, and |x - x*| bounded by the
norm of the inverse times the residual [1]. Where the pair is farther than that from the middle between two floats, its
high part is the exact solution's nearest float.

Reference: [1] Demmel et al., Error bounds from extra-precise iterative refinement, ACM Trans. Math. Softw. 32 (2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.exact.solvers.library import library
from oee_tabular.exact.systems import System, choose, readable

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

    rows = _rows(system, low)
    solver, method, start = choose(system, b)
    # near 1 an iteration's own residual drifts from the true one: the first solution is then all that floats can give
    first, step = (1e-11, 1e-11) if system.discount <= 0.999 else (0.0, 1e-12)
    x = np.array(solver(b, first) if start is None else start)
    x_low = np.zeros(len(b))
    missed, size, bound, rounding = twofold.residual(*rows, b, b_low, x, x_low, float(system.formed), system.transpose)
    sure = np.zeros(len(b), dtype=np.bool_)
    fallen_back = False
    for _ in range(20):
        error = norm_of_inverse * (bound + slack)
        sure = twofold.settled(x, x_low, error)
        if not sure.all():
            sure |= twofold.nothing_ahead(rows[0], rows[1], b, b_low, x, x_low)
        if sure.all() or not 0.25 * rounding < size < np.inf:
            break
        y, y_low = x.copy(), x_low.copy()
        twofold.add(y, y_low, solver(missed, step))
        again = twofold.residual(*rows, b, b_low, y, y_low, float(system.formed), system.transpose)
        if again[1] < 0.5 * size:
            x, x_low, (missed, size, bound, rounding) = y, y_low, again
        elif fallen_back or "LU" in method or (last := library(system)) is None:
            break
        else:
            (solver, method), fallen_back = last, True
    sure &= (x == 0.0) | (np.abs(x) > SMALLEST)
    low_part = np.abs(x_low).sum() if system.transpose else np.abs(x_low).max(initial=0.0)
    error = float(norm_of_inverse * (bound + slack)) + float(low_part)
    return Certified(x, x_low, 0.0 if bool(np.all(sure & (x == 0.0))) else error, float(sure.mean()), method)


def _rows(system: System, low: Array) -> tuple[Any, Any, Any, Any, float]:
    """The arrays that the residual reads, transposed where the system is."""
    from oee_tabular.exact._policy_rows import transposed

    if not system.transpose:
        return system.indptr, system.indices, system.data, readable(low), system.discount
    indptr, indices, data = transposed(system.indptr, system.indices, system.data)
    rest = transposed(system.indptr, system.indices, readable(low))[2]
    return readable(indptr), readable(indices), readable(data), readable(rest), system.discount
