"""Columns of a log that are in another unit than the simulator's."""

from __future__ import annotations

import itertools

import numpy as np

from oee_tabular import _printing
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    shortest,
)
from oee_tabular.typing import Array, IntArray

UNITS = {  # units of a column, and their factors to the simulator's
    "degrees for radians": np.pi / 180.0,
    "radians for degrees": 180.0 / np.pi,
    "mm for m": 1e-3,
    "m for mm": 1e3,
    "cm for m": 1e-2,
    "m for cm": 1e2,
}
N_UNIT_ROWS = 500  # rows of the log by which units are judged
MAX_UNIT_COORDINATES = 8  # with more coordinates units are not judged
# shares of a displacement: more is missed in a wrong unit, less in the right one
MIN_WRONG_UNIT_MISS = 0.5
MAX_RIGHT_UNIT_MISS = 0.1


def other_units(
    task: ContinuousTask, log: ContinuousTransitions, actions: IntArray, periods: Array
) -> str:
    """Describe which columns are in another unit than the simulator's, and in which.

        miss(c)_k = min(1, |c s' - f(c s, a)|_k^2 / |c s' - c s|_k^2),
        c a factor for each column

    Columns are tried one by one, and in pairs by the same factor: it is the least sum
    of misses of those that bring a coordinate from more than half to less than a tenth.
    Returns "" where no column is in another unit, or no factor makes steps alike. Costs
    one call of f with 500 rows, some 200 where a coordinate is missed.
    """
    d = task.n_state
    rows = np.linspace(0, len(log) - 1, min(N_UNIT_ROWS, len(log))).astype(np.int64)
    if d > MAX_UNIT_COORDINATES:
        return ""

    def miss(factors: Array) -> Array:
        """Return the share (d,) of each displacement that the simulator misses."""
        before = factors * log.state[rows]
        after = factors * log.next_state[rows]
        with np.errstate(all="ignore"):  # states that no simulator was made for
            own = task.noiseless_step(before, actions[rows]).next_state
            left = (shortest(after - own, periods) ** 2).sum(axis=0)
            moved = (shortest(after - before, periods) ** 2).sum(axis=0)
        share = np.minimum(1.0, left / np.where(moved > 0, moved, 1.0))
        return np.asarray(np.where(moved > 0, share, 0.0))

    plain = miss(np.ones(d))
    is_missed = plain > MIN_WRONG_UNIT_MISS
    least = plain.sum()
    text = ""
    if not is_missed.any():
        return ""
    groups = [(k,) for k in range(d)] + list(itertools.combinations(range(d), 2))
    for columns, (unit, factor) in itertools.product(groups, UNITS.items()):
        missed = miss(np.where(np.isin(np.arange(d), columns), factor, 1.0))
        is_met = is_missed & (missed < MAX_RIGHT_UNIT_MISS)
        if is_met.any() and missed.sum() < least:
            names = _printing.listing([task.state_names[k] for k in columns])
            least = missed.sum()
            text = f"{names} ({unit})"
    return text
