"""Advice: which state-action pairs to record next, one transition after another."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import NormalDist
from typing import Literal

import numpy as np

from oee_tabular._sparse import row_sums
from oee_tabular.design.costs import row_costs
from oee_tabular.estimators import Problem
from oee_tabular.exact import reweight
from oee_tabular.mdp import Names, place_names
from oee_tabular.ratio import Conditional
from oee_tabular.ratio.dual import Box
from oee_tabular.typing import Array, BoolArray

NO_ADVICE = "More transitions would not narrow it."


def next_pairs(
    table: Array, counts: Array, n_actions: int, number: int, confidence: float
) -> tuple[tuple[int, int], ...]:
    """Choose the pairs (s, a) that most reduce the widths of the policies' intervals.

    They are ``number`` pairs, chosen one after another; none if every cost is 0.
    ``table`` (K, S*A) are the costs c of each policy, ``counts`` (S*A,) n. Off a width
    2 z se, se^2 = sum c / n, a transition of a recorded row takes z c / (n (n + 1)) /
    se; of a row never recorded it takes 2 z sqrt(c), all that one transition of it
    leaves.
    """
    z = NormalDist().inv_cdf(0.5 + confidence / 2.0)
    n = np.array(counts, dtype=np.float64)
    if not np.any(table > 0.0):
        return ()
    chosen = []
    gain_if_never_recorded = np.sum(2.0 * z * np.sqrt(table), axis=0)
    for _ in range(number):
        variance = table / np.maximum(n, 1.0) * (n > 0)
        error = np.sqrt(variance.sum(axis=1, keepdims=True))
        # a policy whose value is certain gains nothing
        slope = np.divide(
            z * variance, error, out=np.zeros_like(table), where=error > 0.0
        )
        gain = slope.sum(axis=0) / (n + 1.0)
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
    of: Literal["value", "gain"] = "value",
) -> str:
    """Say which pair to record first, what for, and why.

    ``table`` (K, S, A) are costs, ``counts`` and ``optimistic`` have shape (S, A);
    ``of`` says what the costs are the variance of.
    """
    if not pairs:
        return NO_ADVICE
    state, action = pairs[0]
    n = counts[state, action]
    pair = describe_pair(names, state, action)
    is_sure = optimistic[state, action]
    if n == 0 and not is_sure:
        # the interval may even widen with the first record
        known = "what happens there is assumed and not measured"
        if of == "gain":  # whose end holds whatever the factor allows there
            known = "no measurement says what happens there"
        return f"Record {pair} first: it was never recorded, so {known}."
    so_far = f"{n:.4g} {'transition' if n == 1 else 'transitions'} so far"
    # of what the model is sure the interval allows nothing else
    why = f"{so_far}; the model has one outcome"
    purpose = "To test what the model is sure of"
    if not is_sure:
        variance = table / np.maximum(counts, 1.0)
        total = variance.sum(axis=(1, 2))
        shares = np.divide(
            variance[:, state, action],
            total,
            out=np.zeros_like(total),
            where=total > 0.0,
        )
        why = f"{so_far}, {shares.mean():.0%} of the variance of the estimated {of}"
        purpose = "To narrow the interval"
    return f"{purpose}, record {pair} first ({why})."


def describe_pair(names: Names, state: int, action: int) -> str:
    """Name a state-action pair, as in "action left in state hall"."""
    return names.describe_pair(state, action)


def advice(
    problem: Problem,
    policies: Mapping[str, Array],
    confidence: float,
    minus: Array | None = None,
) -> str:
    """Return the advice of ``plan_data_collection`` on the same log and policies.

    With ``minus`` it is that for the gains over this policy. Cost: one ratio, and an
    evaluation and an occupancy for each policy.
    """
    mdp = problem.model
    shape = (mdp.n_states, mdp.n_actions)
    counts = row_sums(problem.counts)
    ratio = Conditional().fit(problem.observed, problem.simulator, cache=problem.cache)
    model = reweight(mdp, ratio)
    table, optimistic = row_costs(
        mdp,
        model,
        list(policies.values()),
        counts,
        horizon=problem.horizon,
        box=Box(0.0, np.inf),
        confidence=confidence,
        optimistic=True,
        minus=minus,
    )
    pairs = next_pairs(table, counts, shape[1], 1, confidence)
    return advice_sentence(
        pairs,
        table.reshape(-1, *shape),
        counts.reshape(shape),
        optimistic.reshape(shape),
        place_names(mdp),
        of="value" if minus is None else "gain",
    )
