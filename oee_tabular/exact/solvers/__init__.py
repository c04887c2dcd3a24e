"""Solvers of M x = b, M = I - gamma K, tried in order until the residual is small.

Small means within its own rounding. The order, with the systems that suit each solver:

* ``LAPACK(100)``: up to 100 states; dense.
* ``ValueIteration``: rows of one sum that mix, while four sweeps leave at most .45 of
  the change's spread.
* ``EnvelopeLU(is_narrow=True)``: narrow graphs, whatever the order of their states:
  rings, chains, queues, layers.
* ``SuperLU(8)``: other graphs in which elimination fills little, as trees.
* ``PlainBiCGStab``: graphs that expand; constants taken out, no preconditioner.
* ``BiCGStab``: all others; an independent set eliminated, a modified DILU in
  breadth-first order.
* ``EnvelopeLU``: where that takes more than 72 steps and the graph is not too wide.
* ``LAPACK(400)``: up to 400 states, where the solvers before fall short; dense.
* ``SuperLU()``: the same for any number of states, unless the graph expands; sparse.
* ``LAPACK(3000)``: the last resort, up to 3000 states; dense.

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
from oee_tabular.exact.solvers.direct import (
    LAPACK,
    MAX_DENSE_STATES,
    EnvelopeLU,
    SuperLU,
)
from oee_tabular.exact.solvers.elimination import Elimination
from oee_tabular.exact.solvers.mixing import PlainBiCGStab, ValueIteration
from oee_tabular.exact.system import Solve, System, spectral_radius
from oee_tabular.exceptions import DivergentKernelError, NumericalWarning
from oee_tabular.typing import Array


class Solver(Protocol):
    """A solver of policy systems, transposed ones as well: a member of ``SOLVERS``."""

    @property
    def name(self) -> str:
        """Return what users read as the method."""

    @property
    def is_direct(self) -> bool:
        """Return whether its answer stands even where its residual is too large."""

    def suits(self, system: System) -> bool:
        """Return whether it is tried on a system; others are never prepared."""

    def prepare(self, system: System) -> Solve:
        """Return the solver of any right side, which gives None if it gives up."""


SOLVERS: tuple[Solver, ...] = (
    LAPACK(100),
    ValueIteration(),
    EnvelopeLU(is_narrow=True),
    PlainBiCGStab(6, 2.5),
    Elimination(),
    PlainBiCGStab(),
    BiCGStab(),
    EnvelopeLU(),
    LAPACK(400),
    SuperLU(),
    LAPACK(MAX_DENSE_STATES),
)
# for answers that may keep a share of the residual; value iteration stops by the size
# of x
EARLY_STOP_SOLVERS = tuple(
    solver for solver in SOLVERS if not isinstance(solver, ValueIteration)
)


class Iterate(NamedTuple):
    """An approximation x of the solution, with its residual.

    Attributes
    ----------
    x : ndarray of shape (S,)
        The approximation.
    missed : ndarray of shape (S,)
        The residual b - M x.
    largest : float
        Its largest magnitude.
    bound : float
        A bound on the largest magnitude of the exact residual; transposed, on the sum
        of its magnitudes.
    rounding : float
        The largest rounding in the residual.
    method : str
        The solver.
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
    """Find x by the solvers that suit, one after the other, to rounding.

    Each begins where the solvers before it got to. ``near`` is what to begin with,
    where it is better than 0. ``share`` is the share of the residual of ``near`` that
    may be left; never more than a tenth is. It is for systems that change a little from
    one to the next: on grids of 100 x 100 a share of .001 takes .3 of an exact
    solution's time.
    """
    best = Iterate(np.zeros(len(b)), b, np.inf, np.inf, 0.0, "none")
    allowed = 0.0
    if near is not None:
        start = measure(system, b, near, "none")
        size = np.abs(b).max()
        if start.largest < size:
            best = start
        allowed = 0.1 * min(start.largest, size) if share > 0.0 else 0.0
    for solver in EARLY_STOP_SOLVERS if share > 0.0 else SOLVERS:
        if best.largest <= best.rounding:
            return best
        if solver.suits(system):
            best = refine(system, b, solver, best, share, allowed)
            # a few roundings more than the least are no reason for another solver
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
    """Return x with its residual and the bounds on it."""
    n_roundings = float(system.n_roundings)
    found = _system.residual(system.kernel, system.transpose, b, x, n_roundings)
    return Iterate(x, *found, method)


def refine(
    system: System,
    b: Array,
    solver: Solver,
    best: Iterate,
    share: float = 0.0,
    allowed: float = 0.0,
) -> Iterate:
    """Solve for the residual again until it is small enough or stops falling.

    Small enough is within rounding, or within ``allowed``.
    """
    solve = solver.prepare(system)
    for _ in range(9):
        step = solve(best.missed, max(share, 0.1 * best.rounding / best.largest))
        if step is None:
            break
        candidate = measure(system, b, best.x + step, solver.name)
        if not candidate.largest < best.largest:
            break
        # after a step that does not halve the residual, further ones gain little
        is_stalled = candidate.largest > 0.5 * best.largest
        best = candidate
        if is_stalled or best.largest <= max(allowed, 0.25 * best.rounding):
            break
    return best


def inverse_norm(system: System) -> float:
    """Return an upper bound on |(I - discount K)^-1|_inf, from a certificate.

    A DivergentKernelError is raised where there is none.
    """
    # rows whose sums times gamma are below 1 are certified by h = 1
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
