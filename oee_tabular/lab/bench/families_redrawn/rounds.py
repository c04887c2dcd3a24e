"""Kinds that end after some rounds: an auction, a dialog, the game of pig."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.families_redrawn.coordinates import (
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


def auction(s: IntArray, a: IntArray, others: float, late: float) -> Moves:
    """Bid 1, 2 or 4 of a budget in each of six rounds."""
    left, budget = parts(np.minimum(s, 89), 6, 15)
    bid = np.minimum(2**a, budget)
    win = 1 - np.exp(-bid / (others + late * (5 - left)))
    after = left - 1
    yield win, np.where(after < 0, 90, after * 15 + budget - bid)
    yield 1 - win, np.where(after < 0, 90, after * 15 + budget)


def auction_pays(s: IntArray, a: IntArray, to: IntArray) -> Array:
    """Pay 3 for what is won, less the bid; the last round pays nothing."""
    spent = np.where(to < 90, s % 15 - to % 15, 0)
    return np.where((s < 90) & (spent > 0), 3.0 - 0.5 * spent, 0.0)


AUCTION = Kind(
    "The others bid more than simulated, above all in the last rounds.",
    (91, 3),
    auction_pays,
    0.99,
    both(
        between((1.2, 2.0), (0.05, 0.15)),
        between((1.05, 1.8), (1.0, 3.0)),
    ),
    auction,
    start=range(80, 90),
    ends=[90],
)


def dialog(s: IntArray, a: IntArray, right: float, wrong: Array) -> Moves:
    """Ask for one of three facts, or submit; each is unknown, wrong or right."""
    known = parts(np.minimum(s, 26), 3, 3, 3)
    asks = a < 3
    bad = wrong[np.minimum(a, 2)]
    here = np.choose(np.minimum(a, 2), known)
    unit = 3 ** (2 - np.minimum(a, 2))
    yield np.where(asks, right, 0.0), s + (2 - here) * unit
    yield np.where(asks, bad, 0.0), s + (1 - here) * unit
    yield np.where(asks, 0.97 - right - bad, 0.0), s
    yield np.where(asks, 0.03, 1.0), 27


def dialog_pays(s: IntArray, a: IntArray, to: IntArray) -> Array:
    """Pay 10 where all three facts are right at the end, else -4; a question costs."""
    submits = (a == 3) & (s < 27)
    return np.where(submits, np.where(s == 26, 10.0, -4.0), -0.4 * (s < 27))


def draw_dialog(rng: Generator) -> tuple[tuple[float, Array], tuple[float, Array]]:
    """Draw how often answers are understood, and worse so for the third fact."""
    right = float(rng.uniform(0.55, 0.65))
    wrong = rng.uniform(0.05, 0.12, 3)
    worse = wrong + np.array([0.0, 0.0, rng.uniform(0.05, 0.2)])
    return (right, wrong), (right * float(rng.uniform(0.9, 1.05)), worse)


DIALOG = Kind(
    "Answers about one of three facts are misunderstood more often than simulated.",
    (28, 4),
    dialog_pays,
    0.98,
    draw_dialog,
    dialog,
    start=[0],
    ends=[27],
    length=50,
)


def pig(s: IntArray, a: IntArray, small: Array, large: Array) -> Moves:
    """Roll one of two dice, of which a one loses the turn, or hold (26 ends)."""
    for k in range(8):
        p = np.choose(a, [small[k], large[k], 0.0])
        yield p, np.where(k == 0, 26, np.minimum(s + k + 1, 25))
    yield np.where(a == 2, 1.0, 0.0), 26


def draw_dice(rng: Generator) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Draw fair dice of four and eight faces, and loaded ones."""
    small = np.append(np.full(4, 0.25), np.zeros(4))
    large = np.full(8, 0.125)
    load = np.exp(-float(rng.uniform(0.02, 0.2)) * np.arange(8))
    return (small, large), (normalize(small * load), normalize(large * load))


PIG = Kind(
    "The dice are loaded: ones come more often than simulated.",
    (27, 3),
    lambda s, a, to: np.where((a == 2) & (s < 26), s, 0.0),
    0.995,
    draw_dice,
    pig,
    start=[0],
    ends=[26],
    length=50,
)
