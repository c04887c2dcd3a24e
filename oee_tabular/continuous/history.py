"""Is the state all that the next one depends on? A test on what a correction leaves over, and the state with the last action.

Where steps are delayed, or an actuator has a memory, s' depends on more than (s, a): what g leaves over is then told by the
action and the left-over before. Independent residuals cannot carry that, and every value that takes the state to be Markov is
wrong; with the last action in the state (``HistoryTask``), one step of delay is Markov again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, freeze
from oee_tabular.continuous.discretization import require_log_of
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, DerivedTask, Moves, StatePolicy

FOLDS = 4
MOST_PAIRS = 100  # pairs of actions that have a mean each
FEWEST = 200  # pairs of consecutive moves by which anything is said


class HistoryTask(DerivedTask):
    """A task whose state has the last action in it: A more coordinates, 1 at its number, all 0 where an episode begins.

    Parameters
    ----------
    task : ContinuousTask

    Notes
    -----
    ``log`` brings a log into these states, ``policy`` a policy of the task's own. The task itself does not look at the last
    action; a ``ResidualSimulator`` of it learns what does.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> task = HistoryTask(CartPole())
    >>> log = task.log(record(CartPole(), cartpole_policy(1.0), n_transitions=50, max_steps=20, seed=0))
    >>> log.state[:3, 4:].tolist(), log.action[:2].tolist()
    ([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]], [1, 0])
    """

    def __init__(self, task: ContinuousTask) -> None:
        super().__init__(_checks.instance(task, ContinuousTask, "task"), f"{task.name} with its last action")
        last = tuple(f"last_action_{a}" for a in range(task.n_actions))
        self.state_names, self.feature_names = task.state_names + last, task.feature_names + last
        self.feature_low = freeze(np.concatenate([task.feature_low, np.zeros(len(last))]))
        self.feature_high = freeze(np.concatenate([task.feature_high, np.ones(len(last))]))
        self.periodic = tuple(task.periodic) + (False,) * len(last)

    def log(self, log: ContinuousTransitions) -> ContinuousTransitions:
        """The log with the last action in its states; rows that follow no other row of their episode have none."""
        require_log_of(self.task, log)
        actions = log.action_numbers(self.actions)
        before, after = consecutive(log)
        last = np.zeros((len(log), self.n_actions))
        last[after] = np.eye(self.n_actions)[actions[before]]
        columns = log.columns()
        columns["state"] = np.column_stack([log.state, last])
        columns["next_state"] = np.column_stack([log.next_state, np.eye(self.n_actions)[actions]])
        return ContinuousTransitions(**columns)

    def policy(self, policy: StatePolicy) -> StatePolicy:
        """A policy of the task's own states as one of these."""
        _checks.function(policy, "policy")
        return lambda states: policy(states[:, : self.task.n_state])

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """The task's, and the action taken."""
        return self._with(actions, self.task.moves(self.own(states), actions, disturbance))

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """The task's, and the action taken."""
        return self._with(actions, self.task.step(self.own(states), actions, rng))

    def own(self, states: Array) -> Array:
        """Without the last action."""
        return np.ascontiguousarray(states[:, : self.task.n_state])

    def _with(self, actions: IntArray, moved: Moves) -> Moves:
        following = np.column_stack([moved.next_state, np.eye(self.n_actions)[np.asarray(actions, dtype=np.int64)]])
        return Moves(following, moved.reward, moved.terminated)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """The task's, without a last action."""
        return np.column_stack([super().initial_states(n, rng), np.zeros((n, self.n_actions))])

    def initial_points(self) -> tuple[Array, Array]:
        """The task's, without a last action."""
        points, weights = super().initial_points()
        return np.column_stack([points, np.zeros((len(points), self.n_actions))]), weights

    def features(self, states: Array) -> Array:
        """The task's, and the last action."""
        return np.column_stack([super().features(states), states[:, self.task.n_state :]])

    def smooth(self, states: Array) -> Array:
        """The task's, and the last action."""
        return np.column_stack([super().smooth(states), states[:, self.task.n_state :]])

    def embed(self, features: Array) -> Array:
        """The task's, and the last action."""
        k = len(self.task.feature_names)
        return np.column_stack([super().embed(features[:, :k]), features[:, k:]])

    def parameters(self) -> dict[str, Any]:
        """The task's."""
        return self.task.parameters() | {"history": 1}


def consecutive(log: ContinuousTransitions) -> tuple[IntArray, IntArray]:
    """Rows and the rows that follow them in the same episode; without episodes, where the next row begins as they end."""
    order = np.arange(len(log)) if log.episode is None else np.argsort(log.episode, kind="stable")
    before, after = order[:-1], order[1:]
    gap = np.abs(log.state[after] - log.next_state[before])
    follows = (gap <= 1e-6 * (1.0 + np.abs(log.state[after]))).all(axis=1) & ~(log.terminated | log.truncated)[before]
    if log.episode is not None:
        follows &= log.episode[after] == log.episode[before]
    return before[follows], after[follows]


def told_by_history(
    left_over: Array, actions: IntArray, n_actions: int, before: IntArray, after: IntArray, group: IntArray
) -> Array:
    """(k,) share of what is left over that the action and the left-over before explain, beyond the action's own means.

    A linear regression on pairs of actions and the left-overs before, by its error on groups of episodes that it was not fitted
    to; 0 where fewer than 200 moves follow another.
    """
    scale = np.sqrt((left_over**2).mean(axis=0))
    y = left_over / np.where(scale > 0, scale, 1.0)
    if len(before) < FEWEST:
        return np.zeros(y.shape[1])
    own = np.eye(n_actions)[actions[after]]
    last = np.eye(n_actions)[actions[before]]
    pairs = (own[:, :, None] * last[:, None]).reshape(len(own), -1) if n_actions**2 <= MOST_PAIRS else last
    fold = group[after] % FOLDS
    plain = _held_out(own, y[after], fold)
    with_history = _held_out(np.column_stack([own, pairs, y[before]]), y[after], fold)
    return np.asarray(np.where(plain > 0, np.maximum(1.0 - with_history / np.where(plain > 0, plain, 1.0), 0.0), 0.0))


def _held_out(x: Array, y: Array, fold: IntArray) -> Array:
    """(k,) sums of squared errors on the folds that were left out."""
    total = np.zeros(y.shape[1])
    for f in range(FOLDS):
        inside, outside = fold == f, fold != f
        gram = x[outside].T @ x[outside]
        gram[np.diag_indices_from(gram)] += 1e-6 * max(int(outside.sum()), 1)
        total += ((y[inside] - x[inside] @ np.linalg.solve(gram, x[outside].T @ y[outside])) ** 2).sum(axis=0)
    return total
