"""Stops: values that a coordinate of the next state does not pass, found in the data by their repetition.

A free step differs smoothly from the target's; one that ends at a stop does not. So the simulator's own stop is undone before a
correction is added, by a step from a little further back, and the target's is put where the corrected step passes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.continuous.task import ContinuousTask

ROWS = 5  # that end at exactly the extreme of a coordinate: a stop
MOST = 0.5  # share of rows at stops, beyond which they are values like others
BACK = 2.0 ** np.arange(-5, 1)  # of the longest displacement: from how far back a step is free of the simulator's stop


@dataclass(frozen=True)
class Stops:
    """Where steps are stopped.

    Attributes
    ----------
    bounds : (2, d) what no next state passes; infinite where nothing is known
    target, own : (2, d) the target's stops and the simulator's
    held : (side, i, j, value): who is stopped at that side of coordinate i has this value of coordinate j, as all logged have
    reach : (d,) the longest displacement
    """

    bounds: Array
    target: Array
    own: Array
    held: tuple[tuple[int, int, int, float], ...]
    reach: Array

    @classmethod
    def find(cls, states: Array, following: Array, own: Array, turns: BoolArray) -> Stops:
        """Of a log's moves, the simulator's own steps from there, and which coordinates are angles; O(n d).

        The simulator's stop is the target's too, unless the log passes it.
        """
        bounds = _extremes(following)
        target, ours = _stops(following, bounds, turns), _stops(own, _extremes(own), turns)
        for side, (sign, most) in enumerate(((-1.0, following.min(axis=0)), (1.0, following.max(axis=0)))):
            alike = np.isinf(bounds[side]) & np.isfinite(ours[side]) & (sign * most <= sign * ours[side])
            bounds[side, alike] = target[side, alike] = ours[side, alike]
        reach = np.maximum(np.abs(following - states).max(axis=0), np.abs(own - states).max(axis=0))
        return cls(bounds, target, ours, tuple(_held(target, np.concatenate([following, own]))), reach)

    def ended(self, following: Array) -> BoolArray:
        """(n,) next states at a stop of the target."""
        return np.asarray(_at(self.target, following).any(axis=1))

    def freed(self, task: ContinuousTask, states: Array, actions: IntArray, own: Array) -> Array:
        """(n, d) the simulator's next states without its stops: f(s - b) + b, b as short as is free of them; no noise."""
        at = _at(self.own, own)
        rows = np.flatnonzero(at.any(axis=1))
        free = own.copy() if len(rows) else own
        for share in BACK:
            if len(rows) == 0:
                break
            b = at[rows] * share * self.reach
            moved = task.moves(states[rows] - b, actions[rows], np.zeros((len(rows), task.n_disturbances))).next_state
            free[rows] = moved + b
            rows = rows[(_at(self.own, moved) * at[rows] > 0).any(axis=1)]
        return free

    def pushes(self, moved: Array, following: Array) -> list[Array]:
        """For each stop (h, d) C: who loses v of the h coordinates held there is pushed by v C in the others.

        By least squares on the rows that ended there, ``moved`` their f + g without stops; 0 where they are too few.
        """
        found = []
        for (side, i), (held, values) in self._holding().items():
            rows = following[:, i] == self.target[side, i]
            lost, others = moved[rows][:, held] - values, np.setdiff1d(np.arange(self.reach.size), [i, *held])
            c = np.zeros((len(held), self.reach.size))
            if rows.sum() >= ROWS * len(held):
                c[:, others] = np.linalg.lstsq(lost, (following - moved)[rows][:, others])[0]
            found.append(c)
        return found

    def put(self, moved: Array, pushes: list[Array]) -> Array:
        """(n, d) steps f + g, pushed where they are stopped; the bounds are left to come."""
        found = moved
        for ((side, i), (held, values)), c in zip(self._holding().items(), pushes, strict=True):
            rows = _at(self.target[:, [i]], moved[:, [i]])[:, 0] == 2 * side - 1
            if rows.any():
                found = found.copy() if found is moved else found
                found[rows] += (moved[rows][:, held] - values) @ c
        return found

    def _holding(self) -> dict[tuple[int, int], tuple[list[int], Array]]:
        """What is held at each stop: (side, i) -> the coordinates j and their values."""
        stops = dict.fromkeys((side, i) for side, i, _, _ in self.held)
        own = {at: [(j, value) for *other, j, value in self.held if tuple(other) == at] for at in stops}
        return {at: ([j for j, _ in pairs], np.array([value for _, value in pairs])) for at, pairs in own.items()}

    def hold(self, found: Array) -> None:
        """Set what is held of those that are stopped, in place."""
        for side, i, j, value in self.held:
            found[_at(self.target[:, [i]], found[:, [i]])[:, 0] == 2 * side - 1, j] = value


def _at(stops: Array, values: Array) -> IntArray:
    """(n, d) -1 at or below the lower stop, 1 at or above the upper, 0 between."""
    return np.asarray((values >= stops[1]).astype(np.int64) - (values <= stops[0]))


def _extremes(values: Array) -> Array:
    """(2, d) the least and the most, where ROWS end there and not all."""
    found = np.full((2, values.shape[1]), [[-np.inf], [np.inf]])
    for side, extreme in enumerate((values.min(axis=0), values.max(axis=0))):
        stop = ((values == extreme).sum(axis=0) >= ROWS) & (values.std(axis=0) > 0)
        found[side, stop] = extreme[stop]
    return found


def _stops(values: Array, extremes: Array, turns: BoolArray) -> Array:
    """The extremes that are stops: of a coordinate that is no angle and no number, and for few rows.

    Something must be held there, as a speed is at a wall: a limit that holds nothing else is a bound, no more.
    """
    none = np.full(extremes.shape, [[-np.inf], [np.inf]])
    found = extremes.copy()
    for i in np.flatnonzero(np.isfinite(extremes).any(axis=0)):
        between = values[_at(extremes[:, [i]], values[:, [i]])[:, 0] == 0, i]
        if turns[i] or len(np.unique(between)) ** 2 <= len(values):
            found[:, i] = none[:, i]
    holding = {(side, i) for side, i, _, _ in _held(found, values)}
    for side, i in zip(*np.nonzero(np.isfinite(found)), strict=True):
        if (side, i) not in holding:
            found[side, i] = none[side, i]
    few = _at(found, values).any(axis=1).mean() <= MOST
    return found if few else none


def _held(target: Array, values: Array) -> list[tuple[int, int, int, float]]:
    """What is exactly alike in all rows at a stop."""
    found = []
    for side, i in zip(*np.nonzero(np.isfinite(target)), strict=True):
        rows = values[values[:, i] == target[side, i]]
        alike = np.flatnonzero((rows == rows[0]).all(axis=0) & (values.std(axis=0) > 0))
        found += [(int(side), int(i), int(j), float(rows[0, j])) for j in alike if j != i]
    return found
