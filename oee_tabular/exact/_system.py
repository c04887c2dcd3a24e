"""Kernels for a policy's system: its rows, residuals, and the graph of the kernel.

The graph is searched for a breadth-first order, for whether it expands, and for what an
elimination fills, before anything is solved.
"""

import numpy as np

from oee_tabular._compiling import njit


@njit(cache=True)
def add_entry(columns, values, place, begin, filled, column, value):
    """Add a value to the row from ``begin`` on, or append it; return the row's end.

    ``place`` has each column's last entry.
    """
    at = place[column]
    if begin <= at and at < filled and columns[at] == column:
        values[at] += value
        return filled
    place[column] = filled
    columns[filled] = column
    values[filled] = value
    return filled + np.uint64(1)


@njit(cache=True)
def average_rows(rows, policy, states, number, columns, values):
    """Compute P_pi(s' | s) = sum_a policy[s, a] K(s' | s, a) as CSR without zeros.

    A row's entries stand in the order in which its actions have them. ``states`` are
    the states whose rows are made, and ``number`` has 1 + the new number of each state
    that follows; if they are empty, all rows are made. ``columns`` (uint32) and
    ``values`` have room for all entries, in numpy's memory, whose large pages save
    time.
    """
    indptr, indices, data = rows
    n_rows = len(policy)
    n_columns = len(policy)
    n_actions = policy.shape[1]
    is_part = len(number) > 0
    if is_part:
        n_rows = len(states)
        n_columns = min(len(number), len(states) + len(columns))
    starts = np.zeros(n_rows + 1, dtype=np.uint32)
    place = np.zeros(n_columns, dtype=np.uint32)
    filled = np.uint64(0)
    for i in range(n_rows):
        begin = filled
        state = np.int64(states[i]) if is_part else i
        # the rows of the actions that are taken, merged by their columns
        for action in range(n_actions):
            weight = policy[state, action]
            if weight == 0.0:
                continue
            row = np.uint64(state * n_actions + action)
            for k in range(indptr[row], indptr[row + np.uint64(1)]):
                if weight * data[k] != 0.0:
                    column = (
                        number[indices[k]] - np.uint32(1) if is_part else indices[k]
                    )
                    filled = add_entry(
                        columns, values, place, begin, filled, column, weight * data[k]
                    )
        starts[i + 1] = filled
    return starts, columns[:filled], values[:filled]


@njit(cache=True)
def average_rewards(policy, rewards):
    """Compute r_pi(s) = sum_a policy[s, a] r(s, a), and the scale of its rounding.

    The scale is the largest sum of the magnitudes.
    """
    total = np.zeros(len(policy))
    largest = 0.0
    for state in range(len(policy)):
        size = 0.0
        for action in range(policy.shape[1]):
            term = policy[state, action] * rewards[state, action]
            total[state] += term
            size += abs(term)
        largest = max(largest, size)
    return total, largest


@njit(cache=True)
def largest_magnitude(numbers):
    """Return the largest absolute value, 0 of nothing.

    numpy needs several passes, which problems of few states feel.
    """
    largest = 0.0
    for i in range(len(numbers)):
        if not abs(numbers[i]) <= largest:  # nan as well
            largest = abs(numbers[i])
    return largest


@njit(cache=True)
def range_of_sums(kernel, n_roundings):
    """Return the smallest row sum, the largest, and the middle of the two.

    The largest includes its rounding and ``n_roundings`` in each entry.
    """
    indptr = kernel.indptr
    data = kernel.data
    smallest = np.inf
    largest = 0.0
    entries = np.uint32(0)
    for i in range(len(indptr) - 1):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k]
        smallest = min(smallest, total)
        largest = max(largest, total)
        entries = max(entries, indptr[i + 1] - indptr[i])
    rounded = largest * (
        1.0 + (np.float64(entries) + n_roundings) * np.finfo(np.float64).eps
    )
    return smallest, rounded, 0.5 * (smallest + largest)


