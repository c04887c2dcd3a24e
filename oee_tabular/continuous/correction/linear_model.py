"""A model of the steps learned from a log alone, linear in the smooth coordinates."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from scipy.special import ndtr

from oee_tabular import _checks
from oee_tabular._parallel import one_thread
from oee_tabular.continuous.correction.regression import draw_groups
from oee_tabular.continuous.correction.scatter import Pool, draw_rows
from oee_tabular.continuous.log.numbering import number_actions
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    DerivedTask,
    Moves,
    find_periods,
    shortest,
)
from oee_tabular.typing import Array, IntArray, Seed

N_GROUPS = 40  # of whole episodes, by which a linear model is resampled


class LinearModel(DerivedTask):
    """A task with steps linear in its smooth coordinates, fitted to a log alone.

    It is what a corrected simulator must beat:

        s' = s + B_a (1, x(s)) + e,

    B_a by least squares on the log's transitions of action a, x the task's ``smooth``
    coordinates (cosine and sine of angles), e a whole row's residual drawn from the
    log's transitions of the same action. The simulator says only where episodes begin,
    where they end and what the rewards are.

    Parameters
    ----------
    task : ContinuousTask
        The simulator, for its rewards, ends and beginnings.
    log : ContinuousTransitions
        A log of the target.

    Attributes
    ----------
    coefficients : ndarray of shape (A, p, d)
        B_a of each action; an action that was never recorded has those of all
        transitions.
    residuals : ndarray of shape (n, d)
        What they leave over of s' - s in each row.

    Raises
    ------
    ValueError
        If the log has other states than the task, or actions that it has not.

    See Also
    --------
    ResidualSimulator : A simulator corrected by a log.

    Notes
    -----
    Next states stay within those that were logged, for a linear model's own may run
    away. Rewards are ``reward_between``'s, or else those of the simulator's own step
    from (s, a). Costs O(n p^2).

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> log = record(
    ...     CartPole(15.0),
    ...     cartpole_policy(0.3),
    ...     n_transitions=2000,
    ...     max_steps=100,
    ...     seed=0,
    ... )
    >>> model = LinearModel(CartPole(10.0), log)
    >>> model.residuals.shape, bool(np.abs(model.residuals).max() < 0.02)
    ((2000, 4), True)
    """

    def __init__(self, task: ContinuousTask, log: ContinuousTransitions) -> None:
        super().__init__(
            _checks.instance(task, ContinuousTask, "task"),
            f"linear model of a log of {task.name}",
        )
        self.n_disturbances = 1
        self._actions = number_actions(task, log)
        periods = find_periods(task, log.next_state)
        self._x = self._inputs(log.state)
        self._y = shortest(log.next_state - log.state, periods)
        low = log.next_state.min(axis=0)
        high = log.next_state.max(axis=0)
        # an angle may turn without end
        self._limits = np.where(periods > 0, [[-np.inf], [np.inf]], [low, high])
        # there are no more groups than rows, so that none of them is empty
        self._group = np.arange(len(log)) * min(N_GROUPS, len(log)) // len(log)
        if log.episode is not None and len(np.unique(log.episode)) >= N_GROUPS:
            self._group = np.unique(log.episode, return_inverse=True)[1] % N_GROUPS
        self._fit(np.ones(len(log)))

    def _inputs(self, states: Array) -> Array:
        """Return the inputs of the regression, 1 and the smooth coordinates."""
        return np.column_stack([np.ones(len(states)), self.task.smooth(states)])

    def _fit(self, weights: Array) -> None:
        """Fit least squares with these weights of the rows.

        Residuals are drawn by the weights.
        """
        self.coefficients = np.empty(
            (self.n_actions, self._x.shape[1], self._y.shape[1])
        )
        self._pools = []
        for a in range(self.n_actions):
            rows = np.flatnonzero((self._actions == a) & (weights > 0))
            if len(rows) <= self._x.shape[1]:
                rows = np.arange(len(weights))
            root = np.sqrt(weights[rows])[:, None]
            self.coefficients[a] = np.linalg.lstsq(
                root * self._x[rows], root * self._y[rows]
            )[0]
            self._pools.append(Pool(rows, np.cumsum(weights[rows])))
        self.residuals = self._y - np.einsum(
            "np,npk->nk", self._x, self.coefficients[self._actions]
        )

    def resampled(self, seed: Seed = None) -> LinearModel:
        """Return the model of a bootstrap's log.

        Parameters
        ----------
        seed : int, Generator or SeedSequence, optional
            The source of random numbers. The same seed gives the same bits.

        Returns
        -------
        LinearModel
            The model fitted to groups of whole episodes drawn with replacement.
        """
        again = copy.copy(self)
        again._fit(draw_groups(int(self._group.max()) + 1, seed)[self._group])
        return again

    @one_thread
    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take one step from each state.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        disturbance : ndarray of shape (n, 1)
            The disturbance, which chooses the residual.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        actions = np.asarray(actions, dtype=np.int64)
        x = self._inputs(states)
        uniform = ndtr(disturbance[:, 0])
        following = np.array(states, dtype=np.float64)
        for a in np.unique(actions):
            at = np.flatnonzero(actions == a)
            drawn = self.residuals[draw_rows(self._pools[a], uniform[at])]
            following[at] += x[at] @ self.coefficients[a] + drawn
        following = np.clip(following, *self._limits)
        reward = self.task.reward_between(states, actions, following)
        if reward is None:
            reward = self.task.noiseless_step(states, actions).reward
        ends = self.task.terminated(following) & self.terminates
        return Moves(following, reward, ends)

    def parameters(self) -> dict[str, Any]:
        """Return the task's parameters, and the number of transitions of the log.

        Returns
        -------
        dict
            The parameters.
        """
        return self.task.parameters() | {"linear_model_of_moves": len(self.residuals)}
