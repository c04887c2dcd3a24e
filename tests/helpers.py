"""What several tests need: random MDPs, dense oracles that share no code with the package, and its full enumeration."""

import itertools
import os
import subprocess
import sys

import numpy as np
from hypothesis import strategies as st
from scipy import sparse

from oee_tabular import FiniteMDP
from oee_tabular.mdp.rows import Rows


def integer_distribution(rng, size, zeros=0.3):
    """A distribution from small integer weights: exact zeros, never 1e-300s."""
    weights = rng.integers(1, 10, size=size) * (rng.random(size) >= zeros)
    if weights.sum() == 0:
        weights[rng.integers(size)] = 1
    return weights / weights.sum()


def random_mdp(rng, *, n_states=None, n_actions=None, discount=None, form=None, zeros=0.3, like=None):
    """A random MDP with exact zeros; ``form`` of rewards 1 = r(s), 2 = r(s, a), 3 = r(s, a, s').

    ``like``: other dynamics for that MDP, inside its support (so that a ratio exists).
    """
    if like is not None:
        dense = like.transitions.toarray()
        rows = []
        for row in dense:
            support = np.flatnonzero(row)
            new = np.zeros(len(row))
            new[support] = integer_distribution(rng, len(support), zeros=0.2)
            rows.append(new)
        return like.with_transitions(np.array(rows).reshape(like.n_states, like.n_actions, -1))
    n_states = n_states or int(rng.integers(1, 8))
    n_actions = n_actions or int(rng.integers(1, 4))
    transitions = np.array(
        [[integer_distribution(rng, n_states, zeros) for _ in range(n_actions)] for _ in range(n_states)]
    )
    form = form or int(rng.integers(1, 4))
    shape = (n_states, n_actions, n_states)[:form]
    rewards = rng.integers(-5, 6, size=shape).astype(float)
    discount = discount if discount is not None else float(rng.choice([0.0, 0.5, 0.9, 0.99]))
    return FiniteMDP(transitions, rewards, integer_distribution(rng, n_states), discount)


def random_policy(rng, mdp, zeros=0.3):
    return np.array([integer_distribution(rng, mdp.n_actions, zeros) for _ in range(mdp.n_states)])


seeds = st.integers(0, 2**32 - 1)
rngs = seeds.map(np.random.default_rng)


def dense(mdp):
    """(S, A, S) transitions and rewards of the same shape."""
    shape = (mdp.n_states, mdp.n_actions, mdp.n_states)
    transitions = mdp.transitions.toarray().reshape(shape)
    if mdp.transition_rewards is None:
        return transitions, np.broadcast_to(mdp.rewards[:, :, None], shape)
    return transitions, mdp.transition_rewards.toarray().reshape(shape)


def dense_values(mdp, policy):
    """V = (I - gamma P_pi)^-1 r_pi with numpy alone."""
    transitions, rewards = dense(mdp)
    kernel = np.einsum("sa,sat->st", policy, transitions)
    paid = np.einsum("sa,sat,sat->s", policy, transitions, rewards)
    return np.linalg.solve(np.eye(mdp.n_states) - mdp.discount * kernel, paid)


def dense_occupancy(mdp, policy):
    """(S, A) normalised discounted occupancy with numpy alone."""
    transitions, _ = dense(mdp)
    kernel = np.einsum("sa,sat->st", policy, transitions)
    states = np.linalg.solve(np.eye(mdp.n_states) - mdp.discount * kernel.T, (1 - mdp.discount) * mdp.initial)
    return states[:, None] * policy


def paths(mdp, policy, horizon):
    """Every path of ``horizon`` moves with its probability: (probability, [(s, a, s', r), ...])."""
    transitions, rewards = dense(mdp)
    for states in itertools.product(range(mdp.n_states), repeat=horizon + 1):
        for actions in itertools.product(range(mdp.n_actions), repeat=horizon):
            probability = mdp.initial[states[0]]
            steps = []
            for t in range(horizon):
                s, a, following = states[t], actions[t], states[t + 1]
                step_policy = policy if policy.ndim == 2 else policy[t]
                probability *= step_policy[s, a] * transitions[s, a, following]
                steps.append((s, a, following, rewards[s, a, following]))
            if probability > 0:
                yield probability, steps


def survival_chain(discount=0.9):
    """Two states: alive (pays 1, dies with probability 0.3) and over. V(alive) = 1 / (1 - 0.7 gamma)."""
    transitions = np.array([[[0.7, 0.3]], [[0.0, 1.0]]])
    return FiniteMDP(transitions, np.array([1.0, 0.0]), np.array([1.0, 0.0]), discount)


def printed_with_threads(script, threads):
    """What a script prints in a process of its own with that many numba threads."""
    environment = os.environ | {"NUMBA_NUM_THREADS": str(threads)}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


def rows_of(weights, indptr):
    """``Rows`` of one action with these probabilities; the states that they lead to are no matter."""
    indptr = np.asarray(indptr, dtype=np.int64)
    entries = np.arange(len(weights))
    return Rows(np.arange(len(indptr) - 1), entries, np.asarray(weights, dtype=float), indptr, entries, len(entries), 1)


def environments(form, discount=0.7):
    """A simulator and a target near it, three states and two actions, every move possible."""
    rng = np.random.default_rng(form)
    rows = rng.dirichlet(np.full(3, 4.0), (3, 2))
    rewards = rng.normal(size=(3, 2, 3)[:form])
    simulator = FiniteMDP(rows, rewards, [0.6, 0.4, 0.0], discount)
    return simulator, simulator.with_transitions(0.8 * rows + 0.2 * rng.dirichlet(np.ones(3), (3, 2)))


POLICY = np.array([[0.3, 0.7], [0.5, 0.5], [0.8, 0.2]])  # for these
BEHAVIOR = np.array([[0.4, 0.6], [0.5, 0.5], [0.6, 0.4]])


def ratio_of(rng, simulator):
    """Any weights on the simulator's entries: rows of zeta * P of any sum, zeros among them."""
    data = rng.integers(0, 4, simulator.transitions.nnz) / 2.0
    matrix = simulator.transitions
    return sparse.csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def histories(mdp, policy, horizon):
    """(probability, states s_0..s_T, actions, rewards) of each path, all of positive probability."""
    transitions, rewards = dense(mdp)
    found = [(float(p), (s,), (), ()) for s, p in enumerate(mdp.initial) if p > 0]
    for _ in range(horizon):
        found = [
            (p * policy[states[-1], a] * transitions[states[-1], a, j], (*states, j), (*actions, a),
             (*paid, rewards[states[-1], a, j]))
            for p, states, actions, paid in found
            for a in range(mdp.n_actions)
            for j in range(mdp.n_states)
            if policy[states[-1], a] * transitions[states[-1], a, j] > 0
        ]  # fmt: skip
    return found
