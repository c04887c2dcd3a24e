"""Sampled episodes and transitions, written out as logs."""

from __future__ import annotations

from typing import Any

import numpy as np

from oee_tabular import _checks
from oee_tabular._checks import Array, PolicyLike, Seed
from oee_tabular.data import Transitions
from oee_tabular.mdp import FiniteMDP, check_policy
from oee_tabular.mdp.horizons import horizon_length


def stream_key(seed: Seed) -> np.uint64:
    """A 64-bit key from anything that ``numpy.random.default_rng`` takes."""
    return np.uint64(_checks.generator(seed).integers(0, 2**64, dtype=np.uint64))


def sample_episodes(mdp: FiniteMDP, policy: PolicyLike, n_episodes: int, horizon: int, *, seed: Seed) -> Transitions:
    """Episodes from the initial distribution, each of at most ``horizon`` steps.

    An episode terminates on entering an absorbing state that pays nothing; one that is still going at the horizon is
    truncated. Rewards are r(s, a, s') where the MDP has them, else r(s, a).

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
    Compiled; O(log of the row length) per step; two passes, so that nothing is padded.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> target = oee.tasks.gridworld(3, slip=0.1)
    >>> sample_episodes(target, oee.tasks.gridworld_expert(3), 10, horizon=20, seed=0)
    Transitions(47 transitions in 10 episodes of 4 to 7 steps: 10 terminated, 0 truncated;
                states 0..8, actions 0..2; rewards -0.8 to 0; behaviour probabilities)
    """
    from oee_tabular.simulate import _rollout as rollout

    n = _checks.positive_integer(n_episodes, "n_episodes")
    _checks.require_memory(9.0 * n, "n_episodes", n)  # a row each, at least
    _checks.instance(mdp, FiniteMDP, "mdp")
    steps = _checks.positive_integer(horizon, "horizon")
    if steps > 10**6 / n:  # no log of a million moves is cut
        steps = max(horizon_length(horizon, mdp), 10**6 // n)
    pi = check_policy(policy, mdp)
    key = stream_key(seed)
    indptr = mdp.transitions.indptr.astype(np.int64)
    indices = mdp.transitions.indices.astype(np.int64)
    cumulative = rollout.running_sums(mdp.transitions.data, indptr)
    initial, table = np.cumsum(mdp.initial), np.cumsum(pi, axis=1)
    over = mdp.absorbing()
    lengths = rollout.episode_lengths(key, n, steps, initial, table, indptr, indices, cumulative, over)
    starts = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    rows, entries = rollout.episodes(key, starts, initial, table, indptr, indices, cumulative)
    return episode_log(mdp, rows, entries, starts, pi)


def episodes_holding(
    mdp: FiniteMDP, policy: PolicyLike, n: int, horizon: int, *, seed: Seed, first: int | None = None
) -> Transitions:
    """Whole episodes that together have at least n moves: ``first`` of them, or as many as would do if none ended early, and
    more where they do. A Generator draws afresh at each try; of any other seed the episodes tried before stay.
    """
    count = max(1, -(-n // horizon)) if first is None else first
    while len(log := sample_episodes(mdp, policy, count, horizon, seed=seed)) < n:
        count = int(np.ceil(1.2 * count * n / len(log))) + 1
    return log


def sample_transitions(mdp: FiniteMDP, distribution: object, n: int, *, seed: Seed) -> Transitions:
    """n independent moves: (s, a) from ``distribution`` (S, A), s' from P(. | s, a).

    A bag, without episodes or termination: absorbing states are drawn from like any other.

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
    Compiled; O(log(S A)) per move.

    Examples
    --------
    >>> import oee_tabular as oee
    >>> coin = oee.FiniteMDP([[[0.5, 0.5]]] * 2, [0.0, 1.0], [0.5, 0.5], 0.5)
    >>> sample_transitions(coin, [[0.5], [0.5]], 1000, seed=0).counts(2, 1).toarray().tolist()
    [[222.0, 263.0], [262.0, 253.0]]
    """
    from oee_tabular.simulate import _rollout as rollout

    _checks.instance(mdp, FiniteMDP, "mdp")
    size = _checks.positive_integer(n, "n")
    _checks.require_memory(4.0 * size, "n", size)
    weights = _checks.float_array(distribution, "distribution", ndim=2)
    own = len(mdp.terminal_state)
    if weights.shape == (own, mdp.n_actions):  # of the environment's own shape: twins are not drawn from
        weights = np.concatenate([weights, np.zeros((mdp.n_states - own, mdp.n_actions))])
    weights = _checks.distribution(weights, "distribution", (mdp.n_states, mdp.n_actions))
    indptr = mdp.transitions.indptr.astype(np.int64)
    cumulative = rollout.running_sums(mdp.transitions.data, indptr)
    rows, entries = rollout.transitions(stream_key(seed), size, np.cumsum(weights.reshape(-1)), indptr, cumulative)
    return _as_log(mdp, rows, entries)


def episode_log(mdp: FiniteMDP, rows: Any, entries: Any, starts: Any, policy: Array) -> Transitions:
    """Episodes as rows s*A + a and entries of P, in the ragged places ``starts``."""
    terminated = np.zeros(len(rows), dtype=np.bool_)
    last = starts[1:] - 1
    terminated[last] = mdp.absorbing()[mdp.transitions.indices[entries[last]]]
    episode = np.repeat(np.arange(len(last)), np.diff(starts))
    return _as_log(mdp, rows, entries, terminated=terminated, episode=episode, policy=policy)


def _as_log(
    mdp: FiniteMDP, rows: Any, entries: Any, *, terminated: Any = None, episode: Any = None, policy: Array | None = None
) -> Transitions:
    state, action = rows // mdp.n_actions, rows % mdp.n_actions
    reward = mdp.rewards[state, action] if mdp.reward_data is None else mdp.reward_data[entries]
    return Transitions(
        state,
        action,
        mdp.transitions.indices[entries],
        reward,
        terminated=terminated,
        episode=episode,
        behavior_probability=None if policy is None else policy[state, action],
    )
