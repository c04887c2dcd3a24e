"""Finite horizons: backward sweeps over all states, or over the light cone of the first ones; and visits, forward.

Index arrays are unsigned, and rows are read four entries at a time: signed ones, which could count from the end, cost twice
as much. Every sum keeps the order of its row, so that a value has the same bits in whichever sweep it is worked out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

CHUNK = 128  # terms of a long sum that are added before the sum of these sums: rounding grows with n / 128


def backup(
    indptr: Any, indices: Any, data: Any, rewards: Any, gamma: Any, ahead: Any, out: Any, first: Any, last: Any
) -> Any:
    """out = rewards + gamma K ahead on the rows first .. last - 1 (uint64)."""
    one, four = np.uint64(1), np.uint64(4)
    x = np.uint64(indptr[first])
    for s in range(first, last):
        end = np.uint64(indptr[s + one])
        total = 0.0
        while x + four <= end:  # one addition after the other all the same
            total += data[x] * ahead[indices[x]]
            total += data[x + one] * ahead[indices[x + one]]
            total += data[x + np.uint64(2)] * ahead[indices[x + np.uint64(2)]]
            total += data[x + np.uint64(3)] * ahead[indices[x + np.uint64(3)]]
            x += four
        while x < end:
            total += data[x] * ahead[indices[x]]
            x += one
        out[s] = rewards[s] + gamma * total


backup = njit(cache=True)(backup)


def dot(x: Any, y: Any, size: Any) -> Any:
    """x . y over the first ``size`` entries."""
    total = 0.0
    for low in range(0, size, CHUNK):
        part = 0.0
        for i in range(low, min(size, low + CHUNK)):
            part += x[i] * y[i]
        total += part
    return total


dot = njit(cache=True)(dot)


def bandwidth(indptr: Any, indices: Any) -> Any:
    """The largest |s - s'| of an entry."""
    widest: Any = 0
    for s in range(len(indptr) - 1):
        for x in range(indptr[s], indptr[s + 1]):
            widest = max(widest, abs(np.int64(indices[x]) - s))
    return widest


bandwidth = njit(cache=True)(bandwidth)


def sweep(
    indptr: Any, indices: Any, data: Any, rewards: Any, gamma: Any, steps: Any, band: Any, height: Any, width: Any
) -> Any:
    """V with ``steps`` rewards to go, ``height`` steps at a time in blocks of ``width`` rows that move back by ``band`` a step.

    A row at one step needs rows at most ``band`` away at the step before, and the two buffers hold both until nothing asks
    for the older: so a block goes through several steps while it is in the cache. Height 1 is the plain sweep.
    """
    n = len(rewards)
    value, other = np.zeros(n), np.zeros(n)
    done = 0
    while done < steps:
        now = min(height, steps - done)
        if now == 1:
            backup(indptr, indices, data, rewards, gamma, value, other, np.uint64(0), np.uint64(n))
            value, other = other, value
            done += 1
            continue
        for low in range(0, n + (now - 1) * band, width):
            ahead, out = value, other
            for t in range(now):
                first, last = max(0, low - t * band), min(n, low + width - t * band)
                if first < last:
                    backup(indptr, indices, data, rewards, gamma, ahead, out, np.uint64(first), np.uint64(last))
                ahead, out = out, ahead
        if now % 2:
            value, other = other, value
        done += now
    return value


sweep = njit(cache=True)(sweep)


def grown(array: Any, size: Any) -> Any:
    """The array, or a copy of twice the length where it is shorter than ``size``."""
    if size <= len(array):
        return array
    longer = np.zeros(2 * size, array.dtype)
    longer[: len(array)] = array
    return longer


grown = njit(cache=True)(grown)


def light_cone(
    indptr: Any, indices: Any, data: Any, rewards: Any, policy: Any, initial: Any, steps: Any, place: Any
) -> Any:
    """What ``steps`` rewards can depend on: states in the order in which they are first reached, and rows of P_pi among them.

    Rows have their entries in the order in which the actions do, and sums too, as ``policy_rows.average_rows`` has them.
    Returns states, ends (those reached in at most k moves are the first ends[k]), and the rows indptr, indices, data,
    rewards and initial under the new numbers; rows are there only for states from which a move still counts. ``place`` (S,)
    must be zeros, uint32; what is not reached is not read.
    """
    n_actions = policy.shape[1]
    ends = np.zeros(steps, np.int64)
    support, count = 0, 0
    for s in range(len(initial)):
        support += initial[s] != 0.0
    states = np.zeros(2 * support + 64, np.uint32)
    last = np.zeros(len(states), np.int64)  # 1 + the last entry that leads to a state
    for s in range(len(initial)):
        if count == support:
            break
        if initial[s] != 0.0:
            states[count] = s
            count += 1
            place[s] = count
    ends[0] = count
    start, column, value = np.zeros(len(states), np.uint32), np.zeros(256, np.uint32), np.zeros(256)
    done, size = 0, 0
    for k in range(1, steps):
        start = grown(start, count + 1)
        for i in range(done, ends[k - 1]):
            row = np.int64(states[i]) * n_actions
            most = np.int64(indptr[row + n_actions]) - np.int64(
                indptr[row]
            )  # room for a state at once: it is slow to ask
            if count + most > len(states):
                states, last = grown(states, count + most), grown(last, count + most)
            if size + most > len(value):
                column, value = grown(column, size + most), grown(value, size + most)
            first, zeros = size, False
            for a in range(n_actions):
                share = policy[states[i], a]
                if share == 0.0:
                    continue
                for x in range(indptr[row + a], indptr[row + a + 1]):
                    zeros |= data[x] == 0.0
                    j = indices[x]
                    if place[j] == 0:
                        states[count] = j
                        count += 1
                        place[j] = count
                    to = np.int64(place[j]) - 1
                    if last[to] > first:
                        value[last[to] - 1] += share * data[x]
                    else:
                        column[size] = to
                        value[size] = share * data[x]
                        size += 1
                        last[to] = size
            if zeros:
                kept = first
                for x in range(first, size):
                    last[column[x]] = 0  # entries move up, and the next row begins where this one had some
                    if value[x] != 0.0:
                        column[kept], value[kept] = column[x], value[x]
                        kept += 1
                size = kept
            start[i + 1] = size
        done = ends[k - 1]
        ends[k] = count
    pay = np.zeros(count)
    for i in range(count):
        for a in range(n_actions):
            pay[i] += policy[states[i], a] * rewards[states[i], a]
    begin = np.zeros(ends[0])
    for i in range(ends[0]):
        begin[i] = initial[states[i]]
    return states[:count], ends, start[: done + 1], column[:size], value[:size], pay, begin


