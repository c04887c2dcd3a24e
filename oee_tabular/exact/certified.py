"""Solutions of a policy's linear system that are proved to be correctly rounded.

The residual is computed in twice the precision, the solution refined as a pair high + low, and |x - x*| bounded by the
norm of the inverse times the residual [1]. Where the pair is farther than that from the middle between two floats, its
high part is the exact solution's nearest float.

Reference: [1] Demmel et al., Error bounds from extra-precise iterative refinement, ACM Trans. Math. Softw. 32 (2006).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array, BoolArray
from oee_tabular.exact.system import Kernel, Solve, System, readable

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
