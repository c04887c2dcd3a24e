"""M = I - gamma K with a nonnegative K, by LU without pivoting, one strongly connected component after the other; or dense.

    L_ik = M_ik / M_kk,  M_ij <- M_ij - L_ik M_kj  (i, j > k);    M_kk > 0 always, else M is no M-matrix: rho(gamma K) >= 1.

In a layered model (a season, a task with steps, a clock in the state) no state is met again, or only with few others: taken
after those that they lead to, the components C are solved one by one, M_CC x_C = b_C + gamma K_CD x_D. Their search is
path-based [1]: a component is known while it grows, so that one that is too large ends the search at once; on a grid that is
after as many states as a component may have.

Reference: [1] Gabow, Path-based depth-first search for strong and biconnected components, Information Processing Letters 74
(2000).
"""

import numpy as np
from numba import njit

_ONE = np.uint32(1)


@njit(cache=True)
def factor(a):
    """LU of (n, n) in place, unit lower; whether all pivots are positive."""
    n = len(a)
    for k in range(n):
        if not a[k, k] > 0.0:
            return False
        source = a[k, k + 1 :]  # slices: a computed signed index is not vectorised
        for i in range(k + 1, n):
            if a[i, k] != 0.0:
                a[i, k] /= a[k, k]
                target = a[i, k + 1 :]
                for j in range(len(target)):
                    target[j] -= a[i, k] * source[j]
    return True


@njit(cache=True)
def substitute(a, x, transpose):
    """Solve M x = b, or M^T x = b, in place."""
    n = len(a)
    for turn in range(n):
        i = turn
        if transpose:
            x[i] /= a[i, i]
            x[i + 1 :] -= a[i, i + 1 :] * x[i]
        else:
            for j in range(i):
                x[i] -= a[i, j] * x[j]
    for turn in range(n):
        i = n - 1 - turn
        if transpose:
            x[:i] -= a[i, :i] * x[i]
        else:
            for j in range(i + 1, n):
                x[i] -= a[i, j] * x[j]
            x[i] /= a[i, i]


@njit(cache=True)
def dense(kernel):
    """(n, n): M for a library's solver."""
    indptr, indices, data, discount = kernel
    a = np.eye(len(indptr) - 1)
    for i in range(len(a)):
        for k in range(indptr[i], indptr[i + 1]):
            a[i, indices[k]] -= discount * data[k]
    return a


@njit(cache=True)
def components(kernel, most):
    """States by component, each after those it leads to, and where components begin; empty if one has more than ``most``."""
    indptr, indices, data, _ = kernel
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
                low = np.int64(begins[n_begins])
                starts[found], found = n_ordered, found + 1
                for i in range(low, n_open):
                    order[n_ordered] = open_states[i]
                    height[open_states[i]] = done
                    n_ordered += 1
                n_open = low
    starts[found] = n
    return order, starts[: found + 1]


@njit(cache=True)
def solve_components(kernel, order, starts, transpose, b, relative):
    """x, or that of the transposed system; nan from the first component on that is no M-matrix."""
    indptr, indices, data, discount = kernel
    n, count = len(b), len(starts) - 1
    x, left = np.full(n, np.nan), b.copy()
    most = 0
    for c in range(count):
        most = max(most, np.int64(starts[c + 1]) - np.int64(starts[c]))
    number = np.zeros(n, dtype=np.uint32)  # within its component, beginning with 1; 0 outside of the one at hand
    room, right = np.empty(most * most), np.empty(most)
    for turn in range(count):
        c = count - 1 - turn if transpose else turn
        low = np.int64(starts[c])
        size = np.int64(starts[c + 1]) - low
        for i in range(size):
            number[order[low + i]] = i + 1
        matrix = room[: size * size].reshape(size, size)
        matrix[:] = 0.0
        for i in range(size):
            state = order[low + i]
            matrix[i, i] = 1.0
            total = left[state]
            for k in range(indptr[state], indptr[state + _ONE]):
                j = indices[k]
                if number[j] > 0:
                    matrix[i, np.int64(number[j]) - 1] -= discount * data[k]
                elif not transpose and data[k] != 0.0:
                    total += discount * data[k] * x[j]
            right[i] = total
        if not factor(matrix):
            return x
        substitute(matrix, right[:size], transpose)
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
