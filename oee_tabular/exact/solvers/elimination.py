"""Elimination in the order of least degree, and a dense LU of what is left.

With e a state and N(e) the states that an entry links it to, either way,

    K_ij <- K_ij + K_ie K_ej / (1 - K_ee)    for i and j in N(e)

is a system of the same kind for the other states (a Schur complement of an M-matrix
[1]). In it all states of N(e) are linked. The state with the fewest links goes first
[2]: a tree stays a tree, a comb with a few far links becomes a small graph of the ends
of these links, and of a planar graph few states are left. They are solved by LAPACK as
soon as most of them are linked.

References: [1] Berman and Plemmons, Nonnegative Matrices in the Mathematical Sciences,
1994, chapter 6. [2] George and Liu, The evolution of the minimum degree ordering
algorithm, SIAM Review 31 (1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oee_tabular._compiling import njit
from oee_tabular.exact.solvers.direct import solver_of_dense
from oee_tabular.exact.system import Solve, System
from oee_tabular.typing import Array, IntArray

# The constants were chosen on half of the graphs of tests/benchmarks/graphs.py.
#
# entries that an elimination may meet, as a multiple of (S + entries of K) / (1 -
# gamma): up to discount .99 this takes at most a third of the time of BiCGSTAB
MAX_MET_ENTRIES = 0.15
# at discounts nearer to 1 BiCGSTAB does not take longer for graphs that expand
MIN_ONE_LESS_DISCOUNT = 1e-3
# the cube of the number of states of the rest, as a multiple of (S + entries of K): the
# dense LU takes about as long as BiCGSTAB at discount .999
MAX_CUBE_OF_REST = 16_000.0
# states left when all have many links, for each one of the rest
LEFT_STATES_PER_REST = 3.0
# A graph fills much where states with more than this multiple of the mean number of
# links are gained faster than two for three that are eliminated. Grids and graphs that
# expand gain one and more for each; combs and small worlds in which one link in ten is
# far gain about one for two.
MAX_LINKS_PER_MEAN = 1.6
MAX_GAIN = 2.0 / 3.0
# states with many links that are not counted: a chain of cliques gains some at first
N_FREE_STATES = 30
# where there are twice as many, so many states are eliminated first, to see what they
# gain: it takes a hundredth of the time of BiCGSTAB on a grid of 300 x 300
N_SAMPLE_STATES = 1000
# states of the rest for each link of the one with the fewest, below which a dense LU
# takes less time for this state than its elimination does
DENSE_STATES_PER_LINK = 16
# number of links up to which it is eliminated in any case
N_SMALL_DEGREE = 6

# what an elimination ends with
IS_DONE = 0
IS_GIVEN_UP = 1
IS_FULL = 2  # for want of room


class Links(NamedTuple):
    """The entries of a matrix with a symmetric pattern, whose rows have room to grow.

    Attributes
    ----------
    rows : ndarray of int64, shape (3, S)
        Where the links of each state begin and end, and where the room for them ends.
    columns : ndarray of uint32
        The linked states.
    upper : ndarray
        K_ej of the links of e, as they were when e was eliminated.
    lower : ndarray
        K_je / (1 - K_ee) of the same links, if e was eliminated.
    diagonal : ndarray of shape (S,)
        1 - K_ee.
    """

    rows: IntArray
    columns: NDArray[np.uint32]
    upper: Array
    lower: Array
    diagonal: Array

    def with_room(self, room: int, filled: int) -> Links:
        """Return the links with room for as many entries, of which some are filled."""
        # memory that is not written to costs next to nothing
        columns = np.empty(room, dtype=np.uint32)
        upper = np.empty(room)
        lower = np.empty(room)
        columns[:filled] = self.columns[:filled]
        upper[:filled] = self.upper[:filled]
        lower[:filled] = self.lower[:filled]
        return Links(self.rows, columns, upper, lower, self.diagonal)


@dataclass(frozen=True)
class Elimination:
    """LU in the order of least degree, for graphs of which it leaves few states.

    These are trees, combs, ladders and small worlds with few far links, and irregular
    planar graphs. It gives up early on grids and on graphs that expand, and where
    BiCGSTAB would take less time.
    """

    name: str = "sparse LU"
    is_direct: bool = False

    def suits(self, system: System) -> bool:
        """Return True: only an elimination shows what it fills."""
        return True

    def prepare(self, system: System) -> Solve:
        """Eliminate states and factorise the rest; give up where that is too much."""

        def solve_nothing(b: Array, relative: float) -> Array | None:
            """Return the right side of a system without states."""
            return b

        transpose = system.transpose
        found = eliminate(system)
        if found is None:
            return lambda b, relative: None
        links, eliminated = found
        is_rest = np.ones(system.n_states, dtype=np.bool_)
        is_rest[eliminated] = False
        rest: IntArray = np.flatnonzero(is_rest)
        solve_rest: Solve = solve_nothing
        if len(rest):
            solve_rest = solver_of_dense(dense_rest(links, rest), transpose)

        def solve(b: Array, relative: float) -> Array | None:
            """Solve by the factors of both."""
            x = np.array(b, dtype=np.float64)
            substitute_forward(*links, eliminated, transpose, x)
            x_rest = solve_rest(x[rest], relative)
            if x_rest is None:
                return None
            x[rest] = x_rest
            substitute_backward(*links, eliminated, transpose, x)
            return x

        return solve


def eliminate(system: System) -> tuple[Links, IntArray] | None:
    """Eliminate states in the order of least degree, while that takes little time.

    Returns the links and the states that were eliminated, or None where it was given
    up.
    """
    n = system.n_states
    size = n + len(system.kernel.indices)
    slack = max(1.0 - system.kernel.discount, MIN_ONE_LESS_DISCOUNT)
    max_met = MAX_MET_ENTRIES * size / slack
    max_rest = (MAX_CUBE_OF_REST * size) ** (1.0 / 3.0)
    max_left = min(MAX_GAIN / (1.0 + MAX_GAIN) * n, LEFT_STATES_PER_REST * max_rest)
    # states of the same degree go in breadth-first order, so that those that follow
    # each other are near each other
    order = system.order[0]
    if n > 2 * N_SAMPLE_STATES:
        sample = order[:N_SAMPLE_STATES]
        if eliminate_some(system, sample, max_met, N_SAMPLE_STATES) is None:
            return None
    found = eliminate_some(system, order, max_met, max_left)
    if found is None or n - len(found[1]) > max_rest:
        return None
    return found


def eliminate_some(
    system: System, states: Any, max_met: float, max_left: float
) -> tuple[Links, IntArray] | None:
    """Eliminate some of the given states, or return None where that fills much.

    That is where more than ``max_met`` entries are met, or more than ``max_left`` of
    the states are left when all have many links.
    """
    n = system.n_states
    kernel = system.kernel
    back = system.back
    n_entries = 2 * len(kernel.indices)
    if len(states) < n:
        n_entries = sum(
            int(np.sum(starts[states + 1] - starts[states], dtype=np.int64))
            for starts in (kernel.indptr, back.indptr)
        )
    room = 16 * len(states) + 2 * n_entries
    columns = np.empty(room, dtype=np.uint32)
    upper = np.empty(room)
    lower = np.empty(room)
    links = Links(np.zeros((3, n), dtype=np.int64), columns, upper, lower, np.ones(n))
    place = np.zeros(n, dtype=np.int64)
    heads = np.full(n + 1, -1, dtype=np.int64)
    chain = np.empty((2, n), dtype=np.int64)
    filled = link_rows(*kernel, *back[:2], states, place, heads, chain, *links)
    mean = filled / len(states)
    limits = (max(int(mean) + 1, int(MAX_LINKS_PER_MEAN * mean)), max_met, max_left)
    counts = np.array([0, filled, 0, 0], dtype=np.int64)
    order = np.empty(len(states), dtype=np.int64)
    while True:
        end = eliminate_states(*links, place, heads, chain, order, counts, *limits)
        if end != IS_FULL:
            break
        links = links.with_room(2 * len(links.columns), counts[1])
    return None if end == IS_GIVEN_UP else (links, order[: counts[0]])


def dense_rest(links: Links, rest: IntArray) -> Array:
    """Return I - K of the states that are left, in Fortran's order."""
    matrix = np.zeros((len(rest), len(rest)), order="F")
    begin, end, _ = links.rows[:, rest]
    lengths = end - begin
    number = np.zeros(len(links.diagonal), dtype=np.int64)
    number[rest] = np.arange(len(rest))
    first = np.cumsum(lengths) - lengths
    entries = np.arange(lengths.sum()) + np.repeat(begin - first, lengths)
    row_of_entry = np.repeat(np.arange(len(rest)), lengths)
    matrix[row_of_entry, number[links.columns[entries]]] = -links.upper[entries]
    np.fill_diagonal(matrix, links.diagonal[rest])
    return matrix


