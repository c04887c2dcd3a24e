"""A kernel's graph, before anything is solved: a breadth-first order, whether it expands, what an elimination fills."""

import numpy as np
from numba import njit

N_FREE = 1000  # entries that a count may begin with before it is held to its limit


@njit(cache=True)
def breadth_first(kernel, back, widest):
    """The states in breadth-first order, later trees before earlier ones, and each state's place.

    Along the rows; where ``back``, the transposed rows, has any, along both. Empty where states stand more than ``widest``
    places behind the state that led to them, on average.
    """
    n = len(kernel.indptr) - 1
    place, queue = np.empty(n, dtype=np.uint32), np.empty(n, dtype=np.uint32)
    is_seen = np.zeros(n, dtype=np.bool_)
    free, root, distance, n_done = n, 0, 0.0, 0
    while free > 0:
        while is_seen[root]:
            root += 1
        queue[0], is_seen[root] = root, True
        head, tail = 0, 1
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
    """Whether twice as many steps lead to 9 times as many states, more than in lattices of up to three dimensions.

    By five searches of at most 32 steps each, from states that lie far from each other in the numbering.
    """
    indptr, indices, _, _ = kernel
    n, n_expanding = len(indptr) - 1, 0
    queue, seen_by = np.empty(n, dtype=np.uint32), np.zeros(n, dtype=np.uint8)
    sizes = np.ones(33)
    for search in range(1, 6):
        root = (search - 1) * n // 5
        queue[0], seen_by[root] = root, search
        head, tail = 0, 1
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
    """The order of elimination, the reverse of ``place``; the first linked state of each; where its row begins.

    Row i of the factor L and column i of U begin with the first state that i is linked to, either way; only what lies between
    is filled [1].

    Reference: [1] George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 4.
    """
    n = len(place)
    order, first, starts = np.empty(n, dtype=np.int64), np.arange(n), np.zeros(n + 1, dtype=np.int64)
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
    """Whether factors of M + M^T have up to ``most`` entries a state below the diagonal, in the reverse of the order.

    Row i has an entry in column k where k is on the way from one of its entries to i in the elimination tree [1].

    Reference: [1] Liu, The role of elimination trees in sparse factorization, SIAM J. Matrix Anal. Appl. 11 (1990).
    """
    n = len(order)
    parent, mark = np.full(n, n, dtype=np.int64), np.full(n, n, dtype=np.int64)
    count = 0
    for i in range(n):
        state = order[n - 1 - i]
        mark[i] = i
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