light_cone = njit(cache=True)(light_cone)


def cone_values(ends: Any, indptr: Any, indices: Any, data: Any, rewards: Any, initial: Any, gamma: Any) -> Any:
    """(T + 1,): J of 0 .. T rewards, by a sweep that leaves one ring of the cone out at each step."""
    steps = len(ends)
    found = np.zeros(steps + 1)
    value, other = rewards.copy(), np.zeros(len(rewards))
    for k in range(1, steps + 1):
        if k > 1:
            backup(indptr, indices, data, rewards, gamma, value, other, np.uint64(0), np.uint64(ends[steps - k]))
            value, other = other, value
        found[k] = dot(initial, value, ends[0])
    return found


cone_values = njit(cache=True)(cone_values)


def transposed(indptr: Any, indices: Any, data: Any, n_columns: Any) -> Any:
    """The CSR arrays of the transpose; within a row in the order of the rows that they came from."""
    start = np.zeros(n_columns + 1, np.int64)
    for x in range(len(indices)):
        start[np.int64(indices[x]) + 1] += 1
    for j in range(n_columns):
        start[j + 1] += start[j]
    fill = start[:-1].copy()
    column, value = np.zeros(len(indices), np.uint32), np.zeros(len(indices))
    for s in range(len(indptr) - 1):
        for x in range(indptr[s], indptr[s + 1]):
            at = fill[indices[x]]
            column[at] = s
            value[at] = data[x]
            fill[indices[x]] += 1
    return start, column, value


transposed = njit(cache=True)(transposed)


def cone_visits(ends: Any, indptr: Any, indices: Any, data: Any, initial: Any, gamma: Any) -> Any:
    """sum_{t<T} gamma^t Pr(s_t = s) of the cone's states, gathered through the transpose as far as t moves reach."""
    size = ends[-1]
    start, column, value = transposed(indptr, indices, data, size)
    nothing = np.zeros(size)
    here, there, total = np.zeros(size), np.zeros(size), np.zeros(size)
    here[: ends[0]] = initial
    weight = 1.0
    for t in range(len(ends)):
        for i in range(ends[t]):
            total[i] += weight * here[i]
        if t + 1 < len(ends):
            backup(start, column, value, nothing, 1.0, here, there, np.uint64(0), np.uint64(ends[t + 1]))
            here, there = there, here
        weight *= gamma
    return total


cone_visits = njit(cache=True)(cone_visits)


def gradient_flows(
    indptr: Any, indices: Any, data: Any, rewards: Any, to_go: Any, back_indptr: Any, back_indices: Any, back_data: Any,
    initial: Any, gamma: Any, rows: Any, columns: Any, policy: Any, pay: Any, found: Any,
) -> Any:  # fmt: skip
    """found[x] += sum_t gamma^t d_t(s) (pay[x] + gamma V_{t+1}(s')) for the entries x of the actions that are taken.

    The first four are the kernel that V is of, filled into ``to_go`` (T + 1, S); then the transposed kernel that d is of;
    ``rows`` (S*A + 1,) and ``columns`` the entries, ``pay`` aligned with them or empty.
    """
    steps, n = to_go.shape[0] - 1, to_go.shape[1]
    n_actions = policy.shape[1]
    to_go[steps] = 0.0
    for t in range(steps - 1, -1, -1):
        backup(indptr, indices, data, rewards, gamma, to_go[t + 1], to_go[t], np.uint64(0), np.uint64(n))
    nothing, here, there = np.zeros(n), initial.copy(), np.zeros(n)
    weight = 1.0
    for t in range(steps):
        ahead = to_go[t + 1]
        for s in range(n):
            mass = weight * here[s]
            if mass == 0.0:
                continue
            for a in range(n_actions):
                if policy[s, a] == 0.0:
                    continue
                row = s * n_actions + a
                for x in range(rows[row], rows[row + 1]):
                    found[x] += mass * ((pay[x] if len(pay) else 0.0) + gamma * ahead[columns[x]])
        backup(back_indptr, back_indices, back_data, nothing, 1.0, here, there, np.uint64(0), np.uint64(n))
        here, there = there, here
        weight *= gamma


gradient_flows = njit(cache=True)(gradient_flows)
