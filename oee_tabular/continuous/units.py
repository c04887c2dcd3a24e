"""Columns of a log in another unit than the simulator's: degrees for radians, mm for m."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.task import ContinuousTask

FACTORS = {
    "degrees for radians": np.pi / 180.0, "radians for degrees": 180.0 / np.pi,
    "mm for m": 1e-3, "m for mm": 1e3, "cm for m": 1e-2, "m for cm": 1e2,
}  # fmt: skip
ROWS = 500  # of the log by which it is judged
MOST = 8  # coordinates: of more no test is made
MISSED, MET = (
    0.5,
    0.1,
)  # shares of a displacement: a unit brings a coordinate from beyond the first to within the second


def other_units(
    task: ContinuousTask, states: Array, actions: IntArray, next_states: Array, shortest: Callable[[Array], Array]
) -> str:
    """Which columns by which factor c make the simulator's step the log's; "" where the steps are like or no factor does.

        miss(c)_k = min(1, |c s' - f(c s, a)|_k^2 / |c s' - c s|_k^2),   c a factor for each column

    ``shortest`` brings differences of angles within half a turn. Columns one by one, and in pairs by the same factor: the least
    sum of misses of those that bring a coordinate from more than half to less than a tenth. One call of f with 500 rows, some
    200 where a coordinate is missed; not done beyond eight.
    """
    some = np.linspace(0, len(states) - 1, min(ROWS, len(states))).astype(np.int64)
    s, a, following, d = states[some], actions[some], next_states[some], task.n_state

    def miss(factors: Array) -> Array:
        before, after = factors * s, factors * following
        with np.errstate(all="ignore"):  # states that no simulator was made for
            own = task.moves(before, a, np.zeros((len(a), task.n_disturbances))).next_state
            left, moved = ((shortest(x) ** 2).sum(axis=0) for x in (after - own, after - before))
        return np.asarray(np.where(moved > 0, np.minimum(1.0, left / np.where(moved > 0, moved, 1.0)), 0.0))

    if d > MOST or not ((given := miss(np.ones(d))) > MISSED).any():
        return ""
    best, found = float(given.sum()), ""
    for columns in [*itertools.combinations(range(d), 1), *itertools.combinations(range(d), 2)]:
        for what, factor in FACTORS.items():
            factors = np.ones(d)
            factors[list(columns)] = factor
            now = miss(factors)
            if ((given > MISSED) & (now < MET)).any() and now.sum() < best:
                best, found = float(now.sum()), f"{' and '.join(task.state_names[k] for k in columns)} ({what})"
    return found
