"""What a policy makes of the rows s*A + a: the kernel of its states, and residuals of its linear system."""

import numpy as np
from numba import njit


@njit(cache=True)
def single_action(weights):
    """The action that has weight 1 where all others have none; else -1."""
    found = -1
    for action in range(len(weights)):
        if weights[action] != 0.0:
            if found >= 0 or weights[action] != 1.0:
                return -1
            found = action
    return found


@njit(cache=True)
def fill_average_rows(rows, policy, columns, values):
    """``average_rows`` into arrays with room for all entries."""
    indptr, indices, data = rows
    n_states, n_actions = policy.shape
    starts = np.empty(n_states + 1, dtype=np.uint32)
    starts[0] = 0
    sums, mark = np.zeros(n_states), np.zeros(n_states, dtype=np.uint32)
    kept = 0
    for state in range(n_states):
        only = single_action(policy[state])
        if only >= 0:
            for k in range(indptr[state * n_actions + only], indptr[state * n_actions + only + 1]):
                if data[k] != 0.0:
                    columns[kept], values[kept] = indices[k], data[k]
                    kept += 1
            starts[state + 1] = kept
            continue
        begin = filled = kept
        for action in range(n_actions):
            weight = policy[state, action]
            if weight == 0.0:
                continue
            for k in range(indptr[state * n_actions + action], indptr[state * n_actions + action + 1]):
                j = indices[k]
                if mark[j] != np.uint32(state + 1):
                    mark[j] = state + 1
                    sums[j] = 0.0
                    columns[filled] = j
                    filled += 1
                sums[j] += weight * data[k]
        for k in range(begin, filled):
            value = sums[columns[k]]
            if value != 0.0:
                columns[kept], values[kept] = columns[k], value
                kept += 1
        starts[state + 1] = kept
    return starts, columns[:kept], values[:kept]


@njit(cache=True)
def average_rows(rows, policy):
    """sum_a policy[s, a] K(s' | s, a) as CSR without zeros; a row's entries in the order in which its actions have them."""
    room = len(rows[2])  # only what is filled becomes memory
    return fill_average_rows(rows, policy, np.empty(room, dtype=np.uint32), np.empty(room))


@njit(cache=True)
def average_rewards(policy, rewards):
    """sum_a policy[s, a] r(s, a), and the largest sum of the magnitudes: what its rounding is measured by."""
    total, largest = np.zeros(len(policy)), 0.0
    for state in range(len(policy)):
        size = 0.0
        for action in range(policy.shape[1]):
            term = policy[state, action] * rewards[state, action]
            total[state] += term
            size += abs(term)
        largest = max(largest, size)
    return total, largest


@njit(cache=True)
def mean_next_values(rows, values):
    """sum_s' K(s' | s, a) V(s') of each row s*A + a."""
    indptr, indices, data = rows
    means = np.empty(len(indptr) - 1)
    for row in range(len(means)):
        total = 0.0
        for k in range(indptr[row], indptr[row + np.uint32(1)]):
            total += data[k] * values[indices[k]]
        means[row] = total
    return means


@njit(cache=True)
def range_of_sums(kernel, n_roundings):
    """The smallest sum of a row, the largest with its rounding and ``n_roundings`` an entry, the middle of the two."""
    indptr, data = kernel.indptr, kernel.data
    smallest, largest, entries = np.inf, 0.0, np.uint32(0)
    for i in range(len(indptr) - 1):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k]
        smallest = min(smallest, total)
        largest = max(largest, total)
        entries = max(entries, indptr[i + 1] - indptr[i])
    rounded = largest * (1.0 + (np.float64(entries) + n_roundings) * np.finfo(np.float64).eps)
    return smallest, rounded, 0.5 * (smallest + largest)


@njit(cache=True)
def dense_matrix(kernel):
    """(S, S): I - discount K."""
    indptr, indices, data, discount = kernel
    matrix = np.eye(len(indptr) - 1)
    for i in range(len(matrix)):
        for k in range(indptr[i], indptr[i + 1]):
            matrix[i, indices[k]] -= discount * data[k]
    return matrix


@njit(cache=True)
def multiply(kernel, transpose, x, out):
    """out = K x, or K^T x by scattering, which no row of uneven length holds up."""
    indptr, indices, data, _ = kernel
    if transpose:
        out[:] = 0.0
    for i in range(len(x)):
        total, own = 0.0, x[i]
        for k in range(indptr[i], indptr[i + np.uint32(1)]):
            if transpose:
                out[indices[k]] += data[k] * own
            else:
                total += data[k] * x[indices[k]]
        if not transpose:
            out[i] = total


@njit(cache=True)
def residual(kernel, b, x, n_roundings):
    """b - (I - discount K) x, its largest magnitude, the largest with its rounding, and the largest rounding.

    Each term of an entry meets at most (entries of the row + 4) roundings, and ``n_roundings`` more in the kernel itself.
    """
    indptr, indices, data, discount = kernel
    n = len(b)
    missed = np.empty(n)
    unit = 0.5 * np.finfo(np.float64).eps * (1.0 + 1e-9)
    largest, bound, rounding = 0.0, 0.0, 0.0
    for i in range(n):
        total, size = 0.0, 0.0
        for k in range(indptr[i], indptr[i + 1]):
            term = data[k] * x[indices[k]]
            total += term
            size += abs(term)
        value = b[i] + (discount * total - x[i])
        missed[i] = value
        here = (
            unit
            * (np.float64(indptr[i + 1] - indptr[i]) + (4.0 + n_roundings))
            * (discount * size + abs(x[i]) + abs(b[i]))
        )
        value = abs(value)
        if not value <= largest:  # nan as well
            largest = value
        if not value + here <= bound:
            bound = value + here
        rounding = max(rounding, here)
    return missed, largest, bound, rounding


@njit(cache=True)
def residual_transposed(kernel, b, x, n_roundings):
    """The same for (I - discount K)^T, where the bound is of the sum of the magnitudes."""
    indptr, indices, data, discount = kernel
    n = len(b)
    missed = np.zeros(n)
    size = np.zeros(n)
    count = np.zeros(n)
    unit = 0.5 * np.finfo(np.float64).eps * (1.0 + 1e-9)
    for i in range(n):
        value = x[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            term = data[k] * value
            missed[j] += term
            size[j] += abs(term)
            count[j] += 1.0
    largest, bound, rounding = 0.0, 0.0, 0.0
    for i in range(n):
        value = b[i] + (discount * missed[i] - x[i])
        missed[i] = value
        here = unit * (count[i] + (4.0 + n_roundings)) * (discount * size[i] + abs(x[i]) + abs(b[i]))
        value = abs(value)
        if not value <= largest:
            largest = value
        bound += value + here
        rounding = max(rounding, here)
    return missed, largest, bound * (1.0 + 1e-9), rounding


@njit(cache=True)
def transpose_rows(indptr, indices, data, n_columns):
    """The CSR of the transposed matrix; within a row in the order of the rows that they came from."""
    n = len(indptr) - 1
    starts = np.zeros(n_columns + 1, dtype=np.uint32)
    for k in range(len(indices)):
        starts[indices[k] + np.uint32(1)] += np.uint32(1)
    for i in range(n_columns):
        starts[i + 1] += starts[i]
    columns = np.empty(len(indices), dtype=np.uint32)
    values = np.empty(len(indices))
    free = starts[:-1].copy()
    for i in range(n):
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            at = free[j]
            columns[at] = i
            values[at] = data[k]
            free[j] = at + np.uint32(1)
    return starts, columns, values
