"""What an MDP that was made of samples rests on: how many there were, kept beside it for the intervals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import checked_rows
from oee_tabular.mdp.arrays import canonical_table

KEY = "sampling_"


class Sampling(NamedTuple):
    """Samples behind an MDP.

    ``pairs`` (S*A,): of each (s, a), inf where nothing was to be learned (the task is over), 0 where none was taken and the row
    was filled in. ``starts``: first states that were met, inf where the law of the start was given. ``reward_error``: the
    variance of the mean reward of each move, None where rewards were given.
    """

    pairs: Array
    starts: float
    reward_error: sparse.csr_array | None

    def without_rewards(self) -> Sampling:
        """Of an MDP whose rewards were given."""
        return self._replace(reward_error=None)

    def mixed(self, n_actions: int) -> Sampling:
        """Of an MDP whose actions are mixed: each row rests on the least of them."""
        least = self.pairs.reshape(-1, n_actions).min(axis=1)
        return self._replace(pairs=np.repeat(least, n_actions))

    def arrays(self) -> dict[str, Any]:
        """What a file holds."""
        found: dict[str, object] = {f"{KEY}pairs": self.pairs, f"{KEY}starts": np.array(self.starts)}
        if self.reward_error is not None:
            found |= {f"{KEY}error_{part}": getattr(self.reward_error, part) for part in ("data", "indices", "indptr")}
        return found


def stored_sampling(arrays: Mapping[str, object], shape: tuple[int, int]) -> Sampling | None:
    """The one of a file, None where it has none."""
    if f"{KEY}pairs" not in arrays:
        return None
    pairs = _checks.float_array(arrays[f"{KEY}pairs"], f"{KEY}pairs", ndim=1)
    starts = float(_checks.float_array(arrays[f"{KEY}starts"], f"{KEY}starts", ndim=0))
    if pairs.shape != shape[:1] or not (pairs >= 0).all() or not starts > 0:
        raise ValueError(f"{KEY}pairs must be {shape[0]} numbers of samples, and {KEY}starts positive")
    error = None
    if f"{KEY}error_data" in arrays:
        data, indices, indptr = (arrays[f"{KEY}error_{part}"] for part in ("data", "indices", "indptr"))
        error = checked_rows(data, indices, indptr, shape, f"{KEY}error")
    return Sampling(pairs, starts, error)


def sampling_of(
    columns: tuple[IntArray, IntArray, IntArray, BoolArray], reward: Array | None, starts: float, terminal: IntArray,
    shape: tuple[int, int],
) -> Sampling:  # fmt: skip
    """Of samples (state, action, next state, whether terminated) in an MDP of that shape; None: no rewards among them.

    The variance of a mean of k rewards is s^2 / k, s^2 the move's own, or that of all moves together where k = 1.
    """
    state, action, following, terminated = columns
    n_states = shape[1]
    n_actions = shape[0] // n_states
    row = state * n_actions + action
    pairs = np.bincount(row, minlength=shape[0]).astype(np.float64)
    over = np.zeros(n_states, dtype=np.bool_)
    over[terminal[following[terminated]]] = True
    over[state] = False
    pairs[np.repeat(over, n_actions)] = np.inf
    if reward is None:
        return Sampling(pairs, starts, None)
    to = np.where(terminated, terminal[following], following)
    number, total, squares = (canonical_table(row, to, w, shape) for w in (np.ones(len(row)), reward, reward**2))
    apart = np.maximum(squares.data - total.data**2 / number.data, 0.0)
    free = float((number.data - 1.0).sum())
    pooled = float(apart.sum()) / free if free else 0.0
    own = np.where(number.data > 1, apart / np.maximum(number.data - 1.0, 1.0), pooled) / number.data
    return Sampling(pairs, starts, sparse.csr_array((own, number.indices, number.indptr), shape))
