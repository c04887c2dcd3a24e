"""Finite horizons, carried out as they stand: V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0.

Where only J is wanted, T rewards can depend on no more than the states that T - 1 moves reach: rows of P_pi are made for these
alone (the light cone of the support of mu_0), and each step backward leaves its outermost ring out. Where all of V is wanted
and does not fit into a cache, blocks of rows go through several steps at once.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.systems import readable, unsigned
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.horizons import followed

Cone: TypeAlias = tuple[Any, Any, Any, Any, Any, Array, Array]  # states, ends, indptr, indices, data, rewards, initial
CACHED = 2**20  # bytes that a block of rows may have: half of what a core's second cache has today, or less
STRICT = 1e-9  # the compiled check is stricter than check_policy, which decides where sums are odd


def rows_of(matrix: sparse.csr_array) -> tuple[Any, Any, Any]:
    """indptr, indices, data as kernels read them, so that each is compiled for one kind of array."""
    return unsigned(matrix.indptr), unsigned(matrix.indices), locked(matrix.data)


def locked(array: Any) -> Any:
    """A contiguous view that cannot be written through."""
    return readable(np.ascontiguousarray(array))


def policy_to_read(policy: Any, model: Model, horizon: int) -> Array:
    """``check_policy``; but a policy that one compiled look finds in order is not copied: it must only be read."""
    from oee_tabular.exact import _frontier as kernel

    shape = (model.n_states, model.n_actions)
    if (
        type(policy) is np.ndarray
        and policy.dtype == np.float64
        and policy.flags.c_contiguous
        and policy.shape in (shape, (horizon, *shape))
        and kernel.stochastic(locked(policy.reshape(-1, model.n_actions)), STRICT)
    ):
        return policy
    return check_policy(policy, model, horizon=horizon)


def sweep(rows: tuple[Any, Any, Any], rewards: Array, discount: float, steps: int) -> Array:
    """(S,): V with ``steps`` rewards to go, of a stationary policy's kernel (``rows_of``) and rewards."""
    from oee_tabular.exact import _finite as horizon

    n, band, height, width = len(rewards), 0, 1, len(rewards)
    size = 12 * len(rows[1]) / n + 28  # bytes of a row: its entries, indptr, reward and two values
    if size * n > CACHED and steps > 1:
        band = max(int(horizon.bandwidth(*rows[:2])), 1)
        width = min(3 * band, n)
        height = int((CACHED / size - width) / band)
        height = height if height >= 4 else 1  # of a wider band too little would stay in the cache
    return np.asarray(horizon.sweep(*rows, locked(rewards), discount, steps, band, height, width))


def backward_in_time(model: Model, policy: Array, steps: int) -> Array:
    """(S,): V with rewards at policy.shape[0] - steps, ..., of a policy (T, S, A)."""
    value = np.zeros(model.n_states)
    for act in policy[len(policy) - steps :][::-1]:
        pairs = model.rewards + model.discount * (model.transitions @ value).reshape(model.rewards.shape)
        value = np.einsum("sa,sa->s", act, pairs)
    return value


def light_cone(model: Model, policy: Array, steps: int) -> Cone:
    """The kernel's light cone of a stationary policy."""
    from oee_tabular.exact import _finite as horizon

    # numpy's zeros cost nothing until they are touched, the kernel's own would be written
    place = np.zeros(model.n_states, np.uint32)
    rewards, act, initial = locked(model.rewards), locked(policy), locked(model.initial)
    found: Cone = horizon.light_cone(*rows_of(model.transitions), rewards, act, initial, steps, place)
    return found


def values_by_horizon(model: Model, policy: Array, steps: int) -> Array:
    """(T + 1,): J of 0 .. T rewards, of a policy that has been checked."""
    from oee_tabular.exact import _finite as horizon

    if policy.ndim == 2:
        _, ends, indptr, indices, data, rewards, begin = light_cone(model, policy, steps)
        return np.asarray(horizon.cone_values(ends, indptr, indices, data, rewards, begin, model.discount))
    return _frontier(model, policy, None)


def value_to_horizon(model: Model, policy: Array, steps: int) -> float:
    """J of T rewards, of a policy that has been checked: the last of ``values_by_horizon``, bit for bit."""
    from oee_tabular.exact import _finite as horizon

    if policy.ndim == 3:
        return float(_frontier(model, policy, None)[-1])
    _, ends, indptr, indices, data, rewards, begin = light_cone(model, policy, steps)
    if steps > 1 and ends[0] == ends[-1]:  # no ring to leave out
        value = sweep((readable(indptr), readable(indices), readable(data)), rewards, model.discount, steps)
        return float(horizon.dot(begin, value, len(begin)))
    return float(horizon.cone_values(ends, indptr, indices, data, rewards, begin, model.discount)[-1])


def expected(model: Model, policy: Array, values: Array) -> float:
    """mu_0 . V over the states where episodes start (the others may be infinite), with the bits of ``value_to_horizon``."""
    from oee_tabular.exact import _finite as horizon

    if policy.ndim == 3:
        return value_to_horizon(model, policy, len(policy))
    first = np.flatnonzero(model.initial)
    return float(horizon.dot(model.initial[first], values[first], len(first)))


def visits(model: Model, policy: Array, steps: int) -> Array:
    """(S, A): sum_{t<T} gamma^t Pr(s_t = s, a_t = a)."""
    from oee_tabular.exact import _finite as horizon

    pairs = np.zeros((model.n_states, model.n_actions))
    if policy.ndim == 2:
        states, ends, indptr, indices, data, _, begin = light_cone(model, policy, steps)
        reached = horizon.cone_visits(ends, indptr, indices, data, begin, model.discount)
        pairs[states] = reached[:, None] * policy[states]
    else:
        _frontier(model, policy, pairs)
    return pairs


def _frontier(model: Model, policy: Array, pairs: Array | None) -> Array:
    from oee_tabular.exact._frontier import frontier

    n, keep = model.n_states, pairs is not None
    rewards, act, initial = locked(model.rewards), locked(policy), locked(model.initial)
    here, there, reached = np.zeros(n), np.zeros(n), np.zeros(n, np.uint32)
    visited = pairs if keep else np.zeros((0, 0))
    parts = here, there, reached, visited, keep
    return np.asarray(frontier(*rows_of(model.transitions), rewards, act, initial, model.discount, *parts))


def policy_values_by_horizon(mdp: Model, policy: Any, *, horizon: int) -> Array:
    """J of every horizon up to T, from one pass: J_t = sum_{k<t} gamma^k E[r_k].

    Parameters
    ----------
    mdp : FiniteMDP (or a ReweightedModel, whose rows may have any sum)
    policy : (S, A), or (T, S, A): J_t is then of its first t steps
    horizon : T, a positive int

    Returns
    -------
    (T + 1,) array
        J_0 = 0, ..., J_T; entry t is ``policy_value(mdp, policy, horizon=t)``, for a stationary policy to the last bit.

    Raises
    ------
    ValueError
        Bad arguments.

    Notes
    -----
    Cost: O(T nnz) over the states that are reached in t moves, whatever the number of the others. A stationary policy's are
    the values at the first states during one backward sweep, any other's are summed forward.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> policy_values_by_horizon(coin, [[1.0]] * 2, horizon=3).tolist()
    [0.0, 0.5, 0.75, 0.875]
    """
    require_model(mdp)
    steps = followed(_checks.positive_integer(horizon, "horizon"), 1.0, work=mdp.transitions.nnz, kept=3)
    return values_by_horizon(mdp, policy_to_read(policy, mdp, steps), steps)
