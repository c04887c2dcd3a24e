"""A continuous task as a FiniteMDP, and the way from continuous states and logs to its numbered states.

Two builders make a ``Discretization``: ``GridInterpolation`` (states are the vertices of a grid; a point between them is
shared out by multilinear weights) and ``VisitedCells`` (states are the cells around chosen centres). Where episodes can end,
one absorbing state that pays nothing, the last, stands for all that is over.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, Seed
from oee_tabular._sparse import canonical
from oee_tabular.continuous import discretization_files
from oee_tabular.continuous.closure import Closure, measure
from oee_tabular.continuous.grid import Cells, Places
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy, check_states
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP

OUTSIDE = ("error", "nearest", "drop")


@dataclass(frozen=True, eq=False, repr=False)
class Discretization(Places):
    """A FiniteMDP made from a continuous task, with the encoding that belongs to it.

    Attributes
    ----------
    mdp : FiniteMDP with one state for each cell, and last, where episodes can end, the one that is over
    task : ContinuousTask
    cells : where the states lie
    points : (m, d) states of the task that stand for the cells
    point_cell : (m,) the cell that each point belongs to: a policy in a cell is its mean over the cell's points
    metadata : how it was made: plain numbers and words
    diagnostics : ``clipped`` (share of the simulator's steps that left the grid and were put on its face), ``step_in_cells``
        (median length of a step in spacings, for each feature), ``closure`` (Closure, where it was measured)

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, GridInterpolation, cartpole_policy, record
    >>> model = GridInterpolation((32, 32), closure_episodes=0).build(CartPole(10.0))
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=500, max_steps=100, seed=0)
    >>> encoded = model.encode_log(log, seed=0)
    >>> len(encoded), model.policy(cartpole_policy(0.3)).shape, round(float(model.counts(log).sum()), 6)
    (500, (1025, 2), 500.0)
    """

    mdp: FiniteMDP
    task: ContinuousTask
    cells: Cells
    points: Array
    point_cell: IntArray
    metadata: dict[str, Any] = field(default_factory=dict)
    diagnostics: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        settings = ", ".join(f"{name}={value}" for name, value in self.task.parameters().items())
        return f"Discretization({self.task.name}({settings}): {self.cells.extent()}; {self.mdp})"

    def encode(self, states: object, *, seed: Any = None, outside: str = "error") -> IntArray:
        """(n,) the number of each state.

        Parameters
        ----------
        states : (n, d) finite numbers
        seed : without one, the state with the largest weight; with one, drawn by the weights (so that the mean over draws
            is the interpolation)
        outside : "error" | "nearest"
            What to do with states outside the grid: name and count them, or take the nearest face with a warning.
        """
        _checks.one_of(outside, "outside", OUTSIDE[:2])
        array = check_states(self.task, states)
        over = np.zeros(len(array), dtype=np.bool_)
        if self.over is not None:
            over = self.task.terminated(array) & self.task.end_shows(array)
        self._outside(array, ~over, "states", outside)
        return self._numbers(array, over, None if seed is None else _checks.generator(seed))

    def encode_log(
        self, log: ContinuousTransitions, *, seed: Any = None, outside: str = "error", strict: bool = False
    ) -> Transitions:
        """The log with numbered states and actions, ready for ``Problem``.

        Parameters
        ----------
        seed : as in ``encode``; each state that episodes pass through is drawn once
        outside : "error" | "nearest" | "drop"
            Rows with a state outside the grid: an error that names and counts them, the nearest face, or left out (the rest
            is then a bag without episodes); both of the latter with a warning.
        strict : an error, not a warning, for actions that are not in the task's set

        Raises
        ------
        ValueError
            A log with other dimensions than the task; actions or states that the task does not know.
        """
        _checks.boolean(strict, "strict")
        kept, actions, ended = self._checked(log, outside, strict)
        rng = None if seed is None else _checks.generator(seed)
        draws = None if rng is None else rng.random((len(kept), 2))
        if draws is not None and kept.episode is not None:  # the next row's state is this row's next state
            same = kept.episode[1:] == kept.episode[:-1]
            draws[:-1, 1] = np.where(same, draws[1:, 0], draws[:-1, 1])
        none = np.zeros(len(kept), dtype=np.bool_)
        first = self._numbers(kept.state, none, None if draws is None else draws[:, 0])
        following = self._numbers(kept.next_state, ended, None if draws is None else draws[:, 1])
        columns = kept.columns() | {"state": first, "action": actions, "next_state": following}
        if kept.episode is not None:
            follows = np.flatnonzero(kept.episode[1:] == kept.episode[:-1])
            first[follows + 1] = following[follows]  # float32 copies of one state may lie on two sides of an edge
        columns["terminated"] = ended
        columns["truncated"] = kept.truncated & ~ended | (kept.terminated & ~ended)
        return Transitions(**columns)

    def counts(self, log: ContinuousTransitions, *, outside: str = "error", strict: bool = False) -> sparse.csr_array:
        """Soft counts n(s, a, s') = sum over rows of w_s(state) w_s'(next_state): csr of shape (S*A, S).

        The mean of ``encode_log(...).counts(...)`` over draws, without their noise. Arguments and errors as there.
        """
        _checks.boolean(strict, "strict")
        kept, actions, ended = self._checked(log, outside, strict)
        n, n_states, n_actions = len(kept), self.mdp.n_states, self.task.n_actions
        start = sparse.csr_array(self._weights(kept.state, np.zeros(n, dtype=np.bool_)))
        arrival = sparse.csr_array(self._weights(kept.next_state, ended))
        rows = start.indices.astype(np.int64) * n_actions + np.repeat(actions, np.diff(start.indptr))
        spread = sparse.csr_array((start.data, rows, start.indptr), shape=(n, n_states * n_actions))
        return canonical(sparse.csr_array(spread.T @ arrival), drop_zeros=True)

    def closure(
        self,
        policy: StatePolicy | None = None,
        *,
        horizon: int = 100,
        n_episodes: int = 2000,
        discount: float | None = None,
        seed: Seed = 0,
    ) -> Closure:
        """The error that discretising makes in the value of ``policy`` (default: uniform), measured by Monte Carlo."""
        return measure(self, self.mdp, policy, horizon=horizon, n_episodes=n_episodes, discount=discount, seed=seed)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an npz: the rows of the MDP, the cells, and the metadata as JSON."""
        discretization_files.save(self, self.mdp, self.metadata, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str], task: ContinuousTask) -> Self:
        """Read what ``save`` wrote; ``task`` must be the one that it was made from (name, parameters, features)."""
        return discretization_files.load(cls, path, task)

    def _weights(self, states: Array, ended: BoolArray) -> sparse.csr_array:
        """(n, S); rows that ended lie in the absorbing state."""
        inner = self.cells.weights(self.task.features(states))
        if self.over is None:
            return inner
        stay = sparse.diags_array(np.where(ended, 0.0, 1.0))
        inner = sparse.csr_array(stay @ inner)
        inner.eliminate_zeros()
        return sparse.csr_array(sparse.hstack([inner, sparse.csr_array(ended[:, None].astype(np.float64))]))

    def _numbers(self, states: Array, ended: BoolArray, draws: Any) -> IntArray:
        """One state number a row: the heaviest, or the one that a uniform number (n,) or a generator picks."""
        weights = self.cells.weights(self.task.features(states))
        low, width = weights.indptr[:-1], np.diff(weights.indptr)
        table = np.zeros((len(states), int(width.max())))
        inside = np.arange(table.shape[1]) < width[:, None]
        table[inside] = weights.data
        if draws is None:
            pick = table.argmax(axis=1)
        else:
            u = draws.random(len(states)) if isinstance(draws, np.random.Generator) else draws
            running = np.cumsum(table, axis=1)
            pick = np.minimum((running <= (u * running[:, -1])[:, None]).sum(axis=1), width - 1)
        numbers = weights.indices[low + pick].astype(np.int64)
        return np.asarray(numbers if self.over is None else np.where(ended, self.over, numbers))

    def _checked(
        self, log: ContinuousTransitions, outside: str, strict: bool
    ) -> tuple[ContinuousTransitions, IntArray, BoolArray]:
        """The rows that can be encoded, their action numbers, and which end in the absorbing state."""
        require_log_of(self.task, log)
        _checks.one_of(outside, "outside", OUTSIDE)
        actions = log.action_numbers(self.task.actions, strict=strict)
        ended = np.array(log.terminated)
        if self.over is None and ended.any():
            row = int(np.flatnonzero(ended)[0])
            raise ValueError(
                f"log.terminated[{row}] must be False: episodes of {self.task.name} do not end; it is True"
            )
        if self.over is not None:
            before = np.flatnonzero(self.task.terminated(log.state))
            if before.size:
                raise ValueError(
                    f"log.state[{before[0]}] must be a state in which {self.task.name} goes on; it is over in "
                    f"{log.state[before[0]].tolist()} ({before.size} such rows in all)"
                )
            ended |= self.task.terminated(log.next_state)
            ended = self._shown(log, ended)
        gone = self._outside(log.state, np.ones(len(log), dtype=np.bool_), "log.state", outside)
        gone |= self._outside(log.next_state, ~ended, "log.next_state", outside)
        if outside == "drop" and gone.any():
            if gone.all():
                raise ValueError("outside must not be 'drop' where every row is outside; nothing would be left")
            return log.select(~gone), actions[~gone], ended[~gone]
        return log, actions, ended

    def _shown(self, log: ContinuousTransitions, ended: BoolArray) -> BoolArray:
        """Without the ends that the features do not tell, which are warned about."""
        hidden = np.flatnonzero(ended & ~self.task.end_shows(log.next_state))
        if hidden.size:
            warnings.warn(
                f"log.terminated: {hidden.size} of {int(ended.sum())} ends do not show in the features "
                f"({', '.join(self.task.feature_names)}); the first, row {hidden[0]}, leads to "
                f"{log.next_state[hidden[0]].tolist()}. They are taken as truncated, the process going on",
                stacklevel=5,
            )
            ended[hidden] = False
        return ended

    def _outside(self, states: Array, asked: BoolArray, name: str, outside: str) -> BoolArray:
        gone = np.asarray(self.cells.outside(self.task.features(states)) & asked)
        rows = np.flatnonzero(gone)
        if rows.size:
            at = self.task.features(states[rows[:1]])[0]
            place = ", ".join(f"{k}={v:.4g}" for k, v in zip(self.task.feature_names, at, strict=True))
            found = f"{rows.size} of {len(states)} rows are not; the first, row {rows[0]}, is at {place}"
            text = f"{name} must be inside {self.cells.extent()}: {found}"
            if outside == "error":
                raise ValueError(
                    f"{text}. A wider grid, or outside='nearest' or 'drop' (--task-option outside=), takes them"
                )
            done = "left out" if outside == "drop" else "moved to the nearest place inside"
            warnings.warn(f"{text}. They are {done}", stacklevel=5)
        return gone


def require_log_of(task: ContinuousTask, log: ContinuousTransitions) -> None:
    """ValueError for a log of other states than the task's."""
    _checks.instance(log, ContinuousTransitions, "log")
    if log.n_state != task.n_state:
        raise ValueError(
            f"log.state must have the {task.n_state} coordinates of {task.name} ({', '.join(task.state_names)}); "
            f"it has {log.n_state}"
            + "; speeds that were not recorded can be had from positions, by finite differences or by a Kalman filter"
            * (log.n_state < task.n_state)
        )
