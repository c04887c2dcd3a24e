"""The recycling robot, whose actions differ by state.

Reference: Sutton & Barto, Reinforcement Learning: An Introduction, 2nd edition, 2018,
example 3.3.
"""

from __future__ import annotations

import numpy as np

from oee_tabular import _checks
from oee_tabular._keywords import suggest_keywords
from oee_tabular.mdp import FiniteMDP

STATES = ("high", "low")
ACTIONS = ("search", "wait", "recharge")


@suggest_keywords
def recycling_robot(
    alpha: float = 0.8,
    beta: float = 0.6,
    *,
    search_reward: float = 2.0,
    wait_reward: float = 1.0,
    rescue_reward: float = -3.0,
    discount: float = 0.9,
) -> FiniteMDP:
    """Make the recycling robot of Sutton & Barto (2018, example 3.3) as a FiniteMDP.

    A robot collects cans until its battery is low. With a high battery it cannot
    recharge: the model has 5 of the 6 state-action pairs (``FiniteMDP.available``).

    Parameters
    ----------
    alpha : float, default 0.8
        The probability, in [0, 1], that the battery stays high while it searches.
    beta : float, default 0.6
        The probability, in [0, 1], that a low battery lasts while it searches.
        Otherwise it is empty, and the robot is rescued and recharged.
    search_reward : float, default 2.0
        The cans that a search collects on average (the book's r_search, more than
        ``wait_reward``; it gives neither number, nor alpha and beta).
    wait_reward : float, default 1.0
        The cans that people bring on average while it waits (the book's r_wait).
    rescue_reward : float, default -3.0
        The reward of a search that empties the battery, the book's -3.
    discount : float, default 0.9
        The discount, in [0, 1].

    Returns
    -------
    FiniteMDP
        The robot, of the states "high" and "low", where it begins high, and the actions
        "search", "wait" and "recharge".

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    gridworld : A task in which all actions can be taken.

    Examples
    --------
    >>> robot = recycling_robot()
    >>> robot
    FiniteMDP(2 states, 3 actions (5 of 6 pairs), 7 transitions, rewards r(s, a, s'), discount 0.9)
    >>> robot.available.tolist()
    [[True, True, False], [True, True, True]]
    >>> import oee_tabular as oee
    >>> oee.optimal_policy(robot).argmax(axis=1).tolist()  # search; recharge when low
    [0, 2]
    """
    stays = _checks.number_in(alpha, "alpha", 0.0, 1.0)
    lasts = _checks.number_in(beta, "beta", 0.0, 1.0)
    cans = _checks.number_in(search_reward, "search_reward", -np.inf, np.inf)
    given = _checks.number_in(wait_reward, "wait_reward", -np.inf, np.inf)
    rescue = _checks.number_in(rescue_reward, "rescue_reward", -np.inf, np.inf)
    high, low = range(len(STATES))
    search, wait, recharge = range(len(ACTIONS))
    transitions = np.zeros((len(STATES), len(ACTIONS), len(STATES)))
    transitions[high, search] = stays, 1.0 - stays
    transitions[low, search] = 1.0 - lasts, lasts
    transitions[(high, low), wait, (high, low)] = 1.0
    transitions[low, recharge, high] = 1.0
    rewards = np.zeros(transitions.shape)
    rewards[:, search] = cans
    rewards[low, search, high] = rescue
    rewards[:, wait] = given
    available = np.ones(transitions.shape[:2], dtype=np.bool_)
    available[high, recharge] = False
    return FiniteMDP(
        transitions,
        rewards,
        high,
        discount,
        state_names=STATES,
        action_names=ACTIONS,
        available=available,
    )
