"""Changes of single rows without data, by which an ascent leaves a local end of a gain.

J of one policy is monotone along a change of one row, and no ascent of it stops short
of a better row. A gain sum_k sign_k J(pi_k) is not: the row P_x of a pair x = (s, a)
that moves by t delta changes it by

    sum_k sign_k t d_k(s) pi_k(a | s) delta (r + gamma V_k)
                 / (1 - t gamma pi_k(a | s) delta M_k(., s)),

M_k = (I - gamma P_k)^-1 (Sherman and Morrison). So a change that is bad at first may be
good in the end. All changes towards one next state as much as the box allows are
valued by this formula, and the best of them is made, as long as one is better. With a
horizon, where there is no such formula, they are evaluated one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from oee_tabular.inference.robust import greedy_row
from oee_tabular.typing import Array, IntArray

if TYPE_CHECKING:
    from oee_tabular.inference.profile_ascent import PolicyRows

SHARES = (1.0, 0.75, 0.5, 0.25)  # of a row's way to another one that are tried
MAX_CHANGES = 100  # of rows, in one search
# of the distance from the reference: what a change must add
LEAST_GAIN = 1e-7
# entries times steps times changes that are evaluated one by one
MAX_WORK = 2 * 10**6


class Moves(NamedTuple):
    """Other distributions of rows, one after another.

    Move k is to ``p[indptr[k]:indptr[k + 1]]`` on the ``entries`` there, all of one row.
    """

    entries: IntArray
    indptr: IntArray
    p: Array

    def sums(self, values: Array) -> Array:
        """Sum the entries of each move."""
        return np.asarray(np.add.reduceat(values, self.indptr[:-1]))


def find_moves(rows: PolicyRows, x: Array) -> Moves:
    """Return a move of each entry without data: as much as possible to its next state.

    What the box leaves goes to the others in the order of ``x``.
    """
    own = rows.without_data
    starts = rows.indptr[rows.row_without_data]
    lengths = np.diff(rows.indptr)[rows.row_without_data]
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    within = np.arange(indptr[-1]) - np.repeat(indptr[:-1], lengths)
    entries = np.repeat(starts, lengths) + within
    if rows.takes_one:
        return Moves(
            entries, indptr, (entries == np.repeat(own, lengths)).astype(float)
        )
    low, high = rows.low[entries], rows.high[entries]
    key = np.where(entries == np.repeat(own, lengths), np.inf, x[entries])
    move = np.repeat(np.arange(len(own)), lengths)
    order = np.lexsort((-key, move))
    p = np.zeros(len(entries))
    for start, stop in zip(indptr[:-1], indptr[1:], strict=True):
        greedy_row(order, low, high, start, stop, p)
    return Moves(entries, indptr, p)


def change_rows(
    rows: PolicyRows,
    p: Array,
    sign: float,
    slope: Array,
    distance: float,
    evaluate: Callable[[Array], float],
) -> tuple[Array, float]:
    """Change single rows without data as long as the end moves outwards.

    ``slope`` is the gradient at ``p``, ``distance`` that of the end from the reference,
    and ``evaluate`` returns the gain of rows. The rows are returned with by how much
    they are better.
    """
    total = 0.0
    if not len(rows.without_data):
        return p, total
    value_all = value_by_steps if rows.n_steps else value_moves
    for _ in range(MAX_CHANGES):
        moves = find_moves(rows, sign * slope)
        gains = sign * value_all(rows, p, moves, evaluate)
        share, move = np.unravel_index(int(np.argmax(gains)), gains.shape)
        gain = float(gains[share, move])
        if not gain > LEAST_GAIN * (distance + total):
            break
        chosen = slice(moves.indptr[move], moves.indptr[move + 1])
        entries = moves.entries[chosen]
        p = p.copy()
        p[entries] += SHARES[share] * (moves.p[chosen] - p[entries])
        total += gain
    return p, total


def value_moves(
    rows: PolicyRows, p: Array, moves: Moves, _: Callable[[Array], float]
) -> Array:
    """Return by how much each share of each move changes the gain, exactly."""
    n = len(rows.initial)
    change = moves.p - p[moves.entries]
    column = rows.column[moves.entries]
    first = moves.entries[moves.indptr[:-1]]
    state = rows.state[first]
    gains = np.zeros((len(SHARES), len(first)))
    shares = np.array(SHARES)[:, None]
    for part in rows.parts:
        kept = part.weight * p
        between = np.bincount(rows.cell, kept, n * n).reshape(n, n)
        inverse = np.linalg.inv(rows.identity - rows.discount * between)
        values = inverse @ np.bincount(rows.state, kept * rows.pay, n)
        visits = rows.initial @ inverse
        weight = part.weight[first]
        ahead = rows.pay[moves.entries] + rows.discount * values[column]
        slope = visits[state] * weight * moves.sums(change * ahead)
        back = np.repeat(state, np.diff(moves.indptr))
        returned = moves.sums(change * inverse[column, back])
        again = rows.discount * weight * returned
        gains += part.sign * shares * slope / (1.0 - shares * again)
    return gains


def value_by_steps(
    rows: PolicyRows, p: Array, moves: Moves, evaluate: Callable[[Array], float]
) -> Array:
    """Return the same with a horizon, where each change is evaluated by itself.

    In problems where this takes long nothing is found.
    """
    number = len(moves.indptr) - 1
    gains = np.full((len(SHARES), number), -np.inf)
    if number * len(SHARES) * len(p) * rows.n_steps > MAX_WORK:
        return np.zeros_like(gains)
    before = evaluate(p)
    for k in range(number):
        chosen = slice(moves.indptr[k], moves.indptr[k + 1])
        entries = moves.entries[chosen]
        for i, share in enumerate(SHARES):
            trial = p.copy()
            trial[entries] += share * (moves.p[chosen] - p[entries])
            gains[i, k] = evaluate(trial) - before
    return gains
