"""Costs of the state-action pairs: c_x = Var_{s' ~ P'(.|x)}[G_x(s')], and what is assumed where the model has no spread.

The set of plausible rows, and its bounds, are stated at the door of the room (``oee_tabular.design``).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray
from oee_tabular._sparse import align, canonical, csr_on_pattern, row_sums, row_variances
from oee_tabular.design._variance import largest_variances
from oee_tabular.exact import Model, ReweightedModel, transition_gradient
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.arguments import Box

ACTION_NOISE = 0.1  # of R: half of it another action, half of it no transition
CERTAIN = 1.0 - 1e-12  # a row whose largest probability is above this has no spread
ROUNDING = (1e-24, 1e-28)  # of the largest cost, and of the largest G^2: costs below are the rounding of 0


def row_costs(
    simulator: FiniteMDP,
    model: Model,
    policies: list[Array],
    counts: Array,
    *,
    horizon: int | None,
    box: Box,
    confidence: float,
    optimistic: bool,
) -> tuple[Array, BoolArray]:
    """Compute c_x (K, S*A) of each policy at ``model`` (on the simulator's support), and the rows (S*A,) with a worst case.

    ``counts`` (S*A,) are the log's. Units: those of J, squared. Cost: one policy evaluation and one occupancy a policy.
    """
    largest = np.maximum.reduceat(model.transitions.data, model.transitions.indptr[:-1])
    is_terminal = np.repeat(simulator.closed(), simulator.n_actions)
    certain = (largest >= CERTAIN) & ~is_terminal & optimistic
    if certain.any():
        model, reference = _add_reference_entries(simulator, model, certain)
        low, high = _bounds(model.transitions, reference, box, counts, confidence)
    matrix, table = model.transitions, np.zeros((len(policies), len(certain)))
    for row, policy in zip(table, policies, strict=True):
        gradient = transition_gradient(model, policy, horizon=horizon)
        row[:] = row_variances(matrix, matrix.data, gradient)
        if certain.any():
            row[certain] = largest_variances(matrix.indptr, np.flatnonzero(certain), gradient, low, high)
        row[row <= max(ROUNDING[0] * row.max(), ROUNDING[1] * np.abs(gradient).max() ** 2)] = 0.0
    return table, certain


def _bounds(
    matrix: sparse.csr_array, reference: Array, box: Box, counts: Array, confidence: float
) -> tuple[Array, Array]:
    """Bound each entry; the outcome that the model is sure of keeps what its observations assure."""
    lengths, sure = np.diff(matrix.indptr), matrix.data >= CERTAIN
    low = box.lower * reference
    high = np.minimum(box.upper * reference, 1.0) if np.isfinite(box.upper) else 1.0 * (reference > 0.0)
    number = np.repeat(counts, lengths)[sure]
    assured = np.where(number > 0, (1.0 - confidence) ** (1.0 / np.maximum(number, 1.0)), 0.0)
    room = 1.0 - np.repeat(row_sums(matrix, np.where(sure, 0.0, low)), lengths)[sure]
    low[sure] = np.clip(assured, low[sure], np.minimum(high[sure], room))
    return low, np.asarray(high)


def _add_reference_entries(simulator: FiniteMDP, model: Model, certain: BoolArray) -> tuple[ReweightedModel, Array]:
    """Give the model the entries of R in the rows ``certain``, most of them 0, and return R there (0 in the other rows).

    A transition that the simulator lacks in this row has its reward under another action, or else the row's
    mean.
    """
    n_states, n_actions = simulator.rewards.shape
    matrix, chosen = simulator.transitions, sparse.diags_array(certain.astype(np.float64))
    any_action = sparse.kron(sparse.eye_array(n_states), np.full((n_actions, n_actions), 1.0 / n_actions))
    any_action = canonical(chosen @ any_action, drop_zeros=True)
    mean = canonical(any_action @ matrix, drop_zeros=False)
    stay = chosen @ sparse.kron(sparse.eye_array(n_states), np.ones((n_actions, 1)))
    reference = (1.0 - ACTION_NOISE) * (chosen @ matrix) + 0.5 * ACTION_NOISE * (mean + stay)
    pattern = canonical(model.transitions + reference, drop_zeros=True)
    rewards = None
    if simulator.reward_data is not None:
        rewards = np.repeat(simulator.rewards.reshape(-1), np.diff(pattern.indptr))
        reward_sums = any_action @ csr_on_pattern(matrix, matrix.data * simulator.reward_data, own=True)
        chance = align(mean, pattern)[0]
        np.divide(align(canonical(reward_sums, drop_zeros=False), pattern)[0], chance, out=rewards, where=chance > 0.0)
        own, is_defined = align(simulator.transition_rewards, pattern)
        np.copyto(rewards, own, where=is_defined)
    transitions = csr_on_pattern(pattern, align(model.transitions, pattern)[0], own=True)
    wider = ReweightedModel(
        n_states, n_actions, transitions, model.rewards, rewards, model.initial, model.discount, model.terminal_state
    )  # fmt: skip
    return wider, align(canonical(reference, drop_zeros=True), pattern)[0]