@njit(cache=True)
def link_rows(
    indptr,
    indices,
    data,
    discount,
    back,
    back_columns,
    states,
    place,
    heads,
    chain,
    rows,
    columns,
    upper,
    lower,
    diagonal,
):
    """Write the rows of some states of gamma K, with a symmetric pattern.

    K_ij = 0 is written where only K_ji is not 0. Returns how many entries there are.
    Then ``heads`` (S + 1) gets the first state of each number of links, and ``chain``
    (2, S) the state after each one and the state before it, in the given order.
    ``rows`` and ``place`` begin as zeros, ``diagonal`` as ones, ``heads`` as -1.
    """
    at = np.int64(0)
    for turn in range(len(states)):
        i = np.int64(states[turn])
        begin = at
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            value = discount * data[k]
            known = place[j]
            if j == i:
                diagonal[i] -= value
            elif begin <= known and known < at and columns[known] == j:
                upper[known] += value
            else:
                place[j] = at
                columns[at] = j
                upper[at] = value
                at += 1
        for k in range(back[i], back[i + 1]):
            j = back_columns[k]
            known = place[j]
            is_known = begin <= known and known < at and columns[known] == j
            if j != i and not is_known:
                place[j] = at
                columns[at] = j
                upper[at] = 0.0
                at += 1
        rows[0, i] = begin
        rows[1, i] = at
        rows[2, i] = at
    for turn in range(len(states) - 1, -1, -1):
        state = np.int64(states[turn])
        push(heads, chain, state, rows[1, state] - rows[0, state])
    return at


