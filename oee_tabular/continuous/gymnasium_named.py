"""Gymnasium environments by id, ``Pendulum-v1:g=9``, as continuous simulators: how their states are read and set is found.

Classic control keeps its state in ``unwrapped.state``; MuJoCo's is (qpos, qvel), set by ``set_state``. Of others two functions
say it, get(env) and set(env, state). Whatever the way, ``GymnasiumTask`` steps a record of its own again and refuses a state
that does not decide the next one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from oee_tabular._arguments import own_module, own_modules, own_object, parse_spec
from oee_tabular._checks import Array, BoolArray
from oee_tabular.continuous.actions import action_set
from oee_tabular.continuous.gymnasium_physics import Physics
from oee_tabular.continuous.gymnasium_task import GymnasiumTask
from oee_tabular.continuous.simulator import SLOW_EPISODES, SLOW_PATHS, SLOW_REFITS, ContinuousSimulator, as_simulator

OWN_ID = re.compile(r"([^\W\d]\w*(?:\.[^\W\d]\w*)*):([A-Za-z][\w.-]*-v\d+)(?=[:,]|$)")  # MODULE:EnvId-v0
HORIZON = 1000  # where the environment has no limit
LOOKED = 1000  # steps by which usual ranges are found
HINGE = 3  # mujoco.mjtJoint.mjJNT_HINGE


@dataclass(frozen=True)
class StateAccess:
    """How an environment's state is read and set, and what is known of its coordinates.

    Attributes
    ----------
    get, write : as ``get_state`` and ``set_state`` of ``GymnasiumTask``
    names : of the coordinates; () where nothing is known but their number
    periodic : which are angles; () for none
    low, high : usual ranges; () where steps must show them
    over : (env, states) -> which are over; None where steps alone can say
    terminates : whether episodes can end before a time limit
    """

    get: Callable[[Any], Any]
    write: Callable[[Any, Array], None]
    names: tuple[str, ...] = ()
    periodic: tuple[bool, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    over: Callable[[Any, Array], BoolArray] | None = None
    terminates: bool = True


def _read(env: Any) -> Array:
    return np.array(env.unwrapped.state, dtype=np.float64)


def _write(env: Any, state: Array) -> None:
    inner = env.unwrapped
    inner.state = np.array(state)
    if hasattr(inner, "steps_beyond_terminated"):
        inner.steps_beyond_terminated = None


def _fallen(env: Any, states: Array) -> BoolArray:
    far, turned = np.abs(states[:, 0]) > env.x_threshold, np.abs(states[:, 2]) > env.theta_threshold_radians
    return np.asarray(far | turned)


def _has_arrived(env: Any, states: Array) -> BoolArray:
    return np.asarray((states[:, 0] >= env.goal_position) & (states[:, 1] >= env.goal_velocity))


def _is_raised(env: object, states: Array) -> BoolArray:
    return np.asarray(-np.cos(states[:, 0]) - np.cos(states[:, 1] + states[:, 0]) > 1.0)


_TURN, _POLE = float(np.pi), 0.21
_CAR = StateAccess(_read, _write, ("position", "speed"), (), (-1.2, -0.07), (0.6, 0.07), _has_arrived)
CLASSIC: Mapping[str, StateAccess] = {  # by the name of the class, or of one that it is made from
    "CartPoleEnv": StateAccess(
        _read, _write, ("x", "x_dot", "theta", "theta_dot"), (), (-2.4, -3.0, -_POLE, -3.2), (2.4, 3.0, _POLE, 3.2), _fallen
    ),
    "PendulumEnv": StateAccess(
        _read, _write, ("angle", "speed"), (True, False), (-_TURN, -8.0), (_TURN, 8.0), terminates=False
    ),
    "MountainCarEnv": _CAR,
    "Continuous_MountainCarEnv": _CAR,
    "AcrobotEnv": StateAccess(
        _read, _write, ("angle_1", "angle_2", "speed_1", "speed_2"), (True, True, False, False),
        (-_TURN, -_TURN, -4 * _TURN, -9 * _TURN), (_TURN, _TURN, 4 * _TURN, 9 * _TURN), _is_raised,
    ),
}  # fmt: skip


def gymnasium_simulator(spec: str, *, state: str | None = None, actions: object = None) -> ContinuousSimulator:
    """The Gymnasium environment that ``spec`` names, as a continuous simulator.

    Parameters
    ----------
    spec : ID, ``ID:key=value,...`` or ``ID,key=value,...``: arguments of the environment, its constants (``gravity``,
        ``LINK_MASS_2``), fields of a MuJoCo model (arrays whole); ``MODULE:ID`` imports what registers it
    state : "module:get,set", functions get(env) -> (d,) and set(env, state); None: found
    actions : of a Box, see ``actions.action_set``

    Raises
    ------
    ValueError
        An unknown id, physics that it lacks, a state that cannot be set or does not decide the next one.

    Examples
    --------
    >>> simulator = gymnasium_simulator("CartPole-v1:gravity=12,length=0.65")
    >>> simulator.task.state_names, simulator.horizon
    (('x', 'x_dot', 'theta', 'theta_dot'), 500)
    """
    physics = Physics(*gymnasium_spec(spec))
    make, identifier = physics.make, physics.identifier
    env = make()
    env.reset(seed=0)
    way = _find_access(env, identifier) if state is None else _parse_access(state)
    start = np.array(way.get(env), dtype=np.float64)
    names = way.names or getattr(env.unwrapped, "state_names", None) or [f"state_{i}" for i in range(start.size)]
    commands = action_set(env.unwrapped.action_space, actions)
    low, high = (way.low, way.high) if way.low else _ranges(make, way, commands)
    task = GymnasiumTask(
        make,
        state_names=tuple(names),
        get_state=way.get,
        set_state=way.write,
        actions=commands,
        low=low,
        high=high,
        periodic=way.periodic or None,
        terminates=way.terminates,
        over=None if way.over is None else partial(way.over, env.unwrapped),
        parameters=physics.given,
        make_vector=physics.make_vector,
    )
    task.family, physics.task = physics, task
    simulator = as_simulator(task, getattr(env.spec, "max_episode_steps", None) or HORIZON)
    return replace(simulator, name=spec, episodes=SLOW_EPISODES, refit_paths=SLOW_PATHS, refits=SLOW_REFITS)


def gymnasium_spec(spec: str) -> tuple[str, dict[str, Any]]:
    """The id and the physics of ``ID:key=value,...``; a comma after the id does as well.

    >>> gymnasium_spec("Pendulum-v1,g=9.0")
    ('Pendulum-v1', {'g': 9.0})
    """
    named = _register(spec)
    return parse_spec(named if re.match("[^,]*:", named) else named.replace(",", ":", 1))


def is_continuous_id(spec: str) -> bool:
    """Whether ``spec`` begins with the id of a Gymnasium environment whose observations are no numbers of states."""
    import gymnasium

    identifier = re.split("[:,]", _register(spec), maxsplit=1)[0]
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
    """``spec`` from its id on; the module that stands before it is imported, which registers the environment."""
    own = OWN_ID.match(spec)
    if own is None:
        return spec
    with own_modules():
        own_module(own[1])
    return spec[own.start(2) :]


def _parse_access(state: str) -> StateAccess:
    """From "module:get,set"."""
    first, comma, second = state.partition(",")
    if not comma:
        raise ValueError(f"--task-option state must be like my_module:get,set, two functions; got {state!r}")
    module = first.partition(":")[0]
    with own_modules():
        functions = [
            own_object(name if ":" in name else f"{module}:{name}", "--task-option state", "my_module:get,set")
            for name in (first.strip(), second.strip())
        ]
    return StateAccess(*functions)


def _find_access(env: Any, identifier: str) -> StateAccess:
    """What the environment itself offers."""
    inner = env.unwrapped
    for owner in type(inner).__mro__:
        if owner.__name__ in CLASSIC and owner.__module__.startswith("gymnasium."):
            return CLASSIC[owner.__name__]
    if hasattr(inner, "model") and hasattr(inner, "data") and hasattr(inner, "set_state"):
        return _mujoco(inner)
    state = getattr(inner, "state", None)
    try:
        vector = np.array(state, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if state is None or vector.ndim != 1 or vector.size == 0:
        raise ValueError(
            f"environment {identifier!r} must have a state that can be set, unwrapped.state (numbers) or "
            "unwrapped.set_state(qpos, qvel); it has neither. Write two functions, get(env) -> numbers and set(env, numbers), "
            "and name them: --task-option state=MODULE:GET,SET (tasks.GymnasiumTask in Python)"
        )
    return StateAccess(_read, _write)


def _mujoco(inner: Any) -> StateAccess:
    """(qpos, qvel); hinges without a range are angles; over where the environment's ``is_healthy`` says so."""
    model, nq = inner.model, int(inner.model.nq)
    names = tuple(f"qpos_{i}" for i in range(nq)) + tuple(f"qvel_{i}" for i in range(int(model.nv)))
    free = (np.asarray(model.jnt_type) == HINGE) & ~np.asarray(model.jnt_limited, dtype=np.bool_)
    turns = set(np.asarray(model.jnt_qposadr)[free].tolist())

    def get(env: Any) -> Array:
        return np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel])

    def write(env: Any, state: Array) -> None:
        env.unwrapped.data.qacc_warmstart[:] = 0.0  # of the step before, which is another's
        env.unwrapped.set_state(np.array(state[:nq]), np.array(state[nq:]))

    return StateAccess(get, write, names, tuple(i in turns for i in range(len(names))))


def _ranges(make: Callable[[], Any], way: StateAccess, commands: Array) -> tuple[Array, Array]:
    """The usual range of each coordinate: what random actions reach, and a tenth more; of an angle one turn."""
    env, rng = make(), np.random.default_rng(0)
    env.reset(seed=0)
    states = []
    for _ in range(LOOKED):
        states.append(np.array(way.get(env), dtype=np.float64))
        command = commands[int(rng.integers(len(commands)))]
        _, _, over, cut, _ = env.step(command.astype(env.action_space.dtype) if command.ndim else int(command))
        if over or cut:
            env.reset()
    env.close()
    low, high = np.min(states, axis=0), np.max(states, axis=0)
    room = np.maximum(0.1 * (high - low), 1e-6)
    turns = np.array(way.periodic or (False,) * len(low))
    return np.where(turns, -np.pi, low - room), np.where(turns, np.pi, high + room)
