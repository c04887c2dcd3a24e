"""Continuous simulators by name, ``cartpole:gravity=10``, each with the configuration that logs are evaluated by.

A task is one line in ``CONTINUOUS``: its name, and a function that makes a ``ContinuousSimulator`` of the arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace

from oee_tabular.continuous.cartpole import cartpole
from oee_tabular.continuous.kinova import kinova
from oee_tabular.continuous.reacher import reacher
from oee_tabular.continuous.simulator import ContinuousSimulator
from oee_tabular.tasks.arguments import arguments

CONTINUOUS: Mapping[str, Callable[..., ContinuousSimulator]] = {
    "cartpole": cartpole,
    "reacher": reacher,
    "kinova": kinova,
}


def continuous_simulator(spec: str) -> ContinuousSimulator:
    """The continuous simulator that ``spec`` names, ``NAME`` or ``NAME:key=value,...``.

    Parameters
    ----------
    spec : a name in ``CONTINUOUS``, and parameters of its task

    Raises
    ------
    ValueError
        An unknown name, arguments that the task does not take, or values that it refuses.

    Examples
    --------
    >>> continuous_simulator("cartpole:gravity=15,noise=0").task.parameters()
    {'gravity': 15, 'noise': 0, 'form': 'angle'}
    """
    name, _, rest = spec.partition(":")
    if name not in CONTINUOUS:
        raise ValueError(f"spec must begin with one of {', '.join(CONTINUOUS)}; got {spec!r}")
    positional, keywords = arguments(rest)
    if positional:
        raise ValueError(f"simulator {spec!r} must give its arguments as key=value; found {positional[0]!r}")
    make = CONTINUOUS[name]
    try:
        inspect.signature(make).bind(**keywords)
        found = make(**keywords)
    except TypeError as error:
        raise ValueError(f"simulator {spec!r} does not take these arguments: {error}") from None
    return replace(found, name=spec)
