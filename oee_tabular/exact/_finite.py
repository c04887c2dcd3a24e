"""Finite horizons: backward sweeps over all states, or over the light cone of the first ones; visits, gradients, forward.

    V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0;    d_{t+1} = P_pi^T d_t, d_0 = mu_0;    J = mu_0 . V_0 = sum_t gamma^t d_t . r_pi

Rows are read four entries at a time, with unsigned indices: signed ones, which could count from the end, cost twice as much.
Every sum keeps the order of its row.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from oee_tabular.exact._policy_rows import transpose_rows
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
def sweep(kernel, rewards, horizon):
    """V_0 = r + gamma K V_1, ..., V_T = 0."""
    n = len(rewards)
    value, other = np.zeros(n), np.zeros(n)
    for _ in range(horizon):
        backup(kernel, rewards, value, other, np.uint64(0), np.uint64(n))
        value, other = other, value
    return value


@njit(cache=True)
def enlarge(array, size):
    """The array, or a copy of twice the length where it is shorter than ``size``."""
    if size <= len(array):
        return array
    longer = np.zeros(2 * size, array.dtype)
    for i in range(len(array)):  # a slice's copy takes two seconds more to compile
        longer[i] = array[i]
    return longer


@njit(cache=True)
def light_cone(rows, policy, rewards, initial, discount, horizon, place):
    """What ``horizon`` rewards can depend on: a ``Cone``, its states in the order in which they are first reached.

    Rows are there only for states from which a transition still counts; a row's entries are in the order in which its actions
    have them, as in ``_policy_rows.average_rows``. ``place`` (S,) must be zeros, uint32; what is not reached is not read.
    """
    indptr, indices, data = rows
    n_actions = policy.shape[1]
    ends = np.zeros(horizon, np.int64)
    count, n_initial = 0, np.count_nonzero(initial)
    states = np.zeros(2 * n_initial + 64, np.uint32)
    last = np.zeros(len(states), np.int64)  # 1 + the last entry that leads to a state
    for s in range(len(initial)):
        if count == n_initial:
            break
        if initial[s] != 0.0:
            states[count] = s
            count += 1
            place[s] = count
    ends[0] = count
    start, column, value = np.zeros(len(states), np.uint32), np.zeros(256, np.uint32), np.zeros(256)
    n_rows, size = 0, 0
    for t in range(1, horizon):
        start = enlarge(start, count + 1)
        for i in range(n_rows, ends[t - 1]):
            row = np.int64(states[i]) * n_actions
            n_entries = np.int64(indptr[row + n_actions]) - np.int64(indptr[row])
            states, last = enlarge(states, count + n_entries), enlarge(last, count + n_entries)
            column, value = enlarge(column, size + n_entries), enlarge(value, size + n_entries)
            first = size
            for a in range(n_actions):
                share = policy[states[i], a]
                if share == 0.0:
                    continue
                for k in range(indptr[row + a], indptr[row + a + 1]):
                    if data[k] == 0.0:
                        continue
                    j = indices[k]
                    if place[j] == 0:
                        states[count] = j
                        count += 1
                        place[j] = count
                    to = np.int64(place[j]) - 1
                    if last[to] > first:
                        value[last[to] - 1] += share * data[k]
                    else:
                        column[size] = to
                        value[size] = share * data[k]
                        size += 1
                        last[to] = size
            start[i + 1] = size
        n_rows = ends[t - 1]
        ends[t] = count
    mean = np.zeros(count)
    for i in range(count):
        for a in range(n_actions):
            mean[i] += policy[states[i], a] * rewards[states[i], a]
    begin = np.zeros(ends[0])
    for i in range(ends[0]):
        begin[i] = initial[states[i]]
    return Cone(states[:count], ends, Kernel(start[: n_rows + 1], column[:size], value[:size], discount), mean, begin)


@njit(cache=True)
def cone_values(cone, is_each):
    """(T + 1,): J of 0 .. T rewards, a ring of the cone left out at each step; the last alone unless ``is_each``."""
    ends = cone.ends
    horizon = len(ends)
    out = np.zeros(horizon + 1)
    value, other = cone.rewards.copy(), np.zeros(len(cone.rewards))
    for k in range(1, horizon + 1):
        if k > 1:
            backup(cone.kernel, cone.rewards, value, other, np.uint64(0), np.uint64(ends[horizon - k]))
            value, other = other, value
        if is_each or k == horizon:
            out[k] = dot(cone.initial, value, ends[0])
    return out


@njit(cache=True)
def cone_visits(cone):
    """sum_{t<T} gamma^t Pr(s_t = s) of the cone's states: d_{t+1} = K^T d_t as far as t transitions reach."""
    ends = cone.ends
    indptr, indices, data, gamma = cone.kernel
    size = ends[-1]
    back = Kernel(*transpose_rows(indptr, indices, data, size), 1.0)
    nothing = np.zeros(size)
    here, there, total = np.zeros(size), np.zeros(size), np.zeros(size)
    here[: ends[0]] = cone.initial
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
def step_forward(rows, rewards, policy, initial, gamma, pairs):
    """(T + 1,): J of 0 .. T rewards of a policy (T, S, A), which is read as a whole before, so that S a step costs nothing.

    d_{t+1}(s') = sum_{s, a} d_t(s) policy_t(s, a) K(s' | s, a), J_{t+1} = J_t + gamma^t d_t . r. Where ``pairs`` (S, A) has
    room, sum_t gamma^t Pr(s_t = s, a_t = a) is added to it.
    """
    indptr, indices, data = rows
    horizon, n_states, n_actions = policy.shape
    out, keep = np.zeros(horizon + 1), len(pairs) > 0
    here, there, mean = initial.copy(), np.zeros(n_states), np.zeros(n_states)
    weight = 1.0
    for t in range(horizon):
        for s in range(n_states):
            mass, mean[s] = here[s], 0.0
            if mass == 0.0:
                continue
            for a in range(n_actions):
                share = mass * policy[t, s, a]
                mean[s] += policy[t, s, a] * rewards[s, a]
                if keep:
                    pairs[s, a] += weight * share
                if share == 0.0 or t + 1 == horizon:
                    continue
                row = s * n_actions + a
                for k in range(indptr[row], indptr[row + 1]):
                    there[indices[k]] += share * data[k]
        out[t + 1] = out[t] + weight * dot(here, mean, n_states)
        weight *= gamma
        here[:] = 0.0
        here, there = there, here
    return out


