"""The arrays that an MDP is made of, checked and made sparse rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import align, canonical, checked, find, row_of_entry, row_sums
from oee_tabular.mdp.naming import NAMELESS, Names


def name_move(matrix: sparse.csr_array, entry: int, n_actions: int, names: Names = NAMELESS) -> str:
    """``s=3, a=1 -> s'=7`` for a stored entry of a matrix with rows s*A + a; names in place of numbers where there are some."""
    row = int(np.searchsorted(matrix.indptr, entry, side="right")) - 1
    return names.move(*divmod(row, n_actions), matrix.indices[entry])


def transition_rows(transitions: Any) -> tuple[sparse.csr_array, int, int]:
    """Checked rows, number of states, number of actions; sums are named transitions[s, a]."""
    if sparse.issparse(transitions):
        if transitions.ndim != 2 or transitions.shape[1] == 0 or transitions.shape[0] % transitions.shape[1]:
            raise ValueError(f"transitions must have shape (S*A, S) when sparse; it has shape {transitions.shape}")
        n_states = int(transitions.shape[1])
        rows = checked(transitions, "transitions")
    else:
        dense = _checks.float_array(transitions, "transitions")
        if dense.ndim != 3:
            raise ValueError(
                f"transitions must have shape (S, A, S), or (S*A, S) as a scipy.sparse array; it has shape {dense.shape}"
            )
        if dense.shape[0] != dense.shape[2]:
            raise ValueError(f"transitions must have shape (S, A, S); it has shape {dense.shape}")
        _checks.require_nonnegative(dense, "transitions")
        dense = _checks.scaled_if_single(dense, transitions)
        n_states = dense.shape[0]
        rows = dense.reshape(dense.shape[0] * dense.shape[1], n_states)
    if n_states == 0 or rows.shape[0] == 0:
        raise ValueError(f"transitions must have at least one state and one action; it has shape {transitions.shape}")
    n_actions = rows.shape[0] // n_states
    raw = sparse.csr_array(rows, dtype=np.float64)
    bad = np.flatnonzero(~(np.isfinite(raw.data) & (raw.data >= 0)))
    if bad.size:
        rule = "nonnegative" if np.isfinite(raw.data[bad[0]]) else "finite"
        where = name_move(raw, int(bad[0]), n_actions)
        raise ValueError(f"transitions must be {rule}; at {where} it is {raw.data[bad[0]]}")
    matrix = canonical(raw, drop_zeros=True)
    _checks.require_sums_to_one(row_sums(matrix).reshape(n_states, n_actions), "transitions")
    return matrix, n_states, n_actions


