"""Kernel of ``sums.py``: rows added to a table by hash, with open addressing."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def add_rows(rows, values, start, slots, key, sums, size):  # type: ignore[no-untyped-def]
    """Add rows from ``start`` on until the table is half full; where it stopped, and the number of entries.

    ``rows``: s, a, s', ended; ``values``: as in ``sums``, (n,) each. ``slots``: the entry at each place, -1 where it is free.
    """
    state, action, next_state, ended = rows
    number, total, least, largest, paid = values
    mask = len(slots) - 1
    for i in range(start, len(state)):
        s, a, s2, e = state[i], action[i], next_state[i], ended[i]
        h = np.uint64(s) * np.uint64(0x9E3779B97F4A7C15)
        h = (h ^ (h >> np.uint64(32)) ^ np.uint64(a)) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(32)) ^ np.uint64(s2)) * np.uint64(0x94D049BB133111EB)
        h ^= (h >> np.uint64(32)) ^ np.uint64(e)
        slot = np.int64(h & np.uint64(mask))
        k = slots[slot]
        while k >= 0 and not (key[k, 0] == s and key[k, 1] == a and key[k, 2] == s2 and key[k, 3] == e):
            slot = (slot + 1) & mask
            k = slots[slot]
        if k < 0:
            if size == len(key):
                return i, size
            k = slots[slot] = size
            key[k, 0], key[k, 1], key[k, 2], key[k, 3] = s, a, s2, e
            sums[k, 2] = sums[k, 3] = np.nan
            size += 1
        sums[k, 0] += number[i]
        if paid[i] > 0:
            sums[k, 1] += total[i]
            if not least[i] >= sums[k, 2]:
                sums[k, 2] = least[i]
            if not largest[i] <= sums[k, 3]:
                sums[k, 3] = largest[i]
            sums[k, 4] += paid[i]
    return len(state), size
