"""Stops: values that a coordinate of the next state does not pass, found in the data by their repetition.

A free step differs smoothly from the target's; one that ends at a stop does not. So the simulator's own stop is undone before a
correction is added, by a step from a little further back, and the target's is put where the corrected step passes it.
"""

from __future__ import annotations

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.continuous.task import ContinuousTask

MIN_ROWS = 5  # that end at exactly the extreme of a coordinate: a stop
MAX_SHARE = 0.5  # of rows at stops, beyond which they are values like others
SHARES_BACK = 2.0 ** np.arange(
    -5, 1
)  # of the longest displacement: from how far back a step is free of the simulator's stop


class Stops:
    """Where steps are stopped, by a log's transitions and the simulator's own steps from there.

    Parameters
    ----------
    states, following, own : (n, d) a log's, and the simulator's next states
    is_angle : (d,) coordinates that have no stops

    Attributes
    ----------
    bounds : (2, d) what no next state passes; infinite where nothing is known
    target, own : (2, d) the target's stops and the simulator's, which are the target's too unless the log passes them
    held : (side, i) -> coordinates and their values, which all have that are stopped at that side of coordinate i
    pushes : (side, i) -> (h, d) what who loses v of the h held coordinates is pushed by, v C, in the others; see ``learn``
    """

    def __init__(self, states: Array, following: Array, own: Array, is_angle: BoolArray) -> None:
        self.bounds = _extremes(following)
        self.target, self.own = _find(following, self.bounds, is_angle), _find(own, _extremes(own), is_angle)
        least, most = following.min(axis=0), following.max(axis=0)
        is_own = np.isinf(self.bounds) & np.isfinite(self.own) & [least >= self.own[0], most <= self.own[1]]
        self.bounds[is_own] = self.target[is_own] = self.own[is_own]
        self._reach = np.maximum(np.abs(following - states).max(axis=0), np.abs(own - states).max(axis=0))
        self.held = _group_stops(self.target, np.concatenate([following, own]))
        self.pushes = {at: np.zeros((len(j), self._reach.size)) for at, (j, _) in self.held.items()}

    def is_stopped(self, following: Array) -> BoolArray:
        """(n,) next states at a stop of the target."""
        return np.asarray(_side(self.target, following).any(axis=1))

    def free(self, task: ContinuousTask, states: Array, actions: IntArray, own: Array) -> Array:
        """(n, d) the simulator's next states ``own`` without its stops, f(s - b) + b; b is as short as is free of them."""
        if np.isinf(self.own).all():
            return own
        at, free = _side(self.own, own), own.copy()
        rows = np.flatnonzero(at.any(axis=1))
        for share in SHARES_BACK:
            if len(rows) == 0:
                break
            b = at[rows] * share * self._reach
            moved = task.noiseless_step(states[rows] - b, actions[rows]).next_state
            free[rows] = moved + b
            rows = rows[(_side(self.own, moved) * at[rows] > 0).any(axis=1)]
        return free

    def learn(self, moved: Array, following: Array) -> None:
        """Fit the pushes by least squares on rows that ended at a stop, ``moved`` their f + g; 0 where they are too few."""
        for (side, i), (held, values) in self.held.items():
            rows = following[:, i] == self.target[side, i]
            others = np.setdiff1d(np.arange(self._reach.size), [i, *held])
            if rows.sum() >= MIN_ROWS * len(held):
                lost = moved[rows][:, held] - values
                self.pushes[side, i][:, others] = np.linalg.lstsq(lost, (following - moved)[rows][:, others])[0]

    def push(self, moved: Array) -> Array:
        """(n, d) steps f + g, pushed where they are stopped; the bounds are left to come."""
        for (side, i), (held, values) in self.held.items():
            rows = self._rows_at(side, i, moved)
            if rows.any():
                moved = moved.copy()
                moved[rows] += (moved[rows][:, held] - values) @ self.pushes[side, i]
        return moved

    def hold(self, following: Array) -> None:
        """Set what is held of those that are stopped, in place."""
        for (side, i), (held, values) in self.held.items():
            following[np.ix_(self._rows_at(side, i, following), held)] = values

    def _rows_at(self, side: int, i: int, values: Array) -> BoolArray:
        return np.asarray(_side(self.target[:, [i]], values[:, [i]])[:, 0] == 2 * side - 1)


def _side(stops: Array, values: Array) -> IntArray:
    """(n, d) -1 at or below the lower stop, 1 at or above the upper, 0 between."""
    return np.asarray((values >= stops[1]).astype(np.int64) - (values <= stops[0]))


def _extremes(values: Array) -> Array:
    """(2, d) the least and the most, where ``MIN_ROWS`` end there and not all."""
    ends = np.stack([values.min(axis=0), values.max(axis=0)])
    is_stop = ((values == ends[:, None]).sum(axis=1) >= MIN_ROWS) & (values.std(axis=0) > 0)
    return np.where(is_stop, ends, [[-np.inf], [np.inf]])


def _find(values: Array, extremes: Array, is_angle: BoolArray) -> Array:
    """The extremes that are stops: of a coordinate that is no angle and no number, and for few rows.

    Something must be held there, as a speed is at a wall: a limit that holds nothing else is a bound, no more.
    """
    none = np.full(extremes.shape, [[-np.inf], [np.inf]])
    stops = extremes.copy()
    for i in np.flatnonzero(np.isfinite(extremes).any(axis=0)):
        between = values[_side(extremes[:, [i]], values[:, [i]])[:, 0] == 0, i]
        if is_angle[i] or len(np.unique(between)) ** 2 <= len(values):
            stops[:, i] = none[:, i]
    held = _group_stops(stops, values)
    for at in zip(*np.nonzero(np.isfinite(stops)), strict=True):
        stops[at] = stops[at] if at in held else none[at]
    return stops if _side(stops, values).any(axis=1).mean() <= MAX_SHARE else none


def _group_stops(stops: Array, values: Array) -> dict[tuple[int, int], tuple[IntArray, Array]]:
    """What is exactly alike in all rows at a stop, by side and coordinate."""
    held = {}
    for side, i in zip(*np.nonzero(np.isfinite(stops)), strict=True):
        rows = values[values[:, i] == stops[side, i]]
        alike = np.flatnonzero((rows == rows[0]).all(axis=0) & (values.std(axis=0) > 0))
        if len(j := alike[alike != i]):
            held[int(side), int(i)] = j, rows[0, j]
    return held
