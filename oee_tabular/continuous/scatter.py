"""What a corrected simulator scatters about f + g: nothing, the simulator's own noise, or residuals drawn from the log."""

from __future__ import annotations

import copy

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.neighbors import Neighbors
from oee_tabular.continuous.task import ContinuousTask, Moves, shortest

N_NEIGHBORS = 8  # rows near by, from which one is drawn
MIN_EXPLAINED = (
    0.02  # share of a residual, or of its size, that its neighbours explain: then they are what it is drawn from
)
N_JUDGED = 3000  # rows at which that is judged
N_SIMULATED = 5000  # steps by which the simulator's own noise is known
SKEWED = 5.0  # standard errors between the means of two scatters: they are not the same
ROUNDING = 1e-9  # of a displacement's deviation

Pool = tuple[IntArray, Array]  # rows, and the running sum of their weights


def draw_rows(pool: Pool, uniform: Array) -> IntArray:
    """Rows by the quantile ``uniform`` of their weights."""
    rows, running = pool
    place = np.searchsorted(running, uniform * running[-1], side="right")
    return np.asarray(rows[np.minimum(place, len(rows) - 1)])


class Scatter:
    """e, coordinate by coordinate.

    Parameters
    ----------
    task, log, actions : the simulator, the log and the numbers (n,) of its actions
    own : the simulator's steps from the log's rows, without noise
    left_over : (n, k) what f + g leaves of the log's next states, and of its rewards where they are learned
    is_free : (n,) rows that count
    periods : of angles, as in ``shortest``

    Attributes
    ----------
    spread : (k,) root mean square of the simulator's own noise
    own : (k,) coordinates that scatter as the simulator does
    drawn : (k,) coordinates whose e is drawn from the log
    """

    def __init__(
        self, task: ContinuousTask, log: ContinuousTransitions, actions: IntArray, own: Moves, left_over: Array,
        is_free: BoolArray, periods: Array, rng: np.random.Generator,
    ) -> None:  # fmt: skip
        d, k = log.n_state, left_over.shape[1]
        some = np.sort(rng.permutation(len(log))[:N_SIMULATED])
        noisy = task.step(log.state[some], actions[some], rng)
        noise = np.zeros((len(some), k))
        noise[:, :d] = shortest(noisy.next_state - own.next_state[some], periods)
        self.spread, e = root_mean_square(noise), left_over[is_free]
        size, rounding = root_mean_square(e), np.full(k, ROUNDING)
        rounding[:d] *= shortest(log.next_state - log.state, periods).std(axis=0)
        rounding[:d] += np.finfo(float).eps * np.abs(log.next_state).max(axis=0)
        is_alike = np.abs(size / np.maximum(self.spread, 1e-300) - 1.0) <= max(0.05, 4.0 / np.sqrt(len(e)))
        is_alike &= np.abs(noise.mean(axis=0) - e.mean(axis=0)) <= SKEWED * self.spread * np.sqrt(2.0 / len(some))
        self.own = (self.spread > rounding) & is_alike & (task.n_disturbances > 0)
        self.drawn = ~self.own & (size > rounding)
        if k > d:
            is_paid_alike = noisy.terminated == own.terminated[some]
            self.spread[-1] = root_mean_square(np.where(is_paid_alike, noisy.reward - own.reward[some], 0.0))
        self._task = task
        self._gain = self._find_gain(log.state[some], actions[some]) if self.own.any() else None
        self._e, self._actions = np.where(self.drawn, e, 0.0), actions[is_free]
        scaled = self._e / np.maximum(size, 1e-300)
        widest = np.linalg.eigh(scaled.T @ scaled)[1][:, -1] / np.maximum(size, 1e-300)
        self._order = self._e @ widest  # rows are drawn in order along the direction in which e varies most
        self._rows = [np.flatnonzero(self._actions == a) for a in range(task.n_actions)]
        self._neighbors, self._near = Neighbors(task, log.state[is_free]), None
        if self.drawn.any():
            near = self._find_near(log.state[is_free])
            if self._is_local(near, rng.permutation(len(e))[:N_JUDGED]):
                order = np.argsort(self._order[near[:, :N_NEIGHBORS]], axis=1, kind="stable")
                self._near = np.take_along_axis(near, order, axis=1)
        self._set_weights(np.ones(len(e)))

    @property
    def local(self) -> bool:
        """Whether it is drawn from rows near by."""
        return self._near is not None

    def source(self, k: int) -> str:
        """Where coordinate k's noise is taken from."""
        return "simulator" if self.own[k] else "log" if self.drawn[k] else "none"

    def _find_gain(self, states: Array, actions: IntArray) -> Array | None:
        """(q, d) B where the simulator's noise is xi B at all of these rows, up to rounding; else None.

        Then a second step for the noise is spared: a sixth of Monte Carlo's time in CartPole.
        """
        rows = np.resize(np.arange(len(states)), max(len(states), 1000))
        xi = np.random.default_rng(0).standard_normal((len(rows), self._task.n_disturbances))
        still = self._task.noiseless_step(states[rows], actions[rows]).next_state
        noisy = self._task.moves(states[rows], actions[rows], xi).next_state
        gain = np.linalg.lstsq(xi, noisy - still)[0]
        is_additive = np.abs(noisy - still - xi @ gain).max() <= 8 * np.finfo(float).eps * np.abs([still, noisy]).max()
        return gain * self.own[: still.shape[1]] if is_additive else None

    def _find_near(self, states: Array) -> IntArray:
        """(n, N_NEIGHBORS + 1) rows of the same action near each row, itself among them; repeated where there are fewer."""
        near = np.empty((len(states), N_NEIGHBORS + 1), dtype=np.int64)
        for a, rows in enumerate(self._rows):
            if len(rows):
                k = min(N_NEIGHBORS + 1, len(rows))
                found = self._neighbors.find(states[rows], rows, k, key=a).reshape(len(rows), k)
                near[rows] = found[:, np.resize(np.arange(k), N_NEIGHBORS + 1)]
        return near

    def _is_local(self, near: IntArray, some: IntArray) -> bool:
        """Whether the residuals of the rows near by, or their sizes, explain some of a row's."""
        some = some[np.bincount(self._actions)[self._actions[some]] > N_NEIGHBORS]
        if len(some) < 50:
            return False
        is_self = near[some] == some[:, None]
        others = np.take_along_axis(near[some], np.argsort(is_self, axis=1, kind="stable")[:, :N_NEIGHBORS], axis=1)
        one, eight = self._e[some][:, self.drawn], self._e[others][:, :, self.drawn]
        pairs = ((one, eight.mean(axis=1)), (np.abs(one), np.abs(eight).mean(axis=1)))
        least = max(MIN_EXPLAINED, 9.0 / len(some))
        return any(_squared_correlation(x[:, i], y[:, i]) > least for x, y in pairs for i in range(one.shape[1]))

    def _set_weights(self, weights: Array) -> None:
        """Of each action its rows in order with these weights; of an action without rows, all."""
        self._weights, self._pools = weights, []
        for rows in self._rows:
            pool = rows if weights[rows].any() else np.arange(len(self._e))
            pool = pool[np.argsort(self._order[pool], kind="stable")]
            self._pools.append((pool, np.cumsum(weights[pool])))

    def reweighted(self, weights: Array) -> Scatter:
        """The same with rows drawn by these weights."""
        again = copy.copy(self)
        again._set_weights(weights)
        return again

    def draw(self, states: Array, actions: IntArray, uniform: Array) -> Array:
        """(n, k) residuals of logged rows of the same action, by the quantile ``uniform``."""
        chosen = np.empty(len(states), dtype=np.int64)
        for a in np.unique(actions):
            at = np.flatnonzero(actions == a)
            if self._near is None or len(self._rows[a]) == 0:
                chosen[at] = draw_rows(self._pools[a], uniform[at])
            else:
                near = self._near[self._neighbors.find(states[at], self._rows[a], key=a)]
                weights = self._weights[near]
                running = np.cumsum(np.where(weights.any(axis=1, keepdims=True), weights, 1.0), axis=1)
                place = (running <= (uniform[at] * running[:, -1])[:, None]).sum(axis=1)
                chosen[at] = near[np.arange(len(at)), np.minimum(place, N_NEIGHBORS - 1)]
        return np.asarray(self._e[chosen])

    def own_noise(self, states: Array, actions: IntArray, own: Moves, xi: Array) -> Array:
        """(n, d) the simulator's noise, of the coordinates that scatter as it does; ``own`` is its step without noise."""
        if self._gain is not None:
            return xi @ self._gain
        noise = self._task.moves(states, actions, xi).next_state - own.next_state
        return np.where(self.own[: noise.shape[1]], noise, 0.0)


def root_mean_square(values: Array) -> Array:
    """Of each column."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))


def _squared_correlation(x: Array, y: Array) -> float:
    x, y = x - x.mean(), y - y.mean()
    both = float((x * x).sum() * (y * y).sum())
    return float((x * y).sum()) ** 2 / both if both > 0 else 0.0
