"""A linear-Gaussian model of the arm: what a log says of it without a simulator and without cells."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular._checks import Array, IntArray
from oee_tabular._threads import ONE_THREAD
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.reacher.dynamics import Reacher
from oee_tabular.continuous.task import Moves, check_states


@dataclass(frozen=True)
class LinearReacher(Reacher):
    """s' = s + A s + B u + c + N(0, Sigma), fitted to a log by least squares; rewards and beginnings are the arm's.

    Made by ``LinearReacher.fit``; the other fields are the arm's.

    Attributes
    ----------
    coefficients : (7, 4), of 1, the state's four and the command's two
    root : (4, 4), Cholesky's of Sigma, the residuals' covariance

    Examples
    --------
    >>> from oee_tabular.tasks import reacher_log
    >>> model = LinearReacher.fit(reacher_log(Reacher.tamed(), 1000, max_steps=25, seed=0), Reacher.tamed())
    >>> still = np.zeros((2, 4))
    >>> back, forth = model.moves(still, np.array([0, 8]), still).next_state[:, 2]  # the shoulder's speed
    >>> bool(back < 0 < forth)
    True
    """

    n_disturbances = 4

    coefficients: Array = field(default_factory=lambda: np.zeros((7, 4)), compare=False, repr=False)
    root: Array = field(default_factory=lambda: np.zeros((4, 4)), compare=False, repr=False)

    @classmethod
    def fit(cls, log: ContinuousTransitions, task: Reacher | None = None) -> LinearReacher:
        """The least-squares fit to ``log``, with the reward of ``task`` (default: the paper's arm); O(n).

        Raises
        ------
        ValueError
            A log with other dimensions than the arm's, or actions that are not its.

        Examples
        --------
        >>> from oee_tabular.tasks import record
        >>> from oee_tabular.continuous.reacher.expert import reacher_policy
        >>> log = record(Reacher.tamed(), reacher_policy(1.0), n_transitions=2000, max_steps=25, seed=0)
        >>> LinearReacher.fit(log, Reacher.tamed()).coefficients.shape
        (7, 4)
        """
        base = Reacher() if task is None else task
        states = check_states(base, log.state, "log.state")
        design = _design(states, base.actions[log.action_numbers(base.actions)])
        change = log.next_state - states
        with ONE_THREAD:
            coefficients: Array = np.asarray(np.linalg.lstsq(design, change)[0], dtype=np.float64)
            rest = change - design @ coefficients
            covariance = rest.T @ rest / len(rest) + 1e-12 * np.eye(4)
            root: Array = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        options: dict[str, Any] = base.parameters() | {"target": base.target}
        return cls(**options, coefficients=coefficients, root=root)

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step of the model."""
        drift = _design(states, self.actions[np.asarray(actions, dtype=np.int64)]) @ self.coefficients
        following = states + drift + disturbance @ self.root.T
        return Moves(following, self.reward_between(states, actions, following), np.zeros(len(states), dtype=np.bool_))


def _design(states: Array, commands: Array) -> Array:
    return np.column_stack([np.ones(len(states)), states, commands])
