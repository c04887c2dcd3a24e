"""Values and occupancies of finite horizons, carried out as they stand.

    V_t = r_pi + gamma P_pi V_{t+1}, V_T = 0;    d_{t+1} = P_pi^T d_t, d_0 = mu_0
    J = mu_0 . V_0 = sum_t gamma^t d_t . r_pi

Where only J is wanted, T rewards can depend on no more than the states that T - 1
transitions reach: rows of P_pi are made for these alone (the light cone of the support
of mu_0), and each step backward leaves its outermost ring out.

Rows are read four entries at a time, with unsigned indices: signed ones, which could
count from the end, cost twice as much. Every sum keeps the order of its row.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from oee_tabular import _checks
from oee_tabular._compiling import njit
from oee_tabular._sparse import repeat_rows
from oee_tabular.exact._system import average_rewards
from oee_tabular.exact.reweighted import Model, require_model
from oee_tabular.exact.system import (
    Kernel,
    as_readonly,
    average_rows_of,
    policy_system,
    rows_of,
)
from oee_tabular.mdp import check_policy, limit_horizon
from oee_tabular.typing import Array, IntArray, PolicyLike

# a long sum is a sum of sums of so many terms each: its rounding grows with n / 128
N_CHUNK_TERMS = 128

# what compiled loops get for an argument that is not wanted
NOTHING: Array = np.zeros(0)
NO_INITIAL: Array = as_readonly(np.zeros(0))
NO_ENDS: IntArray = np.zeros(0, dtype=np.int64)


class Cone(NamedTuple):
    """Hold the light cone of the first states, with new numbers for its states.

    ``states`` has their old numbers. They stand in the order in which they are first
    reached: k transitions reach the first ends[k] of them at most.
    """

    states: Any
    ends: Any
    kernel: Kernel
    rewards: Array
    initial: Array


def light_cone(model: Model, policy: Array, horizon: int) -> Cone:
    """Find the states that ``horizon`` rewards of a stationary policy can depend on."""
    rows = rows_of(model.csr)
    # numpy's zeros cost nothing until they are touched; a kernel would write its own
    place = np.zeros(model.n_states, np.uint32)
    # only what is filled becomes memory
    states = np.empty(model.n_states, np.uint32)
    ends = np.zeros(horizon, np.int64)
    n_entries = reach_forward(
        *rows,
        as_readonly(policy),
        as_readonly(model.initial),
        np.count_nonzero(model.initial),
        states,
        place,
        ends,
    )
    states = states[: ends[-1]]
    # states that are reached last give a reward, but their transitions do not count
    leaving = states[: ends[-2] if horizon > 1 else 0]
    averaged = average_rows_of(leaving, rows, policy, place, n_entries)
    kernel = Kernel(*averaged, model.discount)
    given = model.rewards[states]
    initial = model.initial[states[: ends[0]]]
    # kernels are compiled for read-only arrays alone
    given.flags.writeable = False
    initial.flags.writeable = False
    rewards, _ = average_rewards(policy[states], given)
    return Cone(states, ends, kernel, rewards, initial)


def values_by_horizon(
    model: Model, policy: Array, horizon: int, *, is_each: bool = True
) -> Array:
    """Compute J of 0 .. T rewards, (T + 1,), for a policy that has been checked.

    Unless ``is_each``, the last entry alone is filled in for a stationary policy.
    """
    if policy.ndim == 3:
        return _sum_forward(model, policy, np.zeros((0, 0)))
    return sweep_cone(light_cone(model, policy, horizon), is_each)


def sweep_cone(cone: Cone, is_each: bool) -> Array:
    """Compute J of 0 .. T rewards, (T + 1,), on a light cone.

    V_k = r + gamma K V_{k-1} with k rewards to go, J_k = mu_0 . V_k; each step leaves a
    ring of the cone out. Unless ``is_each``, the last entry alone is filled in.
    """
    horizon = len(cone.ends)
    totals = np.zeros(horizon + 1)
    out = np.empty((2, len(cone.rewards)))
    out[(horizon - 1) % 2] = cone.rewards
    sweep(
        *cone.kernel,
        cone.rewards,
        horizon,
        cone.ends,
        out,
        cone.initial,
        totals if is_each else NOTHING,
        0.0,
        0.0,
        0.0,
    )
    totals[-1] = dot(cone.initial, out[0], len(cone.initial))
    if is_each:
        totals[1] = dot(cone.initial, cone.rewards, len(cone.initial))
    return totals


def initial_mean(model: Model, values: Array) -> float:
    """Compute mu_0 . V over the states where episodes start.

    The values of the other states may be infinite.
    """
    return float(dot(model.initial, values, len(values)))


def visits(model: Model, policy: Array, horizon: int) -> Array:
    """Compute sum_{t<T} gamma^t Pr(s_t = s, a_t = a), of shape (S, A)."""
    pairs = np.zeros((model.n_states, model.n_actions))
    if policy.ndim == 2:
        cone = light_cone(model, policy, horizon)
        pairs[cone.states] = visit_cone(cone)[:, None] * policy[cone.states]
    else:
        _sum_forward(model, policy, pairs)
    return pairs


def visit_cone(cone: Cone) -> Array:
    """Compute sum_{t<T} gamma^t Pr(s_t = s) for the states of a light cone."""
    here, there, total = np.zeros((3, cone.ends[-1]))
    here[: len(cone.initial)] = cone.initial
    add_visits(*cone.kernel, cone.ends, here, there, total)
    return np.asarray(total)


def _sum_forward(model: Model, policy: Array, pairs: Array) -> Array:
    """Compute J of 0 .. T rewards forward in time, for a policy (T, S, A)."""
    values = step_forward(
        rows_of(model.csr),
        as_readonly(model.rewards),
        as_readonly(policy),
        as_readonly(model.initial),
        model.discount,
        pairs,
    )
    return np.asarray(values)


def values_to_go(
    model: Model, policy: Array, horizon: int, *, is_each: bool = True
) -> Array:
    """Compute V_t (T + 1, S) of a stationary policy that has been checked.

    Row t has T - t rewards to go. Unless ``is_each``, V_0 alone is returned, (1, S).
    """
    out = np.empty((horizon + 1 if is_each else 2, model.n_states))
    rewards, _ = average_rewards(policy, model.rewards)
    sweep_all(policy_system(model, policy).kernel, rewards, horizon, out)
    return out if is_each else out[:1]


def sweep_all(
    kernel: Kernel,
    rewards: Array,
    horizon: int,
    out: Array,
    carried: float = 0.0,
    each: float = 0.0,
    of_rewards: float = 0.0,
) -> tuple[float, float]:
    """Compute V_t of all states into row t % len(out) of ``out``.

    Returns the largest magnitude in V_0, and e_0 where e_t = carried (e_{t+1} + each
    ``|V_{t+1}|_inf``) + of_rewards, e_T = 0.
    """
    # V_T, where there is room for it
    out[horizon % len(out)] = 0.0
    out[(horizon - 1) % len(out)] = rewards
    size, error = sweep(
        *kernel,
        rewards,
        horizon,
        NO_ENDS,
        out,
        NO_INITIAL,
        NOTHING,
        carried,
        each,
        of_rewards,
    )
    return size, error


def gradient_to_horizon(
    model: Model, valued: Model, policy: Array, horizon: int
) -> Array:
    """Compute the gradient of J for a horizon, on the entries of ``valued``.

    sum_t gamma^t alpha_t(s, a) [r(s, a, s') + gamma V_{t+1}(s')], alpha of ``model``, r
    and V of ``valued``.
    """
    kernel = policy_system(model, policy).kernel
    # empty where rewards do not depend on s'
    data = np.zeros(0) if valued.reward_data is None else valued.reward_data
    rewards = as_readonly(data)
    to_go = values_to_go(valued, policy, horizon)
    out = np.zeros(valued.csr.nnz)
    here, there = np.zeros((2, model.n_states))
    here[:] = model.initial
    indptr, columns, _ = rows_of(valued.csr)
    add_flows(
        to_go,
        valued.discount,
        *kernel[:3],
        indptr,
        columns,
        policy,
        rewards,
        here,
        there,
        out,
    )
    return np.asarray(out * repeat_rows(valued.csr, policy.reshape(-1)))


def policy_values_by_horizon(mdp: Model, policy: PolicyLike, *, horizon: int) -> Array:
    """Compute J of every horizon up to T in one pass: J_t = sum_{k<t} gamma^k E[r_k].

    Parameters
    ----------
    mdp : FiniteMDP or ReweightedModel
        The model in which the policy is evaluated. The rows of a ReweightedModel may
        have any sum.
    policy : PolicyLike
        Action probabilities of shape (S, A), or (T, S, A): J_t is then the value of its
        first t steps.
    horizon : int
        The largest number of rewards T.

    Returns
    -------
    ndarray of shape (T + 1,)
        J_0 = 0, ..., J_T; entry t is ``policy_value(mdp, policy, horizon=t)``.

    Raises
    ------
    ValueError
        If an argument is bad.

    See Also
    --------
    policy_value : J of one horizon, or of the infinite sum.

    Notes
    -----
    Costs O(T nnz) over the states that are reached in t transitions, whatever the
    number of the others. For a stationary policy these are the values at the first
    states during one backward sweep; any other policy's rewards are summed forward.

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
    return values_by_horizon(mdp, check_policy(policy, mdp, horizon=length), length)


