"""A policy's linear system M x = b, M = I - gamma K, as arrays that compiled loops
read.
"""

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
from oee_tabular.mdp.naming import NAMELESS, Names
from oee_tabular.typing import Array, BoolArray, IntArray

# entries of a state in the envelope, on average, up to which LU in it is asked
# (solvers/direct.py)
WIDEST = 48.0

# x = solve(b, relative): until the residual of x is below ``relative`` times that of 0,
# which direct solvers need not read; None where the solver gives up
Solve: TypeAlias = Callable[[Array, float], Array | None]


class Csr(NamedTuple):
    """A CSR matrix as kernels read it: indices of 32 bits, unsigned (signed ones cost
    twice the time), all read-only.
    """

    indptr: Any
    indices: Any
    data: Array


class Kernel(NamedTuple):
    """The rows of K, and gamma."""

    indptr: Any
    indices: Any
    data: Array
    discount: float


def rows_of(matrix: sparse.csr_array) -> Csr:
    """The arrays of the matrix itself where they have 32 bits, so that each kernel is
    compiled for one kind of array.
    """
    indptr = matrix.indptr
    indices = matrix.indices
    data = matrix.data
    if indptr.dtype != np.int32 or indices.dtype != np.int32:
        if indptr[-1] >= 2**32:
            raise ArgumentError(
                "transitions",
                f"must have fewer than 2**32 entries; they have {int(indptr[-1])}",
            )
        indptr = indptr.astype(np.uint32)
        indices = indices.astype(np.uint32)
    return Csr(
        as_readonly(indptr).view(np.uint32),
        as_readonly(indices).view(np.uint32),
        as_readonly(data),
    )


def as_readonly(array: Any) -> Any:
    """The array, or a contiguous view of it, that cannot be written through."""
    # of an array that is broadcast a copy, whose flags may be asked for
    contiguous = np.ascontiguousarray(array)
    if not contiguous.flags.writeable:
        return contiguous
    view = contiguous.view()
    view.flags.writeable = False
    return view


NO_STATES: Any = np.zeros(0, dtype=np.uint32)
NO_ROWS = Csr(
    *map(
        as_readonly,
        (np.zeros(1, dtype=np.uint32), np.zeros(0, dtype=np.uint32), np.zeros(0)),
    )
)


@dataclass(frozen=True, eq=False)
class System:
    """M = I - gamma K, or its transpose.

    Attributes
    ----------
    kernel : K and gamma
    transpose : whether M^T x = b is meant
    n_roundings : counts the roundings in the entries of K, where K stands for a kernel
        that is not rounded
    """

    kernel: Kernel
    transpose: bool = False
    n_roundings: int = 0

    @property
    def n_states(self) -> int:
        """S."""
        return len(self.kernel.indptr) - 1

    @cached_property
    def row_sums(self) -> tuple[float, float, float]:
        """Of K the smallest, the largest with its rounding, and half way between them,
        without rounding.
        """
        smallest, largest, middle = _system.range_of_sums(
            self.kernel, float(self.n_roundings)
        )
        return smallest, largest, middle

    @property
    def shared_sum(self) -> float | None:
        """The sum of each row of K, where all have one and gamma times it is below 1."""
        smallest, largest, middle = self.row_sums
        has_one = (
            largest - smallest <= 1e-8 and self.kernel.discount * largest < 1.0 - 1e-9
        )
        return middle if has_one else None

    @cached_property
    def back(self) -> Csr:
        """K transposed."""
        return Csr(
            *map(as_readonly, _system.transpose_rows(*self.kernel[:3], self.n_states))
        )

    @cached_property
    def expands(self) -> bool:
        """Whether a few steps lead almost everywhere in the graph."""
        return bool(_system.expands(self.kernel))

    @cached_property
    def order(self) -> tuple[Any, Any]:
        """The states in breadth-first order along the rows, and each one's place."""
        return tuple(_system.breadth_first(self.kernel, NO_ROWS, np.inf))

    @cached_property
    def envelope(self) -> tuple[Any, ...] | None:
        """Places in a breadth-first order, and the envelope of M in the reverse of it,
        where that is narrow.

        Both the order along the rows and the one along the rows and back are tried: the
        first suits graphs in which all states lead back to one, the second layers. The
        latter ends as soon as it is wider than ``WIDEST`` entries a state.
        """
        # an envelope has half of them at least
        if len(self.kernel.indices) > (2.0 * WIDEST + 1.0) * self.n_states:
            return None
        for along_both in (False, True):
            _, place = (
                _system.breadth_first(self.kernel, self.back, WIDEST)
                if along_both
                else self.order
            )
            if len(place):
                order, first, starts = _system.find_envelope(self.kernel, place)
                if starts[-1] <= WIDEST * self.n_states:
                    return place, order, first, starts
        return None

    def csr(self) -> sparse.csr_array:
        """K, for a library."""
        kind = np.int32 if len(self.kernel.data) < 2**31 else np.int64
        indptr, indices = (part.astype(kind) for part in self.kernel[:2])
        return sparse.csr_array(
            (self.kernel.data, indices, indptr), shape=(self.n_states, self.n_states)
        )


