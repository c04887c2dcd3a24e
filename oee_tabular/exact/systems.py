"""The solvers behind ``solve_policy_system``, and which of them a system is given to.

=========================  ============================================================================================
up to 32 states            dense LU, without pivoting (an M-matrix needs none)
small communicating sets   one after the other, by dense LU: layered models, whatever the order of their states
a narrow band              banded LU, as the states stand or in breadth-first order
rows of one sum that mix   value iteration with the common change summed, while each sweep more than halves the spread
all others                 an independent set eliminated, then BiCGSTAB with a modified DILU in breadth-first order
where that falls short     LAPACK up to 400 states, else SuperLU with the minimum degree order of A^T + A (``direct``)
=========================  ============================================================================================

A direct solver is the last resort because it fills in on expanders, of which no more than 3000 states are given to one: the
iteration's answer, with its bound, stands there. All are refined on the residual of the system as it was given, until that is
as small as its own rounding.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular.exact.solvers.library import Solver, library

TINY = 32
LARGEST_COMPONENT = 100  # and a tenth of the states
_FLOOR = 2e-15  # of the iteration's residual relative to its y, which is a good deal smaller than x
_STEPS = 500
ITERATIVE = ("BiCGSTAB", "value iteration")
Missed = tuple[Array, float, float, float]


@dataclass(frozen=True, eq=False)
class System:
    """M = I - discount K, or its transpose, as arrays that the kernels read.

    ``formed`` counts the roundings in the entries of K, where K stands for a kernel that is not rounded.
    """

    indptr: Any
    indices: Any
    data: Array
    discount: float
    transpose: bool = False
    formed: int = 0

    @classmethod
    def of(cls, kernel: sparse.csr_array, discount: float, transpose: bool = False, formed: int = 0) -> System:
        """Of a CSR matrix."""
        data = np.ascontiguousarray(kernel.data, dtype=np.float64)
        return cls(unsigned(kernel.indptr), unsigned(kernel.indices), readable(data), discount, transpose, formed)

    @property
    def n_states(self) -> int:
        """S."""
        return len(self.indptr) - 1

    @cached_property
    def sums(self) -> tuple[float, float]:
        """The smallest and the largest row sum of K, the latter with its rounding."""
        from oee_tabular.exact._policy_rows import range_of_sums

        low, high, entries = range_of_sums(self.indptr, self.data)
        return low, high * (1.0 + (int(entries) + self.formed) * np.finfo(float).eps)

    @cached_property
    def order(self) -> tuple[Any, Any]:
        """Breadth-first order and its inverse."""
        from oee_tabular.exact.solvers._bicgstab import breadth_first

        found: tuple[Any, Any] = breadth_first(self.indptr, self.indices)
        return found

    @cached_property
    def components(self) -> tuple[Any, Any]:
        """States by strongly connected component, those last that lead to all others; where components begin, or nothing."""
        from oee_tabular.exact.solvers._components import components

        most = min(LARGEST_COMPONENT, self.n_states // 10)
        found: tuple[Any, Any] = components(self.indptr, self.indices, self.data, most)
        return found

    def residual(self, b: Array, x: Array) -> Missed:
        """b - M x, its largest magnitude, a bound on the exact one (largest, transposed: sum), the largest rounding."""
        from oee_tabular.exact import _policy_rows as policy_rows

        kernel = policy_rows.residual_transposed if self.transpose else policy_rows.residual
        found: Missed = kernel(self.indptr, self.indices, self.data, self.discount, b, x, float(self.formed))
        return found

    def forward(self) -> System:
        """The same without the transposition."""
        if not self.transpose:
            return self  # and what it has worked out
        return System(self.indptr, self.indices, self.data, self.discount, False, self.formed)

    def kernel(self) -> sparse.csr_array:
        """K."""
        indptr, indices = (part.astype(np.int64) for part in (self.indptr, self.indices))
        return sparse.csr_array((self.data, indices, indptr), shape=(self.n_states, self.n_states))

    def matrix(self) -> sparse.csc_array:
        """M for a library's solver."""
        matrix = sparse.csr_array(sparse.eye_array(self.n_states, format="csr") - self.discount * self.kernel())
        return sparse.csc_array(matrix.T if self.transpose else matrix)


