"""Estimators of a policy's value in the target: ``estimator(problem, policy, seed=...) -> Estimate``."""

from oee_tabular.estimators.base import Estimate, Estimator
from oee_tabular.estimators.calibrated import calibrate
from oee_tabular.estimators.doubly_robust import DoublyRobust
from oee_tabular.estimators.importance_sampling import ImportanceSampling
from oee_tabular.estimators.magic import Magic
from oee_tabular.estimators.marginalized import DualDice, Marginalized
from oee_tabular.estimators.model_based import ModelBased
from oee_tabular.estimators.off_environment import OffEnvironment
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.simulator import Oracle, Simulator

__all__ = [
    "DoublyRobust",
    "DualDice",
    "Estimate",
    "Estimator",
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
