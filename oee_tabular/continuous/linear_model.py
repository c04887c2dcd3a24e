"""A linear model of the log alone, as a ``ContinuousTask``: what a corrected simulator must beat.

    s' = s + B_a (1, x(s)) + e,    B_a by least squares on the log's transitions of action a,

x the task's ``smooth`` coordinates (cosine and sine of angles), e a whole row's residual drawn from the log's transitions of
the same action. The simulator says only where episodes begin, where they end and what the rewards are.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from scipy.special import ndtr

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular._threads import one_thread
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.regression import draw_groups
from oee_tabular.continuous.scatter import draw_rows
from oee_tabular.continuous.task import ContinuousTask, DerivedTask, Moves, find_periods, require_log_of, shortest

N_GROUPS = 40  # of whole episodes, for resampling


class LinearModel(DerivedTask):
    """The task with steps linear in its smooth coordinates, fitted to a log.

    Parameters
    ----------
    task : ContinuousTask, for its rewards, ends and beginnings
    log : ContinuousTransitions of the target

    Attributes
    ----------
    coefficients : (A, p, d) B_a; an action that was never recorded has those of all transitions
    residuals : (n, d) what they leave over

    Raises
    ------
    ValueError
        A log of other states than the task's, or of actions that it has not.

    Notes
    -----
    Next states stay within those that were logged, for a linear model's own may run away. Rewards are ``reward_between``'s, or
    else those of the simulator's own step from (s, a). O(n p^2).

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(CartPole(15.0), cartpole_policy(0.3), n_transitions=2000, max_steps=100, seed=0)
    >>> model = LinearModel(CartPole(10.0), log)
    >>> model.residuals.shape, bool(np.abs(model.residuals).max() < 0.02)
    ((2000, 4), True)
    """

    def __init__(self, task: ContinuousTask, log: ContinuousTransitions) -> None:
        super().__init__(_checks.instance(task, ContinuousTask, "task"), f"linear model of a log of {task.name}")
        require_log_of(task, log)
        self.n_disturbances = 1
        self._actions, periods = log.action_numbers(task.actions), find_periods(task, log.next_state)
        self._x, self._y = self._inputs(log.state), shortest(log.next_state - log.state, periods)
        low, high = log.next_state.min(axis=0), log.next_state.max(axis=0)
        self._limits = np.where(periods > 0, [[-np.inf], [np.inf]], [low, high])  # an angle may go round
        self._group = np.arange(len(log)) * min(N_GROUPS, len(log)) // len(log)  # none of them empty
        if log.episode is not None and len(np.unique(log.episode)) >= N_GROUPS:
            self._group = np.unique(log.episode, return_inverse=True)[1] % N_GROUPS
        self._fit(np.ones(len(log)))

    def _inputs(self, states: Array) -> Array:
        return np.column_stack([np.ones(len(states)), self.task.smooth(states)])

    def _fit(self, weights: Array) -> None:
        """Least squares with these weights of the rows, by which residuals are drawn."""
        self.coefficients = np.empty((self.n_actions, self._x.shape[1], self._y.shape[1]))
        self._pools = []
        for a in range(self.n_actions):
            rows = np.flatnonzero((self._actions == a) & (weights > 0))
            if len(rows) <= self._x.shape[1]:
                rows = np.arange(len(weights))
            root = np.sqrt(weights[rows])[:, None]
            self.coefficients[a] = np.linalg.lstsq(root * self._x[rows], root * self._y[rows])[0]
            self._pools.append((rows, np.cumsum(weights[rows])))
        self.residuals = self._y - np.einsum("np,npk->nk", self._x, self.coefficients[self._actions])

    def resampled(self, seed: Any = None) -> LinearModel:
        """The same of a bootstrap's log: groups of whole episodes drawn with replacement."""
        again = copy.copy(self)
        again._fit(draw_groups(int(self._group.max()) + 1, seed)[self._group])
        return again

    @one_thread
    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step; the disturbance chooses the residual."""
        actions, x, uniform = np.asarray(actions, dtype=np.int64), self._inputs(states), ndtr(disturbance[:, 0])
        following = np.array(states, dtype=np.float64)
        for a in np.unique(actions):
            at = np.flatnonzero(actions == a)
            following[at] += x[at] @ self.coefficients[a] + self.residuals[draw_rows(self._pools[a], uniform[at])]
        following = np.clip(following, *self._limits)
        reward = self.task.reward_between(states, actions, following)
        if reward is None:
            reward = self.task.noiseless_step(states, actions).reward
        return Moves(following, reward, self.task.terminated(following) & self.terminates)

    def parameters(self) -> dict[str, Any]:
        """The task's, and how many transitions the model is fitted to."""
        return self.task.parameters() | {"linear_model_of_moves": len(self.residuals)}
