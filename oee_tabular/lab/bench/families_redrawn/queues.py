"""Kinds with queues: callers, packets, small and large jobs, bikes of a station."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.families_redrawn.coordinates import (
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
    cross,
    poisson,
)
from oee_tabular.lab.bench.shift import Moves
from oee_tabular.typing import Array, IntArray


def call_centre(s: IntArray, a: IntArray, calls: float, patience: float) -> Moves:
    """Serve callers by one to three agents; who waits may hang up."""
    leaves = 0.7 * np.minimum(s, a + 1) + patience * np.maximum(s - a - 1, 0)
    law = cross(
        np.broadcast_to(poisson(calls, 6), (*np.broadcast(s, a).shape[:2], 7)),
        poisson(leaves, s),
    )
    come, gone = np.divmod(np.arange(7 * 26), 26)
    yield law, s + come - np.minimum(gone, s)


CALL_CENTRE = Kind(
    "More people call than simulated, and they hang up less often.",
    (26, 3),
    -0.2 * np.arange(26.0)[:, None] - np.array([0.0, 0.5, 1.0]),
    0.95,
    both(
        between((1.0, 1.6), (0.1, 0.25)),
        between((1.0, 1.35), (0.5, 1.0)),
    ),
    call_centre,
)


def packet_routing(s: IntArray, a: IntArray, loss: Array) -> Moves:
    """Send a packet through six layers of five nodes; a lost one is sent again."""
    layer, node = parts(np.minimum(s, 29), 6, 5)
    lost = loss[np.minimum(s, 29)] * (0.7 + 0.3 * a)
    for share, off in ((0.9, a - 1), (0.05, 0), (0.05, 1)):
        to = np.clip(node + off, 0, 4)
        yield share * (1 - lost), np.where(layer < 5, (layer + 1) * 5 + to, 30)
    yield lost, s


def draw_loss(rng: Generator) -> tuple[tuple[Array], tuple[Array]]:
    """Draw losses, and those of a network with a congested part."""
    usual = rng.uniform(0.05, 0.2, 30)
    busy = usual + np.where(rng.random(30) < 0.3, rng.uniform(0.1, 0.4), 0.0)
    return (usual,), (busy,)


PACKET_ROUTING = Kind(
    "A part of the network, here and there, is congested.",
    (31, 3),
    np.append(-np.ones(30), 0.0),
    0.98,
    draw_loss,
    packet_routing,
    start=range(5),
    ends=[30],
    length=50,
)
SMALL_JOBS, LARGE_JOBS = np.indices((7, 7)).reshape(2, 49)


def admission(s: IntArray, a: IntArray, large: float, service: float) -> Moves:
    """Admit no jobs, small ones or all to two queues of at most six."""
    small_jobs, large_jobs = parts(s, 7, 7)
    takes_small = 0.25 * (a > 0)
    takes_large = large * (a > 1)
    serves = 0.2 * (small_jobs > 0)
    slow = service * (large_jobs > 0)
    return (
        (takes_small, clipped((7, 7), small_jobs + 1, large_jobs)),
        (takes_large, clipped((7, 7), small_jobs, large_jobs + 1)),
        (serves, clipped((7, 7), small_jobs - 1, large_jobs)),
        (slow, clipped((7, 7), small_jobs, large_jobs - 1)),
        (1 - takes_small - takes_large - serves - slow, s),
    )


ADMISSION = Kind(
    "Large jobs come more often than simulated, and take longer.",
    (49, 3),
    -0.15 * (SMALL_JOBS + 2 * LARGE_JOBS)[:, None] + np.array([0.0, 0.6, 1.1]),
    0.96,
    both(
        between((0.12, 0.18), (0.16, 0.22)),
        between((1.0, 1.4), (0.6, 1.0)),
    ),
    admission,
)
BIKES = np.indices((13, 6)).reshape(2, 78)[0]


def bike_station(s: IntArray, a: IntArray, taken: Array, brought: Array) -> Moves:
    """Bring or take three bikes of a station with 0 to 12, in six hours of a day."""
    bikes, hour = parts(s, 13, 6)
    here = np.clip(bikes + 3 * (a - 1), 0, 12)
    out = poisson(taken[hour], 6)
    back = poisson(brought[hour], 6)
    law = cross(*np.broadcast_arrays(out, back))
    gone, come = np.divmod(np.arange(49), 7)
    to = np.clip(np.maximum(here - gone, 0) + come, 0, 12)
    yield law + 0.0 * a[..., :1], to * 6 + (hour + 1) % 6


def draw_hours(rng: Generator) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Draw the riders of each hour, and those of rainy or later days."""
    taken = rng.uniform(0.4, 2.5, 6)
    brought = rng.uniform(0.4, 2.5, 6)
    mixed = float(rng.uniform(0.2, 0.8))
    later = (1 - mixed) * taken + mixed * np.roll(taken, 1)
    return (taken, brought), (later * rng.uniform(0.8, 1.3), brought)


BIKE_STATION = Kind(
    "Riders come at other hours than simulated.",
    (78, 3),
    np.where((BIKES >= 2) & (BIKES <= 10), 1.0, 0.0)[:, None]
    - np.array([0.3, 0.0, 0.3]),
    0.95,
    draw_hours,
    bike_station,
)
