"""The paper's theorems with both sides of each, and what holds instead."""

from oee_tabular.theory.bounds import (
    kl_path_bound,
    kl_path_sides,
    normalised_bound,
    normalised_sides,
    path_kl,
    unnormalised_bound,
    unnormalised_sides,
)
from oee_tabular.theory.simulation_lemma import Sides, SimulationLemma, simulation_lemma
from oee_tabular.theory.theorem_1 import (
    EstimationCounterexample,
    estimation_bound,
    estimation_sides,
    excess_risk,
    renyi_divergence,
    squared_error_sides,
    sup_error_bound,
    universal_constant_counterexample,
)
from oee_tabular.theory.theorem_2 import (
    corrected_value_error_bound,
    ratio_error_bound,
    ratio_error_sides,
    value_bound_counterexample,
    value_error_bound,
    value_error_sides,
)

__all__ = [
    "EstimationCounterexample",
    "Sides",
    "SimulationLemma",
    "corrected_value_error_bound",
    "estimation_bound",
    "estimation_sides",
    "excess_risk",
    "kl_path_bound",
    "kl_path_sides",
    "normalised_bound",
    "normalised_sides",
    "path_kl",
    "ratio_error_bound",
    "ratio_error_sides",
    "renyi_divergence",
    "simulation_lemma",
    "squared_error_sides",
    "sup_error_bound",
    "universal_constant_counterexample",
    "unnormalised_bound",
    "unnormalised_sides",
    "value_bound_counterexample",
    "value_error_bound",
    "value_error_sides",
]
