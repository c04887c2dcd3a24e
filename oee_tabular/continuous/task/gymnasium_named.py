"""Gymnasium environments by id with other physics, as continuous simulators.

Physics (``Pendulum-v1:g=9``) are arguments of the constructor, constants of the class,
and fields of a MuJoCo model. A constant is set while the environment is made, wherever
its ``__init__`` would set it, so that what is computed from it there (CartPole's
``polemass_length`` from ``length``) follows.

How a state is read and set is found: classic control keeps it in ``unwrapped.state``;
MuJoCo's is (qpos, qvel), set by ``set_state``. For others two functions say it,
get(env) and set(env, state).
"""

from __future__ import annotations

import inspect
import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._arguments import (
    own_environment,
    own_modules,
    own_object,
    parse_spec,
)
from oee_tabular._keywords import suggest_keywords
from oee_tabular.continuous.evaluation.simulator import (
    SLOW,
    ContinuousSimulator,
    as_simulator,
)
from oee_tabular.continuous.task.gymnasium_task import GymnasiumTask
from oee_tabular.exceptions import ArgumentError
from oee_tabular.tasks.toy_text import environment_exists
from oee_tabular.typing import Array, BoolArray, RealArrayLike

# MODULE:EnvId-v0, an environment that a module registers
OWN_ID = re.compile(r"([^\W\d]\w*(?:\.[^\W\d]\w*)*):([A-Za-z][\w.-]*-v\d+)(?=[:,]|$)")
# levels of each coordinate of a command, by how many coordinates there are
N_LEVELS = {1: 9, 2: 5}
MAX_COMMANDS = 1000
HORIZON = 1000  # steps, where the environment has no limit
HINGE = 3  # mujoco.mjtJoint.mjJNT_HINGE
# fields of a MuJoCo model whose elements have names: the kind of the name, and how many
# there are
ELEMENTS = {
    "body_mass": ("body", "nbody"),
    "dof_damping": ("joint", "nv"),
    "dof_armature": ("joint", "nv"),
    "dof_frictionloss": ("joint", "nv"),
    "jnt_stiffness": ("joint", "njnt"),
    "actuator_gear": ("actuator", "nu"),
    "geom_friction": ("geom", "ngeom"),
}


def _is_car_over(env: Any, states: Array) -> BoolArray:
    """Return which states (n, 2) of the mountain car are at the goal."""
    is_there = states[:, 0] >= env.goal_position
    return np.asarray(is_there & (states[:, 1] >= env.goal_velocity))


def _is_cartpole_over(env: Any, states: Array) -> BoolArray:
    """Return which states (n, 4) of CartPole are beyond its thresholds."""
    limits = [env.x_threshold, env.theta_threshold_radians]
    return np.asarray((np.abs(states[:, [0, 2]]) > limits).any(axis=1))


def _is_acrobot_over(env: Any, states: Array) -> BoolArray:
    """Return in which states (n, 4) of the acrobot the tip is above the line."""
    height = -np.cos(states[:, 0]) - np.cos(states[:, 1] + states[:, 0])
    return np.asarray(height > 1.0)


_CAR: dict[str, Any] = {
    "state_names": ("position", "speed"),
    "low": (-1.2, -0.07),
    "high": (0.6, 0.07),
    "over": _is_car_over,
}
# what GymnasiumTask takes, by the name of the class or of one that it is made from;
# ``over`` takes the environment as well
CLASSIC: Mapping[str, dict[str, Any]] = {
    "CartPoleEnv": {
        "state_names": ("x", "x_dot", "theta", "theta_dot"),
        "low": (-2.4, -3.0, -0.21, -3.2),
        "high": (2.4, 3.0, 0.21, 3.2),
        "over": _is_cartpole_over,
    },
    "PendulumEnv": {
        "state_names": ("angle", "speed"),
        "low": (-np.pi, -8.0),
        "high": (np.pi, 8.0),
        "periodic": (True, False),
        "terminates": False,
    },
    "MountainCarEnv": _CAR,
    "Continuous_MountainCarEnv": _CAR,
    "AcrobotEnv": {
        "state_names": ("angle_1", "angle_2", "speed_1", "speed_2"),
        "low": (-np.pi, -np.pi, -4 * np.pi, -9 * np.pi),
        "high": (np.pi, np.pi, 4 * np.pi, 9 * np.pi),
        "periodic": (True, True, False, False),
        "over": _is_acrobot_over,
    },
}


