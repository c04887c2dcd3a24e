"""Kernels of policies of every structure that a solver may meet."""

import numpy as np
from scipy import sparse

import oee_tabular as oee
from oee_tabular.exact.system import policy_kernel


def cycle(n):
    """A ring with a step back now and then."""
    at = np.arange(n)
    rows = np.concatenate([at, at])
    columns = np.concatenate([(at + 1) % n, (at - 1) % n])
    return sparse.csr_array((np.repeat([0.9, 0.1], n), (rows, columns)), shape=(n, n))


def grid(n):
    mdp = oee.tasks.gridworld(n, 0.3)
    return policy_kernel(mdp, oee.uniform_policy(mdp))


def small_world(n, far):
    """A ring with two neighbours a side, a share of whose links leads anywhere."""
    rng = np.random.default_rng(n)
    rows = np.repeat(np.arange(n), 4)
    columns = (rows + np.tile([-2, -1, 1, 2], n)) % n
    is_far = rng.random(len(columns)) < far
    columns[is_far] = rng.integers(0, n, is_far.sum())
    data = np.full(len(rows), 0.25)
    return sparse.csr_array(sparse.coo_array((data, (rows, columns)), shape=(n, n)))


def layered(layers, width):
    rng = np.random.default_rng(0)
    n = layers * width
    kernel = sparse.lil_array((n, n))
    for s in range(n - width):
        layer = s // width + 1
        kernel[s, layer * width + rng.permutation(width)[:3]] = rng.dirichlet(
            np.ones(3)
        )
    for s in range(n - width, n):
        kernel[s, s] = 1.0
    return sparse.csr_array(kernel)


def random_rows(n, entries):
    rng = np.random.default_rng(n)
    rows = np.repeat(np.arange(n), entries)
    data = rng.dirichlet(np.ones(entries), n).reshape(-1)
    return sparse.csr_array(
        (data, (rows, rng.integers(0, n, n * entries))), shape=(n, n)
    )


STRUCTURES = {
    "one state": sparse.csr_array([[1.0]]),
    "two that never meet": sparse.csr_array(np.eye(2)),
    "grid": grid(22),
    "layered": layered(12, 40),
    "expander": random_rows(600, 8),
    "ring": cycle(500),
    "disconnected": sparse.csr_array(
        sparse.block_diag([grid(15), random_rows(200, 3), cycle(100)])
    ),
    "reducible": sparse.csr_array(
        sparse.block_array(
            [[grid(12) * 0.7, random_rows(144, 2) * 0.3], [None, cycle(144)]]
        )
    ),
    "lossy": grid(20) * 0.9,
    "rows above 1": sparse.csr_array(
        sparse.diags_array(np.where(np.arange(400) % 7 == 1, 1.2, 0.8)) @ grid(20)
    ),
    "empty": sparse.csr_array((50, 50)),
    "dense": sparse.csr_array(np.random.default_rng(5).dirichlet(np.ones(60), 60)),
}


def binary_tree(n):
    """A walk up and down a tree; half of the states are its leaves."""
    rng = np.random.default_rng(0)
    at = np.arange(n)
    rows = np.concatenate([at[1:], (at[1:] - 1) // 2, [0]])
    columns = np.concatenate([(at[1:] - 1) // 2, at[1:], [0]])
    kernel = sparse.csr_array(
        (rng.random(len(rows)) + 0.01, (rows, columns)), shape=(n, n)
    )
    return sparse.csr_array(sparse.diags_array(1 / kernel.sum(axis=1)) @ kernel)


def levels(rng, n, size):
    """Sets of up to ``size`` states that communicate, each leading to sets after it;
    states in any order.
    """
    ends = np.unique(np.append(np.cumsum(rng.integers(1, size + 1, n)), n).clip(max=n))
    kernel = np.zeros((n, n))
    for low, high in zip(np.append(0, ends[:-1]), ends, strict=True):
        for i in range(low, high):
            kernel[i, low + (i - low + 1) % (high - low)] = rng.random() + 0.1
            later = rng.integers(low, n, 3)
            kernel[i, later] += rng.random(3) * (rng.random(3) < 0.7)
    kernel /= kernel.sum(axis=1, keepdims=True)
    at = rng.permutation(n)
    return kernel[at][:, at], len(ends)
