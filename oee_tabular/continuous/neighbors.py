"""Nearest states, by the coordinates that functions of a state are smooth in."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from scipy.spatial import cKDTree

from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.task import ContinuousTask


class Neighbors:
    """States (n, d) of a task among which the nearest are looked for, each coordinate in units of its deviation."""

    def __init__(self, task: ContinuousTask, states: Array) -> None:
        places = task.smooth(states)
        self._task, self._unit = task, np.maximum(places.std(axis=0), 1e-300)
        self._places = places / self._unit
        self._trees: dict[Hashable, cKDTree] = {}

    def find(self, states: Array, rows: IntArray, k: int = 1, *, key: Hashable) -> IntArray:
        """(n, k) or, with k = 1, (n,) which of ``rows`` are nearest; ``key`` names these rows, whose tree is kept."""
        if key not in self._trees:
            self._trees[key] = cKDTree(self._places[rows])
        return np.asarray(rows[self._trees[key].query(self._task.smooth(states) / self._unit, k=k)[1]])
