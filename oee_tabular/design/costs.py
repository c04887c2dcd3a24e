"""Costs of state-action pairs: c_x = Var_{s' ~ P'(.|x)}[G_x(s')], also without spread.

For the difference of two policies' values G_x is the difference of their gradients.

What is plausible in a row where the model has no spread, and its bounds, are stated at
the door of the room (``oee_tabular.design``).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from oee_tabular._compiling import njit
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
from oee_tabular.typing import Array, BoolArray, Csr, IntArray

# the probability, under R, that something else than the action happens: half of it is
# another action, half of it no transition
ACTION_NOISE = 0.1
# a row whose largest probability is at least this is deterministic
MIN_CERTAIN_PROBABILITY = 1.0 - 1e-12
# shares of the largest cost, and of the largest G^2: smaller costs are rounding of 0
COST_TOLERANCES = (1e-24, 1e-28)
# the same share of the largest G^2 of two policies, where G is subtracted: what two
# equal gradients leave is the error of two solved systems
DIFFERENCE_TOLERANCE = 1e-20


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
    minus: Array | None = None,
) -> tuple[Array, BoolArray]:
    """Compute the costs c_x (K, S*A) of the policies, and which rows are optimistic.

    Variances are at ``model``, on the simulator's support, in squared units of J; the
    optimistic rows (S*A,) have the largest plausible variance. ``counts`` (S*A,) are
    the log's. With ``minus`` the costs are those of J(policy) - J(minus). Cost: one
    policy evaluation and one occupancy for each policy, and for ``minus``.
    """
    likeliest = np.maximum.reduceat(
        model.transitions.data, model.transitions.indptr[:-1]
    )
    is_terminal = np.repeat(simulator.closed(), simulator.n_actions)
    is_deterministic = likeliest >= MIN_CERTAIN_PROBABILITY
    certain = is_deterministic & ~is_terminal & optimistic
    if certain.any():
        model, reference = _add_reference_entries(simulator, model, certain)
        low, high = _bounds(model.transitions, reference, box, counts, confidence)
    matrix = model.transitions
    table = np.zeros((len(policies), len(certain)))
    subtracted = None
    if minus is not None:
        subtracted = transition_gradient(model, minus, horizon=horizon)
    for row, policy in zip(table, policies, strict=True):
        gradient = transition_gradient(model, policy, horizon=horizon)
        rounding = COST_TOLERANCES[1] * np.abs(gradient).max() ** 2
        if subtracted is not None:
            largest = max(np.abs(gradient).max(), np.abs(subtracted).max())
            rounding = DIFFERENCE_TOLERANCE * largest**2
            gradient = gradient - subtracted
        row[:] = row_variances(matrix, matrix.data, gradient)
        if certain.any():
            row[certain] = largest_variances(
                matrix.indptr.astype(np.int64),
                np.flatnonzero(certain),
                gradient,
                low,
                high,
            )
        of_cost = COST_TOLERANCES[0] * row.max()
        row[row <= max(of_cost, rounding)] = 0.0
    return table, certain


def _bounds(
    matrix: Csr,
    reference: Array,
    box: Box,
    counts: Array,
    confidence: float,
) -> tuple[Array, Array]:
    """Bound the probability of each entry in the plausible rows.

    The outcome that the model is certain of keeps what its observations assure.
    """
    lengths = np.diff(matrix.indptr)
    sure = matrix.data >= MIN_CERTAIN_PROBABILITY
    low = box.lower * reference
    if np.isfinite(box.upper):
        high = np.minimum(box.upper * reference, 1.0)
    else:
        high = 1.0 * (reference > 0.0)
    number = np.repeat(counts, lengths)[sure]
    # the exact lower bound of a probability after n observations of this outcome alone
    at_least = (1.0 - confidence) ** (1.0 / np.maximum(number, 1.0))
    assured = np.where(number > 0, at_least, 0.0)
    others = row_sums(matrix, np.where(sure, 0.0, low))
    room = 1.0 - np.repeat(others, lengths)[sure]
    low[sure] = np.clip(assured, low[sure], np.minimum(high[sure], room))
    return low, np.asarray(high)


def _add_reference_entries(
    simulator: FiniteMDP, model: Model, certain: BoolArray
) -> tuple[ReweightedModel, Array]:
    """Give the model the entries of R in the rows ``certain``, and return R there.

    Most of these entries are 0, as R is in the other rows. A transition that the
    simulator lacks in a row has its reward under another action, or else the row's
    mean.
    """
    n_states, n_actions = simulator.rewards.shape
    matrix = simulator.transitions
    chosen = sparse.diags_array(certain.astype(np.float64))
    every_action = sparse.kron(
        sparse.eye_array(n_states), np.full((n_actions, n_actions), 1.0 / n_actions)
    )
    any_action = canonical(chosen @ every_action, drop_zeros=True)
    mean = canonical(any_action @ matrix, drop_zeros=False)
    stay = chosen @ sparse.kron(sparse.eye_array(n_states), np.ones((n_actions, 1)))
    own = (1.0 - ACTION_NOISE) * (chosen @ matrix)
    reference = own + 0.5 * ACTION_NOISE * (mean + stay)
    pattern = canonical(model.transitions + reference, drop_zeros=True)
    rewards = _reference_rewards(simulator, any_action, mean, pattern)
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


def _reference_rewards(
    simulator: FiniteMDP, any_action: Csr, mean: Csr, pattern: Csr
) -> Array | None:
    """Return the reward of each entry of ``pattern``; None if rewards are r(s, a).

    ``any_action`` (S*A, S*A) takes each action of the state equally often, and ``mean``
    are the transitions of that.
    """
    given = simulator.transition_rewards
    if simulator.reward_data is None or given is None:
        return None
    matrix = simulator.transitions
    rewards = np.repeat(simulator.rewards.reshape(-1), np.diff(pattern.indptr))
    paid = csr_on_pattern(matrix, matrix.data * simulator.reward_data, own=True)
    reward_sums = canonical(any_action @ paid, drop_zeros=False)
    chance = align(mean, pattern)[0]
    np.divide(align(reward_sums, pattern)[0], chance, out=rewards, where=chance > 0.0)
    own, is_defined = align(given, pattern)
    np.copyto(rewards, own, where=is_defined)
    return rewards


def largest_variances(
    indptr: IntArray, rows: IntArray, values: Array, low: Array, high: Array
) -> Array:
    """Compute max Var_p[v] over low <= p <= high, sum p = 1, in rows of a CSR pattern.

    Every row needs sum low <= 1 <= sum high.

    The largest variance of v in {0, 1}, with any mass on the 1, with a mass of at most
    0.1, and with one in [0.6, 0.7]:

    >>> bounds = (
    ...     np.array([0.0, 0.0, 0.0, 0.0, 0.1, 0.2]),
    ...     np.array([1.0, 1.0, 1.0, 0.1, 0.4, 0.7]),
    ... )
    >>> largest_variances(
    ...     np.array([0, 2, 4, 6]), np.arange(3), np.array([0.0, 1.0] * 3), *bounds
    ... ).round(9)
    array([0.25, 0.09, 0.24])
    """
    lengths = np.diff(indptr)[rows]
    ends = np.concatenate([[0], np.cumsum(lengths)])
    entries = np.arange(ends[-1]) + np.repeat(indptr[rows] - ends[:-1], lengths)
    # each row's entries by their values
    place = np.repeat(np.arange(len(rows)), lengths)
    order = entries[np.lexsort((values[entries], place))]
    p = low[order]
    result = np.empty(len(rows))
    fill_variances(ends, values[order], p, high[order] - p, np.zeros(len(p)), result)
    return result


@njit(cache=True, error_model="numpy")
def fill_variances(ends, v, p, room, moved, result):
    """Fill the largest variance of each row ends[k]:ends[k + 1], in which v increases.

    d Var / d mass = (y - x) (2 E v - x - y) for mass that goes from value y to value x.

    A best p has what is free above its least at both ends of the sorted values. All of
    it is put at the upper end, and from there, the least value y first, to the lower
    end, the least value x first; the derivative changes its sign once. ``p`` are the
    least probabilities, ``room`` is what may be added, and ``moved`` is 0.
    """
    for k in range(len(result)):
        begin = ends[k]
        end = ends[k + 1]
        free = 1.0
        for x in range(begin, end):
            free -= p[x]
        upper = end
        lower = begin
        # all free mass goes to the largest values
        while free > 0.0 and upper > begin:
            upper -= 1
            mass = free if free < room[upper] else room[upper]
            moved[upper] = mass
            p[upper] += mass
            room[upper] -= mass
            free -= mass
        mean = 0.0
        for x in range(begin, end):
            mean += p[x] * v[x]
        gain = 1.0
        # and from the least of these to the smallest, while that raises the variance
        while gain > 0.0:
            # mass on the entry that is being filled may stay
            if upper <= lower:
                upper = lower + 1
            if upper >= end:
                break
            distance = v[upper] - v[lower]
            gain = 2.0 * mean - v[lower] - v[upper]
            mass = moved[upper] if moved[upper] < room[lower] else room[lower]
            # the best split is inside, or has been passed
            if 2.0 * mass * distance >= gain:
                mass = 0.0
                if gain > 0.0:
                    size = 2.0 * distance
                    mass = gain / (size if size > 1e-300 else 1e-300)
                gain = 0.0
            p[lower] += mass
            room[lower] -= mass
            p[upper] -= mass
            room[upper] += mass
            moved[upper] -= mass
            mean -= mass * distance
            if room[lower] <= 0.0:
                lower += 1
            if moved[upper] <= 0.0:
                upper += 1
        variance = 0.0
        for x in range(begin, end):
            variance += p[x] * (v[x] - mean) * (v[x] - mean)
        result[k] = variance
