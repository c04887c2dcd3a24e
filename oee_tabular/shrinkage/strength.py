"""The Dirichlet strength kappa of the prior, chosen on the data.

Each row of the target is a priori Dirichlet(kappa m), m the prior's row (the simulator,
or its tilt). Two criteria, both closed in form and one-dimensional in kappa:

::

    evidence       sum_k [lnG(kappa) - lnG(kappa + n_k)]
                   + sum_x [lnG(kappa m_x + n_x) - lnG(kappa m_x)]    (Polya [1])
    leave-one-out  sum_x n_x log[(n_x - 1 + kappa m_x) / (n_k - 1 + kappa)]

Rows in which the simulator has the same probabilities (in any order) are alike to it,
and share one kappa: where a prior fits most rows and not a few others (a grid's
corners), one kappa for all would trust it in those few as well. Kinds with fewer than
five recorded rows or a hundred transitions are pooled. kappa is its own diagnosis: the
number of transitions that the prior's row is worth.

Reference: [1] T. P. Minka, Estimating a Dirichlet distribution, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log, log1p
from typing import NamedTuple, get_args

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.mdp import Rows, distinct_rows
from oee_tabular.ratio.prior import Criterion
from oee_tabular.typing import Array, IntArray

# The argument from which Stirling's series with four terms errs by less than 1e-13.
FAR = 12.0
# Criteria that differ by less than this share are equal.
EQUAL_SHARE = 1e-13


class Counts(NamedTuple):
    """The recorded rows: the kind and n of each, and where its entries end.

    ``counts`` and ``prior`` are those of the entries that have counts.
    """

    kind: IntArray
    ends: IntArray
    counts: Array
    prior: Array
    n: Array


@njit(cache=True, nogil=True, error_model="numpy")
def log_rising(base, n):
    """Compute ln Gamma(base + n) - ln Gamma(base), for base, n > 0.

    It avoids the cancellation of two large logarithms. For small whole n it is the
    logarithm of base (base + 1) ... (base + n - 1). Else both arguments are carried to
    at least ``FAR`` by Gamma(x + 1) = x Gamma(x); there the difference of Stirling's
    series, (x - 1/2) ln(1 + d/x) + d ln(x + d) - d + s(x + d) - s(x).
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
def add_scores(kappa, kind, ends, counts, prior, n, leave_one_out, score):
    """Add each row's criterion at the kappa of its kind to the score of the kind.

    The criterion of a row is the evidence or leave-one-out formula of this module.
    """
    for row in range(len(n)):
        strength = kappa[kind[row]]
        gained = 0.0
        if leave_one_out:
            others = strength
            if n[row] > 1.0:
                others += n[row] - 1.0
            for x in range(ends[row], ends[row + 1]):
                rest = strength * prior[x]
                if counts[x] > 1.0:
                    rest += counts[x] - 1.0
                gained += counts[x] * log(rest / others)
        else:
            gained = -log_rising(strength, n[row])
            for x in range(ends[row], ends[row + 1]):
                gained += log_rising(strength * prior[x], counts[x])
        score[kind[row]] += gained


def score_by_kind(kappa: Array, rows: Counts, leave_one_out: bool) -> Array:
    """Sum a criterion of the rows' counts over each kind, at kappa (kinds,)."""
    score = np.zeros(len(kappa))
    add_scores(kappa, *rows, leave_one_out, score)
    return score


def maximise_by_kind(
    grid: Array, rows: Counts, n_kinds: int, leave_one_out: bool, n_halvings: int
) -> tuple[Array, Array, Array]:
    """Maximise the criterion over ln kappa, for each kind of rows.

    Returns ln kappa and the criterion there, both (kinds,), and the criterion on the
    grid, (grid, kinds). It takes the best point of the grid, then the better of both
    sides at half the distance, ``n_halvings`` times. Where the criterion is constant it
    takes the largest kappa: counts without information do not speak against the prior.
    """
    scores = np.empty((len(grid), n_kinds))
    best = np.full(n_kinds, grid[0])
    value = np.full(n_kinds, -np.inf)
    for i, point in enumerate(grid):
        scores[i] = score_by_kind(np.full(n_kinds, exp(point)), rows, leave_one_out)
        with np.errstate(invalid="ignore"):  # -inf before the first
            is_as_good = scores[i] >= value - EQUAL_SHARE * (1.0 + np.abs(value))
        best[is_as_good] = point
        value[is_as_good] = np.maximum(scores[i], value)[is_as_good]
    distance = grid[1] - grid[0]
    for _ in range(n_halvings):
        distance *= 0.5
        centre = best.copy()
        for side in (-1.0, 1.0):
            trial = np.clip(centre + side * distance, grid[0], grid[-1])
            new = score_by_kind(np.exp(trial), rows, leave_one_out)
            is_better = new > value
            best[is_better] = trial[is_better]
            value[is_better] = new[is_better]
    return best, value, scores


