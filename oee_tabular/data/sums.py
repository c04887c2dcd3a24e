"""Sums over the transitions of each (s, a, s', ended): a table by hash that grows, rows added in their order.

Each entry has the number n of its transitions, and of their rewards the sum, least, largest and number m::

    n += n_i,  total += total_i,  least = min(least, least_i),  largest = max(largest, largest_i),  m += m_i

A row i is a transition (n_i = 1) or itself an entry of another table. nan is a least or largest of no reward.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, Column, IntArray
from oee_tabular._sparse import canonical
from oee_tabular.data.labels import MOVE

KEY = (*MOVE, "terminated")
COUNTED = ("count", "reward_sum", "reward_min", "reward_max", "reward_count")
LEAST_SIZE = 2**12  # slots of an empty table


class RowSums(NamedTuple):
    """Of each row of a log: how many transitions it stands for, and of their rewards the sum, least, largest and number."""

    number: Array
    reward_sum: Array | None
    reward_min: Array | None
    reward_max: Array | None
    reward_count: Array | None  # of the transitions that have a reward

    @classmethod
    def of_transitions(cls, n: int, reward: Array | None) -> RowSums:
        """The sums of n rows that are a transition each; a reward that is nan is none."""
        if reward is None:
            return cls(np.ones(n), None, None, None, None)
        is_paid = ~np.isnan(reward)
        return cls(np.ones(n), np.where(is_paid, reward, 0.0), reward, reward, is_paid.astype(np.float64))


class Sums:
    """Entries in the order in which they came: ``key`` (K, 4), s, a, s', ended, and ``sums`` (5, K), those of ``RowSums``."""

    def __init__(self, n_slots: int = LEAST_SIZE) -> None:
        self.size = 0
        self.slots = np.full(n_slots, -1, dtype=np.int64)
        self.key = np.zeros((n_slots // 2, 4), dtype=np.int64)
        self.sums = np.zeros((5, n_slots // 2))
        self.sums[2:4] = np.nan

    def add(self, columns: Mapping[str, Column]) -> None:
        """Add transitions, as the columns of a log, or what ``entries`` of another table gives."""
        n = len(columns["state"])
        entry = self._find_entries([columns.get(label, np.zeros(n, dtype=np.int64)) for label in KEY])
        if "count" in columns:
            rows = RowSums(*(columns.get(label) for label in COUNTED))  # type: ignore[arg-type]
        else:
            rows = RowSums.of_transitions(n, columns.get("reward"))
        for total, add, values in zip(self.sums, (np.add, np.add, np.fmin, np.fmax, np.add), rows, strict=True):
            if values is not None:
                add.at(total, entry, values)

    @np.errstate(over="ignore")  # of hashes, where kernels are not compiled
    def _find_entries(self, columns: list[Column]) -> IntArray:
        """The entry of each row; the table grows to twice its size whenever it is half full."""
        from oee_tabular.data import _sums  # numba is not imported before something is summed

        find_entries: Any = _sums.find_entries
        key = [np.require(column, np.int64, ("C", "W")) for column in columns]
        entry = np.zeros(len(key[0]), dtype=np.int64)
        done, self.size = find_entries(*key, 0, self.slots, self.key, self.size, entry)
        while done < len(entry):
            larger = Sums(2 * len(self.slots))
            larger.add(self.entries())
            self.slots, self.key, self.sums = larger.slots, larger.key, larger.sums
            done, self.size = find_entries(*key, done, self.slots, self.key, self.size, entry)
        return entry

    def entries(self) -> dict[str, Column]:
        """The entries as columns."""
        return dict(zip((*KEY, *COUNTED), (*self.key[: self.size].T, *self.sums[:, : self.size]), strict=True))


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
