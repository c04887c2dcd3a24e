"""The structured solver: rows of a separable KL program, each through a one-dimensional dual root, with its gap.

Program of a row (the paper's estimator with the constraint sum beta q = 1):

    minimise  sum_x q g - p log g + A/2 (g - c)^2   subject to  lower <= g <= upper,  sum_x q g = sum_x q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, IntArray


@dataclass(frozen=True)
class RowSolution:
    """Minimisers, m = 1 + multiplier of each row's equality, and each row's duality gap (absolute)."""

    ratio: Array
    m: Array
    gap: Array


def solve_rows(
    p: Array, q: Array, curvature: Array, toward: float, lower: float, upper: float, indptr: IntArray
) -> RowSolution:
    """Every row ``indptr[k]:indptr[k+1]`` by itself. Arguments are checked by the callers.

    p, q sum to 1 in each row that has entries; curvature is A >= 0; lower <= 1 <= upper. Cost: O(entries) times a few
    Newton steps; it cannot fail, every step shrinks a bracket.
    """
    from oee_tabular.kernels import duals

    ratio, m, gap = duals.solve_rows(p, q, curvature, toward, lower, upper, indptr.astype(np.int64))
    return RowSolution(ratio, m, np.maximum(gap, 0.0))


def solve_free(p: Array, q: Array, curvature: Array, toward: float, lower: float, upper: float) -> Array:
    """The minimiser without the equality, in closed form."""
    from oee_tabular.kernels import duals

    return np.asarray(duals.solve_free(p, q, curvature, toward, lower, upper))


def dual_value(m: float, p: Array, q: Array, curvature: Array, toward: float, lower: float, upper: float) -> float:
    """The dual function of one row at multiplier m - 1: a lower bound on the optimum, whatever m is."""
    from oee_tabular.kernels import duals

    y = np.empty(len(p))
    duals.fill_row(m, p, q, curvature, toward, lower, upper, 0, len(p), y)
    if not np.all(np.isfinite(y)):
        return -np.inf
    return objective(y, p, q, curvature, toward) + (m - 1.0) * float(q @ (y - 1.0))


def objective(g: Array, p: Array, q: Array, curvature: Array, toward: float) -> float:
    """sum q g - sum p log g + sum A/2 (g - c)^2."""
    seen = p > 0
    with np.errstate(divide="ignore"):
        logs = float(p[seen] @ np.log(g[seen]))
    return float(q @ g) - logs + 0.5 * float(curvature @ (g - toward) ** 2)