def average_rows(rows: Csr, policy: Array) -> Csr:
    """sum_a policy[s, a] K(s' | s, a) of the rows s*A + a, without zeros, a row's
    entries in the order of its actions.
    """
    return average_rows_of(NO_STATES, rows, policy, NO_STATES, len(rows.data))


def average_rows_of(
    states: Any, rows: Csr, policy: Array, number: Any, n_entries: int
) -> Csr:
    """The same of these states, those that follow under a new number less 1; they have
    ``n_entries`` in all.
    """
    room = np.empty(n_entries, dtype=np.uint32), np.empty(n_entries)
    averaged = Csr(
        *_system.average_rows(rows, np.ascontiguousarray(policy), states, number, *room)
    )
    for part in averaged:
        # so that sweeps are compiled for one kind of array
        part.flags.writeable = False
    return averaged


def policy_system(model: Model, policy: Array) -> System:
    """M = I - gamma P_pi, P_pi = sum_a policy[s, a] K(s' | s, a)."""
    rows = average_rows(rows_of(model.csr), policy)
    return System(Kernel(*rows, model.discount), n_roundings=model.n_actions)


def policy_kernel(model: Model, policy: Array) -> sparse.csr_array:
    """(S, S): sum_a policy[s, a] K(s' | s, a)."""
    return policy_system(model, policy).csr().sorted_indices()


def recurrent_states(
    system: System, rewards: Array, names: Names = NAMELESS
) -> BoolArray:
    """(S,) mask of the closed classes at discount 1, which must have reward 0; the
    other states are solved for.
    """
    kernel = system.csr()
    _, component = csgraph.connected_components(
        kernel, directed=True, connection="strong"
    )
    rows = row_of_entry(kernel)
    crossing = (kernel.data > 0) & (component[rows] != component[kernel.indices])
    closed = np.ones(component.max() + 1, dtype=np.bool_)
    closed[component[rows[crossing]]] = False
    # a kernel may lose mass
    closed[component[row_sums(kernel) < 1.0 - 2.0 * _checks.SUM_TOLERANCE]] = False
    recurrent = np.asarray(closed[component])
    paying: IntArray = np.flatnonzero(recurrent & (rewards != 0.0))
    if paying.size:
        raise DivergentKernelError(
            "horizon must be given: at discount 1 the infinite sum exists only where"
            " the policy is absorbed in states with reward 0; it stays for ever among"
            f" states of which s={names.state(paying[0])} has reward"
            f" {rewards[paying[0]]:g} ({paying.size} such states in all)"
        )
    return recurrent


def drop_states(system: System, dropped: BoolArray) -> System:
    """The system in which these states lead nowhere."""
    entries = np.repeat(dropped, np.diff(system.kernel.indptr.astype(np.int64)))
    kernel = system.kernel._replace(
        data=as_readonly(np.where(entries, 0.0, system.kernel.data))
    )
    return System(kernel, system.transpose, system.n_roundings)


def exponent(numbers: Array) -> int:
    """That of the largest number, where its square may leave the range of floats; else
    0.
    """
    largest = float(
        _system.largest_magnitude(
            np.ascontiguousarray(numbers, dtype=np.float64).reshape(-1)
        )
    )
    return (
        0
        if largest == 0.0 or 1e-100 < largest < 1e100 or not largest < np.inf
        else int(np.frexp(largest)[1])
    )


def spectral_radius(kernel: sparse.csr_array, discount: float = 1.0) -> float:
    """The spectral radius of discount * K for a nonnegative K, by the power method (a
    mean over 1000 steps).
    """
    vector = np.ones(kernel.shape[0])
    growth = []
    for _ in range(2000):
        vector = discount * (kernel @ vector)
        size = float(vector.max(initial=0.0))
        if size == 0.0:
            return 0.0
        vector /= size
        growth.append(np.log(size))
    # the mean, for kernels that are periodic
    return float(np.exp(np.mean(growth[1000:])))
