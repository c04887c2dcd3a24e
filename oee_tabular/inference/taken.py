"""The rows that a policy takes, cut out of an Evidence: their values, occupancy and gradient, from those of rows near by.

Without a horizon V and d are those of the last rows, corrected by some steps of a solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.exact import solvers
from oee_tabular.exact.system import Kernel, System, as_readonly
from oee_tabular.inference.evidence import Evidence, reached_rows
from oee_tabular.mdp.horizons import optional_horizon_length

DENSE = 128  # states up to which LAPACK takes no longer than sweeps (.1 ms), and needs no compiling
LEFT = 1e-3  # of what the last V and d miss in new rows: what is left of it
FINE = 1e-9  # the same, where nothing is near


class Chain(NamedTuple):
    """The rows that the policy takes, as the kernels read them; states are numbered anew."""

    first: IntArray
    indptr: IntArray
    seen: IntArray
    column: IntArray
    weight: Array
    pay: Array
    phat: Array
    n: Array
    initial: Array


class Graph(NamedTuple):
    """Which state may follow which, CSR; entry i of the chain is edge edge[i]."""

    indptr: IntArray
    column: IntArray
    edge: IntArray


class Point(NamedTuple):
    """Rows of the set, their J and V, and d (with a horizon: the gradient); their P_pi, where solvers iterate."""

    p: Array
    value: float
    values: Array
    visits: Array
    gradient: Array
    kernel: Kernel | None


class Direction(NamedTuple):
    """What rows are chosen by: the gradient of J, and r + gamma V in rows without data, which does not vanish unreached.

    (With a horizon the latter only where the gradient does vanish: there the order changes in time.)
    """

    gradient: Array
    order: Array


@dataclass(frozen=True, eq=False)
class Taken:
    """An Evidence cut down to the rows that the policy reaches and takes."""

    evidence: Evidence
    entries: IntArray
    chain: Chain
    steps: int | None

    @classmethod
    def of(cls, evidence: Evidence) -> Taken:
        """The rows that count in any model on the simulator's support."""
        model = evidence.model
        rows = np.flatnonzero(reached_rows(evidence))
        states, first = np.unique(rows // model.n_actions, return_index=True)
        lengths = np.diff(evidence.indptr)[rows]
        indptr = np.concatenate([[0], np.cumsum(lengths)])
        entries = np.arange(indptr[-1]) + np.repeat(evidence.indptr[rows] - indptr[:-1], lengths)
        row, held = np.repeat(np.arange(len(rows)), lengths), evidence.phat[entries] > 0.0
        entries = entries[np.lexsort((~held, row))]
        number = np.zeros(model.n_states, dtype=np.int64)
        number[states] = np.arange(len(states))
        pay = (
            model.rewards.reshape(-1)[np.repeat(rows, lengths)]
            if model.reward_data is None
            else model.reward_data[entries]
        )
        chain = Chain(
            np.append(first, len(rows)),
            indptr,
            indptr[:-1] + np.bincount(row, held, len(rows)).astype(np.int64),
            number[model.transitions.indices[entries]],
            evidence.policy.reshape(-1)[rows],
            np.asarray(pay, dtype=np.float64),
            evidence.phat[entries],
            evidence.n[rows],
            model.initial[states],
        )
        return cls(evidence, entries, chain, optional_horizon_length(evidence.horizon, model, kept=model.n_states))

    @property
    def discount(self) -> float:
        """gamma."""
        return self.evidence.model.discount

    @cached_property
    def loose(self) -> tuple[IntArray, Array]:
        """Entries of rows with several next states in the data, and how far the rows follow a direction there."""
        spread = np.repeat(np.maximum(self.chain.n, 1.0), np.diff(self.chain.indptr))
        found = np.flatnonzero((self.chain.phat > 0.0) & (self.chain.phat < 1.0))
        return found, np.sqrt(self.chain.phat[found] / spread[found])

    def weighed(self, change: Array) -> Array:
        """A change of a direction by how far the rows follow it; others have none."""
        found, follow = self.loose
        return np.asarray(follow * change[found])

    @cached_property
    def seen(self) -> BoolArray:
        """(entries,) those of rows with data."""
        return np.repeat(self.chain.n > 0, np.diff(self.chain.indptr))

    @cached_property
    def blank(self) -> IntArray:
        """The rows without data."""
        return np.flatnonzero(self.chain.n == 0)

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """(entries,) the least and the largest probabilities."""
        return self.evidence.low[self.entries], self.evidence.high[self.entries]

    def _kernel(self, p: Array) -> tuple[Kernel, Array]:
        """P_pi and r_pi."""
        from oee_tabular.inference import _profile as kernel

        indptr, columns, shares, paid = kernel.kernel_of(self.chain, p)
        return Kernel(as_readonly(indptr), as_readonly(columns), as_readonly(shares), self.discount), paid

    def _dense(self, p: Array, transpose: bool) -> Array:
        """V, or transposed d, by LAPACK."""
        chain, n = self.chain, len(self.chain.initial)
        taken = self.weight * p
        matrix = np.eye(n) - self.discount * np.bincount(self.places, taken, n * n).reshape(n, n)
        if transpose:
            return np.asarray(np.linalg.solve(matrix.T, chain.initial))
        return np.asarray(np.linalg.solve(matrix, np.bincount(self.places // n, taken * chain.pay, n)))

    @cached_property
    def weight(self) -> Array:
        """(entries,) pi(a | s)."""
        return np.repeat(self.chain.weight, np.diff(self.chain.indptr))

    @cached_property
    def graph(self) -> Graph:
        """Of the states that are reached."""
        n = len(self.chain.initial)
        places, edge = np.unique(self.places, return_inverse=True)
        return Graph(np.searchsorted(places, np.arange(n + 1) * n), places % n, edge)

    @cached_property
    def places(self) -> IntArray:
        """(entries,) in an (S, S) matrix of the states that are reached."""
        n = len(self.chain.initial)
        state = np.repeat(np.arange(n), np.diff(self.chain.first))
        return np.repeat(state, np.diff(self.chain.indptr)) * n + self.chain.column

    def valued(self, p: Array, near: Point | None, left: float = LEFT) -> Point:
        """J, and V from that of a point near by; without a horizon d is left to ``direction``.

        V is solved for only as far as its gradient needs; J = mu V + d (what V misses) is then far closer, for a d near by.
        """
        from oee_tabular.inference import _profile as kernel

        chain, gamma, n = self.chain, self.discount, len(self.chain.initial)
        if self.steps is not None:
            graph, state, share = self.graph, self.places // n, self.weight * p
            to_go, visits, worth = np.empty((self.steps + 1, n)), np.empty(n), np.empty(len(graph.column))
            edges = np.bincount(graph.edge, share, len(worth))
            kernel.flows(
                graph, edges, np.bincount(state, share * chain.pay, n), chain.initial, gamma, to_go, visits, worth
            )
            gradient = self.weight * (visits[state] * chain.pay + worth[graph.edge])
            return Point(p, float(chain.initial @ to_go[0]), to_go[0].copy(), np.zeros(0), gradient, None)
        before, visits = (np.zeros(n), np.full(n, 1.0 / ((1.0 - gamma) * n))) if near is None else near[2:4]
        if n <= DENSE:
            values = self._dense(p, False)
            return Point(p, float(chain.initial @ values), values, visits, np.zeros(0), None)
        rows, paid = self._kernel(p)
        found = solvers.answer(System(rows), paid, before, left)
        value = float(chain.initial @ found.x + visits @ found.missed)
        return Point(p, value, found.x, visits, np.zeros(0), rows)

    def direction(self, point: Point, sign: float, left: float = LEFT) -> tuple[Point, Direction]:
        """Where J rises (sign 1) or falls (-1) at the point, which is returned with its d."""
        chain, gamma = self.chain, self.discount
        ahead = chain.pay + gamma * point.values[chain.column]
        starts, lengths = chain.indptr[:-1], np.diff(chain.indptr)
        if self.steps is not None:
            flat = np.maximum.reduceat(point.gradient, starts) == np.minimum.reduceat(point.gradient, starts)
            order = np.where(np.repeat(flat, lengths), ahead, point.gradient)
            return point, Direction(sign * point.gradient, sign * order)
        if point.kernel is None:
            visits = self._dense(point.p, True)
        else:
            visits = solvers.answer(System(point.kernel, True), chain.initial, point.visits, left).x
        ahead -= np.repeat(
            np.add.reduceat(chain.phat * ahead, starts), lengths
        )  # a constant in a row counts for nothing
        weight = np.repeat(np.maximum(visits, 0.0), np.diff(chain.first)) * chain.weight
        gradient = np.repeat(weight, lengths) * ahead
        return point._replace(visits=visits), Direction(sign * gradient, sign * ahead)
