"""The embedded default of ``oee evaluate``: the paper's 10 x 10 grid at n = 3162 (its Figure 1 b, c, d).

Slip 0.3 simulated, 0.1 real; a log of n moves drawn without replacement from episodes of at most 1000 steps that the
uniform policy made in the target; policies delta * expert + (1 - delta) * uniform, delta = 0.1, 0.5, 0.9; T = 200.
Importance sampling gets the whole episodes behind the drawn moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.estimators import Problem
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.simulate import sample_episodes
from oee_tabular.tasks import gridworld, gridworld_policy

SIZE, SIMULATED_SLIP, REAL_SLIP = 10, 0.3, 0.1
N_TRANSITIONS, HORIZON, EPISODES, LONGEST = 3162, 200, 50, 1000
DELTAS = (0.1, 0.5, 0.9)


@dataclass(frozen=True, eq=False)
class Embedded:
    """A problem, the policies to evaluate, and the target that made the log."""

    problem: Problem
    policies: dict[str, Array]
    target: FiniteMDP


def embedded_default(
    *, seed: int, horizon: int | None = HORIZON, discount: float = 0.99, rewards: str = "simulator"
) -> Embedded:
    """The default problem; ``seed`` makes the log."""
    simulator = gridworld(SIZE, SIMULATED_SLIP, discount=discount)
    target = gridworld(SIZE, REAL_SLIP, discount=discount)
    generator = np.random.default_rng(seed)
    behavior = uniform_policy(target)
    episodes = sample_episodes(target, behavior, EPISODES, LONGEST, seed=generator)
    log = episodes.draw(N_TRANSITIONS, seed=generator)
    problem = Problem(
        simulator,
        log,
        horizon=horizon,
        behavior_policy=behavior,
        rewards=rewards,  # type: ignore[arg-type]  # checked by Problem
        episodes=episodes,
    )
    return Embedded(problem, {f"delta={d:g}": gridworld_policy(SIZE, d) for d in DELTAS}, target)