@njit(cache=True)
def dot(x, y, size):
    """Compute x . y over the first ``size`` entries.

    Where x is 0, y may be infinite.
    """
    total = 0.0
    part = 0.0
    terms = 0
    for i in range(size):
        if x[i] != 0.0:
            part += x[i] * y[i]
            terms += 1
            if terms == N_CHUNK_TERMS:
                total = total + part
                part = 0.0
                terms = 0
    return total + part


@njit(cache=True)
def sweep(
    indptr,
    indices,
    data,
    gamma,
    rewards,
    horizon,
    ends,
    out,
    initial,
    totals,
    carried,
    each,
    of_rewards,
):
    """Compute V_t = r + gamma K V_{t+1} for t = T-2 .. 0, where V_{T-1} = r is given.

    V_t stands in row t % len(out) of ``out``, and where ``ends`` (T,) has any, in the
    first ends[t] states alone. Where ``totals`` (T + 1,) has room, it takes mu_0 . V_t
    at T - t. Returns the largest magnitude in V_0, and e_0 where e_t = carried (e_{t+1}
    + each ``|V_{t+1}|_inf``) + of_rewards, e_T = 0.
    """
    one = np.uint64(1)
    two = np.uint64(2)
    three = np.uint64(3)
    four = np.uint64(4)
    largest = 0.0
    for s in range(len(rewards)):
        size = abs(rewards[s])
        if not size <= largest:  # nan as well
            largest = size
    error = of_rewards
    last = np.uint64(len(rewards))
    for t in range(horizon - 2, -1, -1):
        error = carried * (error + each * largest) + of_rewards
        largest = 0.0
        ahead = out[(t + 1) % len(out)]
        here = out[t % len(out)]
        if len(ends) > 0:
            last = np.uint64(ends[t])
        x = np.uint64(0)
        for s in range(last):
            end = np.uint64(indptr[s + one])
            total = 0.0
            # four entries at a time, but one addition after the other all the same
            while x + four <= end:
                total += data[x] * ahead[indices[x]]
                total += data[x + one] * ahead[indices[x + one]]
                total += data[x + two] * ahead[indices[x + two]]
                total += data[x + three] * ahead[indices[x + three]]
                x += four
            while x < end:
                total += data[x] * ahead[indices[x]]
                x += one
            total = rewards[s] + gamma * total
            here[s] = total
            size = abs(total)
            if not size <= largest:
                largest = size
        if len(totals) > 0:
            totals[horizon - t] = dot(initial, here, len(initial))
    return largest, error