@njit(cache=True)
def values_to_go(kernel, rewards, out):
    """Fill ``out`` (T + 1, S): V_t = r + gamma K V_{t+1}, V_T = 0."""
    out[-1] = 0.0
    for t in range(len(out) - 2, -1, -1):
        backup(kernel, rewards, out[t + 1], out[t], np.uint64(0), np.uint64(len(rewards)))


@njit(cache=True)
def gradient_flows(to_go, gamma, back, initial, rows, policy, rewards, out):
    """out[k] += sum_t gamma^t d_t(s) (r[k] + gamma V_{t+1}(s')) for the entries k of the actions that are taken.

    ``to_go`` (T + 1, S) is V; ``back`` is the transposed kernel that d is of, with discount 1; ``rows`` (S*A, S) has the
    entries, ``rewards`` r(s, a, s') is aligned with them or empty.
    """
    indptr, columns, _ = rows
    n_states, n_actions = policy.shape
    nothing, here, there = np.zeros(n_states), initial.copy(), np.zeros(n_states)
    weight = 1.0
    for t in range(len(to_go) - 1):
        for s in range(n_states):
            mass = weight * here[s]
            if mass == 0.0:
                continue
            for a in range(n_actions):
                if policy[s, a] == 0.0:
                    continue
                row = s * n_actions + a
                for k in range(indptr[row], indptr[row + 1]):
                    out[k] += mass * ((rewards[k] if len(rewards) else 0.0) + gamma * to_go[t + 1, columns[k]])
        backup(back, nothing, here, there, np.uint64(0), np.uint64(n_states))
        here, there = there, here
        weight *= gamma
