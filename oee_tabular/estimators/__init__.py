"""Estimators of a policy's value in the target: ``estimator(problem, policy, seed=...) -> Estimate``."""

from __future__ import annotations

import importlib

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from oee_tabular.estimators.base import Estimate, Estimator
    from oee_tabular.estimators.calibrated import calibrate
    from oee_tabular.estimators.doubly_robust import DoublyRobust
    from oee_tabular.estimators.findings import Finding
    from oee_tabular.estimators.importance_sampling import ImportanceSampling
    from oee_tabular.estimators.magic import Magic
    from oee_tabular.estimators.marginalized import DualDice, Marginalized
    from oee_tabular.estimators.model_based import ModelBased
    from oee_tabular.estimators.off_environment import OffEnvironment
    from oee_tabular.estimators.problem import Problem
    from oee_tabular.estimators.simulator import Oracle, Simulator

_EXPORTS = {  # module -> names, imported on first use: ``oee --help`` reads the table of names alone
    "base": "Estimate Estimator",
    "calibrated": "calibrate",
    "doubly_robust": "DoublyRobust",
    "findings": "Finding",
    "importance_sampling": "ImportanceSampling",
    "magic": "Magic",
    "marginalized": "DualDice Marginalized",
    "model_based": "ModelBased",
    "off_environment": "OffEnvironment",
    "problem": "Problem",
    "simulator": "Oracle Simulator",
}
__all__ = [
    "DoublyRobust",
    "DualDice",
    "Estimate",
    "Estimator",
    "Finding",
    "ImportanceSampling",
    "Magic",
    "Marginalized",
    "ModelBased",
    "OffEnvironment",
    "Oracle",
    "Problem",
    "Simulator",
    "calibrate",
]


def __getattr__(name: str) -> Any:
    room = next((module for module, names in _EXPORTS.items() if name in names.split()), None)
    if room is None:
        raise AttributeError(f"module 'oee_tabular.estimators' has no attribute {name!r}")
    value = globals()[name] = getattr(importlib.import_module(f"oee_tabular.estimators.{room}"), name)
    return value