def unsigned(index: Any) -> Any:
    """An index array as the kernels read it: uint32, contiguous, read-only."""
    if index.dtype == np.int32 and index.flags.c_contiguous:
        return readable(index.view(np.uint32))
    if len(index) and int(index[-1]) >= 2**32:  # row pointers end with their largest
        raise ValueError(f"transitions must have fewer than 2**32 entries; they have {int(index[-1])}")
    return readable(np.ascontiguousarray(index, dtype=np.uint32))


def readable(array: Any) -> Any:
    """A read-only view: each of the kernels is compiled for one kind of array only."""
    view = array.view()
    view.flags.writeable = False
    return view


def solve(system: System, b: Array) -> tuple[Array, Missed, str]:
    """x, what ``System.residual`` says of it, and the method."""
    solver, method, start = choose(system, b)
    x, found = refine(system, b, solver, start)
    if method in ITERATIVE and not found[1] <= 64.0 * found[3]:
        last = library(system)
        if last is not None:
            y, of_y = refine(system, b, last[0], least=1)
            if not of_y[1] >= found[1]:
                return y, of_y, last[1]
        elif not found[1] <= 1e-9 * np.abs(b).max():
            warnings.warn(
                f"the linear system of {system.n_states} states is solved only to a residual of {found[1]:.2g}, and its graph "
                "lets no direct solver finish: the error bound says what that is worth",
                RuntimeWarning,
                stacklevel=2,
            )
    return x, found, method


def refine(
    system: System, b: Array, solver: Solver, start: Array | None = None, least: int = 0
) -> tuple[Array, Missed]:
    """Solve, then for the residual, ``least`` times and until that is within rounding or stops falling."""
    x = solver(b, 0.0) if start is None else start
    found = system.residual(b, x)
    for taken in range(8):
        missed, largest, _, rounding = found
        if not (0.0 if taken < least else 0.25 * rounding) < largest < np.inf:
            break
        candidate = x + solver(missed, 0.1 * rounding / largest)
        again = system.residual(b, candidate)
        if not again[1] < largest:
            break
        stalled = again[1] > 0.5 * largest
        x, found = candidate, again
        if stalled:
            break
    return x, found


def choose(system: System, b: Array) -> tuple[Solver, str, Array | None]:
    """The solver for the system, its name, and its first answer where finding out has given one."""
    n = system.n_states
    if n <= TINY:
        return elimination(system, n - 1, n - 1, False), "dense LU", None
    if len(system.components[1]):
        return by_components(system), "LU by components", None
    crowded = len(system.indices) > 8 * n  # a graph that mixes, most often: tried before states are put in an order
    if crowded and (mixing := _mixing(system, b)) is not None:
        return mixing
    from oee_tabular.exact.solvers._elimination import band_of

    below, above, below_placed, above_placed = band_of(system.indptr, system.indices, system.order[1])
    for low, high, placed in ((below, above, False), (below_placed, above_placed, True)):
        if low * high + 2 * (low + high) <= (700 if system.discount > 0.999 else 250) and n * (low + high) <= 1e8:
            return elimination(system, low, high, placed), "banded LU", None
    if not crowded and (mixing := _mixing(system, b)) is not None:
        return mixing
    return krylov(system), "BiCGSTAB", None


def _mixing(system: System, b: Array) -> tuple[Solver, str, Array | None] | None:
    """Value iteration and its answer, where the first sweeps show that it gets there."""
    low_sum, high_sum = system.sums
    if system.transpose or high_sum - low_sum > 1e-8 or system.discount * high_sum >= 1.0 - 1e-9:
        return None
    start, done = sweeps(system, b, 0.0, 0.5)
    if not done:
        return None
    return lambda missed, relative: sweeps(system, missed, relative, 1.0)[0], "value iteration", start


