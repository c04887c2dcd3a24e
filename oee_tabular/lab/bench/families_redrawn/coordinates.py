"""Coordinates of states on grids, and transitions of several at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular.lab.bench.shift import Moves
from oee_tabular.typing import IntArray

ROWS_UP = np.array([-1, 1, 0, 0])
COLUMNS_RIGHT = np.array([0, 0, -1, 1])


def parts(state: IntArray, *sizes: int) -> tuple[Any, ...]:
    """Return the coordinates of a state on a grid; the last varies fastest."""
    return np.unravel_index(state, sizes)


def clipped(sizes: tuple[int, ...], *coordinates: Any) -> Any:
    """Return the state at coordinates, each clipped to its size."""
    state: Any = 0
    for size, coordinate in zip(sizes, coordinates, strict=True):
        state = state * size + np.clip(coordinate, 0, size - 1)
    return state


def independent(sizes: tuple[int, ...], *laws: tuple[tuple[Any, Any], ...]) -> Moves:
    """Yield the transitions of coordinates that move independently of each other.

    A law is pairs (probability, new coordinate).
    """
    first, *others = laws
    done: list[tuple[Any, tuple[Any, ...]]] = [(p, (x,)) for p, x in first]
    for law in others:
        done = [(p * q, (*xs, y)) for p, xs in done for q, y in law]
    for p, xs in done:
        yield p, clipped(sizes, *xs)
