"""The moves (s, a, s') of a log, counted: what rows stand for, sums over each move, how many are different."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import canonical

SPARE = 8  # bytes of a table that counts, for each byte of the column: beyond it the column is sorted


class Moves(NamedTuple):
    """Of each row of a log: how many transitions it stands for, and of their rewards the sum, least, largest and number."""

    number: Array
    reward_sum: Array | None
    reward_min: Array | None
    reward_max: Array | None
    reward_count: Array | None  # of the transitions that have a reward


def counts_of(log: Any, weights: Array, n_states: int, n_actions: int) -> sparse.csr_array:
    """The sums of the weights of the rows of each (s, a, s'): csr of shape (S*A, S); ValueError for numbers out of range."""
    _checks.positive_integer(n_states, "n_states")
    _checks.positive_integer(n_actions, "n_actions")
    _checks.require_memory(float(n_states) * n_actions, "n_states * n_actions", n_states * n_actions)
    for name, column, limit in (
        ("state", log.state, n_states),
        ("action", log.action, n_actions),
        ("next_state", log.next_state, n_states),
    ):
        bad = np.flatnonzero(column >= limit)
        if bad.size:
            given = "n_actions" if name == "action" else "n_states"
            raise ValueError(
                f"log.{name}[{bad[0]}] must be in 0..{limit - 1}; it is {column[bad[0]]} ({bad.size} such rows in all; "
                f"{given} is {limit})"
            )
    rows = log.state * n_actions + log.action
    matrix = sparse.csr_array((weights, (rows, log.next_state)), shape=(n_states * n_actions, n_states))
    return canonical(matrix, drop_zeros=True)


def numbered_pairs(state: IntArray, action: IntArray) -> IntArray:
    """One number for each different (s, a)."""
    width = int(action.max()) + 1
    if int(state.max()) < (_checks.LARGEST_INTEGER - width) // width:
        return state * width + action
    return np.unique(np.stack([state, action]), axis=1, return_inverse=True)[1].reshape(-1).astype(np.int64)


def distinct(numbers: IntArray) -> int:
    """How many different numbers there are: by a table where it is not much larger than the column, else by a sort.

    Measured at 10^7 numbers below 10^4, CPU time: the table takes 1/17 of the time of the sort.
    """
    if int(numbers.max()) < SPARE * len(numbers):
        seen = np.zeros(int(numbers.max()) + 1, dtype=np.bool_)
        seen[numbers] = True
        return int(seen.sum())
    return len(np.unique(numbers))
