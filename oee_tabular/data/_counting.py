"""Passes over the rows of a log's batch: a table of the different moves, and where episodes begin and break."""

from typing import NamedTuple

import numpy as np
from numba import njit

FULL = 0.6  # share of the slots that are taken: beyond it a table is made larger
_A, _B, _C = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_D, _E = np.uint64(30), np.uint64(31)

# what is wrong with a row as one of its episode
FINE, TIMESTEP, APART, EARLY, LOST = 0, 1, 2, 3, 4
# places of what is carried from batch to batch
ORDINAL, NAME, AT, OVER, LENGTH, SHORTEST, LONGEST, UNFINISHED, SKIP = 0, 1, 2, 3, 4, 5, 6, 7, 8
CARRIED = 9


class Table(NamedTuple):
    """Open addressing. ``cell`` (slots, 8) integers, a cache line each: s, a, s', ended, then the bits of ``real``.

    ``real``: the same memory as floats; 4 to 7 are number, total, least, most. ``used`` (1,): slots taken.
    """

    cell: object
    real: object
    used: object


class Rows(NamedTuple):
    """Rows to be added: their keys, what they paid (empty: nothing); ``sums`` (n, 4) of several (empty: each is one)."""

    state: object
    action: object
    next_state: object
    ended: object
    reward: object
    sums: object


class Steps(NamedTuple):
    """The rows of episodes, in order; ``timestep`` and ``truncated`` are empty where there are none.

    ``bad``: a row of the episode that is not counted; ``gap``: before the row some were lost.
    """

    episode: object
    state: object
    next_state: object
    terminated: object
    truncated: object
    timestep: object
    bad: object
    gap: object


@njit(cache=True)
def _home(s, a, j, e, mask):
    """The slot where the search for a key begins: a mix of its four numbers."""
    x = (np.uint64(s) * _A) ^ (np.uint64(a) * _B + _A) ^ ((np.uint64(j) + _C) * _C) ^ (np.uint64(e) << _D)
    x = (x ^ (x >> _D)) * _B
    return (x ^ (x >> _E)) & mask


# number += n_i, total += t_i, least = min(least, l_i), most = max(most, m_i) at the slot of (s, a, s', ended), i = begin..
@njit(cache=True)
def add(table, rows, begin):
    """Add rows from ``begin`` on, in their order; the first that is left when the table is full, or how many there are."""
    cell, real = table.cell, table.real
    mask = np.uint64(cell.shape[0] - 1)
    room, n = np.int64(FULL * cell.shape[0]), len(rows.state)
    paid, several = len(rows.reward) > 0, len(rows.sums) > 0
    for i in range(begin, n):
        s, a, j, e = rows.state[i], rows.action[i], rows.next_state[i], rows.ended[i]
        x = _home(s, a, j, e, mask)
        while real[x, 4] > 0.0 and not (cell[x, 0] == s and cell[x, 1] == a and cell[x, 2] == j and cell[x, 3] == e):
            x = (x + np.uint64(1)) & mask
        if real[x, 4] == 0.0:
            if table.used[0] >= room:
                return i
            table.used[0] += 1
            cell[x, 0], cell[x, 1], cell[x, 2], cell[x, 3] = s, a, j, e
            real[x, 6], real[x, 7] = np.inf, -np.inf
        pay = rows.reward[i] if paid else 0.0
        real[x, 4] += rows.sums[i, 0] if several else 1.0
        real[x, 5] += rows.sums[i, 1] if several else pay
        real[x, 6] = min(real[x, 6], rows.sums[i, 2] if several else pay)
        real[x, 7] = max(real[x, 7], rows.sums[i, 3] if several else pay)
    return n


# ordinal_i = ordinal_(i-1) + [episode_i != episode_(i-1)]; a row is at fault where its timestep is not its place in the
# episode, its state is not where the row before it led, or the row before it was the last
@njit(cache=True)
def walk(steps, carried, ordinal, fault):
    """Number the episodes from those ``carried`` on and note in ``fault`` what is wrong with a row as one of its episode."""
    timed, cut = len(steps.timestep) > 0, len(steps.truncated) > 0
    for i in range(len(steps.episode)):
        fault[i] = FINE
        if carried[ORDINAL] < 0 or steps.episode[i] != carried[NAME]:
            close(carried)
            carried[ORDINAL] += 1
            carried[NAME], carried[LENGTH], carried[OVER], carried[SKIP] = steps.episode[i], 0, 0, 0
        elif carried[OVER] > 0:
            fault[i] = EARLY
        elif carried[SKIP] == 0 and carried[AT] != steps.state[i] and not steps.bad[i]:
            fault[i] = APART
        if steps.gap[i] or steps.bad[i]:
            fault[i] = LOST
        elif timed and fault[i] == FINE and steps.timestep[i] != carried[LENGTH]:
            fault[i] = TIMESTEP
        carried[SKIP] = 1 if steps.bad[i] else 0
        carried[AT] = steps.next_state[i]
        carried[OVER] = 0
        if not steps.bad[i] and (steps.terminated[i] or (cut and steps.truncated[i])):
            carried[OVER] = 1
        carried[LENGTH] += 1
        ordinal[i] = carried[ORDINAL]


@njit(cache=True)
def close(carried):
    """The open episode is over: its length is one of the lengths, and without an end it is unfinished."""
    if carried[ORDINAL] < 0:
        return
    if carried[SHORTEST] == 0 or carried[LENGTH] < carried[SHORTEST]:
        carried[SHORTEST] = carried[LENGTH]
    carried[LONGEST] = max(carried[LONGEST], carried[LENGTH])
    if carried[OVER] == 0:
        carried[UNFINISHED] += 1
