"""Checked arguments of a ratio: its data p and q, its box nu <= g <= mu, its ridge lambda_n."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array


class Box(NamedTuple):
    """Checked bounds nu <= g <= mu of a ratio, infinite where not given."""

    lower: float
    upper: float


def check_box(lower: object, upper: object, *, normalized: bool, names: tuple[str, str] = ("lower", "upper")) -> Box:
    """The bounds of a ratio as floats; errors for a box that is empty or, where g is normalised, excludes 1."""
    nu = 0.0 if lower is None else _checks.number_in(lower, names[0], 0.0, np.inf)
    mu = np.inf if upper is None else _checks.number_in(upper, names[1], 0.0, np.inf, infinite=True)
    if nu > mu:
        raise ValueError(f"{names[0]} must not exceed {names[1]}; they are {nu:g} and {mu:g}")
    if mu == 0.0:
        raise ValueError(f"{names[1]} must be positive: the logarithm of the ratio is part of the objective; it is 0")
    if normalized and not nu <= 1.0 <= mu:
        raise ValueError(
            f"the box [{', '.join(names)}] must contain 1 for sum q g = 1 to be possible; it is [{nu:g}, {mu:g}]"
        )
    return Box(nu, mu)


def check_ridge(value: object, n: float) -> float:
    """lambda_n as a finite nonnegative number: given, or a function of the sample size."""
    name = f"ridge({n:g})" if callable(value) else "ridge"
    return _checks.number_in(value(n) if callable(value) else value, name, 0.0, np.inf)


def check_weights(p: object, q: object) -> tuple[Array, Array]:
    """Return p and q, counts or probabilities of the same cells, nonnegative and each with a positive sum."""
    weights = [_checks.float_array(value, name, ndim=1) for value, name in ((p, "p"), (q, "q"))]
    for array, name in zip(weights, ("p", "q"), strict=True):
        _checks.require_nonnegative(array, name)
        with np.errstate(over="ignore"):
            total = float(array.sum())
        if not 0.0 < total < np.inf:
            raise ValueError(f"{name} must have a positive, finite sum; it is {total:g}")
    if len(weights[0]) != len(weights[1]):
        raise ValueError(f"p and q must have one length; they have {len(weights[0])} and {len(weights[1])}")
    return weights[0], weights[1]


def check_distributions(p: object, q: object) -> tuple[Array, Array]:
    """Return p and q, counts or probabilities of the same cells, each scaled to sum to 1."""
    p_weights, q_weights = check_weights(p, q)
    return p_weights / p_weights.sum(), q_weights / q_weights.sum()
