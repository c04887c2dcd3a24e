"""Solvers of M x = b, M = I - gamma K, one a file, and the choice among them: the first that suits and does not give up.

=========================  =============================================================================================
``LAPACK(100)``            up to 100 states: dense
``ValueIteration``         rows of one sum that mix: the common change summed, while four sweeps halve the spread
``EnvelopeLU(..)``         narrow graphs, whatever the order of their states: rings, chains, queues, layers
``SuperLU(8)``             other graphs in which elimination fills little: trees
``BiCGStab(is_plain=..)``  graphs that expand: constants taken out, no preconditioner
``BiCGStab``               all others: an independent set eliminated, a modified DILU in breadth-first order
``EnvelopeLU``             where that takes more than 24 steps and the graph is not too wide
``LAPACK``, ``SuperLU``    with pivoting: where an iteration falls short, unless the graph would never let them finish
=========================  =============================================================================================

A new solver is a file with such a class and a place in ``SOLVERS``; tests/exact/test_solvers.py holds every one to the same
laws. Answers are refined on the residual of the system as it was given, until that is as small as its own rounding.

For a nonnegative K any h > 0 with M h >= c > 0 certifies that the spectral radius of gamma K is below 1 and that |M^-1|_inf <=
max(h) / c [1]. Rows that sum to 1 give h = 1, c = 1 - gamma; other kernels (unnormalised ratios, discount 1) need one more
solution.

Reference: [1] Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences, 1994, chapter 6 (M-matrices).
"""

from __future__ import annotations

import warnings
from typing import NamedTuple, Protocol

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.exact import _policy_rows
from oee_tabular.exact.solvers.bicgstab import BiCGStab
from oee_tabular.exact.solvers.envelope import EnvelopeLU
from oee_tabular.exact.solvers.lapack import LAPACK, LAST_RESORT
from oee_tabular.exact.solvers.superlu import SuperLU
from oee_tabular.exact.solvers.value_iteration import ValueIteration
from oee_tabular.exact.system import DivergentKernelError, Solve, System, spectral_radius


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
        """The solver of any right side; nan where the system is singular, None where the solver gives up."""


SOLVERS: tuple[Solver, ...] = (
    LAPACK(100),
    ValueIteration(),
    EnvelopeLU(is_narrow=True),
    SuperLU(8.0),
    BiCGStab(is_plain=True),
    BiCGStab(),
    EnvelopeLU(),
    LAPACK(400),
    SuperLU(),
    LAPACK(LAST_RESORT),
)
STEADY = tuple(solver for solver in SOLVERS if not isinstance(solver, ValueIteration))  # sweeps stop by the size of x


class Answer(NamedTuple):
    """x; b - M x, its largest magnitude, a bound on the exact one (transposed: on its sum), the largest rounding in it."""

    x: Array
    missed: Array
    largest: float
    bound: float
    rounding: float
    method: str


def answer(system: System, b: Array, near: Array | None = None) -> Answer:
    """By the first solver that suits; where an iteration ends above its rounding, the better of it and those after it.

    ``near``: the solver corrects it, unless it is within rounding already, or no better than 0.
    """
    best = None if near is None else _measure(system, b, near, "none")
    if best is not None:
        if best.largest <= best.rounding:
            return best
        if not best.largest < np.abs(b).max():
            best = near = None
    for solver in SOLVERS:
        if not solver.suits(system):
            continue
        found = refine(system, b, solver.prepare(system), solver.name, near)
        if found is None:
            continue
        if best is None or not found.largest >= best.largest:
            best = found
        if solver.is_direct or best.largest <= 64.0 * best.rounding:
            return best
    assert best is not None
    if not best.largest <= 1e-9 * np.abs(b).max():
        warnings.warn(
            f"the linear system of {len(b)} states is solved only to a residual of {best.largest:.2g}, and its graph "
            "lets no direct solver finish: the error bound says what that is worth",
            RuntimeWarning,
            stacklevel=2,
        )
    return best


def correct(system: System, b: Array, near: Array, share: float) -> Answer:
    """``near`` and one step that leaves about ``share`` of what it misses, by the first of ``STEADY`` that has one.

    Where none leaves a tenth or less, ``answer``. For systems that change a little from one to the next: on grids of 100 x
    100 a share of .001 takes .3 of an exact solution's time.
    """
    before = _measure(system, b, near, "none")
    if before.largest <= before.rounding:
        return before
    for solver in STEADY:
        step = solver.prepare(system)(before.missed, share) if solver.suits(system) else None
        if step is not None:
            found = _measure(system, b, near + step, solver.name)
            if found.largest <= max(0.1 * before.largest, 64.0 * found.rounding):
                return found
    return answer(system, b)


def _measure(system: System, b: Array, x: Array, method: str) -> Answer:
    residual = _policy_rows.residual_transposed if system.transpose else _policy_rows.residual
    missed, largest, bound, rounding = residual(system.kernel, b, x, float(system.n_roundings))
    return Answer(x, missed, largest, bound, rounding, method)


def refine(system: System, b: Array, solve: Solve, method: str, near: Array | None = None) -> Answer | None:
    """Solve, then for the residual, until that is within rounding or stops falling; None where the solver gives up."""
    residual = _policy_rows.residual_transposed if system.transpose else _policy_rows.residual
    x = solve(b, 0.0) if near is None else near
    if x is None:
        return None
    missed, largest, bound, rounding = residual(system.kernel, b, x, float(system.n_roundings))
    found = Answer(x, missed, largest, bound, rounding, method)
    for _ in range(8):
        if not 0.25 * found.rounding < found.largest < np.inf:
            break
        step = solve(found.missed, 0.1 * found.rounding / found.largest)
        if step is None:
            break
        x = found.x + step
        missed, largest, bound, rounding = residual(system.kernel, b, x, float(system.n_roundings))
        if not largest < found.largest:
            break
        stalled = largest > 0.5 * found.largest
        found = Answer(x, missed, largest, bound, rounding, method)
        if stalled:
            break
    return found


def inverse_norm(system: System) -> float:
    """An upper bound on |(I - discount K)^-1|_inf, from a certificate; an error where there is none."""
    carried = system.kernel.discount * system.largest
    if carried <= 1.0 - 1e-9:
        return (1.0 + 1e-14) / (1.0 - carried)
    system = system.forward()
    found = answer(system, np.ones(len(system.kernel.indptr) - 1))
    slack = 1.0 - found.bound
    if not (np.all(np.isfinite(found.x)) and found.x.min() > 0.0 and slack > 0.5):
        radius = spectral_radius(system.csr(), system.kernel.discount)
        raise DivergentKernelError(
            f"the infinite sum does not exist: discount * kernel has a spectral radius of {radius:.6g}, "
            f"which must be below 1 (its rows sum to at most {carried:.6g}); "
            "normalise the rows or give a horizon"
        )
    return float(found.x.max() / slack * (1.0 + 1e-14))
