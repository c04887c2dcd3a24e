"""Kinds of living things: doses of a drug, weeds, a pupil."""

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
    binomial,
    poisson,
)
from oee_tabular.lab.bench.shift import Moves
from oee_tabular.typing import IntArray

LEVEL, ORGAN = np.indices((15, 4)).reshape(2, 60)


def dosing(s: IntArray, a: IntArray, clearance: float, harm: float) -> Moves:
    """Give doses 0 to 3; the organ that clears the drug suffers from much of it."""
    level, organ = parts(s, 15, 4)
    law = binomial(level, np.clip(clearance - 0.06 * organ, 0.03, 1))
    k = np.arange(law.shape[-1])
    rises = np.where(level > 8, harm, 0.03)
    for p, then in ((rises, organ + 1), (0.1, organ - 1), (0.9 - rises, organ)):
        yield p * law + 0.0 * a, clipped((15, 4), level + 2 * a - k, then)


DOSING = Kind(
    "The drug is cleared more slowly than simulated.",
    (60, 4),
    (1.0 * ((LEVEL >= 4) & (LEVEL <= 8)) - 0.1 * LEVEL / 4 - 0.4 * ORGAN)[:, None]
    - 0.05 * np.arange(4.0),
    0.95,
    both(
        between((0.3, 0.45), (0.15, 0.3)),
        between((0.6, 1.05), (0.8, 1.6)),
    ),
    dosing,
)


def weeds(s: IntArray, a: IntArray, growth: float, spray: float) -> Moves:
    """Leave, spray or burn a field with weeds 0 to 24."""
    killed = np.choose(a, [0.02, spray, 0.8])
    left = s * (1 - killed)
    return [(poisson(0.3 + left + growth * left * (1 - left / 30), 24), np.arange(25))]


WEEDS = Kind(
    "Weeds resist the spray more than simulated.",
    (25, 3),
    -0.15 * np.arange(25.0)[:, None] - np.array([0.0, 0.5, 1.5]),
    0.95,
    both(
        between((0.3, 0.5), (0.5, 0.7)),
        between((0.9, 1.3), (0.5, 1.0)),
    ),
    weeds,
)
SKILL, FATIGUE = np.indices((10, 5)).reshape(2, 50)


def tutoring(s: IntArray, a: IntArray, easy: float, hard: float, tires: float) -> Moves:
    """Give an easy lesson, a hard one or a rest; skill 0 to 9, fatigue 0 to 4."""
    skill, fatigue = parts(s, 10, 5)
    fresh = 1 - 0.15 * fatigue
    learns = np.choose(a, [easy * fresh * (1 - skill / 12), hard * fresh, 0.02])
    forgets = np.choose(a, [0.03, 0.06, 0.08])
    more = np.choose(a, [0.5 * tires, tires, 0.02])
    less = np.choose(a, [0.05, 0.02, 0.6])
    return independent(
        (10, 5),
        ((learns, skill + 1), (forgets, skill - 1), (1 - learns - forgets, skill)),
        ((more, fatigue + 1), (less, fatigue - 1), (1 - more - less, fatigue)),
    )


TUTORING = Kind(
    "Hard lessons teach less than simulated, and tire more.",
    (50, 3),
    (0.1 * SKILL - 0.1 * FATIGUE)[:, None] - np.array([0.0, 0.1, 0.0]),
    0.97,
    both(
        between((0.25, 0.4), (0.3, 0.45), (0.25, 0.4)),
        between((0.9, 1.2), (0.4, 0.95), (0.9, 1.5)),
    ),
    tutoring,
)
