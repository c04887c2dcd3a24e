"""Tasks with continuous states: their logs, the finite MDPs that are made of them, and values by way of those.

A wing: it imports the core, and nothing of the core imports it but on use, for the names that ``oee_tabular.tasks``, ``data``,
``report`` and ``experiments`` show. A task is a ``ContinuousTask`` (task); a log of it is ``ContinuousTransitions`` (log); a
``Discretization`` (discretization) is a FiniteMDP with the way from states to its numbers, built on a grid (interpolation)
or on visited states (cells); a ``ContinuousSimulator`` (simulator) is a task with the configuration by which logs are
evaluated (evaluation), and has a name on the command line (names). Each of ``cartpole``, ``reacher`` and ``kinova`` has its
dynamics, its expert, its configuration and the paper's experiment.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from oee_tabular.continuous.cartpole.dynamics import CartPole
    from oee_tabular.continuous.cartpole.expert import cartpole_policy, train_expert
    from oee_tabular.continuous.cells import VisitedCells, visited_states
    from oee_tabular.continuous.closure import Closure
    from oee_tabular.continuous.discretization import Discretization
    from oee_tabular.continuous.episodes import MonteCarlo, monte_carlo_value, record, resimulate
    from oee_tabular.continuous.evaluation import Settings, evaluate_continuous
    from oee_tabular.continuous.gymnasium_task import GymnasiumTask
    from oee_tabular.continuous.interpolation import GridInterpolation
    from oee_tabular.continuous.kinova.dynamics import KinovaArm
    from oee_tabular.continuous.kinova.expert import kinova_policy
    from oee_tabular.continuous.kinova.hand import KinovaHand, fit_hand, kinova_model
    from oee_tabular.continuous.kinova.logs import hand_log, load_kinova_log, record_goals
    from oee_tabular.continuous.log import ContinuousTransitions
    from oee_tabular.continuous.reacher.cells import ArmCells, arm_cells, reacher_log
    from oee_tabular.continuous.reacher.dynamics import LinearReacher, Reacher
    from oee_tabular.continuous.reacher.expert import reacher_policy
    from oee_tabular.continuous.support import defensive_mixture
    from oee_tabular.continuous.task import ContinuousTask, Moves, StatePolicy

_MODULES = {
    "cartpole.dynamics": ("CartPole",),
    "cartpole.expert": ("cartpole_policy", "train_expert"),
    "cartpole.experiment": ("CARTPOLE_CHOICE", "CARTPOLE_DATA", "FIGURE_2", "RESOLUTION"),
    "cells": ("VisitedCells", "visited_states"),
    "closure": ("Closure",),
    "support": ("defensive_mixture",),
    "discretization": ("Discretization",),
    "episodes": ("MonteCarlo", "monte_carlo_value", "record", "resimulate"),
    "evaluation": ("Settings", "evaluate_continuous"),
    "gymnasium_task": ("GymnasiumTask",),
    "interpolation": ("GridInterpolation",),
    "kinova.dynamics": ("KinovaArm",),
    "kinova.expert": ("kinova_policy",),
    "kinova.experiment": ("TABLE_1",),
    "kinova.hand": ("KinovaHand", "fit_hand", "kinova_model"),
    "kinova.logs": ("hand_log", "load_kinova_log", "record_goals"),
    "log": ("ContinuousTransitions",),
    "reacher.cells": ("ArmCells", "arm_cells", "reacher_log"),
    "reacher.dynamics": ("LinearReacher", "Reacher"),
    "reacher.experiment": ("FIGURE_3",),
    "reacher.expert": ("reacher_policy",),
    "task": ("ContinuousTask", "Moves", "StatePolicy"),
}
_EXPORTS = {name: module for module, names in _MODULES.items() for name in names}  # imported on first use

__all__ = [
    "ArmCells",
    "CartPole",
    "Closure",
    "ContinuousTask",
    "ContinuousTransitions",
    "Discretization",
    "GridInterpolation",
    "GymnasiumTask",
    "KinovaArm",
    "KinovaHand",
    "LinearReacher",
    "MonteCarlo",
    "Moves",
    "Reacher",
    "Settings",
    "StatePolicy",
    "VisitedCells",
    "arm_cells",
    "cartpole_policy",
    "defensive_mixture",
    "evaluate_continuous",
    "fit_hand",
    "hand_log",
    "kinova_model",
    "kinova_policy",
    "load_kinova_log",
    "monte_carlo_value",
    "reacher_log",
    "reacher_policy",
    "record",
    "record_goals",
    "resimulate",
    "train_expert",
    "visited_states",
]


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_EXPORTS[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
