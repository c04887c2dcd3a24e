"""Stops and scatter of single steps, as a log shows them.

A stop (``Stops``) is a value that a coordinate of the next state does not pass, found
in the data by its repetition. A free step differs smoothly from the target's; one that
ends at a stop does not. So the simulator's own stop is undone before a correction is
added, by a step from a little further back, and the target's is put where the corrected
step passes it.

A corrected simulator scatters (``Scatter``) by nothing, by the simulator's own noise,
or by residuals drawn from the log.
"""

from __future__ import annotations

import copy
from collections.abc import Hashable
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, Moves, shortest
from oee_tabular.typing import Array, BoolArray, IntArray

MIN_ROWS = 5  # that end at exactly the extreme of a coordinate: a stop
MAX_SHARE = 0.5  # of rows at stops, beyond which they are values like others
# From so many longest displacements further back a step is tried, until it is free of a
# stop.
SHARES_BACK = 2.0 ** np.arange(-5, 1)
N_NEIGHBORS = 8  # rows near by, from which one is drawn
# share of a residual, or of its size, that its neighbours explain: it is drawn from
# them
MIN_EXPLAINED = 0.02
N_JUDGED = 3000  # rows at which that is judged
N_SIMULATED = 5000  # steps by which the simulator's own noise is known
MAX_MEAN_ERRORS = 5.0  # standard errors between the means of two equal scatters
SCATTER_ROUNDING = 1e-9  # displacements' deviations: less scatter is rounding


class Stops:
    """Where steps are stopped, by a log's transitions and the simulator's own steps.

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

    Attributes
    ----------
    bounds : ndarray of shape (2, d)
        What no next state passes; infinite where nothing is known.
    target : ndarray of shape (2, d)
        The target's stops.
    own : ndarray of shape (2, d)
        The simulator's stops, which are the target's too unless the log passes them.
    held : dict from (side, i) to (coordinates, values)
        The coordinates that all rows stopped at that side of coordinate i have alike,
        and their values.
    pushes : dict from (side, i) to ndarray of shape (h, d)
        C: a row that loses v of the h held coordinates is pushed by v C in the others;
        see ``learn``.
    """

    def __init__(
        self, states: Array, following: Array, own: Array, is_angle: BoolArray
    ) -> None:
        self.bounds = _extremes(following)
        self.target = _find(following, self.bounds, is_angle)
        self.own = _find(own, _extremes(own), is_angle)
        least = following.min(axis=0)
        most = following.max(axis=0)
        is_within = [least >= self.own[0], most <= self.own[1]]
        is_own = np.isinf(self.bounds) & np.isfinite(self.own) & is_within
        self.bounds[is_own] = self.target[is_own] = self.own[is_own]
        self._reach = np.maximum(
            np.abs(following - states).max(axis=0), np.abs(own - states).max(axis=0)
        )
        self.held = _group_stops(self.target, np.concatenate([following, own]))
        self.pushes = {
            at: np.zeros((len(j), self._reach.size)) for at, (j, _) in self.held.items()
        }

    def is_stopped(self, following: Array) -> BoolArray:
        """Return which next states (n,) are at a stop of the target."""
        return np.asarray(_side(self.target, following).any(axis=1))

    def free(
        self, task: ContinuousTask, states: Array, actions: IntArray, own: Array
    ) -> Array:
        """Return the simulator's next states ``own`` without its stops, (n, d).

        They are f(s - b) + b; b is as short as is free of the stops.
        """
        if np.isinf(self.own).all():
            return own
        at = _side(self.own, own)
        free = own.copy()
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
        """Fit the pushes by least squares on rows that ended at a stop.

        ``moved`` is f + g of the rows. A push is 0 where the rows are too few.
        """
        for (side, i), (held, values) in self.held.items():
            rows = following[:, i] == self.target[side, i]
            others = np.setdiff1d(np.arange(self._reach.size), [i, *held])
            if rows.sum() >= MIN_ROWS * len(held):
                lost = moved[rows][:, held] - values
                pushed = (following - moved)[rows][:, others]
                self.pushes[side, i][:, others] = np.linalg.lstsq(lost, pushed)[0]

    def push(self, moved: Array) -> Array:
        """Return steps f + g (n, d), pushed where they are stopped.

        The bounds are not applied here.
        """
        for (side, i), (held, values) in self.held.items():
            rows = self._rows_at(side, i, moved)
            if rows.any():
                moved = moved.copy()
                moved[rows] += (moved[rows][:, held] - values) @ self.pushes[side, i]
        return moved

    def hold(self, following: Array) -> None:
        """Set the held coordinates of the rows that are stopped, in place."""
        for (side, i), (held, values) in self.held.items():
            following[np.ix_(self._rows_at(side, i, following), held)] = values

    def _rows_at(self, side: int, i: int, values: Array) -> BoolArray:
        """Return which rows are stopped at this side of coordinate i."""
        sides = _side(self.target[:, [i]], values[:, [i]])[:, 0]
        return np.asarray(sides == 2 * side - 1)