@suggest_keywords
def gymnasium_simulator(
    spec: str, *, state: str | None = None, actions: RealArrayLike | None = None
) -> ContinuousSimulator:
    """Make the continuous simulator of the Gymnasium environment that ``spec`` names.

    Parameters
    ----------
    spec : str
        ID, ``ID:key=value,...`` or ``ID,key=value,...``: arguments of the environment,
        its constants (``gravity``, ``LINK_MASS_2``), fields of a MuJoCo model (arrays
        whole). ``MODULE:ID`` imports what registers it.
    state : str, optional
        "module:get,set", functions get(env) giving (d,) numbers and set(env, state).
        None means that they are found.
    actions : int or array_like, optional
        The actions of a Box: how many levels each coordinate has, the levels, or the
        commands (A, k); see ``gymnasium_named.action_set``.

    Returns
    -------
    ContinuousSimulator
        The simulator, whose task is a ``GymnasiumTask``.

    Raises
    ------
    ValueError
        If the id is unknown, the environment lacks the physics, or its state cannot be
        set or does not decide the next one.

    See Also
    --------
    GymnasiumTask : A task of an environment that a function makes.

    Examples
    --------
    >>> simulator = gymnasium_simulator("CartPole-v1:gravity=12,length=0.65")
    >>> simulator.task.state_names, simulator.horizon
    (('x', 'x_dot', 'theta', 'theta_dot'), 500)
    """
    _checks.instance(spec, str, "spec", "text")
    if state is not None:
        _checks.instance(state, str, "state", "text")
    physics = Physics(*gymnasium_spec(spec))
    env = physics.make()
    env.reset(seed=0)
    if state is None:
        known = _find_state(env, physics.identifier)
    else:
        known = _parse_state(state)
    if "over" in known:
        known["over"] = partial(known["over"], env)
    known |= {
        "actions": action_set(env.action_space, actions),
        "make_vector": physics.make_vector,
    }
    task = GymnasiumTask(physics.make, parameters=physics.given, **known)
    task.family = physics
    physics.task = task
    simulator = as_simulator(task, env.spec.max_episode_steps or HORIZON)
    # even where the steps of many states are made at once, they are slower than ours
    return replace(simulator, name=spec, **SLOW)


def gymnasium_spec(spec: str) -> tuple[str, dict[str, Any]]:
    """Return the id and the physics of ``ID:key=value,...``.

    A comma after the id does as well.

    >>> gymnasium_spec("Pendulum-v1,g=9.0")
    ('Pendulum-v1', {'g': 9.0})
    """
    named = _register(spec)
    return parse_spec(
        named if re.match("[^,]*:", named) else named.replace(",", ":", 1)
    )


def is_continuous_id(spec: str) -> bool:
    """Return whether ``spec`` begins with the id of a continuous environment.

    Its observations are then no numbers of states.
    """
    import gymnasium

    identifier = _read_identifier(_register(spec))
    if identifier not in gymnasium.registry:
        return False
    try:
        env = gymnasium.make(identifier)
    except Exception:  # whatever hinders it is said where it is made to be used
        return False
    space = env.observation_space
    env.close()
    return not hasattr(space, "n")


def _register(spec: str) -> str:
    """Return ``spec`` from its id on.

    The module that stands before it is imported, which registers the environment.
    """
    own = OWN_ID.match(spec)
    if own is None:
        return spec
    rest = spec[own.start(2) :]
    own_environment(own[1], _read_identifier(rest))
    return rest


def _read_identifier(rest: str) -> str:
    """Return the id that the rest of a spec begins with."""
    return re.split("[:,]", rest, maxsplit=1)[0]


