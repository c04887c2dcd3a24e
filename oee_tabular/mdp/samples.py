"""Samples behind an MDP of frequencies: how many there are of each pair, and the variance of mean rewards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.mdp.arrays import csr_from_entries


class Sampling(NamedTuple):
    """Samples that an MDP rests on.

    Attributes
    ----------
    pairs : (S*A,) samples of each (s, a): inf of terminal states, 0 where none was taken and the row was filled in
    starts : first states that were met, inf where the initial distribution was given
    reward_error : csr (S*A, S), the variance of the mean reward of each transition; None where rewards were given
    """

    pairs: Array
    starts: float
    reward_error: sparse.csr_array | None

    def mix_actions(self, n_actions: int) -> Sampling:
        """Those of an MDP with action noise: each pair rests on the least sampled action of its state."""
        least = self.pairs.reshape(-1, n_actions).min(axis=1)
        return self._replace(pairs=np.repeat(least, n_actions))


def compute_sampling(
    columns: tuple[IntArray, IntArray, IntArray, BoolArray], reward: Array | None, starts: float, terminal: IntArray,
    shape: tuple[int, int],
) -> Sampling:  # fmt: skip
    """Count samples (state, action, next state, terminated) of an MDP of that shape; ``reward`` None: it was given.

    The variance of a mean of k rewards is s^2 / k, s^2 the transition's own, or the pooled one where k = 1.
    """
    state, action, next_state, terminated = columns
    n_rows, n_states = shape
    n_actions = n_rows // n_states
    row = state * n_actions + action
    pairs = np.bincount(row, minlength=n_rows).astype(np.float64)
    is_terminal = np.zeros(n_states, dtype=np.bool_)
    is_terminal[terminal[next_state[terminated]]] = True
    is_terminal[state] = False
    pairs[np.repeat(is_terminal, n_actions)] = np.inf
    if reward is None:
        return Sampling(pairs, starts, None)
    to = np.where(terminated, terminal[next_state], next_state)
    number, total, squares = (csr_from_entries(row, to, w, shape) for w in (np.ones(len(row)), reward, reward**2))
    deviation = np.maximum(squares.data - total.data**2 / number.data, 0.0)
    freedom = float((number.data - 1.0).sum())
    pooled = float(deviation.sum()) / freedom if freedom else 0.0
    variance = np.where(number.data > 1, deviation / np.maximum(number.data - 1.0, 1.0), pooled) / number.data
    return Sampling(pairs, starts, sparse.csr_array((variance, number.indices, number.indptr), shape))
