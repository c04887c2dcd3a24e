"""The MDPs of the benchmarks: random graphs, dense rows, rings, chains, queues, layers."""

import numpy as np
from scipy import sparse

import oee_tabular as oee


def garnet(n, actions=4, entries=5, discount=0.99, seed=0):
    """Each action leads to ``entries`` states that are drawn, with Dirichlet
    probabilities.
    """
    rng = np.random.default_rng(seed)
    chances = rng.dirichlet(np.ones(entries), size=n * actions).reshape(-1)
    starts = np.arange(0, n * actions * entries + 1, entries)
    matrix = sparse.csr_array(
        (chances, rng.integers(0, n, len(chances)), starts), shape=(n * actions, n)
    )
    matrix.sum_duplicates()
    return oee.FiniteMDP(
        matrix, rng.normal(size=(n, actions)), np.full(n, 1 / n), discount
    )


def dense(n, actions=2, discount=0.99):
    """Every state leads to all."""
    rng = np.random.default_rng(1)
    rows = rng.random((n * actions, n))
    rows /= rows.sum(axis=1, keepdims=True)
    return oee.FiniteMDP(
        sparse.csr_array(rows),
        rng.normal(size=(n, actions)),
        np.full(n, 1 / n),
        discount,
    )


def fixed_policy(mdp, seed=3):
    """A deterministic policy that is drawn."""
    return np.eye(mdp.n_actions)[
        np.random.default_rng(seed).integers(0, mdp.n_actions, mdp.n_states)
    ]


# ---- graphs of one action: (n, rng) -> edges


def ring(n, rng, reach=3, far=0.0):
    """``reach`` neighbours on each side; a share of the links leads anywhere (a small
    world).
    """
    steps = np.concatenate([np.arange(-reach, 0), np.arange(1, reach + 1)])
    rows = np.repeat(np.arange(n), len(steps))
    columns = (rows + np.tile(steps, n)) % n
    away = rng.random(len(rows)) < far
    columns[away] = rng.integers(0, n, away.sum())
    return rows, columns


def chain(n, rng):
    """A step up or down; staying at the ends."""
    at = np.arange(n)
    return np.tile(at, 2), np.concatenate(
        [np.minimum(at + 1, n - 1), np.maximum(at - 1, 0)]
    )


def queue(n, rng, batch=10):
    """One leaves, up to ``batch`` arrive."""
    rows = np.repeat(np.arange(n), batch + 1)
    return rows, np.clip(rows - 1 + np.tile(np.arange(batch + 1), n), 0, n - 1)


def layers(n, rng, width=4, entries=4):
    """Levels of a few states that lead to their own level or one of the next two;
    states in any order.
    """
    rows = np.repeat(np.arange(n), entries)
    ahead = (rows // width + rng.integers(0, 3, len(rows))) * width + rng.integers(
        0, width, len(rows)
    )
    new = rng.permutation(n)
    return new[rows], new[np.minimum(ahead, n - 1)]


def banded(n, rng, reach=8, entries=5):
    """Some of the neighbours within reach; states in any order."""
    rows = np.repeat(np.arange(n), entries)
    new = rng.permutation(n)
    return (
        new[rows],
        new[np.clip(rows + rng.integers(-reach, reach + 1, len(rows)), 0, n - 1)],
    )


GRAPHS = {
    "ring, 10 a side": lambda n, rng: ring(n, rng, reach=10),
    "ring": ring,
    "chain": chain,
    "queue": queue,
    "layered": layers,
    "banded": banded,
    "small world": lambda n, rng: ring(n, rng, far=0.01),
}


def graph(name, n, discount, actions=1):
    """The MDP of a graph; each action has random chances and rewards of its own."""
    rng = np.random.default_rng(0)
    rows, columns = GRAPHS[name](n, rng)
    every = np.arange(actions)[:, None]
    chances = rng.random((actions, len(rows))).reshape(-1) + 0.1
    pairs = (actions * rows + every).reshape(-1)
    columns = np.tile(columns, actions)
    kernel = sparse.coo_array(
        (chances, (pairs, columns)), shape=(actions * n, n)
    ).tocsr()
    kernel = sparse.csr_array(sparse.diags_array(1.0 / kernel.sum(axis=1)) @ kernel)
    return oee.FiniteMDP(
        kernel, rng.normal(size=(n, actions)), np.full(n, 1 / n), discount
    )


# ---- logs


def draw_log(mdp, n, seed=0):
    """Transitions from pairs that are drawn alike, the same in every state of the
    package.
    """
    rng = np.random.default_rng(seed)
    kernel = mdp.transitions
    pairs = rng.integers(0, kernel.shape[0], n)
    sums = np.concatenate([[0.0], np.cumsum(kernel.data)])
    low = sums[kernel.indptr[pairs]]
    high = sums[kernel.indptr[pairs + 1]]
    entries = (
        np.searchsorted(sums, low + (high - low) * rng.random(n), side="right") - 1
    )
    entries = np.clip(entries, kernel.indptr[pairs], kernel.indptr[pairs + 1] - 1)
    states, actions = np.divmod(pairs, mdp.n_actions)
    return oee.Transitions(
        states, actions, kernel.indices[entries], mdp.rewards[states, actions]
    )
