"""Kinds that move on places: a windy floor, a patrol, a road, aisles, sailing."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.families_redrawn.coordinates import (
    COLUMNS_RIGHT,
    ROWS_UP,
    clipped,
    parts,
)
from oee_tabular.lab.bench.families_redrawn.draws import (
    Generator,
    between,
    both,
)
from oee_tabular.lab.bench.families_redrawn.kind import Kind
from oee_tabular.lab.bench.laws import (
    normalize,
)
from oee_tabular.lab.bench.shift import Moves
from oee_tabular.typing import Array, IntArray


def wind_columns(s: IntArray, a: IntArray, wind: Array) -> Moves:
    """Move on 8 x 8 places; in each column a wind blows one row up."""
    row, column = parts(s, 8, 8)
    blown = wind[column]
    down = row + ROWS_UP[a]
    right = column + COLUMNS_RIGHT[a]
    yield 0.85 * (1 - blown), clipped((8, 8), down, right)
    yield 0.85 * blown, clipped((8, 8), down - 1, right)
    for k in range(4):
        to = clipped((8, 8), row + ROWS_UP[k], column + COLUMNS_RIGHT[k])
        yield 0.0375 + 0.0 * a, to


def draw_wind(rng: Generator) -> tuple[tuple[Array], tuple[Array]]:
    """Draw a wind, and one that is stronger in the middle columns."""
    calm = rng.uniform(0.03, 0.12, 8)
    stronger = calm.copy()
    stronger[2:6] += rng.uniform(0.05, 0.3)
    return (calm,), (stronger,)


WIND_COLUMNS = Kind(
    "The wind over four of eight columns is stronger than simulated.",
    (64, 4),
    np.append(-np.ones(63), 0.0),
    0.97,
    draw_wind,
    wind_columns,
    start=range(63),
    ends=[63],
)


def patrol(s: IntArray, a: IntArray, ahead: float, back: float) -> Moves:
    """Walk a ring of eight places, in which somebody else walks too."""
    guard, other = parts(s, 8, 8)
    walked = guard + a - 1
    for p, here in ((0.9, walked), (0.1, guard)):
        for q, there in (
            (ahead, other + 1),
            (back, other - 1),
            (1 - ahead - back, other),
        ):
            yield p * q + 0.0 * a, here % 8 * 8 + there % 8


PATROL = Kind(
    "Who is looked for walks one way more often than simulated.",
    (64, 3),
    np.where(np.arange(64) // 8 == np.arange(64) % 8, 1.0, 0.0)[:, None]
    - np.array([0.05, 0.0, 0.05]),
    0.95,
    both(
        between((0.2, 0.3), (0.2, 0.3)),
        between((1.1, 2.0), (0.5, 1.0)),
    ),
    patrol,
)
LANE, GAP = np.indices((5, 10)).reshape(2, 50)


def crossing(s: IntArray, a: IntArray, gap: float, slow: float) -> Moves:
    """Cross a road of three lanes; the state has the time to the next car."""
    place, time = parts(s, 5, 10)
    k = np.arange(1, 10)
    law = normalize(np.power(gap, k, dtype=np.float64))
    steps = np.where(a == 1, 1 - slow, np.where(place > 0, 0.3, 0.02))
    for p, here in ((steps, place + 1), (1 - steps, place)):
        passes = time > 0
        yield p * passes * 0.8, clipped((5, 10), here, time - 1)
        yield p * passes * 0.2, clipped((5, 10), here, time - 2)
        yield p * ~passes * law, clipped((5, 10), here, k)


CROSSING = Kind(
    "Cars follow each other more closely than simulated.",
    (50, 2),
    np.where(LANE == 4, 0.0, -0.2 - 4.0 * ((LANE > 0) & (GAP == 0))),
    0.97,
    both(
        between((0.9, 1.1), (0.1, 0.2)),
        between((0.6, 0.95), (0.9, 1.4)),
    ),
    crossing,
    start=range(10),
    ends=range(40, 50),
    length=40,
)


def warehouse(s: IntArray, a: IntArray, blocked: Array) -> Moves:
    """Drive along aisles; each of the eight is blocked for some of the time."""
    row, column = parts(s, 7, 8)
    stuck = np.where(a < 2, blocked[column], 0.05)
    yield 1 - stuck, clipped((7, 8), row + ROWS_UP[a], column + COLUMNS_RIGHT[a])
    yield 0.8 * stuck, s
    yield 0.2 * stuck, clipped((7, 8), row, column + 1)


def draw_blocked(rng: Generator) -> tuple[tuple[Array], tuple[Array]]:
    """Draw how often aisles are blocked, and with three that are so more often."""
    usual = rng.uniform(0.05, 0.25, 8)
    worse = usual.copy()
    worse[rng.permutation(8)[:3]] += rng.uniform(0.1, 0.45)
    return (usual,), (worse,)


WAREHOUSE = Kind(
    "Three of eight aisles are blocked more often than simulated.",
    (56, 4),
    np.append(-np.ones(55), 0.0),
    0.97,
    draw_blocked,
    warehouse,
    start=range(55),
    ends=[55],
)


def sailing(s: IntArray, a: IntArray, turns: float, against: float) -> Moves:
    """Sail on 5 x 5 places; the state has one of four winds, which turns."""
    row, column, wind = parts(s, 5, 5, 4)
    # winds and courses in the order north, south, west, east
    opposite = np.array([1, 0, 3, 2])
    moves = np.where(a == opposite[wind], against, np.where(a == wind, 0.95, 0.8))
    to = clipped((5, 5), row + ROWS_UP[a], column + COLUMNS_RIGHT[a])
    for p, place in ((moves, to), (1 - moves, row * 5 + column)):
        yield p * (1 - turns), place * 4 + wind
        for k in (1, 2, 3):
            yield p * turns / 3, place * 4 + (wind + k) % 4


SAILING = Kind(
    "The wind turns more often than simulated, and boats sail worse against it.",
    (100, 4),
    np.append(-np.ones(96), np.zeros(4)),
    0.97,
    both(
        between((0.1, 0.25), (0.3, 0.5)),
        between((0.8, 2.0), (0.4, 1.1)),
    ),
    sailing,
    start=range(96),
    ends=range(96, 100),
)
