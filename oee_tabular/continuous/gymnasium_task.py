"""Any Gymnasium environment whose state can be read and set, as a continuous task; and
logs by stepping one.

The state must be the environment's own, not its observation: CartPole's observations
are float32 copies of a float64 state, Pendulum's leave the angle to be found from its
sine and cosine. Say how it is read and set, and which actions there are. A record of
random actions is then stepped again from its states: does a state decide the next one,
can many states be stepped at once, how many random numbers does a step draw
(``Chance``).
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks
from oee_tabular._checks import freeze
from oee_tabular.continuous.log import RECORDED, ContinuousTransitions
from oee_tabular.continuous.task import (
    NO_CHANCE,
    Chance,
    ContinuousTask,
    Moves,
    StatePolicy,
    check_probabilities,
)
from oee_tabular.exceptions import ArgumentError, SimulatorWarning
from oee_tabular.typing import Array, IntArray

FEWEST_AT_ONCE = 16  # states
LOOKED = 1000  # steps by which usual ranges are found
MAX_DRAWS = 64  # in a step
SAME_STEP = 0.02  # of a coordinate's usual step: a step that is repeated
# share of steps that may be another (contacts, whose solvers remember): told, not
# refused
FEW = 0.05


def read_state(env: Any) -> Array:
    """The numbers ``env.unwrapped.state``."""
    return np.array(env.unwrapped.state, dtype=np.float64)


def write_state(env: Any, state: Array) -> None:
    """Put these numbers into ``env.unwrapped.state``, as if no episode had ended there."""
    inner = env.unwrapped
    inner.state = np.array(state)
    if hasattr(inner, "steps_beyond_terminated"):
        inner.steps_beyond_terminated = None


class GymnasiumTask(ContinuousTask):
    """A Gymnasium environment with a settable state as a ContinuousTask.

    Parameters
    ----------
    make : function without arguments that makes the environment; what is stepped is
        ``env.unwrapped``, so that wrappers (time limits, scalings) do nothing
    actions : (A,) or (A, k), what is passed to ``step``: integers where the
        environment's actions are Discrete
    state_names : names of the d coordinates that ``get_state`` returns; default: its
        own ``state_names``, or state_0, ...
    low, high, periodic : (d,) the usual range of each coordinate, and whether it is an
        angle; for grids. Default: what random actions reach and a tenth more, of an
        angle one turn; no angles
    get_state, set_state : read the state of an environment as (d,) numbers; put the
        environment into such a state, as if no episode had ended there. Default: its
        ``unwrapped.state``
    terminates : whether episodes can end before a time limit
    over : function of states (n, d) giving (n,) which are over, for vertices and logs
        (default: none; steps always ask the environment)
    reward_between : function of (states, action numbers, next states), optional
    parameters : what distinguishes it, written into files
    make_vector : function of n that makes n environments whose ``state`` is (d, n) and
        which step at once; used where it repeats the steps of one, and the
        environment's own step does not do so with arrays in place of numbers
    check_steps : how many recorded steps are stepped again from their states; 0: none

    Raises
    ------
    ValueError
        Functions, states, ranges and actions that do not fit the environment; a state
        that does not decide the next one, or a step that draws random numbers of its
        own (in how many steps, in which coordinate, by how much).

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
    ...     low=[-np.pi, -8.0], high=[np.pi, 8.0], periodic=(True, False),
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
        actions: object,
        state_names: Sequence[str] | None = None,
        low: object = None,
        high: object = None,
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
        self._parameters = dict(parameters or {})
        self._env = make()
        self._env.reset(seed=0)
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
        self.commands = np.array(actions)
        self.actions = freeze(_checks.float_array(actions, "actions", ndim=(1, 2)))
        self.n_disturbances = 0
        self.periodic = (False,) * len(state) if periodic is None else tuple(periodic)
        self.terminates = terminates
        for number in range(len(self.actions)):
            if not self._env.action_space.contains(self.command(number)):
                raise ArgumentError(
                    f"actions[{number}]",
                    f"must be in {self._env.action_space}; it is"
                    f" {self.actions[number].tolist()}",
                )
        found = (
            self._find_ranges(make()) if low is None or high is None else (low, high)
        )
        for name, own, given in zip(("low", "high"), found, (low, high), strict=True):
            end = _checks.float_array(own if given is None else given, name)
            if end.shape != state.shape:
                raise ArgumentError(
                    name,
                    f"must have shape {state.shape}, one for each of state_names; it"
                    f" has shape {end.shape}",
                )
            setattr(self, f"feature_{name}", end)
        self._set(self._env, state)
        if not np.array_equal(kept := self.read(self._env), state):
            raise ArgumentError(
                "set_state",
                f"must set what get_state reads; {state.tolist()} became"
                f" {kept.tolist()}",
            )
        # of parameters by name makes the task with them; where that is known (Physics)
        self.family: Any = None
        self._make_vector = make_vector
        self._at_once: Callable[[GymnasiumTask, Array, IntArray], Moves] | None = None
        if check_steps:
            record = self._check_steps(
                make(), _checks.positive_integer(check_steps, "check_steps")
            )
            ways = [GymnasiumTask._step_arrays] + [GymnasiumTask._step_vector] * (
                make_vector is not None
            )
            self._at_once = next(
                (way for way in ways if self._repeats(way, *record)), None
            )
            self.n_disturbances = self._count_draws(*record)

    def _check_steps(self, env: Any, steps: int) -> tuple[Array, IntArray]:
        """Step a record of random actions again from its states, in another order; its
        (s, a).

        What differs is an error, where it is at most a twentieth of the steps a
        warning.
        """
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        generators = []
        numbers = rng.integers(self.n_actions, size=steps)

        def choose(state: Array) -> int:
            generators.append(copy.deepcopy(env.unwrapped.np_random))
            return int(numbers[len(generators) - 1])

        states, _, following, reward, _, _ = self.play(env, choose, steps)
        # rewards last
        before = np.pad(states, ((0, 0), (0, 1)))
        after = np.column_stack([following, reward])
        again = np.empty_like(after)
        # in the record's own order what the state lacks would come along
        for i in rng.permutation(steps):
            moved = self.one_by_one(
                states[i : i + 1], numbers[i : i + 1], generators[i]
            )
            again[i] = np.append(moved.next_state[0], moved.reward)
        size = np.sqrt(((after - before) ** 2).mean(axis=0)) + 1e-9 * (
            1.0 + np.abs(after).max(axis=0)
        )
        away = np.abs(again - after)
        bad = (away > SAME_STEP * size).any(axis=1)
        if bad.any():
            k = int((away / size).max(axis=0).argmax())
            text = (
                "get_state and set_state must have all that decides the next step, and"
                f" chance must come from np_random: {int(bad.sum())} of {steps} steps"
                f" of {self.name} differ from the record when stepped again from its"
                " states. Read and set the rest as well, such as other bodies'"
                " velocities and timers (--task-option state=MODULE:GET,SET); the most"
                f" in {(*self.state_names, 'the reward')[k]}: {away[:, k].max():.3g},"
                f" where a step moves it by {size[k]:.3g}"
            )
            if bad.mean() > FEW:
                raise ValueError(text)
            _checks.warn(text, SimulatorWarning)
        return states, np.asarray(numbers, dtype=np.int64)

    def _repeats(
        self,
        way: Callable[[Any, Array, IntArray], Moves],
        states: Array,
        numbers: IntArray,
    ) -> bool:
        """Whether this way of stepping many states at once does as the environment does
        one by one.
        """
        one = self.one_by_one(states, numbers, np.random.default_rng(0))
        try:
            with warnings.catch_warnings(action="ignore"):
                many = way(self, states, numbers)
        except Exception:
            # another interface than the one that is used here, numbers alone, or random
            # numbers
            return False
        return np.array_equal(one.terminated, many.terminated) and all(
            x.shape == y.shape
            and bool((np.abs(x - y) <= 1e-9 * (1.0 + np.abs(x))).all())
            for x, y in ((one.next_state, many.next_state), (one.reward, many.reward))
        )

    def _count_draws(self, states: Array, numbers: IntArray) -> int:
        """The most random numbers that one of these steps draws; 0: none, or others
        than ``Chance`` has.
        """
        chances = [
            Chance(xi)
            for xi in np.random.default_rng(0).standard_normal((len(states), MAX_DRAWS))
        ]
        try:
            self.one_by_one(states, numbers, chances)
        except (AttributeError, IndexError, TypeError, ValueError):
            return 0
        return max(chance.used for chance in chances)

    def reward_between(
        self, states: Array, actions: IntArray, next_states: Array
    ) -> Array | None:
        """The function that was given, if one was."""
        return (
            None
            if self._reward_between is None
            else self._reward_between(states, actions, next_states)
        )

    def with_environment(
        self, make: Callable[[], Any], make_vector: Any, parameters: dict[str, Any]
    ) -> GymnasiumTask:
        """The same task of another environment of the kind, not checked again."""
        again = copy.copy(self)
        again._make = make
        again._env = make()
        again._make_vector = make_vector
        again._parameters = parameters
        again._env.reset(seed=0)
        return again

    @property
    def steps_at_once(self) -> bool:  # type: ignore[override]
        """Whether many states are stepped at once."""
        return self._at_once is not None

    def read(self, env: object) -> Array:
        """(d,) the state of an environment."""
        return np.array(self._get(env), dtype=np.float64)

    def parameters(self) -> dict[str, Any]:
        """As given."""
        return self._parameters

    def moves(self, states: Array, actions: IntArray, disturbance: Array) -> Moves:
        """One step from each state through the environment's own ``step``."""
        if self.n_disturbances:
            return self.one_by_one(states, actions, [Chance(xi) for xi in disturbance])
        return self.step(states, actions, np.random.default_rng(0))

    def step(self, states: Array, actions: IntArray, rng: np.random.Generator) -> Moves:
        """One step from each state; the environment's random numbers are ``rng``'s."""
        if self.n_disturbances:
            return super().step(states, actions, rng)
        if self._at_once is not None and len(states) >= FEWEST_AT_ONCE:
            return self._at_once(self, states, actions)
        return self.one_by_one(states, actions, rng)

    def _step_arrays(self, states: Array, actions: IntArray) -> Moves:
        """By the environment's own step, whose formulas take arrays in place of
        numbers.
        """
        inner = self._env.unwrapped
        n = len(states)
        inner.np_random = NO_CHANCE
        self._set(self._env, states.T.copy())
        _, reward, over, _, _ = inner.step(
            self.commands[actions].T.astype(self._env.action_space.dtype)
        )
        following = self.read(self._env).T.copy()
        return Moves(
            following,
            np.full(n, reward, dtype=np.float64),
            np.full(n, over, dtype=np.bool_),
        )

    def _step_vector(self, states: Array, actions: IntArray) -> Moves:
        """By Gymnasium's environments that step together."""
        assert self._make_vector is not None
        envs = self._make_vector(len(states)).unwrapped
        envs.reset(seed=0)
        envs.np_random = NO_CHANCE
        envs.state = states.T.copy()
        _, reward, over, _, _ = envs.step(
            self.commands[actions].astype(envs.action_space.dtype)
        )
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
        """Each state put into the environment by itself; random numbers are one
        generator's, or each its own.
        """
        env = self._env
        following = np.empty_like(states)
        reward = np.empty(len(states))
        over = np.zeros(len(states), dtype=np.bool_)
        for i, (state, action) in enumerate(zip(states, actions, strict=True)):
            env.unwrapped.np_random = (
                rng if isinstance(rng, np.random.Generator) else rng[i]
            )
            self._set(env, state)
            _, reward[i], over[i], _, _ = env.unwrapped.step(self.command(int(action)))
            following[i] = self.read(env)
        return Moves(following, reward, over)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """By resetting the environment."""
        self._env.reset(seed=int(rng.integers(2**31)))
        found = np.empty((n, self.n_state))
        for i in range(n):
            self._env.reset()
            found[i] = self.read(self._env)
        return found

    def initial_points(self) -> tuple[Array, Array]:
        """5000 resets of one seed."""
        states = self.initial_states(5000, np.random.default_rng(0))
        return states, np.full(len(states), 1.0 / len(states))

    def terminated(self, states: Array) -> Any:
        """By the function ``over``."""
        return (
            super().terminated(states)
            if self._over is None
            else np.asarray(self._over(states), dtype=np.bool_)
        )

    def play(
        self, env: Any, choose: Callable[[Array], int], n: int, limit: Any = None
    ) -> tuple[NDArray[Any], ...]:
        """Step an environment that was reset as any program would, never setting its
        state, n times; then close it.

        Columns: state, action number, next state, reward, whether it is over, and
        whether the environment cut the episode, which also ends after ``limit`` steps.
        """
        rows = []
        inner = env.unwrapped
        t = 0
        for _ in range(n):
            state = self.read(env)
            number = choose(state)
            _, reward, over, cut, _ = inner.step(self.command(number))
            t += 1
            cut = not over and (cut or t == limit)
            rows.append((state, number, self.read(env), reward, over, cut))
            if over or cut:
                inner.reset()
                t = 0
        env.close()
        return tuple(map(np.array, zip(*rows, strict=True)))

    def _find_ranges(self, env: Any) -> tuple[Array, Array]:
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        limit = getattr(getattr(env, "spec", None), "max_episode_steps", None)
        states = self.play(
            env, lambda state: int(rng.integers(self.n_actions)), LOOKED, limit
        )[0]
        low = states.min(axis=0)
        high = states.max(axis=0)
        room = np.maximum(0.1 * (high - low), 1e-6)
        return np.where(self.periodic, -np.pi, low - room), np.where(
            self.periodic, np.pi, high + room
        )

    def record(
        self,
        policy: StatePolicy,
        *,
        n_transitions: int,
        max_steps: int,
        seed: Any = None,
    ) -> ContinuousTransitions:
        """A log of what the environment does, whose state is never set (``play``).

        ``policy`` is a function of states (n, d) giving probabilities (n, A). Episodes
        are truncated after ``max_steps``, the last one where the log ends.
        """
        rows = _checks.positive_integer(n_transitions, "n_transitions")
        steps = _checks.positive_integer(max_steps, "max_steps")
        rng = _checks.generator(seed)
        env = self._make()
        known = []
        env.reset(seed=int(rng.integers(2**31)))
        env.unwrapped.reset()

        def choose(state: Array) -> int:
            chances = check_probabilities(policy, state[None], self.n_actions)[0]
            number = int(
                np.searchsorted(
                    np.cumsum(chances), rng.random() * chances.sum(), side="right"
                )
            )
            known.append(chances[number])
            return number

        *columns, over, cut = self.play(env, choose, rows, steps)
        cut[-1] |= not over[-1]
        episode = np.cumsum(over | cut) - (over | cut)
        return ContinuousTransitions(
            **dict(zip(RECORDED, (*columns, over, cut, episode, known), strict=True))
        )

    def command(self, number: int) -> Any:
        """What is passed to the environment's ``step``."""
        command = self.commands[number]
        if command.ndim:
            return command.astype(self._env.action_space.dtype)
        return int(command) if float(command).is_integer() else float(command)
