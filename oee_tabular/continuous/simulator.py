"""A continuous simulator with the configuration by which logs are evaluated in it: ``ContinuousSimulator``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.interpolation import GridInterpolation
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy

Counter = Callable[[Discretization, ContinuousTransitions, str], sparse.csr_array]


class Builder(Protocol):
    """Makes the finite MDP on a task's own cells; ``floor`` is the defensive share (0: the plain simulator)."""

    def __call__(self, task: Any, *, at: ContinuousTransitions | None, floor: float, discount: float) -> Discretization:
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
    cells : the shape of the default grid, or what makes a Discretization on other cells; see ``Builder``
    horizon : of an episode and of a value, where none is given
    floor : share of the defensive simulator's other steps, where a log is evaluated; ``defence`` says which steps those are
    ratio : options of ``transition_ratio`` for the counts
    tie : the ties of zeta, a function of the Discretization; None: not tied
    calibration : "ratio" | "difference" | "none"; see ``estimators.calibrate``
    count : (model, log, outside) -> csr of counts (S*A, S); None: ``model.counts``
    episodes : of Monte Carlo, for each policy
    at_log : whether the builder looks at the simulator in the log's own places
    cells_of_log : whether the cells are made of the log, so that no array of a policy can be known before
    no_grid : why no other grid can be asked for; empty where it can

    Examples
    --------
    >>> from oee_tabular.continuous.names import continuous_simulator
    >>> simulator = continuous_simulator("cartpole:gravity=10")
    >>> simulator.task.gravity, simulator.horizon, simulator.policy("mix:0.5")(np.zeros((1, 4))).round(2).tolist()
    (10, 100, [[0.52, 0.48]])
    """

    name: str
    task: ContinuousTask
    expert: StatePolicy
    cells: tuple[int, ...] | Builder
    horizon: int
    floor: float = 0.0
    ratio: Mapping[str, Any] = field(default_factory=dict)
    tie: Callable[[Discretization], IntArray] | None = None
    calibration: str = "ratio"
    count: Counter | None = None
    defence: str = "a step ends anywhere near"
    episodes: int = 50_000
    at_log: bool = True
    cells_of_log: bool = False
    no_grid: str = ""

    def counts(self, model: Discretization, log: ContinuousTransitions, *, outside: str = "error") -> sparse.csr_array:
        """The log's moves on the cells of ``model``."""
        if self.count is None:
            return model.counts(log, outside=outside)
        return self.count(model, log, outside)

    def ratio_options(self, model: Discretization) -> dict[str, Any]:
        """Those of ``transition_ratio`` on the cells of ``model``."""
        return dict(self.ratio) if self.tie is None else {"tie": self.tie(model), **self.ratio}

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
        if grid is not None and self.no_grid:
            raise ValueError(f"grid must be left out for {self.no_grid}")
        cells = self.cells if grid is None else grid
        if not isinstance(cells, tuple):
            return cells(self.task, at=at, floor=floor, discount=discount)
        return GridInterpolation(cells, floor=floor).build(self.task, at=at, discount=discount)

    def record(self, policy: StatePolicy, *, max_steps: int | None = None, **options: Any) -> ContinuousTransitions:
        """A log of the simulator; ``n_transitions`` or ``n_episodes``, and ``seed``, as in ``tasks.record``."""
        return record(self.task, policy, max_steps=self.horizon if max_steps is None else max_steps, **options)


def _mixed(expert: StatePolicy, weight: float) -> StatePolicy:
    def policy(states: Array) -> Array:
        found = np.asarray(expert(states), dtype=np.float64)
        return np.asarray(weight * found + (1.0 - weight) / found.shape[1])

    return policy
