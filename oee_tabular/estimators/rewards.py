"""Rewards of a log beside the simulator's: where they contradict each other, and the simulator with the log's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from oee_tabular._checks import Array
from oee_tabular._sparse import align, find, row_sums
from oee_tabular.data import TransitionCounts, Transitions
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.arrays import csr_from_entries

if TYPE_CHECKING:
    from oee_tabular.estimators.problem import Problem


@dataclass(frozen=True)
class RewardConflict:
    """How often the log pays something else than the simulator for the same move."""

    rows: int
    moves: int
    of_rows: int
    example: str
    at_most: bool = False  # of moves that were counted, only the least and the largest reward are known

    def __str__(self) -> str:
        return (
            f"the log's rewards contradict the simulator's in {'up to ' * self.at_most}{self.rows} of {self.of_rows} "
            f"transitions ({self.moves} different moves; {self.example})"
        )


def simulator_rewards(simulator: FiniteMDP, log: Transitions | TransitionCounts) -> Array:
    """r(s, a, s') or r(s, a) of the simulator for each row of the log; its expected r(s, a) off its support."""
    expected = simulator.rewards[log.state, log.action]
    if simulator.transition_rewards is None:
        return expected
    rows = log.state * simulator.n_actions + log.action
    position, stored = find(simulator.transition_rewards, rows, log.next_state)
    return np.where(stored, simulator.transition_rewards.data[position], expected)


def with_log_rewards(simulator: FiniteMDP, log: Transitions | TransitionCounts) -> FiniteMDP:
    """The simulator, paying the log's mean reward for the moves that the log has."""
    moves = log.moves()
    assert moves.reward_sum is not None
    assert moves.reward_count is not None
    shape = simulator.transitions.shape
    rows = log.state * simulator.n_actions + log.action
    total = csr_from_entries(rows, log.next_state, moves.reward_sum, shape)
    seen = csr_from_entries(rows, log.next_state, moves.reward_count, shape)
    matrix = simulator.transitions
    paid, known = align(total, matrix)
    often, _ = align(seen, matrix)
    known &= often > 0  # rewards may be missing
    own = simulator.reward_data
    if own is None:
        own = np.repeat(simulator.rewards.reshape(-1), np.diff(matrix.indptr))
    data = np.where(known, paid / np.where(known, often, 1.0), own)
    return simulator.with_rewards(sparse.csr_array((data, matrix.indices, matrix.indptr), shape=shape))


def mean_rewards(problem: Problem) -> Array:
    """(S*A,) mean over the recorded transitions of each pair (0 without any): of the log's rewards, else the simulator's."""
    simulator = problem.simulator
    model = simulator if problem.log.moves().reward_sum is None else with_log_rewards(simulator, problem.log)
    matrix, data = model.transitions, model.reward_data
    observed, _ = align(problem.counts, matrix)
    number = row_sums(matrix, observed)
    paid = number * model.rewards.reshape(-1) if data is None else row_sums(matrix, observed * data)
    return np.divide(paid, number, out=np.zeros_like(number), where=number > 0)


def conflict(simulator: FiniteMDP, log: Transitions | TransitionCounts) -> RewardConflict | None:
    """Where the log pays something else than the simulator for the same move; None: nowhere."""
    _, _, least, most, number = log.moves()
    if least is None or most is None or number is None:
        return None
    expected = simulator_rewards(simulator, log)
    scale = max(1.0, float(np.abs(expected).max()))
    far = np.where(np.abs(least - expected) > np.abs(most - expected), least, most)
    differ = np.flatnonzero(np.abs(far - expected) > 1e-6 * scale)
    if differ.size == 0:
        return None
    moves = np.unique(np.stack([log.state[differ], log.action[differ], log.next_state[differ]]), axis=1)
    k = int(differ[np.argmax(np.abs(far - expected)[differ])])
    example = (
        f"{simulator.names.transition(log.state[k], log.action[k], log.next_state[k])} pays {far[k]:g} in the log, "
        f"{expected[k]:g} in the simulator"
    )
    varies = bool((least[differ] < most[differ]).any())
    return RewardConflict(round(float(number[differ].sum())), moves.shape[1], len(log), example, varies)
