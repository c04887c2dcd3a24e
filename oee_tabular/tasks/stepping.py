"""Steps and resets of environments, checked where they enter the package.

``env.reset(seed=...)`` returns (observation, info), ``env.step(action)`` returns
(observation, reward, terminated, truncated, info). What an environment raises, or
returns in another form, is an ArgumentError that names the call, the state and the
value. A step in the usual form costs .2 us more than ``env.step`` alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError

# not by the room's door: FiniteMDP.from_env asks for the explorer, which steps
from oee_tabular.mdp.environments import (
    is_discrete,
    read_flag,
    read_integer,
    read_number,
)

STEP_FORM = "(observation, reward, terminated, truncated, info)"
RESET_FORM = "(observation, info)"
MAX_REASON_CHARACTERS = 300  # of an environment's own error
# The longest episode, in steps, where nothing else limits it.
MAX_EPISODE_STEPS = 1_000_000


class Step(NamedTuple):
    """Hold what an environment returned for an action, without its information."""

    observation: Any
    reward: float
    terminated: bool
    truncated: bool


def count_actions(env: Any) -> int:
    """Return the number of actions of an environment; they are Discrete, from 0."""
    space = getattr(env, "action_space", None)
    if is_discrete(space) and int(getattr(space, "start", 0)) == 0:
        return int(space.n)  # type: ignore[union-attr]
    hint = ""
    if is_discrete(space):
        start = int(space.start)  # type: ignore[union-attr]
        hint = (
            f" (gymnasium.wrappers.TransformAction(env, lambda a: a + {start},"
            f" gymnasium.spaces.Discrete({space.n})))"  # type: ignore[union-attr]
        )
    elif hasattr(space, "nvec"):
        sizes = tuple(np.ravel(space.nvec).tolist())  # type: ignore[union-attr]
        hint = (
            " (number the combinations: gymnasium.wrappers.TransformAction(env, lambda"
            f" a: numpy.array(numpy.unravel_index(a, {sizes})),"
            f" gymnasium.spaces.Discrete({math.prod(sizes)})))"
        )
    raise ArgumentError(
        "env.action_space",
        f"must be Discrete, from 0; it is {_checks.show(space)}{hint}",
    )


def count_observations(env: Any) -> int | None:
    """Return 1 + the largest Discrete observation, None where they are not Discrete.

    Observations that begin at 1 leave the number 0 to a state that is never met.
    """
    space = getattr(env, "observation_space", None)
    if not is_discrete(space):
        return None
    start = int(getattr(space, "start", 0))
    size = int(space.n)  # type: ignore[union-attr]
    if start < 0:
        raise ArgumentError(
            "env.observation_space",
            f"must not begin below 0; it is {_checks.show(space)}"
            " (gymnasium.wrappers.TransformObservation(env, lambda s: s"
            f" + {-start}, gymnasium.spaces.Discrete({size})))",
        )
    return start + size


def reset_environment(
    env: Any,
    seed: int | None = None,
    *,
    name: str = "env",
    keep: Callable[[Any], None] | None = None,
) -> Any:
    """Begin an episode, and return its first observation; ``keep`` gets its info."""
    try:
        result = env.reset(seed=seed)
    except Exception as error:  # an environment may raise anything
        hint = " (it takes seed=)" if isinstance(error, TypeError) else ""
        raise ArgumentError(
            f"{name}.reset",
            f"must take seed= and return {RESET_FORM}; that of {_call(env)} raises"
            f" {_reason(error)}{hint}",
        ) from error
    if isinstance(result, tuple | list) and len(result) == 2:
        observation, info = result
        if info is None or isinstance(info, Mapping):
            if keep is not None:
                keep(info)
            return observation
    raise ArgumentError(
        f"{name}.reset",
        f"must return {RESET_FORM}, info a dict; that of {_call(env)} returns"
        f" {_checks.show(result)} (old Gym's returns the observation alone: write"
        " `return observation, {}`)",
    )


def step_environment(
    env: Any,
    action: Any,
    state: object,
    *,
    name: str = "env",
    keep: Callable[[Any], None] | None = None,
) -> Step | tuple[Any, float, bool, bool]:
    """Take an action; ``state`` is where, for errors, and ``keep`` gets the info."""
    try:
        result = env.step(action)
    except Exception as error:  # an environment may raise anything
        hint = ""
        if isinstance(error, LookupError):
            hint = (
                " (an action that cannot be taken in a state is left out by a mask,"
                ' info["action_mask"], or may stay there: return the same observation'
                " with the reward 0)"
            )
        elif getattr(env, "unwrapped", env) is not env:
            hint = " (of env.unwrapped, without its wrappers, the error may say more)"
        raise ArgumentError(
            _place(name, action),
            f"must not raise; in state {_checks.show(state)} of {_call(env)} it raises"
            f" {_reason(error)}{hint}",
        ) from error
    if type(result) is tuple and len(result) == 5:
        observation, reward, terminated, truncated, info = result
        if keep is not None:
            keep(info)
        if (
            type(reward) is float
            and reward - reward == 0.0  # finite
            and type(terminated) is bool
            and type(truncated) is bool
        ):
            return observation, reward, terminated, truncated
    step = _check_step(result, name, action, state)
    if keep is not None:
        keep(result[4])
    return step


def _check_step(result: Any, name: str, action: Any, state: object) -> Step:
    """Return what a step gives in a less usual form, or raise an ArgumentError."""
    place = _place(name, action)
    where = f"in state {_checks.show(state)}"
    if not isinstance(result, tuple | list) or len(result) != 5:
        what = _checks.show(result)
        hint = ""
        if isinstance(result, tuple | list):
            what = f"{len(result)} values, {what}"
            if len(result) == 4:
                hint = (
                    " (old Gym's step: write `return observation, reward, done and not"
                    " cut, cut, info`, where cut says that a time limit ended the"
                    ' episode, info.get("TimeLimit.truncated", False))'
                )
        raise ArgumentError(
            place, f"must return {STEP_FORM}; {where} it returns {what}{hint}"
        )
    observation, reward, terminated, truncated, _ = result
    number = read_number(reward)
    if number is None or not math.isfinite(number):
        hint = ""
        if isinstance(reward, Mapping):
            hint = " (of an environment of several agents, make one of a single agent)"
        raise ArgumentError(
            place,
            f"must give a finite number as reward; {where} it gives"
            f" {_checks.show(reward)}{hint}",
        )
    flags = []
    for word, value in (("terminated", terminated), ("truncated", truncated)):
        flag = read_flag(value)
        if flag is None:
            raise ArgumentError(
                place,
                f"must give True or False as {word}; {where} it gives"
                f" {_checks.show(value)}",
            )
        flags.append(flag)
    return Step(observation, number, *flags)


def require_observation(
    observation: Any, size: int, env: Any, call: str, state: object
) -> int:
    """Return an observation of a Discrete space, a number below ``size``.

    ``call`` is what gave it, in the state ``state`` (None: a reset).
    """
    number = read_integer(observation)
    space = env.observation_space
    if number is None or not int(getattr(space, "start", 0)) <= number < size:
        where = "" if state is None else f"in state {_checks.show(state)} "
        raise ArgumentError(
            call,
            f"must give an observation in env.observation_space, {_checks.show(space)};"
            f" {where}it gives {_checks.show(observation)}",
        )
    return number


def _place(name: str, action: object) -> str:
    """Name a step, ``env.step(1)``."""
    return f"{name}.step({_checks.show(action)})"


def _call(env: Any) -> str:
    """Return what an environment is called, its id or its class."""
    identifier = getattr(getattr(env, "spec", None), "id", None)
    return str(identifier or type(getattr(env, "unwrapped", env)).__name__)


def _reason(error: Exception) -> str:
    """Write an environment's own error."""
    text = _checks.escape_controls(" ".join(str(error).split()))
    return f"{type(error).__name__}: {text[:MAX_REASON_CHARACTERS]}"
