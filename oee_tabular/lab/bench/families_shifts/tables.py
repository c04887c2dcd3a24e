"""Families of drawn tables: mixtures, low rank, points of a square, web pages."""

from __future__ import annotations

import numpy as np

from oee_tabular.lab.bench.family import Family
from oee_tabular.lab.bench.laws import normalize
from oee_tabular.lab.bench.shift import pair
from oee_tabular.mdp import FiniteMDP
from oee_tabular.typing import Array


def from_tables(
    about: str, tables: tuple[Array, Array], rewards: Array, discount: float
) -> Family:
    """Make a family of the simulator's and the target's probabilities (S, A, S)."""
    simulator = FiniteMDP(
        tables[0], rewards, np.full(len(rewards), 1 / len(rewards)), discount
    )
    return pair(about, simulator, tables[1])


def draw_garnet(
    rng: np.random.Generator,
    n_states: int = 40,
    n_actions: int = 3,
    n_successors: int = 5,
) -> Array:
    """Draw random probabilities (S, A, S).

    Each state-action pair leads to ``n_successors`` random states with uniform
    Dirichlet probabilities.
    """
    table = np.zeros((n_states, n_actions, n_states))
    for s, a in np.ndindex(n_states, n_actions):
        table[s, a, rng.permutation(n_states)[:n_successors]] = rng.dirichlet(
            np.ones(n_successors)
        )
    return table


def blend_with_stranger(rng: np.random.Generator) -> Family:
    """Make a Garnet into which another one is mixed."""
    mine = draw_garnet(rng)
    other = draw_garnet(rng)
    rewards = rng.normal(size=(40, 3))
    about = (
        "Three in ten transitions follow another MDP; simulated, one in twenty does."
    )
    return from_tables(
        about, (0.95 * mine + 0.05 * other, 0.7 * mine + 0.3 * other), rewards, 0.95
    )


def low_rank(rng: np.random.Generator) -> Family:
    """Make a family whose rows are mixtures of four laws."""
    weights = rng.dirichlet(np.full(4, 0.5), (60, 3))
    factors = rng.dirichlet(np.ones(60), 4)
    changed = factors.copy()
    changed[:2] = normalize(changed[:2] * rng.gamma(2.0, size=(2, 60)))
    about = "Rows are mixtures of four laws, two of which are wrong in the simulator."
    return from_tables(
        about, (weights @ factors, weights @ changed), rng.normal(size=(60, 3)), 0.95
    )


def scattered_points(rng: np.random.Generator) -> Family:
    """Make a family on 200 points of the unit square.

    Actions are up, left and right.
    """
    points = rng.random((200, 2))
    ways = 0.15 * np.array([[0, 1], [-1, 0], [1, 0]])

    def scatter(width: float, on_the_right: float) -> Array:
        """Return the probabilities (S, A, S) of steps of this width."""
        strength = np.where(points[:, 0] > 0.5, on_the_right, 1.0)
        centers = points[:, None] + ways * strength[:, None, None]
        return normalize(
            (1 + ((centers[:, :, None] - points) ** 2).sum(axis=3) / width**2) ** -4
        )

    rewards = np.exp(-((points - 0.8) ** 2).sum(axis=1) / 0.05)
    about = (
        "Steps scatter more than simulated and are weaker on the right; each may lead"
        " to any of 200 points."
    )
    return from_tables(
        about, (scatter(0.12, 1.0), scatter(rng.uniform(0.15, 0.2), 0.4)), rewards, 0.93
    )


def web_pages(rng: np.random.Generator) -> Family:
    """Make 120 pages with two sets of four links.

    A reader may go to any page.
    """
    links = draw_garnet(rng, 120, 2, 4)
    rewards = rng.normal(size=120)
    popular = 1 / (1 + rng.permutation(120))
    jump = rng.uniform(0.3, 0.4)
    real = (1 - jump) * links + jump * normalize(popular)
    about = "Readers leave the links more often than simulated, and for popular pages."
    return from_tables(about, (0.85 * links + 0.15 / 120, real), rewards, 0.9)
