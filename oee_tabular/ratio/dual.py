"""The structured solver: rows of a separable program, each through a one-dimensional dual root, with its gap.

    minimise  sum_x q g - p log g + A/2 (g - c)^2   subject to  lower <= g <= upper,  sum_x q g = sum_x q    (eq. 3.7)

in each row. The kernels solve q g - p log g - pull g + a/2 g^2; gaps are those of the program as stated (``_certificate``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.ratio import _certificate, _dual
from oee_tabular.ratio.arguments import Box


class Coordinates(NamedTuple):
    """A separable program as it is stated, entry by entry: sum q g - p log g + curvature/2 (g - center)^2.

    ``squares``: least squares (LSIF), the chi-square divergence's dual, sum q g^2 / 2 - p g in place of the KL risk.
    """

    p: Array
    q: Array
    curvature: Array
    center: Array
    squares: bool = False

    def risk(self, g: Array) -> float:
        """sum q g - p log g, or sum q g^2 / 2 - p g."""
        if self.squares:
            return 0.5 * float(self.q @ g**2) - float(self.p @ g)
        seen = self.p > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = self.p @ np.log(g) if seen.all() else self.p[seen] @ np.log(g[seen])
        return float(self.q @ g) - float(logs)

    def penalty(self, g: Array) -> float:
        """sum curvature/2 (g - center)^2."""
        return 0.5 * float(self.curvature @ (g - self.center) ** 2) if self.curvature.any() else 0.0

    def kernel_form(self, lower: float, upper: float) -> _dual.Form:
        """q g - p log g - pull g + a/2 g^2, equal to the program up to a constant."""
        pull = self.curvature * self.center
        if self.squares:
            pull, a = self.p + pull + self.q, self.q + self.curvature
            return _dual.Form(np.zeros_like(self.p), self.q, a, pull, float(lower), float(upper))
        return _dual.Form(self.p, self.q, self.curvature, pull, float(lower), float(upper))


class RowSolution(NamedTuple):
    """Minimisers, m = 1 + multiplier of each row's equality, and each row's duality gap (absolute).

    below <= the exact minimiser <= above, entry by entry: the minimisers at the two ends of the bracket of m, equal, up to
    rounding, but where a jump leaves the minimiser free (inf where nothing bounds it).
    """

    ratio: Array
    m: Array
    gap: Array
    below: Array
    above: Array


def solve_rows(program: Coordinates, lower: float, upper: float, indptr: IntArray) -> RowSolution:
    """Every row ``indptr[k]:indptr[k+1]`` by itself. Arguments are checked by the callers.

    p, q sum to 1 in each row that has entries; curvature >= 0; lower <= 1 <= upper. Cost: O(entries) times a few steps; it
    cannot fail.
    """
    rows, m = indptr.astype(np.int64), np.empty(len(indptr) - 1)
    ratio, below, above = np.empty((3, len(program.p)))
    _dual.solve_rows(program.kernel_form(lower, upper), rows, ratio, below, above, m)
    return RowSolution(ratio, m, row_gaps(program, ratio, m, lower, upper, rows), below, above)


def solve_free(program: Coordinates, lower: float, upper: float) -> Array:
    """The minimiser without the equality, in closed form."""
    return np.asarray(_dual.solve_free(program.kernel_form(lower, upper)))


def row_gaps(program: Coordinates, g: Array, m: Array | None, lower: float, upper: float, indptr: IntArray) -> Array:
    """(rows,) duality gaps of any g with multipliers ``m`` - 1 of the rows' equalities (None: there is no equality).

    From the program as stated, by code that no solver uses; what constraints are missed by counts as it is. Cost: O(entries).
    """
    multiplier, box = np.ones(len(indptr) - 1) if m is None else m, Box(float(lower), float(upper))
    return np.asarray(_certificate.row_gaps(program, box, indptr, g, multiplier, m is not None))


def objective(g: Array, program: Coordinates) -> float:
    """The program's value."""
    return program.risk(g) + program.penalty(g)
