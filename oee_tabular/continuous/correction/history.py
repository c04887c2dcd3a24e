"""States that include the last actions.

With the last actions in the state (``HistoryTask``) a delay is Markov again, and a
motor's lag nearly so. ``hidden_state`` finds whether they matter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular.continuous.log.numbering import number_and_share
from oee_tabular.continuous.log.transitions import (
    CHAIN_TOLERANCE,
    ContinuousTransitions,
)
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    DerivedTask,
    Moves,
    StatePolicy,
    find_periods,
    shortest,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, IntArray

if TYPE_CHECKING:
    pass


@suggest_keywords
class HistoryTask(DerivedTask):
    """A task whose state includes its last actions.

    Each of the last actions has A coordinates: 1 at its number and 0 elsewhere, or 0 in
    all before an episode. A logged command between the task's actions has its shares of
    them instead, whose mean it is. The task's own coordinates, actions, rewards and
    units stay.

    Parameters
    ----------
    task : ContinuousTask
        The task.
    steps : int, default 1
        How many actions are kept, the last one first.

    Raises
    ------
    ValueError
        If ``steps`` is below 0.

    See Also
    --------
    ResidualSimulator : Correct such a task by a log.

    Notes
    -----
    ``log`` brings a log into these states, ``policy`` a policy of the task's own. The
    task itself does not look at the last actions; a ``ResidualSimulator`` of it learns
    what does, from the steps that the task makes under each of them.

    Examples
    --------
    >>> from oee_tabular.tasks import CartPole, cartpole_policy, record
    >>> task = HistoryTask(CartPole(), 2)
    >>> log = task.log(
    ...     record(
    ...         CartPole(), cartpole_policy(1.0), n_transitions=50, max_steps=20, seed=0
    ...     )
    ... )
    >>> log.state[:3, 4:].tolist(), log.action[:2].tolist()
    ([[0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0]], [1, 0])
    """

    def __init__(self, task: ContinuousTask, steps: int = 1) -> None:
        self.steps = steps = check_n_actions(steps, "steps")
        # names, and as many coordinates of each of a thousand states
        _checks.require_memory(1000.0 * steps, "steps", steps)
        about = "action" if steps == 1 else f"{steps} actions"
        super().__init__(
            _checks.instance(task, ContinuousTask, "task"),
            f"{task.name} with its last {about}",
        )
        names = [
            "last_action_{}",
            *(f"action_{{}}_{k}_steps_ago" for k in range(2, steps + 1)),
        ][:steps]
        last = tuple(name.format(a) for name in names for a in range(task.n_actions))
        self.state_names = task.state_names + last
        self.feature_names = task.feature_names + last
        self.feature_low = freeze(
            np.concatenate([task.feature_low, np.zeros(len(last))])
        )
        self.feature_high = freeze(
            np.concatenate([task.feature_high, np.ones(len(last))])
        )
        self.periodic = tuple(task.periodic) + (False,) * len(last)

    def log(self, log: ContinuousTransitions) -> ContinuousTransitions:
        """Return the log with the last actions in its states.

        Parameters
        ----------
        log : ContinuousTransitions
            A log of the task's own states.

        Returns
        -------
        ContinuousTransitions
            The log; rows that follow no other row of their episode have no last action.

        Raises
        ------
        ValueError
            If the log has other states than the task, or no episode longer than
            ``steps``.
        """
        actions, shares = number_and_share(self.task, log)
        earlier = earlier_rows(log, self.steps)
        if self.steps and not (earlier[:, -1] >= 0).any():
            hint = ""
            if log.episode is None:
                hint = (
                    ": log.episode is not given, and no row begins where another ends"
                )
            raise ArgumentError(
                "steps",
                "must be less than the longest episode's transitions; no row of the log"
                f" has {self.steps} before it{hint}",
            )
        if shares is None:
            shares = np.eye(self.n_actions)[actions]
        known = np.vstack([shares, np.zeros(self.n_actions)])  # the last: no action
        last = known[np.where(earlier >= 0, earlier, -1)].reshape(len(log), -1)
        states = np.column_stack([log.state, last])
        columns = {
            "state": states,
            "next_state": self._append_action(states, shares, log.next_state),
        }
        return ContinuousTransitions(**(log.columns() | columns))

    def policy(self, policy: StatePolicy) -> StatePolicy:
        """Return a policy of the task's own states as one of these states.

        Parameters
        ----------
        policy : function
            The policy: of the task's states (n, d) it gives probabilities (n, A).

        Returns
        -------
        function
            The policy of states with the last actions.
        """
        _checks.function(policy, "policy")
        return lambda states: policy(states[:, : self.task.n_state])

    def own(self, states: Array) -> Array:
        """Return the states without the last actions.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray
            The task's own states, one row for each.
        """
        return np.ascontiguousarray(states[:, : self.task.n_state])

    def _last(self, states: Array) -> Array:
        """Return the last actions (n, steps A) in states or in features."""
        return states[:, states.shape[1] - self.steps * self.n_actions :]

    def _append_action(self, states: Array, shares: Array, next_states: Array) -> Array:
        """Return the task's next states with the actions taken and the earlier ones.

        ``shares`` (n, A) has 1 at the action that was taken, or what its command is
        shared out to.
        """
        last = np.column_stack([shares, self._last(states)])
        return np.column_stack([next_states, last[:, : self.steps * self.n_actions]])

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take the task's step and keep the action taken.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        disturbance : ndarray of shape (n, n_disturbances)
            The disturbance xi, drawn from N(0, I).

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        moved = self.task.moves(self.own(states), actions, disturbance)
        taken = np.eye(self.n_actions)[actions]
        return replace(
            moved, next_state=self._append_action(states, taken, moved.next_state)
        )

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """Take the task's random step and keep the action taken.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        moved = self.task.step(self.own(states), actions, rng)
        taken = np.eye(self.n_actions)[actions]
        return replace(
            moved, next_state=self._append_action(states, taken, moved.next_state)
        )

    def displacements(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> list[Array]:
        """Return the task's displacements and those under each of the last actions.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        next_states : ndarray of shape (n, d)
            Where the task's own step leads.

        Returns
        -------
        list of ndarray
            The task's own, then f(s, b) - s under each of the last actions b, or under
            the present one where there was none.
        """
        own = self.own(states)
        past = self._last(states).reshape(len(states), self.steps, self.n_actions)
        numbers = np.where(
            past.any(axis=2), past.argmax(axis=2), np.asarray(actions)[:, None]
        )
        earlier = [self.task.noiseless_step(own, b).next_state - own for b in numbers.T]
        for step, moved in enumerate(earlier):
            shares = past[:, step]
            if shares.max(initial=0.0) < 1.0 or ((shares > 0) & (shares < 1)).any():
                earlier[step] = (
                    moved
                    + blend_steps(
                        self.task, own, numbers[:, step], own + moved, shares
                    ).next_state
                )
        return self.task.displacements(own, actions, self.own(next_states)) + earlier

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw the task's initial states, without a last action.

        Parameters
        ----------
        n : int
            How many states are drawn.
        rng : numpy.random.Generator
            The source of random numbers.

        Returns
        -------
        ndarray of shape (n, d)
            The states.
        """
        return np.pad(
            self.task.initial_states(n, rng), ((0, 0), (0, self.steps * self.n_actions))
        )

    def initial_points(self) -> tuple[Array, Array]:
        """Return the task's initial points, without a last action.

        Returns
        -------
        states : ndarray of shape (m, d)
            The states.
        weights : ndarray of shape (m,)
            Their weights, which sum to 1.
        """
        points, weights = self.task.initial_points()
        return np.pad(points, ((0, 0), (0, self.steps * self.n_actions))), weights

    def features(self, states: Array) -> Array:
        """Return the task's features and the last actions.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, k)
            The features.
        """
        return np.column_stack(
            [self.task.features(self.own(states)), self._last(states)]
        )

    def smooth(self, states: Array) -> Array:
        """Return the task's smooth coordinates and which last actions there were.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, m)
            The coordinates.
        """
        last = self._last(states).reshape(len(states), self.steps, self.n_actions)
        return np.column_stack([self.task.smooth(self.own(states)), last.any(axis=2)])

    def embed(self, features: Array) -> Array:
        """Return states with the task's features and these last actions.

        Parameters
        ----------
        features : ndarray of shape (n, k)
            The features.

        Returns
        -------
        ndarray of shape (n, d)
            The states.
        """
        return np.column_stack(
            [
                self.task.embed(features[:, : len(self.task.feature_names)]),
                self._last(features),
            ]
        )

    def parameters(self) -> dict[str, Any]:
        """Return the task's parameters and the number of last actions.

        Returns
        -------
        dict
            The parameters, with the number of actions under "history".
        """
        return self.task.parameters() | {"history": self.steps}


def count_whole_actions(
    task: HistoryTask, low: Array, high: Array
) -> tuple[Array, Array]:
    """Return a range of features (k,) in which shared actions count as whole ones.

    It reaches up to 1 where any row has a share of a last action, and down to 0 where
    any has less than all of it.
    """
    low, high = low.copy(), high.copy()
    at = len(low) - task.steps * task.n_actions
    low[at:] = np.where(low[at:] < 1.0, 0.0, 1.0)
    high[at:] = np.where(high[at:] > 0.0, 1.0, 0.0)
    return low, high


def blend_steps(
    task: ContinuousTask,
    states: Array,
    actions: IntArray,
    following: Array,
    shares: Array,
) -> Moves:
    """Return by how much steps under shared commands differ from those under actions.

    Parameters
    ----------
    task : ContinuousTask
        The task.
    states : ndarray of shape (n, d)
        The states.
    actions : ndarray of int, shape (n,)
        The action of each state.
    following : ndarray of shape (n, d)
        Where it leads.
    shares : ndarray of shape (n, A)
        How the command of each state is shared out; 0 in all leaves the action.

    Returns
    -------
    Moves
        Differences of next states, sum_b shares_b (f(s, b) - f(s, a)), those of angles
        the shorter way, and of rewards. No row ends.
    """
    periods = find_periods(task, following)
    moved = np.zeros_like(following)
    paid = np.zeros(len(states))
    own = None
    for b in range(task.n_actions):
        rows = np.flatnonzero((shares[:, b] > 0) & (actions != b))
        if not len(rows):
            continue
        if own is None:
            own = task.noiseless_step(states, actions).reward
        there = task.noiseless_step(states[rows], np.full(len(rows), b))
        share = shares[rows, b]
        apart = shortest(there.next_state - following[rows], periods)
        moved[rows] += share[:, None] * apart
        paid[rows] += share * (there.reward - own[rows])
    return Moves(moved, paid, np.zeros(len(states), dtype=np.bool_))


def check_n_actions(value: int, name: str) -> int:
    """Return a number of last actions, 0 or a positive integer."""
    if value is not False and _checks.is_zero(value):
        return 0
    return _checks.positive_integer(value, name)


def consecutive(log: ContinuousTransitions) -> tuple[IntArray, IntArray]:
    """Return rows and the rows that follow them in the same episode.

    Without episodes a row follows where it begins as the one before it ends.
    """
    if log.episode is None:
        order = np.arange(len(log))
    else:
        order = np.argsort(log.episode, kind="stable")
    before = order[:-1]
    after = order[1:]
    gap = np.abs(log.state[after] - log.next_state[before])
    tolerance = CHAIN_TOLERANCE * (1.0 + np.abs(log.state[after]))
    begins_there = (gap <= tolerance).all(axis=1)
    follows = begins_there & ~(log.terminated | log.truncated)[before]
    if log.episode is not None:
        follows &= log.episode[after] == log.episode[before]
    return before[follows], after[follows]


def earlier_rows(log: ContinuousTransitions, steps: int) -> IntArray:
    """Return the rows (n, steps) one, two, ... steps before each, -1 where none is.

    They are rows of the same episode.
    """
    before, after = consecutive(log)
    last = np.full(len(log) + 1, -1)  # the last entry is that of no row
    last[after] = before
    rows = [np.arange(len(log))]
    for _ in range(steps):
        rows.append(last[rows[-1]])
    return np.stack(rows, axis=1)[:, 1:]
