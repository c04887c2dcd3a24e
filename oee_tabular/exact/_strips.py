"""Moments of weighted returns per decision for a policy that does not depend on time, with the actions merged.

In state s, transitions to s' by several actions give X = e + b y: b the weight and e the reward of action and transition, and
y = gamma X' - k of what follows s'. Over the actions that lead there, of probability q together, X has the mean
z = b_mean y + e_mean and the variance

    (c (y + rho)^2 + the residual of e on b) / q,     c = q Var b, rho = Cov(b, e) / Var b;

between the s' it has sum q (z - mean)^2. All are squares. The last is had from the differences d to the first entry's z,
sum q d^2 - (sum q d)^2, of which at most a share 1 - q cancels: the first has at least half of the largest probability.

States are taken LANES at a time, those with equally many s' together, and an entry's numbers stand side by side for such a
strip: its arithmetic is done by vector instructions, with every sum in the order of its state. Entries are in the order of
their columns: in grids those of a strip lead mostly to consecutive states and are read as such.
"""

from collections import namedtuple

import numpy as np
from numba import njit

LANES = 32  # states of a strip
SMALLEST_VARIANCE = 1e-280  # of b, times q: what is less has lost its digits
PARTS = 5  # numbers of an entry: q, b_mean, e_mean, c, rho

# where each strip's entries begin; where an entry leads, and whether its lanes lead side by side; its numbers; probabilities
# and residuals of the states; the states by place, S in the places that stay empty
Strips = namedtuple("Strips", "offsets columns aligned numbers fixed order")


@njit(cache=True)
def merge_state(s, walk, place, to, numbers, outcomes, entries):
    """Fill ``numbers`` (., PARTS) for the successors ``to`` of s, one of large probability first.

    Returns their probability and the residual variance. ``outcomes`` (., 3) has room for q, b, e of each transition and
    ``entries`` for its successor's place in ``to``.
    """
    indptr, indices, prob, w, acts, us, by_transition, rewards, _, _ = walk
    act, u = acts[0], us[0]
    n_actions, size = len(act) // len(place), len(to)
    if size <= LANES:
        for i in range(1, size):
            j, k = to[i], i
            while k > 0 and to[k - 1] > j:
                to[k] = to[k - 1]
                k -= 1
            to[k] = j
    for i in range(size):
        place[to[i]] = i
        for part in range(PARTS):
            numbers[i, part] = 0.0
    count, mass, residual = 0, 0.0, 0.0
    for row in range(s * n_actions, (s + 1) * n_actions):
        if act[row] == 0.0:
            continue
        for k in range(indptr[row], indptr[row + 1]):
            q = act[row] * prob[k]
            if q == 0.0:
                continue
            i, b = np.int64(place[indices[k]]), u[row] * w[k]
            e = b * rewards[0, k] if by_transition else u[row] * rewards[0, row]
            numbers[i, 0] += q
            numbers[i, 1] += q * b
            numbers[i, 2] += q * e
            mass += q
            outcomes[count, 0], outcomes[count, 1], outcomes[count, 2] = q, b, e
            entries[count] = i
            count += 1
    largest = 0
    for i in range(size):
        numbers[i, 1] /= numbers[i, 0]
        numbers[i, 2] /= numbers[i, 0]
        if numbers[i, 0] > numbers[largest, 0]:
            largest = i
    for x in range(count):
        i = entries[x]
        b = outcomes[x, 1] - numbers[i, 1]
        numbers[i, 3] += outcomes[x, 0] * b * b
        numbers[i, 4] += outcomes[x, 0] * b * (outcomes[x, 2] - numbers[i, 2])
    for i in range(size):
        if numbers[i, 3] > SMALLEST_VARIANCE:
            numbers[i, 4] /= numbers[i, 3]
        else:  # all of e is residual
            numbers[i, 3] = numbers[i, 4] = 0.0
    for x in range(count):
        i = entries[x]
        off = outcomes[x, 2] - numbers[i, 2] - numbers[i, 4] * (outcomes[x, 1] - numbers[i, 1])
        residual += outcomes[x, 0] * off * off
    if size > 0 and numbers[largest, 0] > 2.0 * numbers[0, 0]:
        for part in range(PARTS):
            numbers[0, part], numbers[largest, part] = numbers[largest, part], numbers[0, part]
        to[0], to[largest] = to[largest], to[0]
    return mass, residual


