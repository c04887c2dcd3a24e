"""What a ratio from two samples is, and the check of its points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import ArrayLike

from oee_tabular import _checks
from oee_tabular._checks import Array


@dataclass(frozen=True, eq=False)
class SampleRatio:
    """A fitted ratio g = dP/dQ of densities.

    Attributes
    ----------
    p_ratio, q_ratio : g at the two samples
    gap : bound on the risk less its minimum (nats for "log-linear", squared units for "kernel": the largest of its pairs)
    method : "log-linear" or "kernel"
    details : theta, of the features (of (x - center) / scale for the words, both given); or centers, the leave-one-out score
        and the share of each pair, bandwidth and ridge of the pair of least score, and the weights for each bandwidth used;
        p_value of the test of the quadratic class, where it was tried by default (0: not to be relied on at all)

    Examples
    --------
    >>> import numpy as np
    >>> import oee_tabular as oee
    >>> rng = np.random.default_rng(0)
    >>> fit = oee.density_ratio_samples(rng.normal(1, 1, 2000), rng.normal(0, 1, 2000), features="linear")
    >>> fit.at([0.0, 1.0]).round(1).tolist(), np.exp([-0.5, 0.5]).round(1).tolist()  # fitted, true
    ([0.6, 1.6], [0.6, 1.6])
    """

    p_ratio: Array
    q_ratio: Array
    gap: float
    method: str
    _function: Callable[[Array], Array] = field(repr=False)
    _dimension: int = field(repr=False)
    details: dict[str, Any] = field(default_factory=dict)

    def at(self, x: ArrayLike) -> Array:
        """g at new points, (n,) or (n, d)."""
        points = sample_points(x, "x")
        if points.shape[1] != self._dimension:
            raise ValueError(
                f"x must have points of dimension {self._dimension}, as x_p has; they have dimension {points.shape[1]}"
            )
        return self._function(points)


def sample_points(value: object, name: str) -> Array:
    """(n, d) finite points from (n,) or (n, d); at least 2 of a sample, 1 of "x"."""
    array = _checks.float_array(value, name, ndim=(1, 2))
    _checks.require_finite(array, name)
    if array.size == 0:
        raise ValueError(f"{name} must have at least one point; it is empty")
    points = array.reshape(len(array), -1)
    if len(points) < 2 and name != "x":
        raise ValueError(f"{name} must have at least 2 points; it has {len(points)}")
    return points
