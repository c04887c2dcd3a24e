"""The paper's gridworld (Section VI.A).

N x N cells (row, column), numbered row * N + column; start (0, 0), goal (N-1, N-1),
absorbing, with no reward from then on. Actions: 0 row + 1, 1 row - 1, 2 column + 1, 3
column - 1. The intended direction is taken with probability 1 - slip, each of the other
three with slip / 3; a step into a wall stays in place. Reward: -0.2 times the Manhattan
distance to the goal. The layout has row and column.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.data import Transitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import FiniteMDP, deterministic_policy, mix, uniform_policy
from oee_tabular.simulate import sample_episodes
from oee_tabular.typing import Array

DIRECTIONS = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])  # of row and column
LOSS_PER_DISTANCE = 0.2  # the paper's, for each step between a cell and the goal
N_BYTES_PER_STATE = 1800.0  # memory while an MDP is made, measured
N_BYTES_PER_POLICY_STATE = 100.0  # memory while a policy is made


@suggest_keywords
def gridworld(
    size: int,
    slip: float,
    *,
    pay: Literal["next", "current"] = "next",
    discount: float = 0.99,
) -> FiniteMDP:
    """Make the gridworld of ``size`` x ``size`` cells as a FiniteMDP.

    Parameters
    ----------
    size : int
        Number of cells in a row, at least 2.
    slip : float
        Probability, in [0, 1], of not going in the intended direction (the paper's
        epsilon: 0.3 simulated, 0.1 real).
    pay : {'next', 'current'}, default 'next'
        Whether the reward depends on the cell which a step enters, r(s, a, s') = -0.2
        distance(s'), or leaves, r(s) = -0.2 distance(s). The two differ by one step of
        discounting and the first reward.
    discount : float, default 0.99
        The discount, in [0, 1].

    Returns
    -------
    FiniteMDP
        The gridworld, of size^2 states and 4 actions.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    gridworld_expert : The paper's expert.
    gridworld_policy : The paper's mixed policies.

    Examples
    --------
    >>> gridworld(10, slip=0.3)
    FiniteMDP(100 states, 4 actions, 1576 transitions, rewards r(s, a, s'), discount 0.99)
    """
    n = _checks.positive_integer(size, "size")
    _checks.require_memory(N_BYTES_PER_STATE * n * n, "size", n, size=1)
    if n < 2:
        raise ArgumentError("size", f"must be at least 2; it is {n}")
    wrong = _checks.number_in(slip, "slip", 0.0, 1.0)
    _checks.one_of(pay, "pay", ("next", "current"))
    cells = np.stack(np.divmod(np.arange(n * n), n), axis=1)
    # (S, 4): where each direction leads; a step into a wall stays in place
    row, column = np.clip(cells[:, None] + DIRECTIONS, 0, n - 1).transpose(2, 0, 1)
    # each action has four entries, one for each direction
    next_cells = np.repeat(row * n + column, 4, axis=0)
    weights = np.full((4, 4), wrong / 3.0)
    np.fill_diagonal(weights, 1.0 - wrong)
    weights = np.tile(weights, (n * n, 1))
    # the goal stays in place by its first direction, into a wall: the sum of its four
    # probabilities need not be exactly 1
    weights[-4:] = [1.0, 0.0, 0.0, 0.0]
    pointers = np.arange(0, 16 * n * n + 1, 4)
    transitions = sparse.csr_array(
        (weights.ravel(), next_cells.ravel(), pointers), shape=(4 * n * n, n * n)
    )
    initial = np.eye(1, n * n)[0]
    cell_rewards = LOSS_PER_DISTANCE * (cells.sum(axis=1) - (2 * n - 2))
    if pay == "current":
        return FiniteMDP(transitions, cell_rewards, initial, discount, layout=cells)
    transitions.sum_duplicates()
    transitions.eliminate_zeros()
    rewards = sparse.csr_array(
        (cell_rewards[transitions.indices], transitions.indices, transitions.indptr),
        shape=transitions.shape,
    )
    return FiniteMDP(transitions, rewards, initial, discount, layout=cells)


def gridworld_expert(size: int) -> Array:
    """Make the paper's expert: raise the row until the last one, then the column.

    Parameters
    ----------
    size : int
        Number of cells in a row of the gridworld.

    Returns
    -------
    ndarray of shape (S, 4)
        Action probabilities, 0 or 1.

    See Also
    --------
    gridworld_policy : The expert mixed with the uniform policy.

    Examples
    --------
    >>> gridworld_expert(3).argmax(axis=1).tolist()
    [0, 0, 0, 0, 0, 0, 2, 2, 2]
    """
    n = _checks.positive_integer(size, "size")
    _checks.require_memory(N_BYTES_PER_POLICY_STATE * n * n, "size", n)
    row = np.arange(n * n) // n
    return deterministic_policy(np.where(row < n - 1, 0, 2), 4)


def gridworld_policy(size: int, delta: float) -> Array:
    """Make pi_delta = delta * expert + (1 - delta) * uniform.

    Parameters
    ----------
    size : int
        Number of cells in a row of the gridworld.
    delta : float
        The share of the expert, in [0, 1].

    Returns
    -------
    ndarray of shape (S, 4)
        Action probabilities.

    See Also
    --------
    gridworld_expert : The expert alone.

    Examples
    --------
    >>> gridworld_policy(3, 0.8)[0].round(6).tolist()
    [0.85, 0.05, 0.05, 0.05]
    """
    expert = gridworld_expert(size)
    uniform = np.full_like(expert, 0.25)
    return mix(expert, uniform, _checks.number_in(delta, "delta", 0.0, 1.0))


@checked(shapes={"behavior_policy": "S A", "policies": "S A"})
@dataclass(frozen=True, eq=False)
class Embedded:
    """Hold the default problem of ``oee evaluate``, with its target.

    It is the 10 x 10 grid at n = 3162 (the paper's Figure 1 b, c, d).

    Attributes
    ----------
    simulator : FiniteMDP
        The gridworld with slip 0.3.
    target : FiniteMDP
        The gridworld with slip 0.1.
    log : Transitions
        3162 transitions of the target, drawn from ``episodes`` without replacement.
    episodes : Transitions
        50 whole episodes of ``behavior_policy``, for importance sampling.
    behavior_policy : ndarray of shape (S, A)
        The uniform policy.
    policies : dict of str to ndarray of shape (S, A)
        The evaluated policies by name: the expert with a probability, else uniform.
    horizon : int
        Number of rewards of a value.

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


@suggest_keywords
def embedded_default(*, seed: int, discount: float = 0.99) -> Embedded:
    """Make the default problem: slip 0.3 in the simulator, 0.1 in the target.

    Parameters
    ----------
    seed : int
        Seed of the log.
    discount : float, default 0.99
        The discount, in [0, 1].

    Returns
    -------
    Embedded
        Simulator, target, log and policies.

    See Also
    --------
    gridworld : The gridworld of any size and slip.

    Examples
    --------
    >>> default = embedded_default(seed=0)
    >>> len(default.log), list(default.policies)
    (3162, ['10% expert', '50% expert', '90% expert'])
    """
    simulator = gridworld(10, 0.3, discount=discount)
    target = gridworld(10, 0.1, discount=discount)
    generator = _checks.generator(seed)
    behavior = uniform_policy(target)
    episodes = sample_episodes(target, behavior, 50, 1000, seed=generator)
    log = episodes.draw(3162, seed=generator)
    policies = {
        f"{delta:.0%} expert": gridworld_policy(10, delta) for delta in (0.1, 0.5, 0.9)
    }
    return Embedded(simulator, target, log, episodes, behavior, policies)
