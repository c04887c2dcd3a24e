"""Discounted occupancies d(s), d(s, a), d(s, a, s'): the paper's equations for d_P^pi, normalised to sum to 1."""

from __future__ import annotations

from typing import Any, Literal, overload

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular._sparse import on_pattern, row_of_entry
from oee_tabular.exact.finite import policy_to_read, visits
from oee_tabular.exact.linear import solve_policy_system
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import policy_kernel
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.horizons import optional_steps


@overload
def occupancy(
    mdp: Model, policy: Any, *, horizon: int | None = ..., of: Literal["state", "state_action"] = ...
) -> Array: ...
@overload
def occupancy(mdp: Model, policy: Any, *, horizon: int | None = ..., of: Literal["transition"]) -> sparse.csr_array: ...


def occupancy(
    mdp: Model,
    policy: Any,
    *,
    horizon: int | None = None,
    of: Literal["state", "state_action", "transition"] = "state_action",
) -> Array | sparse.csr_array:
    """The share of discounted time spent in each state, state-action pair or transition (eq. 3.2, 3.3).

    d(s, a) = sum_t gamma^t Pr(s_t = s, a_t = a) / sum_t gamma^t, over t = 0..T-1 or over all t.

    Parameters
    ----------
    mdp : FiniteMDP
    policy : (S, A), or (T, S, A) with a horizon T
    horizon : positive int or None (discount below 1)
    of : "state" -> (S,), "state_action" -> (S, A), "transition" -> csr of shape (S*A, S) aligned with mdp.transitions

    Notes
    -----
    It sums to 1, and J = d . r * sum_t gamma^t. Cost: O(T * nnz), or one sparse solve.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> occupancy(coin, [[1.0]] * 2, of="state").round(6).tolist()
    [0.5, 0.5]
    >>> occupancy(coin, [[1.0]] * 2, of="transition").toarray().round(6).tolist()
    [[0.25, 0.25], [0.25, 0.25]]
    """
    require_model(mdp)
    _checks.one_of(of, "of", ("state", "state_action", "transition"))
    steps = optional_steps(horizon, mdp, policy)
    pi = check_policy(policy, mdp) if steps is None else policy_to_read(policy, mdp, steps)
    if steps is None and mdp.discount == 1.0:
        raise ValueError("horizon must be given: at discount 1 an infinite occupancy cannot be normalised")
    if steps is None:
        kernel = policy_kernel(mdp, pi)
        start = (1.0 - mdp.discount) * mdp.initial
        states = solve_policy_system(kernel, start, mdp.discount, transpose=True).x
        pairs = np.maximum(states, 0.0)[:, None] * pi
    else:
        pairs = _forward(mdp, pi, steps)
    if of == "state":
        return np.asarray(pairs.sum(axis=1))
    if of == "state_action":
        return pairs
    data = pairs.reshape(-1)[row_of_entry(mdp.transitions)] * mdp.transitions.data
    return on_pattern(mdp.transitions, data)


def _forward(mdp: Model, policy: Array, horizon: int) -> Array:
    """sum_{t<T} gamma^t Pr(s_t = s, a_t = a) / sum_{t<T} gamma^t."""
    weight, mass = 1.0, 0.0
    for _ in range(horizon):
        mass += weight
        weight *= mdp.discount
    return visits(mdp, policy, horizon) / mass
