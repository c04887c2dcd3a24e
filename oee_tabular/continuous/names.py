"""Continuous simulators by name, ``cartpole:gravity=10``, each with the configuration that logs are evaluated by.

A task is one line in ``CONTINUOUS``: its name, and a function that makes a ``ContinuousSimulator`` of the arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from oee_tabular.continuous.cartpole.dynamics import CartPole, cartpole_policy
from oee_tabular.continuous.cells import VisitedCells, visited_states
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.names_arms import kinova, reacher
from oee_tabular.continuous.simulator import ContinuousSimulator, on_grid
from oee_tabular.tasks.arguments import arguments


def cartpole(**parameters: Any) -> ContinuousSimulator:
    """CartPole under a gravity, by the configuration that ``oee reproduce fig2`` uses for every target.

    (theta, theta') on 32 x 32 vertices, looked at in the log's own places, floor 0.001, zeta from soft counts with prior
    "simulator" and strength 0.01, calibrated by the ratio. For the targets 7.5, 12.5 and 15 and the simulator 10 the mean error
    of (1 - discount) J was .0005 to .0009 at 80 000 moves and .0004 to .0012 at 10 000; the simulator's is .009 to .019. The
    whole state (``form=full``) has 1000 cells of states that the simulator visits.
    """
    task = CartPole(**parameters)
    whole = task.form == "full"
    return ContinuousSimulator(
        "cartpole",
        task,
        cartpole_policy(0.0),
        _cartpole_cells if whole else on_grid((32, 32)),
        horizon=100,
        floor=1e-3,
        ratio={"prior": "simulator", "strength": 1.0 if whole else 0.01},
    )


def _cartpole_cells(
    task: Any, *, grid: tuple[int, ...] | None, at: ContinuousTransitions | None, floor: float, discount: float
) -> Discretization:
    """The whole state: cells of visited states, or a grid where one is asked for."""
    if grid is not None:
        return on_grid(grid)(task, grid=None, at=at, floor=floor, discount=discount)
    builder = VisitedCells(1000, floor=floor, neighbours=200)
    policies = [cartpole_policy(delta) for delta in (0.0, 0.3, 0.6, 1.0)]
    visited = visited_states([task], policies, 200_000, max_steps=100, seed=0)
    base = builder.build(task, visited, discount=discount)
    if at is None:
        return base
    places = np.concatenate([at.state, base.cells.centres])  # type: ignore[attr-defined]
    return builder.build(task, places, cells=base.cells, discount=discount)  # type: ignore[arg-type]


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
