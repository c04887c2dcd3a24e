"""Sums over the transitions of each (s, a, s', ended): a table by hash that grows, rows added in their order.

Each entry has the number n of its transitions, the number m of those with a reward, and of the rewards sum, least and largest::

    n += n_i,  m += m_i,  total += total_i,  least = min(least, least_i),  largest = max(largest, largest_i)

A row i is a transition (n_i = 1) or itself an entry of another table. nan is a least or largest of no reward.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular._checks import Array, IntArray

LEAST_SIZE = 2**12  # slots of an empty table


class Sums:
    """Entries ``key`` (K, 4): s, a, s', ended, in the order in which they came, and ``sums`` (K, 5) as above."""

    def __init__(self) -> None:
        self.size = 0
        self.slots = np.full(LEAST_SIZE, -1, dtype=np.int64)
        self.key, self.sums = np.zeros((LEAST_SIZE // 2, 4), dtype=np.int64), np.zeros((LEAST_SIZE // 2, 5))

    def add_rows(self, columns: dict[str, Any]) -> None:
        """Add transitions: state, action, next_state, and where there are any terminated and reward."""
        from oee_tabular.data import _sums  # numba is not imported before something is summed

        n = len(columns["state"])
        ended = columns["terminated"] if "terminated" in columns else np.zeros(n, dtype=np.bool_)
        reward = columns["reward"] if "reward" in columns else np.full(n, np.nan)
        key = [np.asarray(columns[label], dtype=np.int64) for label in ("state", "action", "next_state")]
        self._add(_sums.add_transitions, (*key, ended, reward), n)

    def add(self, key: IntArray, sums: Array) -> None:
        """Add entries, (n, 4) and (n, 5)."""
        from oee_tabular.data import _sums

        self._add(_sums.add_entries, (key, sums), len(key))

    @np.errstate(over="ignore")  # of hashes, where kernels are not compiled
    def _add(self, kernel: Any, rows: tuple[Any, ...], n: int) -> None:
        """Add n rows, in a table of twice the size whenever the old one is half full."""
        from oee_tabular.data import _sums

        done, self.size = kernel(*rows, 0, self.slots, self.key, self.sums, self.size)
        while done < n:
            key, sums, size = self.key[: self.size], self.sums[: self.size], 2 * len(self.slots)
            self.slots = np.full(size, -1, dtype=np.int64)
            self.key, self.sums = np.zeros((size // 2, 4), dtype=np.int64), np.zeros((size // 2, 5))
            _sums.add_entries(key, sums, 0, self.slots, self.key, self.sums, 0)
            done, self.size = kernel(*rows, done, self.slots, self.key, self.sums, self.size)

    def entries(self) -> tuple[IntArray, Array]:
        """The entries, in the order in which they came."""
        return self.key[: self.size], self.sums[: self.size]
