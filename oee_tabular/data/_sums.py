"""Kernels of ``sums.py``: rows added to a table by hash, with open addressing."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def find(s, a, s2, ended, slots, key):  # type: ignore[no-untyped-def]
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
def add_transitions(state, action, next_state, ended, reward, start, slots, key, sums, size):  # type: ignore[no-untyped-def]
    """Add transitions from ``start`` on until the table is half full; where it stopped, and the number of entries."""
    for i in range(start, len(state)):
        slot = find(state[i], action[i], next_state[i], ended[i], slots, key)
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
def add_entries(more, more_sums, start, slots, key, sums, size):  # type: ignore[no-untyped-def]
    """The same of the entries of another table."""
    for i in range(start, len(more)):
        slot = find(more[i, 0], more[i, 1], more[i, 2], more[i, 3], slots, key)
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
