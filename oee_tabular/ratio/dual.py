"""The structured solver: rows of a separable program, each through a one-dimensional dual root, with its gap.

Program of a row (eq. 3.7 with the constraint sum beta q = 1; with q g^2 / 2 - p g for q g - p log g where it is least squares):

    minimise  sum_x q g - p log g + A/2 (g - c)^2   subject to  lower <= g <= upper,  sum_x q g = sum_x q.

The kernels solve q g - p log g - pull g + a/2 g^2; gaps are those of the program above (``_certificate``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from oee_tabular._checks import Array, BoolArray, IntArray
from oee_tabular.ratio import _certificate, _dual, _plain
from oee_tabular.ratio.arguments import Box


class Coordinates(NamedTuple):
    """A separable program as it is stated, entry by entry; ``squares``: least squares for the KL risk."""

    p: Array
    q: Array
    curvature: Array
    center: Array
    squares: bool = False

    def kernel_form(self, lower: float, upper: float) -> _dual.Form:
        """q g - p log g - pull g + a/2 g^2, equal to the program up to a constant."""
        pull = self.curvature * self.center
        if self.squares:
            pull, a = self.p + pull + self.q, self.q + self.curvature
            return _dual.Form(np.zeros_like(self.p), self.q, a, pull, lower, upper)
        return _dual.Form(self.p, self.q, self.curvature, pull, lower, upper)


def kl_coordinates(p: Array, q: Array, curvature: Array, toward: float) -> Coordinates:
    """sum q g - p log g + curvature/2 (g - toward)^2: the dual of the KL divergence, the paper's loss."""
    return Coordinates(p, q, curvature, np.full(len(p), toward))


def lsif_coordinates(p: Array, q: Array, curvature: Array, toward: float) -> Coordinates:
    """sum q g^2 / 2 - p g + curvature/2 (g - toward)^2: least squares (LSIF), the chi-square divergence's dual."""
    return Coordinates(p, q, curvature, np.full(len(p), toward), squares=True)


@dataclass(frozen=True, eq=False)
class RowSolution:
    """Minimisers, m = 1 + multiplier of each row's equality, and each row's duality gap (absolute).

    ``left`` <= the exact m <= ``right`` (up to the rounding of the sums); equal where g is known outright. ``plain`` rows were
    solved by ``_plain``.
    """

    ratio: Array
    m: Array
    gap: Array
    left: Array
    right: Array
    plain: BoolArray
    form: _dual.Form
    indptr: IntArray

    def enclosure(self) -> tuple[Array, Array]:
        """(below, above) with below <= the exact minimiser <= above, entry by entry.

        They are the coordinates' minimisers at the two ends of the bracket of m: equal, up to rounding, but where a jump
        leaves the minimiser free (inf where nothing bounds it).
        """
        found = []
        for ends in (self.right, self.left):
            values = self.ratio.copy()
            open_ends = np.where(self.left < self.right, ends, np.nan)
            _plain.plain_minimisers(np.where(self.plain, open_ends, np.nan), self.form, self.indptr, values)
            _dual.minimisers(np.where(self.plain, np.nan, open_ends), self.form, self.indptr, values)
            found.append(values)
        return found[0], found[1]


def solve_rows(program: Coordinates, lower: float, upper: float, indptr: IntArray) -> RowSolution:
    """Every row ``indptr[k]:indptr[k+1]`` by itself. Arguments are checked by the callers.

    p, q sum to 1 in each row that has entries; curvature >= 0; lower <= 1 <= upper. Cost: O(entries) times a few steps; it
    cannot fail. Rows without curvature go through the guessed sets of ``_plain``; those that it leaves, and the others,
    through the bracketed root of ``_dual``.
    """
    rows = indptr.astype(np.int64)
    form, ratio = program.kernel_form(float(lower), float(upper)), np.empty(len(program.p))
    left, right, m = np.full((3, len(rows) - 1), np.nan)
    if not (lower == 1.0 or upper == 1.0 or form.a.any() or form.pull.any()):
        _plain.solve_plain_rows(form, rows, ratio, left, right, m)
    plain = ~np.isnan(m)
    if not plain.all():
        _dual.solve_rows(form, rows, np.flatnonzero(~plain), ratio, left, right, m)
    gap = _certificate.row_gaps(program, Box(form.lower, form.upper), rows, ratio, m, True)
    return RowSolution(ratio, m, gap, left, right, plain, form, rows)


def solve_free(program: Coordinates, lower: float, upper: float) -> Array:
    """The minimiser without the equality, in closed form."""
    return np.asarray(_dual.solve_free(program.kernel_form(float(lower), float(upper))))


def row_gaps(program: Coordinates, g: Array, m: Array | None, lower: float, upper: float, indptr: IntArray) -> Array:
    """(rows,) duality gaps of any g with multipliers ``m`` - 1 of the rows' equalities (None: there is no equality).

    From the program as stated, by code that no solver uses; what constraints are missed by counts as it is. Cost: O(entries).
    """
    multiplier = np.ones(len(indptr) - 1) if m is None else m
    return np.asarray(
        _certificate.row_gaps(program, Box(float(lower), float(upper)), indptr, g, multiplier, m is not None)
    )


def objective(g: Array, program: Coordinates) -> float:
    """sum q g - p log g (or q g^2 / 2 - p g) + curvature/2 (g - center)^2."""
    penalty = 0.5 * float(program.curvature @ (g - program.center) ** 2)
    if program.squares:
        return 0.5 * float(program.q @ g**2) - float(program.p @ g) + penalty
    seen = program.p > 0
    with np.errstate(divide="ignore"):
        logs = float(program.p[seen] @ np.log(g[seen]))
    return float(program.q @ g) - logs + penalty
