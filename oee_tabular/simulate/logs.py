"""Sampled episodes and transitions, written out as logs."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular._sparse import row_of_entry
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import horizon_length
from oee_tabular.simulate.sampler import BAG_STREAM, LOG_STREAM, Drawn, draw, entry_rewards


def sample_episodes(mdp: FiniteMDP, policy: PolicyLike, n_episodes: int, horizon: int, *, seed: Seed) -> Transitions:
    """Sample episodes from the initial distribution, each of at most ``horizon`` steps.

    An episode terminates on entering an absorbing state with reward 0; one that reaches the horizon is
    truncated. Rewards are r(s, a, s') if the MDP has them, else r(s, a).

    Parameters
    ----------
    mdp : FiniteMDP
    policy : (S, A)
    n_episodes, horizon : positive int
    seed : anything that ``numpy.random.default_rng`` takes; a Generator is advanced

    Returns
    -------
    Transitions
        With episodes, timesteps and the behaviour probabilities of ``policy``. An episode whose first state is
        already absorbing has one step.

    Notes
    -----
    O(1) a step, after O(nnz) for the alias table; nothing is padded.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> target = oee.tasks.gridworld(3, slip=0.1)
    >>> sample_episodes(target, oee.tasks.gridworld_expert(3), 10, horizon=20, seed=0)
    Transitions(44 transitions in 10 episodes of 4 to 6 steps: 10 terminated, 0 truncated;
                states 0..8, actions 0..2; rewards -0.6 to 0; behaviour probabilities)
    """
    n = _checks.positive_integer(n_episodes, "n_episodes")
    _checks.require_memory(9.0 * n, "n_episodes", n)  # a row each, at least
    _checks.instance(mdp, FiniteMDP, "mdp")
    steps = _checks.positive_integer(horizon, "horizon")
    if steps > 10**6 / n:  # no log of a million transitions is cut
        steps = max(horizon_length(horizon, mdp), 10**6 // n)
    pi = check_policy(policy, mdp)
    drawn = draw(mdp, pi, n, steps, seed=seed, stream=LOG_STREAM, record=True)
    return episode_log(mdp, drawn, pi)


def episodes_holding(mdp: FiniteMDP, policy: PolicyLike, n: int, horizon: int, *, seed: Seed) -> Transitions:
    """Whole episodes that together have at least n transitions.

    As many as would do if none ended early, and more where they do. A Generator draws afresh at each try;
    of any other seed the episodes tried before stay.
    """
    count = max(1, -(-n // horizon))
    while len(log := sample_episodes(mdp, policy, count, horizon, seed=seed)) < n:
        count = int(np.ceil(1.2 * count * n / len(log))) + 1
    return log


def sample_transitions(mdp: FiniteMDP, distribution: object, n: int, *, seed: Seed) -> Transitions:
    """Sample n independent transitions: (s, a) from ``distribution`` (S, A), s' from P(. | s, a).

    There are no episodes and no termination: absorbing states are sampled like any other.

    Parameters
    ----------
    mdp : FiniteMDP
    distribution : (S, A), sums to 1; (S0, A) of the environment's own states does too, where the MDP has twins
    n : positive int
    seed : as in ``sample_episodes``

    Returns
    -------
    Transitions

    Notes
    -----
    O(1) a transition, after O(nnz) for the alias table.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> sample_transitions(coin, [[0.5], [0.5]], 1000, seed=0).counts(2, 1).toarray().tolist()
    [[255.0, 247.0], [241.0, 257.0]]
    """
    _checks.instance(mdp, FiniteMDP, "mdp")
    size = _checks.positive_integer(n, "n")
    weights = _checks.float_array(distribution, "distribution", ndim=2)
    own = len(mdp.terminal_state)
    if weights.shape == (own, mdp.n_actions):  # of the environment's own shape: twins are not drawn from
        weights = np.concatenate([weights, np.zeros((mdp.n_states - own, mdp.n_actions))])
    weights = _checks.distribution(weights, "distribution", (mdp.n_states, mdp.n_actions))
    pairs, every = weights.reshape(-1), np.ones((weights.size, 1))
    path = draw(mdp, every, size, 1, seed=seed, record=True, pairs=pairs, stream=BAG_STREAM, name="n").path
    state, action = np.divmod(row_of_entry(mdp.transitions)[path], mdp.n_actions)
    return Transitions(state, action, mdp.transitions.indices[path], entry_rewards(mdp)[path])


def episode_log(mdp: FiniteMDP, drawn: Drawn, policy: Array) -> Transitions:
    """Recorded episodes as a log, column by column: what was drawn here needs no checks, which take longer than drawing."""
    from oee_tabular.simulate._rollout import write_columns

    n, indices = len(drawn.path), mdp.transitions.indices
    integers, numbers, flags = np.empty((5, n), dtype=np.int64), np.empty((2, n)), np.zeros((2, n), dtype=np.bool_)
    entries = row_of_entry(mdp.transitions), indices, entry_rewards(mdp)
    write_columns(drawn.path, drawn.lengths, *entries, policy, mdp.absorbing(), integers, numbers, flags)
    columns = dict(zip(("state", "action", "next_state", "timestep", "episode"), integers, strict=True))
    columns |= {"reward": numbers[0], "behavior_probability": numbers[1], "terminated": flags[0], "truncated": flags[1]}
    log = object.__new__(Transitions)
    for field in fields(Transitions):
        column = columns.get(field.name)
        object.__setattr__(log, field.name, None if column is None else _checks.freeze(column))
    return log
