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
from typing import Any

_MODULES = {
    "cartpole": ("CartPole", "cartpole_policy", "train_expert"),
    "correction": ("ParameterFit", "fit_parameters"),
    "discretization": (
        "GridInterpolation",
        "VisitedCells",
        "discretize",
        "visited_states",
    ),
    "discretized": ("Discretization",),
    "episodes": ("MonteCarlo", "monte_carlo_value", "record", "resimulate"),
    "evaluation": ("evaluate_continuous",),
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
    "log": ("ContinuousTransitions",),
    "reacher": ("Reacher", "reacher_log", "reacher_policy"),
    "regression": ("LinearModel",),
    "residual": ("ResidualSimulator",),
    "rows": ("corrected_value",),
    "simulator": ("ContinuousSimulator", "Settings"),
    "task": ("ContinuousTask", "Moves", "StatePolicy"),
}
# imported on first use
_EXPORTS = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_EXPORTS[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_EXPORTS)
