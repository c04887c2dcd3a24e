"""The rows of a simulator, or some of them: their entries, and sums over each row."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.segments import segment_sums, spread


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a simulator.

    Attributes
    ----------
    state, action : (rows,); arrival : (entries,), the next states
    weights : (entries,) the simulator's probabilities, each row summing to 1
    indptr : (rows + 1,), the entries of each row
    entries : (entries,), their places among the simulator's
    """

    state: IntArray
    action: IntArray
    arrival: IntArray
    weights: Array
    indptr: IntArray
    entries: IntArray

    @classmethod
    def of(cls, simulator: FiniteMDP, chosen: BoolArray | None = None) -> Rows:
        """All rows of a simulator, or the ``chosen`` (S*A,)."""
        matrix = simulator.transitions
        whole: IntArray = matrix.indptr.astype(np.int64)
        numbers = np.arange(len(whole) - 1) if chosen is None else np.flatnonzero(chosen)
        lengths = np.diff(whole)[numbers]
        indptr: IntArray = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        entries = np.arange(int(indptr[-1])) + np.repeat(whole[:-1][numbers] - indptr[:-1], lengths)
        data = matrix.data[entries]
        weights = data / spread(segment_sums(data, indptr), indptr)
        return cls(
            numbers // simulator.n_actions, numbers % simulator.n_actions, matrix.indices[entries].astype(np.int64),
            weights, indptr, entries,
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.state)

    def sums(self, values: Array) -> Array:
        """The sum over each row of (entries,) or (entries, d) values."""
        return segment_sums(values, self.indptr)

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Each row's value at each of its entries."""
        return spread(values, self.indptr)

    def centred(self, values: Array) -> Array:
        """Values less their mean under the simulator in each row."""
        weights = self.weights if values.ndim == 1 else self.weights[:, None]
        return np.asarray(values - self.spread(self.sums(weights * values)))
