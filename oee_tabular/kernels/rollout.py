"""Sampling with counter-based random numbers, so that every trajectory has its own stream.

Philox4x32-10 [1] keyed by the seed, its counter made of (trajectory, step): the same bits for any number of threads and
any order of work. Each call gives 128 bits. Logs use them as two uniform numbers of 53 bits, which invert running sums; the
lanes below as two words of 64 or four of 32 bits, one for each step, which alias tables (``alias``) turn into moves.

Reference: [1] Salmon, Moraes, Dror and Shaw, Parallel random numbers: as easy as 1, 2, 3, SC 2011.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange

_LOW = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_UNIT = 1.0 / 9007199254740992.0  # 2**-53
_DROP = np.uint64(11)


def philox(c0: Any, c1: Any, c2: Any, c3: Any, k0: Any, k1: Any) -> Any:
    """Ten rounds of Philox4x32 on 32-bit words held in uint64 (only the low 32 bits of what is between them count)."""
    for _ in range(10):
        p0 = _M0 * (c0 & _LOW)
        p1 = _M1 * (c2 & _LOW)
        c0, c1, c2, c3 = (p1 >> _SHIFT) ^ c1 ^ k0, p1, (p0 >> _SHIFT) ^ c3 ^ k1, p0
        k0 = k0 + _W0
        k1 = k1 + _W1
    return c0 & _LOW, c1 & _LOW, c2 & _LOW, c3 & _LOW


# inlined by numba: a call inside the loop over lanes would keep LLVM from vectorising it (3 ns instead of 10)
philox = njit(cache=True, inline="always")(philox)


def uniforms(key: Any, trajectory: Any, step: Any) -> Any:
    """Two numbers in [0, 1) that belong to (key, trajectory, step)."""
    t, s = np.uint64(trajectory), np.uint64(step)
    x0, x1, x2, x3 = philox(s & _LOW, s >> _SHIFT, t & _LOW, t >> _SHIFT, key & _LOW, key >> _SHIFT)
    first = np.float64(((x1 << _SHIFT) | x0) >> _DROP) * _UNIT
    second = np.float64(((x3 << _SHIFT) | x2) >> _DROP) * _UNIT
    return first, second


uniforms = njit(cache=True)(uniforms)


def pick(cumulative: Any, low: Any, high: Any, u: Any) -> Any:
    """The first position in [low, high) whose running sum exceeds u times the total (so zero entries are never picked)."""
    target = u * cumulative[high - 1]
    while low < high - 1:
        middle = (low + high - 1) // 2
        if cumulative[middle] > target:
            high = middle + 1
        else:
            low = middle + 1
    return low


pick = njit(cache=True)(pick)


def episode_lengths(
    key: Any, n: Any, horizon: Any, initial: Any, policy: Any, indptr: Any, indices: Any, cumulative: Any, over: Any
) -> Any:
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


episode_lengths = njit(cache=True, parallel=True)(episode_lengths)


def episodes(key: Any, starts: Any, initial: Any, policy: Any, indptr: Any, indices: Any, cumulative: Any) -> Any:
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


episodes = njit(cache=True, parallel=True)(episodes)


def transitions(key: Any, n: Any, distribution: Any, indptr: Any, cumulative: Any) -> Any:
    """n independent moves: a row from ``distribution`` (running sums), then a stored entry of the row."""
    rows = np.empty(n, dtype=np.int64)
    entries = np.empty(n, dtype=np.int64)
    for i in prange(n):
        u, v = uniforms(key, i, 0)
        row = pick(distribution, 0, len(distribution), u)
        rows[i] = row
        entries[i] = pick(cumulative, indptr[row], indptr[row + 1], v)
    return rows, entries


transitions = njit(cache=True, parallel=True)(transitions)


# Returns: many trajectories ("lanes") take turns, so that one's loads from the table hide behind the others' work.

_MOVES, _FIRST = np.uint64(1), np.uint64(2)  # in the counter where logs have 0: other streams than theirs
_ONE, _TWO, _PASS = np.uint64(1), np.uint64(2), np.uint64(4)
_PLACE, _SIZE = np.uint64(6), np.uint64(63)


def step_words(key: Any, trajectory: Any, t: Any, exact: Any, words: Any, n: Any) -> None:
    """The random words of steps t .. t + 3 (t is a multiple of 4) of each of n lanes: (4, lanes)."""
    k0, k1 = key & _LOW, key >> _SHIFT
    if exact:
        for i in range(n):
            c2, c3 = trajectory[i] & _LOW, trajectory[i] >> _SHIFT
            x0, x1, x2, x3 = philox(t[i] >> _ONE, _MOVES, c2, c3, k0, k1)
            y0, y1, y2, y3 = philox((t[i] >> _ONE) + _ONE, _MOVES, c2, c3, k0, k1)
            words[0, i] = x1 << _SHIFT | x0
            words[1, i] = x3 << _SHIFT | x2
            words[2, i] = y1 << _SHIFT | y0
            words[3, i] = y3 << _SHIFT | y2
    else:
        for i in range(n):
            c2, c3 = trajectory[i] & _LOW, trajectory[i] >> _SHIFT
            words[0, i], words[1, i], words[2, i], words[3, i] = philox(t[i] >> _TWO, _MOVES, c2, c3, k0, k1)


step_words = njit(cache=True)(step_words)


def word_of(key: Any, kind: Any, trajectory: Any, t: Any, exact: Any) -> Any:
    """The random word of one step."""
    block = t >> _ONE if exact else t >> _TWO
    x0, x1, x2, x3 = philox(block, kind, trajectory & _LOW, trajectory >> _SHIFT, key & _LOW, key >> _SHIFT)
    if exact:
        return x3 << _SHIFT | x2 if t & _ONE else x1 << _SHIFT | x0
    if t & _TWO:
        return x3 if t & _ONE else x2
    return x1 if t & _ONE else x0


word_of = njit(cache=True)(word_of)


def choose(code: Any, x: Any, word: Any) -> Any:
    """The slot that the random word x takes in the state of that code."""
    size, base = code & _SIZE, code >> _PLACE
    low = (_ONE << size) - _ONE
    slot = base + (x & low)
    own = word[slot]
    return slot if x >> size < own >> size else base + (own & low)


choose = njit(cache=True, inline="always")(choose)


def lanes_of(
    key: Any, begin: Any, end: Any, horizon: Any, exact: Any, n_lanes: Any, word: Any, following: Any, reward: Any,
    factor: Any, start: Any, over: Any, discounts: Any, weighted: Any, by_move: Any, record: Any, entry: Any,
    places: Any, path: Any, sums: Any, lengths: Any, last: Any,
) -> None:  # fmt: skip
    """Trajectories begin .. end - 1, up to ``n_lanes`` at a time, four steps a pass: fills the outputs at their places.

    sums (3, n): G = sum_t gamma^t r_t; X, where each reward has its weight; the weight of the whole. An episode that is over
    may take the rest of its pass: where it is, nothing is paid and weights stand still. What is left of a horizon after whole
    passes, and the last step if its factor does not count (rewards r(s, a)), is taken one trajectory at a time.
    """
    words, codes, held = np.empty((4, n_lanes), np.uint64), np.empty((5, n_lanes), np.uint64), np.empty((3, n_lanes))
    t, trajectory = np.empty(n_lanes, np.uint64), np.empty(n_lanes, np.uint64)
    g, x, w = held[0], held[1], held[2]
    now = codes[0]  # the other rows: after each step of a pass
    whole = horizon - _ONE if weighted and not by_move else horizon
    active, waiting = 0, begin
    while True:
        i = 0
        while True:
            if i == active:  # all lanes looked at: fill another
                if active == n_lanes or waiting == end:
                    break
                trajectory[i], t[i] = waiting, np.uint64(0)
                g[i], x[i], w[i] = 0.0, 0.0, 1.0
                drawn = word_of(key, _FIRST, trajectory[i], t[i], exact) if start & _SIZE > 0 else t[i]
                now[i] = following[choose(start, drawn, word)]
                active += 1
                waiting += 1
            if t[i] + _PASS <= whole and now[i] < over:
                i += 1
                continue
            j, at, code = trajectory[i], t[i], now[i]
            while at < horizon and (code < over or at == 0):
                slot = choose(code, word_of(key, _MOVES, j, at, exact), word)
                code = following[slot]
                pay = discounts[at] * reward[slot]
                g[i] += pay
                if weighted:
                    after = w[i] * factor[slot]
                    x[i] += pay * (after if by_move else w[i])
                    w[i] = after if by_move or at + _ONE < horizon else w[i]
                if record:
                    path[places[j] + at] = entry[slot]
                at += _ONE
            sums[0, j], sums[1, j], sums[2, j] = g[i], x[i], w[i]
            lengths[j], last[j] = at, code
            active -= 1
            trajectory[i], t[i], now[i] = trajectory[active], t[active], now[active]
            g[i], x[i], w[i] = g[active], x[active], w[active]
        if active == 0:
            return
        step_words(key, trajectory, t, exact, words, active)
        for k in (0, 2):  # two steps at a time: fewer loads and stores of what lanes hold
            one, two, here, between, there = words[k], words[k + 1], codes[k], codes[k + 1], codes[k + 2]
            scale, next_scale = discounts[k:], discounts[k + 1 :]
            if weighted:
                for i in range(active):
                    slot = choose(here[i], one[i], word)
                    middle = following[slot]
                    pay, after = scale[t[i]] * reward[slot], w[i] * factor[slot]
                    paid, sum_x = g[i] + pay, x[i] + pay * (after if by_move else w[i])
                    slot = choose(middle, two[i], word)
                    between[i], there[i] = middle, following[slot]
                    pay, last_w = next_scale[t[i]] * reward[slot], after * factor[slot]
                    g[i], x[i], w[i] = paid + pay, sum_x + pay * (last_w if by_move else after), last_w
            else:
                for i in range(active):
                    slot = choose(here[i], one[i], word)
                    middle = following[slot]
                    paid = g[i] + scale[t[i]] * reward[slot]
                    slot = choose(middle, two[i], word)
                    between[i], there[i] = middle, following[slot]
                    g[i] = paid + next_scale[t[i]] * reward[slot]
        if record:
            for i in range(active):
                place = places[trajectory[i]] + t[i]
                for k in range(4):
                    if k == 0 or codes[k, i] < over:
                        path[place + np.uint64(k)] = entry[choose(codes[k, i], words[k, i], word)]
        for i in range(active):
            t[i] += _ONE + np.uint64(codes[1, i] < over) + np.uint64(codes[2, i] < over) + np.uint64(codes[3, i] < over)
            now[i] = codes[4, i]


lanes_of = njit(cache=True)(lanes_of)


def returns(
    key: Any, n: Any, chunk: Any, horizon: Any, exact: Any, n_lanes: Any, word: Any, following: Any, reward: Any,
    factor: Any, start: Any, over: Any, discounts: Any, weighted: Any, by_move: Any, record: Any, entry: Any,
    places: Any, path: Any, sums: Any, lengths: Any, last: Any,
) -> None:  # fmt: skip
    """``lanes_of`` for all n trajectories, in chunks that threads share; no output depends on either."""
    for c in prange((n + chunk - 1) // chunk):
        begin = np.int64(c) * chunk  # prange counts in uint64, and uint64 * int64 would be a float64
        lanes_of(
            key, begin, min(n, begin + chunk), horizon, exact, n_lanes, word, following, reward,
            factor, start, over, discounts, weighted, by_move, record, entry,
            places, path, sums, lengths, last,
        )  # fmt: skip


returns = njit(cache=True, parallel=True)(returns)
