"""Finite horizons: backward sweeps over all states, or over the light cone of the first ones; and visits, forward.

    V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0;    d_{t+1} = P_pi^T d_t, d_0 = mu_0;    J = mu_0 . V_0 = sum_t gamma^t d_t . r_pi

Rows are read four entries at a time, with unsigned indices: signed ones, which could count from the end, cost twice as much.
Every sum keeps the order of its row, so that a value has the same bits in whichever sweep it is worked out.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from oee_tabular.exact._policy_rows import transposed
from oee_tabular.exact.system import Kernel

CHUNK = 128  # terms of a long sum that are added before the sum of these sums: rounding grows with n / 128

# states; those reached in at most k moves are the first ends[k]; P_pi, rewards and initial under the new numbers
Cone = namedtuple("Cone", "states ends kernel rewards initial")


@njit(cache=True)
def backup(kernel, rewards, ahead, out, first, last):
    """out = rewards + gamma K ahead on the rows first .. last - 1 (uint64)."""
    indptr, indices, data, gamma = kernel
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


@njit(cache=True)
def dot(x, y, size):
    """x . y over the first ``size`` entries; where x is 0, y may be infinite."""
    total, part, terms = 0.0, 0.0, 0
    for i in range(size):
        if x[i] != 0.0:
            part += x[i] * y[i]
            terms += 1
            if terms == CHUNK:
                total, part, terms = total + part, 0.0, 0
    return total + part


@njit(cache=True)
def sweep(kernel, rewards, steps):
    """V with ``steps`` rewards to go: V_t = r + gamma K V_{t+1}, V_T = 0."""
    n = len(rewards)
    value, other = np.zeros(n), np.zeros(n)
    for _ in range(steps):
        backup(kernel, rewards, value, other, np.uint64(0), np.uint64(n))
        value, other = other, value
    return value


@njit(cache=True)
def grown(array, size):
    """The array, or a copy of twice the length where it is shorter than ``size``."""
    if size <= len(array):
        return array
    longer = np.zeros(2 * size, array.dtype)
    for i in range(len(array)):  # a slice's copy takes two seconds more to compile
        longer[i] = array[i]
    return longer


@njit(cache=True)
def light_cone(rows, policy, rewards, initial, discount, steps, place):
    """What ``steps`` rewards can depend on: a ``Cone``, its states in the order in which they are first reached.

    Rows have their entries in the order in which the actions do, and sums too, as ``_policy_rows.average_rows`` has them; they
    are there only for states from which a move still counts. ``place`` (S,) must be zeros, uint32; what is not reached is not
    read.
    """
    indptr, indices, data = rows
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
    kernel = Kernel(start[: done + 1], column[:size], value[:size], discount)
    return Cone(states[:count], ends, kernel, pay, begin)


@njit(cache=True)
def cone_values(cone):
    """(T + 1,): J of 0 .. T rewards, by a sweep that leaves one ring of the cone out at each step."""
    ends = cone.ends
    steps = len(ends)
    found = np.zeros(steps + 1)
    value, other = cone.rewards.copy(), np.zeros(len(cone.rewards))
    for k in range(1, steps + 1):
        if k > 1:
            backup(cone.kernel, cone.rewards, value, other, np.uint64(0), np.uint64(ends[steps - k]))
            value, other = other, value
        found[k] = dot(cone.initial, value, ends[0])
    return found


@njit(cache=True)
def cone_visits(cone):
    """sum_{t<T} gamma^t Pr(s_t = s) of the cone's states, gathered through the transpose as far as t moves reach."""
    ends = cone.ends
    indptr, indices, data, gamma = cone.kernel
    size = ends[-1]
    back = Kernel(*transposed(indptr, indices, data, size), 1.0)
    nothing = np.zeros(size)
    here, there, total = np.zeros(size), np.zeros(size), np.zeros(size)
    for i in range(len(cone.initial)):
        here[i] = cone.initial[i]
    weight = 1.0
    for t in range(len(ends)):
        for i in range(ends[t]):
            total[i] += weight * here[i]
        if t + 1 < len(ends):
            backup(back, nothing, here, there, np.uint64(0), np.uint64(ends[t + 1]))
            here, there = there, here
        weight *= gamma
    return total


@njit(cache=True)
def frontier(rows, rewards, policy, initial, gamma, here, there, reached, pairs, keep):
    """(T + 1,): J of 0 .. T rewards of a policy (T, S, A), step by step over the states that are reached at t exactly.

    ``here``, ``there`` (S,) and ``reached`` (S, uint32) must be zeros. If ``keep``, sum_t gamma^t Pr(s_t = s, a_t = a) is
    added to ``pairs`` (S, A).
    """
    indptr, indices, data = rows
    steps, n_states, n_actions = policy.shape
    found = np.zeros(steps + 1)
    active = np.zeros(n_states, np.uint32)
    following = np.zeros(n_states, np.uint32)
    count = 0
    for s in range(n_states):
        if initial[s] != 0.0:
            here[s] = initial[s]
            active[count] = s
            count += 1
    weight = 1.0
    for t in range(steps):
        total, part, coming = 0.0, 0.0, 0
        for i in range(count):
            s = active[i]
            mass = here[s]
            here[s] = 0.0
            for a in range(n_actions):
                share = mass * policy[t, s, a]
                part += share * rewards[s, a]
                if keep:
                    pairs[s, a] += weight * share
                if share == 0.0 or t + 1 == steps:
                    continue
                row = np.int64(s) * n_actions + a
                for x in range(indptr[row], indptr[row + 1]):
                    j = indices[x]
                    if reached[j] != t + 1:
                        reached[j] = t + 1
                        following[coming] = j
                        coming += 1
                    there[j] += share * data[x]
            if i % CHUNK == CHUNK - 1:
                total += part
                part = 0.0
        found[t + 1] = found[t] + weight * (total + part)
        weight *= gamma
        here, there = there, here
        active, following = following, active
        count = coming
    return found


@njit(cache=True)
def gradient_flows(kernel, rewards, to_go, back, initial, rows, policy, pay, found):
    """found[x] += sum_t gamma^t d_t(s) (pay[x] + gamma V_{t+1}(s')) for the entries x of the actions that are taken.

    ``kernel`` and ``rewards`` are those that V is of, filled into ``to_go`` (T + 1, S); ``back`` is the transposed kernel that
    d is of, with discount 1; ``rows`` (S*A, S) has the entries, ``pay`` is aligned with them or empty.
    """
    gamma, (indptr, columns, _) = kernel.discount, rows
    steps, n = to_go.shape[0] - 1, to_go.shape[1]
    n_actions = policy.shape[1]
    to_go[steps] = 0.0
    for t in range(steps - 1, -1, -1):
        backup(kernel, rewards, to_go[t + 1], to_go[t], np.uint64(0), np.uint64(n))
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
                for x in range(indptr[row], indptr[row + 1]):
                    found[x] += mass * ((pay[x] if len(pay) else 0.0) + gamma * ahead[columns[x]])
        backup(back, nothing, here, there, np.uint64(0), np.uint64(n))
        here, there = there, here
        weight *= gamma
