"""Greedy heavy-edge matching of a weighted graph: one round of coarsening."""

import numpy as np

from oee_tabular._kernels import njit


@njit(cache=True)
def match(indptr, indices, weights, sizes):
    """The group of each node after one round: groups are numbered from 0 in the order of their first nodes.

    Nodes in order; each free one is joined with its free neighbour of largest weight / (product of sizes) (the first of
    several). One whose neighbours are all taken joins the group of the heaviest of them; one without neighbours is joined
    with the next such node. Cost O(edges).
    """
    n = len(indptr) - 1
    group = np.full(n, -1)
    count = 0
    alone = -1
    for v in range(n):
        if group[v] >= 0:
            continue
        best, best_weight, taken, taken_weight = -1, 0.0, -1, 0.0
        for k in range(indptr[v], indptr[v + 1]):
            u = indices[k]
            if u == v:
                continue
            weight = weights[k] / sizes[u]
            if group[u] < 0:
                if weight > best_weight:
                    best, best_weight = u, weight
            elif weight > taken_weight:
                taken, taken_weight = u, weight
        if best >= 0:
            group[v] = group[best] = count
            count += 1
        elif taken >= 0:
            group[v] = group[taken]
        elif alone >= 0:
            group[v] = group[alone]
            alone = -1
        else:
            group[v] = count
            count += 1
            alone = v
    return group
