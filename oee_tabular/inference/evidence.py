"""What the log says of each row, and what the simulator and the box allow there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._checks import Array, BoolArray, IntArray, PolicyLike
from oee_tabular._sparse import align, row_of_entry
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, occupancy
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


def simulator_rows(evidence: Evidence) -> Array:
    """(entries,) the simulator's probabilities, rows summing to 1."""
    data = evidence.model.transitions.data
    return np.asarray(data / np.add.reduceat(data, evidence.indptr[:-1])[evidence.rows])


def unseen_time(evidence: Evidence) -> float:
    """Of the policy's discounted time, the share in open rows without data, which are the simulator's."""
    time = occupancy(evidence.with_rows(evidence.phat), evidence.policy, horizon=evidence.horizon)
    return float(time.reshape(-1)[(evidence.n == 0) & evidence.open_rows].sum())


def reachable_rows(evidence: Evidence, steps: int | None = None) -> BoolArray:
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


def describe_rows(evidence: Evidence, rows: Any) -> str:
    """The first rows, as (s, a) with their counts."""
    n_actions, names = evidence.model.n_actions, names_of(evidence.model)
    named = ", ".join(f"({names.pair(*divmod(int(r), n_actions))}, n={evidence.n[r]:g})" for r in rows[:5])
    return named + ("" if len(rows) <= 5 else f" and {len(rows) - 5} more")
