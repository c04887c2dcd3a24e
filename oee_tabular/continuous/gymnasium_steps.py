"""Does a state decide the next one: a record of a Gymnasium environment, stepped again from its states.

``Chance``: the random numbers that it draws in a step, as a disturbance: quantiles of standard normal numbers.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import ndtr

from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.task import Moves

SAME_STEP = 0.02  # of a coordinate's usual step: a step that is repeated
FEW = 0.05  # share of steps that may be another (contacts, whose solvers remember): told, not refused
DIFFER = (
    "get_state and set_state must have all that decides the next step, and chance must come from np_random: {count} differ "
    "from the record when stepped again from its states. Read and set the rest as well, such as other bodies' velocities and "
    "timers (--task-option state=MODULE:GET,SET); the most in {most}"
)


def check_steps_of(task: Any, env: Any, steps: int) -> tuple[Array, IntArray]:
    """Step a record of random actions again from its states, in another order; what differs is an error.

    ``task`` : GymnasiumTask. A warning where at most a twentieth of the steps differ. Returns the record's (s, a).
    """
    env.reset(seed=0)
    rng, generators = np.random.default_rng(0), []
    numbers = rng.integers(task.n_actions, size=steps)

    def choose(state: Array) -> int:
        generators.append(copy.deepcopy(env.unwrapped.np_random))
        return int(numbers[len(generators) - 1])

    states, _, following, reward, _, _ = task.play(env, choose, steps)
    before, after = np.column_stack([states, np.zeros(steps)]), np.column_stack([following, reward])  # rewards last
    again = np.empty_like(after)
    for i in rng.permutation(steps):  # in the record's own order what the state lacks would come along
        moved = task.one_by_one(states[i : i + 1], numbers[i : i + 1], generators[i])
        again[i] = np.append(moved.next_state[0], moved.reward)
    size = np.sqrt(((after - before) ** 2).mean(axis=0)) + 1e-9 * (1.0 + np.abs(after).max(axis=0))
    away = np.abs(again - after)
    bad = (away > SAME_STEP * size).any(axis=1)
    if bad.any():
        k = int((away / size).max(axis=0).argmax())
        text = DIFFER.format(
            count=f"{int(bad.sum())} of {steps} steps of {task.name}",
            most=f"{(*task.state_names, 'the reward')[k]}: {away[:, k].max():.3g}, where a step moves it by {size[k]:.3g}",
        )
        if bad.mean() > FEW:
            raise ValueError(text)
        warnings.warn(text, stacklevel=4)
    return states, np.asarray(numbers, dtype=np.int64)


def repeats_at_once(task: Any, way: Callable[[Any, Array, IntArray], Moves], states: Array, numbers: IntArray) -> bool:
    """Whether this way of stepping many states at once does as the environment does one by one."""
    one = task.one_by_one(states, numbers, np.random.default_rng(0))
    try:
        with warnings.catch_warnings(action="ignore"):
            many = way(task, states, numbers)
    except Exception:  # another interface than the one that is used here, numbers alone, or random numbers
        return False
    return np.array_equal(one.terminated, many.terminated) and all(
        x.shape == y.shape and bool((np.abs(x - y) <= 1e-9 * (1.0 + np.abs(x))).all())
        for x, y in ((one.next_state, many.next_state), (one.reward, many.reward))
    )


MOST = 64  # draws in a step


class Chance:
    """Stands in for ``np_random``: its numbers are the quantiles at xi, one after the other; at xi = 0 the medians.

    What it has is what steps draw: normal, uniform and whole numbers. Another draw is an AttributeError, more than xi has an
    IndexError.

    >>> chance = Chance(np.array([0.0, 1.0, 0.0]))
    >>> chance.uniform(-1.0, 1.0), chance.normal(2.0, 0.5), chance.integers(5), chance.used
    (0.0, 2.5, 2, 3)
    """

    def __init__(self, xi: Array) -> None:
        self._xi, self.used = xi, 0

    def _draw(self, size: Any, *bounds: Any) -> Any:
        """N(0, 1) of this size, or of the bounds' own shape; a number where that is none."""
        shape = np.broadcast_shapes(*map(np.shape, bounds)) if size is None else size
        n = int(np.prod(shape))
        if self.used + n > len(self._xi):
            raise IndexError(
                f"a step must draw at most {len(self._xi)} random numbers, as when it was recorded; it draws more"
            )
        found = self._xi[self.used : self.used + n].reshape(shape)
        self.used += n
        return found.copy() if found.ndim else float(found)

    def standard_normal(self, size: Any = None) -> Any:
        """N(0, 1)."""
        return self._draw(size)

    def normal(self, loc: object = 0.0, scale: object = 1.0, size: object = None) -> Any:
        """N(loc, scale^2)."""
        return _double(loc) + _double(scale) * self._draw(size, loc, scale)

    def random(self, size: object = None) -> Any:
        """Uniform on [0, 1)."""
        return self.uniform(0.0, 1.0, size)

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """Uniform on [low, high)."""
        share = np.minimum(ndtr(self._draw(size, low, high)), np.nextafter(1.0, 0.0))
        return _double(low) + (_double(high) - _double(low)) * _double(share)

    def integers(self, low: int, high: int | None = None, size: object = None, *, endpoint: bool = False) -> Any:
        """Whole numbers from low to below high; from 0 to below low where there is no high."""
        start, end = (0, low) if high is None else (low, high)
        found = start + np.floor((end + endpoint - start) * np.asarray(self.random(size))).astype(np.int64)
        return int(found) if size is None else found


def _double(value: Any) -> Any:
    return np.asarray(value, dtype=np.float64) if np.ndim(value) else float(value)


def draws_of(task: Any, states: Array, numbers: IntArray) -> int:
    """The most random numbers that one of these steps of a GymnasiumTask draws; 0: none, or others than ``Chance`` has."""
    most, xi = 0, np.random.default_rng(0).standard_normal((len(states), MOST))
    for i in range(len(states)):
        chance = Chance(xi[i])
        try:
            task.one_by_one(states[i : i + 1], numbers[i : i + 1], [chance])
        except (AttributeError, IndexError, TypeError, ValueError):
            return 0
        most = max(most, chance.used)
    return most
