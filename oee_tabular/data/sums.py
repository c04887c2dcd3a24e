"""Sums over the transitions of each (s, a, s', ended): a table by hash that grows, rows added in their order.

Each entry has the number n of its transitions, the number m of those with a reward, and of the rewards sum, least and largest::

    n += n_i,  m += m_i,  total += total_i,  least = min(least, least_i),  largest = max(largest, largest_i)

A row i is a transition (n_i = 1) or itself an entry of another table. nan is a least or largest of no reward.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

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
        n = len(columns["state"])
        ended = columns["terminated"] if "terminated" in columns else np.zeros(n, dtype=np.bool_)
        reward = columns["reward"] if "reward" in columns else np.full(n, np.nan)
        key = [np.asarray(columns[label], dtype=np.int64) for label in ("state", "action", "next_state")]
        self._add(_add_transitions, (*key, ended, reward), n)

    def add(self, key: IntArray, sums: Array) -> None:
        """Add entries, (n, 4) and (n, 5)."""
        self._add(_add_entries, (key, sums), len(key))

    @np.errstate(over="ignore")  # of hashes, where kernels are not compiled
    def _add(self, kernel: Any, rows: tuple[Any, ...], n: int) -> None:
        """Add n rows, in a table of twice the size whenever the old one is half full."""
        done, self.size = kernel(*rows, 0, self.slots, self.key, self.sums, self.size)
        while done < n:
            key, sums, size = self.key[: self.size], self.sums[: self.size], 2 * len(self.slots)
            self.slots = np.full(size, -1, dtype=np.int64)
            self.key, self.sums = np.zeros((size // 2, 4), dtype=np.int64), np.zeros((size // 2, 5))
            _add_entries(key, sums, 0, self.slots, self.key, self.sums, 0)
            done, self.size = kernel(*rows, done, self.slots, self.key, self.sums, self.size)

    def entries(self) -> tuple[IntArray, Array]:
        """The entries, in the order in which they came."""
        return self.key[: self.size], self.sums[: self.size]


@njit(cache=True, nogil=True)
def _find(s, a, s2, ended, slots, key):  # type: ignore[no-untyped-def]
    """The slot of (s, a, s', ended): its own, or the free one where it belongs."""
    mask = len(slots) - 1
    h = np.uint64(s) * np.uint64(0x9E3779B97F4A7C15)
    h = (h ^ (h >> np.uint64(32)) ^ np.uint64(a)) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(32)) ^ np.uint64(s2)) * np.uint64(0x94D049BB133111EB)
    h ^= (h >> np.uint64(32)) ^ np.uint64(ended)
    slot = np.int64(h & np.uint64(mask))
    k = slots[slot]
    while k >= 0 and not (key[k, 0] == s and key[k, 1] == a and key[k, 2] == s2 and key[k, 3] == ended):
        slot = (slot + 1) & mask
        k = slots[slot]
    return slot


@njit(cache=True, nogil=True)
def _add_transitions(state, action, next_state, ended, reward, start, slots, key, sums, size):  # type: ignore[no-untyped-def]
    """Add transitions from ``start`` on until the table is half full; where it stopped, and the number of entries."""
    for i in range(start, len(state)):
        slot = _find(state[i], action[i], next_state[i], ended[i], slots, key)
        k = slots[slot]
        if k < 0:
            if size == len(key):
                return i, size
            k = slots[slot] = size
            key[k, 0], key[k, 1], key[k, 2], key[k, 3] = state[i], action[i], next_state[i], ended[i]
            sums[k, 3] = sums[k, 4] = np.nan
            size += 1
        sums[k, 0] += 1
        r = reward[i]
        if not np.isnan(r):
            sums[k, 1] += 1
            sums[k, 2] += r
            if not r >= sums[k, 3]:
                sums[k, 3] = r
            if not r <= sums[k, 4]:
                sums[k, 4] = r
    return len(state), size


@njit(cache=True, nogil=True)
def _add_entries(more, more_sums, start, slots, key, sums, size):  # type: ignore[no-untyped-def]
    """The same of the entries of another table."""
    for i in range(start, len(more)):
        slot = _find(more[i, 0], more[i, 1], more[i, 2], more[i, 3], slots, key)
        k = slots[slot]
        if k < 0:
            if size == len(key):
                return i, size
            k = slots[slot] = size
            key[k] = more[i]
            sums[k] = more_sums[i]
            size += 1
            continue
        sums[k, :3] += more_sums[i, :3]
        sums[k, 3] = np.fmin(sums[k, 3], more_sums[i, 3])
        sums[k, 4] = np.fmax(sums[k, 4], more_sums[i, 4])
    return len(more), size
