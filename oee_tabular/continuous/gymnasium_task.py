"""Any Gymnasium environment whose state can be read and set, as a continuous task; and logs by stepping one.

The state must be the environment's own, not its observation: CartPole's observations are float32 copies of a float64 state,
Pendulum's leave the angle to be found from its sine and cosine. Say how it is read and set, and which actions there are.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray, freeze
from oee_tabular.continuous.gymnasium_steps import Chance, check_steps_of, draws_of, repeats_at_once
from oee_tabular.continuous.log import RECORDED, ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, Moves, StatePolicy, check_probabilities

FEWEST_AT_ONCE, MOST_AT_ONCE = 16, 4096  # states
NO_CHANCE = Chance(np.empty(0))  # in place of random numbers, where none may be drawn


class GymnasiumTask(ContinuousTask):
    """A Gymnasium environment with a settable state as a ContinuousTask.

    Parameters
    ----------
    make : function without arguments that makes the environment; what is stepped is ``env.unwrapped``, so that wrappers (time
        limits, scalings) do nothing
    state_names : names of the d coordinates that ``get_state`` returns
    get_state, set_state : read the state of an environment as (d,) numbers; put the environment into such a state, as if no
        episode had ended there
    actions : (A,) or (A, k), what is passed to ``step``: integers where the environment's actions are Discrete
    low, high, periodic : (d,) the usual range of each coordinate, and whether it is an angle; for grids
    terminates : whether episodes can end before a time limit
    over : function of states (n, d) giving (n,) which are over, for vertices and logs (default: none; steps always ask the
        environment)
    reward_between : function of (states, action numbers, next states), optional
    parameters : what distinguishes it, written into files
    make_vector : function of n that makes n environments whose ``state`` is (d, n) and which step at once; used where it
        repeats the steps of one, and the environment's own step does not do so with arrays in place of numbers
    check_steps : how many recorded steps are stepped again from their states; 0: none

    Attributes
    ----------
    steps_at_once : whether many states are stepped at once
    family : function of parameters, by name, that makes the task of the environment with them; None where it is not known

    Raises
    ------
    ValueError
        Functions, states, ranges and actions that do not fit the environment; a state that does not decide the next one, or
        a step that draws random numbers of its own (in how many steps, in which coordinate, by how much).

    Notes
    -----
    Some 10^5 steps a second and less, where each state is put into the environment by itself; some 10^6 and more at once: by
    the environment's own step, where it takes arrays (d, n) as its state and draws nothing, or by ``make_vector``. The normal,
    uniform and whole numbers that a step draws from ``np_random`` are the disturbance (``gymnasium_steps.Chance``), as many as
    its checked steps drew. Where it draws others, or steps are not checked, there is no disturbance: ``step`` gives the
    environment its own generator, ``moves`` one of seed 0.

    Examples
    --------
    Pendulum-v1, which this package does not ship, as a finite MDP:

    >>> import gymnasium, numpy as np
    >>> def write(env, state):
    ...     env.unwrapped.state = np.array(state)
    >>> task = GymnasiumTask(
    ...     lambda: gymnasium.make("Pendulum-v1"),
    ...     state_names=("angle", "speed"),
    ...     get_state=lambda env: env.unwrapped.state,
    ...     set_state=write,
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
        state_names: tuple[str, ...],
        get_state: Callable[[Any], Any],
        set_state: Callable[[Any, Array], None],
        actions: object,
        low: object,
        high: object,
        periodic: tuple[bool, ...] | None = None,
        terminates: bool = True,
        over: Callable[[Array], Any] | None = None,
        reward_between: Callable[[Array, IntArray, Array], Array] | None = None,
        parameters: dict[str, Any] | None = None,
        make_vector: Callable[[int], Any] | None = None,
        check_steps: int = 200,
    ) -> None:
        _checks.boolean(terminates, "terminates")
        for name, function in (("make", make), ("get_state", get_state), ("set_state", set_state)):
            if not callable(function):
                raise ValueError(f"{name} must be a function; got {type(function).__name__}")
        self._make, self._get, self._set, self._over = make, get_state, set_state, over
        self._reward_between, self._parameters = reward_between, dict(parameters or {})
        self._env = make()
        self._env.reset(seed=0)
        state, shape = self.read(self._env), (len(state_names),)
        if state.shape != shape:
            raise ValueError(
                f"get_state must return the {len(state_names)} numbers of state_names; it returns shape {state.shape}"
            )
        spec = getattr(self._env, "spec", None)
        self.name = "environment" if spec is None else str(spec.id)
        self.state_names = self.feature_names = tuple(state_names)
        self.commands = np.array(actions)
        self.actions = freeze(_checks.float_array(actions, "actions", ndim=(1, 2)))
        self.n_disturbances = 0
        self.feature_low, self.feature_high = _checks.float_array(low, "low"), _checks.float_array(high, "high")
        for end, name in ((self.feature_low, "low"), (self.feature_high, "high")):
            if end.shape != shape:
                raise ValueError(
                    f"{name} must have shape {shape}, one for each of state_names; it has shape {end.shape}"
                )
        self.periodic = (False,) * len(state) if periodic is None else tuple(periodic)
        self.terminates = terminates
        for number in range(len(self.actions)):
            if not self._env.action_space.contains(self.command(number)):
                raise ValueError(
                    f"actions[{number}] must be in {self._env.action_space}; it is {self.actions[number].tolist()}"
                )
        self._set(self._env, state)
        if not np.array_equal(kept := self.read(self._env), state):
            raise ValueError(f"set_state must set what get_state reads; {state.tolist()} became {kept.tolist()}")
        self.family: Any = None
        self._vectors: dict[int, Any] = {}
        self._make_vector = make_vector
        self._at_once: Callable[[GymnasiumTask, Array, IntArray], Moves] | None = None
        if check_steps:
            record = check_steps_of(self, make(), _checks.positive_integer(check_steps, "check_steps"))
            ways = [GymnasiumTask._step_arrays] + [GymnasiumTask._step_vector] * (make_vector is not None)
            self._at_once = next((way for way in ways if repeats_at_once(self, way, *record)), None)
            self.n_disturbances = draws_of(self, *record)

    def with_environment(
        self, make: Callable[[], Any], make_vector: Callable[[int], Any] | None, parameters: dict[str, Any]
    ) -> GymnasiumTask:
        """The same task of another environment of the kind, not checked again."""
        again = copy.copy(self)
        again._make, again._env, again._vectors, again._parameters = make, make(), {}, parameters
        again._env.reset(seed=0)
        again._make_vector = make_vector
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
        """By the environment's own step, whose formulas take arrays in place of numbers."""
        if 0 not in self._vectors:
            self._vectors[0] = self._make()
            self._vectors[0].reset(seed=0)
        env, n = self._vectors[0], len(states)
        env.unwrapped.np_random = NO_CHANCE
        self._set(env, states.T.copy())
        _, reward, over, _, _ = env.unwrapped.step(self.commands[actions].T.astype(env.action_space.dtype))
        return Moves(self.read(env).T.copy(), np.full(n, reward, dtype=np.float64), np.full(n, over, dtype=np.bool_))

    def _step_vector(self, states: Array, actions: IntArray) -> Moves:
        """By environments that step together, as many as a power of two holds."""
        parts = []
        for low in range(0, len(states), MOST_AT_ONCE):
            part, taken = states[low : low + MOST_AT_ONCE], np.asarray(actions[low : low + MOST_AT_ONCE])
            n = len(part)
            size = 1 << (n - 1).bit_length()
            if size not in self._vectors:
                assert self._make_vector is not None
                self._vectors[size] = self._make_vector(size).unwrapped
            envs = self._vectors[size]
            more = np.resize(np.arange(n), size)
            envs.reset(seed=0)  # nothing of the step before is left
            envs.np_random = NO_CHANCE
            envs.state = part[more].T.copy()
            commands = self.commands[taken[more]].astype(envs.action_space.dtype)
            _, reward, over, _, _ = envs.step(commands)
            parts.append((np.array(envs.state).T[:n], np.asarray(reward)[:n], np.asarray(over)[:n]))
        following, reward, over = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Moves(following.astype(np.float64), reward.astype(np.float64), over.astype(np.bool_))

    def one_by_one(self, states: Array, actions: IntArray, rng: np.random.Generator | Sequence[Chance]) -> Moves:
        """Each state put into the environment by itself; random numbers are one generator's, or each its own."""
        env = self._env
        following, reward, over = np.empty_like(states), np.empty(len(states)), np.zeros(len(states), dtype=np.bool_)
        inner = env.unwrapped
        for i, (state, action) in enumerate(zip(states, actions, strict=True)):
            env.unwrapped.np_random = rng if isinstance(rng, np.random.Generator) else rng[i]
            self._set(env, state)
            _, reward[i], over[i], _, _ = inner.step(self.command(int(action)))
            following[i] = self.read(env)
        return Moves(following, reward, over)

    def initial_states(self, n: int, rng: np.random.Generator) -> Array:
        """By resetting the environment."""
        env = self._env
        env.reset(seed=int(rng.integers(2**31)))
        found = np.empty((n, self.n_state))
        for i in range(n):
            env.reset()
            found[i] = self.read(env)
        return found

    def initial_points(self) -> tuple[Array, Array]:
        """5000 resets of one seed."""
        states = self.initial_states(5000, np.random.default_rng(0))
        return states, np.full(len(states), 1.0 / len(states))

    def terminated(self, states: Array) -> Any:
        """By the function ``over``."""
        return super().terminated(states) if self._over is None else np.asarray(self._over(states), dtype=np.bool_)

    def reward_between(self, states: Array, actions: IntArray, next_states: Array) -> Array | None:
        """By the function of that name."""
        return None if self._reward_between is None else self._reward_between(states, actions, next_states)

    def record(
        self, policy: StatePolicy, *, n_transitions: int, max_steps: int, seed: Any = None
    ) -> ContinuousTransitions:
        """Reset and step the environment as any program would, never setting its state, and write down what it does.

        ``policy`` is a function of states (n, d) giving probabilities (n, A). Episodes are truncated after ``max_steps``, the
        last one where the log ends.
        """
        rows = _checks.positive_integer(n_transitions, "n_transitions")
        steps = _checks.positive_integer(max_steps, "max_steps")
        rng = _checks.generator(seed)
        env = self._make()
        env.reset(seed=int(rng.integers(2**31)))
        inner = env.unwrapped
        written: list[tuple[object, ...]] = []
        episode, t = 0, 0
        inner.reset()
        for row in range(rows):
            state = self.read(env)
            probabilities = check_probabilities(policy, state[None], self.n_actions)[0]
            action = int(np.searchsorted(np.cumsum(probabilities), rng.random() * probabilities.sum(), side="right"))
            _, reward, over, cut, _ = inner.step(self.command(action))
            t += 1
            stop = not over and (cut or t == steps or row == rows - 1)
            written.append((state, action, self.read(env), reward, over, stop, episode, probabilities[action]))
            if over or stop:
                inner.reset()
                episode, t = episode + 1, 0
        env.close()
        columns = map(np.array, zip(*written, strict=True))
        return ContinuousTransitions(**dict(zip(RECORDED, columns, strict=True)))

    def command(self, number: int) -> Any:
        """What is passed to the environment's ``step``."""
        command = self.commands[number]
        if command.ndim:
            return command.astype(self._env.action_space.dtype)
        return int(command) if float(command).is_integer() else float(command)
