"""Multilinear interpolation on a regular grid of at most a few dimensions: ``GridInterpolation``.

States are the vertices; a point in a cell is shared out among its 2^d corners so that its mean is kept. It is the Markov chain
approximation of Munos and Moore [1]: the mean of a step is exact, and its variance too large by f (1 - f) h^2 a step and
coordinate, which is why a grid must be fine compared with the *step*, not with the range.

*At a log.* A log's states lie within the cells, not on the vertices, and soft counts of its transitions spread wider than the
vertices' own rows. For a ratio of transition probabilities the simulator must be looked at in the same places: with a log the
row of (i, a) is the mean over the log's own (s, a), each weighed by w_i(s), of where the *simulator* leads from there. The
strength of a prior must then be given (small): the evidence takes the rows for independent samples, finds them closer than
those would be, and believes the simulator.

*Where a command moves the features alike everywhere* (``task.is_translation_invariant``) it is the other way round: the rows
are the vertices' own, and the log's transitions are carried to the vertices.

Reference: [1] R. Munos and A. Moore, Variable resolution discretization in optimal control, Machine Learning 49, 2002.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import canonical
from oee_tabular.continuous.discretization.places import Places, each_action
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_states

POINTS_OF_A_BOX = 4  # along each axis, where a state is the box around its vertex


@dataclass(frozen=True, eq=False)
class Grid:
    """The vertices of a regular grid, numbered in C order.

    ``shape`` vertices from ``low`` to ``high`` along each coordinate; along a periodic one ``high`` is ``low`` again.
    """

    low: Array
    high: Array
    shape: tuple[int, ...]
    periodic: tuple[bool, ...]

    @property
    def n_cells(self) -> int:
        """The number of vertices."""
        return math.prod(self.shape)

    @property
    def spacing(self) -> Array:
        """(k,) distance between neighbouring vertices."""
        parts = np.array(self.shape) - np.where(self.periodic, 0, 1)
        return np.asarray((self.high - self.low) / parts)

    def vertices(self, numbers: IntArray | None = None) -> Array:
        """(n, k) where the vertices with these numbers (default: all) lie."""
        asked = np.arange(self.n_cells) if numbers is None else numbers
        return np.asarray(self.low + np.stack(np.unravel_index(asked, self.shape), axis=1) * self.spacing)

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) multilinear weights on the 2^k vertices around each point."""
        shape, (n, k) = np.array(self.shape), features.shape
        place = (features - self.low) / self.spacing
        place = np.where(self.periodic, place % shape, np.clip(place, 0.0, shape - 1.0))
        corner = np.minimum(place.astype(np.int64), shape - np.where(self.periodic, 1, 2))
        fraction = place - corner
        numbers, weights = np.zeros((n, 2**k), dtype=np.int64), np.ones((n, 2**k))
        for m, upper in enumerate(itertools.product((0, 1), repeat=k)):
            for axis in range(k):
                step = (corner[:, axis] + upper[axis]) % shape[axis]
                numbers[:, m] = numbers[:, m] * shape[axis] + step
                weights[:, m] *= fraction[:, axis] if upper[axis] else 1.0 - fraction[:, axis]
        starts = np.arange(n + 1) * 2**k
        return canonical(
            sparse.csr_array((weights.ravel(), numbers.ravel(), starts), shape=(n, self.n_cells)), drop_zeros=True
        )

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points lie beyond the faces."""
        room = 1e-9 * self.spacing
        beyond = (features < self.low - room) | (features > self.high + room)
        return np.asarray((beyond & ~np.array(self.periodic)).any(axis=1))

    def neighbourhood(self, task: ContinuousTask, reach: int) -> sparse.csr_array:
        """(n_cells, S) uniform over the vertices within ``reach`` cells; beyond the grid only what is over there counts."""
        shape = np.array(self.shape)
        offsets = np.array(list(itertools.product(range(-reach, reach + 1), repeat=len(shape))))
        index = np.stack(np.unravel_index(np.arange(self.n_cells), self.shape), axis=1)[:, None, :] + offsets
        index = np.where(self.periodic, index % shape, index)
        inside = ((index >= 0) & (index < shape)).all(axis=2)
        over = np.zeros(inside.shape, dtype=np.bool_)
        if task.terminates:
            places = (self.low + index * self.spacing).reshape(-1, len(shape))
            over = task.terminated(task.embed(places)).reshape(inside.shape)
        flat = np.ravel_multi_index(tuple(np.moveaxis(np.clip(index, 0, shape - 1), 2, 0)), self.shape)
        share = np.where(inside | over, 1.0, 0.0)
        share /= share.sum(axis=1, keepdims=True)
        columns, starts = np.where(over, self.n_cells, flat), np.arange(self.n_cells + 1) * len(offsets)
        size = (self.n_cells, self.n_cells + task.terminates)
        return canonical(sparse.csr_array((share.ravel(), columns.ravel(), starts), shape=size), drop_zeros=True)

    def extent(self) -> str:
        """Shape and range."""
        ranges = " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(self.low, self.high, strict=True))
        return f"the {' x '.join(map(str, self.shape))} grid on {ranges}"


@dataclass(frozen=True)
class GridInterpolation:
    """A regular grid over a task's features, for ``discretize(task, log, cells=GridInterpolation((60, 60)))``.

    Parameters
    ----------
    shape : vertices along each feature, at least 2
    low, high : (k,) the grid's range; default the task's ``feature_low`` and ``feature_high``
    noise_points : the number of Gauss-Hermite points for each component of the disturbance (one number for all, or one each);
        1 leaves that component at 0; None: the task's ``noise_points``
    vertex_weight : at a log, how many transitions the row of the vertex itself is worth beside the log's places

    Notes
    -----
    Cost: A S 2^k entries for each noise point; 10^6 vertices with two actions in a few seconds and under a gigabyte.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, discretize
    >>> model = discretize(CartPole(gravity=10.0), cells=GridInterpolation((60, 60)))
    >>> model.mdp.n_states, model.over
    (3601, 3600)
    """

    shape: tuple[int, ...]
    low: Any = None
    high: Any = None
    noise_points: int | tuple[int, ...] | None = None
    vertex_weight: float = 0.01

    def __post_init__(self) -> None:
        try:
            shape = tuple(_checks.positive_integer(n, "shape") for n in self.shape)
        except TypeError:
            raise ValueError(f"shape must be a tuple of positive integers; got {_checks.show(self.shape)}") from None
        if not shape or min(shape) < 2:
            raise ValueError(f"shape must have at least 2 vertices along each feature; it is {shape}")
        object.__setattr__(self, "shape", shape)
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

    def places(
        self,
        task: ContinuousTask,
        log: ContinuousTransitions | None,
        others: Sequence[ContinuousTask],
        policies: Sequence[StatePolicy],
        seed: Any,
    ) -> Places:
        """The vertices under each action and, at a log, the log's own states and actions; the rest is not used."""
        grid = self.grid(task)
        vertices = grid.vertices()
        states, actions = each_action(task, task.embed(vertices))
        averages = None
        facts: dict[str, Any] = {
            "builder": "GridInterpolation",
            "shape": list(self.shape),
            "at_rows": 0,
            "at_outside": 0,
        }
        points = task.embed(vertices)
        if task.is_translation_invariant:
            line = (np.arange(POINTS_OF_A_BOX) + 0.5) / POINTS_OF_A_BOX - 0.5
            within = np.stack(np.meshgrid(*[line] * len(self.shape), indexing="ij"), axis=-1).reshape(
                -1, len(self.shape)
            )
            points = task.embed((vertices[:, None, :] + within * grid.spacing).reshape(-1, len(self.shape)))
        elif log is not None:
            own, chosen = check_states(task, log.state, "log.state"), log.action_numbers(task.actions)
            inside = ~grid.outside(task.features(own))
            averages = self._averages(grid.weights(task.features(own[inside])), chosen[inside], task.n_actions)
            states, actions = np.concatenate([states, own[inside]]), np.concatenate([actions, chosen[inside]])
            facts |= {
                "at_rows": len(log),
                "at_outside": int((~inside).sum()),
                "vertex_weight": self.vertex_weight,
            }
        cell = np.repeat(np.arange(grid.n_cells), len(points) // grid.n_cells)
        return Places(grid, states, actions, averages, points, cell, self.noise_points, False, seed, facts)

    def _averages(self, start: sparse.csr_array, actions: IntArray, n_actions: int) -> sparse.csr_array:
        """W for the vertices' own pairs and then the log's: w_i(s), and ``vertex_weight`` for the vertex itself."""
        rows = start.indices.astype(np.int64) * n_actions + np.repeat(actions, np.diff(start.indptr))
        places = sparse.csr_array((start.data, rows, start.indptr), shape=(len(actions), start.shape[1] * n_actions))
        mass = np.asarray(places.sum(axis=0))
        total = mass + self.vertex_weight
        own = np.divide(self.vertex_weight, total, out=np.ones_like(mass), where=mass > 0)
        scale = np.divide(1.0, total, out=np.zeros_like(mass), where=mass > 0)
        logged = sparse.diags_array(scale) @ places.T
        return sparse.csr_array(sparse.hstack([sparse.diags_array(own), logged], format="csr"))
