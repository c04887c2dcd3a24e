"""(I - gamma K) x = b by the strongly connected components of K, where all of them are small.

In a layered model (a season, a task with steps, a clock in the state) no state is met again, or only with few others. Taken
after those that they lead to, the components are solved one by one, each by a dense LU: exact, in one pass over K.

The search is path-based [1]: a component is known while it grows, so that one that is too large ends the search at once. On a
grid that is after as many states as a component may have.

Reference: [1] Gabow, Path-based depth-first search for strong and biconnected components, Information Processing Letters 74
(2000).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from oee_tabular.exact.solvers._elimination import factor, substitute

_ONE = np.uint32(1)


def components(indptr: Any, indices: Any, data: Any, most: Any) -> Any:
    """States by component, each after those it leads to, and where components begin; empty if one has more than ``most``."""
    n = len(indptr) - 1
    unseen, done = np.uint32(0xFFFFFFFF), np.uint32(0xFFFFFFFE)
    height = np.full(n, unseen)  # in ``open_states``, while a state is there
    ahead = np.empty(n, dtype=np.uint32)  # the next entry of a state to be looked at
    path, open_states, begins = np.empty((3, n), dtype=np.uint32)
    order, starts = np.empty(n, dtype=np.uint32), np.empty(n + 1, dtype=np.uint32)
    depth, n_open, n_begins, n_ordered, found = 0, 0, 0, 0, 0
    for root in range(n):
        if height[root] != unseen:
            continue
        path[0], depth = root, 1
        open_states[0], height[root], ahead[root], n_open = root, 0, indptr[root], 1
        begins[0], n_begins = 0, 1
        while depth > 0:
            state = path[depth - 1]
            k, end = ahead[state], indptr[state + _ONE]
            while k < end:
                j = indices[k]
                if data[k] != 0.0 and height[j] != done:
                    if height[j] == unseen:
                        break
                    while begins[n_begins - 1] > height[j]:  # all from there on lead to each other
                        n_begins -= 1
                    if n_open - begins[n_begins - 1] > most:
                        return order[:0], starts[:0]
                k += _ONE
            if k < end:
                j = indices[k]
                ahead[state] = k + _ONE
                path[depth], depth = j, depth + 1
                height[j], ahead[j], open_states[n_open] = n_open, indptr[j], j
                begins[n_begins], n_begins, n_open = n_open, n_begins + 1, n_open + 1
                continue
            depth -= 1
            if begins[n_begins - 1] == height[state]:
                n_begins -= 1
                low: Any = np.int64(begins[n_begins])
                starts[found], found = n_ordered, found + 1
                for i in range(low, n_open):
                    order[n_ordered] = open_states[i]
                    height[open_states[i]] = done
                    n_ordered += 1
                n_open = low
    starts[found] = n
    return order, starts[: found + 1]


components = njit(cache=True)(components)


def solve(indptr: Any, indices: Any, data: Any, discount: Any, order: Any, starts: Any, b: Any, transpose: Any) -> Any:
    """x, or that of the transposed system; nan from the first component on that is no M-matrix."""
    n, count = len(b), len(starts) - 1
    x, left = np.full(n, np.nan), b.copy()
    most: Any = 0
    for c in range(count):
        most = max(most, np.int64(starts[c + 1]) - np.int64(starts[c]))
    number = np.zeros(n, dtype=np.uint32)  # within its component, beginning with 1; 0 outside of the one at hand
    matrix, right = np.empty(most * most), np.empty(most)
    for turn in range(count):
        c = count - 1 - turn if transpose else turn
        low = np.int64(starts[c])
        size = np.int64(starts[c + 1]) - low
        for i in range(size):
            number[order[low + i]] = i + 1
        matrix[: size * size] = 0.0
        for i in range(size):
            state = order[low + i]
            row = matrix[i * size : (i + 1) * size]
            row[i] = 1.0
            total = left[state]
            for k in range(indptr[state], indptr[state + _ONE]):
                j = indices[k]
                if number[j] > 0:
                    row[np.int64(number[j]) - 1] -= discount * data[k]
                elif not transpose and data[k] != 0.0:
                    total += discount * data[k] * x[j]
            right[i] = total
        if not factor(matrix, size, size, 0, size - 1, size - 1):
            return x
        substitute(matrix, size, size, 0, size - 1, size - 1, right, transpose)
        for i in range(size):
            state = order[low + i]
            x[state] = right[i]
            if transpose:
                for k in range(indptr[state], indptr[state + _ONE]):
                    if number[indices[k]] == 0:
                        left[indices[k]] += discount * data[k] * right[i]
        for i in range(size):
            number[order[low + i]] = 0
    return x


solve = njit(cache=True)(solve)
