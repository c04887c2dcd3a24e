"""Rules of an MDP's arrays, and P(s' | s, a) and r(s, a, s') as sparse entries.

The entries are those of rows s*A + a.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._sparse import (
    CsrParts,
    Entries,
    align,
    align_to,
    canonical,
    check_csr,
    check_values,
    csr_on_pattern,
    entries_of,
    is_matrix_list,
    repeat_rows,
    row_of_entry,
    row_sums,
    stack_actions,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp.naming import NAMELESS, Names, valid_names
from oee_tabular.typing import Array, BoolArray, Csr, IntArray

_SHAPES = (
    "have shape (S, A, S), or (S*A, S) as a scipy.sparse array, with at least one state"
    " and one action"
)
_EMPTY_HINT = " (of an action that cannot be taken: available=)"


class Available(NamedTuple):
    """Hold which actions can be taken, and the names that errors call them by.

    Attributes
    ----------
    mask : ndarray of bool of shape (S, A)
        True where the action can be taken; each state has such an action.
    names : Names
        The names of states and actions.
    """

    mask: BoolArray
    names: Names

    def sums(self, sums: NDArray[Any]) -> NDArray[Any]:
        """Return (S, A) sums of rows, 1 in place of 0 where no row is needed.

        A row that is not empty where its action is unavailable is an ArgumentError.
        """
        if sums.shape != self.mask.shape:
            (states, actions), (n, m) = self.mask.shape, sums.shape
            raise ArgumentError(
                "transitions",
                f"must be for {states} states and {actions} actions, as available is;"
                f" they are for {n} and {m}",
            )
        bad = np.argwhere(~self.mask & (sums != 0))
        if len(bad):
            more = _checks.in_all(len(bad), "such rows")
            raise ArgumentError(
                _checks.place("transitions", tuple(bad[0])),
                "must be zeros where the action cannot be taken;"
                f" {self.names.pair(*bad[0])} has a next state, and"
                f" {_checks.place('available', tuple(bad[0]))} is False{more} (make it"
                " True, or the row zeros)",
            )
        return np.where(self.mask, sums, sums.dtype.type(1))


class CsrArrays(NamedTuple):
    """Hold the read-only arrays of a csr matrix, without scipy's object.

    scipy's object takes longer to make than V of 4 states.
    """

    indptr: IntArray
    indices: IntArray
    data: Array
    shape: tuple[int, int]

    @property
    def nnz(self) -> int:
        """Return the number of entries."""
        return len(self.data)

    @classmethod
    def from_dense(cls, rows: Array, mask: BoolArray | None = None) -> CsrArrays:
        """Take the entries of an (n, m) array that are not 0, or those of ``mask``."""
        row, column = (rows if mask is None else mask).nonzero()
        has_small_indices = max(len(row), *rows.shape) < 2**31
        kind = np.int32 if has_small_indices else np.int64
        indptr = row.searchsorted(np.arange(len(rows) + 1)).astype(kind)
        return cls(
            freeze(indptr),
            freeze(column.astype(kind)),
            freeze(rows[row, column]),
            cast(tuple[int, int], rows.shape),
        )

    @classmethod
    def from_matrix(cls, matrix: Csr) -> CsrArrays:
        """Take the arrays of a canonical matrix."""
        # indices have 32 bits where they fit, which their type does not tell
        indptr = cast(IntArray, matrix.indptr)
        indices = cast(IntArray, matrix.indices)
        return cls(indptr, indices, matrix.data, matrix.shape)

    def to_matrix(self) -> Csr:
        """Return scipy's matrix of these arrays."""
        matrix: Any = csr_on_pattern(self, self.data, own=True)
        # the arrays themselves, of which scipy took views
        matrix.indptr = self.indptr
        matrix.indices = self.indices
        matrix.data = self.data
        return cast(Csr, matrix)


def name_transition(
    matrix: CsrParts, entry: int, n_actions: int, names: Names = NAMELESS
) -> str:
    """Describe an entry of rows s*A + a as ``s=3, a=1 -> s'=7``.

    Names stand in place of numbers where there are some.
    """
    row = int(np.searchsorted(matrix.indptr, entry, side="right")) - 1
    return names.transition(*divmod(row, n_actions), matrix.indices[entry])


