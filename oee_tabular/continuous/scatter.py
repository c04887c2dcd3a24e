"""What a corrected simulator scatters about f + g: nothing, the simulator's own noise, or residuals drawn from the log."""

from __future__ import annotations

import copy

import numpy as np
from scipy.spatial import cKDTree

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.continuous.task import ContinuousTask

NEAR = 8  # rows near by, from which one is drawn
TELLING = 0.02  # share of a residual, or of its size, that its neighbours explain: then they are what it is drawn from
LOOKED_AT = 3000  # rows at which that is judged


class Scatter:
    """e, coordinate by coordinate.

    Attributes
    ----------
    own : (k,) coordinates that scatter as the simulator does
    drawn : (k,) coordinates whose e is drawn from the log
    local : whether it is drawn from rows near by
    """

    def __init__(
        self,
        task: ContinuousTask,
        states: Array,
        actions: IntArray,
        left_over: Array,
        spread: Array,
        rounding: Array,
        can_own: BoolArray,
        rng: np.random.Generator,
    ) -> None:
        size = np.sqrt((left_over**2).mean(axis=0))
        near = max(0.05, 4.0 / np.sqrt(len(states)))
        self.own = (spread > rounding) & (np.abs(size / np.maximum(spread, 1e-300) - 1.0) <= near) & can_own
        self.drawn = ~self.own & (size > rounding)
        self._task, self._actions = task, actions
        self._weights = np.ones(len(states))
        self._e = np.where(self.drawn, left_over, 0.0)
        self._order = self._e @ self._direction(np.maximum(size, 1e-300))
        places = task.smooth(states)
        self._unit = np.maximum(places.std(axis=0), 1e-300)
        self._rows = [np.flatnonzero(actions == a) for a in range(task.n_actions)]
        self._trees = [cKDTree(places[rows] / self._unit) if len(rows) else None for rows in self._rows]
        self.local = bool(self.drawn.any()) and self._tells(places, rng)
        self._near = self._neighbours(places) if self.local else None
        self._sort()

    def source(self, k: int) -> str:
        """Where coordinate k's noise is taken from."""
        return "simulator" if self.own[k] else "log" if self.drawn[k] else "none"

    def _direction(self, size: Array) -> Array:
        """Along which e varies most, by coordinates scaled to 1: the drawn rows are in order along it."""
        scaled = self._e / size
        return np.asarray(np.linalg.eigh(scaled.T @ scaled)[1][:, -1] / size)

    def _tells(self, places: Array, rng: np.random.Generator) -> bool:
        """Whether the residuals of the rows near by, or their sizes, explain some of a row's."""
        some = rng.permutation(len(self._e))[:LOOKED_AT]
        found, there = [], []
        for row in some:
            a = self._actions[row]
            tree, rows = self._trees[a], self._rows[a]
            if tree is None or len(rows) <= NEAR:
                continue
            near = rows[tree.query(places[row] / self._unit, k=NEAR + 1)[1]]
            there.append(self._e[near[near != row][:NEAR]])
            found.append(self._e[row])
        if len(found) < 50:
            return False
        e, others = np.array(found)[:, self.drawn], np.array(there)[:, :, self.drawn]
        least = max(TELLING, 9.0 / len(e))
        pairs = ((e, others.mean(axis=1)), (np.abs(e), np.abs(others).mean(axis=1)))
        return any(_explained(x[:, i], y[:, i]) > least for x, y in pairs for i in range(e.shape[1]))

    def _neighbours(self, places: Array) -> IntArray:
        """(n, NEAR) rows of the same action near each row, itself among them, in order."""
        near = np.empty((len(places), NEAR), dtype=np.int64)
        for tree, rows in zip(self._trees, self._rows, strict=True):
            if tree is not None:
                at = rows[tree.query(places[rows] / self._unit, k=min(NEAR, len(rows)))[1].reshape(len(rows), -1)]
                near[rows] = np.take_along_axis(at, np.resize(np.arange(at.shape[1]), NEAR)[None], axis=1)
        return np.take_along_axis(near, np.argsort(self._order[near], axis=1, kind="stable"), axis=1)

    def _sort(self) -> None:
        """Of each action its rows in order and their running weights; of an action without rows, all."""
        self._pools = []
        for rows in self._rows:
            pool = rows if len(rows) and self._weights[rows].sum() > 0 else np.arange(len(self._e))
            pool = pool[np.argsort(self._order[pool], kind="stable")]
            self._pools.append((pool, np.cumsum(self._weights[pool])))

    def weighted(self, weights: Array) -> Scatter:
        """The same with rows drawn by these weights."""
        again = copy.copy(self)
        again._weights = weights
        again._sort()
        return again

    def draw(self, states: Array, actions: IntArray, uniform: Array) -> Array:
        """(n, k) residuals of logged rows of the same action, by the quantile ``uniform``."""
        chosen = np.empty(len(states), dtype=np.int64)
        for a in np.unique(actions):
            at = np.flatnonzero(actions == a)
            chosen[at] = self._chosen(states[at], a, uniform[at])
        return np.asarray(self._e[chosen])

    def _chosen(self, states: Array, a: int, uniform: Array) -> IntArray:
        tree = self._trees[a]
        if self._near is None or tree is None:
            pool, running = self._pools[a]
            return np.asarray(
                pool[np.minimum(np.searchsorted(running, uniform * running[-1], side="right"), len(pool) - 1)]
            )
        nearest = self._rows[a][tree.query(self._task.smooth(states) / self._unit)[1]]
        near = self._near[nearest]
        running = np.cumsum(
            np.where(self._weights[near].sum(axis=1, keepdims=True) > 0, self._weights[near], 1.0), axis=1
        )
        place = (running <= (uniform * running[:, -1])[:, None]).sum(axis=1)
        return np.asarray(near[np.arange(len(near)), np.minimum(place, NEAR - 1)])


def _explained(x: Array, y: Array) -> float:
    """Squared correlation."""
    x, y = x - x.mean(), y - y.mean()
    both = float((x * x).sum() * (y * y).sum())
    return float((x * y).sum()) ** 2 / both if both > 0 else 0.0
