"""States that include the last actions, and a test of whether earlier actions matter.

Where steps are delayed, or an actuator has a memory, s' depends on more than (s, a).
What a correction g leaves over is then predicted by the actions and the residuals of
earlier steps, y_t by a_{t-1}, ..., a_{t-5} and y_{t-1}, ..., y_{t-5}. Independent
residuals cannot carry that, and every value that takes the state to be Markov is wrong.
With the last actions in the state (``HistoryTask``) a delay is Markov again, and a
motor's lag nearly so.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular.continuous.log import CHAIN_TOLERANCE, ContinuousTransitions
from oee_tabular.continuous.scatter import Neighbors
from oee_tabular.continuous.task import (
    ContinuousTask,
    DerivedTask,
    Moves,
    StatePolicy,
    require_log_of,
)
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from oee_tabular.continuous.residual import ResidualSimulator

# what of an earlier step matters
Kind: TypeAlias = Literal["action", "residual"]

FOLDS = 4
MAX_LAG = 5  # steps back that the test looks at, and that a report tries in the state
# rows by which the test is made; slow tasks step one state at a time
MIN_ROWS = 200
MAX_ROWS = 20_000
MAX_SLOW_ROWS = 3000
N_NEIGHBORS = 4  # whose mean residual is what (s, a) itself explains
NUMBERS = ("", "one step", "two steps", "three steps", "four steps", "five steps")
MAX_CLIPPED = 8.0  # root mean squares: what rows at contacts count at most
# What is explained must be so many standard errors over rows from 0, which fewer than
# 16 rows cannot make it.
MIN_STANDARD_ERRORS = 4.0


@suggest_keywords
class HistoryTask(DerivedTask):
    """A task whose state includes its last actions.

    Each of the last actions has A coordinates: 1 at its number and 0 elsewhere, or 0 in
    all before an episode. The task's own coordinates, actions, rewards and units stay.

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
        require_log_of(self.task, log)
        actions = log.action_numbers(self.actions)
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
        codes = np.eye(self.n_actions + 1, self.n_actions)  # the last: no action
        last = codes[np.where(earlier >= 0, actions[earlier], -1)].reshape(len(log), -1)
        states = np.column_stack([log.state, last])
        columns = {
            "state": states,
            "next_state": self._append_action(states, actions, log.next_state),
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

    def _append_action(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> Array:
        """Return the task's next states with the actions taken and the earlier ones."""
        last = np.column_stack([np.eye(self.n_actions)[actions], self._last(states)])
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
        return replace(
            moved, next_state=self._append_action(states, actions, moved.next_state)
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
        return replace(
            moved, next_state=self._append_action(states, actions, moved.next_state)
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


@dataclass(frozen=True)
class HistoryEffect:
    """What earlier actions and residuals explain of one coordinate's residual.

    Attributes
    ----------
    r_squared : float
        The share of its mean square that all of the last five explain, on episodes to
        which the regression was not fitted.
    lag : int
        How many steps back the action or residual lies that alone explains most.
    of : {'action', 'residual'}
        Which of the two it is.
    lag_r_squared : float
        The share of the mean square that it explains.
    part : float
        The root mean square of what they explain, in the coordinate's unit. Rows far
        from the others count with at most ``MAX_CLIPPED`` root mean squares.
    """

    r_squared: float = 0.0
    lag: int = 1
    of: Kind = "action"
    lag_r_squared: float = 0.0
    part: float = 0.0


def history_effects(
    task: ContinuousTask,
    log: ContinuousTransitions,
    actions: IntArray,
    residuals: Array,
    group: IntArray,
    *,
    is_smooth: BoolArray,
    is_free: BoolArray,
    least: Array,
) -> list[HistoryEffect]:
    """Compute what history explains of each coordinate's residual.

    What the action's own mean and the residuals near by explain is taken off first.
    Linear regressions on the last five actions, the steps that the simulator makes
    under them, and the last five residuals are fitted on smooth rows (no contacts), and
    on the actions alone at all free rows (no stops), because a delay of a command that
    rarely changes is a rare large residual too. There is no effect where fewer than 200
    rows follow another, or where what is explained is below ``least`` (k,) among the
    rows that were looked at: a few odd rows do not make it larger.
    """
    earlier = earlier_rows(log, MAX_LAG)
    n_most = MAX_ROWS if task.steps_at_once else MAX_SLOW_ROWS
    rows = np.flatnonzero((earlier[:, 0] >= 0) & is_free)[:n_most]
    best = [HistoryEffect() for _ in residuals.T]
    if len(rows) < MIN_ROWS:
        return best
    # the last code stands for no action, as row -1 stands for no row
    codes = np.vstack([np.eye(task.n_actions)[actions], np.zeros(task.n_actions)])
    own = task.noiseless_step(log.state[rows], actions[rows]).next_state
    acted = []
    # inputs are which action was taken then, and where the simulator would go under it
    for back in earlier[rows].T:
        then = np.where(back >= 0, actions[back], actions[rows])
        other = task.noiseless_step(log.state[rows], then).next_state - own
        scale = other.std(axis=0)
        acted.append(
            np.column_stack([codes[back], other[:, scale > 0] / scale[scale > 0]])
        )
    for is_usable, has_residuals in ((is_smooth, True), (is_free, False)):
        used = rows[is_usable[rows]]
        if len(used) < MIN_ROWS:
            continue
        unit = np.sqrt((residuals[is_usable] ** 2).mean(axis=0))
        scaled = residuals / np.where(unit > 0, unit, 1.0)
        y = np.clip(scaled, -MAX_CLIPPED, MAX_CLIPPED) * is_usable[:, None]
        blocks: dict[tuple[int, Kind], Array] = {}
        for k, block in enumerate(acted, start=1):
            blocks[k, "action"] = block[is_usable[rows]]
        if has_residuals:
            padded = np.vstack([y, np.zeros(y.shape[1])])  # -1 is no row
            for k, back in enumerate(earlier[used].T, start=1):
                blocks[k, "residual"] = padded[back]
        near = _mean_near(task, log.state, actions, y, is_usable, group)[used]
        x = np.column_stack([codes[used], near])
        target = y[used]
        fold = group[used] % FOLDS
        plain = _errors_held_out([x], target, fold)
        total = np.where(plain.any(axis=0), plain.sum(axis=0), np.inf)
        gained = plain - _errors_held_out([x, *blocks.values()], target, fold)
        shares: dict[tuple[int, Kind], Array] = {}
        for key, block in blocks.items():
            alone = _errors_held_out([x, block], target, fold)
            shares[key] = (plain - alone).sum(axis=0) / total
        whole = gained.sum(axis=0) / total
        size = unit * np.sqrt((target**2).mean(axis=0))
        n_deviations = MIN_STANDARD_ERRORS * len(used) ** 0.5
        is_sure = gained.sum(axis=0) > n_deviations * gained.std(axis=0)
        is_large = np.sqrt(np.maximum(whole, 0.0)) * size > least
        is_better = whole > [effect.r_squared for effect in best]
        for target_number in np.flatnonzero(is_sure & is_large & is_better):
            k = int(target_number)
            (lag, kind), share = max(shares.items(), key=lambda item: item[1][k])
            best[k] = HistoryEffect(
                float(whole[k]),
                lag,
                kind,
                float(share[k]),
                float(whole[k] ** 0.5 * size[k]),
            )
    return best


def hidden_state(learned: ResidualSimulator) -> str:
    """Describe which earlier action or residual matters most to a correction.

    Returns "" where the state is Markov.
    """
    hidden = [c for c in learned.coordinates if c.hidden]
    # coordinates that are equal to rounding stay in the task's order
    hidden.sort(key=lambda c: -round(c.history.lag_r_squared, 6))
    if not hidden:
        return ""
    effect = hidden[0].history
    key = (effect.lag, effect.of)
    same = [c.name for c in hidden if (c.history.lag, c.history.of) == key]
    text = (
        f"the {effect.of} of {NUMBERS[effect.lag]} ago explains"
        f" {effect.lag_r_squared:.0%} of the residual in "
    )
    if len(same) > 1:
        text += f"{', '.join(same[:-1])} and {same[-1]}"
    else:
        text += same[0]
    more = (
        f" (the last {NUMBERS[MAX_LAG].split()[0]} actions and residuals together:"
        f" {effect.r_squared:.0%})"
    )
    return text + more if effect.r_squared > effect.lag_r_squared + 0.05 else text


def _mean_near(
    task: ContinuousTask,
    states: Array,
    actions: IntArray,
    y: Array,
    is_usable: BoolArray,
    group: IntArray,
) -> Array:
    """Compute the mean (n, k) of the nearest rows of the same action in other folds.

    It is what (s, a) explains, however rough.
    """
    neighbors = Neighbors(task, states)
    mean = np.zeros_like(y)
    fold = group % FOLDS
    for a, f in itertools.product(np.unique(actions), range(FOLDS)):
        here = np.flatnonzero((actions == a) & (fold == f))
        there = np.flatnonzero((actions == a) & (fold != f) & is_usable)
        if len(here) and len(there) >= N_NEIGHBORS:
            near = neighbors.find(states[here], there, N_NEIGHBORS, key=(a, f))
            mean[here] = y[near].mean(axis=1)
    return mean


def _errors_held_out(inputs: list[Array], y: Array, fold: IntArray) -> Array:
    """Compute squared errors (n, k) of a linear regression on held-out folds."""
    x = np.column_stack(inputs)
    errors = np.empty_like(y)
    for f in range(FOLDS):
        inside = fold == f
        outside = fold != f
        gram = x[outside].T @ x[outside]
        gram[np.diag_indices_from(gram)] += 1e-6 * max(int(outside.sum()), 1)
        coefficients = np.linalg.solve(gram, x[outside].T @ y[outside])
        errors[inside] = (y[inside] - x[inside] @ coefficients) ** 2
    return errors
