"""Small random problems for the cases of exercises."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from oee_tabular.mdp import FiniteMDP
from oee_tabular.testing.assignments.judging import Arguments, Kind
from oee_tabular.typing import Array, IntArray

LONG = 0.999  # a discount near 1: some 10 000 steps count


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


def draw_parts(
    rng: np.random.Generator,
    *,
    n_states: int | None = None,
    n_actions: int | None = None,
    discount: float | None = None,
    has_zeros: bool = False,
) -> Parts:
    """Draw an MDP, of another number of states than of actions."""
    if n_states is None:
        n_states = int(rng.integers(4, 6))
    if n_actions is None:
        n_actions = int(rng.integers(2, 4))
    if discount is None:
        discount = round(float(rng.uniform(0.5, 0.95)), 2)
    P = draw_rows(rng, (n_states, n_actions, n_states), has_zeros=has_zeros)
    r = np.round(rng.normal(size=(n_states, n_actions)), 2)
    mu = draw_rows(rng, (n_states,), has_zeros=has_zeros)
    return Parts(P, r, mu, discount)


def draw_policy(
    rng: np.random.Generator, shape: tuple[int, int], *, is_certain: bool = False
) -> Array:
    """Draw a policy; a certain one takes one action in each state."""
    if is_certain:
        return np.eye(shape[1])[rng.integers(shape[1], size=shape[0])]
    return draw_rows(rng, shape, has_zeros=False)


class Situation(NamedTuple):
    """An MDP with a policy."""

    parts: Parts
    policy: Array


def draw_situation(
    rng: np.random.Generator,
    *,
    n_states: int | None = None,
    n_actions: int | None = None,
    discount: float | None = None,
    has_zeros: bool = False,
    is_certain: bool = False,
) -> Situation:
    """Draw an MDP with a policy."""
    parts = draw_parts(
        rng,
        n_states=n_states,
        n_actions=n_actions,
        discount=discount,
        has_zeros=has_zeros,
    )
    return Situation(parts, draw_policy(rng, parts.r.shape, is_certain=is_certain))


def _draw_absorbing(rng: np.random.Generator) -> Situation:
    """Draw an MDP whose last state is never left, and has a reward of its own."""
    parts, policy = draw_situation(rng, has_zeros=True)
    parts.P[-1] = np.eye(len(parts.mu))[-1]
    return Situation(parts, policy)


def _draw_circle(rng: np.random.Generator) -> Situation:
    """Draw an MDP whose first action leads on in a circle, and the others back."""
    parts, policy = draw_situation(rng)
    n = len(parts.mu)
    parts.P[:] = np.eye(n)[(np.arange(n) - 1) % n][:, None]
    parts.P[:, 0] = np.eye(n)[(np.arange(n) + 1) % n]
    return Situation(parts, policy)


def _draw_unreachable(rng: np.random.Generator) -> Situation:
    """Draw an MDP that begins in one state, and never comes into the last one."""
    parts, policy = draw_situation(rng)
    P = parts.P.copy()
    P[:, :, -1] = 0.0
    P /= P.sum(axis=-1, keepdims=True)
    return Situation(parts._replace(P=P, mu=np.eye(len(parts.mu))[0]), policy)


def situation_kinds(
    arguments: Callable[[Situation], Arguments],
    *,
    long: float = LONG,
) -> tuple[Kind, ...]:
    """Return kinds of cases of an MDP with a policy; ``arguments`` picks what is given."""
    draws = (
        ("", draw_situation, ""),
        (
            f"the discount is {long}",
            partial(draw_situation, discount=long),
            "with a discount near 1 rewards count for thousands of steps. Solve the"
            " linear system, or iterate until nothing changes any more.",
        ),
        (
            "the last state is never left",
            _draw_absorbing,
            "a state that leads to itself is a state as the others are: its rewards and"
            " the time in it count on.",
        ),
        (
            "the policy takes one action in each state",
            partial(draw_situation, is_certain=True),
            "a policy may have probabilities of 0 and 1; the other actions count"
            " nothing then.",
        ),
        (
            "there are more actions than states",
            partial(draw_situation, n_states=2, n_actions=4),
            "the first axis counts states and the second one actions; take no number"
            " of the one for the other.",
        ),
        (
            "there is one state",
            partial(draw_situation, n_states=1, n_actions=3),
            "with one state every action leads back to it; the formulas hold as they"
            " are, with arrays of one entry.",
        ),
        (
            "there is one action",
            partial(draw_situation, n_actions=1),
            "with one action the policy is 1 everywhere; the formulas hold as they are.",
        ),
        (
            "transitions are certain, around a circle",
            _draw_circle,
            "transitions may be certain, and lead around a circle: the chain does not"
            " settle, and discounted sums exist all the same.",
        ),
        (
            "the discount is 0",
            partial(draw_situation, discount=0.0),
            "with a discount of 0 the first step alone counts, and the sums have one"
            " term.",
        ),
        (
            "the first state is known, and one state is never reached",
            _draw_unreachable,
            "mu may be 1 in one state, and a state may never be reached.",
        ),
    )

    def draw(
        rng: np.random.Generator, one: Callable[[np.random.Generator], Situation]
    ) -> Arguments:
        return arguments(one(rng))

    return tuple(
        Kind(about, partial(draw, one=one), hint) for about, one, hint in draws
    )


def draw_counts(rng: np.random.Generator, n: IntArray, P: Array) -> IntArray:
    """Draw ``n[s, a]`` transitions in each pair, and count them by (s, a, s')."""
    rows = [
        rng.multinomial(k, row)
        for k, row in zip(n.ravel(), P.reshape(-1, P.shape[-1]), strict=True)
    ]
    return np.array(rows, dtype=np.int64).reshape(P.shape)