def _parse_state(state: str) -> dict[str, Any]:
    """Return the two functions that read and set a state, by name."""
    names = [name.strip() for name in state.split(",", 1)]
    module = state.partition(":")[0]
    if len(names) < 2:
        raise ArgumentError(
            "--task-option state",
            f"must be like my_module:get,set, two functions; got {_checks.show(state)}",
        )
    with own_modules():
        specs = [name if ":" in name else f"{module}:{name}" for name in names]
        get, write = (
            own_object(spec, "--task-option state", "my_module:get,set")
            for spec in specs
        )
    return {"get_state": get, "set_state": write}


def _find_state(env: Any, identifier: str) -> dict[str, Any]:
    """Return what is known of the state of an environment.

    It is that of classic control, or MuJoCo's; of others ``env.state`` must be numbers.
    """
    for owner in type(env).__mro__:
        if owner.__name__ in CLASSIC and owner.__module__.startswith("gymnasium."):
            return dict(CLASSIC[owner.__name__])
    if hasattr(env, "model") and hasattr(env, "data") and hasattr(env, "set_state"):
        return _describe_mujoco(env.model)
    state = getattr(env, "state", None)
    if not _is_vector(state):
        raise ArgumentError(
            f"environment {identifier!r}",
            "must have a state that can be set, unwrapped.state (numbers) or"
            " unwrapped.set_state(qpos, qvel); it has neither. Write two functions,"
            " get(env) -> numbers and set(env, numbers), and name them: --task-option"
            " state=MODULE:GET,SET (tasks.GymnasiumTask in Python)",
        )
    return {}


def _is_vector(state: object) -> bool:
    """Return whether a state is a vector of at least one number."""
    if state is None:
        return False
    try:
        numbers = np.array(state, dtype=np.float64)
    except (TypeError, ValueError):
        return False
    return numbers.ndim == 1 and numbers.size > 0


def _describe_mujoco(model: Any) -> dict[str, Any]:
    """Return how a state (qpos, qvel) of MuJoCo is read and set.

    Hinges without a range are angles.
    """
    nq = int(model.nq)
    positions = tuple(f"qpos_{i}" for i in range(nq))
    names = positions + tuple(f"qvel_{i}" for i in range(int(model.nv)))
    is_limited = np.asarray(model.jnt_limited, dtype=np.bool_)
    free = (np.asarray(model.jnt_type) == HINGE) & ~is_limited
    turns = set(np.asarray(model.jnt_qposadr)[free].tolist())

    def get(env: Any) -> Array:
        """Return the state of an environment."""
        return np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel])

    def write(env: Any, state: Array) -> None:
        """Set the state of an environment."""
        # the solver's start is that of the step before, from another state
        env.unwrapped.data.qacc_warmstart[:] = 0.0
        env.unwrapped.set_state(np.array(state[:nq]), np.array(state[nq:]))

    periodic = tuple(i in turns for i in range(len(names)))
    return {
        "get_state": get,
        "set_state": write,
        "state_names": names,
        "periodic": periodic,
    }


