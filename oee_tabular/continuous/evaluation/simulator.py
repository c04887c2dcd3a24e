"""Continuous simulators with the configuration by which logs are evaluated in them.

The task of a ``ContinuousSimulator`` has finitely many actions; which of a Gymnasium
action space, ``gymnasium_named.action_set`` chooses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np

from oee_tabular import _checks
from oee_tabular._arguments import own_modules, own_object
from oee_tabular._keywords import suggest_keywords
from oee_tabular._results import checked
from oee_tabular.continuous.discretization.build import (
    CellsLike,
    VisitedCells,
    discretize,
)
from oee_tabular.continuous.discretization.model import (
    Discretization,
    Outside,
    uniform_policy_of,
)
from oee_tabular.continuous.evaluation.policies import as_probabilities
from oee_tabular.continuous.log.transitions import ContinuousTransitions
from oee_tabular.continuous.task.base import (
    ContinuousTask,
    StatePolicy,
)
from oee_tabular.continuous.task.episodes import record
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, Seed

# vertices along each feature, a number of visited cells, or the task's own
GridLike: TypeAlias = tuple[int, ...] | int | Literal["auto"]
Calibration: TypeAlias = Literal["ratio", "difference", "none"]


class Speed(TypedDict):
    """The settings of a simulator that decide how long an evaluation takes."""

    episodes: int
    refit_paths: int
    refits: int


# the settings of tasks that step one state at a time
SLOW: Speed = {"episodes": 2000, "refit_paths": 200, "refits": 10}


@suggest_keywords
@checked(positive=("horizon",))
@dataclass(frozen=True)
class ContinuousSimulator:
    """A continuous task with the settings by which logs are evaluated in it.

    Parameters
    ----------
    name : str
        The name, as it was given.
    task : ContinuousTask
        The task.
    expert : function or None
        The expert: of states (n, d) it gives probabilities (n, A). None where there is
        none.
    horizon : int
        The number of steps of an episode, and of rewards of a value, where none is
        given.
    floor : float, default 0.0
        The share of the defensive simulator's other steps, where a log is evaluated on
        cells.
    ratio : mapping, optional
        The options of ``transition_ratio`` for the counts on cells.
    calibration : {'ratio', 'difference', 'none'}, default 'ratio'
        How values on cells are calibrated; see ``estimators.calibrate``.
    policies : tuple of functions, default ()
        The policies whose states the cells must serve.
    episodes : int, default 50000
        The number of Monte Carlo episodes for each policy.
    refit_paths : int, default 1000
        The number of episodes by which each refit is compared with the corrected
        simulator.
    refits : int, default 20
        The number of refits of a corrected simulator.

    See Also
    --------
    gymnasium_simulator : Make one of a Gymnasium environment.

    Examples
    --------
    >>> from oee_tabular.continuous.command import continuous_simulator
    >>> simulator = continuous_simulator("cartpole:gravity=10")
    >>> (
    ...     simulator.task.gravity,
    ...     simulator.horizon,
    ...     simulator.policy("mix:0.5")(np.zeros((1, 4))).round(2).tolist(),
    ... )
    (10, 100, [[0.52, 0.48]])
    """

    name: str
    task: ContinuousTask
    expert: StatePolicy | None
    horizon: int
    floor: float = 0.0
    ratio: Mapping[str, Any] = field(default_factory=dict)
    calibration: Calibration = "ratio"
    policies: tuple[StatePolicy, ...] = ()
    episodes: int = 50_000
    refit_paths: int = 1000
    refits: int = 20

    def policy(self, spec: str, name: str = "policy") -> StatePolicy:
        """Return the policy that a specification names.

        Parameters
        ----------
        spec : str
            ``uniform``; ``expert``; ``mix:0.7``, the expert with that probability, else
            uniform; or ``module:function``.
        name : str, default 'policy'
            The name of the argument in errors.

        Returns
        -------
        function
            The policy: of states (n, d) it gives probabilities (n, A).

        Raises
        ------
        ValueError
            If the specification names no policy of the task.

        Notes
        -----
        A function of one's own takes states (n, d) and gives probabilities (n, A),
        action numbers (n,) of actions that are numbers, or commands (n, k) of actions
        that are commands; see ``as_probabilities``.
        """
        expert = self.expert
        if spec == "uniform":
            return uniform_policy_of(self.task)
        if expert is not None and spec == "expert":
            return expert
        if expert is not None and spec.startswith("mix:"):
            try:
                weight = float(spec.removeprefix("mix:"))
            except ValueError:
                raise ArgumentError(
                    name, f"must be like mix:0.5; got {_checks.show(spec)}"
                ) from None
            _checks.number_in(weight, f"the weight of {name} {spec!r}", 0.0, 1.0)
            uniform = (1.0 - weight) / self.task.n_actions

            def mixed(states: Array) -> Array:
                """Return the expert's probabilities, mixed with the uniform ones."""
                own = np.asarray(expert(states), dtype=np.float64)
                return weight * own + uniform

            return mixed
        if ":" not in spec or spec.startswith("mix:"):
            own = "uniform" if expert is None else "uniform, expert, mix:WEIGHT"
            raise ArgumentError(
                f"{name} of {self.task.name}",
                f"must be {own} or MODULE:FUNCTION of states; got {_checks.show(spec)}",
            )
        with own_modules():
            function = own_object(spec, name, "my_module:policy")
            return as_probabilities(function, self.task.actions)

    def discretize(
        self,
        log: ContinuousTransitions | None = None,
        *,
        cells: CellsLike | None = None,
        floor: float = 0.0,
        others: Sequence[ContinuousTask] | None = None,
        discount: float = 0.99,
        seed: Seed = 0,
    ) -> Discretization:
        """Make the finite MDP of the task, looked at where the log was.

        Parameters
        ----------
        log : ContinuousTransitions, optional
            A log of the target, at whose states and actions the task is stepped.
        cells : int, tuple of int or a form of ``tasks.discretize``, optional
            Where the states lie; by default the task's own.
        floor : float, default 0.0
            The share of the defensive simulator's other steps, in [0, 1].
        others : sequence of ContinuousTask, optional
            The task under other parameters, as in ``tasks.discretize``.
        discount : float, default 0.99
            The discount of the MDP, in [0, 1].
        seed : int, Generator or SeedSequence, optional
            The source of visited states and random disturbances, by default 0.

        Returns
        -------
        Discretization
            The finite MDP with its encoding.

        See Also
        --------
        discretize : The function that it calls.
        """
        chosen = self.task.default_cells if cells is None else cells
        if isinstance(chosen, int):
            chosen = VisitedCells(chosen, max_steps=self.horizon)
        return discretize(
            self.task,
            log,
            cells=chosen,
            floor=floor,
            others=others,
            policies=self.policies,
            discount=discount,
            closure_episodes=2000 if self.task.steps_at_once else 500,
            seed=seed,
        )

    def record(
        self,
        policy: StatePolicy,
        *,
        max_steps: int | None = None,
        n_transitions: int | None = None,
        n_episodes: int | None = None,
        seed: Seed = None,
    ) -> ContinuousTransitions:
        """Record a log of the simulator.

        Parameters
        ----------
        policy : function
            The policy: of states (n, d) it gives probabilities (n, A).
        max_steps : int, optional
            The number of steps after which episodes are truncated; by default the
            horizon.
        n_transitions : int, optional
            The number of transitions. Exactly one of ``n_transitions`` and
            ``n_episodes`` is given.
        n_episodes : int, optional
            The number of episodes.
        seed : int, Generator or SeedSequence, optional
            The source of random numbers. The same seed gives the same bits.

        Returns
        -------
        ContinuousTransitions
            The log.

        See Also
        --------
        record : The function that it calls.
        """
        return record(
            self.task,
            policy,
            n_transitions=n_transitions,
            n_episodes=n_episodes,
            max_steps=self.horizon if max_steps is None else max_steps,
            seed=seed,
        )


