"""Sums over the transitions of each (s, a, s', terminated), in the order of first rows.

Of the transitions i of each, and of their rewards, there are the number n, and the sum,
least, largest and number m::

    n += n_i
    total += total_i
    least = min(least, least_i)
    largest = max(largest, largest_i)
    m += m_i

A row i is a transition (n_i = 1) or itself such a sum. nan is a least or largest of no
reward.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._sparse import canonical
from oee_tabular.data.rules import KEY, MOVE
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import source_of_row
from oee_tabular.typing import Array, Column, Csr, IntArray

COUNTED = ("count", "reward_sum", "reward_min", "reward_max", "reward_count")
MAX_UNJOINED_ENTRIES = 2**20  # of later parts, before they are joined to the first


class RowSums(NamedTuple):
    """Hold the number of transitions of each row, and the sums of their rewards.

    Attributes
    ----------
    number : ndarray of shape (n,)
        The number of transitions that each row stands for.
    reward_sum : ndarray of shape (n,), or None
        The sum of their rewards.
    reward_min : ndarray of shape (n,), or None
        The least of their rewards.
    reward_max : ndarray of shape (n,), or None
        The largest of their rewards.
    reward_count : ndarray of shape (n,), or None
        The number of them that have a reward.
    """

    number: Array
    reward_sum: Array | None
    reward_min: Array | None
    reward_max: Array | None
    reward_count: Array | None  # of the transitions that have a reward

    @classmethod
    def of_transitions(cls, n: int, reward: Array | None) -> RowSums:
        """Return the sums of n rows that are a transition each, nan as no reward."""
        if reward is None:
            return cls(np.ones(n), None, None, None, None)
        is_paid = ~np.isnan(reward)
        return cls(
            np.ones(n),
            np.where(is_paid, reward, 0.0),
            reward,
            reward,
            is_paid.astype(np.float64),
        )


def sum_rows(columns: Mapping[str, Column]) -> dict[str, Column]:
    """Sum the rows of each (s, a, s', terminated) in the order of their first rows.

    The rows are transitions, as the columns of a log, or sums.
    """
    import pandas as pd

    n = len(columns["state"])
    key = [np.asarray(columns.get(label, np.zeros(n)), dtype=np.int64) for label in KEY]
    if "count" in columns:
        rewards = (columns.get(label) for label in COUNTED[1:])
        rows = RowSums(columns["count"], *rewards)
    else:
        rows = RowSums.of_transitions(n, columns.get("reward"))
    # by hash, in a third of the time of a sort
    entry, different = pd.factorize(_encode(key))
    row = np.zeros(len(different), dtype=np.int64)
    row[entry] = np.arange(n)  # one that has the key
    sums = np.zeros((len(COUNTED), len(different)))
    sums[2:4] = np.nan
    operations = (np.add, np.add, np.fmin, np.fmax, np.add)
    with np.errstate(over="ignore"):  # which counts refuse
        for total, operation, column in zip(sums, operations, rows, strict=True):
            if column is not None:
                operation.at(total, entry, column)
    values = [*(part[row] for part in key), *sums]
    return dict(zip((*KEY, *COUNTED), values, strict=True))


def _encode(key: list[IntArray]) -> IntArray:
    """Encode the rows of a key as numbers in the same order.

    Parts are numbered anew where 64 bits do not hold them.
    """
    code = np.zeros(len(key[0]), dtype=np.int64)
    size = 1
    for part in key:
        if size * (int(part.max()) + 1) >= 2**63:
            code = np.unique(code, return_inverse=True)[1]
            part = np.unique(part, return_inverse=True)[1]
            size = int(code.max()) + 1
        n_values = int(part.max()) + 1
        code = code * n_values + part
        size = size * n_values
    return code


def add_sums(parts: list[dict[str, Column]], columns: Mapping[str, Column]) -> None:
    """Append the sums of ``columns`` to ``parts``.

    Parts are joined when the later are as long as the first, so that all take O(n log
    n).
    """
    if len(columns["state"]):
        parts.append(sum_rows(columns))
        n_later = sum(len(part["count"]) for part in parts[1:])
        if n_later > max(len(parts[0]["count"]), MAX_UNJOINED_ENTRIES):
            parts[:] = [join_sums(parts)]


def join_sums(parts: Sequence[Mapping[str, Column]]) -> dict[str, Column]:
    """Return the sums of all parts, added in their order."""
    columns = {}
    for label in parts[0]:
        columns[label] = np.concatenate([part[label] for part in parts])
    return sum_rows(columns)


def counts_of(log: Any, weights: Array, n_states: int, n_actions: int) -> Csr:
    """Sum the weights of the rows of each (s, a, s') to a csr of shape (S*A, S).

    Raises an ArgumentError for numbers out of range.
    """
    _checks.positive_integer(n_states, "n_states")
    _checks.positive_integer(n_actions, "n_actions")
    _checks.require_memory(
        float(n_states) * n_actions, "n_states * n_actions", n_states * n_actions
    )
    for name, given in zip(MOVE, ("n_states", "n_actions", "n_states"), strict=True):
        column = getattr(log, name)
        limit = n_actions if name == "action" else n_states
        bad = np.flatnonzero(column >= limit)
        if bad.size:
            raise ArgumentError(
                f"log.{name}[{bad[0]}]{source_of_row(log, int(bad[0]))}",
                f"must be in 0..{limit - 1}; it is {column[bad[0]]} ({bad.size} such"
                f" rows in all; {given} is {limit})",
            )
    rows = log.state * n_actions + log.action
    matrix = sparse.csr_array(
        (weights, (rows, log.next_state)), shape=(n_states * n_actions, n_states)
    )
    return canonical(matrix, drop_zeros=True)
