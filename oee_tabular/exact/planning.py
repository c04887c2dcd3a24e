"""Optimal policies by modified policy iteration, certified by policy iteration.

Modified policy iteration sweeps over all actions, and then over the best actions [1,
6.5]. Actions depend only on differences between states. So the iteration ends when all
states change by nearly the same amount, which a discount near 1 does not delay. This
common change c would go on for ever: c gamma / (1 - gamma) is added to the values at
the end. Policy iteration with exact values follows, and certifies the policy.

Reference: [1] Puterman, Markov Decision Processes, 1994.
"""

from __future__ import annotations

import numpy as np

from oee_tabular import _checks
from oee_tabular._compiling import njit
from oee_tabular._keywords import suggest_keywords
from oee_tabular.exact import _system
from oee_tabular.exact.backup import back_up_pairs
from oee_tabular.exact.solvers.direct import EnvelopeLU
from oee_tabular.exact.system import Kernel, as_readonly, policy_system, rows_of
from oee_tabular.exact.values import (
    action_values,
    drop_unavailable,
    finite_values,
    infinite_values,
)
from oee_tabular.mdp import FiniteMDP, limit_horizon, uniform_policy
from oee_tabular.typing import Array, IntArray

MAX_TURNS = 100  # turns of modified policy iteration
# fewer turns where a graph is narrow: exact evaluation is as quick as some sweeps there
MAX_TURNS_NARROW = 3
# The tolerances are shares of the largest value. Sweeps end where the changes of the
# states differ by less than the first.
SPREAD_TOLERANCE = 1e-9
# An action is better where its value is larger by more than this, or by less where that
# adds up over time to more than ``MAX_TOTAL_LOSS``.
ACTION_TOLERANCE = 1e-11
MAX_TOTAL_LOSS = 1e-6
MIN_ACTION_TOLERANCE = 1e-14  # some roundings of a value


