"""The rows that a policy takes, cut out of an Evidence: their values, visits and gradients, for several ascents at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.exact import solvers
from oee_tabular.exact.system import Kernel, System, as_readonly
from oee_tabular.inference.evidence import Evidence, reachable_rows
from oee_tabular.mdp.horizons import optional_horizon_length

N_DENSE = 128  # states up to which LAPACK takes no longer than sweeps (.1 ms)
ROUGH = 1e-3  # of what the last V and d miss in new rows: what is left of it
FINE = 1e-9  # the same, where nothing is near


class RowArrays(NamedTuple):
    """As the kernels read them (``_likelihood``); states are numbered anew."""

    indptr: IntArray
    observed: IntArray
    state: IntArray
    column: IntArray
    weight: Array
    pay: Array
    phat: Array
    n: Array
    initial: Array
    edges: Any
    columns: Any
    edge: IntArray


class Points(NamedTuple):
    """Rows p of several ascents, (k, entries), with J (k,), V and d (k, states), and the gradient of J (k, entries).

    In rows without data the gradient is r + gamma V, which does not vanish where they are never reached.
    """

    p: Array
    value: Array
    values: Array
    visits: Array
    gradient: Array


@dataclass(frozen=True, eq=False)
class PolicyRows:
    """An Evidence cut down to the rows that the policy reaches in any model on the simulator's support.

    ``entries`` are those of the evidence, the observed ones of each row first; ``n_steps`` is None without a horizon.
    """

    evidence: Evidence
    entries: IntArray
    arrays: RowArrays
    n_steps: int | None

    @classmethod
    def from_evidence(cls, evidence: Evidence) -> PolicyRows:
        """Cut and number them."""
        model = evidence.model
        rows = np.flatnonzero(reachable_rows(evidence))
        states, place = np.unique(rows // model.n_actions, return_inverse=True)
        lengths = np.diff(evidence.indptr)[rows]
        indptr = np.concatenate([[0], np.cumsum(lengths)])
        row = np.repeat(np.arange(len(rows)), lengths)
        entries = np.arange(indptr[-1]) + (evidence.indptr[rows] - indptr[:-1])[row]
        is_observed = evidence.phat[entries] > 0.0
        entries = entries[np.lexsort((~is_observed, row))]
        number = np.zeros(model.n_states, dtype=np.int64)
        number[states] = np.arange(len(states))
        state, column = place[row], number[model.transitions.indices[entries]]
        edges, edge = np.unique(state * len(states) + column, return_inverse=True)
        by_move = model.reward_data is not None
        pay = model.reward_data[entries] if by_move else model.rewards.reshape(-1)[rows][row]  # type: ignore[index]
        arrays = RowArrays(
            indptr,
            indptr[:-1] + np.bincount(row, is_observed, len(rows)).astype(np.int64),
            state,
            column,
            evidence.policy.reshape(-1)[rows][row],
            np.asarray(pay, dtype=np.float64),
            evidence.phat[entries],
            evidence.n[rows],
            model.initial[states],
            as_readonly(np.searchsorted(edges, np.arange(len(states) + 1) * len(states)).astype(np.uint32)),
            as_readonly((edges % len(states)).astype(np.uint32)),
            edge,
        )
        n_steps = optional_horizon_length(evidence.horizon, model, kept=model.n_states)
        return cls(evidence, entries, arrays, n_steps)

    @cached_property
    def has_data(self) -> BoolArray:
        """(entries,) whether the log has the row."""
        return np.repeat(self.arrays.n > 0, np.diff(self.arrays.indptr))

    @property
    def is_small(self) -> bool:
        """Whether all ascents are made at once."""
        return len(self.arrays.initial) <= N_DENSE

    def best_rows(
        self, x: Array, before: Array, step: Array, limit: float, room: float, tau: Array
    ) -> tuple[Array, Array]:
        """P(x) of each direction, and its sum n KL, the limit met to a share ``room``; ``tau`` holds guesses of multipliers.

        With a horizon, only a share ``step`` of mass that goes all to one next state moves from the rows ``before``.
        """
        from oee_tabular.inference import _likelihood as kernel

        p = before.copy()
        low, high = self.evidence.low[self.entries], self.evidence.high[self.entries]
        share = np.ones(len(x)) if self.n_steps is None else step
        return p, kernel.best_rows(self.arrays, low, high, x, share, limit, room, tau, p)

    def evaluate(self, p: Array, near: Points | None, left: float = ROUGH) -> Points:
        """J, V, d and the gradient of J at rows p.

        In large problems V and d are corrected from those of points near by, to a share ``left`` of what these miss, and J =
        mu V + d (what V misses) is then far closer.
        """
        from oee_tabular.inference import _likelihood as kernel

        rows, gamma, n = self.arrays, self.evidence.model.discount, len(self.arrays.initial)
        values, visits = np.empty((len(p), n)), np.empty((len(p), n))
        if self.n_steps is not None:
            gradient = np.empty(p.shape)
            kernel.evaluate_steps(rows, p, gamma, self.n_steps, values, visits, gradient)
            ahead, value = rows.pay + gamma * values[:, rows.column], values @ rows.initial
            starts, lengths = rows.indptr[:-1], np.diff(rows.indptr)
            flat = np.maximum.reduceat(gradient, starts, axis=1) == np.minimum.reduceat(gradient, starts, axis=1)
            unknown = np.repeat(flat & (rows.n == 0), lengths, axis=1)
            return Points(p, value, values, visits, np.where(unknown, ahead, gradient))
        taken = rows.weight * p
        if self.is_small:
            value = self._solve_dense(taken, values, visits)
        else:
            value = self._solve_sparse(taken, near, left, values, visits)
        ahead = rows.pay + gamma * values[:, rows.column]
        mean = np.add.reduceat(rows.phat * ahead, rows.indptr[:-1], axis=1)
        ahead -= np.repeat(mean, np.diff(rows.indptr), axis=1)  # a constant in a row counts for nothing
        weight = np.where(self.has_data, np.maximum(visits, 0.0)[:, rows.state] * rows.weight, 1.0)
        return Points(p, value, values, visits, weight * ahead)

    def _solve_dense(self, taken: Array, values: Array, visits: Array) -> Array:
        """By LAPACK."""
        rows, (k, n) = self.arrays, values.shape
        lane = np.arange(k)[:, None]
        place = lane * n * n + rows.state * n + rows.column
        matrix = np.eye(n) - self.evidence.model.discount * np.bincount(
            place.ravel(), taken.ravel(), k * n * n
        ).reshape(k, n, n)
        paid = np.bincount((lane * n + rows.state).ravel(), (taken * rows.pay).ravel(), k * n).reshape(k, n)
        values[:] = np.linalg.solve(matrix, paid[:, :, None])[:, :, 0]
        visits[:] = np.linalg.solve(matrix.transpose(0, 2, 1), np.broadcast_to(rows.initial[:, None], (k, n, 1)))[
            :, :, 0
        ]
        return np.asarray(values @ rows.initial)

    def _solve_sparse(self, taken: Array, near: Points | None, left: float, values: Array, visits: Array) -> Array:
        """By the solvers of ``exact``, one ascent after the other."""
        rows, gamma, (k, n) = self.arrays, self.evidence.model.discount, values.shape
        value = np.empty(k)
        for i in range(k):
            share = np.bincount(rows.edge, taken[i], len(rows.columns))
            system = Kernel(rows.edges, rows.columns, as_readonly(share), gamma)
            before = np.zeros(n) if near is None else near.values[i]
            last = np.full(n, 1.0 / ((1.0 - gamma) * n)) if near is None else near.visits[i]
            paid: Array = np.asarray(np.bincount(rows.state, taken[i] * rows.pay, n), dtype=np.float64)
            found = solvers.answer(System(system), paid, before, left)
            values[i] = found.x
            value[i] = rows.initial @ found.x + last @ found.missed
            visits[i] = solvers.answer(System(system, True), rows.initial, last, left).x
        return value
