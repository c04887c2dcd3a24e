"""Draws of the parameters of a simulator and of its target."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Generator = np.random.Generator


def between(*ranges: tuple[float, float]) -> Callable[[Generator], tuple[float, ...]]:
    """Return a function that draws a number from each range."""
    return lambda rng: tuple(float(rng.uniform(*ends)) for ends in ranges)


def both(
    believed: Callable[[Generator], tuple[float, ...]],
    factors: Callable[[Generator], tuple[float, ...]],
) -> Callable[[Generator], tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return a function that draws parameters, and the same times drawn factors."""

    def draw(rng: Generator) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Draw the simulator's parameters and the target's."""
        own = believed(rng)
        return own, tuple(x * f for x, f in zip(own, factors(rng), strict=True))

    return draw
