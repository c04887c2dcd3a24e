"""Kernel of ``sums.py``: keys found in a table by hash, with open addressing."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def find_entries(state, action, next_state, ended, start, slots, key, size, entry):  # type: ignore[no-untyped-def]
    """Find the ``entry`` of each row from ``start`` on, a new one where there is none, until the table is half full.

    ``slots``: the entry at each place, -1 where it is free. Returns where it stopped and the number of entries.
    """
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
            size += 1
        entry[i] = k
    return len(state), size