@njit(cache=True)
def reach_forward(
    indptr, indices, data, policy, initial, n_initial, states, place, ends
):
    """Find the states that len(ends) - 1 transitions reach, as they are discovered.

    R_0 = support of mu_0, which has ``n_initial`` states, R_{t+1} = R_t and what its
    rows lead to. ``states`` (S,) takes them, ``ends`` how many of them k transitions
    reach, ``place`` (S,), zeros before, 1 + each state's number; what is not reached is
    not read. Returns how many entries their rows have.
    """
    n_actions = policy.shape[1]
    count = 0
    n_done = 0
    n_entries = 0
    for s in range(len(initial)):
        if count == n_initial:
            break
        if initial[s] != 0.0:
            states[count] = s
            count += 1
            place[s] = count
    ends[0] = count
    # ring by ring: what the states lead to that were reached last
    for t in range(1, len(ends)):
        for i in range(n_done, ends[t - 1]):
            state = np.int64(states[i])
            row = state * n_actions
            n_entries += np.int64(indptr[row + n_actions]) - np.int64(indptr[row])
            for a in range(n_actions):
                share = policy[state, a]
                if share == 0.0:
                    continue
                for k in range(indptr[row + a], indptr[row + a + 1]):
                    if place[indices[k]] == 0 and share * data[k] != 0.0:
                        states[count] = indices[k]
                        count += 1
                        place[indices[k]] = count
        n_done = ends[t - 1]
        ends[t] = count
    return n_entries


