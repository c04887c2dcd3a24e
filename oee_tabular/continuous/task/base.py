"""Continuous tasks: what they must offer so that they can become a FiniteMDP.

A task is a set of numbered actions, a place where episodes begin, and one step:

    s' = f(s, a, xi),   xi ~ N(0, I),     with its reward and whether s' is terminal.

All randomness of a step comes from the disturbance xi, whose length the task declares.
So the same xi can be used twice (pairing a simulator with its target), replaced by
Gauss-Hermite points (an exact average over Gaussian noise), or set to 0. Everything is
vectorised over states: (n, d) in, (n, d) out.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
from scipy.special import ndtr

from oee_tabular import _checks
from oee_tabular._results import checked
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray

if TYPE_CHECKING:
    from oee_tabular.continuous.discretization.build import CellsLike
else:
    CellsLike: TypeAlias = Any  # for ``typing.get_type_hints``

StatePolicy: TypeAlias = Callable[[Array], Array]


@checked()
@dataclass(frozen=True, eq=False)
class Moves:
    """One step from each of n states.

    Attributes
    ----------
    next_state : ndarray of shape (n, d)
        The next states.
    reward : ndarray of shape (n,)
        The rewards of the steps.
    terminated : ndarray of bool, shape (n,)
        Whether the episode ends in ``next_state``.

    Examples
    --------
    >>> Moves(np.array([[0.5]]), np.ones(1), np.array([False])).next_state.tolist()
    [[0.5]]
    """

    next_state: Array
    reward: Array
    terminated: BoolArray


class ContinuousTask(ABC):
    """A decision process with states in R^d and finitely many actions.

    A subclass sets the attributes, and writes ``moves`` and ``initial_states``; the
    other methods have defaults.

    Attributes
    ----------
    name : str
        The name of the task.
    state_names : tuple of str
        The names of the d coordinates of a state.
    actions : ndarray of shape (A,) or (A, k)
        The actions; action number a means ``actions[a]``. The set is part of the
        environment.
    n_disturbances : int
        The length of xi; 0 where a step is deterministic.
    feature_names : tuple of str
        The names of the k coordinates that are discretised (those of ``features``).
    feature_low, feature_high : ndarray of shape (k,)
        The usual range of each feature, which is the default extent of a grid.
    periodic : tuple of bool
        For each feature, whether it is an angle, whose range closes on itself.
    terminates : bool
        Whether episodes can end before a time limit.
    steps_at_once : bool
        Whether stepping many states costs little more than stepping one.
    default_cells : int, tuple of int or None
        What ``discretize`` takes for ``cells`` where none are given. None leaves it to
        the number of features.
    noise_points : int
        The number of Gauss-Hermite points of each disturbance on a grid; 1 leaves them
        at 0.
    is_translation_invariant : bool
        Whether a command moves the features by about the same wherever it is given.
        ``discretize`` then carries a log's transitions to the vertices, and a ratio may
        be tied over displacements.

    See Also
    --------
    GymnasiumTask : A Gymnasium environment as such a task.
    discretize : Make a finite MDP of a task.

    Notes
    -----
    A reward is 0 after termination. A time limit is not part of a task: it is the
    horizon of an evaluation.

    Examples
    --------
    A point on the line that is pushed to either side; its reward is larger near 0:

    >>> from oee_tabular.tasks import discretize
    >>> class Point(ContinuousTask):
    ...     name, state_names, feature_names = "Point", ("s",), ("s",)
    ...     actions, n_disturbances, periodic, terminates = (
    ...         np.array([-0.25, 0.25]),
    ...         1,
    ...         (False,),
    ...         False,
    ...     )
    ...     feature_low, feature_high = np.array([-1.0]), np.array([1.0])
    ...
    ...     def moves(self, states, actions, disturbance):
    ...         following = np.clip(
    ...             states + self.actions[actions][:, None] + 0.01 * disturbance,
    ...             -1.0,
    ...             1.0,
    ...         )
    ...         return Moves(
    ...             following, -np.abs(states[:, 0]), np.zeros(len(states), dtype=bool)
    ...         )
    ...
    ...     def initial_states(self, n, rng):
    ...         return rng.uniform(-0.1, 0.1, (n, 1))
    >>> discretize(Point(), cells=(9,)).mdp
    FiniteMDP(9 states, 2 actions, 18 transitions, rewards r(s, a), discount 0.99)
    """

    name: str
    state_names: tuple[str, ...]
    actions: Array
    n_disturbances: int
    feature_names: tuple[str, ...]
    feature_low: Array
    feature_high: Array
    periodic: tuple[bool, ...]
    terminates: bool
    steps_at_once: bool = True  # whether many states cost little more than one
    default_cells: CellsLike | None = None
    noise_points: int = 1
    is_translation_invariant: bool = False

    @abstractmethod
    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take one step from each state with a given disturbance.

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

    @abstractmethod
    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw states at which episodes begin.

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

    def terminated(self, states: Array) -> BoolArray:
        """Return which states are terminal; by default none is.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether each state is terminal.
        """
        return np.zeros(len(states), dtype=np.bool_)

    def end_shows(self, states: Array) -> BoolArray:
        """Return whether the features of terminal states show it; by default all do.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            Terminal states.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether the features alone show that the state is terminal.

        Notes
        -----
        Where features leave out what ended an episode, the discretised process goes on:
        it treats such an end as a truncation.
        """
        return np.ones(len(states), dtype=np.bool_)

    def features(self, states: Array) -> Array:
        """Return the coordinates that are discretised; by default the state itself.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, k)
            The features.
        """
        return states

    def smooth(self, states: Array) -> Array:
        """Return coordinates of the states in which functions of a state are smooth.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, m)
            By default the state and those of its features that are not coordinates of
            it, with the cosine and the sine in place of what is periodic.

        Notes
        -----
        A task says here which angles it has.
        """
        features = self.features(states)
        has_same_shape = features.shape == states.shape
        is_state = has_same_shape and bool((features == states).all())
        if not any(self.periodic):
            return states if is_state else np.column_stack([states, features])
        turns = np.array(self.periodic)
        width = np.subtract(self.feature_high, self.feature_low)
        angle = 2.0 * np.pi * features[:, turns] / width[turns]
        others = features[:, ~turns] if is_state else states
        return np.column_stack([others, np.cos(angle), np.sin(angle)])

    def embed(self, features: Array) -> Array:
        """Return states that have these features, from which a grid is stepped.

        Parameters
        ----------
        features : ndarray of shape (n, k)
            The features.

        Returns
        -------
        ndarray of shape (n, d)
            By default the features themselves.
        """
        return features

    def reward_between(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> Array | None:
        """Compute the rewards r(s, a, s') of given transitions, where they are known.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        next_states : ndarray of shape (n, d)
            The next states.

        Returns
        -------
        ndarray of shape (n,) or None
            The rewards; None where the task has no ``reward_terms``.
        """
        before = self.reward_terms(states)
        after = self.reward_terms(next_states)
        if before is None or after is None:
            return None
        return self.reward_of(before, actions, after)

    def reward_terms(self, states: Array) -> Array | None:
        """Compute functions of a state in which the reward of a transition is linear.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of shape (n, m) or None
            The terms; None, the default, where there are none.

        Notes
        -----
        With ``reward_of`` they make a reward that telescopes telescope on cells as
        well. They are for tasks whose episodes do not end.
        """
        return None

    def displacements(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> list[Array]:
        """Return what a correction of the step depends on besides (s, a).

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
        list of ndarray, each of shape (n, at most d)
            By default s' - s of the task's own step.
        """
        return [next_states - states]

    def reward_of(self, before: Array, actions: IntArray, after: Array) -> Array:
        """Compute r(s, a, s') from the reward terms of s and of s'.

        It is linear in both.

        Parameters
        ----------
        before : ndarray of shape (n, m)
            The reward terms of the states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        after : ndarray of shape (n, m)
            The reward terms of the next states.

        Returns
        -------
        ndarray of shape (n,)
            The rewards.
        """
        raise NotImplementedError

    def others(self) -> Sequence[ContinuousTask]:
        """Return the task under other parameters, for a defensive simulator.

        Returns
        -------
        sequence of ContinuousTask
            By default none.
        """
        return ()

    def on_features(self) -> ContinuousTask:
        """Return the task as a process of its features, which ``discretize`` steps.

        Returns
        -------
        ContinuousTask
            By default the task itself.
        """
        return self

    def initial_points(self) -> tuple[Array, Array]:
        """Return weighted states that represent the initial distribution.

        Returns
        -------
        states : ndarray of shape (m, d)
            The states; by default 50 000 draws of one seed.
        weights : ndarray of shape (m,)
            Their weights, which sum to 1; by default all are equal.
        """
        states = self.initial_states(50_000, np.random.default_rng(0))
        return states, np.full(len(states), 1.0 / len(states))

    def parameters(self) -> dict[str, Any]:
        """Return what distinguishes this task from others of its name.

        Returns
        -------
        dict
            Plain numbers and words by name, which are written beside everything that is
            made from the task.
        """
        return {}

    @property
    def n_state(self) -> int:
        """Return the number d of coordinates of a state."""
        return len(self.state_names)

    @property
    def n_actions(self) -> int:
        """Return the number A of actions."""
        return len(self.actions)

    def with_actions(self, actions: Array) -> Self:
        """Return the task with other actions in place of its own.

        Parameters
        ----------
        actions : ndarray of shape (A,) or (A, k)
            The actions.

        Returns
        -------
        ContinuousTask
            A copy. It steps the actions only if ``moves`` reads them from
            ``self.actions``.
        """
        other = copy.copy(self)
        object.__setattr__(other, "actions", actions)  # of frozen tasks as well
        return other

    def noiseless_step(self, states: Array, actions: IntArray) -> Moves:
        """Take one step f(s, a) from each state with xi = 0.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        return self.moves(states, actions, np.zeros((len(states), self.n_disturbances)))

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """Take one random step from each state.

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
        disturbance = rng.standard_normal((len(states), self.n_disturbances))
        return self.moves(states, actions, disturbance)


class DerivedTask(ContinuousTask):
    """A task made of another, whose methods it has unless a subclass overrides them.

    The other task's methods are called with ``own`` of a state.
    """

    def __init__(self, task: ContinuousTask, name: str) -> None:
        for attribute in ContinuousTask.__annotations__:
            setattr(self, attribute, getattr(task, attribute))
        self.task = task
        self.name = name

    def own(self, states: Array) -> Array:
        """Return the other task's states (n, d) in these; by default these."""
        return states

    @staticmethod
    def _delegate(method: str, *at: int) -> Any:
        """Return the other task's method; its arguments at these places are states."""

        def call(self: DerivedTask, *arguments: Any) -> Any:
            """Call the other task's method with its own states."""
            return getattr(self.task, method)(
                *(self.own(x) if k in at else x for k, x in enumerate(arguments))
            )

        return call

    initial_states = _delegate("initial_states")
    initial_points = _delegate("initial_points")
    embed = _delegate("embed")
    reward_of = _delegate("reward_of")
    terminated = _delegate("terminated", 0)
    end_shows = _delegate("end_shows", 0)
    features = _delegate("features", 0)
    smooth = _delegate("smooth", 0)
    reward_terms = _delegate("reward_terms", 0)
    reward_between = _delegate("reward_between", 0, 2)
    displacements = _delegate("displacements", 0, 2)


def check_states(task: ContinuousTask, states: object, name: str = "states") -> Array:
    """Return ``states`` as an array (n, d) of finite numbers, d the task's.

    Raises a ValueError with the place and the value found where that is not possible.
    """
    array = _checks.float_array(states, name)
    if array.ndim != 2 or array.shape[1] != task.n_state:
        raise ArgumentError(
            name,
            f"must have shape (n, {task.n_state}), the {', '.join(task.state_names)} of"
            f" {task.name}; it has shape {array.shape}",
        )
    _checks.require_finite(array, name)
    return array


def require_log_of(task: ContinuousTask, log: ContinuousTransitions) -> None:
    """Raise a ValueError for a log whose states have another length than the task's."""
    _checks.instance(log, ContinuousTransitions, "log")
    if log.n_state != task.n_state:
        way_out = (
            "speeds that were not recorded can be had from positions, by finite"
            " differences or by a Kalman filter"
        )
        if log.n_state > task.n_state:
            way_out = (
                "if these are observations, compute the state from them (an angle by"
                " arctan2 of its sine and cosine)"
            )
        raise ArgumentError(
            "log.state",
            f"must have the {task.n_state} coordinates of {task.name}"
            f" ({', '.join(task.state_names)}); it has {log.n_state}; {way_out}",
        )


class Chance:
    """Stand in for an environment's ``np_random`` with the quantiles at xi in turn.

    At xi = 0 its numbers are the medians. It has what steps draw: normal, uniform and
    whole numbers. Another draw is an AttributeError; drawing more than xi has is an
    IndexError.

    >>> chance = Chance(np.array([0.0, 1.0, 0.0]))
    >>> (
    ...     float(chance.uniform(-1.0, 1.0)),
    ...     float(chance.normal(2.0, 0.5)),
    ...     chance.integers(5),
    ...     chance.used,
    ... )
    (0.0, 2.5, 2, 3)
    """

    def __init__(self, xi: Array) -> None:
        self._xi = xi
        self.used = 0

    def _draw(self, size: Any, *bounds: Any) -> Any:
        """Draw from N(0, 1) with this size, or else with the bounds' shape.

        Where that shape is (), the draw is a number.
        """
        shape = np.broadcast_shapes(*map(np.shape, bounds)) if size is None else size
        end = self.used + int(np.prod(shape))
        n_numbers = len(self._xi)
        if end > n_numbers:
            raise IndexError(
                f"a step must draw at most {n_numbers} random numbers, as when it was"
                " recorded; it draws more"
            )
        drawn = self._xi[self.used : end].reshape(shape)
        self.used = end
        return drawn.copy() if drawn.ndim else float(drawn)

    def standard_normal(self, size: Any = None) -> Any:
        """Draw from N(0, 1)."""
        return self._draw(size)

    def normal(self, loc: Any = 0.0, scale: Any = 1.0, size: object = None) -> Any:
        """Draw from N(loc, scale^2)."""
        return np.float64(loc) + np.float64(scale) * self._draw(size, loc, scale)

    def random(self, size: object = None) -> Any:
        """Draw uniformly from [0, 1)."""
        return self.uniform(0.0, 1.0, size)

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """Draw uniformly from [low, high)."""
        share = np.minimum(ndtr(self._draw(size, low, high)), np.nextafter(1.0, 0.0))
        width = np.float64(high) - np.float64(low)
        return np.float64(low) + width * np.float64(share)

    def integers(
        self,
        low: int,
        high: int | None = None,
        size: object = None,
        *,
        endpoint: bool = False,
    ) -> Any:
        """Draw whole numbers from low to below high.

        Without a high they are from 0 to below low.
        """
        start, end = (0, low) if high is None else (low, high)
        n_values = end + endpoint - start
        steps = np.floor(n_values * np.asarray(self.random(size)))
        drawn = start + steps.astype(np.int64)
        return int(drawn) if size is None else drawn


NO_CHANCE = Chance(np.empty(0))  # in place of random numbers, where none may be drawn


class BadPolicy(ValueError):
    """A policy function's own error, told as what the function must do."""


def ask_policy(policy: Callable[[Array], Any], states: Array) -> Any:
    """Call a policy function with all ``states`` at once.

    Raises a ValueError that says so where the function raises.
    """
    try:
        return policy(states)
    except (MemoryError, BadPolicy):
        raise
    except Exception as error:
        raise BadPolicy(
            "policy must take all states at once, an array of shape (n,"
            f" {states.shape[1]}), and give a row or a number for each; given"
            f" {len(states)} of them it raises {type(error).__name__}: {error} (of a"
            " function of one state: return numpy.array([function(state) for state in"
            " states]))"
        ) from error


def check_probabilities(policy: StatePolicy, states: Array, n_actions: int) -> Array:
    """Return a policy function's probabilities (n, A), whose rows must sum to 1."""
    _checks.function(policy, "policy")
    given = ask_policy(policy, states)
    table = _checks.float_array(given, "policy(states)")
    n = len(states)
    if table.shape != (n, n_actions):
        raise ArgumentError(
            "policy(states)",
            f"must have shape {(n, n_actions)} for {n} states; it has shape"
            f" {table.shape}",
        )
    _checks.require_nonnegative(table, "policy(states)")
    table = _checks.scale_if_single(table, given)
    _checks.require_sums_to_one(table.sum(axis=1), "policy(states)")
    return table


def find_periods(task: ContinuousTask, states: Array) -> Array:
    """Return the period (d,) of each coordinate that is an angle, and 0 for the others.

    Angles are known only where the features of these states are the states.
    """
    if task.n_state != len(task.periodic) or not np.array_equal(
        task.features(states), states
    ):
        return np.zeros(task.n_state)
    return np.where(
        task.periodic, np.subtract(task.feature_high, task.feature_low), 0.0
    )


def shortest(differences: Array, periods: Array) -> Array:
    """Return differences (n, k) of coordinates, those of angles the shorter way."""
    if not periods.any():
        return differences
    each = periods[: differences.shape[1]]
    return np.asarray(
        differences - each * np.round(differences / np.where(each > 0, each, np.inf))
    )
