"""Confidence intervals, comparisons of policies, and tests of the simulator.

Given are the simulator P (S, A, S), counts n (S, A, S) of the target's transitions, n_x
those of a state-action pair x = (s, a) and phat_x = n(x, .) / n_x, a policy pi (S, A),
and J of eq. 3.1. Rewards are taken as known. With V the values and d the policy's
discounted time in the pairs, unnormalised, the gradient of J is G(x, s') = d(x) (r(x,
s') + gamma V(s')).

*The quoted interval* (``profile_ascent``, its compiled loops in ``_likelihood``):

    {J(P') : sum_x n_x KL(phat_x || P'_x) <= chi^2_1 / 2},

at the confidence asked for as n grows; P'_i = phat_i / (1 + e_x - tau G_i / n_x) at an
end. Rows without data are anything that simulator or box allow
(``Interval.worst_case``). Where the policy reaches such rows, the quoted interval is
the default's value -+ max(z se, z se_recorded + Delta_k): Delta_k is how far J moves in
the worst and the best model whose unrecorded rows are between Q / k and k Q, Q = zeta P
the estimated rows, and k the factor ``unrecorded``. At k = 1 (``Interval.sampling``)
it is the value -+ z standard errors.
``shared_parameters``: the same where rows share parameters (a tie, features).

*Large samples* (``asymptotic``): Var J = sum_x Var_phat(G_x) / n_x, or resamples; rows
without data are the simulator's.

*Guaranteed* (``robust``): P'_x in {KL(phat_x || P'_x) <= epsilon_x, nu P <= P' <= mu P}
for all x at once, at any sample size, and V = sum_a pi max_{P'_x} P'_x (r + gamma V).
``value_range`` has the box alone, Assumption V.1; ``robust_policies`` finds the policy
with the largest lower end of it.

*Comparison* (``comparison``): differences of the default's values, Cov(J_i, J_j) = f^2
sum_x Cov_x(G_i, G_j) / max(n_x, 1) with a factor f of .8 to 1, and one rule,
``Comparison.decide``, for the ranking, P(best) and every sentence about it.

*What the simulator may lack* (``asymptotic``): the variance of a simulator that was
made of samples, and to first order what transitions outside its support may change.
``changes``: kl(phat(A), P'(A)) <= epsilon_x bounds from below how far P' is from P.

``evidence`` reads counts, box and policy once for all of these. The theorems
(``oee_tabular.theory``) and plans (``oee_tabular.design``) are reachable here as well.
"""

from __future__ import annotations

import importlib

from oee_tabular.inference.changes import RowChanges, row_changes
from oee_tabular.inference.comparison import (
    Comparison,
    Decision,
    Selection,
    compare_policies,
    selection_measures,
)
from oee_tabular.inference.intervals import Interval, interval, value_range
from oee_tabular.inference.robust_policies import RobustPolicy, robust_policy

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from oee_tabular.design import *  # noqa: F403
    from oee_tabular.theory import *  # noqa: F403

__all__ = [
    "Comparison",
    "Decision",
    "Interval",
    "RobustPolicy",
    "RowChanges",
    "Selection",
    "compare_policies",
    "interval",
    "robust_policy",
    "row_changes",
    "selection_measures",
    "value_range",
]


def __getattr__(name: str) -> Any:
    """Import a name of the rooms ``theory`` and ``design`` on use."""
    for room in ("theory", "design"):
        module = importlib.import_module(f"oee_tabular.{room}")
        if name in module.__all__:
            return getattr(module, name)
    raise AttributeError(f"module 'oee_tabular.inference' has no attribute {name!r}")
