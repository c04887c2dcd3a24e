"""The scatter e of a corrected simulator, s' = f(s, a) + g(s, a) + e.

Each coordinate scatters by nothing, by the simulator's own noise, or by residuals drawn
from the log. ``measure_scatter`` decides which, in this order:

1. The simulator's own noise is sampled at the log's rows.
2. A coordinate takes it where the log's residuals have its size and its mean. It takes
   nothing where they are rounding, and the log's residuals elsewhere.
3. These are drawn from the rows near by (``find_near``) if the residuals of neighbours
   tell of each other, and from all rows of the action if not.

``draw_residuals`` draws them by a quantile, so that common random numbers stay common.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from oee_tabular.continuous.correction.neighbors import Neighbors
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import ContinuousTask, Moves, shortest
from oee_tabular.typing import Array, BoolArray, IntArray

N_NEIGHBORS = 8  # rows near by, from which one is drawn
# share of a residual, or of its size, that its neighbours explain: it is drawn from
# them
MIN_EXPLAINED = 0.02
N_JUDGED = 3000  # rows at which that is judged
MIN_JUDGED = 50  # with fewer rows nothing is said of neighbours
N_SIMULATED = 5000  # steps by which the simulator's own noise is known
MAX_MEAN_ERRORS = 5.0  # standard errors between the means of two equal scatters
SCATTER_ROUNDING = 1e-9  # displacements' deviations: less scatter is rounding


class Pool(NamedTuple):
    """Rows from which one is drawn by a quantile.

    Attributes
    ----------
    rows : ndarray of int, shape (m,)
        The rows, in order along the direction in which e varies most.
    running : ndarray of shape (m,)
        The running sum of their weights.
    """

    rows: IntArray
    running: Array


@dataclass(frozen=True, eq=False)
class Scatter:
    """The scatter e of a corrected simulator, coordinate by coordinate.

    Of n rows of the log, k coordinates (with the reward, where that is learned).

    Attributes
    ----------
    spread : ndarray of shape (k,)
        The root mean square of the simulator's own noise.
    own : ndarray of bool, shape (k,)
        The coordinates that scatter as the simulator does.
    drawn : ndarray of bool, shape (k,)
        The coordinates whose e is drawn from the log.
    residuals : ndarray of shape (n, k)
        The e of each row; 0 in coordinates that are not drawn.
    order : ndarray of shape (n,)
        Places of the rows along the direction in which e varies most.
    rows : sequence of ndarray of int
        The rows of each action.
    neighbors : Neighbors
        The rows' states.
    near : ndarray of int, shape (n, N_NEIGHBORS), or None
        The rows near each row, in order, where e is drawn from them.
    weights : ndarray of shape (n,)
        How often each row is drawn: 1, or its number in a bootstrap.
    pools : sequence of Pool
        All rows of each action.
    """

    spread: Array
    own: BoolArray
    drawn: BoolArray
    residuals: Array
    order: Array
    rows: Sequence[IntArray]
    neighbors: Neighbors
    near: IntArray | None
    weights: Array
    pools: Sequence[Pool]

    def source(self, k: int) -> Literal["none", "simulator", "log"]:
        """Return where the scatter of coordinate k is taken from."""
        if self.own[k]:
            return "simulator"
        return "log" if self.drawn[k] else "none"

    def reweighted(self, weights: Array) -> Scatter:
        """Return the same scatter with rows drawn by these weights."""
        pools = _pool_rows(self.rows, self.order, weights)
        return replace(self, weights=weights, pools=pools)


def measure_scatter(
    task: ContinuousTask,
    log: ContinuousTransitions,
    actions: IntArray,
    own: Moves,
    left_over: Array,
    is_free: BoolArray,
    periods: Array,
    rng: np.random.Generator,
) -> Scatter:
    """Decide where each coordinate's scatter is taken from, by a log.

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

    Returns
    -------
    Scatter
        The scatter.
    """
    own_noise = _sample_noise(task, log, actions, own, left_over.shape[1], periods, rng)
    e = left_over[is_free]
    size = root_mean_square(e)
    rounding = _rounding_of(log, left_over.shape[1], periods)
    is_own = _is_like(own_noise, e, size) & (own_noise.spread > rounding)
    is_own &= task.n_disturbances > 0
    is_drawn = ~is_own & (size > rounding)
    e = np.where(is_drawn, e, 0.0)
    order = _order_rows(e, size)
    kept_actions = actions[is_free]
    rows = [np.flatnonzero(kept_actions == a) for a in range(task.n_actions)]
    states = log.state[is_free]
    neighbors = Neighbors(task, states)
    near = None
    if is_drawn.any():
        found = _find_near(neighbors, states, rows)
        judged = _draw_judged(kept_actions, rng)
        if _tell_of_each_other(e[:, is_drawn], found, judged):
            near = _sort_near(found, order)
    weights = np.ones(len(e))
    pools = _pool_rows(rows, order, weights)
    return Scatter(
        own_noise.spread_with_reward,
        is_own,
        is_drawn,
        residuals=e,
        order=order,
        rows=rows,
        neighbors=neighbors,
        near=near,
        weights=weights,
        pools=pools,
    )


class OwnNoise(NamedTuple):
    """The simulator's own noise at rows of a log.

    Attributes
    ----------
    number : int
        How many rows it was sampled at.
    mean : ndarray of shape (k,)
        The mean of each coordinate; 0 of the reward.
    spread : ndarray of shape (k,)
        The root mean square; 0 of the reward, which never takes it.
    spread_with_reward : ndarray of shape (k,)
        The same, with that of the reward.
    """

    number: int
    mean: Array
    spread: Array
    spread_with_reward: Array


def _sample_noise(
    task: ContinuousTask,
    log: ContinuousTransitions,
    actions: IntArray,
    own: Moves,
    k: int,
    periods: Array,
    rng: np.random.Generator,
) -> OwnNoise:
    """Sample the simulator's noise in ``k`` coordinates, about its steps ``own``."""
    d = log.n_state
    some = np.sort(rng.permutation(len(log))[:N_SIMULATED])
    noisy = task.step(log.state[some], actions[some], rng)
    noise = np.zeros((len(some), k))
    noise[:, :d] = shortest(noisy.next_state - own.next_state[some], periods)
    spread = root_mean_square(noise)
    with_reward = spread.copy()
    if k > d:
        is_end_alike = noisy.terminated == own.terminated[some]
        reward_noise = np.where(is_end_alike, noisy.reward - own.reward[some], 0.0)
        with_reward[-1] = root_mean_square(reward_noise)
    return OwnNoise(len(some), noise.mean(axis=0), spread, with_reward)


