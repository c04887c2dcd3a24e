"""The arrays that an MDP is made of, checked and made sparse rows; and, for intervals, the samples that it was made of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import align, canonical, check_csr, csr_from_parts, find, row_of_entry, row_sums
from oee_tabular.mdp.naming import NAMELESS, Names


def name_move(matrix: sparse.csr_array, entry: int, n_actions: int, names: Names = NAMELESS) -> str:
    """``s=3, a=1 -> s'=7`` for a stored entry of a matrix with rows s*A + a; names in place of numbers where there are some."""
    row = int(np.searchsorted(matrix.indptr, entry, side="right")) - 1
    return names.transition(*divmod(row, n_actions), matrix.indices[entry])


def transition_rows(transitions: Any) -> tuple[sparse.csr_array, int, int]:
    """Checked rows, number of states, number of actions; sums are named transitions[s, a]."""
    if sparse.issparse(transitions):
        if transitions.ndim != 2 or transitions.shape[1] == 0 or transitions.shape[0] % transitions.shape[1]:
            raise ValueError(f"transitions must have shape (S*A, S) when sparse; it has shape {transitions.shape}")
        n_states = int(transitions.shape[1])
        rows = check_csr(transitions, "transitions")
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
    given = canonical(check_csr(rewards, "rewards"), drop_zeros=False)
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
    if isinstance(value, tuple) and len(value) == 2 and all(_checks.is_integer(part) for part in value):
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


KEY = "sampling_"


class Sampling(NamedTuple):
    """Samples behind an MDP.

    ``pairs`` (S*A,): of each (s, a), inf where nothing was to be learned (the task is over), 0 where none was taken and the row
    was filled in. ``starts``: first states that were met, inf where the law of the start was given. ``reward_error``: the
    variance of the mean reward of each move, None where rewards were given.
    """

    pairs: Array
    starts: float
    reward_error: sparse.csr_array | None

    def without_rewards(self) -> Sampling:
        """Of an MDP whose rewards were given."""
        return self._replace(reward_error=None)

    def mixed(self, n_actions: int) -> Sampling:
        """Of an MDP whose actions are mixed: each row rests on the least of them."""
        least = self.pairs.reshape(-1, n_actions).min(axis=1)
        return self._replace(pairs=np.repeat(least, n_actions))

    def arrays(self) -> dict[str, Any]:
        """What a file holds."""
        found: dict[str, object] = {f"{KEY}pairs": self.pairs, f"{KEY}starts": np.array(self.starts)}
        if self.reward_error is not None:
            found |= {f"{KEY}error_{part}": getattr(self.reward_error, part) for part in ("data", "indices", "indptr")}
        return found


def stored_sampling(arrays: Mapping[str, object], shape: tuple[int, int]) -> Sampling | None:
    """The one of a file, None where it has none."""
    if f"{KEY}pairs" not in arrays:
        return None
    pairs = _checks.float_array(arrays[f"{KEY}pairs"], f"{KEY}pairs", ndim=1)
    starts = float(_checks.float_array(arrays[f"{KEY}starts"], f"{KEY}starts", ndim=0))
    if pairs.shape != shape[:1] or not (pairs >= 0).all() or not starts > 0:
        raise ValueError(f"{KEY}pairs must be {shape[0]} numbers of samples, and {KEY}starts positive")
    error = None
    if f"{KEY}error_data" in arrays:
        data, indices, indptr = (arrays[f"{KEY}error_{part}"] for part in ("data", "indices", "indptr"))
        error = csr_from_parts(data, indices, indptr, shape, f"{KEY}error")
    return Sampling(pairs, starts, error)


def sampling_of(
    columns: tuple[IntArray, IntArray, IntArray, BoolArray], reward: Array | None, starts: float, terminal: IntArray,
    shape: tuple[int, int],
) -> Sampling:  # fmt: skip
    """Of samples (state, action, next state, whether terminated) in an MDP of that shape; None: no rewards among them.

    The variance of a mean of k rewards is s^2 / k, s^2 the move's own, or that of all moves together where k = 1.
    """
    state, action, following, terminated = columns
    n_states = shape[1]
    n_actions = shape[0] // n_states
    row = state * n_actions + action
    pairs = np.bincount(row, minlength=shape[0]).astype(np.float64)
    over = np.zeros(n_states, dtype=np.bool_)
    over[terminal[following[terminated]]] = True
    over[state] = False
    pairs[np.repeat(over, n_actions)] = np.inf
    if reward is None:
        return Sampling(pairs, starts, None)
    to = np.where(terminated, terminal[following], following)
    number, total, squares = (canonical_table(row, to, w, shape) for w in (np.ones(len(row)), reward, reward**2))
    apart = np.maximum(squares.data - total.data**2 / number.data, 0.0)
    free = float((number.data - 1.0).sum())
    pooled = float(apart.sum()) / free if free else 0.0
    own = np.where(number.data > 1, apart / np.maximum(number.data - 1.0, 1.0), pooled) / number.data
    return Sampling(pairs, starts, sparse.csr_array((own, number.indices, number.indptr), shape))
