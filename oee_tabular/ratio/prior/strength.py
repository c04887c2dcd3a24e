"""How strongly to believe the prior: the Dirichlet strength kappa, chosen on the data.

Each row of the target is a priori Dirichlet(kappa m), m the prior's row (the simulator,
or its tilt). Two criteria, both closed in form and one-dimensional in kappa:

evidence       sum_k [lnG(kappa) - lnG(kappa + n_k)] + sum_x [lnG(kappa m_x + n_x) -
lnG(kappa m_x)]   (Polya [1]) leave-one-out  sum_x n_x log[(n_x - 1 + kappa m_x) / (n_k
- 1 + kappa)]

Rows in which the simulator has the same probabilities (in any order) are alike to it,
and share one kappa: where a prior fits most rows and misses a few (a grid's corners),
one kappa for all would trust it in those few as well. Kinds with fewer than five
recorded rows or a hundred transitions are pooled. kappa is its own diagnosis: the
number of transitions that the prior's row is worth.

Reference: [1] T. P. Minka, Estimating a Dirichlet distribution, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log, log1p
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from oee_tabular.mdp.rows import Rows, distinct_rows
from oee_tabular.typing import Array, IntArray

FAR = 12.0  # from here Stirling's series with four terms errs by less than 1e-13


class Counts(NamedTuple):
    """The recorded rows: their kinds, the ends, counts and prior of their entries with
    counts, and n of each row.
    """

    kind: Any
    ends: Any
    counts: Any
    prior: Any
    n: Any


@njit(cache=True, nogil=True, error_model="numpy")
def log_rising(base, n):
    """ln Gamma(base + n) - ln Gamma(base), for base, n > 0, without the cancellation of
    two large logarithms.

    Both arguments are carried to at least ``FAR`` by Gamma(x + 1) = x Gamma(x); there
    the difference of Stirling's series, (x - 1/2) ln(1 + d/x) + d ln(x + d) - d + s(x +
    d) - s(x).
    """
    x = base
    y = base + n
    gap = n
    if n <= 8.0 and n == int(n):
        product = base
        for i in range(1, int(n)):
            product *= base + i
        return log(product)
    over = 1.0
    under = 1.0
    while x < FAR:
        over *= x
        x += 1.0
        gap -= 1.0
    while y < FAR:
        under *= y
        y += 1.0
        gap += 1.0
    u = 1.0 / (x * x)
    v = 1.0 / (y * y)
    series_x = (1.0 / 12.0 - u * (1.0 / 360.0 - u * (1.0 / 1260.0 - u / 1680.0))) / x
    series_y = (1.0 / 12.0 - v * (1.0 / 360.0 - v * (1.0 / 1260.0 - v / 1680.0))) / y
    return (
        (x - 0.5) * log1p(gap / x)
        + gap * log(y)
        - gap
        + series_y
        - series_x
        + log(over / under)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def score_by_kind(kappa, rows, leave_one_out):
    """The criterion of the rows' counts, summed over each kind, at kappa (kinds,)."""
    score = np.zeros(len(kappa))
    for row in range(len(rows.n)):
        strength = kappa[rows.kind[row]]
        gained = 0.0
        if leave_one_out:
            others = strength + max(rows.n[row] - 1.0, 0.0)
            for x in range(rows.ends[row], rows.ends[row + 1]):
                gained += rows.counts[x] * log(
                    (max(rows.counts[x] - 1.0, 0.0) + strength * rows.prior[x]) / others
                )
        else:
            gained = -log_rising(strength, rows.n[row])
            for x in range(rows.ends[row], rows.ends[row + 1]):
                gained += log_rising(strength * rows.prior[x], rows.counts[x])
        score[rows.kind[row]] += gained
    return score


@njit(cache=True, nogil=True, error_model="numpy")
def maximise_by_kind(grid, rows, n_kinds, leave_one_out, n_halvings):
    """(kinds,) ln kappa and the criterion there, and (grid, kinds) the criterion on the
    grid of ln kappa.

    The best point of the grid; then the better of both sides at half the distance,
    ``n_halvings`` times. Where the criterion is level the largest kappa is taken:
    counts that do not tell leave the prior believed.
    """
    scores = np.empty((len(grid), n_kinds))
    best = np.full(n_kinds, grid[0])
    value = np.full(n_kinds, -np.inf)
    for i in range(len(grid)):
        scores[i] = score_by_kind(np.full(n_kinds, exp(grid[i])), rows, leave_one_out)
        for kind in range(n_kinds):
            if scores[i, kind] >= value[kind] - 1e-13 * (1.0 + abs(value[kind])):
                best[kind] = grid[i]
                value[kind] = max(scores[i, kind], value[kind])
    distance = grid[1] - grid[0]
    for _ in range(n_halvings):
        distance *= 0.5
        centre = best.copy()
        for side in (-1.0, 1.0):
            trial = np.minimum(np.maximum(centre + side * distance, grid[0]), grid[-1])
            new = score_by_kind(np.exp(trial), rows, leave_one_out)
            for kind in range(n_kinds):
                if new[kind] > value[kind]:
                    best[kind] = trial[kind]
                    value[kind] = new[kind]
    return best, value, scores


# at least one move: few moves must not talk the evidence out of a row of the prior
SMALLEST = 1.0
LARGEST = 1e8
FITS = 300.0
FITS_ROUGHLY = 50.0
FEWEST_ROWS = 5
FEWEST_MOVES = 100
CRITERIA = ("evidence", "loo")