@njit(cache=True)
def multiply(kernel, transpose, x, out):
    """Compute out = K x, or K^T x by scattering.

    Scattering is not held up by rows of uneven length.
    """
    indptr, indices, data, _ = kernel
    if transpose:
        out[:] = 0.0
    for i in range(len(indptr) - 1):
        total = 0.0
        own = x[i] if transpose else 0.0
        for k in range(indptr[i], indptr[i + np.uint32(1)]):
            if transpose:
                out[indices[k]] += data[k] * own
            else:
                total += data[k] * x[indices[k]]
        if not transpose:
            out[i] = total


@njit(cache=True)
def residual(kernel, transpose, b, x, n_roundings):
    """Compute the residual b - M x and bounds on it.

    M = I - discount K, or its transpose.

    Returns the residual, its largest magnitude, a bound on the exact one, and the
    largest rounding. Each term of an entry meets at most (entries of the row + 4)
    roundings, and ``n_roundings`` more in the kernel itself. The bound is on the
    largest magnitude with its rounding, transposed on the sum of them.
    """
    indptr, indices, data, discount = kernel
    n = len(b)
    missed = np.zeros(n)
    size = np.zeros(n)
    count = np.zeros(n)
    # K x, the sums of the magnitudes of its terms, and their numbers
    for i in range(n):
        total = 0.0
        magnitude = 0.0
        own = x[i]
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if transpose:
                term = data[k] * own
                missed[j] += term
                size[j] += abs(term)
                count[j] += 1.0
            else:
                term = data[k] * x[j]
                total += term
                magnitude += abs(term)
        if not transpose:
            missed[i] = total
            size[i] = magnitude
            count[i] = np.float64(indptr[i + 1] - indptr[i])
    largest = 0.0
    bound = 0.0
    rounding = 0.0
    # b - M x, and a bound on its rounding
    for i in range(n):
        missed[i] = b[i] + (discount * missed[i] - x[i])
        scale = discount * size[i] + abs(x[i]) + abs(b[i])
        here = (
            0.5
            * np.finfo(np.float64).eps
            * (1.0 + 1e-9)
            * (count[i] + 4.0 + n_roundings)
            * scale
        )
        value = abs(missed[i])
        if not value <= largest:  # nan as well
            largest = value
        if transpose:
            bound += (value + here) * (1.0 + 1e-9)
        elif not value + here <= bound:
            bound = value + here
        rounding = max(rounding, here)
    return missed, largest, bound, rounding


@njit(cache=True)
def transpose_rows(indptr, indices, data, n_columns):
    """Transpose a CSR matrix by counting its columns.

    The entries of a new row stand in the order of the rows that they came from.
    """
    starts = np.zeros(n_columns + 1, dtype=np.uint32)
    for k in range(len(indices)):
        starts[indices[k] + np.uint32(1)] += np.uint32(1)
    for i in range(n_columns):
        starts[i + 1] += starts[i]
    columns = np.empty(len(indices), dtype=np.uint32)
    values = np.empty(len(indices))
    free = starts[:-1].copy()
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            at = free[indices[k]]
            columns[at] = i
            values[at] = data[k]
            free[indices[k]] = at + np.uint32(1)
    return starts, columns, values


N_FREE = 1000  # entries by which a count may exceed its limit at the beginning


@njit(cache=True)
def breadth_first(kernel, back, widest):
    """Find the states in breadth-first order, and each state's place in it.

    Later trees stand before earlier ones. The search goes along the rows; where
    ``back``, the transposed rows, has any, along both. The result is empty where states
    stand more than ``widest`` places behind the state that led to them, on average.
    """
    n = len(kernel.indptr) - 1
    place = np.empty(n, dtype=np.uint32)
    queue = np.empty(n, dtype=np.uint32)
    is_seen = np.zeros(n, dtype=np.bool_)
    free = n
    root = 0
    distance = 0.0
    n_done = 0
    while free > 0:
        while is_seen[root]:
            root += 1
        queue[0] = root
        is_seen[root] = True
        head = 0
        tail = 1
        # one tree: the states that the root leads to
        while head < tail:
            state = queue[head]
            for k in range(kernel.indptr[state], kernel.indptr[state + np.uint32(1)]):
                j = kernel.indices[k]
                if not is_seen[j]:
                    is_seen[j] = True
                    queue[tail] = j
                    distance += tail - head
                    tail += 1
            if len(back.indices) > 0:
                for k in range(back.indptr[state], back.indptr[state + np.uint32(1)]):
                    j = back.indices[k]
                    if not is_seen[j]:
                        is_seen[j] = True
                        queue[tail] = j
                        distance += tail - head
                        tail += 1
            head += 1
            if distance > widest * (n_done + tail) + N_FREE:
                return queue[:0], place[:0]
        # it stands before the trees that were found earlier
        free -= tail
        n_done += tail
        for i in range(tail):
            place[queue[i]] = free + i
    order = queue
    for state in range(n):
        order[place[state]] = state
    return order, place


