"""Reacher as finite MDPs from a log: cells where the log went, and the simulator under several lengths looked at in them.

Four coordinates at 0.0165 s a step are hard to discretise: a step is a small part of a cell, and what is lost is *where in its
cell* a state lies. Two choices keep the loss small. The cells, and the points that stand for them, are the log's own states
(and some of the simulators'), so that each is averaged as the target visits it. And the reward telescopes on cells as it
does in the task,

    r(s, a, s') = 100 (D(s) - D(s')) - 0.01 (|a0| W1(s') + |a1| W2(s')) - 0.01 (|a0| + |a1|) - 0.1 B(s'),

with D, W and B the cell means of the distance, the speeds and of being at the stop: taken move by move, its mean error adds up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._sparse import canonical, row_of_entry, row_sums
from oee_tabular._threads import one_thread
from oee_tabular.continuous.cells import VisitedCells, visited_states
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import record, resimulate
from oee_tabular.continuous.grid import Places, VoronoiCells, begins
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.reacher.dynamics import Reacher, at_stop
from oee_tabular.continuous.reacher.expert import reacher_policy
from oee_tabular.continuous.support import supported
from oee_tabular.continuous.task import task_metadata
from oee_tabular.mdp import FiniteMDP

LENGTHS = (0.05, 0.07, 0.1, 0.14, 0.2)  # m, of the averaged simulator
VISITING = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)  # deltas of the policies that visit states in the simulators


@dataclass(frozen=True, eq=False, repr=False)
class ArmCells(Places):
    """Numbered states of the arm, with its moves under several lengths and those of a log: builds a ``Discretization``.

    Attributes
    ----------
    task : Reacher, whose reward is paid
    cells : where the states lie
    points, point_cell : (m, 4) states of the arm that stand for the cells, and (m,) the cell of each
    transitions : length -> csr (S*A, S), the simulator with links of that length
    counts : csr (S*A, S), the log's moves
    initial, discount : (S,) where episodes begin, and gamma: those of every ``mdp``

    Examples
    --------
    >>> log = reacher_log(Reacher.tamed(), 500, max_steps=25, seed=0)
    >>> numbers = {"n_cells": 50, "n_simulated": 200, "n_stepped": 200, "horizon": 25}
    >>> arm = arm_cells(log, task=Reacher.tamed(), lengths=(0.1, 0.2), **numbers)
    >>> simulator = arm.mdp(arm.mixture())
    >>> simulator.n_states == arm.cells.n_cells, list(arm.transitions), int(arm.counts.sum())
    (True, [0.1, 0.2], 500)
    >>> arm.policy(reacher_policy(0.3)).shape == (simulator.n_states, 9)
    True
    """

    task: Reacher
    cells: VoronoiCells
    points: Array
    point_cell: IntArray
    transitions: Mapping[float, sparse.csr_array]
    counts: sparse.csr_array
    initial: Array
    discount: float = 0.99

    def __repr__(self) -> str:
        lengths = ", ".join(f"{length:g}" for length in self.transitions)
        return f"ArmCells({self.cells.extent()}; lengths {lengths} m; {self.counts.sum():.0f} moves logged)"

    def mdp(self, transitions: sparse.csr_array) -> FiniteMDP:
        """The FiniteMDP of these transitions, with the reward that telescopes on cells (see above)."""
        matrix = canonical(sparse.csr_array(transitions), drop_zeros=True)
        state, action = np.divmod(row_of_entry(matrix), self.task.n_actions)
        to, size = matrix.indices, np.abs(self.task.actions)
        away = self.mean(self.task.distance(self.points))
        speed = np.stack([self.mean(np.abs(self.points[:, k])) for k in (2, 3)], axis=1)
        paid = 100.0 * (away[state] - away[to]) - 0.01 * (size[action] * (1.0 + speed[to])).sum(axis=1)
        paid -= 0.1 * self.mean(at_stop(self.points))[to]
        rewards = sparse.csr_array((paid, matrix.indices, matrix.indptr), shape=matrix.shape)
        return FiniteMDP(matrix, rewards, self.initial, self.discount)

    def build(self, transitions: sparse.csr_array, **facts: object) -> Discretization:
        """The Discretization of these transitions; ``facts`` go into its metadata."""
        made = task_metadata(self.task) | {"builder": "arm_cells", "n_cells": self.cells.n_cells} | facts
        return Discretization(self.mdp(transitions), self.task, self.cells, self.points, self.point_cell, made, {})

    def paying(self, task: Reacher) -> ArmCells:
        """The same cells and moves with the reward of another ``task``."""
        return replace(self, task=task)

    def among(self, lengths: Sequence[float]) -> ArmCells:
        """The same cells with the simulators of these lengths alone, and of the log's moves those that one of them allows.

        ``uncovered`` of the whole, for the new ``mixture()``, is the share of the moves that is left out.

        Raises
        ------
        ValueError
            A length without a simulator here; no length.
        """
        unknown = [length for length in lengths if length not in self.transitions]
        if unknown or not lengths:
            raise ValueError(f"lengths must be among {', '.join(map(str, self.transitions))}; got {list(lengths)}")
        part = replace(self, transitions={length: self.transitions[length] for length in lengths})
        return replace(part, counts=supported(self.counts, part.mixture())[0])

    def mixture(self, weights: Sequence[float] | None = None) -> sparse.csr_array:
        """sum_k w_k P_k over the lengths, in their order; by default all alike: the averaged-length simulator.

        Raises
        ------
        ValueError
            As many weights as lengths, nonnegative, summing to 1, are needed.
        """
        every = list(self.transitions.values())
        shares = np.full(len(every), 1.0 / len(every)) if weights is None else _checks.float_array(weights, "weights")
        if shares.shape != (len(every),):
            raise ValueError(
                f"weights must have one number for each of {len(every)} lengths; it has shape {shares.shape}"
            )
        _checks.require_nonnegative(shares, "weights")
        if abs(shares.sum() - 1.0) > 1e-8:
            raise ValueError(f"weights must sum to 1 (tolerance 1e-8); they sum to {shares.sum():.6g}")
        return sparse.csr_array(sum(w * matrix for w, matrix in zip(shares, every, strict=True)))

    @one_thread
    def risk_minimising_weights(self, *, iterations: int = 300) -> Array:
        """(lengths,) weights w that minimise the KL risk -sum_x n_x log sum_k w_k P_k(x): zeta within the hull of the lengths.

        Convex in w; EM's iteration decreases it in each step. Where the arm's own length is among them and the log is
        long, it is found: this is system identification, stated as a ratio.

        Raises
        ------
        ValueError
            A logged move that no length allows.
        """
        found = self.counts.tocoo()
        rows, columns = found.coords
        table = np.stack([np.asarray(m[rows, columns]).ravel() for m in self.transitions.values()], axis=1)
        impossible = np.flatnonzero(table.sum(axis=1) == 0.0)
        if impossible.size:
            s, a = divmod(int(rows[impossible[0]]), self.task.n_actions)
            raise ValueError(
                f"log must have moves that some length allows; ({s}, {a}, {columns[impossible[0]]}) is allowed by none "
                f"({impossible.size} such moves in all)"
            )
        weights = np.full(table.shape[1], 1.0 / table.shape[1])
        for _ in range(iterations):
            share = table * weights
            share /= share.sum(axis=1, keepdims=True)
            weights = found.data @ share / found.data.sum()
        return np.asarray(weights)

    def uncovered(self, transitions: sparse.csr_array) -> float:
        """The share of the log's moves to which ``transitions`` gives probability 0."""
        return supported(self.counts, transitions)[1]


