"""Does a state decide the next one: a record of a Gymnasium environment, stepped again from its states."""

from __future__ import annotations

import copy
import warnings
from typing import Any

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.task import Moves

SAME_STEP = 0.02  # of a coordinate's usual step: a step that is repeated
FEW = 0.05  # share of steps that may be another (contacts, whose solvers remember): told, not refused
DIFFER = (
    "get_state and set_state must have all that decides the next step, and chance must come from np_random: {} differ from the "
    "record when stepped again from its states. Read and set the rest as well, such as other bodies' velocities and timers "
    "(--state MODULE:GET,SET)"
)


def check_steps_of(task: Any, env: Any, steps: int) -> tuple[Array, IntArray]:
    """Step a record of random actions again from its states, in another order; what differs is an error.

    ``task`` : GymnasiumTask. A warning where at most a twentieth of the steps differ. Returns the record's (s, a).
    """
    env.reset(seed=0)
    inner = env.unwrapped
    rng, generators = np.random.default_rng(0), []
    numbers = rng.integers(task.n_actions, size=steps)
    before, after, again = np.zeros((3, steps, task.n_state + 1))  # rewards last
    for i, number in enumerate(numbers):
        before[i, :-1] = task.read(env)
        generators.append(copy.deepcopy(inner.np_random))
        _, reward, over, cut, _ = inner.step(task.command(int(number)))
        after[i] = np.append(task.read(env), reward)
        if over or cut:
            inner.reset()
    env.close()
    for i in rng.permutation(steps):  # in the record's own order what the state lacks would come along
        moved = task.one_by_one(before[i : i + 1, :-1], numbers[i : i + 1], generators[i])
        again[i] = np.append(moved.next_state[0], moved.reward)
    size = np.sqrt(((after - before) ** 2).mean(axis=0)) + 1e-9 * (1.0 + np.abs(after).max(axis=0))
    away = np.abs(again - after)
    bad = (away > SAME_STEP * size).any(axis=1)
    if bad.any():
        k = int((away / size).max(axis=0).argmax())
        name = (*task.state_names, "the reward")[k]
        text = (
            DIFFER.replace("{}", f"{int(bad.sum())} of {steps} steps of {task.name}")
            + f"; the most in {name}: {away[:, k].max():.3g}, where a step moves it by {size[k]:.3g}"
        )
        if bad.mean() > FEW:
            raise ValueError(text)
        warnings.warn(text, stacklevel=4)
    return before[:, :-1], np.asarray(numbers, dtype=np.int64)


def repeats_at_once(task: Any, states: Array, numbers: IntArray) -> bool:
    """Whether environments that step together do as one of them does."""
    one = task.one_by_one(states, numbers, np.random.default_rng(0))
    try:
        many = task.at_once(states, numbers, np.random.default_rng(0))
    except Exception:  # another interface than the one that is used here
        return False
    return _near(one.next_state, many.next_state) and _near(one.reward, many.reward) and _same_ends(one, many)


def _near(one: Array, other: Array) -> bool:
    return bool((np.abs(one - other) <= 1e-9 * (1.0 + np.abs(one))).all())


def _same_ends(one: Moves, other: Moves) -> bool:
    return bool((one.terminated == other.terminated).all())
