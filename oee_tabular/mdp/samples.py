"""Samples behind an MDP of frequencies: how many there are of each pair, and the variance of mean rewards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import csr_from_parts
from oee_tabular.mdp.arrays import csr_from_entries

_PREFIX = "sampling_"


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

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any], shape: tuple[int, int]) -> Sampling | None:
        """Those of a file's arrays, of an MDP with rows of ``shape``; None where it has none."""
        if f"{_PREFIX}pairs" not in arrays:
            return None
        pairs = _checks.float_array(arrays[f"{_PREFIX}pairs"], f"{_PREFIX}pairs", ndim=1)
        starts = float(_checks.float_array(arrays[f"{_PREFIX}starts"], f"{_PREFIX}starts", ndim=0))
        if pairs.shape != shape[:1] or not (pairs >= 0).all() or not starts > 0:
            raise ValueError(f"{_PREFIX}pairs must be {shape[0]} numbers of samples, and {_PREFIX}starts positive")
        error = None
        if f"{_PREFIX}error_data" in arrays:
            data, indices, indptr = (arrays[f"{_PREFIX}error_{part}"] for part in ("data", "indices", "indptr"))
            error = csr_from_parts(data, indices, indptr, shape, f"{_PREFIX}error")
        return cls(pairs, starts, error)

    def arrays(self) -> dict[str, Any]:
        """What a file holds."""
        arrays: dict[str, Any] = {f"{_PREFIX}pairs": self.pairs, f"{_PREFIX}starts": np.array(self.starts)}
        if self.reward_error is not None:
            for part in ("data", "indices", "indptr"):
                arrays[f"{_PREFIX}error_{part}"] = getattr(self.reward_error, part)
        return arrays

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
