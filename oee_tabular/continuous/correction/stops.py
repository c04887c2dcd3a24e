"""Stops: values that a coordinate of the next state does not pass.

A stop is found in the data by its repetition: many next states end at exactly the
extreme of a coordinate, and something else is held there, as a speed is at a wall.
A free step differs smoothly from the target's; one that ends at a stop does not. So a
correction passes the stops in four steps, each a pure function of what came before:

1. ``find_stops`` finds the target's and the simulator's stops.
2. ``free_steps`` undoes the simulator's own: a step that ended at one is taken again
   from a little further back. The correction g is fitted to these free steps.
3. ``learn_pushes`` fits what the target does with the speed that a stop takes away.
4. ``push_steps`` and ``hold_steps`` put the target's stops where a corrected step
   passes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from oee_tabular.continuous.task.base import ContinuousTask
from oee_tabular.typing import Array, BoolArray, IntArray

MIN_ROWS = 5  # that end at exactly the extreme of a coordinate: a stop
MAX_SHARE = 0.5  # of rows at stops, beyond which they are values like others
# multiples of the longest displacement by which a step is begun further back, tried in
# turn until it ends at no stop
SHARES_BACK = 2.0 ** np.arange(-5, 1)


class Held(NamedTuple):
    """What all rows that are stopped at one side of a coordinate have alike.

    Attributes
    ----------
    coordinates : ndarray of int, shape (h,)
        The other coordinates that are the same in all these rows.
    values : ndarray of shape (h,)
        Their values.
    """

    coordinates: IntArray
    values: Array


@dataclass(frozen=True, eq=False)
class Stops:
    """Where steps are stopped, by a log's transitions and the simulator's own steps.

    A side is 0 for the lower stop of a coordinate and 1 for the upper.

    Attributes
    ----------
    bounds : ndarray of shape (2, d)
        What no next state passes; infinite where nothing is known.
    target : ndarray of shape (2, d)
        The target's stops.
    own : ndarray of shape (2, d)
        The simulator's stops, which are the target's too unless the log passes them.
    reach : ndarray of shape (d,)
        The longest displacement of each coordinate.
    held : mapping from (side, coordinate) to Held
        What is held at each of the target's stops.
    """

    bounds: Array
    target: Array
    own: Array
    reach: Array
    held: Mapping[tuple[int, int], Held]

    def is_stopped(self, following: Array) -> BoolArray:
        """Return which next states (n,) are at a stop of the target."""
        return np.asarray(_side(self.target, following).any(axis=1))

    def rows_at(self, side: int, i: int, values: Array) -> BoolArray:
        """Return which rows (n,) of values (n, d) are at this side of coordinate i."""
        sides = _side(self.target[:, [i]], values[:, [i]])[:, 0]
        return np.asarray(sides == 2 * side - 1)


# C of each stop, (h, d): a row that loses v of the h held coordinates is pushed by v C
# in the others
Pushes = Mapping[tuple[int, int], Array]


def find_stops(
    states: Array,
    following: Array,
    own: Array,
    is_angle: BoolArray,
    is_memory: BoolArray,
) -> Stops:
    """Find the stops of the target and of the simulator.

    Parameters
    ----------
    states : ndarray of shape (n, d)
        The log's states.
    following : ndarray of shape (n, d)
        The log's next states.
    own : ndarray of shape (n, d)
        The simulator's next states from there.
    is_angle : ndarray of bool, shape (d,)
        Which coordinates are angles, which have no stops.
    is_memory : ndarray of bool, shape (d,)
        Which coordinates are last actions. They have no stops and are not held: a
        command at its limit repeats a value exactly, as a wall does.

    Returns
    -------
    Stops
        The stops.
    """
    bounds = _extremes(following, is_memory)
    of_target = _find(following, bounds, is_angle, is_memory)
    of_simulator = _find(own, _extremes(own, is_memory), is_angle, is_memory)
    least = following.min(axis=0)
    most = following.max(axis=0)
    # a stop of the simulator that no row of the log passes is the target's as well
    is_within = [least >= of_simulator[0], most <= of_simulator[1]]
    is_shared = np.isinf(bounds) & np.isfinite(of_simulator) & is_within
    bounds[is_shared] = of_target[is_shared] = of_simulator[is_shared]
    reach = np.maximum(
        np.abs(following - states).max(axis=0), np.abs(own - states).max(axis=0)
    )
    held = _group_stops(of_target, np.concatenate([following, own]), is_memory)
    return Stops(bounds, of_target, of_simulator, reach, held)


def free_steps(
    stops: Stops, task: ContinuousTask, states: Array, actions: IntArray, own: Array
) -> Array:
    """Return the simulator's next states ``own`` without its stops, (n, d).

    They are f(s - b) + b; b is as short as is free of the stops.
    """
    if np.isinf(stops.own).all():
        return own
    at = _side(stops.own, own)
    free = own.copy()
    rows = np.flatnonzero(at.any(axis=1))
    for share in SHARES_BACK:
        if len(rows) == 0:
            break
        b = at[rows] * share * stops.reach
        moved = task.noiseless_step(states[rows] - b, actions[rows]).next_state
        free[rows] = moved + b
        rows = rows[(_side(stops.own, moved) * at[rows] > 0).any(axis=1)]
    return free


def learn_pushes(stops: Stops, moved: Array, following: Array) -> Pushes:
    """Fit the pushes by least squares on rows that ended at a stop.

    ``moved`` is f + g of the rows, ``following`` where they ended. A push is 0 where
    the rows are too few.
    """
    d = stops.reach.size
    pushes = {}
    for (side, i), (held, values) in stops.held.items():
        push = np.zeros((len(held), d))
        rows = following[:, i] == stops.target[side, i]
        others = np.setdiff1d(np.arange(d), [i, *held])
        if rows.sum() >= MIN_ROWS * len(held):
            lost = moved[rows][:, held] - values
            pushed = (following - moved)[rows][:, others]
            push[:, others] = np.linalg.lstsq(lost, pushed)[0]
        pushes[side, i] = push
    return pushes


def push_steps(stops: Stops, pushes: Pushes, moved: Array) -> Array:
    """Return steps f + g (n, d), pushed where they are stopped.

    The bounds are not applied here.
    """
    for (side, i), (held, values) in stops.held.items():
        rows = stops.rows_at(side, i, moved)
        if rows.any():
            moved = moved.copy()
            moved[rows] += (moved[rows][:, held] - values) @ pushes[side, i]
    return moved


def hold_steps(stops: Stops, following: Array) -> Array:
    """Return next states with the held coordinates of the rows that are stopped."""
    for (side, i), (held, values) in stops.held.items():
        rows = stops.rows_at(side, i, following)
        if rows.any():
            following = following.copy()
            following[np.ix_(rows, held)] = values
    return following


def _side(stops: Array, values: Array) -> IntArray:
    """Return the side (n, d) of the stops on which values lie.

    It is -1 at or below the lower stop, 1 at or above the upper, 0 between.
    """
    return np.asarray((values >= stops[1]).astype(np.int64) - (values <= stops[0]))


def _extremes(values: Array, is_memory: BoolArray) -> Array:
    """Return the least and the most (2, d) of each coordinate that varies.

    They are infinite for last actions, and where fewer than ``MIN_ROWS`` rows end
    there.
    """
    ends = np.stack([values.min(axis=0), values.max(axis=0)])
    n_rows = (values == ends[:, None]).sum(axis=1)
    is_stop = (n_rows >= MIN_ROWS) & (values.std(axis=0) > 0) & ~is_memory
    return np.where(is_stop, ends, [[-np.inf], [np.inf]])


def _find(
    values: Array, extremes: Array, is_angle: BoolArray, is_memory: BoolArray
) -> Array:
    """Return the extremes that are stops.

    A coordinate with a stop is no angle, and takes more values between its stops than
    the root of the number of rows; at most half of the rows are at stops.
    Something must be held there, as a speed is at a wall: a limit that holds nothing
    else is a bound, no more.
    """
    none = np.full(extremes.shape, [[-np.inf], [np.inf]])
    stops = extremes.copy()
    for i in np.flatnonzero(np.isfinite(extremes).any(axis=0)):
        between = values[_side(extremes[:, [i]], values[:, [i]])[:, 0] == 0, i]
        if is_angle[i] or len(np.unique(between)) ** 2 <= len(values):
            stops[:, i] = none[:, i]
    held = _group_stops(stops, values, is_memory)
    for at in zip(*np.nonzero(np.isfinite(stops)), strict=True):
        if at not in held:
            stops[at] = none[at]
    if _side(stops, values).any(axis=1).mean() > MAX_SHARE:
        return none
    return stops


def _group_stops(
    stops: Array, values: Array, is_memory: BoolArray
) -> dict[tuple[int, int], Held]:
    """Return what is exactly alike in all rows at a stop, by side and coordinate."""
    held = {}
    can_be_held = (values.std(axis=0) > 0) & ~is_memory
    for side, i in zip(*np.nonzero(np.isfinite(stops)), strict=True):
        rows = values[values[:, i] == stops[side, i]]
        alike = np.flatnonzero((rows == rows[0]).all(axis=0) & can_be_held)
        others = alike[alike != i]
        if len(others):
            held[int(side), int(i)] = Held(others, rows[0, others])
    return held