def _rounding_of(log: ContinuousTransitions, k: int, periods: Array) -> Array:
    """Return the size (k,) below which a scatter is rounding."""
    d = log.n_state
    rounding = np.full(k, SCATTER_ROUNDING)
    rounding[:d] *= shortest(log.next_state - log.state, periods).std(axis=0)
    rounding[:d] += np.finfo(float).eps * np.abs(log.next_state).max(axis=0)
    return rounding


def _is_like(noise: OwnNoise, e: Array, size: Array) -> BoolArray:
    """Return in which coordinates (k,) what is left over is like the own noise.

    It has its size and its mean there.
    """
    most = max(0.05, 4.0 / np.sqrt(len(e)))
    is_alike = np.abs(size / np.maximum(noise.spread, 1e-300) - 1.0) <= most
    apart = np.abs(noise.mean - e.mean(axis=0))
    few = np.sqrt(2.0 / noise.number)
    return np.asarray(is_alike & (apart <= MAX_MEAN_ERRORS * noise.spread * few))


def draw_residuals(
    scatter: Scatter, states: Array, actions: IntArray, uniform: Array
) -> Array:
    """Draw residuals (n, k) of logged rows of the same action.

    They are chosen by the quantile ``uniform``.
    """
    chosen = np.empty(len(states), dtype=np.int64)
    for a in np.unique(actions):
        at = np.flatnonzero(actions == a)
        rows = scatter.rows[a]
        if scatter.near is None or len(rows) == 0:
            chosen[at] = draw_rows(scatter.pools[a], uniform[at])
            continue
        near = scatter.near[scatter.neighbors.find(states[at], rows, key=a)]
        weights = scatter.weights[near]
        # a bootstrap may leave all neighbours out: they then weigh the same
        has_weight = weights.any(axis=1, keepdims=True)
        running = np.cumsum(np.where(has_weight, weights, 1.0), axis=1)
        level = (uniform[at] * running[:, -1])[:, None]
        place = np.minimum((running <= level).sum(axis=1), N_NEIGHBORS - 1)
        chosen[at] = near[np.arange(len(at)), place]
    return np.asarray(scatter.residuals[chosen])


