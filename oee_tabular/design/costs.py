"""Costs of the state-action pairs: c_x = Var_{s' ~ P'(.|x)}[G_x(s')], and what is
assumed where the model has no spread.

The set of plausible rows, and its bounds, are stated at the door of the room
(``oee_tabular.design``).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import sparse

from oee_tabular._sparse import (
    align,
    canonical,
    csr_on_pattern,
    row_sums,
    row_variances,
)
from oee_tabular.exact import Model, ReweightedModel, transition_gradient
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.dual import Box
from oee_tabular.typing import Array, BoolArray

ACTION_NOISE = 0.1  # of R: half of it another action, half of it no transition
CERTAIN = 1.0 - 1e-12  # a row whose largest probability is above this has no spread
# of the largest cost, and of the largest G^2: costs below are the rounding of 0
ROUNDING = (1e-24, 1e-28)


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
    """Compute c_x (K, S*A) of each policy at ``model`` (on the simulator's support),
    and the rows (S*A,) with a worst case.

    ``counts`` (S*A,) are the log's. Units: those of J, squared. Cost: one policy
    evaluation and one occupancy a policy.
    """
    largest = np.maximum.reduceat(model.transitions.data, model.transitions.indptr[:-1])
    is_terminal = np.repeat(simulator.closed(), simulator.n_actions)
    certain = (largest >= CERTAIN) & ~is_terminal & optimistic
    if certain.any():
        model, reference = _add_reference_entries(simulator, model, certain)
        low, high = _bounds(model.transitions, reference, box, counts, confidence)
    matrix = model.transitions
    table = np.zeros((len(policies), len(certain)))
    for row, policy in zip(table, policies, strict=True):
        gradient = transition_gradient(model, policy, horizon=horizon)
        row[:] = row_variances(matrix, matrix.data, gradient)
        if certain.any():
            row[certain] = largest_variances(
                matrix.indptr, np.flatnonzero(certain), gradient, low, high
            )
        row[
            row
            <= max(ROUNDING[0] * row.max(), ROUNDING[1] * np.abs(gradient).max() ** 2)
        ] = 0.0
    return table, certain


def _bounds(
    matrix: sparse.csr_array,
    reference: Array,
    box: Box,
    counts: Array,
    confidence: float,
) -> tuple[Array, Array]:
    """Bound each entry; the outcome that the model is sure of keeps what its
    observations assure.
    """
    lengths = np.diff(matrix.indptr)
    sure = matrix.data >= CERTAIN
    low = box.lower * reference
    high = (
        np.minimum(box.upper * reference, 1.0)
        if np.isfinite(box.upper)
        else 1.0 * (reference > 0.0)
    )
    number = np.repeat(counts, lengths)[sure]
    assured = np.where(
        number > 0, (1.0 - confidence) ** (1.0 / np.maximum(number, 1.0)), 0.0
    )
    room = 1.0 - np.repeat(row_sums(matrix, np.where(sure, 0.0, low)), lengths)[sure]
    low[sure] = np.clip(assured, low[sure], np.minimum(high[sure], room))
    return low, np.asarray(high)


def _add_reference_entries(
    simulator: FiniteMDP, model: Model, certain: BoolArray
) -> tuple[ReweightedModel, Array]:
    """Give the model the entries of R in the rows ``certain``, most of them 0, and
    return R there (0 in the other rows).

    A transition that the simulator lacks in this row has its reward under another
    action, or else the row's
    mean.
    """
    n_states, n_actions = simulator.rewards.shape
    matrix = simulator.transitions
    chosen = sparse.diags_array(certain.astype(np.float64))
    any_action = sparse.kron(
        sparse.eye_array(n_states), np.full((n_actions, n_actions), 1.0 / n_actions)
    )
    any_action = canonical(chosen @ any_action, drop_zeros=True)
    mean = canonical(any_action @ matrix, drop_zeros=False)
    stay = chosen @ sparse.kron(sparse.eye_array(n_states), np.ones((n_actions, 1)))
    reference = (1.0 - ACTION_NOISE) * (chosen @ matrix) + 0.5 * ACTION_NOISE * (
        mean + stay
    )
    pattern = canonical(model.transitions + reference, drop_zeros=True)
    rewards = None
    if simulator.reward_data is not None:
        rewards = np.repeat(simulator.rewards.reshape(-1), np.diff(pattern.indptr))
        reward_sums = any_action @ csr_on_pattern(
            matrix, matrix.data * simulator.reward_data, own=True
        )
        chance = align(mean, pattern)[0]
        np.divide(
            align(canonical(reward_sums, drop_zeros=False), pattern)[0],
            chance,
            out=rewards,
            where=chance > 0.0,
        )
        own, is_defined = align(simulator.transition_rewards, pattern)
        np.copyto(rewards, own, where=is_defined)
    transitions = csr_on_pattern(
        pattern, align(model.transitions, pattern)[0], own=True
    )
    wider = ReweightedModel(
        n_states,
        n_actions,
        transitions,
        model.rewards,
        rewards,
        model.initial,
        model.discount,
        model.terminal_state,
    )
    return wider, align(canonical(reference, drop_zeros=True), pattern)[0]


@njit(cache=True)
def largest_variances(indptr, rows, values, low, high):
    """max Var_p[v] over low <= p <= high, sum p = 1, of each of ``rows`` of a CSR
    pattern (sum low <= 1 <= sum high).

    A best p has what is free above ``low`` at both ends of the sorted values. All of it
    is put at the upper end, and from there, the least value y first, to the lower end,
    the least value x first: d Var / d mass = (y - x) (2 E v - x - y), which changes its
    sign once. The largest variance of v in {0, 1}; with the mass of the 1 at most 0.1;
    in [0.6, 0.7]:

    >>> bounds = np.array([0.0, 0.0, 0.0, 0.0, 0.1, 0.2]), np.array([1.0, 1.0, 1.0, 0.1, 0.4, 0.7])
    >>> largest_variances(np.array([0, 2, 4, 6]), np.arange(3), np.array([0.0, 1.0] * 3), *bounds).round(9)
    array([0.25, 0.09, 0.24])
    """
    result = np.empty(len(rows))
    for k, row in enumerate(rows):
        begin = indptr[row]
        end = indptr[row + 1]
        order = np.argsort(values[begin:end])
        v = values[begin:end][order]
        p = low[begin:end][order]
        room = high[begin:end][order] - p
        moved = np.zeros(len(order))
        free = 1.0 - p.sum()
        upper = len(order)
        lower = 0
        while free > 0.0 and upper > 0:
            upper -= 1
            moved[upper] = min(free, room[upper])
            free -= moved[upper]
        p, room, mean = p + moved, room - moved, np.sum((p + moved) * v)
        gain = 1.0
        while gain > 0.0:
            # what lies on the entry that is being filled may stay
            upper = max(upper, lower + 1)
            if upper == len(order):
                break
            distance = v[upper] - v[lower]
            gain = 2.0 * mean - v[lower] - v[upper]
            mass = min(room[lower], moved[upper])
            # the best split is inside, or has been passed
            if 2.0 * mass * distance >= gain:
                mass = max(gain, 0.0) / max(2.0 * distance, 1e-300)
                gain = 0.0
            p[lower] = p[lower] + mass
            room[lower] = room[lower] - mass
            p[upper] = p[upper] - mass
            room[upper] = room[upper] + mass
            moved[upper] -= mass
            mean -= mass * distance
            lower = lower + (room[lower] <= 0.0)
            upper = upper + (moved[upper] <= 0.0)
        result[k] = np.sum(p * (v - mean) ** 2)
    return result