def arm_cells(
    log: ContinuousTransitions,
    *,
    task: Reacher | None = None,
    lengths: Sequence[float] = LENGTHS,
    n_cells: int = 3000,
    n_simulated: int = 30_000,
    n_stepped: int = 60_000,
    horizon: int = 100,
    seed: Any = 0,
) -> ArmCells:
    """Cells around the log's states and some of the simulators', and the moves of every length on them.

    Parameters
    ----------
    log : ContinuousTransitions of the target, with ``timestep`` if its episodes are longer than ``horizon``
    task : Reacher whose reward is paid, and whose other parameters the simulators share (default: the paper's)
    lengths : of the simulator, m; the log's places are stepped under each, so that a target with one of them is covered
    n_cells : at most so many
    n_simulated : states that the simulators visit by themselves, for what the log leaves out
    n_stepped : of all these states, how many are stepped under all nine actions; the log's under the logged one as well
    horizon : states of the log later than this do not shape the cells
    seed : of the choice of states

    Raises
    ------
    ValueError
        A log that is not Reacher's; no length; numbers that are not positive integers.

    Notes
    -----
    len(lengths) * (9 n_stepped + n) nearest-cell searches: some 10 s by default, for n = 150 000.

    Examples
    --------
    >>> from oee_tabular.tasks import record
    >>> log = record(Reacher.tamed(0.2), reacher_policy(0.5), n_transitions=2000, max_steps=25, seed=0)
    >>> arm = arm_cells(log, task=Reacher.tamed(), n_cells=100, n_simulated=500, n_stepped=1000, horizon=25)
    >>> arm.uncovered(arm.mixture())
    0.0
    >>> arm.risk_minimising_weights().round(2).tolist()
    [0.0, 0.0, 0.0, 0.0, 1.0]
    """
    _checks.instance(log, ContinuousTransitions, "log")
    numbers = {"n_cells": n_cells, "n_simulated": n_simulated, "n_stepped": n_stepped, "horizon": horizon}
    for name, value in numbers.items():
        _checks.positive_integer(value, name)
    base = Reacher() if task is None else task
    if log.n_state != base.n_state:
        raise ValueError(f"log.state must have the 4 coordinates {', '.join(base.state_names)}; it has {log.n_state}")
    if not lengths:
        raise ValueError("lengths must have one length or more; it is empty")
    arms = [replace(base, length=float(length), reward_length=base.reward_length) for length in lengths]
    rng = _checks.generator(seed)
    policies = [reacher_policy(delta) for delta in VISITING]
    simulated = visited_states(arms, policies, n_simulated, max_steps=horizon, seed=rng)
    own = log.state if log.timestep is None else log.state[log.timestep < horizon]
    points = np.concatenate([own, simulated])
    builder = VisitedCells(n_cells, lloyd=3, seed=rng)
    cells = builder.cells(base.features(points))
    point_cell = cells.nearest(base.features(points))[0]
    one_each = np.unique(point_cell, return_index=True)[1]
    stepped = np.concatenate([one_each, rng.permutation(len(points))[: max(0, n_stepped - len(one_each))]])
    here, places = point_cell[stepped], points[stepped]
    actions = log.action_numbers(base.actions)
    logged_rows = cells.nearest(base.features(log.state))[0] * base.n_actions + actions
    shape = (cells.n_cells * base.n_actions, cells.n_cells)
    transitions = {}
    for arm in arms:
        moved = [arm.advance(places, np.broadcast_to(command, (len(places), 2))) for command in base.actions]
        rows = np.concatenate([here * base.n_actions + a for a in range(base.n_actions)] + [logged_rows])
        following = np.concatenate([*moved, resimulate(arm, log).next_state])
        counts = _count(rows, cells.nearest(base.features(following))[0], shape)
        transitions[arm.length] = sparse.csr_array(sparse.diags_array(1.0 / row_sums(counts)) @ counts)
    counts = _count(logged_rows, cells.nearest(base.features(log.next_state))[0], shape)
    return ArmCells(base, cells, points, point_cell, transitions, counts, begins(base, cells))


def _count(rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> sparse.csr_array:
    return canonical(sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape), drop_zeros=False)


def reacher_log(task: Reacher, n: int, *, max_steps: int = 150, seed: Any = None) -> ContinuousTransitions:
    """The paper's data: n moves by pi_delta, delta = 0, .1, ..., 1 in equal parts, episodes of ``max_steps``.

    Parameters
    ----------
    task : Reacher, the target's arm
    n : moves in all
    max_steps : moves of an episode
    seed : the same seed gives the same bits

    Raises
    ------
    ValueError
        ``n`` or ``max_steps`` not a positive integer.

    Examples
    --------
    >>> len(reacher_log(Reacher(), 1000, max_steps=25, seed=0))
    1000
    """
    size = _checks.positive_integer(n, "n")
    parts = [
        record(task, reacher_policy(k / 10), n_transitions=-(-size // 11), max_steps=max_steps, seed=stream)
        for k, stream in enumerate(_checks.generator(seed).spawn(11))
    ]
    return ContinuousTransitions.concatenate(parts).first(size)