@dataclass(frozen=True, eq=False)
class StrengthChoice:
    """kappa of each row, and how it was found.

    Attributes
    ----------
    by_row, by_kind : (rows,) kappa, and that of each kind of rows
    strength : the kappa of the median transition
    score : the criterion at ``by_row`` (nats, all transitions together)
    criterion : "evidence" or "loo"
    grid, curve : the criterion if all rows shared one kappa
    kinds : for each kind of rows its number of recorded rows, of transitions, and its
        kappa
    """

    by_row: Array
    strength: float
    score: float
    criterion: str
    grid: Array
    curve: Array
    kinds: list[tuple[int, int, float]]
    by_kind: Array


def score(
    strength: float | Array,
    observed: Array,
    prior: Array,
    rows: Rows,
    criterion: str = "evidence",
) -> float:
    """A criterion of all rows together, one kappa or one a row."""
    kappa = np.broadcast_to(np.asarray(strength, dtype=np.float64), (len(rows),)).copy()
    counts = _counts(observed, prior, rows, np.arange(len(rows)))
    return float(score_by_kind(kappa, counts, criterion == "loo").sum())


def kinds_of_rows(observed: Array, rows: Rows) -> IntArray:
    """The kind of each row: rows with the same probabilities in any order, kinds with
    few recorded rows pooled.

    Told apart by the number of entries, the largest, and the sums of squares and of
    cubes.
    """
    shape = [
        rows.largest(rows.weights),
        rows.sums(rows.weights**2),
        rows.sums(rows.weights**3),
    ]
    keys = np.column_stack([np.diff(rows.indptr), *np.round(shape, 6)])
    _, kind = distinct_rows(keys)
    n_row = rows.sums(observed)
    size = int(kind.max()) + 1
    few = (np.bincount(kind[n_row > 0], minlength=size) < FEWEST_ROWS) | (
        np.bincount(kind, n_row, size) < FEWEST_MOVES
    )
    return np.asarray(np.where(few[kind], 0, kind + 1), dtype=np.int64)


def choose_strength(
    observed: Array,
    prior: Array,
    rows: Rows,
    criterion: str = "evidence",
    *,
    kind: IntArray | None = None,
    n_halvings: int = 5,
) -> StrengthChoice:
    """For each kind of rows the kappa in [1, 1e8] that maximises the criterion.

    A grid of two a decade, then halvings of its spacing around the best point; five
    find kappa to 2%.
    ``kind``: the rows' kinds where they are known.
    """
    kind = kinds_of_rows(observed, rows) if kind is None else kind
    n_kinds = int(kind.max()) + 1
    grid = np.linspace(np.log(SMALLEST), np.log(LARGEST), 17)
    counts = _counts(observed, prior, rows, kind)
    best, value, scores = maximise_by_kind(
        grid, counts, n_kinds, criterion == "loo", n_halvings
    )
    strength = np.exp(best)
    n_row = rows.sums(observed)
    table = [
        (
            int((n_row[kind == j] > 0).sum()),
            int(n_row[kind == j].sum()),
            float(strength[j]),
        )
        for j in range(n_kinds)
        if (n_row[kind == j] > 0).any()
    ]
    kappa = strength[kind]
    return StrengthChoice(
        by_row=kappa,
        strength=_weighted_median(kappa, n_row),
        score=float(value.sum()),
        criterion=criterion,
        grid=np.exp(grid),
        curve=scores.sum(axis=1),
        kinds=table,
        by_kind=strength,
    )


def _counts(observed: Array, prior: Array, rows: Rows, kind: IntArray) -> Counts:
    """What the loops read, of the rows with counts."""
    n_row = rows.sums(observed)
    seen = observed > 0
    visited = np.flatnonzero(n_row > 0)
    ends = np.concatenate(
        [[0], np.cumsum(rows.sums(seen.astype(np.int64))[visited])]
    ).astype(np.int64)
    return Counts(
        kind[visited].astype(np.int64),
        ends,
        observed[seen],
        prior[seen],
        n_row[visited],
    )


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values, kind="stable")
    running = np.cumsum(weights[order])
    if running[-1] == 0:
        return float(values[order[-1]])
    return float(values[order[np.searchsorted(running, 0.5 * running[-1])]])


def meaning(choice: StrengthChoice, n_row: Array, name: str) -> str:
    """The sentence about the prior that kappa supports."""
    typical = float(np.median(n_row[n_row > 0]))
    strength = choice.strength
    if np.ptp(choice.curve) < 1.0:
        return (
            f"too few transitions to decide whether the {name} fits ({typical:.3g} in"
            " the median recorded row)"
        )
    worth = (
        f"{strength:.3g} transitions" if strength < 1e6 else "any number of transitions"
    )
    compared = (
        f"a row of it is worth {worth}, and the log has {typical:.3g} in the median row"
    )
    if strength >= FITS:
        verdict = f"the {name} fits"
    elif strength >= FITS_ROUGHLY:
        verdict = f"the {name} fits roughly"
    else:
        return f"the {name} does not fit: {compared}"
    misses = sum(rows for rows, _, kappa in choice.kinds if kappa < FITS_ROUGHLY)
    apart = (
        f"; but not in {misses} of {sum(rows for rows, _, _ in choice.kinds)} rows"
        if misses
        else ""
    )
    return f"{verdict}: {compared}{apart}"
