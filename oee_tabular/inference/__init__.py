"""How sure: intervals, comparisons of policies, what to record next, and the paper's theorems with both sides of each."""

from oee_tabular.inference.bounds import (
    kl_path_bound,
    kl_path_sides,
    normalised_bound,
    normalised_sides,
    path_kl,
    unnormalised_bound,
    unnormalised_sides,
)
from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.inference.comparison import Comparison, Selection, compare_policies, selection_measures
from oee_tabular.inference.design_plan import Outlook, Plan
from oee_tabular.inference.experimental_design import plan_data_collection
from oee_tabular.inference.intervals import Interval, interval
from oee_tabular.inference.pairs import Sides, SimulationLemma, simulation_lemma
from oee_tabular.inference.theorem_1 import (
    EstimationCounterexample,
    estimation_bound,
    estimation_sides,
    excess_risk,
    renyi_divergence,
    squared_error_sides,
    sup_error_bound,
    universal_constant_counterexample,
)
from oee_tabular.inference.theorem_2 import (
    corrected_value_error_bound,
    ratio_error_bound,
    ratio_error_sides,
    value_bound_counterexample,
    value_error_bound,
    value_error_sides,
)

__all__ = [
    "Comparison",
    "EstimationCounterexample",
    "Interval",
    "Outlook",
    "Plan",
    "RowChanges",
    "Selection",
    "Sides",
    "SimulationLemma",
    "compare_policies",
    "corrected_value_error_bound",
    "estimation_bound",
    "estimation_sides",
    "excess_risk",
    "interval",
    "kl_path_bound",
    "kl_path_sides",
    "normalised_bound",
    "normalised_sides",
    "path_kl",
    "plan_data_collection",
    "ratio_error_bound",
    "ratio_error_sides",
    "renyi_divergence",
    "row_changes",
    "selection_measures",
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
