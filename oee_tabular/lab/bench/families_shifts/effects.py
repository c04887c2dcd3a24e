"""Families whose targets differ in several numbers, by place, by load or by season."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import stats

from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import cross, poisson
from oee_tabular.lab.bench.shift import Moves, shift
from oee_tabular.typing import Array, IntArray

ONE, TWO = np.divmod(np.arange(64), 8)


def coupled_maintenance(
    s: IntArray, action: IntArray, base: float, load: float
) -> Moves:
    """Return the transitions of two parts with wear 0 to 7.

    The bits of the action say which parts are repaired.
    """

    def wear(part: IntArray, is_repaired: IntArray, rate: Array) -> Array:
        """Return the distribution of the next wear of one part."""
        k = np.arange(8)
        new = 0.95 * is_repaired
        old = np.where(is_repaired, 0.05, 1.0)
        law = (
            new * (1 - rate) * (k == 0)
            + new * rate * (k == 1)
            + old * (1 - rate) * (k == part)
        )
        return np.asarray(law + old * rate * (k == np.minimum(part + 1, 7)))

    one, two = np.divmod(s, 8)
    laws = (
        wear(one, action & 1, base + load * two / 7),
        wear(two, action // 2, base + load * one / 7),
    )
    return [(cross(*laws), np.arange(64))]


COUPLED_MAINTENANCE = shift(
    "A worn part wears out the other one; simulated, they wear independently.",
    (64, 4),
    (4 - 0.08 * (ONE**2 + TWO**2))[:, None] - np.array([0.0, 1.5, 1.5, 2.5]),
    0.96,
    (0.3, 0.0),
    lambda rng: (0.2, rng.uniform(0.3, 0.5)),
    coupled_maintenance,
    recorded=0.8,
)
PREY, HUNTERS = np.divmod(np.arange(96), 8)
HARVESTS = np.array([0, 1, 3])


def predator_prey(
    s: IntArray, action: IntArray, growth: float, death: float, bite: float
) -> Moves:
    """Return the transitions of 0 to 11 prey and 0 to 7 predators.

    Harvests are 0, 1 and 3 prey.
    """
    hunters = HUNTERS[s]
    left = np.maximum(PREY[s] - HARVESTS[action], 0)
    mean = np.maximum(
        0.3 + left * (1 + growth * (1 - left / 11)) - bite * left * hunters, 0.1
    )
    more = 0.2 + (1 - death) * hunters + 0.4 * bite * left * hunters
    return [(cross(poisson(mean, 11), poisson(more, 7)), np.arange(96))]


PREDATOR_PREY = shift(
    "Growth, death and hunting all differ from the simulator's.",
    (96, 3),
    np.minimum(PREY[:, None], HARVESTS) ** 0.7 - 0.05 * HUNTERS[:, None],
    0.95,
    (0.8, 0.5, 0.06),
    lambda rng: (
        rng.uniform(0.5, 0.7),
        rng.uniform(0.3, 0.4),
        rng.uniform(0.05, 0.08),
    ),
    predator_prey,
)
PRICES = np.array([1.0, 1.5, 2.0, 3.0])
STOCK = np.arange(176) % 16
# The states are ten weeks with a stock of 0 to 15; there are four prices.
PRICING = shift(
    "More customers come than simulated, and high prices deter more of them.",
    (176, 4),
    PRICES[:, None] * np.maximum(STOCK[:, None] - STOCK, 0)[:, None, :],
    0.99,
    (3.5, 0.8),
    lambda rng: (rng.uniform(4.0, 5.0), rng.uniform(1.1, 1.5)),
    lambda s, a, base, elasticity: [
        (
            poisson(base * np.exp(-elasticity * (PRICES[a] - 1)), s % 16),
            s + 16 - np.arange(16),
        )
    ],
    start=range(8, 16),
    ends=range(160, 176),
)
LEVEL, SEASON = np.divmod(np.arange(60), 4)
SWING = np.array([1.0, 0.6, -0.8, -0.8])


def reservoir(rng: np.random.Generator) -> Family:
    """Make a reservoir of levels 0 to 14 in four seasons.

    Releases are 0 to 3.
    """
    rewards = (
        np.sqrt(np.minimum(LEVEL[:, None], np.arange(4)))
        * np.array([1.0, 0.8, 1.2, 1.5])[SEASON][:, None]
    )
    rewards -= np.select([LEVEL == 14, LEVEL == 0], [2.0, 3.0])[:, None]
    swing = rng.uniform(0.8, 1.1) * SWING
    about = "Seasons differ more than simulated, with the same inflow a year."

    def moves(s: IntArray, action: IntArray, inflows: Array) -> Moves:
        """Return the transitions of level and season."""
        left = np.maximum(LEVEL[s] - action, 0)
        return [
            (
                poisson(inflows[SEASON[s]], 14),
                np.minimum(left + np.arange(15), 14) * 4 + (SEASON[s] + 1) % 4,
            )
        ]

    return shift(
        about, (60, 4), rewards, 0.97, (1.7 + 0.2 * swing,), (1.7 + swing,), moves
    )()


def router_fault(rng: np.random.Generator) -> Family:
    """Make a network of 40 nodes with three links each, one of which fails.

    Node 0 gives a reward and sends the packet anywhere.
    """
    links = np.array([rng.permutation(40)[:3] for _ in range(40)])
    busiest = 1 + int(np.bincount(links.ravel(), minlength=40)[1:].argmax())
    about = "The busiest node loses most packets; the others are as simulated."
    real = (rng.uniform(0.1, 0.25),)

    def moves(node: IntArray, link: IntArray, works: float) -> Moves:
        """Return the transitions of a packet."""
        p = np.where(node == busiest, works, 0.9)
        goes = node > 0
        yield goes * p, links[node, link]
        yield goes * (0.9 * (1 - p)), node
        yield goes * (0.1 * (1 - p) / 3), links[node[:, :, 0]]
        yield (node == 0) / 40, np.arange(40)

    rewards = np.append(5.0, -np.ones(39))
    return shift(about, (40, 3), rewards, 0.96, (0.9,), real, moves, recorded=0.7)()


CARS = np.arange(294) // 7 % 7, np.arange(294) % 7
RATES = np.array([[0.2, 0.3, 0.7, 0.3, 0.2, 0.2], [0.2, 0.2, 0.2, 0.3, 0.6, 0.3]])


def traffic_hours(s: IntArray, green: IntArray, north: Array, west: Array) -> Moves:
    """Return the transitions of two queues of cars over six hours.

    The queues from north and west have 0 to 6 cars; the action says who has green.
    """
    hour = s // 49
    both = np.arange(49)

    def queue(waiting: IntArray, is_green: IntArray, rate: Array) -> Array:
        """Return the distribution of the next length of one queue."""
        leave = np.asarray(stats.binom.pmf(np.arange(3), 2, 0.85 * is_green))
        come = np.asarray(stats.binom.pmf(np.arange(3), 2, rate))
        law = cross(leave, come)
        served, new = np.divmod(np.arange(9), 3)
        after = np.minimum(np.maximum(waiting - served, 0) + new, 6)
        lengths = [
            sum(law[..., k] * (after[..., k] == n) for k in range(9)) for n in range(7)
        ]
        return np.stack(lengths, axis=-1)

    law = cross(
        queue(CARS[0][s], 1 - green, north[hour]), queue(CARS[1][s], green, west[hour])
    )
    return (0.75 * law, 49 * hour + both), (0.25 * law, 49 * ((hour + 1) % 6) + both)


TRAFFIC_HOURS = shift(
    "One rush hour comes later than simulated, and more cars come from the west.",
    (294, 2),
    -0.2 * (CARS[0] + CARS[1]),
    0.95,
    RATES,
    lambda rng: (np.roll(RATES[0], 1), RATES[1] + rng.uniform(0.1, 0.2)),
    traffic_hours,
)
X, Y = np.divmod(np.arange(81), 9)


def two_motors(s: IntArray, action: IntArray, wear: float, overshoots: float) -> Moves:
    """Return the transitions on a table of 9 x 9 places, over 40 steps.

    Each motor moves by -1, 0 or 1.
    """

    def place(at: IntArray, way: IntArray, fails: Any, overshoots: float) -> Array:
        """Return the distribution of the next place along one axis."""
        # A motor that is asked to move goes 0, 1 or 2 places; at rest it drifts.
        shares = [
            np.where(way, fails, 0.03),
            np.where(way, 1 - fails - overshoots, 0.94),
            np.where(way, overshoots, 0.03),
        ]
        after = [np.clip(at + np.where(way, k * way, k - 1), 0, 8) for k in range(3)]
        parts = [p * (to == np.arange(9)) for p, to in zip(shares, after, strict=True)]
        return np.asarray(sum(parts))

    one = place(X[s], action // 3 - 1, 0.1 + wear * X[s] / 8, 0.05)
    return [(cross(one, place(Y[s], action % 3 - 1, 0.1, overshoots)), np.arange(81))]


TWO_MOTORS = shift(
    "One motor fails the more often the farther out it is, and the other one"
    " overshoots.",
    (81, 9),
    -np.hypot(X - 6, Y - 2) / 4,
    0.95,
    (0.0, 0.05),
    lambda rng: (rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.3)),
    two_motors,
    horizon=40,
)
