"""The paper's gridworld (Section VI.A).

N x N cells (row, column), numbered row * N + column; start (0, 0), goal (N-1, N-1), absorbing, with no reward from then
on. Actions: 0 row + 1, 1 row - 1, 2 column + 1, 3 column - 1. The intended direction is taken with probability 1 - slip,
each of the other three with slip / 3; a move into a wall stays in place. Reward: -0.2 times the Manhattan distance to
the goal. The layout has row and column.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp import FiniteMDP, mix
from oee_tabular.mdp.policies import deterministic_policy

MOVES = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
STATE_BYTES = 1800.0  # that are taken for each state while an MDP is made, measured


def _destinations(size: int) -> IntArray:
    """(S, 4): where each direction leads, walls included."""
    row, column = np.divmod(np.arange(size * size), size)
    to_row = np.clip(row[:, None] + MOVES[:, 0], 0, size - 1)
    to_column = np.clip(column[:, None] + MOVES[:, 1], 0, size - 1)
    return np.asarray(to_row * size + to_column)


def gridworld(size: int, slip: float, *, pay: Literal["next", "current"] = "next", discount: float = 0.99) -> FiniteMDP:
    """The gridworld of ``size`` x ``size`` cells as a FiniteMDP.

    Parameters
    ----------
    size : int of at least 2
    slip : float in [0, 1]
        Probability of not moving in the intended direction (the paper's epsilon: 0.3 simulated, 0.1 real).
    pay : "next" | "current"
        Whether a step pays for the cell that it enters, r(s, a, s') = -0.2 distance(s'), or for the one it leaves,
        r(s) = -0.2 distance(s). The two differ by one step of discounting and the first reward.
    discount : float in [0, 1]

    Examples
    --------
    >>> gridworld(10, slip=0.3)
    FiniteMDP(100 states, 4 actions, 1576 transitions, rewards r(s, a, s'), discount 0.99)
    """
    n = _checks.positive_integer(size, "size")
    _checks.require_memory(STATE_BYTES * n * n, "size", n, size=1)
    if n < 2:
        raise ValueError(f"size must be at least 2; it is {n}")
    wrong = _checks.number_in(slip, "slip", 0.0, 1.0)
    _checks.one_of(pay, "pay", ("next", "current"))
    n_states = n * n
    goal = n_states - 1
    destinations = _destinations(n)
    destinations[goal] = goal
    weights = np.full((4, 4), wrong / 3.0)
    np.fill_diagonal(weights, 1.0 - wrong)
    rows = np.repeat(np.arange(n_states * 4), 4)
    columns = np.repeat(destinations, 4, axis=0).reshape(-1)  # for each action, the four directions
    data = np.tile(weights.reshape(-1), n_states)
    data[goal * 16 :] = np.tile([1.0, 0.0, 0.0, 0.0], 4)  # exactly 1, which the sum of the four need not be
    transitions = sparse.csr_array((data, (rows, columns)), shape=(n_states * 4, n_states))
    row, column = np.divmod(np.arange(n_states), n)
    payment = 0.2 * (row + column - (2 * n - 2))
    rewards: Array | sparse.csr_array = payment
    if pay == "next":
        transitions.sum_duplicates()
        transitions.eliminate_zeros()
        rewards = sparse.csr_array(
            (payment[transitions.indices], transitions.indices, transitions.indptr), transitions.shape
        )
    initial = np.zeros(n_states)
    initial[0] = 1.0
    return FiniteMDP(transitions, rewards, initial, discount, layout=np.column_stack([row, column]))


def gridworld_expert(size: int) -> Array:
    """The paper's expert, (S, 4): raise the row until the last one, then the column.

    Parameters
    ----------
    size : int

    Examples
    --------
    >>> gridworld_expert(3).argmax(axis=1).tolist()
    [0, 0, 0, 0, 0, 0, 2, 2, 2]
    """
    n = _checks.positive_integer(size, "size")
    _checks.require_memory(100.0 * n * n, "size", n)
    row = np.arange(n * n) // n
    return deterministic_policy(np.where(row < n - 1, 0, 2), 4)


def gridworld_policy(size: int, delta: float) -> Array:
    """pi_delta = delta * expert + (1 - delta) * uniform, (S, 4).

    Parameters
    ----------
    size : int
    delta : float in [0, 1]: the share of the expert

    Examples
    --------
    >>> gridworld_policy(3, 0.8)[0].round(6).tolist()
    [0.85, 0.05, 0.05, 0.05]
    """
    expert = gridworld_expert(size)
    return mix(expert, np.full_like(expert, 0.25), _checks.number_in(delta, "delta", 0.0, 1.0))
