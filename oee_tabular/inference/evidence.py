"""The log's frequencies of each pair, and the bounds of the simulator's support and the
box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oee_tabular import _checks
from oee_tabular._sparse import align
from oee_tabular.estimators import Problem
from oee_tabular.exact import ReweightedModel, occupancy
from oee_tabular.exact.reweighted import with_rows
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.rows import Rows
from oee_tabular.typing import Array, BoolArray, PolicyLike

LARGEST_REWARD = 1e140


@dataclass(frozen=True, eq=False)
class Evidence:
    """A problem as the sets of distributions read it, on the entries of the simulator's
    transitions.

    ``phat`` (entries,) frequencies (the simulator's rows where there are none), ``n``
    (S*A,) counts, ``low`` and ``high`` the box lower_ratio * P and upper_ratio * P (at
    most 1).
    """

    model: FiniteMDP
    policy: Array
    horizon: int | None
    rows: Rows
    phat: Array
    n: Array
    low: Array
    high: Array
    has_box: bool

    @cached_property
    def open_rows(self) -> BoolArray:
        """(S*A,) the rows with more than one next state."""
        return np.diff(self.rows.indptr) > 1

    @cached_property
    def pay(self) -> Array:
        """(entries,) r(s, a, s')."""
        data = self.model.reward_data
        return (
            self.rows.spread(self.model.rewards.reshape(-1)) if data is None else data
        )

    @cached_property
    def reachable(self) -> BoolArray:
        """(S*A,) the rows that the policy can reach in some model on the simulator's
        support.
        """
        return reachable_rows(self)

    @cached_property
    def fitted(self) -> ReweightedModel:
        """The maximum-likelihood model."""
        return self.with_rows(self.phat)

    def with_rows(self, probabilities: Array) -> ReweightedModel:
        """The model with these probabilities on the simulator's entries, zeros kept."""
        return with_rows(self.model, probabilities)


def gather(
    problem: Problem,
    policy: PolicyLike,
    lower_ratio: float | None = None,
    upper_ratio: float | None = None,
) -> Evidence:
    """Counts and box, checked: 0 <= lower_ratio <= 1 <= upper_ratio."""
    pi = check_policy(policy, problem.model)
    counts = problem.counts
    return evidence_of(
        problem.model, pi, problem.horizon, counts, lower_ratio, upper_ratio
    )


def evidence_of(
    model: FiniteMDP,
    policy: Array,
    horizon: int | None,
    counts: sparse.csr_array | None,
    lower_ratio: float | None,
    upper_ratio: float | None,
) -> Evidence:
    """The same of a model and counts on its support, or None, for a policy that was
    checked.
    """
    nu = (
        0.0
        if lower_ratio is None
        else _checks.number_in(lower_ratio, "lower_ratio", 0.0, 1.0)
    )
    mu = (
        np.inf
        if upper_ratio is None
        else _checks.number_in(upper_ratio, "upper_ratio", 1.0, np.inf, infinite=True)
    )
    rows = Rows.of(model)
    observed = (
        np.zeros(len(rows.weights))
        if counts is None
        else align(counts, model.transitions)[0]
    )
    n = rows.sums(observed)
    phat = np.where(rows.spread(n) > 0, rows.frequencies(observed), rows.weights)
    high = np.minimum(mu * rows.weights, 1.0) if np.isfinite(mu) else np.ones(len(phat))
    has_box = lower_ratio is not None or upper_ratio is not None
    return Evidence(
        model, policy, horizon, rows, phat, n, nu * rows.weights, high, has_box
    )


def require_squares(model: FiniteMDP) -> None:
    """Rewards so small that floats hold the squares of values: what multiplies two of
    them would be nan.
    """
    largest = float(
        np.abs(model.rewards if model.reward_data is None else model.reward_data).max()
    )
    if largest > LARGEST_REWARD:
        raise ValueError(
            f"the simulator's rewards must be at most {LARGEST_REWARD:g}, so that"
            f" floats hold the squares of values; they reach {largest:g}: give them in"
            " a larger unit"
        )


def unrecorded_share(evidence: Evidence) -> float:
    """Of the policy's discounted time, the share in open rows without data, which are
    the simulator's.
    """
    time = occupancy(evidence.fitted, evidence.policy, horizon=evidence.horizon)
    return float(time.reshape(-1)[(evidence.n == 0) & evidence.open_rows].sum())


def reachable_rows(evidence: Evidence, steps: int | None = None) -> BoolArray:
    """``reachable``; with ``steps``, as one of the policy's first."""
    taken = evidence.policy > 0
    size = evidence.model.n_states
    state, _, following = evidence.rows.select(taken.reshape(-1)).transitions
    # a node of its own leads to every start
    starts = np.flatnonzero(evidence.model.initial > 0)
    tail = np.append(state, np.full(len(starts), size))
    head = np.append(following, starts)
    graph = sparse.csr_array(
        (np.ones(len(tail)), (tail, head)), shape=(size + 1, size + 1)
    )
    seen = np.zeros(size + 1, dtype=np.bool_)
    if steps is None or steps >= size:
        seen[csgraph.breadth_first_order(graph, size, return_predecessors=False)] = True
    else:
        seen = np.isfinite(
            csgraph.dijkstra(graph, indices=size, unweighted=True, limit=steps)
        )
    return np.asarray((seen[:size, None] & taken).reshape(-1))


def describe_rows(evidence: Evidence, rows: Any) -> str:
    """The first rows, as (s, a) with their counts."""
    n_actions = evidence.model.n_actions
    names = evidence.model.names
    named = ", ".join(
        f"({names.pair(*divmod(int(r), n_actions))}, n={evidence.n[r]:g})"
        for r in rows[:5]
    )
    return named + ("" if len(rows) <= 5 else f" and {len(rows) - 5} more")
