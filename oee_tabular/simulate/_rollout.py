"""Kernels of sampling: alias tables, random numbers by counters, and episodes.

Alias tables [1] in whole numbers: one random word gives one of a state's outcomes, in
O(1). A state with n outcomes has 2^k >= n slots. The low k bits of a word of 62 bits
choose a slot; the others are compared with the slot's threshold: below it the outcome
is the slot's own, else the outcome of the slot's alias. Threshold and alias share one
number, ``threshold * 2^k + alias``. Probabilities are whole numbers of units 2^-62,
laid out over the slots without rounding.

Every trajectory has a stream of its own: Philox4x32-10 [2] keyed by the seed, its
counter made of (block, stream, trajectory), so that the bits are the same for any
number of threads and any order of work. A block has two words of 64 bits: word 0 draws
the first state, word t + 1 the transition of step t.

References: [1] A. J. Walker, An efficient method for generating discrete random
variables with general distributions, ACM TOMS 3, 1977; the order of the pairing is M.
D. Vose's, IEEE Trans. Software Engineering 17, 1991. [2] Salmon, Moraes, Dror and Shaw,
Parallel random numbers: as easy as 1, 2, 3, SC 2011.
"""

from typing import Any

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.typing import Array, IntArray

_WHOLE = 1 << 62  # the probability 1, in units
# words of 32 bits in numbers of 64
_LOW = np.uint64(0xFFFFFFFF)
_SHIFT = np.uint64(32)
# the multipliers and the key's increments of Philox4x32 [2]
_M0 = np.uint64(0xD2511F53)
_M1 = np.uint64(0xCD9E8D57)
_W0 = np.uint64(0x9E3779B9)
_W1 = np.uint64(0xBB67AE85)
# unsigned, because a sum with a signed number would be a float
_ONE = np.uint64(1)
_TWO = np.uint64(2)
# blocks drawn at once: 7.6 ns a step; with 8 blocks 12.6, with one 14.5
N_BLOCKS = 16
# episodes in step, whose waits for memory overlap: 8.1 ns a step on a 30 x 30 grid,
# with one lane 11.3
N_LANES = 4
# a state's code: first slot * 2^8 + terminal * 2^7 + k
_PLACE = np.uint64(8)
_SIZE = np.uint64(63)
_TERMINAL = np.uint64(128)


def fill_table(
    indptr: IntArray,
    prob: Array,
    policy: Array,
    first: IntArray,
    size: IntArray,
    word: IntArray,
    entry: IntArray,
) -> None:
    """Fill the slots of all states, the 2^size[s] of state s from ``first[s]`` on.

    A slot has its threshold and alias, and the entry that it stands for.
    """
    widest = 1 << int(size.max())
    mass, small, large = np.empty((3, widest), np.int64)
    fill_slots(
        indptr,
        prob,
        policy,
        first,
        size,
        word,
        entry,
        np.empty(widest),
        mass,
        small,
        large,
    )


@njit(cache=True)
def fill_slots(
    indptr, prob, policy, first, size, word, entry, chance, mass, small, large
):
    """Fill the slots of each state, with room for the numbers of one state.

    p(x) = policy(a | s) P(x) / sum P(. | s, a): rows of P sum to 1 only to 1e-8.
    Probabilities are rounded to whole units, mass(x) = round(2^62 p(x) / sum p); the
    most probable outcome takes what the others leave: their sum is 2^62. Then slots
    that lack units are paired with slots that have too many: threshold_i = mass_i,
    alias_i = j, mass_j -= 2^(62 - k) - mass_i, while a slot lacks units.
    """
    n_actions = policy.shape[1]
    for s in range(len(size)):
        begin = first[s]
        k = size[s]
        n_slots = 1 << k
        # the entries of the state's rows with their probabilities
        n = 0
        for action in range(n_actions):
            share = policy[s, action]
            if share > 0.0:
                row = s * n_actions + action
                total = 0.0
                for x in range(indptr[row], indptr[row + 1]):
                    total += prob[x]
                for x in range(indptr[row], indptr[row + 1]):
                    chance[n] = share / total * prob[x]
                    entry[begin + n] = x
                    n += 1
        # in whole units
        total = 0.0
        most = 0
        for i in range(n):
            total += chance[i]
            if chance[i] > chance[most]:
                most = i
        rest = _WHOLE
        for i in range(n):
            if i != most:
                mass[i] = np.int64(chance[i] / total * _WHOLE + 0.5)
                rest -= mass[i]
        mass[most] = rest
        for i in range(n, n_slots):
            mass[i] = 0
            entry[begin + i] = entry[begin + most]
        # in pairs of slots
        room = _WHOLE >> k
        n_small = 0
        n_large = 0
        for i in range(n_slots):
            if mass[i] < room:
                small[n_small] = i
                n_small += 1
            else:
                large[n_large] = i
                n_large += 1
        while n_small > 0:
            n_small -= 1
            i = small[n_small]
            j = large[n_large - 1]
            word[begin + i] = mass[i] << k | j
            mass[j] -= room - mass[i]
            if mass[j] < room:
                n_large -= 1
                small[n_small] = j
                n_small += 1
        # what is left is exactly full
        for i in range(n_large):
            word[begin + large[i]] = room << k | large[i]


