"""Kernels of alias tables [1] in whole numbers: one random word gives one of a state's outcomes, in O(1).

A state with n outcomes has 2^k >= n slots. The low k bits of a word of 62 bits choose a slot; the others are compared with
the slot's threshold: below it the outcome is the slot's own, else that of the slot's alias. Threshold and alias share one
number, ``threshold * 2^k + alias``. Probabilities are whole numbers of units 2^-62, laid out over the slots without rounding.

Reference: [1] A. J. Walker, An efficient method for generating discrete random variables with general distributions, ACM
TOMS 3, 1977; the order of the pairing is M. D. Vose's, IEEE Trans. Software Engineering 17, 1991.
"""

import numpy as np
from numba import njit

_WHOLE = 1 << 62


@njit(cache=True)
def list_outcomes(state, indptr, prob, policy, chance, entry):
    """p(x) = policy(a | s) P(x) / sum P(. | s, a) of the entries x of a state's rows: rows of P sum to 1 only to 1e-8."""
    n, n_actions = 0, policy.shape[1]
    for action in range(n_actions):
        if policy[state, action] > 0.0:
            row = state * n_actions + action
            total = 0.0
            for x in range(indptr[row], indptr[row + 1]):
                total += prob[x]
            for x in range(indptr[row], indptr[row + 1]):
                chance[n], entry[n] = policy[state, action] / total * prob[x], x
                n += 1
    return n


@njit(cache=True)
def round_to_units(chance, n, mass):
    """mass(x) = round(2^62 p(x) / sum p); the most probable outcome takes what the others leave: their sum is 2^62."""
    total, most, rest = 0.0, np.argmax(chance[:n]), _WHOLE
    for i in range(n):
        total += chance[i]
    for i in range(n):
        if i != most:
            mass[i] = np.int64(chance[i] / total * _WHOLE + 0.5)
            rest -= mass[i]
    mass[most] = rest
    return most


@njit(cache=True)
def pair_slots(mass, k, word, small, large):
    """threshold_i = mass_i, alias_i = j, mass_j -= 2^(62 - k) - mass_i: while a slot lacks units, another one has too many."""
    room = _WHOLE >> k
    n_small, n_large = 0, 0
    for i in range(1 << k):
        if mass[i] < room:
            small[n_small] = i
            n_small += 1
        else:
            large[n_large] = i
            n_large += 1
    while n_small > 0:
        n_small -= 1
        i, j = small[n_small], large[n_large - 1]
        word[i] = mass[i] << k | j
        mass[j] -= room - mass[i]
        if mass[j] < room:
            n_large -= 1
            small[n_small] = j
            n_small += 1
    for i in range(n_large):  # exactly full
        word[large[i]] = room << k | large[i]


@njit(cache=True)
def fill_table(indptr, prob, policy, first, size, word, entry):
    """Slots of all states, state s from ``first[s]`` on: threshold and alias, and the entry that the slot stands for."""
    widest = 1 << np.max(size)
    chance, mass = np.empty(widest), np.empty(widest, np.int64)
    small, large = np.empty(widest, np.int64), np.empty(widest, np.int64)
    for s in range(len(size)):
        slots = slice(first[s], first[s] + (1 << size[s]))
        own = entry[slots]
        n = list_outcomes(s, indptr, prob, policy, chance, own)
        most = round_to_units(chance, n, mass)
        mass[n : len(own)], own[n:] = 0, own[most]
        pair_slots(mass, size[s], word[slots], small, large)
