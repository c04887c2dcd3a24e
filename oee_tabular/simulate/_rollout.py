"""Sampling with counter-based random numbers, so that every trajectory has its own stream.

Philox4x32-10 [1] keyed by the seed, its counter made of (trajectory, step): the same bits for any number of threads and
any order of work. Each call gives 128 bits: two uniform numbers of 53 bits, which invert running sums, for logs; four words
of 32 bits for ``lanes``.

Until the loops are compiled, Python walks the same episodes, with the numbers of many steps drawn at once by numpy.

Reference: [1] Salmon, Moraes, Dror and Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011.
"""

import numpy as np
from numba import njit

_LOW = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_UNIT = 1.0 / 9007199254740992.0  # 2**-53
_DROP = np.uint64(11)
_BLOCK = 64  # episodes, and steps of them, whose numbers numpy draws at once


# inlined by numba: a call inside the loop over lanes would keep LLVM from vectorising it (3 ns instead of 10)
@njit(cache=True, inline="always")
def philox(c0, c1, c2, c3, k0, k1):
    """Ten rounds of Philox4x32 on 32-bit words held in uint64 (only the low 32 bits of what is between them count)."""
    for _ in range(10):
        p0 = _M0 * (c0 & _LOW)
        p1 = _M1 * (c2 & _LOW)
        c0, c1, c2, c3 = (p1 >> _SHIFT) ^ c1 ^ k0, p1, (p0 >> _SHIFT) ^ c3 ^ k1, p0
        k0 = k0 + _W0
        k1 = k1 + _W1
    return c0 & _LOW, c1 & _LOW, c2 & _LOW, c3 & _LOW


@njit(cache=True)
def uniforms(key, trajectory, step):
    """Two numbers in [0, 1) that belong to (key, trajectory, step)."""
    t, s = np.uint64(trajectory), np.uint64(step)
    x0, x1, x2, x3 = philox(s & _LOW, s >> _SHIFT, t & _LOW, t >> _SHIFT, key & _LOW, key >> _SHIFT)
    first = np.float64(((x1 << _SHIFT) | x0) >> _DROP) * _UNIT
    second = np.float64(((x3 << _SHIFT) | x2) >> _DROP) * _UNIT
    return first, second


@njit(cache=True)
def running_sums(data, indptr):
    """Sums of ``data`` from the beginning of each row up to each entry, each row by itself."""
    total = data.copy()
    for row in range(len(indptr) - 1):
        for k in range(indptr[row] + 1, indptr[row + 1]):
            total[k] += total[k - 1]
    return total


@njit(cache=True)
def pick(cumulative, low, high, u):
    """The first position in [low, high) whose running sum exceeds u times the total (so zero entries are never picked)."""
    target = u * cumulative[high - 1]
    while low < high - 1:
        middle = (low + high - 1) // 2
        if cumulative[middle] > target:
            high = middle + 1
        else:
            low = middle + 1
    return low


@njit(cache=True, nogil=True)
def episode_lengths(key, n, horizon, initial, policy, indptr, indices, cumulative, over):
    """The number of steps of each of n episodes: up to the horizon, or to the first state that is over."""
    n_states, n_actions = policy.shape
    flat = policy.reshape(-1)
    lengths = np.empty(n, dtype=np.int64)
    for i in range(n):
        u, _ = uniforms(key, i, 0)
        state = pick(initial, 0, n_states, u)
        t = 0
        while t < horizon:
            u, v = uniforms(key, i, t + 1)
            row = pick(flat, state * n_actions, (state + 1) * n_actions, u)
            state = indices[pick(cumulative, indptr[row], indptr[row + 1], v)]
            t += 1
            if over[state]:
                break
        lengths[i] = t
    return lengths


@njit(cache=True, nogil=True)
def episodes(key, starts, initial, policy, indptr, indices, cumulative):
    """The same episodes, written out: row and entry of each move, in the ragged places that ``starts`` gives."""
    n_states, n_actions = policy.shape
    flat = policy.reshape(-1)
    rows = np.empty(starts[-1], dtype=np.int64)
    entries = np.empty(starts[-1], dtype=np.int64)
    for i in range(len(starts) - 1):
        u, _ = uniforms(key, i, 0)
        state = pick(initial, 0, n_states, u)
        for t in range(starts[i + 1] - starts[i]):
            u, v = uniforms(key, i, t + 1)
            row = pick(flat, state * n_actions, (state + 1) * n_actions, u)
            entry = pick(cumulative, indptr[row], indptr[row + 1], v)
            rows[starts[i] + t] = row
            entries[starts[i] + t] = entry
            state = indices[entry]
    return rows, entries


@njit(cache=True, nogil=True)
def transitions(key, n, distribution, indptr, cumulative):
    """n independent moves: a row from ``distribution`` (running sums), then a stored entry of the row."""
    rows = np.empty(n, dtype=np.int64)
    entries = np.empty(n, dtype=np.int64)
    for i in range(n):
        u, v = uniforms(key, i, 0)
        row = pick(distribution, 0, len(distribution), u)
        rows[i] = row
        entries[i] = pick(cumulative, indptr[row], indptr[row + 1], v)
    return rows, entries