def _side(stops: Array, values: Array) -> IntArray:
    """Return the side (n, d) of the stops on which values lie.

    It is -1 at or below the lower stop, 1 at or above the upper, 0 between.
    """
    return np.asarray((values >= stops[1]).astype(np.int64) - (values <= stops[0]))


def _extremes(values: Array) -> Array:
    """Return the least and the most (2, d) where ``MIN_ROWS`` end there and not all."""
    ends = np.stack([values.min(axis=0), values.max(axis=0)])
    n_rows = (values == ends[:, None]).sum(axis=1)
    is_stop = (n_rows >= MIN_ROWS) & (values.std(axis=0) > 0)
    return np.where(is_stop, ends, [[-np.inf], [np.inf]])


def _find(values: Array, extremes: Array, is_angle: BoolArray) -> Array:
    """Return the extremes that are stops.

    They are of a coordinate that is no angle and no number, and hold for few rows.
    Something must be held there, as a speed is at a wall: a limit that holds nothing
    else is a bound, no more.
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


def _group_stops(
    stops: Array, values: Array
) -> dict[tuple[int, int], tuple[IntArray, Array]]:
    """Return what is exactly alike in all rows at a stop, by side and coordinate."""
    held = {}
    for side, i in zip(*np.nonzero(np.isfinite(stops)), strict=True):
        rows = values[values[:, i] == stops[side, i]]
        alike = np.flatnonzero((rows == rows[0]).all(axis=0) & (values.std(axis=0) > 0))
        if len(j := alike[alike != i]):
            held[int(side), int(i)] = j, rows[0, j]
    return held


def draw_rows(pool: tuple[IntArray, Array], uniform: Array) -> IntArray:
    """Draw rows by the quantile ``uniform`` of their weights.

    ``pool`` has the rows and the running sum of their weights.
    """
    rows, running = pool
    place = np.searchsorted(running, uniform * running[-1], side="right")
    return np.asarray(rows[np.minimum(place, len(rows) - 1)])


class Neighbors:
    """States (n, d) of a task among which the nearest are looked for.

    Each coordinate is measured in units of its deviation.
    """

    def __init__(self, task: ContinuousTask, states: Array) -> None:
        places = task.smooth(states)
        self._task = task
        self._unit = np.maximum(places.std(axis=0), 1e-300)
        self._places = places / self._unit
        self._trees: dict[Hashable, cKDTree] = {}

    def find(
        self, states: Array, rows: IntArray, k: int = 1, *, key: Hashable
    ) -> IntArray:
        """Return which of ``rows`` are nearest, (n, k), or (n,) with k = 1.

        ``key`` names these rows, whose tree is kept.
        """
        if key not in self._trees:
            self._trees[key] = cKDTree(self._places[rows])
        places = self._task.smooth(states) / self._unit
        return np.asarray(rows[self._trees[key].query(places, k=k)[1]])


class Scatter:
    """The scatter e of a corrected simulator, coordinate by coordinate.

    Parameters
    ----------
    task : ContinuousTask
        The simulator.
    log : ContinuousTransitions
        The log.
    actions : ndarray of int, shape (n,)
        The numbers of the log's actions.
    own : Moves
        The simulator's steps from the log's rows, without noise.
    left_over : ndarray of shape (n, k)
        What f + g leaves of the log's next states, and of its rewards where they are
        learned.
    is_free : ndarray of bool, shape (n,)
        The rows that count.
    periods : ndarray of shape (d,)
        The periods of angles, as in ``shortest``.
    rng : numpy.random.Generator
        The source of random numbers.

    Attributes
    ----------
    spread : ndarray of shape (k,)
        The root mean square of the simulator's own noise.
    own : ndarray of bool, shape (k,)
        The coordinates that scatter as the simulator does.
    drawn : ndarray of bool, shape (k,)
        The coordinates whose e is drawn from the log.
    """

    def __init__(
        self,
        task: ContinuousTask,
        log: ContinuousTransitions,
        actions: IntArray,
        own: Moves,
        left_over: Array,
        is_free: BoolArray,
        periods: Array,
        rng: np.random.Generator,
    ) -> None:
        d = log.n_state
        k = left_over.shape[1]
        some = np.sort(rng.permutation(len(log))[:N_SIMULATED])
        noisy = task.step(log.state[some], actions[some], rng)
        noise = np.zeros((len(some), k))
        noise[:, :d] = shortest(noisy.next_state - own.next_state[some], periods)
        self.spread = root_mean_square(noise)
        e = left_over[is_free]
        size = root_mean_square(e)
        rounding = np.full(k, SCATTER_ROUNDING)
        rounding[:d] *= shortest(log.next_state - log.state, periods).std(axis=0)
        rounding[:d] += np.finfo(float).eps * np.abs(log.next_state).max(axis=0)
        # the simulator's own noise is taken where the log's has its size and mean
        most = max(0.05, 4.0 / np.sqrt(len(e)))
        is_alike = np.abs(size / np.maximum(self.spread, 1e-300) - 1.0) <= most
        apart = np.abs(noise.mean(axis=0) - e.mean(axis=0))
        is_alike &= apart <= MAX_MEAN_ERRORS * self.spread * np.sqrt(2.0 / len(some))
        self.own = (self.spread > rounding) & is_alike & (task.n_disturbances > 0)
        self.drawn = ~self.own & (size > rounding)
        if k > d:
            is_end_alike = noisy.terminated == own.terminated[some]
            reward_noise = np.where(is_end_alike, noisy.reward - own.reward[some], 0.0)
            self.spread[-1] = root_mean_square(reward_noise)
        self._task = task
        self._e = np.where(self.drawn, e, 0.0)
        self._actions = actions[is_free]
        scaled = self._e / np.maximum(size, 1e-300)
        widest = np.linalg.eigh(scaled.T @ scaled)[1][:, -1] / np.maximum(size, 1e-300)
        # rows are drawn in order along the direction in which e varies most
        self._order = self._e @ widest
        self._rows = [np.flatnonzero(self._actions == a) for a in range(task.n_actions)]
        self._neighbors = Neighbors(task, log.state[is_free])
        self._near = None
        if self.drawn.any():
            # a row's neighbours are of the same action, and the row is among them
            near = np.empty((len(e), N_NEIGHBORS + 1), dtype=np.int64)
            for a, rows in enumerate(self._rows):
                if len(rows):
                    k = min(N_NEIGHBORS + 1, len(rows))
                    states = log.state[is_free][rows]
                    found = self._neighbors.find(states, rows, k, key=a)
                    found = found.reshape(len(rows), k)
                    # repeated where there are fewer
                    near[rows] = found[:, np.resize(np.arange(k), N_NEIGHBORS + 1)]
            if self._is_local(near, rng.permutation(len(e))[:N_JUDGED]):
                places = self._order[near[:, :N_NEIGHBORS]]
                order = np.argsort(places, axis=1, kind="stable")
                self._near = np.take_along_axis(near, order, axis=1)
        self._set_weights(np.ones(len(e)))

    def source(self, k: int) -> Literal["none", "simulator", "log"]:
        """Return where the scatter of coordinate k is taken from."""
        if self.own[k]:
            return "simulator"
        return "log" if self.drawn[k] else "none"

    @property
    def local(self) -> bool:
        """Return whether e is drawn from rows near by."""
        return self._near is not None

    def _is_local(self, near: IntArray, some: IntArray) -> bool:
        """Return whether the residuals of rows near by explain some of a row's.

        Their sizes may explain its size instead.
        """
        some = some[np.bincount(self._actions)[self._actions[some]] > N_NEIGHBORS]
        if len(some) < 50:
            return False
        # a row itself comes last, and is left out
        is_self = near[some] == some[:, None]
        order = np.argsort(is_self, axis=1, kind="stable")[:, :N_NEIGHBORS]
        others = np.take_along_axis(near[some], order, axis=1)
        one = self._e[some][:, self.drawn]
        eight = self._e[others][:, :, self.drawn]
        least = max(MIN_EXPLAINED, 9.0 / len(some))
        values = (one, eight.mean(axis=1))
        sizes = (np.abs(one), np.abs(eight).mean(axis=1))
        for x, y in (values, sizes):
            x = x - x.mean(axis=0)
            y = y - y.mean(axis=0)
            both = (x * x).sum(axis=0) * (y * y).sum(axis=0)
            if ((x * y).sum(axis=0) ** 2 > least * both).any():
                return True
        return False

    def _set_weights(self, weights: Array) -> None:
        """Set the rows of each action in order with these weights.

        An action without rows has all of them.
        """
        self._weights = weights
        self._pools = []
        for rows in self._rows:
            pool = rows if weights[rows].any() else np.arange(len(self._e))
            pool = pool[np.argsort(self._order[pool], kind="stable")]
            self._pools.append((pool, np.cumsum(weights[pool])))

    def reweighted(self, weights: Array) -> Scatter:
        """Return the same scatter with rows drawn by these weights."""
        again = copy.copy(self)
        again._set_weights(weights)
        return again

    def draw(self, states: Array, actions: IntArray, uniform: Array) -> Array:
        """Draw residuals (n, k) of logged rows of the same action.

        They are chosen by the quantile ``uniform``.
        """
        chosen = np.empty(len(states), dtype=np.int64)
        for a in np.unique(actions):
            at = np.flatnonzero(actions == a)
            if self._near is None or len(self._rows[a]) == 0:
                chosen[at] = draw_rows(self._pools[a], uniform[at])
            else:
                nearest = self._neighbors.find(states[at], self._rows[a], key=a)
                near = self._near[nearest]
                weights = self._weights[near]
                # a bootstrap may leave all neighbours out: they then weigh the same
                has_weight = weights.any(axis=1, keepdims=True)
                running = np.cumsum(np.where(has_weight, weights, 1.0), axis=1)
                level = (uniform[at] * running[:, -1])[:, None]
                place = np.minimum((running <= level).sum(axis=1), N_NEIGHBORS - 1)
                chosen[at] = near[np.arange(len(at)), place]
        return np.asarray(self._e[chosen])


def root_mean_square(values: Array) -> Array:
    """Compute the root mean square of each column."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))
