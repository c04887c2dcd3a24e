"""Intervals with guaranteed coverage: the extreme values of a policy over rectangular sets of models.

Each row of the target is in a KL ball around its frequencies, sum phat log(phat / P) <= epsilon, and in the prior box; all
rows at once with the confidence asked for (a union over the rows). The extreme value is found by robust policy evaluation [1]:
the worst rows for V, then V for these rows, until the Bellman residual is rounding; the row problems are solved with an upper
bound each, and what is left of the residual widens the interval.

Sources: [1] G. Iyengar, Robust dynamic programming, Mathematics of Operations Research 30, 2005. [2] A. Nilim and L. El Ghaoui,
Robust control of Markov decision processes, Operations Research 53, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import row_of_entry
from oee_tabular._threads import dot
from oee_tabular.exact import evaluate_policy, state_values
from oee_tabular.inference.ambiguity import Evidence, anytime_radius, independent_radius, l1_radius, reached_rows
from oee_tabular.mdp.naming import names_of


@dataclass(frozen=True, eq=False)
class Extreme:
    """The largest value (``sign`` 1) or the smallest (-1), a bound beyond it, and the model that has it.

    ``contradicted`` are rows whose counts no distribution in the box can explain.
    """

    value: float
    bound: float
    rows: Array
    sweeps: int
    residual: float
    contradicted: IntArray


def radii(evidence: Evidence, confidence: float, kind: str, ball: str) -> Array:
    """(S*A,) radius of each row, the failure probability shared evenly by the rows that are reached and open."""
    k = np.diff(evidence.indptr)
    counted = int((evidence.open_rows & reached_rows(evidence)).sum())
    level = (1.0 - confidence) / max(counted, 1)
    if ball == "l1":
        return l1_radius(evidence.n, k, level)
    return (independent_radius if kind == "independent" else anytime_radius)(evidence.n, k, level)


def extreme_value(evidence: Evidence, radius: Array, sign: float, *, ball: str = "kl", most: int = 100) -> Extreme:
    """The extreme of J over the rectangular set, certified."""
    model, horizon = evidence.model, evidence.horizon
    solver = _Rows(evidence, radius, sign, ball)
    paid = 0.0 if model.reward_data is None else model.reward_data
    base = np.zeros(model.n_states * model.n_actions) if model.reward_data is not None else model.rewards.reshape(-1)
    gamma, columns = model.discount, model.transitions.indices
    if horizon is not None:
        values = np.zeros(model.n_states)
        for _ in range(horizon):
            best = base + solver.above(paid + gamma * values[columns])
            if solver.bad.any():
                return _refused(solver)
            values = (evidence.policy * best.reshape(evidence.policy.shape)).sum(axis=1)
        value = dot(model.initial, values)
        return Extreme(value, value, solver.p, horizon, 0.0, np.zeros(0, dtype=np.int64))
    values = state_values(evidence.with_rows(evidence.phat), evidence.policy)
    residual, rise, sweeps, stalled = np.inf, 0.0, 0, 0
    while sweeps < most:
        sweeps += 1
        best = base + solver.above(paid + gamma * values[columns])
        if solver.bad.any():
            return _refused(solver)
        backed = (evidence.policy * best.reshape(evidence.policy.shape)).sum(axis=1)
        rise = max(float((sign * (backed - values)).max()), 0.0)
        last, residual = residual, float(np.abs(backed - values).max())
        scale = 1e-12 * max(1.0, float(np.abs(values).max()))
        stalled = stalled + 1 if residual >= 0.5 * last else 0
        if residual <= scale or stalled >= 8:
            break
        found = evaluate_policy(evidence.with_rows(solver.p), evidence.policy)
        values = found.values
    value = dot(model.initial, values)
    beyond = rise / (1.0 - gamma)
    return Extreme(value, value + sign * beyond, solver.p, sweeps, residual, np.zeros(0, dtype=np.int64))


def _refused(solver: _Rows) -> Extreme:
    return Extreme(np.nan, np.nan, solver.p, 0, np.nan, np.flatnonzero(solver.bad))


class _Rows:
    """The row problems of one extreme, with multipliers kept as guesses from sweep to sweep."""

    def __init__(self, evidence: Evidence, radius: Array, sign: float, ball: str) -> None:
        self._evidence, self._radius, self._sign, self._ball = evidence, radius, sign, ball
        self.p = evidence.phat.copy()
        self._lam = np.zeros(len(radius))
        self.bad: BoolArray = np.zeros(len(radius), dtype=np.bool_)

    def above(self, values: Array) -> Array:
        """(S*A,) certified bounds on sign * max sum P (sign * values), times sign; the maximisers are in ``p``."""
        from oee_tabular.inference import _robust as kernel

        part = self._evidence
        v = self._sign * values
        if self._ball == "l1":
            order = np.lexsort((v, row_of_entry(part.model.transitions)))
            self.bad = ~kernel.worst_l1(self._radius, part.phat, v, part.low, part.high, part.indptr, order, self.p)
            return self._sign * np.add.reduceat(self.p * v, part.indptr[:-1])
        n_rows = len(self._radius)
        bound, kl = np.empty(n_rows), np.empty(n_rows)
        kernel.worst_rows(self._radius, part.phat, v, part.low, part.high, part.indptr, self._lam, self.p, bound, kl)
        finite = np.isfinite(self._radius)
        self.bad = finite & (kl > self._radius * (1.0 + 1e-9) + 1e-15)
        return self._sign * bound


def contradicted_rows(evidence: Evidence, confidence: float, kind: str) -> IntArray:
    """Rows in which the KL ball of the counts misses the box: the box is wrong there, with the confidence given."""
    solver = _Rows(evidence, radii(evidence, confidence, kind, "kl"), 1.0, "kl")
    solver.above(np.zeros(len(evidence.phat)))
    return np.flatnonzero(solver.bad)


def describe_rows(evidence: Evidence, rows: Any) -> str:
    """The first rows, as (s, a) with their counts."""
    n_actions, names = evidence.model.n_actions, names_of(evidence.model)
    named = ", ".join(f"({names.pair(*divmod(int(r), n_actions))}, n={evidence.n[r]:g})" for r in rows[:5])
    return named + ("" if len(rows) <= 5 else f" and {len(rows) - 5} more")
