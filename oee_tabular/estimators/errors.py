"""Standard errors: of means, and of functions of the log's frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular._sparse import row_variances
from oee_tabular.exact import exponent
from oee_tabular.mdp import reduce_rows
from oee_tabular.typing import Array, Csr


def effective_sample_size(weights: Array) -> float:
    """Compute Kish's effective sample size, (sum w)^2 / sum w^2.

    As many equally weighted samples would vary as much. It is 0 where all weights are
    0.
    """
    # squares of very large or small numbers leave the range of floats
    scaled = np.ldexp(weights, -exponent(weights))
    square = float(scaled @ scaled)
    return float(scaled.sum()) ** 2 / square if square > 0 else 0.0


# a share of the largest number involved: a smaller spread is rounding, and no variation
ROUNDING = 1e-12


def mean_and_error(values: Array, size: float = 0.0) -> tuple[float, float | None]:
    """Compute the mean and the standard error of independent values.

    There is no error where the values do not vary. If they are differences, ``size`` is
    the size of the numbers that were subtracted, whose rounding is no variation.
    """
    # squares of very large or small numbers leave the range of floats
    n = len(values)
    shift = exponent(values)
    scaled = np.ldexp(values, -shift)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values
        most = max(float(np.abs(scaled).max()), float(np.ldexp(size, -shift)))
        varies = n > 1 and not np.ptp(scaled) <= ROUNDING * most
        error = None
        if varies:
            error = float(np.ldexp(scaled.std(ddof=1) / np.sqrt(n), shift))
        return float(np.ldexp(scaled.mean(), shift)), error


def delta_error(matrix: Csr, frequency: Array, totals: Array, gradient: Array) -> float:
    """Compute a standard error by the delta method.

    It is the root of the sum over recorded rows of Var(gradient) / n, with the
    variances under ``frequency`` and the numbers n in ``totals``.
    """
    shift = exponent(gradient)
    gradient = np.ldexp(gradient, -shift)
    variance = row_variances(matrix, frequency, gradient)
    return float(
        np.ldexp(np.sqrt(np.sum(variance[totals > 0] / totals[totals > 0])), shift)
    )


def error_or_none(
    error: float, gradient: Array, indptr: NDArray[np.integer[Any]]
) -> float | None:
    """Return a delta-method error, or None where 0 would be wrong.

    An error of 0 is wrong where the next state of some row matters: what was recorded
    did not vary. Where no next state matters, whatever error is found is rounding, and
    0 is right. ``gradient`` is the value's, on the entries of the simulator's rows,
    which begin at ``indptr``.
    """
    reach = reduce_rows(np.maximum, gradient, indptr)
    reach -= reduce_rows(np.minimum, gradient, indptr)
    possible = float(reach.max())
    matters = possible > ROUNDING * float(np.abs(gradient).max())
    if not matters:
        return 0.0
    return None if error <= ROUNDING * possible else error
