"""What can be known exactly: values, occupancies, moments, efficiency bounds, gradients, optimal policies."""

from oee_tabular.exact.efficiency import (
    efficiency_bound,
    leading_bias,
    ratio_of_ratios_variance,
    trajectory_efficiency_bound,
)
from oee_tabular.exact.finite import policy_values_by_horizon
from oee_tabular.exact.linear import LinearSolution, solve_policy_system
from oee_tabular.exact.moments import (
    doubly_robust_moments,
    policy_is_moments,
    return_moments,
    weighted_return_moments,
)
from oee_tabular.exact.occupancy import occupancy, transition_gradient
from oee_tabular.exact.planning import optimal_policy
from oee_tabular.exact.recursions import Moments
from oee_tabular.exact.reweighted import Model, ReweightedModel, reweight
from oee_tabular.exact.values import action_values, evaluate_policy, policy_value, state_values
from oee_tabular.exact.walks import weight_growth, weight_moments

__all__ = [
    "LinearSolution",
    "Model",
    "Moments",
    "ReweightedModel",
    "action_values",
    "doubly_robust_moments",
    "efficiency_bound",
    "evaluate_policy",
    "leading_bias",
    "occupancy",
    "optimal_policy",
    "policy_is_moments",
    "policy_value",
    "policy_values_by_horizon",
    "ratio_of_ratios_variance",
    "return_moments",
    "reweight",
    "solve_policy_system",
    "state_values",
    "trajectory_efficiency_bound",
    "transition_gradient",
    "weight_growth",
    "weight_moments",
    "weighted_return_moments",
]
