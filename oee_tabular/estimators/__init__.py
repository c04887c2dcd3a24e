"""Estimators of a policy's value in the target: ``estimator(problem, policy, seed=...) -> Estimate``."""

from oee_tabular.estimators.base import Estimate, Estimator
from oee_tabular.estimators.importance_sampling import ImportanceSampling
from oee_tabular.estimators.model_based import ModelBased
from oee_tabular.estimators.off_environment import OffEnvironment
from oee_tabular.estimators.problem import Problem
from oee_tabular.estimators.simulator import Oracle, Simulator

__all__ = [
    "Estimate",
    "Estimator",
    "ImportanceSampling",
    "ModelBased",
    "OffEnvironment",
    "Oracle",
    "Problem",
    "Simulator",
]
