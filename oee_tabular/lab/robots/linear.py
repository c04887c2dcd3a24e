"""A linear-Gaussian model of a log, the paper's baseline: what a log says of a task without a simulator and without cells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular._threads import ONE_THREAD
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, DerivedTask, Moves


class LinearGaussian(DerivedTask):
    """s' = s + A s + B u + c + N(0, Sigma) in some coordinates, by least squares; rewards, ends and beginnings are the task's.

    One model of all actions u, where ``LinearModel`` has one of each. The coordinates that are left out stay as they are.
    """

    def __init__(self, task: ContinuousTask, log: ContinuousTransitions, coordinates: slice = slice(None)) -> None:
        super().__init__(task, f"linear-Gaussian model of a log of {task.name}")
        self._at = coordinates
        design = self._inputs(log.state, log.action_numbers(task.actions))
        change = (log.next_state - log.state)[:, coordinates]
        self.n_disturbances = change.shape[1]
        with ONE_THREAD:
            self.coefficients = np.linalg.lstsq(design, change)[0]
            rest = change - design @ self.coefficients
            self.root = np.linalg.cholesky(rest.T @ rest / len(rest) + 1e-12 * np.eye(self.n_disturbances))

    def _inputs(self, states: Array, actions: IntArray) -> Array:
        return np.column_stack([np.ones(len(states)), states[:, self._at], self.actions[actions]])

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step of the model."""
        following = np.array(states)
        following[:, self._at] += self._inputs(states, actions) @ self.coefficients + disturbance @ self.root.T
        moved = self.task.moves(states, actions, np.zeros((len(states), self.task.n_disturbances)))
        paid = self.task.reward_between(states, actions, following)
        reward = moved.reward if paid is None else paid
        return replace(moved, next_state=following, reward=reward, terminated=self.task.terminated(following))
