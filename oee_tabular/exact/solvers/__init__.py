"""Solvers of M x = b, M = I - gamma K, tried in this order until the residual is within
rounding.

===================
===================================================================================================
``LAPACK(100)``      up to 100 states: dense
``ValueIteration``   rows of one sum that mix, while four sweeps leave at most .45 of
the change's spread ``EnvelopeLU(..)``   narrow graphs, whatever the order of their
states: rings, chains, queues, layers ``SuperLU(8)``       other graphs in which
elimination fills little: trees
``PlainBiCGStab``    graphs that expand: constants taken out, no preconditioner
``BiCGStab``         all others: an independent set eliminated, a modified DILU in
breadth-first order ``EnvelopeLU``       where that takes more than 72 steps and the
graph is not too wide
``LAPACK(400)``      up to 400 states, where those before fall short: dense
``SuperLU()``        the same for any number of states, unless the graph expands: sparse
``LAPACK(3000)``     the last resort, up to 3000 states: dense
===================
===================================================================================================

A new solver is such a class (``Solver``) with a place in ``SOLVERS``;
tests/exact/test_solvers.py holds every one to the same laws. Answers are refined on the
residual of the system as it was given, until that is as small as its own rounding.

For a nonnegative K any h > 0 with M h >= c > 0 certifies that the spectral radius of
gamma K is below 1 and that |M^-1|_inf <= max(h) / c [1]. Rows that sum to 1 give h = 1,
c = 1 - gamma; other kernels (unnormalised ratios, discount 1) need one more solution.

Reference: [1] Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences,
1994, chapter 6 (M-matrices).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from oee_tabular import _checks
from oee_tabular.exact import _system
from oee_tabular.exact.solvers.bicgstab import BiCGStab
from oee_tabular.exact.solvers.direct import LAPACK, LAST_RESORT, EnvelopeLU, SuperLU
from oee_tabular.exact.solvers.mixing import PlainBiCGStab, ValueIteration
from oee_tabular.exact.system import Solve, System, spectral_radius
from oee_tabular.exceptions import DivergentKernelError, NumericalWarning
from oee_tabular.typing import Array


class Solver(Protocol):
    """What ``SOLVERS`` is made of; transposed systems as well."""

    @property
    def name(self) -> str:
        """What users read as the method."""

    @property
    def is_direct(self) -> bool:
        """Whether its answer stands where the residual is not within rounding."""

    def suits(self, system: System) -> bool:
        """Whether it is asked; ``prepare`` is for these systems only."""

    def prepare(self, system: System) -> Solve:
        """The solver of any right side; it answers None where it gives up."""


SOLVERS: tuple[Solver, ...] = (
    LAPACK(100),
    ValueIteration(),
    EnvelopeLU(is_narrow=True),
    SuperLU(8.0),
    PlainBiCGStab(),
    BiCGStab(),
    EnvelopeLU(),
    LAPACK(400),
    SuperLU(),
    LAPACK(LAST_RESORT),
)
# sweeps stop by the size of x
STEADY = tuple(solver for solver in SOLVERS if not isinstance(solver, ValueIteration))


class Iterate(NamedTuple):
    """x; b - M x, its largest magnitude, a bound on the exact one (transposed: on its
    sum), the largest rounding in it.
    """

    x: Array
    missed: Array
    largest: float
    bound: float
    rounding: float
    method: str


def answer(
    system: System, b: Array, near: Array | None = None, share: float = 0.0
) -> Iterate:
    """x, by one solver after the other that suits, each from where those before it got
    to, until rounding is what is left.

    ``near`` : what to begin with, where it is better than 0.
    ``share`` : of what ``near`` misses about this much may be left, and never more than
    a tenth. For systems that change a
        little from one to the next: on grids of 100 x 100 a share of .001 takes .3 of an exact solution's time.
    """
    best = Iterate(np.zeros(len(b)), b, np.inf, np.inf, 0.0, "none")
    allowed = 0.0
    if near is not None:
        start = measure(system, b, near, "none")
        size = np.abs(b).max()
        best = start if start.largest < size else best
        allowed = 0.1 * min(start.largest, size) if share > 0.0 else 0.0
    for solver in STEADY if share > 0.0 else SOLVERS:
        if best.largest <= best.rounding:
            return best
        if solver.suits(system):
            best = refine(system, b, solver, best, share, allowed)
            if solver.is_direct or best.largest <= max(allowed, 64.0 * best.rounding):
                return best
    if not best.largest <= 1e-9 * np.abs(b).max():
        _checks.warn(
            f"the linear system of {len(b)} states is solved only to a residual of"
            f" {best.largest:.2g}, and its graph lets no direct solver finish: the"
            " error bound says what that is worth",
            NumericalWarning,
        )
    return best


def measure(system: System, b: Array, x: Array, method: str) -> Iterate:
    """x and what it misses."""
    n_roundings = float(system.n_roundings)
    missed, largest, bound, rounding = _system.residual(
        system.kernel, system.transpose, b, x, n_roundings
    )
    return Iterate(x, missed, largest, bound, rounding, method)


def refine(
    system: System,
    b: Array,
    solver: Solver,
    best: Iterate,
    share: float = 0.0,
    allowed: float = 0.0,
) -> Iterate:
    """Solve for what is missed until that is within rounding, or what is allowed, or
    stops falling.
    """
    solve = solver.prepare(system)
    for _ in range(9):
        step = solve(best.missed, max(share, 0.1 * best.rounding / best.largest))
        if step is None:
            break
        candidate = measure(system, b, best.x + step, solver.name)
        if not candidate.largest < best.largest:
            break
        is_stalled = candidate.largest > 0.5 * best.largest
        best = candidate
        if is_stalled or best.largest <= max(allowed, 0.25 * best.rounding):
            break
    return best


def inverse_norm(system: System) -> float:
    """An upper bound on |(I - discount K)^-1|_inf, from a certificate; an error where
    there is none.
    """
    carried = system.kernel.discount * system.row_sums[1]
    if carried <= 1.0 - 1e-9:
        return (1.0 + 1e-14) / (1.0 - carried)
    solution = answer(replace(system, transpose=False), np.ones(system.n_states))
    slack = 1.0 - solution.bound
    if not (np.all(np.isfinite(solution.x)) and solution.x.min() > 0.0 and slack > 0.5):
        radius = spectral_radius(system.csr(), system.kernel.discount)
        raise DivergentKernelError(
            "the infinite sum does not exist: discount * kernel has a spectral radius"
            f" of {radius:.6g}, which must be below 1 (its rows sum to at most"
            f" {carried:.6g}); normalise the rows or give a horizon"
        )
    return float(solution.x.max() / slack * (1.0 + 1e-14))
