"""Families of stocks and queues: an inventory, a queue, two stations in line."""

from __future__ import annotations

from typing import Any, Unpack

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exceptions import ArgumentError
from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import poisson
from oee_tabular.lab.bench.shift import Maker, Moves, PairOptions, shift
from oee_tabular.typing import Array, IntArray

HIGHER = "Customers ask for more than simulated."
LINE = (0.45, 0.5, 0.7)  # arrivals, slow and fast service of the simulated queue


def inventory(
    believed: float,
    demand: float,
    about: str,
    n_states: int = 20,
    step: int = 3,
    **options: Unpack[PairOptions],
) -> Maker:
    """Return a maker of a stock with Poisson demand.

    Orders are 0 to 4 times ``step``. The price is 3, the cost 1, holding costs .1 a
    unit, and sales beyond the stock are lost.
    """

    def fill(stock: IntArray, order: IntArray) -> Any:
        """Return the stock after the order."""
        return np.minimum(stock + step * order, n_states - 1)

    def profit(s: IntArray, a: IntArray, to: IntArray) -> Array:
        """Return the reward of a transition between two stocks."""
        return np.asarray(3.0 * (fill(s, a) - to) - (fill(s, a) - s) - 0.1 * to)

    def moves(stock: IntArray, order: IntArray, mean: float) -> Moves:
        """Return the transitions of the stock."""
        full = fill(stock, order)
        return [(poisson(mean, full), full - np.arange(n_states))]

    return shift(
        about, (n_states, 5), profit, 0.95, (believed,), (demand,), moves, **options
    )


def queue(real: tuple[float, ...], about: str, *, recorded: float = 0.5) -> Maker:
    """Return a maker of a queue of at most 25 jobs.

    ``real`` has the target's probabilities of an arrival, of slow service and of fast
    service in a step. A job costs .1 a step, fast service .4.
    """

    def moves(jobs: IntArray, fast: IntArray, arrival: float, *service: float) -> Moves:
        """Return the transitions of the number of jobs."""
        done = np.where(jobs > 0, np.choose(fast, service), 0.0)
        yield arrival * (1 - done), jobs + 1
        yield (1 - arrival) * done, jobs - 1
        yield arrival * done + (1 - arrival) * (1 - done), jobs

    cost = -0.1 * np.arange(25.0)[:, None] - 0.4 * np.arange(2.0)
    return shift(
        about, (25, 2), cost, 0.98, LINE, real, moves, length=50, recorded=recorded
    )


@suggest_keywords
def tandem(size: int = 45) -> Family:
    """Make two stations in line, where the target has more arrivals and slower service.

    Each station holds fewer than ``size`` jobs and serves slowly or fast.

    Parameters
    ----------
    size : int, default 45
        Number of lengths of each queue, at least 2; S = size * size.

    Returns
    -------
    Family
        The policy is fast at a station with more than 3 jobs. The data are of uniform
        actions, in episodes of 8000 steps from the empty stations.

    See Also
    --------
    families : The families of the package by name.

    Examples
    --------
    >>> family = tandem(9)
    >>> family.simulator.n_states, round(family.truth, 1)
    (81, -98.7)
    """
    size = _checks.positive_integer(size, "size")
    if size < 2:
        raise ArgumentError("size", f"must be at least 2; it is {size}")
    _checks.require_memory(3000.0 * size * size, "size", size, size=1)

    def moves(
        state: IntArray, action: IntArray, arrival: float, first: float, second: float
    ) -> Moves:
        """Return the transitions of both queues."""
        i, j = np.divmod(state, size)
        fast_2, fast_1 = np.divmod(action, 2)
        one = first * np.where(fast_1, 1.6, 1.0)
        two = second * np.where(fast_2, 1.6, 1.0)
        yield arrival, np.minimum(i + 1, size - 1) * size + j
        yield one, np.where(i > 0, (i - 1) * size + np.minimum(j + 1, size - 1), state)
        yield two, np.where(j > 0, state - 1, state)
        yield 1.0 - arrival - one - two, state

    i, j = np.divmod(np.arange(size * size), size)
    cost = -(i + 1.5 * j)[:, None] / 10 - np.array([0.0, 0.6, 0.8, 1.4])
    about = (
        "More arrivals and slower service at both stations of a line than simulated."
    )
    return shift(
        about,
        cost.shape,
        cost,
        0.99,
        (0.20, 0.22, 0.23),
        (0.25, 0.20, 0.22),
        moves,
        policy=np.eye(4)[(i > 3) + 2 * (j > 3)],
        start=0,
        recorded=0.0,
        length=8000,
    )()


STOCKS: dict[str, Maker] = {
    "inventory20": inventory(4.0, 5.2, HIGHER),
    "inventory_slack": inventory(4.0, 3.0, "Customers ask for less than simulated."),
    "inventory40": inventory(7.0, 8.5, HIGHER, 40, 5, recorded=0.9),
    "inventory_identical": inventory(4.0, 4.0, "The simulator of the stock is right."),
    "queue25": queue(
        (0.55, 0.5, 0.7), "Jobs arrive more often than simulated.", recorded=0.0
    ),
    "queue_slower": queue((0.45, 0.42, 0.6), "Service is slower than simulated."),
    "queue_identical": queue(
        LINE, "The simulator of the queue is right.", recorded=0.9
    ),
    "tandem9": lambda: tandem(9),
}