def csr_from_entries(
    rows: NDArray[np.integer[Any]],
    columns: NDArray[np.integer[Any]],
    data: Array,
    shape: tuple[int, int],
) -> Csr:
    """Make the csr of exactly these entries, explicit zeros included."""
    matrix = sparse.csr_array((data, (rows, columns)), shape=shape)
    return canonical(matrix, drop_zeros=False)


def check_transitions(
    transitions: Any, available: Available | None = None
) -> tuple[CsrArrays, int, int]:
    """Check P and return its entries, the number of states and the number of actions.

    Rows are empty exactly where an action is not ``available``. What another MDP has
    checked (``CsrArrays``) is taken as it is, but for that.
    """
    if isinstance(transitions, CsrArrays):
        csr = transitions
        # those of a pickle can be written to
        for part in (csr.indptr, csr.indices, csr.data):
            freeze(part)
        _require_rows(csr, available)
    elif _checks.is_sparse(transitions) or is_matrix_list(transitions):
        csr = _check_sparse_transitions(transitions, available)
    else:
        csr = _check_dense_transitions(transitions, available)
    n_rows, n_states = csr.shape
    return csr, n_states, n_rows // n_states


def _require_rows(csr: CsrArrays, available: Available | None) -> None:
    """Require that rows have entries exactly where actions are available."""
    is_filled = csr.indptr[1:] > csr.indptr[:-1]
    n_states = csr.shape[1]
    if available is not None:
        is_filled = available.sums(is_filled.reshape(n_states, -1))
    if not is_filled.all():
        sums = is_filled.reshape(n_states, -1).astype(np.float64)
        _checks.require_sums_to_one(sums, "transitions", _EMPTY_HINT)


def _check_dense_transitions(
    transitions: Any, available: Available | None = None
) -> CsrArrays:
    """Check a dense P of shape (S, A, S) and return its entries."""
    dense = _checks.float_array(transitions, "transitions")
    shape = dense.shape
    if dense.ndim != 3 or shape[0] != shape[2] or dense.size == 0:
        hint = ""
        if dense.ndim == 3 and shape[0] != shape[1] == shape[2]:
            hint = ": the axes look like (A, S, S); use P.transpose(1, 0, 2)"
        raise ArgumentError(
            "transitions", f"must {_SHAPES}; it has shape {shape}{hint}"
        )
    _checks.require_nonnegative(dense, "transitions")
    dense = _checks.scale_if_single(dense, transitions)
    sums = dense.sum(axis=2)
    if available is not None:
        sums = available.sums(sums)
    _checks.require_sums_to_one(sums, "transitions", _EMPTY_HINT)
    return CsrArrays.from_dense(dense.reshape(-1, dense.shape[2]))


def _check_sparse_transitions(
    transitions: Any, available: Available | None = None
) -> CsrArrays:
    """Check a sparse P of shape (S*A, S) and return its entries."""
    if is_matrix_list(transitions):
        transitions = stack_actions(transitions, "transitions")
    shape = transitions.shape
    if transitions.ndim != 2 or 0 in shape or shape[0] % shape[1]:
        raise ArgumentError("transitions", f"must {_SHAPES}; it has shape {shape}")
    raw = check_csr(transitions, "transitions")
    n_actions = shape[0] // shape[1]
    bad = np.flatnonzero(~(np.isfinite(raw.data) & (raw.data >= 0)))
    if bad.size:
        rule = "nonnegative" if np.isfinite(raw.data[bad[0]]) else "finite"
        where = name_transition(raw, int(bad[0]), n_actions)
        raise ArgumentError(
            "transitions", f"must be {rule}; at {where} it is {raw.data[bad[0]]}"
        )
    matrix = canonical(raw, drop_zeros=True)
    sums = row_sums(matrix)
    if available is not None:
        sums = available.sums(sums.reshape(-1, n_actions)).reshape(-1)
    scale = _checks.scale_sums(sums, transitions)
    if (scale != 1.0).any():
        matrix = csr_on_pattern(matrix, matrix.data / repeat_rows(matrix, scale))
        sums = row_sums(matrix)
        if available is not None:
            sums = available.sums(sums.reshape(-1, n_actions)).reshape(-1)
    _checks.require_sums_to_one(sums.reshape(-1, n_actions), "transitions", _EMPTY_HINT)
    return CsrArrays.from_matrix(matrix)


def _entries_of_transitions(transitions: Any) -> Entries | None:
    """Return the entries of a sparse P that was checked, repeated ones as well."""
    if isinstance(transitions, CsrArrays):
        return None
    if is_matrix_list(transitions):
        transitions = stack_actions(transitions, "transitions")
    if not _checks.is_sparse(transitions):
        return None
    return entries_of(transitions, "transitions")


