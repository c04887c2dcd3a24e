"""Kernels for a policy's system: its rows, residuals, and the graph of the kernel.

The graph is searched for a breadth-first order, for whether it expands, and for what an
elimination fills, before anything is solved.
"""

from typing import Any, NamedTuple

import numpy as np

from oee_tabular._compiling import njit
from oee_tabular.typing import Array

EPS = float(np.finfo(float).eps)  # the relative spacing of floats at 1


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


def average_rows(
    rows: tuple[Any, Any, Array],
    policy: Array,
    states: Any,
    number: Any,
    n_entries: int,
) -> tuple[Any, Any, Array]:
    """Compute P_pi(s' | s) = sum_a policy[s, a] K(s' | s, a) as CSR without zeros.

    A row's entries stand in the order in which its actions have them. ``states`` are
    the states whose rows are made, and ``number`` has 1 + the new number of each state
    that follows; if they are empty, all rows are made. These have up to ``n_entries``
    entries.
    """
    n_rows = n_columns = len(policy)
    if len(number):
        n_rows = len(states)
        n_columns = min(len(number), len(states) + n_entries)
    # in numpy's memory, whose large pages save time
    columns = np.empty(n_entries, dtype=np.uint32)
    values = np.empty(n_entries)
    starts = np.zeros(n_rows + 1, dtype=np.uint32)
    place = np.zeros(n_columns, dtype=np.uint32)
    filled = fill_rows(*rows, policy, states, number, place, starts, columns, values)
    return starts, columns[:filled], values[:filled]


@njit(cache=True)
def fill_rows(
    indptr, indices, data, policy, states, number, place, starts, columns, values
):
    """Write the rows of ``average_rows``, and return how many entries they have.

    P_pi(s' | s) += policy[s, a] K(s' | s, a) for each action a and each s' in turn.
    ``place`` and ``starts`` begin as zeros.
    """
    n_actions = policy.shape[1]
    is_part = len(number) > 0
    filled = np.uint64(0)
    for i in range(len(starts) - 1):
        begin = filled
        state = np.int64(i)
        if is_part:
            state = np.int64(states[i])
        # the rows of the actions that are taken, merged by their columns
        for action in range(n_actions):
            weight = policy[state, action]
            if weight == 0.0:
                continue
            row = np.uint64(state * n_actions + action)
            for k in range(indptr[row], indptr[row + np.uint64(1)]):
                share = weight * data[k]
                if share != 0.0:
                    column = np.uint64(indices[k])
                    if is_part:
                        column = np.uint64(number[column]) - np.uint64(1)
                    filled = add_entry(
                        columns, values, place, begin, filled, column, share
                    )
        starts[i + 1] = filled
    return filled


def average_rewards(policy: Array, rewards: Array) -> tuple[Array, float]:
    """Compute r_pi(s) = sum_a policy[s, a] r(s, a), and the scale of its rounding.

    The scale is the largest sum of the magnitudes.
    """
    total = np.zeros(len(policy))
    # the loop is compiled for one kind of array
    contiguous = np.ascontiguousarray(policy)
    return total, add_rewards(contiguous, rewards, total)


@njit(cache=True)
def add_rewards(policy, rewards, total):
    """Add sum_a policy[s, a] r(s, a) to ``total``; return the largest sum of sizes."""
    largest = 0.0
    for state in range(len(policy)):
        size = 0.0
        for action in range(policy.shape[1]):
            term = policy[state, action] * rewards[state, action]
            total[state] += term
            size += abs(term)
        if size > largest:
            largest = size
    return largest


def largest_magnitude(numbers: Array) -> float:
    """Return the largest absolute value, 0 of nothing.

    numpy needs several passes, which problems of few states feel.
    """
    flat = np.ascontiguousarray(numbers).reshape(-1)
    # this view is read-only, so that the loop is compiled for one kind of array
    flat.flags.writeable = False
    return float(largest_of(flat))


@njit(cache=True)
def largest_of(numbers):
    """Return the largest absolute value, 0 of nothing."""
    largest = 0.0
    for i in range(len(numbers)):
        size = abs(numbers[i])
        if not size <= largest:  # nan as well
            largest = size
    return largest


def range_of_sums(
    indptr: Any, data: Array, n_roundings: int
) -> tuple[float, float, float]:
    """Return the smallest row sum, the largest, and the middle of the two.

    The largest includes its rounding and ``n_roundings`` in each entry.
    """
    smallest, largest, entries = sum_rows(indptr, data)
    rounded = largest * (1.0 + (entries + n_roundings) * EPS)
    return smallest, rounded, 0.5 * (smallest + largest)


