"""The backward recursion of a horizon, and a bound on its roundings.

    V_t = r_pi + gamma P_pi V_{t+1},    V_T = 0

Let V be computed and V* exact for the numbers as they are stored, u half the spacing of
floats at 1, n the largest number of entries in a row of P_pi, and rho its largest sum.
A product of a row meets at most n + A + 3 roundings, A of them in P_pi, and a reward,
itself a sum of A products, at most A + 2. So e_t >= ``|V_t - V*_t|_inf`` is [1]

    e_t = gamma rho e_{t+1} + u (n + A + 3) gamma rho ``|V_{t+1}|_inf`` + u (A + 2) R,

R the largest sum of pi(a | s) ``|r(s, a)|``. Where rewards cancel, R remains, and the
bound is large beside the values: so may be their error.

Reference: [1] N. Higham, Accuracy and Stability of Numerical Algorithms, 2002,
chapter 3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oee_tabular._sparse import row_sums
from oee_tabular.exact import _system, finite
from oee_tabular.exact.backup import back_up_pairs
from oee_tabular.exact.reweighted import Model
from oee_tabular.exact.system import SMALLEST_FLOAT, policy_system
from oee_tabular.typing import Array

UNIT_ROUNDOFF = 0.5 * _system.EPS  # u: the largest relative error of one rounding
# the factor by which products of roundings, and those of the bound itself, exceed sums
ROUNDING_FACTOR = 1.0 + 1e-6


class BoundedValues(NamedTuple):
    """Hold V_0 (S,), and a bound on its error and on the error of mu_0 . V_0."""

    values: Array
    error_bound: float


def last_values(model: Model, policy: Array, steps: int) -> Array:
    """Compute V (S,) for the last ``steps`` steps of a checked policy."""
    if policy.ndim == 2:
        return np.asarray(finite.values_to_go(model, policy, steps, is_each=False)[0])
    value = np.zeros(model.n_states)
    # a policy of T steps is followed from step T - steps on
    for act in policy[len(policy) - steps :][::-1]:
        value = _step_back(model, act, value)
    return value


def bounded_values(model: Model, policy: Array, horizon: int) -> BoundedValues:
    """Compute V_0 of a checked policy, with a bound on the rounding."""
    if policy.ndim == 2:
        system = policy_system(model, policy)
        rewards, largest = _system.average_rewards(policy, model.rewards)
        n_terms = int(np.diff(system.kernel.indptr.astype(np.int64)).max())
        growth = system.row_sums[1]
    else:
        largest = float(np.abs(model.rewards).max())
        n_terms = int(np.diff(model.csr.indptr).max())
        growth = float(row_sums(model.transitions).max() * policy.sum(axis=2).max())
    each = UNIT_ROUNDOFF * (n_terms + model.n_actions + 3)
    of_rewards = UNIT_ROUNDOFF * (model.n_actions + 2) * largest
    of_rewards += SMALLEST_FLOAT * (2 * n_terms + model.n_actions + 3)
    carried = model.discount * growth * ROUNDING_FACTOR
    if policy.ndim == 2:
        out = np.empty((2, model.n_states))
        size, error = finite.sweep_all(
            system.kernel, rewards, horizon, out, carried, each, of_rewards
        )
        values = out[0]
    else:
        error = size = 0.0
        values = np.zeros(model.n_states)
        for act in policy[len(policy) - horizon :][::-1]:
            error = carried * (error + each * size) + of_rewards
            values = _step_back(model, act, values)
            size = _system.largest_magnitude(values)
    # the sum mu_0 . V_0, in parts
    n_parts = finite.N_CHUNK_TERMS + model.n_states // finite.N_CHUNK_TERMS + 2
    error += UNIT_ROUNDOFF * min(n_parts, model.n_states + 1) * size
    error *= ROUNDING_FACTOR
    return BoundedValues(values, float(error) if error < np.inf else np.inf)


def _step_back(model: Model, act: Array, value: Array) -> Array:
    """Compute r_act + gamma P_act V (S,) of a step's policy (S, A)."""
    return np.asarray(np.einsum("sa,sa->s", act, back_up_pairs(model, value)))
