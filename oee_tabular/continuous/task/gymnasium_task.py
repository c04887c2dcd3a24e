"""Continuous tasks of Gymnasium environments whose state can be read and set.

The state must be the environment's own, not its observation: CartPole's observations
are float32 copies of a float64 state, Pendulum's leave the angle to be found from its
sine and cosine. Say how it is read and set, and which actions there are. A record of
random actions is then stepped again from its states: does a state decide the next one,
can many states be stepped at once, how many random numbers does a step draw
(``Chance``). Logs are made by stepping an environment, too.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import conform
from oee_tabular.continuous.log.transitions import RECORDED, ContinuousTransitions
from oee_tabular.continuous.task.base import (
    NO_CHANCE,
    Chance,
    ContinuousTask,
    Moves,
    StatePolicy,
    check_probabilities,
)
from oee_tabular.exceptions import ArgumentError, SimulatorWarning
from oee_tabular.mdp import require_environment
from oee_tabular.tasks.stepping import reset_environment, step_environment
from oee_tabular.typing import Array, BoolArray, IntArray, RealArrayLike, Seed

MIN_STATES_AT_ONCE = 16  # fewer are stepped one by one
N_RANGE_STEPS = 1000  # by which usual ranges are found
MAX_DRAWS = 64  # in a step
MAX_STEP_DIFFERENCE = 0.02  # of a coordinate's usual step, for a step that is repeated
# A share of steps that are not repeated (contacts, whose solvers remember) up to this
# is a warning, a larger one an error.
MAX_DIFFERING_SHARE = 0.05


def read_state(env: Any) -> Array:
    """Return the numbers ``env.unwrapped.state``."""
    return np.array(env.unwrapped.state, dtype=np.float64)


def write_state(env: Any, state: Array) -> None:
    """Put these numbers into ``env.unwrapped.state``.

    The environment is then as if no episode had ended there.
    """
    inner = env.unwrapped
    inner.state = np.array(state)
    if hasattr(inner, "steps_beyond_terminated"):
        inner.steps_beyond_terminated = None


def _make_one(make: Callable[[], Any]) -> Any:
    """Make an environment by a user's function."""
    try:
        env = make()
    except Exception as error:  # a user's function may raise anything
        raise ArgumentError(
            "make",
            f"must make an environment; it raises {type(error).__name__}:"
            f" {_checks.escape_controls(str(error))[:200]}",
        ) from error
    require_environment(env)
    return env


def _is_same(x: Array, y: Array) -> bool:
    """Return whether two arrays are equal up to rounding."""
    if x.shape != y.shape:
        return False
    return bool((np.abs(x - y) <= 1e-9 * (1.0 + np.abs(x))).all())


