"""Returns of sampled episodes: many trajectories ("lanes") take turns, so that one's loads hide behind the others' work.

Each step has a word of 32 random bits (Philox, four steps a call), which the alias table of its state turns into a move.
Thresholds there have 64 bits: where the first 32 do not decide, in one step of 2^28 or so, 32 more are drawn.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from oee_tabular.simulate._rollout import philox

_LOW, _SHIFT = np.uint64(0xFFFFFFFF), np.uint64(32)
_MOVES, _FIRST = np.uint64(1), np.uint64(2)  # in the counter where logs have 0: other streams than theirs
_FURTHER = np.uint64(2)  # added to it for the bits that decide where the first ones do not
_NONE, _ONE, _TWO, _THREE, _PASS = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
_PLACE, _SIZE = np.uint64(8), np.uint64(255)

# what all episodes have in common: ``most``, ``start`` and ``over`` are the alias table's (``AliasTable``)
Plan = namedtuple("Plan", "key horizon n_lanes most start over discounts weighted by_move")

# what is filled in, by trajectory; and by ``places`` the ``path``, an entry of P for each step, unless it is empty
Outcome = namedtuple("Outcome", "sums lengths last places path")

# of each lane: its trajectory, step, the code of its state; and G, X, the weight and the largest one that a reward has
Lanes = namedtuple("Lanes", "trajectory t now held")


@njit(cache=True)
def step_words(key, trajectory, t, words, n):
    """The random words of steps t .. t + 3 (t is a multiple of 4) of each of n lanes, each twice in 64 bits: (4, lanes)."""
    k0, k1 = key & _LOW, key >> _SHIFT
    for i in range(n):
        c2, c3 = trajectory[i] & _LOW, trajectory[i] >> _SHIFT
        x0, x1, x2, x3 = philox(t[i] >> _TWO, _MOVES, c2, c3, k0, k1)
        words[0, i], words[1, i] = x0 << _SHIFT | x0, x1 << _SHIFT | x1
        words[2, i], words[3, i] = x2 << _SHIFT | x2, x3 << _SHIFT | x3


@njit(cache=True)
def word_of(key, kind, trajectory, t):
    """The random word of one step."""
    x0, x1, x2, x3 = philox(t >> _TWO, kind, trajectory & _LOW, trajectory >> _SHIFT, key & _LOW, key >> _SHIFT)
    if t & _TWO:
        return x3 if t & _ONE else x2
    return x1 if t & _ONE else x0


@njit(cache=True, inline="always")
def choose(code, x, word, near):
    """The slot that the random word x takes in the state of that code, and a number that is small where x may not decide it.

    x holds its 32 bits twice: the low copy gives the slot, the high one is compared. Below that, and in its low k bits, other
    bits of the threshold meet bits that mean nothing. They may have decided where threshold - x is within 2^(k + 32) of 0: the
    second number is that difference plus ``near``, 2^(k + 32) of the largest k. No branch, so that lanes are side by side.
    """
    size, base = code & _SIZE, code >> _PLACE
    low = (_ONE << size) - _ONE
    slot = base + (x & low)
    own = word[slot]
    return slot if x <= own else base + (own & low), own - x + near


@njit(cache=True)
def settle(key, kind, trajectory, t, code, word):
    """The slot of one step, whatever bits that takes."""
    x = word_of(key, kind, trajectory, t)
    size, base = code & _SIZE, code >> _PLACE
    low = (_ONE << size) - _ONE
    own = word[base + (x & low)]
    high, threshold = x >> size, own >> (size + _SHIFT)
    if high == threshold:
        high, threshold = word_of(key, kind + _FURTHER, trajectory, t), own >> size & _LOW
    return base + ((x if high < threshold else own) & low)


@njit(cache=True)
def walk(plan, slots, lanes, i, until, place, path):
    """Lane i, step by step, up to the step ``until`` or the end of its episode (which has one step at least)."""
    key, horizon, _, _, _, over, discounts, weighted, by_move = plan
    word, following, reward, factor, entry = slots
    trajectory, t, now, held = lanes
    g, x, w, largest = held[0], held[1], held[2], held[3]
    while t[i] < until and (now[i] < over or t[i] == _NONE):
        slot = settle(key, _MOVES, trajectory[i], t[i], now[i], word)
        now[i] = following[slot]
        pay = discounts[t[i]] * reward[slot]
        g[i] += pay
        if weighted:
            after = w[i] * factor[slot]
            carried = after if by_move else w[i]
            x[i] += pay * carried if pay != 0.0 else 0.0  # a weight may be infinite
            largest[i] = max(largest[i], carried)
            w[i] = after if by_move or t[i] + _ONE < horizon else w[i]
        if len(path):
            path[place + t[i]] = entry[slot]
        t[i] += _ONE


@njit(cache=True)
def lanes_of(begin, end, plan, slots, outcome):
    """Trajectories begin .. end - 1, up to ``n_lanes`` at a time, four steps a pass: fills the outputs at their places.

    sums (4, n): G = sum_t gamma^t r_t; X, where each reward has its weight; the weight of the whole; the largest that a reward
    has. An episode that is over takes the rest of its pass: nothing is paid and weights stand still. So does one at its
    horizon, where nothing is paid either (``discounts`` go on with zeros up to a multiple of four), and then its state and its
    weights go back. A pass in which a word of 32 bits may not have decided is taken one trajectory at a time.
    """
    key, horizon, n_lanes, most, start, over, discounts, weighted, by_move = plan
    word, following, reward, factor, entry = slots
    sums, lengths, last, places, path = outcome
    record = len(path) > 0
    words, codes = (
        np.empty((4, n_lanes), np.uint64),
        np.empty((5, n_lanes), np.uint64),
    )  # codes: before and after each step
    held, before = np.empty((4, n_lanes)), np.empty((4, n_lanes))
    t, trajectory, now = np.empty(n_lanes, np.uint64), np.empty(n_lanes, np.uint64), np.empty(n_lanes, np.uint64)
    stopped, ends = np.empty(n_lanes, np.int64), np.zeros(n_lanes + 3, np.uint64)
    g, x, w, largest = held[0], held[1], held[2], held[3]
    lanes = Lanes(trajectory, t, now, held)
    near = _ONE << (most + _SHIFT)
    active, waiting, n_stopped, walked = 0, begin, 0, False
    while True:
        while n_stopped > 0 or (active < n_lanes and waiting < end):
            if n_stopped > 0:  # the last of them first: lanes behind it all go on
                n_stopped -= 1
                i = stopped[n_stopped]
                j = trajectory[i]
                first = (t[i] - _ONE) & ~_THREE  # of the pass that it has just taken
                if first + _PASS > horizon and not walked:
                    t[i], now[i] = min(t[i], horizon), codes[horizon - first, i]
                    if weighted:
                        w[i], largest[i] = before[2, i], before[3, i]
                        for k in range(t[i] - first):
                            after = w[i] * factor[choose(codes[k, i], words[k, i], word, near)[0]]
                            largest[i] = max(largest[i], after if by_move else w[i])
                            w[i] = after if by_move or first + np.uint64(k) + _ONE < horizon else w[i]
                sums[0, j], sums[1, j], sums[2, j], sums[3, j] = g[i], x[i], w[i], largest[i]
                lengths[j], last[j] = t[i], now[i]
                if waiting == end:
                    active -= 1
                    trajectory[i], t[i], now[i] = trajectory[active], t[active], now[active]
                    g[i], x[i], w[i], largest[i] = g[active], x[active], w[active], largest[active]
                    continue
            else:
                i = active
                active += 1
            trajectory[i], t[i] = waiting, _NONE
            g[i], x[i], w[i], largest[i] = 0.0, 0.0, 1.0, 0.0 if weighted and by_move else 1.0
            several = start & _SIZE > _NONE
            now[i] = following[settle(key, _FIRST, trajectory[i], t[i], start, word) if several else start >> _PLACE]
            waiting += 1
        if active == 0:
            return
        step_words(key, trajectory, t, words, active)
        for i in range(active):
            before[0, i], codes[0, i] = g[i], now[i]
        if weighted:
            for i in range(active):
                before[1, i], before[2, i], before[3, i] = x[i], w[i], largest[i]
        nearest = ~_NONE
        for k in (0, 2):  # two steps at a time: fewer loads and stores of what lanes hold
            one, two, here, between, there = words[k], words[k + 1], codes[k], codes[k + 1], codes[k + 2]
            scale, next_scale = discounts[k:], discounts[k + 1 :]
            final = horizon - _PASS if k == 2 and not by_move else ~_NONE  # the last factor does not count then
            if weighted:
                for i in range(active):
                    at = t[i]
                    slot, first = choose(here[i], one[i], word, near)
                    middle = following[slot]
                    pay, after = scale[at] * reward[slot], w[i] * factor[slot]
                    carried = after if by_move else w[i]
                    top = max(largest[i], carried if by_move or here[i] < over else 0.0)
                    paid, sum_x = g[i] + pay, x[i] + (pay * carried if pay != 0.0 else 0.0)
                    slot, second = choose(middle, two[i], word, near)
                    nearest = min(nearest, min(first, second))
                    between[i], there[i] = middle, following[slot]
                    pay, last_w = next_scale[at] * reward[slot], after * factor[slot]
                    carried = last_w if by_move else after
                    largest[i] = max(top, carried if by_move or middle < over else 0.0)
                    g[i], x[i] = paid + pay, sum_x + (pay * carried if pay != 0.0 else 0.0)
                    w[i] = after if at == final else last_w
            else:
                for i in range(active):
                    at = t[i]
                    slot, first = choose(here[i], one[i], word, near)
                    middle = following[slot]
                    paid = g[i] + scale[at] * reward[slot]
                    slot, second = choose(middle, two[i], word, near)
                    nearest = min(nearest, min(first, second))
                    between[i], there[i] = middle, following[slot]
                    g[i] = paid + next_scale[at] * reward[slot]
        walked = nearest < near + near
        if walked:
            for i in range(active):
                g[i] = before[0, i]
                if weighted:
                    x[i], w[i], largest[i] = before[1, i], before[2, i], before[3, i]
                end_of_pass = min(t[i] + _PASS, horizon)
                walk(plan, slots, lanes, i, end_of_pass, places[trajectory[i]] if record else _NONE, path)
        else:
            if record:
                for i in range(active):
                    place = places[trajectory[i]] + t[i]
                    for k in range(min(_PASS, horizon - t[i])):
                        if k == 0 or codes[k, i] < over:
                            path[place + np.uint64(k)] = entry[choose(codes[k, i], words[k, i], word, near)[0]]
            for i in range(active):
                t[i] += (
                    _ONE + np.uint64(codes[1, i] < over) + np.uint64(codes[2, i] < over) + np.uint64(codes[3, i] < over)
                )
                now[i] = codes[4, i]
        for i in range(active):
            ends[i] = np.uint64(t[i] >= horizon) | np.uint64(now[i] >= over)
        for i in range(0, active, 4):  # few end in a pass
            if ends[i] | ends[i + 1] | ends[i + 2] | ends[i + 3]:
                for j in range(i, min(i + 4, active)):
                    if ends[j]:
                        stopped[n_stopped] = j
                        n_stopped += 1


@njit(cache=True, nogil=True)
def returns(n, chunk, plan, slots, outcome):
    """``lanes_of`` for all n trajectories, in chunks that threads share; no output depends on either."""
    for c in range((n + chunk - 1) // chunk):
        begin = np.int64(c) * chunk  # prange counts in uint64, and uint64 * int64 would be a float64
        lanes_of(begin, min(n, begin + chunk), plan, slots, outcome)
