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

from oee_tabular._compiling import njit
from oee_tabular._sparse import row_sums
from oee_tabular.exact import _system, finite
from oee_tabular.exact.reweighted import Model
from oee_tabular.exact.system import Kernel, policy_system, rows_of
from oee_tabular.typing import Array

HALF_SPACING = 0.5 * float(np.finfo(float).eps)
SMALLEST = 5e-324  # the rounding of numbers that are subnormal
# by which products of roundings, and the roundings of the bound itself, exceed sums
PRODUCTS = 1.0 + 1e-6


class BoundedValues(NamedTuple):
    """V_0 (S,), and a bound on its error and on that of mu_0 . V_0."""

    values: Array
    error_bound: float


def last_values(model: Model, policy: Array, steps: int) -> Array:
    """Compute V (S,) for the last ``steps`` steps of a checked policy."""
    if policy.ndim == 2:
        return np.asarray(finite.values_to_go(model, policy, steps, is_each=False)[0])
    return _last_values(model, policy, steps, np.zeros(0))


def back_up(model: Model, value: Array) -> Array:
    """Compute Q(s, a) = r(s, a) + gamma sum_s' K(s' | s, a) V(s'), of shape (S, A)."""
    following = np.empty(model.rewards.size)
    _system.multiply(Kernel(*rows_of(model.csr), 1.0), False, value, following)
    return np.asarray(
        model.rewards + model.discount * following.reshape(model.rewards.shape)
    )


def bounded_values(model: Model, policy: Array, horizon: int) -> BoundedValues:
    """Compute V_0 of a checked policy, with a bound on the rounding."""
    sizes = np.zeros(horizon + 1)
    if policy.ndim == 2:
        system = policy_system(model, policy)
        rewards, largest = _system.average_rewards(
            np.ascontiguousarray(policy), model.rewards
        )
        out = np.zeros((2, model.n_states))
        finite.sweep(system.kernel, rewards, horizon, out, sizes)
        values = out[0]
        n_terms = int(np.diff(system.kernel.indptr.astype(np.int64)).max())
        growth = system.row_sums[1]
    else:
        values = _last_values(model, policy, horizon, sizes)
        largest = float(np.abs(model.rewards).max())
        n_terms = int(np.diff(model.csr.indptr).max())
        growth = float(row_sums(model.transitions).max() * policy.sum(axis=2).max())
    each = HALF_SPACING * (n_terms + model.n_actions + 3)
    of_rewards = HALF_SPACING * (model.n_actions + 2) * largest
    of_rewards += SMALLEST * (2 * n_terms + model.n_actions + 3)
    error = carry(sizes, model.discount * growth * PRODUCTS, each, of_rewards)
    # the sum mu_0 . V_0, in parts
    n_parts = finite.N_CHUNK_TERMS + model.n_states // finite.N_CHUNK_TERMS + 2
    error += HALF_SPACING * min(n_parts, model.n_states + 1) * sizes[0]
    error *= PRODUCTS
    return BoundedValues(values, float(error) if error < np.inf else np.inf)


def _last_values(model: Model, policy: Array, steps: int, sizes: Array) -> Array:
    """Compute V (S,) for the last steps of a policy (T, S, A).

    Where ``sizes`` has room, it takes the largest magnitude of each V_t.
    """
    value = np.zeros(model.n_states)
    # a policy of T steps is followed from step T - steps on
    for k, act in enumerate(policy[len(policy) - steps :][::-1]):
        value = np.einsum("sa,sa->s", act, back_up(model, value))
        if sizes.size:
            sizes[steps - 1 - k] = _system.largest_magnitude(value)
    return value


@njit(cache=True)
def carry(sizes, carried, each, of_rewards):
    """Compute e_0 from the largest magnitude of each V_t, (T + 1,)."""
    error = 0.0
    for t in range(len(sizes) - 2, -1, -1):
        error = carried * (error + each * sizes[t + 1]) + of_rewards
    return error
