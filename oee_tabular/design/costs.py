"""Costs of the state-action pairs: c_x = Var_{s' ~ P'(.|x)}[G_x(s')], and what is assumed where the model has no spread.

The set of plausible rows, and its bounds, are stated at the door of the room (``oee_tabular.design``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import align, canonical, csr_on_pattern, row_variances
from oee_tabular.exact import Model, ReweightedModel, transition_gradient
from oee_tabular.mdp import FiniteMDP
from oee_tabular.ratio.arguments import Box

ACTION_NOISE = 0.1  # of R: half of it another action, half of it no transition
CERTAIN = 1.0 - 1e-12  # a row whose largest probability is above this has no spread
N_ROWS_AT_A_TIME = 1 << 16  # the table of all 4 000 000 rows of a deterministic grid takes 1 GB
N_BISECTIONS = 60  # the spread of the values over 2^60: rounding
ROUNDING = (1e-24, 1e-28)  # of the largest cost, and of the largest G^2: costs below are the rounding of 0


@dataclass(frozen=True, eq=False)
class Costs:
    """``table`` (K, S*A) c_x of each policy, squared units of J; ``optimistic`` (S*A,) rows where it is a worst case."""

    table: Array
    optimistic: BoolArray


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
) -> Costs:
    """Compute c_x of each policy at ``model`` (on the simulator's support), with the log's ``counts`` (S*A,) of the rows.

    Cost: one policy evaluation and one occupancy a policy, and O(rows * 60) for the rows without spread.
    """
    largest = np.maximum.reduceat(model.transitions.data, model.transitions.indptr[:-1])
    is_terminal = np.repeat(simulator.closed(), simulator.n_actions)
    certain = (largest >= CERTAIN) & ~is_terminal & optimistic
    rows = np.flatnonzero(certain)
    if rows.size:
        model, reference = _add_reference_entries(simulator, model, rows)
    probability = model.transitions.data
    table = np.zeros((len(policies), len(certain)))
    for k, policy in enumerate(policies):
        gradient = transition_gradient(model, policy, horizon=horizon)
        table[k] = row_variances(model.transitions, probability, gradient)
        for start in range(0, len(rows), N_ROWS_AT_A_TIME):
            part = rows[start : start + N_ROWS_AT_A_TIME]
            entries, inside = _entries_of(model.transitions, part)
            weights, sure = (np.where(inside, x[entries], 0.0) for x in (reference, probability))
            low, high = _bounds(weights, sure, box, counts[part], confidence)
            values = np.where(inside, gradient[entries], gradient[entries[:, :1]])
            table[k, part] = largest_variance(values, low, high)
        rounding = max(ROUNDING[0] * table[k].max(initial=0.0), ROUNDING[1] * np.abs(gradient).max(initial=0.0) ** 2)
        table[k, table[k] <= rounding] = 0.0
    return Costs(table, certain)


def largest_variance(values: Array, low: Array, high: Array) -> Array:
    """Compute max Var_P[v] over low <= P <= high, sum P = 1, for each row of (R, W) arrays (sum low <= 1 <= sum high).

    Equal to min_c max_P E_P (v - c)^2 (linear in P, convex in c): for a given c the mass goes first where |v - c| is
    largest, and c is bisected for E_P v = c. Where nothing binds, half the mass goes to each end of the values. The
    largest variance of v in {0, 1}, and with the mass of the 1 at most 0.1:

    >>> largest_variance(np.array([[0.0, 1.0], [0.0, 1.0]]), np.zeros((2, 2)), np.array([[1.0, 1.0], [1.0, 0.1]])).round(9)
    array([0.25, 0.09])
    """
    ends = values.min(axis=1), values.max(axis=1)
    result = (0.5 * (ends[1] - ends[0])) ** 2
    is_free = low.max(axis=1, initial=0.0) <= 0.0
    for end in ends:
        is_free &= np.any((values == end[:, None]) & (high >= 1.0), axis=1)
    v, low, high = (array[~is_free] for array in (values, low, high))
    left, right = (end[~is_free] for end in ends)
    slack, free_mass = high - low, 1.0 - low.sum(axis=1, keepdims=True)
    for _ in range(N_BISECTIONS if len(v) else 0):
        center = 0.5 * (left + right)
        distance = np.abs(v - center[:, None])
        order = np.argsort(-distance, axis=1, kind="stable")
        room = np.take_along_axis(slack, order, axis=1)
        added = np.clip(free_mass - (np.cumsum(room, axis=1) - room), 0.0, room)
        p = np.array(low)
        np.put_along_axis(p, order, np.take_along_axis(low, order, axis=1) + added, axis=1)
        is_above = np.sum(p * v, axis=1) > center
        left, right = np.where(is_above, center, left), np.where(is_above, right, center)
        result[~is_free] = np.sum(p * distance**2, axis=1)
    return np.asarray(result)


def _bounds(reference: Array, probability: Array, box: Box, counts: Array, confidence: float) -> tuple[Array, Array]:
    """Bound each row's entries, (R, W); the outcome that the model is sure of keeps what its observations assure."""
    low = box.lower * reference
    high = np.minimum(box.upper * reference, 1.0) if np.isfinite(box.upper) else 1.0 * (reference > 0.0)
    is_sure = probability >= CERTAIN
    assured = np.where(counts > 0, (1.0 - confidence) ** (1.0 / np.maximum(counts, 1.0)), 0.0)[:, None]
    room = 1.0 - np.where(is_sure, 0.0, low).sum(axis=1, keepdims=True)
    return np.where(is_sure, np.clip(assured, low, np.minimum(high, room)), low), np.asarray(high)


def _entries_of(matrix: sparse.csr_array, rows: IntArray) -> tuple[IntArray, BoolArray]:
    """Positions (R, W) of the entries of ``rows``, and which of them are there (rows are of unequal length)."""
    start = matrix.indptr[rows].astype(np.int64)
    length = matrix.indptr[rows + 1] - start
    offset = np.arange(int(length.max(initial=1)))
    inside = offset < length[:, None]
    return start[:, None] + np.where(inside, offset, 0), inside


def _add_reference_entries(simulator: FiniteMDP, model: Model, rows: IntArray) -> tuple[ReweightedModel, Array]:
    """Give the model the entries of R in these rows, most of them 0, and return R there (0 in the other rows).

    A transition that the simulator does not make in this row pays what it pays under another action, or else the row's
    mean.
    """
    n_actions, matrix = simulator.n_actions, simulator.transitions
    states = rows // n_actions

    def matrix_of(weight: float, columns: IntArray, length: int, n_columns: int) -> sparse.csr_array:
        """Each of ``rows`` has ``length`` entries ``weight``; the others are empty."""
        lengths = np.zeros(matrix.shape[0], dtype=np.int64)
        lengths[rows] = length
        parts = np.full(columns.size, weight), columns.reshape(-1), np.append(0, np.cumsum(lengths))
        return sparse.csr_array(parts, (matrix.shape[0], n_columns))

    all_actions = states[:, None] * n_actions + np.arange(n_actions)
    same_state = matrix_of(1.0 / n_actions, all_actions, n_actions, matrix.shape[0])
    mean = canonical(same_state @ matrix, drop_zeros=False)
    reference = canonical(
        (1.0 - ACTION_NOISE) * matrix_of(1.0, rows, 1, matrix.shape[0]) @ matrix
        + 0.5 * ACTION_NOISE * (mean + matrix_of(1.0, states, 1, matrix.shape[1])),
        drop_zeros=True,
    )
    pattern = canonical(_ones(model.transitions) + _ones(reference), drop_zeros=False)
    weights = align(reference, pattern)[0]
    del reference  # of many such rows each is as large as the simulator
    rewards = None if simulator.reward_data is None else _rewards_on(pattern, simulator, same_state, mean)
    del same_state, mean
    transitions = csr_on_pattern(pattern, align(model.transitions, pattern)[0], own=True)
    wider = ReweightedModel(
        model.n_states, n_actions, transitions, model.rewards, rewards, model.initial, model.discount, model.terminal_state
    )  # fmt: skip
    return wider, weights


def _rewards_on(
    pattern: sparse.csr_array, simulator: FiniteMDP, same_state: sparse.csr_array, mean: sparse.csr_array
) -> Array:
    """r(s, a, s') on the entries of ``pattern``: the row's own, or the mean over the state's actions, or the row's mean."""
    rewards = np.repeat(simulator.rewards.reshape(-1), np.diff(pattern.indptr))
    paid = same_state @ csr_on_pattern(
        simulator.transitions, simulator.transitions.data * simulator.reward_data, own=True
    )
    chance = align(mean, pattern)[0]
    np.divide(align(canonical(paid, drop_zeros=False), pattern)[0], chance, out=rewards, where=chance > 0)
    own, is_defined = align(simulator.transition_rewards, pattern)
    np.copyto(rewards, own, where=is_defined)
    return rewards


def _ones(matrix: sparse.csr_array) -> sparse.csr_array:
    """1 at each entry."""
    return sparse.csr_array((np.ones(matrix.nnz), matrix.indices, matrix.indptr), matrix.shape)
