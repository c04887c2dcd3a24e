"""The nearest of a task's states, coordinate by coordinate in its own unit."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from scipy.spatial import cKDTree

from oee_tabular.continuous.task.base import ContinuousTask
from oee_tabular.typing import Array, IntArray

FARTHEST = 1e100  # deviations, beyond which states count as there


class Neighbors:
    """States (n, d) of a task among which the nearest are looked for.

    Each coordinate is measured in units of its deviation.
    """

    def __init__(self, task: ContinuousTask, states: Array) -> None:
        places = task.smooth(states)
        self._task = task
        with np.errstate(over="ignore"):
            deviation = places.std(axis=0)
        # a coordinate that was the same in all tells no row from another
        self._unit = np.where(deviation > 0.0, deviation, 1.0)
        self._places = self._measure(places)
        self._trees: dict[Hashable, cKDTree] = {}

    def find(
        self, states: Array, rows: IntArray, k: int = 1, *, key: Hashable
    ) -> IntArray:
        """Return which of ``rows`` are nearest, (n, k), or (n,) with k = 1.

        ``key`` names these rows, whose tree is kept.
        """
        if key not in self._trees:
            self._trees[key] = cKDTree(self._places[rows])
        places = self._measure(self._task.smooth(states))
        return np.asarray(rows[self._trees[key].query(places, k=k)[1]])

    def _measure(self, places: Array) -> Array:
        """Return places in their units, with finite squares of distances.

        States that grow without end have none else.
        """
        with np.errstate(over="ignore"):
            measured = np.nan_to_num(places / self._unit)
        return np.asarray(np.clip(measured, -FARTHEST, FARTHEST))
