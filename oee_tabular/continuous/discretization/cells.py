"""Cells around visited states, for tasks of four dimensions and more: ``VisitedCells``.

A uniform grid spends nearly all its vertices where no episode goes. Here the states are the Voronoi cells of centres put (by
Lloyd's iteration [1]) among states that a log or the simulator did visit. The visited states are kept, whole: some of them are
stepped under every action, and the log's under the action that was logged. Transitions and policies are means over the states
of a cell,

    P(j | i, a) = mean over visited s in cell i of [f(s, a, xi) in cell j].

Reference: [1] S. Lloyd, Least squares quantization in PCM, IEEE Transactions on Information Theory 28, 1982.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import canonical
from oee_tabular.continuous.discretization.places import Places, each_action
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_states

NEAREST = 10  # cells within a reach of 1; each further one doubles them


@dataclass(frozen=True, eq=False)
class VoronoiCells:
    """The cells of ``centres`` (n, k) under the distance |x - y| / scale, with the largest distance that was seen."""

    centres: Array
    scale: Array
    radius: float

    @cached_property
    def _tree(self) -> Any:
        return cKDTree(self.centres / self.scale)

    @property
    def n_cells(self) -> int:
        """The number of centres."""
        return len(self.centres)

    def nearest(self, features: Array) -> tuple[IntArray, Array]:
        """The cell of each point, and its distance from the centre."""
        distance, number = self._tree.query(features / self.scale)
        return np.asarray(number, dtype=np.int64), np.asarray(distance)

    def weights(self, features: Array) -> sparse.csr_array:
        """(n, n_cells) 1 in the point's cell."""
        number = self.nearest(features)[0]
        n = len(number)
        return sparse.csr_array((np.ones(n), number, np.arange(n + 1)), shape=(n, self.n_cells))

    def outside(self, features: Array) -> BoolArray:
        """(n,) which points are farther from every centre than any visited state was."""
        return np.asarray(self.nearest(features)[1] > self.radius)

    def neighbourhood(self, task: ContinuousTask, reach: int) -> sparse.csr_array:
        """(n_cells, S) uniform over the nearest cells and, where episodes can end, what is over."""
        many = min(NEAREST * 2 ** (reach - 1), self.n_cells)
        near = self._tree.query(self.centres / self.scale, k=many)[1].reshape(-1, many)
        if task.terminates:
            near = np.concatenate([near, np.full((len(near), 1), self.n_cells)], axis=1)
        size, width = (self.n_cells, self.n_cells + task.terminates), near.shape[1]
        starts = np.arange(len(near) + 1) * width
        return canonical(
            sparse.csr_array((np.full(near.size, 1.0 / width), near.ravel(), starts), shape=size), drop_zeros=True
        )

    def extent(self) -> str:
        """Number of cells and reach."""
        return f"the {self.n_cells} cells of visited states (reach {self.radius:.3g})"