def action_set(space: Any, given: RealArrayLike | None = None) -> Array:
    """Return numbers (A,) of a Discrete space, or commands (A, k) of a Box.

    Parameters
    ----------
    space : gymnasium.spaces.Discrete or gymnasium.spaces.Box
        The action space.
    given : int or array_like, optional
        For a Box, how many levels each coordinate has, evenly from low to high (None
        means 9 of one coordinate, 5 of two, else 3); or the levels themselves, (m,); or
        the commands, (A, k).

    Returns
    -------
    ndarray of shape (A,) or (A, k)
        The actions.

    Raises
    ------
    ValueError
        If the space is another, levels of an endless range are asked for, actions of a
        Discrete space are given, or commands lie outside the space.

    Examples
    --------
    >>> from gymnasium.spaces import Box
    >>> action_set(Box(-2.0, 2.0, (1,)), 3).tolist()
    [[-2.0], [0.0], [2.0]]
    """
    if hasattr(space, "n"):
        if given is not None:
            raise ArgumentError(
                "actions",
                f"must be left out where the environment has {space}; they are"
                f" {_checks.show(given)}",
            )
        numbers = int(getattr(space, "start", 0)) + np.arange(int(space.n))
        return np.asarray(numbers, dtype=np.float64)
    if len(getattr(space, "shape", None) or ()) != 1 or not hasattr(space, "low"):
        raise ArgumentError(
            "env.action_space", f"must be Discrete, or a Box of vectors; it is {space}"
        )
    k = space.shape[0]
    count = N_LEVELS.get(k, 3) if given is None else given
    if _checks.is_integer(count):
        n = _checks.positive_integer(count, "actions")
        if n > MAX_COMMANDS:
            raise ArgumentError(
                "actions", f"must be at most {MAX_COMMANDS} in all; there are {n}"
            )
        if not np.isfinite([space.low, space.high]).all():
            raise ArgumentError(
                "actions",
                f"must be given for {space}, whose range has no end: levels such as"
                " [-1,0,1]",
            )
        levels = list(np.linspace(space.low, space.high, n).T)
    else:
        given_levels = _checks.float_array(count, "actions", ndim=(1, 2))
        if not given_levels.size:
            raise ArgumentError(
                "actions", "must have a level or a command; it is empty"
            )
        levels = [given_levels for _ in range(k)]
    n_levels = len(levels[0])
    table = np.asarray(levels[0])
    if table.ndim == 1:
        if float(n_levels) ** k > MAX_COMMANDS:
            raise ArgumentError(
                "actions",
                f"must be at most {MAX_COMMANDS} in all; {n_levels} levels of {k}"
                " coordinates are more",
            )
        table = np.array(list(itertools.product(*levels)))
    for i, row in enumerate(table):
        if not space.contains(row.astype(space.dtype)):
            raise ArgumentError(
                f"actions[{i}]", f"must be in {space}; it is {row.tolist()}"
            )
    return np.asarray(table)


class Physics:
    """An environment's id with parameters by name.

    What the environment does not have is a ValueError. With a ``task`` of the
    environment it is a ``task_of`` of ``fit_parameters``.
    """

    task: Any = None

    def __init__(self, identifier: str, given: Mapping[str, Any]) -> None:
        import gymnasium

        environment_exists(identifier)
        self.identifier = identifier
        self.given = dict(given)
        self.spec = gymnasium.spec(identifier)
        self._takes = inspect.signature(_load(self.spec.entry_point)).parameters
        known_arguments = {*self._takes, *self.spec.kwargs}
        self._arguments = {key: x for key, x in given.items() if key in known_arguments}
        self._constants: dict[str, Any] = {}
        self._fields: dict[str, Any] = {}
        for key, value in self._arguments.items():
            if key in self._takes and _is_number(self._takes[key].default):
                _checks.number_in(value, key, -np.inf, np.inf)
        rest = {key: x for key, x in given.items() if key not in self._arguments}
        if not rest:
            return
        env = self.make()
        inner = env.unwrapped
        elements = _elements(inner)
        known = _numbers_of(inner)
        holders = (inner.model, inner.model.opt) if elements else ()
        for key, value in rest.items():
            is_field = key in elements or any(hasattr(each, key) for each in holders)
            if is_field and not hasattr(inner, key):
                self._fields[key] = value
                continue
            if key not in known:
                takes = ", ".join(name for name in self._takes if name != "kwargs")
                raise ArgumentError(
                    key,
                    f"must be an argument or a number of {identifier}: it takes"
                    f" {takes or 'none'} and has {', '.join(known) or 'none'}; got"
                    f" {key}={value!r}",
                )
            self._constants[key] = _checks.number_in(value, key, -np.inf, np.inf)
        env.close()

    def make(self, point: str = "entry_point", **arguments: Any) -> Any:
        """Make the environment, without Gymnasium's wrappers."""
        import gymnasium

        owner = _load(getattr(self.spec, point))
        arguments = self.spec.kwargs | self._arguments | arguments
        if self._constants:
            if not isinstance(owner, type):
                raise ArgumentError(
                    next(iter(self._constants)),
                    f"must be an argument of {self.identifier}, which is made by a"
                    " function",
                )

            def hold(env: object, name: str, value: object) -> None:
                """Set an attribute, a given constant always to its given number."""
                object.__setattr__(env, name, self._constants.get(name, value))

            members = self._constants | {
                "__setattr__": hold,
                "__module__": owner.__module__,
            }
            owner = type(owner.__name__, (owner,), members)
        try:
            env = owner(**arguments)
        except gymnasium.error.Error as error:
            raise ValueError(
                f"environment {self.identifier!r} cannot be made: {error}"
            ) from None
        except (
            TypeError,
            LookupError,
            ValueError,
            ArithmeticError,
            AttributeError,
            AssertionError,
        ) as error:
            raise ValueError(
                f"environment {self.identifier!r} does not take {arguments}: {error}"
            ) from None
        env.spec = self.spec
        for key, value in self._fields.items():
            _set_field(env.unwrapped, key, value)
        return env

    @property
    def make_vector(self) -> Callable[[int], Any] | None:
        """Return a function of n that makes n environments which step at once.

        It is None where Gymnasium has no such.
        """
        if self.spec.vector_entry_point is None or self._fields:
            return None

        def make_many(n: int) -> Any:
            """Make n environments that step at once."""
            return self.make("vector_entry_point", num_envs=n)

        return make_many

    def __call__(self, **parameters: float) -> Any:
        """Return the task with these parameters."""
        changed = Physics(self.identifier, self.given | parameters)
        return self.task.with_environment(
            changed.make, changed.make_vector, changed.given
        )

    def known(self) -> dict[str, float]:
        """Return every number of the environment by its name, as it is.

        Numbers are arguments, constants, and elements of a MuJoCo
        model (body_mass.pole).
        """
        env = self.make()
        found = {name: p.default for name, p in self._takes.items()}
        found |= _numbers_of(env.unwrapped)
        found |= self.given
        found |= {name: values[0] for name, values in _elements(env.unwrapped).items()}
        env.close()
        numbers = {name: x for name, x in found.items() if _is_number(x)}
        return {name: float(x) for name, x in numbers.items()}