@suggest_keywords
class GymnasiumTask(ContinuousTask):
    """A Gymnasium environment with a settable state as a ContinuousTask.

    States, rewards and their units are the environment's own.

    Parameters
    ----------
    make : function
        Makes the environment, without arguments. What is stepped is ``env.unwrapped``,
        so that wrappers (time limits, scalings) do nothing.
    actions : array_like of shape (A,) or (A, k)
        What is passed to ``step``: integers where the environment's actions are
        Discrete.
    state_names : sequence of str, optional
        The names of the d coordinates that ``get_state`` returns; by default its own
        ``state_names``, or state_0, ...
    low : array_like of shape (d,), optional
        The lower ends of the usual range of each coordinate, for grids. By default what
        random actions reach and a tenth more, for an angle one turn.
    high : array_like of shape (d,), optional
        The upper ends of the usual ranges.
    get_state : function, optional
        Reads the state of an environment as (d,) numbers; by default its
        ``unwrapped.state``.
    set_state : function, optional
        Puts an environment into such a state, as if no episode had ended there.
    periodic : tuple of bool, optional
        For each coordinate, whether it is an angle; by default none is.
    terminates : bool, default True
        Whether episodes can end before a time limit.
    over : function, optional
        Of states (n, d) it gives (n,) which are terminal, for vertices and logs. By
        default none is; steps always ask the environment.
    reward_between : function, optional
        Of states, action numbers and next states it gives the rewards (n,).
    parameters : dict, optional
        What distinguishes it, which is written into files.
    make_vector : function, optional
        Of n it makes n environments whose ``state`` is (d, n) and which step at once.
        It is used where it repeats the steps of one, and the environment's own step
        does not do so with arrays in place of numbers.
    check_steps : int, default 200
        How many recorded steps are stepped again from their states; 0 means none.

    Raises
    ------
    ValueError
        If functions, states, ranges or actions do not fit the environment, if a state
        does not decide the next one, or if a step draws random numbers of its own (in
        how many steps, in which coordinate, by how much).

    See Also
    --------
    gymnasium_simulator : Make a simulator of an environment by its id.

    Notes
    -----
    Some 10^5 steps a second and less, where each state is put into the environment by
    itself; some 10^6 and more at once (``steps_at_once``). The normal, uniform and
    whole numbers that a step draws from ``np_random`` are the disturbance (``Chance``),
    as many as its checked steps drew. Where it draws others there is no disturbance:
    ``step`` gives the environment its own generator, ``moves`` one of seed 0.

    Examples
    --------
    Pendulum-v1, which this package does not ship, as a finite MDP:

    >>> import gymnasium, numpy as np
    >>> task = GymnasiumTask(
    ...     lambda: gymnasium.make("Pendulum-v1"),
    ...     state_names=("angle", "speed"),
    ...     actions=[[-2.0], [0.0], [2.0]],
    ...     low=[-np.pi, -8.0],
    ...     high=[np.pi, 8.0],
    ...     periodic=(True, False),
    ...     terminates=False,
    ... )
    >>> from oee_tabular.tasks import discretize
    >>> discretize(task, cells=(21, 21)).mdp.n_states
    441
    """

    def __init__(
        self,
        make: Callable[[], Any],
        *,
        actions: RealArrayLike,
        state_names: Sequence[str] | None = None,
        low: RealArrayLike | None = None,
        high: RealArrayLike | None = None,
        get_state: Callable[[Any], Any] = read_state,
        set_state: Callable[[Any, Array], None] = write_state,
        periodic: tuple[bool, ...] | None = None,
        terminates: bool = True,
        over: Callable[[Array], Any] | None = None,
        reward_between: Callable[[Array, IntArray, Array], Array] | None = None,
        parameters: dict[str, Any] | None = None,
        make_vector: Callable[[int], Any] | None = None,
        check_steps: int = 200,
    ) -> None:
        _checks.boolean(terminates, "terminates")
        for name, function in (
            ("make", make),
            ("get_state", get_state),
            ("set_state", set_state),
        ):
            _checks.function(function, name)
        self._make = make
        self._get = get_state
        self._set = set_state
        self._over = over
        self._reward_between = reward_between
        for name, optional in (
            ("over", over),
            ("reward_between", reward_between),
            ("make_vector", make_vector),
        ):
            if optional is not None:
                _checks.function(optional, name)
        known = conform(parameters, "parameters", dict[str, Any] | None)
        if state_names is not None:
            state_names = conform(state_names, "state_names", tuple[str, ...])
        if periodic is not None:
            periodic = conform(periodic, "periodic", tuple[bool, ...])
        self._parameters = dict(known or {})
        self._env = _make_one(make)
        reset_environment(self._env, 0)
        state = self.read(self._env)
        if state_names is None:
            state_names = getattr(self._env.unwrapped, "state_names", None) or [
                f"state_{i}" for i in range(state.size)
            ]
        self.state_names = self.feature_names = tuple(state_names)
        if state.shape != (self.n_state,):
            raise ArgumentError(
                "get_state",
                f"must return the {self.n_state} numbers of state_names; it returns"
                f" shape {state.shape}",
            )
        spec = getattr(self._env, "spec", None)
        self.name = "environment" if spec is None else str(spec.id)
        self._set_actions(actions)
        self.n_disturbances = 0
        self.periodic = (False,) * len(state) if periodic is None else tuple(periodic)
        self.terminates = terminates
        if low is None or high is None:
            usual_low, usual_high = self._find_ranges(_make_one(make))
            low = usual_low if low is None else low
            high = usual_high if high is None else high
        self._set_ranges(low, high)
        self._require_set(state)
        # a function that makes the task with other parameters, given by name; Physics
        # where the environment is named
        self.family: Any = None
        self._make_vector = make_vector
        self._at_once: Callable[[GymnasiumTask, Array, IntArray], Moves] | None = None
        if not _checks.is_zero(check_steps):
            self._learn_to_step(_checks.positive_integer(check_steps, "check_steps"))

    def _learn_to_step(self, n_steps: int) -> None:
        """Find how states are stepped at once, and what a step draws, by a record."""
        record = self._check_steps(_make_one(self._make), n_steps)
        ways = [GymnasiumTask._step_arrays]
        if self._make_vector is not None:
            ways.append(GymnasiumTask._step_vector)
        repeating = (way for way in ways if self._repeats(way, *record))
        self._at_once = next(repeating, None)
        self.n_disturbances = self._count_draws(*record)

    def _set_actions(self, actions: RealArrayLike) -> None:
        """Take the actions, each of which the environment must have."""
        self.actions = freeze(_checks.float_array(actions, "actions", ndim=(1, 2)))
        stated = _checks.as_array(actions, "actions")
        self.commands = self.actions if stated.dtype.hasobject else stated
        for number in range(len(self.actions)):
            if not self._env.action_space.contains(self.command(number)):
                raise ArgumentError(
                    f"actions[{number}]",
                    f"must be in {self._env.action_space}; it is"
                    f" {self.actions[number].tolist()}",
                )

    def _set_ranges(self, low: object, high: object) -> None:
        """Take the least and the largest of each coordinate."""
        shape = (self.n_state,)
        for name, given in (("low", low), ("high", high)):
            end = _checks.float_array(given, name)
            if end.shape != shape:
                raise ArgumentError(
                    name,
                    f"must have shape {shape}, one for each of state_names; it has"
                    f" shape {end.shape}",
                )
            setattr(self, f"feature_{name}", end)

    def _require_set(self, state: Array) -> None:
        """Require that a state that is set is the one that is read."""
        self._write(self._env, state)
        kept = self.read(self._env)
        if not np.array_equal(kept, state):
            raise ArgumentError(
                "set_state",
                f"must set what get_state reads; {state.tolist()} became"
                f" {kept.tolist()}",
            )

    def _check_steps(self, env: Any, steps: int) -> tuple[Array, IntArray]:
        """Step a record of random actions again from its states; return its (s, a).

        The order is another. What differs is an error, where it is at most a twentieth
        of the steps a warning.
        """
        # each step keeps a state and a generator, of some hundred numbers in all
        _checks.require_memory(100.0 * steps, "check_steps", steps)
        reset_environment(env, 0)
        rng = np.random.default_rng(0)
        generators = []
        numbers = rng.integers(self.n_actions, size=steps)

        def choose(state: Array) -> int:
            """Return the next recorded action, and keep the generator's state."""
            generators.append(copy.deepcopy(env.unwrapped.np_random))
            return int(numbers[len(generators) - 1])

        states, _, following, reward, _, _ = self.play(env, choose, steps)
        # rewards stand in the last column
        before = np.pad(states, ((0, 0), (0, 1)))
        after = np.column_stack([following, reward])
        again = np.empty_like(after)
        # another order: in the record's own, what the state lacks would come along
        for i in rng.permutation(steps):
            one = slice(i, i + 1)
            moved = self.one_by_one(states[one], numbers[one], generators[i])
            again[i] = np.append(moved.next_state[0], moved.reward)
        rounding = 1e-9 * (1.0 + np.abs(after).max(axis=0))
        size = np.sqrt(((after - before) ** 2).mean(axis=0)) + rounding
        away = np.abs(again - after)
        bad = (away > MAX_STEP_DIFFERENCE * size).any(axis=1)
        if bad.any():
            k = int((away / size).max(axis=0).argmax())
            worst = (*self.state_names, "the reward")[k]
            text = (
                "get_state and set_state must have all that decides the next step, and"
                f" chance must come from np_random: {int(bad.sum())} of {steps} steps"
                f" of {self.name} differ from the record when stepped again from its"
                " states. Read and set the rest as well, such as other bodies'"
                " velocities and timers (--task-option state=MODULE:GET,SET); the most"
                f" in {worst}: {away[:, k].max():.3g}, where a step moves it by"
                f" {size[k]:.3g}"
            )
            if bad.mean() > MAX_DIFFERING_SHARE:
                raise ValueError(text)
            _checks.warn(text, SimulatorWarning)
        return states, np.asarray(numbers, dtype=np.int64)

    def _repeats(
        self,
        way: Callable[[Any, Array, IntArray], Moves],
        states: Array,
        numbers: IntArray,
    ) -> bool:
        """Return whether this way of stepping does as the environment does."""
        one = self.one_by_one(states, numbers, np.random.default_rng(0))
        try:
            with warnings.catch_warnings(action="ignore"):
                many = way(self, states, numbers)
        except Exception:
            # another interface than the one that is used here, numbers alone, or random
            # numbers
            return False
        return (
            np.array_equal(one.terminated, many.terminated)
            and _is_same(one.next_state, many.next_state)
            and _is_same(one.reward, many.reward)
        )

    def _count_draws(self, states: Array, numbers: IntArray) -> int:
        """Return the most random numbers that one of these steps draws.

        It is 0 where there are none, or others than ``Chance`` has.
        """
        rng = np.random.default_rng(0)
        draws = rng.standard_normal((len(states), MAX_DRAWS))
        chances = [Chance(xi) for xi in draws]
        try:
            self.one_by_one(states, numbers, chances)
        except (AttributeError, IndexError, TypeError, ValueError):
            return 0
        return max(chance.used for chance in chances)

    def reward_between(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> Array | None:
        """Compute the rewards of given transitions by the function that was given.

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
            The rewards; None where no function was given.
        """
        if self._reward_between is None:
            return None
        return self._reward_between(states, actions, next_states)

    def with_environment(
        self,
        make: Callable[[], Any],
        make_vector: Callable[[int], Any] | None,
        parameters: dict[str, Any],
    ) -> GymnasiumTask:
        """Return the same task of another environment of the kind, not checked again.

        Parameters
        ----------
        make : function
            Makes the environment, without arguments.
        make_vector : function or None
            Of n it makes n environments that step at once.
        parameters : dict
            What distinguishes it.

        Returns
        -------
        GymnasiumTask
            The task.
        """
        again = copy.copy(self)
        again._make = make
        again._env = make()
        again._make_vector = make_vector
        again._parameters = parameters
        again._env.reset(seed=0)
        return again

    @property
    def steps_at_once(self) -> bool:  # type: ignore[override]
        """Return whether many states are stepped at once."""
        return self._at_once is not None

    def read(self, env: object) -> Array:
        """Return the state of an environment.

        Parameters
        ----------
        env : gymnasium.Env
            The environment.

        Returns
        -------
        ndarray of shape (d,)
            The state.
        """
        try:
            return np.array(self._get(env), dtype=np.float64)
        except Exception as error:  # a user's function may raise anything
            raise ArgumentError(
                "get_state",
                "must return the numbers of the environment's state; it raises"
                f" {type(error).__name__}: {_checks.escape_controls(str(error))[:200]}",
            ) from error

    def _write(self, env: Any, state: Array) -> None:
        """Put a state into an environment by the function that was given."""
        try:
            self._set(env, state)
        except Exception as error:  # a user's function may raise anything
            raise ArgumentError(
                "set_state",
                f"must put the state {_checks.show(state.tolist())} into the"
                f" environment; it raises {type(error).__name__}:"
                f" {_checks.escape_controls(str(error))[:200]}",
            ) from error

    def parameters(self) -> dict[str, Any]:
        """Return the parameters that were given.

        Returns
        -------
        dict
            The parameters.
        """
        return self._parameters

    def with_actions(self, actions: Array) -> Self:
        """Return the task with other actions in place of its own.

        Parameters
        ----------
        actions : ndarray of shape (A,) or (A, k)
            The actions, which the environment must have.

        Returns
        -------
        GymnasiumTask
            A copy with these actions. It steps the same environment.
        """
        other = super().with_actions(actions)
        other.commands = actions
        return other

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """Take one step from each state through the environment's own ``step``.

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
        if self.n_disturbances:
            return self.one_by_one(states, actions, [Chance(xi) for xi in disturbance])
        return self.step(states, actions, np.random.default_rng(0))

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """Take one random step from each state.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        rng : numpy.random.Generator
            The source of the environment's random numbers.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        if self.n_disturbances:
            return super().step(states, actions, rng)
        if self._at_once is not None and len(states) >= MIN_STATES_AT_ONCE:
            return self._at_once(self, states, actions)
        return self.one_by_one(states, actions, rng)

    def _step_arrays(self, states: Array, actions: IntArray) -> Moves:
        """Take steps by the environment's own step, with arrays in place of numbers."""
        inner = self._env.unwrapped
        n = len(states)
        inner.np_random = NO_CHANCE
        self._set(self._env, states.T.copy())
        commands = self.commands[actions].T.astype(self._env.action_space.dtype)
        _, reward, over, _, _ = inner.step(commands)
        following = self.read(self._env).T.copy()
        return Moves(
            following,
            np.full(n, reward, dtype=np.float64),
            np.full(n, over, dtype=np.bool_),
        )

    def _step_vector(self, states: Array, actions: IntArray) -> Moves:
        """Take steps by Gymnasium's environments that step together."""
        assert self._make_vector is not None
        envs = self._make_vector(len(states)).unwrapped
        envs.reset(seed=0)
        envs.np_random = NO_CHANCE
        envs.state = states.T.copy()
        commands = self.commands[actions].astype(envs.action_space.dtype)
        _, reward, over, _, _ = envs.step(commands)
        return Moves(
            np.array(envs.state.T, dtype=np.float64),
            np.asarray(reward, np.float64),
            over.astype(np.bool_),
        )

    def one_by_one(
        self,
        states: Array,
        actions: IntArray,
        rng: np.random.Generator | Sequence[Chance],
    ) -> Moves:
        """Take steps from states that are put into the environment one by one.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.
        actions : ndarray of int, shape (n,)
            The number of the action in each state.
        rng : numpy.random.Generator or sequence of Chance
            One generator of all random numbers, or the numbers of each step.

        Returns
        -------
        Moves
            The next states, the rewards, and whether the next states are terminal.
        """
        env = self._env
        following = np.empty_like(states)
        reward = np.empty(len(states))
        over = np.zeros(len(states), dtype=np.bool_)
        for i, (state, action) in enumerate(zip(states, actions, strict=True)):
            own = rng if isinstance(rng, np.random.Generator) else rng[i]
            env.unwrapped.np_random = own
            self._write(env, state)
            command = self.command(int(action))
            _, reward[i], over[i], _ = step_environment(env.unwrapped, command, state)
            following[i] = self.read(env)
        return Moves(following, reward, over)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """Draw initial states by resetting the environment.

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
        reset_environment(self._env, int(rng.integers(2**31)))
        found = np.empty((n, self.n_state))
        for i in range(n):
            reset_environment(self._env)
            found[i] = self.read(self._env)
        return found

    def initial_points(self) -> tuple[Array, Array]:
        """Return the states after 5000 resets of one seed, with equal weights.

        Returns
        -------
        states : ndarray of shape (5000, d)
            The states.
        weights : ndarray of shape (5000,)
            The weights, which sum to 1.
        """
        states = self.initial_states(5000, np.random.default_rng(0))
        return states, np.full(len(states), 1.0 / len(states))

    def terminated(self, states: Array) -> BoolArray:
        """Return which states are terminal, by the function ``over``.

        Parameters
        ----------
        states : ndarray of shape (n, d)
            The states.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether each state is terminal; none is without ``over``.
        """
        if self._over is None:
            return super().terminated(states)
        return np.asarray(self._over(states), dtype=np.bool_)

    def play(
        self,
        env: Any,
        choose: Callable[[Array], int],
        n: int,
        limit: int | None = None,
    ) -> tuple[NDArray[Any], ...]:
        """Step a reset environment as any program would, never setting its state.

        Parameters
        ----------
        env : gymnasium.Env
            The environment, which was reset and is closed at the end.
        choose : function
            Of a state (d,) it gives the number of an action.
        n : int
            The number of steps.
        limit : int, optional
            The number of steps after which the environment is cut as well.

        Returns
        -------
        tuple of ndarray
            The columns: states, action numbers, next states, rewards, whether the
            episode ended, and whether the environment cut it.
        """
        rows = []
        inner = env.unwrapped
        t = 0
        for _ in range(n):
            state = self.read(env)
            number = choose(state)
            command = self.command(number)
            _, reward, over, cut = step_environment(inner, command, state)
            t += 1
            cut = not over and (cut or t == limit)
            rows.append((state, number, self.read(env), reward, over, cut))
            if over or cut:
                reset_environment(inner)
                t = 0
        env.close()
        return tuple(map(np.array, zip(*rows, strict=True)))

    def _find_ranges(self, env: Any) -> tuple[Array, Array]:
        """Return the ends of what random actions reach and a tenth more."""
        reset_environment(env, 0)
        rng = np.random.default_rng(0)
        limit = getattr(getattr(env, "spec", None), "max_episode_steps", None)

        def choose(state: Array) -> int:
            """Draw an action, each with the same probability."""
            return int(rng.integers(self.n_actions))

        states = self.play(env, choose, N_RANGE_STEPS, limit)[0]
        low = states.min(axis=0)
        high = states.max(axis=0)
        margin = np.maximum(0.1 * (high - low), 1e-6)
        lower = np.where(self.periodic, -np.pi, low - margin)
        return lower, np.where(self.periodic, np.pi, high + margin)

    def record(
        self,
        policy: StatePolicy,
        *,
        n_transitions: int,
        max_steps: int,
        seed: Seed = None,
    ) -> ContinuousTransitions:
        """Record a log of what the environment does, whose state is never set.

        Parameters
        ----------
        policy : function
            The policy: of states (n, d) it gives probabilities (n, A).
        n_transitions : int
            The number of transitions; the last episode is truncated where the log ends.
        max_steps : int
            The number of steps after which episodes are truncated.
        seed : int, Generator or SeedSequence, optional
            The source of random numbers. The same seed gives the same bits.

        Returns
        -------
        ContinuousTransitions
            The log.

        Raises
        ------
        ValueError
            If a number is not a positive integer.
        """
        rows = _checks.positive_integer(n_transitions, "n_transitions")
        steps = _checks.positive_integer(max_steps, "max_steps")
        rng = _checks.generator(seed)
        env = _make_one(self._make)
        known = []
        reset_environment(env, int(rng.integers(2**31)))
        reset_environment(env.unwrapped)

        def choose(state: Array) -> int:
            """Draw an action by the policy, and keep its probability."""
            chances = check_probabilities(policy, state[None], self.n_actions)[0]
            level = rng.random() * chances.sum()
            number = int(np.searchsorted(np.cumsum(chances), level, side="right"))
            known.append(chances[number])
            return number

        *columns, over, cut = self.play(env, choose, rows, steps)
        cut[-1] |= not over[-1]
        episode = np.cumsum(over | cut) - (over | cut)
        every = (*columns, over, cut, episode, known)
        return ContinuousTransitions(**dict(zip(RECORDED, every, strict=True)))

    def command(self, number: int) -> Any:
        """Return what is passed to the environment's ``step``.

        Parameters
        ----------
        number : int
            The number of an action.

        Returns
        -------
        ndarray, int or float
            The command.
        """
        command = self.commands[number]
        if command.ndim:
            return command.astype(self._env.action_space.dtype)
        return int(command) if float(command).is_integer() else float(command)
