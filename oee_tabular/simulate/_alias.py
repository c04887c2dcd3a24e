"""Alias tables [1] in whole numbers: one random word gives one of a state's outcomes, in O(1).

Outcomes of a state are its (a, s'), with probability policy(a | s) P(s' | s, a); the first state's draw is one state more.
A state with n outcomes has 2^k >= n slots. Of a word of 32 bits the low k choose a slot; the other 32 - k, and 32 more where
those do not decide, are compared with the slot's threshold: below it the outcome is the slot's own, else that of the slot's
alias. Probabilities are whole numbers of units 2^-64, distributed over the slots without rounding. Threshold and alias share
one word, threshold * 2^k + alias; a state's place in the table and its k share another, first slot * 2^8 + k.

Reference: [1] A. J. Walker, An efficient method for generating discrete random variables with general distributions, ACM
TOMS 3, 1977; the order of the pairing is M. D. Vose's, IEEE Trans. Software Engineering 17, 1991.
"""

from collections import namedtuple

import numpy as np
from numba import njit

_PLACE = np.uint64(8)  # bits that hold k
_NONE, _ONE, _BITS = np.uint64(0), np.uint64(1), np.uint64(64)

# what is drawn in a state: a row by the policy, an entry by P; the first state by ``initial``
Outcomes = namedtuple("Outcomes", "indptr indices prob policy initial")

# of each slot: its word, the code of s', reward, factor (or none) and the entry of P that it stands for
Slots = namedtuple("Slots", "word following reward factor entry")


@njit(cache=True)
def chances(state, outcomes, chance, row):
    """Fill in probability and row s*A + a of a state's outcomes (after the last state: of first states); how many.

    Rows of P sum to 1 only to 1e-8, so each is divided by its own sum (``units`` does so for the policy's).
    """
    indptr, _, prob, policy, initial = outcomes
    n_states, n_actions = policy.shape
    if state == n_states:
        for x in range(len(initial)):
            chance[x], row[x] = initial[x], 0
        return len(initial)
    n = 0
    for a in range(n_actions):
        here = state * n_actions + a
        total = 0.0
        for x in range(indptr[here], indptr[here + 1]):
            total += prob[x]
        share = policy[state, a] / total
        for x in range(indptr[here], indptr[here + 1]):
            chance[n], row[n] = share * prob[x], here
            n += 1
    return n


@njit(cache=True)
def units(chance, n, out):
    """Whole numbers of 2^-64 nearest to chance / sum, of n outcomes: how many are not 0, and the most probable outcome.

    That one takes what the others leave, so that they sum to 2^64 (in a word: 0).
    """
    total, most = 0.0, 0
    for x in range(n):
        total += chance[x]
        if chance[x] > chance[most]:
            most = x
    scale, others, kept = 2.0**64, _NONE, 1
    for x in range(n):
        if x != most:
            out[x] = np.uint64(chance[x] / total * scale + 0.5)  # at most 1/2: it fits
            others += out[x]
            kept += out[x] > _NONE
    out[most] = _NONE - others
    return kept, most


@njit(cache=True)
def sizes(outcomes, widest, out):
    """k of each state: the least with 2^k slots for its outcomes."""
    chance, unit, row = np.empty(widest), np.empty(widest, np.uint64), np.empty(widest, np.int64)
    for s in range(len(out)):
        kept, _ = units(chance, chances(s, outcomes, chance, row), unit)
        k = 0
        while (1 << k) < kept:
            k += 1
        out[s] = k


@njit(cache=True)
def pair(mass, k, word, small, large):
    """The words of 2^k slots, from the units of their own outcomes, which are used up."""
    room = _ONE << (_BITS - np.uint64(k))
    n_small, n_large = 0, 0
    for i in range(1 << k):
        if mass[i] < room:
            small[n_small] = i
            n_small += 1
        else:
            large[n_large] = i
            n_large += 1
    while n_small > 0:  # all sum to 2^k * room: while one has less than room, another has more
        n_small -= 1
        i, j = small[n_small], large[n_large - 1]
        word[i] = mass[i] << np.uint64(k) | np.uint64(j)
        mass[j] -= room - mass[i]
        if mass[j] < room:
            n_large -= 1
            small[n_small] = j
            n_small += 1
    for i in range(n_large):  # exactly full: no number is below the threshold 0, and the alias is the slot itself
        word[large[i]] = np.uint64(large[i])


@njit(cache=True)
def fill(outcomes, pay, ratio, widest, size, code, slots):
    """All slots, state by state; ``pay`` is aligned with rows or with entries, ``ratio`` may be empty."""
    indptr, indices, prob, policy, _ = outcomes
    word, following, reward, factor, entry = slots
    n_states, n_actions = policy.shape
    by_move = len(pay) == len(prob)
    chance, unit, row = np.empty(widest), np.empty(widest, np.uint64), np.empty(widest, np.int64)
    most_slots = 1 << np.max(size)
    mass, own = np.empty(most_slots, np.uint64), np.empty(most_slots, np.int64)
    small, large = np.empty(most_slots, np.int64), np.empty(most_slots, np.int64)
    for s in range(n_states + 1):
        n = chances(s, outcomes, chance, row)
        kept, most = units(chance, n, unit)
        n_slots, base, used = 1 << size[s], np.int64(code[s] >> _PLACE), 0
        for x in range(n):
            if unit[x] > _NONE and kept > 1:
                mass[used], own[used] = unit[x], x
                used += 1
        if kept == 1:  # all 2^64 units are one outcome's
            word[base], own[0] = _NONE, most
        else:
            for i in range(used, n_slots):  # no word stops at these
                mass[i], own[i] = _NONE, own[0]
            pair(mass, size[s], word[base : base + n_slots], small, large)
        for i in range(n_slots):
            x = indptr[s * n_actions] + own[i]
            entry[base + i] = x
            moves = s < n_states  # else a first state, before anything is paid
            following[base + i] = code[indices[x]] if moves else code[own[i]]
            reward[base + i] = 0.0 if not moves else pay[x] if by_move else pay[row[own[i]]]
            if len(ratio) > 0:
                factor[base + i] = ratio[x] if moves else 1.0