def _load(point: object) -> Any:
    """Return what makes an environment: an entry point, or the object that it names."""
    from gymnasium.envs.registration import load_env_creator

    return point if callable(point) else load_env_creator(str(point))


def _is_number(value: object) -> bool:
    """Return whether a value is a number and no boolean."""
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _numbers_of(inner: object) -> dict[str, Any]:
    """Return an environment's attributes that are numbers, its class's too, by name.

    None is computed by a property.
    """
    numbers = {}
    for name in sorted(dir(inner)):
        is_private = name.startswith("_")
        # a property may compute, or fail before an episode begins
        if is_private or isinstance(
            inspect.getattr_static(inner, name, None), property
        ):
            continue
        value = getattr(inner, name, None)
        if _is_number(value):
            numbers[name] = value
    return numbers


def _elements(inner: Any) -> dict[str, Any]:
    """Return views of the elements of an environment's MuJoCo model by FIELD.ELEMENT.

    Friction and gear have more than the first number.
    """
    found: dict[str, Any] = {}
    model: Any = getattr(inner, "model", None)
    if not hasattr(model, "nbody"):
        return found
    for field, (kind, count) in ELEMENTS.items():
        values = getattr(model, field)
        for k in range(getattr(model, count)):
            # degrees of freedom are named by their joint
            number = int(model.dof_jntid[k]) if count == "nv" else k
            name = getattr(model, kind)(number).name or str(k)
            # a joint of several degrees of freedom stands for its first
            found.setdefault(f"{field}.{name}", values.reshape(len(values), -1)[k])
    return found


def _set_field(inner: Any, key: str, value: Any) -> None:
    """Set a field of a MuJoCo model, an array whole, or one element by its name."""
    import mujoco

    model = inner.model
    elements = _elements(inner)
    if key in elements:
        elements[key][0] = _checks.number_in(value, key, -np.inf, np.inf)
    else:
        holder = model if hasattr(model, key) else model.opt
        own = np.asarray(getattr(holder, key))
        found = _checks.float_array(value, key, ndim=(0, 1, 2))
        if found.shape != own.shape:
            raise ArgumentError(
                key,
                f"must have shape {own.shape}, as in the model: {own.tolist()}; it has"
                f" shape {found.shape}",
            )
        setattr(holder, key, found if own.ndim else own.dtype.type(found))
    mujoco.mj_setConst(model, inner.data)
