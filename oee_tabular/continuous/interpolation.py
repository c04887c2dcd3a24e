"""Multilinear interpolation on a regular grid: a continuous task as a FiniteMDP on the grid's vertices.

    P(j | i, a) = sum_k c_k w_j(f(x_i, a, xi_k))

x_i a vertex, w_j the multilinear weights (a point in a cell is shared out among its 2^d corners so that its mean is kept), and
(c_k, xi_k) Gauss-Hermite points of the process noise, or xi = 0 alone. It is the Markov chain approximation of Munos and
Moore [1]: the mean of a step is exact, and its variance too large by f (1 - f) h^2 a step and coordinate, which is why a grid
must be fine compared with the *step*, not with the range.

*At a log.* A log's states lie within the cells, not on the vertices, and soft counts of its moves spread wider than the rows
above. For a ratio of transition probabilities the simulator must be looked at in the same places: with ``at=log`` the row of
(i, a) is the mean over the log's own (s, a), each weighed by w_i(s), of where the *simulator* leads from there. Target and
simulator then share the places, and their rows differ by the dynamics alone; so a prior's strength must be given (small): the
evidence takes the rows for independent samples, finds them closer than those would be, and believes the simulator.

Reference: [1] R. Munos and A. Moore, Variable resolution discretization in optimal control, Machine Learning 49, 2002.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._progress import progress_bar
from oee_tabular._sparse import canonical, row_of_entry, row_sums
from oee_tabular._threads import one_thread
from oee_tabular.continuous.closure import warn_if_coarse
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.grid import ENTRIES_AT_A_TIME, Grid, begins, each_action, gauss_hermite
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.support import with_floor
from oee_tabular.continuous.task import ContinuousTask, check_states, task_metadata
from oee_tabular.mdp import FiniteMDP


@dataclass(frozen=True)
class GridInterpolation:
    """Builds a FiniteMDP on the vertices of a regular grid over a task's features.

    Parameters
    ----------
    shape : vertices along each feature, at least 2
    low, high : (k,) the grid's range; default the task's ``feature_low`` and ``feature_high``
    noise_points : 1, or the number of Gauss-Hermite points for each component of the disturbance (one number for all, or one
        each); 1 leaves that component at 0
    floor, reach : with probability ``floor`` a step ends anywhere, uniformly, within ``reach`` cells of where it leads from the
        vertex: a *defensive* simulator, which gives probability to what a log's states can do that lie within a cell of it.
        It changes the simulator; the change is in ``metadata``
    vertex_weight : with ``at=log``, how many moves the row of the vertex itself is worth beside the log's places
    closure_episodes : episodes of the uniform policy that measure the closure error; 0: not measured
    tolerance : a closure error beyond it is warned about

    Notes
    -----
    Cost: A S 2^k entries for each noise point; 10^6 vertices with two actions in a few seconds and under a gigabyte.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole
    >>> model = GridInterpolation((60, 60)).build(CartPole(gravity=10.0))
    >>> model.mdp.n_states, model.over
    (3601, 3600)
    """

    shape: tuple[int, ...]
    low: Any = None
    high: Any = None
    noise_points: int | tuple[int, ...] = 1
    floor: float = 0.0
    reach: int = 2
    vertex_weight: float = 0.01
    closure_episodes: int = 2000
    tolerance: float = 0.05

    def __post_init__(self) -> None:
        try:
            shape = tuple(_checks.positive_integer(n, "shape") for n in self.shape)
        except TypeError:
            raise ValueError(f"shape must be a tuple of positive integers; got {_checks.show(self.shape)}") from None
        if not shape or min(shape) < 2:
            raise ValueError(f"shape must have at least 2 vertices along each feature; it is {shape}")
        object.__setattr__(self, "shape", shape)
        _checks.number_in(self.floor, "floor", 0.0, 1.0)
        _checks.positive_integer(self.reach, "reach")
        _checks.number_in(self.vertex_weight, "vertex_weight", 0.0, np.inf)

    def grid(self, task: ContinuousTask) -> Grid:
        """The grid for the features of ``task``."""
        k = len(task.feature_names)
        if len(self.shape) != k:
            raise ValueError(
                f"shape must have {k} numbers, one for each feature of {task.name} ({', '.join(task.feature_names)}); "
                f"it is {self.shape}"
            )
        ends = []
        for name, value, default in (("low", self.low, task.feature_low), ("high", self.high, task.feature_high)):
            end = _checks.float_array(default if value is None else value, name)
            if end.shape != (k,):
                raise ValueError(f"{name} must have shape ({k},); it has shape {end.shape}")
            _checks.require_finite(end, name)
            ends.append(end)
        bad = np.flatnonzero(ends[0] >= ends[1])
        if bad.size:
            raise ValueError(f"high[{bad[0]}] must be above low[{bad[0]}], {ends[0][bad[0]]}; it is {ends[1][bad[0]]}")
        return Grid(ends[0], ends[1], self.shape, task.periodic)

    @one_thread
    def build(
        self,
        task: ContinuousTask,
        *,
        discount: float = 0.99,
        rewards: str = "expected",
        at: ContinuousTransitions | None = None,
    ) -> Discretization:
        """The task on the grid.

        Parameters
        ----------
        rewards : "expected" | "transition"
            r(s, a), the mean reward of the step; or r(s, a, s') by the task's ``reward_between``, shifted in each row so
            that its mean in this task is r(s, a): what is needed where the reward depends on s' and another task's
            transitions are to be weighed with it.
        at : a log of continuous states
            Look at the task in the log's own (s, a) (its next states are not used); ``diagnostics["at_outside"]`` of its
            rows lie outside the grid and are left out.

        Raises
        ------
        ValueError
            A grid that does not fit the task's features; a task whose step leaves the finite numbers.
        """
        _checks.one_of(rewards, "rewards", ("expected", "transition"))
        grid = self.grid(task)
        nodes = gauss_hermite(self.noise_points, task.n_disturbances)
        matrix, paid, diagnostics = self._at_vertices(task, grid, nodes)
        metadata = task_metadata(task) | {
            "builder": "GridInterpolation",
            "shape": list(self.shape),
            "noise_points": self.noise_points if isinstance(self.noise_points, int) else list(self.noise_points),
            "floor": self.floor,
            "reach": self.reach,
            "at_rows": 0,
        }
        if at is not None:
            matrix, paid, left_out = _at_log(task, grid, nodes, at, matrix, paid, self.vertex_weight)
            diagnostics["at_outside"] = left_out
            metadata |= {"at_rows": len(at), "vertex_weight": self.vertex_weight}
        if self.floor > 0.0:
            matrix = with_floor(task, grid, matrix, self.floor, self.reach)
        if task.terminates:
            stay = sparse.csr_array(
                (np.ones(task.n_actions), (np.arange(task.n_actions), np.full(task.n_actions, grid.n_cells))),
                shape=(task.n_actions, grid.n_cells + 1),
            )
            matrix = sparse.csr_array(sparse.vstack([matrix, stay], format="csr"))
            paid = np.concatenate([paid, np.zeros((1, task.n_actions))])
        points = task.embed(grid.vertices())
        table: object = paid
        if rewards == "transition":
            table = _transition_rewards(task, points, canonical(matrix, drop_zeros=True), paid)
        mdp = FiniteMDP(matrix, table, begins(task, grid), discount)
        found = Discretization(mdp, task, grid, points, np.arange(grid.n_cells), metadata, diagnostics)
        if self.closure_episodes:
            closure = found.closure(n_episodes=self.closure_episodes)
            found = replace(found, diagnostics=diagnostics | {"closure": closure})
            warn_if_coarse(found, closure, diagnostics["step_in_cells"], self.tolerance)
        return found

    def _at_vertices(
        self, task: ContinuousTask, grid: Grid, nodes: tuple[Array, Array]
    ) -> tuple[sparse.csr_array, Array, dict[str, Any]]:
        """Rows s*A + a, rewards (S, A) and diagnostics of the task on the vertices; the state that is over has no row yet."""
        n = grid.n_cells
        at_a_time = max(1, ENTRIES_AT_A_TIME // (len(nodes[1]) * 2 ** len(self.shape) * task.n_actions))
        blocks, paid, clipped, lengths = [], [], 0.0, []
        for low in progress_bar("building the grid", range(0, n, at_a_time)):
            features = grid.vertices(np.arange(low, min(low + at_a_time, n)))
            states, actions = each_action(task, task.embed(features))
            block, rewards, left, step = _moved(task, grid, states, actions, nodes)
            blocks.append(block)
            paid.append(rewards.reshape(-1, task.n_actions))
            clipped += left
            lengths.append(step[:: max(1, len(step) // 2000)])
        middle = [float(x) for x in np.median(np.concatenate(lengths), axis=0)]
        matrix = blocks[0] if len(blocks) == 1 else sparse.csr_array(sparse.vstack(blocks, format="csr"))
        return matrix, np.concatenate(paid), {"clipped": clipped / (n * task.n_actions), "step_in_cells": middle}


def _moved(
    task: ContinuousTask, grid: Grid, states: Array, actions: IntArray, nodes: tuple[Array, Array]
) -> tuple[sparse.csr_array, Array, float, Array]:
    """Where (s, a) lead: weights (n, S), rewards (n,), the number of steps that left the grid, step lengths in spacings."""
    n_states = grid.n_cells + task.terminates
    gone = task.terminated(states) if task.terminates else np.zeros(len(states), dtype=np.bool_)
    columns, values = [], []
    paid, clipped = np.zeros(len(states)), 0.0
    step = np.zeros((len(states), len(grid.shape)))
    before = task.features(states)
    period = np.where(grid.periodic, grid.high - grid.low, np.inf)
    for node, chance in zip(*nodes, strict=True):
        moved = task.moves(states, actions, np.broadcast_to(node, (len(states), len(node))))
        bad = np.flatnonzero(~np.isfinite(moved.next_state).all(axis=1))
        if bad.size:
            raise ValueError(
                f"task must step to finite states; from {states[bad[0]].tolist()} under action {actions[bad[0]]} it steps to "
                f"{moved.next_state[bad[0]].tolist()}"
            )
        arrival = task.features(moved.next_state)
        ended = (moved.terminated & task.end_shows(moved.next_state) | gone) if task.terminates else gone
        vertices, weights = grid.interpolate(arrival)
        vertices[ended] = grid.n_cells
        weights[ended] = 1.0 / weights.shape[1]
        columns.append(vertices)
        values.append(chance * weights)
        paid += chance * np.where(gone, 0.0, moved.reward)
        clipped += chance * float(np.sum(grid.outside(arrival) & ~ended))
        length = np.abs(arrival - before)
        step += chance * np.minimum(length, np.abs(period - length)) / grid.spacing
    wide = columns[0] if len(columns) == 1 else np.concatenate(columns, axis=1)
    data = values[0] if len(values) == 1 else np.concatenate(values, axis=1)
    starts = np.arange(len(states) + 1) * wide.shape[1]
    matrix = sparse.csr_array((data.ravel(), wide.ravel(), starts), shape=(len(states), n_states))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix, paid, clipped, step


def _at_log(
    task: ContinuousTask,
    grid: Grid,
    nodes: tuple[Array, Array],
    log: ContinuousTransitions,
    matrix: sparse.csr_array,
    paid: Array,
    vertex_weight: float,
) -> tuple[sparse.csr_array, Array, int]:
    """Rows averaged over the log's own (s, a), the vertex's row counting as ``vertex_weight`` moves."""
    states = check_states(task, log.state, "at.state")
    actions = log.action_numbers(task.actions)
    inside = ~grid.outside(task.features(states))
    states, actions = states[inside], actions[inside]
    start = grid.weights(task.features(states))
    rows = start.indices.astype(np.int64) * task.n_actions + np.repeat(actions, np.diff(start.indptr))
    places = sparse.csr_array((start.data, rows, start.indptr), shape=(len(states), matrix.shape[0]))
    arrival, rewards, _, _ = _moved(task, grid, states, actions, nodes)
    mass = np.asarray(places.sum(axis=0))
    total = mass + vertex_weight
    own = np.divide(vertex_weight, total, out=np.ones_like(mass), where=mass > 0)
    scale = np.divide(1.0, total, out=np.zeros_like(mass), where=mass > 0)
    averaged = sparse.diags_array(scale) @ (places.T @ arrival) + sparse.diags_array(own) @ matrix
    mean = scale * (places.T @ rewards) + own * paid.reshape(-1)
    return sparse.csr_array(averaged), np.asarray(mean.reshape(paid.shape)), int(np.sum(~inside))


def _transition_rewards(
    task: ContinuousTask, points: Array, matrix: sparse.csr_array, expected: Array
) -> sparse.csr_array:
    """r(s, a, s') between the points of the cells, shifted so that each row's mean is r(s, a)."""
    rows = row_of_entry(matrix)
    first, action, following = rows // task.n_actions, rows % task.n_actions, matrix.indices
    alive = (first < len(points)) & (following < len(points))
    data = expected.reshape(-1)[rows]
    between = task.reward_between(points[first[alive]], action[alive], points[following[alive]])
    if between is None:
        raise ValueError(
            f"rewards must be 'expected' for {task.name}, which has no reward_between; they are 'transition'"
        )
    data[alive] = between
    apart = expected.reshape(-1) - row_sums(matrix, matrix.data * data)
    return sparse.csr_array((data + apart[rows], matrix.indices, matrix.indptr), shape=matrix.shape)
