"""Finite horizons, carried out as they stand: V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0.

Where only J is wanted, T rewards can depend on no more than the states that T - 1 transitions reach: rows of P_pi are made for
these alone (the light cone of the support of mu_0), and each step backward leaves its outermost ring out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import Kernel, as_readonly, policy_kernel, policy_system, rows_of
from oee_tabular.mdp import check_policy
from oee_tabular.mdp.horizons import limit_horizon

if TYPE_CHECKING:
    from oee_tabular.exact._finite import Cone

STRICT_TOLERANCE = 1e-9  # of a row's sum: stricter than check_policy, which decides where sums are odd


def check_policy_in_place(policy: PolicyLike, model: Model, horizon: int) -> Array:
    """``check_policy``; but a policy that one compiled look finds in order is not copied: it must only be read."""
    from oee_tabular.mdp._policies import is_stochastic_matrix

    shape = (model.n_states, model.n_actions)
    if (
        type(policy) is np.ndarray
        and policy.dtype == np.float64
        and policy.flags.c_contiguous
        and policy.shape in (shape, (horizon, *shape))
        and is_stochastic_matrix(as_readonly(policy.reshape(-1, model.n_actions)), STRICT_TOLERANCE)
    ):
        return policy
    return check_policy(policy, model, horizon=horizon)


def light_cone(model: Model, policy: Array, horizon: int) -> Cone:
    """The states that ``horizon`` rewards of a stationary policy can depend on, with their rows and rewards."""
    from oee_tabular.exact import _finite

    # numpy's zeros cost nothing until they are touched, the kernel's own would be written
    place = np.zeros(model.n_states, np.uint32)
    read = as_readonly(policy), as_readonly(model.rewards), as_readonly(model.initial)
    cone: Cone = _finite.light_cone(rows_of(model.csr), *read, model.discount, horizon, place)
    for part in cone.kernel[:3]:
        part.flags.writeable = False  # so that sweeps are compiled for one kind of array
    return cone


def values_by_horizon(model: Model, policy: Array, horizon: int, *, is_each: bool = True) -> Array:
    """(T + 1,): J of 0 .. T rewards, of a policy that has been checked; the last alone unless ``is_each``."""
    from oee_tabular.exact import _finite

    if policy.ndim == 3:
        return _step_forward(model, policy, np.zeros((0, 0)))
    return np.asarray(_finite.cone_values(light_cone(model, policy, horizon), is_each))


def initial_mean(model: Model, values: Array) -> float:
    """mu_0 . V over the states where episodes start (the others may be infinite)."""
    from oee_tabular.exact import _finite

    return float(_finite.dot(model.initial, values, len(values)))


def visits(model: Model, policy: Array, horizon: int) -> Array:
    """(S, A): sum_{t<T} gamma^t Pr(s_t = s, a_t = a)."""
    from oee_tabular.exact import _finite

    pairs = np.zeros((model.n_states, model.n_actions))
    if policy.ndim == 2:
        cone = light_cone(model, policy, horizon)
        pairs[cone.states] = _finite.cone_visits(cone)[:, None] * policy[cone.states]
    else:
        _step_forward(model, policy, pairs)
    return pairs


def _step_forward(model: Model, policy: Array, pairs: Array) -> Array:
    from oee_tabular.exact import _finite

    read = as_readonly(model.rewards), as_readonly(policy), as_readonly(model.initial)
    return np.asarray(_finite.step_forward(rows_of(model.csr), *read, model.discount, pairs))


def values_to_go(model: Model, policy: Array, horizon: int) -> Array:
    """(T + 1, S): V_t of a stationary policy that has been checked, T - t rewards to go."""
    from oee_tabular.exact import _finite, _policy_rows

    out = np.empty((horizon + 1, model.n_states))
    rewards, _ = _policy_rows.average_rewards(np.ascontiguousarray(policy), model.rewards)
    _finite.values_to_go(policy_system(model, policy).kernel, rewards, out)
    return out


def gradient_to_horizon(model: Model, valued: Model, policy: Array, horizon: int) -> Array:
    """sum_t gamma^t alpha_t(s, a) [r(s, a, s') + gamma V_{t+1}(s')], alpha of ``model``, on the entries of ``valued``."""
    from oee_tabular.exact import _finite

    back = Kernel(*rows_of(sparse.csr_array(policy_kernel(model, policy).T)), 1.0)
    rewards = as_readonly(np.zeros(0) if valued.reward_data is None else valued.reward_data)
    to_go, out = values_to_go(valued, policy, horizon), np.zeros(valued.transitions.nnz)
    entries = rows_of(valued.csr)
    _finite.gradient_flows(to_go, valued.discount, back, model.initial, entries, policy, rewards, out)
    return np.asarray(out * np.repeat(policy.reshape(-1), np.diff(valued.transitions.indptr)))


def policy_values_by_horizon(mdp: Model, policy: PolicyLike, *, horizon: int) -> Array:
    """J of every horizon up to T, from one pass: J_t = sum_{k<t} gamma^k E[r_k].

    Parameters
    ----------
    mdp : FiniteMDP (or a ReweightedModel, whose rows may have any sum)
    policy : (S, A), or (T, S, A): J_t is then of its first t steps
    horizon : T, a positive int

    Returns
    -------
    (T + 1,) array
        J_0 = 0, ..., J_T; entry t is ``policy_value(mdp, policy, horizon=t)``.

    Raises
    ------
    ValueError
        Bad arguments.

    Notes
    -----
    Cost: O(T nnz) over the states that are reached in t transitions, whatever the number of the others. A stationary
    policy's are the values at the first states during one backward sweep, any other's are summed forward.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> policy_values_by_horizon(coin, [[1.0]] * 2, horizon=3).tolist()
    [0.0, 0.5, 0.75, 0.875]
    """
    require_model(mdp)
    length = _checks.positive_integer(horizon, "horizon")
    length = limit_horizon(length, 1.0, work=mdp.transitions.nnz, kept=3)
    return values_by_horizon(mdp, check_policy_in_place(policy, mdp, length), length)
