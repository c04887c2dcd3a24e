"""Tasks: what problems are made from.

Finite ones are the paper's gridworld, a recycling robot, bus engines (real data; Rust,
1987) and Gymnasium's toy text. Continuous ones, their corrections by a log and their
cells come from the wing ``oee_tabular.continuous`` on use; this is their only public
place. What evaluates them (``evaluate_continuous``, with its settings) is in
``oee_tabular.report``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from oee_tabular.tasks.buses import BusEngines, bus_engines
from oee_tabular.tasks.gridworld import (
    Embedded,
    embedded_default,
    gridworld,
    gridworld_expert,
    gridworld_policy,
)
from oee_tabular.tasks.recycling_robot import recycling_robot
from oee_tabular.tasks.specs import FINITE as FINITE
from oee_tabular.tasks.specs import MDP_ENDINGS as MDP_ENDINGS
from oee_tabular.tasks.specs import NamedTask, named_task
from oee_tabular.tasks.toy_text import make_environment, record_episodes, toy_text

if TYPE_CHECKING:  # continuous tasks are imported on use
    from oee_tabular.continuous import (
        CartPole,
        ContinuousTask,
        Discretization,
        GridInterpolation,
        GymnasiumTask,
        HistoryTask,
        KinovaArm,
        KinovaHand,
        LinearModel,
        MonteCarlo,
        Moves,
        ParameterFit,
        Reacher,
        ResidualSimulator,
        StatePolicy,
        VisitedCells,
        cartpole_policy,
        corrected_value,
        discretize,
        fit_hand,
        fit_parameters,
        gymnasium_simulator,
        hand_log,
        kinova_policy,
        load_kinova_log,
        monte_carlo_value,
        reacher_log,
        reacher_policy,
        record,
        record_goals,
        resimulate,
        train_expert,
        visited_states,
    )


# what users find here; what is imported above "as" itself is for other rooms alone
__all__ = [
    "BusEngines",
    "CartPole",
    "ContinuousTask",
    "Discretization",
    "Embedded",
    "GridInterpolation",
    "GymnasiumTask",
    "HistoryTask",
    "KinovaArm",
    "KinovaHand",
    "LinearModel",
    "MonteCarlo",
    "Moves",
    "NamedTask",
    "ParameterFit",
    "Reacher",
    "ResidualSimulator",
    "StatePolicy",
    "VisitedCells",
    "bus_engines",
    "cartpole_policy",
    "corrected_value",
    "discretize",
    "embedded_default",
    "fit_hand",
    "fit_parameters",
    "gridworld",
    "gridworld_expert",
    "gridworld_policy",
    "gymnasium_simulator",
    "hand_log",
    "kinova_policy",
    "load_kinova_log",
    "make_environment",
    "monte_carlo_value",
    "named_task",
    "reacher_log",
    "reacher_policy",
    "record",
    "record_episodes",
    "record_goals",
    "recycling_robot",
    "resimulate",
    "toy_text",
    "train_expert",
    "visited_states",
]


def __getattr__(name: str) -> Any:
    """Return a name of ``oee_tabular.continuous``, which is imported on use."""
    # the package of the Kinova arm, under the name by which notebook 09 reads it
    if name == "kinova":
        return importlib.import_module("oee_tabular.continuous.task.kinova")
    if name in __all__:
        return getattr(importlib.import_module("oee_tabular.continuous"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, those that are imported on use as well."""
    return sorted({*__all__, *globals()})
