"""Continuous simulators by name, ``cartpole:gravity=10``, each with the configuration that logs are evaluated by.

A task is one line in ``CONTINUOUS``: its name, and a function that makes a ``ContinuousSimulator`` of the arguments.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.data import ContinuousTransitions
from oee_tabular.tasks.cartpole import CartPole, cartpole_policy
from oee_tabular.tasks.continuous import ContinuousTask, StatePolicy
from oee_tabular.tasks.continuous_sampling import record
from oee_tabular.tasks.discretize import Discretization
from oee_tabular.tasks.discretize_cells import VisitedCells, visited_states
from oee_tabular.tasks.discretize_grid import GridInterpolation
from oee_tabular.tasks.named_arguments import arguments


class Builder(Protocol):
    """Makes the finite MDP: ``grid`` None for the task's default, ``floor`` the defensive share (0: the plain simulator)."""

    def __call__(
        self,
        task: Any,
        *,
        grid: tuple[int, ...] | None,
        at: ContinuousTransitions | None,
        floor: float,
        discount: float,
    ) -> Discretization:
        """The task on its cells, looked at in the log's own places where ``at`` is given."""
        ...


@dataclass(frozen=True)
class ContinuousSimulator:
    """A continuous simulator that was named, and how it is evaluated.

    Attributes
    ----------
    name : str, as it was given
    task : ContinuousTask
    expert : function of states (n, d) giving probabilities (n, A)
    builder : makes a Discretization; see ``Builder``
    horizon : of an episode and of a value, where none is given
    floor : share of a step that may end anywhere near (a defensive simulator), where a log is evaluated
    ratio : options of ``transition_ratio`` for soft counts
    calibration : "ratio" | "difference"; see ``estimators.calibrate``

    Examples
    --------
    >>> simulator = continuous_simulator("cartpole:gravity=10")
    >>> simulator.task.gravity, simulator.horizon, simulator.policy("mix:0.5")(np.zeros((1, 4))).round(2).tolist()
    (10, 100, [[0.52, 0.48]])
    """

    name: str
    task: ContinuousTask
    expert: StatePolicy
    builder: Builder
    horizon: int
    floor: float = 0.0
    ratio: Mapping[str, Any] = field(default_factory=dict)
    calibration: str = "ratio"

    def policy(self, spec: str, name: str = "policy") -> StatePolicy:
        """``uniform``, ``expert``, or ``mix:0.7``: the expert with that probability, else uniform."""
        if spec == "uniform":
            return _mixed(self.expert, 0.0)
        if spec == "expert":
            return self.expert
        if not spec.startswith("mix:"):
            raise ValueError(f"{name} of {self.task.name} must be uniform, expert or mix:WEIGHT; got {spec!r}")
        try:
            weight = float(spec.removeprefix("mix:"))
        except ValueError:
            raise ValueError(f"{name} must be like mix:0.5; got {spec!r}") from None
        return _mixed(self.expert, _checks.number_in(weight, f"the weight of {name} {spec!r}", 0.0, 1.0))

    def build(
        self,
        *,
        grid: tuple[int, ...] | None = None,
        at: ContinuousTransitions | None = None,
        floor: float = 0.0,
        discount: float = 0.99,
    ) -> Discretization:
        """The finite MDP: on the default cells or a grid of that shape, plain or defensive, looked at where the log was."""
        return self.builder(self.task, grid=grid, at=at, floor=floor, discount=discount)

    def record(self, policy: StatePolicy, *, max_steps: int | None = None, **options: Any) -> ContinuousTransitions:
        """A log of the simulator; ``n_transitions`` or ``n_episodes``, and ``seed``, as in ``tasks.record``."""
        return record(self.task, policy, max_steps=self.horizon if max_steps is None else max_steps, **options)


def _mixed(expert: StatePolicy, weight: float) -> StatePolicy:
    def policy(states: Array) -> Array:
        found = np.asarray(expert(states), dtype=np.float64)
        return np.asarray(weight * found + (1.0 - weight) / found.shape[1])

    return policy


def on_grid(default: tuple[int, ...], **options: Any) -> Builder:
    """A builder by ``GridInterpolation(shape, **options)``."""

    def build(
        task: Any, *, grid: tuple[int, ...] | None, at: ContinuousTransitions | None, floor: float, discount: float
    ) -> Discretization:
        shape = default if grid is None else grid
        return GridInterpolation(shape, floor=floor, **options).build(task, at=at, discount=discount)

    return build


def cartpole(**parameters: Any) -> ContinuousSimulator:
    """CartPole under a gravity, by the configuration of tests/studies/cartpole_check.py.

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
    from dataclasses import replace

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
