"""How strongly to believe the prior: the Dirichlet strength kappa, chosen on the data.

Each row of the target is a priori Dirichlet(kappa m), m the prior's row (the simulator, or its tilt). Two criteria, both
closed in form and one-dimensional in kappa:

evidence       sum_k [lnG(kappa) - lnG(kappa + n_k)] + sum_x [lnG(kappa m_x + n_x) - lnG(kappa m_x)]   (Polya [1])
leave-one-out  sum_x n_x log[(n_x - 1 + kappa m_x) / (n_k - 1 + kappa)]

Rows in which the simulator has the same probabilities (in any order) are alike to it, and share one kappa: where a
prior fits most rows and misses a few (a grid's corners), one kappa for all would trust it in those few as well. Kinds with
fewer than five visited rows or a hundred moves are pooled. kappa is its own diagnosis: the number of moves that the
prior's row is worth.

Reference: [1] T. P. Minka, Estimating a Dirichlet distribution, 2000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio.prior import _strength as kernel
from oee_tabular.ratio.segments import segment_sums, spread

SMALLEST, LARGEST = (
    1.0,
    1e8,
)  # a row of the prior is worth at least one move: few moves must not talk the evidence out of it
FITS, FITS_ROUGHLY = 300.0, 50.0
CRITERIA = ("evidence", "loo")


FEWEST_ROWS, FEWEST_MOVES = 5, 100


@dataclass(frozen=True, eq=False)
class StrengthChoice:
    """kappa of each row, and how it was found.

    Attributes
    ----------
    by_row : (rows,) kappa
    strength : the kappa of the median move
    score : the criterion at ``by_row`` (nats, all moves together)
    criterion : "evidence" or "loo"
    grid, curve : the criterion if all rows shared one kappa
    kinds : for each kind of rows its number of visited rows, of moves, and its kappa
    """

    by_row: Array
    strength: float
    score: float
    criterion: str
    grid: Array
    curve: Array
    kinds: list[tuple[int, int, float]]


def log_rising(base: Array, n: Array) -> Array:
    """ln Gamma(base + n) - ln Gamma(base) for n > 0, without the cancellation of two large logarithms."""
    pairs = zip(np.ravel(base).tolist(), np.ravel(n).tolist(), strict=True)
    return np.array([kernel.log_rising(b, k) for b, k in pairs]).reshape(np.shape(base))


def evidence(strength: float | Array, observed: Array, prior: Array, indptr: IntArray) -> float:
    """Log marginal likelihood of the counts, one kappa or one a row."""
    n_rows = len(indptr) - 1
    each = np.arange(n_rows)
    kappa = np.broadcast_to(np.asarray(strength, dtype=np.float64), (n_rows,)).copy()
    return float(_criterion(observed, prior, indptr, each, n_rows, "evidence")(kappa).sum())


def leave_one_out(strength: float | Array, observed: Array, prior: Array, indptr: IntArray) -> float:
    """Log predictive probability of each move, given all the others."""
    return float(_leave_one_out_by_row(strength, observed, prior, indptr).sum())


def _leave_one_out_by_row(strength: float | Array, observed: Array, prior: Array, indptr: IntArray) -> Array:
    n_row = segment_sums(observed, indptr)
    kappa = spread(np.broadcast_to(strength, n_row.shape), indptr)
    seen = observed > 0
    n, total, k = observed[seen], spread(n_row, indptr)[seen], kappa[seen]
    gained = np.zeros(len(observed))
    predicted = (np.maximum(n - 1.0, 0.0) + k * prior[seen]) / (np.maximum(total - 1.0, 0.0) + k)
    gained[seen] = n * np.log(predicted)
    return segment_sums(gained, indptr)


def kinds_of_rows(weights: Array, observed: Array, indptr: IntArray) -> IntArray:
    """The kind of each row: rows with the same probabilities in any order, kinds with few visited rows pooled.

    Told apart by the number of entries, the largest, and the sums of squares and of cubes.
    """
    keys = np.column_stack(
        [
            np.diff(indptr),
            np.round(np.maximum.reduceat(weights, indptr[:-1]), 6),
            np.round(segment_sums(weights**2, indptr), 6),
            np.round(segment_sums(weights**3, indptr), 6),
        ]
    )
    _, kind = np.unique(keys, axis=0, return_inverse=True)
    kind = kind.reshape(-1)
    n_row, size = segment_sums(observed, indptr), int(kind.max()) + 1
    few = (np.bincount(kind[n_row > 0], minlength=size) < FEWEST_ROWS) | (np.bincount(kind, n_row, size) < FEWEST_MOVES)
    return np.asarray(np.where(few[kind], 0, kind + 1), dtype=np.int64)


def choose_strength(
    observed: Array,
    prior: Array,
    weights: Array,
    indptr: IntArray,
    criterion: str = "evidence",
    *,
    kind: IntArray | None = None,
) -> StrengthChoice:
    """For each kind of rows the kappa in [1, 1e8] that maximises the criterion.

    A grid of five a decade, then three finer grids around the best point. ``weights`` is the simulator's P; ``kind`` the
    rows' kinds where they are known already.
    """
    kind = kinds_of_rows(weights, observed, indptr) if kind is None else kind
    n_kinds = int(kind.max()) + 1
    score = _criterion(observed, prior, indptr, kind, n_kinds, criterion)
    grid = np.linspace(np.log(SMALLEST), np.log(LARGEST), 41)
    width = grid[1] - grid[0]
    scores = np.array([score(np.full(n_kinds, np.exp(t))) for t in grid])
    value = scores.max(axis=0)
    level = scores >= value - 1e-9 * (1.0 + np.abs(value))  # where the moves do not tell, the prior is believed
    best = grid[len(grid) - 1 - np.argmax(level[::-1], axis=0)]
    for _ in range(3):
        center = best
        for offset in np.linspace(-width, width, 9):
            trial = np.clip(center + offset, grid[0], grid[-1])
            found = score(np.exp(trial))
            best, value = np.where(found > value, trial, best), np.maximum(found, value)
        width /= 4.0
    strength = np.exp(best)
    n_row = segment_sums(observed, indptr)
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
    )


def _criterion(
    observed: Array, prior: Array, indptr: IntArray, kind: IntArray, n_kinds: int, name: str
) -> Callable[[Array], Array]:
    """The criterion of each kind's rows as a function of the kinds' kappas."""
    if name != "evidence":
        return lambda kappa: np.bincount(
            kind, _leave_one_out_by_row(kappa[kind], observed, prior, indptr), n_kinds
        ).astype(np.float64)
    n_row, seen = segment_sums(observed, indptr), observed > 0
    rows = np.flatnonzero(n_row > 0)
    ends = np.concatenate([[0], np.cumsum(segment_sums(seen.astype(np.int64), indptr)[rows])]).astype(np.int64)
    data = np.ascontiguousarray(kind[rows], dtype=np.int64), ends, observed[seen], prior[seen], n_row[rows]

    def evidence_of(kappa: Array) -> Array:
        found = np.zeros(n_kinds)
        kernel.evidence_by_kind(kappa, *data, found)
        return found

    return evidence_of


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values, kind="stable")
    running = np.cumsum(weights[order])
    if running[-1] == 0:
        return float(values[order[-1]])
    return float(values[order[np.searchsorted(running, 0.5 * running[-1])]])


def meaning(choice: StrengthChoice, n_row: Array, name: str) -> str:
    """What kappa says about the prior, in words."""
    typical = float(np.median(n_row[n_row > 0]))
    strength = choice.strength
    if np.ptp(choice.curve) < 1.0:
        return f"too few moves to tell whether the {name} fits ({typical:.3g} in the median row that has some)"
    worth = f"{strength:.3g} moves" if strength < 1e6 else "any number of moves"
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
