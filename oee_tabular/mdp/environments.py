"""Gymnasium environments: what is one, and the numbers that it gives.

Environments are other people's code. Their numbers may be of any type that reads as a
number, such as arrays with one entry.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import BoolArray


def require_environment(env: Any) -> None:
    """Raise an ArgumentError for what is not one environment that can be stepped."""
    kind = type(env).__name__
    if isinstance(env, type):
        raise ArgumentError(
            "env",
            f"must be a Gymnasium environment; got the class {env.__name__} (make one:"
            f" {env.__name__}())",
        )
    if not callable(getattr(env, "step", None)) or not callable(
        getattr(env, "reset", None)
    ):
        hint = f" (gymnasium.make({_checks.show(env)}))" if isinstance(env, str) else ""
        raise ArgumentError("env", f"must be a Gymnasium environment; got {kind}{hint}")
    if hasattr(env, "num_envs"):
        raise ArgumentError(
            "env",
            f"must be a single environment; {kind} steps {_checks.show(env.num_envs)}"
            " at once (make one of them alone: gymnasium.make in place of make_vec)",
        )


def is_discrete(space: Any) -> bool:
    """Say whether a space is Discrete: n numbers, and not n in an array."""
    return _checks.is_integer(getattr(space, "n", None)) and not getattr(
        space, "shape", ()
    )


def read_number(value: Any) -> float | None:
    """Return a real number of any type, or the only one of an array; None for others.

    >>> read_number(np.array([1.5])), read_number("1.5"), read_number([1.5])
    (1.5, None, None)
    """
    try:
        if np.ma.is_masked(value):
            return None
        shape = getattr(value, "shape", ())
        if isinstance(shape, tuple) and shape and math.prod(shape) == 1:
            value = value.item()
        kind = getattr(getattr(value, "dtype", None), "kind", "f")
        is_text = isinstance(value, str | bytes | bytearray)
        return None if is_text or kind not in "biufO" else float(value)
    except Exception:  # a foreign type may raise anything
        return None


def read_flag(value: Any) -> bool | None:
    """Return True or False, also for the numbers 1 and 0; None for others."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    number = read_number(value)
    return None if number not in (0.0, 1.0) else bool(number)


def read_mask(value: Any, n_actions: int, call: str) -> BoolArray:
    """Return a mask of actions, (A,) booleans or numbers 0 and 1.

    ``call`` is what gave it.
    """
    try:
        array = np.asarray(value)
    except Exception:  # a foreign type may raise anything
        array = np.zeros(0)
    is_mask = array.shape == (n_actions,) and array.dtype.kind in "biuf"
    if not is_mask or not ((array == 0) | (array == 1)).all():
        raise ArgumentError(
            call,
            f"must be {n_actions} numbers 0 or 1, one for each action; it is"
            f" {_checks.show(value)}",
        )
    return np.asarray(array != 0)


def read_integer(value: Any) -> int | None:
    """Return an integer of any type, or the only one of an array; None for others.

    >>> read_integer(3.0), read_integer(np.array([2])), read_integer(2.5)
    (3, 2, None)
    """
    if _checks.is_integer(value):
        return int(value)
    number = read_number(value)
    if number is None or not math.isfinite(number) or number != math.floor(number):
        return None
    return int(number)