@njit(cache=True)
def sum_rows(indptr, data):
    """Return the smallest row sum, the largest, and the most entries of a row."""
    smallest = np.inf
    largest = 0.0
    entries = np.uint32(0)
    for i in range(len(indptr) - 1):
        total = 0.0
        for k in range(indptr[i], indptr[i + 1]):
            total += data[k]
        if total < smallest:
            smallest = total
        if total > largest:
            largest = total
        if indptr[i + 1] - indptr[i] > entries:
            entries = indptr[i + 1] - indptr[i]
    return smallest, largest, entries


@njit(cache=True)
def multiply(indptr, indices, data, transpose, x, out):
    """Compute out = K x, or K^T x by scattering.

    Scattering is not held up by rows of uneven length.
    """
    if transpose:
        for i in range(len(out)):
            out[i] = 0.0
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


class Residual(NamedTuple):
    """Hold the residual b - M x, its largest magnitude, a bound and the rounding.

    The rounding is the largest of an entry. The bound is on the largest magnitude of
    the exact residual; transposed, on the sum of the magnitudes.
    """

    missed: Array
    largest: float
    bound: float
    rounding: float


def residual(
    kernel: tuple[Any, Any, Array, float],
    transpose: bool,
    b: Array,
    x: Array,
    n_roundings: float,
) -> Residual:
    """Compute the residual b - M x and bounds on it.

    M = I - discount K, or its transpose. Each term of an entry meets at most (entries
    of the row + 4) roundings, and ``n_roundings`` more in the kernel itself.
    """
    missed = np.array(b)
    room = np.zeros((3, len(b)))
    return Residual(
        missed, *subtract_product(*kernel, transpose, x, n_roundings, missed, room)
    )


@njit(cache=True)
def subtract_product(
    indptr, indices, data, discount, transpose, x, n_roundings, missed, room
):
    """Subtract M x from ``missed``, and return what ``residual`` says about it.

    ``room`` (3, S), zeros, takes K x, the sums of the magnitudes of its terms, and
    their numbers.
    """
    n = len(missed)
    for i in range(n):
        if transpose:
            own = x[i]
            for k in range(indptr[i], indptr[i + 1]):
                j = indices[k]
                term = data[k] * own
                room[0, j] += term
                room[1, j] += abs(term)
                room[2, j] += 1.0
        else:
            total = 0.0
            magnitude = 0.0
            for k in range(indptr[i], indptr[i + 1]):
                term = data[k] * x[indices[k]]
                total += term
                magnitude += abs(term)
            room[0, i] = total
            room[1, i] = magnitude
            room[2, i] = np.float64(indptr[i + 1] - indptr[i])
    largest = 0.0
    bound = 0.0
    rounding = 0.0
    # b - M x, and a bound on its rounding
    for i in range(n):
        scale = discount * room[1, i] + abs(x[i]) + abs(missed[i])
        missed[i] += discount * room[0, i] - x[i]
        here = 0.5 * EPS * (1.0 + 1e-9) * (room[2, i] + 4.0 + n_roundings) * scale
        value = abs(missed[i])
        if not value <= largest:  # nan as well
            largest = value
        if transpose:
            bound += (value + here) * (1.0 + 1e-9)
        elif not value + here <= bound:
            bound = value + here
        if here > rounding:
            rounding = here
    return largest, bound, rounding


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


# entries by which a count may exceed its limit, which is a mean that the first states
# need not have
N_FREE_ENTRIES = 1000


@njit(cache=True)
def breadth_first(kernel, back, widest, root):
    """Find the states in breadth-first order from a root, and each state's place in it.

    Where the root does not lead to all states, other trees follow; later trees stand
    before earlier ones. The search goes along the rows; where ``back``, the transposed
    rows, has any, along both. The result is empty where states stand more than
    ``widest`` places behind the state that led to them, on average.
    """
    n = len(kernel.indptr) - 1
    place = np.empty(n, dtype=np.uint32)
    queue = np.empty(n, dtype=np.uint32)
    is_seen = np.zeros(n, dtype=np.bool_)
    free = n
    n_passed = 0
    distance = 0.0
    n_done = 0
    while free > 0:
        # the next root is the first state that no tree has
        while is_seen[root]:
            root = n_passed
            n_passed += 1
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
            if distance > widest * (n_done + tail) + N_FREE_ENTRIES:
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
        if count > most * (i + 1) + N_FREE_ENTRIES:
            return False
    return True
