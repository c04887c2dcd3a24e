"""Small random problems for the cases of exercises."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array, IntArray


class Parts(NamedTuple):
    """The arrays of an MDP."""

    P: Array
    r: Array
    mu: Array
    discount: float

    @property
    def mdp(self) -> FiniteMDP:
        """Return the arrays as an MDP."""
        return FiniteMDP(self.P, self.r, self.mu, self.discount)


def draw_rows(
    rng: np.random.Generator, shape: tuple[int, ...], *, has_zeros: bool
) -> Array:
    """Draw distributions over the last axis."""
    rows = rng.dirichlet(np.ones(shape[-1]), size=shape[:-1]) + 0.02
    if has_zeros:
        largest = rows == rows.max(axis=-1, keepdims=True)
        rows = np.where(largest | (rng.random(shape) < 0.6), rows, 0.0)
    return np.asarray(rows / rows.sum(axis=-1, keepdims=True))


def draw_parts(rng: np.random.Generator, is_hard: bool) -> Parts:
    """Draw an MDP; a hard one has zeros, and half of them end in an absorbing state."""
    n_states, n_actions = int(rng.integers(3, 6)), int(rng.integers(2, 4))
    P = draw_rows(rng, (n_states, n_actions, n_states), has_zeros=is_hard)
    r = np.round(rng.normal(size=(n_states, n_actions)), 2)
    mu = draw_rows(rng, (n_states,), has_zeros=is_hard)
    if is_hard and rng.random() < 0.5:
        P[-1] = np.eye(n_states)[-1]
        r[-1] = 0.0
    return Parts(P, r, mu, round(float(rng.uniform(0.5, 0.95)), 2))


def draw_policy(
    rng: np.random.Generator, shape: tuple[int, int], *, is_hard: bool
) -> Array:
    """Draw a policy; a hard one may take one action in each state."""
    policy = draw_rows(rng, shape, has_zeros=False)
    if is_hard and rng.random() < 0.3:
        return np.eye(shape[1])[rng.integers(shape[1], size=shape[0])]
    return policy


def draw_counts(rng: np.random.Generator, n: IntArray, P: Array) -> Array:
    """Draw ``n[s, a]`` transitions in each pair, and count them by (s, a, s')."""
    rows = [
        rng.multinomial(k, row)
        for k, row in zip(n.ravel(), P.reshape(-1, P.shape[-1]), strict=True)
    ]
    return np.array(rows, dtype=float).reshape(P.shape)