def check_available(value: object, states: object, actions: object) -> Available:
    """Check which actions can be taken, at least one in each state.

    ``states`` and ``actions`` are names as they were given, for errors alone.
    """
    array = _checks.as_array(value, "available")
    if array.ndim != 2 or array.size == 0:
        raise ArgumentError(
            "available",
            "must have shape (S, A), a row for each state and a column for each action;"
            f" it has shape {array.shape}",
        )
    # masks of environments are integers
    if array.dtype.kind in "iu":
        bad = np.argwhere((array != 0) & (array != 1))
        if len(bad):
            raise ArgumentError(
                _checks.place("available", tuple(bad[0])),
                f"must be True or False; it is {array[tuple(bad[0])]}",
            )
    elif array.dtype.kind != "b":
        raise ArgumentError(
            "available", f"must be True or False; its entries are {array.dtype}"
        )
    mask = array.astype(np.bool_)
    names = Names(
        valid_names(states, mask.shape[0]), valid_names(actions, mask.shape[1])
    )
    lacking = np.flatnonzero(~mask.any(axis=1))
    if lacking.size:
        more = _checks.in_all(lacking.size, "such states")
        raise ArgumentError(
            f"available[{lacking[0]}]",
            f"must have an action that can be taken; state {names.state(lacking[0])} has"
            f" none{more} (a terminal state: an action that leads back to it with reward"
            " 0)",
        )
    return Available(freeze(mask), names)


def check_rewards(
    rewards: Any,
    csr: CsrArrays,
    n_actions: int,
    transitions: object = None,
    available: BoolArray | None = None,
) -> tuple[Array, Array | None, Array | Csr | None]:
    """Check rewards and return r(s, a), r(s, a, s') on the entries of P, and its table.

    r(s, a) = sum_s' P(s' | s, a) r(s, a, s'). In the table a nan, or no entry, means
    undefined; the last two are None where rewards do not depend on s'. ``transitions``
    are those that P was made of, whose repeated entries average those of the rewards.
    Rewards of actions that are not ``available`` are ignored: 0, or undefined.
    """
    n_states = csr.shape[1]
    table: Any
    if is_matrix_list(rewards):
        rewards = stack_actions(rewards, "rewards")
    if _checks.is_sparse(rewards):
        given = _check_sparse_rewards(rewards, csr, n_actions, transitions, available)
        table, data = align_to(given, csr)
    else:
        table = _check_dense_rewards(rewards, n_states, n_actions, available)
        if table.ndim == 1:
            repeated = np.repeat(table[:, None], n_actions, axis=1)
            if available is not None:
                repeated[~available] = 0.0
            return freeze(repeated), None, None
        if table.ndim == 2:
            return table, None, None
        data = _rewards_on_entries(table, csr, n_actions)
    expected = row_sums(csr, csr.data * data).reshape(n_states, n_actions)
    return freeze(expected), data, table


def _check_dense_rewards(
    rewards: Any, n_states: int, n_actions: int, available: BoolArray | None = None
) -> Array:
    """Check dense rewards and return them as a read-only array of 1, 2 or 3 dimensions.

    One of 3 dimensions may have nan.
    """
    array = freeze(
        _checks.float_array(rewards, "rewards", ndim=(1, 2, 3), allow_missing=True)
    )
    shape = (n_states, n_actions, n_states)[: array.ndim]
    if array.shape != shape:
        raise ArgumentError(
            "rewards", f"must have shape {shape}; it has shape {array.shape}"
        )
    if available is not None and array.ndim == 2:
        array = freeze(np.where(available, array, 0.0))
    elif available is not None and array.ndim == 3:
        array = freeze(np.where(available[:, :, None], array, np.nan))
    if array.ndim < 3:
        _checks.require_finite(array, "rewards")
    elif np.isinf(array).any():
        first = tuple(np.argwhere(np.isinf(array))[0])
        raise ArgumentError(
            _checks.place("rewards", first), f"must be finite; it is {array[first]}"
        )
    return array


