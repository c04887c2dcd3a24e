"""Families of machines and chains: wear, a forest, a river, a corridor, a valley."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.shift import Maker, Moves, shift
from oee_tabular.typing import IntArray


def machine(wear: IntArray, action: IntArray, one: float, two: float) -> Moves:
    """Return the transitions of a machine with wear 0 to 11.

    Actions are keep, repair (half of the wear, which costs 2) and replace (which costs
    6). A worn machine earns less and wears by 0, 1 or 2.
    """
    after = np.choose(action, [wear, wear // 2, 0])
    return (1 - one - two, after), (one, after + 1), (two, after + 2)


def mountain(place: IntArray, action: IntArray, pull: float) -> Moves:
    """Return the transitions in a valley of 25 places.

    Actions are push left, rest and push right. The slope pulls back; the top on the
    right ends the episode with reward 10.
    """
    slope = pull * (place - 10) / 14
    right = 0.3 + 0.2 * (action - 1) - slope
    left = 0.3 - 0.2 * (action - 1) + slope
    return (right, place + 1), (left, place - 1), (1 - left - right, place)


CHAINS: dict[str, Maker] = {
    "machine": shift(
        "Machines wear out faster than simulated.",
        (12, 3),
        4.0 - 0.05 * np.arange(12.0)[:, None] ** 2 - np.array([0.0, 2.0, 6.0]),
        0.97,
        (0.3, 0.05),
        (0.4, 0.15),
        machine,
        recorded=0.9,
    ),
    # Ages are 0 to 11, actions wait and cut. A fire takes the forest back to 0. A cut
    # has the reward of the age's wood, the oldest forest 1 a year.
    "forest12": shift(
        "Fires are twice as frequent as simulated.",
        (12, 2),
        np.stack([np.arange(12) == 11, 0.15 * np.arange(12.0)], axis=1),
        0.96,
        (0.08,),
        (0.16,),
        lambda age, cut, fire: [(1 - fire, np.where(cut, 0, age + 1)), (fire, 0)],
        length=40,
    ),
    # There are nine places. Swimming up works with some probability, and the current
    # takes back. The reward is small below and large above.
    "river_swim": shift(
        "The current is stronger than simulated.",
        (9, 2),
        np.array([[0.05, 0.0], *[[0.0, 0.0]] * 7, [0.0, 1.0]]),
        0.98,
        (0.35, 0.10),
        (0.32, 0.16),
        lambda s, swim, up, back: [
            (swim * up, s + 1),
            (np.where(swim, back, 1.0), s - 1),
            (swim * (1 - up - back), s),
        ],
        length=20,
    ),
    # There are 30 places, left or right, with an end to the right. A slip goes the
    # other way, and every step costs 1.
    "corridor30": shift(
        "Steps slip more often than simulated.",
        (30, 2),
        np.append(-np.ones(29), 0.0),
        0.98,
        (0.2,),
        (0.35,),
        lambda s, right, slip: [
            (1 - slip, s + 2 * right - 1),
            (slip, s - 2 * right + 1),
        ],
        start=range(29),
        ends=[29],
        recorded=0.9,
    ),
    "mountain": shift(
        "The slopes of the valley are steeper than simulated.",
        (25, 3),
        lambda s, a, to: np.where(
            (to == 24) & (s != 24), 10.0, np.where(s == 24, 0.0, -0.02 * np.abs(a - 1))
        ),
        0.99,
        (0.04,),
        (0.16,),
        mountain,
        start=range(5, 16),
        ends=[24],
    ),
}
