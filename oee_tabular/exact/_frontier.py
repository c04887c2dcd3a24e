"""Policies: their check, where their episodes are over, and what one whose actions depend on time reaches, forward."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

CHUNK = 128  # terms of a long sum that are added before the sum of these sums


def stochastic(policy: Any, tolerance: Any) -> Any:
    """Whether no entry of (N, A) is negative (or nan) and every row sums to 1."""
    if policy.shape[1] == 4:  # a stride that is known: several rows are read at once, in a third of the time
        flat, bad = policy.reshape(-1), 0
        for s in range(policy.shape[0]):
            first, second, third, fourth = flat[4 * s], flat[4 * s + 1], flat[4 * s + 2], flat[4 * s + 3]
            bad += 0 if abs(first + second + third + fourth - 1.0) <= tolerance else 1
            bad += 0 if first >= 0.0 else 1
            bad += 0 if second >= 0.0 else 1
            bad += 0 if third >= 0.0 else 1
            bad += 0 if fourth >= 0.0 else 1
        return bad == 0
    for s in range(policy.shape[0]):
        total = 0.0
        for a in range(policy.shape[1]):
            if not policy[s, a] >= 0.0:
                return False
            total += policy[s, a]
        if not abs(total - 1.0) <= tolerance:
            return False
    return True


stochastic = njit(cache=True)(stochastic)


def absorbing(indptr: Any, indices: Any, rewards: Any) -> Any:
    """(S,) whether every action leads back to the state and pays nothing: ``FiniteMDP.absorbing``."""
    n_states, n_actions = rewards.shape
    over = np.ones(n_states, np.bool_)
    for s in range(n_states):
        for a in range(n_actions):
            if rewards[s, a] != 0.0:
                over[s] = False
        if not over[s]:
            continue
        for x in range(indptr[s * n_actions], indptr[(s + 1) * n_actions]):
            if indices[x] != s:
                over[s] = False
    return over


absorbing = njit(cache=True)(absorbing)


def frontier(
    indptr: Any, indices: Any, data: Any, rewards: Any, policy: Any, initial: Any, gamma: Any, here: Any, there: Any,
    reached: Any, pairs: Any, keep: Any,
) -> Any:  # fmt: skip
    """(T + 1,): J of 0 .. T rewards of a policy (T, S, A), step by step over the states that are reached at t exactly.

    ``here``, ``there`` (S,) and ``reached`` (S, uint32) must be zeros. If ``keep``, sum_t gamma^t Pr(s_t = s, a_t = a) is
    added to ``pairs`` (S, A).
    """
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


frontier = njit(cache=True)(frontier)
