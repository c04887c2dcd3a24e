"""What can be known exactly: values, occupancies, gradients, optimal policies."""

from oee_tabular.exact.gradient import transition_gradient
from oee_tabular.exact.linear import LinearSolution, solve_policy_system
from oee_tabular.exact.occupancy import occupancy
from oee_tabular.exact.planning import optimal_policy
from oee_tabular.exact.reweighted import ReweightedModel, reweight
from oee_tabular.exact.values import action_values, evaluate_policy, policy_value, state_values

__all__ = [
    "LinearSolution",
    "ReweightedModel",
    "action_values",
    "evaluate_policy",
    "occupancy",
    "optimal_policy",
    "policy_value",
    "reweight",
    "solve_policy_system",
    "state_values",
    "transition_gradient",
]