def as_simulator(task: ContinuousTask, horizon: int | None) -> ContinuousSimulator:
    """Return a task as a simulator, configured as a Gymnasium environment is.

    ``horizon`` is that of its episodes.
    """
    if horizon is None:
        raise ArgumentError(
            "horizon",
            f"must be given for {task.name}, which has no time limit of its own; it is"
            " None",
        )
    simulator = ContinuousSimulator(
        name=task.name,
        task=task,
        expert=None,
        horizon=horizon,
        floor=1e-3,
        ratio={"prior": "simulator", "strength": 0.01},
        calibration="difference",
    )
    return simulator if task.steps_at_once else replace(simulator, **SLOW)


@suggest_keywords
@checked()
@dataclass(frozen=True)
class Settings:
    """How a continuous log is evaluated; what is None is the simulator's own.

    Parameters
    ----------
    grid : int, tuple of int or 'auto', optional
        The cells of the rows on a finite MDP: the number of vertices along each
        feature, a number of visited cells, or 'auto' for the task's own. None means no
        such rows.
    outside : {'error', 'nearest', 'drop'}, default 'error'
        What is done with states outside the grid. 'drop' leaves out transitions without
        support as well, however many; otherwise more than a hundredth of them leave out
        the rows on the grid.
    strict : bool, default False
        Whether actions that are not in the task's set are an error, not a warning.
    calibration : {'ratio', 'difference', 'none'}, optional
        How the values on cells are calibrated.
    floor : float, optional
        The defensive share, in [0, 1].
    episodes : int, optional
        The number of Monte Carlo episodes for each policy in the continuous simulator.

    Examples
    --------
    >>> Settings(grid=(60, 60)).outside
    'error'
    """

    grid: GridLike | None = None
    outside: Outside = "error"
    strict: bool = False
    calibration: Calibration | None = None
    floor: float | None = None
    episodes: int | None = None
