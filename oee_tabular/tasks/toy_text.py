"""Gymnasium's toy-text environments, by id and keyword arguments."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from oee_tabular import _checks
from oee_tabular.mdp import FiniteMDP


def environment_exists(identifier: str, others: Iterable[str] = ()) -> None:
    """A ValueError with the nearest ids, or names of ``others``, for an unknown one."""
    from gymnasium.envs.registration import registry

    _checks.instance(identifier, str, "identifier")
    if identifier not in registry:
        near = difflib.get_close_matches(identifier, [*others, *registry], n=3, cutoff=0.5)
        hint = f"; near: {', '.join(near)}" if near else ""
        raise ValueError(
            f"environment must be a task or a Gymnasium id; {identifier!r} is neither{hint} (your own: module:Class or "
            "module:EnvId-v0)"
        )


def make_environment(identifier: str, **kwargs: Any) -> Any:
    """``gymnasium.make`` with errors that name what was asked for.

    Parameters
    ----------
    identifier : a Gymnasium id
    kwargs : of the environment

    Raises
    ------
    ValueError
        An unknown id (with the nearest ones), or arguments that the environment does not take.

    Examples
    --------
    >>> make_environment("FrozenLake-v1", is_slippery=False).observation_space
    Discrete(16)
    >>> make_environment("FrozenLak-v1")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ValueError: environment must be a task or a Gymnasium id; 'FrozenLak-v1' is neither; near: FrozenLake-v1...
    """
    import gymnasium

    environment_exists(identifier)
    try:
        return gymnasium.make(identifier, **kwargs)
    except gymnasium.error.Error as error:
        raise ValueError(f"environment {identifier!r} cannot be made: {error}") from None
    except (TypeError, LookupError, ValueError, ArithmeticError, AttributeError, AssertionError) as error:
        raise ValueError(f"environment {identifier!r} does not take these arguments {kwargs}: {error}") from None


def toy_text(identifier: str, *, discount: float = 0.99, **kwargs: object) -> FiniteMDP:
    """The FiniteMDP of a Gymnasium toy-text environment.

    Parameters
    ----------
    identifier : a Gymnasium id
    discount : in [0, 1]
    kwargs : of the environment

    Examples
    --------
    >>> toy_text("FrozenLake-v1", map_name="8x8", success_rate=0.6)
    FiniteMDP(64 states, 4 actions, 674 transitions, rewards r(s, a, s'), discount 0.99)
    """
    gamma = _checks.number_in(discount, "discount", 0.0, 1.0)
    env = make_environment(identifier, **kwargs)
    try:
        return FiniteMDP.from_gymnasium(env, discount=gamma)
    except ValueError as error:
        said = f" with {', '.join(f'{name}={value!r}' for name, value in kwargs.items())}" if kwargs else ""
        raise ValueError(f"environment {identifier!r}{said} is no finite MDP: {error}") from None
    finally:
        env.close()
