"""Tasks with continuous states: their logs, corrections, finite MDPs and values.

A wing: it imports the core, and nothing of the core imports it but on use, for the
names that ``oee_tabular.tasks``, ``data`` and ``report`` show. Its folders stand in the
order in which a log passes them:

1. ``task``: what a task is (``ContinuousTask``), CartPole, Reacher, Kinova and
   Gymnasium's environments, and episodes of them.
2. ``log``: what was recorded (``ContinuousTransitions``), and its numbering for a task.
3. ``correction``: the simulator corrected by the log (``ResidualSimulator``), a task
   again, with parameters, stops, scatter and the last actions where they matter.
4. ``discretization``: the task as a finite MDP. ``discretize(task, log)`` makes it with
   the way from states to the numbers of cells.
5. ``evaluation``: the report of policies by a simulator and a log, row by row.

``command`` reads tasks, policies and logs from words and files for the command line.
The paper's experiments with these tasks are in ``lab.experiments``.

A task is a finite MDP in three lines. What a cell is and what it costs is said in
``discretization``; notebook 08 shows it.

>>> from oee_tabular.tasks import CartPole, discretize
>>> model = discretize(CartPole(10.0), cells=(40, 40))
>>> model.mdp.n_states, f"{model.diagnostics['closure_error']:+.2f}"
(1601, '-0.01')
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # imported on first use
    from oee_tabular.continuous.command import CONTINUOUS as CONTINUOUS
    from oee_tabular.continuous.command import (
        continuous_simulator as continuous_simulator,
    )
    from oee_tabular.continuous.command import evaluate_files as evaluate_files
    from oee_tabular.continuous.command import is_continuous as is_continuous
    from oee_tabular.continuous.command import read_grid as read_grid
    from oee_tabular.continuous.command import record_log as record_log
    from oee_tabular.continuous.command import task_options as task_options
    from oee_tabular.continuous.correction.history import HistoryTask as HistoryTask
    from oee_tabular.continuous.correction.linear_model import (
        LinearModel as LinearModel,
    )
    from oee_tabular.continuous.correction.parameters import (
        ParameterFit as ParameterFit,
    )
    from oee_tabular.continuous.correction.parameters import (
        fit_parameters as fit_parameters,
    )
    from oee_tabular.continuous.correction.residual import (
        ResidualSimulator as ResidualSimulator,
    )
    from oee_tabular.continuous.discretization.build import (
        GridInterpolation as GridInterpolation,
    )
    from oee_tabular.continuous.discretization.build import VisitedCells as VisitedCells
    from oee_tabular.continuous.discretization.build import discretize as discretize
    from oee_tabular.continuous.discretization.build import (
        visited_states as visited_states,
    )
    from oee_tabular.continuous.discretization.cells import Grid as Grid
    from oee_tabular.continuous.discretization.model import (
        Discretization as Discretization,
    )
    from oee_tabular.continuous.evaluation.evaluate import (
        evaluate_continuous as evaluate_continuous,
    )
    from oee_tabular.continuous.evaluation.rollouts import (
        corrected_value as corrected_value,
    )
    from oee_tabular.continuous.evaluation.sampling import (
        sampling_rows as sampling_rows,
    )
    from oee_tabular.continuous.evaluation.simulator import (
        ContinuousSimulator as ContinuousSimulator,
    )
    from oee_tabular.continuous.evaluation.simulator import Settings as Settings
    from oee_tabular.continuous.log.lists import find_lists as find_lists
    from oee_tabular.continuous.log.transitions import (
        ContinuousTransitions as ContinuousTransitions,
    )
    from oee_tabular.continuous.log.transitions import holds_states as holds_states
    from oee_tabular.continuous.task import kinova as kinova
    from oee_tabular.continuous.task.base import ContinuousTask as ContinuousTask
    from oee_tabular.continuous.task.base import DerivedTask as DerivedTask
    from oee_tabular.continuous.task.base import Moves as Moves
    from oee_tabular.continuous.task.base import StatePolicy as StatePolicy
    from oee_tabular.continuous.task.cartpole import PAPER_NOISE as PAPER_NOISE
    from oee_tabular.continuous.task.cartpole import CartPole as CartPole
    from oee_tabular.continuous.task.cartpole import cartpole_policy as cartpole_policy
    from oee_tabular.continuous.task.cartpole import train_expert as train_expert
    from oee_tabular.continuous.task.episodes import MonteCarlo as MonteCarlo
    from oee_tabular.continuous.task.episodes import compare_returns as compare_returns
    from oee_tabular.continuous.task.episodes import (
        monte_carlo_value as monte_carlo_value,
    )
    from oee_tabular.continuous.task.episodes import record as record
    from oee_tabular.continuous.task.episodes import resimulate as resimulate
    from oee_tabular.continuous.task.gen3 import hand_log as hand_log
    from oee_tabular.continuous.task.gen3 import load_kinova_log as load_kinova_log
    from oee_tabular.continuous.task.gen3 import record_goals as record_goals
    from oee_tabular.continuous.task.gymnasium_named import (
        gymnasium_simulator as gymnasium_simulator,
    )
    from oee_tabular.continuous.task.gymnasium_task import (
        GymnasiumTask as GymnasiumTask,
    )
    from oee_tabular.continuous.task.kinova import KinovaArm as KinovaArm
    from oee_tabular.continuous.task.kinova import KinovaHand as KinovaHand
    from oee_tabular.continuous.task.kinova import fit_hand as fit_hand
    from oee_tabular.continuous.task.kinova import kinova_policy as kinova_policy
    from oee_tabular.continuous.task.reacher import Reacher as Reacher
    from oee_tabular.continuous.task.reacher import reacher_log as reacher_log
    from oee_tabular.continuous.task.reacher import reacher_policy as reacher_policy

_MODULES = {
    "command": (
        "CONTINUOUS",
        "continuous_simulator",
        "evaluate_files",
        "is_continuous",
        "read_grid",
        "record_log",
        "task_options",
    ),
    "correction.history": ("HistoryTask",),
    "correction.parameters": (
        "ParameterFit",
        "fit_parameters",
    ),
    "correction.linear_model": ("LinearModel",),
    "correction.residual": ("ResidualSimulator",),
    "discretization.build": (
        "GridInterpolation",
        "VisitedCells",
        "discretize",
        "visited_states",
    ),
    "discretization.cells": ("Grid",),
    "discretization.model": ("Discretization",),
    "evaluation.evaluate": ("evaluate_continuous",),
    "evaluation.rollouts": ("corrected_value",),
    "evaluation.sampling": ("sampling_rows",),
    "evaluation.simulator": (
        "ContinuousSimulator",
        "Settings",
    ),
    "log.lists": ("find_lists",),
    "log.transitions": (
        "ContinuousTransitions",
        "holds_states",
    ),
    "task.base": (
        "ContinuousTask",
        "DerivedTask",
        "Moves",
        "StatePolicy",
    ),
    "task.cartpole": (
        "PAPER_NOISE",
        "CartPole",
        "cartpole_policy",
        "train_expert",
    ),
    "task.episodes": (
        "MonteCarlo",
        "compare_returns",
        "monte_carlo_value",
        "record",
        "resimulate",
    ),
    "task.gen3": (
        "hand_log",
        "load_kinova_log",
        "record_goals",
    ),
    "task.gymnasium_named": ("gymnasium_simulator",),
    "task.gymnasium_task": ("GymnasiumTask",),
    "task.kinova": (
        "KinovaArm",
        "KinovaHand",
        "fit_hand",
        "kinova_policy",
    ),
    "task.reacher": (
        "Reacher",
        "reacher_log",
        "reacher_policy",
    ),
}
# imported on first use
_EXPORTS = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "kinova":  # a module of names, of the arm and of its stand-ins
        return importlib.import_module(f"{__name__}.task.kinova")
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_EXPORTS[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*_EXPORTS, "kinova"])
