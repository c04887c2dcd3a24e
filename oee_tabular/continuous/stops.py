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

    def kicks(self, own: Array, free: Array, left: Array, following: Array) -> Array:
        """(d,) c of what a stop does to the other coordinates, c (f - free), by least squares on rows where both are stopped.

        ``left`` is what free + g leaves of the log's next states. 1, the simulator's own, without such rows; within [0, 2].
        """
        both = (_at(self.target, following) * _at(self.own, own) > 0).any(axis=1)
        kick = (own - free)[both]
        found, size = (kick * left[both]).sum(axis=0), (kick**2).sum(axis=0)
        known = (size > 0) & (both.sum() >= ROWS)
        return np.where(known, np.clip(found / np.where(known, size, 1.0), 0.0, 2.0), 1.0)

    def joined(self, own: Array, free: Array, added: Array, kicks: Array) -> Array:
        """(n, d) free + added; where the simulator's step and this one are stopped alike, kicks (f - free) in the others."""
        found = free + added
        if np.isfinite(self.own).any():
            at = _at(self.target, found)
            both = (at * _at(self.own, own) > 0).any(axis=1)
            found[both] += np.where(at[both] == 0, kicks * (own - free)[both], 0.0)
        return found

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
