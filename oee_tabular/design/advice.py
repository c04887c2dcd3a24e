"""The advice of a plan and of a report: which state-action pairs to record next, one
transition after another.
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import NormalDist

import numpy as np

from oee_tabular._sparse import row_sums
from oee_tabular.design.costs import row_costs
from oee_tabular.estimators import Problem
from oee_tabular.exact import reweight
from oee_tabular.mdp.naming import Names
from oee_tabular.ratio import Conditional
from oee_tabular.ratio.dual import Box
from oee_tabular.typing import Array, BoolArray

NOTHING = "More transitions would not narrow it."


def next_pairs(
    table: Array, counts: Array, n_actions: int, number: int, confidence: float
) -> tuple[tuple[int, int], ...]:
    """Choose the ``number`` pairs (s, a) that most reduce the widths of the policies'
    intervals, one after another.

    ``table`` (K, S*A) costs c of each policy, ``counts`` (S*A,) n. Off a width 2 z se,
    se^2 = sum c / n, a transition of a recorded row takes z c / (n (n + 1)) / se; of a
    row never recorded 2 z sqrt(c), all that one transition of it leaves. None that
    costs 0.
    """
    z = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    n = np.array(counts, dtype=np.float64)
    chosen = []
    gain_if_never_recorded = np.sum(2.0 * z * np.sqrt(table), axis=0)
    for _ in range(number if np.any(table > 0.0) else 0):
        variance = table / np.maximum(n, 1.0) * (n > 0)
        error = np.sqrt(variance.sum(axis=1, keepdims=True))
        gain = np.divide(
            z * variance, error, out=np.zeros_like(table), where=error > 0.0
        ).sum(axis=0) / (n + 1.0)
        row = int(np.argmax(np.where(n > 0, gain, gain_if_never_recorded)))
        n[row] += 1.0
        chosen.append(divmod(row, n_actions))
    return tuple(chosen)


def advice_sentence(
    pairs: tuple[tuple[int, int], ...],
    table: Array,
    counts: Array,
    optimistic: BoolArray,
    names: Names,
) -> str:
    """Say the first of the pairs, and why; ``table`` (K, S, A), ``counts`` and
    ``optimistic`` (S, A).
    """
    if not pairs:
        return NOTHING
    state, action = pairs[0]
    n = counts[state, action]
    why = "never recorded"
    so_far = f"{n:.4g} {'transition' if n == 1 else 'transitions'} so far"
    if optimistic[state, action]:
        why = f"{so_far}; the model has one outcome"
    elif n > 0:
        variance = table / np.maximum(counts, 1.0)
        total = variance.sum(axis=(1, 2))
        share = np.divide(
            variance[:, state, action],
            total,
            out=np.zeros_like(total),
            where=total > 0.0,
        ).mean()
        why = f"{so_far}, {share:.0%} of the value's variance"
    return f"Record {describe_pair(names, state, action)} first ({why})."


def describe_pair(names: Names, state: int, action: int) -> str:
    """Return ``action left in state hall``."""
    return (
        f"action {_quote(names.action(action))} in state {_quote(names.state(state))}"
    )


def _quote(name: str) -> str:
    """Quote a name of several words, so that one sees where it ends; coordinates have
    their brackets.
    """
    return f"“{name}”" if " " in name and not name.startswith("(") else name


def advice(problem: Problem, policies: Mapping[str, Array], confidence: float) -> str:
    """Return the sentence of ``plan_data_collection`` with the same log, policies and
    confidence.

    Cost: one ratio, and an evaluation and an occupancy a policy.
    """
    mdp = problem.model
    shape = (mdp.n_states, mdp.n_actions)
    counts = row_sums(problem.counts)
    model = reweight(
        mdp, Conditional().fit(problem.observed, problem.simulator, cache=problem.cache)
    )
    table, optimistic = row_costs(
        mdp,
        model,
        list(policies.values()),
        counts,
        horizon=problem.horizon,
        box=Box(0.0, np.inf),
        confidence=confidence,
        optimistic=True,
    )
    pairs = next_pairs(table, counts, shape[1], 1, confidence)
    return advice_sentence(
        pairs,
        table.reshape(-1, *shape),
        counts.reshape(shape),
        optimistic.reshape(shape),
        mdp.names,
    )