@dataclass(frozen=True)
class VisitedCells:
    """Voronoi cells of visited states, for ``discretize(task, log, cells=VisitedCells(3000))``.

    Parameters
    ----------
    n_cells : at most so many; cells in which no visited state lies are dropped
    lloyd : Lloyd iterations for the centres
    n_simulated : states that the task and the ``others`` of ``discretize`` visit by themselves under its ``policies``, for what
        the log leaves out
    n_stepped : of all these states, how many are stepped under every action; the log's are under the logged one as well
    max_steps : longest episode; states of the log later than this do not shape the cells

    Notes
    -----
    The same log, policies and seed give the same cells. Cost: lloyd (n + n_simulated) + A n_stepped nearest-cell searches, for
    each task.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, discretize
    >>> model = discretize(CartPole(form="full"), cells=VisitedCells(200), policies=[cartpole_policy(0.3)], closure_episodes=0)
    >>> model.mdp.n_states
    201
    """

    n_cells: int
    lloyd: int = 3
    n_simulated: int = 30_000
    n_stepped: int = 60_000
    max_steps: int = 100

    def __post_init__(self) -> None:
        for name in ("n_cells", "n_simulated", "n_stepped", "max_steps"):
            _checks.positive_integer(getattr(self, name), name)
        if self.lloyd:
            _checks.positive_integer(self.lloyd, "lloyd")

    def places(
        self,
        task: ContinuousTask,
        log: ContinuousTransitions | None,
        others: Sequence[ContinuousTask],
        policies: Sequence[StatePolicy],
        seed: Any,
    ) -> Places:
        """Cells of the log's states and of those that the simulators visit, and some of these under each action."""
        rng = _checks.generator(seed)
        points = visited_states([task, *others], policies, self.n_simulated, max_steps=self.max_steps, seed=rng)
        if log is not None:
            own = check_states(task, log.state, "log.state")
            early = own if log.timestep is None else own[log.timestep < self.max_steps]
            points = np.concatenate([early, points])
        cells = self._cells(task.features(points), rng)
        cell = cells.nearest(task.features(points))[0]
        one_each = np.unique(cell, return_index=True)[1]
        chosen = np.concatenate([one_each, rng.permutation(len(points))[: max(0, self.n_stepped - len(one_each))]])
        states, actions = each_action(task, points[chosen])
        row = np.repeat(cell[chosen], task.n_actions) * task.n_actions + actions
        if log is not None:
            logged = log.action_numbers(task.actions)
            row = np.concatenate([row, cells.nearest(task.features(own))[0] * task.n_actions + logged])
            states, actions = np.concatenate([states, own]), np.concatenate([actions, logged])
        n = np.bincount(row, minlength=cells.n_cells * task.n_actions)
        entries = (1.0 / n[row], (row, np.arange(len(row))))
        averages = sparse.csr_array(entries, shape=(cells.n_cells * task.n_actions, len(row)))
        facts = {"builder": "VisitedCells", "n_cells": cells.n_cells, "visited": len(points)}
        return Places(cells, states, actions, averages, points, cell, None, True, int(rng.integers(2**62)), facts)

    def _cells(self, features: Array, rng: np.random.Generator) -> VoronoiCells:
        """Centres among these points (m, k)."""
        spread = features.std(axis=0)
        scale = np.where(spread > 0, spread, 1.0)
        points = features / scale
        unique = np.unique(points, axis=0)
        centres = unique[rng.permutation(len(unique))[: self.n_cells]]
        for _ in range(self.lloyd):
            number = cKDTree(centres).query(points)[1]
            n = np.bincount(number, minlength=len(centres))
            total = np.stack([np.bincount(number, column, len(centres)) for column in points.T], axis=1)
            centres = total[n > 0] / n[n > 0, None]
        distance, number = cKDTree(centres).query(points)
        used = np.unique(number)
        return VoronoiCells(centres[used] * scale, scale, float(distance.max()))


def visited_states(
    tasks: Sequence[ContinuousTask], policies: Sequence[StatePolicy], n: int, *, max_steps: int, seed: Any
) -> Array:
    """(n, d) states before each transition, in equal parts from every task under every policy.

    Parameters
    ----------
    tasks : those that the cells must serve: the simulator under several parameters (never the target's data)
    policies : functions of states (n, d) giving probabilities (n, A)
    n : how many states in all
    max_steps : longest episode
    seed : the same seed gives the same bits

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> visited_states([CartPole(5.0), CartPole(20.0)], [cartpole_policy(0.3)], 1000, max_steps=100, seed=0).shape
    (1000, 4)
    """
    size = _checks.positive_integer(n, "n")
    pairs = [(task, policy) for task in tasks for policy in policies]
    if not pairs:
        raise ValueError("tasks and policies must have at least one each; one of them is empty")
    streams = _checks.generator(seed).spawn(len(pairs))
    each = -(-size // len(pairs))
    found = [
        record(task, policy, n_transitions=each, max_steps=max_steps, seed=stream).state
        for (task, policy), stream in zip(pairs, streams, strict=True)
    ]
    return np.concatenate(found)[:size]
