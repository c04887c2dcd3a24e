"""Stocks, queues, machines and chains: what an operations manual simulates."""

from __future__ import annotations

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.lab.bench.family import Family, Moves, Recorded, model, poisson, shift
from oee_tabular.mdp import uniform_policy
from oee_tabular.mdp.policies import deterministic_policy

Line = tuple[float, float, float]  # arrivals, slow and fast service of a queue


def inventory(
    believed: float, demand: float, about: str, *, n_states: int = 20, step: int = 3, recorded: Recorded = "half"
) -> Family:
    """Poisson demand; order 0 to 4 times ``step``; price 3, cost 1, holding .1 a unit, sales beyond the stock are lost."""
    top = n_states - 1

    def pay(s: IntArray, a: IntArray, to: IntArray) -> Array:
        full = np.minimum(s + step * a, top)
        return np.asarray(3.0 * (full - to) - (full - s) - 0.1 * to)

    @shift((n_states, 5), pay, 0.95, (believed,), (demand,), about, recorded=recorded)
    def moves(stock: int, order: int, mean: float) -> Moves:
        full = min(stock + step * order, top)
        for sold, probability in enumerate(poisson(mean, full)):
            yield probability, full - sold

    return moves()


def queue(believed: Line, real: Line, about: str, *, recorded: Recorded = "half") -> Family:
    """25 jobs at most; (arrival, slow service, fast service) probabilities of a step; a job costs .1, fast service .4."""
    pay = -0.1 * np.arange(25.0)[:, None] - 0.4 * np.arange(2.0)

    @shift((25, 2), pay, 0.98, believed, real, about, recorded=recorded, length=50)
    def moves(jobs: int, fast: int, arrival: float, *service: float) -> Moves:
        done = service[fast] if jobs else 0.0
        yield arrival * (1 - done), min(jobs + 1, 24)
        yield (1 - arrival) * done, max(jobs - 1, 0)
        yield arrival * done + (1 - arrival) * (1 - done), jobs

    return moves()


def tandem(size: int = 45) -> Family:
    """Two stations in line, less than ``size`` jobs each; slow or fast at each; the target has more arrivals, slower service.

    Policy: fast at a station with more than 3 jobs. Data: uniform actions, episodes of 8000 steps from the empty stations.

    Parameters
    ----------
    size : int of at least 2; S = size * size

    Examples
    --------
    >>> family = tandem(9)
    >>> family.simulator.n_states, round(family.truth, 1)
    (81, -98.7)
    """
    top, n_states = size - 1, size * size

    def moves(state: int, action: int, arrival: float, first: float, second: float) -> Moves:
        (i, j), (fast_2, fast_1) = divmod(state, size), divmod(action, 2)
        one, two = first * (1.6 if fast_1 else 1.0), second * (1.6 if fast_2 else 1.0)
        yield arrival, min(i + 1, top) * size + j
        yield one, (i - 1) * size + min(j + 1, top) if i else state
        yield two, i * size + j - 1 if j else state
        yield 1.0 - arrival - one - two, state

    i, j = np.divmod(np.arange(n_states), size)
    pay = -(i + 1.5 * j)[:, None] / 10 - np.array([0.0, 0.6, 0.8, 1.4])
    policy = deterministic_policy((i > 3) + 2 * (j > 3), 4)
    simulator, target = (
        model(moves, (n_states, 4), pay, 0.99, how, start=0) for how in ((0.20, 0.22, 0.23), (0.25, 0.20, 0.22))
    )
    about = "More arrivals and slower service at both stations of a line than simulated."
    return Family(simulator, target, policy, uniform_policy(simulator), about, length=8000)


@shift(
    (12, 3), 4.0 - 0.05 * np.arange(12.0)[:, None] ** 2 - np.array([0.0, 2.0, 6.0]), 0.97, (0.3, 0.05), (0.4, 0.15),
    "Machines wear out faster than simulated.", recorded="policy",
)  # fmt: skip
def machine(wear: int, action: int, one: float, two: float) -> Moves:
    """Wear 0 to 11; keep, repair (half of the wear, 2) or replace (6); a worn machine earns less and wears by 0, 1 or 2."""
    after = (wear, wear // 2, 0)[action]
    yield 1 - one - two, after
    yield one, min(after + 1, 11)
    yield two, min(after + 2, 11)


@shift(
    (12, 2), np.stack([np.arange(12) == 11, 0.15 * np.arange(12.0)], axis=1), 0.96, (0.08,), (0.16,),
    "Fires are twice as frequent as simulated.", length=40,
)  # fmt: skip
def forest(age: int, cut: int, fire: float) -> Moves:
    """Age 0 to 11; wait or cut; a fire takes it back to 0. A cut pays the age's wood, the oldest forest 1 a year."""
    yield 1 - fire, 0 if cut else min(age + 1, 11)
    yield fire, 0


@shift(
    (9, 2), np.array([[0.05, 0.0], *[[0.0, 0.0]] * 7, [0.0, 1.0]]), 0.98, (0.35, 0.10), (0.32, 0.16),
    "The current is stronger than simulated.", length=20,
)  # fmt: skip
def river_swim(place: int, swim: int, up: float, back: float) -> Moves:
    """Nine places; swimming up works with some probability, the current takes back; little pay below, much above."""
    if not swim:
        yield 1.0, max(place - 1, 0)
        return
    yield up, min(place + 1, 8)
    yield back, max(place - 1, 0)
    yield 1 - up - back, place


@shift(
    (30, 2), np.append(-np.ones(29), 0.0), 0.98, (0.2,), (0.35,), "Steps slip more often than simulated.",
    start=range(29), recorded="policy",
)  # fmt: skip
def corridor(place: int, right: int, slip: float) -> Moves:
    """30 places, left or right, an end to the right; a slip goes the other way; every step costs 1."""
    if place == 29:
        yield 1.0, 29
        return
    way = 1 if right else -1
    yield 1 - slip, max(place + way, 0)
    yield slip, max(place - way, 0)


def _mountain_pay(s: IntArray, a: IntArray, to: IntArray) -> Array:
    return np.where((to == 24) & (s != 24), 10.0, np.where(s == 24, 0.0, -0.02 * np.abs(a - 1)))


@shift(
    (25, 3), _mountain_pay, 0.99, (0.04,), (0.16,), "The slopes of the valley are steeper than simulated.",
    start=range(5, 16),
)  # fmt: skip
def mountain(place: int, push: int, pull: float) -> Moves:
    """A valley of 25 places; push left, rest, push right; the slope pulls back; the right top ends it with 10."""
    if place == 24:
        yield 1.0, 24
        return
    slope = pull * (place - 10) / 14
    right = 0.3 + 0.2 * (push - 1) - slope
    left = 0.3 - 0.2 * (push - 1) + slope
    yield right, min(place + 1, 24)
    yield left, max(place - 1, 0)
    yield 1 - left - right, place
