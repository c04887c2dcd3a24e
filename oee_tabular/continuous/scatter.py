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

    Parameters
    ----------
    task, states, actions, left_over : of a log's rows, (n, d), (n,) and (n, k)
    spread, rounding : (k,) root mean square of the simulator's own scatter, and what is no scatter
    can_own : (k,) coordinates that may scatter as the simulator does, if the sizes are alike

    Attributes
    ----------
    own : (k,) coordinates that scatter as the simulator does
    drawn : (k,) coordinates whose e is drawn from the log
    local : whether it is drawn from rows near by
    """

    def __init__(
        self, task: ContinuousTask, states: Array, actions: IntArray, left_over: Array, *, spread: Array, rounding: Array,
        can_own: BoolArray, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        size = np.sqrt((left_over**2).mean(axis=0))
        near = max(0.05, 4.0 / np.sqrt(len(states)))
        self.own = (spread > rounding) & (np.abs(size / np.maximum(spread, 1e-300) - 1.0) <= near) & can_own
        self.drawn = ~self.own & (size > rounding)
        self._task, self._e = task, np.where(self.drawn, left_over, 0.0)
        scaled = self._e / np.maximum(size, 1e-300)
        widest = np.linalg.eigh(scaled.T @ scaled)[1][:, -1] / np.maximum(size, 1e-300)
        self._order = self._e @ widest  # rows are drawn in order along the direction in which e varies most
        places = task.smooth(states)
        self._unit = np.maximum(places.std(axis=0), 1e-300)
        self._places = places / self._unit
        self._rows = [np.flatnonzero(actions == a) for a in range(task.n_actions)]
        self._trees = [cKDTree(self._places[rows]) if len(rows) else None for rows in self._rows]
        self.local = bool(self.drawn.any()) and self._neighbors_tell(rng.permutation(len(states))[:LOOKED_AT])
        self._near = self._neighbors() if self.local else None
        self._weigh(np.ones(len(states)))

    def source(self, k: int) -> str:
        """Where coordinate k's noise is taken from."""
        return "simulator" if self.own[k] else "log" if self.drawn[k] else "none"

    def _neighbors_tell(self, some: IntArray) -> bool:
        """Whether the residuals of the rows near by, or their sizes, explain some of a row's."""
        e, others = [], []
        for tree, rows in zip(self._trees, self._rows, strict=True):
            mine = np.intersect1d(some, rows)
            if tree is None or len(rows) <= NEAR or len(mine) == 0:
                continue
            near = rows[tree.query(self._places[mine], k=NEAR + 1)[1]]
            last = np.argsort(near == mine[:, None], axis=1, kind="stable")  # the row itself is left out
            e.append(self._e[mine])
            others.append(self._e[np.take_along_axis(near, np.sort(last[:, :NEAR], axis=1), axis=1)])
        if sum(len(part) for part in e) < 50:
            return False
        one, eight = np.concatenate(e)[:, self.drawn], np.concatenate(others)[:, :, self.drawn]
        least = max(TELLING, 9.0 / len(one))
        pairs = ((one, eight.mean(axis=1)), (np.abs(one), np.abs(eight).mean(axis=1)))
        return any(_squared_correlation(x[:, i], y[:, i]) > least for x, y in pairs for i in range(one.shape[1]))

    def _neighbors(self) -> IntArray:
        """(n, NEAR) rows of the same action near each row, itself among them, in order."""
        near = np.empty((len(self._e), NEAR), dtype=np.int64)
        for tree, rows in zip(self._trees, self._rows, strict=True):
            if tree is not None:
                at = rows[tree.query(self._places[rows], k=min(NEAR, len(rows)))[1].reshape(len(rows), -1)]
                near[rows] = at[:, np.resize(np.arange(at.shape[1]), NEAR)]
        return np.take_along_axis(near, np.argsort(self._order[near], axis=1, kind="stable"), axis=1)

    def _weigh(self, weights: Array) -> None:
        """Of each action its rows in order and their running weights; of an action without rows, all."""
        self._weights, self._pools = weights, []
        for rows in self._rows:
            pool = rows if weights[rows].any() else np.arange(len(self._e))
            pool = pool[np.argsort(self._order[pool], kind="stable")]
            self._pools.append((pool, np.cumsum(weights[pool])))

    def weighted(self, weights: Array) -> Scatter:
        """The same with rows drawn by these weights."""
        again = copy.copy(self)
        again._weigh(weights)
        return again

    def draw(self, states: Array, actions: IntArray, uniform: Array) -> Array:
        """(n, k) residuals of logged rows of the same action, by the quantile ``uniform``."""
        chosen = np.empty(len(states), dtype=np.int64)
        for a in np.unique(actions):
            at = np.flatnonzero(actions == a)
            chosen[at] = self._choose(states[at], a, uniform[at])
        return np.asarray(self._e[chosen])

    def _choose(self, states: Array, a: int, uniform: Array) -> IntArray:
        tree = self._trees[a]
        if self._near is None or tree is None:
            pool, running = self._pools[a]
            place = np.searchsorted(running, uniform * running[-1], side="right")
            return np.asarray(pool[np.minimum(place, len(pool) - 1)])
        near = self._near[self._rows[a][tree.query(self._task.smooth(states) / self._unit)[1]]]
        weights = self._weights[near]
        running = np.cumsum(np.where(weights.any(axis=1, keepdims=True), weights, 1.0), axis=1)
        place = (running <= (uniform * running[:, -1])[:, None]).sum(axis=1)
        return np.asarray(near[np.arange(len(near)), np.minimum(place, NEAR - 1)])


def _squared_correlation(x: Array, y: Array) -> float:
    x, y = x - x.mean(), y - y.mean()
    both = float((x * x).sum() * (y * y).sum())
    return float((x * y).sum()) ** 2 / both if both > 0 else 0.0
