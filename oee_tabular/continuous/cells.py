"""Cells around visited states: a continuous task of four to six dimensions as a FiniteMDP.

A uniform grid spends nearly all its vertices where no episode goes. Here the states are the Voronoi cells of centres put (by
Lloyd's iteration [1]) among states that episodes did visit. The visited states themselves are kept, whole: each is stepped
once under every action, and transitions, rewards and policies are means over the states of a cell,

    P(j | i, a) = mean over visited s in cell i of [f(s, a, xi) in cell j].

It rests on the sample: visit with a mixture of the policies, and of the parameters, that are to be evaluated.

Reference: [1] S. Lloyd, Least squares quantization in PCM, IEEE Transactions on Information Theory 28, 1982.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._progress import progress_bar
from oee_tabular._sparse import canonical
from oee_tabular._threads import one_thread
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.grid import VoronoiCells, begins
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_states, task_metadata
from oee_tabular.mdp import FiniteMDP

STATES_AT_A_TIME = 100_000


def visited_states(
    tasks: Sequence[ContinuousTask], policies: Sequence[StatePolicy], n: int, *, max_steps: int, seed: Any
) -> Array:
    """(n, d) states before each move, in equal parts from every task under every policy.

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


@dataclass(frozen=True)
class VisitedCells:
    """Builds a FiniteMDP on the Voronoi cells of visited states.

    Parameters
    ----------
    n_cells : at most so many; cells in which no visited state lies are dropped
    lloyd : Lloyd iterations for the centres
    floor, neighbours : with probability ``floor`` a step ends, uniformly, in one of the ``neighbours`` cells around that which
        it leads to, or is over (where episodes can end): a *defensive* simulator, as in ``GridInterpolation``
    seed : for the first centres and the disturbances

    Notes
    -----
    The same visited states and seed give the same cells whatever the task, so that simulator and target share their states.
    Cost: (lloyd + A) nearest-neighbour searches for each visited state.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy
    >>> task = CartPole(form="full")
    >>> visited = visited_states([task], [cartpole_policy(0.3)], 20_000, max_steps=100, seed=0)
    >>> VisitedCells(200, seed=0).build(task, visited).mdp.n_states
    201
    """

    n_cells: int
    lloyd: int = 4
    floor: float = 0.0
    neighbours: int = 8
    seed: Any = 0

    def __post_init__(self) -> None:
        _checks.positive_integer(self.n_cells, "n_cells")
        if self.lloyd:
            _checks.positive_integer(self.lloyd, "lloyd")
        _checks.number_in(self.floor, "floor", 0.0, 1.0)
        _checks.positive_integer(self.neighbours, "neighbours")

    def cells(self, features: Array) -> VoronoiCells:
        """Centres among these points (m, k)."""
        rng = _checks.generator(self.seed)
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

    @one_thread
    def build(
        self,
        task: ContinuousTask,
        visited: object,
        *,
        discount: float = 0.99,
        rewards: str = "expected",
        cells: VoronoiCells | None = None,
    ) -> Discretization:
        """The task on cells of ``visited`` states (m, d), or on given ``cells`` (those of another Discretization).

        Parameters
        ----------
        visited : (m, d)
            Whole states of the task, at least one in each cell. To look at a simulator in a log's places (pairing), give
            the log's states here and the cells of before.
        rewards : "expected" | "transition"
            r(s, a), or r(s, a, s'), each the mean over the moves that it belongs to.

        Raises
        ------
        ValueError
            States of another dimension, not finite, or all over; given cells that no visited state lies in.
        """
        _checks.one_of(rewards, "rewards", ("expected", "transition"))
        states = check_states(task, visited, "visited")
        if task.terminates:
            states = states[~task.terminated(states)]
        if len(states) == 0:
            raise ValueError(f"visited must have states in which {task.name} goes on; it has none")
        found = self.cells(task.features(states)) if cells is None else cells
        here = found.nearest(task.features(states))[0]
        empty = np.flatnonzero(np.bincount(here, minlength=found.n_cells) == 0)
        if empty.size:
            raise ValueError(
                f"visited must have a state in every cell; {empty.size} cells have none, the first is {empty[0]}"
            )
        n_cells, n_states, n_actions = found.n_cells, found.n_cells + task.terminates, task.n_actions
        rows, columns, paid = _moves(task, found, states, here, _checks.generator(self.seed))
        shape = (n_states * n_actions, n_states)
        if task.terminates:
            rows = np.concatenate([rows, n_cells * n_actions + np.arange(n_actions)])
            columns = np.concatenate([columns, np.full(n_actions, n_cells)])
            paid = np.concatenate([paid, np.zeros(n_actions)])
        counts = canonical(sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape), drop_zeros=False)
        total = canonical(sparse.csr_array((paid, (rows, columns)), shape=shape), drop_zeros=False)
        n = np.bincount(rows, minlength=shape[0])
        matrix = sparse.csr_array(sparse.diags_array(1.0 / n) @ counts)
        if self.floor > 0.0:
            matrix = self._with_floor(matrix, found, task.terminates)
        if rewards == "transition":
            if self.floor > 0.0:
                raise ValueError(f"floor must be 0 with rewards 'transition': its moves have none; it is {self.floor}")
            table: object = sparse.csr_array((total.data / counts.data, counts.indices, counts.indptr), shape=shape)
        else:
            table = (np.bincount(rows, paid, shape[0]) / n).reshape(n_states, n_actions)
        mdp = FiniteMDP(matrix, table, begins(task, found), discount)
        metadata = task_metadata(task) | {
            "builder": "VisitedCells",
            "n_cells": n_cells,
            "visited": len(states),
            "floor": self.floor,
            "neighbours": self.neighbours,
        }
        return Discretization(mdp, task, found, states, here, metadata, {"clipped": 0.0})

    def at(
        self, task: ContinuousTask, visited: Array, log: ContinuousTransitions, *, discount: float = 0.99
    ) -> Discretization:
        """The task on cells of ``visited`` states, looked at in the log's places (and in the cells' own centres)."""
        cells = self.cells(task.features(visited))
        return self.build(task, np.concatenate([log.state, cells.centres]), cells=cells, discount=discount)

    def _with_floor(self, matrix: sparse.csr_array, cells: VoronoiCells, terminates: bool) -> sparse.csr_array:
        """(1 - floor) P + floor P N, where N leads from a cell to its neighbours, itself and what is over."""
        many = min(self.neighbours + 1, cells.n_cells)
        near = cKDTree(cells.centres / cells.scale).query(cells.centres / cells.scale, k=many)[1].reshape(-1, many)
        n_states = matrix.shape[1]
        if terminates:
            near = np.concatenate([near, np.full((len(near), 1), cells.n_cells)], axis=1)
            near = np.concatenate([near, np.full((1, near.shape[1]), cells.n_cells)])
        data = np.full(near.size, 1.0 / near.shape[1])
        around = sparse.csr_array(
            (data, near.ravel(), np.arange(n_states + 1) * near.shape[1]), shape=(n_states, n_states)
        )
        around.sum_duplicates()
        return sparse.csr_array((1.0 - self.floor) * matrix + self.floor * (matrix @ around))


def _moves(
    task: ContinuousTask, cells: VoronoiCells, states: Array, here: IntArray, rng: np.random.Generator
) -> tuple[IntArray, IntArray, Array]:
    """Rows s*A + a, columns and rewards of one step from every state under every action."""
    rows, columns, paid = [], [], []
    for low in progress_bar("stepping", range(0, len(states), STATES_AT_A_TIME)):
        part = slice(low, low + STATES_AT_A_TIME)
        for action in range(task.n_actions):
            moved = task.step(states[part], np.full(len(states[part]), action), rng)
            to = cells.nearest(task.features(moved.next_state))[0]
            rows.append(here[part] * task.n_actions + action)
            ended = moved.terminated & task.end_shows(moved.next_state)
            columns.append(np.where(ended, cells.n_cells, to) if task.terminates else to)
            paid.append(moved.reward)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(paid)
