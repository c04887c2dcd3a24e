"""Optimal policies: modified policy iteration, then policy iteration with exact values, which certifies."""

from __future__ import annotations

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array
from oee_tabular.exact.system import policy_system, rows_of
from oee_tabular.exact.values import action_values, infinite_values, warn_if_not_finite
from oee_tabular.mdp import FiniteMDP
from oee_tabular.mdp.horizons import limit_horizon
from oee_tabular.mdp.policies import deterministic_policy

N_TURNS_BEFORE = 3  # of modified policy iteration, after which the graph of the greedy policy is looked at


def optimal_policy(mdp: FiniteMDP, *, horizon: int | None = None) -> Array:
    """A deterministic optimal policy: (S, A), or (T, S, A) for a horizon T.

    Modified policy iteration until the actions stand, then policy iteration (Puterman, Markov Decision Processes, 1994,
    sections 6.5 and 6.4) with exact evaluation, once where they were right: an action is changed only where another one is
    better by more than rounding (1e-11 of the largest value, and less where 1 - discount is below 1e-5: what is lost so stays
    below a millionth of it up to discount 1 - 1e-8); of equally good actions the first is taken. With a horizon, backward
    induction.

    Parameters
    ----------
    mdp : FiniteMDP
    horizon : T, a positive int, or None

    Raises
    ------
    ValueError
        At discount 1 without a horizon, where a policy met on the way is not absorbed.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> mdp = oee.FiniteMDP([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], [[1.0, 0.0], [2.0, 2.0]], [1, 0], 0.9)
    >>> optimal_policy(mdp).argmax(axis=1).tolist()  # leave state 0, for 2 a step from then on
    [1, 0]
    >>> optimal_policy(mdp, horizon=3).argmax(axis=2).tolist()  # but not when there is no time left
    [[1, 0], [0, 0], [0, 0]]
    """
    from oee_tabular.exact import _planning
    from oee_tabular.exact.solvers.envelope import EnvelopeLU

    _checks.instance(mdp, FiniteMDP, "mdp")
    steps = _checks.optional_horizon(horizon)
    if steps is not None:
        size = mdp.rewards.size
        return _backward_induction(mdp, limit_horizon(steps, 1.0, work=mdp.transitions.nnz, kept=size))
    model = rows_of(mdp.csr), mdp.rewards, mdp.discount
    if mdp.discount == 1.0:  # a greedy start may never be absorbed; the uniform policy is, if any is
        uniform = np.full((mdp.n_states, mdp.n_actions), 1.0 / mdp.n_actions)
        actions, values = action_values(mdp, uniform).argmax(axis=1), None
    else:
        n_turns = N_TURNS_BEFORE if mdp.n_states > 100 else 100
        actions, values, stands = _planning.iterate_modified(*model, 1e-9, np.zeros(mdp.n_states), n_turns)
        if not stands and n_turns < 100:
            system = policy_system(mdp, deterministic_policy(actions, mdp.n_actions))
            if not EnvelopeLU(is_narrow=True).suits(system):  # else exact evaluation is as quick as some sweeps
                actions, values, _ = _planning.iterate_modified(*model, 1e-9, values, 100)
    rounding = 1e-11 if mdp.discount == 1.0 else min(max(1e-6 * (1.0 - mdp.discount), 1e-14), 1e-11)
    met: set[bytes] = set()
    while True:
        met.add(actions.tobytes())
        policy = deterministic_policy(actions, mdp.n_actions)
        values = infinite_values(mdp, policy, near=values).values
        first, better = _planning.find_better_actions(*model, warn_if_not_finite(values), actions, rounding)
        if not better.any() or np.where(better, first, actions).tobytes() in met:
            # among equals the first; at discount 1 an equal action may never be absorbed, so the one evaluated stays
            return policy if mdp.discount == 1.0 else deterministic_policy(first, mdp.n_actions)
        actions = np.where(better, first, actions)


def _backward_induction(mdp: FiniteMDP, horizon: int) -> Array:
    policy = np.zeros((horizon, mdp.n_states, mdp.n_actions))
    value = np.zeros(mdp.n_states)
    for t in range(horizon - 1, -1, -1):
        q = mdp.rewards + mdp.discount * (mdp.transitions @ value).reshape(mdp.rewards.shape)
        actions = q.argmax(axis=1)
        policy[t] = deterministic_policy(actions, mdp.n_actions)
        value = q[np.arange(mdp.n_states), actions]
    return policy