def _rewards_on_entries(array: Array, csr: CsrArrays, n_actions: int) -> Array:
    """Return a dense r(s, a, s') on the entries of P, where none may be nan."""
    row = row_of_entry(csr)
    data = freeze(array.reshape(csr.shape)[row, csr.indices])
    bad = np.flatnonzero(np.isnan(data))
    if bad.size:
        state, action = divmod(int(row[bad[0]]), n_actions)
        index = (state, action, csr.indices[bad[0]])
        raise ArgumentError(
            _checks.place("rewards", index),
            "must be finite where the transition has a probability; it is nan",
        )
    return data


def _check_sparse_rewards(
    rewards: Any,
    csr: CsrArrays,
    n_actions: int,
    transitions: object,
    available: BoolArray | None = None,
) -> Csr:
    """Check sparse rewards and add a 0 wherever P has an entry and they have none."""
    if rewards.shape != csr.shape:
        raise ArgumentError(
            "rewards",
            f"must have shape {csr.shape} when sparse; it has shape {rewards.shape}",
        )
    given = check_values(
        rewards, "rewards", lambda: _entries_of_transitions(transitions)
    )
    if available is not None:
        given = _drop_rows(given, ~available.reshape(-1))
    bad = np.flatnonzero(~np.isfinite(given.data))
    if bad.size:
        where = name_transition(given, int(bad[0]), n_actions)
        raise ArgumentError(
            "rewards", f"must be finite; at {where} it is {given.data[bad[0]]}"
        )
    absent = ~align(given, csr)[1]
    if not absent.any():
        return given
    rows = np.concatenate([row_of_entry(given), row_of_entry(csr)[absent]])
    columns = np.concatenate([given.indices, csr.indices[absent]])
    data = np.pad(given.data, (0, len(rows) - given.nnz))
    return csr_from_entries(rows, columns, data, csr.shape)


def _drop_rows(matrix: Csr, is_dropped: BoolArray) -> Csr:
    """Return a matrix without the entries of some rows."""
    row = row_of_entry(matrix)
    kept = ~is_dropped[row]
    if kept.all():
        return matrix
    return csr_from_entries(
        row[kept], matrix.indices[kept], matrix.data[kept], matrix.shape
    )


def check_terminal_state(value: object, n_states: int) -> IntArray:
    """Check ``terminal_state`` and return it as (S0,) numbers of states."""
    array = _checks.as_array(value, "terminal_state")
    is_integers = array.ndim == 1 and array.dtype.kind in "iu"
    if not is_integers or not 0 < array.size <= n_states:
        raise ArgumentError(
            "terminal_state",
            f"must be 1 to {n_states} integers; got {array.dtype} of shape"
            f" {array.shape}",
        )
    require_numbers(array, n_states, "terminal_state")
    return array.astype(np.int64)


def require_numbers(values: Any, size: int, name: str, whose: str = "") -> None:
    """Raise an ArgumentError unless all of (n,) integers are in 0..size-1."""
    bad = np.flatnonzero((values < 0) | (values >= size))
    if bad.size:
        raise ArgumentError(
            f"{name}[{bad[0]}]",
            f"must be in 0..{size - 1}{whose}; it is {values[bad[0]]}",
        )


def check_layout(value: Any, n_states: int, name: str = "layout") -> Array:
    """Check coordinates of states and return them as a new (S, c) array.

    They are (S,) or (S, c) finite numbers, or a grid's shape (height, width). In a grid
    state s lies in row s // width, column s % width. A tuple of two integers is a
    grid's shape; of two states it may also be their coordinates, where its product is
    not 2.
    """
    is_pair = isinstance(value, tuple) and len(value) == 2
    if is_pair and all(map(_checks.is_integer, value)):
        height, width = (int(part) for part in value)
        if min(height, width) > 0 and height * width == n_states:
            return freeze(grid_coordinates(n_states, width))
        if n_states != 2:
            raise ArgumentError(
                name,
                f"must be (height, width) with height * width = {n_states}, the number"
                f" of states; it is {value!r:.80}",
            )
    array = _checks.float_array(value, name, ndim=(1, 2))
    if len(array) != n_states or array.size == 0:
        raise ArgumentError(
            name,
            f"must have shape ({n_states},) or ({n_states}, c), a place for each state;"
            f" it has shape {array.shape}",
        )
    _checks.require_finite(array, name)
    return freeze(array.reshape(n_states, -1))


def grid_coordinates(n_states: int, width: int) -> Array:
    """Return the (S, 2) row and column of each cell of a grid."""
    row_and_column = np.divmod(np.arange(n_states), width)
    return np.stack(row_and_column, axis=1).astype(np.float64)
