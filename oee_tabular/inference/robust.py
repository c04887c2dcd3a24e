"""Guaranteed extremes of J: every row in its own set of distributions, by robust policy evaluation.

    U(s, a) = {P : sum phat log(phat / P) <= epsilon(s, a),  low <= P <= high,  sum P = 1}
    V(s)    = sum_a pi(a | s) max_{P in U(s, a)} sum_s' P(s') (r(s, a, s') + gamma V(s'))       (min for the lower end)

The best rows for V, then V for these rows, until the Bellman residual is rounding [3]. The row problems are solved with an
upper bound each (``_robust``), and what is left of the residual widens the interval. The radii hold for all rows at once with
the confidence asked for (a union over the rows).

Sources: [1] R. Agrawal, Finite-sample concentration of the multinomial in relative entropy, IEEE Trans. Information Theory 66,
2020. [2] A. Jonsson et al., Planning in Markov decision processes with gap-dependent sample complexity, NeurIPS 2020. [3] G.
Iyengar, Robust dynamic programming, Mathematics of Operations Research 30, 2005; A. Nilim and L. El Ghaoui, Robust control of
Markov decision processes, Operations Research 53, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._threads import dot
from oee_tabular.exact import evaluate_policy, state_values
from oee_tabular.inference.evidence import Evidence, reachable_rows
from oee_tabular.mdp.horizons import optional_horizon_length

N_SWEEPS = 100  # at most; five to ten are usual
N_STALLED = 8  # sweeps that no longer halve the residual: what is left is rounding


def independent_radius(n: Array, k: IntArray, level: float) -> Array:
    """epsilon with Pr(KL(phat || P) > epsilon) <= level for n independent draws over k outcomes [1].

    c = n epsilon solves e^-c (e c / (k - 1))^(k - 1) = level, c > k - 1. inf where n = 0.
    """
    order = np.maximum(k - 1.0, 1.0)
    # -c + (k-1) (1 + log(c / (k-1))) = log level: with y = c / (k-1), y e^-y = exp(log level / (k-1) - 1)
    c = -order * special.lambertw(-np.exp(np.log(level) / order - 1.0), k=-1).real
    return np.where(n > 0, c / np.maximum(n, 1.0), np.inf)


def anytime_radius(n: Array, k: IntArray, level: float) -> Array:
    """The same where n is itself random, as in episodes: (log(1/level) + (k - 1) log(e (1 + n / (k - 1)))) / n [2]."""
    order = np.maximum(k - 1.0, 1.0)
    c = np.log(1.0 / level) + order * (1.0 + np.log1p(n / order))
    return np.where(n > 0, c / np.maximum(n, 1.0), np.inf)


def radii(evidence: Evidence, confidence: float, kind: str) -> Array:
    """(S*A,) radius of each row, the failure probability shared evenly by the rows that are reached and open."""
    counted = int((evidence.open_rows & reachable_rows(evidence)).sum())
    level = (1.0 - confidence) / max(counted, 1)
    radius = independent_radius if kind == "independent" else anytime_radius
    return radius(evidence.n, np.diff(evidence.indptr), level)


@dataclass(frozen=True, eq=False)
class Extreme:
    """The largest value (``sign`` 1) or the smallest (-1), a bound beyond it, and the model that has it.

    ``contradicted`` are rows whose counts no distribution in the box can explain; then there is no value.
    """

    value: float
    bound: float
    rows: Array
    sweeps: int
    residual: float
    contradicted: IntArray


def extreme_value(evidence: Evidence, radius: Array, sign: float, *, most: int = N_SWEEPS) -> Extreme:
    """The extreme of J over the rectangular set, certified (at discount 1 without a horizon, to rounding only)."""
    model = evidence.model
    rows = _RowProblems(evidence, radius, sign)
    steps = optional_horizon_length(evidence.horizon, model, evidence.policy)
    if steps is not None:
        values = np.zeros(model.n_states)
        for t in range(steps - 1, -1, -1):
            values = rows.back_up(values, t)
            if rows.contradicted.any():
                return rows.refuse()
        value = dot(model.initial, values)
        return Extreme(value, value, rows.p, steps, 0.0, np.zeros(0, dtype=np.int64))
    values = state_values(evidence.with_rows(evidence.phat), evidence.policy)
    residual, rise, sweeps, stalled = np.inf, 0.0, 0, 0
    while sweeps < most:
        sweeps += 1
        backed = rows.back_up(values)
        if rows.contradicted.any():
            return rows.refuse()
        rise = max(float((sign * (backed - values)).max()), 0.0)
        last, residual = residual, float(np.abs(backed - values).max())
        stalled = stalled + 1 if residual >= 0.5 * last else 0
        if residual <= 1e-12 * max(1.0, float(np.abs(values).max())) or stalled >= N_STALLED:
            break
        values = evaluate_policy(evidence.with_rows(rows.p), evidence.policy).values
    value = dot(model.initial, values)
    beyond = rise / (1.0 - model.discount) if model.discount < 1.0 else 0.0
    return Extreme(value, value + sign * beyond, rows.p, sweeps, residual, np.zeros(0, dtype=np.int64))


class _RowProblems:
    """The row problems of one extreme, with multipliers kept as guesses from sweep to sweep."""

    def __init__(self, evidence: Evidence, radius: Array, sign: float) -> None:
        model = evidence.model
        self._evidence, self._radius, self._sign = evidence, radius, sign
        by_move = model.reward_data is not None
        self._move_rewards = model.reward_data if by_move else 0.0
        self._row_rewards = 0.0 if by_move else model.rewards.reshape(-1)
        self._multipliers = np.zeros(len(radius))
        self.p = evidence.phat.copy()
        self.contradicted: BoolArray = np.zeros(len(radius), dtype=np.bool_)

    def back_up(self, values: Array, t: int = 0) -> Array:
        """(S,) sum_a pi max P (r + gamma V), of the policy's step t."""
        model, policy = self._evidence.model, self._evidence.policy
        best = self._row_rewards + self.solve(self._move_rewards + model.discount * values[model.transitions.indices])
        pi = policy if policy.ndim == 2 else policy[t]
        return np.asarray((pi * best.reshape(pi.shape)).sum(axis=1))

    def solve(self, v: Array) -> Array:
        """(S*A,) certified bounds on sign * max sum P (sign * v), times sign; the maximisers are in ``p``."""
        from oee_tabular.inference import _robust as kernel

        part, bound, kl = self._evidence, np.empty(len(self._radius)), np.empty(len(self._radius))
        kernel.worst_rows(
            self._radius,
            part.phat,
            self._sign * v,
            part.low,
            part.high,
            part.indptr,
            self._multipliers,
            self.p,
            bound,
            kl,
        )
        self.contradicted = np.isfinite(self._radius) & (kl > self._radius * (1.0 + 1e-9) + 1e-15)
        return self._sign * bound

    def refuse(self) -> Extreme:
        """No value: the contradicted rows."""
        return Extreme(np.nan, np.nan, self.p, 0, np.nan, np.flatnonzero(self.contradicted))


def find_contradictions(evidence: Evidence, confidence: float, kind: str) -> IntArray:
    """Rows in which the KL ball of the counts misses the box: the box is wrong there, with the confidence given."""
    rows = _RowProblems(evidence, radii(evidence, confidence, kind), 1.0)
    rows.solve(np.zeros(len(evidence.phat)))
    return np.flatnonzero(rows.contradicted)
