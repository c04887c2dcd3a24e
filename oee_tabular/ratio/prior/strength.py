"""How strongly to believe the prior: the Dirichlet strength kappa, chosen on the data.

Each row of the target is a priori Dirichlet(kappa m), m the prior's row (the simulator, or its tilt). Two criteria, both
closed in form and one-dimensional in kappa:

evidence       sum_k [lnG(kappa) - lnG(kappa + n_k)] + sum_x [lnG(kappa m_x + n_x) - lnG(kappa m_x)]   (Polya [1])
leave-one-out  sum_x n_x log[(n_x - 1 + kappa m_x) / (n_k - 1 + kappa)]

Rows in which the simulator has the same probabilities (in any order) are alike to it, and share one kappa: where a
prior fits most rows and misses a few (a grid's corners), one kappa for all would trust it in those few as well. Kinds with
fewer than five recorded rows or a hundred transitions are pooled. kappa is its own diagnosis: the number of transitions that
the prior's row is worth.

Reference: [1] T. P. Minka, Estimating a Dirichlet distribution, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.mdp.rows import Rows, distinct_rows
from oee_tabular.ratio.prior._strength import Counts, maximise_by_kind, score_by_kind

SMALLEST, LARGEST = 1.0, 1e8  # at least one move: few moves must not talk the evidence out of a row of the prior
FITS, FITS_ROUGHLY = 300.0, 50.0
FEWEST_ROWS, FEWEST_MOVES = 5, 100
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
    kinds : for each kind of rows its number of recorded rows, of transitions, and its kappa
    """

    by_row: Array
    strength: float
    score: float
    criterion: str
    grid: Array
    curve: Array
    kinds: list[tuple[int, int, float]]
    by_kind: Array


def score(strength: float | Array, observed: Array, prior: Array, rows: Rows, criterion: str = "evidence") -> float:
    """A criterion of all rows together, one kappa or one a row."""
    kappa = np.broadcast_to(np.asarray(strength, dtype=np.float64), (len(rows),)).copy()
    counts = _counts(observed, prior, rows, np.arange(len(rows)))
    return float(score_by_kind(kappa, counts, criterion == "loo").sum())


def kinds_of_rows(observed: Array, rows: Rows) -> IntArray:
    """The kind of each row: rows with the same probabilities in any order, kinds with few recorded rows pooled.

    Told apart by the number of entries, the largest, and the sums of squares and of cubes.
    """
    shape = [rows.largest(rows.weights), rows.sums(rows.weights**2), rows.sums(rows.weights**3)]
    keys = np.column_stack([np.diff(rows.indptr), *np.round(shape, 6)])
    _, kind = distinct_rows(keys)
    n_row, size = rows.sums(observed), int(kind.max()) + 1
    few = (np.bincount(kind[n_row > 0], minlength=size) < FEWEST_ROWS) | (np.bincount(kind, n_row, size) < FEWEST_MOVES)
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

    A grid of two a decade, then halvings of its spacing around the best point; five find kappa to 2%.
    ``kind``: the rows' kinds where they are known.
    """
    kind = kinds_of_rows(observed, rows) if kind is None else kind
    n_kinds = int(kind.max()) + 1
    grid = np.linspace(np.log(SMALLEST), np.log(LARGEST), 17)
    counts = _counts(observed, prior, rows, kind)
    best, value, scores = maximise_by_kind(grid, counts, n_kinds, criterion == "loo", n_halvings)
    strength = np.exp(best)
    n_row = rows.sums(observed)
    table = [
        (int((n_row[kind == j] > 0).sum()), int(n_row[kind == j].sum()), float(strength[j]))
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
    n_row, seen = rows.sums(observed), observed > 0
    visited = np.flatnonzero(n_row > 0)
    ends = np.concatenate([[0], np.cumsum(rows.sums(seen.astype(np.int64))[visited])]).astype(np.int64)
    return Counts(kind[visited].astype(np.int64), ends, observed[seen], prior[seen], n_row[visited])


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
        return f"too few transitions to decide whether the {name} fits ({typical:.3g} in the median recorded row)"
    worth = f"{strength:.3g} transitions" if strength < 1e6 else "any number of transitions"
    compared = f"a row of it is worth {worth}, and the log has {typical:.3g} in the median row"
    if strength >= FITS:
        verdict = f"the {name} fits"
    elif strength >= FITS_ROUGHLY:
        verdict = f"the {name} fits roughly"
    else:
        return f"the {name} does not fit: {compared}"
    misses = sum(rows for rows, _, kappa in choice.kinds if kappa < FITS_ROUGHLY)
    apart = f"; but not in {misses} of {sum(rows for rows, _, _ in choice.kinds)} rows" if misses else ""
    return f"{verdict}: {compared}{apart}"