@njit(cache=True)
def strip_offsets(starts, order, n_states):
    """Where each strip's entries begin: it has as many as the longest of its states."""
    offsets = np.zeros(len(order) // LANES + 1, np.int64)
    for strip in range(len(offsets) - 1):
        longest = np.int64(0)
        for i in range(strip * LANES, min(n_states, (strip + 1) * LANES)):
            longest = max(longest, np.int64(starts[order[i] + 1]) - np.int64(starts[order[i]]))
        offsets[strip + 1] = offsets[strip] + longest
    return offsets


@njit(cache=True, error_model="numpy")
def merge(walk, starts, successors):
    """The ``Strips`` of a walk; those of ``successors`` from starts[s] to starts[s + 1] are the states after s, sorted here."""
    n_states = len(starts) - 1
    n_actions, n_strips = walk.act.shape[1] // n_states, (n_states + LANES - 1) // LANES
    lengths = np.zeros(n_states, np.int64)
    n_outcomes = 0
    for s in range(n_states):
        lengths[s] = np.int64(starts[s + 1]) - np.int64(starts[s])
        n_outcomes = max(n_outcomes, np.int64(walk.indptr[(s + 1) * n_actions]) - np.int64(walk.indptr[s * n_actions]))
    longest = lengths.max()
    order = np.full(n_strips * LANES, n_states, np.int64)
    order[:n_states] = np.arange(n_states)
    offsets = strip_offsets(starts, order, n_states)
    if offsets[n_strips] * LANES > 1.25 * len(successors):  # too much padding: states of one length go together
        order[:n_states] = np.argsort(lengths, kind="mergesort")
        offsets = strip_offsets(starts, order, n_states)
    lane_of = np.zeros(n_states, np.uint32)
    for i in range(n_states):
        lane_of[order[i]] = i
    columns = np.full(offsets[n_strips] * LANES, n_strips * LANES, np.uint32)
    numbers = np.zeros(offsets[n_strips] * LANES * PARTS)
    fixed = np.zeros(2 * n_strips * LANES)
    place, own = np.zeros(n_states, np.uint32), np.zeros((longest, PARTS))
    outcomes, entries = np.zeros((n_outcomes, 3)), np.zeros(n_outcomes, np.int64)
    for i in range(n_states):
        s, first, lane = order[i], offsets[i // LANES], i % LANES
        to = successors[starts[s] : starts[s + 1]]
        both = (i - lane) * 2 + lane
        fixed[both], fixed[both + LANES] = merge_state(s, walk, place, to, own, outcomes, entries)
        for entry in range(lengths[s]):
            columns[(first + entry) * LANES + lane] = lane_of[to[entry]]
            for part in range(PARTS):
                numbers[((first + entry) * PARTS + part) * LANES + lane] = own[entry, part]
    aligned = np.ones(offsets[n_strips], np.bool_)
    for entry in range(len(aligned)):
        for lane in range(1, LANES):
            aligned[entry] &= columns[entry * LANES + lane] == columns[entry * LANES] + np.uint32(lane)
    return Strips(offsets, columns, aligned, numbers, fixed, order)


@njit(cache=True, error_model="numpy")
def step_back(strips, factor, offset, here, there, local, room, lanes):
    """All strips, one step back: y, v -> factor X - offset, factor^2 Var X; ``local`` takes each state's own variance.

    The last LANES of y and v are room for what an entry leads to where that does not stand side by side. ``lanes`` is LANES:
    a short loop over a number known beforehand would be unrolled before it is made of vector instructions, and not be.
    """
    offsets, columns, aligned, numbers, fixed, _ = strips
    (y, v), (new_y, new_v) = here, there
    one, tail = np.uint64(LANES), np.uint64(np.uint32(len(y) - LANES))
    two, three, four = one * np.uint64(2), one * np.uint64(3), one * np.uint64(4)
    for strip in range(len(offsets) - 1):
        for entry in range(offsets[strip], offsets[strip + 1]):
            at = np.uint64(entry) * one
            if aligned[entry]:
                j = np.uint64(columns[at])
            else:
                j = tail
                for i in range(one):
                    x = np.uint64(columns[at + i])
                    y[tail + i] = y[x]
                    v[tail + i] = v[x]
            at *= np.uint64(PARTS)
            if entry == offsets[strip]:
                for i in range(one):
                    b, off = numbers[at + one + i], y[j + i] + numbers[at + four + i]
                    c = numbers[at + three + i]
                    room[i] = b * y[j + i] + numbers[at + two + i]
                    room[one + i] = 0.0
                    room[two + i] = c * off * off
                    room[three + i] = (numbers[at + i] * b * b + c) * v[j + i]
                continue
            for i in range(one):
                q, b, c = numbers[at + i], numbers[at + one + i], numbers[at + three + i]
                off = y[j + i] + numbers[at + four + i]
                d = b * y[j + i] + numbers[at + two + i] - room[i]
                room[one + i] += q * d
                room[two + i] += q * d * d + c * off * off
                room[three + i] += (q * b * b + c) * v[j + i]
        at = np.uint64(strip) * one
        both = at * np.uint64(2)
        for i in range(lanes):
            mass, d = fixed[both + i], room[one + i]
            own = max(room[two + i] - (2.0 - mass) * d * d + fixed[both + one + i], 0.0)
            room[two + i] = own
            new_y[at + i] = factor * (mass * room[i] + d)
            new_v[at + i] = factor * factor * (own + room[three + i])
        if len(local):
            for i in range(lanes):
                local[at + i] = room[two + i]
        if len(offset):
            for i in range(lanes):
                new_y[at + i] -= offset[at + i]


@njit(cache=True, error_model="numpy")
def backward(strips, discounts, offsets, keep):
    """E X, Var X (N,) of the first step and, if ``keep``, each step's own variance (T, N), by places.

    ``discounts`` (T,) are gamma_t, ``offsets`` (T, N) k_t, or (0, N) where they are 0.
    """
    horizon, size = len(discounts), len(strips.order)
    room = np.zeros(4 * LANES)  # z of the first entry; sums of q d, of squares, of what v carries
    lanes, length = np.uint64(len(room) // 4), size + 1 + LANES  # behind the states 0, which padding reads, and room
    here, there = (np.zeros(length), np.zeros(length)), (np.zeros(length), np.zeros(length))
    local, nothing = np.empty((horizon if keep else 0, size)), np.zeros(0)
    if len(offsets):
        here[0][:size] = -offsets[horizon - 1]
    for t in range(horizon - 1, -1, -1):
        factor = discounts[t - 1] if t > 0 else 1.0
        offset = offsets[t - 1] if t > 0 and len(offsets) else nothing
        step_back(strips, factor, offset, here, there, local[t] if keep else nothing, room, lanes)
        here, there = there, here
    return here[0][:size], here[1][:size], local
