"""The linear model of a log, in any dimension: what regression says without a simulator's steps."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular._threads import ONE_THREAD
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, Moves


def linear_model(task: ContinuousTask, log: ContinuousTransitions) -> ContinuousTask:
    """s' = s + B_a (1, x) + N(0, Sigma) by least squares for each action, x the task's ``smooth`` coordinates of s.

    Rewards, beginnings and ends are the task's; coordinates keep within what was logged.
    """
    model: Any = copy.copy(task)
    fitted = _Linear(task, log)
    object.__setattr__(model, "moves", fitted.moves)
    object.__setattr__(model, "n_disturbances", task.n_state)
    return model  # type: ignore[no-any-return]


class _Linear:
    def __init__(self, task: ContinuousTask, log: ContinuousTransitions) -> None:
        self.task = task
        self.low, self.high = log.next_state.min(axis=0), log.next_state.max(axis=0)
        actions, x = log.action_numbers(task.actions), self._design(log.state)
        turn = np.full(task.n_state, np.inf)
        if len(task.periodic) == task.n_state:
            turn[np.array(task.periodic)] = 2.0 * np.pi
        moved = log.next_state - log.state
        moved = moved - np.where(np.isfinite(turn), turn, 0.0) * np.round(moved / turn)
        self.coefficients = np.zeros((task.n_actions, x.shape[1], task.n_state))
        left = np.zeros_like(moved)
        with ONE_THREAD:
            for a in range(task.n_actions):
                rows = actions == a if (actions == a).any() else slice(None)
                self.coefficients[a] = np.linalg.lstsq(x[rows], moved[rows])[0]
                left[rows] = moved[rows] - x[rows] @ self.coefficients[a]
            size, axes = np.linalg.eigh(left.T @ left / len(left))
        self.root = axes * np.sqrt(np.maximum(size, 0.0))

    def _design(self, states: Array) -> Array:
        return np.column_stack([np.ones(len(states)), self.task.smooth(states)])

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        x, following = self._design(states), states + disturbance @ self.root.T
        for a in range(self.task.n_actions):
            rows = actions == a
            following[rows] += x[rows] @ self.coefficients[a]
        following = np.clip(following, self.low, self.high)
        paid = self.task.reward_between(states, actions, following)
        if paid is None:
            paid = self.task.moves(states, actions, np.zeros((len(states), self.task.n_disturbances))).reward
        return Moves(following, paid, self.task.terminated(following))