def draw_rows(pool: Pool, uniform: Array) -> IntArray:
    """Draw rows of a pool by the quantile ``uniform`` of their weights."""
    rows, running = pool
    place = np.searchsorted(running, uniform * running[-1], side="right")
    return np.asarray(rows[np.minimum(place, len(rows) - 1)])


def root_mean_square(values: Array) -> Array:
    """Compute the root mean square of each column."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))


def _order_rows(residuals: Array, size: Array) -> Array:
    """Return the rows' places along the direction in which residuals vary most.

    Each coordinate is measured in its own ``size``.
    """
    unit = np.maximum(size, 1e-300)
    scaled = residuals / unit
    widest = np.linalg.eigh(scaled.T @ scaled)[1][:, -1] / unit
    return np.asarray(residuals @ widest)


def _find_near(
    neighbors: Neighbors, states: Array, rows: Sequence[IntArray]
) -> IntArray:
    """Return the rows (n, N_NEIGHBORS + 1) of the same action that are nearest.

    A row itself is among them. They are repeated where there are fewer.
    """
    near = np.empty((len(states), N_NEIGHBORS + 1), dtype=np.int64)
    for a, own in enumerate(rows):
        if len(own):
            k = min(N_NEIGHBORS + 1, len(own))
            found = neighbors.find(states[own], own, k, key=a).reshape(len(own), k)
            near[own] = found[:, np.resize(np.arange(k), N_NEIGHBORS + 1)]
    return near


def _draw_judged(actions: IntArray, rng: np.random.Generator) -> IntArray:
    """Draw the rows that are judged, of actions with enough rows for neighbours."""
    judged = rng.permutation(len(actions))[:N_JUDGED]
    has_neighbors = np.bincount(actions)[actions[judged]] > N_NEIGHBORS
    return np.asarray(judged[has_neighbors])


def _tell_of_each_other(residuals: Array, near: IntArray, some: IntArray) -> bool:
    """Return whether the residuals of rows near by explain some of a row's.

    Their sizes may explain its size instead. ``some`` are the rows that are judged.
    """
    if len(some) < MIN_JUDGED:
        return False
    # a row itself comes last, and is left out
    is_self = near[some] == some[:, None]
    order = np.argsort(is_self, axis=1, kind="stable")[:, :N_NEIGHBORS]
    others = np.take_along_axis(near[some], order, axis=1)
    one = residuals[some]
    eight = residuals[others]
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


def _sort_near(near: IntArray, order: Array) -> IntArray:
    """Return the first ``N_NEIGHBORS`` rows near by, sorted by their ``order``."""
    kept = near[:, :N_NEIGHBORS]
    places = np.argsort(order[kept], axis=1, kind="stable")
    return np.take_along_axis(kept, places, axis=1)


def _pool_rows(rows: Sequence[IntArray], order: Array, weights: Array) -> list[Pool]:
    """Return the rows of each action in order, with these weights.

    An action without rows has all of them.
    """
    pools = []
    for own in rows:
        pool = own if weights[own].any() else np.arange(len(order))
        pool = pool[np.argsort(order[pool], kind="stable")]
        pools.append(Pool(pool, np.cumsum(weights[pool])))
    return pools
