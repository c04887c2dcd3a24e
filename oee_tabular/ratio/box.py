"""The options that every ratio program shares: the box [nu, mu] and the ridge lambda_n, checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oee_tabular import _checks


@dataclass(frozen=True)
class Box:
    """Checked bounds nu <= g <= mu, infinite where not given."""

    lower: float
    upper: float


def check_box(
    lower: float | None, upper: float | None, *, normalized: bool, names: tuple[str, str] = ("lower", "upper")
) -> Box:
    """The bounds as floats; errors for a box that is empty or, where g is normalised, excludes 1."""
    low = 0.0 if lower is None else _checks.number_in(lower, names[0], 0.0, np.inf)
    high = np.inf if upper is None else _checks.number_in(upper, names[1], 0.0, np.inf, infinite=True)
    if low > high:
        raise ValueError(f"{names[0]} must not exceed {names[1]}; they are {low:g} and {high:g}")
    if high == 0.0:
        raise ValueError(f"{names[1]} must be positive: the logarithm of the ratio is part of the objective; it is 0")
    if normalized and not low <= 1.0 <= high:
        raise ValueError(
            f"the box [{', '.join(names)}] must contain 1 for sum q g = 1 to be possible; it is [{low:g}, {high:g}]"
        )
    return Box(low, high)


def check_ridge(ridge: float | Callable[[float], float], n: float) -> float:
    """The ridge as a finite nonnegative number: given, or a function of the sample size."""
    value = ridge(n) if callable(ridge) else ridge
    name = f"ridge({n:g})" if callable(ridge) else "ridge"
    return _checks.number_in(value, name, 0.0, np.inf)
