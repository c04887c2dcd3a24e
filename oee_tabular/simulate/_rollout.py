"""Sampling with counter-based random numbers, so that every trajectory has its own stream.

Philox4x32-10 [1] keyed by the seed, its counter made of (trajectory, step): the same bits for any number of threads and
any order of work. Each call gives 128 bits: two uniform numbers of 53 bits, which invert running sums, for logs; four words
of 32 bits for ``lanes``.

Until the loops are compiled, Python walks the same episodes, with the numbers of many steps drawn at once by numpy.

Reference: [1] Salmon, Moraes, Dror and Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011.
"""

import functools
from bisect import bisect_right

import numpy as np
from numba import prange

from oee_tabular._compiled import threads_share
from oee_tabular._kernels import njit

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


def _first_above(sums, low, high, u):
    """``pick`` from a list."""
    return bisect_right(sums, u * sums[high - 1], low, high - 1)


def _block(key, begin, most, initial, policy, indptr, indices, cumulative, over):
    """The entries that some episodes take, a list each: ``begin`` and those behind it, of at most ``most`` steps each.

    All but ``key`` and ``begin`` are lists; an episode ends where ``over`` is true.
    """
    n_actions = len(policy) // len(initial)
    who = np.arange(begin, begin + len(most))
    state = [_first_above(initial, 0, len(initial), u) for u in uniforms.watched(key, who, 0)[0].tolist()]
    paths = [[] for _ in most]
    going, t = [i for i, steps in enumerate(most) if steps > 0], 0
    while going:
        drawn = uniforms.watched(key, who[going][:, None], np.arange(t + 1, t + 1 + _BLOCK))
        on = []
        for i, *numbers in zip(going, *(part.tolist() for part in drawn), strict=True):
            s, path = state[i], paths[i]
            for u, v in zip(*numbers, strict=True):
                row = _first_above(policy, s * n_actions, (s + 1) * n_actions, u)
                path.append(_first_above(cumulative, indptr[row], indptr[row + 1], v))
                s = indices[path[-1]]
                if len(path) == most[i] or over[s]:
                    break
            else:
                on.append(i)
            state[i] = s
        going, t = on, t + _BLOCK
    return paths


def _walked(key, most, over, initial, *tables):
    """The paths of all episodes."""
    lists = [initial.tolist(), *(table.reshape(-1).tolist() for table in tables), over.tolist()]
    for begin in range(0, len(most), _BLOCK):
        yield from _block(key, begin, most[begin : begin + _BLOCK].tolist(), *lists)


def _episode_lengths(key, n, horizon, initial, policy, indptr, indices, cumulative, over):
    """``episode_lengths`` by Python."""
    most = np.full(n, horizon)
    return np.array([len(path) for path in _walked(key, most, over, initial, policy, indptr, indices, cumulative)])


def _episodes(key, starts, initial, policy, indptr, indices, cumulative):
    """``episodes`` by Python."""
    over = np.zeros(len(initial), dtype=np.bool_)
    paths = _walked(key, np.diff(starts), over, initial, policy, indptr, indices, cumulative)
    entries = np.array([entry for path in paths for entry in path], dtype=np.int64)
    return np.searchsorted(indptr, entries, side="right") - 1, entries


def _transitions(key, n, distribution, indptr, cumulative):
    """``transitions`` by Python."""
    ends, sums = indptr.tolist(), cumulative.tolist()
    rows, entries = np.empty((2, n), dtype=np.int64)
    for begin in range(0, n, _BLOCK * _BLOCK):
        who = np.arange(begin, min(n, begin + _BLOCK * _BLOCK))
        u, v = uniforms(key, who, 0)
        rows[who] = np.minimum(np.searchsorted(distribution, u * distribution[-1], side="right"), len(distribution) - 1)
        entries[who] = [
            _first_above(sums, ends[row], ends[row + 1], x)
            for row, x in zip(rows[who].tolist(), v.tolist(), strict=True)
        ]
    return rows, entries


@functools.partial(threads_share, python=_episode_lengths)
def episode_lengths(key, n, horizon, initial, policy, indptr, indices, cumulative, over):
    """The number of steps of each of n episodes: up to the horizon, or to the first state that is over."""
    n_states, n_actions = policy.shape
    flat = policy.reshape(-1)
    lengths = np.empty(n, dtype=np.int64)
    for i in prange(n):
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


@functools.partial(threads_share, python=_episodes)
def episodes(key, starts, initial, policy, indptr, indices, cumulative):
    """The same episodes, written out: row and entry of each move, in the ragged places that ``starts`` gives."""
    n_states, n_actions = policy.shape
    flat = policy.reshape(-1)
    rows = np.empty(starts[-1], dtype=np.int64)
    entries = np.empty(starts[-1], dtype=np.int64)
    for i in prange(len(starts) - 1):
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


@functools.partial(threads_share, python=_transitions)
def transitions(key, n, distribution, indptr, cumulative):
    """n independent moves: a row from ``distribution`` (running sums), then a stored entry of the row."""
    rows = np.empty(n, dtype=np.int64)
    entries = np.empty(n, dtype=np.int64)
    for i in prange(n):
        u, v = uniforms(key, i, 0)
        row = pick(distribution, 0, len(distribution), u)
        rows[i] = row
        entries[i] = pick(cumulative, indptr[row], indptr[row + 1], v)
    return rows, entries