# The range of kappa. It is at least one transition, so that a few transitions alone
# cannot overrule a row of the prior.
SMALLEST_KAPPA = 1.0
LARGEST_KAPPA = 1e8
# The kappa from which the summary calls a prior fitting, or roughly fitting.
KAPPA_OF_GOOD_FIT = 300.0
KAPPA_OF_ROUGH_FIT = 50.0
# Kinds with fewer recorded rows, or fewer transitions, are pooled.
MIN_ROWS_OF_KIND = 5
MIN_TRANSITIONS_OF_KIND = 100
CRITERIA: tuple[str, ...] = get_args(Criterion)


@dataclass(frozen=True, eq=False)
class StrengthChoice:
    """The chosen kappa of each row, and how it was found.

    Attributes
    ----------
    by_row : ndarray of shape (rows,)
        kappa of each row.
    strength : float
        kappa of the median transition.
    score : float
        The criterion at ``by_row`` (nats, all transitions together).
    criterion : {'evidence', 'loo'}
        The criterion.
    grid : ndarray
        The grid of kappa.
    curve : ndarray
        The criterion on the grid if all rows shared one kappa.
    kinds : list of tuple
        Number of recorded rows, number of transitions, and kappa of each kind of rows.
    by_kind : ndarray of shape (kinds,)
        kappa of each kind of rows.
    """

    by_row: Array
    strength: float
    score: float
    criterion: Criterion
    grid: Array
    curve: Array
    kinds: list[tuple[int, int, float]]
    by_kind: Array


def score(
    strength: float | Array,
    observed: Array,
    prior: Array,
    rows: Rows,
    criterion: Criterion = "evidence",
) -> float:
    """Compute a criterion of all rows together, at one kappa or one a row."""
    kappa = np.broadcast_to(np.asarray(strength, dtype=np.float64), (len(rows),)).copy()
    counts = _counts(observed, prior, rows, np.arange(len(rows)))
    return float(score_by_kind(kappa, counts, criterion == "loo").sum())


def kinds_of_rows(observed: Array, rows: Rows) -> IntArray:
    """Return the kind of each row: rows with the same probabilities in any order.

    Kinds with few recorded rows are pooled as kind 0. Rows are told apart by the number
    of entries, the largest, and the sums of squares and of cubes.
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
    n_recorded = np.bincount(kind[n_row > 0], minlength=size)
    n_transitions = np.bincount(kind, n_row, size)
    is_small = n_recorded < MIN_ROWS_OF_KIND
    is_small |= n_transitions < MIN_TRANSITIONS_OF_KIND
    return np.asarray(np.where(is_small[kind], 0, kind + 1), dtype=np.int64)


def choose_strength(
    observed: Array,
    prior: Array,
    rows: Rows,
    criterion: Criterion = "evidence",
    *,
    kind: IntArray | None = None,
    n_halvings: int = 5,
) -> StrengthChoice:
    """Choose the kappa in [1, 1e8] that maximises the criterion, for each kind of rows.

    It searches a grid of two points a decade, then halves the spacing around the best
    point; five halvings find kappa to 2%. ``kind`` are the rows' kinds, if they are
    known.
    """
    kind = kinds_of_rows(observed, rows) if kind is None else kind
    n_kinds = int(kind.max()) + 1
    grid = np.linspace(np.log(SMALLEST_KAPPA), np.log(LARGEST_KAPPA), 17)
    counts = _counts(observed, prior, rows, kind)
    best, value, scores = maximise_by_kind(
        grid, counts, n_kinds, criterion == "loo", n_halvings
    )
    strength = np.exp(best)
    n_row = rows.sums(observed)
    table = []
    for j in range(n_kinds):
        n_of_kind = n_row[kind == j]
        n_recorded = int((n_of_kind > 0).sum())
        if n_recorded:
            table.append((n_recorded, int(n_of_kind.sum()), float(strength[j])))
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
    """Return the rows with counts as the kernels read them."""
    n_row = rows.sums(observed)
    has_count = observed > 0
    recorded = np.flatnonzero(n_row > 0)
    n_entries = rows.sums(has_count.astype(np.int64))[recorded]
    ends = np.concatenate([[0], np.cumsum(n_entries)]).astype(np.int64)
    return Counts(
        kind=kind[recorded].astype(np.int64),
        ends=ends,
        counts=observed[has_count],
        prior=prior[has_count],
        n=n_row[recorded],
    )


def _weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median of values; without weights the largest value."""
    order = np.argsort(values, kind="stable")
    running = np.cumsum(weights[order])
    if running[-1] == 0:
        return float(values[order[-1]])
    return float(values[order[np.searchsorted(running, 0.5 * running[-1])]])


def meaning(choice: StrengthChoice, n_row: Array, name: str) -> str:
    """Return the sentence about the prior that kappa supports."""
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
    if strength >= KAPPA_OF_GOOD_FIT:
        verdict = f"the {name} fits"
    elif strength >= KAPPA_OF_ROUGH_FIT:
        verdict = f"the {name} fits roughly"
    else:
        return f"the {name} does not fit: {compared}"
    n_rows = sum(rows for rows, _, _ in choice.kinds)
    n_misfits = sum(
        rows for rows, _, kappa in choice.kinds if kappa < KAPPA_OF_ROUGH_FIT
    )
    exception = f"; but not in {n_misfits} of {n_rows} rows" if n_misfits else ""
    return f"{verdict}: {compared}{exception}"
