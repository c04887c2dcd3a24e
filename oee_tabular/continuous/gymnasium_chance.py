"""The random numbers that a Gymnasium environment draws in a step, as a disturbance: quantiles of standard normal numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import ndtr

from oee_tabular._checks import Array, IntArray

MOST = 64  # draws in a step


class Chance:
    """Stands in for ``np_random``: its numbers are the quantiles at xi, one after the other; at xi = 0 the medians.

    What it has is what steps draw: normal, uniform and whole numbers. Another draw is an AttributeError, more than xi has an
    IndexError.

    >>> chance = Chance(np.array([0.0, 1.0, 0.0]))
    >>> chance.uniform(-1.0, 1.0), chance.normal(2.0, 0.5), chance.integers(5), chance.used
    (0.0, 2.5, 2, 3)
    """

    def __init__(self, xi: Array) -> None:
        self._xi, self.used = xi, 0

    def standard_normal(self, size: Any = None) -> Any:
        """N(0, 1)."""
        n = 1 if size is None else int(np.prod(size))
        if self.used + n > len(self._xi):
            raise IndexError(
                f"a step must draw at most {len(self._xi)} random numbers, as when it was recorded; it draws more"
            )
        found = self._xi[self.used : self.used + n]
        self.used += n
        return float(found[0]) if size is None else found.reshape(size).copy()

    def _shaped(self, size: Any, *bounds: Any) -> Any:
        shape = np.broadcast_shapes(*(np.shape(bound) for bound in bounds))
        return size if size is not None or shape == () else shape

    def normal(self, loc: object = 0.0, scale: object = 1.0, size: object = None) -> Any:
        """N(loc, scale^2)."""
        loc, scale = _arrays(loc, scale)
        return loc + scale * self.standard_normal(self._shaped(size, loc, scale))

    def random(self, size: object = None) -> Any:
        """Uniform on [0, 1)."""
        found = np.minimum(ndtr(self.standard_normal(size)), np.nextafter(1.0, 0.0))
        return float(found) if size is None else found

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """Uniform on [low, high)."""
        low, high = _arrays(low, high)
        return low + (high - low) * self.random(self._shaped(size, low, high))

    def integers(self, low: int, high: int | None = None, size: object = None, *, endpoint: bool = False) -> Any:
        """Whole numbers from low to below high; from 0 to below low where there is no high."""
        start, end = (0, low) if high is None else (low, high)
        found = start + np.floor((end + endpoint - start) * np.asarray(self.random(size))).astype(np.int64)
        return int(found) if size is None else found


def _arrays(*values: Any) -> list[Any]:
    return [np.asarray(value, dtype=np.float64) if np.ndim(value) else float(value) for value in values]


def draws_of(task: Any, states: Array, numbers: IntArray) -> int:
    """The most random numbers that one of these steps of a GymnasiumTask draws; 0: none, or others than ``Chance`` has."""
    most, xi = 0, np.random.default_rng(0).standard_normal((len(states), MOST))
    for i in range(len(states)):
        chance = Chance(xi[i])
        try:
            task.one_by_one(states[i : i + 1], numbers[i : i + 1], [chance])
        except (AttributeError, IndexError, TypeError, ValueError):
            return 0
        most = max(most, chance.used)
    return most