@njit(cache=True, inline="always")
def philox(c0, c1, c2, c3, k0, k1):
    """Compute ten rounds of Philox4x32 on words of 32 bits held in uint64.

    Between rounds only their low 32 bits count.
    """
    for _ in range(10):
        p0 = _M0 * (c0 & _LOW)
        p1 = _M1 * (c2 & _LOW)
        c0 = (p1 >> _SHIFT) ^ c1 ^ k0
        c1 = p1
        c2 = (p0 >> _SHIFT) ^ c3 ^ k1
        c3 = p0
        k0 = k0 + _W0
        k1 = k1 + _W1
    return c0 & _LOW, c1 & _LOW, c2 & _LOW, c3 & _LOW


@njit(cache=True)
def fill_words(key, stream, trajectory, block, words, lane):
    """Compute the words (2, blocks) of 62 bits of a lane's next blocks.

    The blocks stand side by side, so that they are vectorised.
    """
    k0 = key & _LOW
    k1 = key >> _SHIFT
    c2 = trajectory & _LOW
    c3 = trajectory >> _SHIFT
    for b in range(words.shape[2]):
        x0, x1, x2, x3 = philox(block + np.uint64(b), stream, c2, c3, k0, k1)
        words[lane, 0, b] = (x1 << _SHIFT | x0) >> _TWO
        words[lane, 1, b] = (x3 << _SHIFT | x2) >> _TWO


@njit(cache=True, inline="always")
def choose_slot(code, x, word):
    """Return the slot whose outcome the word x gives in the state of that code.

    The outcome is the slot's own below the threshold, else the alias.
    """
    base = code >> _PLACE
    low = (_ONE << (code & _SIZE)) - _ONE
    slot = base + (x & low)
    own = word[slot]
    return slot if x | low < own else base + (own & low)


def draw_episodes(
    begin: int,
    end: int,
    key: Any,
    stream: Any,
    horizon: int,
    discount: float,
    by_transition: bool,
    table: tuple[Any, Any, Any, Array, Array, IntArray],
    sums: Array,
    lengths: IntArray,
    last: IntArray,
    path: IntArray,
) -> tuple[int, int]:
    """Draw the trajectories begin .. end - 1 and the sums along them.

    G += gamma^t r_t, X += gamma^t W r_t, W_{t+1} = W_t zeta_{t+1}. ``sums`` (4, n): G;
    X, where a reward has the weight W_t, or W_{t+1} ``by_transition``; the weight of
    the whole; the largest weight of a reward. ``lengths`` (n,) takes the steps,
    ``last`` (n,) the last step's entry of P, ``path`` the entries of all steps in a
    row, unless it is empty. Returns the first trajectory that ``path`` has no room for,
    and how much of it is used.
    """
    # one after the other where paths are kept
    n_lanes = 1 if len(path) else N_LANES
    # the threads that draw episodes have words of their own
    words = np.empty((n_lanes, 2, N_BLOCKS), np.uint64)
    here = np.empty(n_lanes, np.uint64)
    done, used = step_lanes(
        begin,
        end,
        key,
        stream,
        horizon,
        discount,
        by_transition,
        *table,
        sums,
        lengths,
        last,
        path,
        words,
        here,
    )
    return done, used


