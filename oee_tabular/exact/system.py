"""A policy's linear system M x = b, M = I - gamma K, as arrays for compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._sparse import row_of_entry, row_sums
from oee_tabular.exact import _system
from oee_tabular.exact.reweighted import Model
from oee_tabular.exceptions import ArgumentError, DivergentKernelError
from oee_tabular.mdp import NAMELESS, CsrArrays, Names
from oee_tabular.typing import Array, BoolArray, Csr, IntArray

# entries of a state in the envelope, on average, up to which LU in it is tried
# (solvers/direct.py says where that was measured)
MAX_ENVELOPE_WIDTH = 48.0
# those up to which it is tried first: on grids of 20 x 20, which have as many, BiCGSTAB
# takes as long
MAX_NARROW_WIDTH = 14
# entries of K a state below which no second order is tried; a tree has two
MIN_BAND_ENTRIES = 2.5

# the smallest positive float: what the rounding of a subnormal number may add
SMALLEST_FLOAT = 5e-324

N_POWER_STEPS = 2000  # of the power method

# x = solve(b, relative): the residual of x is below ``relative`` times the residual of
# 0 (direct solvers need not read it); None where the solver gives up
Solve: TypeAlias = Callable[[Array, float], Array | None]


class KernelRows(NamedTuple):
    """Hold a csr matrix as compiled loops read it, in read-only arrays.

    Indices have 32 bits and are unsigned, because signed ones cost twice the time.
    """

    indptr: Any
    indices: Any
    data: Array


class Kernel(NamedTuple):
    """Hold the rows of K as ``KernelRows`` has them, and the discount gamma."""

    indptr: Any
    indices: Any
    data: Array
    discount: float


def rows_of(matrix: CsrArrays | Csr) -> KernelRows:
    """Return a matrix as the arrays that kernels read.

    They are views where the matrix has 32 bits, and copies of 32 bits elsewhere, so
    that each kernel is compiled for one kind of array.
    """
    indptr: Any = matrix.indptr
    indices: Any = matrix.indices
    data = matrix.data
    if indptr.dtype != np.int32 or indices.dtype != np.int32:
        if indptr[-1] >= 2**32:
            raise ArgumentError(
                "transitions",
                f"must have fewer than 2**32 entries; they have {int(indptr[-1])}",
            )
        indptr = indptr.astype(np.uint32)
        indices = indices.astype(np.uint32)
    return KernelRows(
        as_readonly(indptr).view(np.uint32),
        as_readonly(indices).view(np.uint32),
        as_readonly(data),
    )


def as_readonly(array: Any) -> Any:
    """Return the array, or a contiguous view of it, that cannot be written through."""
    # a broadcast array is copied, so that its flags may be read
    contiguous = np.ascontiguousarray(array)
    if not contiguous.flags.writeable:
        return contiguous
    view = contiguous.view()
    view.flags.writeable = False
    return view


NO_STATES: Any = np.zeros(0, dtype=np.uint32)
NO_ROWS = KernelRows(
    as_readonly(np.zeros(1, dtype=np.uint32)),
    as_readonly(np.zeros(0, dtype=np.uint32)),
    as_readonly(np.zeros(0)),
)


@dataclass(frozen=True, eq=False)
class System:
    """Hold the linear system of M = I - gamma K, or of its transpose.

    Attributes
    ----------
    kernel : Kernel
        K and gamma.
    transpose : bool
        Whether the system is M^T x = b.
    n_roundings : int
        Number of roundings in each entry of K, where K stands for a kernel that is not
        rounded.
    """

    kernel: Kernel
    transpose: bool = False
    n_roundings: int = 0

    @property
    def n_states(self) -> int:
        """Return the number of states S."""
        return len(self.kernel.indptr) - 1

    @cached_property
    def row_sums(self) -> tuple[float, float, float]:
        """Return the smallest row sum of K, the largest, and their mid-point.

        The largest includes its rounding; the mid-point does not.
        """
        return _system.range_of_sums(
            self.kernel.indptr, self.kernel.data, self.n_roundings
        )

    @property
    def shared_sum(self) -> float | None:
        """Return the sum that all rows of K share, or None.

        It is None where rows differ or where gamma times the sum is not below 1.
        """
        smallest, largest, middle = self.row_sums
        is_shared = largest - smallest <= 1e-8
        is_convergent = self.kernel.discount * largest < 1.0 - 1e-9
        return middle if is_shared and is_convergent else None

    @cached_property
    def back(self) -> KernelRows:
        """Return the rows of K transposed."""
        parts = _system.transpose_rows(*self.kernel[:3], self.n_states)
        return KernelRows(*(as_readonly(part) for part in parts))

    @cached_property
    def expands(self) -> bool:
        """Return whether a few steps lead almost everywhere in the graph."""
        return bool(_system.expands(self.kernel))

    @cached_property
    def order(self) -> tuple[Any, Any]:
        """Return the states in breadth-first order along the rows, and their places."""
        return tuple(_system.breadth_first(self.kernel, NO_ROWS, np.inf, 0))

    @cached_property
    def envelope(self) -> tuple[Any, ...] | None:
        """Return the envelope of M in a breadth-first order, or None where it is wide.

        The tuple has the place of each state and what ``find_envelope`` returns. Wide
        is more than ``MAX_ENVELOPE_WIDTH`` entries a state. The order along the rows
        suits graphs in which all states lead back to one. Where its envelope is not
        narrow, the order along the rows and back is tried, which suits layers and
        bands. This search begins with the last state of the first, since from the
        middle of a band it would go both ways at once, in fronts of twice the width.
        """
        # an envelope has at least half of the entries
        if len(self.kernel.indices) > (2.0 * MAX_ENVELOPE_WIDTH + 1.0) * self.n_states:
            return None
        best = self._envelope_of(self.order[1])
        # trees and the like are quicker to eliminate in another order
        is_tree = len(self.kernel.indices) < MIN_BAND_ENTRIES * self.n_states
        if best[-1][-1] > self.max_narrow_entries and not is_tree:
            last = int(self.order[0][-1])
            _, place = _system.breadth_first(
                self.kernel, self.back, MAX_ENVELOPE_WIDTH, last
            )
            if len(place):
                best = min(best, self._envelope_of(place), key=lambda e: e[-1][-1])
        return best if best[-1][-1] <= MAX_ENVELOPE_WIDTH * self.n_states else None

    def _envelope_of(self, place: Any) -> tuple[Any, ...]:
        """Return the places of the states and their envelope."""
        return place, *_system.find_envelope(self.kernel, place)

    @property
    def max_narrow_entries(self) -> int:
        """Return the number of entries up to which an envelope is narrow."""
        return max(MAX_NARROW_WIDTH * self.n_states, 2 * len(self.kernel.indices))

    def csr(self) -> Csr:
        """Return K as a scipy matrix."""
        kind = np.int32 if len(self.kernel.data) < 2**31 else np.int64
        indptr, indices = (part.astype(kind) for part in self.kernel[:2])
        return sparse.csr_array(
            (self.kernel.data, indices, indptr), shape=(self.n_states, self.n_states)
        )


def average_rows(rows: KernelRows, policy: Array) -> KernelRows:
    """Compute sum_a policy[s, a] K(s' | s, a) from the rows s*A + a.

    Zeros are left out; the entries of a row stand in the order of its actions.
    """
    return average_rows_of(NO_STATES, rows, policy, NO_STATES, len(rows.data))


def average_rows_of(
    states: Any, rows: KernelRows, policy: Array, number: Any, n_entries: int
) -> KernelRows:
    """Compute the rows of ``average_rows`` for some states only.

    ``number`` has 1 + the new number of each state that follows. The rows of these
    states have ``n_entries`` entries in all.
    """
    averaged = KernelRows(
        *_system.average_rows(
            rows, np.ascontiguousarray(policy), states, number, n_entries
        )
    )
    # all arrays are read-only, so that sweeps are compiled for one kind of array
    for part in averaged:
        part.flags.writeable = False
    return averaged


def policy_system(model: Model, policy: Array) -> System:
    """Make M = I - gamma P_pi with P_pi = sum_a policy[s, a] K(s' | s, a)."""
    rows = average_rows(rows_of(model.csr), policy)
    return System(Kernel(*rows, model.discount), n_roundings=model.n_actions)


def policy_kernel(model: Model, policy: Array) -> Csr:
    """Compute P_pi = sum_a policy[s, a] K(s' | s, a) as csr (S, S)."""
    return policy_system(model, policy).csr().sorted_indices()


def recurrent_states(
    system: System, rewards: Array, names: Names = NAMELESS
) -> BoolArray:
    """Find the states of the closed classes at discount 1, as a mask (S,).

    Their reward must be 0, or a DivergentKernelError is raised. The system is solved
    for the other states.
    """
    kernel = system.csr()
    _, component = csgraph.connected_components(
        kernel, directed=True, connection="strong"
    )
    rows = row_of_entry(kernel)
    crossing = (kernel.data > 0) & (component[rows] != component[kernel.indices])
    closed = np.ones(component.max() + 1, dtype=np.bool_)
    closed[component[rows[crossing]]] = False
    # a class that loses mass is left at some time, as well as one with a way out
    closed[component[row_sums(kernel) < 1.0 - 2.0 * _checks.SUM_TOLERANCE]] = False
    recurrent = np.asarray(closed[component])
    rewarded: IntArray = np.flatnonzero(recurrent & (rewards != 0.0))
    if rewarded.size:
        raise DivergentKernelError(
            "horizon must be given: at discount 1 the infinite sum exists only where"
            " the policy is absorbed in states with reward 0; it stays for ever among"
            f" states of which s={names.state(rewarded[0])} has reward"
            f" {rewards[rewarded[0]]:g} ({rewarded.size} such states in all)"
        )
    return recurrent


def drop_states(system: System, dropped: BoolArray) -> System:
    """Return the system in which the dropped states lead nowhere."""
    entries = np.repeat(dropped, np.diff(system.kernel.indptr.astype(np.int64)))
    kernel = system.kernel._replace(
        data=as_readonly(np.where(entries, 0.0, system.kernel.data))
    )
    return System(kernel, system.transpose, system.n_roundings)


def exponent(numbers: Array) -> int:
    """Return the exponent of the largest number if squares may overflow, else 0.

    Numbers between 1e-100 and 1e100 have squares within the range of floats.
    """
    largest = _system.largest_magnitude(np.asarray(numbers, dtype=np.float64))
    if largest == 0.0 or 1e-100 < largest < 1e100 or not largest < np.inf:
        return 0
    return int(np.frexp(largest)[1])


def spectral_radius(kernel: Csr, discount: float = 1.0) -> float:
    """Compute the spectral radius of discount * K, K >= 0, by the power method.

    It is exp of the mean growth, log |K x|_inf / |x|_inf, over the last half of the
    steps.
    """
    vector = np.ones(kernel.shape[0])
    growth = []
    for _ in range(N_POWER_STEPS):
        vector = discount * np.asarray(kernel @ vector)
        size = float(vector.max(initial=0.0))
        if size == 0.0:
            return 0.0
        vector /= size
        growth.append(np.log(size))
    # kernels may be periodic: the mean growth, not the last
    return float(np.exp(np.mean(growth[N_POWER_STEPS // 2 :])))