def reward_table(
    rewards: Any, matrix: sparse.csr_array, n_states: int, n_actions: int
) -> tuple[sparse.csr_array | None, Array]:
    """The csr of r(s, a, s') where it is defined (None for r(s, a)), and r(s, a)."""
    if not sparse.issparse(rewards):
        array = _checks.float_array(rewards, "rewards", ndim=(1, 2, 3))
        shapes = {1: (n_states,), 2: (n_states, n_actions), 3: (n_states, n_actions, n_states)}
        if array.shape != shapes[array.ndim]:
            raise ValueError(f"rewards must have shape {shapes[array.ndim]}; it has shape {array.shape}")
        if array.ndim < 3:
            _checks.require_finite(array, "rewards")
            expected = np.broadcast_to(array.reshape(n_states, -1), (n_states, n_actions)).copy()
            return None, expected
        if np.isinf(array).any():
            first = tuple(np.argwhere(np.isinf(array))[0])
            raise ValueError(f"{_checks.place('rewards', first)} must be finite; it is {array[first]}")
        flat = array.reshape(-1, n_states)
        on_support = find(matrix, *(index.astype(np.int64) for index in np.nonzero(np.isnan(flat))))[1]
        if on_support.any():
            row, column = (int(index[on_support][0]) for index in np.nonzero(np.isnan(flat)))
            where = _checks.place("rewards", (row // n_actions, row % n_actions, column))
            raise ValueError(f"{where} must be finite where the transition has a probability; it is nan")
        rows, columns = np.nonzero(~np.isnan(flat))
        return canonical_table(rows, columns, flat[rows, columns], flat.shape), np.empty(0)
    if rewards.shape != (n_states * n_actions, n_states):
        raise ValueError(
            f"rewards must have shape {(n_states * n_actions, n_states)} when sparse; it has shape {rewards.shape}"
        )
    given = canonical(checked(rewards, "rewards"), drop_zeros=False)
    bad = np.flatnonzero(~np.isfinite(given.data))
    if bad.size:
        where = name_move(given, int(bad[0]), n_actions)
        raise ValueError(f"rewards must be finite; at {where} it is {given.data[bad[0]]}")
    _, stored = align(given, matrix)
    if stored.all():
        return given, np.empty(0)
    rows = np.concatenate([row_of_entry(given), row_of_entry(matrix)[~stored]])
    columns = np.concatenate([given.indices, matrix.indices[~stored]])
    data = np.concatenate([given.data, np.zeros(int((~stored).sum()))])
    return canonical_table(rows, columns, data, given.shape), np.empty(0)


def stored_shape(stored: Any) -> tuple[int, int]:
    """(S*A, S) from the (S, A) of a file."""
    if stored.shape != (2,) or stored.dtype.kind not in "iu" or stored.min() < 1:
        raise ValueError(f"shape must be two positive integers, states and actions; it is {stored.tolist()!r:.80}")
    n_states, n_actions = stored.tolist()
    return n_states * n_actions, n_states


def canonical_table(rows: object, columns: object, data: Array, shape: tuple[int, int]) -> sparse.csr_array:
    """A CSR with exactly these entries, explicit zeros included."""
    return canonical(sparse.csr_array((data, (rows, columns)), shape=shape), drop_zeros=False)


def terminal_states(value: object, n_states: int) -> IntArray:
    """(S0,) numbers of states, checked."""
    array = _checks.as_array(value, "terminal_state")
    if array.ndim != 1 or array.dtype.kind not in "iu" or not 0 < array.size <= n_states:
        raise ValueError(f"terminal_state must be 1 to {n_states} integers; got {array.dtype} of shape {array.shape}")
    bad = np.flatnonzero((array < 0) | (array >= n_states))
    if bad.size:
        raise ValueError(f"terminal_state[{bad[0]}] must be in 0..{n_states - 1}; it is {array[bad[0]]}")
    return array.astype(np.int64)


def check_layout(value: object, n_states: int, name: str = "layout") -> Array:
    """``value`` as a new (S, c) array that is not writable: (S,) or (S, c) finite numbers, or the tuple (height, width).

    A tuple of two integers is a grid's shape: state s lies in row s // width, column s % width. Of two states it may also be
    their places, where its product is not 2.
    """
    if isinstance(value, tuple) and len(value) == 2 and all(_is_integer(part) for part in value):
        height, width = (int(part) for part in value)
        if min(height, width) > 0 and height * width == n_states:
            return _checks.freeze(np.stack(np.divmod(np.arange(n_states), width), axis=1).astype(np.float64))
        if n_states != 2:
            raise ValueError(
                f"{name} must be (height, width) with height * width = {n_states}, the number of states; it is {value!r:.80}"
            )
    array = _checks.float_array(value, name, ndim=(1, 2))
    if len(array) != n_states or array.size == 0:
        raise ValueError(
            f"{name} must have shape ({n_states},) or ({n_states}, c), a place for each state; it has shape {array.shape}"
        )
    _checks.require_finite(array, name)
    return _checks.freeze(array.reshape(n_states, -1))


def _is_integer(part: object) -> bool:
    return isinstance(part, int | np.integer) and not isinstance(part, bool)
