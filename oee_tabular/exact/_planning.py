"""Modified policy iteration, until its actions stand: sweeps over all actions, and sweeps over those that were best [1, 6.5].

Only differences between states matter to actions, so that it is the spread of the changes that has to fall: the change that all
states share is left out, and the discount does not slow it down. In the end it is summed: the values of the last actions are
what is left plus gamma / (1 - gamma) of it.

Reference: [1] Puterman, Markov Decision Processes, 1994.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def improve(rows, rewards, discount, values, new, actions):
    """The best actions, the first of equals, for these values; new = max_a Q; the spread of new - values, the largest value."""
    indptr, indices, data = rows
    n_states, n_actions = rewards.shape
    low, high, largest, row = np.inf, -np.inf, 0.0, np.uint32(0)
    for state in range(n_states):
        best, chosen = -np.inf, 0
        for action in range(n_actions):
            total = 0.0
            for k in range(indptr[row], indptr[row + np.uint32(1)]):
                total += data[k] * values[indices[k]]
            row += np.uint32(1)
            total = rewards[state, action] + discount * total
            if total > best:
                best, chosen = total, action
        new[state], actions[state] = best, chosen
        change = best - values[state]
        low = min(low, change)
        high = max(high, change)
        largest = max(largest, abs(best))
    return high - low, largest


@njit(cache=True)
def sweep_actions(rows, rewards, discount, actions, values, new):
    """new = r + gamma P values for these actions; the least and the largest change."""
    indptr, indices, data = rows
    low, high = np.inf, -np.inf
    for state in range(len(actions)):
        row = np.uint32(state * rewards.shape[1] + actions[state])
        total = 0.0
        for k in range(indptr[row], indptr[row + np.uint32(1)]):
            total += data[k] * values[indices[k]]
        value = rewards[state, actions[state]] + discount * total
        change = value - values[state]
        new[state] = value
        low = min(low, change)
        high = max(high, change)
    return low, high


@njit(cache=True)
def iterate_modified(rows, rewards, discount, relative, values, n_turns):
    """(S,) actions, after at most so many turns from these values, about their values, and whether the actions stand.

    The values are swept to rounding while four sweeps halve what is missing, as they do where a graph mixes.
    """
    n = len(rewards)
    values, new, actions, stands = values.copy(), np.empty(n), np.zeros(n, dtype=np.int64), False
    for _ in range(n_turns):
        spread, largest = improve(rows, rewards, discount, values, new, actions)
        values, new = new, values
        if not spread > relative * largest:
            stands = True
            break
        for _ in range(20):
            low, high = sweep_actions(rows, rewards, discount, actions, values, new)
            values, new = new, values
            if high - low <= 0.1 * spread:
                break
    factor, allowed = discount / (1.0 - discount), np.inf
    for sweep in range(200):
        low, high = sweep_actions(rows, rewards, discount, actions, values, new)
        values, new = new, values
        shift = factor * 0.5 * (low + high)
        if not high - low > 2e-16 * max(largest, abs(shift)) or (sweep % 4 == 0 and high - low > allowed):
            break
        if sweep % 4 == 0:
            allowed = 0.5 * (high - low)
    return actions, values + shift, stands


@njit(cache=True)
def find_better_actions(rows, rewards, discount, values, actions, relative):
    """For values of these actions: the first of a state's best actions up to rounding, and whether it is better by more."""
    indptr, indices, data = rows
    n_states, n_actions = rewards.shape
    q, row, largest = np.empty((n_states, n_actions)), np.uint32(0), 0.0
    for state in range(n_states):
        for action in range(n_actions):
            total = 0.0
            for k in range(indptr[row], indptr[row + np.uint32(1)]):
                total += data[k] * values[indices[k]]
            row += np.uint32(1)
            q[state, action] = rewards[state, action] + discount * total
            largest = max(largest, abs(q[state, action]))
    first, gains = np.empty(n_states, dtype=np.int64), np.empty(n_states, dtype=np.bool_)
    for state in range(n_states):
        best = q[state].max()
        gains[state] = best > q[state, actions[state]] + relative * largest
        first[state] = 0
        while q[state, first[state]] < best - relative * largest:
            first[state] += 1
    return first, gains
