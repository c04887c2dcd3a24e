"""The default problem of ``oee evaluate``: the paper's 10 x 10 grid at n = 3162 (its Figure 1 b, c, d)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oee_tabular._checks import Array
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, uniform_policy
from oee_tabular.simulate import sample_episodes
from oee_tabular.tasks.gridworld import gridworld, gridworld_policy


@dataclass(frozen=True, eq=False)
class Embedded:
    """What a problem is made of, the policies to evaluate, and the target that made the log.

    Attributes
    ----------
    simulator, target : FiniteMDP
    log : 3162 transitions, drawn from ``episodes`` without replacement
    episodes : 50 whole episodes of ``behavior_policy``, for importance sampling
    behavior_policy : (S, A), uniform
    policies : name -> (S, A), whose values are asked: the expert's with a probability, else uniform
    horizon : number of rewards of a value

    Examples
    --------
    >>> embedded_default(seed=1).target.n_states
    100
    """

    simulator: FiniteMDP
    target: FiniteMDP
    log: Transitions
    episodes: Transitions
    behavior_policy: Array
    policies: dict[str, Array]
    horizon: int = 200


def embedded_default(*, seed: int, discount: float = 0.99) -> Embedded:
    """Make the default problem: slip 0.3 simulated, 0.1 real.

    Parameters
    ----------
    seed : of the log
    discount : float in [0, 1]

    Examples
    --------
    >>> default = embedded_default(seed=0)
    >>> len(default.log), list(default.policies)
    (3162, ['10% expert', '50% expert', '90% expert'])
    """
    simulator, target = (gridworld(10, slip, discount=discount) for slip in (0.3, 0.1))
    generator = np.random.default_rng(seed)
    behavior = uniform_policy(target)
    episodes = sample_episodes(target, behavior, 50, 1000, seed=generator)
    log = episodes.draw(3162, seed=generator)
    policies = {f"{delta:.0%} expert": gridworld_policy(10, delta) for delta in (0.1, 0.5, 0.9)}
    return Embedded(simulator, target, log, episodes, behavior, policies)
