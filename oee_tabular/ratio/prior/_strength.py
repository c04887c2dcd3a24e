"""Loops of the choice of kappa: both criteria of Dirichlet rows, and their maximum for each kind of rows."""

from math import exp, log, log1p
from typing import Any, NamedTuple

import numpy as np
from numba import njit

FAR = 12.0  # from here Stirling's series with four terms errs by less than 1e-13


class Counts(NamedTuple):
    """The recorded rows: their kinds, the ends, counts and prior of their entries with counts, and n of each row."""

    kind: Any
    ends: Any
    counts: Any
    prior: Any
    n: Any


@njit(cache=True, nogil=True, error_model="numpy")
def log_rising(base, n):
    """ln Gamma(base + n) - ln Gamma(base), for base, n > 0, without the cancellation of two large logarithms.

    Both arguments are carried to at least ``FAR`` by Gamma(x + 1) = x Gamma(x); there the difference of Stirling's series,
    (x - 1/2) ln(1 + d/x) + d ln(x + d) - d + s(x + d) - s(x).
    """
    x, y, gap = base, base + n, n
    if n <= 8.0 and n == int(n):
        product = base
        for i in range(1, int(n)):
            product *= base + i
        return log(product)
    over, under = 1.0, 1.0
    while x < FAR:
        over *= x
        x += 1.0
        gap -= 1.0
    while y < FAR:
        under *= y
        y += 1.0
        gap += 1.0
    u, v = 1.0 / (x * x), 1.0 / (y * y)
    series_x = (1.0 / 12.0 - u * (1.0 / 360.0 - u * (1.0 / 1260.0 - u / 1680.0))) / x
    series_y = (1.0 / 12.0 - v * (1.0 / 360.0 - v * (1.0 / 1260.0 - v / 1680.0))) / y
    return (x - 0.5) * log1p(gap / x) + gap * log(y) - gap + series_y - series_x + log(over / under)


@njit(cache=True, nogil=True, error_model="numpy")
def score_by_kind(kappa, rows, leave_one_out):
    """The criterion of the rows' counts, summed over each kind, at kappa (kinds,)."""
    score = np.zeros(len(kappa))
    for row in range(len(rows.n)):
        strength, gained = kappa[rows.kind[row]], 0.0
        if leave_one_out:
            others = strength + max(rows.n[row] - 1.0, 0.0)
            for x in range(rows.ends[row], rows.ends[row + 1]):
                gained += rows.counts[x] * log((max(rows.counts[x] - 1.0, 0.0) + strength * rows.prior[x]) / others)
        else:
            gained = -log_rising(strength, rows.n[row])
            for x in range(rows.ends[row], rows.ends[row + 1]):
                gained += log_rising(strength * rows.prior[x], rows.counts[x])
        score[rows.kind[row]] += gained
    return score


@njit(cache=True, nogil=True, error_model="numpy")
def maximise_by_kind(grid, rows, n_kinds, leave_one_out, n_halvings):
    """(kinds,) ln kappa and the criterion there, and (grid, kinds) the criterion on the grid of ln kappa.

    The best point of the grid; then the better of both sides at half the distance, ``n_halvings`` times. Where the criterion
    is level the largest kappa is taken: counts that do not tell leave the prior believed.
    """
    scores = np.empty((len(grid), n_kinds))
    best, value = np.full(n_kinds, grid[0]), np.full(n_kinds, -np.inf)
    for i in range(len(grid)):
        scores[i] = score_by_kind(np.full(n_kinds, exp(grid[i])), rows, leave_one_out)
        for kind in range(n_kinds):
            if scores[i, kind] >= value[kind] - 1e-13 * (1.0 + abs(value[kind])):
                best[kind], value[kind] = grid[i], max(scores[i, kind], value[kind])
    distance = grid[1] - grid[0]
    for _ in range(n_halvings):
        distance *= 0.5
        centre = best.copy()
        for side in (-1.0, 1.0):
            trial = np.minimum(np.maximum(centre + side * distance, grid[0]), grid[-1])
            new = score_by_kind(np.exp(trial), rows, leave_one_out)
            for kind in range(n_kinds):
                if new[kind] > value[kind]:
                    best[kind], value[kind] = trial[kind], new[kind]
    return best, value, scores
