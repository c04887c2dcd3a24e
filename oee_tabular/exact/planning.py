"""Optimal policies: modified policy iteration, then policy iteration with exact values, which certifies.

Modified policy iteration sweeps over all actions, and over those that were best [1, 6.5]. Only differences between states
matter to actions, so that it is the spread of the changes that has to fall: the change that all states share is left out, and
the discount does not slow it down. In the end it is summed: the values of the last actions are what is left plus
gamma / (1 - gamma) of it.

Reference: [1] Puterman, Markov Decision Processes, 1994.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.exact.solvers.envelope import EnvelopeLU
from oee_tabular.exact.system import Csr, policy_system, rows_of
from oee_tabular.exact.values import action_values, infinite_values, warn_if_not_finite
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.mdp.horizons import limit_horizon

N_TURNS = 100  # of modified policy iteration, at most
N_TURNS_NARROW = 3  # where a graph is narrow: exact evaluation is then as quick as some sweeps


def optimal_policy(mdp: FiniteMDP, *, horizon: int | None = None) -> Array:
    """A deterministic optimal policy: (S, A), or (T, S, A) for a horizon T.

    Modified policy iteration until the actions stand, then policy iteration (Puterman, Markov Decision Processes, 1994,
    sections 6.5 and 6.4) with exact evaluation, once where they were right: an action is changed only where another one is
    better by more than rounding (1e-11 of the largest value, and less where 1 - discount is below 1e-5: what is lost so stays
    below a millionth of it up to discount 1 - 1e-8); of equally good actions the first is taken. With a horizon, backward
    induction.

    Parameters
    ----------
    mdp : FiniteMDP
    horizon : T, a positive int, or None

    Raises
    ------
    ValueError
        At discount 1 without a horizon, where a policy met on the way is not absorbed.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.FiniteMDP([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1.0, 0.0], [2.0, 2.0]], [1, 0], 0.9)
    >>> optimal_policy(mdp).argmax(axis=1).tolist()  # leave state 0, for 2 a step from then on
    [1, 0]
    >>> optimal_policy(mdp, horizon=3).argmax(axis=2).tolist()  # but not when there is no time left
    [[1, 0], [0, 0], [0, 0]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    steps = _checks.optional_horizon(horizon)
    model = rows_of(mdp.csr), mdp.rewards, mdp.discount
    if steps is not None:
        length = limit_horizon(steps, 1.0, work=mdp.transitions.nnz, kept=mdp.rewards.size)
        return np.asarray(np.eye(mdp.n_actions)[induce_backward(*model, length)])
    actions, values = _begin(mdp, *model)
    rounding = 1e-11 if mdp.discount == 1.0 else min(max(1e-6 * (1.0 - mdp.discount), 1e-14), 1e-11)
    met: set[bytes] = set()
    while True:
        met.add(actions.tobytes())
        policy = np.eye(mdp.n_actions)[actions]
        values = infinite_values(mdp, policy, near=values).values
        first, is_better = find_better_actions(*model, warn_if_not_finite(values), actions, rounding)
        changed = np.where(is_better, first, actions)
        if not is_better.any() or changed.tobytes() in met:
            # among equals the first; at discount 1 an equal action may never be absorbed, so the one evaluated stays
            return policy if mdp.discount == 1.0 else np.eye(mdp.n_actions)[first]
        actions = changed


def _begin(mdp: FiniteMDP, rows: Csr, rewards: Array, discount: float) -> tuple[IntArray, Array | None]:
    """(S,) actions that are good already, and about their values."""
    if discount == 1.0:  # a greedy start may never be absorbed; the uniform policy is, if any is
        return action_values(mdp, uniform_policy(mdp)).argmax(axis=1), None
    is_narrow = mdp.n_states > 100 and EnvelopeLU(is_narrow=True).suits(policy_system(mdp, uniform_policy(mdp)))
    actions, values = iterate_modified(rows, rewards, discount, 1e-9, N_TURNS_NARROW if is_narrow else N_TURNS)
    return actions, values


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
def induce_backward(rows, rewards, discount, horizon):
    """(T, S): the best actions with T - t rewards to go."""
    n = len(rewards)
    value, ahead, actions = np.zeros(n), np.zeros(n), np.zeros((horizon, n), dtype=np.int64)
    for t in range(horizon - 1, -1, -1):
        improve(rows, rewards, discount, ahead, value, actions[t])
        value, ahead = ahead, value
    return actions


@njit(cache=True)
def iterate_modified(rows, rewards, discount, relative, n_turns):
    """(S,) actions, after at most so many turns or where they stand, and about their values.

    The values are swept to rounding while four sweeps halve what is missing, as they do where a graph mixes.
    """
    n = len(rewards)
    values, new, actions = np.zeros(n), np.empty(n), np.zeros(n, dtype=np.int64)
    for _ in range(n_turns):
        spread, largest = improve(rows, rewards, discount, values, new, actions)
        values, new = new, values
        if not spread > relative * largest:
            break
        for _ in range(20):
            low, high = sweep_actions(rows, rewards, discount, actions, values, new)
            values, new = new, values
            if high - low <= 0.1 * spread:
                break
    factor, allowed = discount / (1.0 - discount), np.inf
    for turn in range(200):
        low, high = sweep_actions(rows, rewards, discount, actions, values, new)
        values, new = new, values
        shift = factor * 0.5 * (low + high)
        if not high - low > 2e-16 * max(largest, abs(shift)) or (turn % 4 == 0 and high - low > allowed):
            break
        if turn % 4 == 0:
            allowed = 0.5 * (high - low)
    return actions, values + shift


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
