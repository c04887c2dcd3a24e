"""Modules that moved, under the names by which users' scripts import them: ``from oee_tabular.tasks.reacher import ...``."""

from __future__ import annotations

import importlib
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED = {
    "tasks.continuous": "continuous.task",
    "tasks.continuous_sampling": "continuous.episodes",
    "tasks.continuous_simulator": "continuous.simulator",
    "tasks.discretize": "continuous.discretization",
    "tasks.discretize_cells": "continuous.cells",
    "tasks.discretize_closure": "continuous.closure",
    "tasks.discretize_files": "continuous.discretization_files",
    "tasks.discretize_geometry": "continuous.grid",
    "tasks.discretize_grid": "continuous.interpolation",
    "tasks.discretize_gymnasium": "continuous.gymnasium_task",
    "tasks.discretize_mixture": "continuous.support",
    "tasks.named_continuous": "continuous.names",
    "tasks.named_arms": "continuous.names",
    "tasks.named_arguments": "tasks.specs",
    "tasks.recording": "tasks.toy_text",
    "tasks.cartpole": "continuous.cartpole.dynamics",
    "tasks.cartpole_expert": "continuous.cartpole.expert",
    "tasks.reacher": "continuous.reacher.dynamics",
    "tasks.reacher_cells": "continuous.reacher.cells",
    "tasks.reacher_expert": "continuous.reacher.expert",
    "tasks.reacher_linear": "continuous.reacher.dynamics",
    "tasks.kinova": "continuous.kinova",
    "tasks.kinova_arm": "continuous.kinova.dynamics",
    "tasks.kinova_kinematics": "continuous.kinova.dynamics",
    "tasks.kinova_logs": "continuous.kinova.logs",
    "tasks.kinova_model": "continuous.kinova",
    "data.continuous": "continuous.log",
    "data.continuous_files": "continuous.log",
    "report.continuous": "continuous.evaluation",
    "report.continuous_estimators": "continuous.estimators",
    "experiments.cartpole": "continuous.cartpole.experiment",
    "experiments.cartpole_estimates": "continuous.cartpole.estimates",
    "experiments.cartpole_figures": "continuous.cartpole.figures",
    "experiments.cartpole_truth": "continuous.cartpole.truth",
    "experiments.reacher": "continuous.reacher.experiment",
    "experiments.kinova": "continuous.kinova.experiment",
}  # as they were named -> as they are named, both within oee_tabular
PACKAGE = "oee_tabular."


class Moved(MetaPathFinder, Loader):
    """Gives for a former name the module itself, so that both names have one set of objects."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """The spec of a former name; None for every other."""
        return ModuleSpec(name, self) if name.removeprefix(PACKAGE) in MOVED else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module as it is named now; its own spec is kept aside, for importing puts another in its place."""
        module = importlib.import_module(PACKAGE + MOVED[spec.name.removeprefix(PACKAGE)])
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is run again; the module gets its own spec back."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


def former(package: str, name: str) -> ModuleType:
    """What ``package.name`` is where a module of that name moved; AttributeError where none did."""
    if f"{package}.{name}".removeprefix(PACKAGE) not in MOVED:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    return importlib.import_module(f"{package}.{name}")


sys.meta_path.append(Moved())
