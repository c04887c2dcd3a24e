"""Tasks with continuous states, their logs, finite MDPs of them, and their values.

A wing: it imports the core, and nothing of the core imports it but on use, for the
names that ``oee_tabular.tasks``, ``data`` and ``report`` show. A task is a
``ContinuousTask`` (task); a log of it is ``ContinuousTransitions`` (log); a
``ResidualSimulator`` (residual) is a task corrected by a log, a ``LinearModel``
(regression) one learned from it, both again tasks; ``discretize`` (discretization)
makes a FiniteMDP with the way from states to its numbers (discretized), on a grid or on
cells of visited states (cells); a ``ContinuousSimulator`` (simulator) is a task with
the configuration by which logs are evaluated (evaluation, row by row: rows), and has a
name on the command line (command; Gymnasium's environments: gymnasium_named). Each of
``cartpole``, ``reacher`` and ``kinova`` has its dynamics and its expert (kinova's
controller and logs are in ``gen3``); the paper's experiments with them are in
``lab.experiments``.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # imported on first use
    from oee_tabular.continuous.cartpole import PAPER_NOISE as PAPER_NOISE
    from oee_tabular.continuous.cartpole import CartPole as CartPole
    from oee_tabular.continuous.cartpole import cartpole_policy as cartpole_policy
    from oee_tabular.continuous.cartpole import train_expert as train_expert
    from oee_tabular.continuous.cells import Grid as Grid
    from oee_tabular.continuous.command import CONTINUOUS as CONTINUOUS
    from oee_tabular.continuous.command import (
        continuous_simulator as continuous_simulator,
    )
    from oee_tabular.continuous.command import evaluate_files as evaluate_files
    from oee_tabular.continuous.command import is_continuous as is_continuous
    from oee_tabular.continuous.command import read_grid as read_grid
    from oee_tabular.continuous.command import record_log as record_log
    from oee_tabular.continuous.command import task_options as task_options
    from oee_tabular.continuous.correction import ParameterFit as ParameterFit
    from oee_tabular.continuous.correction import fit_parameters as fit_parameters
    from oee_tabular.continuous.discretization import (
        GridInterpolation as GridInterpolation,
    )
    from oee_tabular.continuous.discretization import VisitedCells as VisitedCells
    from oee_tabular.continuous.discretization import discretize as discretize
    from oee_tabular.continuous.discretization import visited_states as visited_states
    from oee_tabular.continuous.discretized import Discretization as Discretization
    from oee_tabular.continuous.episodes import MonteCarlo as MonteCarlo
    from oee_tabular.continuous.episodes import compare_returns as compare_returns
    from oee_tabular.continuous.episodes import monte_carlo_value as monte_carlo_value
    from oee_tabular.continuous.episodes import record as record
    from oee_tabular.continuous.episodes import resimulate as resimulate
    from oee_tabular.continuous.evaluation import (
        evaluate_continuous as evaluate_continuous,
    )
    from oee_tabular.continuous.evaluation import sampling_rows as sampling_rows
    from oee_tabular.continuous.gen3 import hand_log as hand_log
    from oee_tabular.continuous.gen3 import load_kinova_log as load_kinova_log
    from oee_tabular.continuous.gen3 import record_goals as record_goals
    from oee_tabular.continuous.gymnasium_named import (
        gymnasium_simulator as gymnasium_simulator,
    )
    from oee_tabular.continuous.gymnasium_task import GymnasiumTask as GymnasiumTask
    from oee_tabular.continuous.history import HistoryTask as HistoryTask
    from oee_tabular.continuous.kinova import KinovaArm as KinovaArm
    from oee_tabular.continuous.kinova import KinovaHand as KinovaHand
    from oee_tabular.continuous.kinova import fit_hand as fit_hand
    from oee_tabular.continuous.kinova import kinova_policy as kinova_policy
    from oee_tabular.continuous.log import (
        ContinuousTransitions as ContinuousTransitions,
    )
    from oee_tabular.continuous.log import holds_states as holds_states
    from oee_tabular.continuous.reacher import Reacher as Reacher
    from oee_tabular.continuous.reacher import reacher_log as reacher_log
    from oee_tabular.continuous.reacher import reacher_policy as reacher_policy
    from oee_tabular.continuous.regression import LinearModel as LinearModel
    from oee_tabular.continuous.residual import ResidualSimulator as ResidualSimulator
    from oee_tabular.continuous.rows import corrected_value as corrected_value
    from oee_tabular.continuous.simulator import (
        ContinuousSimulator as ContinuousSimulator,
    )
    from oee_tabular.continuous.simulator import Settings as Settings
    from oee_tabular.continuous.task import ContinuousTask as ContinuousTask
    from oee_tabular.continuous.task import DerivedTask as DerivedTask
    from oee_tabular.continuous.task import Moves as Moves
    from oee_tabular.continuous.task import StatePolicy as StatePolicy

_MODULES = {
    "cartpole": ("CartPole", "PAPER_NOISE", "cartpole_policy", "train_expert"),
    "cells": ("Grid",),
    "command": (
        "CONTINUOUS",
        "continuous_simulator",
        "evaluate_files",
        "is_continuous",
        "read_grid",
        "record_log",
        "task_options",
    ),
    "correction": ("ParameterFit", "fit_parameters"),
    "discretization": (
        "GridInterpolation",
        "VisitedCells",
        "discretize",
        "visited_states",
    ),
    "discretized": ("Discretization",),
    "episodes": (
        "MonteCarlo",
        "compare_returns",
        "monte_carlo_value",
        "record",
        "resimulate",
    ),
    "evaluation": ("evaluate_continuous", "sampling_rows"),
    "gymnasium_named": ("gymnasium_simulator",),
    "gymnasium_task": ("GymnasiumTask",),
    "history": ("HistoryTask",),
    "kinova": (
        "KinovaArm",
        "KinovaHand",
        "fit_hand",
        "hand_log",
        "kinova_policy",
        "load_kinova_log",
        "record_goals",
    ),
    "log": ("ContinuousTransitions", "holds_states"),
    "reacher": ("Reacher", "reacher_log", "reacher_policy"),
    "regression": ("LinearModel",),
    "residual": ("ResidualSimulator",),
    "rows": ("corrected_value",),
    "simulator": ("ContinuousSimulator", "Settings"),
    "task": ("ContinuousTask", "DerivedTask", "Moves", "StatePolicy"),
}
# imported on first use
_EXPORTS = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_EXPORTS[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_EXPORTS)