@njit(cache=True)
def add_visits(indptr, indices, data, gamma, ends, here, there, total):
    """Add sum_{t<T} gamma^t d_t to ``total``, d_{t+1} = K^T d_t, d_0 = ``here``.

    d_t is read in the first ends[t] states, which t transitions reach. ``there`` begins
    with zeros.
    """
    one = np.uint64(1)
    weight = 1.0
    for t in range(len(ends) - 1):
        x = np.uint64(0)
        for i in range(np.uint64(ends[t])):
            own = here[i]
            total[i] += weight * own
            # zero again for the step after next
            here[i] = 0.0
            end = np.uint64(indptr[i + one])
            while x < end:
                there[indices[x]] += data[x] * own
                x += one
        here, there = there, here
        weight *= gamma
    for i in range(len(total)):
        total[i] += weight * here[i]


@njit(cache=True)
def step_forward(rows, rewards, policy, initial, gamma, pairs):
    """Compute J of 0 .. T rewards, (T + 1,), of a policy (T, S, A), forward in time.

    d_{t+1}(s') = sum_{s, a} d_t(s) policy_t(s, a) K(s' | s, a), J_{t+1} = J_t + gamma^t
    d_t . r. The policy is read as a whole before, so that S numbers a step cost
    nothing. Where ``pairs`` (S, A) has room, sum_t gamma^t Pr(s_t = s, a_t = a) is
    added to it.
    """
    indptr, indices, data = rows
    horizon, n_states, n_actions = policy.shape
    out = np.zeros(horizon + 1)
    keep = len(pairs) > 0
    here = initial.copy()
    there = np.zeros(n_states)
    mean = np.zeros(n_states)
    weight = 1.0
    for t in range(horizon):
        for s in range(n_states):
            mass = here[s]
            mean[s] = 0.0
            if mass == 0.0:
                continue
            for a in range(n_actions):
                share = mass * policy[t, s, a]
                mean[s] += policy[t, s, a] * rewards[s, a]
                if keep:
                    pairs[s, a] += weight * share
                if share == 0.0 or t + 1 == horizon:
                    continue
                row = s * n_actions + a
                for k in range(indptr[row], indptr[row + 1]):
                    there[indices[k]] += share * data[k]
        out[t + 1] = out[t] + weight * dot(here, mean, n_states)
        weight *= gamma
        here[:] = 0.0
        here, there = there, here
    return out


@njit(cache=True)
def add_flows(
    to_go,
    gamma,
    starts,
    following,
    data,
    indptr,
    columns,
    policy,
    rewards,
    here,
    there,
    out,
):
    """Add sum_t gamma^t d_t(s) (r[k] + gamma V_{t+1}(s')) to out[k] for each entry k.

    d_{t+1} = K^T d_t, d_0 = ``here``; K has the rows ``starts``, ``following`` and
    ``data``. Only entries of actions that are taken count. ``to_go`` (T + 1, S) is V;
    ``indptr`` and ``columns`` have the entries k, and ``rewards`` r(s, a, s') is
    aligned with them or empty.
    """
    n_states, n_actions = policy.shape
    has_rewards = len(rewards) > 0
    weight = 1.0
    for t in range(len(to_go) - 1):
        for s in range(n_states):
            there[s] = 0.0
        for s in range(n_states):
            own = here[s]
            if own == 0.0:
                continue
            for k in range(starts[s], starts[s + 1]):
                there[following[k]] += data[k] * own
            mass = weight * own
            for a in range(n_actions):
                if policy[s, a] == 0.0:
                    continue
                row = s * n_actions + a
                for k in range(indptr[row], indptr[row + 1]):
                    gain = gamma * to_go[t + 1, columns[k]]
                    if has_rewards:
                        gain += rewards[k]
                    out[k] += mass * gain
        here, there = there, here
        weight *= gamma
