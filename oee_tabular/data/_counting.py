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
    """Open addressing: ``key`` (slots, 4) is s, a, s', ended; ``sums`` (slots, 4) number, total, least, most; ``used`` (1,)."""

    key: object
    sums: object
    used: object


class Rows(NamedTuple):
    """Rows to be added: their keys, and ``sums`` as in the table."""

    state: object
    action: object
    next_state: object
    ended: object
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
def _slot(table, s, a, j, e):
    """Where a key stands, or the free slot where it is to stand: linear probing from a mix of its four numbers."""
    mask = np.uint64(table.key.shape[0] - 1)
    x = (np.uint64(s) * _A) ^ (np.uint64(a) * _B + _A) ^ ((np.uint64(j) + _C) * _C) ^ (np.uint64(e) << _D)
    x = (x ^ (x >> _D)) * _B
    x = (x ^ (x >> _E)) & mask
    while table.sums[x, 0] > 0.0:
        k = table.key[x]
        if k[0] == s and k[1] == a and k[2] == j and k[3] == e:
            break
        x = (x + np.uint64(1)) & mask
    return x


# number += n_i, total += t_i, least = min(least, l_i), most = max(most, m_i) at the slot of (s, a, s', ended), i = begin..
@njit(cache=True)
def add(table, rows, begin):
    """Add rows from ``begin`` on, in their order; the first that is left when the table is full, or how many there are."""
    room = np.int64(FULL * table.key.shape[0])
    for i in range(begin, len(rows.state)):
        if table.used[0] >= room:
            return i
        s, a, j, e = rows.state[i], rows.action[i], rows.next_state[i], rows.ended[i]
        x = _slot(table, s, a, j, e)
        if table.sums[x, 0] == 0.0:
            table.used[0] += 1
            table.key[x, 0], table.key[x, 1], table.key[x, 2], table.key[x, 3] = s, a, j, e
            table.sums[x, 2], table.sums[x, 3] = np.inf, -np.inf
        table.sums[x, 0] += rows.sums[i, 0]
        table.sums[x, 1] += rows.sums[i, 1]
        table.sums[x, 2] = min(table.sums[x, 2], rows.sums[i, 2])
        table.sums[x, 3] = max(table.sums[x, 3], rows.sums[i, 3])
    return len(rows.state)


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
