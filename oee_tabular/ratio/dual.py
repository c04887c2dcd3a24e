"""The structured solver: rows of a separable program, each through a one-dimensional dual root, with its gap.

Program of a row (the paper's estimator with the constraint sum beta q = 1; with q g^2 / 2 - p g for q g - p log g where it is
least squares):

    minimise  sum_x q g - p log g + A/2 (g - c)^2   subject to  lower <= g <= upper,  sum_x q g = sum_x q.

The kernel solves q g - p log g - pull g + a/2 g^2; gaps are those of the program above (``ratio.certificate``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Coordinates:
    """A separable program as it is stated, entry by entry; ``squares``: least squares for the KL risk."""

    p: Array
    q: Array
    curvature: Array
    center: Array
    squares: bool = False

    def kernel_form(self) -> tuple[Array, Array, Array, Array]:
        """(p, q, a, pull) of q g - p log g - pull g + a/2 g^2, equal to the program up to a constant."""
        pull = self.curvature * self.center
        if self.squares:
            return np.zeros_like(self.p), self.q, self.q + self.curvature, self.p + pull + self.q
        return self.p, self.q, self.curvature, pull


def kl_coordinates(p: Array, q: Array, curvature: Array, toward: float) -> Coordinates:
    """sum q g - p log g + curvature/2 (g - toward)^2: the dual of the KL divergence, the paper's loss."""
    return Coordinates(p, q, curvature, np.full(len(p), toward))


def lsif_coordinates(p: Array, q: Array, curvature: Array, toward: float) -> Coordinates:
    """sum q g^2 / 2 - p g + curvature/2 (g - toward)^2: least squares (LSIF), the chi-square divergence's dual."""
    return Coordinates(p, q, curvature, np.full(len(p), toward), squares=True)


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
        from oee_tabular.ratio import _dual as duals
        from oee_tabular.ratio import _plain as plain

        (p, q, a, pull), found = self.program.kernel_form(), []
        for ends in (self.right, self.left):
            values = self.ratio.copy()
            open_ends = np.where(self.left < self.right, ends, np.nan)
            plain.plain_minimisers(np.where(self.plain, open_ends, np.nan), p, q, *self.box, self.indptr, values)
            duals.minimisers(np.where(self.plain, np.nan, open_ends), p, q, a, pull, *self.box, self.indptr, values)
            found.append(values)
        return found[0], found[1]


def solve_rows(program: Coordinates, lower: float, upper: float, indptr: IntArray) -> RowSolution:
    """Every row ``indptr[k]:indptr[k+1]`` by itself. Arguments are checked by the callers.

    p, q sum to 1 in each row that has entries; curvature >= 0; lower <= 1 <= upper. Cost: O(entries) times a few steps; it
    cannot fail. Rows without curvature go through the guessed sets of ``_plain``; those that it leaves, and the
    others, through the bracketed root of ``_dual``.
    """
    from oee_tabular.ratio import _dual as duals
    from oee_tabular.ratio import _plain as plain

    rows = indptr.astype(np.int64)
    p, q, a, pull = program.kernel_form()
    n_rows = len(rows) - 1
    ratio = np.empty(len(p))
    left, right, m = (np.empty(n_rows) for _ in range(3))
    if lower == 1.0 or upper == 1.0 or a.any() or pull.any():
        quick, todo = np.zeros(n_rows, dtype=bool), np.arange(n_rows)
    else:
        plain.solve_plain_rows(p, q, lower, upper, rows, ratio, left, right, m)
        quick = ~np.isnan(m)
        todo = np.flatnonzero(~quick)
    if todo.size:
        duals.solve_rows(p, q, a, pull, lower, upper, rows, todo, ratio, left, right, m)
    gap = row_gaps(program, ratio, m, lower, upper, rows)
    return RowSolution(ratio, m, gap, left, right, quick, program, (lower, upper), rows)


def solve_free(program: Coordinates, lower: float, upper: float) -> Array:
    """The minimiser without the equality, in closed form."""
    from oee_tabular.ratio import _dual as duals

    return np.asarray(duals.solve_free(*program.kernel_form(), lower, upper))


def row_gaps(program: Coordinates, g: Array, m: Array | None, lower: float, upper: float, indptr: IntArray) -> Array:
    """(rows,) duality gaps of any g with multipliers ``m`` - 1 of the rows' equalities (None: there is no equality).

    From the program as stated, by code that no solver uses; what constraints are missed by counts as it is. Cost: O(entries).
    """
    from oee_tabular.ratio import certificate

    multiplier = np.ones(len(indptr) - 1) if m is None else m
    return np.asarray(
        certificate.row_gaps(
            program.squares, multiplier, program.p, program.q, program.curvature, program.center, lower, upper, indptr,
            m is not None, g,
        )
    )  # fmt: skip


def objective(g: Array, program: Coordinates) -> float:
    """sum q g - p log g (or q g^2 / 2 - p g) + curvature/2 (g - center)^2."""
    penalty = 0.5 * float(program.curvature @ (g - program.center) ** 2)
    if program.squares:
        return 0.5 * float(program.q @ g**2) - float(program.p @ g) + penalty
    seen = program.p > 0
    with np.errstate(divide="ignore"):
        logs = float(program.p[seen] @ np.log(g[seen]))
    return float(program.q @ g) - logs + penalty
