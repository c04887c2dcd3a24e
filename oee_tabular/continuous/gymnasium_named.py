"""Gymnasium environments by id, ``Pendulum-v1:g=9``, as continuous simulators: how their states are read and set is found.

Classic control keeps its state in ``unwrapped.state``; MuJoCo's is (qpos, qvel), set by ``set_state``. Of others two functions
say it, get(env) and set(env, state).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
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
HINGE = 3  # mujoco.mjtJoint.mjJNT_HINGE


def _has_fallen(env: Any, states: Array) -> BoolArray:
    far, turned = np.abs(states[:, 0]) > env.x_threshold, np.abs(states[:, 2]) > env.theta_threshold_radians
    return np.asarray(far | turned)


def _has_arrived(env: Any, states: Array) -> BoolArray:
    return np.asarray((states[:, 0] >= env.goal_position) & (states[:, 1] >= env.goal_velocity))


def _is_raised(env: object, states: Array) -> BoolArray:
    return np.asarray(-np.cos(states[:, 0]) - np.cos(states[:, 1] + states[:, 0]) > 1.0)


_CAR = {"state_names": ("position", "speed"), "low": (-1.2, -0.07), "high": (0.6, 0.07), "over": _has_arrived}
# by the name of the class, or of one that it is made from: what GymnasiumTask takes; ``over`` takes the environment as well
CLASSIC: Mapping[str, dict[str, Any]] = {
    "CartPoleEnv": {
        "state_names": ("x", "x_dot", "theta", "theta_dot"), "low": (-2.4, -3.0, -0.21, -3.2),
        "high": (2.4, 3.0, 0.21, 3.2), "over": _has_fallen,
    },
    "PendulumEnv": {
        "state_names": ("angle", "speed"), "low": (-np.pi, -8.0), "high": (np.pi, 8.0), "periodic": (True, False),
        "terminates": False,
    },
    "MountainCarEnv": _CAR,
    "Continuous_MountainCarEnv": _CAR,
    "AcrobotEnv": {
        "state_names": ("angle_1", "angle_2", "speed_1", "speed_2"), "low": (-np.pi, -np.pi, -4 * np.pi, -9 * np.pi),
        "high": (np.pi, np.pi, 4 * np.pi, 9 * np.pi), "periodic": (True, True, False, False), "over": _is_raised,
    },
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
    env = physics.make()
    env.reset(seed=0)
    known = _find_state(env, physics.identifier) if state is None else _parse_state(state)
    if "over" in known:
        known["over"] = partial(known["over"], env)
    known |= {"actions": action_set(env.action_space, actions), "make_vector": physics.make_vector}
    task = GymnasiumTask(physics.make, parameters=physics.given, **known)
    task.family, physics.task = physics, task
    simulator = as_simulator(task, env.spec.max_episode_steps or HORIZON)
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


def _parse_state(state: str) -> dict[str, Any]:
    """From "module:get,set"."""
    first, comma, second = state.partition(",")
    if not comma:
        raise ValueError(f"--task-option state must be like my_module:get,set, two functions; got {state!r}")
    module = first.partition(":")[0]
    with own_modules():
        get, write = (
            own_object(name if ":" in name else f"{module}:{name}", "--task-option state", "my_module:get,set")
            for name in (first.strip(), second.strip())
        )
    return {"get_state": get, "set_state": write}


def _find_state(env: Any, identifier: str) -> dict[str, Any]:
    """What is known of the state: of classic control, of MuJoCo, else that ``env.state`` is numbers."""
    for owner in type(env).__mro__:
        if owner.__name__ in CLASSIC and owner.__module__.startswith("gymnasium."):
            return dict(CLASSIC[owner.__name__])
    if hasattr(env, "model") and hasattr(env, "data") and hasattr(env, "set_state"):
        return _describe_mujoco(env.model)
    state = getattr(env, "state", None)
    try:
        is_vector = state is not None and np.array(state, dtype=np.float64).ndim == 1 and np.size(state) > 0
    except (TypeError, ValueError):
        is_vector = False
    if not is_vector:
        raise ValueError(
            f"environment {identifier!r} must have a state that can be set, unwrapped.state (numbers) or "
            "unwrapped.set_state(qpos, qvel); it has neither. Write two functions, get(env) -> numbers and set(env, numbers), "
            "and name them: --task-option state=MODULE:GET,SET (tasks.GymnasiumTask in Python)"
        )
    return {}


def _describe_mujoco(model: Any) -> dict[str, Any]:
    """(qpos, qvel); hinges without a range are angles."""
    nq = int(model.nq)
    names = tuple(f"qpos_{i}" for i in range(nq)) + tuple(f"qvel_{i}" for i in range(int(model.nv)))
    free = (np.asarray(model.jnt_type) == HINGE) & ~np.asarray(model.jnt_limited, dtype=np.bool_)
    turns = set(np.asarray(model.jnt_qposadr)[free].tolist())

    def get(env: Any) -> Array:
        return np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel])

    def write(env: Any, state: Array) -> None:
        env.unwrapped.data.qacc_warmstart[:] = 0.0  # of the step before, which is another's
        env.unwrapped.set_state(np.array(state[:nq]), np.array(state[nq:]))

    periodic = tuple(i in turns for i in range(len(names)))
    return {"get_state": get, "set_state": write, "state_names": names, "periodic": periodic}
