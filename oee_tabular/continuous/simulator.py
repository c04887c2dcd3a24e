"""A continuous simulator with the configuration by which logs are evaluated in it: ``ContinuousSimulator``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._arguments import own_modules, own_object
from oee_tabular._checks import Array, IntArray
from oee_tabular.continuous.actions import as_probabilities
from oee_tabular.continuous.discretization import Discretization
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.interpolation import GridInterpolation
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.support import USUAL, reach_of
from oee_tabular.continuous.task import ContinuousTask, StatePolicy

SLOW_EPISODES, SLOW_PATHS = 2000, 200  # of tasks that step one state at a time
DEFAULT_VERTICES = {1: 201, 2: 41, 3: 15, 4: 9}  # along each feature, by how many there are
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
    expert : function of states (n, d) giving probabilities (n, A); None where there is none
    cells : the shape of the default grid, or what makes a Discretization on other cells; see ``Builder``; () for no cells
    horizon : of an episode and of a value, where none is given
    floor : share of the defensive simulator's other steps, where a log is evaluated
    ratio : options of ``transition_ratio`` for the counts
    tie : the ties of zeta, a function of the Discretization; None: not tied
    calibration : "ratio" | "difference" | "none"; see ``estimators.calibrate``
    count : (model, log, outside) -> csr of counts (S*A, S); None: ``model.counts``
    defence : which other steps those are, in words
    episodes : of Monte Carlo, for each policy
    refit_paths : episodes by which each refit of a corrected simulator is compared with it
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
    expert: StatePolicy | None
    cells: tuple[int, ...] | Builder
    horizon: int
    floor: float = 0.0
    ratio: Mapping[str, Any] = field(default_factory=dict)
    tie: Callable[[Discretization], IntArray] | None = None
    calibration: str = "ratio"
    count: Counter | None = None
    defence: str = "a step ends anywhere near"
    episodes: int = 50_000
    refit_paths: int = 1000
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
        """``uniform``; ``expert``; ``mix:0.7``, the expert with that probability, else uniform; or ``module:function``.

        The function takes states (n, d) and gives probabilities (n, A), action numbers (n,) or commands (n, k); see
        ``actions.as_probabilities``.
        """
        if spec == "uniform":
            n = self.task.n_actions
            return lambda states: np.full((len(states), n), 1.0 / n)
        own = "uniform, expert, mix:WEIGHT" if self.expert is not None else "uniform"
        if self.expert is not None and spec == "expert":
            return self.expert
        if self.expert is not None and spec.startswith("mix:"):
            return _mixed(self.expert, _weight(spec, name))
        if ":" not in spec or spec.startswith("mix:"):
            raise ValueError(
                f"{name} of {self.task.name} must be {own} or MODULE:FUNCTION of states; got {_checks.show(spec)}"
            )
        with own_modules():
            return as_probabilities(own_object(spec, name, "my_module:policy"), self.task.actions)

    def has_cells(self, grid: tuple[int, ...] | None) -> bool:
        """Whether there are cells: the default ones, or a ``grid`` that was asked for."""
        return (self.cells if grid is None else grid) != ()

    def no_cells(self, grid: tuple[int, ...] | None) -> str:
        """Why there are none, where there are none."""
        if grid is not None:
            return "no grid was asked for"
        return (
            f"there is no grid in the {len(self.task.feature_names)} dimensions of {self.task.name}; the corrected simulator "
            "needs none"
        )

    def build(
        self,
        *,
        grid: tuple[int, ...] | None = None,
        at: ContinuousTransitions | None = None,
        floor: float = 0.0,
        discount: float = 0.99,
        reach: int = USUAL,
    ) -> Discretization:
        """The finite MDP: on the default cells or a grid of that shape, plain or defensive, looked at where the log was.

        ``reach`` of the floor, on a grid; see ``GridInterpolation``.
        """
        self._take(grid)
        if not self.has_cells(grid):
            raise ValueError(f"cells must be given: {self.no_cells(grid)}")
        cells = self.cells if grid is None else grid
        if not isinstance(cells, tuple):
            return cells(self.task, at=at, floor=floor, discount=discount)
        return GridInterpolation(cells, floor=floor, reach=reach).build(self.task, at=at, discount=discount)

    def _take(self, grid: tuple[int, ...] | None) -> None:
        if grid is not None and self.no_grid:
            raise ValueError(f"grid must be left out for {self.no_grid}")

    def reach(self, grid: tuple[int, ...] | None, log: ContinuousTransitions) -> int:
        """The reach that the log asks of a floor on the grid."""
        self._take(grid)
        cells = self.cells if grid is None else grid
        return reach_of(self.task, GridInterpolation(cells).grid(self.task), log) if isinstance(cells, tuple) else USUAL

    def record(self, policy: StatePolicy, *, max_steps: int | None = None, **options: Any) -> ContinuousTransitions:
        """A log of the simulator; ``n_transitions`` or ``n_episodes``, and ``seed``, as in ``tasks.record``."""
        return record(self.task, policy, max_steps=self.horizon if max_steps is None else max_steps, **options)


def default_grid(dimensions: int) -> tuple[int, ...]:
    """Vertices along each feature of a task without a grid of its own; () where a grid would be too coarse."""
    return (DEFAULT_VERTICES[dimensions],) * dimensions if dimensions in DEFAULT_VERTICES else ()


def as_simulator(task: ContinuousTask, horizon: int | None) -> ContinuousSimulator:
    """A task as a simulator, configured as a Gymnasium environment is; ``horizon`` of its episodes."""
    if horizon is None:
        raise ValueError(f"horizon must be given for {task.name}, which has no time limit of its own; it is None")
    slow = not task.steps_at_once
    return ContinuousSimulator(
        task.name,
        task,
        None,
        default_grid(len(task.feature_names)),
        horizon,
        floor=1e-3,
        ratio={"prior": "simulator", "strength": 0.01},
        calibration="difference",
        episodes=SLOW_EPISODES if slow else 50_000,
        refit_paths=SLOW_PATHS if slow else 1000,
    )


def _weight(spec: str, name: str) -> float:
    try:
        weight = float(spec.removeprefix("mix:"))
    except ValueError:
        raise ValueError(f"{name} must be like mix:0.5; got {_checks.show(spec)}") from None
    return _checks.number_in(weight, f"the weight of {name} {spec!r}", 0.0, 1.0)


def _mixed(expert: StatePolicy, weight: float) -> StatePolicy:
    def policy(states: Array) -> Array:
        found = np.asarray(expert(states), dtype=np.float64)
        return np.asarray(weight * found + (1.0 - weight) / found.shape[1])

    return policy


@dataclass(frozen=True)
class Settings:
    """How a continuous log is evaluated; what is None is the simulator's own.

    Attributes
    ----------
    grid : vertices along each feature; () for no cells
    outside : "error" | "nearest" | "drop", for states outside the grid; "drop" leaves out moves without support as well,
        however many (otherwise more than a hundredth leave out the rows on the grid)
    strict : an error, not a warning, for actions that are not in the task's set
    calibration : "ratio" | "difference" | "none"
    floor : defensive share, in [0, 1]
    episodes : of Monte Carlo, for each policy in the continuous simulator

    Examples
    --------
    >>> Settings(grid=(60, 60)).outside
    'error'
    """

    grid: tuple[int, ...] | None = None
    outside: str = "error"
    strict: bool = False
    calibration: str | None = None
    floor: float | None = None
    episodes: int | None = None
