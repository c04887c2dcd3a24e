"""Kinds that wear: the engines of buses, and sections of a road."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.families_redrawn.draws import (
    Generator,
    between,
    both,
)
from oee_tabular.lab.bench.families_redrawn.kind import Kind
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.shift import Moves
from oee_tabular.typing import Array, IntArray


def bus_engines(s: IntArray, a: IntArray, *months: float) -> Moves:
    """Run a bus for a month or replace its engine first: 0, 1 or 2 more of 90 steps."""
    here = np.where(a == 1, 0, s)
    for k, p in enumerate(months):
        yield p + 0.0 * a, here + k


def draw_buses(rng: Generator) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Draw the shares of increments around those of two groups of buses.

    J. Rust, Optimal Replacement of GMC Bus Engines, Econometrica 55, 1987, has .307,
    .683 and .010 for group 3, and .392, .595 and .013 for group 4.
    """
    one, two = (
        tuple(float(x) for x in rng.dirichlet(size * np.array(shares)))
        for size, shares in (
            (4000, (0.307, 0.683, 0.01)),
            (4000, (0.392, 0.595, 0.013)),
        )
    )
    return one, two


def replace_seldom(family: Family, rng: Generator) -> Array:
    """Return a policy that takes the second action the more often the more is worn."""
    n = family.simulator.n_states
    share = 0.002 + float(rng.uniform(0.02, 0.06)) * (np.arange(n) / n) ** 2
    return np.stack([1 - share, share], axis=1)


BUS_ENGINES = Kind(
    "Buses of one group run fewer miles in a month than those of another one.",
    (90, 2),
    -np.stack([0.2 * np.arange(90.0) / 10, np.full(90, 8.0)], axis=1),
    0.98,
    draw_buses,
    bus_engines,
    length=60,
)
BUS_MONTHS = Kind(
    "Buses of one group run fewer miles than those of another one; engines are"
    " seldom replaced, and a few months of many buses are recorded.",
    (90, 2),
    -np.stack([0.0023 * np.arange(90.0), np.full(90, 10.0)], axis=1),
    0.99,
    draw_buses,
    bus_engines,
    length=2,
    recorded=replace_seldom,
)


def road_sections(s: IntArray, a: IntArray, slow: float, fast: float) -> Moves:
    """Leave or mend a section of a road with damage 0 to 69, which grows by seasons."""
    here = np.where(a == 1, s // 4, s)
    worn = here > 35
    one = np.where(worn, fast, slow)
    yield one + 0.0 * a, here + 1
    yield 0.1 * one + 0.0 * a, here + 3
    yield 1 - 1.1 * one + 0.0 * a, here


ROAD_SECTIONS = Kind(
    "Damaged sections of a road wear faster than simulated; they are seldom mended,"
    " and a few seasons of many sections are recorded.",
    (70, 2),
    -np.stack([0.02 * np.arange(70.0), np.full(70, 6.0)], axis=1),
    0.98,
    both(
        between((0.35, 0.5), (0.45, 0.6)),
        between((0.9, 1.2), (0.7, 1.3)),
    ),
    road_sections,
    start=range(65),
    length=3,
    recorded=replace_seldom,
)