@suggest_keywords
def optimal_policy(mdp: FiniteMDP, *, horizon: int | None = None) -> Array:
    """Compute a deterministic optimal policy.

    Parameters
    ----------
    mdp : FiniteMDP
        The model.
    horizon : int, optional
        Number of rewards T, at t = 0..T-1. None means the infinite discounted sum.

    Returns
    -------
    ndarray of shape (S, A) or (T, S, A)
        Action probabilities, 0 or 1: a stationary policy without a horizon, one policy
        for each step with a horizon. Of equally good actions the first is taken that can
        be taken in the state.

    Raises
    ------
    ValueError
        At discount 1 without a horizon, if the iteration reaches a policy that is not
        absorbed.

    See Also
    --------
    action_values : Q of a policy, by which actions are compared.

    Notes
    -----
    Modified policy iteration runs until the greedy policy is stable, then policy
    iteration (Puterman, Markov Decision Processes, 1994, sections 6.5 and 6.4) with
    exact evaluation. An action changes only if another one is better by more than
    rounding (1e-11 of the largest value, less if 1 - discount is below 1e-5; the loss
    is below a millionth of that value up to discount 1 - 1e-8). With a horizon,
    backward induction costs O(T nnz).

    Examples
    --------
    >>> import oee_tabular as oee
    >>> rows = [[[1, 0], [0, 1]], [[0, 1], [0, 1]]]
    >>> mdp = oee.FiniteMDP(rows, [[1.0, 0.0], [2.0, 2.0]], [1, 0], 0.9)

    Leave state 0, for a reward of 2 a step from then on:

    >>> optimal_policy(mdp).argmax(axis=1).tolist()
    [1, 0]

    But not when there is no time left:

    >>> optimal_policy(mdp, horizon=3).argmax(axis=2).tolist()
    [[1, 0], [0, 0], [0, 0]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    steps = _checks.optional_horizon(horizon)
    # the reward -inf is never the largest: no such action is chosen
    model = rows_of(mdp.csr), drop_unavailable(mdp, mdp.rewards), mdp.discount
    if steps is not None:
        length = limit_horizon(
            steps, 1.0, work=mdp.transitions.nnz, kept=mdp.rewards.size
        )
        return np.asarray(np.eye(mdp.n_actions)[induce_backward(model, length)])
    # at discount 1 a greedy start may never be absorbed; the uniform policy is absorbed
    # if any policy is
    if mdp.discount == 1.0:
        actions = action_values(mdp, uniform_policy(mdp)).argmax(axis=1)
        values = None
    else:
        n_turns = MAX_TURNS_NARROW if is_narrow(mdp) else MAX_TURNS
        actions, values = iterate_modified(model, SPREAD_TOLERANCE, n_turns)
    tolerance = ACTION_TOLERANCE
    if mdp.discount < 1.0:
        # near discount 1 a small loss a step adds up to a large one
        limit = max(MAX_TOTAL_LOSS * (1.0 - mdp.discount), MIN_ACTION_TOLERANCE)
        tolerance = min(limit, ACTION_TOLERANCE)
    earlier: set[bytes] = set()
    choices: Array = np.eye(mdp.n_actions)
    while True:
        earlier.add(actions.tobytes())
        policy = choices[actions]
        values = finite_values(infinite_values(mdp, policy, near=values))
        first, actions = find_better_actions(mdp, values, actions, tolerance)
        if actions.tobytes() not in earlier:
            continue
        # among equals the first; at discount 1 an equal action may never be absorbed,
        # so the one evaluated stays
        return policy if mdp.discount == 1.0 else np.asarray(choices[first])


def is_narrow(mdp: FiniteMDP) -> bool:
    """Return whether LU in a band is quick for the values of most policies."""
    if mdp.n_states <= 100:
        return False
    # every A-th row pointer joins the rows of a state, which lead where its actions do
    rows = rows_of(mdp.csr)
    pointers = as_readonly(rows.indptr[:: mdp.n_actions])
    if _system.expands(Kernel(pointers, rows.indices, rows.data, 1.0)):
        return False
    return EnvelopeLU(is_narrow=True).suits(policy_system(mdp, uniform_policy(mdp)))


def find_better_actions(
    mdp: FiniteMDP, values: Array, actions: IntArray, relative: float
) -> tuple[IntArray, IntArray]:
    """Find each state's first best action up to rounding, and the actions that improve.

    Q = r + gamma P V for the values of ``actions``. The second result has ``actions``,
    but the first best action where it is better by more than ``relative`` of the
    largest Q.
    """
    q = back_up_pairs(mdp, values)
    allowed = relative * _system.largest_magnitude(q)
    q = drop_unavailable(mdp, q)
    best = q.max(axis=1)
    first = (q >= (best - allowed)[:, None]).argmax(axis=1)
    own = q[np.arange(len(q)), actions]
    return first, np.where(best > own + allowed, first, actions)


@njit(cache=True)
def action_value(model, values, state, action):
    """Compute Q(s, a) = r(s, a) + gamma sum_s' P(s' | s, a) V(s')."""
    (indptr, indices, data), rewards, discount = model
    row = np.uint64(state * rewards.shape[1] + action)
    total = 0.0
    for k in range(indptr[row], indptr[row + np.uint64(1)]):
        total += data[k] * values[indices[k]]
    return rewards[state, action] + discount * total


@njit(cache=True)
def improve(model, values, new, actions):
    """Compute new = max_a Q, and the best actions, the first of equals.

    Returns the spread of new - values over the states, and the largest value.
    """
    low = np.inf
    high = -np.inf
    largest = 0.0
    for state in range(len(values)):
        best = -np.inf
        chosen = 0
        for action in range(model[1].shape[1]):
            value = action_value(model, values, state, action)
            if value > best:
                best = value
                chosen = action
        new[state] = best
        actions[state] = chosen
        change = best - values[state]
        low = min(low, change)
        high = max(high, change)
        largest = max(largest, abs(best))
    return high - low, largest


@njit(cache=True)
def sweep_actions(model, actions, values, new):
    """Compute new = r + gamma P values for these actions.

    Returns the least and the largest change of a state.
    """
    low = np.inf
    high = -np.inf
    for state in range(len(actions)):
        new[state] = action_value(model, values, state, actions[state])
        change = new[state] - values[state]
        low = min(low, change)
        high = max(high, change)
    return low, high


@njit(cache=True)
def induce_backward(model, horizon):
    """Compute the best actions (T, S) with T - t rewards to go.

    V_t = max_a [r + gamma P V_{t+1}], V_T = 0.
    """
    n = len(model[1])
    value = np.zeros(n)
    ahead = np.zeros(n)
    actions = np.zeros((horizon, n), dtype=np.int64)
    for t in range(horizon - 1, -1, -1):
        improve(model, ahead, value, actions[t])
        value, ahead = ahead, value
    return actions


@njit(cache=True)
def iterate_modified(model, relative, n_turns):
    """Find actions (S,) by modified policy iteration, and approximate their values.

    V <- max_a [r + gamma P V], then V <- r_pi + gamma P_pi V up to 20 times, for at
    most ``n_turns`` turns or until the spread of the changes is ``relative`` of the
    values. The values are then swept to rounding while four sweeps halve the residual,
    as they do where a graph mixes.
    """
    n = len(model[1])
    discount = model[2]
    # turns of modified policy iteration: the best actions, then sweeps of their values
    values = np.zeros(n)
    new = np.empty(n)
    actions = np.zeros(n, dtype=np.int64)
    for _ in range(n_turns):
        spread, largest = improve(model, values, new, actions)
        values, new = new, values
        if not spread > relative * largest:
            break
        for _ in range(20):
            low, high = sweep_actions(model, actions, values, new)
            values, new = new, values
            if high - low <= 0.1 * spread:
                break
    # the values of the last actions, until four sweeps leave over half of the spread
    factor = discount / (1.0 - discount)
    allowed = np.inf
    for turn in range(200):
        low, high = sweep_actions(model, actions, values, new)
        values, new = new, values
        shift = factor * 0.5 * (low + high)
        if not high - low > 2e-16 * max(largest, abs(shift)) or (
            turn % 4 == 0 and high - low > allowed
        ):
            break
        if turn % 4 == 0:
            allowed = 0.5 * (high - low)
    return actions, values + shift
