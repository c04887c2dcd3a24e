"""The structured solver: rows of a separable KL program, each through a one-dimensional dual root, with its gap.

Program of a row (the paper's estimator with the constraint sum beta q = 1):

    minimise  sum_x q g - p log g + A/2 (g - c)^2   subject to  lower <= g <= upper,  sum_x q g = sum_x q.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Coordinates:
    """A separable program in the kernel's form: sum q g - p log g + curvature/2 (g - center)^2, entry by entry."""

    p: Array
    q: Array
    curvature: Array
    center: Array


def kl_coordinates(p: Array, q: Array, curvature: Array, toward: float) -> Coordinates:
    """sum q g - p log g + curvature/2 (g - toward)^2: the dual of the KL divergence, the paper's loss."""
    return Coordinates(p, q, curvature, np.full(len(p), toward))


def lsif_coordinates(p: Array, q: Array, curvature: Array, toward: float) -> Coordinates:
    """sum q g^2 / 2 - p g + curvature/2 (g - toward)^2: least squares (LSIF), the chi-square divergence's dual.

    Up to a constant, (q + A)/2 (g - c')^2 + q g with (q + A) c' = p + A toward + q.
    """
    bend = q + curvature
    center = np.divide(p + curvature * toward + q, bend, out=np.zeros_like(p), where=bend > 0)
    return Coordinates(np.zeros_like(p), q, bend, center)


@dataclass(frozen=True, eq=False)
class RowSolution:
    """Minimisers, m = 1 + multiplier of each row's equality, and each row's duality gap (absolute).

    ``left`` <= the exact m <= ``right`` (up to the rounding of the sums); equal where g is known outright.
    """

    ratio: Array
    m: Array
    gap: Array
    left: Array
    right: Array
    plain: BoolArray
    program: Coordinates
    box: tuple[float, float]
    indptr: IntArray

    def enclosure(self) -> tuple[Array, Array]:
        """(below, above) with below <= the exact minimiser <= above, entry by entry.

        They are the coordinates' minimisers at the two ends of the bracket of m: equal, up to rounding, but where a jump
        leaves the minimiser free (inf where nothing bounds it).
        """
        from oee_tabular.kernels import duals, plain

        part, found = self.program, []
        for ends in (self.right, self.left):
            values = self.ratio.copy()
            open_ends = np.where(self.left < self.right, ends, np.nan)
            plain.plain_minimisers(
                np.where(self.plain, open_ends, np.nan), part.p, part.q, *self.box, self.indptr, values
            )
            duals.minimisers(
                np.where(self.plain, np.nan, open_ends),
                part.p, part.q, part.curvature, part.center, *self.box, self.indptr, values,
            )  # fmt: skip
            found.append(values)
        return found[0], found[1]


def solve_rows(program: Coordinates, lower: float, upper: float, indptr: IntArray) -> RowSolution:
    """Every row ``indptr[k]:indptr[k+1]`` by itself. Arguments are checked by the callers.

    p, q sum to 1 in each row that has entries; curvature >= 0; lower <= 1 <= upper. Cost: O(entries) times a few steps; it
    cannot fail. Rows without curvature go through the guessed sets of ``kernels.plain``; those that it leaves, and the
    others, through the bracketed root of ``kernels.duals``.
    """
    from oee_tabular.kernels import duals, plain

    rows = indptr.astype(np.int64)
    p, q = program.p, program.q
    n_rows = len(rows) - 1
    ratio = np.empty(len(p))
    left, right, m, gap = (np.empty(n_rows) for _ in range(4))
    if lower == 1.0 or upper == 1.0 or program.curvature.any():
        quick, todo = np.zeros(n_rows, dtype=bool), np.arange(n_rows)
    else:
        plain.solve_plain_rows(p, q, lower, upper, rows, ratio, left, right, m, gap)
        quick = ~np.isnan(gap)
        todo = np.flatnonzero(~quick)
    if todo.size:
        duals.solve_rows(p, q, program.curvature, program.center, lower, upper, rows, todo, ratio, left, right, m, gap)
    return RowSolution(ratio, m, gap, left, right, quick, program, (lower, upper), rows)


def solve_free(program: Coordinates, lower: float, upper: float) -> Array:
    """The minimiser without the equality, in closed form."""
    from oee_tabular.kernels import duals

    return np.asarray(duals.solve_free(program.p, program.q, program.curvature, program.center, lower, upper))


def dual_value(m: float, program: Coordinates, lower: float, upper: float) -> float:
    """The dual function of one row at multiplier m - 1: a lower bound on the optimum, whatever m is."""
    from oee_tabular.kernels import duals

    y, p, q = np.empty(len(program.p)), program.p, program.q
    duals.fill_row(m, p, q, program.curvature, program.center, lower, upper, 0, len(p), y)
    if not np.all(np.isfinite(y)):
        return -np.inf
    return objective(y, program) + (m - 1.0) * float(q @ (y - 1.0))


def objective(g: Array, program: Coordinates) -> float:
    """sum q g - p log g + curvature/2 (g - center)^2."""
    seen = program.p > 0
    with np.errstate(divide="ignore"):
        logs = float(program.p[seen] @ np.log(g[seen]))
    return float(program.q @ g) - logs + 0.5 * float(program.curvature @ (g - program.center) ** 2)
