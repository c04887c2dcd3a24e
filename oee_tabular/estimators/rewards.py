"""The rewards of a log beside the simulator's, and where the two differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oee_tabular._sparse import align, csr_on_pattern, find, row_of_entry, row_sums
from oee_tabular.data import TransitionCounts, Transitions
from oee_tabular.exact import largest_reward, policy_value
from oee_tabular.mdp import FiniteMDP, csr_from_entries
from oee_tabular.typing import Array

if TYPE_CHECKING:
    from oee_tabular.estimators.problem import Problem

TOLERANCE = 1e-6  # a share of the largest reward: rewards that differ by less agree
# a share of the largest reward: a difference that is larger is not called rounding
MAX_ROUNDING = 0.01
MAX_DIGITS = 9  # after the point, of rewards that may have been rounded


@dataclass(frozen=True)
class RewardConflict:
    """A contradiction between the rewards of a log and the simulator's.

    Attributes
    ----------
    rows : int
        The number of transitions whose rewards differ.
    sentence : str
        A sentence about it, which ``str`` returns.
    is_rounding : bool, default False
        Whether the log's rewards may be the simulator's, rounded (``is_rounded``).
    """

    rows: int
    sentence: str
    is_rounding: bool = False

    def __str__(self) -> str:
        return self.sentence


def simulator_rewards(
    simulator: FiniteMDP, log: Transitions | TransitionCounts
) -> Array:
    """Return the simulator's reward for each row of the log.

    Outside the simulator's support it is the expected reward r(s, a).
    """
    expected = simulator.rewards[log.state, log.action]
    if simulator.transition_rewards is None:
        return expected
    rows = log.state * simulator.n_actions + log.action
    position, stored = find(simulator.transition_rewards, rows, log.next_state)
    return np.where(stored, simulator.transition_rewards.data[position], expected)


def with_log_rewards(
    simulator: FiniteMDP, log: Transitions | TransitionCounts
) -> FiniteMDP:
    """Return the simulator with the log's mean rewards of recorded transitions."""
    moves = log.moves()
    matrix = simulator.transitions
    assert moves.reward_sum is not None
    assert moves.reward_count is not None
    rows = log.state * simulator.n_actions + log.action
    total, number = (
        align(csr_from_entries(rows, log.next_state, x, matrix.shape), matrix)[0]
        for x in (moves.reward_sum, moves.reward_count)
    )
    own = simulator.reward_data
    if own is None:
        own = simulator.rewards.reshape(-1)[row_of_entry(matrix)]
    # a recorded transition may lack its reward
    data = np.divide(total, number, out=np.array(own), where=number > 0)
    return simulator.with_rewards(csr_on_pattern(matrix, data))


def mean_rewards(problem: Problem) -> Array:
    """Average the rewards over the recorded transitions of each pair, (S*A,).

    They are the log's rewards, or the simulator's where the log has none.
    """
    model = problem.simulator
    if problem.log.moves().reward_sum is not None:
        model = with_log_rewards(model, problem.log)
    matrix = model.transitions
    observed, _ = align(problem.counts, matrix)
    number = row_sums(matrix, observed)
    if model.reward_data is None:
        total = number * model.rewards.reshape(-1)
    else:
        total = row_sums(matrix, observed * model.reward_data)
    return np.divide(total, number, out=np.zeros_like(number), where=number > 0)


def conflict(
    simulator: FiniteMDP, log: Transitions | TransitionCounts
) -> RewardConflict | None:
    """Compare the log's rewards with the simulator's for the same transitions.

    The result is None where they agree, or where the log has no rewards.
    """
    _, _, least, most, number = log.moves()
    if least is None or most is None or number is None:
        return None
    expected = simulator_rewards(simulator, log)
    far = np.where(np.abs(least - expected) > np.abs(most - expected), least, most)
    gap = np.abs(far - expected)
    size = max(largest_reward(simulator), float(np.abs(far).max()))
    differ = np.flatnonzero(gap > TOLERANCE * size)
    if differ.size == 0:
        return None
    moves = np.unique(
        np.stack([log.state[differ], log.action[differ], log.next_state[differ]]),
        axis=1,
    )
    k = int(differ[np.argmax(gap[differ])])
    rows = round(float(number[differ].sum()))
    # of counted transitions only the extreme rewards are known, so that their number is
    # an upper bound
    at_most = "up to " if (least[differ] < most[differ]).any() else ""
    where = simulator.names.transition(log.state[k], log.action[k], log.next_state[k])
    is_known = ~np.isnan(far)  # some transitions may lack their reward
    is_rounding = is_rounded(far[is_known], expected[is_known])
    verb = "are rounded from" if is_rounding else "contradict"
    sentence = (
        f"the log's rewards {verb} the simulator's in {at_most}{rows} of"
        f" {len(log)} transitions ({moves.shape[1]} distinct; the reward of {where} is"
        f" {far[k]:.9g} in the log, {expected[k]:.9g} in the simulator)"
    )
    return RewardConflict(rows, sentence, is_rounding)


def is_rounded(rewards: Array, exact: Array) -> bool:
    """Say whether rewards may be the exact ones, rounded to some digits.

    They differ by at most half a unit of the last digit that the rewards have, and by
    at most a hundredth of the largest reward: 0 and 1 are not 0.4 rounded.

    >>> is_rounded(np.array([0.33, 2.0]), np.array([1 / 3, 2.0]))
    True
    >>> is_rounded(np.array([0.0, 1.0]), np.array([0.4, 1.0]))
    False
    """
    gap = float(np.abs(rewards - exact).max())
    scale = float(np.abs(exact).max())
    if not gap <= MAX_ROUNDING * scale:
        return False
    for digits in range(MAX_DIGITS + 1):
        # more digits are a smaller unit
        if gap > 0.5 * 10.0**-digits * (1.0 + 1e-6) + 1e-12 * scale:
            return False
        error = np.abs(rewards - np.round(rewards, digits))
        if (error <= 1e-12 * (1.0 + np.abs(rewards))).all():
            return True
    return False


def reward_effect(problem: Problem, policy: Array) -> float:
    """Compute by how much the log's rewards change a policy's value in the simulator.

    It is infinite where the value does not exist, and 0 where the rewards agree.
    """
    if problem.reward_conflict is None:
        return 0.0
    key = "reward_effect", policy.tobytes()
    if key not in problem.cache:
        problem.cache[key] = _compute_effect(problem, policy)
    effect: float = problem.cache[key]
    return effect


def _compute_effect(problem: Problem, policy: Array) -> float:
    """Compute what ``reward_effect`` returns, which is asked for more than once."""
    paid = with_log_rewards(problem.simulator, problem.log)
    try:
        values = [
            policy_value(mdp, policy, horizon=problem.horizon)
            for mdp in (paid, problem.simulator)
        ]
    except ValueError:  # without a horizon, at discount 1
        return math.inf
    return values[0] - values[1]
