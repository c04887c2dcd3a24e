"""Columns of a log in another unit than the simulator's: degrees for radians, mm for m."""

from __future__ import annotations

import itertools

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, shortest

FACTORS = {
    "degrees for radians": np.pi / 180.0, "radians for degrees": 180.0 / np.pi,
    "mm for m": 1e-3, "m for mm": 1e3, "cm for m": 1e-2, "m for cm": 1e2,
}  # fmt: skip
N_ROWS = 500  # of the log by which it is judged
MAX_COORDINATES = 8  # of more no test is made
MISSED, MET = (
    0.5,
    0.1,
)  # shares of a displacement: a unit brings a coordinate from beyond the first to within the second


def other_units(task: ContinuousTask, log: ContinuousTransitions, actions: IntArray, periods: Array) -> str:
    """Which columns by which factor c make the simulator's step the log's; "" where the steps are like or no factor does.

        miss(c)_k = min(1, |c s' - f(c s, a)|_k^2 / |c s' - c s|_k^2),   c a factor for each column

    Columns one by one, and in pairs by the same factor: the least sum of misses of those that bring a coordinate from more than
    half to less than a tenth. One call of f with 500 rows, some 200 where a coordinate is missed; not done beyond eight.
    """
    rows = np.linspace(0, len(log) - 1, min(N_ROWS, len(log))).astype(np.int64)

    def miss(factors: Array) -> Array:
        before, after = factors * log.state[rows], factors * log.next_state[rows]
        with np.errstate(all="ignore"):  # states that no simulator was made for
            own = task.noiseless_step(before, actions[rows]).next_state
            left, moved = ((shortest(x, periods) ** 2).sum(axis=0) for x in (after - own, after - before))
        return np.asarray(np.where(moved > 0, np.minimum(1.0, left / np.where(moved > 0, moved, 1.0)), 0.0))

    d, plain = task.n_state, np.zeros(1)
    if d <= MAX_COORDINATES:
        plain = miss(np.ones(d))
    is_missed, least, text = plain > MISSED, plain.sum(), ""
    pairs = itertools.combinations_with_replacement(range(d), 2) if is_missed.any() else ()
    for columns in sorted(pairs, key=lambda pair: pair[0] != pair[1]):  # one column first
        for unit, factor in FACTORS.items():
            factors = np.ones(d)
            factors[list(columns)] = factor
            missed = miss(factors)
            if (is_missed & (missed < MET)).any() and missed.sum() < least:
                least, text = (
                    missed.sum(),
                    f"{' and '.join(task.state_names[k] for k in dict.fromkeys(columns))} ({unit})",
                )
    return text
