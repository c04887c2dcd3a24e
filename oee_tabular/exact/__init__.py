"""Exact dynamic programming for finite MDPs.

Values, occupancies, moments, efficiency bounds, gradients and optimal policies.

Objects (eq. 3.4). P[s, a, s'] is a csr matrix (S*A, S) with row s*A + a, r[s, a] has
shape (S, A), mu_0 (S,), a policy pi[s, a] (S, A); P_pi = sum_a pi[s, a] P[s, a, .] is
(S, S), r_pi = sum_a pi[s, a] r[s, a] is (S,); gamma is the discount, T the horizon.
Each formula is followed by the module that computes it::

    J(pi) = E[sum_t gamma^t r_t] = mu_0 . V                                 (eq. 3.1)
        values
    d(s, a) = (1 - gamma) sum_t gamma^t Pr(s_t = s, a_t = a)                (eq. 3.2)
        occupancy
    d(s, a, s') = d(s, a) P(s' | s, a)                                      (eq. 3.3)
        occupancy
    J(pi) = sum_{s, a} d(s, a) r(s, a) / (1 - gamma)
        occupancy
    V = r_pi + gamma P_pi V,    Q(s, a) = r(s, a) + gamma sum_{s'} P V(s')  (eq. 4.1)
        values
    V_t = r_pi + gamma P_pi V_{t+1},    V_T = 0
        finite, backward (horizon T)
    r(s, a) + gamma sum_{s'} P V(s'),    r(s, a, s') + gamma V(s')
        backup (Bellman's, of pairs and of transitions)
    V*(s) = max_a [r(s, a) + gamma sum_{s'} P(s' | s, a) V*(s')]
        planning
    dJ / dP(s' | s, a) = d(s, a) [r(s, a, s') + gamma V(s')] / (1 - gamma)
        occupancy

Moments of returns and of importance-weighted returns satisfy equations of the same form
with kernels sum_a pi w P and sum_a pi w^2 P (moments, recursions). Efficiency bounds
and the growth of weights follow from them (efficiency, walks). A model whose
transitions are a ratio times the simulator's, zeta P, is a ``ReweightedModel``
(reweighted).

With a horizon, sums are carried out as they stand. Without one, values and occupancies
solve M x = b and M^T x = b with M = I - gamma P_pi (system, solvers), by LAPACK, value
iteration, LU in a band, SuperLU or BiCGSTAB. The solvers that suit the graph of P_pi
are tried one after the other until one is within rounding (``solvers`` has the order).

Guarantees. ``error_bound`` bounds the largest error ``|V - V*|_inf``, for transposed
systems the sum ``|x - x*|_1``, for the numbers as they are stored::

    |x - x*| <= |M^-1| (|b - M x| + rounding)
    |M^-1|_inf <= max(h) / c    for any h > 0 with M h >= c > 0,

h = 1 and c = 1 - gamma where rows sum to 1. With a horizon it bounds the roundings of
the recursion (``backward``). Where no such h exists (discount 1 without
absorption, unnormalised kernels with a spectral radius of 1 / gamma or more) the sum
diverges, and the functions raise ``DivergentKernelError``. An optimal policy is
certified by exact evaluation: no action is better by more than rounding.

References: Puterman, Markov Decision Processes, 1994; Berman and Plemmons, Nonnegative
Matrices in the Mathematical Sciences, 1994.
"""

from oee_tabular.exact.backup import back_up_pairs as back_up_pairs
from oee_tabular.exact.backup import back_up_transitions as back_up_transitions
from oee_tabular.exact.efficiency import (
    efficiency_bound,
    leading_bias,
    ratio_of_ratios_variance,
    trajectory_efficiency_bound,
)
from oee_tabular.exact.efficiency import (
    require_action_support as require_action_support,
)
from oee_tabular.exact.finite import policy_values_by_horizon
from oee_tabular.exact.finite import values_to_go as values_to_go
from oee_tabular.exact.moments import (
    doubly_robust_moments,
    policy_is_moments,
    return_moments,
    weighted_return_moments,
)
from oee_tabular.exact.occupancy import occupancy, transition_gradient
from oee_tabular.exact.occupancy import time_in_pairs as time_in_pairs
from oee_tabular.exact.planning import optimal_policy
from oee_tabular.exact.reach import reached_states as reached_states
from oee_tabular.exact.recursions import Moments
from oee_tabular.exact.reweighted import Model, ReweightedModel, reweight
from oee_tabular.exact.reweighted import RatioLike as RatioLike
from oee_tabular.exact.reweighted import with_rows as with_rows
from oee_tabular.exact.system import Kernel as Kernel
from oee_tabular.exact.system import System as System
from oee_tabular.exact.system import as_readonly as as_readonly
from oee_tabular.exact.system import exponent as exponent
from oee_tabular.exact.system import policy_kernel as policy_kernel
from oee_tabular.exact.system import policy_system as policy_system
from oee_tabular.exact.system import recurrent_states as recurrent_states
from oee_tabular.exact.values import (
    LinearSolution,
    action_values,
    evaluate_policy,
    policy_value,
    solve_policy_system,
    state_values,
)
from oee_tabular.exact.values import largest_reward as largest_reward
from oee_tabular.exact.values import values_or_zeros as values_or_zeros
from oee_tabular.exact.walks import transition_factors as transition_factors
from oee_tabular.exact.walks import walk_of as walk_of
from oee_tabular.exact.walks import weight_growth, weight_moments

# what users find here; what is imported above "as" itself is for other rooms alone
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
