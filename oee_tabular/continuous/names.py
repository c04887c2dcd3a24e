"""Continuous simulators by name, ``cartpole:gravity=10``, each with the configuration that logs are evaluated by.

Gymnasium's environments are named by their ids, ``Pendulum-v1:g=9`` (``gymnasium_named``). A task of ours is one
line in ``CONTINUOUS``: its name, and a function that makes a ``ContinuousSimulator`` of the arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace

from oee_tabular._arguments import parse_spec
from oee_tabular.continuous.cartpole import cartpole
from oee_tabular.continuous.gymnasium_named import gymnasium_simulator, is_continuous_id
from oee_tabular.continuous.kinova import kinova
from oee_tabular.continuous.reacher import reacher
from oee_tabular.continuous.simulator import ContinuousSimulator

CONTINUOUS: Mapping[str, Callable[..., ContinuousSimulator]] = {
    "cartpole": cartpole,
    "reacher": reacher,
    "kinova": kinova,
}


def is_continuous(spec: str) -> bool:
    """Whether ``spec`` names a continuous task."""
    return spec.partition(":")[0] in CONTINUOUS or is_continuous_id(spec)


def continuous_simulator(spec: str, *, state: str | None = None, actions: object = None) -> ContinuousSimulator:
    """The continuous simulator that ``spec`` names, ``NAME`` or ``NAME:key=value,...``.

    Parameters
    ----------
    spec : a name in ``CONTINUOUS`` or the id of a Gymnasium environment, and parameters of its task
    state, actions : of a Gymnasium environment; see ``gymnasium_simulator``

    Raises
    ------
    ValueError
        An unknown name, arguments that the task does not take, or values that it refuses.

    Examples
    --------
    >>> continuous_simulator("cartpole:gravity=15,noise=0").task.parameters()
    {'gravity': 15, 'noise': 0, 'form': 'angle'}
    """
    name = spec.partition(":")[0]
    if name not in CONTINUOUS:
        if not is_continuous_id(spec):
            raise ValueError(
                f"spec must begin with one of {', '.join(CONTINUOUS)}, or with a Gymnasium id whose states are no numbers; "
                f"got {spec!r}"
            )
        return gymnasium_simulator(spec, state=state, actions=actions)
    for option, given in (("state", state), ("actions", actions)):
        if given is not None:
            raise ValueError(
                f"--task-option {option} must be left out for {name}, which is no Gymnasium environment; it is {given!r}"
            )
    _, keywords = parse_spec(spec)
    make = CONTINUOUS[name]
    try:
        inspect.signature(make).bind(**keywords)
        found = make(**keywords)
    except TypeError as error:
        raise ValueError(f"simulator {spec!r} does not take these arguments: {error}") from None
    return replace(found, name=spec)