def elimination(system: System, below: int, above: int, placed: bool) -> Solver:
    """LU without pivoting, dense where the band is."""
    from oee_tabular.exact.solvers._elimination import factor, fill, substitute

    n = system.n_states
    dense = below == above == n - 1
    step, shift = (n, 0) if dense else (below + above, below)
    order, place = system.order if placed else (None, np.arange(n, dtype=np.uint32))
    size = n * n if dense else n * (step + 1)
    matrix = fill(system.indptr, system.indices, system.data, system.discount, place, size, step, shift)
    regular = factor(matrix, n, step, shift, below, above)

    def solver(b: Array, relative: float) -> Array:
        if not regular:
            return np.full(n, np.nan)
        x = np.array(b if order is None else b[order])
        substitute(matrix, n, step, shift, below, above, x, system.transpose)
        return x if order is None else x[place]

    return solver


def by_components(system: System) -> Solver:
    """Strongly connected components one after the other."""
    from oee_tabular.exact.solvers._components import solve

    parts, found = (system.indptr, system.indices, system.data, system.discount), system.components

    def solver(b: Array, relative: float) -> Array:
        x: Array = solve(*parts, *found, readable(b), system.transpose)
        return x

    return solver


def sweeps(system: System, b: Array, relative: float, ratio: float) -> tuple[Array, bool]:
    """Value iteration, and whether it got there with each sweep dividing the spread by 1 / ratio."""
    from oee_tabular.exact._policy_rows import span_iteration

    parts = system.indptr, system.indices, system.data, system.discount, system.sums[1]
    found: tuple[Array, bool] = span_iteration(*parts, b, ratio, max(relative, 8e-16), 200)
    return found


def krylov(system: System) -> Solver:
    """Preconditioned BiCGSTAB, on what an independent set of states leaves where that has not many more entries."""
    from oee_tabular.exact.solvers import _reduction as reduction

    # weight 1 keeps row sums, which counts near discount 1; a little below it the iteration is steadier in a drift
    weight = 1.0 - min(0.1, max(0.001, 0.15 * np.sqrt(1.0 - system.discount)))
    parts, (order, place) = (system.indptr, system.indices, system.data, system.discount), system.order
    mark, inverse, room = reduction.independent(*parts, order)
    if room > 2.5 * len(system.indices):
        return iteration(system, order, place, weight)
    columns, values = np.empty(room, dtype=np.uint32), np.empty(room)  # only what is filled becomes memory
    starts, states, number = reduction.eliminate(*parts, order, mark, inverse, columns, values)
    rest = System(starts, columns[: starts[-1]], values[: starts[-1]], 1.0, system.transpose)
    natural = np.arange(len(states), dtype=np.uint32)
    inner = iteration(rest, natural, natural, weight)

    def solver(b: Array, relative: float) -> Array:
        left = reduction.reduce_right(*parts, mark, inverse, states, number, b, system.transpose)
        found: Array = reduction.extend(*parts, mark, inverse, states, b, inner(left, relative), system.transpose)
        return found

    return solver


def iteration(system: System, order: Any, place: Any, weight: float) -> Solver:
    """BiCGSTAB with the states in the given order."""
    from oee_tabular.exact._policy_rows import transposed
    from oee_tabular.exact.solvers._bicgstab import bicgstab, modified_diagonal, split

    rows = readable(system.indptr), readable(system.indices), readable(system.data)
    modified = modified_diagonal(*rows, system.discount, weight, order, place)
    if system.transpose:
        rows = tuple(readable(part) for part in transposed(*rows))
    parts: tuple[Any, Any, Any, Any, Any] = split(*rows, system.discount, order, place, modified)

    def solver(b: Array, relative: float) -> Array:
        x, _ = bicgstab(*parts, b[order] / modified, relative, _FLOOR, _STEPS)
        found: Array = x[place]
        return found

    return solver