@njit(cache=True)
def push(heads, chain, state, degree):
    """Put a state before all others of its degree."""
    other = heads[degree]
    heads[degree] = state
    chain[0, state] = other
    chain[1, state] = -1
    if other >= 0:
        chain[1, other] = state


@njit(cache=True)
def remove(heads, chain, state, degree):
    """Take a state out of the list of its degree."""
    after = chain[0, state]
    before = chain[1, state]
    if before >= 0:
        chain[0, before] = after
    else:
        heads[degree] = after
    if after >= 0:
        chain[1, after] = before


@njit(cache=True)
def eliminate_states(
    rows,
    columns,
    upper,
    lower,
    diagonal,
    place,
    heads,
    chain,
    order,
    counts,
    usual,
    max_met,
    max_left,
):
    """Eliminate the state with the fewest links, until a dense LU is quicker.

    K_ij <- K_ij + K_ie K_ej / (1 - K_ee) for i and j in N(e). ``counts`` has the number
    of states that were eliminated, of entries written, the least degree, and the number
    of states gained with more links than ``usual``; it takes them, so that it goes on
    from there when there is more room.
    """
    n = len(order)
    done = counts[0]
    at = counts[1]
    least = counts[2]
    gained = counts[3]
    met = 0.0
    end = IS_DONE
    while done < n:
        while heads[least] < 0:
            least += 1
        left = n - done
        if least > N_SMALL_DEGREE and DENSE_STATES_PER_LINK * least > left:
            break
        fills_much = least > usual and left > max_left
        if fills_much or gained > MAX_GAIN * done + N_FREE_STATES or met > max_met:
            end = IS_GIVEN_UP
            break
        e = heads[least]
        low = rows[0, e]
        high = rows[1, e]
        size = high - low
        # a row that has no room for what it may get moves behind all others
        wanted = np.int64(0)
        for q in range(low, high):
            i = columns[q]
            wanted += 2 * (rows[1, i] - rows[0, i] + size)
        if at + wanted > len(columns):
            end = IS_FULL
            break
        # M is no M-matrix
        if not diagonal[e] > 0.0:
            end = IS_GIVEN_UP
            break
        inverse = 1.0 / diagonal[e]
        remove(heads, chain, e, least)
        order[done] = e
        done += 1
        if size > usual:
            gained -= 1
        for q in range(low, high):
            i = np.int64(columns[q])
            begin = rows[0, i]
            stop = rows[1, i]
            degree = stop - begin
            # a state outside of a sample
            if degree == 0:
                continue
            met += degree + size
            to_e = begin
            for k in range(begin, stop):
                place[columns[k]] = k
                if columns[k] == e:
                    to_e = k
            factor = upper[to_e] * inverse
            lower[q] = factor
            # e leaves the row of i
            stop -= 1
            columns[to_e] = columns[stop]
            upper[to_e] = upper[stop]
            place[columns[to_e]] = to_e
            if stop + size - 1 > rows[2, i]:
                for k in range(begin, stop):
                    columns[at + k - begin] = columns[k]
                    upper[at + k - begin] = upper[k]
                    place[columns[k]] = at + k - begin
                stop += at - begin
                begin = at
                at += degree + size + (degree + size) // 2
                rows[0, i] = begin
                rows[2, i] = at
            # the row of e, times the factor, is added to it
            for k in range(low, high):
                j = columns[k]
                known = place[j]
                if j == i:
                    diagonal[i] -= factor * upper[k]
                elif begin <= known and known < stop and columns[known] == j:
                    upper[known] += factor * upper[k]
                else:
                    columns[stop] = j
                    upper[stop] = factor * upper[k]
                    stop += 1
            rows[1, i] = stop
            if stop - begin != degree:
                remove(heads, chain, i, degree)
                push(heads, chain, i, stop - begin)
                least = min(least, stop - begin)
                gained += np.int64(stop - begin > usual) - np.int64(degree > usual)
    counts[0] = done
    counts[1] = at
    counts[2] = least
    counts[3] = gained
    return end


@njit(cache=True)
def substitute_forward(rows, columns, upper, lower, diagonal, eliminated, transpose, x):
    """Solve L y = b in place, or U^T y = b.

    y_i = b_i + sum_e L_ie y_e with L_ie = K_ie / U_ee; transposed y_j = (b_j + sum_e
    K_ej y_e) / U_jj. States of the rest get the right side of their own system.
    """
    for turn in range(len(eliminated)):
        e = eliminated[turn]
        if transpose:
            x[e] /= diagonal[e]
        for k in range(rows[0, e], rows[1, e]):
            x[columns[k]] += (upper[k] if transpose else lower[k]) * x[e]


@njit(cache=True)
def substitute_backward(
    rows, columns, upper, lower, diagonal, eliminated, transpose, x
):
    """Solve U x = y in place, or L^T x = y.

    x_e = (y_e + sum_j K_ej x_j) / U_ee; transposed x_e = y_e + sum_i L_ie x_i.
    """
    for turn in range(len(eliminated)):
        e = eliminated[len(eliminated) - 1 - turn]
        total = x[e]
        for k in range(rows[0, e], rows[1, e]):
            total += (lower[k] if transpose else upper[k]) * x[columns[k]]
        x[e] = total if transpose else total / diagonal[e]
