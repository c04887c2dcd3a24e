"""A continuous simulator with the configuration by which logs are evaluated in it: ``ContinuousSimulator``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._arguments import own_modules, own_object
from oee_tabular._checks import Array
from oee_tabular.continuous.actions import as_probabilities
from oee_tabular.continuous.discretization import Discretization, VisitedCells, discretize
from oee_tabular.continuous.episodes import record
from oee_tabular.continuous.log import ContinuousTransitions
from oee_tabular.continuous.task import ContinuousTask, StatePolicy

SLOW_EPISODES, SLOW_PATHS, SLOW_REFITS, SLOW_CLOSURE = 2000, 200, 10, 500  # of tasks that step one state at a time


@dataclass(frozen=True)
class ContinuousSimulator:
    """A continuous task with the settings by which logs are evaluated in it.

    Attributes
    ----------
    name : str, as it was given
    task : ContinuousTask
    expert : function of states (n, d) giving probabilities (n, A); None where there is none
    horizon : of an episode and of a value, where none is given
    floor : share of the defensive simulator's other steps, where a log is evaluated on cells
    ratio : options of ``transition_ratio`` for the counts on cells
    calibration : "ratio" | "difference" | "none"; see ``estimators.calibrate``
    policies : those whose states the cells must serve
    episodes : of Monte Carlo, for each policy
    refits, refit_paths : of a corrected simulator, and the episodes by which each is compared with it

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
    horizon: int
    floor: float = 0.0
    ratio: Mapping[str, Any] = field(default_factory=dict)
    calibration: str = "ratio"
    policies: tuple[StatePolicy, ...] = ()
    episodes: int = 50_000
    refit_paths: int = 1000
    refits: int = 20

    def policy(self, spec: str, name: str = "policy") -> StatePolicy:
        """``uniform``; ``expert``; ``mix:0.7``, the expert with that probability, else uniform; or ``module:function``.

        The function takes states (n, d) and gives probabilities (n, A), action numbers (n,) or commands (n, k); see
        ``actions.as_probabilities``.
        """
        expert = self.expert
        if spec == "uniform":
            return _mix(None, 0.0, self.task.n_actions)
        if expert is not None and spec == "expert":
            return expert
        if expert is not None and spec.startswith("mix:"):
            try:
                weight = float(spec.removeprefix("mix:"))
            except ValueError:
                raise ValueError(f"{name} must be like mix:0.5; got {_checks.show(spec)}") from None
            weight = _checks.number_in(weight, f"the weight of {name} {spec!r}", 0.0, 1.0)
            return _mix(expert, weight, self.task.n_actions)
        if ":" not in spec or spec.startswith("mix:"):
            own = "uniform" if expert is None else "uniform, expert, mix:WEIGHT"
            raise ValueError(
                f"{name} of {self.task.name} must be {own} or MODULE:FUNCTION of states; got {_checks.show(spec)}"
            )
        with own_modules():
            return as_probabilities(own_object(spec, name, "my_module:policy"), self.task.actions)

    def discretize(
        self,
        log: ContinuousTransitions | None = None,
        *,
        cells: Any = None,
        floor: float = 0.0,
        discount: float = 0.99,
    ) -> Discretization:
        """The finite MDP of the task, plain or defensive, looked at where the log was; see ``tasks.discretize``."""
        chosen = self.task.default_cells if cells is None else cells
        if isinstance(chosen, int):
            chosen = VisitedCells(chosen, max_steps=self.horizon)
        return discretize(
            self.task, log, cells=chosen, floor=floor, policies=self.policies, discount=discount,
            closure_episodes=2000 if self.task.steps_at_once else SLOW_CLOSURE,
        )  # fmt: skip

    def record(self, policy: StatePolicy, *, max_steps: int | None = None, **options: Any) -> ContinuousTransitions:
        """A log of the simulator; ``n_transitions`` or ``n_episodes``, and ``seed``, as in ``tasks.record``."""
        return record(self.task, policy, max_steps=self.horizon if max_steps is None else max_steps, **options)


def as_simulator(task: ContinuousTask, horizon: int | None) -> ContinuousSimulator:
    """A task as a simulator, configured as a Gymnasium environment is; ``horizon`` of its episodes."""
    if horizon is None:
        raise ValueError(f"horizon must be given for {task.name}, which has no time limit of its own; it is None")
    slow, ratio = not task.steps_at_once, {"prior": "simulator", "strength": 0.01}
    return ContinuousSimulator(
        task.name, task, None, horizon, floor=1e-3, ratio=ratio, calibration="difference",
        episodes=SLOW_EPISODES if slow else 50_000, refit_paths=SLOW_PATHS if slow else 1000,
        refits=SLOW_REFITS if slow else 20,
    )  # fmt: skip


def _mix(expert: StatePolicy | None, weight: float, n_actions: int) -> StatePolicy:
    """The expert with probability ``weight``, else uniform."""

    def policy(states: Array) -> Array:
        uniform = np.full((len(states), n_actions), (1.0 - weight) / n_actions)
        return uniform if expert is None else weight * np.asarray(expert(states), dtype=np.float64) + uniform

    return policy


@dataclass(frozen=True)
class Settings:
    """How a continuous log is evaluated; what is None is the simulator's own.

    Attributes
    ----------
    grid : None: no rows on cells; "auto": on the task's own; vertices along each feature; or a number of visited cells
    outside : "error" | "nearest" | "drop", for states outside the grid; "drop" leaves out transitions without support as
        well, however many (otherwise more than a hundredth leave out the rows on the grid)
    strict : an error, not a warning, for actions that are not in the task's set
    calibration : "ratio" | "difference" | "none"
    floor : defensive share, in [0, 1]
    episodes : of Monte Carlo, for each policy in the continuous simulator

    Examples
    --------
    >>> Settings(grid=(60, 60)).outside
    'error'
    """

    grid: tuple[int, ...] | int | str | None = None
    outside: str = "error"
    strict: bool = False
    calibration: str | None = None
    floor: float | None = None
    episodes: int | None = None