@njit(cache=True)
def expands(kernel):
    """Return whether twice as many steps lead to 9 times as many states.

    This is more than in lattices of up to three dimensions. Five searches of at most 32
    steps each start from states that lie far from each other in the numbering.
    """
    indptr, indices, _, _ = kernel
    n = len(indptr) - 1
    n_expanding = 0
    queue = np.empty(n, dtype=np.uint32)
    seen_by = np.zeros(n, dtype=np.uint8)
    sizes = np.ones(33)
    for search in range(1, 6):
        root = (search - 1) * n // 5
        queue[0] = root
        seen_by[root] = search
        head = 0
        tail = 1
        # the number of states within so many steps
        for step in range(1, 33):
            level = tail
            while head < level:
                state = queue[head]
                head += 1
                for k in range(indptr[state], indptr[state + np.uint32(1)]):
                    j = indices[k]
                    if seen_by[j] != search:
                        seen_by[j] = search
                        queue[tail] = j
                        tail += 1
            sizes[step] = tail
            if step % 2 == 0 and tail > 9.0 * sizes[step // 2]:
                n_expanding += 1
                break
            if tail == level or 2 * tail > n:
                break
        if n_expanding == 3 or search - n_expanding == 3:
            break
    return n_expanding == 3


@njit(cache=True)
def find_envelope(kernel, place):
    """Find the envelope of M in the reverse of the order ``place``.

    first_i = min {j : M_ij or M_ji is not 0}, j <= i. Row i of the factor L and column
    i of U begin with the first state that i is linked to, either way; only what lies
    between is filled [1]. Returns the order of elimination, the first linked state of
    each, and where its row begins.

    Reference: [1] George and Liu, Computer Solution of Large Sparse Positive Definite
    Systems, 1981, chapter 4.
    """
    n = len(place)
    order = np.empty(n, dtype=np.int64)
    first = np.arange(n)
    starts = np.zeros(n + 1, dtype=np.int64)
    for state in range(n):
        i = n - 1 - np.int64(place[state])
        order[i] = state
        for k in range(kernel.indptr[state], kernel.indptr[state + 1]):
            j = n - 1 - np.int64(place[kernel.indices[k]])
            first[i] = min(first[i], j)
            first[j] = min(first[j], i)
    for i in range(n):
        starts[i + 1] = starts[i] + i - first[i]
    return order, first, starts


@njit(cache=True)
def fills_little(kernel, back, order, place, most):
    """Return whether factors of M + M^T have up to ``most`` entries a state.

    Entries below the diagonal are counted, in the reverse of the order. Row i has an
    entry in column k where k is on the way from one of its entries to i in the
    elimination tree [1].

    Reference: [1] Liu, The role of elimination trees in sparse factorization, SIAM J.
    Matrix Anal. Appl. 11 (1990).
    """
    n = len(order)
    parent = np.full(n, n, dtype=np.int64)
    mark = np.full(n, n, dtype=np.int64)
    count = 0
    for i in range(n):
        state = order[n - 1 - i]
        mark[i] = i
        # along the row and along the column, up the tree to what is marked
        for half in range(2):
            rows = kernel.indptr if half == 0 else back.indptr
            columns = kernel.indices if half == 0 else back.indices
            for k in range(rows[state], rows[state + np.uint32(1)]):
                j = n - 1 - np.int64(place[columns[k]])
                while j < i and mark[j] != i:
                    if parent[j] == n:
                        parent[j] = i
                    mark[j] = i
                    count += 1
                    j = parent[j]
        if count > most * (i + 1) + N_FREE:
            return False
    return True
