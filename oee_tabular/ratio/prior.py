"""How strongly to believe the prior: the Dirichlet strength kappa, chosen on the data.

Each row of the target is a priori Dirichlet(kappa m), m the prior's row (the simulator, or its tilt). Two criteria, both
closed in form and one-dimensional in kappa:

evidence       sum_k [lnG(kappa) - lnG(kappa + n_k)] + sum_x [lnG(kappa m_x + n_x) - lnG(kappa m_x)]   (Polya [1])
leave-one-out  sum_x n_x log[(n_x - 1 + kappa m_x) / (n_k - 1 + kappa)]

kappa is its own diagnosis: it is the number of moves that the prior's row is worth.

Reference: [1] T. P. Minka, Estimating a Dirichlet distribution, 2000.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio.segments import segment_sums, spread

SMALLEST, LARGEST = 1e-3, 1e8
CRITERIA = ("evidence", "loo")


@dataclass(frozen=True, eq=False)
class StrengthChoice:
    """kappa, the criterion's value there, and its curve over a grid of kappa (nats, all moves together)."""

    strength: float
    score: float
    criterion: str
    grid: Array
    curve: Array


def log_rising(base: Array, n: Array) -> Array:
    """ln Gamma(base + n) - ln Gamma(base) for n > 0, without the cancellation of two large logarithms."""
    return np.asarray(special.gammaln(n) - special.betaln(base, n))


def evidence(strength: float, observed: Array, prior: Array, indptr: IntArray) -> float:
    """Log marginal likelihood of the counts."""
    n_row = segment_sums(observed, indptr)
    seen, rows = observed > 0, n_row > 0
    gained = log_rising(strength * prior[seen], observed[seen]).sum()
    return float(gained - log_rising(np.full(int(rows.sum()), strength), n_row[rows]).sum())


def leave_one_out(strength: float, observed: Array, prior: Array, indptr: IntArray) -> float:
    """Log predictive probability of each move, given all the others."""
    n_row = spread(segment_sums(observed, indptr), indptr)
    seen = observed > 0
    n, total, m = observed[seen], n_row[seen], prior[seen]
    with np.errstate(divide="ignore"):
        predicted = (np.maximum(n - 1.0, 0.0) + strength * m) / (np.maximum(total - 1.0, 0.0) + strength)
        return float(n @ np.log(predicted))


def choose_strength(observed: Array, prior: Array, indptr: IntArray, criterion: str = "evidence") -> StrengthChoice:
    """The kappa in [1e-3, 1e8] that maximises the criterion: a grid of four a decade, then Brent's method."""
    score = evidence if criterion == "evidence" else leave_one_out
    grid = np.logspace(np.log10(SMALLEST), np.log10(LARGEST), 45)
    curve = np.array([score(k, observed, prior, indptr) for k in grid])
    best = int(np.argmax(curve))
    low, high = np.log(grid[max(best - 1, 0)]), np.log(grid[min(best + 1, len(grid) - 1)])
    found = optimize.minimize_scalar(
        lambda t: -score(float(np.exp(t)), observed, prior, indptr), bounds=(low, high), method="bounded",
        options={"xatol": 1e-6},
    )  # fmt: skip
    strength, value = float(np.exp(found.x)), float(-found.fun)
    if curve[best] >= value:
        strength, value = float(grid[best]), float(curve[best])
    return StrengthChoice(strength, value, criterion, grid, curve)


def meaning(strength: float, n_row: Array, name: str) -> str:
    """What kappa says about the prior, in words."""
    typical = float(np.median(n_row[n_row > 0]))
    compared = f"a row of it is worth {strength:.3g} moves, and the log has {typical:.3g} in the median row"
    if strength >= 10.0 * max(typical, 10.0):
        return f"the {name} fits: {compared}"
    if strength >= max(typical, 10.0):
        return f"the {name} fits roughly: {compared}"
    return f"the {name} does not fit: {compared}"
