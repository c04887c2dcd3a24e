"""What the log leaves open: counts, the prior box on every row, confidence sets, and the extreme values over them.

Each row of the target is in a KL ball around its frequencies, sum phat log(phat / P) <= epsilon, and in the prior box; all
rows at once with the confidence asked for (a union over the rows). The extreme value is found by robust policy evaluation [4]:
the worst rows for V, then V for these rows, until the Bellman residual is rounding; the row problems are solved with an upper
bound each, and what is left of the residual widens the interval.

Sources: [1] R. Agrawal, Finite-sample concentration of the multinomial in relative entropy, IEEE Trans. Information Theory 66,
2020. [2] A. Jonsson et al., Planning in Markov decision processes with gap-dependent sample complexity, NeurIPS 2020. [3] T.
Weissman et al., Inequalities for the L1 deviation of the empirical distribution, HP Labs, 2003. [4] G. Iyengar, Robust dynamic
programming, Mathematics of Operations Research 30, 2005; A. Nilim and L. El Ghaoui, Robust control of Markov decision
processes, Operations Research 53, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse, special
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, PolicyLike
from oee_tabular._sparse import align, row_of_entry
from oee_tabular._threads import dot
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, evaluate_policy, occupancy, state_values
from oee_tabular.exact.reweighted import with_rows
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.naming import names_of

LARGEST_REWARD = 1e140


@dataclass(frozen=True, eq=False)
class Evidence:
    """A problem as the sets of distributions read it, on the entries of the simulator's transitions.

    ``phat`` (entries,) frequencies (the simulator's rows where there are none), ``n`` (S*A,) counts, ``low`` and ``high`` the
    box lower_ratio * P and upper_ratio * P (at most 1), ``open_rows`` those with more than one next state.
    """

    model: FiniteMDP
    policy: Array
    horizon: int | None
    indptr: IntArray
    phat: Array
    n: Array
    low: Array
    high: Array
    open_rows: BoolArray
    has_box: bool

    @property
    def rows(self) -> IntArray:
        """The row of each entry."""
        return row_of_entry(self.model.transitions)

    def with_rows(self, probabilities: Array) -> ReweightedModel:
        """The model with these probabilities on the simulator's entries, zeros kept."""
        return with_rows(self.model, probabilities)


def gather(
    problem: Problem, policy: PolicyLike, lower_ratio: float | None = None, upper_ratio: float | None = None
) -> Evidence:
    """Counts and box, checked: 0 <= lower_ratio <= 1 <= upper_ratio."""
    return evidence_of(problem.model, problem.counts, problem.horizon, policy, lower_ratio, upper_ratio)


def evidence_of(
    model: FiniteMDP, counts: sparse.csr_array, horizon: int | None, policy: PolicyLike, lower_ratio: float | None = None,
    upper_ratio: float | None = None,
) -> Evidence:  # fmt: skip
    """The same of a model and counts on its support."""
    pi = check_policy(policy, model)
    low = 0.0 if lower_ratio is None else _checks.number_in(lower_ratio, "lower_ratio", 0.0, 1.0)
    high = np.inf if upper_ratio is None else _checks.number_in(upper_ratio, "upper_ratio", 1.0, np.inf, infinite=True)
    matrix = model.transitions
    indptr = matrix.indptr.astype(np.int64)
    rows = row_of_entry(matrix)
    observed, _ = align(counts, matrix)
    n = np.add.reduceat(observed, indptr[:-1])
    probability = matrix.data / np.add.reduceat(matrix.data, indptr[:-1])[rows]
    phat = np.where(n[rows] > 0, observed / np.maximum(n[rows], 1.0), probability)
    above = np.minimum(high * probability, 1.0) if np.isfinite(high) else np.ones(len(phat))
    return Evidence(
        model,
        pi,
        horizon,
        indptr,
        phat,
        n,
        low * probability,
        above,
        np.diff(indptr) > 1,
        lower_ratio is not None or upper_ratio is not None,
    )


def require_squares(model: FiniteMDP) -> None:
    """Rewards so small that floats hold the squares of values: what multiplies two of them would be nan."""
    largest = float(np.abs(model.rewards if model.reward_data is None else model.reward_data).max())
    if largest > LARGEST_REWARD:
        raise ValueError(
            f"the simulator's rewards must be at most {LARGEST_REWARD:g}, so that floats hold the squares of values; they "
            f"reach {largest:g}: give them in a larger unit"
        )


def simulated_rows(evidence: Evidence) -> Array:
    """(entries,) the simulator's probabilities, rows summing to 1."""
    data = evidence.model.transitions.data
    return np.asarray(data / np.add.reduceat(data, evidence.indptr[:-1])[evidence.rows])


def unseen_time(evidence: Evidence) -> float:
    """Of the policy's discounted time, the share in open rows without data, which are the simulator's."""
    time = occupancy(evidence.with_rows(evidence.phat), evidence.policy, horizon=evidence.horizon)
    return float(time.reshape(-1)[(evidence.n == 0) & evidence.open_rows].sum())


def reached_rows(evidence: Evidence, steps: int | None = None) -> BoolArray:
    """(S*A,) rows that the policy can reach in some model on the simulator's support; with ``steps``, as one of its first."""
    model = evidence.model
    taken = evidence.policy > 0
    rows, columns = row_of_entry(model.transitions), model.transitions.indices
    used = taken.reshape(-1)[rows]
    size = model.n_states
    starts = np.flatnonzero(model.initial > 0)  # a node of its own leads to every start
    tail = np.concatenate([rows[used] // model.n_actions, np.full(len(starts), size)])
    head = np.concatenate([columns[used], starts])
    graph = sparse.csr_array((np.ones(len(tail)), (tail, head)), shape=(size + 1, size + 1))
    seen = np.zeros(size + 1, dtype=np.bool_)
    if steps is None or steps >= size:
        seen[csgraph.breadth_first_order(graph, size, return_predecessors=False)] = True
    else:
        seen = np.isfinite(csgraph.dijkstra(graph, indices=size, unweighted=True, limit=steps))
    return np.asarray((seen[:size, None] & taken).reshape(-1))


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


def l1_radius(n: Array, k: IntArray, level: float) -> Array:
    """r with Pr(|phat - P|_1 > r) <= level: sqrt(2 log((2^k - 2) / level) / n) [3]; at most 2."""
    bound = np.sqrt(2.0 * (np.log(np.maximum(2.0**k - 2.0, 1.0)) - np.log(level)) / np.maximum(n, 1.0))
    return np.where(n > 0, np.minimum(bound, 2.0), 2.0)


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
