"""A task of eight coordinates: four masses on springs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from oee_tabular._checks import Array, IntArray, freeze
from oee_tabular.continuous.task import Moves, StatePolicy
from oee_tabular.lab.robots.changes.classic import Plain, noisy


@dataclass(frozen=True)
class Chain(Plain):
    """Four masses between two walls, on springs that harden; the first is pushed: eight coordinates.

    k (u + hardness u^3) is a spring's force at the extension u; a step is 0.1 s, twice 0.05 s by semi-implicit Euler.
    """

    mass: float = 1.0
    stiffness: float = 2.0
    hardness: float = 1.0
    friction: float = 0.1
    force: float = 1.0
    noise: float = 0.01
    name: str = field(default="Chain", init=False)

    state_names = feature_names = tuple(f"{what}_{k}" for what in ("place", "speed") for k in range(1, 5))
    actions = freeze(np.array([-1.0, 0.0, 1.0]))
    n_disturbances = 4
    feature_low, feature_high = freeze(np.full(8, -2.0)), freeze(np.full(8, 2.0))
    periodic, terminates = (False,) * 8, False

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step."""
        place, speed = states[:, :4], states[:, 4:]
        for _ in range(2):
            stretched = np.diff(place, axis=1, prepend=0.0, append=0.0)
            tension = self.stiffness * (stretched + self.hardness * stretched**3)
            pulled = np.diff(tension, axis=1) - self.friction * speed
            pulled[:, 0] += self.force * self.actions[actions]
            speed = speed + 0.05 * pulled / self.mass
            place = place + 0.05 * speed
        speed = speed + self.noise * disturbance
        following = np.column_stack([place, speed])
        return Moves(following, self.reward_between(states, actions, following), np.zeros(len(states), dtype=np.bool_))

    def reward_between(self, states: Array, actions: IntArray, next_states: Array) -> Array:
        """Minus the mean square of the places."""
        return np.asarray(-(next_states[:, :4] ** 2).mean(axis=1))

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Displaced, at rest."""
        return np.column_stack([rng.uniform(-1.0, 1.0, (n, 4)), np.zeros((n, 4))])


def braking(delta: float) -> StatePolicy:
    """Chain: against the first mass's speed."""
    return lambda states: noisy(np.where(states[:, 4] >= 0.0, 0, 2), delta)
