"""Kinds that fill and empty: a battery, moisture, a depot and a shop, a warm room."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.families_redrawn.coordinates import (
    clipped,
    independent,
    parts,
)
from oee_tabular.lab.bench.families_redrawn.draws import (
    between,
    both,
)
from oee_tabular.lab.bench.families_redrawn.kind import Kind
from oee_tabular.lab.bench.laws import (
    poisson,
)
from oee_tabular.lab.bench.shift import Moves
from oee_tabular.typing import IntArray

CHARGE, WARMTH = np.indices((10, 5)).reshape(2, 50)


def battery(s: IntArray, a: IntArray, heat: float, wear: float) -> Moves:
    """Charge, drive or boost; a warm battery loses its charge faster."""
    charge, warmth = parts(s, 10, 5)
    use = np.where(charge > 0, a, 0)
    one = np.choose(use, [0.05, 0.35, 0.45]) + wear * warmth
    two = np.choose(use, [0.01, 0.05, 0.25])
    more = np.choose(use, [0.6, 0.01, 0.01])
    rise = heat * np.choose(use, [0.3, 1.0, 2.2])
    return independent(
        (10, 5),
        (
            (more, charge + 1),
            (one, charge - 1),
            (two, charge - 2),
            (1 - more - one - two, charge),
        ),
        ((rise, warmth + 1), (0.25, warmth - 1), (0.75 - rise, warmth)),
    )


BATTERY = Kind(
    "The battery gets warm more easily than simulated.",
    (50, 3),
    np.where(CHARGE > 0, 1.0, 0.0)[:, None] * np.array([0.0, 1.0, 1.7])
    - 0.6 * (WARMTH == 4)[:, None],
    0.96,
    both(
        between((0.08, 0.14), (0.015, 0.03)),
        between((1.0, 1.9), (0.8, 1.8)),
    ),
    battery,
)
WET, STAGE = np.indices((12, 6)).reshape(2, 72)


def irrigation(s: IntArray, a: IntArray, rain: float, dry: float) -> Moves:
    """Water a field with moisture 0 to 11 in six stages of growth."""
    wet, stage = parts(s, 12, 6)
    k = np.arange(6)
    fallen = poisson(rain, 5)
    lost = poisson(dry * (1 + 0.2 * stage), 5)
    for i, j in np.ndindex(6, 6):
        p = fallen[i] * lost[..., j : j + 1] + 0.0 * a
        here = wet + 2 * a + k[i] - k[j]
        yield 0.3 * p, np.clip(here, 0, 11) * 6 + (stage + 1) % 6
        yield 0.7 * p, np.clip(here, 0, 11) * 6 + stage


IRRIGATION = Kind(
    "Less rain falls than simulated, and more water evaporates.",
    (72, 3),
    np.where((WET >= 4) & (WET <= 8), 0.4 + 0.2 * STAGE, 0.0)[:, None]
    - np.array([0.0, 0.3, 0.6]),
    0.95,
    both(
        between((0.6, 1.1), (0.7, 1.1)),
        between((0.5, 1.0), (1.0, 1.5)),
    ),
    irrigation,
)
DEPOT, SHOP = np.indices((7, 9)).reshape(2, 63)


def two_echelon(s: IntArray, a: IntArray, demand: float, supply: float) -> Moves:
    """Order into a depot and ship to a shop, two units each or none."""
    depot, shop = parts(s, 7, 9)
    ship = np.minimum(2 * (a % 2), depot)
    full = np.minimum(shop + ship, 8)
    order = 2 * (a // 2)
    law = poisson(demand, full)
    k = np.arange(law.shape[-1])
    for p, come in ((supply, order), (1 - supply, 0)):
        yield p * law, clipped((7, 9), depot - ship + come, full - k)


TWO_ECHELON = Kind(
    "Customers ask for more than simulated, and suppliers deliver less often.",
    (63, 4),
    (np.minimum(SHOP, 3) - 0.15 * SHOP - 0.1 * DEPOT)[:, None]
    - np.array([0.0, 0.1, 0.5, 0.6]),
    0.95,
    both(
        between((1.0, 1.8), (0.75, 0.9)),
        between((0.9, 1.5), (0.7, 1.05)),
    ),
    two_echelon,
)
ROOM, OUTSIDE = np.indices((15, 4)).reshape(2, 60)


def thermostat(s: IntArray, a: IntArray, leak: float, power: float) -> Moves:
    """Heat a room of 15 temperatures; outside there are four."""
    room, outside = parts(s, 15, 4)
    cooling = np.clip(leak * (room - 2 * outside) / 10, 0.02, 0.6)
    heating = 0.03 + power * a
    up = heating * (1 - cooling)
    down = cooling * (1 - heating)
    return independent(
        (15, 4),
        (
            (0.8 * up, room + 1),
            (0.2 * up, room + 2),
            (down, room - 1),
            (1 - up - down, room),
        ),
        ((0.1, outside + 1), (0.1, outside - 1), (0.8, outside)),
    )


THERMOSTAT = Kind(
    "The walls let out more heat than simulated.",
    (60, 3),
    -np.abs(ROOM - 9.0)[:, None] / 5 - np.array([0.0, 0.15, 0.4]),
    0.95,
    both(
        between((0.3, 0.5), (0.25, 0.35)),
        between((1.0, 1.7), (0.85, 1.1)),
    ),
    thermostat,
)