@njit(cache=True, nogil=True)
def step_lanes(
    begin,
    end,
    key,
    stream,
    horizon,
    discount,
    by_transition,
    code,
    word,
    following,
    reward,
    factor,
    entry,
    sums,
    lengths,
    last,
    path,
    words,
    here,
):
    """Draw the trajectories begin .. end - 1, ``len(here)`` of them side by side.

    In each lane, with a slot drawn by word t + 1 from the table of the state s_t:
    G += gamma^t r, X += gamma^t W r, W <- W zeta, s_{t+1} = the state that the slot
    leads to. The other arguments are explained in ``draw_episodes``.
    """
    weighted = len(factor) > 0
    record = len(path) > 0
    used = 0
    n_lanes = len(here)
    for first in range(begin, end, n_lanes):
        # the first states of the lanes, and sums that begin with 0 or 1
        n_together = n_lanes
        if end - first < n_lanes:
            n_together = end - first
        for lane in range(n_together):
            i = first + lane
            fill_words(key, stream, np.uint64(i), np.uint64(0), words, lane)
            here[lane] = following[choose_slot(code[-1], words[lane, 0, 0], word)]
            sums[0, i] = 0.0
            sums[1, i] = 0.0
            sums[2, i] = 1.0
            sums[3, i] = 0.0 if weighted else 1.0
        scale = 1.0
        n_running = n_together
        # a step of each lane whose episode has not ended
        for t in range(horizon):
            at = (t + 1) % (2 * N_BLOCKS)
            for lane in range(n_together):
                if t > 0 and here[lane] & _TERMINAL:
                    continue
                i = first + lane
                if at == 0:
                    block = np.uint64((t + 1) // 2)
                    fill_words(key, stream, np.uint64(i), block, words, lane)
                slot = choose_slot(here[lane], words[lane, at & 1, at >> 1], word)
                here[lane] = following[slot]
                gain = scale * reward[slot]
                sums[0, i] += gain
                if weighted:
                    before = sums[2, i]
                    after = before * factor[slot]
                    carried = after if by_transition else before
                    # a weight may be infinite
                    if gain != 0.0:
                        sums[1, i] += gain * carried
                    if carried > sums[3, i]:
                        sums[3, i] = carried
                    if by_transition or t + 1 < horizon:
                        sums[2, i] = after
                if record:
                    if used == len(path):
                        return i, used - t
                    path[used] = entry[slot]
                    used += 1
                if t + 1 == horizon or here[lane] & _TERMINAL:
                    lengths[i] = t + 1
                    last[i] = entry[slot]
                    n_running -= 1
            if n_running == 0:
                break
            scale *= discount
    return end, used


@njit(cache=True)
def write_columns(
    path,
    lengths,
    row_of_entry,
    indices,
    rewards,
    policy,
    terminal,
    integers,
    numbers,
    flags,
):
    """Write the columns of a log, row by row of its path.

    The entry x of P is a transition from the state and action of its row to
    indices[x]. ``integers`` (5, n) takes state, action, next state, timestep and
    episode; ``numbers`` (2, n) reward and behaviour probability; ``flags`` (2, n),
    which begin as zeros, terminated and truncated.
    """
    n_actions = policy.shape[1]
    i = 0
    for episode in range(len(lengths)):
        for t in range(lengths[episode]):
            x = path[i]
            row = row_of_entry[x]
            state = row // n_actions
            action = row - state * n_actions
            integers[0, i] = state
            integers[1, i] = action
            integers[2, i] = indices[x]
            integers[3, i] = t
            integers[4, i] = episode
            numbers[0, i] = rewards[x]
            numbers[1, i] = policy[state, action]
            i += 1
        # an episode that did not terminate was truncated
        over = terminal[indices[path[i - 1]]]
        flags[0, i - 1] = over
        flags[1, i - 1] = not over
