"""What each (s, a) costs: how much one observation of it is worth for a policy's value.

    c_x = Var_{s' ~ P'(.|x)}[G_x(s')],  G_x(s') = dJ / dP'(s' | x),

the terms of the asymptotic variance sum_x c_x / n_x of J from n_x observations of each row x = (s, a), at a model P'. A
row that P' makes deterministic has c_x = 0, which would leave the model's claim for ever untested. Its cost is *optimistic*
instead, the largest variance that is still plausible: max Var_P[G_x] over

    lower_ratio R <= P <= upper_ratio R,  R(.|s, a) = 0.9 P(.|s, a) + 0.05 mean_b P(.|s, b) + 0.05 1{s' = s},

P the simulator: something like another action is carried out, or nothing happens. Without a box, any distribution on the
support of R, and the largest variance is (range of G_x / 2)^2. In a row with n_x observations, all of them the one outcome,
that outcome has moreover a probability of at least (1 - confidence)^(1 / n_x), the exact (Clopper-Pearson) bound. States that
no action leaves have nothing to tell and cost 0.

``next_pairs`` and ``sentence`` make the one piece of advice of them, which (s, a) to record next: a plan, a report and its page
give the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular._sparse import align, canonical, csr_on_pattern, row_sums, row_variances
from oee_tabular.estimators import Problem
from oee_tabular.exact import Model, ReweightedModel, reweight, transition_gradient
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.naming import Names
from oee_tabular.ratio import Conditional
from oee_tabular.ratio.arguments import Box

ACTION_NOISE = 0.1  # of R: half of it another action, half of it no move
_SURE = 1.0 - 1e-12  # a row whose largest probability is above this has no spread
_SOME = 1 << 16  # rows at a time: a table of all 4 000 000 of a deterministic grid takes 1 GB
_ROUNDING = 1e-24  # of the largest cost, and 1e-28 of what the largest may be: less is the rounding of 0


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
    """c_x of each policy at ``model`` (moves inside the simulator's support), with the log's ``counts`` (S*A,) of the rows.

    Cost: one policy evaluation and one occupancy a policy, and O(rows * 60) for the rows without spread.
    """
    alone = np.maximum.reduceat(model.transitions.data, model.transitions.indptr[:-1]) >= _SURE
    alone &= ~np.repeat(simulator.closed(), simulator.n_actions)
    if not optimistic:
        alone[:] = False
    rows = np.flatnonzero(alone)
    if rows.size:
        model, weights = _on_reference(simulator, model, rows)
    indptr, probability = model.transitions.indptr.astype(np.int64), model.transitions.data
    table = np.zeros((len(policies), len(alone)))
    for k, policy in enumerate(policies):
        gradient = transition_gradient(model, policy, horizon=horizon)
        table[k] = row_variances(model.transitions, probability, gradient)
        for some in np.split(rows, range(_SOME, len(rows), _SOME)) if rows.size else ():
            place, inside = _table_of(indptr, some)
            weight, model_row = (np.where(inside, x[place], 0.0) for x in (weights, probability))
            values = np.where(inside, gradient[place], gradient[place[:, :1]])
            ends = _box_around(weight, model_row, box, counts[some], confidence)
            table[k, some] = largest_variance(values, *ends)
        largest = max(_ROUNDING * table[k].max(initial=0.0), 1e-28 * np.abs(gradient).max(initial=0.0) ** 2)
        table[k, table[k] <= largest] = 0.0
    return Costs(table, alone)


def largest_variance(values: Array, low: Array, high: Array) -> Array:
    """max Var_P[v] over low <= P <= high, sum P = 1, for each row of (R, W) arrays (sum low <= 1 <= sum high).

    min_c max_P E_P (v - c)^2, the two exchanged (linear in P, convex in c): for a given c the mass goes first where |v - c| is
    largest, and c is bisected for E_P v = c. The largest variance of v in {0, 1}, and with the mass of the 1 at most 0.1:

    >>> largest_variance(np.array([[0.0, 1.0], [0.0, 1.0]]), np.zeros((2, 2)), np.array([[1.0, 1.0], [1.0, 0.1]])).round(9)
    array([0.25, 0.09])
    """
    left, right = values.min(axis=1), values.max(axis=1)
    found = (0.5 * (right - left)) ** 2  # half the mass at each end, where nothing bounds it
    ends = [np.any((values == end[:, None]) & (high >= 1.0), axis=1) for end in (left, right)]
    bound = np.flatnonzero(~(ends[0] & ends[1] & (low.max(axis=1, initial=0.0) <= 0.0)))
    if bound.size:
        found[bound] = _bisected(values[bound], low[bound], high[bound])
    return np.asarray(found)


def _bisected(values: Array, low: Array, high: Array) -> Array:
    """The same where bounds bind."""
    left, right = values.min(axis=1), values.max(axis=1)
    slack, free = high - low, 1.0 - low.sum(axis=1, keepdims=True)
    for _ in range(60):
        center = 0.5 * (left + right)
        far = np.abs(values - center[:, None])
        order = np.argsort(-far, axis=1, kind="stable")
        room = np.take_along_axis(slack, order, axis=1)
        given = np.clip(free - (np.cumsum(room, axis=1) - room), 0.0, room)
        p = np.array(low)
        np.put_along_axis(p, order, np.take_along_axis(low, order, axis=1) + given, axis=1)
        above = np.sum(p * values, axis=1) > center
        left, right = np.where(above, center, left), np.where(above, right, center)
    return np.asarray(np.sum(p * far**2, axis=1))


def _on_reference(simulator: FiniteMDP, model: Model, rows: IntArray) -> tuple[ReweightedModel, Array]:
    """The model with the entries of R in these rows, most of them 0; and R there, 0 in the other rows.

    A move that the simulator does not make in this row pays what it pays under another action, or else the row's mean.
    """
    n_actions, states, matrix = simulator.n_actions, rows // simulator.n_actions, simulator.transitions
    some = (states[:, None] * n_actions + np.arange(n_actions)).reshape(-1)
    parts = np.full(len(some), 1.0 / n_actions), some, np.arange(0, len(some) + 1, n_actions)
    among = sparse.csr_array(parts, (len(rows), matrix.shape[0]))
    onto = sparse.csr_array((np.ones(len(rows)), (rows, np.arange(len(rows)))), (matrix.shape[0], len(rows)))
    mean = sparse.csr_array(among @ matrix)  # over the actions of each row's state
    stay = sparse.csr_array((np.ones(len(rows)), (np.arange(len(rows)), states)), mean.shape)
    half = 0.5 * ACTION_NOISE
    mixed = (1.0 - ACTION_NOISE) * matrix[rows] + half * mean + half * stay
    reference = canonical(onto @ sparse.csr_array(mixed), drop_zeros=True)
    del mixed, stay  # of many such rows each is as large as the simulator
    pattern = canonical(_ones(model.transitions) + _ones(reference), drop_zeros=False)
    weights = align(reference, pattern)[0]
    del reference
    rewards = None
    if simulator.reward_data is not None:
        made = align(canonical(onto @ mean, drop_zeros=False), pattern)[0]
        del mean
        flow = among @ csr_on_pattern(matrix, matrix.data * simulator.reward_data, own=True)
        paid = align(canonical(onto @ flow, drop_zeros=False), pattern)[0]
        rewards = np.repeat(simulator.rewards.reshape(-1), np.diff(pattern.indptr))
        np.divide(paid, made, out=rewards, where=made > 0)
        del flow, paid, made
        own, defined = align(simulator.transition_rewards, pattern)
        np.copyto(rewards, own, where=defined)
        del own
    padded = ReweightedModel(
        model.n_states, n_actions, csr_on_pattern(pattern, align(model.transitions, pattern)[0], own=True), model.rewards,
        rewards, model.initial, model.discount, model.terminal_state,
    )  # fmt: skip
    return padded, weights


def _ones(matrix: sparse.csr_array) -> sparse.csr_array:
    """1 at each entry."""
    return sparse.csr_array((np.ones(matrix.nnz), matrix.indices, matrix.indptr), matrix.shape)


def _table_of(indptr: Any, rows: Any) -> tuple[Any, BoolArray]:
    """(R, W) positions of the entries of ``rows``, and which of them are there (rows are of unequal length)."""
    lengths = indptr[rows + 1] - indptr[rows]
    offset = np.arange(int(lengths.max(initial=1)))
    inside = offset < lengths[:, None]
    return np.where(inside, indptr[rows][:, None] + offset, indptr[rows][:, None]), inside


def _box_around(
    reference: Array, probability: Array, box: Box, counts: Array, confidence: float
) -> tuple[Array, Array]:
    """The bounds of each row's entries, (R, W); the outcome that the model is sure of keeps what its observations assure."""
    low = box.lower * reference
    high = np.minimum(box.upper * reference, 1.0) if np.isfinite(box.upper) else np.where(reference > 0.0, 1.0, 0.0)
    seen = probability >= _SURE
    assured = np.where(counts > 0, (1.0 - confidence) ** (1.0 / np.maximum(counts, 1.0)), 0.0)[:, None]
    room = 1.0 - np.where(seen, 0.0, low).sum(axis=1, keepdims=True)
    return np.where(seen, np.clip(assured, low, np.minimum(high, room)), low), high


NOTHING = "More moves would not narrow it."


def next_pairs(
    table: Array, counts: Array, n_actions: int, number: int, confidence: float
) -> tuple[tuple[int, int], ...]:
    """The first ``number`` rows, as (s, a), that take most off the widths of the policies' intervals, one move after another.

    ``table`` (K, S*A) costs c of each policy, ``counts`` (S*A,) n. Off a width 2 z se, se^2 = sum c / n, a move of a recorded
    row takes z c / (n (n + 1)) / se; of a row never recorded 2 z sqrt(c), all that one move of it leaves. None that costs 0.
    """
    z, n, chosen = NormalDist().inv_cdf(0.5 + confidence / 2.0), np.array(counts, dtype=np.float64), []
    never = np.sum(2.0 * z * np.sqrt(table), axis=0)
    for _ in range(number if np.any(table > 0.0) else 0):
        variance = table / np.maximum(n, 1.0) * (n > 0)
        error = np.sqrt(variance.sum(axis=1, keepdims=True))
        fall = np.divide(z * variance, error, out=np.zeros_like(table), where=error > 0.0).sum(axis=0) / (n + 1.0)
        row = int(np.argmax(np.where(n > 0, fall, never)))
        n[row] += 1.0
        chosen.append(divmod(row, n_actions))
    return tuple(chosen)


def sentence(
    pairs: tuple[tuple[int, int], ...], table: Array, counts: Array, optimistic: BoolArray, names: Names
) -> str:
    """The first of the pairs, and why; ``table`` (K, S, A), ``counts`` and ``optimistic`` (S, A)."""
    if not pairs:
        return NOTHING
    state, action = pairs[0]
    n, why = counts[state, action], "never recorded"
    if optimistic[state, action]:
        why = f"{_so_far(n)}; the model holds its outcome for certain"
    elif n > 0:
        variance = table / np.maximum(counts, 1.0)
        total = variance.sum(axis=(1, 2))
        share = np.divide(variance[:, state, action], total, out=np.zeros_like(total), where=total > 0.0).mean()
        why = f"{_so_far(n)}, {share:.0%} of the variance"
    where = f"action {_set_off(names.action(action))} in state {_set_off(names.state(state))}"
    return f"What would help most: moves of {where} ({why})."


def _so_far(n: float) -> str:
    return f"{n:.4g} {'move' if n == 1 else 'moves'} so far"


def _set_off(name: str) -> str:
    """A name of several words in quotation marks, so that one sees where it ends; coordinates have their brackets."""
    return f"“{name}”" if " " in name and not name.startswith("(") else name


def advice(problem: Problem, policies: Mapping[str, Array], confidence: float) -> str:
    """The sentence for a problem: that of ``plan_data_collection`` with the same log, policies and confidence.

    Cost: one ratio, and an evaluation and an occupancy a policy.
    """
    mdp = problem.model
    shape = (mdp.n_states, mdp.n_actions)
    counts = row_sums(problem.counts)
    model = reweight(mdp, Conditional().fit(problem.observed, problem.simulator, made=problem.made))
    costs = row_costs(
        mdp, model, list(policies.values()), counts, horizon=problem.horizon, box=Box(0.0, np.inf), confidence=confidence,
        optimistic=True,
    )  # fmt: skip
    pairs = next_pairs(costs.table, counts, shape[1], 1, confidence)
    table, optimistic = costs.table.reshape(-1, *shape), costs.optimistic.reshape(shape)
    return sentence(pairs, table, counts.reshape(shape), optimistic, mdp.names)
